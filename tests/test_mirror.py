"""Left hands are mirror images of right hands, and so is what they do.

M is the reflection of the base's frame. It acts on positions as p -> M p, on rotations as
R -> M R M, on torques and rotation axes (axial vectors) as a -> -M a.
"""

from __future__ import annotations

from functools import cache
from itertools import combinations
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from planner.bridge import compile_spec, mirror_spec
from planner.collision.pregrasp import Approach
from planner.errors import HandError
from planner.failure import Failure
from planner.hand_loading import load_hand
from planner.hands.catalog import find_hand
from planner.hands.description_toml import MirrorAxis, read_description, reflection_signs
from planner.hands.hand import Hand
from planner.kinematics import HandState
from planner.plan import GraspPlan
from planner.search.grasp import plan_grasp
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask
from planner.verification import verify_grasp

HANDS = Path(__file__).resolve().parent.parent / "models" / "hands"
NAMES = ("shadow_hand", "allegro_hand")
EXACT = 1e-12
"""m, rad, N m: what a few dozen products of rounded numbers may differ by."""

both_hands = pytest.mark.parametrize("name", NAMES)
all_axes = pytest.mark.parametrize("axis", ("x", "y", "z"))

# Everything in which a model file can hide a pose: degrees, Euler angles, direction of z, end
# points, nested frames, three kinds of inertia, an anchor off the origin, a slide.
ODD_MODEL = """
<mujoco>
  <compiler angle="degree" autolimits="true"/>
  <worldbody>
    <light pos="1 2 3"/>
    <body name="base" pos="0.1 0.2 0.3" euler="10 20 30">
      <camera name="eye" pos="0 0.1 0.2"/>
      <geom name="base" type="box" size="0.03 0.02 0.01" pos="0.01 0.02 0.03" euler="15 0 40"/>
      <frame pos="0.02 -0.03 0.05" axisangle="1 2 3 50">
        <frame pos="0.01 0 0" euler="0 0 25">
          <body name="link" pos="0.03 0.01 0.02" zaxis="1 1 2">
            <joint name="hinge" type="hinge" axis="1 2 -1" pos="0.01 -0.02 0.005" range="-60 80"
                   ref="20"/>
            <geom name="rod" type="capsule" fromto="0 0 0 0.02 0.03 0.06" size="0.008"/>
            <body name="slider" pos="0.02 0.03 0.06" xyaxes="1 1 0 0 1 1">
              <inertial pos="0.004 0.003 0.002" mass="0.2"
                        fullinertia="3e-4 4e-4 5e-4 2e-5 -3e-5 4e-5"/>
              <joint name="slide" type="slide" axis="1 -1 3" range="-0.1 0.1"/>
              <geom name="egg" type="ellipsoid" size="0.01 0.02 0.03" euler="30 40 50"/>
              <geom name="can" type="cylinder" fromto="0 0 0.02 0.03 -0.02 0.05" size="0.01"/>
              <site name="tip" pos="0.01 0.02 0.05" euler="5 15 25"/>
              <body name="tail" pos="0.01 0 0.01">
                <inertial pos="0.01 0.02 0" mass="0.1" diaginertia="1e-4 2e-4 2.5e-4"
                          euler="10 50 20"/>
                <joint name="tail" type="hinge" axis="0 1 1" range="-60 60"/>
              </body>
              <site name="rim" type="capsule" fromto="0 0 0 0.01 0.02 0.03" size="0.001"/>
            </body>
          </body>
        </frame>
      </frame>
    </body>
  </worldbody>
</mujoco>
"""


@cache
def hand(name: str) -> Hand:
    return load_hand(name)


def pair(name: str) -> tuple[Hand, Hand, FloatArray]:
    """A right hand, its left hand, and M as a matrix (3, 3)."""
    axis = read_description(find_hand(f"{name}_left")).mirror_axis
    assert axis is not None
    return hand(name), hand(f"{name}_left"), np.diag(reflection_signs(axis))


def random_joints(of: Hand, n: int, seed: int = 0) -> FloatArray:
    return np.random.default_rng(seed).uniform(of.q_lower, of.q_upper, (n, of.nq))


def mirrored(pose: SE3, m: FloatArray) -> SE3:
    """M T M."""
    return SE3(m @ pose.rotation @ m, m @ pose.translation)


def assert_mirrored(left: SE3, right: SE3, m: FloatArray, tol: float = EXACT) -> None:
    np.testing.assert_allclose(left.translation, m @ right.translation, atol=tol)
    np.testing.assert_allclose(left.rotation, m @ right.rotation @ m, atol=tol)


@both_hands
def test_thumb_and_index_are_on_the_other_side(name: str) -> None:
    right, left, m = pair(name)
    q = right.posture("open")
    across = int(np.argmin(np.diag(m)))
    for finger in ("thumb", "index"):
        here = HandState(right, q).pad_center(right.fingers[finger])[across]
        there = HandState(left, q).pad_center(left.fingers[finger])[across]
        assert abs(here) > 0.01
        assert there == pytest.approx(-here, abs=EXACT)
    np.testing.assert_array_equal(left.palm_normal, m @ right.palm_normal)


@both_hands
def test_names_limits_and_actuators_stay(name: str) -> None:
    right, left, _ = pair(name)
    assert (left.name, left.joint_names) == (f"{name}_left", right.joint_names)
    assert list(left.fingers) == list(right.fingers)
    assert left.allowed_pairs == right.allowed_pairs
    np.testing.assert_array_equal(left.q_lower, right.q_lower)
    np.testing.assert_array_equal(left.q_upper, right.q_upper)
    np.testing.assert_array_equal(left.posture("open"), right.posture("open"))
    for field in ("moment", "gain", "bias", "force_range", "ctrl_range", "stop_rows"):
        np.testing.assert_array_equal(
            getattr(left.actuation, field), getattr(right.actuation, field)
        )


@both_hands
def test_tips_and_pads_are_mirrored(name: str) -> None:
    right, left, m = pair(name)
    for q in random_joints(right, 50):
        a, b = HandState(right, q), HandState(left, q)
        assert_mirrored(b.T_base_palm, a.T_base_palm, m)
        for finger in right.fingers:
            f, g = right.fingers[finger], left.fingers[finger]
            assert_mirrored(b.tip_pose(g), a.tip_pose(f), m)
            np.testing.assert_allclose(b.pad_center(g), m @ a.pad_center(f), atol=EXACT)
            np.testing.assert_allclose(b.pad_axis(g), m @ a.pad_axis(f), atol=EXACT)


@both_hands
def test_jacobians_are_mirrored(name: str) -> None:
    right, left, m = pair(name)
    for q in random_joints(right, 20):
        a, b = HandState(right, q), HandState(left, q)
        for finger in right.fingers:
            expected = a.tip_jacobian(right.fingers[finger])
            actual = b.tip_jacobian(left.fingers[finger])
            np.testing.assert_allclose(actual[:3], m @ expected[:3], atol=EXACT)
            np.testing.assert_allclose(actual[3:], -m @ expected[3:], atol=EXACT)


@both_hands
def test_masses_and_inertias_are_the_same(name: str) -> None:
    right, left, m = pair(name)
    signs = np.diag(m)
    a, b = right.mj_model, left.mj_model
    np.testing.assert_array_equal(b.body_mass, a.body_mass)
    np.testing.assert_array_equal(b.body_inertia, a.body_inertia)
    np.testing.assert_array_equal(b.body_ipos, a.body_ipos * signs)
    for i, (link, mirror) in enumerate(
        zip(right.pin_model.inertias, left.pin_model.inertias, strict=True)
    ):
        np.testing.assert_allclose(mirror.lever, m @ link.lever, atol=EXACT, err_msg=str(i))
        np.testing.assert_allclose(mirror.inertia, m @ link.inertia @ m, atol=EXACT)


@both_hands
def test_gravity_torque_is_the_same_under_mirrored_gravity(name: str) -> None:
    right, left, m = pair(name)
    gravity = np.array([3.0, -5.0, -8.0])
    for q in random_joints(right, 20):
        expected = HandState(right, q).gravity_torque(gravity)
        assert np.abs(expected).max() > 1e-3
        actual = HandState(left, q).gravity_torque(m @ gravity)
        np.testing.assert_allclose(actual, expected, atol=EXACT)


@both_hands
def test_geometries_are_mirrored_with_their_extent(name: str) -> None:
    right, left, m = pair(name)
    for a, b in zip(right.geometries, left.geometries, strict=True):
        assert (a.name, a.body, a.kind) == (b.name, b.body, b.kind)
        np.testing.assert_array_equal(a.size, b.size)
        assert_mirrored(b.T_joint_geometry, a.T_joint_geometry, m)
    q = random_joints(right, 1)[0]
    np.testing.assert_allclose(
        _distances(left.mj_model, q), _distances(right.mj_model, q), atol=1e-6
    )


@both_hands
def test_new_spec_is_the_mirrored_model(name: str) -> None:
    right, left, _ = pair(name)
    rebuilt = left.new_spec().compile()
    for field in ("body_pos", "body_quat", "body_iquat", "jnt_axis", "geom_pos", "site_quat"):
        np.testing.assert_array_equal(getattr(rebuilt, field), getattr(left.mj_model, field))
    assert not np.array_equal(rebuilt.jnt_axis, right.mj_model.jnt_axis)


@all_axes
def test_any_way_to_write_a_pose_is_mirrored(axis: MirrorAxis) -> None:
    """Poses, masses and motion of an awkward model, by MuJoCo's own dynamics."""
    signs = reflection_signs(axis)
    m = np.diag(signs)
    spec = mujoco.MjSpec.from_string(ODD_MODEL)
    mirror_spec(spec, signs, "odd")
    right, left = mujoco.MjModel.from_xml_string(ODD_MODEL), spec.compile()
    right.opt.gravity = [1.0, 2.0, -3.0]
    left.opt.gravity = signs * right.opt.gravity
    np.testing.assert_array_equal(left.body_mass, right.body_mass)
    np.testing.assert_array_equal(left.body_inertia, right.body_inertia)
    principal = right.body_iquat * [1.0, *-signs]
    np.testing.assert_allclose(left.body_iquat, principal, atol=EXACT)
    a, b = mujoco.MjData(right), mujoco.MjData(left)
    rng = np.random.default_rng(1)
    for _ in range(20):
        a.qpos[:] = b.qpos[:] = rng.uniform(-1, 1, 3) * [1.0, 0.1, 1.0]
        a.qvel[:] = b.qvel[:] = rng.normal(size=3)
        mujoco.mj_forward(right, a)
        mujoco.mj_forward(left, b)
        for kind in ("x", "site_x", "geom_x"):
            here, there = getattr(a, f"{kind}pos"), getattr(b, f"{kind}pos")
            np.testing.assert_allclose(there, here @ m, atol=EXACT, err_msg=kind)
            turned = m @ getattr(a, f"{kind}mat").reshape(-1, 3, 3) @ m
            np.testing.assert_allclose(
                getattr(b, f"{kind}mat").reshape(-1, 3, 3), turned, atol=EXACT, err_msg=kind
            )
        np.testing.assert_allclose(b.xipos, a.xipos @ m, atol=EXACT)
        np.testing.assert_allclose(b.qfrc_bias, a.qfrc_bias, atol=EXACT)
        np.testing.assert_allclose(b.qacc, a.qacc, rtol=1e-9)
        np.testing.assert_allclose(_distances(left, b.qpos), _distances(right, a.qpos), atol=1e-6)
    assert (left.ncam, left.nlight) == (0, 0)


def _distances(model: Any, q: FloatArray) -> FloatArray:
    """Distances (m) of all pairs of geoms at q: they tell a mirrored solid from a misplaced one."""
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    pairs = list(combinations(range(model.ngeom), 2))[:: max(1, model.ngeom // 8)]
    return np.array([mujoco.mj_geomDistance(model, data, i, j, 1.0, None) for i, j in pairs])


@cache
def right_plan(name: str) -> GraspPlan:
    """A grasp of a box at the origin, tilted, in mid-air."""
    turn = SE3(pin.rpy.rpyToMatrix(0.3, 0.2, 0.4), np.zeros(3))
    task = GraspTask.create(hand(name), "box", T_world_object=turn, table_height=None)
    return plan_grasp(task, seed=0)


@both_hands
def test_mirrored_plan_has_mirrored_fingertips(name: str) -> None:
    _, left, m = pair(name)
    plan = right_plan(name)
    task = GraspTask.create(
        left, "box", T_world_object=mirrored(plan.task.T_world_object, m), table_height=None
    )
    image = verify_grasp(
        task,
        mirrored(plan.T_world_base, m),
        plan.q,
        record=plan.record,
        approach=Approach(
            q=plan.q_pregrasp,
            pregrasp_distance=plan.pregrasp_distance,
            T_world_base_start=mirrored(plan.T_world_base_start, m),
        ),
    )
    assert isinstance(image, GraspPlan), image
    assert image.contacts.fingers == plan.contacts.fingers
    np.testing.assert_allclose(image.contacts.positions, plan.contacts.positions @ m, atol=1e-9)
    np.testing.assert_allclose(image.contacts.normals, plan.contacts.normals @ m, atol=1e-9)
    gaps = image.verification.pad_gaps
    np.testing.assert_allclose(gaps, plan.verification.pad_gaps, atol=1e-9)
    a, b = HandState(plan.task.hand, plan.q), HandState(left, image.q)
    for f, g in zip(plan.task.fingers, task.fingers, strict=True):
        right_tip, left_tip = plan.T_world_base * a.tip_pose(f), image.T_world_base * b.tip_pose(g)
        assert_mirrored(left_tip, right_tip, m, 1e-9)


@both_hands
def test_mirrored_plan_does_not_fit_the_right_hand(name: str) -> None:
    """The witness that the test above can fail."""
    right, _, m = pair(name)
    plan = right_plan(name)
    task = GraspTask.create(
        right, "box", T_world_object=mirrored(plan.task.T_world_object, m), table_height=None
    )
    verdict = verify_grasp(task, mirrored(plan.T_world_base, m), plan.q, record=plan.record)
    assert isinstance(verdict, Failure)
    assert "mm from the surface" in verdict.text


@both_hands
def test_left_hand_plans_by_itself(name: str) -> None:
    plan = plan_grasp(GraspTask.create(hand(f"{name}_left"), "sphere"), seed=0)
    assert plan.verification.ok
    assert np.abs(plan.verification.pad_gaps).max() <= 5e-4


def _write_mirror(folder: Path, of: Path | str, name: str = "hand.toml") -> Path:
    path = folder / name
    path.write_text(f'schema = 1\nname = "m"\nmirror_of = "{of}"\nmirror_axis = "x"\n')
    return path


def _copy_right(folder: Path, name: str = "allegro_hand") -> Path:
    for file in ("hand.toml", f"{name}.xml"):
        (folder / file).write_bytes((HANDS / name / file).read_bytes())
    return folder / "hand.toml"


def test_description_is_mirrored_out_of_the_plane(tmp_path: Path) -> None:
    """The shipped pads and palms lie in their mirror planes; this one does not."""
    original = _copy_right(tmp_path)
    text = original.read_text()
    for old, new in (
        ("palm_normal = [1.0, 0.0, 0.0]", "palm_normal = [0.8, 0.6, 0.0]"),
        ("center = [0.0, 0.0, 0.0423]", "center = [0.0001, 0.0002, 0.0423]"),
        ("axis = [0.7071067811865476, 0.0, 0.7071067811865476]", "axis = [0.6, 0.0, 0.8]"),
    ):
        assert old in text
        text = text.replace(old, new)
    original.write_text(text)
    right, left = load_hand(original), load_hand(_write_mirror(tmp_path, "hand.toml", "left.toml"))
    np.testing.assert_array_equal(left.palm_normal, [-0.8, 0.6, 0.0])
    m = np.diag([-1.0, 1.0, 1.0])
    q = random_joints(right, 1)[0]
    a, b = HandState(right, q), HandState(left, q)
    for f, g in zip(right.fingers.values(), left.fingers.values(), strict=True):
        np.testing.assert_allclose(b.pad_center(g), m @ a.pad_center(f), atol=EXACT)
        np.testing.assert_allclose(b.pad_axis(g), m @ a.pad_axis(f), atol=EXACT)
    assert left.description.fingers[0].pad.center == (-0.0001, 0.0002, 0.0423)


def test_digest_covers_all_files(tmp_path: Path) -> None:
    original = _copy_right(tmp_path)
    model = tmp_path / "allegro_hand.xml"
    mirror = _write_mirror(tmp_path, "hand.toml", "left.toml")
    seen = {load_hand(mirror).digest}
    for file, comment in ((original, "\n# x"), (model, "<!-- x -->"), (mirror, "\n# x")):
        file.write_text(file.read_text() + comment)
        seen.add(load_hand(mirror).digest)
    assert len(seen) == 4


def test_two_mirrors_give_the_hand_back() -> None:
    spec = hand("shadow_hand").new_spec()
    for _ in range(2):
        mirror_spec(spec, reflection_signs("x"), "shadow_hand")
    twice, once = spec.compile(), hand("shadow_hand").mj_model
    for field in ("body_pos", "body_quat", "jnt_axis", "geom_pos", "geom_quat", "body_iquat"):
        np.testing.assert_array_equal(getattr(twice, field), getattr(once, field))


def test_mirror_of_a_mirror_is_refused(tmp_path: Path) -> None:
    path = _write_mirror(tmp_path, HANDS / "allegro_hand_left" / "hand.toml")
    with pytest.raises(HandError, match="is a mirror image itself"):
        load_hand(path)


def test_missing_original_is_refused(tmp_path: Path) -> None:
    with pytest.raises(HandError, match="which does not exist"):
        load_hand(_write_mirror(tmp_path, "nowhere.toml"))


def test_fields_beside_mirror_of_are_refused(tmp_path: Path) -> None:
    path = _write_mirror(tmp_path, HANDS / "allegro_hand" / "hand.toml")
    path.write_text(path.read_text() + 'palm_body = "palm"\n')
    with pytest.raises(HandError, match="palm_body"):
        load_hand(path)


def test_mesh_is_refused() -> None:
    spec = mujoco.MjSpec.from_string(
        """<mujoco><asset><mesh name="m" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset>
        <worldbody><body><joint/><geom name="shell" type="mesh" mesh="m"/></body></worldbody>
        </mujoco>"""
    )
    with pytest.raises(HandError, match=r"'shell'.*mirroring a mesh is not supported"):
        mirror_spec(spec, reflection_signs("x"), "hand.xml")


def test_a_mesh_that_is_only_shown_is_left_out() -> None:
    spec = mujoco.MjSpec.from_string(
        """<mujoco><asset><mesh name="m" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset>
        <worldbody><body><joint/><geom type="mesh" mesh="m" contype="0" conaffinity="0" mass="0"/>
        <geom name="solid" size="0.01" pos="0.1 0 0" group="3"/></body></worldbody></mujoco>"""
    )
    mirror_spec(spec, reflection_signs("x"), "it")
    (solid,) = spec.geoms
    np.testing.assert_allclose(solid.pos, [-0.1, 0, 0])
    assert solid.group == 0  # it is drawn now


def test_weld_is_refused() -> None:
    spec = mujoco.MjSpec.from_string(
        """<mujoco><worldbody>
        <body name="a"><joint/><geom size="0.01"/></body>
        <body name="b"><joint/><geom size="0.01"/></body>
        </worldbody><equality><weld name="tie" body1="a" body2="b"/></equality></mujoco>"""
    )
    with pytest.raises(HandError, match="'tie' ties two bodies"):
        mirror_spec(spec, reflection_signs("x"), "hand.xml")
    spec.delete(spec.equalities[0])
    mirror_spec(spec, reflection_signs("x"), "hand.xml")
    assert compile_spec(spec, "hand.xml").nv == 2
