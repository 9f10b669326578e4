"""The door to compiled kernels: which form runs, and that both can be asked."""

from __future__ import annotations

import dis
import importlib.util
import marshal
import subprocess
import sys
from types import CodeType, FunctionType
from typing import Any

import numpy as np
import pytest

from planner.numerics import kernels
from planner.numerics.kernels import compile_loops, globals_read, kernel
from planner.proximity import gap_loops
from planner.synthesis.loops import clearances


def plain_norms(rows: np.ndarray) -> np.ndarray:
    norms: np.ndarray = np.sqrt((rows**2).sum(axis=1))
    return norms


@kernel(plain_norms)
def norms(rows: np.ndarray) -> np.ndarray:
    out = np.empty(len(rows))
    for i in range(len(rows)):
        total = 0.0
        for j in range(rows.shape[1]):
            total += rows[i, j] * rows[i, j]
        out[i] = np.sqrt(total)
    return out


def test_both_forms_agree() -> None:
    pytest.importorskip("numba")
    rows = np.random.default_rng(0).normal(size=(20, 3))
    expected = plain_norms(rows)
    assert np.allclose(norms(rows), expected, atol=1e-15, rtol=0)
    assert np.allclose(compile_loops(norms.loops)(rows), expected, atol=1e-15, rtol=0)  # type: ignore[attr-defined]
    assert norms.plain is plain_norms  # type: ignore[attr-defined]


def test_numba_is_not_imported_before_a_kernel_is_called() -> None:
    code = "import sys, planner.search, planner.numerics.kernels; print('numba' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_planning_is_imported_without_what_few_plans_need() -> None:
    """SciPy alone takes longer to load than all else together."""
    code = "import sys; from planner import plan_grasp, GraspTask; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = {name.partition(".")[0] for name in done.stdout.split()}
    assert {"casadi", "pinocchio", "coal"} <= loaded
    assert not loaded & {"scipy", "trimesh", "qpsolvers", "numba"}


def _told_by_dis(code: CodeType) -> set[str]:
    return {i.argval for i in dis.get_instructions(code) if i.opname == "LOAD_GLOBAL"}


def test_globals_that_code_reads_are_those_that_dis_tells() -> None:
    """Of functions of all kinds; an attribute that is called like a global is none."""
    functions = [
        value
        for module in (dis, subprocess, gap_loops, clearances, kernels)
        for value in vars(module).values()
        if isinstance(value, FunctionType)
    ]
    assert len(functions) > 50
    for function in functions:
        assert globals_read(function.__code__) == _told_by_dis(function.__code__)
    namespace: dict[str, Any] = {}
    exec("def f(np):\n    return norms(np.rows)", namespace)
    assert globals_read(namespace["f"].__code__) == {"norms"}


def test_globals_of_code_of_many_names_are_found() -> None:
    """Beyond 127 names their numbers take a second instruction, beyond 32767 a third."""
    names = [f"name_{k}" for k in range(33_000)]
    code = compile(f"def f():\n    return [{', '.join(names)}]", "many", "exec").co_consts[0]
    assert isinstance(code, CodeType)
    assert globals_read(code) == set(names) == _told_by_dis(code)


def test_the_name_of_machine_code_does_not_depend_on_where_the_loops_were_read_from() -> None:
    """Read from a ``.pyc`` file or compiled anew: the same machine code serves both."""
    loops = norms.loops  # type: ignore[attr-defined]
    again = FunctionType(marshal.loads(marshal.dumps(loops.__code__)), loops.__globals__)
    assert kernels._digest(again) == kernels._digest(loops)
    held = list(loops.__code__.co_consts), list(loops.__code__.co_names)  # more references
    assert kernels._digest(again) == kernels._digest(loops) and held


@pytest.mark.parametrize("asked", ["0", ""])
def test_the_variable_switches_kernels_off(asked: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPPOSABLE_COMPILE", asked)
    ran: list[str] = []

    def same_plain(x: float) -> float:
        ran.append("plain")
        return x

    @kernel(same_plain)
    def same(x: float) -> float:
        return x

    assert same(2.0) == 2.0
    has_numba = importlib.util.find_spec("numba") is not None
    assert (ran == ["plain"]) == (asked == "0" or not has_numba)
