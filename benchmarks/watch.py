"""``TouchWatch``: senses of touch that look on while something else happens, scored by the truth.

A slip is a pad over which the object moves by ``SLID`` within ``WITHIN``; it is noticed when the
sense says so up to ``LATE`` afterwards. An alarm is false when the pad slides by less than
``NOTHING`` from ``WITHIN`` before to ``LATE`` after it. Fingers that press less than ``LOADED``
count neither way: they close or open.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.spatial import FloatArray
from sim.controllers import Observation, PadReading
from sim.sensing.touch import TOUCH_SENSES, TouchContext, make_sense
from sim.sensing.touch.taxels import TaxelSense
from sim.simulation import Simulation

SENSES = ("taxels", "effort", "binary")
"""Senses that look on."""

SLID, WITHIN, LATE, NOTHING = 1e-4, 0.1, 0.05, 2e-5
"""Slid distance (m) of a slip, within a time (s); how long after it an alarm still counts (s); slid
distance (m) below which an alarm is false."""

LOADED = 0.3
"""Normal force (N) from which on a pad counts."""

SAMPLE_EVERY = 5
"""Time steps between samples of errors (-); slips are looked for at every step."""


class TouchWatch:
    """Senses beside a simulation; call ``look`` after every time step.

    Attributes:
        simulation: What is watched.
    """

    def __init__(self, simulation: Simulation, seed: int, senses: Sequence[str] = SENSES) -> None:
        """Make the senses.

        Args:
            simulation: What is watched.
            seed: Of their noise.
            senses: Their names.
        """
        self.simulation = simulation
        context = TouchContext(
            scene=simulation.scene, data=simulation.data, plan=simulation.plan, seed=seed
        )
        self._senses = {name: make_sense(name, context) for name in senses if name in TOUCH_SENSES}
        self._errors: dict[str, dict[str, list[float]]] = {name: {} for name in self._senses}
        self._spent = dict.fromkeys(self._senses, 0.0)
        self._rows: list[tuple[float, FloatArray, FloatArray, NDArray[np.bool_], FloatArray]] = []

    def look(self) -> None:
        """Look on at the end of a time step."""
        simulation = self.simulation
        truth = simulation.observe(simulation.phase, 0.0)
        exact = truth.pads
        n = len(exact.normal_force)
        slipping, friction = np.zeros(n, dtype=bool), np.full(n, math.nan)
        for name, sense in self._senses.items():
            begin = time.process_time()
            seen = sense.read(truth)
            pads = seen.pads
            self._spent[name] += time.process_time() - begin
            if pads.slipping is not None:
                slipping = pads.slipping
            if isinstance(sense, TaxelSense):
                friction = sense.friction.friction.copy()
            if len(self._rows) % SAMPLE_EVERY == 0:
                self._compare(name, seen, exact)
        row = (truth.time, exact.sliding_speed, exact.normal_force, slipping, friction)
        self._rows.append(row)

    def _compare(self, name: str, seen: Observation, exact: PadReading) -> None:
        pads, errors = seen.pads, self._errors[name]
        for k in np.flatnonzero(exact.normal_force >= LOADED).tolist():
            true, force = float(exact.normal_force[k]), float(pads.normal_force[k])
            felt = force > 0
            errors.setdefault("felt", []).append(float(felt))
            if not felt:
                continue
            off = np.linalg.norm(pads.position[k] - exact.position[k])
            cosine = float(np.clip(pads.normal[k] @ exact.normal[k], -1.0, 1.0))
            errors.setdefault("place_mm", []).append(1e3 * float(off))
            errors.setdefault("normal_deg", []).append(math.degrees(math.acos(cosine)))
            errors.setdefault("force", []).append(abs(force / true - 1.0))
            miss = np.linalg.norm(pads.force[k] - exact.force[k])
            errors.setdefault("force_vector", []).append(float(miss) / true)

    def result(self, mu: float) -> dict[str, Any]:
        """Errors, times and slips so far, as plain data.

        Args:
            mu: True friction (-).
        """
        steps = max(1, len(self._rows))
        senses = [
            {
                "sense": name,
                "samples": len(errors.get("felt", [])),
                "felt": float(np.mean(errors["felt"])) if errors.get("felt") else None,
                **{key: float(np.median(v)) for key, v in errors.items() if key != "felt"},
                "us": 1e6 * self._spent[name] / steps,
            }
            for name, errors in self._errors.items()
        ]
        if not self._rows:
            return {"senses": senses, "slips": None}
        times, speed, force, slipping, friction = (
            np.array(part) for part in zip(*self._rows, strict=True)
        )
        loaded = force >= LOADED
        off = np.abs(friction[loaded] / mu - 1.0)
        known = off[np.isfinite(off)]
        return {
            "senses": senses,
            "slips": score(times, speed, force, slipping),
            "friction_off": float(np.median(known)) if len(known) else None,
        }


def score(
    times: FloatArray, speed: FloatArray, force: FloatArray, slipping: NDArray[np.bool_]
) -> dict[str, Any]:
    """How well slips were noticed.

    Args:
        times: (m,), s, evenly spaced.
        speed: (m, n), true sliding speed over each pad, m/s.
        force: (m, n), true normal forces, N.
        slipping: (m, n), what the sense says.
    """
    dt = float(times[1] - times[0]) if len(times) > 1 else 1.0
    before, after = round(WITHIN / dt), round(LATE / dt)
    slips, delays, alarms, false, early = 0, [], 0, 0, 0
    for k in range(speed.shape[1]):
        loaded = force[:, k] >= LOADED
        path = np.concatenate([[0.0], np.cumsum(speed[:, k] * dt)])
        slid = path[1:] - path[np.maximum(np.arange(1, len(path)) - before, 0)]
        told = slipping[:, k]
        for at in _begins(slid >= SLID):
            if not loaded[at]:
                continue
            slips += 1
            first = max(0, at - before)
            hits = np.flatnonzero(told[first : at + after + 1])
            if len(hits):
                delays.append(float((first + hits[0] - at) * dt))
        for at in _begins(told):
            if not loaded[at]:
                continue
            alarms += 1
            last = min(at + after, len(times) - 1)
            moved = path[last + 1] - path[max(0, at - before)]
            false += bool(moved < NOTHING)
            early += bool(NOTHING <= moved < SLID)
    return {
        "seconds": float(dt * (force >= LOADED).any(axis=1).sum()),
        "slips": slips,
        "noticed": len(delays),
        "delays_s": delays,
        "alarms": alarms,
        "early": early,
        "false": false,
    }


def _begins(values: NDArray[np.bool_]) -> list[int]:
    """Where a row of yes and no changes to yes."""
    edges: list[int] = np.flatnonzero(np.diff(np.r_[False, values].astype(int)) == 1).tolist()
    return edges
