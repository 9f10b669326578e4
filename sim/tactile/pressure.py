"""How pressure and shear are spread over a pad: the one place, and its sources.

MuJoCo's contacts are points with a force; a soft pad spreads it. Of each contact

    radius      a = (3 f R / 4 E)^(1/3): Hertz, a sphere of radius R on a flat body, with the
                contact modulus E = 1.3 MPa of soft rubber
    pressure    a Gaussian of Hertz's second moment, sigma^2 = a^2 / 5 on each axis, integrated
                over the cell of each taxel: what lies on the array is conserved
    shear       Cattaneo and Mindlin: a share (used) of the friction cone in use sticks within
                c = a (1 - used)^(1/3) and slips outside, so that the shear is that of full
                slip with radius a less (1 - used) of that with radius c, over used
    torsion     a shear that grows with the distance from the middle

K. L. Johnson, Contact Mechanics, Cambridge 1985: 3.4 and 4.2 (Hertz), 7.2 (Cattaneo, Mindlin).
The object counts as flat and rigid: one that is round has a smaller patch. The shear at full slip
is mu times the pressure everywhere, so its spread tells how much of the friction is in use before
anything slides. Torsion and force use the cone together, as MuJoCo's contacts do.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import erf

from planner.spatial import FloatArray

CONTACT_MODULUS = 1.3e6
"""Contact modulus E / (1 - nu^2) of pads, Pa: the soft rubber of ``sim.physics.options``."""

LEAST_DEVIATION = 1e-4
"""Standard deviation (m) of the pressure of the lightest touch: pads are no sharper than 0.1 mm."""

LEAST_USED = 0.02
"""Share of friction (-) below which the shear has the spread of this share: the formula is 0/0."""

LEAST_SPREAD = 1e-30
"""Share (-) that is as good as none: its logarithm is finite."""

_ROOT, _DENSITY = math.sqrt(0.5), 1.0 / math.sqrt(2.0 * math.pi)


def contact_deviation(force: float, radius: float) -> float:
    """Standard deviation (m), each axis, of the pressure of a normal force.

    Args:
        force: N, >= 0.
        radius: Of the pad, m.
    """
    patch = math.cbrt(0.75 * force * radius / CONTACT_MODULUS)
    return max(patch / math.sqrt(5.0), LEAST_DEVIATION)


def spread(
    edges: FloatArray, middle: float | FloatArray, deviation: float | FloatArray
) -> FloatArray:
    """Shares (..., n) of a Gaussian within n neighbouring cells.

    Args:
        edges: Their borders, (..., n + 1), m.
        middle: Of the Gaussian, m; a number, or one that broadcasts.
        deviation: Its standard deviation, m; likewise.
    """
    below = erf((_ROOT / deviation) * (edges - middle))
    return np.asarray(0.5 * (below[..., 1:] - below[..., :-1]))


def spread_with_slopes(
    edges: FloatArray, middle: FloatArray, deviation: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Logarithms of the shares (..., n) that ``spread`` gives, and how they grow (..., n), (-).

    The second is with the middle, per deviation of the Gaussian; the third with the logarithm of
    the deviation. Shares are at least ``LEAST_SPREAD``.
    """
    z = (edges - middle) / deviation
    below = 0.5 * erf(_ROOT * z)
    density = _DENSITY * np.exp(-0.5 * z * z)
    moment = z * density
    shares = np.maximum(below[..., 1:] - below[..., :-1], LEAST_SPREAD)
    slopes = (density[..., :-1] - density[..., 1:]) / shares
    widths = (moment[..., :-1] - moment[..., 1:]) / shares
    return np.log(shares), slopes, widths


def spread_of_shear(pressure: FloatArray, stuck: FloatArray, used: float) -> FloatArray:
    """Shares of the shear force per taxel.

    Args:
        pressure: Shares of the normal force.
        stuck: The same with the deviation of the stick region.
        used: Share of the friction cone in use (-).
    """
    used = min(1.0, max(used, LEAST_USED))
    return np.asarray((pressure - (1.0 - used) * stuck) / used)


def stick_ratio(used: float) -> float:
    """Radius of the stick region over that of the patch (-), at a share of friction in use."""
    return math.cbrt(1.0 - min(1.0, max(used, LEAST_USED)))
