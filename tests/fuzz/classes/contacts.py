"""Lists of contacts that a user typed in."""

from __future__ import annotations

import json
from pathlib import Path
from random import Random

from ..hostile import changed_json, damaged
from ..samples import Samples


def case(rng: Random, samples: Samples) -> list[str]:
    del samples
    contacts = []
    for _ in range(rng.choice([0, 1, 2, 3, 4, 5, 8, 40])):
        direction = [rng.gauss(0, 1) for _ in range(3)]
        contacts.append(
            {
                "position_m": [0.03 * x for x in direction],
                "normal_into_object": [-x for x in direction],
                "mu": rng.choice([0.0, 0.3, 0.5, 1.0]),
                "model": rng.choice(["point", "soft", "frictionless"]),
                "mu_torsion_m": rng.choice([0.0, 0.005]),
            }
        )
    data = changed_json({"contacts": contacts, "length_m": 0.03}, rng, rng.randrange(0, 4))
    content = json.dumps(data).encode()
    if rng.random() < 0.15:
        content = damaged(content, rng)
    if rng.random() < 0.02:
        content = b"[" * 200_000
    Path("contacts.json").write_bytes(content)
    command = ["analyse", "contacts.json"]
    return [*command, "--json"] if rng.random() < 0.3 else command
