"""Tilts and translations in the hand: what stands afterwards, the way back, and the whole run."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from manipulations import DT, QUICK, task_of
from typer.testing import CliRunner

from planner.errors import TaskError
from planner.failure import Failure
from planner.motion.ending import backwards, object_at_target, planned_ending, stands
from planner.motion.manipulation import (
    ManipulationPlan,
    on_stand,
    plan_manipulation,
)
from planner.motion.path import ATTITUDES, tilts
from planner.motion.plan import TORSION
from planner.motion.single_stroke import MOST_PIVOT
from planner.spatial import SE3
from planner.task import GraspTask
from sim.cli import app
from sim.controllers.follow import MotionReference
from sim.manipulation import (
    ManipulationReport,
    manipulate,
    rests,
)
from sim.scene.physics import PhysicsOptions

pytestmark = pytest.mark.usefixtures("coarse_steps")

X, Y, Z = np.eye(3)
ANGLE, UP = math.radians(20.0), np.array([0.0, 0.0, 0.008])


@pytest.fixture(scope="module")
def plan() -> ManipulationPlan:
    """A block that an Allegro-type hand tilts and moves up at once."""
    task = task_of("box:0.05x0.05x0.08", mass=0.1, mu=0.5)
    return plan_manipulation(task, axis=Y, angle=ANGLE, shift=UP, place=(0.04, -0.02), seed=0)


@pytest.fixture(scope="module")
def report(plan: ManipulationPlan) -> ManipulationReport:
    return manipulate(plan, physics=PhysicsOptions(mu=0.6), timeline=replace(QUICK, height=0.04))


def _task(spec: str) -> GraspTask:
    return GraspTask.create("allegro_hand", spec)


# --- what stands -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("spec", "axis", "degrees", "whether"),
    [
        ("box:0.05x0.06x0.08", Z, 37.0, True),  # about the vertical anything stands as before
        ("box:0.05x0.06x0.08", Y, 30.0, False),
        ("box:0.05x0.06x0.08", Y, 90.0, True),  # on another face
        ("box:0.05x0.06x0.08", X, -90.0, True),
        ("box:0.05x0.06x0.08", Y, 88.0, False),
        ("cylinder:0.03x0.08", X, 180.0, True),  # upside down
        ("cylinder:0.03x0.08", X, 90.0, False),  # on its side it rolls
        ("sphere:0.03", X, 50.0, True),  # a ball looks the same always
        ("ellipsoid:0.05x0.06x0.08", X, 50.0, False),
    ],
)
def test_what_stands_after_a_turn(
    spec: str, axis: np.ndarray, degrees: float, whether: bool
) -> None:
    assert stands(_task(spec), axis, math.radians(degrees)) is whether


def test_a_stand_holds_what_looks_as_it_did() -> None:
    assert stands(on_stand(_task("sphere:0.03"), 0.05), X, 1.0)
    block = on_stand(_task("box:0.05x0.06x0.08"), 0.05)
    assert stands(block, Z, 1.0, rests=rests)
    assert not stands(block, Y, math.pi / 2)  # it would lie on the walls otherwise


def test_a_target_on_another_face_is_as_high_as_that() -> None:
    target = object_at_target(_task("box:0.05x0.06x0.08"), Y, math.pi / 2, (0.1, 0.2))
    np.testing.assert_allclose(target.translation, [0.1, 0.2, 0.025], atol=1e-12)
    np.testing.assert_allclose(target.rotation @ X, -Z, atol=1e-12)


def test_what_does_not_stand_is_put_down_as_it_was_picked_up(plan: ManipulationPlan) -> None:
    grasp = plan.motion.grasp
    assert plan.ending.back == "turned so it does not stand"
    np.testing.assert_allclose(
        plan.ending.T_world_target.translation, [0.04, -0.02, 0.04], atol=1e-12
    )
    np.testing.assert_allclose(plan.ending.T_world_target.rotation, np.eye(3), atol=1e-12)
    assert plan.ending.release is not None
    np.testing.assert_array_equal(plan.ending.release.q, grasp.q_pregrasp)
    ending = planned_ending(plan.motion, math.pi / 2, None)  # on its side it would stand
    assert not isinstance(ending, Failure)
    assert ending.back == ""
    assert ending.T_world_target.rotation[2] @ Z == pytest.approx(0.0, abs=1e-12)
    assert backwards(plan.motion, None, "so").back == "so"


# --- the plan ----------------------------------------------------------------------------------


def test_what_is_moved_ends_where_it_was_to(plan: ManipulationPlan) -> None:
    path, last = plan.motion.path, plan.motion.knots[-1]
    # the motion goes further than was asked, and as much further up
    np.testing.assert_allclose(path.shift, path.angle / ANGLE * UP, atol=1e-12)
    off = last.T_world_object.translation - plan.motion.knots[0].T_world_object.translation
    np.testing.assert_allclose(off, path.shift, atol=3e-4)
    assert plan.motion.pivoted.max() <= MOST_PIVOT


def test_a_tip_that_stays_while_the_object_spins_under_it_pivots(plan: ManipulationPlan) -> None:
    motion = plan.motion
    first = motion.knots[0]
    spin = SE3(pin.exp3(0.3 * first.contacts.normals[0]), np.zeros(3))
    pose = spin * first.T_world_object
    second = replace(
        first, path_parameter=1.0, T_world_object=pose, contacts=first.contacts.transformed(spin)
    )
    turned = motion.with_knots((first, second))
    along = first.contacts.normals @ first.contacts.normals[0]
    np.testing.assert_allclose(turned.pivoted, 0.3 * np.abs(along), atol=1e-9)
    np.testing.assert_allclose(turned.pivots[0], -0.3 * along, atol=1e-9)
    assert not turned.spins.any(), "palm down"
    sideways = replace(turned, path=replace(turned.path, attitude=ATTITUDES["sideways"]))
    np.testing.assert_allclose(sideways.spins, [-TORSION * np.sign(along)] * 2, atol=1e-9)
    still = motion.with_knots((first, replace(first, path_parameter=1.0)))
    assert still.pivoted.max() < 1e-12


def test_no_regrasps_where_the_object_is_to_be_moved() -> None:
    task = task_of("cylinder:0.03x0.08", mu=0.5)
    with pytest.raises(TaskError, match="made in one stroke"):
        plan_manipulation(task, angle=1.0, shift=UP, regrasp=True)
    with pytest.raises(TaskError, match="made in one stroke"):
        plan_manipulation(task, angle=2 * math.pi, shift=UP)


# --- the way back ------------------------------------------------------------------------------


def test_the_way_back_begins_where_the_object_is_and_ends_where_it_was(
    plan: ManipulationPlan,
) -> None:
    motion = plan.motion
    T_palm_world = motion.grasp.T_world_palm.inverse()
    n = len(motion.grasp.task.fingers)
    reference = MotionReference(motion, back_from=0.5)
    assert reference.place == 0.5
    assert reference.goal == pytest.approx(-0.5 * motion.path.angle)
    begin = T_palm_world * motion.at(0.5)[0]
    q = motion.at(0.5)[1]
    target = reference.advance(DT, begin, np.zeros((n, 3)), q, missed=0.0)
    np.testing.assert_allclose(target.T_palm_object.homogeneous, begin.homogeneous, atol=1e-12)
    while not reference.arrived:
        made = (0.5 - reference.place) * motion.path.angle
        turn = pin.exp3(-made * reference.axis)
        pose = SE3(turn @ begin.rotation, begin.translation)  # follows exactly
        target = reference.advance(DT, pose, np.zeros((n, 3)), q, missed=0.0)
    end = T_palm_world * motion.knots[0].T_world_object
    assert reference.place == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(target.T_palm_object.homogeneous, end.homogeneous, atol=1e-6)
    np.testing.assert_allclose(target.q, motion.knots[0].q, atol=1e-6)


def test_what_is_moved_is_moved_from_where_it_is(plan: ManipulationPlan) -> None:
    motion = plan.motion
    T_palm_world = motion.grasp.T_world_palm.inverse()
    tips = np.zeros((len(motion.grasp.task.fingers), 3))
    aside = np.array([0.002, -0.001, 0.0])
    still = replace(motion, path=replace(motion.path, shift=np.zeros(3)))
    for one, left in ((motion, aside), (still, np.zeros(3))):
        reference = MotionReference(one)
        begin = T_palm_world * one.knots[0].T_world_object
        while not reference.arrived:
            turn = pin.exp3(reference.place * motion.path.angle * reference.axis)
            pose = SE3(turn @ begin.rotation, begin.translation + aside)
            target = reference.advance(DT, pose, tips, motion.grasp.q, missed=0.0)
        end = T_palm_world * one.knots[-1].T_world_object
        np.testing.assert_allclose(
            target.T_palm_object.translation, end.translation + left, atol=1e-6
        )


@pytest.mark.parametrize("place", [0.0, 1.5])
def test_no_way_back_from_nowhere(plan: ManipulationPlan, place: float) -> None:
    with pytest.raises(TaskError, match=r"give a place in \(0, 1\]"):
        MotionReference(plan.motion, back_from=place)


# --- the run -----------------------------------------------------------------------------------


def test_a_block_is_tilted_moved_brought_back_and_placed(
    plan: ManipulationPlan, report: ManipulationReport
) -> None:
    assert report.complete, str(report)
    assert report.success_with_closure
    steps = [c.phase for c in report.results]
    assert steps[steps.index("verify again") :][:3] == ["verify again", "back", "carry"]
    assert math.degrees(report.turned) == pytest.approx(20.5, abs=1.0)
    assert np.linalg.norm(report.shifted - UP) < 2e-3
    back = report.log.during("back")
    assert report.log.turn[back[0]] > 0.9 * ANGLE
    assert abs(report.log.turn[back[-1]]) < math.radians(2.0)
    assert report.results[-1].numbers["off_mm"] < 3.0
    assert report.results[-1].numbers["tilt_deg"] < 0.5
    text = str(report)
    assert "of (0.0, 0.0, 8.0) mm in the hand" in text
    assert "made backwards before it was put down: turned so it does not stand" in text
    data = report.to_dict()
    assert data["asked_shift_mm"] == [0.0, 0.0, 8.0]
    assert data["numbers"]["shift_off_mm"] < 2.0


def test_what_ends_elsewhere_is_not_moved_as_asked(report: ManipulationReport) -> None:
    further = replace(report, asked_shift=UP + 0.004 * X)
    assert not further.success
    assert replace(report, asked_shift=np.zeros(3)).success


# --- the command -------------------------------------------------------------------------------


def test_the_command_warns_of_less_friction_and_refuses_regrasps_of_a_translation() -> None:
    item = ["allegro_on_arm7", "cylinder:0.03x0.08"]
    asked = ["manipulate", *item, "--gait", "--shift", "0,0,0.01", "--sim-mu", "0.3"]
    done = CliRunner().invoke(app, asked)
    assert done.exit_code != 0
    assert "--sim-mu 0.3 is less friction than is believed, --mu 0.45" in done.output
    assert "regrasp" in done.output.partition("0.45")[2]
    done = CliRunner().invoke(app, asked[:-2])
    assert "less friction" not in done.output


def test_turns_about_the_vertical_tilt_nothing() -> None:
    assert not tilts(np.array([0.0, 0.0, -2.0]))
    assert tilts(np.array([0.0, 3.0, 0.0])) and tilts(np.array([0.0, 0.2, 1.0]))
