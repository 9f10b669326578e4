"""``certify``: everything that can be proven of a planned grasp, at a cost of its own."""

from __future__ import annotations

import time
from typing import get_args

import numpy as np

from planner.certify.breaking import Breaking, Disturbance, smallest_breaking
from planner.certify.certificate import Certificate
from planner.certify.pose import PoseErrors
from planner.certify.tolerance import (
    Tolerance,
    contact_tolerances,
    pose_tolerances,
    sampled,
)
from planner.contacts import ContactSet
from planner.errors import TaskError
from planner.forces import ForceProblem
from planner.plan import GraspPlan
from planner.quality import Interval, epsilon_linf, epsilon_round, force_closure
from planner.spatial import FloatArray

__all__ = ["certify", "certify_contacts"]

DEFAULT_WIDTH = 0.01
"""Relative width of an interval at which its refinement ends (-)."""

DEFAULT_POINTS = 300
"""Points of a hull at which its refinement ends (-). Four contacts need 30 to 200 for 1 %."""


def certify(
    plan: GraspPlan,
    *,
    width: float = DEFAULT_WIDTH,
    max_points: int = DEFAULT_POINTS,
    edges: int = 8,
    samples: int = 0,
    seed: int = 0,
) -> Certificate:
    """Bounds of epsilon, the smallest breaking disturbances, and errors that closure tolerates.

    May be called from any number of threads.

    Disturbances are judged with the hand's actuators, stops and weight and the object's weight, as
    the plan's own forces are, without the plan's grip and without its reserve of friction: what is
    proven is what the best control bears in the planned posture. Torque
    is divided by the radius of the object's bounding sphere.

    Args:
        plan: What to certify.
        width: Relative width of intervals that is aimed at, in (0, 1).
        max_points: Budget of each interval; it stays as wide as it is then, and valid.
        edges: Edges of the inscribed pyramids by which closure and the promises are decided, at
            least 3. All else is about the true cones.
        samples: Random errors to try of every kind, up to its promise; 0 tries none.
        seed: Of random errors.

    Returns:
        The certificate; tolerances are empty where the grasp is not closed.

    Raises:
        ContactError: ``edges`` is below 3.
        TaskError: ``width``, ``max_points`` or ``samples`` is out of range.
        PlannerError: A linear programme met numerical trouble.
    """
    task = plan.task
    poses = PoseErrors.of(
        task.object.shape,
        plan.contacts_in_object,
        np.array([finger.pad.radius for finger in task.fingers]),
    )
    return _certify(
        plan.contacts,
        length=task.object.shape.bounding_radius,
        problem=plan.forces.problem,
        poses=poses,
        rotation=np.array(task.T_world_object.rotation),
        width=width,
        max_points=max_points,
        edges=edges,
        samples=samples,
        seed=seed,
    )


def certify_contacts(
    contacts: ContactSet,
    *,
    length: float,
    problem: ForceProblem | None = None,
    width: float = DEFAULT_WIDTH,
    max_points: int = DEFAULT_POINTS,
    edges: int = 8,
    samples: int = 0,
    seed: int = 0,
) -> Certificate:
    """The same of bare contacts, without errors of the object's pose.

    Args:
        contacts: n contacts.
        length: Torque is divided by it, m.
        problem: Weight and limits for the breaking disturbances; none are sought without it.
        width: As for ``certify``.
        max_points: As for ``certify``.
        edges: As for ``certify``.
        samples: As for ``certify``.
        seed: As for ``certify``.

    Raises:
        ContactError: ``length`` is not positive, or ``edges`` is below 3.
        TaskError: ``width``, ``max_points`` or ``samples`` is out of range.
        PlannerError: A linear programme met numerical trouble.
    """
    return _certify(
        contacts,
        length=length,
        problem=problem,
        poses=None,
        rotation=np.eye(3),
        width=width,
        max_points=max_points,
        edges=edges,
        samples=samples,
        seed=seed,
    )


def _certify(
    contacts: ContactSet,
    *,
    length: float,
    problem: ForceProblem | None,
    poses: PoseErrors | None,
    rotation: FloatArray,
    width: float,
    max_points: int,
    edges: int,
    samples: int,
    seed: int,
) -> Certificate:
    if not 0 < width < 1:
        raise TaskError(f"width is {width}; give a relative width in (0, 1), for example 0.01")
    if max_points < 1 or samples < 0:
        raise TaskError(
            f"max_points is {max_points} and samples is {samples}; give at least 1 and at least 0"
        )
    begin = time.process_time()
    closure = force_closure(contacts, edges)
    epsilon = epsilon_round(contacts, length=length, rel_tol=width, max_points=max_points)
    bounded = Interval(lower=0.0, upper=0.0)
    if epsilon.upper > 0:
        bounded = epsilon_linf(contacts, length=length, rel_tol=width, max_points=max_points)
    breaking: tuple[Breaking, ...] = ()
    if problem is not None:
        breaking = tuple(
            smallest_breaking(problem, kind, length=length, rel_tol=width, max_points=max_points)
            for kind in get_args(Disturbance)
        )
    tolerances: tuple[Tolerance, ...] = ()
    if closure.closed:
        tolerances = contact_tolerances(contacts, edges=edges)
        if poses is not None:
            tolerances += pose_tolerances(poses, edges=edges, seed=seed)
        if samples:
            tolerances = tuple(sampled(t, samples, seed) for t in tolerances)
    return Certificate(
        closed=closure.closed,
        reason=closure.reason,
        length=length,
        epsilon=epsilon,
        epsilon_linf=bounded,
        breaking=breaking,
        tolerances=tolerances,
        rotation=rotation,
        cpu_s=time.process_time() - begin,
    )
