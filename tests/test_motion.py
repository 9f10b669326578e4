"""Motions of an object in the hand: the path, rolling, derivatives, known ranges, the verdict."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from planner.collision.world import CollisionWorld
from planner.contacts import ContactSet
from planner.errors import FileFormatError, NoGraspFoundError, TaskError
from planner.failure import Failure
from planner.files import read_motion, write_json, write_motion
from planner.files.movements import movement_to_dict
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.kinematics import HandState
from planner.motion import MotionPlan, ObjectPath, motion_attempts, plan_motion
from planner.motion.context import finger_sets, on_opposed_sides, with_rolling_pads
from planner.motion.path import ATTITUDES
from planner.motion.phase import Knot
from planner.motion.problem import JOINT_ROOM, MotionProblem, build_motion_problem
from planner.motion.residuals import MotionResiduals
from planner.motion.search import MOTION_OPTIONS
from planner.motion.solve import MotionSolver, what_limits
from planner.motion.terms import (
    BEARING,
    INSCRIBED,
    LOAD,
    MOST_LOAD,
    MOST_PLANNED,
    MOTION_TERMS,
    REACH,
    STRONG,
    SWING,
    Stance,
    StanceRows,
    load_function,
    load_parameters,
    pivoting_function,
    rolling_function,
    slips,
    swing_rows,
)
from planner.motion.trajectory import interpolate_rolling
from planner.motion.unknowns import SHARE, placement
from planner.motion.verify import MovementVerifier, Waypoint
from planner.objects import parse_object
from planner.quality import analyse, force_closure
from planner.spatial import SE3, FloatArray, skew
from planner.synthesis.mesh_surface import surface_of
from planner.synthesis.objectives import driving
from planner.synthesis.problem import Start
from planner.synthesis.seeds.draw import Seeder
from planner.synthesis.symbols import mrp_numeric, obstacles_in_object
from planner.synthesis.terms.standard import BALANCE, CONE
from planner.task import GraspTask, Obstacle
from planner.tolerances import CLOSURE_EDGES, CLOSURE_MARGIN, FRICTION_SHARE, SWING_SHARE
from planner.verification import contacts_at, plan_forces, verify_geometry

UP = np.array([0.0, 0.0, 1.0])

HINGE = 0.5
"""Range (rad, either way) of the hinges of the turning hand."""


def write_turning_hand(folder: Path) -> Path:
    """Three fingers that turn about one vertical axis and press towards it: a range on paper.

    Each has a hinge on that axis and a slide along its radius. A cylinder on the axis can be
    turned as far as the hinges go, and no further: a tip that turns with the object does not roll.
    """
    bodies, actuators, fingers = "", "", ""
    names = [f"finger{k + 1}" for k in range(3)]
    for k, name in enumerate(names):
        turn = 2 * math.pi * k / 3
        bodies += f"""
    <body name="{name}_arm" quat="{math.cos(turn / 2)} 0 0 {math.sin(turn / 2)}">
      <joint name="{name}_turn" axis="0 0 1" range="{-HINGE} {HINGE}" damping="0.1"/>
      <geom name="{name}_arm" type="sphere" size="0.004" pos="0.01 0 0" mass="0.02"/>
      <body name="{name}_leg" pos="0.055 0 -0.005">
        <joint name="{name}_press" type="slide" axis="-1 0 0" range="-0.03 0.03" damping="1"/>
        <geom name="{name}_leg" type="capsule" size="0.005" fromto="0 0 0 0 0 -0.06" mass="0.03"/>
        <geom name="{name}_tip" type="sphere" size="0.01" pos="0 0 -0.08" mass="0.01"/>
        <site name="{name}_tip" pos="0 0 -0.08"/>
      </body>
    </body>"""
        for joint, span, force in (("turn", HINGE, 1.0), ("press", 0.03, 20.0)):
            actuators += f"""
    <position name="{name}_{joint}" joint="{name}_{joint}" kp="{100 if joint == "turn" else 5000}"
      ctrlrange="{-span} {span}" forcerange="{-force} {force}"/>"""
        fingers += f"""
[[fingers]]
name = "{name}"
joints = ["{name}_turn", "{name}_press"]
tip_site = "{name}_tip"
[fingers.pad]
geom = "{name}_tip"
center = [0.0, 0.0, -0.08]
radius = 0.01
axis = [-1.0, 0.0, 0.0]
half_angle_deg = 50.0
"""
    (folder / "turning.xml").write_text(
        f"""<mujoco model="turning"><compiler angle="radian" autolimits="true"/><worldbody>
  <body name="palm"><geom name="palm" type="cylinder" size="0.05 0.005" pos="0 0 0.015" mass="0.3"/>
  {bodies}</body></worldbody><actuator>{actuators}</actuator></mujoco>"""
    )
    postures = ""
    for posture, press in (("open", -0.02), ("pinch", 0.012)):
        postures += f"[postures.{posture}]\n"
        postures += "".join(f"{name}_press = {press}\n" for name in names)
    path = folder / "turning.toml"
    path.write_text(
        f"""schema = 1
name = "turning"
model = "turning.xml"
base_body = "palm"
palm_body = "palm"
palm_normal = [0.0, 0.0, -1.0]
default_fingers = {names}
{fingers}
{postures}"""
    )
    return path


@pytest.fixture(scope="module")
def turning(tmp_path_factory: pytest.TempPathFactory) -> GraspTask:
    hand = load_hand(write_turning_hand(tmp_path_factory.mktemp("turning")))
    return GraspTask.create(hand, "cylinder:0.03x0.08", mu=0.8, grip_force=2.0)


def from_above(task: GraspTask) -> Start:
    """The turning hand upright around its cylinder, all contacts 10 mm under its middle."""
    seeder = Seeder(task)
    q = np.array([0.0, 0.015] * 3)
    turns = 2 * np.pi * np.arange(3) / 3
    outward = np.stack([np.cos(turns), np.sin(turns), np.zeros(3)], axis=1)
    points = 0.03 * outward - 0.01 * UP
    side = next(p for p in seeder.surface.patches(task.object.shape) if "side" in p.name)
    return Start(
        T_object_base=SE3(np.eye(3), np.array([0.0, 0.0, 0.075])),
        q=q,
        points=points,
        forces=-outward,
        patches=(side,) * 3,
        frozen=np.zeros(6, dtype=bool),
    )


def solver_of(task: GraspTask, path: ObjectPath, rounds: int = 0) -> MotionSolver:
    return MotionSolver(
        problem_of(task.hand, 4),
        task,
        path,
        MOTION_OPTIONS,
        path_tolerance=0.01,
        posture=Seeder(task).posture,
        rounds=rounds,
    )


@cache
def problem_of(hand: Hand, n_knots: int) -> MotionProblem:
    fingers = [hand.fingers[name] for name in list(hand.fingers)[:3]]
    shape = GraspTask.create(hand, "cylinder:0.03x0.1").object.shape
    return build_motion_problem(hand, fingers, shape, n_knots)


@pytest.fixture(scope="module")
def ninety(allegro: Hand) -> MotionPlan:
    task = GraspTask.create(allegro, "cylinder:0.03x0.1", fingers=["thumb", "index", "middle"])
    return plan_motion(task, angle=np.pi / 2)


def test_a_path_turns_and_moves_in_world_axes() -> None:
    path = ObjectPath(axis=np.array([0.0, 0.0, 2.0]), angle=np.pi / 2, shift=np.array([0, 0, 0.1]))
    start = SE3(pin.utils.rpyToMatrix(0.0, 0.3, 0.0), np.array([1.0, 2.0, 3.0]))
    end = path.pose(start, 1.0)
    assert np.allclose(end.translation, [1.0, 2.0, 3.1])
    assert np.allclose(end.rotation @ start.rotation.T, [[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    half = path.cut(0.5).pose(start, 1.0)
    assert np.allclose(half.homogeneous, path.pose(start, 0.5).homogeneous)
    assert str(path) == "90.0 degrees about (0, 0, 1) and (0.0, 0.0, 100.0) mm"


@pytest.mark.parametrize(
    ("axis", "angle", "shift", "words"),
    [
        ([0, 0, 0], 1.0, [0, 0, 0], "axis is"),
        ([0, 0, 1], 4.0, [0, 0, 0], "at most a half turn"),
        ([0, 0, 1], 0.0, [0, 0, 0], "give an angle or a shift"),
        ([0, 0, 1], 1.0, [0, np.nan, 0], "shift holds NaN"),
    ],
)
def test_a_path_that_cannot_be_is_refused(
    axis: list[float], angle: float, shift: list[float], words: str
) -> None:
    with pytest.raises(TaskError, match=words):
        ObjectPath(axis=np.array(axis), angle=angle, shift=np.array(shift))


def test_the_base_seen_from_the_object_is_that_of_poses_in_the_world() -> None:
    rng = np.random.default_rng(3)
    reference = pin.exp3(rng.normal(size=3))
    s, t, offset = rng.normal(0, 0.2, 3), rng.normal(0, 0.1, 3), rng.normal(0, 0.01, 3)
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    shift, angle, share = rng.normal(0, 0.02, 3), 1.4, 0.7
    T_middle_base = SE3(reference @ mrp_numeric(s), t)
    T_start_middle = SE3(pin.exp3(0.5 * share * angle * axis), np.zeros(3))
    for place in (0.0, 0.3, 1.0):
        y = np.concatenate([s, t, [share], offset])
        at, _ = placement()(y, reference.ravel(order="F"), axis, angle, shift, place)
        found = at.full().ravel()
        path = ObjectPath(axis=axis, angle=angle, shift=shift).cut(share)
        T_start_object = path.pose(SE3.Identity(), place)
        T_start_object.translation += T_start_middle.rotation @ offset
        expected = T_start_object.inverse() * T_start_middle * T_middle_base
        assert np.allclose(reference @ mrp_numeric(found[:3]), expected.rotation, atol=1e-12)
        assert np.allclose(found[3:], expected.translation, atol=1e-12)


def test_a_tip_that_rolls_around_a_cylinder_does_not_slide(turning: GraspTask) -> None:
    """On paper: a ball of radius r that rolls by b around one of radius a turns by b (a + r) / r.

    The whole hand is turned with the tip.
    """
    hand, finger = turning.hand, turning.fingers[0]
    a, r, b = 0.03, finger.pad.radius, 0.08
    q = np.array([0.0, 0.015] * 3)
    center = HandState(hand, q).pad_center(finger)
    bases, normals = [], []
    for angle in (0.0, b):
        normal = np.array([np.cos(angle), np.sin(angle), 0.0])
        turn = pin.exp3(angle * (a + r) / r * UP)
        bases.append(SE3(turn, (a + r) * normal - turn @ center))
        normals.append(np.tile(normal, (3, 1)))
    rolled = slips(hand, (finger,), (bases[0], bases[1]), (q, q), (normals[0], normals[1]))
    assert rolled[0] < 2e-6
    turned = SE3(pin.exp3(0.05 * UP) @ bases[1].rotation, np.zeros(3))
    turned.translation = bases[1].act(center) - turned.rotation @ center
    slid = slips(hand, (finger,), (bases[0], turned), (q, q), (normals[0], normals[1]))
    assert slid[0] == pytest.approx(0.05 * r, rel=0.01)


def test_rolling_by_casadi_is_rolling_by_pinocchio(allegro: Hand) -> None:
    rng = np.random.default_rng(5)
    fingers = tuple(allegro.fingers.values())[:3]
    reference = pin.exp3(rng.normal(size=3))
    q = (allegro.q_lower + allegro.q_upper) / 2
    x0: list[float] = []
    x1: list[float] = []
    poses, outward = [], []
    for out in (x0, x1):
        s, t = rng.normal(0, 0.05, 3), rng.normal(0, 0.01, 3)
        moved = q + rng.normal(0, 0.05, len(q))
        base = SE3(reference @ mrp_numeric(s), t)
        state = HandState(allegro, moved)
        centers = np.array([base.act(state.pad_center(f)) for f in fingers])
        normals = rng.normal(size=(3, 3)) * 0.1 + UP
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        radii = np.array([f.pad.radius for f in fingers])
        points = centers - radii[:, None] * normals
        out += [*s, *t, *moved, *points.ravel(), *np.zeros(9)]
        poses.append(base)
        outward.append(normals)
    found, _ = rolling_function(allegro, fingers)(x0, x1, reference.ravel(order="F"))
    by_casadi = np.linalg.norm(found.full().reshape(3, 3), axis=1)
    n = allegro.nq
    postures = np.array(x0)[6 : 6 + n], np.array(x1)[6 : 6 + n]
    by_pinocchio = slips(allegro, fingers, (poses[0], poses[1]), postures, (outward[0], outward[1]))
    assert by_pinocchio.min() > 1e-4
    assert np.allclose(by_casadi, by_pinocchio, rtol=1e-3)
    pivots = pivoting_function(allegro, fingers)(x0, x1, reference.ravel(order="F"))[0].full()
    tips = [
        [base.rotation @ HandState(allegro, q).joint_pose(f.pad.joint_id).rotation for f in fingers]
        for base, q in zip(poses, postures, strict=True)
    ]
    for i in range(3):
        normal = outward[0][i] + outward[1][i]
        turn = pin.log3(tips[1][i] @ tips[0][i].T)
        about = float(turn @ normal / np.linalg.norm(normal))
        assert pivots[i, 0] == pytest.approx(about, abs=2e-3)


@pytest.mark.parametrize("stances", [(), (Stance(swinging=0, knots=(-1, 0, 1)),)])
def test_derivatives_of_all_residuals_by_finite_differences(
    allegro: Hand, stances: tuple[Stance, ...]
) -> None:
    task = GraspTask.create(allegro, "cylinder:0.03x0.1", fingers=["thumb", "index", "middle"])
    path = ObjectPath(axis=np.array([0.2, 0.0, 1.0]), angle=2.0, shift=np.array([0.0, 0.01, 0.01]))
    problem = replace(problem_of(allegro, 3), stances=stances)
    seeder = Seeder(task)
    start = seeder.draw(np.random.default_rng(0))
    assert isinstance(start, Start)
    numbers = problem.numbers(task, path, start, seeder.posture, MOTION_OPTIONS, 0.002)
    residuals = MotionResiduals(problem, numbers, None)
    residuals.pull = REACH.weight
    rng = np.random.default_rng(1)
    z = problem.first(start)
    z += 0.01 * rng.normal(size=len(z))
    z[SHARE] = 0.4
    value, blocks = residuals(z)
    value, jacobian, rows = value.copy(), blocks.dense(), residuals.row_names()
    normal, slope = blocks.normal_equations()
    assert np.allclose(normal, jacobian.T @ jacobian, rtol=1e-12, atol=1e-9)
    assert np.allclose(slope, jacobian.T @ value, rtol=1e-12, atol=1e-9)
    counted = Counter(row.term.name for row in rows)
    assert counted["path"] and counted["rolling"] and counted["object"] + counted["table"]
    equal = counted["swing_balance"] + counted["swing_level"]
    assert equal == 7 * len(stances)
    step = 1e-6
    compared = 0
    for i in range(len(z)):
        e = step * np.eye(len(z))[i]
        more, less = residuals(z + e)[0].copy(), residuals(z - e)[0].copy()
        if len(more) != len(value) or len(less) != len(value):
            continue  # a row began to count
        slope = (more - less) / (2 * step)
        scale = max(1.0, float(np.abs(slope).max()))
        assert np.abs(slope - jacobian[:, i]).max() <= 2e-5 * scale, i
        compared += 1
    assert compared > 0.9 * len(z)


def test_loads_are_those_of_forces_that_bear_the_weight(allegro: Hand) -> None:
    task = GraspTask.create(allegro, "box:0.06x0.06x0.08", fingers=["thumb", "index", "middle"])
    path = ObjectPath(axis=UP, angle=1.0, shift=np.zeros(3))
    seeder = Seeder(task)
    start = seeder.draw(np.random.default_rng(0))
    assert isinstance(start, Start)
    u = problem_of(allegro, 3).unknowns.grasp
    places = np.linspace(0.0, 1.0, 3)
    parameters = load_parameters(task, path, places, start.q)
    assert np.allclose(parameters, parameters[0])  # about the vertical the weight stays where it is
    inward = start.forces / np.linalg.norm(start.forces, axis=1, keepdims=True)
    forces = np.array([2.0, 1.0, 1.0])[:, None] * inward
    state = HandState(allegro, start.q)
    pads = np.array([start.T_object_base.act(state.pad_center(f)) for f in task.fingers])
    radii = np.array([f.pad.radius for f in task.fingers])[:, None]
    points = pads + radii * inward  # where the pads would touch faces that they press on
    turn = start.T_object_base.rotation
    x = np.concatenate(
        [np.zeros(3), start.T_object_base.translation, start.q, points.ravel(), forces.ravel()]
    )
    assert len(x) == u.size
    out = load_function(allegro, task.fingers)(x, turn.ravel(order="F"), parameters[0])[0]
    used = driving(allegro, task.fingers)
    loads = MOST_LOAD - out.full().ravel()[: len(used)] / LOAD.weight
    weight = task.object.mass * task.gravity
    length = task.object.shape.bounding_radius
    grasp = np.hstack([np.vstack([np.eye(3), skew(p) / length]) for p in points])
    bearing = (np.linalg.pinv(grasp) @ np.concatenate([-weight, np.zeros(3)])).reshape(-1, 3)
    carry = np.linalg.norm(weight) / (0.8 * task.mu * 3)
    pressed = max(task.grip_force, carry) * forces + bearing
    torque = np.zeros(allegro.nq)
    for f, point, force in zip(task.fingers, points, pressed, strict=True):
        at = start.T_object_base.actInv(point)
        torque += state.point_jacobian(f.pad.joint_id, at)[:3].T @ (turn.T @ force)
    by_hand = np.abs(torque[f_index(allegro, used)]) / 0.7  # every joint has one motor of 0.7 N m
    assert np.allclose(loads, by_hand, rtol=1e-3, atol=1e-3)
    strong = out.full().ravel()[-3:]
    assert not strong.any()  # palm down no force is too large
    up = load_parameters(task, replace(path, attitude=ATTITUDES["up"]), places, start.q)
    out = load_function(allegro, task.fingers)(x, turn.ravel(order="F"), up[0])[0].full().ravel()
    pressed = max(task.grip_force, carry) * forces - bearing  # the weight is the other way
    normals = np.einsum("ij,ij->i", pressed, inward)
    assert np.allclose(MOST_PLANNED * (1.0 - out[-3:] / STRONG.weight), normals, atol=1e-3)
    share = FRICTION_SHARE * INSCRIBED * task.mu
    aside = np.linalg.norm(pressed - normals[:, None] * inward, axis=1)
    margins = (share * normals - aside) / max(task.grip_force, carry)
    assert np.allclose(out[-6:-3] / BEARING.weight, margins, atol=1e-3)


def f_index(hand: Hand, used: Any) -> Any:
    """Joints that actuators drive, one each."""
    return np.argmax(np.abs(hand.actuation.moment[used]), axis=1)


def test_starts_on_a_box_oppose_one_face_to_its_opposite(allegro: Hand) -> None:
    task = GraspTask.create(allegro, "box:0.06x0.06x0.08", fingers=["thumb", "index", "middle"])
    seeder = Seeder(task)
    for seed in range(8):
        drawn = seeder.draw(np.random.default_rng(seed))
        assert isinstance(drawn, Start)
        start = on_opposed_sides(drawn, seeder)
        codes = np.array([patch.code for patch in start.patches])
        assert np.array_equal(codes[1], -codes[0]) and np.array_equal(codes[2], -codes[0])
        assert np.allclose(start.forces[0] / np.linalg.norm(start.forces[0]), -codes[0])


def test_pads_are_wide_for_faces_and_balls_alone(allegro: Hand) -> None:
    block = GraspTask.create(allegro, "box:0.06x0.06x0.08")
    wide = with_rolling_pads(block)
    assert wide.hand.rolls and wide.hand.digest != allegro.digest
    pads = [(f.pad, allegro.fingers[n].pad) for n, f in wide.hand.fingers.items()]
    assert all(new.half_angle > old.half_angle for new, old in pads)
    assert wide.hand.rolling is wide.hand and with_rolling_pads(wide) is wide
    assert with_rolling_pads(GraspTask.create(allegro, "sphere:0.03")).hand.rolls
    round_one = GraspTask.create(allegro, "cylinder:0.03x0.08")
    assert with_rolling_pads(round_one) is round_one


def test_tips_turn_with_a_ball_instead_of_pivoting(allegro: Hand) -> None:
    # without a cost of pivoting the same start ends with 17, 46 and 42 degrees
    task = GraspTask.create(allegro, "sphere:0.03", mu=0.45, fingers=["thumb", "index", "middle"])
    path = ObjectPath(axis=UP, angle=np.deg2rad(95.0), shift=np.zeros(3))
    (attempt,) = itertools.islice(motion_attempts(task, path, path_tolerance=0.03, seed=1), 1)
    motion = attempt.plan
    assert motion is not None, attempt.failure
    fingers = motion.grasp.task.fingers
    pivoted, turned = np.zeros(3), np.zeros(3)
    for before, after in pairwise(motion.knots):
        for i, finger in enumerate(fingers):
            old, new = (
                k.T_world_object.rotation.T
                @ motion.T_world_base.rotation
                @ HandState(allegro, k.q).joint_pose(finger.pad.joint_id).rotation
                for k in (before, after)
            )
            turn = pin.log3(new @ old.T)
            pivoted[i] += abs(turn @ before.T_world_object.rotation.T @ before.contacts.normals[i])
            turned[i] += np.linalg.norm(turn)
    assert np.rad2deg(pivoted).max() < 8.0
    assert np.rad2deg(turned).max() > 30.0, "tips roll over the ball all the same"


def test_forces_of_a_hold_balance_where_each_contact_is_seen_by_the_hand() -> None:
    # three contacts at 0, 120 and 240 degrees, of which the second is told in the frame of an
    # object that has turned by 40 degrees and gone up by 10 mm since
    shape = parse_object("cylinder:0.03x0.1").shape
    surface = surface_of(shape)
    shares, shift = np.array([0.0, 0.5, 0.0]), np.array([0.0, 0.0, 0.02])
    path = (UP, np.deg2rad(80.0), shift)
    angles = 2 * np.pi * np.arange(3) / 3
    outward = np.stack([np.cos(angles), np.sin(angles), np.zeros(3)], axis=1)
    points = 0.03 * outward
    points[1] = pin.exp3(-0.5 * path[1] * UP) @ (points[1] - 0.5 * shift)
    side = next(p for p in surface.patches(shape) if "side" in p.name)
    p = {"size": surface.size(shape), "mu": np.array([0.5]), "length": np.array([0.05])}
    rows = StanceRows(surface, 3)
    values, slopes, which = rows(points, -outward, shares, path, p, np.array([side.code] * 3))
    assert np.allclose(values, 0.0, atol=1e-12) and slopes.shape == (7, 21)
    assert which.tolist() == list(range(7))
    tilted = -outward + 0.6 * UP  # outside the cones, and not in balance
    values, _, _ = rows(points, tilted, shares, path, p, np.array([side.code] * 3))
    assert values[2] == pytest.approx(BALANCE.weight * 1.8)
    cone = CONE.weight * ((SWING_SHARE * 0.5) ** 2 - 0.36)
    assert np.allclose(values[7:], cone)


def test_rows_are_told_in_their_order_with_their_units(allegro: Hand) -> None:
    task = GraspTask.create(allegro, "cylinder:0.03x0.1", fingers=["thumb", "index", "middle"])
    path = ObjectPath(axis=UP, angle=1.0, shift=np.zeros(3))
    problem, seeder = problem_of(allegro, 3), Seeder(task)
    start = seeder.draw(np.random.default_rng(0))
    assert isinstance(start, Start)
    numbers = problem.numbers(task, path, start, seeder.posture, MOTION_OPTIONS, 0.002)
    residuals = MotionResiduals(problem, numbers, None)
    z = problem.first(start) + 0.01 * np.random.default_rng(2).normal(size=problem.unknowns.size)
    z[SHARE] = 0.3
    r, _ = residuals(z)
    rows = residuals.row_names()
    assert len(rows) == len(r)
    assert sum(not row.term.role.is_cost for row in rows) == residuals.n_terms
    for value, row in zip(r, rows, strict=True):
        assert not row.term.role.one_sided or value < 0
    base, u = SE3(numbers.reference, np.zeros(3)), problem.unknowns.grasp
    for k, x in enumerate(residuals.grasps(z)):
        state = HandState(allegro, u.q(x))
        for finger, point in zip(task.fingers, u.points(x), strict=True):
            outward = np.array([point[0], point[1], 0.0]) / 0.03  # the first side of the cylinder
            gap = u.pose(x, base).act(state.pad_center(finger)) - point - 0.012 * outward
            told = [
                value / row.term.weight
                for value, row in zip(r, rows, strict=True)
                if (str(row), row.knot) == (f"touch of {finger.name}", k)
            ]
            assert np.allclose(told, gap, atol=1e-9)


def test_what_is_printed_of_a_motion_is_what_is_solved(allegro: Hand) -> None:
    """All rows that count at any place are among those printed, and all of equalities and costs."""
    task = GraspTask.create(allegro, "cylinder:0.03x0.1", fingers=["thumb", "index", "middle"])
    path = ObjectPath(axis=UP, angle=1.0, shift=np.array([0.0, 0.0, 0.01]))
    problem = replace(problem_of(allegro, 3), stances=(Stance(swinging=0, knots=(-1, 0, 1)),))
    seeder = Seeder(task)
    start = seeder.draw(np.random.default_rng(0))
    assert isinstance(start, Start)
    numbers = problem.numbers(task, path, start, seeder.posture, MOTION_OPTIONS, 0.002)
    residuals = MotionResiduals(problem, replace(numbers, pivoting_costs=True), None)
    residuals.pull = REACH.weight
    printed = {(w.term.name, row.number, row.knot) for w in problem.terms for row in w.rows}
    always = {
        (w.term.name, row.number, row.knot)
        for w in problem.terms
        if not w.term.role.one_sided
        for row in w.rows
    }
    rng, seen = np.random.default_rng(2), set[tuple[str, int, int]]()
    for size in (0.0, 0.01, 0.1, 0.3):
        residuals(problem.first(start) + size * rng.normal(size=problem.unknowns.size))
        names = [(row.term.name, row.number, row.knot) for row in residuals.row_names()]
        assert len(set(names)) == len(names)
        assert always <= set(names) <= printed
        seen |= set(names)
    over = replace(path, attitude=ATTITUDES["up"])  # where forces have a largest
    numbers = problem.numbers(task, over, start, seeder.posture, MOTION_OPTIONS, 0.002)
    residuals = MotionResiduals(problem, replace(numbers, pivoting_costs=True), None)
    residuals(problem.first(start) + 0.3 * rng.normal(size=problem.unknowns.size))
    names = [(row.term.name, row.number, row.knot) for row in residuals.row_names()]
    assert set(names) <= printed
    seen |= set(names)
    assert {term.name for term in MOTION_TERMS} <= {name for name, _, _ in seen}
    text = str(problem)
    for w in problem.terms:
        assert f"{w.term.name:14s} {len(w.rows):5d}  {w.term.role.value}" in text


def test_the_turning_hand_turns_as_far_as_its_hinges_and_says_so(turning: GraspTask) -> None:
    """On paper: both ways HINGE, less the room that joints keep.

    If all six ends gave way by a degree, three at the start and three at the end, the path were
    longer by two.
    """
    path = ObjectPath(axis=UP, angle=np.pi, shift=np.zeros(3))
    solver = solver_of(turning, path)
    paper = 2 * (HINGE - JOINT_ROOM)
    candidate = next(solver.maximise_path(from_above(turning)))
    assert 0.9 * paper < candidate.path_parameter * np.pi <= paper * 1.001
    first = candidate.limits[0]
    assert first.joint.endswith("_turn") and "limit" in first.what
    hinges = [limit for limit in candidate.limits if limit.joint.endswith("_turn")]
    assert len(hinges) == 6
    assert sum(limit.gain for limit in hinges) * 180 == pytest.approx(2.0, abs=0.01)


@pytest.mark.parametrize(("share", "reached"), [(0.95, True), (1.2, False)])
def test_the_turning_hand_reaches_what_its_hinges_allow(
    turning: GraspTask, share: float, reached: bool
) -> None:
    angle = share * 2 * (HINGE - JOINT_ROOM)
    path = ObjectPath(axis=UP, angle=angle, shift=np.zeros(3))
    candidate = next(solver_of(turning, path).solve_path(from_above(turning)))
    assert (candidate.worst < 0.1) == reached


def test_rounds_on_closure_make_another_motion_of_it(turning: GraspTask) -> None:
    path = ObjectPath(axis=UP, angle=0.3, shift=np.zeros(3))
    plain, worked = solver_of(turning, path, rounds=1).solve_path(from_above(turning))
    assert plain.worst < 0.1 and worked.worst < 0.1
    margins = []
    for candidate in (plain, worked):
        points = candidate.grasps[0][12:21].reshape(3, 3)
        normals = -points * [1, 1, 0] / 0.03
        contacts = ContactSet.from_arrays(points, normals, mu=turning.mu)
        margins.append(analyse(contacts, length=0.05).epsilon)
    assert margins[1] > margins[0]


def test_turning_everything_about_the_vertical_changes_nothing(turning: GraspTask) -> None:
    axis, shift = np.array([0.1, 0.0, 1.0]), np.array([0.004, 0.0, 0.002])
    turn = SE3(pin.exp3(0.7 * UP), np.zeros(3))
    found = []
    for T in (SE3.Identity(), turn):
        task = replace(turning, T_world_object=T * turning.T_world_object)
        path = ObjectPath(axis=T.rotation @ axis, angle=0.4, shift=T.rotation @ shift)
        found.append(next(solver_of(task, path).solve_path(from_above(task))))
    assert found[0].worst < 0.1
    assert np.allclose(found[0].grasps, found[1].grasps, atol=1e-7)


def test_ninety_degrees_with_three_fingers(ninety: MotionPlan) -> None:
    first, last = ninety.knots[0], ninety.knots[-1]
    turn = last.T_world_object.rotation @ first.T_world_object.rotation.T
    assert np.allclose(pin.log3(turn), [0.0, 0.0, np.pi / 2], atol=1e-6)
    assert np.allclose(
        first.T_world_object.homogeneous, ninety.grasp.task.T_world_object.homogeneous, atol=1e-9
    )
    assert np.allclose(first.q, ninety.grasp.q)
    assert ninety.margin >= 0.05
    assert np.max([k.off_path for k in ninety.knots]) <= ninety.path_tolerance + 2e-4


def test_every_knot_passes_the_grasps_own_verdict_in_a_world_of_its_own(
    ninety: MotionPlan,
) -> None:
    task = ninety.grasp.task
    for knot in ninety.knots[::4]:
        there = replace(task, T_world_object=knot.T_world_object, table_height=None)
        assert verify_geometry(CollisionWorld(there), ninety.T_world_base, knot.q).ok
        contacts = contacts_at(there, ninety.T_world_base, knot.q)
        assert np.allclose(contacts.positions, knot.contacts.positions, atol=1e-9)
        assert np.allclose(contacts.normals, knot.contacts.normals, atol=1e-7)
        assert force_closure(contacts, edges=8).normalised_min_weight == pytest.approx(
            knot.closure.normalised_min_weight, abs=1e-6
        )
        forces = plan_forces(there, contacts, ninety.T_world_base, knot.q)
        assert forces.found


def test_a_knot_that_closes_by_less_than_the_margin_is_refused(ninety: MotionPlan) -> None:
    """Friction is lowered until a knot's contacts still close, but by less than is asked for."""
    task, worst = ninety.grasp.task, min(ninety.knots, key=closure_of)
    place = Waypoint(
        path_parameter=worst.path_parameter,
        T_object_base=worst.T_world_object.inverse() * ninety.T_world_base,
        q=worst.q,
    )

    def margin(mu: float) -> float:
        contacts = replace(worst.contacts, mu=np.full(len(task.fingers), mu))
        return force_closure(contacts, edges=CLOSURE_EDGES).normalised_min_weight

    def verified(mu: float) -> tuple[Knot, ...] | Failure:
        return MovementVerifier(replace(task, mu=mu)).verify_knots(
            ninety.T_world_base, [place], ninety.path, ninety.path_tolerance
        )

    weak, strong = 0.0, task.mu
    while strong - weak > 1e-3:
        middle = (weak + strong) / 2
        weak, strong = (weak, middle) if margin(middle) > CLOSURE_MARGIN else (middle, strong)
    assert 0.0 < margin(weak) < CLOSURE_MARGIN < margin(strong)
    refused, other = verified(weak), verified(strong)
    assert isinstance(refused, Failure) and refused.kind == "closure_margin"
    assert refused.numbers["normalised_min_weight"] == pytest.approx(margin(weak), abs=1e-6)
    assert "closure has a margin of 0.0" in refused.text
    assert not isinstance(other, Failure) or other.kind != "closure_margin"
    assert not isinstance(verified(task.mu), Failure)


def closure_of(knot: Knot) -> float:
    return knot.closure.normalised_min_weight


def test_between_knots_the_object_and_the_pads_keep_together(ninety: MotionPlan) -> None:
    task = ninety.grasp.task
    for place in (0.04, 0.37, 0.96):
        T_world_object, q = ninety.at(place)
        there = replace(task, T_world_object=T_world_object, table_height=None)
        found = verify_geometry(CollisionWorld(there), ninety.T_world_base, q)
        assert np.abs(found.pad_gaps).max() < 1e-3


def test_contacts_roll_on_the_object(ninety: MotionPlan) -> None:
    """The tips turn against the object, so contacts move on it, and they do not slide."""
    first, last = (k.contacts_in_object.positions for k in (ninety.knots[0], ninety.knots[-1]))
    assert np.linalg.norm(last - first, axis=1).max() > 2e-3
    assert ninety.slipped.max() < 2e-3


def test_the_plan_prints_its_path_and_margins(ninety: MotionPlan) -> None:
    text = str(ninety)
    assert "90.0 degrees about (0, 0, 1)" in text
    assert "closure: least normalised min-weight" in text
    assert ninety.joint_room[0] in text


def test_the_same_seed_gives_the_same_motion(ninety: MotionPlan) -> None:
    again = plan_motion(ninety.grasp.task, angle=np.pi / 2)
    assert np.array_equal(again.knots[-1].q, ninety.knots[-1].q)


def test_what_is_out_of_reach_is_refused_with_reasons(turning: GraspTask) -> None:
    with pytest.raises(NoGraspFoundError, match="angle=None finds how far it goes") as caught:
        plan_motion(turning, angle=np.pi, max_attempts=2)
    assert [a.index for a in caught.value.attempts] == [0, 1]


def test_tasks_and_budgets_that_cannot_work_are_refused(turning: GraspTask) -> None:
    with pytest.raises(TaskError, match="the base of turning is fixed"):
        plan_motion(replace(turning, T_world_base=SE3.Identity()), angle=1.0)
    with pytest.raises(TaskError, match="path_tolerance is -1"):
        plan_motion(turning, angle=1.0, path_tolerance=-1.0)
    with pytest.raises(TaskError, match="max_attempts is 0"):
        plan_motion(turning, angle=1.0, max_attempts=0)


def test_without_a_pull_there_are_no_limits(turning: GraspTask) -> None:
    path = ObjectPath(axis=UP, angle=0.3, shift=np.zeros(3))
    problem, start = problem_of(turning.hand, 3), from_above(turning)
    numbers = problem.numbers(turning, path, start, Seeder(turning).posture, MOTION_OPTIONS, 0.01)
    residuals = MotionResiduals(problem, numbers, None)
    lower, upper = problem.bounds(start, 0.01)
    assert what_limits(residuals, problem.first(start), lower, upper) == ()


def test_table_and_obstacles_count_at_the_start_alone(turning: GraspTask) -> None:
    obstacle = Obstacle(
        name="wall",
        size=np.full(3, 0.02),
        T_world_obstacle=SE3(np.eye(3), np.array([0.2, 0, 0.01])),
    )
    task = replace(turning, obstacles=(obstacle,))
    fingers, shape = turning.fingers, turning.object.shape
    problem = build_motion_problem(turning.hand, fingers, shape, 3, n_obstacles=1)
    path = ObjectPath(axis=UP, angle=0.3, shift=np.zeros(3))
    numbers = problem.numbers(
        task, path, from_above(task), Seeder(task).posture, MOTION_OPTIONS, 0.01
    )
    places = problem.grasp.formulation.places
    first, later = (numbers.knots[k, places["obstacles"]] for k in (0, 2))
    assert np.allclose(first, obstacles_in_object(task))
    assert (later[9:12] > 1.0).all() and np.allclose(later[:9], first[:9])
    assert numbers.knots[0, places["table"].stop - 1] == pytest.approx(-0.04)
    assert (numbers.knots[1:, places["table"].stop - 1] < -1.0).all()


@pytest.mark.slow
def test_of_several_the_motion_with_the_largest_margin_is_taken(ninety: MotionPlan) -> None:
    best = plan_motion(ninety.grasp.task, angle=np.pi / 2, best_of=3)
    assert best.record.attempts >= 3  # three are found, and some attempts may fail
    assert best.margin >= ninety.margin


def test_fingers_are_spared_only_by_plan_motion_and_where_it_may(shadow: Hand) -> None:
    task = GraspTask.create(shadow, "cylinder:0.03x0.08")
    tripod, other, whole = finger_sets(task)
    assert tripod.finger_names == ("thumb", "index", "middle") and whole is task
    assert other.finger_names == ("thumb", "middle", "ring")
    assert tripod.grip_force >= task.grip_force
    named = GraspTask.create(shadow, "cylinder:0.03x0.08", fingers=list(task.finger_names))
    assert finger_sets(named) == (named,)
    path = ObjectPath(axis=UP, angle=0.3, shift=np.zeros(3))
    for attempt in itertools.islice(motion_attempts(task, path), 3):
        assert attempt.plan is None or attempt.plan.grasp.task is task


def test_leading_keeps_the_ends_and_lets_pads_roll(
    ninety: MotionPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    task = replace(ninety.grasp.task, table_height=None)
    ends = ninety.knots[0], ninety.knots[6]
    poses = [k.T_world_object.inverse() * ninety.T_world_base for k in ends]
    bases = [SE3.Interpolate(poses[0], poses[1], s) for s in np.linspace(0, 1, 4)]
    led = interpolate_rolling(task, bases, ends[0].q, ends[1].q)
    assert np.array_equal(led[0], ends[0].q) and np.array_equal(led[-1], ends[1].q)
    slid = _slid(task, bases, led)
    assert np.ptp(slid, axis=0).max() < 5e-5  # what the ends are apart by, in even parts
    monkeypatch.setattr("planner.motion.trajectory.MOST_LAPS", 1)
    straight = _slid(task, bases, interpolate_rolling(task, bases, ends[0].q, ends[1].q))
    assert slid.max() < 0.6 * straight.max() and np.ptp(straight, axis=0).max() > 2e-4


def _slid(task: GraspTask, bases: list[SE3], postures: list[FloatArray]) -> FloatArray:
    """Slips (m - 1, n) between places."""
    normals = []
    for base, q in zip(bases, postures, strict=True):
        state = HandState(task.hand, q)
        centers = np.array([base.act(state.pad_center(f)) for f in task.fingers])
        normals.append(task.object.shape.closest_point(centers)[1])
    return np.array(
        [
            slips(
                task.hand,
                task.fingers,
                (bases[k], bases[k + 1]),
                (postures[k], postures[k + 1]),
                (normals[k], normals[k + 1]),
            )
            for k in range(len(bases) - 1)
        ]
    )


def test_a_motion_file_gives_the_motion_back(ninety: MotionPlan, tmp_path: Path) -> None:
    path = tmp_path / "motion.json"
    write_motion(ninety, path)
    again = read_motion(path)
    assert np.allclose(again.knots[-1].q, ninety.knots[-1].q, atol=1e-12)
    assert again.path.angle == pytest.approx(ninety.path.angle)
    assert again.margin == pytest.approx(ninety.margin, abs=1e-6)
    assert np.allclose(again.slipped, ninety.slipped, atol=1e-7)
    assert str(again) == str(ninety)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda data: data.update(format="opposable-plan"), "is not a movement file"),
        (lambda data: data.update(version=9), "has movement version 9"),
        (lambda data: data["knots"][0].update(place=0.5), "do not go from 0 to 1"),
        (lambda data: data["knots"][0]["q_rad"].__setitem__(0, 0.1), "is not its grasp"),
        (lambda data: data["knots"][5]["q_rad"].__setitem__(1, 0.4), "fails its checks"),
        (lambda data: data["path"].update(angle_rad=0.8), "fails its checks"),
        (lambda data: data.update(angle_rad=99.0), "it is to turn by"),
        (lambda data: data.update(shift_m=[0.0, 0.0, 0.01]), "its translation is not"),
        (
            lambda data: data["knots"][5]["contacts"][0].update(force_normal_N=9.0),
            "are not those of its joints",
        ),
    ],
)
def test_a_damaged_motion_file_is_refused(
    ninety: MotionPlan, tmp_path: Path, change: Callable[[dict[str, Any]], None], words: str
) -> None:
    data = movement_to_dict(ninety)
    change(data)
    path = tmp_path / "motion.json"
    write_json(data, path)
    with pytest.raises(FileFormatError, match=words):
        read_motion(path)


def test_rows_of_a_swing_are_those_of_the_fingers_that_stay() -> None:
    """Six of balance, one of margin, and of each finger that stays its two; all of the one knot."""
    fingers = tuple(load_hand("allegro_hand").fingers.values())
    rows = swing_rows(fingers, 1, 3)
    counts = [sum(row.term is term for row in rows) for term in SWING]
    assert counts == [6, 1, len(fingers) - 1, len(fingers) - 1] and sum(counts) == len(rows)
    assert {row.knot for row in rows} == {3} and len(set(rows)) == len(rows)
