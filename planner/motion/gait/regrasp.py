"""Relocations after a stroke: fingers move on one at a time while the others hold the object.

Fingers land where the stroke began, recomputed on the true geometry with the object where it stands
at the end. For every lift of the order the contacts that hold close with a margin and bear the
object's weight within the torque limits, without force on the lifted finger; all contacts do so
after the landing; and the finger's swing is free of collisions.

``plan_back`` serves a turn that stalls: from any point of the motion the fingers return to where it
began, the object held still, and the motion starts again. ``plan_others`` serves a lift that is
refused during execution: the remaining fingers move on in another order.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from planner.collision.pad_contact import pad_contacts
from planner.contacts import ContactSet
from planner.failure import Failure
from planner.motion.gait.order import NoOrder, Order, find_order, holding, standing
from planner.motion.gait.plan import Relocation
from planner.motion.gait.relocate import FingerPaths
from planner.motion.plan import MotionPlan
from planner.spatial import FloatArray
from planner.task import GraspTask
from planner.tolerances import SWING_VERDICT_SHARE, TOUCH_TOL
from planner.verification.geometry import contacts_of
from planner.verification.grasp import plan_forces

HOLDING_GRIP = 0.5
"""Least normal force (N) of the fingers that hold, where the task's grip force is infeasible: a
finger between two others pushes the object out of their grip, so it presses lightly."""

HOLDING_EDGES = 16
"""Sides of the friction pyramid of those forces; the inscribed pyramid gives away
1 - cos(pi/16) = 2 % of the friction."""


class RegraspPlanner:
    """Plans relocations after strokes of one task; the geometry is built once.

    Attributes:
        lifted: The task without table and obstacles.
        without: The same without each of its fingers.
        paths: Swings of single fingers.
    """

    def __init__(self, task: GraspTask) -> None:
        """Prepare the geometry."""
        self.lifted = replace(task, table_height=None, obstacles=())
        self.paths = FingerPaths(self.lifted)
        self.without = [
            self.lifted.with_fingers([name for name in task.finger_names if name != away])
            for away in task.finger_names
        ]

    def relocations(
        self,
        stroke: MotionPlan,
        *,
        moved: frozenset[int] = frozenset(),
        refused: frozenset[int] = frozenset(),
    ) -> tuple[Relocation, ...] | NoOrder | Failure:
        """The relocations after a stroke, in an order that holds; or why there is none.

        Args:
            stroke: The stroke.
            moved: Numbers of the fingers that have moved on already.
            refused: Numbers of the fingers that execution could not lift next.

        Returns:
            The relocations; or ``NoOrder``; or a failure where the object does not look the same to
            the hand after the stroke.
        """
        end = _End(self, stroke)
        if end.failure is not None:
            return end.failure

        def refuse(finger: int, before: frozenset[int]) -> Failure | None:
            if before == moved and finger in refused:
                text = "it could not be lifted when it was tried"
                return Failure(kind="refused_before", text=text)
            return end.refuse(finger, before)

        found = find_order(end.begin, end.end, stroke.path.axis, refuse=refuse, moved=moved)
        return end.build(found, moved) if isinstance(found, Order) else found


def cut_motion(motion: MotionPlan, path_parameter: float) -> MotionPlan:
    """The part of a motion up to the knot nearest to a path parameter, at least to the second.

    Args:
        motion: The whole.
        path_parameter: Where on its path, 0 to 1.
    """
    at = np.array([knot.path_parameter for knot in motion.knots])
    last = max(1, int(np.abs(at - path_parameter).argmin()))
    return replace(motion, knots=motion.knots[: last + 1], path=motion.path.cut(float(at[last])))


def plan_back(motion: MotionPlan, path_parameter: float) -> tuple[Relocation, ...] | Failure:
    """Relocations of all fingers from a point of a motion back to its beginning; or why not.

    Args:
        motion: The motion.
        path_parameter: Where on its path it is now, 0 to 1; the nearest knot stands for it.
    """
    task = motion.grasp.task
    if len(task.fingers) - 1 < task.fingers_needed:
        n = len(task.fingers)
        text = f"{n} fingers are too few to lift one of them"
        return Failure(kind="too_few_fingers", text=text, numbers={"fingers": n})
    found = RegraspPlanner(task).relocations(cut_motion(motion, path_parameter))
    return found.failure if isinstance(found, NoOrder) else found


def plan_others(
    stroke: MotionPlan, moved: Collection[str], refused: Collection[str]
) -> tuple[Relocation, ...] | Failure:
    """Relocations of the remaining fingers in an order that avoids refused lifts; or why not.

    Args:
        stroke: The stroke.
        moved: Names of the fingers that have moved on already.
        refused: Names of the fingers that cannot be lifted next.
    """
    task = stroke.grasp.task
    numbers = [frozenset(map(task.finger_names.index, names)) for names in (moved, refused)]
    found = RegraspPlanner(task).relocations(stroke, moved=numbers[0], refused=numbers[1])
    return found.failure if isinstance(found, NoOrder) else found


@dataclass(frozen=True, kw_only=True)
class _Move:
    """A lift that holds: the swing, and the forces during and after it."""

    postures: FloatArray
    grip: float
    during: ContactSet
    after: ContactSet


class _End:
    """Hand and object at the end of a stroke."""

    def __init__(self, planner: RegraspPlanner, stroke: MotionPlan) -> None:
        """Compute the contacts where fingers stand and where they land."""
        self._planner, self._stroke = planner, stroke
        first, last = stroke.knots[0], stroke.knots[-1]
        self.T_world_object = last.T_world_object
        self._base = self.T_world_object.inverse() * stroke.T_world_base
        task = planner.lifted
        touches = pad_contacts(task, task.T_world_object * self._base, first.q)
        gaps = np.array([touch.pad_gap for touch in touches])
        worst = int(np.abs(gaps).argmax())
        self.failure: Failure | None = None
        if abs(gaps[worst]) > TOUCH_TOL:
            self.failure = Failure(
                kind="object_not_alike",
                text="the object does not look the same to the hand after a stroke: "
                f"{stroke.path} put the surface {1e3 * gaps[worst]:.1f} mm from where "
                f"{task.finger_names[worst]} would land",
                numbers={"gap": float(gaps[worst])},
            )
        self.begin = contacts_of(task, touches).transformed(
            self.T_world_object * task.T_world_object.inverse()
        )
        self.end = last.contacts
        self._moves: dict[tuple[int, frozenset[int]], _Move] = {}

    def posture(self, moved: frozenset[int]) -> FloatArray:
        """Joints (nq,) after some fingers have moved on; idle fingers go with the first to move."""
        first, last = self._stroke.knots[0].q, self._stroke.knots[-1].q
        q = (first if moved else last).copy()
        for i, finger in enumerate(self._planner.lifted.fingers):
            q[finger.q_index] = (first if i in moved else last)[finger.q_index]
        return q

    def refuse(self, finger: int, moved: frozenset[int]) -> Failure | None:
        """Why a finger cannot be lifted although the others close, None if it can."""
        planner, base = self._planner, self._stroke.T_world_base
        task = planner.lifted
        name = task.finger_names[finger]
        q, landed = self.posture(moved), self.posture(moved | {finger})
        rest = holding(self.begin, self.end, moved, finger)
        for grip in (task.grip_force, min(HOLDING_GRIP, task.grip_force)):
            during = plan_forces(
                planner.without[finger],
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
            return Failure(
                kind="no_forces_while_lifted",
                text=f"the others cannot bear the load: {during.reason}",
            )
        after = plan_forces(task, standing(self.begin, self.end, moved | {finger}), base, landed)
        if not after.found:
            return Failure(
                kind="no_forces_after_landing",
                text=f"with {name} landed there are no forces: {after.reason}",
            )
        postures = planner.paths.path(task.hand.fingers[name], self._base, q, landed)
        if isinstance(postures, Failure):
            return postures
        self._moves[finger, moved] = _Move(
            postures=postures, grip=grip, during=during.contacts, after=after.contacts
        )
        return None

    def build(self, order: Order, moved: frozenset[int]) -> tuple[Relocation, ...]:
        """The relocations of an order whose lifts hold, after some fingers have moved on."""
        out: list[Relocation] = []
        before = standing(self.begin, self.end, moved) if moved else self.end
        for lift in order.lifts:
            move = self._moves[lift.finger, lift.moved]
            out.append(
                Relocation(
                    cycle=0,
                    finger=self._planner.lifted.finger_names[lift.finger],
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
