"""``measure``: jobs in, rows out; with a file, an interrupted measurement goes on where it ended.

A job is parameters and a number; its work is a function from the job to a row of plain data. What a
measurement draws comes from the job alone, so that a row does not depend on the others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Protocol, TypeVar

from rich.markup import escape

from benchmarks.journal import Journal
from planner.arrays import finite
from sim.estimation import NONE, AnyEstimator, estimator_name
from sim.reality import Reality
from sim.runner import Check, Runner, made_with
from sim.tables import Row, grouped


class _Numbered(Protocol):
    """A job with a number of its own."""

    @property
    def index(self) -> int:
        """The number."""
        ...


SomeJob = TypeVar("SomeJob", bound=_Numbered)


@dataclass(frozen=True, kw_only=True)
class Job:
    """One row to be made, as it is sent to a worker.

    Attributes:
        SHOWN: Fields that stand in the row; "label" stands there as "object".
        index: Its number among all, and the row's.
    """

    SHOWN: ClassVar[tuple[str, ...]] = ()

    index: int

    def row(self, **values: Any) -> Row:
        """The row: which job it is of, and what came of it; NaN and infinity become None."""
        shown = {("object" if n == "label" else n): getattr(self, n) for n in self.SHOWN}
        row: Row = finite({"index": self.index, **shown, **values})
        return row

    def lost(self, reason: str) -> Row:
        """The row of a job that could not be done."""
        return self.row(error=reason)


@dataclass(frozen=True, kw_only=True)
class ObjectJob(Job):
    """A job about a hand and an object.

    Attributes:
        hand: Name or path of the hand.
        spec: The object.
        label: What it is called.
    """

    hand: str
    spec: str
    label: str


def measure(
    runner: Runner,
    work: Callable[[SomeJob, Check], Row],
    jobs: Sequence[SomeJob],
    *,
    kind: str,
    title: str,
    lost: Callable[[SomeJob, str], Row],
    version: int = 1,
    file: Path | None = None,
    asked: Row | None = None,
    seen: Callable[[Row], object] = lambda row: None,
    **told: Any,
) -> Row:
    """Do the jobs, or those whose rows a file does not have yet; Ctrl-C keeps what is done.

    Args:
        runner: Who works.
        work: Makes the row of a job, plain data with the job's number as "index".
        jobs: All jobs.
        kind: What is measured: the format of the result.
        title: What the progress bar says.
        lost: The row of a job that killed every process that tried it.
        version: Of the result.
        file: Of the rows; made if it is not there. Without one they are kept in memory.
        asked: First line of that file, plain data: what the jobs follow from. "format" says what
            kind of file it is.
        seen: Called with every new row; what it raises ends the measurement.
        **told: What else stands in the result.

    Returns:
        Plain data: what the rows were made with, and those of the jobs asked for by number.

    Raises:
        FileFormatError: The file is another one, was begun with other arguments, or cannot be
            written.
    """
    made = made_with()
    rows: list[Row] = []
    opened = nullcontext() if file is None else Journal(file, asked or {"format": f"{kind}-rows"})
    with opened as journal:
        if journal is not None:
            rows = journal.rows
        done = {row["index"] for row in rows}
        left = [job for job in jobs if job.index not in done]
        if done:
            _say(runner, f"{len(jobs) - len(left)} of {len(jobs)} are in {file} already")
        add = rows.append if journal is None else journal.add

        def keep(row: Row) -> None:
            seen(row)
            add(row)

        whole = runner.run(work, left, title=title, keep=keep, given_up=lost)
        wanted = {job.index for job in jobs}
        rows = sorted((r for r in rows if r["index"] in wanted), key=lambda r: int(r["index"]))
        if not whole and journal is not None:
            kept = f"{len(rows)} of {len(jobs)} are in {file}"
            _say(runner, f"interrupted: {kept}; the same command goes on")
    result: Row = {"format": kind, "version": version, **made, **told}
    return result | {"workers": runner.workers, "interrupted": not whole, "rows": rows}


def stated(reality: Reality, estimator: AnyEstimator | None = None) -> Row:
    """How a file says under which reality, and with which estimator, its rows were made.

    Nothing where nothing is off and nothing is estimated, so that files go on that were begun
    before there were any.
    """
    row: Row = {} if reality.ideal else {"reality": reality.to_dict()}
    name = estimator_name(estimator, reality)
    return row if name == NONE else row | {"estimator": name}


def _say(runner: Runner, text: str) -> None:
    runner.console.print(escape(text), highlight=False, soft_wrap=True)


def by_cell(rows: Iterable[Row]) -> dict[tuple[Any, ...], list[Row]]:
    """Rows by hand and kind of object."""
    return grouped(rows, "hand", "kind")
