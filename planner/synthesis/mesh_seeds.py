"""Starts on a mesh: the hand's opposition axis through a pair of opposed surface points.

The pair is drawn from ``planner.synthesis.opposed``, near the centre of mass by preference; the
fingers are opened a little wider than it is. Of a few turns of the hand about the axis the one is
taken at which pads are near the surface and the rest of the hand is not in it, nor in the table.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from planner.errors import TaskError
from planner.kinematics import HandState
from planner.shapes import Mesh
from planner.spatial import SE3, FloatArray, skew
from planner.synthesis.clearance import link_balls
from planner.synthesis.opposed import opposed_pairs
from planner.synthesis.seeds import STEEPEST, Seeder, frame_of, opposition
from planner.task import GraspTask

__all__ = ["MeshSeeder", "seeder_for"]

TURNS = 12
"""Turns of the hand about the opposition axis that are looked at for one start."""

TURN_NOISE = 0.8
"""Standard deviation (rad) of these turns about straight from above; any turn without a table."""

SPARE = 0.02
"""Fingers are opened by up to this much (m) wider than the pair."""

POSITION_NOISE = 0.004
"""Standard deviation (m) of the hand's position about the pair's middle."""

NEAR_CENTER = 0.6
"""Distance from the centre of mass, in bounding radii, at which a pair is taken 1/e as often."""

ROOM = 0.004
"""Clearance (m) of links beyond which more is no better."""

ABOVE_TABLE = 0.004
"""Height (m) over the table, on top of a pad's radius, that a pair's middle needs."""


class MeshSeeder(Seeder):
    """Draws starts for a task with a mesh."""

    def _prepare(self) -> None:
        """Find the pairs that the hand can close on.

        Raises:
            TaskError: There is none.
        """
        task = self.task
        mesh = task.object.shape
        if not isinstance(mesh, Mesh):
            raise TaskError(f"{task.object.name} is not a mesh; use seeder_for(task)")
        self._mesh = mesh
        pairs = opposed_pairs(mesh)
        T = task.T_world_object
        able = pairs.widths < self.widest
        if task.object.touch is not None:
            half = pairs.widths[:, None] / 2 * pairs.directions
            able &= task.object.touch.permits(pairs.centers + half)
            able &= task.object.touch.permits(pairs.centers - half)
        if task.table_height is not None:
            level = np.abs(pairs.directions @ T.rotation[2]) < STEEPEST
            height = pairs.centers @ T.rotation[2] + T.translation[2] - task.table_height
            pad = max(f.pad.radius for f in task.fingers)
            # a flat object has none that high: then any of them
            high = height > pad + ABOVE_TABLE
            able &= level & (high if (able & level & high).any() else True)
        if not able.any():
            least = float(pairs.widths.min(initial=np.inf))
            raise TaskError(
                f"{task.hand.name} finds nowhere to close on {task.object.name}: its pads open "
                f"{1e3 * self.widest:.0f} mm; the object has {len(pairs.widths)} places with "
                f"opposed faces, the narrowest {1e3 * least:.0f} mm wide, none of them level "
                "enough, within reach and where it may be touched; try another pose, other fingers "
                "or a larger hand"
            )
        far = np.linalg.norm(pairs.centers, axis=1) / (NEAR_CENTER * mesh.bounding_radius)
        weight = np.where(able, np.exp(-(far**2)), 0.0)
        self._pairs, self._chance = pairs, weight / weight.sum()
        arm = task.hand.arm.geometries if task.hand.arm is not None else frozenset()
        self._balls = [b for b in link_balls(task.hand) if b.geometry not in arm]
        self._radii = np.array([b.radius for b in self._balls])
        self._joints = np.array([b.joint_id for b in self._balls])
        self._centers = np.array([b.center for b in self._balls])
        self._touching = np.array([b.is_pad and b.finger in task.finger_names for b in self._balls])

    def _place(self, rng: np.random.Generator) -> tuple[SE3, FloatArray]:
        task = self.task
        number = rng.choice(len(self._chance), p=self._chance)
        width = float(self._pairs.widths[number])
        q = self._with_noise(self._opened(width + rng.uniform(0.0, SPARE)), rng)
        if task.T_world_base is not None and task.hand.arm is None:
            return task.T_world_base, q
        now = opposition(task, q)
        axis = task.T_world_object.rotation @ self._pairs.directions[number]
        axis *= rng.choice([-1.0, 1.0])
        center = task.T_world_object.act(self._pairs.centers[number])
        center = center + rng.normal(0, POSITION_NOISE, 3)
        sides = np.array([self._side(axis, rng) for _ in range(TURNS)])
        crosses = skew(axis) @ sides.T
        # columns of a turn: axis, side, and their product
        rotations = np.stack([np.tile(axis, (TURNS, 1)), sides, crosses.T], axis=2)
        rotations = rotations @ frame_of(now.axis, now.palm_side).T
        shifts = center - rotations @ now.center
        best = int(np.argmax(self._merits(rotations, shifts, q)))
        return SE3(rotations[best], shifts[best]), q

    def _opened(self, gap: float) -> FloatArray:
        """The posture, from pinch towards open, whose pads leave a gap (m)."""
        order = np.argsort(self.gaps)
        return self._stretched(float(np.interp(gap, self.gaps[order], self.stretches[order])))

    def _side(self, axis: FloatArray, rng: np.random.Generator) -> FloatArray:
        """A direction across ``axis`` for the palm: from above, with much noise, over a table."""
        up = rng.normal(size=3)
        if self.task.table_height is not None:
            up = np.array([0.0, 0.0, 1.0])
        up = up - axis * (axis @ up)
        turn = rng.normal(0, TURN_NOISE)
        return np.array(pin.exp3(axis * turn) @ (up / np.linalg.norm(up)))

    def _merits(self, rotations: FloatArray, shifts: FloatArray, q: FloatArray) -> FloatArray:
        """How well base poses (n, 3, 3), (n, 3) suit, (n,), m: links' room less pads' gaps."""
        task, n = self.task, len(rotations)
        poses = HandState(task.hand, q).pin_data.oMi
        turns = np.array([pose.rotation for pose in poses])[self._joints]
        local = (turns @ self._centers[:, :, None])[:, :, 0]
        local += np.array([pose.translation for pose in poses])[self._joints]
        world = local @ rotations.transpose(0, 2, 1) + shifts[:, None]
        T = task.T_world_object
        points = ((world - T.translation) @ T.rotation).reshape(-1, 3)
        gaps = self._mesh.field().rough_value(points).reshape(n, -1) - self._radii
        room = np.where(self._touching, ROOM, gaps)
        if task.table_height is not None:
            room = np.minimum(room, world[:, :, 2] - task.table_height - self._radii)
        off = np.abs(gaps[:, self._touching]).mean(axis=1)
        merit: FloatArray = np.minimum(room.min(axis=1), ROOM) - off
        return merit


def seeder_for(task: GraspTask) -> Seeder:
    """The source of starts that suits the task's object."""
    return MeshSeeder(task) if isinstance(task.object.shape, Mesh) else Seeder(task)
