"""What was drawn of a reality, for people: ``drawn_numbers`` and ``draws_in_words``.

Called for reports and pages of trials, and by protocols, which show the range over their trials.
A failure then has its likely cause beside it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from planner.hands.hand import Hand
from planner.kinematics.state import joint_axes
from planner.spatial import FloatArray
from sim.reality.drawn import Drawn

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


def draws_in_words(numbers: Iterable[Mapping[str, float]]) -> str:
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
