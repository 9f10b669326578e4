"""Which disturbances a force problem can bear: its support function, with a bound on either side.

The disturbances d = B s (6,), s (k,), that forces x can balance together with the wrench of the
problem,

    S = {s : A x + [B s; 0] = b, x in bounds, every contact force in its friction cone},

are a convex set: a projection of the convex set of (x, s). Its support function at u,
h(u) = max u . s, is a linear programme where the cones are pyramids. Here the cones are the true
ones, and h is enclosed:

above   The cones are replaced by tangent half-spaces. A relaxation can only reach further.
below   The answer x of the relaxation may leave cone i by v_i. With x0 a feasible point for s = 0
        that is inside cone i by m_i, the point (1 - a) x + a x0 is inside every cone for
        a = max v_i / (v_i + m_i), since the excess |(f_t / mu, tau / mu_torsion)| - f_n is convex;
        every other constraint is convex too. So (1 - a) s is in S.

Tangents at the forces found are added until the two are as near as asked; they serve all later
directions. All statements hold up to the tolerance of ``solve_lp``, for which ``SOLVER_MARGIN`` is
given.

The smallest disturbance that breaks a grasp, as an interval that is certain to hold it.

Let S be the disturbances that the grasp can bear on top of the object's weight
(``planner.certify.breaking``): convex, with 0 inside. A disturbance of direction u breaks the grasp
beyond the radial function t(u) = max {t : t u in S}. The smallest of them, over all directions, is
the radius of the largest ball about 0 in S: 0 is inside, and a convex set holds a ball exactly if
its support function h(u) is nowhere below the radius. The search over directions is not convex, so

lower   is the largest ball in the hull of points that were found in S. Whatever is smaller is
        borne, in every direction: proven.
upper   is the least h(u) of all directions tried. h(u) u with ever so little more is outside the
        half-space of u, which holds S: it breaks the grasp. So the bound is a disturbance.

Forces act through the centre of mass without a torque; torques come without a force; a wrench is
measured by |(force, torque / length)|.

The hand answers each disturbance as well as its actuators can, in the planned posture, and the
disturbance comes slowly. So this is what the best control bears, and neither what a fixed grip does
nor what the controller of ``sim`` does. Slow loads broke that one at 0.95 of the promise and above,
20 of 22 at 0.97 and above; sudden ones from 0.3 of it on, half of them below 0.75 (``python -m
benchmarks control --parts promise -n 12``). Postures near the planned one have a bound of their
own, in ``planner.certify.nearby``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike

from planner.contacts import ContactSet, Pyramid, pyramid_faces, round_cone
from planner.errors import ContactError, shown
from planner.forces import ForceProblem
from planner.numerics.lp import NOT_KNOWN, LpSolution, Undecided, solve_lp
from planner.quality import Interval, ball_interval
from planner.spatial import FloatArray

SOLVER_MARGIN = 1e-7
"""Share of a value (-) by which bounds are set apart: a hundred times that of ``solve_lp``."""

REACH = 1e3
"""Disturbances are sought up to this many times ``ForceProblem.force_scale`` (-). A hand without
torque limits bears any; nobody needs to know more."""

SIDES = 16
"""Tangent planes per cone to begin with (-): 2 % beyond the cone at most."""

INNER_SIDES = 32
"""Sides of the inscribed pyramids in which the interior point is sought (-): 0.5 % inside."""

TIGHT = 1e-6
"""Distance (-), in force scales, up to which a cone has no room."""

ROUNDS = 20
"""Most times that tangents are added for one direction (-)."""


def without_grip(problem: ForceProblem) -> ForceProblem:
    """The same problem where no contact has to press: least normal forces are 0."""
    lower = problem.lower.copy()
    normal = np.cumsum([0, *problem.contacts.dims])[:-1]
    lower[normal] = 0.0
    return replace(problem, lower=lower)


class Resistance:
    """The set S of the module, for one basis B; friction is that of ``problem.contacts``.

    Attributes:
        reach: Bound on each coordinate of s, N: ``REACH`` times the force scale.
        held: Whether s = 0 is borne, by forces inside inscribed pyramids. None where only a part of
            the true cones outside them might do.
        programmes: Linear programmes solved so far.
    """

    def __init__(self, problem: ForceProblem, basis: FloatArray, *, gap: float) -> None:
        """Lay out the programme and find its interior point.

        Args:
            problem: Contacts, wrench and limits. Its faces are not used; the least normal forces
                that it asks for are.
            basis: B (6, k), wrench (N, N m) per unit of s.
            gap: Largest share (-) between the two sides of h that is aimed at.
        """
        self.gap = gap
        self.programmes = 0
        self.reach = REACH * problem.force_scale
        n, k = len(problem.column_names), basis.shape[1]
        self._unit = np.concatenate([problem.column_scale, np.ones(k)])
        kept = np.r_[:6, 6 + problem.n_faces : len(problem.rows)]
        below = np.zeros((len(kept) - 6, k))
        scale = problem.row_scale[kept]
        rows = np.hstack([problem.rows[kept], np.vstack([basis, below])])
        self._rows = scale[:, None] * rows * self._unit
        self._limits = np.column_stack([scale * problem.low[kept], scale * problem.high[kept]])
        self._bounds = np.column_stack(
            [
                np.concatenate([problem.lower / problem.column_scale, np.full(k, -self.reach)]),
                np.concatenate([problem.upper / problem.column_scale, np.full(k, self.reach)]),
            ]
        )
        self._cones = _cone_maps(problem.contacts, problem.column_scale, n + k)
        self._faces = self._pyramids(problem, SIDES, "circumscribed", n + k)
        self._slack = np.zeros(len(self._cones))
        self.held = self._find_interior(problem, k)

    def support(self, direction: FloatArray) -> tuple[float, FloatArray]:
        """An upper bound of h(u), and a point s (k,) of S that reaches nearly as far.

        Args:
            direction: u (k,).

        Returns:
            The bound, -inf where S is empty, and the point; 0 where the interior is empty.
        """
        cost = np.zeros(len(self._unit))
        cost[-len(direction) :] = -direction
        point = np.zeros(len(direction))
        bound = np.inf
        for _ in range(ROUNDS):
            x = self._solve(cost, self._faces, self._bounds)
            if x is NOT_KNOWN:  # S is within the bounds
                return self.reach * float(np.abs(direction).sum()), point
            if x is None:
                return -np.inf, point
            value = -float(cost @ x)
            bound = value + SOLVER_MARGIN * abs(value)
            blend = self._blend(x)
            if self.held:
                point = (1.0 - blend - SOLVER_MARGIN) * x[-len(direction) :]
            if blend <= self.gap:
                break
            self._add_tangents(x)
        return bound, point

    def _blend(self, x: FloatArray) -> float:
        """Share of the interior point that brings x (nx + k,) into every cone."""
        over = self._excess(x)
        share = over / np.where(over > 0, over + self._slack, 1.0)
        return float(share.max(initial=0.0))

    def _excess(self, x: FloatArray) -> FloatArray:
        """How far x is outside each cone (n,), N; 0 inside."""
        sizes = [np.linalg.norm(side @ x) - normal @ x for normal, side in self._cones]
        return np.asarray(np.maximum(sizes, 0.0), dtype=np.float64)

    def _add_tangents(self, x: FloatArray) -> None:
        """Half-spaces that touch the cones where the forces of x leave them."""
        fresh = []
        for (normal, side), over in zip(self._cones, self._excess(x), strict=True):
            y = side @ x
            size = np.linalg.norm(y)
            # Without a size it is rounding of f_n >= 0, and no tangent.
            if over > 0 and size > 0:
                fresh.append(y / size @ side - normal)
        self._faces = np.vstack([self._faces, *fresh])

    def _find_interior(self, problem: ForceProblem, k: int) -> bool | None:
        """Forces for s = 0 well inside the cones; sets the slack (n,) in each.

        Maximises the sum over contacts of the least distance to a side, each up to the force scale;
        where that leaves a cone without room, the least of all distances too.
        """
        inner = self._pyramids(problem, INNER_SIDES, "inscribed", len(self._unit))
        n = len(self._cones)
        total = len(self._unit)
        # Which contact a row belongs to: the one whose normal force it holds.
        owner = np.array(
            [[row @ normal != 0 for normal, _ in self._cones] for row in inner], dtype=float
        ).reshape(len(inner), n)
        bounds = np.vstack([self._bounds, np.tile([0.0, problem.force_scale], (n, 1))])
        bounds[total - k : total] = 0.0
        cost = np.concatenate([np.zeros(total), -np.ones(n)])
        x = self._solve(cost, np.hstack([inner, owner]), bounds)
        if isinstance(x, np.ndarray):
            self._slack = self._depths(x[:total])
            if n and self._slack.min() < TIGHT * problem.force_scale:
                # the sum leaves a cone without room: half way to where the least is largest
                alike = np.hstack([inner, owner.sum(axis=1, keepdims=True)])
                even = self._solve(np.append(cost[:total], -1.0), alike, bounds[: total + 1])
                if isinstance(even, np.ndarray):
                    self._slack = self._depths((x[:total] + even[:total]) / 2.0)
            return True
        still = self._bounds.copy()
        still[total - k :] = 0.0
        outer = self._solve(np.zeros(total), self._faces, still)
        return False if outer is None else None

    def _depths(self, x: FloatArray) -> FloatArray:
        """How far x (nx + k,) is inside each cone (n,), N; 0 outside."""
        inside = [normal @ x - np.linalg.norm(side @ x) for normal, side in self._cones]
        return np.asarray(np.maximum(inside, 0.0), dtype=np.float64)

    def _pyramids(self, problem: ForceProblem, sides: int, cone: Pyramid, width: int) -> FloatArray:
        """Half-spaces D (m, width) of all friction pyramids, D x <= 0 in N."""
        blocks, at = [np.zeros((0, width))], 0
        contacts = problem.contacts
        for (mu, twist), dim in zip(contacts.friction.tolist(), contacts.dims, strict=True):
            faces = pyramid_faces(mu, twist, sides, cone)
            block = np.zeros((len(faces), width))
            block[:, at : at + dim] = faces[:, :dim]
            blocks.append(block * self._unit)
            at += dim
        return np.vstack(blocks)

    def _solve(
        self, cost: FloatArray, faces: FloatArray, bounds: FloatArray
    ) -> FloatArray | Literal[Undecided.NOT_KNOWN] | None:
        """A minimiser of cost . x with faces @ x <= 0, None where there is no solution."""
        self.programmes += 1
        rows = np.zeros((len(self._rows), len(cost)))
        rows[:, : self._rows.shape[1]] = self._rows
        limits = np.vstack([self._limits, np.tile([-np.inf, 0.0], (len(faces), 1))])
        found = solve_lp(cost, np.vstack([rows, faces]), limits, bounds)
        return found.x if isinstance(found, LpSolution) else found


def _cone_maps(
    contacts: ContactSet, unit: FloatArray, width: int
) -> list[tuple[FloatArray, FloatArray]]:
    """For each contact with friction: row of f_n (width,), and rows of f_t / mu, tau / mu_torsion.

    A cone reads |side @ x| <= normal @ x.
    """
    maps, at = [], 0
    for (mu, twist), dim in zip(contacts.friction.tolist(), contacts.dims, strict=True):
        rows = round_cone(mu, twist)
        block = np.zeros((len(rows), width))
        block[:, at : at + dim] = rows[:, :dim] * unit[at : at + dim]
        if len(rows):
            maps.append((block[0], block[1:]))
        at += dim
    return maps


Disturbance: TypeAlias = Literal["force", "torque", "wrench"]

_UNITS = {"force": "N", "torque": "N m", "wrench": "N"}

QUERIES = 3
"""Directions asked for each time the hull is rebuilt (-), as many as ``ball_interval`` refines."""

ALIKE = 0.999
"""Directions with a cosine above this are asked for one at a time (-)."""

GAP_SHARE = 0.2
"""Share of the wanted width that a single support value may be uncertain by (-)."""

_AT_REACH = 1.0 - 1e-6
"""A bound above this share of the reach (-) means that no limit was found."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Breaking:
    """The smallest disturbance of one kind that breaks a grasp.

    Attributes:
        kind: "force", "torque" or "wrench".
        bounds: The size is between them, N, N m, or N with torque divided by ``length``; [0, 0]
            where not even the object's weight is held. The upper end is infinite where no limit was
            found up to the reach of the search.
        wrench: (6,), world axes, N and N m about the centre of mass: of the size of the upper
            bound, and any more along it breaks the grasp. Zero where the weight is not held; NaN
            where no limit was found.
        length: What torque is divided by, m.
        programmes: Linear programmes solved.
    """

    kind: Disturbance
    bounds: Interval
    wrench: FloatArray
    length: float
    programmes: int

    @property
    def unit(self) -> str:
        """Unit of the bounds."""
        return _UNITS[self.kind]

    def in_frame(self, rotation: FloatArray) -> FloatArray:
        """The breaking wrench (6,) in other axes; ``rotation`` (3, 3) is world from those."""
        return np.concatenate([rotation.T @ self.wrench[:3], rotation.T @ self.wrench[3:]])

    def as_dict(self) -> dict[str, Any]:
        """Plain data for JSON; None for what is infinite."""
        known = np.isfinite(self.wrench).all()
        return {
            "lower": self.bounds.lower,
            "upper": self.bounds.upper if np.isfinite(self.bounds.upper) else None,
            "unit": self.unit,
            "wrench_world_N_Nm": self.wrench.tolist() if known else None,
        }


def smallest_breaking(
    problem: ForceProblem,
    kind: Disturbance,
    *,
    length: float,
    rel_tol: float = 0.01,
    max_points: int = 120,
) -> Breaking:
    """The smallest disturbance that a force problem cannot balance on top of its wrench.

    Args:
        problem: Contacts, weight and limits. Friction is the true cones of its contacts, and no
            contact has to press, whatever its faces and its least normal forces say.
        kind: "force" at the centre of mass, "torque", or "wrench".
        length: Torque is divided by it where it is mixed with force, m.
        rel_tol: Ends when the width is below this share of the upper end (-).
        max_points: Ends when the inner hull has this many points.

    Raises:
        ContactError: ``kind`` is unknown, or ``length`` is not positive.
        PlannerError: A linear programme met numerical trouble.
    """
    if kind not in get_args(Disturbance):
        raise ContactError(f"kind is {shown(kind)}; use one of {list(get_args(Disturbance))}")
    if not (np.isfinite(length) and length > 0):
        raise ContactError(f"the characteristic length is {length}; give a positive number in m")
    basis = np.diag([1.0, 1.0, 1.0, length, length, length])
    basis = {"force": basis[:, :3], "torque": basis[:, 3:], "wrench": basis}[kind]
    oracle = Resistance(without_grip(problem), basis, gap=GAP_SHARE * rel_tol)
    search = _Search(oracle, basis.shape[1])
    unit = length if kind == "torque" else 1.0
    if oracle.held is False:
        bounds, wrench = Interval(lower=0.0, upper=0.0), np.zeros(6)
    else:
        found = search.run(rel_tol, max_points)
        bounds = Interval(lower=unit * found.lower, upper=unit * found.upper)
        wrench = found.upper * basis @ search.weakest
        if found.upper >= _AT_REACH * oracle.reach:
            bounds, wrench = Interval(lower=bounds.lower, upper=np.inf), np.full(6, np.nan)
    return Breaking(
        kind=kind, bounds=bounds, wrench=wrench, length=length, programmes=oracle.programmes
    )


def breaking_along(
    problem: ForceProblem, direction: ArrayLike, *, rel_tol: float = 1e-3
) -> Interval:
    """How much of a given wrench a force problem can balance on top of its own.

    Args:
        problem: As for ``smallest_breaking``.
        direction: (6,), N and N m, world axes about the centre of mass.
        rel_tol: Width that is aimed at, as a share of the upper end (-).

    Returns:
        Bounds of the largest factor t for which t times ``direction`` is balanced (-); [0, 0] where
        t = 0 is not.

    Raises:
        ContactError: The direction is not six finite numbers, or is zero.
    """
    along = np.asarray(direction, dtype=np.float64)
    if along.shape != (6,) or not np.isfinite(along).all() or not along.any():
        raise ContactError(
            f"direction is {shown(direction)}; give six finite numbers, not all zero"
        )
    scale = np.array([1.0, 1.0, 1.0, *np.full(3, 1 / problem.length)])
    size = float(np.linalg.norm(scale * along))
    oracle = Resistance(without_grip(problem), along[:, None] / size, gap=rel_tol)
    if oracle.held is False:
        return Interval(lower=0.0, upper=0.0)
    bound, point = oracle.support(np.ones(1))
    upper = np.inf if bound >= _AT_REACH * oracle.reach else bound / size
    return Interval(lower=min(max(float(point[0]) / size, 0.0), upper), upper=max(upper, 0.0))


class _Search:
    """Feeds ``ball_interval`` with support values, as few as it uses, and keeps the least."""

    def __init__(self, oracle: Resistance, dimension: int) -> None:
        """Nothing is asked yet."""
        self.oracle = oracle
        self.dimension = dimension
        self.least = np.inf
        self.weakest = np.zeros(dimension)

    def run(self, rel_tol: float, max_points: int) -> Interval:
        """The radius of the largest ball about the origin."""
        axes = np.eye(self.dimension)
        seeds = np.vstack([self._ask(u) for u in (*axes, *-axes)])
        if not self.oracle.held:
            return Interval(lower=0.0, upper=max(self.least, 0.0))
        found = ball_interval(self, seeds, rel_tol=rel_tol, max_points=max_points)
        upper = max(min(found.upper, self.least), 0.0)
        return Interval(lower=min(found.lower, upper), upper=upper)

    def __call__(self, directions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Support values (q,), infinite where not asked for, and points (q, 1, k).

        A linear programme is dear: only the first few directions that differ are asked for. For
        the others infinity is a true upper bound, and 0 a point.
        """
        reach = np.full(len(directions), np.inf)
        points = np.zeros((len(directions), 1, self.dimension))
        asked: list[int] = []
        for i, u in enumerate(directions):
            if len(asked) == QUERIES:
                break
            if not asked or (directions[asked] @ u).max() < ALIKE:
                asked.append(i)
                points[i, 0] = self._ask(u)
                reach[i] = self._last
        return reach, points

    def _ask(self, u: FloatArray) -> FloatArray:
        self._last, point = self.oracle.support(u)
        if self._last < self.least:
            self.least, self.weakest = self._last, u
        return point
