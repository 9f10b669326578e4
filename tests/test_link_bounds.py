"""Lower bounds of distances between links: never above coal's, and the same compiled or not."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from planner.collision import form_kernels
from planner.collision.link_bounds import LinkBounds
from planner.collision.pregrasp import CLOSING_SHARES
from planner.collision.world import FAR, CollisionWorld
from planner.hands.hand import Hand
from planner.numerics.kernels import (
    attempt_kernels,
    compile_loops,
    compiled_searches,
    kernels_are_compiled,
)
from planner.search.grasp import plan_grasp
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask

CONVEX = ("sphere", "box", "cylinder", "capsule", "ellipsoid")


def bounds_of(world: CollisionWorld) -> LinkBounds:
    return world._pairs.bounds


def places(task: GraspTask, count: int) -> Iterator[tuple[SE3, FloatArray]]:
    """Base poses and joints with the hand about the object, some of them in it."""
    rng = np.random.default_rng(5)
    for _ in range(count):
        q = rng.uniform(task.hand.q_lower, task.hand.q_upper)
        turn = pin.exp3(rng.uniform(-2.0, 2.0, 3))
        yield SE3(turn, task.T_world_object.translation + rng.normal(0.0, 0.08, 3)), q


@pytest.mark.parametrize("item", CONVEX)
def test_no_bound_is_above_the_distance(right_hand: Hand, item: str) -> None:
    task = GraspTask.create(right_hand, item)
    world = CollisionWorld(task)
    bounds = bounds_of(world)
    numbers = np.arange(len(bounds.pairs))
    apart = close = 0
    for base, q in places(task, 16):
        truth = np.array([c.distance for c in world.distances(base, q)])
        inverse = base.inverse()
        poses = bounds.place(q[None], [inverse * pose for pose in world._table.fixed])
        for limit in (np.inf, 0.01):
            found = bounds.at(poses, numbers, np.array([limit]))[0]
            assert (found[truth > 0.0] <= truth[truth > 0.0]).all()
            assert (found[truth <= 0.0] < 0.0).all()
        exact = bounds.at(poses, numbers, np.array([np.inf]))[0]
        near = (truth > 0.0) & (truth < 0.05)
        apart += int(near.sum())
        close += int((truth - exact < 5e-4)[near].sum())
    assert close > 0.8 * apart  # most are good to half a millimetre, or they would prove nothing


@pytest.mark.slow
def test_no_bound_is_above_the_distance_from_a_mesh(right_hand: Hand) -> None:
    task = GraspTask.create(right_hand, "mug")
    world = CollisionWorld(task)
    bounds = bounds_of(world)
    on_mesh = np.flatnonzero(world._table.on_mesh)
    told = 0
    for base, q in places(task, 60):
        truth = np.array([c.distance for c in world.distances(base, q)])[on_mesh]
        poses = bounds.place(q[None], [base.inverse() * pose for pose in world._table.fixed])
        found = bounds.at(poses, on_mesh, np.array([np.inf]))[0]
        near = truth < FAR  # beyond, it is only said to be that far
        assert (found[near] <= np.maximum(truth[near], 0.0)).all()
        told += int((found[near] > 0.0).sum())
    assert told > 10  # of those that may have a bound above 0


@pytest.mark.parametrize("item", ["box", "cylinder", "ellipsoid", "mug"])
def test_both_forms_of_the_kernels_agree(right_hand: Hand, item: str) -> None:
    task = GraspTask.create(right_hand, item)
    world = CollisionWorld(task)
    bounds = bounds_of(world)
    place: Any = form_kernels.place_forms
    bound: Any = form_kernels.bound_pairs
    quick_place, quick_bound = compile_loops(place.loops), compile_loops(bound.loops)
    for base, q in places(task, 4):
        path = q + CLOSING_SHARES * 0.3
        chain = (path, bounds._parents, bounds._joints, bounds._axes)
        bodies = bounds._carriers, bounds._bodies
        np.testing.assert_allclose(
            quick_place(*chain, *bodies), place.plain(*chain, *bodies), atol=1e-12
        )
        poses = bounds.place(path, [base.inverse() * pose for pose in world._table.fixed])
        forms = bounds._kinds, bounds._sizes, bounds._capsules, bounds._along
        given = poses, *forms, bounds._planes, bounds.pairs, np.linspace(0.0, 0.1, len(path))
        np.testing.assert_allclose(quick_bound(*given), bound.plain(*given), atol=1e-12)


def test_what_is_called_clear_on_a_way_is_clear_all_along(right_hand: Hand) -> None:
    task = GraspTask.create(right_hand, "cylinder")
    world = CollisionWorld(task)
    bounds, rng = bounds_of(world), np.random.default_rng(2)
    around = np.flatnonzero(world._table.hand_environment_pairs)
    called = denied = 0
    for base, q in places(task, 9):
        way = rng.normal(0.0, 0.08, 3)
        poses = bounds.place(q[None], [base.inverse() * pose for pose in world._table.fixed])
        clear = bounds.clear_along(poses, around, base.rotation.T @ way, 0.001)
        least = np.full(len(around), np.inf)
        for share in np.linspace(0.0, 1.0, 40):
            there = SE3(base.rotation, base.translation + share * way)
            told = np.array([c.distance for c in world.distances(there, q)])[around]
            least = np.minimum(least, told)
        assert (least[clear] >= 0.001).all()
        called, denied = called + int(clear.sum()), denied + int((~clear).sum())
    assert called > denied > 0


def test_the_verdict_is_the_same_without_bounds(
    right_hand: Hand, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A world that asks coal for every pair says the same."""
    task = GraspTask.create(right_hand, "box")
    plan = plan_grasp(task, seed=1)
    questions = [(plan.T_world_base, plan.q), (plan.T_world_base, plan.q_pregrasp)]
    questions += list(places(task, 12))
    way = np.array([0.02, -0.03, 0.09])

    def answers(world: CollisionWorld) -> list[Any]:
        out: list[Any] = []
        for base, q in questions:
            out.append(world.nearest(base, q))
            out.append(world.nearest_below(base, q))
            out.append(world.nearest_below(base, q, clearance=0.01, surroundings_only=True))
            out.append(world.closest(base, q, 5))
            out.append(world.is_clear(base, q, environment=0.003, fingers=0.002))
            out.append(world.near(base, q, 0.03).numbers.tolist())
            found = world.swept_clearance_violation(base, q, way, 0.001)
            out.append(found is None or (found.first, found.second))
        return out

    with compiled_searches(), attempt_kernels(0):
        assert kernels_are_compiled()
        quick = answers(CollisionWorld(task))
        for module in ("world", "placed_pairs"):
            name = f"planner.collision.{module}.kernels_are_compiled"
            monkeypatch.setattr(name, lambda: False)
        assert quick == answers(CollisionWorld(task))
