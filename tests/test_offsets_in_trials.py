"""Trials with joints that are off: what is mended, by which part, and that exact joints stay."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import PlanOf

from planner.plan import GraspPlan
from planner.spatial import FloatArray
from sim.controllers.calibration import Calibration, StopCorrection
from sim.controllers.hand_dynamics import ContactForceLimit
from sim.report import TrialReport
from sim.scene.carrier import Timeline
from sim.sensing.errors import ERROR_MODELS
from sim.trial import simulate

pytestmark = pytest.mark.usefixtures("coarse_steps")

QUICK = Timeline(hold=0.5)
OFFSETS = ERROR_MODELS["rough"].only("encoder_offset")  # 3 degrees
SEED = 201
"""A draw in which closed stops of the Shadow-type hand are read as open."""


@pytest.fixture(scope="module")
def plan(plan_of: PlanOf) -> GraspPlan:
    return plan_of("shadow_hand", "ellipsoid", seed=SEED)


def held(plan: GraspPlan, controller: str, seed: int = SEED) -> TrialReport:
    return simulate(plan, controller=controller, error_model=OFFSETS.seeded(seed), timeline=QUICK)


@pytest.mark.slow
@pytest.mark.parametrize("controller", ["feedforward", "impedance"])
def test_three_degrees_are_borne_by_tendons_and_stops(plan: GraspPlan, controller: str) -> None:
    report = held(plan, controller)
    assert report.success, report.verdict.detail


@pytest.mark.slow
def test_a_controller_that_trusts_its_encoders_loses_it(
    plan: GraspPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same trial, stops judged by the reading alone and no sample at the contacts."""

    def as_read(_: StopCorrection, q: FloatArray) -> FloatArray:
        return q

    monkeypatch.setattr(StopCorrection, "corrected", as_read)
    monkeypatch.setattr(Calibration, "learn", lambda *_: False)
    assert not held(plan, "impedance").success


@pytest.mark.slow
def test_a_free_hand_does_not_notice_the_light_touch(
    plan: GraspPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    with_it = simulate(plan, timeline=QUICK)
    monkeypatch.setattr(ContactForceLimit, "commands", lambda _self, ctrl, *_: ctrl)
    without = simulate(plan, timeline=QUICK)
    assert with_it.success
    np.testing.assert_array_equal(with_it.samples.normal_force, without.samples.normal_force)
