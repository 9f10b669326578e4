"""What all attempts at a movement with one set of fingers share: starts, solver and verdict.

Starts of motions: which fingers hold the object, with which pads, and where they touch it.

Fingers. Where the caller names none, attempts take turns between several sets. Three fingers go
further than four, though four have a contact to spare. Of four starts on each of six cylinders of 5
to 7 cm with 50 to 300 g and friction 0.5 to 1, 90 degrees about the vertical, these hold on the
Allegro-type hand: 22 with thumb, index and middle, 13 with middle and ring (the two nearest to the
thumb), 14 with all four; on the Shadow-type hand, of four starts on four of them, 12, 13 and 10,
and none with ring and little.

Contacts. ``planner.synthesis.seeds`` draws the hand's pose and posture. On objects with faces the
opposer's contact is then put on one side and all others on the opposite one. A finger's side
follows from where the finger is, not from its pad's axis or the nearest face: a finger that looks
to the side would get a neighbouring face, where nothing opposes it. Two of five starts of the
Shadow-type hand on a block had such a finger.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from typing import TypeAlias

import numpy as np

from planner.errors import TaskError
from planner.failure import Failure
from planner.kinematics import HandState
from planner.motion.path import ObjectPath
from planner.motion.phase import Knot
from planner.motion.plan import MotionRecord, MovementPlan
from planner.motion.problem import motion_problem_for
from planner.motion.solve import MotionCandidate, MotionSolver
from planner.motion.terms import Stance
from planner.motion.verify import MovementVerifier
from planner.plan import SolveRecord
from planner.search.attempt import Attempt, run_attempts
from planner.shapes import Mesh
from planner.spatial import SE3, FloatArray
from planner.synthesis.options import SynthesisOptions
from planner.synthesis.problem import Start
from planner.synthesis.seeds import turning_seeder_for
from planner.synthesis.seeds.draw import TRIPOD, Seeder
from planner.synthesis.symbols import GraspPoint
from planner.synthesis.terms.term import first_failure
from planner.system.threads import kept_by_thread, made_once
from planner.task import GraspTask

Reaches: TypeAlias = Callable[[SE3, FloatArray], bool]
"""Whether the hand's base can be at a pose, in the world, with joints q (nq,)."""

DRAWS = 50
"""Starts drawn per attempt until one is within reach: a few milliseconds each."""

OUT_OF_REACH = "out_of_reach"
"""Kind of a failure of a start that what carries the hand does not reach."""

LEAST_SHARE = 0.02
"""Share of a path (-) below which nothing of it is reached."""


@kept_by_thread(8)
def _verifier(task: GraspTask) -> MovementVerifier:
    """The verifier of a task, of which every thread keeps its last few."""
    return MovementVerifier(task)


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionContext:
    """What all attempts with one set of fingers share.

    Attributes:
        seeder: Draws starts.
        solver: Solves from them.
        full: Whether the whole path is asked for; else the longest part is.
        build_s: Time that building the problem took, s.
        cycles: How often the path is repeated, with relocations of all fingers between.
        reaches: Whether what carries the hand brings its base there; anywhere if None.
    """

    seeder: Seeder
    solver: MotionSolver
    full: bool
    build_s: float
    cycles: int
    reaches: Reaches | None = None

    @classmethod
    def of(
        cls,
        task: GraspTask,
        path: ObjectPath,
        options: SynthesisOptions,
        *,
        n_knots: int,
        full: bool,
        path_tolerance: float,
        rounds: int = 0,
        exact_end: bool = False,
        stances: tuple[Stance, ...] = (),
        reaches: Reaches | None = None,
        cycles: int = 1,
    ) -> MotionContext:
        """Build it.

        Args:
            task: The task, for one set of fingers.
            path: Where the object is to go.
            options: Margins and weights at each knot.
            n_knots: Knots of the solver.
            full: Whether the whole path is asked for; else the longest part is.
            path_tolerance: How far the object may leave the path, m.
            rounds: How many rounds work on closure once all of the path is reached.
            exact_end: Whether the object ends on its path.
            stances: Contacts that must close the grasp while a finger swings.
            reaches: As the attribute.
            cycles: As the attribute.
        """
        seeder = turning_seeder_for(task)
        problem, build_s = motion_problem_for(task, n_knots, stances, options.form.terms)
        solver = MotionSolver(
            problem,
            task,
            path,
            options,
            path_tolerance=path_tolerance,
            posture=seeder.posture,
            rounds=rounds,
            exact_end=exact_end,
        )
        _verifier(task)  # refuses what stands in something else, before anything is solved
        return cls(
            seeder=seeder,
            solver=solver,
            full=full,
            build_s=build_s,
            reaches=reaches,
            cycles=cycles,
        )

    def attempt(self, rng: np.random.Generator) -> MovementPlan | Failure:
        """One attempt: a stroke, repeated as often as it is asked for; or why it fails."""
        stroke = self._stroke(rng)
        if isinstance(stroke, Failure) or self.cycles == 1:
            return stroke
        return _verifier(self.solver.task).repeated(stroke, self.cycles)

    def _stroke(self, rng: np.random.Generator) -> MovementPlan | Failure:
        """The best candidate that passes the verdict, or why the last one fails.

        Where all of the path is asked for that is the one with the largest margin, else the
        longest, which comes first.
        """
        start = self._start(rng)
        if isinstance(start, Failure):
            return start
        start = on_opposed_sides(start, self.seeder)
        solve = self.solver.solve_path if self.full else self.solver.maximise_path
        best: MovementPlan | None = None
        failure: Failure | None = None
        for candidate in solve(start):
            found = self._verified(candidate)
            if isinstance(found, Failure):
                failure = found
            elif best is None or merit(found, self.full) > merit(best, self.full):
                best = found
            if best is not None and not self.full:
                break
        if best is not None:
            return best
        assert failure is not None  # a solver gives at least one candidate
        return failure

    def _start(self, rng: np.random.Generator) -> Start | Failure:
        """A start within reach of what carries the hand."""
        T_world_object = self.solver.task.T_world_object
        for _ in range(DRAWS):
            start = self.seeder.draw(rng)
            if isinstance(start, Failure) or self.reaches is None:
                return start
            if self.reaches(T_world_object * start.T_object_base, start.q):
                return start
        return Failure(
            kind=OUT_OF_REACH,
            text=f"out of reach: of {DRAWS} palm poses drawn the arm reaches none",
        )

    def _verified(self, candidate: MotionCandidate) -> MovementPlan | Failure:
        """A plan out of what the solver found, or why not."""
        if candidate.failure is not None:
            return candidate.failure.at("not solved")
        if candidate.path_parameter < LEAST_SHARE:
            return Failure(
                kind="path_too_short",
                text=f"only {100 * candidate.path_parameter:.1f} % of the path are reached",
                numbers={"path_parameter": candidate.path_parameter},
            )
        covered = self.solver.path.cut(candidate.path_parameter)
        record = SolveRecord(iterations=candidate.iterations, status="motion", objective="motion")
        verifier = _verifier(self.solver.task)  # that of the thread which asks now
        found = verifier.verify(candidate, covered, self.solver.path_tolerance, record)
        if isinstance(found, Failure):
            return found
        grasp, knots = found
        refused = self._refused_by_own_terms(knots)
        if refused is not None:
            return refused
        return MovementPlan.of_stroke(
            grasp,
            covered,
            knots,
            path_tolerance=self.solver.path_tolerance,
            limits=candidate.limits,
            record=MotionRecord(iterations=candidate.iterations, worst=candidate.worst),
        )

    def _refused_by_own_terms(self, knots: tuple[Knot, ...]) -> Failure | None:
        """Why a term of the user refuses a knot; None if all accept all knots."""
        terms = self.solver.problem.grasp.own_terms
        for knot in knots if terms else ():
            at = knot.contacts.transformed(knot.T_world_object.inverse())
            point = GraspPoint(
                task=self.solver.task, q=knot.q, points=at.positions, inward=at.normals
            )
            failure = first_failure(terms, point)
            if failure is not None:
                return failure.at(f"at {100 * knot.path_parameter:.0f} % of the path")
        return None


def attempts_in_turn(
    contexts: Sequence[Callable[[], MotionContext]], seed: int
) -> Iterator[Attempt[MovementPlan]]:
    """Endless independent attempts that take turns between contexts.

    Attempt i depends on ``seed`` and i alone. A single iterator is for one thread at a time.

    Args:
        contexts: Make the contexts; the first is called now, which refuses a task that cannot work
            before an attempt is asked for, the others when it is their turn.
        seed: Same seed, same attempts.
    """
    context = cache(lambda number: contexts[number]())
    context(0)
    return run_attempts(lambda index: context(index % len(contexts)), seed=seed)


def merit(plan: MovementPlan, full: bool) -> float:
    """The order of motions: by margin, or by length of the path."""
    if full:
        return plan.margin
    return abs(plan.path.angle) + float(np.linalg.norm(plan.path.shift))


FACING = float(np.cos(np.deg2rad(45.0)))
"""Least cosine between the normal of a side and the line across: less belongs to a neighbour."""

SAMPLES = 3000
"""Points of a mesh among which a finger's first contact is looked for: some 3 mm apart."""

EDGE_RADIUS, EDGE_SPREAD = 0.004, float(np.deg2rad(20.0))
"""A point around which (m) normals are dispersed by more (rad) is on an edge."""


def with_rolling_pads(task: GraspTask) -> GraspTask:
    """The task with pads as wide as the tips are round, where its object has faces or is a ball.

    Of 8 starts for 94 degrees on blocks of 5, 6 and 7 cm, 60 mm high, path tolerance 30 mm, 3, 3
    and 2 hold with thumb, index and middle of the Shadow-type hand; none with the pads of a grasp.
    Torsional friction of tips that pivot turns balls of 55 to 70 mm with 0 to 3 mN m in an
    Allegro-type hand (9 plans), with the pads of a grasp with up to 23 (4 plans).
    """
    if not task.object.shape.turns_tips or task.hand.rolls:
        return task
    return replace(task, hand=task.hand.rolling)


@made_once(4)
def finger_sets(task: GraspTask) -> tuple[GraspTask, ...]:
    """The task for each set of fingers that attempts take turns between.

    Of the first ``PAIRS`` tripods those that open wide enough, then all; all alone where the caller
    chose.
    """
    if not task.may_spare_fingers or len(task.fingers) <= TRIPOD:
        return (task,)
    chosen = [tripod for names in tripods(task)[:PAIRS] if (tripod := _alone(task, names))]
    return (*chosen, task)


PAIRS = 2
"""Tripods that take turns; little fingers come last and seldom turn anything."""


def tripods(task: GraspTask) -> list[tuple[str, ...]]:
    """The finger that opposes the others with each pair of neighbours among those."""
    opposer = task.finger_names[turning_seeder_for(task).pinch.opposer]
    others = [name for name in task.finger_names if name != opposer]
    return [(opposer, *pair) for pair in pairwise(others)]


def _alone(task: GraspTask, names: tuple[str, ...]) -> GraspTask | None:
    """The task for these fingers, if they can do it.

    A region may be required of a spared finger, and without a thumb some do not open wide enough.
    """
    try:
        alone = task.with_fingers(names)
        turning_seeder_for(alone)
    except TaskError:
        return None
    return alone


def on_opposed_sides(start: Start, seeder: Seeder) -> Start:
    """The start with contacts on opposed sides, where the object has faces; else as it is."""
    task, opposer = seeder.task, seeder.pinch.opposer
    shape = task.object.shape
    if shape.flat_sides is None and not isinstance(shape, Mesh):
        return start
    state = HandState(task.hand, start.q)
    pads = np.array([start.T_object_base.act(state.pad_center(f)) for f in task.fingers])
    across = np.delete(pads, opposer, axis=0).mean(axis=0) - pads[opposer]
    if isinstance(shape, Mesh):
        return _on_mesh(start, shape, pads, across, opposer)
    return _on_faces(start, seeder, pads, across)


def _on_faces(start: Start, seeder: Seeder, pads: FloatArray, across: FloatArray) -> Start:
    """On the flat sides that face a line (3,) across the object the most, in either direction."""
    shape, opposer = seeder.task.object.shape, seeder.pinch.opposer
    sides = shape.flat_sides
    assert sides is not None
    normals = np.tile(sides[np.argmax(sides @ across)], (len(pads), 1))
    normals[opposer] = sides[np.argmin(sides @ across)]
    patches = tuple(
        seeder.surface.patch_at(shape, point, normal)
        for point, normal in zip(pads, normals, strict=True)
    )
    points = np.array([np.clip(p, c.lower, c.upper) for p, c in zip(pads, patches, strict=True)])
    return replace(start, points=points, forces=_pressing(start, normals), patches=patches)


def _on_mesh(start: Start, mesh: Mesh, pads: FloatArray, across: FloatArray, opposer: int) -> Start:
    """On the points nearest to the pads that face to their side and are on no edge."""
    points, normals = _off_edges(mesh)
    along = normals @ (across / np.linalg.norm(across))
    found = []
    for i, pad in enumerate(pads):
        facing = np.flatnonzero((-along if i == opposer else along) >= FACING)
        if not len(facing):
            return start
        away = np.linalg.norm(points[facing] - pad, axis=1)
        found.append(int(facing[np.argmin(away)]))
    return replace(start, points=points[found], forces=_pressing(start, normals[found]))


def _pressing(start: Start, normals: FloatArray) -> FloatArray:
    """Forces (n, 3) as large as the start's, against outward normals (n, 3)."""
    return np.asarray(-normals * np.linalg.norm(start.forces, axis=1, keepdims=True))


@made_once(8)
def _off_edges(mesh: Mesh) -> tuple[FloatArray, FloatArray]:
    """Points (m, 3) spread over a mesh but not on its edges, and outward normals (m, 3)."""
    points, normals = mesh.surface_samples(SAMPLES, np.random.default_rng(0))
    flat = mesh.normal_dispersion(points, EDGE_RADIUS, facing=normals) <= EDGE_SPREAD
    return points[flat], normals[flat]
