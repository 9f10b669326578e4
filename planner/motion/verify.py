"""The verdict on a movement: every knot on the true geometry, by Pinocchio and coal, like a grasp.

The solver's knots are up to 30 degrees apart. Between them the object continues along its path and
the pads roll over its surface (``planner.motion.trajectory``); these waypoints become knots too.
The first knot is verified as a grasp on the table with its approach. All knots pass the same
checks: contact, penetration, couplings and limits, force closure with a margin, forces that bear
the weight, and such that produce each wrench that the task needs, on the object as it is there.
During relocations no needed wrench is produced.

Where the stroke is repeated, relocations come between (``planner.motion.regrasp``). Later strokes
are verified like the first, with the object at its pose of that cycle. So are the swings of the
fingers, unless the object fills the same space again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from planner.collision.pad_contact import PadContact, pad_contact_queries, pad_contacts
from planner.collision.world import Clearance, CollisionWorld
from planner.contacts import ContactSet
from planner.failure import Failure
from planner.forces import ForceSolution
from planner.motion.order import NoOrder
from planner.motion.path import ObjectPath
from planner.motion.phase import Knot, Relocation, Stroke
from planner.motion.plan import MovementPlan
from planner.motion.regrasp import RegraspPlanner
from planner.motion.solve import MotionCandidate
from planner.motion.terms import slips
from planner.motion.trajectory import interpolate_rolling
from planner.plan import GraspPlan, SolveRecord
from planner.quality import ClosureResult, force_closure
from planner.shapes import Shape
from planner.spatial import SE3, FloatArray, rotation_angle
from planner.synthesis.symbols import Unknowns
from planner.task import GraspTask
from planner.tolerances import CLOSURE_EDGES, CLOSURE_MARGIN
from planner.verification import (
    contacts_of,
    needed_forces,
    no_closure,
    no_forces,
    no_needed,
    plan_forces,
    project_onto_surface,
    verify_geometry,
    verify_grasp,
)

SUBKNOTS = 3
"""Knots of the plan per interval of the solver: 10 degrees apart where the solver's are 30."""

SLIP_TOL = 5e-4
"""Largest slip (m) of a pad from knot to knot: as large as the largest pad gap, since the
compliance of the grip takes it up."""

BETWEEN_TOL = 1e-3
"""Largest pad gap (m) half-way between knots with joints interpolated linearly: twice the gap of a
contact, since a controller closes it."""

BETWEEN_PENETRATION = 1e-4
"""Penetration (m) allowed half-way between knots."""

TURN_TOL = 1e-3
"""Largest rotation (rad) of the object off its path; the path tolerance is for positions."""

SAME_POINT, SAME_NORMAL = 1e-5, 1e-3
"""Largest difference of contacts (m) and normals (-) of a later stroke from the first that counts
as none: far below the tolerance of a contact."""

SAME_LOAD = 1e-9
"""Largest difference (N, N m) of needed wrenches of a later stroke from the first that counts as
none."""

PATH_SLACK = 2e-4
"""Excess (m) over the path tolerance that a knot may have: the solver's accuracy."""


@dataclass(frozen=True, kw_only=True)
class Waypoint:
    """A knot before it is verified.

    Attributes:
        path_parameter: Where on the path, 0 to 1.
        T_object_base: Pose of the base in the object's frame.
        q: Joints (nq,).
    """

    path_parameter: float
    T_object_base: SE3
    q: FloatArray


class MovementVerifier:
    """Verifies movements of one task; the geometry is built once."""

    def __init__(self, task: GraspTask) -> None:
        """Build two worlds: that of the task, and hand and object alone."""
        self._task = task
        self._world = CollisionWorld(task)
        self._lifted = replace(task, table_height=None, obstacles=())
        self._free = CollisionWorld(self._lifted)
        self._planners: dict[bytes, RegraspPlanner] = {}

    def _regrasp(self, path: ObjectPath) -> RegraspPlanner:
        """Plans relocations in the attitude of a path; made where a movement has any."""
        key = path.attitude.tobytes()
        if key not in self._planners:
            self._planners[key] = RegraspPlanner(path.borne(self._task))
        return self._planners[key]

    def verify(
        self,
        candidate: MotionCandidate,
        path: ObjectPath,
        path_tolerance: float,
        record: SolveRecord,
    ) -> tuple[GraspPlan, tuple[Knot, ...]] | Failure:
        """The grasp and the knots of a motion; or why one of them fails.

        Args:
            candidate: From the solver.
            path: The path that the candidate covers.
            path_tolerance: How far the object may be off its path, m.
            record: Where the candidate comes from.
        """
        waypoints = [self._projected(waypoint) for waypoint in self._waypoints(candidate)]
        T_world_base = self._task.T_world_object * waypoints[0].T_object_base
        grasp = verify_grasp(
            self._task, T_world_base, waypoints[0].q, record=record, world=self._world
        )
        if isinstance(grasp, Failure):
            return grasp.at("start")
        knots = self.verify_knots(T_world_base, waypoints, path, path_tolerance)
        return knots if isinstance(knots, Failure) else (grasp, knots)

    def verify_held(
        self, T_world_base: SE3, q: FloatArray, path: ObjectPath, record: SolveRecord
    ) -> tuple[GraspPlan, tuple[Knot, ...]] | Failure:
        """The grasp and the knots of an object that stays in the fingers while the wrist turns.

        Args:
            T_world_base: Pose of the base at the grasp.
            q: Joints (nq,).
            path: A path that stays.
            record: Where the grasp comes from.
        """
        grasp = verify_grasp(self._task, T_world_base, q, record=record, world=self._world)
        if isinstance(grasp, Failure):
            return grasp
        knots = self.held(T_world_base, q, path)
        return knots if isinstance(knots, Failure) else (grasp, knots)

    def held(
        self, T_world_base: SE3, q: FloatArray, path: ObjectPath
    ) -> tuple[Knot, ...] | Failure:
        """The knots of an object that stays in the fingers of a grasp; see ``verify_held``."""
        T_object_base = self._task.T_world_object.inverse() * T_world_base
        ends = [Waypoint(path_parameter=s, T_object_base=T_object_base, q=q) for s in (0.0, 1.0)]
        return self.verify_knots(T_world_base, ends, path, 0.0)

    def verify_knots(
        self,
        T_world_base: SE3,
        waypoints: Sequence[Waypoint],
        path: ObjectPath,
        path_tolerance: float,
        *,
        T_world_start: SE3 | None = None,
    ) -> tuple[Knot, ...] | Failure:
        """The knots of a motion; or why one of them fails.

        Args:
            T_world_base: Pose of the base.
            waypoints: Poses and joints, path parameters from 0 to 1 in order.
            path: The path that the waypoints cover.
            path_tolerance: How far the object may be off its path, m.
            T_world_start: Pose of the object where the path begins; where the task has it if None.
        """
        start = self._task.T_world_object if T_world_start is None else T_world_start
        bearing = [path.borne(self._lifted, share) for share in path.wrist_shares[::-1]]
        out: list[Knot] = []
        before: tuple[Waypoint, list[PadContact]] | None = None
        for waypoint in waypoints:
            touches = pad_contacts(self._lifted, self._base(waypoint), waypoint.q)
            wanted = path.pose(start, waypoint.path_parameter)
            knot = self._knot(
                waypoint, touches, T_world_base, wanted, path_tolerance, before, bearing
            )
            if isinstance(knot, Failure):
                return knot.at(f"at {100 * waypoint.path_parameter:.0f} % of the path")
            out.append(knot)
            before = waypoint, touches
        return tuple(out)

    def _waypoints(self, candidate: MotionCandidate) -> list[Waypoint]:
        """The solver's knots and those between them."""
        task = self._task
        u = Unknowns(n_joints=task.hand.nq, n_contacts=len(task.fingers))
        reference = SE3(candidate.reference, np.zeros(3))
        poses = [u.pose(x, reference) for x in candidate.grasps]
        lower, upper = task.hand.q_lower, task.hand.q_upper
        postures = [np.clip(u.q(x), lower, upper) for x in candidate.grasps]
        n = SUBKNOTS * (len(poses) - 1)
        out = [Waypoint(path_parameter=0.0, T_object_base=poses[0], q=postures[0])]
        for k in range(len(poses) - 1):
            parts = np.linspace(0.0, 1.0, SUBKNOTS + 1)
            bases = [_between(poses[k], poses[k + 1], part) for part in parts]
            between = interpolate_rolling(self._lifted, bases, postures[k], postures[k + 1])
            out += [
                Waypoint(
                    path_parameter=(SUBKNOTS * k + i) / n, T_object_base=bases[i], q=between[i]
                )
                for i in range(1, SUBKNOTS + 1)
            ]
        return out

    def _projected(self, waypoint: Waypoint) -> Waypoint:
        """The waypoint with the pads on the true surface."""
        q = project_onto_surface(self._lifted, self._base(waypoint), waypoint.q)
        return replace(waypoint, q=q)

    def _base(self, waypoint: Waypoint) -> SE3:
        """Pose of the base with the object where the task has it, so that one world serves all."""
        return self._lifted.T_world_object * waypoint.T_object_base

    def _knot(
        self,
        waypoint: Waypoint,
        touches: list[PadContact],
        T_world_base: SE3,
        wanted: SE3,
        path_tolerance: float,
        before: tuple[Waypoint, list[PadContact]] | None,
        bearing: Sequence[GraspTask],
    ) -> Knot | Failure:
        """One knot; or why it, or the interval from the knot before, fails.

        ``bearing`` is the task with gravity as it is in the attitude, and on the way back from it.
        """
        task = self._lifted
        verification = verify_geometry(
            self._free, self._base(waypoint), waypoint.q, touches, object_moved=True
        )
        if verification.failure is not None:
            return verification.failure
        T_world_object = T_world_base * waypoint.T_object_base.inverse()
        contacts = contacts_of(task, touches).transformed(
            T_world_object * task.T_world_object.inverse()
        )
        closure = force_closure(contacts, edges=CLOSURE_EDGES)
        unclosed = _verify_closure(closure)
        if unclosed is not None:
            return unclosed
        borne = [plan_forces(one, contacts, T_world_base, waypoint.q) for one in bearing]
        for share, forces in zip(np.linspace(1.0, 0.0, len(borne)), borne, strict=True):
            if not forces.found or (len(borne) > 1 and pressed(forces) > MOST_PRESS):
                return _falls(task, forces, share, borne)
        needed: tuple[ForceSolution, ...] = ()
        if task.needed:  # on the object as it is turned here
            turned_task = replace(task, T_world_object=T_world_object)
            needed = needed_forces(turned_task, contacts, T_world_base, waypoint.q)
            for one, found in zip(task.needed, needed, strict=True):
                if not found.found:
                    return no_needed(task, one, found)
        off, turned = _off_path(T_world_object, wanted)
        slid, gap, within = np.zeros(len(touches)), 0.0, None
        if before is not None:
            slid = self._slips(before, (waypoint, touches))
            gap, within = self._between(before[0], waypoint)
        failure = (
            _verify_path(off, turned, path_tolerance)
            or _verify_slips(slid, task.finger_names)
            or _verify_between(gap, within)
        )
        if failure is not None:
            return failure
        return Knot(
            path_parameter=waypoint.path_parameter,
            T_world_object=T_world_object,
            q=waypoint.q,
            contacts=borne[0].contacts,
            forces=borne[0],
            on_the_way=tuple(borne[1:]),
            needed=needed,
            closure=closure,
            verification=verification,
            off_path=off,
            slips=slid,
            between=gap,
        )

    def _slips(
        self, before: tuple[Waypoint, list[PadContact]], after: tuple[Waypoint, list[PadContact]]
    ) -> FloatArray:
        """Slip (n,), m, of each pad from one knot to the next."""
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

    def _between(self, before: Waypoint, after: Waypoint) -> tuple[float, Clearance | None]:
        """Half-way between two knots: the largest pad gap, m, and a penetrating pair, if any."""
        pose = _between(before.T_object_base, after.T_object_base, 0.5)
        middle = Waypoint(path_parameter=0.5, T_object_base=pose, q=(before.q + after.q) / 2)
        base = self._base(middle)
        touches = pad_contacts(self._lifted, base, middle.q)
        nearest = self._free.closest(
            base, middle.q, 1, may_touch=pad_contact_queries(self._lifted).names
        )
        within = [c for c in nearest if c.distance < -BETWEEN_PENETRATION]
        return max(abs(t.pad_gap) for t in touches), within[0] if within else None

    def repeated(self, stroke: MovementPlan, cycles: int) -> MovementPlan | Failure:
        """The movement that repeats a stroke, with relocations between cycles; or why it fails.

        Args:
            stroke: The first stroke; it ends on its path.
            cycles: Number of strokes.
        """
        phases: list[Stroke | Relocation] = [Stroke(cycle=0, knots=stroke.knots)]
        first: tuple[Relocation, ...] = ()
        if cycles > 1:
            found = self._regrasp(stroke.path).relocations(stroke)
            if isinstance(found, NoOrder):
                return found.failure
            if isinstance(found, Failure):
                return found
            first = found
        for cycle in range(1, cycles):
            failure = self._verify_swings(first, stroke, cycle - 1)
            following = failure or self._stroke(stroke, cycle)
            if isinstance(following, Failure):
                return following.at(f"cycle {cycle + 1}")
            phases += [_displaced_relocation(r, stroke, cycle - 1) for r in first]
            phases.append(following)
        path = stroke.path
        return replace(
            stroke, phases=tuple(phases), angle=cycles * path.angle, shift=cycles * path.shift
        )

    def _verify_swings(
        self, relocations: tuple[Relocation, ...], stroke: MovementPlan, cycle: int
    ) -> Failure | None:
        """Why a swing after a later stroke fails, None if all are free."""
        planner = self._regrasp(stroke.path)
        task, paths = planner.lifted, planner.paths
        first = stroke.knots[-1].T_world_object
        if same_space(task.object.shape, first, _displaced(first, stroke, cycle)):
            return None  # nothing differs
        for relocation in relocations:
            finger = task.hand.fingers[relocation.finger]
            pose = _displaced(relocation.T_world_object, stroke, cycle)
            base = pose.inverse() * stroke.T_world_base
            failure = paths.verify(finger, base, relocation.postures)
            if failure is not None:
                return failure
        return None

    def _stroke(self, stroke: MovementPlan, cycle: int) -> Stroke | Failure:
        """A later stroke, verified with the object at its pose of that cycle; or why it fails."""
        poses = [_displaced(knot.T_world_object, stroke, cycle) for knot in stroke.knots]
        alike = [
            self._alike(knot, pose, stroke) for knot, pose in zip(stroke.knots, poses, strict=True)
        ]
        same = [knot for knot in alike if knot is not None]
        if len(same) == len(alike):
            return Stroke(cycle=cycle, knots=tuple(same))
        waypoints = [
            Waypoint(
                path_parameter=knot.path_parameter,
                T_object_base=pose.inverse() * stroke.T_world_base,
                q=knot.q,
            )
            for knot, pose in zip(stroke.knots, poses, strict=True)
        ]
        knots = self.verify_knots(
            stroke.T_world_base,
            waypoints,
            stroke.path,
            stroke.path_tolerance,
            T_world_start=poses[0],
        )
        return knots if isinstance(knots, Failure) else Stroke(cycle=cycle, knots=knots)

    def _alike(self, knot: Knot, T_world_object: SE3, stroke: MovementPlan) -> Knot | None:
        """A knot of the first stroke with the object at another pose, if all contacts are the same.

        The same contacts in the world close as before and bear the weight with the same forces, and
        the pads slide as little as before. Clearances are computed again.
        """
        planner = self._regrasp(stroke.path)
        task = planner.lifted
        base = task.T_world_object * T_world_object.inverse() * stroke.T_world_base
        touches = pad_contacts(task, base, knot.q)
        contacts = contacts_of(task, touches).transformed(
            T_world_object * task.T_world_object.inverse()
        )
        if task.needed and not self._needs_alike(task, knot.T_world_object, T_world_object):
            return None
        apart = np.abs(contacts.positions - knot.contacts.positions).max()
        turned = np.abs(contacts.normals - knot.contacts.normals).max()
        if apart > SAME_POINT or turned > SAME_NORMAL:
            return None
        verification = verify_geometry(planner.paths.world, base, knot.q, touches)
        if not verification.ok:
            return None
        moved = T_world_object.translation - knot.T_world_object.translation
        return replace(
            knot,
            T_world_object=T_world_object,
            contacts=replace(knot.contacts, center=knot.contacts.center + moved),
            verification=verification,
        )

    @staticmethod
    def _needs_alike(task: GraspTask, one: SE3, other: SE3) -> bool:
        """Whether needed wrenches are the same, world, with the object at two poses."""
        loads = [
            np.array([replace(task, T_world_object=pose).needed_load(w) for w in task.needed])
            for pose in (one, other)
        ]
        return bool(np.abs(loads[0] - loads[1]).max() < SAME_LOAD)


def _falls(
    task: GraspTask, forces: ForceSolution, share: float, borne: Sequence[ForceSolution]
) -> Failure:
    """The failure of contacts that cannot bear the weight at a share of the way to the attitude."""
    failure = no_forces(task, forces)
    if forces.found:
        text = (
            f"forces: a finger has to press with {pressed(forces):.1f} N (at most {MOST_PRESS:g})"
        )
        failure = replace(failure, text=text)
    if len(borne) == 1 or not borne[-1].found:
        return failure
    if share == 0.0:  # as it was grasped: no attitude is to blame
        return replace(failure, kind=PRESSES).at("held with the palm down")
    where = "in the attitude" if share == 1.0 else f"{100 * share:.0f} % of the way to the attitude"
    failure = failure.at(f"held with the palm down, but {where}")
    return replace(failure, kind=FALLS, numbers={**failure.numbers, "share": share})


def pressed(forces: ForceSolution) -> float:
    """Largest normal force, N."""
    return float(forces.contacts.forces[:, 0].max())


LEAST_FORCE_LIMIT, ASKED_SHARE = 18.0, 2.0 / 3.0
"""Normal force (N) with which a finger may press in any manipulation, by the verdict; and the share
(-) of what it may that the closed loop asks for at most (its cap): springs and movement add to the
measured force, most where the object comes down on the table."""

MOST_PRESS = ASKED_SHARE * LEAST_FORCE_LIMIT
"""Largest planned normal force (N) of a finger in an attitude and on the way there: the loop's cap
of any plan. Of one that presses as hard the cap is a quarter higher, which is the margin by design:
at 13 to 15 N a Shadow-type hand used it up with the palm up."""

PRESSES = "presses_too_hard"
"""Kind of a failure of a grasp that has to press more than ``MOST_PRESS`` palm down."""

FALLS = "falls_in_attitude"
"""Kind of a failure of a grasp that bears the weight palm down, but not in the attitude."""


def _verify_closure(closure: ClosureResult) -> Failure | None:
    """Why contacts do not close with a margin, None if they do."""
    if not closure.closed:
        return no_closure(closure)
    margin = closure.normalised_min_weight
    if margin < CLOSURE_MARGIN:
        return Failure(
            kind="closure_margin",
            text=f"closure has a margin of {margin:.3f} only (at least {CLOSURE_MARGIN})",
            numbers={"normalised_min_weight": margin},
        )
    return None


def _verify_path(off: float, turned: float, path_tolerance: float) -> Failure | None:
    """Why the object is off its path, by its distance (m) and rotation (rad); None if it is not."""
    if off > path_tolerance + PATH_SLACK:
        return Failure(
            kind="off_path",
            text=f"the object is {1e3 * off:.1f} mm off its path "
            f"(tolerance {1e3 * path_tolerance:.1f})",
            numbers={"distance": off},
        )
    if turned > TURN_TOL:
        return Failure(
            kind="turned_off_path",
            text=f"the object is turned {np.rad2deg(turned):.1f} degrees off its path",
            numbers={"angle": turned},
        )
    return None


def _verify_slips(slid: FloatArray, fingers: Sequence[str]) -> Failure | None:
    """Which pad slides too far from knot to knot, by the slips (n,), m; None if none does."""
    worst = int(slid.argmax())
    if slid[worst] <= SLIP_TOL:
        return None
    return Failure(
        kind="slip",
        text=f"{fingers[worst]} slides by {1e3 * slid[worst]:.2f} mm "
        f"(allowed {1e3 * SLIP_TOL:.1f})",
        numbers={"slip": float(slid[worst])},
    )


def _verify_between(gap: float, within: Clearance | None) -> Failure | None:
    """Why pads (gap in m) or links fail half-way from the knot before, None if they do not."""
    if gap > BETWEEN_TOL:
        return Failure(
            kind="gap_between_knots",
            text=f"a pad is {1e3 * gap:.2f} mm off the surface half-way from the knot before "
            f"(allowed {1e3 * BETWEEN_TOL:.1f})",
            numbers={"gap": gap},
        )
    if within is not None:
        return Failure(
            kind="penetration_between_knots",
            text=f"penetration half-way from the knot before, {within}",
            numbers={"distance": within.distance},
        )
    return None


def _off_path(T_world_object: SE3, wanted: SE3) -> tuple[float, float]:
    """Distance (m) and rotation (rad) of the object off its path."""
    off = wanted.inverse() * T_world_object
    return float(np.linalg.norm(off.translation)), rotation_angle(off.rotation)


def _between(a: SE3, b: SE3, part: float) -> SE3:
    """Pose of the base in the object's frame, interpolated between two.

    The object's origin moves on a line, and the object turns about one axis.
    """
    old, new = a.inverse(), b.inverse()
    turn = pin.exp3(part * pin.log3(new.rotation @ old.rotation.T)) @ old.rotation
    shift = old.translation + part * (new.translation - old.translation)
    return SE3(turn, shift).inverse()


SAMPLES, AROUND, SAME_SPACE = 500, 1.2, 1e-7
"""Points at which the distances from an object in two poses are compared, the half-width of the
cube that they fill, in bounding radii, and the difference (m) that counts as none."""


def same_space(shape: Shape, one: SE3, other: SE3) -> bool:
    """Whether points around an object are equally far from it in both poses.

    Args:
        shape: The object's.
        one: Pose of the object, world.
        other: The other pose.
    """
    points = np.random.default_rng(0).uniform(-1.0, 1.0, size=(SAMPLES, 3))
    points = one.translation + AROUND * shape.bounding_radius * points
    seen = [
        shape.signed_distance((points - pose.translation) @ pose.rotation) for pose in (one, other)
    ]
    return bool(np.abs(seen[0] - seen[1]).max() < SAME_SPACE)


def _displaced(T_world_object: SE3, stroke: MovementPlan, cycle: int) -> SE3:
    """Pose of the object ``cycle`` strokes later, at the same path parameter."""
    path = stroke.path
    turn = pin.exp3(cycle * path.angle * path.axis)
    return SE3(turn @ T_world_object.rotation, T_world_object.translation + cycle * path.shift)


def _displaced_relocation(relocation: Relocation, stroke: MovementPlan, cycle: int) -> Relocation:
    """The same relocation ``cycle`` strokes later; hand, contacts and forces stay in the world."""
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
