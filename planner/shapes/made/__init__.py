"""Objects of our own that are no primitives: closed meshes, made from a few sizes."""

from planner.shapes.made.base import Made
from planner.shapes.made.hammer import Hammer
from planner.shapes.made.knot import Knot
from planner.shapes.made.lbracket import LBracket
from planner.shapes.made.mug import Mug
from planner.shapes.made.superquadric import Superquadric
from planner.shapes.made.torus import Torus

__all__ = ["Hammer", "Knot", "LBracket", "Made", "Mug", "Superquadric", "Torus"]
