"""A lever that one finger presses while the others hold: its free body, its way, its count."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest

from planner.collision.pair_table import Clearance
from planner.collision.world import CollisionWorld
from planner.errors import ObjectError, PlannerError, TaskError
from planner.failure import Failure
from planner.files.movements import movement_from_dict, movement_to_dict
from planner.hand_loading import load_hand
from planner.kinematics import HandState
from planner.motion.phase import Phase, ToolUse
from planner.motion.plan import ManipulationPlan
from planner.motion.tool_use import with_use
from planner.plan import GraspPlan
from planner.spatial import FloatArray
from planner.tools import Tool, load_tool
from sim.contacts.reading import _kind, _side
from sim.scene.build import OBJECT
from sim.scene.physics import PhysicsOptions
from sim.tools import UseTrial, plan_tool
from sim.tools.press import IN, LEVER, OUT, PRELOAD, REST, STAY, Press, PressingFinger
from sim.tools.trial import UseController, task_of_use
from sim.tools.use import use_of


def bottle(**numbers: float) -> Tool:
    """The spray bottle with other numbers of its use."""
    tool = load_tool("spray_bottle")
    assert tool.use is not None
    use = tool.use.model_copy(update={"numbers": {**tool.use.numbers, **numbers}})
    return replace(tool, use=use)


def press(**numbers: float) -> Press:
    """Its use."""
    use = use_of(bottle(**numbers))
    assert isinstance(use, Press)
    return use


@pytest.fixture(scope="module")
def movement() -> ManipulationPlan:
    return plan_tool("allegro_hand", "spray_bottle", seed=0)


@pytest.fixture(scope="module")
def plan(movement: ManipulationPlan) -> GraspPlan:
    return movement.grasp


def test_the_others_hold_and_balance_the_pressing_finger(plan: GraspPlan) -> None:
    assert plan.task.finger_names == ("thumb", "middle", "ring")
    use, pose = press(), plan.task.T_world_object
    place, normal = use._end(0.0)
    assert np.allclose(place, use.tool.tip)
    pressed = -use.numbers["force_N"] * pose.rotation @ normal  # of the finger on the tool
    at = pose.rotation @ place
    weight = plan.task.object.mass * 9.81
    (found,), times = plan.needed, plan.task.needed_margin
    forces = found.contacts.forces_in_axes()
    levers = found.contacts.positions - pose.translation
    assert np.allclose(forces.sum(axis=0) + times * pressed - [0, 0, weight], 0.0, atol=1e-5)
    torque = np.cross(levers, forces).sum(axis=0) + times * np.cross(at, pressed)
    assert np.allclose(torque, 0.0, atol=1e-6)
    load = use.finger(plan)._most.reshape(2, 3) @ plan.T_world_base.rotation.T  # world
    assert np.allclose(load[0], -pressed)
    assert np.allclose(load[1], -np.cross(at, pressed))


def test_the_finger_goes_to_the_lever_and_along_its_arc(plan: GraspPlan) -> None:
    use = press()
    way = use.finger_way(plan.task, plan.T_world_base, plan.q)
    assert not isinstance(way, Failure)
    others = [j for j in range(plan.task.hand.nq) if j not in way.finger.q_index]
    assert np.allclose(way.stroke[:, others], plan.q[others])
    assert np.allclose(way.reach[0], plan.q)
    assert np.allclose(way.reach[-1], way.stroke[0])
    base = plan.task.T_world_object.inverse() * plan.T_world_base
    for q, angle in ((way.stroke[0], 0.0), (way.stroke[-2], 0.75 * use._most)):
        place, normal = use._end(angle)
        pad = base.act(HandState(plan.task.hand, q).pad_center(way.finger))
        assert (pad - place) @ normal == pytest.approx(way.finger.pad.radius, abs=1.5e-3)
    world = CollisionWorld(plan.task)
    near = [world.between_fingers(plan.T_world_base, q, 2e-3) for q in way.reach]
    assert near == [None] * len(near)


def test_a_lever_that_cannot_be_pressed_is_told(plan: GraspPlan) -> None:
    def refused(use: Press, q: np.ndarray[Any, Any] | None = None) -> str:
        found = use.finger_way(plan.task, plan.T_world_base, plan.q if q is None else q)
        assert isinstance(found, Failure)
        return found.kind

    far = press()
    far._hinge = far._hinge + np.array([0.3, 0.0, 0.0])
    assert refused(far) == "lever_out_of_reach"
    hard = press()
    hard.numbers = {**hard.numbers, "force_N": 60.0}
    assert refused(hard) == "lever_too_hard"
    behind = press()
    behind._hinge = behind._hinge - np.array([0.012, 0.0, 0.02])  # where the others hold
    assert refused(behind) in ("lever_blocked", "lever_out_of_reach", "lever_not_faced")


def test_a_spring_holds_the_lever_off_and_its_force_is_that_of_the_file() -> None:
    use, spec = press(), mujoco.MjSpec()
    spec.worldbody.add_body(name=OBJECT).add_geom(size=[0.01, 0.01, 0.01])
    PhysicsOptions().apply(spec, np.zeros(3))
    use.add_fixture(spec, PhysicsOptions(), 0.0)
    model = spec.compile()
    data, end = mujoco.MjData(model), 0.035
    reached = []
    for force in (0.7 * PRELOAD * 2.0, 2.1):
        data.qfrc_applied[model.joint(LEVER).dofadr[0]] = force * end
        for _ in range(2000):
            mujoco.mj_step(model, data)
        reached.append(1e3 * end * np.sin(float(data.joint(LEVER).qpos[0])))
    assert reached[0] == pytest.approx(0.0, abs=0.2)
    assert reached[1] == pytest.approx(6.0, abs=0.3)


def test_a_lever_without_resistance_has_no_spring() -> None:
    use, spec = press(), mujoco.MjSpec()
    spec.worldbody.add_body(name=OBJECT).add_geom(size=[0.01, 0.01, 0.01])
    use.friction = 0.0
    use.add_fixture(spec, PhysicsOptions(), 0.0)
    model = spec.compile()
    assert float(model.joint(LEVER).stiffness.sum()) == 0.0


def test_presses_are_counted_down_and_up() -> None:
    use = press(presses=3.0)
    stroke = np.array([0.0, 6.0, 2.0, 6.0, 0.0, 4.0, 0.0, 5.0, 1.0])  # 2.0 is not up, 4.0 not down
    assert use._pressed(stroke) == 2
    seen = {name: stroke for name in use.channels}
    (fault,) = use.faults(np.arange(9.0), ["use"] * 9, seen)
    assert fault[1] == "use not done"
    assert "2 of 3 times" in fault[2]
    assert press(presses=2.0).faults(np.arange(9.0), ["use"] * 9, seen) == []


def test_a_press_goes_down_stays_and_comes_up(plan: GraspPlan) -> None:
    finger = press().finger(plan)
    times = (0.0, IN + STAY / 2, IN + STAY + OUT + REST / 2, 2 * IN + STAY + OUT + REST)
    assert [finger.share(t) for t in times] == pytest.approx([0.0, 1.0, 0.0, 1.0])


def test_the_finger_presses_with_the_torque_of_the_force(
    plan: GraspPlan, movement: ManipulationPlan
) -> None:
    use = press()
    way = use.finger_way(plan.task, plan.T_world_base, plan.q)
    assert not isinstance(way, Failure)
    # the force's work in a small motion of the joints is the torque's
    normal = plan.task.T_world_object.rotation @ use._end(use._most)[1]
    q, small = way.stroke[-1], 1e-6 * np.arange(1.0, 1.0 + plan.task.hand.nq)
    pads = [HandState(plan.task.hand, at).pad_center(way.finger) for at in (q - small, q + small)]
    moved = plan.T_world_base.rotation @ (pads[1] - pads[0])
    work = -use.numbers["force_N"] * float(normal @ moved)
    assert float(way.torque @ (2 * small)) == pytest.approx(work, rel=1e-3)
    # and its drives get it while the lever is down, and before not
    seen = UseTrial(movement).simulation.observe("use", 0.0)
    told = []
    for torque in (way.torque, 0.0 * way.torque):
        finger = PressingFinger(plan, replace(way, torque=torque), np.zeros(6))
        told.append([finger.step(seen.altered(time=t)) for t in (0.0, IN + STAY / 2)])
    more = np.array(told[0]) - told[1]
    actuation, still = plan.task.hand.actuation, np.zeros(plan.task.hand.nq)
    pressing = actuation.commands(seen.q, still, way.torque)
    assert np.abs(more[0]).max() < 1e-9
    assert np.allclose(more[1], pressing - actuation.commands(seen.q, still, still), atol=1e-9)
    assert np.abs(more[1]).max() > 1e-3


def test_the_others_are_told_what_the_press_asks_of_them(
    plan: GraspPlan, movement: ManipulationPlan
) -> None:
    finger = press().finger(plan)
    controller = UseController(plan, learns=False, finger=finger)
    seen = UseTrial(movement).simulation.observe("use", 0.0)
    loads = []
    for t in (0.0, IN + STAY / 2, IN + STAY + OUT + REST / 2):
        controller.step(seen.altered(time=t))
        loads.append(controller.law.load.copy())
    assert np.linalg.norm(finger._most[:3]) == pytest.approx(2.0)
    assert np.allclose(loads[1] - loads[0], finger._most)
    assert np.allclose(loads[2], loads[0])


def test_each_posture_of_the_stroke_is_checked(
    plan: GraspPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    use = press()
    checked = {}

    def blocked(_: Any, __: Any, ___: Any, way: np.ndarray[Any, Any], angle: float) -> None:
        checked[round(angle / use._most, 3)] = way[-1]

    monkeypatch.setattr(use, "_blocked", blocked)
    found = use.finger_way(plan.task, plan.T_world_base, plan.q)
    assert not isinstance(found, Failure)
    assert list(checked) == [0.0, 0.25, 0.5, 0.75, 1.0]
    assert np.array_equal(list(checked.values()), found.stroke)


def test_the_hand_may_be_loaded_and_the_pressing_finger_does_not_hold() -> None:
    hand, tool = load_hand("allegro_hand"), bottle()
    assert task_of_use(hand, tool)[0].finger_names == ("thumb", "middle", "ring")
    named, _ = task_of_use(hand, tool, fingers=["ring", "thumb", "middle"])
    assert named.finger_names == ("ring", "thumb", "middle")
    with pytest.raises(TaskError, match="fingers has index, which presses the lever of spray_bo"):
        task_of_use(hand, tool, fingers=["thumb", "index"])
    thumb = replace(hand, fingers={"thumb": hand.fingers["thumb"]})
    with pytest.raises(TaskError, match="has no finger but thumb to press the lever"):
        task_of_use(thumb, tool)


def test_a_lever_that_would_be_on_the_wrong_side_is_refused() -> None:
    with pytest.raises(ObjectError, match=r"tip.axis is \[.*1.0\]; give \[0, 0, -1\]"):
        use_of(replace(bottle(), axis=np.array([0.0, 0.0, 1.0])))


def test_a_hand_on_a_part_of_the_object_has_not_collided(movement: ManipulationPlan) -> None:
    trial = UseTrial(movement)
    scene = trial.simulation.scene
    lever = int(scene.model.body_geomadr[scene.model.body(LEVER).id])
    assert _kind({"hand", _side(scene, lever)}) is None
    block = int(scene.model.body_geomadr[scene.model.body("obstacle/workpiece").id])
    assert _kind({"hand", _side(scene, block)}) == "hand-obstacle"


@pytest.mark.parametrize(
    ("numbers", "complaint"),
    [
        ({"force_N": 3.0}, r"does not balance the press; give one, with force_N = \[3.0, 0.0, 0.0"),
        ({"presses": 0.0}, "use.numbers.presses is 0.0; give 1 to 200"),
        ({"stroke_m": 0.019}, "give a longer lever"),
    ],
)
def test_a_lever_that_cannot_be_is_refused(numbers: dict[str, float], complaint: str) -> None:
    with pytest.raises(PlannerError, match=complaint):
        press(**numbers)


def test_the_bottle_stands_above_its_block_at_any_size() -> None:
    for scale in (0.9, 1.1):
        use = use_of(load_tool("spray_bottle", scale=scale))
        pose = use.offered(0.3)
        corners = pose.act(np.zeros(3)) + use.tool.shape.vertices @ pose.rotation.T  # type: ignore[attr-defined]
        assert corners[:, 2].min() == pytest.approx(0.06 + 0.02)


@pytest.mark.slow
def test_a_finger_presses_a_lever_while_the_others_hold(movement: ManipulationPlan) -> None:
    report = UseTrial(replace(movement, tool=bottle(presses=3.0))).run()
    assert report.success, str(report)
    assert report.use is not None
    assert "3 of 3 times" in report.use["summary"]
    assert max(report.use["channels"]["force_N"]) > 1.8
    assert max(report.use["channels"]["stray_N"]) == 0.0
    assert report.largest_slip[0] < 3.0


def test_the_plan_has_the_finger_s_way_and_a_file_keeps_it(
    movement: ManipulationPlan, plan: GraspPlan
) -> None:
    use = movement.tool_use
    assert use is not None
    way = press().finger_way(plan.task, plan.T_world_base, plan.q)
    assert not isinstance(way, Failure)
    assert use.finger == "index"
    assert np.array_equal(use.postures[0], plan.q)
    assert np.array_equal(use.postures[-1], way.stroke[-1])
    assert len(use.postures) == len(way.reach) + len(way.stroke) - 1
    data = json.loads(json.dumps(movement_to_dict(movement)))
    again = movement_from_dict(data, "a file").tool_use
    assert again is not None
    assert np.allclose(again.postures, use.postures, atol=1e-9)
    made = movement.joint_trajectory()
    assert list(dict.fromkeys(made.phases)) == ["approach", "close", "use", "withdraw"]
    assert np.allclose(made.positions[-1], plan.q)
    pressed = [q for q, phase in zip(made.positions, made.phases, strict=True) if phase == "use"]
    assert np.allclose(pressed[-1], way.stroke[-1])


def test_a_grasp_tells_no_distances_of_the_lever_that_its_task_has_not(
    plan: GraspPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file of one whose pad was 0.4 mm from the lever was refused when it was read."""
    near = Clearance(first="index_pad", second=LEVER, distance=4e-4)
    with_lever = replace(plan, verification=replace(plan.verification, closest=(near,)))
    monkeypatch.setattr("sim.tools.press.verify_grasp", lambda *_, **__: with_lever)
    found = press().fit(replace(plan, task=replace(plan.task, needed=())), plan.task)
    assert not isinstance(found, Failure)
    assert near not in found.verification.closest
    assert len(found.verification.closest) > 1


def test_a_finger_s_way_is_that_of_its_tool_and_grasp(movement: ManipulationPlan) -> None:
    use = movement.tool_use
    assert use is not None
    others: tuple[ToolUse, ...] = (
        replace(use, finger="thumb"),
        replace(use, postures=use.postures[:-1]),
        replace(use, postures=use.postures + 1e-3),
    )
    for other in others:
        phases: tuple[Phase, ...] = (*movement.strokes, other)
        with pytest.raises(TaskError, match="is not that of the use of spray_bottle"):
            UseTrial(replace(movement, phases=phases))


def test_a_finger_s_way_is_checked_by_the_planner(
    movement: ManipulationPlan, plan: GraspPlan
) -> None:
    use, hand = movement.tool_use, plan.task.hand
    assert use is not None
    index = hand.fingers["index"].q_index

    def failure(postures: FloatArray, finger: str = "index") -> str:
        found = with_use(plan, replace(use, postures=postures, finger=finger))
        return "" if not isinstance(found, Failure) else found.text

    assert failure(use.postures) == ""
    assert "does not begin at the grasp" in failure(use.postures[1:])
    assert "does not begin at the grasp" in failure(np.zeros((0, hand.nq)))
    others = use.postures.copy()
    others[-1, hand.fingers["ring"].q_index] += 0.01
    assert "moves other joints too" in failure(others)
    beyond = use.postures.copy()
    beyond[-1, index] = hand.q_upper[index] + 0.1
    assert "index is beyond a limit by 0.1 rad" in failure(beyond)
    curled = use.postures.copy()
    curled[-1, index[1:]] = hand.q_upper[index[1:]]
    assert "index is not free on its way" in failure(curled)
    with pytest.raises(TaskError, match=r"ring does not work in a use, .* free are index"):
        failure(use.postures, "ring")
