"""Numbers that a hand can have: links with a possible inertia, and finite parts of possible size.

MuJoCo refuses links without inertia; URDF allows those that only join two joints, which get the
least mass and inertia that count as none. It compiles an inertia of more than a link's size allows
without a word, radii of gyration of metres in links of centimetres, and such fingers hardly move.
It compiles ``inf``, ``nan`` and links of 1e11 kg without a warning too (``check_numbers``): results
on such a model are NaN, or least squares do not end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from planner.bridge.pinocchio_model import body_name
from planner.errors import ModelError
from planner.spatial import FloatArray

LEAST_MASS = 1e-5
"""Mass of a link that has none, kg: a thousandth of a small fingertip's."""

LEAST_INERTIA = 1e-9
"""Its moment of inertia about every axis, kg m^2: a tenth of a per cent of a fingertip's, and less
than the armature that ``opposable hands --describe`` gives a joint."""


def give_least_inertias(spec: Any) -> None:
    """Complete the links of a ``mujoco.MjSpec`` whose inertia MuJoCo would refuse.

    These are links with an inertia that is not positive, and links with joints that have neither a
    mass nor a geometry. A mass that is given stays; so does a positive inertia.
    """
    for body in spec.bodies[1:]:
        stated = _principal(body) if body.explicitinertial else None
        if stated is None:
            nothing = bool(body.joints) and not body.geoms and not _carries(body)
        else:
            nothing = bool(body.joints) and body.mass < NONE
        if nothing or (stated is not None and float(stated.min()) < NONE):
            body.explicitinertial = True
            body.mass = max(float(body.mass), LEAST_MASS)
            body.fullinertia = np.full(6, np.nan)
            body.inertia = np.full(3, LEAST_INERTIA)


def with_least_inertias(spec: Any) -> tuple[str, ...]:
    """Names of the links that ``give_least_inertias`` has completed."""
    return tuple(
        body.name
        for body in spec.bodies
        if body.explicitinertial and (body.inertia == LEAST_INERTIA).all()
    )


NONE = 1e-14
"""Mass (kg) or inertia (kg m^2) that counts as none; MuJoCo's own limit is 1e-15."""


def _carries(body: Any) -> bool:
    """Whether a link without a joint is fixed to a body and has mass or a geometry."""
    fixed = [child for child in body.bodies if not child.joints]
    return any(child.mass > NONE or child.geoms or _carries(child) for child in fixed)


def _principal(body: Any) -> FloatArray:
    """Principal moments of a body's inertia; MuJoCo writes a whole one as xx yy zz xy xz yz."""
    full = np.array(body.fullinertia, dtype=np.float64)
    if not np.isfinite(full).all():
        return np.array(body.inertia, dtype=np.float64)
    xx, yy, zz, xy, xz, yz = full
    matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return np.asarray(np.linalg.eigvalsh(matrix), dtype=np.float64)


@dataclass(frozen=True, kw_only=True)
class ImpossibleInertia:
    """A body whose inertia is larger than its size and mass allow.

    Attributes:
        body: Its name.
        mass: kg.
        inertia: Its largest principal moment, kg m^2.
        size: Diagonal of the box around its link, m.
        has_solid: Whether it has a geom that collides, whose inertia can stand in.
    """

    body: str
    mass: float
    inertia: float
    size: float
    has_solid: bool

    def __str__(self) -> str:
        """The figures: "tip has 0.24 kg m2 at 0.047 kg, a radius of gyration of 2.26 m ..."."""
        radius = float(np.sqrt(self.inertia / self.mass))
        return (
            f"{self.body} has an inertia of {self.inertia:.3g} kg m2 at {self.mass:.3g} kg: a "
            f"radius of gyration of {1e3 * radius:.3g} mm in a link of {1e3 * self.size:.3g} mm"
        )


def worst_inertia(impossible: Sequence[ImpossibleInertia]) -> str:
    """The figures of the body that is furthest off, and how many more there are."""
    worst = max(impossible, key=lambda one: one.inertia / (one.mass * one.size**2))
    more = len(impossible) - 1
    return f"{worst}, which no body can have" + (f" (and {more} more such bodies)" if more else "")


def impossible_inertias(model: Any) -> tuple[ImpossibleInertia, ...]:
    """Moving bodies of a ``mujoco.MjModel`` whose inertia nothing of their mass and size has.

    Told are bodies with a radius of gyration above the diagonal of their link (twice what a body of
    that size can have, for motors that no geom shows) and an inertia above the mass times the
    squared diagonal of the link with all that it carries: below that, a filler changes little. The
    size of a link without any geom is not known.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    link_of = np.asarray(model.body_weldid)
    # lower and upper corner of what each link consists of, then of what it carries too
    low, high = np.full((model.nbody, 3), np.inf), np.full((model.nbody, 3), -np.inf)
    solid, shown = np.zeros(model.nbody, dtype=bool), np.zeros(model.nbody, dtype=bool)

    def widen(link: int, lowest: FloatArray, highest: FloatArray) -> None:
        low[link], high[link] = np.minimum(low[link], lowest), np.maximum(high[link], highest)

    for b in range(1, model.nbody):
        for link in {int(link_of[b]), int(link_of[model.body_parentid[b]])}:
            widen(link, data.xpos[b], data.xpos[b])
    for g in range(model.ngeom):
        body, radius = int(model.geom_bodyid[g]), float(model.geom_rbound[g])
        widen(int(link_of[body]), data.geom_xpos[g] - radius, data.geom_xpos[g] + radius)
        shown[link_of[body]] = True
        solid[body] |= bool(model.geom_contype[g] or model.geom_conaffinity[g])
    own = np.linalg.norm(high - low, axis=1)
    carried = np.array(model.body_subtreemass)
    for b in range(model.nbody - 1, 0, -1):  # children come after their parents
        if link_of[model.body_parentid[b]]:
            widen(int(link_of[model.body_parentid[b]]), low[link_of[b]], high[link_of[b]])
    reach = np.linalg.norm(high - low, axis=1)
    out = []
    for b in range(1, model.nbody):
        link, mass, inertia = int(link_of[b]), model.body_mass[b], model.body_inertia[b].max()
        most = max(mass * own[link] ** 2, carried[link] * reach[link] ** 2, LEAST_INERTIA)
        if link and shown[link] and mass > 0 and inertia > most:
            out.append(
                ImpossibleInertia(
                    body=body_name(model, b),
                    mass=float(mass),
                    inertia=float(inertia),
                    size=float(own[link]),
                    has_solid=bool(solid[b]),
                )
            )
    return tuple(out)


MOST_LENGTH = 10.0
"""Largest size or offset (m) of a part of a hand or its arm: files in millimetres exceed it."""

MOST_MASS = 1e3
"""Mass (kg) of a body above which it is a filler: links of the largest arms weigh some 300 kg."""

MOST_INERTIA = 1e3
"""Moment of inertia (kg m^2) and rotor inertia above which the same holds."""

MOST_DAMPING = 1e5
"""Damping (N m s/rad, N s/m) and dry friction (N m, N) above which no joint moves."""

MOST_RANGE = 1e3
"""End of a joint's range (rad, m) above which it is no range."""

MOST_COEFFICIENT = 1e6
"""Coefficient of a joint in a tendon or an equality (-, m/rad) above which it is a filler."""

MOST_GAIN = 1e9
"""Gain (N m/rad, N/m) of an actuator above which no time step resolves it."""


@dataclass(frozen=True)
class _Quantity:
    """One check: arrays of ``mujoco.MjModel`` by the kind of part that they belong to."""

    kind: str
    field: str
    what: str
    most: float
    unit: str
    remedy: str = "give finite numbers in SI units"


_MILLIMETRES = "give finite numbers in metres (a scale of 0.001 where the file is in millimetres)"

_QUANTITIES = (
    _Quantity("body", "body_pos", "position", MOST_LENGTH, "m", _MILLIMETRES),
    _Quantity("body", "body_quat", "orientation", 1.0 + 1e-6, "-"),
    _Quantity("body", "body_mass", "mass", MOST_MASS, "kg", "give the link its own mass"),
    _Quantity("body", "body_ipos", "centre of mass", MOST_LENGTH, "m", _MILLIMETRES),
    _Quantity("body", "body_inertia", "inertia", MOST_INERTIA, "kg m^2"),
    _Quantity("body", "body_iquat", "inertia's axes", 1.0 + 1e-6, "-"),
    _Quantity("geom", "geom_size", "size", MOST_LENGTH, "m", _MILLIMETRES),
    _Quantity("geom", "geom_pos", "position", MOST_LENGTH, "m", _MILLIMETRES),
    _Quantity("geom", "geom_quat", "orientation", 1.0 + 1e-6, "-"),
    _Quantity("site", "site_pos", "position", MOST_LENGTH, "m", _MILLIMETRES),
    _Quantity("joint", "jnt_axis", "axis", 1.0 + 1e-6, "-", "give a direction with a length"),
    _Quantity("joint", "jnt_pos", "position", MOST_LENGTH, "m", _MILLIMETRES),
    _Quantity("joint", "jnt_range", "range", MOST_RANGE, "rad or m"),
    _Quantity("joint", "jnt_stiffness", "stiffness", MOST_GAIN, "N m/rad"),
    _Quantity("joint", "qpos0", "reference", MOST_RANGE, "rad or m"),
    _Quantity("joint", "qpos_spring", "spring's rest", MOST_RANGE, "rad or m"),
    _Quantity("joint", "dof_armature", "armature", MOST_INERTIA, "kg m^2"),
    _Quantity("joint", "dof_damping", "damping", MOST_DAMPING, "N m s/rad"),
    _Quantity("joint", "dof_frictionloss", "frictionloss", MOST_DAMPING, "N m"),
    _Quantity("tendon", "tendon_range", "range", MOST_GAIN, "m"),
    _Quantity("tendon", "tendon_stiffness", "stiffness", MOST_GAIN, "N/m"),
    _Quantity("actuator", "actuator_gear", "gear", MOST_GAIN, "-"),
    _Quantity("actuator", "actuator_gainprm", "gain", MOST_GAIN, "N m/rad"),
    _Quantity("actuator", "actuator_biasprm", "bias", MOST_GAIN, "N m/rad"),
)


def check_numbers(model: Any, what: str) -> None:
    """See that a compiled ``mujoco.MjModel`` of hinges and slides holds numbers of a hand.

    Args:
        model: The hand, or the hand on its arm, alone.
        what: What it is called in messages.

    Raises:
        ModelError: A number is NaN, infinite, or larger than any hand's; the message names the
            part, what is wrong with it and what is allowed.
    """
    for quantity in _QUANTITIES:
        values = np.asarray(getattr(model, quantity.field), dtype=np.float64)
        if not len(values):
            continue
        rows = values.reshape(len(values), -1)
        wrong = ~(np.abs(rows) <= quantity.most)  # NaN too
        if not wrong.any():
            continue
        part = int(np.argmax(wrong.any(axis=1)))
        owner = _joint_of(model, quantity.field, part) if quantity.kind == "joint" else part
        name = getattr(model, quantity.kind)(owner).name
        worst = rows[part][wrong[part]][0]
        raise ModelError(
            f"{what}: the {quantity.what} of {quantity.kind} {name!r} holds {worst:g}; allowed are "
            f"numbers up to {quantity.most:g} {quantity.unit}: {quantity.remedy}"
        )
    _check_coefficients(model, what)
    used = model.mesh_vert[: model.nmeshvert]
    if not (np.abs(used) <= MOST_LENGTH).all():
        starts = np.asarray(model.mesh_vertadr)
        row = int(np.argmax(~(np.abs(used) <= MOST_LENGTH).all(axis=1)))
        mesh = model.mesh(int(np.searchsorted(starts, row, side="right")) - 1).name
        raise ModelError(
            f"{what}: mesh {mesh!r} has a vertex at {np.round(used[row], 3).tolist()} m; allowed "
            f"are numbers up to {MOST_LENGTH:g} m: {_MILLIMETRES}"
        )


def _check_coefficients(model: Any, what: str) -> None:
    """See that tendons and equalities of joints are made of finite coefficients."""
    parts = [
        (f"tendon {model.tendon(t).name!r}", model.wrap_prm[start : start + count])
        for t, (start, count) in enumerate(zip(model.tendon_adr, model.tendon_num, strict=True))
    ]
    parts += [
        (f"equality {model.equality(i).name!r}", model.eq_data[i, :POLYNOMIAL])
        for i in range(model.neq)
    ]
    for name, values in parts:
        wrong = ~(np.abs(values) <= MOST_COEFFICIENT)
        if wrong.any():
            raise ModelError(
                f"{what}: {name} has the coefficient {values[wrong][0]:g}; allowed are numbers up "
                f"to {MOST_COEFFICIENT:g}: correct coef, polycoef or, in a URDF, the multiplier "
                "and offset of <mimic>"
            )
    for i, (low, high) in enumerate(model.actuator_forcerange):
        if np.isnan([low, high, *model.actuator_ctrlrange[i]]).any():
            raise ModelError(
                f"{what}: actuator {model.actuator(i).name!r} has NaN in its forcerange or "
                "ctrlrange; give two numbers, the smaller one first"
            )


POLYNOMIAL = 5
"""Numbers of an equality's data that are the coefficients of its polynomial."""


def check_sizes(spec: Any, what: str) -> None:
    """See that no part of a ``mujoco.MjSpec`` is so large that MuJoCo cannot even compile it.

    With a geom of 1e300 m it gives an inertia of no number, a warning, or a refusal that names
    neither the geom nor its size. A scene around the hand may be large; NaN stands for what a file
    does not say. Both are left to ``check_numbers``.

    Raises:
        ModelError: A size, a position, a mass or an inertia is above ``MOST_OF_ANYTHING``.
    """
    fields = {"geom": ("size", "pos", "mass"), "body": ("pos", "mass", "inertia")}
    for kind, parts in (("geom", spec.geoms), ("body", spec.bodies)):
        for part in parts:
            for field in fields[kind]:
                value = np.abs(np.atleast_1d(np.asarray(getattr(part, field), dtype=np.float64)))
                if (value > MOST_OF_ANYTHING).any():
                    of = {"pos": "position"}.get(field, field)
                    raise ModelError(
                        f"{what}: the {of} of {kind} {part.name!r} holds {np.nanmax(value):g}; "
                        "give finite numbers in metres and kilograms, as a hand has them"
                    )


MOST_OF_ANYTHING = 1e6
"""Length (m), mass (kg) or inertia (kg m^2) above which nothing in a scene is."""


def check_repeated_names(spec: Any, what: str) -> None:
    """See that no two parts of a kind in a ``mujoco.MjSpec`` share a name.

    A URDF may repeat one until MuJoCo compiles it; taking such a file apart fails without saying
    where.

    Raises:
        ModelError: Two bodies, joints, geoms, sites, tendons or actuators share a name.
    """
    kinds = {
        "body": spec.bodies,
        "joint": spec.joints,
        "geom": spec.geoms,
        "site": spec.sites,
        "tendon": spec.tendons,
        "actuator": spec.actuators,
        "equality": spec.equalities,
    }
    for kind, parts in kinds.items():
        seen: set[str] = set()
        for part in parts:
            if part.name and part.name in seen:
                raise ModelError(
                    f"{what}: two parts of kind {kind} are called {part.name!r} (repeated name); "
                    "rename one, and what refers to it"
                )
            seen.add(part.name)


def _joint_of(model: Any, field: str, row: int) -> int:
    """Number of the joint that row ``row`` of an array belongs to."""
    if field.startswith("dof_"):
        return int(model.dof_jntid[row])
    if field.startswith("qpos"):
        return int(np.searchsorted(np.asarray(model.jnt_qposadr), row, side="right")) - 1
    return row
