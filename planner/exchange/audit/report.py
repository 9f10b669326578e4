"""``AuditReport``: rows of judged grasps, and how many pass each stage.

A row has a result for each stage, with its number and its reason.
"""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from planner.arrays import finite, short_repr
from planner.batch.rows import arrow
from planner.errors import TaskError
from planner.files import whole_file


@dataclass(frozen=True, kw_only=True)
class Stage:
    """A stage of the verdict.

    Attributes:
        name: Its name.
        number: What its number is, with unit, as the name of a column.
        asks: What it asks, for people.
    """

    name: str
    number: str
    asks: str


STAGES: tuple[Stage, ...] = (
    Stage(name="joints", number="beyond_rad", asks="joint limits and couplings are kept"),
    Stage(name="gap", number="tolerance_mm", asks="enough pads touch the surface"),
    Stage(name="pad", number="angle_deg", asks="they touch on the pad, off edges, where allowed"),
    Stage(name="penetration", number="depth_mm", asks="nothing else penetrates"),
    Stage(name="closure", number="min_weight", asks="the contacts close"),
    Stage(name="forces", number="share", asks="forces hold the weight within torque limits"),
    Stage(name="approach", number="opening_mm", asks="a straight way in is free"),
    Stage(name="held", number="moved_mm", asks="it holds in simulation"),
)
"""All stages in their order; the last two where they are asked for."""


@dataclass(frozen=True, kw_only=True)
class StageResult:
    """What a stage says.

    Attributes:
        passed: Whether it passes; None where an earlier stage leaves nothing to judge.
        number: As ``Stage.number`` says; None where there is none.
        reason: Why not, or why it was not judged; "" if it passes.
    """

    passed: bool | None
    number: float | None = None
    reason: str = ""


@dataclass(frozen=True, kw_only=True)
class AuditRow:
    """The verdict on one grasp.

    Attributes:
        index: Its place in the file.
        name: As ``ImportedGrasp.name``.
        source: The file.
        object: The object as the file names it.
        scale: Factor on the object's mesh.
        fingers: Those whose pads are taken for its contacts.
        gaps_mm: Finger -> signed distance of its pad from the surface, mm, of all that may take
            part.
        stages: Name -> result, in the order of ``STAGES``.
    """

    index: int
    name: str
    source: str = ""
    object: str = ""
    scale: float = 1.0
    fingers: tuple[str, ...] = ()
    gaps_mm: Mapping[str, float] = field(default_factory=dict)
    stages: Mapping[str, StageResult]

    def __post_init__(self) -> None:
        """Keep copies that nobody changes."""
        for name in ("gaps_mm", "stages"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

    @property
    def passed(self) -> bool:
        """Whether every stage passes."""
        return all(result.passed is True for result in self.stages.values())

    @property
    def first_fault(self) -> str:
        """Name of the first stage that does not pass; "" if all do."""
        return next((n for n, result in self.stages.items() if result.passed is not True), "")

    @property
    def reason(self) -> str:
        """Why it does not pass: every stage that fails with its reason."""
        return "; ".join(
            f"{name}: {result.reason}"
            for name, result in self.stages.items()
            if result.passed is False
        )

    def __reduce__(self) -> tuple[Any, ...]:
        """How it is sent to another process: a read-only mapping cannot be pickled."""
        values = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return _row, ({**values, "gaps_mm": dict(self.gaps_mm), "stages": dict(self.stages)},)

    def to_dict(self) -> dict[str, Any]:
        """Plain data, one value per column; lists are joined by spaces."""
        out: dict[str, Any] = {
            "index": self.index,
            "name": self.name,
            "source": self.source,
            "object": self.object,
            "scale": self.scale,
            "passed": self.passed,
            "first_fault": self.first_fault,
            "fingers": " ".join(self.fingers),
        }
        for stage in STAGES:
            if stage.name in self.stages:
                result = self.stages[stage.name]
                out[stage.name] = result.passed
                out[f"{stage.name}_{stage.number}"] = finite(result.number)
        out["reason"] = self.reason
        out["gaps_mm"] = " ".join(f"{n}={v:.4g}" for n, v in self.gaps_mm.items())
        return out


def _row(values: dict[str, Any]) -> AuditRow:
    return AuditRow(**values)


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
