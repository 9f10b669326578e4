"""Starts of grasps with the whole hand: the palm near the object, the fingers closed around it.

The palm is laid on the object from a random side, turned at random about its normal, and every
finger flexes until one of its links touches; what lies behind that link stays, the rest goes on, as
in a hand of which each joint has its own motor.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from planner.collision.moving_hand import moving_hand
from planner.spatial import SE3, FloatArray
from planner.synthesis.link_spheres import link_spheres
from planner.synthesis.seeds.draw import Seeder
from planner.task import GraspTask

FLEXION_STEP = 0.06
"""Largest step (rad) of a joint that flexes: links move some 2 mm."""

FLEXING = 0.4
"""Cosine between the motion of a tip and the palm's normal from which on a joint flexes (-)."""

PALM_GAP = (0.002, 0.02)
"""Distances (m) of a palm that does not touch from the object."""

LOWEST_SIDE = -0.2
"""Least height (-) of the direction from which the palm comes, over a table."""

UP_WEIGHT = 0.6
"""Standard deviation (-) that the direction is drawn with across a table, 1 along its normal."""


class EnvelopingSeeder(Seeder):
    """Draws starts in which the palm faces the object and the fingers are around it."""

    def _prepare(self) -> None:
        """Find how the fingers flex."""
        hand = self.task.hand
        self._spheres = link_spheres(hand)
        self._joints = np.array([b.joint_id for b in self._spheres])
        self._centers = np.array([b.center for b in self._spheres])
        self._radii = np.array([b.radius for b in self._spheres])
        self._palm = hand.contact_parts[hand.description.palm_body].pad
        self._touches_palm = hand.description.palm_body in self.task.finger_names
        self._flexed = self._flexed_posture()

    def _flexed_posture(self) -> FloatArray:
        """Joints (nq,) with every finger flexed as far as it goes; others as in the open posture."""
        hand, q = self.task.hand, self.open.copy()
        state = moving_hand(hand).move(self.open)
        normal = state.T_base_palm.rotation @ hand.palm_normal
        for finger in hand.fingers.values():
            rates = state.point_jacobian(finger.pad.joint_id, state.pad_center(finger))[:3]
            facing = state.pad_axis(finger)
            for j in finger.q_index:
                speed = float(np.linalg.norm(rates[:, j]))
                along = float(rates[:, j] @ (facing - normal)) / max(
                    speed * float(np.linalg.norm(facing - normal)), 1e-9
                )
                if along > FLEXING:
                    q[j] = hand.q_upper[j]
                elif along < -FLEXING:
                    q[j] = hand.q_lower[j]
        return q

    def _place(self, rng: np.random.Generator) -> tuple[SE3, FloatArray]:
        task = self.task
        T_world_object, state = task.T_world_object, moving_hand(task.hand)
        q = self._with_noise(self.open, rng)
        if task.T_world_base is not None:
            T_world_base = task.T_world_base
        else:
            T_base_palm = SE3(state.move(q).joint_pose(self._palm.joint_id))
            T_object_palm = self._palm_pose(rng)
            T_world_base = T_world_object * T_object_palm * T_base_palm.inverse()
        T_object_base = T_world_object.inverse() * T_world_base
        return T_world_base, self._closed(T_object_base, q, rng)

    def _palm_pose(self, rng: np.random.Generator) -> SE3:
        """Pose of the palm's joint in the object's frame, its face on the object or near it."""
        task, pad = self.task, self._palm
        side = rng.normal(size=3)
        if task.table_height is not None:
            while side[2] < LOWEST_SIDE * np.linalg.norm(side):
                side = rng.normal(size=3) * [UP_WEIGHT, UP_WEIGHT, 1.0]
        side = task.T_world_object.rotation.T @ (side / np.linalg.norm(side))
        far = 2.0 * task.object.shape.bounding_radius * side
        point, outward = (v[0] for v in task.object.shape.closest_point(far[None]))
        gap = 0.0 if self._touches_palm else rng.uniform(*PALM_GAP)
        turn = _turn_onto(pad.axis, -outward)
        turn = pin.exp3(outward * rng.uniform(-np.pi, np.pi)) @ turn
        touching = pad.center + pad.radius * pad.axis
        if len(pad.reach):
            touching = touching + rng.uniform(-0.5, 0.5, len(pad.reach)) @ pad.reach
        return SE3(turn, point + gap * outward - turn @ touching)

    def _closed(self, T_object_base: SE3, q: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Joints (nq,) with all fingers flexed from q until their links touch or the limits end it."""
        task, hand = self.task, self.task.hand
        state, q = moving_hand(hand), q.copy()
        way = self._flexed - q
        speed = np.clip(way, -1.0, 1.0) * rng.uniform(0.5, 1.0, hand.nq)
        speed *= FLEXION_STEP / max(float(np.abs(speed).max()), 1e-9)
        free = speed != 0.0
        held = np.abs(hand.coupling_matrix[0]).sum(axis=0) > 0
        while free.any():
            step = np.where(free, speed, 0.0)
            ahead = np.clip(q + step, hand.q_lower, hand.q_upper)
            free &= np.abs(ahead - q) > 1e-9
            poses = state.move(ahead).pin_data.oMi
            at = np.array([poses[b.joint_id].act(b.center) for b in self._spheres])
            at = at @ T_object_base.rotation.T + T_object_base.translation
            points, outward = task.object.shape.closest_point(at)
            gaps = ((at - points) * outward).sum(axis=1) - self._radii
            stopped = hand.moved_by[self._joints[gaps < 0.0]].any(axis=0)
            free &= ~stopped
            q = np.where(free, ahead, q)
        del held
        return self._with_wrist(q)

    def _forces(self, normals: FloatArray) -> FloatArray:
        return np.asarray(-normals)


def _turn_onto(a: FloatArray, b: FloatArray) -> FloatArray:
    """A rotation (3, 3) that takes the unit vector a to b."""
    axis = np.cross(a, b)
    length = float(np.linalg.norm(axis))
    if length < 1e-9:
        return np.eye(3) if a @ b > 0 else np.array(pin.exp3(np.pi * _across(a)))
    return np.array(pin.exp3(axis / length * np.arctan2(length, float(a @ b))))


def _across(a: FloatArray) -> FloatArray:
    out = np.eye(3)[int(np.argmin(np.abs(a)))]
    out = out - a * (a @ out)
    return np.asarray(out / np.linalg.norm(out))
