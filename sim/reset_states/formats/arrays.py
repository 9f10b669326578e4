"""``npz``: all columns as NumPy arrays by name; what the check of a cache reads."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sim.reset_states.formats.registry import StateFormat, register_state_format
from sim.reset_states.states import StateSet

STATES_FILE = "states.npz"
"""Name of the file in the folder of its object and size."""


def _write(states: StateSet, name: str, folder: Path) -> Path:
    path = folder / name / STATES_FILE
    states.write(path)
    return path


def _read(path: Path) -> Mapping[str, Any]:
    with np.load(path, allow_pickle=False) as file:
        return {key: file[key] for key in file.files}


register_state_format(
    StateFormat(
        name="npz",
        title="NumPy arrays by name",
        lost="",
        refuses=lambda states: "",
        write=_write,
        read=_read,
    )
)
