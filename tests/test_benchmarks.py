"""The runner of the benchmarks: rows that are kept, errors that cost a row, summaries on paper."""

from __future__ import annotations

import json
import math
import os
import signal
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from io import StringIO
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pandas as pd
import pytest
from rich.console import Console
from typer.testing import CliRunner

from benchmarks.__main__ import NAMES, app
from benchmarks.bench import Journal, Options, key_of, run, show
from benchmarks.metrics import auc
from benchmarks.summary import (
    counted,
    flat,
    of,
    parts,
    percentage,
    ratio,
    share,
    share_of,
    spread,
    summary,
)
from planner.errors import FileFormatError, TaskError
from sim.runner import Check, Runner

RUN = CliRunner()


@dataclass(frozen=True)
class Physics:
    """Something that stands in cases and not in rows."""

    mu: float = 0.5


def cases(options: Options) -> Iterator[dict[str, Any]]:
    yield from ({"k": k, "seed": options.seed, "physics": Physics()} for k in range(options.n))


def measure(case: dict[str, Any]) -> dict[str, Any]:
    MADE.append(case["k"])
    if case["k"] == BAD.get("error"):
        raise TaskError("no such grasp")
    if (case["k"], case["seed"]) == (1, KILLS):
        os.kill(os.getpid(), signal.SIGKILL)
    return {"square": case["k"] ** 2, "lost": math.inf, "at": (1.5, np.float64(2))}


def tables(result: dict[str, Any]) -> list[dict[str, Any]]:
    return [summary("squares", result["rows"], (), {"sum": of("square", "sum", 0)}, [()])]


MADE: list[int] = []
BAD: dict[str, int] = {}
KILLS = 99
"""Seed with which a case kills its process."""

HERE: ModuleType = sys.modules[__name__]


@pytest.fixture(autouse=True)
def fresh() -> None:
    MADE.clear()
    BAD.clear()


def made(
    n: int, out: Path | None = None, workers: int = 1, check: Check = lambda: None, seed: int = 0
) -> tuple[dict[str, Any], str]:
    """A result, and what was said."""
    text = StringIO()
    runner = Runner(console=Console(file=text, width=200), check=check, workers=workers)
    return run(HERE, Options(n=n, seed=seed, output=out), runner), text.getvalue()


def interrupt(after: int) -> Callable[[], None]:
    """A check that finds Ctrl-C when it is called so often."""
    calls: list[bool] = []

    def check() -> None:
        calls.append(True)
        if len(calls) == after:
            raise KeyboardInterrupt

    return check


def test_a_result_says_how_it_was_made_and_what_it_comes_to() -> None:
    result, _ = made(3)
    row = {"k": 2, "seed": 0, "error": "", "square": 4, "lost": None, "at": [1.5, 2.0]}
    assert result["rows"][2] == row
    assert result["setting"]["n"] == 3 and result["setting"]["physics"] == {"mu": 0.5}
    assert result["format"] == "opposable-bench-test_benchmarks" and not result["interrupted"]
    assert {"command", "date", "commit", "machine", "cores", "load_average"} <= set(result)
    table = {"title": "squares", "left": [], "columns": ["sum"], "rows": [["5"]] * 2}
    assert result["summary"] == [table]
    json.dumps(result, allow_nan=False)


def test_what_is_there_is_not_made_again(tmp_path: Path) -> None:
    out = tmp_path / "x.json"
    result, said = made(6, out, check=interrupt(3))
    assert result["interrupted"] and [row["k"] for row in result["rows"]] == [0, 1]
    assert f"interrupted: 2 of 6 are in {out}.journal; the same command goes on" in said
    MADE.clear()
    result, said = made(6, out)
    assert MADE == [2, 3, 4, 5] and not result["interrupted"]
    assert [row["square"] for row in result["rows"]] == [0, 1, 4, 9, 16, 25]
    assert f"2 of 6 are in {out}.journal already" in said
    MADE.clear()
    assert len(made(8, out)[0]["rows"]) == 8 and MADE == [6, 7]  # more cases, the same file
    MADE.clear()
    made(2, out, seed=1)
    assert MADE == [0, 1]  # other cases


@pytest.mark.parametrize("lost", [1, 10, 100])
def test_a_line_that_was_cut_short_is_made_again(lost: int, tmp_path: Path) -> None:
    out = tmp_path / "x.json"
    first = made(4, out)[0]["rows"]
    file = tmp_path / "x.json.journal"
    content = file.read_bytes()
    file.write_bytes(content[:-lost])
    assert made(4, out)[0]["rows"] == first
    assert file.read_bytes() == content


@pytest.mark.parametrize("content", [b"{}x\n", b"{}\n", b"\xff\xfe\n", b"text", b"\n"])
def test_files_of_others_are_refused_and_left_alone(content: bytes, tmp_path: Path) -> None:
    file = tmp_path / "x.jsonl"
    file.write_bytes(content)
    with pytest.raises(FileFormatError, match="no journal of this measurement"):
        Journal(file, "test")
    assert file.read_bytes() == content
    with pytest.raises(FileFormatError, match=r"cannot write .*: Is a directory; name another"):
        Journal(tmp_path, "test")


def test_two_runs_do_not_write_one_file(tmp_path: Path) -> None:
    file = tmp_path / "x.jsonl"
    with Journal(file, "test"), pytest.raises(FileFormatError, match="written by another run"):
        Journal(file, "test")


def test_a_failed_case_costs_its_row_only() -> None:
    BAD["error"] = 1
    result, _ = made(3)
    assert [row["error"] for row in result["rows"]] == ["", "no such grasp", ""]
    assert "square" not in result["rows"][1]
    assert result["summary"][1] == "not measured, 1: no such grasp"


@pytest.mark.slow
def test_workers_make_the_same_rows_and_one_that_dies_costs_its_own(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("planner.batch.pool.DEATHS_ALONE", 1)  # to start fewer processes
    alone = made(5)[0]["rows"]
    rows = made(5, workers=2, seed=KILLS)[0]["rows"]
    assert [row.get("square") for row in rows] == [0, None, 4, 9, 16]
    whole = [row | {"seed": 0} for row in rows if not row["error"]]
    assert whole == [alone[0], *alone[2:]]
    assert rows[1]["error"] == "its process died 2 times, killed or by a fault in a library"


def test_a_case_is_known_by_all_that_it_is() -> None:
    case = {"hand": "a", "physics": Physics(), "at": (1, 2)}
    assert key_of(case) == key_of(dict(reversed(case.items())))
    assert key_of(case) != key_of({**case, "physics": replace(Physics(), mu=0.6)})
    assert key_of(case) != key_of({**case, "at": (1, 3)})


# --- the command ---------------------------------------------------------------------------------


def test_every_measurement_is_listed_with_a_line() -> None:
    told = RUN.invoke(app(), [])
    for name in NAMES:
        assert f" {name} " in told.output
    for name in NAMES:
        bench = sys.modules[f"benchmarks.{name}"]
        assert (bench.__doc__ or "").split("\n")[0].endswith(".")
        assert issubclass(bench.Options, Options)
        assert bench.cases and bench.measure and bench.tables


@pytest.mark.parametrize(
    ("words", "code", "told"),
    [
        (["grasps", "--objetcs", "box"], 2, "No such option"),
        (["grasps", "--objects", "bxo"], 3, "Did you mean 'box'"),
        (["grasps", "alegro_hand"], 3, "Did you mean 'allegro_hand'"),
        (["grasps", "--error-model", "labs"], 3, "lab"),
        (["grasps", "--out", "no/folder.json"], 3, "there is no folder"),
        (["control", "--parts", "pull"], 3, "no part is called 'pull'"),
        (["best", "--ways", "clim"], 3, "Did you mean 'climb'"),
        (["best", "--marks", "0.3,0.1"], 3, "give CPU seconds > 0, ascending"),
        (["refine", "--shifts", "-1", "--turns", "0"], 3, "give shifts and turns >= 0"),
        (["motion", "--objects", "cone"], 3, "cone"),
        (["walls", "--objects", "."], 3, "holds no mesh file"),
    ],
)
def test_what_cannot_be_measured_is_refused(
    words: list[str], code: int, told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = RUN.invoke(app(words[:1]), words)
    assert done.exit_code == code, done.output
    assert told in " ".join(done.output.replace("│", " ").split())
    assert not list(tmp_path.iterdir())


def test_a_table_is_shown_whole_in_a_narrow_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    show([{"title": "t", "left": ["a"], "columns": ["a", "b"], "rows": [["x" * 150, "1"]]}, "told"])
    assert "x" * 150 in capsys.readouterr().out


# --- summaries -----------------------------------------------------------------------------------

ROWS: list[dict[str, Any]] = [
    {"hand": "a", "ok": True, "t": 1.0, "n": 2, "of": 4, "why": "", "list": [1.0, 2.0]},
    {"hand": "b", "ok": False, "t": None, "n": 1, "of": 4, "why": "slip", "list": []},
    {"hand": "a", "ok": True, "t": 3.0, "n": 3, "of": 4, "why": "slip", "list": [6.0]},
    {"hand": "a", "error": "lost"},
]


@pytest.mark.parametrize(
    ("cell", "told"),
    [
        (share("ok"), "2/4"),
        (share("ok", known="ok"), "2/3"),
        (percentage("ok"), "50.0 %"),
        (of("t"), "2.00"),
        (of("t", "max", 0, 10.0, unit=" ms"), "30 ms"),
        (of("list"), "2.00"),
        (of("n", "sum", 0, where="ok"), "5"),
        (of("nothing"), "-"),
        (spread("t", 1), "2.0 / 2.8"),
        (parts("n", "of"), "6/12"),
        (ratio("n", "of"), "0.50"),
        (ratio("n", "nothing"), "-"),
        (counted("why"), "slip 2"),
        (share_of("t", lambda t: t >= 2), "1/2"),
    ],
)
def test_cells_worked_by_hand(cell: Any, told: str) -> None:
    assert cell(pd.DataFrame(ROWS)) == told


def test_rows_are_grouped_and_summed_up_in_their_order() -> None:
    made = summary("t", ROWS, {"hand": "Hand"}, {"n": of("n", "sum", 0)}, [("all",)])
    assert made["columns"] == ["Hand", "n"]
    assert made["rows"] == [["a", "5"], ["b", "1"], ["all", "6"]]
    assert summary("t", ROWS[:1], ("t",), {"n": of("n", digits=0)})["rows"] == [["1", "2"]]
    assert summary("t", [], ("hand",), {"n": of("n")})["rows"] == []
    both = flat([{"hand": "a", "trips": [{"x": 1}, {"x": 2}]}, {"hand": "b"}], "trips")
    assert [(one["hand"], one["x"]) for one in both] == [("a", 1), ("a", 2)]


def test_areas_under_the_curve_worked_by_hand() -> None:
    def area(values: list[float], success: list[bool]) -> float:
        found = auc(np.array(values), success)
        assert found is not None
        return found[0]

    won = [True, True, False, False]
    assert area([4, 3, 2, 1], won) == 1.0
    assert area([1, 2, 3, 4], won) == 0.0
    assert area([4, 2, 2, 1], won) == pytest.approx(3.5 / 4)  # a tie is half a win
    assert auc(np.ones(2), [True, True]) is None
    # within groups an offset between them makes no difference
    groups = [0, 0, 1, 1]
    found = auc(np.array([1.0, 0.0, 9.0, 8.0]), [True, False, True, False], groups)
    assert found == (1.0, None)
