"""Senses of touch by name: what turns the truth of a step into what pads say.

Each has a file and one registration. All give the same ``PadReading``, so that a controller or an
estimator runs with any of them; ``Reality.touch`` names the one of a trial.

    exact     MuJoCo's own contacts: force, place, normal and sliding without error
    taxels    arrays of taxels (``sim.tactile.taxels``)
    effort    the torques of the motors (``sim.tactile.effort``)
    binary    whether a pad touches, and nothing else (``sim.tactile.binary``)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

from planner.errors import NotFoundError, TaskError
from planner.plan import GraspPlan
from sim.controllers import Observation
from sim.scene import Scene


class TouchSense(Protocol):
    """A sense of touch during one trial."""

    def read(self, truth: Observation) -> Observation:
        """The observation with what this sense feels; called once a time step, in order."""
        ...


@dataclass(frozen=True, kw_only=True, eq=False)
class TouchContext:
    """What a sense is made from.

    Attributes:
        scene: The scene.
        data: ``mujoco.MjData``, as it is at every step.
        plan: What is executed: where contacts were planned.
        seed: Of all noise.
        dry_friction: Of every joint beside what the hand's model has, N m (N for slides): a
            laboratory knows about how stiff its hand turns.
    """

    scene: Scene
    data: Any
    plan: GraspPlan
    seed: int
    dry_friction: float = 0.0


MakeSense: TypeAlias = Callable[[TouchContext], TouchSense]
"""What makes a sense for a trial."""

_SENSES: dict[str, MakeSense] = {}

TOUCH_SENSES: Mapping[str, MakeSense] = _SENSES
"""Senses by their names."""


def register_touch(name: str, make: MakeSense) -> MakeSense:
    """Make a sense of touch known by a name, and return what makes it.

    Raises:
        TaskError: Another one has that name.
    """
    if _SENSES.setdefault(name, make) is not make:
        raise TaskError(f"there is a sense of touch {name!r} already; give another name")
    return make


def check_touch(name: str) -> str:
    """The name of a sense, checked.

    Raises:
        NotFoundError: There is none of that name.
    """
    if name not in TOUCH_SENSES:
        raise NotFoundError("sense of touch", name, sorted(TOUCH_SENSES))
    return name


def make_sense(name: str, context: TouchContext) -> TouchSense:
    """The sense of a name, for a trial.

    Raises:
        NotFoundError: There is none of that name.
    """
    return TOUCH_SENSES[check_touch(name)](context)
