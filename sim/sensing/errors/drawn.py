"""``Drawn``: the errors of one trial, drawn from the seed of an ``ErrorModel``.

Every error has a stream of random numbers of its own, named by its field: a ``SeedSequence`` of
the seed whose spawn key is a checksum of the name. Streams give standard numbers, which the field
only scales. So an error that is added or changed leaves the draws of all others as they were, and
doubles with its field.

``drawn_numbers`` and ``drawn_text``: what was drawn, for people.

Called for reports and pages of trials, and by protocols, which show the range over their trials.
A failure then has its likely cause beside it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from planner.hands.hand import Hand
from planner.kinematics import joint_axes
from planner.spatial import FloatArray
from sim.sensing.errors.model import ErrorModel


def stream(seed: int, name: str) -> np.random.Generator:
    """The random numbers of one error."""
    key = (crc32(name.encode()),)
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


def hand_actuators(hand: Hand) -> NDArray[np.bool_]:
    """Which actuators (nu,) drive joints of the hand, not of an arm that carries it."""
    own = np.setdiff1d(np.arange(hand.nq), hand.arm_index)
    drives: NDArray[np.bool_] = (hand.actuation.moment[:, own] != 0).any(axis=1)
    return drives


@dataclass(frozen=True, kw_only=True, eq=False)
class Drawn:
    """What stays the same during a trial.

    Attributes:
        encoder_offset: (nq,), reading minus joint at a joint of 0, rad or m; 0 for an arm's.
        encoder_scale: (nq,), growth of the reading per joint, less 1 (-); 0 for an arm's.
        torque_constant: (nu,), true over nominal force of each actuator, less 1 (-).
        pose_bias: (3,), constant error of the object's position, m.
        turn_bias: (3,), rotation vector, rad, world axes.
        touch_scale: (fingers of the hand,), growth of a finger's felt force, less 1 (-).
        size: True over nominal lengths of the object (-).
        mass: True over nominal mass (-).
        center: (3,), centre of mass, as a share of half the extents, object's axes (-).
        friction: True over nominal friction (-).
    """

    encoder_offset: FloatArray
    encoder_scale: FloatArray
    torque_constant: FloatArray
    pose_bias: FloatArray
    turn_bias: FloatArray
    touch_scale: FloatArray
    size: float
    mass: float
    center: FloatArray
    friction: float

    @classmethod
    def of(cls, error_model: ErrorModel, hand: Hand) -> Drawn:
        """Draw for a hand."""
        nq, nu = hand.nq, len(hand.actuation.names)
        of_hand = np.ones(nq)
        of_hand[hand.arm_index] = 0.0

        def normal(name: str, n: int) -> FloatArray:
            numbers = stream(error_model.seed, name).standard_normal(n)
            return np.asarray(error_model.numbers[name] * numbers)

        def uniform(name: str, n: int) -> FloatArray:
            numbers = stream(error_model.seed, name).uniform(-1.0, 1.0, n)
            return np.asarray(error_model.numbers[name] * numbers)

        return cls(
            encoder_offset=of_hand * normal("encoder_offset", nq),
            encoder_scale=of_hand * normal("encoder_scale", nq),
            torque_constant=hand_actuators(hand) * uniform("torque_constant", nu),
            pose_bias=normal("pose_bias", 3),
            turn_bias=normal("turn_bias", 3),
            touch_scale=uniform("touch_scale", len(hand.fingers)),
            size=1.0 + float(uniform("object_size", 1)[0]),
            mass=1.0 + float(uniform("object_mass", 1)[0]),
            center=uniform("object_center", 3),
            friction=1.0 + float(uniform("object_friction", 1)[0]),
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain data, by the names of the attributes."""
        return {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in vars(self).items()}


PHRASES: Mapping[str, tuple[str, float, int]] = {
    "largest_encoder_offset_deg": ("joints up to {} degrees off", 0.0, 1),
    "largest_slide_offset_mm": ("slides up to {} mm off", 0.0, 1),
    "largest_encoder_scale_percent": ("joint scales up to {} % off", 0.0, 1),
    "largest_torque_percent": ("actuator forces up to {} % off", 0.0, 0),
    "pose_bias_mm": ("poses {} mm aside", 0.0, 1),
    "turn_bias_deg": ("poses turned by {} degrees", 0.0, 1),
    "largest_touch_percent": ("felt forces up to {} % off", 0.0, 0),
    "size_factor": ("size x {}", 1.0, 3),
    "mass_factor": ("mass x {}", 1.0, 2),
    "largest_center_percent": ("centre of mass up to {} % of half the extents aside", 0.0, 0),
    "friction_factor": ("friction x {}", 1.0, 2),
}
"""Phrase of each number, what it is without an error, and decimals that are shown."""


def drawn_numbers(drawn: Drawn, hand: Hand) -> dict[str, float]:
    """The draws of a trial as few numbers, by the names of ``PHRASES``; all of them.

    Args:
        drawn: What was drawn.
        hand: Whose joints it is about.
    """
    hinges = np.ones(hand.nq, dtype=bool)
    model = hand.pin_model
    for j, axis in enumerate(joint_axes(model)):
        if j:
            hinges[model.joints[j].idx_q] = axis[3:].any()
    turned = np.where(hinges, drawn.encoder_offset, 0.0)
    return {
        "largest_encoder_offset_deg": float(np.rad2deg(_largest(turned))),
        "largest_slide_offset_mm": 1e3 * _largest(drawn.encoder_offset[~hinges]),
        "largest_encoder_scale_percent": 100.0 * _largest(drawn.encoder_scale),
        "largest_torque_percent": 100.0 * _largest(drawn.torque_constant),
        "pose_bias_mm": 1e3 * float(np.linalg.norm(drawn.pose_bias)),
        "turn_bias_deg": float(np.rad2deg(np.linalg.norm(drawn.turn_bias))),
        "largest_touch_percent": 100.0 * _largest(drawn.touch_scale),
        "size_factor": drawn.size,
        "mass_factor": drawn.mass,
        "largest_center_percent": 100.0 * _largest(drawn.center),
        "friction_factor": drawn.friction,
    }


def drawn_text(numbers: Iterable[Mapping[str, float]]) -> str:
    """One line about the draws of some trials; "" if nothing was off.

    Of several trials it says the largest errors, and between what factors lie.
    """
    trials, said = list(numbers), []
    for name, (phrase, exact, digits) in PHRASES.items():
        values = [one[name] for one in trials if name in one]
        if any(value != exact for value in values):
            least, most = f"{min(values):.{digits}f}", f"{max(values):.{digits}f}"
            spread = name.endswith("_factor") and least != most
            said.append(phrase.format(f"{least} to {most}" if spread else most))
    return ", ".join(said)


def _largest(values: FloatArray) -> float:
    return float(np.abs(values).max(initial=0.0))
