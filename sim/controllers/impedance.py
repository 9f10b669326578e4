"""Impedance of a held object: ``ImpedanceGains`` and ``ImpedanceLaw``.

The law gives the wrench that the hand should exert, from where the object is and should be:

    w = K e - D (twist - wanted twist) + load,    e = [p* - p; log(R* R^T)]
    d load/dt = learning_rate (K e + missed)

K and D are diagonal, the same along and the same about every axis. ``missed`` is what the contact
forces give less what was asked of them: the load stops growing where the forces are exhausted. With
learning_rate = 0 a constant push P leaves e = P / K; otherwise the load becomes -P and e goes to 0.
Everything is about the object's centre of mass, in the axes of the poses given.

The gains follow from bandwidth and the inertia felt at the object, which includes the links of the
fingers that hold it (Khatib 1987, operational space inertia):

    M = diag(m, I) + sum_i G_i (J_i H^-1 J_i^T)^-1 G_i^T,    G_i = [1; r_i x]

with H the joint-space inertia and J_i the Jacobian of contact i. K = M w^2 and D = 2 z M w give the
natural frequency w and the damping ratio z.

``EstimateCorrection``: what an estimate takes back is no motion of the object.

Called by ``ObjectImpedance`` at every step while it only holds. A carried object moves with the
fingertips, which the joints tell to hundredths of a millimetre, and against them as the pads feel
it slide; one that still stands does not move. An estimate changes by more than that: it learns from
a camera of millimetres and degrees where the object has been all the time. A loop that brought the
object back by as much would move it in the hand, against contacts that stick, with forces that grow
until they slip. So the wanted pose goes along with the estimate, as far as the estimate was in
doubt. A larger change counts as a motion of the object.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from planner.arrays import check_fields
from planner.kinematics import HandState
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray, skew
from sim.controllers.base import PoseUncertainty

DEVIATIONS = 3.0
"""How many standard deviations of the estimate, the largest so far, it may take back (-)."""


class EstimateCorrection:
    """What an estimate has taken back since the wanted pose was set."""

    def __init__(self) -> None:
        """Nothing yet."""
        self._last: SE3 | None
        self.forget()

    def forget(self) -> None:
        """Begin anew, at another wanted pose."""
        self._last = None
        self._taken, self._most = np.zeros((2, 3)), np.zeros(2)

    def follow(
        self,
        wanted: SE3,
        estimate: SE3,
        twist: FloatArray,
        elapsed: float,
        uncertainty: PoseUncertainty,
    ) -> SE3:
        """The wanted pose, moved as the estimate has moved without the object.

        Args:
            wanted: Where the object is to be kept, in the palm.
            estimate: Where it is taken to be, in the palm.
            twist: (6,), of the object as its contacts tell it, about its centre, palm axes, m/s and
                rad/s.
            elapsed: Since the last step, s.
            uncertainty: How well the estimate is known.
        """
        last, self._last = self._last, estimate
        if last is None:
            return wanted
        deviations = np.array([uncertainty.position_deviation, uncertainty.rotation_deviation])
        self._most = np.maximum(self._most, deviations)
        shift = estimate.translation - last.translation - elapsed * twist[:3]
        turn = pin.log3(estimate.rotation @ last.rotation.T @ pin.exp3(-elapsed * twist[3:]))
        taken = self._taken + np.array([shift, turn])
        size = np.linalg.norm(taken, axis=1)
        most = DEVIATIONS * self._most
        taken *= np.minimum(1.0, most / np.maximum(size, np.maximum(most, TINY)))[:, None]
        (shift, turn), self._taken = taken - self._taken, taken
        return SE3(pin.exp3(turn) @ wanted.rotation, wanted.translation + shift)


TINY = 1e-12
"""Length (m) or angle (rad) that is nothing."""


BANDWIDTH = 60.0
"""Natural frequency (rad/s) of the held object. Contacts give way at 200 rad/s in simulation, and
a control step of 2 ms at 60 rad/s is a phase of 7 degrees."""

DAMPING_RATIO = 1.0
"""Damping ratio (-): critical, so that a push does not ring."""

LEARNING_RATE = 8.0
"""Rate (1/s) at which the spring's force becomes known load: a constant push is carried without
deflection after some tenths of a second, well below the bandwidth."""

SOFTEST = 1e-6
"""Added to J H^-1 J^T (1/kg), for a finger that cannot move along some direction."""


@dataclass(frozen=True, kw_only=True)
class ImpedanceGains:
    """Gains of ``ImpedanceLaw``.

    Attributes:
        stiffness: Force per displacement, N/m.
        damping: Force per velocity, N s/m.
        turning_stiffness: Torque per angle, N m/rad.
        turning_damping: Torque per angular velocity, N m s/rad.
        learning_rate: Rate at which the spring's wrench goes over to the learned load, 1/s. With 0
            a constant push leaves the deflection push / stiffness.
    """

    stiffness: float
    damping: float
    turning_stiffness: float
    turning_damping: float
    learning_rate: float = LEARNING_RATE

    def __post_init__(self) -> None:
        """Check every number."""
        check_fields(self, what="gains: ", least=0.0)

    @classmethod
    def of_body(
        cls,
        *,
        mass: float,
        inertia: float,
        bandwidth: float = BANDWIDTH,
        damping_ratio: float = DAMPING_RATIO,
        learning_rate: float = LEARNING_RATE,
    ) -> ImpedanceGains:
        """Gains that give a body a natural frequency and a damping ratio.

        Args:
            mass: What moves, kg.
            inertia: Mean moment of inertia about the centre of mass, kg m^2.
            bandwidth: Natural frequency, rad/s.
            damping_ratio: -.
            learning_rate: 1/s.
        """
        return cls(
            stiffness=mass * bandwidth**2,
            damping=2.0 * damping_ratio * mass * bandwidth,
            turning_stiffness=inertia * bandwidth**2,
            turning_damping=2.0 * damping_ratio * inertia * bandwidth,
            learning_rate=learning_rate,
        )


class ImpedanceLaw:
    """Spring, damper and learned load of one object.

    Attributes:
        gains: The gains.
        load: Learned wrench (6,) at rest, N and N m.
    """

    def __init__(self, gains: ImpedanceGains) -> None:
        """Start without a load."""
        self.gains = gains
        self.load = np.zeros(6)
        self._stiffness = np.repeat([gains.stiffness, gains.turning_stiffness], 3)
        self._damping = np.repeat([gains.damping, gains.turning_damping], 3)
        self._spring = np.zeros(6)

    def wrench(self, T_wanted: SE3, T_actual: SE3, twist: FloatArray) -> FloatArray:
        """The wrench (6,) that the hand should exert, without gravity.

        Args:
            T_wanted: Where the object should be.
            T_actual: Where it is.
            twist: (6,), velocity of the object relative to the wanted one: linear of the centre of
                mass and angular, m/s and rad/s.
        """
        error = np.empty(6)
        error[:3] = T_wanted.translation - T_actual.translation
        error[3:] = pin.log3(T_wanted.rotation @ T_actual.rotation.T)
        self._spring = self._stiffness * error
        return np.asarray(self._spring - self._damping * twist + self.load)

    def damped_by(self, brake: FloatArray, twist: FloatArray) -> FloatArray:
        """Wrench (6,) to be added to ``wrench`` where something else damps already.

        Each component of the damping is asked for as far as it is beyond the other's.

        Args:
            brake: (6,), N and N m, by which it is damped.
            twist: (6,), as for ``wrench``.
        """
        own = -self._damping * twist
        return np.asarray(np.clip(-brake, *np.sort([-own, np.zeros(6)], axis=0)))

    def learn(self, elapsed: float, missed: FloatArray) -> None:
        """Move the spring's wrench over to the load.

        Args:
            elapsed: Time since the last call, s.
            missed: (6,), wrench of the contact forces minus the wanted wrench.
        """
        self.load += elapsed * self.gains.learning_rate * (self._spring + missed)


def effective_inertia(plan: GraspPlan, mass: float) -> tuple[float, float]:
    """Mass (kg) and moment of inertia (kg m^2) of a held object with the links that move with it.

    From the mean of the mobility M^-1 over all directions. A mean of M would be dominated by
    directions in which stretched fingers hardly move, and a damper of that size is unstable in the
    other directions at a control step of 2 ms.

    Args:
        plan: The grasp.
        mass: Mass of the object as it is believed, kg; its own inertia is that of a ball as large
            as its bounding sphere, an upper bound.
    """
    hand, state = plan.task.hand, HandState(plan.task.hand, plan.q)
    joint_inertia = pin.crba(hand.pin_model, hand.pin_model.createData(), plan.q)
    joint_inertia = np.triu(joint_inertia) + np.triu(joint_inertia, 1).T
    contacts = plan.contacts.transformed(plan.T_world_base.inverse())
    radius = plan.task.object.shape.bounding_radius
    felt: FloatArray = np.diag([mass] * 3 + [0.4 * mass * radius**2] * 3)
    for finger, point in zip(plan.task.fingers, contacts.positions, strict=True):
        k = finger.q_index
        jac = state.point_jacobian(finger.pad.joint_id, point)[:3, k]
        mobility = jac @ np.linalg.solve(joint_inertia[np.ix_(k, k)], jac.T)
        tip = np.linalg.inv(mobility + SOFTEST * np.eye(3))
        arm = np.vstack([np.eye(3), skew(point - contacts.center)])
        felt += arm @ tip @ arm.T
    mean = np.diag(np.linalg.inv(felt)).reshape(2, 3).mean(axis=1)
    return 1.0 / float(mean[0]), 1.0 / float(mean[1])
