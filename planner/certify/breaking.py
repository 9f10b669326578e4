"""The smallest disturbance that breaks a grasp, as an interval that is certain to hold it.

Let S be the disturbances that the grasp can bear on top of the object's weight
(``planner.certify.resist``): convex, with 0 inside. A disturbance of direction u breaks the grasp
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
20 of 22 at 0.97 and above; sudden ones from 0.3 of it on, half of them below 0.75 (``opposable
bench control --parts promise -n 12``). Postures near the planned one have a bound of their own, in
``planner.certify.nearby``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike

from planner.certify.resist import Resistance, without_grip
from planner.errors import ContactError, shown
from planner.forces import ForceProblem
from planner.quality import Interval, ball_interval
from planner.spatial import FloatArray

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
