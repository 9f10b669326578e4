"""The closed loop in trials: what it holds, what it notices, and what it does then."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from brief import COARSE
from conftest import PlanOf

from benchmarks.slips import LATENCY, true_slips
from planner.certify import smallest_breaking
from planner.certify.breaking import Disturbance
from planner.errors import NotFoundError, TaskError
from planner.forces import QuadraticCost
from planner.plan import GraspPlan
from planner.search.grasp import plan_grasp
from planner.spatial import FloatArray
from planner.synthesis.options import SynthesisOptions
from planner.task import GraspTask
from sim.contacts.reading import read_pads
from sim.controllers import (
    Controller,
    GraspController,
    ImpedanceGains,
    ObjectImpedance,
    Observation,
)
from sim.controllers.torques import HoldingTorques
from sim.protocols.disturbance import DisturbanceTrial
from sim.report import TrialReport
from sim.report_file import ReportFile
from sim.scene.physics import PhysicsOptions
from sim.sensing.errors import ErrorModel
from sim.simulation import Simulation
from sim.trial import Timeline, Trial

pytestmark = pytest.mark.usefixtures("coarse_steps")

SHORT = Timeline(
    approach=0.3,
    close=0.25,
    close_wait=0.2,
    squeeze=0.25,
    settle=0.05,
    lift=0.15,
    hold=0.6,
    lift_height=0.01,
)
"""Long enough to hold the object in the air; 1.6 s simulated."""

FINE = 0.002
"""Time step (s) of what is learned, or seen, step by step; other trials take 4 ms."""


@pytest.fixture(scope="module")
def plan(plan_of: PlanOf) -> GraspPlan:
    return plan_of("allegro_hand", "sphere")


@pytest.fixture(scope="module")
def shadow_plan(plan_of: PlanOf) -> GraspPlan:
    return plan_of("shadow_hand", "cylinder")


def run(
    plan: GraspPlan,
    controller: Controller,
    on_hold: Callable[[Simulation, float], None] = lambda _trial, _since: None,
    *,
    timeline: Timeline = SHORT,
    mu: float = 0.6,
    error_model: ErrorModel | None = None,
    timestep: float = COARSE.timestep,
) -> TrialReport:
    """A short trial; ``on_hold`` is called after every step of the hold with the time since."""
    trial = Trial(
        plan,
        controller=controller,
        timeline=timeline,
        physics=PhysicsOptions(mu=mu, timestep=timestep),
        error_model=error_model,
    )
    began: list[float] = []

    def on_step(t: Simulation) -> None:
        if t.phase == "hold":
            began.append(float(t.data.time))
            on_hold(t, began[-1] - began[0])

    return trial.run(on_step=on_step)


def kinds(controller: ObjectImpedance, finger: str | None = None) -> list[str]:
    return [e.kind for e in controller.events if finger in (None, e.finger)]


def in_base(trial: Simulation) -> FloatArray:
    """Position of the object in the hand's base, m."""
    base = trial.scene.body_pose(trial.data, trial.scene.base_body)
    there = trial.scene.body_pose(trial.data, trial.scene.object_body)
    return np.array(base.actInv(there).translation)


def push(trial: Simulation, force: FloatArray) -> None:
    trial.data.xfrc_applied[trial.scene.object_body, :3] = force


def test_tendons_and_servos_hold(shadow_plan: GraspPlan) -> None:
    controller = ObjectImpedance(shadow_plan)
    report = run(shadow_plan, controller)
    assert report.success, report.verdict.detail
    assert report.largest_slip[0] < 0.3
    assert controller.gave_up == ""
    wanted, felt = controller.forces[:, 0], report.samples.normal_force[-1]
    np.testing.assert_allclose(felt, wanted, atol=0.4)
    assert report.controller == "ObjectImpedance"


def test_soft_contacts_hold_and_their_moments_are_commanded(
    plan_of: PlanOf, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = plan_of("allegro_hand", "cylinder:0.03x0.1", contact_model="soft", mu_torsion=0.005)
    controller, commands, moments = ObjectImpedance(plan), HoldingTorques.commands, []

    def noted(self: HoldingTorques, *args: Any, **options: Any) -> FloatArray:
        moments.append(np.array(options["moments"]))
        return commands(self, *args, **options)

    monkeypatch.setattr(HoldingTorques, "commands", noted)
    assert run(plan, controller, timeline=replace(SHORT, hold=0.3)).success
    assert np.abs(controller.forces[:, 3]).max() > 1e-6  # N m: they bear a part
    np.testing.assert_array_equal(moments[-1], controller.forces[:, 3])


@pytest.fixture(scope="module")
def plain(plan: GraspPlan) -> tuple[ObjectImpedance, TrialReport]:
    """A controller without any changes, and its trial; only looked at."""
    controller = ObjectImpedance(plan)
    return controller, run(plan, controller, timeline=replace(SHORT, hold=0.3))


@pytest.mark.slow
def test_a_cost_of_ones_own_shapes_the_forces(
    plan: GraspPlan, plain: tuple[ObjectImpedance, TrialReport]
) -> None:
    """The first finger is to press with 4 N; without the cost it presses as the rest do."""
    row = np.zeros((1, 3 * len(plan.contacts)))
    row[0, 0] = 1.0
    wanted = QuadraticCost.of_residual(row, [4.0], weight=1e3, name="first finger")
    own = ObjectImpedance(plan, costs=[wanted])
    assert plain[1].success and run(plan, own, timeline=replace(SHORT, hold=0.3)).success
    assert own.forces[0, 0] == pytest.approx(4.0, abs=0.05)
    assert plain[0].forces[0, 0] < 3.5


@pytest.mark.slow
def test_a_push_deflects_the_object_by_push_over_stiffness(plan: GraspPlan) -> None:
    stiffness, force = 1500.0, 2.0
    gains = ImpedanceGains(
        stiffness=stiffness,
        damping=60.0,
        turning_stiffness=3.0,
        turning_damping=0.1,
        learning_rate=0.0,
    )
    places: dict[str, FloatArray] = {}

    def on_hold(trial: Simulation, since: float) -> None:
        if since < 0.4:
            places["before"] = in_base(trial)
        else:
            push(trial, np.array([0.0, force, 0.0]))
            places["after"] = in_base(trial)

    run(plan, ObjectImpedance(plan, gains=gains), on_hold, timeline=replace(SHORT, hold=1.0))
    moved = float(np.linalg.norm(places["after"] - places["before"]))
    # dry friction of contacts and what rolls keep it a little off
    assert moved == pytest.approx(force / stiffness, rel=0.2)


def test_a_wrong_mass_is_learned(plan: GraspPlan) -> None:
    believed = 0.5 * plan.task.object.mass
    controller = ObjectImpedance(plan, mass=believed)
    report = run(plan, controller, timestep=FINE)
    assert report.success, report.verdict.detail
    missing = 0.5 * plan.task.object.mass * 9.81
    upward = plan.T_world_base.rotation @ controller.law.load[:3]
    assert upward[2] == pytest.approx(missing, abs=0.25 * missing)


@pytest.mark.slow
def test_it_holds_against_what_breaks_the_open_loop(plan: GraspPlan) -> None:
    def on_hold(trial: Simulation, since: float) -> None:
        push(trial, min(since / 0.4, 1.0) * np.array([0.0, 7.0, 0.0]))

    open_loop = run(plan, GraspController(plan), on_hold)
    closed_loop = run(plan, ObjectImpedance(plan), on_hold)
    assert not open_loop.success
    assert closed_loop.success, closed_loop.verdict.detail
    assert closed_loop.largest_slip[0] < 2.0


@pytest.mark.slow
def test_fingers_ease_off_where_one_must_push_alone(plan_of: PlanOf) -> None:
    """The thumb stands alone against three: what they press takes from what it can give."""
    alone = plan_of("allegro_hand", "box", seed=2)
    k = alone.task.finger_names.index("thumb")
    onto_thumb = -8.0 * alone.contacts.normals[k]

    def on_hold(trial: Simulation, since: float) -> None:
        push(trial, min(since / 0.9, 1.0) * onto_thumb)

    controller = ObjectImpedance(alone)
    report = run(alone, controller, on_hold, timeline=replace(SHORT, hold=1.2))
    assert report.success, report.verdict.detail
    assert "gave up" not in kinds(controller)
    grip = alone.task.grip_force
    pressed = np.delete(controller.forces[:, 0], k)
    assert 0 < pressed.min() < 0.9 * grip  # it was all of the grip, and the push was not met
    assert 8.0 < controller.forces[k, 0] < 8.0 + 3 * grip


@pytest.mark.slow
def test_no_delay_and_no_noise_are_the_same_as_none(
    plan: GraspPlan, plain: tuple[ObjectImpedance, TrialReport]
) -> None:
    short, exact = replace(SHORT, hold=0.3), plain[1]
    nothing = ErrorModel(pose_noise=0.0, turn_noise=0.0, pose_delay=0.0, seed=3)
    same = run(plan, ObjectImpedance(plan), timeline=short, error_model=nothing)
    late = run(plan, ObjectImpedance(plan), timeline=short, error_model=ErrorModel(pose_delay=0.01))
    np.testing.assert_array_equal(exact.samples.slip_mm, same.samples.slip_mm)
    np.testing.assert_array_equal(exact.samples.normal_force, same.samples.normal_force)
    assert np.abs(exact.samples.normal_force - late.samples.normal_force).max() > 1e-6


@pytest.mark.slow
def test_it_holds_with_noise_and_delay(plan: GraspPlan) -> None:
    noisy = ErrorModel(
        pose_noise=3e-4, turn_noise=3e-3, pose_delay=0.01, touch_noise=0.02, sliding_noise=0.002
    )
    controller = ObjectImpedance(plan, mass=1.3 * plan.task.object.mass)
    report = run(plan, controller, error_model=noisy)
    assert report.success, report.verdict.detail
    assert "gave up" not in kinds(controller)


@pytest.mark.slow
def test_a_finger_leaves_and_comes_back(plan: GraspPlan) -> None:
    controller = ObjectImpedance(plan)
    forces: dict[str, list[float]] = {"away": [], "back": []}
    told: set[str] = set()

    def on_hold(trial: Simulation, since: float) -> None:
        for when, what in ((0.1, "leave"), (0.5, "join")):
            if since >= when and what not in told:
                told.add(what)
                getattr(controller, what)("middle")
        felt = read_pads(trial.scene, trial.data, plan.task.finger_names).normal_force
        middle = float(felt[plan.task.finger_names.index("middle")])
        if 0.35 < since < 0.5:
            forces["away"].append(middle)
        if since > 1.0:
            forces["back"].append(middle)

    report = run(plan, controller, on_hold, timeline=replace(SHORT, hold=1.1))
    assert kinds(controller, "middle") == ["finger leaves", "finger joins", "contact found"]
    assert max(forces["away"]) == 0.0
    assert min(forces["back"]) > 0.7 * plan.task.grip_force
    assert report.largest_slip[0] < 3.0
    with pytest.raises(NotFoundError, match="There is: index, middle, ring, thumb"):
        controller.leave("litle")


@pytest.mark.slow
def test_a_finger_with_tendons_that_leaves_asks_nothing_of_the_others() -> None:
    # its own weight is not what its tendons can hold exactly; that is no reason to give up forces.
    # without rounds, which work on the grasp of all fingers: the others alone may hold worse after
    made = plan_grasp(
        GraspTask.create("shadow_hand", "cylinder"), options=SynthesisOptions(rounds=0)
    )
    controller = ObjectImpedance(made)
    fingers = [name for name in made.task.finger_names if name != "thumb"]
    held: list[FloatArray] = []

    def on_hold(trial: Simulation, since: float) -> None:
        if since == 0.0:
            controller.keep()
            controller.leave(fingers[-1])
        held.append(in_base(trial))

    run(made, controller, on_hold, timeline=replace(SHORT, hold=0.3))
    lever = controller._loop.contacts.lever.reshape(len(made.task.finger_names), 3, -1)
    asks = np.abs(lever).max(axis=(1, 2)) > 0.0
    left = [name == fingers[-1] for name in made.task.finger_names]
    assert asks.tolist() == [not away for away in left]
    assert "infeasible" not in kinds(controller)
    assert np.linalg.norm(held[-1] - held[0]) < 2e-3


def test_a_contact_that_is_lost_is_noticed_and_found_again(plan: GraspPlan) -> None:
    """The tip of a finger is torn off the object for 60 ms."""
    controller = ObjectImpedance(plan)
    name = "middle"
    normal = plan.contacts.normals[plan.task.finger_names.index(name)]
    lost: list[float] = []

    def on_hold(trial: Simulation, since: float) -> None:
        body = int(trial.scene.model.body("hand/middle_distal").id)
        torn = 0.1 <= since < 0.16
        trial.data.xfrc_applied[body, :3] = -4.0 * normal if torn else 0.0
        felt = read_pads(trial.scene, trial.data, (name,)).normal_force[0]
        if torn and felt == 0.0 and not lost:
            lost.append(float(trial.data.time))

    report = run(plan, controller, on_hold)
    assert kinds(controller, name)[:2] == ["contact lost", "contact found"]
    noticed = next(e.time for e in controller.events if e.kind == "contact lost")
    assert lost
    assert 0.0 <= noticed - lost[0] <= 0.02
    assert report.success, report.verdict.detail


@pytest.mark.slow
def test_slips_are_noticed_and_answered(plan: GraspPlan) -> None:
    """Friction falls to less than is believed, while the object is pulled."""
    noisy = ErrorModel(touch_noise=0.02, sliding_noise=0.002)
    controller = ObjectImpedance(plan)
    rows: list[tuple[float, FloatArray, FloatArray]] = []

    def on_hold(trial: Simulation, since: float) -> None:
        push(trial, np.array([0.0, 0.0, -1.0]))
        if since > 0.2:
            trial.scene.model.geom_friction[:, 0] = 0.3
        pads = read_pads(trial.scene, trial.data, plan.task.finger_names)
        rows.append((float(trial.data.time), pads.sliding_speed, pads.normal_force))

    brief = replace(SHORT, hold=0.8)
    run(plan, controller, on_hold, timeline=brief, error_model=noisy, timestep=FINE)
    times, speed, force = (np.array(column) for column in zip(*rows, strict=True))
    slips = true_slips(times, speed, force)
    noticed = [e for e in controller.events if e.kind == "slip"]
    assert slips
    assert noticed
    for slip in slips[:1]:
        finger = plan.task.finger_names[slip.finger]
        assert any(e.finger == finger and e.time <= slip.begin + LATENCY for e in noticed)
    assert "grip x 1.30" in noticed[0].detail
    end = times > times[-1] - 0.2
    assert force[end].min() > 1.2 * plan.task.grip_force
    assert speed[end].max() < 0.005  # held again


def test_what_slips_taught_is_forgotten_where_fingers_hold_elsewhere(plan: GraspPlan) -> None:
    """Pads that are said to slip for a moment, twice; the fingers are kept in between."""

    class Deceived:
        slipping = False

        def __init__(self, inner: ObjectImpedance) -> None:
            self.inner = inner

        def step(self, observation: Observation) -> FloatArray:
            if self.slipping:
                normal = observation.pads.normal
                aside = np.cross(normal, np.roll(normal, 1, axis=1))
                pads = replace(observation.pads, sliding=0.05 * aside)
                observation = replace(observation, read_pads=lambda: pads)
            return self.inner.step(observation)

    controller = ObjectImpedance(plan)
    deceived = Deceived(controller)

    kept: list[float] = []

    def on_hold(trial: Simulation, since: float) -> None:
        deceived.slipping = 0.1 <= since < 0.13 or 0.3 <= since < 0.33
        if since >= 0.2 and not kept:
            kept.append(float(trial.data.time))
            controller.keep()

    run(plan, deceived, on_hold, timeline=replace(SHORT, hold=0.4))
    slips = [e for e in controller.events if e.kind == "slip"]
    before, after = ([e for e in slips if (e.time < kept[0]) == first] for first in (True, False))
    assert "grip x 1.30" in before[0].detail
    assert "grip x 1.30" in after[0].detail  # the first step of the grip again


@pytest.mark.slow
def test_what_cannot_be_held_is_said(plan: GraspPlan) -> None:
    controller = ObjectImpedance(plan)
    begun: list[float] = []

    def on_hold(trial: Simulation, since: float) -> None:
        if since > 0.1 and not begun:
            begun.append(float(trial.data.time))
        push(trial, np.array([0.0, 0.0, -60.0 if since > 0.1 else 0.0]))

    report = run(plan, controller, on_hold, timeline=replace(SHORT, hold=1.0))
    assert not report.success
    first = next(e for e in controller.events if e.kind == "infeasible")
    assert "cannot be exerted; the nearest forces are given" in first.detail
    assert first.time - begun[0] < 0.05
    assert controller.gave_up
    told = [e for e in controller.events if e.kind in ("gave up", "feasible again")]
    assert told[-1].detail == controller.gave_up
    times = [e.time for e in controller.events]
    assert times == sorted(times)
    assert report.events == controller.events
    assert len(ReportFile.model_validate(report.to_dict()).events) == len(times)


def test_beliefs_must_make_sense(plan: GraspPlan) -> None:
    with pytest.raises(TaskError, match="the believed mass is 0; give a number > 0 in kg"):
        ObjectImpedance(plan, mass=0)
    with pytest.raises(TaskError, match="the believed mu is -1; give a number > 0"):
        ObjectImpedance(plan, mu=-1)


@pytest.fixture(scope="module")
def of_ellipsoid() -> GraspPlan:
    """Of the search alone, whose contacts the certificate is about."""
    task = GraspTask.create("allegro_hand", "ellipsoid")
    return plan_grasp(task, options=SynthesisOptions(rounds=0))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["force", "torque"])
def test_a_slow_load_is_borne_up_to_what_the_certificate_promises(
    of_ellipsoid: GraspPlan, kind: Disturbance
) -> None:
    """With the friction and the contacts of the certificate: mu 0.5, no torsion.

    The direction is that of the least load that breaks the grasp. No pad slips on the way: where
    one did, the contacts would no longer be those of the certificate.
    """
    made, controller = of_ellipsoid, ObjectImpedance(of_ellipsoid)
    breaking = smallest_breaking(
        made.forces.problem, kind, length=made.task.object.shape.bounding_radius
    )
    promised = breaking.bounds.lower * breaking.wrench / np.linalg.norm(breaking.wrench)
    hold = DisturbanceTrial(
        made, controller=controller, physics=PhysicsOptions(mu=0.5, mu_torsion=0.0)
    )
    assert hold.close_and_squeeze() is None
    for share in (*np.linspace(0.05, 0.7, 14), *np.linspace(0.72, 0.94, 12)):
        hold.push(share * promised)
        assert hold.hold_for(0.08) is None, f"lost at {share:.2f} of the promise"
    assert "slip" not in kinds(controller)
    assert hold.at_rest()


def test_a_slip_at_the_friction_that_is_believed_changes_no_belief(plan: GraspPlan) -> None:
    """A pull to where the pads slip: their friction is the believed one, and stays believed."""
    controller = ObjectImpedance(plan, mu=0.5)

    def on_hold(trial: Simulation, since: float) -> None:
        push(trial, np.array([0.0, 0.0, -min(since / 0.3, 1.0) * 20.0]))

    run(plan, controller, on_hold, timeline=replace(SHORT, hold=0.5), mu=0.5)
    slips = [e for e in controller.events if e.kind == "slip"]
    assert slips
    assert "friction believed 0.50" in slips[0].detail, slips
