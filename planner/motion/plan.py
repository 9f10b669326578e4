"""``MotionPlan``: a verified motion of an object in the hand, knot by knot, and what limits it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pinocchio as pin

from planner.attempt import SearchRecord
from planner.contacts import ContactSet
from planner.forces import ForceSolution
from planner.immutable import freeze
from planner.kinematics.state import HandState
from planner.motion.limits import Limit
from planner.motion.path import ObjectPath
from planner.motion.trajectory import JOINT_RATE, TURN_RATE, TrajectoryBuilder
from planner.plan import GraspPlan, JointTrajectory, Verification
from planner.quality import ClosureResult
from planner.showing import Shown, in_notebook
from planner.spatial import SE3, FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Knot:
    """The object in the hand at one point of its path, verified like a grasp.

    Attributes:
        path_parameter: Where on the path, 0 to 1.
        T_world_object: Pose of the object; the base stands where the grasp has it.
        q: Joints (nq,), pads just touching.
        contacts: Contacts with the true surface, world, with the planned forces.
        forces: The distribution that bears the object's weight here.
        closure: Force closure of the contacts.
        verification: Residuals on the true geometry.
        off_path: Distance of the object from its path, m.
        slips: Slip (n,), m, of each pad since the knot before: 0 if it rolls.
        between: Largest pad gap, m, half-way from the knot before, joints interpolated linearly.
    """

    path_parameter: float
    T_world_object: SE3
    q: FloatArray
    contacts: ContactSet
    forces: ForceSolution
    closure: ClosureResult
    verification: Verification
    off_path: float
    slips: FloatArray
    between: float

    def __post_init__(self) -> None:
        """Keep copies that nobody changes."""
        freeze(self, poses=("T_world_object",), arrays=("q", "slips"))

    @property
    def contacts_in_object(self) -> ContactSet:
        """The contacts in the object's frame."""
        return self.contacts.transformed(self.T_world_object.inverse())

    @property
    def clearance(self) -> float:
        """Smallest distance of geometries that must not touch, m."""
        return min((c.distance for c in self.verification.closest), default=np.inf)


@dataclass(frozen=True, kw_only=True)
class MotionRecord(SearchRecord):
    """Where a motion comes from.

    Attributes:
        iterations: Evaluations of the residuals in its attempt.
        worst: Largest weighted residual of a term in the verified candidate.
    """

    iterations: int
    worst: float


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionPlan(Shown):
    """A motion of the object in the hand; every knot passed the checks of a grasp.

    All poses are relative to the grasp on the table: execution lifts hand and object first, both by
    the same translation, which the plan leaves out.

    Attributes:
        grasp: The grasp with which it begins, with its approach, where the object is.
        path: The path of the object; shorter than requested if that was too long.
        knots: In order; the first is the grasp.
        path_tolerance: Largest distance of the object from the path, m.
        limits: What kept the path from being longer, if the longest path was requested.
        record: Where the motion comes from.
    """

    grasp: GraspPlan
    path: ObjectPath
    knots: tuple[Knot, ...]
    path_tolerance: float
    limits: tuple[Limit, ...]
    record: MotionRecord

    @property
    def T_world_base(self) -> SE3:
        """Pose of the hand's base, from the first knot to the last."""
        return self.grasp.T_world_base

    @property
    def margin(self) -> float:
        """Least normalised min-weight of closure (-) over all knots."""
        return min(k.closure.normalised_min_weight for k in self.knots)

    @property
    def clearance(self) -> float:
        """Smallest distance of geometries that must not touch, m, over all knots."""
        return min(k.clearance for k in self.knots)

    @property
    def joint_room(self) -> tuple[str, float, float]:
        """The finger joint nearest to a limit, how near (share of its range), and where."""
        hand = self.grasp.task.hand
        index = np.concatenate([f.q_index for f in self.grasp.task.fingers])
        lower, upper = hand.q_lower[index], hand.q_upper[index]
        q = np.array([k.q[index] for k in self.knots])
        room = np.minimum(q - lower, upper - q) / np.maximum(upper - lower, SMALLEST_RANGE)
        k, j = np.unravel_index(int(np.argmin(room)), room.shape)
        return hand.joint_names[index[j]], float(room[k, j]), self.knots[k].path_parameter

    @property
    def slipped(self) -> FloatArray:
        """Slip (n,), m, of each pad over the whole path: 0 if it only rolls."""
        return np.asarray(np.sum([k.slips for k in self.knots], axis=0))

    @property
    def pivoted(self) -> FloatArray:
        """Rotation (n,), rad, of each tip about its contact's normal over the whole path."""
        task, out = self.grasp.task, []
        for a, b in pairwise(self.knots):
            before, after = (
                (k.T_world_object.inverse() * self.T_world_base, HandState(task.hand, k.q))
                for k in (a, b)
            )
            normals = a.contacts_in_object.normals + b.contacts_in_object.normals
            for finger, normal in zip(task.fingers, normals, strict=True):
                old, new = (
                    base.rotation @ state.joint_pose(finger.pad.joint_id).rotation
                    for base, state in (before, after)
                )
                out.append(abs(pin.log3(new @ old.T) @ normal) / np.linalg.norm(normal))
        return np.asarray(np.reshape(out, (-1, len(task.fingers))).sum(axis=0))

    def at(self, path_parameter: float) -> tuple[SE3, FloatArray]:
        """Pose of the object and joints (nq,) at a path parameter, 0 to 1, between knots.

        The object is interpolated along its screw, the joints linearly.
        """
        at = np.array([k.path_parameter for k in self.knots])
        i = int(np.clip(np.searchsorted(at, path_parameter, side="right") - 1, 0, len(at) - 2))
        part = float(np.clip((path_parameter - at[i]) / (at[i + 1] - at[i]), 0.0, 1.0))
        a, b = self.knots[i], self.knots[i + 1]
        return SE3.Interpolate(a.T_world_object, b.T_world_object, part), a.q + part * (b.q - a.q)

    def joint_trajectory(
        self,
        *,
        approach_s: float = 1.5,
        close_s: float = 1.0,
        joint_rate: float = JOINT_RATE,
        turn_rate: float = TURN_RATE,
        rate_hz: float = 50.0,
    ) -> JointTrajectory:
        """Approach, closing and the motion as joint positions by name, for a real hand.

        Squeeze and lift are not part of it. Joints pass through the knots without overshoot.

        Args:
            approach_s: As for ``GraspPlan.joint_trajectory``.
            close_s: As there.
            joint_rate: Largest rate of a joint in the motion, rad/s or m/s.
            turn_rate: Largest rate of the object's turn, rad/s.
            rate_hz: Samples per second.

        Raises:
            TaskError: A duration or a rate that is not positive.
        """
        builder = TrajectoryBuilder(
            self.grasp,
            approach_s=approach_s,
            close_s=close_s,
            joint_rate=joint_rate,
            turn_rate=turn_rate,
            rate_hz=rate_hz,
        )
        self.add_to(builder, "turn")
        return builder.built()

    def add_to(self, builder: TrajectoryBuilder, phase: str, until: float = 1.0) -> None:
        """Append the motion up to a path parameter in (0, 1] to a trajectory."""
        before = [k.path_parameter for k in self.knots if k.path_parameter < until]
        parameters = np.array([*before, until])
        postures = np.array([self.at(s)[1] for s in parameters])
        builder.turn(phase, postures, parameters, until * self.path.angle)

    def __repr__(self) -> str:
        """One line."""
        return f"<MotionPlan of {self.grasp.task!r}: {self.path}>"

    def _repr_html_(self) -> str:
        """What a notebook shows of it: a table and a picture, made once."""
        return in_notebook(self)

    def __str__(self) -> str:
        """The path, the margins, and the limits."""
        joint, room, where = self.joint_room
        task = self.grasp.task
        lines = [
            f"{task.hand.name} ({', '.join(task.finger_names)}), {task.object.shape.spec}: "
            f"{self.path}",
            f"  {len(self.knots)} knots, off the path by up to "
            f"{1e3 * max(k.off_path for k in self.knots):.1f} mm "
            f"(tolerance {1e3 * self.path_tolerance:.1f})",
            f"  closure: least normalised min-weight {self.margin:.3f}",
            f"  clearance: least {1e3 * self.clearance:.2f} mm",
            f"  joints: {joint} comes within {100 * room:.1f} % of its range of an end, at "
            f"{100 * where:.0f} % of the path",
            "  pads slide by "
            + ", ".join(
                f"{name} {1e3 * s:.2f}"
                for name, s in zip(task.finger_names, self.slipped, strict=True)
            )
            + " mm in all",
        ]
        if self.limits:
            lines.append("  longer if these gave way:")
            lines += [f"    {limit}" for limit in self.limits]
        return "\n".join(lines)


SMALLEST_RANGE = 1e-3
"""Least range (rad or m) of a joint by which distances are divided."""
