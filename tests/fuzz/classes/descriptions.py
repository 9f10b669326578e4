"""Hand descriptions: a shipped hand.toml with lines changed, left out or doubled."""

from __future__ import annotations

from pathlib import Path
from random import Random

from ..hostile import damaged, replaced_numbers
from ..samples import Samples

COMMANDS = (
    ["hands", "hand.toml", "--check"],
    ["hands", "hand.toml"],
    ["plan", "hand.toml", "sphere", "--max-attempts", "1", "--rounds", "0"],
)


def case(rng: Random, samples: Samples) -> list[str]:
    lines = samples.description.splitlines()
    for _ in range(rng.choice([0, 0, 0, 0, 1, 2])):
        k = rng.randrange(len(lines))
        kind = rng.randrange(3)
        if kind == 0:
            del lines[k]
        elif kind == 1:
            lines.insert(rng.randrange(len(lines)), lines[k])
        else:
            lines[k] = rng.choice(EXTRA)
    text = "\n".join(lines)
    kept = [line for line in lines if line.startswith("model")]
    if rng.random() < 0.9:
        text = replaced_numbers(text, rng, rng.randrange(1, 4), words=0.15)
    if kept and rng.random() < 0.9:  # most cases are about the description, not about its model
        text = "\n".join(kept[0] if s.startswith("model") else s for s in text.splitlines())
    content = text.encode(errors="replace")
    if rng.random() < 0.05:
        content = damaged(content, rng)
    Path("hand.toml").write_bytes(content)
    return rng.choices(COMMANDS, weights=[4, 3, 1])[0]


EXTRA = (
    '[[couplings]]\nname = "a"\nkind = "tie"\njoints = { thumb_0 = 0.0 }',
    '[[couplings]]\nname = "a"\nkind = "stop"\njoints = { thumb_0 = 1e300, thumb_1 = 1 }',
    'name = "../../../x"',
    "[repair]\nbalance_inertia = true",
    'drop_collision = ["nothing"]',
    "[postures.open]\nthumb_0 = nan",
    "[[fingers]]",
    "schema = 2",
)
