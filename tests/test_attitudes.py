"""Other attitudes of the hand: gravity in planning, the wrist's way, files, and an execution."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from manipulations import QUICK, task_of

from planner.errors import NoGraspFoundError, NotFoundError, TaskError
from planner.failure import Failure
from planner.files import read_movement, write_movement
from planner.files.movements import movement_to_dict
from planner.motion.manipulation import ManipulationPlan, plan_manipulation
from planner.motion.path import ATTITUDES, AnyAttitude, ObjectPath, checked_attitude, tilts
from planner.motion.plan import WRIST_RATE
from planner.motion.regrasp import ROOM, FingerPaths
from planner.motion.single_stroke import merit, turning_press
from planner.motion.verify import FALLS, PRESSES, MovementVerifier, Waypoint, _falls, pressed
from planner.spatial import SE3, rotation_angle, shifted
from planner.task import Obstacle
from sim.cli.manipulate import TurnExecution
from sim.controllers import ObjectImpedance
from sim.manipulation import ManipulationReport, manipulate
from sim.manipulation.driver import BaseMover
from sim.manipulation.phases import Phases
from sim.manipulation.simulation import ManipulationOptions, _hinges
from sim.manipulation.timeline import SuccessCriteria
from sim.scene.gantry import Gantry

G = 9.81
CORNERS = ((0.03, 0.02), (0.05, -0.01))
"""Places through which an object is carried, m."""


@pytest.fixture(scope="module")
def plan() -> ManipulationPlan:
    """A small turn of a cylinder with the palm up."""
    task = task_of("cylinder:0.03x0.08", mass=0.2)
    return plan_manipulation(task, angle=math.radians(40.0), place=(0.04, -0.02), attitude="up")


@pytest.fixture(scope="module")
def report(plan: ManipulationPlan) -> ManipulationReport:
    """What comes of it, carried around a corner meanwhile."""
    return manipulate(plan, timeline=replace(QUICK, wrist_rate=2.0), via=CORNERS)


def path(attitude: AnyAttitude = "down") -> ObjectPath:
    turn = checked_attitude(attitude)
    return ObjectPath(axis=np.array([0.0, 0.0, 1.0]), angle=1.0, shift=np.zeros(3), attitude=turn)


@pytest.mark.parametrize(("name", "felt"), [("down", (0, 0, -G)), ("up", (0, 0, G))])
def test_gravity_is_what_an_attitude_changes(name: str, felt: tuple[float, ...]) -> None:
    """Seen from the hand; and sideways it is level, halfway there at 45 degrees."""
    task = task_of("cylinder:0.03x0.08")
    np.testing.assert_allclose(path(name).borne(task).gravity, felt, atol=1e-9)
    sideways = path("sideways")
    assert abs(sideways.borne(task).gravity[2]) < 1e-9
    assert sideways.borne(task, 0.5).gravity[2] == pytest.approx(-G * math.cos(math.pi / 4))


def test_the_way_of_the_wrist_ends_in_the_attitude() -> None:
    """Half a turn too, whose axis has no sign."""
    for turn in ATTITUDES.values():
        one = path(turn)
        np.testing.assert_allclose(one.wrist(0.0), np.eye(3), atol=1e-12)
        np.testing.assert_allclose(one.wrist(1.0), turn, atol=1e-9)
        assert len(one.wrist_shares) == 1 + round(np.linalg.norm(one.wrist_turn) * 12 / np.pi)
    np.testing.assert_array_equal(path("sideways").cut(0.5).attitude, ATTITUDES["sideways"])


def test_the_weight_turns_back_about_what_is_level_in_the_attitude() -> None:
    """Whether the object stands otherwise afterwards is asked with the palm down."""
    x, y, z = np.eye(3)
    for axis, down, sideways, up in ((z, 0, 1, 0), (y, 1, 0, 1), (x, 1, 1, 1)):
        assert tilts(axis) == bool(down)
        for name, back in (("down", down), ("sideways", sideways), ("up", up)):
            assert replace(path(name), axis=axis).weight_turns_back == bool(back), (axis, name)


def test_a_hand_above_no_table_is_not_lifted_before_its_wrist_turns(
    plan: ManipulationPlan,
) -> None:
    """There is no floor at 0; an obstacle is one."""
    free = replace(plan.task, table_height=None)
    grasp = replace(plan.grasp, task=free)
    assert plan.rise > 0.0 and replace(plan, grasp=grasp).rise == 0.0
    box = Obstacle(name="shelf", size=np.full(3, 0.1), T_world_obstacle=SE3.Identity())
    grasp = replace(plan.grasp, task=replace(free, obstacles=(box,)))
    assert replace(plan, grasp=grasp).rise == pytest.approx(plan.rise + 0.05)


def test_the_wrist_of_a_trajectory_turns_in_one_go(plan: ManipulationPlan) -> None:
    """At rest at its ends alone, about the object's centre, for as long as before."""
    made = plan.joint_trajectory(rate_hz=200.0)
    center = plan.task.T_world_object.translation
    held = plan.T_world_base.inverse().act(center)
    for phase in ("wrist", "wrist back"):
        rows = np.flatnonzero(np.array(made.phases) == phase)
        assert len(rows) / 200.0 == pytest.approx(np.pi / WRIST_RATE, rel=0.02)
        bases = [made.T_world_base[k] for k in rows]
        turned = [rotation_angle(b.rotation @ a.rotation.T) for a, b in pairwise(bases)]
        middle = np.array(turned)[len(turned) // 10 : -len(turned) // 10]
        assert middle.min() > 0.1 * middle.max()
        away = np.array([b.act(held) for b in bases]) - center - [0.0, 0.0, max(plan.rise, 0.08)]
        assert np.linalg.norm(away, axis=1).max() < 1e-3
        speeds = np.diff([b.translation for b in bases], axis=0)
        assert (
            np.linalg.norm(np.diff(speeds, axis=0), axis=1).max()
            < 0.05 * np.linalg.norm(speeds, axis=1).max()
        )


def test_what_is_no_attitude_is_refused() -> None:
    """By name, and what would mirror the hand."""
    with pytest.raises(NotFoundError, match="attitude"):
        checked_attitude("left")
    with pytest.raises(TaskError, match="no rotation"):
        checked_attitude(np.diag([1.0, 1.0, -1.0]))


def test_forces_bear_the_weight_in_the_attitude_and_on_the_way(plan: ManipulationPlan) -> None:
    """Contact forces and gravity as the hand feels it add up to nothing at every orientation."""
    task, way = plan.task, plan.path
    for knot in plan.knots:
        solved = [knot.forces, *knot.on_the_way]
        assert len(solved) == len(way.wrist_shares) == 13
        for share, forces in zip(way.wrist_shares[::-1], solved, strict=True):
            weight = task.object.mass * way.borne(task, float(share)).gravity
            pressed = forces.contacts
            total = np.einsum("nij,nj->i", pressed.frames, pressed.forces[:, :3])
            np.testing.assert_allclose(total, -weight, atol=2e-3)
    assert plan.reserve > 0.0


def test_the_hand_is_lifted_clear_of_the_table_before_it_turns(plan: ManipulationPlan) -> None:
    """Nothing of it comes lower than 25 mm above the table while the wrist turns."""
    assert (
        plan.motion.with_knots(plan.knots, replace(plan.path, attitude=ATTITUDES["down"])).rise
        == 0.0
    )
    hand, q = plan.task.hand, plan.grasp.q
    data = hand.pin_model.createData()
    pin.forwardKinematics(hand.pin_model, data, q)
    lowest = np.inf
    for share in np.linspace(0.0, 1.0, 61):
        base = plan.turned_base(float(share))
        for one in hand.geometries:
            corners = one.corners @ one.T_joint_geometry.rotation.T
            corners = corners + one.T_joint_geometry.translation
            for corner in corners:
                lowest = min(lowest, base.act(data.oMi[one.joint_id].act(corner))[2])
    assert plan.task.table_height is not None
    assert lowest + plan.rise > plan.task.table_height + 0.025


def test_a_file_keeps_the_attitude_and_has_none_without(
    plan: ManipulationPlan, tmp_path: Path
) -> None:
    """So that earlier versions read what they could plan, and their files are read."""
    write_movement(plan, tmp_path / "up.json")
    again = read_movement(tmp_path / "up.json")
    np.testing.assert_array_equal(again.path.attitude, ATTITUDES["up"])
    assert again.reserve == pytest.approx(plan.reserve, abs=1e-3)
    level = replace(plan, path=replace(plan.path, attitude=ATTITUDES["down"]))
    assert "attitude" not in movement_to_dict(level)["path"]


def test_a_grasp_that_holds_palm_down_may_fall_in_an_attitude(
    plan: ManipulationPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The failure says so, where on the wrist's way, and names the limit; palm down it holds."""
    points = [
        Waypoint(
            path_parameter=knot.path_parameter,
            T_object_base=knot.T_world_object.inverse() * plan.T_world_base,
            q=knot.q,
        )
        for knot in plan.knots[:2]
    ]
    monkeypatch.setattr("planner.motion.verify.MOST_PRESS", 1.0)
    verifier = MovementVerifier(plan.task)
    down = replace(plan.path, attitude=ATTITUDES["down"])
    assert isinstance(verifier.verify_knots(plan.T_world_base, points, down, 0.03), tuple)
    fallen = verifier.verify_knots(plan.T_world_base, points, plan.path, 0.03)
    assert isinstance(fallen, Failure)
    assert fallen.kind == FALLS
    assert "palm down, but in the attitude: forces: a finger has to press" in fallen.text

    forces = plan.knots[0].forces
    hard = _falls(plan.task, forces, 0.0, (forces, forces))
    assert hard.kind == PRESSES and "attitude" not in hard.text
    assert hard.text.startswith("held with the palm down: forces: a finger has to press")

    monkeypatch.setattr("planner.motion.single_stroke.FALLEN", 2)
    monkeypatch.setattr("planner.motion.verify.MOST_PRESS", 0.1)
    with pytest.raises(NoGraspFoundError, match="falls in this attitude") as raised:
        plan_manipulation(plan.task, angle=plan.angle, attitude="up")
    assert len(raised.value.attempts) <= 8


def test_a_drift_to_the_other_side_of_where_it_was_is_a_drift(plan: ManipulationPlan) -> None:
    """From 5 mm to one side to 5 mm to the other the object has moved by 10."""
    side = np.array([0.005])

    def ran(phase: str, duration: float) -> str:
        side[0] *= -1.0
        return ""

    sim: Any = SimpleNamespace(
        recorder=SimpleNamespace(moved=lambda: (0.0, 0.0, np.append(side, [0.0, 0.0]))),
        mover=SimpleNamespace(go_along=lambda poses, duration: None, duration=1.0),
        touching_fingers=plan.task.finger_names,
        run=ran,
    )
    phases = Phases.__new__(Phases)
    phases._sim, phases._plan, phases._timeline = sim, plan, QUICK
    phases._criteria = SuccessCriteria(slip_mm=8.0)
    fault, numbers = phases._wrist("wrist")
    assert "moved 10.0 mm in the hand while the wrist turned" in fault
    assert numbers["drift_mm"] == pytest.approx(10.0)
    phases._shortfall = lambda numbers: ""  # type: ignore[method-assign]
    assert phases._hold()[1]["drift_mm"] == pytest.approx(10.0)


def test_a_phase_lasts_as_long_as_an_arm_takes() -> None:
    """Asked in 1 s, where the arm's joints need 3."""
    ran: list[Any] = []
    went: list[Any] = []
    mover = SimpleNamespace(go=lambda *given: went.append(given), duration=3.0)

    def run(*given: Any) -> str:
        ran.append(given)
        return "why"

    phases = Phases.__new__(Phases)
    phases._sim = SimpleNamespace(mover=mover, run=run)  # type: ignore[assignment]
    assert phases._go("lift", SE3.Identity(), 1.0) == "why"
    assert went == [(SE3.Identity(), 1.0)] and ran == [("lift", 3.0)]


def test_a_gantry_turns_by_half_a_turn_about_any_axis() -> None:
    """Its coordinates give the pose back, and the first hinge alone turns."""
    rng = np.random.default_rng(4)
    for _ in range(5):
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        none = np.zeros(6, dtype=np.int64)
        gantry = Gantry(
            T_world_base=SE3.Random(),
            qpos=none,
            dof=none,
            ctrl=none,
            gains=np.ones((2, 6)),
            hinges=_hinges(axis),
        )
        for angle in (0.3, 1.57, 3.1):
            start = gantry.T_world_base
            pose = SE3(pin.exp3(angle * axis) @ start.rotation, start.translation + 0.1)
            found = gantry.coordinates(pose)
            np.testing.assert_allclose(found[3:], [angle, 0.0, 0.0], atol=1e-6)
            assert gantry.pose(found).isApprox(pose, 1e-6)


def test_an_object_is_turned_palm_up_and_put_down(report: ManipulationReport) -> None:
    """The palm looks up during the turn; the wrist turns before it and back after it."""
    names = [result.phase for result in report.results]
    assert names.index("wrist") + 1 == names.index("turn")
    assert names.index("wrist back") == names.index("carry") - 1
    assert report.complete, str(report)
    assert report.success_with_closure, str(report)
    turning = report.log.during("turn")
    base = report.recording.T_world_base[turning]
    first = report.recording.T_world_base[0]
    up = [pin.Quaternion(w, x, y, z).matrix() for *_, w, x, y, z in (*base, first)]
    turned = np.array([u @ up[-1].T for u in up[:-1]])
    assert turned[:, 2, 2].max() < -0.999


def test_an_object_is_carried_while_it_is_turned(report: ManipulationReport) -> None:
    """Through the corner, to where its way ends; the wrist turns back there."""
    turning = report.log.during("turn")
    way = report.recording.T_world_object[turning][:, :2]
    away = np.linalg.norm(way[:, None] - np.array(CORNERS), axis=2)
    assert away[:, 0].min() < 0.006
    assert away[-1, 1] < 0.006
    back = report.log.during("wrist back")
    assert np.linalg.norm(report.recording.T_world_object[back][-1, :2] - CORNERS[-1]) < 0.006


@pytest.mark.parametrize(
    "places", [((0.3, 0.0), (0.3, 0.3)), ((0.02, 0.0), (0.3, 0.0)), ((0.1, 0.0), (0.1, 0.0))]
)
def test_a_hand_goes_straight_from_place_to_place(
    plan: ManipulationPlan, places: tuple[tuple[float, float], ...]
) -> None:
    """As an arm does: it does not go beyond a corner, and not backwards."""
    gantry: Any = SimpleNamespace(coordinates=lambda pose: np.append(pose.translation, [0, 0, 0]))
    phases = Phases.__new__(Phases)
    phases._plan, phases._timeline, phases._via = plan, QUICK, places
    at_first = shifted(plan.turned_base(1.0), [0.0, 0.0, phases.height])
    mover = BaseMover(gantry, at_first)
    phases._sim = SimpleNamespace(mover=mover)  # type: ignore[assignment]
    phases._set_out()
    assert mover._smooth is not None
    way = mover._smooth(np.linspace(0.0, 1.0, 1000))[:, :2] - at_first.translation[:2]
    np.testing.assert_allclose(way[-1], places[-1], atol=1e-9)
    assert way.min() > -1.5e-3 and (way.max(axis=0) < np.max(places, axis=0) + 1.5e-3).all()
    assert np.linalg.norm(way - places[0], axis=1).min() < 1e-3
    phases._via = ((0.0, 0.0),)
    mover.stay()
    phases._set_out()  # it is there
    assert mover._smooth is None


@pytest.mark.parametrize(("hard", "several"), [(True, True), (True, False), (False, True)])
def test_a_stroke_that_presses_hard_is_left_for_regrasps(
    plan: ManipulationPlan, monkeypatch: pytest.MonkeyPatch, hard: bool, several: bool
) -> None:
    """In another attitude, where there are better ones."""
    regrasped = replace(plan)

    def regrasps(*args: Any, **asked: Any) -> ManipulationPlan:
        if not several:
            raise NoGraspFoundError("none", ())
        return regrasped

    at = "planner.motion.manipulation"
    monkeypatch.setattr(f"{at}.plan_single_stroke", lambda *args, **asked: plan)
    monkeypatch.setattr(f"{at}.plan_regrasping", regrasps)
    monkeypatch.setattr(f"{at}.merit", lambda one: 0.7 if hard and one is plan else 1.0)
    found = plan_manipulation(plan.task, angle=plan.angle, attitude="up")
    assert found is (regrasped if hard and several else plan)


def spun(plan: ManipulationPlan, spin: float) -> ManipulationPlan:
    """The plan with another torque of its thumb about its normal, per normal force (m)."""
    made = replace(plan)
    spins = np.zeros((len(plan.knots), len(plan.task.fingers)))
    spins[:, 0] = spin
    vars(made)["spins"] = spins
    return made


def test_a_stroke_whose_thumb_turns_the_object_along_is_not_good_enough(
    plan: ManipulationPlan,
) -> None:
    """Contacts that need too much force for it, or cannot bear it whatever they press with."""
    most = max(pressed(knot.forces) for knot in plan.knots)
    assert turning_press(spun(plan, 0.0)) == pytest.approx(most, rel=1e-3)
    presses = [turning_press(spun(plan, spin)) for spin in (0.0, 0.01, 0.02, 0.1)]
    assert presses == sorted(presses) and presses[-1] == math.inf
    assert merit(spun(plan, 0.1)) == 0.0 < merit(spun(plan, 0.0))


def test_places_of_a_carry_are_pairs_of_numbers() -> None:
    assert TurnExecution(via="0.1,0;0.1,-0.1").places() == ((0.1, 0.0), (0.1, -0.1))
    assert TurnExecution().places() == ()
    for wrong in ("0.1", "a,b", "0.1,0;"):
        with pytest.raises(TaskError, match="--via"):
            TurnExecution(via=wrong).places()
    with pytest.raises(TaskError, match="place"):
        ManipulationOptions(via=((0.1, 200.0),))
    nothing: Any
    for nothing in (3, None, (None,), ((),), (0.1, 0.2), ((0.1, math.inf),), ((0.1, 0.0, 0.2),)):
        with pytest.raises(TaskError, match="via"):
            ManipulationOptions(via=nothing)
    rows: Any = np.array(CORNERS)
    assert ManipulationOptions(via=rows).via == CORNERS
    assert ManipulationOptions().via == ()


def test_swings_keep_room_in_another_attitude(plan: ManipulationPlan) -> None:
    for name, room in (("down", 0.0), ("sideways", ROOM), ("up", ROOM)):
        assert FingerPaths(path(name).borne(plan.task))._apart == room, name


def test_an_arm_that_cannot_turn_the_hand_there_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before anything is planned."""
    task = task_of("cylinder:0.03x0.08", "allegro_on_arm7")
    monkeypatch.setattr("planner.motion.on_arm.rise_for", lambda *_: 5.0)
    with pytest.raises(TaskError, match="does not reach the attitude"):
        plan_manipulation(task, angle=1.0, attitude="up")


@pytest.mark.parametrize("on_arm", [False, True])
def test_nothing_is_learned_while_a_palm_turns(on_arm: bool) -> None:
    """The base of an arm stands; the learned load stays where it is in the world with either."""
    turn = pin.exp3(np.array([0.1, 0.0, 0.0]))
    still = np.eye(3)
    loop: Any = SimpleNamespace(
        law=SimpleNamespace(load=np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])),
        _torques=SimpleNamespace(T_base_palm=SE3(turn if on_arm else still, np.zeros(3))),
        **{"_loaded": still, "_turned": still, "_time": 2.0, "_turning_until": 0.0},
        turning_time=ObjectImpedance.turning_time,
    )
    ObjectImpedance._turn_load(loop, still if on_arm else turn.T)
    assert loop._turning_until == 2.0 + ObjectImpedance.turning_time
    np.testing.assert_allclose(loop.law.load[:3], still[2] if on_arm else turn.T[:, 2])
    loop._turning_until = 0.0
    ObjectImpedance._turn_load(loop, still if on_arm else turn.T)
    assert loop._turning_until == 0.0
