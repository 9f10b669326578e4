"""Terms of a motion beside those of its grasps, and the names of their rows."""

from __future__ import annotations

from dataclasses import replace

from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.synthesis.objectives.joint import driving
from planner.synthesis.terms.contact import PER_METRE
from planner.synthesis.terms.forces import BALANCE, CONE, LEVEL, PRESS
from planner.synthesis.terms.term import Role, Row, Term

ROLLING = Term(
    name="rolling",
    meaning="slip of each tip from knot to knot",
    role=Role.EQUALITY,
    unit="m",
    weight=PER_METRE,
    judged="slip between knots, by Pinocchio",
)

PATH = Term(
    name="path",
    meaning="path tolerance less the object's distance from its path",
    role=Role.INEQUALITY,
    unit="m",
    weight=PER_METRE,
    wording="the path tolerance",
    judged="path tolerance",
)

PIVOTING = Term(
    name="pivoting",
    meaning="turn of each tip about its contact's normal from knot to knot, where that costs",
    role=Role.COST,
    unit="rad",
    weight=12.0,
)
"""Torsional friction holds up an object that is turned against pivoting tips. With pads as wide as
the tips are round, the weight 12 turns balls of 54 and 60 mm in the Shadow-type hand with 4 to 12
mN m (6 plans), 5 with 8 to 17 mN m (7 plans); with 20 fewer starts hold."""

SWING: tuple[Term, ...] = tuple(
    replace(
        term,
        name=f"swing_{term.name}",
        meaning=f"while a finger swings, of the others' forces: {term.meaning}",
        write=None,
        wording="closure without {}",
        judged="closure at each regrasp",
    )
    for term in (BALANCE, LEVEL, CONE, PRESS)
)
"""Force closure of the stance: the contacts that hold the object while one finger swings."""

LOAD = Term(
    name="load",
    meaning="largest share of its limit that an actuator may spend, less the share it spends",
    role=Role.INEQUALITY,
    unit="-",
    weight=2.0,
    wording="load of actuator {}",
    judged="the force programme at every knot",
)
"""With this weight a motion that spends a tenth more is still worth verifying."""

BEARING = Term(
    name="bearing",
    meaning="friction less the tangential force under the weight, over the mean normal force",
    role=Role.INEQUALITY,
    unit="-",
    weight=5.0,
    wording="friction of {} under the weight",
    judged="the force programme at every knot",
)

STEADY = Term(
    name="steady",
    meaning="second differences of the joints over the knots, over their ranges",
    role=Role.COST,
    unit="-",
    weight=1.0,
)
"""Without this cost redundant fingers take another posture at every knot."""

REACH = Term(
    name="reach",
    meaning="missing share of the path, where its length is maximised",
    role=Role.EQUALITY,
    unit="rad",
    weight=4.0,
    judged="the share is fixed before the verdict",
)
"""The weight is that of one radian, or of 35 mm (a fingertip's way in that). It makes a radian
worth some 0.1 mm of violation, which the last run of least squares takes back."""

MOTION_TERMS = (ROLLING, PATH, *SWING, LOAD, BEARING, REACH, PIVOTING, STEADY)
"""All of them."""


def rows_of_fingers(term: Term, fingers: tuple[Finger, ...], each: int, knot: int) -> list[Row]:
    """Names of rows, ``each`` for every finger, finger by finger."""
    about = [f.name for f in fingers for _ in range(each)]
    return [term.row((name,), i, knot) for i, name in enumerate(about)]


def swing_rows(fingers: tuple[Finger, ...], swinging: int, knot: int) -> list[Row]:
    """Names of the rows of closure while one finger swings, in the order of ``StanceRows``."""
    n = len(fingers) - 1
    sizes = zip(SWING, (6, 1, n, n), strict=True)
    about = (fingers[swinging].name,)
    return [term.row(about, i, knot) for term, size in sizes for i in range(size)]


def load_rows(hand: Hand, fingers: tuple[Finger, ...], knot: int) -> list[Row]:
    """Names of the rows of loads at a knot: actuators, then contacts."""
    actuators = [hand.actuation.names[k] for k in driving(hand, fingers)]
    rows = [LOAD.row((name,), i, knot) for i, name in enumerate(actuators)]
    return rows + rows_of_fingers(BEARING, fingers, 1, knot)


def steady_rows(hand: Hand, knot: int) -> list[Row]:
    """Names of the rows of even motion of the joints past a knot."""
    return [STEADY.row((name,), i, knot) for i, name in enumerate(hand.joint_names)]
