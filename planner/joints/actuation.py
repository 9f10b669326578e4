"""``Actuation``: joint torques that a hand's actuators and stops can make, on bare arrays.

Lengths, forces and joint torques are related by the transmission

    length = R q + length0,    F = gain ctrl + bias0 + bias1 length + bias2 R v,    tau = R^T F,

with F clipped to ``force_range`` and ctrl to ``ctrl_range``, as MuJoCo does for actuators on joints
and fixed tendons. One-sided stops S q >= s (joint limits, tendon stops) add the torque S^T lam,
lam >= 0, while they are active. A two-sided coupling is a pair of stops, one each way, that are
active everywhere.
Springs of joints and tendons add the passive torque t0 - K q. Units: rad, N m, s for hinges (m, N,
s for slides).

A transmission differs from a kinematic coupling: it says which torques exist, not which q do.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planner.errors import HandError, ModelError
from planner.spatial import FloatArray, IntArray

__all__ = ["STOP_TOL", "Actuation"]

STOP_TOL = 0.01
"""A stop is active when S q - s is at most this (rad): 0.5 mm at a fingertip 5 cm from the joint,
which is the tolerance with which a tip counts as touching."""

_ALIGNED_TOL = 1e-9
"""A stop whose share outside the range of R^T is below this (-) can do nothing that the actuators
cannot, and is left to them."""

_SPRINGS = ("stiffness", "spring_torque")

_CLIPPED_TOL = 1e-12
"""Change of an actuator force (N m) above which it counts as clipped: rounding is below."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Actuation:
    """Transmission, affine actuator laws, ranges and one-sided stops; see the module.

    Attributes:
        names: nu actuator names.
        joint_names: nv joint names, order of q.
        moment: R (nu, nv), m/rad or -.
        length0: (nu,), actuator length at q = 0.
        gain: (nu,), force per unit of ctrl, never 0.
        bias: (nu, 3), constant, per length, per velocity.
        force_range: (nu, 2), N m, infinite where unlimited.
        ctrl_range: (nu, 2), infinite where unlimited.
        stop_rows: S (ns, nv).
        stop_values: s (ns,), rad; infinite for a stop that is active everywhere.
        stop_names: ns names.
        stiffness: K (nv, nv), N m/rad; no springs if not given.
        spring_torque: t0 (nv,), N m: passive torque at q = 0.
    """

    names: tuple[str, ...]
    joint_names: tuple[str, ...]
    moment: FloatArray
    length0: FloatArray
    gain: FloatArray
    bias: FloatArray
    force_range: FloatArray
    ctrl_range: FloatArray
    stop_rows: FloatArray
    stop_values: FloatArray
    stop_names: tuple[str, ...]
    stiffness: FloatArray = field(default_factory=lambda: np.zeros(0))
    spring_torque: FloatArray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        """Check shapes, finiteness, gains and ranges; freeze the arrays."""
        nu, nv, ns = len(self.names), len(self.joint_names), len(self.stop_names)
        shapes = {
            "moment": (nu, nv),
            "length0": (nu,),
            "gain": (nu,),
            "bias": (nu, 3),
            "force_range": (nu, 2),
            "ctrl_range": (nu, 2),
            "stop_rows": (ns, nv),
            "stop_values": (ns,),
            "stiffness": (nv, nv),
            "spring_torque": (nv,),
        }
        for name, shape in shapes.items():
            value = np.array(getattr(self, name), dtype=np.float64)
            if name in _SPRINGS and value.size == 0:
                value = np.zeros(shape)
            if value.shape != shape:
                raise ModelError(
                    f"{name} has shape {value.shape}; {nu} actuators, {nv} joints and {ns} stops "
                    f"need {shape}"
                )
            may_be_infinite = name.endswith("_range") or name == "stop_values"
            bad = np.isnan(value) if may_be_infinite else ~np.isfinite(value)
            if bad.any():
                raise ModelError(f"{name} holds NaN or infinity; give finite numbers")
            value.flags.writeable = False
            object.__setattr__(self, name, value)
        for i, name in enumerate(self.names):
            if self.gain[i] == 0.0:
                raise ModelError(f"actuator {name!r} has gain 0: ctrl has no effect; give a gain")
            for what, (low, high) in (("force", self.force_range[i]), ("ctrl", self.ctrl_range[i])):
                if low > high:
                    raise ModelError(f"{what} range of actuator {name!r} is [{low}, {high}]; swap")
        for name, row in zip(self.stop_names, self.stop_rows, strict=True):
            if not row.any():
                raise ModelError(f"stop {name!r} acts on no joint; leave it out")

    def force_limits(self, q: FloatArray) -> FloatArray:
        """Least and greatest force of each actuator at rest at q: law, ctrl and force range.

        Args:
            q: Joints (nv,), rad.

        Returns:
            (nu, 2), N m; infinite where neither range limits it.

        Raises:
            HandError: q has the wrong shape or holds NaN.
        """
        still = np.zeros(len(self.joint_names))
        offset, _, _ = self._split(q, still, still)
        ends = self._tables.reach.T + offset[:, None]
        return np.clip(ends, self.force_range[:, :1], self.force_range[:, 1:])

    def torque_limits(self, q: FloatArray) -> FloatArray:
        """Least and greatest torque that the actuators of each joint make together at rest at q.

        The sum of their intervals: antagonists take one side each, and what pulls together adds up.
        An actuator that drives several joints counts in full for each.

        Args:
            q: Joints (nv,), rad.

        Returns:
            (nv, 2), N m; infinite where nothing limits an actuator, zero where none acts.

        Raises:
            HandError: q has the wrong shape or holds NaN.
        """
        limits = self.force_limits(q)
        out = np.zeros((len(self.joint_names), 2))
        for i, k in np.argwhere(self.moment):
            out[k] += np.sort(self.moment[i, k] * limits[i])
        return out

    def active_stops(self, q: FloatArray) -> NDArray[np.bool_]:
        """Which stops touch at q, (ns,): S q - s <= ``STOP_TOL``."""
        return np.asarray(self.stop_rows @ q - self.stop_values <= STOP_TOL)

    @property
    def carrying_stops(self) -> NDArray[np.int64]:
        """Stops that make torques which no actuator makes: forces there hang on their reading."""
        return self._tables.useful.copy()

    def passive_torque(self, q: FloatArray) -> FloatArray:
        """Joint torque (nv,) of the springs at q, N m."""
        return np.asarray(self.spring_torque - self.stiffness @ q)

    def split_torque(self, q: FloatArray, torque: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Actuator forces and stop multipliers for a joint torque, ranges left aside.

        What the springs make at q is taken off the torque first. With N a basis of the torques that
        no actuator makes (N R^T = 0), lam >= 0 of the active stops minimises
        |N (torque - S^T lam)|, and F = pinv(R^T) (torque - S^T lam). Together they minimise
        |R^T F + S^T lam - torque|, and stops carry only what actuators cannot.

        Args:
            q: Joints (nv,), rad.
            torque: Wanted joint torque (nv,), N m.

        Returns:
            F (nu,) and lam (ns,), N m.

        Raises:
            HandError: Wrong shape, or NaN.
        """
        _, force, lam = self._split(q, np.zeros(len(self.joint_names)), torque)
        return force, lam

    def ctrl_for_torque(
        self, q: FloatArray, v: FloatArray, torque: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Commands that produce a joint torque at (q, v), clipped to the ranges.

        Args:
            q: Joints (nv,), rad.
            v: Joint velocities (nv,), rad/s.
            torque: Wanted joint torque (nv,), N m.

        Returns:
            ctrl (nu,) and the torque (nv,) that actuators and springs then make together with the
            reaction of the active stops to what is still missing, N m.

        Raises:
            HandError: Wrong shape, or NaN.
        """
        offset, wanted, lam = self._split(q, v, torque)
        low, high, _, _ = self._tables.ranges
        ctrl = self._commands(offset, wanted)
        force = np.minimum(np.maximum(self.gain * ctrl + offset, low), high)
        achieved = self._tables.moment_t @ force + self.passive_torque(q)
        change = force - wanted
        if change @ change > _CLIPPED_TOL**2:
            missing = np.asarray(torque, dtype=np.float64) - achieved
            lam = self._reaction(self.stop_rows.T, self.active_stops(q), missing)
        return ctrl, achieved + self._tables.stops_t @ lam

    def commands(self, q: FloatArray, v: FloatArray, torque: FloatArray) -> FloatArray:
        """The commands (nu,) of ``ctrl_for_torque`` alone, in half of its time."""
        offset, wanted, _ = self._split(q, v, torque)
        return self._commands(offset, wanted)

    def short_of(self, q: FloatArray, torque: FloatArray, tolerance: float) -> NDArray[np.bool_]:
        """Which actuators' limits at rest at q are below what a joint torque takes, (nu,).

        The forces are those of ``split_torque``, the limits those of ``force_limits``.

        Args:
            q: Joints (nv,), rad.
            torque: Wanted joint torque (nv,), N m.
            tolerance: How far (N m) a force may lie beyond its limit.

        Raises:
            HandError: Wrong shape, or NaN.
        """
        offset, force, _ = self._split(q, np.zeros(len(self.joint_names)), torque)
        low, high, _, _ = self._tables.ranges
        least, greatest = self._tables.reach
        return np.asarray(
            (force > np.minimum(np.maximum(greatest + offset, low), high) + tolerance)
            | (force < np.minimum(np.maximum(least + offset, low), high) - tolerance)
        )

    def _commands(self, offset: FloatArray, wanted: FloatArray) -> FloatArray:
        """Commands (nu,) for wanted forces (nu,), clipped, with the force at ctrl = 0 (nu,)."""
        low, high, ctrl_low, ctrl_high = self._tables.ranges
        ctrl = (np.minimum(np.maximum(wanted, low), high) - offset) / self.gain
        return np.asarray(np.minimum(np.maximum(ctrl, ctrl_low), ctrl_high))

    def _split(
        self, q: FloatArray, v: FloatArray, torque: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Force (nu,) at ctrl = 0 before clipping, and F (nu,) and lam (ns,) of ``split_torque``.

        Everything that is linear in (q, v, torque) comes out of one product: this runs in every
        step of a simulation, and a call into numpy costs more than its arithmetic here.
        """
        t = self._tables
        try:
            state = np.concatenate((q, v, torque))
            fits = state.shape == t.state_shape and len(q) == len(v) == len(torque)
        except (ValueError, TypeError):  # numbers, or arrays that do not fit together
            fits = False
        if not fits:
            given = f"q {np.shape(q)}, v {np.shape(v)}, torque {np.shape(torque)}"
            shape = (len(self.joint_names),)
            raise HandError(f"shapes are {given}; give {shape} each, one number per joint")
        if not math.isfinite(state @ state):
            raise HandError("q, v or torque holds NaN or infinity; give finite numbers")
        out = t.linear @ state + t.constant
        of_offset, of_force, of_undriven, of_gaps = t.parts
        offset, force = out[of_offset], out[of_force]
        if not t.useful.size:
            return offset, force, t.no_stop
        undriven, gaps = out[of_undriven], out[of_gaps]
        lam = np.zeros(len(self.stop_names))
        if t.choices is None:
            active = np.zeros(len(lam), dtype=bool)
            active[t.useful] = gaps <= STOP_TOL
            lam = self._reaction(t.stops_undriven, active, undriven)
        else:
            gap = gaps.tolist()
            for wanted, by_sign in zip(undriven.tolist(), t.choices, strict=True):
                for k, stop, share in by_sign[wanted < 0.0]:
                    if gap[k] <= STOP_TOL:
                        lam[stop] = wanted / share
                        break
        return offset, force - t.stops_driven @ lam if lam.any() else force, lam

    def _reaction(
        self, columns: FloatArray, active: NDArray[np.bool_], wanted: FloatArray
    ) -> FloatArray:
        """Multipliers (ns,) >= 0 of active stops with ``columns @ lam`` nearest to ``wanted``.

        Columns enter by unit torque, so that of equal stops the best aligned one is taken.
        """
        from planner.system.scipy_parts import nnls  # here: SciPy loads slowly

        lam = np.zeros(len(self.stop_names))
        if active.any():
            size = np.linalg.norm(self.stop_rows[active], axis=1)
            lam[active] = nnls(columns[:, active] / size, wanted)[0] / size
        return lam

    @cached_property
    def _tables(self) -> _Tables:
        return _Tables.of(self)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Tables:
    """Quantities that ``Actuation`` computes once.

    Attributes:
        state_shape: Of (q, v, torque), one after the other.
        no_stop: (ns,), zero, not to be written.
        linear, constant: (q, v, torque) -> [force at ctrl = 0 (nu); pinv(R^T) tau (nu);
            N tau (k); gaps S q - s of the useful stops], where tau is torque less that of springs.
        parts: Where those four parts stand.
        useful: Stops that make torques which no actuator makes.
        stops_undriven: N S^T (k, ns).
        stops_driven: pinv(R^T) S^T (nu, ns).
        moment_t, stops_t: R^T (nv, nu) and S^T (nv, ns), contiguous.
        ranges: Force and ctrl ranges as four arrays (nu,): low, high, low, high.
        reach: (2, nu), least and greatest force of the ctrl range, offset left aside.
        choices: Where every useful stop acts on one row of N only, the problem falls apart into
            rows. Then for each row: the stops that help a torque >= 0 and those that help one < 0,
            best aligned first, as (place in ``useful``, stop, entry of N S^T). Else None.
    """

    state_shape: tuple[int]
    no_stop: FloatArray
    linear: FloatArray
    constant: FloatArray
    parts: tuple[slice, slice, slice, slice]
    useful: NDArray[np.int64]
    stops_undriven: FloatArray
    stops_driven: FloatArray
    moment_t: FloatArray
    stops_t: FloatArray
    ranges: tuple[FloatArray, FloatArray, FloatArray, FloatArray]
    reach: FloatArray
    choices: list[tuple[list[tuple[int, int, float]], list[tuple[int, int, float]]]] | None

    @classmethod
    def of(cls, a: Actuation) -> _Tables:
        """Compute them for an actuation."""
        nu, nv = a.moment.shape
        inverse = np.linalg.pinv(a.moment.T)  # (nu, nv)
        null = _disjoint_basis(np.eye(nv) - a.moment.T @ inverse)
        in_null = null @ a.stop_rows.T
        size = np.linalg.norm(a.stop_rows, axis=1)
        part = np.abs(in_null) > _ALIGNED_TOL * size
        useful = np.flatnonzero(part.any(axis=0))
        none = np.zeros((nu, nv))
        _, stiffness, damping = (a.bias[:, i, None] * a.moment for i in range(3))
        k, m = len(null), len(useful)
        linear = np.block(
            [
                [stiffness, damping, none],
                [inverse @ a.stiffness, none, inverse],
                [null @ a.stiffness, np.zeros((k, nv)), null],
                [a.stop_rows[useful], np.zeros((m, 2 * nv))],
            ]
        )
        offset = a.bias[:, 0] + a.bias[:, 1] * a.length0
        springs = [-inverse @ a.spring_torque, -null @ a.spring_torque]
        constant = np.concatenate([offset, *springs, -a.stop_values[useful]])
        choices = None
        if part.sum(axis=0).max(initial=0) <= 1:
            aligned = np.abs(in_null) / size
            choices = []
            for i in range(k):
                mine = [j for j in range(m) if part[i, useful[j]]]
                mine.sort(key=lambda j, i=i: -aligned[i, useful[j]])  # type: ignore[misc]
                found = [(j, int(useful[j]), float(in_null[i, useful[j]])) for j in mine]
                choices.append(([c for c in found if c[2] > 0], [c for c in found if c[2] < 0]))
        no_stop = np.zeros(len(a.stop_names))
        no_stop.flags.writeable = False
        return cls(
            state_shape=(3 * nv,),
            no_stop=no_stop,
            linear=linear,
            constant=constant,
            parts=(
                slice(nu),
                slice(nu, 2 * nu),
                slice(2 * nu, 2 * nu + k),
                slice(2 * nu + k, None),
            ),
            useful=useful,
            stops_undriven=in_null,
            stops_driven=inverse @ a.stop_rows.T,
            moment_t=np.ascontiguousarray(a.moment.T),
            stops_t=np.ascontiguousarray(a.stop_rows.T),
            ranges=(*a.force_range.T.copy(), *a.ctrl_range.T.copy()),
            reach=np.sort(a.gain[:, None] * a.ctrl_range, axis=1).T.copy(),
            choices=choices,
        )


def connected(linked: NDArray[np.bool_]) -> IntArray:
    """Number (n,) of the component of each of n things, by its first thing.

    Args:
        linked: Which two are linked (n, n), in either order.
    """
    either = linked | linked.T
    label: IntArray = np.full(len(either), -1, dtype=np.int64)
    count = 0
    for first in range(len(either)):
        if label[first] >= 0:
            continue
        reached = np.zeros(len(either), dtype=bool)
        grown = np.arange(len(either)) == first
        while (grown > reached).any():
            reached = grown
            grown = reached | either[reached].any(axis=0)
        label[reached] = count
        count += 1
    return label


def _disjoint_basis(projector: FloatArray) -> FloatArray:
    """Orthonormal rows (k, nv) that span what a projector (nv, nv) keeps.

    Joints that it does not mix do not share a row, so that a tendon over two joints has its own.
    """
    label = connected(np.abs(projector) > _ALIGNED_TOL)
    rows = [np.zeros((0, len(projector)))]
    for part in (np.flatnonzero(label == i) for i in range(label.max(initial=-1) + 1)):
        # A projector's eigenvalues are 0 and 1.
        values, vectors = np.linalg.eigh(projector[np.ix_(part, part)])
        kept = vectors[:, values > 0.5].T
        block = np.zeros((len(kept), len(projector)))
        block[:, part] = kept
        rows.append(block)
    return np.vstack(rows)
