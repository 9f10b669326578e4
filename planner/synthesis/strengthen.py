"""From a start to a strong grasp by least squares: reach one, strengthen it, keep it off edges.

A first descent (``planner.synthesis.descent``) satisfies the terms and stops; where that fails the
start is given up. Then, in rounds, the directions of wrench in which the grasp resists least are
looked for (``planner.quality.weakest``), and a descent works on its resistance there as a further
cost. On a mesh a contact that has come to lie on an edge is held in a small box beside it. The last
descent is for the terms alone.
"""

from __future__ import annotations

import time

import numpy as np

from planner.quality.weakest import weakest_directions
from planner.shapes import Mesh
from planner.spatial import FloatArray
from planner.stages import stage
from planner.synthesis.descent import MAX_ITERATIONS, SOLVED, Descent, descend
from planner.synthesis.edges import EDGE_SPREAD, ROOM, edge_free, spreads
from planner.synthesis.problem import Candidate, GraspProblem, Start
from planner.synthesis.terms import N_DIRECTIONS
from planner.task import GraspTask

__all__ = ["descend_grasp"]

TURN_SCALE, SHIFT_SCALE, JOINT_SCALE, POINT_SCALE, FORCE_SCALE = 0.3, 0.02, 0.3, 0.01, 0.5
"""Steps that count as alike in least squares: Rodrigues parameters (-), base (m), joints (rad or
m), contact points (m), forces (in units of the mean normal force)."""

WORTH_IMPROVING = 0.5
"""Largest weighted residual of a term with which a grasp is worth strengthening."""

ROUND_ITERATIONS = 8
"""Evaluations of one round."""

SMALLEST_RANGE = 1e-3
"""Least scale (rad or m) of a joint that can hardly move."""

OFF_EDGES = 2
"""How often contacts are brought off edges at the end: beside one edge there may be another."""


def descend_grasp(
    problem: GraspProblem, task: GraspTask, start: Start, parameters: FloatArray, rounds: int = 0
) -> Candidate:
    """Where least squares lead from a start.

    Args:
        problem: The problem of the task's hand, fingers and kind of shape.
        task: The task.
        start: The start.
        parameters: From ``GraspProblem.parameters``.
        rounds: How many rounds strengthen the grasp; none leaves the first that is reached.
    """
    begin = time.process_time()
    problem.residuals.bind(parameters, problem.surface.field_of(task.object.shape))
    run = _Run(problem, task, start)
    run.descend(MAX_ITERATIONS)
    status = run.end.status
    if run.end.worst <= WORTH_IMPROVING:
        if rounds and run.leave_edges():
            run.descend(MAX_ITERATIONS)
        for _ in range(rounds):
            with stage("weakest"):
                problem.residuals.set_directions(run.weakest())
            run.descend(ROUND_ITERATIONS)
        problem.residuals.set_directions(np.zeros((0, 6)))
        if rounds and run.end.worst > SOLVED:
            run.descend(ROUND_ITERATIONS)
        for _ in range(OFF_EDGES):
            if not run.leave_edges():
                break
            run.descend(MAX_ITERATIONS)
    violation = problem.residuals.violations()
    return problem.candidate(start, run.x, violation, status, run.iterations, begin)


class _Run:
    """Where a solution has come to, and within which bounds it may move on."""

    def __init__(self, problem: GraspProblem, task: GraspTask, start: Start) -> None:
        self._problem, self._task = problem, task
        self._unknowns = problem.formulation.unknowns
        self._lower, self._upper = problem.bounds(start)
        n = len(problem.fingers)
        span = np.maximum(problem.hand.q_upper - problem.hand.q_lower, SMALLEST_RANGE)
        self._scale = self._unknowns.pack(
            np.full(3, TURN_SCALE),
            np.full(3, SHIFT_SCALE),
            np.minimum(JOINT_SCALE, span),
            np.full((n, 3), POINT_SCALE),
            np.full((n, 3), FORCE_SCALE),
        )
        self.x = problem.first(start)
        self.end: Descent
        self.iterations = 0

    def descend(self, budget: int) -> None:
        """Move on by at most ``budget`` evaluations."""
        self.end = descend(
            self._problem.residuals,
            np.clip(self.x, self._lower, self._upper),
            lower=self._lower,
            upper=self._upper,
            scale=self._scale,
            max_iterations=budget,
        )
        self.x = self.end.x
        self.iterations += self.end.iterations

    def weakest(self) -> FloatArray:
        """The directions (k, 6) in which the contacts resist least."""
        shape = self._task.object.shape
        points, outward = shape.closest_point(self._unknowns.points(self.x))
        length = shape.bounding_radius
        return weakest_directions(points, -outward, self._task.mu, length, N_DIRECTIONS)

    def leave_edges(self) -> bool:
        """Whether a contact is on an edge; if so its bounds become a box beside it."""
        shape = self._task.object.shape
        if not isinstance(shape, Mesh):
            return False
        # a pad touches the true mesh beside where it touches the smooth one, far so near edges
        smooth = shape.field().taylor(self._unknowns.points(self.x), 1)[:, 1:4]
        smooth /= np.maximum(np.linalg.norm(smooth, axis=1, keepdims=True), TINY)
        radii = np.array([f.pad.radius for f in self._problem.fingers])
        centers = self._unknowns.points(self.x) + radii[:, None] * smooth
        points, outward = shape.closest_point(centers)
        on_edge = np.flatnonzero(spreads(shape, points) > EDGE_SPREAD)
        for i in on_edge:
            place = edge_free(shape).nearest(points[i], outward[i])
            if place is not None:
                self._unknowns.points(self._lower)[i] = place - ROOM
                self._unknowns.points(self._upper)[i] = place + ROOM
        return bool(len(on_edge))


TINY = 1e-9
"""A gradient shorter than this has no direction."""
