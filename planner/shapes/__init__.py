"""Shapes that can be grasped. The origin of every shape is its centre of mass."""

from typing import TYPE_CHECKING

from planner.shapes.base import Shape
from planner.shapes.box import Box
from planner.shapes.hulls import StablePose
from planner.shapes.mesh import Mesh
from planner.shapes.registry import (
    SIZED_SHAPES,
    register_shape,
    shape_from_dict,
    shape_key,
    shape_to_dict,
)
from planner.system.package import lazy_names

if TYPE_CHECKING:
    from planner.shapes.made import (
        Channel,
        Hammer,
        Knot,
        LBracket,
        Mug,
        Superquadric,
        Torus,
        Tray,
    )
    from planner.shapes.round import Capsule, Cylinder, Ellipsoid, Sphere
    from planner.shapes.vessels import Bowl, Cup, Pan, Plate, Teacup, Tube

__all__ = [
    "SIZED_SHAPES",
    "Bowl",
    "Box",
    "Capsule",
    "Channel",
    "Cup",
    "Cylinder",
    "Ellipsoid",
    "Hammer",
    "Knot",
    "LBracket",
    "Mesh",
    "Mug",
    "Pan",
    "Plate",
    "Shape",
    "Sphere",
    "StablePose",
    "Superquadric",
    "Teacup",
    "Torus",
    "Tray",
    "Tube",
    "register_shape",
    "shape_from_dict",
    "shape_key",
    "shape_to_dict",
]

_HOMES = {
    "Bowl": "planner.shapes.vessels",
    "Capsule": "planner.shapes.round",
    "Channel": "planner.shapes.made",
    "Cup": "planner.shapes.vessels",
    "Cylinder": "planner.shapes.round",
    "Ellipsoid": "planner.shapes.round",
    "Hammer": "planner.shapes.made",
    "Knot": "planner.shapes.made",
    "LBracket": "planner.shapes.made",
    "Mug": "planner.shapes.made",
    "Pan": "planner.shapes.vessels",
    "Plate": "planner.shapes.vessels",
    "Sphere": "planner.shapes.round",
    "Superquadric": "planner.shapes.made",
    "Teacup": "planner.shapes.vessels",
    "Torus": "planner.shapes.made",
    "Tray": "planner.shapes.made",
    "Tube": "planner.shapes.vessels",
}
"""Shapes that few tasks have -> the module that defines them."""

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
