"""Grasps on meshes: starts, the last step onto the true triangles, the verdict, regions, files."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from functools import partial
from itertools import islice, product
from pathlib import Path

import casadi as ca
import coal
import numpy as np
import pinocchio as pin
import pytest
from conftest import box_mesh
from scipy.spatial import ConvexHull

from planner.bridge import LinkGeometry
from planner.collision.mesh_distance import MeshPair
from planner.collision.pad_contact import PadContact, pad_contacts
from planner.collision.world import CollisionWorld
from planner.errors import TaskError
from planner.failure import Failure
from planner.files import read_plan, write_plan
from planner.hands.hand import Hand
from planner.kinematics import HandState
from planner.objects import GraspObject, Region, TouchRegion, parse_object, parse_region
from planner.plan import GraspPlan
from planner.search.grasp import attempts, plan_grasp
from planner.shapes import Box, Mesh, Shape, Torus
from planner.shapes.convex_pairs import DistancePair
from planner.spatial import SE3, FloatArray
from planner.synthesis.link_spheres import fill, link_spheres, span
from planner.synthesis.mesh_surface import STEEP, mesh_surface
from planner.synthesis.optimize import NEARLY, optimize_grasp
from planner.synthesis.options import SynthesisOptions
from planner.synthesis.problem import Start, build_problem
from planner.synthesis.seeds import seeder_for
from planner.synthesis.seeds.draw import Seeder
from planner.synthesis.seeds.mesh import FACING, MeshSeeder, opposed_pairs
from planner.synthesis.seeds.opposition import measure_postures, opposition
from planner.synthesis.terms.clearance import PRESSED
from planner.synthesis.terms.registry import TERMS
from planner.synthesis.terms.resistance import least_resisted
from planner.synthesis.terms.standard import EDGE
from planner.task import GraspTask
from planner.tolerances import EDGE_RADIUS, EDGE_SPREAD, TOUCH_TOL
from planner.verification import GAP_TOL, edge_failures, project_onto_surface, verify_geometry


@pytest.fixture(scope="module")
def torus_plan(allegro: Hand) -> GraspPlan:
    return plan_grasp(GraspTask.create(allegro, "torus"), seed=0)


def test_opposed_pairs_of_a_box_are_its_faces() -> None:
    size = np.array([0.05, 0.06, 0.08])
    pairs = opposed_pairs(box_mesh(size, 3))
    axis = np.abs(pairs.directions).argmax(axis=1)
    assert set(axis.tolist()) == {0, 1, 2}
    assert (np.abs(pairs.directions).max(axis=1) > FACING).all()
    # the smooth field is a little inside at edges: widths and middles are those of the faces
    np.testing.assert_allclose(pairs.widths, size[axis], atol=2e-3)
    middle = pairs.centers[np.arange(len(axis)), axis]
    np.testing.assert_allclose(middle, 0.0, atol=2e-3)


def test_opposed_pairs_of_a_torus_go_through_its_tube() -> None:
    torus = Torus(0.04, 0.012)
    pairs = opposed_pairs(torus)
    through = np.isclose(pairs.widths, 0.024, atol=3e-3)
    assert through.mean() > 0.8
    # the middle of a line through the tube is near the ring
    ring = np.linalg.norm(pairs.centers[through, :2], axis=1)
    np.testing.assert_allclose(ring, 0.04, atol=6e-3)


def test_opposed_pairs_of_a_mug_cross_its_wall_and_its_hollow() -> None:
    mug = parse_object("mug").shape
    assert isinstance(mug, Mesh)
    pairs = opposed_pairs(mug)
    outer, wall = 0.080, 0.004  # diameter and wall of the default mug, m
    along = np.abs(pairs.directions[:, 2]) < 0.1
    assert (np.abs(pairs.widths[along] - wall) < 0.001).sum() > 50
    across = along & (np.abs(pairs.widths - outer) < 0.002)
    assert across.sum() > 50
    # those that cross the hollow end on the outer wall, most of them straight across the axis
    middles = pairs.centers[across, :2]
    axis = np.median(middles, axis=0)
    half = (pairs.widths[:, None] / 2 * pairs.directions)[across, :2]
    for ends in (middles + half, middles - half):
        np.testing.assert_allclose(np.linalg.norm(ends - axis, axis=1), outer / 2, atol=1.1e-3)
    assert np.quantile(np.linalg.norm(middles - axis, axis=1), 0.8) < 4e-3


def test_starts_on_a_mesh_are_drawn_from_pairs(allegro: Hand) -> None:
    task = GraspTask.create(allegro, "torus")
    seeder = seeder_for(task)
    assert isinstance(seeder, MeshSeeder)
    assert type(seeder_for(GraspTask.create(allegro, "box"))) is Seeder
    start = seeder.draw(np.random.default_rng(0))
    again = seeder_for(task).draw(np.random.default_rng(0))
    assert not isinstance(start, Failure)
    assert not isinstance(again, Failure)
    np.testing.assert_array_equal(start.q, again.q)
    np.testing.assert_allclose(task.object.shape.signed_distance(start.points), 0, atol=1e-9)


def test_postures_leave_about_the_gap_that_is_asked_and_know_where_links_are(
    allegro: Hand,
) -> None:
    task = GraspTask.create(allegro, "torus")
    seeder = seeder_for(task)
    balls = link_spheres(allegro)
    widest = float(seeder.gaps.max())
    rng = np.random.default_rng(1)
    drawn = [seeder.posture + rng.normal(0, 0.03, allegro.nq) for _ in range(40)]
    opposed = partial(opposition, task)
    postures = measure_postures(allegro, task.fingers, balls, drawn, opposed)
    assert (np.diff(postures.gaps) >= 0.0).all()
    for gap in np.linspace(postures.gaps[0], postures.gaps[-1], 5):
        k = postures.draw(float(gap), rng)
        assert abs(np.searchsorted(postures.gaps, gap) - k) <= 8
        state = HandState(allegro, postures.q[k])
        assert opposition(task, postures.q[k]).gap == pytest.approx(postures.gaps[k])
        for i, ball in enumerate(balls):
            at = state.joint_pose(ball.joint_id).act(ball.center)
            np.testing.assert_allclose(postures.spheres[k, i], at, atol=1e-12)
        for i, finger in enumerate(task.fingers):
            np.testing.assert_allclose(postures.pads[k, i], state.pad_center(finger), atol=1e-12)
    assert postures.draw(widest + 1.0, rng) >= 32
    assert postures.draw(-1.0, rng) < 8


@pytest.mark.slow
def test_starts_of_which_one_is_chosen_resist_more(
    allegro: Hand, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Contacts under the pads of 24 starts, with and without a look at what they would resist."""
    task = GraspTask.create(allegro, "superquadric")

    def resisted() -> float:
        values = []
        for k in range(24):
            start = seeder_for(task).draw(np.random.default_rng([8, k]))
            assert isinstance(start, Start)
            points, outward = task.object.shape.closest_point(start.points)
            length = task.object.shape.bounding_radius
            values.append(least_resisted(points[None], outward[None], mu=task.mu, length=length))
        return float(np.median(values))

    chosen = resisted()
    monkeypatch.setattr("planner.synthesis.seeds.mesh.RESISTANCE_WORTH", 0.0)
    assert chosen > resisted() + 0.02


def test_an_object_that_is_too_wide_everywhere_is_refused(allegro: Hand) -> None:
    wide = GraspObject(name="slab", shape=box_mesh((0.5, 0.5, 0.4), 3))
    with pytest.raises(TaskError, match="finds nowhere to close on slab"):
        seeder_for(GraspTask.create(allegro, wide))


def test_a_plan_touches_the_true_triangles_and_nothing_else(torus_plan: GraspPlan) -> None:
    shape = torus_plan.task.object.shape
    points = torus_plan.contacts_in_object.positions
    np.testing.assert_allclose(shape.signed_distance(points), 0.0, atol=TOUCH_TOL)
    assert np.abs(torus_plan.verification.pad_gaps).max() <= GAP_TOL + 1e-6
    assert all(c.distance > -5e-6 for c in torus_plan.verification.closest)
    assert torus_plan.quality.closure.closed


def test_settling_undoes_a_small_error_and_leaves_a_large_one(torus_plan: GraspPlan) -> None:
    task, base, q = torus_plan.task, torus_plan.T_world_base, torus_plan.q
    index = [int(f.q_index[2]) for f in task.fingers]
    off = q.copy()
    off[index] += 0.02
    gaps = [abs(t.sphere_gap) for t in pad_contacts(task, base, off)]
    assert max(gaps) > 5e-4
    settled = project_onto_surface(task, base, off)
    assert max(abs(t.sphere_gap) for t in pad_contacts(task, base, settled)) <= GAP_TOL
    far = q.copy()
    far[index] -= 0.3
    np.testing.assert_array_equal(project_onto_surface(task, base, far), far)


def test_a_plan_on_a_mesh_survives_its_file(torus_plan: GraspPlan, tmp_path: Path) -> None:
    write_plan(torus_plan, tmp_path / "plan.json")
    back = read_plan(tmp_path / "plan.json")
    assert isinstance(back.task.object.shape, Torus)
    np.testing.assert_array_equal(back.q, torus_plan.q)


def test_the_verdict_names_contacts_where_none_may_be(torus_plan: GraspPlan) -> None:
    task = torus_plan.task
    first = torus_plan.contacts_in_object.positions[0]
    around = Region(name="spot", lower=tuple(first - 0.004), upper=tuple(first + 0.004))
    for touch, faults in (
        (TouchRegion(forbidden=(around,)), 1),
        (TouchRegion(allowed=(around,)), len(task.fingers) - 1),
        (TouchRegion(required={task.finger_names[0]: around}), 0),
        (TouchRegion(required={task.finger_names[1]: around}), 1),
    ):
        asked = replace(task, object=replace(task.object, touch=touch))
        world = CollisionWorld(asked)
        found = verify_geometry(world, torus_plan.T_world_base, torus_plan.q).failures
        assert sum(f.kind == "region" for f in found) == faults


@pytest.mark.parametrize("item", ["box", "torus"])
def test_a_region_is_kept_and_stored(allegro: Hand, item: str, tmp_path: Path) -> None:
    region = parse_region("x>-0.02" if item == "torus" else "z>0.01")
    asked = parse_object(item, touch=TouchRegion(allowed=(region,)))
    plan = plan_grasp(GraspTask.create(allegro, asked), seed=1)
    assert region.contains(plan.contacts_in_object.positions).all()
    write_plan(plan, tmp_path / "plan.json")
    stored = read_plan(tmp_path / "plan.json").task.object.touch
    assert stored == asked.touch


LINKS: dict[str, tuple[object, Shape]] = {
    "box": (coal.Box(0.02, 0.02, 0.02), Box((0.02, 0.02, 0.02))),
    "capsule": (coal.Capsule(0.01, 0.03), Box((0.02, 0.02, 0.05))),
    "sphere": (coal.Sphere(0.01), Box((0.02, 0.02, 0.02))),
}


@pytest.mark.parametrize("link", LINKS)
@pytest.mark.parametrize("seed", range(3))
def test_mesh_distances_are_those_of_the_same_box(link: str, seed: int) -> None:
    size = (0.05, 0.06, 0.08)
    geometry = LINKS[link][0]
    mesh, exact = MeshPair(geometry, box_mesh(size, 3)), DistancePair(geometry, coal.Box(*size))
    rng = np.random.default_rng(seed)
    for _ in range(50):
        pose = SE3(pin.exp3(rng.normal(size=3)), rng.normal(0, 0.05, 3))
        there = SE3(pin.exp3(rng.normal(size=3)), rng.normal(0, 0.02, 3))
        told, true = mesh.distance(pose, there), exact.distance(pose, there)
        assert (told > 0) == (true > 0)
        if true > 0:
            assert told == pytest.approx(true, abs=2e-6)
            found = mesh.query(pose, there)
            np.testing.assert_allclose(
                found.point_b - found.point_a, told * found.normal, atol=1e-5
            )


@pytest.mark.parametrize("link", LINKS)
def test_a_link_wholly_inside_a_mesh_is_inside(link: str) -> None:
    """Apart from every triangle, and in the middle of the solid: coal alone calls it apart."""
    mesh = box_mesh((0.2, 0.2, 0.2), 3)
    geometry = LINKS[link][0]
    alone = coal.DistanceResult()
    here = coal.Transform3s()
    if link != "sphere":
        request = coal.DistanceRequest()
        assert coal.distance(geometry, here, mesh.coal_geometry(), here, request, alone) > 0.05
    assert MeshPair(geometry, mesh).distance(SE3.Identity(), SE3.Identity()) < -0.05


def hull_geometry(points: FloatArray) -> LinkGeometry:
    vertices = coal.StdVec_Vec3s()
    vertices.extend(list(points))
    return LinkGeometry(
        name="hull",
        body="link",
        joint_id=1,
        T_joint_geometry=SE3.Identity(),
        geometry=coal.Convex.convexHull(vertices, True, "Qt"),
        kind="mesh",
        size=np.zeros(3),
    )


@pytest.mark.parametrize("seed", range(4))
def test_balls_of_a_hull_are_inside_it_and_its_span_is_its_corners(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(40, 3)) * [0.01, 0.015, 0.04] + rng.normal(0, 0.05, 3)
    geometry, hull = hull_geometry(points), ConvexHull(points)
    centers, radii = fill(geometry)
    depth = -(centers @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1)
    np.testing.assert_allclose(radii, depth, atol=1e-9)
    assert radii.max() > 0.004
    corners, radius = span(geometry)
    assert radius == 0
    known = {tuple(np.round(p, 9)) for p in points[hull.vertices]}
    assert {tuple(np.round(p, 9)) for p in corners} <= known


X = np.array([1.0, 0.0, 0.0])


def test_a_contact_on_an_edge_of_a_mesh_is_named(allegro: Hand) -> None:
    item = GraspObject(name="brick", shape=box_mesh((0.05, 0.06, 0.08), 3))
    task = GraspTask.create(allegro, item, fingers=["thumb", "index", "middle"])

    def fault(last: list[float]) -> str:
        points = np.array([[0.025, 0.0, 0.0], [-0.025, 0.01, 0.0], last])
        touches = [
            PadContact(
                sphere_gap=0.0, gap=0.0, round=True, point=p, outward=np.sign(p) * X, angle=0.0
            )
            for p in points
        ]
        return "; ".join(map(str, edge_failures(task, touches)))

    assert fault([-0.025, -0.01, 0.0]) == ""
    assert fault([-0.025, -0.03, 0.0]).startswith("middle is on an edge")


@pytest.mark.slow
def test_contacts_leave_edges_while_they_move(
    allegro: Hand, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Three fingers on an L-bracket, whose faces are hardly wider than they stand apart."""
    task = GraspTask.create(allegro, "lbracket", fingers=["thumb", "middle", "ring"])
    seeder, shape = seeder_for(task), task.object.shape
    assert isinstance(shape, Mesh)
    starts = [seeder.draw(np.random.default_rng([0, k])) for k in range(8)]

    def on_edges() -> int:
        problem = build_problem(allegro, task.fingers, shape)
        options, count = SynthesisOptions(), 0
        for start in starts:
            assert isinstance(start, Start)
            parameters = problem.parameters(task, start, seeder.posture, options)
            end = optimize_grasp(problem, task, start, parameters, options)
            slopes = np.linalg.norm(shape.field().taylor(end.points, 1)[:, 1:4], axis=1)
            count += int((slopes < STEEP - 0.03).sum())
        return count

    leaving = on_edges()
    monkeypatch.setitem(TERMS, "edge", replace(EDGE, weight=0.0))
    assert leaving < 0.5 * on_edges()


# small solids that are mostly edges

BLOCKS = ((0, 0, 0), (1, 0, 0), (2, 0, 0), (1, 1, 0), (1, 0, 1))
"""Cubes of a solid with outer and inner edges all over."""


def blocks_mesh(cells: Collection[tuple[int, ...]], size: float) -> Mesh:
    """A solid of cubes that touch by whole faces."""
    squares = []
    for cell, axis, side in product(cells, range(3), (0, 1)):
        step = 2 * side - 1
        if tuple(c + step * (k == axis) for k, c in enumerate(cell)) in cells:
            continue
        corners = np.tile(np.array(cell), (4, 1))
        corners[:, axis] += side
        corners[:, (axis + 1) % 3] += [0, 1, 1, 0]
        corners[:, (axis + 2) % 3] += [0, 0, 1, 1]
        squares.append(corners[::step])
    points, number = np.unique(np.concatenate(squares), axis=0, return_inverse=True)
    number = number.reshape(-1, 4)
    faces = np.vstack([number[:, [0, 1, 2]], number[:, [0, 2, 3]]])
    return Mesh.from_triangles(size * points.astype(float), faces)


@pytest.fixture(scope="module")
def blocks(allegro: Hand) -> GraspTask:
    item = GraspObject(name="blocks", shape=blocks_mesh(BLOCKS, 0.02))
    return GraspTask.create(allegro, item)


@pytest.mark.slow
def test_a_small_solid_of_edges_is_grasped(blocks: GraspTask) -> None:
    made = list(islice(attempts(blocks, seed=0), 20))
    assert sum(a.plan is not None for a in made) >= 10
    on_edges = sum(a.failure is not None and a.failure.kind == "edge" for a in made)
    assert on_edges <= 2


def test_a_contact_gains_no_flatness_by_leaving_the_surface(blocks: GraspTask) -> None:
    shape = blocks.object.shape
    assert isinstance(shape, Mesh)
    surface, p = mesh_surface(), ca.SX.sym("p", 3)
    size = surface.size(shape)
    flat = surface.flatness(size, p)
    slope = ca.Function("slope", [p, surface.field.symbols], [ca.gradient(flat, p)])
    points, _ = shape.surface_samples(400, np.random.default_rng(0))
    found = 0
    for _ in range(4):  # onto the smooth surface
        value, gradient = np.split(shape.field().taylor(points, 1), [1], axis=1)
        points = points - value * gradient / np.square(gradient).sum(axis=1, keepdims=True)
    normals = gradient / np.linalg.norm(gradient, axis=1, keepdims=True)
    for point, normal in zip(points, normals, strict=True):
        known = surface.field.coefficients(shape.field(), point[None])
        along = np.array(slope(point, known)).ravel()
        if np.linalg.norm(along) > 20.0:  # 2 % per mm: near an edge
            found += 1
            assert abs(along @ normal) < 0.02 * np.linalg.norm(along)
    assert found > 50


@pytest.mark.slow
def test_a_pad_in_a_corner_stands_in_neither_face(blocks: GraspTask) -> None:
    seeder, shape = seeder_for(blocks), blocks.object.shape
    problem = build_problem(blocks.hand, blocks.fingers, shape)
    options, solved = SynthesisOptions(rounds=0), 0
    radii = np.array([f.pad.radius for f in blocks.fingers])
    for k in range(40):
        start = seeder.draw(np.random.default_rng([3, k]))
        assert isinstance(start, Start)
        parameters = problem.parameters(blocks, start, seeder.posture, options)
        end = optimize_grasp(problem, blocks, start, parameters, options)
        if problem.worst_violation(end.violation)[1] > NEARLY:
            continue
        solved += 1
        _, centers = HandState(blocks.hand, end.q).pads(blocks.fingers)
        base = end.T_object_base
        apart = shape.signed_distance(centers @ base.rotation.T + base.translation)
        assert (apart > radii - PRESSED - 0.001).all()
    assert solved > 20


def test_pads_start_off_edges_facing_the_surface(blocks: GraspTask) -> None:
    seeder, shape = seeder_for(blocks), blocks.object.shape
    askew = []
    for k in range(20):
        start = seeder.draw(np.random.default_rng(k))
        assert isinstance(start, Start)
        normals = shape.closest_point(start.points)[1]
        assert (
            shape.normal_dispersion(start.points, EDGE_RADIUS, facing=normals) < EDGE_SPREAD
        ).all()
        state = HandState(blocks.hand, start.q)
        axes = np.array([start.T_object_base.rotation @ state.pad_axis(f) for f in blocks.fingers])
        rims = np.cos([f.pad.half_angle for f in blocks.fingers])
        askew.append(rims + (axes * normals).sum(axis=1) > 0.0)
    assert np.mean(askew) < 0.2


def test_blocks_of_15_mm_are_grasped_by_small_fingertips() -> None:
    item = GraspObject(name="small", shape=blocks_mesh(BLOCKS, 0.015))
    made = islice(attempts(GraspTask.create("shadow_hand", item), seed=0), 30)
    assert sum(a.plan is not None for a in made) >= 10
