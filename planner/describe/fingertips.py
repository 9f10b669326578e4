"""Where a finger ends and which way it closes: the distal link's bone and flexion direction.

All in the frame of the finger's last joint, with every joint as near to zero as its range allows.
``ConvexLink`` is all that a pad is fitted from: for a convex body K, support h(d) = max of d . x
over K, and depth(c) = least of h(d) - d . c over unit d, the radius of the largest ball about c
inside K.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from planner.bridge import LinkGeometry
from planner.bridge.structure import ModelStructure
from planner.describe.tree import Branch
from planner.spatial import SE3, FloatArray

ELLIPSOID_DIRECTIONS = 4000
"""Directions with which the depth in an ellipsoid is taken: at most 2 % of a radius too large where
its proportions are 1 to 3, and the verdict is coal's."""


class ConvexLink:
    """One convex geometry in the frame of the joint that carries it.

    Attributes:
        name: Name of the geom.
        kind: "sphere", "capsule", "cylinder", "box", "ellipsoid" or "mesh".
        center: (3,), m: its origin.
        rotation: (3, 3): its axes.
        vertices: (n, 3), of a mesh's hull, m, in its own axes, as all that follows.
        facets: (m, 4), outward unit normals and offsets of the hull's facets.
        points: (k, 3), the points that ``triangles`` counts.
        triangles: (m, 3), corners of the facets.
    """

    def __init__(self, geometry: LinkGeometry) -> None:
        """Read size and place of a geometry; a mesh counts as its convex hull."""
        from planner.system.scipy_parts import ConvexHull  # here: SciPy loads slowly

        self.name, self.kind, self.body = geometry.name, geometry.kind, geometry.body
        self.center = np.array(geometry.T_joint_geometry.translation)
        self.rotation = np.array(geometry.T_joint_geometry.rotation)
        self.size = geometry.size
        self.vertices = np.zeros((0, 3))
        self.facets = np.zeros((0, 4))
        self.points = np.zeros((0, 3))
        self.triangles = np.zeros((0, 3), dtype=np.int64)
        if self.kind == "mesh":
            hull = ConvexHull(np.array(geometry.geometry.points()))
            self.vertices = hull.points[hull.vertices]
            self.facets = hull.equations
            self.points, self.triangles = hull.points, hull.simplices

    def support_points(self, directions: FloatArray) -> FloatArray:
        """The furthest point of the body along each unit direction: (n, 3) -> (n, 3), m."""
        d = directions @ self.rotation
        a, b, c = (float(v) for v in self.size)
        if self.kind == "sphere":
            local = a * d
        elif self.kind == "capsule":
            local = a * d + np.outer(np.sign(d[:, 2]) * b, [0.0, 0.0, 1.0])
        elif self.kind == "cylinder":
            radial = d * [1.0, 1.0, 0.0]
            length = np.linalg.norm(radial, axis=1, keepdims=True)
            local = a * radial / np.maximum(length, 1e-12)
            local[:, 2] = np.sign(d[:, 2]) * b
        elif self.kind == "box":
            local = np.sign(d) * [a, b, c]
        elif self.kind == "ellipsoid":
            half = np.array([a, b, c])
            local = half**2 * d / np.linalg.norm(half * d, axis=1, keepdims=True)
        else:
            local = self.vertices[np.argmax(d @ self.vertices.T, axis=1)]
        return np.asarray(local @ self.rotation.T + self.center)

    def support(self, directions: FloatArray) -> FloatArray:
        """h(d) for unit directions (n, 3): (n,), m."""
        return np.asarray((self.support_points(directions) * directions).sum(axis=1))

    def depth(self, point: FloatArray) -> float:
        """Radius (m) of the largest ball about a point (3,) inside the body; negative outside."""
        x = self.rotation.T @ (point - self.center)
        a, b, c = (float(v) for v in self.size)
        if self.kind == "sphere":
            return a - float(np.linalg.norm(x))
        if self.kind == "capsule":
            return a - float(np.linalg.norm(x - [0.0, 0.0, np.clip(x[2], -b, b)]))
        if self.kind == "cylinder":
            return min(a - float(np.hypot(x[0], x[1])), b - abs(float(x[2])))
        if self.kind == "box":
            return float((np.array([a, b, c]) - np.abs(x)).min())
        if self.kind == "ellipsoid":
            d = sphere_directions(ELLIPSOID_DIRECTIONS)
            return float((np.linalg.norm(d * [a, b, c], axis=1) - d @ x).min())
        return float(-(self.facets[:, :3] @ x + self.facets[:, 3]).max())


def sphere_directions(count: int) -> FloatArray:
    """Unit vectors (count, 3) spread evenly over the sphere by the golden angle."""
    z = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    turn = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    radius = np.sqrt(1.0 - z**2)
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), z])


def cone_directions(axis: FloatArray, half_angle: float, rings: int = 4) -> FloatArray:
    """Unit vectors (n, 3) on rings about a unit axis up to ``half_angle`` (rad), the axis first.

    Symmetric about the axis, so that averages over them keep a body's own symmetry.
    """
    side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    side /= np.linalg.norm(side)
    across = np.cross(axis, side)
    out = [axis]
    for k in range(1, rings + 1):
        angle, count = half_angle * k / rings, 8 * k
        turns = 2 * np.pi * np.arange(count) / count
        ring = np.outer(np.cos(turns), side) + np.outer(np.sin(turns), across)
        out.extend(np.cos(angle) * axis + np.sin(angle) * ring)
    return np.array(out)


END_CONE = np.deg2rad(20.0)
"""Half angle (rad) of the cone about the bone whose support points are averaged into the end, so
that a flat or a lopsided end is met in its middle."""

LEAST_LEVER = 0.5
"""A joint bends the finger if the sine between its axis and the bone is at least this; else it
twists or spreads it."""

ONE_SIDED = 1.25
"""Ratio of the two sides of a joint's range from which on the longer one is the closing side."""

PARALLEL = 0.95
"""Cosine between the axes of two joints above which they bend a finger in one plane."""


class Skeleton:
    """The moving links of an isolated hand: placements at q, geometry by joint.

    Attributes:
        structure: Its bodies and joints.
        pin_model: ``pinocchio.Model``; joint j of the structure is Pinocchio joint j + 1.
        solids: The colliding geometries by Pinocchio joint (0: the base).
        q_lower: (nq,), rad or m.
        q_upper: (nq,).
        neutral: (nq,): zero, or the end of the range nearest to it.
    """

    def __init__(
        self,
        structure: ModelStructure,
        pin_model: Any,
        geometries: tuple[LinkGeometry, ...],
    ) -> None:
        """Sort the geometries by joint."""
        self.structure, self.pin_model = structure, pin_model
        self.solids: dict[int, list[ConvexLink]] = {}
        for g in geometries:
            self.solids.setdefault(g.joint_id, []).append(ConvexLink(g))
        self.q_lower = np.array(pin_model.lowerPositionLimit)
        self.q_upper = np.array(pin_model.upperPositionLimit)
        self.neutral = np.clip(np.zeros(pin_model.nq), self.q_lower, self.q_upper)
        self._data = pin_model.createData()

    def place(self, q: FloatArray) -> list[SE3]:
        """Pose of every Pinocchio joint in the base at q (nq,)."""
        pin.forwardKinematics(self.pin_model, self._data, q)
        return [SE3(pose) for pose in self._data.oMi]

    def axis(self, joint: int) -> FloatArray:
        """Axis (3,) of a joint of the structure, in its own frame: of turning or of sliding."""
        model = self.pin_model.joints[joint + 1]
        data = model.createData()
        model.calc(data, np.zeros(1))
        motion = np.array(data.S).ravel()
        return motion[3:] if self.is_hinge(joint) else motion[:3]

    def is_hinge(self, joint: int) -> bool:
        """Whether a joint of the structure turns."""
        return self.structure.joints[joint].kind == "hinge"


@dataclass(frozen=True, kw_only=True)
class Fingertip:
    """The end of one finger, in the frame of its last joint.

    Attributes:
        joint_id: Pinocchio joint of that frame.
        bone: (3,), unit: from the last joint to the end.
        flexion: (3,), unit, orthogonal to the bone: the way the end moves when the finger closes.
        end: (3,), m: the middle of the end.
        flexion_joint: Number of the joint that bends the end.
        certain: Whether the joint's range decides the sign.
    """

    joint_id: int
    bone: FloatArray
    flexion: FloatArray
    end: FloatArray
    flexion_joint: int
    certain: bool


def fingertip_of(skeleton: Skeleton, branch: Branch, others: FloatArray | None) -> Fingertip | None:
    """Where a finger ends and closes; None if nothing on its last link can touch.

    Args:
        skeleton: The hand.
        branch: The finger.
        others: Middle (3,) of the other fingers' ends in the base, m, if known: it decides the
            closing side of slides and of joints that bend both ways alike.
    """
    last = branch.joints[-1]
    joint_id = last + 1
    solids = skeleton.solids.get(joint_id, [])
    if not solids:
        return None
    poses = skeleton.place(skeleton.neutral)
    bone, end = _bone(skeleton, last, solids, poses)
    for joint in reversed(branch.joints):
        carried = poses[joint_id].inverse() * poses[joint + 1]
        axis = carried.rotation @ skeleton.axis(joint)
        way = np.cross(axis, end - carried.translation) if skeleton.is_hinge(joint) else axis
        way = way - bone * (bone @ way)
        lever = float(np.linalg.norm(np.cross(axis, bone)))
        if lever >= LEAST_LEVER or joint == branch.joints[0]:
            break
    way /= np.linalg.norm(way)
    sign, decides = _closing_side(skeleton, joint)
    for other in reversed(branch.joints):  # a joint that bends both ways closes as those before it
        turn = poses[joint_id].rotation.T @ poses[other + 1].rotation @ skeleton.axis(other)
        if not decides and skeleton.is_hinge(joint) and abs(turn @ axis) > PARALLEL:
            side, decides = _closing_side(skeleton, other)
            sign = side * float(np.sign(turn @ axis))
    if not decides and others is not None:
        toward = poses[joint_id].actInv(others) - end
        sign = 1.0 if toward @ way >= 0 else -1.0
    return Fingertip(
        joint_id=joint_id,
        bone=bone,
        flexion=sign * way,
        end=end,
        flexion_joint=joint,
        certain=decides,
    )


def _closing_side(skeleton: Skeleton, joint: int) -> tuple[float, bool]:
    """Sign of the longer side of a hinge's range, and whether it is clearly longer."""
    low, high = abs(skeleton.q_lower[joint]), abs(skeleton.q_upper[joint])
    clear = skeleton.is_hinge(joint) and max(low, high) > ONE_SIDED * min(low, high)
    return (1.0 if high >= low else -1.0), bool(clear)


def _bone(
    skeleton: Skeleton, last: int, solids: list[ConvexLink], poses: list[SE3]
) -> tuple[FloatArray, FloatArray]:
    """Direction from the last joint to the end of its link, and that end."""
    axis = skeleton.axis(last)
    start = np.zeros(3)
    if not skeleton.is_hinge(last):
        # a sliding finger has no joint to start from: it points away from the palm
        parent = skeleton.pin_model.parents[last + 1]
        start = np.array(poses[last + 1].actInv(poses[parent].translation))
    middle = np.mean([s.center for s in solids], axis=0) - start
    bone = _across(middle, axis)
    end = middle
    for _ in range(4):
        near = cone_directions(bone, END_CONE)
        tips = np.array([s.support_points(near) for s in solids])  # (n_solids, n, 3)
        furthest = np.argmax((tips * near).sum(axis=2), axis=0)
        end = tips[furthest, np.arange(len(near))].mean(axis=0)
        bone = _across(end - start, axis)
    reach = max(float(s.support(bone[None])[0]) for s in solids)
    return bone, end + bone * (reach - bone @ end)


def _across(v: FloatArray, axis: FloatArray) -> FloatArray:
    """Unit vector of the part of v orthogonal to an axis; of v itself where that is zero."""
    flat = v - axis * (axis @ v)
    flat = flat if np.linalg.norm(flat) > 1e-6 else v
    length = float(np.linalg.norm(flat))
    return flat / length if length > 1e-9 else np.array([0.0, 0.0, 1.0])
