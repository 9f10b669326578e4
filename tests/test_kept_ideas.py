"""Ideas that hold the house up, each guarded: who recomputes, who judges, who knows no engine.

Others have their guards beside what they guard: contact sets that reach neither hand nor engine and
the bridge as the only door to MuJoCo in ``test_architecture``, certificates of closure and proofs
of infeasibility in ``test_quality_closure`` and ``test_forces``, attempts that depend on seed and
number alone in ``test_search``.
"""

from __future__ import annotations

import copy
import math
from dataclasses import fields, replace

import numpy as np
import pytest
from test_architecture import imports_of, sources, within
from test_sim_verdict import held, verdict

from planner.collision.world import CollisionWorld
from planner.hands.hand import Hand
from planner.motion import ObjectPath, motion_attempts
from planner.search.grasp import attempts, plan_grasp
from planner.task import GraspTask
from planner.verification import verify_geometry
from sim.scene.physics import PhysicsOptions


def modules_of(*rooms: str) -> list[str]:
    found = [m for m in sources() if any(within(m, room) for room in rooms)]
    assert found
    return found


# --- residuals recomputed by a second engine ---------------------------------------------------


def test_the_verdict_on_a_grasp_never_asks_the_solver() -> None:
    """What CasADi has solved is recomputed by Pinocchio and coal."""
    solver = ("casadi", "planner.synthesis", "planner.synthesis.symbols")
    rooms = (
        "planner.verification",
        "planner.collision.world",
        "planner.shapes.convex_pairs",
        "planner.collision.pregrasp",
        "planner.collision.pregrasp_ik",
        "planner.collision.arm_path",
    )
    for module in modules_of(*rooms):
        asked = {i for i in imports_of(module) for s in solver if within(i, s)}
        assert not asked, module


@pytest.mark.parametrize("finger", ["thumb", "index", "middle", "ring"])
def test_joints_that_the_solver_did_not_mean_are_found_out(allegro: Hand, finger: str) -> None:
    """A joint that is 4 degrees off moves its pad by half a millimetre and more."""
    plan = plan_grasp(GraspTask.create(allegro, "sphere", fingers=[*allegro.fingers]))
    world = CollisionWorld(plan.task)
    assert verify_geometry(world, plan.T_world_base, plan.q).ok
    for sign in (-1.0, 1.0):
        q = plan.q.copy()
        q[allegro.fingers[finger].q_index[1]] += sign * math.radians(4.0)
        found = verify_geometry(world, plan.T_world_base, q)
        assert not found.ok
        assert any(finger in fault for fault in map(str, found.failures)), found.failures


# --- attempts by seed and number ---------------------------------------------------------------


@pytest.mark.slow
def test_attempts_are_numbered_streams_of_their_seed(allegro: Hand) -> None:
    """Attempt k of a seed is the same whichever were made before it; seeds differ."""
    task = GraspTask.create(allegro, "cylinder:0.03x0.1", fingers=["thumb", "index", "middle"])
    path = ObjectPath(axis=np.array([0.0, 0.0, 1.0]), angle=0.3, shift=np.zeros(3))
    first, again, other = (
        [a for a, _ in zip(motion_attempts(task, path, seed=s), range(2), strict=False)]
        for s in (4, 4, 5)
    )
    assert [a.index for a in first] == [0, 1]
    assert [str(a.failure) for a in first] == [str(a.failure) for a in again]
    found = [a.plan.knots[-1].q for a in (*first, *again, *other) if a.plan is not None]
    assert len(found) == 6
    np.testing.assert_array_equal(found[0], found[2])
    np.testing.assert_array_equal(found[1], found[3])
    assert np.abs(found[0] - found[1]).max() > 1e-3
    assert np.abs(found[0] - found[4]).max() > 1e-3
    # not seed + index: the second attempt of a seed is not the first of the next
    grasps = [next(iter(attempts(task, seed=s))) for s in (4, 5)]
    second = list(zip(attempts(task, seed=4), range(2), strict=False))[1][0]
    poses = [a.plan.q for a in (*grasps, second) if a.plan is not None]
    assert len(poses) == 3
    assert min(np.abs(poses[i] - poses[j]).max() for i, j in ((0, 1), (0, 2), (1, 2))) > 1e-3


# --- verdicts and controllers without an engine ------------------------------------------------


def test_controllers_and_verdicts_do_not_know_the_simulator() -> None:
    """What drives a simulated hand could drive a real one; what judges needs samples alone."""
    above = (
        "mujoco",
        "planner.bridge",
        "sim.scene.build",
        "sim.trial",
        "sim.scene.physics",
        "sim.contacts",
    )
    for module in modules_of("sim.controllers", "sim.verdict"):
        known = {i for i in imports_of(module) for name in above if within(i, name)}
        assert not known, module


def test_the_same_samples_have_the_same_verdict() -> None:
    """A pure function: nothing is kept between trials, and nothing is written into samples."""
    samples = held()
    before = copy.deepcopy(samples)
    lost = replace(samples, slip_mm=np.full_like(samples.slip_mm, 50.0))
    good, bad = verdict(samples), verdict(lost)
    assert good.success and not bad.success
    assert (verdict(samples), verdict(lost), verdict(samples)) == (good, bad, good)
    for field in fields(samples):
        np.testing.assert_array_equal(getattr(samples, field.name), getattr(before, field.name))


# --- physics with reasons ----------------------------------------------------------------------


def test_every_number_of_the_physics_says_what_it_is_for() -> None:
    text = PhysicsOptions.__doc__
    assert text is not None
    attributes = text.split("Attributes:")[1]
    for field in fields(PhysicsOptions):
        told = attributes.split(f" {field.name}: ")
        assert len(told) == 2, field.name
        assert len(told[1].split("\n        ")[0].split()) > 2, field.name
