"""A new clearance is one term in one file: NumPy and compiled loops evaluate it, print shows it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from planner import GraspTask, plan_grasp
from planner.errors import TaskError
from planner.kinematics import HandState
from planner.numerics.kernels import compiled_searches
from planner.spatial import SE3, FloatArray
from planner.synthesis import (
    GraspSymbols,
    Role,
    SphereClearance,
    SynthesisOptions,
    Term,
    hull_spheres,
    link_spheres,
    register_term,
)
from planner.synthesis.link_spheres import LinkSphere
from planner.synthesis.loops import solver
from planner.synthesis.loops.solver import LoopResiduals, loop_problem
from planner.synthesis.problem import GraspProblem, Start, problems_for
from planner.synthesis.residuals import Residuals
from planner.synthesis.seeds import seeder_for
from planner.synthesis.terms.registry import TERMS

WALL = np.array([1.0, 0.0, 0.0, 0.1])
"""A second plane, object frame: its normal, and where along it the plane is, m."""

BALLS = np.array([[0.05, 0.06, 0.02, 0.02], [-0.05, 0.06, 0.02, 0.03]])
"""Centres and radii of balls that the hand keeps away from, object frame, m."""

APART = 0.004
"""Clearance of both, m."""

BEHIND_WALL = Term(
    name="behind_wall",
    meaning="distance of the links' hull from a wall, less 4 mm",
    role=Role.INEQUALITY,
    unit="m",
    weight=700.0,
    clearance=SphereClearance(
        spheres=hull_spheres,
        numbers=lambda g: [g.parameter("behind_wall_plane", 4)],
        distance=lambda g, plane, point: ca.dot(plane[:3], point) - plane[3],
        least=lambda g, sphere: (sphere.radius, APART),
    ),
    wording="clearance of {} from the wall",
    lacking="links would stand in the wall",
)


def _of_fingers(g: GraspSymbols, sphere: LinkSphere) -> tuple[Any, ...] | None:
    return (sphere.radius + APART,) if sphere.finger else None


OFF_BALLS = Term(
    name="off_balls",
    meaning="distance of the fingers' spheres from balls, less 4 mm",
    role=Role.INEQUALITY,
    unit="m",
    weight=1e3,
    clearance=SphereClearance(
        spheres=link_spheres,
        numbers=lambda g: [ca.SX(ball) for ball in BALLS],
        distance=lambda g, ball, point: ca.norm_2(point - ball[:3]) - ball[3],
        least=_of_fingers,
    ),
)

OWN = {term.name: term for term in (BEHIND_WALL, OFF_BALLS)}


def options(*terms: str) -> SynthesisOptions:
    """Options without rounds, with these terms."""
    return SynthesisOptions(rounds=0, terms=terms)


@pytest.fixture(autouse=True)
def registered() -> Iterator[None]:
    for term in OWN.values():
        register_term(term)
    yield
    for name in OWN:
        del TERMS[name]


Placed = tuple[GraspTask, GraspProblem, Start, FloatArray]


@pytest.fixture(params=["cylinder:0.03x0.1", "mug"])
def placed(request: pytest.FixtureRequest) -> Placed:
    """A problem with these terms on a primitive and on a mesh, a start, and parameters."""
    task = GraspTask.create("allegro_hand", request.param)
    problem, seeder = problems_for(task, options(*OWN).form).grasp, seeder_for(task)
    drawn = (seeder.draw(np.random.default_rng([0, k])) for k in range(20))
    start = next(s for s in drawn if isinstance(s, Start))
    own = {"behind_wall_plane": WALL}
    return task, problem, start, problem.parameters(task, start, seeder.posture, options(*OWN), own)


def both_of(placed: Placed) -> tuple[Residuals, LoopResiduals]:
    """The residuals in NumPy and in loops."""
    task, problem, _, parameters = placed
    field = problem.surface.field_of(task.object.shape)
    plain = problem.residuals.clone()
    plain.set_parameters(parameters, field)
    loops = loop_problem(problem.residuals)
    assert loops is not None
    return plain, LoopResiduals(loops, parameters, field)


def in_the_way(placed: Placed) -> FloatArray:
    """The unknowns at the start, shifted until a finger is in a ball."""
    task, problem, start, _ = placed
    lower, upper = problem.bounds(start)
    x = np.clip(problem.first(start), lower, upper)
    unknowns = problem.formulation.unknowns
    state = HandState(task.hand, unknowns.q(x))
    finger = [b for b in link_spheres(task.hand) if b.finger][-1]
    at = state.joint_pose(finger.joint_id).act(finger.center)
    pose = unknowns.pose(x, SE3(start.T_object_base.rotation, np.zeros(3)))
    x[3:6] += BALLS[0, :3] + np.array([0.004, 0.006, 0.002]) - pose.act(at)
    return np.clip(x, lower, upper)


def truth(placed: Placed, x: FloatArray) -> dict[str, float]:
    """Least clearance of each term by Pinocchio, written out once more."""
    task, problem, start, _ = placed
    unknowns = problem.formulation.unknowns
    pose = unknowns.pose(x, SE3(start.T_object_base.rotation, np.zeros(3)))
    state = HandState(task.hand, unknowns.q(x))

    def centres(spheres: tuple[LinkSphere, ...]) -> FloatArray:
        return np.array([pose.act(state.joint_pose(b.joint_id).act(b.center)) for b in spheres])

    hull = hull_spheres(task.hand)
    from_wall = centres(hull) @ WALL[:3] - WALL[3] - [b.radius for b in hull]
    fingers = tuple(b for b in link_spheres(task.hand) if b.finger)
    off = np.linalg.norm(centres(fingers)[:, None] - BALLS[:, :3], axis=2) - BALLS[:, 3]
    off -= np.array([b.radius for b in fingers])[:, None]
    return {"behind_wall": from_wall.min() - APART, "off_balls": off.min() - APART}


def test_both_roads_give_the_clearances_that_pinocchio_gives(
    placed: Placed, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(solver, "compile_loops", lambda loops: loops)
    _, problem, start, _ = placed
    plain, loops = both_of(placed)
    lower, upper = problem.bounds(start)
    x = in_the_way(placed)
    plain(x)
    loops.minimise(x, lower=lower, upper=upper, scale=np.ones(len(x)), max_iterations=1)
    expected = {name: max(0.0, -least) for name, least in truth(placed, x).items()}
    assert all(v > 0.005 for v in expected.values()), "else it proves nothing"
    for found in (plain.violations(), loops.violations()):
        assert {name: found[name] for name in OWN} == pytest.approx(expected, abs=1e-9)


def test_its_derivatives_are_those_of_finite_differences(placed: Placed) -> None:
    plain, _ = both_of(placed)
    x, rng = in_the_way(placed), np.random.default_rng(1)

    def rows_at(x: FloatArray) -> tuple[dict[tuple[str, int], float], FloatArray]:
        values, jacobian = plain(x)
        names = plain.row_names()
        mine = [k for k, row in enumerate(names) if row.term.name in OWN]
        keys = [(names[k].term.name, names[k].number) for k in mine]
        return dict(zip(keys, values[mine].tolist(), strict=True)), jacobian[mine].copy()

    values, jacobian = rows_at(x)
    assert {name for name, _ in values} == set(OWN)
    for _ in range(5):
        way = rng.normal(size=len(x))
        ahead, behind = (rows_at(x + step * way)[0] for step in (1e-6, -1e-6))
        for k, key in enumerate(values):
            if key in ahead and key in behind:
                slope = (ahead[key] - behind[key]) / 2e-6
                assert slope == pytest.approx(float(jacobian[k] @ way), rel=1e-5, abs=1e-3)


def test_both_roads_take_the_same_steps(placed: Placed, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(solver, "compile_loops", lambda loops: loops)
    _, problem, start, _ = placed
    lower, upper = problem.bounds(start)
    x = in_the_way(placed)
    ends = [
        r.minimise(x, lower=lower, upper=upper, scale=np.full(len(x), 0.05), max_iterations=4)
        for r in both_of(placed)
    ]
    assert np.allclose(ends[0].x, ends[1].x, rtol=0, atol=1e-9)
    assert ends[0].worst == pytest.approx(ends[1].worst, abs=1e-7)


def test_it_is_printed_as_it_is_solved(placed: Placed) -> None:
    _, problem, _, _ = placed
    lines = {line.split()[0]: line for line in str(problem).splitlines()[3:]}
    hull, fingers = hull_spheres(problem.hand), link_spheres(problem.hand)
    n_fingers = sum(bool(b.finger) for b in fingers)
    assert lines["behind_wall"].split()[1:4] == [str(len(hull)), ">=", "0"]
    assert lines["off_balls"].split()[1:4] == [str(2 * n_fingers), ">=", "0"]
    for term in OWN.values():
        assert f"{term.weight:9.4g}" in lines[term.name] and term.meaning in lines[term.name]
    terms = {w.term.name: w for w in problem.terms}
    assert terms["behind_wall"].expression.numel() == len(hull)
    assert terms["off_balls"].expression.numel() == 2 * n_fingers


@pytest.mark.parametrize("compiled", [False, True], ids=["numpy", "numba"])
def test_a_plan_keeps_it(compiled: bool) -> None:
    task = GraspTask.create("allegro_hand", "cylinder:0.03x0.1")
    asked = options("off_balls")
    if compiled:
        with compiled_searches():
            plan = plan_grasp(task, seed=0, options=asked)
    else:
        plan = plan_grasp(task, seed=0, options=asked)
    to_object = task.T_world_object.inverse() * plan.T_world_base
    state = HandState(task.hand, plan.q)
    off = min(
        np.linalg.norm(to_object.act(state.joint_pose(b.joint_id).act(b.center)) - ball[:3])
        - ball[3]
        - b.radius
        for b in link_spheres(task.hand)
        if b.finger
        for ball in BALLS
    )
    assert off > APART - 1e-3


def test_a_distance_of_more_than_its_numbers_is_refused() -> None:
    assert OFF_BALLS.clearance is not None
    wrong = replace(
        OFF_BALLS.clearance, distance=lambda g, ball, point: ca.norm_2(point - ball[:3]) - g.mu
    )
    TERMS["off_balls"] = replace(OFF_BALLS, clearance=wrong)
    with pytest.raises(TaskError, match=r"off_balls.*numbers="):
        problems_for(GraspTask.create("allegro_hand", "sphere:0.033"), options(*OWN).form)


def test_a_term_with_two_kinds_of_rows_is_refused() -> None:
    with pytest.raises(TaskError, match="two kinds"):
        register_term(replace(OFF_BALLS, name="both", write=lambda g: []))
    with pytest.raises(TaskError, match=r"role=Role\.INEQUALITY"):
        register_term(replace(OFF_BALLS, name="soft", role=Role.COST))


def test_a_margin_beside_least_and_three_parts_of_it_are_refused() -> None:
    with pytest.raises(TaskError, match=r"margin 0\.02; put it into what its least="):
        register_term(replace(OFF_BALLS, name="wide", margin=0.02))
    assert OFF_BALLS.clearance is not None
    three = replace(OFF_BALLS.clearance, least=lambda g, sphere: (sphere.radius, APART, APART))
    TERMS["off_balls"] = replace(OFF_BALLS, clearance=three)
    with pytest.raises(TaskError, match="give one or two"):
        problems_for(GraspTask.create("allegro_hand", "sphere:0.034"), options(*OWN).form)
