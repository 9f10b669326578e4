"""Files of motions and of manipulations that were changed."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from random import Random

from planner.files import read_manipulation, read_motion
from planner.files.movements import movement_to_dict

from ..hostile import changed_json, damaged
from ..samples import Samples


def case(rng: Random, samples: Samples) -> Callable[[], object]:
    whole = rng.random() < 0.5
    sound = samples.manipulation() if whole else samples.motion()
    data = changed_json(sound, rng, rng.choice([1, 1, 1, 2, 5]))
    content = json.dumps(data).encode()
    if rng.random() < 0.1:
        content = damaged(content, rng)
    Path("motion.json").write_bytes(content)

    def read() -> None:
        if whole:
            manipulation = read_manipulation("motion.json")
            json.dumps(movement_to_dict(manipulation), allow_nan=False)
            str(manipulation)
        else:
            motion = read_motion("motion.json")
            json.dumps(movement_to_dict(motion), allow_nan=False)
            str(motion)

    return read
