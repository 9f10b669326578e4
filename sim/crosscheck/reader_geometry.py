"""The collision geometries that Pinocchio's own reader finds, against MuJoCo's: their boxes."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from planner.bridge.geometry import coal_geometry
from planner.bridge.pinocchio_model import body_name
from planner.spatial import FloatArray, pose_from_wxyz
from sim.crosscheck.boxes import bounding_box
from sim.crosscheck.geometry import geom_name
from sim.crosscheck.quantities import Tally
from sim.crosscheck.reader import ReaderResult

__all__ = ["compare_boxes", "geoms_of_bodies"]

_BOUNDED = {
    int(mujoco.mjtGeom.mjGEOM_SPHERE),
    int(mujoco.mjtGeom.mjGEOM_CAPSULE),
    int(mujoco.mjtGeom.mjGEOM_CYLINDER),
    int(mujoco.mjtGeom.mjGEOM_BOX),
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID),
    int(mujoco.mjtGeom.mjGEOM_MESH),
}


def geoms_of_bodies(model: Any) -> dict[str, list[int]]:
    """Body -> numbers of its colliding geoms that have an end, in order."""
    out: dict[str, list[int]] = {}
    for g in range(model.ngeom):
        colliding = model.geom_contype[g] or model.geom_conaffinity[g]
        if colliding and int(model.geom_type[g]) in _BOUNDED:
            out.setdefault(body_name(model, int(model.geom_bodyid[g])), []).append(g)
    return out


def compare_boxes(tally: Tally, model: Any, result: ReaderResult) -> None:
    """Compare geometry by geometry: by name, and by order in the body for those without one."""
    carried: dict[str, dict[str, FloatArray | None]] = {}
    for name, box in result.boxes.items():
        carried.setdefault(result.carriers[name], {})[name] = box
    for body, geoms in geoms_of_bodies(model).items():
        boxes = dict(carried.get(body, {}))
        rest = [n for n in boxes if n not in {model.geom(g).name for g in geoms}]
        for g in geoms:
            name = geom_name(model, g)
            key = model.geom(g).name if model.geom(g).name in boxes else None
            if key is None and rest:
                key = rest.pop(0)
            tally.add("geometries present", name, float(key is None))
            if key is None:
                continue
            box = boxes[key]
            pose = pose_from_wxyz(model.geom_pos[g], model.geom_quat[g])
            mine = bounding_box(coal_geometry(model, g), pose)
            if mine is None or box is None:
                tally.add("geometry", name, np.inf)
                continue
            error = float(np.abs(mine - box).max())
            tally.add("geometry", name, error, values=(mine[1] - mine[0], box[1] - box[0]))
