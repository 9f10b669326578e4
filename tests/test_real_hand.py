"""Hands behind one interface: simulated, replayed, wrapped; what they lack; what a log keeps."""

from __future__ import annotations

import json
import pickle
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import PlanOf
from hands_in_loops import FakeClock, FakeHand, Steady, looped

from planner.errors import FileFormatError, HandError, NotFoundError, TaskError
from planner.files import read_plan, write_plan
from planner.hand_loading import load_hand
from planner.plan import GraspPlan
from planner.shapes import Sphere
from planner.spatial import SE3, FloatArray, IntArray
from sim.controllers import (
    Controller,
    GraspController,
    ObjectImpedance,
    Observation,
    PadReading,
    controller_for,
)
from sim.real_hand import (
    CommandLimits,
    DryRun,
    HandLog,
    HandReading,
    HandWrapper,
    LoopReport,
    Observer,
    PlanMark,
    ReplayedHand,
    Safety,
    SimulatedHand,
    check_joints,
    read_log,
    run_controller,
)
from sim.report import TrialReport
from sim.scene.carrier import Timeline
from sim.scene.physics import PhysicsOptions
from sim.trial import Trial

pytestmark = pytest.mark.usefixtures("coarse_steps")

QUICK = Timeline(approach=0.3, close=0.3, close_wait=0.2, squeeze=0.2, lift=0.4, hold=0.2)


@pytest.fixture(scope="module")
def plan(plan_of: PlanOf) -> GraspPlan:
    return plan_of("allegro_hand", "sphere")


@pytest.fixture(scope="module")
def with_tendons(plan_of: PlanOf) -> GraspPlan:
    """A hand with a wrist, and tendons that drive two joints each."""
    return plan_of("shadow_hand", "cylinder")


def simulated(plan: GraspPlan, controller: Any = None, **options: Any) -> SimulatedHand:
    return SimulatedHand(Trial(plan, controller=controller, timeline=QUICK), **options)


def run_on(
    hand: SimulatedHand, plan: GraspPlan, *, inside: Any = None, **options: Any
) -> LoopReport:
    """A run on its own clock, without limits unless told otherwise."""
    settings: dict[str, Any] = {"rate_hz": 250.0, "limits": CommandLimits.none()} | options
    return run_controller(
        inside or hand,
        settings.pop("controller", hand.controller),
        plan,
        timeline=QUICK,
        clock=hand.clock,
        carry=hand.carry,
        **settings,
    )


# the trial through the interface


def assert_same(first: TrialReport, second: TrialReport) -> None:
    a, b = first.recording, second.recording
    assert len(a) == len(b) > 10 and a.phase == b.phase
    for name in ("time", "q", "T_world_base", "T_world_object", "commands", "points", "forces"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), atol=1e-9, rtol=0.0)
    told, again = (r.to_dict() | {"wall_s": 0.0} for r in (first, second))
    assert str(told) == str(again)  # all of the verdict; NaN is not equal to itself


@pytest.mark.slow
@pytest.mark.parametrize("controller", ["feedforward", "impedance"])
def test_a_trial_through_the_interface_is_the_trial(plan: GraspPlan, controller: str) -> None:
    own = Trial(plan, controller=controller, timeline=QUICK).run()
    hand = simulated(plan, controller)
    ran = run_on(hand, plan)
    assert ran.done and ran.misses == 0 and own.success
    assert_same(own, hand.report())


@pytest.mark.slow
def test_a_trial_with_tendons_and_a_wrist_is_the_trial(with_tendons: GraspPlan) -> None:
    own = Trial(with_tendons, controller="feedforward", timeline=QUICK).run()
    hand = simulated(with_tendons, "feedforward")
    run_on(hand, with_tendons)
    assert_same(own, hand.report())


@pytest.mark.slow
@pytest.mark.parametrize(("mu", "reason"), [(0.25, "slipped"), (0.05, "dropped")])
def test_a_trial_that_fails_fails_the_same_way(plan: GraspPlan, mu: float, reason: str) -> None:
    slippery = PhysicsOptions(mu=mu)
    own = Trial(plan, physics=slippery, timeline=QUICK).run()
    assert not own.success
    hand = SimulatedHand(Trial(plan, physics=slippery, timeline=QUICK))
    run_on(hand, plan, least_touch=1e-6)
    assert_same(own, hand.report())


def test_it_is_held_at_100_hz_within_limits(plan: GraspPlan) -> None:
    hand = simulated(plan)
    ran = run_on(hand, plan, rate_hz=100.0, limits=None)
    assert ran.done and ran.rate_limited  # led from where the fingers were
    report = hand.report()
    assert report.success
    assert len(report.samples) == pytest.approx(ran.duration_s / 0.02, abs=3)


def test_a_hand_whose_torque_is_taken_off_drops_the_object(plan: GraspPlan) -> None:
    hand = simulated(plan)
    bounds = Safety(stop=lambda: hand.now() > 1.3)  # in the lift
    ran = run_on(hand, plan, safety=bounds)
    assert ran.reason == "asked" and ran.on_stop == "torque off" and ran.phases[-1] == "lift"
    written = hand._written.commands.copy()
    with pytest.raises(HandError, match="torque of this hand was taken off"):
        hand.write(written)
    hand.sleep_until(3.0)
    assert hand.read().touch == pytest.approx(np.zeros(4), abs=1e-6)


def test_a_hand_that_holds_keeps_the_object(plan: GraspPlan) -> None:
    hand = simulated(plan)
    bounds = Safety(on_stop="hold", stop=lambda: hand.now() > 1.3)
    run_on(hand, plan, safety=bounds)
    hand.sleep_until(2.0)
    touch = hand.read().touch
    assert touch is not None and (touch > 0.1).all()


def test_what_moves_the_hand_as_a_whole_may_fail(plan: GraspPlan) -> None:
    hand = bare(plan)

    def fails(phase: str, progress: float, per_second: float) -> None:
        if progress > 0.5:
            raise OSError("the arm does not answer")

    report = run_controller(
        hand, Steady(hand.q), plan, clock=hand.clock, timeline=QUICK, carry=fails
    )
    assert report.reason == "interface failed"
    assert "moving the hand as a whole: the arm does not answer" in report.detail
    assert hand.stops == 1 and report.ticks == len(hand.writes) == 16  # none after that


def test_a_trial_that_has_run_is_refused(plan: GraspPlan) -> None:
    trial = Trial(plan, timeline=QUICK)
    trial.simulation.step("approach", 0.0)
    with pytest.raises(TaskError, match="has run already"):
        SimulatedHand(trial)
    with pytest.raises(TaskError, match="cannot be read for contacts"):
        simulated(plan, senses=("contacts",))


def test_in_real_time_it_simulates_up_to_now(plan: GraspPlan) -> None:
    clock = FakeClock()
    hand = simulated(plan, clock=clock)
    assert hand.read().time == 100.0
    clock.time += 0.048
    assert hand.read().time == pytest.approx(100.048, abs=2e-3)
    hand.write(hand._written.commands)
    clock.time += 0.0001  # less than a step: nothing new
    assert hand.read().time == pytest.approx(100.048, abs=2e-3)


def test_a_simulation_that_diverges_ends_the_run(plan: GraspPlan) -> None:
    hand = simulated(plan)

    hand.trial.simulation.data.qvel[:] = 1e12
    ran = run_on(hand, plan)
    assert ran.reason in ("interface failed", "joint limit", "reading not finite")
    assert not ran.done


# wrappers


class Worse(HandWrapper):
    """Readings with noise: what the next issue will put here."""

    def __init__(self, inner: Any) -> None:
        """Seed the noise."""
        super().__init__(inner)
        self.rng = np.random.default_rng(0)

    def read(self) -> HandReading:
        reading = super().read()
        return replace(reading, joints=reading.joints + self.rng.normal(0.0, 1e-3, 16))


def test_a_wrapper_stands_between(plan: GraspPlan) -> None:
    hand = simulated(plan)
    ran = run_on(hand, plan, inside=Worse(hand))
    assert ran.done
    report = hand.report()
    clean = simulated(plan)
    run_on(clean, plan)
    assert not np.allclose(report.recording.commands, clean.report().recording.commands, atol=1e-6)


def test_a_dry_run_writes_nothing(plan: GraspPlan) -> None:
    hand = FakeHand(plan.task.hand, FakeClock())
    dry = DryRun(hand)
    report = run_controller(dry, Steady(hand.q), plan, clock=hand.clock, timeline=QUICK)
    assert report.done and report.written > 100
    dry.stop()
    assert not hand.writes and not hand.stops


# senses


class Asks:
    """A controller that says nothing of its needs and asks for something in tick 3."""

    def __init__(self, what: str, commands: FloatArray) -> None:
        """Keep them."""
        self.what, self.commands, self.ticks = what, commands, 0

    def step(self, observation: Observation) -> FloatArray:
        self.ticks += 1
        if self.ticks == 4:
            getattr(observation, self.what)
        return self.commands


def bare(plan: GraspPlan) -> FakeHand:
    """A hand that reads joints only."""
    hand = FakeHand(plan.task.hand, FakeClock())
    hand.q = plan.q_start.copy()
    return hand


@pytest.mark.parametrize(
    ("make", "needs"),
    [
        (GraspController, "touch and object_pose"),
        (ObjectImpedance, "touch and object_pose and pads"),
    ],
)
def test_a_controller_that_says_what_it_needs_is_refused_before_the_hand_moves(
    plan: GraspPlan, make: Any, needs: str
) -> None:
    hand = bare(plan)
    with pytest.raises(HandError, match=f"{make.__name__} needs {needs}, which this hand"):
        run_controller(hand, make(plan), plan, clock=hand.clock, timeline=QUICK)
    assert not hand.writes and not hand.stops  # it is left as it was


@pytest.mark.parametrize(
    ("what", "sense"),
    [
        ("normal_forces", "touch"),
        ("T_world_object", "object_pose"),
        ("object_twist", "object_twist"),
        ("pads", "pads"),
        ("contacts", "contacts"),
        ("all_touch", "touch"),
    ],
)
def test_one_that_says_nothing_is_stopped_when_it_asks(
    plan: GraspPlan, what: str, sense: str
) -> None:
    hand = bare(plan)
    controller = Asks(what, hand.q)
    report = run_controller(hand, controller, plan, clock=hand.clock, timeline=QUICK)
    assert report.reason == "bad command"
    assert f"needs {sense}, which this hand does not read" in report.detail
    assert len(hand.writes) == 3 and hand.stops == 1


def test_planned_values_stand_in_where_that_is_asked_for(plan: GraspPlan) -> None:
    hand = bare(plan)
    report = run_controller(
        hand,
        GraspController(plan),
        plan,
        clock=hand.clock,
        timeline=QUICK,
        assume=("touch", "object_pose"),
    )
    assert report.done and report.assumed == ("touch", "object_pose")
    observer = Observer(hand, plan.task.hand, plan, ("touch", "object_pose"))
    reading = hand.read()
    before = observer.observe(reading, "close", 0.9)
    assert before.normal_forces == pytest.approx(np.zeros(4))
    after = observer.observe(reading, "close", 1.0)
    assert after.normal_forces == pytest.approx(plan.contacts.forces[:, 0])
    lifted = SE3(plan.T_world_base.rotation, plan.T_world_base.translation + 0.1 * np.eye(3)[2])
    seen = observer.observe(replace(reading, T_world_base=lifted), "hold", 0.5)
    moved = seen.T_world_object.translation - plan.task.T_world_object.translation
    assert moved == pytest.approx([0.0, 0.0, 0.1])


def test_a_simulated_object_is_held_by_planned_values_alone(plan: GraspPlan) -> None:
    hand = simulated(plan, senses=())
    with pytest.raises(HandError, match="let planned values stand in: assume touch, object_pose"):
        run_on(hand, plan)
    hand = simulated(plan, senses=())
    run_on(hand, plan, rate_hz=100.0, limits=None, assume=("touch", "object_pose"))
    assert hand.report().success


def test_assumptions_that_cannot_be_are_refused(plan: GraspPlan) -> None:
    hand = bare(plan)
    with pytest.raises(NotFoundError, match="no planned value that may stand in"):
        Observer(hand, plan.task.hand, plan, ("pads",))
    with pytest.raises(HandError, match="only where there is a plan"):
        Observer(hand, plan.task.hand, None, ("touch",))


def test_fingers_in_another_order_are_matched(plan: GraspPlan) -> None:
    hand = bare(plan)
    names = plan.task.finger_names
    hand.finger_names = names[::-1]
    observer = Observer(hand, plan.task.hand, plan)
    pads = PadReading(
        normal_force=np.arange(4.0),
        force=np.zeros((4, 3)),
        position=np.arange(12.0).reshape(4, 3),
        normal=np.zeros((4, 3)),
        sliding=np.zeros((4, 3)),
        time=1.5,
    )
    reading = replace(hand.read(), touch=np.arange(4.0), pads=pads)
    seen = observer.observe(reading, "hold", 0.0)
    assert seen.normal_forces.tolist() == [3.0, 2.0, 1.0, 0.0]
    assert seen.pads.normal_force.tolist() == [3.0, 2.0, 1.0, 0.0]
    assert seen.pads.position[0].tolist() == [9.0, 10.0, 11.0]
    assert seen.pads.time == 1.5
    hand.finger_names = names[:2]
    with pytest.raises(NotFoundError, match="no finger of the interface"):
        Observer(hand, plan.task.hand, plan)


def test_a_hand_that_touches_with_too_few_fingers_is_not_lifted(plan: GraspPlan) -> None:
    hand = bare(plan)
    hand.finger_names = plan.task.finger_names
    hand.change = lambda k, reading: replace(reading, touch=np.array([1.0, 1.0, 0.0, 0.0]))
    report = run_controller(hand, Steady(hand.q), plan, clock=hand.clock, timeline=QUICK)
    assert report.reason == "too few fingers touch"
    assert "before the lift 2 touch; 3 are needed" in report.detail
    assert "lift" in report.phases and not report.stopped and not hand.stops


# logs


@pytest.fixture(scope="module")
def logged(plan: GraspPlan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("logs") / "run.npz"
    hand = simulated(plan, "impedance", senses=("touch", "object_pose", "object_twist", "pads"))
    run_on(hand, plan, rate_hz=125.0, limits=None, log=path)
    return path


def test_a_log_holds_what_was_read_and_written_by_names_with_units(
    logged: Path, plan: GraspPlan
) -> None:
    log = read_log(logged)
    assert log.joint_names == plan.task.hand.joint_names
    assert log.actuator_names == plan.task.hand.actuation.names
    assert log.finger_names == plan.task.finger_names
    assert log.rate_hz == 125.0 and len(log) > 150
    assert log.phase[0] == "approach" and log.phase[-1] == "hold"
    assert np.isfinite(log.commands).all() and np.isfinite(log.efforts).all()
    assert np.diff(log.begin_s) == pytest.approx(1 / 125, abs=2e-3)
    with np.load(logged, allow_pickle=False) as file:
        meta = json.loads(str(file["meta"]))
    assert meta["units"]["joints"] == "rad or m" and meta["units"]["touch"] == "N"


@pytest.mark.parametrize("controller", ["impedance"])
def test_a_log_that_is_replayed_gives_the_same_commands(
    logged: Path, plan: GraspPlan, controller: str
) -> None:
    hand = ReplayedHand(logged, plan.task.hand)
    report = run_controller(
        hand,
        controller_for(plan, controller),
        plan,
        rate_hz=125.0,
        timeline=QUICK,
        clock=hand.clock,
    )
    assert report.done
    compared = hand.comparison()
    assert compared.compared == len(hand.log) and compared.largest < 1e-9


def test_misses_are_replayed_too(plan: GraspPlan, tmp_path: Path) -> None:
    live = FakeHand(plan.task.hand, FakeClock(), costs=[0.001, 0.027, 0.013] * 8)
    live.q = plan.q_start.copy()
    wanted = Steady(plan.q)
    settings: dict[str, Any] = {"timeline": QUICK, "log": tmp_path / "late.npz"}
    first = run_controller(live, wanted, plan, clock=live.clock, **settings)
    hand = ReplayedHand(tmp_path / "late.npz")
    again = run_controller(hand, Steady(plan.q), plan, clock=hand.clock, timeline=QUICK)
    assert first.misses == again.misses > 5
    assert first.skipped == again.skipped > 0
    assert hand.comparison().largest < 1e-12


def test_another_controller_is_seen_in_a_replay(logged: Path, plan: GraspPlan) -> None:
    hand = ReplayedHand(logged, plan.task.hand)
    run_controller(
        hand, GraspController(plan), plan, rate_hz=125.0, timeline=QUICK, clock=hand.clock
    )
    compared = hand.comparison()
    assert compared.largest > 1e-3 and compared.actuator in hand.actuator_names
    assert compared.time_s > 0.5  # until the squeeze both close in the same way


def test_a_log_that_ends_ends_the_run(plan: GraspPlan, tmp_path: Path) -> None:
    live = bare(plan)
    bounds = Safety(stop=lambda: live.clock.time > 100.4)
    path = tmp_path / "cut.npz"
    settings: dict[str, Any] = {"clock": live.clock, "timeline": QUICK, "safety": bounds}
    assert run_controller(live, Steady(live.q), plan, log=path, **settings).reason == "asked"
    hand = ReplayedHand(path)
    report = run_controller(hand, Steady(live.q), plan, clock=hand.clock, timeline=QUICK)
    assert report.reason == "no more readings"
    assert report.ticks == len(read_log(path)) == len(live.writes)


def test_a_log_says_which_plan_it_is_of(logged: Path, plan: GraspPlan, tmp_path: Path) -> None:
    write_plan(plan, tmp_path / "plan.json")
    marks = [PlanMark.of(plan), PlanMark.of(read_plan(tmp_path / "plan.json"))]
    assert read_log(logged).plan == marks[0] == marks[1]
    assert marks[0].hand == plan.task.hand.name and marks[0].object == plan.task.object.shape.spec


def test_a_log_of_another_plan_or_rate_is_refused(logged: Path, plan: GraspPlan) -> None:
    """Also behind a wrapper, which hides that it is a log."""
    heavy = replace(plan, task=replace(plan.task, object=replace(plan.task.object, mass=0.3)))
    small = replace(
        plan.task, table_height=None, object=replace(plan.task.object, shape=Sphere(0.02))
    )
    hand = ReplayedHand(logged)
    for other, rate, said in (
        (replace(plan, q=plan.q + 1e-3), 125.0, "of another grasp of"),
        (heavy, 125.0, "of another grasp of"),
        (replace(plan, task=small), 125.0, "not of sphere:0.02; give"),
        (plan, 100.0, "of a loop at 125 Hz, and a rate of 100 Hz is asked for; give 125 Hz"),
    ):
        with pytest.raises(TaskError, match=said):
            run_controller(HandWrapper(hand), Steady(plan.q), other, rate_hz=rate, clock=hand.clock)
    assert hand.comparison().compared == 0


def test_a_log_of_version_1_is_read_and_not_compared(logged: Path, plan: GraspPlan) -> None:
    with np.load(logged, allow_pickle=False) as file:
        meta = json.loads(str(file["meta"]))
    del meta["plan"]
    path = damaged(logged, meta=np.array(json.dumps(meta | {"version": 1})))
    hand = ReplayedHand(path)
    assert hand.log.plan is None
    other = replace(plan, q=plan.q + 1e-3)
    done = run_controller(
        hand, Steady(plan.q), other, rate_hz=125.0, timeline=QUICK, clock=hand.clock
    )
    assert done.done


def test_a_log_of_another_hand_is_refused(logged: Path) -> None:
    with pytest.raises(FileFormatError, match="of another hand than shadow_hand"):
        ReplayedHand(logged, load_hand("shadow_hand"))


@pytest.mark.parametrize("error", [KeyboardInterrupt(), IndexError("a bug")])
def test_a_run_that_is_cut_off_keeps_its_log(
    plan: GraspPlan, tmp_path: Path, error: BaseException
) -> None:
    hand = bare(plan)

    def breaks(k: int) -> FloatArray:
        if k == 30:
            raise error
        return hand.q

    path = tmp_path / "kept.npz"
    try:
        report = run_controller(
            hand, Steady(breaks), plan, clock=hand.clock, timeline=QUICK, log=path
        )
        assert report.reason == "interrupted"
    except IndexError:
        assert isinstance(error, IndexError)
    assert len(read_log(path)) == 30
    assert hand.stops == 1 and len(hand.writes) == 30


def test_a_log_is_not_begun_where_it_cannot_be_written(plan: GraspPlan, tmp_path: Path) -> None:
    hand = bare(plan)
    with pytest.raises(FileFormatError, match="there is no folder"):
        run_controller(hand, Steady(hand.q), plan, clock=hand.clock, log=tmp_path / "no" / "a.npz")
    assert not hand.reads


def damaged(path: Path, **changes: Any) -> Path:
    """The log with some arrays changed; None leaves one out."""
    with np.load(path, allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files} | changes
    out = path.with_name("damaged.npz")
    np.savez(out, **{k: v for k, v in arrays.items() if v is not None})
    return out


class Hostile:
    """Makes a file when it is unpickled."""

    def __reduce__(self) -> Any:
        """Make the file."""
        return Path.touch, (Path("hostile"),)


def test_a_damaged_log_is_refused_and_nothing_is_executed(
    logged: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    log = read_log(logged)
    cut = tmp_path / "cut.npz"
    cut.write_bytes(logged.read_bytes()[:2000])
    text = tmp_path / "text.npz"
    text.write_text("time,q\n")
    pickled = tmp_path / "pickle.npz"
    pickled.write_bytes(pickle.dumps(Hostile()))
    objects = damaged(logged, joints=np.array([Hostile()], dtype=object)).rename("objects.npz")
    later = {"format": "opposable-hand-log", "version": 3}
    cases = {
        "does not exist": tmp_path / "none.npz",
        "cannot be read as a log": cut,
        "damaged or something else": text,
        "cannot be read as": pickled,
        "cannot be read": tmp_path / objects,
    }
    for words, path in cases.items():
        with pytest.raises(FileFormatError, match=words):
            read_log(path)
    changed: dict[str, dict[str, Any]] = {
        "joints has shape": {"joints": log.joints[:-1]},
        "cannot be read as a log": {"efforts": None},
        "version 3; this reads version 1 and 2": {"meta": np.array(json.dumps(later))},
        "is no log of a hand": {"meta": np.array("{}")},
        "phases for": {"phase": np.array(["hold"])},
    }
    for words, changes in changed.items():
        with pytest.raises(FileFormatError, match=words):
            read_log(damaged(logged, **changes))
    assert not Path("hostile").exists()
    np.savez(tmp_path / "other.npz", x=np.zeros(3))
    with pytest.raises(FileFormatError, match="cannot be read as a log"):
        read_log(tmp_path / "other.npz")


def test_flipped_bytes_of_a_packed_log_are_refused(logged: Path, tmp_path: Path) -> None:
    """Wherever they are; the checksum of the archive finds those that unpack."""
    with np.load(logged, allow_pickle=False) as file:
        np.savez_compressed(tmp_path / "packed.npz", **file)
    rng = np.random.default_rng(27)
    for path in (logged, tmp_path / "packed.npz"):
        good = path.read_bytes()
        for _ in range(25):
            data = bytearray(good)
            for place in rng.integers(0, len(good) // 2, 20):  # of the members, not the directory
                data[place] ^= int(rng.integers(1, 256))
            (tmp_path / "flipped.npz").write_bytes(data)
            with pytest.raises(FileFormatError):
                read_log(tmp_path / "flipped.npz")


def test_a_log_whose_parts_would_grow_is_refused(logged: Path) -> None:
    """Narrow numbers, a text of phases and a description each become many times their bytes."""
    n = len(read_log(logged).phase)
    for changes in (
        {"joints": np.zeros(np.shape(read_log(logged).joints), dtype=bool)},
        {"phase": np.zeros(n + 1_000_000, dtype=bool)},
        {"meta": np.array(" " * 2_000_000 + "{}")},
    ):
        with pytest.raises(FileFormatError):
            read_log(damaged(logged, **changes))


def test_an_empty_log_is_refused(plan: GraspPlan, tmp_path: Path) -> None:
    hand = FakeHand(plan.task.hand, FakeClock())
    loop, _ = looped(hand, Steady(hand.q), 3)
    log = loop.log.log()
    none = {f.name: getattr(log, f.name) for f in fields(log)}
    none = {k: v[:0] if k in log.shapes() or k == "phase" else v for k, v in none.items()}
    HandLog(**none).write(tmp_path / "empty.npz")
    with pytest.raises(FileFormatError, match="holds no readings"):
        ReplayedHand(tmp_path / "empty.npz")


# joints one by one


class Rewired(HandWrapper):
    """A hand with faults: gears (nu,), and which command goes to which motor."""

    def __init__(self, inner: Any, gears: FloatArray, cables: IntArray) -> None:
        """Keep them, and where the hand began."""
        super().__init__(inner)
        self.gears, self.cables = gears, cables
        self.rest: FloatArray | None = None

    def write(self, commands: FloatArray) -> None:
        if self.rest is None:
            self.rest = commands.copy()
        moved = (commands - self.rest)[self.cables] * self.gears
        super().write(self.rest + moved)


@pytest.mark.slow
def test_a_hand_that_is_wired_well_passes(with_tendons: GraspPlan) -> None:
    """Of a hand without tendons, the joints without faults of the next test."""
    hand, described = simulated(with_tendons), with_tendons.task.hand
    checks, report = check_joints(hand, described, clock=hand.clock)
    assert report.done
    assert [c.actuator for c in checks] == list(described.actuation.names)
    assert [c.fault for c in checks] == [""] * len(checks)


@pytest.mark.slow
def test_faults_of_the_wiring_are_found_and_none_is_invented(plan: GraspPlan) -> None:
    gears, cables = np.ones(16), np.arange(16)
    gears[1], gears[6], gears[10] = -1.0, 0.0, 0.3
    cables[[13, 14]] = 14, 13
    hand = simulated(plan)
    wired = Rewired(hand, gears, cables)
    checks, _ = check_joints(wired, plan.task.hand, clock=hand.clock)
    found = {i: c.fault for i, c in enumerate(checks) if c.fault}
    assert set(found) == {1, 6, 10, 13, 14}
    assert "the wrong way" in found[1]
    assert "does not move" in found[6]
    assert "0.3" in found[10] and "gear" in found[10]
    assert "thumb_2" in found[13] and "thumb_1" in found[14]


def test_motors_are_not_checked_that_way() -> None:
    hand = load_hand("shadow_hand_torque")
    with pytest.raises(HandError, match="is no position servo"):
        check_joints(FakeHand(hand, FakeClock()), hand)


def test_what_controllers_need_is_what_they_read() -> None:
    """The two that come along say what they need; a plain one says nothing."""
    assert GraspController.needs == ("touch", "object_pose")
    assert ObjectImpedance.needs == ("touch", "object_pose", "pads")
    plain: Controller = Steady(np.zeros(3))
    assert not hasattr(plain, "needs")


def test_joints_that_were_not_reached_do_not_pass(plan: GraspPlan) -> None:
    hand = simulated(plan)
    bounds = Safety(stop=lambda: hand.now() > 3.0)
    checks, report = check_joints(hand, plan.task.hand, clock=hand.clock, safety=bounds)
    assert report.reason == "asked"
    assert [c.fault for c in checks[:2]] == ["", ""]
    assert all(c.fault == "was not moved: the run ended before" for c in checks[4:])
