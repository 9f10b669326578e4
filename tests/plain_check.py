"""``doubts``: a second opinion on a plan that shares no code with the verdict.

Kinematics are MuJoCo's, distances are by formula (primitives) or from every triangle (meshes),
inside and outside by solid angles, closure and forces by linear programmes. It is slow and coarse:
links are sampled, and torque limits and the way in are not looked at.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np
from scipy.optimize import linprog

from planner.plan import GraspPlan
from planner.shapes import Mesh, Shape
from planner.spatial import FloatArray
from planner.task import GraspTask

TOUCH, DEEP = 5.5e-4, 2e-4
"""Gap (m) of a pad that still touches, sampling included; depth (m) of a sample that penetrates."""

EDGES = 16
"""Edges of the friction pyramid in the force programme."""

FEW_EDGES = 8
"""The same for closure."""


def doubts(plan: GraspPlan) -> list[str]:
    """What speaks against a plan; empty if nothing does."""
    task = plan.task
    turn, shift, data = _placed(plan)
    model = task.hand.mj_model
    said, points, normals = [], [], []
    pads = {finger.pad.geom for finger in task.fingers}
    for finger in task.fingers:
        geom = model.geom(finger.pad.geom).id
        axis = _segment(model, geom)
        at = _in_object(axis, data, geom, turn, shift)
        distances, nearest = nearest_on(task.object.shape, at)
        k = int(np.argmin(distances))
        gap = distances[k] - model.geom_size[geom, 0]
        if abs(gap) > TOUCH:
            said.append(f"{finger.name} is {1e3 * gap:.2f} mm off")
        points.append(nearest[k])
        normals.append((nearest[k] - at[k]) / max(distances[k], 1e-12))
    said += _penetrations(plan, turn, shift, data, pads)
    inward, where = np.array(normals), np.array(points)
    length = float(np.linalg.norm(where, axis=1).max())
    if not closes(where, inward, task.mu, length):
        said.append("the contacts do not close")
    pull = task.T_world_object.rotation.T @ (task.object.mass * task.gravity)
    if not bears(where, inward, task.mu, pull, task.grip_force, length):
        said.append("no forces within friction bear the weight")
    limits = np.maximum(task.hand.q_lower - plan.q, plan.q - task.hand.q_upper)
    if limits.max() > 1e-6:
        said.append("a joint is beyond its limit")
    return said


def _placed(plan: GraspPlan) -> tuple[FloatArray, FloatArray, Any]:
    """MuJoCo's kinematics at the grasp, and from its world into the object's frame."""
    hand = plan.task.hand
    model, data = hand.mj_model, mujoco.MjData(hand.mj_model)
    for name, value in zip(hand.joint_names, plan.q, strict=True):
        data.qpos[model.jnt_qposadr[model.joint(name).id]] = value
    mujoco.mj_kinematics(model, data)
    base = model.body(hand.description.base_body).id
    R_model_base, p_model_base = data.xmat[base].reshape(3, 3), data.xpos[base]
    R_world_object = plan.task.T_world_object.rotation
    R = R_world_object.T @ plan.T_world_base.rotation
    p = R_world_object.T @ (plan.T_world_base.translation - plan.task.T_world_object.translation)
    turn = R @ R_model_base.T
    return turn, p - turn @ p_model_base, data


def _in_object(
    local: FloatArray, data: Any, geom: int, turn: FloatArray, shift: FloatArray
) -> FloatArray:
    """Points (n, 3) of a geometry in the object's frame."""
    in_model = local @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
    moved: FloatArray = in_model @ turn.T + shift
    return moved


def _segment(model: Any, geom: int) -> FloatArray:
    """Points (n, 3) on the axis of a sphere or capsule, in its frame."""
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_SPHERE:
        return np.zeros((1, 3))
    return _along(model.geom_size[geom, 1], 41)


def _along(half: float, n: int) -> FloatArray:
    """Points (n, 3) on the z axis from -half to half."""
    points = np.zeros((n, 3))
    points[:, 2] = np.linspace(-half, half, n)
    return points


def _penetrations(
    plan: GraspPlan, turn: FloatArray, shift: FloatArray, data: Any, pads: set[str]
) -> Iterator[str]:
    """Links that are in the object or below the table, by samples of their surfaces."""
    task, model = plan.task, plan.task.hand.mj_model
    up, height = _table(task)
    for geometry in task.hand.geometries:
        geom = model.geom(geometry.name).id
        samples = _in_object(_samples(model, geom), data, geom, turn, shift)
        if geometry.name not in pads:
            depth = -float(signed_distance(task.object.shape, samples).min())
            if depth > DEEP:
                yield f"{geometry.name} is {1e3 * depth:.2f} mm in the object"
        below = -float((samples @ up - height).min())
        if below > DEEP:
            yield f"{geometry.name} is {1e3 * below:.2f} mm below the table"


def _table(task: GraspTask) -> tuple[FloatArray, float]:
    """Direction up in the object's frame, and the table's height along it; -inf without one."""
    up = task.T_world_object.rotation[2]
    if task.table_height is None:
        return up, -np.inf
    return up, task.table_height - float(task.T_world_object.translation[2])


def _samples(model: Any, geom: int) -> FloatArray:
    """Points (n, 3) on the surface of a sphere, capsule, cylinder or box, in its frame."""
    size, kind = model.geom_size[geom], model.geom_type[geom]
    k = np.arange(80) + 0.5
    polar, around = np.arccos(1 - k / 40), np.pi * (1 + 5**0.5) * k
    sphere = np.column_stack(
        [np.cos(around) * np.sin(polar), np.sin(around) * np.sin(polar), np.cos(polar)]
    )
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return np.asarray(size[0] * sphere)
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return np.asarray((size[0] * sphere + _along(size[1], 9)[:, None]).reshape(-1, 3))
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
        ring = size[0] * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
        return np.asarray((ring + _along(size[1], 9)[:, None]).reshape(-1, 3))
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 9)] * 3, indexing="ij"), -1).reshape(-1, 3)
    return np.asarray(grid[np.abs(grid).max(axis=1) == 1.0] * size)


def signed_distance(shape: Shape, points: FloatArray) -> FloatArray:
    """Distances (n,) of points (n, 3), m, negative inside; of meshes, only points inside count."""
    if not isinstance(shape, Mesh):
        distances = nearest_on(shape, points)[0]
        return np.where(_inside(shape, points), -distances, distances)
    distances = np.full(len(points), np.inf)
    lower, upper = shape.vertices.min(axis=0), shape.vertices.max(axis=0)
    near = np.flatnonzero(((points > lower) & (points < upper)).all(axis=1))
    if len(near):
        inside = near[_winding(shape.vertices[shape.faces], points[near]) > 0.5]
        if len(inside):
            distances[inside] = -nearest_on(shape, points[inside])[0]
    return distances


def _inside(shape: Any, points: FloatArray) -> Any:
    x, y, z = np.abs(points.T)
    half = shape.half_extents
    if shape.kind == "box":
        return (x < half[0]) & (y < half[1]) & (z < half[2])
    if shape.kind == "cylinder":
        return (np.hypot(x, y) < half[0]) & (z < half[2])
    if shape.kind == "capsule":
        straight = half[2] - half[0]
        return np.sqrt(x**2 + y**2 + np.maximum(z - straight, 0) ** 2) < half[0]
    return ((points / half) ** 2).sum(axis=1) < 1.0


def nearest_on(shape: Any, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distances (n,) of points (n, 3) from the surface, m, and the nearest points (n, 3) on it."""
    if isinstance(shape, Mesh):
        return _nearest_triangle(shape.vertices[shape.faces], points)
    half = shape.half_extents
    if shape.kind == "box":
        near = _on_box(half, points)
    elif shape.kind == "cylinder":
        radius = np.maximum(np.hypot(points[:, 0], points[:, 1]), 1e-12)
        flat = _on_box(np.array([half[0], 1.0, half[2]]), _profile(radius, points[:, 2]))
        around = points[:, :2] / radius[:, None]
        near = np.column_stack([around * flat[:, :1], flat[:, 2]])
    elif shape.kind == "capsule":
        axis = np.zeros_like(points)
        axis[:, 2] = np.clip(points[:, 2], half[0] - half[2], half[2] - half[0])
        away = points - axis
        near = axis + half[0] * away / np.linalg.norm(away, axis=1, keepdims=True)
    else:
        near = _on_ellipsoid(half, points)
    return np.linalg.norm(points - near, axis=1), near


def _profile(radius: FloatArray, z: FloatArray) -> FloatArray:
    return np.column_stack([radius, 0 * radius, z])


def _on_box(half: FloatArray, points: FloatArray) -> FloatArray:
    near = np.clip(points, -half, half)
    inside = np.flatnonzero((near == points).all(axis=1))
    for i in inside:
        k = int(np.argmin(half - np.abs(points[i])))
        near[i, k] = np.copysign(half[k], points[i, k])
    return near


def _on_ellipsoid(half: FloatArray, points: FloatArray) -> FloatArray:
    """By bisection of the multiplier t: x = h^2 p / (t + h^2), |x / h| = 1."""
    square = half**2
    low = np.full(len(points), -square.min() * (1 - 1e-9))
    high = np.linalg.norm(points, axis=1) * half.max() + square.max()
    for _ in range(80):
        t = (low + high) / 2
        outside = ((half * points / (t[:, None] + square)) ** 2).sum(axis=1) > 1.0
        low, high = np.where(outside, t, low), np.where(outside, high, t)
    return np.asarray(square * points / (((low + high) / 2)[:, None] + square))


def _nearest_triangle(triangles: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Of every point to every triangle: to its plane where it is above it, else to its edges."""
    best, near = np.full(len(points), np.inf), np.zeros_like(points)
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    for i, p in enumerate(points):
        height = np.einsum("ij,ij->i", p - a, normal)
        foot = p - height[:, None] * normal
        sides = [
            np.einsum("ij,ij->i", np.cross(v - u, foot - u), normal)
            for u, v in ((a, b), (b, c), (c, a))
        ]
        above = (np.array(sides) >= 0.0).all(axis=0)
        candidates = [np.where(above.reshape(-1, 1), foot, np.inf)]
        for u, v in ((a, b), (b, c), (c, a)):
            along = v - u
            share = np.einsum("ij,ij->i", p - u, along)
            share = np.clip(share / np.maximum((along**2).sum(axis=1), 1e-30), 0.0, 1.0)
            candidates.append(u + share[:, None] * along)
        every = np.concatenate(candidates)
        every = every[np.isfinite(every[:, 0])]
        distances = np.square(every - p).sum(axis=1)
        k = int(np.argmin(distances))
        best[i], near[i] = np.sqrt(distances[k]), every[k]
    return best, near


def _winding(triangles: FloatArray, points: FloatArray) -> FloatArray:
    """Sum of the solid angles of all triangles at points (n, 3), over 4 pi."""
    out = np.zeros(len(points))
    for i, p in enumerate(points):
        a, b, c = np.moveaxis(triangles - p, 1, 0)
        la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
        volume = np.einsum("ij,ij->i", a, np.cross(b, c))
        dots = (
            la * lb * lc
            + np.einsum("ij,ij->i", a, b) * lc
            + np.einsum("ij,ij->i", b, c) * la
            + np.einsum("ij,ij->i", c, a) * lb
        )
        out[i] = 2 * np.arctan2(volume, dots).sum() / (4 * np.pi)
    return out


def _edges(points: FloatArray, inward: FloatArray, mu: float, k: int, length: float) -> FloatArray:
    """Wrenches (6, n k) of pyramids' edges of unit normal force, torque over a length."""
    columns = []
    for p, n in zip(points, inward, strict=True):
        other = np.eye(3)[int(np.argmin(np.abs(n)))]
        u = np.cross(n, other)
        u /= np.linalg.norm(u)
        v = np.cross(n, u)
        for angle in 2 * np.pi * np.arange(k) / k:
            f = n + mu * (np.cos(angle) * u + np.sin(angle) * v)
            columns.append(np.concatenate([f, np.cross(p, f) / length]))
    return np.array(columns).T


def closes(points: FloatArray, inward: FloatArray, mu: float, length: float) -> bool:
    """Whether positive weights of all edges sum up to no wrench, and the edges span all."""
    W = _edges(points, inward, mu, FEW_EDGES, length)
    n = W.shape[1]
    # unknowns a, l: a_i - l >= 0, sum a = 1, W a = 0; largest l
    found = linprog(
        np.append(np.zeros(n), -1.0),
        A_ub=np.column_stack([-np.eye(n), np.ones(n)]),
        b_ub=np.zeros(n),
        A_eq=np.vstack([np.column_stack([W, np.zeros(6)]), np.append(np.ones(n), 0.0)]),
        b_eq=np.append(np.zeros(6), 1.0),
        bounds=[(None, None)] * (n + 1),
    )
    return bool(found.success and found.x[-1] > 0.0 and np.linalg.matrix_rank(W, 1e-6) == 6)


def bears(
    points: FloatArray,
    inward: FloatArray,
    mu: float,
    pull: FloatArray,
    grip: float,
    length: float,
) -> bool:
    """Whether forces in the cones, with at least the grip each, balance a pull at the centre."""
    W = _edges(points, inward, mu, EDGES, length)
    n = W.shape[1]
    per_finger = np.kron(np.eye(len(points)), np.ones(EDGES))
    found = linprog(
        np.ones(n),
        A_ub=-per_finger,
        b_ub=np.full(len(points), -grip),
        A_eq=W,
        b_eq=np.concatenate([-pull, np.zeros(3)]),
        bounds=[(0, None)] * n,
    )
    return bool(found.success)
