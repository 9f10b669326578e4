"""The door to compiled kernels: which form runs, and that both can be asked."""

from __future__ import annotations

import dis
import marshal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from types import CodeType, FunctionType
from typing import Any

import numpy as np
import pytest

from planner import GraspTask, attempts
from planner.collision import mesh_pairs
from planner.errors import PlannerError
from planner.numerics import kernels
from planner.numerics.kernels import (
    COMPILE_VARIABLE,
    PLAIN_ATTEMPTS,
    attempt_kernels,
    compile_loops,
    compiled_searches,
    globals_read,
    kernel,
    kernels_are_compiled,
    loops_of_kernels,
)
from planner.spatial import FloatArray
from planner.synthesis.loops import least_squares


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
    rows = np.random.default_rng(0).normal(size=(20, 3))
    expected = plain_norms(rows)
    for wanted in (nullcontext(), compiled_searches()):
        with wanted, attempt_kernels(0):
            assert np.allclose(norms(rows), expected, atol=1e-15, rtol=0)
    assert np.allclose(compile_loops(norms.loops)(rows), expected, atol=1e-15, rtol=0)  # type: ignore[attr-defined]
    assert norms.plain is plain_norms  # type: ignore[attr-defined]


@pytest.mark.slow
def test_planning_loads_nothing_that_few_plans_need() -> None:
    """SciPy alone takes longer to load than all else together; a single plan needs no Numba."""
    code = """
import sys
from planner import GraspTask, plan_grasp
print(*sys.modules)
plan_grasp(GraspTask.create("allegro_hand", "mug"), seed=0)
print(*sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    before, after = (
        {name.partition(".")[0] for name in line.split()} for line in done.stdout.splitlines()
    )
    assert {"casadi", "pinocchio", "coal"} <= before
    assert not before & {"scipy", "trimesh", "qpsolvers", "numba"}
    assert "numba" not in after


def _told_by_dis(code: CodeType) -> set[str]:
    return {i.argval for i in dis.get_instructions(code) if i.opname == "LOAD_GLOBAL"}


def test_globals_that_code_reads_are_those_that_dis_tells() -> None:
    """Of functions of all kinds; an attribute that is called like a global is none."""
    functions = [
        value
        for module in (dis, subprocess, mesh_pairs, least_squares, kernels)
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


def test_compiling_is_decided_by_the_number_of_an_attempt(monkeypatch: pytest.MonkeyPatch) -> None:
    """In a search from ``PLAIN_ATTEMPTS`` on, in a batch from the first; outside of them never."""
    monkeypatch.delenv(COMPILE_VARIABLE, raising=False)

    def compiled_at(*indices: int) -> list[bool]:
        told = []
        for index in indices:
            with attempt_kernels(index):
                told.append(kernels_are_compiled())
            assert not kernels_are_compiled()
        return told

    assert compiled_at(0, PLAIN_ATTEMPTS - 1, PLAIN_ATTEMPTS) == [False, False, True]
    with compiled_searches():
        assert compiled_at(0, PLAIN_ATTEMPTS) == [True, True]
        with ThreadPoolExecutor(1) as other:  # another thread makes searches of its own
            assert other.submit(compiled_at, 0).result() == [False]
    assert compiled_at(0) == [False]
    monkeypatch.setenv(COMPILE_VARIABLE, "0")
    with compiled_searches():
        assert compiled_at(0, PLAIN_ATTEMPTS) == [False, False]
    monkeypatch.setenv(COMPILE_VARIABLE, "1")
    assert kernels_are_compiled()
    monkeypatch.setenv(COMPILE_VARIABLE, "yes")
    with pytest.raises(PlannerError, match="set it to 1 or to 0"):
        kernels_are_compiled()


@loops_of_kernels
def entry(values: FloatArray, k: int) -> float:
    """One of the values."""
    return float(values[k])


def ends_of(values: FloatArray) -> float:
    """A sum of three of them, two by numbers that are written out."""
    return entry(values, 0) + entry(values, 1) + entry(values, len(values) - 1)


def test_loops_are_compiled_once_for_all_numbers_that_are_written_out() -> None:
    compiled = kernels._compile(ends_of, called=True)
    compiled.compile((kernels._numba().float64[::1],))
    assert len(kernels._compile(entry, called=True).overloads) == 1


@pytest.mark.slow
def test_a_plan_does_not_depend_on_what_was_compiled_before() -> None:
    """Attempts in NumPy and compiled ones, mixed in one process in either order, on a mesh."""
    task = GraspTask.create("allegro_hand", "mug")

    def ends() -> list[Any]:
        made = [next(attempts(task, seed=seed)) for seed in range(3)]
        return [a.plan.q.tolist() if a.plan is not None else a.failure for a in made]

    plain = ends()
    with compiled_searches():
        compiled = ends()
    assert ends() == plain
    with compiled_searches():
        assert ends() == compiled


def test_without_numba_it_is_said_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "numba", None)
    kernels._numba.cache_clear()
    kernels._compile.cache_clear()
    with compiled_searches(), attempt_kernels(0), pytest.raises(PlannerError, match="pip install"):
        norms(np.ones((2, 3)))
    kernels._numba.cache_clear()


def test_a_budget_of_time_does_not_count_compiling() -> None:
    numba = kernels._numba()
    begin, planning = time.process_time(), kernels.planning_time()
    assert numba.njit(lambda x: x + 1.0)(1.0) == 2.0
    whole, counted = time.process_time() - begin, kernels.planning_time() - planning
    assert counted < 0.5 * whole
