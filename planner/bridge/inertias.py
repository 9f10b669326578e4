"""Links with an inertia that no link can have: none at all, or more than their size allows.

MuJoCo refuses the first; URDF allows links that only join two joints, which get the least mass and
inertia that count as none. It compiles the second without a word, radii of gyration of metres in
links of centimetres, and such fingers hardly move.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from planner.bridge.pinocchio_model import body_name
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
