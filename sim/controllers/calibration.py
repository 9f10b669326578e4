"""``Calibration``: the encoder offsets that a controller has found, and its readings without them.

Called by ``TouchAgain`` when all fingers touch and by ``ObjectImpedance`` when the squeeze is over,
with what the pads feel, and from then on at every step. Offsets are taken over only where the
contacts contradict the joints as read by more than ``CONTRADICTION``, so exact joints stay exactly
as they are. Contacts beside the pads' balls tell nothing.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planner.kinematics.state import MovingHand
from planner.plan import GraspPlan
from planner.spatial import FloatArray
from sim.controllers.base import Observation
from sim.controllers.offsets import Look, OffsetEstimate, estimate_offsets
from sim.controllers.pads import PadReading

CONTRADICTION = 1.0
"""Root mean square of the contacts' errors in standard deviations (-) from which on joints count as
off: contacts 1 mm off the surface with normals that fit, for instance. Exact joints leave 0.04, 1
degree 0.9 to 2.5, 3 degrees 5 to 14 (four grasps of two hands)."""

OFF_PAD = 0.002
"""Distance (m) of a contact from the pad's ball from which on something else of the finger touches,
an edge of the tip or a link above it: 4 to 39 mm in 6 first touches of 12 (Shadow-type hand, 1
degree), where pads are within 0.1 mm. Such a contact is on no surface whose place is known. Counted
as pads, they left joints 1.1 to 3.1 degrees off that had been 1.0 to 1.3 off."""


class Calibration:
    """Offsets of a hand's encoders as far as they are known.

    Attributes:
        offset: (nq,), reading minus joint, rad; 0 until contacts contradict the readings.
        estimate: What was found last, taken over or not; None before.
    """

    def __init__(self, plan: GraspPlan) -> None:
        """Nothing is known yet."""
        task = plan.task
        self._hand, self._fingers, self._shape = task.hand, task.fingers, task.object.shape
        self._read, self._true = (MovingHand(task.hand, plan.q) for _ in range(2))
        self._looks: list[Look] = []
        self.offset = np.zeros(task.hand.nq)
        self.estimate: OffsetEstimate | None = None

    def learn(self, observation: Observation) -> bool:
        """Look at the contacts of now, as read; whether the offsets have changed.

        Nothing is learned of a hand without pads.
        """
        if not observation.reads_pads:
            return False
        T_base_world = observation.T_world_base.inverse()
        pads = observation.pads
        points = pads.position @ T_base_world.rotation.T + T_base_world.translation
        look = Look(
            q=observation.q,
            T_base_object=T_base_world * observation.T_world_object,
            touching=self._by_pads(observation.q, points),
            points=points,
            normals=pads.normal @ T_base_world.rotation.T,
        )
        if not look.touching.any():
            return False
        self._looks.append(look)
        self.estimate = estimate_offsets(self._hand, self._fingers, self._shape, self._looks)
        if self.estimate.misfit < CONTRADICTION:
            return False
        self.offset = self.estimate.offset
        return True

    def _by_pads(self, q: FloatArray, points: FloatArray) -> NDArray[np.bool_]:
        """Which fingers (n,) touch at points (n, 3) of their pads, base frame, NaN for none."""
        read = self._read.move(q)
        centers = np.array([read.pad_center(finger) for finger in self._fingers])
        radii = np.array([finger.pad.radius for finger in self._fingers])
        away = np.linalg.norm(points - centers, axis=1) - radii
        return np.asarray(np.abs(away) < OFF_PAD)  # NaN is not

    def correct(self, observation: Observation) -> Observation:
        """What would have been read without the offsets; the same object if there are none."""
        if not self.offset.any():
            return observation
        q = observation.q - self.offset
        return observation.altered(q=q, read_pads=lambda: self._moved(observation, q))

    def _moved(self, observation: Observation, q: FloatArray) -> PadReading:
        """Pads feel in their fingertips' frames: where these are follows from the joints."""
        pads, base = observation.pads, observation.T_world_base
        read, true = self._read.move(observation.q), self._true.move(q)
        joints = [finger.pad.joint_id for finger in self._fingers]
        moves = [base * true.joint_pose(j) * (base * read.joint_pose(j)).inverse() for j in joints]
        turns = np.array([move.rotation for move in moves])

        def turned(rows: FloatArray) -> FloatArray:
            return np.asarray((turns @ rows[:, :, None])[:, :, 0])

        return replace(
            pads,
            force=turned(pads.force),
            position=turned(pads.position) + np.array([move.translation for move in moves]),
            normal=turned(pads.normal),
            sliding=turned(pads.sliding),
        )
