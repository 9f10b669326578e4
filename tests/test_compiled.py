"""CasADi functions as compiled libraries."""

from __future__ import annotations

import shutil
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from planner.errors import PlannerError
from planner.shapes.cache import CACHE_VARIABLE
from planner.synthesis.compiled import COMPILE_VARIABLE, compiled

needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler here")


def example() -> ca.Function:
    x, p = ca.SX.sym("x", 3), ca.SX.sym("p", 2)
    y = ca.vertcat(ca.sin(x[0]) * p[0] + x[1] * x[2], ca.sqrt(ca.sumsqr(x)) / p[1])
    return ca.Function("example", [x, p], [y, ca.jacobian(y, x)])


@needs_compiler
def test_a_compiled_function_gives_the_same_numbers_and_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    monkeypatch.setenv(COMPILE_VARIABLE, "1")
    plain, quick = example(), compiled(example())
    assert quick.class_name() != plain.class_name()
    rng = np.random.default_rng(0)
    for _ in range(20):
        x, p = rng.normal(size=3), rng.normal(size=2)
        for mine, theirs in zip(quick(x, p), plain(x, p), strict=True):
            np.testing.assert_array_equal(np.array(mine), np.array(theirs))
    (library,) = tmp_path.rglob("*.so")
    made = library.stat().st_mtime_ns
    compiled(example())
    assert library.stat().st_mtime_ns == made
    assert [path.name for path in library.parent.iterdir()] == [library.name]


def test_nothing_is_compiled_unless_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    function = example()
    for value in ("", "0"):
        monkeypatch.setenv(COMPILE_VARIABLE, value)
        assert compiled(function) is function
    assert not list(tmp_path.iterdir())


def test_what_is_wrong_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    monkeypatch.setenv(COMPILE_VARIABLE, "yes")
    with pytest.raises(PlannerError, match="set it to 1 or to 0"):
        compiled(example())
    monkeypatch.setenv(COMPILE_VARIABLE, "1")
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(PlannerError, match="no C compiler 'no-such-compiler'"):
        compiled(example())
    monkeypatch.setenv("CC", "false")
    with pytest.raises(PlannerError, match="failed on generated code"):
        compiled(example())
    assert not list(tmp_path.rglob("*.so"))
