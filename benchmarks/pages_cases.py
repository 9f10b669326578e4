"""Random reports for ``bench pages``: plans, trials and manipulations, successes and failures."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np

from benchmarks.trials import CONDITIONS, trial_under
from planner.errors import PlannerError
from planner.motion.manipulation import ManipulationPlan, manipulation_task, plan_manipulation
from planner.objects import parse_object
from planner.pages.plan_page import RATE
from planner.pages.scene import pose_row, pose_rows
from planner.plan import GraspPlan
from planner.search import plan_grasp
from planner.spatial import FloatArray
from planner.task import GraspTask
from sim.manipulation import ManipulationTimeline, Push, manipulate, rests, settled
from sim.manipulation.page import manipulation_page
from sim.physics import PhysicsOptions
from sim.recording import Recording

ReportKind: TypeAlias = Literal["plan", "trial", "without forces", "manipulation", "full turn"]

KINDS: dict[ReportKind, float] = {
    "plan": 0.18,
    "trial": 0.58,
    "without forces": 0.02,
    "manipulation": 0.2,
    "full turn": 0.02,
}
"""Kind of report -> its share."""

HANDS = (
    "allegro_hand",
    "allegro_hand_left",
    "shadow_hand",
    "shadow_hand_left",
    "shadow_hand_torque",
    "allegro_on_arm7",
    "shadow_on_arm7",
)

OBJECTS = (
    "sphere",
    "box",
    "cylinder",
    "capsule",
    "ellipsoid",
    "mug",
    "lbracket",
    "torus",
    "hammer",
    "superquadric",
    "knot",
    "box:0.04x0.06x0.1",
    "cylinder:0.025x0.12",
    "sphere:0.028",
)

TURNS: dict[str, tuple[str, str, float, bool]] = {
    "turn": ("allegro_hand", "cylinder:0.03x0.08", 25.0, False),
    "turn of a block": ("allegro_hand", "box:0.05x0.05x0.08", 20.0, False),
    "turn back": ("shadow_hand", "cylinder:0.03x0.08", -20.0, False),
    "two strokes": ("allegro_hand", "cylinder:0.03x0.08", 50.0, True),
}
"""Manipulations by name: hand, object, degrees, and whether by strokes. Planned once each."""

FULL_TURN = ("allegro_hand", "cylinder:0.03x0.08", 360.0, True)

SLIPPERY, HEAVY, PUSH = 0.2, 3.0, 3.0
"""Friction (-), mass over the planned one, and push (N) of manipulations that may fail."""

QUICK = ManipulationTimeline(
    approach=0.4, close=0.3, squeeze=0.3, verify=0.1, lift=0.4, carry=0.5, lower=0.4, open=0.3
)

MAX_ATTEMPTS, MOST_DRAWS = 6, 12
"""Attempts at a plan, and tasks that are drawn until there is one."""


@dataclass(frozen=True, kw_only=True, eq=False)
class States:
    """What a page must show: m samples.

    Attributes:
        time: (m,), s.
        q: (m, nq).
        T_world_base: (m, 7).
        T_world_object: (m, 7).
    """

    time: FloatArray
    q: FloatArray
    T_world_base: FloatArray
    T_world_object: FloatArray

    @classmethod
    def of(cls, recording: Recording) -> States:
        """Of a recording."""
        return cls(**{name: getattr(recording, name) for name in cls.__dataclass_fields__})


@dataclass(frozen=True, kw_only=True, eq=False)
class Made:
    """A report that is to become a page.

    Attributes:
        task: Hand and object.
        condition: Under what it was made.
        outcome: What came of it.
        states: What the page must show; None for one without a motion.
        fault: When it went wrong, where the page must open, s; None if nothing did.
        write: Writes the page.
    """

    task: GraspTask
    condition: str
    outcome: str
    states: States | None
    fault: float | None
    write: Callable[[Path], None]


def make_report(kind: ReportKind, rng: np.random.Generator) -> Made:
    """A random report of a kind.

    Raises:
        PlannerError: There is no plan for any of the tasks that were drawn.
    """
    if kind == "manipulation":
        return _manipulation(TURNS[str(rng.choice(list(TURNS)))], rng)
    if kind == "full turn":
        return _manipulation(FULL_TURN, rng, conditions=("as planned", "heavy"))
    plan = _plan(rng)
    if kind == "plan":
        return _of_plan(plan)
    return _trial(plan, rng, forces=kind == "trial")


def _plan(rng: np.random.Generator) -> GraspPlan:
    """A plan for a random hand and object."""
    for _ in range(MOST_DRAWS):
        hand, spec = str(rng.choice(HANDS)), str(rng.choice(OBJECTS))
        try:
            task = GraspTask.create(hand, parse_object(spec))
            return plan_grasp(task, seed=int(rng.integers(1000)), max_attempts=MAX_ATTEMPTS)
        except PlannerError:
            continue
    raise PlannerError(f"no plan in {MOST_DRAWS} tasks")


def _of_plan(plan: GraspPlan) -> Made:
    way = plan.joint_trajectory(rate_hz=RATE)
    states = States(
        time=way.times,
        q=np.array(way.positions),
        T_world_base=pose_rows(way.T_world_base),
        T_world_object=np.tile(pose_row(plan.task.T_world_object), (len(way.times), 1)),
    )
    return Made(
        task=plan.task,
        condition="as planned",
        outcome="planned",
        states=states,
        fault=None,
        write=plan.save_html,
    )


def _trial(plan: GraspPlan, rng: np.random.Generator, *, forces: bool) -> Made:
    condition = str(rng.choice(list(CONDITIONS))) if forces else "without forces"
    if not forces:
        missing = replace(plan.forces, found=False, reason="left out on purpose")
        plan = replace(plan, forces=missing)
    wanted = CONDITIONS[condition] if forces else CONDITIONS["as planned"]
    report = trial_under(plan, wanted, rng, record_every=0.02)
    recorded = len(report.recording) > 0
    return Made(
        task=plan.task,
        condition=condition,
        outcome=report.reason or "held",
        states=States.of(report.recording) if recorded else None,
        fault=report.verdict.time if recorded and not report.success else None,
        write=report.save_html,
    )


def _manipulation(
    what: tuple[str, str, float, bool],
    rng: np.random.Generator,
    conditions: tuple[str, ...] = ("as planned", "slippery", "heavy", "pushed"),
) -> Made:
    plan, condition = _turn(what), str(rng.choice(conditions))
    task, push, physics = plan.task, None, PhysicsOptions()
    if condition == "slippery":
        physics = PhysicsOptions(mu=SLIPPERY)
    if condition == "heavy":
        task = replace(task, object=replace(task.object, mass=HEAVY * task.object.mass))
    if condition == "pushed":
        angle = rng.uniform(0.0, 2.0 * np.pi)
        force = PUSH * np.array([np.cos(angle), np.sin(angle), 0.0])
        push = Push(force=force, after=0.1, duration=0.2)
    report = manipulate(
        plan,
        true_task=task,
        physics=physics,
        push=push,
        timeline=QUICK,
        retry=bool(rng.integers(2)),
    )
    scene = manipulation_page(report.to_file(), task).scene
    assert scene is not None
    recording = report.recording
    if report.earlier is not None:
        earlier = report.earlier.recording
        recording = earlier.joined(recording, float(earlier.time[-1]))
    good = report.complete and report.success_with_closure
    return Made(
        task=task,
        condition=condition,
        outcome="complete" if report.complete else report.reason.split(":")[0],
        states=States.of(recording),
        fault=None if good else scene.start,
        write=report.save_html,
    )


@cache
def _turn(what: tuple[str, str, float, bool]) -> ManipulationPlan:
    hand, spec, degrees, strokes = what
    return plan_manipulation(
        settled(manipulation_task(hand, parse_object(spec), mu=0.45)),
        angle=math.radians(degrees),
        place=(0.04, -0.02),
        regrasp=strokes,
        rests=rests,
    )
