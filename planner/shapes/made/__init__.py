"""Objects of our own that are no primitives: closed meshes of a few sizes."""

from planner.shapes.made.base import Made
from planner.shapes.made.handled import Pan, Teacup
from planner.shapes.made.scaled import Hammer, Mug
from planner.shapes.made.walled import Bowl, Cup, Plate, Tube
from planner.shapes.made.woven import Channel, Knot, LBracket, Superquadric, Torus

__all__ = [
    "Bowl",
    "Channel",
    "Cup",
    "Hammer",
    "Knot",
    "LBracket",
    "Made",
    "Mug",
    "Pan",
    "Plate",
    "Superquadric",
    "Teacup",
    "Torus",
    "Tube",
]
