"""Friction cones as wrenches, and force closure by rank and linear programme, with a certificate.

Let the columns of W (6, m) be primitive wrenches. The **min-weight** (FRoGGeR, Li et al. 2023) is

    l* = max l  such that  W a = 0,  sum a = 1,  a >= l,

and the contacts close the grasp if and only if l* > 0 and rank W = 6. The normalised form l* m lies
in (-inf, 1]; it is -inf where W a = 0, sum a = 1 has no solution at all.

W a = 0 holds for W exactly when it holds for any basis of W's row space. The programme is solved in
an orthonormal one, P (r, m), so the answer depends on no unit, no origin of torque and no rotation,
and is as well conditioned as P:

    primal  max l      such that  P b + l P1 = 0,  1.b + m l = 1,  b >= 0,      a = b + l
    dual    min z      such that  P'y + z 1 >= 0,  y.P1 + m z = 1.

At the optimum z = l*. If l* <= 0, then y.P_j >= -l* >= 0 for every j, and not all are zero: y is
the certificate that the origin is not inside. If 1 lies in the row space of P, y = P1 gives
y.P_j = 1 for all j and l* = -inf, without a solver.

``plainly_closed`` needs no programme. Forces f with G f = 0, each strictly inside its friction
cone, and a grasp map G of rank 6 are force closure: for any wrench w some g has G g = -w, and
f + t g is inside the cones for a small t > 0, so (f + t g) / t balances w (Murray, Li, Sastry 1994,
chapter 5). Here f is given by weights a > 0 with W a = 0. Whatever they are, l* m is at least
m min(a) / sum(a). Weights are sought by a few steps that keep them positive: of the changes d with
W (a + d) = 0 the one that is least in proportion, sum (d / a)^2. Most grasps that are closed need
one to four. Where they do not suffice nothing is said, and the programme decides.

Friction cones as wrenches on the object: their edges, and their exact extremal points.

The cones are those of ``planner.contacts.friction``. Where a friction is zero, the weight that
copies of an edge would carry is carried by the one edge: only the number of columns changes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal, TypeAlias

import numpy as np

from planner.arrays import finite, float_array
from planner.contacts import ContactSet, check_contacts
from planner.contacts.friction import Pyramid, check_edges, cone_edges, cone_support
from planner.errors import ContactError, PlannerError, shown
from planner.numerics.lp import LpSolution, solve_lp
from planner.spatial import FloatArray, skew

EdgeUnit: TypeAlias = Literal["normal", "length"]

SHORTEST, LONGEST = 1e-6, 1e6
"""Range of a characteristic length, m: beyond it forces and torques drown each other."""


def contact_wrenches(
    contacts: ContactSet,
    edges: int = 8,
    *,
    cone: Pyramid = "inscribed",
    length: float = 1.0,
    phase: float = 0.0,
    unit: EdgeUnit = "normal",
) -> list[FloatArray]:
    """Primitive wrenches contact by contact: n arrays (6, m_i), see ``primitive_wrenches``."""
    check_contacts(contacts)
    check_edges(edges, cone)
    if unit not in ("normal", "length"):
        raise ContactError(f"unit is {shown(unit)}; use 'normal' or 'length'")
    cones = RoundCones.of(contacts, length)
    groups = []
    for wrench_map, (mu, _, mu_torsion) in zip(cones.maps, cones.semi_axes, strict=True):
        edge = _edges(float(mu), float(mu_torsion), edges, cone, phase, unit)
        groups.append(wrench_map @ edge)
    return groups


@lru_cache(256)
def _edges(
    mu: float, mu_torsion: float, edges: int, cone: Pyramid, phase: float, unit: EdgeUnit
) -> FloatArray:
    """Edges of a cone (4, m), the same for most contacts of a grasp and most grasps of a task."""
    edge = cone_edges(mu, mu_torsion, edges, cone=cone, phase=phase)
    if unit == "length":
        edge = edge / np.linalg.norm(edge[:3], axis=0)
    edge.flags.writeable = False
    return edge


def primitive_wrenches(
    contacts: ContactSet,
    edges: int = 8,
    *,
    cone: Pyramid = "inscribed",
    length: float = 1.0,
    phase: float = 0.0,
    unit: EdgeUnit = "normal",
) -> FloatArray:
    """Wrenches of the edges of all friction cones, one column per edge.

    Args:
        contacts: n contacts.
        edges: Number k of edges per contact in its tangent plane, at least 3.
        cone: "inscribed" or "circumscribed".
        length: Torque rows are divided by it, m.
        phase: Angle of the first edge from tangent1, rad.
        unit: "normal" gives every edge a unit normal component, "length" a force of unit length.

    Returns:
        W, (6, m), [force (-); torque about ``contacts.center`` / length (-)] per unit of force.

    Raises:
        ContactError: ``edges``, ``cone``, ``length`` or ``unit`` is not usable.
    """
    groups = contact_wrenches(contacts, edges, cone=cone, length=length, phase=phase, unit=unit)
    return np.hstack([np.zeros((6, 0)), *groups])


@dataclass(frozen=True, kw_only=True)
class RoundCones:
    """The true cones at unit normal component, as linear images of balls.

    Attributes:
        maps: (n, 6, 4), [f_n, f_t1, f_t2, tau_n] of a contact -> wrench, torque rows divided by the
            characteristic length. Columns that a contact does not transmit are zero.
        semi_axes: (n, 3), mu (-), mu (-), mu_torsion (m) as far as the contact's model has them.
    """

    maps: FloatArray
    semi_axes: FloatArray

    @classmethod
    def of(cls, contacts: ContactSet, length: float) -> RoundCones:
        """The cones of a set, torque divided by ``length`` (m).

        Raises:
            ContactError: ``length`` is not a positive number.
        """
        check_length(length)
        dims = np.array(contacts.dims, dtype=int)
        maps = np.zeros((len(contacts), 6, 4))
        # (n, 3, 3) forces; torques are arm x column; tau_n acts along the normal.
        arms = contacts.positions - contacts.center
        maps[:, :3, :3] = contacts.frames
        maps[:, 3:, :3] = skew(arms / length) @ contacts.frames
        maps[:, 3:, 3] = contacts.normals / length
        maps *= (np.arange(4) < dims[:, None])[:, None, :]
        return cls(maps=maps, semi_axes=contacts.friction[:, [0, 0, 1]])

    def extremes(self, directions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Furthest point of each cone's section along given directions.

        Args:
            directions: (q, 6).

        Returns:
            Values u . w (q, n), and the wrenches w (q, n, 6) where they are reached
            (``cone_support``).
        """
        pulled = np.swapaxes(directions @ self.maps, 0, 1)  # (q, n, 4)
        values, force = cone_support(pulled, self.semi_axes)  # (q, n), (q, n, 4)
        wrenches = np.swapaxes(force, 0, 1) @ np.swapaxes(self.maps, 1, 2)  # (n, q, 6)
        return values, np.swapaxes(wrenches, 0, 1)


def check_length(length: float) -> None:
    """Refuse a characteristic length that is not a positive number of metres.

    Raises:
        ContactError: It is not.
    """
    given = float_array("the characteristic length", length)
    if given.shape != () or not SHORTEST <= given <= LONGEST:
        raise ContactError(
            f"the characteristic length is {length}; give a positive number of metres "
            f"from {SHORTEST:g} to {LONGEST:g}, for example the radius of the object's bounding "
            "sphere about its centre of mass"
        )


RANK_TOL = 1e-6
"""Singular values of W below this share of the largest count as zero (-). A grasp of 30 mm that has
rank 6 by contacts 30 nm out of line has no closure that anyone can use."""

WEIGHT_TOL = 1e-7
"""Normalised min-weight that counts as positive must exceed this (-): a hundred times the error of
the linear programme, and far below any useful value (motions ask for
``planner.tolerances.CLOSURE_MARGIN``)."""

_NEGLIGIBLE = 1e-6
"""Components below this share of a direction are left out of the prose that describes it (-)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ClosureResult:
    """Decision about force closure of a set of primitive wrenches, with its certificate.

    Attributes:
        closed: Whether l* > 0 and rank W = 6.
        rank: Rank of W, 0 to 6.
        min_weight: l* (-), -inf where W a = 0, sum a = 1 has no solution.
        normalised_min_weight: l* times the number of primitive wrenches (-), in [-inf, 1].
        weights: (m,), a > 0 with W a = 0 and sum a = 1, internal forces in every contact; None
            where l* <= 0.
        separator: (6,), u = [m; rad] with u . w >= 0 for every primitive wrench w and not u . w = 0
            for all wrenches in space: a small motion of the object on which the contacts can only
            do work >= 0 (exactly 0 where only the rank is missing). None where closed.
        unresisted_wrench: (6,), [N; N m], a wrench on the object that no contact forces balance,
            of unit size with torque divided by the lever arm; None where closed.
        residual: Largest violation of what the certificate states, recomputed from W with torque
            divided by the lever arm (root mean square of W's torques over that of its
            forces): |W a| for weights, -min u . w for a separator (-).
        reason: The decision in words.
    """

    closed: bool
    rank: int
    min_weight: float
    normalised_min_weight: float
    weights: FloatArray | None
    separator: FloatArray | None
    unresisted_wrench: FloatArray | None
    residual: float
    reason: str

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON; units in the names, None for what is absent or infinite."""
        return {
            "closed": self.closed,
            "rank": self.rank,
            "min_weight": finite(self.min_weight),
            "normalised_min_weight": finite(self.normalised_min_weight),
            "weights": finite(self.weights),
            "separator_m_rad": finite(self.separator),
            "unresisted_wrench_n_nm": finite(self.unresisted_wrench),
            "residual": self.residual,
            "reason": self.reason,
        }


def force_closure(contacts: ContactSet, edges: int = 8, *, phase: float = 0.0) -> ClosureResult:
    """Force closure of the contacts, their cones inscribed with k edges.

    A grasp called closed is closed for the true cones too; one that is not may be closed with more
    edges. Any number of contacts is an answerable question, none included. May be called from any
    number of threads.

    Args:
        contacts: n contacts.
        edges: Edges k per cone, at least 3.
        phase: Angle of the first edge from tangent1, rad.

    Raises:
        ContactError: ``edges`` is below 3.
    """
    return closure_of_wrenches(primitive_wrenches(contacts, edges, phase=phase))


def min_weight(contacts: ContactSet, edges: int = 8, *, phase: float = 0.0) -> float:
    """Normalised min-weight of the contacts (-), in [-inf, 1]; see the module.

    Raises:
        ContactError: ``edges`` is below 3.
    """
    return force_closure(contacts, edges, phase=phase).normalised_min_weight


def closure_of_wrenches(wrenches: FloatArray) -> ClosureResult:
    """Force closure of bare primitive wrenches, whatever cones they come from.

    Args:
        wrenches: W (6, m), [force; torque about any fixed point], N and N m per unit of force.

    Raises:
        ContactError: The shape is not (6, m), or a number is not finite.
        PlannerError: The linear programme met numerical trouble.
    """
    w = np.asarray(wrenches, dtype=np.float64)
    if w.ndim != 2 or w.shape[0] != 6 or not np.isfinite(w).all():
        raise ContactError(f"wrenches have shape {w.shape}; give finite numbers of shape (6, m)")
    arm = _lever_arm(w)
    scale = np.array([1.0, 1.0, 1.0, 1 / arm, 1 / arm, 1 / arm])
    scaled = w * scale[:, None]
    u, s, vt = np.linalg.svd(scaled, full_matrices=w.shape[1] < 6)
    rank = int((s > RANK_TOL * s.max(initial=0.0)).sum())
    basis = vt[:rank]  # (r, m)
    weight, a, y = _solve(basis)
    m = w.shape[1]
    inside = weight * m > WEIGHT_TOL
    weights = a if inside else None
    direction = None
    if not inside:
        direction = u[:, :rank] @ (y / s[:rank]) if rank else np.eye(6)[0]
    elif rank < 6:
        # Only the rank is missing: any direction outside the span of W separates.
        direction = u[:, rank]
    lacking = "" if rank == 6 else _rank_reason(rank, u[:, rank:] * scale[:, None])
    return _result(scaled, scale, rank, weight, weights, direction, lacking)


def _result(
    scaled: FloatArray,
    scale: FloatArray,
    rank: int,
    weight: float,
    weights: FloatArray | None,
    direction: FloatArray | None,
    lacking: str,
) -> ClosureResult:
    """Check the certificate against W and put the decision into words."""
    separator = unresisted = None
    residual = 0.0
    reason = f"closed: rank 6, normalised min-weight {weight * scaled.shape[1]:.3g}"
    if weights is not None:
        residual = float(np.abs(scaled @ weights).max())
    if direction is not None:
        direction = direction / np.linalg.norm(direction)
        separator, unresisted = direction * scale, direction / scale
        residual = max(residual, float(-(direction @ scaled).min(initial=0.0)))
        pushed = "" if weights is not None else _separation_reason(scaled.shape[1], unresisted)
        reason = "not closed: " + "; ".join(part for part in (lacking, pushed) if part)
    return ClosureResult(
        closed=direction is None,
        rank=rank,
        min_weight=weight,
        normalised_min_weight=weight * scaled.shape[1] if scaled.shape[1] else -np.inf,
        weights=weights,
        separator=separator,
        unresisted_wrench=unresisted,
        residual=residual,
        reason=reason,
    )


def _solve(basis: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    """Min-weight l*, weights a (m,) and dual y (r,) for an orthonormal row basis P (r, m)."""
    rank, m = basis.shape
    sums = basis.sum(axis=1)
    if m == 0 or m - sums @ sums <= RANK_TOL**2 * m:
        return -np.inf, np.zeros(m), sums
    rows = np.vstack([np.column_stack([basis, sums]), np.append(np.ones(m), m)])
    target = np.append(np.zeros(rank), 1.0)
    lower = np.append(np.zeros(m), -np.inf)
    # -l is minimised, so the multipliers are minus the dual variables of the maximum
    found = solve_lp(
        np.append(np.zeros(m), -1.0),
        rows,
        np.column_stack([target, target]),
        np.column_stack([lower, np.full(m + 1, np.inf)]),
    )
    if not isinstance(found, LpSolution):
        raise PlannerError(
            "no solver decides the min-weight programme, which always has a solution; report these "
            "contacts, and try another number of edges"
        )
    weight, a = _on_rows(basis, found.x)
    return weight, a, -found.row_duals[:rank]


def _on_rows(basis: FloatArray, x: FloatArray) -> tuple[float, FloatArray]:
    """Weights (m,) put exactly on W a = 0, sum a = 1, and the least of them: that is certain."""
    a = x[:-1] + x[-1]
    a = a - basis.T @ (basis @ a)
    a = a / a.sum()
    return float(a.min()), a


def _lever_arm(w: FloatArray) -> float:
    """Torque per force over the wrenches, m: an internal scale, 1 where there is none to take."""
    force, torque = np.linalg.norm(w[:3]), np.linalg.norm(w[3:])
    return float(torque / force) if torque > 1e-12 * force and force > 0 else 1.0


def _rank_reason(rank: int, motions: FloatArray) -> str:
    """Say which motions (6, 6 - rank) [m; rad] of the object no contact force resists."""
    if rank == 0:
        return "rank 0: no contact acts on the object"
    first = _describe_motion(motions[:, 0])
    if rank == 5:
        return f"rank 5: {first}"
    return f"rank {rank}: {6 - rank} independent motions meet no force, among them {first}"


def _describe_motion(motion: FloatArray) -> str:
    """A motion [v; omega] as the force or torque that is missing along it."""
    v, omega = motion[:3], motion[3:]
    angle = np.linalg.norm(omega)
    if angle <= _NEGLIGIBLE * np.linalg.norm(v):
        return f"no force along {_vector(v / np.linalg.norm(v))}"
    axis = omega / angle
    point = np.cross(omega, v) / angle**2
    pitch = axis @ v / angle
    text = f"no torque about the axis {_vector(axis)} through {_vector(point)} m from the centre"
    if abs(pitch) > _NEGLIGIBLE * max(float(np.linalg.norm(point)), 1.0):
        text += f", with a pitch of {pitch:.3g} m/rad"
    return text


def _separation_reason(m: int, unresisted: FloatArray) -> str:
    if m == 0:
        return ""
    return (
        f"the wrench of force {_vector(unresisted[:3])} N and torque {_vector(unresisted[3:])} N m "
        "cannot be resisted"
    )


def _vector(v: FloatArray) -> str:
    return "(" + ", ".join(f"{x:.3g}" for x in np.round(v, 6) + 0.0) + ")"


PLAIN = 1e-4
"""Normalised min-weight that weights must prove (-): a thousand times what counts as positive."""

STEPS = 12
"""Most steps that weights are sought by (-)."""

BACK = 0.9
"""Share of the way to the first weight of zero that a step takes (-)."""

SOUND = 1e-10
"""Least over largest eigenvalue of W W^T that counts as rank 6 (-): a hundred times the square of
``RANK_TOL``. From below it is taken as det (5 / trace)^5 / trace."""

BALANCED = 1e-12
"""Largest entry of W a, over the sum of weights and the largest wrench (-), that is rounding."""


def plainly_closed(contacts: ContactSet, edges: int = 8) -> bool:
    """Whether weights are found that prove closure; False says nothing, ask ``force_closure``.

    Args:
        contacts: n contacts.
        edges: Edges per inscribed cone, at least 3.

    Raises:
        ContactError: ``edges`` is below 3.
    """
    return positive_weights(np.ascontiguousarray(primitive_wrenches(contacts, edges).T))


def positive_weights(w: FloatArray) -> bool:
    """Whether weights a with w^T a = 0 are found that are all positive, and w has rank 6.

    Args:
        w: Wrenches (m, 6).
    """
    force, torque = (w[:, :3] ** 2).sum(), (w[:, 3:] ** 2).sum()
    if not (force > 0.0 and torque > 0.0 and np.isfinite(force + torque)):
        return False
    p = w / np.sqrt(np.repeat([force, torque], 3) / len(w))
    largest, a = np.abs(p).max(), np.ones(len(w))
    for step in range(STEPS):
        weighted = p * (a * a)[:, None]
        scatter = p.T @ weighted
        if step == 0:
            trace = np.trace(scatter)
            if not np.linalg.det(scatter) * (5.0 / trace) ** 5 > SOUND * trace:
                return False
        if not np.linalg.det(scatter) > 0.0:
            return False
        change = -weighted @ np.linalg.solve(scatter, a @ p)
        there = a + change
        left = np.abs(there @ p).max()
        if len(w) * there.min() > PLAIN * there.sum() and left <= BALANCED * largest * there.sum():
            return True
        share = (-change / a).max()
        a = a + min(1.0, BACK / share) * change if share > 0.0 else there
        a /= a.mean()
    return False
