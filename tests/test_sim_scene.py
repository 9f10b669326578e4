"""The scene: options, index maps, friction of pairs, the gantry."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from planner.errors import TaskError
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.kinematics import HandState
from planner.spatial import SE3
from planner.system.package import models_dir
from planner.task import GraspTask, Obstacle
from sim.contacts import other_touches
from sim.scene.build import HAND_PREFIX, Scene, build_scene
from sim.scene.gantry import GANTRY, GANTRY_FREQUENCY, GANTRY_INERTIA, GANTRY_MASS, Gantry
from sim.scene.physics import PhysicsOptions

ABOVE = SE3(pin.exp3(np.array([0.2, np.pi - 0.3, 0.4])), np.array([0.03, -0.02, 0.7]))


@pytest.fixture(scope="module", params=["allegro_hand", "shadow_hand"])
def hand(request: pytest.FixtureRequest) -> Hand:
    return load_hand(request.param)


@pytest.fixture(scope="module")
def scene(hand: Hand) -> Scene:
    return build_scene(GraspTask.create(hand, "box"), T_world_base=ABOVE)


def gantry_of(scene: Scene) -> Gantry:
    assert scene.gantry is not None
    return scene.gantry


def random_q(hand: Hand, rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(hand.q_lower, hand.q_upper)


def test_jacobian_is_dense_and_cone_elliptic(scene: Scene) -> None:
    """MuJoCo 4.0.0 factorises sparse Hessians wrongly, so "auto" must never decide."""
    option = scene.model.opt
    assert int(option.jacobian) == int(mujoco.mjtJacobian.mjJAC_DENSE)
    assert int(option.cone) == int(mujoco.mjtCone.mjCONE_ELLIPTIC)
    assert int(option.integrator) == int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
    data = scene.start(scene.task.hand.posture("open"), ABOVE)
    assert not mujoco.mj_isSparse(scene.model)
    assert data.ncon > 0  # the object stands on the table


def test_options_reach_the_model(hand: Hand) -> None:
    physics = PhysicsOptions(timestep=0.001, mu=0.3, noslip_iterations=3, impratio=5)
    gravity = np.array([0.0, 1.0, -5.0])
    task = GraspTask.create(hand, "sphere", gravity=gravity)
    option = build_scene(task, T_world_base=ABOVE, physics=physics).model.opt
    assert (option.timestep, option.noslip_iterations, option.impratio) == (0.001, 3, 5)
    np.testing.assert_allclose(option.gravity, gravity)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"timestep": 0.0}, "timestep is 0.0"),
        ({"mu": float("nan")}, "mu in simulation is nan"),
        ({"mu_torsion": -1.0}, "mu_torsion in simulation is -1.0"),
        ({"iterations": 0}, "iterations is 0; give a whole number from 1 to"),
    ],
)
def test_bad_options_are_named(options: dict[str, float], message: str) -> None:
    with pytest.raises(TaskError, match=message):
        PhysicsOptions(**options)  # type: ignore[arg-type]


def test_index_maps_agree_with_pinocchio(scene: Scene) -> None:
    hand, rng = scene.task.hand, np.random.default_rng(0)
    for _ in range(5):
        q = random_q(hand, rng)
        base = SE3(pin.exp3(rng.normal(size=3) * 0.3) @ ABOVE.rotation, rng.normal(size=3))
        data = scene.start(q, base)
        state = HandState(hand, q)
        for finger in hand.fingers.values():
            site = data.site(HAND_PREFIX + finger.tip_frame)
            tip = base * state.tip_pose(finger)
            np.testing.assert_allclose(site.xpos, tip.translation, atol=1e-10)
            np.testing.assert_allclose(site.xmat.reshape(3, 3), tip.rotation, atol=1e-10)
        palm = scene.body_pose(data, scene.palm_body)
        assert palm.isApprox(base * state.T_base_palm, 1e-9)
        held = scene.body_pose(data, scene.object_body)
        assert held.isApprox(scene.task.T_world_object, 1e-9)


def test_velocity_and_command_addresses(scene: Scene) -> None:
    model, hand = scene.model, scene.task.hand
    for address, dof, name in zip(scene.hand_qpos, scene.hand_dof, hand.joint_names, strict=True):
        joint = model.joint(HAND_PREFIX + name)
        assert (joint.qposadr[0], joint.dofadr[0]) == (address, dof)
    for i, name in zip(scene.hand_ctrl, hand.actuation.names, strict=True):
        assert model.actuator(int(i)).name == HAND_PREFIX + name
    all_dof = np.concatenate([scene.hand_dof, gantry_of(scene).dof, scene.object_dof])
    assert sorted(all_dof) == list(range(model.nv))
    all_ctrl = np.concatenate([scene.hand_ctrl, gantry_of(scene).ctrl])
    assert sorted(all_ctrl) == list(range(model.nu))


def test_every_colliding_geom_of_the_hand_has_its_finger(scene: Scene) -> None:
    hand, model = scene.task.hand, scene.model
    assert len(scene.finger_of_geom) == len(hand.geometries)
    for finger in hand.fingers.values():
        pad = model.geom(HAND_PREFIX + finger.pad.geom).id
        assert scene.finger_of_geom[pad] == finger.name
    assert "" in scene.finger_of_geom.values()


def test_gantry_is_at_zero_at_the_grasp(scene: Scene) -> None:
    np.testing.assert_allclose(gantry_of(scene).coordinates(ABOVE), 0.0, atol=1e-12)


def test_object_has_the_mass_and_inertia_of_its_shape(hand: Hand) -> None:
    for item in ("box", "cylinder", "ellipsoid"):
        task = GraspTask.create(hand, item)
        model = build_scene(task, T_world_base=ABOVE).model
        body = model.body("object")
        shape = task.object.shape
        assert body.mass[0] == pytest.approx(task.object.mass)
        np.testing.assert_allclose(
            np.sort(body.inertia), np.linalg.eigvalsh(shape.inertia(task.object.mass)), rtol=1e-9
        )
        np.testing.assert_allclose(body.ipos, 0.0)


def test_friction_is_that_of_the_options_and_not_a_maximum(hand: Hand) -> None:
    """Whatever the hand's geoms have, the pair has what was asked: the object decides."""
    physics = PhysicsOptions(mu=0.2, mu_torsion=0.003)
    scene = build_scene(GraspTask.create(hand, "sphere"), T_world_base=ABOVE, physics=physics)
    geoms = list(scene.finger_of_geom)
    np.testing.assert_allclose(scene.model.geom_friction[geoms, 0], 0.2)
    scene.model.geom_friction[geoms], scene.model.geom_condim[geoms] = 1.0, 6
    data = scene.start(hand.posture("open"), ABOVE)
    finger = scene.task.fingers[0]
    pad = data.geom(HAND_PREFIX + finger.pad.geom).xpos
    data.qpos[scene.object_qpos[:3]] = pad  # the object inside the fingertip
    mujoco.mj_forward(scene.model, data)
    held = [c for c in data.contact if any(int(g) in scene.finger_of_geom for g in c.geom)]
    assert held
    for contact in held:
        if scene.model.geom("object").id in contact.geom:
            assert contact.dim == 4
            np.testing.assert_allclose(contact.friction[:3], [0.2, 0.2, 0.003])


def test_object_on_table_rolls_with_friction(scene: Scene) -> None:
    data = scene.start(scene.task.hand.posture("open"), ABOVE)
    assert {int(d) for d in data.contact.dim} == {6}
    np.testing.assert_allclose(data.contact.friction[:, 0], scene.physics.mu)


def test_ball_stays_where_it_is_put_and_rolls_when_pushed() -> None:
    scene = build_scene(GraspTask.create("allegro_hand", "sphere"), T_world_base=ABOVE)
    moved = {}
    for push in (0.01, 0.2):  # N, below and above the rolling resistance of 0.03 N
        data = scene.start(scene.task.hand.posture("open"), ABOVE)
        data.xfrc_applied[scene.object_body, 0] = push
        for _ in range(200):
            data.ctrl[gantry_of(scene).ctrl] = gantry_of(scene).command(
                data, np.zeros(6), np.zeros(6)
            )
            mujoco.mj_step(scene.model, data)
        moved[push] = data.xpos[scene.object_body, 0]
    assert abs(moved[0.01]) < 1e-4
    assert moved[0.2] > 0.01


def test_gantry_carries_the_hand_and_follows_without_lag(scene: Scene) -> None:
    hand = scene.task.hand
    start = SE3(pin.exp3(np.array([0.1, 0.2, -0.1])) @ ABOVE.rotation, ABOVE.translation + 0.05)
    begin = gantry_of(scene).coordinates(start)
    q = hand.posture("open")
    data = scene.start(q, start)
    assert scene.body_pose(data, scene.base_body).isApprox(start, 1e-9)
    duration, worst = 0.5, 0.0
    still = np.zeros(hand.nq)
    while data.time < duration + 0.2:
        s = min(1.0, data.time / duration)
        share, rate = s**3 * (10 + s * (6 * s - 15)), 30 * s**2 * (1 - s) ** 2 / duration
        target = (1 - share) * begin
        worst = max(worst, np.abs(data.qpos[gantry_of(scene).qpos] - target)[:3].max())
        gravity = HandState(hand, q).gravity_torque(ABOVE.rotation.T @ [0, 0, -9.81])
        data.ctrl[scene.hand_ctrl], _ = hand.actuation.ctrl_for_torque(q, still, gravity)
        data.ctrl[gantry_of(scene).ctrl] = gantry_of(scene).command(data, target, -rate * begin)
        mujoco.mj_step(scene.model, data)
    assert worst < 0.001
    sag_without_feed_forward = 9.81 / GANTRY_FREQUENCY**2  # 2.7 mm
    left = np.abs(data.qpos[gantry_of(scene).qpos[:3]]).max()
    assert left < 0.1 * sag_without_feed_forward


def test_object_without_table_is_held_until_released(hand: Hand) -> None:
    task = GraspTask.create(
        hand, "box", table_height=None, T_world_object=SE3(pin.exp3(np.ones(3)), np.ones(3))
    )
    scene = build_scene(task, T_world_base=SE3(ABOVE.rotation, ABOVE.translation + 1.0))
    data = scene.start(hand.posture("open"), scene.T_world_base)
    heights = []
    for held in (True, False):
        if not held:
            scene.release(data)
        for _ in range(100):
            mujoco.mj_step(scene.model, data)
        heights.append(data.xpos[scene.object_body, 2])
    assert heights[0] == pytest.approx(1.0, abs=1e-3)
    assert heights[1] < heights[0] - 0.1


def test_touches_that_are_not_hand_on_object_are_sorted_by_who_touches_whom(hand: Hand) -> None:
    wall = Obstacle(
        name="wall",
        size=np.array([0.02, 0.02, 0.02]),
        T_world_obstacle=SE3(np.eye(3), np.array([1.5, 0.0, 0.7])),
    )
    task = GraspTask.create(hand, "box", obstacles=(wall,))
    scene = build_scene(task, T_world_base=ABOVE)
    data = scene.start(hand.posture("open"), ABOVE)
    for _ in range(100):
        data.ctrl[gantry_of(scene).ctrl] = gantry_of(scene).command(data, np.zeros(6), np.zeros(6))
        mujoco.mj_step(scene.model, data)
    resting = [t for t in other_touches(scene, data) if t.kind == "object-table"]
    assert {(t.first, t.second) for t in resting} == {("object", "table")}
    weight = task.object.mass * 9.81
    assert sum(t.normal_force for t in resting) == pytest.approx(weight, rel=1e-2)

    beside = np.array([0.4, 0.4, 0.0])
    for goal, kind, other in (
        (beside, "hand-table", "table"),
        (wall.T_world_obstacle.translation, "hand-obstacle", "wall"),
    ):
        palm = HandState(hand, hand.posture("open")).T_base_palm
        at = SE3(ABOVE.rotation, goal - ABOVE.rotation @ palm.translation)
        data = scene.start(hand.posture("open"), at)
        found = [t for t in other_touches(scene, data) if t.kind == kind]
        assert found
        names = {g.name for g in hand.geometries}
        assert {t.first for t in found} <= names
        assert {t.second for t in found} == {other}


def test_fingers_on_each_other_are_a_touch_of_hand_and_hand(scene: Scene) -> None:
    hand, rng = scene.task.hand, np.random.default_rng(1)
    for _ in range(200):
        data = scene.start(random_q(hand, rng), ABOVE)
        found = [t for t in other_touches(scene, data) if t.kind == "hand-hand"]
        if found:
            break
    assert found
    names = {g.name for g in hand.geometries}
    assert {found[0].first, found[0].second} <= names


def test_obstacles_stand_where_the_task_says(hand: Hand) -> None:
    pose = SE3(pin.exp3(np.array([0, 0, 0.5])), np.array([0.2, 0.1, 0.05]))
    wall = Obstacle(name="table", size=np.array([0.02, 0.1, 0.1]), T_world_obstacle=pose)
    scene = build_scene(GraspTask.create(hand, "box", obstacles=(wall,)), T_world_base=ABOVE)
    geom = scene.model.geom("obstacle/table")
    np.testing.assert_allclose(geom.size, [0.01, 0.05, 0.05])
    data = scene.start(hand.posture("open"), ABOVE)
    np.testing.assert_allclose(data.geom("obstacle/table").xpos, pose.translation, atol=1e-12)


def without_mass(edit_hand: Callable[..., Path]) -> Path:
    """The Allegro with a palm that weighs nothing."""
    palm = 'mass="0.4154" diaginertia="0.000754 0.00037 0.0005"'
    return edit_hand(xml={palm: 'mass="0" diaginertia="0 0 0"'})


def from_the_palm(edit_hand: Callable[..., Path]) -> Path:
    """The Shadow hand from its palm on, which the last joint of the wrist moves."""
    file, source = edit_hand(), models_dir() / "hands" / "shadow_hand"
    text = (source / "hand.toml").read_text(encoding="utf-8")
    for old, new in (
        ('base_body = "forearm"', 'base_body = "palm"'),
        ('["WRJ2", "WRJ1"]', '["WRJ1"]'),
        ('"shadow_hand.xml"', f'"{(source / "shadow_hand.xml").as_posix()}"'),
    ):
        assert old in text
        text = text.replace(old, new)
    file.write_text(text, encoding="utf-8")
    return file


@pytest.mark.parametrize("write", [without_mass, from_the_palm])
def test_a_gantry_to_which_no_mass_is_fixed_gets_the_least(
    edit_hand: Callable[..., Path], write: Callable[[Callable[..., Path]], Path]
) -> None:
    hand = load_hand(write(edit_hand))
    scene = build_scene(GraspTask.create(hand, "box"), T_world_base=ABOVE)
    body = scene.model.body(GANTRY)
    assert body.mass == GANTRY_MASS
    np.testing.assert_array_equal(body.inertia, GANTRY_INERTIA)
    data, q = scene.start(hand.posture("open"), ABOVE), hand.posture("open")
    for _ in range(200):
        gravity = HandState(hand, q).gravity_torque(ABOVE.rotation.T @ [0, 0, -9.81])
        data.ctrl[scene.hand_ctrl], _ = hand.actuation.ctrl_for_torque(q, 0.0 * q, gravity)
        data.ctrl[gantry_of(scene).ctrl] = gantry_of(scene).command(data, np.zeros(6), np.zeros(6))
        mujoco.mj_step(scene.model, data)
    assert np.abs(data.qpos[gantry_of(scene).qpos]).max() < 0.001


def test_a_gantry_with_a_mass_fixed_to_it_has_none_of_its_own(scene: Scene) -> None:
    assert scene.model.body(GANTRY).mass == 0.0
    assert not scene.model.body(GANTRY).inertia.any()
