"""Measurements that go on: their file of rows, and workers that die."""

from __future__ import annotations

import os
import signal
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from benchmarks.journal import Journal
from benchmarks.run import measure
from planner.errors import FileFormatError
from sim.runner import Check, Runner

ASKED = {"format": "opposable-test", "version": 1, "seeds": 3}


@dataclass(frozen=True)
class Job:
    """A job that may kill its process."""

    index: int
    kills: bool = False


def work(job: Job, check: Check) -> dict[str, Any]:
    check()
    if job.kills:
        os.kill(os.getpid(), signal.SIGKILL)
    return {"index": job.index, "square": job.index**2, "reason": ""}


def given_up(job: Job, reason: str) -> dict[str, Any]:
    return {"index": job.index, "square": None, "reason": reason}


def run(
    file: Path, jobs: list[Job], workers: int = 1, check: Check = lambda: None
) -> tuple[list[dict[str, Any]], bool, str]:
    """Rows by their index, whether those are all, and what was said."""
    text = StringIO()
    runner = Runner(console=Console(file=text, width=200), check=check, workers=workers)
    result = measure(
        runner, work, jobs, kind="test", file=file, asked=ASKED, title="", lost=given_up
    )
    return result["rows"], not result["interrupted"], text.getvalue()


def test_rows_are_on_disk_as_soon_as_they_are_added(tmp_path: Path) -> None:
    file = tmp_path / "x.jsonl"
    with Journal(file, ASKED) as journal:
        for k in range(3):
            journal.add({"index": k, "values": (1.5, k)})
            assert len(file.read_bytes().splitlines()) == 2 + k
        assert journal.rows[2] == {"index": 2, "values": [1.5, 2]}  # as it is read again
    with Journal(file, ASKED) as again:
        assert again.rows == journal.rows


def test_nothing_that_is_there_is_done_again(tmp_path: Path) -> None:
    file = tmp_path / "x.jsonl"
    jobs = [Job(k) for k in range(6)]
    calls: list[bool] = []

    def check() -> None:
        calls.append(True)
        if len(calls) == 4:
            raise KeyboardInterrupt

    rows, whole, said = run(file, jobs, check=check)
    assert ([row["index"] for row in rows], whole) == ([0, 1, 2], False)
    assert f"interrupted: 3 of 6 are in {file}; the same command goes on" in said
    rows, whole, said = run(file, jobs, check=check)
    assert ([row["square"] for row in rows], whole) == ([0, 1, 4, 9, 16, 25], True)
    assert f"3 of 6 are in {file} already" in said
    assert len(calls) == 4 + 3


@pytest.mark.parametrize("lost", [1, 10, 45])
def test_a_row_that_was_cut_short_is_made_again(lost: int, tmp_path: Path) -> None:
    file = tmp_path / "x.jsonl"
    jobs = [Job(k) for k in range(4)]
    first = run(file, jobs)[0]
    content = file.read_bytes()
    file.write_bytes(content[:-lost])
    with Journal(file, ASKED) as journal:
        assert 2 <= len(journal.rows) < 4
    assert run(file, jobs)[0] == first
    assert file.read_bytes() == content


@pytest.mark.parametrize("length", [0, 1, 30])
def test_a_file_that_was_cut_while_it_began_is_begun_again(length: int, tmp_path: Path) -> None:
    file = tmp_path / "x.jsonl"
    Journal(file, ASKED).__exit__(None, None, None)
    header = file.read_bytes()
    file.write_bytes(header[:length])
    assert run(file, [Job(0)])[1]
    assert file.read_bytes().startswith(header)


@pytest.mark.parametrize(
    "content",
    [b"{}x\n", b"{}\n", b"[1]\n", b"\xff\xfe\n", b"text without an end", b"\n"],
)
def test_files_of_others_are_refused_and_left_alone(content: bytes, tmp_path: Path) -> None:
    file = tmp_path / "x.jsonl"
    file.write_bytes(content)
    with pytest.raises(FileFormatError, match="not a file of the format opposable-test"):
        Journal(file, ASKED)
    assert file.read_bytes() == content


def test_other_arguments_are_named(tmp_path: Path) -> None:
    file = tmp_path / "x.jsonl"
    run(file, [Job(0)])
    before = file.read_bytes()
    with pytest.raises(FileFormatError, match=r"other arguments \(different: hands, seeds\)"):
        Journal(file, {**ASKED, "seeds": 4, "hands": ["shadow_hand"]})
    assert file.read_bytes() == before


def test_two_runs_do_not_write_one_file(tmp_path: Path) -> None:
    file = tmp_path / "x.jsonl"
    with Journal(file, ASKED), pytest.raises(FileFormatError, match="written by another run"):
        Journal(file, ASKED)
    with Journal(file, ASKED):
        pass


def test_a_file_that_cannot_be_written_says_so(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match=r"cannot write .*: Is a directory; name another"):
        Journal(tmp_path, ASKED)


@pytest.mark.slow
def test_a_job_that_kills_its_process_costs_only_its_own_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("planner.batch.pool.DEATHS_ALONE", 1)  # to start fewer processes
    jobs = [Job(k, kills=k == 1) for k in range(5)]
    rows, whole, _ = run(tmp_path / "x.jsonl", jobs, workers=2)
    assert whole
    assert [row["square"] for row in rows] == [0, None, 4, 9, 16]
    assert rows[1]["reason"] == "its process died 2 times, killed or by a fault in a library"
