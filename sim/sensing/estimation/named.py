"""Estimators by their names, and what a simulation takes as one.

One of your own registers itself by a name::

    @register_estimator("mine", "what it reads, in a few words")
    def mine(task, errors):
        return Mine(task)               # step(observation) -> observation, events
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Protocol, TypeAlias, runtime_checkable

from planner.errors import NotFoundError, TaskError, shown
from planner.registry import Registry
from planner.task import GraspTask
from sim.controllers import Event, Observation
from sim.sensing.errors import ErrorModel
from sim.sensing.estimation.estimator import ObjectEstimator
from sim.sensing.estimation.state import SensorErrors

NONE = "none"
"""Name of no estimator: the controller reads the sensors themselves."""


@runtime_checkable
class Estimator(Protocol):
    """What stands between sensors and controller."""

    @property
    def events(self) -> tuple[Event, ...]:
        """What it noticed so far, in order."""
        ...

    def step(self, observation: Observation) -> Observation:
        """What is known, from what sensors say; called once a time step."""
        ...


MakeEstimator: TypeAlias = Callable[[GraspTask, SensorErrors], Estimator]
"""Makes an estimator for a task and the expected errors of its senses."""

AnyEstimator: TypeAlias = str | MakeEstimator
"""What is accepted as an estimator: a name, or what makes one. Each trial gets its own."""


@dataclass(frozen=True)
class NamedEstimator:
    """An estimator with a name.

    Attributes:
        make: Makes one.
        reads: What it reads, in a few words.
    """

    make: MakeEstimator
    reads: str


ESTIMATORS: Registry[NamedEstimator] = Registry("estimator")
"""Estimators by their names."""


def register_estimator(name: str, reads: str) -> Callable[[MakeEstimator], MakeEstimator]:
    """Make known by a name what makes an estimator.

    Args:
        name: Its name.
        reads: What it reads, in a few words.

    Raises:
        TaskError: There is one of that name.
    """

    def register(make: MakeEstimator) -> MakeEstimator:
        if name == NONE:
            raise TaskError(f"{NONE!r} is the name of no estimator; choose another name")
        ESTIMATORS.add(name, NamedEstimator(make, reads))
        return make

    return register


register_estimator("all", "joints, pads and camera")(ObjectEstimator)
# contacts where round tips touch the estimated object, a nominal force, no sliding
register_estimator("contact", "joints, and which fingers touch; no camera once the hand closes")(
    partial(ObjectEstimator, touch="binary", camera=False)
)
register_estimator("touch", "joints and pads; no camera once the hand closes")(
    partial(ObjectEstimator, camera=False)
)


def default_estimator(error_model: ErrorModel | None) -> str:
    """Name of the estimator where none is asked for.

    It is the one with all senses where the pose that is read has errors: a controller that acts on
    each pose by itself multiplies their noise by its stiffness. An exact pose needs none.
    """
    return "all" if error_model is not None and error_model.has_pose_errors else NONE


def estimator_name(estimator: AnyEstimator | None, error_model: ErrorModel | None) -> str:
    """What reports call the estimator of a trial."""
    if estimator is None:
        return default_estimator(error_model)
    if isinstance(estimator, str):
        return estimator
    return str(getattr(estimator, "__name__", type(estimator).__name__))


def check_estimator(name: str) -> None:
    """Refuse a name that no estimator has.

    Raises:
        NotFoundError: There is none of that name.
    """
    if name != NONE and name not in ESTIMATORS:
        raise NotFoundError("estimator", name, (*ESTIMATORS, NONE))


def estimator_for(
    task: GraspTask, estimator: AnyEstimator | None, error_model: ErrorModel | None
) -> Estimator | None:
    """The estimator of a trial; None for none.

    Args:
        task: What it is to believe.
        estimator: A name, or what makes one; if None, that with all senses where the
            pose that is read has errors, and none where it is exact.
        error_model: How large the errors of the senses are; their size is all that is told of it.

    Raises:
        NotFoundError: No estimator has that name.
        TaskError: It is none.
    """
    if estimator is None:
        estimator = default_estimator(error_model)
    errors = SensorErrors.of(error_model)
    if isinstance(estimator, str):
        if estimator == NONE:
            return None
        check_estimator(estimator)
        return ESTIMATORS[estimator].make(task, errors)
    made: object = estimator(task, errors) if callable(estimator) else estimator
    if not isinstance(made, Estimator):
        raise TaskError(
            f"{shown(estimator)} is no estimator; give a name "
            f"({', '.join((*ESTIMATORS, NONE))}), or "
            "what makes an object with step(observation) and events out of task and sensor errors"
        )
    return made
