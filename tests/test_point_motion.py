"""How points and distances change with the joints: compiled, in NumPy, and by Pinocchio."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from planner.approach import pregrasp_ik
from planner.hands.hand import Hand
from planner.kinematics.point_motion import point_jacobians, point_rates
from planner.kinematics.state import HandState
from planner.numerics import ik_step
from planner.spatial import contact_frames, cross

KERNELS = pytest.mark.parametrize("form", ["plain", "loops"])


@KERNELS
def test_many_points_move_as_pinocchio_moves_each(right_hand: Hand, form: str) -> None:
    rng = np.random.default_rng(1)
    state = HandState(right_hand, rng.uniform(right_hand.q_lower, right_hand.q_upper))
    joints, points = rng.integers(0, right_hand.nq + 1, 9), rng.normal(size=(9, 3))
    directions = rng.normal(size=(9, 3))
    given = state.pin_data.J, right_hand.moved_by, joints, points
    found = getattr(point_jacobians, form)(*given)
    expected = np.array(
        [state.point_jacobian(int(j), p) for j, p in zip(joints, points, strict=True)]
    )
    np.testing.assert_allclose(found, expected, atol=1e-12)
    rates = getattr(point_rates, form)(*given, directions)
    np.testing.assert_allclose(
        rates, np.einsum("ni,nij->nj", directions, expected[:, :3]), atol=1e-12
    )


def test_both_forms_of_the_pre_grasps_kernels_agree(right_hand: Hand) -> None:
    rng = np.random.default_rng(3)
    fingers = list(right_hand.fingers.values())
    q = rng.uniform(right_hand.q_lower, right_hand.q_upper)
    state = HandState(right_hand, q)
    joints, centers = state.pads(fingers)
    inward = contact_frames(rng.normal(size=centers.shape))[:, :, 0]
    opening: Any = pregrasp_ik._opening
    given = state.pin_data.J, right_hand.moved_by, joints, centers, centers - 0.01, inward, 0.02
    quick, slow = opening.loops(*given), opening.plain(*given)
    for one, other in zip(quick, slow, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12)

    rows, misses, rates, shares = quick
    n, matrix = right_hand.nq, rng.normal(size=(2, right_hand.nq))
    barrier = np.arange(len(shares)) % 2
    programme: Any = ik_step._programme
    task = rows, misses, rates, shares, barrier, np.array([1.0, 2.0]), matrix, np.ones(2)
    whole = *task, -np.ones(n), np.ones(n), q, (0.05, 0.2, 100.0)
    for one, other in zip(programme.loops(*whole), programme.plain(*whole), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12)


def test_the_cross_product_is_numpys() -> None:
    a, b = np.random.default_rng(0).normal(size=(2, 5, 3))
    assert (cross(a, b) == np.cross(a, b)).all()
    assert (cross(a[0], b[0]) == np.cross(a[0], b[0])).all()
