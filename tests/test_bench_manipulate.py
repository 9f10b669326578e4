"""``benchmarks.manipulate``: trials of turns, tilts and translations in the hand, counted."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner

from benchmarks.commands.common import TABLE_WIDTH
from benchmarks.conditions import FRICTION, MASS, PUSH_UNTIL, SIZE, Conditions
from benchmarks.manipulate import Turn, run_manipulate
from benchmarks.turn_table import manipulate_table
from planner import ManipulationPlan
from planner.errors import FileFormatError, NotFoundError, TaskError
from sim.cli import app
from sim.manipulation import ManipulationReport, manipulate
from sim.runner import Runner

RUN = CliRunner()

Y = (0.0, 1.0, 0.0)

TURN = Turn(
    index=0,
    hand="allegro_hand",
    kind="cylinder",
    number=0,
    height=0.08,
    fingers=None,
    stand=0.0,
    seed=3,
)

HEADER = {
    "format": "opposable-bench-manipulate-rows",
    "version": 1,
    "hands": ["allegro_hand"],
    "kinds": ["block"],
    "n": 1,
    "height": 0.08,
    "fingers": None,
    "stand": 0.0,
    "seed": 3,
    "angle_deg": 90.0,
}
"""First line of a file that was begun before there were tilts and translations."""

ROW = {
    "index": 0,
    "hand": "allegro_hand",
    "kind": "block",
    "found": True,
    "strict": True,
    "loose": True,
    "complete": True,
    "dropped": False,
    "planning_cpu_s": 1.0,
    "time_to_angle_s": 1.5,
    "turned_deg": 90.5,
    "shift_off_mm": 0.25,
    "largest_tilt_deg": 1.0,
    "largest_off_path_mm": 0.5,
    "least_fingers": 4.0,
    "place_off_mm": 1.0,
    "place_heading_deg": -0.5,
}

THIRTY = math.degrees(math.radians(30.0))
"""What stands in a file for 30 degrees: rounded twice."""

Measure = Callable[..., dict[str, Any]]


@pytest.fixture
def measure(tmp_path: Path) -> Measure:
    """One trial with a block, in a file of its own."""

    def run(**asked: Any) -> dict[str, Any]:
        return run_manipulate(
            ["allegro_hand"],
            ["block"],
            1,
            height=0.08,
            fingers=None,
            stand=0.0,
            seed=3,
            file=tmp_path / "rows.jsonl",
            runner=Runner(console=Console(quiet=True), check=lambda: None, workers=1),
            **asked,
        )

    return run


def _written(file: Path, header: dict[str, Any]) -> None:
    file.write_text("".join(json.dumps(line) + "\n" for line in (header, ROW)))


def _cells(result: dict[str, Any]) -> dict[str, str]:
    table = manipulate_table(result)
    return {str(column.header): str(next(iter(column.cells))) for column in table.columns}


# --- what is drawn -----------------------------------------------------------------------------


def test_conditions_keep_their_ranges_and_their_seed() -> None:
    drawn = [Conditions.draw("cylinder", 0.08, np.random.default_rng([1, k])) for k in range(200)]
    again = Conditions.draw("cylinder", 0.08, np.random.default_rng([1, 7]))
    assert again == drawn[7]
    sizes = [2 * float(c.spec.split(":")[1].split("x")[0]) for c in drawn]
    for values, (low, high) in (
        (sizes, SIZE),
        ([c.mass for c in drawn], MASS),
        ([c.mu for c in drawn], FRICTION),
        ([math.degrees(c.heading) for c in drawn], (-5.0, 5.0)),
        ([1e3 * c.shift[0] for c in drawn], (-3.0, 3.0)),
    ):
        assert low - 1e-9 <= min(values) < low + 0.1 * (high - low)
        assert high - 0.1 * (high - low) < max(values) <= high + 1e-9
    assert all(math.hypot(*c.push) == pytest.approx(0.4) for c in drawn)


@pytest.mark.parametrize(
    ("asked", "latest"),
    [
        ({"angle": math.radians(30.0)}, PUSH_UNTIL),  # as it always was about the vertical
        ({"axis": Y, "angle": math.radians(30.0)}, 0.476),  # at 1.1 rad/s
        ({"angle": 0.0, "shift": (0.0, 0.0, 0.015)}, 0.3),  # at 50 mm/s
        ({"axis": Y, "angle": math.radians(-30.0), "shift": (0.0, 0.01, 0.0)}, 0.476),
        ({"axis": Y, "angle": math.pi}, PUSH_UNTIL),
    ],
)
def test_the_push_begins_while_the_object_is_moved(asked: dict[str, Any], latest: float) -> None:
    begins = [replace(TURN, number=k, **asked).draw().push_after for k in range(100)]
    assert 0.9 * latest < max(begins) <= latest + 1e-3


def test_what_is_there_does_not_depend_on_where_it_is_turned() -> None:
    plain, tilted = TURN.draw(), replace(TURN, axis=Y, angle=0.5).draw()
    assert replace(tilted, push_after=plain.push_after) == plain


# --- trials ------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_block_is_tilted_and_moved_as_it_was_asked(
    measure: Measure, monkeypatch: pytest.MonkeyPatch
) -> None:
    plans: list[ManipulationPlan] = []
    reports: list[ManipulationReport] = []

    def heard(plan: ManipulationPlan, **arguments: Any) -> ManipulationReport:
        plans.append(plan)
        reports.append(manipulate(plan, **arguments))
        return reports[-1]

    monkeypatch.setattr("benchmarks.manipulate.manipulate", heard)
    asked = {"axis": Y, "angle": math.radians(20.0), "shift": (0.0, 0.0, 0.008)}
    result = measure(**asked)
    (row,), (report,) = result["rows"], reports
    assert row["success_with_closure"] and row["complete"], row["reason"]
    assert tuple(plans[0].motion.path.axis) == Y
    assert 20.0 <= row["turned_deg"] < 23.0
    assert row["shift_off_mm"] <= report.criteria.shift_mm
    # the verdicts are those of the report about all that was asked for: more was not made
    assert report.asked == asked["angle"]
    assert tuple(report.asked_shift) == asked["shift"]
    assert not replace(report, asked=math.radians(30.0)).success
    assert not replace(report, asked_shift=2.0 * report.asked_shift).success

    assert measure(**asked)["rows"] == [row]
    assert len(reports) == 1  # it was not made again
    assert list(_cells(result))[-1] == "shift off mm"
    title = "turns by 20 degrees about (0, 1, 0) with translations by (0, 0, 8) mm: counts"
    assert str(manipulate_table(result).title).startswith(title)


# --- files -------------------------------------------------------------------------------------


def test_files_from_before_tilts_go_on(measure: Measure, tmp_path: Path) -> None:
    file = tmp_path / "rows.jsonl"
    _written(file, HEADER)
    before = file.read_bytes()
    result = measure()
    assert result["rows"] == [ROW]
    assert file.read_bytes() == before
    assert "axis" not in result and "shift" not in result
    assert str(manipulate_table(result).title).startswith("turns by 90 degrees: counts")


@pytest.mark.parametrize(
    ("asked", "different"),
    [
        ({"axis": Y}, "axis"),
        ({"shift": (0.0, 0.0, 0.01)}, "shift"),
        ({"axis": Y, "angle": 0.5, "shift": (0.0, 0.0, 0.01)}, "angle_deg, axis, shift"),
    ],
)
def test_a_file_of_other_movements_is_refused(
    measure: Measure, tmp_path: Path, asked: dict[str, Any], different: str
) -> None:
    _written(tmp_path / "rows.jsonl", HEADER)
    with pytest.raises(FileFormatError, match=rf"\(different: {different}\)"):
        measure(**asked)


def test_a_file_of_a_tilt_goes_on_with_the_same_and_no_other(
    measure: Measure, tmp_path: Path
) -> None:
    _written(tmp_path / "rows.jsonl", {**HEADER, "axis": list(Y)})
    assert measure(axis=Y)["rows"] == [ROW]
    for asked in ({}, {"axis": (1.0, 0.0, 0.0)}):
        with pytest.raises(FileFormatError, match=r"\(different: axis\)"):
            measure(**asked)


# --- the table ---------------------------------------------------------------------------------


def test_a_table_counts_over_all_trials() -> None:
    failed = {"hand": "allegro_hand", "kind": "block", "planning_cpu_s": 1.0}
    rows = [ROW, {**failed, "found": True, "dropped": True}, {**failed, "found": False}]
    cells = _cells({"angle_deg": 90.0, "rows": rows})
    columns = ("planned", "closed", "success", "complete", "drops")
    assert [cells[name] for name in columns] == ["2/3", "1/3", "1/3", "1/3", "1/3"]
    now = {**ROW, "success_with_closure": ROW["strict"], "success": ROW["loose"]}
    del now["strict"], now["loose"]
    assert _cells({"angle_deg": 90.0, "rows": [now, *rows[1:]]}) == cells
    assert (cells["turned in s"], cells["error deg"]) == ("1.50", "0.50")
    assert "shift off mm" not in cells


def test_a_table_of_a_translation_says_how_far_it_was_off() -> None:
    row = {**ROW, "turned_deg": 0.1}
    result = {"angle_deg": 0.0, "shift": [0.0, 0.0, 0.015], "rows": [row]}
    cells = _cells(result)
    assert (cells["shift off mm"], cells["error deg"]) == ("0.25", "0.10")
    assert str(manipulate_table(result).title).startswith("translations by (0, 0, 15) mm: counts")


def test_names_are_left_where_the_table_is_widest() -> None:
    row = {**ROW, "hand": "shadow_hand_torque", "kind": "superquadric", "time_to_angle_s": 40.25}
    table = manipulate_table({"angle_deg": 180.0, "shift": [0.01, 0.0, 0.0], "rows": [row]})
    text = StringIO()
    Console(width=TABLE_WIDTH, file=text).print(table)
    assert "shadow_hand_torque" in text.getvalue()
    assert "superquadric" in text.getvalue()


# --- what is refused ---------------------------------------------------------------------------


def test_an_unknown_kind_is_refused_before_any_work(tmp_path: Path) -> None:
    with pytest.raises(NotFoundError, match="cone"):
        run_manipulate(
            ["allegro_hand"],
            ["cone"],
            1,
            height=0.08,
            fingers=None,
            stand=0.0,
            seed=0,
            file=tmp_path / "rows.jsonl",
            runner=None,  # type: ignore[arg-type]
        )


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"angle": 0.0}, "give an angle or a shift"),
        ({"angle": math.radians(200.0), "shift": (0.0, 0.0, 0.01)}, "at most a half turn"),
        ({"angle": math.nan}, "angle is nan"),
        ({"shift": (0.0, math.inf, 0.0)}, "shift holds NaN or infinity; give finite numbers"),
        ({"axis": (0.0, 0.0, 0.0)}, "give a direction"),
    ],
)
def test_a_movement_that_cannot_be_is_refused_before_any_work(
    measure: Measure, tmp_path: Path, asked: dict[str, Any], words: str
) -> None:
    with pytest.raises(TaskError, match=words):
        measure(**asked)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--rotate", "q:30"], "--rotate 'q:30' names no axis; give x, y or z and degrees"),
        (["--rotate", "y:a"], "--rotate 'a' holds something else than numbers; give one"),
        (["--shift", "0,0.01"], "--shift '0,0.01' has 2 numbers; give three"),
        (["--rotate", "0"], "give an angle or a shift"),
        (["--rotate", "y:200", "--shift", "0,0,0.01"], "at most a half turn"),
    ],
)
def test_the_command_tells_what_is_wrong(tmp_path: Path, arguments: list[str], words: str) -> None:
    file = tmp_path / "rows.jsonl"
    command = ["bench", "manipulate", "allegro_hand", "--samples", str(file)]
    done = RUN.invoke(app, [*command, *arguments])
    assert done.exit_code == 3, done.output
    assert words in " ".join(done.output.split())
    assert not file.exists()


@pytest.mark.parametrize(
    ("arguments", "header"),
    [
        ([], {}),
        (["--rotate", "90"], {}),
        (["--rotate", "y:30"], {"angle_deg": THIRTY, "axis": list(Y)}),
        (["--shift", "0,0,0.015"], {"angle_deg": 0.0, "shift": [0.0, 0.0, 0.015]}),
    ],
)
def test_the_command_asks_for_what_its_options_say(
    tmp_path: Path, arguments: list[str], header: dict[str, Any]
) -> None:
    """A file with all of its rows shows it: nothing is left to do."""
    file = tmp_path / "rows.jsonl"
    _written(file, {**HEADER, **header})
    command = ["bench", "manipulate", "allegro_hand", "--objects", "block", "-n", "1"]
    done = RUN.invoke(app, [*command, "--seed", "3", "--samples", str(file), *arguments, "--json"])
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["rows"] == [ROW]
