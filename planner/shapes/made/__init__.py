"""Objects of our own that are no primitives: closed meshes of a few sizes."""

from planner.shapes.made.base import Made
from planner.shapes.made.scaled import Hammer, Mug
from planner.shapes.made.woven import Knot, LBracket, Superquadric, Torus

__all__ = ["Hammer", "Knot", "LBracket", "Made", "Mug", "Superquadric", "Torus"]
