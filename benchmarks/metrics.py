"""Simulate grasps of mixed quality: which metric predicts success.

Grades make plans of mixed quality, conditions make trials in which some fail. Both are fixed
tables, so that every metric is asked the same questions. All metrics are taken at one friction, so
that plans made for different ones compare; a grasp that is not closed there has epsilon 0.

An area under the ROC curve is the chance that a success has the larger number of a success and a
failure drawn at random, ties counting half: 0.5 is guessing, 1 is perfect.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import mujoco
import numpy as np
import typer
from scipy.stats import mannwhitneyu

from benchmarks.bench import HandOptions, ObjectsOption
from benchmarks.common import (
    PRIMITIVES,
    Setting,
    cells_of,
    clearance_of,
    half_longest_side,
    task_of,
)
from benchmarks.summary import table_data
from planner.errors import NoGraspFoundError
from planner.plan import GraspPlan
from planner.quality import analyse
from planner.quality.ball import epsilon_frogger
from planner.search.grasp import plan_grasp
from planner.spatial import FloatArray
from planner.synthesis.options import SynthesisOptions
from planner.task import DEFAULT_MU
from sim.cli.execution import error_model_of
from sim.cli.options import ErrorModelOption
from sim.report import TrialReport
from sim.scene.physics import PhysicsOptions
from sim.sensing.errors import ErrorModel
from sim.simulation import Simulation
from sim.tables import Row
from sim.trial import Timeline, Trial

SAME = "same task"
"""Column of pairs of the same hand, object and condition: which of two grasps of this object?"""


@dataclass(frozen=True, kw_only=True)
class Grade:
    """How a plan is made.

    Attributes:
        options: Of the search.
        mu: Friction that planning relies on (-).
    """

    options: SynthesisOptions
    mu: float = DEFAULT_MU


_LOOSE = SynthesisOptions(rounds=0, cone_share=0.95, weight_center=0.0)

GRADES = {
    "best": Grade(options=SynthesisOptions()),
    "plain": Grade(options=SynthesisOptions(rounds=0)),
    "loose": Grade(options=_LOOSE),
    "reckless": Grade(options=_LOOSE, mu=1.0),
}
"""From the planner's best to plans that accept any contacts and rely on a friction of 1, where the
trials have 0.6 or less."""


@dataclass(frozen=True, kw_only=True)
class Condition:
    """How a trial differs from the plan.

    Attributes:
        mu: Friction in simulation (-).
        mass_factor: True over planned mass (-).
        shift: Position error of the object in a random horizontal direction, m.
        push: Force that pushes the held object along six directions in turn, over its weight (-).
    """

    mu: float = 0.6
    mass_factor: float = 1.0
    shift: float = 0.0
    push: float = 0.0


CONDITIONS = {
    "as planned": Condition(),
    "slippery": Condition(mu=0.27),
    "heavy": Condition(mass_factor=3.0),
    "displaced": Condition(shift=0.015),
    "pushed": Condition(push=2.3),
}
"""All but the first make part of the grasps fail, each for another reason."""

TIMELINE = Timeline.quick(settle=0.1, hold=1.2)
"""Shorter than the default timeline: 2.8 s of simulated time instead of 5.3 s."""

RECORD_EVERY = 0.05
"""Time between samples, s: four samples for each direction of the push."""

DIRECTIONS = np.concatenate([np.eye(3), -np.eye(3)])
"""Directions of the push, world axes; each for a sixth of the hold."""

MAX_ATTEMPTS = 20
"""Attempts at a plan; a sample without one is not counted."""


def trial_under(
    plan: GraspPlan,
    condition: Condition,
    rng: np.random.Generator,
    record_every: float = RECORD_EVERY,
    error_model: ErrorModel | None = None,
) -> TrialReport:
    """A trial under a condition and an error model, with a sample every so often (s)."""
    item = plan.task.object
    heavier = replace(item, mass=condition.mass_factor * item.mass)
    changed = replace(plan, task=replace(plan.task, object=heavier))
    trial = Trial(
        changed,
        physics=PhysicsOptions(mu=condition.mu),
        timeline=TIMELINE,
        record_every=record_every,
        error_model=error_model,
    )
    angle = rng.uniform(0.0, 2 * np.pi)
    aside = condition.shift * np.array([np.cos(angle), np.sin(angle)])
    scene, data = trial.simulation.scene, trial.simulation.data
    data.qpos[scene.object_qpos[:2]] += aside
    mujoco.mj_forward(scene.model, data)
    weight = item.mass * float(np.linalg.norm(plan.task.gravity))
    return trial.run(on_step=_pusher(condition.push * weight * DIRECTIONS))


def _pusher(forces: FloatArray) -> Callable[[Simulation], None]:
    """Push with forces (6, 3), N, at the centre of mass, one after the other during the hold."""
    steps = 0

    def push(simulation: Simulation) -> None:
        nonlocal steps
        if simulation.phase == "hold":
            total = TIMELINE.hold / simulation.scene.physics.timestep
            k = min(len(forces) - 1, int(len(forces) * steps / total))
            simulation.data.xfrc_applied[simulation.scene.object_body, :3] = forces[k]
            steps += 1

    return push


LEAST = -1e3
"""What stands for minus infinity, which JSON does not have (-)."""


def predictors_of(plan: GraspPlan) -> dict[str, float]:
    """Every predictor of a plan (-, m or rad), larger is better."""
    task = plan.task
    contacts = plan.contacts.with_friction(DEFAULT_MU)
    radius = task.object.shape.bounding_radius
    report = analyse(contacts, length=radius)
    weight = task.object.mass * float(np.linalg.norm(task.gravity))
    off = np.linalg.norm(contacts.positions.mean(axis=0) - contacts.center)
    half_angles = np.array([f.pad.half_angle for f in task.fingers])
    values = {
        "min_weight": max(LEAST, report.closure.normalised_min_weight),
        "epsilon": report.epsilon,
        "epsilon_round": report.epsilon_round.lower,
        "epsilon_linf": report.epsilon_linf.lower,
        "epsilon_frogger": epsilon_frogger(
            contacts, half_longest_side=half_longest_side(task.object.shape)
        ),
        "volume": report.volume,
        "least_singular_value": report.smallest_singular_value,
        "isotropy": report.isotropy,
        "near_center": 1.0 - off / radius,
        "n_fingers": len(task.fingers),
        "friction_margin": 1.0 - contacts.friction_utilisation().max(),
        "torque_margin": _torque_margin(plan),
        "grip": contacts.forces[:, 0].min() / weight,
        "joint_margin": _joint_margin(plan),
        "pad_margin": (half_angles - plan.verification.pad_angles).min(),
        "clearance": clearance_of(plan),
    }
    return {name: float(value) for name, value in values.items()}


def _torque_margin(plan: GraspPlan) -> float:
    """1 - max |force / limit on its side|, over the hand's actuators."""
    low, high = plan.task.hand.actuation.force_limits(plan.q).T
    force = plan.forces.actuator_forces
    limit = np.where(force >= 0, high, low)
    with np.errstate(divide="ignore", invalid="ignore"):
        used = np.where(force == 0, 0.0, force / limit)
    return max(LEAST, float(1.0 - used.max()))


def _joint_margin(plan: GraspPlan) -> float:
    """Least distance of a finger's joint from its limits over its range."""
    hand = plan.task.hand
    index = np.concatenate([f.q_index for f in plan.task.fingers])
    q, low, high = plan.q[index], hand.q_lower[index], hand.q_upper[index]
    free = high > low
    return float((np.minimum(q - low, high - q)[free] / (high - low)[free]).min())


@dataclass(frozen=True, kw_only=True)
class Options(HandOptions):
    """Samples over all hands and objects."""

    n: Annotated[int, typer.Option("-n", "--number", min=1, help="Grasps in all.")] = 500
    objects: ObjectsOption = PRIMITIVES
    error_model: ErrorModelOption = "ideal"


def cases(options: Options) -> Iterator[Row]:
    """Cell after cell, in each of them conditions and grades equally often."""
    error_model = error_model_of(options.error_model)
    cells = list(cells_of(options.hand_names, options.objects))
    each = -(-options.n // len(cells))
    grades, conditions = list(GRADES), list(CONDITIONS)
    for index in range(options.n):
        turn, condition = divmod(index % each, len(conditions))
        made = {"grade": grades[turn % len(grades)], "condition": conditions[condition]}
        given = {"index": index, "seed": options.seed, "error_model": error_model}
        yield {**cells[index // each], **made, **given}


def measure(case: Row) -> Row:
    """Plan, note the predictors, execute."""
    rng = np.random.default_rng([case["seed"], case["index"]])
    grade = GRADES[case["grade"]]
    try:
        plan = plan_grasp(
            task_of(case["hand"], case["spec"], Setting(mu=grade.mu)),
            seed=int(rng.integers(2**62)),
            max_attempts=MAX_ATTEMPTS,
            options=grade.options,
        )
    except NoGraspFoundError:
        return {"found": False, "reason": "no plan"}
    error_model = case["error_model"].seeded(case["index"])
    verdict = trial_under(plan, CONDITIONS[case["condition"]], rng, error_model=error_model).verdict
    told = {"success": verdict.success, "reason": verdict.reason}
    return {"found": True, **told, "predictors": predictors_of(plan)}


def auc(
    values: FloatArray, success: Sequence[bool], groups: Sequence[Any] | None = None
) -> tuple[float, float | None] | None:
    """The area for values (n,), larger meaning better; None without a pair to compare.

    Args:
        values: The predictor.
        success: What happened, n.
        groups: Compare only within these, n; all with all if None.

    Returns:
        Area, in [0, 1], and standard error (Hanley and McNeil, Radiology 143, 1982, equation 1);
        None for pairs within groups, which that does not cover.
    """
    won = np.asarray(success, dtype=bool)
    wins, pairs = 0.0, 0
    labels = [None] * len(won) if groups is None else list(groups)
    for label in dict.fromkeys(labels):
        here = np.array([g == label for g in labels])
        good, bad = values[here & won], values[here & ~won]
        if len(good) and len(bad):
            wins += float(mannwhitneyu(good, bad, method="asymptotic").statistic)
            pairs += len(good) * len(bad)
    if not pairs:
        return None
    area, n_good = wins / pairs, int(won.sum())
    if groups is not None:
        return area, None
    n_bad, q1, q2 = len(won) - n_good, area / (2 - area), 2 * area**2 / (1 + area)
    variance = area * (1 - area) + (n_good - 1) * (q1 - area**2) + (n_bad - 1) * (q2 - area**2)
    return area, math.sqrt(max(0.0, variance / (n_good * n_bad)))


def tables(result: Row) -> Iterator[Row]:
    """One row per predictor, best first by the pairs of the same task."""
    rows = [row for row in result["rows"] if row.get("found")]
    won = [row["success"] for row in rows]

    def held(some: Sequence[Row]) -> str:
        return f"{sum(row['success'] for row in some)}/{len(some)}"

    def area(name: str, some: Sequence[Row], same: bool = False) -> tuple[float, float | None]:
        values = np.array([row["predictors"][name] for row in some])
        groups = [(r["hand"], r["object"], r["condition"]) for r in some] if same else None
        return auc(values, [row["success"] for row in some], groups) or (math.nan, None)

    by = {c: [row for row in rows if row["condition"] == c] for c in CONDITIONS}
    lines = []
    for name in rows[0]["predictors"] if rows else ():
        every, alike = area(name, rows), area(name, rows, same=True)[0]
        cells = [every[0], every[1], alike, *(area(name, some)[0] for some in by.values())]
        shown = ["-" if v is None or math.isnan(v) else f"{v:.2f}" for v in cells]
        lines.append((0.0 if math.isnan(alike) else alike, [name, *shown]))
    told = [held(some) for some in by.values()]
    yield table_data(
        f"area under the ROC curve, {len(rows)} grasps, {sum(won)} held (0.5 is guessing); same "
        "task: pairs of one hand, object and condition",
        ("metric",),
        ("all", "+-", SAME, *CONDITIONS),
        [
            *(line for _, line in sorted(lines, key=lambda pair: -pair[0])),
            ["held", held(rows), "", "", *told],
        ],
    )
