"""The verdict on a gait: an order of lifts, forces through all of them, ways of fingers, cycles.

Where fingers land is where the stroke begins, recomputed on the true geometry with the object where
it stands at the end. For every lift of the order: the contacts that hold close with a margin, and
bear the object's weight within the torque limits with no force on the finger that leaves; so do all
contacts once it has landed; and coal finds its way free. Later strokes are judged like the first,
with the object where it is by then.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from planner.collision.pad_contact import pad_touches
from planner.contacts import ContactSet
from planner.motion.check import MotionJudge, Place
from planner.motion.gait.alike import same_space
from planner.motion.gait.order import NoOrder, Order, find_order, holding, standing
from planner.motion.gait.plan import GaitPlan, Relocation, Stroke
from planner.motion.gait.relocate import FingerPaths
from planner.motion.plan import Knot, MotionPlan
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask
from planner.tolerances import SWING_VERDICT_SHARE, TOUCH_TOL
from planner.verification.geometry import contacts_of, verify
from planner.verification.grasp import plan_forces

__all__ = ["GaitJudge"]

HOLDING_GRIP = 0.5
"""Least normal force (N) of those that hold while a finger is away, where the task's grip cannot be
had: a finger between two others presses the object out of them, so it is to press lightly."""

SAME_POINT, SAME_NORMAL = 1e-5, 1e-3
"""How far contacts (m) and normals (-) of a later stroke may be from those of the first to count as
the same: far below what is allowed of a touch."""

HOLDING_EDGES = 16
"""Sides of the pyramid of those forces, for the same reason: it gives away 2 % of the friction."""


class GaitJudge:
    """Judges gaits of one task; its geometry is made once."""

    def __init__(self, task: GraspTask) -> None:
        """Prepare the geometry."""
        self.lifted = replace(task, table_height=None, obstacles=())
        self.paths = FingerPaths(self.lifted)
        self.without = [
            self.lifted.with_fingers([name for name in task.finger_names if name != away])
            for away in task.finger_names
        ]
        self._motion = MotionJudge(task)

    def judge(self, stroke: MotionPlan, cycles: int) -> GaitPlan | str:
        """A plan of so many strokes and the relocations between them; or why not.

        Args:
            stroke: The first of them; it ends on its path.
            cycles: How many.
        """
        phases: list[Stroke | Relocation] = [Stroke(cycle=0, knots=stroke.knots)]
        first: tuple[Relocation, ...] = ()
        if cycles > 1:
            found = self.relocations(stroke)
            if isinstance(found, str):
                return found
            if isinstance(found, NoOrder):
                return str(found)
            first = found
        for cycle in range(1, cycles):
            why = self._faults(first, stroke, cycle - 1)
            following = why or self._stroke(stroke, cycle)
            if isinstance(following, str):
                return f"cycle {cycle + 1}: {following}"
            phases += [_moved(r, stroke, cycle - 1) for r in first]
            phases.append(following)
        return GaitPlan(motion=stroke, cycles=cycles, phases=tuple(phases), record=stroke.record)

    def relocations(
        self,
        stroke: MotionPlan,
        *,
        moved: frozenset[int] = frozenset(),
        refused: frozenset[int] = frozenset(),
    ) -> tuple[Relocation, ...] | NoOrder | str:
        """What moves on after a stroke, in an order that holds; or why there is none.

        Args:
            stroke: The stroke.
            moved: Numbers of the fingers that have moved on already.
            refused: Numbers of those that cannot be the next, as was found out where it is done.

        Returns:
            The relocations; or what stands against every order; or, where the object does not look
            the same after the stroke, that it does not.
        """
        end = _End(self, stroke)
        if end.unlike:
            return end.unlike

        def refuse(finger: int, before: frozenset[int]) -> str:
            if before == moved and finger in refused:
                return "it could not be lifted when it was tried"
            return end.refuse(finger, before)

        found = find_order(end.begin, end.end, stroke.path.axis, refuse=refuse, moved=moved)
        return end.build(found, moved) if isinstance(found, Order) else found

    def _faults(self, relocations: tuple[Relocation, ...], stroke: MotionPlan, cycle: int) -> str:
        """What is in the way of fingers that move on after a later stroke, "" for nothing."""
        first = stroke.knots[-1].T_world_object
        if same_space(self.lifted.object.shape, first, _displaced(first, stroke, cycle)):
            return ""  # nothing differs
        for relocation in relocations:
            finger = self.lifted.hand.fingers[relocation.finger]
            pose = _displaced(relocation.T_world_object, stroke, cycle)
            base = pose.inverse() * stroke.T_world_base
            why = self.paths.fault(finger, base, relocation.postures)
            if why:
                return why
        return ""

    def _stroke(self, stroke: MotionPlan, cycle: int) -> Stroke | str:
        """A later stroke, judged where the object is by then; or why it does not hold."""
        poses = [_displaced(knot.T_world_object, stroke, cycle) for knot in stroke.knots]
        alike = [
            self._alike(knot, pose, stroke) for knot, pose in zip(stroke.knots, poses, strict=True)
        ]
        same = [knot for knot in alike if knot is not None]
        if len(same) == len(alike):
            return Stroke(cycle=cycle, knots=tuple(same))
        places = [
            Place(
                place=knot.place,
                T_object_base=pose.inverse() * stroke.T_world_base,
                q=knot.q,
            )
            for knot, pose in zip(stroke.knots, poses, strict=True)
        ]
        knots = self._motion.knots(
            stroke.T_world_base, places, stroke.path, stroke.tube, T_world_start=poses[0]
        )
        return knots if isinstance(knots, str) else Stroke(cycle=cycle, knots=knots)

    def _alike(self, knot: Knot, T_world_object: SE3, stroke: MotionPlan) -> Knot | None:
        """A knot of the first stroke with the object elsewhere, if the hand feels no difference.

        The same contacts in the world close as before and bear the weight with the same forces; on
        the way there the pads slide as little as before. What is near is looked at again.
        """
        task = self.lifted
        base = task.T_world_object * T_world_object.inverse() * stroke.T_world_base
        touches = pad_touches(task, base, knot.q)
        contacts = contacts_of(task, touches).transformed(
            T_world_object * task.T_world_object.inverse()
        )
        apart = np.abs(contacts.positions - knot.contacts.positions).max()
        turned = np.abs(contacts.normals - knot.contacts.normals).max()
        if apart > SAME_POINT or turned > SAME_NORMAL:
            return None
        verification = verify(self.paths.world, base, knot.q, touches)
        if not verification.ok:
            return None
        moved = T_world_object.translation - knot.T_world_object.translation
        return replace(
            knot,
            T_world_object=T_world_object,
            contacts=replace(knot.contacts, center=knot.contacts.center + moved),
            verification=verification,
        )


@dataclass(frozen=True, kw_only=True)
class _Move:
    """A lift that holds: its way, and the forces while the finger is away and after."""

    postures: FloatArray
    grip: float
    during: ContactSet
    after: ContactSet


class _End:
    """Hand and object where a stroke has ended."""

    def __init__(self, judge: GaitJudge, stroke: MotionPlan) -> None:
        """Compute the contacts where fingers stand and where they will land."""
        self._judge, self._stroke = judge, stroke
        first, last = stroke.knots[0], stroke.knots[-1]
        self.T_world_object = last.T_world_object
        self._base = self.T_world_object.inverse() * stroke.T_world_base
        task = judge.lifted
        touches = pad_touches(task, task.T_world_object * self._base, first.q)
        gaps = np.array([touch.pad_gap for touch in touches])
        worst = int(np.abs(gaps).argmax())
        self.unlike = ""
        if abs(gaps[worst]) > TOUCH_TOL:
            self.unlike = (
                f"the object does not look the same to the hand after a stroke: {stroke.path} put "
                f"the surface {1e3 * gaps[worst]:.1f} mm from where {task.finger_names[worst]} "
                "would land"
            )
        self.begin = contacts_of(task, touches).transformed(
            self.T_world_object * task.T_world_object.inverse()
        )
        self.end = last.contacts
        self._moves: dict[tuple[int, frozenset[int]], _Move] = {}

    def posture(self, moved: frozenset[int]) -> FloatArray:
        """Joints (nq,) after some fingers have moved on; idle ones go along with the first."""
        first, last = self._stroke.knots[0].q, self._stroke.knots[-1].q
        q = (first if moved else last).copy()
        for i, finger in enumerate(self._judge.lifted.fingers):
            q[finger.q_index] = (first if i in moved else last)[finger.q_index]
        return q

    def refuse(self, finger: int, moved: frozenset[int]) -> str:
        """Why a finger cannot be lifted although the others close, "" if it can."""
        judge, base = self._judge, self._stroke.T_world_base
        name = judge.lifted.finger_names[finger]
        q, landed = self.posture(moved), self.posture(moved | {finger})
        rest = holding(self.begin, self.end, moved, finger)
        for grip in (judge.lifted.grip_force, min(HOLDING_GRIP, judge.lifted.grip_force)):
            during = plan_forces(
                judge.without[finger],
                rest,
                base,
                q,
                min_normal=grip,
                friction_scale=SWING_VERDICT_SHARE,
                edges=HOLDING_EDGES,
            )
            if during.found:
                break
        if not during.found:
            return f"the others cannot bear the load: {during.reason}"
        whole = standing(self.begin, self.end, moved | {finger})
        after = plan_forces(judge.lifted, whole, base, landed)
        if not after.found:
            return f"with {name} landed there are no forces: {after.reason}"
        postures = judge.paths.path(judge.lifted.hand.fingers[name], self._base, q, landed)
        if isinstance(postures, str):
            return postures
        self._moves[finger, moved] = _Move(
            postures=postures, grip=grip, during=during.contacts, after=after.contacts
        )
        return ""

    def build(self, order: Order, moved: frozenset[int]) -> tuple[Relocation, ...]:
        """The relocations of an order, after some, whose lifts have all been agreed to."""
        out: list[Relocation] = []
        before = standing(self.begin, self.end, moved) if moved else self.end
        for lift in order.lifts:
            move = self._moves[lift.finger, lift.moved]
            out.append(
                Relocation(
                    cycle=0,
                    finger=self._judge.lifted.finger_names[lift.finger],
                    T_world_object=self.T_world_object,
                    postures=move.postures,
                    before=before,
                    during=move.during,
                    after=move.after,
                    margin=lift.margin,
                    grip=move.grip,
                )
            )
            before = move.after
        return tuple(out)


def _displaced(T_world_object: SE3, stroke: MotionPlan, cycle: int) -> SE3:
    """Where the object is so many strokes later, in the same place of a stroke."""
    path = stroke.path
    turn = pin.exp3(cycle * path.angle * path.axis)
    return SE3(turn @ T_world_object.rotation, T_world_object.translation + cycle * path.shift)


def _moved(relocation: Relocation, stroke: MotionPlan, cycle: int) -> Relocation:
    """The same relocation so many strokes later: hand, contacts and forces are where they were."""
    shift = cycle * stroke.path.shift

    def along(contacts: ContactSet) -> ContactSet:
        return replace(contacts, center=contacts.center + shift)

    return replace(
        relocation,
        cycle=cycle,
        T_world_object=_displaced(relocation.T_world_object, stroke, cycle),
        before=along(relocation.before),
        during=along(relocation.during),
        after=along(relocation.after),
    )
