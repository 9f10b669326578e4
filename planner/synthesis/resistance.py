"""Resistance of a grasp in given directions of wrench, with derivatives by contact points.

The formula is ``support`` of ``planner.synthesis.symbols``, here in numbers for many
directions at once; only the contact that resists most in a direction has derivatives:

    h = a + mu |t|,   g = u_f + u_t x p / length,   a = -g . n,   t = g + a n,
    dh = w . dg + z . dn,   w = mu t/|t| - c n,   z = mu a t/|t| - c g,   c = 1 + mu t . n/|t|,
    dg = u_t x dp / length,   dn = N dp,

with outward normal n and its change N with the point. Off the surface, where least squares pass, n
need not be a unit vector; on it c is 1.
"""

from __future__ import annotations

import numpy as np

from planner.spatial import FloatArray, IntArray
from planner.synthesis.symbols import TINY


def missing_resistance(
    directions: FloatArray,
    points: FloatArray,
    outward: FloatArray,
    normal_jacobians: FloatArray,
    *,
    mu: float,
    length: float,
    target: float,
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Resistance less its target, (k,), where that is negative, derivatives (k, 3 n), directions.

    The last are the numbers (k,) of the directions that fall short.

    Args:
        directions: Directions of wrench u (m, 6), torques over ``length``; targets scale with them.
        points: Contact points (n, 3), m.
        outward: Normals (n, 3).
        normal_jacobians: Derivative of each normal by its point (n, 3, 3), 1/m.
        mu: Friction (-).
        length: Characteristic length, m.
        target: Resistance (normal forces sum to 1) to reach per unit of ``directions``.
    """
    # contacts come first, so that every product below is a product of matrices
    g = directions[:, :3] + directions[:, 3:] @ _turning(points / length)  # (n, m, 3)
    pressed = -(g @ outward[:, :, None])[:, :, 0]  # (n, m)
    t = g + pressed[:, :, None] * outward[:, None, :]
    across = np.sqrt(np.einsum("nmi,nmi->nm", t, t) + TINY)
    resisted = pressed + mu * across
    best = (resisted >= resisted.max(axis=0) - TIE).argmax(axis=0)
    every = np.arange(len(directions))
    values = resisted[best, every] - target * np.sqrt(np.einsum("mi,mi->m", directions, directions))
    short = np.flatnonzero(values < 0.0)
    i = best[short]
    n, g, pressed = outward[i], g[i, short], pressed[i, short][:, None]
    along = (mu / across[i, short])[:, None] * t[i, short]
    c = 1.0 + np.einsum("ki,ki->k", along, n)[:, None]
    u, w, z = directions[short, 3:], along - c * n, pressed * along - c * g
    slope = (w[:, NEXT] * u[:, AFTER] - w[:, AFTER] * u[:, NEXT]) / length
    slope += (z[:, None, :] @ normal_jacobians[i])[:, 0]
    rows = np.zeros((len(short), *points.shape))
    rows[np.arange(len(short)), i] = slope
    return values[short], rows.reshape(len(short), points.size), short


def least_resisted(
    points: FloatArray, outward: FloatArray, *, mu: float, length: float
) -> FloatArray:
    """Least resistance of sets of contacts over a sample of directions, (k,): epsilon or more.

    Args:
        points: (k, n, 3), m.
        outward: Unit normals (k, n, 3).
        mu: Friction (-).
        length: Characteristic length, m.
    """
    flat, n = points.reshape(-1, 3), outward.reshape(-1, 3)
    g = SAMPLE[:, :3] + SAMPLE[:, 3:] @ _turning(flat / length)  # (k n, m, 3)
    pressed = -(g @ n[:, :, None])[:, :, 0]
    across = np.einsum("nmi,nmi->nm", g, g) - pressed * pressed
    resisted = pressed + mu * np.sqrt(np.maximum(across, 0.0))
    least: FloatArray = resisted.reshape(*points.shape[:2], -1).max(axis=1).min(axis=1)
    return least


def _sample(count: int) -> FloatArray:
    """Directions of wrench (count, 6), spread at random, always the same."""
    found = np.random.default_rng(0).normal(size=(count, 6))
    found /= np.linalg.norm(found, axis=1, keepdims=True)
    return found


SAMPLE = _sample(128)
"""Directions in which starts are compared: enough for a ranking, too few for epsilon."""


def _turning(p: FloatArray) -> FloatArray:
    """Matrices (n, 3, 3) from which u @ matrix is u x p."""
    out = np.zeros((len(p), 3, 3))
    out[:, NEXT, AFTER] = -p[:, AXIS]
    out[:, AFTER, NEXT] = p[:, AXIS]
    return out


TIE = 1e-9
"""Contacts whose resistance differs by less than this (-) resist alike, and the first counts: faces
of a box give exact ties, which rounding must not decide."""

AXIS, NEXT, AFTER = np.arange(3), np.array([1, 2, 0]), np.array([2, 0, 1])
