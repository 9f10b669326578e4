"""``DriveRows``: the actuators' limits as rows on joint torque, quick to renew at every q.

The torque of the joints is R^T F + S^T lam + passive, with F within the actuators' limits at q and
lam >= 0 of the stops that are active there. With M = [R^T, S^T] of full column rank, M^+ its
pseudo-inverse and N a basis of what M does not make, that is the same as

    low <= Z (tau - passive) <= high,    Z = [M^+; N],  low = high = 0 on the rows of N,

one row per joint, and the actuator and stop forces need no columns of their own. A stop along an
actuator (a joint limit on a joint with its own motor) or against another stop (the two of a tie)
takes the limit off one side of it instead; any other stop that repeats what is there is left out,
which can only refuse, never promise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.actuation import STOP_TOL, Actuation
from planner.errors import HandError
from planner.spatial import FloatArray

__all__ = ["DriveRows"]

RANK_TOL = 1e-9
"""Share of a column (-) that must be outside the columns before it, else it repeats them."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Case:
    """What depends on which stops are active, but not on q.

    Attributes:
        rows: Z (nv, nv) over the length.
        linear: [gap of each stop; offset of the limits' ends; Z (gravity - passive)], all of them
            linear in (q, 1, gravity).
        ends: (2, nv), of the actuators' laws without the offset; infinite where nothing limits.
        least, most: (2, nv), what both limits are kept within.
    """

    rows: FloatArray
    linear: FloatArray
    ends: FloatArray
    least: FloatArray
    most: FloatArray


class DriveRows:
    """Rows Z (nv, nv) and their limits; see the module.

    Attributes:
        gravity: Joint torques (nv,) that hold the hand itself, N m; write them, then ``at``.
    """

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
        offset = a.bias[:, 0] + a.bias[:, 1] * a.length0
        self._laws = np.zeros((nv, nv + 1))  # offset of the limits' ends = laws (q, 1)
        self._laws[:nu] = np.column_stack([a.bias[:, 1, None] * a.moment, offset]) / length
        self._gap_rows = np.column_stack([a.stop_rows, -a.stop_values])
        self._passive = np.column_stack([-np.reshape(a.stiffness, (nv, nv)), a.spring_torque])
        # forces clipped to the law's ends and to the force range; first the least, then the most
        self._ends, self._least, self._most = np.zeros((3, 2, nv))
        self._ends[:, :nu] = np.sort(a.gain[:, None] * a.ctrl_range, axis=1).T / length
        self._least[:, :nu], self._most[:, :nu] = a.force_range.T[:, None] / length
        self._state = np.ones(2 * nv + 1)
        self.gravity, self._q = self._state[nv + 1 :], self._state[:nv]
        self.gravity.fill(0.0)
        ns = len(a.stop_names)
        out = self._out = np.zeros(ns + 2 * nv)
        self._gaps, self._offset, self._shift = np.split(out, [ns, ns + nv])
        self._active = np.zeros(ns, dtype=np.bool_)
        self._cases: dict[bytes, _Case] = {}
        self._key = self._active.tobytes()
        self._case = self._case_of(self._key)

    def at(self, q: FloatArray, limits: FloatArray) -> FloatArray:
        """Z (nv, nv) over the length at q (nv,); writes the limits (2, nv) of Z J'f over it."""
        self._q[:] = q
        np.dot(self._case.linear, self._state, out=self._out)
        np.less_equal(self._gaps, STOP_TOL, out=self._active)
        if (key := self._active.tobytes()) != self._key:
            self._key, self._case = key, self._case_of(key)
            np.dot(self._case.linear, self._state, out=self._out)
        case = self._case
        np.add(case.ends, self._offset, out=limits)
        np.maximum(limits, case.least, out=limits)
        np.minimum(limits, case.most, out=limits)
        np.subtract(limits, self._shift, out=limits)
        return case.rows

    def _case_of(self, key: bytes) -> _Case:
        """What holds while the same stops are active; a case once met is kept."""
        if key not in self._cases:
            nv = len(self._q)
            rows, widening = self._rows(np.frombuffer(key, dtype=np.bool_))
            wide = np.isinf(widening)  # open on one side, whatever the law and the force range
            linear = np.zeros((len(self._out), len(self._state)))
            constant = np.vstack([self._gap_rows, self._laws, -rows @ self._passive])
            linear[:, : nv + 1] = constant
            linear[-nv:, nv + 1 :] = rows
            ends, least, most = (
                np.where(wide, widening, part) for part in (self._ends, self._least, self._most)
            )
            self._cases[key] = _Case(rows=rows, linear=linear, ends=ends, least=least, most=most)
        return self._cases[key]

    def _rows(self, active: NDArray[np.bool_]) -> tuple[FloatArray, FloatArray]:
        """Z over the length, and what is added to the limits (2, nv): 0 or infinity."""
        a = self._actuation
        nu, nv = a.moment.shape
        widening = np.zeros((2, nv))
        columns = list(a.moment)
        basis = list(np.linalg.qr(a.moment.T)[0].T)
        ties = np.isinf(a.stop_values)  # first, so that no limit of a joint stands in for a tie
        for row in a.stop_rows[[*np.flatnonzero(active & ties), *np.flatnonzero(active & ~ties)]]:
            size = np.linalg.norm(row)
            rest = row - sum(((b @ row) * b for b in basis), start=np.zeros(nv))
            if np.linalg.norm(rest) > RANK_TOL * size:
                columns.append(row)
                basis.append(rest / np.linalg.norm(rest))
                continue
            share = np.linalg.lstsq(np.array(columns).T, row, rcond=None)[0]
            along = np.flatnonzero(np.abs(share) > RANK_TOL * np.abs(share).max(initial=0.0))
            if len(along) == 1 and share[along[0]] > 0:
                widening[1, along[0]] = np.inf
            elif len(along) == 1:
                widening[0, along[0]] = -np.inf
        made = np.array(columns).reshape(-1, nv).T
        widening[1, nu : made.shape[1]] = np.inf  # stops push as hard as they must
        null = np.linalg.svd(made)[0][:, made.shape[1] :]
        return np.vstack([np.linalg.pinv(made), null.T]) / self._length, widening
