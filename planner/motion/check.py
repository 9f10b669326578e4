"""The verdict on a motion: every knot by the true geometry, Pinocchio and coal, like a grasp.

The solver's knots are up to 30 degrees apart. Between them the object goes on along its path,
and the pads over its surface (``planner.motion.between``); these places count as knots too. The
first is judged as a grasp on the table with its way in, all by the same checks: touch, penetration,
couplings and limits, force closure with a margin, and forces that bear the weight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from planner.collision.pad_contact import PadTouch, pad_touches, touching_of
from planner.collision.world import Clearance, CollisionWorld
from planner.motion.between import lead
from planner.motion.path import ObjectPath
from planner.motion.plan import Knot
from planner.motion.rolling import slips
from planner.motion.solve import MotionCandidate
from planner.plan import GraspPlan, SolveRecord
from planner.quality import force_closure
from planner.spatial import SE3, FloatArray, rotation_angle
from planner.synthesis.unknowns import Unknowns
from planner.task import GraspTask
from planner.tolerances import CLOSURE_EDGES, CLOSURE_MARGIN
from planner.verification.geometry import contacts_of, verify
from planner.verification.grasp import judge_grasp, plan_forces
from planner.verification.projection import settle

__all__ = ["MotionJudge", "Place"]

SUBKNOTS = 3
"""Knots of a plan for every one of the solver: 10 degrees apart where those are 30."""

SLIP_TOL = 5e-4
"""How far (m) a pad may slide from knot to knot, as far as a pad may be off the
surface: the compliance of a grip takes it up."""

BETWEEN_TOL = 1e-3
"""Largest pad gap (m) half-way between knots, if joints move evenly: twice what counts as touching,
since a controller closes it."""

BETWEEN_PENETRATION = 1e-4
"""Depth (m) from which penetration counts there, where pads are off by as much."""

TURN_TOL = 1e-3
"""How far (rad) the object may be turned off its path: it is turned as asked, exactly."""

TUBE_TOL = 2e-4
"""How far (m) a knot may be outside the tube: the descent's accuracy."""


@dataclass(frozen=True, kw_only=True)
class Place:
    """A knot before it is judged.

    Attributes:
        place: Where on the path, 0 to 1.
        T_object_base: The base as the object sees it.
        q: Joints (nq,).
    """

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
        places = [replace(place, q=self._settled(place)) for place in places]
        T_world_base = self._task.T_world_object * places[0].T_object_base
        grasp = judge_grasp(self._task, T_world_base, places[0].q, record=record, world=self._world)
        if isinstance(grasp, str):
            return f"start: {grasp}"
        knots = self.knots(T_world_base, places, path, tube)
        return knots if isinstance(knots, str) else (grasp, knots)

    def knots(
        self,
        T_world_base: SE3,
        places: Sequence[Place],
        path: ObjectPath,
        tube: float,
        *,
        T_world_start: SE3 | None = None,
    ) -> tuple[Knot, ...] | str:
        """The knots of a motion if all of them hold; else why not.

        Args:
            T_world_base: Pose of the base.
            places: Where the object is, and the joints; from 0 to 1 in order.
            path: The path that they cover.
            tube: m.
            T_world_start: Pose of the object where the path begins; where the task has it if None.
        """
        start = self._task.T_world_object if T_world_start is None else T_world_start
        out: list[Knot] = []
        before: tuple[Place, list[PadTouch]] | None = None
        for place in places:
            touches = pad_touches(self._lifted, self._base(place), place.q)
            knot = self._knot(place, touches, T_world_base, path, tube, start, before)
            if isinstance(knot, str):
                return f"at {100 * place.place:.0f} % of the path: {knot}"
            out.append(knot)
            before = place, touches
        return tuple(out)

    def _places(self, candidate: MotionCandidate) -> list[Place]:
        """The solver's knots and those between them."""
        task = self._task
        u = Unknowns(n_joints=task.hand.nq, n_contacts=len(task.fingers))
        reference = SE3(candidate.reference, np.zeros(3))
        poses = [u.pose(x, reference) for x in candidate.grasps]
        lower, upper = task.hand.q_lower, task.hand.q_upper
        postures = [np.clip(u.q(x), lower, upper) for x in candidate.grasps]
        n = SUBKNOTS * (len(poses) - 1)
        out = [Place(place=0.0, T_object_base=poses[0], q=postures[0])]
        for k in range(len(poses) - 1):
            shares = np.linspace(0.0, 1.0, SUBKNOTS + 1)
            bases = [_between(poses[k], poses[k + 1], share) for share in shares]
            led = lead(self._lifted, bases, postures[k], postures[k + 1])
            out += [
                Place(place=(SUBKNOTS * k + i) / n, T_object_base=bases[i], q=led[i])
                for i in range(1, SUBKNOTS + 1)
            ]
        return out

    def _settled(self, place: Place) -> FloatArray:
        """Joints with the pads on the true surface."""
        return settle(self._lifted, self._base(place), place.q)

    def _base(self, place: Place) -> SE3:
        """Where the base is if the object is held where the task has it: one world for all."""
        return self._lifted.T_world_object * place.T_object_base

    def _knot(
        self,
        place: Place,
        touches: list[PadTouch],
        T_world_base: SE3,
        path: ObjectPath,
        tube: float,
        start: SE3,
        before: tuple[Place, list[PadTouch]] | None,
    ) -> Knot | str:
        """One knot if it holds, and if the way there from the one before does; else why not."""
        task = self._lifted
        verification = verify(self._free, self._base(place), place.q, touches)
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
        off, turned = _off_path(T_world_object, path.pose(start, place.place))
        if off > tube + TUBE_TOL:
            return f"the object is {1e3 * off:.1f} mm off its path (tube {1e3 * tube:.1f})"
        if turned > TURN_TOL:
            return f"the object is turned {np.rad2deg(turned):.1f} degrees off its path"
        slid, gap, within = np.zeros(len(touches)), 0.0, None
        if before is not None:
            slid = self._slips(before, (place, touches))
            gap, within = self._between(before[0], place)
        if slid.max() > SLIP_TOL:
            name = task.finger_names[int(slid.argmax())]
            return f"{name} slides by {1e3 * slid.max():.2f} mm (allowed {1e3 * SLIP_TOL:.1f})"
        if gap > BETWEEN_TOL:
            return (
                f"a pad is {1e3 * gap:.2f} mm off the surface half-way from the knot before "
                f"(allowed {1e3 * BETWEEN_TOL:.1f})"
            )
        if within is not None:
            return f"penetration half-way from the knot before, {within}"
        return Knot(
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

    def _slips(
        self, before: tuple[Place, list[PadTouch]], after: tuple[Place, list[PadTouch]]
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

    def _between(self, before: Place, after: Place) -> tuple[float, Clearance | None]:
        """Half-way between two knots: the largest pad gap, m, and what penetrates, if anything."""
        pose = _between(before.T_object_base, after.T_object_base, 0.5)
        middle = Place(place=0.5, T_object_base=pose, q=(before.q + after.q) / 2)
        base = self._base(middle)
        touches = pad_touches(self._lifted, base, middle.q)
        nearest = self._free.closest(base, middle.q, 1, touching=touching_of(self._lifted).names)
        within = [c for c in nearest if c.distance < -BETWEEN_PENETRATION]
        return max(abs(t.pad_gap) for t in touches), within[0] if within else None


def _off_path(T_world_object: SE3, wanted: SE3) -> tuple[float, float]:
    """How far the object is off its path, m and rad."""
    off = wanted.inverse() * T_world_object
    return float(np.linalg.norm(off.translation)), rotation_angle(off.rotation)


def _between(a: SE3, b: SE3, share: float) -> SE3:
    """Base in the object's frame while the object goes from one pose to another.

    Its origin goes on a line, and it turns about one axis.
    """
    old, new = a.inverse(), b.inverse()
    turn = pin.exp3(share * pin.log3(new.rotation @ old.rotation.T)) @ old.rotation
    shift = old.translation + share * (new.translation - old.translation)
    return SE3(turn, shift).inverse()
