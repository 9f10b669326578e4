"""Whole-hand grasps: what they bear beside fingertips, and which type holds at which size.

``--parts load``: of each hand, object and seed a fingertip and a power grasp; the smallest force
that breaks either, as certified; and of the power grasp a push that grows along that force, under
a controller that is told the push and commands the forces of the programme (what a certificate is
about), beside one with its references held, whose contact forces ``GraspCompliance`` predicts.
``--parts bound``: the certified forces alone.

``--parts push``: of power grasps of 1 kg, measured beside predicted contact forces under a push
that grows in a random direction, references held, up to what the prediction says is borne.
``--parts sizes``: objects of 2 to 30 cm of half diagonal, drawn by ``--seed``, with every type.
``python -m benchmarks.whole FILE PLOT.svg`` draws what was held (needs matplotlib).
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from benchmarks.bench import HandOptions, ObjectsOption
from benchmarks.common import checked_hand, known
from benchmarks.summary import Columns, of, share, summary
from planner.certify import smallest_breaking
from planner.certify.breaking import Breaking
from planner.errors import NoGraspFoundError, TaskError
from planner.forces import distribute_forces
from planner.objects import parse_object
from planner.plan import GraspPlan
from planner.search.grasp import plan_grasp
from planner.spatial import FloatArray
from planner.task import GraspTask
from planner.verification import force_arguments
from sim.cli.options import flag
from sim.creep import compliance_of
from sim.protocols.disturbance import DisturbanceTrial
from sim.tables import Row
from sim.trial import simulate

PARTS = ("load", "bound", "push", "sizes")
TYPES = ("fingertip", "power", "any")

SIZES = (0.02, 0.03, 0.045, 0.065, 0.1, 0.15, 0.2, 0.3)
"""Half diagonals, m."""

PUSHED = 1.0
"""Mass (kg) of what is pushed: the grip is sized for it."""

MASS, HEAVIEST, MIDDLE = 0.1, 0.5, 0.05
"""Mass (kg) of an object of ``MIDDLE`` half diagonal (m), growing with it up to ``HEAVIEST``: as
HUGS, which stops there too."""

FIRST, STEP, MOST = 2.0, 0.15, 300.0
"""First load (N) of references that are held, duration of each (s), and the last one (N)."""

TOLD_FROM, TOLD, HELD = 0.5, 1.05, 1.15
"""First load that the controller is told, as a share of the certified one; and factors from one
load to the next (-), told and held."""

LEAST = 0.5
"""Force (N) below which a contact is not compared, if neither measured nor predicted force is above
it: its relative error says nothing. Errors are shares of the predicted force, or of this."""

GRIPS = (1.0, 0.5, 0.0)
"""Shares of the least normal forces that the controller that is told asks for, the first that is
found."""


@dataclass(frozen=True, kw_only=True)
class Options(HandOptions):
    """Seeds count from ``--seed``."""

    objects: ObjectsOption = "sphere:0.04,cylinder:0.03x0.12,ellipsoid:0.07x0.06x0.09,capsule"
    parts: Annotated[str, typer.Option(help=f"Some of {', '.join(PARTS)}.")] = "load,push,sizes"
    mass: Annotated[float, typer.Option(help="Of the objects of load, kg.")] = 0.1
    attempts: Annotated[int, typer.Option(min=1, help="Of each search.")] = 30
    floating: Annotated[bool, flag("--floating", "Of load, bound and push: no table.")] = False


def cases(options: Options) -> Iterator[Row]:
    """Hands x objects x seeds of every part."""
    parts = known("part", options.parts, PARTS)
    for hand in options.hand_names:
        checked_hand(hand)
        more = {"hand": hand, "attempts": options.attempts, "floating": options.floating}
        for part, mass in (("load", options.mass), ("bound", options.mass), ("push", PUSHED)):
            for spec in options.objects.split(",") if part in parts else ():
                for seed in range(options.seed, options.seed + options.n):
                    yield {**more, "part": part, "object": spec, "mass": mass, "seed": seed}
        if "sizes" in parts:
            for number, size in enumerate(SIZES):
                for k in range(options.n):
                    drawn = drawn_object(np.random.default_rng([options.seed, number, k]), size)
                    for kind in TYPES:
                        case = {"part": "sizes", "size": size, "object": drawn, "type": kind}
                        case["floating"] = False
                        mass = round(min(HEAVIEST, MASS * size / MIDDLE), 3)
                        yield {**more, **case, "mass": mass, "seed": options.seed + k}


def drawn_object(rng: np.random.Generator, half_diagonal: float) -> str:
    """A box, cylinder, capsule or ellipsoid with this half diagonal (m), sides up to 1 to 4."""
    kind = ("box", "cylinder", "capsule", "ellipsoid")[int(rng.integers(4))]
    sides = rng.uniform(0.25, 1.0, 3)
    if kind in ("cylinder", "capsule"):
        sides[1] = sides[0]
        sides[2] = max(sides[2], sides[0])
    sides *= 2.0 * half_diagonal / np.linalg.norm(sides)
    if kind in ("cylinder", "capsule"):
        return f"{kind}:{sides[0] / 2:.4f}x{max(sides[2], sides[0] + 1e-3):.4f}"
    return f"{kind}:" + "x".join(f"{side:.4f}" for side in sides)


def measure(case: Row) -> Row:
    """One case of a part."""
    return {"load": _load, "bound": _load, "push": _push, "sizes": _size}[case["part"]](case)


@lru_cache(maxsize=8)
def _task(hand: str, spec: str, mass: float, kind: str, floating: bool) -> GraspTask:
    item, table = parse_object(spec, mass=mass), None if floating else 0.0
    return GraspTask.create(checked_hand(hand), item, grasp_type=kind, table_height=table)


def _plan(case: Row, kind: str) -> GraspPlan:
    task = _task(case["hand"], case["object"], case["mass"], kind, case["floating"])
    return plan_grasp(task, seed=case["seed"], max_attempts=case["attempts"])


def _size(case: Row) -> Row:
    try:
        plan = _plan(case, case["type"])
    except NoGraspFoundError as error:
        return {"found": False, "held": False, "reason": str(error)[:200]}
    report = simulate(plan)
    return {"found": True, "held": report.success, "reason": report.reason}


def _push(case: Row) -> Row:
    try:
        plan = _plan(case, "power")
    except NoGraspFoundError:
        return {"found": False}
    way = np.random.default_rng(case["seed"]).normal(size=3)
    along = np.append(way / np.linalg.norm(way), np.zeros(3))
    seen = _growing(plan, along, told=False, first=FIRST)
    inner = len(plan.contacts) - len(plan.task.outermost) - 1  # and the palm
    return {"found": True, "contacts": len(plan.contacts), "inner": inner} | {
        "broke": seen["broke"],
        "force_off": seen["off"],
        "plan_off": seen["plan_off"],
        "predicted_to": seen["to"],
    }


def _load(case: Row) -> Row:
    row: Row = {"found": False}
    certified: dict[str, Breaking] = {}
    plan = None
    for kind in ("fingertip", "power"):
        try:
            plan = _plan(case, kind)
        except NoGraspFoundError:
            return row
        radius = plan.task.object.shape.bounding_radius
        found = smallest_breaking(plan.forces.problem, "force", length=radius, rel_tol=0.03)
        certified[kind] = found
        row[kind] = found.bounds.lower
    row |= {"found": True, "ratio": row["power"] / max(row["fingertip"], 1e-9)}
    if case["part"] == "bound":
        return row
    assert plan is not None
    weakest = certified["power"].wrench
    along = weakest / np.linalg.norm(weakest[:3])
    told = _growing(plan, along, told=True, first=max(FIRST, TOLD_FROM * row["power"]))
    broke = _growing(plan, along, told=False, first=FIRST)
    return row | {
        "contacts": len(plan.contacts),
        "broke": told["broke"],
        "over": told["broke"] / max(row["power"], 1e-9),
        "held_broke": broke["broke"],
        "force_off": broke["off"],
        "predicted_to": broke["to"],
    }


def _growing(plan: GraspPlan, along: FloatArray, *, told: bool, first: float) -> Row:
    """The load (N) under which the object was lost, and how far (%) contact forces were predicted.

    Once from the posture in which the fingers had closed, whose joints are the references of the
    servos while they press and are pushed; and once from the plan alone.

    Args:
        plan: The grasp.
        along: Of 1 N (6,), world.
        told: Whether the controller commands the forces of the programme for each load.
        first: The first load, N.
    """
    hold = DisturbanceTrial(plan)
    fault = hold.run_phases("close")
    closed = hold.simulation.data.qpos.copy()
    if (fault := fault or hold.run_phases("squeeze", "settle", "lift")) is not None:
        raise TaskError(f"the hand did not close: {fault.detail}")
    hold.begin_hold()
    names, scene = np.array(plan.task.finger_names), hold.simulation.scene
    predictions = {
        "off": compliance_of(plan, scene, closed),
        "plan_off": compliance_of(plan, scene),
    }
    given: dict[str, Any] = dict(
        force_arguments(plan.task, plan.contacts, plan.T_world_base, plan.q)
    )
    turn = plan.task.T_world_object.rotation
    before, level, end = 0.0, first, 0.0
    off: dict[str, list[float]] = {kind: [] for kind in predictions}
    while level < MOST:
        if told:
            for grip in GRIPS:
                least = grip * np.asarray(given["min_normal"])
                asked = {**given, "min_normal": least, "friction_scale": 1.0}
                asked["wrench"] = np.asarray(given["wrench"]) + level * along
                answer = distribute_forces(plan.contacts, **asked)
                if answer.found:
                    controller: Any = hold.simulation.controller
                    controller._forces = answer.contacts.forces_in_axes()[:, :3] @ turn
                    break

        def grow(time: float, before: float = before, level: float = level) -> None:
            share = min(1.0, 2.0 * time / STEP)
            hold.push((before + share * (level - before)) * along)

        if hold.hold_for(STEP, each_step=grow):
            break
        if not told and hold.at_rest():
            measured = hold.simulation.normal_forces()
            for kind, (grasp, contacts, pressed) in predictions.items():
                forces, borne = grasp.under(contacts, pressed, level * along)
                if borne < 1.0:
                    continue
                normals = forces[np.cumsum([0, *contacts.dims])[:-1]]
                normal = (names[:, None] == np.array(contacts.fingers)) @ normals
                error = 100.0 * np.abs(measured - normal) / np.maximum(normal, LEAST)
                off[kind] += error[np.maximum(measured, normal) > LEAST].tolist()
                end = level if kind == "off" else end
        before, level = level, (TOLD if told else HELD) * level
    return {"broke": level, **off, "to": end}


def tables(result: Row) -> Iterator[Row]:
    """Loads per hand and object; held per size and type."""
    rows = [{"found": False, "held": False, **row} for row in result["rows"]]  # too large for it
    loads = [row for row in rows if row["part"] in ("load", "bound")]
    if loads:
        columns: Columns = {
            "both found": share("found"),
            "fingertip N": of("fingertip", "median", 1),
            "power N": of("power", "median", 1),
            "ratio": of("ratio", "median", 2),
            "least lost / certified": of("over", "min", 2),
            "median": of("over", "median", 2),
            "references held": of("held_broke", "median", 1),
            "force %": of("force_off", "median", 1),
        }
        yield summary(
            "certified breaking force; load under which it was lost over the certified one; "
            "contact forces under a push against the prediction",
            loads,
            ("hand", "object"),
            columns,
            [("all", "")],
        )
    pushes = [row for row in rows if row["part"] == "push"]
    if pushes:
        yield summary(
            "normal forces of contacts against the prediction under a growing push, %, and against "
            "that of the plan alone; load, N, under which it was lost, and up to which balance was "
            "predicted; by the number of inner links",
            [{**row, "inner": row.get("inner", "-")} for row in pushes],
            {"hand": "hand", "object": "object", "inner": "inner links"},
            {
                "found": share("found"),
                "values": of("force_off", "count", 0),
                "median %": of("force_off", "median", 1),
                "90 %": of("force_off", 0.9, 1),
                "of the plan": of("plan_off", "median", 1),
                "lost at": of("broke", "median", 1),
                "predicted": of("predicted_to", "median", 1),
            },
            [("all", "", None), ("all", "", "")],
        )
    sizes = [row for row in rows if row["part"] == "sizes"]
    if sizes:
        held: Columns = {"found": share("found"), "held": share("held")}
        yield summary("half diagonal, m", sizes, ("size", "type"), held)


def draw(file: Path, picture: Path) -> None:
    """Held by half diagonal, one line a type."""
    from matplotlib.figure import Figure

    rows = [r for r in json.loads(file.read_text())["rows"] if r.get("part") == "sizes"]
    axes = (figure := Figure(figsize=(6, 3.2), layout="constrained")).subplots()
    for kind, mark in zip(TYPES, "ov+", strict=True):
        held = [
            [bool(r.get("held")) for r in rows if r["type"] == kind and r["size"] == size]
            for size in SIZES
        ]
        axes.plot(
            100.0 * np.array(SIZES),
            [float(np.mean(h)) if h else np.nan for h in held],
            mark + "-",
            label=kind,
        )
    axes.set(xscale="log", xlabel="half diagonal, cm", ylabel="held", ylim=(0.0, 1.05))
    axes.set_xticks([100.0 * size for size in SIZES], [f"{100.0 * size:g}" for size in SIZES])
    axes.minorticks_off()
    axes.legend()
    figure.savefig(picture)


if __name__ == "__main__":
    draw(Path(sys.argv[1]), Path(sys.argv[2]))
