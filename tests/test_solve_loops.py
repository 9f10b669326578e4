"""Least squares in compiled loops give what they give in NumPy: rows, runs and plans."""

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest

from planner import GraspTask, plan_grasp
from planner.numerics import tape as tape_module
from planner.numerics.kernels import compile_loops, compiled_searches
from planner.numerics.least_squares import LMResult
from planner.numerics.tape import programs_of, run_on_lanes, run_tape, tape_of
from planner.shapes import Mesh
from planner.spatial import SE3, FloatArray
from planner.synthesis.loops import solver
from planner.synthesis.loops.clearance import spline_tables, taylor_at
from planner.synthesis.loops.solver import LINK_ROWS, LoopProblem, LoopResiduals, loop_problem
from planner.synthesis.options import SynthesisOptions
from planner.synthesis.problem import GraspProblem, Start, problems_for
from planner.synthesis.residuals import Residuals
from planner.synthesis.seeds import seeder_for
from planner.synthesis.terms.link_distance import LinkDistances
from planner.task import Obstacle

BINARY: dict[str, Callable[[Any, Any], Any]] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "min": ca.fmin,
    "max": ca.fmax,
    "less": lambda a, b: a < b,
    "at most": lambda a, b: a <= b,
    "equal": lambda a, b: a == b,
    "other": lambda a, b: a != b,
    "and": ca.logic_and,
    "or": ca.logic_or,
    "if": lambda a, b: ca.if_else(a > 0.5, b, a),
    "power": lambda a, b: ca.fabs(a) ** b,
    "constant power": lambda a, b: ca.fabs(a) ** 1.3 + b,
    "angle": ca.atan2,
}
UNARY: dict[str, Callable[[Any], Any]] = {
    "negative": lambda a: -a,
    "square": lambda a: a * a,
    "twice": lambda a: 2 * a,
    "inverse": lambda a: 1 / a,
    "root": lambda a: ca.sqrt(ca.fabs(a)),
    "sin": ca.sin,
    "cos": ca.cos,
    "tan": ca.tan,
    "asin": lambda a: ca.asin(ca.sin(a)),
    "acos": lambda a: ca.acos(ca.cos(a)),
    "atan": ca.atan,
    "tanh": ca.tanh,
    "exp": ca.exp,
    "log": lambda a: ca.log(ca.fabs(a)),
    "sign": ca.sign,
    "not": ca.logic_not,
}


def everything() -> Any:
    """A function that holds every instruction that tapes know."""
    a, b = ca.SX.sym("a", 3), ca.SX.sym("b", 3)
    rows = [f(a[k], b[k]) for f in BINARY.values() for k in range(3)]
    rows += [f(a[k]) for f in UNARY.values() for k in range(3)]
    rows.append(sum(rows[::5]) * a[0] + 7.0)
    lower = ca.Sparsity.lower(3)
    return ca.Function("all", [a, b], [ca.vertcat(*rows), ca.SX(lower, ca.vertcat(a, b))])


ARGUMENTS = [
    (np.array([0.3, -1.2, 0.0]), np.array([0.3, 2.0, -0.7])),
    (np.array([-0.9, 1.0, 2.5]), np.array([-1.0, 1.0, 0.0])),
]


def loops_or_compiled(loops: Any, compiled: bool) -> Any:
    """Loops as Python runs them, or as numba does."""
    return compile_loops(loops) if compiled else loops


compiled_too = pytest.mark.parametrize("compiled", [False, True], ids=["python", "numba"])


@compiled_too
def test_a_tape_gives_the_bits_of_the_virtual_machine(compiled: bool) -> None:
    function = everything()
    tape = tape_of(function)
    assert tape is not None
    assert set(range(len(tape_module._KINDS))) == set(tape.program.kinds.tolist()), "all kinds"
    lanes = np.repeat(tape.work[:, None], len(ARGUMENTS), axis=1)
    for k, (a, b) in enumerate(ARGUMENTS):
        work = tape.work.copy()
        for begin, value in zip(tape.arguments, (a, b), strict=True):
            work[begin : begin + 3] = lanes[begin : begin + 3, k] = value
        with np.errstate(all="ignore"):
            try:
                loops_or_compiled(run_tape, compiled)(tape.program, work)
            except (ValueError, ZeroDivisionError):  # Python's own mathematics refuses log(0)
                assert not compiled
                continue
        expected = [np.array(r.nz[:]).ravel() for r in function(a, b)]
        for places, values in zip(tape.results, expected, strict=True):
            assert np.allclose(work[places], values, rtol=1e-15, atol=0, equal_nan=True)
    if compiled:
        programs, both = programs_of([tape, tape]), np.concatenate([np.zeros(3), lanes.ravel()])
        compile_loops(run_on_lanes)(programs, 1, both, 3, len(ARGUMENTS))
        lanes = both[3:].reshape(lanes.shape)
        for k, (a, b) in enumerate(ARGUMENTS):
            expected = [np.array(r.nz[:]).ravel() for r in function(a, b)]
            for places, values in zip(tape.results, expected, strict=True):
                assert np.allclose(lanes[places, k], values, rtol=1e-15, atol=0, equal_nan=True)


def test_an_instruction_that_kernels_do_not_know_makes_no_tape() -> None:
    a = ca.SX.sym("a")
    assert tape_of(ca.Function("f", [a], [ca.sin(a) + 1])) is not None
    assert tape_of(ca.Function("f", [a], [ca.erf(a) + 1])) is None


@compiled_too
@pytest.mark.parametrize("order", [1, 2])
def test_loops_look_up_the_field_of_a_mesh(order: int, compiled: bool) -> None:
    shape = GraspTask.create("allegro_hand", "mug").object.shape
    assert isinstance(shape, Mesh)
    field, rng = shape.field(), np.random.default_rng(0)
    count = 25 if compiled else 8
    points = np.vstack([rng.normal(0.0, size, (count, 3)) for size in (0.03, 0.1, 0.3, 2.0)])
    expected = field.taylor(points, order)
    found, one = np.zeros((len(points), 10)), loops_or_compiled(taylor_at, compiled)
    for point, out in zip(points, found, strict=True):
        one(spline_tables(field), *point.tolist(), order, out, 0)
    assert np.allclose(found[:, : expected.shape[1]], expected, rtol=1e-9, atol=1e-12)


def near(obstacle: bool, hand: str, item: str) -> GraspTask:
    """A task, with an obstacle beside the object if asked for."""
    task = GraspTask.create(hand, item)
    if not obstacle:
        return task
    at = SE3(np.eye(3), task.T_world_object.translation + np.array([0.08, 0.02, 0.02]))
    post = Obstacle(name="post", size=np.full(3, 0.06), T_world_obstacle=at)
    return GraspTask.create(hand, item, obstacles=(post,))


CASES = [
    ("allegro_hand", "box", False),
    ("allegro_hand", "mug", True),
    ("shadow_hand_torque", "torus", False),
    ("allegro_on_arm7", "cylinder", True),
]


def started(task: GraspTask, seed: int) -> tuple[GraspProblem, Start, FloatArray]:
    """A problem, a start, and the parameters."""
    problem, seeder = problems_for(task).grasp, seeder_for(task)
    start = next(
        s
        for k in range(20)
        if isinstance(s := seeder.draw(np.random.default_rng([seed, k])), Start)
    )
    return problem, start, problem.parameters(task, start, seeder.posture, SynthesisOptions())


def both_of(task: GraspTask, parameters: FloatArray) -> tuple[Residuals, LoopResiduals]:
    """The residuals in NumPy and in loops."""
    problem = problems_for(task).grasp
    field = problem.surface.field_of(task.object.shape)
    plain = problem.residuals.clone()
    plain.set_parameters(parameters, field)
    loops = loop_problem(problem.residuals)
    assert isinstance(loops, LoopProblem)
    return plain, LoopResiduals(loops, parameters, field)


def assert_same(first: LMResult, second: LMResult) -> None:
    """Two runs ended alike."""
    assert (first.status, first.iterations) == (second.status, second.iterations)
    assert np.allclose(first.x, second.x, rtol=0, atol=1e-9)
    assert first.worst == pytest.approx(second.worst, abs=1e-7)
    assert first.damping == pytest.approx(second.damping, rel=1e-7)


@pytest.mark.parametrize(("hand", "item", "obstacle"), CASES)
@compiled_too
def test_a_run_in_loops_is_the_run_in_numpy(
    hand: str, item: str, obstacle: bool, compiled: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not compiled:
        monkeypatch.setattr(solver, "compile_loops", lambda loops: loops)
    task = near(obstacle, hand, item)
    for seed in range(4 if compiled else 1):
        problem, start, parameters = started(task, seed)
        plain, loops = both_of(task, parameters)
        lower, upper = problem.bounds(start)
        at: dict[str, Any] = {"lower": lower, "upper": upper, "scale": np.full(len(lower), 0.05)}
        x = np.clip(problem.first(start), lower, upper)
        budget = 12 if compiled else 3
        ends = [r.minimise(x, **at, max_iterations=budget) for r in (plain, loops)]
        assert_same(*ends)
        assert plain.violations() == pytest.approx(loops.violations(), abs=1e-9)
        # a round: directions of wrench, and true links near each other
        rng = np.random.default_rng(seed)
        directions, rows = rng.normal(size=(20, 6)), rng.normal(size=(3, len(x)))
        links = LinkDistances(
            x=ends[0].x,
            values=np.array([-0.001, 0.0, 0.1]),
            rows=rows,
            joints=np.zeros((3, 2), dtype=np.int64),
            urgent=False,
        )
        for one in (plain, loops):
            one.set_directions(directions, 0.4)
            one.keep_apart(links)
        x = ends[0].x
        ends = [r.minimise(x, **at, max_iterations=4, damping=0.1) for r in (plain, loops)]
        assert_same(*ends)
        assert plain.violations() == pytest.approx(loops.violations(), abs=1e-9)
        # repair: nothing but the terms
        for one in (plain, loops):
            one.set_directions(np.zeros((0, 6)))
            one.keep_apart(None)
        x = ends[0].x
        ends = [r.minimise(x, **at, max_iterations=5, slow=np.inf) for r in (plain, loops)]
        assert_same(*ends)


def test_there_is_room_for_any_number_of_true_distances() -> None:
    task = near(False, "allegro_hand", "box")
    problem, start, parameters = started(task, 0)
    plain, loops = both_of(task, parameters)
    lower, upper = problem.bounds(start)
    x, n = np.clip(problem.first(start), lower, upper), 3 * LINK_ROWS
    links = LinkDistances(
        x=x,
        values=np.full(n, -0.001),
        rows=np.random.default_rng(0).normal(size=(n, len(x))),
        joints=np.zeros((n, 2), dtype=np.int64),
        urgent=True,
    )
    ends = []
    for one in (plain, loops):
        one.keep_apart(links)
        ends.append(
            one.minimise(x, lower=lower, upper=upper, scale=np.full(len(x), 0.05), max_iterations=4)
        )
    assert_same(*ends)


@pytest.mark.parametrize(("hand", "item"), [("allegro_hand", "box"), ("shadow_hand", "hammer")])
def test_plans_are_those_without_compiled_loops(hand: str, item: str) -> None:
    task = GraspTask.create(hand, item)
    options = SynthesisOptions(rounds=0)
    with compiled_searches():
        mine = [plan_grasp(task, seed=seed, options=options) for seed in range(3)]
    for seed, plan in enumerate(mine):
        plain = plan_grasp(task, seed=seed, options=options)
        assert plan.record.attempts == plain.record.attempts
        assert np.allclose(plan.q, plain.q, rtol=0, atol=1e-9)
        assert np.allclose(plan.contacts.positions, plain.contacts.positions, rtol=0, atol=1e-9)
