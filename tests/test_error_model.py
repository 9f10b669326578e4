"""ErrorModel against answers on paper: offsets, delays, rates, noise; nothing else changes."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from functools import cache, partial
from typing import Any, cast

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from brief import COARSE
from conftest import PlanOf
from hypothesis import given, settings
from hypothesis import strategies as st
from manipulations import QUICK, turned_cylinder, turned_cylinder_report

from planner.errors import NotFoundError, TaskError
from planner.hand_loading import load_hand
from planner.joints.actuation import Actuation
from planner.kinematics import HandState
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask
from sim.contacts import hand_contacts
from sim.controllers import GraspController, Observation, PadReading, Phase
from sim.manipulation.regrasping import margin_without
from sim.manipulation.run import ManipulationRun
from sim.protocols.variations import with_errors
from sim.recording import Recording
from sim.report_file import read_report, write_report
from sim.scene.build import build_scene
from sim.scene.carrier import Timeline
from sim.scene.physics import PhysicsOptions
from sim.sensing.errors import (
    ERROR_MODELS,
    Drawn,
    ErrorModel,
    TrialErrors,
    named_errors,
    register_errors,
)
from sim.sensing.errors.model import stream
from sim.sensing.errors.senses import Drift, RealSenses
from sim.sensing.errors.trial import RealDrive, center_offset
from sim.simulation import Simulation
from sim.trial import Trial, simulate

DT = 0.002
SHORT = Timeline.quick(approach=0.2, lift=0.3, hold=0.3)
ERRORS = [name for name in ErrorModel().numbers if name != "drift_time"]


@pytest.fixture(scope="module")
def plan(plan_of: PlanOf) -> GraspPlan:
    return plan_of("allegro_hand", "sphere")


@pytest.fixture(scope="module")
def task(plan: GraspPlan) -> GraspTask:
    return plan.task


def changed(error_model: ErrorModel, name: str, value: float) -> ErrorModel:
    """With another number in a field."""
    values: dict[str, Any] = {name: value}
    return replace(error_model, **values)


def nothing(task: GraspTask, **values: Any) -> Drawn:
    """Draws that are all nominal but those given."""
    return replace(Drawn.of(ErrorModel(), task.hand), **values)


def seen(time: float, x: float = 0.0, *, phase: Phase = "hold", **other: Any) -> Observation:
    """An observation of 16 joints and four fingers, the object at x (m)."""
    values: dict[str, Any] = {
        "q": np.zeros(16),
        "v": np.zeros(16),
        "T_world_base": SE3.Identity(),
        "T_world_object": SE3(np.eye(3), np.array([x, 0.0, 0.0])),
        "normal_forces": np.zeros(4),
        "read_twist": lambda: np.zeros(6),
        "read_contacts": lambda: None,
    }
    return Observation(time=time, phase=phase, progress=0.0, **(values | other))


# --- what is drawn -----------------------------------------------------------------------------


def test_ideal_has_no_error_and_every_other_preset_has() -> None:
    assert list(ERROR_MODELS) == ["ideal", "lab", "rough"]
    assert [name for name, error_model in ERROR_MODELS.items() if error_model.ideal] == ["ideal"]
    lab, rough = ERROR_MODELS["lab"].numbers, ERROR_MODELS["rough"].numbers
    rates = {"pose_rate", "touch_rate", "command_rate"}
    assert all(rough[name] >= lab[name] for name in ERRORS if name not in rates)
    assert all(0 < rough[name] <= lab[name] for name in rates)


def test_same_seed_same_draws(task: GraspTask) -> None:
    one, again, other = (
        Drawn.of(named_errors("rough", seed), task.hand).to_dict() for seed in (3, 3, 4)
    )
    assert one == again
    undrawn = {name for name in one if not any(np.ravel(one[name]))}
    assert undrawn <= {"pose_bias", "turn_bias", "touch_scale"}
    assert all(one[name] != other[name] for name in one.keys() - undrawn)


allegro_of_draws = cache(partial(load_hand, "allegro_hand"))
"""Loaded once for all examples."""


@given(
    name=st.sampled_from(ERRORS),
    value=st.floats(0.0, 0.9),
    seed=st.integers(0, 2**63),
)
@settings(deadline=None)  # the first example builds the hand
def test_an_error_leaves_the_draws_of_the_others(name: str, value: float, seed: int) -> None:
    hand, first = allegro_of_draws(), replace(ERROR_MODELS["rough"], seed=seed)
    before = Drawn.of(first, hand).to_dict()
    after = Drawn.of(changed(first, name, value), hand).to_dict()
    own = name.removeprefix("object_")
    assert {k: v for k, v in before.items() if k != own} == {
        k: v for k, v in after.items() if k != own
    }
    if own in ("size", "mass", "friction"):
        share = (before[own] - 1.0) / ERROR_MODELS["rough"].numbers[name]
        assert after[own] - 1.0 == pytest.approx(value * share, abs=1e-12)


def test_draws_have_the_distribution_that_is_said(task: GraspTask) -> None:
    rough = ERROR_MODELS["rough"]
    drawn = [Drawn.of(rough.seeded(seed), task.hand) for seed in range(400)]
    offsets = np.array([d.encoder_offset for d in drawn])
    assert offsets.std() == pytest.approx(rough.encoder_offset, rel=0.03)
    assert abs(offsets.mean()) < 4 * rough.encoder_offset / np.sqrt(offsets.size)
    mass = np.array([d.mass for d in drawn]) - 1.0
    assert np.abs(mass).max() <= rough.object_mass
    assert mass.std() == pytest.approx(rough.object_mass / np.sqrt(3), rel=0.1)


def test_an_arm_is_calibrated() -> None:
    hand = load_hand("allegro_on_arm7")
    drawn = Drawn.of(ERROR_MODELS["rough"], hand)
    own = np.setdiff1d(np.arange(hand.nq), hand.arm_index)
    assert len(hand.arm_index) > 0
    assert not drawn.encoder_offset[hand.arm_index].any()
    assert drawn.encoder_offset[own].all()


@pytest.mark.parametrize("name", ERRORS)
@pytest.mark.parametrize("value", [-1e-3, np.nan, np.inf])
def test_bad_values_are_refused(name: str, value: float) -> None:
    with pytest.raises(TaskError, match=f"{name} is .*; give a finite number >= 0"):
        changed(ErrorModel(), name, value)


def test_other_bad_values_are_refused() -> None:
    for name in ("object_size", "object_mass", "object_friction", "torque_constant"):
        with pytest.raises(TaskError, match="a share in"):
            changed(ErrorModel(), name, 1.0)
    with pytest.raises(TaskError, match="a probability"):
        ErrorModel(dropout=1.1)
    with pytest.raises(TaskError, match="drift_time is 0"):
        ErrorModel(drift_time=0.0)
    with pytest.raises(TaskError, match="an integer >= 0"):
        ErrorModel(seed=-1)
    with pytest.raises(TaskError, match="an integer >= 0"):
        ErrorModel(seed=True)
    for wrong in ("1 mm", None, True):
        with pytest.raises(TaskError, match=r"pose_noise is .*; give a finite number >= 0"):
            changed(ErrorModel(), "pose_noise", cast(Any, wrong))
    with pytest.raises(TaskError, match="name is ''; give a text"):
        ErrorModel(name="")
    with pytest.raises(NotFoundError, match="lab"):
        named_errors("labs")
    with pytest.raises(NotFoundError, match="encoder_offset"):
        ERROR_MODELS["lab"].only("encoder_offsets")
    with pytest.raises(TaskError, match="already"):
        register_errors(ErrorModel(name="lab"))


def test_alone_keeps_one_error() -> None:
    only = ERROR_MODELS["rough"].seeded(7).only("object_mass")
    assert [name for name in ERRORS if only.numbers[name]] == ["object_mass"]
    assert only.seed == 7
    no_error = {"name", "touch", "seed", "drift_time"}
    assert {f.name for f in fields(ErrorModel)} - set(ERRORS) == no_error


# --- sensors -----------------------------------------------------------------------------------


def test_drift_has_the_variance_and_the_correlation_of_its_formula() -> None:
    time, elapsed, n = 0.5, 0.05, 40_000
    drift = Drift(np.array([2.0, 0.1]), time, stream(1, "drift"))
    x = np.array([drift.step(elapsed) for _ in range(n)])
    np.testing.assert_allclose(x.std(axis=0), [2.0, 0.1], rtol=0.05)
    for lag in (1, 5, 10, 20):
        measured = (x[lag:] * x[:-lag]).mean(axis=0) / x.var(axis=0)
        np.testing.assert_allclose(measured, np.exp(-lag * elapsed / time), atol=0.06)


def test_drift_does_not_depend_on_how_time_is_cut() -> None:
    finely = Drift(np.ones(2000), 0.5, stream(1, "a"))
    coarsely = Drift(np.ones(2000), 0.5, stream(2, "b"))
    begin = finely.step(0.0), coarsely.step(0.0)
    for _ in range(10):
        fine = finely.step(0.03)
    coarse = coarsely.step(0.3)
    for first, last in zip(begin, (fine, coarse), strict=True):
        assert last.std() == pytest.approx(1.0, rel=0.06)
        assert (first * last).mean() == pytest.approx(np.exp(-0.3 / 0.5), abs=0.06)


@pytest.mark.parametrize("steps", [1, 7, 15])
def test_a_late_pose_is_that_of_before(task: GraspTask, steps: int) -> None:
    error_model = ErrorModel(pose_delay=DT * steps)
    senses = RealSenses(error_model, Drawn.of(error_model, task.hand), task)
    for k in range(40):
        known = senses.read(seen(DT * k, 0.01 * k)).T_world_object.translation[0]
        assert known == pytest.approx(0.01 * max(0, k - steps), abs=1e-12)


def test_a_camera_sees_at_its_rate_and_late(task: GraspTask) -> None:
    """At 50 Hz and 30 ms every tenth step is measured, and known 15 steps later."""
    error_model = ErrorModel(pose_rate=50.0, pose_delay=0.03)
    senses = RealSenses(error_model, Drawn.of(error_model, task.hand), task)
    for k in range(100):
        known = senses.read(seen(DT * k, float(k))).T_world_object.translation[0]
        assert known == pytest.approx(max(0, (k - 15) // 10 * 10))


def test_a_late_pose_is_carried_by_the_hand_once_it_holds(task: GraspTask) -> None:
    cases: tuple[tuple[Phase, float], ...] = (("hold", 0.09), ("approach", 0.04))
    for phase, expected in cases:
        error_model = ErrorModel(pose_delay=5 * DT)
        senses = RealSenses(error_model, Drawn.of(error_model, task.hand), task)
        for k in range(10):
            base = SE3(np.eye(3), np.array([0.01 * k, 0.0, 0.0]))
            truth = seen(DT * k, 0.01 * k, T_world_base=base, phase=phase)
            known = senses.read(truth).T_world_object.translation[0]
        assert known == pytest.approx(expected, abs=1e-12)


def test_a_pose_seen_before_the_hand_closed_is_carried_from_there(task: GraspTask) -> None:
    """The hand comes 0.2 m to an object at 0.05 m that is seen once, and carries it 0.1 m on."""
    error_model = ErrorModel(turn_noise=1e-9).without_camera()
    senses = RealSenses(error_model, Drawn.of(error_model, task.hand), task)

    def known(k: int, base: float, x: float, phase: Phase) -> float:
        pose = SE3(np.eye(3), np.array([base, 0.0, 0.0]))
        read = senses.read(seen(DT * k, x, T_world_base=pose, phase=phase))
        return float(read.T_world_object.translation[0])

    assert known(0, -0.2, 0.05, "approach") == pytest.approx(0.05)
    assert known(1, 0.0, 0.05, "close") == pytest.approx(0.05)
    assert known(2, 0.0, 0.05, "squeeze") == pytest.approx(0.05)
    assert known(3, 0.1, 0.15, "lift") == pytest.approx(0.15)


def test_the_twist_is_the_difference_of_the_last_two_poses(task: GraspTask) -> None:
    error_model = ErrorModel(pose_rate=50.0)
    senses = RealSenses(error_model, Drawn.of(error_model, task.hand), task)
    read = senses.read(seen(0.0))
    np.testing.assert_array_equal(read.object_twist, np.zeros(6))
    for k in range(1, 30):
        turned = SE3(pin.exp3(np.array([0.0, 0.0, 2.0 * DT * k])), np.array([DT * k, 0.0, 0.0]))
        read = senses.read(seen(DT * k, T_world_object=turned))
    np.testing.assert_allclose(read.object_twist, [1.0, 0, 0, 0, 0, 2.0], atol=1e-9)


@pytest.mark.parametrize("lost", [1, 4])
def test_dropouts_come_and_last_as_often_and_long_as_said(task: GraspTask, lost: int) -> None:
    """Of the poses a share p m / (1 - p + p m) is lost if each dropout costs m of them."""
    p, rate = 0.1, 1.0 / DT
    error_model = ErrorModel(dropout=p, dropout_time=lost * DT, pose_rate=rate)
    senses = RealSenses(error_model, Drawn.of(error_model, task.hand), task)
    known = np.array(
        [senses.read(seen(DT * k, float(k))).T_world_object.translation[0] for k in range(8000)]
    )
    fresh = known == np.arange(8000)
    assert 1.0 - fresh.mean() == pytest.approx(p * lost / (1 - p + p * lost), rel=0.1)
    runs = np.diff(np.flatnonzero(fresh)) - 1
    assert runs[runs > 0].min() == lost


def test_noise_and_bias_have_the_size_asked_for(task: GraspTask) -> None:
    error_model = ErrorModel(pose_noise=1e-3, turn_noise=0.02, encoder_noise=0.01, rate_noise=0.3)
    drawn = nothing(task, pose_bias=np.array([5e-3, 0.0, 0.0]), turn_bias=np.array([0, 0.1, 0]))
    senses = RealSenses(error_model, drawn, task)
    read = [senses.read(seen(DT * k)) for k in range(3000)]
    moved = np.array([r.T_world_object.translation for r in read])
    turned = np.array([pin.log3(r.T_world_object.rotation) for r in read])
    np.testing.assert_allclose(moved.std(axis=0), 1e-3, rtol=0.06)
    np.testing.assert_allclose(turned.std(axis=0), 0.02, rtol=0.06)
    np.testing.assert_allclose(moved.mean(axis=0), [5e-3, 0, 0], atol=1e-4)
    np.testing.assert_allclose(turned.mean(axis=0), [0, 0.1, 0], atol=2e-3)
    assert np.std([r.q for r in read]) == pytest.approx(0.01, rel=0.03)
    assert np.std([r.v for r in read]) == pytest.approx(0.3, rel=0.03)


def test_a_finger_that_touches_nothing_says_so_and_pads_agree_with_touch(task: GraspTask) -> None:
    error_model = ErrorModel(touch_noise=0.1, sliding_noise=0.002)
    senses = RealSenses(error_model, nothing(task), task)
    pads = PadReading(
        normal_force=np.array([2.0, 0.0, 0.0, 0.0]),
        force=np.array([[2.0, 0.5, 0.0], *[[0.0] * 3] * 3]),
        position=np.array([[0.0, 0.0, 0.0], *[[np.nan] * 3] * 3]),
        normal=np.array([[1.0, 0.0, 0.0], *[[np.nan] * 3] * 3]),
        sliding=np.array([[0.0, 0.003, 0.004], *[[np.nan] * 3] * 3]),
    )
    truth = [
        seen(DT * k, normal_forces=pads.normal_force, read_pads=lambda: pads) for k in range(3000)
    ]
    read = [senses.read(t) for t in truth]
    felt = np.array([r.normal_forces for r in read])
    assert felt[:, 0].std() == pytest.approx(0.1, rel=0.06)
    assert not felt[:, 1:].any()
    for r in read[:10]:
        np.testing.assert_array_equal(r.pads.normal_force, r.normal_forces)
        assert r.pads.force[0, 0] == pytest.approx(r.normal_forces[0])
        assert not r.pads.force[1:].any()
        assert np.isnan(r.pads.sliding[1:]).all()
    np.testing.assert_allclose(
        np.std([r.pads.sliding[0] for r in read], axis=0), [0, 0.002, 0.002], rtol=0.06
    )
    with pytest.raises(TaskError, match="read pads"):
        _ = read[0].contacts


def test_places_on_pads_follow_the_joints_that_are_read(plan: GraspPlan) -> None:
    """A reading in the world minus the truth is how far the offsets move the fingertip."""
    task, offset = plan.task, np.deg2rad(2.0) * np.ones(16)
    simulation = Simulation(plan)
    senses = RealSenses(ErrorModel(), nothing(task, encoder_offset=offset), task)
    n = len(task.fingers)
    tips = np.array([simulation.T_world_base.act(p) for p in _tips(task, simulation.q)])
    pads = replace(
        PadReading.nothing(n), position=tips, normal_force=np.ones(n), normal=np.eye(3)[[0] * n]
    )
    pads = replace(pads, sliding=np.zeros((n, 3)))
    truth = replace(simulation.observe("hold", 0.0), read_pads=lambda: pads)
    read = senses.read(truth).pads
    base = simulation.T_world_base
    expected = [base.act(p) for p in _tips(task, simulation.q + offset)]
    np.testing.assert_allclose(read.position, expected, atol=1e-9)
    assert np.linalg.norm(read.position - tips, axis=1).min() > 1e-3
    np.testing.assert_allclose(np.linalg.norm(read.normal, axis=1), 1.0)


@pytest.mark.parametrize(
    ("rate", "delay", "age"), [(0.0, 0.006, 3), (100.0, 0.0, 4), (50.0, 0.02, 19)]
)
def test_pads_are_late_and_move_on_with_the_fingertip(
    plan: GraspPlan, rate: float, delay: float, age: int
) -> None:
    """What was felt some steps ago is told where the fingertip is by now, joints as read."""
    task, offset = plan.task, np.deg2rad(1.0) * np.ones(16)
    error_model = ErrorModel(touch_rate=rate, touch_delay=delay)
    senses = RealSenses(error_model, nothing(task, encoder_offset=offset), task)
    n, oldest = len(task.fingers), 0
    for k in range(60):
        q = plan.q + 0.002 * k
        pads = replace(
            PadReading.nothing(n),
            position=np.array(_tips(task, q)),
            normal_force=np.full(n, 1.0 + k),
            normal=np.eye(3)[[0] * n],
            sliding=np.zeros((n, 3)),
        )
        read = senses.read(
            seen(DT * k, q=q, normal_forces=pads.normal_force, read_pads=partial(_given, pads))
        )
        np.testing.assert_allclose(read.pads.position, _tips(task, q + offset), atol=1e-12)
        np.testing.assert_array_equal(read.pads.normal_force, read.normal_forces)
        if k >= 20:
            oldest = max(oldest, round(1.0 + k - read.normal_forces[0]))
    assert oldest == age


def _given(pads: PadReading) -> PadReading:
    return pads


def test_pads_tell_forces_in_steps_above_a_threshold_and_off_by_a_scale(task: GraspTask) -> None:
    error_model = ErrorModel(touch_step=0.02, touch_threshold=0.1)
    scale = np.array([0.1, -0.1, 0.0, 0.0])
    senses = RealSenses(error_model, nothing(task, touch_scale=scale), task)
    true = np.array([1.0, 1.0, 0.09, 0.1])
    pads = PadReading(
        normal_force=true,
        force=true[:, None] * np.array([[1.0, 0.2, 0.0]] * 4),
        position=np.zeros((4, 3)),
        normal=np.eye(3)[[0] * 4],
        sliding=np.zeros((4, 3)),
    )
    read = senses.read(seen(0.0, normal_forces=true, read_pads=lambda: pads))
    np.testing.assert_allclose(read.normal_forces, [1.1, 0.9, 0.0, 0.1])
    np.testing.assert_allclose(read.pads.normal_force, [1.1, 0.9, 0.0, 0.1])
    np.testing.assert_allclose(read.pads.force[:, 1], [0.22, 0.18, 0.0, 0.02])
    assert np.isnan(read.pads.position[2]).all()
    assert np.isnan(read.pads.normal[2]).all()
    assert not read.pads.force[2].any()


@pytest.mark.slow
def test_a_misplaced_contact_stays_on_the_ball_of_its_pad_and_normals_turn(plan: GraspPlan) -> None:
    """Off by the stated deviation along the pad, for about the stated time; never off the ball."""
    task, state = plan.task, HandState(plan.task.hand, plan.q)
    centers = np.array([state.pad_center(f) for f in task.fingers])
    radii = np.array([f.pad.radius for f in task.fingers])[:, None]
    normal = np.array([state.pad_axis(f) for f in task.fingers])
    n = len(task.fingers)
    pads = PadReading(
        normal_force=np.ones(n),
        force=normal,
        position=centers + radii * normal,
        normal=normal,
        sliding=np.zeros((n, 3)),
    )
    error_model = ErrorModel(touch_place=5e-4, drift_time=0.05)
    senses = RealSenses(error_model, nothing(task), task)
    truth = seen(0.0, q=plan.q, normal_forces=np.ones(n), read_pads=lambda: pads)
    read = [senses.read(replace(truth, time=DT * k)).pads for k in range(4000)]
    places, normals = np.array([p.position for p in read]), np.array([p.normal for p in read])
    np.testing.assert_allclose(places - centers, radii * normals, atol=1e-12)
    np.testing.assert_allclose(np.array([p.force for p in read]), normals, atol=1e-12)
    moved = places - pads.position
    size = np.sqrt((moved**2).sum(axis=2).mean(axis=0))
    np.testing.assert_allclose(size, math.sqrt(2.0) * 5e-4, rtol=0.15)
    later = (moved[25:] * moved[:-25]).sum(axis=2).mean(axis=0) / size**2
    np.testing.assert_allclose(later, math.exp(-1.0), atol=0.12)


def test_encoders_read_in_steps(task: GraspTask) -> None:
    senses = RealSenses(ErrorModel(encoder_step=0.002), nothing(task), task)
    q = np.linspace(-0.01, 0.01, 16)
    read = senses.read(seen(0.0, q=q)).q
    np.testing.assert_allclose(np.round(read / 0.002), read / 0.002, atol=1e-9)
    assert 0.0 < np.abs(read - q).max() <= 0.001 + 1e-12


def _tips(task: GraspTask, q: FloatArray) -> list[FloatArray]:
    state = HandState(task.hand, q)
    return [state.tip_pose(f).translation for f in task.fingers]


# --- drives ------------------------------------------------------------------------------------


@dataclass
class Still:
    """Keeps commanding one posture."""

    commands: FloatArray

    def step(self, observation: Observation) -> FloatArray:
        return self.commands


def test_an_offset_moves_the_joint_of_a_position_servo_the_other_way(plan: GraspPlan) -> None:
    """2 degrees on one encoder: at rest its joint stands at -2 degrees, and reads as commanded."""
    floating = replace(plan, task=replace(plan.task, gravity=np.zeros(3)))
    k, offset = 2, np.deg2rad(2.0)
    rest, read = [], []
    for error in (0.0, offset):
        simulation = Simulation(
            floating,
            controller=Still(plan.q_start.copy()),
            error_model=ErrorModel(encoder_offset=1.0),
        )
        drawn = nothing(plan.task, encoder_offset=error * np.eye(16)[k])
        simulation.error_model = TrialErrors(ErrorModel(), plan.task, drawn)
        for _ in simulation.run("approach", 1.5):
            pass
        rest.append(simulation.q)
        read.append(simulation.sensed(simulation.observe("approach", 1.0)).q)
    np.testing.assert_allclose(rest[1] - rest[0], -offset * np.eye(16)[k], atol=2e-4)
    np.testing.assert_allclose(read[1], read[0], atol=2e-4)


@pytest.mark.parametrize("load", [0.5, -0.5])
def test_backlash_lets_a_joint_rest_anywhere_between_the_stops(
    plan: GraspPlan, load: float
) -> None:
    """A joint rests half a band from where it would, on the side to which a torque pulls it."""
    floating = replace(plan, task=replace(plan.task, gravity=np.zeros(3)))
    k, band = 2, np.deg2rad(4.0)
    rest, read = [], []
    for backlash in (0.0, band):
        simulation = Simulation(
            floating,
            controller=Still(plan.q_start.copy()),
            error_model=ErrorModel(backlash=backlash, pose_noise=1e-9),
            estimator="none",
        )
        dof = simulation.scene.hand_dof[k]
        for _ in simulation.run("approach", 1.5, before=partial(_load, simulation, dof, load)):
            pass
        rest.append(simulation.q)
        read.append(simulation.sensed(simulation.observe("approach", 1.0)).q)
    expected = np.sign(load) * 0.5 * band
    assert rest[1][k] - rest[0][k] == pytest.approx(expected, abs=1e-3)
    assert read[1][k] - rest[1][k] == pytest.approx(-expected, abs=1e-3)  # the motor has gone back
    np.testing.assert_allclose(read[1][k], read[0][k], atol=2e-3)


def _load(simulation: Simulation, dof: int, torque: float, since: float) -> None:
    del since
    simulation.data.qfrc_applied[dof] = torque


def test_a_motor_has_no_backlash_and_within_the_band_a_servo_gives_no_force(
    task: GraspTask,
) -> None:
    hand = task.hand
    q = np.full(hand.nq, 0.2)
    idle = hand.actuation.commands(q, np.zeros(hand.nq), np.zeros(hand.nq))
    drive = RealDrive(ErrorModel(backlash=0.1), nothing(task), hand.actuation)
    for ahead, left in ((0.04, 0.0), (-0.05, 0.0), (0.07, 0.02)):
        ctrl = drive.drive(0.0, idle + ahead, q)
        drive = RealDrive(ErrorModel(backlash=0.1), nothing(task), hand.actuation)
        np.testing.assert_allclose(ctrl - idle, left, atol=1e-12)


def test_offsets_pass_through_tendons_and_clipping_comes_before() -> None:
    hand = load_hand("shadow_hand")
    task = GraspTask.create(hand, "sphere")
    moment = hand.actuation.moment
    assert (np.count_nonzero(moment, axis=1) > 1).any()  # tendons on two joints
    drawn = Drawn.of(ErrorModel(encoder_offset=0.02, seed=1), hand)
    drive = RealDrive(ErrorModel(), drawn, hand.actuation)
    high = hand.actuation.ctrl_range[:, 1]
    ctrl = drive.drive(0.0, high + 1.0, np.zeros(hand.nq))
    np.testing.assert_allclose(ctrl, high - moment @ drawn.encoder_offset)
    scaled = replace(nothing(task), encoder_scale=np.full(hand.nq, 0.1))
    q = np.linspace(0.1, 0.3, hand.nq)
    ctrl = RealDrive(ErrorModel(), scaled, hand.actuation).drive(0.0, 0.0 * high, q)
    np.testing.assert_allclose(ctrl, np.clip(0, *hand.actuation.ctrl_range.T) - 0.1 * moment @ q)


def test_a_motor_gives_its_torque_whatever_its_encoder_says(task: GraspTask) -> None:
    n = 16
    motors = Actuation(
        names=tuple(f"m{k}" for k in range(n)),
        joint_names=task.hand.joint_names,
        moment=np.eye(n),
        length0=np.zeros(n),
        gain=np.ones(n),
        bias=np.zeros((n, 3)),
        force_range=np.tile([-1.0, 1.0], (n, 1)),
        ctrl_range=np.tile([-1.0, 1.0], (n, 1)),
        stop_rows=np.zeros((0, n)),
        stop_values=np.zeros(0),
        stop_names=(),
    )
    drive = RealDrive(ErrorModel(), nothing(task, encoder_offset=np.full(n, 0.1)), motors)
    torque = np.linspace(-0.5, 0.5, n)
    np.testing.assert_array_equal(drive.drive(0.0, torque, np.zeros(n)), torque)


@pytest.mark.parametrize("steps", [1, 3, 8])
def test_commands_act_late(task: GraspTask, steps: int) -> None:
    drive = RealDrive(ErrorModel(command_delay=steps * DT), nothing(task), task.hand.actuation)
    for k in range(30):
        acting = drive.drive(k * DT, np.full(16, 0.001 * k), np.zeros(16))
        low = task.hand.actuation.ctrl_range[:, 0]
        np.testing.assert_allclose(acting, np.maximum(low, 0.001 * max(0, k - steps)), atol=1e-12)


def test_commands_are_held(task: GraspTask) -> None:
    """At 100 Hz every fifth step is taken over; with 4 ms of delay it acts two steps later."""
    error_model = ErrorModel(command_rate=100.0, command_delay=2 * DT)
    drive = RealDrive(error_model, nothing(task), task.hand.actuation)
    low = task.hand.actuation.ctrl_range[:, 0]
    for k in range(40):
        acting = drive.drive(k * DT, np.full(16, 0.001 * k), np.zeros(16))
        held = 0.001 * max(0, (k - 2) // 5 * 5)
        np.testing.assert_allclose(acting, np.maximum(low, held), atol=1e-12)


# --- the world ---------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", ["box", "cylinder", "lbracket"])
def test_the_compiled_object_is_off_by_what_was_drawn(shape: str) -> None:
    task = GraspTask.create("allegro_hand", shape)
    drawn = nothing(task, size=1.1, mass=1.5, friction=0.5, center=np.array([0.1, -0.2, 0.0]))
    here = TrialErrors(ErrorModel(dry_friction=0.02), task, drawn)
    scenes = []
    for change in (None, here.change):
        scenes.append(build_scene(task, T_world_base=SE3.Identity(), change=change))
    (a, b), body = (scene.model for scene in scenes), scenes[0].object_body
    geoms = sorted(scenes[0].object_geoms)
    assert b.body_mass[body] == pytest.approx(1.5 * a.body_mass[body])
    np.testing.assert_allclose(
        np.sort(b.body_inertia[body]), 1.5 * 1.21 * np.sort(a.body_inertia[body]), rtol=1e-6
    )
    half = task.object.shape.half_extents
    np.testing.assert_allclose(
        b.body_ipos[body] - a.body_ipos[body], 1.1 * half * [0.1, -0.2, 0.0], atol=1e-9
    )
    np.testing.assert_allclose(b.geom_friction[geoms], 0.5 * a.geom_friction[geoms])
    np.testing.assert_allclose(b.geom_rbound[geoms], 1.1 * a.geom_rbound[geoms], rtol=1e-5)
    dofs = scenes[0].hand_dof
    np.testing.assert_allclose(b.dof_frictionloss[dofs] - a.dof_frictionloss[dofs], 0.02)
    others = np.setdiff1d(np.arange(a.ngeom), geoms)
    np.testing.assert_array_equal(a.geom_size[others], b.geom_size[others])
    np.testing.assert_array_equal(a.geom_friction[others], b.geom_friction[others])


@pytest.mark.parametrize(
    ("shape", "kept"), [("box", (1.0, 1.0)), ("sphere", (0.0, 0.0)), ("capsule", (0.0, 0.0))]
)
def test_what_stands_at_rest_does_not_roll_away(shape: str, kept: tuple[float, float]) -> None:
    """The centre of mass stays above what the object stands on: a face, a point, a line."""
    task = GraspTask.create("allegro_hand", shape)
    drawn = nothing(task, center=np.array([0.3, 0.2, -0.1]))
    R, half = task.T_world_object.rotation, task.object.shape.half_extents
    asked, there = R @ (drawn.center * half), R @ center_offset(drawn, task)
    assert there[2] == asked[2]
    np.testing.assert_allclose(there[:2], kept * asked[:2], atol=3e-4)
    floating = replace(task, table_height=None)
    np.testing.assert_allclose(center_offset(drawn, floating), drawn.center * half)
    here, away = TrialErrors(ErrorModel(), task, drawn), SE3(np.eye(3), np.array([0.0, 0.0, 1.0]))
    scene = build_scene(task, T_world_base=away, change=here.change)
    data = scene.start(task.hand.neutral, away)
    before = scene.body_pose(data, scene.object_body).translation.copy()
    while data.time < 1.0:
        mujoco.mj_step(scene.model, data)
    assert np.linalg.norm(scene.body_pose(data, scene.object_body).translation - before) < 1.5e-3


@pytest.mark.parametrize("size", [0.8, 1.2])
def test_a_larger_object_stands_on_the_table(plan: GraspPlan, size: float) -> None:
    task = plan.task
    here = TrialErrors(ErrorModel(), task, nothing(task, size=size))
    scene = build_scene(task, T_world_base=plan.T_world_base, change=here.change)
    data = scene.start(plan.q_start, plan.T_world_base_start)
    here.place(scene, data)
    radius = size * task.object.shape.half_extents[2]
    assert task.table_height is not None
    assert scene.body_pose(data, scene.object_body).translation[2] == pytest.approx(
        task.table_height + radius, abs=1e-9
    )


def test_a_torque_constant_changes_what_actuators_give(plan: GraspPlan) -> None:
    simulation = Simulation(plan, error_model=ErrorModel(torque_constant=0.3, seed=2))
    nominal, model = Simulation(plan).scene.model, simulation.scene.model
    assert simulation.error_model is not None
    ctrl, factor = simulation.scene.hand_ctrl, 1.0 + simulation.error_model.drawn.torque_constant
    for name in ("actuator_gainprm", "actuator_biasprm"):
        before, after = getattr(nominal, name)[ctrl], getattr(model, name)[ctrl]
        np.testing.assert_allclose(after[:, :3], factor[:, None] * before[:, :3])
    assert factor.std() > 0.1


# --- whole trials ------------------------------------------------------------------------------


def same_states(one: Recording, other: Recording) -> None:
    """To the last bit."""
    for name in ("q", "T_world_object", "commands", "forces"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


@pytest.mark.parametrize(
    "controller", ["feedforward", pytest.param("impedance", marks=pytest.mark.slow)]
)
def test_layers_without_errors_change_no_bit(plan: GraspPlan, controller: str) -> None:
    """With ``ideal``, and with layers in between that have nothing to do."""
    reports = []
    for layers in (False, True):
        trial = Trial(plan, controller=controller, timeline=SHORT, error_model=ErrorModel(seed=9))
        assert trial.simulation.error_model is None
        if layers:
            trial.simulation.error_model = TrialErrors(ErrorModel(), plan.task)
        reports.append(trial.run())
    first, other = reports
    same_states(first.recording, other.recording)
    assert first.verdict == other.verdict
    assert first.events == other.events
    assert first.error_model is None


@pytest.mark.slow
def test_layers_without_errors_change_no_bit_of_a_manipulation() -> None:
    plan, without = turned_cylinder(), turned_cylinder_report()
    run = ManipulationRun(plan, timeline=QUICK, physics=COARSE, error_model=ErrorModel(seed=3))
    assert run.sim.simulation.error_model is None
    run.sim.simulation.error_model = TrialErrors(ErrorModel(), plan.task)
    layered = run.perform()
    assert without.complete
    same_states(without.recording, layered.recording)
    assert without.numbers() == layered.numbers()


@pytest.mark.slow
def test_the_hand_carries_the_object_to_where_it_reads_it() -> None:
    """A camera that is 4 mm off along x: the object is put down 4 mm short of its target there."""
    plan, margins = turned_cylinder(), []
    run = ManipulationRun(plan, timeline=QUICK, physics=COARSE, estimator="none")
    drawn = nothing(plan.task, pose_bias=np.array([0.004, 0.0, 0.0]))
    run.sim.simulation.error_model = TrialErrors(ErrorModel(pose_bias=1.0), plan.task, drawn)

    def look(simulation: Simulation) -> None:
        if simulation.phase == "hold" and simulation.due(0.1):
            true = hand_contacts(simulation.scene, simulation.data)
            pair = [
                margin_without(found, plan.task, plan.task.finger_names[1])
                for found in (true, run.sim.reading.contacts())
            ]
            margins.append(pair)
            assert run.sim.reading.turned() == pytest.approx(run.sim.recorder.moved()[0], abs=1e-6)

    run.sim.simulation.on_step = look
    assert run.perform().complete
    without = turned_cylinder_report().recording
    assert without is not None
    moved = run.sim.simulation.T_world_object.translation - without.T_world_object[-1, :3]
    np.testing.assert_allclose(moved, [-0.004, 0.0, 0.0], atol=5e-4)
    assert margins  # what pads say of the contacts is what they are
    true, read = np.array(margins).T
    np.testing.assert_allclose(read, true, atol=0.02)


@pytest.mark.slow
def test_the_report_says_what_was_drawn_and_comes_again(plan: GraspPlan, tmp_path: Any) -> None:
    asked = named_errors("rough", 5)

    def early(simulation: Simulation) -> None:
        if simulation.phase == "settle":
            simulation.stop("seen enough")

    reports = [
        simulate(plan, controller="impedance", timeline=SHORT, error_model=asked, on_step=early)
        for _ in range(2)
    ]
    same_states(reports[0].recording, reports[1].recording)
    write_report(reports[0].to_dict(), tmp_path / "report.json")
    told = read_report(tmp_path / "report.json").error_model
    assert told is not None
    assert (told["name"], told["seed"]) == ("rough", 5)
    assert told["drawn"] == Drawn.of(asked, plan.task.hand).to_dict()


@pytest.mark.slow
def test_what_was_read_stands_beside_the_truth(plan: GraspPlan, tmp_path: Any) -> None:
    """Joints are off by the drawn offsets, the pose by what it was 10 steps before; to a file."""
    asked = ErrorModel(name="off", encoder_offset=0.03, pose_delay=10 * DT, seed=2)
    seen: list[tuple[FloatArray, FloatArray]] = []

    class Listens(GraspController):
        def step(self, observation: Observation) -> FloatArray:
            seen.append((observation.q.copy(), observation.T_world_object.translation.copy()))
            return super().step(observation)

    report = simulate(plan, controller=Listens, timeline=SHORT, error_model=asked, estimator="none")
    recording = report.recording
    assert recording is not None
    assert recording.read_q is not None
    assert recording.read_T_world_object is not None
    steps = np.round(recording.time / DT).astype(int)
    told = np.array([seen[k - 1][0] for k in steps])
    np.testing.assert_array_equal(recording.read_q, told)
    poses = np.array([seen[k - 1][1] for k in steps])
    np.testing.assert_array_equal(recording.read_T_world_object[:, :3], poses)
    offset = Drawn.of(asked, plan.task.hand).encoder_offset
    still = recording.phase.index("settle")
    np.testing.assert_allclose(recording.read_q[still] - recording.q[still], offset, atol=2e-3)
    lifted = recording.phase.index("hold") - 8
    assert recording.T_world_object[lifted, 2] - recording.read_T_world_object[lifted, 2] > 1e-4
    write_report(report.to_dict(), tmp_path / "report.json")
    again = read_report(tmp_path / "report.json").recording
    assert again is not None
    assert again.read_q_rad is not None
    np.testing.assert_allclose(np.array(again.read_q_rad), recording.read_q, atol=1e-5)
    joined = recording.joined(replace(recording, read_q=None, read_T_world_object=None), 9.0)
    assert joined.read_q is not None
    assert np.isfinite(joined.read_q[: len(recording)]).all()
    assert np.isnan(joined.read_q[len(recording) :]).all()


def test_the_truth_is_not_recorded_twice(plan: GraspPlan) -> None:
    recording = simulate(plan, timeline=SHORT, error_model=ErrorModel(seed=4)).recording
    assert recording is not None
    assert recording.read_q is None
    assert recording.to_dict()["read_T_world_object_m"] is None


def test_reports_of_older_versions_have_no_error_model(plan: GraspPlan, tmp_path: Any) -> None:
    data = simulate(plan, timeline=SHORT).to_dict(states=False)
    old = {k: v for k, v in data.items() if k != "error_model"} | {"version": 2}
    write_report(old, tmp_path / "report.json")
    assert read_report(tmp_path / "report.json").error_model is None
    data = simulate(plan, timeline=SHORT, error_model=ERROR_MODELS["lab"]).to_dict(states=False)
    data["reality"] = told = data.pop("error_model")
    write_report(data | {"version": 3}, tmp_path / "report.json")
    assert read_report(tmp_path / "report.json").error_model == told


def test_the_loop_yields_the_truth_and_the_controller_sees_the_reading(plan: GraspPlan) -> None:
    told: list[Observation] = []

    class Noting(Still):
        def step(self, observation: Observation) -> FloatArray:
            told.append(observation)
            return self.commands

    simulation = Simulation(
        plan,
        controller=Noting(plan.q_start.copy()),
        error_model=ErrorModel(encoder_offset=0.05, seed=1),
    )
    assert simulation.error_model is not None
    offset = simulation.error_model.drawn.encoder_offset
    for truth in simulation.run("approach", 5 * DT):
        np.testing.assert_allclose(told[-1].q - truth.q, offset, atol=1e-12)
        assert told[-1].T_world_object is truth.T_world_object


def test_a_scene_of_ones_own_has_no_error_model(plan: GraspPlan) -> None:
    scene = Simulation(plan).scene
    with pytest.raises(TaskError, match="a scene or an error model"):
        Simulation(plan, scene=scene, error_model=named_errors("lab"))
    assert Simulation(plan, scene=scene, error_model=named_errors("ideal")).error_model is None


def test_errors_of_physics_and_error_model_go_together(plan: GraspPlan) -> None:
    simulation = Simulation(
        plan, physics=PhysicsOptions(mu=0.8), error_model=ErrorModel(object_friction=0.3, seed=4)
    )
    assert simulation.error_model is not None
    geom = min(simulation.scene.object_geoms)
    expected = 0.8 * simulation.error_model.drawn.friction
    assert simulation.scene.model.geom_friction[geom, 0] == pytest.approx(expected)


@pytest.mark.parametrize("asked", [ErrorModel(), ErrorModel(name="pads", touch="binary", seed=4)])
def test_the_protocol_draws_from_a_laboratory_unless_told_otherwise(asked: ErrorModel) -> None:
    used = with_errors(asked)
    assert used == replace(ERROR_MODELS["lab"], touch=asked.touch, seed=asked.seed)
    rough = named_errors("rough", 2)
    assert with_errors(rough) is rough
