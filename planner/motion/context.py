"""What all attempts at a motion share, for each set of fingers that may hold the object.

Where the caller names no fingers, attempts take turns between the sets. Three fingers go further
than four, though four have a contact to spare. Of four starts on each of six cylinders of 5 to 7 cm
with 50 to 300 g and friction 0.5 to 1, 90 degrees about the vertical, these hold on the
Allegro-type hand: 22 with thumb, index and middle, 13 with middle and ring (the two nearest to the
thumb), 14 with all four; on the Shadow-type hand, of four starts on four of them, 12, 13 and 10,
and none with ring and little.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from planner.errors import TaskError
from planner.failure import Failure
from planner.motion.holds import Hold
from planner.motion.path import ObjectPath
from planner.motion.plan import Knot, MotionPlan, MotionRecord
from planner.motion.problems import motion_problem_for
from planner.motion.solve import MotionCandidate, MotionSolver
from planner.motion.starts import on_opposed_sides
from planner.motion.verify import MotionVerifier
from planner.plan import SolveRecord
from planner.synthesis.options import SynthesisOptions
from planner.synthesis.seeds.draw import TRIPOD, Seeder
from planner.synthesis.seeds.mesh import turning_seeder_for
from planner.synthesis.symbols import GraspPoint
from planner.synthesis.terms.term import first_failure
from planner.system.threads import kept_by_thread, made_once
from planner.task import GraspTask

__all__ = ["MotionContext", "finger_sets", "merit", "tripods", "with_rolling_pads"]

LEAST_SHARE = 0.02
"""Share of a path (-) below which nothing of it is reached."""


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


@kept_by_thread(8)
def _verifier(task: GraspTask) -> MotionVerifier:
    """The verifier of a task, of which every thread keeps its last few."""
    return MotionVerifier(task)


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionContext:
    """What all attempts with one set of fingers share.

    Attributes:
        seeder: Draws starts.
        solver: Solves from them.
        full: Whether all of the path is asked for, else as much of it as there is.
        build_s: Time that building the problem took, s.
    """

    seeder: Seeder
    solver: MotionSolver
    full: bool
    build_s: float

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
        holds: tuple[Hold, ...] = (),
    ) -> MotionContext:
        """Build it.

        Args:
            task: The task, for one set of fingers.
            path: Where the object is to go.
            options: Margins and weights at each knot.
            n_knots: Knots of the solver.
            full: Whether all of the path is asked for, else as much of it as there is.
            path_tolerance: How far the object may leave the path, m.
            rounds: How many rounds work on closure once all of the path is reached.
            exact_end: Whether the object ends on its path.
            holds: What must hold while a finger is away.
        """
        seeder = turning_seeder_for(task)
        problem, build_s = motion_problem_for(task, n_knots, holds, options.form.terms)
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
        return cls(seeder=seeder, solver=solver, full=full, build_s=build_s)

    def attempt(self, rng: np.random.Generator) -> MotionPlan | Failure:
        """What comes of a start: the best candidate that holds, or why the last one does not.

        Where all of the path is asked for that is the one with the largest margin, else the
        longest, which comes first.
        """
        start = self.seeder.draw(rng)
        if isinstance(start, Failure):
            return start
        start = on_opposed_sides(start, self.seeder)
        solve = self.solver.solve_path if self.full else self.solver.maximise_path
        best: MotionPlan | None = None
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

    def _verified(self, candidate: MotionCandidate) -> MotionPlan | Failure:
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
        return MotionPlan(
            grasp=grasp,
            path=covered,
            knots=knots,
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


def merit(plan: MotionPlan, full: bool) -> float:
    """What makes one motion better than another: margin, or length of the path."""
    if full:
        return plan.margin
    return abs(plan.path.angle) + float(np.linalg.norm(plan.path.shift))
