"""The hand description: a short TOML file with what a model file does not contain.

It lies beside the model and names fingers, tip frames, pads, palm, couplings and postures. See
``models/hands/shadow_hand/hand.toml`` for one with everything in it.
"""

from __future__ import annotations

from math import pi
from typing import Annotated, Any, Literal, Self

from pydantic import (
    Field,
    SerializerFunctionWrapHandler,
    StrictInt,
    ValidationInfo,
    field_validator,
    model_serializer,
    model_validator,
)

from planner.schema import StrictData

__all__ = [
    "ActuatorDescription",
    "CouplingDescription",
    "FingerDescription",
    "HandDescription",
    "JointDefaults",
    "PadDescription",
    "RepairDescription",
    "TaxelDescription",
    "TipDescription",
    "Vector",
]

Finite = Annotated[float, Field(allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Vector = tuple[Finite, Finite, Finite]
"""Three finite numbers x, y, z."""


LEAST_COEFFICIENT, MOST_COEFFICIENT = 1e-6, 1e6
"""Size of a joint's coefficient in a coupling (-) below which it ties nothing, and above which it
drowns the others in rounding."""

MOST_REACH = 2.0944
"""How far (rad) an array reaches from its middle to the middle of a side: 120 degrees."""

PINCH, OPEN = "pinch", "open"
"""Postures that every description gives: pads opposed, and wide open."""

_TO_THE_BIT = object()
"""Validation context of a description that was checked before: nothing is changed."""


def _unit(v: Vector, info: ValidationInfo[Any]) -> Vector:
    if info.context is _TO_THE_BIT:
        return v
    length = float(sum(x * x for x in v) ** 0.5)
    if length < 1e-9:
        raise ValueError("a direction needs a length; give a unit vector")
    return (v[0] / length, v[1] / length, v[2] / length)


class TaxelDescription(StrictData):
    """The array of taxels on a pad: a grid on its sphere about ``rolling_axis``, or ``axis``.

    Columns run around the bone, rows along it. A taxel reads force in three axes.

    Attributes:
        rows: Number of rows.
        columns: Number of columns.
        spacing: Distance of neighbours along the sphere, m.
        noise: Standard deviation of a taxel's white noise, each axis, as a share of the normal
            force on it (-).
        threshold: Normal force (N) below which a taxel reads nothing; the least that its noise is
            a share of.
        latency: Age of an image when it arrives, s.
        rate: Images per second, Hz; 0 for one at every time step.
        dead: Row and column, from 0, of each taxel that reads nothing, as its driver knows.
    """

    rows: int = Field(ge=2, le=64, strict=True)
    columns: int = Field(ge=2, le=64, strict=True)
    spacing: float = Field(gt=0, le=0.02, strict=True)
    noise: float = Field(default=0.05, ge=0, lt=1, strict=True)
    threshold: float = Field(default=0.005, ge=0, strict=True)
    latency: float = Field(default=0.002, ge=0, le=1, strict=True)
    rate: float = Field(default=0.0, ge=0, strict=True)
    dead: tuple[tuple[StrictInt, StrictInt], ...] = ()

    @model_validator(mode="after")
    def _dead_are_taxels(self) -> Self:
        for row, column in self.dead:
            if not (0 <= row < self.rows and 0 <= column < self.columns):
                raise ValueError(
                    f"dead taxel [{row}, {column}] is outside of the array; give rows from 0 to "
                    f"{self.rows - 1} and columns from 0 to {self.columns - 1}"
                )
            if self.dead.count((row, column)) > 1:
                raise ValueError(f"dead taxel [{row}, {column}] is named twice; name it once")
        if len(self.dead) == self.rows * self.columns:
            raise ValueError("all taxels are dead; leave some alive, or leave the table out")
        return self


class PadDescription(StrictData):
    """Spherical contact pad, rigid in the body that carries ``geom``.

    Attributes:
        geom: Collision geom whose surface the pad is part of.
        center: Centre of the sphere in that body's frame, m.
        radius: Radius, m.
        axis: Direction the pad faces, in that body's frame; normalised on reading.
        half_angle_deg: Contact points lie within this cone about ``axis``, seen from the centre.
        rolling_axis: Middle of the wider cone in which the sphere is the tip's outer surface, if
            the tip is round that far: while an object is turned, contacts may roll there.
        rolling_half_angle_deg: That cone's half angle.
        taxels: Its tactile array; an array of ``sim.sensing.touch`` that covers the cone if left
            out.
    """

    geom: str
    center: Vector
    radius: float = Field(gt=0, lt=0.1)
    axis: Vector
    half_angle_deg: float = Field(gt=0, le=90)
    rolling_axis: Vector | None = None
    rolling_half_angle_deg: float | None = Field(default=None, gt=0, le=90)
    taxels: TaxelDescription | None = None

    @field_validator("axis", "rolling_axis")
    @classmethod
    def _normalise(cls, v: Vector | None, info: ValidationInfo[Any]) -> Vector | None:
        return None if v is None else _unit(v, info)

    @model_validator(mode="after")
    def _rolls_or_not(self) -> Self:
        if (self.rolling_axis is None) != (self.rolling_half_angle_deg is None):
            raise ValueError("give both rolling_axis and rolling_half_angle_deg, or neither")
        return self

    @model_serializer(mode="wrap")
    def _without_no_array(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """No line where there is no array: digests of hands without one stay as they were."""
        data: dict[str, Any] = dump(self)
        if data.get("taxels", 0) is None:
            del data["taxels"]
        return data

    @model_validator(mode="after")
    def _array_fits(self) -> Self:
        if self.taxels is None:
            return self
        longest = max(self.taxels.rows, self.taxels.columns)
        reach = (longest - 1) / 2 * self.taxels.spacing / self.radius
        if reach > MOST_REACH:
            raise ValueError(
                f"{longest} taxels {1e3 * self.taxels.spacing:g} mm apart reach "
                f"{reach * 180 / pi:.0f} degrees around a pad of radius {1e3 * self.radius:g} mm, "
                "and at most 120 are possible; give fewer or closer taxels"
            )
        return self


class TipDescription(StrictData):
    """A tip frame where the model has no site: axes of a body, origin at ``position`` in it, m."""

    body: str
    position: Vector


class FingerDescription(StrictData):
    """One finger: joints from the palm outwards, its tip frame and its pad.

    Attributes:
        name: What the finger is called.
        joints: Joint names from the palm outwards.
        tip_site: Site of the model that is the tip frame; or
        tip: The tip frame itself. It becomes a site called ``<finger>_tip``.
        pad: Where it touches.
    """

    name: str
    joints: tuple[str, ...] = Field(min_length=1)
    tip_site: str = ""
    tip: TipDescription | None = None
    pad: PadDescription

    @model_validator(mode="after")
    def _has_one_tip(self) -> Self:
        if bool(self.tip_site) == (self.tip is not None):
            raise ValueError("give either tip_site or a [fingers.tip] table with body and position")
        return self

    @property
    def tip_frame(self) -> str:
        """Name of the site that is the tip frame in the loaded model."""
        return self.tip_site or f"{self.name}_tip"


class CouplingDescription(StrictData):
    """Kinematic coupling: sum of coefficient times joint position equals ``value`` in a grasp.

    Equalities of the model itself (``<equality>`` on joints or tendons, URDF ``mimic``) need no
    description. One that is described is added to the model.

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

    @field_validator("joints")
    @classmethod
    def _act_on_each_joint(cls, v: dict[str, float]) -> dict[str, float]:
        wrong = [j for j, c in v.items() if not LEAST_COEFFICIENT <= abs(c) <= MOST_COEFFICIENT]
        if wrong:
            raise ValueError(
                f"the coefficients of {wrong} are {[v[j] for j in wrong]}, and their sizes must be "
                f"from {LEAST_COEFFICIENT:g} to {MOST_COEFFICIENT:g}; leave out a joint that the "
                "coupling does not tie"
            )
        return v


class RepairDescription(StrictData):
    """What is wrong in a model file and is put right when it is loaded.

    Attributes:
        angle: Unit of the angles in a file that does not say it, or says it wrongly.
        balance_inertia: Replace inertias that break the triangle inequality A + B >= C by their
            mean, as MuJoCo's ``balanceinertia`` does.
        inertia_from_geometry: Bodies whose inertia no body of their mass and size can have: they
            get that of a uniform solid of their mass and shape about their centre of mass.
        world_body: Name of a body made of all that is fixed to the world, which carries the
            fingers of a model without a palm; "" for none.
        drop_collision: Geoms that only look: they collide with nothing.
        drop_couplings: Tendons and equalities that are wrong, by name; equalities and actuators on
            such a tendon go with it.
        exclude: Pairs of bodies that overlap by construction and shall not collide.
    """

    angle: Literal["radian", "degree"] | None = None
    balance_inertia: bool = False
    inertia_from_geometry: tuple[str, ...] = ()
    world_body: str = ""
    drop_collision: tuple[str, ...] = ()
    drop_couplings: tuple[str, ...] = ()
    exclude: tuple[tuple[str, str], ...] = ()

    @model_serializer(mode="wrap")
    def _without_newer_lines(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """No line where there is none: digests of hands without one stay as they were."""
        newer = ("inertia_from_geometry", "world_body")
        data: dict[str, Any] = dump(self)
        return {key: value for key, value in data.items() if value or key not in newer}


class JointDefaults(StrictData):
    """Passive properties that replace or complete what the model says, for every joint of the hand.

    Attributes:
        damping: N m s/rad (N s/m); the model's own if not given.
        frictionloss: N m (N); the same.
        armature: kg m^2 (kg); the same.
        least_armature: kg m^2 (kg); joints whose own armature is less get this one.
    """

    damping: NotNegative | None = None
    frictionloss: NotNegative | None = None
    armature: NotNegative | None = None
    least_armature: NotNegative | None = None


class ActuatorDescription(StrictData):
    """Position servos that are added to a model without (enough) actuators.

    Their force is kp (ctrl - length) - damping * velocity, clipped to +- ``force_limit``. An
    actuator is called like what it drives.

    Attributes:
        joints: One servo for each of these joints; ctrl range is the joint's range; or
        tendon: One servo for this tendon of the model.
        kp: N m/rad (N/m).
        damping: N m s/rad (N s/m).
        force_limit: N m (N).
    """

    joints: tuple[str, ...] = ()
    tendon: str = ""
    kp: Positive
    damping: NotNegative = 0.0
    force_limit: Positive

    @model_validator(mode="after")
    def _drives_something(self) -> Self:
        if bool(self.joints) == bool(self.tendon):
            raise ValueError("give either joints = [...] or tendon = ...")
        return self


class HandDescription(StrictData):
    """Everything in a ``hand.toml``; angles of postures in rad (slides in m).

    Attributes:
        schema_version: Version of the format; ``schema`` in the file.
        name: What the hand is called.
        model: MJCF or URDF file: relative to this file, absolute, or ``package:PACKAGE/PATH``, a
            path inside an installed Python package.
        summary: One line.
        source: Where model and numbers come from.
        base_body: Root body of the hand, which a gantry or an arm carries.
        palm_body: Body whose pose a plan states.
        palm_normal: Direction the palm faces, in that body's frame; normalised on reading.
        wrist_joints: Joints between base and palm; they belong to no finger.
        default_fingers: Fingers of a task that names none; all if left out.
        allowed_contacts: Pairs of bodies of the hand that may touch each other.
        repair: What is wrong in the model file.
        joint_defaults: Passive properties of all joints.
        actuators: Servos that are added.
        motors: Replace all actuators and tendons by torque motors, see ``planner.bridge.edit``;
            couplings are equalities then.
        fingers: The fingers, with tips and pads.
        couplings: Linear relations between joints.
        postures: Joint values (rad, m for slides) by the name of a posture; joints that are left
            out stay neutral.
    """

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
    repair: RepairDescription = RepairDescription()
    joint_defaults: JointDefaults = JointDefaults()
    actuators: tuple[ActuatorDescription, ...] = ()
    motors: bool = False
    fingers: tuple[FingerDescription, ...] = ()
    couplings: tuple[CouplingDescription, ...] = ()
    postures: dict[str, dict[str, Finite]] = Field(default_factory=dict)

    @field_validator("palm_normal")
    @classmethod
    def _normalise(cls, v: Vector, info: ValidationInfo[Any]) -> Vector:
        return _unit(v, info)

    @model_validator(mode="after")
    def _motors_have_no_stops(self) -> Self:
        stops = [c.name for c in self.couplings if c.kind == "stop"]
        if self.motors and stops:
            raise ValueError(
                f"motors take the tendons away, so that nothing presses on the stops {stops}; "
                'write kind = "equality" for joints that are tied, or drop the coupling'
            )
        return self

    def to_json(self) -> str:
        """The description as JSON, from which ``from_json`` makes it again to the last bit."""
        return self.model_dump_json(by_alias=True)

    @classmethod
    def from_json(cls, text: str) -> Self:
        """The description that ``to_json`` wrote; directions stay as they are.

        Raises:
            pydantic.ValidationError: The text is another one.
        """
        return cls.model_validate_json(text, context=_TO_THE_BIT)
