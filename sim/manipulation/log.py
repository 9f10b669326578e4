"""``ManipulationLog``: a manipulation over time, channel by channel, and who records it."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planner.quality import closure_and_epsilon
from planner.spatial import SE3, FloatArray, IntArray, signed_twist
from planner.system.process import interrupts_wait
from sim.contacts import ContactHistory
from sim.contacts.reading import read_pads
from sim.manipulation.timeline import ManipulationPhase
from sim.recorder import StateRecorder
from sim.recording import PALM, Recording
from sim.simulation import Simulation


def channel(
    in_file: str, *shape: int, kind: type = float, scale: float = 1.0, per_finger: bool = False
) -> dict[str, Any]:
    """All that is declared of a channel of the log.

    Args:
        in_file: Its name in a report file, with unit.
        shape: Shape of a sample, after the fingers.
        kind: Type of its values.
        scale: What its values are multiplied by for the file.
        per_finger: Whether a sample has a value for each finger that takes part.
    """
    return {
        "in_file": in_file,
        "shape": shape,
        "kind": kind,
        "scale": scale,
        "per_finger": per_finger,
    }


MM, DEG = 1e3, float(np.rad2deg(1.0))


@dataclass(frozen=True, kw_only=True, eq=False)
class ManipulationLog:
    """What happened, m samples, n fingers that take part.

    Turn, tilt and shift are the object's in the palm since the turn began, or since the grip was
    there while it has not.

    Attributes:
        time: (m,), s.
        phase: m phases.
        touching: (m,), how many fingers of the hand touch the object, the palm not counted.
        points: (m, n, 3), merged contacts in the object's frame, m; NaN without contact.
        sliding: (m, n), speed of the object over the pad beyond what spinning explains, m/s; NaN
            without contact.
        closed: (m,), force closure of the measured contacts, merged per finger, with their own
            friction.
        epsilon: (m,), their L1 epsilon (-).
        friction_utilisation: (m, n), share of the friction cone in use (-); NaN without contact.
        turn: (m,), signed twist about the axis of the turn, rad.
        tilt: (m,), rotation beside that, rad.
        shift: (m, 3), translation, m, palm axes.
        off_path: (m,), distance from where the reference has the object, m; NaN before the turn.
        path_parameter: (m,), where on the planned path the reference is, 0 to 1.
        away: (m, n), which fingers are told to be off the object.
        normal_force: (m, n), N, on the object, mean over the time steps since the last sample.
        peak_force: (m, n), the largest of these steps, N.
        collision_N: (m,), largest normal force of hand on table, obstacle or itself.
        collision: m names of the pair with that force, "" without.
    """

    time: FloatArray = field(metadata=channel("time_s"))
    phase: tuple[ManipulationPhase, ...] = field(metadata=channel("phase", kind=str))
    touching: IntArray = field(metadata=channel("fingers_touching", kind=int))
    points: FloatArray = field(metadata=channel("contact_object_m", 3, per_finger=True))
    sliding: FloatArray = field(metadata=channel("sliding_mm_s", scale=MM, per_finger=True))
    closed: NDArray[np.bool_] = field(metadata=channel("closed", kind=bool))
    epsilon: FloatArray = field(metadata=channel("epsilon"))
    friction_utilisation: FloatArray = field(
        metadata=channel("friction_utilisation", per_finger=True)
    )
    turn: FloatArray = field(metadata=channel("object_in_palm_turn_deg", scale=DEG))
    tilt: FloatArray = field(metadata=channel("object_in_palm_tilt_deg", scale=DEG))
    shift: FloatArray = field(metadata=channel("object_in_palm_shift_mm", 3, scale=MM))
    off_path: FloatArray = field(metadata=channel("off_path_mm", scale=MM))
    path_parameter: FloatArray = field(metadata=channel("path_parameter"))
    away: NDArray[np.bool_] = field(metadata=channel("away", kind=bool, per_finger=True))
    normal_force: FloatArray = field(metadata=channel("normal_force_N", per_finger=True))
    peak_force: FloatArray = field(metadata=channel("peak_normal_force_N", per_finger=True))
    collision_N: FloatArray = field(metadata=channel("collision_N"))
    collision: tuple[str, ...] = field(metadata=channel("collision", kind=str))

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.phase)

    def during(self, *phases: ManipulationPhase) -> IntArray:
        """Numbers of the samples of some phases."""
        return np.flatnonzero(np.isin(np.array(self.phase, dtype=str), phases))

    @classmethod
    def of(cls, rows: list[dict[str, Any]], n_fingers: int) -> ManipulationLog:
        """From samples by channel."""
        columns: dict[str, Any] = {}
        for one in fields(cls):
            values, about = [row[one.name] for row in rows], one.metadata
            if about["kind"] is str:
                columns[one.name] = tuple(values)
                continue
            fingers = (n_fingers,) if about["per_finger"] else ()
            array = np.array(values, dtype=about["kind"])
            columns[one.name] = array.reshape(-1, *fingers, *about["shape"])
        return cls(**columns)

    def to_dict(self) -> dict[str, list[Any]]:
        """All channels by their names in files; NaN stays NaN."""
        out: dict[str, list[Any]] = {}
        for one in fields(self):
            values, about = getattr(self, one.name), one.metadata
            if about["scale"] != 1.0:
                values = about["scale"] * values
            out[about["in_file"]] = list(values) if about["kind"] is str else values.tolist()
        return out


class ManipulationRecorder:
    """Takes samples of one simulation."""

    def __init__(self, simulation: Simulation, axis: FloatArray) -> None:
        """Start empty.

        Args:
            simulation: What is watched.
            axis: Axis of the turn (3,), unit, palm.
        """
        self._simulation, self._axis = simulation, axis
        self._fingers = simulation.plan.task.finger_names
        self._length = simulation.plan.task.object.shape.bounding_radius
        self._reference: SE3 | None = None
        self._turn = 0.0
        self._rows: list[dict[str, Any]] = []
        self._states = StateRecorder(simulation)
        self._contacts = ContactHistory.of(simulation.scene)
        self._forces: list[FloatArray] = []

    def note_forces(self, normal_forces: FloatArray) -> None:
        """Note the normal forces (n,), N, of one time step, for the next sample."""
        self._forces.append(normal_forces)

    def mark_reference(self) -> None:
        """From now on movement is counted from how the object lies in the palm now."""
        self._reference, self._turn = self._simulation.T_palm_object, 0.0

    def moved(self) -> tuple[float, float, FloatArray]:
        """Turn (rad), tilt beside it (rad) and shift (3,), m, in the palm since the mark."""
        if self._reference is None:
            return 0.0, 0.0, np.zeros(3)
        now = self._simulation.T_palm_object
        turned = now.rotation @ self._reference.rotation.T
        turn = signed_twist(turned, self._axis, near=self._turn)
        tilt = float(np.linalg.norm(pin.log3(turned @ pin.exp3(-turn * self._axis))))
        return turn, tilt, now.translation - self._reference.translation

    def record(
        self,
        phase: ManipulationPhase,
        *,
        path_parameter: float,
        wanted: SE3 | None,
        away: NDArray[np.bool_],
    ) -> None:
        """Take a sample: all of it, also where Ctrl-C comes meanwhile.

        Args:
            phase: Phase.
            path_parameter: Where on the path the reference is.
            wanted: T_palm_object that is wanted, None before it is held.
            away: (n,), which fingers are told to be off the object.
        """
        with interrupts_wait():
            self._take(phase, path_parameter, wanted, away)

    def _take(
        self,
        phase: ManipulationPhase,
        path_parameter: float,
        wanted: SE3 | None,
        away: NDArray[np.bool_],
    ) -> None:
        simulation = self._simulation
        scene, data = simulation.scene, simulation.data
        self._states.take(phase)
        self._contacts.note(data)
        forces = np.array(self._forces or [np.zeros(len(self._fingers))])
        self._forces = []
        pads = read_pads(scene, data, self._fingers)
        pose, now = simulation.T_world_object, simulation.T_palm_object
        self._turn, tilt, shift = self.moved()
        self._rows.append(
            {
                "time": float(data.time),
                "phase": phase,
                "points": (pads.position - pose.translation) @ pose.rotation,
                "sliding": np.linalg.norm(pads.sliding, axis=1) - pads.creep_speed,
                "turn": self._turn,
                "tilt": tilt,
                "shift": shift,
                "off_path": np.nan
                if wanted is None
                else np.linalg.norm(now.translation - wanted.translation),
                "path_parameter": path_parameter,
                "away": away.copy(),
                "normal_force": forces.mean(axis=0),
                "peak_force": forces.max(axis=0),
            }
        )

    def log(self) -> ManipulationLog:
        """All samples so far."""
        merged = self._contacts.rows().merged
        collision, force = self._contacts.collisions(self._simulation.scene)
        touching = np.delete(merged.counts(), merged.names.index(""), axis=1).sum(axis=1)
        used = merged.friction_utilisation()
        rows = []
        for i, row in enumerate(self._rows):
            mine = merged.of(i)
            share = {
                merged.names[k]: u for k, u in zip(merged.finger[mine], used[mine], strict=True)
            }
            closed, epsilon = closure_and_epsilon(merged.at(i), length=self._length)
            rows.append(
                row
                | {
                    "touching": touching[i],
                    "closed": closed,
                    "epsilon": epsilon,
                    "friction_utilisation": [share.get(f, np.nan) for f in self._fingers],
                    "collision_N": force[i],
                    "collision": collision[i],
                }
            )
        return ManipulationLog.of(rows, len(self._fingers))

    def recording(self) -> Recording:
        """The states at the same times."""
        merged = self._contacts.rows().merged
        return self._states.recording(merged.columns(self._fingers, PALM))
