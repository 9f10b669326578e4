"""Measure physics: which default grasps hold under which preset, and how fast they creep.

holds     every preset, in the open loop
closed    every preset, in the closed loop
remedies  MuJoCo's defaults with one change each, sized by ``sim.creep``
creep     speed of the held object while one number changes, beside the formula of ``sim.creep``
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Annotated, TypeAlias

import typer

from benchmarks.bench import HandOptions, ObjectsOption
from benchmarks.common import MESHES, PRIMITIVES, cells_of, known, plan_of
from benchmarks.summary import counted, of, share, summary, table_data
from planner.errors import TaskError
from planner.plan import GraspPlan
from planner.verification import plan_forces
from sim.cli.execution import error_model_of
from sim.cli.options import ErrorModelOption
from sim.creep import CREEP_BUDGET, least_creep, remedies
from sim.protocols.creep import measure_creep
from sim.scene.build import build_scene
from sim.scene.physics import PRESETS, PhysicsOptions
from sim.sensing.errors import ErrorModel
from sim.tables import Row, number
from sim.trial import simulate

Measure: TypeAlias = Callable[[GraspPlan, str, ErrorModel], Row]
"""Measures a variant with a grasp, under an error model."""

SOFT = PRESETS["mujoco-default"]
"""The physics of which one number is varied."""

ROUND = replace(SOFT, cone="elliptic")


@dataclass(frozen=True, kw_only=True)
class Variant:
    """Physics and grip under which creep is measured.

    Attributes:
        physics: How MuJoCo computes.
        grip: Factor on the least normal forces of the plan (-).
    """

    physics: PhysicsOptions
    grip: float = 1.0


VARIANTS: Mapping[str, Variant] = MappingProxyType(
    {
        "mujoco-default": Variant(physics=SOFT),
        "condim 4": Variant(physics=replace(SOFT, condim=4)),
        "mu 0.6": Variant(physics=replace(SOFT, mu=0.6)),
        "elliptic": Variant(physics=ROUND),
        "impratio 10": Variant(physics=replace(SOFT, impratio=10.0)),
        "elliptic, impratio 10": Variant(physics=replace(ROUND, impratio=10.0)),
        "elliptic, impratio 100": Variant(physics=replace(ROUND, impratio=100.0)),
        "solref 0.01": Variant(physics=replace(SOFT, solref=(0.01, 1.0))),
        "solref 0.005": Variant(physics=replace(SOFT, solref=(0.005, 1.0))),
        "solimp 0.95 0.95": Variant(physics=replace(SOFT, solimp=(0.95, 0.95, 1e-3, 0.5, 2.0))),
        "solimp 0.99 0.99": Variant(physics=replace(SOFT, solimp=(0.99, 0.99, 1e-3, 0.5, 2.0))),
        "solimp 0.999 0.999": Variant(physics=replace(SOFT, solimp=(0.999, 0.999, 1e-3, 0.5, 2))),
        "noslip 1": Variant(physics=replace(SOFT, noslip_iterations=1)),
        "noslip 3": Variant(physics=replace(SOFT, noslip_iterations=3)),
        "noslip 10": Variant(physics=replace(SOFT, noslip_iterations=10)),
        "grip x 1.5": Variant(physics=SOFT, grip=1.5),
        "grip x 2": Variant(physics=SOFT, grip=2.0),
        "elliptic, grip x 2": Variant(physics=ROUND, grip=2.0),
        "menagerie": Variant(physics=PRESETS["menagerie"]),
        "menagerie, grip x 2": Variant(physics=PRESETS["menagerie"], grip=2.0),
        "ours without noslip": Variant(physics=replace(PRESETS["ours"], noslip_iterations=0)),
        "ours": Variant(physics=PRESETS["ours"]),
    }
)
"""By what differs from MuJoCo's defaults."""


@dataclass(frozen=True, kw_only=True)
class Options(HandOptions):
    """The grasp of the seed, of every hand and object; -n does not count."""

    objects: ObjectsOption = f"{PRIMITIVES},{MESHES},knot"
    parts: Annotated[str, typer.Option(help="Comma separated: holds, closed, remedies, creep.")] = (
        "all"
    )
    error_model: ErrorModelOption = "ideal"


def _hold(plan: GraspPlan, case: str, error_model: ErrorModel) -> Row:
    return _trial(plan, PRESETS[case], "feedforward", error_model)


def _closed(plan: GraspPlan, case: str, error_model: ErrorModel) -> Row:
    return _trial(plan, PRESETS[case], "impedance", error_model)


def _remedy(plan: GraspPlan, case: str, error_model: ErrorModel) -> Row:
    """Under the change of MuJoCo's defaults that the formula asks for."""
    scene = build_scene(plan.task, T_world_base=plan.T_world_base, q=plan.q, physics=SOFT)
    names = plan.task.finger_names
    found = remedies(SOFT, lambda physics: least_creep(scene, names, physics), CREEP_BUDGET)
    for change in found:
        if change.kind == case:
            trial = _trial(plan, change.physics, "feedforward", error_model)
            return {**trial, "what": change.what}
    return {"held": False, "reason": "there is no such remedy for this grasp"}


def _trial(plan: GraspPlan, physics: PhysicsOptions, loop: str, error_model: ErrorModel) -> Row:
    report = simulate(plan, physics=physics, controller=loop, error_model=error_model)
    moved, turned = report.largest_slip
    outcome = {"physics": physics.label, "held": report.success, "reason": report.reason}
    return outcome | {"slip_mm": moved, "slip_deg": turned}


def _creep(plan: GraspPlan, case: str, error_model: ErrorModel) -> Row:
    """Speed of the object in the palm, and what the formula says of the contacts there were.

    Nothing is off whatever the error model: the formula is about what is planned.
    """
    del error_model
    variant = VARIANTS[case]
    pressed = _gripped(plan, variant.grip)
    seen = measure_creep(pressed, variant.physics)
    if seen.lost:
        raise TaskError("lost")
    speeds = {"creep": seen.measured, "predicted": seen.predicted, "least": seen.least}
    row = {f"{name}_mm_s": 1e3 * speed for name, speed in speeds.items()}
    return row | {"over": seen.measured / seen.predicted if seen.predicted else None}


def _gripped(plan: GraspPlan, factor: float) -> GraspPlan:
    """The plan with forces of a firmer grip.

    Raises:
        TaskError: There are none.
    """
    if factor == 1.0:
        return plan
    task = replace(plan.task, grip_force=factor * plan.task.grip_force)
    forces = plan_forces(task, plan.contacts, plan.T_world_base, plan.q)
    if not forces.found:
        raise TaskError("the hand cannot press so hard")
    return replace(plan, task=task, forces=forces, contacts=forces.contacts)


PARTS: Mapping[str, tuple[Measure, tuple[str, ...]]] = {
    "holds": (_hold, tuple(PRESETS)),
    "closed": (_closed, tuple(PRESETS)),
    "remedies": (_remedy, ("noslip", "impratio", "contacts")),
    "creep": (_creep, tuple(VARIANTS)),
}
"""Name -> function that measures a variant, and the variants."""


def cases(options: Options) -> Iterator[Row]:
    """Every variant of every part with every hand and object, grasp by grasp."""
    error_model = error_model_of(options.error_model)
    parts = known("part", options.parts, list(PARTS))
    for cell in cells_of(options.hand_names, options.objects):
        for part in parts:
            for variant in PARTS[part][1]:
                asked = {"part": part, "case": variant, "seed": options.seed}
                yield {**cell, **asked, "error_model": error_model}


def measure(case: Row) -> Row:
    """One grasp under one variant."""
    plan = plan_of(case["hand"], case["spec"], case["seed"])
    return PARTS[case["part"]][0](plan, case["case"], case["error_model"])


TITLES = {
    "holds": "held in the open loop, by physics",
    "closed": "held in the closed loop, by physics",
    "remedies": "held under mujoco-default with one change",
}


def tables(result: Row) -> Iterator[Row]:
    """Of each part that has rows: how many grasps held and why others did not, and every grasp."""
    for part, title in TITLES.items():
        rows = [row for row in result["rows"] if row["part"] == part]
        if not rows:
            continue
        tried = [row for row in rows if not row["error"]]
        columns = {
            "held": share("held"),
            "slip mm": of("slip_mm", where="held"),
            "p90": of("slip_mm", 0.9, where="held"),
            "reasons": counted("reason"),
        }
        yield summary(title, tried, {"case": "physics"}, columns)
        told: dict[tuple[str, str], dict[str, str]] = {}
        for r in rows:
            shown = number(r["slip_mm"], 2) if r.get("held") else r["error"] or r["reason"]
            told.setdefault((r["hand"], r["object"]), {})[r["case"]] = shown
        variants = list(dict.fromkeys(r["case"] for r in rows))
        lines = [[*cell, *(of_.get(v, "-") for v in variants)] for cell, of_ in told.items()]
        yield table_data(f"{title}: slip in mm, or why not", ("hand", "object"), variants, lines)
    crept = [row for row in result["rows"] if row["part"] == "creep"]
    if crept:
        yield summary(
            "creep of the held object, medians in mm/s: measured; by the formula; by it however "
            "firm the grip; noslip is not in it",
            crept,
            {"case": "physics"},
            {
                "n": of("creep_mm_s", "count", 0),
                "measured": of("creep_mm_s", digits=3),
                "formula": of("predicted_mm_s", digits=3),
                "least": of("least_mm_s", digits=3),
                "measured / formula": of("over"),
                "not measured": counted("error"),
            },
        )
