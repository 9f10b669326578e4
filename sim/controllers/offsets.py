"""``estimate_offsets``: how far a hand's encoders are off, from contacts on a known object.

Where a finger touches, its surface is on the object's, and their normals are opposite. Joints that
are off by delta put the contact elsewhere: the known surface closes the loop. Called by
``ObjectImpedance`` when the fingers have closed, and by whoever calibrates a hand.

    minimise   sum_looks sum_contacts  (distance / s_d)^2 + |n + outward|^2 / s_n^2
                  + |delta / s_q|^2 + sum_looks |pose error / s_pose|^2

over the offsets delta (reading minus joint) of the joints that move a touching pad, the same in all
looks, and over the pose error of each look. Distance and outward normal are those of the object's
surface at the contact (from the pads' reading, or a pad's ball where only touch is known). Gauss
and Newton, with the surface's curvature by differences. Contacts see few combinations of joints:
what they do not see stays at its prior, 0, and ``deviation`` says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.kinematics.state import HandState
from planner.shapes.base import Shape
from planner.spatial import SE3, FloatArray, skew

OFFSET = np.deg2rad(2.0)
"""Prior standard deviation (rad) of a joint's offset: between a good calibration and a bad one."""

POSITION, ROTATION = 0.001, np.deg2rad(1.0)
"""Standard deviations of the object's pose in a look, m and rad."""

DISTANCE, NORMAL = 0.0005, np.deg2rad(4.0)
"""Standard deviations of a contact's distance to the surface, m (pads give way by tenths of a
millimetre), and of a felt normal, rad."""

ROUNDS = 4
"""Steps of Gauss and Newton: kinematics bends by 0.1 % within 3 degrees, so two do nearly all."""

STEP = 2e-4
"""Step (m) of the differences that give the surface's curvature."""

SHARPEST = 200.0
"""Curvature (1/m) above which a normal is not used: an edge, which can have any."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Look:
    """What is read of one moment, base frame; n fingers.

    Attributes:
        q: Joints as read (nq,), rad.
        T_base_object: The object's pose.
        touching: (n,), which fingers touch.
        points: (n, 3), contacts as they follow from q, m; or None where only touch is known.
        normals: (n, 3), unit, into the object; or None.
    """

    q: FloatArray
    T_base_object: SE3
    touching: NDArray[np.bool_]
    points: FloatArray | None = None
    normals: FloatArray | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class OffsetEstimate:
    """Offsets of a hand's encoders.

    Attributes:
        offset: (nq,), reading minus joint, rad; 0 for joints that move no touching pad.
        deviation: (nq,), its standard deviation, rad; the prior's where nothing was seen.
        before, after: Root mean square of the contacts' distances to the surface without and with
            the offsets, m.
        misfit: Root mean square of all errors without the offsets, in standard deviations (-).
    """

    offset: FloatArray
    deviation: FloatArray
    before: float
    after: float
    misfit: float


def estimate_offsets(
    hand: Hand,
    fingers: Sequence[Finger],
    shape: Shape,
    looks: Sequence[Look],
    *,
    prior: float = OFFSET,
    position: float = POSITION,
    rotation: float = ROTATION,
) -> OffsetEstimate:
    """The offsets that explain some looks best.

    Args:
        hand: The hand.
        fingers: The n fingers of the looks.
        shape: The object's, as it is believed.
        looks: One or more; those in which the object lies differently in the hand tell more.
        prior: Standard deviation of an offset, rad.
        position: Of the object's position in a look, m.
        rotation: Of its rotation, rad.
    """
    nq, poses = hand.nq, 6 * len(looks)
    seen = np.zeros(nq, dtype=bool)
    for look in looks:
        for i in np.flatnonzero(look.touching).tolist():
            seen |= hand.moved_by[fingers[i].pad.joint_id]
    precision = np.concatenate(
        [
            np.full(nq, prior**-2),
            np.tile(np.repeat([position**-2, rotation**-2], 3), len(looks)),
        ]
    )
    x = np.zeros(nq + poses)
    before = after = misfit = 0.0
    gram = np.diag(precision)
    for round_ in range(ROUNDS):
        gram, right, squares, count = np.diag(precision), -precision * x, 0.0, 0
        whole, errors_n = 0.0, 0
        for k, look in enumerate(looks):
            mine = slice(nq + 6 * k, nq + 6 * k + 6)
            state = HandState(hand, look.q - x[:nq])
            read = HandState(hand, look.q)
            for i in np.flatnonzero(look.touching).tolist():
                error, rows = _residual(fingers[i], i, look, state, read, shape, x[mine])
                full = np.zeros((len(error), nq + poses))
                full[:, :nq], full[:, mine] = rows[:, :nq], rows[:, nq:]
                gram += full.T @ full
                right -= full.T @ error
                squares, count = squares + (error[0] * DISTANCE) ** 2, count + 1
                whole, errors_n = whole + float(error @ error), errors_n + len(error)
        after = float(np.sqrt(squares / max(count, 1)))
        if round_ == 0:
            before, misfit = after, float(np.sqrt(whole / max(errors_n, 1)))
        x += np.linalg.solve(gram, right)
    deviation = np.sqrt(np.diag(np.linalg.inv(gram)))[:nq]
    return OffsetEstimate(
        offset=np.where(seen, x[:nq], 0.0),
        deviation=deviation,
        before=before,
        after=after,
        misfit=misfit,
    )


def _residual(
    finger: Finger,
    i: int,
    look: Look,
    state: HandState,
    read: HandState,
    shape: Shape,
    pose_error: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Weighted errors (1 or 4,) of a contact, and their derivatives (., nq + 6).

    The object is where it was measured, moved by the pose error: x + t + r x (x - its origin).
    """
    joint = finger.pad.joint_id
    moved = state.joint_pose(joint) * read.joint_pose(joint).inverse()
    if look.points is None:
        point, clear = state.pad_center(finger), finger.pad.radius
    else:
        point, clear = moved.act(look.points[i]), 0.0
    T = look.T_base_object
    arm = point - T.translation
    jac = state.point_jacobian(joint, point)
    turn = np.asarray(T.rotation.T)
    # in the object's axes, and how it changes with (delta, t, r)
    place = turn @ (arm - pose_error[:3] - np.cross(pose_error[3:], arm))
    d_place = turn @ np.hstack([-jac[:3], -np.eye(3), skew(arm)])
    around = place + STEP * np.vstack([np.zeros(3), np.eye(3), -np.eye(3)])
    nearest, outward = shape.closest_point(around)
    nu = outward[0]
    distance = float((place - nearest[0]) @ nu) - clear
    rows = [nu @ d_place / DISTANCE]
    errors = [distance / DISTANCE]
    bend = (outward[1:4] - outward[4:7]).T / (2.0 * STEP)
    if look.normals is not None and np.linalg.norm(bend, 2) < SHARPEST:
        normal = moved.rotation @ look.normals[i]
        felt = turn @ (normal - np.cross(pose_error[3:], normal))
        # normal turns by -J_ang delta; so does what the object sees of it, against r
        d_felt = turn @ np.hstack([skew(normal) @ jac[3:], np.zeros((3, 3)), skew(normal)])
        errors += list((felt + nu) / NORMAL)
        rows += list((d_felt + bend @ d_place) / NORMAL)
    return np.array(errors), np.array(rows)
