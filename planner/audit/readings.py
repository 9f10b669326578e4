"""Whether a file was read as it was meant: unit, order of quaternions, frame, hand.

Poses in millimetres, quaternions in the other order, inverted poses and the other hand give numbers
that look as good as any. They show where the hand is: under the wrong reading the pads of no grasp
are near the object, under the right one those of most are. Nothing is decided here: the error says
what to give. ``audit`` and ``refine`` read files through it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from planner.audit.grasp_file import GraspFile
from planner.audit.judge import Judge
from planner.errors import FileFormatError, PlannerError, TaskError
from planner.exchange.formats import Reading
from planner.exchange.given import GivenGrasps
from planner.hand_loading import load_hand
from planner.hands.catalog import hand_names
from planner.hands.hand import Hand
from planner.task import GraspTask

SIGNS = ((0.001, 3), (0.01, 2))
"""Distance (m) of pads from the surface, either side, and how many of them must be so near: nearly
touching, which the other hand's pads do not; and near at all."""

LOOKED_AT = 40
"""Grasps of a file that are looked at."""

FEW = 0.1
"""Share of grasps (-) that may be near under a wrong reading: some are by chance."""

ENOUGH = 0.5
"""Share of grasps (-) that another reading must bring near to be named."""


def right_task(
    file: GraspFile,
    task_for: Callable[[Hand], GraspTask],
    hand: Hand,
    *,
    fingers_told: bool = False,
    within: float | None = None,
) -> tuple[GraspTask, GivenGrasps]:
    """Task and grasps of one object of a file, seen to be read as they were written.

    Args:
        file: The file, restricted to an object where it has several.
        task_for: Makes the task for a hand.
        hand: The hand.
        fingers_told: Whether the fingers of the task hold and no others.
        within: Distance (m) of two pads from the object up to which a pose is as it was meant,
            where poses need be no grasps; by ``SIGNS`` if None.

    Raises:
        FileFormatError: Damaged; or the hand is nowhere near the object, and would be in another
            reading: it says what to give.
        TaskError: It holds no grasp.
    """
    given = file.grasps(hand)
    if not len(given):
        raise TaskError(f"{file.path} holds no grasp; give a file with grasps")
    task = task_for(hand)
    judge = Judge(task, fingers_told=fingers_told)
    if within is None or _share_near(judge, given, within, 2) <= FEW:
        _need_right_reading(file, judge, given, task_for)
    return task, given


def _need_right_reading(
    file: GraspFile, judge: Judge, given: GivenGrasps, task_for: Callable[[Hand], GraspTask]
) -> None:
    """Refuse a file whose hand is nowhere near the object, and would be in another reading."""
    near = [_share_near(judge, given, *sign) for sign in SIGNS]
    if min(near) > FEW:
        _need_one_hand(file, judge, given, task_for)
        return
    for said, hand, other in _others(judge.task.hand, file.reading):
        try:
            again = _inverted(given) if other is None else file.grasps(hand, other)
            mine = judge if hand is judge.task.hand else Judge(task_for(hand), **judge.how)
            shares = [_share_near(mine, again, *sign) for sign in SIGNS]
        except PlannerError:  # this reading cannot be, and another one may
            continue
        for (within, count), before, share in zip(SIGNS, near, shares, strict=True):
            if before <= FEW and share >= ENOUGH:
                raise FileFormatError(
                    f"{file.path}: of the grasps looked at, {min(len(given), LOOKED_AT)} of "
                    f"{len(given)}, {100 * before:.0f} % have {count} pads within "
                    f"{1e3 * within:.0f} mm of the object's surface; {said[0]}, "
                    f"{100 * share:.0f} % do: {said[1]}"
                )


def _share_near(judge: Judge, given: GivenGrasps, within: float, count: int) -> float:
    """Share of the grasps (-) with so many pads so near (m) to the object."""
    step = max(1, len(given) // LOOKED_AT)
    near = [judge.near_pads(g, within) >= count for g in given.grasps[::step][:LOOKED_AT]]
    return float(np.mean(near)) if near else 1.0


def _need_one_hand(
    file: GraspFile, judge: Judge, given: GivenGrasps, task_for: Callable[[Hand], GraspTask]
) -> None:
    """Refuse a file some of whose grasps are those of the hand on the other side."""
    (within, count), mirrored = SIGNS[0], _mirrored(judge.task.hand)
    looked_at = given.grasps[:: max(1, len(given) // LOOKED_AT)][:LOOKED_AT]
    far = [k for k, grasp in enumerate(looked_at) if judge.near_pads(grasp, within) < count]
    if mirrored is None or len(far) <= FEW * len(looked_at):
        return
    try:
        hand = load_hand(mirrored)
        other, again = Judge(task_for(hand), **judge.how), file.grasps(hand).grasps
    except PlannerError:  # that hand cannot be meant
        return
    seen = again[:: max(1, len(again) // LOOKED_AT)]
    theirs = [seen[k].name for k in far if other.near_pads(seen[k], within) >= count]
    if len(theirs) >= ENOUGH * len(far):
        raise FileFormatError(
            f"{file.path} mixes hands: of the grasps looked at, {len(looked_at)} of {len(given)}, "
            f"{len(theirs)} touch the object with {mirrored} and not with "
            f"{judge.task.hand.name}, {theirs[0]} the first of them; give a file per hand"
        )


def _inverted(given: GivenGrasps) -> GivenGrasps:
    """The grasps with the poses that they have if what stands in the file is the object's."""
    grasps = [replace(g, T_object_base=g.T_object_base.inverse()) for g in given.grasps]
    return replace(given, grasps=tuple(grasps))


def _mirrored(hand: Hand) -> str | None:
    """Name of the hand on the other side; None where there is none."""
    name = hand.name.removesuffix("_left")
    mirrored = name if name != hand.name else f"{hand.name}_left"
    return mirrored if mirrored in hand_names() else None


def _others(hand: Hand, reading: Reading) -> Iterator[tuple[tuple[str, str], Hand, Reading | None]]:
    """Other readings, each with what it assumes and what to do then; None for inverted poses."""
    unit = reading.unit or 1.0
    if unit == 1.0:
        said = "with lengths in millimetres", "give --unit mm"
        yield said, hand, replace(reading, unit=1e-3)
    else:
        yield ("with lengths in metres", "give --unit m"), hand, replace(reading, unit=1.0)
    order = "wxyz" if reading.quaternion == "xyzw" else "xyzw"
    said = f"with quaternions in the order {order}", f"give --quaternion {order}"
    yield said, hand, replace(reading, quaternion=order)
    said = "with the inverse of each pose", "give poses of the hand's base in the object's frame"
    yield said, hand, None
    if mirrored := _mirrored(hand):
        said = f"for {mirrored}", f"give --hand {mirrored}"
        yield said, load_hand(mirrored), reading
