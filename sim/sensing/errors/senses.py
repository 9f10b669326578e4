"""``RealSenses``: what the sensors of a laboratory say of what there is.

Joints are read through their encoders. Pads feel forces in the frames of their fingertips, at their
own rate and late, so where they act is told by the joints as read when it arrives. A camera sees
the object at its own rate, with noise, drift and bias, and late; now and then it does not see it
for a while. Each pose has a time stamp. A pose is carried on with the hand's base from the moment
of its stamp, or from that at which the hand had closed; before, the object stands still.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pinocchio as pin

from planner.contacts import ContactSet
from planner.errors import TaskError
from planner.kinematics import MovingHand
from planner.spatial import SE3, FloatArray, cross
from planner.task import GraspTask
from sim.controllers import Observation, Phase
from sim.controllers.base import MeasuredPose, PadReading
from sim.sensing.errors.model import Drawn, ErrorModel, stream
from sim.sensing.touch.layout import TIME_TOL, Delayed

STANDING: frozenset[Phase] = frozenset({"approach", "close"})
"""Phases in which the object does not move with the hand."""


def encoder_error(drawn: Drawn, q: FloatArray) -> FloatArray:
    """Reading minus joint (nq,) without noise, at joints (nq,), rad or m."""
    return np.asarray(drawn.encoder_offset + drawn.encoder_scale * q)


class Drift:
    """Correlated noise: an Ornstein-Uhlenbeck process in its stationary state, per axis.

    Sampled exactly for any time step: x' = a x + sqrt(1 - a^2) xi with a = exp(-dt / time).
    """

    def __init__(self, deviation: FloatArray, time: float, rng: np.random.Generator) -> None:
        """Start it.

        Args:
            deviation: Standard deviation (n,).
            time: Correlation time, s.
            rng: Its random numbers.
        """
        self._deviation, self._time, self._rng = deviation, time, rng
        self._state = rng.standard_normal(len(deviation))

    def step(self, elapsed: float) -> FloatArray:
        """The noise (n,) after a further time (s)."""
        kept = math.exp(-elapsed / self._time)
        fresh = self._rng.standard_normal(len(self._deviation))
        self._state = kept * self._state + math.sqrt(1.0 - kept * kept) * fresh
        return np.asarray(self._deviation * self._state)


class RealSenses:
    """Turns exact observations into what is read; call ``read`` once a time step."""

    def __init__(self, error_model: ErrorModel, drawn: Drawn, task: GraspTask) -> None:
        """Start the noise.

        Args:
            error_model: Its errors.
            drawn: What was drawn of them.
            task: Hand and fingers.
        """
        self._error_model, self._drawn = error_model, drawn
        self._fingers = task.fingers
        names = list(task.hand.fingers)
        self._scale = 1.0 + drawn.touch_scale[[names.index(f.name) for f in task.fingers]]
        self._centers = np.array([f.pad.center for f in task.fingers])
        self._radii = np.array([f.pad.radius for f in task.fingers])
        white = ("encoder_noise", "rate_noise", "touch_noise", "sliding_noise")
        self._rng = {
            name: stream(error_model.seed, name)
            for name in (*white, "pose_noise", "turn_noise", "dropout")
        }
        self._drifts = [
            Drift(np.full(3, deviation), error_model.drift_time, stream(error_model.seed, name))
            for name, deviation in (
                ("pose_drift", error_model.pose_drift),
                ("turn_drift", error_model.turn_drift),
            )
        ]
        place = np.full(3 * len(task.fingers), error_model.touch_place)
        self._misplaced = Drift(
            place, error_model.drift_time, stream(error_model.seed, "touch_place")
        )
        self._touch: Delayed[tuple[FloatArray, Callable[[], PadReading]]] = Delayed(
            error_model.touch_rate, error_model.touch_delay
        )
        self._late = error_model.touch_rate > 0 or error_model.touch_delay > 0
        # of the object in the world and in the hand's base
        self._camera: Delayed[tuple[SE3, SE3]] = Delayed(
            error_model.pose_rate, error_model.pose_delay
        )
        self._looked: float | None = None
        self._blind_until = -math.inf
        self._closed: tuple[float, SE3] | None = None  # when, and T_base_world then
        self._sees_exactly = not error_model.has_pose_errors
        off = drawn.encoder_offset.any() or drawn.encoder_scale.any()
        placed = not off and error_model.backlash == 0.0 and error_model.touch_place == 0.0
        self._as_it_is = placed and not self._late
        neutral = task.hand.neutral
        self._true_hand = MovingHand(task.hand, neutral)
        self._read_hand = MovingHand(task.hand, neutral)

    def read(self, truth: Observation, ahead: FloatArray | float = 0.0) -> Observation:
        """What is read of the truth, by encoders that are ahead (nq,) of their joints, rad."""
        r, n = self._error_model, len(truth.q)
        q = truth.q + encoder_error(self._drawn, truth.q) + ahead
        q = q + r.encoder_noise * self._rng["encoder_noise"].standard_normal(n)
        if r.encoder_step:
            q = r.encoder_step * np.round(q / r.encoder_step)
        v = truth.v * (1.0 + self._drawn.encoder_scale)
        v = v + r.rate_noise * self._rng["rate_noise"].standard_normal(n)
        normal_forces, read_pads = self._felt(truth)
        changed = replace(
            truth,
            q=q,
            v=v,
            normal_forces=normal_forces,
            read_contacts=_no_contacts,
            read_pads=lambda: self._placed(read_pads(), truth.T_world_base, q),
        )
        if self._sees_exactly:
            return changed
        pose, seen = self._pose(truth)
        return replace(
            changed, T_world_object=pose, read_twist=lambda: self._twist(truth), measured_pose=seen
        )

    # ---- pads

    def _felt(self, truth: Observation) -> tuple[FloatArray, Callable[[], PadReading]]:
        """Normal forces, and how the rest is read, that arrived last; at first the oldest."""
        r, now = self._error_model, truth.time
        fingers = len(truth.normal_forces)
        error = r.touch_noise * self._rng["touch_noise"].standard_normal((fingers, 3))
        slid = r.sliding_noise * self._rng["sliding_noise"].standard_normal((fingers, 3))
        if self._touch.due(now):
            last = self._touch.last_time
            since = 0.0 if last is None else now - last
            aside = self._misplaced.step(since).reshape(fingers, 3)
            read = partial(self._pads, truth, error, slid, aside)
            if self._late:
                read = partial(_as_sent, read())
            self._touch.add(now, (self._measured(truth.normal_forces, error[:, 0]), read))
        return self._touch.newest(now)[1]

    def _measured(self, normal_force: FloatArray, error: FloatArray) -> FloatArray:
        """What pads say of normal forces (n,), with noise (n,), N."""
        r = self._error_model
        force = np.maximum(self._scale * normal_force + error, 0.0)
        if r.touch_step:
            force = r.touch_step * np.round(force / r.touch_step)
        return np.where((normal_force > 0) & (force >= r.touch_threshold), force, 0.0)

    def _pads(
        self, truth: Observation, error: FloatArray, slid: FloatArray, aside: FloatArray
    ) -> PadReading:
        """What pads say, in the world as it is, or in their joints' frames if it is carried on."""
        exact = truth.pads
        if not len(exact.normal_force):  # nothing reads pads here
            return exact
        pressing = self._measured(exact.normal_force, error[:, 0])
        there = pressing > 0
        normal = np.where(there[:, None], np.nan_to_num(exact.normal), 0.0)
        across = np.column_stack([np.zeros(len(error)), error[:, 1:]])
        scaled = self._scale * exact.normal_force
        force = self._scale[:, None] * exact.force + (pressing - scaled)[:, None] * normal
        noisy = replace(
            exact,
            normal_force=pressing,
            force=np.where(there[:, None], force + _tangential(across, normal), 0.0),
            position=np.where(there[:, None], exact.position, np.nan),
            normal=np.where(there[:, None], exact.normal, np.nan),
            sliding=np.where(there[:, None], exact.sliding + _tangential(slid, normal), np.nan),
            time=truth.time if self._late else None,
        )
        if self._as_it_is:
            return noisy
        hand = self._true_hand.move(truth.q)
        poses = [truth.T_world_base * hand.joint_pose(f.pad.joint_id) for f in self._fingers]
        local = noisy.moved([pose.inverse() for pose in poses])
        if not self._error_model.touch_place:
            return local
        turns = cross(local.normal, aside) / self._radii[:, None]
        about = [
            SE3(R, c - R @ c)
            for R, c in zip(map(pin.exp3, np.nan_to_num(turns)), self._centers, strict=True)
        ]
        return local.moved(about)

    def _placed(self, felt: PadReading, T_world_base: SE3, q: FloatArray) -> PadReading:
        """Vectors and places in the world, as they follow from the joints (nq,) that were read."""
        if self._as_it_is or not len(felt.normal_force):
            return felt
        hand = self._read_hand.move(q)
        return felt.moved([T_world_base * hand.joint_pose(f.pad.joint_id) for f in self._fingers])

    # ---- the object's pose

    def _pose(self, truth: Observation) -> tuple[SE3, MeasuredPose]:
        """The newest pose that has arrived, now and as measured; at first the oldest there is."""
        now = truth.time
        if self._camera.due(now):
            self._sample(truth)
        time, (T_world_object, T_base_object) = self._camera.newest(now)
        seen = MeasuredPose(time=time, T_world_object=T_world_object)
        if truth.phase in STANDING:
            return T_world_object, seen
        closed = self._closed = self._closed or (now, truth.T_world_base.inverse())
        if time < closed[0]:  # the object stood still until the hand had closed
            return truth.T_world_base * closed[1] * T_world_object, seen
        return truth.T_world_base * T_base_object, seen

    def _sample(self, truth: Observation) -> None:
        """Measure a pose, unless the object is out of sight; the first one is always seen."""
        r, now = self._error_model, truth.time
        first = self._looked is None
        since = 0.0 if self._looked is None else now - self._looked
        self._looked = now
        shift = r.pose_noise * self._rng["pose_noise"].standard_normal(3)
        turn = r.turn_noise * self._rng["turn_noise"].standard_normal(3)
        pose_drift, turn_drift = (drift.step(since) for drift in self._drifts)
        lost = self._rng["dropout"].random() < r.dropout
        if now < self._blind_until - TIME_TOL:
            return
        if lost and not first:
            self._blind_until = now + r.dropout_time
            return
        exact = truth.T_world_object
        turned = pin.exp3(self._drawn.turn_bias + turn + turn_drift) @ exact.rotation
        moved = exact.translation + self._drawn.pose_bias + shift + pose_drift
        measured = SE3(turned, moved)
        self._camera.add(now, (measured, truth.T_world_base.inverse() * measured))

    def _twist(self, truth: Observation) -> FloatArray:
        """Velocity (6,) between the last two poses that arrived; 0 before there are two."""
        if self._camera.before is None:
            return np.zeros(6)
        old, (T_old, _) = self._camera.before
        new, (T_new, _) = self._camera.newest(truth.time)
        turned = pin.log3(T_new.rotation @ T_old.rotation.T)
        moved = T_new.translation - T_old.translation
        return np.concatenate([moved, turned]) / (new - old)


def _as_sent(reading: PadReading) -> PadReading:
    return reading


def _no_contacts() -> ContactSet:
    raise TaskError(
        "no sensor tells the contacts of a hand one by one; a controller that reads "
        "observation.contacts runs in the error model 'ideal' only; read pads"
    )


def _tangential(vectors: FloatArray, normal: FloatArray) -> FloatArray:
    along = (vectors * normal).sum(axis=1, keepdims=True)
    return np.asarray(vectors - along * normal)
