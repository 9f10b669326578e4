"""Grasp types: which fingers, links and palm of a hand may touch, by a name.

Called by ``GraspTask.create``. A type gives sets of contacts (``Hand.contact_parts``) that the
search tries in turns. To add one, write its function and enter it in ``GRASP_TYPES``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import chain, pairwise

import numpy as np
import pinocchio as pin

from planner.errors import NotFoundError, TaskError
from planner.hands.fingers import FLANK, Finger, Side, opposing
from planner.hands.hand import Hand
from planner.joints.description import PINCH
from planner.spatial import FloatArray

__all__ = ["GRASP_TYPES", "contact_sets"]

ContactSets = tuple[tuple[str, ...], ...]

FINGERTIP, ANY = "fingertip", "any"

LEAST_LINE = 0.008
"""Least half length (m) of an inner link that is worth a contact: knuckles are shorter."""

FEW = 2
"""Number of fingers beside the opposer in the set for objects too small for all fingers."""

INNER_LINKS = 2
"""Fingers beside the opposer of a power grasp that touch with an inner link too, where the opposer
has none: more can seldom lie on one object."""

AROUND = (3, 1)
"""Turns of a power grasp's set with inner links before each set without: where it had every fourth
turn, the Shadow-type hand's certified breaking force was 2.2 in place of 2.8 times that of its
fingertips (7 objects, 2 seeds)."""


def contact_sets(hand: Hand, grasp_type: str) -> ContactSets:
    """Sets of names of fingers and links, in the order in which a search tries them.

    Raises:
        NotFoundError: No such type.
        TaskError: The hand has not what the type needs.
    """
    if grasp_type not in GRASP_TYPES:
        raise NotFoundError("grasp type", grasp_type, GRASP_TYPES)
    return GRASP_TYPES[grasp_type](hand)


def _by_nearness(hand: Hand, side: Side | None = None) -> list[Finger]:
    """The fingers of a grasp: the one that opposes the others, then those, the nearest first.

    Args:
        hand: The hand.
        side: Of which of two hands; of both if None.
    """
    fingers = [f for f in hand.choose_fingers() if side is None or f.name in side.fingers]
    data = hand.pin_model.createData()
    pin.forwardKinematics(hand.pin_model, data, hand.posture(PINCH))
    centers = np.array([data.oMi[f.pad.joint_id].act(f.pad.center) for f in fingers])
    opposer = opposing(hand.pin_model, fingers, hand.posture(PINCH))
    order = np.argsort(np.linalg.norm(centers - centers[opposer], axis=1), kind="stable")
    return [fingers[i] for i in order]


def _links(hand: Hand, finger: Finger) -> list[Finger]:
    """Links of a finger that may touch, from the palm outwards; the last is that of its tip."""
    own = [
        p
        for p in hand.contact_parts.values()
        if p.is_link and p.bodies <= finger.bodies and not p.name.endswith(FLANK)
    ]
    tip = finger.pad.joint_id
    return [p for p in own if p.pad.joint_id == tip or _is_long(p)]


def _is_long(part: Finger) -> bool:
    return bool(np.linalg.norm(part.pad.reach, axis=1).max(initial=0.0) >= LEAST_LINE)


def _few(hand: Hand, count: int, name: str) -> ContactSets:
    fingers = _by_nearness(hand)
    if len(fingers) < count:
        raise TaskError(
            f"a {name} takes {count} fingers, and {hand.name} has {len(fingers)}; use another type"
        )
    return (tuple(f.name for f in fingers[:count]),)


def _power(hand: Hand) -> ContactSets:
    """Palm and last links of all fingers with an inner link of the opposer; without it; or few.

    The worst push is one against the opposer, whose tip is far from its joints: with an inner link
    of it beside the tip a grasp breaks at twice the load (Shadow-type hand). Where it has none,
    inner links of two others take its place. Sets with inner links come first (``AROUND``).
    """
    return _both([_power_of(hand, side) for side in hand.sides])


def _both(sets: Sequence[ContactSets]) -> ContactSets:
    """Sets of both hands of two, side by side; of one hand as they are."""
    return tuple(tuple(chain.from_iterable(one)) for one in zip(*sets, strict=False))


def _power_of(hand: Hand, side: Side) -> ContactSets:
    palm = side.palm_body
    if palm not in hand.contact_parts:
        raise TaskError(
            f"the palm {palm!r} of {hand.name} has no geometry that could touch; use fingertip"
        )
    opposer, *others = _by_nearness(hand, side)
    last = [_last(hand, f) for f in (opposer, *others)]
    inner = [
        [part[-3].name for f in fingers if len(part := _links(hand, f)) > 2]
        for fingers in ([opposer], others)
    ]
    around = (*last, *(inner[0] or inner[1][:INNER_LINKS]), palm)
    sets = [(*last, palm)]
    if len(others) > FEW:
        sets.append((*last[: 1 + FEW], palm))
    if not any(inner):
        return tuple(sets)
    turns = zip(AROUND, sets, strict=False)
    return tuple(chain.from_iterable((*(around,) * n, one) for n, one in turns))


def _last(hand: Hand, finger: Finger) -> str:
    """Name of what touches last on a finger: its last link, or itself."""
    links = _links(hand, finger)
    return links[-1].name if links else finger.name


def _hook(hand: Hand) -> ContactSets:
    """Last and inner links of all fingers but the opposer, around a bar; or last links and palm.

    Raises:
        TaskError: Its fingers have no inner links that could touch, or the hand is two.
    """
    hand.require_one("a hook")
    _, *others = _by_nearness(hand)
    inner = [part[-3].name for f in others if len(part := _links(hand, f)) > 2]
    if len(inner) < FEW:
        raise TaskError(
            f"a hook takes two fingers with inner links that can touch, and {hand.name} has "
            f"{len(inner)} of them beside the one that opposes; use fingertip or tripod"
        )
    last = [_last(hand, f) for f in others]
    palm = [hand.sides[0].palm_body]
    around = (*last, *inner)
    return (around, (*last, *palm)) if palm[0] in hand.contact_parts else (around,)


def _lateral(hand: Hand) -> ContactSets:
    """The opposer's tip against flanks of two links of the finger beside it, as one holds a key.

    Raises:
        TaskError: That finger has no two long round links, or the hand is two.
    """
    hand.require_one("a lateral grasp")
    opposer, *others = _by_nearness(hand)
    beside = min(others, key=lambda f: float(np.linalg.norm(_root(hand, f) - _root(hand, opposer))))
    flanks = [
        name
        for link in _links(hand, beside)
        if (name := link.name + FLANK) in hand.contact_parts and _is_long(hand.contact_parts[name])
    ]
    if len(flanks) < FEW:
        raise TaskError(
            f"a lateral grasp takes the flanks of two links of {beside.name}, and {hand.name} has "
            f"{len(flanks)}; use pinch or tripod"
        )
    return tuple((opposer.name, *pair) for pair in pairwise(flanks))


def _root(hand: Hand, finger: Finger) -> FloatArray:
    """Where a finger begins (3,), m, in the hand's base."""
    data = hand.pin_model.createData()
    pin.forwardKinematics(hand.pin_model, data, hand.neutral)
    first = hand.pin_model.getJointId(finger.joints[0])
    return np.array(data.oMi[first].translation)


def _palms(hand: Hand) -> ContactSets:
    """Both palms of two hands, with the last links of two fingers or of all but the opposer.

    Raises:
        TaskError: It is one hand.
    """
    if not hand.pair:
        raise TaskError(
            f"palms takes two hands, and {hand.name} is one; load two (two_allegro_hands, "
            "two_shadow_hands), or use power"
        )
    out = []
    for side in hand.sides:
        _, *others = _by_nearness(hand, side)
        last = [_last(hand, f) for f in others]
        out.append(((last[0], last[-1], side.palm_body), (*last, side.palm_body)))
    return _both(out)


def _any(hand: Hand) -> ContactSets:
    kinds = (FINGERTIP, "palms" if hand.pair else "power")
    return tuple(dict.fromkeys(chain.from_iterable(GRASP_TYPES[name](hand) for name in kinds)))


GRASP_TYPES: Mapping[str, Callable[[Hand], ContactSets]] = {
    FINGERTIP: lambda hand: (tuple(f.name for f in hand.choose_fingers()),),
    "pinch": lambda hand: _few(hand, 2, "pinch"),
    "tripod": lambda hand: _few(hand, 3, "tripod"),
    "power": _power,
    "hook": _hook,
    "lateral": _lateral,
    "palms": _palms,
    ANY: _any,
}
"""Sets of contacts of a hand, by the name of the type."""
