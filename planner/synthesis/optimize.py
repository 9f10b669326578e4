"""From a start to a strong grasp by least squares: reach a grasp, improve it, repair it.

A first run (``planner.numerics.least_squares``) satisfies the terms; a start from which it
fails is abandoned. Rounds improve the objectives (``planner.synthesis.objectives``). Each
round finds the directions of wrench in which the grasp resists least (``planner.quality.weakest``)
and takes a few steps with resistance there as a further cost. A last run without objectives repairs
the violated terms.

Bars and hulls are wider in places than the spheres and capsules that stand for them. For hands with
such links the true distances are measured after each run, and pairs that are too near are kept
apart in the next one (``planner.synthesis.terms.link_distance``), which saves attempts.

From a grasp to the best one near it: an ascent that stays among solved grasps.

The rounds of ``planner.synthesis.optimize`` leave the terms for the objective and return at the
end, wherever that is: of twenty rounds the last is rarely the best. A step here is a short run with
the objectives and one without, and it counts only if the grasp is solved again and better;
otherwise the grasp before it comes back and the next step aims nearer. Costs that keep a first
grasp in an ordinary posture would hold the ascent back, so they weigh little.

``nearby_start`` draws a start beside a grasp, from where another ascent may end higher.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from planner.collision.world import CollisionWorld
from planner.hands.hand import Hand
from planner.numerics.least_squares import MAX_ITERATIONS, SLOW, SOLVED, LMResult
from planner.quality.weakest import wrench_faces
from planner.shapes import Mesh, Shape
from planner.spatial import SE3, FloatArray
from planner.synthesis.objectives import EPSILON, objective_parameters, resisted_wrenches
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


STEPS = 12
"""Most steps: after some ten the gain of one is below a hundredth."""

FIRST_STEPS = 4
"""Most steps while there is nothing to beat: what comes first should come soon, and starts beside
it go on."""

STEP_ITERATIONS, RETURN_ITERATIONS = 5, 8
"""Evaluations of a step with the objectives, and of the return to the terms."""

LIGHT = 0.05
"""Share of their weights that the costs keep."""

DAMPING = 1.0
"""Damping of the first step: contacts of a solved grasp may move by centimetres."""

LEAST_RISE = 1e-3
"""Share by which a step must raise the value."""

SHRINK, GROW, LEAST_GAIN, MOST_GAIN = 0.4, 1.5, 0.02, 0.3
"""Factors on the target of a step after a poor and a good one, and its limits (-)."""

POOR, GOOD = 0.01, 0.5
"""A step is poor below this share of the value, good above this share of its target."""

HEAVIER = 3.0
"""Factor on the damping after a step that is taken back."""

LEAST_SHARES = {2: 0.5, 4: 0.7, 8: 0.9, STEPS: 0.9}
"""Steps -> share of the best value below which the ascent is given up: values a few steps later
rarely exceed it."""

MEASURED_EVERY = 3
"""Steps that one measurement of the true distances between links serves."""

TURN, SHIFT, JOINT, POINT = 0.09, 0.003, 0.03, 0.0045
"""Standard deviations of a start beside a grasp: base (rad, m), joints (share of their range),
contact points (m)."""


def with_light_costs(options: SynthesisOptions) -> SynthesisOptions:
    """The options of an ascent: the same margins and objectives, little weight on the costs."""
    return replace(
        options,
        weight_tangential=LIGHT * options.weight_tangential,
        weight_share=LIGHT * options.weight_share,
        weight_posture=LIGHT * options.weight_posture,
        weight_center=LIGHT * options.weight_center,
    )


def climb(
    run: GraspRun,
    options: SynthesisOptions,
    *,
    value: Callable[[GraspRun], float],
    best: float,
    world: CollisionWorld | None,
) -> float | None:
    """Raise the value of a solved run; the value reached, or None if it was given up.

    Args:
        run: Solved, with the parameters of ``with_light_costs``; it ends at the best grasp.
        options: Objectives.
        value: What is to be large, of the run at its x.
        best: Value to beat; -inf for none.
        world: True geometry, where capsules stand for wider links.
    """
    _return(run, options, world, MEND_ITERATIONS)
    now, kept, gain, damping = value(run), run.x, GAIN, DAMPING
    for step in range(1, (STEPS if best > -np.inf else FIRST_STEPS) + 1):
        run.update_objectives(options, gain)
        if step % MEASURED_EVERY == 0:
            run.refresh_link_distances(world, options)
        run.solve(STEP_ITERATIONS, damping, slow=0.0)
        reached = run.end.damping
        run.drop_objectives()
        if run.end.worst > SOLVED:
            run.solve(RETURN_ITERATIONS, slow=np.inf)
        then = value(run) if run.end.worst <= NEARLY else -np.inf
        if then > now + LEAST_RISE * abs(now):
            if then - now > GOOD * gain:
                gain = min(gain * GROW, MOST_GAIN)
            elif then - now < POOR * abs(now):
                gain *= SHRINK
            now, kept, damping = then, run.x, reached or DAMPING
        else:
            run.x = kept
            gain *= SHRINK
            damping = max(damping, MIN_DAMPING) * HEAVIER
            if EPSILON not in options.weights:
                break  # without a target to bring nearer the same step would come again
        if gain < LEAST_GAIN:
            break
        if now < LEAST_SHARES.get(step, 0.0) * best:
            return None
    if now < LEAST_SHARES[STEPS] * best:
        return None
    run.x = kept
    _return(run, options, world, MEND_ITERATIONS)
    return now


MIN_DAMPING = 1e-3
"""Least damping after a step that is taken back."""


def _return(
    run: GraspRun, options: SynthesisOptions, world: CollisionWorld | None, budget: int
) -> None:
    """Satisfy the terms alone from x, with pairs of links kept apart that are too near."""
    run.drop_objectives()
    run.refresh_link_distances(world, options)
    run.solve(budget, slow=np.inf)


def nearby_start(hand: Hand, start: Start, candidate: Candidate, rng: np.random.Generator) -> Start:
    """A start beside a grasp: base, joints and contacts moved at random by little.

    A base that is fixed and joints that are frozen stay.

    Args:
        hand: The hand.
        start: Where the grasp came from.
        candidate: The grasp.
        rng: Random numbers.
    """
    turn, shift = TURN * rng.normal(size=3), SHIFT * rng.normal(size=3)
    joints = JOINT * rng.normal(size=hand.nq) * (hand.q_upper - hand.q_lower)
    points = candidate.points + POINT * rng.normal(size=candidate.points.shape)
    pose = candidate.T_object_base
    if not (start.base_fixed or hand.arm is not None):
        middle, rotation = candidate.points.mean(axis=0), pin.exp3(turn)
        place = middle + rotation @ (pose.translation - middle) + shift
        pose = SE3(rotation @ pose.rotation, place)
    q = np.where(start.frozen, start.q, candidate.q + joints)
    return replace(
        start,
        T_object_base=pose,
        q=np.clip(q, hand.q_lower, hand.q_upper),
        points=points,
        forces=candidate.forces,
    )
