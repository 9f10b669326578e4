"""Convex hulls for coal whose corners have more neighbours than it can count."""

from __future__ import annotations

from pathlib import Path

import coal
import mujoco
import numpy as np
import pytest
import trimesh
from conftest import calls_in
from scipy.spatial import ConvexHull

from planner.bridge.geometry import coal_geometry
from planner.collision.world import CollisionWorld
from planner.hands.hand import Hand
from planner.shapes import Mesh
from planner.shapes.hulls import BLUNT, convex_geometry
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask


def ring(count: int, radius: float = 0.03) -> FloatArray:
    turn = np.arange(count) * 2 * np.pi / count
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), np.zeros(count)])


UP = np.array([0.0, 0.0, 0.05])

SOLIDS = {
    f"{name} {count}": points
    for count in (254, 255, 256, 1000)
    for name, points in (
        ("cylinder", np.concatenate([ring(count), ring(count) + UP])),
        ("cone", np.concatenate([ring(count), UP[None]])),
        ("flat cone", np.concatenate([ring(count), [[0.0, 0.0, 0.001]]])),
        ("leaning double cone", np.concatenate([ring(count), [[0.0, 0, 0.03], [0.01, 0, -0.03]]])),
    )
}


@pytest.mark.parametrize("name", SOLIDS)
def test_hulls_of_corners_with_many_neighbours_are_the_hull(name: str) -> None:
    """By numpy's support of the corners, and by coal's distances from points outside."""
    points = SOLIDS[name]
    hull = convex_geometry(points[ConvexHull(points).vertices])
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(500, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    kept = (directions @ np.array(hull.points()).T).max(axis=1)
    np.testing.assert_allclose(kept, (directions @ points.T).max(axis=1), rtol=0, atol=BLUNT)
    here = coal.Transform3s.Identity()
    for n in directions[:100]:
        beyond = float((points @ n).max()) + 0.02
        far = coal.Halfspace(-n, -beyond)
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        told = coal.distance(hull, here, far, here, request, result)
        assert told == pytest.approx(0.02, abs=2 * BLUNT)


def test_a_cylinder_of_many_sections_is_grasped_like_any_other(
    allegro: Hand, tmp_path: Path
) -> None:
    """256 sections, 1,024 triangles: coal said "Too many neighbors" of its hull."""
    trimesh.creation.cylinder(radius=0.03, height=0.1, sections=256).export(tmp_path / "can.stl")
    task = GraspTask.create(allegro, str(tmp_path / "can.stl"))
    world = CollisionWorld(task)
    T_world_base = SE3(np.eye(3), np.array([0.0, 0.0, 0.6]))
    q = allegro.posture(next(iter(allegro.description.postures)))
    down = np.array([0.0, 0.0, -0.5])
    assert world.swept_clearance_violation(T_world_base, q, down, 0.001) is not None
    assert world.swept_clearance_violation(T_world_base, q, -down, 0.001) is None


@pytest.mark.slow
def test_a_torus_of_150000_triangles_has_a_hull() -> None:
    torus = trimesh.creation.torus(0.04, 0.015, 387, 194)
    mesh = Mesh(np.array(torus.vertices), np.array(torus.faces))
    assert len(mesh.faces) > 150_000
    tops: list[float] = []
    calls = calls_in(lambda: tops.append(np.array(mesh.coal_hull.points())[:, 2].max()))
    (top,) = tops
    assert calls < len(mesh.faces), calls  # nothing goes triangle by triangle
    assert top == pytest.approx(0.015, abs=2e-6)


def test_the_mesh_of_a_hand_may_be_a_cone() -> None:
    points = SOLIDS["cone 1000"]
    vertices = " ".join(f"{v:.9g}" for v in points.ravel())
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><asset><mesh name="m" vertex="{vertices}"/></asset><worldbody><body>'
        '<geom type="mesh" mesh="m"/></body></worldbody></mujoco>'
    )
    geometry = coal_geometry(model, 0)
    assert ConvexHull(np.array(geometry.points())).volume == pytest.approx(
        ConvexHull(points).volume, rel=1e-6
    )
