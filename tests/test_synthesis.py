"""The grasp problem: every term means what its name says.

The terms are compared with numpy, Pinocchio and coal, at points that do not satisfy them, so that a
wrong term cannot hide behind a residual of zero; then a solution is checked with the same code.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from constrained import Constrained

from planner.contacts import ContactSet
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.kinematics import HandState
from planner.shapes.base import EDGE_MARGIN
from planner.spatial import SE3, FloatArray
from planner.synthesis.link_spheres import LinkSphere, hull_spheres, link_spheres
from planner.synthesis.options import SynthesisOptions
from planner.synthesis.problem import Candidate, GraspProblem, Start, problems_for
from planner.synthesis.seeds.draw import Seeder
from planner.synthesis.terms.standard import LEVER, PRESS_MIN
from planner.task import GraspTask, Obstacle

SOFT = 4e-5
"""How far (m) a ball that keeps its margin in the problem may miss it: softened face distances."""

OPTIONS = SynthesisOptions()

SOLVED_TOL = 1e-5
"""Largest violation of a term (in its unit) that IPOPT may leave."""


@dataclass(frozen=True)
class Solved:
    """A problem, a solution, and its parameters with the solution's own base as reference."""

    task: GraspTask
    problem: GraspProblem
    solution: Candidate
    start: Start
    parameters: FloatArray

    @property
    def x(self) -> FloatArray:
        return pack(self.solution, np.zeros(3))

    @property
    def normals(self) -> FloatArray:
        """Outward normals (n, 3) of the contacts, by the terms' own form of the shape."""
        surface = self.problem.surface
        size = ca.DM(surface.size(self.task.object.shape))
        pairs = zip(self.start.patches, self.solution.points, strict=True)
        return np.array(
            [np.array(surface.outward_normal(size, c.code, ca.DM(p))).ravel() for c, p in pairs]
        )

    def disturbed(self, rng: np.random.Generator) -> FloatArray:
        """The unknowns away from the solution, contact points still on their patches."""
        s = self.solution
        points = s.points + rng.normal(0, 0.004, s.points.shape)
        for patch, p in zip(self.start.patches, points, strict=True):
            p[:] = np.clip(p, patch.lower, patch.upper)
            if self.problem.surface.kind == "cylinder":
                assert patch.name == "side", "take another seed: an end's z would be free here"
                p[:2] *= self.task.object.shape.half_extents[0] / np.hypot(*p[:2])
        hand = self.task.hand
        q = np.clip(s.q + rng.normal(0, 0.1, hand.nq), hand.q_lower, hand.q_upper)
        shift = s.T_object_base.translation + rng.normal(0, 0.01, 3)
        forces = s.forces + rng.normal(0, 0.3, s.forces.shape)
        other = replace(s, T_object_base=SE3(np.eye(3), shift), q=q, points=points, forces=forces)
        return pack(other, rng.normal(0, 0.1, 3))


def pack(s: Candidate, turn: FloatArray) -> FloatArray:
    return np.concatenate(
        [turn, s.T_object_base.translation, s.q, s.points.ravel(), s.forces.ravel()]
    )


def solve(task: GraspTask) -> Solved:
    problem, seeder = problems_for(task).grasp, Seeder(task)
    programme = Constrained(problem)

    def parameters(start: Start) -> FloatArray:
        return problem.parameters(task, start, seeder.posture, OPTIONS)

    for seed in range(20):
        start = seeder.draw(np.random.default_rng(seed))
        assert isinstance(start, Start)
        solution = programme.solve(task, start, parameters(start))
        if max(solution.violation.values()) <= SOLVED_TOL:
            here = replace(start, T_object_base=solution.T_object_base)
            return Solved(task, problem, solution, here, parameters(here))
    pytest.fail("no start of twenty leads to a solution")


@pytest.fixture(scope="module", params=["allegro box", "shadow cylinder"])
def solved(request: pytest.FixtureRequest, allegro: Hand, shadow: Hand) -> Solved:
    """A box without, and a cylinder beside an obstacle; the Shadow has couplings and stops."""
    if request.param == "allegro box":
        return solve(GraspTask.create(allegro, "box"))
    wall = Obstacle(
        name="wall",
        size=np.array([0.05, 0.2, 0.1]),
        T_world_obstacle=SE3(pin.exp3(np.array([0.0, 0.0, 0.4])), np.array([0.11, 0.0, 0.05])),
    )
    return solve(GraspTask.create(shadow, "cylinder", obstacles=(wall,)))


def terms(case: Solved, x: FloatArray) -> dict[str, FloatArray]:
    """Value of every term at x."""
    return Constrained(case.problem).values(x, case.parameters, case.task)


class Reference:
    """The same unknowns in numpy and Pinocchio: nothing of the problem's own code."""

    def __init__(self, case: Solved, x: FloatArray) -> None:
        """Kinematics and contacts at x."""
        task, n = case.task, len(case.task.fingers)
        self.task, self.hand, nq = task, task.hand, task.hand.nq
        s = x[:3]
        size = float(np.linalg.norm(s))
        # modified Rodrigues parameters: axis times the tangent of a quarter of the angle
        turn = pin.exp3(s / size * 4 * np.arctan(size)) if size > 0 else np.eye(3)
        self.T = SE3(case.start.T_object_base.rotation @ turn, x[3:6])
        self.q = x[6 : 6 + nq]
        self.points = x[6 + nq : 6 + nq + 3 * n].reshape(n, 3)
        self.forces = x[6 + nq + 3 * n :].reshape(n, 3)
        _, self.outward = task.object.shape.closest_point(self.points)
        self.state = HandState(task.hand, self.q)
        self.centers = np.array([self.T.act(self.state.pad_center(f)) for f in task.fingers])
        self.radii = np.array([f.pad.radius for f in task.fingers])
        self.contacts = ContactSet.from_arrays(self.points, -self.outward, mu=task.mu)
        local = np.einsum("nji,nj->ni", self.contacts.frames, self.forces)
        self.contacts = self.contacts.with_forces(np.column_stack([local, np.zeros(n)]))

    def torque(self) -> FloatArray:
        """Joint torques J^T f of the forces at the pads' surfaces, by Pinocchio."""
        total = np.zeros(self.hand.nq)
        for f, center, r, n, force in zip(
            self.task.fingers, self.centers, self.radii, self.outward, self.forces, strict=True
        ):
            at = self.T.inverse().act(center - r * n)
            jacobian = self.state.point_jacobian(f.pad.joint_id, at)[:3]
            total += jacobian.T @ self.T.rotation.T @ force
        return total

    def ball(self, joint_id: int, center: FloatArray) -> FloatArray:
        """A point of a joint's frame in the object's."""
        return np.array(self.T.act(self.state.joint_pose(joint_id).act(center)))


def check(values: dict[str, FloatArray], ref: Reference, tolerance: float = 1e-9) -> None:
    """All terms of contacts, forces and joints against their definitions in words."""
    task, fn = ref.task, ref.contacts.forces[:, 0]
    tangential = ref.contacts.forces[:, 1:3]
    expected: dict[str, Any] = {
        "touch": ref.centers - ref.points - ref.radii[:, None] * ref.outward,
        "level": fn.mean() - 1.0,
        "press": fn - PRESS_MIN,
        "cone": (OPTIONS.cone_share * task.mu * fn) ** 2 - (tangential**2).sum(axis=1),
        "facing": [
            -(ref.T.rotation @ ref.state.pad_axis(f)) @ n - np.cos(f.pad.half_angle)
            for f, n in zip(task.fingers, ref.outward, strict=True)
        ],
        "balance": ref.contacts.wrench() / np.repeat([1.0, task.object.shape.bounding_radius], 3),
    }
    matrix, value = ref.hand.coupling_matrix
    if len(value):
        expected["coupling"] = matrix @ ref.q - value
    for name, numbers in expected.items():
        wanted = np.asarray(numbers, dtype=float).ravel()
        np.testing.assert_allclose(values[name], wanted, rtol=0, atol=tolerance, err_msg=name)


@pytest.mark.slow
def test_terms_of_contacts_and_forces_are_what_they_say_away_from_a_solution(
    solved: Solved,
) -> None:
    for seed in range(5):
        x = solved.disturbed(np.random.default_rng(seed))
        values = terms(solved, x)
        assert np.abs(values["touch"]).max() > 1e-3
        check(values, Reference(solved, x))


def test_stop_torque_is_half_the_difference_of_the_two_joints_that_share_a_tendon(
    shadow: Hand, solved: Solved
) -> None:
    """By hand: tau_2 = F + lam and tau_1 = F - lam, so lam = (tau_2 - tau_1) / 2."""
    if solved.task.hand is not shadow:
        assert "stop" not in terms(solved, solved.x)
        return
    pairs = [
        (shadow.joint_index(f"{prefix}J2"), shadow.joint_index(f"{prefix}J1"))
        for prefix in ("FF", "MF", "RF")
    ]
    for seed in range(5):
        x = solved.disturbed(np.random.default_rng(seed))
        torque = Reference(solved, x).torque()
        by_hand = [(torque[a] - torque[b]) / 2 / LEVER for a, b in pairs]
        np.testing.assert_allclose(terms(solved, x)["stop"], by_hand, rtol=0, atol=1e-9)
    assert (terms(solved, solved.x)["stop"] >= -SOLVED_TOL).all()


def test_table_and_object_terms_are_clearances_of_the_right_balls(solved: Solved) -> None:
    """``Surface.clearance`` itself is compared with the true distance in ``test_surfaces``."""
    task = solved.task
    for x in (solved.x, solved.disturbed(np.random.default_rng(0))):
        ref, values = Reference(solved, x), terms(solved, x)
        heights = [
            task.T_world_object.act(ref.ball(b.joint_id, b.center))[2] - b.radius
            for b in hull_spheres(task.hand)
        ]
        expected = np.array(heights) - task.table_height - OPTIONS.clear_table
        np.testing.assert_allclose(values["table"], expected, rtol=0, atol=1e-12)
        counted = [
            b for b in link_spheres(task.hand) if not (b.is_pad and b.finger in task.finger_names)
        ]
        surface = solved.problem.surface
        size = surface.size(task.object.shape)
        smooth = [
            float(surface.clearance(size, ref.ball(b.joint_id, b.center))) - b.radius
            for b in counted
        ]
        np.testing.assert_allclose(
            values["object"], np.array(smooth) - [least_gap(task, b) for b in counted], atol=1e-12
        )


def least_gap(task: GraspTask, ball: LinkSphere) -> float:
    """Distance (m) that a ball must keep from the object."""
    on_tip = ball.on_tip and ball.finger in task.finger_names
    return OPTIONS.clear_tip if on_tip else OPTIONS.clear_object


def test_a_solution_keeps_its_margins_on_the_true_shapes(solved: Solved) -> None:
    """Balls of a solution, measured by the shape's own distance, the obstacle's by numpy."""
    task, ref = solved.task, Reference(solved, solved.x)
    for b in link_spheres(task.hand):
        center = ref.ball(b.joint_id, b.center)
        if not (b.is_pad and b.finger in task.finger_names):
            gap = float(task.object.shape.signed_distance(center[None])[0]) - b.radius
            assert gap > least_gap(task, b) - SOFT, (b.geometry, gap)
        for o in task.obstacles:
            local = o.T_world_obstacle.actInv(task.T_world_object.act(center))
            outside = np.maximum(np.abs(local) - o.size / 2, 0.0)
            assert np.linalg.norm(outside) - b.radius > OPTIONS.clear_table - SOFT, b.geometry


def test_a_solution_satisfies_every_term_with_its_own_base_as_reference(solved: Solved) -> None:
    programme = Constrained(solved.problem)
    violations = programme.violations(solved.x, solved.parameters, solved.task)
    assert max(violations.values()) <= SOLVED_TOL
    ref = Reference(solved, solved.x)
    check(terms(solved, solved.x), ref, tolerance=1e-6)
    np.testing.assert_allclose(ref.outward, solved.normals, atol=1e-6)


def test_contacts_stay_inside_the_patch_that_a_finger_was_given(solved: Solved) -> None:
    half = solved.task.object.shape.half_extents
    margin = np.minimum(EDGE_MARGIN, half / 4)
    assert len({patch.name for patch in solved.start.patches}) > 1 or half[0] == half[1]
    for patch, p, n in zip(
        solved.start.patches, solved.solution.points, solved.normals, strict=True
    ):
        if patch.name == "side":
            assert n[2] == 0.0
            assert abs(p[2]) <= half[2] - margin[2] + 1e-9
        else:
            axis = "xyz".index(patch.name[1])
            np.testing.assert_array_equal(n, patch.code)
            assert p[axis] == pytest.approx(patch.code[axis] * half[axis], abs=1e-9)
            others = np.arange(3) != axis
            assert (np.abs(p) <= half - margin + 1e-9)[others].all()


def test_programmes_are_built_once_for_a_hand_however_often_it_is_loaded() -> None:
    first, again = (
        problems_for(GraspTask.create(load_hand("allegro_hand"), size))
        for size in ("sphere:0.03", "sphere:0.04")
    )
    assert first.grasp is again.grasp
    other = problems_for(GraspTask.create(load_hand("shadow_hand"), "sphere"))
    assert other.grasp is not first.grasp


def test_a_thumb_that_faces_the_next_face_starts_on_the_face_opposite_the_others(
    edit_hand: Callable[..., Path],
) -> None:
    # the thumb's pad is turned by 55 degrees, as on thumbs that swing sideways alone
    pad = 'geom = "thumb_pad"\ncenter = [0.0, 0.0, 0.0423]\nradius = 0.012\naxis = '
    turned = [float(np.cos(np.deg2rad(100))), 0.0, float(np.sin(np.deg2rad(100)))]
    was = "[0.7071067811865476, 0.0, 0.7071067811865476]"
    path = edit_hand({f"{pad}{was}": f"{pad}{turned}"})
    seeder = Seeder(GraspTask.create(load_hand(path), "box:0.05x0.05x0.08"))
    assert seeder.aside.tolist() == [True, False, False, False]
    rng = np.random.default_rng(0)
    for _ in range(10):
        start = seeder.draw(rng)
        assert isinstance(start, Start)
        held = [np.flatnonzero(p.lower == p.upper)[0] for p in start.patches]
        sides = [np.sign(p.lower[k]) for p, k in zip(start.patches, held, strict=True)]
        others = [(k, s) for k, s in zip(held[1:], sides[1:], strict=True)]
        most = max(set(others), key=others.count)
        assert (held[0], sides[0]) == (most[0], -most[1])
