"""Grasps from what cameras saw: clouds, the uncertain surface behind them, plans and refusals."""

from __future__ import annotations

import pickle
import re
from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest

from planner import GraspObject, PointCloud, plan_from_cloud
from planner.clouds.belief import CERTAIN, CORRELATED, DIFFER, LEAST_SLOPE, TOUCH, Belief
from planner.clouds.cloud import FEWEST, KEPT, _one_object, find_table, prepared
from planner.clouds.hollow import lidded
from planner.clouds.sight import _distance, _reflection, hypotheses
from planner.collision.pair_table import OBJECT
from planner.collision.world import CollisionWorld
from planner.errors import ObjectError, TaskError, UncertainError
from planner.objects import parse_object
from planner.search import from_cloud
from planner.search.from_cloud import CONE_SHARE, UNSEEN_FOOT, CloudPlan, _abstained
from planner.search.in_the_way import CLEAR, _spheres, _way_in, hidden_share, hits, things_about
from planner.search.survival import FELT, SAMPLES, TABLE_MU, _meets, _tips, survival_of
from planner.shapes import Mesh
from planner.spatial import SE3, FloatArray
from planner.synthesis.options import SynthesisOptions
from sim.cli import main
from sim.scan import scan

CAMERA = np.array([0.42, 0.05, 0.36])
BALL, RADIUS = np.array([0.0, 0.0, 0.035]), 0.035
BOX = np.array([0.05, 0.06, 0.08])
NOISE = 0.002


def on_ball(n: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Points of a ball on the table, and outward normals."""
    out = rng.normal(size=(n, 3))
    out /= np.linalg.norm(out, axis=1)[:, None]
    return BALL + RADIUS * out, out


def on_box(n: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """The same of a box that stands on the table, turned by 25 degrees."""
    areas = BOX[[1, 0, 0]] * BOX[[2, 2, 1]]
    axis, side = rng.choice(3, n, p=areas / areas.sum()), rng.choice([-1.0, 1.0], n)
    points = rng.uniform(-0.5, 0.5, (n, 3))
    normals = np.zeros((n, 3))
    points[np.arange(n), axis], normals[np.arange(n), axis] = 0.5 * side, side
    c, s = np.cos(np.deg2rad(25.0)), np.sin(np.deg2rad(25.0))
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return points * BOX @ turn.T + [0.0, 0.0, BOX[2] / 2], normals @ turn.T


SOLIDS = {"ball": on_ball, "box": on_box}


def seen_by(camera: FloatArray, points: FloatArray, normals: FloatArray) -> Any:
    """Which points of a convex surface a camera sees, rays of less than 80 degrees only."""
    ray = camera - points
    return np.einsum("nd,nd->n", ray, normals) > 0.17 * np.linalg.norm(ray, axis=1)


def table_past(camera: FloatArray, solid: str, rng: np.random.Generator) -> FloatArray:
    """Points of the table beside the solid's shadow."""
    table = np.column_stack([rng.uniform(-0.2, 0.2, (9000, 2)), np.zeros(9000)])
    points, _ = SOLIDS[solid](4000, rng)
    shadow = camera + (points - camera) * (camera[2] / (camera[2] - points[:, 2]))[:, None]
    from scipy.spatial import cKDTree

    return np.asarray(table[cKDTree(shadow).query(table)[0] > 0.004])


@cache
def scanned(solid: str, *, views: int = 1, seed: int = 0, n: int = 9000) -> PointCloud:
    """A cloud from one camera, or from two opposite ones."""
    rng = np.random.default_rng(seed)
    cameras = np.array([CAMERA, CAMERA * [-1.0, -1.0, 1.0]])[:views]
    parts, view_of = [], []
    for k, camera in enumerate(cameras):
        points, normals = SOLIDS[solid](n, rng)
        mine = np.concatenate(
            [points[seen_by(camera, points, normals)], table_past(camera, solid, rng)]
        )
        parts.append(mine + NOISE * rng.normal(size=mine.shape))
        view_of += [k] * len(mine)
    return PointCloud.create(
        np.concatenate(parts), views=cameras, view_of=view_of, noise=NOISE, table=0.0
    )


@cache
def believed(solid: str, views: int = 1) -> GraspObject:
    return GraspObject.from_points(scanned(solid, views=views))


def belief_of(item: GraspObject) -> Belief:
    assert item.belief is not None
    return item.belief


def split(solid: str, item: GraspObject) -> tuple[FloatArray, FloatArray]:
    """True surface points that were seen, and those of the back, in the object's frame."""
    points, normals = SOLIDS[solid](4000, np.random.default_rng(99))
    towards = (CAMERA - points) / np.linalg.norm(CAMERA - points, axis=1)[:, None]
    facing = np.einsum("nd,nd->n", towards, normals)
    at = points - belief_of(item).offset
    return at[facing > 0.3], at[(facing < -0.5) & (points[:, 2] > 0.01)]


@pytest.mark.parametrize("solid", SOLIDS)
def test_the_surface_is_right_where_it_was_seen(solid: str) -> None:
    item = believed(solid)
    seen, _ = split(solid, item)
    off = item.shape.signed_distance(seen)
    assert np.sqrt(np.mean(off**2)) < 0.5 * NOISE  # many points make one of the surface
    assert item.belief is not None and (item.belief.gradient(seen) ** 2).sum(axis=1).min() > 0.1


@pytest.mark.slow
def test_one_sigma_holds_two_thirds_of_the_seen_surface() -> None:
    """Of points whose errors are independent, so without what a camera's correlation adds."""
    shares = []
    for solid in SOLIDS:
        for seed in range(3):
            belief = Belief.of(scanned(solid, seed=seed))
            item = GraspObject(name=solid, shape=belief.of_hypothesis(0)[1], belief=belief)
            seen, _ = split(solid, item)
            slope = np.linalg.norm(belief.gradient(seen), axis=1)
            off = np.abs(belief.mean(seen)) / np.maximum(slope, 0.5)
            shares.append(float(np.mean(off < belief.deviation(seen) / CORRELATED)))
    assert 0.60 <= np.mean(shares) <= 0.76


@pytest.mark.parametrize("solid", SOLIDS)
def test_the_level_rises_as_a_distance(solid: str) -> None:
    item = believed(solid)
    slope = np.linalg.norm(belief_of(item).gradient(split(solid, item)[0]), axis=1)
    assert 0.8 < np.median(slope) < 1.1


@pytest.mark.parametrize("views", [1, 2])
def test_a_hollow_that_was_looked_into_counts_as_filled(views: int) -> None:
    """A cup with walls of 2 mm, less than the noise of three points."""
    seen = scan(parse_object("cup:0.025x0.07x0.002"), views=views, seed=5)
    item = GraspObject.from_points(seen.cloud(table=0.0))
    belief, pose = belief_of(item), seen.truth.T_world_object
    outer = seen.truth.object.shape.half_extents[2]
    axis = pose.translation + np.linspace(-0.5, 0.6, 9)[:, None] * outer * pose.rotation[:, 2]
    assert (item.shape.signed_distance(axis - belief.offset) < -0.005).all()
    assert not belief.certain(belief.lid - belief.offset).any() and len(belief.lid) > 300
    on_lid = (belief.cloud.points[:, None] == belief.lid[:: len(belief.lid) // 9]).all(axis=2)
    assert (on_lid.sum(axis=0) == views).all()


@pytest.mark.parametrize("spec", ["sphere:0.035", "box:0.05x0.05x0.08", "lbracket"])
def test_what_is_round_flat_or_open_to_a_side_is_no_hollow(spec: str) -> None:
    cloud = prepared(scan(parse_object(spec), views=2, seed=5).cloud(table=0.0))
    kept, lid = lidded(cloud)
    assert kept is cloud and not len(lid)


@pytest.mark.parametrize("solid", SOLIDS)
def test_what_is_behind_is_less_certain(solid: str) -> None:
    item = believed(solid)
    seen, back = split(solid, item)
    known, guessed = belief_of(item).deviation(seen), belief_of(item).deviation(back)
    assert np.median(guessed) > 3.0 * np.median(known)
    two = believed(solid, 2)
    same = back + belief_of(item).offset - belief_of(two).offset
    assert np.median(belief_of(two).deviation(same)) < 0.5 * np.median(guessed)


def test_the_gradient_is_that_of_the_mean() -> None:
    belief = belief_of(believed("ball"))
    seen, _ = split("ball", believed("ball"))
    some, step = seen[:20], 1e-3
    for axis in np.eye(3):
        slope = (belief.mean(some + step * axis) - belief.mean(some - step * axis)) / (2 * step)
        assert np.abs(belief.gradient(some) @ axis - slope).max() < 0.15
    outward = some + belief.offset - BALL
    outward /= np.linalg.norm(outward, axis=1)[:, None]
    gradient = belief.gradient(some)
    gradient /= np.linalg.norm(gradient, axis=1)[:, None]
    off = np.rad2deg(np.arccos(np.einsum("nd,nd->n", outward, gradient)))
    assert np.median(off) < 10.0 and off.max() < 30.0


def test_samples_have_the_deviation_that_is_stated() -> None:
    belief = belief_of(believed("ball", 2))
    seen, _ = split("ball", believed("ball", 2))
    drawn = belief.samples(seen[:15], 4000, np.random.default_rng(0))
    own = belief.deviation(seen[:15])
    assert (drawn.std(axis=0) <= 1.1 * own).all() and (drawn.std(axis=0) >= 0.3 * own).all()


def test_free_space_stays_free() -> None:
    item = believed("box")
    offset = belief_of(item).offset
    ray = np.linspace(0.3, 0.93, 60)[:, None]
    for end in scanned("box").points[::400]:
        if end[2] < 0.004:  # on the table: the whole ray is free
            along = CAMERA + ray * (end - CAMERA) - offset
            assert item.shape.signed_distance(along).min() > -0.003


@cache
def found(solid: str, views: int = 1) -> CloudPlan:
    return plan_from_cloud("allegro_hand", scanned(solid, views=views), seed=0)


@pytest.mark.slow
@pytest.mark.parametrize(("solid", "views"), [("ball", 1), ("box", 2)])
def test_contacts_are_on_the_true_surface_where_it_is_certain(solid: str, views: int) -> None:
    grasp = found(solid, views)
    at = grasp.plan.contacts_in_object.positions
    assert (grasp.belief.deviation(at) <= CERTAIN + 1e-9).all()
    assert np.allclose(grasp.position_std, grasp.belief.deviation(at))
    assert grasp.survival >= 0.7
    true, _ = SOLIDS[solid](20_000, np.random.default_rng(5))
    gaps = np.linalg.norm(true[:, None] - grasp.plan.contacts.positions, axis=2).min(axis=0)
    assert (gaps < 3.0 * CERTAIN).all() and np.median(gaps) < CERTAIN


def test_the_result_says_what_is_there_and_what_is_tolerated() -> None:
    grasp = found("ball")
    text = str(grasp)
    position = next(t for t in grasp.tolerances if t.kind == "position")
    assert position.promised is not None and f"{position.promised:.1f} mm" in text
    assert f"{grasp.survival:.0%} of 60 samples" in text
    assert grasp.belief.hypothesis.name in text


def test_a_worse_pose_is_survived_less() -> None:
    again = plan_from_cloud(
        "allegro_hand", scanned("ball"), seed=0, pose_error=(0.02, 0.0), survives=0.0
    )
    assert again.survival < found("ball").survival


def test_a_sliver_is_refused_aloud() -> None:
    cloud = scanned("ball")
    sliver = cloud.only((cloud.points[:, 2] > 0.062) | (cloud.points[:, 2] < 0.004))
    # nothing is known beside it
    blind = PointCloud.create(
        sliver.points[sliver.points[:, 2] > 0.062], views=CAMERA, noise=NOISE, table=None
    )
    with pytest.raises((UncertainError, ObjectError)) as caught:
        plan_from_cloud("allegro_hand", blind, survives=0.9, pose_error=(0.004, 0.05))
    assert "view" in str(caught.value)
    if isinstance(caught.value, UncertainError):
        same = pickle.loads(pickle.dumps(caught.value))
        assert str(same) == str(caught.value)
        assert all(a.plan is None for a in same.attempts)


def object_alone(n: int = 4000) -> FloatArray:
    return scanned("box").points[scanned("box").points[:, 2] > 0.006][:n]


BAD: dict[str, tuple[Any, str]] = {
    "empty": (lambda: np.zeros((0, 3)), "empty"),
    "few": (lambda: object_alone(FEWEST - 1), f"at least {FEWEST}"),
    "all NaN": (lambda: np.full((500, 3), np.nan), "0 are finite"),
    "millimetres": (lambda: 1e3 * scanned("box").points, "millimetres"),
    "a table only": (
        lambda: np.column_stack(
            [np.random.default_rng(0).uniform(-0.3, 0.3, (5000, 2)), np.zeros(5000)]
        ),
        "only a table",
    ),
    "a plane": (
        lambda: np.random.default_rng(0).uniform(-0.04, 0.04, (3000, 3)) * [1.0, 0.0, 1.0],
        "one plane",
    ),
    "two objects": (
        lambda: np.concatenate([object_alone(), object_alone() + np.array([0.2, 0.0, 0.0])]),
        "two objects",
    ),
    "another shape": (lambda: np.zeros((100, 2)), r"\(n, 3\)"),
    "a room": (lambda: np.random.default_rng(0).uniform(-1.0, 1.0, (9000, 3)), "mm"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_cannot_be_used_is_an_error_that_says_why(name: str) -> None:
    make, words = BAD[name]
    with pytest.raises(ObjectError, match=words):
        prepared(PointCloud.create(make(), views=CAMERA))


USABLE: dict[str, Any] = {
    "500 points": lambda all_, alone: (alone[::8][:500], {"table": 0.0}),
    "half a million": lambda all_, alone: (scanned("box", n=900_000).points[:500_000], {}),
    "no table": lambda all_, alone: (alone, {}),
    "no view": lambda all_, alone: (all_, {"views": ()}),
    "NaN and infinite": lambda all_, alone: (
        np.where(np.arange(len(all_))[:, None] % 7 == 0, [[np.nan, np.inf, 0.0]], all_),
        {},
    ),
    "every point thrice": lambda all_, alone: (np.repeat(all_, 3, axis=0), {}),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", USABLE)
def test_every_cloud_that_is_not_refused_gives_a_plan_on_the_true_object(name: str) -> None:
    """Fingers that go on until they feel it, 12 mm at most, come to it; beside ``BAD``."""
    rng = np.random.default_rng(7)
    points = scanned("box").points
    alone = rng.permutation(points[points[:, 2] > 0.006])
    some, more = USABLE[name](points, alone)
    grasp = plan_from_cloud("allegro_hand", PointCloud.create(some, **{"views": CAMERA} | more))
    true, _ = on_box(20_000, np.random.default_rng(5))
    gaps = np.linalg.norm(true[:, None] - grasp.plan.contacts.positions, axis=2).min(axis=0)
    assert gaps.max() < FELT + 0.003 and gaps.min() < CERTAIN / 2.0  # behind, and where seen
    assert grasp.clearance >= CLEAR


def test_pixels_without_depth_a_small_thing_and_outliers_are_left_out() -> None:
    rng = np.random.default_rng(3)
    small = np.array([0.15, 0.1, 0.02]) + 0.004 * rng.normal(size=(150, 3))
    far = rng.uniform([-0.1, -0.1, 0.1], [0.1, 0.1, 0.3], (40, 3))
    points = np.concatenate([object_alone(), np.full((30, 3), np.nan), small, far])
    used = prepared(PointCloud.create(points, views=CAMERA, noise=NOISE, table=0.0))
    said = " ".join(used.notes)
    assert "30 points without a depth" in said and "outliers" in said and "took" in said
    assert np.linalg.norm(used.points - [0.0, 0.0, 0.04], axis=1).max() < 0.075
    beside = np.linalg.norm(used.past - [0.15, 0.1, 0.02], axis=1) < 0.02
    assert beside.sum() > 100  # what is left out is in the way all the same


@pytest.mark.parametrize("n", [500, 500_000])
def test_few_and_many_points_become_a_surface(n: int) -> None:
    points, normals = on_ball(n * 3, np.random.default_rng(1))
    points = points[seen_by(CAMERA, points, normals)][:n]
    cloud = PointCloud.create(points, views=CAMERA, noise=0.0005, table=0.0)
    used = prepared(cloud)
    assert len(used) <= KEPT and used.normals is not None
    item = GraspObject.from_points(cloud)
    seen, _ = split("ball", item)
    assert np.abs(item.shape.signed_distance(seen)).mean() < 0.002


def test_the_table_is_found_where_it_is() -> None:
    points = scanned("box").points + np.array([0.0, 0.0, 0.3])
    height = find_table(points)
    assert height is not None and abs(height - 0.3) < 0.001
    assert find_table(object_alone()) is None


def test_normals_look_at_the_camera_and_are_those_of_the_surface() -> None:
    used = prepared(scanned("ball"))
    towards = used.towards_camera
    assert used.normals is not None and towards is not None
    assert (np.einsum("nd,nd->n", used.normals, towards) > 0.0).all()
    true = used.points - BALL
    true /= np.linalg.norm(true, axis=1)[:, None]
    off = np.rad2deg(np.arccos(np.clip(np.einsum("nd,nd->n", used.normals, true), -1, 1)))
    assert np.median(off) < 15.0


def test_a_belief_is_no_part_of_a_known_object() -> None:
    known = GraspObject(name="box", shape=believed("box").shape)
    back = split("box", believed("box"))[1]
    assert known.permits(back).all() and not believed("box").permits(back).all()


def test_wrong_arguments_are_told_before_anything_is_planned() -> None:
    wrong: Any = np.zeros((5, 3))
    with pytest.raises(TaskError, match="cloud is"):
        plan_from_cloud("allegro_hand", wrong)
    for name, value in (("mass", -1.0), ("seed", -1)):
        more: dict[str, Any] = {name: value}
        with pytest.raises(TaskError, match=name):
            plan_from_cloud("allegro_hand", scanned("ball"), **more)


def test_what_one_view_saw_through_is_free_whatever_another_hides() -> None:
    """Behind the ball of the first camera, in front of it for the second, and under the table."""
    sight = belief_of(believed("ball", 2)).sight
    before = BALL + 1.3 * RADIUS * (BALL - CAMERA) / np.linalg.norm(BALL - CAMERA)
    alone = belief_of(believed("ball")).sight
    assert alone.behind(before[None])[0] > RADIUS  # hidden for one camera
    assert sight.behind(before[None])[0] < 0.0
    assert sight.behind(BALL[None])[0] > 0.0
    assert np.isneginf(sight.behind(np.array([[0.0, 0.0, -0.01]]))[0])


def test_distances_of_cells_change_sign_between_them() -> None:
    cells = np.zeros((20, 20, 20), dtype=bool)
    cells[:10] = True
    signed = _distance(cells, 0.002)[:, 10, 10]
    assert signed[9] == pytest.approx(-0.001, abs=2e-4)
    assert signed[10] == pytest.approx(0.001, abs=2e-4)
    assert signed[14] == pytest.approx(0.009, abs=2e-4)


def test_a_mirror_image_is_as_far_behind_its_plane() -> None:
    image = _reflection(np.array([1.0, 0.0, 0.0]), 0.3)(np.array([[0.5, 0.2, 0.1]]))
    np.testing.assert_allclose(image, [[0.1, 0.2, 0.1]], atol=1e-15)


def test_every_hypothesis_explains_what_was_seen() -> None:
    """The best mirror image of this one is beyond the grid, and leaves a fifth of its length."""
    seen = scan(parse_object("ellipsoid:0.14x0.09x0.08"), seed=4).cloud(table=0.0)
    cloud = prepared(seen)
    grid, _, found = hypotheses(cloud)
    for hypothesis in found:
        inside = grid.nodes[hypothesis.distance.ravel() < 0.0]
        assert (np.ptp(inside, axis=0) > 0.9 * np.ptp(cloud.points, axis=0)).all()


@pytest.mark.parametrize("solid", SOLIDS)
def test_the_most_plausible_comes_first(solid: str) -> None:
    weights = [h.weight for h in belief_of(believed(solid)).hypotheses]
    assert weights == sorted(weights, reverse=True) and np.isclose(sum(weights), 1.0)
    assert len(weights) > 1 and belief_of(believed(solid)).hypotheses[0].name != "shadow"


def test_far_from_what_was_seen_the_hypotheses_alone_are_uncertain() -> None:
    """There the variance is that of the prior, and of how the hypotheses differ from the chosen."""
    belief = belief_of(believed("box"))
    _, back = split("box", believed("box"))
    far = back[np.linalg.norm(back - back.mean(axis=0), axis=1).argsort()[-40:]]
    means = np.stack([belief.mean(far, k) for k in range(len(belief.hypotheses))])
    weights = np.array([h.weight for h in belief.hypotheses])[:, None]
    off = np.clip(means - means[belief.chosen], -DIFFER, DIFFER)
    between = (weights * off**2).sum(axis=0)
    differ = between > (0.004**2)
    assert differ.any()
    slope = np.clip(np.linalg.norm(belief.gradient(far), axis=1), LEAST_SLOPE, 1.0)
    own = (belief.deviation(far) * slope)[differ] ** 2 - between[differ]
    prior = belief._scale(far[differ] + belief.offset) ** 2
    assert (own > 0.2 * prior).all() and (own <= prior * (1.0 + 1e-9)).all()


def test_no_mesh_reaches_into_what_a_camera_saw_through() -> None:
    """A hypothesis that is 30 mm too large all around is cut off before the seen surface."""
    belief = belief_of(believed("ball"))
    large = [replace(h, distance=h.distance - 0.03) for h in belief.hypotheses]
    swollen = replace(belief, hypotheses=tuple(large), places=belief.places[:0],
                      deviations=belief.deviations[:0], before=belief.before[:0],
                      offset=np.zeros(3))  # fmt: skip
    own, mesh = swollen.of_hypothesis(0)
    towards = (CAMERA - BALL) / np.linalg.norm(CAMERA - BALL)
    before, behind = BALL + 1.4 * RADIUS * towards, BALL - 1.4 * RADIUS * towards
    outside = mesh.signed_distance(np.array([before, behind]) - own.offset)
    assert outside[0] > 0.0 > outside[1]


def test_errors_of_place_and_of_turn_are_both_survived_less() -> None:
    plan = found("box", 2).plan
    exact, shifted, turned = (
        survival_of(plan, error, 0, 0.0).survival for error in ((0.0, 0.0), (0.03, 0.0), (0.0, 0.6))
    )
    assert shifted < exact - 0.1 and turned < exact - 0.1


def test_a_hand_in_another_hypothesis_is_noticed() -> None:
    plan, belief = found("box", 2).plan, found("box", 2).belief
    everywhere = replace(belief.hypotheses[0], distance=np.full(belief.grid.shape, -0.05))
    both = replace(belief, hypotheses=(*belief.hypotheses, everywhere), places=belief.places[:0],
                   deviations=belief.deviations[:0], before=belief.before[:0])  # fmt: skip
    assert not hits(plan, both)[belief.chosen]
    assert hits(plan, both)[len(belief.hypotheses)]


def test_what_opened_fingers_meet_on_their_way_in_is_noticed() -> None:
    """A ball that only one hypothesis has, where a finger passes and no link is at the grasp."""
    plan, belief = found("box", 2).plan, found("box", 2).belief
    end = plan.task.T_world_object
    way, _ = _way_in(plan)
    apart = np.linalg.norm(way[:, None] - _spheres(plan, plan.q, inner=True)[0], axis=2).min(axis=1)
    apart[belief.grid.beyond(way + belief.offset) > 0.0] = 0.0
    place = way[apart.argmax()]
    off = belief.grid.nodes - belief.offset - place
    ball = np.linalg.norm(off, axis=1).reshape(belief.grid.shape) - 0.012
    more = replace(belief.hypotheses[0], distance=np.minimum(ball, belief.hypothesis.distance))
    both = replace(belief, hypotheses=(*belief.hypotheses, more))
    assert not hits(plan, belief)[belief.chosen]
    assert hits(plan, both)[len(belief.hypotheses)]
    cloud = belief.cloud
    thing = end.act(way[np.linalg.norm(way, axis=1).argmax()])[None]  # where the way begins
    full = replace(cloud, past=np.vstack([cloud.past, thing]), past_of=np.append(cloud.past_of, 0))
    item = replace(plan.task.object, belief=replace(belief, cloud=full))
    blocked = survival_of(replace(plan, task=replace(plan.task, object=item)), (0.0, 0.0), 0, 0.0)
    assert blocked.clearance < CLEAR and blocked.survival == 0.0


def test_a_hand_behind_the_object_is_where_no_camera_saw() -> None:
    plan, belief = found("ball").plan, found("ball").belief
    palm = _spheres(plan, plan.q)[0].mean(axis=0)  # from the ball's middle, about
    ahead = np.array([BALL[0] - CAMERA[0], BALL[1] - CAMERA[1], 0.0])
    ahead *= 0.05 / np.linalg.norm(ahead)
    base = plan.T_world_base
    behind, before = (
        hidden_share(
            replace(plan, T_world_base=SE3(base.rotation, base.translation - palm + way)), belief
        )
        for way in (ahead, -3.0 * ahead)
    )
    assert behind > 0.2 and before == 0.0  # it is larger than the shadow


def test_grasps_are_planned_anew_with_the_options_of_the_first_search() -> None:
    options = SynthesisOptions(cone_share=0.37)
    first = replace(found("box", 2), others=(), options=options, max_attempts=1)
    made: list[Any] = []

    def counted(task: Any, *, seed: int, options: Any) -> Any:
        made.append(options)
        return iter(())

    with patch("planner.search.from_cloud.attempts", counted):
        assert first.after(np.zeros((0, 3))) is None
    assert made and all(one is options for one in made)
    again = plan_from_cloud("allegro_hand", scanned("box", views=2), options=options)
    assert again.options is options


def test_ordinary_margins_are_tried_where_cautious_ones_find_nothing() -> None:
    """A thin capsule on its side: half of the friction and wide clearances leave no grasp."""
    made: list[float] = []

    def counted(task: Any, *, seed: int, options: Any) -> Any:
        made.append(options.cone_share)
        return iter(())

    with patch("planner.search.from_cloud.attempts", counted), pytest.raises(UncertainError):
        plan_from_cloud("allegro_hand", scanned("ball"))
    assert made[0] == CONE_SHARE and made[-1] == SynthesisOptions().cone_share


def test_a_push_tips_what_it_meets_above_the_lever_of_its_base_over_friction() -> None:
    """A box of half width 20 mm, pushed along x; 20 mm / TABLE_MU is the height between."""
    between = 0.02 / TABLE_MU
    plan: Any = SimpleNamespace(
        task=SimpleNamespace(
            table_height=0.3,
            object=parse_object("box:0.04x0.06x0.2"),
            T_world_object=SE3(np.eye(3), np.array([0.0, 0.0, 0.4])),
        ),
        contacts=SimpleNamespace(
            normals=np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]),
            positions=np.array([[-0.02, 0.0, 0.3 + between + dz] for dz in (-1e-3, 1e-3, 1e-3)]),
        ),
    )
    assert _tips(plan).tolist() == [False, True, False]  # along y the lever is 30 mm


def test_fingers_that_meet_one_another_or_the_table_are_noticed() -> None:
    """As true distances say of a middle finger turned aside and of a thumb turned down."""
    plan = found("ball").plan
    hand, still = plan.task.hand, np.zeros((1, len(plan.task.fingers)))
    world, met = CollisionWorld(plan.task), []
    for name, angle in product(("middle", "thumb"), np.linspace(-0.3, 0.6, 13)):
        turned = np.zeros(hand.nq)
        turned[next(f.q_index[0] for f in plan.task.fingers if f.name == name)] = angle
        distances = world.distances(plan.T_world_base, plan.q + turned)
        gap = min(c.distance for c in distances if c.second != OBJECT)
        if abs(gap) > 0.003:  # capsules are as wide as links to a millimetre or two
            met.append(gap < 0.0)
            assert _meets(plan, still, turned[None])[0] == met[-1], (name, angle, gap)
    assert any(met) and not all(met)


def test_fingers_that_go_on_too_far_meet_and_survive_nothing() -> None:
    """Each 4 cm on through a ball of 7: they come out behind it, where the thumb is."""
    plan = found("ball").plan
    n, joints = len(plan.task.fingers), np.zeros((1, plan.task.hand.nq))
    met = [_meets(plan, np.full((1, n), way), joints)[0] for way in (-0.02, -0.01, 0.0, 0.04)]
    assert met == [False, False, False, True]
    with patch("planner.search.survival._meets", lambda *_: np.ones(SAMPLES, dtype=bool)):
        assert survival_of(plan, (0.0, 0.0), 0, 0.0).survival == 0.0


@pytest.mark.parametrize(("solid", "views"), [("box", 1), ("ball", 2)])
def test_an_object_stands_on_its_table_and_the_hand_keeps_clear_of_where_that_is(
    solid: str, views: int
) -> None:
    grasp = found(solid, views)
    table, task = grasp.belief.cloud.table, grasp.plan.task
    assert table is not None and task.table_height is not None
    assert isinstance(task.object.shape, Mesh)
    lowest = task.T_world_object.translation[2] - task.object.shape.support(-np.eye(3)[2])
    assert lowest > table - 2e-4 and table - 2e-4 < task.table_height < table + UNSEEN_FOOT


def test_what_a_mask_names_is_one_object_in_two_parts() -> None:
    bars = [object_alone() + shift for shift in (np.zeros(3), np.array([0.0, 0.16, 0.0]))]
    given: dict[str, Any] = {"views": CAMERA, "table": None}
    with pytest.raises(ObjectError, match="two objects"):
        prepared(PointCloud.create(np.vstack(bars), **given))
    both = prepared(PointCloud.create(np.vstack(bars), one=True, **given))
    assert np.ptp(both.points[:, 1]) > 0.16
    alone = prepared(PointCloud.create(bars[0], one=True, **given))
    assert np.ptp(alone.points[:, 1]) < 0.1


def test_a_refusal_names_what_is_too_low_for_fingertips() -> None:
    """A thin ring of 13 mm height: fingertips of 24 mm press it down."""
    belief = Belief.of(scan(parse_object("torus:0.0218x0.0066"), views=2, seed=3).cloud(table=0.0))
    assert re.search(r"about 1[2-5] mm high", str(_abstained(None, 0.1, belief, ["no"], [])))
    assert "high" not in str(_abstained(None, 0.1, Belief.of(scanned("ball")), ["no"], []))


def test_joints_that_are_off_are_survived_less() -> None:
    plan = found("box", 2).plan
    off = replace(plan, task=replace(plan.task, joint_error=0.1))
    exact, wrong = (survival_of(p, (0.0, 0.0), 0, 0.0).survival for p in (plan, off))
    assert wrong < exact - 0.1


def test_a_wall_thinner_than_a_step_is_felt_from_outside() -> None:
    """The distance behind a thin wall rises again: its slope is that of where a finger is from."""
    plan, belief = found("box", 2).plan, found("box", 2).belief
    lower, h, shape = belief.grid.lower, belief.grid.spacing, belief.grid.shape
    nodes = (lower + h * np.indices(shape).reshape(3, -1).T - belief.offset).reshape(*shape, 3)
    solid = plan.task.object.shape.signed_distance(nodes.reshape(-1, 3)).reshape(shape)
    hollow = np.abs(solid + 0.0015) - 0.0015  # walls of 3 mm, and air inside
    wall = replace(
        belief,
        hypotheses=(replace(belief.hypothesis, distance=hollow, weight=1.0),),
        chosen=0,
    )
    item = replace(plan.task.object, belief=wall)
    thin = replace(plan, task=replace(plan.task, object=item))
    assert survival_of(thin, (0.0, 0.0), 0, 0.0).survival > 0.6


def test_felt_places_move_the_surface_and_make_it_certain() -> None:
    """A ball that stands 4 mm beside its belief is felt on three sides, one of them hidden."""
    item = believed("ball")
    belief, shift = belief_of(item), np.array([0.004, 0.0, 0.0])
    out = np.array([[1.0, 0.0, 0.2], [-0.6, 0.8, 0.1], [-0.9, -0.4, 0.0]])
    out /= np.linalg.norm(out, axis=1)[:, None]
    true = BALL - belief.offset + RADIUS * out
    after, moved = belief.with_felt(true + shift, 0.005)
    assert np.linalg.norm(moved - shift) < 0.002 and moved[2] == 0.0
    assert belief.deviation(true)[2] > 1.5 * after.deviation(true)[2]
    assert abs(after.mean(true))[2] < abs(belief.mean(true))[2] + 0.0005
    # each new place is as sure as the touch and what is left of the shift, no less
    sure = after.deviations[len(belief.deviations) :]
    assert ((sure > TOUCH) & (sure < np.hypot(TOUCH, 0.005))).all()
    weights = [h.weight for h in after.hypotheses]
    assert sum(weights) == pytest.approx(1.0)
    off = [abs(belief.mean(true, k)).max() for k in range(len(weights))]
    gained = [w / h.weight for w, h in zip(weights, belief.hypotheses, strict=True)]
    assert gained[int(np.argmin(off))] > gained[int(np.argmax(off))]


def test_the_next_plan_is_where_the_object_has_moved_to() -> None:
    other = found("box", 2)
    pair = replace(other, others=(replace(other, others=()),))
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    moved = SE3(turn, np.array([0.02, -0.01, 0.003]))
    following = pair.after(np.zeros((0, 3)), moved)
    assert following is not None and not following.others
    old, new = other.plan, following.plan
    place = new.task.T_world_object.translation
    about = old.task.T_world_object.translation
    assert np.allclose(place[:2], moved.act(about)[:2]) and place[2] == pytest.approx(about[2])
    for at in ("T_world_base", "T_world_base_start"):
        kept = old.task.T_world_object.inverse() * getattr(old, at)
        assert np.allclose((new.task.T_world_object.inverse() * getattr(new, at)).homogeneous,
                           kept.homogeneous)  # fmt: skip
    assert following.survival == other.survival


def test_grasps_are_planned_anew_when_none_is_left() -> None:
    last = replace(found("box", 2), others=())
    moved = SE3(np.eye(3), np.array([0.02, -0.01, 0.0]))
    anew = last.after(np.zeros((0, 3)), moved)
    assert anew is not None and anew.survival >= anew.survives
    assert not np.allclose(anew.plan.q, last.plan.q)
    for grasp, shift in ((last, np.zeros(3)), (anew, moved.translation)):
        place = grasp.plan.task.T_world_object.translation
        assert np.allclose(place, grasp.belief.offset + shift)


def test_what_was_seen_beside_the_object_is_in_the_way() -> None:
    grasp = found("box", 2)
    palm = grasp.plan.T_world_base.translation
    cloud = grasp.belief.cloud
    full = replace(cloud, past=np.vstack([cloud.past, palm]), past_of=np.append(cloud.past_of, 0))
    item = replace(grasp.plan.task.object, belief=replace(grasp.belief, cloud=full))
    blocked = survival_of(
        replace(grasp.plan, task=replace(grasp.plan.task, object=item)), (0.0, 0.0), 0, 0.0
    )
    assert grasp.clearance >= CLEAR and blocked.clearance < CLEAR and blocked.survival == 0.0


def test_a_search_keeps_away_from_other_things_and_its_plan_does_not_have_them() -> None:
    """A wall 9 cm beside the box; points near the box are no wall."""
    cloud, rng = scanned("box", views=2), np.random.default_rng(1)
    wall = np.array([0.115, 0.0, 0.06]) + rng.uniform(-1, 1, (600, 3)) * [0.002, 0.05, 0.05]
    near = np.array([0.035, 0.0, 0.04]) + rng.uniform(-1, 1, (50, 3)) * [0.002, 0.01, 0.01]
    more = np.vstack([cloud.past, wall, near])
    by = np.concatenate([cloud.past_of, np.zeros(650, dtype=int)])
    grasp = plan_from_cloud("allegro_hand", replace(cloud, past=more, past_of=by))
    task = grasp.plan.task
    boxes = things_about(task)
    assert boxes and not task.obstacles and grasp.clearance >= CLEAR
    for box in boxes:
        least = box.T_world_obstacle.translation - box.size / 2.0
        assert least[0] > 0.11 and (box.size < [0.01, 0.061, 0.061]).all()
    held = [
        np.abs(wall - box.T_world_obstacle.translation) <= box.size / 2.0 + 1e-9 for box in boxes
    ]
    assert np.any([inside.all(axis=1) for inside in held], axis=0).mean() > 0.9
    assert not things_about(found("box", 2).plan.task)


def test_a_cloud_that_shows_a_table_is_not_planned_on_without_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its table would be part of the object, and the hand beneath it."""
    np.save(tmp_path / "cloud.npy", scanned(next(iter(SOLIDS))).points)
    with pytest.raises(SystemExit) as ended:
        main(["plan", "allegro_hand", str(tmp_path / "cloud.npy"), "--table", "none"])
    assert ended.value.code == 3
    told = " ".join(capsys.readouterr().err.split())
    assert "shows a table at z =" in told and "leave --table out" in told


def test_plans_that_are_clear_of_what_was_seen_are_kept_first(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """One that survives 0.3 and may tip, beside three in the way, which survive nothing."""
    judged = iter([(0.3, 0.9, 0.004), *[(0.0, 0.0, 0.001)] * 3])
    beaten = []

    def tried(plan: Any, pose_error: Any, seed: int, least: float) -> CloudPlan:
        survival, tipping, clearance = next(judged)
        beaten.append(least)
        known: dict[str, Any] = {"plan": plan, "samples": 60, "position_std": np.zeros(1)}
        known |= {"normal_std": np.zeros(1), "hidden": 0.0}
        return CloudPlan(**known, survival=survival, tipping=tipping, clearance=clearance)

    monkeypatch.setattr(from_cloud, "_tried", tried)
    monkeypatch.setattr(from_cloud, "replace", lambda one, **_: one)
    attempt = SimpleNamespace(plan=SimpleNamespace(task=None), failure=None)
    kept: list[CloudPlan] = []
    task: Any = SimpleNamespace(obstacles=())
    from_cloud._add_best([attempt] * 4, task, kept, (0.0, 0.0), 0, [])  # type: ignore[list-item]
    assert kept[0].survival == 0.3
    assert kept[0].merit < kept[1].merit
    assert beaten == [0.0] * 4  # what is in the way is no bound for others


def test_what_a_mask_names_is_said_in_its_parts() -> None:
    """Two groups of 800 and 500 points, and 40 of something else."""
    draw = np.random.default_rng(0)
    large = draw.uniform(-0.02, 0.02, (800, 3))
    small = draw.uniform(-0.005, 0.005, (40, 3)) + np.array([0.0, 0.3, 0.0])
    points = np.concatenate([large, large[:500] + np.array([0.2, 0.0, 0.0]), small])
    view_of = np.zeros(len(points), dtype=np.int64)
    about: dict[str, Any] = {"views": [[0, 0, 1.0]], "noise": 0.001, "table": None, "one": True}
    cloud = PointCloud.create(points, view_of=view_of, **about)
    note = _one_object(cloud).notes[-1]
    assert "took 800 points" in note and "and 500 points" in note and "left out 40" in note
    rest = PointCloud.create(points[:1300], view_of=view_of[:1300], **about)
    both = _one_object(rest)
    assert len(both) == 1300
    assert "as one object, as its mask tells" in both.notes[-1]
