"""Terms of forces and joints.

An internal force is strictly inside all friction cones, and borne by the stops; couplings, the arm
that carries the hand, and the preferred posture bind the joints.

An internal force strictly inside all cones together with rank G = 6 is force closure (Murray, Li,
Sastry 1994, proposition 5.3); rank follows from three contacts that are not on a line.
"""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca
import numpy as np

from planner.synthesis.symbols import GraspSymbols
from planner.synthesis.terms.contact import COST_WEIGHT, PER_METRE
from planner.synthesis.terms.term import Role, Rows, Term

PRESS_MIN = 0.25
"""Smallest normal force of a finger over the mean normal force (-)."""

LEVER = 0.05
"""Typical lever arm of a fingertip force, m; makes stop torques comparable to unit forces."""

ALIGNED_TOL = 1e-9
"""Share (-) of a stop outside the range of actuators and couplings below which they bear it."""


def _balance(g: GraspSymbols) -> Iterator[Rows]:
    pairs = zip(g.points, g.forces, strict=True)
    torque = sum((ca.cross(p, f) for p, f in pairs), ca.SX.zeros(3))
    yield Rows(expression=sum(g.forces[1:], g.forces[0]))
    yield Rows(expression=torque / g.length)


def _level(g: GraspSymbols) -> Iterator[Rows]:
    normal = g.normal_forces
    yield Rows(expression=sum(normal[1:], normal[0]) / len(normal) - 1)


def _cone(g: GraspSymbols) -> Iterator[Rows]:
    for finger, force, normal in zip(g.fingers, g.forces, g.normal_forces, strict=True):
        tangential = ca.dot(force, force) - normal**2
        most = (g.option["cone_share"] * g.mu * normal) ** 2
        yield Rows(expression=most - tangential, about=(finger.name,))


def _press(g: GraspSymbols) -> Iterator[Rows]:
    for finger, normal in zip(g.fingers, g.normal_forces, strict=True):
        yield Rows(expression=normal - PRESS_MIN, about=(finger.name,))


def _stop(g: GraspSymbols) -> Iterator[Rows]:
    """Multiplier of each one-sided coupling: tau = R^T F + C^T mu + S^T lam, by least squares.

    A stop bears the torque that actuators (F) and two-sided couplings (mu) cannot; a stop in their
    range has no row.
    """
    hand = g.hand
    moving = {int(i): f.name for f in g.fingers for i in f.q_index}
    firm = [c.row for c in hand.couplings if not c.one_sided]
    drive = np.column_stack([hand.actuation.moment.T, *firm])
    rest = np.eye(hand.nq) - drive @ np.linalg.pinv(drive)
    stops = [c for c in hand.couplings if c.one_sided and set(np.flatnonzero(c.row)) <= set(moving)]
    used = [c for c in stops if np.linalg.norm(rest @ c.row) > ALIGNED_TOL]
    if not used:
        return
    left = np.linalg.pinv(np.column_stack([rest @ c.row for c in used]))
    multipliers = ca.DM(left) @ g.torque / LEVER
    for k, stop in enumerate(used):
        joints = np.flatnonzero(stop.row)
        names = dict.fromkeys(moving[int(i)] for i in joints)
        yield Rows(expression=multipliers[k], about=tuple(names))


def _forces(g: GraspSymbols) -> Iterator[Rows]:
    n = len(g.fingers)
    for finger, force, outward, normal in zip(
        g.fingers, g.forces, g.outward, g.normal_forces, strict=True
    ):
        tangential = force + normal * outward
        aside = ca.sqrt(g.option["weight_tangential"] / n) / g.mu * tangential
        uneven = ca.sqrt(g.option["weight_share"] / n) * (normal - 1)
        yield Rows(expression=ca.vertcat(aside, uneven), about=(finger.name,))


CLOSURE = "force closure and the force programme"

BALANCE = Term(
    name="balance",
    meaning="sum f_i and sum p_i x f_i / length: an internal force",
    role=Role.EQUALITY,
    unit="-",
    weight=20.0,
    write=_balance,
    judged=CLOSURE,
    lacking=(
        "the forces of these fingers do not cancel, since their contacts do not oppose each "
        "other; a narrower object, other fingers, more friction"
    ),
)

LEVEL = Term(
    name="level",
    meaning="mean of the normal forces f_i . -n_i, less 1",
    role=Role.EQUALITY,
    unit="-",
    weight=20.0,
    write=_level,
    lacking=(
        "these fingers cannot balance a grip here, whatever they press with, and the solver "
        "lets go; a smaller or differently turned object, fingers that oppose each other, more "
        "friction"
    ),
)

CONE = Term(
    name="cone",
    meaning="(cone_share mu fn_i)^2 - |ft_i|^2: strictly inside every friction cone",
    role=Role.INEQUALITY,
    unit="-",
    weight=20.0,
    write=_cone,
    wording="force of {} at the edge of its cone",
    judged=CLOSURE,
    lacking=(
        "the grip holds only with more friction than there is; more friction, a place whose "
        "faces oppose each other, other fingers"
    ),
)

PRESS = Term(
    name="press",
    meaning=f"fn_i - {PRESS_MIN:g}: every finger presses",
    role=Role.INEQUALITY,
    unit="-",
    weight=20.0,
    write=_press,
    wording="force of {} at its least",
    judged=CLOSURE,
    lacking=(
        "one of the fingers cannot press against the others; leave it out, or take a smaller object"
    ),
)

STOP = Term(
    name="stop",
    meaning=f"torque of each one-sided stop over {LEVER:g} m: a stop can only push",
    role=Role.INEQUALITY,
    unit="-",
    weight=10.0,
    write=_stop,
    wording="a stop that can only push",
    judged="the force programme",
    lacking="a coupled joint would have to pull at its stop; other fingers, another pose",
)

FORCES = Term(
    name="forces",
    meaning="ft_i / mu and fn_i - 1, times the roots of weight_tangential and weight_share",
    role=Role.COST,
    unit="-",
    weight=COST_WEIGHT,
    write=_forces,
)


ARM_POSTURE = 1e-3
"""Cost (-) of an arm's joint that leaves its start, over that of a finger's joint that leaves the
pinch posture, per share of their ranges. The start comes from inverse kinematics that begins at the
ready posture; with the ready posture itself as the target fewer attempts are solved."""


def _coupling(g: GraspSymbols) -> Iterator[Rows]:
    matrix, value = g.hand.coupling_matrix
    if len(value):
        yield Rows(expression=ca.DM(matrix) @ g.q - value)


def _arm(g: GraspSymbols) -> Iterator[Rows]:
    if g.root is None:
        return
    turn, origin = g.symbolic.flange
    apart = g.rotation.T @ g.root[0] @ turn
    yield Rows(expression=g.root[0] @ origin + g.root[1] - g.shift)
    yield Rows(expression=ca.inv_skew(apart - apart.T) / 2)


def _posture(g: GraspSymbols) -> Iterator[Rows]:
    span = g.hand.q_upper - g.hand.q_lower
    span[g.hand.arm_index] /= np.sqrt(ARM_POSTURE)
    n_hand = g.hand.nq - len(g.hand.arm_index)
    root = ca.sqrt(g.option["weight_posture"] / n_hand)
    yield Rows(expression=root * (g.q - g.posture) / span)


COUPLING = Term(
    name="coupling",
    meaning="C q - d",
    role=Role.EQUALITY,
    unit="rad",
    weight=50.0,
    write=_coupling,
    judged="couplings hold",
    lacking=(
        "joints that move together cannot both be where they would have to be; another size or "
        "pose, other fingers"
    ),
)

ARM = Term(
    name="arm",
    meaning="offset and sine of the turn of the arm's last link from where s and t put it",
    role=Role.EQUALITY,
    unit="m",
    weight=PER_METRE,
    write=_arm,
    judged="the verdict computes the base from the joints",
    lacking="the arm does not bring the hand there; put the object nearer, or free its pose",
)

POSTURE = Term(
    name="posture",
    meaning="q less the preferred posture over the range, times the root of weight_posture",
    role=Role.COST,
    unit="-",
    weight=COST_WEIGHT,
    write=_posture,
)
