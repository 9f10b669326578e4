"""Reading a ``hand.toml``: the description in it, its model, and what a derived hand changes.

A hand of the other side is described by reference, ``mirror_of``: it has the model and the
description of that hand, both reflected through a coordinate plane of the base's frame. Names of
bodies, joints, tips and pads stay those of the hand it mirrors. See
``models/hands/shadow_hand_left/hand.toml``. In the same way ``motors_of`` makes of any hand one
with torque motors (``planner.bridge.edit``), whose stops are ties: joints that a tendon and its
stop keep together in a grasp move together. See ``models/hands/shadow_hand_torque/hand.toml``.
"""

from __future__ import annotations

import hashlib
import os
import tomllib
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any, Literal, TypeAlias, TypeVar

import numpy as np
from pydantic import Field, ValidationError

from planner.bridge.load import model_files
from planner.errors import HandError, shown
from planner.hands.catalog import PACKAGE_SCHEME, model_file
from planner.joints.description import FingerDescription, HandDescription, TaxelDescription, Vector
from planner.schema import StrictData, faults_of
from planner.spatial import FloatArray

__all__ = [
    "DescribedHand",
    "MirrorAxis",
    "MirrorDescription",
    "MotorsDescription",
    "is_pair",
    "read_description",
    "read_toml",
    "reflection_signs",
    "validated",
]

MirrorAxis: TypeAlias = Literal["x", "y", "z"]
"""Normal of the plane of reflection: an axis of the base."""


class MirrorDescription(StrictData):
    """A ``hand.toml`` that only says which hand it is the mirror image of.

    Attributes:
        name: Name of the mirrored hand.
        summary: One line.
        mirror_of: Description file of the hand to mirror, relative to this file.
        mirror_axis: Normal of the mirror plane through the base's origin, an axis of the base.
    """

    schema_version: Literal[1] = Field(alias="schema")
    name: str
    summary: str = ""
    mirror_of: str
    mirror_axis: MirrorAxis


class MotorsDescription(StrictData):
    """A ``hand.toml`` that only says which hand it is with torque motors.

    Attributes:
        name: Name of this hand.
        summary: One line.
        motors_of: Description file of that hand, which may be a mirror image, relative to this one.
    """

    schema_version: Literal[1] = Field(alias="schema")
    name: str
    summary: str = ""
    motors_of: str


@dataclass(frozen=True, kw_only=True)
class DescribedHand:
    """Contents of a hand's description files.

    Attributes:
        description: The description, reflected already if the hand is a mirror image; its ``model``
            is relative to the file that was read.
        model_path: The model file, as it is on disk.
        mirror_axis: Axis along which that model is still to be reflected, or None.
        described_in: The file that holds fingers, pads and postures.
        files: The description files, the one that was read first; none if the description is a
            proposal.
    """

    description: HandDescription
    model_path: Path
    mirror_axis: MirrorAxis | None
    described_in: Path
    files: tuple[Path, ...]

    @property
    def digest(self) -> str:
        """SHA-256 over the description and the model, with all that the model includes.

        Raises:
            ModelError: The model cannot be read.
        """
        files = (*self.files, *model_files(self.model_path))
        content = b"".join(f.read_bytes() for f in files)
        if not self.files:
            content += self.description.model_dump_json(exclude={"model"}).encode()
        return hashlib.sha256(content).hexdigest()


def reflection_signs(axis: MirrorAxis) -> FloatArray:
    """Diagonal (3,) of the reflection M along a coordinate axis: -1 there, +1 elsewhere."""
    return np.where(np.arange(3) == "xyz".index(axis), -1.0, 1.0)


def read_description(path: Path) -> DescribedHand:
    """Read and validate a description file, and the one that it is derived from if it is.

    Raises:
        HandError: Not TOML, a field is missing, unknown or out of range (each one is named), or the
            hand that it is derived from is missing or itself derived where it must not be.
        ModelError: The model is in a package that is not installed.
    """
    raw = read_toml(path)
    if "motors_of" in raw:
        return _motorised(path, validated(path, MotorsDescription, raw))
    if "mirror_of" not in raw:
        description = validated(path, HandDescription, raw)
        model = model_file(description.model, path.parent)
        return DescribedHand(
            description=description,
            model_path=model,
            mirror_axis=None,
            described_in=path,
            files=(path,),
        )
    mirror = validated(path, MirrorDescription, raw)
    other = path.parent / mirror.mirror_of
    _check_there(path, "mirror_of", other)
    original_raw = read_toml(other)
    if "motors_of" in original_raw:
        raise HandError(
            f"{path}: mirror_of names {other}, a hand with motors in place of its own actuators; "
            "mirror the hand that it is made of, and write motors_of = that mirror image"
        )
    if "mirror_of" in original_raw:
        raise HandError(
            f"{path}: mirror_of names {other}, which is a mirror image itself; name the hand that "
            f"it mirrors, {shown(original_raw['mirror_of'])} beside it"
        )
    original = validated(other, HandDescription, original_raw)
    model = model_file(original.model, other.parent)
    return DescribedHand(
        description=_mirrored(original, mirror),
        model_path=model,
        mirror_axis=mirror.mirror_axis,
        described_in=other,
        files=(path, other),
    )


def _mirrored(original: HandDescription, mirror: MirrorDescription) -> HandDescription:
    """The description of the mirror image: positions and directions p -> M p, all else as it is."""
    signs = reflection_signs(mirror.mirror_axis)

    def reflect(v: Vector) -> Vector:
        x, y, z = (float(c) for c in signs * v + 0.0)  # + 0.0 turns -0.0 into 0.0
        return (x, y, z)

    def reflected(f: FingerDescription) -> FingerDescription:
        rolling = f.pad.rolling_axis and reflect(f.pad.rolling_axis)
        pad = {
            "center": reflect(f.pad.center),
            "axis": reflect(f.pad.axis),
            "rolling_axis": rolling,
            "taxels": f.pad.taxels and _mirrored_array(f.pad.taxels),
        }
        tip = f.tip and f.tip.model_copy(update={"position": reflect(f.tip.position)})
        return f.model_copy(update={"pad": f.pad.model_copy(update=pad), "tip": tip})

    return original.model_copy(
        update={
            "name": mirror.name,
            "model": _seen_from(mirror.mirror_of, original.model),
            "summary": mirror.summary,
            "palm_normal": reflect(original.palm_normal),
            "fingers": tuple(reflected(f) for f in original.fingers),
        }
    )


def _mirrored_array(taxels: TaxelDescription) -> TaxelDescription:
    """The same array on the mirrored pad: columns count from the other side of the bone."""
    dead = tuple((row, taxels.columns - 1 - column) for row, column in taxels.dead)
    return taxels.model_copy(update={"dead": dead})


def _motorised(path: Path, motors: MotorsDescription) -> DescribedHand:
    """The hand of another description file, with motors."""
    other = path.parent / motors.motors_of
    _check_there(path, "motors_of", other)
    original = read_description(other)
    ties = tuple(c.model_copy(update={"kind": "equality"}) for c in original.description.couplings)
    description = original.description.model_copy(
        update={
            "name": motors.name,
            "model": _seen_from(motors.motors_of, original.description.model),
            "summary": motors.summary,
            "couplings": ties,
            "motors": True,
        }
    )
    return replace(original, description=description, files=(path, *original.files))


def _seen_from(other: str, model: str) -> str:
    """The ``model`` line of another description file, relative to the file that names that one."""
    if model.startswith(PACKAGE_SCHEME):
        return model
    return str(PurePosixPath(other).parent / model)


def _check_there(path: Path, field: str, other: Path) -> None:
    if not os.path.isfile(other):  # False, not an error, where the name is too long
        raise HandError(f"{path}: {field} names {other}, which does not exist; correct it")


def read_toml(path: Path) -> dict[str, Any]:
    """The content of a TOML file.

    Raises:
        HandError: It is none.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise HandError(f"{path} is not a TOML file: {error}") from error


def is_pair(path: Path) -> bool:
    """Whether a description file is one of two hands (``planner.hands.two_hands``).

    Raises:
        HandError: It is not TOML.
    """
    return "hands" in read_toml(path)


_Described = TypeVar("_Described", bound=StrictData)


def validated(
    path: Path, kind: type[_Described], raw: dict[str, Any], what: str = "a hand"
) -> _Described:
    """The content of a description file as the description that it is.

    Args:
        path: The file, for the message.
        kind: The schema.
        raw: Its content.
        what: What it describes, for the message.

    Raises:
        HandError: Fields are missing, unknown or out of range; names each.
    """
    try:
        return kind.model_validate(raw)
    except ValidationError as error:
        raise HandError(f"{path} does not describe {what}: {faults_of(error, raw)}") from error
