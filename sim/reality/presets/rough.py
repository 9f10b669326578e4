"""``rough``: a hand out of its box, a cheap camera, an object whose data sheet is wrong.

Pose noise is white and drifts besides: half as much again, over 1 s, as the estimate of a marker
does when the hand turns in the light. A camera loses the object behind a finger about once in 3 s
(2 % of 15 poses a second) for 0.2 s. Commands go over a bus of 250 Hz and act 4 ms late. Pads are
those of ``lab``, with more noise.
"""

from __future__ import annotations

import math

from sim.reality.errors import Reality, register_reality

PRESET = register_reality(
    Reality(
        name="rough",
        encoder_offset=math.radians(3.0),
        encoder_scale=0.01,
        encoder_noise=math.radians(0.1),
        encoder_step=math.radians(0.1),
        rate_noise=0.02,
        dry_friction=0.04,
        torque_constant=0.1,
        command_delay=0.004,
        command_rate=250.0,
        pose_noise=0.003,
        turn_noise=math.radians(3.0),
        pose_drift=0.0015,
        turn_drift=math.radians(1.5),
        drift_time=1.0,
        pose_rate=15.0,
        pose_delay=0.08,
        dropout=0.02,
        dropout_time=0.2,
        touch_noise=0.05,
        touch_scale=0.1,
        touch_step=0.01,
        touch_threshold=0.05,
        touch_place=0.0006,
        touch_rate=100.0,
        touch_delay=0.01,
        sliding_noise=0.002,
        object_size=0.02,
        object_mass=0.3,
        object_center=0.1,
        object_friction=0.4,
    )
)
