"""How a grasp gives way under position servos: known answers, and the same in MuJoCo."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

from planner.certify.stiffness import GraspStiffness, _tips
from planner.contacts import ContactSet
from planner.exchange.dexgraspbench import export, plan_squeeze
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.search.grasp import plan_grasp
from planner.spatial import SE3, FloatArray, rotation_angle
from planner.task import GraspTask
from planner.verification import plan_forces
from sim.protocols.dexgraspbench import (
    benchmark_contacts,
    benchmark_physics,
    dexgraspbench_cases,
)

TIP, HALF = 0.008, 0.0125
"""Radius of a fingertip and half the object's width, m."""

STIFFNESS, PRESS = 200.0, 4.0
"""Of each servo, N/m; planned force of each of two fingertips, N."""

AXES = ("x", "y", "z")


def finger(name: str, side: int) -> tuple[str, str, str]:
    """Model, actuators and description of a fingertip on three slides, each with a servo."""
    joints = [f"{name}_{axis}" for axis in AXES]
    slides = "".join(
        f'<joint name="{joint}" type="slide" axis="{axis}" range="-0.1 0.1" damping="2"/>'
        for joint, axis in zip(joints, ("1 0 0", "0 1 0", "0 0 1"), strict=True)
    )
    model = f"""<body name="{name}" pos="{side * 0.1} 0 0">{slides}
    <geom name="{name}_pad" type="sphere" size="{TIP}" mass="0.02"/>
    <site name="{name}_tip" pos="{-side * TIP} 0 0"/></body>"""
    servos = "".join(
        f'<position name="{j}" joint="{j}" kp="{STIFFNESS}" forcerange="-50 50"/>' for j in joints
    )
    description = f"""
[[fingers]]
name = "{name}"
joints = {joints}
tip_site = "{name}_tip"
[fingers.pad]
geom = "{name}_pad"
center = [0.0, 0.0, 0.0]
radius = {TIP}
axis = [{-side}.0, 0.0, 0.0]
half_angle_deg = 60.0
"""
    return model, servos, description.replace("'", '"')


@pytest.fixture(scope="module")
def tongs(tmp_path_factory: pytest.TempPathFactory) -> Hand:
    folder: Path = tmp_path_factory.mktemp("tongs")
    (left, pull, left_text), (right, push, right_text) = finger("left", -1), finger("right", 1)
    (folder / "tongs.xml").write_text(
        f"""<mujoco model="tongs"><compiler angle="radian"/><worldbody><body name="palm">
        <geom name="palm" type="box" size="0.1 0.01 0.01" pos="0 0 -0.3" mass="0.5"/>{left}{right}
        </body></worldbody><actuator>{pull}{push}</actuator></mujoco>"""
    )
    zeros = "".join(f"{n}_{axis} = 0.0\n" for n in ("left", "right") for axis in AXES)
    (folder / "hand.toml").write_text(
        f"""schema = 1
name = "tongs"
model = "tongs.xml"
summary = "two balls on slides"
source = "our own"
base_body = "palm"
palm_body = "palm"
palm_normal = [0.0, 0.0, 1.0]
wrist_joints = []
default_fingers = ["left", "right"]
allowed_contacts = []
{left_text}{right_text}
[postures.open]
{zeros}
[postures.pinch]
{zeros}
"""
    )
    return load_hand(folder / "hand.toml")


POSTURE = np.array([1.0, 0.0, 0.0, -1.0, 0.0, 0.0]) * (0.1 - HALF - TIP)
"""Both tips touch."""


def pressed(hand: Hand, label: str) -> GraspStiffness:
    """Of an object about the origin, pressed from both sides through its centre."""
    task = GraspTask.create(
        hand,
        label,
        T_world_object=SE3.Identity(),
        table_height=None,
        gravity=(0.0, 0.0, 0.0),
        grip_force=PRESS,
        contact_model="soft",
        mu_torsion=0.02,
    )
    contacts = ContactSet.from_arrays(
        [[-HALF, 0.0, 0.0], [HALF, 0.0, 0.0]],
        [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]],
        mu=task.mu,
        mu_torsion=task.mu_torsion,
        model=task.contact_model,
        fingers=task.finger_names,
    )
    forces = plan_forces(task, contacts, SE3.Identity(), POSTURE)
    assert forces.found
    np.testing.assert_allclose(forces.forces[:, 0], PRESS, rtol=1e-6)
    return GraspStiffness.of(task, forces, SE3.Identity(), POSTURE)


BALL = f"sphere:{HALF}"
SLAB = "box:0.025x0.06x0.06"
LIMITS = {BALL: STIFFNESS * (HALF + TIP), SLAB: STIFFNESS * HALF**2 / (HALF - TIP)}
"""Force (N) at which the object between two tips turns aside: 2 k R^2 of the springs against
2 f (R - A) of the levers, less what rolling moves the contacts: A = R r / (R + r) between two
balls, r on a flat side."""


@pytest.mark.parametrize("label", LIMITS)
def test_two_springs_hold_an_object_up_to_a_known_force(tongs: Hand, label: str) -> None:
    assert pressed(tongs, label).buckling * PRESS == pytest.approx(LIMITS[label], rel=0.02)


def turned_in_mujoco(label: str, force: float) -> float:
    """Angle (rad) by which MuJoCo turns an object whose tips are 0.1 mm aside, within 2 s."""
    kind, size = ("sphere", f"{HALF}") if label == BALL else ("box", f"{HALF} 0.03 0.03")
    (left, pull, _), (right, push, _) = finger("left", -1), finger("right", 1)
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><compiler angle="radian"/>
        <option timestep="0.0005" gravity="0 0 0" cone="elliptic" impratio="100"
         jacobian="dense" noslip_iterations="5"/>
        <default><geom condim="4" friction="1.5 0.02" solref="0.002 1"/></default>
        <worldbody>{left}{right}<body name="object"><freejoint/>
        <geom type="{kind}" size="{size}" mass="0.1"/></body></worldbody>
        <actuator>{pull}{push}</actuator></mujoco>"""
    )
    data = mujoco.MjData(model)
    data.qpos[:6] = POSTURE + 1e-4 * np.array([0.0, 1.0, 0.0, 0.0, -1.0, 0.0])
    data.ctrl[:] = POSTURE + force / STIFFNESS * np.array([1.0, 0.0, 0.0, -1.0, 0.0, 0.0])
    for _ in range(4000):
        mujoco.mj_step(model, data)
    return rotation_angle(data.body("object").xmat.reshape(3, 3))


@pytest.mark.parametrize("label", LIMITS)
def test_mujoco_lets_it_turn_aside_at_the_same_force(label: str) -> None:
    assert turned_in_mujoco(label, 0.8 * LIMITS[label]) < 0.1
    assert turned_in_mujoco(label, 1.25 * LIMITS[label]) > 1.0


def test_loads_hang_on_the_springs_and_a_misplaced_tip_presses_on_both(tongs: Hand) -> None:
    stiffness = pressed(tongs, BALL)
    push = np.array([[0.0, 0.0, 1.0, 0.0, 0.0, 0.0]])
    changes, _ = stiffness.under(1.0, push, 0.001)
    under, first, second = changes[:3]
    # each tip bears half, along -z; their frames differ
    np.testing.assert_allclose(np.linalg.norm(under[:, 1:3], axis=1), 0.5, rtol=1e-3)
    np.testing.assert_allclose(under[:, [0, 3]], 0.0, atol=1e-3)
    for moved in (first, second):
        np.testing.assert_allclose(moved[:, 0], 0.001 * STIFFNESS / 2, rtol=0.01)


def softened(stiffness: GraspStiffness, factor: float) -> FloatArray:
    """Eigenvalues of its matrix, in units of the springs'."""
    return np.linalg.eigvals(
        np.linalg.solve(stiffness.springs, stiffness.springs + factor * stiffness.bending)
    ).real


def test_the_matrix_of_a_real_grasp_is_singular_where_it_buckles(allegro: Hand) -> None:
    plan = plan_grasp(GraspTask.create(allegro, "ellipsoid:0.025x0.035x0.045"), seed=0)
    stiffness = GraspStiffness.of(plan.task, plan.forces, plan.T_world_base, plan.q)
    limit = stiffness.buckling
    assert 1.0 < limit < 100.0
    assert softened(stiffness, 0.99 * limit).min() > 0.0 > softened(stiffness, 1.01 * limit).min()


def test_a_squeeze_stays_off_the_force_that_turns_the_object_aside(
    allegro: Hand, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = plan_grasp(GraspTask.create(allegro, "ellipsoid:0.025x0.035x0.045"), seed=0)
    given = plan.task, plan.contacts, plan.T_world_base, plan.q
    free = plan_squeeze(*given)
    monkeypatch.setattr(GraspStiffness, "buckling", property(lambda _: 0.8))
    near = plan_squeeze(*given)
    assert near.factor < 0.8 < free.factor
    assert near.use > free.use


def slides(pressed: float, pulled: float) -> float:
    """Speed (m/s) at which a box creeps between two tips in the benchmark's contacts."""
    physics, contacts = benchmark_physics(), benchmark_contacts()
    (solref, solimp), mu = contacts.values(), f"{physics.mu} {physics.mu_torsion}"
    tip = '<geom type="sphere" size="0.008" mass="0.05"/>'
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option timestep="{physics.timestep}" gravity="0 0 0" cone="elliptic"
        impratio="{physics.impratio}" jacobian="dense" integrator="implicitfast"/>
        <default><joint type="slide" axis="1 0 0" damping="2"/><geom condim="4" friction="{mu}"
        solref="{solref[0]} 1" solimp="{" ".join(map(str, solimp[:3]))}"/></default><worldbody>
        <body pos="-0.0205 0 0"><joint/>{tip}</body><body pos="0.0205 0 0"><joint/>{tip}</body>
        <body name="object"><freejoint/><geom type="box" size="0.0125 0.03 0.03" mass="0.1"/></body>
        </worldbody></mujoco>"""
    )
    data = mujoco.MjData(model)
    data.qfrc_applied[:2] = pressed, -pressed
    data.xfrc_applied[model.body("object").id, 1] = 2.0 * pulled
    mujoco.mj_step(model, data, 300)
    before = float(data.body("object").xpos[1])
    mujoco.mj_step(model, data, 300)
    return (float(data.body("object").xpos[1]) - before) / (300 * physics.timestep)


@pytest.mark.parametrize("pulled", [1.0, 5.0])
def test_contacts_of_the_benchmark_creep_as_far_as_the_squeeze_reckons(pulled: float) -> None:
    inverse = 1.0 / 0.05 + 1.0 / 0.1  # of a tip and the box
    assert slides(10.0, pulled) == pytest.approx(export.CREEP * inverse * pulled, rel=0.05)


def twisted(force: float, torque: float, seconds: float) -> float:
    """Angle (rad) to which MuJoCo turns the slab under a torque in the benchmark's contacts."""
    physics, (solref, solimp) = benchmark_physics(), benchmark_contacts().values()
    hard, mu = solimp[1], f"{physics.mu} {physics.mu_torsion}"  # as deep as contacts are pressed
    (left, pull, _), (right, push, _) = finger("left", -1), finger("right", 1)
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><compiler angle="radian"/>
        <option timestep="{physics.timestep}" gravity="0 0 0" cone="elliptic"
        impratio="{physics.impratio}" jacobian="dense" integrator="implicitfast"/>
        <default><geom condim="4" friction="{mu}" solref="{solref[0]} 1"
        solimp="{hard} {hard} 0.001"/></default><worldbody>{left}{right}
        <body name="object"><freejoint/><geom type="box" size="{HALF} 0.03 0.03" mass="0.1"/></body>
        </worldbody><actuator>{pull}{push}</actuator></mujoco>"""
    )
    data = mujoco.MjData(model)
    data.qpos[:6] = POSTURE
    data.ctrl[:] = POSTURE + force / STIFFNESS * np.array([1.0, 0.0, 0.0, -1.0, 0.0, 0.0])
    mujoco.mj_step(model, data, 100)
    data.xfrc_applied[model.body("object").id, 5] = torque
    mujoco.mj_step(model, data, round(seconds / physics.timestep))
    return rotation_angle(data.body("object").xmat.reshape(3, 3))


@pytest.mark.parametrize("force", [0.4, 1.0, 3.0])
def test_mujoco_lets_a_loaded_object_creep_as_far_as_reckoned(tongs: Hand, force: float) -> None:
    """Friction is a damper there: a gentle grip ends where there would be none."""
    stiffness, load = pressed(tongs, SLAB), np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 2e-4]])
    inverse = 1.0 / 0.02 + 1.0 / 0.1  # of a tip and the slab
    speed = export.CREEP * inverse * np.array([1.0, 1.0, 900.0])
    factor = force / PRESS
    for seconds in (2.0, 6.0):
        slides = np.tile(seconds * speed, (2, 1))
        changes, turned = stiffness.crept(factor, load, 0.0, slides)
        np.testing.assert_allclose(np.hstack([changes[0].ravel(), turned[0]]), 0.0, atol=1e-9)
        assert twisted(force, load[0, 5], seconds) == pytest.approx(turned[1, 2], rel=0.08)
    forces, moved = stiffness.under(factor, load, 0.0)
    for known, found in zip(
        (forces, moved[:, 3:6]),
        stiffness.crept(factor, load, 0.0, np.full((2, 3), 1e-12)),
        strict=True,
    ):
        np.testing.assert_allclose(found[1:, ..., 0], known[..., 0], rtol=1e-3, atol=1e-9)


@pytest.mark.parametrize(("label", "worse"), [(BALL, True), (SLAB, False)])
def test_creeping_relaxes_friction_on_flat_faces_alone(
    tongs: Hand, label: str, worse: bool
) -> None:
    """Where a contact of a ball creeps to, the surface is turned from the force."""
    stiffness = pressed(tongs, label)
    tangential = stiffness.forces.copy()
    tangential[:, 1] = 0.2 * PRESS  # as where two fingers are not quite opposite
    bent = replace(stiffness, forces=tangential)
    loads = export.MASS * export.LOADS
    still, much = (
        export._use(bent, 0.5, loads, np.tile([c, c, 0.0], (2, 1))) for c in (1e-7, 3e-3)
    )
    assert abs(much - still) > 0.05 * still
    assert (much > still) == worse


@pytest.mark.slow
def test_small_objects_are_pressed_enough_for_the_benchmark(allegro: Hand) -> None:
    task = GraspTask.create(allegro, "ellipsoid:0.025x0.035x0.045")
    plan = plan_grasp(task, seed=0)
    assert all(case.run(plan).held for case in dexgraspbench_cases())


def test_a_pad_is_flat_along_its_reach(tongs: Hand) -> None:
    finger = tongs.fingers["left"]
    straight = replace(finger, pad=replace(finger.pad, reach=np.array([[0.0, 0.03, 0.0]])))
    task: Any = SimpleNamespace(hand=tongs, fingers=[finger, straight])
    tangents = np.tile(np.eye(3)[:, 1:], (2, 1, 1))  # along y and z
    ball, line = _tips(task, SE3.Identity(), POSTURE, tangents)
    np.testing.assert_allclose(ball, np.eye(2) / TIP, atol=1e-9)
    np.testing.assert_allclose(line, np.diag([0.0, 1.0 / TIP]), atol=1e-9)


def test_contacts_that_hardly_press_may_be_let_go(allegro: Hand) -> None:
    task = GraspTask.create(allegro, "cylinder:0.03x0.08", grasp_type="power", table_height=None)
    plan = plan_grasp(task, seed=0)
    palm = plan.task.finger_names.index("palm")
    pressed = plan.forces.forces.copy()
    pressed[:, 0] = np.maximum(pressed[:, 0], plan.task.grip_force)
    pressed[palm] = 0.0
    all_of_them, without = export._bearing(plan.task, replace(plan.forces, forces=pressed))
    assert all_of_them[0] is plan.task
    kept = [k for k in range(len(pressed)) if k != palm]
    assert without[0].finger_names == tuple(plan.task.finger_names[k] for k in kept)
    np.testing.assert_array_equal(without[1].forces, pressed[kept])
    np.testing.assert_array_equal(
        without[1].contacts.positions, plan.forces.contacts.positions[kept]
    )
