"""``StateRecorder``: takes the states of a simulation that a ``Recording`` holds.

It copies what MuJoCo has and what the controller read, and computes nothing while the simulation
runs, so that a run with it is the same run. Poses are made from the joints of the same moment:
MuJoCo's own poses are those of the step before.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from planner.spatial import FloatArray, pose_to_wxyz
from sim.recording import Recording
from sim.simulation import Simulation

__all__ = ["StateRecorder"]


class StateRecorder:
    """States of one simulation, one row per call of ``take``."""

    def __init__(self, simulation: Simulation) -> None:
        """Start empty."""
        self._simulation = simulation
        scene = simulation.scene
        self._gantry = np.zeros(0, dtype=int) if scene.gantry is None else scene.gantry.qpos
        self._base = simulation.plan.T_world_base  # of a hand on an arm, whose base stands
        self._phases: list[str] = []
        self._rows: list[FloatArray] = []
        self._read: list[tuple[FloatArray, FloatArray] | None] = []

    def take(self, phase: str) -> None:
        """Take the state of now, which belongs to a phase."""
        scene, data = self._simulation.scene, self._simulation.data
        parts = (
            [data.time],
            data.qpos[scene.hand_qpos],
            data.qpos[scene.object_qpos],
            data.ctrl[scene.hand_ctrl],
            data.qpos[self._gantry],
        )
        self._rows.append(np.concatenate(parts))
        self._phases.append(phase)
        seen, read = self._simulation.seen, None
        if seen is not None:
            read = seen.q.copy(), np.concatenate(pose_to_wxyz(seen.T_world_object))
        self._read.append(read)

    def recording(self, contacts: Mapping[str, Any]) -> Recording:
        """Everything taken so far.

        Args:
            contacts: Fields of ``Recording`` about the contacts at the same moments.
        """
        scene, task = self._simulation.scene, self._simulation.plan.task
        sizes = (1, len(scene.hand_qpos), 7, len(scene.hand_ctrl), len(self._gantry))
        rows = np.array(self._rows).reshape(-1, sum(sizes))
        time, q, T_world_object, commands, gantry = np.split(rows, np.cumsum(sizes)[:-1], axis=1)
        quaternion = T_world_object[:, 3:]
        quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
        read_q, read_pose = self._readings(q.shape[1])
        return Recording(
            joint_names=task.hand.joint_names,
            actuator_names=task.hand.actuation.names,
            control_range=task.hand.actuation.ctrl_range,
            time=time[:, 0],
            phase=tuple(self._phases),
            q=q,
            T_world_base=self._bases(gantry),
            T_world_object=T_world_object,
            commands=commands,
            read_q=read_q,
            read_T_world_object=read_pose,
            **contacts,
        )

    def _readings(self, nq: int) -> tuple[FloatArray | None, FloatArray | None]:
        """Joints (m, nq) and poses (m, 7) that the controller read; None if that was the truth."""
        if not any(self._read):
            return None, None
        none = np.full(nq, np.nan), np.full(7, np.nan)
        joints, poses = zip(*(none if read is None else read for read in self._read), strict=True)
        return np.array(joints), np.array(poses)

    def _bases(self, gantry: FloatArray) -> FloatArray:
        """Poses of the base (m, 7) from the joints of what carries it; an arm's base stands."""
        carrier = self._simulation.scene.gantry
        if carrier is None:
            return np.tile(np.concatenate(pose_to_wxyz(self._base)), (len(gantry), 1))
        rows = [np.concatenate(pose_to_wxyz(carrier.pose(row))) for row in gantry]
        return np.array(rows).reshape(-1, 7)
