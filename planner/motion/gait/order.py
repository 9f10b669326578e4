"""In which order fingers can move on, one at a time, while the others hold: searched to the end.

A stroke ends with every finger where its stroke ends. Each is to be lifted once and put down where
the stroke begins, while the object stands still. What matters for a lift is which fingers have
moved on before it, not in which order they did: n 2^(n-1) lifts stand for all n! orders. Of all
orders that hold, the one is taken whose least margin is largest (a widest path over the sets of
fingers that have moved on). If there is none, every lift that can be come to has been looked at.

Only contacts are needed, so this works without a hand.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from planner.contacts import ContactSet
from planner.failure import Failure
from planner.quality import closure_of_wrenches, force_closure, primitive_wrenches
from planner.spatial import FloatArray
from planner.tolerances import CLOSURE_EDGES, CLOSURE_MARGIN

__all__ = [
    "CLOSURE_MARGIN",
    "NO_ORDER",
    "Lift",
    "NoOrder",
    "Order",
    "find_order",
    "holding",
    "standing",
]

PROOF_EDGES = 32
"""Sides of the circumscribed pyramid with which it is proven that round cones do not close: it
overstates the friction by 0.5 %."""


@dataclass(frozen=True, kw_only=True)
class Lift:
    """One finger away from the object, the others holding.

    Attributes:
        finger: Number of the finger.
        moved: Numbers of those that have moved on before.
        margin: Normalised min-weight (-) of the contacts that hold.
        failure: Why this lift cannot be, None if it can.
        proven: Whether the contacts that hold do not close with the round cones either.
    """

    finger: int
    moved: frozenset[int]
    margin: float
    failure: Failure | None
    proven: bool = False


@dataclass(frozen=True, kw_only=True)
class Order:
    """An order that holds.

    Attributes:
        lifts: In order, one per finger.
    """

    lifts: tuple[Lift, ...]

    @property
    def margin(self) -> float:
        """Normalised min-weight (-) of the lift where it is least."""
        return min(lift.margin for lift in self.lifts)


@dataclass(frozen=True, kw_only=True)
class NoOrder:
    """No order holds: every lift that can be come to, and why not.

    Attributes:
        names: Names of the fingers.
        lifts: All lifts that were looked at, those that hold too.
        spans: Of each finger, the arc (rad) about the axis of the stroke within which the normals
            of the others lie, where it is largest among its lifts.
        needed: Arc (rad) above which contacts in a plane close.
    """

    names: tuple[str, ...]
    lifts: tuple[Lift, ...]
    spans: tuple[float, ...]
    needed: float

    @property
    def stuck(self) -> tuple[int, ...]:
        """Numbers of the fingers that can never be lifted, of those that are still to be."""
        able = {lift.finger for lift in self.lifts if lift.failure is None}
        return tuple(sorted({lift.finger for lift in self.lifts} - able))

    @property
    def proven(self) -> bool:
        """Whether some finger is never lifted because the others never close, round cones or not.

        It holds for these contacts, with lifts where the stroke ends.
        """
        return any(all(lift.proven for lift in self.lifts if lift.finger == i) for i in self.stuck)

    @property
    def failure(self) -> Failure:
        """The same as a failure."""
        return Failure(kind=NO_ORDER, text=str(self), numbers={"lifts": len(self.lifts)})

    def __str__(self) -> str:
        """One line per finger that can never be lifted, with the numbers of its best lift."""
        n = len(self.lifts)
        lines = [f"no order of lifts holds: {n} lift{'s' if n != 1 else ''} looked at"]
        for i in self.stuck or range(len(self.names)):
            mine = [lift for lift in self.lifts if lift.finger == i and lift.failure is not None]
            if not mine:
                continue
            best = max(mine, key=lambda lift: lift.margin)
            others = ", ".join(name for j, name in enumerate(self.names) if j != i)
            proof = "; proven for round cones" if all(lift.proven for lift in mine) else ""
            lines.append(
                f"  {self.names[i]}: {best.failure}; {others} hold within "
                f"{np.rad2deg(self.spans[i]):.0f} degrees about the axis (in a plane more than "
                f"{np.rad2deg(self.needed):.0f} close){proof}"
            )
        return "\n".join(lines)


def standing(begin: ContactSet, end: ContactSet, moved: frozenset[int]) -> ContactSet:
    """All contacts after some fingers have moved on.

    Args:
        begin: Where the stroke begins, as the object stands now (n contacts).
        end: Where it ends.
        moved: Numbers of those that have moved on.
    """
    return ContactSet.from_contacts(
        [(begin if i in moved else end)[i] for i in range(len(end))], center=end.center
    )


def holding(begin: ContactSet, end: ContactSet, moved: frozenset[int], lifted: int) -> ContactSet:
    """The contacts that hold while one finger is away; see ``standing``."""
    whole = standing(begin, end, moved)
    return ContactSet.from_contacts(
        [whole[i] for i in range(len(whole)) if i != lifted], center=whole.center
    )


def find_order(
    begin: ContactSet,
    end: ContactSet,
    axis: FloatArray,
    *,
    refuse: Callable[[int, frozenset[int]], Failure | None] = lambda finger, moved: None,
    margin: float = CLOSURE_MARGIN,
    moved: frozenset[int] = frozenset(),
) -> Order | NoOrder:
    """The order of lifts with the largest least margin; or what stands against all of them.

    Args:
        begin: Where the stroke begins and fingers land, as the object stands now (n contacts).
        end: Where it ends.
        axis: Axis of the stroke (3,), unit, in the axes of the contacts; for the prose alone.
        refuse: What else stands against lifting a finger after some have moved on, None for
            nothing. Asked only for lifts that are of use.
        margin: Least normalised min-weight of the contacts that hold (-).
        moved: Numbers of the fingers that have moved on already.
    """
    n = len(end)
    lifts: dict[tuple[int, frozenset[int]], Lift] = {}

    def lift(finger: int, moved: frozenset[int]) -> Lift:
        if (finger, moved) not in lifts:
            lifts[finger, moved] = _closed(
                holding(begin, end, moved, finger), finger, moved, margin
            )
        return lifts[finger, moved]

    agreed: set[tuple[int, frozenset[int]]] = set()
    while True:
        found = _widest(n, moved, lift)
        if found is None:
            return NoOrder(
                names=end.fingers,
                lifts=tuple(lifts.values()),
                spans=tuple(
                    max(
                        (
                            _span(holding(begin, end, one.moved, i).normals, axis)
                            for one in lifts.values()
                            if one.finger == i
                        ),
                        default=0.0,
                    )
                    for i in range(n)
                ),
                needed=float(np.pi - 2.0 * np.arctan(end.mu.max())),
            )
        for one in found:
            key = (one.finger, one.moved)
            if key in agreed:
                continue
            why = refuse(*key)
            if why is not None:
                lifts[key] = Lift(finger=key[0], moved=key[1], margin=one.margin, failure=why)
                break
            agreed.add(key)
        else:
            return Order(lifts=found)


def _closed(contacts: ContactSet, finger: int, moved: frozenset[int], margin: float) -> Lift:
    """The lift as far as closure of those that hold goes."""
    closure = force_closure(contacts, edges=CLOSURE_EDGES)
    weight, failure, proven = closure.normalised_min_weight, None, False
    numbers = {"normalised_min_weight": weight, "rank": closure.rank}
    if not closure.closed:
        outer = primitive_wrenches(contacts, PROOF_EDGES, cone="circumscribed")
        proven = not closure_of_wrenches(outer).closed
        why = f"normalised min-weight {weight:.3g}"
        if closure.rank < RANK:
            why = f"rank {closure.rank}"
        text = f"the others do not close ({why})"
        failure = Failure(kind="no_closure", text=text, numbers=numbers)
    elif weight < margin:
        text = f"the others close with a margin of {weight:.3f} only (at least {margin})"
        failure = Failure(kind="closure_margin", text=text, numbers=numbers)
    return Lift(finger=finger, moved=moved, margin=weight, failure=failure, proven=proven)


NO_ORDER = "no_order_of_lifts"
"""Kind of the failure that no order of lifts holds."""

RANK = 6
"""Rank of the wrenches of a closed grasp."""


def _widest(
    n: int, first: frozenset[int], lift: Callable[[int, frozenset[int]], Lift]
) -> tuple[Lift, ...] | None:
    """The lifts of all n fingers but the first, in the order whose least margin is largest.

    None if none holds.
    """
    best: dict[frozenset[int], tuple[float, tuple[Lift, ...]]] = {first: (np.inf, ())}
    layer = [first]
    for _ in range(n - len(first)):
        following: set[frozenset[int]] = set()
        for moved in layer:
            width, way = best[moved]
            for finger in (i for i in range(n) if i not in moved):
                one = lift(finger, moved)
                if one.failure is not None:
                    continue
                after = moved | {finger}
                now = min(width, one.margin)
                if after not in best or now > best[after][0]:
                    best[after] = (now, (*way, one))
                following.add(after)
        layer = sorted(following, key=sorted)
    whole = best.get(frozenset(range(n)))
    return None if whole is None else whole[1]


def _span(normals: FloatArray, axis: FloatArray) -> float:
    """Arc (rad) about an axis within which normals (n, 3) lie: a turn less the largest gap."""
    first = np.eye(3)[int(np.argmin(np.abs(axis)))]
    side = np.cross(axis, first)
    side /= np.linalg.norm(side)
    angles = np.sort(np.arctan2(normals @ side, normals @ np.cross(side, axis)))
    gaps = np.diff(np.append(angles, angles[0] + 2 * np.pi))
    return float(2 * np.pi - gaps.max(initial=0.0))
