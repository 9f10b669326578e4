"""``AuditReport``: rows, and how many grasps pass each stage."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from planner.arrays import short_repr
from planner.audit.rows import STAGES, AuditRow
from planner.batch.rows import arrow
from planner.errors import TaskError
from planner.files import whole_file

SHARES = (0.5, 0.9)
"""Shares of grasps (-) for which the tolerance is told."""

FORMS = (".csv", ".parquet")
"""Suffixes of files with the rows."""


@dataclass(frozen=True, kw_only=True)
class AuditReport:
    """The verdict on all grasps of a file.

    Attributes:
        source: What was judged.
        format: Its format.
        hand: The hand.
        object: The object.
        rows: In the order of the file.
        total: How many grasps there are; more than rows where it was interrupted.
        assumed: What the file does not say and was taken for granted.
    """

    source: str
    format: str
    hand: str
    object: str
    rows: tuple[AuditRow, ...]
    total: int
    assumed: tuple[str, ...] = ()

    def __repr__(self) -> str:
        """One line."""
        return short_repr(self)

    def __str__(self) -> str:
        """How many grasps pass."""
        return f"{self.passed} of {self.total} grasps of {self.hand} and {self.object} pass"

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.rows)

    @property
    def complete(self) -> bool:
        """Whether every grasp was judged."""
        return len(self.rows) == self.total

    @property
    def passed(self) -> int:
        """How many grasps pass every stage."""
        return sum(row.passed for row in self.rows)

    @property
    def ok(self) -> bool:
        """Whether all were judged and pass."""
        return self.complete and self.passed == self.total

    @cached_property
    def stages(self) -> dict[str, dict[str, int]]:
        """Stage -> how many "passed", "failed", "not_judged", and have it as "first_fault"."""
        first = Counter(row.first_fault for row in self.rows)
        out: dict[str, dict[str, int]] = {}
        for stage in STAGES:
            results = [r.stages[stage.name].passed for r in self.rows if stage.name in r.stages]
            if results:
                out[stage.name] = {
                    "passed": results.count(True),
                    "failed": results.count(False),
                    "not_judged": results.count(None),
                    "first_fault": first[stage.name],
                }
        return out

    def tolerance_mm(self, share: float) -> float | None:
        """Gap (mm) that pads would have to be allowed for a share (-) of the grasps to touch.

        None without a row that says it. Nothing is judged by it.
        """
        gaps = [r.stages["gap"].number for r in self.rows if "gap" in r.stages]
        known = [gap for gap in gaps if gap is not None]
        return float(np.quantile(known, share)) if known else None

    @property
    def summary(self) -> str:
        """One sentence."""
        text = f"{self.passed} of {len(self.rows)} grasps pass"
        faults = Counter(row.first_fault for row in self.rows if not row.passed)
        if faults:
            text += ", " + ", ".join(f"{n} fail first at {name}" for name, n in faults.items())
        if not self.complete:
            text += f"; {self.total - len(self.rows)} were not judged"
        return text

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "source": self.source,
            "format": self.format,
            "hand": self.hand,
            "object": self.object,
            "total": self.total,
            "judged": len(self.rows),
            "passed": self.passed,
            "assumed": list(self.assumed),
            "tolerance_mm": {str(share): self.tolerance_mm(share) for share in SHARES},
            "stages": self.stages,
            "rows": [row.to_dict() for row in self.rows],
        }

    def write(self, path: Path) -> None:
        """Write the rows as CSV or Parquet, by the suffix, whole or not at all.

        Raises:
            TaskError: Another suffix, or Parquet without pyarrow.
            FileFormatError: The folder does not exist or cannot be written.
        """
        check_form(path)
        rows = [row.to_dict() for row in self.rows]
        if path.suffix == ".csv":
            text = io.StringIO(newline="")
            names = list(dict.fromkeys(name for row in rows for name in row)) or ["index"]
            writer = csv.DictWriter(text, names)
            writer.writeheader()
            writer.writerows(rows)
            data = text.getvalue().encode()
        else:
            pa = arrow()
            from pyarrow import parquet

            sink = io.BytesIO()
            parquet.write_table(pa.Table.from_pylist(rows), sink)
            data = sink.getvalue()
        with whole_file(path) as stream:
            stream.write(data)


def check_form(path: Path) -> None:
    """Refuse a file that the rows cannot be written to, before the work.

    Raises:
        TaskError: Another suffix, or Parquet without pyarrow.
    """
    if path.suffix not in FORMS:
        raise TaskError(f"{path}: rows are written as {' or '.join(FORMS)}; name it so")
    if path.suffix == ".parquet":
        arrow()


def joined_reports(reports: Sequence[AuditReport]) -> AuditReport:
    """Several reports as one, rows in their order.

    Raises:
        TaskError: There is none.
    """
    if not reports:
        raise TaskError("there is nothing to join; give at least one report")

    def once(name: str) -> str:
        return ", ".join(dict.fromkeys(str(getattr(r, name)) for r in reports))

    return AuditReport(
        source=once("source"),
        format=once("format"),
        hand=once("hand"),
        object=once("object"),
        rows=tuple(row for r in reports for row in r.rows),
        total=sum(r.total for r in reports),
        assumed=tuple(dict.fromkeys(a for r in reports for a in r.assumed)),
    )
