"""From a start to a strong grasp by least squares: reach a grasp, improve it, repair it.

A first run (``planner.numerics.levenberg_marquardt``) satisfies the terms; a start from which it
fails is abandoned. Rounds improve the objectives (``planner.synthesis.objectives.registry``). Each
round finds the directions of wrench in which the grasp resists least (``planner.quality.weakest``)
and takes a few steps with resistance there as a further cost. A last run without objectives repairs
the violated terms.

Bars and hulls are wider in places than the spheres and capsules that stand for them. For hands with
such links the true distances are measured after each run, and pairs that are too near are kept
apart in the next one (``planner.synthesis.terms.link_distance``), which saves attempts.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np

from planner.collision.world import CollisionWorld
from planner.numerics.levenberg_marquardt import (
    MAX_ITERATIONS,
    SLOW,
    SOLVED,
    LMResult,
)
from planner.quality.weakest import wrench_faces
from planner.shapes import Mesh, Shape
from planner.spatial import FloatArray
from planner.synthesis.objectives.registry import EPSILON, objective_parameters
from planner.synthesis.objectives.wrench import resisted_wrenches
from planner.synthesis.options import SynthesisOptions
from planner.synthesis.problem import Candidate, GraspProblem, Start
from planner.synthesis.residuals import Residuals
from planner.synthesis.symbols import GraspPoint
from planner.synthesis.terms.link_distance import find_link_distances
from planner.synthesis.terms.resistance import N_DIRECTIONS
from planner.system.threads import stage
from planner.task import GraspTask

if TYPE_CHECKING:
    from planner.synthesis.loops.solver import LoopResiduals

TURN_SCALE, SHIFT_SCALE, JOINT_SCALE, POINT_SCALE, FORCE_SCALE = 0.3, 0.02, 0.3, 0.01, 0.5
"""Steps that count as alike in least squares: Rodrigues parameters (-), base (m), joints (rad or
m), contact points (m), forces (in units of the mean normal force)."""

GAIN = 0.2
"""Target of a round over the least resistance (normal forces sum to 1). Pyramids underestimate
round cones by 0.04: a gain of 0.05 moves little, and with 0.3 contacts do not return to the
surface."""

NEARLY = 0.5
"""Largest weighted residual of a term with which a grasp is worth improving and verifying: half a
millimetre."""

LINKS_NEARLY = 1.5
"""The same where links or the palm touch, whose lines and faces end at kinks that steps stop at:
fingers are put onto the true surface afterwards, where all is judged."""

ROUND_ITERATIONS = 4
"""Evaluations of one round: after some four, other directions are the weakest."""

LINK_ITERATIONS = 150
"""Evaluations of the first run where links or the palm touch: where a face lies on a face, the last
half millimetre takes twice as many as a fingertip."""

MEND_ITERATIONS = 30
"""Evaluations of the last run, without objectives; most need six, contacts on mugs and brackets
more than 12 to return to the surface."""

SMALLEST_RANGE = 1e-3
"""Least scale (rad or m) of a joint that can hardly move."""


def optimize_grasp(
    problem: GraspProblem,
    task: GraspTask,
    start: Start,
    parameters: FloatArray,
    options: SynthesisOptions,
    world: CollisionWorld | None = None,
) -> Candidate:
    """The grasp that least squares reach from a start.

    The problem is only read: any number of threads may call at once, each with a world of its own.

    Args:
        problem: The problem of the task's hand, fingers and kind of shape.
        task: The task.
        start: The start.
        parameters: From ``GraspProblem.parameters``.
        options: Objectives and rounds; without either the first grasp that is reached stays.
        world: True geometry of the task; without it spheres and capsules stand for links.
    """
    rounds = options.rounds if options.weights else 0
    begin = time.process_time()
    run = GraspRun(problem, task, start, parameters)
    run.solve(MAX_ITERATIONS if task.is_of_fingertips else LINK_ITERATIONS)
    status = run.end.status
    if run.end.worst <= nearly(task):
        damping = None
        for k in range(rounds):
            with stage("weakest"):
                run.update_objectives(options)
            if k % 2 == 0:  # measured distances serve two rounds
                run.refresh_link_distances(world, options)
            run.solve(ROUND_ITERATIONS, damping)
            damping = run.end.damping  # the trust region carries over
        run.drop_objectives()
        near = run.refresh_link_distances(world, options)
        if near or (rounds and run.end.worst > SOLVED):
            run.solve(MEND_ITERATIONS, slow=np.inf)
    return run.candidate(status, begin)


def nearly(task: GraspTask) -> float:
    """Largest weighted residual of a term with which a task's grasp is worth verifying."""
    return NEARLY if task.is_of_fingertips else LINKS_NEARLY


class GraspRun:
    """The state of one optimisation: unknowns, their bounds and the residuals.

    Attributes:
        start: Where it began.
        residuals: A clone of the problem's, with its own parameters and directions.
        x: The unknowns.
        end: How the last ``solve`` ended.
        iterations: Evaluations so far.
    """

    def __init__(
        self, problem: GraspProblem, task: GraspTask, start: Start, parameters: FloatArray
    ) -> None:
        """Begin at a start; arguments are those of ``optimize_grasp``."""
        self._problem, self._task, self.start = problem, task, start
        self.residuals = self._residuals(parameters)
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
        self.end: LMResult
        self.iterations = 0
        self._faces: tuple[FloatArray, FloatArray] | None = None

    def solve(self, budget: int, damping: float | None = None, slow: float = SLOW) -> None:
        """Move on by at most ``budget`` evaluations."""
        self.end = self.residuals.minimise(
            np.clip(self.x, self._lower, self._upper),
            lower=self._lower,
            upper=self._upper,
            scale=self._scale,
            max_iterations=budget,
            damping=damping,
            slow=slow,
        )
        self.x = self.end.x
        self.iterations += self.end.iterations

    def refresh_link_distances(
        self, world: CollisionWorld | None, options: SynthesisOptions
    ) -> bool:
        """Measure true distances and constrain near pairs from now on; whether any is too near."""
        if world is None:
            return False
        with stage("links"):
            pose = self._problem.base_pose(self.start, self.x)
            near = find_link_distances(
                world,
                self._unknowns,
                self.x,
                pose,
                clear_tip=options.clear_tip,
                clear_fingers=options.clear_fingers,
            )
        self.residuals.keep_apart(near)
        return near is not None and near.urgent

    def _residuals(self, parameters: FloatArray) -> Residuals | LoopResiduals:
        """Residuals of this run's own, with parameters."""
        field = self._problem.surface.field_of(self._task.object.shape)
        return self._problem.least_squares(parameters, field)

    def set_parameters(self, parameters: FloatArray) -> None:
        """Other parameters from the next ``solve`` on; what was added to the terms is dropped."""
        self.residuals = self._residuals(parameters)

    def drop_objectives(self) -> None:
        """Work on the terms alone from now on."""
        self.residuals.set_directions(np.zeros((0, 6)))
        self.residuals.set_objectives(np.zeros(0))

    def contacts(self) -> tuple[FloatArray, FloatArray]:
        """Contacts (n, 3) and outward normals (n, 3) at x, object frame."""
        return _contacts(self._task.object.shape, self._unknowns.points(self.x))

    def wrench_faces(self) -> FloatArray:
        """Faces (k, 7) of the hull of wrenches at x, the nearest first (``quality.weakest``)."""
        if self._faces is None or self._faces[0] is not self.x:
            points, outward = self.contacts()
            length = self._task.object.shape.bounding_radius
            self._faces = self.x, wrench_faces(points, -outward, self._task.mu, length)
        return self._faces[1]

    @property
    def least_resistance(self) -> float:
        """Epsilon at x with coarse pyramids (-)."""
        faces = self.wrench_faces()
        return max(-float(faces[0, 6]), 0.0) if len(faces) else 0.0

    def update_objectives(self, options: SynthesisOptions, gain: float = GAIN) -> None:
        """Linearise the objectives at the present grasp.

        Args:
            options: Objectives and their weights.
            gain: Target of epsilon over the least resistance (-).
        """
        problem, task, weights = self._problem, self._task, options.weights
        if EPSILON in weights:
            faces = self.wrench_faces()[:N_DIRECTIONS]
            found = np.sqrt(weights[EPSILON]) * faces[:, :6]
            self.residuals.set_directions(found, self.least_resistance + gain)
        if problem.objectives:
            points, outward = self.contacts()
            point = GraspPoint(
                task=task,
                q=self._unknowns.q(self.x),
                points=points,
                inward=-outward,
                wrenches=resisted_wrenches(task, options.task_wrenches),
            )
            self.residuals.set_objectives(objective_parameters(problem.objectives, weights, point))

    def candidate(self, status: str, begin: float) -> Candidate:
        """The result at x, where the residuals were called last; CPU time counts from ``begin``."""
        violation = self.residuals.violations()
        return self._problem.candidate(
            self.start, self.x, violation, status, self.iterations, begin
        )


def _contacts(shape: Shape, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Contacts (n, 3) and outward normals (n, 3): of a mesh, on its smooth surface."""
    if not isinstance(shape, Mesh):
        return shape.closest_point(points)
    slopes = shape.field().taylor(points, 1)[:, 1:4]
    return points, slopes / np.maximum(np.linalg.norm(slopes, axis=1, keepdims=True), TINY)


TINY = 1e-9
"""A gradient shorter than this has no direction."""
