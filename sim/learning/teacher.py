"""``Demonstrator``: a hand driven by the teacher or the policy, while both say what they would do.

The teacher is the planner's closed loop (``ObjectImpedance``). It sees the truth, and it turns
the object by the clock of the playback, so that teacher and policy mean the same moment. The policy
sees what the sensors of the trial's error model say. Each decision gives a sample: the senses of
the policy, and the action that the teacher wanted then, in the readings of the encoders.

Who drives is drawn anew every ``STRETCH`` decisions. With the teacher alone this is a
demonstration; with both, the mixture of DAgger (Ross et al. 2011), which visits the states that the
policy gets into and asks the teacher there.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from planner.errors import TaskError
from planner.kinematics import MovingHand
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray
from sim.controllers import (
    ImpedanceGains,
    MotionReference,
    ObjectImpedance,
    Observation,
    Reference,
    Target,
)
from sim.controllers.impedance import effective_inertia
from sim.learning.controller import PolicyController
from sim.learning.policy import Policy
from sim.learning.senses import SENSES, SenseHistory, columns
from sim.sensing.estimation import NONE
from sim.simulation import Simulation

BANDWIDTH = 30.0
"""Natural frequency (rad/s) of the object that the teacher holds: a decision is held for 10 ms, for
which the 60 rad/s of a loop with steps of 2 ms are too many."""

LEARNING_RATE = 0.0
"""Rate (1/s) at which the teacher's loop learns a constant load: not at all, since a policy cannot
imitate what depends on a memory that it does not have."""

AIM_TAUGHT = float(np.deg2rad(1.0))
"""Turn (rad) beyond the goal that the teacher aims at; dry friction, against which its loop
has learned a load, adds a degree at the end."""

APART, PUSH_APART = 0.003, 500.0
"""Gap (m) between the pads of two fingers below which the teacher pushes them apart, and how hard
(N/m): with 1.5 N when they touch. The planner leaves 2 mm between fingers, and the verdict counts
1 N between them as a collision."""

STRETCH = 50
"""Decisions for which one of both drives: half a second."""

TINY = 1e-9
"""Least distance (m) of two pads that is divided by."""


class ByTheClock:
    """A ``Reference`` that follows a planned motion as if the object did."""

    def __init__(self, reference: MotionReference, angle: float) -> None:
        """Prepare to turn by an angle (rad, with its sign) along the motion of a reference."""
        self._inner = MotionReference(reference.motion, angle=angle)
        self._wanted: SE3 | None = None

    def advance(
        self, elapsed: float, T_palm_object: SE3, tips: FloatArray, q: FloatArray, *, missed: float
    ) -> Target:
        """Go on by one step; only the first measured pose counts."""
        del missed
        seen = T_palm_object if self._wanted is None else self._wanted
        target = self._inner.advance(elapsed, seen, tips, q, missed=0.0)
        self._wanted = target.T_palm_object
        return target


class Demonstrator(PolicyController):
    """Collects samples; give it its ``simulation`` before the first step.

    Attributes:
        simulation: Of which it tells the teacher the truth.
        teacher: The closed loop.
        senses: All inputs that a policy can have (``SENSES``), at each decision, (m,) each.
        wanted: The actions that the teacher wanted then, (nu,) each.
    """

    def __init__(
        self,
        plan: GraspPlan,
        policy: Policy | None,
        *,
        share: float,
        noise: float,
        rng: np.random.Generator,
        max_normal: float,
        estimator: str = NONE,
    ) -> None:
        """Prepare for a plan.

        Args:
            plan: What is executed.
            policy: Which policy drives where the teacher does not; the playback alone if None.
            share: Share of the stretches in which the teacher drives, 0 to 1.
            noise: Standard deviation of what is added to the teacher's actions while it drives
                (-): it then visits states beside its path too.
            rng: Draws.
            max_normal: Largest normal force that the teacher asks of a finger, N.
            estimator: What tells where the object is, a name, where there is no policy yet.
        """
        super().__init__(plan, policy)
        if policy is None:
            self.estimator = estimator
        self.history = SenseHistory(plan.task)
        self._columns = columns(plan.task.hand, SENSES if policy is None else policy.about.senses)
        self.simulation: Simulation | None = None
        mass, inertia = effective_inertia(plan, plan.task.object.mass)
        gains = ImpedanceGains.of_body(
            mass=mass, inertia=inertia, bandwidth=BANDWIDTH, learning_rate=LEARNING_RATE
        )
        self.teacher = ObjectImpedance(plan, gains=gains, max_normal=max_normal)
        self.senses: list[FloatArray] = []
        self.wanted: list[FloatArray] = []
        self._share = share
        self._noise, self._rng = noise, rng
        self._state = MovingHand(plan.task.hand, plan.q)
        self._teaches = True

    @property
    def reference(self) -> Reference | None:
        """Of the motion."""
        return self.playback.reference

    @reference.setter
    def reference(self, reference: Reference | None) -> None:
        PolicyController.reference.fset(self, reference)  # type: ignore[attr-defined]
        given = self.playback.reference
        if given is None:
            self.teacher.reference = None
            return
        most = min(abs(given.goal) + AIM_TAUGHT, abs(given.motion.path.angle))
        self.teacher.reference = ByTheClock(given, float(np.copysign(most, given.goal)))

    @property
    def gave_up(self) -> str:
        """Why the teacher gave up, "" while it has not."""
        return self.teacher.gave_up

    def step(self, observation: Observation) -> FloatArray:
        """Commands (nu,) for the hand's actuators."""
        if observation.phase in ("approach", "close"):
            self.teacher.step(observation)
        return super().step(observation)

    def decide(self, observation: Observation) -> FloatArray:
        """The next action (nu,); what the teacher wants is kept, and taken where it drives."""
        if self.simulation is None:
            raise TaskError("a demonstrator needs its simulation; set it before the first step")
        inputs = self.history.vector(observation, self.playback, self.action)
        truth = self.simulation.observe(observation.phase, observation.progress)
        commands = self.teacher.step(truth) + self._apart(truth.q)
        commands = commands + self.playback.shift @ (self.playback.q - truth.q)
        wanted = np.clip((commands - self.playback.ctrl) / self.scale, -1.0, 1.0)
        if len(self.senses) % STRETCH == 0:
            self._teaches = bool(self._rng.random() < self._share)
        self.senses.append(inputs)
        self.wanted.append(wanted)
        if self._teaches:
            noise = self._noise * self._rng.standard_normal(len(wanted))
            return np.asarray(np.clip(wanted + noise, -1.0, 1.0))
        return (
            np.zeros(len(wanted)) if self.policy is None else self.policy.act(inputs[self._columns])
        )

    def _apart(self, q: FloatArray) -> FloatArray:
        """Change of the commands (nu,) that keeps the fingers off each other at joints q (nq,)."""
        fingers, state = self.plan.task.fingers, self._state.move(q)
        centers = [state.pad_center(f) for f in fingers]
        torque = np.zeros(len(q))
        for (a, first), (b, second) in combinations(enumerate(fingers), 2):
            way = centers[b] - centers[a]
            distance = max(float(np.linalg.norm(way)), TINY)
            near = APART - (distance - first.pad.radius - second.pad.radius)
            if near <= 0.0:
                continue
            push = PUSH_APART * near / distance * way
            for finger, center, force in ((second, centers[b], push), (first, centers[a], -push)):
                jacobian = state.point_jacobian(finger.pad.joint_id, center)[:3, finger.q_index]
                torque[finger.q_index] += jacobian.T @ force
        actuation = self.plan.task.hand.actuation
        still = np.zeros(len(q))
        return actuation.commands(q, still, torque) - actuation.commands(q, still, still)
