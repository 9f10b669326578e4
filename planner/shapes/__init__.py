"""Shapes that can be grasped. The origin of every shape is its centre of mass."""

from planner.shapes.base import Shape
from planner.shapes.box import Box
from planner.shapes.capsule import Capsule
from planner.shapes.cylinder import Cylinder
from planner.shapes.ellipsoid import Ellipsoid
from planner.shapes.made import Channel, Hammer, Knot, LBracket, Mug, Superquadric, Torus
from planner.shapes.mesh import Mesh
from planner.shapes.registry import (
    SIZED_SHAPES,
    register_shape,
    shape_from_dict,
    shape_key,
    shape_to_dict,
)
from planner.shapes.sphere import Sphere
from planner.shapes.stable import StablePose
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
    "Tube",
    "register_shape",
    "shape_from_dict",
    "shape_key",
    "shape_to_dict",
]
