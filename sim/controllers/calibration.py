"""Where joints are: offsets of encoders found by contacts, and readings mended by stops.

``Calibration``: the encoder offsets that a controller has found, and its readings without them.

Called by ``Reclosing`` when all fingers touch and by ``ObjectImpedance`` when the squeeze is over,
with what the pads feel, and from then on at every step. Offsets are taken over only where the
contacts contradict the joints as read by more than ``CONTRADICTION``, so exact joints stay exactly
as they are. Contacts beside the pads' balls tell nothing.

``estimate_offsets``: how far a hand's encoders are off, from contacts on a known object.

Where a finger touches, its surface is on the object's, and their normals are opposite. Joints that
are off by delta put the contact elsewhere: the known surface closes the loop. Called by
``ObjectImpedance`` when the fingers have closed, and by whoever calibrates a hand.

    minimise   sum_samples sum_contacts  (distance / s_d)^2 + |n + outward|^2 / s_n^2
                  + |delta / s_q|^2 + sum_samples |pose error / s_pose|^2

over the offsets delta (reading minus joint) of the joints that move a touching pad, the same in all
samples, and over the pose error of each. Distance and outward normal are those of the object's
surface at the contact (from the pads' reading, or a pad's ball where only touch is known). Gauss
and Newton, with the surface's curvature by differences. Contacts see few combinations of joints:
what they do not see stays at its prior, 0, and ``deviation`` says so.

``StopCorrection``: where joints are, by their encoders and by the stops that they must lean on.

An encoder is off by a degree or three. Where a tendon drives two joints, a stop carries what the
tendon cannot, and a controller that takes the stop for open can exert no force: 0.01 rad decide.
Called by controllers before they turn torques into commands.

A stop carries (its gap counts as closed) if the reading says so within ``STOP_TOL``, as in a plan;
or if the plan leans on it and the reading is within ``MOST_OFF``: a load that presses on an open
stop closes it. The plan's verdict keeps ``STOP_TOL``. Effort confirms it: a joint that
rests although the forces felt press on its stop by more than friction and springs hold has the stop
there, and what the encoder says then is its offset, from then on.

No joint is beyond its stop: a reading there is off as well.

Corrections are the least change of joints, in equal parts where a stop ties two of them, so the
length of a tendon that adds them up stays as it was read.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.joints.actuation import STOP_TOL, Actuation
from planner.kinematics import HandState, MovingHand
from planner.plan import GraspPlan
from planner.shapes.base import Shape
from planner.spatial import SE3, FloatArray, skew
from sim.controllers.base import Observation, PadReading

OFFSET = np.deg2rad(2.0)
"""Prior standard deviation (rad) of a joint's offset: between a good calibration and a bad one."""

POSITION, ROTATION = 0.001, np.deg2rad(1.0)
"""Standard deviations of the object's pose in a sample, m and rad."""

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
class ContactSample:
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
    samples: Sequence[ContactSample],
    *,
    prior: float = OFFSET,
    position: float = POSITION,
    rotation: float = ROTATION,
) -> OffsetEstimate:
    """The offsets that explain some samples best.

    Args:
        hand: The hand.
        fingers: The n fingers of the samples.
        shape: The object's, as it is believed.
        samples: One or more; those in which the object lies differently in the hand tell more.
        prior: Standard deviation of an offset, rad.
        position: Of the object's position in a sample, m.
        rotation: Of its rotation, rad.
    """
    nq, poses = hand.nq, 6 * len(samples)
    seen = np.zeros(nq, dtype=bool)
    for sample in samples:
        for i in np.flatnonzero(sample.touching).tolist():
            seen |= hand.moved_by[fingers[i].pad.joint_id]
    precision = np.concatenate(
        [
            np.full(nq, prior**-2),
            np.tile(np.repeat([position**-2, rotation**-2], 3), len(samples)),
        ]
    )
    x = np.zeros(nq + poses)
    before = after = misfit = 0.0
    gram = np.diag(precision)
    for round_ in range(ROUNDS):
        gram, right, squares, count = np.diag(precision), -precision * x, 0.0, 0
        whole, errors_n = 0.0, 0
        for k, sample in enumerate(samples):
            mine = slice(nq + 6 * k, nq + 6 * k + 6)
            state = HandState(hand, sample.q - x[:nq])
            read = HandState(hand, sample.q)
            for i in np.flatnonzero(sample.touching).tolist():
                error, rows = _residual(fingers[i], i, sample, state, read, shape, x[mine])
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
    sample: ContactSample,
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
    if sample.points is None:
        point, clear = state.pad_center(finger), finger.pad.radius
    else:
        point, clear = moved.act(sample.points[i]), 0.0
    T = sample.T_base_object
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
    if sample.normals is not None and np.linalg.norm(bend, 2) < SHARPEST:
        normal = moved.rotation @ sample.normals[i]
        felt = turn @ (normal - np.cross(pose_error[3:], normal))
        # normal turns by -J_ang delta; so does what the object sees of it, against r
        d_felt = turn @ np.hstack([skew(normal) @ jac[3:], np.zeros((3, 3)), skew(normal)])
        errors += list((felt + nu) / NORMAL)
        rows += list((d_felt + bend @ d_place) / NORMAL)
    return np.array(errors), np.array(rows)


CONTRADICTION = 1.0
"""Root mean square of the contacts' errors in standard deviations (-) from which on joints count as
off: contacts 1 mm off the surface with normals that fit, for instance. Exact joints leave 0.04, 1
degree 0.9 to 2.5, 3 degrees 5 to 14 (four grasps of two hands)."""

OFF_PAD = 0.002
"""Distance (m) of a contact from the pad's ball from which on something else of the finger touches,
an edge of the tip or a link above it: 4 to 39 mm in 6 first touches of 12 (Shadow-type hand, 1
degree), where pads are within 0.1 mm. Such a contact is on no surface whose place is known. Counted
as pads, they left joints 1.1 to 3.1 degrees off that had been 1.0 to 1.3 off."""


class Calibration:
    """Offsets of a hand's encoders as far as they are known.

    Attributes:
        offset: (nq,), reading minus joint, rad; 0 until contacts contradict the readings.
        estimate: What was found last, taken over or not; None before.
    """

    def __init__(self, plan: GraspPlan) -> None:
        """Nothing is known yet."""
        task = plan.task
        self._hand, self._fingers, self._shape = task.hand, task.fingers, task.object.shape
        self._read, self._true = (MovingHand(task.hand, plan.q) for _ in range(2))
        self._believed = task.object.belief is not None
        self._samples: list[ContactSample] = []
        self.offset = np.zeros(task.hand.nq)
        self.estimate: OffsetEstimate | None = None

    def learn(self, observation: Observation) -> bool:
        """Compare the contacts of now, as read; whether the offsets have changed.

        Nothing is learned of a hand without pads, nor from a surface of which cameras saw a part:
        it is known to millimetres, as the tips of joints that are off by a degree or two.
        """
        if self._believed or not observation.reads_pads:
            return False
        T_base_world = observation.T_world_base.inverse()
        pads = observation.pads
        points = pads.position @ T_base_world.rotation.T + T_base_world.translation
        sample = ContactSample(
            q=observation.q,
            T_base_object=T_base_world * observation.T_world_object,
            touching=self._by_pads(observation.q, points),
            points=points,
            normals=pads.normal @ T_base_world.rotation.T,
        )
        if not sample.touching.any():
            return False
        self._samples.append(sample)
        self.estimate = estimate_offsets(self._hand, self._fingers, self._shape, self._samples)
        if self.estimate.misfit < CONTRADICTION:
            return False
        self.offset = self.estimate.offset
        return True

    def _by_pads(self, q: FloatArray, points: FloatArray) -> NDArray[np.bool_]:
        """Which fingers (n,) touch at points (n, 3) of their pads, base frame, NaN for none."""
        read = self._read.move(q)
        centers = np.array([read.pad_center(finger) for finger in self._fingers])
        radii = np.array([finger.pad.radius for finger in self._fingers])
        away = np.linalg.norm(points - centers, axis=1) - radii
        balls = np.array([not len(finger.pad.reach) for finger in self._fingers])
        return np.asarray((np.abs(away) < OFF_PAD) & balls)  # NaN is not

    def correct(self, observation: Observation) -> Observation:
        """What would have been read without the offsets; the same object if there are none."""
        if not self.offset.any():
            return observation
        q = observation.q - self.offset
        return observation.altered(q=q, read_pads=lambda: self._moved(observation, q))

    def _moved(self, observation: Observation, q: FloatArray) -> PadReading:
        """Pads feel in their fingertips' frames: where these are follows from the joints."""
        pads, base = observation.pads, observation.T_world_base
        read, true = self._read.move(observation.q), self._true.move(q)
        joints = [finger.pad.joint_id for finger in self._fingers]
        moves = [base * true.joint_pose(j) * (base * read.joint_pose(j)).inverse() for j in joints]
        return pads.moved(moves)


MOST_OFF = 0.22
"""Largest error (rad) of a stop's reading: three standard deviations of the sum of two joints that
are off by 3 degrees each, 3 sqrt(2) 3 degrees."""

LEAST_EFFORT = 0.006
"""Torque (N m) onto a stop that only the stop can bear: three times the dry friction of a small
finger joint (0.002 N m), and more than its spring of 0.08 N m/rad makes within 0.05 rad."""

STILL_RATE, STILL_TIME = 0.1, 0.03
"""Rate (rad/s) below which a loaded joint rests, and how long (s) it must: without a stop the least
effort moves a distal link of 1e-5 kg m^2 by a radian in that time."""


class StopCorrection:
    """Corrects readings by stops; exact readings it leaves as they are.

    Attributes:
        offset: (ns,), confirmed reading of each stop's gap where it is closed, rad; NaN if unknown.
    """

    def __init__(self, actuation: Actuation, planned: FloatArray) -> None:
        """Take as closed the stops that a planned posture (nq,) leans on."""
        self._rows, self._values = actuation.stop_rows, actuation.stop_values
        self._carrying = np.zeros(len(self._values), dtype=bool)
        self._carrying[actuation.carrying_stops] = True
        self._carrying &= np.isfinite(self._values)
        self.offset = np.full(len(self._values), np.nan)
        self._planned: NDArray[np.bool_] = self._carrying.copy()
        self._rested = np.zeros(len(self._values))
        self._idle = not self._carrying.any()
        self.set_posture(planned)

    @property
    def acts(self) -> bool:
        """Whether the hand has stops that carry what no actuator can."""
        return not self._idle

    def set_posture(self, planned: FloatArray) -> None:
        """Go on to another planned posture (nq,)."""
        if not self._idle:
            self._planned = self._carrying & (self._gaps(planned) <= STOP_TOL)

    def remove_offset(self, offset: FloatArray) -> None:
        """From now on readings come without an offset (nq,), rad."""
        self.offset = self.offset - self._rows @ offset

    def corrected(self, q: FloatArray) -> FloatArray:
        """Joints (nq,) that agree with the stops; the same array if readings do already."""
        if self._idle:
            return q
        gaps = self._gaps(q)
        known = np.isfinite(self.offset)
        gap = gaps - np.where(known, self.offset, 0.0)
        closed = self._planned & ~known & (gap <= MOST_OFF) | self._carrying & (gap <= STOP_TOL)
        # a known offset is subtracted; without one the whole remaining gap is
        change = np.where(closed & (np.abs(gap) > STOP_TOL), gap, 0.0)
        change += np.where(known, self.offset, 0.0)
        moved = np.flatnonzero(change)
        if not len(moved):
            return q
        rows = self._rows[moved]
        return np.asarray(q - np.linalg.lstsq(rows, change[moved], rcond=None)[0])

    def update(self, elapsed: float, q: FloatArray, v: FloatArray, pressing: FloatArray) -> None:
        """Take over what effort says of the stops.

        Args:
            elapsed: Time since the last call, s.
            q: Joints as read (nq,).
            v: Their rates (nq,).
            pressing: Torque onto each stop (ns,), N m, if it carries: the multipliers of
                ``Actuation.split_torque`` for the contact forces that are felt.
        """
        if self._idle:
            return
        rests = np.abs(self._rows @ v) < STILL_RATE
        shown = self._planned & (pressing > LEAST_EFFORT) & rests
        self._rested = np.where(shown, self._rested + elapsed, 0.0)
        gaps = self._gaps(q)
        off = np.abs(gaps) > STOP_TOL
        learn = (self._rested >= STILL_TIME) & np.isnan(self.offset) & off & (gaps <= MOST_OFF)
        self.offset = np.where(learn, gaps, self.offset)

    def _gaps(self, q: FloatArray) -> FloatArray:
        return np.asarray(self._rows @ q - self._values)


def servo_commands(
    actuation: Actuation, read: FloatArray, corrected: FloatArray, v: FloatArray, torque: FloatArray
) -> FloatArray:
    """Commands (nu,) for joint torques (nq,) at corrected joints, for servos that read others.

    Args:
        actuation: The hand's.
        read: Joints (nq,) as the servos' encoders have them.
        corrected: Joints (nq,) where the stops are looked at.
        v: Rates (nq,).
        torque: Wanted (nq,), N m.
    """
    ctrl = actuation.commands(corrected, v, torque)
    if corrected is read:
        return ctrl
    servo = -actuation.bias[:, 1] / actuation.gain
    ctrl = ctrl + servo * (actuation.moment @ (read - corrected))
    low, high = actuation.ctrl_range.T
    return np.asarray(np.clip(ctrl, low, high))
