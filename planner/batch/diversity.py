"""Features of grasps, near-duplicates among them, and how different a set is.

Features by which grasps of one object are compared: base, contacts and joints.

All in the object's frame, so that where the object lies in the world makes no difference.

Near-duplicates among grasps: found, and thinned to one each.

Two grasps of one object are near-duplicates if base position, base rotation, every contact and
every joint agree within tolerances. Grasps that a symmetry of the object turns into each other are
not: the hand stands elsewhere, which matters for learning and for choosing among grasps.

How different the grasps of one object are from each other, as four numbers.

- Approach: over how many of 192 cells of equal area on the sphere (HEALPix, resolution 4, about 15
  degrees across; Gorski et al. 2005) the directions spread in which the palm faces, and the entropy
  of that histogram.
- Contact: the share of the object's surface within 5 mm of a contact.
- Posture: the differential entropy of the joints by their nearest neighbours (Kozachenko and
  Leonenko 1987, in the form of Kraskov, Stoegbauer and Grassberger 2004, equation 20).
- What is left without near-duplicates (``planner.batch.diversity``).

The first three grow with the number of grasps, so compare sets of the same size.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.special import digamma

from planner.errors import TaskError
from planner.failure import Failure
from planner.kinematics import HandState
from planner.plan import GraspPlan
from planner.shapes import Shape
from planner.shapes.mesh import surface_points
from planner.spatial import FloatArray, IntArray, pose_from_wxyz
from planner.synthesis.seeds import seeder_for
from planner.task import GraspTask

DRAWS_PER_START = 50
"""Draws per start before the seeder counts as unable to give one."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GraspFeatures:
    """n grasps of one object by one hand with c fingers, of which some may be spared.

    Attributes:
        positions: Hand's base (n, 3), m.
        rotations: Hand's base (n, 3, 3).
        approach: Direction that the palm faces (n, 3), unit.
        contacts: (n, c, 3), m, finger by finger; NaN where one does not touch.
        q: Joints of these fingers (n, d), rad (m for slides).
    """

    positions: FloatArray
    rotations: FloatArray
    approach: FloatArray
    contacts: FloatArray
    q: FloatArray

    def __post_init__(self) -> None:
        """Check the shapes.

        Raises:
            TaskError: They do not fit.
        """
        n = len(self.positions)
        given = [np.shape(getattr(self, name)) for name in self.__dataclass_fields__]
        tails = ((3,), (3, 3), (3,), (*given[3][1:2], 3), given[4][1:2])
        if given != [(n, *tail) for tail in tails]:
            raise TaskError(
                f"arrays of grasps have shapes {given}; give (n, 3), (n, 3, 3), (n, 3), (n, c, 3) "
                "and (n, d)"
            )

    def __len__(self) -> int:
        """Number of grasps."""
        return len(self.positions)

    def __getitem__(self, rows: Any) -> GraspFeatures:
        """Some of the grasps, as numpy indexes rows."""
        return GraspFeatures(**{k: getattr(self, k)[rows] for k in self.__dataclass_fields__})

    @classmethod
    def of_rows(cls, task: GraspTask, rows: Sequence[Mapping[str, Any]]) -> GraspFeatures:
        """Of rows of a dataset, all found, all of the task's object."""
        index, n = _finger_joints(task), len(rows)
        every = list(task.all_names)
        contacts = np.full((n, len(every), 3), np.nan)
        for places, row in zip(contacts, rows, strict=True):
            names = row.get("fingers") or task.finger_names
            places[[every.index(f) for f in names]] = row["contact_positions_object_m"]
        rotations = [
            pose_from_wxyz(np.zeros(3), np.array(row["base_quaternion_object_wxyz"])).rotation
            for row in rows
        ]
        return cls(
            positions=_stack([row["base_position_object_m"] for row in rows], (n, 3)),
            rotations=_stack(rotations, (n, 3, 3)),
            approach=_stack([row["approach_object"] for row in rows], (n, 3)),
            contacts=contacts,
            q=_stack([np.array(row["q_rad"])[index] for row in rows], (n, len(index))),
        )

    @classmethod
    def of_plans(cls, plans: Sequence[GraspPlan]) -> GraspFeatures:
        """Of plans of one object by one hand; c is for the fingers of the one that has most.

        Raises:
            TaskError: There is none, or one has fingers that this one has not.
        """
        if not plans:
            raise TaskError("there are no plans to compare; give at least one")
        tasks = [plan.task for plan in plans]
        whole = max(tasks, key=lambda task: len(task.fingers))
        names = list(whole.finger_names)
        if not all(task.is_of_fingertips for task in tasks):
            names = list(dict.fromkeys(name for task in tasks for name in task.finger_names))
        index = _finger_joints(whole)
        contacts = np.full((len(plans), len(names), 3), np.nan)
        for places, plan in zip(contacts, plans, strict=True):
            if other := sorted(set(plan.task.finger_names) - set(names)):
                raise TaskError(
                    f"a plan uses {', '.join(other)}, and another {', '.join(names)}; give plans "
                    "of one task"
                )
            taken = [names.index(name) for name in plan.task.finger_names]
            places[taken] = plan.contacts_in_object.positions
        to_object = [plan.task.T_world_object.inverse() for plan in plans]
        bases = [T * plan.T_world_base for T, plan in zip(to_object, plans, strict=True)]
        palms = [T * plan.T_world_palm for T, plan in zip(to_object, plans, strict=True)]
        normal = plans[0].task.hand.palm_normal
        return cls(
            positions=np.array([T.translation for T in bases]),
            rotations=np.array([T.rotation for T in bases]),
            approach=np.array([T.rotation @ normal for T in palms]),
            contacts=contacts,
            q=np.array([plan.q[index] for plan in plans]),
        )

    @classmethod
    def of_random_starts(cls, task: GraspTask, n: int, *, seed: int = 0) -> GraspFeatures:
        """Of n independent starts of the search, as they are before solving.

        Reference for the diversity of a batch: solving should not bring grasps together.

        Raises:
            TaskError: The object cannot be grasped by this hand, or starts cannot be drawn.
        """
        seeder, rng = seeder_for(task), np.random.default_rng(seed)
        starts: list[Any] = []
        for _ in range(DRAWS_PER_START * n):
            if len(starts) == n:
                break
            start = seeder.draw(rng)
            if not isinstance(start, Failure):
                starts.append(start)
        else:
            raise TaskError(
                f"of {DRAWS_PER_START * n} starts drawn for {task!r} only {len(starts)} can be "
                "used; bring the object into reach"
            )
        index, hand, c = _finger_joints(task), task.hand, len(task.fingers)
        palms = [s.T_object_base * HandState(hand, s.q).T_base_palm for s in starts]
        return cls(
            positions=_stack([s.T_object_base.translation for s in starts], (n, 3)),
            rotations=_stack([s.T_object_base.rotation for s in starts], (n, 3, 3)),
            approach=_stack([T.rotation @ hand.palm_normal for T in palms], (n, 3)),
            contacts=_stack([s.points for s in starts], (n, c, 3)),
            q=_stack([s.q[index] for s in starts], (n, len(index))),
        )


def _finger_joints(task: GraspTask) -> Any:
    """Where the joints of the fingers that take part stand in q."""
    index = np.concatenate([finger.q_index for finger in task.fingers])
    return index if task.is_of_fingertips else np.unique(index)


def _stack(items: Sequence[Any], shape: tuple[int, ...]) -> FloatArray:
    """Items as one array of a known shape, which says the rest where there are none."""
    return np.array(items, dtype=np.float64).reshape(shape)


POSITION_TOL = 0.010
"""Distance (m) between two bases up to which they are alike: a tenth of a hand's length."""

ROTATION_TOL = float(np.deg2rad(10.0))
"""Turn (rad) between two bases up to which they are alike: about 10 mm at the fingertips, 6 cm
from the contacts' middle."""

CONTACT_TOL = 0.005
"""Distance (m) between two contacts of a finger up to which they are alike: less than half of a
pad's radius, and what a hand's placing error leaves."""

FLEXION_TOL = float(np.deg2rad(10.0))
"""Difference (rad; m for slides) of a joint up to which it is alike."""


def distances(grasps: GraspFeatures, i: int, others: IntArray) -> FloatArray:
    """How different grasp i is from others (m,), in tolerances: near-duplicates are at most 1.

    The largest of the four differences, each divided by its tolerance; a metric, since each is.
    """
    part = grasps[others]
    turn = np.einsum("nij,ij->n", part.rotations, grasps.rotations[i])  # trace of R_n R_i^T
    angles = np.arccos(np.clip((turn - 1.0) / 2.0, -1.0, 1.0))
    contacts = np.linalg.norm(_placed(part.contacts) - _placed(grasps.contacts[i]), axis=2)
    out: FloatArray = np.max(
        [
            np.linalg.norm(part.positions - grasps.positions[i], axis=1) / POSITION_TOL,
            angles / ROTATION_TOL,
            contacts.max(axis=1, initial=0.0) / CONTACT_TOL,
            np.abs(part.q - grasps.q[i]).max(axis=1, initial=0.0) / FLEXION_TOL,
        ],
        axis=0,
    )
    return out


AWAY = 1e3
"""Coordinate (m) where the contact of a finger that does not touch is put: grasps with different
fingers are never alike, and those without the same finger differ in nothing there."""


def _placed(contacts: FloatArray) -> FloatArray:
    """Contacts, with a place for missing ones."""
    return np.where(np.isnan(contacts), AWAY, contacts)


def thin(grasps: GraspFeatures, *, worth: FloatArray | None = None) -> IntArray:
    """Numbers of grasps, ascending, of which no two are near-duplicates, and that stand for all.

    The grasp of most worth is kept, its near-duplicates are dropped, and so on. Grasps of equal
    worth are ordered by their coordinates, so that the numbering makes no difference.

    Args:
        grasps: n grasps of one object.
        worth: (n,), larger is better, for example epsilon; all equal if None.

    Raises:
        TaskError: ``worth`` has another shape, or holds NaN.
    """
    n = len(grasps)
    value = np.zeros(n) if worth is None else np.asarray(worth, dtype=np.float64)
    if value.shape != (n,) or np.isnan(value).any():
        raise TaskError(f"worth has shape {value.shape}, or holds NaN; give {n} numbers")
    if n == 0:
        return np.zeros(0, dtype=np.int64)
    flat = np.hstack([grasps.positions, _placed(grasps.contacts).reshape(n, -1), grasps.q])
    # a ball of points is in a box of coordinates, which a tree finds quickly
    scale = np.concatenate(
        [
            np.full(3, POSITION_TOL),
            np.full(grasps.contacts[0].size, CONTACT_TOL),
            np.full(grasps.q.shape[1], FLEXION_TOL),
        ]
    )
    tree = cKDTree(flat / scale)
    dropped = np.zeros(n, dtype=bool)
    kept = []
    for i in np.lexsort((*flat.T[::-1], -value)):
        if dropped[i]:
            continue
        kept.append(int(i))
        near = np.array(tree.query_ball_point(flat[i] / scale, SLACK, p=np.inf), dtype=np.int64)
        near = near[~dropped[near]]
        dropped[near[distances(grasps, int(i), near) <= 1.0]] = True
    return np.array(sorted(kept), dtype=np.int64)


SLACK = 1.0 + 1e-9
"""Half-width (-) of the search box in tolerances, with room for rounding."""


N_SIDE = 4
"""Resolution: cells along the edge of each of the twelve base cells."""

N_CELLS = 12 * N_SIDE**2
"""Cells on the sphere: 192, each 0.065 sr, about 15 degrees across."""

TOUCHED = 0.005
"""Distance (m) from a contact within which surface counts as touched: a pad's contact patch."""

SURFACE_POINTS = 2000
"""Points, evenly spread by area, that stand for the surface: the share is right to 0.01."""

NEIGHBOUR = 3
"""Which nearest neighbour estimates the density: a further one has less variance, more bias."""

FINEST = 1e-3
"""Distance (rad) below which postures count as this far apart: a servo does not resolve them,
and equal ones would have an entropy of minus infinity."""


@dataclass(frozen=True, kw_only=True)
class Diversity:
    """How different n grasps are from each other; see the module.

    Attributes:
        n: Grasps.
        n_distinct: Grasps left without near-duplicates.
        approach_share: Share of the cells of approach directions that are taken (-).
        approach_entropy: Entropy of the cells, nats; at most log(192) = 5.26.
        surface_share: Share of the surface that is touched (-).
        posture_entropy: Entropy of the d joints of the fingers, nats (of rad^d); None for fewer
            grasps than it takes. It may be negative.
        posture_width_rad: Width (rad) over which each joint would be spread evenly and by itself
            for this entropy H, exp(H / d); None likewise.
    """

    n: int
    n_distinct: int
    approach_share: float
    approach_entropy: float
    surface_share: float
    posture_entropy: float | None
    posture_width_rad: float | None

    def to_dict(self) -> dict[str, Any]:
        """As plain data."""
        return asdict(self)


def diversity(grasps: GraspFeatures, shape: Shape) -> Diversity:
    """Measure grasps of a shape."""
    entropy = posture_entropy(grasps.q)
    counts = np.bincount(cell_of(grasps.approach), minlength=N_CELLS)
    return Diversity(
        n=len(grasps),
        n_distinct=len(thin(grasps)),
        approach_share=float((counts > 0).mean()),
        approach_entropy=_entropy(counts),
        surface_share=_touched(grasps.contacts.reshape(-1, 3), shape),
        posture_entropy=entropy,
        posture_width_rad=None if entropy is None else float(np.exp(entropy / grasps.q.shape[1])),
    )


def posture_entropy(q: FloatArray) -> float | None:
    """Differential entropy of postures (n, d), nats, distances by the largest difference.

    H = psi(n) - psi(k) + d mean(log 2 r_k), with r_k the distance to the k-th neighbour.
    """
    n, d = q.shape
    if n <= NEIGHBOUR or d == 0:
        return None
    radius = cKDTree(q).query(q, k=[NEIGHBOUR + 1], p=np.inf)[0][:, 0]
    spread = np.log(2.0 * np.maximum(radius, FINEST)).mean()
    return float(digamma(n) - digamma(NEIGHBOUR) + d * spread)


def _entropy(counts: NDArray[np.int_]) -> float:
    """Of a histogram, nats; 0 if it is empty."""
    shares = counts[counts > 0] / max(1, counts.sum())
    return float(-(shares * np.log(shares)).sum())


def _touched(contacts: FloatArray, shape: Shape) -> float:
    """Share of the surface within reach of a contact."""
    contacts = contacts[~np.isnan(contacts).any(axis=1)]
    if len(contacts) == 0:
        return 0.0
    points = surface_points(shape, SURFACE_POINTS)
    distance = cKDTree(contacts).query(points, distance_upper_bound=TOUCHED)[0]
    return float(np.isfinite(distance).mean())


def cell_of(directions: FloatArray) -> IntArray:
    """Number of the HEALPix cell (n,), from 0 at the north pole, that each direction (n, 3) is in.

    In ring order: Gorski et al., "HEALPix: a framework for high-resolution discretization and fast
    analysis of data distributed on the sphere", The Astrophysical Journal 622 (2005), section 5.
    """
    x, y, z = np.asarray(directions, dtype=np.float64).reshape(-1, 3).T
    z = z / np.sqrt(x * x + y * y + z * z)
    quarter = np.mod(np.arctan2(y, x), 2 * np.pi) / (np.pi / 2)  # azimuth, [0, 4)
    cells: IntArray = np.where(np.abs(z) <= 2 / 3, _belt(z, quarter), _cap(z, quarter))
    return cells


def _belt(z: FloatArray, quarter: FloatArray) -> IntArray:
    """Cells of the equatorial belt, where all rings have 4 N cells."""
    rising = np.floor(N_SIDE * (0.5 + quarter - 0.75 * z)).astype(np.int64)
    falling = np.floor(N_SIDE * (0.5 + quarter + 0.75 * z)).astype(np.int64)
    ring = N_SIDE + 1 + rising - falling  # 1 .. 2 N + 1
    place = ((rising + falling - N_SIDE + 1) // 2) % (4 * N_SIDE)
    cells: IntArray = 2 * N_SIDE * (N_SIDE - 1) + (ring - 1) * 4 * N_SIDE + place
    return cells


def _cap(z: FloatArray, quarter: FloatArray) -> IntArray:
    """Cells of the polar caps, where the ring i from the pole has 4 i cells."""
    share = quarter - np.floor(quarter)
    out = N_SIDE * np.sqrt(np.maximum(0.0, 3.0 * (1.0 - np.abs(z))))
    rising = np.floor(share * out).astype(np.int64)
    falling = np.floor((1.0 - share) * out).astype(np.int64)
    ring = np.minimum(rising + falling + 1, N_SIDE)
    place = np.floor(quarter * ring).astype(np.int64) % (4 * ring)
    north = 2 * ring * (ring - 1) + place
    cells: IntArray = np.where(z > 0, north, N_CELLS - 2 * ring * (ring + 1) + place)
    return cells
