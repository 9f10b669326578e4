"""The order in which fingers move on, one at a time, while the others hold: an exhaustive search.

After a stroke every finger is lifted once and put down where the stroke began, while the object
stands still. A lift depends on the set of fingers that have moved on before it, not on their order:
n 2^(n-1) lifts stand for all n! orders. Of the orders that hold, the search returns the one with
the largest least margin (a widest path over the sets of fingers that have moved on). If no order
holds, every reachable lift has been examined.

The search needs contacts only, no hand.
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

PROOF_EDGES = 32
"""Sides of the circumscribed pyramid that proves that round cones do not close. It overstates
friction by 1/cos(pi/32) - 1 = 0.5 %."""


@dataclass(frozen=True, kw_only=True)
class Lift:
    """A lift: one finger off the object while the others hold it.

    Attributes:
        finger: Number of the finger.
        moved: Numbers of those that have moved on before.
        margin: Normalised min-weight (-) of the contacts that hold.
        failure: Why this lift fails, None if it holds.
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
    """No order holds: every reachable lift, and why it fails.

    Attributes:
        names: Names of the fingers.
        lifts: All lifts that were examined, those that hold included.
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
        """Numbers of the fingers that can never be lifted, among those not yet lifted."""
        able = {lift.finger for lift in self.lifts if lift.failure is None}
        return tuple(sorted({lift.finger for lift in self.lifts} - able))

    @property
    def proven(self) -> bool:
        """Whether for some finger the others never close, with round cones either.

        The proof is for these contacts, with lifts where the stroke ends.
        """
        return any(all(lift.proven for lift in self.lifts if lift.finger == i) for i in self.stuck)

    @property
    def failure(self) -> Failure:
        """This result as a failure."""
        return Failure(kind=NO_ORDER, text=str(self), numbers={"lifts": len(self.lifts)})

    def __str__(self) -> str:
        """One line per finger that can never be lifted, with the numbers of its best lift."""
        n = len(self.lifts)
        lines = [f"no order of lifts holds: {n} lift{'s' if n != 1 else ''} examined"]
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
        begin: Contacts where the stroke begins, with the object where it stands now (n contacts).
        end: Contacts where the stroke ends (n contacts).
        moved: Numbers of the fingers that have moved on.
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
    """The order of lifts with the largest least margin; or why no order holds.

    Args:
        begin: Contacts where fingers land, with the object where it stands now (n contacts).
        end: Contacts where the stroke ends (n contacts).
        axis: Axis of the stroke (3,), unit, in the axes of the contacts; used in messages only.
        refuse: Why a finger cannot be lifted after some have moved on, although the others close;
            None if it can. Called only for lifts of a candidate order.
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
    """The lift, judged by the closure of the contacts that hold."""
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
"""Kind of the failure where no order of lifts holds."""

RANK = 6
"""Rank of the wrenches of a force-closed grasp."""


def _widest(
    n: int, first: frozenset[int], lift: Callable[[int, frozenset[int]], Lift]
) -> tuple[Lift, ...] | None:
    """The lifts of the n fingers except those in ``first``, in the best order, see ``find_order``.

    None if no order holds.
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
    """Arc (rad) about an axis that holds all normals (n, 3): a full turn minus the largest gap."""
    first = np.eye(3)[int(np.argmin(np.abs(axis)))]
    side = np.cross(axis, first)
    side /= np.linalg.norm(side)
    angles = np.sort(np.arctan2(normals @ side, normals @ np.cross(side, axis)))
    gaps = np.diff(np.append(angles, angles[0] + 2 * np.pi))
    return float(2 * np.pi - gaps.max(initial=0.0))
