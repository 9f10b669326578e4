"""Stances: closure by the other fingers while one swings, which a stroke needs to be repeated.

A finger that swings to its next contact leaves n - 1 in stance. They close the grasp if an internal
force strictly inside their cones exists. Its forces g_j are unknowns, with the terms of a grasp:

    sum g_j = 0,  sum x_j x g_j / length = 0,  mean normal force = 1,
    (share mu g_n)^2 - |g_t|^2 >= 0,           g_n - PRESS_MIN >= 0.

x_j is the contact of finger j at a knot of its own, in the hand's frame: fingers that have swung
stand where the stroke begins, the others where it ends.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from planner.motion.terms import SWING
from planner.shapes.surface import CODE_DIM, SIZE_DIM, Surface
from planner.spatial import FloatArray, IntArray
from planner.synthesis.terms.forces import PRESS_MIN
from planner.synthesis.unknowns import mrp_matrix
from planner.tolerances import SWING_SHARE


@dataclass(frozen=True, kw_only=True)
class Stance:
    """Which contacts hold the object while one finger swings.

    Attributes:
        swinging: Number of the finger that swings.
        knots: The knot at which each of all fingers stands, -1 for the last.
    """

    swinging: int
    knots: tuple[int, ...]


class StanceRows:
    """Weighted residuals of one stance, by its contacts, their forces and path parameters.

    Everything is in the object's frame where its path begins.
    """

    def __init__(self, surface: Surface, n_contacts: int) -> None:
        """Differentiate.

        Args:
            surface: Form of the object's shape; one that needs no distance field.
            n_contacts: Number of contacts in stance.
        """
        m = n_contacts
        points, forces = ca.SX.sym("x", 3 * m), ca.SX.sym("g", 3 * m)
        parameters, codes = ca.SX.sym("c", m), ca.SX.sym("codes", CODE_DIM * m)
        axis, angle, shift = ca.SX.sym("a", 3), ca.SX.sym("angle"), ca.SX.sym("d", 3)
        size, mu, length = ca.SX.sym("size", SIZE_DIM), ca.SX.sym("mu"), ca.SX.sym("length")
        total, torque, level = ca.SX.zeros(3), ca.SX.zeros(3), ca.SX.zeros(1)
        cones: list[Any] = []
        presses: list[Any] = []
        for j in range(m):
            p, g = points[3 * j : 3 * j + 3], forces[3 * j : 3 * j + 3]
            turn = mrp_matrix(axis * ca.tan(parameters[j] * angle / 4))
            code = codes[CODE_DIM * j : CODE_DIM * (j + 1)]
            pressed = -ca.dot(g, turn @ surface.outward_normal(size, code, p))
            total, torque = total + g, torque + ca.cross(turn @ p + parameters[j] * shift, g)
            level += pressed / m
            cones.append((SWING_SHARE * mu * pressed) ** 2 - ca.dot(g, g) + pressed**2)
            presses.append(pressed - PRESS_MIN)
        balance, mean, cone, press = (term.weight for term in SWING)
        rows = ca.densify(
            ca.vertcat(
                balance * total,
                balance * torque / length,
                mean * (level - 1),
                cone * ca.vertcat(*cones),
                press * ca.vertcat(*presses),
            )
        )
        jacobian = ca.densify(ca.jacobian(rows, ca.vertcat(points, forces, parameters)))
        inputs = [points, forces, parameters, axis, angle, shift, codes, size, mu, length]
        self._call = ca.Function("stance", inputs, [rows, jacobian])
        self._both: NDArray[np.bool_] = np.arange(rows.numel()) < N_EQUAL

    def __call__(
        self,
        points: FloatArray,
        forces: FloatArray,
        parameters: FloatArray,
        path: tuple[FloatArray, float, FloatArray],
        p: dict[str, FloatArray],
        codes: FloatArray,
    ) -> tuple[FloatArray, FloatArray, IntArray]:
        """Active rows (k,), their Jacobian (k, 7 m) by points, forces and parameters, and numbers.

        Args:
            points: Contact points (m, 3), each in the object's frame at its knot.
            forces: (m, 3), in units of the mean normal force.
            parameters: Path parameter of the object at the knot of each contact (m,), 0 to 1.
            path: Axis (3,), angle (rad) and shift (3,), m, of the whole path.
            p: Parameters of a grasp, by name.
            codes: Codes of the patches (m, k).
        """
        grasp = (codes.ravel(), p["size"], p["mu"], p["length"])
        found = self._call(points.ravel(), forces.ravel(), parameters, *path, *grasp)
        values, slopes = found[0].full().ravel(), found[1].full()
        counts = self._both | (values < 0.0)
        return values[counts], slopes[counts], np.flatnonzero(counts)


N_EQUAL = 7
"""Number of equality rows: force (3), torque (3) and the mean normal force."""
