"""A new primitive is one class and one registration: a cone, added from outside of the package."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca
import coal
import numpy as np
import pytest
import trimesh

from planner import GraspTask, plan_grasp, read_plan, write_plan
from planner.errors import ObjectError
from planner.objects import object_names, parse_object
from planner.shapes import SIZED_SHAPES, Mesh, Shape, register_shape, shape_from_dict
from planner.shapes.base import (
    Patch,
    Surface,
    checked_length,
    checked_points,
    edge_margin,
    soft_norm,
)
from planner.spatial import SE3, FloatArray


@dataclass(frozen=True)
class Cone(Shape):
    """A cone about z, its apex up; the centre of mass is a quarter of the height above the base."""

    kind: ClassVar[str] = "cone"
    size_names: ClassVar[tuple[str, ...]] = ("radius", "height")
    default_sizes: ClassVar[tuple[float, ...]] = (0.035, 0.12)
    turns_tips: ClassVar[bool] = False
    radius: float
    height: float

    def __post_init__(self) -> None:
        """Check the sizes."""
        for name in self.size_names:
            checked_length(self.kind, name, getattr(self, name))

    @property
    def slant(self) -> FloatArray:
        """Outward normal of the side (2,): radial and axial part."""
        across = np.array([self.height, self.radius])
        return np.asarray(across / np.linalg.norm(across))

    @property
    def sizes(self) -> tuple[float, ...]:
        return self.radius, self.height

    @property
    def half_extents(self) -> FloatArray:
        return np.array([self.radius, self.radius, 0.75 * self.height])

    @property
    def bounding_radius(self) -> float:
        return float(max(0.75 * self.height, np.hypot(self.radius, 0.25 * self.height)))

    @property
    def volume(self) -> float:
        return np.pi * self.radius**2 * self.height / 3

    def inertia(self, mass: float) -> FloatArray:
        across = mass * (3 / 20 * self.radius**2 + 3 / 80 * self.height**2)
        return np.diag([across, across, 0.3 * mass * self.radius**2])

    def coal_geometry(self) -> Any:
        # coal's own cone has its origin at half of its height
        angles = np.linspace(0, 2 * np.pi, 96, endpoint=False)
        rim = np.column_stack([np.cos(angles), np.sin(angles)]) * self.radius
        points = coal.StdVec_Vec3s()
        for x, y in rim:
            points.append(np.array([x, y, -0.25 * self.height]))
        points.append(np.array([0.0, 0.0, 0.75 * self.height]))
        return coal.Convex.convexHull(points, False, "")

    def closest_point(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        p = checked_points(points)
        rho = np.hypot(p[:, 0], p[:, 1])
        out = np.where(rho[:, None] > 1e-12, p[:, :2] / np.maximum(rho, 1e-12)[:, None], [1.0, 0.0])
        low, top = -0.25 * self.height, 0.75 * self.height
        # in the half plane (rho, z): the side from rim to apex, the base from axis to rim
        along = np.array([-self.radius, self.height])
        share = ((rho - self.radius) * along[0] + (p[:, 2] - low) * along[1]) / (along @ along)
        side = np.array([self.radius, low]) + np.clip(share, 0, 1)[:, None] * along
        base = np.column_stack([np.minimum(rho, self.radius), np.full(len(p), low)])
        flat = np.column_stack([rho, p[:, 2]])
        depth = (side - flat) @ self.slant
        inside = (depth > 0) & (p[:, 2] > low)
        to_side = np.linalg.norm(flat - side, axis=1)
        to_base = np.linalg.norm(flat - base, axis=1)
        near_side = to_side <= to_base
        found = np.where(near_side[:, None], side, base)
        normal = np.where(near_side[:, None], self.slant, [0.0, -1.0])
        gap = flat - found
        distance = np.linalg.norm(gap, axis=1)
        apart = ~inside & (distance > 1e-12)
        normal[apart] = gap[apart] / distance[apart, None]
        assert top > low
        surface, outward = (np.column_stack([out * v[:, :1], v[:, 1]]) for v in (found, normal))
        return surface, outward

    def support(self, direction: FloatArray) -> float:
        rim = self.radius * np.hypot(direction[0], direction[1]) - 0.25 * self.height * direction[2]
        return float(max(rim, 0.75 * self.height * direction[2]))

    def surface(self) -> Surface:
        return _CONE


class _ConeSurface(Surface):
    """The side alone: a finger that opposes another one below would stand in the table."""

    kind = "cone"

    def size(self, shape: Cone) -> FloatArray:
        return np.array([shape.radius, shape.height, 0.0])

    def patches(self, shape: Cone) -> tuple[Patch, ...]:
        reach, half = 2 * shape.radius, shape.height / 2
        low, high = -half / 2 + edge_margin(half), 1.5 * half - 4 * edge_margin(half)
        lower, upper = np.array([-reach, -reach, low]), np.array([reach, reach, high])
        return (Patch(name="side", code=np.zeros(3), lower=lower, upper=upper),)

    def patch_at(self, shape: Cone, point: FloatArray, normal: FloatArray) -> Patch:
        return self.patches(shape)[0]

    def outward_normal(self, size: Any, code: Any, p: Any) -> Any:
        rho, long = soft_norm(p[0], p[1]), soft_norm(size[0], size[1])
        return ca.vertcat(p[0] / rho * size[1], p[1] / rho * size[1], size[0]) / long

    def surface_error(self, size: Any, code: Any, p: Any) -> Any:
        level = 0.75 * size[1] - p[2]
        side = soft_norm(p[0], p[1]) * size[1] - level * size[0]
        return side / soft_norm(size[0], size[1])

    def clearance(self, size: Any, c: Any) -> Any:
        return self.surface_error(size, None, c)


_CONE = _ConeSurface()


@pytest.fixture
def cone() -> Iterator[type[Cone]]:
    yield register_shape(Cone)
    del SIZED_SHAPES["cone"]


def test_its_figures_are_those_of_a_mesh_of_it(cone: type[Cone]) -> None:
    shape = cone(0.04, 0.1)
    mesh = trimesh.creation.cone(0.04, 0.1, sections=512)
    mesh.apply_translation(-mesh.center_mass)
    assert shape.volume == pytest.approx(mesh.volume, rel=1e-3)
    inertia = mesh.moment_inertia / mesh.volume * 0.2
    np.testing.assert_allclose(shape.inertia(0.2), inertia, rtol=2e-3, atol=1e-9)
    points = np.random.default_rng(0).uniform(-0.12, 0.12, (300, 3))
    triangles = Mesh.from_triangles(np.array(mesh.vertices), np.array(mesh.faces), name="cone")
    exact = triangles.signed_distance(points)
    np.testing.assert_allclose(shape.signed_distance(points), exact, atol=5e-6)


def test_it_is_known_by_name_and_sizes_and_survives_plain_data(cone: type[Cone]) -> None:
    assert "cone" in object_names()
    assert parse_object("cone").shape == cone(0.035, 0.12)
    assert parse_object("cone:0.03x0.1").shape == cone(0.03, 0.1)
    data = {"kind": "cone", "radius_m": 0.03, "height_m": 0.1}
    assert shape_from_dict(data) == cone(0.03, 0.1)


def test_it_is_planned_written_and_held_like_any_other(cone: type[Cone], tmp_path: Any) -> None:
    from sim import simulate
    from sim.scene.carrier import Timeline

    plan = plan_grasp(GraspTask.create("allegro_hand", "cone", mu=0.8), seed=0)
    shape = cone(*cone.default_sizes)
    local = [plan.task.T_world_object.actInv(p) for p in plan.contacts.positions]
    assert np.abs(shape.signed_distance(np.array(local))).max() <= 5e-4
    write_plan(plan, tmp_path / "plan.json")
    assert read_plan(tmp_path / "plan.json").task.object.shape == shape
    report = simulate(plan, timeline=Timeline.quick())
    assert report.success, report.reason


def test_it_is_seen_in_a_simulation(cone: type[Cone]) -> None:
    from planner.bridge.load import HIDDEN_GROUP
    from sim.scene.build import build_scene

    away = SE3(np.eye(3), np.array([0.0, 0.0, 1.0]))
    scene = build_scene(GraspTask.create("allegro_hand", "cone"), T_world_base=away)
    model = scene.model
    of_object = np.flatnonzero(model.geom_bodyid == scene.object_body)
    seen = [g for g in of_object if model.geom_group[g] != HIDDEN_GROUP]
    assert len(seen) == 1 and not model.geom_contype[seen[0]]


@pytest.mark.parametrize(
    ("attribute", "value", "message"),
    [
        ("kind", "sphere", "is Sphere already"),
        ("kind", "mesh", "is Mesh already"),
        ("kind", "My Cone", "one word"),
        ("default_sizes", (0.1,), "one for each of radius, height"),
        ("default_sizes", (0.1, -1.0), "give a finite number > 0 in m"),
    ],
)
def test_what_cannot_be_registered_is_refused(attribute: str, value: Any, message: str) -> None:
    wrong = type("Wrong", (Cone,), {attribute: value})
    with pytest.raises(ObjectError, match=message):
        register_shape(wrong)
    assert "cone" not in SIZED_SHAPES
    assert SIZED_SHAPES["sphere"].__name__ == "Sphere"


def test_a_shape_without_patches_says_so(cone: type[Cone]) -> None:
    bare = type("Bare", (Cone,), {"surface": Shape.surface})
    with pytest.raises(ObjectError, match="no contact patches"):
        bare(0.03, 0.1).surface()
