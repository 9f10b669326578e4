"""A small dataset, a large one made out of it, and sites that are served while a test runs."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from planner.batch import GraspSet, plan_grasps
from planner.batch.recipe import MANIFEST, read_manifest
from planner.batch.rows import arrow
from planner.batch.store import ATTEMPTS, GRASPS, OWNER, shard_file
from planner.synthesis.options import SynthesisOptions
from planner.task import GraspTask
from sim.show.browser import LocalServer, Site

OBJECTS = ("sphere:0.035", "box:0.05x0.05x0.08")
"""Objects of the small dataset."""

REASON = "true geometry: thumb touches 110 degrees off its pad axis, outside the pad"
"""Why a row of the large dataset has no grasp."""


@contextmanager
def serving(site: Site) -> Iterator[LocalServer]:
    """A site on a free port."""
    server = LocalServer(site, 0)
    thread = threading.Thread(target=server.run)
    thread.start()
    try:
        yield server
    finally:
        server.stop()
        thread.join()
        server.close()


def small_dataset(folder: Path, n: int = 3) -> Path:
    """Grasps of two objects, n each, planned in this process."""
    tasks = [GraspTask.create("allegro_hand", item) for item in OBJECTS]
    options = SynthesisOptions(rounds=0)
    plan_grasps(tasks[0].hand, tasks, n, workers=1, out=folder, options=options)
    return folder


def large_dataset(small: Path, folder: Path, n: int) -> Path:
    """A dataset of n rows that repeat the first object's grasps; every seventh row has none.

    Epsilon of row i is 1e-4 times i, so that sorted and filtered rows are known.
    """
    pa = arrow()
    grasps = GraspSet(small)
    manifest = grasps.manifest.model_copy(update={"n": n, "objects": grasps.manifest.objects[:1]})
    label = manifest.objects[0].label
    for table in (GRASPS, ATTEMPTS):
        (folder / table).mkdir(parents=True)
    (folder / MANIFEST).write_text(manifest.model_dump_json(), encoding="utf-8")
    owner = {OWNER.encode(): (read_manifest(folder).digest or "").encode()}
    whole, attempts = grasps.table(), grasps.attempts()
    found = [row for row in whole.to_pylist() if row["object"] == label and row["found"]]
    for shard in range(manifest.n_shards):
        first = shard * manifest.shard_rows
        numbers = range(first, first + manifest.rows_in(shard))
        rows = [_row(found[i % len(found)], i) for i in numbers]
        tries = [
            {"object": label, "k": i, "attempt": 0, "reason": row["reason"], "cpu_s": 0.1}
            for i, row in zip(numbers, rows, strict=True)
        ]
        for table, made, schema in (
            (GRASPS, rows, whole.schema),
            (ATTEMPTS, tries, attempts.schema),
        ):
            data = pa.Table.from_pylist(made, schema=schema)
            data = data.replace_schema_metadata({**(schema.metadata or {}), **owner})
            pa.parquet.write_table(data, shard_file(folder, table, shard))
    return folder


def _row(like: dict[str, Any], i: int) -> dict[str, Any]:
    if i % 7 == 0:
        kept = {"object": like["object"], "k": i, "seed": i, "attempts": 1, "cpu_s": 0.1}
        return dict.fromkeys(like) | kept | {"found": False, "reason": REASON}
    return {**like, "k": i, "epsilon": 1e-4 * i}
