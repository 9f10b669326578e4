"""Policies: their playback, their file, what they see, and that a training goes on as it began."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from shutil import copytree
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from benchmarks import conditions as bench
from planner.errors import (
    FileFormatError,
    HandError,
    NoGraspFoundError,
    NotFoundError,
    ObjectError,
    TaskError,
)
from planner.hand_loading import load_hand
from planner.kinematics import HandState
from planner.motion.manipulation import ManipulationPlan
from planner.objects import parse_object
from planner.spatial import SE3
from sim.cli import main
from sim.controllers import MotionReference, Observation
from sim.learning import (
    Conditions,
    Course,
    ObjectRange,
    Plans,
    Policy,
    PolicyController,
    PolicyFor,
    Progress,
    TurnTask,
    learn,
    open_loop,
    policy_controller,
    trials,
)
from sim.learning.controller import policy_file, shipped_policies
from sim.learning.policy import error_numbers, normalised, physics_numbers
from sim.learning.senses import (
    AIM,
    LAGS,
    LENGTH,
    SENSES,
    ObjectLag,
    Playback,
    SenseHistory,
    columns,
    servo_shift,
)
from sim.learning.training import POLICY, fit, read_episode, run_episode, trained_network
from sim.manipulation import ManipulationReport, ManipulationRun
from sim.scene.physics import PhysicsOptions
from sim.sensing.errors import ErrorModel, named_errors
from sim.simulation import Simulation

OBJECT = "cylinder:0.03x0.08"
TASK = TurnTask(
    hand="allegro_hand", objects=OBJECT, angle=math.pi / 4, error_model=named_errors("lab")
)
WITHOUT_POSE = tuple(name for name in SENSES if name != "object")
CALM = Conditions(
    mass=0.1, mu=0.8, shift=(0.001, -0.001), heading=0.02, push=(0.2, 0.0), push_after=0.3, seed=4
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("plans")


@pytest.fixture(scope="module")
def plan(folder: Path) -> ManipulationPlan:
    return Plans(TASK, folder)(0)


@pytest.fixture
def policy(plan: ManipulationPlan) -> Policy:
    """Small random layers: actions about 0.01."""
    rng = np.random.default_rng(3)
    hand = plan.task.hand
    m, nu = SenseHistory(plan.task, WITHOUT_POSE).size, len(hand.actuation.names)
    return Policy(
        about=PolicyFor.of(
            hand,
            objects=OBJECT,
            angle_deg=90.0,
            error_model="lab",
            senses=WITHOUT_POSE,
            command="by hand",
        ),
        mean=rng.normal(size=m).astype(np.float32),
        scale=rng.uniform(0.5, 1.0, size=m).astype(np.float32),
        weights=tuple(
            (0.05 * rng.normal(size=shape)).astype(np.float32) for shape in ((m, 8), (8, nu))
        ),
        biases=tuple((0.01 * rng.normal(size=n)).astype(np.float32) for n in (8, nu)),
    )


# ---- what is drawn


def test_all_ranges_of_an_object_are_drawn_together() -> None:
    sizes = ObjectRange("box:0.05..0.07x0.05..0.07x0.08")
    assert sizes.at(0.0) == "box:0.05x0.05x0.08"
    assert sizes.at(0.5) == "box:0.06x0.06x0.08"
    assert sizes.at(1.0) == "box:0.07x0.07x0.08"
    assert ObjectRange(OBJECT).at(0.3) == OBJECT


def test_a_range_that_ends_below_its_beginning_is_told_the_other_way_round() -> None:
    with pytest.raises(ObjectError, match=r"0\.07\.\.0\.05 .* give 0\.05\.\.0\.07"):
        ObjectRange("box:0.07..0.05x0.05x0.08")
    with pytest.raises(ObjectError, match=r"radius is -0.03; give a finite number > 0 in m"):
        ObjectRange("cylinder:-0.03..0.02x0.08")


def test_conditions_are_those_of_the_bench() -> None:
    for name in ("FRICTION", "MASS", "BELIEVED_MU", "SHIFT", "HEADING", "PUSH_FORCE", "PUSH_TIME"):
        assert getattr(trials, name) == getattr(bench, name), name
    assert trials.PUSH_UNTIL == bench.PUSH_UNTIL
    drawn = [Conditions.draw(np.random.default_rng(k)) for k in range(200)]
    assert min(d.mass for d in drawn) >= bench.MASS[0] and max(d.mass for d in drawn) > 0.28
    assert max(abs(v) for d in drawn for v in d.shift) <= bench.SHIFT
    assert {d.seed for d in drawn} != {drawn[0].seed}


# ---- the playback


def test_commands_of_the_playback_exert_the_planned_forces(plan: ManipulationPlan) -> None:
    """Another way to the same torque: Jacobians of the pads, actuators by their law."""
    playback = Playback(plan.grasp)
    playback.reference = MotionReference(plan.motion)
    knot, actuation = plan.motion.knots[0], plan.task.hand.actuation
    state = HandState(plan.task.hand, knot.q)
    T_base_world = plan.motion.T_world_base.inverse()
    wanted = state.gravity_torque(T_base_world.rotation @ plan.task.gravity)
    forces = knot.contacts.forces_in_axes() @ T_base_world.rotation.T
    for finger, point, force in zip(
        plan.task.fingers, knot.contacts.positions, forces, strict=True
    ):
        jacobian = state.point_jacobian(finger.pad.joint_id, T_base_world.act(point))[:3]
        own = np.zeros_like(wanted)
        own[finger.q_index] = (jacobian.T @ force)[finger.q_index]
        wanted = wanted + own
    ctrl = playback.ctrl - playback.share * playback.press + playback.press
    length = actuation.moment @ knot.q + actuation.length0
    made = actuation.moment.T @ (
        actuation.gain * ctrl + actuation.bias[:, 0] + actuation.bias[:, 1] * length
    )
    assert np.abs(wanted).max() > 0.05
    np.testing.assert_allclose(made, wanted, atol=1e-9)


def test_the_clock_ends_beyond_the_turn_and_not_beyond_the_plan(plan: ManipulationPlan) -> None:
    playback = Playback(plan.grasp)
    reference = MotionReference(plan.motion, angle=plan.angle)
    playback.reference = reference
    asked = TASK.angle
    for k in range(2000):
        playback.step(seen(plan, time=0.002 * k, phase="turn"))
    assert playback.place * plan.motion.path.angle == pytest.approx(asked + AIM, abs=1e-6)
    assert playback.end == pytest.approx(asked + AIM)
    assert playback.rate == pytest.approx(0.0, abs=0.03)
    whole = Playback(plan.grasp, aim=1.0)
    whole.reference = reference
    assert whole.end == pytest.approx(plan.motion.path.angle)


def test_a_posture_read_at_the_first_touch_shifts_posture_and_commands(
    plan: ManipulationPlan,
) -> None:
    first, bent = Playback(plan.grasp), Playback(plan.grasp)
    aside = np.full(plan.task.hand.nq, 0.01)
    for playback, q in ((first, plan.grasp.q), (bent, plan.grasp.q + aside)):
        playback.step(seen(plan, q=q))
        playback.step(seen(plan, q=q, time=0.002))
    np.testing.assert_allclose(bent.q - first.q, aside, atol=1e-12)
    servo = plan.task.hand.actuation.moment @ aside  # kp over gain is 1
    np.testing.assert_allclose(bent.ctrl - first.ctrl, servo, atol=1e-12)


def test_a_hand_with_motors_has_no_playback() -> None:
    with pytest.raises(HandError, match="of shadow_hand_torque are no position servos"):
        servo_shift(load_hand("shadow_hand_torque"))
    assert servo_shift(load_hand("shadow_hand")).shape == (20, 24)


def seen(
    plan: ManipulationPlan, *, time: float = 0.0, phase: Any = "settle", q: Any = None
) -> Observation:
    return Observation(
        time=time,
        phase=phase,
        progress=0.5,
        q=plan.grasp.q if q is None else q,
        v=np.zeros(plan.task.hand.nq),
        T_world_base=plan.motion.T_world_base,
        T_world_object=plan.task.T_world_object,
        normal_forces=np.arange(1.0, 1.0 + len(plan.task.fingers)),
        read_twist=lambda: np.zeros(6),
        read_contacts=lambda: plan.grasp.contacts,
    )


# ---- where the object is


def moved(plan: ManipulationPlan, twist: Any, at: int = 0) -> Observation:
    """The object off its place at a knot by a twist (6,) in base axes."""
    base = plan.motion.T_world_base
    planned = base.inverse() * plan.motion.knots[at].T_world_object
    pose = SE3(pin.exp3(np.asarray(twist[3:])) @ planned.rotation, planned.translation + twist[:3])
    return replace(seen(plan), T_world_object=base * pose)


def test_the_lag_of_the_object_is_the_torque_that_moves_it_back(plan: ManipulationPlan) -> None:
    """In motions that the contacts allow, torques do as much work as the deviation by its twist."""
    rng, knot = np.random.default_rng(2), plan.motion.knots[0]
    T_base_world = plan.motion.T_world_base.inverse()
    points = knot.contacts.transformed(T_base_world).positions
    center = (T_base_world * knot.T_world_object).translation
    fingers, before = plan.task.fingers, HandState(plan.task.hand, knot.q)
    columns_of_j = []
    for k in range(plan.task.hand.nq):
        q = knot.q.copy()
        q[k] += 1e-6
        after = HandState(plan.task.hand, q)
        columns_of_j.append(
            np.concatenate(
                [
                    after.joint_pose(f.pad.joint_id).act(
                        before.joint_pose(f.pad.joint_id).actInv(point)
                    )
                    - point
                    for f, point in zip(fingers, points, strict=True)
                ]
            )
            / 1e-6
        )
    jacobian = np.array(columns_of_j).T
    lag = ObjectLag(plan.grasp)
    lag.follow(plan.motion)
    assert np.allclose(lag.vector(moved(plan, np.zeros(6)), 0.0), 0.0)
    deviation = np.concatenate([0.001 * rng.normal(size=3), 0.02 * rng.normal(size=3)])
    told = lag.vector(moved(plan, deviation), 0.0).reshape(2, -1).sum(axis=0)
    for _ in range(3):
        twist = rng.normal(size=6)
        rigid = np.concatenate([twist[:3] + np.cross(twist[3:], p - center) for p in points])
        rates = np.linalg.lstsq(jacobian, rigid, rcond=None)[0]
        np.testing.assert_allclose(jacobian @ rates, rigid, atol=1e-9)
        work = deviation[:3] @ twist[:3] / LENGTH**2 + deviation[3:] @ twist[3:]
        assert told @ rates == pytest.approx(np.rad2deg(work), rel=2e-3, abs=0.05)


def test_what_the_object_was_off_at_first_counts_less_and_less(plan: ManipulationPlan) -> None:
    """A tilt and a shift fade out of what is wanted, a turn about the axis stays."""
    axis = plan.motion.T_world_base.rotation.T @ plan.motion.path.axis
    for first, kept in (
        (np.r_[np.zeros(3), 0.05 * axis], True),
        (np.r_[0.002, np.zeros(5)], False),
    ):
        lag = ObjectLag(plan.grasp)
        lag.follow(plan.motion)
        assert np.allclose(lag.vector(moved(plan, first), 0.0), 0.0)
        at_end = lag.vector(moved(plan, first, at=-1), 1.0)
        assert np.allclose(at_end, 0.0, atol=0.02) == kept, at_end


def test_a_part_of_all_senses_is_what_a_policy_of_that_part_is_told(
    plan: ManipulationPlan,
) -> None:
    names = ("touch", "object")
    whole, part, playback = SenseHistory(plan.task), SenseHistory(plan.task, names), None
    playback = Playback(plan.grasp)
    action, off = np.zeros(16), np.r_[0.001, 0.002, 0.0, 0.0, 0.0, 0.03]
    for k in range(8):
        observation = replace(moved(plan, k * off), time=0.01 * k)
        playback.step(observation)
        told, of_part = (h.vector(observation, playback, action) for h in (whole, part))
    assert np.abs(of_part).max() > 1.0
    np.testing.assert_array_equal(told[columns(plan.task.hand, names)], of_part)


@pytest.mark.slow
def test_a_policy_brings_its_estimator_unless_another_is_asked_for(
    plan: ManipulationPlan, policy: Policy
) -> None:
    touching = replace(policy, about=replace(policy.about, estimator="touch"))
    for asked, got in ((None, "touch"), ("contact", "contact")):
        driver = PolicyController(plan.grasp, touching)
        run = ManipulationRun(
            plan, controller=driver, error_model=TASK.error_model, estimator=asked
        )
        assert (run.sim.simulation.senses() or {})["estimator"] == got


# ---- what a policy sees


def test_the_history_has_readings_of_before_each_at_its_lag(plan: ManipulationPlan) -> None:
    history, playback = SenseHistory(plan.task), Playback(plan.grasp)
    nq, nu = plan.task.hand.nq, len(plan.task.hand.actuation.names)
    playback.step(seen(plan))
    q0 = playback.q.copy()
    for k in range(10):
        told = history.vector(seen(plan, q=q0 + 0.001 * k), playback, np.full(nu, 0.1 * k))
    assert told.shape == (history.size,)
    for place, age in enumerate(LAGS):
        expected = np.full(nq, 0.001 * (9 - age))
        np.testing.assert_allclose(told[place * nq : (place + 1) * nq], expected, atol=1e-12)
    blind = SenseHistory(plan.task, ("touch",))
    assert blind.size == len(LAGS) * len(plan.task.hand.fingers)


def test_touch_of_a_finger_stands_in_the_place_of_that_finger(plan: ManipulationPlan) -> None:
    few = replace(plan.task, finger_names=("thumb", "middle", "ring"), may_spare_fingers=False)
    history, playback = SenseHistory(few, ("touch",)), Playback(plan.grasp)
    playback.step(seen(plan))
    observation = replace(seen(plan), normal_forces=np.array([3.0, 4.0, 5.0]))
    told = history.vector(observation, playback, np.zeros(16))
    fingers = list(plan.task.hand.fingers)
    expected = [{"thumb": 3.0, "middle": 4.0, "ring": 5.0}.get(name, 0.0) for name in fingers]
    assert told[: len(fingers)].tolist() == expected


@pytest.mark.parametrize("names", [(), ("sight",)])
def test_senses_that_do_not_exist_are_refused(
    plan: ManipulationPlan, names: tuple[str, ...]
) -> None:
    with pytest.raises((NotFoundError, TaskError), match="joints, "):
        SenseHistory(plan.task, names)


@pytest.mark.slow
@pytest.mark.usefixtures("brief_manipulations")
def test_a_policy_reads_nothing_of_the_camera(plan: ManipulationPlan, policy: Policy) -> None:
    """With a camera that is half a metre off it does exactly the same."""
    blind = ErrorModel(name="blind", pose_noise=0.5, turn_noise=1.0, pose_rate=7.0)
    task = replace(TASK, physics=PhysicsOptions())
    runs = [
        CALM.run(replace(task, error_model=error_model), plan, PolicyController(plan.grasp, policy))
        for error_model in (ErrorModel(), blind)
    ]
    one, other = map(until_turned, runs)
    until = int(one.log.during("turn")[-1])  # where it is put down after that is for the camera
    assert until > 100
    assert np.array_equal(one.log.turn[:until], other.log.turn[:until])
    assert np.array_equal(one.log.normal_force[:until], other.log.normal_force[:until])


@pytest.mark.slow
@pytest.mark.usefixtures("brief_manipulations")
def test_the_open_loop_turns_the_object_where_all_is_as_planned(plan: ManipulationPlan) -> None:
    task = replace(TASK, error_model=ErrorModel(), physics=PhysicsOptions())
    report = CALM.run(task, plan, open_loop(plan.grasp)).perform()
    assert report.success, report
    assert report.controller == "PolicyController"


# ---- the network and its file


@pytest.mark.slow
def test_a_policy_computes_what_its_trainer_computes(plan: ManipulationPlan) -> None:
    pytest.importorskip("sklearn")
    rng = np.random.default_rng(0)
    m, nu = SenseHistory(plan.task).size, 16
    senses = (3.0 * rng.normal(size=(3000, m)) + 1.0).astype(np.float32)
    wanted = (0.1 * np.tanh(senses[:, :nu])).astype(np.float32)
    about = PolicyFor.of(plan.task.hand, objects=OBJECT, angle_deg=90.0, error_model="lab")
    policy = fit(about, senses, wanted, epochs=20, seed=1)
    x = normalised(senses, policy.mean, policy.scale)
    unit = float(wanted.std())
    network = trained_network(x, wanted / unit, epochs=20, seed=1)
    expected = np.clip(unit * network.predict(x), -1.0, 1.0)
    assert np.abs(expected).max() > 0.01
    np.testing.assert_allclose(policy.act(senses), expected, atol=1e-5)
    np.testing.assert_allclose(policy.act(senses[7]), expected[7], atol=1e-5)
    before = np.mean(wanted**2)
    assert np.mean((policy.act(senses) - wanted) ** 2) < 0.5 * before


def test_a_policy_is_the_same_after_its_file(policy: Policy, tmp_path: Path) -> None:
    file = tmp_path / "policy"
    policy.save(file)
    again = Policy.load(file, hand=load_hand("allegro_hand"))
    assert again.about == policy.about
    senses = np.random.default_rng(1).normal(size=(5, len(policy.mean)))
    assert np.array_equal(again.act(senses), policy.act(senses))
    assert not any(a.dtype == object for a in np.load(file).values())


def test_a_policy_of_another_hand_is_refused_by_name(policy: Policy, tmp_path: Path) -> None:
    policy.save(tmp_path / "p.npz")
    with pytest.raises(HandError, match=r"for the hand allegro_hand, .* has shadow_hand"):
        Policy.load(tmp_path / "p.npz", hand=load_hand("shadow_hand"))


def changed(policy: Policy, tmp_path: Path, **header: Any) -> Path:
    """A policy's file with another header."""
    file = tmp_path / "changed.npz"
    policy.save(file)
    with np.load(file) as stored:
        arrays = dict(stored)
    told = json.loads(arrays["header"].tobytes()) | header
    arrays["header"] = np.frombuffer(json.dumps(told).encode(), dtype=np.uint8)
    with file.open("wb") as stream:
        np.savez(stream, **arrays)
    return file


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ({"version": 5}, "version 5; this version reads"),
        ({"format": "opposable-plan"}, "of format 'opposable-plan'"),
        ({"senses": ["sight"]}, "damaged: no sense"),
        ({"actuators": ["one"]}, "damaged: layers"),
        ({"more": 1}, "damaged"),
    ],
)
def test_files_that_are_no_policy_of_ours_are_refused(
    policy: Policy, tmp_path: Path, header: dict[str, Any], message: str
) -> None:
    with pytest.raises(FileFormatError, match=message):
        Policy.load(changed(policy, tmp_path, **header))


def test_a_missing_a_cut_and_a_foreign_file_are_refused(policy: Policy, tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match=r"there is no policy .*opposable learn"):
        Policy.load(tmp_path / "none.npz")
    file = tmp_path / "p.npz"
    policy.save(file)
    file.write_bytes(file.read_bytes()[:2000])
    with pytest.raises(FileFormatError, match="no policy, or damaged"):
        Policy.load(file)
    file.write_text("{}")
    with pytest.raises(FileFormatError, match="no policy, or damaged") as told:
        Policy.load(file)
    assert "pickle" not in str(told.value)
    with pytest.raises(FileFormatError, match=r"is a folder; give the file policy\.npz in it"):
        Policy.load(tmp_path)
    with pytest.raises(FileFormatError, match="no file of a policy is named"):
        policy_file("")


def test_weights_that_are_not_finite_are_refused(policy: Policy) -> None:
    bad = policy.weights[0].copy()
    bad[0, 0] = np.nan
    with pytest.raises(TaskError, match="not finite"):
        replace(policy, weights=(bad, policy.weights[1]))


def test_the_command_line_tells_that_a_policy_is_missing(
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = ["manipulate", "allegro_hand", "sphere", "--controller", "policy:no.npz"]
    with pytest.raises(SystemExit) as left:
        main(words)
    assert left.value.code == 3
    assert "there is no policy no.npz" in " ".join(capsys.readouterr().err.split())


def test_a_policy_has_its_name_in_reports(policy: Policy, tmp_path: Path) -> None:
    from sim.controllers import controller_maker, controller_name

    policy.save(tmp_path / "turner.npz")
    maker = policy_controller(tmp_path / "turner.npz")
    assert controller_name(maker) == "policy:turner.npz"
    controller_maker(maker)  # is taken for one that takes a plan


# ---- training

TINY = Course(plans=1, demonstrations=1, rounds=1, episodes=1, epochs=1)


@pytest.mark.parametrize(
    "wrong", [{"plans": 0}, {"rounds": -1}, {"noise": 1.0}, {"share": 2.0}, {"senses": ("sight",)}]
)
def test_courses_that_cannot_be_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises((TaskError, NotFoundError), match=r"give|There is"):
        Course(**wrong)


def test_the_teacher_drives_less_from_round_to_round_and_not_in_the_last() -> None:
    course = Course(demonstrations=5, rounds=3, episodes=2, share=0.8)
    assert [course.teaches(k) for k in range(4)] == [0.8, 0.4, 0.2, 0.0]
    assert [course.begins(k) for k in range(5)] == [0, 5, 7, 9, 11]
    assert [Course().teaches(k) for k in range(3)] == [0.0, 0.0, 0.0]


@pytest.mark.slow
@pytest.mark.usefixtures("plan", "brief_manipulations")
def test_an_interrupted_training_ends_as_if_it_had_not_been(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Episodes of the same arguments are run once: that they are the same is tested elsewhere."""
    pytest.importorskip("sklearn")
    made: dict[tuple[Any, ...], Any] = {}

    def once(plans: Plans, number: int, *, policy: Policy | None, **asked: Any) -> Any:
        weights = () if policy is None else tuple(w.tobytes() for w in policy.weights)
        key = (number, weights, *sorted(asked.items()))
        if key not in made:
            made[key] = run_episode(plans, number, policy=policy, **asked)
        return made[key]

    monkeypatch.setattr("sim.learning.training.run_episode", once)
    task = replace(TASK, error_model=ErrorModel(), physics=PhysicsOptions())
    at_once, in_two = tmp_path / "at-once", tmp_path / "in-two"
    (at_once / "plans").mkdir(parents=True)
    file = folder / "plan-0000.json"
    (at_once / "plans" / file.name).write_bytes(file.read_bytes())

    def leave(now: Progress) -> None:
        if now.episode == 1:  # what an interruption after it would leave
            copytree(at_once, in_two)

    whole = learn(task, TINY, at_once, command="one", progress=leave)

    def press(now: Progress) -> None:
        if now.episode == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        learn(task, TINY, in_two, command="one", progress=press)
    assert not (in_two / "rounds" / "01.npz").exists()
    rest = learn(task, TINY, in_two, command="one")
    assert whole.policy is not None and rest.policy is not None
    for one, other in zip(whole.policy.weights, rest.policy.weights, strict=True):
        assert np.array_equal(one, other)
    both = [read_episode(run / "episodes" / "00001.npz") for run in (at_once, in_two)]
    assert np.array_equal(both[0].senses, both[1].senses)
    assert (at_once / POLICY).stat().st_size < 2**20
    assert (at_once / "curves.png").stat().st_size > 1000
    assert len(made) == 2  # the interruption has changed no argument
    told = whole.to_dict()
    assert [row["episodes"] for row in told["rounds"]] == [1, 1]
    with pytest.raises(FileFormatError, match=r"course.epochs is 1 there and 2 here"):
        learn(task, replace(TINY, epochs=2), in_two)
    with pytest.raises(FileFormatError, match=r"task.angle is"):
        learn(replace(task, angle=1.0), TINY, in_two)


@pytest.mark.slow
@pytest.mark.usefixtures("plan")
def test_the_teacher_turns_it_under_lab_by_the_truth(folder: Path) -> None:
    """In the time that manipulations take: lifted as briefly as in other tests, one was dropped."""
    task = replace(TASK, physics=PhysicsOptions())
    plans, asked = Plans(task, folder), {"policy": None, "share": 1.0, "noise": 0.0}
    episodes = [run_episode(plans, k, count=3, **asked) for k in range(3)]  # type: ignore[arg-type]
    for episode in episodes:
        assert episode.strict, episode.reason
        assert len(episode.senses) == len(episode.wanted) > 300
        assert np.abs(episode.wanted).max() <= 1.0


# ---- what a policy is for


def test_a_policy_says_in_a_line_what_it_was_not_trained_for(policy: Policy) -> None:
    about = replace(policy.about, objects="cylinder:0.025..0.035x0.08")
    inside = parse_object("cylinder:0.03x0.08")
    assert about.outside_training(inside, 90.0) == ""
    assert "the object is cylinder" in about.outside_training(
        parse_object("cylinder:0.04x0.08"), 90.0
    )
    box = about.outside_training(parse_object("box"), 45.0)
    assert box.startswith("the policy was trained for cylinder:0.025..0.035x0.08 turned by 90")
    assert "the object is box and the turn is 45 degrees" in box
    assert "\n" not in box
    assert "the turn is -90 degrees" in about.outside_training(inside, -90.0)
    assert "no turn about the vertical" in about.outside_training(inside, None)


def test_a_policy_says_what_mass_friction_physics_and_errors_it_was_not_trained_for(
    policy: Policy, tmp_path: Path
) -> None:
    lab, ours = named_errors("lab"), PhysicsOptions()
    about = replace(
        policy.about,
        objects="cylinder:0.025..0.035x0.08",
        error_model="lab",
        errors=error_numbers(lab),
        physics=physics_numbers(ours),
    )
    replace(policy, about=about).save(tmp_path / "policy.npz")
    about = Policy.load(tmp_path / "policy.npz").about  # what is told comes back out of a file

    def told(
        mass: float = 0.1, physics: PhysicsOptions = ours, error_model: ErrorModel = lab
    ) -> str:
        item = parse_object("cylinder:0.03x0.08", mass=mass)
        return about.outside_training(item, 90.0, physics, error_model)

    within = replace(lab, name="mine", encoder_offset=0.5 * lab.encoder_offset, touch_rate=200.0)
    for error_model in (lab, lab.seeded(7), ErrorModel(), within, lab.sensed_exactly()):
        assert told(error_model=error_model) == ""
    assert told(physics=replace(ours, mu=0.9)) == ""
    assert "the mass is 0.5 kg (trained with 0.05 to 0.3)" in told(mass=0.5)
    assert "the friction is 0.4 (trained with 0.5 to 1)" in told(physics=replace(ours, mu=0.4))
    assert "the physics is ours with impratio 1" in told(physics=replace(ours, impratio=1.0))
    assert "larger than in its training: encoder_offset 0.0" in told(
        error_model=named_errors("rough")
    )
    for slow in (replace(lab, touch_rate=50.0), replace(lab, touch="effort")):
        assert "touch" in told(error_model=slow)
    assert "command_rate" in told(error_model=replace(lab, command_rate=100.0))
    assert "\n" not in told(mass=0.5, error_model=named_errors("rough"))


def test_an_older_policy_says_only_what_it_knows(policy: Policy) -> None:
    old = replace(policy.about, objects=OBJECT, error_model="lab", errors={}, physics={})
    item = parse_object(OBJECT)
    for error_model in ("ideal", "lab"):
        assert old.outside_training(item, 90.0, PhysicsOptions(), named_errors(error_model)) == ""
    assert "rough" in old.outside_training(item, 90.0, PhysicsOptions(), named_errors("rough"))


@pytest.mark.parametrize(
    ("words", "code", "told"),
    [
        (["shadow_hand", "cylinder:0.03x0.08"], 3, "for the hand allegro_hand"),
        (["allegro_hand", "box", "--rotate", "45"], 4, "the object is box and the turn is 45"),
        (["allegro_hand", OBJECT, "--mass", "0.5", "--sim-mu", "0.4"], 4, "the mass is 0.5 kg"),
    ],
)
def test_another_hand_or_object_is_told_before_anything_is_planned(
    policy: Policy,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    words: list[str],
    code: int,
    told: str,
) -> None:
    from sim.cli.manipulate import TurnOptions

    def plan(*_: object) -> None:
        assert told in " ".join(capsys.readouterr().err.split()), "it was not told before"
        raise NoGraspFoundError("planned", ())

    monkeypatch.setattr(TurnOptions, "plan", plan)
    policy.save(tmp_path / "p.npz")
    with pytest.raises(SystemExit) as left:
        main(["manipulate", *words, "--controller", f"policy:{tmp_path / 'p.npz'}"])
    assert left.value.code == code
    if code == 3:
        assert told in " ".join(capsys.readouterr().err.split())


def test_a_controller_that_there_is_not_is_told_with_the_policies(
    capsys: pytest.CaptureFixture[str],
) -> None:
    for words in (
        ["manipulate", "allegro_hand", "sphere"],
        ["bench", "manipulate", "allegro_hand"],
    ):
        with pytest.raises(SystemExit) as left:
            main([*words, "--controller", "pid"])
        assert left.value.code == 3
        error = " ".join(capsys.readouterr().err.split())
        assert "no controller is called 'pid'" in error and "policy:FILE" in error, error


def test_a_name_is_that_of_a_policy_that_comes_with_us(tmp_path: Path) -> None:
    with pytest.raises(NotFoundError, match="no policy is called 'walker'"):
        policy_file("walker")
    own = tmp_path / "mine.npz"
    assert policy_file(own) == own
    for name in shipped_policies():
        about = Policy.load(policy_file(name)).about
        assert "/" not in about.command.replace("runs/learn", ""), "a folder of some machine"
        assert policy_file(name).stat().st_size < 2**20


def test_a_policy_of_the_first_version_is_still_read(policy: Policy, tmp_path: Path) -> None:
    file = changed(policy, tmp_path, version=1)
    with np.load(file) as stored:
        arrays = dict(stored)
    told = json.loads(arrays["header"].tobytes())
    del told["estimator"]
    told["reality"] = told.pop("error_model")
    arrays["header"] = np.frombuffer(json.dumps(told).encode(), dtype=np.uint8)
    with file.open("wb") as stream:
        np.savez(stream, **arrays)
    assert Policy.load(file).about == replace(policy.about, estimator="none")


def test_a_bench_refuses_a_policy_of_another_hand(policy: Policy, tmp_path: Path) -> None:
    from benchmarks.manipulate import Options, cases

    policy.save(tmp_path / "p.npz")
    asked = Options(hands=["shadow_hand"], controller=f"policy:{tmp_path / 'p.npz'}")
    with pytest.raises(HandError, match="for the hand allegro_hand"):
        list(cases(asked))


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"angle": math.nan}, "angle is nan; give a finite number"),
        ({"angle": 4.0 * math.pi}, "the turn is 720 degrees"),
        ({"angle": 0.0}, "the turn is 0 degrees"),
        ({"seed": -1}, "the seed is -1; give a whole number from 0"),
    ],
)
def test_tasks_that_cannot_be_are_refused(wrong: dict[str, Any], told: str) -> None:
    with pytest.raises(TaskError, match=told):
        replace(TASK, **wrong)


def test_each_round_is_a_line_where_there_is_no_terminal(
    capsys: pytest.CaptureFixture[str],
) -> None:
    from sim.cli.learn import _shown

    show = _shown(lambda _: None)
    for k in range(4):
        ends = k % 2 == 1
        show(
            Progress(
                round=k // 2,
                episode=k + 1,
                of=4,
                strict=1,
                in_round=k % 2 + 1,
                round_ends=ends,
                fitted=0.1,
            )
        )
    lines = capsys.readouterr().err.splitlines()
    assert lines == [
        "round 0: 2 episodes, 1 with closure; 2 of 4 in all",
        "round 1: 2 episodes, 1 with closure; 4 of 4 in all",
    ]


# ---- the policy that comes with us

TRAINED = Policy.load(Path("models/policies/allegro_turn.npz")).about.errors
SHIPPED = TurnTask(  # with the errors that it was trained with: `lab` has had more since
    hand="allegro_hand",
    objects="cylinder:0.025..0.035x0.08",
    error_model=ErrorModel(name="as trained", **TRAINED),
)


@pytest.mark.slow
@pytest.mark.usefixtures("brief_manipulations")
def test_the_shipped_policy_turns_where_the_open_loop_does_not() -> None:
    """A trial that neither plan nor conditions of the training have; angle as asked, and strict."""
    # planned for exact joints: with room for joints that are off the open loop gets there as well
    plan = Plans(replace(SHIPPED, error_model=named_errors("ideal")))(104)
    conditions = Conditions.draw(np.random.default_rng([777, 104]))
    driver = policy_controller("allegro_turn")(plan.grasp)
    by_policy = until_turned(conditions.run(SHIPPED, plan, driver))
    assert by_policy.success_with_closure, by_policy
    assert 90.0 <= math.degrees(by_policy.turned) <= 95.0
    by_clock = until_turned(conditions.run(SHIPPED, plan, open_loop(plan.grasp)))
    assert not by_clock.success, by_clock


def until_turned(run: ManipulationRun) -> ManipulationReport:
    """Perform a run without carrying the object away and putting it down."""

    def stop(simulation: Simulation) -> None:
        if simulation.phase == "carry":
            simulation.stop("seen enough")

    run.sim.simulation.on_step = stop
    return run.perform()
