"""``opposable batch`` and ``opposable pick``."""

from __future__ import annotations

import io
import json
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import pytest
from rich.console import Console

from planner.batch import BatchProgress
from planner.files import read_plan
from sim.batch_report import BatchBar
from sim.cli import main

pytest.importorskip("pyarrow")


def opposable(*arguments: str | Path) -> tuple[int, str, str]:
    """Exit code, output and messages of the command, called in this process."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err), pytest.raises(SystemExit) as ended:
        main([str(a) for a in arguments])
    code = ended.value.code
    assert isinstance(code, int)
    return code, out.getvalue(), " ".join(err.getvalue().split())


def test_a_batch_is_planned_summed_up_exported_and_picked_from(tmp_path: Path) -> None:
    folder = tmp_path / "set"
    words = ("batch", "allegro_hand", "sphere", "sphere:0.2", "-n", "3", "--workers", "1")
    code, out, err = opposable(*words, "--out", folder, "--export", "dexgraspbench")
    assert code == 0, err
    assert "3/3" in out
    assert "0/3" in out
    assert "3 grasps exported" in err
    written = folder / "dexgraspbench" / "graspdata" / "allegro_hand" / "sphere-0.035"
    assert (written / "2.npy").exists()

    code, out, _ = opposable(*words, "--out", folder, "--json")
    summary = json.loads(out)
    assert summary == json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    sphere, too_large = summary["objects"]
    assert (sphere["requested"], sphere["found"], sphere["attempts_per_found"]) == (3, 3, 1.0)
    assert sphere["diversity"]["n"] == 3
    assert "too large" in too_large["commonest_reason"]
    assert too_large["cpu_s_per_found"] is None

    code, _, err = opposable(*words, "--out", folder, "--mu", "0.6")
    assert code == 3
    assert "mu is 0.5 there and 0.6 here" in err
    for other in (("--objective", "torque"), ("--rounds", "0")):
        code, _, err = opposable(*words, "--out", folder, *other)
        assert code == 3
        assert "options" in err

    code, _, err = opposable("pick", folder, "1", "-o", tmp_path / "plan.json")
    assert code == 0, err
    assert read_plan(tmp_path / "plan.json").task.object.name == "sphere"
    assert "was not found" in opposable("pick", folder, "4", "-o", tmp_path / "no.json")[2]
    assert "There is: 0 to 5" in opposable("pick", folder, "6", "-o", tmp_path / "no.json")[2]
    assert not (tmp_path / "no.json").exists()


def test_a_batch_without_a_grasp_says_so(tmp_path: Path) -> None:
    words = ("batch", "allegro_hand", "sphere:0.2", "-n", "1", "--workers", "1")
    assert opposable(*words, "--out", tmp_path / "set")[0] == 4
    code, _, err = opposable(*words, "--out", tmp_path / "no" / "such")
    assert code == 3
    assert "there is no folder" in err


def test_the_bar_shows_rate_and_estimated_end() -> None:
    drawn = io.StringIO()
    with BatchBar(Console(file=drawn, force_terminal=True, width=120)) as bar:
        assert bar.kept() == "nothing was planned"
        bar.show(BatchProgress(total=100, done=20, kept=20, found=0, elapsed_s=0.0))
        bar.show(BatchProgress(total=100, done=40, kept=20, found=18, elapsed_s=10.0))
        assert bar.kept() == "40 grasps are kept"
    assert "40/100" in drawn.getvalue()
    assert "2.0/s, found 18 of 20" in drawn.getvalue()
