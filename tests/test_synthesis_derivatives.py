"""Derivatives of the expressions; spheres and capsules that stand for links, against coal."""

from __future__ import annotations

from collections import Counter
from itertools import combinations
from typing import Any

import casadi as ca
import coal
import numpy as np
import pinocchio as pin
import pytest
from constrained import Constrained
from hypothesis import given
from hypothesis import strategies as st

from planner.hands.hand import Hand
from planner.kinematics import HandState
from planner.objects import parse_object
from planner.spatial import SE3, FloatArray
from planner.synthesis.link_spheres import hull_spheres
from planner.synthesis.options import SynthesisOptions
from planner.synthesis.problem import GraspProblem, Start, build_problem, problems_for
from planner.synthesis.seeds.draw import Seeder
from planner.synthesis.terms.fingers import (
    COLLISION_MARGIN,
    FINGERS,
    LinkCapsule,
    closest_on_segments,
    collision_pairs,
    finger_capsules,
)
from planner.task import GraspTask, Obstacle

STEP = 1e-6
"""Step of the central differences (m, rad or -)."""


class Derivatives:
    """Exact derivatives of a problem's expressions at a place, by CasADi."""

    def __init__(self, problem: GraspProblem, x: FloatArray, p: FloatArray) -> None:
        """Differentiate cost and constraints twice."""
        programme = Constrained(problem)
        self.x, self.p = x, p
        both = ca.vertcat(programme.cost, programme.g)
        weights, inputs = ca.SX.sym("w", both.numel()), [programme.x, programme.p]
        lagrangian = ca.dot(weights, both)
        self._values = ca.Function("values", inputs, [both])
        self._jacobian = ca.Function("jacobian", inputs, [ca.jacobian(both, programme.x)])
        hessian = ca.hessian(lagrangian, programme.x)[0]
        self._hessian = ca.Function("hessian", [*inputs, weights], [hessian])

    def values(self, x: FloatArray) -> FloatArray:
        """Cost and constraints (1 + m,)."""
        return np.array(self._values(x, self.p)).ravel()

    def jacobian(self, x: FloatArray) -> FloatArray:
        """Exact derivatives (1 + m, n) of ``values``."""
        return np.array(ca.DM(self._jacobian(x, self.p)))

    def hessian(self, weights: FloatArray) -> FloatArray:
        """Exact second derivatives (n, n) of weights . values."""
        return np.array(ca.DM(self._hessian(self.x, self.p, weights)))


def check_derivatives(nlp: Derivatives) -> None:
    """Central differences of values, and of the gradient of the Lagrangian, along every axis.

    1e-6 and 1e-5 of the largest entry allow for rounding and for edges softened over 2 mm.
    """
    axes = STEP * np.eye(len(nlp.x))
    exact = nlp.jacobian(nlp.x)
    by_steps = np.array(
        [(nlp.values(nlp.x + e) - nlp.values(nlp.x - e)) / (2 * STEP) for e in axes]
    ).T
    scale = np.maximum(1.0, np.abs(by_steps).max(axis=0))
    assert (np.abs(exact - by_steps).max(axis=0) <= 1e-6 * scale).all()

    weights = np.random.default_rng(7).normal(size=len(exact))
    second = nlp.hessian(weights)
    by_steps = np.array(
        [weights @ (nlp.jacobian(nlp.x + e) - nlp.jacobian(nlp.x - e)) / (2 * STEP) for e in axes]
    )
    assert np.abs(second - by_steps).max() <= 1e-5 * np.abs(second).max()
    assert (np.abs(second) > 1e-3).sum() > 4 * len(nlp.x)


@pytest.fixture(scope="module")
def task(shadow: Hand) -> GraspTask:
    """Every term there is: couplings, stops, patches with a surface equation, an obstacle."""
    wall = Obstacle(
        name="wall",
        size=np.array([0.05, 0.2, 0.1]),
        T_world_obstacle=SE3(pin.exp3(np.array([0.0, 0.0, 0.4])), np.array([0.11, 0.0, 0.05])),
    )
    return GraspTask.create(shadow, "cylinder", obstacles=(wall,))


@pytest.mark.parametrize("seed", [0, 1])
def test_grasp_problem_has_exact_derivatives(task: GraspTask, seed: int) -> None:
    rng = np.random.default_rng(seed)
    problem, seeder, hand = problems_for(task).grasp, Seeder(task), task.hand
    assert {w.term.name for w in problem.terms if w.rows} >= {
        "surface",
        "coupling",
        "stop",
        "obstacle",
    }
    start = seeder.draw(rng)
    assert isinstance(start, Start)
    parameters = problem.parameters(task, start, seeder.posture, SynthesisOptions())
    x = np.concatenate(
        [
            rng.normal(0, 0.2, 3),
            start.T_object_base.translation,
            np.clip(start.q + rng.normal(0, 0.1, hand.nq), hand.q_lower, hand.q_upper),
            (start.points + rng.normal(0, 0.003, start.points.shape)).ravel(),
            (start.forces + rng.normal(0, 0.3, start.forces.shape)).ravel(),
        ]
    )
    check_derivatives(Derivatives(problem, x, parameters))


def capsule_geometry(capsule: LinkCapsule, pose: SE3) -> tuple[Any, Any]:
    """A link capsule as coal's and its pose in the base."""
    inner, outer = pose.act(capsule.inner), pose.act(capsule.outer)
    along = outer - inner
    length = float(np.linalg.norm(along))
    z = along / length if length > 0 else np.array([0.0, 0.0, 1.0])
    side = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
    side /= np.linalg.norm(side)
    rotation = np.column_stack([side, np.cross(z, side), z])
    return coal.Capsule(capsule.radius, length), coal.Transform3s(rotation, (inner + outer) / 2)


def between_capsules(first: LinkCapsule, second: LinkCapsule, state: HandState) -> float:
    """Signed distance (m) of two capsules by coal."""
    one, other = (capsule_geometry(c, state.joint_pose(c.joint_id)) for c in (first, second))
    return between(one, other)


def between(first: tuple[Any, Any], second: tuple[Any, Any]) -> float:
    """Signed distance (m) of two placed capsules."""
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    return float(coal.distance(*first, *second, request, result))


def random_state(hand: Hand, seed: int) -> HandState:
    return HandState(hand, np.random.default_rng(seed).uniform(hand.q_lower, hand.q_upper))


def test_fingers_term_is_the_distance_of_capsules(right_hand: Hand) -> None:
    """By coal, to its tolerance of 1e-6 m, at random joints, through the squares of the term."""
    fingers, sphere = tuple(right_hand.fingers.values()), parse_object("sphere").shape
    problem = build_problem(right_hand, fingers, sphere)
    f = problem.formulation
    expression = next(w.expression for w in problem.terms if w.term is FINGERS)
    inputs = [f.x, f.symbols.reference, f.symbols.option["clear_fingers"]]
    rows = ca.Function("rows", inputs, [expression])
    x = np.zeros(f.unknowns.size)
    capsules = finger_capsules(right_hand)
    apart_seen = 0
    for seed in range(5):
        state = random_state(right_hand, seed)
        f.unknowns.q(x)[:] = state.q
        squares = np.array(rows(x, np.eye(3), 0.002)).ravel()
        for (i, j), row in zip(collision_pairs(right_hand), squares, strict=True):
            radii = capsules[i].radius + capsules[j].radius
            apart = np.sqrt(row + (radii + 0.002) ** 2) - radii
            theirs = between_capsules(capsules[i], capsules[j], state)
            if apart > 0.0:  # of what overlaps coal tells the way out instead
                assert apart == pytest.approx(theirs, abs=3e-6)
                apart_seen += 1
            else:
                assert theirs <= 3e-6
    assert apart_seen > 100


@given(st.integers(0, 10_000))
def test_nearest_points_of_segments_are_nearer_than_any_others(seed: int) -> None:
    rng = np.random.default_rng(seed)
    p1, q1, p2, q2 = 0.02 * rng.normal(size=(4, 12, 3))  # as long as bones of fingers
    q2[6:] = p2[6:] + (q1 - p1)[6:] * (1.0 + 0.02 * rng.normal(size=(6, 3)))  # nearly parallel
    q1[0] = p1[0]  # a point
    q2[1] = p2[1] + 2.0 * (q1[1] - p1[1])  # parallel
    p2[2] = q2[2] = p1[2]  # a point on the other's end
    one, other = closest_on_segments(p1, q1, p2, q2)
    least = np.linalg.norm(other - one, axis=1)
    shares = np.linspace(0.0, 1.0, 21)
    for s in shares:
        on_first = p1 + s * (q1 - p1)
        for t in shares:
            others = np.linalg.norm(on_first - p2 - t * (q2 - p2), axis=1)
            assert (least <= others + 1e-9).all()
    for a, b, at in ((p1, q1, one), (p2, q2, other)):
        along = np.linalg.norm(at - a, axis=1) + np.linalg.norm(at - b, axis=1)
        np.testing.assert_allclose(along, np.linalg.norm(b - a, axis=1), atol=1e-9)


def test_meeting_bones_are_the_same_every_time_and_contain_pairs_that_often_meet(
    right_hand: Hand,
) -> None:
    """Pairs that meet in 8 of 200 other configurations; what counts as often is 1 of 100."""
    found = collision_pairs(right_hand)
    collision_pairs.cache_clear()
    assert collision_pairs(right_hand) == found
    capsules = finger_capsules(right_hand)
    times: Counter[tuple[int, int]] = Counter()
    for seed in range(100, 300):
        state = random_state(right_hand, seed)
        places = [state.joint_pose(b.joint_id) for b in capsules]
        middles = [T.act((b.inner + b.outer) / 2) for T, b in zip(places, capsules, strict=True)]
        reach = [float(np.linalg.norm(b.outer - b.inner)) / 2 + b.radius for b in capsules]
        placed = [capsule_geometry(b, T) for b, T in zip(capsules, places, strict=True)]
        for i, j in combinations(range(len(capsules)), 2):
            far = np.linalg.norm(middles[i] - middles[j]) > reach[i] + reach[j] + COLLISION_MARGIN
            if not far and capsules[i].finger != capsules[j].finger:
                times[i, j] += between(placed[i], placed[j]) < COLLISION_MARGIN
    often = {pair for pair, count in times.items() if count >= 8}
    assert len(often) >= 3
    assert often <= set(found)
    assert len(found) < sum(a.finger != b.finger for a, b in combinations(capsules, 2))


def relatives(hand: Hand, joint: int) -> set[int]:
    """Joints up to two steps up or down the same chain."""
    parent = list(hand.pin_model.parents)
    above = {joint, parent[joint], parent[parent[joint]]}
    below = {k for k in range(1, len(parent)) if joint in (parent[k], parent[parent[k]])}
    return above | below


def test_hull_balls_hold_every_link_and_reach_no_further(right_hand: Hand) -> None:
    """Lowest points over a plane, by coal; a cylinder's prism may reach 8 % of its radius lower.

    A ball that is shared by links which meet in a joint is kept once, on one of them.
    """
    balls = hull_spheres(right_hand)
    rng = np.random.default_rng(3)
    plane, origin = coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0), coal.Transform3s.Identity()
    for seed in range(5):
        state = random_state(right_hand, seed)
        T_world_base = SE3(pin.exp3(rng.normal(size=3)), np.array([0.0, 0.0, 1.0]))
        low = [
            T_world_base.act(state.joint_pose(b.joint_id).act(b.center))[2] - b.radius
            for b in balls
        ]
        for g in right_hand.geometries:
            pose = T_world_base * state.joint_pose(g.joint_id) * g.T_joint_geometry
            at = coal.Transform3s(pose.rotation, pose.translation)
            request, result = coal.DistanceRequest(), coal.DistanceResult()
            true = coal.distance(g.geometry, at, plane, origin, request, result)
            near = relatives(right_hand, g.joint_id)
            lowest = min(z for z, b in zip(low, balls, strict=True) if b.joint_id in near)
            assert lowest <= true + 2e-6, g.name
            own = [z for z, b in zip(low, balls, strict=True) if b.geometry == g.name]
            reach = g.size[0] * (1 / np.cos(np.pi / 8) - 1) if g.kind == "cylinder" else 0.0
            assert min(own, default=np.inf) >= true - reach - 1e-9, g.name
    assert {g.kind for g in right_hand.geometries} >= {"sphere", "capsule", "box"}
