"""Meshes as motions see them: contacts keep further from edges, and nearer to the rims of pads.

A mesh enters the programme as a smooth distance, whose normals turn over some 8 mm around an edge.
A finger that is asked to turn further than its pad allows would find the slant there that the true
surface does not have. So edges weigh more than in a grasp, which leaves normals that are right to a
few degrees, and pads that may touch nearly up to their rim, where a turn begins and ends.
"""

from __future__ import annotations

from planner.shapes import Mesh, Shape
from planner.shapes.surface import Surface
from planner.synthesis.mesh_surface import mesh_surface, surface_of

__all__ = ["turned_surface_of"]

NORMAL_ERROR, STEEP, EDGE_WORTH = 0.08, 0.97, 10.0
"""How far (rad) normals may be off at a contact; slope (-) of the smooth distance from which on a
contact is off edges; and what counts a slope that is missing there, in those of a grasp. Thumb,
index and middle of the Shadow-type hand, a block of 6 cm and a hexagonal prism as meshes: with
those of a grasp none of 6 and 6 starts held for 95 degrees, with these 4 and 1 of 5 for 92."""

STEEP_ON_WALLS = 0.87
"""The slope on thin walls. There it is 0.95 to 0.99 even in the middle of a mug's side, and fingers
drawn to where it is most find no way around. For four mugs 50 to 66 mm wide on a stand the
Allegro-type hand found turns within 2 to 14 attempts, with 0.97 for one of two within 30."""

DISTANCE_ERROR = 0.0035
"""How much (m) links keep away beyond what is asked for. Balls inside a palm leave its corners out:
with the 0.7 mm of a grasp they reached up to 0.7 mm into a bottle 16 cm high at all of 5 starts of
the Allegro-type hand; with these 2 of 5 hold."""


def turned_surface_of(shape: Shape) -> Surface:
    """The form of a shape in the programme of a motion."""
    if not isinstance(shape, Mesh):
        return surface_of(shape)
    return mesh_surface(
        normal_error=NORMAL_ERROR,
        distance_error=DISTANCE_ERROR,
        steep=STEEP,
        steep_on_walls=STEEP_ON_WALLS,
        edge_worth=EDGE_WORTH,
    )
