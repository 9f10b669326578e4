"""The hand description: a short TOML file that names what a model file does not say.

It lies beside the model and names fingers, tip frames, pads, palm, couplings and postures. See
``models/hands/shadow_hand/hand.toml`` for one with everything in it.

A hand of the other side is described by reference, ``mirror_of``: it has the model and the
description of that hand, both reflected through a coordinate plane of the base's frame. Names of
bodies, joints, tips and pads stay those of the hand it mirrors. See
``models/hands/shadow_hand_left/hand.toml``.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Literal, TypeAlias, TypeVar

import numpy as np
from pydantic import Field, ValidationError, field_validator

from planner.errors import HandError
from planner.schema import StrictData, faults_of
from planner.spatial import FloatArray

__all__ = [
    "CouplingDescription",
    "DescribedHand",
    "FingerDescription",
    "HandDescription",
    "MirrorAxis",
    "MirrorDescription",
    "PadDescription",
    "read_description",
    "reflection_signs",
]

Finite = Annotated[float, Field(allow_inf_nan=False)]
Vector = tuple[Finite, Finite, Finite]
MirrorAxis: TypeAlias = Literal["x", "y", "z"]


def _unit(v: Vector) -> Vector:
    length = float(sum(x * x for x in v) ** 0.5)
    if length < 1e-9:
        raise ValueError("a direction needs a length; give a unit vector")
    return (v[0] / length, v[1] / length, v[2] / length)


class PadDescription(StrictData):
    """Spherical contact pad, rigid in the body that carries ``geom``.

    Attributes:
        geom: Collision geom whose surface the pad is part of.
        center: Centre of the sphere in that body's frame, m.
        radius: Radius, m.
        axis: Direction the pad faces, in that body's frame; normalised on reading.
        half_angle_deg: Contact points lie within this cone about ``axis``, seen from the centre.
    """

    geom: str
    center: Vector
    radius: float = Field(gt=0, lt=0.1)
    axis: Vector
    half_angle_deg: float = Field(gt=0, le=90)

    @field_validator("axis")
    @classmethod
    def _normalise(cls, v: Vector) -> Vector:
        return _unit(v)


class FingerDescription(StrictData):
    """One finger: joints from the palm outwards, the site that is its tip frame, its pad."""

    name: str
    joints: tuple[str, ...] = Field(min_length=1)
    tip_site: str
    pad: PadDescription


class CouplingDescription(StrictData):
    """Kinematic coupling: sum of coefficient times joint position equals ``value`` in a grasp.

    Attributes:
        name: What the coupling is called.
        joints: Coefficient per joint.
        value: Right-hand side, rad (or m).
        kind: "stop" for a one-sided stop that is active in a grasp (it can only push the
            expression up), "equality" for a two-sided one.
    """

    name: str
    joints: dict[str, Finite] = Field(min_length=1)
    value: Finite = 0.0
    kind: Literal["stop", "equality"]


class HandDescription(StrictData):
    """Everything in a ``hand.toml``; angles of postures in rad (slides in m)."""

    schema_version: Literal[1] = Field(alias="schema")
    name: str
    model: str
    summary: str = ""
    source: str = ""
    base_body: str
    palm_body: str
    palm_normal: Vector
    wrist_joints: tuple[str, ...] = ()
    default_fingers: tuple[str, ...] = ()
    allowed_contacts: tuple[tuple[str, str], ...] = ()
    fingers: tuple[FingerDescription, ...] = ()
    couplings: tuple[CouplingDescription, ...] = ()
    postures: dict[str, dict[str, Finite]] = Field(default_factory=dict)

    @field_validator("palm_normal")
    @classmethod
    def _normalise(cls, v: Vector) -> Vector:
        return _unit(v)


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


@dataclass(frozen=True, kw_only=True)
class DescribedHand:
    """What description files say about a hand.

    Attributes:
        description: The description, reflected already if the hand is a mirror image; its ``model``
            is relative to the file that was read.
        model_path: The model file, as it is on disk.
        mirror_axis: Axis along which that model is still to be reflected, or None.
        described_in: The file that holds fingers, pads and postures.
        files: Every file that determines the hand.
    """

    description: HandDescription
    model_path: Path
    mirror_axis: MirrorAxis | None
    described_in: Path
    files: tuple[Path, ...]


def reflection_signs(axis: MirrorAxis) -> FloatArray:
    """Diagonal (3,) of the reflection M along a coordinate axis: -1 there, +1 elsewhere."""
    return np.where(np.arange(3) == "xyz".index(axis), -1.0, 1.0)


def read_description(path: Path) -> DescribedHand:
    """Read and validate a description file, and the one that it mirrors if it does.

    Raises:
        HandError: Not TOML, a field is missing, unknown or out of range (each one is named), or the
            hand to mirror is missing or a mirror image itself.
    """
    raw = _read_toml(path)
    if "mirror_of" not in raw:
        description = _validated(path, HandDescription, raw)
        model = path.parent / description.model
        return DescribedHand(
            description=description,
            model_path=model,
            mirror_axis=None,
            described_in=path,
            files=(path, model),
        )
    mirror = _validated(path, MirrorDescription, raw)
    other = path.parent / mirror.mirror_of
    if not other.is_file():
        raise HandError(f"{path}: mirror_of names {other}, which does not exist; correct it")
    original_raw = _read_toml(other)
    if "mirror_of" in original_raw:
        raise HandError(
            f"{path}: mirror_of names {other}, which is a mirror image itself; name the hand that "
            f"it mirrors, {original_raw['mirror_of']!r} beside it"
        )
    original = _validated(other, HandDescription, original_raw)
    model = other.parent / original.model
    return DescribedHand(
        description=_mirrored(original, mirror),
        model_path=model,
        mirror_axis=mirror.mirror_axis,
        described_in=other,
        files=(path, other, model),
    )


def _mirrored(original: HandDescription, mirror: MirrorDescription) -> HandDescription:
    """The description of the mirror image: positions and directions p -> M p, all else as it is."""
    signs = reflection_signs(mirror.mirror_axis)

    def reflect(v: Vector) -> Vector:
        x, y, z = (float(c) for c in signs * v + 0.0)  # + 0.0 turns -0.0 into 0.0
        return (x, y, z)

    fingers = tuple(
        f.model_copy(
            update={
                "pad": f.pad.model_copy(
                    update={"center": reflect(f.pad.center), "axis": reflect(f.pad.axis)}
                )
            }
        )
        for f in original.fingers
    )
    return original.model_copy(
        update={
            "name": mirror.name,
            "model": str(PurePosixPath(mirror.mirror_of).parent / original.model),
            "summary": mirror.summary,
            "palm_normal": reflect(original.palm_normal),
            "fingers": fingers,
        }
    )


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise HandError(f"{path} is not a TOML file: {error}") from error


_Described = TypeVar("_Described", bound=StrictData)


def _validated(path: Path, kind: type[_Described], raw: dict[str, Any]) -> _Described:
    try:
        return kind.model_validate(raw)
    except ValidationError as error:
        raise HandError(f"{path} does not describe a hand: {faults_of(error)}") from error
