"""Trials with known slips: a detector's alarms compared with exact velocities.

A slip is a tangential speed above ``SLIP_SPEED`` for ``SLIP_TIME`` at a loaded contact. The object
is held undisturbed for a while. Then it is provoked repeatedly until a pad slips, by turns with a
growing push in a random direction and with decreasing friction. Each provocation ends before the
object is lost. The detector sees noisy pads and does not act; the controller's are exact, so that
noise moves no slip.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from planner.plan import GraspPlan
from planner.spatial import FloatArray
from planner.task import GRAVITY
from sim.controllers import CONTROLLERS, Controller, Observation, SlipDetector
from sim.controllers.monitors import LOADED, SLIP_SPEED
from sim.protocols.disturbance import DisturbanceTrial
from sim.sensing.errors import ErrorModel, TrialErrors
from sim.sensing.touch.layout import TIME_TOL
from sim.verdict import Fault

SLIP_TIME = 0.01
"""How long (s) the speed must be too high."""

LATENCY = 0.05
"""A slip counts as found when the alarm comes within this time (s) of its beginning."""

NOISE = ErrorModel(name="pads", touch_noise=0.02, sliding_noise=0.002)
"""Noise of the pads: 20 mN and 2 mm/s at every step, of the order of a good optical pad."""

PEACE_S = 10.0
"""Undisturbed hold, s."""

PROVOCATIONS = 6
"""Provocations per trial."""

GROW_S, MOST_WEIGHTS = 2.0, 60.0
"""Duration of a provocation (s) and its largest push in weights of the object (-), which impedance
control seldom holds."""

LEAST_FRICTION = 0.02
"""Share of the friction (-) left at the end of a provocation; nothing can be held with it."""

SLIDING_S, REST_S = 0.06, 0.4
"""Sliding time that ends a provocation, and rest after it (s)."""


@dataclass(frozen=True, kw_only=True)
class Slip:
    """One finger's slip, or an alarm.

    Attributes:
        finger: Number of the finger.
        begin: When the speed first was too high, s (for an alarm: when it was raised).
        end: When it last was, s.
    """

    finger: int
    begin: float
    end: float


@dataclass(frozen=True, kw_only=True)
class SlipScore:
    """How well a detector did.

    Attributes:
        slips: How many true slips there were.
        found: How many of them were found within ``LATENCY``.
        alarms: How many alarms were raised.
        right: How many of them lasted while there was a true slip, or began at most ``LATENCY``
            after it.
        delay: Median time from the beginning of a found slip to its alarm, s; NaN if none.
    """

    slips: int
    found: int
    alarms: int
    right: int
    delay: float

    @property
    def recall(self) -> float:
        """Share of the true slips that were found; NaN if there were none."""
        return self.found / self.slips if self.slips else float("nan")

    @property
    def precision(self) -> float:
        """Share of the alarms that were right; NaN if there were none."""
        return self.right / self.alarms if self.alarms else float("nan")


def true_slips(times: FloatArray, speed: FloatArray, normal_force: FloatArray) -> list[Slip]:
    """Slips by definition, from exact speeds.

    Args:
        times: (m,), s.
        speed: (m, n), tangential speed per finger, m/s.
        normal_force: (m, n), N.
    """
    sliding = (speed > SLIP_SPEED) & (normal_force > LOADED)
    found = []
    for finger in range(speed.shape[1]):
        edges = np.flatnonzero(np.diff(np.r_[False, sliding[:, finger], False].astype(int)))
        for first, after in edges.reshape(-1, 2):
            begin, end = float(times[first]), float(times[after - 1])
            if end - begin >= SLIP_TIME:
                found.append(Slip(finger=finger, begin=begin, end=end))
    return found


def score_slips(slips: Sequence[Slip], alarms: Sequence[Slip]) -> SlipScore:
    """Compare alarms with true slips of the same fingers."""
    delays = []
    for slip in slips:
        late = [
            alarm.begin - slip.begin
            for alarm in alarms
            if alarm.finger == slip.finger
            and alarm.begin <= slip.begin + LATENCY
            and alarm.end >= slip.begin
        ]
        if late:
            delays.append(max(0.0, min(late)))
    right = sum(
        any(s.finger == a.finger and s.begin <= a.end and a.begin <= s.end + LATENCY for s in slips)
        for a in alarms
    )
    return SlipScore(
        slips=len(slips),
        found=len(delays),
        alarms=len(alarms),
        right=right,
        delay=float(np.median(delays)) if delays else float("nan"),
    )


class Watched:
    """A controller with a slip detector beside it that only watches.

    Attributes:
        times: Of the samples, s.
        speeds: True sliding speed of the object over each pad, m/s.
        forces: True normal forces, N.
        alarms: Of the detector; the last ones may not have ended.
    """

    def __init__(
        self,
        inner: Controller,
        fingers: int,
        read: Callable[[Observation], Observation] = lambda truth: truth,
    ) -> None:
        """Watch a controller's pads.

        Args:
            inner: What drives the hand.
            fingers: How many take part.
            read: What the detector's sensors say of the truth; the truth if not given.
        """
        self._inner, self._read = inner, read
        self._detector = SlipDetector(fingers)
        self._open: dict[int, float] = {}
        self.times: list[float] = []
        self.speeds: list[FloatArray] = []
        self.forces: list[FloatArray] = []
        self.alarms: list[Slip] = []

    def step(self, observation: Observation) -> FloatArray:
        """Commands (nu,) of the controller."""
        ctrl = self._inner.step(observation)
        if observation.phase == "hold":
            self._look(observation)
        return ctrl

    def sliding(self) -> bool:
        """Whether a loaded pad has been sliding for as long as a slip lasts at least."""
        begin = self.times[-1] - SLIP_TIME - TIME_TOL
        late = slice(bisect_left(self.times, begin), None)
        fast = (np.array(self.speeds[late]) > SLIP_SPEED) & (np.array(self.forces[late]) > LOADED)
        return bool(fast.all(axis=0).any())

    def finish(self) -> None:
        """End the alarms that still last."""
        for finger in list(self._open):
            self._end(finger)

    def _look(self, observation: Observation) -> None:
        elapsed = observation.time - self.times[-1] if self.times else 0.0
        self.times.append(observation.time)
        self.speeds.append(observation.pads.sliding_speed)
        self.forces.append(observation.pads.normal_force)
        begun = self._detector.update(elapsed, self._read(observation).pads)
        for finger in np.flatnonzero(begun).tolist():
            self._open[finger] = observation.time
        for finger in [f for f in self._open if not self._detector.slipping[f]]:
            self._end(finger)

    def _end(self, finger: int) -> None:
        self.alarms.append(Slip(finger=finger, begin=self._open.pop(finger), end=self.times[-1]))


def slip_row(plan: GraspPlan, rng: np.random.Generator, error_model: ErrorModel) -> dict[str, Any]:
    """Undisturbed hold, then provocations, under each controller.

    Of an error model the drives and the world count: what slips is judged by pads without errors.
    """
    pushes = rng.normal(size=(PROVOCATIONS, 3))
    pushes /= np.linalg.norm(pushes, axis=1, keepdims=True)
    seed = int(rng.integers(2**31))
    loops = []
    for loop, make in CONTROLLERS.items():
        noisy = TrialErrors(NOISE.seeded(seed), plan.task)
        watched = Watched(make(plan), len(plan.task.fingers), noisy.read)
        hold = DisturbanceTrial(plan, controller=watched, error_model=error_model.sensed_exactly())
        fault = hold.close_and_squeeze() or hold.hold_for(PEACE_S)
        peace = hold.simulation.data.time
        for k, push in enumerate(pushes):
            fault = fault or _provoke(hold, watched, push if k % 2 == 0 else None)
        watched.finish()
        slips = _truth(watched)
        score = score_slips(slips, watched.alarms)
        begin = watched.times[0] if watched.times else peace
        early = score_slips(slips, [a for a in watched.alarms if a.begin <= peace])
        loops.append(
            {
                "loop": loop,
                "reason": "" if fault is None else fault.reason,
                **asdict(score),
                "delay": None if np.isnan(score.delay) else score.delay,
                "calm_s": max(0.0, peace - begin),
                "calm_false": early.alarms - early.right,
            }
        )
    return {"loops": loops}


def _provoke(hold: DisturbanceTrial, watched: Watched, push: FloatArray | None) -> Fault | None:
    """Push with a growing force along a direction, or without one reduce the friction."""
    weight = -GRAVITY[2] * hold.plan.task.object.mass
    friction = hold.simulation.scene.model.geom_friction
    normal = friction.copy()
    slid = 0.0
    dt = hold.simulation.scene.physics.timestep
    for k in range(round(GROW_S / dt)):
        share = k * dt / GROW_S
        if push is None:
            friction[:] = normal * (1.0 - share * (1.0 - LEAST_FRICTION))
        else:
            hold.push(share * MOST_WEIGHTS * weight * np.append(push, np.zeros(3)))
        if fault := hold.hold_for(dt):
            return fault
        slid += dt if slid or watched.sliding() else 0.0
        if slid > SLIDING_S:
            break
    friction[:] = normal
    hold.push(np.zeros(6))
    return hold.hold_for(REST_S)


def _truth(watched: Watched) -> list[Slip]:
    if not watched.times:
        return []
    return true_slips(np.array(watched.times), np.array(watched.speeds), np.array(watched.forces))
