"""The benchmark of synthesis: what it sums up is what was measured."""

from __future__ import annotations

import json
import subprocess
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from conftest import of_trimesh
from rich.console import Console
from typer.testing import CliRunner

from benchmarks.baseline import BASELINE_EPSILON, BASELINE_RATE, against_baseline
from benchmarks.first_grasp import first_grasp_s
from benchmarks.objects import BenchObject, bench_objects
from benchmarks.requests import Request, RequestOutcome, Setting, half_longest_side, outcome_of
from benchmarks.statistics import power_law
from benchmarks.synthesis import run_synthesis, summary_of, total_of
from benchmarks.synthesis_tables import synthesis_tables
from planner.batch.pool import grasp_seed
from planner.errors import HandError, NotFoundError, ObjectError, TaskError
from planner.failure import Failure
from planner.hands.hand import Hand
from planner.quality.ball import epsilon_frogger
from planner.search import plan_grasp
from planner.shapes import Box, shape_key
from planner.system.disk_cache import CACHE_VARIABLE
from planner.task import GraspTask
from sim.cli import app
from sim.runner import Runner

QUIET = Console(quiet=True)
SPHERE = BenchObject(label="sphere", spec="sphere")


def nothing() -> None:
    """A check that never finds Ctrl-C."""


def run(objects: list[BenchObject], n: int, **options: Any) -> dict[str, Any]:
    setting, baseline = options.pop("setting", Setting()), options.pop("baseline", False)
    given: dict[str, Any] = {"console": QUIET, "check": nothing}
    runner = Runner(**(given | options))
    return run_synthesis(["allegro_hand"], objects, n, setting, runner=runner, baseline=baseline)


def outcome(k: int, cpu: float, *, found: bool = True, **values: Any) -> RequestOutcome:
    return RequestOutcome(k=k, cpu_s=cpu, found=found, **{"attempts": 1, **values})


def test_a_summary_adds_up() -> None:
    stages = {"solve": 0.1, "approach": 0.2}
    outcomes = [
        outcome(0, 0.5, stages=stages, without_approach=2, attempts=3, epsilon=0.2),
        outcome(1, 1.5, stages=stages, without_approach=1, epsilon=0.1),
        outcome(
            2,
            2.0,
            found=False,
            stages=stages,
            attempts=4,
            without_approach=0,
            reasons={"approach": 1, "x": 3},
        ),
    ]
    cell = summary_of(outcomes, "no task")
    assert (cell["requested"], cell["found"], cell["attempts"]) == (3, 2, 8)
    assert cell["found_per_cpu_s"] == pytest.approx(2 / 4.0)  # the failed request's time counts
    assert cell["attempts_per_found"] == pytest.approx(4.0)
    assert cell["within_1s"] == pytest.approx(1 / 3)
    assert cell["cpu_s_per_found"]["median"] == pytest.approx(1.0)
    assert cell["stages_cpu_s"] == pytest.approx({"other": 3.1, "approach": 0.6, "solve": 0.3})
    # without that check three would have been found, and its 0.6 s not spent
    assert cell["found_per_cpu_s_without_approach"] == pytest.approx(3 / 3.4)
    assert cell["epsilon"]["median"] == pytest.approx(0.15)
    assert cell["reasons"] == {"x": 3, "approach": 1}
    assert total_of([cell, cell])["found_per_cpu_s_without_approach"] == pytest.approx(3 / 3.4)


def test_without_a_stage_for_it_nothing_is_said_about_the_way_in() -> None:
    cell = summary_of([outcome(0, 0.5, stages={"solve": 0.1}, without_approach=1)], "no task")
    assert cell["found_per_cpu_s_without_approach"] is None


def test_totals_weigh_objects_by_their_time() -> None:
    fast = summary_of([outcome(k, 0.1) for k in range(4)], "no task")
    slow = summary_of([outcome(0, 3.6), outcome(1, 2.0, found=False)], "no task")
    refused = summary_of([RequestOutcome(k=0, error="open mesh")], "no task")
    total = total_of([fast, slow, refused])
    assert total["found_per_cpu_s_without_approach"] is None
    assert (total["found"], total["requested"]) == (5, 6)
    assert total["found_per_cpu_s"] == pytest.approx(5 / 6.0)
    assert total["within_1s"] == pytest.approx(4 / 6)
    assert total["within_1s_least"] == 0.0
    assert refused["error"] == "open mesh"


def test_the_comparison_with_the_baseline() -> None:
    name, theirs = next(iter(BASELINE_EPSILON.items()))
    cells = [
        {"object": name, "found": 2, "epsilon_frogger": {"median": 1.5 * theirs}},
        {"object": "sphere", "found": 2, "epsilon_frogger": {"median": 0.3}},
    ]
    against = against_baseline(cells, 2 * BASELINE_RATE)
    assert against["rate_ratio"] == pytest.approx(2.0)
    assert against["epsilon_ratio"] == pytest.approx({name: 1.5})
    assert against["epsilon_ratio_least"] == pytest.approx(1.5)
    assert against_baseline(cells[1:], None)["epsilon_ratio_median"] is None


def test_a_request_is_what_the_planner_does_with_that_seed(allegro: Hand) -> None:
    setting = Setting(mu=0.7, floating=True, fingers=("thumb", "index", "middle", "ring"), seed=5)
    made = outcome_of(Request(hand="allegro_hand", spec="box", k=1, setting=setting))
    task = GraspTask.create(
        allegro, "box", mu=0.7, table_height=None, fingers=["thumb", "index", "middle", "ring"]
    )
    plan = plan_grasp(task, seed=grasp_seed(5, shape_key(task.object.shape), 1))
    assert made.found
    assert made.attempts == plan.record.attempts
    assert made.features is not None
    assert made.features.q[0] == pytest.approx(
        plan.q[np.concatenate([f.q_index for f in task.fingers])]
    )
    assert made.epsilon_frogger == pytest.approx(
        epsilon_frogger(plan.contacts, half_longest_side=0.04)
    )
    assert 0 < sum(made.stages.values()) <= made.cpu_s
    assert made.without_approach is not None and made.without_approach >= 1


def test_grasps_that_come_too_near_count_as_failed() -> None:
    setting = Setting(clearance=0.5, max_attempts=3)  # m: no hand keeps away that far
    made = outcome_of(Request(hand="allegro_hand", spec="sphere", k=0, setting=setting))
    assert not made.found
    assert made.attempts == 3
    assert made.reasons["clearance"] >= 1
    assert made.without_approach is None


def test_attempts_that_only_lack_a_way_in_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    blocked = Failure(kind="closing_collision", text="blocked")
    monkeypatch.setattr("planner.verification.grasp.find_approach", lambda *_, **__: blocked)
    setting = Setting(max_attempts=3)
    made = outcome_of(Request(hand="allegro_hand", spec="sphere", k=0, setting=setting))
    assert not made.found
    assert made.without_approach == made.reasons["closing_collision"] >= 1


def test_half_the_longest_side_is_of_the_box_not_about_the_centre_of_mass() -> None:
    assert half_longest_side(Box.from_sizes((0.02, 0.08, 0.05))) == pytest.approx(0.04)
    cone = of_trimesh(trimesh.creation.cone(radius=0.03, height=0.12))
    assert half_longest_side(cone) == pytest.approx(0.06)


def test_power_laws_are_found_again() -> None:
    x = [1.0, 10.0, 100.0]
    law = power_law(x, [3.0 * v**0.5 for v in x])
    assert law is not None
    assert (law.exponent, law.factor, law.spread) == pytest.approx((0.5, 3.0, 0.0))
    assert power_law([1.0, 1.0], [2.0, 3.0]) is None
    noisy = power_law([1.0, 10.0, 100.0], [1.0, 2.0, 1.0])
    assert noisy is not None
    assert noisy.exponent == pytest.approx(0.0)
    # residuals of log y: -1/3, 2/3, -1/3 of log 2
    assert noisy.spread == pytest.approx(np.log(2) * np.sqrt(2) / 3)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    trimesh.creation.box((0.05, 0.05, 0.08)).export(tmp_path / "b_box.stl")
    half = trimesh.creation.icosphere(subdivisions=2, radius=0.04)
    half.update_faces(half.triangles_center[:, 2] > 0)
    half.export(tmp_path / "a_open.ply")
    (tmp_path / "readme.txt").write_text("no mesh")
    return tmp_path


def test_folders_stand_for_their_mesh_files(folder: Path, tmp_path: Path) -> None:
    found = bench_objects(["sphere", str(folder)])
    assert [(o.label, o.may_fail) for o in found] == [
        ("sphere", False),
        ("a_open", True),
        ("b_box", True),
    ]
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(ObjectError, match=r"no mesh file; meshes end in \.glb, \.obj"):
        bench_objects([str(empty)])
    with pytest.raises(ObjectError, match="there are no objects"):
        bench_objects([])


def test_a_mesh_of_a_folder_that_bounds_no_solid_is_a_row(folder: Path) -> None:
    result = run(bench_objects([str(folder)])[:1], 2)
    (cell,) = result["cells"]
    assert "not the surface of a solid" in cell["error"]
    assert cell["requested"] == 0
    text = StringIO()
    Console(width=140, file=text).print(*synthesis_tables(result))
    assert "not tried" in text.getvalue()


def test_what_was_named_must_be_right(folder: Path) -> None:
    with pytest.raises(ObjectError, match="not the surface of a solid"):
        run(bench_objects([str(folder / "a_open.ply")]), 1)
    with pytest.raises(ObjectError, match="no object is called 'bx'"):
        run([BenchObject(label="bx", spec="bx")], 1)
    with pytest.raises((NotFoundError, HandError), match="pinky"):
        run([SPHERE], 1, setting=Setting(fingers=("thumb", "pinky")))


def test_ctrl_c_keeps_what_is_finished() -> None:
    calls = []

    def check() -> None:
        calls.append(True)
        if len(calls) == 3:
            raise KeyboardInterrupt

    result = run([SPHERE], 9, check=check)
    assert result["interrupted"]
    (cell,) = result["cells"]
    assert 1 <= cell["requested"] <= 2
    assert cell["found"] == cell["requested"]


def test_the_command_prints_tables_or_json(tmp_path: Path) -> None:
    runner = CliRunner()
    file = tmp_path / "out.json"
    arguments = ["bench", "synthesis", "allegro_hand", "--objects", "sphere", "-n", "4"]
    shown = runner.invoke(app, [*arguments, "--baseline", "--out", str(file)])
    assert shown.exit_code == 0, shown.output
    for text in ("4/4", "solve", "found/s", "against FRoGGeR"):
        assert text in shown.output
    stored = json.loads(file.read_text(encoding="utf-8"))
    (cell,) = stored["cells"]
    assert cell["found"] == len(cell["requests"]) == 4
    assert cell["cpu_s"] == pytest.approx(sum(r["cpu_s"] for r in cell["requests"]))
    assert sum(cell["stages_cpu_s"].values()) == pytest.approx(cell["cpu_s"])
    assert cell["diversity"]["n"] == cell["diversity_of_random_starts"]["n"] == 4
    assert stored["setting"]["mu"] == 0.5
    # more than the attempts: hand, task and problem are made anew
    first = [r["first_s"] for r in cell["requests"]]
    assert first[1:] == [None] * 3 and first[0] > cell["requests"][0]["cpu_s"]
    assert stored["total"]["first_grasp_cpu_s_worst"] == cell["first_grasp_cpu_s"] == first[0]


def test_the_first_grasp_is_timed_with_an_empty_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[str] = []
    real = subprocess.run

    def run_and_look(words: list[str], **options: Any) -> Any:
        given.append(options["env"][CACHE_VARIABLE])
        assert not any(Path(given[-1]).iterdir())
        done = real(words, **options)
        assert (Path(given[-1]) / "field").is_dir()  # a mesh was prepared there
        return done

    monkeypatch.setattr(subprocess, "run", run_and_look)
    request = Request(hand="allegro_hand", spec="torus", k=0, setting=Setting())
    taken = first_grasp_s(request)
    assert taken is not None and 0.05 < taken < 20
    assert len(given) == 1 and not Path(given[0]).exists()


def test_a_first_grasp_that_is_not_found_has_no_time_and_one_that_fails_says_why() -> None:
    never = Setting(clearance=10.0, max_attempts=1)
    assert first_grasp_s(Request(hand="allegro_hand", spec="box", k=0, setting=never)) is None
    with pytest.raises(TaskError, match=r"first grasp could not be measured: .*nobody"):
        first_grasp_s(Request(hand="nobody", spec="box", k=0, setting=never))


def test_two_workers_make_the_same_requests() -> None:
    alone, both = run([SPHERE], 3), run([SPHERE], 3, workers=2)

    def rows(result: dict[str, Any]) -> list[Any]:
        return [(r["k"], r["attempts"], r["epsilon"]) for r in result["cells"][0]["requests"]]

    assert rows(alone) == rows(both)
