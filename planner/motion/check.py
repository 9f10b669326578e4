"""The verdict on a motion: every knot by the true geometry, Pinocchio and coal, like a grasp.

The solver's knots are some twenty degrees apart. Between them the object goes on along its path,
and the pads over its surface (``planner.motion.between``); these places count as knots too. The first
is judged as a grasp on the table with its way in, all by the same checks: touch, penetration,
couplings and limits, force closure with a margin, and forces that bear the weight.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from planner.collision import CollisionWorld
from planner.judge import judge_grasp, plan_forces
from planner.motion.between import lead
from planner.motion.path import ObjectPath
from planner.motion.plan import Knot
from planner.motion.rolling import slips
from planner.motion.solve import MotionCandidate
from planner.plan import GraspPlan, SolveRecord
from planner.quality import force_closure
from planner.spatial import SE3, FloatArray
from planner.synthesis.settle import settle
from planner.synthesis.touch import PadTouch, pad_touches
from planner.synthesis.unknowns import Unknowns
from planner.synthesis.verify import contacts_of, verify
from planner.task import GraspTask

__all__ = ["MotionJudge"]

CLOSURE_EDGES = 8
"""Sides of the friction pyramid with which closure is decided, as for a grasp."""

CLOSURE_MARGIN = 0.05
"""Least normalised min-weight (-) at every knot: contacts of a moving grasp are off by more than
those of one that rests."""

SUBKNOTS = 3
"""Knots of a plan for every one of the solver: 8 degrees apart where those are 24."""

SLIP_TOL = 3e-4
"""How far (m) a pad may slide from knot to knot: below what the compliance of a grip takes up."""

BETWEEN_TOL = 1e-3
"""Largest pad gap (m) half-way between knots, if joints move evenly: twice what counts as touching,
since a controller closes it."""

TUBE_TOL = 2e-4
"""How far (m) a knot may be outside the tube: the descent's accuracy."""


@dataclass(frozen=True)
class _Place:
    """A knot before it is judged, as the base is seen from the object."""

    place: float
    T_object_base: SE3
    q: FloatArray


class MotionJudge:
    """Judges motions of one task; its geometry is made once."""

    def __init__(self, task: GraspTask) -> None:
        """Prepare the geometry: as the task has it, and of hand and object alone."""
        self._task = task
        self._world = CollisionWorld(task)
        self._lifted = replace(task, table_height=None, obstacles=())
        self._free = CollisionWorld(self._lifted)

    def judge(
        self, candidate: MotionCandidate, path: ObjectPath, tube: float, record: SolveRecord
    ) -> tuple[GraspPlan, tuple[Knot, ...]] | str:
        """The grasp and the knots of a motion if all holds; else why not.

        Args:
            candidate: From the solver.
            path: The path that it covers.
            tube: m.
            record: Where the candidate comes from.
        """
        places = self._places(candidate)
        T_world_base = self._task.T_world_object * places[0].T_object_base
        q = self._settled(places[0])
        grasp = judge_grasp(self._task, T_world_base, q, record=record, world=self._world)
        if isinstance(grasp, str):
            return f"start: {grasp}"
        knots: list[Knot] = []
        before: tuple[_Place, list[PadTouch]] | None = None
        for place in places:
            at = replace(place, q=self._settled(place))
            found = self._knot(at, T_world_base, path, tube, before)
            if isinstance(found, str):
                return f"at {100 * place.place:.0f} % of the path: {found}"
            knot, touches = found
            knots.append(knot)
            before = at, touches
        return grasp, tuple(knots)

    def _places(self, candidate: MotionCandidate) -> list[_Place]:
        """The solver's knots and those between them."""
        task = self._task
        u = Unknowns(n_joints=task.hand.nq, n_contacts=len(task.fingers))
        reference = SE3(candidate.reference, np.zeros(3))
        poses = [u.pose(x, reference) for x in candidate.grasps]
        lower, upper = task.hand.q_lower, task.hand.q_upper
        postures = [np.clip(u.q(x), lower, upper) for x in candidate.grasps]
        n = SUBKNOTS * (len(poses) - 1)
        out = []
        for i in range(n + 1):
            k, rest = divmod(i, SUBKNOTS)
            if rest == 0:
                out.append(_Place(i / n, poses[k], postures[k]))
                continue
            share = rest / SUBKNOTS
            ends = poses[k], poses[k + 1]
            pose = _between(*ends, share)
            q = lead(self._lifted, ends, (postures[k], postures[k + 1]), pose, share)
            out.append(_Place(i / n, pose, q))
        return out

    def _settled(self, place: _Place) -> FloatArray:
        """Joints with the pads on the true surface."""
        return settle(self._lifted, self._base(place), place.q)

    def _base(self, place: _Place) -> SE3:
        """Where the base is if the object is held where the task has it, so that it can be asked
        of one world."""
        return self._lifted.T_world_object * place.T_object_base

    def _knot(
        self,
        place: _Place,
        T_world_base: SE3,
        path: ObjectPath,
        tube: float,
        before: tuple[_Place, list[PadTouch]] | None,
    ) -> tuple[Knot, list[PadTouch]] | str:
        base, task = self._base(place), self._lifted
        touches = pad_touches(task, base, place.q)
        verification = verify(self._free, base, place.q, touches)
        if not verification.ok:
            return f"true geometry: {'; '.join(verification.faults)}"
        T_world_object = T_world_base * place.T_object_base.inverse()
        contacts = contacts_of(task, touches).transformed(
            T_world_object * task.T_world_object.inverse()
        )
        closure = force_closure(contacts, edges=CLOSURE_EDGES)
        if not closure.closed:
            return f"no force closure: {closure.reason}"
        if closure.normalised_min_weight < CLOSURE_MARGIN:
            return (
                f"closure has a margin of {closure.normalised_min_weight:.3f} only "
                f"(at least {CLOSURE_MARGIN})"
            )
        forces = plan_forces(task, contacts, T_world_base, place.q)
        if not forces.found:
            return f"forces: with {task.grip_force:.3g} N per finger, {forces.reason}"
        aim = path.pose(task.T_world_object, place.place)
        off = float(np.linalg.norm(aim.translation - T_world_object.translation))
        if off > tube + TUBE_TOL:
            return f"the object is {1e3 * off:.1f} mm off its path (tube {1e3 * tube:.1f})"
        slid, gap = np.zeros(len(touches)), 0.0
        if before is not None:
            slid = self._slips(before, (place, touches))
            gap = self._between(before[0], place)
        if slid.max() > SLIP_TOL:
            name = task.finger_names[int(slid.argmax())]
            return f"{name} slides by {1e3 * slid.max():.2f} mm (allowed {1e3 * SLIP_TOL:.1f})"
        if gap > BETWEEN_TOL:
            return (
                f"a pad is {1e3 * gap:.2f} mm off the surface half-way from the knot before "
                f"(allowed {1e3 * BETWEEN_TOL:.1f})"
            )
        knot = Knot(
            place=place.place,
            T_world_object=T_world_object,
            q=place.q,
            contacts=forces.contacts,
            forces=forces,
            closure=closure,
            verification=verification,
            off_path=off,
            slips=slid,
            between=gap,
        )
        return knot, touches

    def _slips(
        self, before: tuple[_Place, list[PadTouch]], after: tuple[_Place, list[PadTouch]]
    ) -> FloatArray:
        """How far each pad slides from one knot to the next, m."""
        (old, old_touches), (new, new_touches) = before, after
        return slips(
            self._task.hand,
            self._task.fingers,
            (old.T_object_base, new.T_object_base),
            (old.q, new.q),
            (
                np.array([t.outward for t in old_touches]),
                np.array([t.outward for t in new_touches]),
            ),
        )

    def _between(self, before: _Place, after: _Place) -> float:
        """Largest pad gap half-way between two knots, m."""
        pose = _between(before.T_object_base, after.T_object_base, 0.5)
        middle = _Place(0.5, pose, (before.q + after.q) / 2)
        touches = pad_touches(self._lifted, self._base(middle), middle.q)
        return max(abs(t.pad_gap) for t in touches)


def _between(a: SE3, b: SE3, share: float) -> SE3:
    """Base in the object's frame while the object goes from one pose to another.

    Its origin goes on a line, and it turns about one axis.
    """
    old, new = a.inverse(), b.inverse()
    turn = pin.exp3(share * pin.log3(new.rotation @ old.rotation.T)) @ old.rotation
    shift = old.translation + share * (new.translation - old.translation)
    return SE3(turn, shift).inverse()
