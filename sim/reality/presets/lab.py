"""``lab``: a hand that was calibrated with care, and a good camera."""

from __future__ import annotations

import math

from sim.reality.errors import Reality, register_reality

__all__ = ["PRESET"]

PRESET = register_reality(
    Reality(
        name="lab",
        encoder_offset=math.radians(1.0),
        dry_friction=0.02,
        pose_noise=0.001,
        turn_noise=math.radians(1.0),
        pose_rate=60.0,
        pose_delay=0.03,
        object_mass=0.2,
        object_friction=0.3,
    )
)
