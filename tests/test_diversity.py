"""Diversity and thinning: known answers, and what must not make a difference."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from planner.batch import GraspFeatures, diversity, thin
from planner.batch.diversity import (
    CONTACT_TOL,
    FINEST,
    FLEXION_TOL,
    N_CELLS,
    POSITION_TOL,
    ROTATION_TOL,
    SURFACE_POINTS,
    TOUCHED,
    cell_of,
    distances,
    posture_entropy,
)
from planner.errors import TaskError
from planner.hands.hand import Hand
from planner.objects import parse_object
from planner.search.grasp import plan_grasp
from planner.shapes import Box, Sphere
from planner.shapes.mesh import surface_points, surface_triangles
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask

SPHERE = Sphere(radius=0.035)


def sphere_lattice(n: int) -> FloatArray:
    """Directions (n, 3) spread evenly: a Fibonacci lattice."""
    i = np.arange(n) + 0.5
    z, turn = 1 - 2 * i / n, np.pi * (1 + 5**0.5) * i
    r = np.sqrt(1 - z * z)
    return np.column_stack([r * np.cos(turn), r * np.sin(turn), z])


def random_grasps(n: int, seed: int = 0, spread: float = 1.0) -> GraspFeatures:
    """Grasps without meaning, near enough to each other that some are alike."""
    rng = np.random.default_rng(seed)
    rotations = Rotation.from_rotvec(0.1 * spread * rng.normal(size=(n, 3))).as_matrix()
    return GraspFeatures(
        positions=0.01 * spread * rng.normal(size=(n, 3)),
        rotations=rotations,
        approach=rotations @ np.array([1.0, 0.0, 0.0]),
        contacts=0.004 * spread * rng.normal(size=(n, 4, 3)),
        q=0.1 * spread * rng.normal(size=(n, 5)),
    )


def shifted(grasps: GraspFeatures, **parts: Any) -> GraspFeatures:
    """Two grasps: the first of some, and it with some of its arrays changed."""
    second = replace(grasps[:1], **{k: v[None] for k, v in parts.items()})
    return GraspFeatures(
        **{
            k: np.concatenate([getattr(grasps[:1], k), getattr(second, k)])
            for k in GraspFeatures.__dataclass_fields__
        }
    )


def turned(grasps: GraspFeatures, rotation: FloatArray) -> GraspFeatures:
    """The same grasps seen from a turned frame."""
    return replace(
        grasps,
        positions=grasps.positions @ rotation.T,
        rotations=rotation @ grasps.rotations,
        approach=grasps.approach @ rotation.T,
        contacts=grasps.contacts @ rotation.T,
    )


def test_cells_are_of_equal_area() -> None:
    counts = np.bincount(cell_of(sphere_lattice(1000 * N_CELLS)), minlength=N_CELLS)
    assert len(counts) == N_CELLS == 192
    assert counts.min() > 970
    assert counts.max() < 1030


def test_cells_are_compact() -> None:
    directions = sphere_lattice(200 * N_CELLS)
    cells = cell_of(directions)
    for cell in range(N_CELLS):
        members = directions[cells == cell]
        center = members.mean(axis=0) / np.linalg.norm(members.mean(axis=0))
        # a disc of this area has a radius of 8.3 degrees
        assert np.degrees(np.arccos(members @ center)).max() < 14


def test_poles_and_seams_have_cells() -> None:
    assert cell_of(np.array([[0, 0, 1.0], [0, 0, -1.0]])).tolist() == [0, N_CELLS - 4]
    seam = cell_of(np.array([[-1.0, 1e-300, 0.1], [-1.0, -1e-300, 0.1], [1.0, -1e-17, 0.0]]))
    assert ((seam >= 0) & (seam < N_CELLS)).all()


def test_direction_length_makes_no_difference() -> None:
    directions = sphere_lattice(500)
    assert (cell_of(directions) == cell_of(7.0 * directions)).all()


def test_posture_entropy_of_known_distributions() -> None:
    rng = np.random.default_rng(1)
    even = posture_entropy(rng.uniform(0, 2.0, size=(6000, 2)))
    assert even == pytest.approx(2 * math.log(2.0), abs=0.06)
    # few enough in one dimension to be farther apart than the finest distance
    normal = posture_entropy(rng.normal(0, 3.0, size=(4000, 1)))
    assert normal == pytest.approx(0.5 * math.log(2 * math.pi * math.e * 9.0), abs=0.05)


def test_posture_entropy_scales_with_the_joints() -> None:
    q = np.random.default_rng(2).normal(size=(200, 4))
    first, second = posture_entropy(q), posture_entropy(3 * q)
    assert first is not None
    assert second == pytest.approx(first + 4 * math.log(3))


def test_equal_postures_have_a_finite_entropy_and_too_few_none() -> None:
    same = posture_entropy(np.ones((100, 2)))
    assert same is not None
    other = posture_entropy(np.ones((100, 2)) + FINEST / 10 * np.eye(100, 2))
    assert same == other
    assert posture_entropy(np.ones((3, 2))) is None


def test_near_duplicates_are_within_every_tolerance() -> None:
    one = random_grasps(1)
    by = 0.99
    turn = Rotation.from_rotvec([0, by * ROTATION_TOL, 0]).as_matrix()
    alike = [
        shifted(one, positions=one.positions[0] + [0, by * POSITION_TOL, 0]),
        shifted(one, rotations=turn @ one.rotations[0]),
        shifted(one, contacts=one.contacts[0] + by * CONTACT_TOL * np.eye(4, 3)),
        shifted(one, q=one.q[0] + by * FLEXION_TOL),
    ]
    for pair in alike:
        assert thin(pair).tolist() in ([0], [1])
        assert distances(pair, 0, np.array([1]))[0] == pytest.approx(by, rel=1e-6)


def test_beyond_any_tolerance_grasps_are_different() -> None:
    one = random_grasps(1)
    by = 1.01
    turn = Rotation.from_rotvec([0, 0, by * ROTATION_TOL]).as_matrix()
    far_contact = one.contacts[0].copy()
    far_contact[2, 1] += by * CONTACT_TOL
    different = [
        shifted(one, positions=one.positions[0] + [by * POSITION_TOL, 0, 0]),
        shifted(one, rotations=one.rotations[0] @ turn),
        shifted(one, contacts=far_contact),
        shifted(one, q=one.q[0] + np.array([0, 0, 0, 0, by * FLEXION_TOL])),
    ]
    for pair in different:
        assert thin(pair).tolist() == [0, 1]


def test_the_worthiest_of_near_duplicates_stays() -> None:
    one = random_grasps(1)
    three = one[[0, 0, 0]]
    assert thin(three, worth=np.array([0.1, 0.3, 0.2])).tolist() == [1]


def test_worth_is_checked() -> None:
    with pytest.raises(TaskError, match="give 3 numbers"):
        thin(random_grasps(3), worth=np.zeros(2))
    with pytest.raises(TaskError, match="NaN"):
        thin(random_grasps(3), worth=np.array([0, np.nan, 0]))


def test_nothing_is_thinned_to_nothing() -> None:
    empty = random_grasps(3)[np.zeros(0, dtype=int)]
    assert len(thin(empty)) == 0
    measured = diversity(empty, SPHERE)
    assert (measured.n, measured.n_distinct, measured.approach_share) == (0, 0, 0.0)


def test_features_of_wrong_shape_are_refused() -> None:
    one = random_grasps(2)
    with pytest.raises(TaskError, match=r"\(n, c, 3\)"):
        replace(one, contacts=one.contacts[:1])


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6), n=st.integers(1, 60), spread=st.floats(0.1, 3.0))
def test_thinning_stands_for_all_and_repeats_none(seed: int, n: int, spread: float) -> None:
    grasps = random_grasps(n, seed, spread)
    kept = thin(grasps)
    for i in range(n):
        nearest = distances(grasps, i, kept)
        if i in kept:
            assert (nearest[kept != i] > 1.0).all()
        else:
            assert nearest.min() <= 1.0
    assert thin(grasps[kept]).tolist() == list(range(len(kept)))


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6), n=st.integers(4, 40), data=st.data())
def test_numbering_makes_no_difference(seed: int, n: int, data: st.DataObject) -> None:
    order = np.array(data.draw(st.permutations(range(n))))
    grasps = random_grasps(n, seed)
    worth = np.random.default_rng(seed).integers(0, 3, n).astype(float)
    again = thin(grasps[order], worth=worth[order])
    assert sorted(order[again].tolist()) == thin(grasps, worth=worth).tolist()
    one, two = diversity(grasps, SPHERE).to_dict(), diversity(grasps[order], SPHERE).to_dict()
    assert one == pytest.approx(two, rel=1e-12)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6), n=st.integers(2, 40))
def test_the_measure_of_likeness_does_not_change_with_the_frame(seed: int, n: int) -> None:
    grasps = random_grasps(n, seed)
    other = turned(grasps, Rotation.random(rng=np.random.default_rng(seed)).as_matrix())
    everyone = np.arange(n)
    for i in range(min(n, 5)):
        before, after = distances(grasps, i, everyone), distances(other, i, everyone)
        assert after == pytest.approx(before, abs=1e-6)  # arccos near 1 takes half the digits


def test_a_repeated_set_is_no_more_diverse() -> None:
    grasps = random_grasps(30, 3)
    twice = grasps[np.tile(np.arange(30), 2)]
    once, again = diversity(grasps, SPHERE), diversity(twice, SPHERE)
    assert again.n == 60
    assert again.n_distinct == once.n_distinct
    assert again.approach_share == once.approach_share
    assert again.approach_entropy == pytest.approx(once.approach_entropy)
    assert again.surface_share == once.surface_share


def test_even_directions_reach_the_largest_entropy() -> None:
    directions = sphere_lattice(200 * N_CELLS)
    n = len(directions)
    zeros = np.zeros((n, 3))
    grasps = GraspFeatures(
        positions=zeros,
        rotations=np.tile(np.eye(3), (n, 1, 1)),
        approach=directions,
        contacts=zeros[:, None],
        q=zeros[:, :0],
    )
    measured = diversity(grasps, SPHERE)
    assert measured.approach_share == 1.0
    assert measured.approach_entropy == pytest.approx(math.log(192), abs=1e-3)
    assert measured.posture_entropy is None
    assert measured.n_distinct == 1


def test_touched_share_is_that_of_the_caps() -> None:
    # six contacts on a sphere: a chord c cuts off a cap of area pi c^2
    contacts = 0.035 * np.vstack([np.eye(3), -np.eye(3)])
    grasps = replace(random_grasps(1), contacts=contacts[None])
    share = 6 * TOUCHED**2 / (4 * 0.035**2)
    measured = diversity(grasps, SPHERE).surface_share
    assert measured == pytest.approx(share, abs=3 * math.sqrt(share / SURFACE_POINTS))
    assert diversity(replace(grasps, contacts=contacts[None] * 9), SPHERE).surface_share == 0.0


def test_surface_points_are_on_the_surface_by_area() -> None:
    box = Box(size=(0.02, 0.04, 0.08))
    points = surface_points(box, 2000)
    assert np.abs(box.signed_distance(points)).max() < 1e-9
    on_end = (np.abs(np.abs(points[:, 2]) - 0.04) < 1e-9).mean()
    assert on_end == pytest.approx(2 * 8 / (2 * (8 + 16 + 32)), abs=0.01)
    assert (surface_points(box, 2000) == points).all()


@pytest.mark.parametrize("spec", ["sphere", "box", "cylinder", "capsule", "ellipsoid", "mug"])
def test_surface_triangles_enclose_the_shape(spec: str) -> None:
    shape = parse_object(spec).shape
    vertices, faces = surface_triangles(shape)
    corners = vertices[faces]
    volume = np.linalg.det(corners).sum() / 6
    assert volume == pytest.approx(shape.volume, rel=0.01)
    centers = corners.mean(axis=1)
    assert np.abs(shape.signed_distance(centers)).max() < 2e-4


def test_where_the_world_is_makes_no_difference(allegro: Hand) -> None:
    task = GraspTask.create(allegro, "sphere", table_height=None)
    plan = plan_grasp(task, seed=0)
    before = GraspFeatures.of_plans([plan])
    T = SE3(Rotation.from_rotvec([0.3, -1.2, 2.0]).as_matrix(), np.array([1.0, -2.0, 0.5]))
    moved = replace(
        plan,
        task=replace(task, T_world_object=T * task.T_world_object),
        T_world_base=T * plan.T_world_base,
        contacts=plan.contacts.transformed(T),
    )
    after = GraspFeatures.of_plans([moved])
    for name in GraspFeatures.__dataclass_fields__:
        assert getattr(after, name) == pytest.approx(getattr(before, name), abs=1e-12), name
    # the palm faces the object that it holds
    toward = -plan.task.hand.palm_normal @ before.rotations[0].T @ before.positions[0]
    assert toward > 0


def test_no_plans_are_refused() -> None:
    with pytest.raises(TaskError, match="at least one"):
        GraspFeatures.of_plans([])


def test_random_starts_are_spread_and_the_same_every_time(allegro: Hand) -> None:
    task = GraspTask.create(allegro, "sphere")
    starts = GraspFeatures.of_random_starts(task, 60, seed=5)
    again = GraspFeatures.of_random_starts(task, 60, seed=5)
    assert len(starts) == 60
    assert (starts.positions == again.positions).all()
    assert starts.q.shape == (60, 16)
    on_surface = np.linalg.norm(starts.contacts, axis=2)
    assert on_surface == pytest.approx(np.full((60, 4), task.object.shape.bounding_radius))
    measured = diversity(starts, task.object.shape)
    assert measured.n_distinct == 60
    assert measured.approach_share > 0.1
