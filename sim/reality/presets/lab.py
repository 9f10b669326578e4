"""``lab``: a hand that was calibrated with care, good tactile pads, and a good camera.

What is no calibration is taken from data sheets and papers; docs/how/sensors.md names them.
"""

from __future__ import annotations

import math

from sim.reality.errors import Reality, register_reality

PRESET = register_reality(
    Reality(
        name="lab",
        encoder_offset=math.radians(1.0),
        encoder_noise=math.radians(0.05),
        encoder_step=math.radians(0.1),
        rate_noise=0.02,
        dry_friction=0.02,
        command_delay=0.003,
        command_rate=1000.0 / 3.0,
        pose_noise=0.001,
        turn_noise=math.radians(1.0),
        pose_rate=60.0,
        pose_delay=0.03,
        touch_noise=0.03,
        touch_scale=0.1,
        touch_step=0.01,
        touch_threshold=0.05,
        touch_place=0.0006,
        touch_rate=100.0,
        touch_delay=0.01,
        sliding_noise=0.002,
        object_mass=0.2,
        object_friction=0.3,
    )
)
