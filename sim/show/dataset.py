"""A stored batch: a grid of thumbnails, and a page for each grasp, made when it is asked for.

``DatasetTables`` is what a browser asks of a stored batch, as plain data and by row. Columns of all
rows are sent once, poses for the rows on the screen, everything else for the row that is clicked,
so that ten thousand rows cost no more than a few.

``grid_html``, ``grid_script`` and ``grid_models`` make the grid. Unlike a ``Page`` the grid is not
one file: it asks its own server for columns, places of hands and pages of single grasps. Pictures
are drawn in the browser.
"""

from __future__ import annotations

import json
import re
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, lru_cache
from html import escape
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from planner.arrays import finite
from planner.batch import GraspSet
from planner.batch.dataset import MOST_COMPARED
from planner.batch.diversity import GraspFeatures, distances
from planner.batch.recipe import MANIFEST
from planner.batch.rows import reading
from planner.batch.store import ATTEMPTS, GRASPS
from planner.errors import FileFormatError, NotFoundError
from planner.hands.hand import Hand
from planner.pages.page import asset, pack, page_html, three_source
from planner.pages.plan_page import plan_page
from planner.pages.plan_scene import object_model
from planner.pages.scene import Model, hand_model, pose_row
from planner.plan import GraspPlan
from planner.shapes.meshes.triangles import simplified
from planner.task import GraspTask
from sim.show.browser import Answer
from sim.show.targets import Kind, Target, ViewOptions

SCRIPTS = ("unpack.js", "bodies.js", "side.js", "thumbnails.js", "grid.js", "grid_main.js")
"""In the order in which they run, after three.js."""

MOST_TRIANGLES = 12_000
"""Of a hand or an object in a picture of 176 pixels."""

DRAWN = ("hand", "pads", "object")
"""Layers in a picture."""


def grid_html(title: str, subtitle: str) -> str:
    """The page of a grid."""
    style = "\n".join(asset(name) for name in ("page.css", "side.css", "grid.css"))
    return asset("grid.html").format(title=escape(title), subtitle=escape(subtitle), style=style)


def grid_script() -> str:
    """Its script, three.js included.

    Raises:
        PlannerError: trimesh carries another three.js.
    """
    return "\n".join((three_source(), *(asset(name) for name in SCRIPTS)))


def grid_models(hand: Hand, tasks: Mapping[str, GraspTask]) -> bytes:
    """The hand and the objects that its pictures are made of, packed.

    Args:
        hand: The hand of all grasps.
        tasks: Label of an object -> its task, in whose pose it is shown.
    """
    return pack(
        {
            "hand": _light(hand_model(hand)),
            "objects": {
                label: {
                    "model": _light(object_model(task.object.shape, label).model),
                    "pose": pose_row(task.T_world_object),
                }
                for label, task in tasks.items()
            },
        }
    )


def _light(model: Model) -> Model:
    """A model with what a small picture shows, and with few triangles."""
    drawn = [part for part in model.parts if part.layer in DRAWN]
    share = MOST_TRIANGLES / max(1, sum(len(part.triangles) for part in drawn))
    parts = []
    for part in drawn:
        most = max(LEAST_TRIANGLES, int(share * len(part.triangles)))
        vertices, triangles, _ = simplified(part.vertices, part.triangles, most)
        parts.append(replace(part, vertices=vertices, triangles=triangles))
    return Model(joints=model.joints, parts=tuple(parts))


LEAST_TRIANGLES = 60
"""That every part may keep."""


KEPT_PAGES = 32
"""Pages of grasps that are kept, about 1 MB each."""

MOST_POSES = 1000
"""Rows of one request for poses."""

_ROW = re.compile(r"/(grasp|details)/(\d{1,12})")


class DatasetSite:
    """The pages and data of a batch; see ``planner/pages/assets/grid.js``."""

    def __init__(self, tables: DatasetTables) -> None:
        """Serve the tables of a batch."""
        self._tables = tables
        self._lock = threading.Lock()  # models and pages are made once
        self._page = lru_cache(maxsize=KEPT_PAGES)(self._made_page)
        self._kept: dict[str, Answer] = {}
        self._made: Mapping[str, Callable[[], Answer]] = {
            "/": self._grid,
            "/script.js": lambda: Answer(
                body=grid_script().encode(), kind="text/javascript; charset=utf-8"
            ),
            "/rows": self._rows,
            "/models": self._models,
        }

    def answer(self, path: str, query: Mapping[str, str]) -> Answer | None:
        """See ``Site``."""
        if path in self._made:
            with self._lock:
                if path not in self._kept:
                    self._kept[path] = self._made[path]()
                return self._kept[path]
        if path == "/poses":
            return _json(self._tables.poses(_numbers(query.get("rows", ""))))
        found = _ROW.fullmatch(path)
        if found is None:
            return None
        row = int(found[2])
        if row >= len(self._tables):
            raise NotFoundError("row", str(row), [f"0 to {len(self._tables) - 1}"])
        if found[1] == "details":
            return _json(self._tables.details(row))
        with self._lock:
            return self._page(row)

    def _grid(self) -> Answer:
        grasps = self._tables.grasps
        m = grasps.manifest
        total = f"{len(grasps)} of {m.total} requested" if len(grasps) < m.total else str(m.total)
        objects = "one object" if len(m.objects) == 1 else f"{len(m.objects)} objects"
        subtitle = f"{total} grasps of {objects}, seed {m.seed}, {grasps.folder}"
        return Answer(body=grid_html(f"Grasps by {m.hand}", subtitle).encode())

    def _rows(self) -> Answer:
        columns = self._tables.columns
        units = {name: COLUMNS[name] for name in columns}
        return _json({"count": len(self._tables), "columns": columns, "units": units})

    def _models(self) -> Answer:
        grasps = self._tables.grasps
        tasks = {label: grasps.task(label) for label in grasps.labels}
        hand = tasks[grasps.labels[0]].hand
        return Answer(body=grid_models(hand, tasks), kind="application/octet-stream")

    def _made_page(self, row: int) -> Answer:
        return Answer(body=page_html(plan_page(self._tables.plan(row))).encode())


def _json(data: Any) -> Answer:
    text = json.dumps(data, allow_nan=False, separators=(",", ":"))
    return Answer(body=text.encode(), kind="application/json")


def _numbers(text: str) -> list[int]:
    """Numbers of rows with commas between them, no more than ``MOST_POSES``; others are dropped."""
    parts = text.split(",")[:MOST_POSES]
    return [int(part) for part in parts if part.isascii() and part.isdigit() and len(part) < 13]


def _shown(target: Target, options: ViewOptions) -> DatasetSite:
    assert target.path is not None
    tables = DatasetTables(target.path)
    if not len(tables):
        raise FileFormatError(
            f"{target.path} holds the manifest of a batch and no grasps yet; go on with the batch "
            "(opposable batch), then view it"
        )
    return DatasetSite(tables)


DATASET = Kind(
    name="the folder of a batch (opposable batch)",
    recognises=lambda target: target.holds(MANIFEST),
    shown=_shown,
)
"""See ``sim.show.targets``."""


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
                "attempts": finite(self._attempts.get((values["object"], values["k"]), [])),
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
