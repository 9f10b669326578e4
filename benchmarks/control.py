"""Measure control: what grasps bear in either loop, how they drift, slips that are noticed.

fc       the six pushes of DexGraspBench's test
push     a growing load until the object is lost: feedforward control with the planned grip and with
         the best grip that the plan's forces allow, and impedance control
drift    how far an object moves in the hand while nothing happens
slip     a slip detector's alarms beside known slips (``benchmarks.slips``)
robust   a third of the grid of masses, frictions and pose errors
rate     CPU time of a step of each loop, and of MuJoCo alone
promise  the share of a certified load that impedance control holds: friction is the certified one,
         the load acts in the weakest direction and grows slowly, or is switched on and off

A cell is a hand and an object. Grasp k belongs to cell k modulo the number of cells; all parts use
the same grasps. Errors of an error model are drawn from the number of the grasp.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated, Any

import mujoco
import numpy as np
import typer

from benchmarks.bench import HandOptions, ObjectsOption
from benchmarks.common import MESHES, PRIMITIVES, Setting, cells_of, checked_hand, known, plan_of
from benchmarks.slips import slip_row
from benchmarks.summary import (
    Cell,
    Columns,
    Frame,
    amount,
    count,
    flat,
    of,
    parts,
    percentage,
    ratio,
    share,
    share_of,
    summary,
)
from planner.certify import smallest_breaking
from planner.plan import GraspPlan
from planner.spatial import FloatArray
from planner.verification import with_grip
from sim.cli.execution import error_model_of
from sim.cli.options import ErrorModelOption
from sim.controllers import CONTROLLERS, ObjectImpedance
from sim.protocols.dexgraspbench import dexgraspbench_cases
from sim.protocols.disturbance import DROPPED, DisturbanceTrial, Settings
from sim.protocols.forces import PushCase
from sim.protocols.outcome import Conditions
from sim.protocols.variations import robust_cases
from sim.scene.physics import PhysicsOptions
from sim.sensing.errors import ErrorModel
from sim.tables import Row, number
from sim.verdict import Fault

PUSHED = ("feedforward", "best", "impedance")
"""Names of what is pushed: planned grip, best grip of those that were tried, closed loop."""

DRIFT_S = 10.0
"""How long an object is held for its drift to be seen, s."""

NOSLIP = (10, 0)
"""Noslip iterations (-) with which drift is measured: the simulation's own, and none."""

STRETCHES, STEPS = 20, 100
"""Timed stretches, and time steps of each: 0.2 s simulated, long compared with the clock's 1 us."""

WARM_S = 0.2
"""Hold before the measurement (s), so that first-use costs are over."""

GRIPS = 3
"""Grips tried between the planned and the largest feasible one (-)."""

MOST_GRIP = 16.0
"""Search limit for the grip, in planned grips (-): 24 N for a planned 1.5 N, more than the fingers
of any hand in the catalogue can press."""

GRIP_TOL = 0.05
"""Relative width at which the search for the largest grip ends (-)."""

SLOW_FIRST, SLOW_STEP, SLOW_S = 0.7, 0.01, 0.1
"""Slow load: share of the certified load reached in the first second, and increments from there
(-); duration of each increment (s)."""

SUDDEN_FIRST, SUDDEN_STEP, SUDDEN_S, PAUSE_S = 0.3, 0.1, 0.3, 0.2
"""Sudden load: first size and increments, shares of the certified load (-); duration of the load,
and of the pause after it (s)."""

MOST = 1.2
"""Share of the certified load (-) at which a trial ends."""

LEAD_STEPS = 20
"""Increments of the slow load up to ``SLOW_FIRST`` (-)."""

ENOUGH = 0.7
"""Share of the proven bound (-) that impedance control should hold."""

KEPT, ROUNDING = 0.97, 1e-9
"""Share of a certified load (-) that impedance control should hold; rounding of sums of steps."""

STILL_MM = 0.5
"""Largest drift in ten seconds (mm) that counts as still."""


def fc_row(plan: GraspPlan, rng: np.random.Generator, error_model: ErrorModel) -> dict[str, Any]:
    """The six pushes of DexGraspBench's test, which are exact; it draws nothing."""
    del rng, error_model
    outcomes = [case.run(plan, conditions("feedforward")) for case in dexgraspbench_cases()]
    return {
        "whole": all(o.held for o in outcomes),
        "held": sum(o.held for o in outcomes),
        "of": len(outcomes),
        "reasons": [o.reason for o in outcomes if o.reason],
        "start_penetration_mm": max(o.conditions["start_penetration_mm"] for o in outcomes),
        "grasp_penetration_mm": max(o.conditions["grasp_penetration_mm"] for o in outcomes),
    }


def push_row(plan: GraspPlan, rng: np.random.Generator, error_model: ErrorModel) -> dict[str, Any]:
    """A force and a torque in random directions that grow until the object is lost.

    "feedforward" presses with the planned forces, "best" with those of the grip out of
    ``tried_grips`` under which the most is borne, chosen afterwards and for each direction: no rule
    that chooses a grip beforehand does better. "impedance" presses with no less than the plan's
    grip while there is force to spare.
    """
    settings = Settings()
    grips = tried_grips(plan)
    pressed = [plan, *(with_grip(plan, grip) for grip in grips[1:])]
    pushes = []
    for kind, offset in (("force", 0), ("torque", 3)):
        direction = np.zeros(6)
        direction[offset : offset + 3] = unit(rng)
        case = PushCase(index=0, name=kind, direction=direction, settings=settings)
        opened = [case.run(tight, conditions("feedforward", error_model)) for tight in pressed]
        closed = case.run(plan, conditions("impedance", error_model))
        best = max(range(len(grips)), key=lambda k: opened[k].largest_load_held)
        row = {"kind": kind, "direction": direction.tolist(), "grip_N": grips[best]}
        row |= {"lost_mm": settings.dropped.mm, "lost_deg": settings.dropped.deg}
        row |= {"bound": closed.bound, "bound_near": closed.bound_near, "unit": closed.unit}
        for loop, outcome in zip(PUSHED, (opened[0], opened[best], closed), strict=True):
            row[loop] = outcome.largest_load_held
            row |= {f"{loop}_broke": outcome.failure_load, f"{loop}_reason": outcome.reason}
        pushes.append(row)
    return {"pushes": pushes, "grips_N": grips}


def tried_grips(plan: GraspPlan) -> list[float]:
    """Grips (N): the planned one, then ``GRIPS`` evenly up to the largest feasible, if any."""
    first, most = plan.task.grip_force, largest_grip(plan)
    if most <= (1.0 + GRIP_TOL) * first:
        return [first]
    return [float(g) for g in np.linspace(first, most, GRIPS + 1)]


def largest_grip(plan: GraspPlan) -> float:
    """Largest minimum normal force (N) for which the plan's force problem is feasible."""
    low = plan.task.grip_force
    high = MOST_GRIP * low
    if with_grip(plan, high).forces.found:
        return high
    while high - low > GRIP_TOL * high:
        middle = 0.5 * (low + high)
        if with_grip(plan, middle).forces.found:
            low = middle
        else:
            high = middle
    return low


def unit(rng: np.random.Generator) -> FloatArray:
    """A direction (3,), uniform on the sphere."""
    drawn = rng.normal(size=3)
    return np.asarray(drawn / np.linalg.norm(drawn))


def conditions(loop: str, error_model: ErrorModel | None = None) -> Conditions:
    """Default physics with a controller by name, under an error model."""
    return Conditions(
        physics=PhysicsOptions(),
        controller=CONTROLLERS[loop],
        error_model=error_model or ErrorModel(),
    )


def drift_row(plan: GraspPlan, rng: np.random.Generator, error_model: ErrorModel) -> dict[str, Any]:
    """How far an object moves in the hand while nothing happens; it draws nothing."""
    del rng
    holds = []
    for loop, make in CONTROLLERS.items():
        for noslip in NOSLIP:
            hold = DisturbanceTrial(
                plan,
                controller=make(plan),
                physics=PhysicsOptions(noslip_iterations=noslip),
                error_model=error_model,
            )
            fault = hold.close_and_squeeze() or hold.hold_for(DRIFT_S)
            seen = hold.samples.during("hold")
            moved, turned = hold.samples.slip_mm[seen], hold.samples.slip_deg[seen]
            holds.append(
                {
                    "loop": loop,
                    "noslip": noslip,
                    "reason": "" if fault is None else fault.reason,
                    "moved_mm": float(moved[-1]) if len(seen) else None,
                    "turned_deg": float(turned[-1]) if len(seen) else None,
                }
            )
    return {"seconds": DRIFT_S, "holds": holds}


def robust_row(
    plan: GraspPlan, rng: np.random.Generator, error_model: ErrorModel
) -> dict[str, Any]:
    """A third of the grid of masses, frictions and pose errors, by each loop.

    A Latin square: every mass, friction and error three times, every pair of them once. Three
    grasps cover the whole grid on average.
    """
    seed, shift = int(rng.integers(2**31)), int(rng.integers(3))
    settings = Settings()
    grid = settings.mass_factors, settings.friction_factors, settings.pose_errors
    trials = []
    for case in robust_cases(settings, seed):
        error = (case.shift_mm, case.turn_deg)
        m, f, e = (
            level.index(value)
            for level, value in zip(grid, (case.mass, case.friction, error), strict=True)
        )
        if (m + f + e + shift) % len(settings.pose_errors):
            continue
        for loop in CONTROLLERS:
            outcome = case.run(plan, conditions(loop, error_model))
            trials.append(
                {
                    "loop": loop,
                    "mass": case.mass,
                    "friction": case.friction,
                    "pose": f"{case.shift_mm:g} mm {case.turn_deg:g} deg",
                    "held": outcome.held,
                    "reason": outcome.reason,
                }
            )
    return {"trials": trials}


def rate_row(plan: GraspPlan, rng: np.random.Generator, error_model: ErrorModel) -> dict[str, Any]:
    """CPU time (ms) of a step of each loop, physics included, and of MuJoCo alone; draws nothing.

    In the median over short stretches of a hold. The loop runs at every time step.
    """
    del rng
    loops: list[dict[str, Any]] = []
    for loop, make in CONTROLLERS.items():
        hold = DisturbanceTrial(plan, controller=make(plan), error_model=error_model)
        fault = hold.close_and_squeeze() or hold.hold_for(WARM_S)
        if fault is not None:
            loops.append({"loop": loop, "reason": fault.reason})
            continue
        whole = _milliseconds(lambda hold=hold: hold.simulation.step("hold", 1.0))  # type: ignore[misc]
        model, data = hold.simulation.scene.model, hold.simulation.data
        bare = _milliseconds(lambda model=model, data=data: mujoco.mj_step(model, data))  # type: ignore[misc]
        loops.append(
            {
                "loop": loop,
                "reason": "",
                "step_ms": 1e3 * hold.simulation.scene.physics.timestep,
                "whole_ms": whole,
                "bare_ms": bare,
            }
        )
    return {"fingers": len(plan.task.fingers), "loops": loops}


def _milliseconds(step: Callable[[], object]) -> list[float]:
    """CPU time per step of every stretch, ms."""
    spent = []
    for _ in range(STRETCHES):
        begin = time.process_time()
        for _ in range(STEPS):
            step()
        spent.append(1e3 * (time.process_time() - begin) / STEPS)
    return spent


def promise_row(
    plan: GraspPlan, rng: np.random.Generator, error_model: ErrorModel
) -> dict[str, Any]:
    """Shares of certified force and torque at which the object was lost; draws nothing."""
    del rng
    length = plan.task.object.shape.bounding_radius
    loads: list[dict[str, Any]] = []
    for kind in ("force", "torque"):
        breaking = smallest_breaking(plan.forces.problem, kind, length=length)
        promised, size = breaking.bounds.lower, float(np.linalg.norm(breaking.wrench))
        if not (promised > 0 and np.isfinite(size)):
            continue
        wrench = promised / size * breaking.wrench
        for speed, run in (("slow", _slow), ("sudden", _sudden)):
            share, fault = run(plan, wrench, error_model)
            loads.append(
                {
                    "kind": kind,
                    "speed": speed,
                    "promised": promised,
                    "unit": breaking.unit,
                    "broke_at": share if fault is not None else None,
                    "reason": "" if fault is None else fault.reason,
                    "lost_mm": DROPPED.mm,
                    "lost_deg": DROPPED.deg,
                }
            )
    return {"loads": loads}


def _slow(
    plan: GraspPlan, wrench: FloatArray, error_model: ErrorModel
) -> tuple[float, Fault | None]:
    """Share of a slowly growing wrench (6,) at which the grasp failed."""
    hold = _certified(plan, error_model)
    share, fault = 0.0, hold.close_and_squeeze()
    while fault is None and share < MOST:
        share += SLOW_FIRST / LEAD_STEPS if share < SLOW_FIRST else SLOW_STEP
        hold.push(share * wrench)
        fault = hold.hold_for(1.0 / LEAD_STEPS if share < SLOW_FIRST else SLOW_S)
    return share, fault


def _sudden(
    plan: GraspPlan, wrench: FloatArray, error_model: ErrorModel
) -> tuple[float, Fault | None]:
    """Share of a sudden wrench (6,) at which the grasp failed."""
    hold = _certified(plan, error_model)
    share, fault = SUDDEN_FIRST - SUDDEN_STEP, hold.close_and_squeeze()
    while fault is None and share < MOST:
        share += SUDDEN_STEP
        hold.push(share * wrench)
        fault = hold.hold_for(SUDDEN_S)
        if fault is None:
            hold.push(np.zeros(6))
            fault = hold.hold_for(PAUSE_S)
    return share, fault


def _certified(plan: GraspPlan, error_model: ErrorModel) -> DisturbanceTrial:
    """Impedance control at the certified friction."""
    task = plan.task
    torsion = task.mu_torsion if task.contact_model == "soft" else 0.0
    return DisturbanceTrial(
        plan,
        controller=ObjectImpedance(plan),
        physics=PhysicsOptions(mu=task.mu, mu_torsion=torsion),
        error_model=error_model,
    )


@dataclass(frozen=True, kw_only=True)
class Part:
    """One question that is asked of many grasps.

    Attributes:
        number: Its place among the numbers of a grasp, from which directions are drawn.
        measure: Measures a grasp under an error model; draws directions from the generator; gives
            plain data.
        grasps: How many grasps are asked by default.
        whole_hand: Whether all fingers of the hand must take part.
    """

    number: int
    measure: Callable[[GraspPlan, np.random.Generator, ErrorModel], Mapping[str, Any]]
    grasps: int
    whole_hand: bool = False


PARTS: Mapping[str, Part] = MappingProxyType(
    {
        "fc": Part(number=0, measure=fc_row, grasps=200),
        "push": Part(number=1, measure=push_row, grasps=50),
        "drift": Part(number=2, measure=drift_row, grasps=20),
        "slip": Part(number=3, measure=slip_row, grasps=20),
        "robust": Part(number=4, measure=robust_row, grasps=60),
        "rate": Part(number=5, measure=rate_row, grasps=4, whole_hand=True),
        "promise": Part(number=6, measure=promise_row, grasps=20),
    }
)
"""By name. A new part takes a new number."""

NUMBERS = 16
"""Numbers reserved for each grasp."""


@dataclass(frozen=True, kw_only=True)
class Options(HandOptions):
    """Grasps of every part."""

    n: Annotated[
        int,
        typer.Option(
            "-n", "--number", min=0, help="Grasps of every part; 0 for as many as its figure asks."
        ),
    ] = 0
    objects: ObjectsOption = f"{PRIMITIVES},{MESHES}"
    parts: Annotated[
        str, typer.Option(help="Comma separated: fc, push, drift, slip, robust, rate, promise.")
    ] = "all"
    error_model: ErrorModelOption = "ideal"


def cases(options: Options) -> Iterator[Row]:
    """Every part for every grasp, cell by cell, so that a plan serves all parts."""
    error_model = error_model_of(options.error_model)
    asked = known("part", options.parts, list(PARTS))
    cells = list(cells_of(options.hand_names, options.objects))
    cells = sorted(cells, key=lambda cell: [c["spec"] for c in cells].index(cell["spec"]))
    counts = {part: options.n or PARTS[part].grasps for part in asked}
    for i, cell in enumerate(cells):
        for k in range(i, max(counts.values()), len(cells)):
            for part in (part for part, n in counts.items() if k < n):
                grasp = {"part": part, "grasp": k, "seed": options.seed}
                yield {
                    **cell,
                    **grasp,
                    "plan_seed": options.seed + k // len(cells),
                    "error_model": error_model.seeded(k),
                }


def measure(case: Row) -> Row:
    """One part for one grasp."""
    part = PARTS[case["part"]]
    fingers = tuple(checked_hand(case["hand"]).fingers) if part.whole_hand else None
    plan = plan_of(case["hand"], case["spec"], case["plan_seed"], Setting(fingers=fingers))
    rng = np.random.default_rng([case["seed"], NUMBERS * case["grasp"] + part.number])
    return dict(part.measure(plan, rng, case["error_model"]))


def tables(result: Row) -> Iterator[Row]:
    """A table per part that has rows."""
    for part in PARTS:
        rows = [row for row in result["rows"] if row["part"] == part]
        there = [row for row in rows if not row["error"]]
        if there:
            yield _TABLES[part](there)


def _fc(rows: list[Row]) -> Row:
    columns = {
        "held": share("whole"),
        "share": percentage("whole"),
        "pushes": parts("held", "of"),
        "start": of("start_penetration_mm", "max"),
        "grasp": of("grasp_penetration_mm", "max"),
    }
    title = "fc: held in all six directions, and pushes held; penetration at start and grasp, mm"
    return summary(title, rows, ("hand", "object"), columns, [(None, "all"), ("all", "")])


def _lost(rows: list[Row]) -> str:
    """Drop criteria in words."""
    limits = {(row["lost_mm"], row["lost_deg"]) for row in rows}
    said = " or ".join(f"{mm:g} mm or {deg:g} degrees in the palm" for mm, deg in sorted(limits))
    return f"lost: {said or 'nothing measured'}"


def _push(rows: list[Row]) -> Row:
    pushes = flat(rows, "pushes")
    for p in pushes:
        for name in ("bound", "bound_near"):
            p[f"of_{name}"] = p["impedance"] / p[name] if p[name] else None
    columns: Columns = {
        "n": count,
        "feedforward": _borne("feedforward"),
        "best open": _borne("best"),
        "its grip": of("grip_N", digits=1, unit=" N"),
        "impedance": _borne("impedance"),
        "by open": _by("feedforward"),
        "by best": _by("best"),
        "share": of("of_bound"),
        "p10": of("of_bound", 0.1),
        f">= {ENOUGH:g}": share_of("of_bound", lambda s: s >= ENOUGH),
        "beyond": share_of("of_bound", lambda s: s > 1),
        "near": share_of("of_bound_near", lambda s: s > 1),
    }
    return summary(
        f"push: medians of the largest load borne ({_lost(pushes)}); open loop with the plan's "
        "grip and with the best of those that the plan's forces allow, closed loop; its medians by "
        "the open loop's; its share of the bound that is proven for the planned posture, and loads "
        "beyond it and beyond the bound for its neighbourhood",
        pushes,
        ("hand", "kind"),
        columns,
        [("all", None), ("all", "")],
    )


def _borne(loop: str) -> Cell:
    """Median of the largest load held; a dash where forces and torques are mixed."""

    def cell(frame: Frame) -> str:
        units, middle = frame["unit"].unique(), amount(frame, loop)
        return "-" if len(units) > 1 or middle is None else f"{middle:.3g} {units[0]}"

    return cell


def _by(loop: str) -> Cell:
    """Median load held under impedance control over that under another."""

    def cell(frame: Frame) -> str:
        closed, other = amount(frame, "impedance"), amount(frame, loop)
        known = len(frame["unit"].unique()) == 1 and closed is not None and other
        return number(closed / other if known and closed and other else None, 2)

    return cell


def _promise(rows: list[Row]) -> Row:
    loads = flat(rows, "loads")
    for load in loads:
        load["share"] = MOST if load["broke_at"] is None else load["broke_at"]
    columns: Columns = {
        "n": count,
        "median": of("share"),
        "p10": of("share", 0.1),
        "least": of("share", "min"),
        f">= {KEPT:g}": share_of("share", lambda s: s >= KEPT - ROUNDING),
        ">= 1": share_of("share", lambda s: s >= 1 - ROUNDING),
    }
    return summary(
        "promise: share of what the certificate promises, for the best control, at which the "
        f"closed loop lost the object ({_lost(loads)}), {MOST:g} at most; friction as certified",
        loads,
        {"hand": "hand", "kind": "kind", "speed": "load"},
        columns,
        [("all", "", None)],
    )


def _drift(rows: list[Row]) -> Row:
    holds = flat(rows, "holds")
    for h in holds:
        h["held"] = not h["reason"]
        h["still"] = h["held"] and h["moved_mm"] <= STILL_MM
    columns: Columns = {
        "held": share("held"),
        "median mm": of("moved_mm", digits=3, where="held"),
        "p90": of("moved_mm", 0.9, 3, where="held"),
        "worst": of("moved_mm", "max", 3, where="held"),
        f"<= {STILL_MM:g} mm": share("still"),
        "worst deg": of("turned_deg", "max", where="held"),
    }
    title = f"drift in {DRIFT_S:g} s of holding"
    return summary(title, holds, ("loop", "noslip"), columns)


def _slip(rows: list[Row]) -> Row:
    columns: Columns = {
        "found": parts("found", "slips"),
        "recall %": ratio("found", "slips", 1, 100.0),
        "right": parts("right", "alarms"),
        "precision %": ratio("right", "alarms", 1, 100.0),
        "delay ms": of("delay", digits=0, scale=1e3),
        "peace s": of("calm_s", "sum", 0),
        "false": of("calm_false", "sum", 0),
        "per 100 s": ratio("calm_false", "calm_s", 2, 100.0),
    }
    title = "slip: found within 50 ms; right alarms; delay; false alarms in peace, per 100 s of it"
    totals = [("all", None), ("all", "")]
    return summary(title, flat(rows, "loops"), ("hand", "loop"), columns, totals)


def _robust(rows: list[Row]) -> Row:
    trials = []
    for trial in flat(rows, "trials"):
        levels = (f"mass x{trial['mass']}", f"friction x{trial['friction']}")
        for what in (*levels, f"pose off by {trial['pose']}", "whole grid"):
            trials.append({"what": what, trial["loop"]: trial["held"]})
    loops = {loop: share(loop, known=loop) for loop in CONTROLLERS}
    percents = {f"{loop} %": percentage(loop, known=loop) for loop in CONTROLLERS}
    return summary("robust: held over the grid", trials, ("what",), {**loops, **percents})


def _rate(rows: list[Row]) -> Row:
    loops = [loop for loop in flat(rows, "loops") if not loop["reason"]]

    def over(frame: Frame) -> str:
        whole = amount(frame, "whole_ms")
        return number(amount(frame, "step_ms") / whole if whole else None, 2)  # type: ignore[operator]

    columns: Columns = {
        "n": count,
        "whole": of("whole_ms", digits=3),
        "fastest": of("whole_ms", "min", 3),
        "MuJoCo": of("bare_ms", digits=3),
        "above": lambda frame: number(
            (amount(frame, "whole_ms") or 0.0) - (amount(frame, "bare_ms") or 0.0), 3
        ),
        "real time": over,
    }
    return summary(
        "rate: CPU ms per step of 2 ms on one core; MuJoCo alone; what is above; times real time",
        loops,
        ("hand", "loop", "fingers"),
        columns,
    )


_TABLES: Mapping[str, Callable[[list[Row]], Row]] = {
    "fc": _fc,
    "push": _push,
    "drift": _drift,
    "slip": _slip,
    "robust": _robust,
    "rate": _rate,
    "promise": _promise,
}
