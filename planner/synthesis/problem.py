"""The grasp-synthesis problem: built once per hand, fingers and kind of shape, solved many times.

Unknowns, all in the object's frame:

    s       (3,)     turn of the base from the start's orientation R0, modified Rodrigues parameters
    t       (3,)     position of the base, m
    q       (nq,)    joints, rad or m
    p_i     (3,)     contact point of finger i on the object's surface, m
    f_i     (3,)     force of finger i on the object, in units of the mean normal force

Terms (named residuals, each an equality or an inequality):

    touch    c_i(q) - (p_i + r_i n_i)            = 0    pad centre is one radius off the surface
    surface  g(p_i)                              = 0    contact point on its patch
    balance  sum f_i, sum p_i x f_i / length     = 0    an internal force ...
    level    (sum f_i . -n_i) / n_contacts - 1   = 0    ... of unit mean normal force ...
    cone     (k mu)^2 fn_i^2 - |ft_i|^2         >= 0    ... strictly inside every friction cone,
    press    fn_i - PRESS_MIN                   >= 0
    facing   pad axis . -n_i - cos(half angle)  >= 0    the pad touches, not the nail
    stop     torque of each one-sided stop      >= 0    a stop can only push
    object   clearance of link balls            >= 0    (the true links may be a little nearer)
    table    height of all balls over the table >= 0
    obstacle clearance of balls from obstacles  >= 0
    fingers  squared distance of bones of different fingers, less the least     >= 0
    coupling C q - d                             = 0
    arm      where the arm's joints put its last link, less where s and t put it = 0

The base of a hand on an arm is the arm's root, which is fixed. There s and t move the arm's last
link, to which the arm's joints are tied by the term ``arm``: the terms of the hand stay as they are
for a floating one. With the joints alone as unknowns 30 of 60 attempts were solved, so 41.

An internal force strictly inside all cones together with rank G = 6 is force closure (Murray, Li,
Sastry 1994, proposition 5.3); rank follows from three contacts that are not on a line. The cost
keeps forces near the normals, shares them evenly, keeps contacts around the centre of mass and
joints near the pinch posture.

The same terms are solved in two ways. ``planner.synthesis.optimize`` takes them as residuals of a
least-squares problem, inequalities counting where they are violated and the cost
weighing little: a few milliseconds from a start to a grasp or to nothing. ``solve`` gives them to
IPOPT as the constrained programme they are, with exact second derivatives: to its optimum, in ten
times as long.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.kinematics.state import HandState
from planner.shapes import Shape
from planner.shapes.surface import Patch, Surface
from planner.spatial import SE3, FloatArray
from planner.synthesis.avoid import Avoidance
from planner.synthesis.nlp import Nlp
from planner.synthesis.options import SynthesisOptions
from planner.synthesis.residuals import Residuals
from planner.synthesis.surfaces import surface_of
from planner.synthesis.surroundings import obstacles_in_object, table_in_object
from planner.synthesis.terms import Formulation, Term, formulate
from planner.system.threads import built
from planner.task import GraspTask

__all__ = ["Candidate", "GraspProblem", "Start", "build_problem"]


@dataclass(frozen=True, kw_only=True)
class Start:
    """Where a solver starts; poses and points in the object's frame.

    Attributes:
        T_object_base: Pose of the hand's base.
        q: (nq,).
        points: (n, 3), contact points, m.
        forces: (n, 3), in units of the mean normal force.
        patches: The patch that each finger is assigned to.
        frozen: Joints that stay at ``q``, boolean (nq,).
        base_fixed: Whether the base stays at ``T_object_base``.
    """

    T_object_base: SE3
    q: FloatArray
    points: FloatArray
    forces: FloatArray
    patches: tuple[Patch, ...]
    frozen: FloatArray
    base_fixed: bool = False


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """Where a solver ended; ``violation`` is recomputed from the terms, never the solver's word.

    Attributes:
        T_object_base: Pose of the base in the object's frame.
        q: (nq,).
        points: (n, 3), m.
        forces: (n, 3), object frame, in units of the mean normal force.
        violation: Largest violation per term, in its unit.
        status: What the solver says.
        iterations: Its iterations.
        cpu_s: CPU time, s.
    """

    T_object_base: SE3
    q: FloatArray
    points: FloatArray
    forces: FloatArray
    violation: dict[str, float]
    status: str
    iterations: int
    cpu_s: float


@dataclass(frozen=True, eq=False)
class GraspProblem:
    """The problem of one hand, finger set and kind of shape.

    Attributes:
        hand: The hand.
        fingers: Fingers that take part, in order of the contacts.
        surface: Form of the shape in the terms.
        n_obstacles: How many obstacle boxes there are.
        residuals: The terms and the cost as residuals with their Jacobian, to be looked at; a
            descent works with a twin of them, since threads share the problem.
        objectives: Names of the objectives that have rows of their own here.
    """

    hand: Hand
    fingers: tuple[Finger, ...]
    surface: Surface
    n_obstacles: int
    residuals: Residuals
    objectives: tuple[str, ...] = ()

    @property
    def formulation(self) -> Formulation:
        """Unknowns, parameters, terms without clearances, and cost."""
        return self.residuals.formulation

    @built
    def whole(self) -> tuple[Formulation, Surface]:
        """All as expressions, clearances too, and the surface that collected its field points."""
        surface = self.surface.anew()
        formulation = formulate(self.hand, self.fingers, surface, self.n_obstacles, self.objectives)
        return formulation, surface

    @property
    def terms(self) -> tuple[Term, ...]:
        """The constraints."""
        return self.whole[0].terms

    @built
    def nlp(self) -> Nlp:
        """The terms as a programme for IPOPT, built when it is first asked for."""
        f, surface = self.whole
        return Nlp(
            "grasp",
            x=f.x,
            p=f.p,
            cost=ca.sumsqr(f.cost_rows),
            g=ca.vertcat(*[t.expression for t in f.terms]),
            options=IPOPT_OPTIONS,
            points=surface.field,
        )

    def __str__(self) -> str:
        """Variables, parameters and terms, one line each."""
        f = self.formulation
        lines = [
            f"grasp problem: {self.hand.name}, {', '.join(f.name for f in self.fingers)}, "
            f"{self.surface.kind}",
            f"  {f.x.numel()} variables, {f.p.numel()} parameters",
        ]
        lines += [
            f"  {t.name:10s} {t.expression.numel():4d} {' =' if t.equality else '>='} 0  [{t.unit}]"
            for t in self.terms
        ]
        return "\n".join(lines)

    def solve(self, task: GraspTask, start: Start, parameters: FloatArray) -> Candidate:
        """Run IPOPT from one start: all terms and the cost, without objectives.

        Args:
            task: The task.
            start: The start.
            parameters: From ``parameters``.
        """
        solver = self.nlp.bind(self.surface.field_of(task.object.shape))
        lower, upper = self.bounds(start)
        sizes = [(t.expression.numel(), t.equality) for t in self.terms]
        ubg = np.concatenate([np.full(m, 0.0 if equality else np.inf) for m, equality in sizes])
        begin = time.process_time()
        x, stats = solver(
            x0=np.clip(self.first(start), lower, upper),
            p=parameters,
            lbx=lower,
            ubx=upper,
            lbg=np.zeros(len(ubg)),
            ubg=ubg,
        )
        x = np.clip(x, lower, upper)  # IPOPT goes 1e-8 beyond bounds
        violation = self.violations(solver.evaluate(x, parameters))
        status, iterations = str(stats["return_status"]), int(stats["iter_count"])
        return self.candidate(start, x, violation, status, iterations, begin)

    def candidate(
        self,
        start: Start,
        x: FloatArray,
        violation: dict[str, float],
        status: str,
        iterations: int,
        begin: float,
    ) -> Candidate:
        """What a solver found: unknowns x, violations, its words, and CPU time since ``begin``."""
        unknowns = self.formulation.unknowns
        return Candidate(
            T_object_base=self.base_pose(start, x),
            q=unknowns.q(x),
            points=unknowns.points(x),
            forces=unknowns.forces(x),
            violation=violation,
            status=status,
            iterations=iterations,
            cpu_s=time.process_time() - begin,
        )

    def base_pose(self, start: Start, x: FloatArray) -> SE3:
        """Pose of the hand's base in the object's frame at unknowns x; an arm's root stays."""
        if self.hand.arm is not None:
            return start.T_object_base
        return self.formulation.unknowns.pose(x, start.T_object_base)

    def first(self, start: Start) -> FloatArray:
        """The unknowns at a start."""
        origin = np.array(self._carrier(start).translation)
        return self.formulation.unknowns.pack(
            np.zeros(3), origin, start.q, start.points, start.forces
        )

    def bounds(self, start: Start) -> tuple[FloatArray, FloatArray]:
        """Lower and upper bounds of the unknowns."""
        n = len(self.fingers)
        still = start.base_fixed and self.hand.arm is None
        turn, shift = (0.0, 0.0) if still else (TURN_MAX, SHIFT_MAX)
        origin = np.array(self._carrier(start).translation)
        pack, force = self.formulation.unknowns.pack, np.full((n, 3), float(4 * n))
        lower = pack(
            np.full(3, -turn),
            origin - shift,
            np.where(start.frozen, start.q, self.hand.q_lower),
            np.array([patch.lower for patch in start.patches]),
            -force,
        )
        upper = pack(
            np.full(3, turn),
            origin + shift,
            np.where(start.frozen, start.q, self.hand.q_upper),
            np.array([patch.upper for patch in start.patches]),
            force,
        )
        return lower, upper

    def _carrier(self, start: Start) -> SE3:
        """Pose in the object's frame of what s and t move: the base, or the last link of an arm."""
        if self.hand.arm is None:
            return start.T_object_base
        state = HandState(self.hand, start.q)
        return start.T_object_base * state.joint_pose(self.hand.arm.flange)

    def violations(self, g: FloatArray) -> dict[str, float]:
        """Largest violation of each term, in its unit, from the values of all constraints."""
        out, at = {}, 0
        for t in self.terms:
            part = g[at : at + t.expression.numel()]
            at += len(part)
            bad = np.abs(part) if t.equality else np.maximum(-part, 0)
            out[t.name] = float(bad.max(initial=0.0))
        return out

    def parameters(
        self, task: GraspTask, start: Start, posture: FloatArray, options: SynthesisOptions
    ) -> FloatArray:
        """Pack the parameters.

        Args:
            task: Object, table, obstacles and friction.
            start: Gives the reference orientation and the patches.
            posture: Preferred q (nq,); that of an arm's joints is where the start has them.
            options: Margins and weights.
        """
        root: list[FloatArray] = []
        posture = posture.copy()
        posture[self.hand.arm_index] = start.q[self.hand.arm_index]
        if self.hand.arm is not None:
            T = start.T_object_base
            root = [np.array(T.rotation).ravel(order="F"), T.translation]
        shape = task.object.shape
        return self.formulation.pack(
            {
                "reference": np.array(self._carrier(start).rotation).ravel(order="F"),
                "root": np.concatenate(root) if root else (),
                "size": self.surface.size(shape),
                "codes": [patch.code for patch in start.patches],
                "table": table_in_object(task),
                "obstacles": obstacles_in_object(task),
                "mu": task.mu,
                "length": shape.bounding_radius,
                "posture": posture,
                **options.values(),
                "objectives": 0.0,
                "aim": 0.0,
                "directions": 0.0,
            }
        )


TURN_MAX = 1.0
"""Bound of each modified Rodrigues parameter: a full half turn from the start's orientation."""

SHIFT_MAX = 0.25
"""How far (m) the base may move from where the start put it, along each axis."""


def build_problem(
    hand: Hand,
    fingers: Sequence[Finger],
    kind_of: Shape,
    n_obstacles: int = 0,
    objectives: tuple[str, ...] = (),
) -> GraspProblem:
    """Build the problem for a hand, the fingers that take part and a kind of shape.

    Args:
        hand: The hand.
        fingers: The fingers that take part.
        kind_of: Any shape of the kind; its size does not matter.
        n_obstacles: How many obstacle boxes there are.
        objectives: Objectives that are asked for and have rows of their own, by name.
    """
    fingers = tuple(fingers)
    surface = surface_of(kind_of)
    formulation = formulate(hand, fingers, surface, n_obstacles, objectives, clearances=False)
    avoidance = Avoidance(formulation, surface)
    residuals = Residuals(formulation, surface.field, avoidance)
    return GraspProblem(hand, fingers, surface, n_obstacles, residuals, objectives)


IPOPT_TOL = 1e-4
"""IPOPT's scaled optimality tolerance (-). Constraints are held to 1e-7 m; the cost only ranks."""

IPOPT_ITERATIONS = 60
"""IPOPT iterations of one attempt; nine of ten that succeed need under 50."""

IPOPT_OPTIONS = {
    "ipopt.max_iter": IPOPT_ITERATIONS,
    "ipopt.tol": IPOPT_TOL,
    "ipopt.constr_viol_tol": 1e-7,
    "ipopt.acceptable_tol": 1e-2,
    "ipopt.acceptable_constr_viol_tol": 1e-6,
    "ipopt.acceptable_iter": 3,
    "ipopt.mu_strategy": "adaptive",
    "ipopt.adaptive_mu_globalization": "never-monotone-mode",
}
"""Never-monotone adaptive barrier: more attempts succeed than with any other of IPOPT's."""
