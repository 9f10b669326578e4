"""``Observer``: turns what a hand reads into what a controller sees.

A real hand lacks senses that a simulation has. What is missing is missing: a controller that asks
for it is refused with a line that says what to do, before anything is written where the controller
says what it needs (``sim.controllers.NeedsSenses``), else at the moment at which it asks. Planned
values stand in only where that is asked for by name (``assume``):

    object_pose   the object lies in the hand as planned, also while the hand moves
    touch         no finger touches before the closing is over; from then on each presses as planned

Where the base is not read, it is where the plan grasps: only the direction of gravity counts then.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import fields
from functools import partial
from typing import Any, cast

import numpy as np

from planner.errors import HandError, NotFoundError
from planner.hands.hand import Hand
from planner.plan import GraspPlan
from planner.spatial import SE3
from sim.controllers.base import Controller, NeedsSenses, Observation, Phase, Sense
from sim.controllers.pads import PadReading
from sim.real_hand.interface import HandInterface, HandReading

ASSUMABLE: tuple[Sense, ...] = ("object_pose", "touch")
"""Senses for which planned values may stand in."""

_SENSE_OF: dict[str, Sense] = {
    "normal_forces": "touch",
    "T_world_object": "object_pose",
}
"""Name in an ``Observation`` that is always there in a trial -> the sense that it takes."""


def _refuse(sense: Sense) -> Any:
    raise HandError(_missing("the controller", (sense,)))


_NOT_READ: dict[str, Any] = {
    "read_twist": partial(_refuse, "object_twist"),
    "read_pads": partial(_refuse, "pads"),
    "read_contacts": partial(_refuse, "contacts"),
}
"""What an ``Observation`` reads when it is first asked for, where a hand does not read it."""


class HandObservation(Observation):
    """An ``Observation`` of a hand that may lack senses.

    Asking for what there is no sense for raises ``HandError``.
    """

    def __init__(self, known: dict[str, Any]) -> None:
        """Hold what is known, by the names of ``Observation``."""
        self.__dict__.update(_NOT_READ | known)

    @property
    def feels(self) -> bool:
        """Whether the touch of fingers is known."""
        return "normal_forces" in self.__dict__

    @property
    def reads_pads(self) -> bool:
        """Whether the hand has pads."""
        return "pads" in self.__dict__ or self.__dict__["read_pads"] is not _NOT_READ["read_pads"]

    def altered(self, **changes: Any) -> HandObservation:
        """The same with other values of some fields."""
        kept = {k: v for k, v in self.__dict__.items() if f"read_{k}" not in changes}
        return HandObservation(kept | changes)

    def __getattr__(self, name: str) -> Any:
        """Refuse what there is no sense for; asked only where nothing is known by that name."""
        if name in _SENSE_OF:
            raise HandError(_missing("the controller", (_SENSE_OF[name],)))
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")


class Observer:
    """Makes observations of one hand for one plan.

    Attributes:
        assume: Senses for which planned values stand in.
        plan: What is executed; None where nothing is grasped.
    """

    def __init__(
        self,
        interface: HandInterface,
        hand: Hand,
        plan: GraspPlan | None = None,
        assume: Collection[str] = (),
    ) -> None:
        """Match the interface's names with the hand's.

        Args:
            interface: The hand that is read.
            hand: Its model.
            plan: What is executed; None where nothing is grasped.
            assume: Names out of ``ASSUMABLE``.

        Raises:
            HandError: Joints, actuators or fingers that do not match, or an assumption without a
                plan.
            NotFoundError: An assumption that there is not.
        """
        for name in assume:
            if name not in ASSUMABLE:
                raise NotFoundError("planned value that may stand in for a sense", name, ASSUMABLE)
        if assume and plan is None:
            raise HandError("planned values stand in for senses only where there is a plan")
        self.assume = cast("tuple[Sense, ...]", tuple(assume))
        self.plan = plan
        self._joints = places("joint", hand.joint_names, interface.joint_names)
        self.actuators = places("actuator", hand.actuation.names, interface.actuator_names)
        self._fingers: list[int] | None = None
        if plan is not None and interface.finger_names:
            self._fingers = [
                _place("finger", name, interface.finger_names) for name in plan.task.finger_names
            ]
        self._first: float | None = None
        if plan is not None:
            self._T_world_base = plan.T_world_base
            self._T_base_object = plan.T_world_base.inverse() * plan.task.T_world_object
            self._planned_forces = plan.contacts.forces[:, 0]

    def observe(self, reading: HandReading, phase: Phase, progress: float) -> HandObservation:
        """What the controller sees of a reading.

        Args:
            reading: Of the interface.
            phase: What the controller is told.
            progress: How much of it has passed, in [0, 1].
        """
        if self._first is None:
            self._first = reading.time
        known: dict[str, Any] = {
            "time": reading.time - self._first,
            "phase": phase,
            "progress": progress,
            "q": reading.joints[self._joints],
            "v": reading.velocities[self._joints],
        }
        base = reading.T_world_base
        if base is None and self.plan is not None:
            base = self._T_world_base
        known["T_world_base"] = SE3.Identity() if base is None else base
        if "object_pose" in self.assume:
            known["T_world_object"] = known["T_world_base"] * self._T_base_object
        elif reading.T_world_object is not None:
            known["T_world_object"] = reading.T_world_object
        if "touch" in self.assume:
            closed = phase not in ("approach", "close") or (phase == "close" and progress >= 1.0)
            known["normal_forces"] = self._planned_forces * closed
        elif reading.touch is not None:
            known["normal_forces"] = reading.touch[self._fingers]
        if reading.object_twist is not None:
            known["object_twist"] = reading.object_twist
        if reading.pads is not None:
            known["pads"] = self._own_pads(reading.pads)
        return HandObservation(known)

    def _own_pads(self, pads: PadReading) -> PadReading:
        """The rows of the fingers that take part, in their order."""
        if self._fingers is None or self._fingers == list(range(len(pads.normal_force))):
            return pads
        given = {field.name: getattr(pads, field.name) for field in fields(pads)}
        own = {
            name: value if np.size(value) == 1 else value[self._fingers]
            for name, value in given.items()
        }
        return PadReading(**own)

    def check_senses(self, controller: Controller, reading: HandReading) -> None:
        """Refuse a controller that needs what this hand has no sense for.

        Raises:
            HandError: It says that it needs a sense, and a reading holds none and nothing stands
                in.
        """
        if not isinstance(controller, NeedsSenses):
            return
        there = set(self.assume)
        seen: dict[Sense, object] = {
            "touch": reading.touch,
            "object_pose": reading.T_world_object,
            "object_twist": reading.object_twist,
            "pads": reading.pads,
        }
        there |= {sense for sense, value in seen.items() if value is not None}
        missing = tuple(sense for sense in controller.needs if sense not in there)
        if missing:
            raise HandError(_missing(type(controller).__name__, missing))


def places(what: str, wanted: tuple[str, ...], given: tuple[str, ...]) -> list[int]:
    """Where each wanted name stands among those given, which must be the same names.

    Raises:
        HandError: Names that are missing, unknown or given twice.
    """
    if len(set(given)) != len(given):
        twice = sorted({name for name in given if given.count(name) > 1})
        raise HandError(f"the interface names {what} {twice[0]} more than once; name each once")
    missing = [name for name in wanted if name not in given]
    unknown = [name for name in given if name not in wanted]
    if missing or unknown:
        parts = [f"lacks {', '.join(missing)}"] * bool(missing)
        parts += [f"has {', '.join(unknown)}, which the model has not"] * bool(unknown)
        raise HandError(
            f"the {what}s of the interface do not match the hand's model: it "
            f"{' and '.join(parts)}; use the model's names: {', '.join(wanted)}"
        )
    return [given.index(name) for name in wanted]


def _place(what: str, name: str, given: tuple[str, ...]) -> int:
    if name not in given:
        raise NotFoundError(f"{what} of the interface", name, given)
    return given.index(name)


def _missing(who: str, senses: tuple[Sense, ...]) -> str:
    """What to tell about senses that there are not."""
    named = " and ".join(senses)
    advice = "choose a controller that does without"
    if all(sense in ASSUMABLE for sense in senses):
        advice += f", or let planned values stand in: assume {', '.join(senses)}"
    return f"{who} needs {named}, which this hand does not read; {advice}"
