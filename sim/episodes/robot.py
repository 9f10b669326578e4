"""``Robot``: names and units of a hand's joints, actuators and contacts in a data set."""

from __future__ import annotations

from dataclasses import dataclass, fields

import mujoco

from planner.errors import TaskError, shown
from planner.hands.hand import Hand
from sim.recording import PALM

SERVO_TOL = 1e-9
"""Relative difference of gain and stiffness (-) up to which a command is the servo's target."""

NO_UNIT = "-"


@dataclass(frozen=True, kw_only=True)
class Robot:
    """What all episodes of one data set have in common.

    Attributes:
        name: Of the hand.
        joint_names: nq names, the order of ``Recording.q``.
        joint_units: "rad" or "m" per joint.
        actuator_names: nu names, the order of ``Recording.commands``.
        command_units: Per actuator: "rad" or "m" for the target of a position servo, "N m" or "N"
            for a torque or force, "-" where the model scales the command by a gain.
        contact_names: Columns of contacts: every finger of the hand, then ``PALM``.
    """

    name: str
    joint_names: tuple[str, ...]
    joint_units: tuple[str, ...]
    actuator_names: tuple[str, ...]
    command_units: tuple[str, ...]
    contact_names: tuple[str, ...]

    @classmethod
    def of(cls, hand: Hand) -> Robot:
        """Of a hand; an arm that carries it counts as part of it."""
        slide = int(mujoco.mjtJoint.mjJNT_SLIDE)
        types = [int(hand.mj_model.joint(name).type[0]) for name in hand.joint_names]
        return cls(
            name=hand.name,
            joint_names=hand.joint_names,
            joint_units=tuple("m" if kind == slide else "rad" for kind in types),
            actuator_names=hand.actuation.names,
            command_units=tuple(
                _command_unit(hand, i, [kind == slide for kind in types])
                for i in range(len(hand.actuation.names))
            ),
            contact_names=(*hand.fingers, PALM),
        )

    def refuse_unless_same(self, other: Robot, source: str) -> None:
        """Check that an episode is of this robot.

        Args:
            other: The episode's.
            source: What the error calls the episode.

        Raises:
            TaskError: Names or units differ; says the first that do.
        """
        for field in fields(self):
            ours, theirs = getattr(self, field.name), getattr(other, field.name)
            if ours != theirs:
                raise TaskError(
                    f"{source} is of another hand: its {field.name.replace('_', ' ')} are "
                    f"{_first_difference(theirs, ours)} before it; one data set "
                    "holds one hand, so write another folder for each"
                )


def _first_difference(theirs: str | tuple[str, ...], ours: str | tuple[str, ...]) -> str:
    if isinstance(theirs, str) or isinstance(ours, str) or len(theirs) != len(ours):
        return f"{shown(theirs)}, and {shown(ours)}"
    k = next(i for i, pair in enumerate(zip(theirs, ours, strict=True)) if pair[0] != pair[1])
    return f"{shown(theirs[k])} at place {k}, and {shown(ours[k])}"


def _command_unit(hand: Hand, i: int, slides: list[bool]) -> str:
    """Unit of the command of actuator i, by its law F = gain ctrl + bias1 length + ...."""
    actuation = hand.actuation
    gain, stiffness = float(actuation.gain[i]), -float(actuation.bias[i, 1])
    driven = [slides[k] for k in range(len(slides)) if actuation.moment[i, k]]
    linear = bool(driven) and all(driven)
    if abs(gain - stiffness) <= SERVO_TOL * abs(gain):
        return "m" if linear else "rad"
    if stiffness == 0.0 and gain == 1.0:
        return "N" if linear else "N m"
    return NO_UNIT
