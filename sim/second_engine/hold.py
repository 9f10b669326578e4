"""``hold_in_drake``: whether an exported grasp holds its object in Drake by its commands alone."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from planner.spatial import SE3, FloatArray, pose_change
from sim.second_engine.drake_scene import TIME_STEP, DrakeScene, load_drake_scene

__all__ = ["Held", "hold_in_drake"]

SAMPLE_EVERY = 0.02
"""Time between samples, s."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Held:
    """What became of a hold in another engine; m samples.

    Attributes:
        held: Whether the object stayed within the limits to the end.
        detail: What was seen, a sentence.
        time: (m,), s.
        moved_mm, turned_deg: (m,), of the object since the start.
        contacts: (m,), contacts of the object with the hand.
        deepest_mm: Deepest penetration of the object at the start.
    """

    held: bool
    detail: str
    time: FloatArray
    moved_mm: FloatArray
    turned_deg: FloatArray
    contacts: FloatArray
    deepest_mm: float


def hold_in_drake(
    folder: Path,
    *,
    seconds: float | None = None,
    wrench: FloatArray | None = None,
    time_step: float = TIME_STEP,
) -> Held:
    """Begin at the key frame "grasp", command "squeeze", and look for some time.

    Args:
        folder: An exported scene.
        seconds: How long; what the export's own check says if None.
        wrench: Force (N) and torque (N m) (6,) on the object's centre of mass, world axes, from the
            beginning of the second half; none if None.
        time_step: Of Drake's solver, s.

    Raises:
        TaskError: Drake is not installed.
        FileFormatError: The folder is no export, or Drake cannot read it.
    """
    scene = load_drake_scene(folder, time_step=time_step)
    return _Trial(scene).run(scene.check["seconds"] if seconds is None else seconds, wrench)


class _Trial:
    """A simulator at the start of a hold."""

    def __init__(self, scene: DrakeScene) -> None:
        """Put hand and object where they are at the grasp, and command the squeeze."""
        from pydrake.math import RigidTransform
        from pydrake.systems.analysis import Simulator

        self._scene, plant = scene, scene.plant
        self._simulator = Simulator(scene.diagram)
        root = self._simulator.get_mutable_context()
        self._context = plant.GetMyMutableContextFromRoot(root)
        q = plant.GetPositions(self._context)
        grasp, squeeze = scene.key_frames["grasp"], scene.key_frames["squeeze"]
        q[scene.q_index] = [grasp["joints"][name] for name in scene.joints]
        plant.SetPositions(self._context, q)
        plant.SetFreeBodyPose(
            self._context, scene.object_body, RigidTransform(scene.T_world_object.homogeneous)
        )
        count = plant.num_actuators()
        desired = np.zeros(2 * count)
        for name, (place, factor, offset) in scene.wanted.items():
            desired[place] = factor * squeeze["commands"][name] + offset
        instance = scene.object_body.model_instance()
        plant.get_desired_state_input_port(instance).FixValue(self._context, desired)
        self._commands = np.array([squeeze["commands"][n] for n in scene.explicit.names])
        self._torque = plant.get_applied_generalized_force_input_port()

    def run(self, seconds: float, wrench: FloatArray | None) -> Held:
        """Simulate."""
        scene, check = self._scene, self._scene.check
        step = float(scene.plant.time_step())
        steps, every = round(seconds / step), max(1, round(SAMPLE_EVERY / step))
        begin, deepest = self._object_pose(), 0.0
        rows = []
        for k in range(steps + 1):
            now = k * step
            self._push(wrench if wrench is not None and now >= seconds / 2 else None)
            if k % every == 0 or k == steps:
                moved = pose_change(begin, self._object_pose())
                contacts, depth = self._contacts()
                deepest = max(deepest, depth) if k == 0 else deepest
                rows.append((now, *moved, contacts))
                if not np.isfinite(moved).all():
                    break
                if moved[0] > check["most_mm"] or moved[1] > check["most_deg"]:
                    break
            if k < steps:
                self._simulator.AdvanceTo(now + step)
        time, mm, deg, contacts = np.array(rows).T
        held = bool(mm[-1] <= check["most_mm"] and deg[-1] <= check["most_deg"])
        return Held(
            held=held,
            detail=f"after {time[-1]:.2f} s the object had moved {mm[-1]:.1f} mm and turned "
            f"{deg[-1]:.1f} degrees, with {int(contacts[-1])} contacts",
            time=time,
            moved_mm=mm,
            turned_deg=deg,
            contacts=contacts,
            deepest_mm=deepest,
        )

    def _push(self, wrench: FloatArray | None) -> None:
        """Torques of this step that Drake does not make itself, and a push on the object."""
        scene, plant = self._scene, self._scene.plant
        q, v = plant.GetPositions(self._context), plant.GetVelocities(self._context)
        forces = np.zeros(plant.num_velocities())
        forces[scene.v_index] = scene.explicit.torque(
            q[scene.q_index], v[scene.v_index], self._commands
        )
        if wrench is not None:
            first = scene.object_body.floating_velocities_start_in_v()
            # a free body's velocity is angular first, both in world axes
            forces[first : first + 6] = np.concatenate([wrench[3:], wrench[:3]])
        self._torque.FixValue(self._context, forces)

    def _object_pose(self) -> SE3:
        pose = self._scene.plant.EvalBodyPoseInWorld(self._context, self._scene.object_body)
        return SE3(pose.rotation().matrix(), pose.translation())

    def _contacts(self) -> tuple[int, float]:
        """How many points of the object touch, and the deepest of them, mm."""
        port: Any = self._scene.plant.get_geometry_query_input_port()
        query = port.Eval(self._context)
        mine = set(self._scene.plant.GetCollisionGeometriesForBody(self._scene.object_body))
        pairs = [p for p in query.ComputePointPairPenetration() if p.id_A in mine or p.id_B in mine]
        return len(pairs), 1e3 * max((p.depth for p in pairs), default=0.0)
