"""``run_physics``: what default grasps do under named physics, and how fast they creep.

Four parts. ``holds`` and ``closed`` execute every grasp under every preset, in the open and the
closed loop. ``remedies`` executes it under MuJoCo's defaults with one change each, sized by
``sim.creep``. ``creep`` holds it for a second under variants of one number and compares its speed
in the palm with the formula there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

from planner.errors import NotFoundError, PlannerError
from planner.plain import finite
from planner.plan import GraspPlan
from planner.search import plan_grasp
from planner.verification.grasp import plan_forces
from sim.bench.journal import run_with_journal
from sim.bench.objects import BenchObject
from sim.bench.physics_variants import SOFT, VARIANTS
from sim.bench.requests import Setting, check_tasks, task_for
from sim.creep import CREEP_BUDGET, Remedy, least_creep, remedies
from sim.physics import PRESETS, PhysicsOptions
from sim.protocols.creep import measure_creep
from sim.runner import Check, Runner, made_with
from sim.scene import build_scene
from sim.trial import simulate

__all__ = [
    "NO_SUCH_GRIP",
    "PARTS",
    "VARIANTS",
    "PhysicsJob",
    "physics_jobs",
    "physics_row",
    "run_physics",
]

FORMAT = "opposable-bench-physics"

NO_SUCH_GRIP = "the hand cannot press so hard"
"""Why there is no creep to measure with a firmer grip."""


@dataclass(frozen=True, kw_only=True)
class PhysicsJob:
    """One grasp under one physics, as it is sent to a worker.

    Attributes:
        index: Its number.
        part: Name out of ``PARTS``.
        hand: Name or path.
        spec: The object.
        label: What it is called.
        case: What is done in this part: a preset, a remedy or a variant.
    """

    index: int
    part: str
    hand: str
    spec: str
    label: str
    case: str


def _hold(plan: GraspPlan, case: str) -> dict[str, Any]:
    return _trial(plan, PRESETS[case], "feedforward")


def _closed(plan: GraspPlan, case: str) -> dict[str, Any]:
    return _trial(plan, PRESETS[case], "impedance")


def _remedy(plan: GraspPlan, case: str) -> dict[str, Any]:
    """Under the change of MuJoCo's defaults that the formula asks for."""
    changes = {change.kind: change for change in _changes(plan)}
    if case not in changes:
        return {"held": False, "reason": "there is no such remedy for this grasp"}
    return {**_trial(plan, changes[case].physics, "feedforward"), "what": changes[case].what}


def _changes(plan: GraspPlan) -> tuple[Remedy, ...]:
    scene = build_scene(plan.task, T_world_base=plan.T_world_base, q=plan.q, physics=SOFT)
    names = plan.task.finger_names
    return remedies(SOFT, lambda physics: least_creep(scene, names, physics), CREEP_BUDGET)


def _trial(plan: GraspPlan, physics: PhysicsOptions, loop: str) -> dict[str, Any]:
    report = simulate(plan, physics=physics, controller=loop)
    moved, turned = report.largest_slip
    row: dict[str, Any] = finite(
        {
            "physics": physics.label,
            "held": report.success,
            "reason": report.reason,
            "slip_mm": moved,
            "slip_deg": turned,
        }
    )
    return row


def _creep(plan: GraspPlan, case: str) -> dict[str, Any]:
    """Speed of the object in the palm, and what the formula says of the contacts there were."""
    variant = VARIANTS[case]
    pressed = _gripped(plan, variant.grip)
    if pressed is None:
        return {"error": NO_SUCH_GRIP}
    seen = measure_creep(pressed, variant.physics)
    if seen.lost:
        return {"error": "lost"}
    row: dict[str, Any] = finite(
        {
            "creep_mm_s": 1e3 * seen.measured,
            "predicted_mm_s": 1e3 * seen.predicted,
            "least_mm_s": 1e3 * seen.least,
        }
    )
    return row


def _gripped(plan: GraspPlan, factor: float) -> GraspPlan | None:
    """The plan with forces of a firmer grip; None if there are none."""
    if factor == 1.0:
        return plan
    task = replace(plan.task, grip_force=factor * plan.task.grip_force)
    forces = plan_forces(task, plan.contacts, plan.T_world_base, plan.q)
    if not forces.found:
        return None
    return replace(plan, task=task, forces=forces, contacts=forces.contacts)


REMEDIES = ("noslip", "impratio", "contacts")
"""Kinds of changes of ``sim.creep.remedies``."""

PARTS: Mapping[str, tuple[Callable[[GraspPlan, str], dict[str, Any]], tuple[str, ...]]] = (
    MappingProxyType(
        {
            "holds": (_hold, tuple(PRESETS)),
            "closed": (_closed, tuple(PRESETS)),
            "remedies": (_remedy, REMEDIES),
            "creep": (_creep, tuple(VARIANTS)),
        }
    )
)
"""Name -> what measures a case, and the cases."""


def physics_jobs(
    hands: Sequence[str], objects: Sequence[BenchObject], parts: Iterable[str]
) -> list[PhysicsJob]:
    """The jobs, grasp by grasp, numbered whatever parts are asked for.

    Raises:
        NotFoundError: There is no such part.
    """
    asked = list(parts)
    for part in asked:
        if part not in PARTS:
            raise NotFoundError("part", part, PARTS)
    every = [(part, case) for part, (_, cases) in PARTS.items() for case in cases]
    cells = [(hand, item) for hand in hands for item in objects]
    return [
        PhysicsJob(
            index=len(every) * k + i,
            part=part,
            hand=hand,
            spec=item.spec,
            label=item.label,
            case=case,
        )
        for k, (hand, item) in enumerate(cells)
        for i, (part, case) in enumerate(every)
        if part in asked
    ]


def physics_row(job: PhysicsJob, check: Check) -> dict[str, Any]:
    """The row of a job, as plain data.

    Args:
        job: Which.
        check: Called before and after the trial; what it raises ends it.
    """
    plan = _plan(job.hand, job.spec)
    check()
    if isinstance(plan, str):
        return _row(job, error=plan)
    measure, _ = PARTS[job.part]
    measured = measure(plan, job.case)
    check()
    return _row(job, **measured)


def run_physics(
    hands: Sequence[str],
    objects: Sequence[BenchObject],
    parts: Sequence[str],
    *,
    file: Path,
    runner: Runner,
) -> dict[str, Any]:
    """Measure what the file does not have yet.

    Args:
        hands: Names or paths.
        objects: The objects; of every hand and object the grasp of seed 0 is taken.
        parts: Out of ``PARTS``.
        file: Of the rows; made if it is not there.
        runner: Who works on them.

    Returns:
        Plain data: the rows that were asked for, and what they were made with.

    Raises:
        NotFoundError: There is no such part.
        FileFormatError: The file is not one of these, or was begun with other arguments.
        PlannerError: A hand or an object that was named cannot be used.
    """
    jobs = physics_jobs(hands, objects, parts)
    check_tasks(hands, objects)
    asked = {
        "format": f"{FORMAT}-rows",
        "version": 1,
        "hands": list(hands),
        "objects": [item.spec for item in objects],
    }
    rows, whole = run_with_journal(
        runner,
        physics_row,
        jobs,
        file=file,
        asked=asked,
        title="physics",
        given_up=lambda job, reason: _row(job, error=reason),
    )
    wanted = {job.index for job in jobs}
    return {
        "format": FORMAT,
        "version": 1,
        **made_with(),
        "workers": runner.workers,
        "interrupted": not whole,
        "physics": {name: preset.to_dict() for name, preset in PRESETS.items()},
        "rows": sorted((r for r in rows if r["index"] in wanted), key=lambda r: int(r["index"])),
    }


@lru_cache(maxsize=2)
def _plan(hand: str, spec: str) -> GraspPlan | str:
    """The grasp of seed 0, made once for the cases that follow each other; or why there is none."""
    task = task_for(hand, spec, Setting())
    if isinstance(task, str):
        return task
    try:
        return plan_grasp(task, seed=0)
    except PlannerError as error:
        return str(error)


def _row(job: PhysicsJob, **values: Any) -> dict[str, Any]:
    return {
        "index": job.index,
        "part": job.part,
        "hand": job.hand,
        "object": job.label,
        "case": job.case,
        "error": "",
        **values,
    }
