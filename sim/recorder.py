"""``Recorder``: takes samples of a trial and turns them into ``Samples`` and comparisons."""

from __future__ import annotations

from typing import Any

import numpy as np

from planner.contacts import ContactSet
from planner.quality import closure_and_epsilon, force_closure
from planner.spatial import SE3, FloatArray, pose_change
from planner.tolerances import CLOSURE_EDGES
from sim.contacts import hand_collision, hand_contacts, merge_per_finger
from sim.recording import Recording
from sim.report import FingerComparison
from sim.samples import Samples
from sim.simulation import Simulation
from sim.states import StateRecorder

__all__ = ["Recorder"]

NAN = float("nan")


class Recorder:
    """Samples of one simulation, taken at most every so often.

    Attributes:
        every: Time between samples, s.
    """

    def __init__(self, simulation: Simulation, every: float) -> None:
        """Start empty.

        Args:
            simulation: What is watched.
            every: Time between samples, s.
        """
        self.every = every
        self._simulation = simulation
        task = simulation.plan.task
        self._fingers = task.finger_names
        self._length = task.object.shape.bounding_radius
        self._reference: SE3 | None = None
        self._rows: list[dict[str, Any]] = []
        self._states = StateRecorder(simulation)
        self._held: list[tuple[FloatArray, FloatArray]] = []

    def mark_reference(self) -> None:
        """From now on, slip is movement relative to how the object lies in the palm now."""
        self._reference = self._simulation.T_palm_object

    def record(self) -> None:
        """Take a sample of now."""
        simulation = self._simulation
        scene, data, phase = simulation.scene, simulation.data, simulation.phase
        raw = hand_contacts(scene, data)
        merged = merge_per_finger(raw)
        closed, epsilon = closure_and_epsilon(merged, length=self._length)
        unmerged = closed
        if len(raw) != len(merged):
            unmerged = force_closure(raw, CLOSURE_EDGES).closed
        T_world_object, first = simulation.T_world_object, simulation.plan.task.T_world_object
        moved, turned = pose_change(first, T_world_object)
        slip = self.slip()
        collision, force = hand_collision(scene, data)
        normal, used = self._per_finger(merged)
        self._rows.append(
            {
                "time": float(data.time),
                "phase": phase,
                "contacts": [raw.fingers.count(f) for f in self._fingers],
                "palm_contacts": sum(f not in self._fingers for f in raw.fingers),
                "normal_force": normal,
                "friction_utilisation": used,
                "closed": closed,
                "closed_unmerged": unmerged,
                "epsilon": epsilon,
                "slip_mm": slip[0],
                "slip_deg": slip[1],
                "moved_mm": moved,
                "turned_deg": turned,
                "lift_mm": 1e3 * (T_world_object.translation[2] - first.translation[2]),
                "collision_N": force,
                "collision": collision,
                "saturated": simulation.saturated_actuators(),
            }
        )
        self._states.take(phase, merged)
        if phase == "hold":
            self._held.append(self._positions(merged, T_world_object, normal))

    def samples(self) -> Samples:
        """Everything recorded so far."""
        return Samples.from_rows(self._rows, len(self._fingers))

    def recording(self) -> Recording:
        """The states at the same times."""
        return self._states.recording()

    def comparison(self) -> tuple[FingerComparison, ...]:
        """Planned against measured contacts while holding; empty if it never came to that."""
        if not self._held:
            return ()
        planned = self._simulation.plan.contacts_in_object
        position = np.array([p for p, _ in self._held])  # (m, n, 3)
        force = np.array([f for _, f in self._held])  # (m, n)
        out = []
        for i, finger in enumerate(self._fingers):
            known = position[np.isfinite(position[:, i, 0]), i]
            mean = known.mean(axis=0) if len(known) else np.full(3, NAN)
            wanted = float(planned.forces[i, 0])
            error = float(np.abs(force[:, i] - wanted).mean())
            out.append(
                FingerComparison(
                    finger=finger,
                    planned_position=planned.positions[i],
                    measured_position=mean,
                    position_error_mm=1e3 * float(np.linalg.norm(mean - planned.positions[i])),
                    planned_normal_force=wanted,
                    measured_normal_force=float(force[:, i].mean()),
                    force_error_N=error,
                    force_error_percent=100.0 * error / wanted if wanted > 0 else NAN,
                )
            )
        return tuple(out)

    def slip(self) -> tuple[float, float]:
        """Movement (mm) and rotation (degrees) in the palm since the reference; NaN before."""
        if self._reference is None:
            return NAN, NAN
        return pose_change(self._reference, self._simulation.T_palm_object)

    def _per_finger(self, merged: ContactSet) -> tuple[list[float], list[float]]:
        """Normal force (N, 0 without contact) and friction utilisation (NaN) of each finger."""
        used = merged.friction_utilisation() if len(merged) else np.zeros(0)
        where = {f: i for i, f in enumerate(merged.fingers)}
        normal = [float(merged.forces[where[f], 0]) if f in where else 0.0 for f in self._fingers]
        return normal, [float(used[where[f]]) if f in where else NAN for f in self._fingers]

    def _positions(
        self, merged: ContactSet, T_world_object: SE3, normal: list[float]
    ) -> tuple[FloatArray, FloatArray]:
        """Contact positions (n, 3) in the object's frame (NaN: no contact) and normal forces."""
        local = merged.transformed(T_world_object.inverse())
        position = np.full((len(self._fingers), 3), NAN)
        for i, finger in enumerate(self._fingers):
            if finger in local.fingers:
                position[i] = local.positions[local.fingers.index(finger)]
        return position, np.array(normal)
