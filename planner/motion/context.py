"""What all attempts at a motion with one set of fingers share: starts, solver and verdict."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from planner.failure import Failure
from planner.motion.path import ObjectPath
from planner.motion.plan import Knot, MotionPlan, MotionRecord
from planner.motion.problem_cache import motion_problem_for
from planner.motion.solve import MotionCandidate, MotionSolver
from planner.motion.stances import Stance
from planner.motion.starts import on_opposed_sides
from planner.motion.verify import MotionVerifier
from planner.plan import SolveRecord
from planner.spatial import SE3, FloatArray
from planner.synthesis.options import SynthesisOptions
from planner.synthesis.problem import Start
from planner.synthesis.seeds.draw import Seeder
from planner.synthesis.seeds.mesh import turning_seeder_for
from planner.synthesis.symbols import GraspPoint
from planner.synthesis.terms.term import first_failure
from planner.system.threads import kept_by_thread
from planner.task import GraspTask

Reaches: TypeAlias = Callable[[SE3, FloatArray], bool]
"""Whether the hand's base can be at a pose, in the world, with joints q (nq,)."""

DRAWS = 50
"""Starts drawn per attempt until one is within reach: a few milliseconds each."""

LEAST_SHARE = 0.02
"""Share of a path (-) below which nothing of it is reached."""


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
        full: Whether the whole path is asked for; else the longest part is.
        build_s: Time that building the problem took, s.
        reaches: Whether what carries the hand brings its base there; anywhere if None.
    """

    seeder: Seeder
    solver: MotionSolver
    full: bool
    build_s: float
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
        return cls(seeder=seeder, solver=solver, full=full, build_s=build_s, reaches=reaches)

    def attempt(self, rng: np.random.Generator) -> MotionPlan | Failure:
        """One attempt: the best candidate that passes the verdict, or why the last one fails.

        Where all of the path is asked for that is the one with the largest margin, else the
        longest, which comes first.
        """
        start = self._start(rng)
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
            kind="out_of_reach",
            text=f"out of reach: of {DRAWS} palm poses drawn the arm reaches none",
        )

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
    """The order of motions: by margin, or by length of the path."""
    if full:
        return plan.margin
    return abs(plan.path.angle) + float(np.linalg.norm(plan.path.shift))
