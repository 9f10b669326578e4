"""Measure the limit: the best epsilon that contacts without a hand can have on a surface.

Contacts lie on the true surface, off edges as those of plans do. The search is a lower bound of the
limit; on a sphere, where the best is known, it comes within a percent (``tests/test_bench_limit``).

The support function of a grasp's wrenches is the largest of its contacts': ``h(u) = max_p h_p(u)``,
and epsilon is its least value over unit ``u``. Over some directions it is a table, points by
directions, in which the best exchange of one contact is found by looking at all points; that is an
upper bound. Qhull then gives epsilon, and the weakest directions, which join the table.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from scipy.spatial import ConvexHull, QhullError

from benchmarks.bench import ObjectsOption
from benchmarks.bench import Options as Common
from benchmarks.common import half_longest_side, objects_of
from benchmarks.summary import Cell, Frame, amount, of, summary
from benchmarks.synthesis import BASELINE_EPSILON
from planner.contacts import ContactSet
from planner.files import read_json
from planner.objects import parse_object
from planner.quality.ball import FROGGER_EDGES, epsilon_frogger
from planner.quality.closure import contact_wrenches
from planner.shapes import Mesh, Shape
from planner.spatial import FloatArray, IntArray
from planner.synthesis.mesh_surface import surface_of
from planner.tolerances import EDGE_RADIUS, EDGE_SPREAD
from sim.cli.options import MuOption
from sim.tables import Row, number

POINTS = 400
"""Surface points among which contacts are exchanged."""

STAGES = (POINTS, 20 * POINTS, 200 * POINTS)
"""Points drawn, in stages of equal time; after the first, those nearest to the best contacts
are kept."""

DIRECTIONS = 500
"""Random directions at first."""

MOST_DIRECTIONS = 3000
"""Directions from which on the table is not extended."""

CUTS = 40
"""Weakest directions that join after a hull."""

GAIN = 1.002
"""Factor by which an upper bound must exceed the best for a hull to be worth it."""


@dataclass(frozen=True, kw_only=True)
class Options(Common):
    """One search for every object."""

    n: Annotated[int, typer.Option("-n", "--number", min=2, help="Contacts.")] = 4
    objects: ObjectsOption = "sphere,box,cylinder,capsule,ellipsoid"
    mu: MuOption = 0.7
    cpu_s: Annotated[float, typer.Option("--cpu", help="CPU time per object, s.")] = 20.0
    against: Annotated[
        Path | None, typer.Option(help="Result of ``synthesis`` whose epsilon is compared.")
    ] = None


def cases(options: Options) -> Iterator[Row]:
    """The objects, each with the median of a result of ``synthesis``, if there is one."""
    ours = {}
    if options.against is not None:
        read = read_json(options.against, "a result of synthesis")
        rows = read.get("rows") or read["cells"]
        ours = {row["object"]: row["epsilon_frogger"] for row in rows if row["epsilon_frogger"]}
    for label, spec in objects_of(options.objects):
        given = ours.get(label)
        if given is not None:
            given = given["median"] if isinstance(given, dict) else float(np.median(given))
        yield {
            "object": label,
            "spec": spec,
            "contacts": options.n,
            "mu": options.mu,
            "cpu_s": options.cpu_s,
            "seed": options.seed,
            "ours": given,
        }


def measure(case: Row) -> Row:
    """The best epsilon found, FRoGGeR's definition."""
    shape = parse_object(case["spec"]).shape
    rng = np.random.default_rng(case["seed"])
    best = best_contacts(shape, case["contacts"], case["mu"], case["cpu_s"], rng)
    limit = epsilon_frogger(best, half_longest_side=half_longest_side(shape))
    return {"limit": limit, "theirs": BASELINE_EPSILON.get(case["object"])}


def tables(result: Row) -> Iterator[Row]:
    """The limit of every object, and what the others have of it."""
    rows = [row for row in result["rows"] if not row["error"]]
    setting = result["setting"]
    yield summary(
        f"best epsilon of {setting['n']} contacts off edges without a hand, mu {setting['mu']:g}, "
        "FRoGGeR's definition; medians of our grasps and FRoGGeR's, and as shares of it",
        rows,
        ("object",),
        {
            "limit": of("limit", digits=3),
            "ours": of("ours", digits=3),
            "of it, %": _share("ours"),
            "FRoGGeR": of("theirs", digits=3),
            "its, %": _share("theirs"),
        },
    )


def _share(name: str) -> Cell:
    def cell(frame: Frame) -> str:
        there = amount(frame, name)
        return number(there and there / float(frame["limit"].iloc[0]), 0, 100.0)

    return cell


def best_contacts(
    shape: Shape, n: int, mu: float, cpu_s: float, rng: np.random.Generator
) -> ContactSet:
    """The best of n contacts found in a CPU time (s), in the object's frame."""
    best, found = 0.0, None
    for drawn in STAGES:
        begin = time.process_time()
        points, normals = surface_points(shape, drawn, rng)
        chosen = rng.choice(len(points), n, replace=False)
        if found is not None:
            away = np.linalg.norm(points[:, None] - found.positions, axis=2)
            near = np.unique(np.argsort(away, axis=0)[: POINTS // n])
            points = np.concatenate([found.positions, points[near]])
            normals = np.concatenate([-found.frames[:, :, 0], normals[near]])
            chosen = np.arange(n)
        table = _Table(shape, _at(points, normals, mu), rng)
        while time.process_time() - begin < cpu_s / len(STAGES):
            chosen, bound = table.climbed(chosen)
            epsilon = table.epsilon(chosen) if bound > GAIN * best else 0.0
            if found is None or epsilon > best:
                best, found = epsilon, _at(points[chosen], normals[chosen], mu)
            if bound <= GAIN * best or len(table.reach) > MOST_DIRECTIONS:
                chosen = rng.choice(len(points), n, replace=False)
    assert found is not None
    return found


def surface_points(shape: Shape, n: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """At most n points (m, 3), m, off edges, and outward normals (m, 3)."""
    if isinstance(shape, Mesh):
        points, normals = shape.surface_samples(n, rng)
        flat = shape.normal_dispersion(points, EDGE_RADIUS, facing=normals) <= EDGE_SPREAD
        return points[flat], normals[flat]
    points, normals = shape.closest_point(rng.uniform(-1.0, 1.0, (n, 3)) * shape.half_extents)
    surface = surface_of(shape)
    patches = [surface.patch_at(shape, p, m) for p, m in zip(points, normals, strict=True)]
    inside = [
        bool(((p >= a.lower - 1e-9) & (p <= a.upper + 1e-9)).all())
        for p, a in zip(points, patches, strict=True)
    ]
    return points[inside], normals[inside]


def _at(points: FloatArray, normals: FloatArray, mu: float) -> ContactSet:
    return ContactSet.from_arrays(points, -normals, mu=mu)


class _Table:
    """How far the wrenches of every point reach along directions.

    Attributes:
        reach: (directions, points), per newton of force.
    """

    def __init__(self, shape: Shape, contacts: ContactSet, rng: np.random.Generator) -> None:
        length = half_longest_side(shape)
        wrenches = contact_wrenches(contacts, FROGGER_EDGES, length=length, unit="length")
        self._wrenches = np.array(wrenches, dtype=np.float32)  # (points, 6, edges)
        drawn = rng.normal(size=(DIRECTIONS, 6))
        self.reach = self._reach(drawn / np.linalg.norm(drawn, axis=1, keepdims=True))

    def _reach(self, directions: FloatArray) -> FloatArray:
        directions = directions.astype(np.float32)
        return np.array([(directions @ w).max(axis=1) for w in self._wrenches]).T.copy()

    def climbed(self, chosen: IntArray) -> tuple[IntArray, float]:
        """Points after exchanges of single ones that raise the bound, and that bound."""
        chosen, bound = chosen.copy(), -np.inf
        while True:
            before = bound
            for k in range(len(chosen)):
                others = self.reach[:, np.delete(chosen, k)].max(axis=1, keepdims=True)
                bounds = np.maximum(self.reach, others).min(axis=0)
                chosen[k] = int(bounds.argmax())
                bound = float(bounds[chosen[k]])
            if bound <= before + 1e-9:
                return chosen, bound

    def epsilon(self, chosen: IntArray) -> float:
        """Epsilon of points; their weakest directions join the table."""
        try:
            facets = ConvexHull(
                np.hstack(list(self._wrenches[chosen])).T.astype(float), qhull_options="QJ"
            )
        except QhullError:  # in a hyperplane
            return 0.0
        equations = facets.equations[np.argsort(-facets.equations[:, -1])]
        self.reach = np.concatenate([self.reach, self._reach(equations[:CUTS, :-1])])
        return float(-equations[0, -1])
