"""Two sides of a cross-check, quantity by quantity.

Local facts (the pose of a body relative to its parent, a joint's axis in its own body) are read off
the motion of each side where the model stands as it is drawn. They name the part that is at fault;
poses, forces and the mass matrix then differ everywhere behind it.

Of equalities the rows that the bridge finds are held against MuJoCo's own constraint Jacobian.
Joint and tendon equalities are the couplings of ``planner.bridge``. A ``connect`` or ``weld`` has
no constant row; its row is built here from the Jacobians of Pinocchio's frames:

    connect   p1 - p2, Jacobian J_p1 - J_p2;
    weld      the same, and half of conj(q2) (w1 - w2) q1, the vector part times torquescale, where
              q1 is body 1's quaternion times the relative one, q2 body 2's, w the angular
              velocities as pure quaternions (MuJoCo documentation, "Equality").
"""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin

from planner.bridge import couplings_from_mujoco
from planner.bridge.pinocchio_model import body_name, site_name
from planner.errors import ModelError
from planner.spatial import SE3, FloatArray, pose_from_wxyz, pose_to_wxyz, skew
from sim.crosscheck.mujoco_side import MujocoSide
from sim.crosscheck.parts import (
    HINGE,
    SLIDE,
    BoolArray,
    Layout,
    LinkInertia,
    Observation,
    Parts,
    State,
    Tally,
)

_HUGE = 1e15
"""Limit, in any unit, beyond which a number stands for "none" (largest float and the like)."""

_ROUNDING = 1e-14
"""Share of the largest force at hand that rounding may take, where forces cancel."""

_GRAVITY = 10.0
"""Size of gravity, m/s2, in what forces are at hand."""


_PARAMETERS = {
    "joint range": "range",
    "armature": "armature",
    "damping": "damping",
    "dry friction": "friction",
    "effort limit": "effort",
    "velocity limit": "velocity",
}
"""Quantity -> attribute of ``JointFacts``; None where a side does not tell it."""


def compare_parts(tally: Tally, layout: Layout, here: Parts, there: Parts) -> None:
    """Names, kinds, limits of all sorts, armature, damping, friction, masses and inertias."""
    for slot in layout.joints:
        tally.add("joints present", slot.name, float(slot.name not in there.joints))
    for body in layout.parents:
        tally.add("bodies present", body, float(body not in there.bodies))
    for site in layout.sites:
        tally.add("sites present", site, float(site not in there.sites))
    for name in there.others:
        kind, _, part = name.partition(" ")
        title = {"joint": "joints", "body": "bodies", "site": "sites"}[kind] + " present"
        tally.add(title, f"{part} (not in the reference)", 1.0)
    for name, theirs in there.joints.items():
        mine = here.joints[name]
        kinds = mine.kind, theirs.kind
        tally.add("joint kind", name, float(kinds[0] != kinds[1]), values=kinds)
        if kinds[0] != kinds[1]:
            continue
        for title, which in _PARAMETERS.items():
            values = getattr(mine, which), getattr(theirs, which)
            if values[0] is not None and values[1] is not None:
                _relative(tally, title, name, *values)
    _apart(tally, "gravity", "the model", here.gravity, there.gravity)
    alone = bool(here.inertias and there.inertias)
    mine_all, theirs_all = (here.inertias, there.inertias) if alone else (here.links, there.links)
    for body in layout.parents:
        if body in there.bodies and (body in mine_all or body in theirs_all):
            _inertia(tally, body, mine_all.get(body), theirs_all.get(body))


def _inertia(tally: Tally, body: str, mine: LinkInertia | None, theirs: LinkInertia | None) -> None:
    masses = (0.0 if mine is None else mine.mass), (0.0 if theirs is None else theirs.mass)
    _relative(tally, "mass", body, np.array(masses[:1]), np.array(masses[1:]))
    if mine is None or theirs is None:
        return
    if min(masses) > 0:
        _apart(tally, "link centre", body, mine.center, theirs.center)
    scale = float(np.abs(mine.inertia).max()) or 1.0
    error = float(np.abs(mine.inertia - theirs.inertia).max()) / scale
    tally.add("inertia", body, error, values=(_six(mine.inertia), _six(theirs.inertia)))


def _six(inertia: FloatArray) -> FloatArray:
    """Moments xx, yy, zz, then products xy, xz, yz, of an inertia (3, 3), kg m2."""
    return np.concatenate([np.diag(inertia), inertia[np.triu_indices(3, 1)]])


def _apart(
    tally: Tally, title: str, part: str, mine: FloatArray, theirs: FloatArray, state: int = -1
) -> None:
    """Largest difference of two vectors."""
    error = float(np.abs(mine - theirs).max())
    tally.add(title, part, error, state=state, values=(mine, theirs))


def _relative(tally: Tally, title: str, part: str, mine: FloatArray, theirs: FloatArray) -> None:
    """Error relative to the reference's own size; infinities must stand at the same places."""
    mine, theirs = (np.where(np.abs(v) > _HUGE, np.copysign(np.inf, v), v) for v in (mine, theirs))
    same = mine == theirs  # infinities too
    error = 0.0
    if not same.all():
        a, b = mine[~same], theirs[~same]
        finite = np.isfinite(a) & np.isfinite(b)
        size = np.abs(mine[np.isfinite(mine)]).max(initial=0.0)
        size = size or np.abs(theirs[np.isfinite(theirs)]).max(initial=0.0)
        error = float(np.abs(a - b).max() / size) if finite.all() and size > 0 else np.inf
    tally.add(title, part, error, values=(mine, theirs))


def compare_local(tally: Tally, layout: Layout, here: Observation, there: Observation) -> None:
    """Offsets of bodies and sites, axes and anchors of joints; both as drawn."""
    for body in there.bodies:
        local = [local_pose(layout, there, o, body) for o in (here, there)]
        _pose(tally, ("body offset", "body turn"), body, local[0], local[1], -1)
    for site in there.sites:
        local = [local_pose(layout, there, o, site, site=True) for o in (here, there)]
        _pose(tally, ("site offset", "site turn"), site, local[0], local[1], -1)
    for slot in layout.joints:
        if slot.kind not in (HINGE, SLIDE) or slot.body not in there.bodies:
            continue
        screws = [_screw(o, slot.body, slot.v.start) for o in (here, there)]
        if not screws[1].any():  # the joint is not there
            continue
        part = screws[0][3:], screws[1][3:]
        if slot.kind == SLIDE:
            part = screws[0][:3], screws[1][:3]
        angle = _angle(*part)
        tally.add("joint axis", slot.name, angle, values=part)
        if slot.kind == HINGE:
            # the point of each axis that is nearest to the body's origin: w x v
            points = [np.cross(s[3:], s[:3]) for s in screws]
            error = float(np.linalg.norm(points[0] - points[1])) if angle < _PARALLEL else 0.0
            tally.add("joint anchor", slot.name, error, values=(points[0], points[1]))


_PARALLEL = 1e-6
"""Angle, rad, above which only the axis is blamed and not the point that it passes through."""


def compare_observations(
    tally: Tally,
    layout: Layout,
    moving: BoolArray,
    mass: float,
    state: State,
    here: Observation,
    there: Observation,
) -> None:
    """Poses, Jacobians, centres of mass and smooth dynamics at one configuration.

    Args:
        tally: Takes the results.
        layout: The reference's.
        moving: (nv,) booleans: degrees of freedom that both have.
        mass: Of the whole model, kg.
        state: The configuration.
        here: The reference's values.
        there: The other side's.
    """
    i = state.index
    for body, pose in there.bodies.items():
        _pose(tally, ("body position", "body orientation"), body, here.bodies[body], pose, i)
    for site, pose in there.sites.items():
        _pose(tally, ("site position", "site orientation"), site, here.sites[site], pose, i)
    for title, mine, theirs in (
        ("body Jacobian", here.body_jacobians, there.body_jacobians),
        ("site Jacobian", here.site_jacobians, there.site_jacobians),
    ):
        for name, jacobian in theirs.items():
            error = np.abs(mine[name] - jacobian)[:, moving].max(initial=0.0)
            tally.add(title, name, float(error), state=i)
    for body, center in there.centers.items():
        if body in here.centers:
            error = float(np.abs(here.centers[body] - center).max())
            tally.add("centre of mass", body, error, state=i)
    if not moving.any():
        return
    on = np.flatnonzero(moving)
    block = np.ix_(on, on)
    diagonal = np.sqrt(np.diag(here.mass_matrix)[on])
    # forces m g l of a mass m whose inertia m l^2 is on the diagonal
    forces = np.sqrt(mass) * float(diagonal.max()) * (_GRAVITY + float((state.qvel**2).max()))
    scaled = np.abs(here.mass_matrix - there.mass_matrix)[block] / np.outer(diagonal, diagonal)
    for k, error in zip(on, scaled.max(axis=1), strict=True):
        tally.add("mass matrix", layout.dof_name(int(k)), float(error), state=i)
    for title, a, b in (
        ("Coriolis force", here.coriolis, there.coriolis),
        ("gravity force", here.gravity, there.gravity),
        ("forward dynamics", here.acceleration, there.acceleration),
    ):
        errors = np.abs(a - b)[on]
        if title != "forward dynamics":
            errors[errors < _ROUNDING * forces] = 0.0
        scale = float(np.abs(a[on]).max()) or 1.0
        for k, error in zip(on, errors / scale, strict=True):
            tally.add(title, layout.dof_name(int(k)), float(error), state=i)


def _pose(
    tally: Tally, titles: tuple[str, str], part: str, mine: SE3, theirs: SE3, state: int
) -> None:
    _apart(tally, titles[0], part, mine.translation, theirs.translation, state)
    turn = mine.rotation.T @ theirs.rotation
    # exact for small angles too, unlike the arc cosine of the trace
    sine = np.linalg.norm(turn - turn.T) / np.sqrt(8)
    angle = float(np.arctan2(sine, (np.trace(turn) - 1) / 2))
    values = pin.log3(mine.rotation), pin.log3(theirs.rotation)
    tally.add(titles[1], part, angle, state=state, values=values)


def local_pose(
    layout: Layout,
    common: Observation,
    observation: Observation,
    part: str,
    *,
    site: bool = False,
) -> SE3:
    """Pose of a body or site in its parent's frame; an ancestor's where ``common`` lacks that."""
    above = layout.sites if site else layout.parents
    pose = (observation.sites if site else observation.bodies)[part]
    parent = above[part]
    while parent in layout.parents and parent not in common.bodies:
        parent = layout.parents[parent]
    return observation.bodies[parent].actInv(pose) if parent in common.bodies else pose


def _screw(observation: Observation, body: str, dof: int) -> FloatArray:
    """Velocity (6,) of a body by one of its joints, in its own frame."""
    column = observation.body_jacobians[body][:, dof]
    turn = observation.bodies[body].rotation.T
    return np.concatenate([turn @ column[:3], turn @ column[3:]])


def _angle(a: FloatArray, b: FloatArray) -> float:
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


_CONNECT, _WELD = int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD)
_SITE = int(mujoco.mjtObj.mjOBJ_SITE)
_EQUALITY = int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)


class EqualityCheck:
    """The active equalities of a model."""

    def __init__(self, model: Any) -> None:
        """Find each equality's row, or the reason why it has none."""
        self._model = copy(model)
        self._model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
        self._model.opt.disableflags = int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        self._model.opt.enableflags = 0
        self._data = mujoco.MjData(self._model)
        self._loops = [
            int(e)
            for e in np.flatnonzero(model.eq_active0)
            if int(model.eq_type[e]) in (_CONNECT, _WELD)
        ]
        self._rows, self.left_out = constant_rows(model)

    def run(self, tally: Tally, state: State, there: Observation) -> None:
        """Compare rows at a configuration; ``there`` are the bridge's poses and Jacobians."""
        m, d = self._model, self._data
        mujoco.mj_resetData(m, d)
        d.qpos[:] = state.qpos
        mujoco.mj_forward(m, d)
        jacobian = np.asarray(d.efc_J).reshape(int(d.nefc), m.nv)
        equal = np.asarray(d.efc_type) == _EQUALITY
        number, position = np.asarray(d.efc_id), np.asarray(d.efc_pos)
        q = _scalar_positions(m, state.qpos)
        for e in [*self._rows, *self._loops]:
            mine = equal & (number == e)
            if e in self._rows:
                row, value = self._rows[e]
                rows, residual = row[None, :], np.array([row @ q - value])
            else:
                rows, residual = self._loop(e, there)
            error = np.inf
            if e in self._loops and (jacobian[mine][3:] * rows[3:]).sum() < 0:
                rows[3:], residual[3:] = -rows[3:], -residual[3:]  # q and -q are one rotation
            if len(rows) == int(mine.sum()):
                scale = np.abs(jacobian[mine]).max(initial=0.0) or 1.0
                error = np.abs(jacobian[mine] - rows).max(initial=0.0) / scale
                error = max(error, float(np.abs(position[mine] - residual).max(initial=0.0)))
            tally.add("equality rows", equality_name(m, e), float(error), state=state.index)

    def _loop(self, e: int, there: Observation) -> tuple[FloatArray, FloatArray]:
        """Rows (3 or 6, nv) and residual of a connect or weld."""
        m, data = self._model, self._model.eq_data[e]
        weld = int(m.eq_type[e]) == _WELD
        parts = [int(m.eq_obj1id[e]), int(m.eq_obj2id[e])]
        sites = int(m.eq_objtype[e]) == _SITE
        frames = [self._frame(there, part, site=sites) for part in parts]
        anchors = [np.zeros(3), np.zeros(3)]
        relative = np.array([1.0, 0.0, 0.0, 0.0])
        if not sites:
            # a weld keeps the point on body 2 first, a connect that on body 1
            anchors = [data[3:6], data[0:3]] if weld else [data[0:3], data[3:6]]
            relative = data[6:10] if weld else relative
        points = [pose.act(a) for (pose, _), a in zip(frames, anchors, strict=True)]
        jacobians = [
            j[:3] - skew(p - pose.translation) @ j[3:]
            for (pose, j), p in zip(frames, points, strict=True)
        ]
        rows, residual = jacobians[0] - jacobians[1], points[0] - points[1]
        if not weld:
            return rows, residual
        turned = frames[0][0] * pose_from_wxyz(np.zeros(3), relative)
        q1, q2 = pose_to_wxyz(turned)[1], pose_to_wxyz(frames[1][0])[1]
        back = q2 * [1, -1, -1, -1]
        spin = frames[0][1][3:] - frames[1][1][3:]
        turning = [_times(_times(back, np.array([0.0, *w])), q1)[1:] / 2 for w in spin.T]
        scale = float(data[10])
        error = _times(back, q1)[1:]
        return (
            np.vstack([rows, scale * np.array(turning).T]),
            np.concatenate([residual, scale * error]),
        )

    def _frame(self, there: Observation, part: int, *, site: bool) -> tuple[SE3, FloatArray]:
        """Pose and Jacobian (6, nv) of a site or a body; the world stands still."""
        if site:
            name = site_name(self._model, part)
            return there.sites[name], there.site_jacobians[name]
        if part == 0:
            return SE3.Identity(), np.zeros((6, self._model.nv))
        name = body_name(self._model, part)
        return there.bodies[name], there.body_jacobians[name]


def equality_name(model: Any, equality: int) -> str:
    """Name of an equality, or its number."""
    return model.equality(equality).name or f"equality{equality}"


def equality_names(model: Any) -> tuple[str, ...]:
    """Names of the active equalities."""
    return tuple(equality_name(model, int(e)) for e in np.flatnonzero(model.eq_active0))


def constant_rows(model: Any) -> tuple[dict[int, tuple[FloatArray, float]], tuple[str, ...]]:
    """Active equality of joints or tendons -> row (nv,) and value; and why others have none."""
    rows: dict[int, tuple[FloatArray, float]] = {}
    left_out = []
    for e in np.flatnonzero(model.eq_active0):
        if int(model.eq_type[e]) in (_CONNECT, _WELD):
            continue
        alone = copy(model)
        alone.eq_active0[:] = np.arange(model.neq) == e
        try:
            (coupling,) = couplings_from_mujoco(alone)
        except ModelError as error:
            left_out.append(f"{equality_name(model, int(e))}: {error}")
        else:
            rows[int(e)] = coupling.row, coupling.value
    return rows, tuple(left_out)


def compare_couplings(tally: Tally, here: MujocoSide, there: MujocoSide) -> None:
    """Equalities of two MuJoCo models, by name; rows in the order of the reference's joints."""
    mine, theirs = (dict(_named(side)) for side in (here, there))
    for name in [*mine, *(n for n in theirs if n not in mine)]:
        if name not in mine or name not in theirs:
            tally.add("equality rows", name, np.inf)
        elif mine[name].shape == theirs[name].shape and mine[name].size:
            scale = float(np.abs(mine[name]).max()) or 1.0
            error = float(np.abs(mine[name] - theirs[name]).max()) / scale
            tally.add("equality rows", name, error, values=(mine[name], theirs[name]))


def _named(side: MujocoSide) -> Iterator[tuple[str, FloatArray]]:
    """Name, and row and value (nv + 1,) of an equality; empty where it has no constant row."""
    rows, _ = constant_rows(side.compiled)
    for e in np.flatnonzero(side.compiled.eq_active0):
        value = np.zeros(0)
        if int(e) in rows:
            row, target = rows[int(e)]
            value = np.array([*side.in_order(row), target])
        yield equality_name(side.compiled, int(e)), value


def _scalar_positions(model: Any, qpos: FloatArray) -> FloatArray:
    """Positions (nv,) of hinges and slides at their degree of freedom; zero elsewhere."""
    out = np.zeros(model.nv)
    for j in range(model.njnt):
        if int(model.jnt_type[j]) in (
            int(mujoco.mjtJoint.mjJNT_HINGE),
            int(mujoco.mjtJoint.mjJNT_SLIDE),
        ):
            out[int(model.jnt_dofadr[j])] = qpos[int(model.jnt_qposadr[j])]
    return out


def _times(a: FloatArray, b: FloatArray) -> FloatArray:
    """Product of quaternions w, x, y, z."""
    return np.array(
        [a[0] * b[0] - a[1:] @ b[1:], *(a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:]))]
    )
