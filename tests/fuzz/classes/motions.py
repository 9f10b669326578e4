"""Motion files that were changed."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from random import Random

from planner.files import read_motion
from planner.files.motions import motion_to_dict

from ..hostile import changed_json, damaged
from ..samples import Samples


def case(rng: Random, samples: Samples) -> Callable[[], object]:
    data = changed_json(samples.motion(), rng, rng.choice([1, 1, 1, 2, 5]))
    content = json.dumps(data).encode()
    if rng.random() < 0.1:
        content = damaged(content, rng)
    Path("motion.json").write_bytes(content)

    def read() -> None:
        motion = read_motion("motion.json")
        json.dumps(motion_to_dict(motion), allow_nan=False)
        str(motion)

    return read
