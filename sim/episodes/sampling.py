"""Which samples of a recording are the frames of an episode with a fixed rate.

A data set with a frame rate has its frames at even times. They are samples as they were recorded:
nothing is interpolated, so that forces and contacts are those of the simulation.
"""

from __future__ import annotations

import numpy as np

from planner.errors import TaskError
from planner.spatial import FloatArray, IntArray

TIME_TOL = 2e-6
"""How far (s) a sample may lie from its frame's time: report files round times to 1e-6 s."""


def rates_of(time: FloatArray) -> tuple[int, ...]:
    """Whole frame rates (1/s) whose frames are samples, highest first; none if none is.

    Args:
        time: Times of the samples (m,), s, at least two.
    """
    period = float(np.median(np.diff(time)))
    rates = []
    for rate in range(int(1.0 / period + 0.5), 0, -1):
        steps = round(1.0 / (rate * period))
        if abs(steps * period - 1.0 / rate) <= steps * TIME_TOL:
            rates.append(rate)
    return tuple(rates)


def frames_at(time: FloatArray, fps: int | None, source: str) -> tuple[int, IntArray]:
    """The frame rate, and the numbers of the samples that are its frames.

    Frames begin at the first sample. Samples after the last frame are left out.

    Args:
        time: Times of the samples (m,), s, increasing.
        fps: Wanted rate, 1/s; the highest that fits if None.
        source: What errors call the episode.

    Raises:
        TaskError: There are too few samples, or no sample lies where a frame is.
    """
    if len(time) < 2:
        raise TaskError(f"{source}: an episode needs two samples or more, and has {len(time)}")
    fitting = rates_of(time)
    allowed = ", ".join(map(str, fitting)) or "none"
    if not fitting or (fps is not None and fps not in fitting):
        period = float(np.median(np.diff(time)))
        wanted = "no whole number of frames a second" if fps is None else f"{fps} frames a second"
        raise TaskError(
            f"{source}: {wanted} cannot be had of samples every {1e3 * period:g} ms without "
            f"inventing states; rates that fit: {allowed}; give one with --fps"
        )
    rate = fitting[0] if fps is None else fps
    count = int((time[-1] - time[0] + TIME_TOL) * rate) + 1
    wanted_times = time[0] + np.arange(count) / rate
    after = np.minimum(np.searchsorted(time, wanted_times - TIME_TOL), len(time) - 1)
    off = np.abs(time[after] - wanted_times) > TIME_TOL
    if off.any():
        raise TaskError(
            f"{source}: there is no sample at {wanted_times[np.argmax(off)]:.4f} s, where a frame "
            f"of {rate} a second is; rates that fit the other samples: {allowed}"
        )
    if count < 2:
        raise TaskError(f"{source}: at {rate} frames a second it has one frame; give a higher rate")
    frames: IntArray = after.astype(np.int64)
    return rate, frames
