"""Protocols: known answers of a two-finger jaw worked on paper, every reason, workers, Ctrl-C.

The jaw presses a cube from two sides with motors: the force of its pads is what was planned, and
along the pads nothing yields. So a cube pressed with N breaks at 2 mu N along the faces, and at
2 mu_torsion N about the line between the pads.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.certify import NEAR
from planner.errors import NotFoundError, TaskError
from planner.exchange.dexgraspbench import plan_squeeze
from planner.files import write_plan
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.objects import parse_object
from planner.plan import GraspPlan, SolveRecord
from planner.search.grasp import plan_grasp
from planner.spatial import SE3, FloatArray, rotation_angle
from planner.task import GraspTask
from planner.verification import verify_grasp
from sim.cli import main
from sim.controllers import Controller, GraspController, MakeController, Observation, Phase
from sim.protocols import Outcome, Settings, protocol_table, run_protocol, variations, write_csv
from sim.protocols.dexgraspbench import (
    DexGraspBenchCase,
    Replay,
    benchmark_physics,
    dexgraspbench_cases,
)
from sim.protocols.disturbance import DisturbanceTrial
from sim.protocols.forces import GravityCase, PushCase, forces_cases, proven_bound
from sim.protocols.outcome import AXES, Conditions
from sim.protocols.run import PROTOCOLS, cases_of, physics_of, trials_of, unsuitable
from sim.protocols.shake_pushes import ShakeCase, Shaker, shake_cases
from sim.protocols.variations import RobustCase, displaced, robust_cases
from sim.scene.physics import PhysicsOptions
from sim.trial import TrialOptions
from sim.verdict import REASONS, LossCriteria

pytestmark = pytest.mark.usefixtures("coarse_steps")

HALF, PAD = 0.02, 0.012
"""Half the cube's edge and the pads' radius, m."""

PRESS, STRONGEST = 2.0, 20.0
"""Planned normal force, and what the motors can give, N."""

PHYSICS = PhysicsOptions()

FINE = Settings(random=0, growth=1.04, step_s=0.3, first_load=1.5)
"""Loads that grow slowly and last long enough for what slips to slip away."""

MOTORS = '<motor name="{0}" joint="{0}" forcerange="-20 20"/>'
SERVOS = '<position name="{0}" joint="{0}" kp="500" kv="20" forcerange="-20 20"/>'


def finger(name: str, side: float) -> tuple[str, str]:
    """Model and description of a finger that slides along x; it stands at ``side``."""
    model = f"""
<body name="{name}" pos="{0.06 * side} 0 0">
  <joint name="{name}" type="slide" axis="{-side} 0 0" range="0 0.06" damping="1"/>
  <geom name="{name}_bar" type="capsule" size="0.008" fromto="0 0 0.03 0 0 0.1" mass="0.05"/>
  <geom name="{name}_pad" type="sphere" size="{PAD}" pos="0 0 0.1" mass="0.01"/>
  <site name="{name}_tip" pos="{-PAD * side} 0 0.1"/>
</body>"""
    description = f"""
[[fingers]]
name = "{name}"
joints = ["{name}"]
tip_site = "{name}_tip"
[fingers.pad]
geom = "{name}_pad"
center = [0.0, 0.0, 0.1]
radius = {PAD}
axis = [{-side}, 0.0, 0.0]
half_angle_deg = 60.0
"""
    return model, description


def make_jaw(folder: Path, actuator: str = MOTORS) -> Hand:
    (left, left_text), (right, right_text) = finger("left", -1.0), finger("right", 1.0)
    (folder / "jaw.xml").write_text(
        f"""<mujoco model="jaw"><compiler angle="radian"/><worldbody><body name="palm">
        <geom name="palm" type="box" size="0.08 0.02 0.01" mass="0.5"/>{left}{right}
        </body></worldbody>
        <actuator>{actuator.format("left")}{actuator.format("right")}</actuator></mujoco>"""
    )
    (folder / "hand.toml").write_text(
        f"""schema = 1
name = "jaw"
model = "jaw.xml"
summary = "two fingers that slide towards each other"
source = "our own"
base_body = "palm"
palm_body = "palm"
palm_normal = [0.0, 0.0, 1.0]
wrist_joints = []
default_fingers = ["left", "right"]
allowed_contacts = []
{left_text}{right_text}
[postures.open]
left = 0.01
right = 0.01
[postures.pinch]
left = 0.028
right = 0.028
"""
    )
    return load_hand(folder / "hand.toml")


def pinch(hand: Hand, *, press: float = PRESS, mass: float = 0.1) -> GraspPlan:
    """A cube in free fall, pressed from both sides through its centre."""
    task = GraspTask.create(
        hand,
        parse_object("box:0.04x0.04x0.04", mass=mass),
        T_world_object=SE3(np.eye(3), np.array([0.0, 0.0, 0.3])),
        table_height=None,
        gravity=(0.0, 0.0, 0.0),
        contact_model="soft",
        mu_torsion=PHYSICS.mu_torsion,
        grip_force=press,
    )
    record = SolveRecord(
        seed=0, attempt=0, attempts=1, iterations=0, status="by hand", cpu_s=0.0, build_s=0.0
    )
    above = SE3(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 0.4]))
    plan = verify_grasp(task, above, np.full(2, 0.06 - HALF - PAD), record=record)
    assert isinstance(plan, GraspPlan), plan
    return plan


@pytest.fixture(scope="module")
def jaw(tmp_path_factory: pytest.TempPathFactory) -> Hand:
    return make_jaw(tmp_path_factory.mktemp("jaw"))


@pytest.fixture(scope="module")
def servo_jaw(tmp_path_factory: pytest.TempPathFactory) -> Hand:
    return make_jaw(tmp_path_factory.mktemp("servo_jaw"), SERVOS)


@pytest.fixture(scope="module")
def pinched(jaw: Hand) -> GraspPlan:
    return pinch(jaw)


@pytest.fixture(scope="module")
def grasped(allegro: Hand) -> GraspPlan:
    return plan_grasp(GraspTask.create(allegro, "sphere"))


def under(controller: MakeController = GraspController) -> Conditions:
    return Conditions(physics=PHYSICS, controller=controller)


def push(name: str, how: Settings = FINE) -> PushCase:
    """The case of a name."""
    case = next(c for c in forces_cases(how, 0) if c.name == name)
    assert isinstance(case, PushCase)
    return case


# known answers


def test_a_pinched_cube_breaks_at_twice_mu_n(pinched: GraspPlan) -> None:
    outcome = push("force -z").run(pinched, under())
    answer = 2 * PHYSICS.mu * PRESS
    assert outcome.largest_load_held <= 1.005 * answer
    assert outcome.failure_load >= 0.995 * answer
    # a load that is hardly too large needs longer than a step to carry the cube away
    assert outcome.failure_load <= FINE.growth**2 * answer
    assert outcome.largest_load_held >= answer / FINE.growth**2
    assert (outcome.reason, outcome.unit) == ("slipped", "N")
    np.testing.assert_allclose(outcome.wrench, [0, 0, -1, 0, 0, 0])


def test_about_the_line_between_its_fingers_it_breaks_at_twice_mu_torsion_n(
    pinched: GraspPlan,
) -> None:
    outcome = push("torque +x", replace(FINE, first_load=0.4)).run(pinched, under())
    answer = 2 * PHYSICS.mu_torsion * PRESS
    assert outcome.largest_load_held <= 1.005 * answer
    assert outcome.failure_load >= 0.995 * answer
    assert outcome.failure_load <= FINE.growth**2 * answer
    assert outcome.largest_load_held >= answer / FINE.growth**2
    assert outcome.unit == "N m"
    np.testing.assert_allclose(outcome.wrench, [0, 0, 0, 1, 0, 0])


def test_the_bound_is_what_the_strongest_press_would_bear(pinched: GraspPlan) -> None:
    along = proven_bound(pinched, PHYSICS, np.eye(6)[1])
    assert along.upper == pytest.approx(2 * PHYSICS.mu * STRONGEST, rel=2e-3)
    about = proven_bound(pinched, PHYSICS, np.eye(6)[3])
    assert about.upper == pytest.approx(2 * PHYSICS.mu_torsion * STRONGEST, rel=2e-3)
    # one finger pushes, the other lets go
    across = proven_bound(pinched, PHYSICS, np.eye(6)[0])
    assert across.upper == pytest.approx(STRONGEST, rel=2e-3)


@pytest.mark.slow
def test_simulation_never_bears_more_than_is_proven(grasped: GraspPlan) -> None:
    coarse = Settings(growth=1.5)
    for name in ("force +z", "torque -x", "wrench 7"):
        outcome = push(name, coarse).run(grasped, under())
        assert 0 < outcome.largest_load_held < outcome.bound, name
        assert outcome.bound < outcome.bound_near < np.inf
        assert not outcome.contradicts
        assert not outcome.held
        # the load grows from sample to sample, and is known at every one
        hold = outcome.samples.during("hold")
        assert outcome.load[hold[0]] == 0
        assert (np.diff(outcome.load) >= 0).all()
        assert outcome.load[-1] <= outcome.failure_load + 1e-12


def test_a_contradiction_is_told(pinched: GraspPlan) -> None:
    outcome = push("force +y", replace(FINE, growth=1.5)).run(pinched, under())
    assert not outcome.contradicts
    assert outcome.stood is not None and NEAR.holds(outcome.stood)
    assert replace(outcome, bound_near=0.9 * outcome.largest_load_held).contradicts
    # more than the planned posture could bear is none: another posture has borne it
    assert not replace(outcome, bound=0.9 * outcome.largest_load_held).contradicts
    far = replace(outcome.stood, turn=2.0 * NEAR.turn)
    assert not replace(outcome, bound_near=0.9 * outcome.largest_load_held, stood=far).contradicts


def test_gravity_is_borne_up_to_the_friction_there_is(jaw: Hand) -> None:
    # planned at mu 0.5 and 80 % of it, executed at 0.6
    held = GravityCase(index=0, axis=3, settings=Settings(hold_s=0.5))
    assert held.run(pinch(jaw, mass=0.15), under()).held
    heavy = pinch(jaw, mass=2.0)
    assert held.run(heavy, under()).reason == "infeasible forces"


# DexGraspBench's test


@pytest.mark.parametrize(("strongest", "held"), [(1.0, True), (0.7, False)])
def test_fc_holds_one_newton_where_friction_does(
    tmp_path: Path, strongest: float, held: bool
) -> None:
    # 2 x 0.6 x 1.0 = 1.2 N is more than 1 N, 2 x 0.6 x 0.7 = 0.84 N is less
    servos = SERVOS.replace('"-20 20"', f'"{-strongest} {strongest}"')
    outcome = DexGraspBenchCase(index=AXES.index("-y")).run(
        pinch(make_jaw(tmp_path, servos), press=0.7)
    )
    assert outcome.held == held
    assert outcome.reason in (("",) if held else ("slipped", "dropped", "torque limit reached"))


def test_fc_is_a_sequence_of_stages(servo_jaw: Hand) -> None:
    plan = pinch(servo_jaw)
    replay = Replay(plan)
    squeezed = plan_squeeze(plan.task, plan.contacts, plan.T_world_base, plan.q).ctrl
    np.testing.assert_allclose(replay.pregrasp, plan.q_pregrasp)
    np.testing.assert_allclose(replay.grasp, plan.q)
    np.testing.assert_array_equal(replay.squeeze, squeezed)
    assert (squeezed > plan.q + PRESS / 500).all()

    hold = DisturbanceTrial(plan, controller=replay)

    def commands(phase: Phase) -> FloatArray:
        return np.array([replay.step(hold.simulation.observe(phase, k / 100)) for k in range(100)])

    close, squeeze = commands("close"), commands("squeeze")
    for motion, begin, end in (
        (close, plan.q_pregrasp, plan.q),
        (squeeze, plan.q, squeezed),
    ):
        stages = motion[::10]
        np.testing.assert_array_equal(np.repeat(stages, 10, axis=0), motion)
        np.testing.assert_allclose(np.diff(stages, axis=0), np.tile((end - begin) / 10, (9, 1)))
        np.testing.assert_allclose(stages[-1], end)


def test_fc_has_its_own_physics_and_times(grasped: GraspPlan) -> None:
    stated = physics_of(grasped, benchmark_physics())
    assert stated["timestep_s"] == 0.004
    assert (stated["integrator"], stated["cone"]) == ("implicitfast", "elliptic")
    assert (stated["impratio"], stated["noslip_iterations"]) == (10, 2)
    assert (stated["friction"], stated["torsional_friction_m"]) == (0.6, 0.02)
    outcome = DexGraspBenchCase(index=0).run(grasped, under())
    assert outcome.held
    s = outcome.samples
    assert set(s.phase) == {"close", "squeeze", "hold"}
    assert s.time[-1] == pytest.approx(0.4 + 0.4 + 2.0, abs=0.1)
    assert set(outcome.load[s.during("hold")][1:]) == {1.0}
    assert not outcome.load[s.during("close", "squeeze")].any()
    assert s.closed[s.during("hold")].all()


def test_fc_needs_servos(pinched: GraspPlan) -> None:
    with pytest.raises(TaskError, match=r"commands postures, and left, right of jaw are no posi"):
        run_protocol(pinched, "dexgraspbench")


# shaking


def test_a_shaker_is_at_rest_at_both_ends_and_reaches_its_amplitude(pinched: GraspPlan) -> None:
    gantry = DisturbanceTrial(pinched, controller=GraspController).simulation.scene.gantry
    assert gantry is not None
    shaker = Shaker(gantry, 0, 0.01, 5.0, 2.0)
    times = np.linspace(0.0, 2.0, 2001)
    path = np.array([shaker.coordinate(t) for t in times])
    assert np.abs(path).max() == pytest.approx(0.01, rel=1e-3)
    speed = np.diff(path) / np.diff(times)
    assert abs(path[0]) + abs(path[-1]) < 1e-12
    assert abs(speed[0]) + abs(speed[-1]) < 1e-4
    assert np.count_nonzero(np.diff(np.sign(path[1:-1]))) == 19  # ten periods
    assert np.abs(speed).max() == pytest.approx(2 * np.pi * 5.0 * 0.01, rel=0.01)


@pytest.mark.slow
def test_shaking_reaches_what_was_asked_and_breaks_what_it_must(pinched: GraspPlan) -> None:
    gentle = Settings(shake_mm=5.0, shake_s=1.0)
    outcome = ShakeCase(index=1, settings=gentle).run(pinched, under())
    assert outcome.held, outcome.fault
    assert outcome.conditions["reached_mm"] == pytest.approx(5.0, rel=0.1)
    turned = ShakeCase(index=5, settings=gentle).run(pinched, under())
    assert turned.conditions["reached_deg"] == pytest.approx(5.0, rel=0.1)
    # 2 mu N / m = 24 m/s2 is what friction can give; A (2 pi f)^2 asks for 49 m/s2
    violent = Settings(shake_mm=50.0, shake_s=1.0)
    outcome = ShakeCase(index=1, settings=violent).run(pinched, under())
    assert outcome.reason in ("slipped", "dropped")
    assert outcome.fault is not None
    assert outcome.fault.time == pytest.approx(outcome.samples.time[-1], abs=0.003)


# errors of mass, friction and pose


@settings(max_examples=50, deadline=None)
@given(
    seed=st.integers(0, 2**32),
    shift=st.floats(0.0, 0.01),
    turn=st.floats(0.0, 0.2),
    on_table=st.booleans(),
)
def test_a_displaced_pose_is_off_by_what_was_asked(
    seed: int, shift: float, turn: float, on_table: bool
) -> None:
    rng = np.random.default_rng(seed)
    pose = SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3))
    moved = displaced(pose, shift, turn, rng, on_table=on_table)
    assert np.linalg.norm(moved.translation - pose.translation) == pytest.approx(shift, abs=1e-12)
    between = moved.rotation @ pose.rotation.T
    assert rotation_angle(between) == pytest.approx(turn, abs=1e-7)
    if on_table:
        assert moved.translation[2] == pose.translation[2]
        np.testing.assert_allclose(between[2], [0.0, 0.0, 1.0], atol=1e-12)


def test_the_grid_is_the_whole_grid() -> None:
    cases = robust_cases(Settings(), 0)
    assert len({c.name for c in cases}) == len(cases) == 27
    assert {c.mass for c in cases} == {0.5, 1.0, 2.0}
    assert {c.friction for c in cases} == {0.7, 1.0, 1.3}
    assert {(c.shift_mm, c.turn_deg) for c in cases} == {(0.0, 0.0), (2.5, 2.5), (5.0, 5.0)}


def test_friction_differs_along_and_about_the_normal(
    pinched: GraspPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is executed: the true mass, and both frictions by the same share."""
    executed: list[tuple[GraspPlan, TrialOptions]] = []

    def taking(plan: GraspPlan, options: TrialOptions) -> None:
        executed.append((plan, options))
        raise TaskError("enough")

    monkeypatch.setattr(variations, "simulate", taking)
    case = RobustCase(index=0, mass=2.0, friction=0.7, shift_mm=0.0, turn_deg=0.0, seed=0)
    with pytest.raises(TaskError, match="enough"):
        case.run(pinched, under())
    ((plan, options),) = executed
    given: Any = under().physics
    physics: Any = options.physics
    assert physics.mu == pytest.approx(0.7 * given.mu)
    assert physics.mu_torsion == pytest.approx(0.7 * given.mu_torsion)
    assert plan.task.object.mass == pytest.approx(2.0 * pinched.task.object.mass)


@pytest.mark.slow
def test_the_controller_does_not_know_what_differs(grasped: GraspPlan) -> None:
    known: list[GraspPlan] = []

    def remembering(plan: GraspPlan) -> Controller:
        known.append(plan)
        return GraspController(plan)

    case = RobustCase(index=0, mass=2.0, friction=1.3, shift_mm=5.0, turn_deg=5.0, seed=0)
    outcome = case.run(grasped, under(remembering))
    assert outcome.held, outcome.fault
    assert known == [grasped]
    hopeless = replace(case, mass=30.0)
    outcome = hopeless.run(grasped, under())
    assert not outcome.held
    assert outcome.fault is not None
    assert np.isfinite(outcome.fault.time)


# reasons


class Altered:
    """The usual controller, whose commands are changed in some phases."""

    def __init__(
        self, plan: GraspPlan, change: Callable[[FloatArray], FloatArray], *phases: str
    ) -> None:
        """Note what to change and when."""
        self._inner, self._change, self._phases = GraspController(plan), change, phases

    def step(self, observation: Observation) -> FloatArray:
        ctrl = self._inner.step(observation)
        return self._change(ctrl) if observation.phase in self._phases else ctrl


def held_by(plan: GraspPlan, change: Callable[[FloatArray], FloatArray], *phases: str) -> Outcome:
    """A hold with such a controller."""
    case = GravityCase(index=0, axis=0, settings=Settings(hold_s=0.3))
    return case.run(plan, under(lambda p: Altered(p, change, *phases)))


def test_no_contact(pinched: GraspPlan) -> None:
    outcome = held_by(pinched, np.zeros_like, "close", "squeeze", "settle")
    assert outcome.reason == "no contact"
    assert "did not touch; 2 are needed" in str(outcome.fault)
    assert not outcome.held


def test_dropped(pinched: GraspPlan) -> None:
    outcome = held_by(pinched, lambda ctrl: -5.0 * np.ones_like(ctrl), "hold")
    assert outcome.reason == "dropped"
    assert outcome.fault is not None
    assert "nothing touched it any more" in outcome.fault.detail


def test_diverged(pinched: GraspPlan) -> None:
    outcome = held_by(pinched, lambda ctrl: np.full_like(ctrl, np.nan), "hold")
    assert outcome.reason == "diverged"


@pytest.mark.slow
def test_torque_limit_reached(servo_jaw: Hand) -> None:
    # the right servo gives all it has; what pushes the cube against it pushes both along
    outcome = push("force +x", Settings()).run(pinch(servo_jaw, press=STRONGEST), under())
    assert outcome.reason == "torque limit reached"
    assert outcome.fault is not None
    assert "right stood at the limit; then: slipped" in outcome.fault.detail


def test_pressed_with_all_there_is_it_bears_what_is_proven(jaw: Hand) -> None:
    strong = pinch(jaw, press=STRONGEST)
    outcome = push("force +y", replace(FINE, first_load=20.0)).run(strong, under())
    assert outcome.bound == pytest.approx(2 * PHYSICS.mu * STRONGEST, rel=2e-3)
    assert FINE.growth**-2 < outcome.largest_load_held / outcome.bound < 1.0
    assert not outcome.contradicts


def test_penetration(servo_jaw: Hand) -> None:
    plan = pinch(servo_jaw)
    deep = DexGraspBenchCase(index=0).run(replace(plan, q_pregrasp=plan.q + 0.011), under())
    assert deep.reason == "penetration"
    assert deep.conditions["start_penetration_mm"] == pytest.approx(11.0, abs=1e-6)
    assert deep.conditions["grasp_penetration_mm"] == pytest.approx(0.0, abs=1e-3)
    assert len(deep.samples) == 0
    json.dumps(deep.to_dict(), allow_nan=False)


def test_every_reason_is_one_of_those_listed() -> None:
    assert {"", "penetration", "torque limit reached", "diverged"} <= set(REASONS)
    assert len(set(REASONS)) == len(REASONS)


# running


@pytest.mark.slow
def test_results_do_not_depend_on_the_number_of_workers(pinched: GraspPlan) -> None:
    quick = Settings(shake_s=0.2)
    some = ("shake x", "shake rz")
    one = run_protocol(pinched, "shake", settings=quick, only=some, workers=1)
    two = run_protocol(pinched, "shake", settings=quick, only=some, workers=2)
    assert one.complete
    assert [o.to_dict() for o in one.outcomes] == [o.to_dict() for o in two.outcomes]
    assert tuple(o.name for o in one.outcomes) == some


@pytest.mark.slow
def test_what_was_done_is_kept_after_ctrl_c(pinched: GraspPlan, tmp_path: Path) -> None:
    calls = 0

    def check() -> None:
        nonlocal calls
        calls += 1
        if calls == 3:
            raise KeyboardInterrupt

    file = tmp_path / "lines.jsonl"
    report = run_protocol(
        pinched, "shake", settings=Settings(shake_s=0.2), file=file, check=check, name="p"
    )
    rows = [json.loads(line) for line in file.read_text().splitlines()]
    assert [row["trial"] for row in rows] == ["shake x", "shake y"]
    assert [o.name for o in report.outcomes] == ["shake x", "shake y"]
    assert (report.complete, report.success, report.asked) == (False, False, 6)


@pytest.mark.slow
def test_a_report_is_a_table_json_and_csv(pinched: GraspPlan, tmp_path: Path) -> None:
    coarse = Settings(random=1, growth=4.0, step_s=0.1, hold_s=0.1)
    some = ("gravity +x", "gravity -z", "force +y", "torque -x", "wrench 0")
    report = run_protocol(pinched, "forces", settings=coarse, seed=3, only=some, name="jaw")
    assert report.asked == len(some)
    data = json.loads(json.dumps(report.to_dict(), allow_nan=False))
    assert data["physics"]["cone"] == "elliptic"
    assert data["physics"]["noslip_iterations"] == PHYSICS.noslip_iterations
    assert (data["held"], data["of"], data["contradictions"]) == (2, 2, [])
    assert len(data["trials"]) == report.asked
    over_time = data["trials"][-1]["over_time"]
    assert len(over_time["load"]) == len(over_time["normal_force_N"]) == len(over_time["closed"])
    least = min(o.largest_load_held for o in report.outcomes if o.unit == "N")
    assert data["least_load_held_N"] == least
    write_csv([report], tmp_path / "trials.csv")
    with (tmp_path / "trials.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["trial"] for row in rows] == [o.name for o in report.outcomes]
    assert protocol_table(report).row_count == report.asked


def test_random_directions_follow_the_seed_and_are_of_length_one() -> None:
    first, again, other = (forces_cases(Settings(), seed) for seed in (1, 1, 2))
    directions = [np.array([c.direction for c in cases[-20:]]) for cases in (first, again, other)]  # type: ignore[union-attr]
    np.testing.assert_array_equal(directions[0], directions[1])
    assert not np.allclose(directions[0], directions[2])
    np.testing.assert_allclose(np.linalg.norm(directions[0], axis=1), 1.0)
    assert [c.name for c in first[6:12]] == [f"force {a}" for a in AXES]
    assert len(first) == 6 + 12 + 20


def test_every_protocol_has_cases_in_order(pinched: GraspPlan) -> None:
    for name in PROTOCOLS:
        assert [c.index for c in cases_of(name, Settings(), 0)] == list(
            range(len(cases_of(name, Settings(), 0)))
        )
    assert len(dexgraspbench_cases()) == len(shake_cases(Settings())) == 6
    with pytest.raises(NotFoundError, match="protocol"):
        run_protocol(pinched, "push")
    with pytest.raises(NotFoundError, match="trial"):
        run_protocol(pinched, "dexgraspbench", only=["shake x"])
    with pytest.raises(NotFoundError, match="trial"):
        run_protocol(pinched, "shake", only=["shake w"])
    with pytest.raises(NotFoundError, match="controller"):
        run_protocol(pinched, "shake", controller="none")
    with pytest.raises(TaskError, match="workers is 0"):
        run_protocol(pinched, "shake", workers=0)


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ({"growth": 1.0}, "growth is 1.0; give a finite number > 1"),
        ({"hold_s": 0.0}, "hold_s is 0.0"),
        ({"random": -1}, "random is -1; give a whole number from 0"),
        ({"mass_factors": (0.0,)}, "mass_factors is 0.0; give a finite number > 0"),
        ({"pose_errors": ((-1.0, 0.0),)}, "pose_errors is -1.0; give a finite number >= 0"),
    ],
)
def test_settings_are_checked(bad: dict[str, object], message: str) -> None:
    with pytest.raises(TaskError, match=message):
        Settings(**bad)  # type: ignore[arg-type]
    assert Settings().dropped == LossCriteria(fewest=1, mm=10.0, deg=15.0)


@pytest.mark.slow
def test_the_command(
    grasped: GraspPlan, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, out = tmp_path / "plan.json", tmp_path / "out"
    write_plan(grasped, file)
    arguments = [
        "test",
        str(file),
        "--protocol",
        "dexgraspbench",
        "--workers",
        "1",
        "--out",
        str(out),
    ]
    with pytest.raises(SystemExit) as ended:
        main([*arguments, "--json"])
    assert ended.value.code == 0
    (summary,) = json.loads(capsys.readouterr().out)["reports"]
    assert (summary["held"], summary["of"], summary["success"]) == (6, 6, True)
    assert summary["physics"]["timestep_s"] == 0.004
    names = {path.name for path in out.iterdir()}
    assert names == {"000-plan-dexgraspbench.jsonl", "000-plan-dexgraspbench.json", "trials.csv"}
    assert len((out / "000-plan-dexgraspbench.jsonl").read_text().splitlines()) == 6
    lines = (out / "000-plan-dexgraspbench.jsonl").read_text().splitlines()
    assert {json.loads(line)["controller"] for line in lines} == {"replay"}
    assert summary["controller"] == "replay"


def test_trials_are_looked_for_in_every_protocol() -> None:
    asked = ["shake x", "dexgraspbench +z", "shake rz"]
    assert trials_of(PROTOCOLS, asked, Settings(), 0) == {
        "dexgraspbench": ("dexgraspbench +z",),
        "shake": ("shake x", "shake rz"),
    }
    assert tuple(trials_of(PROTOCOLS, [], Settings(), 0)) == tuple(PROTOCOLS)
    with pytest.raises(NotFoundError, match="no trial is called 'shake w'"):
        trials_of(PROTOCOLS, ["shake x", "shake w"], Settings(), 0)


def test_a_protocol_says_which_hands_it_is_not_for(jaw: Hand, servo_jaw: Hand) -> None:
    of_motors, of_servos = pinch(jaw).task, pinch(servo_jaw).task
    assert "left, right of jaw are no position servos" in unsuitable("dexgraspbench", of_motors)
    assert [unsuitable(name, of_servos) for name in PROTOCOLS] == [""] * len(PROTOCOLS)
    on_arm = GraspTask.create("allegro_on_arm7", "sphere")
    assert "allegro_on_arm7 is on an arm" in unsuitable("shake", on_arm)
    assert unsuitable("forces", on_arm) == ""


@pytest.mark.slow
def test_of_all_protocols_those_that_a_hand_cannot_take_are_skipped(
    pinched: GraspPlan, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "plan.json"
    write_plan(pinched, file)
    arguments = ["test", str(file), "--protocol", "all", "--workers", "1"]
    arguments += ["--out", str(tmp_path / "out"), "--json"]

    def run(*names: str) -> tuple[int, dict[str, list[dict[str, str]]], str]:
        with pytest.raises(SystemExit) as ended:
            main([*arguments, *(text for name in names for text in ("--only", name))])
        told = capsys.readouterr()
        return int(ended.value.code or 0), json.loads(told.out or "{}"), told.err

    code, told, text = run("dexgraspbench +x", "shake x")
    assert code == 0
    assert [report["protocol"] for report in told["reports"]] == ["shake"]
    assert [each["protocol"] for each in told["skipped"]] == ["dexgraspbench"]
    assert "skipped: " in text
    assert "left, right of jaw are no position servos" in text
    code, told, text = run("dexgraspbench +x")
    assert (code, told) == (3, {})
    assert "nothing was tested" in text


def test_without_bounds_loads_are_told_without_a_share(pinched: GraspPlan) -> None:
    coarse = Settings(random=0, growth=4.0, step_s=0.1)
    report = run_protocol(pinched, "forces", settings=coarse, only=["force +y"])
    assert "of what the certificate allows" in " ".join(str(report).split())
    boundless = tuple(replace(o, bound=float("nan")) for o in report.outcomes)
    told = " ".join(str(replace(report, outcomes=boundless)).split())
    assert "load held: median" in told
    assert "certificate" not in told


@pytest.mark.slow
def test_a_report_prints_as_a_screen(pinched: GraspPlan) -> None:
    """With every trial of the longest protocol on it."""
    coarse = Settings(random=0, growth=4.0, step_s=0.1, hold_s=0.1)
    report = run_protocol(pinched, "forces", settings=coarse)
    text = str(report)
    assert len(text) < 3000
    assert "forces: not held: jaw" in text and "control feedforward" in text
    first = report.failed[0]
    assert first.fault is not None
    assert f"not held: {first.name}: {first.reason}, {first.fault.detail}" in " ".join(text.split())
    held = replace(report, outcomes=tuple(o for o in report.outcomes if o not in report.failed))
    held = replace(held, asked=len(held.outcomes))
    assert held.success and "forces: held: jaw" in str(held)
    assert f"ended by slipped: {report.reasons['slipped']}" in text
    heavy = replace(report, outcomes=report.outcomes[:3])
    assert "forces: not held, 3 of 18 trials finished" in str(heavy)


def test_the_help_names_every_protocol(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["test", "--help"])
    told = " ".join(capsys.readouterr().out.split())
    every = ("hold", "creep", *PROTOCOLS)
    assert f"{', '.join(every)}, or all" in told.replace("\u2502 ", "")
