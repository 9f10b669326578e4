"""``DriveRows``: the actuators' limits as rows on joint torque, quick to renew at every q.

The torque of the joints is R^T F + S^T lam + passive, with F within the actuators' limits at q and
lam >= 0 of the stops that are active there. With M = [R^T, S^T] of full column rank, M^+ its
pseudo-inverse and N a basis of what M does not make, that is the same as

    low <= Z (tau - passive) <= high,    Z = [M^+; N],  low = high = 0 on the rows of N,

one row per joint, and the actuator and stop forces need no columns of their own. A stop along an
actuator (a joint limit on a joint with its own motor) takes the limit off one side of it instead;
any other stop that repeats what is there is left out, which can only refuse, never promise.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.actuation import STOP_TOL, Actuation
from planner.errors import HandError
from planner.spatial import FloatArray

__all__ = ["DriveRows"]

RANK_TOL = 1e-9
"""Share of a column (-) that must be outside the columns before it, else it repeats them."""


class DriveRows:
    """Rows Z (nv, nv) and their limits; see the module. What ``at`` returns is written again."""

    def __init__(self, actuation: Actuation, length: float) -> None:
        """Prepare what does not depend on q.

        Args:
            actuation: The hand's.
            length: Everything is divided by it, m, and so comes in N.

        Raises:
            HandError: Actuators repeat each other (R has not full row rank).
        """
        a = self._actuation = actuation
        nu, nv = a.moment.shape
        rank = int(np.linalg.matrix_rank(a.moment)) if nu else 0
        if rank < nu:
            raise HandError(
                f"the {nu} actuators repeat each other (moment matrix of rank {rank}); use "
                "distribute_forces, which keeps one unknown per actuator"
            )
        self._length = length
        # [offset of each actuator's force, gap of each stop, passive torque] = linear q + constant
        self._linear = np.vstack(
            [
                a.bias[:, 1, None] * a.moment / length,
                a.stop_rows,
                -np.reshape(a.stiffness, (nv, nv)),
            ]
        )
        offset = a.bias[:, 0] + a.bias[:, 1] * a.length0
        self._constant = np.concatenate([offset / length, -a.stop_values, a.spring_torque])
        # forces clipped to the law's ends and to the force range; first the least, then the most
        self._ends = np.sort(a.gain[:, None] * a.ctrl_range, axis=1).T / length
        self._range = a.force_range.T[:, None] / length  # (2, 1, nu)
        self._moving = bool(np.isfinite(self._ends).any())
        self._limits = np.zeros((2, nv))
        self._forces = np.clip(self._ends, self._range[0], self._range[1])
        self._known: dict[bytes, tuple[FloatArray, FloatArray]] = {}
        self._constant_limits: tuple[FloatArray, FloatArray, FloatArray] | None = None
        if not (self._moving or a.stop_names or a.stiffness.any()):  # plain motors
            self._constant_limits = self.at(np.zeros(nv))

    def at(self, q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Z (nv, nv) over the length, limits (2, nv) over it, passive torque (nv,) at q (nv,)."""
        if self._constant_limits is not None:
            return self._constant_limits
        nu, ns = len(self._actuation.names), len(self._actuation.stop_names)
        out = self._linear @ q
        out += self._constant
        key = (out[nu : nu + ns] <= STOP_TOL).tobytes()
        if key not in self._known:
            self._known[key] = self._rows(np.frombuffer(key, dtype=np.bool_))
        rows, widening = self._known[key]
        if self._moving:
            forces = np.add(self._ends, out[:nu], out=self._forces)
            np.maximum(forces, self._range[0], out=forces)
            np.minimum(forces, self._range[1], out=forces)
        self._limits[:] = widening
        self._limits[:, :nu] += self._forces
        return rows, self._limits, out[nu + ns :]

    def _rows(self, active: NDArray[np.bool_]) -> tuple[FloatArray, FloatArray]:
        """Z over the length, and what is added to the limits (2, nv): 0 or infinity."""
        a = self._actuation
        nu, nv = a.moment.shape
        widening = np.zeros((2, nv))
        columns = list(a.moment)
        basis = list(np.linalg.qr(a.moment.T)[0].T)
        for row in a.stop_rows[np.flatnonzero(active)]:
            size = np.linalg.norm(row)
            rest = row - sum(((b @ row) * b for b in basis), start=np.zeros(nv))
            if np.linalg.norm(rest) > RANK_TOL * size:
                columns.append(row)
                basis.append(rest / np.linalg.norm(rest))
                continue
            share = np.linalg.lstsq(a.moment.T, row, rcond=None)[0]
            along = np.flatnonzero(np.abs(share) > RANK_TOL * np.abs(share).max(initial=0.0))
            alone = len(along) == 1 and np.linalg.norm(a.moment.T @ share - row) <= RANK_TOL * size
            if alone and share[along[0]] > 0:
                widening[1, along[0]] = np.inf
            elif alone:
                widening[0, along[0]] = -np.inf
        made = np.array(columns).reshape(-1, nv).T
        widening[1, nu : made.shape[1]] = np.inf  # stops push as hard as they must
        null = np.linalg.svd(made)[0][:, made.shape[1] :]
        return np.vstack([np.linalg.pinv(made), null.T]) / self._length, widening
