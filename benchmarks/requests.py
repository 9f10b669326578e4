"""One requested grasp, measured: attempts until one is found, and what they cost by stage.

Request k of an object has the seed that ``planner.batch`` gives it, so that what is measured here
is what ``opposable batch`` would plan. CPU time is that of the process with all its threads; what
a task's attempts share (mesh, field, problems) is told apart from the attempts.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from benchmarks.objects import BenchObject
from planner.approach.pregrasp import APPROACH_KINDS
from planner.batch import GraspFeatures
from planner.batch.pool import grasp_seed
from planner.collision.world import OBJECT
from planner.errors import PlannerError, TaskError
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.numerics.kernels import compiled_searches
from planner.objects import parse_object
from planner.plan import GraspPlan
from planner.quality.ball import epsilon_frogger, epsilon_l1
from planner.search import DEFAULT_MAX_ATTEMPTS, Attempt, attempts
from planner.shapes import Mesh, Shape, shape_key
from planner.synthesis.options import SynthesisOptions
from planner.system.threads import timed
from planner.task import DEFAULT_MU, GraspTask

APPROACH = "approach"
"""The stage that is the last check of an attempt."""


@dataclass(frozen=True, kw_only=True)
class Setting:
    """What all requests of a measurement share.

    Attributes:
        mu: Sliding friction that planning relies on (-).
        fingers: Fingers that take part; None for the hand's default, of which some may be spared.
        floating: Whether there is no table.
        joint_error: Standard deviation of the encoders' errors that planning reckons with, rad.
        clearance: Distance (m) below which a found grasp counts as failed: of object and links
            that carry no pad, and between links. 0 asks for no more than that nothing penetrates.
        rounds: Rounds that strengthen a grasp; the planner's default if None.
        max_attempts: Attempts per request.
        seed: Seed of the measurement.
    """

    mu: float = DEFAULT_MU
    fingers: tuple[str, ...] | None = None
    floating: bool = False
    joint_error: float = 0.0
    clearance: float = 0.0
    rounds: int | None = None
    max_attempts: int = DEFAULT_MAX_ATTEMPTS
    seed: int = 0

    @property
    def options(self) -> SynthesisOptions:
        """The planner's options."""
        return SynthesisOptions() if self.rounds is None else SynthesisOptions(rounds=self.rounds)


@dataclass(frozen=True, kw_only=True)
class Request:
    """One requested grasp, as it is sent to a worker.

    Attributes:
        hand: The hand's name or path.
        spec: The object.
        k: Number of the grasp among those of this hand and object.
        setting: What all requests share.
    """

    hand: str
    spec: str
    k: int
    setting: Setting


@dataclass(frozen=True, kw_only=True)
class RequestOutcome:
    """What a request cost and gave.

    Attributes:
        k: Its number.
        error: Why it could not be tried, "" if it was.
        found: Whether a grasp was found.
        attempts: Attempts made.
        cpu_s: CPU time of all of them, s.
        prepare_s: CPU time of what this request had to prepare for itself and later ones, s.
        first_s: CPU time to the first grasp in a process of its own with an empty cache, s: see
            ``benchmarks.first_grasp``. None where it was not measured, or none was found.
        stages: CPU time of the attempts by stage, s.
        without_approach: Attempts that passed every check but the way in, or that one too; None
            where a clearance is asked for, which only whole plans tell.
        reasons: How many attempts failed for which reason, by the kind of their failure.
        n_fingers: Fingers of the grasp found, 0 without.
        epsilon: L1 epsilon, 8 edges, torque over the bounding radius; None without a grasp.
        epsilon_frogger: In the baseline's definition.
        clearance_mm: ``clearance_of`` the grasp.
        features: What the grasp is compared by.
    """

    k: int
    error: str = ""
    found: bool = False
    attempts: int = 0
    cpu_s: float = 0.0
    prepare_s: float = 0.0
    first_s: float | None = None
    stages: dict[str, float] = field(default_factory=dict)
    without_approach: int | None = None
    reasons: dict[str, int] = field(default_factory=dict)
    n_fingers: int = 0
    epsilon: float | None = None
    epsilon_frogger: float | None = None
    clearance_mm: float | None = None
    features: GraspFeatures | None = None


def outcome_of(
    request: Request, check: Callable[[], None] = lambda: None, *, compiled: bool = True
) -> RequestOutcome:
    """Make a request.

    Args:
        request: What is wanted.
        check: Called after every attempt; what it raises ends the request.
        compiled: Whether kernels are compiled from the first attempt, as in batches.
    """
    loaded_hand(request.hand)  # once per hand, no matter of the object
    begin = time.process_time()
    task = task_for(request.hand, request.spec, request.setting)
    if isinstance(task, str):
        return RequestOutcome(k=request.k, error=task)
    made = time.process_time() - begin
    outcome = outcome_of_task(task, request.k, request.setting, check, compiled=compiled)
    return replace(outcome, prepare_s=outcome.prepare_s + made)


_loaded: set[tuple[bool, bool]] = set()
"""Kinds of problems for which this process has loaded what is compiled."""


def _load_kernels(task: GraspTask, setting: Setting) -> None:
    """One attempt, once per process and kind of problem, that loads compiled kernels.

    Loading takes about a second and belongs to no grasp: it counts as preparation.
    """
    kind = (isinstance(task.object.shape, Mesh), setting.options.rounds > 0)
    if kind not in _loaded:
        _loaded.add(kind)
        # a task that cannot work is told by the request itself
        with suppress(PlannerError), compiled_searches():
            next(attempts(task, seed=setting.seed, options=setting.options))


def outcome_of_task(
    task: GraspTask,
    k: int,
    setting: Setting,
    check: Callable[[], None] = lambda: None,
    *,
    compiled: bool = True,
) -> RequestOutcome:
    """Make request k of a task.

    Args:
        task: The task.
        k: Number of the request; with ``setting.seed`` and the shape it fixes the starts.
        setting: Options, clearance and attempts; the rest is the task's.
        check: Called after every attempt; what it raises ends the request.
        compiled: Whether kernels are compiled from the first attempt, as in batches.
    """
    shape = task.object.shape
    seed = grasp_seed(setting.seed, shape_key(shape), k)
    begin = time.process_time()
    if compiled:
        _load_kernels(task, setting)
    made: list[Attempt[GraspPlan]] = []
    reasons: list[str] = []
    plan = None
    with timed() as stages, compiled_searches() if compiled else nullcontext():
        try:
            for attempt in attempts(task, seed=seed, options=setting.options):
                made.append(attempt)
                plan, reason = _cleared(attempt, setting.clearance)
                reasons.append(reason)
                check()
                if plan is not None or len(made) >= setting.max_attempts:
                    break
        except PlannerError as error:
            return RequestOutcome(k=k, error=str(error))
    cpu = sum(a.cpu_s for a in made)
    outcome = RequestOutcome(
        k=k,
        attempts=len(made),
        cpu_s=cpu,
        prepare_s=max(0.0, time.process_time() - begin - cpu),
        stages=dict(stages),
        without_approach=(
            sum(r == "" or r in APPROACH_KINDS for r in reasons) if setting.clearance == 0 else None
        ),
        reasons=dict(Counter(r for r in reasons if r)),
    )
    if plan is None:
        return outcome
    return replace(
        outcome,
        found=True,
        n_fingers=len(plan.task.finger_names),
        epsilon=epsilon_l1(plan.contacts, length=shape.bounding_radius),
        epsilon_frogger=epsilon_frogger(plan.contacts, half_longest_side=half_longest_side(shape)),
        clearance_mm=1e3 * clearance_of(plan),
        features=GraspFeatures.of_plans([plan]),
    )


def _cleared(attempt: Attempt[GraspPlan], clearance: float) -> tuple[GraspPlan | None, str]:
    """The plan of an attempt if it keeps its distance, and the kind of failure if there is none."""
    if attempt.plan is None:
        return None, "" if attempt.failure is None else attempt.failure.kind
    if clearance > 0 and clearance_of(attempt.plan) < clearance:
        return None, "clearance"
    return attempt.plan, ""


def clearance_of(plan: GraspPlan) -> float:
    """Least distance (m) of what must not touch, the object from links that carry pads left out.

    Those links are near the object wherever they touch it. Where they are all that was noted, their
    largest distance is returned, and the true one is no less.
    """
    hand = plan.task.hand
    joints = {finger.pad.joint_id for finger in plan.task.fingers}
    carriers = {g.name for g in hand.geometries if g.joint_id in joints}
    noted = plan.verification.closest
    for pair in noted:
        if not (pair.second == OBJECT and pair.first in carriers):
            return pair.distance
    return noted[-1].distance if noted else float("inf")


def half_longest_side(shape: Shape) -> float:
    """Half the longest side (m) of a shape's bounding box in its own axes."""
    return max(0.5 * (shape.support(a) + shape.support(-a)) for a in np.eye(3))


def check_tasks(hands: Iterable[str], objects: Sequence[BenchObject]) -> None:
    """Make the task of every hand and object: bad input ends here, not after minutes.

    Raises:
        PlannerError: A hand, or an object that was named, cannot be used; one out of a folder may
            fail.
    """
    for hand in hands:
        loaded_hand(hand)
        for item in objects:
            task = task_for(hand, item.spec, Setting())
            if isinstance(task, str) and not item.may_fail:
                raise TaskError(task)


@lru_cache(maxsize=16)
def loaded_hand(name: str) -> Hand:
    """A hand, loaded once per process."""
    return load_hand(name)


@lru_cache(maxsize=32)
def task_for(hand: str, spec: str, setting: Setting) -> GraspTask | str:
    """The task of a hand and an object, made once per process; or why it cannot be made."""
    try:
        return GraspTask.create(
            loaded_hand(hand),
            parse_object(spec),
            table_height=None if setting.floating else 0.0,
            mu=setting.mu,
            fingers=setting.fingers,
            joint_error=setting.joint_error,
        )
    except PlannerError as error:
        return str(error)
