"""Batch folders: Parquet, manifest and journal with changed bytes or rows."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from random import Random

import pyarrow as pa
import pyarrow.parquet as pq

from planner.batch import GraspSet
from sim.cli.batch import batch_summary

from ..hostile import changed_json, damaged
from ..samples import Samples


def case(rng: Random, samples: Samples) -> Callable[[], object] | list[str]:
    folder = samples.batch(Path("b"))
    file = rng.choice(["grasps/part-000000.parquet"] * 4 + ["manifest.json", "journal.jsonl"])
    path, how = folder / file, rng.randrange(5)
    if file == "manifest.json" and how:
        data = json.loads(path.read_text(encoding="utf-8"))
        path.write_text(json.dumps(changed_json(data, rng)), encoding="utf-8")
    elif file == "journal.jsonl" and how:
        rows = pq.read_table(folder / "grasps/part-000000.parquet").to_pylist()
        (folder / "grasps/part-000000.parquet").unlink()
        lines = [json.dumps(changed_json(row, rng, rng.randrange(2)), default=str) for row in rows]
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    elif how == 0 or not path.is_file():
        path.write_bytes(damaged(path.read_bytes(), rng))
    else:
        _change_rows(path, rng)
    if rng.random() < 0.2:
        return ["batch", "b", "--extract", str(rng.randrange(5))]
    if rng.random() < 0.1:
        return ["batch", "allegro_hand", "sphere", "-n", "4", "--workers", "1", "--out", "b"]
    return _read


def _change_rows(path: Path, rng: Random) -> None:
    table = pq.read_table(path)
    name = rng.choice(table.column_names)
    values = table.column(name).to_pylist()
    k = rng.randrange(len(values))
    how = rng.randrange(5)
    if how == 0:
        pq.write_table(table.drop([name]), path)
        return
    if how == 1:
        values[k] = None
    elif how == 2 and isinstance(values[k], list):
        values[k] = values[k][: rng.randrange(len(values[k]) + 1)]
    elif how == 3 and isinstance(values[k], list) and values[k]:
        if isinstance(values[k][0], float):
            values[k][rng.randrange(len(values[k]))] = rng.choice([math.nan, math.inf, 1e300])
        else:
            values[k] = values[k] * 2
    elif isinstance(values[k], float):
        values[k] = rng.choice([math.nan, math.inf, -1.0, 1e300])
    elif isinstance(values[k], str):
        values[k] = rng.choice(["", "x" * 5000, "../../x", "[", "{}"])
    elif isinstance(values[k], int) and not isinstance(values[k], bool):
        values[k] = rng.choice([-1, 0, 2**31, 10**9])
    index = table.column_names.index(name)
    field = table.schema.field(name)
    try:
        column = pa.array(values, type=field.type)
    except pa.ArrowInvalid:  # lists of a fixed length: another length is another type
        column = pa.array(values)
        field = pa.field(name, column.type)
    pq.write_table(table.set_column(index, field, column), path)


def _read() -> None:
    grasps = GraspSet("b")
    for label in grasps.labels:
        grasps.thinned(label)
    batch_summary(grasps)
    list(grasps.attempts())
    for k in range(len(grasps)):
        grasps.plan(k)
