"""Starts of grasps with two hands: each on its side of the object, its fingers closed around it.

The right hand, say, comes from where it is at rest, the other from the opposite side; both are
turned at random about the normals of their palms.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from planner.collision.moving_hand import moving_hand
from planner.errors import TaskError
from planner.spatial import SE3, FloatArray
from planner.synthesis.seeds.enveloping import FAR, HANDS, EnvelopingSeeder, Palm, laid

TIPS_GAP = (0.03, 0.09)
"""Distances (m) from the object of a palm whose fingertips alone touch."""

LEAST_OPPOSED = float(np.cos(np.deg2rad(50.0)))
"""Least cosine between a flat side and where a hand comes from: others belong to nobody."""

SIDE_NOISE = 0.3
"""Standard deviation (-) of the direction from which a hand comes, of unit length."""

ASIDE_NOISE = 0.2
"""Standard deviation of where on its side a palm is, in radii of the object (-)."""

TURN_OVER_TABLE = np.pi / 2
"""How far (rad) a hand turns about its palm's normal over a table, from its rest."""

PLACED_DRAWS = 20
"""Poses of a palm drawn in search of one within its carriage's reach."""


class PairSeeder(EnvelopingSeeder):
    """Draws starts in which two palms face each other across the object."""

    def _prepare(self) -> None:
        super()._prepare()
        hand, pose = self.task.hand, self.task.T_world_object.inverse() * self.task.T_world_base
        self._rest = [pose * hand.T_base_palm_joint(palm.pad) for palm in self._palms]
        self._roots = [pose * hand.carriage_root(palm.side) for palm in self._palms]
        first, second = (T.translation for T in self._rest)
        apart = first - second
        self._from = apart / np.linalg.norm(apart)
        self._check_reach()
        self._check_weight()

    def _check_reach(self) -> None:
        """Refuse an object whose sides are beyond what the carriages reach.

        Raises:
            TaskError: So.
        """
        hand, shape = self.task.hand, self.task.object.shape
        for palm, rest, sign in zip(self._palms, self._rest, (1.0, -1.0), strict=True):
            slides = palm.side.carriage[:3]
            most = float(rest.translation @ (sign * self._from) + hand.q_upper[slides].max())
            half = float(shape.support(sign * self._from))
            if half > most:
                raise TaskError(
                    f"{hand.name} cannot reach around the object together: its side is "
                    f"{half:.2f} m from its middle, and the palm of {palm.side.name!r} gets "
                    f"{most:.2f} m away from there; use a smaller object, turn it, or give the "
                    "carriages more reach in hand.toml"
                )

    def _check_weight(self) -> None:
        """Refuse an object that is heavier than what the carriages can carry beside the hands.

        Raises:
            TaskError: So.
        """
        task, hand = self.task, self.task.hand
        pull = float(np.linalg.norm(task.gravity))
        limits = hand.actuation.torque_limits(hand.neutral)[:, 1]
        up = task.T_world_object.rotation.T @ task.gravity / max(pull, 1e-9)
        most = sum(
            float(limits[palm.side.carriage[:3]] @ np.abs(root.rotation.T @ up))
            for palm, root in zip(self._palms, self._roots, strict=True)
        )
        own = pull * float(np.sum(hand.mj_model.body_mass))
        weight = pull * task.object.mass
        if weight > most - own:
            names = ", ".join(hand.joint_names[p.side.carriage[2]] for p in self._palms)
            raise TaskError(
                f"the object weighs {weight:.0f} N, and the carriages of {hand.name} carry "
                f"{most:.0f} N ({names}), of which the hands themselves take {own:.0f} N; "
                f"{weight - most + own:.0f} N are missing: use a lighter object or stronger "
                "carriages (hand.toml)"
            )

    def _place(self, rng: np.random.Generator) -> tuple[SE3, FloatArray]:
        """Of some closed pairs the one whose contacts lie best on the object."""
        task = self.task
        T_object_base = task.T_world_object.inverse() * task.T_world_base
        drawn = [self._drawn_pair(T_object_base, rng) for _ in range(HANDS)]
        misses = [self._miss(T_object_base, q) for q in drawn]
        return SE3(task.T_world_base), drawn[int(np.argmin(misses))]

    def _drawn_pair(self, T_object_base: SE3, rng: np.random.Generator) -> FloatArray:
        """Joints (nq,) of both hands, closed."""
        q, outward = self._with_noise(self.open, rng), self._drawn_direction(rng)
        for palm, rest, root, sign in zip(
            self._palms, self._rest, self._roots, (1.0, -1.0), strict=True
        ):
            q[palm.side.carriage] = self._carriage(palm, rest, root, sign * outward, rng)
        return self._closed(T_object_base, q, rng)

    def _drawn_direction(self, rng: np.random.Generator) -> FloatArray:
        """Unit direction (3,) from which the first hand comes, object frame.

        Raises:
            TaskError: No flat side of the object looks towards a hand.
        """
        sides = self.task.object.shape.flat_sides
        if sides is None:
            noisy = self._from + rng.normal(0.0, SIDE_NOISE, 3)
            return np.asarray(noisy / np.linalg.norm(noisy))
        faces = [s for s in sides if s @ self._from > LEAST_OPPOSED]
        if not faces:
            raise TaskError(
                "no side of the object looks towards the hands; turn it (T_world_object), or the "
                "pair (T_world_base)"
            )
        return np.asarray(faces[rng.integers(len(faces))])

    def _carriage(
        self, palm: Palm, rest: SE3, root: SE3, outward: FloatArray, rng: np.random.Generator
    ) -> FloatArray:
        """Joints (6,) of a carriage that lay the palm on the side of the object that looks so."""
        hand = self.task.hand
        low, high = hand.q_lower[palm.side.carriage], hand.q_upper[palm.side.carriage]
        best, least = np.zeros(6), np.inf
        for _ in range(PLACED_DRAWS):
            pose = self._drawn_pose(palm, rest.rotation, outward, rng)
            wanted = carriage_joints(root.inverse() * pose * rest.inverse() * root)
            beyond = float(np.maximum(low - wanted, wanted - high).max())
            if beyond < least:
                best, least = np.clip(wanted, low, high), beyond
            if beyond <= 0.0:
                break
        return best

    def _drawn_pose(
        self, palm: Palm, rest: FloatArray, outward: FloatArray, rng: np.random.Generator
    ) -> SE3:
        """Pose of a palm's joint on or before the side of the object that looks so."""
        shape = self.task.object.shape
        onto = pin.Quaternion.FromTwoVectors(rest @ palm.pad.axis, -outward).matrix() @ rest
        most = np.pi if self.task.table_height is None else TURN_OVER_TABLE
        turn = pin.exp3(outward * rng.uniform(-most, most)) @ onto
        far = shape.bounding_radius * (FAR * outward + rng.normal(0.0, ASIDE_NOISE, 3))
        points, normals = shape.closest_point(far[None])
        normal = outward if shape.flat_sides is not None else normals[0]
        turn = pin.Quaternion.FromTwoVectors(outward, normal).matrix() @ turn
        if not palm.touches:
            gap = rng.uniform(*TIPS_GAP)
            return laid(palm, self._tips(palm), points[0] + gap * normal, turn)
        return laid(palm, self._shares(palm, rng), points[0], turn)

    def _tips(self, palm: Palm) -> FloatArray:
        """Middle of the tips of half closed fingers along the palm, (3,), m, from its middle."""
        hand = self.task.hand
        state = moving_hand(hand).move((self.open + self._flexed) / 2.0)
        tips = np.mean([state.pad_center(hand.fingers[f]) for f in palm.side.fingers], axis=0)
        off = state.joint_pose(palm.pad.joint_id).actInv(tips) - palm.pad.center
        return np.asarray(off - palm.pad.axis * (palm.pad.axis @ off))


def carriage_joints(moved: SE3) -> FloatArray:
    """Joints (6,), m and rad, of a carriage that has moved so in its axes at rest.

    moved = Trans(x, y, z) Rx Ry Rz.
    """
    R = moved.rotation
    ry = np.arcsin(np.clip(R[0, 2], -1.0, 1.0))
    rx, rz = np.arctan2(-R[1, 2], R[2, 2]), np.arctan2(-R[0, 1], R[0, 0])
    return np.array([*moved.translation, rx, ry, rz])
