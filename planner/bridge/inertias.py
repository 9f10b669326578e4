"""Links of a URDF without mass, or with an inertia that is none, which MuJoCo refuses.

URDF allows links that only join two joints. They get the least mass and inertia that count as none.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from planner.spatial import FloatArray

__all__ = ["LEAST_INERTIA", "LEAST_MASS", "give_least_inertias", "with_least_inertias"]

LEAST_MASS = 1e-5
"""Mass of a link that has none, kg: a thousandth of a small fingertip's."""

LEAST_INERTIA = 1e-9
"""Its moment of inertia about every axis, kg m^2: a tenth of a per cent of a fingertip's, and less
than the armature that ``opposable describe`` gives a joint."""


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
