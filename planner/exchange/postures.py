"""Joints and poses of a file that says little of itself, as one of our hands has them.

A file may name no joints, name them by another numbering, leave out a wrist, and give the pose of a
body that is not the hand's base. ``FileJoints`` settles this once per file.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from planner.errors import FileFormatError, few_of
from planner.exchange.formats import Reading
from planner.exchange.frames import T_base_body
from planner.exchange.given import joints_by_name
from planner.hands.hand import Hand
from planner.spatial import SE3, FloatArray, pose_from_wxyz

_SHADOW = re.compile(r"(?:robot0:|rh_|lh_)?((?:FF|MF|RF|LF|TH|WR)J)(\d)")
"""Joints of the Shadow hand: its maker counts from 1, the model of OpenAI (``robot0:``) from 0."""

NORM_TOL = 1e-2
"""How far the length of a quaternion may be from 1 (-): files hold single precision."""


def pose_of_seven(values: FloatArray, order: str, where: str) -> SE3:
    """Pose from position (m) and quaternion in one (7,).

    Args:
        values: (7,).
        order: "wxyz" or "xyzw".
        where: Place in the file, for messages.

    Raises:
        FileFormatError: Other numbers, not finite, or no unit quaternion.
    """
    array = np.asarray(values, dtype=float).reshape(-1)
    if array.shape != (7,) or not np.isfinite(array).all():
        raise FileFormatError(
            f"{where} is {np.shape(values)} numbers, or not finite; a pose is x, y, z (m) and a "
            f"quaternion {', '.join(order)}"
        )
    norm = float(np.linalg.norm(array[3:]))
    if abs(norm - 1.0) > NORM_TOL:
        raise FileFormatError(
            f"{where}: the last four of {np.round(array, 4).tolist()} have length {norm:.4g}, and "
            "a quaternion has length 1; it is damaged, or not a pose x, y, z and a quaternion"
        )
    quaternion = array[3:] if order == "wxyz" else array[[6, 3, 4, 5]]
    return pose_from_wxyz(array[:3], quaternion)


class FileJoints:
    """How the joints of a file become those of a hand, and its poses those of the hand's base."""

    def __init__(
        self,
        hand: Hand,
        reading: Reading,
        where: str,
        *,
        names: Sequence[str] | None = None,
        count: int,
        base_body: str = "",
    ) -> None:
        """Settle names.

        Args:
            hand: Our hand.
            reading: What the reader is told.
            where: The file, for messages.
            names: As the file gives them; None where it gives none.
            count: How many joints the file has.
            base_body: Body whose pose the format gives, if ``reading`` names no other; "" for the
                hand's base.

        Raises:
            FileFormatError: The file names no joints and nobody did, or they do not fit.
            NotFoundError: The hand has no such body.
        """
        self.hand, self.where = hand, where
        self.body = reading.base_body or base_body
        self.assumed: list[str] = []
        told = reading.joint_names or names
        held = self._held()
        if reading.joint_names is not None and len(reading.joint_names) != count:
            raise FileFormatError(
                f"{where} has {count} joints and --joint-names gives {len(reading.joint_names)}; "
                "give a name for each, in the order of the file"
            )
        if told is None and reading.by_number:
            wanted = [n for n in hand.joint_names if n not in held]
            whole = count == hand.nq
            if not whole and count != len(wanted):
                raise FileFormatError(
                    f"{where} has {count} joints, {hand.name} has {hand.nq}"
                    f"{f' ({len(wanted)} without those above {self.body})' if held else ''}; give "
                    "the hand that the file is for, or --joint-names"
                )
            told = hand.joint_names if whole else wanted
            self.assumed.append(f"joints are in the order of {hand.name}")
        if told is None:
            raise FileFormatError(
                f"{where} has {count} joints and does not name them; if they are in the order of "
                f"{hand.name} ({few_of(hand.joint_names)}), say --by-number, else give their "
                "names with --joint-names"
            )
        self.names = [reading.rename.get(n) or _ours(n, hand) for n in told]
        self.missing = [n for n in held if n not in self.names]
        if self.missing:
            joints = ", ".join(self.missing)
            self.assumed.append(
                f"{joints}, which the file lacks and which do not move {self.body}, are at 0"
            )

    def _held(self) -> list[str]:
        """Joints between the hand's base and the body of the poses."""
        if not self.body:
            return []
        T_base_body(self.hand, self.hand.neutral, self.body)  # refuses what there is not
        model = self.hand.mj_model
        chain, at = [], int(model.body(self.body).id)
        while at:
            first, number = int(model.body_jntadr[at]), int(model.body_jntnum[at])
            chain += [str(model.joint(j).name) for j in range(first, first + number)]
            at = int(model.body_parentid[at])
        return [n for n in self.hand.joint_names if n in chain]

    def of(self, values: FloatArray, where: str = "") -> FloatArray:
        """Joints (nq,) or (m, nq) of ours from those of the file (n,) or (m, n).

        Raises:
            FileFormatError: They are not as many, not numbers, or not finite.
        """
        place = where or self.where
        try:
            array = np.asarray(values, dtype=float)
        except (TypeError, ValueError):
            raise FileFormatError(f"{place} holds joints that are no numbers") from None
        if not np.isfinite(array).all():
            raise FileFormatError(f"{place} holds joints that are not finite; leave it out")
        if array.ndim and array.shape[-1] != len(self.names):
            raise FileFormatError(
                f"{place} has {array.shape[-1]} values for {len(self.names)} joints; it is damaged"
            )
        filled = np.concatenate([array, np.zeros((*array.shape[:-1], len(self.missing)))], axis=-1)
        return joints_by_name(self.hand, [*self.names, *self.missing], filled, where=place)

    def base(self, T_object_body: SE3, q: FloatArray) -> SE3:
        """Pose of the hand's base from that of the body that the file tells."""
        if not self.body:
            return T_object_body
        return T_object_body * T_base_body(self.hand, q, self.body).inverse()


def _ours(name: str, hand: Hand) -> str:
    """The joint of a hand that a file means by a name: the same, or one of the Shadow hand's."""
    if name in hand.joint_names:
        return name
    named = _SHADOW.fullmatch(name)
    if named is None:
        return name
    mine = {_numbered(joint): joint for joint in hand.joint_names}
    return mine.get(_numbered(name), name)


def _numbered(name: str) -> tuple[str, int] | None:
    """A joint of the Shadow hand with its maker's number; None for another."""
    named = _SHADOW.fullmatch(name)
    if named is None:
        return None
    return named[1], int(named[2]) + name.startswith("robot0:")
