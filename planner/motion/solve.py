"""From a start to a motion by least squares: a given path, or as much of it as there is.

A start is a grasp of the object in the middle of its path. A given path is asked for at once
(``solve_path``): the first residuals are centimetres, and the solver removes them. Asking for it in
steps costs half as much again and finds hardly more (20 instead of 19 of 20 starts, Allegro-type
hand, 95 degrees). To go as far as possible (``maximise_path``) the path parameter is an unknown
with a residual that pulls at it; then it is fixed a little below where the terms held it, and the
terms alone are solved again.

IPOPT got the same programme (five knots, 192 unknowns, even without clearances) and was not done
after 150 iterations and a second, from any of four starts; descents took a quarter of that, with
clearances.

What limits a path: multipliers of the least squares that pulled it longer.

Where the pull r0 = w (1 - share) and the violated terms r_i balance, least squares are stationary:

    sum_i r_i dr_i/dz = w (w (1 - share)) e_share - (forces of the bounds).

So r_i / (w (1 - share)) is the growth of the share per unit by which the limit behind r_i is
relaxed; the same holds for the force of a bound. Limits are joint ends, pad rims, clearances,
friction cones and the path tolerance, each with its knot.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from planner.failure import Failure
from planner.motion.path import ObjectPath
from planner.motion.plan import Limit
from planner.motion.problem import MotionNumbers, MotionProblem
from planner.motion.residuals import MotionResiduals
from planner.motion.terms import REACH
from planner.motion.unknowns import OFFSET, SHARE
from planner.numerics.least_squares import PATIENCE, STALLED, levenberg_marquardt
from planner.quality.weakest import weakest_directions
from planner.spatial import FloatArray
from planner.synthesis.optimize import (
    FORCE_SCALE,
    JOINT_SCALE,
    POINT_SCALE,
    SHIFT_SCALE,
    SMALLEST_RANGE,
    TURN_SCALE,
    optimize_grasp,
)
from planner.synthesis.options import SynthesisOptions, with_room
from planner.synthesis.problem import Start
from planner.synthesis.terms.term import Role
from planner.task import GraspTask

PARAMETER_SCALE, OFFSET_SCALE = 0.1, 0.01
"""Steps that count as alike: of the path parameter (-), of the offset from the path (m)."""

REACHING = 80
"""Evaluations of the descent that reaches a given path, or pulls."""

HOLDING = 40
"""Evaluations of a descent that makes good what pulling or strengthening cost the terms."""

SMALL_GAIN, SMALL_GAINS = 0.01, 5
"""``STALLED`` and ``PATIENCE`` of a descent that asks for all of a path, without holds; others have
those of grasps, since what pulls at a path has to come to rest: its multipliers tell what limits
it. Of 64 starts on cylinders of 5 to 7 cm, 98 degrees, 27 hold with either, at a fifth more time
with those of grasps; 22 with 3 steps, and 22 with 2 % and 5 steps."""

DIRECTIONS = 12
"""Directions of wrench that a round works on at each knot."""

RESISTANCE_TARGET = 0.3
"""Resistance (normal forces sum to 1) that is aimed at in each: more than grasps reach."""

STRENGTHENING = 10
"""Evaluations of a round that works on closure."""

WORTH_A_LOOK = 0.3
"""Largest weighted residual (mm, where a length is involved) of a motion worth verifying: less than
for a grasp, since every term is met by the least-squares descent at every knot."""

RELAX, RELAXINGS = 0.95, 5
"""Factor on the path parameter that the pull reached, and how often it is applied at most: until a
candidate has a good verdict."""


@dataclass(frozen=True, kw_only=True)
class MotionCandidate:
    """Where a solver ended.

    Attributes:
        path_parameter: How far along the path the candidate goes, 0 to 1.
        grasps: Every knot as a grasp's unknowns (n_knots, size).
        reference: R0 (3, 3) of those.
        worst: Largest weighted residual of a term.
        failure: Which term that is, where it is too large for the motion to be verified; else None.
        limits: What keeps the path from being longer, where as much as there is was asked for.
        iterations: Evaluations.
    """

    path_parameter: float
    grasps: FloatArray
    reference: FloatArray
    worst: float
    failure: Failure | None
    limits: tuple[Limit, ...]
    iterations: int


class MotionSolver:
    """Solves for motions of one task along one path."""

    def __init__(
        self,
        problem: MotionProblem,
        task: GraspTask,
        path: ObjectPath,
        options: SynthesisOptions,
        *,
        path_tolerance: float,
        posture: FloatArray,
        rounds: int,
        exact_end: bool = False,
    ) -> None:
        """Keep what all starts share.

        Args:
            problem: The problem of the task's hand, fingers and kind of shape.
            task: The task.
            path: Where the object is to go.
            options: Margins and weights of each knot.
            path_tolerance: How far the object may leave its path, m.
            posture: Preferred joints (nq,).
            rounds: How many rounds work on the closure of all knots.
            exact_end: Whether the object ends on its path, and leaves it on the way only.
        """
        self._exact_end = exact_end
        self.problem, self.task, self.path = problem, task, path
        self.path_tolerance = path_tolerance
        self._options, self._posture = options, posture
        self._roomy = with_room(options, task)
        self._first = replace(self._roomy, rounds=0)
        self._rounds = rounds
        self._field = problem.grasp.surface.field_of(task.object.shape)
        hand, u = task.hand, problem.unknowns
        n, k = len(task.fingers), u.n_knots
        span = np.maximum(hand.q_upper - hand.q_lower, SMALLEST_RANGE)
        rest = np.concatenate(
            [
                np.minimum(JOINT_SCALE, span),
                np.full(3 * n, POINT_SCALE),
                np.full(3 * n, FORCE_SCALE),
            ]
        )
        shared = np.repeat([TURN_SCALE, SHIFT_SCALE, PARAMETER_SCALE], [3, 3, 1])
        self._scale = u.pack(
            shared,
            np.full((k, 3), OFFSET_SCALE),
            np.tile(rest, (k, 1)),
            np.full((u.n_stances, u.stance_size), FORCE_SCALE),
        )

    def solve_path(self, start: Start) -> Iterator[MotionCandidate]:
        """All of the path, from a start in its middle; then what rounds on closure make of it."""
        run = _Descent(self, start)
        run.in_haste = not self.problem.stances
        run.fix(1.0)
        run.descend(REACHING)
        if run.worst > WORTH_A_LOOK and run.has_room:
            run.give_up_room()
            run.descend(HOLDING)
        if (
            run.worst > WORTH_A_LOOK and run.residuals.numbers.pivoting_costs
        ):  # pivoting is a cost that need not hold: try again without it
            run.residuals.numbers = replace(run.residuals.numbers, pivoting_costs=False)
            run.descend(HOLDING)
        yield run.candidate(())
        if run.worst <= WORTH_A_LOOK and self._rounds:
            for _ in range(self._rounds):
                run.strengthen(STRENGTHENING)
            run.weaken()
            run.descend(HOLDING)
            yield run.candidate(())

    def maximise_path(self, start: Start) -> Iterator[MotionCandidate]:
        """As much of the path as there is, from a start in its middle; then less and less of it."""
        run = _Descent(self, start)
        if run.has_room:
            run.give_up_room()
        run.residuals.pull = REACH.weight * run.residuals.length
        run.descend(REACHING)
        limits = what_limits(run.residuals, run.z, run.lower, run.upper)
        run.residuals.pull = 0.0
        path_parameter = run.z[SHARE]
        for _ in range(RELAXINGS):
            path_parameter *= RELAX
            run.fix(path_parameter)
            run.descend(HOLDING)
            yield run.candidate(limits)

    def _grasped(self, start: Start) -> Start:
        """The same start with the grasp that it leads to."""
        one = self.problem.grasp
        parameters = one.parameters(self.task, start, self._posture, self._roomy)
        return start.at(optimize_grasp(one, self.task, start, parameters, self._first))


class _Descent:
    """Where a motion has come to, and within which bounds it may move on.

    Attributes:
        has_room: Whether room for joints that are off is asked for (``planner.synthesis.options``).
    """

    def __init__(self, solver: MotionSolver, start: Start) -> None:
        self._solver = solver
        self._start = start = solver._grasped(start)
        problem = solver.problem
        self.has_room = solver._roomy is not solver._options
        self.residuals = MotionResiduals(problem, self._numbers(), solver._field)
        self.lower, self.upper = problem.bounds(
            start, solver.path_tolerance, exact_end=solver._exact_end
        )
        self.z = np.clip(problem.first(start), self.lower, self.upper)
        self.worst = np.inf
        self.in_haste = False  # whether small gains end a descent
        self._iterations = 0

    def _numbers(self) -> MotionNumbers:
        """The parameters, with room or without."""
        s = self._solver
        options = s._roomy if self.has_room else s._options
        return s.problem.numbers(s.task, s.path, self._start, s._posture, options, s.path_tolerance)

    def give_up_room(self) -> None:
        """From now on ask for no more distance than if joints were exact."""
        self.has_room = False
        for one, knot in zip(self.residuals.grasped, self._numbers().knots, strict=True):
            one.set_parameters(knot, self._solver._field)

    def fix(self, path_parameter: float) -> None:
        """From now on exactly up to this path parameter."""
        self.lower[SHARE] = self.upper[SHARE] = self.z[SHARE] = path_parameter

    def descend(self, budget: int) -> None:
        """Move on by at most ``budget`` evaluations."""
        end = levenberg_marquardt(
            self.residuals,
            np.clip(self.z, self.lower, self.upper),
            lower=self.lower,
            upper=self.upper,
            scale=self._solver._scale,
            max_iterations=budget,
            stalled=SMALL_GAIN if self.in_haste else STALLED,
            patience=SMALL_GAINS if self.in_haste else PATIENCE,
        )
        self.z, self.worst = end.x.copy(), end.worst
        self._iterations += end.iterations

    def strengthen(self, budget: int) -> None:
        """Work on the directions of wrench in which each knot resists least."""
        task, problem = self._solver.task, self._solver.problem
        shape, u = task.object.shape, problem.unknowns
        grasps = self.residuals.grasps(self.z)
        for one, x in zip(self.residuals.grasped, grasps, strict=True):
            points, outward = shape.closest_point(u.grasp.points(x))
            found = weakest_directions(points, -outward, task.mu, shape.bounding_radius, DIRECTIONS)
            found = found / np.sqrt(u.n_knots)  # all knots together count like one grasp
            one.set_directions(found, RESISTANCE_TARGET)
        self.descend(budget)

    def weaken(self) -> None:
        """Leave closure to the terms again."""
        for one in self.residuals.grasped:
            one.set_directions(np.zeros((0, 6)))

    def candidate(self, limits: tuple[Limit, ...]) -> MotionCandidate:
        """Where it is now."""
        return MotionCandidate(
            path_parameter=float(self.z[SHARE]),
            grasps=self.residuals.grasps(self.z),
            reference=self.residuals.numbers.reference,
            worst=self.worst,
            failure=worst_term(self.residuals, self.z) if self.worst > WORTH_A_LOOK else None,
            limits=limits,
            iterations=self._iterations,
        )


LISTED = 6
"""Largest number of limits in a report."""

AT_BOUND = 1e-9
"""Distance (rad or m) from a bound below which an unknown is on it."""

PER_UNIT = {
    "m": (1e-3, "mm"),
    "rad": (np.pi / 180, "degree"),
    "m2": (1e-6, "mm2"),
    "-": (0.01, "0.01"),
}
"""A step of each unit for reports, and its name."""


def what_limits(
    residuals: MotionResiduals, z: FloatArray, lower: FloatArray, upper: FloatArray
) -> tuple[Limit, ...]:
    """The limits that count most where the pull has come to rest, largest gain first.

    Args:
        residuals: With the pull on.
        z: Where least squares ended.
        lower: Least z.
        upper: Largest z.
    """
    r, blocks = residuals(z)
    jacobian = blocks.dense()
    missing = residuals.pull * (1.0 - z[SHARE])
    if missing <= 0.0:
        return ()
    scale = 1.0 / (residuals.pull * missing)
    found = [*_joints(residuals, z, jacobian.T @ r, lower, upper, scale)]
    found += _terms(residuals, r, scale)
    found.sort(key=lambda limit: -limit.gain)
    best: dict[str, Limit] = {}
    for limit in found:
        best.setdefault(limit.what, limit)
    return tuple(list(best.values())[:LISTED])


def _joints(
    residuals: MotionResiduals,
    z: FloatArray,
    slope: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    scale: float,
) -> Iterator[Limit]:
    """Ends of joints' ranges with a force against them."""
    problem = residuals.problem
    hand, u = problem.grasp.hand, problem.unknowns
    degree, unit = PER_UNIT["rad"]
    for k in range(u.n_knots):
        at = u.columns(k).start + OFFSET
        for j, name in enumerate(hand.joint_names):
            i = at + j
            if upper[i] <= lower[i]:
                continue
            low = z[i] <= lower[i] + AT_BOUND and slope[i] > 0
            high = z[i] >= upper[i] - AT_BOUND and slope[i] < 0
            if low or high:
                finger = next((f.name for f in hand.fingers.values() if name in f.joints), "")
                yield Limit(
                    what=f"joint {name} at its {'lower' if low else 'upper'} limit",
                    finger=finger,
                    joint=name,
                    path_parameter=float(residuals.numbers.path_parameters[k]),
                    gain=abs(float(slope[i])) * scale * degree,
                    unit=unit,
                )


def _terms(residuals: MotionResiduals, r: FloatArray, scale: float) -> Iterator[Limit]:
    """Violated inequalities."""
    fingers = residuals.problem.grasp.hand.fingers
    for row, value in zip(residuals.row_names(), r, strict=True):
        if row.term.role is not Role.INEQUALITY:
            continue
        step, unit = PER_UNIT[row.term.unit]
        yield Limit(
            what=str(row),
            finger=next((name for name in row.about if name in fingers), ""),
            joint="",
            path_parameter=float(residuals.numbers.path_parameters[row.knot]),
            gain=abs(float(value)) * row.term.weight * scale * step,
            unit=unit,
        )


def worst_term(residuals: MotionResiduals, z: FloatArray) -> Failure:
    """The term with the largest weighted residual at z; a failure's kind is that of its term."""
    r, _ = residuals(z)
    rows = [row for row in residuals.row_names()[: residuals.n_terms] if row.term is not REACH]
    k = int(np.abs(r[: len(rows)]).argmax())
    term, place = rows[k].term, float(residuals.numbers.path_parameters[rows[k].knot])
    step, unit = WORDS[term.unit]
    off = abs(float(r[k])) / term.weight
    return Failure(
        kind=f"unsolved_{term.name}",
        text=f"{rows[k]} at {100 * place:.0f} % of the path, off by {off / step:.2g}{unit}",
        numbers={"place": place, "off": off},
    )


WORDS = {"m": (1e-3, " mm"), "rad": (np.pi / 180, " degrees"), "m2": (1e-6, " mm2"), "-": (1.0, "")}
"""For each unit the one in messages, and its name."""
