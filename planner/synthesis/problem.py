"""The grasp-synthesis problem: built once per hand, fingers and kind of shape, solved many times.

Unknowns, all in the object's frame:

    s       (3,)     turn of the base from the start's orientation R0, modified Rodrigues parameters
    t       (3,)     position of the base, m
    q       (nq,)    joints, rad or m
    p_i     (3,)     contact point of finger i on the object's surface, m
    f_i     (3,)     force of finger i on the object, in units of the mean normal force

``print(build_problem(...))`` lists the terms: what each means, its role, unit, weight and margin,
how many rows it has, and who judges it (``planner.synthesis.terms``, one family a file). They are
the rows that ``planner.synthesis.optimize`` solves as least squares, where an inequality counts
while it is violated.

The base of a hand on an arm is the arm's root, which is fixed. There s and t move the arm's last
link, to which the term ``arm`` ties the arm's joints: the terms of the hand are those of a floating
one. With the joints alone as unknowns fewer attempts are solved.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.kinematics import moving_hand
from planner.numerics.kernels import kernels_are_compiled
from planner.shapes import Shape
from planner.shapes.base import Patch, Surface
from planner.spatial import SE3, FloatArray
from planner.synthesis.mesh_surface import Field, surface_of
from planner.synthesis.options import ProblemForm, SynthesisOptions, table_room
from planner.synthesis.residuals import Formulation, Residuals, formulate
from planner.synthesis.symbols import obstacles_in_object, table_in_object
from planner.synthesis.terms.registry import TERMS
from planner.synthesis.terms.term import Term, WrittenTerm, table_of
from planner.system.threads import BUILDING, built, made_once
from planner.task import GraspTask

if TYPE_CHECKING:
    from planner.synthesis.loops.solver import LoopProblem, LoopResiduals


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
    frozen: NDArray[np.bool_]
    base_fixed: bool = False

    def at(self, candidate: Candidate) -> Start:
        """The same start where a solver ended."""
        return replace(
            self,
            T_object_base=candidate.T_object_base,
            q=candidate.q,
            points=candidate.points,
            forces=candidate.forces,
        )


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """Where a solver ended; ``violation`` is recomputed from the terms, not taken from the solver.

    Attributes:
        T_object_base: Pose of the base in the object's frame.
        q: (nq,).
        points: (n, 3), m.
        forces: (n, 3), object frame, in units of the mean normal force.
        violation: Largest violation per term, in its unit.
        status: Status of the solver.
        iterations: Evaluations of the residuals.
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
        residuals: The terms as residuals with their Jacobian, read only; a run of least squares
            works with a clone of them, since threads share the problem.
        objectives: Names of the objectives that have rows of their own here.
        own_terms: The terms beside the standard ones.
    """

    hand: Hand
    fingers: tuple[Finger, ...]
    surface: Surface
    residuals: Residuals
    objectives: tuple[str, ...] = ()
    own_terms: tuple[Term, ...] = ()

    @property
    def formulation(self) -> Formulation:
        """Unknowns, parameters, and the terms that are written as expressions."""
        return self.residuals.formulation

    @built
    def terms(self) -> tuple[WrittenTerm, ...]:
        """All terms with their rows, in the order of the residuals.

        Clearances from primitives, table, obstacles and other fingers are expressions too: any
        solver of CasADi can take the problem. Those from a mesh are looked up in its field.
        """
        return self.residuals.written

    def __str__(self) -> str:
        """Variables, parameters and all terms, one line each."""
        return f"{self._head}\n{table_of(self.terms)}"

    @built
    def _loops(self) -> LoopProblem | None:
        from planner.synthesis.loops.solver import loop_problem  # here: for what lasts

        return loop_problem(self.residuals)

    def least_squares(self, p: FloatArray, field: Field | None) -> Residuals | LoopResiduals:
        """The residuals of one run with parameters p, and the field of a mesh.

        As compiled loops where kernels are compiled (``planner.numerics.kernels``).
        """
        if kernels_are_compiled() and self._loops is not None:
            from planner.synthesis.loops.solver import LoopResiduals  # here: for what lasts

            return LoopResiduals(self._loops, p, field)
        mine = self.residuals.clone()
        mine.set_parameters(p, field)
        return mine

    @property
    def _head(self) -> str:
        f = self.formulation
        names = ", ".join(f.name for f in self.fingers)
        return (
            f"grasp problem: {self.hand.name}, {names}, {self.surface.kind}\n"
            f"  {f.x.numel()} variables, {f.p.numel()} parameters, "
            f"{sum(len(t.rows) for t in self.terms)} rows"
        )

    def worst_violation(self, violation: Mapping[str, float]) -> tuple[Term, float]:
        """The term with the largest weighted violation, and that.

        Args:
            violation: Largest violation of each term, in its unit.
        """
        required = self.residuals.required
        worst = max(violation, key=lambda name: violation[name] * required[name].weight)
        return required[worst], violation[worst] * required[worst].weight

    def candidate(
        self,
        start: Start,
        x: FloatArray,
        violation: dict[str, float],
        status: str,
        iterations: int,
        begin: float,
    ) -> Candidate:
        """A solver's result: unknowns x, violations, status, and CPU time since ``begin``."""
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
        """Pose of the link that s and t move, object frame: the base, or an arm's last link."""
        if self.hand.arm is None:
            return start.T_object_base
        state = moving_hand(self.hand).move(start.q)
        return start.T_object_base * state.joint_pose(self.hand.arm.flange)

    def parameters(
        self,
        task: GraspTask,
        start: Start,
        posture: FloatArray,
        options: SynthesisOptions,
        own: Mapping[str, FloatArray | float] = MappingProxyType({}),
    ) -> FloatArray:
        """Pack the parameters.

        Args:
            task: Object, table, obstacles and friction.
            start: Gives the reference orientation and the patches.
            posture: Preferred q (nq,); that of an arm's joints is where the start has them.
            options: Margins and weights.
            own: Numbers of terms beside the standard ones, by the names that they gave to
                ``GraspSymbols.parameter``; zero where nothing is said.
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
                "grip": task.grip_force,
                "mass": task.object.mass,
                "gravity": task.T_world_object.rotation.T @ task.gravity,
                "length": shape.bounding_radius,
                "posture": posture,
                **options.values(),
                "clear_table": min(options.clear_table, table_room(task)),
                "objectives": 0.0,
                **dict.fromkeys(self.formulation.symbols.own, 0.0),
                **own,
            }
        )


TURN_MAX = 1.0
"""Bound of each modified Rodrigues parameter: a full half turn from the start's orientation."""

SHIFT_MAX = 0.25
"""Largest shift (m) of the base from its start, along each axis."""


def build_problem(
    hand: Hand,
    fingers: Sequence[Finger],
    kind_of: Shape,
    n_obstacles: int = 0,
    objectives: tuple[str, ...] = (),
    terms: tuple[str, ...] = (),
) -> GraspProblem:
    """Build the problem for a hand, the fingers that take part and a kind of shape.

    Args:
        hand: The hand.
        fingers: The fingers that take part.
        kind_of: Any shape of the kind; its size does not matter.
        n_obstacles: How many obstacle boxes there are.
        objectives: Objectives with rows of their own, by name.
        terms: Registered terms beside the standard ones, by name.
    """
    surface = surface_of(kind_of)
    return problem_on(hand, tuple(fingers), surface, n_obstacles, objectives, terms)


def problem_on(
    hand: Hand,
    fingers: tuple[Finger, ...],
    surface: Surface,
    n_obstacles: int,
    objectives: tuple[str, ...] = (),
    terms: tuple[str, ...] = (),
) -> GraspProblem:
    """``build_problem`` on a given form of the shape."""
    formulation = formulate(hand, fingers, surface, n_obstacles, objectives, terms)
    own = tuple(TERMS[name] for name in terms)
    return GraspProblem(hand, fingers, surface, Residuals(formulation), objectives, own)


@dataclass(frozen=True)
class Problems:
    """The grasp problem of a task, and the time (s) that it took to build."""

    grasp: GraspProblem
    build_s: float


def problems_for(task: GraspTask, form: ProblemForm | None = None) -> Problems:
    """The problem of a task; built once per hand, fingers, kind of shape, obstacles and form.

    A mesh's field is made here too, so that attempts take no time for either.

    Args:
        task: The task.
        form: Objectives and terms beside the standard ones; None for neither.
    """
    kind = _Kind(task.object.shape)
    same, n_obstacles = _SameHand(task.hand), len(task.obstacles)
    form = form or ProblemForm()
    problems = _cached_problems(same, task.finger_names, kind, n_obstacles, form)
    begin = time.perf_counter()
    with BUILDING:  # fitting a field takes seconds: one thread does it and the others wait
        problems.grasp.surface.field_of(task.object.shape)
    return replace(problems, build_s=problems.build_s + time.perf_counter() - begin)


class _Kind:
    """A shape that compares by its form in the problem, for the cache."""

    def __init__(self, shape: Shape) -> None:
        self.shape, self.kind = shape, surface_of(shape).kind

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Kind) and other.kind == self.kind

    def __hash__(self) -> int:
        return hash(self.kind)


class _SameHand:
    """A hand that compares by what determines it, for the cache: loaded twice it is the same."""

    def __init__(self, hand: Hand) -> None:
        self.hand = hand

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _SameHand) and other.hand.digest == self.hand.digest

    def __hash__(self) -> int:
        return hash(self.hand.digest)


@made_once(16)
def _cached_problems(
    same: _SameHand,
    finger_names: tuple[str, ...],
    kind: _Kind,
    n_obstacles: int,
    form: ProblemForm,
) -> Problems:
    begin = time.perf_counter()
    fingers = same.hand.choose_fingers(finger_names)
    grasp = build_problem(
        same.hand,
        fingers,
        kind.shape,
        n_obstacles,
        form.objectives,
        tuple(term.name for term in form.terms),
    )
    return Problems(grasp=grasp, build_s=time.perf_counter() - begin)
