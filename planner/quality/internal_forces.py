"""``plainly_closed``: force closure without a linear programme, where internal forces prove it.

Forces f with G f = 0, each strictly inside its friction cone, and a grasp map G of rank 6 are force
closure: for any wrench w some g has G g = -w, and f + t g is inside the cones for a small t > 0, so
(f + t g) / t balances w (Murray, Li, Sastry 1994, chapter 5). Here the cones are pyramids with
primitive wrenches W (6, m), and f is given by weights a > 0 with W a = 0. Whatever they are, the
normalised min-weight of ``planner.quality.closure`` is at least m min(a) / sum(a).

Weights are sought by a few steps that keep them positive: of the changes d with W (a + d) = 0 the
one that is least in proportion, sum (d / a)^2. Most grasps that are closed need one to four. Where
they do not suffice nothing is said, and the programme decides.
"""

from __future__ import annotations

import numpy as np

from planner.contacts import ContactSet
from planner.quality.cones import primitive_wrenches
from planner.spatial import FloatArray

PLAIN = 1e-4
"""Normalised min-weight that weights must prove (-): a thousand times what counts as positive."""

STEPS = 12
"""Most steps (-)."""

BACK = 0.9
"""Share of the way to the first weight of zero that a step takes (-)."""

SOUND = 1e-10
"""Least over largest eigenvalue of W W^T that counts as rank 6 (-): a hundred times the square of
``planner.quality.closure.RANK_TOL``. From below it is taken as det (5 / trace)^5 / trace."""

BALANCED = 1e-12
"""Largest entry of W a, over the sum of weights and the largest wrench (-), that is rounding."""


def plainly_closed(contacts: ContactSet, edges: int = 8) -> bool:
    """Whether weights are found that prove closure; False says nothing, ask ``force_closure``.

    Args:
        contacts: n contacts.
        edges: Edges per inscribed cone, at least 3.

    Raises:
        ContactError: ``edges`` is below 3.
    """
    return positive_weights(np.ascontiguousarray(primitive_wrenches(contacts, edges).T))


def positive_weights(w: FloatArray) -> bool:
    """Whether weights a with w^T a = 0 are found that are all positive, and w has rank 6.

    Args:
        w: Wrenches (m, 6).
    """
    force, torque = (w[:, :3] ** 2).sum(), (w[:, 3:] ** 2).sum()
    if not (force > 0.0 and torque > 0.0 and np.isfinite(force + torque)):
        return False
    p = w / np.sqrt(np.repeat([force, torque], 3) / len(w))
    largest, a = np.abs(p).max(), np.ones(len(w))
    for step in range(STEPS):
        weighted = p * (a * a)[:, None]
        scatter = p.T @ weighted
        if step == 0:
            trace = np.trace(scatter)
            if not np.linalg.det(scatter) * (5.0 / trace) ** 5 > SOUND * trace:
                return False
        if not np.linalg.det(scatter) > 0.0:
            return False
        change = -weighted @ np.linalg.solve(scatter, a @ p)
        there = a + change
        left = np.abs(there @ p).max()
        if len(w) * there.min() > PLAIN * there.sum() and left <= BALANCED * largest * there.sum():
            return True
        share = (-change / a).max()
        a = a + min(1.0, BACK / share) * change if share > 0.0 else there
        a /= a.mean()
    return False
