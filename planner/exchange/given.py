"""Grasps as a file of another tool tells them: poses and joints, of which nothing is verified.

Every reader makes ``GivenGrasps``, in the conventions of this package and in the order of our
hand's joints; ``planner.audit`` and ``planner.refine`` take them from there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from planner.errors import FileFormatError, few_of
from planner.hands.hand import Hand
from planner.immutable import freeze
from planner.spatial import SE3, FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class GivenGrasp:
    """One grasp of a file.

    Attributes:
        name: What the file calls it, or where in the file it is ("row 12").
        T_object_base: Pose of the hand's base in the frame of the object's own file, scaled; ours
            has its origin at the centre of mass (``planner.exchange.frames.T_file_object``).
        q: Joints at the grasp (nq,), rad (m for slides), order of ``hand.joint_names``.
        q_pregrasp: Joints (nq,) before the grasp; None where the file has none.
        q_squeeze: Joints (nq,) that are commanded to press; None where the file has none.
        object: The object as the file names it, a path or a name; "" where it says nothing.
        scale: Factor on the object's mesh.
        T_world_object: Where that frame is; None where the file says nothing.
        confidence: As the file gives it, without a unit; None where it gives none.
    """

    name: str
    T_object_base: SE3
    q: FloatArray
    q_pregrasp: FloatArray | None = None
    q_squeeze: FloatArray | None = None
    object: str = ""
    scale: float = 1.0
    T_world_object: SE3 | None = None
    confidence: float | None = None

    def __post_init__(self) -> None:
        """Keep read-only copies."""
        held = ("q", *(n for n in ("q_pregrasp", "q_squeeze") if getattr(self, n) is not None))
        poses = ("T_object_base", *(() if self.T_world_object is None else ("T_world_object",)))
        freeze(self, poses=poses, arrays=held)


@dataclass(frozen=True, kw_only=True)
class GivenGrasps:
    """All grasps of a file.

    Attributes:
        source: The file or folder.
        format: Name of its format, as in ``planner.exchange.formats.FORMATS``.
        hand: The hand as the file names it; "" where it says nothing.
        grasps: In the order of the file.
        assumed: What the file does not say and was taken for granted, a sentence each.
    """

    source: Path
    format: str
    hand: str
    grasps: tuple[GivenGrasp, ...]
    assumed: tuple[str, ...] = ()

    def __len__(self) -> int:
        """Number of grasps."""
        return len(self.grasps)


def joints_by_name(
    hand: Hand,
    names: Sequence[str],
    values: FloatArray,
    *,
    where: str,
    other_names: Mapping[str, str] | None = None,
) -> FloatArray:
    """Joints in the order of our hand, from values that a file gives by name.

    Args:
        hand: Our hand.
        names: Joint names of the file.
        values: Their values (n,) or (m, n).
        where: Place in the file, for messages.
        other_names: Name in the file -> name of our joint, where they differ.

    Returns:
        (nq,) or (m, nq).

    Raises:
        FileFormatError: A joint of the hand is missing, is named twice, or a name is unknown; or
            there are more or fewer values than names.
    """
    mine = [(other_names or {}).get(name, name) for name in names]
    missing = [name for name in hand.joint_names if name not in mine]
    foreign = [name for name in mine if name not in hand.joint_names]
    doubled = sorted({name for name in mine if mine.count(name) > 1})
    if doubled:
        raise FileFormatError(f"{where} names twice {few_of(doubled)}; name every joint once")
    if missing or foreign:
        parts = [f"lacks {few_of(missing)}"] * bool(missing)
        parts += [f"names {few_of(foreign)}, which {hand.name} does not have"] * bool(foreign)
        raise FileFormatError(
            f"{where} does not fit {hand.name}: it {' and '.join(parts)}; give the hand that the "
            "file is for with --hand, or say which joint is which with --rename THEIRS=OURS"
        )
    array = np.asarray(values, dtype=float)
    if array.shape[-1] != len(mine):
        raise FileFormatError(
            f"{where} has {array.shape[-1]} values for {len(mine)} joint names; it is damaged"
        )
    return np.array(array[..., [mine.index(name) for name in hand.joint_names]])
