"""Hands, objects, tasks and plans of cases, each made once per process."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from planner.batch.pool import grasp_seed
from planner.collision.world import OBJECT
from planner.errors import NotFoundError, ObjectError, PlannerError, TaskError
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.objects import parse_object
from planner.plan import GraspPlan
from planner.search.grasp import plan_grasp
from planner.shapes import Shape, shape_key
from planner.shapes.meshes.io import MESH_SUFFIXES
from planner.synthesis.options import SynthesisOptions
from planner.task import DEFAULT_MU, GraspTask
from sim.cli.options import names
from sim.tables import Row

PRIMITIVES = "sphere,box,cylinder,capsule,ellipsoid"
MESHES = "mug,lbracket,torus,hammer,superquadric"


@dataclass(frozen=True, kw_only=True)
class Setting:
    """What the tasks of a measurement share.

    Attributes:
        mu: Sliding friction that planning relies on (-).
        fingers: Fingers that take part; None for the hand's default, of which some may be spared.
        floating: Whether there is no table.
        joint_error: Standard deviation of the encoders' errors that planning reckons with, rad.
        grasp_type: What touches (``planner.hands.grasp_types``), instead of ``fingers``.
        mass: Of the object, kg; its own if None.
    """

    mu: float = DEFAULT_MU
    fingers: tuple[str, ...] | None = None
    floating: bool = False
    joint_error: float = 0.0
    grasp_type: str | None = None
    mass: float | None = None


USUAL = Setting()
hand_of = lru_cache(maxsize=16)(load_hand)


def checked_hand(name: str) -> Hand:
    """A hand, loaded once per process; bad input ends a measurement before it begins."""
    hand: Hand = hand_of(name)
    return hand


def objects_of(text: str, kinds: Sequence[str] = ()) -> list[tuple[str, str]]:
    """Label and specification of every object: names, mesh files, and those in folders.

    Args:
        text: With commas between them.
        kinds: Names that mean something else to the measurement.

    Raises:
        ObjectError: A folder without mesh files, or an object that cannot be used.
        NotFoundError: No object has that name.
    """
    found: list[tuple[str, str]] = []
    for given in names(text):
        folder = Path(given)
        if given in kinds:
            found.append((given, ""))
        elif not folder.is_dir():
            parse_object(given)
            label = folder.stem if folder.suffix.lower() in MESH_SUFFIXES else given
            found.append((label, given))
        else:
            files = sorted(f for f in folder.iterdir() if f.suffix.lower() in MESH_SUFFIXES)
            if not files:
                raise ObjectError(
                    f"the folder {given} holds no mesh file; meshes end in "
                    f"{', '.join(MESH_SUFFIXES)}"
                )
            found += [(file.stem, str(file)) for file in files]
    return found


def cells_of(hands: Sequence[str], objects: str) -> Iterator[Row]:
    """The beginning of a case for every hand and object.

    Raises:
        PlannerError: A hand, or an object that was named, cannot be used; a file of a folder may
            fail.
    """
    found = objects_of(objects)
    for hand in hands:
        checked_hand(hand)
        for label, spec in found:
            yield {"hand": hand, "object": label, "spec": spec}


def known(what: str, asked: str, there: Sequence[str]) -> list[str]:
    """Names with commas between them, all of which there are; "all" stands for all.

    Raises:
        NotFoundError: One that there is not.
    """
    chosen = list(there) if asked == "all" else names(asked)
    for name in chosen:
        if name not in there:
            raise NotFoundError(what, name, there)
    return chosen


@lru_cache(maxsize=32)
def task_of(hand: str, spec: str, setting: Setting = USUAL) -> GraspTask:
    """The task of a hand and an object, made once per process.

    Raises:
        PlannerError: It cannot be made.
    """
    return GraspTask.create(
        checked_hand(hand),
        parse_object(spec, mass=setting.mass),
        table_height=None if setting.floating else 0.0,
        mu=setting.mu,
        fingers=setting.fingers,
        joint_error=setting.joint_error,
        grasp_type=setting.grasp_type,
    )


@lru_cache(maxsize=2)
def _plan(hand: str, spec: str, seed: int, setting: Setting) -> GraspPlan | str:
    try:
        return plan_grasp(task_of(hand, spec, setting), seed=seed)
    except PlannerError as error:
        return str(error)


def plan_of(hand: str, spec: str, seed: int, setting: Setting = USUAL) -> GraspPlan:
    """A plan, made once for the cases that follow each other.

    Raises:
        TaskError: There is none, or no task.
    """
    plan = _plan(hand, spec, seed, setting)
    if isinstance(plan, str):
        raise TaskError(plan)
    return plan


def seed_of(seed: int, shape: Shape, k: int) -> int:
    """Seed of request k of a shape, that of ``opposable batch``."""
    return grasp_seed(seed, shape_key(shape), k)


def options_of(rounds: int | None, **more: object) -> SynthesisOptions:
    """The planner's options, with rounds if they are given."""
    given = {**more, **({} if rounds is None else {"rounds": rounds})}
    return SynthesisOptions(**given)  # type: ignore[arg-type]


def clearance_of(plan: GraspPlan) -> float:
    """Least distance (m) of what must not touch, the object from links that carry pads left out.

    Those links are near the object wherever they touch it. Where they are all that was noted, their
    largest distance is returned, and the true one is no less.
    """
    hand = plan.task.hand
    joints = {finger.pad.joint_id for finger in plan.task.fingers}
    carriers = {g.name for g in hand.geometries if g.joint_id in joints}
    noted = plan.verification.closest
    for pair in noted:
        if not (pair.second == OBJECT and pair.first in carriers):
            return pair.distance
    return noted[-1].distance if noted else float("inf")


def half_longest_side(shape: Shape) -> float:
    """Half the longest side (m) of a shape's bounding box in its own axes."""
    return max(0.5 * (shape.support(a) + shape.support(-a)) for a in np.eye(3))
