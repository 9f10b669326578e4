"""Controllers by name, and what else may be given as one."""

from __future__ import annotations

import copy
import inspect
from collections.abc import Callable
from typing import TypeAlias

from planner.errors import TaskError, shown
from planner.plan import GraspPlan
from planner.registry import Registry
from sim.controllers.base import Controller

MakeController: TypeAlias = Callable[[GraspPlan], Controller]
"""What makes a controller of a plan: a class or a function."""

AnyController: TypeAlias = str | Controller | MakeController
"""What is accepted as a controller: a name out of ``CONTROLLERS``, a controller, or a class or
function that makes one from the plan."""

CONTROLLERS: Registry[MakeController] = Registry("controller", group="controllers")
"""feedforward: the planned forces, turned with the object, and servos that hold the posture, but
nothing that steers the object; impedance: a closed loop that keeps the object's pose."""

CONTROLLERS.add_homes(
    {
        "feedforward": "sim.controllers.grasp:GraspController",
        "impedance": "sim.controllers.object_impedance:ObjectImpedance",
    }
)

DEFAULT_CONTROLLER = "feedforward"

OF_A_POLICY = (
    "A learned policy is --controller policy:FILE on the command line, and "
    "sim.learning.policy_controller(FILE) in Python."
)
"""What else there is to drive a hand, for messages; the package that has it is above this one."""


def named_controller(name: str) -> MakeController:
    """What makes a fresh controller for a plan.

    Raises:
        NotFoundError: No controller has that name.
    """
    return CONTROLLERS.named(name, OF_A_POLICY)


def controller_for(plan: GraspPlan, controller: AnyController | None) -> Controller:
    """The controller that is given, made for a plan where it is a name, a class or a function.

    Args:
        plan: What it is to execute.
        controller: Name, controller, class or function of the plan; "feedforward" if None.

    Raises:
        NotFoundError: No controller has that name.
        TaskError: It is none of these.
    """
    if is_controller(controller):
        return controller  # type: ignore[return-value]
    return controller_maker(controller)(plan)


def controller_maker(controller: AnyController | None) -> MakeController:
    """What makes a fresh controller for every plan; a controller itself is copied as it is now.

    Args:
        controller: Name, controller, class or function of the plan; "feedforward" if None.

    Raises:
        NotFoundError: No controller has that name.
        TaskError: It is none of these.
    """
    if controller is None:
        return CONTROLLERS[DEFAULT_CONTROLLER]
    if isinstance(controller, str):
        return named_controller(controller)
    if is_controller(controller):
        return _CopyOf(controller)  # type: ignore[arg-type]
    if not callable(controller) or not _takes_a_plan(controller):
        raise _refused(controller)
    return _Checked(controller)


def controller_name(controller: AnyController | None) -> str:
    """What a report calls a controller: its name, or that of its class or function."""
    if controller is None:
        return DEFAULT_CONTROLLER
    if isinstance(controller, str):
        return controller
    return str(getattr(controller, "__name__", type(controller).__name__))


class _CopyOf:
    """Makes copies of one controller: trials do not see each other."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller

    def __call__(self, plan: GraspPlan) -> Controller:
        return copy.deepcopy(self._controller)


class _Checked:
    """A class or function, checked that what it makes is a controller."""

    def __init__(self, make: MakeController) -> None:
        self._make = make

    def __call__(self, plan: GraspPlan) -> Controller:
        made = self._make(plan)
        if not is_controller(made):
            raise TaskError(
                f"{controller_name(self._make)} made {shown(made)} of the plan, which has no "
                "method step(observation); see sim.controllers.Controller"
            )
        return made


def is_controller(thing: object) -> bool:
    """Whether it is a controller itself, not what makes one."""
    return not isinstance(thing, type) and _steps(thing)


def _steps(thing: object) -> bool:
    return callable(getattr(thing, "step", None))


def _takes_a_plan(make: Callable[..., object]) -> bool:
    try:
        inspect.signature(make).bind(None)
    except (TypeError, ValueError):  # ValueError: a builtin without a signature
        return False
    return True


def _refused(thing: object) -> TaskError:
    if isinstance(thing, type) and _steps(thing):
        return TaskError(
            f"controller {thing.__name__} is a class that does not take the plan alone; give "
            f"an instance, or a function that makes one from the plan"
        )
    return TaskError(
        f"controller is {thing!r}; give one of {', '.join(CONTROLLERS)}, an object with a method "
        "step(observation), or a class or function that makes one from the plan"
    )
