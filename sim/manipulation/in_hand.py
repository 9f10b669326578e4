"""What drives the fingers of a manipulation: the default, a name, or a controller of your own.

A controller of your own is one of a trial that sees more::

    class Mine:
        def __init__(self, plan):                     # the GraspPlan it begins with
            ...
        def step(self, observation):                  # every time step, until the fingers open
            target = observation.target               # where object, pads and joints should be now
            holding = observation.holding             # which fingers hold, (n,)
            return ctrl                               # (nu,), order of hand.actuation.names

    manipulate(plan, controller=Mine)

``GuidedController`` follows the schedule of contacts and the reference of the motion for it. A
controller that does both itself, as ``ObjectImpedance`` and its subclasses do, is an
``InHandController`` and drives the fingers as it is.

Whatever the controller, the commands of a finger that swings to another place are those of
``FingerSwing``, and in the phases "open" and "retreat" those of a posture servo.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Protocol, TypeAlias, cast, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from planner.errors import NotFoundError
from planner.kinematics import MovingHand
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray
from sim.controllers import (
    AnyController,
    Event,
    ObjectImpedance,
    Observation,
    Reference,
    ReportsEvents,
    ReportsLimits,
    Target,
    controller_for,
)
from sim.controllers.base import TOUCH_FORCE
from sim.controllers.monitors import ContactSchedule
from sim.controllers.object_impedance import REFERENCE_PHASES


@dataclass(frozen=True, kw_only=True)
class ManipulationObservation(Observation):
    """What a controller of a manipulation sees at one time step.

    Attributes:
        target: Where object, pads and joints should be now, with their velocities, palm axes; None
            before the squeeze. It stays between turns.
        wanted: (n,), which fingers are to hold the object; another gives its force to the others
            and leaves.
        holding: (n,), which fingers may press: they touch, and have a share of their force.
        share: (n,), share of its force that each finger has, 0 to 1: ramps of 0.1 s.
        grip: Least normal force of a finger that holds, N.
    """

    target: Target | None
    wanted: NDArray[np.bool_]
    holding: NDArray[np.bool_]
    share: FloatArray
    grip: float


class TurningController(Protocol):
    """A controller of your own; every ``Controller`` is one."""

    def step(self, observation: ManipulationObservation) -> FloatArray:
        """Commands (nu,) for the hand's actuators, order of ``hand.actuation.names``."""
        ...


AnyTurningController: TypeAlias = (
    AnyController | TurningController | Callable[[GraspPlan], TurningController]
)
"""What is accepted as a controller: a name, a controller, or what makes one from the grasp."""


@runtime_checkable
class InHandController(Protocol):
    """What holds and turns an object, and is told which fingers are to hold it.

    Attributes:
        reference: Gives a target at every step of a turn; None keeps the object where it is.
        grip: Least normal force of a finger that holds, N.
        schedule: Which fingers hold, from the squeeze on.
        T_palm_wanted: Where the object is to be in the palm; None before the squeeze.
    """

    reference: Reference | None
    grip: float
    schedule: ContactSchedule
    T_palm_wanted: SE3 | None

    @property
    def gave_up(self) -> str:
        """Why it gave up, "" while it has not."""
        ...

    @property
    def events(self) -> tuple[Event, ...]:
        """What it noticed, in order."""
        ...

    def step(self, observation: Observation) -> FloatArray:
        """Commands (nu,) for the hand's actuators."""
        ...

    def saturated_actuators(self) -> tuple[str, ...]:
        """Names of the actuators that could not give what the last step wanted."""
        ...

    def leave(self, finger: str) -> None:
        """Tell a finger to give its force to the others and to go off the object."""
        ...

    def join(self, finger: str) -> None:
        """Tell a finger to come back."""
        ...

    def keep(self) -> None:
        """Keep object and fingertips where they are now, and drop the reference."""
        ...


def in_hand_controller(
    plan: GraspPlan, given: AnyTurningController | None, *, max_normal: float
) -> InHandController:
    """The controller that was given, made for a plan and able to turn.

    Args:
        plan: The grasp that the manipulation begins with.
        given: Name, controller, class or function of the plan; "impedance" if None.
        max_normal: Largest normal force that the default asks of a finger, N.

    Raises:
        NotFoundError: No controller has that name.
        TaskError: What was given is none.
    """
    if given is None or given == "impedance":
        return ObjectImpedance(plan, max_normal=max_normal)
    made = cast(TurningController, controller_for(plan, cast(AnyController, given)))
    return made if isinstance(made, InHandController) else GuidedController(plan, made)


@runtime_checkable
class ReportsMissed(Protocol):
    """A controller of your own that knows when it cannot exert the wanted wrench."""

    @property
    def missed(self) -> float:
        """Missed share (-) of the last step's wrench, at least of 1 N; slows the reference down."""
        ...


class GuidedController:
    """Schedule and reference for a controller that knows neither: an ``InHandController``.

    Attributes:
        controller: Whose commands these are.
        reference: As ``InHandController``.
        grip: As there; the task's at first.
        schedule: As there.
        T_palm_wanted: As there.
    """

    def __init__(self, plan: GraspPlan, controller: TurningController) -> None:
        """Prepare for a plan."""
        task = plan.task
        self.controller = controller
        self.reference: Reference | None = None
        self.grip = task.grip_force
        self.schedule = ContactSchedule(np.zeros(len(task.fingers), dtype=bool))
        self.T_palm_wanted: SE3 | None = None
        self._names, self._fingers = task.finger_names, task.fingers
        self._state = MovingHand(task.hand, plan.q)
        self._target: Target | None = None
        self._time = 0.0

    @property
    def gave_up(self) -> str:
        """Nothing is known of that."""
        return ""

    @property
    def events(self) -> tuple[Event, ...]:
        """What the controller noticed, if it tells."""
        return self.controller.events if isinstance(self.controller, ReportsEvents) else ()

    def saturated_actuators(self) -> tuple[str, ...]:
        """What the controller tells, if it does."""
        told = isinstance(self.controller, ReportsLimits)
        return self.controller.saturated_actuators() if told else ()  # type: ignore[attr-defined]

    @property
    def _missed(self) -> float:
        """What the controller reports, or 0."""
        return self.controller.missed if isinstance(self.controller, ReportsMissed) else 0.0

    def leave(self, finger: str) -> None:
        """See ``InHandController``."""
        self.schedule.wanted[self._index(finger)] = False

    def join(self, finger: str) -> None:
        """See ``InHandController``."""
        self.schedule.wanted[self._index(finger)] = True

    def keep(self) -> None:
        """See ``InHandController``."""
        self.reference = None
        self._target = None

    def step(self, observation: Observation) -> FloatArray:
        """Commands (nu,) of the controller, which is told the target and the schedule."""
        elapsed, self._time = observation.time - self._time, observation.time
        if observation.phase not in ("approach", "close"):
            self._follow(elapsed, observation)
        seen = {one.name: getattr(observation, one.name) for one in fields(Observation)}
        return self.controller.step(
            ManipulationObservation(
                **seen,
                target=self._target,
                wanted=self.schedule.wanted.copy(),
                holding=self.schedule.holding,
                share=self.schedule.share.copy(),
                grip=self.grip,
            )
        )

    def _follow(self, elapsed: float, observation: Observation) -> None:
        """Advance schedule and reference to now."""
        state = self._state.move(observation.q)
        T_palm_base = state.T_base_palm.inverse()
        in_palm = T_palm_base * observation.T_world_base.inverse() * observation.T_world_object
        tips = np.array([T_palm_base.act(state.pad_center(f)) for f in self._fingers])
        if self.T_palm_wanted is None:
            self.schedule = ContactSchedule(observation.normal_forces > TOUCH_FORCE)
        self.schedule.step(elapsed, observation.normal_forces)
        if observation.phase in REFERENCE_PHASES and self.reference is not None:
            self._target = self.reference.advance(
                elapsed, in_palm, tips, observation.q, missed=self._missed
            )
        elif self._target is None:
            q = observation.q.copy()
            still = np.zeros(6)
            self._target = Target(
                T_palm_object=in_palm, twist=still, tips=tips, q=q, v=np.zeros_like(q)
            )
        self.T_palm_wanted = self._target.T_palm_object

    def _index(self, finger: str) -> int:
        if finger not in self._names:
            raise NotFoundError("finger that takes part", finger, self._names)
        return self._names.index(finger)
