"""Closing until felt: what the reference does while fingers touch early, in time and late."""

from __future__ import annotations

import numpy as np
import pytest
from test_sim_controllers import observe

from planner.kinematics.state import HandState
from planner.plan import GraspPlan
from planner.search import plan_grasp
from planner.spatial import FloatArray, minimum_jerk
from planner.task import GraspTask
from sim.controllers.closing import (
    CAREFUL_SPEED,
    EARLY,
    SEARCH_REACH,
    SEARCH_SPEED,
    GuardedClosing,
)

DT, STEPS = 0.002, 250


@pytest.fixture(scope="module")
def plan() -> GraspPlan:
    return plan_grasp(GraspTask.create("allegro_hand", "sphere"))


def close(
    closing: GuardedClosing,
    plan: GraspPlan,
    steps: range,
    *,
    touching: tuple[int, ...] = (),
    q: FloatArray | None = None,
) -> FloatArray:
    """References (m, nq) over some steps of a closing of 0.5 s."""
    force = np.zeros(len(plan.task.fingers))
    force[list(touching)] = 0.5
    seen = [observe(plan, "close", min(1.0, k / STEPS), q=q, force=force) for k in steps]
    return np.array([closing.step(DT, one) for one in seen])


def pads(plan: GraspPlan, q: FloatArray) -> FloatArray:
    """Pad centres (n, 3) along the planned normals (n,), base, m."""
    state = HandState(plan.task.hand, q)
    normals = plan.contacts.normals @ plan.T_world_base.rotation
    centers = np.array([state.pad_center(f) for f in plan.task.fingers])
    return np.asarray((centers * normals).sum(axis=1))


def halfway(plan: GraspPlan) -> FloatArray:
    return np.asarray((plan.q + plan.q_pregrasp) / 2)


def test_without_a_surprise_every_finger_goes_the_planned_way(plan: GraspPlan) -> None:
    closing = GuardedClosing(plan)
    references = close(closing, plan, range(STEPS + 1))
    for k in (0, 100, 180, STEPS):
        share = float(minimum_jerk(np.asarray(k / STEPS)))
        wanted = plan.q_pregrasp + share * (plan.q - plan.q_pregrasp)
        np.testing.assert_allclose(references[k], wanted, atol=1e-12)
    # a touch where it was planned stops that finger, and nothing else changes
    close(closing, plan, range(STEPS, STEPS + 5), touching=(0,), q=plan.q)
    assert not closing.careful


def test_a_finger_that_touches_early_stays_where_it_is_and_does_not_push(plan: GraspPlan) -> None:
    closing = GuardedClosing(plan)
    at = halfway(plan)
    way = pads(plan, plan.q) - pads(plan, at)
    assert way[0] > EARLY, "this plan's pre-grasp is too near for the test"
    close(closing, plan, range(125))
    references = close(closing, plan, range(125, 260), touching=(0,), q=at)
    assert closing.careful
    first = plan.task.fingers[0].q_index
    # the reference is the reading at the touch: a servo there pushes with nothing
    np.testing.assert_allclose(references[:, first], at[first][None].repeat(135, axis=0))


def test_after_an_early_touch_the_others_come_slowly(plan: GraspPlan) -> None:
    closing = GuardedClosing(plan)
    close(closing, plan, range(125))
    references = close(closing, plan, range(125, 600), touching=(0,), q=halfway(plan))
    along = np.array([pads(plan, q) for q in references])
    speed = np.diff(along, axis=0) / DT
    assert speed[1:, 1:].max() < 1.3 * CAREFUL_SPEED  # the way bends a little
    assert (along[-1, 1:] > pads(plan, plan.q)[1:]).all()  # and they come all the way


def test_a_held_finger_follows_an_object_that_moves_off(plan: GraspPlan) -> None:
    closing = GuardedClosing(plan)
    at = halfway(plan)
    close(closing, plan, range(125))
    before = close(closing, plan, range(125, 130), touching=(0,), q=at)[-1]
    after = close(closing, plan, range(130, 230), q=at)[-1]  # 0.2 s without touch
    moved = pads(plan, after) - pads(plan, before)
    assert moved[0] == pytest.approx(SEARCH_SPEED * 0.2, rel=0.4)


def test_a_late_finger_searches_slowly_then_faster_and_not_for_ever(plan: GraspPlan) -> None:
    closing = GuardedClosing(plan)
    close(closing, plan, range(STEPS + 1))
    slow = EARLY / SEARCH_SPEED
    rest = (SEARCH_REACH - EARLY) / CAREFUL_SPEED
    touching = tuple(range(1, len(plan.task.fingers)))
    ends = [
        close(closing, plan, range(STEPS, STEPS + round(t / DT)), touching=touching)[-1]
        for t in (slow, rest, 1.0)
    ]
    gone = [pads(plan, q)[0] - pads(plan, plan.q)[0] for q in ends]
    assert gone[0] == pytest.approx(EARLY, rel=0.2)
    assert gone[1] == pytest.approx(SEARCH_REACH, rel=0.2)
    assert gone[2] == pytest.approx(gone[1], abs=2e-4)
