"""``ForceProblem``: the programme of contact forces, with named rows and columns.

    minimise    1/2 x'P x + q'x
    subject to  G f = -wrench                  balance
                D x <= 0                       friction pyramids
                P'C f = 0                      passive forces (``planner.forces.compliance``)
                low <= Z J'f - Z E e <= high   joint torques (``planner.forces.limits``)
                C x in second-order cones      head >= |tail|: round friction cones
                lower <= x <= upper            normal forces, e

    x = [contact forces f, excess, forces e of actuators and stops that repeat others]

f is what the hand does to the object, in the contact frames, so J^T f is the torque that the joints
supply to press that hard. The cost is 1/2 |f|^2 and whatever ``QuadraticCost`` adds. The excess
(one per contact) is there if forces near the cone's edge have a cost: the tangential part of a
contact stays within (1 - margin) f_n + excess of the friction, with excess <= margin f_n, and
excess^2 costs. Forces that keep the margin cost no more then, and the whole cone remains open.

``distribute_forces`` solves a problem once; ``ForceLoop`` keeps one and writes what changes. Both
give the solver what ``ForceProblem.dense_qp`` makes, and judge its answer by the same violation.

``ContactWorkspace`` writes grasp map and J^T of moving contacts into a programme in place.

Forces and torques as tables for a terminal: what ``print`` shows of answers and of loops.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from planner.arrays import is_finite
from planner.contacts import ContactSet
from planner.errors import ContactError
from planner.forces.limits import TorqueLimits, names_of_contacts
from planner.numerics.qp import DenseQp
from planner.spatial import FloatArray, IntArray, contact_frames, skew

if TYPE_CHECKING:
    import qpsolvers


MOST_LINES = 14
"""Lines of a table; the rest are counted."""

CARRIES = 1e-9
"""Force of a stop (N, N m) from which on it is named."""


def at_most(lines: Sequence[str], most: int = MOST_LINES) -> list[str]:
    """The first lines, and how many others there are."""
    if len(lines) <= most:
        return list(lines)
    return [*lines[: most - 1], f"  ... and {len(lines) - most + 1} more"]


def wrench_text(wrench: FloatArray) -> str:
    """A wrench (6,) with units."""
    force, torque = (", ".join(f"{v:.3g}" for v in w + 0.0) for w in (wrench[:3], wrench[3:]))
    return f"force ({force}) N, torque ({torque}) N m"


def force_table(
    names: Sequence[str], forces: FloatArray, used: FloatArray | None = None
) -> list[str]:
    """One line per contact.

    Args:
        names: n names.
        forces: (n, 4), f_n, f_t1, f_t2 (N) and tau_n (N m).
        used: (n,), share of the friction cone in use (-), where it is known.
    """
    width = max(len(name) for name in ("contact", *names)) + 2
    head = (
        f"  {'contact':{width}}{'f_n (N)':>9}{'f_t1 (N)':>10}{'f_t2 (N)':>10}{'tau_n (mN m)':>14}"
    )
    rows = [
        f"  {name:{width}}{f[0]:9.3f}{f[1]:10.3f}{f[2]:10.3f}{1e3 * f[3]:14.2f}"
        for name, f in zip(names, forces, strict=True)
    ]
    if used is not None:
        head += f"{'friction used':>16}"
        rows = [f"{row}{100 * share:14.0f} %" for row, share in zip(rows, used, strict=True)]
    return [head, *at_most(rows)]


def torque_table(
    names: Sequence[str],
    forces: FloatArray,
    limits: FloatArray,
    stop_names: Sequence[str],
    stop_forces: FloatArray,
) -> list[str]:
    """Actuators with their limits, those nearest to one first, and the stops that carry.

    Args:
        names: nu actuators.
        forces: (nu,), N m (N for slides).
        limits: (nu, 2), least and greatest; may be infinite.
        stop_names: ns stops.
        stop_forces: (ns,), N m.
    """
    ends = np.where(forces >= 0.0, limits[:, 1], limits[:, 0])
    share = np.divide(forces, ends, out=np.full(len(forces), np.inf), where=ends != 0.0)
    share = np.where(forces == 0.0, 0.0, share)
    rows = [
        f"  {names[i]:16}{forces[i]:10.4f}{limits[i, 0]:10.4g}{limits[i, 1]:10.4g}"
        f"{100 * share[i]:8.0f} %"
        for i in np.argsort(-share, kind="stable").tolist()
    ]
    head = f"  {'actuator':16}{'N m':>10}{'least':>10}{'greatest':>10}{'used':>10}"
    carried = [
        f"{stop_names[i]} {stop_forces[i]:.4f}"
        for i in np.flatnonzero(stop_forces > CARRIES).tolist()
    ]
    stops = [f"  stops that carry (N m): {', '.join(at_most(carried))}"] if carried else []
    return [head, *at_most(rows), *stops]


RESIDUAL_TOL = 1e-6
"""Largest residual of an answer, in units of ``ForceProblem.force_scale`` (-): 1e-6 N for a weight
of 1 N, far below what any sensor or simulator resolves."""

BALANCE_TERMS, TORQUE_TERMS = 3, 2
"""Terms of a row that are printed; the others are counted."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ForceResiduals:
    """How far an answer is from what was asked, recomputed from it.

    Attributes:
        wrench: (6,), G f + wrench, N and N m.
        cone: Largest violation of a friction pyramid or cone, N.
        bounds: Largest violation of a bound, N; torques divided by the problem's length.
        torque: Joint torque that is missing (nv,), N m; 0 for joints outside the problem.
        worst: Largest of all, N, torques divided by the length; infinite without an answer.
    """

    wrench: FloatArray
    cone: float
    bounds: float
    torque: FloatArray
    worst: float


@dataclass(frozen=True, kw_only=True, eq=False)
class ForceProblem:
    """The programme of the module's docstring; ``build_force_problem`` makes one.

    Attributes:
        contacts: n contacts.
        wrench: (6,), external wrench on the object about ``contacts.center``, N and N m.
        quadratic, linear: P (nx, nx) and q (nx,).
        rows: (6 + mf + mp + mt, nx): balance, friction faces, passive forces, torques; N and N m.
        low, high: (6 + mf + mp + mt,), their limits; infinite where free.
        row_names: What each row is.
        n_faces: mf.
        torque_rows: Which rows of the torque limits take part (mt,).
        cones: C (mc, nx), N: blocks of rows [head, tail ...].
        cone_sizes: Rows of each block, 2 to 4; none with pyramids.
        cone_names: What each block is.
        lower, upper: (nx,), infinite where free.
        column_names: What each unknown is.
        column_scale: (nx,), unit of each unknown per newton: 1, or a length in m.
        row_scale: (6 + mf + mp + mt,), what turns a row into newtons.
        length: Characteristic length, m: distance of the furthest contact from the centre.
        force_scale: Size of the forces that are asked for, N; residuals are judged by it.
        cost_names: What costs.
        joint_map: (nv, number of force components): J^T in contact components.
        gravity_torque: (nv,), N m.
        torque_limits: What limits the torques, at ``q``; None without an actuation.
        q: (nv,) where there is an actuation, else None.
    """

    contacts: ContactSet
    wrench: FloatArray
    quadratic: FloatArray
    linear: FloatArray
    rows: FloatArray
    low: FloatArray
    high: FloatArray
    row_names: tuple[str, ...]
    n_faces: int
    torque_rows: IntArray
    cones: FloatArray
    cone_sizes: tuple[int, ...]
    cone_names: tuple[str, ...]
    lower: FloatArray
    upper: FloatArray
    column_names: tuple[str, ...]
    column_scale: FloatArray
    row_scale: FloatArray
    length: float
    force_scale: float
    cost_names: tuple[str, ...]
    joint_map: FloatArray
    gravity_torque: FloatArray
    torque_limits: TorqueLimits | None
    q: FloatArray | None

    @property
    def n_force(self) -> int:
        """Number of contact force components: they are the first columns."""
        return sum(self.contacts.dims)

    @property
    def n_extra(self) -> int:
        """Number of actuators and stops with unknowns of their own: they are the last columns."""
        return 0 if self.torque_limits is None else len(self.torque_limits.case.extra)

    @property
    def cost(self) -> FloatArray:
        """Diagonal of P (nx,): cost of each squared unknown."""
        return np.diag(self.quadratic)

    @property
    def faces(self) -> FloatArray:
        """Friction faces (mf, nx), a view of the rows."""
        return self.rows[6 : 6 + self.n_faces]

    @property
    def joints(self) -> IntArray:
        """Joints whose torque counts: those that contacts load, and those tied to them."""
        if self.torque_limits is None:
            return np.zeros(0, dtype=np.int64)
        return np.flatnonzero(self.torque_limits.case.rows[self.torque_rows].any(axis=0))

    def value(self, x: FloatArray) -> float:
        """Cost 1/2 x'P x + q'x at x (nx,)."""
        return float(0.5 * x @ self.quadratic @ x + self.linear @ x)

    def dense_qp(self, unit: float = 1.0) -> DenseQp:
        """The programme as solvers see it: rows and columns in newtons.

        Args:
            unit: Forces are counted in this many newtons.
        """
        scale, nx = self.column_scale, len(self.column_names)
        qp = DenseQp(nx, len(self.rows), 6)
        np.multiply(self.quadratic, scale[:, None] * scale, out=qp.p)
        np.multiply(self.linear, scale / unit, out=qp.q)
        np.multiply(self.row_scale[:, None] * self.rows, scale, out=qp.a)
        for of_rows, bounds, row_end, end in (
            (self.low, self.lower, qp.low, qp.lower),
            (self.high, self.upper, qp.high, qp.upper),
        ):
            np.divide(self.row_scale * of_rows, unit, out=row_end)
            np.divide(bounds, scale * unit, out=end)
        qp.cones, qp.cone_sizes = self.cones * scale, self.cone_sizes
        return qp

    def to_qpsolvers(self, *, sparse: bool = False) -> qpsolvers.Problem:
        """The programme for qpsolvers; its unknowns times ``column_scale`` are x. No round cones.

        Args:
            sparse: Whether matrices are scipy.sparse.csc_matrix.
        """
        return self.dense_qp().to_qpsolvers(sparse=sparse)

    @cached_property
    def contact_names(self) -> tuple[str, ...]:
        """A name for each contact: its finger if no other contact has it."""
        return names_of_contacts(self.contacts.fingers)

    def contact_forces(self, x: FloatArray) -> FloatArray:
        """Contact forces (n, 4) in the contact frames; 0 where a model transmits nothing."""
        n = len(self.contacts)
        forces = np.zeros((n, 4))
        if self.contacts.dims == (3,) * n:
            forces[:, :3] = x[: 3 * n].reshape(n, 3)
            return forces
        start = 0
        for row, dim in zip(forces, self.contacts.dims, strict=True):
            row[:dim] = x[start : start + dim]
            start += dim
        return forces

    def joint_torques(self, x: FloatArray) -> FloatArray:
        """Torque (nv,) that the joints need, J^T f + gravity_torque, N m."""
        return np.asarray(self.joint_map @ x[: self.n_force] + self.gravity_torque)

    def residuals(self, x: FloatArray) -> ForceResiduals:
        """Residuals at x (nx,). The wrench is summed by ``ContactSet.wrench``, not by the rows."""
        if not np.isfinite(x).all():
            nothing = np.full(len(self.gravity_torque), np.inf)
            return ForceResiduals(
                wrench=np.full(6, np.inf), cone=np.inf, bounds=np.inf, torque=nothing, worst=np.inf
            )
        wrench = self.contacts.wrench_of(self.contact_forces(x)) + self.wrench
        value = self.rows @ x
        off = self.row_scale * (value - np.minimum(np.maximum(value, self.low), self.high))
        end = len(off) - len(self.torque_rows)
        faces, torque = off[6 : 6 + self.n_faces], off[end:]
        passive = float(np.abs(off[6 + self.n_faces : end]).max(initial=0.0))
        missing = np.zeros(len(self.gravity_torque))
        if self.torque_limits is not None:
            by_row = np.zeros(len(missing))
            by_row[self.torque_rows] = self.length * torque
            missing = self.torque_limits.case.inverse @ by_row
        outside = np.maximum(self.lower - x, x - self.upper) / self.column_scale
        round_cones = list[float]()
        if self.cone_sizes:
            blocks = np.split(self.cones @ x, np.cumsum(self.cone_sizes)[:-1])
            round_cones = [float(np.linalg.norm(b[1:]) - b[0]) for b in blocks]
        cone = max([float(faces.max(initial=0.0)), *round_cones])
        bounds = float(outside.max(initial=0.0))
        missed = float(np.abs(self.row_scale[:6] * wrench).max())
        worst = max(missed, cone, bounds, passive, float(np.abs(torque).max(initial=0.0)))
        return ForceResiduals(wrench=wrench, cone=cone, bounds=bounds, torque=missing, worst=worst)

    def __repr__(self) -> str:
        """One line; the attributes hold the rest."""
        return f"<ForceProblem of {len(self.contacts)} contacts against {wrench_text(self.wrench)}>"

    def __str__(self) -> str:
        """A screen: sizes and costs, bounded unknowns, rows by their largest terms, friction."""
        nf, ne = self.n_force, self.n_extra
        excess = len(self.column_names) - nf - ne
        mt = len(self.torque_rows)
        passive = len(self.rows) - 6 - self.n_faces - mt
        head = [
            f"force problem: {len(self.contacts)} contacts, {len(self.column_names)} columns "
            f"({nf} contact, {excess} excess, {ne} repeated actuator or stop), 6 rows of balance, "
            f"{self.n_faces} friction faces, {mt} rows of torque"
            + (f", {passive} of passive forces" if passive else "")
            + (f", {len(self.cone_sizes)} round cones" if self.cone_sizes else ""),
            f"minimise 1/2 sum cost x^2: {', '.join(self.cost_names)}; lengths by "
            f"{self.length:.4g} m, forces by {self.force_scale:.4g} N",
        ]
        free = np.isinf(self.lower) & np.isinf(self.upper)
        columns = [
            f"  {self.lower[j]:.4g} <= {self.column_names[j]} <= {self.upper[j]:.4g}, "
            f"cost {self.cost[j]:.4g}"
            for j in np.flatnonzero(~free)
        ]
        torques = range(6 + self.n_faces, len(self.rows))
        faces = Counter(self.row_names[6 : 6 + self.n_faces])
        friction = [f"  {name}: {count} faces" for name, count in faces.items()]
        named = zip(self.cone_names, self.cone_sizes, strict=True)
        friction += [f"  {name}: round, {size - 1} tangential" for name, size in named]
        return "\n".join(
            [
                *head,
                *at_most(columns),
                *([f"  {free.sum()} unknowns without bounds"] if free.any() else []),
                *(self._row_text(i, BALANCE_TERMS) for i in range(6)),
                *at_most([self._row_text(i, TORQUE_TERMS) for i in torques], 20),
                *at_most(friction, 8),
            ]
        )

    def _row_text(self, i: int, most: int) -> str:
        """One row with its limits and its largest terms."""
        row, low, high = self.rows[i], self.low[i], self.high[i]
        there = np.flatnonzero(row)
        largest = np.sort(there[np.argsort(-np.abs(row[there]), kind="stable")[:most]])
        text = " ".join(f"{row[j]:+.3g} {self.column_names[j]}" for j in largest) or "0"
        if len(there) > most:
            text += f" and {len(there) - most} more"
        sides = f"{text} = {low + 0.0:.3g}" if low == high else f"{low:.3g} <= {text} <= {high:.3g}"
        return f"  {self.row_names[i]}: {sides}"


OPPOSED = 0.0
"""Cosine between an old and a new normal below which tangents are chosen anew (-): a turn by more
than 90 degrees multiplies rounding errors, and a pad that chatters has one at every step."""


class ContactWorkspace:
    """Where contacts are, and what they do to the object and to the joints.

    Attributes:
        positions, frames, center: As they are now; write them, then ``place``.
        spin: (n,), torque on the object about its normal that comes with a contact's normal force,
            N m per N; written likewise.
        table: (6, nx), the grasp map.
        lever: (nx, nv), joint torque per unknown, N m per N.
        plain: Whether all are point contacts and the forces all there is.
    """

    def __init__(
        self, contacts: ContactSet, length: float, unit: FloatArray, table: FloatArray, nv: int
    ) -> None:
        """Lay out.

        Args:
            contacts: As they are at first.
            length: Torques are divided by it, m.
            unit: Unit of each unknown per newton (nx,); force components come first.
            table: (6, nx), where the grasp map goes.
            nv: Number of joints.
        """
        dims = np.array(contacts.dims, dtype=np.int64)
        n, nx = len(dims), len(unit)
        wide = int(dims.max(initial=3))
        self.table, self._length, self._nv, self._unit = table, length, nv, unit
        self._soft = wide == 4
        self.positions, self.frames = np.array(contacts.positions), np.array(contacts.frames)
        self.center, self.spin = np.array(contacts.center), np.zeros(n)
        # places of the unknowns among (n, wide) components, None where those are all
        present = np.flatnonzero((np.arange(wide) < dims[:, None]).ravel())
        direct = len(present) == wide * n == nx
        self._used = None if direct else present
        self.plain = direct and not self._soft
        # [1; skew(arm)] (n, 6, 3) is linear in (arm, 1); times the frames it is the grasp map
        self._arms, self._carry = np.ones((n, 4)), np.zeros((n, 18))
        self._from_arms = np.zeros((4, 18))
        self._from_arms[:3, 9:] = skew(np.eye(3)).reshape(3, 9) / length
        self._from_arms[3, :9] = np.eye(3).ravel()
        self._six = self._carry.reshape(-1, 6, 3)
        self._moved = self._arms[:, :3]
        self._turned = self.frames.transpose(0, 2, 1)
        self._map = np.zeros((n, 6, wide))
        self.lever = np.zeros((nx, nv))
        self._levers = np.zeros((n, wide, nv))
        if direct:
            self._map = table.reshape(6, n, wide).transpose(1, 0, 2)
            self._levers = self.lever.reshape(n, wide, nv)
        self._forces_map, self._force_levers = self._map[:, :, :3], self._levers[:, :3]

    def place(self) -> None:
        """Write the grasp map for the present places."""
        np.subtract(self.positions, self.center, out=self._moved)
        np.dot(self._arms, self._from_arms, out=self._carry)
        np.matmul(self._six, self.frames, out=self._forces_map)
        if self.spin.any():
            self._map[:, 3:, 0] += self.spin[:, None] * self.frames[:, :, 0] / self._length
        if self._soft:
            self._map[:, 3:, 3] = self.frames[:, :, 0] / self._length
        if self._used is not None:
            columns = self._map.transpose(1, 0, 2).reshape(6, -1)[:, self._used]
            self.table[:, : len(self._used)] = columns
        if self._soft:
            self.table *= self._unit

    def load(self, jacobians: FloatArray) -> None:
        """Write the levers from Jacobians (n, 3 or 6, nv).

        Raises:
            ContactError: Another shape.
        """
        n, rows = len(self.frames), 6 if self._soft else 3
        given = jacobians.shape
        if len(given) != 3 or given[0] != n or given[1] < rows or given[2] != self._nv:
            raise ContactError(f"jacobians have shape {given}; give ({n}, {rows}, {self._nv})")
        if not is_finite(jacobians):
            raise ContactError("jacobians hold NaN or infinity; give finite numbers")
        np.matmul(self._turned, jacobians[:, :3], out=self._force_levers)
        if self._soft:
            np.matmul(self._turned[:, :1], jacobians[:, 3:], out=self._levers[:, 3:])
        if self._used is not None:
            self.lever[: len(self._used)] = self._levers.reshape(-1, self._nv)[self._used]
        if self._soft:
            self.lever *= self._unit[:, None]


def turned_frames(frames: FloatArray, normals: FloatArray) -> FloatArray:
    """Contact frames (n, 3, 3) turned by the least rotation onto unit normals (n, 3).

    Tangents then move as little as the normals do, where ``contact_frames`` may jump.
    """
    old = frames[:, :, 0]
    cosine = (old * normals).sum(axis=1)
    if (cosine < OPPOSED).any():
        return contact_frames(normals)
    dyad = normals[:, :, None] * old[:, None]
    turn = dyad - dyad.transpose(0, 2, 1)  # the cross-product matrix of old x normals
    rotation = IDENTITY + turn + turn @ turn / (1.0 + cosine)[:, None, None]
    return np.asarray(rotation @ frames)


IDENTITY = np.eye(3)
