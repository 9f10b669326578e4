"""``PoseFilter``: carries estimate and covariance from one sample to the next.

Prediction by contacts that stick (``rolling``), correction by contacts that lie on the surface
(``touch_equations``) and by what a camera saw. Errors that last, as a pad's or a camera's drift do,
count as white noise with the same information per correlation time T: variance (1 + 2 T / dt) s^2.

A contact far from where it is expected is trusted less: its variance grows until it is ``FAR``
standard deviations off, so that its pull falls with its distance. A pose beyond
``FARTHEST`` is not believed at all; after ``TOO_MANY`` of these in a row it is the filter that is
wrong, and it starts anew from the last one.

``Track``: what was known at the last samples. A measurement that comes late is taken into account
at the sample nearest to its time stamp, and everything after is computed anew, with the Jacobians
that are there: the result is that of a filter that had it in time, to first order.

``LossDetector``: the moment at which an estimator no longer knows where the object is. A pose
counts as known while the believed errors stay below limits; with hysteresis, so that it does not
change to and fro.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planner.arrays import check_fields
from planner.spatial import SE3, FloatArray, skew
from planner.task import GraspTask
from sim.controllers import Event
from sim.sensing.estimation.state import (
    Estimate,
    Grip,
    Motion,
    PoseMeasurement,
    SensorErrors,
    SensorSample,
    TipKinematics,
    Tips,
    about_origin,
    nearest,
    rolling,
    touch_equations,
)

FARTHEST = 22.5
"""Largest squared Mahalanobis distance (-) of a pose that is believed: 99.9 % of a chi-square
distribution with 6 degrees of freedom lie below."""

TOO_MANY = 5
"""Poses in a row that are not believed before the filter gives up its own."""

FAR = 3.0
"""Standard deviations beyond which a contact counts less."""

STANDING = (5e-5, 1e-3)
"""Random walk of an object that stands and is not touched, m / sqrt(s) and rad / sqrt(s).
In 4 s these are 0.1 mm and 0.1 degrees: it stands still."""

PUSHED, PUSHED_UP = (3e-3, 0.05), (1e-3, 0.03)
"""The same of one that is touched: along the table and about the vertical; up, and by tipping. In
0.1 s these are 1 mm and 1 degree, and 0.3 mm and 0.5 degrees."""

ROLLING = 0.15
"""The same, rad / sqrt(s), of a ball that rolls on its table, about a horizontal axis."""

CARRIED = (0.1, 2.0)
"""The same of one that no contact holds: 10 mm and 11 degrees after 0.01 s, so that nothing is
believed of a direction along which no finger sticks."""

SHORTEST = 1e-3
"""Least time (s) between two measurements that counts: of two at once drift would tell nothing."""

OFF_PAD = 0.004
"""Distance (m) of a contact from a pad's sphere beyond which it is one of another link."""

LESS = 25.0
"""Factor on the variance of a contact off the pads: a fifth of the trust."""


@dataclass(frozen=True, kw_only=True)
class ContactNoise:
    """Standard deviations of contacts; calibrated on trials, see docs/how/sensors.md.

    Attributes:
        creep: Random walk between object and pad, m / sqrt(s).
        spin: Random walk of the turn about the normal, rad / sqrt(s).
        share: Error of a displacement per displacement (-), over each ``over``.
        over: Way along which that error stays the same, m.
        distance: Error of a contact's distance from the surface, m.
        normal: Error of a felt normal, rad.
        lasting: Correlation time of both, s.
    """

    creep: float = 5e-4
    spin: float = 0.3
    share: float = 0.03
    over: float = 0.02
    distance: float = 5e-4
    normal: float = 0.05
    lasting: float = 0.5

    def __post_init__(self) -> None:
        """Check every number: variances are divided by."""
        check_fields(self, what="contact noise: ", above=0.0)


@dataclass(frozen=True, slots=True, eq=False)
class ContactUpdate:
    """What contacts said at a sample.

    Attributes:
        estimate: What was known before.
        residual: (k,), m and rad.
        jacobian: (k, 7 + m).
        noise: (k,), variances.
    """

    estimate: Estimate
    residual: FloatArray
    jacobian: FloatArray
    noise: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Filtered:
    """What is known at a sample.

    Attributes:
        estimate: It.
        motion: How the object moved since the sample before; None at the first.
        drift: (m,), variance by which offsets wandered meanwhile.
        offsets: (m,), offsets with which the motion was computed.
        felt: What contacts said; None without any.
        refused: Poses in a row that were not believed.
    """

    estimate: Estimate
    motion: Motion | None = None
    drift: FloatArray | None = None
    offsets: FloatArray | None = None
    felt: ContactUpdate | None = None
    refused: int = 0


class PoseFilter:
    """The filter of one trial.

    Attributes:
        tips: Kinematics of the fingers that take part.
        feels: Whether pads say where they touch; else only whether.
    """

    def __init__(
        self, task: GraspTask, errors: SensorErrors, contact_noise: ContactNoise, *, feels: bool
    ) -> None:
        """Prepare for a task."""
        task.require_fingertips("an estimator")
        self.tips = TipKinematics(task.hand, task.fingers)
        self.feels = feels
        self._errors, self._contact_noise = errors, contact_noise
        self._shape = task.object.shape
        self._table = task.table_height is not None
        pads = [finger.pad for finger in task.fingers]
        self._centers = np.array([pad.center for pad in pads])
        self._radii = np.array([pad.radius for pad in pads])
        self._up = -task.gravity / max(float(np.linalg.norm(task.gravity)), 1e-9)

    def first(self, measurement: PoseMeasurement) -> Filtered:
        """What a first measurement tells."""
        errors, m = self._errors, len(self.tips.index)
        covariance = np.zeros((7 + m, 7 + m))
        covariance[:6, :6] = self.pose_noise(measurement)
        covariance[range(6, 6 + m), range(6, 6 + m)] = errors.joint_offset**2
        covariance[-1, -1] = errors.size**2
        return Filtered(Estimate(measurement.T_base_object, np.zeros(m), 0.0, covariance))

    def advanced(self, known: Filtered, a: SensorSample, b: SensorSample) -> Filtered:
        """Predicted state at b, before its measurements, from the state at a."""
        estimate, k, dt = known.estimate, self.tips.index, b.time - a.time
        moved = (b.q - a.q)[k]
        tips = self.tips.at(self._believed(0.5 * (a.q + b.q), estimate))
        points, normals, on_pad = self._contacts(estimate, a, b, tips)
        jacobians = tips.jacobians(points)
        held = a.touching & b.touching
        slid = 0.5 * dt * tips.turned(a.sliding + b.sliding)
        noise_of = self._contact_noise
        way = np.abs(moved @ jacobians).sum(axis=1)
        variance = noise_of.creep**2 * dt + noise_of.share**2 * noise_of.over * way
        variance += 0.25 * (slid * slid).sum(axis=1) + (self._errors.sliding * dt) ** 2
        variance *= on_pad
        prior, information = self._prior(estimate, a, b)
        grip = Grip(
            points,
            normals,
            slid,
            held / variance,
            held / (noise_of.spin**2 * dt * on_pad),
        )
        motion = rolling(tips, jacobians, grip, moved, prior, information, dt)
        drift = (self._errors.joint_scale**2 * 0.5) * np.abs(moved)
        after = estimate.moved(motion.displacement, motion.by_offsets, motion.covariance, drift)
        felt = self._contact_update(after, b, dt) if b.touching.any() else None
        if felt is not None:
            after = after.corrected(felt.residual, felt.jacobian, np.diag(felt.noise))
        return Filtered(after, motion, drift, estimate.offsets, felt, known.refused)

    def recomputed(self, known: Filtered, before: Filtered) -> Filtered:
        """What ``advanced`` gives from a better knowledge of the sample before, to first order.

        Args:
            known: What is known now of the sample before.
            before: What was known of this sample, before any measurement.
        """
        motion, felt = before.motion, before.felt
        if motion is None or before.drift is None or before.offsets is None:
            return before
        change = motion.by_offsets @ (known.estimate.offsets - before.offsets)
        after = known.estimate.moved(
            motion.displacement + change, motion.by_offsets, motion.covariance, before.drift
        )
        if felt is not None:
            residual = felt.residual - felt.jacobian @ after.error_against(felt.estimate)
            after = after.corrected(residual, felt.jacobian, np.diag(felt.noise))
        return replace(before, estimate=after, refused=known.refused)

    def corrected_by_pose(self, known: Filtered, measurement: PoseMeasurement) -> Filtered:
        """What is known after a measurement."""
        estimate = known.estimate
        noise = self.pose_noise(measurement)
        off = estimate.error_to(measurement.T_base_object)
        spread = estimate.covariance[:6, :6] + noise
        if float(off @ np.linalg.solve(spread, off)) > FARTHEST:
            if known.refused + 1 < TOO_MANY:
                return replace(known, refused=known.refused + 1)
            again = self.first(measurement).estimate
            anew = Estimate(again.T_base_object, estimate.offsets, estimate.size, again.covariance)
            return replace(known, estimate=anew, refused=0)
        jacobian = np.zeros((6, len(estimate.covariance)))
        jacobian[:, :6] = np.eye(6)
        return replace(known, estimate=estimate.corrected(off, jacobian, noise), refused=0)

    def pose_noise(self, measurement: PoseMeasurement) -> FloatArray:
        """(6, 6), covariance of a measured pose as an error of the base's axes."""
        e = self._errors
        drift = 1.0 + 2.0 * e.drift_time / max(measurement.period, SHORTEST)
        linear = e.camera**2 + e.drift**2 * drift
        angular = e.camera_turn**2 + e.drift_turn**2 * drift
        arm = skew(measurement.T_base_object.translation)
        out = np.zeros((6, 6))
        out[:3, :3] = linear * np.eye(3) + angular * arm @ arm.T
        out[:3, 3:] = angular * arm
        out[3:, :3] = out[:3, 3:].T
        out[3:, 3:] = angular * np.eye(3)
        return out

    def contacts(self, estimate: Estimate, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Where round tips would touch, as the joints are read: points and normals (n, 3), base."""
        tips = self.tips.at(self._believed(q, estimate))
        points, normals = self._round(estimate, tips)
        read = self.tips.at(q)
        return read.out(tips.into(points)), read.turned(tips.turned_into(normals))

    # ---- steps

    def _believed(self, q: FloatArray, estimate: Estimate) -> FloatArray:
        out = q.copy()
        out[self.tips.index] -= estimate.offsets
        return out

    def _round(self, estimate: Estimate, tips: Tips) -> tuple[FloatArray, FloatArray]:
        """Points of the object nearest to the tips' spheres, and normals into it; (n, 3), base."""
        centers = tips.out(self._centers)
        distance, outward = nearest(self._shape, estimate, centers)
        return centers - distance[:, None] * outward, -outward

    def _contacts(
        self, estimate: Estimate, a: SensorSample, b: SensorSample, tips: Tips
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Contacts in the middle of a motion, and by how much their variance is larger (n,)."""
        if not self.feels:
            points, normals = self._round(estimate, tips)
            return points, normals, np.ones(len(points))
        both = a.touching & b.touching
        local = np.where(both[:, None], 0.5 * (a.points + b.points), self._centers)
        normals = tips.turned(0.5 * (a.normals + b.normals))
        return tips.out(local), normals, self._less(local, slice(None))

    def _less(self, local: FloatArray, on: NDArray[np.intp] | slice) -> FloatArray:
        """(k,), factor on the variance of contacts in the frames of the pads ``on``."""
        away = np.sqrt(((local - self._centers[on]) ** 2).sum(axis=1)) - self._radii[on]
        return np.where(np.abs(away) > OFF_PAD, LESS, 1.0)

    def _prior(
        self, estimate: Estimate, a: SensorSample, b: SensorSample
    ) -> tuple[FloatArray, FloatArray]:
        """Displacement (6,) of an object that no finger moves, and the information on it (6, 6)."""
        dt = b.time - a.time
        free = np.zeros((6, 6))
        if not a.standing:
            along, about = CARRIED
            up, tipping = CARRIED
            prior = np.zeros(6)
        else:
            stays = b.T_world_base.actInv(a.T_world_base)
            prior = np.array(pin.log6(stays).vector)
            touched = self._table and (a.touching.any() or b.touching.any())
            if touched and not a.touching.any():
                dt += self._errors.touch_age  # it may have been pushed before a pad said so
            (along, about), (up, tipping) = (PUSHED, PUSHED_UP) if touched else (STANDING, STANDING)
            tipping = ROLLING if touched and self._shape.ball_like else tipping
        vertical = b.T_world_base.rotation.T @ self._up
        vertical = np.outer(vertical, vertical)
        level = np.eye(3) - vertical
        free[:3, :3] = (level / along**2 + vertical / up**2) / dt
        free[3:, 3:] = (level / tipping**2 + vertical / about**2) / dt
        to_center = about_origin(estimate.T_base_object.translation)
        return prior, to_center.T @ free @ to_center

    def _contact_update(self, estimate: Estimate, sample: SensorSample, dt: float) -> ContactUpdate:
        """What the contacts of a sample say."""
        on = np.flatnonzero(sample.touching)
        tips = self.tips.at(self._believed(sample.q, estimate)).of(on)
        noise_of = self._contact_noise
        lasting = 1.0 + 2.0 * noise_of.lasting / dt
        if self.feels:
            local = sample.points[on]
            outward = -tips.turned(sample.normals[on])
            equations = touch_equations(
                self._shape, estimate, tips, tips.out(local), np.zeros(len(on)), outward
            )
            less = self._less(local, on)
        else:
            points, less = tips.out(self._centers[on]), np.ones(len(on))
            equations = touch_equations(self._shape, estimate, tips, points, self._radii[on], None)
        noise = np.empty(len(equations.residual))
        noise[: len(on)] = noise_of.distance**2 * lasting * less
        if self.feels:
            drift = 1.0 + 2.0 * self._errors.drift_time / dt
            turned = (
                noise_of.normal**2 * lasting + (self._errors.place / self._radii[on]) ** 2 * drift
            )
            noise[len(on) :] = np.repeat(turned * less, 2)
        jacobian, residual = equations.jacobian, equations.residual
        spread = ((jacobian @ estimate.covariance) * jacobian).sum(axis=1) + noise
        far = np.abs(residual) / (FAR * np.sqrt(spread))
        noise = noise + spread * (np.maximum(far, 1.0) ** 2 - 1.0)
        return ContactUpdate(estimate, residual, jacobian, noise)


LOST = (0.01, math.radians(15.0))
"""Believed errors, m and rad (root mean squares), beyond which a pose is not known."""

FOUND = 0.7
"""Share of these below which it is known again."""


class LossDetector:
    """Whether the pose is known.

    Attributes:
        known: Whether it is.
    """

    def __init__(self) -> None:
        """It is known, until it is not."""
        self.known = True
        self._events: list[Event] = []

    @property
    def events(self) -> tuple[Event, ...]:
        """What changed, in order."""
        return tuple(self._events)

    def update(self, time: float, covariance: FloatArray) -> bool:
        """Take over the covariance (6, 6) of a pose at a time (s); whether it is known."""
        diagonal = np.maximum(np.diagonal(covariance), 0.0)
        off, turned = math.sqrt(diagonal[:3].sum()), math.sqrt(diagonal[3:].sum())
        share = max(off / LOST[0], turned / LOST[1])
        if self.known != (share < (1.0 if self.known else FOUND)):
            self.known = not self.known
            detail = f"{1e3 * off:.1f} mm and {math.degrees(turned):.1f} degrees"
            self._events.append(
                Event(
                    time=time,
                    kind="pose known again" if self.known else "pose lost",
                    detail=f"believed to be off by {detail}",
                )
            )
        return self.known


KEPT = 0.4
"""How long (s) samples are kept: a measurement that is older when it arrives is not used."""


@dataclass(slots=True)
class _Node:
    """A sample, its estimate, and its estimate before any measured pose."""

    sample: SensorSample
    known: Filtered
    before: Filtered
    measurements: list[PoseMeasurement] = field(default_factory=list)


class Track:
    """The last samples of one trial, in order."""

    def __init__(
        self, pose_filter: PoseFilter, sample: SensorSample, measurement: PoseMeasurement
    ) -> None:
        """Begin with a sample, and the pose measured then."""
        self._filter = pose_filter
        known = pose_filter.first(measurement)
        self._nodes = [_Node(sample, known, known)]

    @property
    def known(self) -> Filtered:
        """What is known at the last sample."""
        return self._nodes[-1].known

    @property
    def last(self) -> SensorSample:
        """The last sample."""
        return self._nodes[-1].sample

    def go_on(self, sample: SensorSample) -> None:
        """Add a sample, later than the last."""
        known = self._filter.advanced(self.known, self.last, sample)
        self._nodes.append(_Node(sample, known, known))
        while self._nodes[1].sample.time < sample.time - KEPT:
            del self._nodes[0]

    def add_pose(
        self, time: float, measured: SE3, number: int, period: float, *, world: bool
    ) -> bool:
        """Take a measured pose into account; whether it was in time for that.

        Args:
            time: When it was measured, s.
            measured: Pose of the object in the world, or in the hand's base.
            number: Of this measurement, from 0.
            period: Time since the one before, s.
            world: Whether ``measured`` is in the world.
        """
        nodes = self._nodes
        if time < nodes[0].sample.time or time > nodes[-1].sample.time + 1e-9:
            return False
        i = max(k for k, node in enumerate(nodes) if node.sample.time <= time + 1e-9)
        here = nodes[i].sample
        pose = here.T_world_base.actInv(measured) if world else measured
        if i + 1 < len(nodes) and time > here.time + 1e-9:
            there = nodes[i + 1]
            share = (time - here.time) / (there.sample.time - here.time)
            base = SE3.Interpolate(here.T_world_base, there.sample.T_world_base, share)
            pose = base.actInv(measured) if world else measured
            motion = there.known.motion
            whole = 0.0 if motion is None else motion.displacement
            later = share >= 0.5
            rest = (1.0 - share) * whole if later else -share * whole
            pose = pin.exp6(pin.Motion(rest)) * pose
            i += int(later)
        measurement = PoseMeasurement(pose, number, period)
        nodes[i].measurements.append(measurement)
        nodes[i].known = self._filter.corrected_by_pose(nodes[i].known, measurement)
        for before, node in zip(nodes[i:], nodes[i + 1 :], strict=False):
            known = self._filter.recomputed(before.known, node.before)
            for seen in node.measurements:
                known = self._filter.corrected_by_pose(known, seen)
            node.known = known
        return True
