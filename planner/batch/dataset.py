"""``GraspSet``: a stored batch, read shard by shard as it is asked for."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from planner.batch.diversity import Diversity, GraspFeatures, diversity, thin
from planner.batch.recipe import read_manifest, task_of, with_fingers_of
from planner.batch.rows import (
    arrow,
    attempt_rows,
    attempt_schema,
    check_fingers,
    checked_row,
    grasp_schema,
    reading,
)
from planner.batch.store import ATTEMPTS, GRASPS, JOURNAL, shard_file, waiting_rows, whole_shards
from planner.collision.arm_path import ArmPath
from planner.collision.pregrasp import Approach
from planner.errors import FileFormatError, NotFoundError
from planner.failure import Failure
from planner.plan import GraspPlan, SolveRecord
from planner.showing import in_notebook
from planner.spatial import SE3, IntArray, pose_from_wxyz
from planner.task import GraspTask
from planner.verification import verify_grasp

MOST_COMPARED = 10_000
"""Grasps per object by which diversity is measured, the first in order of k: they are independent
of each other, so the first are as good as any."""


class GraspSet:
    """A stored batch: one row per requested grasp, sorted by object and k; see ``grasp_schema``.

    Rows that are missing, because the batch was interrupted, are left out.
    """

    def __init__(self, folder: Path | str) -> None:
        """Open a folder that ``plan_grasps`` wrote; nothing is written.

        Args:
            folder: The folder.

        Raises:
            FileFormatError: The folder holds no batch.
        """
        self.folder = Path(folder)
        self.manifest = read_manifest(self.folder)
        self._shards = whole_shards(self.folder, self.manifest)
        size = self.manifest.shard_rows
        self._waiting: dict[int, list[dict[str, Any]]] = {}
        for index, row in sorted(waiting_rows(self.folder, self.manifest).items()):
            if index // size not in self._shards:
                self._waiting.setdefault(index // size, []).append(row)
        self._table = lru_cache(maxsize=2)(self._read)

    def __len__(self) -> int:
        """Rows that are there."""
        return sum(self._rows_in(shard) for shard in self._parts)

    def __repr__(self) -> str:
        """One line."""
        return (
            f"<GraspSet: {len(self)} of {self.manifest.total} grasps by {self.manifest.hand}, "
            f"{len(self.labels)} objects, {self.folder}>"
        )

    def _repr_html_(self) -> str:
        """What a notebook shows of it: a table and a picture, made once."""
        return in_notebook(self)

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels of the objects."""
        return tuple(item.label for item in self.manifest.objects)

    @property
    def complete(self) -> bool:
        """Whether every requested grasp was planned."""
        return len(self) == self.manifest.total

    def task(self, label: str) -> GraspTask:
        """The task of an object.

        Raises:
            NotFoundError: No object of the batch is called so.
            PlannerError: Hand or object cannot be loaded, or have changed.
        """
        for item in self.manifest.objects:
            if item.label == label:
                return task_of(item.recipe)
        raise NotFoundError("object of the batch", label, self.labels)

    def tables(self, columns: Sequence[str] | None = None) -> Iterator[Any]:
        """Arrow tables of the grasps in order, one per shard; one at a time is in memory."""
        for shard in self._parts:
            yield self._read(GRASPS, shard, None if columns is None else tuple(columns))

    def table(self, columns: Sequence[str] | None = None) -> Any:
        """All grasps as one Arrow table; ``to_pandas()`` makes a data frame of it."""
        pa = arrow()
        tables = list(self.tables(columns))
        return pa.concat_tables(tables) if tables else self._schema().empty_table()

    def attempts(self) -> Any:
        """Every attempt with its reason and CPU time (s), as one Arrow table."""
        pa = arrow()
        tables = [self._read(ATTEMPTS, shard, None) for shard in self._parts]
        return pa.concat_tables(tables) if tables else attempt_schema().empty_table()

    def __iter__(self) -> Iterator[dict[str, Any]]:
        """Rows in order."""
        for table in self.tables():
            yield from self._rows(table)

    def __getitem__(self, i: int) -> dict[str, Any]:
        """Row i, as plain data.

        Raises:
            IndexError: There are not so many.
        """
        left = i + len(self) if i < 0 else i
        if not 0 <= left < len(self):
            raise IndexError(f"row {i} of {len(self)}")
        for shard in self._parts:
            if left < self._rows_in(shard):
                break
            left -= self._rows_in(shard)
        (row,) = self._rows(self._table(GRASPS, shard, None).slice(left, 1))
        return row

    def plan(self, i: int) -> GraspPlan:
        """The plan of row i, rebuilt and verified again on the true geometry.

        Raises:
            FileFormatError: No grasp was found, or it fails its checks now.
        """
        row = self[i]
        where = f"grasp {row['k']} of {row['object']!r}"
        if not row["found"]:
            raise FileFormatError(f"{where} was not found: {row['reason']}; take another row")
        task = with_fingers_of(self.task(row["object"]), row)
        start = _pose(row, "start")
        arm = None
        if row["arm_approach_q_rad"] is not None:
            arm = ArmPath(
                approach=np.array(row["arm_approach_q_rad"]), lift=np.array(row["arm_lift_q_rad"])
            )
        plan = verify_grasp(
            task,
            task.T_world_object * _pose(row, "base"),
            task.hand.checked_q(row["q_rad"], "q_rad"),
            record=SolveRecord(
                seed=row["seed"],
                attempt=row["attempts"] - 1,
                attempts=row["attempts"],
                iterations=row["iterations"],
                status=row["solver_status"],
                cpu_s=row["cpu_s"],
                build_s=row["build_s"],
            ),
            approach=Approach(
                q=task.hand.checked_q(row["q_pregrasp_rad"], "q_pregrasp_rad"),
                pregrasp_distance=row["opening_m"],
                T_world_base_start=task.T_world_object * start,
                arm=arm,
            ),
        )
        if isinstance(plan, Failure):
            raise FileFormatError(f"{where} fails its checks: {plan}; plan it again")
        return plan

    def found(self, label: str | None = None) -> Iterator[tuple[int, dict[str, Any]]]:
        """Numbers and rows of the grasps, of one object or all, in order."""
        first = 0
        for table in self.tables():
            with reading(self.folder / GRASPS):
                wanted = table["found"].to_numpy(zero_copy_only=False) == True  # noqa: E712
                if label is not None:
                    wanted = wanted & (table["object"].to_numpy(zero_copy_only=False) == label)
            numbers = np.flatnonzero(wanted)
            rows = self._rows(table.take(numbers))
            yield from zip((first + numbers).tolist(), rows, strict=True)
            first += table.num_rows

    def features(self, label: str, *, most: int = MOST_COMPARED) -> GraspFeatures:
        """Features of an object's first found grasps, in order of k."""
        rows = [row for _, row in islice(self.found(label), most)]
        return self._compared(label, rows)

    def thinned(self, label: str) -> IntArray:
        """Numbers of an object's rows without near-duplicates, of which the best epsilon stays."""
        numbers, rows = [], []
        for number, row in self.found(label):
            numbers.append(number)
            rows.append(row)
        features = self._compared(label, rows)
        kept = thin(features, worth=np.array([row["epsilon"] for row in rows]))
        chosen: IntArray = np.array(numbers, dtype=np.int64)[kept]
        return chosen

    def diversity(self, label: str) -> Diversity:
        """How different the grasps of an object are from each other."""
        task = self.task(label)
        return diversity(self.features(label), task.object.shape)

    def _compared(self, label: str, rows: list[dict[str, Any]]) -> GraspFeatures:
        task = self.task(label)
        for row in rows:
            check_fingers(row, task, source=self.folder / GRASPS)
        return GraspFeatures.of_rows(task, rows)

    @property
    def _parts(self) -> list[int]:
        """Shards with rows, in order."""
        return sorted(self._shards | set(self._waiting))

    def _rows_in(self, shard: int) -> int:
        if shard in self._waiting:
            return len(self._waiting[shard])
        return self.manifest.rows_in(shard)

    def _schema(self) -> Any:
        return grasp_schema(self.task(self.labels[0]).hand)

    def _read(self, table: str, shard: int, columns: tuple[str, ...] | None) -> Any:
        pa = arrow()
        if shard not in self._waiting:
            path = shard_file(self.folder, table, shard)
            with reading(path):
                # one file, not a folder of them: no columns out of the path
                made = pa.parquet.ParquetFile(path).read(columns=columns)
                return made if columns is None else made.select(list(columns))
        rows, schema = self._waiting[shard], self._schema()
        if table == ATTEMPTS:
            rows, schema = [a for row in rows for a in attempt_rows(row)], attempt_schema()
        with reading(self.folder / JOURNAL):
            made = pa.Table.from_pylist(rows, schema=schema)
            return made if columns is None else made.select(list(columns))

    def _rows(self, table: Any) -> list[dict[str, Any]]:
        """Rows of a table of grasps as plain data, checked."""
        nq, source = len(self.manifest.joint_names), self.folder / GRASPS
        labels = frozenset(self.labels)
        return [checked_row(row, nq, labels, source=source) for row in table.to_pylist()]


def _pose(row: dict[str, Any], name: str) -> SE3:
    position = np.array(row[f"{name}_position_object_m"])
    return pose_from_wxyz(position, np.array(row[f"{name}_quaternion_object_wxyz"]))
