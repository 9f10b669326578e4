"""Least squares with bounds and one-sided residuals, and the residuals of grasp synthesis."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from constrained import Constrained
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from planner.hands.hand import Hand
from planner.numerics.least_squares import LMResult, levenberg_marquardt
from planner.objects import parse_object
from planner.shapes import Mesh
from planner.spatial import SE3, FloatArray
from planner.synthesis.optimize import optimize_grasp
from planner.synthesis.options import SynthesisOptions
from planner.synthesis.problem import GraspProblem, Start, problems_for
from planner.synthesis.seeds import seeder_for
from planner.synthesis.terms.registry import TERMS
from planner.task import GraspTask, Obstacle


@dataclass
class Given:
    """Residuals of a function of x; those not in ``equality`` count where negative."""

    function: Callable[[FloatArray], tuple[FloatArray, FloatArray]]
    equality: NDArray[np.bool_] | None
    given: int | None
    n_terms: int = 0

    def __call__(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        r, jacobian = self.function(x)
        counts = r < 0.0
        counts |= True if self.equality is None else self.equality
        self.n_terms = int(counts.sum()) if self.given is None else self.given
        return r[counts], jacobian[counts]


def run(
    function: Callable[[FloatArray], tuple[FloatArray, FloatArray]],
    x: list[float],
    *,
    equality: NDArray[np.bool_] | None = None,
    n_terms: int | None = None,
    **options: Any,
) -> LMResult:
    """Descend with every residual an equality of unit scale unless told otherwise."""
    free = {
        "lower": np.full(len(x), -np.inf),
        "upper": np.full(len(x), np.inf),
        "scale": np.ones(len(x)),
        "max_iterations": 200,
    }
    return levenberg_marquardt(
        Given(function, equality, n_terms), np.array(x), **{**free, **options}
    )


def test_rosenbrock_ends_at_its_known_minimum() -> None:
    def rosenbrock(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        values = np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]])
        return values, np.array([[-20 * x[0], 10.0], [-1.0, 0.0]])

    end = run(rosenbrock, [-1.2, 1.0], n_terms=0)
    np.testing.assert_allclose(end.x, [1, 1], atol=1e-3)
    assert end.iterations < 60


def test_an_equality_that_holds_at_the_start_is_kept_by_the_first_step() -> None:
    matrix, target = np.array([[30.0, -30.0], [1.0, 0.0]]), np.array([0.0, 1.0])
    end = run(lambda x: (matrix @ x - target, matrix), [0.0, 0.0], n_terms=0)
    np.testing.assert_allclose(end.x, [1.0, 1.0], atol=0.02)
    assert end.iterations <= 12


@given(st.integers(0, 10_000))
def test_linear_residuals_within_bounds_agree_with_scipy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    matrix, target = rng.normal(size=(8, 4)), rng.normal(size=8) * 2
    lower, upper = -rng.uniform(0.05, 0.5, 4), rng.uniform(0.05, 0.5, 4)
    end = run(lambda x: (matrix @ x - target, matrix), [0.0] * 4, lower=lower, upper=upper)
    best = lsq_linear(matrix, target, bounds=(lower, upper), tol=1e-14)
    mine = float(np.sum((matrix @ end.x - target) ** 2))
    assert mine <= 2 * best.cost * (1 + 5e-3) + 1e-2
    assert (end.x >= lower).all()
    assert (end.x <= upper).all()


def test_an_inequality_counts_where_it_is_violated_and_nowhere_else() -> None:
    def at_least_two(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        return np.array([x[0] - 2.0]), np.array([[1.0]])

    sided = np.array([False])
    assert run(at_least_two, [5.0], equality=sided).x[0] == 5.0
    assert run(at_least_two, [-5.0], equality=sided).x[0] == pytest.approx(2.0, abs=0.05)


def test_what_cannot_be_solved_ends_early_and_says_so() -> None:
    """|x| = 1 and x = 3 at once: the best compromise is between, and no budget is burnt."""

    def torn(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        return np.array([x[0] ** 2 - 1, x[0] - 3]), np.array([[2 * x[0]], [1.0]])

    end = run(torn, [1.0])
    assert end.status in {"stalled", "no step descends"}
    assert end.worst > 0.5
    assert end.iterations < 60


def test_small_gains_are_worth_as_many_steps_as_asked() -> None:
    """1 / (1 + x) falls for ever, by less and less."""

    def slow(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        return np.array([1.0, 1 / (1 + x[0])]), np.array([[0.0], [-1 / (1 + x[0]) ** 2]])

    long, short, patient = (
        run(slow, [0.0], stalled=stalled, patience=patience)
        for stalled, patience in ((1e-6, 3), (0.05, 3), (0.05, 8))
    )
    assert {long.status, short.status, patient.status} == {"stalled"}
    assert short.iterations + 5 == patient.iterations < long.iterations
    assert short.x[0] < patient.x[0] < long.x[0]


def test_numbers_of_one_twin_are_not_those_of_another(allegro: Hand) -> None:
    task = GraspTask.create(allegro, "cylinder", fingers=["thumb", "index", "middle"])
    problem, seeder = problems_for(task).grasp, seeder_for(task)
    start = seeder.draw(np.random.default_rng(1))
    assert isinstance(start, Start)
    wide = replace(SynthesisOptions(), clear_object=0.02)
    icy = replace(task, mu=0.1)
    x = problem.first(start)
    problem.formulation.unknowns.forces(x)[:, 2] += 0.3  # in the cones of one, not of the other
    first, second = problem.residuals.clone(), problem.residuals.clone()
    first.set_parameters(problem.parameters(task, start, seeder.posture, SynthesisOptions()), None)
    alone, slopes = (a.copy() for a in first(x))
    second.set_parameters(problem.parameters(icy, start, seeder.posture, wide), None)
    beside = second(x)[0]
    assert len(beside) > len(alone), "more is too near, and slips"
    again = first(x)
    assert np.array_equal(again[0], alone) and np.array_equal(again[1], slopes)


def test_an_unknown_without_room_stays_and_the_others_do_without_it() -> None:
    matrix = np.array([[1.0, 1.0], [1.0, -1.0]])
    end = run(
        lambda x: (matrix @ x - np.array([3.0, 0.0]), matrix),
        [1.0, 0.0],
        lower=np.array([1.0, -9.0]),
        upper=np.array([1.0, 9.0]),
    )
    np.testing.assert_allclose(end.x, [1.0, 1.5], atol=0.01)


CASES = [
    ("shadow_hand", "box", True),
    ("shadow_hand", "torus", False),
    ("allegro_hand", "ellipsoid", False),
    ("allegro_on_arm7", "capsule", True),
]


@pytest.fixture(scope="module", params=CASES, ids=[f"{h}-{o}" for h, o, _ in CASES])
def posed(request: pytest.FixtureRequest) -> tuple[GraspProblem, GraspTask, FloatArray, FloatArray]:
    """A problem, its task, parameters, and unknowns where clearances of every kind are missed."""
    hand, item, beside = request.param
    task = GraspTask.create(hand, item)
    if beside:
        at = SE3(np.eye(3), task.T_world_object.translation + np.array([0.08, 0.02, 0.02]))
        post = Obstacle(name="post", size=np.full(3, 0.06), T_world_obstacle=at)
        task = GraspTask.create(hand, item, obstacles=(post,))
    return _posed(task)


def _posed(task: GraspTask) -> tuple[GraspProblem, GraspTask, FloatArray, FloatArray]:
    """See ``posed``."""
    problem, seeder = problems_for(task).grasp, seeder_for(task)
    start = seeder.draw(np.random.default_rng(1))
    assert isinstance(start, Start)
    parameters = problem.parameters(task, start, seeder.posture, SynthesisOptions())
    rng = np.random.default_rng(4)
    x = problem.first(start)
    x[:3] = [0.1, -0.2, 0.05]
    joints = problem.formulation.unknowns.q(x)
    joints += rng.normal(0.0, 0.15, len(joints))
    problem.formulation.unknowns.points(x)[:] += 0.002
    problem.formulation.unknowns.forces(x)[:] += 0.1
    problem.residuals.set_parameters(parameters, problem.surface.field_of(task.object.shape))
    origin = x[3:6].copy()
    for _ in range(2000):
        x[3:6] = origin + rng.uniform(-0.3, 0.3, 3)
        problem.residuals(x)
        violated = problem.residuals.violations()
        if all(violated[name] > 0.0 for name in missed(task)):
            return problem, task, parameters, x
    raise AssertionError("no place found where all of them are violated")


def missed(task: GraspTask) -> set[str]:
    """Terms of clearance that are to be violated."""
    return {"object", "table", "obstacle"} if task.obstacles else {"object", "table"}


def test_residuals_of_a_grasp_have_exact_derivatives(
    posed: tuple[GraspProblem, GraspTask, FloatArray, FloatArray],
) -> None:
    problem, task, parameters, x = posed
    residuals = problem.residuals
    residuals.set_parameters(parameters, problem.surface.field_of(task.object.shape))
    residuals.set_directions(np.random.default_rng(2).normal(size=(5, 6)), 0.6)
    exact = residuals(x)[1].copy()
    violated = {name for name, value in residuals.violations().items() if value > 0.0}
    assert missed(task) <= violated
    step = 1e-6
    by_steps = np.array(
        [
            (residuals(x + e)[0].copy() - residuals(x - e)[0].copy()) / (2 * step)
            for e in step * np.eye(len(x))
        ]
    ).T
    assert np.abs(exact - by_steps).max() <= 1e-6 * np.abs(exact).max()


def test_least_squares_and_the_programme_have_the_same_terms(
    posed: tuple[GraspProblem, GraspTask, FloatArray, FloatArray],
) -> None:
    """Violations told by the residuals are those of the expressions at the same place."""
    _check_terms(*posed, without={"effort"})


def test_least_squares_and_the_programme_have_the_same_terms_around_an_object() -> None:
    """Likewise where links and palm touch, whose actuators have a term."""
    task = GraspTask.create("shadow_hand", "cylinder", grasp_type="power")
    _check_terms(*_posed(task), without=set())


def _check_terms(
    problem: GraspProblem,
    task: GraspTask,
    parameters: FloatArray,
    x: FloatArray,
    *,
    without: set[str],
) -> None:
    """Compare both at twelve places; all terms with a margin are written but those named."""
    field = problem.surface.field_of(task.object.shape)
    problem.residuals.set_parameters(parameters, field)
    rng = np.random.default_rng(6)
    seen, programme = set(), Constrained(problem)
    # on meshes what was far is not looked up at once: from place to place it must be seen again
    for k in range(12):
        x = x + rng.normal(0.0, 3e-3 if k % 2 else 1e-4, len(x))
        problem.residuals(x)
        mine = problem.residuals.violations()
        theirs = programme.violations(x, parameters, task)
        assert set(mine) - set(theirs) <= {"fingers", "obstacle", "links"}, "terms without rows"
        assert {t.name for t in TERMS.values() if t.margin} - set(mine) == without
        for name, value in theirs.items():
            assert mine[name] == pytest.approx(value, abs=1e-12), name
        seen |= {name for name, value in mine.items() if value > 0.0}
    assert missed(task) | {"touch", "balance"} <= seen


def test_links_that_meet_are_told_apart(shadow: Hand) -> None:
    """Fingers that are folded into each other violate the same rooms as in the programme."""
    task = GraspTask.create(shadow, "cylinder")
    problem, seeder = problems_for(task).grasp, seeder_for(task)
    start = seeder.draw(np.random.default_rng(3))
    assert isinstance(start, Start)
    parameters = problem.parameters(task, start, seeder.posture, SynthesisOptions())
    problem.residuals.set_parameters(parameters, None)
    rng = np.random.default_rng(0)
    x, met, programme = problem.first(start), 0, Constrained(problem)
    for _ in range(40):
        problem.formulation.unknowns.q(x)[:] = rng.uniform(shadow.q_lower, shadow.q_upper)
        exact = problem.residuals(x)[1].copy()
        mine = problem.residuals.violations()["fingers"]
        if mine > 0.0:
            theirs = programme.violations(x, parameters, task)
            assert mine == pytest.approx(theirs["fingers"], abs=1e-12)
            at, step = int(shadow.fingers["index"].q_index[0]) + 6, 1e-7
            ahead, behind = x.copy(), x.copy()
            ahead[at] += step
            behind[at] -= step
            slope = (problem.residuals(ahead)[0].copy() - problem.residuals(behind)[0]) / (2 * step)
            np.testing.assert_allclose(exact[:, at], slope, atol=1e-4 * np.abs(exact).max())
            met += 1
    assert met >= 5


@pytest.mark.slow
def test_descent_and_ipopt_agree_that_a_start_leads_to_a_grasp(allegro: Hand) -> None:
    """From most starts on a sphere both solve all terms: neither is the other's stand-in."""
    task = GraspTask.create(allegro, parse_object("sphere"))
    problem, seeder = problems_for(task).grasp, seeder_for(task)
    assert not isinstance(task.object.shape, Mesh)
    both = 0
    for k in range(6):
        start = seeder.draw(np.random.default_rng([5, k]))
        assert isinstance(start, Start)
        parameters = problem.parameters(task, start, seeder.posture, SynthesisOptions())
        quick, slow = (
            optimize_grasp(problem, task, start, parameters, SynthesisOptions(rounds=0)),
            Constrained(problem).solve(task, start, parameters),
        )
        good = max(v * TERMS[name].weight for name, v in quick.violation.items()) < 0.1
        both += good and max(slow.violation.values()) < 1e-5
    assert both >= 5


def test_a_step_that_meets_a_bound_is_the_best_one_along_it() -> None:
    """Min (2a + b - 10)^2 + 3 b^2 with a <= 1: then b = 8 / 4 = 2, in the first step already."""
    matrix = np.array([[2.0, 1.0], [0.0, np.sqrt(3.0)]])
    target = np.array([10.0, 0.0])
    end = run(
        lambda x: (matrix @ x - target, matrix),
        [0.0, 0.1],
        upper=np.array([1.0, np.inf]),
        max_iterations=2,
    )
    np.testing.assert_allclose(end.x, [1.0, 2.0], atol=0.01)
