"""Links as spheres: spheres that fill them, and spheres that span them.

The clearance of a sphere from a smooth surface is that of its centre less its radius. Against the
object, spheres fill the links and are slightly smaller than they are. Against table and
obstacles' planes the corners of the hull are enough, and exact for spheres, capsules and boxes: a
capsule's two ends, a box's eight corners, a prism around a cylinder (spheres of radius 0). The
verdict on the true geometry is coal's (``planner.verification``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np

from planner.bridge import LinkGeometry
from planner.collision.pad_contact import ROUND, pad_geometry
from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.kinematics import HandState
from planner.spatial import FloatArray

SPACING = 2.0
"""Largest distance between neighbouring spheres of a link, in radii."""

SLENDER = 1.4
"""A bar of a finger is filled with spheres of the geometric mean of its half widths, at most this
many times the smaller: 1.4 reaches to the edges of a square bar. A plain filling leaves out up to
0.4 half widths at the edges, with which fingers with square links collide."""

THINNEST = 0.3
"""Spheres in a hull are kept if their radius is at least this share of its smallest half extent."""

DIRECTIONS = 24
"""Directions in which the outermost points of a hull are taken to span it."""


_PAD_OVERLAP = 1e-6
"""A sphere closer (m) to a pad's centre than this is the pad itself."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LinkSphere:
    """A sphere fixed in a joint's frame.

    Attributes:
        geometry: Name of the geometry it stands for.
        finger: Name of the finger it belongs to, "" for palm, wrist and base.
        joint_id: Pinocchio joint it moves with.
        center: (3,), m, in the joint's frame.
        radius: m.
        is_pad: Whether it is the finger's pad, which may touch the object.
        on_tip: Whether it belongs to the body that carries the pad.
        in_hull: Whether its geometry is a hull.
    """

    geometry: str
    finger: str
    joint_id: int
    center: FloatArray
    radius: float
    is_pad: bool
    on_tip: bool
    in_hull: bool


def margin_of(sphere: LinkSphere, touching: Sequence[Finger]) -> str | None:
    """The margin of a sphere from the object, by name; None for the pads of touching fingers.

    Links of a finger that touches with one of them are as near as a fingertip, but for hulls, of
    which the spheres fill less.
    """
    touches = sphere.finger in {finger.name for finger in touching}
    links = [finger.pad for finger in touching if finger.is_link]
    if any(pad.geom == sphere.geometry for pad in links):
        return None
    if any(pad.joint_id == sphere.joint_id for pad in links):
        return "clear_object" if sphere.finger and sphere.in_hull else "clear_tip"
    if sphere.is_pad and touches:
        return None
    return "clear_tip" if sphere.on_tip and touches else "clear_object"


def moving(hand: Hand, spheres: tuple[LinkSphere, ...]) -> tuple[LinkSphere, ...]:
    """The spheres that move with q or the base: not those of an arm's root, which stands fixed."""
    return tuple(b for b in spheres if not hand.on_arm or b.joint_id > 0)


@lru_cache(maxsize=8)
def link_spheres(hand: Hand) -> tuple[LinkSphere, ...]:
    """Spheres that fill every colliding geometry of a hand."""
    return _distinct(hand, _spheres(hand, corners=False))


def hull_spheres(hand: Hand) -> tuple[LinkSphere, ...]:
    """Spheres whose convex hull, joint by joint, holds every link: for clearance from a plane."""
    from planner.system.scipy_parts import ConvexHull  # here: SciPy loads slowly

    spheres = _spheres(hand, corners=True)
    inner: set[int] = set()
    for joint in {b.joint_id for b in spheres}:
        points = [i for i, b in enumerate(spheres) if b.joint_id == joint and b.radius == 0]
        if len(points) > 4:
            hull = ConvexHull([spheres[i].center for i in points])
            inner |= set(points) - {points[k] for k in hull.vertices}
    return _distinct(hand, [b for i, b in enumerate(spheres) if i not in inner])


def _spheres(hand: Hand, *, corners: bool) -> list[LinkSphere]:
    out = []
    for geometry in hand.geometries:
        name = hand.finger_of_body.get(geometry.body, "")
        if corners:
            centers, radius = span(geometry)
            radii = np.full(len(centers), radius)
        else:
            bar = bool(name) and is_bar(hand, geometry, name)
            centers, radii = fill(geometry, slender=bar)
            if bar:
                # beside a contact the corners matter
                edges = span(geometry)[0]
            elif is_beside_palm(hand, geometry):
                edges = np.array(list(product((-1.0, 0.0, 1.0), repeat=3))) * geometry.size
            else:
                edges = np.zeros((0, 3))
            centers, radii = np.vstack([centers, edges]), np.append(radii, np.zeros(len(edges)))
        for center, radius in zip(centers, radii, strict=True):
            at = np.array(geometry.T_joint_geometry.act(center))
            out.append(_sphere(hand, geometry, name, at, float(radius)))
    return out


def on_tip(hand: Hand, geometry: LinkGeometry, finger: str) -> bool:
    """Whether a geometry moves with the link that carries a finger's pad."""
    return bool(geometry.joint_id == hand.fingers[finger].pad.joint_id)


def is_bar(hand: Hand, geometry: LinkGeometry, finger: str) -> bool:
    """Whether a geometry of a finger is a box that reaches far: a long one, or that of the tip."""
    if geometry.kind != "box":
        return False
    _, wide, long = np.sort(geometry.size)
    return bool(long >= LONG * wide) or on_tip(hand, geometry, finger)


def is_beside_palm(hand: Hand, geometry: LinkGeometry) -> bool:
    """Whether it is a box of one of two palms beside the one that presses, as a heel is.

    A palm that is tipped onto the edge of its pad has the edges of these in the object.
    """
    own = [s.palm_body for s in hand.pair if s.palm_body == geometry.body]
    parts = [hand.contact_parts[name] for name in own if name in hand.contact_parts]
    return geometry.kind == "box" and any(part.pad.geom != geometry.name for part in parts)


LONG = 1.5
"""Length over width from which a box is a bar and not a knuckle (-)."""


def _distinct(hand: Hand, spheres: list[LinkSphere]) -> tuple[LinkSphere, ...]:
    """Without spheres that lie in another one at every q: links that share a joint share an end."""
    rng = np.random.default_rng(0)
    far = np.zeros((len(spheres), len(spheres)))
    for _ in range(2):
        state = HandState(hand, rng.uniform(hand.q_lower, hand.q_upper))
        at = np.array([state.joint_pose(b.joint_id).act(b.center) for b in spheres])
        far = np.maximum(far, np.linalg.norm(at[:, None] - at[None], axis=2))
    radius = np.array([b.radius for b in spheres])
    inside = (
        far + radius[:, None] <= radius[None] + SAME_POINT
    )  # [i, j]: sphere i is within sphere j
    order = np.arange(len(spheres))
    twins = inside & inside.T & (order[:, None] < order[None])  # of equal spheres the first stays
    pads = np.array([b.is_pad for b in spheres])
    dropped = ((inside & ~inside.T) | twins.T).any(axis=1) & ~pads
    return tuple(b for b, drop in zip(spheres, dropped, strict=True) if not drop)


SAME_POINT = 1e-6
"""Distance (m) below which two points are one."""


def _sphere(
    hand: Hand, geometry: LinkGeometry, finger: str, center: FloatArray, radius: float
) -> LinkSphere:
    is_pad = tip = False
    if finger:
        pad = hand.fingers[finger].pad
        tip = on_tip(hand, geometry, finger)
        apart = float(np.linalg.norm(center - pad.center))
        is_pad = tip and apart < _PAD_OVERLAP
        if tip and pad_geometry(hand, pad.geom).kind not in ROUND:
            # the pad's sphere is part of a box or a hull: spheres that overlap it may touch
            is_pad = apart < radius + pad.radius
    return LinkSphere(
        geometry=geometry.name,
        finger=finger,
        joint_id=geometry.joint_id,
        center=center,
        radius=radius,
        is_pad=is_pad,
        on_tip=tip,
        in_hull=geometry.kind == "mesh",
    )


def fill(geometry: LinkGeometry, *, slender: bool = False) -> tuple[FloatArray, FloatArray]:
    """Sphere centres (n, 3), m, and radii (n,), m, all through a geometry.

    Spheres are inside it, but for bars of fingers (``slender``), where they are a little too large.
    """
    a, b, c = (float(v) for v in geometry.size)
    if geometry.kind == "sphere":
        return np.zeros((1, 3)), np.array([a])
    if geometry.kind in ("capsule", "cylinder"):
        # a cylinder's end spheres reach exactly to its flat ends
        z = _row(b if geometry.kind == "capsule" else max(b - a, 0.0), a)
        return np.column_stack([np.zeros_like(z), np.zeros_like(z), z]), np.full(len(z), a)
    if geometry.kind == "mesh":
        return _fill_hull(geometry.geometry)
    half = np.array([a, b, c])
    radius = float(half.min())
    if slender and geometry.kind == "box":
        radius = min(SLENDER * radius, float(np.sqrt(np.prod(np.sort(half)[:2]))))
    grid = _grid(half, radius)
    return grid, np.full(len(grid), radius)


def span(geometry: LinkGeometry) -> tuple[FloatArray, float]:
    """Points (n, 3), m, and a radius (m): the hull of spheres of that radius there is the geometry.

    A little more than it for a cylinder, whose rim is a prism's; a little less for a round hull.
    """
    a, b, c = (float(v) for v in geometry.size)
    if geometry.kind == "sphere":
        return np.zeros((1, 3)), a
    if geometry.kind == "capsule":
        return np.array([[0.0, 0.0, -b], [0.0, 0.0, b]]), a
    if geometry.kind == "cylinder":
        return _prism(a, b), 0.0
    if geometry.kind == "mesh":
        vertices = np.array(geometry.geometry.points())
        outermost = np.unique(np.argmax(vertices @ _directions().T, axis=0))
        return vertices[outermost], 0.0
    return np.array(list(product(*([-h, h] for h in (a, b, c))))), 0.0


def _fill_hull(hull: Any) -> tuple[FloatArray, FloatArray]:
    """The largest spheres of a convex polyhedron about the points of a grid."""
    vertices = np.array(hull.points())
    normals, offsets = np.array(hull.normals()), np.array(hull.offsets())
    lower, upper = vertices.min(axis=0), vertices.max(axis=0)
    half = (upper - lower) / 2
    grid = _grid(half, float(half.min())) + (lower + upper) / 2
    inner = vertices.mean(axis=0)
    # faces point out of the hull whatever sign their offsets have
    side = np.sign(normals @ inner + offsets)
    depth = (side * (grid @ normals.T + offsets)).min(axis=1)
    good = depth >= THINNEST * half.min()
    if not good.any():
        good = depth == depth.max()
    return grid[good], np.maximum(depth[good], 0.0)


def _grid(half: FloatArray, radius: float) -> FloatArray:
    rows = [_row(float(max(h - radius, 0.0)), radius) for h in half]
    return np.stack(np.meshgrid(*rows, indexing="ij"), axis=-1).reshape(-1, 3)


def _directions() -> FloatArray:
    """Unit vectors (``DIRECTIONS``, 3) spread evenly over the sphere (Fibonacci spiral)."""
    k = np.arange(DIRECTIONS) + 0.5
    z = 1 - 2 * k / DIRECTIONS
    turn = np.pi * (1 + 5**0.5) * k
    ring = np.sqrt(1 - z**2)
    return np.column_stack([ring * np.cos(turn), ring * np.sin(turn), z])


def _prism(radius: float, half: float) -> FloatArray:
    """Corners (16, 3) of an octagonal prism around a cylinder along z."""
    turns = np.arange(8) * np.pi / 4
    ring = radius / np.cos(np.pi / 8) * np.column_stack([np.cos(turns), np.sin(turns)])
    return np.vstack([np.column_stack([ring, np.full(8, z)]) for z in (-half, half)])


def _row(reach: float, radius: float) -> FloatArray:
    """Evenly spaced coordinates from -reach to reach, no further apart than ``SPACING`` radii."""
    count = int(np.ceil(2 * reach / (SPACING * radius))) + 1 if reach > 0 else 1
    return np.linspace(-reach, reach, count)
