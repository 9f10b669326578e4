"""Parts without names, strengths and losses in the Pinocchio model that the bridge builds."""

from __future__ import annotations

import mujoco
import numpy as np
import pinocchio as pin

from planner.bridge.pinocchio_model import (
    body_name,
    effort_limits,
    joint_name,
    pinocchio_from_mujoco,
    site_name,
)
from sim.crosscheck.mujoco_side import layout_of
from sim.crosscheck.pinocchio_side import match

NAMELESS = """
<mujoco><worldbody>
  <site/>
  <body name="body_2"><joint name="joint_1"/><geom size="0.1"/><site name="site_2"/>
    <body><joint axis="1 0 0"/><geom size="0.1"/><site/></body>
  </body>
</worldbody></mujoco>
"""


def test_parts_without_names_are_called_by_their_number_and_stay_apart() -> None:
    model = mujoco.MjModel.from_xml_string(NAMELESS)
    assert [body_name(model, b) for b in range(3)] == ["world", "body_2", "body_2_"]
    assert [joint_name(model, j) for j in range(2)] == ["joint_1", "joint_1_"]
    assert [site_name(model, s) for s in range(3)] == ["site_0", "site_2", "site_2_"]
    ours = pinocchio_from_mujoco(model)
    assert list(ours.names) == ["universe", "joint_1", "joint_1_"]
    assert ours.existFrame("body_2_", pin.FrameType.BODY)
    assert ours.existFrame("site_2_", pin.FrameType.OP_FRAME)


DRIVEN = """
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <body name="a"><joint name="a" axis="0 0 1" damping="0.5" frictionloss="0.2" armature="0.1"/>
      <geom size="0.1"/>
      <body name="b"><joint name="b" axis="0 1 0" actuatorfrcrange="-1 1.5"/><geom size="0.1"/>
        <body name="c"><joint name="c" axis="1 0 0"/><geom size="0.1"/>
          <body name="d"><joint name="d" axis="1 0 0"/><geom size="0.1"/>
            <body name="e"><joint name="e" axis="1 0 0" actuatorfrcrange="-4 3"/>
              <geom size="0.1"/></body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <tendon><fixed name="t"><joint joint="a" coef="0.5"/><joint joint="b" coef="-2"/></fixed></tendon>
  <actuator>
    <motor joint="a" gear="-3" forcerange="-1 2"/>
    <position tendon="t" kp="5" gear="2" forcerange="-1 3"/>
    <motor joint="c"/>
  </actuator>
</mujoco>
"""


def test_effort_limits_are_the_sum_of_what_actuators_give() -> None:
    limits = effort_limits(mujoco.MjModel.from_xml_string(DRIVEN))
    expected: list[list[float]] = [
        [-6 - 1, 3 + 3],  # gear -3 times [-1, 2], and gear 2 x coefficient 0.5 times [-1, 3]
        [-1, 1.5],  # gear 2 x coefficient -2 times [-1, 3] = [-12, 4], within the joint's range
        [-np.inf, np.inf],  # a motor without range
        [-np.inf, np.inf],  # nothing drives it: nothing is stated
        [-4, 3],  # only the joint's own range
    ]
    np.testing.assert_allclose(limits, expected)


def test_a_moment_that_depends_on_q_gives_no_limit() -> None:
    text = DRIVEN.replace(
        '<motor joint="c"/>', '<motor site="s" refsite="s" gear="1 0 0 0 0 0" forcerange="-1 1"/>'
    ).replace('<body name="e">', '<site name="s"/><body name="e">')
    limits = effort_limits(mujoco.MjModel.from_xml_string(text))
    np.testing.assert_array_equal(limits[[0, 2, 3]], [[-np.inf, np.inf]] * 3)
    np.testing.assert_array_equal(limits[[1, 4]], [[-1, 1.5], [-4, 3]])


def test_losses_and_efforts_are_copied() -> None:
    model = mujoco.MjModel.from_xml_string(DRIVEN)
    ours = pinocchio_from_mujoco(model)
    np.testing.assert_array_equal(ours.damping, [0.5, 0, 0, 0, 0])
    np.testing.assert_array_equal(ours.upperDryFrictionLimit, [0.2, 0, 0, 0, 0])
    np.testing.assert_array_equal(ours.lowerDryFrictionLimit, [-0.2, 0, 0, 0, 0])
    np.testing.assert_array_equal(ours.armature, [0.1, 0, 0, 0, 0])
    np.testing.assert_array_equal(ours.upperEffortLimit, effort_limits(model)[:, 1])
    np.testing.assert_array_equal(ours.lowerEffortLimit, effort_limits(model)[:, 0])


def test_a_model_without_joints_or_actuators_is_no_special_case() -> None:
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body mocap="true"><geom size="1"/></body></worldbody></mujoco>'
    )
    ours = pinocchio_from_mujoco(model)
    assert (ours.nq, ours.nv, ours.njoints) == (0, 0, 1)
    assert ours.existFrame("body_1", pin.FrameType.BODY)


def test_inertia_without_mass_counts() -> None:
    # a URDF may give a foot a moment of inertia and no mass
    inertial = '<inertial pos="0 0 0" mass="{}" diaginertia="0.1 0.2 0.3"/>'
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body name="a"><joint axis="0 0 1"/>'
        f'{inertial.format(1)}<body name="b">{inertial.format(0)}</body></body>'
        "</worldbody></mujoco>"
    )
    assert model.body_mass[2] == 0
    ours = pinocchio_from_mujoco(model)
    np.testing.assert_allclose(ours.inertias[1].inertia, np.diag([0.2, 0.4, 0.6]))


def test_what_mujoco_snaps_to_a_frame_stands_where_mujoco_puts_it() -> None:
    inertial = '<inertial pos="3e-7 0 0.1" quat="1 0.2 0 0" mass="1" diaginertia="0.1 0.2 0.3"/>'
    sites = (
        '<site name="a" pos="3e-7 0 0"/><site name="b" pos="3e-7 3e-7 0.1" quat="1 0.2 0 0"/>'
        '<site name="c" pos="0 0 1" quat="1 3e-7 0 0"/><site name="d" quat="1 0.2 3e-7 0"/>'
        '<site name="e" pos="3e-6 0 0" quat="1 3e-6 0 0"/>'
    )
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody><body><joint/>{inertial}{sites}</body></worldbody></mujoco>"
    )
    assert sorted(model.site_sameframe) == [0, 1, 2, 3, 4]
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    ours = pinocchio_from_mujoco(model)
    for s in range(model.nsite):
        pose = ours.frames[ours.getFrameId(model.site(s).name, pin.FrameType.OP_FRAME)].placement
        np.testing.assert_allclose(pose.translation, data.site_xpos[s], rtol=0, atol=1e-14)
        np.testing.assert_allclose(pose.rotation.ravel(), data.site_xmat[s], rtol=0, atol=1e-14)


def test_a_body_is_the_reading_of_one_body_alone() -> None:
    """Two that are told to be the same one: the second is not found, and compared with nothing."""
    model = mujoco.MjModel.from_xml_string(DRIVEN)
    ours = pinocchio_from_mujoco(model)
    parts = match(ours, "reader", layout_of(model), {"b": "c"}).parts()
    assert parts.bodies == {"a", "b", "d", "e"} and "body b" in parts.others
