"""The postures ``pinch`` and ``open``: pads around a handle, the opposer against the others.

In both, every pad looks at one common segment from the same distance, as if the fingers held a
capsule that is as long as the row of fingers is wide, a ball where there is no row: a thin one in
``pinch``, a thick one in ``open``, or the thickest the hand can. Couplings hold, no joint leaves
its range, and neither the hand nor the capsule touches the hand where it must not. Found by least
squares from a fixed set of starts, so that the same model gives the same postures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planner.couplings import nearest_on_couplings
from planner.describe.overlaps import TOUCHING, HandGaps
from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.kinematics.state import HandState
from planner.spatial import FloatArray

__all__ = ["OPEN_RADII", "PINCH_RADII", "PosturePart", "PostureSolver"]

PINCH_RADII = (0.022, 0.028, 0.018, 0.034)
"""Radii (m) of the ball held in the pinch posture, tried in this order."""

OPEN_RADII = (0.045, 0.040, 0.035, 0.030, 0.026)
"""The same for the open posture: as wide as the hand can."""

STARTS = 6
"""Starts of the search for a posture where resting fingers do not lead to one."""

KEPT = 2
"""Results that are refined with collisions, the costliest part."""

LENGTH = 0.003
"""Deviation (m) that costs as much as one radian."""

ROW_SHARE = 1.0
"""Length of the handle over the width of the row of fingers (-)."""

PAD_GAP = 0.003
"""Least distance (m) between pads, and between parts of the hand that must not touch."""

BALL_GAP = 0.003
"""Least distance (m) of the ball from everything but the links that carry pads."""

CONE_SHARE = 0.6
"""Share of a pad's cone within which a posture should look at the ball (-)."""

PRESS = 6.0
"""Force (N) with which each pad shall be able to press: a servo at the end of its range cannot."""

MARGIN = 0.05
"""Share of a joint's range that it should keep from both ends: there a servo has no force left."""

STRENGTH = 0.1
"""Missing torque (N m) that costs as much as one radian."""

CENTERING = 0.5
"""Weight of the opposer's looking at the middle of the others, not only at the handle (-)."""

REST_WEIGHT = 0.08
"""Cost of a joint that leaves its resting place by its whole range."""

ALIKE = 0.7
"""Cosine between two axes above which two joints bend a finger the same way."""

REST_SHARE = 0.35
"""Resting place of a joint that bends one way: this share of its range (-)."""

MOST_BENT = 0.55
"""Resting place (rad) that no joint exceeds, however far it bends."""

RANGE_TOL = 1e-9
"""How far (rad or m) a follower may leave its range by rounding alone."""

GOOD_DISTANCE, GOOD_OPPOSITION, GOOD_FACING = 0.004, np.deg2rad(35.0), np.deg2rad(10.0)
"""A posture is good if pads miss the ball by at most this (m), the opposer looks against the others
within this angle (rad), and pads leave their cones by at most that (rad)."""


@dataclass(frozen=True, kw_only=True)
class PosturePart:
    """A posture found by the search.

    Attributes:
        q: (nq,), rad or m.
        radius: Radius of the ball that the pads hold, m.
        distance_error: Largest miss of a pad, m.
        opposition_error: Angle by which opposer and others do not look at each other, rad.
        facing_error: Largest angle by which a pad looks past the ball beyond its cone, rad.
        clearance: Smallest distance between parts of the hand that must not touch, m.
    """

    q: FloatArray
    radius: float
    distance_error: float
    opposition_error: float
    facing_error: float
    clearance: float

    @property
    def good(self) -> bool:
        """Whether the planner can start from it unchanged."""
        return (
            self.distance_error <= GOOD_DISTANCE
            and self.opposition_error <= GOOD_OPPOSITION
            and self.facing_error <= GOOD_FACING
            and self.clearance >= TOUCHING
        )


class PostureSolver:
    """Looks for postures of some fingers of a hand; the first finger is the opposer."""

    def __init__(self, hand: Hand, fingers: Sequence[Finger]) -> None:
        """Split the joints into free ones and those that couplings determine."""
        self.hand, self.fingers = hand, tuple(fingers)
        self._data = hand.pin_model.createData()
        low, high = hand.q_lower, hand.q_upper
        self._span = np.maximum(high - low, 1e-9)
        one_way = np.abs(high + low) > 0.3 * self._span
        bent = np.where(np.abs(high) >= np.abs(low), high, low) * REST_SHARE
        bent = np.clip(bent, -MOST_BENT, MOST_BENT)
        self.rest = np.clip(np.where(one_way & self._curling(), bent, 0.0), low, high)
        matrix, value = hand.coupling_matrix
        # fingers that take no part may make room
        active = sorted({int(k) for f in hand.fingers.values() for k in f.q_index})
        self._dependent, self._map, self._offset = _eliminate(matrix, value)
        tied = set(self._dependent)
        self._free = np.array([k for k in active if k not in tied], dtype=int)
        idle = [k for k in range(hand.nq) if k not in tied and k not in set(self._free)]
        self._idle = np.array(idle, dtype=int)
        self._pads = [f.pad for f in self.fingers]
        self._radii = np.array([p.radius for p in self._pads])
        self._cones = np.array([p.half_angle for p in self._pads])
        self._gaps = HandGaps(hand, PAD_GAP)
        self._carriers = {hand.pin_model.getJointId(f.joints[-1]) for f in self.fingers}
        self._row, self._half = self._row_of_fingers()

    def solve(self, radii: Sequence[float], near: FloatArray | None = None) -> PosturePart:
        """The first good posture around a ball of one of the radii; else the best of all.

        Args:
            radii: Radii to try in this order, m.
            near: A posture (nq,) to start from as well.
        """
        rest = self.rest[self._free] if near is None else near[self._free]
        found = []
        # from where the fingers rest the way is mostly short; only else is it worth looking around
        for starts in ([rest], self._starts()):
            for radius in radii:
                part = self._best(radius, starts)
                if part.good:
                    return part
                found.append(part)
        return min(found, key=_badness)

    def complete(self, free: FloatArray) -> FloatArray:
        """All joints (nq,) from the free ones: idle joints rest, couplings give the others."""
        q = self.rest.copy()
        q[self._free] = free
        if len(self._dependent):
            q[self._dependent] = self._map @ q + self._offset
        return q

    def rounded(self, q: FloatArray) -> FloatArray:
        """A posture with free joints rounded to 1e-3 and the others as the couplings want.

        Where rounding puts a follower out of its range, the nearest posture that keeps ranges and
        couplings takes its place, unrounded.
        """
        low, high = self.hand.q_lower, self.hand.q_upper
        free = np.clip(np.round(q, 3), np.ceil(low * 1e3) / 1e3, np.floor(high * 1e3) / 1e3)
        exact = np.clip(q, low, high)
        free = np.where((free >= low) & (free <= high), free, exact)
        out = self.complete(free[self._free])
        if (np.maximum(low - out, out - high) > RANGE_TOL).any():
            kept = nearest_on_couplings(out, self.hand.couplings, low, high)
            out = np.clip(out, low, high) if kept is None else kept
        return np.where(np.isin(np.arange(len(q)), self._dependent), out, np.clip(out, low, high))

    def _from_handle(self, point: FloatArray, radius: float) -> FloatArray:
        """Signed distance of the handle from every part that must not touch it, m."""
        return self._gaps.from_handle(
            self._data.oMi, self._carriers, point, self._row, self._half, radius
        )

    def _curling(self) -> NDArray[np.bool_]:
        """Which joints (nq,) curl their finger: their axis is like that of its last joint."""
        hand = self.hand
        state = HandState(hand, hand.neutral)
        out = np.zeros(hand.nq, dtype=bool)
        for finger in hand.fingers.values():
            ids = [hand.pin_model.getJointId(j) for j in finger.joints]
            axes = [
                state.point_jacobian(i, np.zeros(3))[3:, k]
                for i, k in zip(ids, finger.q_index, strict=True)
            ]
            out[finger.q_index] = [abs(a @ axes[-1]) > ALIKE for a in axes]
        return out

    def _row_of_fingers(self) -> tuple[FloatArray, float]:
        """Direction (3,) along the roots of the fingers beside the opposer, and half its length."""
        pin.forwardKinematics(self.hand.pin_model, self._data, self.rest)
        roots = np.array(
            [
                self._data.oMi[self.hand.pin_model.getJointId(f.joints[0])].translation
                for f in self.fingers[1:]
            ]
        )
        reach = roots[:, None] - roots[None]
        i, j = np.unravel_index(int(np.argmax((reach**2).sum(axis=2))), reach.shape[:2])
        length = float(np.linalg.norm(reach[i, j]))
        if length < PAD_GAP:
            return np.array([0.0, 0.0, 1.0]), 0.0
        return np.asarray(reach[i, j] / length), ROW_SHARE * length / 2

    def _starts(self) -> list[FloatArray]:
        """Free joints to start from: fingers stretched, half bent, mid-range, and random ones."""
        rng = np.random.default_rng(0)
        low, high = self.hand.q_lower[self._free], self.hand.q_upper[self._free]
        out = [share * self.rest[self._free] for share in (0.2, 0.6)] + [(low + high) / 2]
        while len(out) < STARTS:
            out.append(low + (high - low) * rng.uniform(0.1, 0.9, len(low)))
        return out

    def _best(self, radius: float, starts: Sequence[FloatArray]) -> PosturePart:
        """The first good posture around a handle of one radius, or the best."""
        rough = sorted(
            (self._descend(start, None, radius, collisions=False) for start in starts),
            key=lambda r: r[0],
        )
        parts: list[PosturePart] = []
        for _, start, around in rough[:KEPT]:
            _, free, point = self._descend(start, around, radius, collisions=True)
            parts.append(self.judge(self.complete(free), radius, point))
            if parts[-1].good:
                break
        return min(parts, key=_badness)

    def _descend(
        self, free: FloatArray, point: FloatArray | None, radius: float, *, collisions: bool
    ) -> tuple[float, FloatArray, FloatArray]:
        """Cost, free joints and the ball's centre where least squares end."""
        from scipy.optimize import least_squares  # here, since SciPy loads slowly

        low, high = self.hand.q_lower[self._free], self.hand.q_upper[self._free]
        free = np.clip(free, low + 1e-6 * (high - low), high - 1e-6 * (high - low))
        if point is None:
            centers, axes = self._look(self.complete(free))
            point = (centers + axes * (self._radii + radius)[:, None]).mean(axis=0)
        lower = np.concatenate([low, np.full(3, -np.inf)])
        upper = np.concatenate([high, np.full(3, np.inf)])
        found = least_squares(
            lambda x: self._residual(x[:-3], x[-3:], radius, collisions),
            np.concatenate([free, point]),
            bounds=(lower, upper),
            max_nfev=15 if collisions else 30,
            x_scale=np.concatenate([self._span[self._free], np.full(3, 0.1)]),
        )
        return float(found.cost), found.x[:-3], found.x[-3:]

    def _residual(
        self, free: FloatArray, point: FloatArray, radius: float, collisions: bool
    ) -> FloatArray:
        q = self.complete(free)
        centers, axes = self._look(q)
        away, looks = self._views(centers, point)
        distance = (away - self._radii - radius) / LENGTH
        cosine = (axes * looks).sum(axis=1)
        facing = 3 * np.maximum(np.cos(CONE_SHARE * self._cones) - cosine, 0.0) + 0.2 * (1 - cosine)
        opposed = looks[0] + _unit(looks[1:].sum(axis=0))
        # the opposer stands before the middle of the row, not beside it
        before = CENTERING * (looks[0] - _unit(centers[1:].mean(axis=0) - centers[0]))
        gaps = [
            np.maximum(
                self._radii[i] + self._radii[j] + PAD_GAP - np.linalg.norm(centers[i] - centers[j]),
                0.0,
            )
            / LENGTH
            for i, j in combinations(range(len(centers)), 2)
        ]
        low, high = self.hand.q_lower, self.hand.q_upper
        tied = self._dependent
        beyond = np.maximum(np.maximum(low[tied] - q[tied], q[tied] - high[tied]), 0.0) / 0.02
        wanted = self._pressing(centers, looks)
        force, stops = self.hand.actuation.split_torque(q, wanted)
        limits = self.hand.actuation.force_limits(q)
        weak = np.maximum(np.maximum(force - limits[:, 1], limits[:, 0] - force), 0.0) / STRENGTH
        weak = np.concatenate([weak, np.maximum(-stops, 0.0) / STRENGTH])
        rest = REST_WEIGHT * (free - self.rest[self._free]) / self._span[self._free]
        span = self._span[self._free]
        end = np.minimum(free - low[self._free], high[self._free] - free)
        margin = np.maximum(1.0 - end / (MARGIN * span), 0.0)
        parts = [distance, facing, opposed, before, gaps, beyond, weak, margin, rest]
        if collisions:
            parts += [
                np.minimum(self._gaps.between_parts(self._data.oMi) - PAD_GAP, 0.0) / LENGTH,
                np.minimum(self._from_handle(point, radius) - BALL_GAP, 0.0) / LENGTH,
            ]
        return np.concatenate([np.ravel(p) for p in parts])

    def judge(self, q: FloatArray, radius: float, point: FloatArray | None = None) -> PosturePart:
        """How good a posture is; the ball's centre is looked for where it is not given."""
        low, high = self.hand.q_lower, self.hand.q_upper
        q = np.clip(q, low, high)
        centers, axes = self._look(q)
        if point is None:
            point = (centers + axes * (self._radii + radius)[:, None]).mean(axis=0)
        away, looks = self._views(centers, point)
        others = _unit(looks[1:].sum(axis=0))
        angles = np.arccos(np.clip((axes * looks).sum(axis=1), -1, 1))
        return PosturePart(
            q=q,
            radius=radius,
            distance_error=float(np.abs(away - self._radii - radius).max()),
            opposition_error=float(np.arccos(np.clip(-looks[0] @ others, -1, 1))),
            facing_error=float(max((angles - self._cones).max(), 0.0)),
            clearance=float(self._gaps.between_parts(self._data.oMi).min(initial=np.inf)),
        )

    def _views(self, centers: FloatArray, point: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distance (n,) and direction (n, 3) from each pad to the handle about a point."""
        to_point = point - centers
        along = np.clip(-to_point @ self._row, -self._half, self._half)
        to_point = to_point + along[:, None] * self._row
        away = np.linalg.norm(to_point, axis=1)
        return away, to_point / np.maximum(away, 1e-9)[:, None]

    def _look(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Centres (n, 3) and axes (n, 3) of the pads in the base at q."""
        pin.computeJointJacobians(self.hand.pin_model, self._data, q)
        poses = [self._data.oMi[p.joint_id] for p in self._pads]
        centers = [pose.act(p.center) for pose, p in zip(poses, self._pads, strict=True)]
        axes = [pose.rotation @ p.axis for pose, p in zip(poses, self._pads, strict=True)]
        return np.array(centers), np.array(axes)

    def _pressing(self, centers: FloatArray, looks: FloatArray) -> FloatArray:
        """Joint torques (nq,) with which every pad presses along its look, N m."""
        torque = np.zeros(self.hand.nq)
        for pad, center, look in zip(self._pads, centers, looks, strict=True):
            jacobian = pin.getJointJacobian(
                self.hand.pin_model, self._data, pad.joint_id, pin.ReferenceFrame.WORLD
            )
            force = PRESS * look
            torque += jacobian.T @ np.concatenate([force, np.cross(center, force)])
        return torque


def _eliminate(matrix: FloatArray, value: FloatArray) -> tuple[list[int], FloatArray, FloatArray]:
    """Joints that C q = d determines, and q[dependent] = M q + b with M zero on them."""
    from scipy.linalg import qr  # here, since SciPy loads slowly

    if not len(matrix):
        return [], np.zeros((0, 0)), np.zeros(0)
    n = matrix.shape[1]
    # the last joints of a coupling follow: pivoting looks at them first
    weight = 1.0 + 1e-3 * np.arange(n)
    _, _, order = qr(matrix * weight, mode="economic", pivoting=True)
    dependent = sorted(int(k) for k in order[: len(matrix)])
    inverse = np.linalg.inv(matrix[:, dependent])
    rest = matrix.copy()
    rest[:, dependent] = 0.0
    return dependent, -inverse @ rest, inverse @ value


def _badness(part: PosturePart) -> float:
    """Excess of a posture over the limits of a good one, in shares of these limits."""
    return float(
        part.distance_error / GOOD_DISTANCE
        + part.opposition_error / GOOD_OPPOSITION
        + part.facing_error / GOOD_FACING
        + 10 * max(TOUCHING - part.clearance, 0.0) / LENGTH
    )


def _unit(v: FloatArray) -> FloatArray:
    return np.asarray(v / max(float(np.linalg.norm(v)), 1e-9))
