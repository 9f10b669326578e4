"""Objects to grasp: a shape and a mass, by name, by specification, by file or by parameters.

    sphere:RADIUS   box:XxYxZ   cylinder:RADIUSxHEIGHT   capsule:RADIUSxHEIGHT   ellipsoid:XxYxZ
    mug:RADIUSxHEIGHT   lbracket:LENGTHxHEIGHTxWIDTHxTHICKNESS   torus:RINGxTUBE
    hammer:LENGTHxHEADxRADIUS   superquadric:XxYxZxE1xE2   knot:RADIUSxTUBE
    cup, teacup, bowl, pan, plate, tube:RADIUSxHEIGHTxWALL   channel:LENGTHxHEIGHTxWIDTHxTHICKNESS
    tray:LENGTHxWIDTHxHEIGHTxTHICKNESS
    FILE.stl   FILE.obj*SCALE   FILE.xml#BODY

All in metres; X, Y, Z and HEIGHT are full lengths, end to end. A name alone has default sizes; mug
and hammer are meshes of ``models/objects``, scaled along their axes to others. A mesh file (GLB,
OBJ, PLY, STL) is in metres unless a scale says how many metres its unit is.

A ``TouchRegion`` says where one may, must not, or must be touched. Regions are boxes in the
object's frame, whose origin is the centre of mass; a half-space is a box with infinite bounds.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from planner.arrays import checked_number, finite_array
from planner.errors import NotFoundError, ObjectError, shown
from planner.shapes import SIZED_SHAPES, Mesh, Shape
from planner.spatial import SE3, FloatArray

if TYPE_CHECKING:
    from planner.clouds.belief import Belief

__all__ = [
    "DEFAULT_MASS",
    "GraspObject",
    "NeededWrench",
    "Region",
    "TouchRegion",
    "object_names",
    "parse_object",
    "parse_region",
]


@dataclass(frozen=True, kw_only=True)
class Region:
    """A box in the object's frame.

    Attributes:
        name: What to call it in messages.
        lower: Lower corner (3,), m; -inf where it has no bound.
        upper: Upper corner (3,), m; inf where it has no bound.
    """

    name: str
    lower: tuple[float, float, float] = (-np.inf, -np.inf, -np.inf)
    upper: tuple[float, float, float] = (np.inf, np.inf, np.inf)

    def __post_init__(self) -> None:
        """Check the corners."""
        for which in ("lower", "upper"):
            corner = _corner(f"region {self.name!r}", which, getattr(self, which))
            object.__setattr__(self, which, corner)
        if not (np.array(self.lower) < np.array(self.upper)).all():
            raise ObjectError(
                f"region {self.name!r} runs from {self.lower} to {self.upper}; give lower < upper "
                "along every axis, in m"
            )

    def contains(self, points: FloatArray) -> NDArray[np.bool_]:
        """Whether each point (n, 3), m, is in the region, (n,) bool."""
        p = np.asarray(points, dtype=np.float64)
        return np.asarray(((p >= self.lower) & (p <= self.upper)).all(axis=1))


@dataclass(frozen=True, kw_only=True)
class TouchRegion:
    """Where fingers may touch an object.

    Attributes:
        allowed: Contacts lie in one of these; everywhere if empty.
        forbidden: Contacts lie in none of these.
        required: By finger, the region that its contact lies in.
    """

    allowed: tuple[Region, ...] = ()
    forbidden: tuple[Region, ...] = ()
    required: Mapping[str, Region] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Freeze the mapping and check that no region is both allowed and forbidden."""
        object.__setattr__(self, "allowed", tuple(self.allowed))
        object.__setattr__(self, "forbidden", tuple(self.forbidden))
        object.__setattr__(self, "required", MappingProxyType(dict(self.required)))
        both = {r.name for r in self.allowed} & {r.name for r in self.forbidden}
        if both:
            raise ObjectError(f"regions {sorted(both)} are both allowed and forbidden; give one")

    def permits(self, points: FloatArray, fingers: Sequence[str] = ()) -> NDArray[np.bool_]:
        """Whether each contact may be where it is, (n,) bool.

        Args:
            points: Contacts (n, 3) in the object's frame, m.
            fingers: Their fingers (n,); without them, what is required of fingers is not asked.
        """
        p = np.asarray(points, dtype=np.float64)
        good = np.ones(len(p), dtype=bool)
        if self.allowed:
            good &= np.any(np.array([region.contains(p) for region in self.allowed]), axis=0)
        for region in self.forbidden:
            good &= ~region.contains(p)
        for i, finger in enumerate(fingers):
            if finger in self.required:
                good[i] &= bool(self.required[finger].contains(p[i : i + 1])[0])
        return good


def parse_region(text: str) -> Region:
    """A region from text such as "z>0.01" or "z>0.01,x<0.02": bounds in the object's frame, m.

    Raises:
        ObjectError: Not of that form, or empty.
    """
    lower, upper = np.full(3, -np.inf), np.full(3, np.inf)
    for part in text.split(","):
        found = _BOUND.fullmatch(part.strip())
        if found is None:
            raise ObjectError(
                f"region {text!r}: {part.strip()!r} is no bound; write an axis, < or >, and metres "
                'from the centre of mass: "z>0.01", several with commas: "z>0.01,x<0.02"'
            )
        axis, value = "xyz".index(found[1]), float(found[3])
        if found[2] == ">":
            lower[axis] = max(lower[axis], value)
        else:
            upper[axis] = min(upper[axis], value)
    (a, b, c), (d, e, f) = lower.tolist(), upper.tolist()
    return Region(name=text, lower=(a, b, c), upper=(d, e, f))


_BOUND = re.compile(r"([xyz])\s*([<>])\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)")


def _corner(what: str, which: str, values: object) -> tuple[float, float, float]:
    try:
        corner = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        corner = np.empty(0)
    if corner.shape != (3,) or np.isnan(corner).any():
        raise ObjectError(f"{what}: {which} is {shown(values)}; give three numbers x, y, z in m")
    x, y, z = (float(v) for v in corner)
    return x, y, z


@dataclass(frozen=True, kw_only=True)
class NeededWrench:
    """A wrench that the hand must be able to produce on an object, beside holding it.

    Attributes:
        name: What it is for, in messages.
        force: (3,), N, object frame.
        torque: (3,), about the centre of mass, N m, object frame.
    """

    name: str
    force: tuple[float, float, float] = (0.0, 0.0, 0.0)
    torque: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        """Check the numbers."""
        for which in ("force", "torque"):
            what = f"needed wrench {shown(self.name)}: {which}"
            given = finite_array(what, getattr(self, which), (3,), error=ObjectError)
            object.__setattr__(self, which, tuple(given.tolist()))
        if not any((*self.force, *self.torque)):
            raise ObjectError(f"needed wrench {self.name!r} is zero; give a force or a torque")

    @property
    def wrench(self) -> FloatArray:
        """Force and torque (6,), N and N m, object frame."""
        return np.array([*self.force, *self.torque])


DEFAULT_MASS = 0.1
"""Mass (kg) of an object for which neither mass nor density is given."""

HEAVIEST = 100.0
"""Largest accepted mass (kg): more is too heavy to lift, or was given in grams."""

_MODEL_BODY = re.compile(r"(.*\.(?:xml|mjcf|urdf))#(.*)", re.I)


@dataclass(frozen=True, kw_only=True)
class GraspObject:
    """A rigid object of uniform density.

    Attributes:
        name: What to call it.
        shape: Its shape; the origin is its centre of mass.
        mass: kg.
        touch: Where it may and must be touched; anywhere if None.
        belief: What is known of its surface, where cameras saw only a part of it: fingers touch
            where that is certain enough. None where the shape is known. A plan file keeps the shape
            alone.
    """

    name: str
    shape: Shape
    mass: float = DEFAULT_MASS
    touch: TouchRegion | None = None
    belief: Belief | None = None

    def __post_init__(self) -> None:
        """Check the mass."""
        mass = _positive(f"{self.name}: mass", self.mass, "kg")
        if mass > HEAVIEST:
            raise ObjectError(
                f"{self.name}: mass is {mass:.6g} kg, more than {HEAVIEST:g} kg; masses are in kg "
                "and densities in kg/m3, was it given in grams by mistake?"
            )
        object.__setattr__(self, "mass", mass)

    @classmethod
    def from_points(
        cls,
        points: Any,
        normals: Any = None,
        *,
        name: str = "cloud",
        mass: float = DEFAULT_MASS,
        **seen: Any,
    ) -> GraspObject:
        """The most plausible object behind points that cameras saw, with what is known of it.

        Its axes are those of the points; ``belief.T_world_object`` is where it is among them.

        Args:
            points: (n, 3), m, z up; or a ``planner.clouds.cloud.PointCloud``, which goes alone.
            normals: (n, 3), outward; estimated if None.
            name: What to call it.
            mass: kg; no camera tells it.
            **seen: ``views``, ``view_of``, ``noise``, ``table``, ``past`` and ``past_of`` of
                ``PointCloud.create``.

        Raises:
            ObjectError: A cloud that is not usable; says why and what to do.
        """
        from planner.clouds.belief import Belief
        from planner.clouds.cloud import PointCloud

        if not isinstance(points, PointCloud):
            points = PointCloud.create(points, normals=normals, **seen)
        elif normals is not None or seen:
            raise ObjectError("a PointCloud has its normals and views; give nothing beside it")
        belief, mesh = Belief.of(points).of_hypothesis(0)
        return cls(name=name, shape=mesh, mass=mass, belief=belief)

    def permits(self, points: FloatArray, fingers: Sequence[str] = ()) -> NDArray[np.bool_]:
        """Whether each contact may be where it is, (n,) bool: by ``touch`` and ``belief``.

        Args:
            points: Contacts (n, 3) in the object's frame, m.
            fingers: Their fingers (n,); without them, what is required of fingers is not asked.
        """
        good = np.ones(len(points), dtype=bool)
        if self.touch is not None:
            good &= self.touch.permits(points, fingers)
        if self.belief is not None:
            good &= self.belief.certain(points)
        return good

    @property
    def mended(self) -> str:
        """What was mended of its mesh and how far that moved the surface; "" if nothing was."""
        return self.shape.mended if isinstance(self.shape, Mesh) else ""

    def resting_pose(self, table_height: float = 0.0, index: int = 0) -> SE3:
        """``T_world_object`` where it stands on a table, above the world's origin.

        Args:
            table_height: z of the table's top, m.
            index: Which of the shape's stable poses.

        Raises:
            ObjectError: The shape has no stable pose of that number.
        """
        return self.shape.resting_pose(table_height, index)


def object_names() -> tuple[str, ...]:
    """Names that ``parse_object`` knows."""
    return tuple(SIZED_SHAPES)


def parse_object(
    spec: str,
    *,
    mass: float | None = None,
    density: float | None = None,
    repair: bool = False,
    strict: bool = False,
    touch: TouchRegion | None = None,
) -> GraspObject:
    """An object from a specification such as "box", "torus:0.04x0.012" or "mug.stl*0.001".

    Args:
        spec: Name, name and sizes in m, mesh file, or model file and body; see the module.
        mass: kg; if neither it nor a density is given, that of the model for a body of a model,
            else ``DEFAULT_MASS``.
        density: kg/m3; give this or ``mass``, not both.
        repair: Whether to mend a mesh that bounds no solid however much that changes; what changes
            nothing that matters is mended anyway, and ``shape.mended`` says so.
        strict: Whether to refuse a mesh that would have to be mended.
        touch: Where it may and must be touched.

    Raises:
        NotFoundError: Unknown name or body.
        ModelError: A model file that cannot be read.
        ObjectError: Wrong number of sizes, not numbers, out of range, a mesh that is missing or
            bounds no solid, or mass and density given.
    """
    if mass is not None and density is not None:
        raise ObjectError(
            f"{spec!r}: mass {mass} kg and density {density} kg/m3 are both given; give one of them"
        )
    name, shape, own_mass = _parse_shape(spec.strip(), repair, strict)
    if density is not None:
        mass = _positive(f"{name}: density", density, "kg/m3") * shape.volume
    elif mass is None:
        mass = own_mass
    return GraspObject(name=name, shape=shape, mass=mass, touch=touch)


@cache
def _mesh_file() -> re.Pattern[str]:
    """A mesh file and its scale."""
    from planner.shapes.meshes.io import CONVERTIBLE, MESH_SUFFIXES

    suffixes = "|".join(re.escape(s) for s in (*MESH_SUFFIXES, *CONVERTIBLE))
    return re.compile(rf"(.*(?:{suffixes}))(?:\*(.*))?", re.I)


def _parse_shape(spec: str, repair: bool, strict: bool) -> tuple[str, Shape, float]:
    """Name, shape, and mass (kg) if nothing else is said."""
    mesh = _mesh_file().fullmatch(spec)
    if mesh:
        path = Path(mesh[1])
        scale = _scale(spec, mesh[2])
        loaded = Mesh.load(path, scale=scale, repair=repair, strict=strict)
        return path.stem, loaded, DEFAULT_MASS
    model = _MODEL_BODY.fullmatch(spec)
    if model:
        from planner.bridge.object_body import object_body  # here: few objects are models' bodies

        body = object_body(Path(model[1]), model[2], repair=repair, strict=strict)
        return model[2], body.shape, body.mass if body.mass > 0 else DEFAULT_MASS
    kind, colon, numbers = spec.lower().partition(":")
    kind = kind.strip()
    if kind not in SIZED_SHAPES:
        hint = (
            "Sizes follow a colon, in metres: box:0.05x0.05x0.08. A mesh is the path of a GLB, "
            "OBJ, PLY or STL file: mug.stl, or mug.stl*0.001 if in millimetres."
        )
        raise NotFoundError("object", kind, object_names(), hint)
    shape = SIZED_SHAPES[kind]
    sizes = _parse_sizes(spec, numbers, shape) if colon else shape.default_sizes
    return kind, shape.from_sizes(sizes), DEFAULT_MASS


def _scale(spec: str, text: str | None) -> float:
    if text is None:
        return 1.0
    try:
        return float(text)
    except ValueError:
        raise ObjectError(
            f"{spec!r}: scale {text!r} is not a number; give metres per unit of the file, for "
            "example *0.001 for millimetres"
        ) from None


def _parse_sizes(spec: str, text: str, shape: type[Shape]) -> tuple[float, ...]:
    try:
        values = tuple(float(part) for part in text.split("x"))
    except ValueError:
        raise ObjectError(
            f"{spec!r}: {text!r} is not numbers separated by x; write {shape.form()} in metres"
        ) from None
    needed = len(shape.size_names)
    if len(values) != needed:
        raise ObjectError(
            f"{spec!r} has {len(values)} size(s); {shape.form()} needs {needed}, in metres"
        )
    return values


def _positive(what: str, value: object, unit: str) -> float:
    return checked_number(what, value, above=0.0, unit=unit, error=ObjectError)
