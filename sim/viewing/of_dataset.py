"""A stored batch: a grid of thumbnails, and a page for each grasp, made when it is asked for."""

from __future__ import annotations

import json
import re
import threading
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

from planner.batch.recipe import MANIFEST
from planner.errors import FileFormatError, NotFoundError
from planner.pages.grid_page import grid_html, grid_models, grid_script
from planner.pages.page import page_html
from planner.pages.plan_page import plan_page
from sim.viewing.dataset_tables import COLUMNS, DatasetTables
from sim.viewing.kinds import Kind, ViewOptions
from sim.viewing.server import Answer
from sim.viewing.target import Target

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
            "/script.js": self._script,
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

    def _script(self) -> Answer:
        return Answer(body=grid_script().encode(), kind="text/javascript; charset=utf-8")

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
        plan = self._tables.plan(row)
        return Answer(body=page_html(plan_page(plan)).encode())


def _json(data: Any) -> Answer:
    text = json.dumps(data, allow_nan=False, separators=(",", ":"))
    return Answer(body=text.encode(), kind="application/json")


def _numbers(text: str) -> list[int]:
    """Numbers of rows with commas between them, no more than ``MOST_POSES``; others are dropped."""
    parts = text.split(",")[:MOST_POSES]
    return [int(part) for part in parts if part.isascii() and part.isdigit() and len(part) < 13]


def _recognises(target: Target) -> bool:
    return target.holds(MANIFEST)


def _shown(target: Target, options: ViewOptions) -> DatasetSite:
    assert target.path is not None
    tables = DatasetTables(target.path)
    if not len(tables):
        raise FileFormatError(
            f"{target.path} holds the manifest of a batch and no grasps yet; go on with the batch "
            "(opposable batch), then view it"
        )
    return DatasetSite(tables)


KIND = Kind(name="the folder of a batch (opposable batch)", recognises=_recognises, shown=_shown)
"""See ``sim.viewing.kinds``."""
