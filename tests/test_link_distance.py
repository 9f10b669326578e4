"""Clearances of the true links in least squares: linear where they were looked at, and kept."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planner.collision.pad_contact import pad_contact_queries
from planner.collision.world import CollisionWorld
from planner.hands.hand import Hand
from planner.objects import parse_object
from planner.spatial import SE3, FloatArray
from planner.synthesis.optimize import optimize_grasp
from planner.synthesis.options import SynthesisOptions
from planner.synthesis.problem import Candidate, GraspProblem, Start, problems_for
from planner.synthesis.seeds import seeder_for
from planner.synthesis.terms.fingers import capsules_are_true
from planner.synthesis.terms.link_distance import (
    LEAST_DISTANCE,
    MARGIN_IN_VIEW,
    find_link_distances,
)
from planner.task import GraspTask


@pytest.fixture(scope="module", params=["cylinder", "torus"])
def task(request: pytest.FixtureRequest, allegro: Hand) -> GraspTask:
    """The Allegro's links are bars; a torus is a mesh, and stands on a table like the cylinder."""
    return GraspTask.create(allegro, parse_object(request.param))


def _start(task: GraspTask, k: int) -> tuple[GraspProblem, Start]:
    start = seeder_for(task).draw(np.random.default_rng([3, k]))
    assert isinstance(start, Start)
    return problems_for(task).grasp, start


def test_only_hands_of_spheres_and_capsules_have_capsules_that_are_true(
    allegro: Hand, shadow: Hand
) -> None:
    assert capsules_are_true(shadow)
    assert not capsules_are_true(allegro)


def test_gaps_are_what_coal_measures_and_change_as_they_say(task: GraspTask) -> None:
    """A little away in every unknown the distance of nearly every pair is the one foretold."""
    world, rng, options = CollisionWorld(task), np.random.default_rng(4), SynthesisOptions()
    problem, start = _start(task, 0)
    unknowns = problem.formulation.unknowns
    names = pad_contact_queries(task).names
    pads = [f.pad.joint_id for f in task.fingers]
    errors, outward, short = [], 0, 0

    def look(x: FloatArray, limit: float) -> tuple[SE3, dict[int, float]]:
        pose = problem.base_pose(start, x)
        near = world.near(
            task.T_world_object * pose, unknowns.q(x), limit, may_touch=names, meshes=False
        )
        asked = np.where(np.isin(near.joints[:, 0], pads), options.clear_tip, LEAST_DISTANCE)
        asked = np.where(near.hand_environment, asked, options.clear_fingers)
        found = zip(near.numbers.tolist(), near.distances - asked, strict=True)
        return pose, {number: float(value) for number, value in found if value < limit}

    for _ in range(120):
        x = problem.first(start)
        x[:6] += rng.normal(0, [0.3, 0.3, 0.3, 0.02, 0.02, 0.02])
        x[6 : 6 + task.hand.nq] = rng.uniform(task.hand.q_lower, task.hand.q_upper)
        pose, there = look(x, 0.006)
        gaps = find_link_distances(
            world,
            unknowns,
            x,
            pose,
            clear_tip=options.clear_tip,
            clear_fingers=options.clear_fingers,
        )
        kept = {number: value for number, value in there.items() if value < MARGIN_IN_VIEW}
        if gaps is None:
            assert not kept
            continue
        assert sorted(gaps.values) == pytest.approx(sorted(kept.values()))
        short += int((gaps.values < 0.0).sum())
        outward += int(gaps.rows[:, 3:6].any(axis=1).sum())
        step = 2e-5 * rng.normal(size=len(x))
        after = look(x + step, 0.02)[1]
        for (number, value), row in zip(kept.items(), gaps.rows, strict=True):
            if value > 0.0:  # apart: in penetration coal's distance is not smooth
                errors.append(abs(after[number] - value - row @ step))
    assert len(errors) > 20
    assert outward > 10
    assert short > 20
    # where two faces are parallel the nearest points, and with them the slope, may jump
    assert np.quantile(errors, 0.8) < 2e-8


def _ends(task: GraspTask, apart: float, k: int) -> tuple[Candidate, Candidate]:
    """Where a start leads without and with a look at the true links."""
    problem, start = _start(task, k)
    options = SynthesisOptions(rounds=0)
    parameters = problem.parameters(task, start, seeder_for(task).posture, options)
    asked = replace(options, clear_fingers=apart)
    world = CollisionWorld(task)
    return (
        optimize_grasp(problem, task, start, parameters, options),
        optimize_grasp(problem, task, start, parameters, asked, world),
    )


def test_fingers_end_as_far_apart_as_is_asked_and_still_touch(allegro: Hand) -> None:
    """Over twice as far as they come to be without: capsules know nothing of it, the look does."""
    task = GraspTask.create(allegro, parse_object("cylinder"))
    world, better = CollisionWorld(task), 0

    def least(found: Candidate) -> float:
        base = task.T_world_object * found.T_object_base
        near = world.near(base, found.q, 0.05)
        return float(near.distances[~near.hand_environment].min())

    for k in range(4):
        before = least(_ends(task, 0.002, k)[0])
        plain, kept = _ends(task, 2.2 * before, k)
        assert least(plain) == pytest.approx(before)
        solved = kept.violation["touch"] < 1e-4 and kept.violation["balance"] < 5e-3
        better += solved and least(kept) > 2.0 * before
    assert better >= 3
