"""``Judge``: one grasp of a file, stage by stage, by the functions of ``planner.verification``.

A file does not say which fingers hold. Those take part whose pads touch within ``TOUCH_TOL``, on
the pad, off edges and where the object may be touched; where these are too few for a grasp, the
nearest ones, and the stages "gap", "pad" and "penetration" say what is wrong with them. The other
fingers must not penetrate, as in a plan.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from planner.collision.pad_contact import PadContact, pad_contacts
from planner.collision.pregrasp import find_approach
from planner.collision.world import CollisionWorld
from planner.contacts import ContactSet
from planner.errors import TaskError
from planner.exchange.audit.report import AuditRow, StageResult
from planner.exchange.formats import ImportedGrasp
from planner.exchange.joints import T_file_object
from planner.failure import Failure
from planner.objects import GraspObject, parse_object
from planner.plan import Verification
from planner.quality import force_closure
from planner.shapes import SIZED_SHAPES, Mesh
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask
from planner.tolerances import ANGLE_TOL, CLOSURE_EDGES, FLAT_ANGLE_TOL, TOUCH_TOL
from planner.verification import (
    contacts_of,
    edge_failures,
    no_closure,
    no_forces,
    plan_forces,
    verify_geometry,
)

SAME = 1e-3
"""Largest relative error (-) of lengths and volume of the result; it is larger for
a shape of which not all sizes are lengths."""


def scaled_object(item: GraspObject, scale: float) -> GraspObject:
    """The same object, mass and region, with all lengths multiplied.

    Args:
        item: The object.
        scale: Factor, > 0.

    Raises:
        TaskError: Its shape cannot be made in another size.
        ObjectError: The factor makes it too small or too large.
    """
    if scale == 1.0:
        return item
    shape = item.shape
    if isinstance(shape, Mesh) and shape.source is not None:
        source = shape.source
        made = Mesh.load(source.path, scale=source.scale * scale, repair=source.repair)
        return replace(item, shape=made)
    name, _, sizes = shape.spec.partition(":")
    if name in SIZED_SHAPES and sizes:
        scaled = "x".join(repr(scale * float(size)) for size in sizes.split("x"))
        made_shape = parse_object(f"{name}:{scaled}").shape
        if np.isclose(made_shape.volume, scale**3 * shape.volume, rtol=SAME) and np.allclose(
            made_shape.half_extents, scale * shape.half_extents, rtol=SAME
        ):
            return replace(item, shape=made_shape)
    raise TaskError(
        f"the file scales its object by {scale:g}, and {shape.spec} cannot be scaled; give "
        "the mesh file that the grasps were made for"
    )


MOST_TASKS = 24
"""Tasks that are kept: one per set of fingers, scale and place of the object."""

MOST_REASONS = 3
"""Reasons of a stage that are told; the number is that of the worst."""

_STAGE_OF = {
    "pad_gap": "gap",
    "pad_geometry_gap": "gap",
    "off_pad": "pad",
    "edge": "pad",
    "region": "pad",
    "penetration": "penetration",
    "coupling": "joints",
    "joint_limit": "joints",
}
"""Kind of a failure of ``verify_geometry`` -> stage."""


class Judge:
    """Judges grasps of one hand and one object; keeps the scenes that it has made."""

    def __init__(
        self, task: GraspTask, *, fixed_fingers: bool = False, approach: bool = False
    ) -> None:
        """Prepare.

        Args:
            task: Hand, object in the size of scale 1, friction, grip, gravity, table.
            fixed_fingers: Whether the grasps are held by the fingers of the task and no others;
                else they are found from each pose.
            approach: Whether the way in is judged too.
        """
        self.task, self.told, self.approach = task, fixed_fingers, approach
        self._tasks: OrderedDict[object, GraspTask] = OrderedDict()
        self._worlds: dict[GraspTask, CollisionWorld] = {}

    def row(self, grasp: ImportedGrasp, index: int = 0, source: str = "") -> AuditRow:
        """The verdict on a grasp.

        Args:
            grasp: The grasp.
            index: Its place in the file.
            source: The file.

        Raises:
            TaskError, ObjectError: The object cannot be scaled as the grasp says.
        """
        q = np.array(grasp.q)
        every = self._task(grasp, self._all_fingers)
        base = T_world_base(every, grasp)
        touches = pad_contacts(every, base, q)
        task = self._task(grasp, self._taking_part(every, touches))
        world = self._world(task)
        kept = [touches[every.finger_names.index(name)] for name in task.finger_names]
        results = _geometry_stages(task, kept, verify_geometry(world, base, q, kept))
        contacts = contacts_of(task, kept)
        weighed = self._weighed(task, grasp)
        touching = results["gap"].passed is True
        results |= _contact_stages(weighed, contacts, base, q, judged=touching)
        if self.approach:
            results["approach"] = _approach(world, base, q, contacts, results)
        return AuditRow(
            index=index,
            name=grasp.name,
            source=source,
            object=grasp.object,
            scale=grasp.scale,
            fingers=task.finger_names,
            gaps_mm={
                name: 1e3 * _gap(touch)
                for name, touch in zip(every.finger_names, touches, strict=True)
            },
            stages=results,
        )

    def near_pads(self, grasp: ImportedGrasp, within: float) -> int:
        """How many pads are within a distance (m) of the surface, either side."""
        every = self._task(grasp, self._all_fingers)
        touches = pad_contacts(every, T_world_base(every, grasp), np.array(grasp.q))
        return sum(abs(_gap(t)) <= within for t in touches)

    def task_of(self, grasp: ImportedGrasp, fingers: Sequence[str]) -> GraspTask:
        """The task that a grasp solves with some fingers, with gravity as it pulls there."""
        return self._weighed(self._task(grasp, tuple(fingers)), grasp)

    @property
    def how(self) -> dict[str, bool]:
        """How it was made, as arguments."""
        return {"fixed_fingers": self.told, "approach": self.approach}

    @property
    def _all_fingers(self) -> tuple[str, ...]:
        return self.task.finger_names if self.told else tuple(self.task.hand.fingers)

    def _taking_part(self, task: GraspTask, touches: Sequence[PadContact]) -> tuple[str, ...]:
        """Names of the fingers whose contacts are judged."""
        if self.told:
            return task.finger_names
        gaps = [abs(_gap(touch)) for touch in touches]
        on_edge = {f.text.split(" ", 1)[0] for f in edge_failures(task, touches)}
        region = task.object.touch
        allowed = (
            np.ones(len(touches), dtype=bool)
            if region is None
            else region.permits(np.array([t.point for t in touches]), task.finger_names)
        )
        good = [
            finger.name not in on_edge
            and bool(may)
            and touch.angle <= finger.pad.half_angle + _angle_tol(touch)
            for finger, touch, may in zip(task.fingers, touches, allowed, strict=True)
        ]
        order = sorted(range(len(gaps)), key=lambda i: (gaps[i] > TOUCH_TOL, not good[i], gaps[i]))
        touching = [i for i in order if gaps[i] <= TOUCH_TOL and good[i]]
        count = max(len(touching), task.fingers_needed)
        return tuple(task.finger_names[i] for i in sorted(order[:count]))

    def _task(self, grasp: ImportedGrasp, fingers: tuple[str, ...]) -> GraspTask:
        """The task for a grasp's scale and place, and for some fingers."""
        place: object = None
        if self._stands and grasp.T_world_object is not None:
            place = grasp.T_world_object.homogeneous.round(9).tobytes()
        arm = None if self.task.hand.arm is None else grasp.T_object_base.homogeneous.tobytes()
        key = (grasp.scale, place, fingers, arm)
        if key not in self._tasks:
            self._tasks[key] = self._made(grasp, fingers)
            if len(self._tasks) > MOST_TASKS:
                self._worlds.pop(self._tasks.popitem(last=False)[1], None)
        self._tasks.move_to_end(key)
        return self._tasks[key]

    def _world(self, task: GraspTask) -> CollisionWorld:
        """True geometry of a task that is kept."""
        if task not in self._worlds:
            self._worlds[task] = CollisionWorld(task)
        return self._worlds[task]

    @property
    def _stands(self) -> bool:
        """Whether it matters for the geometry where the object is."""
        return self.task.table_height is not None or bool(self.task.obstacles)

    def _made(self, grasp: ImportedGrasp, fingers: tuple[str, ...]) -> GraspTask:
        item = scaled_object(self.task.object, grasp.scale)
        task = replace(self.task, object=item, wrist_free=True)
        if fingers != task.finger_names:
            task = task.with_fingers(fingers)
        if self._stands and grasp.T_world_object is not None:
            task = replace(task, T_world_object=grasp.T_world_object * T_file_object(task))
        if task.hand.arm is not None:
            task = replace(task, T_world_base=T_world_base(task, grasp))
        return task

    def _weighed(self, task: GraspTask, grasp: ImportedGrasp) -> GraspTask:
        """The task with gravity as it pulls where the file has the object.

        Without surroundings all grasps share one scene, and gravity is turned into it.
        """
        if self._stands or grasp.T_world_object is None:
            return task
        turn = task.T_world_object.rotation @ grasp.T_world_object.rotation.T
        return replace(task, gravity=turn @ task.gravity)


def T_world_base(task: GraspTask, grasp: ImportedGrasp) -> SE3:
    """Pose of the hand's base in the world of a task, from that in the frame of the object's file.

    Args:
        task: Has the object where it stands.
        grasp: The grasp.
    """
    return task.T_world_object * T_file_object(task).inverse() * grasp.T_object_base


def _gap(touch: PadContact) -> float:
    """Signed distance (m) of a pad, or of what carries it where that is farther off."""
    return max(touch.pad_gap, touch.gap, key=abs)


def _angle_tol(touch: PadContact) -> float:
    return ANGLE_TOL if touch.round else FLAT_ANGLE_TOL


def _geometry_stages(
    task: GraspTask, touches: Sequence[PadContact], found: Verification
) -> dict[str, StageResult]:
    """The stages that ``verify_geometry`` decides; a pad that is too deep penetrates."""
    reasons: dict[str, list[str]] = {name: [] for name in ("joints", "gap", "pad", "penetration")}
    said = {touch.gap for touch in touches if abs(touch.pad_gap) > TOUCH_TOL}  # of the pad itself
    for failure in found.failures:
        gap = failure.numbers.get("gap", 0.0)
        if failure.kind == "pad_geometry_gap" and gap in said:
            continue
        reasons["penetration" if gap < 0.0 else _STAGE_OF[failure.kind]].append(failure.text)
    gaps = [_gap(touch) for touch in touches]
    depth = min((c.distance for c in found.closest), default=0.0)
    deep = min(g for g in gaps) if min(gaps) < -TOUCH_TOL else 0.0
    off = max(t.angle - f.pad.half_angle for f, t in zip(task.fingers, touches, strict=True))
    numbers = {
        "joints": max(found.coupling_error, found.limit_error),
        "gap": 1e3 * max(0.0, *gaps),
        "pad": float(np.rad2deg(max(0.0, off))),
        "penetration": 1e3 * max(0.0, -depth, -deep),
    }
    return {
        name: StageResult(passed=not texts, number=numbers[name], reason=_first(texts))
        for name, texts in reasons.items()
    }


def _first(texts: Sequence[str]) -> str:
    """The first few of many reasons."""
    more = len(texts) - MOST_REASONS
    return "; ".join(texts[:MOST_REASONS]) + (f"; and {more} more" if more > 0 else "")


def _contact_stages(
    task: GraspTask, contacts: ContactSet, base: SE3, q: FloatArray, *, judged: bool
) -> dict[str, StageResult]:
    """Closure and forces at the contacts, as ``verify_grasp`` decides them."""
    if not judged:
        waits = StageResult(passed=None, reason="there are not enough contacts to judge")
        return {"closure": waits, "forces": waits}
    closure = force_closure(contacts, edges=CLOSURE_EDGES)
    weight = closure.normalised_min_weight
    if not closure.closed:
        return {
            "closure": StageResult(passed=False, number=weight, reason=no_closure(closure).text),
            "forces": StageResult(passed=None, reason="the contacts do not close"),
        }
    forces = plan_forces(task, contacts, base, q)
    reason = "" if forces.found else no_forces(task, forces).text
    return {
        "closure": StageResult(passed=True, number=weight),
        "forces": StageResult(passed=forces.found, number=forces.fraction, reason=reason),
    }


def _approach(
    world: CollisionWorld,
    base: SE3,
    q: FloatArray,
    contacts: ContactSet,
    before: Mapping[str, StageResult],
) -> StageResult:
    """Whether there is a pre-grasp and a straight way in."""
    if not all(result.passed is True for result in before.values()):
        return StageResult(passed=None, reason="there is no grasp to go to")
    way = find_approach(world, base, q, contacts.normals)
    if isinstance(way, Failure):
        return StageResult(passed=False, reason=way.text)
    return StageResult(passed=True, number=1e3 * way.pregrasp_distance)
