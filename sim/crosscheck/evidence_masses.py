"""Evidence of the reader's mistakes with masses, inertias and geometries (``causes.toml``).

A mistake with masses is made on purpose in a copy of the model, which MuJoCo then compiles: the
cause is named if the reader's mass is the one that comes out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeAlias

import mujoco
import numpy as np

from planner.bridge.pinocchio_model import body_name
from planner.spatial import pose_from_wxyz, skew
from sim.crosscheck.cause_context import EQUAL, ORIENTATIONS, Context
from sim.crosscheck.evidence import Evidence, Reasons, when
from sim.crosscheck.geometry import geom_name
from sim.crosscheck.quantities import Difference

_SHOWN = 1e-4
"""Up to which sizes, as they are shown with six digits, are equal (relative)."""

_MESH = int(mujoco.mjtGeom.mjGEOM_MESH)
_MASS_OF_MESH = 1.0
"""Mass, kg, and inertia, kg m2, that the reader gives to a body of mesh geoms without inertial."""


def _mesh_mass(spec: Any, c: Context) -> set[str]:
    """Every body without inertial whose mass comes from meshes gets 1 kg."""
    changed = set()
    for i, body in enumerate(spec.bodies):
        if i and not body.explicitinertial and any(int(g.type) == _MESH for g in body.geoms):
            body.explicitinertial, body.mass = True, _MASS_OF_MESH
            body.inertia, body.ipos = np.full(3, _MASS_OF_MESH), np.zeros(3)
            body.fullinertia = np.full(6, np.nan)
            changed.add(body_name(c.model, i))
    return changed


def _class_mass(spec: Any, c: Context) -> set[str]:
    """A geom whose mass comes from its class gets density times volume."""
    changed = set()
    for i, body in enumerate(spec.bodies):
        for k, geom in enumerate(body.geoms):
            element = _element(c, int(c.model.body_geomadr[i]) + k)
            if c.text is None or element is None or "mass" in element.attrib:
                continue
            if "mass" in c.text.inherited(element):
                geom.mass = np.nan
                changed.add(body_name(c.model, i))
    return changed


def _group_range(spec: Any, c: Context) -> set[str]:
    """Geoms of all groups count."""
    low, high = spec.compiler.inertiagrouprange
    if low <= 0 and high >= 5:
        return set()
    spec.compiler.inertiagrouprange = (0, 5)
    return set(c.layout.parents)


def _total_mass(spec: Any, c: Context) -> set[str]:
    """Masses stay as they are written."""
    if spec.compiler.settotalmass <= 0:
        return set()
    spec.compiler.settotalmass = -1
    return set(c.layout.parents)


_Mistake: TypeAlias = Callable[[Any, Context], set[str]]
_MISTAKES: Mapping[str, _Mistake] = {
    "mesh": _mesh_mass,
    "class": _class_mass,
    "group": _group_range,
    "total": _total_mass,
}


def _mass(d: Difference, c: Context) -> Reasons:
    """The mistakes that explain the mass of a link, one alone or all of the file together."""
    if c.source.spec is None or d.part not in c.there.links:
        return {}
    links = {b for b, root in c.layout.roots.items() if root == d.part}
    for trial in (*((name,) for name in _MISTAKES), tuple(_MISTAKES)):
        touched, masses = _twin(c, trial)
        predicted = sum(masses[b] for b in links)
        weighed = c.there.links[d.part].mass
        if touched & links and abs(predicted - weighed) <= EQUAL * predicted:
            return {name: {} for name in trial if _twin(c, (name,))[0] & links}
    return {}


def _twin(c: Context, mistakes: tuple[str, ...]) -> tuple[frozenset[str], dict[str, float]]:
    """Bodies that mistakes touch, and the masses of all bodies, kg, that come out."""
    if mistakes not in c.twins:
        spec = c.source.spec.copy()
        touched = frozenset().union(*(_MISTAKES[name](spec, c) for name in mistakes))
        model = spec.compile() if touched else c.model
        names = ["world", *c.layout.parents]
        c.twins[mistakes] = touched, {n: float(model.body_mass[i]) for i, n in enumerate(names)}
    return c.twins[mistakes]


def _not_balanced(d: Difference, c: Context) -> Reasons:
    """The inertia as it is written, impossible as it may be, is the reader's."""
    spec = c.source.spec
    if spec is None or not spec.compiler.balanceinertia or d.part not in c.there.links:
        return {}
    theirs = c.there.links[d.part]
    names = ["world", *c.layout.parents]
    total = np.zeros((3, 3))
    for name, root in c.layout.roots.items():
        if root != d.part:
            continue
        body = spec.bodies[names.index(name)]
        if not body.explicitinertial:
            continue
        full = np.array(body.fullinertia)
        tensor = np.diag(body.inertia)
        turn = pose_from_wxyz(np.zeros(3), body.iquat).rotation
        if np.isfinite(full).all():
            (xx, yy, zz, xy, xz, yz) = full
            tensor, turn = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), np.eye(3)
        local = c.pose_in(d.part, name)
        turn = local.rotation @ turn
        arm = skew(local.act(np.array(body.ipos)) - theirs.center)
        total += turn @ tensor @ turn.T - body.mass * arm @ arm
    return when(np.allclose(total, theirs.inertia, rtol=0, atol=EQUAL * np.abs(total).max()))


def _geometry(d: Difference, c: Context) -> Reasons:
    """Wrong size or place of a geometry."""
    g = next(g for g in range(c.model.ngeom) if geom_name(c.model, g) == d.part)
    element = _element(c, g)
    if c.text is None or element is None or not d.value:
        return {}
    inherited = c.text.inherited(element)
    attributes = inherited | element.attrib
    here, there = (np.array(v.strip("()").split(), dtype=float) for v in (d.reference, d.value))
    if "mesh" in attributes and attributes.get("type", "sphere") != "mesh":
        return when(there.max() < EQUAL, "fitted")
    asset = _asset(c, attributes.get("mesh"))
    if asset is not None:
        scale = c.text.inherited(asset).get("scale")
        if scale is not None and "scale" not in asset.attrib:
            factors = np.abs(np.array(scale.split(), dtype=float))
            if np.allclose(there * factors, here, rtol=_SHOWN, atol=EQUAL):
                return when(True, "scale")
        if {"refpos", "refquat"} & asset.attrib.keys():
            return when(True, "refpos")
    return when({"pos", *ORIENTATIONS} & (inherited.keys() - element.attrib.keys()), "class")


def _asset(c: Context, name: str | None) -> Any:
    """The mesh of that name as it is written; without a name it is called after its file."""
    if c.text is None or name is None:
        return None
    for mesh in c.text.root.iterfind("asset/mesh"):
        if mesh.get("name", Path(mesh.get("file", "")).stem) == name:
            return mesh
    return None


def _element(c: Context, g: int) -> Any:
    """The geom as it is written."""
    if c.text is None:
        return None
    if c.model.geom(g).name:
        return c.text.element("geom", c.model.geom(g).name)
    body = int(c.model.geom_bodyid[g])
    owner = c.text.element("body", body_name(c.model, body))
    written = [] if owner is None else owner.findall("geom")
    order = g - int(c.model.body_geomadr[body])
    return written[order] if order < len(written) else None


EVIDENCE_OF_MASSES: Mapping[str, Evidence] = {
    "mass": _mass,
    "not_balanced": _not_balanced,
    "geometry": _geometry,
}
"""By the names that ``causes.toml`` gives them."""
