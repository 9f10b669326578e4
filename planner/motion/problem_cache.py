"""The problem of a task's motions: built for its kind of shape, once, and kept.

Contacts on a mesh keep further from edges than in a grasp, and nearer to the rims of pads. The
problem sees a mesh as a smooth distance, whose normals turn over some 8 mm around an edge. A finger
that has to turn further than its pad allows would find the slant there that the true surface does
not have. So edges weigh more than in a grasp, which leaves normals that are right to a few degrees,
and pads may touch nearly up to their rim, where a turn begins and ends.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field

from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.motion.problem import MotionProblem
from planner.motion.stances import Stance
from planner.shapes import Mesh, Shape
from planner.shapes.surface import Surface
from planner.synthesis.mesh_surface import mesh_surface, surface_of
from planner.synthesis.problem import problem_on
from planner.synthesis.terms.term import Term
from planner.system.threads import BUILDING, made_once
from planner.task import GraspTask

NORMAL_ERROR, STEEP, EDGE_WORTH = 0.08, 0.97, 10.0
"""Largest error (rad) of normals at a contact; least slope (-) of the smooth distance at a contact
that is on no edge; and weight factor (-) of a lower slope, 1 in a grasp. Thumb,
index and middle of the Shadow-type hand, a block of 6 cm and a hexagonal prism as meshes: with
the values of a grasp none of 6 and 6 starts held for 95 degrees, with these 4 and 1 of 5 for 92."""

STEEP_ON_WALLS = 0.87
"""The least slope on thin walls. There it is 0.95 to 0.99 even in the middle of a mug's side, and
fingers drawn to its maximum find no path around. For four mugs 50 to 66 mm wide on a stand the
Allegro-type hand found turns within 2 to 14 attempts, with 0.97 for one of two within 30."""

DISTANCE_ERROR = 0.0035
"""Added to every clearance of links, m: the spheres inside a palm leave its corners out. With the
0.7 mm of a grasp corners penetrated a bottle 16 cm high by up to 0.7 mm at all of 5 starts of the
Allegro-type hand; with 3.5 mm 2 of 5 hold."""


def turned_surface_of(shape: Shape) -> Surface:
    """The form of a shape in the problem of a motion."""
    if not isinstance(shape, Mesh):
        return surface_of(shape)
    return mesh_surface(
        normal_error=NORMAL_ERROR,
        distance_error=DISTANCE_ERROR,
        steep=STEEP,
        steep_on_walls=STEEP_ON_WALLS,
        edge_worth=EDGE_WORTH,
    )


def build_motion_problem(
    hand: Hand,
    fingers: Sequence[Finger],
    kind_of: Shape,
    n_knots: int,
    n_obstacles: int = 0,
    stances: tuple[Stance, ...] = (),
    terms: tuple[str, ...] = (),
) -> MotionProblem:
    """Build the problem of a motion.

    Args:
        hand: The hand; it floats.
        fingers: The fingers that take part.
        kind_of: Any shape of the kind; its size does not matter.
        n_knots: Number of knots, 2 or more.
        n_obstacles: Number of obstacle boxes.
        stances: Contacts that must close the grasp while a finger swings.
        terms: Registered terms that every knot has beside the standard ones, by name.
    """
    surface = turned_surface_of(kind_of)
    grasp = problem_on(hand, tuple(fingers), surface, n_obstacles, (), terms)
    return MotionProblem(grasp, n_knots, stances)


def motion_problem_for(
    task: GraspTask,
    n_knots: int,
    stances: tuple[Stance, ...] = (),
    terms: tuple[Term, ...] = (),
) -> tuple[MotionProblem, float]:
    """The problem of a task's hand, fingers and kind of shape, and the time to build it, s.

    Args:
        task: The task.
        n_knots: Number of knots.
        stances: Contacts that must close the grasp while a finger swings.
        terms: Terms of users that every knot has, see ``SynthesisOptions.form``.
    """
    begin = time.perf_counter()
    shape = task.object.shape
    form = _Form(
        digest=task.hand.digest,
        finger_names=task.finger_names,
        kind=surface_of(shape).kind,
        n_knots=n_knots,
        n_obstacles=len(task.obstacles),
        stances=stances,
        terms=terms,
        hand=task.hand,
        shape=shape,
    )
    found = _built(form)
    with BUILDING:  # fitting a field takes seconds: one thread does it and the others wait
        found.grasp.surface.field_of(shape)
    return found, time.perf_counter() - begin


@dataclass(frozen=True, kw_only=True)
class _Form:
    """What determines a problem, for the cache; and an example of it."""

    digest: str
    finger_names: tuple[str, ...]
    kind: str
    n_knots: int
    n_obstacles: int
    stances: tuple[Stance, ...]
    terms: tuple[Term, ...]
    hand: Hand = field(compare=False)
    shape: Shape = field(compare=False)


@made_once(8)
def _built(form: _Form) -> MotionProblem:
    fingers = form.hand.choose_fingers(form.finger_names)
    return build_motion_problem(
        form.hand,
        fingers,
        form.shape,
        form.n_knots,
        form.n_obstacles,
        form.stances,
        tuple(term.name for term in form.terms),
    )
