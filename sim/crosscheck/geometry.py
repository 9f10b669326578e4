"""Collision geometries: coal against MuJoCo, and those of two models against each other.

``GeometryCheck`` compares distances and directions between geometries. MuJoCo places the geoms by
its own kinematics and coal by those of the bridge. MuJoCo's iterations run to 1e-12 m here, since
its default of 1e-6 m is as large as what is looked for. Apart, the two then agree to 2e-10 m for
all pairs of planes, spheres, capsules, cylinders, boxes, ellipsoids and convex hulls. In overlap
MuJoCo's own colliders of a box and a capsule, and of a cylinder and a sphere, measure a depth that
is not the shortest way out: by up to 26 mm for shapes of some cm. Its iterative pairs agree in
overlap to about 1e-6 m.

Of Pinocchio's reader the boxes are compared. Of a second MuJoCo model it is body, kind, size and
pose; a mesh, whose frame MuJoCo chooses, by the vertices of its hull.
"""

from __future__ import annotations

from copy import copy
from functools import cached_property
from itertools import combinations, permutations
from typing import Any

import coal
import mujoco
import numpy as np
from scipy.spatial import cKDTree

from planner.bridge.geometry import coal_geometry
from planner.bridge.pinocchio_model import body_name
from planner.spatial import SE3, FloatArray, pose_from_wxyz
from sim.crosscheck.mujoco_side import MujocoSide
from sim.crosscheck.parts import Observation, State, Tally
from sim.crosscheck.reader import ReaderResult, bounding_box, vertices

KINDS = ("plane", "sphere", "capsule", "cylinder", "box", "ellipsoid", "mesh")
"""Kinds of geoms that coal has too; not height fields and signed-distance geoms."""

_CCD_TOLERANCE, _CCD_ITERATIONS = 1e-12, 300
"""m; and how many steps MuJoCo may take to get there."""

_FAR = 1e3
"""Distance, m, up to which MuJoCo looks."""

_TOUCHING = 1e-6
"""Distance, m, below which a pair counts as overlapping."""

_DIRECTED = 1e-3
"""Distance, m, from which on its direction is compared."""

_COAL_TOLERANCE = 1e-10
"""Of coal's iterations, m."""


def geom_name(model: Any, geom: int) -> str:
    """Name of a geom, or the body's with its number among the body's geoms."""
    body = int(model.geom_bodyid[geom])
    order = geom - int(model.body_geomadr[body])
    return model.geom(geom).name or f"{body_name(model, body)}_geom{order}"


class Solid:
    """A geom that collides, in its body's frame.

    Attributes:
        number: Of the geom.
        name: Its own, or the body's with its number among the body's geoms.
        own_name: "" where it has none.
        kind: MuJoCo's word for it.
        body: Number of the body that carries it.
        pose: In that body's frame.
    """

    def __init__(self, model: Any, g: int) -> None:
        """The geom g of a ``mujoco.MjModel``."""
        self.number, self._model = g, model
        self.name, self.own_name = geom_name(model, g), model.geom(g).name
        self.kind = mujoco.mjtGeom(int(model.geom_type[g])).name.removeprefix("mjGEOM_").lower()
        self.body = int(model.geom_bodyid[g])
        self.pose: SE3 = pose_from_wxyz(model.geom_pos[g], model.geom_quat[g])

    @cached_property
    def geometry(self) -> Any:
        """Coal's geometry of it."""
        if self.kind == "plane":  # a plane of MuJoCo has no end and no underside
            return coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
        return coal_geometry(self._model, self.number)

    @cached_property
    def points(self) -> FloatArray:
        """Vertices (n, 3) of the hull of a mesh, m, in the body's frame."""
        found = vertices(self.geometry) if self.kind == "mesh" else None
        none = np.zeros((0, 3))
        return none if found is None else found @ self.pose.rotation.T + self.pose.translation

    @cached_property
    def size(self) -> FloatArray:
        """MuJoCo's size (3,); of a mesh its half extents, of a plane, which has no end, zero."""
        if self.kind == "mesh":
            return np.asarray(np.ptp(self.points, axis=0) / 2)
        return np.zeros(3) if self.kind == "plane" else np.array(self._model.geom_size[self.number])

    def __str__(self) -> str:
        """Kind, half extents or radius and half length (mm), and place (mm)."""
        size, place = (
            " ".join(f"{1e3 * v:.6g}" for v in values)
            for values in (self.size[self.size > 0], self.pose.translation)
        )
        return f"{self.kind} {size} mm".replace("  ", " ") + f" at ({place})"

    def errors(self, other: Solid) -> dict[str, float]:
        """Quantity -> error against another one of the same kind."""
        if self.kind == "mesh":
            ways = ((self.points, other.points), (other.points, self.points))
            return {"geometry": max(float(cKDTree(a).query(b)[0].max()) for a, b in ways)}
        apart = self.pose.translation - other.pose.translation
        size, turn = self._size_and_turn(other)
        out = {"geometry size": size, "geometry offset": float(np.abs(apart).max())}
        return out if self.kind == "sphere" else {**out, "geometry turn": turn}

    def _size_and_turn(self, other: Solid) -> tuple[float, float]:
        """Size and turn, with axes exchanged as they fit best, without the kind's symmetries."""
        orders: list[tuple[int, ...]] = [(0, 1, 2)]
        if self.kind in ("box", "ellipsoid"):
            orders = list(permutations(range(3)))
        axes = [2] if self.kind in ("capsule", "cylinder", "plane") else [0, 1, 2]
        best = []
        for order in orders:
            size = float(np.abs(self.size - other.size[list(order)]).max())
            angles = []
            for k in axes:
                u, v = self.pose.rotation[:, k], other.pose.rotation[:, order[k]]
                along = u @ v if self.kind == "plane" else abs(u @ v)
                angles.append(float(np.arctan2(np.linalg.norm(np.cross(u, v)), along)))
            best.append((round(size, 12), max(angles)))
        return min(best)


def solids(model: Any) -> list[Solid]:
    """All geoms of a ``mujoco.MjModel`` that collide, in order."""
    colliding = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    return [Solid(model, g) for g in np.flatnonzero(colliding).tolist()]


class GeometryCheck:
    """The colliding geoms of a model in both engines."""

    def __init__(self, model: Any, budget: int) -> None:
        """Build coal's geometries.

        Args:
            model: ``mujoco.MjModel``.
            budget: Pairs looked at per configuration; over the configurations all get their turn.
        """
        self._model = copy(model)
        self._model.opt.ccd_tolerance = _CCD_TOLERANCE
        self._model.opt.ccd_iterations = _CCD_ITERATIONS
        self._model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_NATIVECCD)
        self._data = mujoco.MjData(self._model)
        self._budget = budget
        colliding = solids(model)
        self.left_out = tuple(
            f"geom {solid.name} (a height field or a signed-distance geom)"
            for solid in colliding
            if solid.kind not in KINDS
        )
        weld = model.body_weldid
        self._pairs = [
            (a, b)
            for a, b in combinations([s for s in colliding if s.kind in KINDS], 2)
            if weld[a.body] != weld[b.body] and (a.kind, b.kind) != ("plane", "plane")
        ]
        self._next = 0

    def shuffle(self, generator: np.random.Generator) -> None:
        """Bring the pairs into a random order."""
        order = generator.permutation(len(self._pairs))
        self._pairs = [self._pairs[i] for i in order]

    def run(self, tally: Tally, state: State, there: Observation) -> None:
        """Compare as many pairs as the budget allows; ``there`` are the bridge's poses."""
        m, d = self._model, self._data
        d.qpos[:] = state.qpos
        mujoco.mj_kinematics(m, d)
        count = min(self._budget, len(self._pairs))
        for k in range(count):
            self._pair(tally, state, there, *self._pairs[(self._next + k) % len(self._pairs)])
        self._next += count

    def _pair(self, tally: Tally, state: State, there: Observation, a: Solid, b: Solid) -> None:
        segment = np.zeros(6)
        theirs = mujoco.mj_geomDistance(self._model, self._data, a.number, b.number, _FAR, segment)
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        request.enable_signed_distance, request.gjk_tolerance = True, _COAL_TOLERANCE
        poses = [self._placed(there, solid) for solid in (a, b)]
        ours = coal.distance(a.geometry, poses[0], b.geometry, poses[1], request, result)
        pair = f"{a.name} ({a.kind}) and {b.name} ({b.kind})"
        apart = min(ours, theirs) > _TOUCHING
        title = "distance" if apart else "distance in overlap"
        values = f"{theirs:.9g} m", f"{ours:.9g} m"
        tally.add(title, pair, abs(ours - theirs), state=state.index, values=values)
        if apart and min(ours, theirs) > _DIRECTED:
            way = segment[3:] - segment[:3]
            normal = np.array(result.normal)
            angle = float(np.arctan2(np.linalg.norm(np.cross(way, normal)), way @ normal))
            directions = way / np.linalg.norm(way), normal
            tally.add("normal", pair, angle, state=state.index, values=directions)

    def _placed(self, there: Observation, solid: Solid) -> Any:
        """Coal's pose of a solid in the world, by the poses of the bridge."""
        body = body_name(self._model, solid.body)
        pose = there.bodies.get(body, SE3.Identity()) * solid.pose  # the world has no frame
        return coal.Transform3s(pose.rotation, pose.translation)


def compare_boxes(tally: Tally, model: Any, result: ReaderResult) -> None:
    """Compare geometry by geometry: by name, and by order in the body for those without one."""
    carried: dict[str, dict[str, FloatArray | None]] = {}
    for name, box in result.boxes.items():
        carried.setdefault(result.carriers[name], {})[name] = box
    bounded: dict[str, list[Solid]] = {}
    for solid in solids(model):
        if solid.kind in KINDS and solid.kind != "plane":
            bounded.setdefault(body_name(model, solid.body), []).append(solid)
    for body, mine in bounded.items():
        boxes = carried.get(body, {})
        rest = [n for n in boxes if n not in {solid.own_name for solid in mine}]
        for solid in mine:
            key = solid.own_name if solid.own_name in boxes else rest.pop(0) if rest else None
            tally.add("geometries present", solid.name, float(key is None))
            if key is None:
                continue
            here, there = bounding_box(solid.geometry, solid.pose), boxes[key]
            if here is None or there is None:
                tally.add("geometry", solid.name, np.inf)
                continue
            error = float(np.abs(here - there).max())
            values = here[1] - here[0], there[1] - there[0]
            tally.add("geometry", solid.name, error, values=values)


def compare_geometries(tally: Tally, here: MujocoSide, there: MujocoSide) -> None:
    """Compare what collides of two models, body by body: presence, kind, size, pose.

    In a body, geoms of one name belong together, then those that are alike, then by order. What
    looks otherwise but is the same counts as equal: a box turned with its edges exchanged, an axis
    that points the other way, a mesh of other triangles with the same hull.
    """
    mine, theirs = (_colliding(side) for side in (here, there))
    for body in {**mine, **theirs}:
        if body not in there.bodies:
            continue  # the body is reported as missing
        for a, b in _paired(mine.get(body, []), theirs.get(body, [])):
            _compare_pair(tally, body, a, b)


def _colliding(side: MujocoSide) -> dict[str, list[Solid]]:
    """Body of the reference -> the solids of a model."""
    names = {number: name for name, number in side.bodies.items()}
    out: dict[str, list[Solid]] = {}
    for solid in solids(side.compiled):
        if solid.body in names:
            out.setdefault(names[solid.body], []).append(solid)
    return out


def _paired(mine: list[Solid], theirs: list[Solid]) -> list[tuple[Solid | None, Solid | None]]:
    """Which solid is which; None where one side has no more."""
    pairs: list[tuple[Solid | None, Solid | None]] = []
    named = {b.own_name: b for b in theirs if b.own_name}
    left, rest = [], list(theirs)
    for a in mine:
        if a.own_name in named:
            pairs.append((a, named[a.own_name]))
            rest.remove(named[a.own_name])
        else:
            left.append(a)
    for alike in (True, False):
        for a in list(left):
            b = next((b for b in rest if not alike or _alike(a, b)), None)
            if b is not None:
                pairs.append((a, b))
                left.remove(a)
                rest.remove(b)
    return [*pairs, *((a, None) for a in left), *((None, b) for b in rest)]


def _alike(a: Solid, b: Solid) -> bool:
    return a.kind == b.kind and max(a.errors(b).values()) < ALIKE


ALIKE = 1e-6
"""Error (m, rad) below which two solids of a body are taken for the same one."""


def _compare_pair(tally: Tally, body: str, a: Solid | None, b: Solid | None) -> None:
    name = a.name if a else f"{b.name} (not in the reference)" if b else ""
    values = tuple(f"{solid} on {body}" if solid else "none" for solid in (a, b))
    missing = a is None or b is None
    tally.add("geometries present", name, float(missing), values=(values[0], values[1]))
    if a is None or b is None:
        return
    same = a.kind == b.kind
    tally.add("geometry kind", name, float(not same), values=(str(a), str(b)))
    for quantity, error in (a.errors(b) if same else {}).items():
        tally.add(quantity, name, error, values=(str(a), str(b)))
