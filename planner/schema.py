"""Strict data of files, and the faults of a file in one sentence.

Base of hand descriptions, plan files and trial reports.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import ErrorDetails

from planner.arrays import LARGEST_FLOAT, LARGEST_INT
from planner.errors import shown

__all__ = [
    "LARGEST",
    "Finite",
    "NotNegative",
    "StrictData",
    "Vector3",
    "Vector4",
    "faults_of",
    "told_of",
]

LARGEST = 1e6
"""Largest number, either sign, in SI units: no grasp has a larger one, and its square is finite."""

Finite = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-LARGEST, le=LARGEST)]
"""A number of a file, no text and no truth value, up to ``LARGEST``."""

NotNegative = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=LARGEST)]
"""A number of a file, 0 to ``LARGEST``."""

Vector3 = tuple[Finite, Finite, Finite]
"""Three numbers of a file."""

Vector4 = tuple[Finite, Finite, Finite, Finite]
"""Four numbers of a file."""

OF_OTHERS = {"value_error", "assertion_error"}
"""Kinds of faults that are told in our own words already."""

MOST_FAULTS = 5
"""Most faults in one message; the rest usually follow from these."""


class StrictData(BaseModel):
    """Data without unknown fields, without NaN or infinity, and without numbers beyond a bound."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)

    @model_validator(mode="after")
    def _bounded(self) -> Self:
        """Refuse the first number beyond the bound, in fields of any type, by its place."""
        for name in type(self).model_fields:
            field = getattr(self, name)
            if not _within(field):
                place, value = next(_beyond(field, name))
                largest = LARGEST_FLOAT if isinstance(value, float) else LARGEST_INT
                raise ValueError(f"{place} is {shown(value)}; numbers up to {largest:g} are read")
        return self


def _within(value: Any) -> bool:
    """Whether ``_beyond`` finds nothing: a report holds 50,000 numbers, and no place is named."""
    if isinstance(value, float):
        return abs(value) <= LARGEST_FLOAT
    if isinstance(value, int):
        return abs(value) <= LARGEST_INT
    if isinstance(value, list | tuple):
        return all(map(_within, value))
    return not isinstance(value, dict) or all(map(_within, value.values()))


def _beyond(value: Any, place: str) -> Iterator[tuple[str, float]]:
    """Numbers beyond the bound, with their places; other ``StrictData`` looks at its own."""
    if isinstance(value, float | int):
        if not abs(value) <= (LARGEST_FLOAT if isinstance(value, float) else LARGEST_INT):
            yield place, value
    elif isinstance(value, dict):
        for key, inner in value.items():
            yield from _beyond(inner, f"{place}.{key}")
    elif isinstance(value, list | tuple):
        for i, inner in enumerate(value):
            yield from _beyond(inner, f"{place}.{i}")


def faults_of(error: ValidationError, raw: Any = None) -> str:
    """The first faults of a file, each with the field where it is.

    Args:
        error: What the schema says.
        raw: The content that was read: entries of a list that have a name are called by it.
    """
    return "; ".join(
        f"{_place(fault['loc'], raw) or 'file'}{told_of(fault)}"
        for fault in error.errors()[:MOST_FAULTS]
    )


def told_of(fault: ErrorDetails) -> str:
    """What is wrong with a value, after its name: what was given, and what is allowed."""
    kind, text = fault["type"], fault["msg"]
    if kind == "missing":
        return " is missing"
    if kind == "extra_forbidden":
        return " is no field that is known; leave it out, or correct its name"
    _, should, allowed = re.split(", unable to| after validation", text)[0].partition(" should ")
    if kind in OF_OTHERS or not should:
        return f": {text.removeprefix('Value error, ')}"
    allowed = allowed.replace("a valid i", "an i").replace("a valid ", "a ")
    return f" is {shown(fault['input'])}; it should {allowed}"


def _place(keys: Sequence[int | str], raw: Any) -> str:
    """A field, keys joined by dots; the entry of a list that has a name is called by it."""
    out = ""
    for key in keys:
        try:
            raw = raw[key]
        except (KeyError, IndexError, TypeError):  # a field that is missing, or no content given
            raw = None
        named = isinstance(key, int) and isinstance(raw, Mapping) and "name" in raw
        if named:
            out += f"[{raw['name']}]"
        else:
            out += f"{'.' * bool(out)}{key}"
    return out
