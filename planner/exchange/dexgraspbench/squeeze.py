"""Squeeze pose for DexGraspBench: how far beyond the grasp its servos are commanded.

The benchmark commands one posture and holds it throughout: its servos are springs about that
posture. So the forces on the object change by stiffness times displacement, and the squeeze must be
large enough that after every change that the protocol brings, each contact still holds:

    f_i = s f0_i - K_i G_i^T d(load) -+ e_i,     |tangential| <= mu normal,     for all loads,

where f0 are the planned forces that press without a load (they balance, so s f0 does too), K_i the
stiffness of finger i at its contact through its servos, d = (sum G_j K_j G_j^T)^-1 load the
movement of the object under the load, and e_i what the misplaced contacts change: they are not
where the plan has them, by ``MISPLACED``. The squeeze is the least s >= 1 that does it, as far as
the actuators reach.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import eigh

from planner.contacts import ContactSet
from planner.errors import PlannerError
from planner.forces import ForceSolution
from planner.hands.hand import Hand
from planner.spatial import SE3, FloatArray, skew
from planner.task import GraspTask
from planner.verification.grasp import force_arguments, plan_forces

__all__ = [
    "FRICTION",
    "LOADS",
    "MASS",
    "MISPLACED",
    "PUSH",
    "STABLE",
    "Squeeze",
    "plan_squeeze",
    "without_servos",
]

MASS = 0.1
"""Of every object in the benchmark, kg (``config/task/eval.yaml``)."""

PUSH = 10.0
"""Force over mass that stands for gravity, m/s2, in all six directions (``fc_mocap.py``)."""

JERK = 25.0
"""Acceleration (m/s2) of a lift in the benchmark: the hand's target jumps by 10 mm, and the weld
that draws it there has the time constant 20 ms: 10 mm / (20 ms)^2 (``tabletop_mocap.py``)."""

LOADS = np.vstack(
    [
        PUSH * MASS * np.vstack([np.eye(3), -np.eye(3)]),
        (PUSH + JERK) * MASS * np.array([[0.0, 0.0, -1.0]]),
    ]
)
"""Forces (7, 3), N, in world axes, on the object's centre of mass."""

FRICTION = 0.6
"""Friction coefficient of the benchmark (-) (``config/task/eval.yaml``)."""

FRICTION_SHARES = (0.3, 0.5, 0.8)
"""Shares of the planned friction coefficient (-) with which pressing forces are tried: with little
friction in use, more is left to the loads, but balanced forces may be very unequal. The set whose
wanted squeeze is farthest from buckling is taken."""

STABLE = 1.0 / 3.0
"""Share of the force at which a grasp buckles that a squeeze may use (-): tips roll and slide,
which the stiffness leaves out. A larger share loses grasps in the benchmark
(``opposable bench dexgraspbench``)."""

MISPLACED = 0.001
"""Distance (m) between a contact and its plan: the servos lag by different times, so that the first
finger to touch pushes the object before the last one does."""

SOFTEST = 0.001
"""Stiffness (N m/rad) of a joint without a servo, which keeps matrices invertible."""

STIFFEST_SHARE = 0.01
"""Compliance of a tip where no joint moves it, as share of the mean (-): the links are stiff, and
contact and weld give way by about this much."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Squeeze:
    """A squeeze, or the reason why there is none.

    Attributes:
        reason: Why not; "" if there is one.
        ctrl: Commands (nu,) of the actuators; empty without one.
        factor: Planned forces are multiplied by this (-); NaN without one.
        wanted: What the loads ask for (-); above ``factor`` where the grasp would buckle.
        forces: Normal forces (n,) at the grasp, N, but for what actuators that stand at their limit
            lack; empty without one.
    """

    reason: str = ""
    ctrl: FloatArray
    factor: float
    wanted: float
    forces: FloatArray

    def posture(self, task: GraspTask, q: FloatArray) -> FloatArray:
        """Joints (nq,) whose lengths R q are the commands, the nearest to q (nq,).

        The benchmark sends R q to the actuators. Joints without an actuator stay.

        Raises:
            PlannerError: There is no squeeze.
        """
        if self.reason:
            raise PlannerError(f"no squeeze: {self.reason}; leave the grasp out")
        moment = task.hand.actuation.moment
        out: FloatArray = q + np.linalg.pinv(moment) @ (self.ctrl - moment @ q)
        return out


def without_servos(hand: Hand) -> str:
    """Why a hand cannot be commanded by postures; "" if it can."""
    actuation = hand.actuation
    motors = [n for n, b in zip(actuation.names, actuation.bias, strict=True) if b[1] >= 0]
    if not motors:
        return ""
    return f"{', '.join(motors)} of {hand.name} are no position servos"


def plan_squeeze(
    task: GraspTask, contacts: ContactSet, T_world_base: SE3, q: FloatArray
) -> Squeeze:
    """The squeeze of a grasp.

    Args:
        task: Gives grip, friction and hand; its gravity and mass do not count.
        contacts: One contact per finger of the task, world.
        T_world_base: Base pose.
        q: Joints (nq,).
    """
    floating = replace(task, gravity=np.zeros(3))
    jacobians = np.asarray(force_arguments(floating, contacts, T_world_base, q)["jacobians"])
    stiffness = _stiffness(task, jacobians)
    best: tuple[float, float, ForceSolution] | None = None
    for share in FRICTION_SHARES:
        forces = plan_forces(floating, contacts, T_world_base, q, friction_scale=share)
        if forces.found:
            wanted = _wanted(forces.contacts, stiffness)
            limit = STABLE * _buckling(forces.contacts, stiffness)
            if best is None or wanted / limit < best[0] / best[1]:
                best = wanted, limit, forces
    if best is None:
        none = np.zeros(0)
        return Squeeze(
            reason=forces.reason, ctrl=none, factor=float("nan"), wanted=float("nan"), forces=none
        )
    wanted, limit, forces = best
    factor = min(wanted, limit)
    torque = factor * forces.joint_torques
    ctrl, _ = task.hand.actuation.ctrl_for_torque(q, np.zeros_like(q), torque)
    return Squeeze(ctrl=ctrl, factor=factor, wanted=wanted, forces=factor * forces.forces[:, 0])


def _wanted(contacts: ContactSet, stiffness: FloatArray) -> float:
    """Least factor (-) >= 1 with which every contact holds under every load."""
    n = len(contacts)
    normals = contacts.normals
    gathered = _gathered(contacts)
    response = stiffness @ gathered.T @ np.linalg.pinv(gathered @ stiffness @ gathered.T)
    loads = np.hstack([LOADS, np.zeros_like(LOADS)])
    changes = -(loads @ response.T).reshape(len(LOADS), n, 3)
    # a finger out of place presses on all others, and the object settles between them
    settled = stiffness - response @ gathered @ stiffness
    along = np.zeros((n, 3 * n))
    for i in range(n):
        along[i, 3 * i : 3 * i + 3] = normals[i]
    lost = MISPLACED * np.linalg.norm(along @ settled @ along.T, axis=1)
    planned = contacts.forces_in_axes()[:, :3]
    return max(
        1.0,
        *(
            _least(planned[i], change[i] - lost[i] * normals[i], normals[i], FRICTION)
            for change in changes
            for i in range(n)
        ),
    )


def _buckling(contacts: ContactSet, stiffness: FloatArray) -> float:
    """Factor (-) of the planned forces at which the object turns aside; infinite if none does."""
    gathered = _gathered(contacts)
    destabilising = np.zeros((6, 6))
    arms = contacts.positions - contacts.center
    for r, f in zip(arms, contacts.forces_in_axes()[:, :3], strict=True):
        destabilising[3:, 3:] += (np.outer(r, f) + np.outer(f, r)) / 2 - (r @ f) * np.eye(3)
    largest = float(eigh(destabilising, gathered @ stiffness @ gathered.T, eigvals_only=True)[-1])
    return 1.0 / largest if largest > 0.0 else float("inf")


def _gathered(contacts: ContactSet) -> FloatArray:
    """Wrench about the centre of mass out of forces (3n,) at the contacts: (6, 3n)."""
    arms = contacts.positions - contacts.center
    return np.hstack([np.vstack([np.eye(3), skew(r)]) for r in arms])


def _stiffness(task: GraspTask, jacobians: FloatArray) -> FloatArray:
    """Of all contacts (3n, 3n), N/m, through the servos: force on the object per displacement."""
    actuation = task.hand.actuation
    servos = actuation.moment.T @ (-actuation.bias[:, 1, None] * actuation.moment)
    joints = servos + actuation.stiffness + SOFTEST * np.eye(len(servos))
    rows = jacobians[:, :3].reshape(-1, len(servos))  # (3n, nq)
    compliance = rows @ np.linalg.solve(joints, rows.T)
    # a direction in which no joint moves a tip is as stiff as the hand's links: bounded, not inf
    least = STIFFEST_SHARE * np.trace(compliance) / len(compliance)
    out: FloatArray = np.linalg.inv(compliance + least * np.eye(len(compliance)))
    return out


def _least(planned: FloatArray, change: FloatArray, normal: FloatArray, mu: float) -> float:
    """Least s >= 0 with s planned + change in the friction cone, all (3,), N.

    |a s + b| <= mu (c s + d) with a, b tangential and c, d normal: the larger root of a quadratic,
    since the planned force is inside of the cone.
    """
    c, d = float(planned @ normal), float(change @ normal)
    a, b = planned - c * normal, change - d * normal
    square = float(a @ a) - mu**2 * c**2  # < 0 inside
    if square >= 0.0:
        return float("inf")
    half = float(a @ b) - mu**2 * c * d
    rest = float(b @ b) - mu**2 * d**2
    root = np.sqrt(max(0.0, half**2 - square * rest))
    return max(0.0, -d / c, float((-half - root) / square))
