"""The hand description: a short TOML file that names what a model file does not say.

It lies beside the model and names fingers, tip frames, pads, palm, couplings and postures. See
``models/hands/shadow_hand/hand.toml`` for one with everything in it.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from planner.errors import HandError

__all__ = [
    "CouplingDescription",
    "FingerDescription",
    "HandDescription",
    "PadDescription",
    "read_description",
]

Finite = Annotated[float, Field(allow_inf_nan=False)]
Vector = tuple[Finite, Finite, Finite]


def _unit(v: Vector) -> Vector:
    length = float(sum(x * x for x in v) ** 0.5)
    if length < 1e-9:
        raise ValueError("a direction needs a length; give a unit vector")
    return (v[0] / length, v[1] / length, v[2] / length)


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class PadDescription(_Strict):
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


class FingerDescription(_Strict):
    """One finger: joints from the palm outwards, the site that is its tip frame, its pad."""

    name: str
    joints: tuple[str, ...] = Field(min_length=1)
    tip_site: str
    pad: PadDescription


class CouplingDescription(_Strict):
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


class HandDescription(_Strict):
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


def read_description(path: Path) -> HandDescription:
    """Read and validate a description file.

    Raises:
        HandError: Not TOML, or a field is missing, unknown or out of range (each one is named).
    """
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise HandError(f"{path} is not a TOML file: {error}") from error
    try:
        return HandDescription.model_validate(raw)
    except ValidationError as error:
        faults = "; ".join(
            f"{'.'.join(str(k) for k in e['loc']) or 'file'}: {e['msg']}" for e in error.errors()
        )
        raise HandError(f"{path} does not describe a hand: {faults}") from error
