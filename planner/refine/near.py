"""The term ``near``: a cost of leaving a given hand pose.

Rows, with weights that are parameters of the problem, so that one problem serves every pose and
every strength of the wish to stay:

    w_contact (p_i - p_i0)        contact i from the point under its given pad
    w_shift (R a + t - b)         the palm's origin from where it was
    w_turn 4 s                    turn of the base, modified Rodrigues parameters from the start's
    w_joint_j (q_j - q_j0)        joints

It is no standard term: ``planner.refine`` asks for it. All weights are zero unless given.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from planner.hands.hand import Hand
from planner.refine.movement import JOINT_UNIT, LENGTH_UNIT, TURN_UNIT
from planner.spatial import FloatArray
from planner.synthesis.symbols import GraspSymbols
from planner.synthesis.terms.registry import register_term
from planner.synthesis.terms.term import Role, Rows, Term

SMALLEST_RANGE = 1e-3
"""Least range (rad or m) of a joint that its change is compared with."""


def _near(g: GraspSymbols) -> Iterator[Rows]:
    n = len(g.points)
    points, contact = g.parameter("near_points", 3 * n), g.parameter("near_contact", 1)
    for i, (finger, point) in enumerate(zip(g.fingers, g.points, strict=True)):
        off = point - points[3 * i : 3 * i + 3]
        yield Rows(expression=contact * off, about=(finger.name,))
    at, place = g.parameter("near_at", 3), g.parameter("near_place", 3)
    shift, turn = g.parameter("near_shift", 1), g.parameter("near_turn", 1)
    yield Rows(expression=shift * (g.rotation @ at + g.shift - place))
    yield Rows(expression=turn * 4 * g.x[:3])
    q, joint = g.parameter("near_q", g.hand.nq), g.parameter("near_joint", g.hand.nq)
    yield Rows(expression=joint * (g.q - q))


NEAR = register_term(
    Term(
        name="near",
        meaning="displacement of contacts and palm over 10 mm, turn and joints over 0.2 rad",
        role=Role.COST,
        unit="-",
        weight=1.0,
        write=_near,
        judged="the movement is reported",
    )
)


def near_numbers(
    hand: Hand,
    weight: float,
    *,
    points: FloatArray,
    q: FloatArray,
    at: FloatArray,
    place: FloatArray,
) -> Mapping[str, FloatArray | float]:
    """Parameters of the term, for ``GraspProblem.parameters``.

    Args:
        hand: The hand.
        weight: Residual (-) of one unit of ``planner.refine.movement``.
        points: Points of the surface under the given pads (n, 3), object frame, m.
        q: Given joints (nq,).
        at: The palm's origin (3,) in the frame of the base, or of an arm's last link, m.
        place: Where it was (3,), object frame, m.
    """
    span = np.maximum(hand.q_upper - hand.q_lower, SMALLEST_RANGE)
    return {
        "near_points": points.ravel(),
        "near_contact": weight / LENGTH_UNIT,
        "near_at": at,
        "near_place": place,
        "near_shift": weight / LENGTH_UNIT,
        "near_turn": weight / TURN_UNIT,
        "near_q": q,
        "near_joint": weight / np.minimum(JOINT_UNIT, span) / np.sqrt(hand.nq),
    }
