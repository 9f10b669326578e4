"""Friction pyramids as half-spaces, the dual of the edges of ``planner.quality.cones``.

With k sides the tangential force stays in a regular polygon. Its corners lie at the angles 2 pi j/k
from tangent1, at radius mu f_n (inscribed) or mu f_n / cos(pi/k) (circumscribed); its sides face
the angles a_j = (2 j + 1) pi/k, and with rho = mu cos(pi/k) or mu they read

    cos(a_j) f_t1 + sin(a_j) f_t2 - rho f_n <= 0.

Torsion, where mu_torsion > 0: the inscribed polyhedron is the bipyramid over the polygon with tips
+-mu_torsion f_n, the circumscribed one the prism of that height:

    inscribed       cos(a_j) f_t1 + sin(a_j) f_t2 +- rho tau_n / mu_torsion - rho f_n <= 0
    circumscribed   the polygon's sides, and  +-tau_n / mu_torsion - f_n <= 0.

That is the ellipsoidal limit surface, where sliding takes from torsion (Howe, Cutkosky, "Practical
force-motion models for sliding manipulation", 1996). Where the two limits are "independent",
|tau_n| <= mu_torsion f_n stands beside the polygon, which is the prism, in either case.

The round cones are [f_n; f_t1/mu; f_t2/mu; tau_n/mu_torsion] with f_n >= |the others|.

Every row is a force in N. A component without friction has no rows: its column is pinned to zero.
"""

from __future__ import annotations

from typing import Literal, TypeAlias

import numpy as np

from planner.arrays import checked_count
from planner.contacts import MIN_EDGES, MOST_EDGES
from planner.errors import ContactError
from planner.spatial import FloatArray

__all__ = ["Cone", "LimitSurface", "Pyramid", "pyramid_faces", "round_cone"]

Pyramid: TypeAlias = Literal["inscribed", "circumscribed"]
Cone: TypeAlias = Literal["inscribed", "circumscribed", "round"]
LimitSurface: TypeAlias = Literal["ellipsoid", "independent"]


def pyramid_faces(
    mu: float,
    mu_torsion: float,
    edges: int,
    cone: Pyramid,
    limit_surface: LimitSurface = "ellipsoid",
) -> FloatArray:
    """Rows D (m, 4) of D [f_n, f_t1, f_t2, tau_n] <= 0; see the module.

    Args:
        mu: Sliding friction (-).
        mu_torsion: Torsional friction (m).
        edges: Number of sides k, at least 3.
        cone: "inscribed" or "circumscribed".
        limit_surface: "ellipsoid" or "independent".

    Returns:
        m = k rows, 2 k (inscribed ellipsoid), k + 2 (otherwise with torsion), 2 (torsion only) or
        0.

    Raises:
        ContactError: ``edges`` is not 3 to 512, or ``cone`` or ``limit_surface`` is unknown.
    """
    checked_count(
        "the number of sides per friction pyramid", edges, least=MIN_EDGES, most=MOST_EDGES
    )
    if cone not in ("inscribed", "circumscribed"):
        raise ContactError(f"cone is {cone!r}; use 'inscribed' or 'circumscribed'")
    if limit_surface not in ("ellipsoid", "independent"):
        raise ContactError(f"limit_surface is {limit_surface!r}; use 'ellipsoid' or 'independent'")
    angle = (2 * np.arange(edges) + 1) * np.pi / edges
    reach = mu * np.cos(np.pi / edges) if cone == "inscribed" else mu
    sides = np.stack(
        [np.full(edges, -reach), np.cos(angle), np.sin(angle), np.zeros(edges)], axis=1
    )
    if mu_torsion == 0.0:
        return sides if mu > 0.0 else np.zeros((0, 4))
    twist = np.array([[-1, 0, 0, 1 / mu_torsion], [-1, 0, 0, -1 / mu_torsion]])
    if mu == 0.0:
        return twist
    if cone == "circumscribed" or limit_surface == "independent":
        return np.vstack([sides, twist])
    lift = np.zeros_like(sides)
    lift[:, 3] = reach / mu_torsion
    return np.vstack([sides + lift, sides - lift])


def round_cone(mu: float, mu_torsion: float, limit_surface: LimitSurface) -> FloatArray:
    """Rows (m, 4) that turn [f_n, f_t1, f_t2, tau_n] into [head, tail ...] of a second-order cone.

    Args:
        mu: Sliding friction (-).
        mu_torsion: Torsional friction (m).
        limit_surface: "independent" leaves the torsion to rows of its own where there is sliding.

    Returns:
        m = 4, 3 (sliding alone), 2 (torsion alone) or 0.
    """
    rows = [[1.0, 0.0, 0.0, 0.0]]
    if mu > 0.0:
        rows += [[0.0, 1 / mu, 0.0, 0.0], [0.0, 0.0, 1 / mu, 0.0]]
    if mu_torsion > 0.0 and (limit_surface == "ellipsoid" or mu == 0.0):
        rows.append([0.0, 0.0, 0.0, 1 / mu_torsion])
    return np.array(rows) if len(rows) > 1 else np.zeros((0, 4))
