"""``StateRecorder``: takes the states of a simulation that a ``Recording`` holds.

It copies what MuJoCo has and computes nothing while the simulation runs, so that a run with it is
the same run. Poses are made from the joints of the same moment: MuJoCo's own poses are those of the
step before.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from planner.spatial import FloatArray, pose_to_wxyz
from sim.contacts import ContactHistory
from sim.recording import PALM, Recording
from sim.simulation import Simulation

__all__ = ["StateRecorder"]


class StateRecorder:
    """States of one simulation, one row per call of ``take``.

    Attributes:
        contacts: Contacts at the same moments, of the steps that ended then.
    """

    def __init__(self, simulation: Simulation) -> None:
        """Start empty."""
        self._simulation = simulation
        scene = simulation.scene
        self._gantry = np.zeros(0, dtype=int) if scene.gantry is None else scene.gantry.qpos
        self._base = simulation.plan.T_world_base  # of a hand on an arm, whose base stands
        self._phases: list[str] = []
        self._rows: list[FloatArray] = []
        self.contacts = ContactHistory(scene.model, scene.object_body, scene.finger_of_geom)

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
        self.contacts.note(data)

    def recording(self) -> Recording:
        """Everything taken so far."""
        scene, task = self._simulation.scene, self._simulation.plan.task
        sizes = (1, len(scene.hand_qpos), 7, len(scene.hand_ctrl), len(self._gantry))
        rows = np.array(self._rows).reshape(-1, sum(sizes))
        time, q, T_world_object, commands, gantry = np.split(rows, np.cumsum(sizes)[:-1], axis=1)
        quaternion = T_world_object[:, 3:]
        quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
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
            **self._columns(task.finger_names),
        )

    def _bases(self, gantry: FloatArray) -> FloatArray:
        """Poses of the base (m, 7) from the joints of what carries it; an arm's base stands."""
        carrier = self._simulation.scene.gantry
        if carrier is None:
            return np.tile(np.concatenate(pose_to_wxyz(self._base)), (len(gantry), 1))
        rows = [np.concatenate(pose_to_wxyz(carrier.pose(row))) for row in gantry]
        return np.array(rows).reshape(-1, 7)

    def _columns(self, fingers: tuple[str, ...]) -> dict[str, Any]:
        """Contacts as arrays with a column per finger, and per other part that touched."""
        rows = self.contacts.rows().merged
        seen = (rows.names[k] or PALM for k in dict.fromkeys(rows.finger.tolist()))
        names = tuple(dict.fromkeys((*fingers, *seen)))
        column = np.array(
            [names.index(n or PALM) if (n or PALM) in names else -1 for n in rows.names]
        )
        m, k = len(self._rows), len(names)
        points, normals, forces = np.full((3, m, k, 3), np.nan)
        friction = np.full((m, k, 2), np.nan)
        where = rows.moment, column[rows.finger]
        points[where] = rows.positions
        normals[where] = rows.frames[:, :, 0]
        forces[where] = rows.forces_in_axes()
        friction[where] = rows.used_friction()
        return {
            "contact_names": names,
            "points": points,
            "normals": normals,
            "forces": forces,
            "friction": friction,
        }
