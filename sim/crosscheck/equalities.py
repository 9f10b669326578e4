"""Equalities: the rows that the bridge finds against MuJoCo's own constraint Jacobian.

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

from planner.bridge import couplings_from_mujoco
from planner.bridge.pinocchio_model import body_name, site_name
from planner.errors import ModelError
from planner.spatial import SE3, FloatArray, pose_from_wxyz, pose_to_wxyz, skew
from sim.crosscheck.mujoco_side import MujocoSide
from sim.crosscheck.parts import Observation, State, Tally

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
