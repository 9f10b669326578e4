"""Hostile numbers, texts and changes, drawn from a seeded generator."""

from __future__ import annotations

import copy
import math
import re
from random import Random
from typing import Any

import numpy as np

NUMBERS: tuple[float, ...] = (
    0.0, -0.0, 1.0, -1.0, 1e-300, 5e-324, 1e-9, 1e-3, 0.5, 2.0, 10.0, 1e3, 1e7, 1e11, 1e18, 1e154,
    1e300, 1.7e308, -1e300, math.inf, -math.inf, math.nan, float(2**31), float(2**63), -2.0**63,
)  # fmt: skip

TEXTS = (
    "", " ", "nan", "inf", "-inf", "1e999", "0x10", "1,2", "..", "../../../x", "/etc/passwd",
    "a\0b", "x" * 5000, "é", "\u202e", "\ud800", "[bold]", "%s", "None", "true", "-1",
    "1_0", "\n", "🖐", "{}",
)  # fmt: skip


def number(rng: Random) -> float:
    """A hostile number, or now and then a plain one."""
    return rng.uniform(-2.0, 2.0) if rng.random() < 0.2 else rng.choice(NUMBERS)


def number_text(rng: Random) -> str:
    """A number as text, or what may stand where one belongs."""
    if rng.random() < 0.15:
        return rng.choice(TEXTS).replace("\0", "").encode(errors="replace").decode()
    value = number(rng)
    return repr(int(value)) if math.isfinite(value) and rng.random() < 0.4 else repr(value)


def text(rng: Random) -> str:
    """A hostile text."""
    return rng.choice(TEXTS)


def value(rng: Random) -> Any:
    """Anything that JSON can hold, more or less."""
    kind = rng.randrange(7)
    if kind < 3:
        return number(rng)
    return (text(rng), None, [], {})[kind - 3]


def changed_json(data: Any, rng: Random, changes: int = 1) -> Any:
    """A copy of JSON data with some places changed, left out, doubled or swapped."""
    data = copy.deepcopy(data)
    for _ in range(changes):
        places = list(_places(data))
        if not places:
            break
        holder, key = rng.choice(places)
        kind = rng.randrange(6)
        if kind == 0:
            del holder[key]
        elif kind == 1 and isinstance(holder, list):
            holder.append(copy.deepcopy(holder[key]))
        elif kind == 2:
            other, name = rng.choice(places)
            holder[key] = copy.deepcopy(other[name])
        elif kind == 3 and isinstance(holder[key], int | float):
            holder[key] = holder[key] * rng.choice([-1, 0, 1 + 1e-7, 1.01, 2, 1e6])
        elif kind == 4 and isinstance(holder, dict):
            holder[text(rng)] = holder.pop(key)
        else:
            holder[key] = value(rng)
    return data


def _places(data: Any) -> Any:
    items = data.items() if isinstance(data, dict) else enumerate(data)
    for key, item in list(items):
        yield data, key
        if isinstance(item, dict | list):
            yield from _places(item)


def replaced_numbers(source: str, rng: Random, changes: int, *, words: float = 0.1) -> str:
    """A text with some numbers replaced by hostile ones or multiplied, or words by other words.

    Args:
        source: The text.
        rng: Where chance comes from.
        changes: How many.
        words: Share of the changes that are to words.
    """
    for _ in range(changes):
        if rng.random() < words:
            found = list(re.finditer(r"[A-Za-z_]\w*", source))
            new = rng.choice(["", rng.choice(found).group() if found else "", text(rng)])
        else:
            found = list(re.finditer(r"(?<![\w.])-?\d+\.?\d*(?:e-?\d+)?(?!\w)", source))
            new = number_text(rng)
        if not found:
            break
        match = rng.choice(found)
        if match.group()[0] in "-0123456789" and rng.random() < 0.6:
            new = f"{float(match.group()) * rng.choice(FACTORS):.6g}"
        source = source[: match.start()] + new.replace("\0", "") + source[match.end() :]
    return source


FACTORS = (-1.0, 0.0, 0.5, 0.999, 1.001, 1.1, 2.0, 10.0, 1e-3, 1e3)


def damaged(content: bytes, rng: Random) -> bytes:
    """Bytes with some flipped, cut, doubled, or put in."""
    data = bytearray(content)
    for _ in range(rng.randrange(1, 4)):
        place = rng.randrange(len(data) + 1)
        kind = rng.randrange(5)
        if kind == 0 and data:
            data[min(place, len(data) - 1)] ^= 1 << rng.randrange(8)
        elif kind == 1:
            del data[place:]
        elif kind == 2:
            del data[place : place + rng.randrange(1, 50)]
        elif kind == 3:
            data[place:place] = data[place : place + rng.randrange(1, 200)]
        else:
            data[place:place] = rng.randbytes(rng.randrange(1, 20))
    return bytes(data)


def array(rng: Random, *shape: int) -> Any:
    """An array of a shape, hostile in its numbers, its shape or its kind; sometimes sound."""
    base = np.random.default_rng(rng.randrange(2**32)).normal(size=shape)
    kind = rng.randrange(12)
    if kind == 0:
        return base
    if kind == 1:
        return base.T if base.ndim > 1 else base[:, None]
    if kind == 2:
        return base.ravel()[: rng.randrange(base.size + 1)]
    if kind == 3:
        return base[None]
    if kind in (4, 5, 6):
        base.ravel()[rng.randrange(max(base.size, 1)) :][:1] = number(rng)
        return base
    if kind == 7:
        return base * number(rng)
    if kind == 8:
        return base.tolist()
    if kind == 9:
        return rng.choice([None, "text", {}, object(), b"bytes", 10**400, base * 1j, [[1], [1, 2]]])
    if kind == 10:
        return number(rng)
    return base.astype(rng.choice(["float32", "int64", "object", "U5", "bool"]))
