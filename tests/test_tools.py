"""Tools: their files, the wrenches that they need, and their use in MuJoCo."""

from __future__ import annotations

import gc
import io
import json
import re
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar
from unittest.mock import MagicMock
from weakref import ref

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from rich.console import Console

from planner import (
    GraspObject,
    GraspPlan,
    GraspTask,
    NeededWrench,
    load_tool,
    plan_use,
    tools,
    use_task,
)
from planner.certify import certify
from planner.collision.pair_table import Clearance
from planner.errors import FileFormatError, NoGraspFoundError, ObjectError, PlannerError, TaskError
from planner.failure import Failure
from planner.files import read_movement, read_plan, write_movement, write_plan
from planner.files.plans import plan_from_dict, plan_to_dict
from planner.kinematics import HandState
from planner.motion.plan import ManipulationPlan
from planner.objects import parse_object
from planner.pages.motion_page import motion_page, object_motion
from planner.search.attempt import Attempt
from planner.shapes import Mesh
from planner.spatial import SE3, shifted
from planner.synthesis.options import SynthesisOptions, needed_options
from planner.tools import (
    LOADED_CLEARANCE,
    Tool,
    _too_near,
    followed,
    needed_margin,
    read_tool,
    tool_names,
    way_blocked,
)
from planner.verification import verify_grasp
from sim import UseTrial, manipulate, plan_tool
from sim.cli import main
from sim.cli.execution import trial_of
from sim.cli.grasp import UseOptions
from sim.cli.reading import one_plan, plan_to_test
from sim.controllers import PadReading
from sim.controllers.monitors import ALARM_TIME, LOST_TIME
from sim.controllers.object_impedance import GRIP_STEP, ObjectImpedance
from sim.datasets.episodes.sources import _of_file
from sim.report_file import ReportFile, read_report, write_report_of
from sim.scene.build import OBJECT
from sim.scene.gantry import GANTRY_FREQUENCY
from sim.scene.physics import PhysicsOptions
from sim.show.trial_page import trial_page
from sim.simulation import Simulation
from sim.tools import USES, FingersTrial, strike
from sim.tools.press import LEVER
from sim.tools.strike import HOVER, RAISE, THROUGH, Strike, _Blow
from sim.tools.trial import (
    GONE,
    USE_THRESHOLDS,
    YIELDING,
    GuidedLoad,
    UseController,
    rehearsed,
    yaw_of_plan,
)
from sim.tools.turn import HINGE, MADE, RAMP, RATE, SLIDE, Turn
from sim.tools.use import FIXTURE, Motion, use_of

PEG = """
format = "opposable-tool"
version = 1
name = "peg"
mass_kg = 0.05
section = [{ z_m = 0.0, size_m = [0.02, 0.02] }, { z_m = 0.09, size_m = [0.02, 0.02] }]
tip = { position_m = [0, 0, 0], axis = [0, 0, -1] }
handle = [{ lower_m = [-1, -1, 0.03], upper_m = [1, 1, 1] }]
needed = [{ name = "turn", force_N = [1, 0, -2], torque_N_m = [0, 0, -0.03] }]
[use]
kind = "turn"
numbers = { angle_deg = 90 }
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "tool.toml"
    path.write_text(text)
    return path


@pytest.fixture(scope="module")
def movement() -> ManipulationPlan:
    return plan_tool("allegro_hand", "screwdriver", seed=0)


@pytest.fixture(scope="module")
def plan(movement: ManipulationPlan) -> GraspPlan:
    return movement.grasp


class Enough(Exception):
    """Ends a planning of which the rest is of no interest."""


def noting(seen: list[dict[str, Any]]) -> Callable[..., Any]:
    """In place of ``plan_use``: notes what it is given."""

    def note(*_: object, **given: Any) -> None:
        seen.append(given)
        raise Enough

    return note


def test_a_tool_is_told_about_its_centre_of_mass(tmp_path: Path) -> None:
    peg = read_tool(written(tmp_path, PEG))
    assert np.allclose(peg.tip, [0, 0, -0.045])
    assert np.allclose(peg.axis, [0, 0, -1])
    (needed,) = peg.needed
    # (0, 0, -0.045) x (1, 0, -2) = (0, -0.045, 0)
    assert np.allclose(needed.wrench, [1, 0, -2, 0, -0.045, -0.03])
    assert np.isclose(peg.shape.volume, 0.02**2 * 0.09)
    (handle,) = peg.touch.allowed if peg.touch else ()
    assert np.isclose(handle.lower[2], -0.015)
    twice = read_tool(tmp_path / "tool.toml", scale=2.0)
    assert np.allclose(twice.tip, 2 * peg.tip)
    assert np.isclose(twice.shape.volume, 8 * peg.shape.volume)


@pytest.mark.parametrize("name", tool_names())
def test_our_tools_are_offered_axis_down_and_fit_their_fixture(name: str) -> None:
    tool = load_tool(name)
    use = use_of(tool)
    pose = use.offered(0.4)
    assert np.allclose(pose.rotation @ tool.axis, [0, 0, -1])
    spec = mujoco.MjSpec()
    for body in ("obstacle/workpiece", OBJECT):
        spec.worldbody.add_body(name=body).add_geom(size=[0.01, 0.01, 0.01])
    use.add_fixture(spec, PhysicsOptions(), 0.4)
    assert spec.compile().body(LEVER if name == "spray_bottle" else FIXTURE).id > 0
    assert [obstacle.name for obstacle in use.obstacles] == ["workpiece"]


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ('format = "opposable-tool"', 'format = "opposable"', "format"),
        ("version = 1", "version = 2", "version"),
        ("mass_kg = 0.05", "mass_kg = 50", "mass_kg"),
        ("mass_kg = 0.05", "mass_kg = nan", "mass_kg is nan; it should be a finite number"),
        ("mass_kg = 0.05", 'mass_kg = "light"', "mass_kg is 'light'; it should be a number"),
        ("mass_kg = 0.05", "mass = 0.05", "mass_kg is missing; mass is no field that is known"),
        ("tip = { position_m = [0, 0, 0], axis = [0, 0, -1] }", "", "tip"),
        ("axis = [0, 0, -1]", "axis = [0, 0, 0]", "its axis is zero"),
        ("size_m = [0.02, 0.02] }, {", "radius_m = -1 }, {", "radius_m"),
        ("z_m = 0.09, ", "z_m = -0.09, ", "from below upwards"),
        ("[1, 0, -2], torque_N_m = [0, 0, -0.03]", "[0, 0, 0]", "'turn' is zero"),
        ("section", 'shape = "box"\nsection', "shape and section"),
        ("position_m = [0, 0, 0]", "position_m = [0, 0, -5]", "the tip is 5.045 m from the centre"),
        ("angle_deg = 90", 'angle_deg = "90"', "angle_deg is '90'; it should be a number"),
        ("angle_deg = 90", "angle_deg = true", "angle_deg is True; it should be a number"),
        ("force_N", "force", r"needed\[turn\].force is no field"),
        ("mass_kg = 0.05", "mass_kg = 0.05\n[", "is not a TOML file"),
    ],
)
def test_what_is_wrong_with_a_tool_file_is_named(
    old: str, new: str, complaint: str, tmp_path: Path
) -> None:
    assert old in PEG
    with pytest.raises(PlannerError, match=complaint):
        read_tool(written(tmp_path, PEG.replace(old, new, 1)))


def test_a_socket_into_which_the_tip_does_not_go_is_refused(tmp_path: Path) -> None:
    """The tip is 20 mm wide; the socket has 0.3 mm to spare on each side."""
    fits = PEG.replace("angle_deg = 90", "angle_deg = 90, socket_x_m = 0.0195, socket_y_m = 0.03")
    assert use_of(read_tool(written(tmp_path, fits)))
    small = fits.replace("0.0195", "0.0193")
    with pytest.raises(ObjectError, match=r"20 x 20 mm in the lowest 5 mm.*19\.3 x 30"):
        use_of(read_tool(written(tmp_path, small)))


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ('kind = "turn"', 'kind = "saw"', "no kind of use is called 'saw'"),
        ("angle_deg = 90", "angle = 90", "kind 'turn' has angle_deg"),
        ("angle_deg = 90", "angle_deg = 0", "give 1 to 3600 degrees"),
        ("angle_deg = 90", "angle_deg = 90, stop_deg = 45", "before the end"),
        ("angle_deg = 90", "angle_deg = 90, stop_deg = -95", "give both one sign"),
        ("angle_deg = 90", "angle_deg = 90, lead_m = 1.0", "lead_m is 1.0; give -0.02"),
        ("angle_deg = 90", "angle_deg = 90, friction_N_m = 0.04", "0.03 N m at most"),
        ("angle_deg = 90", "angle_deg = -90", "with 0 N m at most; raise torque_N_m"),
        ("numbers =", "workpiece_m = [0, 1, 1]\nnumbers =", "workpiece_m"),
        ("numbers =", "workpiece_m = [100, 1, 1]\nnumbers =", "workpiece_m"),
    ],
)
def test_a_use_that_cannot_be_is_refused_before_planning(
    old: str, new: str, complaint: str, tmp_path: Path
) -> None:
    with pytest.raises(PlannerError, match=complaint):
        plan_tool("allegro_hand", read_tool(written(tmp_path, PEG.replace(old, new, 1))))


def test_an_object_without_frames_is_no_tool() -> None:
    box: Any = parse_object("box")
    with pytest.raises(PlannerError, match="no tip and no axis"):
        load_tool(box)
    with pytest.raises(PlannerError, match=r"no tool is called 'spoon'.*screwdriver"):
        load_tool("spoon")
    bare = Tool(name="bare", shape=box.shape)
    with pytest.raises(PlannerError, match="needs no wrench or has no handle"):
        use_task("allegro_hand", bare, SE3.Identity())


def test_a_wrench_beyond_a_hand_is_refused_with_the_limit_that_ends_it() -> None:
    tool = load_tool("screwdriver")
    strong = replace(tool, needed=(NeededWrench(name="twist off", torque=(0, 0, -80.0)),))
    with pytest.raises(PlannerError, match=r"'twist off'.*torque of 160 N m.*ended by A_"):
        plan_tool("allegro_hand", strong)


def test_a_grasp_that_cannot_produce_a_needed_wrench_fails_by_its_name(plan: GraspPlan) -> None:
    asked = replace(plan.task, needed_margin=60.0)
    failure = verify_grasp(asked, plan.T_world_base, plan.q, record=plan.record)
    assert isinstance(failure, Failure)
    assert failure.kind == "no_needed_wrench"
    assert "'turn the screw', 60 times" in failure.text
    assert "in the way: " in failure.text
    assert 0 <= failure.numbers["fraction"] < 1


def test_the_forces_of_a_plan_produce_its_needed_wrenches(plan: GraspPlan) -> None:
    (needed,), (found,) = plan.task.needed, plan.needed
    forces = found.contacts.forces_in_axes()
    at = plan.contacts.positions - plan.task.T_world_object.translation
    turn, times = plan.task.T_world_object.rotation, plan.task.needed_margin
    weight = plan.task.object.mass * 9.81
    assert np.allclose(forces.sum(axis=0), times * turn @ needed.force + [0, 0, weight], atol=1e-5)
    assert np.allclose(np.cross(at, forces).sum(axis=0), times * turn @ needed.torque, atol=1e-6)


def test_the_certificate_states_the_margin_and_the_file_keeps_the_needs(
    plan: GraspPlan, tmp_path: Path
) -> None:
    proven = certify(plan, max_points=20)
    bounds = proven.needed["turn the screw"]
    assert plan.task.needed_margin <= bounds.lower <= bounds.upper
    assert np.isclose(bounds.lower, needed_margin(plan), rtol=1e-3)
    assert "needed, turn the screw" in str(proven)
    assert proven.as_dict()["needed_margins"]["turn the screw"][0] == bounds.lower
    write_plan(plan, tmp_path / "plan.json")
    again = read_plan(tmp_path / "plan.json")
    assert again.task.needed == plan.task.needed
    assert again.task.needed_margin == plan.task.needed_margin
    assert len(again.needed) == 1


def test_a_search_that_finds_nothing_names_wrench_and_limit(plan: GraspPlan) -> None:
    much = replace(plan.task, needed_margin=90.0)
    with pytest.raises(NoGraspFoundError, match=r"needed wrench 'turn the screw', 90 times: .*way"):
        plan_use(much, max_attempts=6)


def test_needed_wrenches_join_the_objectives() -> None:
    plain = SynthesisOptions()
    assert needed_options((), plain) is plain
    joined = needed_options((NeededWrench(name="push", force=(0, 0, 2.0)),), plain)
    assert set(joined.weights) == {"epsilon", "task"}
    assert joined.task_wrenches == ((-0.0, -0.0, -2.0, -0.0, -0.0, -0.0),)
    task = GraspTask.create("allegro_hand", "box")
    assert task.needed == ()
    assert isinstance(task.object, GraspObject)


def test_links_of_a_grasp_for_a_use_keep_apart(plan: GraspPlan) -> None:
    assert min(c.distance for c in plan.verification.closest) >= LOADED_CLEARANCE
    near = Clearance(first="index_knuckle", second="middle_knuckle", distance=0.0002)
    touching = replace(plan.verification, closest=(*plan.verification.closest, near))
    failure = _too_near(replace(plan, verification=touching))
    assert failure is not None
    assert "index_knuckle - middle_knuckle: 0.20 mm apart" in failure.text
    assert "1.5 mm are kept" in failure.text


def test_fingers_that_follow_a_blow_keep_apart(plan: GraspPlan) -> None:
    q = followed(plan, 1e-4)
    before, after = (HandState(plan.task.hand, joints) for joints in (plan.q, q))
    contacts = plan.contacts.transformed(plan.T_world_base.inverse())
    for finger, point, normal in zip(
        plan.task.fingers, contacts.positions, contacts.normals, strict=True
    ):
        joint = finger.pad.joint_id
        moved = after.joint_pose(joint).act(before.joint_pose(joint).actInv(point)) - point
        assert moved == pytest.approx(1e-4 * normal, abs=2e-6)
    assert _too_near(plan) is None
    failure = _too_near(plan, 0.03)  # they meet where the screwdriver's handle was
    assert failure is not None
    assert "where the tool gives way by 30 mm" in failure.text


def test_a_strike_is_planned_for_fingers_that_follow(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[dict[str, Any]] = []
    monkeypatch.setattr("sim.tools.trial.plan_use", noting(asked))
    with pytest.raises(Enough):
        plan_tool("allegro_hand", "hammer")
    assert asked[0]["gives_way"] == Strike.gives_way > 0


def test_only_a_blow_is_rehearsed_and_not_where_that_is_not_wanted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[dict[str, Any]] = []
    monkeypatch.setattr("sim.tools.trial.plan_use", noting(asked))
    calls: list[tuple[str, dict[str, Any]]] = [
        ("hammer", {}),
        ("hammer", {"rehearse": False}),
        ("key", {}),
    ]
    for name, changes in calls:
        with pytest.raises(Enough):
            plan_tool("allegro_hand", name, **changes)
    assert [given["rehearse"] is not None for given in asked] == [True, False, False]


@pytest.mark.parametrize(
    ("came", "taken", "tried", "value"),
    [
        ([None, 0.9, 0.4, 0.1], 2, 3, 0.4),  # the first that is good enough
        ([0.8, None, 0.7, 0.9, 0.1], 2, 4, 0.7),  # the best of three that pass
        ([0.5, 0.2], 0, 1, 0.5),
    ],
)
def test_a_grasp_is_taken_by_how_its_rehearsal_went(
    plan: GraspPlan,
    monkeypatch: pytest.MonkeyPatch,
    came: list[float | None],
    taken: int,
    tried: int,
    value: float,
) -> None:
    found = [replace(plan, T_world_base=shifted(plan.T_world_base, [k, 0, 0])) for k in range(5)]
    made = [Attempt(index=k, plan=one, failure=None, cpu_s=0.0) for k, one in enumerate(found)]
    monkeypatch.setattr(tools, "attempts", lambda *_, **__: iter(made))
    monkeypatch.setattr(tools, "planning_time", iter(np.arange(10.0)).__next__)
    lost = Failure(kind="use_rehearsal", text="it flew away")
    asked: list[GraspPlan] = []

    def rehearse(plan: GraspPlan) -> float | Failure:
        asked.append(plan)
        share = came[len(asked) - 1]
        return lost if share is None else share

    best = plan_use(plan.task, best_of=3, rehearse=rehearse)
    assert asked == found[:tried]
    assert best.T_world_base.translation[0] == plan.T_world_base.translation[0] + taken
    assert best.record.best is not None
    assert (best.record.best.metric, best.record.best.value) == ("rehearsal", value)
    assert best.record.cpu_s == tried  # what a rehearsal takes counts as planning


def test_a_caller_may_stop_a_search_that_rehearses(
    plan: GraspPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = [Attempt(index=k, plan=replace(plan), failure=None, cpu_s=0.0) for k in range(3)]
    monkeypatch.setattr(tools, "attempts", lambda *_, **__: iter(made))
    seen: list[int] = []

    def stop(attempt: Attempt[GraspPlan]) -> bool:
        seen.append(attempt.index)
        return attempt.index == 1

    best = plan_use(plan.task, rehearse=lambda _: 0.9, progress=stop)
    assert seen == [0, 1]
    assert best.record.attempts == 2


def test_a_search_in_which_all_rehearsals_fail_says_so(
    plan: GraspPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = [Attempt(index=k, plan=plan, failure=None, cpu_s=0.0) for k in range(2)]
    monkeypatch.setattr(tools, "attempts", lambda *_, **__: iter(made))
    lost = Failure(kind="use_rehearsal", text="it flew away")
    with pytest.raises(NoGraspFoundError, match="2 attempts: 2 x it flew away"):
        plan_use(plan.task, max_attempts=2, rehearse=lambda _: lost)


class Rehearsed:
    """In place of a ``UseTrial``: the tool moves in the hand as it is told."""

    made: ClassVar[list[Any]] = []
    reason, phase = "", "use"
    slips: tuple[tuple[float, float], ...] = ((0.0, 0.0),)

    def __init__(self, movement: ManipulationPlan, **given: Any) -> None:
        """Note how it was made."""
        self.given, self.thresholds = given, USE_THRESHOLDS
        self.recorder = SimpleNamespace(every=0.01, slip=iter(self.slips).__next__)
        now: Any = SimpleNamespace(phase=self.phase, due=lambda _: True, stopped="")
        now.stop = lambda why: setattr(now, "stopped", why)
        self.simulation = now
        self.made.append(self)

    def run(self, *, on_step: Callable[[Any], None]) -> Any:
        for _ in self.slips:
            on_step(self.simulation)
        reason = "stopped" if self.simulation.stopped else self.reason
        verdict = SimpleNamespace(detail="as told")
        return SimpleNamespace(success=not reason, reason=reason, verdict=verdict)


@pytest.mark.parametrize(
    ("changes", "share", "says"),
    [
        ({}, 0.0, ""),
        ({"slips": ((1.0, 2.0), (4.0, 9.0), (6.0, 3.0))}, 0.9, ""),
        ({"slips": ((7.0, 2.0), (1.0, 1.0)), "phase": "hold"}, 0.7, ""),
        (
            {"slips": ((10.1, 1.0),)},
            None,
            r"0\.5: the tool moved by 10\.1 mm, 1\.0 degrees",
        ),
        (
            {"slips": ((1.0, 10.1),)},
            None,
            r"0\.5: the tool moved by 1\.0 mm, 10\.1 degrees",
        ),
        ({"slips": ((20.0, 9.0),), "phase": "close"}, 0.0, ""),
        ({"reason": "hand collided"}, None, r"friction 0\.5: hand collided, as told"),
    ],
)
def test_a_rehearsal_tells_how_far_the_tool_came_to_the_limits(
    plan: GraspPlan,
    monkeypatch: pytest.MonkeyPatch,
    changes: dict[str, Any],
    share: float | None,
    says: str,
) -> None:
    """With the friction that the plan relies on, whatever a later trial has."""
    monkeypatch.setattr("sim.tools.trial.UseTrial", type("Told", (Rehearsed,), changes))
    result = rehearsed(plan, load_tool("screwdriver"))
    if isinstance(result, Failure):
        assert share is None
        assert re.search(says, result.text)
    else:
        assert result == share
    assert Rehearsed.made[-1].given["physics"].mu == plan.task.mu == 0.5


def test_ctrl_c_in_a_rehearsal_ends_planning(
    plan: GraspPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "sim.tools.trial.UseTrial", type("Told", (Rehearsed,), {"reason": "interrupted"})
    )
    with pytest.raises(KeyboardInterrupt):
        rehearsed(plan, load_tool("screwdriver"))


def test_a_use_that_is_over_is_given_back_at_once(movement: ManipulationPlan) -> None:
    """Each holds 30 MB; many are rehearsed one after the other."""
    gc.collect()
    gc.disable()
    try:
        trial = UseTrial(movement)
        kept: list[Any] = [ref(trial), ref(trial.simulation), ref(trial.simulation.scene)]
        trial.run(on_step=lambda simulation: simulation.stop("seen enough"))
        del trial
        assert [one() for one in kept] == [None, None, None]
    finally:
        gc.enable()


def test_the_way_of_a_use_keeps_off_the_workpiece(plan: GraspPlan) -> None:
    assert way_blocked(plan, use_of(load_tool("screwdriver")).way(plan)) is None
    low = SE3(plan.T_world_base.rotation, plan.T_world_base.translation - [0, 0, 0.2])
    blocked = way_blocked(plan, [plan.T_world_base, low])
    assert blocked is not None
    assert "at pose 2 of 2" in blocked.text
    assert "workpiece" in blocked.text


def test_a_screw_advances_by_its_lead_and_its_friction_holds() -> None:
    use = use_of(load_tool("screwdriver"))
    spec = mujoco.MjSpec()
    spec.worldbody.add_body(name="obstacle/workpiece").add_geom(size=[0.01, 0.01, 0.01])
    PhysicsOptions().apply(spec, np.array([0, 0, -9.81]))
    use.add_fixture(spec, PhysicsOptions(), 0.0)
    model = spec.compile()
    data = mujoco.MjData(model)
    dof = model.joint(HINGE).dofadr[0]
    for torque, turns in ((0.04, False), (0.06, True)):
        data.qfrc_applied[dof] = torque
        for _ in range(200):
            mujoco.mj_step(model, data)
        angle, depth = (float(data.joint(name).qpos[0]) for name in (HINGE, SLIDE))
        assert (angle > 1.0) == turns
    assert np.isclose(depth, 0.0008 * angle / (2 * np.pi), atol=1e-4)


def test_kinds_of_use_are_registered() -> None:
    assert {"turn", "strike", "press"} <= set(USES)


@pytest.mark.slow
def test_a_key_is_turned_and_the_report_tells_it(tmp_path: Path) -> None:
    tool = load_tool("key")
    trial = UseTrial(plan_tool("shadow_hand", tool, seed=0))
    report = trial.run()
    assert report.success, report.verdict
    assert report.use is not None
    seen = trial._moment(report)
    assert seen is not None
    assert report.samples.phase[report.samples.time.tolist().index(seen)] == "use"
    turned = np.array(report.use["channels"]["angle_deg"])
    assert turned.max() > 87.0
    assert np.abs(report.use["channels"]["torque_Nm"]).max() > 0.03  # against 0.04 N m
    assert len(turned) == len(report.samples)
    write_report_of(report, tmp_path / "report.json")
    again = read_report(tmp_path / "report.json")
    assert again.use is not None
    assert again.use.kind == "turn"
    page = trial_page(again)
    assert any(again.use.summary in getattr(block, "text", "") for block in page.summary)
    scene = page.scene
    assert scene is not None
    assert {p.unit for p in scene.plots if p.title == "Angle of the socket"} == {"degrees"}


def test_the_load_before_a_use_stays_in_the_world(
    plan: GraspPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The base turns by 90 degrees in between, and the load is in its axes."""
    monkeypatch.setattr(ObjectImpedance, "step", lambda *_: np.zeros(1))
    controller = UseController(plan)
    before = np.array([1.0, 0.0, 0.0, 0.0, 0.02, 0.0])
    for phase, angle in (("use", 0.0), ("withdraw", np.pi / 2)):
        controller.law.load = before.copy()
        base = SE3(pin.exp3(np.array([0.0, 0.0, angle])), np.zeros(3))
        seen: Any = SimpleNamespace(phase=phase, T_world_base=base, altered=lambda **_: None)
        controller.step(seen)
    assert controller.law.load == pytest.approx([0.0, -1.0, 0.0, 0.02, 0.0, 0.0])


def test_of_a_guided_tool_only_the_torque_about_the_axis_is_learned(plan: GraspPlan) -> None:
    """The screwdriver needs 3 N down and -0.05 N m about the vertical, however far it is turned."""
    guided, turn = GuidedLoad(plan, share=1.0), plan.T_world_base.rotation
    around = pin.exp3(np.array([0.0, 0.0, 1.5])) @ turn
    for base in (turn, around):
        given = guided.give().reshape(2, 3) @ base.T
        assert given == pytest.approx(np.array([[0.0, 0.0, -3.0], [0.0, 0.0, -0.05]]), abs=1e-9)
    learned = np.array([[4.0, 5.0, 6.0], [0.7, 0.8, -0.09]]) @ around
    guided.take(learned.ravel())
    given = guided.give().reshape(2, 3) @ turn.T
    assert given == pytest.approx(np.array([[0.0, 0.0, -3.0], [0.0, 0.0, -0.09]]), abs=1e-9)


def pads(plan: GraspPlan, *, pressed: float, speed: float = 0.0) -> PadReading:
    """Every finger presses with ``pressed`` N and no friction; the tool slides at m/s."""
    contacts = plan.contacts.transformed(plan.T_world_base.inverse())
    force = pressed * contacts.normals
    sliding = speed * contacts.frames[:, :, 1]
    return PadReading(
        normal_force=np.full(len(force), pressed),
        force=force,
        position=contacts.positions,
        normal=contacts.normals,
        sliding=sliding,
    )


@pytest.mark.parametrize("learns", [True, False])
def test_sliding_in_a_blow_tells_no_friction(plan: GraspPlan, learns: bool) -> None:
    controller = UseController(plan, learns=learns)
    controller.schedule.touching[:], controller.schedule.share[:] = True, 1.0
    for _ in range(round(5 * ALARM_TIME / 0.002)):
        controller._tighten(0.002, pads(plan, pressed=3.0, speed=0.1))
    assert controller._grip == (GRIP_STEP if learns else 1.0)
    believed = plan.task.mu
    assert (controller._mu < believed).all() if learns else (controller._mu == believed).all()


@pytest.mark.parametrize("learns", [True, False])
def test_a_finger_off_the_tool_gives_nothing_aside(plan: GraspPlan, learns: bool) -> None:
    """Planned are 4 N and 2 N along the surface; at mu 0.5 a blow leaves half of the felt force."""
    controller = UseController(plan, learns=learns)
    controller.forces[:] = [4.0, 2.0, 0.0, 0.0]
    for felt, left in ((0.0, 0.0), (2.0, 1.0), (4.0, 2.0), (9.0, 2.0)):
        given = controller._given(pads(plan, pressed=felt))
        assert given == pytest.approx(np.tile([4.0, 2.0 if learns else left, 0.0], (len(given), 1)))


def test_a_guided_tool_is_wanted_where_it_is_across_the_axis(plan: GraspPlan) -> None:
    controller = UseController(plan, guided=True)
    turn = pin.exp3(np.array([0.3, -0.2, 0.5]))
    base = SE3(turn, np.array([0.1, 0.2, 0.3]))
    kept = pin.exp3(np.array([0.0, 0.1, 0.0]))
    controller.T_palm_wanted = SE3(kept, np.zeros(3))
    T_world_palm = base * controller._torques.T_base_palm
    moved = T_world_palm.translation + np.array([0.003, -0.001, 0.002])
    seen: Any = SimpleNamespace(T_world_base=base, T_world_object=SE3(np.eye(3), moved))
    controller._yield_to_fixture(seen, YIELDING / 2)
    wanted = controller.T_palm_wanted
    assert T_world_palm.rotation @ wanted.translation == pytest.approx([0.0015, -0.0005, 0.0])
    assert wanted.rotation == pytest.approx(kept)


@pytest.mark.slow
def test_a_lid_hardly_turns_in_the_fingertips() -> None:
    # where nothing is learned while the wrist turns it turns by 11 degrees in them
    lid = load_tool("lid")
    report = UseTrial(plan_tool("allegro_hand", lid, seed=1)).run()
    assert report.success, str(report)
    assert report.largest_slip[1] < 6.0


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_wrist_slows_down_before_the_socket_has_turned(
    sign: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    use = use_of(load_tool("key"))
    assert isinstance(use, Turn)
    use._goal = sign * np.pi
    simulation: Any = SimpleNamespace(time=0.0, timestep=0.002, T_world_base=SE3.Identity())
    use.begin(simulation, "use")
    monkeypatch.setattr("sim.tools.turn.joint_value", lambda *_: sign * use._angle)
    rates, done = [], False
    while not done:
        before, simulation.time = use._angle, simulation.time + simulation.timestep
        done = use.motion(simulation, "use", 0.0).done
        rates.append((use._angle - before) / simulation.timestep)
    assert max(rates) == pytest.approx(RATE)
    assert rates[-1] < np.deg2rad(11.5)
    assert np.max(-np.diff(rates)) < 1.5 * RATE / RAMP * simulation.timestep
    assert use._angle == pytest.approx(np.pi, abs=2 * MADE)
    assert simulation.time < use.duration


def test_the_command_refuses_bad_input(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    for words, complaint in (
        (["key", "shadow_hand"], "the hand comes first: shadow_hand key"),
        (["allegro_hand", "spoon"], "no tool is called 'spoon'"),
        (["allegro_hand", str(tmp_path / "none.toml")], "cannot read the tool file"),
        (["allegro_hand", str(written(tmp_path, PEG.replace("turn", "saw")))], "no kind of use"),
    ):
        with pytest.raises(SystemExit) as ended:
            main(["use", *words, "--out", str(tmp_path / "out")])
        assert ended.value.code == 3
        assert complaint in capsys.readouterr().err.replace("\n", " ")
    assert not (tmp_path / "out").exists()


@pytest.fixture(scope="module")
def trial(movement: ManipulationPlan) -> UseTrial:
    return UseTrial(movement, friction=2.0)


def test_a_phase_begins_where_the_hand_is(trial: UseTrial, monkeypatch: pytest.MonkeyPatch) -> None:
    simulation, carrier = trial.simulation, trial.carrier
    gantry, data = simulation.scene.gantry, simulation.data
    assert gantry is not None
    pushes = iter([None, 2.0, None])
    monkeypatch.setattr(
        trial.use,
        "motion",
        lambda *_: Motion(T_world_base=gantry.pose(data.qpos[gantry.qpos]), push=next(pushes)),
    )

    def forward() -> Any:
        still = gantry.command(data, data.qpos[gantry.qpos], np.zeros(6))
        return gantry.gains[0] * (data.ctrl[gantry.ctrl] - still)

    before = data.qpos.copy()
    data.qpos[gantry.qpos[2]] += 0.0045
    carrier.begin(data)
    carrier.drive(data, "withdraw", 0.0)
    assert np.allclose(forward(), 0.0)  # N, N m: the hand is where it is wanted
    carrier.drive(data, "use", 0.0)
    data.qpos[gantry.qpos[2]] += 1e-6
    assert np.isclose(forward()[2], -2.0, atol=0.5)
    carrier.drive(data, "use", 0.0)
    sped = forward()[2] / gantry.gains[1][2]
    assert np.isclose(sped, 1e-6 / simulation.timestep, rtol=1e-3)
    data.qpos[:] = before


def test_the_wrist_brakes_without_lag_in_a_blow(
    trial: UseTrial, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At 50 m/s2 a servo of 60 rad/s that is told the velocity alone lags by 14 mm."""
    gantry, data = trial.simulation.scene.gantry, trial.simulation.data
    assert gantry is not None
    step, carried = trial.simulation.timestep, gantry.gains[0][2] / GANTRY_FREQUENCY**2
    heights = [0.0, -50.0 * step**2]
    forces = []
    for lasting in (True, False):
        monkeypatch.setattr(type(trial.use), "lasting", lasting)
        way = iter([shifted(trial.simulation.T_world_base, [0.0, 0.0, z]) for z in heights])
        monkeypatch.setattr(trial.use, "motion", lambda *_, way=way: Motion(T_world_base=next(way)))
        trial.carrier.begin(data)
        for _ in heights:
            trial.carrier.drive(data, "withdraw", 0.0)
        forces.append(gantry.gains[0][2] * data.ctrl[gantry.ctrl[2]])
    assert forces[1] - forces[0] == pytest.approx(-50.0 * carried)


def test_a_use_ends_when_the_tool_is_gone_and_says_so(
    movement: ManipulationPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    trial = UseTrial(movement)
    assert trial._run("engage") == "nothing of the hand touches the tool"  # not yet, at the start
    assert trial.simulation.time < 0.1
    monkeypatch.setattr(Simulation, "diverged", "a speed of 1e9")
    verdict = trial.judged(0.0).verdict
    assert verdict.reason == "dropped"
    assert "in phase engage" in verdict.detail


def test_a_report_tells_what_acted_and_at_which_yaw(trial: UseTrial) -> None:
    trial.recorder.record()
    report = trial.judged(0.0)
    assert report.use is not None
    assert report.use["summary"] == "it never came to its use"
    assert (report.use["friction_factor"], report.use["yaw_rad"]) == (2.0, 0.0)
    seen = {name: np.ones(1) for name in trial.use.channels}
    assert "against 0.1 N m" in trial.use.summary(seen)


def test_blows_are_judged_by_every_time_step() -> None:
    use = Strike(load_tool("hammer"))
    use.friction, use._blows = 2.0, [_Blow(), _Blow()]
    for speed, force in ((0.5, 0.0), (0.95, 0.0), (15.0, 40.0)):
        use._blows[0].note({"speed_mps": speed, "force_N": force})
    use._blows[1].note({"speed_mps": 7.0, "force_N": 0.0})  # met nothing
    seen = {name: np.array([12.0]) for name in use.channels}
    assert use.faults(np.zeros(1), ["use"], seen | {"speed_mps": np.zeros(1)}) == []
    assert use.summary(seen).startswith("1 of 5 blows, at up to 0.95 m/s and 40 N, drove")
    assert use.summary(seen).endswith("against 40 N")


def test_a_plan_of_another_tool_place_or_number_is_none(movement: ManipulationPlan) -> None:
    tool, plan = load_tool("screwdriver"), movement.grasp
    with pytest.raises(PlannerError, match="object is not that of key"):
        UseTrial(replace(movement, tool=load_tool("key")))
    with pytest.raises(PlannerError, match="shape is not that of screwdriver"):
        UseTrial(replace(movement, tool=load_tool("screwdriver", scale=1.1)))
    stronger = replace(tool, needed=(replace(tool.needed[0], torque=(0, 0, -0.09)),))
    with pytest.raises(PlannerError, match="needed wrenches is not"):
        UseTrial(replace(movement, tool=stronger))
    shift = SE3(np.eye(3), np.array([0.0, 0.0, 0.01]))
    moved = replace(plan.task, T_world_object=shift * plan.task.T_world_object)
    with pytest.raises(PlannerError, match="where its use offers it"):
        UseTrial(replace(movement, grasp=replace(plan, task=moved)))
    turned = replace(plan.task, T_world_object=use_of(tool).offered(0.4))
    assert np.isclose(yaw_of_plan(replace(plan, task=turned), use_of(tool)), 0.4)
    for friction in (-1.0, float("nan")):
        with pytest.raises(PlannerError, match="friction is"):
            UseTrial(movement, friction=friction)
    with pytest.raises(PlannerError, match="yaw is"):
        plan_tool("allegro_hand", tool, yaw=float("nan"))
    with pytest.raises(PlannerError, match="uses no tool; give what plan_tool"):
        UseTrial(replace(movement, tool=None))
    grasp: Any = plan
    with pytest.raises(PlannerError, match="movement is"):
        UseTrial(grasp)


def test_a_movement_of_a_use_begins_with_its_grasp_and_goes_its_way(
    movement: ManipulationPlan, plan: GraspPlan
) -> None:
    """What is kept as one plan is what the use does: held throughout, through the poses checked."""
    use = movement.tool_use
    assert use is not None and movement.tool is plan.task.object
    way = use_of(load_tool("screwdriver")).way(plan)
    assert len(use.way) == len(way) == 16
    assert all(a.isApprox(b) for a, b in zip(use.way, way, strict=True))
    assert (use.finger, use.postures.shape) == ("", (0, plan.task.hand.nq))
    with pytest.raises(ValueError, match="read-only"):
        use.way[0].translation[2] = 0.0
    (stroke,) = movement.strokes
    for knot in stroke.knots:
        assert np.array_equal(knot.q, plan.q)
        assert knot.T_world_object.isApprox(plan.task.T_world_object)
        (needed,) = knot.needed
        assert needed.found  # what the screw needs is produced at every knot
    assert str(use) == "use: the hand goes through 16 poses"
    assert "screwdriver: held as it is" in str(movement)
    assert "roll, pitch, yaw" not in str(movement)
    assert repr(movement).endswith("use: the hand goes through 16 poses>")


def assert_same_tool(one: Tool | None, other: Tool | None) -> None:
    """All of it, with the mesh as files round it."""
    assert one is not None and other is not None
    for field in ("name", "mass", "touch", "needed", "use", "grip_force", "scale"):
        assert getattr(one, field) == getattr(other, field), field
    assert np.array_equal((one.tip, one.axis), (other.tip, other.axis))
    assert isinstance(one.shape, Mesh) and isinstance(other.shape, Mesh)
    assert np.allclose(one.shape.vertices, other.shape.vertices, rtol=0.0, atol=1e-12)


def test_a_file_holds_a_use_and_is_checked(movement: ManipulationPlan, tmp_path: Path) -> None:
    file = tmp_path / "plan.json"
    write_movement(movement, file)
    again = read_movement(file)
    assert_same_tool(again.tool, movement.tool)
    assert again.tool_use is not None and movement.tool_use is not None
    assert all(
        a.isApprox(b) for a, b in zip(again.tool_use.way, movement.tool_use.way, strict=True)
    )
    assert isinstance(again, ManipulationPlan)
    assert UseTrial(again).use.numbers == UseTrial(movement).use.numbers
    tested = plan_to_test(file)
    assert isinstance(tested, ManipulationPlan)
    assert_same_tool(tested.tool, movement.tool)
    assert np.array_equal(one_plan(file).q, movement.grasp.q)  # to be analysed as a grasp
    whole = json.loads(file.read_text())

    def fails(match: str, change: Callable[[dict[str, Any]], object]) -> None:
        data = json.loads(json.dumps(whole))
        change(data)
        file.write_text(json.dumps(data))
        with pytest.raises(FileFormatError, match=match):
            read_movement(file)

    fails("has a tool_use and no tool", lambda data: data.pop("tool"))
    fails(
        "without a finger that works",
        lambda d: d["tool_use"].update(q_rad=[d["grasp"]["grasp"]["q_rad"]]),
    )
    fails(
        "a way of two poses",
        lambda d: d["tool_use"].update(T_world_base=d["tool_use"]["T_world_base"][:1]),
    )
    fails("angle_rad is not what follows", lambda data: data.update(angle_rad=0.1))
    fails("cycles is not what follows", lambda data: data.update(cycles=2))
    fails("then is not what follows", lambda data: data.update(then=json.loads(json.dumps(whole))))
    fails("index does not work in a use", lambda data: data["tool_use"].update(finger="index"))

    def lowered(data: dict[str, Any]) -> None:
        data["tool_use"]["T_world_base"][4]["position_m"][2] -= 0.15  # into the workpiece

    fails("a use that fails its checks: the way of the use is not free, at pose 5 of 16", lowered)
    turned = json.loads(json.dumps(whole))
    turned["tool_use"]["T_world_base"] = turned["tool_use"]["T_world_base"][:3]
    file.write_text(json.dumps(turned))
    short = read_movement(file)  # it is free
    assert isinstance(short, ManipulationPlan)
    with pytest.raises(
        TaskError, match="the way in the plan is not that of the use of screwdriver"
    ):
        UseTrial(short)


def test_a_use_is_no_turn_in_the_hand(movement: ManipulationPlan, tmp_path: Path) -> None:
    with pytest.raises(TaskError, match="hands over or uses a tool; execute it by"):
        manipulate(movement)
    file = tmp_path / "plan.json"
    write_movement(movement, file)
    with pytest.raises(SystemExit):
        main(["manipulate", "--plan", str(file)])
    with pytest.raises(TaskError, match="hands over or uses a tool"):
        list(_of_file(file, MagicMock()))  # a source of episodes, before anything is executed


def test_its_joints_over_time_go_along_its_way(movement: ManipulationPlan) -> None:
    made = movement.joint_trajectory(rate_hz=50.0)
    assert list(dict.fromkeys(made.phases)) == ["approach", "close", "use"]
    use = movement.tool_use
    assert use is not None
    assert made.T_world_base[-1].isApprox(use.way[-1], 1e-6)
    turned = [
        float(np.linalg.norm(pin.log6(a.inverse() * b).vector[3:]))
        for a, b in pairwise(made.T_world_base)
    ]
    assert sum(turned) == pytest.approx(2 * np.pi, rel=0.01)  # a whole turn, and no more is checked
    assert max(turned) * 50.0 < 2.5  # rad/s: 1 on average, and minimum jerk has 1.875 times that


def test_the_page_of_a_use_carries_the_tool_with_the_hand(movement: ManipulationPlan) -> None:
    page = motion_page(movement)
    assert page.title == "allegro_hand uses screwdriver"
    made = movement.joint_trajectory(rate_hz=30.0)
    found = object_motion(movement, made)
    held = movement.T_world_base.inverse() * movement.task.T_world_object
    assert found.poses[-1].isApprox(made.T_world_base[-1] * held, 1e-6)
    assert found.contacts[-1] is not None


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("section", 'shape = "peg.stl"\nunused', r'give one of .*by mesh = "NAME.stl"'),
        ("mass_kg = 0.05", "mass_kg = 0.05\nscale = 2.0", "section is in metres"),
        ("z_m = 0.09", "z_m = 0.9", "the tool is 0.9 m long; tools up to 0.6 m"),
    ],
)
def test_shapes_of_tools_are_sized_or_meshes_beside_the_file(
    old: str, new: str, complaint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = PEG.replace(old, new, 1)
    text = "\n".join(line for line in text.splitlines() if not line.startswith("unused"))
    monkeypatch.chdir(tmp_path)
    with pytest.raises(PlannerError, match=complaint):
        read_tool(written(tmp_path, text))


def test_a_made_tool_takes_no_scale_and_is_compared_by_value() -> None:
    key = load_tool("key")
    with pytest.raises(PlannerError, match="key is made, and scale is 2"):
        load_tool(key, scale=2.0)
    again = load_tool("key")
    assert again is not key
    assert again == key
    assert len({key, again}) == 1
    changes: list[dict[str, Any]] = [
        {"tip": key.tip + 1e-3},
        {"needed": ()},
        {"mass": 0.1},
        {"use": None},
    ]
    for change in changes:
        assert replace(key, **change) != key
    assert key != GraspObject(name=key.name, shape=key.shape)


def test_needed_wrenches_have_names_of_their_own(plan: GraspPlan) -> None:
    with pytest.raises(PlannerError, match="'turn the screw' are there more than once"):
        replace(plan.task, needed=plan.task.needed * 2)


def test_files_say_needs_and_channels_by_their_version(plan: GraspPlan, trial: UseTrial) -> None:
    data = plan_to_dict(plan)
    without = {name: value for name, value in data["task"].items() if name != "needed"}
    wrongs: list[dict[str, Any]] = [{"version": 1}, {"version": 2}, {"task": without}]
    for wrong in wrongs:
        with pytest.raises(PlannerError, match="in versions 3 and 4"):
            plan_from_dict(data | wrong, "here")
    trial.recorder.record()
    report = trial.judged(0.0).to_dict()
    ReportFile.model_validate(report)
    use = report["use"]
    first = next(iter(use["channels"]))
    longer = use["channels"] | {first: [0.0] * 9}
    with pytest.raises(ValueError, match="have different lengths"):
        ReportFile.model_validate(report | {"use": use | {"channels": longer}})
    with pytest.raises(ValueError, match="titles and channels of the use differ: angle_deg"):
        ReportFile.model_validate(report | {"use": use | {"titles": {}}})


def test_a_hammer_is_swung_about_a_lever(plan: GraspPlan) -> None:
    use = Strike(load_tool("hammer"))
    tip = plan.contacts.positions.mean(axis=0) + np.array([0.001, 0.0, 0.1])
    above = replace(plan.task, T_world_object=use.tool.T_world_object(tip))
    wanted = r"hammer: the lever.* is (0\.\d+).*from 0.03 to 0.3"
    with pytest.raises(PlannerError, match=wanted) as refused:
        use.way(replace(plan, task=above))
    told = re.search(wanted, str(refused.value))
    assert told is not None
    assert float(told[1]) == pytest.approx(0.001)


def test_the_face_swings_about_an_elbow(plan: GraspPlan) -> None:
    use = Strike(load_tool("hammer"))
    tip = plan.contacts.positions.mean(axis=0) + np.array([0.06, 0.0, 0.0])
    task = replace(plan.task, T_world_object=use.tool.T_world_object(tip))
    way = use.way(replace(plan, task=task))
    top = np.deg2rad(use.numbers["swing_deg"])
    moved = (way[3] * way[0].inverse()).act(tip) - tip  # the hand carries the face
    assert np.linalg.norm(moved) == pytest.approx(2 * 0.3 * np.sin(top / 2))
    assert moved[2] == pytest.approx(0.3 * np.sin(top))  # upwards, and the hand hardly turns


def test_a_blow_is_fastest_where_the_nail_is_and_brakes_from_there(
    plan: GraspPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Raised by no angle the face hovers at 2 mm; it has its full speed that much lower."""
    use = Strike(load_tool("hammer"))
    tip = plan.contacts.positions.mean(axis=0) + np.array([0.06, 0.0, 0.0])
    task = replace(plan.task, T_world_object=use.tool.T_world_object(tip))
    still: Any = SimpleNamespace(
        plan=replace(plan, task=task), T_world_base=plan.T_world_base, time=0.0
    )
    use.begin(still, "engage")
    use.begin(still, "use")
    monkeypatch.setattr(strike, "joint_value", lambda *_: 0.0)
    _, axis, lever = use._grip
    low, top = HOVER / lever, np.deg2rad(use.numbers["swing_deg"])
    falls = 2 * (top + low) * lever / use.numbers["speed_m_s"]

    def angle(after: float) -> float:
        now: Any = SimpleNamespace(
            time=use._begun + after, touching=lambda: (), T_world_object=task.T_world_object
        )
        base = use._striking(now).T_world_base
        turned: float = pin.log3(base.rotation @ use._base.rotation.T) @ axis
        return turned

    assert angle(RAISE) == pytest.approx(top)
    assert angle(RAISE + falls - 1e-9) == pytest.approx(-low, abs=1e-6)
    met = RAISE + falls
    rates = [(angle(met + h) - angle(met + h - 1e-6)) / 1e-6 * lever for h in (0.0, THROUGH)]
    assert rates == pytest.approx([-use.numbers["speed_m_s"], 0.0], abs=1e-3)


def test_a_blow_begins_with_the_tool_where_it_was_over_the_nail(
    plan: GraspPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A tool that turned and slipped in the hand, which is moved as one with it: back, and down.

    The hand is commanded, and stands 1 mm below that; after the next blow nothing has changed.
    """
    use = Strike(load_tool("hammer"))
    tip = plan.contacts.positions.mean(axis=0) + np.array([0.06, 0.0, 0.0])
    task = replace(plan.task, T_world_object=use.tool.T_world_object(tip))
    sag = SE3(np.eye(3), np.array([0.0, 0.0, -0.001]))
    driven = {"now": 0.003}
    monkeypatch.setattr(strike, "joint_value", lambda *_: driven["now"])
    start: Any = SimpleNamespace(
        plan=replace(plan, task=task), T_world_base=plan.T_world_base, time=0.0
    )
    use.begin(start, "engage")
    use.begin(start, "use")
    whole = use.duration / use.numbers["blows"]

    def moved(blow: float, in_hand: SE3) -> SE3:
        """Where the tool is once the hand has aimed for a blow, if it moves as one with it."""
        command = use._base if blow == 0 else use._aimed(1.0)[0]
        now: Any = SimpleNamespace(time=blow * whole, touching=lambda: ())
        now.T_world_object = sag * command * in_hand
        use._striking(now)
        return sag * use._aimed(1.0)[0] * in_hand

    first = plan.T_world_base.inverse() * task.T_world_object
    begun = moved(0, first)
    slipped = SE3(pin.exp3(np.array([0.1, -0.05, 0.08])), np.array([0.002, -0.004, 0.001])) * first
    driven["now"] = 0.008
    for blow in (1, 2):
        over = moved(blow, slipped)
        lower = begun.translation - [0.0, 0.0, 0.005]
        assert over.translation == pytest.approx(lower, abs=2e-4)  # 1 mm of sag, turned
        assert over.rotation == pytest.approx(begun.rotation)
    assert use._aimed(1.0)[1] == pytest.approx([0.0, 0.0, -0.005])  # the elbow goes down as far
    assert use._turn.angular == pytest.approx(np.zeros(3), abs=1e-9)


@pytest.mark.parametrize(
    ("off", "turned", "follows"),
    [(0.028, 0.0, True), (0.032, 0.0, False), (0.0, 28.0, True), (0.0, 32.0, False)],
)
def test_a_hand_does_not_follow_a_tool_that_it_has_lost(
    off: float, turned: float, follows: bool
) -> None:
    """It then goes down by what the nail has gone, 4 mm, and no more."""
    use = Strike(load_tool("hammer"))
    use._held, use._drop = SE3.Identity(), np.array([0.0, 0.0, -0.004])
    lies = SE3(pin.exp3(np.radians([0.0, turned, 0.0])), np.array([off, 0.0, -0.004]))
    moved = pin.exp6(use._aim(lies, 0.004))
    if follows:
        over = moved * lies
        assert over.isApprox(SE3(np.eye(3), np.array([0.0, 0.0, -0.004])), 1e-9)
    else:
        assert moved.isApprox(SE3(np.eye(3), use._drop), 1e-12)


def test_a_nail_that_is_in_is_not_struck_again(
    plan: GraspPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """15 mm from the end of its way; before that another blow begins."""
    for left, over in ((0.014, True), (0.016, False)):
        use = Strike(load_tool("hammer"))
        tip = plan.contacts.positions.mean(axis=0) + np.array([0.06, 0.0, 0.0])
        task = replace(plan.task, T_world_object=use.tool.T_world_object(tip))
        monkeypatch.setattr(strike, "joint_value", lambda *_, use=use, left=left: use._most - left)
        now: Any = SimpleNamespace(
            plan=replace(plan, task=task), T_world_base=plan.T_world_base, time=0.0
        )
        now.T_world_object, now.touching = task.T_world_object, lambda: ()
        use.begin(now, "engage")
        use.begin(now, "use")
        assert use._striking(now).done == over
        assert (len(use._blows), use._is_in) == (0 if over else 1, over)


def test_a_hammer_is_grasped_against_blows_that_glance() -> None:
    """Beside those of the swing: the hand gives way about the handle and about the blow too."""
    hammer = load_tool("hammer")
    across = np.array([needed.force for needed in hammer.needed]) @ np.cross(hammer.axis, [0, 0, 1])
    assert sorted(np.sign(across)) == [-1, 0, 0, 1]


def test_a_contact_is_lost_later_where_blows_shake_fingers_off(
    plan: GraspPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ObjectImpedance, "step", lambda *_: np.zeros(1))
    seen: Any = SimpleNamespace(phase="engage", T_world_base=SE3.Identity(), time=0.0)
    seen.altered = lambda **_: seen
    for learns, time in ((True, LOST_TIME), (False, GONE)):
        controller = UseController(plan, learns=learns)
        controller.step(seen)
        assert controller.schedule.lost_time == time


@pytest.mark.slow
def test_a_hammer_drives_its_nail_and_stays_in_the_hand() -> None:
    hammer = load_tool("hammer")
    report = UseTrial(plan_tool("allegro_hand", hammer, seed=1)).run()
    assert report.success, str(report)
    assert report.use is not None
    assert max(report.use["channels"]["speed_mps"]) > 0.8
    nail = Strike(hammer)._most
    assert 0.01 < max(report.use["channels"]["driven_mm"]) / 1e3 < nail


def test_a_folder_of_an_earlier_use_keeps_nothing_of_it(
    movement: ManipulationPlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = replace(movement, tool=load_tool("key"))  # the grasp is of a screwdriver
    monkeypatch.setattr(UseOptions, "plan", lambda *_: other)
    (tmp_path / "report.json").write_text("{}")
    with pytest.raises(SystemExit):
        main(["use", "allegro_hand", "key", "--out", str(tmp_path)])
    assert [path.name for path in tmp_path.iterdir()] == ["plan.json"]


def test_a_use_is_told_of_less_friction_and_refused_before_it_is_planned(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def never(*_: object, **__: object) -> None:
        pytest.fail("planned")

    monkeypatch.setattr(UseOptions, "plan", never)
    with pytest.raises(SystemExit):
        main(["use", "allegro_hand", "key", "--resist", "1000"])
    assert "--resist is 1000.0; give a finite number from 0 to 100" in capsys.readouterr().err
    monkeypatch.undo()
    monkeypatch.setattr("sim.tools.trial.plan_use", never)
    with pytest.raises(SystemExit):
        main(["use", "allegro_on_arm7", "key", "--sim-mu", "0.3"])
    told = " ".join(capsys.readouterr().err.split())
    assert "--sim-mu 0.3 is less friction than is believed, --mu 0.5" in told
    assert "allegro_on_arm7 is on an arm" in told


def test_a_use_that_fails_is_not_called_not_held(movement: ManipulationPlan) -> None:
    trial = UseTrial(movement)
    report = trial.run(on_step=lambda simulation: simulation.stop("seen enough"))
    assert [(r.phase, r.reason) for r in report.results] == [
        ("stand", ""),
        ("approach", "stopped: seen enough"),
    ]
    page = trial_page(report.to_file())
    assert page.title == "allegro_hand uses screwdriver"
    assert page.verdict is not None and page.verdict.text.startswith("Not done")
    console = Console(record=True, width=200, file=io.StringIO())
    console.print(report)
    assert "not done, stopped" in console.export_text()


def test_a_use_ends_where_it_is_stopped_and_ctrl_c_is_told(
    movement: ManipulationPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    trial = UseTrial(movement)
    trial.simulation.stop("seen enough")
    assert trial._run("engage") == "stopped: seen enough"
    trial = UseTrial(movement)

    def struck(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("sim.tools.trial.run_grasp_phase", struck)
    report = trial.run()
    assert report.reason == "interrupted"
    assert [(r.phase, r.reason) for r in report.results] == [
        ("stand", ""),
        ("approach", "interrupted"),
    ]


def test_a_tool_that_too_few_fingers_feel_is_not_let_go(
    movement: ManipulationPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    trial = UseTrial(movement)
    released: list[Any] = []
    monkeypatch.setattr("sim.tools.trial.run_grasp_phase", lambda *_: True)
    monkeypatch.setattr("sim.tools.trial.why_not_lifted", lambda _: "too few feel it")
    monkeypatch.setattr(type(trial.simulation.scene), "release", lambda *_: released.append(1))
    trial.perform()
    assert [r.phase for r in trial.results][-1] == "verify"
    assert (trial.results[-1].reason, trial.not_lifted) == ("too few feel it", "too few feel it")
    assert not released


def test_each_movement_has_its_trial(movement: ManipulationPlan) -> None:
    assert trial_of(movement) is UseTrial
    assert trial_of(replace(movement, phases=movement.strokes)) is FingersTrial


def test_the_way_of_a_hammer_is_without_a_jump(plan: GraspPlan) -> None:
    use = Strike(load_tool("hammer"))
    tip = plan.contacts.positions.mean(axis=0) + np.array([0.06, 0.0, 0.0])
    task = replace(plan.task, T_world_object=use.tool.T_world_object(tip))
    way = use.way(replace(plan, task=task))
    swing = np.deg2rad(use.numbers["swing_deg"]) / 3  # from pose to pose
    steps = [float(np.linalg.norm(pin.log6(a.inverse() * b).vector[3:])) for a, b in pairwise(way)]
    assert max(steps[:-1]) == pytest.approx(swing)  # but for the last, which takes it away


def test_an_error_of_ours_in_the_check_of_a_way_is_no_failed_grasp(
    plan: GraspPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = [Attempt(index=0, plan=plan, failure=None, cpu_s=0.0)]
    monkeypatch.setattr(tools, "attempts", lambda *_, **__: iter(made))

    def refuses(*_: object) -> Any:
        raise TaskError("too far")

    with pytest.raises(NoGraspFoundError, match="1 attempts: 1 x too far"):
        plan_use(plan.task, refuses)
    monkeypatch.setattr(tools, "way_blocked", refuses)
    with pytest.raises(TaskError, match=r"^too far"):
        plan_use(plan.task, lambda plan: [plan.T_world_base])
