"""What a success with closure keeps clear of: collisions, forces, poses where nothing rests."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import trimesh
from conftest import of_trimesh
from manipulations import QUICK, UP, task_of, with_log
from typer.testing import CliRunner

from benchmarks.conditions import FRICTION, REGRASP_FRICTION
from benchmarks.manipulate import Turn
from planner.collision.pair_table import TABLE, lift_to_rest
from planner.collision.world import CollisionWorld
from planner.contacts import Contact, ContactSet
from planner.errors import NoGraspFoundError, TaskError
from planner.failure import Failure
from planner.motion import manipulation as search
from planner.motion.ending import find_release, object_at_target, stands
from planner.motion.manipulation import (
    ManipulationPlan,
    manipulation_task,
    on_stand,
    plan_manipulation,
)
from planner.objects import GraspObject
from planner.quality import force_closure
from planner.shapes import Box, Sphere
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask, Obstacle
from sim.cli import app
from sim.contacts import with_planned_friction
from sim.controllers import ObjectImpedance
from sim.controllers.torques import HoldingTorques
from sim.manipulation import (
    ManipulationReport,
    SuccessCriteria,
    manipulate,
    rests,
    settled,
)
from sim.manipulation.driver import ManipulationDriver, out_of_the_way
from sim.manipulation.log import finger_forces, force_limit
from sim.manipulation.machine import PhaseCall
from sim.manipulation.phases import Phases
from sim.manipulation.regrasping import margin_without
from sim.scene.physics import PhysicsOptions
from sim.verdict import Thresholds, first_collision

pytestmark = pytest.mark.usefixtures("coarse_steps")


@pytest.fixture(scope="module")
def plan() -> ManipulationPlan:
    """A turn of a block by thumb, index and middle of the Shadow-type hand; two fingers idle."""
    fingers = ("thumb", "index", "middle")
    task = task_of("box:0.06x0.06x0.08", "shadow_hand", mass=0.3, fingers=fingers)
    return plan_manipulation(task, angle=math.radians(45.0), place=(0.04, -0.02), seed=0)


@pytest.fixture(scope="module")
def report(plan: ManipulationPlan) -> ManipulationReport:
    return manipulate(plan, timeline=QUICK)


# --- collisions ---------------------------------------------------------------------------------


def test_trials_and_manipulations_have_one_bound_of_collisions() -> None:
    assert Thresholds().collision_N == SuccessCriteria().collision_N == 1.0
    time, pairs = np.array([0.0, 0.1, 0.2]), ("", "a - b", "c - d")
    assert first_collision(time, np.array([0.0, 1.0, 0.9]), pairs, 1.0) is None
    found = first_collision(time, np.array([0.0, 1.1, 5.0]), pairs, 1.0)
    assert found is not None
    assert (found.reason, found.detail, found.time) == (
        *("hand collided", "a - b with 1.1 N (up to 5.0 N later)"),
        0.1,
    )


def test_a_collision_anywhere_in_the_run_is_a_fault(
    report: ManipulationReport,
) -> None:
    assert report.success_with_closure, str(report)
    assert report.collision is None
    log = report.log
    force, names = log.collision_N.copy(), list(log.collision)
    force[5], names[5] = 2.8, "middle_distal - ring_distal"
    hit = replace(report, log=replace(log, collision_N=force, collision=tuple(names)))
    assert hit.success and not hit.success_with_closure
    assert "middle_distal - ring_distal with 2.8 N" in hit.faults
    assert "2.8 N" in str(hit).splitlines()[-1]
    assert hit.to_dict()["collision"] == "middle_distal - ring_distal with 2.8 N"
    force[5] = 0.9  # a light touch
    assert replace(report, log=replace(log, collision_N=force)).success_with_closure


def test_the_command_says_no_where_the_hand_collided(
    plan: ManipulationPlan, report: ManipulationReport, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[SuccessCriteria] = []
    made = [report]

    def execute(*_: object, criteria: SuccessCriteria, **__: object) -> ManipulationReport:
        asked.append(criteria)
        return made[-1]

    monkeypatch.setattr("planner.motion.manipulation.plan_manipulation", lambda *_, **__: plan)
    monkeypatch.setattr("sim.manipulation.manipulate", execute)
    command = ["manipulate", "shadow_hand", "box", "--max-force", "20"]
    assert CliRunner().invoke(app, command).exit_code == 0
    force = report.log.collision_N.copy()
    force[-1] = 1.5
    made.append(replace(report, log=replace(report.log, collision_N=force)))
    told = CliRunner().invoke(app, command)
    assert told.exit_code == 1 and "1.5 N" in told.stdout
    assert asked[0].normal_N == 20.0
    assert CliRunner().invoke(app, [*command[:-1], "0"]).exit_code == 3
    again = replace(report, earlier=made[-1])
    assert again.collision is not None


# --- how far it turned --------------------------------------------------------------------------


class TurnsTo:
    """A run whose object is found turned by an angle after every phase, whatever is asked."""

    def __init__(self, plan: ManipulationPlan, degrees: float) -> None:
        """Whose controller does nothing."""
        scene = SimpleNamespace(physics=PhysicsOptions())
        self.simulation = SimpleNamespace(timestep=0.002, scene=scene)
        self.driver = ManipulationDriver(plan, ObjectImpedance(plan.grasp), rate=1.0)
        moved = (math.radians(degrees), 0.0, np.zeros(3))
        self.recorder = SimpleNamespace(moved=lambda: moved)
        self.reading = SimpleNamespace(
            mark_reference=lambda: None, turned=lambda: moved[0], deviation=lambda: 0.0
        )
        self.touching_fingers = set(plan.task.finger_names)

    def run(self, *_: object, **__: object) -> str:
        return ""


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("degrees", "fault"), [(39.9, "5.1 short (at most 5)"), (40.1, ""), (50.1, ""), (75.0, "")]
)
def test_one_rule_says_in_every_phase_how_far_is_far_enough(
    plan: ManipulationPlan, sign: float, degrees: float, fault: str
) -> None:
    """45 degrees are asked for. What turns 5.1 further is as good in "turn" as in "hold"."""
    asked = replace(plan, angle=sign * plan.angle)
    run: Any = TurnsTo(plan, sign * degrees)
    phases = Phases(asked, run, QUICK, SuccessCriteria())
    assert phases.left == pytest.approx(math.radians(45.0 - degrees))
    for phase in ("turn", "hold"):
        told, _ = phases.perform(PhaseCall(phase=phase, ending=plan.ending))
        assert (fault in told) if fault else not told, (phase, told)


def test_a_turn_too_far_is_a_success_and_one_too_short_is_none(report: ManipulationReport) -> None:
    asked = math.radians(45.0)
    for turned, success in ((44.9, False), (45.0, True), (50.1, True), (75.0, True)):
        turn = np.full_like(report.log.turn, math.radians(turned))
        assert with_log(report, turn=turn).success is success
        assert with_log(replace(report, asked=-asked), turn=-turn).success is success


@pytest.mark.slow
def test_what_is_brought_back_too_far_goes_on(plan: ManipulationPlan) -> None:
    for degrees, fault in ((5.1, "5.1 short"), (4.9, ""), (-5.1, "")):
        run: Any = TurnsTo(plan, degrees)
        phases = Phases(plan, run, QUICK, SuccessCriteria())
        run.driver.reference.advance(
            0.002, SE3.Identity(), np.zeros((3, 3)), plan.grasp.q, missed=0
        )
        run.driver.begin_back = lambda: None
        told, _ = phases.perform(PhaseCall(phase="back", ending=plan.ending))
        assert (fault in told) if fault else not told, told


# --- forces -------------------------------------------------------------------------------------


def test_every_finger_reports_its_forces(report: ManipulationReport) -> None:
    for i, force in enumerate(report.forces):
        assert force.finger == report.fingers[i]
        column = report.log.normal_force[:, i]
        assert force.sustained == column.max() <= force.peak
        assert 0.0 < force.mean == pytest.approx(column[column > 0.0].mean())
        assert f"{force.finger} {force.sustained:.1f} N" in str(report)
    told = report.to_dict()
    assert [f["finger"] for f in told["forces"]] == list(report.fingers)
    assert told["numbers"]["largest_force_N"] == max(f.sustained for f in report.forces)


def test_a_finger_that_presses_harder_than_it_may_is_a_fault(
    report: ManipulationReport,
) -> None:
    force = report.log.normal_force.copy()
    force[7, 0] = report.force_limit + 1.0
    hard = replace(report, log=replace(report.log, normal_force=force))
    assert hard.success and not hard.success_with_closure
    assert f"thumb pressed with {report.force_limit + 1.0:.1f} N" in hard.faults
    empty = replace(report.log, normal_force=0.0 * force, peak_force=0.0 * force)
    assert all(f.peak == f.mean == 0.0 for f in finger_forces(empty, report.fingers))


def test_the_limit_follows_from_the_plan(
    plan: ManipulationPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And from nothing that a controller is tuned by."""
    planned = max(k.contacts.forces[:, 0].max() for k in plan.motion.knots)
    assert force_limit(plan) == pytest.approx(max(18.0, 1.875 * planned))
    for room in ("planner.motion.verify", "sim.manipulation.run"):
        monkeypatch.setattr(f"{room}.ASKED_SHARE", 0.5)  # the controller's
    assert force_limit(plan) == pytest.approx(max(18.0, 1.875 * planned))
    with pytest.raises(TaskError, match="normal_N is 0"):
        SuccessCriteria(normal_N=0.0)
    with pytest.raises(TaskError, match="largest normal force is -1"):
        ObjectImpedance(plan.motion.grasp, max_normal=-1.0)


def test_the_controller_asks_for_no_more_than_it_may(plan: ManipulationPlan) -> None:
    """With a fifth of the friction that is believed it would press as hard as its actuators can."""
    task = plan.motion.grasp.task
    heavy = replace(task, object=replace(task.object, mass=1.2))
    report = manipulate(
        plan, true_task=heavy, timeline=QUICK, criteria=SuccessCriteria(normal_N=12.0)
    )
    assert max(force.sustained for force in report.forces) < 12.0


# --- idle fingers -------------------------------------------------------------------------------


def gap(plan: ManipulationPlan, T_world_object: SE3, q: FloatArray) -> float:
    """Least distance (m) of an idle finger from thumb, index and middle."""
    task = replace(plan.motion.grasp.task, table_height=None)
    T_world_base = task.T_world_object * T_world_object.inverse() * plan.motion.T_world_base
    near = CollisionWorld(task).closest(T_world_base, q, 60)
    idle = ("ring", "little")
    return min(c.distance for c in near if c.first.startswith(idle) != c.second.startswith(idle))


def test_idle_fingers_are_led_out_of_the_way(plan: ManipulationPlan) -> None:
    motion, led = plan.motion, out_of_the_way(plan.motion)
    hand = motion.grasp.task.hand
    used = np.concatenate([f.q_index for f in motion.grasp.task.fingers])
    assert led.knots[0] is motion.knots[0]
    for before, after in zip(motion.knots[1:], led.knots[1:], strict=True):
        np.testing.assert_array_equal(after.q[used], before.q[used])
        assert (after.q >= hand.q_lower - 1e-12).all() and (after.q <= hand.q_upper + 1e-12).all()
        assert gap(plan, after.T_world_object, after.q) > 0.0025
    least = [min(gap(plan, k.T_world_object, k.q) for k in m.knots[1:]) for m in (motion, led)]
    assert least[1] > least[0]


@pytest.mark.parametrize("depth", [0.0, 0.009])
def test_idle_fingers_stay_out_of_the_table(
    plan: ManipulationPlan, monkeypatch: pytest.MonkeyPatch, depth: float
) -> None:
    """Where the hand puts the object down: one was led 9 mm into it, and pressed with 20 N."""
    seen: list[float | None] = []

    def spread(world: CollisionWorld, base: SE3, q: FloatArray) -> FloatArray:
        seen.append(world.task.table_height)
        return q

    def nearest(_: CollisionWorld, base: SE3, q: FloatArray, moving: frozenset[str]) -> Any:
        assert moving == {TABLE}
        return SimpleNamespace(distance=0.001 - depth)

    monkeypatch.setattr("sim.manipulation.driver.spread_idle", spread)
    monkeypatch.setattr(CollisionWorld, "nearest_of", nearest)
    out_of_the_way(plan.motion)
    last = plan.motion.grasp.task.table_height if depth else None
    assert seen[0] is None and seen[-1] == last
    assert len(seen) == (2 if depth else 1) * (len(plan.motion.knots) - 1)


def test_idle_fingers_follow_the_motion(plan: ManipulationPlan) -> None:
    """They stayed where they were when the turn began, though the plan has them make room."""
    grasp = plan.motion.grasp
    hand = grasp.task.hand
    torques = HoldingTorques(grasp)
    torques.move(grasp.q, np.zeros(hand.nq), np.array([0.0, 0.0, -9.81]))
    torques.latch()
    center = grasp.T_world_base.actInv(grasp.contacts.center)
    torques.touch(torques.centers, center, np.ones(3, dtype=bool))
    still, held = np.zeros((3, 3)), np.ones(3, dtype=bool)

    def commands(q: FloatArray) -> FloatArray:
        torques.aim(torques.tips_in_palm, q, np.zeros(hand.nq))
        normals = grasp.contacts.normals @ grasp.T_world_base.rotation
        return torques.commands(still, normals, held, ~held)

    first = commands(grasp.q)
    joint = hand.joint_names.index("RFJ4")
    aside = grasp.q.copy()
    aside[joint] += 0.1
    changed = np.flatnonzero(np.abs(commands(aside) - first) > 1e-9)
    assert [hand.actuation.moment[i, joint] != 0.0 for i in changed] == [True]


def test_a_hand_without_idle_fingers_keeps_its_motion(plan: ManipulationPlan) -> None:
    grasp = plan.motion.grasp
    every = replace(grasp.task, finger_names=tuple(grasp.task.hand.fingers))
    whole = replace(plan.motion, grasp=replace(grasp, task=every))
    assert out_of_the_way(whole) is whole


# --- the gate of a regrasp ----------------------------------------------------------------------


def pinched() -> ContactSet:
    """Contacts at two opposed points of a cylinder: closed by torsion alone."""
    places = [([0.03, 0.0, 0.0], "thumb"), ([-0.03, 0.0, 0.0], "index")]
    places.append(([-0.03, 0.0, 0.0], "middle"))
    return ContactSet.from_contacts(
        [
            Contact(
                position=np.array(p),
                frame=np.diag([-np.sign(p[0]), -np.sign(p[0]), 1.0]),
                model="soft",
                mu=1.0,
                mu_torsion=0.005,
                force=np.array([2.0, 0.0, 0.0, 0.0]),
                finger=f,
            )
            for p, f in places
        ],
        center=np.zeros(3),
    )


def test_a_lift_is_judged_by_what_is_believed(plan: ManipulationPlan) -> None:
    """Torsion of 5 mm that simulation has, and planning does not count on, let a finger go."""
    task = plan.motion.grasp.task
    assert force_closure(pinched()).normalised_min_weight > 0.02
    believed = with_planned_friction(pinched(), task)
    assert set(believed.models) == {"point"} and (believed.mu == task.mu).all()
    assert margin_without(pinched(), task, "ring") <= 0.0


# --- where objects rest -------------------------------------------------------------------------


def oval(x: float, y: float, z: float) -> GraspObject:
    """A mesh of an ellipsoid with these diameters, m."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.5)
    ball.apply_scale((x, y, z))
    return GraspObject(name="oval", shape=of_trimesh(ball), mass=0.1)


def lying(item: GraspObject, rotation: FloatArray) -> GraspTask:
    """On the table, turned like that, whether it stands so or not."""
    height = item.shape.support(-rotation[2])
    pose = SE3(rotation, np.array([0.0, 0.0, height]))
    task = manipulation_task("allegro_hand", item, mu=0.45)
    return replace(task, T_world_object=pose)


def test_how_far_up_an_object_rests() -> None:
    walls = [
        Obstacle(
            name=f"{side}",
            size=np.array([0.01, 0.1, 0.02]),
            T_world_obstacle=SE3(np.eye(3), np.array([0.023 * side, 0.0, 0.0])),
        )
        for side in (-1, 1)
    ]
    ball = Sphere(0.03)  # on edges 18 mm beside its middle, 10 mm up: 24 mm above them
    lift = lift_to_rest(ball, SE3(np.eye(3), np.array([0.0, 0.0, 0.03])), walls, -0.02, 0.02)
    assert lift == pytest.approx(0.004, abs=2e-6)
    low = SE3(np.eye(3), np.zeros(3))
    assert lift_to_rest(ball, low, walls, -0.01, 0.01) is None
    high = SE3(np.eye(3), np.array([0.0, 0.0, 0.2]))
    assert lift_to_rest(ball, high, walls, -0.01, 0.01) == -0.01
    assert lift_to_rest(Box((0.01, 0.01, 0.01)), low, [], -0.01, 0.01) == -0.01


def test_an_object_that_would_roll_on_its_stand_is_put_where_it_rests() -> None:
    """An oval with its long axis up by 30 degrees lies on four walls, and rolls until it rests."""
    tilted = lying(oval(0.07, 0.055, 0.055), pin.exp3(np.array([0.0, 0.5, 0.0])))
    task = settled(on_stand(tilted, 0.04))
    assert rests(task)
    off = np.arccos(
        (np.trace(task.T_world_object.rotation.T @ tilted.T_world_object.rotation) - 1) / 2
    )
    assert np.rad2deg(off) > 10.0
    again = lift_to_rest(task.object.shape, task.T_world_object, task.obstacles, -0.001, 0.001)
    assert again == pytest.approx(0.0, abs=3e-6)


def test_an_object_that_rests_stays_where_it_was_put() -> None:
    flat = lying(oval(0.055, 0.055, 0.07), np.eye(3))
    task = on_stand(flat, 0.04)
    assert settled(task) is task
    np.testing.assert_array_equal(task.T_world_object.rotation, np.eye(3))
    primitive = task_of("cylinder")
    assert settled(primitive) is primitive
    held = replace(flat, table_height=None)
    assert settled(held) is held


def test_an_object_that_falls_off_its_stand_is_refused() -> None:
    """A ball beside the middle of a post."""
    post = Obstacle(
        name="post",
        size=np.array([0.02, 0.02, 0.05]),
        T_world_obstacle=SE3(np.eye(3), np.array([0.004, 0.0, 0.025])),
    )
    task = task_of("sphere:0.03")
    above = SE3(np.eye(3), np.array([0.0, 0.0, 0.08001]))
    narrow = replace(post, size=np.array([0.002, 0.002, 0.05]))
    with pytest.raises(TaskError, match="does not stand on 'post'"):
        settled(replace(task, T_world_object=above, obstacles=(narrow,)))


def test_a_turned_object_that_lies_higher_does_not_end_the_search(plan: ManipulationPlan) -> None:
    """It was 'inside stand +y; move them apart', an error, for hundredths of a millimetre."""
    task = on_stand(lying(oval(0.056, 0.06, 0.058), np.eye(3)), 0.05)
    motion = plan.motion
    grasp = replace(
        motion.grasp,
        task=replace(
            task,
            hand=motion.grasp.task.hand,
            finger_names=motion.grasp.task.finger_names,
            wrist_q=motion.grasp.task.wrist_q,
        ),
    )
    turned = SE3(pin.exp3(math.radians(50.0) * UP), task.T_world_object.translation)
    knots = (*motion.knots[:-1], replace(motion.knots[-1], T_world_object=turned))
    again = find_release(replace(motion.with_knots(knots), grasp=grasp))
    assert not (isinstance(again, Failure) and "inside" in again.text)


def test_a_turned_object_is_put_down_where_it_lies_on_its_stand() -> None:
    task = on_stand(lying(oval(0.056, 0.06, 0.058), np.eye(3)), 0.05)
    target = object_at_target(task, UP, math.radians(45.0), None)
    again = lift_to_rest(task.object.shape, target, task.carrying, -0.001, 0.001)
    assert again == pytest.approx(0.0, abs=3e-6)
    assert target.translation[2] != pytest.approx(task.T_world_object.translation[2], abs=5e-5)
    assert stands(task, UP, math.radians(90.0), rests=rests)
    assert not stands(task, UP, math.radians(90.0)), "geometry alone does not tell"


# --- which turns are left to regrasps -----------------------------------------------------------


@pytest.mark.parametrize(("degrees", "friction"), [(140.0, FRICTION), (180.0, REGRASP_FRICTION)])
def test_a_turn_that_no_stroke_makes_has_the_conditions_of_regrasps(
    degrees: float, friction: tuple[float, float]
) -> None:
    """180 degrees had those of one stroke: 300 g, friction 0.45, and no way to lift a finger."""
    turn = Turn(
        hand="allegro_hand",
        kind="cylinder",
        number=0,
        height=0.08,
        fingers=None,
        stand=0.0,
        seed=3,
        angle=math.radians(degrees),
    )
    drawn = [replace(turn, number=k).draw().mu for k in range(60)]
    assert friction[0] <= min(drawn) < friction[0] + 0.05
    assert turn.regrasps == (friction == REGRASP_FRICTION)


@pytest.mark.slow
def test_regrasps_come_first_where_no_stroke_goes(
    plan: ManipulationPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    order: list[str] = []

    def nothing(name: str) -> Any:
        def plan_it(*_: object, **__: object) -> ManipulationPlan:
            order.append(name)
            raise NoGraspFoundError(f"no {name}", ())

        return plan_it

    task = task_of("cylinder")
    monkeypatch.setattr(search, "plan_single_stroke", nothing("stroke"))
    monkeypatch.setattr(search, "plan_regrasping", nothing("regrasps"))
    with pytest.raises(NoGraspFoundError, match=r"no stroke\. With regrasps: no regrasps"):
        plan_manipulation(task, angle=math.pi)
    assert order == ["regrasps", "stroke"]
    with pytest.raises(NoGraspFoundError, match=r"no stroke\. With regrasps: no regrasps"):
        plan_manipulation(task, angle=math.radians(140.0))
    assert order[2:] == ["stroke", "regrasps"]
    monkeypatch.setattr(search, "plan_regrasping", lambda *_, **__: plan)
    assert plan_manipulation(task, angle=math.pi) is plan
    assert len(order) == 4


@pytest.mark.parametrize(
    ("off_mm", "tilted", "told"),
    [
        (0.5, "", ""),
        (50.0, "", "50.0 mm from where it was to be moved: slid"),
        (0.5, "it tilted", "it tilted"),
        (50.0, "it tilted", "it tilted"),
    ],
)
def test_what_lies_elsewhere_than_it_was_to_be_moved_falls_short(
    off_mm: float, tilted: str, told: str
) -> None:
    """A tilt is told first."""
    phases: Any = Phases.__new__(Phases)
    phases._plan, phases._criteria = SimpleNamespace(angle=0.0), SuccessCriteria()
    phases._obstacle, phases._tilted = lambda: "slid", lambda numbers: tilted
    assert phases._shortfall({"turn_deg": 0.0, "shift_off_mm": off_mm}) == told
