"""Objects to grasp: a shape and a mass, by name, by specification, by file or by parameters.

    sphere:RADIUS   box:XxYxZ   cylinder:RADIUSxHEIGHT   capsule:RADIUSxHEIGHT   ellipsoid:XxYxZ
    mug:RADIUSxHEIGHT   lbracket:LENGTHxHEIGHTxWIDTHxTHICKNESS   torus:RINGxTUBE
    hammer:LENGTHxHEADxRADIUS   superquadric:XxYxZxE1xE2   knot:RADIUSxTUBE
    FILE.stl   FILE.obj*SCALE   FILE.xml#BODY

All in metres; X, Y, Z and HEIGHT are full lengths, end to end. A name alone has default sizes; mug
and hammer are meshes of ``models/objects``, scaled along their axes to others. A mesh file (GLB,
OBJ, PLY, STL) is in metres unless a scale says how many metres its unit is.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from planner.arrays import checked_number
from planner.bridge.object_body import object_body
from planner.errors import NotFoundError, ObjectError
from planner.regions import TouchRegion
from planner.shapes import SIZED_SHAPES, Mesh, Shape
from planner.shapes.meshes.io import CONVERTIBLE, MESH_SUFFIXES
from planner.spatial import SE3

__all__ = ["DEFAULT_MASS", "GraspObject", "object_names", "parse_object"]

DEFAULT_MASS = 0.1
"""Mass (kg) of an object for which neither mass nor density is given."""

HEAVIEST = 100.0
"""Largest accepted mass (kg): more is too heavy to lift, or was given in grams."""

_MESH_FILE = re.compile(
    rf"(.*(?:{'|'.join(re.escape(s) for s in (*MESH_SUFFIXES, *CONVERTIBLE))}))(?:\*(.*))?", re.I
)
_MODEL_BODY = re.compile(r"(.*\.(?:xml|mjcf|urdf))#(.*)", re.I)


@dataclass(frozen=True, kw_only=True)
class GraspObject:
    """A rigid object of uniform density.

    Attributes:
        name: What to call it.
        shape: Its shape; the origin is its centre of mass.
        mass: kg.
        touch: Where it may and must be touched; anywhere if None.
    """

    name: str
    shape: Shape
    mass: float = DEFAULT_MASS
    touch: TouchRegion | None = None

    def __post_init__(self) -> None:
        """Check the mass."""
        mass = _positive(f"{self.name}: mass", self.mass, "kg")
        if mass > HEAVIEST:
            raise ObjectError(
                f"{self.name}: mass is {mass:.6g} kg, more than {HEAVIEST:g} kg; masses are in kg "
                "and densities in kg/m3, was it given in grams by mistake?"
            )
        object.__setattr__(self, "mass", mass)

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


def _parse_shape(spec: str, repair: bool, strict: bool) -> tuple[str, Shape, float]:
    """Name, shape, and mass (kg) if nothing else is said."""
    mesh = _MESH_FILE.fullmatch(spec)
    if mesh:
        path = Path(mesh[1])
        scale = _scale(spec, mesh[2])
        loaded = Mesh.load(path, scale=scale, repair=repair, strict=strict)
        return path.stem, loaded, DEFAULT_MASS
    model = _MODEL_BODY.fullmatch(spec)
    if model:
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
