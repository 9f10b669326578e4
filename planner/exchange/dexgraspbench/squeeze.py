"""Squeeze pose for DexGraspBench: how far beyond the grasp its servos are commanded.

The benchmark commands one posture and holds it throughout: its servos are springs about it, and a
grasp gives way as ``planner.verification.stiffness.GraspStiffness`` tells. A squeeze of s times
the planned forces f0, which press without a load and balance, is good when after every change that
the protocol brings each contact still holds:

    f_i = s f0_i + change_i(s, load) -+ e_i(s),

in the soft-finger cone of the benchmark, for all loads, where e_i is what the misplaced contacts
change: they are not where the plan has them, by ``MISPLACED``. Too small an s leaves no friction
to the loads. Too large a one turns the object aside, by forces that miss the points where they
balance and at last by themselves: s stays below ``STABLE`` of that, and turns less than ``TURNED``.
The squeeze is the least s that leaves ``SPARE`` of every normal force, or the one that leaves most.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from planner.contacts import ContactSet
from planner.errors import PlannerError
from planner.forces import ForceSolution
from planner.hands.hand import Hand
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask
from planner.verification.grasp import plan_forces
from planner.verification.stiffness import GraspStiffness

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

TORSION = 0.02
"""Its torsional friction, m."""

FRICTION_SHARES = (0.3, 0.5, 0.8)
"""Shares of the planned friction coefficient (-) with which pressing forces are tried: with little
friction in use, more is left to the loads, but balanced forces may be very unequal. The set that
leaves most friction is taken, and of those with enough the gentlest."""

SPARE = 0.3
"""Share of normal forces (-) that a squeeze leaves under every load: contacts creep and the object
turns a little, which the stiffness of a small displacement leaves out."""

STABLE = 0.5
"""Share of the force at which a grasp buckles that a squeeze may use (-): a load moves the object
at most 1 / (1 - 0.5) times as far as springs alone would let it."""

FACTORS = 1.1 ** np.arange(-7.0, 22.0)
"""Multiples of the planned forces that are tried (-), 0.5 to 7.4: in steps of a tenth."""

TURNED = math.radians(15.0)
"""Rotation with which the benchmark calls an object lost, rad."""

MISPLACED = 0.001
"""Distance (m) between a contact and its plan: the servos lag by different times, so that the first
finger to touch pushes the object before the last one does."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Squeeze:
    """A squeeze, or the reason why there is none.

    Attributes:
        reason: Why not; "" if there is one.
        ctrl: Commands (nu,) of the actuators; empty without one.
        factor: Planned forces are multiplied by this (-); NaN without one.
        use: Share of a normal force, or of the rotation that is let pass, that the loads need at
            most (-); above 1 they may win. NaN without one.
        forces: Normal forces (n,) at the grasp, N, but for what actuators that stand at their limit
            lack; empty without one.
    """

    reason: str = ""
    ctrl: FloatArray
    factor: float
    use: float
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
    best: tuple[float, float, float, ForceSolution] | None = None
    for share in FRICTION_SHARES:
        forces = plan_forces(floating, contacts, T_world_base, q, friction_scale=share)
        if forces.found:
            stiffness = GraspStiffness.of(floating, forces, T_world_base, q)
            use, factor = _least_factor(task, stiffness, forces, q)
            found = max(use, 1.0 - SPARE), factor * forces.forces[:, 0].max(), factor, forces
            if best is None or found[:2] < best[:2]:
                best = found
    if best is None:
        none = np.zeros(0)
        return Squeeze(
            reason=forces.reason, ctrl=none, factor=float("nan"), use=float("nan"), forces=none
        )
    use, _, factor, forces = best
    if not np.isfinite(use):
        none = np.zeros(0)
        reason = "no squeeze is within the actuators' limits and below buckling"
        return Squeeze(reason=reason, ctrl=none, factor=float("nan"), use=use, forces=none)
    torque = factor * forces.joint_torques
    ctrl, _ = task.hand.actuation.ctrl_for_torque(q, np.zeros_like(q), torque)
    return Squeeze(ctrl=ctrl, factor=factor, use=use, forces=factor * forces.forces[:, 0])


def _least_factor(
    task: GraspTask, stiffness: GraspStiffness, forces: ForceSolution, q: FloatArray
) -> tuple[float, float]:
    """Share of the friction in use, and the factor of the forces; see the module."""
    limit, actuation = STABLE * stiffness.buckling, task.hand.actuation

    def allowed(factor: float) -> bool:
        torques = factor * forces.joint_torques
        return factor < limit and not actuation.short_of(q, torques, 1e-9).any()

    tried = [factor for factor in FACTORS if allowed(factor)]
    if tried and tried[-1] < FACTORS[-1]:  # what the actuators give beyond the last step counts
        low, high = tried[-1], 1.1 * tried[-1]
        for _ in range(20):
            middle = (low + high) / 2
            low, high = (middle, high) if allowed(middle) else (low, middle)
        tried.append(low)
    uses = [_use(stiffness, factor) for factor in tried]
    for i, (use, factor) in enumerate(zip(uses, tried, strict=True)):
        if factor >= 1.0 and use <= 1.0 - SPARE:
            if factor == 1.0 or i == 0 or uses[i - 1] <= 1.0 - SPARE:
                return use, factor
            share = (uses[i - 1] - (1.0 - SPARE)) / (uses[i - 1] - use)
            return 1.0 - SPARE, tried[i - 1] + share * (factor - tried[i - 1])
    return min(zip(uses, tried, strict=True), default=(float("inf"), 1.0))


def _use(stiffness: GraspStiffness, factor: float) -> float:
    """Largest share (-) of a contact's normal force, or of ``TURNED``, that any load needs."""
    m, n = len(LOADS), len(stiffness.forces)
    wrenches = np.hstack([LOADS, np.zeros_like(LOADS)])
    changes, turned = stiffness.under(factor, wrenches, MISPLACED)
    # a finger out of place presses on all others, and the object settles between them
    lost = np.linalg.norm(changes[m : m + n, :, 0], axis=0)
    force = factor * stiffness.forces + changes[:m]
    sliding = np.linalg.norm(force[:, :, 1:3], axis=2) / FRICTION
    needed = np.hypot(sliding, force[:, :, 3] / TORSION) + lost - changes[:m, :, 0]
    slips = float((needed / (factor * stiffness.forces[:, 0])).max())
    angles = np.linalg.norm(turned, axis=1)
    return max(slips, float(angles[:m].max() + np.linalg.norm(angles[m:])) / TURNED)
