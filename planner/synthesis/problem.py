"""The grasp-synthesis NLP: built once per hand, fingers and kind of shape, solved many times.

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
    fingers  squared distance of link ends from bones of other fingers, less the least  >= 0
    coupling C q - d                             = 0
    arm      where the arm's joints put its last link, less where s and t put it = 0

The base of a hand on an arm is the arm's root, which is fixed. There s and t move the arm's last
link, to which the arm's joints are tied by the term ``arm``: the terms of the hand stay as they are
for a floating one. With the joints alone as unknowns 30 of 60 attempts were solved, so 41.

An internal force strictly inside all cones together with rank G = 6 is force closure (Murray, Li,
Sastry 1994, proposition 5.3); rank follows from three contacts that are not on a line. The cost
keeps forces near the normals, shares them evenly, keeps contacts around the centre of mass and
joints near the pinch posture.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from planner.hand import Finger, Hand
from planner.kinematics import HandState
from planner.shapes import Shape
from planner.spatial import SE3, FloatArray
from planner.symbolic import SymbolicHand
from planner.synthesis.clearance import ClearanceTerms
from planner.synthesis.nlp import Field, Nlp
from planner.synthesis.options import OPTION_NAMES, SynthesisOptions
from planner.synthesis.surfaces import (
    CODE_DIM,
    SIZE_DIM,
    Patch,
    Surface,
    surface_of,
)
from planner.synthesis.surroundings import Surroundings

__all__ = ["GraspProblem", "NlpSolution", "Start", "build_problem"]

PRESS_MIN = 0.25
"""Smallest normal force of a finger over the mean normal force (-)."""


@dataclass(frozen=True, kw_only=True)
class Start:
    """Where IPOPT starts; poses and points in the object's frame.

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
class NlpSolution:
    """What IPOPT returned; ``violation`` is recomputed from the terms, never IPOPT's word.

    Attributes:
        T_object_base: Pose of the base in the object's frame.
        q: (nq,).
        points: (n, 3), m.
        normals: (n, 3), outward.
        forces: (n, 3), object frame, in units of the mean normal force.
        violation: Largest violation per term.
        status: IPOPT's return status.
        iterations: IPOPT iterations.
        cpu_s: CPU time of the solve, s.
    """

    T_object_base: SE3
    q: FloatArray
    points: FloatArray
    normals: FloatArray
    forces: FloatArray
    violation: dict[str, float]
    status: str
    iterations: int
    cpu_s: float


@dataclass(frozen=True, kw_only=True)
class Term:
    """One named residual: expression (m,), whether it is = 0 (else >= 0)."""

    name: str
    expression: Any
    equality: bool

    @property
    def unit(self) -> str:
        """Unit of the residual, "-" for none."""
        return UNITS.get(self.name, "-")


UNITS = {
    "touch": "m",
    "surface": "m",
    "coupling": "rad",
    "arm": "m",
    "object": "m",
    "table": "m",
    "obstacle": "m",
    "fingers": "m2",
}
"""Units of the terms that have one; forces are in units of the mean normal force."""


@dataclass(kw_only=True, eq=False)
class GraspProblem:
    """The NLP of one hand, finger set and kind of shape.

    Attributes:
        hand: The hand.
        fingers: Fingers that take part, in order of the contacts.
        surface: NLP form of the shape.
        n_obstacles: Number of obstacle boxes.
        terms: Constraints.
        nlp: Unknowns, parameters, cost and constraints as expressions, and their solver.
    """

    hand: Hand
    fingers: tuple[Finger, ...]
    surface: Surface
    n_obstacles: int
    terms: tuple[Term, ...]
    nlp: Nlp

    def __str__(self) -> str:
        """Variables, parameters and terms, one line each."""
        lines = [
            f"grasp problem: {self.hand.name}, {', '.join(f.name for f in self.fingers)}, "
            f"{self.surface.kind}",
            f"  {self.nlp.x.numel()} variables, {self.nlp.p.numel()} parameters",
        ]
        lines += [
            f"  {t.name:10s} {t.expression.numel():4d} {' =' if t.equality else '>='} 0  [{t.unit}]"
            for t in self.terms
        ]
        return "\n".join(lines)

    def solve(
        self, start: Start, parameters: FloatArray, field: Field | None = None
    ) -> NlpSolution:
        """Run IPOPT from one start.

        Args:
            start: The start.
            parameters: From ``parameters``.
            field: The object's distance field, where its kind of shape needs one.
        """
        solver = self.nlp.bind(field)
        n, nq = len(self.fingers), self.hand.nq
        T_object_carrier = self._carrier(start)
        lower_q = np.where(start.frozen, start.q, self.hand.q_lower)
        upper_q = np.where(start.frozen, start.q, self.hand.q_upper)
        still = start.base_fixed and self.hand.arm is None
        turn, shift = (0.0, 0.0) if still else (TURN_MAX, SHIFT_MAX)
        origin = np.array(T_object_carrier.translation)
        force_max = float(4 * n)
        lower = np.concatenate(
            [np.full(3, -turn), origin - shift, lower_q]
            + [patch.lower for patch in start.patches]
            + [np.full(3 * n, -force_max)]
        )
        upper = np.concatenate(
            [np.full(3, turn), origin + shift, upper_q]
            + [patch.upper for patch in start.patches]
            + [np.full(3 * n, force_max)]
        )
        x0 = np.concatenate(
            [np.zeros(3), origin, start.q, start.points.ravel(), start.forces.ravel()]
        )
        lbg = np.concatenate([np.zeros(t.expression.numel()) for t in self.terms])
        ubg = np.concatenate(
            [np.full(t.expression.numel(), 0.0 if t.equality else np.inf) for t in self.terms]
        )
        begin = time.process_time()
        x, stats = solver(
            x0=np.clip(x0, lower, upper), p=parameters, lbx=lower, ubx=upper, lbg=lbg, ubg=ubg
        )
        cpu = time.process_time() - begin
        g, normals = solver.evaluate(x, parameters)
        T_object_base = start.T_object_base
        if self.hand.arm is None:
            turned = T_object_base.rotation @ np.array(_mrp_numeric(x[:3]))
            T_object_base = SE3(turned, x[3:6])
        points = x[6 + nq : 6 + nq + 3 * n].reshape(n, 3)
        return NlpSolution(
            T_object_base=T_object_base,
            q=x[6 : 6 + nq],
            points=points,
            normals=normals.T,
            forces=x[6 + nq + 3 * n :].reshape(n, 3),
            violation=self.violations(g.ravel()),
            status=str(stats["return_status"]),
            iterations=int(stats["iter_count"]),
            cpu_s=cpu,
        )

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
        self,
        *,
        shape: Shape,
        start: Start,
        table: tuple[FloatArray, float],
        obstacles: Sequence[tuple[SE3, FloatArray]],
        mu: float,
        posture: FloatArray,
        options: SynthesisOptions,
    ) -> FloatArray:
        """Pack the NLP's parameters.

        Args:
            shape: The object.
            start: Gives the reference orientation and the patches.
            table: Unit normal (3,) and offset d in the object's frame; points above it have
                n . x - d >= 0.
            obstacles: Pose in the object's frame and half extents (3,), m, of each.
            mu: Friction (-).
            posture: Preferred q (nq,); that of an arm's joints is where the start has them.
            options: Margins and weights.
        """
        root: list[Any] = []
        posture = posture.copy()
        posture[self.hand.arm_index] = start.q[self.hand.arm_index]
        if self.hand.arm is not None:
            T = start.T_object_base
            root = [np.array(T.rotation).ravel(order="F"), T.translation]
        parts = [
            np.array(self._carrier(start).rotation).ravel(order="F"),
            *root,
            self.surface.size(shape),
            *[patch.code for patch in start.patches],
            Surroundings.values(table, obstacles),
            [mu, shape.bounding_radius],
            posture,
            options.values(),
        ]
        return np.concatenate([np.asarray(v, dtype=np.float64).ravel() for v in parts])


TURN_MAX = 1.0
"""Bound of each modified Rodrigues parameter: a full half turn from the start's orientation."""

SHIFT_MAX = 0.25
"""How far (m) the base may move from where the start put it, along each axis."""


def build_problem(
    hand: Hand, fingers: Sequence[Finger], kind_of: Shape, n_obstacles: int = 0
) -> GraspProblem:
    """Build the NLP for a hand, the fingers that take part and a kind of shape.

    Args:
        hand: The hand.
        fingers: The fingers that take part.
        kind_of: Any shape of the kind; its size does not matter.
        n_obstacles: How many obstacle boxes there are.
    """
    fingers = tuple(fingers)
    surface = surface_of(kind_of)
    n = len(fingers)
    s, t, q = ca.SX.sym("s", 3), ca.SX.sym("t", 3), ca.SX.sym("q", hand.nq)
    points = [ca.SX.sym(f"p{i}", 3) for i in range(n)]
    forces = [ca.SX.sym(f"f{i}", 3) for i in range(n)]
    r0 = ca.SX.sym("R0", 3, 3)
    size = ca.SX.sym("size", SIZE_DIM)
    codes = [ca.SX.sym(f"code{i}", CODE_DIM) for i in range(n)]
    surroundings = Surroundings(n_obstacles)
    mu, length = ca.SX.sym("mu"), ca.SX.sym("length")
    posture = ca.SX.sym("posture", hand.nq)
    option = {name: ca.SX.sym(name) for name in OPTION_NAMES}

    rotation = r0 @ _mrp(s)
    symbolic = SymbolicHand(hand, q, from_flange=True)
    root = (ca.SX.sym("R_root", 3, 3), ca.SX.sym("t_root", 3)) if hand.arm is not None else None
    normals = [surface.outward_normal(size, codes[i], points[i]) for i in range(n)]
    equal: dict[str, list[Any]] = {"touch": [], "surface": []}
    above: dict[str, list[Any]] = {"facing": [], "cone": [], "press": []}
    normal_forces, torque = [], ca.SX.zeros(hand.nq)
    tangential_cost = share_cost = ca.SX(0)
    for i, finger in enumerate(fingers):
        pad = finger.pad
        center_base = symbolic.point(pad.joint_id, pad.center)
        equal["touch"].append(rotation @ center_base + t - points[i] - pad.radius * normals[i])
        error = surface.surface_error(size, codes[i], points[i])
        if error is not None:
            equal["surface"].append(error)
        axis = rotation @ symbolic.direction(pad.joint_id, pad.axis)
        rim = max(pad.half_angle - surface.normal_error, 0.0)
        above["facing"].append(-ca.dot(axis, normals[i]) - float(np.cos(rim)))
        fn = -ca.dot(forces[i], normals[i])
        ft2 = ca.dot(forces[i], forces[i]) - fn**2
        normal_forces.append(fn)
        above["cone"].append((option["cone_share"] * mu * fn) ** 2 - ft2)
        above["press"].append(fn - PRESS_MIN)
        tangential_cost += ft2 / mu**2
        share_cost += (fn - 1) ** 2
        torque += _contact_torque(symbolic, finger, rotation, center_base, normals[i], forces[i])
    equal["balance"] = [
        sum(forces[1:], forces[0]),
        sum((ca.cross(p, f) for p, f in zip(points, forces, strict=True)), ca.SX.zeros(3)) / length,
    ]
    equal["level"] = [sum(normal_forces[1:], normal_forces[0]) / n - 1]
    matrix, value = hand.coupling_matrix
    equal["coupling"] = [ca.DM(matrix) @ q - value] if len(value) else []
    equal["arm"] = [] if root is None else _arm_gap(symbolic, root, rotation, t)
    above["stop"] = _stop_torques(hand, fingers, torque)

    names = [f.name for f in fingers]
    links = ClearanceTerms(symbolic, rotation, t, root)
    above["object"] = links.from_object(
        surface, size, names, option["clear_object"], option["clear_tip"]
    )
    above["table"] = surroundings.from_table(links, option["clear_table"])
    above["obstacle"] = surroundings.from_obstacles(links, option["clear_table"])
    above["fingers"] = links.between_fingers(option["clear_fingers"])

    span = hand.q_upper - hand.q_lower
    span[hand.arm_index] /= np.sqrt(ARM_POSTURE)
    n_hand = hand.nq - len(hand.arm_index)
    posture_cost = ca.sumsqr((q - posture) / span) / n_hand * len(fingers)
    middle = sum(points[1:], points[0]) / n
    cost = (
        option["weight_tangential"] * tangential_cost
        + option["weight_share"] * share_cost
        + option["weight_posture"] * posture_cost
    ) / n + option["weight_center"] * ca.sumsqr(middle / length)
    terms = tuple(
        Term(name=name, expression=ca.vertcat(*parts), equality=group is equal)
        for group in (equal, above)
        for name, parts in group.items()
        if parts
    )
    return GraspProblem(
        hand=hand,
        fingers=fingers,
        surface=surface,
        n_obstacles=n_obstacles,
        terms=terms,
        nlp=Nlp(
            "grasp",
            x=ca.vertcat(s, t, q, *points, *forces),
            p=ca.vertcat(
                ca.vec(r0),
                *(() if root is None else (ca.vec(root[0]), root[1])),
                size,
                *codes,
                surroundings.symbols,
                mu,
                length,
                posture,
                *option.values(),
            ),
            cost=cost,
            g=ca.vertcat(*[t.expression for t in terms]),
            options=IPOPT_OPTIONS,
            points=surface.field,
            outputs=(ca.horzcat(*normals),),
        ),
    )


ARM_POSTURE = 1e-3
"""Cost of an arm's joint that leaves its start against that of a finger's joint that leaves the
pinch posture, by the same share of their ranges (-). The start comes from inverse kinematics that
set out from the ready posture. With 0.1, or with the ready posture itself as the aim, 44 and 41 of
60 attempts are solved on sphere, box and cylinder, so 48."""

IPOPT_TOL = 1e-4
"""IPOPT's scaled optimality tolerance (-). Constraints are held to 1e-7 m; the cost only ranks."""

MAX_ITERATIONS = 60
"""IPOPT iterations of one attempt; nine of ten that succeed need under 50."""

IPOPT_OPTIONS = {
    "ipopt.max_iter": MAX_ITERATIONS,
    "ipopt.tol": IPOPT_TOL,
    "ipopt.constr_viol_tol": 1e-7,
    "ipopt.acceptable_tol": 1e-2,
    "ipopt.acceptable_constr_viol_tol": 1e-6,
    "ipopt.acceptable_iter": 3,
    "ipopt.mu_strategy": "adaptive",
    "ipopt.adaptive_mu_globalization": "never-monotone-mode",
}
"""Never-monotone adaptive barrier: more attempts succeed than with any other of IPOPT's."""


def _mrp(s: Any) -> Any:
    """Rotation matrix of modified Rodrigues parameters: no singularity below a full turn."""
    k = ca.skew(s)
    n = ca.dot(s, s)
    return ca.SX.eye(3) + (8 * (k @ k) + 4 * (1 - n) * k) / (1 + n) ** 2


def _mrp_numeric(s: FloatArray) -> FloatArray:
    return np.array(ca.DM(_MRP(s)))


_S = ca.SX.sym("s", 3)
_MRP = ca.Function("mrp", [_S], [_mrp(_S)])


def _contact_torque(
    symbolic: SymbolicHand, finger: Finger, rotation: Any, center: Any, normal: Any, force: Any
) -> Any:
    """Joint torques (nq,) with which a finger presses ``force`` (object frame) at its contact."""
    point = center - finger.pad.radius * (rotation.T @ normal)
    local = rotation.T @ force
    out = ca.SX.zeros(symbolic.hand.nq)
    for name, index in zip(finger.joints, finger.q_index, strict=True):
        out[int(index)] = symbolic.joint_torque(name, point, local)
    return out


def _arm_gap(symbolic: SymbolicHand, root: tuple[Any, Any], rotation: Any, shift: Any) -> list[Any]:
    """Offset (m) and turn (sine of the angle) of the arm's last link from where s and t put it."""
    turn, origin = symbolic.flange
    apart = rotation.T @ root[0] @ turn
    return [root[0] @ origin + root[1] - shift, ca.inv_skew(apart - apart.T) / 2]


def _stop_torques(hand: Hand, fingers: tuple[Finger, ...], torque: Any) -> list[Any]:
    """Multiplier of each one-sided coupling: tau = R^T F + C^T mu + S^T lam, by least squares.

    A stop counts for what actuators (F) and two-sided couplings (mu) cannot do; one for which
    nothing is left does not count.
    """
    moving = {int(i) for f in fingers for i in f.q_index}
    firm = [c.row for c in hand.couplings if not c.one_sided]
    drive = np.column_stack([hand.actuation.moment.T, *firm])
    rest = np.eye(hand.nq) - drive @ np.linalg.pinv(drive)
    stops = [c for c in hand.couplings if c.one_sided and set(np.flatnonzero(c.row)) <= moving]
    left = [rest @ c.row for c in stops if np.linalg.norm(rest @ c.row) > ALIGNED_TOL]
    return [ca.DM(np.linalg.pinv(np.column_stack(left))) @ torque / LEVER] if left else []


ALIGNED_TOL = 1e-9
"""A stop of which less than this is outside what actuators and couplings hold is left to them."""

LEVER = 0.05
"""Typical lever arm of a fingertip force, m; makes stop torques comparable to unit forces."""
