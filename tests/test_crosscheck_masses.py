"""The cross-check of masses: whole inertia tensors, and a total mass that a reader ignores."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from planner.bridge import pinocchio_from_mujoco
from sim.crosscheck import READER, compare_models, crosscheck
from sim.crosscheck.mujoco_side import efforts

WHEEL = """
<mujoco><option gravity="0 0 -9.81"/><worldbody><body name="wheel">
  <joint name="spin" axis="0 0 1"/>
  <inertial pos="0 0 0" mass="0.4" fullinertia="3e-3 4e-3 5e-3 {xy} {xz} {yz}"/>
</body></worldbody></mujoco>
"""
"""A body on one hinge: only the inertia about its axis shows in how it moves."""


def wheel(**products: float) -> mujoco.MjModel:
    named = {"xy": 2e-4, "xz": -3e-4, "yz": 1e-4} | products
    return mujoco.MjModel.from_xml_string(WHEEL.format(**named))


@pytest.mark.parametrize(("product", "place"), [("xy", (0, 1)), ("xz", (0, 2)), ("yz", (1, 2))])
@pytest.mark.parametrize("as_pinocchio", [False, True])
def test_a_wrong_product_of_inertia_is_a_fault(
    product: str, place: tuple[int, int], as_pinocchio: bool
) -> None:
    true = wheel()
    assert compare_models(true, pinocchio_from_mujoco(true), n_configurations=2).ok
    other = wheel(**{product: 7e-4})
    if as_pinocchio:
        other = pinocchio_from_mujoco(true)
        tensor = other.inertias[1].inertia.copy()
        i, j = place
        tensor[i, j] = tensor[j, i] = 7e-4
        other.inertias[1] = pin.Inertia(0.4, np.zeros(3), tensor)
    report = compare_models(true, other, n_configurations=2)
    assert not report.ok
    faults = {(d.quantity, d.part) for d in report.columns[0].faults}
    assert faults == {("inertia", "wheel")}


SCALED = """
<mujoco><compiler angle="radian" settotalmass="2"/><worldbody><body name="base">
  <inertial pos="0 0 0.01" mass="0.5" diaginertia="0.01 0.02 0.03"/>
  <body name="link"><joint name="j" axis="0 1 0" range="-1 1"/>
    <inertial pos="0.01 0 0" mass="0.3" diaginertia="0.01 0.01 0.01"/>
  </body>
</body></worldbody></mujoco>
"""
"""0.8 kg as it is written, 2 kg as it is meant."""


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:compiler attribute 'settotalmass' is deprecated")
def test_a_total_mass_that_the_reader_ignores_is_named(tmp_path: Path) -> None:
    path = tmp_path / "scaled.xml"
    path.write_text(SCALED, encoding="utf-8")
    column = crosscheck(path, n_configurations=1).column(READER)
    assert set(column.causes) == {"mass"}
    assert column.causes["mass"] == "settotalmass is ignored there"
    assert column.unexplained == ()


CARRIED = """
<mujoco><worldbody><body name="link"><joint name="j" axis="0 1 0"/>
  <inertial pos="0 0 0" mass="{link}" diaginertia="1e-4 1e-4 1e-4"/>
  <body name="tool" pos="0 0 0.1">
    <inertial pos="0 0 -0.1" mass="{tool}" diaginertia="1e-4 1e-4 1e-4"/>
  </body>
</body></worldbody></mujoco>
"""
"""A body fixed to a link, with its centre of mass in the link's."""


def test_a_body_that_is_fixed_to_a_link_has_a_mass_of_its_own() -> None:
    true, moved = (
        mujoco.MjModel.from_xml_string(CARRIED.format(link=link, tool=tool))
        for link, tool in ((0.4, 0.2), (0.5, 0.1))
    )
    assert compare_models(true, true, n_configurations=1).ok
    # as a whole both move alike, and the masses of both bodies are still faults
    faults = compare_models(true, moved, n_configurations=2).columns[0].faults
    assert {(d.quantity, d.part) for d in faults} == {("mass", "link"), ("mass", "tool")}


def test_an_actuator_that_only_pulls_has_a_limit() -> None:
    model = mujoco.MjModel.from_xml_string("""
        <mujoco><worldbody>
          <body><joint name="pulled"/><geom size="0.1"/></body>
          <body><joint name="free"/><geom size="0.1"/></body>
        </worldbody>
        <actuator><motor joint="pulled" gear="3" forcelimited="true" forcerange="0 2"/></actuator>
        </mujoco>""")
    np.testing.assert_allclose(efforts(model), [[0.0, 6.0], [-np.inf, np.inf]])
