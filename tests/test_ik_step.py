"""Steps of inverse kinematics by least squares within limits, and those that keep away."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from planner.numerics.least_squares import Barrier, Task, constrained_ik_step, ik_step
from planner.spatial import FloatArray

WIDE = np.full(5, 10.0)


def drawn(seed: int, rows: int = 3) -> Task:
    rng = np.random.default_rng(seed)
    return Task(rng.normal(size=(rows, 5)), rng.normal(size=rows))


@pytest.mark.parametrize("seed", range(5))
def test_without_damping_it_is_the_least_step_that_meets_the_task(seed: int) -> None:
    task, q = drawn(seed), np.zeros(5)
    step = ik_step(task, q, -WIDE, WIDE)
    np.testing.assert_allclose(task.jacobian @ step, task.error, atol=1e-12)
    null = np.eye(5) - np.linalg.pinv(task.jacobian) @ task.jacobian
    np.testing.assert_allclose(null @ step, 0.0, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_damping_trades_the_task_against_the_length_of_the_step(seed: int) -> None:
    task, damping = drawn(seed), 0.3
    step = ik_step(task, np.zeros(5), -WIDE, WIDE, damping=damping)
    gradient = task.jacobian.T @ (task.jacobian @ step - task.error) + damping * step
    np.testing.assert_allclose(gradient, 0.0, atol=1e-12)


@pytest.mark.parametrize("damping", [0.0, 1e-3])
def test_joints_at_a_limit_leave_the_task_to_the_others(damping: float) -> None:
    task = Task(np.array([[1.0, 1.0]]), np.array([0.5]))
    q, lower, upper = np.array([0.0, 0.0]), np.zeros(2), np.array([0.0, 1.0])
    new = ik_step(task, q, lower, upper, damping=damping)
    assert new[0] == 0.0
    assert new[1] == pytest.approx(0.5 / (1.0 + damping), abs=1e-12)
    both = ik_step(task, q, lower, np.zeros(2), damping=damping)
    np.testing.assert_array_equal(both, q)


@pytest.mark.parametrize("seed", range(10))
def test_repeated_steps_come_to_the_best_within_the_limits(seed: int) -> None:
    task = drawn(seed, rows=7)  # more rows than joints: one best point
    upper = np.full(5, 0.1)
    q = np.zeros(5)
    for _ in range(50):
        left = Task(task.jacobian, task.error - task.jacobian @ q)
        q = ik_step(left, q, -upper, upper)
        assert (np.abs(q) <= upper).all()
    best = lsq_linear(task.jacobian, task.error, (-upper, upper)).x
    off = np.linalg.norm(task.jacobian @ q - task.error)
    assert off <= 1.1 * np.linalg.norm(task.jacobian @ best - task.error)


def constrained(
    task: Task, barriers: list[Barrier], lower: FloatArray = -WIDE, upper: FloatArray = WIDE
) -> FloatArray | None:
    """A step with the first two joints coupled."""
    return constrained_ik_step(
        task,
        barriers,
        lower,
        upper,
        equality=Task(np.array([[1.0, -1.0, 0.0, 0.0, 0.0]]), np.array([0.02])),
        posture=np.zeros(5),
        posture_weight=0.01,
        damping=0.01,
        price=100.0,
    )


@pytest.mark.parametrize("seed", range(5))
def test_barriers_hold_and_couplings_are_met(seed: int) -> None:
    task, rng = drawn(seed), np.random.default_rng(100 + seed)
    barriers = [Barrier(rng.normal(size=(2, 5)), rng.normal(size=2)) for _ in range(2)]
    step = constrained(task, barriers)
    assert step is not None
    assert step[0] - step[1] == pytest.approx(0.02, abs=1e-9)
    for barrier in barriers:
        assert (barrier.rates @ step >= barrier.least - 1e-9).all()


def test_a_barrier_that_cannot_hold_is_missed_by_as_little_as_can_be() -> None:
    rates = np.array([[0.0, 0.0, 1.0, 0.0, 0.0]])
    for unit in (1.0, 0.1):
        step = constrained(drawn(0), [Barrier(rates, np.array([0.5]), unit)], upper=np.full(5, 0.2))
        assert step is not None and step[2] == pytest.approx(0.2, abs=1e-9)


def test_couplings_against_the_bounds_have_no_step() -> None:
    assert constrained(drawn(0), [], lower=np.zeros(5), upper=np.full(5, 0.01)) is None
