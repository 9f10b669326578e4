"""What counts as touching, penetrating, closed and within friction: one page for every verdict.

Planning, verification, motions, gaits and the gate of a regrasp in simulation take these numbers
from here, so that "closed" and "touches" mean the same everywhere. Lengths in m, angles in rad,
shares and margins without unit.
"""

from __future__ import annotations

import math

__all__ = [
    "ANGLE_TOL",
    "CLOSURE_EDGES",
    "CLOSURE_MARGIN",
    "DEFAULT_MU",
    "EDGE_RADIUS",
    "EDGE_SPREAD",
    "FLAT_ANGLE_TOL",
    "FRICTION_SHARE",
    "JOINT_TOL",
    "PENETRATION_TOL",
    "SWING_SHARE",
    "SWING_VERDICT_SHARE",
    "SYNTHESIS_SHARE",
    "TOUCH_TOL",
]

TOUCH_TOL = 5e-4
"""A pad touches when its signed distance to the true surface is at most this (m), either sign."""

PENETRATION_TOL = 5e-6
"""Depth (m) from which two geometries that must not touch count as penetrating: coal is that
accurate in penetration (``planner.shapes.convex_pairs``)."""

ANGLE_TOL = 1e-3
"""How far (rad) a contact may lie outside the pad's cone: the solver's accuracy."""

FLAT_ANGLE_TOL = 0.15
"""The same where the pad's sphere approximates a box or a hull: its normals differ by that much."""

EDGE_RADIUS = 0.002
"""How far (m) around a contact normals are looked at: what a pad creeps and rolls in a grasp. On an
edge a pad that creeps by a millimetre meets another normal."""

EDGE_SPREAD = math.radians(25.0)
"""Largest dispersion of normals there (rad); it is 45 degrees on a right-angled edge."""

JOINT_TOL = 1e-6
"""How far (rad) couplings and joint limits may be violated: the solver's accuracy."""

CLOSURE_EDGES = 8
"""Sides of the inscribed friction pyramid with which closure is decided."""

CLOSURE_MARGIN = 0.05
"""Least normalised min-weight (-) at every knot of a motion, and of the contacts that hold while a
finger is away: contacts of a moving grasp are off by more than those of one that rests."""

DEFAULT_MU = 0.5
"""Sliding friction that planning assumes (-). A trial has 0.6 (``sim.scene.physics``), so that a
plan has a margin. The shares below are of the friction of a task."""

SYNTHESIS_SHARE = 0.7
"""Share of the friction coefficient (-) that the internal forces of synthesis may use."""

FRICTION_SHARE = 0.8
"""Share of the friction coefficient (-) that planned forces may use, so that they keep off the
cone's edge when contacts turn out a little different."""

SWING_SHARE = 0.85
"""Share of the friction coefficient (-) that the internal force may use in the programme of a
motion while a finger is away: with that of synthesis the others would have to reach much further
around the object."""

SWING_VERDICT_SHARE = 0.9
"""Share of the friction coefficient (-) that planned forces may use while a finger is away: every
degree around the object counts there."""
