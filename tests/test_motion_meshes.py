"""Meshes turned in the hand: where starts put contacts, which edges count, and that it is found."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from conftest import box_mesh

from planner.hands.hand import Hand
from planner.motion import ObjectPath, motion_attempts
from planner.motion.context import _off_edges, on_opposed_sides, with_rolling_pads
from planner.motion.problem import build_motion_problem, turned_surface_of
from planner.motion.residuals import MotionResiduals
from planner.motion.search import MOTION_OPTIONS
from planner.objects import GraspObject, parse_object
from planner.shapes import Cylinder, Mesh, Superquadric
from planner.spatial import SE3
from planner.synthesis.mesh_surface import surface_of
from planner.synthesis.problem import Start
from planner.synthesis.seeds import turning_seeder_for
from planner.synthesis.seeds.mesh import MeshSeeder, TurningSeeder
from planner.synthesis.terms.clearance import OBJECT, OBSTACLE, TABLE
from planner.synthesis.terms.fingers import FINGERS
from planner.task import GraspTask

THREE = ["thumb", "index", "middle"]


@pytest.fixture(scope="module")
def block() -> Mesh:
    return box_mesh((0.06, 0.06, 0.08))


@pytest.fixture(scope="module")
def on_block(allegro: Hand, block: Mesh) -> GraspTask:
    return GraspTask.create(allegro, GraspObject(name="block", shape=block), fingers=THREE)


def test_starts_on_a_mesh_oppose_one_side_to_the_other(on_block: GraspTask, block: Mesh) -> None:
    seeder = turning_seeder_for(on_block)
    for seed in range(6):
        drawn = seeder.draw(np.random.default_rng(seed))
        assert isinstance(drawn, Start)
        # as if the hand were so far aside that some pads are nearest to a neighbouring side
        level = np.cross(on_block.T_world_object.rotation[2], drawn.forces[0])
        aside = SE3(np.eye(3), 0.035 * level / np.linalg.norm(level))
        drawn = replace(drawn, T_object_base=aside * drawn.T_object_base)
        start = on_opposed_sides(drawn, seeder)
        points, normals = block.closest_point(start.points)
        assert np.allclose(points, start.points, atol=1e-9)
        assert np.allclose(normals[1], -normals[0]) and np.allclose(normals[2], -normals[0])
        pressed = start.forces / np.linalg.norm(start.forces, axis=1, keepdims=True)
        assert np.allclose(pressed, -normals)
        assert np.linalg.norm(start.forces, axis=1) == pytest.approx(
            np.linalg.norm(drawn.forces, axis=1)
        )
        across = np.flatnonzero(np.abs(normals[0]) < 0.5)
        room = np.array([0.03, 0.03, 0.04])[across] - np.abs(start.points[:, across])
        assert room.min() > 0.002  # off edges


def test_starts_on_what_has_no_faces_stay_as_they_are(allegro: Hand) -> None:
    task = GraspTask.create(allegro, "cylinder:0.03x0.08", fingers=THREE)
    seeder = turning_seeder_for(task)
    drawn = seeder.draw(np.random.default_rng(0))
    assert isinstance(drawn, Start)
    assert on_opposed_sides(drawn, seeder) is drawn


def test_starts_of_turns_are_more_level_than_those_of_grasps(on_block: GraspTask) -> None:
    def steepest(seeder: MeshSeeder) -> float:
        level = on_block.T_world_object.rotation[2]
        return float(np.abs(seeder._pairs.directions[seeder._chance > 0.0] @ level).max())

    assert steepest(TurningSeeder(on_block)) <= 0.3
    assert TurningSeeder.steepest < MeshSeeder.steepest


def test_a_contact_near_an_edge_lacks_slope_in_a_motion_alone(block: Mesh) -> None:
    near = np.array([[0.03, 0.03 - 0.0085, 0.0]])  # 8.5 mm from the edge, on the face
    slope = float(np.linalg.norm(block.field().taylor(near, 1)[0, 1:4]))
    in_grasp = surface_of(block).size(block)[0]
    in_motion = turned_surface_of(block).size(block)[0]
    assert in_grasp < slope < in_motion
    assert turned_surface_of(block).normal_error < surface_of(block).normal_error


def test_thin_walls_are_steep_enough_and_no_edges() -> None:
    mug = parse_object("mug").shape
    assert isinstance(mug, Mesh)
    surface = turned_surface_of(mug)
    assert surface.size(mug)[0] == 0.87
    assert surface_of(mug).size(mug)[0] > 0.9
    points, normals = _off_edges(mug)
    outside = np.einsum("nd,nd->n", points[:, :2], normals[:, :2]) > 0.9 * 0.04
    height = points[outside, 2] - points[:, 2].min()
    # starts find the outer wall, which is 4 mm thick, all the way up but not at its ends
    assert len(height) > 200
    assert height.min() < 0.02 and 0.06 < height.max() < 0.0895


def test_what_was_looked_up_once_is_looked_up_again_when_it_comes_near(
    allegro: Hand, on_block: GraspTask, block: Mesh
) -> None:
    """From place to place the same rows count as for residuals that have seen nothing before."""
    problem = build_motion_problem(allegro, on_block.fingers, block, 3)
    seeder = turning_seeder_for(on_block)
    start = seeder.draw(np.random.default_rng(0))
    assert isinstance(start, Start)
    path = ObjectPath(axis=np.array([0.0, 0.0, 1.0]), angle=1.0, shift=np.zeros(3))
    numbers = problem.numbers(on_block, path, start, seeder.posture, MOTION_OPTIONS, 0.02)
    seen = MotionResiduals(problem, numbers, block.field())
    rng, first = np.random.default_rng(3), problem.first(start)
    counted = set()
    for step in (0.0, 0.3, 0.02, 0.1, 0.01, 0.2):
        z = first + step * rng.normal(size=len(first))
        fresh = MotionResiduals(problem, numbers, block.field())
        values, expected = seen(z)[0].copy(), fresh(z)[0]
        np.testing.assert_allclose(values, expected, atol=1e-12)
        names = [row.term for row in seen.row_names()]
        counted.add(sum(term in (OBJECT, TABLE, OBSTACLE, FINGERS) for term in names))
    assert len(counted) > 3, "more and fewer links are too near"


def test_primitives_are_the_same_in_grasps_and_motions() -> None:
    shape = Cylinder(0.03, 0.08)
    assert turned_surface_of(shape) is surface_of(shape)


def test_meshes_with_sizes_of_their_own_have_rolling_pads_too(allegro: Hand) -> None:
    assert with_rolling_pads(GraspTask.create(allegro, "superquadric", fingers=THREE)).hand.rolls


@pytest.mark.slow
def test_a_superquadric_is_turned_by_a_right_angle(allegro: Hand) -> None:
    shape = Superquadric(0.06, 0.06, 0.09, 0.5, 0.5)
    item = GraspObject(name="superquadric", shape=shape, mass=0.3)
    task = GraspTask.create(allegro, item, mu=0.45, fingers=THREE)
    path = ObjectPath(axis=np.array([0.0, 0.0, 1.0]), angle=np.pi / 2, shift=np.zeros(3))
    # of 24 attempts, as about one in five succeeds
    attempts = islice(motion_attempts(task, path, path_tolerance=0.03, seed=0), 24)
    found = next((a.plan for a in attempts if a.plan is not None), None)
    assert found is not None
    assert all(k.verification.ok and k.closure.closed for k in found.knots)


def test_every_problem_on_a_mesh_collects_field_points_of_its_own() -> None:
    surface, again = (turned_surface_of(parse_object("superquadric").shape) for _ in range(2))
    assert (again.normal_error, again.distance_error) == (0.08, 0.0035)
    assert again is not surface and again.field is not surface.field
