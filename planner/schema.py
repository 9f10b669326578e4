"""Strict data of files, and the faults of a file in one sentence.

Base of hand descriptions, plan files and trial reports.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

__all__ = ["StrictData", "faults_of"]

MOST_FAULTS = 5
"""Most faults in one message; the rest usually follow from these."""


class StrictData(BaseModel):
    """Data without unknown fields and without NaN or infinity."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def faults_of(error: ValidationError, raw: Any = None) -> str:
    """The first faults of a file, each with the field where it is.

    Args:
        error: What the schema says.
        raw: The content that was read: entries of a list that have a name are called by it.
    """
    return "; ".join(
        f"{_place(fault['loc'], raw) or 'file'}: {fault['msg'].removeprefix('Value error, ')}"
        for fault in error.errors()[:MOST_FAULTS]
    )


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
