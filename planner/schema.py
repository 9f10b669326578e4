"""Strict data of files, and the faults of a file in one sentence.

Base of hand descriptions, plan files and trial reports.
"""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, ValidationError

__all__ = ["StrictData", "faults_of"]

MOST_FAULTS = 5
"""Most faults in one message; the rest usually follow from these."""


class StrictData(BaseModel):
    """Data without unknown fields and without NaN or infinity."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def faults_of(error: ValidationError) -> str:
    """The first faults of a file, each with the field where it is."""
    return "; ".join(
        f"{'.'.join(str(key) for key in fault['loc']) or 'file'}: {fault['msg']}"
        for fault in error.errors()[:MOST_FAULTS]
    )
