"""The last step onto the true surface: gaps and couplings both, within the joints' ranges."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import PlanOf

from planner.collision.pad_contact import pad_contacts
from planner.hands.hand import Hand
from planner.plan import GraspPlan
from planner.search.grasp import plan_grasp
from planner.task import GraspTask
from planner.verification import COUPLING_TOL, FARTHEST, GAP_TOL, project_onto_surface


@pytest.fixture(scope="module", params=["sphere", "torus"])
def plan(request: pytest.FixtureRequest, plan_of: PlanOf) -> GraspPlan:
    return plan_of("shadow_hand", request.param)


def worst_gap(plan: GraspPlan, q: np.ndarray) -> float:
    return max(abs(t.pad_gap) for t in pad_contacts(plan.task, plan.T_world_base, q))


def test_gaps_and_couplings_are_closed(plan: GraspPlan) -> None:
    hand = plan.task.hand
    matrix, value = hand.coupling_matrix
    rng = np.random.default_rng(3)
    index = np.unique(np.concatenate([f.q_index for f in plan.task.fingers]))
    for _ in range(5):
        q = plan.q.copy()
        q[index] += rng.normal(0.0, 0.004, len(index))
        q = np.clip(q, hand.q_lower, hand.q_upper)
        assert np.abs(matrix @ q - value).max() > 1e-4
        settled = project_onto_surface(plan.task, plan.T_world_base, q)
        assert worst_gap(plan, settled) <= GAP_TOL
        assert np.abs(matrix @ settled - value).max() <= COUPLING_TOL
        assert (settled >= hand.q_lower).all() and (settled <= hand.q_upper).all()
        assert np.abs(settled - q).max() < 0.1


def test_a_coupling_is_closed_where_pads_touch_already(plan: GraspPlan) -> None:
    # a step that no pad notices: gaps alone would stop at once
    hand, finger = plan.task.hand, plan.task.fingers[1]
    matrix, value = hand.coupling_matrix
    state = plan.q.copy()
    row = np.flatnonzero(np.abs(matrix[:, finger.q_index]).sum(axis=1))[0]
    pair = np.flatnonzero(matrix[row])
    state[pair[0]] += 2e-4
    off = np.abs(matrix @ state - value).max()
    assert off > 1e-4
    settled = project_onto_surface(plan.task, plan.T_world_base, state)
    assert np.abs(matrix @ settled - value).max() <= COUPLING_TOL
    assert worst_gap(plan, settled) <= GAP_TOL


def test_a_coupling_of_a_finger_left_out_is_closed_too(plan: GraspPlan) -> None:
    matrix, value = plan.task.hand.coupling_matrix
    mine = np.concatenate([f.q_index for f in plan.task.fingers])
    away = np.abs(matrix[:, mine]).sum(axis=1) == 0.0
    assert away.any(), "the little finger is coupled and takes no part"
    q = plan.q.copy()
    q[np.argmax(np.abs(matrix[away][0]))] += 1e-3
    assert np.abs(matrix @ q - value)[away].max() > 1e-4
    settled = project_onto_surface(plan.task, plan.T_world_base, q)
    assert np.abs(matrix @ settled - value).max() <= COUPLING_TOL


def test_what_is_far_off_stays(allegro: Hand) -> None:
    task = GraspTask.create(allegro, "sphere")
    plan = plan_grasp(task, seed=0)
    away = plan.T_world_base.copy()
    away.translation = away.translation + np.array([0.0, 0.0, 2 * FARTHEST + 0.05])
    np.testing.assert_array_equal(project_onto_surface(task, away, plan.q), plan.q)
