"""``Tape``: states of a simulation, kept for pictures and films that are drawn afterwards.

It only reads, so that a simulation goes on as it would without it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from planner.contacts import ContactSet
from planner.spatial import FloatArray
from sim.looking.painter import Arrows
from sim.looking.view import Subject

__all__ = ["FRAME_RATE", "Frame", "Tape"]

FRAME_RATE = 25.0
"""States kept per simulated second."""


@dataclass(frozen=True, kw_only=True)
class Frame:
    """One state.

    Attributes:
        time: s.
        qpos: State (nq,) of the model.
        arrows: Forces of the hand on the object; None if they are not known.
    """

    time: float
    qpos: FloatArray
    arrows: Arrows | None = None


class Tape:
    """States of one model in the order of time.

    Attributes:
        model: ``mujoco.MjModel``.
        subject: What its pictures are about.
        frames: What was kept.
    """

    def __init__(self, model: Any, subject: Subject) -> None:
        """An empty tape."""
        self.model, self.subject = model, subject
        self.frames: list[Frame] = []

    def keep(self, time: float, qpos: FloatArray, contacts: ContactSet | None = None) -> None:
        """Keep a state.

        Args:
            time: s; not before the last one's.
            qpos: State (nq,).
            contacts: Contacts with the object, whose forces arrows may show.
        """
        arrows = None
        if contacts is not None:
            arrows = Arrows(
                points=contacts.positions,
                forces=np.nan_to_num(contacts.forces_in_axes()),
                object_body=self.subject.object_body,
            )
        self.frames.append(Frame(time=time, qpos=np.array(qpos), arrows=arrows))

    def at(self, time: float | None) -> Frame:
        """The state kept next to a time (s); the last one if None."""
        if time is None:
            return self.frames[-1]
        return min(self.frames, key=lambda frame: abs(frame.time - time))

    def evenly(self, rate: float, most: int) -> tuple[list[Frame], float]:
        """States at an even rate, and by how much a film of them is faster than the simulation.

        Args:
            rate: Frames per second of the film.
            most: Frames that it may have; a longer simulation is shown faster.
        """
        times = np.array([frame.time for frame in self.frames])
        length = times[-1] - times[0]
        speed = max(1.0, length * rate / most)
        wanted = times[0] + np.arange(0.0, length + 1e-9, speed / rate)
        after = np.minimum(np.searchsorted(times, wanted), len(times) - 1)
        before = np.maximum(after - 1, 0)
        nearer = np.where(wanted - times[before] < times[after] - wanted, before, after)
        return [self.frames[i] for i in nearer], speed
