"""Fingers that only curl, side by side: no more room is asked of them than they have."""

from __future__ import annotations

import casadi as ca
import mujoco
import numpy as np
import pytest

from planner.hand_loading import hand_from_spec, load_hand
from planner.hands.catalog import hand_names
from planner.hands.hand import Hand
from planner.objects import parse_object
from planner.spatial import FloatArray
from planner.synthesis.options import SynthesisOptions
from planner.synthesis.problem import build_problem
from planner.synthesis.terms import fingers
from planner.synthesis.terms.fingers import FINGERS, collision_pairs, finger_capsules, rooms_at_rest

pytestmark = pytest.mark.usefixtures("brief_postures")

CLEAR = SynthesisOptions().clear_fingers
"""Distance between fingers that is asked for if nothing is said, m."""

PITCH, WIDE, THIN = 0.0165, 0.008, 0.005
"""Distance of the fingers' middles, and half sizes of their links, m: 0.5 mm between the links."""

LINK = f"""<body name="{{name}}_{{k}}" pos="{{at}}"><joint name="{{name}}_{{k}}" axis="{{axis}}"
range="0 1.5"/><geom type="box" size="{WIDE} {THIN} 0.018" pos="0 0 0.02"/>{{more}}</body>"""


def finger(name: str, at: str, axis: str) -> str:
    """Two links; the last one ends in a ball."""
    ball = '<geom type="sphere" size="0.007" pos="0 0 0.04"/>'
    last = LINK.format(name=name, k=2, at="0 0 0.042", axis=axis, more=ball)
    return LINK.format(name=name, k=1, at=at, axis=axis, more=last)


@pytest.fixture(scope="module")
def narrow() -> Hand:
    """A thumb opposite to three fingers that only curl."""
    side = [finger(n, f"{k * PITCH} -0.04 0.03", "-1 0 0") for k, n in enumerate("abc", -1)]
    parts = [finger("thumb", "0 0.04 0.03", "1 0 0"), *side]
    text = f"""<mujoco><compiler angle="radian"/><worldbody><body name="palm">
    <geom type="box" size="0.03 0.045 0.01"/>{"".join(parts)}</body></worldbody></mujoco>"""
    return hand_from_spec(mujoco.MjSpec.from_string(text))


def margins(hand: Hand, clear: float) -> FloatArray:
    """The term's rows (n_pairs,), m2, in the posture pinch."""
    problem = build_problem(hand, tuple(hand.fingers.values()), parse_object("sphere").shape)
    f = problem.formulation
    expression = next(w.expression for w in problem.terms if w.term is FINGERS)
    rows = ca.Function(
        "rows", [f.x, f.symbols.reference, f.symbols.option["clear_fingers"]], [expression]
    )
    x = np.zeros(f.unknowns.size)
    f.unknowns.q(x)[:] = hand.posture("pinch")
    return np.array(rows(x, np.eye(3), clear)).ravel()


@pytest.mark.slow
def test_neighbours_have_less_room_than_is_asked_for(narrow: Hand) -> None:
    rooms, capsules = rooms_at_rest(narrow), finger_capsules(narrow)
    tight = {
        frozenset((capsules[i].finger, capsules[j].finger))
        for (i, j), room in zip(collision_pairs(narrow), rooms, strict=True)
        if room < CLEAR
    }
    assert tight
    assert all(len(pair) == 2 and "thumb" not in pair for pair in tight)


def test_the_hands_own_posture_is_allowed(narrow: Hand, monkeypatch: pytest.MonkeyPatch) -> None:
    for clear in (CLEAR, 0.0, 0.02):  # however much is asked
        assert margins(narrow, clear).min() > 0.0
    monkeypatch.setattr(fingers, "rooms_at_rest", as_if_every_pair_had_room)
    assert margins(narrow, CLEAR).min() < -1e-6


def as_if_every_pair_had_room(hand: Hand) -> FloatArray:
    return np.full(len(collision_pairs(hand)), np.inf)


@pytest.mark.parametrize("name", hand_names())
def test_hands_that_ship_have_room(name: str) -> None:
    """So their problems ask of all pairs what the options say."""
    assert rooms_at_rest(load_hand(name)).min() >= CLEAR
