"""Clearances of spheres of the hand from surfaces, where they are violated: ``Clearances``.

Spheres stand for the links (``planner.synthesis.link_spheres``). Which spheres keep away from
which surface, and by how much, is said by each term (``SphereClearance``); here are those of every
problem, and what evaluates all of them. A new one is written in one file, as in
``tests/test_own_clearance.py``.

Of some hundreds of clearances few are violated at a time. CasADi computes all values and points;
derivatives are computed for the violated ones alone, from the joints' Jacobians
(``planner.synthesis.terms.hand_points``). On a mesh a sphere that was far from the object is looked
up again only when it may be near: distances change no faster than points move.

Compiled loops do the same (``planner.synthesis.loops.clearance``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from planner.errors import TaskError
from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.shapes.base import box_clearance
from planner.spatial import FloatArray, IntArray
from planner.synthesis.link_spheres import (
    SAME_POINT,
    LinkSphere,
    hull_spheres,
    link_spheres,
    margin_of,
    moving,
)
from planner.synthesis.mesh_surface import Field
from planner.synthesis.symbols import GraspSymbols, mrp_rates
from planner.synthesis.terms.hand_points import (
    HandPoints,
    Placement,
    side_by_side,
)
from planner.synthesis.terms.standard import PER_METRE
from planner.synthesis.terms.term import ActiveRows, Role, Row, RowSource, SphereClearance, Term
from planner.system.threads import built

PRESSED = 0.001
"""Depth (m) of a touching pad's sphere in the smooth distance, at most: it touches at its contact,
and in a corner must not stand in the other face. On edges and in fillets the smooth distance of a
pad that touches is up to so much below the pad's radius."""

FASTEST = 1.1
"""Largest slope (-) of a mesh's smooth distance; a little more than that of the true one."""


def _from_object(g: GraspSymbols, sphere: LinkSphere) -> tuple[Any, ...] | None:
    if g.surface.field is not None and _is_round_pad(sphere, g.fingers):
        return (sphere.radius - PRESSED,)
    margin = margin_of(sphere, g.fingers)
    if margin is None:
        return None
    if g.hand.pair and margin == "clear_tip" and not sphere.finger:
        return (sphere.radius + g.surface.distance_error,)  # a palm's other boxes, some 0.2 mm back
    return (sphere.radius + g.option[margin] + g.surface.distance_error,)


def _from_surroundings(g: GraspSymbols, sphere: LinkSphere) -> tuple[Any, ...]:
    return sphere.radius, g.option["clear_table"]


def _is_round_pad(sphere: LinkSphere, fingers: Iterable[Finger]) -> bool:
    """Whether a sphere is the surface of a touching finger's pad."""
    touching = [f for f in fingers if f.name == sphere.finger]
    return sphere.is_pad and any(abs(sphere.radius - f.pad.radius) < SAME_POINT for f in touching)


OBJECT = Term(
    name="object",
    meaning="distance of link spheres less clear_object or clear_tip; of pads beside their contact",
    role=Role.INEQUALITY,
    unit="m",
    weight=PER_METRE,
    clearance=SphereClearance(
        spheres=link_spheres,
        numbers=lambda g: [g.size],
        distance=lambda g, size, point: g.surface.clearance(size, point),
        least=_from_object,
        of_object=True,
    ),
    wording="clearance of {} from the object",
    elsewhere="palm or wrist",
    judged="penetration of the true links",
    lacking="palm or links would stand in the object; a smaller one, another pose, other fingers",
)

TABLE = Term(
    name="table",
    meaning="height of the links' hull over the table, less clear_table",
    role=Role.INEQUALITY,
    unit="m",
    weight=PER_METRE,
    clearance=SphereClearance(
        spheres=hull_spheres,
        numbers=lambda g: [ca.vertcat(*g.table)],
        distance=lambda g, plane, point: ca.dot(plane[:3], point) - plane[3],
        least=_from_surroundings,
    ),
    wording="clearance of {} from the table",
    elsewhere="palm or wrist",
    judged="penetration of the true links",
    lacking="links would stand in the table; another pose, or a stand",
)

OBSTACLE = Term(
    name="obstacle",
    meaning="distance of link spheres from each obstacle, less clear_table",
    role=Role.INEQUALITY,
    unit="m",
    weight=PER_METRE,
    clearance=SphereClearance(
        spheres=link_spheres,
        numbers=lambda g: [ca.vertcat(*map(ca.vec, box)) for box in g.boxes],
        distance=lambda g, box, point: box_clearance(
            box[12:], ca.reshape(box[:9], 3, 3) @ point + box[9:12]
        ),
        least=_from_surroundings,
    ),
    wording="clearance of {} from an obstacle",
    elsewhere="palm or wrist",
    judged="penetration of the true links",
    lacking="links would stand in an obstacle; more room around the object, another pose",
)


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceRows:
    """The rows of one term about one surface, as expressions.

    Attributes:
        term: The term.
        first: Number of the first of them among the rows of the term.
        spheres: The spheres, all that the term has (n,).
        numbers: What the surface depends on (k,).
        distance: CasADi function of numbers and a point: value, gradient. None where it is looked
            up in the field of a mesh.
        least: What the distance of each sphere's centre must be (n, 2), m, in the parts that are
            taken off it; minus infinity where it has no row.
        counts: Which spheres have a row (n,).
    """

    term: Term
    first: int
    spheres: tuple[LinkSphere, ...]
    numbers: Any
    distance: Any
    least: Any
    counts: NDArray[np.bool_]

    @property
    def rows(self) -> tuple[Row, ...]:
        """Their names."""
        about = [(b.finger,) if b.finger else () for b in self.spheres]
        return tuple(
            self.term.row(about[k], self.first + k) for k in np.flatnonzero(self.counts).tolist()
        )


def surface_rows(g: GraspSymbols, terms: Iterable[Term]) -> tuple[SurfaceRows, ...]:
    """The rows of all terms that are clearances, surface by surface.

    Args:
        g: The grasp in symbols.
        terms: Terms; others than clearances are passed over.

    Raises:
        TaskError: A distance depends on more than its numbers and the point.
    """
    out: list[SurfaceRows] = []
    sets: dict[Callable[[Hand], tuple[LinkSphere, ...]], tuple[LinkSphere, ...]] = {}
    for term in terms:
        clearance = term.clearance
        if clearance is None:
            continue
        if clearance.spheres not in sets:
            sets[clearance.spheres] = moving(g.hand, clearance.spheres(g.hand))
        spheres = sets[clearance.spheres]
        asked = [clearance.least(g, sphere) for sphere in spheres]
        parts = [((-np.inf,) if a is None else a) + (0.0,) for a in asked]
        if any(a is not None and len(a) not in (1, 2) for a in asked):
            raise TaskError(
                f"least of term {term.name!r} gives {[len(a) for a in asked if a is not None]} "
                "expressions; give one or two"
            )
        surfaces = clearance.numbers(g)
        distance = None
        if surfaces and not (clearance.of_object and g.surface.field is not None):
            distance = _distance(g, term, surfaces[0].numel())
        out += [
            SurfaceRows(
                term=term,
                first=k * len(spheres),
                spheres=spheres,
                numbers=numbers,
                distance=distance,
                least=ca.vertcat(*(ca.horzcat(*p[:2]) for p in parts)),
                counts=np.array([a is not None for a in asked]),
            )
            for k, numbers in enumerate(surfaces)
        ]
    return tuple(out)


def _distance(g: GraspSymbols, term: Term, size: int) -> Any:
    """A term's distance as CasADi function of numbers (size,) and a point: value, gradient."""
    assert term.clearance is not None
    of, at = ca.SX.sym("of", size), ca.SX.sym("at", 3)
    value = term.clearance.distance(g, of, at)
    try:
        return ca.Function("distance", [of, at], [value, ca.densify(ca.gradient(value, at))])
    except RuntimeError as error:
        raise TaskError(
            f"the distance of term {term.name!r} depends on more than its numbers and the point; "
            "give what it depends on as numbers= of its SphereClearance"
        ) from error


class Clearances(RowSource):
    """The clearances of one hand, finger set and kind of shape.

    Attributes:
        surfaces: The rows, surface by surface.
        sets: The distinct sets of spheres.
        set_of: Which set each surface's spheres are.
        first: Where the spheres of each surface begin among those of all surfaces, and the end.
    """

    def __init__(
        self, symbols: GraspSymbols, terms: Iterable[Term], surfaces: tuple[SurfaceRows, ...]
    ) -> None:
        """Write the expressions.

        Args:
            symbols: Unknowns and parameters.
            terms: The terms that are clearances.
            surfaces: Their rows.
        """
        g = self._symbols = symbols
        self.surfaces = surfaces
        self.sets = list(dict.fromkeys(s.spheres for s in surfaces))
        self.set_of = [self.sets.index(s.spheres) for s in surfaces]
        self.first = np.cumsum([0, *(len(s.spheres) for s in surfaces)])
        self._points = [
            HandPoints(g.hand, g.unknowns, [b.joint_id for b in spheres]) for spheres in self.sets
        ]
        placed = [[g.place(b.joint_id, b.center) for b in spheres] for spheres in self.sets]
        self.outputs = {
            "columns": g.symbolic.joint_columns(),
            "rotation": g.rotation.T,
        }
        for k, spheres in enumerate(self.sets):
            local = [g.symbolic.point(b.joint_id, b.center) for b in spheres]
            self.outputs[f"local{k}"] = side_by_side(local)
            self.outputs[f"placed{k}"] = side_by_side(placed[k])
        for k, s in enumerate(surfaces):
            if s.distance is not None:
                found = [s.distance(s.numbers, point) for point in placed[self.set_of[k]]]
                self.outputs[f"distances{k}"] = ca.horzcat(*[v for v, _ in found])
                self.outputs[f"slopes{k}"] = ca.horzcat(*[v for _, v in found])
        self._rows = {
            term: tuple(row for s in surfaces if s.term is term for row in s.rows) for term in terms
        }

    @property
    def rows(self) -> dict[Term, tuple[Row, ...]]:
        """See ``RowSource``."""
        return self._rows

    @property
    def expressions(self) -> dict[Term, Any]:
        """All clearances (m,) as expressions, in the order of ``rows``; None on a mesh."""
        out: dict[Term, Any] = {}
        for term in self.rows:
            parts = [
                (self.outputs[f"distances{k}"].T - s.least[:, 0] - s.least[:, 1])[
                    np.flatnonzero(s.counts).tolist()
                ]
                for k, s in enumerate(self.surfaces)
                if s.term is term and s.distance is not None and s.counts.any()
            ]
            looked_up = any(s.term is term and s.distance is None for s in self.surfaces)
            out[term] = None if looked_up else ca.vertcat(*parts)
        return out

    @built
    def _settings(self) -> Any:
        """Numbers of all surfaces and least distances of all spheres, of the parameters."""
        parameters = ca.vertcat(*self._symbols.parameters.values())
        numbers = ca.vertcat(*(s.numbers for s in self.surfaces))
        least = ca.vertcat(*(s.least for s in self.surfaces))
        return ca.Function("settings", [parameters], list(map(ca.densify, (numbers, least))))

    def settings(self, values: dict[str, FloatArray]) -> tuple[FloatArray, FloatArray]:
        """Numbers (k,) of all surfaces, and least distances (n, 2), m, of all their spheres."""
        p = np.concatenate([values[name] for name in self._symbols.parameters])
        numbers, least = self._settings(p)
        return np.array(numbers).ravel(), np.ascontiguousarray(least)

    def unknown_gaps(self) -> FloatArray:
        """Gaps (n,), m, of spheres that have not been looked up: those that count at once."""
        counts = np.concatenate([np.zeros(0, dtype=bool), *(s.counts for s in self.surfaces)])
        return np.where(counts, -np.inf, np.inf)

    def set_parameters(self, values: dict[str, FloatArray], field: Field | None) -> None:
        """See ``RowSource``."""
        self._field = field
        self._least = self.settings(values)[1]
        self._seen, self._gaps = np.full((len(self._least), 3), np.inf), self.unknown_gaps()
        root = values["root"][:9]
        self._root = root.reshape(3, 3, order="F") if len(root) else None

    def __call__(self, x: FloatArray) -> list[ActiveRows]:
        """See ``RowSource``."""
        found, out = self._found, []
        placement = Placement(
            rotation=found["rotation"],
            rates=mrp_rates(x[:3]),
            columns=found["columns"],
            root=self._root,
        )
        for k, s in enumerate(self.surfaces):
            which = self.set_of[k]
            if s.distance is None:
                gaps, bad, slopes = self._looked_up(k, found[f"placed{which}"])
            else:
                radius, margin = self._least[self.first[k] : self.first[k + 1]].T
                gaps = found[f"distances{k}"][:, 0] - radius - margin
                bad = np.flatnonzero(gaps < 0.0)
                slopes = found[f"slopes{k}"][bad]
            if len(bad):
                at = found[f"local{which}"][bad]
                rows = self._points[which].rows(placement, bad, at, slopes)
                out.append(ActiveRows(s.term, gaps[bad], rows, s.first + bad))
        return out

    def _looked_up(self, k: int, centers: FloatArray) -> tuple[FloatArray, IntArray, FloatArray]:
        """Last known gaps from surface k, numbers of the violated ones, and their gradients."""
        assert self._field is not None
        mine = slice(self.first[k], self.first[k + 1])
        gaps, seen = self._gaps[mine], self._seen[mine]
        moved = centers - seen
        moved *= moved
        near = np.flatnonzero(gaps < FASTEST * np.sqrt(moved.sum(axis=1)))
        if not len(near):
            return gaps, near, np.zeros((0, 3))
        found = self._field.taylor(centers[near], 1)
        seen[near] = centers[near]
        radius, margin = self._least[mine][near].T
        gaps[near] = found[:, 0] - radius - margin
        bad = gaps[near] < 0.0
        return gaps, near[bad], found[bad, 1:4]
