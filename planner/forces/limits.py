"""What friction, actuators and stops allow, as rows and bounds that are laid out once.

Attempts of one task have the same friction at every contact, wherever it is; so bounds, faces,
cones and names are laid out once for all of them.

``TorqueLimits``: what actuators and stops can do, as rows on joint torque, quick to renew.

The torque of the joints is R^T F + S^T lam + passive, with F within the actuators' limits at q and
lam >= 0 of the stops that are active there. Of the columns of [R^T, S^T] some are chosen that are
independent, M; the others repeat them, E, and keep unknowns e of their own. With M^+ the
pseudo-inverse of M and N a basis of what M does not make, that is the same as

    low <= Z (tau - passive - E e) <= high,    Z = [M^+; N],  low = high = 0 on the rows of N,

one row per joint. A stop along an actuator (a joint limit on a joint with its own motor) or against
another stop (the two of a tie) needs no unknown: it takes the limit off one side of that row. So E
is empty but for hands whose actuators repeat each other, and where stops do (a coupled finger that
is straight against two of them).

Joints that no actuator and no stop ties together are worked on apart. A row that no contact loads
is about the hand alone: its actuators carry the hand's weight or they do not, whatever is held, and
the row does not count.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from planner.contacts import CONTACT_DIM, Cone, ContactModel, pyramid_faces, round_cone
from planner.joints.actuation import STOP_TOL, Actuation, connected
from planner.spatial import FloatArray, IntArray
from planner.system.threads import built, made_once

KEPT = 64
"""Layouts that are kept (-), 10 kB each."""

_COMPONENTS = ("f_n", "f_t1", "f_t2", "tau_n")


@dataclass(frozen=True, kw_only=True, eq=False)
class FrictionPart:
    """Columns of the contact forces and of the excess, with their friction; read-only.

    Attributes:
        names: Of the force components (nf,).
        excess_names: Of the excess (ne,), one per contact if there is a margin.
        normal: Which of them are normal forces (n,).
        unit: (nf,), unit of each per newton.
        lower, upper: (nf,), with nothing said of normal forces.
        faces: (m, nf + ne), rows <= 0.
        cones: (mc, nf + ne), blocks [head, tail ...].
        cone_sizes: Rows of each block.
        face_names, cone_names: Of rows and blocks.
    """

    names: tuple[str, ...]
    excess_names: tuple[str, ...]
    normal: IntArray
    unit: FloatArray
    lower: FloatArray
    upper: FloatArray
    faces: FloatArray
    cones: FloatArray
    cone_sizes: tuple[int, ...]
    face_names: tuple[str, ...]
    cone_names: tuple[str, ...]


@made_once(KEPT)
def friction_part(
    models: tuple[ContactModel, ...],
    fingers: tuple[str, ...],
    friction: bytes,
    edges: int,
    cone: Cone,
    margin: float,
) -> FrictionPart:
    """Lay them out contact by contact.

    Args:
        models: Friction law of each contact.
        fingers: Their names.
        friction: Sliding (-) and torsional friction (m) of each, the bytes of (n, 2).
        edges: Sides of each pyramid.
        cone: As for ``build_force_problem``.
        margin: Share of the friction that is kept; above 0 it brings the excess.

    Raises:
        ContactError: ``edges`` is not usable.
    """
    dims, labels = [CONTACT_DIM[m] for m in models], names_of_contacts(fingers)
    size, n = sum(dims), len(dims)
    width = size + (n if margin else 0)
    names, face_names, cone_names = list[str](), list[str](), list[str]()
    normal = np.cumsum([0, *dims])[:-1]
    unit = np.ones(size)
    lower, upper = np.full(size, -np.inf), np.full(size, np.inf)
    faces, cones = [np.zeros((0, width))], [np.zeros((0, width))]
    of_contacts = np.frombuffer(friction).reshape(n, 2).tolist()
    for i, (at, dim) in enumerate(zip(normal, dims, strict=True)):
        names += [f"{labels[i]} {c}" for c in _COMPONENTS[:dim]]
        mu, twist = of_contacts[i]
        without = np.flatnonzero(np.array([1.0, mu, mu, twist])[:dim] == 0.0)
        lower[at + without] = upper[at + without] = 0.0
        if twist:
            unit[at + 3] = twist  # a torsion counts like the normal force that it needs
        name = f"friction of {labels[i]}"
        rows = round_cone(mu, twist) if cone == "round" else pyramid_faces(mu, twist, edges, cone)
        block = np.zeros((len(rows), width))
        block[:, at : at + dim] = rows[:, :dim]
        if margin:
            block[:, size + i] = rows[:, 0]
            block[:, at] *= 1.0 - margin
            most = np.zeros((1, width))
            most[0, size + i], most[0, at] = 1.0, -margin
        if cone == "round":
            cones.append(block)
            cone_names += [name] * min(len(rows), 1)
        else:
            faces.append(block)
            face_names += [name] * len(rows)
        if margin:
            faces.append(most)
            face_names.append(name)
    tables = np.vstack(faces), np.vstack(cones)
    for array in (normal, unit, lower, upper, *tables):
        array.flags.writeable = False
    return FrictionPart(
        names=tuple(names),
        excess_names=tuple(f"{label} excess" for label in labels) if margin else (),
        normal=normal,
        unit=unit,
        lower=lower,
        upper=upper,
        faces=tables[0],
        cones=tables[1],
        cone_sizes=tuple(len(rows) for rows in cones if len(rows)),
        face_names=tuple(face_names),
        cone_names=tuple(cone_names),
    )


def names_of_contacts(fingers: Sequence[str]) -> tuple[str, ...]:
    """A name for each contact: its finger if no other contact has it, else with its number."""
    count = Counter(fingers)
    return tuple(
        finger
        if finger and count[finger] == 1
        else f"contact {i}" + (f" ({finger})" if finger else "")
        for i, finger in enumerate(fingers)
    )


RANK_TOL = 1e-9
"""Share of a column (-) that must be outside the columns before it, else it repeats them."""

LOADED_TOL = 1e-12
"""A row of torque per force (m) below this is of a joint that no contact loads."""

CASES = 1024
"""Sets of active stops of any hand whose rows are kept (-), 30 kB each."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TorqueCase:
    """The rows while the same stops are active; nothing here depends on q.

    Attributes:
        rows: Z (nv, nv), over the length.
        made: Which column of [R^T, S^T] a row of M^+ is about (nv,), -1 on the rows of N.
        extra: Columns of [R^T, S^T] that repeat others (ne,): E.
        extra_rows: -Z E (nv, ne), over the length.
        widened: (row, stop, share): stops that take a limit off a row, along it by ``share``.
    """

    rows: FloatArray
    made: NDArray[np.int64]
    extra: NDArray[np.int64]
    extra_rows: FloatArray
    widened: tuple[tuple[int, int, float], ...]
    linear: FloatArray = field(repr=False)
    """[gap of each stop; Z (gravity - passive); offset of the limits' ends of rows and extra], all
    of them linear in (q, 1, gravity)."""
    ends: FloatArray = field(repr=False)
    """(2, nv + ne), of the laws without the offset; infinite where nothing limits."""
    least: FloatArray = field(repr=False)
    most: FloatArray = field(repr=False)
    """(2, nv + ne), what both limits are kept within."""

    @built
    def inverse(self) -> FloatArray:
        """Inverse of ``rows`` (nv, nv): the joint torques of an error in each row."""
        return np.asarray(np.linalg.inv(self.rows), dtype=np.float64)

    def over(self, length: float) -> TorqueCase:
        """The same with everything divided by a length, m."""
        if length == 1.0:
            return self
        linear = self.linear / length
        gaps = len(linear) - len(self.ends.T) - len(self.rows)
        linear[:gaps] = self.linear[:gaps]
        parts = {
            n: getattr(self, n) / length for n in ("rows", "extra_rows", "ends", "least", "most")
        }
        return replace(self, linear=linear, **parts)


class TorqueLimits:
    """Rows Z (nv, nv) and their limits; see the module.

    Attributes:
        actuation: The hand's.
        gravity: Joint torques (nv,) that hold the hand itself, N m; write them, then ``at``.
        case: The rows at the last q.
    """

    def __init__(self, actuation: Actuation, length: float) -> None:
        """For a hand, with everything divided by a length in m, so that it comes in N."""
        self.actuation, self._length = actuation, length
        nv = len(actuation.joint_names)
        self._state = np.ones(2 * nv + 1)
        self.gravity, self._q = self._state[nv + 1 :], self._state[:nv]
        self.gravity.fill(0.0)
        self._active = np.zeros(len(actuation.stop_names), dtype=np.bool_)
        self._cases: dict[bytes, TorqueCase] = {}
        self._enter(self._active.tobytes())

    def at(self, q: FloatArray, limits: FloatArray) -> TorqueCase:
        """The rows at q (nv,); writes the limits (2, nv) of Z J'f - Z E e over ``limits``.

        ``extra_limits`` are then those of e.
        """
        self._q[:] = q
        np.dot(self.case.linear, self._state, out=self._out)
        np.less_equal(self._gaps, STOP_TOL, out=self._active)
        if (key := self._active.tobytes()) != self._key:
            self._enter(key)
            np.dot(self.case.linear, self._state, out=self._out)
        case, work = self.case, self._work
        np.add(case.ends, self._offset, out=work)
        np.maximum(work, case.least, out=work)
        np.minimum(work, case.most, out=work)
        np.subtract(self._of_rows, self._shift, out=limits)
        return case

    @property
    def made_limits(self) -> FloatArray:
        """Limits (2, nv) of the actuator and stop forces that rows are about, at the last q."""
        return self._of_rows

    @property
    def extra_limits(self) -> FloatArray:
        """Limits (2, ne) of e at the last q."""
        return self._work[:, len(self._q) :]

    def shares(self, torque: FloatArray, extra: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Actuator forces (nu,) and stop forces (ns,) that make a torque at the last q, N m.

        Args:
            torque: Joint torque (nv,) with gravity, N m.
            extra: Forces e (ne,), N m.
        """
        a, case = self.actuation, self.case
        made = case.rows @ (torque - a.passive_torque(self._q)) + case.extra_rows @ extra
        forces = np.zeros(len(a.names) + len(a.stop_names) + 1)
        forces[case.made] = self._length * made  # what nothing makes ends in the last place
        forces[case.extra] = extra
        for row, stop, share in case.widened:  # a stop takes what its row's limit leaves over
            column = case.made[row]
            bound = a.force_limits(self._q)[column] if column < len(a.names) else (0.0, np.inf)
            kept = min(forces[column], bound[1]) if share > 0 else max(forces[column], bound[0])
            forces[len(a.names) + stop] += (forces[column] - kept) / share
            forces[column] = kept
        return forces[: len(a.names)], forces[len(a.names) : -1]

    def _enter(self, key: bytes) -> None:
        """Take over the rows for a set of active stops; sets once met are kept."""
        if key not in self._cases:
            self._cases[key] = _case_of(self.actuation, key).over(self._length)
        self._key, self.case = key, self._cases[key]
        nv, ns, ne = len(self._q), len(self._active), len(self.case.extra)
        self._out = np.zeros(ns + 2 * nv + ne)
        self._gaps, self._shift, self._offset = np.split(self._out, [ns, ns + nv])
        self._work = np.zeros((2, nv + ne))
        self._of_rows = self._work[:, :nv]


@made_once(CASES)
def _case_of(a: Actuation, key: bytes) -> TorqueCase:
    """The rows in N m for a set of active stops."""
    active = np.frombuffer(key, dtype=np.bool_)
    (nu, nv), ns = a.moment.shape, len(active)
    columns = np.vstack([a.moment, a.stop_rows])
    ties = np.isinf(a.stop_values)  # first, so that no limit of a joint stands in for a tie
    order = [*range(nu), *(nu + np.flatnonzero(active & ties)).tolist()]
    order += (nu + np.flatnonzero(active & ~ties)).tolist()
    tied = (columns[order] != 0).T.astype(float)
    label = connected(tied @ tied.T > 0.0)
    rows, made, extra = [np.zeros((0, nv))], list[int](), list[int]()
    widened: list[tuple[int, int, float]] = []
    for group in range(label.max(initial=-1) + 1):
        part = label == group
        chosen, others = _independent(columns, [j for j in order if columns[j][part].any()])
        block = columns[chosen][:, part].T
        null = np.linalg.svd(block)[0][:, len(chosen) :]
        out = np.zeros((len(block), nv))
        out[:, part] = np.vstack([np.linalg.pinv(block), null.T])
        for j in others:
            share = out[: len(chosen)] @ columns[j]
            along = np.flatnonzero(np.abs(share) > RANK_TOL * np.abs(share).max(initial=0.0))
            if j >= nu and len(along) == 1:
                widened.append((len(made) + int(along[0]), j - nu, float(share[along[0]])))
            else:
                extra.append(j)
        made += [*chosen, *[-1] * (len(block) - len(chosen))]
        rows.append(out)
    z, places = np.vstack(rows), [*made, *extra]
    # of actuators, stops and, last, of what nothing makes: ends of the law, least and most force
    offset = a.bias[:, 0] + a.bias[:, 1] * a.length0
    laws = np.vstack(
        [np.column_stack([a.bias[:, 1, None] * a.moment, offset]), np.zeros((ns + 1, nv + 1))]
    )[places]
    push = np.zeros((2, ns + 1))
    push[1, :ns] = np.inf
    ends = np.hstack([np.sort(a.gain[:, None] * a.ctrl_range, axis=1).T, push])[:, places]
    least = np.hstack([a.force_range[:, 0], push[0]])[places] * np.ones((2, 1))
    most = np.hstack([a.force_range[:, 1], push[1]])[places] * np.ones((2, 1))
    for row, _, share in widened:  # open on one side, whatever the law and the force range
        for table in (ends, least, most):
            table[int(share > 0), row] = np.copysign(np.inf, share)
    passive = np.column_stack([-a.stiffness, a.spring_torque])
    linear = np.zeros((ns + 2 * nv + len(extra), 2 * nv + 1))
    gaps = np.column_stack([a.stop_rows, -a.stop_values])
    linear[:, : nv + 1] = np.vstack([gaps, -z @ passive, laws])
    linear[ns : ns + nv, nv + 1 :] = z
    return TorqueCase(
        rows=z,
        made=np.array(made, dtype=np.int64),
        extra=np.array(extra, dtype=np.int64),
        extra_rows=-z @ columns[extra].T,
        widened=tuple(widened),
        linear=linear,
        ends=ends,
        least=least,
        most=most,
    )


def loaded_rows(table: FloatArray, extra: FloatArray) -> NDArray[np.bool_]:
    """Which rows (nv,) count: those that contacts load, and those that share an e with them.

    Args:
        table: Z J' in contact components (nv, n).
        extra: -Z E (nv, ne).
    """
    loaded: NDArray[np.bool_] = np.abs(table).max(axis=1, initial=0.0) >= LOADED_TOL
    if extra.size:
        shared = extra != 0.0
        while (
            grown := loaded | shared[:, shared[loaded].any(axis=0)].any(axis=1)
        ).sum() > loaded.sum():
            loaded = grown
    return loaded


def _independent(columns: FloatArray, order: list[int]) -> tuple[list[int], list[int]]:
    """Which columns (k, nv), taken in order, are independent of those before, and the others."""
    chosen, others, basis = list[int](), list[int](), list[FloatArray]()
    for j in order:
        rest = columns[j].copy()
        for b in basis * 2:  # twice, for rounding
            rest -= (b @ rest) * b
        size = np.linalg.norm(rest)
        if size > RANK_TOL * np.linalg.norm(columns[j]):
            chosen.append(j)
            basis.append(rest / size)
        else:
            others.append(j)
    return chosen, others
