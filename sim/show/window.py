"""MuJoCo's live viewer beside a trial, in real time."""

from __future__ import annotations

import os
import sys
import time
from typing import Any

from planner.errors import TaskError

FRAME = 1.0 / 60.0
"""Time between two pictures, s."""


def check_display() -> None:
    """See whether a window could open.

    Raises:
        TaskError: There is no display.
    """
    displays = ("DISPLAY", "WAYLAND_DISPLAY")
    if sys.platform == "linux" and not any(os.environ.get(d) for d in displays):
        raise TaskError("there is no display to show the trial on; run it without the viewer")


class Viewer:
    """A window that follows a simulation; closing it lets the simulation go on unseen."""

    def __init__(self, model: Any, data: Any) -> None:
        """Open the window.

        Raises:
            TaskError: There is no display, or MuJoCo cannot open a window on it.
        """
        check_display()
        import mujoco.viewer  # opens a connection to the display

        try:
            self._handle = mujoco.viewer.launch_passive(model, data)
        except RuntimeError as error:
            raise TaskError(
                f"MuJoCo's viewer does not open: {error}; run without the viewer (on macOS, start "
                "Python as mjpython)"
            ) from error
        self._begin = time.perf_counter() - data.time
        self._next = 0.0

    def show(self, now: float) -> None:
        """Draw if a picture is due at simulated time ``now`` (s), and wait until then."""
        if now < self._next or not self._handle.is_running():
            return
        self._next = now + FRAME
        self._handle.sync()
        time.sleep(max(0.0, self._begin + now - time.perf_counter()))

    def close(self) -> None:
        """Close the window."""
        self._handle.close()
