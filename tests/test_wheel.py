"""What an installed wheel has: everything but the measurements, and a word on where those are."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The packages as ``pyproject.toml`` has the wheel built, with the models inside."""
    site = tmp_path_factory.mktemp("site-packages")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    wheel = project["tool"]["hatch"]["build"]["targets"]["wheel"]
    for package in wheel["packages"]:
        shutil.copytree(
            ROOT / package, site / package, ignore=shutil.ignore_patterns("__pycache__")
        )
    for source, target in wheel["force-include"].items():
        copy = shutil.copytree if (ROOT / source).is_dir() else shutil.copy
        copy(ROOT / source, site / target)
    return site


@pytest.mark.slow
def test_one_module_brings_all_public_names(installed: Path) -> None:
    code = f"import sys; sys.path.insert(0, {str(installed)!r}); import opposable as o; "
    code += "from opposable import GraspTask, simulate; print(o.__file__, len(o.__all__))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=installed
    )
    file, count = done.stdout.split()
    assert Path(file) == installed / "opposable.py" and int(count) > 40


def opposable(
    site: Path, folder: Path, *arguments: str, code: int = 0
) -> subprocess.CompletedProcess[str]:
    """The installed command, in a folder of the user's."""
    start = f"import sys; sys.path.insert(0, {str(site)!r}); import sim.cli; sim.cli.main()"
    run = subprocess.run(
        [sys.executable, "-c", start, *arguments],
        check=False,
        cwd=folder,
        env=os.environ | {"COLUMNS": "200"},
        capture_output=True,
        text=True,
    )
    assert run.returncode == code, run.stderr
    return run


@pytest.mark.slow
def test_help_and_plan_work_without_the_measurements(installed: Path, tmp_path: Path) -> None:
    """``.ci/run`` runs a trial from the wheel itself."""
    assert not (installed / "benchmarks").exists()
    assert "manipulate" in opposable(installed, tmp_path, "--help").stdout
    opposable(installed, tmp_path, "plan", "allegro_hand", "sphere", "-o", "plan.json")
    assert (tmp_path / "plan.json").is_file()


@pytest.mark.parametrize("words", [("bench",), ("bench", "grasps", "-n", "2", "--help")])
def test_measuring_from_a_wheel_says_what_it_needs(
    words: tuple[str, ...], installed: Path, tmp_path: Path
) -> None:
    run = opposable(installed, tmp_path, *words, code=3)
    assert run.stdout == ""
    (line,) = run.stderr.splitlines()
    assert line.startswith("error: measuring is `python -m benchmarks NAME` in a checkout")
    assert "pip install -e ." in line
