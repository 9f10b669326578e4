"""``ForceLoop``: contact forces at every step of a controller, with nothing made anew.

The programme is that of ``distribute_forces`` (``planner.forces.problem``): the same rows, costs
and verdict. Rows, limits and the solver's workspace are laid out once; a step writes the numbers
that changed, solves from the last answer, and recomputes the residuals.

A contact that is not there now has ``max_normal`` 0: fingers join and leave, and forces ramp, by
bounds alone. Where the wrench cannot be met, the forces are those that leave the least of it over
(``planner.forces.solve``).
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Unpack, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner.arrays import checked_number, finite_given, float_array, per_item
from planner.contacts import ContactSet, Pyramid, check_frames
from planner.errors import ContactError, shown
from planner.forces.build import EXTRA_COST, LimitArguments, QuadraticCost, build_force_problem
from planner.forces.limits import TorqueCase, TorqueLimits, loaded_rows
from planner.forces.problem import ContactWorkspace, force_table, wrench_text
from planner.forces.solve import Relaxation
from planner.joints.actuation import Actuation
from planner.numerics.qp import DEFAULT_SOLVER, DenseQp, QpWorkspace, qp_workspace
from planner.spatial import FloatArray

STEP_TOL = 1e-6
"""Largest residual of a step's answer (N, torques divided by the length), by the larger of the
wrench's size and 1 N."""


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

    def __str__(self) -> str:
        """A screen: the verdict, forces and the unbalanced wrench."""
        return self.text([f"contact {i}" for i in range(len(self.forces))])

    def text(self, names: Sequence[str], used: FloatArray | None = None) -> str:
        """The screen with n names of contacts and shares (n,) of their friction cones (-)."""
        verdict = "balanced" if self.balanced else "allowed, not balanced"
        lines = [
            f"contact forces: {verdict if self.allowed else 'not found'}, "
            f"in {1e6 * self.total_s:.0f} us ({1e6 * self.solver_s:.0f} us in the solver)",
            *force_table(names, self.forces, used),
        ]
        if not self.balanced:
            lines.append(f"  left over: {wrench_text(self.left_over)}")
        if len(self.joint_torques):
            lines.append(f"  largest joint torque {np.abs(self.joint_torques).max():.4f} N m")
        return "\n".join([*lines, f"  largest violation {self.violation:.1e} N"])


class ForceLoop:
    """A force programme that is solved again and again; see the module.

    A loop is for one thread at a time; loops of different threads have nothing in common.

    Attributes:
        problem: The programme as it was built, for reading; ``str(loop.problem)`` prints it.
        qp: What the solver sees; forces in N, torques divided by ``problem.length``.
        contacts: The contacts as they are now.
        solver: The solver of ``qp``, with its last answer and multipliers.
        result: The last step.
    """

    qp: DenseQp
    contacts: ContactWorkspace
    solver: QpWorkspace
    _relaxation: Relaxation | None
    _balance: FloatArray
    _met: FloatArray

    def __init__(
        self,
        contacts: ContactSet,
        *,
        change_cost: float = 0.0,
        actuation: Actuation | None = None,
        joints: int = 0,
        solver: str = DEFAULT_SOLVER,
        tolerance: float = STEP_TOL,
        **limits: Unpack[LimitArguments],
    ) -> None:
        """Lay out the programme.

        Args:
            contacts: n contacts as they are at first: models, friction, places.
            change_cost: Cost of a squared change of force since the previous step, >= 0 (-).
            actuation: Limits the joint torques; each step then needs ``jacobians`` and ``q``.
            joints: Number of joints, if there are Jacobians without an actuation.
            solver: One of ``solver_names()``.
            tolerance: Of the verdict, N, torques divided by the length.
            **limits: As for ``build_force_problem``, but no round cone. A step may change
                ``min_normal``, ``max_normal`` and ``costs``.

        Raises:
            ContactError: A value out of range.
            NotFoundError: No such solver is installed.
        """
        checked_number("change_cost", change_cost, least=0.0)
        if (cone := limits.get("cone", "inscribed")) not in get_args(Pyramid):
            raise ContactError(
                f"cone is {shown(cone)}; a loop takes 'inscribed' or 'circumscribed'"
            )
        if not checked_number("tolerance", tolerance) > 0:
            raise ContactError(f"tolerance is {tolerance}; give a number > 0 in N")
        costs = limits.pop("costs", ())
        p = self.problem = build_force_problem(contacts, wrench=np.zeros(6), **limits)
        self._tolerance, self._change, self._solver_name = tolerance, change_cost, solver
        n, nf = len(contacts), p.n_force
        self._n_force, self._unit = nf, p.column_scale
        nv = self._nv = len(actuation.joint_names) if actuation is not None else joints
        self._drive = None if actuation is None else TorqueLimits(actuation, p.length)
        self._gravity = np.zeros(nv) if self._drive is None else self._drive.gravity
        dims = np.array(contacts.dims, dtype=np.int64)
        self._of_four = np.flatnonzero((np.arange(4) < dims[:, None]).ravel())
        normal = np.cumsum(dims) - dims
        self._tail = np.flatnonzero(~np.isin(np.arange(nf), normal))
        self._owner = np.repeat(np.arange(n), dims)[self._tail]
        self._tail_limits = np.stack([p.lower[self._tail], p.upper[self._tail]])  # 0 or infinite
        self._normal: Any = normal
        if n and (dims == dims[0]).all():  # evenly spaced: a view
            self._normal = slice(0, nf, int(dims[0]))
        self._least, self._most = np.array(p.lower[normal]), np.array(p.upper[normal])
        # which contacts are away, as it was last written
        self._away: NDArray[np.bool_] | None = None
        self._minus_row_scale, self._row_unit = -p.row_scale[:6], 1.0 / p.row_scale[:6]
        self._case: TorqueCase | None = None
        self._lay_out(0)
        base, qp, m = p.dense_qp(), self.qp, 6 + p.n_faces
        qp.p[:], qp.a[:m], qp.low[:m], qp.high[:m] = base.p, base.a, base.low, base.high
        qp.p[range(nf), range(nf)] += change_cost
        qp.lower[:], qp.upper[:] = base.lower, base.upper
        self._plain_p, self._own_q = qp.p[:nf, :nf].copy(), np.zeros(nf)
        if costs:
            self._take_costs(costs)
        self.contacts.place()
        self.result = ForceStep(
            forces=np.zeros((n, 4)), joint_torques=np.zeros(nv), left_over=np.zeros(6)
        )
        self._vectors = self.result.forces[:, :3]

    def __repr__(self) -> str:
        """One line; ``str`` shows the last step."""
        return f"<ForceLoop of {len(self._least)} contacts by {self._solver_name}>"

    def __str__(self) -> str:
        """A screen: the last step, with the contacts' names and the friction that they use."""
        if not self.result.total_s:
            return f"{self!r}, no step yet; str(loop.problem) prints the programme"
        used = self.problem.contacts.with_forces(self.result.forces).friction_utilisation()
        return self.result.text(self.problem.contact_names, used)

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
        costs: Sequence[QuadraticCost] | None = None,
        spin: FloatArray | None = None,
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
            costs: What forces cost beside their squares, instead of what was given before.
            spin: Torque (n,) on the object about its normal that comes with each newton of a
                contact's normal force, m: torsional friction of a pad that pivots; 0 at first.

        Returns:
            ``self.result``, written anew.

        Raises:
            ContactError: Shapes do not fit, NaN or infinity, frames that are no rotations, a least
                normal force above the greatest of a contact that is not away, or an actuation
                without Jacobians or q.
        """
        begin = time.perf_counter()
        n, nv = len(self._least), self._nv
        wrench = finite_given("wrench", wrench, (6,))
        if gravity_torque is not None:
            self._gravity[:] = finite_given("gravity_torque", gravity_torque, (nv,))
        self._place(positions, frames, center, spin)
        if jacobians is not None:
            self.contacts.load(float_array("jacobians", jacobians))
        if min_normal is not None or max_normal is not None:
            self._press(min_normal, max_normal)
        if costs is not None:
            self._take_costs(costs)
        if self._change:
            if previous is not None:
                previous = finite_given("previous", previous, (n, 4))
            self._resist_change(previous)
        if self._drive is not None:
            if q is None:
                raise ContactError("an actuation limits the torques; give q (nv,) at every step")
            q = finite_given("q", q, (nv,))
            self._limit_torques(self._drive, q, moved=jacobians is not None)
        qp, solver = self.qp, self.solver
        np.multiply(self._minus_row_scale, wrench, out=self._balance)
        called = time.perf_counter()
        solver.solve()
        solver_s = time.perf_counter() - called
        r = self.result
        r.violation = qp.violation(solver.x)
        r.balanced = r.allowed = r.violation <= self._tolerance or r.violation <= self._error()
        if not r.balanced:
            called = time.perf_counter()
            if self._relaxation is None:
                self._relaxation = Relaxation(qp, self._solver_name)
            solver = self._relaxation.solver
            x = self._relaxation.solve(self._tolerance)
            solver_s += time.perf_counter() - called
            r.violation = self._relaxation.loose.violation(x)
            r.allowed = r.violation <= self._error()
            missed = qp.violation(x)  # the unbalanced wrench, too
            r.balanced = r.allowed and missed <= self._error()
        if r.allowed:
            self._x = solver.x
        r.iterations, r.status = solver.iterations, solver.status
        self._give(solver.x, wrench)
        r.solver_s, r.total_s = solver_s, time.perf_counter() - begin
        return r

    def _place(
        self,
        positions: FloatArray | None,
        frames: FloatArray | None,
        center: FloatArray | None,
        spin: FloatArray | None,
    ) -> None:
        """Write where the contacts are now.

        Raises:
            ContactError: As ``step``.
        """
        if positions is None and frames is None and center is None and spin is None:
            return
        now, n = self.contacts, len(self._least)
        if positions is not None:
            now.positions[:] = finite_given("positions", positions, (n, 3))
        if frames is not None:
            frames = finite_given("frames", frames, (n, 3, 3))
            check_frames(frames)
            now.frames[:] = frames
        if center is not None:
            now.center[:] = finite_given("center", center, (3,))
        if spin is not None:
            now.spin[:] = finite_given("spin", spin, (n,))
        now.place()
        self.qp.new_a = True

    def _lay_out(self, extra: int) -> None:
        """Make the programme with unknowns for actuators and stops that repeat others.

        How many there are changes with the active stops, and most hands have none: they are added
        where a step meets more than there is room for.
        """
        p, nv = self.problem, self._nv
        before, unit = len(p.column_names), np.append(p.column_scale, np.full(extra, p.length))
        nx, rows = len(unit), 6 + p.n_faces
        self._n_extra, self._x = extra, np.zeros(nx)
        self.qp = DenseQp(nx, rows + (nv if self._drive is not None else 0), 6)
        self.qp.p[range(before, nx), range(before, nx)] = EXTRA_COST
        self.qp.lower[before:] = self.qp.upper[before:] = 0.0
        self.solver = qp_workspace(self._solver_name, self.qp)
        self._relaxation = None  # made when it is first needed
        self.contacts = ContactWorkspace(p.contacts, p.length, unit, self.qp.a[:6], nv)
        self._balance = self.qp.limits[:, nx : nx + 6]
        self._met = self.qp.value[nx : nx + 6]
        self._torque_limits = self.qp.limits[:, nx + rows :]
        self._torque_rows = self.qp.a[rows:]
        # rows of torque that no contact loads are open; known for these rows and this loading
        self._open, self._has_open = np.zeros((2, nv)), False
        self._loaded_by: NDArray[np.bool_] = np.zeros((nx, nv), dtype=np.bool_)

    def _make_room(self, extra: int) -> None:
        """Lay out anew with more unknowns; what was written stays."""
        old, was, x, n = self.qp, self.contacts, self._x, len(self.qp.q)
        self._lay_out(extra)
        self._x[:n] = x
        qp, now = self.qp, self.contacts
        qp.p[:n, :n], qp.q[:n], qp.a[:, :n] = old.p, old.q, old.a
        qp.lower[:n], qp.upper[:n], qp.low[:], qp.high[:] = old.lower, old.upper, old.low, old.high
        now.positions[:], now.frames[:], now.center[:] = was.positions, was.frames, was.center
        now.spin[:] = was.spin
        now.place()
        now.lever[:n] = was.lever

    def _error(self) -> float:
        """What may be missed of a wrench (N), by the scale of ``ForceProblem`` from 1 N on."""
        asked = np.abs(self._balance[0]).max()
        return self._tolerance * max(1.0, float(asked), float(self._least.max(initial=0.0)))

    def _press(self, min_normal: ArrayLike | None, max_normal: ArrayLike | None) -> None:
        """Write bounds on normal forces; of a contact that is away everything is 0."""
        qp, n = self.qp, len(self._least)
        least = self._least if min_normal is None else per_item("min_normal", min_normal, n)
        most = self._most if max_normal is None else per_item("max_normal", max_normal, n)
        if n and not (least.min() >= 0.0 and least.max() < math.inf and most.min() >= 0.0):
            raise ContactError(
                f"min_normal is {shown(min_normal)} and max_normal {shown(max_normal)}; give "
                "finite forces >= 0 in N, and infinity for no greatest force"
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
            if self._away is None or not np.array_equal(away, self._away):
                self._hold_away(away)
        qp.lower[self._normal] = np.minimum(self._least, self._most)

    def _hold_away(self, away: NDArray[np.bool_]) -> None:
        """Write the bounds of all rows but normal forces; some contacts (n,) are away."""
        self._away = away
        tails = np.where(away[self._owner], 0.0, self._tail_limits)
        self.qp.lower[self._tail], self.qp.upper[self._tail] = tails

    def _take_costs(self, costs: Sequence[QuadraticCost]) -> None:
        """Write costs in place of those before."""
        qp, nf = self.qp, self._n_force
        p, self._own_q = self._plain_p.copy(), np.zeros(nf)
        for cost in costs:
            cost.check_size(nf)
            p += cost.p * np.outer(self._unit[:nf], self._unit[:nf])
            self._own_q += cost.q * self._unit[:nf]
        qp.p[:nf, :nf], qp.q[:nf] = p, self._own_q
        qp.new_p = qp.new_q = True

    def _resist_change(self, previous: FloatArray | None) -> None:
        """Write the cost of a change from the previous forces."""
        qp, n = self.qp, self._n_force
        before = self._x[:n]
        if previous is not None:
            before = previous.ravel()[self._of_four] / self._unit[:n]
        np.multiply(before, -self._change, out=qp.q[:n])
        qp.q[:n] += self._own_q
        qp.new_q = True

    def _limit_torques(self, drive: TorqueLimits, q: FloatArray, *, moved: bool) -> None:
        """Write the rows of torque: Z (J'f + gravity - passive) - Z E e within its limits."""
        case = drive.at(q, self._torque_limits)
        changed, ne = case is not self._case, len(case.extra)
        if ne > self._n_extra:
            self._make_room(ne)
            drive.at(q, self._torque_limits)
            changed = True
        if moved or changed:
            lever, before = self.contacts.lever, len(self._unit)
            np.dot(case.rows, lever.T, out=self._torque_rows)
            if self._n_extra:
                self._torque_rows[:, before : before + ne] = case.extra_rows * self.problem.length
            loaded = lever != 0.0
            if changed or not np.array_equal(loaded, self._loaded_by):
                self._case, self._loaded_by = case, loaded
                self._open_idle_rows(case)
            self.qp.new_a = True
        if self._n_extra:
            at = len(self._unit)
            self.qp.limits[:, at : at + self._n_extra] = 0.0
            self.qp.limits[:, at : at + ne] = drive.extra_limits
        if self._has_open:
            self._torque_limits += self._open

    def _open_idle_rows(self, case: TorqueCase) -> None:
        """Lift the limits of rows of torque that no contact loads."""
        idle = ~loaded_rows(self._torque_rows[:, : len(self._unit)], case.extra_rows)
        self._open[:] = np.where(idle, [[-np.inf], [np.inf]], 0.0)
        self._has_open = bool(idle.any())

    def _give(self, x: FloatArray, wrench: FloatArray) -> None:
        """Write forces, torques and the unbalanced wrench of an answer."""
        r = self.result
        if self.contacts.plain:
            self._vectors[:] = x.reshape(-1, 3)
        else:
            nf = self._n_force
            r.forces.reshape(-1)[self._of_four] = self._unit[:nf] * x[:nf]
        np.multiply(self._met, self._row_unit, out=r.left_over)
        r.left_over += wrench
        if self._nv:
            np.dot(x, self.contacts.lever, out=r.joint_torques)
            r.joint_torques += self._gravity
