"""Depths of every kind of link in every kind of object, against support functions written here.

The witness shares nothing with the code: solids are support functions h(n) = max n . x, and the
least translation that parts two convex solids is the least of h_object(n) + h_link(-n) over all
directions n. A concave object is a union of boxes, which are parted from a link if every box is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import coal
import mujoco
import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from planner.bridge.geometry import coal_geometry
from planner.collision.pair_table import shape_pair
from planner.hands.hand import Hand
from planner.kinematics import MovingHand
from planner.search.grasp import plan_grasp
from planner.shapes import Box, Capsule, Cylinder, Ellipsoid, Mesh, Shape, Sphere
from planner.shapes.hulls import convex_geometry
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask

Support = Callable[[FloatArray], FloatArray]
"""Largest coordinates (n,), m, of a solid along unit directions (n, 3)."""

DEPTHS = (1e-5, 2e-5, 1e-4, 2e-4, 5e-4, 1e-3, 1.5e-3, 2e-3, 3e-3, 4e-3)
"""m, along a direction; the least translation may be a little less."""

SIX = (*DEPTHS[::2], DEPTHS[-1])
"""Those of them that many pairs of solids are tried at."""

ACCURATE = 5e-6
"""How far (m) depths may be from the least translation: coal's accuracy in penetration."""


LONG = 0.02
"""Share by which a depth in a mesh may be more than the least translation: directions are tried by
descent, which may end beside the least one. In 720 other poses on the convex meshes below it was
0.4 % at most where it was more than 5 um; the box in ``mesh-box`` has shown 0.9 % at 4 mm. In 1440
others, 0.5 to 4 mm deep in the plates of the L, it was below 2 % of the depth out of the plate."""


def of_points(points: FloatArray) -> Support:
    return lambda n: (n @ points.T).max(axis=1)


def of_ellipsoid(half: FloatArray) -> Support:
    return lambda n: np.linalg.norm(n * half, axis=1)


def of_cylinder(radius: float, half: float) -> Support:
    return lambda n: radius * np.hypot(n[:, 0], n[:, 1]) + half * np.abs(n[:, 2])


def of_capsule(radius: float, half: float) -> Support:
    return lambda n: radius + half * np.abs(n[:, 2])


def of_box(half: FloatArray) -> Support:
    return lambda n: np.abs(n) @ half


def placed(support: Support, pose: SE3) -> Support:
    return lambda n: support(n @ pose.rotation) + n @ pose.translation


def points_of_hull(seed: int, size: float) -> FloatArray:
    points = np.random.default_rng(seed).normal(size=(40, 3))
    points *= size / np.linalg.norm(points, axis=1, keepdims=True)
    return np.asarray(points * [1.0, 0.7, 1.4])


def of_mesh_file(points: FloatArray) -> Any:
    """The geometry of a MuJoCo mesh geom, as a hand has it, about its own centre."""
    vertices = " ".join(f"{v:.9g}" for v in points.ravel())
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><asset><mesh name="m" vertex="{vertices}"/></asset><worldbody><body>'
        '<geom type="mesh" mesh="m"/></body></worldbody></mujoco>'
    )
    return coal_geometry(model, 0)


def links() -> dict[str, tuple[Any, Support]]:
    hull = coal.StdVec_Vec3s()
    hull.extend(list(points_of_hull(1, 0.009)))
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.0065).vertices
    mesh = of_mesh_file(np.array(ball) * [1.0, 1.0, 1.5])
    return {
        "sphere": (coal.Sphere(0.008), of_ellipsoid(np.full(3, 0.008))),
        "capsule": (coal.Capsule(0.007, 0.02), of_capsule(0.007, 0.01)),
        "box": (coal.Box(0.012, 0.016, 0.04), of_box(np.array([0.006, 0.008, 0.02]))),
        "cylinder": (coal.Cylinder(0.007, 0.03), of_cylinder(0.007, 0.015)),
        "hull": (coal.Convex.convexHull(hull, True, "Qt"), of_points(points_of_hull(1, 0.009))),
        "mesh": (mesh, of_points(np.array(mesh.points()))),
    }


OUTLINE = np.array([[-40, -4], [40, -4], [40, 4], [-32, 4], [-32, 56], [-40, 56.0]]) * 1e-3
"""Of an L, x and z, m."""

WIDTH = 0.04
"""Of its plates, along y, m."""


def l_bracket() -> tuple[Mesh, list[Support]]:
    """An L as one solid, and the two boxes that together are it."""
    front, back = (np.insert(OUTLINE, 1, y, axis=1) for y in (-WIDTH / 2, WIDTH / 2))
    side = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 5], [3, 4, 5]])
    rim = [[k, k + 6, (k + 1) % 6] for k in range(6)]
    rim += [[(k + 1) % 6, k + 6, (k + 1) % 6 + 6] for k in range(6)]
    faces = np.concatenate([side, side[:, ::-1] + 6, rim])
    mesh = Mesh.from_triangles(np.concatenate([front, back]), faces, repair=True)
    lower, upper = np.array([-0.04, -0.02, -0.004]), np.array([0.04, 0.02, 0.004])
    low, high = (lower, upper), (lower, np.array([-0.032, 0.02, 0.056]))
    return mesh, [
        placed(of_box((b - a) / 2), SE3(np.eye(3), (a + b) / 2 - mesh.offset))
        for a, b in (low, high)
    ]


def convex_objects() -> dict[str, tuple[Shape, Support]]:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.035)
    stretched = Mesh(np.array(ball.vertices) * [1.0, 0.8, 1.3], np.array(ball.faces))
    cuboid = trimesh.creation.box((0.05, 0.06, 0.08))
    return {
        "sphere": (Sphere(0.035), of_ellipsoid(np.full(3, 0.035))),
        "box": (Box((0.05, 0.06, 0.08)), of_box(np.array([0.025, 0.03, 0.04]))),
        "cylinder": (Cylinder(0.03, 0.09), of_cylinder(0.03, 0.045)),
        "capsule": (Capsule(0.025, 0.12), of_capsule(0.025, 0.035)),
        "ellipsoid": (
            Ellipsoid((0.05, 0.06, 0.09)),
            of_ellipsoid(np.array([0.025, 0.03, 0.045])),
        ),
        "mesh-round": (stretched, of_points(stretched.vertices)),
        "mesh-box": (
            Mesh(np.array(cuboid.vertices), np.array(cuboid.faces)),
            of_box(np.array([0.025, 0.03, 0.04])),
        ),
    }


def sphere_of(count: int) -> FloatArray:
    """Unit vectors (count, 3), evenly spread."""
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, k * np.pi * (3 - np.sqrt(5))
    rim = np.sqrt(1 - z * z)
    return np.column_stack([rim * np.cos(turn), rim * np.sin(turn), z])


def least(value: Support, starts: FloatArray) -> tuple[float, FloatArray]:
    """The least value over all directions: the best of many, then of ever nearer neighbours."""
    rng = np.random.default_rng(0)
    best, radius = starts, 0.1
    while True:
        values = value(best)
        order = np.argsort(values)[:KEPT]
        best = best[order]
        if radius < 1e-6:
            return float(values[order[0]]), best[0]
        near = np.repeat(best, TRIED, axis=0)
        near += radius * rng.normal(size=near.shape)
        near /= np.linalg.norm(near, axis=1, keepdims=True)
        best = np.concatenate([best, near])
        radius *= SHRUNK


KEPT, TRIED, SHRUNK = 16, 12, 0.6
"""Directions kept of those tried around each, and how much nearer the next ones are."""


def overlap(first: Support, second: Support) -> Support:
    """How far the second must move along a direction until a plane across it parts the two."""
    return lambda n: first(n) + second(-n)


def pose_at(
    depth: float, other: Support, link: Support, along: FloatArray, turn: FloatArray
) -> SE3:
    """The pose of a turned link at which it must go back by a depth (m) along a direction.

    That direction leads away from the middle of the other.
    """
    middle = np.array([other(n[None])[0] - other(-n[None])[0] for n in np.eye(3)]) / 2
    rooms = overlap(other, placed(link, SE3(turn, middle)))

    def way(n: FloatArray) -> FloatArray:
        slope = n @ along
        return np.where(slope > 1e-3, rooms(n) / np.maximum(slope, 1e-3), np.inf)

    return SE3(turn, middle + (least(way, STARTS)[0] - depth) * along)


def somehow(rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """A direction (3,) and a rotation (3, 3)."""
    along = rng.normal(size=3)
    return along / np.linalg.norm(along), Rotation.random(random_state=rng).as_matrix()


def edges_of(points: FloatArray) -> FloatArray:
    """Edges (k, 3) of the convex hull of points."""
    hull = ConvexHull(points)
    triangles = points[hull.simplices]
    return np.concatenate([triangles[:, k] - triangles[:, k - 1] for k in range(3)])


def edge_axes(first: FloatArray, second: FloatArray) -> FloatArray:
    """Directions (n, 3) across an edge of each of two polyhedra: axes that may part them."""
    if len(first) * len(second) > MOST_AXES:  # round, or nearly: a fine sphere of directions does
        return np.zeros((0, 3))
    axes = np.cross(first[:, None], second[None]).reshape(-1, 3)
    length = np.linalg.norm(axes, axis=1)
    axes = axes[length > 1e-12] / length[length > 1e-12, None]
    return np.concatenate([axes, -axes])


MOST_AXES = 20_000
"""Pairs of edges up to which all are tried."""

LINKS, CONVEX = links(), convex_objects()
NO_EDGES: FloatArray = np.zeros((0, 3))
EDGES = dict.fromkeys([*LINKS, *CONVEX], NO_EDGES) | {
    "hull": edges_of(points_of_hull(1, 0.009)),
    "mesh": edges_of(np.array(LINKS["mesh"][0].points())),
    "box": np.eye(3),  # of both kinds: axes of the frame
    "mesh-box": np.eye(3),
}
STARTS = np.concatenate([np.eye(3), -np.eye(3), sphere_of(2500)])


@pytest.mark.parametrize("kind", CONVEX)
@pytest.mark.parametrize("link", LINKS)
def test_depths_in_convex_objects_are_the_least_translation(link: str, kind: str) -> None:
    (geometry, support), (shape, surface) = LINKS[link], CONVEX[kind]
    pair, rng = shape_pair(geometry, shape), np.random.default_rng([len(link), len(kind)])
    for depth in SIX:
        pose = pose_at(depth, surface, support, *somehow(rng))
        axes = np.concatenate([STARTS, edge_axes(EDGES[kind], EDGES[link] @ pose.rotation.T)])
        true, _ = least(overlap(surface, placed(support, pose)), axes)
        assert 0.0 < true <= 1.001 * depth
        told = -pair.distance(pose, SE3.Identity())
        assert told >= true - ACCURATE
        assert told <= (1 + LONG * isinstance(shape, Mesh)) * true + ACCURATE


def ways_out(boxes: list[Support], link: Support, normals: FloatArray) -> Support:
    """How far a link must move along directions (n, 3) until it is parted from every box.

    A box and a link share points between two lengths of a way, those at which it crosses the planes
    of all normals (k, 3); the link goes on from one such stretch to the next. As there are planes
    of some normals only, the way is a little too long.
    """
    rooms = [overlap(box, link)(normals) for box in boxes]

    def way(directions: FloatArray) -> FloatArray:
        slope = directions @ normals.T
        out = np.zeros(len(directions))
        stretches = []
        for room in rooms:
            with np.errstate(divide="ignore"):
                at = room / slope
            begin = np.where(slope < -1e-9, at, -np.inf).max(axis=1)
            end = np.where(slope > 1e-9, at, np.inf).min(axis=1)
            stretches.append((begin, np.where(end > begin, end, -np.inf)))
        for begin, end in stretches * 2:
            out = np.where((begin < out + 1e-9) & (end > out), end, out)
        return out

    return way


def check_in_boxes(
    pair: Any, pose: SE3, boxes: list[Support], link: Support, edges: FloatArray
) -> float:
    """Hold the depth of a link in a union of boxes against bounds of the least translation."""
    axes = np.concatenate([STARTS, edge_axes(np.eye(3), edges @ pose.rotation.T)])
    parted = [least(overlap(box, placed(link, pose)), axes) for box in boxes]
    normals = np.concatenate([np.eye(3), -np.eye(3), [n for _, n in parted], sphere_of(800)])
    way, _ = least(ways_out(boxes, placed(link, pose), normals), normals)
    told = -float(pair.distance(pose, SE3.Identity()))
    assert told >= max(depth for depth, _ in parted) - ACCURATE  # it must leave every box
    assert told <= (1 + LONG) * way + ACCURATE
    return told


OUT_OF_PLATES = ((0, [0, 0, -1]), (0, [0, 0.9, -1]), (0, [1, 0, 0.6]), (1, [-1, 0, 0.4]))
"""A plate of the L, and a direction to its outside."""


@pytest.mark.parametrize("link", LINKS)
def test_depths_in_the_plates_of_a_concave_mesh_are_the_least_translation(link: str) -> None:
    geometry, support = LINKS[link]
    mesh, boxes = l_bracket()
    pair, rng = shape_pair(geometry, mesh), np.random.default_rng(len(link))
    for number, depth in enumerate(DEPTHS):
        plate, out = OUT_OF_PLATES[number % len(OUT_OF_PLATES)]
        along = np.array(out) / np.linalg.norm(out)
        pose = pose_at(depth, boxes[plate], support, along, somehow(rng)[1])
        told = check_in_boxes(pair, pose, boxes, support, EDGES[link])
        assert told <= (1 + LONG) * depth + ACCURATE


@pytest.mark.parametrize(
    ("link", "turn", "place"),
    [
        ("box", [1.1182, 0.6248, 2.7254], [0.01418, 0.01734, -0.03108]),
        ("cylinder", [1.1915, 1.9463, -0.6774], [0.01418, 0.0124, -0.02559]),
    ],
)
def test_a_way_out_across_an_edge_is_found_behind_a_longer_one_across_a_face(
    link: str, turn: list[float], place: list[float]
) -> None:
    """Ways across the lower face, the next one to the link's middle, are up to 27 % longer."""
    geometry, support = LINKS[link]
    mesh, boxes = l_bracket()
    pose = SE3(Rotation.from_rotvec(turn).as_matrix(), np.array(place))
    rooms = overlap(boxes[0], placed(support, pose))
    true, _ = least(rooms, np.concatenate([STARTS, edge_axes(np.eye(3), pose.rotation.T)]))
    assert rooms(np.array([[0.0, 0.0, -1.0]]))[0] > 1.1 * true
    told = -shape_pair(geometry, mesh).distance(pose, SE3.Identity())
    assert true - ACCURATE <= told <= (1 + LONG) * true + ACCURATE


@pytest.mark.parametrize("link", LINKS)
def test_depths_in_the_corner_of_a_concave_mesh_are_those_of_both_plates(link: str) -> None:
    """A link that is in both plates from within: it leaves along their bisector, or nearly."""
    geometry, support = LINKS[link]
    mesh, boxes = l_bracket()
    pair, rng = shape_pair(geometry, mesh), np.random.default_rng(len(link))
    up, across = np.array([[0.0, 0.0, 1.0]]), np.array([[1.0, 0.0, 0.0]])
    for depth, share in zip(SIX, np.linspace(0.3, 1.0, len(SIX)), strict=True):
        turn = somehow(rng)[1]
        turned = placed(support, SE3(turn, np.zeros(3)))
        z = boxes[0](up)[0] + turned(-up)[0] - depth
        x = boxes[1](across)[0] + turned(-across)[0] - share * depth
        pose = SE3(turn, np.array([x, 0.0, z]))
        told = check_in_boxes(pair, pose, boxes, support, EDGES[link])
        assert told == pytest.approx(np.hypot(depth, share * depth), rel=LONG, abs=ACCURATE)


@pytest.mark.parametrize("subdivisions", [1, 3])
@pytest.mark.parametrize("direction", [[0.0, 0.0, 1.0], [0.3, -0.5, 0.8], [0.7, 0.1, -0.2]])
def test_a_tip_that_is_pressed_into_a_ball_is_ever_deeper(
    subdivisions: int, direction: list[float]
) -> None:
    """Triangles alone said 0.02, 0.1, 0.2, 0.02, 0.0, 0.07 and 0.4 mm of 0.02 to 3 mm."""
    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=0.035)
    points = np.array(trimesh.creation.icosphere(subdivisions=2, radius=0.0065).vertices)
    tip, mesh = of_mesh_file(points), Mesh(np.array(ball.vertices), np.array(ball.faces))
    pair, support = shape_pair(tip, mesh), of_points(np.array(tip.points()))
    along = np.array(direction) / np.linalg.norm(direction)
    last = 0.0
    for depth in np.array([0.02, 0.1, 0.2, 0.5, 1.0, 2.0, 3.0]) * 1e-3:
        pose = pose_at(depth, of_points(mesh.vertices), support, along, np.eye(3))
        told = -pair.distance(pose, SE3.Identity())
        assert 0.95 * depth - ACCURATE <= told <= depth + ACCURATE
        assert told > last
        last = told


@pytest.mark.parametrize("link", LINKS)
def test_the_way_out_of_a_mesh_leads_out(link: str) -> None:
    """Moved by the depth along the normal, a link touches; the points told then coincide."""
    geometry, support = LINKS[link]
    mesh, boxes = l_bracket()
    pair, rng = shape_pair(geometry, mesh), np.random.default_rng(3)
    T_world_mesh = SE3(somehow(rng)[1], rng.normal(0, 0.1, 3))
    for plate, out in OUT_OF_PLATES:
        along = np.array(out) / np.linalg.norm(out)
        pose = T_world_mesh * pose_at(1.3e-3, boxes[plate], support, along, somehow(rng)[1])
        found = pair.query(pose, T_world_mesh)
        assert found.distance < -1e-4
        assert found.distance == pytest.approx(pair.distance(pose, T_world_mesh), abs=1e-9)
        gap = found.point_b - found.point_a
        np.testing.assert_allclose(gap, found.distance * found.normal, atol=1e-9)
        free = SE3(pose.rotation, pose.translation + found.distance * found.normal)
        assert abs(pair.distance(free, T_world_mesh)) <= ACCURATE


@pytest.fixture(scope="module")
def allegro_with_mesh_tips(allegro: Hand) -> Hand:
    """The Allegro hand with balls of 320 triangles for fingertips."""
    pads = {f.pad.geom: f.pad.radius for f in allegro.fingers.values()}

    def tip(radius: float) -> Any:
        ball = trimesh.creation.icosphere(subdivisions=2, radius=radius)
        return convex_geometry(np.array(ball.vertices))

    return replace(
        allegro,
        geometries=tuple(
            replace(g, geometry=tip(pads[g.name]), kind="mesh") if g.name in pads else g
            for g in allegro.geometries
        ),
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["mug", "torus", "superquadric"])
def test_plans_with_mesh_tips_on_meshes_touch_and_no_more(
    allegro_with_mesh_tips: Hand, name: str
) -> None:
    """By distances of single points: corners of the tips in the object, and of it in the tips."""
    hand = allegro_with_mesh_tips
    task = GraspTask.create(hand, name)
    shape = task.object.shape
    assert isinstance(shape, Mesh)
    samples, _ = shape.surface_samples(20_000, np.random.default_rng(0))
    surface = np.concatenate([samples, shape.vertices])
    for seed in range(2):
        plan = plan_grasp(task, seed=seed)
        state = MovingHand(hand, plan.q)
        base = task.T_world_object.inverse() * plan.T_world_base
        for finger in plan.task.fingers:
            geometry = next(g for g in hand.geometries if g.name == finger.pad.geom)
            pose = base * state.joint_pose(geometry.joint_id) * geometry.T_joint_geometry
            corners = np.array(geometry.geometry.points())
            planes = ConvexHull(corners).equations
            inside = -(planes[:, :3] @ ((surface - pose.translation) @ pose.rotation).T).T
            there = -shape.signed_distance(corners @ pose.rotation.T + pose.translation)
            assert max(there.max(), (inside - planes[:, 3]).min(axis=1).max()) <= 5e-5
