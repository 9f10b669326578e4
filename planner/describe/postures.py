"""The postures ``pinch`` and ``open``: pads around a handle, the opposer against the others.

In both, every pad faces one common object from the same distance: a ball, or a bar along the row of
fingers. Couplings hold, no joint leaves its range, and neither the hand nor the object touches the
hand where it must not. Where the object is and how the fingers reach it is one problem:

1. Fingers share nothing but the object. Of random configurations of every finger those are combined
   that face one place best, for places before the pads of the opposer.
2. Least squares over the joints and the object's place improve the best of these starts, first
   without collisions, then with them.
3. From there the object grows and shrinks step by step. The range of openings over which the
   posture stays good, with its margins, is the score of a candidate.

The starts are drawn from a fixed seed, so that the same model gives the same postures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planner.describe.overlaps import TOUCHING, HandGaps
from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.joints.couplings import nearest_on_couplings
from planner.kinematics import HandState
from planner.spatial import FloatArray

RADII = (0.012, 0.016, 0.022, 0.028, 0.034, 0.040, 0.046, 0.052)
"""Radii (m) of the object over which a posture is followed: up to a jar of 100 mm."""

FIRST = (0.022, 0.034, 0.046)
"""Radii (m) at which starts are looked for: some hands reach around a thick object alone."""

PINCH = 0.022
"""Radius (m) of the object that the posture ``pinch`` should hold."""

SAMPLES, BEFORE = 600, 150
"""Random configurations of every finger, and those of the opposer before which an object is put."""

STARTS = 5
"""Starts of least squares per object."""

ENOUGH = 0.8
"""Share of the best score that can be had at which no further place of this object is followed."""

CANDIDATES = 3
"""Candidates that are shown."""

SAME = 0.12
"""Share of a joint's range within which two postures are one."""

APART = 0.015
"""Least distance (m) between the objects of two starts."""

NEAR, AWAY = 0.015, 0.5
"""Miss (m) of a pad that costs as much in a start as one that faces 90 degrees past the object, and
cost (-) of a joint that leaves its resting place by its whole range."""

LENGTH = 0.003
"""Deviation (m) that costs as much as one radian."""

PAD_GAP = 0.003
"""Least distance (m) between pads, and between parts of the hand that must not touch."""

BALL_GAP = 0.003
"""Least distance (m) of the object from everything but the links that carry pads."""

CONE_SHARE = 0.6
"""Share of a pad's cone within which a posture should face the object (-)."""

PRESS = 6.0
"""Force (N) with which each pad shall be able to press: a servo at the end of its range cannot."""

MARGIN = 0.05
"""Share of a joint's range that it should keep from both ends: there a servo has no force left."""

STRENGTH = 0.1
"""Missing torque (N m) that costs as much as one radian."""

CENTERING = 0.5
"""Weight of the opposer's facing the middle of the others, not only the object (-)."""

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

GOOD_DISTANCE, GOOD_OPPOSITION, GOOD_FACING = 0.004, 2 * np.arctan(0.5), np.deg2rad(10.0)
"""A posture is good if pads miss the object by at most this (m), the opposer presses against the
others within this angle (rad: twice the friction angle that planning supposes, beyond which two
pads push the object out), and pads leave their cones by at most that (rad)."""

NEXT_FACE = np.deg2rad(45.0)
"""Angle (rad) beyond which a pad faces the next face of a box and not the one opposite the other
pads."""

ACROSS, UNDER = 0.5, 0.01
"""Weight of pads' facing along the line between opposer and others (-), and reach (m) of a joint
past the object, seen from the palm, that costs as much as one radian: there is the table."""


@dataclass(frozen=True, kw_only=True)
class PosturePart:
    """A posture found by the search.

    Attributes:
        q: (nq,), rad or m.
        radius: Radius of the object that the pads hold, m.
        point: Middle (3,) of the object in the base, m.
        distance_error: Largest miss of a pad, m.
        opposition_error: Angle by which opposer and others do not press against each other, rad.
        facing_error: Largest angle by which a pad faces past the object beyond its cone, rad.
        across_error: Largest angle from a pad's axis to the line between opposer and others, rad.
        clearance: Smallest distance between parts of the hand that must not touch, m.
    """

    q: FloatArray
    radius: float
    point: FloatArray
    distance_error: float
    opposition_error: float
    facing_error: float
    across_error: float
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

    @property
    def badness(self) -> float:
        """Errors in shares of those of a good posture (-): mostly below 4 for a good one."""
        return float(
            self.distance_error / GOOD_DISTANCE
            + self.opposition_error / GOOD_OPPOSITION
            + self.facing_error / GOOD_FACING
            + self.across_error / NEXT_FACE
            + 10 * max(TOUCHING - self.clearance, 0.0) / LENGTH
        )


@dataclass(frozen=True, kw_only=True)
class PostureCandidate:
    """Two postures with a way between them.

    Attributes:
        pinch: Pads around an object of some ``PINCH``.
        wide: Pads around the largest object.
        bar: Whether the object is a bar along the row of fingers; else a ball.
        score: Number of radii at which the posture is good, less for small margins (-).
    """

    pinch: PosturePart
    wide: PosturePart
    bar: bool
    score: float


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
        # a joint outside of fingers may drive one in a finger
        drives = [k for k in range(hand.nq) if len(self._map) and self._map[:, k].any()]
        self._free = np.array(sorted({*active, *drives} - tied), dtype=int)
        self._pads = [f.pad for f in self.fingers]
        self._radii = np.array([p.radius for p in self._pads])
        self._cones = np.array([p.half_angle for p in self._pads])
        self._gaps = HandGaps(hand, PAD_GAP)
        self._moving = [hand.pin_model.getJointId(j) for f in self.fingers for j in f.joints]
        self._carriers = {hand.pin_model.getJointId(f.joints[-1]) for f in self.fingers}
        self._row, self._longest = self._row_of_fingers()
        self._half = 0.0
        self._neighbours = np.triu_indices(len(self.fingers), 1)

    def candidates(self) -> tuple[PostureCandidate, ...]:
        """The best candidate, and up to two that differ from it, best first."""
        drawn = self._sample()
        found: list[PostureCandidate] = []
        for half in dict.fromkeys((self._longest, 0.0)):
            self._half = half
            reached: list[FloatArray] = []
            for radius in FIRST:
                rough = [
                    self._descend(free, point, radius, collisions=False)
                    for free, point in self._starts(drawn, radius)
                ]
                _, free, point = min(rough, key=lambda r: r[0])
                if any(self._alike(free, other) for other in reached):
                    continue  # it would be followed to the same candidate
                reached.append(free)
                found.append(self._followed(free, point, radius))
                if found[-1].score >= ENOUGH * len(RADII):
                    break
        found.sort(key=lambda c: -c.score)
        kept: list[PostureCandidate] = []
        for candidate in found:
            free = candidate.pinch.q[self._free]
            if not any(self._alike(free, c.pinch.q[self._free]) for c in kept):
                kept.append(candidate)
        good = [c for c in kept if c.pinch.good]
        return tuple((good or kept[:1])[:CANDIDATES])

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

    def clearance(self, q: FloatArray) -> float:
        """Smallest distance (m) between parts of the hand that must not touch at q (nq,)."""
        pin.forwardKinematics(self.hand.pin_model, self._data, q)
        return float(self._gaps.between_parts(self._data.oMi).min(initial=np.inf))

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
        return np.asarray(reach[i, j] / length), length / 2

    def _sample(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Free joints (m, n_free) that keep the followers' ranges, pad centres and axes (m, n, 3).

        The first few are fingers that rest, stretch and stand mid-range.
        """
        rng = np.random.default_rng(0)
        low, high = self.hand.q_lower[self._free], self.hand.q_upper[self._free]
        rest = self.rest[self._free]
        drawn = [rest, 0.2 * rest, 0.6 * rest, (low + high) / 2]
        drawn += list(low + (high - low) * rng.uniform(0.05, 0.95, (SAMPLES, len(low))))
        beyond = [self._beyond(self.complete(free)).max(initial=0.0) for free in drawn]
        free = np.array([f for f, b in zip(drawn, beyond, strict=True) if b <= PAD_GAP] or drawn)
        looks = [self._look(self.complete(f)) for f in free]
        return free, np.array([c for c, _ in looks]), np.array([a for _, a in looks])

    def _starts(
        self, drawn: tuple[FloatArray, FloatArray, FloatArray], radius: float
    ) -> list[tuple[FloatArray, FloatArray]]:
        """Free joints and places of an object for which the samples of all fingers fit best."""
        free, centers, axes = drawn
        cost = AWAY**2 * ((free - free[0]) / self._span[self._free]) ** 2
        total = cost[:BEFORE, self._columns(0)].sum(axis=1)
        first = axes[: len(total), 0]
        apart = centers[: len(total), 0] + first * (self._radii[0] + radius)  # (k, 3)
        chosen = np.empty((len(total), len(self.fingers)), dtype=int)
        chosen[:, 0] = np.arange(len(total))
        for i in range(1, len(self.fingers)):
            away, looks = self._views(centers[:, i], apart[:, None])  # (k, m), (k, m, 3)
            miss = (away - self._radii[i] - radius) / NEAR
            past = 1.0 - (axes[:, i] * looks).sum(axis=2)
            opposed = 1.0 + (first[:, None] * looks).sum(axis=2)
            each = miss**2 + past**2 + opposed**2 + cost[:, self._columns(i)].sum(axis=1)
            chosen[:, i] = each.argmin(axis=1)
            total = total + each.min(axis=1)
        out: list[tuple[FloatArray, FloatArray]] = []
        for k in np.argsort(total, kind="stable"):
            if all(np.linalg.norm(apart[k] - point) >= APART for _, point in out):
                start = free[0].copy()
                for i, m in enumerate(chosen[k]):
                    start[self._columns(i)] = free[m, self._columns(i)]
                out.append((start, apart[k]))
            if len(out) == STARTS:
                break
        return out

    def _columns(self, finger: int) -> NDArray[np.int_]:
        """Which free joints are those of a finger."""
        return np.flatnonzero(np.isin(self._free, self.fingers[finger].q_index))

    def _followed(self, free: FloatArray, point: FloatArray, radius: float) -> PostureCandidate:
        """The candidate to which a posture grows and shrinks, rung by rung of ``RADII``."""
        first = RADII.index(radius)
        parts: dict[float, PosturePart] = {}
        for rungs in (RADII[first:], RADII[:first][::-1]):
            near = parts[radius] if parts else None
            for r in rungs:
                at, where = (free, point) if near is None else (near.q[self._free], near.point)
                _, at, where = self._descend(at, where, r, collisions=True)
                near = parts[r] = self._judge(self.complete(at), r, where)
                if not near.good:
                    break
        good = [p for p in parts.values() if p.good]
        pinch = min(good or parts.values(), key=lambda p: (abs(p.radius - PINCH), p.badness))
        larger = [p for p in good if p.radius > pinch.radius]
        # a hand that holds one size well opens as far as it gets
        larger = larger or [p for p in parts.values() if p.radius > pinch.radius] or [pinch]
        wide = max(larger, key=lambda p: p.radius)
        score = sum(1.0 - p.badness / 5.0 for p in good) - (0.0 if good else pinch.badness)
        return PostureCandidate(pinch=pinch, wide=wide, bar=self._half > 0.0, score=score)

    def _alike(self, a: FloatArray, b: FloatArray) -> bool:
        """Whether two postures, as free joints, are one."""
        return bool((np.abs(a - b) <= SAME * self._span[self._free]).all())

    def _descend(
        self, free: FloatArray, point: FloatArray, radius: float, *, collisions: bool
    ) -> tuple[float, FloatArray, FloatArray]:
        """Cost, free joints and the object's middle where least squares end."""
        from scipy.optimize import least_squares  # here, since SciPy loads slowly

        low, high = self.hand.q_lower[self._free], self.hand.q_upper[self._free]
        free = np.clip(free, low + 1e-6 * (high - low), high - 1e-6 * (high - low))
        found = least_squares(
            lambda x: self._residual(x[:-3], x[-3:], radius, collisions),
            np.concatenate([free, point]),
            bounds=(
                np.concatenate([low, np.full(3, -np.inf)]),
                np.concatenate([high, np.full(3, np.inf)]),
            ),
            max_nfev=12,
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
        line, cosines = self._across(centers, axes)
        across = ACROSS * np.maximum(np.cos(0.8 * NEXT_FACE) - cosines, 0.0)
        palm = self._data.oMf[self.hand.palm_frame_id].act(self.hand.palm_point) - point
        palm = _unit(palm - (palm @ line) * line)
        joints = np.array([self._data.oMi[k].translation for k in self._moving])
        under = np.maximum(-(joints - point) @ palm, 0.0) / UNDER
        i, j = self._neighbours
        between = np.linalg.norm(centers[i] - centers[j], axis=1)
        close = np.minimum(between - self._radii[i] - self._radii[j] - PAD_GAP, 0.0) / LENGTH
        low, high = self.hand.q_lower[self._free], self.hand.q_upper[self._free]
        span = self._span[self._free]
        end = np.minimum(free - low, high - free)
        margin = np.maximum(1.0 - end / (MARGIN * span), 0.0)
        rest = REST_WEIGHT * (free - self.rest[self._free]) / span
        parts = [distance, facing, opposed, before, across, under, close, margin, rest]
        parts.append(self._beyond(q) / 0.02)
        if collisions:
            force, stops = self.hand.actuation.split_torque(q, self._pressing(centers, looks))
            limits = self.hand.actuation.force_limits(q)
            weak = np.maximum(np.maximum(force - limits[:, 1], limits[:, 0] - force), 0.0)
            handle = self._gaps.from_handle(
                self._data.oMi, self._carriers, point, self._row, self._half, radius
            )
            parts += [
                weak / STRENGTH,
                np.maximum(-stops, 0.0) / STRENGTH,
                np.minimum(self._gaps.between_parts(self._data.oMi) - PAD_GAP, 0.0) / LENGTH,
                np.minimum(handle - BALL_GAP, 0.0) / LENGTH,
            ]
        return np.concatenate(parts)

    def _beyond(self, q: FloatArray) -> FloatArray:
        """How far joints that follow others are out of their ranges (n_dependent,), rad or m."""
        tied = self._dependent
        below, above = self.hand.q_lower[tied] - q[tied], q[tied] - self.hand.q_upper[tied]
        return np.maximum(np.maximum(below, above), 0.0)

    def _judge(self, q: FloatArray, radius: float, point: FloatArray) -> PosturePart:
        """How good a posture is around an object of a radius (m) at a point (3,)."""
        q = np.clip(q, self.hand.q_lower, self.hand.q_upper)
        centers, axes = self._look(q)
        away, looks = self._views(centers, point)
        others = _unit(looks[1:].sum(axis=0))
        angles = np.arccos(np.clip((axes * looks).sum(axis=1), -1, 1))
        _, cosines = self._across(centers, axes)
        return PosturePart(
            q=q,
            radius=radius,
            point=point,
            distance_error=float(np.abs(away - self._radii - radius).max()),
            opposition_error=float(np.arccos(np.clip(-looks[0] @ others, -1, 1))),
            facing_error=float(max((angles - self._cones).max(), 0.0)),
            across_error=float(np.arccos(np.clip(cosines.min(), -1, 1))),
            clearance=self.clearance(q),
        )

    def _views(self, centers: FloatArray, point: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distance (...) and direction (..., 3) from pads (..., 3) to the object about points."""
        to_point = point - centers
        along = np.clip(-to_point @ self._row, -self._half, self._half)
        to_point = to_point + along[..., None] * self._row
        away = np.sqrt((to_point**2).sum(axis=-1))
        return away, to_point / np.maximum(away, 1e-9)[..., None]

    def _across(self, centers: FloatArray, axes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Direction (3,) from the opposer to the middle of the others; cosines (n,) of pads to it.

        The pads of the others are to face back along it.
        """
        line = _unit(centers[1:].mean(axis=0) - centers[0])
        cosines = axes @ line
        cosines[1:] *= -1.0
        return line, cosines

    def _look(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Centres (n, 3) and axes (n, 3) of the pads in the base at q."""
        pin.computeJointJacobians(self.hand.pin_model, self._data, q)
        pin.updateFramePlacement(self.hand.pin_model, self._data, self.hand.palm_frame_id)
        poses = [self._data.oMi[p.joint_id] for p in self._pads]
        centers = [pose.act(p.center) for pose, p in zip(poses, self._pads, strict=True)]
        axes = [pose.rotation @ p.axis for pose, p in zip(poses, self._pads, strict=True)]
        return np.array(centers), np.array(axes)

    def _pressing(self, centers: FloatArray, looks: FloatArray) -> FloatArray:
        """Joint torques (nq,) with which every pad presses along its look, N m."""
        forces = PRESS * looks
        wrenches = np.hstack([forces, np.cross(centers, forces)])
        torque = np.zeros(self.hand.nq)
        for pad, wrench in zip(self._pads, wrenches, strict=True):
            jacobian = pin.getJointJacobian(
                self.hand.pin_model, self._data, pad.joint_id, pin.ReferenceFrame.WORLD
            )
            torque += jacobian.T @ wrench
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


def _unit(v: FloatArray) -> FloatArray:
    return np.asarray(v / max(float(np.linalg.norm(v)), 1e-9))
