"""Contact modes over time: what every finger does to the object, planned and measured.

    off     the finger does not touch (a planned one is told to be off)
    break   it does not touch although it should
    slip    the object slides over it faster than ``SLIP_SPEED``
    roll    it does not slide, and the contact wanders over the object faster than ``ROLL_SPEED``
    stick   neither

Where sticking ends and rolling begins is a matter of speed: any round tip rolls a little.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import interp1d

from planner.motion import MotionPlan
from planner.spatial import FloatArray, IntArray
from sim.controllers.monitors import SLIP_SPEED
from sim.manipulation.timeline import PHASES, ManipulationPhase

Mode: TypeAlias = Literal["off", "break", "slip", "roll", "stick"]

MODES: tuple[Mode, ...] = Mode.__args__  # type: ignore[attr-defined]

ROLL_SPEED = 0.002
"""Speed (m/s) of the contact over the object from which on it rolls: a tip of 12 mm that turns by
10 degrees a second against the object."""

MODE_LETTERS = 60
"""Approximate number of letters for the contact modes of a turn."""

LETTERS = (("stick", "s"), ("roll", "r"), ("slip", "S"), ("break", "!"), ("off", "-"))
"""One for each mode."""

SPAN = 2
"""Samples to either side over which the speed of a contact is taken: the centre of several contacts
jumps when one of them opens."""


def measured_modes(
    time: FloatArray, points: FloatArray, sliding: FloatArray, wanted: NDArray[np.bool_]
) -> NDArray[np.str_]:
    """Modes (m, n) of m samples of n fingers.

    Args:
        time: (m,), s.
        points: (m, n, 3), contacts in the object's frame, m; NaN without contact.
        sliding: (m, n), speed of the object over the pad, m/s; NaN without contact.
        wanted: (m, n), which fingers were to touch.
    """
    speed = wandering(time, points)
    touching = np.isfinite(points[..., 0])
    modes = np.where(np.nan_to_num(speed) > ROLL_SPEED, "roll", "stick")
    modes = np.where(np.nan_to_num(sliding) > SLIP_SPEED, "slip", modes)
    return np.where(touching, modes, np.where(wanted, "break", "off"))


def planned_modes(time: FloatArray, points: FloatArray) -> NDArray[np.str_]:
    """The same of planned contacts (m, n, 3) in the object's frame: NaN is off; none slips."""
    modes = np.where(np.nan_to_num(wandering(time, points)) > ROLL_SPEED, "roll", "stick")
    return np.where(np.isfinite(points[..., 0]), modes, "off")


def wandering(time: FloatArray, points: FloatArray) -> FloatArray:
    """Speed (m, n), m/s, of contacts (m, n, 3) over the object; NaN next to a missing one."""
    m = len(time)
    if m < 2:
        return np.full(points.shape[:2], np.nan)
    index = np.arange(m)
    before, after = np.maximum(index - SPAN, 0), np.minimum(index + SPAN, m - 1)
    moved = np.linalg.norm(points[after] - points[before], axis=2)
    return np.asarray(moved / (time[after] - time[before])[:, None])


def planned_points(
    motion: MotionPlan,
    path_parameter: FloatArray,
    phase: tuple[ManipulationPhase, ...],
    away: NDArray[np.bool_],
) -> FloatArray:
    """Planned contacts (m, n, 3) in the object's frame; NaN before the grip and after the release.

    Args:
        motion: The plan.
        path_parameter: (m,), where on its path the reference is, 0 to 1.
        phase: m phases.
        away: (m, n), which fingers are to be off the object.
    """
    points = np.array([k.contacts_in_object.positions for k in motion.knots])
    planned = interp1d([k.path_parameter for k in motion.knots], points, axis=0)(path_parameter)
    order = {name: k for k, name in enumerate(PHASES)}
    order["regrasp"] = order["back"] = order["turn"]
    index = np.array([order[p] for p in phase], dtype=int)
    off = (index < order["verify"]) | (index > order["lower"])
    planned[off[:, None] | away] = np.nan
    return np.asarray(planned)


def mode_table(planned: NDArray[np.str_], measured: NDArray[np.str_]) -> dict[str, dict[str, int]]:
    """How many samples planned as the first were measured as the second; zeros left out."""
    out: dict[str, dict[str, int]] = {}
    for mode in MODES:
        row = {m: int(((planned == mode) & (measured == m)).sum()) for m in MODES}
        if any(row.values()):
            out[mode] = {m: n for m, n in row.items() if n}
    return out


def told_modes(
    fingers: Sequence[str],
    planned: NDArray[np.str_],
    measured: NDArray[np.str_],
    turning: IntArray,
) -> list[str]:
    """Contact modes of each finger while the object is turned, planned above measured.

    Args:
        fingers: Names of n fingers.
        planned: (m, n), modes of all samples.
        measured: (m, n), likewise.
        turning: Numbers of the samples of the turn.
    """
    index = turning[:: max(1, len(turning) // MODE_LETTERS)]
    lines = [f"contact modes during the turn ({', '.join(f'{v} {k}' for k, v in LETTERS)}):"]
    width = max(len(f) for f in fingers)
    for i, finger in enumerate(fingers):
        for name, modes in (("planned", planned), ("measured", measured)):
            row = "".join(dict(LETTERS)[str(m)] for m in modes[index, i])
            lines.append(f"  {finger:<{width}} {name:<8} {row}")
    return lines
