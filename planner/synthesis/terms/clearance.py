"""Clearances of links from object, table, obstacles and each other, where they are violated.

Spheres and capsules stand for the links (``planner.synthesis.link_spheres``, ``.link_capsules``).
Of some hundreds of clearances few are violated at a time. CasADi computes all values and points;
derivatives are computed for the violated ones alone, from the joints' Jacobians
(``planner.synthesis.terms.hand_points``). On a mesh a sphere that was far from the object is looked
up again only when it may be near: distances change no faster than points move.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from planner.hands.fingers import Finger
from planner.shapes.surface import SIZE_DIM, box_clearance
from planner.spatial import FloatArray, IntArray
from planner.synthesis.field_points import Field
from planner.synthesis.link_capsules import (
    between_segments,
    closest_on_segments,
    collision_pairs,
    finger_capsules,
    rooms_at_rest,
)
from planner.synthesis.link_spheres import (
    SAME_POINT,
    LinkSphere,
    hull_spheres,
    link_spheres,
    margin_of,
    moving,
)
from planner.synthesis.symbols import GraspSymbols
from planner.synthesis.terms.contact import PER_METRE
from planner.synthesis.terms.hand_points import HandPoints, Placement
from planner.synthesis.terms.source import ActiveRows
from planner.synthesis.terms.term import Role, Row, Term
from planner.synthesis.unknowns import mrp_rates

PRESSED = 0.001
"""Depth (m) of a touching pad's sphere in the smooth distance, at most: it touches at its contact,
and in a corner must not stand in the other face. On edges and in fillets the smooth distance of a
pad that touches is up to so much below the pad's radius."""

OBSTACLE_DIM = 15
"""Numbers of an obstacle among the parameters."""

FASTEST = 1.1
"""Largest slope (-) of a mesh's smooth distance; a little more than that of the true one."""

OBJECT = Term(
    name="object",
    meaning="distance of link spheres less clear_object or clear_tip; of pads beside their contact",
    role=Role.INEQUALITY,
    unit="m",
    weight=PER_METRE,
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
    wording="clearance of {} from an obstacle",
    elsewhere="palm or wrist",
    judged="penetration of the true links",
    lacking="links would stand in an obstacle; more room around the object, another pose",
)

FINGERS = Term(
    name="fingers",
    meaning="squared distance of link capsules less that of touching with clear_fingers between",
    role=Role.INEQUALITY,
    unit="m2",
    weight=PER_METRE / 0.03,  # two links are some 15 mm apart
    wording="clearance between {}",
    judged="penetration of the true links",
    lacking="the fingers stand in each other's way; fewer fingers, or a larger object",
)


class Clearances:
    """The clearances of one hand, finger set and kind of shape: a ``RowSource``.

    Attributes:
        outputs, rows: See ``RowSource``.
        spheres: Spheres that avoid object and obstacles.
        radii: Theirs (n,), m.
        hull: Spheres that avoid the table.
        pairs: Capsules of ``finger_capsules`` that avoid each other (n_pairs, 2).
    """

    def __init__(self, symbols: GraspSymbols) -> None:
        """Write the expressions.

        Args:
            symbols: Unknowns and parameters.
        """
        g, hand = symbols, symbols.hand
        self._symbols, self._hand, self._surface = g, hand, g.surface
        self._size = g.unknowns.size
        self.spheres = moving(hand, link_spheres(hand))
        self.hull = moving(hand, hull_spheres(hand))
        capsules = finger_capsules(hand)
        self._on_spheres = HandPoints(hand, g.unknowns, [b.joint_id for b in self.spheres])
        self._on_hull = HandPoints(hand, g.unknowns, [b.joint_id for b in self.hull])
        self._on_capsules = HandPoints(hand, g.unknowns, [b.joint_id for b in capsules])
        self.pairs = np.array(collision_pairs(hand), dtype=np.int64).reshape(-1, 2)
        self.radii = np.array([b.radius for b in self.spheres])
        touching = [f.name for f in g.fingers]
        self._avoids, self._on_tip = _avoiding(self.spheres, touching)
        self._presses = np.zeros(len(self.spheres), dtype=bool)
        if g.surface.field is not None:
            self._presses = np.array([_is_round_pad(b, g.fingers) for b in self.spheres])
        self._avoids |= self._presses
        centers = [g.place(b.joint_id, b.center) for b in self.spheres]
        values, slopes = ca.SX(1, 0), ca.SX(3, 0)
        if g.surface.field is None:
            values, slopes = _distances(centers, clearance_of(g.surface.clearance), g.size)
        boxes = [
            _distances(centers, box_clearance_of(), ca.vertcat(*map(ca.vec, box)))
            for box in g.boxes
        ]
        point, normal, offset = g.symbolic.point, *g.table
        ends = [(point(c.joint_id, c.inner), point(c.joint_id, c.outer)) for c in capsules]
        heights = [
            ca.dot(normal, g.place(b.joint_id, b.center))
            - offset
            - b.radius
            - g.option["clear_table"]
            for b in self.hull
        ]
        self.outputs: dict[str, Any] = {
            "centers": _columns(centers),
            "spheres": _columns([point(b.joint_id, b.center) for b in self.spheres]),
            "hull": _columns([point(b.joint_id, b.center) for b in self.hull]),
            "inner": _columns([inner for inner, _ in ends]),
            "outer": _columns([outer for _, outer in ends]),
            "distances": values,
            "slopes": slopes,
            "obstacle_distances": ca.vertcat(*[v for v, _ in boxes]),
            "obstacle_slopes": ca.horzcat(*[s for _, s in boxes]),
            "heights": ca.horzcat(*heights),
            "rooms": ca.horzcat(*_between_fingers(g)),
            "columns": g.symbolic.joint_columns(),
            "rotation": g.rotation.T,
        }
        self.rows: Mapping[Term, tuple[Row, ...]] = self._named()

    def _named(self) -> dict[Term, tuple[Row, ...]]:
        """Names of all rows; spheres that need not avoid the object have none."""
        sphere = [(b.finger,) if b.finger else () for b in self.spheres]
        hull = [(b.finger,) if b.finger else () for b in self.hull]
        capsule = [c.finger for c in finger_capsules(self._hand)]
        about: dict[Term, list[tuple[int, tuple[str, ...]]]] = {
            OBJECT: [(k, sphere[k]) for k in np.flatnonzero(self._avoids).tolist()],
            TABLE: list(enumerate(hull)),
            OBSTACLE: list(enumerate(sphere * len(self._symbols.boxes))),
            FINGERS: [
                (k, (capsule[i], capsule[j])) for k, (i, j) in enumerate(self.pairs.tolist())
            ],
        }
        return {term: tuple(term.row(a, k) for k, a in rows) for term, rows in about.items()}

    @property
    def expressions(self) -> dict[Term, Any]:
        """All clearances (m,) as expressions, in the order of ``rows``; None on a mesh."""
        g = self._symbols
        by_sphere = self.outputs["distances"].T
        if g.surface.field is None:
            margin = [g.option["clear_tip" if tip else "clear_object"] for tip in self._on_tip]
            by_sphere -= ca.vertcat(*margin) + self.radii + self._surface.distance_error
        around = self.outputs["obstacle_distances"].T
        around = [around[:, k] - self.radii - g.option["clear_table"] for k in range(len(g.boxes))]
        which = np.flatnonzero(self._avoids).tolist()
        return {
            OBJECT: by_sphere[which] if g.surface.field is None and which else None,
            TABLE: self.outputs["heights"].T,
            OBSTACLE: ca.vertcat(*around),
            FINGERS: self.outputs["rooms"].T,
        }

    def clone(self) -> Clearances:
        """The same with parameters and results of its own."""
        return copy(self)

    def receive(self, results: dict[str, FloatArray]) -> None:
        """See ``RowSource``."""
        self._found = results

    def set_parameters(self, values: dict[str, FloatArray], field: Field | None) -> None:
        """See ``RowSource``."""
        self._values, self._field = values, field
        self._reach = self.reach(values)
        self._seen = np.full((len(self._reach), 3), np.inf)
        self._gaps = self.unknown_gaps()
        root = values["root"][:9]
        self._root = root.reshape(3, 3, order="F") if len(root) else None

    def reach(self, values: dict[str, FloatArray]) -> FloatArray:
        """What the distance of each sphere's centre from the object must be (n,), m.

        Minus infinity where it need not be any. ``values`` are parameters by name.
        """
        margin = np.where(self._on_tip, values["clear_tip"][0], values["clear_object"][0])
        out: FloatArray = self.radii + margin + self._surface.distance_error
        out[self._presses] = self.radii[self._presses] - PRESSED
        out[~self._avoids] = -np.inf
        return out

    def unknown_gaps(self) -> FloatArray:
        """Clearances (n,), m, of spheres that have not been looked up: those that count at once."""
        return np.where(self._avoids, -np.inf, np.inf)

    def heights(self, values: dict[str, FloatArray]) -> FloatArray:
        """What the height of each hull sphere along the table's normal must be (n_hull,), m."""
        least = float(values["table"][3] + values["clear_table"][0])
        return np.array([b.radius for b in self.hull]) + least

    def squared_distances(self, values: dict[str, FloatArray]) -> FloatArray:
        """What the squared distance of each pair of capsules must be (n_pairs,), m2."""
        radii = np.array([c.radius for c in finger_capsules(self._hand)])
        rooms, clear = rooms_at_rest(self._hand), float(values["clear_fingers"][0])
        least = np.maximum(radii[self.pairs].sum(axis=1) + np.minimum(clear, rooms), 0.0)
        out: FloatArray = least**2
        return out

    def __call__(self, x: FloatArray) -> list[ActiveRows]:
        """See ``RowSource``."""
        found = self._found
        self._placement = Placement(
            rotation=found["rotation"],
            rates=mrp_rates(x[:3]),
            columns=found["columns"],
            root=self._root,
        )
        return [*self._object(), *self._table(), *self._obstacles(), *self._fingers()]

    def _object(self) -> list[ActiveRows]:
        if self._surface.field is None:
            gaps = self._found["distances"][:, 0] - self._reach
            bad = np.flatnonzero(gaps < 0.0)
            slopes = self._found["slopes"][bad]
        else:
            gaps, bad, slopes = self._looked_up()
        if not len(bad):
            return []
        rows = self._on_spheres.rows(self._placement, bad, self._found["spheres"][bad], slopes)
        return [ActiveRows(OBJECT, gaps[bad], rows, bad)]

    def _looked_up(self) -> tuple[FloatArray, IntArray, FloatArray]:
        """Last known gaps of all spheres, numbers of the violated ones, and their gradients."""
        centers = self._found["centers"]
        moved = centers - self._seen
        moved *= moved
        near = np.flatnonzero(self._gaps < FASTEST * np.sqrt(moved.sum(axis=1)))
        if not len(near):
            return self._gaps, near, np.zeros((0, 3))
        assert self._field is not None
        found = self._field.taylor(centers[near], 1)
        self._seen[near] = centers[near]
        self._gaps[near] = found[:, 0] - self._reach[near]
        bad = self._gaps[near] < 0.0
        return self._gaps, near[bad], found[bad, 1:4]

    def _table(self) -> list[ActiveRows]:
        heights = self._found["heights"][:, 0]
        bad = np.flatnonzero(heights < 0.0)
        if not len(bad):
            return []
        normals = np.tile(self._values["table"][:3], (len(bad), 1))
        rows = self._on_hull.rows(self._placement, bad, self._found["hull"][bad], normals)
        return [ActiveRows(TABLE, heights[bad], rows, bad)]

    def _obstacles(self) -> list[ActiveRows]:
        n = len(self.radii)
        slopes = self._found["obstacle_slopes"]
        parts = []
        for k, gaps in enumerate(self._found["obstacle_distances"].T):
            room = gaps - self.radii - self._values["clear_table"][0]
            bad = np.flatnonzero(room < 0.0)
            if len(bad):
                at = self._found["spheres"][bad]
                rows = self._on_spheres.rows(self._placement, bad, at, slopes[k * n + bad])
                parts.append(ActiveRows(OBSTACLE, room[bad], rows, k * n + bad))
        return parts

    def _fingers(self) -> list[ActiveRows]:
        rooms = self._found["rooms"][:, 0]
        bad = np.flatnonzero(rooms < 0.0)
        if not len(bad):
            return []
        first, second = self.pairs[bad].T
        inner, outer = self._found["inner"], self._found["outer"]
        end, foot = closest_on_segments(inner[first], outer[first], inner[second], outer[second])
        twice = 2.0 * (end - foot)
        rates = self._on_capsules.joint_rows(self._placement, first, end, twice)
        rates -= self._on_capsules.joint_rows(self._placement, second, foot, twice)
        rows = np.zeros((len(bad), self._size))
        self._symbols.unknowns.q(rows.T)[:] = rates.T
        return [ActiveRows(FINGERS, rooms[bad], rows, bad)]


def _avoiding(
    spheres: tuple[LinkSphere, ...], touching: list[str]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which spheres must stay away from the object, and which of them are beside a pad."""
    margins = [margin_of(b, touching) for b in spheres]
    return np.array([m is not None for m in margins]), np.array([m == "clear_tip" for m in margins])


def _is_round_pad(sphere: LinkSphere, fingers: Sequence[Finger]) -> bool:
    """Whether a sphere is the surface of a touching finger's pad."""
    touching = [f for f in fingers if f.name == sphere.finger]
    return sphere.is_pad and any(abs(sphere.radius - f.pad.radius) < SAME_POINT for f in touching)


def _between_fingers(g: GraspSymbols) -> list[Any]:
    """Squared distance of capsules of different fingers, less the least allowed (m2)."""
    capsules = finger_capsules(g.hand)
    ends = [(g.place(c.joint_id, c.inner), g.place(c.joint_id, c.outer)) for c in capsules]
    corners = [ca.SX.sym(name, 3) for name in ("p1", "q1", "p2", "q2")]
    way = ca.Function("way", corners, [between_segments(*corners)])  # written once: 1 ms each
    out = []
    clear = g.option["clear_fingers"]
    for (i, j), room in zip(collision_pairs(g.hand), rooms_at_rest(g.hand), strict=True):
        apart = way(*ends[i], *ends[j])
        asked = ca.fmin(clear, float(room))
        least = ca.fmax(capsules[i].radius + capsules[j].radius + asked, 0.0)
        out.append(ca.sumsqr(apart) - least**2)
    return out


def clearance_of(clearance: Callable[[Any, Any], Any], numbers: int = SIZE_DIM) -> Any:
    """A clearance as CasADi function of numbers (``numbers``,) and a point: value, gradient."""
    of, at = ca.SX.sym("of", numbers), ca.SX.sym("at", 3)
    value = clearance(of, at)
    return ca.Function("clearance", [of, at], [value, ca.densify(ca.gradient(value, at))])


def box_clearance_of() -> Any:
    """Clearance from an obstacle; its numbers (15,) are those of ``obstacles_in_object``."""

    def clearance(box: Any, point: Any) -> Any:
        return box_clearance(box[12:], ca.reshape(box[:9], 3, 3) @ point + box[9:12])

    return clearance_of(clearance, OBSTACLE_DIM)


def _distances(points: list[Any], clearance: Any, size: Any) -> tuple[Any, Any]:
    """Distances (1, n) and gradients (3, n) of a clearance at points."""
    found = [clearance(size, p) for p in points]
    return ca.horzcat(*[v for v, _ in found]), ca.horzcat(*[g for _, g in found])


def _columns(points: list[Any]) -> Any:
    return ca.horzcat(*points) if points else ca.SX(3, 0)
