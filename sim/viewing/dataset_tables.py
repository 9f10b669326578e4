"""``DatasetTables``: what a browser asks of a stored batch, as plain data and by row.

Columns of all rows are sent once, poses for the rows on the screen, everything else for the row
that is clicked, so that ten thousand rows cost no more than a few.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from planner.arrays import finite
from planner.batch import GraspSet
from planner.batch.dataset import MOST_COMPARED
from planner.batch.diversity import GraspFeatures, distances
from planner.batch.rows import reading
from planner.batch.store import ATTEMPTS, GRASPS
from planner.plan import GraspPlan

COLUMNS = {
    "object": "",
    "k": "",
    "found": "",
    "epsilon": "",
    "min_weight": "",
    "largest_pad_gap_m": "m",
    "opening_m": "m",
    "fingers": "",
    "attempts": "",
    "cpu_s": "s",
    "iterations": "",
    "solver_status": "",
    "seed": "",
    "build_s": "s",
    "reason": "",
}
"""Columns that a grid filters and sorts by, with their units; in the order of the grid."""

POSES = (
    "found",
    "object",
    "base_position_object_m",
    "base_quaternion_object_wxyz",
    "q_rad",
)
"""Columns that place a hand at an object."""


class DatasetTables:
    """The tables of a batch for many readers at once."""

    def __init__(self, folder: Path) -> None:
        """Open a folder that ``plan_grasps`` wrote.

        Raises:
            FileFormatError: The folder holds no batch, or a damaged one.
            TaskError: ``pyarrow`` is missing.
        """
        self.grasps = GraspSet(folder)
        self._lock = threading.Lock()  # kept tables are filled once
        self._features: dict[str, tuple[list[int], GraspFeatures]] = {}

    def __len__(self) -> int:
        """Rows."""
        return len(self.grasps)

    @cached_property
    def columns(self) -> dict[str, list[Any]]:
        """Every column of the grid, by name; what is not finite is None.

        Raises:
            FileFormatError: A column is missing.
        """
        with reading(self.grasps.folder / GRASPS):
            table = self.grasps.table(self._present(COLUMNS))
        made: dict[str, list[Any]] = {name: table[name].to_pylist() for name in table.column_names}
        if "fingers" in made:
            made["fingers"] = [" ".join(f or ()) for f in made["fingers"]]
        if "seed" in made:  # 63 bits, which a browser's numbers do not hold
            made["seed"] = [str(v) for v in made["seed"]]
        result: dict[str, list[Any]] = finite(made)
        return result

    def poses(self, rows: Sequence[int]) -> dict[int, dict[str, Any]]:
        """Where the hand is in the object's frame, of those rows that have a grasp.

        Returns:
            Row -> "object", its label; "base", x, y, z in m and w, x, y, z; "q", rad (m).
        """
        with self._lock:
            table = self._poses
        out = {}
        for row in rows:
            if 0 <= row < table.num_rows and table["found"][row].as_py():
                place = [v for name in POSES[2:4] for v in table[name][row].as_py()]
                q = table["q_rad"][row].as_py()
                out[row] = {"object": table["object"][row].as_py(), "base": place, "q": q}
        return out

    @cached_property
    def _poses(self) -> Any:
        with reading(self.grasps.folder / GRASPS):
            return self.grasps.table(POSES)

    def details(self, row: int) -> dict[str, Any]:
        """Everything about a row: its numbers, its near-duplicates, its attempts.

        Raises:
            FileFormatError: It is damaged.
        """
        with self._lock:
            values = self.grasps[row]
            return {
                "row": row,
                "values": {
                    n: str(v) if n == "seed" else finite(v)
                    for n, v in values.items()
                    if not isinstance(v, list)
                },
                "fingers": values.get("fingers") or [],
                "forces_N": finite(self._normal_forces(values)),
                "duplicates": self._duplicates(row, values),
                "attempts": self._attempts_of(values),
            }

    def plan(self, row: int) -> GraspPlan:
        """The plan of a row, verified again.

        Raises:
            FileFormatError: No grasp was found, or it fails its checks now.
        """
        with self._lock:
            return self.grasps.plan(row)

    def _present(self, wanted: Mapping[str, str]) -> list[str]:
        """Those of some columns that this version of the dataset has."""
        there = next(iter(self.grasps.tables()), None)
        return [name for name in wanted if there is None or name in there.column_names]

    @staticmethod
    def _normal_forces(values: Mapping[str, Any]) -> list[float]:
        if not values["found"]:
            return []
        forces = np.array(values["contact_forces_object_N"])
        normals = np.array(values["contact_normals_object"])
        return [float(v) for v in np.einsum("nd,nd->n", forces, normals)]

    def _duplicates(self, row: int, values: Mapping[str, Any]) -> list[dict[str, Any]]:
        """Grasps of the same object within all tolerances of this one, the nearest first."""
        if not values["found"]:
            return []
        label = values["object"]
        if label not in self._features:
            found = list(islice(self.grasps.found(label), MOST_COMPARED))
            features = GraspFeatures.of_rows(self.grasps.task(label), [r for _, r in found])
            self._features[label] = ([number for number, _ in found], features)
        numbers, features = self._features[label]
        if row not in numbers:
            return []
        here = numbers.index(row)
        others = np.delete(np.arange(len(numbers)), here)
        apart = distances(features, here, others)
        near = np.flatnonzero(apart <= 1.0)
        near = near[np.argsort(apart[near], kind="stable")]
        return [{"row": numbers[int(others[i])], "apart": float(apart[i])} for i in near]

    def _attempts_of(self, values: Mapping[str, Any]) -> list[dict[str, Any]]:
        label, k = values["object"], values["k"]
        found: list[dict[str, Any]] = finite(self._attempts.get((label, k), []))
        return found

    @cached_property
    def _attempts(self) -> dict[tuple[str, int], list[dict[str, Any]]]:
        """Attempts by object and k."""
        with reading(self.grasps.folder / ATTEMPTS):
            rows = self.grasps.attempts().to_pylist()
        made: dict[tuple[str, int], list[dict[str, Any]]] = {}
        for a in rows:
            made.setdefault((a["object"], a["k"]), []).append(
                {"attempt": a["attempt"], "reason": a["reason"], "cpu_s": a["cpu_s"]}
            )
        return made
