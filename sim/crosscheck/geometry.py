"""coal against MuJoCo: distance and direction between geometries, at poses from each engine.

MuJoCo places the geoms by its own kinematics and coal by those of the bridge. MuJoCo's iterations
run to 1e-12 m here, since its default of 1e-6 m is as large as what is looked for. Apart, the two
then agree to 2e-10 m for all pairs of planes, spheres, capsules, cylinders, boxes, ellipsoids and
convex hulls. In overlap MuJoCo's own colliders of a box and a capsule, and of a cylinder and a
sphere, measure a depth that is not the shortest way out: by up to 26 mm for shapes of some cm. Its
iterative pairs agree in overlap to about 1e-6 m.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import coal
import mujoco
import numpy as np

from planner.bridge.geometry import coal_geometry
from planner.bridge.pinocchio_model import body_name
from planner.spatial import SE3, pose_from_wxyz
from sim.crosscheck.parts import Observation, State
from sim.crosscheck.quantities import Tally

_KINDS = {
    int(mujoco.mjtGeom.mjGEOM_PLANE): "plane",
    int(mujoco.mjtGeom.mjGEOM_SPHERE): "sphere",
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): "capsule",
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): "cylinder",
    int(mujoco.mjtGeom.mjGEOM_BOX): "box",
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID): "ellipsoid",
    int(mujoco.mjtGeom.mjGEOM_MESH): "mesh",
}
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


@dataclass(frozen=True, kw_only=True)
class _Geom:
    number: int
    name: str
    kind: str
    body: str
    T_body_geom: SE3
    geometry: Any


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
        colliding = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
        numbers = np.flatnonzero(colliding)
        known = [g for g in numbers if int(model.geom_type[g]) in _KINDS]
        self.left_out = tuple(
            f"geom {geom_name(model, int(g))} (a height field or a signed-distance geom)"
            for g in numbers
            if int(model.geom_type[g]) not in _KINDS
        )
        geoms = [_geom(model, int(g)) for g in known]
        weld = model.body_weldid[model.geom_bodyid]
        self._pairs = [
            (a, b)
            for a, b in combinations(geoms, 2)
            if weld[a.number] != weld[b.number] and (a.kind, b.kind) != ("plane", "plane")
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

    def _pair(self, tally: Tally, state: State, there: Observation, a: _Geom, b: _Geom) -> None:
        segment = np.zeros(6)
        theirs = mujoco.mj_geomDistance(self._model, self._data, a.number, b.number, _FAR, segment)
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        request.enable_signed_distance, request.gjk_tolerance = True, _COAL_TOLERANCE
        poses = [_transform(_world(there, s) * s.T_body_geom) for s in (a, b)]
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


def geom_name(model: Any, geom: int) -> str:
    """Name of a geom, or the body's with its number among the body's geoms."""
    body = int(model.geom_bodyid[geom])
    order = geom - int(model.body_geomadr[body])
    return model.geom(geom).name or f"{body_name(model, body)}_geom{order}"


def _geom(model: Any, g: int) -> _Geom:
    kind = _KINDS[int(model.geom_type[g])]
    # a plane of MuJoCo has no end and no underside
    half_space = coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
    return _Geom(
        number=g,
        name=geom_name(model, g),
        kind=kind,
        body=body_name(model, int(model.geom_bodyid[g])),
        T_body_geom=pose_from_wxyz(model.geom_pos[g], model.geom_quat[g]),
        geometry=half_space if kind == "plane" else coal_geometry(model, g),
    )


def _world(there: Observation, geom: _Geom) -> SE3:
    return there.bodies.get(geom.body, SE3.Identity())  # the world itself has no frame


def _transform(pose: SE3) -> Any:
    return coal.Transform3s(pose.rotation, pose.translation)
