"""The cross-check reads whole inertia tensors, also where no movement of the model shows them."""

from __future__ import annotations

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from planner.bridge import pinocchio_from_mujoco
from sim.crosscheck import compare_models

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
