"""``Roadmap``: grasps of an object on each of its stable poses, kept for all goals of a hand.

    nodes: stable pose k on the table          edges: grasp g, verified on poses k and j
    goals: grasp g, with the largest finger force in each direction that gravity may have

A grasp that is verified on two stable poses moves the object from one to the other: it picks it up,
the wrist turns, and it sets it down. Turned about the vertical all of it is the same, so a pose
stands for all its headings. ``planner.motion.goals`` searches sequences and verifies them again:
what the roadmap holds only tells where to look.

It is kept in the user's cache under a digest of hand, object and task.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.collision.world import CollisionWorld
from planner.errors import TaskError
from planner.failure import Failure
from planner.kinematics import HandState
from planner.motion.verify import pressed
from planner.numerics.kernels import planning_time
from planner.objects import GraspObject
from planner.plan import GraspPlan
from planner.quality import force_closure
from planner.search.grasp import attempts
from planner.shapes import shape_key
from planner.spatial import SE3, FloatArray, pose_from_wxyz, pose_to_wxyz
from planner.system.disk_cache import is_stored, read_arrays, write_arrays
from planner.task import GraspTask
from planner.tolerances import CLOSURE_EDGES, CLOSURE_MARGIN
from planner.verification import plan_forces, verify_grasp

__all__ = ["Roadmap", "build_roadmap", "roadmap_for"]

KIND, VERSION = "roadmap", 1
"""Folder of the cache, and version of its files."""

ATTEMPTS = 200
"""Attempts on each stable pose. Of 60 grasps of the box of 5 x 5 x 8 cm 0 to 12 are grasps on
another face as well, with either hand."""

MOST_POSES = 8
"""Stable poses that are looked at, those first that can be tilted farthest."""

LEAST_TILT_DEG = 8.0
"""Tilt (degrees) at which a pose falls below which nothing is set down on it: objects are set down
by up to 5 degrees off, and on their edge then."""

ROADMAP_S = 600.0
"""CPU time (s) after which building ends with what there is."""

ALOFT = 0.3
"""Height (-) of the palm's direction on another pose from which on the hand would be below."""

MOST_N = 1e6
"""Force (N) that stands for none that bears the weight: kept arrays are finite."""

DIRECTIONS = 48
"""Directions of gravity in the object's frame in which grasps are judged: no other is further than
23 degrees from the nearest of them."""


def directions() -> FloatArray:
    """Directions (n, 3), unit, spread evenly over the sphere on a spiral."""
    k = np.arange(DIRECTIONS) + 0.5
    height, turn = 1.0 - 2.0 * k / DIRECTIONS, np.pi * (1.0 + np.sqrt(5.0)) * k
    across = np.sqrt(1.0 - height**2)
    return np.column_stack([across * np.cos(turn), across * np.sin(turn), height])


@dataclass(frozen=True, kw_only=True, eq=False)
class Roadmap:
    """Grasps (m) of one object by one hand, on its stable poses (n).

    Attributes:
        stands: (m, n), on which poses a grasp is verified, approach and table included.
        bases: (m, 7), position (m) and quaternion (w, x, y, z) of the hand's base, object frame.
        joints: (m, nq).
        fingers: (m, f), which of the hand's fingers take part.
        palms: (m, 3), where the palm looks, unit, object frame.
        forces: (m, d), largest normal force (N) of a finger with gravity in each of ``directions``
            of the object's frame, ``MOST_N`` where nothing bears the weight.
        margins: (m,), normalised min-weight (-).
        cpu_s: (1,), CPU time of building, s.
    """

    stands: NDArray[np.bool_]
    bases: FloatArray
    joints: FloatArray
    fingers: NDArray[np.bool_]
    palms: FloatArray
    forces: FloatArray
    margins: FloatArray
    cpu_s: FloatArray

    def __len__(self) -> int:
        """Number of grasps."""
        return len(self.margins)

    @cached_property
    def _directions(self) -> FloatArray:
        return directions()

    def forces_towards(self, down: FloatArray) -> FloatArray:
        """Largest finger force (m,), N, with gravity near a direction (3,), object frame."""
        return np.asarray(self.forces[:, int(np.argmax(self._directions @ down))])

    def T_object_base(self, grasp: int) -> SE3:
        """Pose of the hand's base of a grasp in the object's frame."""
        return pose_from_wxyz(self.bases[grasp, :3], self.bases[grasp, 3:])

    def finger_names(self, grasp: int, task: GraspTask) -> tuple[str, ...]:
        """Names of the fingers of a grasp, those of the task first in its order."""
        used = {n for n, on in zip(task.hand.fingers, self.fingers[grasp], strict=True) if on}
        own = [name for name in task.finger_names if name in used]
        return (*own, *(n for n in task.hand.fingers if n in used and n not in own))

    def __str__(self) -> str:
        """One line."""
        n = self.stands.shape[1]
        moves = sum(
            bool(self.stands[self.stands[:, k], j].any())
            for k in range(n)
            for j in range(n)
            if j != k
        )
        return (
            f"roadmap: {len(self)} grasps on {int(self.stands.any(axis=0).sum())} of {n} stable "
            f"poses, {moves} of {n * (n - 1)} set-downs on another, {self.cpu_s[0]:.0f} s of CPU"
        )


def poses_of(item: GraspObject, table_height: float | None) -> tuple[SE3, ...]:
    """Stable poses of an object on a table that goals may go through; always the first.

    Raises:
        TaskError: No table.
    """
    if table_height is None:
        raise TaskError(
            "there is no table for the object to stand on; a goal is reached from the table: give "
            "table_height"
        )
    kept = [
        k
        for k, pose in enumerate(item.shape.resting_poses())
        if k == 0 or pose.margin_deg is None or pose.margin_deg >= LEAST_TILT_DEG
    ]
    return tuple(item.resting_pose(table_height, k) for k in kept[:MOST_POSES])


def roadmap_for(
    task: GraspTask,
    *,
    seed: int = 0,
    max_cpu_s: float = ROADMAP_S,
    tell: Callable[[str], object] = lambda line: None,
) -> Roadmap:
    """The roadmap of a task from the cache, or built and kept there.

    Args:
        task: Hand, object, friction and grip; where the object stands does not matter.
        seed: Same seed, same roadmap.
        max_cpu_s: CPU time (s) after which building ends with what there is.
        tell: Called with one line where it is built.

    Raises:
        TaskError: No table, or a hand that cannot grasp the object on any stable pose.
    """
    key = _key(task, seed)
    found = _read(task, key)
    if found is not None:
        return found
    damaged = "the one kept is damaged or of another version, " if is_stored(KIND, key) else ""
    tell(f"{damaged}building the roadmap of {task.object.name} with {task.hand.name} ...")
    built = build_roadmap(task, seed=seed, max_cpu_s=max_cpu_s)
    if built.cpu_s[0] < max_cpu_s:  # one that was cut short depends on the machine
        write_arrays(KIND, key, {f.name: np.asarray(getattr(built, f.name)) for f in fields(built)})
    return built


def _key(task: GraspTask, seed: int) -> str:
    """Digest of all that a roadmap depends on."""
    touch = "" if task.object.touch is None else repr(task.object.touch)
    numbers = [task.object.mass, task.mu, task.mu_torsion, task.grip_force, *task.gravity]
    named = [
        VERSION,
        ATTEMPTS,
        DIRECTIONS,
        seed,
        task.hand.digest,
        shape_key(task.object.shape),
        touch,
    ]
    rest = [task.contact_model, *task.finger_names, task.may_spare_fingers, task.joint_error]
    rest += [repr(task.obstacles), repr(task.needed), task.needed_margin]
    numbers += [CLOSURE_MARGIN, CLOSURE_EDGES, MOST_POSES, LEAST_TILT_DEG, ALOFT]
    text = json.dumps([*named, *rest, *[float(n) for n in numbers]])
    return hashlib.sha256(text.encode()).hexdigest()


def _read(task: GraspTask, key: str) -> Roadmap | None:
    """The roadmap of the cache if it fits the task, else None."""
    arrays: dict[str, Any] | None = read_arrays(KIND, key)
    if arrays is None or set(arrays) != {f.name for f in fields(Roadmap)}:
        return None
    m, n = len(arrays["margins"]), len(poses_of(task.object, task.table_height))
    shapes = {
        "stands": (m, n),
        "bases": (m, 7),
        "joints": (m, task.hand.nq),
        "fingers": (m, len(task.hand.fingers)),
        "palms": (m, 3),
        "forces": (m, DIRECTIONS),
        "margins": (m,),
        "cpu_s": (1,),
    }
    if any(arrays[name].shape != shape for name, shape in shapes.items()):
        return None
    return Roadmap(**{**arrays, "stands": arrays["stands"] > 0, "fingers": arrays["fingers"] > 0})


def build_roadmap(task: GraspTask, *, seed: int = 0, max_cpu_s: float = ROADMAP_S) -> Roadmap:
    """A new roadmap; see ``roadmap_for``."""
    begin, poses = planning_time(), poses_of(task.object, task.table_height)
    rows: list[dict[str, Any]] = []
    refused: list[str] = []
    for k, pose in enumerate(poses):
        builder = _Builder(task, poses, k)
        try:
            endless = attempts(replace(task, T_world_object=pose), seed=seed)
        except TaskError as error:
            refused.append(str(error))
            continue
        for attempt in islice(endless, ATTEMPTS):
            if attempt.plan is not None and (row := builder.row(attempt.plan)) is not None:
                rows.append(row)
            if planning_time() - begin > max_cpu_s:
                break
    if not rows:
        why = f": {refused[0]}" if refused else f" in {ATTEMPTS} attempts each"
        raise TaskError(
            f"{task.hand.name} has no grasp of {task.object.name} on any of its {len(poses)} "
            f"stable poses{why}; try another object, other fingers or more friction"
        )
    columns = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    return Roadmap(**columns, cpu_s=np.array([planning_time() - begin]))


class _Builder:
    """Judges grasps that were found on one stable pose."""

    def __init__(self, task: GraspTask, poses: tuple[SE3, ...], k: int) -> None:
        self._task, self._poses, self._k = task, poses, k
        self._worlds: dict[tuple[tuple[str, ...], int], CollisionWorld] = {}
        self._directions = directions()

    def row(self, plan: GraspPlan) -> dict[str, Any] | None:
        """What a roadmap keeps of a grasp; None if it closes by less than movements must."""
        margin = force_closure(plan.contacts, edges=CLOSURE_EDGES).normalised_min_weight
        if margin < CLOSURE_MARGIN:
            return None
        task, pose = plan.task, self._poses[self._k]
        T_object_base = pose.inverse() * plan.T_world_base
        state = HandState(task.hand, plan.q)
        palm = (T_object_base * state.T_base_palm).rotation @ task.hand.palm_normal
        names = set(task.finger_names)
        return {
            "stands": [self._stands(plan, T_object_base, palm, j) for j in range(len(self._poses))],
            "bases": np.concatenate(pose_to_wxyz(T_object_base)),
            "joints": plan.q,
            "fingers": [name in names for name in task.hand.fingers],
            "palms": palm,
            "forces": self._forces(plan, pose.rotation),
            "margins": margin,
        }

    def _stands(self, plan: GraspPlan, T_object_base: SE3, palm: FloatArray, j: int) -> bool:
        """Whether a grasp is one on another pose too."""
        if j == self._k:
            return True
        pose, names = self._poses[j], plan.task.finger_names
        if (pose.rotation @ palm)[2] > ALOFT:
            return False
        there = replace(plan.task, T_world_object=pose)
        if (names, j) not in self._worlds:
            self._worlds[names, j] = CollisionWorld(there)
        found = verify_grasp(
            there, pose * T_object_base, plan.q, record=plan.record, world=self._worlds[names, j]
        )
        return not isinstance(found, Failure)

    def _forces(self, plan: GraspPlan, rotation: FloatArray) -> FloatArray:
        """Largest normal force (d,), N, with gravity in each direction, object frame."""
        lifted = replace(plan.task, table_height=None, obstacles=())
        pull = float(np.linalg.norm(plan.task.gravity))
        out = np.full(DIRECTIONS, MOST_N)
        for i, down in enumerate(self._directions @ rotation.T):
            borne = replace(lifted, gravity=pull * down)
            forces = plan_forces(borne, plan.contacts, plan.T_world_base, plan.q)
            if forces.found:
                out[i] = pressed(forces)
        return out
