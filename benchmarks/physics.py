"""``run_physics``: what default grasps do under named physics, and how fast they creep.

Four parts. ``holds`` and ``closed`` execute every grasp under every preset, in the open and the
closed loop. ``remedies`` executes it under MuJoCo's defaults with one change each, sized by
``sim.creep``. ``creep`` holds it for a second under variants of one number and compares its speed
in the palm with the formula there.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import ClassVar, TypeAlias

from rich.table import Table

from benchmarks.objects import BenchObject
from benchmarks.physics_variants import SOFT, VARIANTS
from benchmarks.planned import PlannedJob, ask, run_parts
from benchmarks.run import stated
from benchmarks.statistics import median_of, quantile_of
from planner.errors import NotFoundError
from planner.plan import GraspPlan
from planner.verification.grasp import plan_forces
from sim.creep import CREEP_BUDGET, least_creep, remedies
from sim.physics import PRESETS, PhysicsOptions
from sim.protocols.creep import measure_creep
from sim.reality import Reality
from sim.runner import Check, Runner
from sim.scene import build_scene
from sim.tables import Row, grouped, number, share, summary_table, table_of
from sim.trial import simulate

Measure: TypeAlias = Callable[[GraspPlan, str, Reality], Row]
"""Measures a case with a grasp, under a reality."""

NO_SUCH_GRIP = "the hand cannot press so hard"
"""Why there is no creep to measure with a firmer grip."""


@dataclass(frozen=True, kw_only=True)
class PhysicsJob(PlannedJob):
    """One grasp under one physics.

    Attributes:
        case: What is done in this part: a preset, a remedy or a variant.
    """

    SHOWN: ClassVar = ("part", "hand", "label", "case")

    case: str


def _hold(plan: GraspPlan, case: str, reality: Reality) -> Row:
    return _trial(plan, PRESETS[case], "feedforward", reality)


def _closed(plan: GraspPlan, case: str, reality: Reality) -> Row:
    return _trial(plan, PRESETS[case], "impedance", reality)


def _remedy(plan: GraspPlan, case: str, reality: Reality) -> Row:
    """Under the change of MuJoCo's defaults that the formula asks for."""
    scene = build_scene(plan.task, T_world_base=plan.T_world_base, q=plan.q, physics=SOFT)
    names = plan.task.finger_names
    found = remedies(SOFT, lambda physics: least_creep(scene, names, physics), CREEP_BUDGET)
    for change in found:
        if change.kind == case:
            trial = _trial(plan, change.physics, "feedforward", reality)
            return {**trial, "what": change.what}
    return {"held": False, "reason": "there is no such remedy for this grasp"}


def _trial(plan: GraspPlan, physics: PhysicsOptions, loop: str, reality: Reality) -> Row:
    report = simulate(plan, physics=physics, controller=loop, reality=reality)
    moved, turned = report.largest_slip
    outcome = {"physics": physics.label, "held": report.success, "reason": report.reason}
    return outcome | {"slip_mm": moved, "slip_deg": turned}


def _creep(plan: GraspPlan, case: str, reality: Reality) -> Row:
    """Speed of the object in the palm, and what the formula says of the contacts there were.

    Nothing is off whatever the reality: the formula is about what is planned.
    """
    del reality
    variant = VARIANTS[case]
    pressed = _gripped(plan, variant.grip)
    if pressed is None:
        return {"error": NO_SUCH_GRIP}
    seen = measure_creep(pressed, variant.physics)
    if seen.lost:
        return {"error": "lost"}
    speeds = {"creep": seen.measured, "predicted": seen.predicted, "least": seen.least}
    return {f"{name}_mm_s": 1e3 * speed for name, speed in speeds.items()}


def _gripped(plan: GraspPlan, factor: float) -> GraspPlan | None:
    """The plan with forces of a firmer grip; None if there are none."""
    if factor == 1.0:
        return plan
    task = replace(plan.task, grip_force=factor * plan.task.grip_force)
    forces = plan_forces(task, plan.contacts, plan.T_world_base, plan.q)
    if not forces.found:
        return None
    return replace(plan, task=task, forces=forces, contacts=forces.contacts)


PARTS: Mapping[str, tuple[Measure, tuple[str, ...]]] = MappingProxyType(
    {
        "holds": (_hold, tuple(PRESETS)),
        "closed": (_closed, tuple(PRESETS)),
        "remedies": (_remedy, ("noslip", "impratio", "contacts")),
        "creep": (_creep, tuple(VARIANTS)),
    }
)
"""Name -> function that measures a case, and the cases."""


def physics_jobs(
    hands: Sequence[str],
    objects: Sequence[BenchObject],
    parts: Iterable[str],
    reality: Reality | None = None,
) -> list[PhysicsJob]:
    """The jobs, grasp by grasp, numbered whatever parts are asked for.

    Raises:
        NotFoundError: There is no such part.
    """
    asked = list(parts)
    for part in asked:
        if part not in PARTS:
            raise NotFoundError("part", part, PARTS)
    cells = [(hand, item) for hand in hands for item in objects]
    every = [(*c, part, case) for c in cells for part in PARTS for case in PARTS[part][1]]
    return [
        PhysicsJob(
            index=k,
            part=part,
            hand=hand,
            spec=item.spec,
            label=item.label,
            case=case,
            reality=reality or Reality(),
        )
        for k, (hand, item, part, case) in enumerate(every)
        if part in asked
    ]


def physics_row(job: PhysicsJob, check: Check) -> Row:
    """The row of a job; the arguments are those of ``ask``."""
    return ask(job, check, lambda plan: PARTS[job.part][0](plan, job.case, job.reality))


def run_physics(
    hands: Sequence[str],
    objects: Sequence[BenchObject],
    parts: Sequence[str],
    *,
    file: Path,
    runner: Runner,
    reality: Reality | None = None,
) -> Row:
    """Measure the grasp of seed 0 of every hand and object, part by part (``benchmarks``)."""
    reality = reality or Reality()
    return run_parts(
        runner,
        physics_row,
        physics_jobs(hands, objects, parts, reality),
        hands,
        objects,
        kind="opposable-bench-physics",
        title="physics",
        file=file,
        drawn=stated(reality),
        physics={name: preset.to_dict() for name, preset in PRESETS.items()},
        **stated(reality),
    )


TITLES = {
    "holds": "held in the open loop, by physics",
    "closed": "held in the closed loop, by physics",
    "remedies": "held under mujoco-default with one change",
}

CREEP_TITLE = (
    "creep of the held object, medians in mm/s: measured; by the formula; by it however firm the "
    "grip; noslip is not in it"
)


def physics_tables(result: Row) -> list[Table]:
    """Of each part that has rows: how many grasps held and why others did not, and every grasp."""
    parts = {part: rows for (part,), rows in grouped(result["rows"], "part").items()}
    out = []
    for part, title in TITLES.items():
        if rows := parts.get(part):
            columns = {
                "held": lambda rows: share(r["held"] for r in _tried(rows)),
                "slip mm": lambda rows: number(median_of(_slips(rows)), 2),
                "p90": lambda rows: number(quantile_of(_slips(rows), 0.9), 2),
                "reasons": _reasons,
            }
            out += [summary_table(title, rows, {"case": "physics"}, columns), _each(title, rows)]
    if rows := parts.get("creep"):
        columns = {
            "n": lambda rows: str(len(_tried(rows))),
            "measured": lambda rows: _speed(rows, "creep"),
            "formula": lambda rows: _speed(rows, "predicted"),
            "least": lambda rows: _speed(rows, "least"),
            "measured / formula": _agreement,
            "lost": lambda rows: str(sum(r["error"] not in ("", NO_SUCH_GRIP) for r in rows)),
            "no such grip": lambda rows: str(sum(r["error"] == NO_SUCH_GRIP for r in rows)),
        }
        out.append(summary_table(CREEP_TITLE, rows, {"case": "physics"}, columns))
    return out


def _tried(rows: list[Row]) -> list[Row]:
    return [r for r in rows if not r["error"]]


def _slips(rows: list[Row]) -> list[float]:
    return [r["slip_mm"] for r in _tried(rows) if r["held"]]


def _reasons(rows: list[Row]) -> str:
    counts = Counter(r["reason"] for r in _tried(rows) if not r["held"])
    return ", ".join(f"{n} {reason}" for reason, n in counts.most_common())


def _speed(rows: list[Row], name: str) -> str:
    known = (r[f"{name}_mm_s"] for r in _tried(rows))
    return number(median_of(v for v in known if v is not None), 3)


def _agreement(rows: list[Row]) -> str:
    known = [r for r in _tried(rows) if r["predicted_mm_s"]]
    return number(median_of(r["creep_mm_s"] / r["predicted_mm_s"] for r in known), 2)


def _each(title: str, rows: list[Row]) -> Table:
    """Every grasp: its slip in mm where it is held, why not where it is not."""
    cases = list(dict.fromkeys(r["case"] for r in rows))
    table = table_of(f"{title}: slip in mm, or why not", ("hand", "object"), cases)
    for cell, members in grouped(rows, "hand", "object").items():
        told = {
            r["case"]: r["error"] or (number(r["slip_mm"], 2) if r["held"] else r["reason"])
            for r in members
        }
        table.add_row(*cell, *(told.get(case, "-") for case in cases))
    return table
