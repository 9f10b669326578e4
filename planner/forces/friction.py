"""Friction pyramids as half-spaces, the dual of the edges of ``planner.quality.cones``.

With k sides the tangential force stays in a regular polygon. Its corners lie at the angles 2 pi j/k
from tangent1, at radius mu f_n (inscribed) or mu f_n / cos(pi/k) (circumscribed); its sides face
the angles a_j = (2 j + 1) pi/k, and with rho = mu cos(pi/k) or mu they read

    cos(a_j) f_t1 + sin(a_j) f_t2 - rho f_n <= 0.

Torsion, where mu_torsion > 0: the inscribed polyhedron is the bipyramid over the polygon with tips
+-mu_torsion f_n, the circumscribed one the prism of that height:

    inscribed       cos(a_j) f_t1 + sin(a_j) f_t2 +- rho tau_n / mu_torsion - rho f_n <= 0
    circumscribed   the polygon's sides, and  +-tau_n / mu_torsion - f_n <= 0.

Every row is a force in N. A component without friction has no rows: its column is pinned to zero.
"""

from __future__ import annotations

from typing import Literal, TypeAlias

import numpy as np

from planner.errors import ContactError
from planner.spatial import FloatArray

__all__ = ["Pyramid", "pyramid_faces"]

Pyramid: TypeAlias = Literal["inscribed", "circumscribed"]

MIN_EDGES = 3
"""Fewest sides (-): two bound no area."""


def pyramid_faces(mu: float, mu_torsion: float, edges: int, cone: Pyramid) -> FloatArray:
    """Rows D (m, 4) of D [f_n, f_t1, f_t2, tau_n] <= 0; see the module.

    Args:
        mu: Sliding friction (-).
        mu_torsion: Torsional friction (m).
        edges: Number of sides k, at least 3.
        cone: "inscribed" or "circumscribed".

    Returns:
        m = k rows, 2 k (inscribed, with torsion), k + 2 (circumscribed, with torsion), 2 (torsion
        only) or 0.

    Raises:
        ContactError: ``edges`` is below 3, or ``cone`` is unknown.
    """
    if edges < MIN_EDGES:
        raise ContactError(f"a friction pyramid of {edges} edges; give at least {MIN_EDGES}")
    if cone not in ("inscribed", "circumscribed"):
        raise ContactError(f"cone is {cone!r}; use 'inscribed' or 'circumscribed'")
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
    if cone == "circumscribed":
        return np.vstack([sides, twist])
    lift = np.zeros_like(sides)
    lift[:, 3] = reach / mu_torsion
    return np.vstack([sides + lift, sides - lift])
