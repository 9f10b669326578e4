"""Moment arms of actuators: MuJoCo's own, and the same for everyone who reads them."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from planner.bridge import actuation_from_mujoco
from planner.bridge.pinocchio_model import actuator_row, effort_limits, is_fixed_tendon, tendon_row
from planner.bridge.structure import structure_of
from planner.errors import ModelError

MODEL = """
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <site name="here"/>
    <body name="a"><joint name="a" axis="0 0 1"/><geom size="0.1"/>
      <body name="b" pos="0 0 0.1"><joint name="b" type="slide" axis="0 1 0"/><geom size="0.1"/>
        <site name="there" pos="0.1 0 0"/>
        <body name="c" pos="0 0 0.1"><joint name="c" axis="1 0 0"/><geom size="0.1"/></body>
      </body>
    </body>
  </worldbody>
  <tendon>
    <fixed name="t"><joint joint="a" coef="0.5"/><joint joint="c" coef="-2"/></fixed>
    <spatial name="s"><site site="here"/><site site="there"/></spatial>
  </tendon>
  <actuator>
    <motor name="gear" joint="a" gear="-3" forcerange="-1 1"/>
    <motor name="slide" joint="b" gear="40" forcerange="-1 1"/>
    <position name="in parent" jointinparent="c" gear="2" forcerange="-1 1"/>
    <motor name="fixed" tendon="t" gear="0.1" forcerange="-1 1"/>
    {more}
  </actuator>
</mujoco>
"""
BENT = {
    "spatial tendon": '<motor name="bent" tendon="s" forcerange="-1 1"/>',
    "site": '<motor name="bent" site="there" gear="1 0 0 0 0 0" forcerange="-1 1"/>',
}


def compiled(more: str = "") -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(MODEL.format(more=more))


def test_rows_are_mujoco_s_moments_at_any_q() -> None:
    model = compiled()
    data = mujoco.MjData(model)
    data.qpos[:] = [0.3, 0.02, -0.7]
    mujoco.mj_forward(model, data)
    moment = np.zeros((model.nu, model.nv))
    mujoco.mju_sparse2dense(
        moment, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind
    )
    rows = [actuator_row(model, i) for i in range(model.nu)]
    np.testing.assert_allclose(np.array(rows), moment, atol=1e-15)
    np.testing.assert_array_equal(moment[2], [0, 0, 2])  # in the parent: the same for a hinge


def test_everyone_reads_the_same_rows() -> None:
    model = compiled()
    moment = actuation_from_mujoco(model).moment
    np.testing.assert_array_equal([a.row for a in structure_of(model).actuators], moment)
    np.testing.assert_array_equal(effort_limits(model)[:, 1], np.abs(moment).sum(axis=0))


@pytest.mark.parametrize("kind", BENT)
def test_arms_that_depend_on_q_are_no_row(kind: str) -> None:
    model = compiled(BENT[kind])
    assert actuator_row(model, 4) is None
    np.testing.assert_array_equal(structure_of(model).actuators[4].row, np.zeros(3))
    assert np.isinf(effort_limits(model)).all()
    message = "tendon 's' runs through space" if "tendon" in kind else "'bent' drives neither"
    with pytest.raises(ModelError, match=message):
        actuation_from_mujoco(model)


def test_tendons_through_space_have_no_coefficients() -> None:
    model = compiled()
    assert [is_fixed_tendon(model, t) for t in range(2)] == [True, False]
    np.testing.assert_array_equal(tendon_row(model, 0), [0.5, 0, -2])
    with pytest.raises(ModelError, match=r"'s' runs through space.*drop_couplings"):
        tendon_row(model, 1)
