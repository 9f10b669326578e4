"""``EstimateLog``: how far an estimate was from the truth during a trial, as a table or a picture.

It is called with the simulation after every time step::

    log = EstimateLog()
    simulate(plan, error_model=ERROR_MODELS["lab"], on_step=log)
    log.write_csv("errors.csv")
    log.draw("errors.png")
"""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pinocchio as pin

from planner.errors import FileFormatError, TaskError
from planner.spatial import FloatArray
from sim.controllers import Observation

AXES = ("x", "y", "z")


class _Simulation(Protocol):
    @property
    def told(self) -> tuple[Observation, Observation] | None: ...


class EstimateLog:
    """Errors of the estimated pose over time, true minus estimated, world axes.

    An empty log has arrays without rows; what sums it up, writes or draws it raises a TaskError.

    Attributes:
        every: Time between samples, s.
    """

    def __init__(self, every: float = 0.01) -> None:
        """Start empty."""
        self.every = every
        self._rows: list[tuple[float, str, FloatArray, FloatArray, bool]] = []

    def __call__(self, simulation: _Simulation) -> None:
        """Note what the estimator of a ``Simulation`` gave last, if it has one."""
        if simulation.told is not None:
            self.note(*simulation.told)

    def note(self, truth: Observation, estimated: Observation) -> None:
        """Note an estimate, unless the last one is too near in time."""
        if estimated.uncertainty is None:
            return
        if self._rows and truth.time < self._rows[-1][0] + self.every - 1e-9:
            return
        true, other = truth.T_world_object, estimated.T_world_object
        turned = pin.log3(true.rotation @ other.rotation.T)
        error = np.concatenate([true.translation - other.translation, turned])
        deviation = np.sqrt(np.diagonal(estimated.uncertainty.covariance))
        self._rows.append((truth.time, truth.phase, error, deviation, estimated.uncertainty.known))

    def __len__(self) -> int:
        """Number of samples."""
        return len(self._rows)

    @property
    def time(self) -> FloatArray:
        """(m,), s."""
        return np.array([row[0] for row in self._rows])

    @property
    def phase(self) -> tuple[str, ...]:
        """M phases."""
        return tuple(row[1] for row in self._rows)

    @property
    def error(self) -> FloatArray:
        """(m, 6), of position, m, and rotation vector, rad."""
        return np.array([row[2] for row in self._rows]).reshape(-1, 6)

    @property
    def deviation(self) -> FloatArray:
        """(m, 6), standard deviations that were believed, m and rad."""
        return np.array([row[3] for row in self._rows]).reshape(-1, 6)

    @property
    def within_two_sigma(self) -> float:
        """Share of all errors within two believed standard deviations.

        Raises:
            TaskError: Nothing was noted.
        """
        self._check_noted()
        return float((np.abs(self.error) < 2.0 * self.deviation).mean())

    def write_csv(self, path: Path | str) -> None:
        """Write a line per sample: time, phase, errors, deviations, whether the pose was known.

        Raises:
            TaskError: Nothing was noted.
            FileFormatError: The file cannot be written.
        """
        self._check_noted()
        kinds = [(f"{axis}_mm", 1e3) for axis in AXES]
        kinds += [(f"about_{axis}_deg", float(np.rad2deg(1.0))) for axis in AXES]
        names = [name for name, _ in kinds]
        scale = np.array([factor for _, factor in kinds])
        head = ["time_s", "phase", *(f"error_{n}" for n in names), *(f"sigma_{n}" for n in names)]
        try:
            with Path(path).open("w", encoding="utf-8", newline="") as stream:
                writer = csv.writer(stream)
                writer.writerow([*head, "known"])
                for time, phase, error, deviation, known in self._rows:
                    numbers = np.concatenate([scale * error, scale * deviation])
                    cells = [f"{v:.4f}" for v in numbers]
                    writer.writerow([f"{time:.3f}", phase, *cells, int(known)])
        except OSError as problem:
            raise FileFormatError(f"cannot write {path}: {problem.strerror}") from problem

    def draw(self, path: Path | str) -> None:
        """Draw the errors against two standard deviations, axis by axis.

        Raises:
            TaskError: Nothing was noted, or Matplotlib is not installed.
        """
        self._check_noted()
        try:
            from matplotlib.figure import Figure
        except ImportError as problem:
            raise TaskError("drawing needs Matplotlib: pip install 'opposable[plot]'") from problem
        figure = Figure(figsize=(10.0, 8.0), layout="constrained")
        grid: Any = figure.subplots(3, 2, sharex=True)
        time, error, deviation = self.time, self.error, self.deviation
        for k in range(6):
            axes, scale = grid[k % 3, k // 3], 1e3 if k < 3 else float(np.rad2deg(1.0))
            band = 2.0 * scale * deviation[:, k]
            axes.fill_between(time, -band, band, alpha=0.2, label="two sigma")
            axes.plot(time, scale * error[:, k], lw=1.0, label="true minus estimated")
            unit = f"{AXES[k % 3]} [mm]" if k < 3 else f"about {AXES[k % 3]} [degrees]"
            axes.set_ylabel(unit)
            axes.grid(alpha=0.3)
            for begin, name in self._phases():
                axes.axvline(begin, color="0.6", lw=0.6)
                if k % 3 == 0:
                    across = axes.get_xaxis_transform()
                    axes.text(begin, 1.01, name, transform=across, fontsize=7, rotation=40)
        for axes in grid[2]:
            axes.set_xlabel("time [s]")
        grid[2, 0].legend(fontsize=8)
        figure.savefig(path, dpi=110)

    def _check_noted(self) -> None:
        if not self._rows:
            raise TaskError("nothing was noted; give a trial with an estimator on_step=log")

    def _phases(self) -> list[tuple[float, str]]:
        """When each phase begins, s."""
        out: list[tuple[float, str]] = []
        for time, phase, *_ in self._rows:
            if not out or out[-1][1] != phase:
                out.append((time, phase))
        return out
