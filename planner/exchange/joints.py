"""Joints as a driver knows them: which are told, by which names, and which follow.

A joint that no actuator moves and that the equality couplings C q = d tie to the others is a
follower: a driver moves it with the others and has no name for it, so that files for drivers leave
it out. A reader computes it from the same couplings. An actuator that moves several joints (a
tendon) has one number for them, its length R q + length0.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from planner.errors import FileFormatError, NotFoundError, TaskError
from planner.exchange.formats import Writing
from planner.exchange.given import joints_by_name
from planner.exchange.yaml_text import read_documents, table, text
from planner.hands.hand import Hand
from planner.spatial import FloatArray, IntArray

DETERMINED = 1e-9
"""A joint is tied by couplings if each direction that they leave free moves it by less (-)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Channels:
    """Numbers that a driver is told, one per joint or actuator.

    Attributes:
        names: n names, as the file calls them.
        matrix: (n, nq), value = matrix q + offset.
        offset: (n,), rad or m.
        said: Sentences that name joints left out and joints commanded together.
    """

    names: tuple[str, ...]
    matrix: FloatArray
    offset: FloatArray
    said: tuple[str, ...]

    def values(self, q: FloatArray) -> FloatArray:
        """Values (..., n), rad or m, at joints (..., nq)."""
        return np.asarray(np.asarray(q) @ self.matrix.T + self.offset)

    def by_name(self, q: FloatArray) -> dict[str, float]:
        """Values, rad or m, by name at joints (nq,)."""
        return dict(zip(self.names, self.values(q).tolist(), strict=True))


def followers(hand: Hand) -> IntArray:
    """Where joints stand in q that no actuator moves and equality couplings determine."""
    idle = np.flatnonzero(~hand.actuation.moment.any(axis=0))
    rows = _equalities(hand)[0][:, idle]
    if not len(idle) or not len(rows):
        return np.zeros(0, dtype=int)
    _, sizes, directions = np.linalg.svd(rows)
    rank = int((sizes > DETERMINED * sizes.max(initial=1.0)).sum())
    free = np.abs(directions[rank:]).max(axis=0, initial=0.0)
    return np.asarray(idle[free < DETERMINED])


def channels_of(hand: Hand, writing: Writing) -> Channels:
    """What a file tells of a hand's joints.

    Raises:
        NotFoundError: ``rename`` names a joint or actuator that is not told.
        TaskError: Two would have one name, or the hand has no actuators to go by.
    """
    left_out = followers(hand)
    if writing.by == "actuators":
        actuation = hand.actuation
        if not actuation.names:
            raise TaskError(f"{hand.name} has no actuators; export it by joints")
        names, matrix, offset = actuation.names, actuation.moment, actuation.length0
        what = "actuator"
        said: tuple[str, ...] = ("values are lengths of actuators, not positions of joints",)
    else:
        kept = np.setdiff1d(np.arange(hand.nq), left_out)
        names = tuple(hand.joint_names[i] for i in kept)
        matrix, offset, what = np.eye(hand.nq)[kept], np.zeros(len(kept)), "joint"
        said = ()
    if len(left_out):
        tied = ", ".join(hand.joint_names[i] for i in left_out)
        said += (f"left out, since they follow other joints by couplings: {tied}",)
    loose = np.setdiff1d(np.flatnonzero(~hand.actuation.moment.any(axis=0)), left_out)
    if len(loose):
        idle = ", ".join(hand.joint_names[i] for i in loose)
        said += (f"moved by no actuator and tied by no coupling that always holds: {idle}",)
    return Channels(
        names=renaming(names, writing.rename, f"{what} of {hand.name}"),
        matrix=matrix,
        offset=offset,
        said=said + _together(hand),
    )


def completed_joints(
    hand: Hand,
    names: Sequence[str],
    values: FloatArray,
    *,
    where: str,
    other_names: Mapping[str, str] | None = None,
) -> FloatArray:
    """Joints (nq,) of our hand from values by name, with followers from the couplings.

    Args:
        hand: Our hand.
        names: Joint names of the file.
        values: (n,), rad or m.
        where: Place in the file, for messages.
        other_names: Name in the file -> name of our joint, where they differ.

    Raises:
        FileFormatError: As ``joints_by_name``; followers may be missing.
    """
    mine = {(other_names or {}).get(name, name) for name in names}
    tied = np.array([i for i in followers(hand) if hand.joint_names[i] not in mine], dtype=int)
    added = [hand.joint_names[i] for i in tied]
    padded = np.concatenate([np.asarray(values, dtype=np.float64), np.zeros(len(tied))])
    q = joints_by_name(hand, [*names, *added], padded, where=where, other_names=other_names)
    if len(tied):
        matrix, value = _equalities(hand)
        rest = value - matrix @ q  # followers are at zero in it
        q[tied] = np.linalg.lstsq(matrix[:, tied], rest, rcond=None)[0]
    if not np.isfinite(q).all():
        raise FileFormatError(f"{where} holds NaN or infinity; give finite numbers")
    return q


def renaming(names: Sequence[str], rename: Mapping[str, str], what: str) -> tuple[str, ...]:
    """Names after a renaming.

    Args:
        names: Ours.
        rename: Ours -> theirs, where they differ.
        what: What they are names of, for messages: "joint of NAME".

    Raises:
        NotFoundError: A name that is not there is renamed.
        TaskError: Two would have one name.
    """
    for name in rename:
        if name not in names:
            raise NotFoundError(what, name, names)
    new = tuple(rename.get(name, name) for name in names)
    doubled = sorted({name for name in new if new.count(name) > 1})
    if doubled:
        raise TaskError(
            f"after renaming, more than one {what} is called {', '.join(doubled)}; give each a "
            "name of its own"
        )
    return new


def read_renaming(path: Path) -> dict[str, str]:
    """Names out of a TOML, YAML or JSON file of OLD = NEW.

    Raises:
        FileFormatError: It cannot be read, or holds something else.
    """
    what = "a file of names"
    if path.suffix.lower() == ".toml":
        try:
            data: Any = tomllib.loads(path.read_text("utf-8"))
        except OSError as error:
            raise FileFormatError(f"cannot read {what} {path}: {error.strerror}") from error
        except ValueError as error:  # not TOML, or not text
            raise FileFormatError(f"{path} is damaged or not TOML: {error}") from error
    else:
        documents = read_documents(path, what)
        data = documents[0] if len(documents) == 1 else documents
    return {old: text(new, f"{path}: {old}") for old, new in table(data, str(path)).items()}


def _equalities(hand: Hand) -> tuple[FloatArray, FloatArray]:
    """C (m, nq) and d (m,) of the couplings that hold always, not in a grasp alone."""
    chosen = [c for c in hand.couplings if not c.one_sided]
    rows = np.array([c.row for c in chosen], dtype=np.float64).reshape(-1, hand.nq)
    return rows, np.array([c.value for c in chosen], dtype=np.float64)


def _together(hand: Hand) -> tuple[str, ...]:
    """Sentences on actuators that move more than one joint."""
    actuation = hand.actuation
    told = []
    for name, row in zip(actuation.names, actuation.moment, strict=True):
        at = np.flatnonzero(row)
        if len(at) > 1:
            parts = " + ".join(
                hand.joint_names[i] if row[i] == 1.0 else f"{row[i]:g} {hand.joint_names[i]}"
                for i in at
            )
            told.append(f"actuator {name} commands {parts}")
    return tuple(told)
