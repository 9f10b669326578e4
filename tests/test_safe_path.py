"""Workers of a batch import nothing from the current folder."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from planner.batch.pool import finished
from planner.errors import TaskError
from planner.system.threads import SAFE_PATH, safe_path

PROGRAM = """
import operator
from planner.batch.pool import finished
given_up = lambda item, reason: reason
print(sorted(finished(operator.neg, [1, 2], workers=2, backend=BACKEND, given_up=given_up)))
"""


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["loky", "multiprocessing"])
def test_a_joblib_of_the_current_folder_is_not_run(tmp_path: Path, backend: str) -> None:
    for name in ("joblib.py", "numpy.py", "planner.py"):
        text = f"open('ran', 'a').write({name!r}); raise SystemExit(9)"
        (tmp_path / name).write_text(text, encoding="utf-8")
    program = PROGRAM.replace("BACKEND", repr(backend))
    environment = {name: v for name, v in os.environ.items() if name != SAFE_PATH}
    done = subprocess.run(
        [sys.executable, "-P", "-c", program], cwd=tmp_path, env=environment, timeout=600,
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.stdout == "[-2, -1]\n", done.stderr
    assert not (tmp_path / "ran").exists()


def test_the_environment_is_as_before_when_the_last_has_left(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv(SAFE_PATH, raising=False)
    first, second = safe_path(), safe_path()
    with first:
        second.__enter__()
        assert os.environ[SAFE_PATH] == "1"
    assert os.environ[SAFE_PATH] == "1"
    second.__exit__(None, None, None)
    assert SAFE_PATH not in os.environ
    monkeypatch.setenv(SAFE_PATH, "yes")
    with safe_path():
        pass
    assert os.environ[SAFE_PATH] == "yes"


@pytest.mark.parametrize("workers", [0, -7, 2**63])
def test_a_number_of_workers_that_cannot_be_is_named(workers: int) -> None:
    with pytest.raises(TaskError, match="give a whole number from 1 to 1024"):
        next(finished(abs, [1], workers=workers, backend="loky", given_up=lambda *_: 0))
