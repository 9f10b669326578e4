"""``SenseHistory``: what a policy is told, as one vector.

The pose of the object is told by the estimator that the policy was trained with; with ``touch``
nothing of the vector comes from a camera once the hand has closed.

joints    joints as read less the playback's posture (nq,), of each of the last decisions
touch     normal force per finger of the hand (fingers,), N, likewise
targets   offset from the playback's commands at the last decision, as an action (nu,)
plan      the playback's posture (nq,), what pressing adds to its commands (nu,), the posture at
          the first touch less the planned one (nq,), and which fingers take part (fingers,)
clock     place on the path, rate, share of the planned forces, whether the object stands (4,)
object    its deviation from the plan as joints (2 nq,), degrees: ``sim.learning.playback``;
          as joints

``ObjectRange``: an object of which dimensions are drawn: ``cylinder:0.025..0.035x0.08``.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.errors import NotFoundError, ObjectError, TaskError, shown
from planner.hands.hand import Hand
from planner.objects import GraspObject, parse_object
from planner.spatial import FloatArray
from planner.task import GraspTask
from sim.controllers import Observation
from sim.learning.playback import Playback

SENSES: tuple[str, ...] = ("joints", "touch", "targets", "plan", "clock", "object")
"""Senses that a policy may have."""

LAGS: tuple[int, ...] = (0, 2, 6)
"""Ages of joint readings and forces that a policy sees, in decisions."""


_NOTHING = np.zeros(0)
"""Of a sense that is not told."""


def checked_senses(names: Sequence[str]) -> tuple[str, ...]:
    """Senses in their order.

    Raises:
        NotFoundError: There is none of a name.
        TaskError: None is given.
    """
    for name in names:
        if name not in SENSES:
            raise NotFoundError("sense of a policy", name, SENSES)
    if not names:
        raise TaskError(f"a policy needs a sense; give some of {', '.join(SENSES)}")
    return tuple(name for name in SENSES if name in names)


def columns(hand: Hand, senses: Sequence[str]) -> NDArray[np.intp]:
    """Where some senses stand in a vector of all: what a policy of these alone is told.

    Raises:
        NotFoundError: There is none of a name.
        TaskError: None is given.
    """
    wanted, at, found = checked_senses(senses), 0, []
    for name, size in _sizes(hand).items():
        if name in wanted:
            found.append(np.arange(at, at + size))
        at += size
    return np.concatenate(found)


def _sizes(hand: Hand) -> dict[str, int]:
    """Numbers of each sense, in order."""
    nq, nu, n = hand.nq, len(hand.actuation.names), len(hand.fingers)
    each = {
        "joints": len(LAGS) * nq,
        "touch": len(LAGS) * n,
        "targets": nu,
        "plan": 2 * nq + nu + n,
        "clock": 4,
        "object": len(LAGS) * 2 * nq,
    }
    return {name: each[name] for name in SENSES}


class SenseHistory:
    """The last readings of one run.

    Attributes:
        size: Length of the vector.
    """

    def __init__(self, task: GraspTask, senses: Sequence[str] = SENSES) -> None:
        """Nothing has been read yet.

        Args:
            task: Hand, and fingers that take part.
            senses: Those that are told, out of ``SENSES``.
        """
        self._senses = checked_senses(senses)
        hand = task.hand
        all_fingers = tuple(hand.fingers)
        self._columns = [all_fingers.index(name) for name in task.finger_names]
        self._part = np.zeros(len(all_fingers))
        self._part[self._columns] = 1.0
        self._kept: deque[tuple[FloatArray, ...]] = deque(maxlen=max(LAGS) + 1)
        each = _sizes(hand)
        self.size = sum(each[name] for name in self._senses)

    def vector(
        self, observation: Observation, playback: Playback, action: FloatArray
    ) -> FloatArray:
        """What is told now, (size,); call it once a decision.

        Args:
            observation: What sensors read.
            playback: At the time of the observation.
            action: The last decision's (nu,).
        """
        forces = np.zeros(len(self._part))
        forces[self._columns] = observation.normal_forces
        lag = _NOTHING
        if "object" in self._senses:
            lag = playback.lag.told(observation, playback.place)
        self._kept.appendleft((observation.q - playback.q, forces, lag))
        last = len(self._kept) - 1
        past = [self._kept[min(age, last)] for age in LAGS]
        play = playback
        told: dict[str, list[FloatArray]] = {
            "joints": [joints for joints, _, _ in past],
            "touch": [force for _, force, _ in past],
            "targets": [action],
            "plan": [play.q, play.press, play.bent, self._part],
            "clock": [np.array([play.place, play.rate, play.share, float(play.standing)])],
            "object": [lag for _, _, lag in past],
        }
        return np.concatenate([part for name in self._senses for part in told[name]])


_RANGE = re.compile(r"(-?\d*\.?\d+)\.\.(-?\d*\.?\d+)")
"""Two numbers with two dots between them; a sign is read so that the object can refuse it."""

STEP = 5e-5
"""Sizes are rounded to this, m: a tenth of a millimetre in diameter."""


@dataclass(frozen=True)
class ObjectRange:
    """An object as ``parse_object`` takes it; a dimension may be a range ``a..b``, m.

    All ranges are drawn together, so a block that is square stays square.

    Attributes:
        text: As it was given.
    """

    text: str

    def __post_init__(self) -> None:
        """Check both ends.

        Raises:
            PlannerError: An end is no object, or a range whose end is below its beginning.
        """
        for low, high in _RANGE.findall(self.text):
            if float(low) > float(high):
                raise ObjectError(
                    f"the range {low}..{high} of {shown(self.text)} ends below its beginning; give "
                    f"{high}..{low}"
                )
        for share in (0.0, 1.0):
            parse_object(self.at(share))

    def at(self, share: float) -> str:
        """The object at a share of all ranges, 0 to 1."""

        def drawn(found: re.Match[str]) -> str:
            low, high = (float(v) for v in found.groups())
            return f"{STEP * round((low + share * (high - low)) / STEP):.6g}"

        return _RANGE.sub(drawn, self.text)

    def holds(self, item: GraspObject) -> bool:
        """Whether an object is of this kind, and its extents between those of both ends."""
        low, high = (parse_object(self.at(share)).shape for share in (0.0, 1.0))
        shape = item.shape
        return type(shape) is type(low) and bool(
            (shape.half_extents >= low.half_extents - STEP).all()
            and (shape.half_extents <= high.half_extents + STEP).all()
        )
