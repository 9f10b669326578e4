"""``ForceProblem``: the programme of contact forces, with named rows and columns.

    minimise    1/2 x'P x + q'x
    subject to  A x = b      balance G f - r = -wrench, and joint torques
                             R^T F + S^T lam = J^T f + gravity_torque
                D x <= 0     friction pyramids
                C x          in second-order cones, head >= |tail|: round friction cones
                lower <= x <= upper            normal force, actuator limits at q, lam >= 0

    x = [contact forces f, actuator forces F, stop forces lam, excess e, residual r]

f is what the hand does to the object, in the contact frames, so J^T f is the torque that the joints
supply to press that hard. P is diagonal unless joint torques have a cost; among equal contact
forces, small actuator forces and then smaller stop forces decide. Excess e (one per contact) is
there if forces near the cone's edge have a cost, residual r if the wrench is a cost and not an
equality.

Torques enter for the joints that a contact moves and those tied to them by a tendon or a stop; the
other joints carry their own gravity and are no matter of the grasp.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from planner.actuation import Actuation
from planner.contacts import ContactSet
from planner.spatial import FloatArray, IntArray

__all__ = ["RESIDUAL_TOL", "ForceProblem", "ForceResiduals", "contact_names"]

RESIDUAL_TOL = 1e-6
"""Largest residual of an answer, in units of ``ForceProblem.force_scale`` (-): 1e-6 N for a weight
of 1 N, far below what any sensor or simulator resolves."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ForceResiduals:
    """How far an answer is from what was asked, recomputed from it.

    Attributes:
        wrench: (6,), G f + wrench, N and N m.
        cone: Largest violation of a friction pyramid or cone, N.
        bounds: Largest violation of a bound, N; torques divided by the problem's length.
        torque: Joint torque that is missing (nv,), N m; 0 for joints outside the problem.
        worst: Largest of all, N, torques divided by the length; infinite without an answer. Where
            the wrench is a cost, what r takes up does not count.
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
        equality, equality_value: A (6 + nt, nx) and b; the first six rows are the balance.
        faces: D (m, nx), N.
        cones: C (mc, nx), N: blocks of rows [head, tail ...].
        cone_sizes: Rows of each block, 3 or 4; none with pyramids.
        lower, upper: (nx,), infinite where free.
        column_names, equality_names, face_names, cone_names: What each column, row and block is.
        column_scale: (nx,), unit of each variable per newton: 1, or a length in m.
        row_scale: (6 + nt,), what turns an equality row into newtons.
        length: Characteristic length, m: distance of the furthest contact from the centre.
        force_scale: Size of the forces that are asked for, N; residuals are judged by it.
        joints: Joints whose torque is balanced (nt,), index into v.
        balance_cost: Cost of a squared residual of the balance, None where it is an equality.
        actuators: Actuators that take part (na,).
        stops: Active stops that take part (ns,).
        joint_map: (nv, number of force components): J^T in contact components.
        gravity_torque: (nv,), N m.
        actuation: What limits the torques, or None.
        q: (nv,) where ``actuation`` is given, else None.
    """

    contacts: ContactSet
    wrench: FloatArray
    quadratic: FloatArray
    linear: FloatArray
    equality: FloatArray
    equality_value: FloatArray
    faces: FloatArray
    cones: FloatArray
    cone_sizes: tuple[int, ...]
    lower: FloatArray
    upper: FloatArray
    column_names: tuple[str, ...]
    equality_names: tuple[str, ...]
    face_names: tuple[str, ...]
    cone_names: tuple[str, ...]
    column_scale: FloatArray
    row_scale: FloatArray
    length: float
    force_scale: float
    balance_cost: float | None
    joints: IntArray
    actuators: IntArray
    stops: IntArray
    joint_map: FloatArray
    gravity_torque: FloatArray
    actuation: Actuation | None
    q: FloatArray | None

    @property
    def n_force(self) -> int:
        """Number of contact force components: they are the first columns."""
        return sum(self.contacts.dims)

    @property
    def cost(self) -> FloatArray:
        """Diagonal of P (nx,): cost of each squared unknown."""
        return np.diag(self.quadratic)

    @property
    def n_drive(self) -> int:
        """Number of contact, actuator and stop columns: excess and residual follow."""
        return self.n_force + len(self.actuators) + len(self.stops)

    def value(self, x: FloatArray) -> float:
        """Cost 1/2 x'P x + q'x at x (nx,)."""
        return float(0.5 * x @ self.quadratic @ x + self.linear @ x)

    @cached_property
    def contact_names(self) -> tuple[str, ...]:
        """A name for each contact: its finger if no other contact has it."""
        return contact_names(self.contacts)

    def contact_forces(self, x: FloatArray) -> FloatArray:
        """Contact forces (n, 4) in the contact frames; 0 where a model transmits nothing."""
        forces = np.zeros((len(self.contacts), 4))
        start = 0
        for row, dim in zip(forces, self.contacts.dims, strict=True):
            row[:dim] = x[start : start + dim]
            start += dim
        return forces

    def joint_torques(self, x: FloatArray) -> FloatArray:
        """Torque (nv,) that the joints need, J^T f + gravity_torque, N m."""
        return np.asarray(self.joint_map @ x[: self.n_force] + self.gravity_torque)

    def residuals(self, x: FloatArray) -> ForceResiduals:
        """Residuals at x (nx,). The wrench is summed by ``ContactSet.wrench``, not by A."""
        if not np.isfinite(x).all():
            nothing = np.full(len(self.gravity_torque), np.inf)
            return ForceResiduals(
                wrench=np.full(6, np.inf), cone=np.inf, bounds=np.inf, torque=nothing, worst=np.inf
            )
        wrench = self.contacts.with_forces(self.contact_forces(x)).wrench() + self.wrench
        torque = np.zeros(len(self.gravity_torque))
        torque[self.joints] = self.equality[6:] @ x - self.equality_value[6:]
        outside = np.maximum(self.lower - x, x - self.upper) / self.column_scale
        cone = max(float((self.faces @ x).max(initial=0.0)), self._outside_cones(x))
        bounds = float(outside.max(initial=0.0))
        scaled = self.row_scale * np.concatenate([wrench, torque[self.joints]])
        if self.balance_cost is not None:
            scaled[:6] -= self.row_scale[:6] * x[-6:]
        worst = max(float(np.abs(scaled).max()), cone, bounds)
        return ForceResiduals(wrench=wrench, cone=cone, bounds=bounds, torque=torque, worst=worst)

    def _outside_cones(self, x: FloatArray) -> float:
        """Largest |tail| - head, N, at least 0."""
        worst, start = 0.0, 0
        rows = self.cones @ x
        for size in self.cone_sizes:
            head, tail = rows[start], rows[start + 1 : start + size]
            worst = max(worst, float(np.linalg.norm(tail) - head))
            start += size
        return worst

    def __str__(self) -> str:
        """Sizes, then every column with its bounds and every equality, one a line."""
        lines = [
            f"force problem: {len(self.contacts)} contacts, {len(self.column_names)} columns "
            f"({self.n_force} contact, {len(self.actuators)} actuator, {len(self.stops)} stop"
            + (f", {more} more" if (more := len(self.column_names) - self.n_drive) else "")
            + f"), {len(self.equality_names)} equalities, {len(self.face_names)} friction faces"
            + (f", {len(self.cone_sizes)} round cones" if self.cone_sizes else ""),
            f"minimise {self._cost_in_words()}; lengths by {self.length:.4g} m, "
            f"forces by {self.force_scale:.4g} N",
        ]
        columns = zip(self.column_names, self.lower, self.upper, self.cost, strict=True)
        lines += [f"  {lo:>10.4g} <= {n} <= {hi:<10.4g} cost {c:.4g}" for n, lo, hi, c in columns]
        for name, row, value in zip(
            self.equality_names, self.equality, self.equality_value, strict=True
        ):
            terms = [f"{row[j]:+.4g} {self.column_names[j]}" for j in np.flatnonzero(row)]
            lines.append(f"  {name}: {' '.join(terms) or '0'} = {value + 0.0:.4g}")
        faces = Counter(self.face_names)
        lines += [f"  {name}: {count} faces" for name, count in faces.items()]
        lines += [f"  {name}: round, {n - 1} tangential" for name, n in self._named_cones()]
        return "\n".join(lines)

    def _cost_in_words(self) -> str:
        words = "1/2 sum cost x^2"
        if (self.quadratic != np.diag(self.cost)).any():
            words += " + products of contact forces"
        if self.linear.any():
            words += " + linear"
        return words

    def _named_cones(self) -> list[tuple[str, int]]:
        return list(zip(self.cone_names, self.cone_sizes, strict=True))


def contact_names(contacts: ContactSet) -> tuple[str, ...]:
    """A name for each contact: its finger if no other contact has it, else with its number."""
    count = Counter(contacts.fingers)
    return tuple(
        finger
        if finger and count[finger] == 1
        else f"contact {i}" + (f" ({finger})" if finger else "")
        for i, finger in enumerate(contacts.fingers)
    )
