"""``PairTable``: what there is around a hand, and which pairs of geometries must not touch.

It follows from a task alone and never changes. ``planner.collision.world`` measures the pairs; how
they lie is told by ``Clearance``, one pair, and ``NearPairs``, many. ``lift_to_rest`` asks the same
pairs where an object comes to lie when it is lowered on what carries it, by the true geometry: a
scan that is turned by some degrees lies higher or lower on the same walls, by hundredths of a
millimetre for round ones and by millimetres for others.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planner.errors import TaskError
from planner.hands.hand import Hand
from planner.kinematics import HandKinematics, point_rates
from planner.shapes import Box, Mesh, Shape
from planner.shapes.convex_pairs import DistancePair
from planner.spatial import SE3, FloatArray, IntArray
from planner.task import GraspTask, Obstacle

if TYPE_CHECKING:
    from planner.collision.mesh_distance import MeshPair

OBJECT = "object"
"""Name of the object among the geometries."""
TABLE = "table"
"""Name of the table among the geometries."""

TABLE_SIZE = (2.0, 2.0, 0.1)
"""Full extents (m) of the table: wide enough for any hand, centred under the object."""

OVERLAP_TOL = 1e-5
"""Depth (m) to which the object may be inside table or obstacle: rounding, and coal's accuracy."""


@dataclass(frozen=True, kw_only=True)
class Clearance:
    """Signed distance of one pair: positive apart, negative in penetration.

    Attributes:
        first: Name of a hand geometry.
        second: Name of another one, "object", "table", or an obstacle's name.
        distance: m.
    """

    first: str
    second: str
    distance: float

    def __str__(self) -> str:
        """Names and distance in mm."""
        return f"{self.first} - {self.second}: {1e3 * self.distance:.2f} mm"


@dataclass(frozen=True, kw_only=True, eq=False)
class NearPairs:
    """How pairs that are near to each other lie.

    Attributes:
        numbers: Numbers of the pairs (k,).
        hand_environment: Whether the second is object, table or obstacle, (k,).
        mesh: Whether it is a mesh, (k,).
        joints: Pinocchio joints (k, 2) that the two geometries move with; 0 for what stands still.
        distances: Signed distances (k,), m.
        points_a: Nearest points of the first (k, 3), m.
        points_b: Nearest points of the second (k, 3), m.
        normals: Unit vectors (k, 3) from the first to the second.
    """

    numbers: IntArray
    hand_environment: NDArray[np.bool_]
    mesh: NDArray[np.bool_]
    joints: IntArray
    distances: FloatArray
    points_a: FloatArray
    points_b: FloatArray
    normals: FloatArray

    def rates(self, hand: HandKinematics) -> FloatArray:
        """How the distances change with the joints, (k, nq), of a hand where the pairs are."""
        jacobian, moved_by = hand.pin_data.J, hand.hand.moved_by
        ahead = point_rates(jacobian, moved_by, self.joints[:, 1], self.points_b, self.normals)
        behind = point_rates(jacobian, moved_by, self.joints[:, 0], self.points_a, self.normals)
        return ahead - behind


@dataclass(frozen=True, kw_only=True, eq=False)
class PairTable:
    """The geometries of a task, those of the hand first, and the pairs that must not touch.

    Of hand and surroundings, the hand's is a pair's first.

    Attributes:
        model: ``pinocchio.GeometryModel`` of all geometries.
        names: Of all geometries, in the model's order.
        n_hand: How many of them are the hand's.
        fixed: Poses of the others in the world: object, table, obstacles.
        pairs: The pairs, numbers of geometries.
        named: The pairs, names of geometries.
        first: The first geometry of each pair (n_pairs,).
        joints: Pinocchio's joints that carry them (n_pairs, 2).
        hand_environment_pairs: Which pairs (n_pairs,) are of hand and surroundings;
        of_arm: which have to do with the arm that carries the hand, or those of two, above its last
            link, which moves with the hand;
        between_hands: which are of two hands, their arms included;
        between_fingers: which are of two different fingers;
        finger_pairs: which of those are of links on their last three joints;
        on_object: which are with the object;
        on_mesh: which are with an object that is a mesh.
    """

    model: Any
    names: tuple[str, ...]
    n_hand: int
    fixed: tuple[SE3, ...]
    pairs: tuple[tuple[int, int], ...]
    named: tuple[tuple[str, str], ...]
    first: IntArray
    joints: IntArray
    hand_environment_pairs: NDArray[np.bool_]
    of_arm: NDArray[np.bool_]
    between_hands: NDArray[np.bool_]
    between_fingers: NDArray[np.bool_]
    finger_pairs: NDArray[np.bool_]
    on_object: NDArray[np.bool_]
    on_mesh: NDArray[np.bool_]

    @classmethod
    def of(cls, task: GraspTask) -> PairTable:
        """Collect the geometries and the pairs that must not touch.

        Raises:
            TaskError: Two geometries have one name, so that a verdict could not tell them apart;
                or table or an obstacle is in the object.
        """
        hand = task.hand
        surroundings = _surroundings(task)
        names = [g.name for g in hand.geometries] + [name for name, _, _ in surroundings]
        _check(task, names, surroundings)
        model = pin.GeometryModel()
        for g in hand.geometries:
            model.addGeometryObject(
                pin.GeometryObject(g.name, g.joint_id, g.T_joint_geometry, g.geometry)
            )
        for name, pose, shape in surroundings:
            model.addGeometryObject(pin.GeometryObject(name, 0, pose, shape.coal_geometry()))
        pairs = _pairs(hand, names)
        named = [(names[a], names[b]) for a, b in pairs]
        n_hand = len(hand.geometries)
        last = {s.carriage[-1] + 1 for s in hand.pair} | ({hand.arm.flange} if hand.arm else set())
        arm = hand.arm_geometries - {g.name for g in hand.geometries if g.joint_id in last}
        side_of = {
            name: s.name for s in hand.pair for name in names if name.startswith(s.called(""))
        }
        joint = [*(g.joint_id for g in hand.geometries), *(0 for _ in surroundings)]
        sides = [(side_of.get(a), side_of.get(b)) for a, b in named]
        on_object = np.array([b == OBJECT for _, b in named])
        between, outer = _finger_pairs(hand, pairs)
        return cls(
            model=model,
            names=tuple(names),
            n_hand=n_hand,
            fixed=tuple(pose for _, pose, _ in surroundings),
            pairs=tuple(pairs),
            named=tuple(named),
            first=np.array([a for a, _ in pairs]),
            joints=np.array([(joint[a], joint[b]) for a, b in pairs]),
            hand_environment_pairs=np.array([b >= n_hand for _, b in pairs]),
            of_arm=np.array([a in arm or b in arm for a, b in named]),
            between_hands=np.array([None not in both and len(set(both)) > 1 for both in sides]),
            between_fingers=between,
            finger_pairs=between & outer,
            on_object=on_object,
            on_mesh=on_object & isinstance(task.object.shape, Mesh),
        )

    @property
    def surroundings(self) -> frozenset[str]:
        """Names of all that is not the hand."""
        return frozenset(self.names[self.n_hand :])


def _surroundings(task: GraspTask) -> list[tuple[str, SE3, Shape]]:
    """Name, pose in the world and shape of object, table and obstacles, in this order."""
    found: list[tuple[str, SE3, Shape]] = [(OBJECT, task.T_world_object, task.object.shape)]
    if task.table_height is not None:
        top = np.array([*task.T_world_object.translation[:2], task.table_height])
        center = top - np.array([0.0, 0.0, TABLE_SIZE[2] / 2])
        found.append((TABLE, SE3(np.eye(3), center), Box(TABLE_SIZE)))
    for o in task.obstacles:
        x, y, z = (float(v) for v in o.size)
        found.append((o.name, o.T_world_obstacle, Box((x, y, z))))
    return found


def _check(
    task: GraspTask, names: Sequence[str], surroundings: Sequence[tuple[str, SE3, Shape]]
) -> None:
    """Refuse names that are not unique, and an object inside the others; see ``PairTable.of``."""
    twice = sorted(name for name, count in Counter(names).items() if count > 1)
    if twice:
        raise TaskError(
            f"several of obstacles, object, table and hand geometries are called {twice}; name "
            "each obstacle differently"
        )
    for name, pose, shape in surroundings[1:]:
        query = shape_pair(shape.coal_geometry(), task.object.shape)
        depth = -query.distance(pose, task.T_world_object)
        if depth > OVERLAP_TOL:
            raise TaskError(f"the object is {1e3 * depth:.2f} mm inside {name!r}; move them apart")


def _pairs(hand: Hand, names: Sequence[str]) -> list[tuple[int, int]]:
    """Pairs that must not touch: of the hand, then of hand and surroundings."""
    n_hand = len(hand.geometries)
    pairs = [
        (a, b)
        for a, b in combinations(range(n_hand), 2)
        if frozenset((names[a], names[b])) not in hand.allowed_pairs
    ]
    # an arm stands on the table
    standing = {g.name for g in hand.geometries if hand.on_arm and g.joint_id == 0}
    pairs += [
        (a, b)
        for a in range(n_hand)
        for b in range(n_hand, len(names))
        if not (names[a] in standing and names[b] == TABLE)
    ]
    return pairs


def _finger_pairs(
    hand: Hand, pairs: Sequence[tuple[int, int]]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which pairs (n_pairs,) are of two different fingers, and of links on their last joints."""
    finger_of = [hand.finger_of_body.get(g.body, "") for g in hand.geometries]
    joints = np.array([g.joint_id for g in hand.geometries])
    outer = np.zeros(len(joints), dtype=bool)
    for name in hand.fingers:
        mine = np.array([of == name for of in finger_of])
        outer |= mine & np.isin(joints, np.unique(joints[mine])[-3:])
    n = len(joints)
    apart = [(a, b) if b < n else (a, a) for a, b in pairs]
    between = [
        finger_of[a] != finger_of[b] and "" not in (finger_of[a], finger_of[b]) for a, b in apart
    ]
    return np.array(between), np.array([bool(outer[a] and outer[b]) for a, b in apart])


def shape_pair(geometry: Any, shape: Shape) -> DistancePair | MeshPair:
    """The distance query of a convex coal geometry (a) and a shape (b)."""
    if isinstance(shape, Mesh):
        from planner.collision.mesh_distance import MeshPair  # here: for meshes alone

        return MeshPair(geometry, shape)
    return DistancePair(geometry, shape.coal_geometry())


APART = 1e-6
"""Distance (m) from what carries it at which the object lies on it; it must not be in it."""

HALVINGS = 20
"""Halvings of the range of heights: a few centimetres to less than a micrometre."""


def lift_to_rest(
    shape: Shape,
    T_world_object: SE3,
    carrying: Sequence[Obstacle],
    lowest: float,
    highest: float,
) -> float | None:
    """How far up (m) an object must go from a pose to lie on obstacles, touching none.

    Args:
        shape: Of the object.
        T_world_object: Its pose; only its height changes.
        carrying: What it is to lie on.
        lowest: Where to look first, m; negative is below the pose.
        highest: Where to look last, m.

    Returns:
        The lift; ``lowest`` where it touches nothing there; None where it is in an obstacle even at
        ``highest``.
    """
    pairs = [
        (shape_pair(Box((o.size[0], o.size[1], o.size[2])).coal_geometry(), shape), o)
        for o in carrying
    ]

    def free(lift: float) -> bool:
        there = SE3(
            T_world_object.rotation, T_world_object.translation + np.array([0.0, 0.0, lift])
        )
        apart = (pair.distance(o.T_world_obstacle, there) for pair, o in pairs)
        return min(apart, default=np.inf) > APART

    low, high = lowest, highest
    if free(low):
        return low
    if not free(high):
        return None
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (low, middle) if free(middle) else (middle, high)
    return high
