"""``RealSenses``: what the sensors of a laboratory say of what there is.

Joints are read through their encoders. Pads feel forces in the frames of their fingertips, so where
they act is told by the joints as read. A camera sees the object at its own rate, with noise, drift
and bias, and late; now and then it does not see it for a while. Each pose has a time stamp. A pose
is carried on with the hand's base from the moment of its stamp, or from that at which the hand had
closed; before, the object stands still.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin

from planner.contacts import ContactSet
from planner.errors import TaskError
from planner.kinematics.state import MovingHand
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask
from sim.controllers import Observation, Phase
from sim.controllers.belief import SeenPose
from sim.controllers.pads import PadReading
from sim.reality.drawn import Drawn, stream
from sim.reality.errors import Reality

__all__ = ["Drift", "RealSenses", "encoder_error"]

TIME_TOL = 1e-9
"""Times that differ by less (s) are the same: rounding of sums of time steps."""

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


@dataclass(frozen=True, kw_only=True)
class _Stamped:
    """A measured pose: when, of the object in the world and in the hand's base."""

    time: float
    T_world_object: SE3
    T_base_object: SE3


@dataclass
class _Camera:
    """Poses that are under way, the newest that arrived, and the one before."""

    under_way: deque[_Stamped] = field(default_factory=deque)
    newest: _Stamped | None = None
    before: _Stamped | None = None
    next_sample: float = 0.0
    blind_until: float = -math.inf
    last_sample: float | None = None


class RealSenses:
    """Turns exact observations into what is read; call ``read`` once a time step."""

    def __init__(self, reality: Reality, drawn: Drawn, task: GraspTask) -> None:
        """Start the noise.

        Args:
            reality: Its errors.
            drawn: What was drawn of them.
            task: Hand and fingers.
        """
        self._reality, self._drawn = reality, drawn
        self._fingers = task.fingers
        names = ("encoder_noise", "rate_noise", "touch_noise", "sliding_noise")
        self._rng = {
            name: stream(reality.seed, name)
            for name in (*names, "pose_noise", "turn_noise", "dropout")
        }
        self._drifts = [
            Drift(np.full(3, deviation), reality.drift_time, stream(reality.seed, name))
            for name, deviation in (
                ("pose_drift", reality.pose_drift),
                ("turn_drift", reality.turn_drift),
            )
        ]
        self._camera = _Camera()
        self._closed: tuple[float, SE3] | None = None  # when, and T_base_world then
        self._sees_exactly = not reality.blurs_pose
        off = drawn.encoder_offset.any() or drawn.encoder_scale.any()
        self._reads_exactly = not off and reality.backlash == 0.0
        neutral = task.hand.neutral
        self._true_hand = MovingHand(task.hand, neutral)
        self._read_hand = MovingHand(task.hand, neutral)

    def read(self, truth: Observation, ahead: FloatArray | float = 0.0) -> Observation:
        """What is read of the truth, by encoders that are ahead (nq,) of their joints, rad."""
        r, n = self._reality, len(truth.q)
        q = truth.q + encoder_error(self._drawn, truth.q) + ahead
        q = q + r.encoder_noise * self._rng["encoder_noise"].standard_normal(n)
        v = truth.v * (1.0 + self._drawn.encoder_scale)
        v = v + r.rate_noise * self._rng["rate_noise"].standard_normal(n)
        fingers = len(truth.normal_forces)
        error = r.touch_noise * self._rng["touch_noise"].standard_normal((fingers, 3))
        slid = r.sliding_noise * self._rng["sliding_noise"].standard_normal((fingers, 3))
        pressed = truth.normal_forces > 0
        felt = np.where(pressed, np.maximum(truth.normal_forces + error[:, 0], 0.0), 0.0)
        changed = replace(
            truth,
            q=q,
            v=v,
            normal_forces=felt,
            read_contacts=_no_contacts,
            read_pads=lambda: self._pads(truth, q, error, slid),
        )
        if self._sees_exactly:
            return changed
        pose, seen = self._pose(truth)
        return replace(
            changed, T_world_object=pose, read_twist=lambda: self._twist(truth), seen=seen
        )

    # ---- pads

    def _pads(
        self, truth: Observation, q: FloatArray, error: FloatArray, slid: FloatArray
    ) -> PadReading:
        exact = truth.pads
        pressed = exact.normal_force > 0
        normal = np.nan_to_num(exact.normal)
        pressing = np.where(pressed, np.maximum(exact.normal_force + error[:, 0], 0.0), 0.0)
        across = np.column_stack([np.zeros(len(error)), error[:, 1:]])
        change = (pressing - exact.normal_force)[:, None] * normal
        change += _tangential(across, normal) * pressed[:, None]
        noisy = replace(
            exact,
            normal_force=pressing,
            force=exact.force + change,
            sliding=exact.sliding + _tangential(slid, normal),
        )
        return noisy if self._reads_exactly else self._as_believed(noisy, truth, q)

    def _as_believed(self, pads: PadReading, truth: Observation, q: FloatArray) -> PadReading:
        """Vectors and places in the world, as they follow from the joints that were read."""
        true, read = self._true_hand.move(truth.q), self._read_hand.move(q)
        base = truth.T_world_base
        moves = [
            base * read.tip_pose(f) * (base * true.tip_pose(f)).inverse() for f in self._fingers
        ]
        turns = np.array([m.rotation for m in moves])
        shifts = np.array([m.translation for m in moves])

        def turned(rows: FloatArray) -> FloatArray:
            return np.asarray((turns @ rows[:, :, None])[:, :, 0])

        return replace(
            pads,
            force=turned(pads.force),
            position=turned(pads.position) + shifts,
            normal=turned(pads.normal),
            sliding=turned(pads.sliding),
        )

    # ---- the object's pose

    def _pose(self, truth: Observation) -> tuple[SE3, SeenPose]:
        """The newest pose that has arrived, now and as measured; at first the oldest there is."""
        r, camera, now = self._reality, self._camera, truth.time
        if now >= camera.next_sample - TIME_TOL:
            if r.pose_rate > 0:
                camera.next_sample = (math.floor(now * r.pose_rate + TIME_TOL) + 1) / r.pose_rate
            self._sample(truth)
        while camera.under_way and camera.under_way[0].time <= now - r.pose_delay + TIME_TOL:
            camera.before, camera.newest = camera.newest, camera.under_way.popleft()
        known = camera.newest or camera.under_way[0]
        seen = SeenPose(time=known.time, T_world_object=known.T_world_object)
        if truth.phase in STANDING:
            return known.T_world_object, seen
        closed = self._closed = self._closed or (now, truth.T_world_base.inverse())
        if known.time < closed[0]:  # the object stood still until the hand had closed
            return truth.T_world_base * closed[1] * known.T_world_object, seen
        return truth.T_world_base * known.T_base_object, seen

    def _sample(self, truth: Observation) -> None:
        """Measure a pose, unless the object is out of sight; the first one is always seen."""
        r, camera, now = self._reality, self._camera, truth.time
        since = 0.0 if camera.last_sample is None else now - camera.last_sample
        first, camera.last_sample = camera.last_sample is None, now
        shift = r.pose_noise * self._rng["pose_noise"].standard_normal(3)
        turn = r.turn_noise * self._rng["turn_noise"].standard_normal(3)
        pose_drift, turn_drift = (drift.step(since) for drift in self._drifts)
        lost = self._rng["dropout"].random() < r.dropout
        if now < camera.blind_until - TIME_TOL:
            return
        if lost and not first:
            camera.blind_until = now + r.dropout_time
            return
        exact = truth.T_world_object
        turned = pin.exp3(self._drawn.turn_bias + turn + turn_drift) @ exact.rotation
        moved = exact.translation + self._drawn.pose_bias + shift + pose_drift
        measured = SE3(turned, moved)
        camera.under_way.append(
            _Stamped(
                time=now,
                T_world_object=measured,
                T_base_object=truth.T_world_base.inverse() * measured,
            )
        )

    def _twist(self, truth: Observation) -> FloatArray:
        """Velocity (6,) between the last two poses that arrived; 0 before there are two."""
        old, new = self._camera.before, self._camera.newest
        if old is None or new is None:
            return np.zeros(6)
        T_old, T_new = old.T_world_object, new.T_world_object
        turned = pin.log3(T_new.rotation @ T_old.rotation.T)
        moved = T_new.translation - T_old.translation
        return np.concatenate([moved, turned]) / (new.time - old.time)


def _no_contacts() -> ContactSet:
    raise TaskError(
        "no sensor tells the contacts of a hand one by one; a controller that reads "
        "observation.contacts runs in the reality 'ideal' only; read pads"
    )


def _tangential(vectors: FloatArray, normal: FloatArray) -> FloatArray:
    along = (vectors * normal).sum(axis=1, keepdims=True)
    return np.asarray(vectors - along * normal)
