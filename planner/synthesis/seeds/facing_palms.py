"""Starts of grasps with two hands: each on its side of the object, its fingers closed around it.

The right hand, say, comes from where it is at rest, the other from the opposite side; both are
turned at random about the normals of their palms.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from planner.collision.arm_path import lift_height
from planner.collision.world import CollisionWorld
from planner.errors import TaskError
from planner.hands.fingers import Side
from planner.hands.two_hands import carriage_joints
from planner.kinematics import POSITION_TOL, MovingHand, Reach, follow, moving_hand, reach
from planner.spatial import SE3, FloatArray
from planner.synthesis.seeds.enveloping import FAR, HANDS, EnvelopingSeeder, Palm, laid
from planner.task import GraspTask

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

TURN_NOISE = 0.2
"""Standard deviation (rad) of the turn of each of two palms that turn alike."""

PLACED_DRAWS = 20
"""Poses of a palm drawn in search of one within its carriage's reach; also to see whether its arm
reaches any."""

WITHDRAWAL, WITHDRAWALS = 0.02, 16
"""Step (m) by which a palm goes back, away from its fingers, until the arm's last link, which is
thicker than the palm, is clear of the object; and the most places looked at."""

IN_THE_WAY = 0.03
"""How far (m) arms may be in something at places drawn: the search finds others beside them."""

REACH_RESTARTS = 2
"""Random starts of inverse kinematics after the ready posture, for such a pose."""


class PairSeeder(EnvelopingSeeder):
    """Draws starts in which two palms face each other across the object.

    For two arms the starts are of their hands on carriages.
    """

    def __init__(self, task: GraspTask) -> None:
        """See ``Seeder``; two arms that cannot reach the object together are refused."""
        self._asked = task
        super().__init__(task.on_carriages)

    def _prepare(self) -> None:
        """Find where the hands are at rest, and what they face.

        Raises:
            TaskError: The object is too heavy, out of reach, or turns no side to the hands.
        """
        super()._prepare()
        task, hand = self.task, self.task.hand
        pose = task.T_world_object.inverse() * task.T_world_base
        at_rest = moving_hand(hand).move(hand.neutral)
        self._rest = [pose * at_rest.joint_pose(palm.pad.joint_id) for palm in self._palms]
        last = [int(palm.side.carriage[-1]) + 1 for palm in self._palms]
        self._roots = [pose * at_rest.joint_pose(joint) for joint in last]
        self._tips = [self._tips_of(palm) for palm in self._palms]
        self._turn: float | None = None
        self._links = [self._last_link_of(palm, at_rest) for palm in self._palms]
        apart = self._rest[0].translation - self._rest[1].translation
        self._from = apart / np.linalg.norm(apart)
        self._faces = self._faces_towards_hands()
        if self._asked is self.task:
            self._check_reach()
            self._check_weight()
        else:
            self._check_arms()

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

    def _check_arms(self) -> None:
        """Refuse an object that two arms, at no pair of places drawn, reach and lift together.

        Raises:
            TaskError: So, or an arm stands in it.
        """
        task, hand, rng = self._asked, self._asked.hand, np.random.default_rng(0)
        world, q = CollisionWorld(task), hand.at_rest
        least = dict.fromkeys((side.name for side in hand.pair), np.inf)
        for _ in range(PLACED_DRAWS):
            outward, there = self._drawn_direction(rng), True
            self._draw_turn(rng)
            for i, (side, sign) in enumerate(zip(hand.pair, (1.0, -1.0), strict=True)):
                found = _lifting(task, side, self._drawn_pose(i, sign * outward, rng))
                least[side.name] = min(least[side.name], found.distance)
                q[side.joints], there = found.q, there and found.there
            held = task.T_world_object
            nearest = world.nearest_on_arm(task.T_world_base, q, T_world_object=held)
            if there and nearest.distance > -IN_THE_WAY:
                return
        far = max(least, key=lambda name: least[name])
        miss = f"that of {far!r} comes no nearer than {1e3 * least[far]:.0f} mm"
        raise TaskError(
            f"{hand.name} cannot reach the object together: at none of {PLACED_DRAWS} pairs of "
            f"places of the palms do both arms get there and {lift_height(hand):g} m above; "
            f"{miss if least[far] > POSITION_TOL else f'in the way: {nearest}'}; use a smaller "
            "object, turn it (T_world_object), or place the arms otherwise (position in hand.toml, "
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
        self._draw_turn(rng)
        for i, (palm, sign) in enumerate(zip(self._palms, (1.0, -1.0), strict=True)):
            q[palm.side.carriage] = self._carriage(i, sign * outward, rng)
        return self._closed(T_object_base, q, rng)

    def _drawn_direction(self, rng: np.random.Generator) -> FloatArray:
        """Unit direction (3,) from which the first hand comes, object frame."""
        if self._faces:
            return np.asarray(self._faces[rng.integers(len(self._faces))])
        noisy = self._from + rng.normal(0.0, SIDE_NOISE, 3)
        return np.asarray(noisy / np.linalg.norm(noisy))

    def _carriage(self, i: int, outward: FloatArray, rng: np.random.Generator) -> FloatArray:
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
        turn = pin.exp3(outward * self._drawn_turn(i, rng)) @ onto
        far = shape.bounding_radius * (FAR * outward + rng.normal(0.0, ASIDE_NOISE, 3))
        if palm.touches:
            gap, place = 0.0, self._shares(palm, rng)
        else:
            gap, place = rng.uniform(*TIPS_GAP), self._tips[i]
        centers, radii = self._links[i]
        for _ in range(WITHDRAWALS):
            points, normals = shape.closest_point(far[None])
            normal = outward if shape.flat_sides is not None else normals[0]
            onto = pin.Quaternion.FromTwoVectors(outward, normal).matrix() @ turn
            pose = laid(palm, place, points[0] + gap * normal, onto)
            at = centers @ pose.rotation.T + pose.translation
            if (self._from_surface(at)[0] >= radii).all():
                break
            far -= WITHDRAWAL * (onto @ palm.way)  # the last link beyond the object's edge
        return pose

    @property
    def _most_turn(self) -> float:
        return float(np.pi if self.task.table_height is None else TURN_OVER_TABLE)

    def _draw_turn(self, rng: np.random.Generator) -> None:
        """Let both palms turn alike, where arms' last links keep them to the object's edges."""
        if any(len(radii) for _, radii in self._links):
            self._turn = rng.uniform(-self._most_turn, self._most_turn)

    def _drawn_turn(self, i: int, rng: np.random.Generator) -> float:
        """Angle (rad) of palm i about where it comes from, which are opposite for both."""
        if self._turn is None:
            return float(rng.uniform(-self._most_turn, self._most_turn))
        return float((self._turn, -self._turn)[i] + rng.normal(0.0, TURN_NOISE))

    def _last_link_of(self, palm: Palm, at_rest: MovingHand) -> tuple[FloatArray, FloatArray]:
        """Spheres in the arm's last link: centres (k, 3) in the palm's joint, radii (k,), m."""
        T_base_palm = SE3(at_rest.joint_pose(palm.pad.joint_id))
        names = [palm.side.called(name) for name in palm.side.alone.last_link]
        inside = [ball for ball in self._spheres if ball.geometry in names]
        placed = [at_rest.joint_pose(ball.joint_id).act(ball.center) for ball in inside]
        centers = np.array([T_base_palm.actInv(center) for center in placed]).reshape(-1, 3)
        return centers, np.array([ball.radius for ball in inside])

    def _tips_of(self, palm: Palm) -> FloatArray:
        """Middle of the tips of half closed fingers along the palm, (3,), m, from its middle."""
        hand = self.task.hand
        state = moving_hand(hand).move((self.open + self._flexed) / 2.0)
        tips = np.mean([state.pad_center(hand.fingers[f]) for f in palm.side.fingers], axis=0)
        off = state.joint_pose(palm.pad.joint_id).actInv(tips) - palm.pad.center
        return np.asarray(off - palm.pad.axis * (palm.pad.axis @ off))


def _lifting(task: GraspTask, side: Side, pose: SE3) -> Reach:
    """How near an arm brings the joint of its palm to a pose (object frame), and above that."""
    alone, up = side.alone, np.array([0.0, 0.0, lift_height(task.hand)])
    placed = pose * alone.pin_model.frames[alone.palm_frame_id].placement
    there = task.T_world_object * placed
    root = (SE3(task.T_world_base) * side.T_base_root).inverse()
    here = reach(alone, root * there, alone.at_rest, restarts=REACH_RESTARTS)
    if not here.there:
        return here
    return follow(alone, root * SE3(there.rotation, there.translation + up), here.q)
