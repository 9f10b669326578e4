"""Trials on what there really is: the plan keeps its belief, the world does not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import PlanOf
from typer.testing import CliRunner

from planner.contacts import ContactSet
from planner.errors import TaskError
from planner.objects import parse_object
from planner.plan import GraspPlan
from planner.search.from_cloud import CloudPlan, plan_from_cloud
from planner.spatial import SE3
from sim.cli import app
from sim.cli.common import EXIT_BAD_INPUT
from sim.controllers.base import PHASES
from sim.controllers.grasp import (
    MOST_FELT,
    MOST_FREE,
    GraspController,
    felt_contacts,
    not_closed,
)
from sim.scan import scan, write_scan
from sim.scene.build import OBJECT, TABLE, Truth
from sim.sensing.errors import ErrorModel
from sim.simulation import Simulation
from sim.trial import Timeline, Trial, TrialOptions, run_grasp_phase, simulate

pytestmark = pytest.mark.usefixtures("coarse_steps")

RUN = CliRunner()
QUICK = Timeline.quick(close_wait=1.0)


@pytest.fixture(scope="module")
def plan(plan_of: PlanOf) -> GraspPlan:
    return plan_of("allegro_hand", "box")


def test_a_truth_that_is_the_belief_changes_nothing(plan: GraspPlan) -> None:
    task = plan.task
    same = Truth(object=task.object, T_world_object=task.T_world_object, table_height=0.0)
    believed, there = (Simulation(plan, truth=truth) for truth in (None, same))
    for simulation in (believed, there):
        for _ in simulation.run("approach", 0.05):
            pass
    assert np.array_equal(believed.data.qpos, there.data.qpos)


def test_geometry_and_mass_are_the_truth_and_the_frame_is_the_belief(plan: GraspPlan) -> None:
    """Every point of the object is where the truth has it, though its body is elsewhere."""
    turn = SE3(np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.zeros(3))
    item = parse_object("box:0.06x0.04x0.07", mass=0.3)
    place = SE3(np.eye(3), np.array([0.004, -0.003, 0.035])) * turn
    simulation = Simulation(plan, truth=Truth(object=item, T_world_object=place))
    model, data = simulation.scene.model, simulation.data
    assert np.allclose(simulation.T_world_object.homogeneous, plan.task.T_world_object.homogeneous)
    geom = model.geom(OBJECT).id
    assert np.allclose(data.geom_xpos[geom], place.translation, atol=1e-12)
    assert np.allclose(np.abs(data.geom_xmat[geom].reshape(3, 3)), np.abs(place.rotation))
    assert np.allclose(model.geom_size[geom], [0.03, 0.02, 0.035])
    body = simulation.scene.object_body
    assert model.body_mass[body] == 0.3
    assert np.allclose(data.xipos[body], place.translation, atol=1e-12)
    full = data.ximat[body].reshape(3, 3) @ np.diag(model.body_inertia[body])
    full = full @ data.ximat[body].reshape(3, 3).T
    assert np.allclose(full, place.rotation @ item.shape.inertia(0.3) @ place.rotation.T)


def test_fingers_close_on_a_shifted_truth_and_hold_it_where_it_is(plan: GraspPlan) -> None:
    task = plan.task
    along = plan.contacts.normals[0]  # fingers close along x of the box
    shifted = SE3(np.eye(3), 0.004 * along) * task.T_world_object
    report = simulate(plan, truth=Truth(object=task.object, T_world_object=shifted))
    assert report.success
    # contacts are compared in the frame of the belief: they are off by the shift
    off = [c.position_error_mm for c in report.comparison]
    assert off == pytest.approx([4.0] * len(off), abs=0.5)


def test_a_truth_far_from_the_belief_is_not_held(plan: GraspPlan) -> None:
    away = SE3(np.eye(3), np.array([0.15, 0.0, 0.0])) * plan.task.T_world_object
    report = simulate(plan, truth=Truth(object=plan.task.object, T_world_object=away))
    assert not report.success
    assert "too few fingers" in report.verdict.detail or report.reason


def test_two_truths_are_refused(plan: GraspPlan) -> None:
    truth = Truth(object=plan.task.object, T_world_object=plan.task.T_world_object)
    wrongs: tuple[dict[str, Any], ...] = ({"object_size": 0.1}, {"object_center": 0.1})
    for wrong in wrongs:
        with pytest.raises(TaskError, match="a truth tells"):
            Simulation(plan, truth=truth, error_model=replace(ErrorModel(name="other"), **wrong))


def test_a_cloud_takes_no_options_of_an_object(tmp_path: Path) -> None:
    file = tmp_path / "cloud.ply"
    write_scan(scan(parse_object("box")), file)
    for words, said in (
        (["--at", "0,0"], "--at"),
        (["--density", "900", "--repair"], "--density, --repair"),
        (["-n", "2"], "one grasp is planned"),
        (["--table", "0.1"], "--table find"),
        (["--cloud-error", "5 inches"], "no length"),
        (["--cloud-error", "5mm,x"], "a length and degrees"),
        (["--cloud-error", "5mm,400"], "at most 0.1 m"),
    ):
        done = RUN.invoke(app, ["plan", "allegro_hand", str(file), *words])
        assert done.exit_code == EXIT_BAD_INPUT
        assert said in " ".join(done.output.split())


def test_the_table_is_where_it_really_is(plan: GraspPlan) -> None:
    task = plan.task
    lower = Truth(object=task.object, T_world_object=task.T_world_object, table_height=-0.004)
    model = Simulation(plan, truth=lower).scene.model
    table = model.geom(TABLE)
    assert model.body(table.bodyid[0]).pos[2] + table.size[2] == pytest.approx(-0.004)


def test_what_is_no_truth_and_no_object_is_told() -> None:
    for wrong in (scan(parse_object("sphere")).cloud(), "cloud.ply"):
        with pytest.raises(TaskError, match="give what there really is"):
            TrialOptions(truth=wrong)  # type: ignore[arg-type]
    with pytest.raises(TaskError, match="the object to scan is 'sphere'"):
        scan("sphere")  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def seen() -> tuple[CloudPlan, Truth]:
    """The plan of a scanned box with another one, and the box."""
    found = scan(parse_object("box:0.05x0.05x0.07"), views=2, seed=4)
    plan = plan_from_cloud("allegro_hand", found.cloud(table=0.0), seed=0)
    return replace(plan, others=(replace(plan, others=()),)), found.truth


def test_an_object_that_is_not_there_is_not_lifted_and_the_next_plan_is_tried(
    seen: tuple[CloudPlan, Truth],
) -> None:
    found, truth = seen
    away = SE3(np.eye(3), np.array([0.3, 0.0, 0.0])) * truth.T_world_object
    report = simulate(found, truth=replace(truth, T_world_object=away), timeline=QUICK)
    assert not report.success
    # this plan, the other one, and one that is planned anew when none is left
    assert report.tries == ("not lifted, no finger feels the object",) * 3
    assert len(report.to_dict(states=False)["tries"]) == 3


def test_a_try_ends_open_and_away_and_the_next_holds_the_object_where_it_is(
    seen: tuple[CloudPlan, Truth],
) -> None:
    found, truth = seen
    trial = Trial(found.plan, truth=truth, timeline=QUICK)
    for phase in PHASES[:3]:
        assert run_grasp_phase(trial.simulation, trial.recorder, trial.timeline, phase)
    pushed = trial.simulation.T_world_object
    following, there = trial.tried_again(found)
    simulation = trial.simulation
    assert not simulation.touching()
    start = found.plan.T_world_base_start.translation
    assert np.linalg.norm(simulation.T_world_base.translation - start) < 0.01
    assert following is not None and not following.others
    assert there is not None
    moved = simulation.T_world_object * found.plan.task.T_world_object.inverse()
    assert np.allclose(there.T_world_object.homogeneous,
                       (moved * truth.T_world_object).homogeneous)  # fmt: skip
    assert np.linalg.norm((pushed.inverse() * simulation.T_world_object).translation) < 0.01
    assert len(following.belief.places) > len(found.belief.places)
    assert simulate(following, truth=there, timeline=QUICK).success


def test_the_next_try_has_the_errors_of_the_first_and_the_object_where_it_was_left(
    seen: tuple[CloudPlan, Truth], monkeypatch: pytest.MonkeyPatch
) -> None:
    """An error model of sizes and centres, which no truth may tell too."""
    made: list[tuple[Simulation, SE3]] = []

    def given_up(trial: Trial) -> None:
        made.append((trial.simulation, trial.simulation.T_world_object))
        trial.not_lifted = "no finger feels the object"

    monkeypatch.setattr(Trial, "perform", given_up)
    errors = ErrorModel(object_size=0.05, object_center=0.1, seed=3)
    short = replace(QUICK, approach=0.05)
    report = simulate(seen[0], error_model=errors, timeline=short, tries=3)
    assert len(report.tries) == len(made) == 3
    (first, _), (_, second), _ = made
    assert np.allclose(first.T_world_object.homogeneous, second.homogeneous, atol=1e-9)


def test_each_try_has_a_controller_of_its_plan_and_tries_are_counted(
    seen: tuple[CloudPlan, Truth],
) -> None:
    found, truth = seen
    with pytest.raises(TaskError, match=r"GraspController, made for one plan, and 2 may be tried"):
        simulate(found, truth=truth, controller=GraspController(found.plan))
    for wrong in (0, -1, "2", True):
        with pytest.raises(TaskError, match=r"tries is .*; give a whole number from 1"):
            simulate(found, tries=wrong)  # type: ignore[arg-type]


def test_forces_are_planned_over_the_contacts_that_are_felt(
    seen: tuple[CloudPlan, Truth],
) -> None:
    """Each felt place is that of its force, and all of them balance the weight."""
    found, truth = seen
    beside = SE3(np.eye(3), np.array([0.003, 0.003, 0.0])) * truth.T_world_object
    trial = Trial(found.plan, truth=replace(truth, T_world_object=beside), timeline=QUICK)
    simulation, controller = trial.simulation, trial.simulation.controller
    assert isinstance(controller, GraspController)
    for phase in PHASES[:2]:
        run_grasp_phase(simulation, trial.recorder, QUICK, phase)
    for _ in simulation.run("squeeze", 0.004):
        pass
    assert not controller.refused
    seen_now = simulation.observe("squeeze", 0.0)
    felt, contacts = felt_contacts(found.plan, seen_now)
    at = simulation.T_world_object.inverse()
    off = np.linalg.norm(contacts.transformed(at).positions - controller._points, axis=1)
    assert felt.all() and off.max() < 0.001
    planned = found.plan.contacts_in_object.positions
    assert np.linalg.norm(controller._points - planned, axis=1).max() > 0.001
    most = MOST_FREE * found.plan.contacts.forces[:, 0].max()
    assert np.linalg.norm(controller._forces, axis=1).max() < 1.2 * most
    weight = found.plan.task.object.mass * 9.81
    assert np.allclose(controller._forces.sum(axis=0), [0.0, 0.0, weight], atol=0.02)


def test_forces_without_torque_limits_are_bounded_by_the_planned_ones(
    seen: tuple[CloudPlan, Truth], monkeypatch: pytest.MonkeyPatch
) -> None:
    """With limits nothing is found; without them no finger is asked for 97 N."""
    plan, asked = seen[0].plan, []

    def none(contacts: ContactSet, **given: Any) -> Any:
        asked.append(given)
        return replace(plan.forces, found=False, reason="none")

    monkeypatch.setattr("sim.controllers.grasp.distribute_forces", none)
    controller = GraspController(plan)
    trial = Trial(plan, truth=seen[1], timeline=QUICK, controller=controller)
    for phase in PHASES[:2]:
        run_grasp_phase(trial.simulation, trial.recorder, QUICK, phase)
    for _ in trial.simulation.run("squeeze", 0.004):
        pass
    limited, free = ([a for a in asked if ("jacobians" in a) == w] for w in (True, False))
    planned = plan.contacts.forces[:, 0].max()
    assert len(limited) == len(free) == 3 and "forces" in controller.refused
    assert {a["max_normal"].max() for a in limited} == {MOST_FELT}
    assert all(a["max_normal"].max() == pytest.approx(MOST_FREE * planned) for a in free)


def test_contacts_that_do_not_close_are_refused(seen: tuple[CloudPlan, Truth]) -> None:
    contacts = seen[0].plan.contacts
    every = np.ones(len(contacts), dtype=bool)
    assert not_closed(every, contacts) == ""
    one_side = contacts.normals @ contacts.normals[0] > 0.0
    assert "do not close" in not_closed(one_side, contacts)
    assert not_closed(~every, contacts) == "no finger feels the object"


def test_every_felt_contact_keeps_its_friction_law() -> None:
    """Two soft pads that face each other close, whatever a third is that feels nothing."""
    across = np.array([[0.0, 0.03, 0.0], [0.03, 0.0, 0.0], [-0.03, 0.0, 0.0]])
    contacts = ContactSet.from_arrays(
        across, -across, mu_torsion=0.005, model=["point", "soft", "soft"], fingers=["a", "b", "c"]
    )
    assert not_closed(np.array([False, True, True]), contacts) == ""
    hard = replace(contacts, models=("soft", "point", "point"))
    assert "do not close" in not_closed(np.array([False, True, True]), hard)
