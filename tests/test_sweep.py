"""Straight ways without a gap: against distances at many places on the way."""

from __future__ import annotations

import numpy as np
import pytest

from planner.collision.world import CollisionWorld
from planner.hands.hand import Hand
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask, Obstacle

CLEARANCE = 0.001


def least_on_way(world: CollisionWorld, base: SE3, q: FloatArray, way: FloatArray) -> float:
    """Least distance (m) from the surroundings at places 0.4 mm apart, or one that is too little.

    A hand that is so much farther away than it was before cannot be nearer until it has gone as
    far: places in between are left out.
    """
    length = float(np.linalg.norm(way))
    least, gone = np.inf, 0.0
    while True:
        there = SE3(base.rotation, base.translation + gone / length * way)
        distance = world.nearest(there, q, surroundings_only=True).distance
        least = min(least, distance)
        if gone >= length or least < CLEARANCE - 5e-4:
            return least
        gone = min(gone + max(4e-4, distance - least), length)


@pytest.mark.parametrize("item", ["box", "ellipsoid", "lbracket", "torus"])
def test_a_way_is_free_if_and_only_if_it_is_everywhere(allegro: Hand, item: str) -> None:
    wall = Obstacle(
        name="wall",
        size=np.array([0.02, 0.3, 0.3]),
        T_world_obstacle=SE3(np.eye(3), np.array([0.16, 0.0, 0.15])),
    )
    task = GraspTask.create(allegro, item, obstacles=(wall,))
    world = CollisionWorld(task)
    q = allegro.posture("open")
    rng = np.random.default_rng(5)
    free = touching = 0
    for _ in range(24):
        direction = rng.normal(size=3)
        shift = rng.normal(0.0, 0.06, 3) + np.array([0.0, 0.0, 0.14])
        base = SE3(np.eye(3), task.T_world_object.translation + shift)
        way = 0.04 * direction / np.linalg.norm(direction)
        found = world.swept_clearance_violation(base, q, way, CLEARANCE)
        least = least_on_way(world, base, q, way)
        if found is None:
            free += 1
            assert least > CLEARANCE - 5e-4
        else:
            touching += 1
            assert found.distance < CLEARANCE
            assert found.second in world.surroundings
            assert least < CLEARANCE + 4e-4
    assert free >= 3 and touching >= 3


def test_a_way_past_a_corner_is_followed_between_its_ends(allegro: Hand) -> None:
    # clear at both ends, through a thin wall in between
    wall = Obstacle(
        name="wall",
        size=np.array([0.004, 1.0, 1.0]),
        T_world_obstacle=SE3(np.eye(3), np.array([0.5, 0.0, 0.5])),
    )
    world = CollisionWorld(GraspTask.create(allegro, "sphere", obstacles=(wall,)))
    q, base = allegro.posture("open"), SE3(np.eye(3), np.array([0.2, 0.0, 0.6]))
    way = np.array([0.6, 0.0, 0.0])
    beyond = SE3(np.eye(3), base.translation + way)
    for at in (base, beyond):
        assert world.nearest(at, q, surroundings_only=True).distance > 0.05
    found = world.swept_clearance_violation(base, q, way, CLEARANCE)
    assert found is not None and found.second == "wall"
    assert world.swept_clearance_violation(base, q, -way / 3, CLEARANCE) is None


def test_a_way_of_no_length_is_a_place(allegro: Hand) -> None:
    world = CollisionWorld(GraspTask.create(allegro, "torus"))
    q, away = allegro.posture("open"), SE3(np.eye(3), np.array([0.0, 0.0, 0.5]))
    assert world.swept_clearance_violation(away, q, np.zeros(3), CLEARANCE) is None
    inside = SE3(np.eye(3), np.array([0.0, 0.0, 0.05]))
    found = world.swept_clearance_violation(inside, q, np.zeros(3), CLEARANCE)
    assert found is not None and found.distance < CLEARANCE
