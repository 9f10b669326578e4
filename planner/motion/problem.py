"""The problem of a motion: a grasp at every knot of a path, on one base, with tips that roll.

Every knot is a grasp of ``planner.synthesis``: its terms (touch, surface, friction cones, an
internal force, clearances, couplings, limits) hold there with the same margins. What binds them:

    base     one pose for all knots (``planner.motion.unknowns``)
    rolling  slip of each tip from knot to knot = 0 (``planner.motion.terms``)
    path     distance of the object from its path <= the path tolerance
    reach    covered share of the path: at least what is asked, or the largest
    stances  where a finger is to swing, closure by the others (``planner.motion.terms``)
    pivoting turn of each tip about its contact normal: a cost, where that counts
    loads    share of its limit that each actuator spends <= a bound (``planner.motion.terms``)

Table and obstacles count at the first knot alone: the object is lifted before it is moved.

The problem of a task's motions: built for its kind of shape, once, and kept.

Contacts on a mesh keep further from edges than in a grasp, and nearer to the rims of pads. The
problem sees a mesh as a smooth distance, whose normals turn over some 8 mm around an edge. A finger
that has to turn further than its pad allows would find the slant there that the true surface does
not have. So edges weigh more than in a grasp, which leaves normals that are right to a few degrees,
and pads may touch nearly up to their rim, where a turn begins and ends.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.motion.path import ObjectPath, tilts
from planner.motion.terms import (
    MOTION_TERMS,
    PATH,
    PIVOTING,
    REACH,
    ROLLING,
    Stance,
    StanceRows,
    load_function,
    load_parameters,
    load_rows,
    pivoting_function,
    rolling_function,
    rows_of_fingers,
    steady_rows,
    swing_rows,
)
from planner.motion.unknowns import MotionUnknowns, placement
from planner.numerics.tape import BufferedFunction
from planner.shapes import Mesh, Shape
from planner.shapes.base import Surface
from planner.spatial import FloatArray
from planner.synthesis.mesh_surface import mesh_surface, surface_of
from planner.synthesis.options import SynthesisOptions
from planner.synthesis.problem import GraspProblem, Start, problem_on
from planner.synthesis.symbols import NO_TABLE
from planner.synthesis.terms.term import Term, WrittenTerm, table_of
from planner.system.threads import BUILDING, built, made_once
from planner.task import GraspTask


@dataclass(frozen=True, kw_only=True)
class MotionNumbers:
    """The numbers of one motion to be solved for.

    Attributes:
        knots: Parameters (n_knots, n_p) of every knot as a grasp.
        reference: R0 (3, 3) of the base in the middle frame.
        path_parameters: Of each knot (n_knots,), 0 to 1.
        axis: Axis in the object's frame at the start (3,), unit.
        angle: Turn, rad.
        shift: Translation in the same frame (3,), m.
        path_tolerance: How far the object may leave its path, m.
        loads: Parameters (n_knots, m) of the actuators' loads.
        pivoting_costs: Whether a tip that pivots on its contact from knot to knot has a cost.
    """

    knots: FloatArray
    reference: FloatArray
    path_parameters: FloatArray
    axis: FloatArray
    angle: float
    shift: FloatArray
    path_tolerance: float
    loads: FloatArray
    pivoting_costs: bool


@dataclass(frozen=True, eq=False)
class MotionProblem:
    """The problem of one hand, finger set and kind of shape, at any path.

    Attributes:
        grasp: The problem of a single knot.
        n_knots: Number of knots.
        stances: Contacts that must close the grasp while a finger swings.
    """

    grasp: GraspProblem
    n_knots: int
    stances: tuple[Stance, ...] = ()

    @property
    def terms(self) -> tuple[WrittenTerm, ...]:
        """All terms with the names of all rows that they can have: of all grasps, of the motion.

        Pivoting costs where ``MotionNumbers`` says so; ``reach`` counts in ``maximise_path`` alone.
        """
        hand, fingers, n = self.grasp.hand, self.grasp.fingers, self.n_knots
        motion = [row for k in range(1, n) for row in rows_of_fingers(ROLLING, fingers, 3, k)]
        motion += [PATH.row(number=k, knot=k) for k in range(n)]
        for stance in self.stances:
            motion += swing_rows(fingers, stance.swinging, n - 1)
        motion += [row for k in range(n) for row in load_rows(hand, fingers, k)]
        motion.append(REACH.row())
        motion += [row for k in range(1, n) for row in rows_of_fingers(PIVOTING, fingers, 1, k)]
        motion += [row for k in range(1, n - 1) for row in steady_rows(hand, k)]
        of_grasps = [
            WrittenTerm(
                term=one.term,
                rows=tuple(replace(row, knot=k) for k in range(n) for row in one.rows),
            )
            for one in self.grasp.terms
        ]
        of_motion = [
            WrittenTerm(term=term, rows=tuple(row for row in motion if row.term is term))
            for term in MOTION_TERMS
        ]
        return (*of_grasps, *of_motion)

    def __str__(self) -> str:
        """Unknowns and all terms, one line each."""
        names = ", ".join(f.name for f in self.grasp.fingers)
        return (
            f"motion problem: {self.grasp.hand.name}, {names}, {self.grasp.surface.kind}\n"
            f"  {self.n_knots} knots, {len(self.stances)} regrasps, {self.unknowns.size} unknowns\n"
            f"{table_of(self.terms)}"
        )

    @built
    def unknowns(self) -> MotionUnknowns:
        """Layout of the unknowns."""
        return MotionUnknowns(
            grasp=self.grasp.formulation.unknowns, n_knots=self.n_knots, n_stances=len(self.stances)
        )

    @built
    def rolling(self) -> BufferedFunction:
        """``rolling_function`` from every knot to the next, mapped."""
        one = rolling_function(self.grasp.hand, self.grasp.fingers)
        return BufferedFunction(one.map(self.n_knots - 1))

    @built
    def pivoting(self) -> BufferedFunction:
        """``pivoting_function`` from every knot to the next, mapped."""
        one = pivoting_function(self.grasp.hand, self.grasp.fingers)
        return BufferedFunction(one.map(self.n_knots - 1))

    @built
    def loads(self) -> BufferedFunction:
        """``load_function`` at every knot, mapped."""
        one = load_function(self.grasp.hand, self.grasp.fingers)
        return BufferedFunction(one.map(self.n_knots))

    @built
    def placement(self) -> BufferedFunction:
        """``placement`` of every knot, mapped."""
        return BufferedFunction(placement().map(self.n_knots))

    @built
    def stance_rows(self) -> StanceRows:
        """The residuals of a stance."""
        return StanceRows(self.grasp.surface, len(self.grasp.fingers) - 1)

    def numbers(
        self,
        task: GraspTask,
        path: ObjectPath,
        start: Start,
        posture: FloatArray,
        options: SynthesisOptions,
        path_tolerance: float,
    ) -> MotionNumbers:
        """The parameters for a start that grasps the object in the middle of its path.

        Args:
            task: The task; object, table and friction.
            path: Where the object is to go.
            start: Gives the base's reference orientation and the patches.
            posture: Preferred joints (nq,).
            options: Margins and weights.
            path_tolerance: m.
        """
        first = self.grasp.parameters(task, start, posture, options)
        later = first.copy()
        places = self.grasp.formulation.places
        along = np.linspace(0.0, 1.0, self.n_knots)
        later[places["table"].stop - 1] = -NO_TABLE
        later[places["obstacles"]].reshape(-1, OBSTACLE_DIM)[:, 9:12] = NO_TABLE
        to_object = task.T_world_object.rotation.T
        return MotionNumbers(
            knots=np.vstack([first, *[later] * (self.n_knots - 1)]),
            reference=np.array(start.T_object_base.rotation),
            path_parameters=along,
            axis=to_object @ path.axis,
            angle=path.angle,
            shift=to_object @ path.shift,
            path_tolerance=path_tolerance,
            loads=load_parameters(task, path, along, start.q),
            pivoting_costs=self._pivoting_costs(task, path),
        )

    def _pivoting_costs(self, task: GraspTask, path: ObjectPath) -> bool:
        """Whether pivoting has a cost: on balls, and on paths that are no turn about the vertical.

        Not between regrasps: strokes are short, and closure of the stances is what counts. With
        the cost the least margin of a lift was 0.25 to 0.34 on a ball in a hand of four fingers in
        a circle (four seeds, strokes of 23 degrees), without it 0.33 to 0.58.
        """
        return not self.stances and (task.object.shape.ball_like or not _level(path))

    def first(self, start: Start) -> FloatArray:
        """The unknowns where all knots are the start: none of the path is covered."""
        x = self.grasp.first(start)
        shared = np.concatenate([x[:6], [0.0]])
        n = self.n_knots
        forces = start.forces
        in_stance = np.array(
            [np.delete(forces, stance.swinging, axis=0) for stance in self.stances]
        )
        return self.unknowns.pack(shared, np.zeros((n, 3)), np.tile(x[6:], (n, 1)), in_stance)

    def bounds(
        self, start: Start, path_tolerance: float, *, exact_end: bool = False
    ) -> tuple[FloatArray, FloatArray]:
        """Lower and upper bounds of the unknowns; the first knot is where the object is.

        Args:
            start: Gives the base where that is fixed, and the patches.
            path_tolerance: How far the object may leave its path, m.
            exact_end: Whether the last knot is on the path as well.
        """
        n = self.n_knots
        reach = np.full((n, 3), path_tolerance)
        reach[0] = 0.0
        if exact_end:
            reach[-1] = 0.0
        nq, (least, most) = self.grasp.hand.nq, self.grasp.bounds(start)
        joints = slice(6, 6 + nq)
        room = np.minimum(JOINT_ROOM, (most - least)[joints] / 4)
        least[joints] += room
        most[joints] -= room
        pushed = np.full(
            (len(self.stances), self.unknowns.stance_size), 4.0 * len(self.grasp.fingers)
        )
        lower, upper = (
            self.unknowns.pack(
                np.append(bound[:6], share), sign * reach, np.tile(bound[6:], (n, 1)), sign * pushed
            )
            for bound, share, sign in ((least, 0.0, -1), (most, 1.0, 1))
        )
        return lower, upper


def _level(path: ObjectPath) -> bool:
    """Whether a path is a turn about the vertical, and nothing else.

    On any other fingers that come from above stand on an axis about which they turn with the object
    or against it as often as not, and pivot.
    """
    return not path.shift.any() and not tilts(path.axis)


OBSTACLE_DIM = 15
"""Numbers of an obstacle: rotation, translation and half extents (``obstacles_in_object``)."""

JOINT_ROOM = 0.05
"""How far (rad or m) joints stay from the ends of their ranges: a servo whose command ends there
could not press any more, and an object that stands 3 mm beside its place bends joints by 0.03. As
many starts hold as with 0.02: 3, 2 and 1 of 8 on blocks of 5, 6 and 7 cm, 93 degrees, Shadow-type
hand."""


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
