"""Room for joints that are off: how much it is, that plans have it, and that it costs no plan."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import mujoco
import numpy as np
import pytest
from conftest import box_mesh
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.collision.pregrasp_ik import spread_idle
from planner.collision.world import CollisionWorld
from planner.errors import TaskError
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.kinematics import HandState, tip_reach
from planner.objects import GraspObject
from planner.plan import GraspPlan
from planner.search.grasp import plan_grasp
from planner.spatial import FloatArray
from planner.synthesis.options import LEAST_ROOM, SynthesisOptions, table_room, with_room
from planner.task import GraspTask
from planner.tolerances import EDGE_RADIUS

ROUGH = float(np.deg2rad(3.0))


@pytest.mark.parametrize("name", ["allegro_hand", "shadow_hand_left", "shadow_on_arm7"])
def test_reach_is_what_random_errors_of_the_joints_do_to_a_pad(name: str) -> None:
    """By kinematics alone: the spread of a pad in its worst direction, of the worst finger."""
    hand, s = load_hand(name), 1e-3
    middle = (hand.q_lower + hand.q_upper) / 2.0
    rng = np.random.default_rng(0)
    spread = 0.0
    for finger in hand.fingers.values():
        at = []
        for _ in range(2000):
            q = middle.copy()
            q[finger.q_index] += s * rng.standard_normal(len(finger.q_index))
            at.append(HandState(hand, q).pad_center(finger))
        spread = max(spread, float(np.sqrt(np.linalg.eigvalsh(np.cov(np.array(at).T))[-1])))
    assert spread / s == pytest.approx(tip_reach(hand), rel=0.05)


@given(error=st.floats(0.0, 0.2))
@settings(deadline=None)  # the first example finds the reach
def test_margins_grow_by_standard_deviations_of_a_tip(allegro: Hand, error: float) -> None:
    options = SynthesisOptions(clear_object=0.002, clear_fingers=0.001, clear_table=0.004)
    task = GraspTask.create(allegro, "sphere", joint_error=error)
    roomy = with_room(options, task)
    room = error * tip_reach(allegro)
    assert roomy.clear_object == pytest.approx(0.002 + room)
    assert roomy.clear_fingers == pytest.approx(0.001 + room)
    assert roomy.clear_table == pytest.approx(0.004 + 2.0 * room)  # a tip on the table ends a trial
    before = replace(roomy, clear_object=0.002, clear_fingers=0.001, clear_table=0.004)
    assert before == options
    assert (roomy is options) == (room == 0.0)


def between_fingers(plan: GraspPlan) -> float:
    """Least distance (m) between links of two fingers, as MuJoCo has it."""
    hand = plan.task.hand
    data = mujoco.MjData(hand.mj_model)
    data.qpos[:] = plan.q
    mujoco.mj_kinematics(hand.mj_model, data)
    return float(
        min(
            mujoco.mj_geomDistance(hand.mj_model, data, a, b, 1.0, None)
            for one, other in combinations(geoms_of_fingers(hand), 2)
            for a in one
            for b in other
        )
    )


def geoms_of_fingers(hand: Hand) -> list[list[int]]:
    model, finger_of = hand.mj_model, hand.finger_of_body
    bodies = [model.body(int(b)).name for b in model.geom_bodyid]
    return [
        [i for i, body in enumerate(bodies) if finger_of.get(body) == name and solid(model, i)]
        for name in hand.fingers
    ]


def solid(model: mujoco.MjModel, geom: int) -> bool:
    return bool(model.geom_contype[geom] or model.geom_conaffinity[geom])


def lowest_pad(plan: GraspPlan) -> float:
    """Height of the lowest pad over the table, m."""
    state, task = HandState(plan.task.hand, plan.q), plan.task
    heights = [plan.T_world_base.act(state.pad_center(f))[2] - f.pad.radius for f in task.fingers]
    return float(min(heights))


@pytest.fixture(scope="module")
def pairs(allegro: Hand) -> list[tuple[GraspPlan, GraspPlan]]:
    """Plans for exact joints and for joints that are off, from the same starts."""
    exact, off = (GraspTask.create(allegro, "box", joint_error=error) for error in (0.0, ROUGH))
    return [(plan_grasp(exact, seed=s), plan_grasp(off, seed=s)) for s in range(5)]


def test_plans_have_the_room(pairs: list[tuple[GraspPlan, GraspPlan]], allegro: Hand) -> None:
    room = ROUGH * tip_reach(allegro)
    asked = SynthesisOptions()
    assert min(between_fingers(exact) for exact, _ in pairs) < asked.clear_fingers + room
    for _, plan in pairs:
        assert between_fingers(plan) > asked.clear_fingers + room - 5e-4
        assert lowest_pad(plan) > asked.clear_table + 2.0 * room - 5e-4


@pytest.mark.slow
@pytest.mark.parametrize("spec", ["box:0.03x0.03x0.04", "cylinder:0.015x0.1"])
def test_a_plan_is_found_where_there_is_no_room(spec: str) -> None:
    """Four fingers on a thin thing, with 15 mm between them: there is no such grasp."""
    fingers = ("thumb", "index", "middle", "ring")
    task = GraspTask.create("shadow_hand", spec, fingers=fingers, joint_error=ROUGH * 3.0)
    plan = plan_grasp(task, max_attempts=20)
    assert between_fingers(plan) < SynthesisOptions().clear_fingers + task.joint_error * 0.1
    best = plan_grasp(task, keep="best", max_attempts=80)  # its ascent gives the room up, too
    assert best.quality.epsilon >= plan.quality.epsilon
    assert between_fingers(best) < SynthesisOptions().clear_fingers + task.joint_error * 0.1


def beside_ring(plan: GraspPlan, q: FloatArray) -> float:
    """Distance of the idle ring finger's pad from the middle finger's by MuJoCo, m."""
    model = plan.task.hand.mj_model
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    pads = [model.geom(name).id for name in ("middle_pad", "ring_pad")]
    return float(mujoco.mj_geomDistance(model, data, *pads, 0.2, np.zeros(6)))


def test_an_idle_finger_makes_way_for_opened_ones_that_are_off(allegro: Hand) -> None:
    fingers = ("thumb", "index", "middle")
    task = GraspTask.create(allegro, "cylinder:0.03x0.08", fingers=fingers, joint_error=ROUGH)
    plan = plan_grasp(task, seed=0)
    taking_part = np.concatenate([f.q_index for f in task.fingers])
    idle = allegro.fingers["ring"].q_index
    # the ring finger opened as the middle finger is, and leant towards it
    near = plan.q_pregrasp.copy()
    near[idle] = near[allegro.fingers["middle"].q_index]
    leant = [near + by * np.eye(len(near))[idle[0]] for by in (-0.2, 0.2)]
    near = min(leant, key=lambda q: beside_ring(plan, q))
    world = CollisionWorld(task)
    led = spread_idle(world, plan.T_world_base, near, near=ROUGH * tip_reach(allegro), sweeps=10)
    assert_same(led[taking_part], near[taking_part])
    assert (led >= allegro.q_lower).all() and (led <= allegro.q_upper).all()
    assert beside_ring(plan, led) > beside_ring(plan, near) + 0.005
    # a plan has it already, and exact joints need none of it
    assert beside_ring(plan, plan.q_pregrasp) > 2.0 * ROUGH * tip_reach(allegro)
    exact = plan_grasp(GraspTask.create(allegro, "cylinder:0.03x0.08", fingers=fingers), seed=0)
    assert_same(exact.q_pregrasp[idle], exact.q[idle])


def test_without_an_error_nothing_changes(pairs: list[tuple[GraspPlan, GraspPlan]]) -> None:
    plain = plan_grasp(GraspTask.create(pairs[0][0].task.hand, "box"), seed=0)
    assert_same(plain.q, pairs[0][0].q)


def assert_same(one: FloatArray, other: FloatArray) -> None:
    np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("error", [-0.01, 0.3, float("nan"), float("inf"), "3", True])
def test_an_error_out_of_range_is_refused(allegro: Hand, error: object) -> None:
    with pytest.raises(TaskError, match="joint_error"):
        GraspTask.create(allegro, "sphere", joint_error=error)  # type: ignore[arg-type]


def test_a_low_narrow_part_leaves_fingers_less_room_over_the_table() -> None:
    asked = SynthesisOptions().clear_table
    rod = GraspObject(name="rod", shape=box_mesh((0.012, 0.06, 0.012)))
    low = GraspTask.create("allegro_hand", rod)
    assert LEAST_ROOM <= table_room(low) < asked
    bar = GraspObject(name="bar", shape=box_mesh((0.016, 0.06, 0.016)))
    task = GraspTask.create("allegro_hand", bar)
    radius = max(f.pad.radius for f in task.fingers)
    between = 2.0 * (task.T_world_object.translation[2]) - EDGE_RADIUS - radius
    assert table_room(task) == pytest.approx(max(LEAST_ROOM, between / 2.0), abs=1e-6)
    assert between / 2.0 > LEAST_ROOM
    assert np.isinf(table_room(replace(low, table_height=None)))
    plate = GraspObject(name="plate", shape=box_mesh((0.08, 0.08, 0.016)))
    for ordinary in ("box:0.04x0.06x0.016", "mug", plate):
        assert np.isinf(table_room(GraspTask.create("allegro_hand", ordinary)))
