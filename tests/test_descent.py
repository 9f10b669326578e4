"""Least squares with bounds and one-sided residuals, and the residuals of grasp synthesis."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from planner.hand import Hand
from planner.objects import parse_object
from planner.shapes import Mesh
from planner.spatial import FloatArray
from planner.synthesis.descent import Descent, descend
from planner.synthesis.mesh_seeds import seeder_for
from planner.synthesis.options import SynthesisOptions
from planner.synthesis.problem import Start
from planner.synthesis.problems import problems_for
from planner.synthesis.residuals import SPARE, WEIGHTS
from planner.synthesis.strengthen import descend_grasp
from planner.task import GraspTask


def run(residuals: object, x: list[float], **options: object) -> Descent:
    """Descend with every residual an equality of unit scale unless told otherwise."""
    start = np.array(x)
    m = len(residuals(start)[0])  # type: ignore[operator]
    given: dict[str, object] = {
        "lower": np.full(len(x), -np.inf),
        "upper": np.full(len(x), np.inf),
        "scale": np.ones(len(x)),
        "equality": np.ones(m, dtype=bool),
        "n_terms": m,
        "max_iterations": 200,
    }
    return descend(residuals, start, **{**given, **options})  # type: ignore[arg-type]


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


@pytest.mark.parametrize("item", ["box", "torus"])
def test_residuals_of_a_grasp_have_exact_derivatives(shadow: Hand, item: str) -> None:
    task = GraspTask.create(shadow, item)
    problem, seeder = problems_for(task).grasp, seeder_for(task)
    start = seeder.draw(np.random.default_rng(1))
    assert isinstance(start, Start)
    problem.residuals.set_parameters(
        problem.parameters(task, start, seeder.posture, SynthesisOptions())
    )
    problem.residuals.set_directions(np.random.default_rng(2).normal(size=(5, 6)))
    field = problem.surface.field_of(task.object.shape)
    x = problem.formulation.unknowns.pack(
        np.array([0.1, -0.2, 0.05]),
        start.T_object_base.translation + 0.003,
        start.q,
        start.points + 0.002,
        start.forces + 0.1,
    )

    def values(at: FloatArray) -> FloatArray:
        return problem.residuals(at, field)[0].copy()

    exact = problem.residuals(x, field)[1].copy()
    step = 1e-6
    by_steps = np.array(
        [(values(x + e) - values(x - e)) / (2 * step) for e in step * np.eye(len(x))]
    ).T
    assert np.abs(exact - by_steps).max() <= 1e-6 * np.abs(exact).max()


def test_least_squares_and_the_programme_have_the_same_terms(shadow: Hand) -> None:
    """Violations told by the residuals are those of IPOPT's constraints at the same place."""
    task = GraspTask.create(shadow, "cylinder")
    problem, seeder = problems_for(task).grasp, seeder_for(task)
    start = seeder.draw(np.random.default_rng(3))
    assert isinstance(start, Start)
    parameters = problem.parameters(task, start, seeder.posture, SynthesisOptions())
    x = problem.formulation.unknowns.pack(
        np.zeros(3), start.T_object_base.translation, start.q, start.points, start.forces
    )
    problem.residuals.set_parameters(parameters)
    problem.residuals(x, None)
    mine = problem.residuals.violations()
    theirs = problem.violations(problem.nlp.bind(None).evaluate(x, parameters))
    assert set(mine) == set(WEIGHTS) & {t.name for t in problem.terms} == set(theirs)
    assert set(SPARE) <= set(mine)
    for name, value in theirs.items():
        assert mine[name] == pytest.approx(value, abs=1e-12), name


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
            descend_grasp(problem, task, start, parameters),
            problem.solve(task, start, parameters),
        )
        good = max(v * WEIGHTS[name] for name, v in quick.violation.items()) < 0.1
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
