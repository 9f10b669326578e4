"""The command ``opposable``: what it prints and writes, its exit codes, bad input, and Ctrl-C."""

from __future__ import annotations

import copy
import io
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from brief import COARSE

import planner
from planner.files import PlanFile, read_plan
from planner.hand_loading import load_hand
from sim.cli import main
from sim.cli.common import print_json
from sim.cli.options import names
from sim.report_file import ReportFile

pytestmark = pytest.mark.usefixtures("brief_trials")

ROOT = Path(__file__).resolve().parent.parent
TOO_HEAVY = ("allegro_hand", "box", "--mass", "15")
"""A task whose every attempt fails: 15 kg are more than the fingers' motors can hold."""


@dataclass(frozen=True)
class Result:
    """What a call of the command left: exit code, output, and messages with blanks as one."""

    code: int
    out: str
    err: str


def opposable(*arguments: str | Path) -> Result:
    """Call the command in this process."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err), pytest.raises(SystemExit) as ended:
        main([str(a) for a in arguments])
    code = ended.value.code
    assert isinstance(code, int)
    return Result(code, out.getvalue(), " ".join(err.getvalue().split()))


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The plan file of an Allegro-type hand and a sphere."""
    path = tmp_path_factory.mktemp("plan") / "plan.json"
    result = opposable("plan", "allegro_hand", "sphere", "-o", path)
    assert result.code == 0, result.err
    assert "force closure" in result.out
    return path


def without_times(plan: dict[str, Any]) -> dict[str, Any]:
    """A plan's data without what the clock decides."""
    plan = copy.deepcopy(plan)
    del plan["record"]["cpu_s"], plan["record"]["build_s"]
    return plan


def test_inspect_prints_every_joint_and_actuator() -> None:
    result = opposable("hands", "shadow_hand")
    hand = load_hand("shadow_hand")
    assert result.code == 0
    assert result.err == ""
    for name in (*hand.fingers, *hand.actuation.names, *hand.fingers["thumb"].joints):
        assert name in result.out


def test_inspect_as_json_agrees_with_the_hand() -> None:
    result = opposable("hands", "allegro_hand", "--json")
    assert result.code == 0
    data, hand = json.loads(result.out), load_hand("allegro_hand")
    assert data["sha256"] == hand.digest
    assert [a["name"] for a in data["actuator_table"]] == list(hand.actuation.names)
    for finger in data["fingers"]:
        for joint in finger["joints"]:
            assert hand.joint_names[joint["index"]] == joint["name"]
            assert joint["lower"] == hand.q_lower[joint["index"]]
            assert joint["torque_limit_N_m"] == pytest.approx(0.7)


def test_an_object_stands_in_the_pose_that_is_asked_for(tmp_path: Path) -> None:
    box = ("allegro_hand", "box:0.05x0.06x0.09")
    assert opposable("plan", *box, "--pose", "1", "-o", tmp_path / "plan.json").code == 0
    task = read_plan(tmp_path / "plan.json").task
    standing = task.object.resting_pose(index=1)
    np.testing.assert_allclose(task.T_world_object.homogeneous, standing.homogeneous, atol=1e-12)
    assert abs(standing.rotation[2, 2]) < 1e-12  # it lies
    refused = opposable("plan", *box, "--pose", "9", "-o", tmp_path / "plan.json")
    assert refused.code == 3 and "there is no pose 9" in refused.err


def test_a_plan_file_as_the_object_is_told_what_takes_it(planned: Path) -> None:
    result = opposable("plan", "allegro_hand", planned)
    assert result.code == 3
    assert f"is a plan file, not an object: opposable test {planned}" in result.err


def test_a_plan_file_is_valid_and_the_same_for_the_same_seed(planned: Path) -> None:
    first = json.loads(planned.read_text(encoding="utf-8"))
    PlanFile.model_validate(first)
    again = planned.with_name("again.json")
    result = opposable("plan", "allegro_hand", "sphere", "-o", again, "--json")
    second = json.loads(again.read_text(encoding="utf-8"))
    assert result.code == 0
    assert json.loads(result.out) == second
    assert without_times(second) == without_times(first)


def test_options_of_plan_reach_the_plan(tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    options = ("--seed", "3", "--mu", "0.7", "--mass", "0.05", "--fingers", "thumb, index,middle")
    result = opposable("plan", "allegro_hand", "sphere", "-o", path, *options)
    assert result.code == 0, result.err
    plan = json.loads(path.read_text(encoding="utf-8"))
    assert plan["record"]["seed"] == 3
    assert plan["task"]["mu"] == 0.7
    assert plan["task"]["object"]["mass_kg"] == 0.05
    assert plan["task"]["fingers"] == ["thumb", "index", "middle"]


@pytest.mark.slow
def test_plan_simulate_analyse_round_trip(planned: Path, tmp_path: Path, can_draw: bool) -> None:
    report_file, picture = tmp_path / "report.json", tmp_path / "held.png"
    result = opposable("test", planned, "-o", report_file, "--picture", picture)
    assert result.code == 0, result.err
    assert "held" in result.out
    report = json.loads(report_file.read_text(encoding="utf-8"))
    ReportFile.model_validate(report)
    assert report["success"]
    assert report["samples"]["phase"][-1] == "hold"
    assert_picture_or_reason(picture, report, result.out, can_draw)
    analysis = opposable("analyse", planned, "--json")
    assert analysis.code == 0
    plan = json.loads(planned.read_text(encoding="utf-8"))
    judged = json.loads(analysis.out)
    assert judged["closure"]["closed"]
    assert judged["epsilon"] == pytest.approx(plan["quality"]["epsilon"], rel=1e-6)
    assert report["quality_planned"]["epsilon"] == pytest.approx(judged["epsilon"], rel=1e-6)


def assert_picture_or_reason(
    picture: Path, report: dict[str, Any], out: str, can_draw: bool
) -> None:
    """A picture where the machine draws, and only there a reason instead."""
    assert (report["picture"] is not None) == can_draw, report["picture_reason"]
    if not can_draw:
        assert report["picture_reason"].split()[0] in out
    else:
        assert picture.read_bytes().startswith(b"\x89PNG")
        assert picture.name in out


def test_simulate_says_no_when_the_object_is_not_held(planned: Path) -> None:
    result = opposable("test", planned, "--sim-mu", "0", "--json")
    report = json.loads(result.out)
    assert result.code == 1
    assert not report["success"]
    assert report["reason"] in ("slipped", "dropped", "tipped", "no contact")


@pytest.mark.slow
def test_run_writes_plan_report_and_picture(tmp_path: Path, can_draw: bool) -> None:
    folder = tmp_path / "new" / "folder"
    result = opposable("run", "allegro_hand", "box", "--out", folder)
    assert result.code == 0, result.err
    PlanFile.model_validate_json((folder / "plan.json").read_text(encoding="utf-8"))
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    ReportFile.model_validate(report)
    assert_picture_or_reason(folder / "held.png", report, result.out, can_draw)
    assert f"open in a browser: {folder}/report.html" in result.out
    assert "held" in result.out
    assert len(result.out.splitlines()) < 15  # verdict, table, where to look
    assert not list(folder.glob("*.part"))


def bench_grasps(folder: Path, n: int) -> tuple[str | Path, ...]:
    """Words of a small ``grasps`` that keeps its results in a folder."""
    asked = ("allegro_hand", "--objects", "sphere", "-n", str(n))
    return ("bench", "grasps", *asked, "--out", folder / "out.json")


def rows_in(folder: Path) -> list[str]:
    """Finished lines of the journal."""
    path = folder / "out.json.journal"
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True) if path.exists() else []
    return [line for line in lines[1:] if line.endswith("\n")]


@pytest.mark.slow
def test_a_measurement_writes_its_rows_and_its_table(tmp_path: Path) -> None:
    result = opposable(*bench_grasps(tmp_path, 1), "--json")
    assert result.code == 0, result.err
    data = json.loads(result.out)
    assert data == json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))
    (outcome,) = data["rows"]
    assert outcome["found"]
    assert outcome["held"]
    assert data["summary"][0]["rows"][0][2:4] == ["1/1", "1/1"]
    assert not rows_in(tmp_path)  # a journal is of what is not finished


@pytest.mark.slow
@pytest.mark.usefixtures("plain_searches")
@pytest.mark.parametrize(("number", "workers"), [(signal.SIGINT, 1), (signal.SIGTERM, 2)])
def test_an_interrupted_bench_keeps_its_rows(
    number: signal.Signals, workers: int, tmp_path: Path
) -> None:
    words = [str(w) for w in bench_grasps(tmp_path, 50)]
    words += ["--workers", str(workers)]
    code = f"from brief import *; from sim.cli import main\nwith brief_trials(): main({words!r})"
    with subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=Path(__file__).parent,
        start_new_session=True,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        for _ in range(6000):  # ten minutes are a hang
            if rows_in(tmp_path) or process.poll() is not None:
                break
            time.sleep(0.1)
        os.killpg(process.pid, number)  # a terminal and a system end the workers, too
        _, message = process.communicate(timeout=600)
    assert process.returncode == 130, message
    assert "Traceback" not in message
    kept = len(rows_in(tmp_path))
    assert 1 <= kept < 50
    assert f"interrupted: {kept} of 50 are in" in " ".join(message.split())


def contacts_file(path: Path, points: list[list[float]], model: str) -> Path:
    """A file of contacts on the unit sphere."""
    contacts = [
        {
            "position_m": p,
            "normal_into_object": [-x for x in p],
            "model": model,
            "mu": 0.5,
            "mu_torsion_m": 0.1,
        }
        for p in points
    ]
    path.write_text(json.dumps({"contacts": contacts}), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("points", "model", "code", "words"),
    [
        ([[1, 0, 0], [-1, 0, 0]], "point", 1, "not closed: rank 5"),
        ([[1, 0, 0], [-1, 0, 0]], "soft", 0, "closed: rank 6"),
        ([[1, 0, 0], [-0.5, 0.75**0.5, 0], [-0.5, -(0.75**0.5), 0]], "point", 0, "closed: rank 6"),
    ],
)
def test_analyse_judges_contacts_that_were_typed_in(
    points: list[list[float]], model: str, code: int, words: str, tmp_path: Path
) -> None:
    path = contacts_file(tmp_path / "contacts.json", points, model)
    result = opposable("analyse", path)
    assert result.code == code
    assert words in result.out


def test_schema_describes_the_file_that_was_written(planned: Path) -> None:
    result = opposable("export", "--schema", "plan")
    assert result.code == 0
    schema, plan = json.loads(result.out), json.loads(planned.read_text(encoding="utf-8"))
    assert set(schema["required"]) <= set(plan) <= set(schema["properties"])


def test_no_grasp_found_has_its_own_exit_code_and_writes_nothing(tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    result = opposable("plan", *TOO_HEAVY, "--max-attempts", "2", "-o", path)
    assert result.code == 4
    assert result.out == ""
    assert "not found: no grasp of box with allegro_hand" in result.err
    assert "in 2 attempts" in result.err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("hands", "alegro_hand"), "Did you mean 'allegro_hand'?"),
        (("hands", "nowhere/hand.toml"), "nowhere/hand.toml does not exist; give a hand.toml"),
        (("plan", "allegro_hand", "bax"), "Did you mean 'box'?"),
        (("plan", "allegro_hand", "box", "--fingers", "thumb,indx,ring"), "mean 'index'?"),
        (
            ("plan", "allegro_hand", "box", "--mass", "-1"),
            "mass is -1.0; give a finite number > 0 in kg",
        ),
        (
            ("plan", "allegro_hand", "box", "--mass", "nan"),
            "mass is nan; give a finite number > 0 in kg",
        ),
        (("plan", "allegro_hand", "box", "--mu", "nan"), "mu is nan; give a finite number"),
        (("plan", "allegro_hand", "box", "--mu", "-0.5"), "mu is -0.5; give a finite number"),
        (("plan", "allegro_hand", "box", "--mu", "0"), "without friction; give mu > 0"),
        (("plan", "allegro_hand", "box:60x60x60"), "in millimetres by mistake?"),
        (("plan", "allegro_hand", "box:0.4x0.4x0.4"), "too large for allegro_hand"),
        (("plan", "allegro_hand", "box:0.05x-0.05x0.05"), "box: y is -0.05"),
        (("plan", "allegro_hand", "box:0.05x0.05"), "needs 3, in metres"),
        (("plan", "allegro_hand", "sphere:nan"), "radius is nan; give a finite number > 0 in m"),
        (("plan", "allegro_hand", "box:[/]"), "box:[/]"),
        (("plan", "allegro_hand", "box", "--fingers", "thumb,index"), "needs at least 3"),
        (("plan", "allegro_hand", "box", "--fingers", " ,"), "holds no name"),
        (("learn", "allegro_hand", "sphere", "--senses", ""), "'' holds no name"),
        (("plan", "allegro_hand", "box", "--fingers", "thumb,thumb,ring"), "named twice"),
        (("plan", "allegro_hand", "box", "--max-cpu-s", "0"), "give seconds > 0"),
        (("plan", "allegro_hand", "box", "-o", "nowhere/plan.json"), "no folder nowhere"),
        (("test", "missing.json"), "cannot read plan file missing.json: No such file"),
        (("test", "[bold]missing.json"), "[bold]missing.json"),
        (("analyse", "missing.json"), "missing.json: No such file"),
        (("export", "--schema", "plans"), "Did you mean 'plan'?"),
        (("batch", "allegro_hand", "bax"), "Did you mean 'box'?"),
    ],
    ids=lambda v: " ".join(v) if isinstance(v, tuple) else "",
)
def test_bad_input_says_what_to_do(
    arguments: tuple[str, ...], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    result = opposable(*arguments)
    assert result.code == 3
    assert result.out == ""
    assert result.err.startswith("error: ")
    assert words in result.err
    assert not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_made_ends_before_planning(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    result = opposable("run", *TOO_HEAVY, "--out", tmp_path / "file" / "folder")
    assert result.code == 3
    assert "cannot make the folder" in result.err


def test_bad_numbers_of_the_simulation_are_refused(planned: Path, tmp_path: Path) -> None:
    for value in ("nan", "-1"):
        result = opposable("test", planned, "--sim-mu", value)
        assert result.code == 3
        assert "mu in simulation is" in result.err
    result = opposable("test", planned, "-o", tmp_path / "nowhere" / "report.json")
    assert result.code == 3
    assert "make it" in result.err


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere there is always a display")
def test_view_without_a_display_is_refused(planned: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    result = opposable("test", planned, "--view")
    assert result.code == 3
    assert "there is no display" in result.err


def edited(change: Callable[[dict[str, Any]], object]) -> Callable[[str], str]:
    """A text of a plan from another one by a change of its data."""

    def apply(text: str) -> str:
        data = json.loads(text)
        change(data)
        return json.dumps(data)

    return apply


def shift_contact(data: dict[str, Any]) -> None:
    data["contacts"][0]["position_world_m"][2] += 0.001


def bend_joint(data: dict[str, Any]) -> None:
    data["grasp"]["q_rad"][1] = 9.0


def move_hand(data: dict[str, Any]) -> None:
    data["grasp"]["T_world_base"]["position_m"][0] += 0.02


DAMAGE: dict[str, tuple[Callable[[str], str], str]] = {
    "cut off": (lambda text: text[: len(text) // 2], "is damaged or not JSON"),
    "not JSON": (lambda text: "<xml/>", "is damaged or not JSON"),
    "a list": (lambda text: "[]", "holds a list"),
    "another file": (lambda text: '{"format": "opposable-report"}', "is not a plan file"),
    "another version": (edited(lambda d: d.update(version=99)), "plan version 99; this Opposable"),
    "another hand": (
        edited(lambda d: d["task"]["hand"].update(sha256="0" * 64)),
        "was planned for a different 'allegro_hand'",
    ),
    "an unknown hand": (
        edited(lambda d: d["task"]["hand"].update(name="alegro_hand")),
        "Did you mean 'allegro_hand'?",
    ),
    "an unknown finger": (edited(lambda d: d["task"].update(fingers=["a", "b", "c"])), "'a'"),
    "a missing field": (edited(lambda d: d["grasp"].pop("q_rad")), "grasp.q_rad is missing"),
    "an unknown field": (edited(lambda d: d.update(extra=1)), "extra"),
    "NaN": (edited(lambda d: d["task"].update(mu=float("nan"))), "task.mu"),
    "negative mass": (edited(lambda d: d["task"]["object"].update(mass_kg=-1)), "mass_kg"),
    "a joint outside its range": (edited(bend_joint), "outside its range"),
    "a hand elsewhere": (edited(move_hand), "fails its checks"),
    "a contact elsewhere": (edited(shift_contact), "its contacts are not those of its joints"),
}


@pytest.mark.parametrize("name", DAMAGE)
def test_a_damaged_plan_file_is_refused(name: str, planned: Path, tmp_path: Path) -> None:
    damage, words = DAMAGE[name]
    path = tmp_path / "plan.json"
    path.write_text(damage(planned.read_text(encoding="utf-8")), encoding="utf-8")
    result = opposable("test", path)
    assert result.code == 3
    assert result.out == ""
    assert result.err.startswith("error: ")
    assert words in result.err


@pytest.mark.parametrize(
    ("option", "given", "allowed"),
    [
        ("--mu", "abc", "a number"),
        ("--seed", "1.5", "an integer"),
        ("--seed", "-1", "greater than or equal to 0"),
        ("--stand", "nan", "greater than or equal to 0"),
    ],
)
def test_a_value_that_an_option_does_not_take_is_said_with_what_it_takes(
    option: str, given: str, allowed: str
) -> None:
    result = opposable("plan", "allegro_hand", "box", option, given)
    said = " ".join(result.err.replace("│", " ").split())
    assert result.code == 2
    assert f"'{option}': it is '{given}'; it should be {allowed}" in said
    assert "Input" not in said


@pytest.mark.parametrize(
    "arguments",
    [(), ("plan",), ("nothing",), ("plan", "allegro_hand", "box", "--max-attempts", "0")],
    ids=" ".join,
)
def test_wrong_usage_has_its_own_exit_code(arguments: tuple[str, ...]) -> None:
    assert opposable(*arguments).code == 2


def test_every_command_explains_itself() -> None:
    for command in ("run", "hands", "plan", "test", "analyse", "export"):
        result = opposable(command, "--help")
        assert result.code == 0
        assert command in result.out


@pytest.mark.slow
def test_ctrl_c_in_a_run_leaves_plan_and_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    step, steps = mujoco.mj_step, 0

    def interrupted_step(*arguments: Any) -> None:
        nonlocal steps
        steps += 1
        step(*arguments)
        if steps == 300:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(mujoco, "mj_step", interrupted_step)
    result = opposable("run", "allegro_hand", "sphere", "--out", tmp_path)
    assert result.code == 130
    assert steps == 300
    PlanFile.model_validate_json((tmp_path / "plan.json").read_text(encoding="utf-8"))
    report = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    ReportFile.model_validate(report)
    assert report["reason"] == "interrupted"
    assert np.isclose(report["simulated_s"], 300 * COARSE.timestep)


SAY_WHEN = """
import sys
import {module} as module
import sim.cli

function, calls = {owner}.{name}, 0

def announced(*arguments, **options):
    global calls
    calls += 1
    if calls == {call}:
        print("now", flush=True)
    return function(*arguments, **options)

{owner}.{name} = announced
sim.cli.main(sys.argv[1:])
"""
"""The command in a process that prints "now" at a certain call of a function."""


def interrupt(script: str, *arguments: str | Path) -> Result:
    """Run a script, send it SIGINT when it says "now", and wait for its end."""
    paths = [str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
    process = subprocess.Popen(
        [sys.executable, "-c", script, *map(str, arguments)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    with process:
        assert process.stdout is not None
        while (line := process.stdout.readline()) not in ("now\n", ""):
            pass
        process.send_signal(signal.SIGINT)
        try:
            out, err = process.communicate(timeout=600)
        finally:
            process.kill()
    assert line == "now\n", err
    return Result(process.returncode, out, err)


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="SIGINT to one process is a matter of POSIX")
def test_ctrl_c_ends_planning_even_inside_a_solve(tmp_path: Path) -> None:
    script = SAY_WHEN.format(
        module="planner.search.grasp", owner="module", name="optimize_grasp", call=3
    )
    options = ("--max-attempts", "1000000", "-o", tmp_path / "plan.json")
    result = interrupt(script, "plan", *TOO_HEAVY, *options)
    assert result.code == 130
    assert "interrupted" in result.err
    assert "Traceback" not in result.err
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="SIGINT to one process is a matter of POSIX")
def test_ctrl_c_ends_a_trial_with_a_whole_report(planned: Path, tmp_path: Path) -> None:
    path = tmp_path / "report.json"
    script = SAY_WHEN.format(module="mujoco", owner="module", name="mj_step", call=500)
    result = interrupt(script, "test", planned, "-o", path, "--json")
    assert result.code == 130
    assert "Traceback" not in result.err
    report = json.loads(path.read_text(encoding="utf-8"))
    assert report == json.loads(result.out)
    assert report["reason"] == "interrupted"
    assert not list(tmp_path.glob("*.part"))


def test_defaults_are_those_of_the_library() -> None:
    import inspect

    from planner.task import DEFAULT_MU
    from sim.cli import grasp as cli
    from sim.scene.physics import PhysicsOptions, named_physics

    defaults = {
        name: parameter.default for name, parameter in inspect.signature(cli.run).parameters.items()
    }
    assert defaults["mu"] == DEFAULT_MU
    assert defaults["max_attempts"] is None  # the library tells by what else is asked for
    assert defaults["sim_mu"] is None  # that of the physics
    assert named_physics(defaults["physics"]) == PhysicsOptions()


def test_names_are_those_between_the_commas() -> None:
    assert names("sphere, box,,mug ,") == ["sphere", "box", "mug"]


def test_json_on_stdout_knows_no_nan(capsys: pytest.CaptureFixture[str]) -> None:
    print_json({"dual": float("nan"), "cells": [{"bound": np.inf}]})
    told = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert told == {"dual": None, "cells": [{"bound": None}]}


def test_the_command_says_its_version() -> None:
    done = opposable("--version")
    assert done.code == 0
    assert done.out == f"opposable {planner.__version__}\n"


def test_an_expected_load_is_asked_for_on_the_command_line(tmp_path: Path) -> None:
    sphere = ("plan", "allegro_hand", "sphere", "-o", tmp_path / "plan.json", "--expect-load")
    assert opposable(*sphere, "3").code == 0
    assert read_plan(tmp_path / "plan.json").task.grip_force > 2.9
    for text, wrong in (("-1", "the expected force is -1"), ("1,2,3", "has 3 numbers")):
        refused = opposable(*sphere, text)
        assert refused.code == 3 and wrong in refused.err
