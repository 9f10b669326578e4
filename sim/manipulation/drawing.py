"""Pictures and films of plans: the scene posed as planned, without a simulation."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from planner.contacts import ContactSet
from planner.motion.phase import Knot, Relocation, Stroke
from planner.motion.plan import MovementPlan
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray
from sim.scene.build import build_scene
from sim.show.picture import Tape, draw_tape

STROKE_S, RELOCATION_S = 3.0, 1.0
"""How long a stroke and a relocation take in a film of a plan, s."""

RATE = 25.0
"""Poses per second of such a film."""


@dataclass(frozen=True, kw_only=True)
class Pose:
    """A hand and an object as planned; the base stands where the grasp has it."""

    q: FloatArray
    T_world_object: SE3
    contacts: ContactSet | None


def draw_grasp(plan: GraspPlan, picture: Path, *, arrows: bool) -> str:
    """Draw a grasp on its table; what was drawn, or why not, in one line.

    Args:
        plan: The grasp.
        picture: File to write.
        arrows: Draw the planned contact forces.
    """
    pose = Pose(q=plan.q, T_world_object=plan.task.T_world_object, contacts=plan.contacts)
    return _draw(plan, [pose], picture=picture, video=None, arrows=arrows)


def draw_motion(
    plan: MovementPlan, *, picture: Path | None, video: Path | None, arrows: bool
) -> str:
    """Draw a movement: its first grasp, and a film of the whole, both in the air.

    Args:
        plan: The movement.
        picture: File of the picture, if one is wanted.
        video: File of the film, if one is wanted.
        arrows: Draw the planned contact forces; fingers that move on are drawn without any.
    """
    in_the_air = replace(plan.task, table_height=None, obstacles=())
    poses = list(_poses(plan))
    return _draw(
        replace(plan.grasp, task=in_the_air), poses, picture=picture, video=video, arrows=arrows
    )


def _draw(
    plan: GraspPlan, poses: list[Pose], *, picture: Path | None, video: Path | None, arrows: bool
) -> str:
    scene = build_scene(plan.task, T_world_base=plan.T_world_base, q=plan.q)

    def tape_of(poses: list[Pose]) -> Tape:
        tape = Tape(scene.model, scene.subject)
        for k, pose in enumerate(poses):
            qpos = scene.posed(pose.q, plan.T_world_base, pose.T_world_object)
            tape.keep(k / RATE, qpos, pose.contacts)
        return tape

    told = []
    if picture is not None:
        told.append(draw_tape(tape_of(poses[:1]), pictures={picture: None}, arrows=arrows))
    if video is not None:
        told.append(draw_tape(tape_of(poses), video=video, arrows=arrows))
    return "; ".join(dict.fromkeys(str(drawn) for drawn in told))


def _poses(plan: MovementPlan) -> Iterator[Pose]:
    for phase in plan.phases:
        if isinstance(phase, Stroke):
            yield from _stroke(phase.knots)
        if not isinstance(phase, Relocation):
            continue
        along = np.linspace(0.0, len(phase.postures) - 1.0, round(RELOCATION_S * RATE))
        for place in along:
            q = _between(phase.postures, place)
            yield Pose(q=q, T_world_object=phase.T_world_object, contacts=phase.during)


def _stroke(knots: tuple[Knot, ...]) -> Iterator[Pose]:
    count = max(2, round(STROKE_S * RATE / (len(knots) - 1)))
    for a, b in pairwise(knots):
        for share in np.linspace(0.0, 1.0, count):
            yield Pose(
                q=(1 - share) * a.q + share * b.q,
                T_world_object=SE3.Interpolate(a.T_world_object, b.T_world_object, float(share)),
                contacts=(a if share < 0.5 else b).contacts,
            )


def _between(rows: FloatArray, place: float) -> FloatArray:
    k = min(int(place), len(rows) - 2)
    share = place - k
    return np.asarray((1 - share) * rows[k] + share * rows[k + 1])
