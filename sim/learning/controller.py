"""``PolicyController``: a policy as a controller like any other; without one the open loop.

Until the fingers touch it is ``GraspController``. From the squeeze on the hand follows the playback
of the plan, and ``rate_hz`` times a second the policy decides by how much the joint targets differ
from it; that offset is held until the next decision. It reads joints and touch, and the estimated
pose of the object if the policy has the sense ``object``. In a manipulation the clock tells the
phases how far the turn has come.

``policy_file``: the file of a policy, one of our own or of those that come with Opposable.

Whatever takes ``policy:NAME`` asks here: the command line, the benches, ``policy_controller``.

``Demonstrator``: a hand driven by the teacher or the policy, while both say what they would do.

The teacher is the planner's closed loop (``ObjectImpedance``). It sees the truth, and it turns
the object by the clock of the playback, so that teacher and policy mean the same moment. The policy
sees what the sensors of the trial's error model say. Each decision gives a sample: the senses of
the policy, and the action that the teacher wanted then, in the readings of the encoders.

Who drives is drawn anew every ``STRETCH`` decisions. With the teacher alone this is a
demonstration; with both, the mixture of DAgger (Ross et al. 2011), which visits the states that the
policy gets into and asks the teacher there.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from planner.errors import FileFormatError, NotFoundError, TaskError
from planner.kinematics import MovingHand
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray
from planner.system.package import models_dir
from sim.controllers import (
    CONTROLLERS,
    Event,
    GraspController,
    ImpedanceGains,
    MotionReference,
    ObjectImpedance,
    Observation,
    Reference,
    Sense,
    Target,
)
from sim.controllers.base import TOUCH_FORCE
from sim.controllers.impedance import effective_inertia
from sim.controllers.monitors import ContactSchedule
from sim.learning.policy import ACTION_SCALE, RATE_HZ, Policy
from sim.learning.senses import AIM, SENSES, Playback, SenseHistory, columns
from sim.sensing.estimation import NONE
from sim.simulation import Simulation

SUFFIX = ".npz"
"""Ending of a policy's file."""


def policy_file(text: Path | str) -> Path:
    """The file that a text names: a path, or the name of a shipped policy.

    A text with a folder or an ending, and a file that there is, is a path.

    Raises:
        FileFormatError: The text is empty.
        NotFoundError: It is a mere name, and nothing has it.
    """
    path = Path(text)
    if not str(text):
        raise FileFormatError("no file of a policy is named; give policy:FILE")
    if path.suffix or len(path.parts) != 1 or path.exists():
        return path
    names = shipped_policies()
    if str(text) not in names:
        raise NotFoundError("policy", str(text), (*names, f"your own file, FILE{SUFFIX}"))
    return _folder() / f"{text}{SUFFIX}"


def shipped_policies() -> tuple[str, ...]:
    """Names of the policies that come with Opposable."""
    return tuple(sorted(file.stem for file in _folder().glob(f"*{SUFFIX}")))


def _folder() -> Path:
    return models_dir() / "policies"


POLICY = "policy:"
"""What the name of a controller begins with that is a policy."""

TIME_TOL = 1e-9
"""Rounding of times, s."""


class PolicyController:
    """Drives the fingers by a policy: an ``InHandController``.

    Attributes:
        needs: Senses without which it cannot work.
        plan: What is executed.
        policy: What corrects the playback; None for the open loop.
        playback: The plan by the clock.
        estimator: What tells it where the object is, a name; None where it does not matter.
        action: (nu,), the last decision.
        grip: As ``InHandController``; not used, since the playback has the plan's forces.
        schedule: As there.
    """

    needs: tuple[Sense, ...] = ("touch",)

    def __init__(self, plan: GraspPlan, policy: Policy | None = None) -> None:
        """Prepare for a plan.

        Raises:
            HandError: The plan is of another hand than the policy, or of one without servos.
        """
        self.plan, self.policy = plan, policy
        if policy is not None:
            policy.check_plan(plan)
        about = None if policy is None else policy.about
        self.estimator = None if about is None else about.estimator
        self.playback = Playback(plan, aim=AIM if about is None else about.aim)
        self.scale = ACTION_SCALE if about is None else about.action_scale
        self.period = 1.0 / (RATE_HZ if about is None else about.rate_hz)
        self.history = SenseHistory(plan.task, SENSES if about is None else about.senses)
        self.action: FloatArray = np.zeros(len(plan.task.hand.actuation.names))
        self.grip = plan.task.grip_force
        self.schedule = ContactSchedule(np.zeros(len(plan.task.fingers), dtype=bool))
        self.T_palm_wanted: SE3 | None = None
        self._names = plan.task.finger_names
        self._opening = GraspController(plan)
        self._range = plan.task.hand.actuation.ctrl_range
        self._wanted: FloatArray = np.zeros(len(self._range))
        self._began = False
        self._next = self._time = self._told = 0.0

    # ---- what the phases of a manipulation ask

    @property
    def reference(self) -> Reference | None:
        """Of the motion; told by the clock how far the turn has come."""
        return self.playback.reference

    @reference.setter
    def reference(self, reference: Reference | None) -> None:
        self.playback.reference = reference if isinstance(reference, MotionReference) else None
        self._told = self._time

    @property
    def aim(self) -> float:
        """Turn beyond the asked one at which its clock ends, rad."""
        return self.playback.aim

    @property
    def gave_up(self) -> str:
        """Never: nothing tells it."""
        return ""

    @property
    def events(self) -> tuple[Event, ...]:
        """None: it notices nothing by name."""
        return ()

    def saturated_actuators(self) -> tuple[str, ...]:
        """Names of the actuators whose targets were beyond their range."""
        low, high = self._range.T
        beyond = (self._wanted < low) | (self._wanted > high)
        return tuple(self.plan.task.hand.actuation.names[i] for i in np.flatnonzero(beyond))

    def leave(self, finger: str) -> None:
        """Note that a finger is to move on; the playback goes on with it."""
        self.schedule.wanted[self._index(finger)] = False

    def join(self, finger: str) -> None:
        """Note that it is to hold again."""
        self.schedule.wanted[self._index(finger)] = True

    def keep(self) -> None:
        """Drop the reference."""
        self.reference = None

    # ---- what it does

    def step(self, observation: Observation) -> FloatArray:
        """Commands (nu,) for the hand's actuators."""
        elapsed, self._time = observation.time - self._time, observation.time
        if observation.phase in ("approach", "close"):
            return self._opening.step(observation)
        self.playback.step(observation)
        if not self._began:
            self._began, self._next = True, observation.time
            self.schedule = ContactSchedule(observation.normal_forces > TOUCH_FORCE)
        self.schedule.step(elapsed, observation.normal_forces)
        if observation.time >= self._next - TIME_TOL:
            self._next += self.period
            self.action = self.decide(observation)
            self._tell(observation)
        return self.commands(observation)

    def decide(self, observation: Observation) -> FloatArray:
        """The next action (nu,)."""
        senses = self.history.vector(observation, self.playback, self.action)
        return self.action if self.policy is None else self.policy.act(senses)

    def commands(self, observation: Observation) -> FloatArray:
        """Commands (nu,) of the playback with the last action."""
        del observation
        self._wanted = self.playback.ctrl + self.scale * self.action
        low, high = self._range.T
        return np.asarray(np.minimum(np.maximum(self._wanted, low), high))

    def _tell(self, observation: Observation) -> None:
        """Tell the reference how far the clock is."""
        reference = self.playback.reference
        believed = self.playback.T_palm_object
        self.T_palm_wanted = believed
        if observation.phase in ("turn", "hold") and reference is not None and believed is not None:
            tips = np.zeros((len(self._names), 3))  # the target that it gives is not used
            elapsed = max(observation.time - self._told, TIME_TOL)
            reference.advance(elapsed, believed, tips, observation.q, missed=0.0)
        self._told = observation.time

    def _index(self, finger: str) -> int:
        if finger not in self._names:
            raise NotFoundError("finger that takes part", finger, self._names)
        return self._names.index(finger)


def open_loop(plan: GraspPlan) -> PolicyController:
    """The playback of a plan alone: a controller without any feedback after the first touch."""
    return PolicyController(plan)


@dataclass(frozen=True)
class PolicyMaker:
    """Makes a controller for every plan; given wherever a controller can be.

    Attributes:
        policy: What drives.
        name: What a report calls it.
    """

    policy: Policy
    name: str = "policy"

    @property
    def __name__(self) -> str:
        """What a report calls it."""
        return self.name

    def __call__(self, plan: GraspPlan) -> PolicyController:
        """A controller for a plan.

        Raises:
            HandError: The plan is of another hand.
        """
        return PolicyController(plan, self.policy)


def policy_controller(path: Path | str) -> PolicyMaker:
    """What makes controllers of a policy: ``manipulate(plan, controller=...)``.

    Args:
        path: A file, or the name of a policy that comes with Opposable.

    Raises:
        FileFormatError: The file is none, damaged, or of another version.
        NotFoundError: Neither a file nor a policy has that name.
    """
    return PolicyMaker(Policy.load(policy_file(path)), f"policy:{Path(path).name}")


def named_driver(name: str) -> str | PolicyMaker | None:
    """What drives the fingers by its name on a command line.

    Args:
        name: Of a controller, or "policy:FILE", or "policy:NAME"; "" for the default.

    Raises:
        NotFoundError: No controller or policy has that name.
        FileFormatError: A policy that cannot be read.
    """
    if name.startswith(POLICY):
        return policy_controller(name.removeprefix(POLICY))
    if name and name not in CONTROLLERS:
        policies = [POLICY + policy for policy in shipped_policies()]
        raise NotFoundError("controller", name, (*CONTROLLERS, *policies, f"{POLICY}FILE"))
    return name or None


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
