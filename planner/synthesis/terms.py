"""The terms of grasp synthesis as CasADi expressions; what they mean is told in ``problem``."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.kinematics.symbolic import SymbolicHand
from planner.shapes.surface import CODE_DIM, SIZE_DIM, Surface
from planner.spatial import FloatArray
from planner.synthesis.clearance import ClearanceTerms
from planner.synthesis.objectives.registry import GraspSymbols, objective_rows
from planner.synthesis.options import OPTION_NAMES
from planner.synthesis.surroundings import Surroundings
from planner.synthesis.unknowns import Unknowns, mrp_matrix
from planner.synthesis.wrenches import contact_torque

__all__ = ["PRESS_MIN", "Formulation", "Term", "formulate"]

PRESS_MIN = 0.25
"""Smallest normal force of a finger over the mean normal force (-)."""


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


@dataclass(frozen=True, kw_only=True)
class Formulation:
    """Unknowns, parameters, terms and cost of one hand, finger set and kind of shape.

    Attributes:
        unknowns: Layout of ``x``.
        x, p: Unknowns and parameters, columns.
        parameters: Symbols of the parameters, by name in the order of ``p``.
        finger_names: Fingers that take part.
        links: The hand, placed by the unknowns.
        surroundings: Table and obstacles.
        terms: Constraints.
        cost_rows: The cost is the sum of their squares.
        edge_rows: Negative (-) where a contact is on an edge; a cost of least squares alone.
        objective_rows: Rows of the objectives; a cost of least squares alone, where negative.
        normals: Outward normals (3, n) at the contact points.
    """

    unknowns: Unknowns
    x: Any
    p: Any
    parameters: dict[str, Any]
    finger_names: tuple[str, ...]
    links: ClearanceTerms
    surroundings: Surroundings
    terms: tuple[Term, ...]
    cost_rows: Any
    edge_rows: Any
    objective_rows: Any
    normals: Any

    @cached_property
    def places(self) -> dict[str, slice]:
        """Where each parameter stands in ``p``, by name."""
        ends = np.cumsum([0, *(v.numel() for v in self.parameters.values())])
        pairs = zip(self.parameters, ends[:-1], ends[1:], strict=True)
        return {name: slice(int(a), int(b)) for name, a, b in pairs}

    def pack(self, values: dict[str, Any]) -> FloatArray:
        """The column of parameters: numbers for every name in ``places``."""
        out = np.zeros(self.p.numel())
        for name, place in self.places.items():
            out[place] = np.asarray(values[name], dtype=np.float64).ravel()
        return out

    def unpack(self, p: FloatArray) -> dict[str, FloatArray]:
        """Views of a column of parameters, by name."""
        return {name: p[place] for name, place in self.places.items()}


def formulate(
    hand: Hand,
    fingers: tuple[Finger, ...],
    surface: Surface,
    n_obstacles: int,
    objectives: tuple[str, ...] = (),
    *,
    clearances: bool = True,
) -> Formulation:
    """Write the terms for a hand, the fingers that take part and the NLP form of a shape.

    Args:
        hand: The hand.
        fingers: Fingers that take part, in order of the contacts.
        surface: NLP form of the shape.
        n_obstacles: Number of obstacle boxes.
        objectives: Those of ``planner.synthesis.objectives.registry`` that have rows of their own.
        clearances: Whether links' clearances are among the terms; least squares gets them from
            ``planner.synthesis.avoid``.
    """
    n = len(fingers)
    unknowns = Unknowns(n_joints=hand.nq, n_contacts=n)
    s, t, q, points, forces = unknowns.symbols()
    r0 = ca.SX.sym("R0", 3, 3)
    size = ca.SX.sym("size", SIZE_DIM)
    codes = [ca.SX.sym(f"code{i}", CODE_DIM) for i in range(n)]
    surroundings = Surroundings(n_obstacles)
    mu, length = ca.SX.sym("mu"), ca.SX.sym("length")
    posture = ca.SX.sym("posture", hand.nq)
    option = {name: ca.SX.sym(name) for name in OPTION_NAMES}

    rotation = r0 @ mrp_matrix(s)
    symbolic = SymbolicHand(hand, q, from_flange=True)
    root = (ca.SX.sym("R_root", 3, 3), ca.SX.sym("t_root", 3)) if hand.arm is not None else None
    normals = [surface.outward_normal(size, codes[i], points[i]) for i in range(n)]
    equal: dict[str, list[Any]] = {"touch": [], "surface": []}
    above: dict[str, list[Any]] = {"facing": [], "cone": [], "press": []}
    normal_forces, torque = [], ca.SX.zeros(hand.nq)
    cost_rows: list[Any] = []
    edge_rows: list[Any] = []
    for i, finger in enumerate(fingers):
        pad = finger.pad
        center_base = symbolic.point(pad.joint_id, pad.center)
        equal["touch"].append(rotation @ center_base + t - points[i] - pad.radius * normals[i])
        error = surface.surface_error(size, codes[i], points[i])
        if error is not None:
            equal["surface"].append(error)
        flatness = surface.flatness(size, points[i])
        if flatness is not None:
            edge_rows.append(flatness)
        axis = rotation @ symbolic.direction(pad.joint_id, pad.axis)
        rim = max(pad.half_angle - surface.normal_error, 0.0)
        above["facing"].append(-ca.dot(axis, normals[i]) - float(np.cos(rim)))
        fn = -ca.dot(forces[i], normals[i])
        ft2 = ca.dot(forces[i], forces[i]) - fn**2
        normal_forces.append(fn)
        above["cone"].append((option["cone_share"] * mu * fn) ** 2 - ft2)
        above["press"].append(fn - PRESS_MIN)
        tangential = forces[i] + fn * normals[i]
        cost_rows.append(ca.sqrt(option["weight_tangential"] / n) / mu * tangential)
        cost_rows.append(ca.sqrt(option["weight_share"] / n) * (fn - 1))
        torque += contact_torque(symbolic, finger, rotation, center_base, normals[i], forces[i])
    equal["balance"] = [
        sum(forces[1:], forces[0]),
        sum((ca.cross(p, f) for p, f in zip(points, forces, strict=True)), ca.SX.zeros(3)) / length,
    ]
    equal["level"] = [sum(normal_forces[1:], normal_forces[0]) / n - 1]
    matrix, value = hand.coupling_matrix
    equal["coupling"] = [ca.DM(matrix) @ q - value] if len(value) else []
    equal["arm"] = [] if root is None else _arm_gap(symbolic, root, rotation, t)
    above["stop"] = _stop_torques(hand, fingers, torque)

    names = tuple(f.name for f in fingers)
    links = ClearanceTerms(symbolic, rotation, t, root)
    if clearances:
        above["object"] = links.from_object(
            surface, size, names, option["clear_object"], option["clear_tip"]
        )
        above["table"] = surroundings.from_table(links, option["clear_table"])
        above["obstacle"] = surroundings.from_obstacles(links, option["clear_table"])
        above["fingers"] = links.between_fingers(option["clear_fingers"])

    span = hand.q_upper - hand.q_lower
    span[hand.arm_index] /= np.sqrt(ARM_POSTURE)
    n_hand = hand.nq - len(hand.arm_index)
    cost_rows.append(ca.sqrt(option["weight_posture"] / n_hand) * (q - posture) / span)
    extra, extra_p = objective_rows(
        objectives,
        GraspSymbols(
            fingers=fingers,
            symbolic=symbolic,
            rotation=rotation,
            q=q,
            points=points,
            outward=normals,
            forces=forces,
            mu=mu,
            length=length,
        ),
    )
    middle = sum(points[1:], points[0]) / n
    cost_rows.append(ca.sqrt(option["weight_center"]) * middle / length)
    parameters = {
        "reference": ca.vec(r0),
        "root": ca.SX(0, 1) if root is None else ca.vertcat(ca.vec(root[0]), root[1]),
        "size": size,
        "codes": ca.vertcat(*codes),
        "table": surroundings.table,
        "obstacles": surroundings.obstacles,
        "mu": mu,
        "length": length,
        "posture": posture,
        **option,
        "objectives": extra_p,
        "aim": ca.SX.sym("aim"),
        "directions": ca.SX.sym("u", 6 * N_DIRECTIONS),
    }
    terms = tuple(
        Term(name=name, expression=ca.vertcat(*parts), equality=group is equal)
        for group in (equal, above)
        for name, parts in group.items()
        if parts
    )
    return Formulation(
        unknowns=unknowns,
        x=ca.vertcat(s, t, q, *points, *forces),
        p=ca.vertcat(*parameters.values()),
        parameters=parameters,
        finger_names=names,
        links=links,
        surroundings=surroundings,
        terms=terms,
        objective_rows=extra,
        normals=ca.horzcat(*normals),
        cost_rows=ca.vertcat(*cost_rows),
        edge_rows=ca.vertcat(*edge_rows),
    )


ARM_POSTURE = 1e-3
"""Cost of an arm's joint that leaves its start against that of a finger's joint that leaves the
pinch posture, by the same share of their ranges (-). The start comes from inverse kinematics that
set out from the ready posture. With 0.1, or with the ready posture itself as the aim, 44 and 41 of
60 attempts are solved on sphere, box and cylinder, so 48."""


N_DIRECTIONS = 64
"""Directions of wrench in which a descent can work on what a grasp resists; they stand among the
parameters, for ``planner.synthesis.resistance``. With 12 a round makes others weak."""


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
