"""``plan_grasp``: draw a start, solve, verify on the true geometry, distribute forces; repeat.

Attempts end by iteration limits, never by the clock, so that a seed gives the same plan on any
machine; budgets stop between attempts.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from planner.collision import CollisionWorld
from planner.contacts import ContactSet
from planner.errors import NoGraspFoundError, TaskError
from planner.forces import ForceSolution, distribute_forces, gravity_wrench
from planner.hand import Hand
from planner.kinematics import HandState
from planner.plan import GraspPlan, SolveRecord
from planner.quality import force_closure
from planner.shapes import Mesh, Shape
from planner.spatial import SE3, FloatArray
from planner.synthesis.mesh_seeds import seeder_for
from planner.synthesis.options import SynthesisOptions
from planner.synthesis.pregrasp import (
    Approach,
    PregraspProblem,
    approach_fault,
    find_approach,
)
from planner.synthesis.problem import GraspProblem, build_problem
from planner.synthesis.seeds import Seeder
from planner.synthesis.settle import settle
from planner.synthesis.surfaces import surface_of
from planner.synthesis.surroundings import obstacles_in_object, table_in_object
from planner.synthesis.verify import contacts_at, verify
from planner.task import GraspTask

__all__ = [
    "Attempt",
    "attempts",
    "judge_grasp",
    "plan_forces",
    "plan_grasp",
    "problems_for",
]

DEFAULT_MAX_ATTEMPTS = 40
"""Attempts before giving up. On the shipped shapes one to three are usual."""

SPARE_AFTER = 5
"""Attempts after which every other one is made with three fingers alone, if the choice of fingers
was left to us: on narrow faces, rims and handles four fingers find no room."""

CLOSURE_EDGES = 8
"""Sides of the friction pyramid with which closure is decided."""

FRICTION_SHARE = 0.8
"""Share of the friction coefficient that planned forces may use, so that they keep off the cone's
edge when contacts turn out a little different (-)."""

NLP_TOL = 1e-5
"""Largest violation of an NLP term (in its unit) with which a candidate is looked at further."""


@dataclass(frozen=True, kw_only=True)
class Attempt:
    """One attempt: a plan, or the reason why there is none.

    Attributes:
        index: Its number, from 0.
        plan: The plan if it was found.
        reason: Why not, "" if found.
        cpu_s: CPU time of this attempt, s.
    """

    index: int
    plan: GraspPlan | None
    reason: str
    cpu_s: float


def _nothing_found(task: GraspTask, made: tuple[Attempt, ...]) -> NoGraspFoundError:
    """The error of an exhausted budget, with the commonest reasons."""
    counts = Counter(a.reason.split(":")[0] for a in made)
    why = "; ".join(f"{n} x {reason}" for reason, n in counts.most_common(3))
    commonest = counts.most_common(1)[0][0]
    example = next(a.reason for a in made if a.reason.startswith(commonest))
    return NoGraspFoundError(
        f"no grasp of {task.object.name} with {task.hand.name} "
        f"({', '.join(task.finger_names)}) in {len(made)} attempts: {why} (the first of these: "
        f"{example}). Try more attempts, other fingers, another pose or size of the object, more "
        "friction or less grip",
        made,
    )


@dataclass(frozen=True)
class Problems:
    """The NLPs of a task: the grasp's and the pre-grasp's, and the time (s) both took to build."""

    grasp: GraspProblem
    pregrasp: PregraspProblem
    build_s: float


def problems_for(task: GraspTask) -> Problems:
    """The NLPs for a task; built once per hand, fingers, kind of shape and number of obstacles.

    A mesh's field is bound to them here too, so that attempts take no time for either.
    """
    problems = _cached_problems(
        task.hand, task.finger_names, _Kind(task.object.shape), len(task.obstacles)
    )
    begin = time.perf_counter()
    field = problems.grasp.surface.field_of(task.object.shape)
    problems.grasp.nlp.bind(field)
    problems.pregrasp.nlp.bind(field)
    return replace(problems, build_s=problems.build_s + time.perf_counter() - begin)


class _Kind:
    """A shape that compares by the NLP form of its kind, for the cache."""

    def __init__(self, shape: Shape) -> None:
        self.shape, self.kind = shape, surface_of(shape).kind

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Kind) and other.kind == self.kind

    def __hash__(self) -> int:
        return hash(self.kind)


@lru_cache(maxsize=16)
def _cached_problems(
    hand: Hand, finger_names: tuple[str, ...], kind: _Kind, n_obstacles: int
) -> Problems:
    begin = time.perf_counter()
    fingers = hand.choose_fingers(finger_names)
    grasp = build_problem(hand, fingers, kind.shape, n_obstacles)
    pregrasp = PregraspProblem(hand, fingers, kind.shape, n_obstacles)
    return Problems(grasp=grasp, pregrasp=pregrasp, build_s=time.perf_counter() - begin)


def attempts(
    task: GraspTask,
    *,
    seed: int = 0,
    options: SynthesisOptions | None = None,
) -> Iterator[Attempt]:
    """Endless independent attempts at a task; attempt i depends on ``seed`` and i alone.

    Raises:
        TaskError: The object cannot be grasped by this hand, found out before solving.
    """
    if not isinstance(seed, int | np.integer) or seed < 0:
        raise TaskError(f"seed is {seed!r}; give an integer >= 0")
    options = options or SynthesisOptions()
    whole = spared = _Ground.of(task)
    total = 0.0
    index = 0
    while True:
        if index == SPARE_AFTER and task.may_spare_fingers:
            spared = _Ground.of(task.with_fingers(whole.seeder.tripod))
        past = index - SPARE_AFTER
        ground = spared if past >= 0 and past % 2 == 0 else whole
        start_cpu = time.process_time()
        rng = np.random.default_rng([seed, index])
        outcome = _attempt(ground, rng, options)
        cpu = time.process_time() - start_cpu
        total += cpu
        if isinstance(outcome, str):
            yield Attempt(index=index, plan=None, reason=outcome, cpu_s=cpu)
        else:
            record = replace(
                outcome.record,
                seed=seed,
                attempt=index,
                attempts=index + 1,
                cpu_s=total,
                build_s=ground.problems.build_s,
            )
            plan = replace(outcome, record=record)
            yield Attempt(index=index, plan=plan, reason="", cpu_s=cpu)
        index += 1


def plan_grasp(
    task: GraspTask,
    *,
    seed: int = 0,
    max_attempts: int = DEFAULT_MAX_ATTEMPTS,
    max_cpu_s: float | None = None,
    options: SynthesisOptions | None = None,
    progress: Callable[[Attempt], None] | None = None,
) -> GraspPlan:
    """The first grasp that holds on the true geometry.

    Args:
        task: What to grasp, with what, where.
        seed: Same seed, same plan.
        max_attempts: Budget in attempts.
        max_cpu_s: Budget in CPU seconds, looked at between attempts; None for no limit.
        options: Margins and weights of the NLP.
        progress: Called after every attempt.

    Raises:
        NoGraspFoundError: The budget ended; carries every attempt and its reason.
        TaskError: The task cannot work, or a budget is not positive.
    """
    if max_attempts < 1:
        raise TaskError(f"max_attempts is {max_attempts}; give at least 1")
    if max_cpu_s is not None and not max_cpu_s > 0:
        raise TaskError(f"max_cpu_s is {max_cpu_s}; give seconds > 0")
    made: list[Attempt] = []
    used = 0.0
    for attempt in attempts(task, seed=seed, options=options):
        made.append(attempt)
        used += attempt.cpu_s
        if progress is not None:
            progress(attempt)
        if attempt.plan is not None:
            return attempt.plan
        if len(made) >= max_attempts or (max_cpu_s is not None and used >= max_cpu_s):
            break
    raise _nothing_found(task, tuple(made))


@dataclass(frozen=True)
class _Ground:
    """What all attempts at a task share."""

    task: GraspTask
    problems: Problems
    seeder: Seeder
    world: CollisionWorld

    @classmethod
    def of(cls, task: GraspTask) -> _Ground:
        seeder = seeder_for(task)
        return cls(task, problems_for(task), seeder, CollisionWorld(task))


def _attempt(
    ground: _Ground, rng: np.random.Generator, options: SynthesisOptions
) -> GraspPlan | str:
    """One attempt: a plan, or why not."""
    task, problems, seeder = ground.task, ground.problems, ground.seeder
    start = seeder.draw(rng)
    if isinstance(start, str):
        return start
    parameters = problems.grasp.parameters(
        shape=task.object.shape,
        start=start,
        table=table_in_object(task),
        obstacles=obstacles_in_object(task),
        mu=task.mu,
        posture=seeder.posture,
        options=options,
    )
    solution = problems.grasp.solve(
        start, parameters, problems.grasp.surface.field_of(task.object.shape)
    )
    worst = max(solution.violation, key=lambda k: solution.violation[k])
    if not solution.violation[worst] <= NLP_TOL:
        return f"not solved, term {worst}: violated by {solution.violation[worst]:.1e}"
    record = SolveRecord(
        seed=0,
        attempt=0,
        attempts=1,
        iterations=solution.iterations,
        status=solution.status,
        cpu_s=0.0,
        build_s=0.0,
    )
    q = np.clip(solution.q, task.hand.q_lower, task.hand.q_upper)
    T_world_base = task.T_world_object * solution.T_object_base
    q = settle(task, T_world_base, q)
    return judge_grasp(task, T_world_base, q, record=record, world=ground.world)


def judge_grasp(
    task: GraspTask,
    T_world_base: SE3,
    q: FloatArray,
    *,
    record: SolveRecord,
    approach: Approach | None = None,
    world: CollisionWorld | None = None,
) -> GraspPlan | str:
    """A plan out of a base pose and joints if everything holds on the true geometry; else why not.

    Args:
        task: The task.
        T_world_base: Base pose at the grasp.
        q: Joints (nq,), within their limits.
        record: Where the candidate comes from.
        approach: Pre-grasp and way in, checked; searched for if None.
        world: True geometry of the task, if it is at hand already.
    """
    world = world or CollisionWorld(task)
    verification = verify(world, T_world_base, q)
    if not verification.ok:
        return f"true geometry: {'; '.join(verification.faults)}"
    contacts = contacts_at(task, T_world_base, q)
    if edge := edge_fault(task, contacts):
        return f"edge: {edge}"
    closure = force_closure(contacts, edges=CLOSURE_EDGES)
    if not closure.closed:
        return f"no force closure: {closure.reason}"
    forces = plan_forces(task, contacts, T_world_base, q)
    if not forces.found:
        return f"forces: with {task.grip_force:.3g} N per finger, {forces.reason}"
    if approach is None:
        pregrasp = problems_for(task).pregrasp
        found = find_approach(world, pregrasp, T_world_base, q, contacts.normals)
        if isinstance(found, str):
            return f"approach: {found}"
        approach = found
    elif fault := approach_fault(world, T_world_base, q, approach):
        return f"approach: {fault}"
    return GraspPlan(
        task=task,
        T_world_base=T_world_base,
        T_world_base_start=approach.T_world_base_start,
        q=q,
        q_pregrasp=approach.q,
        opening=approach.opening,
        arm=approach.arm,
        contacts=forces.contacts,
        forces=forces,
        verification=verification,
        record=record,
    )


def edge_fault(task: GraspTask, contacts: ContactSet) -> str:
    """Which contact is on an edge of a mesh, "" for none.

    The NLP sees rounded edges. On the true one a pad that creeps by a millimetre meets another
    normal. Primitives need no look: their contacts keep away from edges by construction.
    """
    shape = task.object.shape
    if not isinstance(shape, Mesh):
        return ""
    local = contacts.transformed(task.T_world_object.inverse())
    for finger, point in zip(task.finger_names, local.positions, strict=True):
        spread = shape.normal_dispersion(point, EDGE_RADIUS)
        if spread > EDGE_SPREAD:
            return (
                f"{finger} is on an edge: normals differ by {np.rad2deg(spread):.0f} degrees "
                f"within {1e3 * EDGE_RADIUS:.0f} mm"
            )
    return ""


EDGE_RADIUS = 0.002
"""How far (m) around a contact normals are looked at: what a pad creeps and rolls in a grasp."""

EDGE_SPREAD = float(np.deg2rad(25.0))
"""Largest dispersion of normals there (rad); it is 45 degrees on a right-angled edge."""


def plan_forces(
    task: GraspTask, contacts: ContactSet, T_world_base: SE3, q: FloatArray, **options: Any
) -> ForceSolution:
    """Contact forces (world) that carry the object's weight, within torque limits, at a grasp.

    Args:
        task: Gives weight, friction and grip.
        contacts: One contact per finger of the task, world.
        T_world_base: Base pose.
        q: Joints (nq,).
        **options: Passed to ``distribute_forces``.
    """
    state = HandState(task.hand, q)
    inverse = T_world_base.inverse()
    rotation = T_world_base.rotation
    jacobians = np.array(
        [
            rotation @ state.point_jacobian(f.pad.joint_id, inverse.act(p)).reshape(2, 3, -1)
            for f, p in zip(task.fingers, contacts.positions, strict=True)
        ]
    ).reshape(len(contacts), 6, -1)
    return distribute_forces(
        contacts,
        wrench=gravity_wrench(task.object.mass, task.gravity),
        min_normal=task.grip_force,
        friction_scale=FRICTION_SHARE,
        jacobians=jacobians,
        actuation=task.hand.actuation,
        q=q,
        gravity_torque=state.gravity_torque(rotation.T @ task.gravity),
        **options,
    )
