"""Whether a file was read as it was meant: unit, order of quaternions, hand.

Poses in millimetres, quaternions in the other order and the other hand give numbers that look as
good as any. They show where the hand is: under the wrong reading no pad of any grasp is near the
object, under the right one the pads of most are. Nothing is decided here: the error says what to
give.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from planner.audit.judge import Judge
from planner.errors import FileFormatError, PlannerError
from planner.exchange.formats import GraspFormat, Reading
from planner.exchange.given import GivenGrasps
from planner.hand_loading import load_hand
from planner.hands.catalog import hand_names
from planner.hands.hand import Hand
from planner.task import GraspTask

__all__ = ["need_right_reading"]

NEAR = 0.01
"""Distance (m) of a pad from the surface that counts as near: planned ones touch within 0.5 mm."""

FEWEST = 2
"""Pads that must be near."""

LOOKED_AT = 40
"""Grasps of a file that are looked at."""

ENOUGH = 0.5
"""Share of grasps (-) that another reading must bring near to be named."""


def need_right_reading(
    path: Path,
    read: GraspFormat,
    reading: Reading,
    judge: Judge,
    given: GivenGrasps,
    task_for: Callable[[Hand], GraspTask],
) -> None:
    """Refuse a file whose hand is nowhere near the object, and would be in another reading.

    Args:
        path: The file.
        read: Its format.
        reading: How it was read.
        judge: For the hand and object that were given.
        given: What was read.
        task_for: The same task for another hand.

    Raises:
        FileFormatError: So; it says what to give.
    """
    if _share_near(judge, given) > 0.0 or read.read is None:
        return
    for said, hand, other in _others(judge.task.hand, reading):
        try:
            again = read.read(path, hand, other)
            mine = hand is judge.task.hand
            share = _share_near(judge if mine else Judge(task_for(hand)), again)
        except PlannerError:  # this reading cannot be, and another one may
            continue
        if share >= ENOUGH:
            raise FileFormatError(
                f"{path}: in none of its {len(given)} grasps are two pads within "
                f"{1e3 * NEAR:.0f} mm of the object; {said[0]}, they are in "
                f"{100 * share:.0f} % of them: {said[1]}"
            )


def _share_near(judge: Judge, given: GivenGrasps) -> float:
    """Share of the grasps (-) with pads near the object."""
    step = max(1, len(given) // LOOKED_AT)
    near = [judge.near_pads(g, NEAR) >= FEWEST for g in given.grasps[::step][:LOOKED_AT]]
    return float(np.mean(near)) if near else 1.0


def _others(hand: Hand, reading: Reading) -> Iterator[tuple[tuple[str, str], Hand, Reading]]:
    """Other readings, each with what it assumes and what to do then."""
    unit = reading.unit or 1.0
    if unit == 1.0:
        said = "with lengths in millimetres", "give --unit mm"
        yield said, hand, replace(reading, unit=1e-3)
    else:
        yield ("with lengths in metres", "give --unit m"), hand, replace(reading, unit=1.0)
    order = "wxyz" if reading.quaternion == "xyzw" else "xyzw"
    said = f"with quaternions in the order {order}", f"give --quaternion {order}"
    yield said, hand, replace(reading, quaternion=order)
    name = hand.name.removesuffix("_left")
    mirrored = name if name != hand.name else f"{hand.name}_left"
    if mirrored in hand_names():
        said = f"for {mirrored}", f"give --hand {mirrored}"
        yield said, load_hand(mirrored), reading
