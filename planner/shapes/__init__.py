"""Shapes that can be grasped. The origin of every shape is its centre of mass."""

from planner.shapes.base import Shape
from planner.shapes.box import Box
from planner.shapes.capsule import Capsule
from planner.shapes.cylinder import Cylinder
from planner.shapes.data import SHAPES, shape_from_dict, shape_to_dict
from planner.shapes.ellipsoid import Ellipsoid
from planner.shapes.sphere import Sphere

__all__ = [
    "SHAPES",
    "Box",
    "Capsule",
    "Cylinder",
    "Ellipsoid",
    "Shape",
    "Sphere",
    "shape_from_dict",
    "shape_to_dict",
]
