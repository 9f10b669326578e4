"""Terms of joints: couplings, the arm that carries the hand, and the preferred posture."""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca
import numpy as np

from planner.synthesis.symbols import GraspSymbols
from planner.synthesis.terms.contact import COST_WEIGHT, PER_METRE
from planner.synthesis.terms.term import Role, Rows, Term

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
