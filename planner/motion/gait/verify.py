"""The verdict on a gait: relocations between strokes (``planner.motion.gait.regrasp``), and cycles.

Later strokes are verified like the first, with the object at its pose of that cycle. So are the
swings of the fingers, unless the object fills the same space again.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin

from planner.collision.pad_contact import pad_contacts
from planner.contacts import ContactSet
from planner.failure import Failure
from planner.motion.gait.order import NoOrder
from planner.motion.gait.plan import GaitPlan, Relocation, Stroke
from planner.motion.gait.regrasp import RegraspPlanner
from planner.motion.plan import Knot, MotionPlan
from planner.motion.verify import MotionVerifier, Waypoint
from planner.shapes import Shape
from planner.spatial import SE3
from planner.task import GraspTask
from planner.verification.geometry import contacts_of, verify_geometry

SAME_POINT, SAME_NORMAL = 1e-5, 1e-3
"""Largest difference of contacts (m) and normals (-) of a later stroke from the first that counts
as none: far below the tolerance of a contact."""


class GaitVerifier:
    """Verifies gaits of one task; the geometry is built once."""

    def __init__(self, task: GraspTask) -> None:
        """Prepare the geometry."""
        self._regrasp = RegraspPlanner(task)
        self._motion = MotionVerifier(task)

    def verify(self, stroke: MotionPlan, cycles: int) -> GaitPlan | Failure:
        """The gait that repeats a stroke, with the relocations between cycles; or why it fails.

        Args:
            stroke: The first stroke; it ends on its path.
            cycles: Number of strokes.
        """
        phases: list[Stroke | Relocation] = [Stroke(cycle=0, knots=stroke.knots)]
        first: tuple[Relocation, ...] = ()
        if cycles > 1:
            found = self._regrasp.relocations(stroke)
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
            phases += [_moved(r, stroke, cycle - 1) for r in first]
            phases.append(following)
        return GaitPlan(motion=stroke, cycles=cycles, phases=tuple(phases), record=stroke.record)

    def _verify_swings(
        self, relocations: tuple[Relocation, ...], stroke: MotionPlan, cycle: int
    ) -> Failure | None:
        """Why a swing after a later stroke fails, None if all are free."""
        task, paths = self._regrasp.lifted, self._regrasp.paths
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

    def _stroke(self, stroke: MotionPlan, cycle: int) -> Stroke | Failure:
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
        knots = self._motion.verify_knots(
            stroke.T_world_base,
            waypoints,
            stroke.path,
            stroke.path_tolerance,
            T_world_start=poses[0],
        )
        return knots if isinstance(knots, Failure) else Stroke(cycle=cycle, knots=knots)

    def _alike(self, knot: Knot, T_world_object: SE3, stroke: MotionPlan) -> Knot | None:
        """A knot of the first stroke with the object at another pose, if all contacts are the same.

        The same contacts in the world close as before and bear the weight with the same forces, and
        the pads slide as little as before. Clearances are computed again.
        """
        task = self._regrasp.lifted
        base = task.T_world_object * T_world_object.inverse() * stroke.T_world_base
        touches = pad_contacts(task, base, knot.q)
        contacts = contacts_of(task, touches).transformed(
            T_world_object * task.T_world_object.inverse()
        )
        apart = np.abs(contacts.positions - knot.contacts.positions).max()
        turned = np.abs(contacts.normals - knot.contacts.normals).max()
        if apart > SAME_POINT or turned > SAME_NORMAL:
            return None
        verification = verify_geometry(self._regrasp.paths.world, base, knot.q, touches)
        if not verification.ok:
            return None
        moved = T_world_object.translation - knot.T_world_object.translation
        return replace(
            knot,
            T_world_object=T_world_object,
            contacts=replace(knot.contacts, center=knot.contacts.center + moved),
            verification=verification,
        )


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


def _displaced(T_world_object: SE3, stroke: MotionPlan, cycle: int) -> SE3:
    """Pose of the object ``cycle`` strokes later, at the same path parameter."""
    path = stroke.path
    turn = pin.exp3(cycle * path.angle * path.axis)
    return SE3(turn @ T_world_object.rotation, T_world_object.translation + cycle * path.shift)


def _moved(relocation: Relocation, stroke: MotionPlan, cycle: int) -> Relocation:
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
