"""``Watch``: takes a sample of a manipulation every 20 ms; ``Track``: all of them, as arrays."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planner.quality import closure_and_epsilon, force_closure
from planner.spatial import SE3, FloatArray, IntArray, signed_twist
from sim.contacts import hand_collision, hand_contacts, merge_per_finger
from sim.manipulation.pace import Step
from sim.pads import read_pads
from sim.scene import Scene

__all__ = ["Track", "Watch"]

NAMES = ("step", "collision")
"""Fields of a ``Track`` that hold names, not numbers."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Track:
    """What happened, m samples, n fingers that take part.

    Turn, tilt and shift are the object's in the palm since the turn began, or since the grip was
    there while it has not.

    Attributes:
        time: (m,), s.
        step: m phases.
        touching: (m,), how many fingers of the hand touch the object, the palm not counted.
        points: (m, n, 3), merged contacts in the object's frame, m; NaN without contact.
        sliding: (m, n), speed of the object over the pad beyond what spinning explains, m/s; NaN
            without contact.
        closed: (m,), force closure of the measured contacts, merged per finger, with their own
            friction.
        turn: (m,), signed twist about the axis of the turn, rad.
        tilt: (m,), rotation beside that, rad.
        shift: (m, 3), translation, m, palm axes.
        off_path: (m,), distance from where the reference has the object, m; NaN before the turn.
        place: (m,), where on the planned path the reference is, 0 to 1.
        away: (m, n), which fingers are told to be off the object.
        normal_force: (m, n), N, on the object, mean over the time steps since the last sample.
        peak_force: (m, n), the largest of these steps, N.
        collision_N: (m,), largest normal force of hand on table, obstacle or itself.
        collision: m names of the pair with that force, "" without.
    """

    time: FloatArray
    step: tuple[Step, ...]
    touching: IntArray
    points: FloatArray
    sliding: FloatArray
    closed: NDArray[np.bool_]
    turn: FloatArray
    tilt: FloatArray
    shift: FloatArray
    off_path: FloatArray
    place: FloatArray
    away: NDArray[np.bool_]
    normal_force: FloatArray
    peak_force: FloatArray
    collision_N: FloatArray
    collision: tuple[str, ...]

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.step)

    def during(self, *steps: Step) -> IntArray:
        """Numbers of the samples of some phases."""
        return np.flatnonzero(np.isin(np.array(self.step, dtype=str), steps))


class Watch:
    """Collects samples of one run."""

    def __init__(self, scene: Scene, axis: FloatArray) -> None:
        """Start empty.

        Args:
            scene: What is watched.
            axis: Axis of the turn (3,), unit, palm.
        """
        self._scene, self._axis = scene, axis
        self._fingers = scene.task.finger_names
        self._length = scene.task.object.shape.bounding_radius
        self._reference: SE3 | None = None
        self._turn = 0.0
        self._rows: list[dict[str, Any]] = []
        self._felt: list[FloatArray] = []

    def feel(self, normal_forces: FloatArray) -> None:
        """Note the normal forces (n,), N, of one time step, for the next sample."""
        self._felt.append(normal_forces)

    def mark(self, data: Any) -> None:
        """From now on movement is counted from how the object lies in the palm now."""
        self._reference, self._turn = self.in_palm(data), 0.0

    def in_palm(self, data: Any) -> SE3:
        """T_palm_object."""
        scene = self._scene
        T_world_palm = scene.body_pose(data, scene.palm_body)
        return T_world_palm.inverse() * scene.body_pose(data, scene.object_body)

    def moved(self, data: Any) -> tuple[float, float, FloatArray]:
        """Turn (rad), tilt beside it (rad) and shift (3,), m, in the palm since the mark."""
        if self._reference is None:
            return 0.0, 0.0, np.zeros(3)
        now = self.in_palm(data)
        turned = now.rotation @ self._reference.rotation.T
        turn = signed_twist(turned, self._axis, near=self._turn)
        tilt = float(np.linalg.norm(pin.log3(turned @ pin.exp3(-turn * self._axis))))
        return turn, tilt, now.translation - self._reference.translation

    def take(
        self,
        data: Any,
        step: Step,
        place: float,
        wanted: SE3 | None,
        away: NDArray[np.bool_],
    ) -> None:
        """Take a sample.

        Args:
            data: ``mujoco.MjData`` after a step.
            step: Phase.
            place: Where on the path the reference is.
            wanted: T_palm_object that is wanted, None before it is held.
            away: (n,), which fingers are told to be off the object.
        """
        scene = self._scene
        merged = merge_per_finger(hand_contacts(scene, data))
        closed, _ = closure_and_epsilon(merged, length=self._length)
        if not closed:  # of four edges; the true cone may still be closed
            closed = force_closure(merged).closed
        felt = np.array(self._felt or [np.zeros(len(self._fingers))])
        self._felt = []
        collision, collision_N = hand_collision(scene, data)
        pads = read_pads(scene, data, self._fingers)
        pose = scene.body_pose(data, scene.object_body)
        now = self.in_palm(data)
        self._turn, tilt, shift = self.moved(data)
        self._rows.append(
            {
                "time": float(data.time),
                "step": step,
                "touching": len(set(merged.fingers) - {""}),
                "points": (pads.position - pose.translation) @ pose.rotation,
                "sliding": np.linalg.norm(pads.sliding, axis=1) - pads.creep_speed,
                "closed": closed,
                "turn": self._turn,
                "tilt": tilt,
                "shift": shift,
                "off_path": np.nan
                if wanted is None
                else np.linalg.norm(now.translation - wanted.translation),
                "place": place,
                "away": away.copy(),
                "normal_force": felt.mean(axis=0),
                "peak_force": felt.max(axis=0),
                "collision_N": collision_N,
                "collision": collision,
            }
        )

    def track(self) -> Track:
        """All samples so far."""
        n = len(self._fingers)
        shapes: dict[str, tuple[int, ...]] = {
            "sliding": (n,),
            "away": (n,),
            "normal_force": (n,),
            "peak_force": (n,),
            "points": (n, 3),
            "shift": (3,),
        }
        kinds: dict[str, type] = {"touching": int, "closed": bool, "away": bool}
        columns: dict[str, Any] = {
            f.name: np.array(
                [row[f.name] for row in self._rows], dtype=kinds.get(f.name, float)
            ).reshape(-1, *shapes.get(f.name, ()))
            for f in fields(Track)
            if f.name not in NAMES
        }
        named: dict[str, Any] = {name: tuple(row[name] for row in self._rows) for name in NAMES}
        return Track(**named, **columns)
