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
from typing import get_args

import numpy as np
from numpy.typing import ArrayLike

from planner.actuation import Actuation
from planner.contacts import ContactSet
from planner.errors import ContactError
from planner.forces.build import EDGE_MARGIN, build_force_problem
from planner.forces.dense import QUICK_SOLVER, DenseQp, KeptSolver, keep_solver
from planner.forces.drive import DriveRows
from planner.forces.friction import LimitSurface, Pyramid
from planner.forces.placed import PlacedContacts
from planner.spatial import FloatArray

__all__ = ["ForceLoop", "ForceStep"]

VIOLATION_WEIGHT = 1e6
"""Cost of a squared newton that is left over beside that of a squared newton of contact force (-):
where the wrench cannot be met, what is left over exceeds the least by a millionth of the forces."""

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
        edges: int = 8,
        cone: Pyramid = "inscribed",
        limit_surface: LimitSurface = "ellipsoid",
        min_normal: ArrayLike = 0.0,
        max_normal: ArrayLike = np.inf,
        friction_scale: float = 1.0,
        tangential_cost: float = 1.0,
        edge_cost: float = 0.0,
        edge_margin: float = EDGE_MARGIN,
        change_cost: float = 0.0,
        torque_cost: float = 0.0,
        actuation: Actuation | None = None,
        joints: int = 0,
        solver: str = QUICK_SOLVER,
        tolerance: float = STEP_TOL,
    ) -> None:
        """Lay out the programme.

        Args:
            contacts: n contacts as they are at first: models, friction, places.
            edges: As for ``build_force_problem``.
            cone: "inscribed" or "circumscribed".
            limit_surface: As for ``build_force_problem``.
            min_normal: As there; a step may change it.
            max_normal: As there; a step may change it.
            friction_scale: As for ``build_force_problem``.
            tangential_cost: As for ``build_force_problem``.
            edge_cost: As for ``build_force_problem``.
            edge_margin: As for ``build_force_problem``.
            change_cost: Cost of a squared change of force since the previous step, >= 0 (-).
            torque_cost: Cost of a squared joint torque divided by the squared length, >= 0 (-).
            actuation: Limits the joint torques; each step then needs ``jacobians`` and ``q``.
            joints: Number of joints, if there are Jacobians without an actuation.
            solver: One of ``solver_names()``.
            tolerance: Of the solver and of the verdict, N, torques divided by the length.

        Raises:
            ContactError: A value out of range.
            HandError: The actuators repeat each other.
            NotFoundError: No such solver is installed.
        """
        for name, value in (("change_cost", change_cost), ("torque_cost", torque_cost)):
            if not 0 <= value < np.inf:
                raise ContactError(f"{name} is {value}; give a finite number >= 0")
        if cone not in get_args(Pyramid):
            raise ContactError(f"cone is {cone!r}; a loop takes 'inscribed' or 'circumscribed'")
        if not 0 < tolerance < np.inf:
            raise ContactError(f"tolerance is {tolerance}; give a number > 0 in N")
        p = self.problem = build_force_problem(
            contacts,
            wrench=np.zeros(6),
            edges=edges,
            cone=cone,
            min_normal=min_normal,
            max_normal=max_normal,
            friction_scale=friction_scale,
            limit_surface=limit_surface,
            tangential_cost=tangential_cost,
            edge_cost=edge_cost,
            edge_margin=edge_margin,
        )
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
        self._change, self._torque = change_cost, torque_cost
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
        self._normal = (np.cumsum(dims) - dims).astype(np.int64)
        self._tail = np.flatnonzero(~np.isin(np.arange(p.n_force), self._normal))
        self._owner = np.repeat(np.arange(n), dims)[self._tail]
        self._tail_limits = p.lower[self._tail], p.upper[self._tail]  # 0 or infinite
        self._least, self._most = p.lower[self._normal], p.upper[self._normal]
        self._balance = self.qp.limits[:, nx : nx + 6]
        # rows of torque that no contact loads are open; known for these rows and this loading
        self._open, self._loaded = np.zeros((2, nv)), b""
        self._torque_limits = self.qp.limits[:, len(self.qp.value) - m_drive :]
        self._rows: FloatArray | None = None
        self._gravity, self._x = np.zeros(nv), np.zeros(nx)
        self.result = ForceStep(
            forces=np.zeros((n, 4)), joint_torques=np.zeros(nv), left_over=np.zeros(6)
        )

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
            ContactError: Shapes do not fit, or an actuation without Jacobians or q.
        """
        begin = time.perf_counter()
        moved = positions is not None or frames is not None or center is not None
        placed = self.placed
        if positions is not None:
            placed.positions[:] = positions
        if frames is not None:
            placed.frames[:] = frames
        if center is not None:
            placed.center[:] = center
        if moved:
            placed.place()
        if jacobians is not None:
            placed.load(jacobians)
        if gravity_torque is not None:
            self._gravity[:] = gravity_torque
        if min_normal is not None or max_normal is not None:
            self._press(min_normal, max_normal)
        if self._change or self._torque:
            self._write_costs(previous)
        if self._drive is not None:
            if q is None:
                raise ContactError("an actuation limits the torques; give q (nv,) at every step")
            self._limit_torques(self._drive, q)
        qp = self.qp
        scaled = self.problem.row_scale[:6] * wrench
        np.negative(scaled, out=self._balance)
        allowed_error = self._tolerance * max(1.0, math.sqrt(scaled @ scaled))
        solver = self.solver
        called = time.perf_counter()
        solver.solve()
        solver_s = time.perf_counter() - called
        r = self.result
        r.violation = qp.violation(solver.x)
        r.balanced = r.allowed = r.violation <= allowed_error
        if not r.balanced:
            solver, spent = self._least_violation(scaled)
            solver_s += spent
            r.violation = self._fallback.violation(solver.x)
            qp.violation(solver.x)  # for what is left over
            r.allowed = r.violation <= allowed_error
        if r.allowed:
            self._x[:] = solver.x
        r.iterations, r.status = solver.iterations, solver.status
        self._give(solver.x, wrench)
        r.solver_s, r.total_s = solver_s, time.perf_counter() - begin
        return r

    def _press(self, min_normal: ArrayLike | None, max_normal: ArrayLike | None) -> None:
        """Write bounds on normal forces; of a contact that is away everything is 0."""
        qp = self.qp
        if min_normal is not None:
            self._least[:] = min_normal
        if max_normal is not None:
            self._most[:] = max_normal
            qp.upper[self._normal] = self._most
            away = (self._most <= 0.0)[self._owner]
            qp.lower[self._tail] = np.where(away, 0.0, self._tail_limits[0])
            qp.upper[self._tail] = np.where(away, 0.0, self._tail_limits[1])
        qp.lower[self._normal] = np.minimum(self._least, self._most)

    def _write_costs(self, previous: FloatArray | None) -> None:
        """Write the costs on change of force and on joint torque."""
        qp, n = self.qp, self.problem.n_force
        qp.q.fill(0.0)
        if self._change:
            if previous is not None:
                self._x[:n] = previous.ravel()[self._of_four] / self._unit[:n]
            qp.q[:n] = -self._change * self._x[:n]
        if self._torque:
            weight, lever = self._torque / self.problem.length**2, self.placed.lever
            qp.p[:] = self._plain_cost + weight * (lever @ lever.T)
            qp.q += weight * (lever @ self._gravity)

    def _limit_torques(self, drive: DriveRows, q: FloatArray) -> None:
        """Write the rows of torque: Z (J'f + gravity - passive) within its limits."""
        rows, limits, passive = drive.at(q)
        part = slice(len(self.qp.a) - self._nv, None)
        np.dot(rows, self.placed.lever.T, out=self.qp.a[part])
        loaded = (self.placed.lever != 0.0).tobytes()
        if rows is not self._rows or loaded != self._loaded:
            self._rows, self._loaded = rows, loaded
            idle = np.abs(self.qp.a[part]).max(axis=1, initial=0.0) < LOADED_TOL
            self._open[:] = np.where(idle, [[-np.inf], [np.inf]], 0.0)
        np.subtract(self._open, rows @ (self._gravity - passive), out=self._torque_limits)
        self._torque_limits += limits

    def _least_violation(self, scaled: FloatArray) -> tuple[KeptSolver, float]:
        """Solve for the least that is left over of a wrench in newtons; the solver and its time."""
        qp, loose = self.qp, self._fallback
        table = qp.a[:6]
        loose.p[:] = qp.p + VIOLATION_WEIGHT * (table.T @ table)
        loose.q[:] = qp.q + VIOLATION_WEIGHT * (table.T @ scaled)
        loose.a[:], loose.low[:], loose.high[:] = qp.a[6:], qp.low[6:], qp.high[6:]
        loose.lower[:], loose.upper[:] = qp.lower, qp.upper
        if self._yielding is None:
            self._yielding = keep_solver(self._solver_name, loose, self._tolerance)
        begin = time.perf_counter()
        self._yielding.solve()
        return self._yielding, time.perf_counter() - begin

    def _give(self, x: FloatArray, wrench: FloatArray) -> None:
        """Write forces, torques and what is left over of an answer."""
        r = self.result
        if self.placed.plain:
            r.forces[:, :3] = x.reshape(-1, 3)
        else:
            r.forces.reshape(-1)[self._of_four] = (self._unit * x)[: self.problem.n_force]
        balance = self.qp.value[len(x) : len(x) + 6]
        np.divide(balance, self.problem.row_scale[:6], out=r.left_over)
        r.left_over += wrench
        if self._nv:
            np.dot(x, self.placed.lever, out=r.joint_torques)
            r.joint_torques += self._gravity
