"""Programs as forks of a process that has imported the packages."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import forks
import pytest

from planner.batch.pool import finished


def tell(word: str) -> None:
    """Print what can be told apart, and end with 3."""
    print(word, os.getcwd(), os.environ["MINE"], "sim.trial" in sys.modules)
    print("aside", file=sys.stderr)
    sys.exit(3)


def ask(folder: str) -> None:
    """Run a program from a program."""
    again = forks.run(tell, "inner", folder=Path(folder), environment=os.environ)
    print(again.returncode, again.stdout, end="")  # though the fork ends, and removes its folders


def sleep(seconds: str) -> None:
    print("asleep", flush=True)
    time.sleep(float(seconds))


def pool() -> None:
    """Leave workers that would stay for minutes, should there be more work."""
    jobs = finished(abs, [-1, 1], workers=2, backend="loky", given_up=lambda job, reason: 0)
    assert list(jobs) == [1, 1]


def test_a_program_ends_although_its_workers_would_wait_for_more(tmp_path: Path) -> None:
    done = forks.run(pool, folder=tmp_path, timeout=200.0)  # s; workers idle for 300 s
    assert done.returncode == 0, done.stderr


def test_a_program_has_its_folder_environment_output_and_code(tmp_path: Path) -> None:
    environment = {**forks.environment_of_programs(), "MINE": "yes"}
    for program, word, code, said in (
        (tell, "outer", 3, f"outer {tmp_path} yes True\n"),
        (ask, str(tmp_path), 0, f"3 inner {tmp_path} yes True\n"),
    ):
        done = forks.run(program, word, folder=tmp_path, environment=environment)
        assert (done.returncode, done.stdout) == (code, said), done.stderr
    assert "MINE" not in os.environ


def test_what_fails_says_where_and_what_hangs_is_killed(tmp_path: Path) -> None:
    failed = forks.run(tell, "outer", folder=tmp_path)
    assert failed.returncode == 1
    assert "KeyError: 'MINE'" in failed.stderr
    with pytest.raises(subprocess.TimeoutExpired):
        forks.run(sleep, "3600", folder=tmp_path, timeout=1.0)


def test_a_deprecated_call_of_a_script_is_an_error(tmp_path: Path) -> None:
    script = tmp_path / "old.py"
    script.write_text("import warnings\nwarnings.warn('old', DeprecationWarning)\n")
    done = forks.run(forks.script, str(script), folder=tmp_path)
    assert done.returncode == 1
    assert "DeprecationWarning: old" in done.stderr
