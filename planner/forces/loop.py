"""``ForceLoop``: contact forces at every step of a controller, with nothing made anew.

The programme is that of ``planner.forces.problem`` without columns for actuators (their limits are
rows on J^T f, see ``planner.forces.drive``), so five point contacts have 15 unknowns. Rows, limits
and the solver's workspace are laid out once; a step writes the numbers that changed, solves from
the last answer, and recomputes the residuals.

    minimise    1/2 sum c f^2 + change_cost/2 |f - f_previous|^2 + torque_cost/2 |tau/length|^2
    subject to  G f = -wrench, friction pyramids, normal forces and actuators within their limits

A contact that is not there now has ``max_normal`` 0: fingers join and leave, and forces ramp, by
bounds alone. Where the wrench cannot be met, a second programme has the least |G f + wrench|
(torque divided by the length) within every other limit.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any, Unpack, get_args

import numpy as np
from numpy.typing import ArrayLike

from planner.actuation import Actuation
from planner.arrays import checked_number, finite_given, float_array, per_item
from planner.contacts import ContactSet, check_frames
from planner.errors import ContactError
from planner.forces.build import LimitArguments, build_force_problem
from planner.forces.costs import check_not_negative
from planner.forces.drive import DriveRows
from planner.forces.friction import Pyramid
from planner.forces.placed import PlacedContacts
from planner.numerics.dense_qp import DenseQp, KeptSolver
from planner.numerics.warm_started import QUICK_SOLVER, keep_solver
from planner.spatial import FloatArray

__all__ = ["ForceLoop", "ForceStep"]

VIOLATION_WEIGHT = 1e6
"""Cost of a squared newton that is left over beside that of a squared newton of contact force (-):
where the wrench cannot be met, what is left over exceeds the least by a millionth of the forces."""

DEAREST = 100.0
"""Largest plausible price (N per N) of a wrench, beside its size: two contacts that bear it by a
friction of 0.1 have 50. That price over ``VIOLATION_WEIGHT`` is let through of a wrench that can be
had."""

STEP_TOL = 1e-6
"""Largest residual of a step's answer (N, torques divided by the length), by the larger of the
wrench's size and 1 N."""

LOADED_TOL = 1e-12
"""A row of torque per force (m) below this is of a joint that no contact loads."""


@dataclass(kw_only=True, eq=False)
class ForceStep:
    """What a step gave; its arrays are written again by the next step, copy what you keep.

    Attributes:
        forces: (n, 4), on the object, in the contact frames: f_n, f_t1, f_t2 (N), tau_n (N m).
        joint_torques: (nv,), J^T f + gravity torque, N m.
        left_over: (6,), G f + wrench, N and N m.
        allowed: Whether the forces respect friction, normal and actuator limits within tolerance.
        balanced: Whether they also balance the wrench within tolerance.
        violation: Largest violation of a limit, and of the balance if it is balanced, N.
        status: What the solver said (informative only).
        iterations: Its iterations, -1 where it does not say.
        solver_s: Wall time in the solver and its interface, s.
        total_s: Wall time of the whole step, s.
    """

    forces: FloatArray
    joint_torques: FloatArray
    left_over: FloatArray
    allowed: bool = False
    balanced: bool = False
    violation: float = np.inf
    status: str = ""
    iterations: int = -1
    solver_s: float = 0.0
    total_s: float = 0.0


class ForceLoop:
    """A force programme that is solved again and again; see the module.

    A loop is for one thread at a time; loops of different threads have nothing in common.

    Attributes:
        problem: The programme as it was built, for reading; ``str(loop.problem)`` prints it.
        qp: What the solver sees; forces in N, torques divided by ``problem.length``.
        placed: The contacts as they are now.
        solver: The solver of ``qp``, with its last answer and multipliers.
        result: The last step.
    """

    def __init__(
        self,
        contacts: ContactSet,
        *,
        change_cost: float = 0.0,
        torque_cost: float = 0.0,
        actuation: Actuation | None = None,
        joints: int = 0,
        solver: str = QUICK_SOLVER,
        tolerance: float = STEP_TOL,
        **limits: Unpack[LimitArguments],
    ) -> None:
        """Lay out the programme.

        Args:
            contacts: n contacts as they are at first: models, friction, places.
            change_cost: Cost of a squared change of force since the previous step, >= 0 (-).
            torque_cost: Cost of a squared joint torque divided by the squared length, >= 0 (-).
            actuation: Limits the joint torques; each step then needs ``jacobians`` and ``q``.
            joints: Number of joints, if there are Jacobians without an actuation.
            solver: One of ``solver_names()``.
            tolerance: Of the solver and of the verdict, N, torques divided by the length.
            **limits: As for ``build_force_problem``, but no round cone. A step may change
                ``min_normal`` and ``max_normal``.

        Raises:
            ContactError: A value out of range.
            HandError: The actuators repeat each other.
            NotFoundError: No such solver is installed.
        """
        for name, value in (("change_cost", change_cost), ("torque_cost", torque_cost)):
            check_not_negative(name, value)
        if (cone := limits.get("cone", "inscribed")) not in get_args(Pyramid):
            raise ContactError(f"cone is {cone!r}; a loop takes 'inscribed' or 'circumscribed'")
        if not checked_number("tolerance", tolerance) > 0:
            raise ContactError(f"tolerance is {tolerance}; give a number > 0 in N")
        p = self.problem = build_force_problem(contacts, wrench=np.zeros(6), **limits)
        self._tolerance = tolerance
        n, nx = len(contacts), len(p.column_names)
        nv = len(actuation.joint_names) if actuation is not None else joints
        self._drive = None if actuation is None else DriveRows(actuation, p.length)
        self._nv = nv
        m_faces, m_drive = len(p.faces), nv if self._drive is not None else 0
        pattern = np.ones((6 + m_faces + m_drive, nx), dtype=bool)
        pattern[6 : 6 + m_faces] = p.faces != 0
        self.qp = DenseQp(pattern, 6)
        self._fallback = DenseQp(pattern[6:], 0)
        self._unit = p.column_scale
        self._plain_cost = np.diag(p.cost * self._unit**2)
        forces = range(p.n_force)
        self._plain_cost[forces, forces] += change_cost
        self._change, self._effort = change_cost, torque_cost
        for qp in (self.qp, self._fallback):
            qp.p[:] = self._plain_cost
            faces = slice(qp.equalities, qp.equalities + m_faces)
            qp.a[faces] = p.faces * self._unit
            qp.high[faces] = 0.0
            qp.lower[:], qp.upper[:] = p.lower / self._unit, p.upper / self._unit
        self.solver = keep_solver(solver, self.qp, tolerance)
        self._solver_name = solver
        self._yielding: KeptSolver | None = None  # made when it is first needed
        self.placed = PlacedContacts(p, self.qp.a[:6], nv)
        self.placed.place()
        dims = np.array(contacts.dims, dtype=np.int64)
        self._of_four = np.flatnonzero((np.arange(4) < dims[:, None]).ravel())
        self._n_force = p.n_force  # counted once: it is asked for at every step
        normal = np.cumsum(dims) - dims
        self._tail = np.flatnonzero(~np.isin(np.arange(p.n_force), normal))
        self._owner = np.repeat(np.arange(n), dims)[self._tail]
        self._tail_limits = np.stack([p.lower[self._tail], p.upper[self._tail]])  # 0 or infinite
        self._normal: Any = normal
        if n and (dims == dims[0]).all():  # evenly spaced: a view
            self._normal = slice(0, p.n_force, int(dims[0]))
        self._least, self._most = np.array(p.lower[normal]), np.array(p.upper[normal])
        self._away = b""  # which contacts are away, as it was last written
        self._balance = self.qp.limits[:, nx : nx + 6]
        self._met = self.qp.value[nx : nx + 6]
        self._minus_row_scale, self._row_unit = -p.row_scale[:6], 1.0 / p.row_scale[:6]
        # rows of torque that no contact loads are open; known for these rows and this loading
        self._open, self._has_open = np.zeros((2, nv)), False
        self._loaded, self._loading = np.zeros((nx, nv), dtype=np.bool_), b""
        self._torque_limits = self.qp.limits[:, nx + 6 + m_faces :]
        self._torque_rows = self.qp.a[6 + m_faces :]
        self._rows: FloatArray | None = None
        self._gravity = np.zeros(nv) if self._drive is None else self._drive.gravity
        self._x = np.zeros(nx)
        self.result = ForceStep(
            forces=np.zeros((n, 4)), joint_torques=np.zeros(nv), left_over=np.zeros(6)
        )
        self._vectors = self.result.forces[:, :3]

    def step(
        self,
        wrench: FloatArray,
        *,
        positions: FloatArray | None = None,
        frames: FloatArray | None = None,
        center: FloatArray | None = None,
        jacobians: FloatArray | None = None,
        q: FloatArray | None = None,
        gravity_torque: FloatArray | None = None,
        min_normal: ArrayLike | None = None,
        max_normal: ArrayLike | None = None,
        previous: FloatArray | None = None,
    ) -> ForceStep:
        """Solve for what is now; what is not given stays as it was.

        Args:
            wrench: External wrench (6,) to be balanced, G f + wrench = 0, N and N m, about
                ``center`` in the axes of the contacts. A controller that wants the wrench w on the
                object gives -w.
            positions: Contact points (n, 3), m.
            frames: Contact frames (n, 3, 3); ``turned_frames`` makes them from normals.
            center: Point about which torques are taken (3,), m.
            jacobians: (n, 3 or 6, nv), as for ``build_force_problem``.
            q: Joints (nv,), for the actuators' limits.
            gravity_torque: Joint torques (nv,) that hold the hand itself, N m.
            min_normal: Least normal force, N, a number or (n,).
            max_normal: Greatest normal force, N, a number or (n,); 0 for a contact that is away.
            previous: Forces (n, 4) that ``change_cost`` is about; the last answer if not given.

        Returns:
            ``self.result``, written anew.

        Raises:
            ContactError: Shapes do not fit, NaN or infinity, frames that are no rotations, a least
                normal force above the greatest of a contact that is not away, or an actuation
                without Jacobians or q.
        """
        begin = time.perf_counter()
        placed, qp, n, nv = self.placed, self.qp, len(self._least), self._nv
        wrench = finite_given("wrench", wrench, (6,))
        if positions is not None or frames is not None or center is not None:
            if positions is not None:
                placed.positions[:] = finite_given("positions", positions, (n, 3))
            if frames is not None:
                frames = finite_given("frames", frames, (n, 3, 3))
                check_frames(frames)
                placed.frames[:] = frames
            if center is not None:
                placed.center[:] = finite_given("center", center, (3,))
            placed.place()
            qp.new_a = True
        if jacobians is not None:
            placed.load(float_array("jacobians", jacobians))
        if gravity_torque is not None:
            self._gravity[:] = finite_given("gravity_torque", gravity_torque, (nv,))
        if min_normal is not None or max_normal is not None:
            self._press(min_normal, max_normal)
        if self._change or self._effort:
            if previous is not None:
                previous = finite_given("previous", previous, (n, 4))
            self._write_costs(previous)
        if self._drive is not None:
            if q is None:
                raise ContactError("an actuation limits the torques; give q (nv,) at every step")
            q = finite_given("q", q, (nv,))
            self._limit_torques(self._drive, q, moved=jacobians is not None)
        np.multiply(self._minus_row_scale, wrench, out=self._balance)
        solver = self.solver
        called = time.perf_counter()
        solver.solve()
        solver_s = time.perf_counter() - called
        r = self.result
        r.violation = qp.violation(solver.x)
        r.balanced = r.allowed = r.violation <= self._tolerance or r.violation <= self._error()
        if not r.balanced:
            solver, spent = self._least_violation()
            solver_s += spent
            r.violation = self._fallback.violation(solver.x)
            r.allowed = r.violation <= self._error()
            missed = qp.violation(solver.x)  # this also tells what is left over
            r.balanced = r.allowed and missed <= self._error()
        if r.allowed:
            self._x = solver.x
        r.iterations, r.status = solver.iterations, solver.status
        self._give(solver.x, wrench)
        r.solver_s, r.total_s = solver_s, time.perf_counter() - begin
        return r

    def _error(self) -> float:
        """What may be missed of a wrench (N)."""
        wanted = self._balance[0]
        return self._tolerance * max(1.0, math.sqrt(wanted @ wanted))

    def _press(self, min_normal: ArrayLike | None, max_normal: ArrayLike | None) -> None:
        """Write bounds on normal forces; of a contact that is away everything is 0."""
        qp, n = self.qp, len(self._least)
        least = self._least if min_normal is None else per_item("min_normal", min_normal, n)
        most = self._most if max_normal is None else per_item("max_normal", max_normal, n)
        if n and not (least.min() >= 0.0 and least.max() < math.inf and most.min() >= 0.0):
            raise ContactError(
                f"min_normal is {min_normal!r} and max_normal {max_normal!r}; give finite forces "
                ">= 0 in N, and infinity for no greatest force"
            )
        if min_normal is not None and ((least > most) & (most > 0.0)).any():
            raise ContactError(
                f"min_normal {least.tolist()} is above max_normal {most.tolist()}; give "
                "min_normal <= max_normal, or a max_normal of 0 for a contact that is away"
            )
        self._least[:] = least
        if max_normal is not None:
            self._most[:] = most
            qp.upper[self._normal] = self._most
            away = self._most <= 0.0
            if (key := away.tobytes()) != self._away:
                self._away = key
                tails = np.where(away[self._owner], 0.0, self._tail_limits)
                qp.lower[self._tail], qp.upper[self._tail] = tails
        qp.lower[self._normal] = np.minimum(self._least, self._most)

    def _write_costs(self, previous: FloatArray | None) -> None:
        """Write the costs on change of force and on joint torque."""
        qp, n = self.qp, self._n_force
        if self._change:
            before = self._x[:n]
            if previous is not None:
                before = previous.ravel()[self._of_four] / self._unit[:n]
            np.multiply(before, -self._change, out=qp.q[:n])
        if self._effort:
            weight, lever = self._effort / self.problem.length**2, self.placed.lever
            qp.p[:] = self._plain_cost + weight * (lever @ lever.T)
            slope = weight * (lever @ self._gravity)
            if not self._change:
                qp.q.fill(0.0)
            qp.q += slope
            qp.new_p = True
        qp.new_q = True

    def _limit_torques(self, drive: DriveRows, q: FloatArray, *, moved: bool) -> None:
        """Write the rows of torque: Z (J'f + gravity - passive) within its limits."""
        rows = drive.at(q, self._torque_limits)
        changed = rows is not self._rows
        if moved or changed:
            lever = self.placed.lever
            np.dot(rows, lever.T, out=self._torque_rows)
            np.not_equal(lever, 0.0, out=self._loaded)
            loading = self._loaded.tobytes()
            if changed or loading != self._loading:
                self._rows, self._loading = rows, loading
                idle = np.abs(self._torque_rows).max(axis=1, initial=0.0) < LOADED_TOL
                self._open[:] = np.where(idle, [[-np.inf], [np.inf]], 0.0)
                self._has_open = bool(idle.any())
            self.qp.new_a = True
        if self._has_open:
            self._torque_limits += self._open

    def _least_violation(self) -> tuple[KeptSolver, float]:
        """Solve for the least that is left over of a wrench in newtons; the solver and its time."""
        qp, loose = self.qp, self._fallback
        table, k = qp.a[:6], qp.equalities
        loose.p[:] = qp.p + VIOLATION_WEIGHT * (table.T @ table)
        loose.q[:] = qp.q - VIOLATION_WEIGHT * (table.T @ qp.low[:k])
        loose.a[:], loose.low[:], loose.high[:] = qp.a[6:], qp.low[6:], qp.high[6:]
        loose.lower[:], loose.upper[:] = qp.lower, qp.upper
        loose.new_p = loose.new_q = loose.new_a = True
        if self._yielding is None:
            self._yielding = keep_solver(self._solver_name, loose, self._tolerance)
        begin = time.perf_counter()
        solver = self._yielding
        solver.solve()
        through = DEAREST * np.linalg.norm(qp.low[:k]) / VIOLATION_WEIGHT
        if self._tolerance < qp.violation(solver.x) <= through:
            # what is left over may be what the cost lets through: the wrench can be had, though the
            # solver refused it, and a step of the method of multipliers gets it
            loose.q -= VIOLATION_WEIGHT * (table.T @ (qp.low[:k] - self._met))
            loose.new_q = True
            solver.solve()
        return solver, time.perf_counter() - begin

    def _give(self, x: FloatArray, wrench: FloatArray) -> None:
        """Write forces, torques and what is left over of an answer."""
        r = self.result
        if self.placed.plain:
            self._vectors[:] = x.reshape(-1, 3)
        else:
            r.forces.reshape(-1)[self._of_four] = (self._unit * x)[: self._n_force]
        np.multiply(self._met, self._row_unit, out=r.left_over)
        r.left_over += wrench
        if self._nv:
            np.dot(x, self.placed.lever, out=r.joint_torques)
            r.joint_torques += self._gravity
