"""The bridge: what is built from a compiled MuJoCo model moves and weighs as MuJoCo says."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import coal
import mujoco
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from planner.bridge import (
    actuation_from_mujoco,
    compile_spec,
    hand_geometries,
    load_spec,
    pinocchio_from_mujoco,
)
from planner.bridge.geometry import allowed_pairs
from planner.errors import ModelError
from planner.hands.hand import Hand
from planner.shapes.convex_pairs import DistancePair
from planner.spatial import FloatArray, pose_from_wxyz

FREE, BALL = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_BALL)

NASTY = """
<mujoco>
  <compiler angle="radian"/>
  <option gravity="1 -2 -9"/>
  <worldbody>
    <site name="in_the_world" pos="0.3 0.1 0"/>
    <body name="root" pos="0.1 0.2 0.3" quat="0.5 0.1 -0.7 0.4">
      <inertial pos="0 0 0.01" mass="0.9" diaginertia="0.01 0.01 0.01"/>
      <body name="two_in_one" pos="0 0.1 0" quat="1 0.2 0 0.1">
        <inertial pos="0.01 0.02 0.03" quat="1 2 3 4" mass="0.7" diaginertia="0.03 0.02 0.04"/>
        <joint name="h1" type="hinge" axis="1 2 3" pos="0.01 0 -0.02" ref="0.4" armature="0.02"/>
        <joint name="s1" type="slide" axis="0 -1 1" pos="0 0.05 0" ref="-0.03"/>
        <joint name="h2" type="hinge" axis="0 1 0" pos="0 -0.01 0.03" ref="-1.1"/>
        <site name="s_two" pos="0.1 0 0" quat="0 1 0 1"/>
        <body name="stiff" pos="0.2 0 0" quat="0.3 0.1 0.9 0">
          <inertial pos="0.02 0 0" quat="0 1 1 0" mass="0.2" diaginertia="0.01 0.02 0.015"/>
          <body name="ball" pos="0 0 0.15">
            <inertial pos="0 0.04 0" mass="0.3" diaginertia="0.004 0.005 0.006"/>
            <joint name="b" type="ball" pos="0.01 -0.02 0.03" armature="0.01"/>
            <body name="end" pos="0 0.1 0.1">
              <inertial pos="0 0 0" mass="0.1" diaginertia="0.001 0.001 0.001"/>
              <joint name="h3" type="hinge" axis="-1 0 0"/>
              <site name="s_end" pos="0 0 0.07"/>
            </body>
          </body>
        </body>
      </body>
    </body>
    <body name="flying" pos="1 0 0" quat="0 0 1 0">
      <inertial pos="0.01 0 -0.02" quat="1 0 1 0" mass="0.5" diaginertia="0.002 0.003 0.004"/>
      <joint name="f" type="free" armature="0.05"/>
      <body name="flag" pos="0 0 0.1" quat="1 1 0 0">
        <inertial pos="0 0 0.02" mass="0.4" diaginertia="0.002 0.002 0.002"/>
        <joint name="h4" type="hinge" axis="1 1 0" pos="0 0.02 0" ref="0.2"/>
        <site name="s_flag" pos="0 0.02 0"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def numbers(values: FloatArray) -> str:
    return " ".join(repr(float(v)) for v in np.atleast_1d(values))


def random_model(rng: np.random.Generator) -> Any:
    """A tree of up to six bodies with every kind of joint, frames and inertias at random."""

    def placed() -> str:
        return (
            f'pos="{numbers(rng.normal(scale=0.2, size=3))}" quat="{numbers(rng.normal(size=4))}"'
        )

    count = int(rng.integers(1, 7))
    parents = [int(rng.integers(-1, i)) for i in range(count)]

    def joints(i: int) -> str:
        kinds = rng.choice(["hinge", "slide"], size=int(rng.integers(0, 4))).tolist()
        if rng.random() < 0.2:
            kinds.append("ball")
        if parents[i] == -1 and rng.random() < 0.3:
            kinds = ["free"]
        out = ""
        for k, kind in enumerate(kinds):
            out += f'<joint name="j{i}_{k}" type="{kind}" armature="{rng.random()!r}"'
            if kind != "free":
                out += f' pos="{numbers(rng.normal(scale=0.1, size=3))}"'
            if kind in ("hinge", "slide"):
                out += f' axis="{numbers(rng.normal(size=3))}" ref="{rng.normal()!r}"'
            out += "/>"
        return out

    def body(i: int) -> str:
        a, b, c = rng.uniform(1e-3, 1e-2, size=3)  # a+b, b+c, c+a is always a possible inertia
        diagonal = numbers(np.array([a + b, b + c, c + a]))
        inertial = f'mass="{rng.uniform(0.1, 1)!r}" diaginertia="{diagonal}"'
        children = "".join(body(k) for k in range(count) if parents[k] == i)
        return (
            f'<body name="b{i}" {placed()}><inertial {placed()} {inertial}/>{joints(i)}'
            f'<site name="s{i}" {placed()}/>{children}</body>'
        )

    roots = "".join(body(i) for i in range(count) if parents[i] == -1)
    gravity = numbers(rng.normal(scale=5, size=3))
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/><option gravity="{gravity}"/>'
        f"<worldbody>{roots}</worldbody></mujoco>"
    )


def random_state(model: Any, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """MuJoCo's qpos with unit quaternions, and qvel."""
    qpos = rng.normal(size=model.nq)
    for j in range(model.njnt):
        kind, at = int(model.jnt_type[j]), int(model.jnt_qposadr[j])
        if kind in (FREE, BALL):
            quat = slice(at + 3, at + 7) if kind == FREE else slice(at, at + 4)
            qpos[quat] /= np.linalg.norm(qpos[quat])
    return qpos, rng.normal(size=model.nv)


def to_pinocchio(
    model: Any, qpos: FloatArray, qvel: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """q, v, T (nv, nv) and a0 (nv,): v = T qvel, and its rate at zero qacc is a0.

    Quaternions run w, x, y, z in MuJoCo and x, y, z, w in Pinocchio. The linear velocity of a free
    joint is in world axes in MuJoCo and in body axes in Pinocchio; the angular one in body axes.
    """
    q, turn, rate = qpos.copy(), np.eye(model.nv), np.zeros(model.nv)
    for j in range(model.njnt):
        kind, at, dof = (int(a[j]) for a in (model.jnt_type, model.jnt_qposadr, model.jnt_dofadr))
        if kind in (FREE, BALL):
            start = at + 3 * (kind == FREE)
            q[start : start + 4] = qpos[[start + 1, start + 2, start + 3, start]]
        if kind == FREE:
            to_body = pose_from_wxyz(np.zeros(3), qpos[at + 3 : at + 7]).rotation.T
            turn[dof : dof + 3, dof : dof + 3] = to_body
            spin = qvel[dof + 3 : dof + 6]
            rate[dof : dof + 3] = -np.cross(spin, to_body @ qvel[dof : dof + 3])
    return q, turn @ qvel, turn, rate


def assert_same_mechanics(model: Any, rng: np.random.Generator) -> None:
    """Poses of all bodies and sites, mass matrix and bias forces agree at a random state."""
    ours = pinocchio_from_mujoco(model)
    data, ours_data = mujoco.MjData(model), ours.createData()
    qpos, qvel = random_state(model, rng)
    data.qpos[:], data.qvel[:] = qpos, qvel
    mujoco.mj_forward(model, data)
    q, v, turn, rate = to_pinocchio(model, qpos, qvel)

    assert (ours.nq, ours.nv) == (model.nq, model.nv)
    pin.framesForwardKinematics(ours, ours_data, q)
    for kind, count, pos, mat in (
        (pin.FrameType.BODY, model.nbody, data.xpos, data.xmat),
        (pin.FrameType.OP_FRAME, model.nsite, data.site_xpos, data.site_xmat),
    ):
        for i in range(1 if kind == pin.FrameType.BODY else 0, count):
            name = model.body(i).name if kind == pin.FrameType.BODY else model.site(i).name
            pose = ours_data.oMf[ours.getFrameId(name, kind)]
            np.testing.assert_allclose(pose.translation, pos[i], rtol=0, atol=1e-10, err_msg=name)
            np.testing.assert_allclose(
                pose.rotation, mat[i].reshape(3, 3), rtol=0, atol=1e-10, err_msg=name
            )
    if model.nv == 0:
        return
    dense = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, dense)
    upper = np.triu(pin.crba(ours, ours_data, q))
    mass_matrix = turn.T @ (upper + np.triu(upper, 1).T) @ turn
    np.testing.assert_allclose(mass_matrix, dense, rtol=0, atol=1e-10)
    # RNEA at the acceleration that is zero for MuJoCo; rotor inertia must not act on that.
    still = pin.rnea(ours, ours_data, q, v, rate) - ours.armature * rate
    np.testing.assert_allclose(turn.T @ still, data.qfrc_bias, rtol=0, atol=1e-10)


def test_nasty_model_has_the_same_mechanics() -> None:
    model = mujoco.MjModel.from_xml_string(NASTY)
    for seed in range(20):
        assert_same_mechanics(model, np.random.default_rng(seed))


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(seed=st.integers(0, 2**32 - 1))
def test_random_trees_have_the_same_mechanics(seed: int) -> None:
    rng = np.random.default_rng(seed)
    assert_same_mechanics(random_model(rng), rng)


def compiled(body: str, rest: str = "") -> Any:
    """A model of one fixed base "base" that carries ``body``; angles in rad."""
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/><worldbody><body name="base">{body}</body></worldbody>'
        f"{rest}</mujoco>"
    )


ARM = """
<body name="upper">
  <joint name="a" axis="0 0 1" range="-0.5 0.7"/><geom name="upper" size="0.1"/>
  <body name="lower" pos="0.3 0 0">
    <joint name="c" type="slide" axis="1 0 0" range="-0.1 0.2" limited="false"/>
    <geom name="lower" size="0.1"/>
    <site name="near"/><site name="far" pos="0 0 0.2"/>
  </body>
</body>
"""


def test_limits_gravity_and_armature_are_copied() -> None:
    model = compiled(ARM.replace('name="a"', 'name="a" armature="0.25"'))
    ours = pinocchio_from_mujoco(model)
    np.testing.assert_array_equal(ours.lowerPositionLimit, [-0.5, -np.inf])
    np.testing.assert_array_equal(ours.upperPositionLimit, [0.7, np.inf])
    np.testing.assert_array_equal(ours.armature, [0.25, 0.0])
    np.testing.assert_array_equal(ours.gravity.linear, [0, 0, -9.81])
    assert np.isinf(ours.effortLimit).all()
    assert tuple(ours.names)[1:] == ("a", "c")


def test_joint_order_is_that_of_mujoco(right_hand: Hand) -> None:
    model = right_hand.mj_model
    names = tuple(model.joint(j).name for j in range(model.njnt))
    assert names == right_hand.joint_names == right_hand.actuation.joint_names
    np.testing.assert_array_equal(model.jnt_qposadr, np.arange(right_hand.nq))
    np.testing.assert_array_equal(right_hand.q_lower, model.jnt_range[:, 0])
    np.testing.assert_array_equal(right_hand.q_upper, model.jnt_range[:, 1])


def test_a_joint_without_name_is_called_by_its_number() -> None:
    ours = pinocchio_from_mujoco(compiled(ARM.replace('name="c"', "")))
    assert tuple(ours.names)[1:] == ("a", "joint_1")


# --- reading and compiling ------------------------------------------------------------------------


def test_a_missing_model_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"no model file .*gone\.xml; give the path of an MJCF"):
        load_spec(tmp_path / "gone.xml")


@pytest.mark.parametrize(
    "text", ["<mujoco><worldbody><body", "", "<html></html>", "<mujoco><banana/></mujoco>", "\0"]
)
def test_what_is_no_model_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "broken.xml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ModelError, match=r"MuJoCo cannot read .*broken\.xml as a model: \S"):
        load_spec(path)


def test_what_mujoco_cannot_compile_is_refused_with_its_reason() -> None:
    spec = mujoco.MjSpec.from_string(
        '<mujoco><worldbody><body><joint name="a"/></body></worldbody></mujoco>'
    )
    with pytest.raises(ModelError, match=r"MuJoCo cannot compile massless\.xml: .*mass"):
        compile_spec(spec, "massless.xml")


def test_a_mesh_file_that_is_missing_is_named(tmp_path: Path) -> None:
    path = tmp_path / "mesh.xml"
    path.write_text(
        '<mujoco><asset><mesh name="m" file="gone.stl"/></asset><worldbody><body>'
        '<geom type="mesh" mesh="m"/></body></worldbody></mujoco>',
        encoding="utf-8",
    )
    with pytest.raises(ModelError, match=r"MuJoCo cannot compile .*gone\.stl"):
        compile_spec(load_spec(path), str(path))


# --- geometry -------------------------------------------------------------------------------------

SOLIDS = """
<body name="a">
  <joint name="a" axis="0 0 1" pos="0.05 0 0.02"/>
  <geom name="sphere" size="0.03" pos="0 0 0.1"/>
  <geom name="capsule" type="capsule" fromto="0 0 0 0.1 0.2 0.05" size="0.01"/>
</body>
<body name="b" pos="0.4 0 0">
  <joint name="b" type="slide" axis="0 1 0"/>
  <geom name="cylinder" type="cylinder" size="0.03 0.05" pos="0 0.1 0" euler="0.3 0.5 0"/>
  <geom name="box" type="box" size="0.03 0.02 0.05" pos="0.2 0 0.3" quat="1 2 3 4"/>
  <body name="glued" pos="-0.1 0 0.2" quat="1 2 0 1">
    <geom name="ellipsoid" type="ellipsoid" size="0.03 0.02 0.05" pos="0 0 0.1" quat="1 0 1 4"/>
  </body>
  <geom name="mesh" type="mesh" mesh="wedge" pos="0.1 0.3 0.3" quat="2 0 1 0"/>
  <geom name="seen" size="0.5" contype="0" conaffinity="0" mass="0.1"/>
</body>
"""
WEDGE = """
<asset>
  <mesh name="wedge" vertex="0 0 0  0.1 0 0  0 0.1 0  0 0 0.1  0.1 0.1 0.02  0.03 0.03 0.03"/>
</asset>
"""


PROBE = 0.001  # m, radius of the ball that feels for the solids


def test_geometries_are_where_and_as_large_as_in_mujoco() -> None:
    # A small ball at random places sees the same distance to every solid in both engines.
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/>{WEDGE}<worldbody><body name="base">{SOLIDS}</body>'
        f'<body name="probe" mocap="true"><geom name="probe" size="{PROBE}" contype="0"'
        ' conaffinity="0"/></body></worldbody></mujoco>'
    )
    model.opt.ccd_tolerance = 1e-10
    ours = pinocchio_from_mujoco(model)
    geometries = {g.name: g for g in hand_geometries(model, ours)}
    kinds = ("sphere", "capsule", "cylinder", "box", "ellipsoid", "mesh")
    assert {name: g.kind for name, g in geometries.items()} == {kind: kind for kind in kinds}
    assert {g.body for g in geometries.values()} == {"a", "b", "glued"}
    data, ours_data = mujoco.MjData(model), ours.createData()
    rng = np.random.default_rng(0)
    for _ in range(30):
        data.qpos[:] = q = rng.uniform(-1, 1, 2)
        pin.forwardKinematics(ours, ours_data, q)
        data.mocap_pos[0] = rng.uniform(-1, 1, 3)
        mujoco.mj_kinematics(model, data)
        ball = pose_from_wxyz(data.mocap_pos[0], np.array([1.0, 0, 0, 0]))
        for name, g in geometries.items():
            pair = model.geom(name).id, model.geom("probe").id
            theirs = mujoco.mj_geomDistance(model, data, *pair, 10.0, None)
            if theirs <= 0:
                continue
            pose = ours_data.oMi[g.joint_id] * g.T_joint_geometry
            distance = DistancePair(g.geometry, coal.Sphere(PROBE)).query(pose, ball).distance
            assert distance == pytest.approx(theirs, abs=1e-6), name


def test_a_geom_that_cannot_collide_is_left_out() -> None:
    model = compiled(SOLIDS, WEDGE)
    names = [g.name for g in hand_geometries(model, pinocchio_from_mujoco(model))]
    assert "seen" not in names
    half = compiled(SOLIDS.replace('contype="0" conaffinity="0"', 'contype="0"'), WEDGE)
    assert "seen" in [g.name for g in hand_geometries(half, pinocchio_from_mujoco(half))]


def test_a_geom_without_name_is_refused() -> None:
    model = compiled(SOLIDS.replace('name="cylinder" ', ""), WEDGE)
    with pytest.raises(ModelError, match="geom of body 'b' has no name; name every geom"):
        hand_geometries(model, pinocchio_from_mujoco(model))


def test_a_plane_is_refused() -> None:
    model = compiled(SOLIDS + '<geom name="floor" type="plane" size="1 1 1"/>', WEDGE)
    with pytest.raises(ModelError, match=r"'floor' is a plane, a height field or .*; use a solid"):
        hand_geometries(model, pinocchio_from_mujoco(model))


FAMILY = """
<geom name="base" size="0.01"/>
<body name="thumb_1">
  <joint name="t1"/><geom name="t1" size="0.01"/><geom name="t1b" size="0.01"/>
  <body name="glued"><geom name="glued" size="0.01"/>
    <body name="thumb_2"><joint name="t2"/><geom name="t2" size="0.01"/></body>
  </body>
</body>
<body name="index_1">
  <joint name="i1"/><geom name="i1" size="0.01"/>
  <body name="index_2"><joint name="i2"/><geom name="i2" size="0.01"/></body>
</body>
"""


def test_neighbours_and_exclusions_may_touch_and_nobody_else() -> None:
    rest = '<contact><exclude body1="thumb_2" body2="index_2"/></contact>'
    pairs = allowed_pairs(compiled(FAMILY, rest), [("t2", "base")])
    # "glued" has no joint: it is one rigid link with thumb_1, and thumb_2's parent is that link.
    expected = {
        frozenset(pair)
        for pair in (
            ("t1", "t1b"),
            ("t1", "glued"),
            ("t1b", "glued"),
            ("base", "t1"),
            ("base", "t1b"),
            ("base", "glued"),
            ("base", "i1"),
            ("t2", "t1"),
            ("t2", "t1b"),
            ("t2", "glued"),
            ("i1", "i2"),
            ("t2", "i2"),  # excluded in the model
            ("t2", "base"),  # allowed by the description
        )
    }
    assert pairs == expected


def test_what_mujoco_lets_touch_is_what_we_check(right_hand: Hand) -> None:
    # MuJoCo itself collides no pair that is allowed here, except the palm's with its neighbours'.
    model = right_hand.mj_model
    data = mujoco.MjData(model)
    seen = set()
    rng = np.random.default_rng(0)
    for _ in range(100):
        data.qpos[:] = rng.uniform(right_hand.q_lower, right_hand.q_upper)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        seen |= {
            frozenset(model.geom(int(g)).name for g in data.contact.geom[i])
            for i in range(data.ncon)
        }
    assert seen
    assert not seen & right_hand.allowed_pairs


# --- actuators ------------------------------------------------------------------------------------

ACTUATED = """
<tendon>
  <fixed name="sum" range="-0.2 0.3">
    <joint joint="a" coef="1.5"/><joint joint="c" coef="-2"/>
  </fixed>
</tendon>
<actuator>
  <motor name="motor" joint="a" gear="3" ctrlrange="-1 1"/>
  <position name="servo" joint="c" kp="20" kv="2" forcerange="-5 4" gear="-0.5"/>
  <velocity name="speed" joint="a" kv="0.3"/>
  <general name="pull" tendon="sum" gear="2" gainprm="7" biastype="affine" biasprm="0.3 -4 -0.1"
    ctrlrange="-0.4 0.6"/>
</actuator>
"""


def test_moment_and_law_give_the_forces_of_mujoco() -> None:
    model = compiled(ARM.replace('name="a"', 'name="a" ref="0.2"'), ACTUATED)
    ours = actuation_from_mujoco(model)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    for _ in range(20):
        data.qpos[:], data.qvel[:] = rng.normal(size=2), rng.normal(size=2)
        data.ctrl[:] = ctrl = rng.uniform(-2, 2, 4)
        mujoco.mj_forward(model, data)
        length, velocity = ours.moment @ data.qpos + ours.length0, ours.moment @ data.qvel
        np.testing.assert_allclose(length, data.actuator_length, rtol=0, atol=1e-12)
        low, high = ours.ctrl_range.T
        force = (
            ours.gain * np.clip(ctrl, low, high)
            + ours.bias[:, 0]
            + ours.bias[:, 1] * length
            + ours.bias[:, 2] * velocity
        )
        force = np.clip(force, *ours.force_range.T)
        np.testing.assert_allclose(force, data.actuator_force, rtol=0, atol=1e-12)
        np.testing.assert_allclose(ours.moment.T @ force, data.qfrc_actuator, rtol=0, atol=1e-12)


def test_ranges_that_are_not_limited_are_infinite() -> None:
    ours = actuation_from_mujoco(compiled(ARM, ACTUATED))
    inf = np.inf
    np.testing.assert_array_equal(ours.ctrl_range, [[-1, 1], [-inf, inf], [-inf, inf], [-0.4, 0.6]])
    np.testing.assert_array_equal(
        ours.force_range, [[-inf, inf], [-5, 4], [-inf, inf], [-inf, inf]]
    )


def test_stops_are_the_limits_of_joints_and_tendons() -> None:
    ours = actuation_from_mujoco(compiled(ARM, ACTUATED))
    assert ours.stop_names == (
        "joint a lower",
        "joint a upper",
        "tendon sum lower",
        "tendon sum upper",
    )
    for q, inside in (([0.0, 0.0], True), ([0.71, 0.5], False), ([0.0, -0.16], False)):
        # sum = 1.5 a - 2 c: -0.16 on c alone gives 0.32 > 0.3
        assert bool((ours.stop_rows @ q >= ours.stop_values).all()) is inside


@pytest.mark.parametrize(
    ("actuator", "reason"),
    [
        ('<motor name="u" site="near"/>', "'u' drives neither a joint nor a fixed tendon"),
        ('<muscle name="u" joint="a" ctrlrange="0 1"/>', "'u' is not affine in ctrl"),
        ('<damper name="u" joint="a" kv="1" ctrlrange="0 1"/>', "'u' is not affine in ctrl"),
        ('<motor name="u" tendon="rope"/>', "'rope' runs through space; only fixed tendons"),
    ],
)
def test_actuators_of_other_kinds_are_refused(actuator: str, reason: str) -> None:
    rope = '<spatial name="rope"><site site="near"/><site site="far"/></spatial>'
    model = compiled(ARM, f"<tendon>{rope}</tendon><actuator>{actuator}</actuator>")
    with pytest.raises(ModelError, match=reason):
        actuation_from_mujoco(model)


def test_an_actuator_whose_force_follows_a_state_is_refused() -> None:
    actuator = '<intvelocity name="u" joint="a" kp="1" actrange="-1 1"/>'
    with pytest.raises(ModelError, match=r"'u' has dynamics of its own .*whose force follows ctrl"):
        actuation_from_mujoco(compiled(ARM, f"<actuator>{actuator}</actuator>"))


def test_a_filter_counts_by_what_it_does_at_rest() -> None:
    actuator = (
        '<general name="u" joint="a" dyntype="filter" dynprm="0.01" gainprm="3" ctrlrange="-1 2" '
        'actlimited="true" actrange="-0.5 5"/>'
    )
    model = compiled(ARM, f"<actuator>{actuator}</actuator>")
    ours = actuation_from_mujoco(model)
    np.testing.assert_array_equal(ours.ctrl_range, [[-0.5, 2.0]])
    data = mujoco.MjData(model)
    for ctrl, force in ((0.4, 1.2), (-0.9, -1.5)):  # the state stops at -0.5
        data.ctrl[0] = ctrl
        for _ in range(200):  # twenty time constants of 10 ms, with the arm held
            data.qpos[:] = data.qvel[:] = 0.0
            mujoco.mj_step(model, data)
        assert data.actuator_force[0] == pytest.approx(force, abs=1e-6)
        assert ours.gain[0] * np.clip(ctrl, *ours.ctrl_range[0]) == pytest.approx(force, abs=1e-12)


def test_a_motor_in_the_parent_frame_is_a_motor_on_the_joint() -> None:
    model = compiled(ARM, '<actuator><motor name="u" jointinparent="a" gear="2"/></actuator>')
    np.testing.assert_array_equal(actuation_from_mujoco(model).moment, [[2.0, 0.0]])


def test_a_limit_of_a_joint_limits_its_actuator() -> None:
    arm = ARM.replace('name="a"', 'name="a" actuatorfrcrange="-1 3"')
    text = (
        '<actuator><motor name="u" joint="a" gear="-2" forcelimited="true" forcerange="-9 0.25"/>'
        "</actuator>"
    )
    model = compiled(arm, text)
    ours = actuation_from_mujoco(model)
    np.testing.assert_array_equal(ours.force_range, [[-1.5, 0.25]])
    data = mujoco.MjData(model)
    for ctrl, torque in ((9.0, -0.5), (-9.0, 3.0)):  # torque = -2 force
        data.ctrl[0] = ctrl
        mujoco.mj_forward(model, data)
        assert data.qfrc_actuator[0] == torque
        assert -2 * np.clip(ctrl, *ours.force_range[0]) == torque


def test_a_limit_on_the_sum_of_two_actuators_is_refused() -> None:
    arm = ARM.replace('name="a"', 'name="a" actuatorfrcrange="-1 3"')
    text = '<actuator><motor name="u" joint="a"/><motor name="v" joint="a"/></actuator>'
    with pytest.raises(ModelError, match=r"joint 'a' limits the sum of .*'u', 'v'.* forcerange"):
        actuation_from_mujoco(compiled(arm, text))


def test_springs_are_those_of_mujoco() -> None:
    arm = ARM.replace('name="a"', 'name="a" stiffness="2" springref="0.3"')
    text = (
        '<tendon><fixed name="t" stiffness="5" springlength="0.2">'
        '<joint joint="a" coef="1.5"/><joint joint="c" coef="-2"/></fixed></tendon>'
    )
    model = compiled(arm, text)
    ours = actuation_from_mujoco(model)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(3)
    for _ in range(5):
        data.qpos[:] = rng.uniform(-0.4, 0.4, 2)
        mujoco.mj_forward(model, data)
        expected = data.qfrc_spring
        assert np.abs(expected).max() > 0.01
        np.testing.assert_allclose(ours.passive_torque(data.qpos), expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("joint", "tendon"),
    [('stiffness="2 1"', 'stiffness="0"'), ("", 'stiffness="5" springlength="0.1 0.4"')],
)
def test_springs_that_are_not_linear_are_refused(joint: str, tendon: str) -> None:
    text = f'<tendon><fixed name="t" {tendon}><joint joint="c" coef="1"/></fixed></tendon>'
    model = compiled(ARM.replace('name="a"', f'name="a" {joint}'), text)
    with pytest.raises(ModelError, match=r"springs of .*('a'|'t') are not linear; give each one"):
        actuation_from_mujoco(model)
