"""Base, wrist, palm and fingers: read off the tree of bodies and joints, without any geometry.

A palm is the link from which the most unbranched chains of joints start; each chain is a finger.
Joints between it and the root are the wrist, or, if there are many, an arm that carries the hand.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from planner.bridge.structure import ModelStructure
from planner.errors import HandError, NotFoundError
from planner.spatial import FloatArray

LONGEST_WRIST = 2
"""Joints between root and palm up to which they are a wrist; more are an arm that carries the hand
and that the base leaves out."""

FEWEST_FINGERS = 2
"""A hand has at least two fingers."""


@dataclass(frozen=True, kw_only=True)
class Branch:
    """A chain of joints that starts at the palm: a finger.

    Attributes:
        links: Numbers of its links (first bodies), outwards.
        joints: Numbers of its joints, outwards.
        side_joints: Joints on side branches that the chain leaves out.
    """

    links: tuple[int, ...]
    joints: tuple[int, ...]
    side_joints: tuple[int, ...]


@dataclass(frozen=True, kw_only=True)
class HandTree:
    """How the bodies and joints of an isolated hand are divided up.

    Attributes:
        palm: Number of the palm's link.
        wrist: Numbers of the joints between base and palm, outwards.
        branches: The fingers, in the model's order.
        others: Joints that are in neither.
    """

    palm: int
    wrist: tuple[int, ...]
    branches: tuple[Branch, ...]
    others: tuple[int, ...]


@dataclass(frozen=True)
class _Palm:
    """A link that could be a palm: its link, the root body above it, its chains."""

    link: int
    root: int
    chains: int
    joints: int


def find_base(
    structure: ModelStructure, base_body: str | None, what: str
) -> tuple[str, str, tuple[str, ...]]:
    """The body to take as the hand's base, out of everything that a model file holds.

    Args:
        structure: The whole model.
        base_body: The user's choice, or None.
        what: What the model is called in messages.

    Returns:
        The body's name, why it was chosen, and what remains open.

    Raises:
        NotFoundError: The user's choice does not exist.
        HandError: Nothing in the model looks like a hand, or several things do equally; or its
            links are tied into closed loops.
    """
    names = [b.name for b in structure.bodies]
    if base_body is not None:
        if base_body not in names[1:]:
            raise NotFoundError(f"body of {what}", base_body, names[1:])
        _refuse_loops(structure, names.index(base_body), what)
        return base_body, "you named it", ()
    palms = _palms(structure)
    if not palms:
        _refuse_loops(structure, 0, what)
        raise HandError(
            f"nothing in {what} looks like a hand: no body carries {FEWEST_FINGERS} or more chains "
            "of hinges or slides; if the file is a fragment, describe the file that includes it"
        )
    best = max((p.chains, p.joints) for p in palms)
    first, *rest = [p for p in palms if (p.chains, p.joints) == best]
    if rest:
        _refuse_loops(structure, 0, what)
        found = [_base_of(structure, p)[0] for p in (first, *rest)]
        if len(set(found)) < len(found):  # chains that branch: each branch could be a palm
            found = [structure.bodies[p.link].name for p in (first, *rest)]
        raise HandError(
            f"{what} holds several hands that look alike, on the bodies {found}; say which one is "
            "meant: --base-body NAME (base_body in Python)"
        )
    base, upstream = _base_of(structure, first)
    _refuse_loops(structure, names.index(base), what)
    why = f"the root above the link that carries {first.chains} chains of joints"
    if upstream <= LONGEST_WRIST:
        return base, why, ()
    return (
        base,
        f"the link that carries {first.chains} chains of joints",
        (
            f"{upstream} joints lie between the root of {what} and the hand: they are taken for an "
            "arm and left out; name another base_body (--base-body) to keep some as a wrist",
        ),
    )


def fingers_in_world(structure: ModelStructure) -> bool:
    """Whether the only link that carries chains of joints is the world."""
    chains = [child for child in structure.children(0) if _is_chain(structure, child)]
    return len(chains) >= FEWEST_FINGERS and not _palms(structure)


def _refuse_loops(structure: ModelStructure, base: int, what: str) -> None:
    """Say so where links below a body are tied into loops, as in fingers that rods drive.

    Raises:
        HandError: They are.
    """
    loops = [
        name
        for name, *tied in structure.loops
        if all(_is_below(structure, body, base) for body in tied)
    ]
    if loops:
        some = ", ".join(loops[:4]) + (f" and {len(loops) - 4} more" if len(loops) > 4 else "")
        others = sum(
            j.kind == "other" for j in structure.joints if _is_below(structure, j.body, base)
        )
        balls = f" and has {others} ball or free joints" if others else ""
        raise HandError(
            f"{what} has closed loops: {some} tie links to each other (connect or weld){balls}. A "
            "hand is a tree of hinges and slides here: in a copy of the model, take the rods and "
            "these equalities out, and let each joint that they drove follow another one by "
            '<equality><joint joint1="follower" joint2="driven" polycoef="..."/>'
        )


def read_tree(
    structure: ModelStructure, base_body: str, what: str, ties: Sequence[FloatArray] = ()
) -> HandTree:
    """Palm, wrist and fingers of a hand whose base is ``base_body`` (fixed to the world).

    A chain of which every joint follows one of a longer chain is a rod or a cover, no finger.

    Args:
        structure: The hand.
        base_body: Its base.
        what: What the model is called in messages.
        ties: Rows (nv,) of couplings that hold always.

    Raises:
        HandError: No link below the base carries two chains.
    """
    base = [b.name for b in structure.bodies].index(base_body)
    palms = [p for p in _palms(structure) if _is_below(structure, p.link, base) or p.link == 0]
    if not palms:
        raise HandError(
            f"below {base_body!r} of {what} no link carries {FEWEST_FINGERS} or more chains of "
            "joints; name another base_body (--base-body)"
        )
    palm = max(palms, key=lambda p: (p.chains, p.joints)).link
    wrist: list[int] = []
    link = palm
    while link:
        wrist = structure.joints_of(link) + wrist
        link = structure.bodies[structure.bodies[link].parent].link
    chains = [_branch(structure, child) for child in structure.children(palm)]
    branches = tuple(c for c in chains if not _follows(c, chains, ties))
    used = {*wrist, *(j for b in branches for j in b.joints)}
    return HandTree(
        palm=palm,
        wrist=tuple(wrist),
        branches=branches,
        others=tuple(j for j in range(len(structure.joints)) if j not in used),
    )


def _palms(structure: ModelStructure) -> list[_Palm]:
    """Every link that carries at least two unbranched chains of hinges and slides."""
    out = []
    for link in {b.link for b in structure.bodies}:
        below = structure.children(link)
        for root in {_root(structure, child) for child in below}:
            mine = [c for c in below if _root(structure, c) == root and _is_chain(structure, c)]
            joints = sum(len(_branch(structure, c).joints) for c in mine)
            if len(mine) >= FEWEST_FINGERS:
                out.append(_Palm(link=link, root=root, chains=len(mine), joints=joints))
    return out


def _base_of(structure: ModelStructure, palm: _Palm) -> tuple[str, int]:
    """Name of the base for a palm, and the number of joints between root and palm."""
    bodies = structure.bodies
    upstream, link = 0, palm.link
    while link:
        upstream += sum(structure.joints[j].kind != "other" for j in structure.joints_of(link))
        link = bodies[bodies[link].parent].link
    if upstream <= LONGEST_WRIST:
        return bodies[palm.root].name, upstream
    return bodies[_common_body(structure, palm)].name, upstream


def _common_body(structure: ModelStructure, palm: _Palm) -> int:
    """The lowest body of a palm's link that all its chains hang from."""
    ways = []
    for child in structure.children(palm.link):
        if _root(structure, child) == palm.root:
            way = [structure.bodies[child].parent]
            while way[-1] != palm.link and way[-1]:
                way.append(structure.bodies[way[-1]].parent)
            ways.append(way)
    return next(body for body in ways[0] if all(body in way for way in ways))


def _root(structure: ModelStructure, body: int) -> int:
    """The child of the world above a body."""
    while structure.bodies[body].parent:
        body = structure.bodies[body].parent
    return body


def _follows(chain: Branch, chains: Sequence[Branch], ties: Sequence[FloatArray]) -> bool:
    """Whether every joint of a chain is tied to one of a longer chain."""
    longer = [j for c in chains if len(c.joints) > len(chain.joints) for j in c.joints]
    return all(any(row[j] and row[longer].any() for row in ties) for j in chain.joints)


def _is_below(structure: ModelStructure, body: int, above: int) -> bool:
    while body and body != above:
        body = structure.bodies[body].parent
    return body == above


def _is_chain(structure: ModelStructure, link: int) -> bool:
    """Whether a link and all below it are a chain without branches, of hinges and slides."""
    while True:
        if any(structure.joints[j].kind == "other" for j in structure.joints_of(link)):
            return False
        below = structure.children(link)
        if not below:
            return True
        if len(below) > 1:
            return False
        link = below[0]


def _branch(structure: ModelStructure, link: int) -> Branch:
    """The chain of most joints that starts with a link; the first of equals."""
    tails = [_branch(structure, child) for child in structure.children(link)]
    own = tuple(structure.joints_of(link))
    if not tails:
        return Branch(links=(link,), joints=own, side_joints=())
    longest = max(tails, key=lambda t: len(t.joints))
    aside = [j for t in tails if t is not longest for j in (*t.joints, *t.side_joints)]
    return Branch(
        links=(link, *longest.links),
        joints=own + longest.joints,
        side_joints=(*longest.side_joints, *aside),
    )


_SHORT = r"(?=$|[_:\-.\s\d]|j\d|tip|knuckle|proximal|middle|distal|base|hub|metacarpal|pip|dip|mcp)"
_WORDS = {
    "thumb": rf"thumb|(?<![a-z])th{_SHORT}",
    "index": rf"index|fore_?finger|(?<![a-z])[fi]f{_SHORT}",
    "middle": rf"middle|(?<![a-z])mf{_SHORT}",
    "ring": rf"(?<![a-z])ring|(?<![a-z])rf{_SHORT}",
    "little": rf"little|pinky|pinkie|(?<![a-z])lf{_SHORT}",
}
"""Words in names of bodies and joints that name a finger: whole words, and the abbreviations of
Shadow-type hands where a part of a finger follows."""


def finger_names(
    structure: ModelStructure, branches: Sequence[Branch]
) -> tuple[list[str], list[str]]:
    """Names for the fingers, and why each one.

    The word that most names of a finger's bodies and joints hold; a finger whose names hold none,
    or the same as another's, is numbered.
    """
    votes: list[tuple[str, int, int]] = []
    for branch in branches:
        bodies = [b.name for b in structure.bodies if b.link in branch.links]
        texts = [t.lower() for t in (*bodies, *(structure.joints[j].name for j in branch.joints))]
        counts = {word: sum(bool(re.search(p, t)) for t in texts) for word, p in _WORDS.items()}
        best = max(counts, key=lambda word: counts[word])
        votes.append((best, counts[best], len(texts)))
    names, reasons = [], []
    for i, (word, count, total) in enumerate(votes):
        rivals = [n for k, (other, n, _) in enumerate(votes) if other == word and k != i]
        if count and count > max(rivals, default=0):
            names.append(word)
            reasons.append(f"{count} of {total} names of its bodies and joints say so")
        else:
            names.append(f"finger{i + 1}")
            reasons.append("the names of its bodies and joints suggest none; rename it freely")
    return names, reasons
