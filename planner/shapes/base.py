"""Interface of all shapes: distances, mass properties, and their form in coal and in MuJoCo.

With it, what shapes share: nearest points of solids with smooth faces, checks of sizes, and smooth
patches of a surface, for contact synthesis.

A contact point is a decision variable that lies exactly on the true surface. Edges need no
rounding, because the surface is cut along them into smooth patches (the faces of a box; side and
ends of a cylinder), each finger is assigned to one patch, and the point keeps a margin from the
patch's rim. The assignment enters the problem as numbers (``Patch.code``, bounds of the point), so
one problem per hand and kind of shape serves every size and every assignment.

``Surface.clearance`` is used for links that must stay away. It is exact for spheres and capsules;
the largest of the face distances, softened over ``SOFTNESS``, for boxes and cylinders, which for
balls of 8 mm or more is within 0.08 mm of a lower bound of the true distance (the worst is straight
above a box's corner); first-order accurate for ellipsoids. The verdict is always on the true
geometry, see ``planner.verification``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, Self

import casadi as ca
import numpy as np

from planner.arrays import checked_number, float_array
from planner.errors import ObjectError, shown
from planner.shapes.hulls import StablePose
from planner.spatial import SE3, FloatArray

SOFTNESS = 0.002
"""Length (m) over which the largest of several face distances is softened."""

EDGE_MARGIN = 0.004
"""Distance (m) that a contact keeps from the rim of its patch: a fingertip that rolls or creeps by
a few millimetres must not reach the edge. At most a quarter of the patch's half width."""

KEPT = 16
"""Shapes whose patches a surface keeps: every start asks for them."""

SIZE_DIM = 3
"""Numbers that describe a shape's size in the synthesis problem."""

CODE_DIM = 3
"""Numbers that say which patch a finger touches."""


@dataclass(frozen=True, kw_only=True)
class Patch:
    """A smooth part of a surface.

    Attributes:
        name: For people, for example "+x".
        code: (3,), which patch, as numbers for the problem.
        lower: (3,), lower bounds of a contact point in the object's frame, m.
        upper: (3,), upper bounds.
    """

    name: str
    code: FloatArray
    lower: FloatArray
    upper: FloatArray


class Surface(ABC):
    """One kind of shape in the synthesis problem; expressions are in the object's frame, m."""

    kind: ClassVar[str]
    field: Any = None
    """The ``FieldPoints`` where expressions need a distance field; None where they are formulas."""
    normal_error: float = 0.0
    """How far (rad) ``outward_normal`` may be from the true one; pads keep that from their rim."""
    distance_error: float = 0.0
    """How far (m) ``clearance`` may be from the true one; links keep that much more away."""

    def field_of(self, shape: Any) -> Any:
        """The distance field of a shape, where ``field`` is not None."""
        return None

    @abstractmethod
    def size(self, shape: Any) -> FloatArray:
        """Parameters (3,) of the problem for a shape's size, m."""

    def skin(self, size: Any) -> Any:
        """How far in front of the true surface contact points are looked for, m.

        Pads are shorter by as much.

        Args:
            size: Of the shape, see ``size``: numbers or symbols.
        """
        return 0.0

    @abstractmethod
    def patches(self, shape: Any) -> tuple[Patch, ...]:
        """The patches of a shape."""

    @abstractmethod
    def patch_at(self, shape: Any, point: FloatArray, normal: FloatArray) -> Patch:
        """The patch to which a surface point with this outward normal belongs."""

    @abstractmethod
    def outward_normal(self, size: Any, code: Any, p: Any) -> Any:
        """Outward unit normal (3,) at a point of the patch."""

    @abstractmethod
    def surface_error(self, size: Any, code: Any, p: Any) -> Any:
        """Zero on the patch; m near it. None where the bounds of the patch fix the point."""

    def flatness(self, size: Any, p: Any) -> Any:
        """At least 0 (-) at a contact off edges; None where patches keep contacts off them."""
        return None

    @abstractmethod
    def clearance(self, size: Any, c: Any) -> Any:
        """Smooth signed distance of a point from the surface, m, for avoidance."""


def soft_norm(*parts: Any) -> Any:
    """Euclidean norm, differentiable at 0; 1e-6 there."""
    return ca.sqrt(sum(v * v for v in parts) + 1e-12)


def soft_max(*values: Any) -> Any:
    """Maximum, softened over ``SOFTNESS``; never less than it."""
    top = ca.fmax(values[0], values[1])
    for v in values[2:]:
        top = ca.fmax(top, v)
    # log-sum-exp; shifting by the maximum keeps the exponentials finite and changes nothing
    return top + SOFTNESS * ca.log(sum(ca.exp((v - top) / SOFTNESS) for v in values))


def box_clearance(half: Any, c: Any) -> Any:
    """Smooth distance (m) of a point (3,) from a box of half extents ``half`` at the origin."""
    return soft_max(*(soft_norm(c[k]) - half[k] for k in range(3)))


def edge_margin(half: float) -> float:
    """Distance (m) from the rim that contacts keep on a patch of half width ``half`` (m)."""
    return min(EDGE_MARGIN, half / 4)


def whole_surface(name: str, reach: FloatArray) -> Patch:
    """The patch of a surface without edges, in a box of half extents ``reach`` (3,), m."""
    return Patch(name=name, code=np.zeros(CODE_DIM), lower=-reach, upper=reach)


class WholeSurface(Surface):
    """Base of a surface without edges: one patch."""

    def patches(self, shape: Any) -> tuple[Patch, ...]:
        """See ``Surface``."""
        return _whole(self.kind, shape)

    def patch_at(self, shape: Any, point: FloatArray, normal: FloatArray) -> Patch:
        """See ``Surface``."""
        return self.patches(shape)[0]


@lru_cache(maxsize=2 * KEPT)
def _whole(kind: str, shape: Any) -> tuple[Patch, ...]:
    return (whole_surface(kind, 2 * shape.half_extents),)


ON_SURFACE = 1e-12
"""Points nearer than this (m) to the surface take the normal of the nearest face: the direction
from the surface point would be rounding noise."""

NO_LENGTH = 1e-15
"""Vectors shorter than this (m) have no direction: rounding of a point on a centre or an axis."""


def sign(values: FloatArray) -> FloatArray:
    """-1 where negative, else 1, of any shape."""
    return np.where(values < 0, -1.0, 1.0)


def unit(vectors: FloatArray) -> FloatArray:
    """Unit vectors (n, 3) of vectors (n, 3); +x where a vector has no length."""
    v = np.array(vectors, dtype=np.float64)
    length = np.linalg.norm(v, axis=1, keepdims=True)
    flat = length[:, 0] < NO_LENGTH
    v[flat], length[flat] = [1.0, 0.0, 0.0], 1.0
    out: FloatArray = v / length
    return out


def nearest_of_faces(
    points: FloatArray,
    clamped: FloatArray,
    depths: FloatArray,
    face_points: FloatArray,
    face_normals: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Nearest surface points of a convex solid with smooth faces and sharp edges.

    Args:
        points: (n, 3), m.
        clamped: The points of the solid nearest to ``points``, (n, 3), m.
        depths: How far each point is below each of k faces, (n, k), m.
        face_points: Each point moved onto each face, (n, k, 3), m.
        face_normals: Outward unit normals there, (n, k, 3).

    Returns:
        Surface points (n, 3) and outward normals (n, 3): from ``clamped`` for points outside, of
        the least deep face inside.
    """
    gap = points - clamped
    distance = np.linalg.norm(gap, axis=1)
    row, face = np.arange(len(points)), np.argmin(depths, axis=1)
    surface, normal = face_points[row, face], face_normals[row, face]
    outside = distance > ON_SURFACE
    surface[outside] = clamped[outside]
    normal[outside] = gap[outside] / distance[outside, None]
    return surface, normal


def nearest_on_cylinder(
    points: FloatArray, radius: float, half_height: float
) -> tuple[FloatArray, FloatArray]:
    """Nearest surface points (n, 3) and outward normals (n, 3) of a cylinder about z.

    Args:
        points: (n, 3), m, in the cylinder's frame.
        radius: m.
        half_height: Half of the full height, m.
    """
    radial = np.hypot(points[:, 0], points[:, 1])
    out = unit(np.column_stack([points[:, :2], np.zeros(len(points))]))
    axis = np.zeros_like(points)
    axis[:, 2] = sign(points[:, 2])
    clamped = out * np.minimum(radial, radius)[:, None]
    clamped[:, 2] = np.clip(points[:, 2], -half_height, half_height)
    side, end = out * radius, points.copy()
    side[:, 2] = points[:, 2]
    end[:, 2] = half_height * axis[:, 2]
    return nearest_of_faces(
        points,
        clamped,
        np.column_stack([radius - radial, half_height - np.abs(points[:, 2])]),
        np.stack([side, end], axis=1),
        np.stack([out, axis], axis=1),
    )


LARGEST = 2.0
"""Largest accepted size (m): more is too large to grasp, or was given in millimetres."""

ALIGNED = 1e-9
"""Components of a normal below this (-) count as zero."""

SMALLEST = 1e-4
"""Smallest accepted size (m): the thickness of a sheet of paper."""


class Shape(ABC):
    """A solid of uniform density; the origin of its frame is its centre of mass.

    Lengths are in m, points and directions in the shape's frame. Symmetry axes are along z.

    A new primitive is one file: a subclass with its ``surface``, and ``register_shape``.

    Attributes:
        kind: Name of the kind, for example "box".
        size_names: Names of the numbers of a specification, in its order.
        pure_numbers: Those of ``size_names`` that are numbers, not lengths.
        default_sizes: The numbers of a specification that is the name alone.
        convex: Whether every shape of this kind is; a mesh need not be.
        turns_tips: Whether a fingertip has to turn with the object all the way when it is turned
            in the hand: on a face, or on a ball, where a tip that does not turn with it pivots,
            against torsional friction. On a side that is round about z the contact may wander.
        ball_like: Whether it is round in every direction: contacts below or above the equator make
            tips pivot when the object is turned.
    """

    kind: ClassVar[str]
    size_names: ClassVar[tuple[str, ...]]
    pure_numbers: ClassVar[tuple[str, ...]] = ()
    default_sizes: ClassVar[tuple[float, ...]]
    convex: ClassVar[bool] = True
    turns_tips: ClassVar[bool] = True
    ball_like: ClassVar[bool] = False

    @classmethod
    def from_sizes(cls, sizes: Sequence[float]) -> Self:
        """A shape from the numbers of its specification, m, in the order of ``size_names``."""
        make: Any = cls
        shape: Self = make(*sizes)
        return shape

    @classmethod
    def form(cls) -> str:
        """How a specification is written, for example "cylinder:RADIUSxHEIGHT"."""
        return f"{cls.kind}:" + "x".join(name.upper() for name in cls.size_names)

    @property
    @abstractmethod
    def sizes(self) -> tuple[float, ...]:
        """The numbers of the specification, m, in the order of ``size_names``."""

    @property
    def spec(self) -> str:
        """The specification that ``parse_object`` reads, for example "box:0.05x0.05x0.08".

        Every digit is kept: the shape read back is equal to this one.
        """
        return sized_spec(self.kind, self.sizes)

    @property
    @abstractmethod
    def half_extents(self) -> FloatArray:
        """Half extents (3,) of the smallest box about the centre, in its axes, m."""

    @property
    @abstractmethod
    def bounding_radius(self) -> float:
        """Radius of the smallest ball about the centre of mass that contains the shape, m."""

    @property
    @abstractmethod
    def volume(self) -> float:
        """Volume, m3."""

    @abstractmethod
    def inertia(self, mass: float) -> FloatArray:
        """Inertia (3, 3) about the centre of mass in the shape's axes, kg m2, for a mass in kg."""

    @abstractmethod
    def coal_geometry(self) -> Any:
        """The same solid in coal. Keep a reference: coal's functors hold none."""

    def mujoco_geom(self) -> tuple[str, tuple[float, ...]] | None:
        """MuJoCo's geom type and size: half lengths and radii, m; plain data, one to three.

        None where MuJoCo has no such geom: there a convex shape is the hull of its surface.
        """
        return None

    def surface(self) -> Surface:
        """Its smooth patches in the synthesis problem; the same object for all of its kind.

        Raises:
            ObjectError: Synthesis cannot plan contacts on this kind of shape.
        """
        raise ObjectError(
            f"cannot plan on a {self.kind!r}: it has no contact patches; override Shape.surface, "
            "or give the object as a mesh"
        )

    @property
    def flat_sides(self) -> FloatArray | None:
        """Outward normals (m, 3) of the faces where all sides are flat; None where one is round.

        Opposed contacts need opposed faces there.
        """
        return None

    def curvature_and_edges(
        self, points: FloatArray, normals: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Least radius of curvature (n,) and distance to the nearest edge (n,), m, at points.

        Both may be infinite. 0 and infinite where nothing is known, as here.

        Args:
            points: Surface points (n, 3), m.
            normals: Outward unit normals (n, 3) there.
        """
        n = len(points)
        return np.zeros(n), np.full(n, np.inf)

    def normal_dispersion(
        self, points: FloatArray, radius: float, *, facing: FloatArray | None = None
    ) -> FloatArray:
        """How much the outward normals around contacts differ (n,), rad: large on an edge.

        0 where patches keep contacts off edges (``surface``), as here.

        Args:
            points: Surface points (n, 3), m.
            radius: How far around them, m.
            facing: Outward normals (n, 3) at the points; normals of an opposite side do not count.
        """
        return np.zeros(len(points))

    @abstractmethod
    def closest_point(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Nearest surface points and outward normals.

        Where several surface points are equally near (a centre, an axis), one of them is returned.

        Args:
            points: (n, 3), m; inside or outside.

        Returns:
            Surface points (n, 3), m, and outward unit normals (n, 3). For a point outside, the
            normal is the direction from surface point to point, at edges and corners too.

        Raises:
            ObjectError: The points are not finite or not of shape (n, 3).
        """

    def signed_distance(self, points: FloatArray) -> FloatArray:
        """Exact signed distance (n,) in m of points (n, 3): positive outside, negative inside.

        Raises:
            ObjectError: The points are not finite or not of shape (n, 3).
        """
        surface, normals = self.closest_point(points)
        distance: FloatArray = np.einsum("ij,ij->i", checked_points(points) - surface, normals)
        return distance

    @abstractmethod
    def support(self, direction: FloatArray) -> float:
        """Largest coordinate (m) of the solid along a unit direction (3,)."""

    @property
    def resting_rotation(self) -> FloatArray:
        """Rotation (3, 3) world from object of a stable pose on a horizontal table."""
        return np.eye(3)

    def resting_poses(self) -> tuple[StablePose, ...]:
        """Stable poses on a horizontal table, the preferred one first; one for most primitives."""
        rotation = self.resting_rotation
        return (StablePose(rotation=rotation, height=self.support(-rotation[2])),)

    def resting_pose(self, table_height: float = 0.0, index: int = 0) -> SE3:
        """``T_world_object`` of a stable pose on a table, above the world's origin.

        Args:
            table_height: z of the table's top, m.
            index: Which of ``resting_poses``.

        Raises:
            ObjectError: There is no such pose.
        """
        poses = self.resting_poses()
        if not 0 <= index < len(poses):
            raise ObjectError(
                f"{self.kind} has {len(poses)} stable pose(s), 0 to {len(poses) - 1}; there is no "
                f"pose {index}"
            )
        rotation = poses[index].rotation
        height = self.support(-rotation[2])
        return SE3(rotation, np.array([0.0, 0.0, table_height + height]))


class Boxed(Shape):
    """Base of a frozen dataclass whose field ``size`` holds its full extents x, y, z, m."""

    size_names: ClassVar[tuple[str, ...]] = ("x", "y", "z")

    size: tuple[float, float, float]

    def __post_init__(self) -> None:
        """Check the sizes."""
        object.__setattr__(self, "size", checked_extents(self.kind, self.size))

    @classmethod
    def from_sizes(cls, sizes: Sequence[float]) -> Self:
        """From x, y, z."""
        make: Any = cls
        shape: Self = make(tuple(sizes))
        return shape

    @property
    def sizes(self) -> tuple[float, ...]:
        """Full extents, m."""
        return self.size

    @property
    def half_extents(self) -> FloatArray:
        """Half the full extents, (3,), m."""
        return np.array(self.size) / 2


class Sized:
    """Base, before ``Shape`` or ``Mesh``, of a frozen dataclass whose fields are its sizes.

    The fields are in the order of ``size_names``; lengths are checked, and are floats.
    """

    kind: ClassVar[str]
    size_names: ClassVar[tuple[str, ...]]
    pure_numbers: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        """Check the sizes."""
        for name in self.size_names:
            if name not in self.pure_numbers:
                value = checked_length(self.kind, name, getattr(self, name))
                object.__setattr__(self, name, value)
        self._check()

    def _check(self) -> None:
        """Whether the sizes fit each other; ObjectError if not."""

    @classmethod
    def from_sizes(cls, sizes: Sequence[float]) -> Self:
        """From the numbers of the specification."""
        make: Any = cls
        shape: Self = make(*sizes)
        return shape

    @property
    def sizes(self) -> tuple[float, ...]:
        """The numbers of the specification, m."""
        return tuple(getattr(self, name) for name in self.size_names)

    @property
    def spec(self) -> str:
        """See ``Shape``."""
        return sized_spec(self.kind, self.sizes)


def sized_spec(kind: str, sizes: Sequence[float]) -> str:
    """The specification of a kind and sizes (m) with every digit: "box:0.05x0.05x0.08"."""
    return f"{kind}:" + "x".join(repr(v) for v in sizes)


def checked_length(kind: str, name: str, value: object) -> float:
    """A size in m as a float.

    Args:
        kind: Kind of shape, for the message.
        name: Name of the size, for the message.
        value: What was given.

    Raises:
        ObjectError: Not a number, not finite, not positive, or out of range.
    """
    length = checked_number(f"{kind}: {name}", value, above=0.0, unit="m", error=ObjectError)
    if length > LARGEST:
        raise ObjectError(
            f"{kind}: {name} is {length} m, more than {LARGEST} m; sizes are in metres, was it "
            "given in millimetres by mistake?"
        )
    if length < SMALLEST:
        raise ObjectError(
            f"{kind}: {name} is {length} m, less than {SMALLEST} m; sizes are in metres, give more"
        )
    return length


def checked_extents(kind: str, size: object) -> tuple[float, float, float]:
    """Full extents x, y, z in m as floats.

    Args:
        kind: Kind of shape, for the message.
        size: What was given.

    Raises:
        ObjectError: Not three numbers, or one of them is refused by ``checked_length``.
    """
    if isinstance(size, str) or not isinstance(size, Sequence | np.ndarray) or len(size) != 3:
        raise ObjectError(
            f"{kind}: size is {shown(size)}; give three full extents x, y, z in metres"
        )
    x, y, z = (checked_length(kind, name, v) for name, v in zip("xyz", size, strict=True))
    return x, y, z


def checked_points(points: FloatArray) -> FloatArray:
    """Points (n, 3) as float64; a single point (3,) becomes (1, 3).

    Raises:
        ObjectError: No numbers, another shape, NaN or infinity.
    """
    p = np.atleast_2d(float_array("points", points, error=ObjectError))
    if p.ndim != 2 or p.shape[1] != 3:
        raise ObjectError(f"points have shape {p.shape}; give an array of shape (n, 3), in metres")
    if not np.isfinite(p).all():
        raise ObjectError("points hold NaN or infinity; give finite coordinates in metres")
    return p
