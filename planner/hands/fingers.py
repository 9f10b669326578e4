"""What a hand touches with: fingers and their pads, inner links, the palm; the sides of two hands.

Beside its fingertips a hand touches with links of its fingers, and with the palm
(``Hand.contact_parts``). A link that touches is a finger that ends early: the joints up to that
link, and a pad on it. The palm is a finger without joints, or, of one hand of two, with those of
its carriage. Pads are proposed from the geometry: a capsule or cylinder touches along its line, a
box with the face that looks to the palm's side, a hull with the line or face that its front is. A
long round link has a second pad, on the flank towards the finger that opposes the others
(``flank``): there a thumb presses in a lateral grasp.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pinocchio as pin

from planner.bridge import LinkGeometry
from planner.spatial import FloatArray, IntArray

__all__ = ["Finger", "Pad", "Side"]


@dataclass(frozen=True, kw_only=True)
class Pad:
    """Spherical contact pad, fixed in a joint's frame.

    Attributes:
        geom: Collision geometry whose surface it is part of.
        joint_id: Pinocchio joint it moves with.
        center: (3,), m, in the joint's frame.
        axis: (3,), unit, in the joint's frame: where the pad faces.
        radius: m.
        half_angle: rad; contact points lie within this cone about the axis.
        rolling_axis: (3,), unit: middle of the cone within which contacts may roll.
        rolling_half_angle: rad; of that cone. Without a description, both equal ``axis`` and
            ``half_angle``.
        reach: (k, 3), m, orthogonal, in the joint's frame: the sphere stands for all that have
            their centre at most these away from ``center``, along a link or in a face; none
            (0, 3) at a fingertip.
    """

    geom: str
    joint_id: int
    center: FloatArray
    axis: FloatArray
    radius: float
    half_angle: float
    rolling_axis: FloatArray
    rolling_half_angle: float
    reach: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))

    def beyond_reach(self, off: FloatArray, turn: FloatArray, most: float = 1.0) -> FloatArray:
        """What is left of an offset (3,) from the pad's centre that its reach does not take up.

        Args:
            off: m, in any axes.
            turn: Rotation (3, 3) of the pad's joint in those axes.
            most: How many times its reach may be taken up (-).
        """
        for along in self.reach @ turn.T:
            off = off - np.clip(off @ along / (along @ along), -most, most) * along
        return off

    @property
    def rolling(self) -> Pad:
        """The same pad with the cone within which contacts may roll."""
        return replace(self, axis=self.rolling_axis, half_angle=self.rolling_half_angle)


@dataclass(frozen=True, kw_only=True)
class Finger:
    """One finger.

    Attributes:
        name: Its name in the description.
        joints: Joint names from the palm outwards.
        q_index: (n,), where those joints stand in q.
        tip_frame: Name of the tip frame (a site), also in ``pin_model``.
        tip_frame_id: Its number in ``pin_model.frames``.
        pad: Where it touches.
        bodies: Names of the bodies that belong to the finger.
        is_link: Whether it is no finger but a link that can touch, or the palm: a finger that ends
            early (``planner.hands.fingers``).
    """

    name: str
    joints: tuple[str, ...]
    q_index: IntArray
    tip_frame: str
    tip_frame_id: int
    pad: Pad
    bodies: frozenset[str]
    is_link: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class Side:
    """One hand of two, or the only one.

    Attributes:
        name: Its name in the description of the pair; "" of the only one.
        palm_body: Body of its palm.
        palm_normal: Direction the palm faces (3,), unit, in that body's frame.
        carriage: Where the joints that move its palm stand in q: of its carriage (6,), or of the
            arm that takes its place (n,); empty for the only one.
        fingers: Names of its fingers.
        alone: The ``Hand`` alone, of two, with its arm if it is on one; None of the only one.
        joints: Where the joints of the hand alone stand in q; empty for the only one.
        T_base_root: Pose (SE3) of its arm's root in the base of both; None on a carriage.
    """

    name: str
    palm_body: str
    palm_normal: FloatArray
    carriage: IntArray
    fingers: tuple[str, ...]
    alone: Any = None
    joints: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    T_base_root: Any = None

    def called(self, name: str) -> str:
        """What a body, joint or geometry of the hand alone is called in the whole."""
        return f"{self.name}/{name}" if self.name else name


ROUND_HALF_ANGLE = float(np.deg2rad(70.0))
"""Contacts of a round link lie within this cone (rad) about the direction to the palm's side: its
flanks touch as well, its back does not."""

FLANK = ".side"
"""Behind the name of a link: its flank."""

FLANK_HALF_ANGLE = float(np.deg2rad(50.0))
"""Contacts of a flank lie within this cone (rad) about the direction straight to the side."""

FLAT_HALF_ANGLE = float(np.deg2rad(8.0))
"""The same for the face of a box or a hull, whose one normal is the pad's axis."""

STRAIGHT = 1e-3
"""How far (m) the front of a hull may fall back where it counts as straight: the rest is closed
when fingers are put onto the true surface."""

SHORT_FACE, WIDE = 4e-3, 0.8
"""Least half length (m) along which a hull's front counts as straight; share (-) of its half extent
that a pad takes at most: its rim is round."""

FITTED, FACING_UP = np.linspace(-0.7, 0.7, 9), 0.05
"""Where the front is fitted, in shares of the half extents; cosine (-) between a facet of the front
and the direction in which the pad faces."""

FLAT, ONE_FACE = 0.2, float(np.cos(np.deg2rad(2.0)))
"""Share (-) of the rays onto a hull's front from which on the face that they meet is the pad, and
cosine between normals of one face."""

STEEPEST = float(np.cos(np.deg2rad(30.0)))
"""Cosine of the largest angle between a hull's front and where the hand says that it faces."""

ROUND_HULL_ANGLE = float(np.deg2rad(45.0))
"""Contacts of a round hull lie within this cone (rad)."""

TINY = 1e-12
"""A squared length (m2) below which there is no direction."""

SHORT = 1e-3
"""A link along whose line pads could move by less than this (m) is taken as a ball."""


def link_contacts(
    model: Any,
    geometries: Sequence[LinkGeometry],
    fingers: Sequence[Finger],
    side: Side,
    neutral: FloatArray,
    pinch: FloatArray | None,
) -> Mapping[str, Finger]:
    """Inner links, their flanks and palm of one hand as fingers that end early, by the body's name.

    Of a body with several geometries the largest touches; of the last one of a finger that of the
    tip, if it is a ball. A body whose name is a finger's is left out.

    Args:
        model: ``pinocchio.Model`` of the hand.
        geometries: Its colliding geometries.
        fingers: Its fingers.
        side: Its palm, and the joints of the carriage that moves it if it is one of two.
        neutral: Joints (nq,) with straight fingers.
        pinch: Joints (nq,) with fingertips that oppose each other; no flanks if None.
    """
    data = model.createData()
    pin.framesForwardKinematics(model, data, neutral)
    out = {}
    for finger in fingers:
        tip = data.oMi[finger.pad.joint_id]
        ball = next(g.kind for g in geometries if g.name == finger.pad.geom) == "sphere"
        for body in sorted(finger.bodies, key=model.getBodyId):
            geometry = _largest(geometries, body)
            if geometry is None:
                continue
            pose = data.oMi[geometry.joint_id]
            outward = tip.act(finger.pad.center) - pose.translation
            facing = tip.rotation @ finger.pad.axis
            facing = facing - outward * (outward @ facing) / max(float(outward @ outward), TINY)
            pad = _pad(geometry, pose.rotation.T @ facing)
            if ball and geometry.joint_id == finger.pad.joint_id:
                wide = max(ROUND_HALF_ANGLE, finger.pad.rolling_half_angle)
                pad = replace(finger.pad, axis=pad.axis, half_angle=wide)
            moving = [int(j) - 1 for j in model.supports[geometry.joint_id]]
            out[body] = _ended(model, body, pad, [j for j in finger.q_index if j in moving])
    palm = side.palm_body
    if (face := _largest(geometries, palm)) is not None:
        turn = model.frames[model.getBodyId(palm)].placement.rotation
        pad = _pad(face, turn @ side.palm_normal, of_palm=True)
        out[palm] = _ended(model, palm, pad, side.carriage.tolist())
    if pinch is not None:
        opposer = fingers[opposing(model, fingers, pinch)]
        hulls = {g.name for g in geometries if g.kind == "mesh"}
        for finger in fingers:
            links = [out[b] for b in out if b in finger.bodies and finger is not opposer]
            links = [link for link in links if link.pad.geom not in hulls]
            flanks = [_flank(model, link, opposer, pinch) for link in links]
            out |= {part.name: part for part in flanks if part is not None}
    names = {finger.name for finger in fingers}
    return {name: part for name, part in out.items() if name not in names}


def opposing(model: Any, fingers: Sequence[Finger], pinch: FloatArray) -> int:
    """Number of the finger that opposes the others: its pad looks against theirs.

    Args:
        model: ``pinocchio.Model`` of the hand.
        fingers: Of one hand, or of both.
        pinch: Joints (nq,) with fingertips that oppose each other.
    """
    data = model.createData()
    pin.forwardKinematics(model, data, pinch)
    axes = np.array([data.oMi[f.pad.joint_id].rotation @ f.pad.axis for f in fingers])
    return int((axes @ axes.sum(axis=0)).argmin())


def _flank(model: Any, link: Finger, opposer: Finger, pinch: FloatArray) -> Finger | None:
    """The flank of a round link towards the opposer's pad; None if the link is short or flat."""
    pad = link.pad
    if len(pad.reach) != 1:
        return None
    data = model.createData()
    pin.forwardKinematics(model, data, pinch)
    to_opposer = data.oMi[pad.joint_id].actInv(
        data.oMi[opposer.pad.joint_id].act(opposer.pad.center)
    )
    side = np.cross(pad.reach[0], pad.axis)
    side *= np.sign(side @ (to_opposer - pad.center)) / np.linalg.norm(side)
    looking = replace(
        pad,
        axis=side,
        half_angle=FLANK_HALF_ANGLE,
        rolling_axis=side,
        rolling_half_angle=FLANK_HALF_ANGLE,
    )
    return replace(link, name=link.name + FLANK, pad=looking)


def _ended(model: Any, body: str, pad: Pad, joints: Sequence[int]) -> Finger:
    """A finger that ends with a body; where its joints stand in q."""
    return Finger(
        name=body,
        joints=tuple(model.names[int(j) + 1] for j in joints),
        q_index=np.array(joints, dtype=int),
        tip_frame=body,
        tip_frame_id=int(model.getBodyId(body)),
        pad=pad,
        bodies=frozenset({body}),
        is_link=True,
    )


def _largest(geometries: Sequence[LinkGeometry], body: str) -> LinkGeometry | None:
    mine = [g for g in geometries if g.body == body]
    return max(mine, key=lambda g: float(np.prod(_extent(g)[1])), default=None)


def _extent(geometry: LinkGeometry) -> tuple[FloatArray, FloatArray]:
    """Middle and half extents (3,), m, of a geometry's box in its own frame."""
    coal_geometry = geometry.geometry
    coal_geometry.computeLocalAABB()
    box = coal_geometry.aabb_local
    return (np.array(box.max_) + box.min_) / 2, (np.array(box.max_) - box.min_) / 2


def _pad(geometry: LinkGeometry, facing: FloatArray, *, of_palm: bool = False) -> Pad:
    """The pad of a link; ``facing`` (3,) is the way to the palm's side, in the joint's frame."""
    if geometry.kind == "mesh":
        return _hull_pad(geometry, facing, of_palm)
    placed = geometry.T_joint_geometry
    local = placed.rotation.T @ facing
    middle, half = _extent(geometry)
    if geometry.kind in ("sphere", "capsule", "cylinder"):
        along = float(half[2] - half[0]) if geometry.kind == "capsule" else float(half[2])
        round_ = geometry.kind == "sphere" or along < SHORT
        local[2] = 0.0
        radius, angle = float(half[0]), ROUND_HALF_ANGLE
        reach = np.zeros((0, 3)) if round_ else np.array([[0.0, 0.0, along]])
    else:
        k = int(np.argmax(np.abs(local)))
        local = np.sign(local[k]) * np.eye(3)[k]
        radius, angle = float(half[k]), FLAT_HALF_ANGLE
        reach = np.diag(half)[[i for i in range(3) if i != k]]
    axis = placed.rotation @ (local / max(float(np.linalg.norm(local)), 1e-9))
    return Pad(
        geom=geometry.name,
        joint_id=geometry.joint_id,
        center=np.array(placed.act(middle)),
        axis=axis,
        radius=radius,
        half_angle=angle,
        rolling_axis=axis,
        rolling_half_angle=angle,
        reach=reach @ placed.rotation.T,
    )


def _hull_pad(geometry: LinkGeometry, facing: FloatArray, of_palm: bool) -> Pad:
    """The pad of a hull: where its front is as good as straight it is a line or a face, else round.

    A quadric is fitted to the front of the hull, twice, the second time seen along its normal.
    Along each of its two ways the pad reaches as far as the front falls back by ``STRAIGHT``. A way
    along which that is short is round, with the radius of curvature; so is the narrow way of a
    finger's link, which meets round objects with its edges.
    """
    from planner.system.scipy_parts import ConvexHull  # here: SciPy loads slowly

    placed = geometry.T_joint_geometry
    hull = ConvexHull(np.array(geometry.geometry.points()))
    corners, facets = hull.points[hull.vertices], hull.equations
    normal = placed.rotation.T @ facing
    normal /= max(float(np.linalg.norm(normal)), TINY)
    first = normal
    for _ in range(2):
        flat = corners - corners.mean(axis=0)
        ways = np.linalg.svd(flat - np.outer(flat @ normal, normal))[2][:2]
        low, high = (corners @ ways.T).min(axis=0), (corners @ ways.T).max(axis=0)
        half, middle = (high - low) / 2, (high + low) / 2 @ ways
        a, b = (v.ravel() for v in np.meshgrid(*np.outer(half, FITTED)))
        over = np.column_stack([a, b]) @ ways + middle
        apart, slope = over @ facets[:, :3].T + facets[:, 3], facets[:, :3] @ normal
        up, down = slope > FACING_UP, slope < -FACING_UP
        heights = -apart[:, up] / slope[up]
        height, met = heights.min(axis=1), facets[up, :3][heights.argmin(axis=1)]
        hit = height >= (-apart[:, down] / slope[down]).max(axis=1)
        quadric = np.column_stack([np.ones_like(a), a, b, -(a**2) / 2, -(b**2) / 2])
        fit = np.linalg.lstsq(quadric[hit], height[hit], rcond=None)[0]
        bent = np.maximum(fit[3:], 1e-3)
        front = middle + float(height[len(height) // 2]) * normal  # of the middle of the grid
        alike = met[hit] @ met[hit].T > ONE_FACE
        most = alike[alike.sum(axis=1).argmax()]
        turned = met[hit][most].mean(axis=0) if most.mean() > FLAT else normal - fit[1:3] @ ways
        turned /= np.linalg.norm(turned)
        if turned @ first > STEEPEST:
            normal = turned
    far = np.minimum(WIDE * half, np.sqrt(2.0 * STRAIGHT / bent))
    long = far > SHORT_FACE
    if not of_palm:
        long[int(np.argmin(half))] = False
    thick = float(np.append(half[~long], np.ptp(corners @ normal) / 2).min())
    radius = float(np.clip(1.0 / bent[~long].max(initial=1e-3), 2e-3, thick))
    angle = FLAT_HALF_ANGLE if long.all() else ROUND_HULL_ANGLE
    axis = placed.rotation @ normal
    return Pad(
        geom=geometry.name,
        joint_id=geometry.joint_id,
        center=np.array(placed.act(front - radius * normal)),
        axis=axis,
        radius=radius,
        half_angle=angle,
        rolling_axis=axis,
        rolling_half_angle=angle,
        reach=(far[:, None] * ways)[long] @ placed.rotation.T,
    )
