"""Estimating the object: Jacobians by differences, and answers known on paper."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.shapes import Box, Cylinder, Ellipsoid, Shape, Sphere
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask
from sim.controllers import Observation, PadReading, Phase
from sim.controllers.base import MeasuredPose
from sim.sensing.errors import ErrorModel
from sim.sensing.errors.senses import Drift
from sim.sensing.estimation import ContactNoise, ObjectEstimator, SensorErrors
from sim.sensing.estimation.estimator import PERIOD
from sim.sensing.estimation.filter import FOUND, LOST, TOO_MANY, LossDetector, PoseFilter
from sim.sensing.estimation.state import (
    Estimate,
    Grip,
    PoseMeasurement,
    SensorSample,
    TipKinematics,
    Tips,
    rolling,
    touch_equations,
)

DT = 0.002
FINE = 1e-6
SHAPES: tuple[Shape, ...] = (
    Sphere(radius=0.03),
    Cylinder(radius=0.03, height=0.1),
    Ellipsoid.from_sizes((0.02, 0.03, 0.04)),
    Box.from_sizes((0.05, 0.06, 0.07)),
)


@pytest.fixture(scope="module")
def task() -> GraspTask:
    return GraspTask.create("allegro_hand", "sphere")


@pytest.fixture(scope="module")
def kinematics(task: GraspTask) -> TipKinematics:
    return TipKinematics(task.hand, task.fingers)


def some_joints(task: GraspTask, rng: np.random.Generator) -> FloatArray:
    low, high = task.hand.q_lower, task.hand.q_upper
    return np.asarray(low + (high - low) * rng.uniform(0.2, 0.8, len(low)))


def some_pose(rng: np.random.Generator) -> SE3:
    return SE3(pin.exp3(rng.normal(size=3)), 0.1 * rng.normal(size=3))


def differences(f: Callable[[FloatArray], FloatArray], n: int) -> FloatArray:
    """Jacobian of f at 0 by central differences."""
    columns = []
    for e in FINE * np.eye(n):
        columns.append((f(e) - f(-e)) / (2.0 * FINE))
    return np.array(columns).T


# --- Jacobians ---------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_velocities_of_tips_and_how_they_bend(
    task: GraspTask, kinematics: TipKinematics, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    q, moved = some_joints(task, rng), rng.normal(size=len(kinematics.index))
    local = 0.02 * rng.normal(size=(len(task.fingers), 3))
    tips = kinematics.at(q)
    points = tips.out(local)

    def at(e: FloatArray) -> tuple[Tips, FloatArray]:
        there = q.copy()
        there[kinematics.index] += e
        tips = kinematics.at(there)
        return tips, tips.out(local)

    n = len(moved)
    numeric = differences(lambda e: at(e)[1].ravel(), n).reshape(-1, 3, n)
    assert tips.jacobians(points).transpose(0, 2, 1) == pytest.approx(numeric, abs=1e-8)

    def velocity(e: FloatArray) -> FloatArray:
        tips, points = at(e)
        return np.asarray((moved @ tips.jacobians(points)).ravel())

    bent = differences(velocity, n).reshape(-1, 3, n)
    assert tips.bending(points, moved).transpose(0, 2, 1) == pytest.approx(bent, abs=1e-7)


@pytest.mark.parametrize("seed", range(3))
def test_motion_by_offsets(task: GraspTask, kinematics: TipKinematics, seed: int) -> None:
    rng = np.random.default_rng(seed)
    q, moved = some_joints(task, rng), 0.1 * rng.normal(size=len(kinematics.index))
    n = len(task.fingers)
    local = 0.02 * rng.normal(size=(n, 3))
    tips = kinematics.at(q)
    points = tips.out(local)
    d = 0.1 * rng.normal(size=6)
    # contacts slide so that the object moves exactly like a rigid body
    slid = d[:3] + np.cross(d[3:], points) - moved @ tips.jacobians(points)
    weight, loose = 1e6 * rng.uniform(1.0, 4.0, n), 1e-6 * np.eye(6)

    def displacement(e: FloatArray) -> FloatArray:
        true = q.copy()
        true[kinematics.index] -= e
        tips = kinematics.at(true)
        points = tips.out(local)
        grip = Grip(points, np.zeros((n, 3)), slid, weight, np.zeros(n))
        motion = rolling(tips, tips.jacobians(points), grip, moved, np.zeros(6), loose, DT)
        return motion.displacement

    grip = Grip(points, np.zeros((n, 3)), slid, weight, np.zeros(n))
    motion = rolling(tips, tips.jacobians(points), grip, moved, np.zeros(6), loose, DT)
    assert motion.displacement == pytest.approx(d, abs=1e-8)
    assert motion.by_offsets == pytest.approx(differences(displacement, len(moved)), abs=1e-6)
    told = motion.by_joints @ moved + DT * motion.rest_rate
    assert told == pytest.approx(motion.displacement, abs=1e-12)


@pytest.mark.parametrize("shape", SHAPES, ids=lambda s: s.kind)
@pytest.mark.parametrize("felt", [True, False])
def test_equations_of_touch(
    task: GraspTask, kinematics: TipKinematics, shape: Shape, felt: bool
) -> None:
    rng = np.random.default_rng(7)
    q, m = some_joints(task, rng), len(kinematics.index)
    n = len(task.fingers)
    estimate = Estimate(some_pose(rng), 0.03 * rng.normal(size=m), 0.02, np.eye(7 + m))

    def tips_of(estimate: Estimate) -> Tips:
        true = q.copy()
        true[kinematics.index] -= estimate.offsets
        return kinematics.at(true)

    # contacts on the surface of the estimate, off the edges of a box
    inner = 0.4 * shape.half_extents * rng.uniform(-1, 1, (n, 3))
    on, normals = shape.closest_point(inner + 0.3 * np.sign(inner) * [0.0, 0.1, 0.0])
    T, grown = estimate.T_base_object, 1.0 + estimate.size
    height = 0.0 if felt else 0.012
    points = grown * on @ T.rotation.T + T.translation
    points = points + height * normals @ T.rotation.T
    tips = tips_of(estimate)
    local, local_normals = tips.into(points), tips.turned_into(normals @ T.rotation.T)

    def residual(e: FloatArray) -> FloatArray:
        true = estimate._shifted(e, estimate.covariance)
        tips = tips_of(true)
        outward = tips.turned(local_normals) if felt else None
        equations = touch_equations(shape, true, tips, tips.out(local), np.full(n, height), outward)
        return equations.residual

    outward = tips.turned(local_normals) if felt else None
    equations = touch_equations(shape, estimate, tips, points, np.full(n, height), outward)
    assert equations.residual == pytest.approx(np.zeros((3 if felt else 1) * n), abs=1e-9)
    numeric = -differences(residual, 7 + m)
    # the curvature, 1/m, is a forward difference over 0.1 mm
    rel, most = (5e-3, 0.1) if felt else (1e-6, 1e-6)
    assert equations.jacobian == pytest.approx(numeric, rel=rel, abs=most)
    assert equations.jacobian[:n] == pytest.approx(numeric[:n], abs=1e-6)


@given(seed=st.integers(0, 2**32 - 1), size=st.floats(0.0, 0.5))
@settings(max_examples=30, deadline=None)
def test_an_error_goes_through_a_motion_whatever_the_pose(seed: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    estimate, xi, d = some_pose(rng), size * rng.normal(size=6), rng.normal(size=6)
    M = pin.exp6(pin.Motion(d))
    true = pin.exp6(pin.Motion(xi)) * estimate
    covariance = np.outer([*xi, 0.0], [*xi, 0.0])
    estimate = Estimate(estimate, np.zeros(0), 0.0, covariance)
    after = estimate.moved(d, np.zeros((6, 0)), np.zeros((6, 6)), np.zeros(0))
    off = M.action @ xi
    assert (pin.exp6(pin.Motion(off)) * after.T_base_object).isApprox(M * true, 1e-9)
    assert after.covariance[:6, :6] == pytest.approx(np.outer(off, off), abs=1e-9)


# --- known on paper ----------------------------------------------------------------------------


@pytest.mark.parametrize("below", [0.0, -1.0, 1.0])
def test_a_sphere_between_two_plates(below: float) -> None:
    radius, way, steps = 0.03, 0.02, 1000
    linear = np.zeros((2, 2, 3))
    linear[0, 0, 0] = linear[1, 1, 0] = 1.0  # each plate slides along x
    plates = Tips(np.tile(np.eye(3), (2, 1, 1)), np.zeros((2, 3)), linear, np.zeros((2, 2, 3)))
    pose = SE3(np.eye(3), np.array([0.1, 0.2, 0.3]))
    up = np.array([[0.0, 0.0, radius], [0.0, 0.0, -radius]])
    for _ in range(steps):
        grip = Grip(
            pose.translation + up, -up / radius, np.zeros((2, 3)), np.full(2, 1e8), np.full(2, 1e2)
        )
        motion = rolling(
            plates,
            plates.jacobians(grip.points),
            grip,
            way / steps * np.array([1.0, below]),
            np.zeros(6),
            1e-6 * np.eye(6),
            DT,
        )
        pose = pin.exp6(pin.Motion(motion.displacement)) * pose
    # the centre goes half as far as both plates together, and it turns by their difference
    middle, turn = 0.5 * way * (1.0 + below), 0.5 * way * (1.0 - below) / radius
    assert pose.translation == pytest.approx([0.1 + middle, 0.2, 0.3], abs=2e-6)
    assert pin.log3(pose.rotation) == pytest.approx([0.0, turn, 0.0], abs=2e-6)


def test_looks_at_an_object_at_rest_average(task: GraspTask) -> None:
    errors = SensorErrors(camera=2e-3, camera_turn=0.03)
    known = PoseFilter(task, errors, ContactNoise(), feels=True)
    pose = SE3(np.eye(3), np.array([0.1, -0.2, 0.3]))
    filtered = known.first(PoseMeasurement(pose, 0, np.inf))
    for k in range(1, 16):
        filtered = known.corrected_by_pose(filtered, PoseMeasurement(pose, k, 0.1))
    deviation = np.sqrt(np.diagonal(filtered.estimate.pose_covariance()))
    assert deviation == pytest.approx([2e-3 / 4.0] * 3 + [0.03 / 4.0] * 3, rel=1e-9)


def test_felt_normals_count_as_much_as_draws_of_their_drift(task: GraspTask) -> None:
    """The mean of many equations is as uncertain as the mean of pads whose error drifts."""
    place, samples, axes = 1e-3, 500, 4000
    error_model = ErrorModel(touch_place=place, drift_time=0.2)
    known = PoseFilter(task, SensorErrors.of(error_model), ContactNoise(normal=1e-9), feels=True)
    n, q = len(task.fingers), task.hand.neutral
    estimate = known.first(
        PoseMeasurement(SE3(np.eye(3), np.array([0.0, 0.0, 0.1])), 0, np.inf)
    ).estimate
    axis = np.array([finger.pad.axis for finger in task.fingers])
    radii = np.array([finger.pad.radius for finger in task.fingers])
    sample = SensorSample(
        time=0.0,
        q=q,
        T_world_base=SE3.Identity(),
        standing=False,
        touching=np.ones(n, dtype=bool),
        points=np.array([finger.pad.center for finger in task.fingers]) + radii[:, None] * axis,
        normals=axis,
        sliding=np.zeros((n, 3)),
    )
    # a covariance so wide that no contact counts as far from where it is expected
    wide = Estimate(
        estimate.T_base_object, estimate.offsets, estimate.size, 1e6 * np.eye(7 + len(q))
    )
    noise = known._contact_update(wide, sample, PERIOD).noise[n:].reshape(n, 2) / samples
    drift = Drift(np.full(axes, place), error_model.drift_time, np.random.default_rng(0))
    mean = np.mean([drift.step(PERIOD) for _ in range(samples)], axis=0)
    assert np.sqrt(noise) == pytest.approx((mean.std() / radii)[:, None].repeat(2, 1), rel=0.05)


def test_an_object_may_have_been_pushed_before_a_late_pad_says_that_it_touches(
    task: GraspTask,
) -> None:
    """What is not known grows as if the hand had touched for as long as the pads are late."""
    pose = SE3(np.eye(3), np.array([0.0, 0.0, 0.1]))
    first, later = (
        SensorSample(
            time=time,
            q=task.hand.neutral,
            T_world_base=SE3.Identity(),
            standing=True,
            touching=np.full(len(task.fingers), touching),
            points=np.zeros((len(task.fingers), 3)),
            normals=np.zeros((len(task.fingers), 3)),
            sliding=np.zeros((len(task.fingers), 3)),
        )
        for time, touching in ((0.0, False), (PERIOD, True))
    )

    def moved(delay: float, begin: SensorSample, end: float) -> FloatArray:
        error_model = ErrorModel(touch_delay=delay)
        known = PoseFilter(task, SensorErrors.of(error_model), ContactNoise(), feels=False)
        estimate = known.first(PoseMeasurement(pose, 0, 0.1)).estimate
        prior, information = known._prior(estimate, begin, replace(later, time=end))
        assert not prior.any()
        return np.asarray(np.linalg.inv(information))

    late = moved(0.03, first, PERIOD)
    assert late == pytest.approx(moved(0.0, first, PERIOD + 0.03))
    assert (np.diag(late) > 2.0 * np.diag(moved(0.0, first, PERIOD))).all()
    touched = replace(later, time=0.0)
    assert moved(0.03, touched, PERIOD) == pytest.approx(moved(0.0, touched, PERIOD))


def test_noise_of_a_look_against_draws(task: GraspTask) -> None:
    errors = SensorErrors(camera=1e-3, camera_turn=0.02)
    known, rng = PoseFilter(task, errors, ContactNoise(), feels=True), np.random.default_rng(0)
    pose = some_pose(rng)
    estimate = Estimate(pose, np.zeros(0), 0.0, np.eye(7))
    off = []
    for _ in range(4000):
        shift, turn = 1e-3 * rng.normal(size=3), 0.02 * rng.normal(size=3)
        off.append(estimate.error_to(SE3(pin.exp3(turn) @ pose.rotation, pose.translation + shift)))
    told = known.pose_noise(PoseMeasurement(pose, 0, 0.1))
    deviation = np.sqrt(np.diagonal(told))
    assert np.cov(np.array(off).T) / np.outer(deviation, deviation) == pytest.approx(
        told / np.outer(deviation, deviation), abs=0.08
    )


def test_offsets_make_the_motion_as_uncertain_as_draws_say(
    task: GraspTask, kinematics: TipKinematics
) -> None:
    rng = np.random.default_rng(3)
    q, m, n = some_joints(task, rng), len(kinematics.index), len(task.fingers)
    moved, offset = 0.3 * rng.normal(size=m), np.deg2rad(1.0)
    local = 0.01 * rng.normal(size=(n, 3))
    weight, loose = np.full(n, 1e6), np.eye(6)
    tips = kinematics.at(q)
    points = tips.out(local)
    slid = -moved @ tips.jacobians(points)  # in truth it does not move

    def motion_of(wrong: FloatArray) -> Any:
        read = q.copy()
        read[kinematics.index] -= wrong
        tips = kinematics.at(read)
        points = tips.out(local)
        grip = Grip(points, np.zeros((n, 3)), slid, weight, np.zeros(n))
        return rolling(tips, tips.jacobians(points), grip, moved, np.zeros(6), loose, DT)

    drawn = np.array([motion_of(offset * rng.normal(size=m)).displacement for _ in range(1500)])
    by = motion_of(np.zeros(m)).by_offsets
    told = np.sqrt(np.diagonal(offset**2 * by @ by.T))
    assert drawn.std(axis=0) == pytest.approx(told, rel=0.1)


# --- the estimator over time -------------------------------------------------------------------


def seen(
    time: float,
    pose: SE3,
    *,
    phase: Phase = "hold",
    stamp: float | None = None,
    touching: bool = True,
    base: SE3 | None = None,
    n: int = 4,
    **other: Any,
) -> Observation:
    """What is read at a time: fingers at rest that touch, and the pose with its time stamp."""
    values: dict[str, Any] = {
        "q": np.full(16, 0.4),
        "v": np.zeros(16),
        "T_world_base": base or SE3.Identity(),
        "T_world_object": pose,
        "normal_forces": np.full(n, 1.0 if touching else 0.0),
        "read_twist": lambda: np.zeros(6),
        "read_contacts": lambda: None,
        "read_pads": lambda: PadReading.nothing(n),
        "measured_pose": None if stamp is None else MeasuredPose(time=stamp, T_world_object=pose),
    }
    return Observation(time=time, phase=phase, progress=0.0, **(values | other))


DIRECTIONS = np.array([[1.0, 0.0, 0.0], [-0.6, 0.8, 0.0], [-0.6, -0.8, 0.0], [0.0, 0.0, -1.0]])


def looked_at(task: GraspTask, *, late: float, noise: float, touching: bool) -> ObjectEstimator:
    """A sphere that is carried, turned and measured every 20 ms; fingers at rest on it."""
    rng, shape = np.random.default_rng(5), task.object.shape
    assert isinstance(shape, Sphere)
    T_base_object = SE3(np.eye(3), np.array([0.1, 0.0, 0.2]))
    noises = [pin.exp6(pin.Motion(noise * rng.normal(size=6))) for _ in range(20)]

    def base_at(time: float) -> SE3:
        return SE3(pin.exp3(np.array([0.0, 0.0, 0.5 * time])), np.array([time, 0.0, 0.0]))

    estimator = ObjectEstimator(task, SensorErrors(camera=1e-3, camera_turn=0.01))
    for i in range(round(0.42 / DT)):
        time = i * DT
        k = min(max(0, int((time - late + 1e-9) / 0.02)), 19)
        pose = base_at(0.02 * k) * noises[k] * T_base_object
        base = base_at(time)
        there, turned = base * T_base_object, DIRECTIONS @ base.rotation.T
        pads = PadReading(
            normal_force=np.ones(4),
            force=-turned,
            position=there.translation + shape.radius * turned,
            normal=-turned,
            sliding=np.zeros((4, 3)),
        )
        observation = seen(time, pose, stamp=0.02 * k, base=base, touching=touching)
        estimator.step(replace(observation, read_pads=partial(PadReading, **vars(pads))))
    return estimator


@pytest.mark.parametrize("touching", [False, True])
def test_a_late_look_counts_as_if_it_had_been_in_time(task: GraspTask, touching: bool) -> None:
    off = []
    for noise in (1e-3, 1e-4):
        soon, later = (
            looked_at(task, late=late, noise=noise, touching=touching).known for late in (0.0, 0.03)
        )
        assert soon is not None and later is not None
        change = soon.estimate.T_base_object.actInv(later.estimate.T_base_object)
        off.append(float(np.abs(pin.log6(change).vector).max()))
        scale = np.sqrt(np.diagonal(soon.estimate.covariance))
        scale = np.outer(scale, scale) + 1e-12
        difference = (soon.estimate.covariance - later.estimate.covariance) / scale
        assert np.abs(difference).max() < 1e-6 + 60.0 * noise
    # Jacobians are not computed anew: an error of second order
    assert off[0] < 1e-5
    assert off[1] < 2e-2 * off[0] + 1e-12


def test_a_late_look_is_no_look_of_now(task: GraspTask) -> None:
    late = looked_at(task, late=0.03, noise=1e-4, touching=False).known
    assert late is not None
    off = late.estimate.T_base_object.translation - np.array([0.1, 0.0, 0.2])
    assert np.linalg.norm(off) < 5e-4  # in 30 ms the hand goes 30 mm


def test_a_look_that_is_far_off_is_refused_until_there_are_too_many(task: GraspTask) -> None:
    pose = SE3(np.eye(3), np.array([0.1, 0.0, 0.2]))
    wrong = SE3(np.eye(3), np.array([0.2, 0.0, 0.2]))
    estimator, time = ObjectEstimator(task, SensorErrors(), touch="binary"), 0.0
    for _ in range(100):
        estimator.step(seen(time, pose, stamp=time))
        time += 0.01
    for k in range(TOO_MANY):
        told = estimator.step(seen(time, wrong, stamp=time))
        away = np.linalg.norm(told.T_world_object.translation - pose.translation)
        assert (away < 0.01) == (k < TOO_MANY - 1)
        time += 0.01


def test_it_says_when_it_no_longer_knows_and_when_again(task: GraspTask) -> None:
    pose = SE3(np.eye(3), np.array([0.1, 0.0, 0.2]))
    estimator = ObjectEstimator(task, SensorErrors(camera=1e-4), touch="binary")
    time, known = 0.0, []
    for touching, stamped in ((True, True), (False, False), (False, True)):
        for _ in range(50):
            stamp = time if stamped else 0.49
            told = estimator.step(seen(time, pose, stamp=stamp, touching=touching))
            time += 0.01
        assert told.uncertainty is not None
        known.append(told.uncertainty.known)
    assert known == [True, False, True]
    assert [e.kind for e in estimator.events] == ["pose lost", "pose known again"]
    assert 0.5 < estimator.events[0].time < 0.6


@given(share=st.floats(0.0, 2.0))
def test_knowing_has_hysteresis(share: float) -> None:
    knowing = LossDetector()
    some = (share * LOST[0]) ** 2 / 3.0 * np.diag([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    assert knowing.update(0.0, some) == (share < 1.0 - 1e-12) or share == pytest.approx(1.0)
    knowing.update(0.1, 100.0 * np.diag([LOST[0] ** 2] * 6))
    assert knowing.update(0.2, some) == (share < FOUND) or share == pytest.approx(FOUND)
