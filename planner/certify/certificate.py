"""``certify``: everything that can be proven of a planned grasp, at a cost of its own.

A ``Certificate`` holds proven bounds of a grasp, counterexamples that were found, and CPU times.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, TypedDict, Unpack, get_args

import numpy as np

from planner.arrays import finite
from planner.certify.breaking import (
    Breaking,
    Disturbance,
    breaking_along,
    smallest_breaking,
)
from planner.certify.tolerance import (
    PoseErrors,
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

SCHEMA_VERSION = 1
"""Version of ``Certificate.as_dict``."""

BEST_CONTROL = (
    "  of the planned posture under the best control that its actuators allow, load added slowly;\n"
    "  what a controller bears of it: python -m benchmarks control --parts promise"
)
"""What breaking loads are proven for, said where they are printed."""

DEFAULT_WIDTH = 0.01
"""Relative width of an interval at which its refinement ends (-)."""

DEFAULT_POINTS = 300
"""Points of a hull at which its refinement ends (-)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Certificate:
    """Proven bounds of a grasp's quality and of what it withstands.

    Attributes:
        closed: Whether the grasp is closed. Without closure there are no tolerances.
        reason: The decision in words.
        length: Torque is divided by it before it is mixed with force, m.
        epsilon: Bounds of epsilon of the true cones, normal forces of sum 1 (-).
        epsilon_linf: The same with each normal force in [0, 1].
        breaking: Smallest disturbing force, torque and wrench, for the planned posture and the best
            control; empty where no hand is known.
        needed: By name, how many times each needed wrench can be produced beside the weight (-).
        tolerances: Errors that closure tolerates.
        rotation: (3, 3), world from object.
        cpu_s: CPU time that the certificate took, s, with its samples.
    """

    closed: bool
    reason: str
    length: float
    epsilon: Interval
    epsilon_linf: Interval
    breaking: tuple[Breaking, ...]
    tolerances: tuple[Tolerance, ...]
    rotation: FloatArray
    cpu_s: float
    needed: Mapping[str, Interval] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Plain data for JSON; None for what is infinite or unknown."""
        broken = {}
        needed = {name: [found.lower, found.upper] for name, found in self.needed.items()}
        for b in self.breaking:
            seen = b.in_frame(self.rotation)
            known = np.isfinite(seen).all()
            broken[b.kind] = {
                **b.as_dict(),
                "wrench_object_N_Nm": seen.tolist() if known else None,
            }
        return {
            "schema_version": SCHEMA_VERSION,
            "closed": self.closed,
            "reason": self.reason,
            "length_m": self.length,
            "epsilon_l1": [self.epsilon.lower, self.epsilon.upper],
            "epsilon_linf": [self.epsilon_linf.lower, self.epsilon_linf.upper],
            "smallest_breaking": broken,
            **({"needed_margins": finite(needed)} if needed else {}),
            "tolerances": [t.as_dict() for t in self.tolerances],
            "cpu_s": self.cpu_s,
        }

    def __repr__(self) -> str:
        """One line; the attributes hold the rest."""
        low, high = self.epsilon.lower, self.epsilon.upper
        closed = "closed" if self.closed else "not closed"
        return f"<Certificate: {closed}, epsilon {low:.4g} to {high:.4g}>"

    def __str__(self) -> str:
        """A small table: proven from, proven to or found, unit, and where it acts."""
        lines = [
            self.reason,
            f"torque divided by {1e3 * self.length:.1f} mm; {self.cpu_s:.1f} s of CPU",
            f"{'':24}{'at least':>10}{'at most':>10}",
            _row("epsilon, L1", self.epsilon.lower, self.epsilon.upper, ""),
            _row("epsilon, L-infinity", self.epsilon_linf.lower, self.epsilon_linf.upper, ""),
        ]
        for b in self.breaking:
            where = "no limit found"
            if np.isfinite(b.wrench).all():
                part = slice(3, 6) if b.kind == "torque" else slice(0, 3)
                where = "along " + " and in the object ".join(
                    _direction(w[part]) for w in (b.wrench, b.in_frame(self.rotation))
                )
                if b.kind == "wrench":
                    where = f"force {_vector(b.wrench[:3])} N, torque {_vector(b.wrench[3:])} N m"
            lines.append(
                _row(f"breaking {b.kind}", b.bounds.lower, b.bounds.upper, f"{b.unit:4} {where}")
            )
        for name, found in self.needed.items():
            lines.append(_row(f"needed, {name}", found.lower, found.upper, "times"))
        if self.breaking:
            lines.append(BEST_CONTROL)
        if self.tolerances:
            lines.append(f"{'closure tolerates':24}{'promised':>10}{'broken at':>10}")
        for t in self.tolerances:
            tail = t.unit
            if t.samples:
                tail += f"  {t.lost} of {t.samples} samples lost closure"
            if t.note:
                tail += f"  no promise: {t.note}"
            lines.append(_row(f"  {t.kind}", t.promised, t.broken_at, tail))
        return "\n".join(lines)


class CertifyOptions(TypedDict, total=False):
    """How much work goes into a certificate.

    Attributes:
        width: Relative width of intervals that is aimed at, in (0, 1); 0.01 if not given.
        max_points: Budget of each interval; it stays as wide as it is then, and valid; 300 if not
            given.
        edges: Edges of the inscribed pyramids by which closure and the promises are decided, at
            least 3; 8 if not given. All else is about the true cones.
        samples: Random errors to try of every kind, up to its promise; 0 tries none.
        seed: Of random errors.
    """

    width: float
    max_points: int
    edges: int
    samples: int
    seed: int


def certify(plan: GraspPlan, **options: Unpack[CertifyOptions]) -> Certificate:
    """Bounds of epsilon, the smallest breaking disturbances, and errors that closure tolerates.

    May be called from any number of threads.

    Disturbances are judged with the hand's actuators, stops and weight and the object's weight, as
    the plan's own forces are, without the plan's grip and without its reserve of friction: what is
    proven is what the best control bears in the planned posture. Torque is divided by the radius of
    the object's bounding sphere.

    Args:
        plan: What to certify.
        **options: Those of ``CertifyOptions``.

    Returns:
        The certificate; tolerances are empty where the grasp is not closed.

    Raises:
        ContactError: ``edges`` is below 3.
        TaskError: ``width``, ``max_points`` or ``samples`` is out of range.
        PlannerError: A linear programme met numerical trouble.
    """
    task, poses = plan.task, None
    if task.is_of_fingertips:  # contacts of links move along them when the object's pose is off
        radii = np.array([finger.pad.radius for finger in task.fingers])
        poses = PoseErrors.of(task.object.shape, plan.contacts_in_object, radii)
    begin = time.process_time()
    problem, needed = plan.forces.problem, {}
    for one in task.needed:
        needed[one.name] = breaking_along(problem, task.needed_load(one))
    spent = time.process_time() - begin
    made = certify_contacts(
        plan.contacts,
        length=task.object.shape.bounding_radius,
        problem=problem,
        poses=poses,
        rotation=np.array(task.T_world_object.rotation),
        **options,
    )
    return replace(made, needed=needed, cpu_s=made.cpu_s + spent) if needed else made


def certify_contacts(
    contacts: ContactSet,
    *,
    length: float,
    problem: ForceProblem | None = None,
    poses: PoseErrors | None = None,
    rotation: FloatArray | None = None,
    width: float = DEFAULT_WIDTH,
    max_points: int = DEFAULT_POINTS,
    edges: int = 8,
    samples: int = 0,
    seed: int = 0,
) -> Certificate:
    """The same of bare contacts.

    Args:
        contacts: n contacts.
        length: Torque is divided by it, m.
        problem: Weight and limits for the breaking disturbances; none are sought without it.
        poses: Pads and object for the errors of its pose; none are judged without it.
        rotation: (3, 3), world from object; the identity if not given.
        width: As in ``CertifyOptions``, like all that follow.
        max_points: Budget of each interval.
        edges: Edges of the inscribed pyramids.
        samples: Random errors of every kind.
        seed: Of random errors.

    Raises:
        ContactError: ``length`` is not positive, or ``edges`` is below 3.
        TaskError: ``width``, ``max_points`` or ``samples`` is out of range.
        PlannerError: A linear programme met numerical trouble.
    """
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
        rotation=np.eye(3) if rotation is None else rotation,
        cpu_s=time.process_time() - begin,
    )


def _row(name: str, low: float | None, high: float | None, tail: str) -> str:
    ends = "".join(f"{'-' if x is None else f'{x:.4g}':>10}" for x in (low, high))
    return f"{name:24}{ends} {tail}".rstrip()


def _direction(v: FloatArray) -> str:
    size = np.linalg.norm(v)
    return _vector(v / size) if size > 0 else "nothing"


def _vector(v: FloatArray) -> str:
    return "(" + ", ".join(f"{x:.3g}" for x in np.round(v, 4) + 0.0) + ")"
