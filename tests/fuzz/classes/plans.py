"""Plan files that were changed."""

from __future__ import annotations

import json
from pathlib import Path
from random import Random

from ..hostile import changed_json, damaged
from ..samples import Samples

COMMANDS = (
    ["analyse", "plan.json"],
    ["analyse", "plan.json", "--forces"],
    ["certify", "plan.json"],
    ["test", "plan.json"],
)


def case(rng: Random, samples: Samples) -> list[str]:
    data = changed_json(samples.plan(), rng, rng.choice([1, 1, 1, 2, 5]))
    content = json.dumps(data).encode()
    if rng.random() < 0.1:
        content = damaged(content, rng)
    Path("plan.json").write_bytes(content)
    return rng.choices(COMMANDS, weights=[6, 6, 2, 1])[0]
