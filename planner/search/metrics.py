"""Metrics of a plan: each objective of synthesis by its full definition on the true geometry.

The objectives (``planner.synthesis.objectives``) are smooth rows in a few directions of
wrench. The metrics are computed independently: with Pinocchio's Jacobians, Qhull on primitive
wrenches, the linear programme of closure, and the planned forces. For all of them more is better.

    epsilon        (-)     Radius of the largest ball in the hull of unit contact wrenches, L1,
                           8 edges (Ferrari and Canny 1992).
    min_weight     (-)     Normalised min-weight (FRoGGeR, Li et al. 2023), 8 edges.
    task           (1/N)   How much of every task wrench one newton of normal force, shared freely,
                           resists: min over wrenches t of max {l: -l t in that hull}.
    robustness     (-)     Epsilon that remains under errors of every contact point by 2 mm and of
                           every normal by 5 degrees: of the hull with friction narrowed, less the
                           error of the torque (``planner.synthesis.objectives``).
    torque         (-)     1 less the largest share of its limit that an actuator of the fingers
                           spends on the planned forces.
    manipulability (m/rad) Least over fingers of the geometric mean of the singular values of the
                           contact's Jacobian (Yoshikawa 1985, per direction of motion).
    limits         (-)     Least distance of a finger's joint from a limit, as a share of its range.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from planner.arrays import float_array
from planner.contacts import ContactSet
from planner.errors import ContactError, TaskError
from planner.forces import ForceSolution
from planner.hands.fingers import Finger
from planner.kinematics import HandState
from planner.plan import GraspPlan
from planner.quality import epsilon_l1, min_weight, primitive_wrenches
from planner.quality.ball import flat_direction
from planner.spatial import SE3, FloatArray
from planner.synthesis.objectives import (
    NORMAL_ERROR,
    OBJECTIVES,
    POSITION_ERROR,
    Objective,
    driving,
    free_velocities,
    narrowed,
    resisted_wrenches,
)
from planner.synthesis.options import named_weights
from planner.task import GraspTask

__all__ = [
    "METRICS",
    "Measure",
    "MeasuredGrasp",
    "Metric",
    "evaluate_metrics",
    "mean_singular_value",
    "register_metric",
    "resisted_per_newton",
    "robust_epsilon",
]

EDGES = 8
"""Edges of the friction pyramids."""


class MeasuredGrasp(Protocol):
    """What metrics need of a grasp: a plan has it, and so has a grasp that is not verified yet."""

    @property
    def task(self) -> GraspTask:
        """What was asked."""

    @property
    def T_world_base(self) -> SE3:
        """Pose of the hand's base."""

    @property
    def q(self) -> FloatArray:
        """Joints (nq,)."""

    @property
    def contacts(self) -> ContactSet:
        """Contacts, world."""

    @property
    def contacts_in_object(self) -> ContactSet:
        """Contacts, object frame."""

    @property
    def forces(self) -> ForceSolution:
        """Planned forces."""


@dataclass(frozen=True, kw_only=True)
class Metric:
    """A metric of a plan; more is better.

    Attributes:
        unit: "-" for none.
        value: From a grasp and the task wrenches (k, 6), object frame.
    """

    unit: str
    value: Callable[[MeasuredGrasp, FloatArray], float]


@dataclass(frozen=True)
class Measure:
    """One number by which plans are compared: a metric, or a weighted sum of several.

    Attributes:
        text: The metric's name, or several with weights, "epsilon:1,limits:0.5".
        weights: Weight of each metric's value, in one over its unit.
        task_wrenches: Of the metric "task" (k, 6), object frame; if empty, the object's weight.
    """

    text: str
    weights: dict[str, float]
    task_wrenches: FloatArray

    @classmethod
    def of(cls, metric: str | Mapping[str, float], task_wrenches: ArrayLike = ()) -> Measure:
        """From a name, "epsilon:1,limits:0.5", or a mapping of names to weights > 0.

        Raises:
            NotFoundError: A metric that does not exist.
            TaskError: A name twice, or a weight that is not a number > 0.
        """
        weights = named_weights(metric, METRICS, what="metric")
        text = ",".join(n if w == 1.0 else f"{n}:{w!r}" for n, w in weights.items())
        return cls(text, weights, np.asarray(task_wrenches, dtype=np.float64))

    def __call__(self, grasp: MeasuredGrasp) -> float:
        """The value of a grasp; more is better."""
        wrenches = resisted_wrenches(grasp.task, self.task_wrenches)
        return sum(w * METRICS[name].value(grasp, wrenches) for name, w in self.weights.items())


def evaluate_metrics(plan: GraspPlan, task_wrenches: ArrayLike = ()) -> dict[str, float]:
    """Every metric of a plan, by name.

    Args:
        plan: The plan.
        task_wrenches: Wrenches (k, 6) of the metric "task", object frame, N and N m; if empty, the
            object's weight in any direction.
    """
    wrenches = resisted_wrenches(plan.task, task_wrenches)
    return {name: metric.value(plan, wrenches) for name, metric in METRICS.items()}


def resisted_per_newton(contacts: ContactSet, wrenches: FloatArray, *, length: float) -> float:
    """Largest l such that -l t is in the hull of unit contact wrenches for all t, 1/N.

    0 where the contacts do not close the grasp.

    Args:
        contacts: n contacts.
        wrenches: t (k, 6), in the contacts' frame about their centre, N and N m.
        length: Torque is divided by it, m; it affects conditioning only.

    Raises:
        ContactError: ``wrenches`` are not finite (k, 6), or ``length`` is not positive.
    """
    faces = _faces(contacts, length)
    wrenches = float_array("wrenches", wrenches)
    if wrenches.ndim != 2 or wrenches.shape[1] != 6 or not np.isfinite(wrenches).all():
        raise ContactError(f"wrenches have shape {wrenches.shape}; give finite numbers (k, 6)")
    if (faces[:, 6] >= 0).any():
        return 0.0  # the origin is not inside
    against = -faces[:, :6] @ (wrenches / np.repeat([1.0, length], 3)).T
    reach = np.maximum(-faces[:, 6:], 0.0)
    met = against > 0
    return float(np.min(np.where(met, reach / np.where(met, against, 1.0), np.inf), initial=np.inf))


def robust_epsilon(
    contacts: ContactSet, *, length: float, position_error: float, normal_error: float
) -> float:
    """Epsilon that remains under errors of every contact; negative where closure may be lost.

    A face n . w <= d of the hull with narrowed friction moves in by r |f| |n_t| / length, the error
    of the torque of a force of unit normal component: exact for the hull eroded by that.

    Args:
        contacts: n contacts.
        length: Torque is divided by it, m.
        position_error: r, m.
        normal_error: rad.
    """
    mu = np.maximum(narrowed(contacts.mu, normal_error), 0.0)
    faces = _faces(contacts.with_friction(mu), length)
    lost = position_error / length * float(np.sqrt(1 + mu.max(initial=0.0) ** 2))
    return float((-faces[:, 6] - lost * np.linalg.norm(faces[:, 3:6], axis=1)).min())


def _faces(contacts: ContactSet, length: float) -> FloatArray:
    """Faces (k, 7) of the hull of primitive wrenches: unit normal, minus its distance."""
    from planner.system.scipy_parts import ConvexHull  # here: SciPy loads slowly

    wrenches = primitive_wrenches(contacts, EDGES, length=length).T
    if len(wrenches) <= 6:  # a hull in six dimensions has seven corners or more: this one is flat
        flat = flat_direction(wrenches)
        assert flat is not None
        offset = float(flat @ wrenches[0]) if len(wrenches) else 0.0
        return np.array([[*flat, -offset], [*-flat, offset]])
    # the option joggles points in special position, such as those of two opposed contacts
    return np.asarray(ConvexHull(wrenches, qhull_options="QJ").equations)


def _torque_margin(plan: MeasuredGrasp) -> float:
    hand, task = plan.task.hand, plan.task
    used = driving(hand, task.fingers)
    low, high = hand.actuation.force_limits(plan.q)[used].T
    force = plan.forces.actuator_forces[used]
    limit = np.where(force > 0, high, -low)
    spent = np.abs(force) / np.where(limit > 0, limit, np.nan)
    return 1.0 - float(np.nanmax(spent, initial=0.0))


def _manipulability(plan: MeasuredGrasp) -> float:
    state = HandState(plan.task.hand, plan.q)
    points = plan.contacts.transformed(plan.T_world_base.inverse()).positions
    return min(
        mean_singular_value(state, finger, point)
        for finger, point in zip(plan.task.fingers, points, strict=True)
    )


def mean_singular_value(state: HandState, finger: Finger, point: FloatArray) -> float:
    """Geometric mean (m/rad) of the singular values of a finger's Jacobian at a point (3,)."""
    jacobian = state.point_jacobian(finger.pad.joint_id, point)[:3, finger.q_index]
    values = np.linalg.svd(jacobian @ free_velocities(state.hand, finger), compute_uv=False)
    return float(np.prod(values) ** (1 / len(values)))


def _limit_distance(plan: MeasuredGrasp) -> float:
    hand = plan.task.hand
    index = np.concatenate([f.q_index for f in plan.task.fingers])
    lower, upper = hand.q_lower[index], hand.q_upper[index]
    near = np.minimum(plan.q[index] - lower, upper - plan.q[index])
    return float((near / np.where(upper > lower, upper - lower, np.inf))[upper > lower].min())


def _length(plan: MeasuredGrasp) -> float:
    return plan.task.object.shape.bounding_radius


METRICS: dict[str, Metric] = {
    "epsilon": Metric(
        unit="-", value=lambda plan, _: epsilon_l1(plan.contacts, length=_length(plan))
    ),
    "min_weight": Metric(unit="-", value=lambda plan, _: min_weight(plan.contacts)),
    "task": Metric(
        unit="1/N",
        value=lambda plan, wrenches: resisted_per_newton(
            plan.contacts_in_object, wrenches, length=_length(plan)
        ),
    ),
    "robustness": Metric(
        unit="-",
        value=lambda plan, _: robust_epsilon(
            plan.contacts,
            length=_length(plan),
            position_error=POSITION_ERROR,
            normal_error=NORMAL_ERROR,
        ),
    ),
    "torque": Metric(unit="-", value=lambda plan, _: _torque_margin(plan)),
    "manipulability": Metric(unit="m/rad", value=lambda plan, _: _manipulability(plan)),
    "limits": Metric(unit="-", value=lambda plan, _: _limit_distance(plan)),
}
"""All metrics by name: every objective of ``planner.synthesis`` has one."""


def register_metric(name: str, metric: Metric, objective: Objective | None = None) -> Metric:
    """Make a metric known by its name; with an objective, synthesis improves it by that name too.

    Args:
        name: As ``metric=`` of ``plan_grasp`` and ``--metric`` take it.
        metric: What it is.
        objective: Rows that rounds of synthesis improve; None where plans are compared by it only.

    Raises:
        TaskError: The name is taken.
    """
    if name in METRICS or name in OBJECTIVES:
        raise TaskError(f"there is a metric {name!r} already; give another name")
    METRICS[name] = metric
    if objective is not None:
        OBJECTIVES[name] = objective
    return metric
