"""Starts of grasps with the whole hand: the palm near the object, the fingers closed around it.

The palm is laid on the object from a random side, turned at random about its normal, and every
finger flexes until one of its links touches; what lies behind that link stays, the rest goes on, as
in a hand of which each joint has its own motor.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
import pinocchio as pin

from planner.errors import TaskError
from planner.hands.fingers import Pad, Side
from planner.kinematics import moving_hand
from planner.shapes import Mesh
from planner.spatial import SE3, FloatArray
from planner.synthesis.link_spheres import link_spheres
from planner.synthesis.seeds.draw import Seeder

FLEXION_STEPS = 30
"""Steps from the open to the flexed posture: 3 degrees each."""

SLOWEST = 0.5
"""Least share (-) of its range that a joint flexes in the time in which others flex fully."""

FLEXING = 0.4
"""Cosine (-) between the motion of a tip and where its pad faces from which on a joint flexes."""

PALM_GAP = (0.002, 0.02)
"""Distances (m) of a palm that does not touch from the object."""

LOWEST_SIDE = -0.2
"""Least height (-) of the direction from which the palm comes, over a table."""

FAR = 2.0
"""Distance (-) from which the nearest point of the object is where the palm comes to, in radii."""

FACE_AWAY = 0.02
"""Distance (m) that a face counts as farther away that is at right angles to a pad."""

OFF_CENTER = 0.1
"""Standard deviation (-) of the palm's place from the middle of a flat face, in radii."""

HANDS = 4
"""Hands drawn and closed of which the best is taken: 10 ms each, and a solve takes 50."""

WRIST_DRAWS = 8
"""Most palm poses drawn in search of one in which the wrist bears the object."""

FARTHEST = 0.03
"""Distance (m) beyond which a contact is as bad as any: the solver will not bring it back."""

FACING_AWAY, LEAST_FACING = 0.03, 0.5
"""What facing away costs (m), per cosine below the one at which a pad faces the surface enough."""

TABLE_COST = 5.0
"""What a link below the table costs (m), per depth of the deepest (m)."""

LYING, OPPOSED = -0.5, -0.7
"""Cosine (-) between a side's normal and the vertical below which a side lies on the table; and
that between two normals from which on friction balances what presses on both sides."""

FLAT = 1e-9
"""A slope of a mesh's distance (-) below which it has no direction."""

PLACES = 4
"""Places of the palm of which the best is taken."""

TOWARD, ASIDE = (0.0, 1.0), 0.3
"""Where on the palm the object lies (-), in shares of the palm's reach towards the fingers, and how
far aside of that."""


@dataclass(frozen=True)
class Palm:
    """A palm as a start places it.

    Attributes:
        side: Whose palm.
        pad: Where it touches.
        way: Unit direction (3,) in which most fingers lie across it, in its joint's frame.
        touches: Whether it takes part.
    """

    side: Side
    pad: Pad
    way: FloatArray
    touches: bool


class EnvelopingSeeder(Seeder):
    """Draws starts in which the palm faces the object and the fingers are around it."""

    def _prepare(self) -> None:
        """Find how the fingers flex.

        Raises:
            TaskError: The palm has no geometry.
        """
        hand = self.task.hand
        self._spheres = link_spheres(hand)
        self._joints = np.array([b.joint_id for b in self._spheres])
        self._moving, self._frame = np.unique(self._joints, return_inverse=True)
        self._centers = np.array([b.center for b in self._spheres])
        self._radii = np.array([b.radius for b in self._spheres])
        self._palms = [self._palm_of(side) for side in hand.sides]
        pads = [f.pad for f in self.task.fingers]
        self._spots = [_spots(pad) for pad in pads]
        sizes = [len(spots) for spots in self._spots]
        self._spot_of = np.repeat(np.arange(len(pads)), sizes)
        self._spot_radii = np.repeat([pad.radius for pad in pads], sizes)
        self._spot_begins = np.cumsum([0, *sizes[:-1]])
        self._flexed = self._flexed_posture()

    def _palm_of(self, side: Side) -> Palm:
        """A palm, and where its fingers lie.

        Raises:
            TaskError: It has no geometry, or is to touch where nothing moves it.
        """
        task, hand, name = self.task, self.task.hand, side.palm_body
        if name not in hand.contact_parts:
            raise TaskError(
                f"the palm {name!r} of {hand.name} has no geometry, and a hand closes around an "
                "object from there; give it one in the model, or use fingertips alone"
            )
        touches = name in task.finger_names
        if touches and task.T_world_base is not None and not hand.pair:
            raise TaskError(
                f"the palm {name!r} is to touch, and the base of {hand.name} is fixed, or on an "
                "arm: no way in is planned for that; use other contacts, or a hand that floats"
            )
        pad = hand.contact_parts[name].pad
        state = moving_hand(hand).move(self.open)
        inverse = state.joint_pose(pad.joint_id).inverse()
        ways = []
        for finger in (hand.fingers[f] for f in side.fingers):
            root = state.joint_pose(hand.pin_model.getJointId(finger.joints[0])).translation
            way = inverse.rotation @ (state.pad_center(finger) - root)
            way -= pad.axis * (pad.axis @ way)
            ways.append(way / max(float(np.linalg.norm(way)), 1e-9))
        # the way that agrees with most: a thumb points elsewhere
        best = ways[int(np.argmax(np.sum(np.array(ways) @ np.array(ways).T, axis=1)))]
        return Palm(side, pad, np.asarray(best), touches)

    def _flexed_posture(self) -> FloatArray:
        """Joints (nq,) with every finger flexed as far as it goes, others as in the open one."""
        hand, q = self.task.hand, self.open.copy()
        state = moving_hand(hand).move(self.open)
        for finger in hand.fingers.values():
            rates = state.point_jacobian(finger.pad.joint_id, state.pad_center(finger))[:3]
            facing = state.pad_axis(finger)
            for j in finger.q_index:
                along = float(facing @ rates[:, j])
                if abs(along) > FLEXING * np.linalg.norm(rates[:, j]):
                    q[j] = hand.q_upper[j] if along > 0.0 else hand.q_lower[j]
        return q

    def _place(self, rng: np.random.Generator) -> tuple[SE3, FloatArray]:
        """Of some closed hands the one whose contacts lie best on the object."""
        drawn = [self._drawn_hand(rng) for _ in range(HANDS)]
        misses = [self._miss(*hand) for hand in drawn]
        T_object_base, q = drawn[int(np.argmin(misses))]
        return self.task.T_world_object * T_object_base, q

    def _drawn_hand(self, rng: np.random.Generator) -> tuple[SE3, FloatArray]:
        """Base in the object's frame and joints (nq,) of a hand that has closed."""
        task, state = self.task, moving_hand(self.task.hand)
        q = self._with_noise(self.open, rng)
        if task.T_world_base is not None and task.hand.arm is None:
            T_object_base = task.T_world_object.inverse() * task.T_world_base
        else:
            T_base_palm = SE3(state.move(q).joint_pose(self._palms[0].pad.joint_id))
            for _ in range(WRIST_DRAWS):
                T_object_base = self._palm_pose(rng) * T_base_palm.inverse()
                if self._wrist_bears(T_object_base, q):
                    break
        return T_object_base, self._closed(T_object_base, q, rng)

    def _wrist_bears(self, T_object_base: SE3, q: FloatArray) -> bool:
        """Whether the wrist's actuators hold the object, and the hand beyond them, at q (nq,)."""
        task, state = self.task, moving_hand(self.task.hand).move(q)
        wrist, turn = task.hand.wrist_index, (task.T_world_object.rotation @ T_object_base.rotation)
        if not len(wrist):
            return True
        gravity = turn.T @ task.gravity
        center = T_object_base.inverse().translation
        rates = state.point_jacobian(self._palms[0].pad.joint_id, center)[:3, wrist]
        torque = state.gravity_torque(gravity)[wrist] - task.object.mass * gravity @ rates
        low, high = task.hand.actuation.torque_limits(q)[wrist].T
        return bool(((torque >= low) & (torque <= high)).all())

    def _miss(self, T_object_base: SE3, q: FloatArray) -> float:
        """How far (m) the task's contacts are off the object, or turned away, in all."""
        state, fingers = moving_hand(self.task.hand).move(q), self.task.fingers
        frames = [T_object_base * state.joint_pose(f.pad.joint_id) for f in fingers]
        placed = zip(frames, self._spots, strict=True)
        at = np.vstack([spots @ T.rotation.T + T.translation for T, spots in placed])
        axes = np.array([T.rotation @ f.pad.axis for T, f in zip(frames, fingers, strict=True)])
        lowest = float(self._above_table(self._links_at(T_object_base, q)).min())
        below = max(-TABLE_COST * lowest, 0.0)
        gaps, outward = self._from_surface(at)
        if self.task.object.shape.flat_sides is not None:
            return self._sides_for(T_object_base, q, outward[self._spot_begins])[1] + below
        gaps -= self._spot_radii
        facing = -(outward * axes[self._spot_of]).sum(axis=1)
        away = FACING_AWAY * np.maximum(LEAST_FACING - facing, 0.0)
        misses = np.minimum(np.abs(gaps), FARTHEST) + away
        return float(np.minimum.reduceat(misses, self._spot_begins).sum()) + below

    def _from_surface(self, at: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distances (n,), m, of points (n, 3) from the object, and normals (n, 3) out of it.

        Of a mesh by its smooth distance, which takes a tenth of the time.
        """
        shape = self.task.object.shape
        if isinstance(shape, Mesh):
            found = shape.field().taylor(at, 1)
            slopes = np.linalg.norm(found[:, 1:4], axis=1, keepdims=True)
            return found[:, 0].copy(), found[:, 1:4] / np.maximum(slopes, FLAT)
        points, outward = shape.closest_point(at)
        return ((at - points) * outward).sum(axis=1), outward

    def _links_at(self, T_object_base: SE3, q: FloatArray) -> FloatArray:
        """Centres (n, 3) of the spheres in all links, object frame, m."""
        poses = moving_hand(self.task.hand).move(q).pin_data.oMi
        frames = np.array([poses[j].homogeneous for j in self._moving.tolist()])[self._frame]
        at = (frames[:, :3, :3] @ self._centers[:, :, None])[:, :, 0] + frames[:, :3, 3]
        return np.asarray(at @ T_object_base.rotation.T + T_object_base.translation)

    def _above_table(self, at: FloatArray) -> FloatArray:
        """Heights (n,), m, of the spheres at (n, 3) over the table; infinite without one."""
        T, table = self.task.T_world_object, self.task.table_height
        if table is None:
            return np.full(len(at), np.inf)
        return np.asarray(at @ T.rotation[2] + T.translation[2] - table - self._radii)

    def _palm_pose(self, rng: np.random.Generator) -> SE3:
        """Pose of the palm's joint in the object's frame, its face on the object or near it.

        Of some places drawn it is the one where the object is smallest across the fingers.
        """
        drawn = [self._drawn_palm_pose(rng) for _ in range(PLACES)]
        return min(drawn, key=lambda place: place[0])[1]

    def _drawn_palm_pose(self, rng: np.random.Generator) -> tuple[float, SE3]:
        """Size (m) of the object across fingers and palm, and a pose."""
        palm, shape = self._palms[0], self.task.object.shape
        point, outward = self._drawn_side(rng)
        gap = 0.0 if palm.touches else rng.uniform(*PALM_GAP)
        onto = pin.Quaternion.FromTwoVectors(palm.pad.axis, -outward).matrix()
        turn = pin.exp3(outward * rng.uniform(-np.pi, np.pi)) @ onto
        along = turn @ palm.way
        size = shape.support(along) + shape.support(-along)
        size += shape.support(outward) + shape.support(-outward)
        return float(size), laid(palm, self._shares(palm, rng), point + gap * outward, turn)

    def _drawn_side(self, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """A point (3,) of the surface where the palm may lie, and the outward normal (3,) there."""
        task, shape = self.task, self.task.object.shape
        turn = task.T_world_object.rotation
        sides = None if shape.flat_sides is None else np.array(list(shape.flat_sides))
        while True:
            side = rng.normal(size=3) if sides is None else sides[rng.integers(len(sides))]
            side = side / np.linalg.norm(side)
            if task.table_height is None or (turn @ side)[2] >= LOWEST_SIDE:
                break
        far = FAR * shape.bounding_radius * side
        if sides is not None:
            far = far + rng.normal(0.0, OFF_CENTER * shape.bounding_radius, 3)
        points, outward = shape.closest_point(far[None])
        return points[0], outward[0] if sides is None else side

    def _shares(self, palm: Palm, rng: np.random.Generator) -> FloatArray:
        """Where on the palm the object lies, (3,), m, from its middle: rather near the fingers."""
        if not len(palm.pad.reach):
            return np.zeros(3)
        toward = palm.pad.reach @ palm.way
        toward /= max(float(np.linalg.norm(toward)), 1e-9)
        shares = rng.uniform(-1.0, 1.0, len(toward)) * ASIDE + toward * rng.uniform(*TOWARD)
        return np.asarray(np.clip(shares, -1.0, 1.0) @ palm.pad.reach)

    def _closed(self, T_object_base: SE3, q: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Joints (nq,) with all fingers flexed from q until links touch, or to their limits."""
        hand = self.task.hand
        way = (self._flexed - q) * rng.uniform(SLOWEST, 1.0, hand.nq)
        way[hand.carriage_index] = 0.0
        free = np.ones(hand.nq, dtype=bool)
        q = q.copy()
        for _ in range(FLEXION_STEPS):
            ahead = q + np.where(free, way, 0.0) / FLEXION_STEPS
            at = self._links_at(T_object_base, ahead)
            gaps = np.minimum(self._from_surface(at)[0] - self._radii, self._above_table(at))
            free &= ~hand.moved_by[self._joints[gaps < 0.0]].any(axis=0)
            q = np.where(free, ahead, q)
            if not free.any():
                break
        return self._with_wrist(q)

    def _face_normals(self, q: FloatArray, T_object_base: SE3, nearest: FloatArray) -> FloatArray:
        """Of the faces that are near to the pads as they lie, and that the pads face."""
        sides, _ = self._sides_for(T_object_base, q, nearest)
        return np.array(self.task.object.shape.flat_sides)[sides]

    def _sides_for(
        self, T_object_base: SE3, q: FloatArray, nearest: FloatArray
    ) -> tuple[list[int], float]:
        """Numbers of the flat sides for the pads, two of which oppose each other; what it costs.

        The cost is the pads' distance from their sides, m, and what facing away counts as. A side
        that lies on the table is for none.

        Args:
            T_object_base: Pose of the base in the object's frame.
            q: Joints (nq,).
            nearest: Normals (n, 3) of the points nearest to the pads.
        """
        task, state = self.task, moving_hand(self.task.hand).move(q)
        sides = np.array(task.object.shape.flat_sides)
        cost = np.empty((len(task.fingers), len(sides)))
        for i, finger in enumerate(task.fingers):
            pad, pose = finger.pad, T_object_base * state.joint_pose(finger.pad.joint_id)
            at = pose.act(pad.center)
            cost[i] = FACE_AWAY * (1.0 + sides @ (pose.rotation @ pad.axis))
            for k, side in enumerate(sides):
                patch = self.surface.patch_at(task.object.shape, nearest[i], side)
                off = at - np.clip(at, patch.lower, patch.upper) - pad.radius * side
                cost[i, k] += np.linalg.norm(pad.beyond_reach(off, pose.rotation))
        if task.table_height is not None and not task.carrying:
            cost[:, sides @ task.T_world_object.rotation[2] < LYING] = FAR
        chosen = cost.argmin(axis=1)
        more = cost - cost.min(axis=1, keepdims=True)
        # of all pairs of contacts on opposed sides the one that costs least beyond the nearest
        pairs = more[:, None, :, None] + more[None, :, None, :]
        pairs[np.eye(len(more), dtype=bool)] = np.inf
        pairs[:, :, sides @ sides.T > OPPOSED] = np.inf
        one, other, here, there = np.unravel_index(int(pairs.argmin()), pairs.shape)
        if np.isfinite(pairs[one, other, here, there]):
            chosen[[one, other]] = here, there
        return chosen.tolist(), float(np.take_along_axis(cost, chosen[:, None], axis=1).sum())

    def _forces(self, normals: FloatArray) -> FloatArray:
        return np.asarray(-normals)


def laid(palm: Palm, place: FloatArray, at: FloatArray, turn: FloatArray) -> SE3:
    """Pose of a palm's joint, turned so, with a place (3,) of its face at a point (3,)."""
    return SE3(turn, at - turn @ (palm.pad.center + palm.pad.radius * palm.pad.axis + place))


def _spots(pad: Pad) -> FloatArray:
    """Centres (k, 3) where a pad may touch, in its joint's frame: the middle and all ends, m."""
    shares = np.array(list(product((-1.0, 0.0, 1.0), repeat=len(pad.reach))))
    return np.asarray(pad.center + shares @ pad.reach)
