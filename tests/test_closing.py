"""Closing until felt: what the reference does while fingers touch early, in time and late."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest
from conftest import PlanOf
from hypothesis import given, settings
from hypothesis import strategies as st
from test_sim_controllers import observe

from planner.errors import FileFormatError
from planner.files import plan_to_dict, read_plan
from planner.hands.hand import Hand
from planner.kinematics import HandState
from planner.plan import GraspPlan
from planner.search.beyond import SearchDirection, search_directions
from planner.search.grasp import plan_grasp
from planner.spatial import FloatArray, minimum_jerk
from planner.task import GraspTask
from sim.controllers.closing import (
    CAREFUL_SPEED,
    EARLY,
    MOST_WAY,
    SEARCH_REACH,
    SEARCH_SPEED,
    WAY_SPEED,
    GuardedClosing,
)
from sim.controllers.grasp import GraspController

DT, STEPS = 0.002, 250


@pytest.fixture(scope="module")
def plan(plan_of: PlanOf) -> GraspPlan:
    return plan_of("allegro_hand", "sphere")


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


def loose(plan: GraspPlan) -> GraspPlan:
    """The plan of a task whose joints may be off by 3 degrees."""
    return replace(plan, task=replace(plan.task, joint_error=np.deg2rad(3.0)))


def test_exact_joints_make_no_way(plan: GraspPlan) -> None:
    """What they feel on the way in is what effort feels where a joint begins to move."""
    controller = GraspController(plan)
    for k in range(1, 60):
        caught = np.full(len(plan.task.fingers), 0.5)
        controller.step(replace(observe(plan, "approach", 1.0, force=caught), time=DT * k))
    assert controller.q_ref.tobytes() == plan.q_pregrasp.tobytes()


def test_a_finger_that_touches_on_the_way_in_opens_until_it_is_free(plan: GraspPlan) -> None:
    plan = loose(plan)
    controller = GraspController(plan)
    opened = pads(plan, plan.q_pregrasp)
    caught = np.zeros(len(plan.task.fingers))
    caught[0] = 0.5

    def come(force: FloatArray, steps: range) -> FloatArray:
        for k in steps:
            controller.step(replace(observe(plan, "approach", 1.0, force=force), time=DT * k))
        return opened - pads(plan, controller.q_ref)

    np.testing.assert_array_equal(come(0.0 * caught, range(1, 10)), 0.0)
    assert controller.q_ref.tobytes() == plan.q_pregrasp.tobytes()
    gone = come(caught, range(10, 60))  # 0.1 s
    assert gone[0] == pytest.approx(0.1 * WAY_SPEED, rel=0.2)
    np.testing.assert_allclose(gone[1:], 0.0, atol=1e-12)
    assert come(0.0 * caught, range(60, 100))[0] == gone[0]  # free again: it stays there
    assert come(caught, range(100, 1000))[0] == pytest.approx(MOST_WAY, rel=0.2)


def test_a_finger_that_touches_before_it_closes_is_not_held_there(plan: GraspPlan) -> None:
    plan = loose(plan)
    closing = GuardedClosing(plan)
    close(closing, plan, range(10), touching=(0,), q=plan.q_pregrasp)
    assert not closing.careful
    last = close(closing, plan, range(10, 400))[-1]  # free: it closes as planned
    np.testing.assert_allclose(pads(plan, last)[0], pads(plan, plan.q)[0], atol=0.008)
    # one that cannot open any further has touched, early
    stuck = GuardedClosing(plan)
    close(stuck, plan, range(round(MOST_WAY / WAY_SPEED / DT) + 5), touching=(0,), q=halfway(plan))
    assert stuck.careful


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


BOTH = "allegro_hand", "shadow_hand"
"""The Shadow-type hand has coupled joints."""


@cache
def planned(name: str) -> GraspPlan:
    return plan_grasp(GraspTask.create(name, "box"), seed=2)


@pytest.mark.parametrize("name", BOTH)
def test_a_search_moves_the_pad_along_its_normal_as_the_joints_can(name: str) -> None:
    either = planned(name)
    couplings, _ = either.task.hand.coupling_matrix
    far = 1e-5
    for i, way in enumerate(search_directions(either)):
        step = np.zeros(either.task.hand.nq)
        step[way.index] = way.straight
        # contacts are fixed in their links; their motion along the normal by differences
        moved = contact(either, i, either.q + far * step) - contact(either, i, either.q)
        assert float(moved @ inwards(either)[i]) == pytest.approx(far, rel=1e-3)
        np.testing.assert_allclose(couplings @ step, 0.0, atol=1e-9)


def contact(plan: GraspPlan, i: int, q: FloatArray) -> FloatArray:
    """The point of a link that touches in the plan, at joints q, base, m."""
    joint = plan.task.fingers[i].pad.joint_id
    planned = HandState(plan.task.hand, plan.q).joint_pose(joint)
    point = plan.T_world_base.inverse().act(plan.contacts.positions[i])
    return np.array(HandState(plan.task.hand, q).joint_pose(joint).act(planned.actInv(point)))


def inwards(plan: GraspPlan) -> FloatArray:
    return np.asarray(plan.contacts.normals @ plan.T_world_base.rotation)


@pytest.mark.parametrize("name", BOTH)
@given(slope=st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=4))
@settings(deadline=None)  # the first example plans a grasp
def test_a_way_past_a_neighbour_goes_as_far_and_comes_no_nearer(
    name: str, slope: list[float]
) -> None:
    for way in search_directions(planned(name)):
        off = np.array((slope * 2)[: len(way.index)])
        found = way.around(off)
        if found is None:
            continue
        assert way.along @ found == pytest.approx(way.along @ way.straight)
        assert off @ found >= -1e-9
        # of all such directions it costs least: none of the straight one's kind is cheaper
        assert cost(way, found) >= cost(way, way.straight) - 1e-9


def cost(way: SearchDirection, v: FloatArray) -> float:
    inner = way.free.T @ v
    return float(inner @ way.cost @ inner)


def test_there_is_no_way_past_what_stands_right_ahead() -> None:
    """The distance falls exactly as the pad goes along the normal, whatever joints move."""
    ahead = np.array([0.03, 0.01])
    way = SearchDirection(
        index=np.arange(2),
        along=ahead,
        straight=ahead / (ahead @ ahead),
        free=np.eye(2),
        cost=np.eye(2),
    )
    assert way.around(-2.0 * ahead) is None


@pytest.mark.slow
def test_a_search_does_not_run_into_a_neighbour() -> None:
    """A finger leans on its neighbour's side; MuJoCo measures between the links."""
    plan = plan_grasp(GraspTask.create("shadow_hand", "cylinder"), seed=2)
    hand, fingers = plan.task.hand, plan.task.fingers
    directions, ahead = search_directions(plan), EARLY
    tried = []
    for i, finger in enumerate(fingers):
        for turn in np.deg2rad(np.linspace(-15.0, 15.0, 31)):
            lean = plan.q.copy()
            lean[finger.q_index[0]] += turn
            further = lean.copy()
            further[finger.q_index] += ahead * directions[i].straight
            now, then = gap(hand, finger.name, lean), gap(hand, finger.name, further)
            if 5e-4 < now < 1.5e-3 and then < now - 8e-4:
                tried.append((i, lean, now))
    assert tried, "no finger of this plan searches towards its neighbour"
    for i, lean, now in tried:
        closing = GuardedClosing(plan)
        touching = tuple(k for k in range(len(fingers)) if k != i)
        close(closing, plan, range(STEPS + 1))
        steps = round(ahead / SEARCH_SPEED / DT)
        before = close(closing, plan, range(STEPS, STEPS + 1), touching=touching, q=lean)[-1]
        after = close(closing, plan, range(STEPS, STEPS + steps), touching=touching, q=lean)[-1]
        # as far as the reference went, so far the joints would have gone; they read the same all
        # the while, so a way that is straight in joints bends by some tenths of a millimetre
        assert gap(hand, fingers[i].name, lean + after - before) > now - 5e-4


def gap(hand: Hand, name: str, q: FloatArray) -> float:
    """Least distance (m) of a finger's links from those of others, as MuJoCo has it."""
    model, data = hand.mj_model, mujoco.MjData(hand.mj_model)
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    of = [hand.finger_of_body.get(model.body(int(b)).name) for b in model.geom_bodyid]
    solid = [bool(model.geom_contype[i] or model.geom_conaffinity[i]) for i in range(model.ngeom)]
    mine = [i for i in range(model.ngeom) if of[i] == name and solid[i]]
    others = [i for i in range(model.ngeom) if of[i] not in (name, None) and solid[i]]
    return float(
        min(mujoco.mj_geomDistance(model, data, a, b, 1.0, None) for a in mine for b in others)
    )


def test_a_plan_file_keeps_that_joints_may_be_off(plan: GraspPlan, tmp_path: Path) -> None:
    """Read again, fingers make way as for the plan itself; other files stay as they were."""
    off = loose(plan)
    off.save(tmp_path / "off.json")
    again = read_plan(tmp_path / "off.json")
    assert again.task.joint_error == pytest.approx(np.deg2rad(3.0))
    assert json.loads((tmp_path / "off.json").read_text())["version"] == 4
    assert "joint_error_rad" not in plan_to_dict(plan)["task"]
    data = json.loads((tmp_path / "off.json").read_text())
    data["version"] = 1
    (tmp_path / "off.json").write_text(json.dumps(data))
    with pytest.raises(FileFormatError, match="joint_error_rad; that is in version 4 alone"):
        read_plan(tmp_path / "off.json")
