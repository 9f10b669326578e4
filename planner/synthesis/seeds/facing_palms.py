"""Starts of grasps with two hands: each on its side of the object, its fingers closed around it.

The right hand, say, comes from where it is at rest, the other from the opposite side; both are
turned at random about the normals of their palms.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from planner.collision.arm_path import lift_height
from planner.errors import TaskError
from planner.hands.two_hands import carriage_joints
from planner.kinematics import Reach, follow, moving_hand, reach
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
"""Poses of a palm drawn in search of one within reach of its carriage or arm."""

UP = np.array([0.0, 0.0, 1.0])

REACH_RESTARTS = 1
"""Random starts of inverse kinematics after the ready posture: another pose is drawn sooner."""


class PairSeeder(EnvelopingSeeder):
    """Draws starts in which two palms face each other across the object."""

    def _prepare(self) -> None:
        """Find where the hands are at rest, and what they face.

        Raises:
            TaskError: The object is too heavy, out of reach, or turns no side to the hands.
        """
        super()._prepare()
        task, hand = self.task, self.task.hand
        pose = task.T_world_object.inverse() * task.T_world_base
        at_rest = moving_hand(hand).move(hand.at_rest)
        self._rest = [pose * at_rest.joint_pose(palm.pad.joint_id) for palm in self._palms]
        last = [int(palm.side.carriage[-1]) + 1 for palm in self._palms]
        self._roots = [pose * at_rest.joint_pose(joint) for joint in last]
        self._tips = [self._tips_of(palm) for palm in self._palms]
        apart = self._rest[0].translation - self._rest[1].translation
        self._from = apart / np.linalg.norm(apart)
        self._faces = self._faces_towards_hands()
        if hand.on_arm:
            self._check_arms_reach()
        else:
            self._check_reach()
            self._check_weight()

    def _faces_towards_hands(self) -> list[FloatArray]:
        """Normals (3,) of the flat sides that look to the first hand; none of a round object.

        Raises:
            TaskError: A shape of flat sides turns none of them.
        """
        sides = self.task.object.shape.flat_sides
        if sides is None:
            return []
        faces = [side for side in sides if side @ self._from > LEAST_OPPOSED]
        if not faces:
            raise TaskError(
                "no side of the object looks towards the hands; turn it (T_world_object), or the "
                "pair (T_world_base)"
            )
        return faces

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

    def _check_arms_reach(self) -> None:
        """Refuse an object on whose sides an arm brings no palm of those drawn, or does not lift it.

        Raises:
            TaskError: So.
        """
        rng, hand = np.random.default_rng(0), self.task.hand
        for i, (palm, sign) in enumerate(zip(self._palms, (1.0, -1.0), strict=True)):
            found = [
                self._reached(i, self._drawn_pose(i, sign * self._drawn_direction(rng), rng), self.open)
                for _ in range(PLACED_DRAWS)
            ]
            if not any(one.there for one in found):
                least = min(one.distance for one in found)
                raise TaskError(
                    f"{hand.name} cannot reach the object together: of {PLACED_DRAWS} places of its "
                    f"palm drawn, the arm of {palm.side.name!r} gets to none and {lift_height(hand):g} "
                    f"m above it, the nearest it comes is {1e3 * least:.0f} mm; use a smaller object, "
                    "turn it (T_world_object), or place the arms otherwise (position in hand.toml, "
                    "T_world_base)"
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
        roots = [hand.mj_model.body(palm.side.called("carriage")).id for palm in self._palms]
        own = pull * float(hand.mj_model.body_subtreemass[roots].sum())
        weight = pull * task.object.mass
        if weight > most - own:
            names = ", ".join(palm.side.name for palm in self._palms)
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
        for i, (palm, sign) in enumerate(zip(self._palms, (1.0, -1.0), strict=True)):
            place = self._arm if self.task.hand.on_arm else self._carriage
            q[palm.side.carriage] = place(i, sign * outward, rng, q)
        return self._closed(T_object_base, q, rng)

    def _drawn_direction(self, rng: np.random.Generator) -> FloatArray:
        """Unit direction (3,) from which the first hand comes, object frame."""
        if self._faces:
            return np.asarray(self._faces[rng.integers(len(self._faces))])
        noisy = self._from + rng.normal(0.0, SIDE_NOISE, 3)
        return np.asarray(noisy / np.linalg.norm(noisy))

    def _arm(
        self, i: int, outward: FloatArray, rng: np.random.Generator, q: FloatArray
    ) -> FloatArray:
        """Joints (n,) of arm i that lay its palm on the side that looks so, and can lift it there.

        Of the poses drawn the first that is reached, else the nearest; the others' joints from q.
        """
        side, found = self._palms[i].side, []
        for _ in range(PLACED_DRAWS):
            found.append(self._reached(i, self._drawn_pose(i, outward, rng), q))
            if found[-1].there:
                break
        best = min(found, key=lambda one: one.distance)
        return np.asarray(best.q[side.alone.arm.chain])

    def _reached(self, i: int, pose: SE3, q: FloatArray) -> Reach:
        """How near arm i brings the joint of its palm to a pose, object frame, and above it.

        What is missing is the larger miss of the two; its joints are those at the pose.
        """
        task, side = self.task, self._palms[i].side
        alone = side.alone
        T_world_palm = task.T_world_object * pose * alone.pin_model.frames[alone.palm_frame_id].placement
        T_root_world = (task.T_world_base * side.T_base_root).inverse()
        here = reach(alone, T_root_world * T_world_palm, q[side.joints], restarts=REACH_RESTARTS)
        if not here.there:
            return here
        lifted = SE3(T_world_palm.rotation, T_world_palm.translation + lift_height(task.hand) * UP)
        above = follow(alone, T_root_world * lifted, here.q)
        return Reach(q=here.q, distance=above.distance, angle=above.angle)

    def _carriage(
        self, i: int, outward: FloatArray, rng: np.random.Generator, _: FloatArray
    ) -> FloatArray:
        """Joints (6,) of carriage i that lay its palm on the side of the object that looks so."""
        hand, rest, root = self.task.hand, self._rest[i], self._roots[i]
        mine = self._palms[i].side.carriage
        low, high = hand.q_lower[mine], hand.q_upper[mine]
        best, least = np.zeros(6), np.inf
        for _ in range(PLACED_DRAWS):
            pose = self._drawn_pose(i, outward, rng)
            wanted = carriage_joints(root.inverse() * pose * rest.inverse() * root)
            beyond = float(np.maximum(low - wanted, wanted - high).max())
            if beyond < least:
                best, least = np.clip(wanted, low, high), beyond
            if beyond <= 0.0:
                break
        return best

    def _drawn_pose(self, i: int, outward: FloatArray, rng: np.random.Generator) -> SE3:
        """Pose of the joint of palm i, on or before the side of the object that looks so."""
        palm, rest, shape = self._palms[i], self._rest[i].rotation, self.task.object.shape
        onto = pin.Quaternion.FromTwoVectors(rest @ palm.pad.axis, -outward).matrix() @ rest
        most = np.pi if self.task.table_height is None else TURN_OVER_TABLE
        turn = pin.exp3(outward * rng.uniform(-most, most)) @ onto
        far = shape.bounding_radius * (FAR * outward + rng.normal(0.0, ASIDE_NOISE, 3))
        points, normals = shape.closest_point(far[None])
        normal = outward if shape.flat_sides is not None else normals[0]
        turn = pin.Quaternion.FromTwoVectors(outward, normal).matrix() @ turn
        if not palm.touches:
            gap = rng.uniform(*TIPS_GAP)
            return laid(palm, self._tips[i], points[0] + gap * normal, turn)
        return laid(palm, self._shares(palm, rng), points[0], turn)

    def _tips_of(self, palm: Palm) -> FloatArray:
        """Middle of the tips of half closed fingers along the palm, (3,), m, from its middle."""
        hand = self.task.hand
        state = moving_hand(hand).move((self.open + self._flexed) / 2.0)
        tips = np.mean([state.pad_center(hand.fingers[f]) for f in palm.side.fingers], axis=0)
        off = state.joint_pose(palm.pad.joint_id).actInv(tips) - palm.pad.center
        return np.asarray(off - palm.pad.axis * (palm.pad.axis @ off))
