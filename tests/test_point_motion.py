"""How points and distances change with the joints, beside Pinocchio."""

from __future__ import annotations

import numpy as np

from planner.hands.hand import Hand
from planner.kinematics import HandState, point_jacobians, point_rates
from planner.spatial import cross


def test_many_points_move_as_pinocchio_moves_each(right_hand: Hand) -> None:
    rng = np.random.default_rng(1)
    state = HandState(right_hand, rng.uniform(right_hand.q_lower, right_hand.q_upper))
    joints, points = rng.integers(0, right_hand.nq + 1, 9), rng.normal(size=(9, 3))
    directions = rng.normal(size=(9, 3))
    given = state.pin_data.J, right_hand.moved_by, joints, points
    found = point_jacobians(*given)
    expected = np.array(
        [state.point_jacobian(int(j), p) for j, p in zip(joints, points, strict=True)]
    )
    np.testing.assert_allclose(found, expected, atol=1e-12)
    rates = point_rates(*given, directions)
    np.testing.assert_allclose(
        rates, np.einsum("ni,nij->nj", directions, expected[:, :3]), atol=1e-12
    )


def test_the_cross_product_is_numpys() -> None:
    a, b = np.random.default_rng(0).normal(size=(2, 5, 3))
    assert (cross(a, b) == np.cross(a, b)).all()
    assert (cross(a[0], b[0]) == np.cross(a[0], b[0])).all()
