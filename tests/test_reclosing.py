"""Touching again: when it happens, what it commands, and how long a phase waits for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import PlanOf
from test_offsets import look_of
from test_sim_controllers import observe

from planner.plan import GraspPlan
from planner.spatial import FloatArray
from sim.controllers import Observation, PadReading
from sim.controllers.calibration import Calibration
from sim.controllers.grasp import CLOSE_TIME, LONGEST, OPEN_TIME, Reclosing, closing_ended

DT = 0.002


@pytest.fixture(scope="module")
def plan(plan_of: PlanOf) -> GraspPlan:
    return plan_of("allegro_hand", "ellipsoid")


def touching(plan: GraspPlan, offset: FloatArray) -> Observation:
    """All fingers at their planned contacts, with encoders that are off."""
    look, base = look_of(plan, offset), plan.T_world_base
    assert look.points is not None
    assert look.normals is not None
    n = len(look.points)
    pads = replace(
        PadReading.nothing(n),
        normal_force=np.full(n, 0.5),
        position=np.array([base.act(p) for p in look.points]),
        normal=look.normals @ base.rotation.T,
    )
    seen = observe(plan, "close", q=look.q, force=0.5)
    return replace(seen, read_pads=lambda: pads)


def off_by(plan: GraspPlan, degrees: float) -> FloatArray:
    return np.asarray(np.deg2rad(degrees) * np.random.default_rng(1).standard_normal(len(plan.q)))


def test_exact_joints_touch_once_and_are_left_alone(plan: GraspPlan) -> None:
    calibration = Calibration(plan)
    closing = Reclosing(plan, calibration)
    seen = touching(plan, np.zeros(len(plan.q)))
    closing.step(DT, seen)
    assert calibration.estimate is not None
    assert calibration.estimate.misfit < 0.3
    assert not (closing.again or closing.busy or calibration.offset.any())
    assert calibration.correct(seen) is seen


def test_joints_that_are_off_open_and_close_where_they_are(plan: GraspPlan) -> None:
    calibration = Calibration(plan)
    closing = Reclosing(plan, calibration)
    seen = touching(plan, off_by(plan, 3.0))
    closing.step(DT, seen)
    assert closing.again
    offset = calibration.offset
    assert offset.any()
    free = replace(seen, normal_forces=np.zeros(len(plan.task.fingers)))
    open_steps, close_steps = round(OPEN_TIME / DT), round(CLOSE_TIME / DT)
    opened = [closing.step(DT, free) for _ in range(open_steps)][-1]
    np.testing.assert_allclose(opened, plan.q_pregrasp + offset, atol=1e-3)
    for _ in range(close_steps):
        down = closing.step(DT, free)
    np.testing.assert_allclose(down, plan.q + offset, atol=1e-3)
    seen_busy = [closing.busy]
    closing.step(DT, seen)  # all touch again
    assert [*seen_busy, closing.busy] == [True, False]
    assert calibration.offset is offset


def test_a_finger_that_never_comes_does_not_keep_it_busy(plan: GraspPlan) -> None:
    closing = Reclosing(plan, Calibration(plan))
    closing.step(DT, touching(plan, off_by(plan, 3.0)))
    free = replace(touching(plan, off_by(plan, 3.0)), normal_forces=np.zeros(4))
    for _ in range(round((OPEN_TIME + CLOSE_TIME + LONGEST) / DT) + 2):
        closing.step(DT, free)
    assert not closing.busy


def test_corrected_pads_are_nearer_to_where_they_are(plan: GraspPlan) -> None:
    calibration = Calibration(plan)
    seen = touching(plan, off_by(plan, 3.0))
    assert calibration.learn(seen)
    true = plan.contacts.positions
    before = np.linalg.norm(seen.pads.position - true, axis=1)
    after = np.linalg.norm(calibration.correct(seen).pads.position - true, axis=1)
    assert np.sqrt(np.mean(after**2)) < 0.7 * np.sqrt(np.mean(before**2))


def test_a_contact_beside_its_pad_tells_nothing(plan: GraspPlan) -> None:
    """A link above the tip touches: its place says nothing of where the tip is."""
    seen = touching(plan, off_by(plan, 3.0))
    pads = seen.pads
    strayed = pads.position.copy()
    strayed[1] -= 0.02 * pads.normal[1]
    without = pads.position.copy()
    without[1] = np.nan

    def learned(positions: FloatArray) -> FloatArray:
        calibration = Calibration(plan)
        moved = replace(pads, position=positions)
        assert calibration.learn(replace(seen, read_pads=lambda: moved))
        return calibration.offset

    np.testing.assert_array_equal(learned(strayed), learned(without))
    assert not np.array_equal(learned(pads.position), learned(without))
    everywhere = replace(pads, position=pads.position - 0.02 * pads.normal)
    assert not Calibration(plan).learn(replace(seen, read_pads=lambda: everywhere))


class Busy:
    closing = True


def test_a_phase_waits_as_long_as_it_did_and_longer_for_a_second_closing(plan: GraspPlan) -> None:
    felt = observe(plan, "close", force=0.5)
    none = observe(plan, "close")
    once = closing_ended(object(), 5 * DT, DT)
    assert [once(none) for _ in range(7)] == [False] * 5 + [True] * 2
    assert closing_ended(object(), 5 * DT, DT)(felt)
    busy = Busy()
    again = closing_ended(busy, 5 * DT, DT)
    assert not any(again(felt) for _ in range(20))
    busy.closing = False
    assert again(felt)
