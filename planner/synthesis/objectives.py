"""The objectives by name, and their rows, which rounds of least squares improve.

Each objective gives rows that count where they are negative: a metric less its target. Their
numeric parameters are updated when a round begins and are zero outside rounds.
``planner.search.metrics`` evaluates the metrics of a plan by their full definitions on the true
geometry.

Objectives of the hand's joints: torque margin, manipulability, distance from limits.

torque           The share of its limit that each actuator spends on the internal force, scaled such
                 that every finger presses with the task's grip at least, and on an equal share of
                 the weight. Squared: the worst counts most. The weight of the links is left out.
manipulability   log det(J J^T / a^2 + e I) / 6 for the velocity Jacobian J of every finger at its
                 contact, of the joint velocities that couplings allow: the logarithm of Yoshikawa's
                 measure (1985, Manipulability of robotic mechanisms) per direction of motion. Its
                 derivative weighs each singular value by its inverse: the least one counts most,
                 and the measure is smooth where two are equal; e keeps it finite.
limits           How far every joint of the fingers is from its nearer limit, as a share of its
                 range.

Objectives of the contacts: min-weight, task wrenches, robustness.

Each is the minimum, over directions u of wrench, of a function of the support h(u) = max u . w of
the unit contact wrenches (normal forces sum to 1, torques over the characteristic length). The
minimising directions are found once per round, among the faces of the hull with coarse pyramids. In
up to ``CUTS`` of them the rows are then exact functions of the grasp for the true cones. The inner
problem is solved numerically and its envelope is differentiated, as for epsilon.

min_weight   The normalised min-weight s = m l* is where the ray from the origin against the mean
             w0 of the primitive wrenches leaves their hull: a = l* + b with b >= 0 and W a = 0 say
             that -s / (1 - s) w0 is in the hull. By duality s = min_u h(u) / (h(u) - u . w0). The
             mean of a cone's edges is its normal.
task         The multiple of the task wrench t that one newton of normal force resists is where the
             ray along -t leaves the hull: min_u h(u) over all u with -u . t = 1.
robustness   With every contact point off by up to r and every normal by up to a, forces in the cone
             narrowed by a stay in the true one, and their torque errs by at most r |f|. So
             min_u h'(u) - r / length sqrt(1 + mu'^2) |u_t| over unit u, with mu' = tan(atan(mu) -
             a), is the radius of a ball of wrenches that is resisted under any error up to r and a.

A task wrench acts on the object about its centre of mass, in the object's frame, [N; N m]; it is
given by the user, or ready-made for common cases.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from planner.errors import TaskError, shown
from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.quality.weakest import first_apart, wrench_faces
from planner.spatial import FloatArray, IntArray
from planner.synthesis.symbols import GraspPoint, GraspSymbols, contact_torque, support
from planner.task import GraspTask

MANIPULABILITY_TARGET = 0.15
"""Target of manipulability, more than fingers reach, m/rad."""

SINGULAR = 2e-4
"""Added to the eigenvalues of J J^T / ``MANIPULABILITY_TARGET``^2 (-): 2 mm/rad."""

LIMIT_TARGET = 0.25
"""Target of the distance from a limit over the range (-): the middle half is good."""

LEAST_PRESS = 0.1
"""Least normal force over the mean (-) below which forces are not scaled up further; the term
``press`` asks for more."""

LEAST_LIMIT = 1e-3
"""Limits of actuators nearer to zero than this (N m, N) count as this: a servo at the end of its
command range can hardly pull further."""


def driving(hand: Hand, fingers: tuple[Finger, ...]) -> IntArray:
    """Numbers (k,) of the actuators that move joints of these fingers."""
    joints = np.concatenate([f.q_index for f in fingers])
    return np.flatnonzero(hand.actuation.moment[:, joints].any(axis=1))


def free_velocities(hand: Hand, finger: Finger) -> FloatArray:
    """Basis (n, k) of the velocities of a finger's joints that its two-sided couplings allow."""
    from scipy.linalg import null_space  # here, since SciPy loads slowly

    rows = [
        c.row[finger.q_index]
        for c in hand.couplings
        if not c.one_sided and set(np.flatnonzero(c.row)) <= {int(i) for i in finger.q_index}
    ]
    return null_space(np.array(rows)) if rows else np.eye(len(finger.q_index))


def torque_rows(g: GraspSymbols) -> tuple[Any, Any]:
    """Minus the squared share of its limit that each actuator spends."""
    hand, n = g.symbolic.hand, len(g.fingers)
    used = driving(hand, g.fingers)
    grip, weight = ca.SX.sym("grip"), ca.SX.sym("weight", 3)
    per_limit = ca.SX.sym("per_limit", len(used), 2)
    torque = ca.SX.zeros(hand.nq)
    least = ca.SX(np.inf)
    for normal, force in zip(g.outward, g.forces, strict=True):
        least = ca.fmin(least, -ca.dot(force, normal))
    least = ca.fmax(least, LEAST_PRESS)
    for finger, normal, force in zip(g.fingers, g.outward, g.forces, strict=True):
        center = g.symbolic.point(finger.pad.joint_id, finger.pad.center)
        pressed = grip * force / least - weight / n
        torque += contact_torque(g.symbolic, finger, g.rotation, center, normal, pressed)
    firm = [c.row for c in hand.couplings if not c.one_sided]
    drive = np.linalg.pinv(np.column_stack([hand.actuation.moment.T, *firm]))
    effort = ca.DM(drive[used]) @ torque
    share = ca.fmax(effort * per_limit[:, 0], effort * per_limit[:, 1])
    return -(share**2), ca.vertcat(grip, weight, ca.vec(per_limit))


def update_torque(point: GraspPoint) -> FloatArray:
    """Grip (N), weight in the object's frame (N), inverse limits of the actuators."""
    task = point.task
    used = driving(task.hand, task.fingers)
    limits = task.hand.actuation.force_limits(point.q)[used]
    low, high = np.minimum(limits[:, 0], -LEAST_LIMIT), np.maximum(limits[:, 1], LEAST_LIMIT)
    weight = task.object.mass * task.T_world_object.rotation.T @ task.gravity
    return np.concatenate([[task.grip_force], weight, 1 / low, 1 / high])


def manipulability_rows(g: GraspSymbols) -> tuple[Any, Any]:
    """Logarithm of each finger's manipulability over its target."""
    rows = []
    for finger, normal in zip(g.fingers, g.outward, strict=True):
        pad = finger.pad
        point = g.symbolic.point(pad.joint_id, pad.center) - pad.radius * (g.rotation.T @ normal)
        jacobian = ca.vertcat(
            *[
                ca.horzcat(*[g.symbolic.joint_torque(name, point, axis) for name in finger.joints])
                for axis in np.eye(3)
            ]
        )
        free = jacobian @ ca.DM(free_velocities(g.symbolic.hand, finger)) / MANIPULABILITY_TARGET
        rows.append(ca.log(ca.det(free @ free.T + SINGULAR * ca.SX.eye(3))) / 6)
    return ca.vertcat(*rows), ca.SX(0, 1)


def limits_rows(g: GraspSymbols) -> tuple[Any, Any]:
    """Distance of each joint from both limits over its range, less its target."""
    hand = g.symbolic.hand
    index = np.concatenate([f.q_index for f in g.fingers])
    index = index[hand.q_upper[index] > hand.q_lower[index]]
    lower, upper = hand.q_lower[index], hand.q_upper[index]
    q = g.q[index.tolist()]
    rows = ca.vertcat((q - lower) / (upper - lower), (upper - q) / (upper - lower))
    return rows - LIMIT_TARGET, ca.SX(0, 1)


CUTS = 12
"""Directions of wrench in which a round works on one objective. Those of the hull with 4 edges do
as well as those with 8, which take 4 ms more a round."""

POSITION_ERROR = 2e-3
"""Error of a contact's position that "robustness" allows for, m: good calibration and vision."""

NORMAL_ERROR = float(np.deg2rad(5.0))
"""Error of a contact's normal that "robustness" allows for, rad."""

MIN_WEIGHT_TARGET = 0.85
"""Target of min-weight (-), of which 1 is the most."""

ROBUSTNESS_TARGET = 0.15
"""Target of robustness (-), little more than grasps reach, so that the weakest directions
count most: on four pairs of hand and primitive it rises by 0.05 in the median, with twice as much
by 0.03."""

TASK_TARGET = 0.6
"""Target for the largest task wrench, per sum of normal forces (-). With 0.5 the least
that is resisted rises by 30 % in the median, with 0.6 by 50 %, with 1 by 35 %."""


def narrowed(mu: Any, angle: float) -> Any:
    """Friction tan(atan(mu) - angle) of the cone that every tilt by up to ``angle`` (rad) holds."""
    tangent = float(np.tan(angle))
    return (mu - tangent) / (1 + mu * tangent)


def min_weight_rows(g: GraspSymbols) -> tuple[Any, Any]:
    """The min-weight that each direction allows, less its target."""
    u = ca.SX.sym("u_min_weight", 6, CUTS)
    n = len(g.points)
    mean = ca.vertcat(
        -sum(g.outward[1:], g.outward[0]) / n,
        -sum((ca.cross(p, o) for p, o in zip(g.points, g.outward, strict=True)), ca.SX.zeros(3))
        / (n * g.length),
    )
    rows = []
    for k in range(CUTS):
        reach = support(u[:, k], g.points, g.outward, g.mu, g.length)
        rows.append(reach / (reach - ca.dot(u[:, k], mean)) - MIN_WEIGHT_TARGET)
    return ca.vertcat(*rows), ca.vec(u)


def update_min_weight(point: GraspPoint) -> FloatArray:
    """The directions that bound the min-weight most (6 CUTS,)."""
    faces = wrench_faces(point.points, point.inward, point.task.mu, point.length)
    torque = np.cross(point.points, point.inward).mean(axis=0) / point.length
    along = faces[:, :6] @ np.concatenate([point.inward.mean(axis=0), torque])
    bound = -faces[:, 6] / (-faces[:, 6] - along)
    faces = faces[np.argsort(bound, kind="stable"), :6]
    return _filled(faces[first_apart(faces, CUTS)])


def task_rows(g: GraspSymbols) -> tuple[Any, Any]:
    """Resistance to each task wrench, less its target."""
    u = ca.SX.sym("u_task", 6, CUTS)
    on = ca.SX.sym("on_task", CUTS)
    rows = [
        support(u[:, k], g.points, g.outward, g.mu, g.length) - TASK_TARGET * on[k]
        for k in range(CUTS)
    ]
    return ca.vertcat(*rows), ca.vertcat(ca.vec(u), on)


def update_task(point: GraspPoint) -> FloatArray:
    """The directions that bound the worst task wrenches most, and which are used (7 CUTS,)."""
    wrenches = point.wrenches / np.repeat([1.0, point.length], 3)
    wrenches = wrenches / np.linalg.norm(wrenches, axis=1).max()
    faces = wrench_faces(point.points, point.inward, point.task.mu, point.length)
    against = -faces[:, :6] @ wrenches.T  # (faces, wrenches)
    face, wrench = np.nonzero(against > FACING)
    reach = -faces[face, 6]
    # beyond which the origin lies: nothing is resisted yet, whatever the ray
    scale = np.where(reach > 0, against[face, wrench], 1.0)
    order = np.argsort(reach / scale, kind="stable")
    face, scale = face[order], scale[order]
    chosen = first_apart(faces[face, :6], CUTS)
    directions = faces[face[chosen], :6] / scale[chosen, None]
    return np.concatenate([_filled(directions), np.arange(CUTS) < len(chosen)])


FACING = 1e-3
"""Least cosine (-) between a wrench and the inward normal of a face that its ray may hit."""


def robustness_rows(g: GraspSymbols) -> tuple[Any, Any]:
    """Resistance in each direction under the largest errors, less its target."""
    u = ca.SX.sym("u_robustness", 6, CUTS)
    mu = ca.fmax(narrowed(g.mu, NORMAL_ERROR), 0)
    lost = POSITION_ERROR / g.length * ca.sqrt(1 + mu**2)
    rows = [
        support(u[:, k], g.points, g.outward, mu, g.length)
        - lost * ca.norm_2(u[3:, k])
        - ROBUSTNESS_TARGET * ca.norm_2(u[:, k])
        for k in range(CUTS)
    ]
    return ca.vertcat(*rows), ca.vec(u)


def update_robustness(point: GraspPoint) -> FloatArray:
    """The directions with the least resistance under errors (6 CUTS,)."""
    mu = max(float(narrowed(point.task.mu, NORMAL_ERROR)), 0.0)
    faces = wrench_faces(point.points, point.inward, mu, point.length)
    lost = POSITION_ERROR / point.length * np.sqrt(1 + mu**2)
    left = -faces[:, 6] - lost * np.linalg.norm(faces[:, 3:6], axis=1)
    faces = faces[np.argsort(left, kind="stable"), :6]
    return _filled(faces[first_apart(faces, CUTS)])


def _filled(directions: FloatArray) -> FloatArray:
    """Directions (k, 6) as parameters (6 CUTS,); those that are missing are zero."""
    out = np.zeros(6 * CUTS)
    out[: directions.size] = directions.ravel()
    return out


_GOLDEN = (1 + 5**0.5) / 2
_ICOSAHEDRON: FloatArray = np.array(
    [
        np.roll([0.0, a, b * _GOLDEN], shift)
        for shift in range(3)
        for a in (1.0, -1.0)
        for b in (1.0, -1.0)
    ]
)
"""Corners (12, 3) of a regular icosahedron with edges of length 2."""

_INRADIUS = _GOLDEN**2 / 3**0.5
"""Radius of the ball that touches its faces from within."""


def gravity_any_direction(task: GraspTask) -> FloatArray:
    """The object's weight in any direction, (12, 6), N: corners of an icosahedron around its ball.

    The set of resisted wrenches is convex: a grasp that resists the corners resists every weight
    inside. The corners are 1.26 times as heavy as the object. Without gravity they are those of one
    newton.
    """
    weight = task.object.mass * float(np.linalg.norm(task.gravity)) or 1.0
    forces = weight / _INRADIUS * _ICOSAHEDRON
    return np.hstack([forces, np.zeros_like(forces)])


def tool_torque(axis: ArrayLike, torque: float) -> FloatArray:
    """A torque about an axis of the object's frame, both ways round, (2, 6), N m.

    Args:
        axis: Direction (3,), any length but zero.
        torque: N m, > 0.

    Raises:
        TaskError: The axis has no direction, or the torque is not positive.
    """
    direction = np.asarray(axis, dtype=np.float64)
    size = float(np.linalg.norm(direction))
    if direction.shape != (3,) or not np.isfinite(size) or size == 0.0:
        raise TaskError(
            f"the axis of a tool's torque is {shown(axis)}; give three numbers, not all 0"
        )
    if not (np.isfinite(torque) and torque > 0):
        raise TaskError(f"a tool's torque is {torque}; give N m > 0")
    turn = np.concatenate([np.zeros(3), torque * direction / size])
    return np.stack([turn, -turn])


def resisted_wrenches(task: GraspTask, wrenches: ArrayLike = ()) -> FloatArray:
    """The task wrenches (k, 6): those given, else the weight in any direction.

    Raises:
        TaskError: As ``checked_wrenches`` does.
    """
    if given := checked_wrenches(wrenches if wrenches is not None else ()):
        return np.array(given)
    return gravity_any_direction(task)


def checked_wrenches(
    wrenches: ArrayLike,
) -> tuple[tuple[float, ...], ...]:
    """Task wrenches (k, 6) as plain numbers, after a check; k may be 0.

    Raises:
        TaskError: Another shape, NaN or infinity, or a wrench of nothing but zeros.
    """
    try:
        array = np.array(wrenches, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise TaskError(f"task_wrenches is {shown(wrenches)}; {_FORM}") from error
    if array.size == 0:
        return ()
    if array.ndim != 2 or array.shape[1] != 6 or not np.isfinite(array).all():
        raise TaskError(f"task_wrenches has shape {array.shape} or holds NaN; {_FORM}")
    if not np.abs(array).max(axis=1).all():
        raise TaskError(f"a task wrench is zero in all components; {_FORM}")
    return tuple(tuple(float(v) for v in row) for row in array)


_FORM = "give rows of six finite numbers, fx, fy, fz in N and tx, ty, tz in N m, object frame"


EPSILON = "epsilon"
"""The default; its rows are the term ``planner.synthesis.terms.resistance``."""


def _nothing(_point: GraspPoint) -> FloatArray:
    """Parameters of rows that have none."""
    return np.zeros(0)


@dataclass(frozen=True, kw_only=True)
class Objective:
    """One objective.

    Attributes:
        weight: Weight of its rows against those of epsilon (-), so that weight 1 is sensible.
        rows: Rows and their parameters as expressions.
        update: Computes the parameters at a grasp, in the same order.
    """

    weight: float
    rows: Callable[[GraspSymbols], tuple[Any, Any]] | None = None
    update: Callable[[GraspPoint], FloatArray] = _nothing


OBJECTIVES: dict[str, Objective] = {
    EPSILON: Objective(weight=1.0),
    "min_weight": Objective(weight=0.6, rows=min_weight_rows, update=update_min_weight),
    "task": Objective(weight=1.0, rows=task_rows, update=update_task),
    "robustness": Objective(weight=4.0, rows=robustness_rows, update=update_robustness),
    "torque": Objective(weight=20.0, rows=torque_rows, update=update_torque),
    "manipulability": Objective(weight=0.5, rows=manipulability_rows),
    "limits": Objective(weight=1.0, rows=limits_rows),
}
"""All objectives by name. With these weights each raises its own measure most while nine of ten
attempts that succeed without an objective still do; with twice as much grasps are lost.
``planner.search.metrics.register_metric`` adds one."""


def objective_rows(names: tuple[str, ...], symbols: GraspSymbols) -> tuple[dict[str, Any], Any]:
    """Rows (m,) of each objective, and the parameters (k,) of all for ``objective_parameters``."""
    rows, parameters = {}, [ca.SX(0, 1)]
    for name in names:
        objective = OBJECTIVES[name]
        if objective.rows is None:
            continue
        size = ca.SX.sym(f"size_{name}")
        expression, own = objective.rows(symbols)
        rows[name] = objective.weight * size * expression
        parameters += [size, own]
    return rows, ca.vertcat(*parameters)


def objective_parameters(
    names: tuple[str, ...], weights: Mapping[str, float], point: GraspPoint
) -> FloatArray:
    """Parameters (k,) of the rows of objectives at a grasp.

    Args:
        names: As for ``objective_rows``.
        weights: Weight of each squared residual (-).
        point: The grasp.
    """
    parts = [np.zeros(0)]
    for name in names:
        parts += [np.array([np.sqrt(weights[name])]), OBJECTIVES[name].update(point)]
    return np.concatenate(parts)
