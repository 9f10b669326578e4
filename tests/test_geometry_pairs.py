"""Quick answers of a ``CollisionWorld`` against one exact query after the other."""

from __future__ import annotations

from collections.abc import Iterator

import coal
import numpy as np
import pinocchio as pin
import pytest

from planner.collision.mesh_distance import MeshPair
from planner.collision.world import OBJECT, CollisionWorld
from planner.hands.hand import Hand
from planner.kinematics import HandState
from planner.search.grasp import plan_grasp
from planner.shapes import Mesh
from planner.shapes.convex_pairs import FAILED, LEAST_LIMIT, DistancePair, GeometryPairs
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask

MESHES = ("torus", "mug", "lbracket")


def places(task: GraspTask, count: int) -> Iterator[tuple[SE3, FloatArray]]:
    """Base poses and joints with the hand about the object, some of them deep in it."""
    hand, rng = task.hand, np.random.default_rng(11)
    for _ in range(count):
        q = hand.posture("open") + rng.normal(0.0, 0.05, hand.nq)
        finger = list(hand.fingers.values())[rng.integers(len(hand.fingers))]
        tip = HandState(hand, q).tip_pose(finger).translation
        turn = pin.exp3(rng.uniform(-2.0, 2.0, 3))
        spot = task.T_world_object.translation + rng.normal(0.0, 0.07, 3)
        yield SE3(turn, spot - turn @ tip), q


def exact(
    task: GraspTask, base: SE3, q: FloatArray, pairs: list[tuple[str, str]]
) -> dict[tuple[str, str], float]:
    """Signed distances (m) of pairs of hand geometries, or of one and the object, one by one."""
    state, shape, out = HandState(task.hand, q), task.object.shape, {}
    geometry = {g.name: g.geometry for g in task.hand.geometries}
    pose = {
        g.name: base * state.joint_pose(g.joint_id) * g.T_joint_geometry
        for g in task.hand.geometries
    }
    for first, second in pairs:
        a, pair = geometry[first], (first, second)
        if second != OBJECT:
            out[pair] = DistancePair(a, geometry[second]).distance(pose[first], pose[second])
        elif isinstance(shape, Mesh):
            out[pair] = MeshPair(a, shape).distance(pose[first], task.T_world_object)
        else:
            by_coal = DistancePair(a, shape.coal_geometry())
            out[pair] = by_coal.distance(pose[first], task.T_world_object)
    return out


@pytest.mark.slow
@pytest.mark.parametrize("item", ["sphere", "ellipsoid", *MESHES])
def test_all_quick_answers_are_those_of_single_queries(right_hand: Hand, item: str) -> None:
    task = GraspTask.create(right_hand, item, table_height=None)
    world = CollisionWorld(task)
    pairs = [(c.first, c.second) for c in world.distances(SE3.Identity(), right_hand.q_lower)]
    negative = apart = 0
    for base, q in places(task, 12):
        truth = exact(task, base, q, pairs)
        least = min(truth.values())
        nearest, touching = world.nearest(base, q), world.nearest_below(base, q)
        assert (touching is None) == (least >= LEAST_LIMIT)
        negative, apart = negative + (least < 0), apart + (least > 0)
        if least < 0 and item in MESHES:  # a depth in a mesh is that of some triangle
            assert nearest.distance < 0
            assert truth[nearest.first, nearest.second] < 0
            continue
        assert nearest.distance == pytest.approx(least, abs=2e-6)
        assert truth[nearest.first, nearest.second] == pytest.approx(least, abs=2e-6)
        if touching is not None:
            assert touching.distance == pytest.approx(least, abs=2e-6)

        within = {pair for pair in pairs if pair[1] == OBJECT}
        around = min(truth[pair] for pair in within)
        clear = world.nearest_below(base, q, clearance=0.01, surroundings_only=True)
        assert (clear is None) == (around >= 0.01)
        if clear is not None:
            assert clear.distance == pytest.approx(around, abs=2e-6)

        closest = world.closest(base, q, 5)
        kept = max(5, sum(d < 0 for d in truth.values()))
        expected = sorted(truth.values())[:kept]
        np.testing.assert_allclose([c.distance for c in closest], expected, rtol=0, atol=2e-6)
        for c in closest:
            assert truth[c.first, c.second] == pytest.approx(c.distance, abs=2e-6)
    assert negative and apart


def test_what_may_touch_is_left_out_of_the_closest(allegro: Hand) -> None:
    task = GraspTask.create(allegro, "torus")
    base, q = next(places(task, 1))
    world = CollisionWorld(task)
    names = {g.name for g in allegro.geometries}
    found = world.closest(base, q, 8, may_touch=names)
    assert len(found) >= 8
    assert all(c.second != OBJECT for c in found)


def test_near_pairs_tell_how_their_distance_changes(right_hand: Hand) -> None:
    # a small step of the joints against the distance after it
    plan = plan_grasp(GraspTask.create(right_hand, "torus"), seed=0)
    world, base = CollisionWorld(plan.task), plan.T_world_base
    q = plan.q + 0.1 * (plan.q_pregrasp - plan.q)  # pads some 2 mm off
    near = world.near(base, q, 0.03)
    assert near.mesh.any() and (~near.hand_environment).any()
    state = world.moving.move(q)
    rates = state.point_rates(near.joints[:, 1], near.points_b, near.normals)
    rates = rates - state.point_rates(near.joints[:, 0], near.points_a, near.normals)
    step = np.random.default_rng(2).normal(0.0, 1e-5, right_hand.nq)
    before, after = world.distances(base, q), world.distances(base, q + step)
    apart = near.distances > 1e-4
    assert apart.sum() > 5
    change = [after[k].distance - before[k].distance for k in near.numbers[apart]]
    np.testing.assert_allclose(rates[apart] @ step, change, rtol=0, atol=2e-7)
    named = world.near(base, q, 0.03, near.numbers[~near.mesh])
    np.testing.assert_allclose(
        named.distances[~named.mesh], near.distances[~near.mesh], rtol=0, atol=1e-9
    )


def test_a_ball_deep_in_a_cylinder_leaves_by_the_nearer_end(allegro: Hand) -> None:
    # coal says 30 mm through the side; the ball's centre is 5 mm below the end, its radius 10 mm
    model = pin.GeometryModel()
    model.addGeometryObject(pin.GeometryObject("ball", 0, SE3.Identity(), coal.Sphere(0.01)))
    tall = pin.GeometryObject("tall", 0, SE3.Identity(), coal.Cylinder(0.03, 0.1))
    model.addGeometryObject(tall)
    pairs = GeometryPairs(allegro.pin_model, model, [(0, 1)], 1)
    pairs.place(allegro.q_lower, [SE3(np.eye(3), np.array([0.0, 0.0, -0.045]))])
    one = np.ones(1, dtype=bool)
    assert pairs.nearest(one)[1] == pytest.approx(-0.015, abs=1e-9)
    assert pairs.distances(one)[0] == pytest.approx(-0.015, abs=1e-9)


def test_a_query_that_coal_fails_at_is_asked_again(
    allegro: Hand, monkeypatch: pytest.MonkeyPatch
) -> None:
    world = CollisionWorld(GraspTask.create(allegro, "box"))
    base, q = SE3(np.eye(3), np.array([0.0, 0.0, 0.3])), allegro.posture("open")
    truth = world.nearest(base, q)
    # so small a limit makes every distance a failure
    monkeypatch.setattr("planner.shapes.convex_pairs.FAILED", 0.0)
    asked = []
    distance = DistancePair.distance

    def told(self: DistancePair, a: SE3, b: SE3) -> float:
        asked.append(self)
        with monkeypatch.context() as single:
            single.setattr("planner.shapes.convex_pairs.FAILED", FAILED)  # of one pair, the usual
            return distance(self, a, b)

    monkeypatch.setattr(DistancePair, "distance", told)
    again = world.distances(base, q)
    assert len(asked) == len(again)
    assert min(c.distance for c in again) == pytest.approx(truth.distance, abs=1e-9)
