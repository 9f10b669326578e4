"""Layout of the column x of unknowns of a grasp, and modified Rodrigues parameters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from planner.spatial import SE3, FloatArray, skew


@dataclass(frozen=True, kw_only=True)
class Unknowns:
    """Layout of x = [turn (3), shift (3), q, contact points (3 each), forces (3 each)].

    Attributes:
        n_joints: Number of joints.
        n_contacts: Number of fingers that take part.
    """

    n_joints: int
    n_contacts: int

    @property
    def size(self) -> int:
        """Length of x."""
        return 6 + self.n_joints + 6 * self.n_contacts

    def pack(
        self,
        turn: FloatArray,
        shift: FloatArray,
        q: FloatArray,
        points: FloatArray,
        forces: FloatArray,
    ) -> FloatArray:
        """One column (size,) of its parts; points and forces are (n_contacts, 3)."""
        return np.concatenate([turn, shift, q, np.ravel(points), np.ravel(forces)])

    def symbols(self) -> tuple[Any, Any, Any, list[Any], list[Any]]:
        """CasADi symbols of turn, shift, q, and of every contact's point and force."""
        n = range(self.n_contacts)
        return (
            ca.SX.sym("s", 3),
            ca.SX.sym("t", 3),
            ca.SX.sym("q", self.n_joints),
            [ca.SX.sym(f"p{i}", 3) for i in n],
            [ca.SX.sym(f"f{i}", 3) for i in n],
        )

    def pose(self, x: FloatArray, reference: SE3) -> SE3:
        """Pose of turn and shift of x; the turn is relative to the reference's orientation."""
        return SE3(reference.rotation @ mrp_numeric(x[:3]), x[3:6])

    def q(self, x: FloatArray) -> FloatArray:
        """Joints (n_joints,)."""
        return x[6 : 6 + self.n_joints]

    def points(self, x: FloatArray) -> FloatArray:
        """Contact points (n_contacts, 3)."""
        return x[self.point_columns].reshape(-1, 3)

    def forces(self, x: FloatArray) -> FloatArray:
        """Forces (n_contacts, 3)."""
        return x[self.point_columns.stop :].reshape(-1, 3)

    @property
    def point_columns(self) -> slice:
        """Columns of the contact points."""
        return slice(6 + self.n_joints, 6 + self.n_joints + 3 * self.n_contacts)


def mrp_matrix(s: Any) -> Any:
    """Rotation matrix of modified Rodrigues parameters: no singularity below a full turn."""
    k = ca.skew(s)
    n = ca.dot(s, s)
    return ca.SX.eye(3) + (8 * (k @ k) + 4 * (1 - n) * k) / (1 + n) ** 2


def mrp_numeric(s: FloatArray) -> FloatArray:
    """The same (3, 3) of numbers (3,)."""
    k, n = skew(s), float(s @ s)
    return np.eye(3) + (8 * (k @ k) + 4 * (1 - n) * k) / (1 + n) ** 2


def mrp_rates(s: FloatArray) -> FloatArray:
    """Turn of the matrix M, in its own axes, per change of s, (3, 3): M' dM = [rates ds]x.

    Inverse of ds = ((1 - s.s) I + 2 [s]x + 2 s s') omega / 4 (Schaub and Junkins, Analytical
    mechanics of space systems, equation 3.152).
    """
    a, b, c = s.tolist()  # written out: numpy's own takes ten times as long on three numbers
    n = a * a + b * b + c * c
    d, k = 1 - n, 4 / (1 + n) ** 2
    rates: FloatArray = k * np.array(
        [
            [d + 2 * a * a, 2 * (a * b + c), 2 * (a * c - b)],
            [2 * (a * b - c), d + 2 * b * b, 2 * (b * c + a)],
            [2 * (a * c + b), 2 * (b * c - a), d + 2 * c * c],
        ]
    )
    return rates
