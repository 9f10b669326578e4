"""Plots that pages of trials and manipulations have in common."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

import numpy as np

from planner.hands.hand import Hand
from planner.pages.scene import Band, Line, Mark, Plot
from planner.spatial import FloatArray
from sim.controllers.events import AS_TOLD
from sim.recording import Recording
from sim.report_file import EventData


def column(values: Sequence[float | None]) -> FloatArray:
    """Numbers of a file (m,), NaN for null."""
    return np.array(values, dtype=np.float64)


def per_finger(rows: Sequence[Sequence[float | None]], fingers: Sequence[str]) -> FloatArray:
    """Numbers of a file (m, n) with a column per finger, NaN for null."""
    return np.array(rows, dtype=np.float64).reshape(-1, len(fingers))


def force_plot(fingers: Sequence[str], measured: FloatArray, planned: FloatArray) -> Plot:
    """Normal forces.

    Args:
        fingers: n names.
        measured: (m, n), N.
        planned: (1, n) or (m, n), N; (0, n) for none.
    """
    lines = []
    for i, name in enumerate(fingers):
        lines.append(Line(name=name, values=measured[:, i], group=name))
        if len(planned):
            lines.append(
                Line(name=f"{name}, planned", values=planned[:, i], dashed=True, group=name)
            )
    return Plot(title="Normal force on the object", unit="N", lines=tuple(lines))


def cone_plot(fingers: Sequence[str], used: FloatArray) -> Plot:
    """Share (m, n) of the friction cone that tangential force and torsion use; 1 is its edge."""
    lines = [Line(name=name, values=used[:, i], group=name) for i, name in enumerate(fingers)]
    edge = Line(name="edge of the cone", values=np.ones(1), dashed=True)
    return Plot(title="Tangential use of the friction cone", unit="", lines=(*lines, edge))


def quality_plot(epsilon: FloatArray, min_weight: FloatArray | None) -> Plot:
    """Epsilon and normalised min-weight (m,) of the measured contacts; 0 is no closure.

    A negative min-weight is drawn as 0: without closure it has no lower bound, and its size says
    nothing.
    """
    lines = [Line(name="epsilon (L1)", values=epsilon)]
    if min_weight is not None:
        name = "min-weight, normalised, 0 if negative"
        lines.append(Line(name=name, values=np.maximum(min_weight, 0.0)))
    return Plot(title="Force closure of the measured contacts", unit="", lines=tuple(lines))


def command_plot(recording: Recording, hand: Hand | None) -> Plot | None:
    """Commands as shares of the actuators' ranges; None where no actuator has a range."""
    low, high = recording.control_range.T
    limited = np.flatnonzero(np.isfinite(low) & np.isfinite(high) & (high > low))
    if not len(limited):
        return None
    share = (recording.commands - low) / np.where(high > low, high - low, 1.0)
    lines = [
        Line(name=recording.actuator_names[k], values=share[:, k], group=_finger_of(hand, int(k)))
        for k in limited
    ]
    limits = [
        Line(name=name, values=np.array([value]), dashed=True)
        for name, value in (("lower limit", 0.0), ("upper limit", 1.0))
    ]
    return Plot(title="Commands within their limits", unit="", lines=(*lines, *limits))


def _finger_of(hand: Hand | None, actuator: int) -> str:
    """The finger that an actuator moves, "" for none or several."""
    if hand is None:
        return ""
    moved = np.flatnonzero(hand.actuation.moment[actuator])
    names = [f.name for f in hand.fingers.values() if np.isin(moved, f.q_index).all()]
    return names[0] if len(names) == 1 else ""


def phase_bands(time: Sequence[float], phase: Sequence[str]) -> tuple[Band, ...]:
    """Phases as spans of time: each begins where the one before ended."""
    bands: list[Band] = []
    begin, at = 0.0, 0
    for name, samples in groupby(phase):
        at += len(list(samples))
        bands.append(Band(name=name, begin=begin, end=time[at - 1]))
        begin = time[at - 1]
    return tuple(bands)


def event_marks(events: Sequence[EventData], shift: float = 0.0) -> tuple[Mark, ...]:
    """What a controller noticed, on an axis on which its time begins at ``shift``, s.

    What it was told to do is left out: phases show it.
    """
    return tuple(
        Mark(
            time=e.time_s + shift,
            text=f"{e.kind} {e.finger}".rstrip() + (f": {e.detail}" if e.detail else ""),
        )
        for e in events
        if e.kind not in AS_TOLD
    )
