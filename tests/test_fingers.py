"""A tool turned in its fixture by the fingers alone: plan, verifier, machine, errors."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from planner.collision.world import Clearance, CollisionWorld
from planner.errors import FileFormatError, PlannerError
from planner.failure import Failure
from planner.files import read_manipulation, write_manipulation
from planner.files.movements import movement_from_dict, movement_to_dict
from planner.motion import tool_gait
from planner.motion.phase import Knot
from planner.motion.plan import ManipulationPlan, MovementPlan
from planner.motion.regrasp import FingerPaths
from planner.motion.tool_gait import handle_cylinder, posture_blocked, verify_tool_gait
from planner.motion.verify import MovementVerifier, Waypoint
from planner.objects import NeededWrench, TouchRegion
from planner.pages.blocks import Facts
from planner.pages.motion_page import motion_page
from planner.shapes import Cylinder, Mesh
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask
from planner.tools import Tool, load_tool
from sim.cli import main
from sim.manipulation.machine import StateMachine
from sim.tools import FingersTrial, UseTimeline, UseTrial, plan_fingers, plan_tool, use_tool
from sim.tools.fingers import standing
from sim.tools.trial import task_of_use
from sim.verdict import Verdict


def screwdriver(angle_deg: float = 720.0) -> Tool:
    """The screwdriver, turned by another angle."""
    tool = load_tool("screwdriver")
    assert tool.use is not None
    numbers = {**tool.use.numbers, "angle_deg": angle_deg}
    return replace(tool, use=tool.use.model_copy(update={"numbers": numbers}))


@pytest.fixture(scope="module")
def gait() -> ManipulationPlan:
    return plan_fingers("allegro_hand", screwdriver(40.0), seed=0)


def test_every_knot_produces_the_needed_wrench_and_bears_the_weight(
    gait: ManipulationPlan,
) -> None:
    (needed,), times = gait.task.needed, gait.task.needed_margin
    weight = gait.task.object.mass * 9.81
    knots = [knot for stroke in gait.strokes for knot in stroke.knots]
    assert gait.cycles >= 2
    assert len(knots) > gait.cycles
    for knot in knots:
        (found,) = knot.needed
        forces, turn = found.contacts.forces_in_axes(), knot.T_world_object.rotation
        at = knot.contacts.positions - knot.T_world_object.translation
        wanted = times * turn @ needed.force + [0, 0, weight]
        assert np.allclose(forces.sum(axis=0), wanted, atol=1e-5)
        torque = np.cross(at, forces).sum(axis=0)
        assert np.allclose(torque, times * turn @ needed.torque, atol=1e-6)
        assert torque[2] == pytest.approx(-2 * 0.05, abs=1e-6)  # with the turn, which is clockwise
    assert gait.path.angle < 0


def judged(gait: ManipulationPlan, needed: NeededWrench) -> tuple[Knot, ...] | Failure:
    """The knots of a gait, judged again for another needed wrench."""
    task = replace(gait.task, needed=(needed,))
    waypoints = [
        Waypoint(
            path_parameter=k.path_parameter,
            T_object_base=k.T_world_object.inverse() * gait.T_world_base,
            q=k.q,
        )
        for k in gait.knots
    ]
    verifier = MovementVerifier(task)
    return verifier.verify_knots(gait.T_world_base, waypoints, gait.path, gait.path_tolerance)


def test_knots_that_cannot_produce_a_needed_wrench_are_refused(gait: ManipulationPlan) -> None:
    (needed,) = gait.task.needed
    assert not isinstance(judged(gait, needed), Failure)
    much = replace(needed, torque=(0.0, 0.0, -0.6))
    refused = judged(gait, much)
    assert isinstance(refused, Failure)
    assert refused.kind == "no_needed_wrench"
    assert "of the path" in refused.text


def test_a_needed_wrench_turns_with_the_object(gait: ManipulationPlan) -> None:
    across = NeededWrench(name="across", force=(1.0, 0.0, 0.0))
    knots = judged(gait, across)
    assert isinstance(knots, tuple)
    forces = [k.needed[0].contacts.forces_in_axes().sum(axis=0)[:2] for k in knots]
    first, last = forces[0], forces[-1]
    turned = np.arctan2(last[1], last[0]) - np.arctan2(first[1], first[0])
    assert turned == pytest.approx(gait.path.angle, abs=1e-3)


def test_a_torque_of_the_other_sign_takes_other_forces(gait: ManipulationPlan) -> None:
    (needed,) = gait.task.needed
    knots = judged(gait, replace(needed, torque=(0.0, 0.0, 0.05)))
    assert isinstance(knots, tuple)
    for knot in knots:
        forces = knot.needed[0].contacts.forces_in_axes()
        at = knot.contacts.positions - knot.T_world_object.translation
        assert np.cross(at, forces).sum(axis=0)[2] == pytest.approx(0.1, abs=1e-6)


def test_a_gait_of_a_tool_is_written_and_judged_again(
    gait: ManipulationPlan, tmp_path: Path
) -> None:
    write_manipulation(gait, tmp_path / "plan.json")
    again = read_manipulation(tmp_path / "plan.json")
    assert again.cycles == gait.cycles
    assert again.task.needed == gait.task.needed
    assert np.allclose(
        again.knots[1].needed[0].contacts.forces, gait.knots[1].needed[0].contacts.forces, atol=1e-3
    )


def test_postures_are_checked_against_the_true_tool_and_its_workpiece(
    gait: ManipulationPlan,
) -> None:
    task = replace(gait.task, object=standing(screwdriver()))
    assert posture_blocked(gait, task) is None
    block = task.obstacles[0]
    at = gait.T_world_base.translation + np.array([0.0, 0.0, 0.02])
    higher = replace(block, T_world_obstacle=SE3(np.eye(3), at), name="in the way")
    blocked = posture_blocked(gait, replace(task, obstacles=(higher,)))
    assert blocked is not None
    assert "in the way" in blocked.text


def test_fingers_keep_2_mm_from_each_other_on_every_swing(
    gait: ManipulationPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    task = replace(gait.task, object=standing(screwdriver()))
    world = CollisionWorld(task)
    postures = [q for move in gait.regrasps for q in move.postures]
    assert [world.between_fingers(gait.T_world_base, q, 2e-3) for q in postures] == [None] * len(
        postures
    )
    nearest = min(nearest_fingers(world, gait, q).distance for q in postures)
    monkeypatch.setattr("planner.motion.tool_gait.LOADED_ROOM", nearest + 1e-4)
    blocked = posture_blocked(gait, task)
    assert blocked is not None
    assert "fingers that bear the use yield" in blocked.text


def nearest_fingers(world: CollisionWorld, gait: ManipulationPlan, q: FloatArray) -> Clearance:
    """The nearest links of two fingers in a posture."""
    found = world.between_fingers(gait.T_world_base, q, 1.0)
    assert found is not None
    return found


def test_a_swing_past_a_neighbour_is_refused_under_load(gait: ManipulationPlan) -> None:
    lifted = replace(gait.task, table_height=None, obstacles=())
    move, base = gait.regrasps[0], gait.knots[-1].T_world_object.inverse() * gait.T_world_base
    finger = lifted.hand.fingers[move.finger]
    paths = FingerPaths(lifted)
    assert paths.verify(finger, base, move.postures) is None
    paths._apart = 0.06
    refused = paths.verify(finger, base, move.postures)
    assert refused is not None
    assert refused.kind == "swing_crowded"
    assert FingerPaths(replace(lifted, needed=()))._apart == 0.0


def test_idle_fingers_stay_where_swings_were_verified(
    gait: ManipulationPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Moved by 20 degrees, an idle ring finger was 2.6 mm within the little finger's swing."""
    moved = SimpleNamespace(T_palm_wanted=None)
    monkeypatch.setattr("sim.manipulation.driver.out_of_the_way", lambda plan: moved)
    assert FingersTrial(gait).sim.driver._motion is gait


def test_a_handle_that_is_round_is_planned_for_as_a_cylinder() -> None:
    tool = screwdriver()
    shape = handle_cylinder(tool).shape
    assert isinstance(shape, Cylinder)
    assert shape.radius == pytest.approx(0.015)
    assert shape.height / 2 == pytest.approx(0.175 + tool.tip[2], abs=1e-6)  # its top


def test_a_bar_with_corners_equally_far_from_its_axis_is_not_round() -> None:
    """A square of 30 mm across its corners is 21 mm thick between them."""
    corners = trimesh.creation.box(extents=(0.03 / np.sqrt(2), 0.03 / np.sqrt(2), 0.09))
    tool = screwdriver()
    bar = Mesh.from_triangles(corners.vertices, corners.faces, name="bar")
    assert len(bar.vertices) == 8
    with pytest.raises(PlannerError, match=r"handle of screwdriver is 10.6 to 15.0 mm from"):
        handle_cylinder(replace(tool, shape=bar, touch=TouchRegion()))


def test_a_gait_is_used_with_its_own_tool_and_timeline(gait: ManipulationPlan) -> None:
    thicker = load_tool("screwdriver", scale=1.2)
    with pytest.raises(PlannerError, match="strokes are of a screwdriver with other handle sizes"):
        FingersTrial(replace(gait, tool=thicker))
    for other in (replace(gait, tool=None), plan_tool("allegro_hand", "key", seed=0)):
        with pytest.raises(PlannerError, match="is no gait of a tool; give what plan_fingers"):
            FingersTrial(other)
    with pytest.raises(PlannerError, match="give no timeline"):
        FingersTrial(gait, timeline=UseTimeline())


def test_a_phase_that_fails_ends_a_use_by_fingers(
    gait: ManipulationPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Though nothing was dropped and nothing slipped."""
    trial = FingersTrial(gait)
    monkeypatch.setattr(trial._phases, "perform", lambda call: ("it did not close", {}))
    monkeypatch.setattr(UseTrial, "_verdict", lambda *_: Verdict())
    verdict = trial.run().verdict
    assert verdict.fault is not None and verdict.fault.reason == "use not done"
    assert "stand : it did not close" in verdict.fault.detail


@pytest.mark.parametrize(
    ("hand", "tool", "complaint"),
    [
        ("allegro_hand", "hammer", r"hammer is for 'strike', which takes the whole hand"),
        ("allegro_hand", "key", r"the handle of key is 7.0 to 16.6 mm from its axis; .*round"),
        ("allegro_on_arm7", "screwdriver", "is on an arm"),
    ],
)
def test_what_fingers_cannot_use_is_named(hand: str, tool: str, complaint: str) -> None:
    with pytest.raises(PlannerError, match=complaint):
        plan_fingers(hand, tool)


def test_what_drives_a_tool_is_wrist_or_fingers(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    with pytest.raises(PlannerError, match=r"no way to drive a tool is called 'foot'"):
        use_tool("allegro_hand", "screwdriver", by="foot")  # type: ignore[arg-type]
    with pytest.raises(SystemExit) as ended:
        main(["use", "allegro_hand", "hammer", "--by", "fingers", "--out", str(tmp_path / "out")])
    assert ended.value.code == 3
    assert "takes the whole hand" in capsys.readouterr().err.replace("\n", " ")


def test_joints_and_page_of_strokes_leave_the_tool_in_its_fixture(gait: ManipulationPlan) -> None:
    made = gait.joint_trajectory()
    phases = list(dict.fromkeys(made.phases))
    assert phases[:3] == ["approach", "close", "stroke 1"] and phases[-1].startswith("stroke")
    held = [b for b, p in zip(made.T_world_base, made.phases, strict=True) if p != "approach"]
    assert all(base.isApprox(gait.T_world_base, 1e-9) for base in held)
    page = motion_page(gait)
    assert page.subtitle is not None and page.subtitle.endswith("in its fixture")
    assert "put down" not in str(gait) and "degrees, in its fixture" in str(gait)
    told = [row[0] for block in page.summary if isinstance(block, Facts) for row in block.rows]
    assert "knots" in told and not {"put down at", "held at last at"} & set(told)


def test_strokes_are_checked_against_all_of_their_tool(
    gait: ManipulationPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert gait.tool is not None
    assert verify_tool_gait(gait) is None
    stronger = replace(gait.tool.needed[0], torque=(0.0, 0.0, -0.2))
    other = verify_tool_gait(replace(gait, tool=replace(gait.tool, needed=(stronger,))))
    assert other is not None and "other needed wrenches" in other.text
    seen: list[str] = []

    def blocked(_: MovementPlan, task: GraspTask) -> Failure:
        seen.append(task.object.shape.spec)
        return Failure(kind="use_collision", text="in the way")

    monkeypatch.setattr(tool_gait, "posture_blocked", blocked)
    found = verify_tool_gait(gait)
    assert found is not None and found.text == "in the way"
    assert seen == [gait.tool.shape.spec]  # the tool, not the cylinder that was planned for


def test_a_file_holds_a_gait_with_its_tool_and_is_checked(gait: ManipulationPlan) -> None:
    data = json.loads(json.dumps(movement_to_dict(gait)))
    again = movement_from_dict(data, "a file")
    assert isinstance(again, ManipulationPlan)
    assert again.tool is not None and gait.tool is not None
    assert isinstance(again.tool.shape, Mesh) and isinstance(gait.tool.shape, Mesh)
    assert np.allclose(again.tool.shape.vertices, gait.tool.shape.vertices, rtol=0.0, atol=1e-12)
    assert (again.tool.use, again.tool.needed) == (gait.tool.use, gait.tool.needed)
    assert FingersTrial(again)._goal == FingersTrial(gait)._goal
    thicker = load_tool("screwdriver", scale=1.2)
    other = json.loads(json.dumps(movement_to_dict(replace(gait, tool=thicker))))
    with pytest.raises(
        FileFormatError, match="strokes are of a screwdriver with other handle sizes"
    ):
        movement_from_dict(other, "a file")


def test_a_tool_in_its_fixture_is_neither_lifted_nor_put_down(gait: ManipulationPlan) -> None:
    trial = FingersTrial(gait)
    trial._goal = 0.0  # turned as far as asked after one stroke
    machine = StateMachine(gait, trial, retry=True)
    phases = []
    while (call := machine.next) is not None:
        phases.append(call.phase)
        machine.passed()
    assert phases == ["stand", "approach", "close", "squeeze", "verify", "turn", "hold"]
    assert machine.complete


@pytest.mark.slow
def test_fingers_turn_a_screw_by_strokes_and_regrasps(gait: ManipulationPlan) -> None:
    report = FingersTrial(gait).run()
    assert report.success, str(report)
    assert report.use is not None
    angle = np.array(report.use["channels"]["angle_deg"])
    used = np.array([phase == "use" for phase in report.samples.phase])
    assert angle[used][-1] > 37.0
    assert np.array(report.use["channels"]["depth_mm"])[used].min() > 3.0
    assert np.abs(report.use["channels"]["torque_Nm"]).max() > 0.045  # against 0.05 N m
    assert np.nanmax(report.samples.slip_deg[used]) < 10.0
    fewest = (report.samples.contacts[used] > 0).sum(axis=1).min()
    assert fewest == 3  # a finger moved on


def test_all_sets_of_fingers_are_searched_with_long_strokes_then_with_short_ones() -> None:
    task, _ = task_of_use("shadow_hand", standing(load_tool("screwdriver")))
    searches = [(one.finger_names, strokes) for one, strokes in tool_gait._searches(task)]
    first, second = searches[:4], searches[4:8]
    assert len({names for names, _ in first}) == 4 and [n for n, _ in second] == [
        n for n, _ in first
    ]
    assert np.mean(first[0][1]) > np.mean(second[0][1])
    assert len({s for _, s in first}) == len({s for _, s in second}) == 1
    assert searches[8] == first[0] and len(searches) == tool_gait.SEARCHES
