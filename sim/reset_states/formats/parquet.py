"""``parquet``: one row per state, one list column per array, names and units in the metadata."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from planner.batch.rows import arrow
from planner.errors import TaskError
from planner.files.json_csv import whole_file
from sim.reset_states.formats.registry import StateFormat, register_state_format
from sim.reset_states.states import FORMAT, VERSION, StateSet

PARQUET_FILE = "states.parquet"
"""Name of the file in the folder of its object and size."""

_LISTS = {
    "joint_position": "q",
    "joint_target": "targets",
    "command": "commands",
    "object_position_m": "position",
    "object_quaternion_wxyz": "quaternion",
    "gravity_m_s2": "gravity",
}
_NUMBERS = {"mass_kg": "mass", "friction": "friction", "source_plan": "plan", "source_pose": "pose"}


def _write(states: StateSet, name: str, folder: Path) -> Path:
    pa = arrow()
    columns: dict[str, Any] = {}
    for key, attribute in _LISTS.items():
        rows = getattr(states, attribute)
        columns[key] = pa.FixedSizeListArray.from_arrays(pa.array(rows.ravel()), rows.shape[1])
    columns |= {key: pa.array(getattr(states, name)) for key, name in _NUMBERS.items()}
    columns["scale"] = pa.array(np.full(len(states), states.scale))
    columns["source_kind"] = pa.array(states.kind.tolist())
    about = {
        "format": FORMAT,
        "version": VERSION,
        "hand": states.hand,
        "object": states.object,
        "scene": states.scene,
        "joint_names": states.joint_names,
        "actuator_names": states.actuator_names,
    }
    table = pa.table(columns).replace_schema_metadata({FORMAT: json.dumps(about)})
    path = folder / name / PARQUET_FILE
    with whole_file(path) as stream:
        pa.parquet.write_table(table, stream)
    return path


def _read(path: Path) -> Mapping[str, Any]:
    table = arrow().parquet.read_table(path)
    about: dict[str, Any] = json.loads((table.schema.metadata or {}).get(FORMAT.encode(), b"{}"))
    return about | {
        key: np.stack(table[key].to_numpy()) if key in _LISTS else table[key].to_numpy()
        for key in table.column_names
    }


def _refuses(states: StateSet) -> str:
    try:
        arrow()
    except TaskError as error:
        return str(error)
    return ""


register_state_format(
    StateFormat(
        name="parquet",
        title="one row per state",
        lost="",
        refuses=_refuses,
        write=_write,
        read=_read,
    )
)
