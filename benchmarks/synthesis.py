"""Measure planning: found per CPU second, CPU by stage, epsilon, diversity.

Request k of an object has the seed that ``planner.batch`` gives it, so the plans are those of
``opposable batch``. CPU time is that of the process with all its threads; work that all attempts
of a task share (mesh, field, problems) is reported separately.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import nullcontext, suppress
from dataclasses import asdict, dataclass
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import numpy as np
import typer

from benchmarks.bench import HandOptions, NumberOption, ObjectsOption
from benchmarks.common import (
    PRIMITIVES,
    Setting,
    cells_of,
    checked_hand,
    clearance_of,
    half_longest_side,
    options_of,
    seed_of,
    task_of,
)
from benchmarks.summary import Cell, Frame, amount, of, parts, ratio, summary
from planner.batch import GraspFeatures, diversity
from planner.collision.pregrasp import APPROACH_KINDS
from planner.errors import PlannerError, TaskError
from planner.numerics.kernels import compiled_searches
from planner.quality.ball import epsilon_frogger, epsilon_l1
from planner.search.grasp import Attempt, attempts
from planner.shapes import Mesh
from planner.system.disk_cache import CACHE_VARIABLE
from planner.system.threads import timed
from planner.task import DEFAULT_MU, GraspTask
from sim.cli.options import AttemptsOption, FingersOption, MuOption, RoundsOption, names
from sim.tables import Row, number

SOON = 1.0
"""CPU time (s) within which a request should be met."""

APPROACH, OTHER = "approach", "other"
"""The stage that is the last check of an attempt; what of an attempt is in no stage."""

BASELINE_RATE = 0.43
"""Grasps found per CPU second (1/s) by FRoGGeR, over 42 objects.

Li, Culbertson, Burdick, Ames, "FRoGGeR: Fast Robust Grasp Generation via the Min-Weight Metric",
IROS 2023; github.com/alberthli/frogger, commit f91157f. Measured by this project on two EPYC cores,
one thread, five grasps per object: its Allegro hand, floating, four contacts, mu 0.7, 1 mm
clearance, with the one correction that its contact points are taken in the frame in which Drake
gives them (as shipped a fifth of its grasps is not closed).
"""

BASELINE_EPSILON = {
    "004_sugar_box": 0.104,
    "005_tomato_soup_can": 0.178,
    "006_mustard_bottle": 0.071,
    "010_potted_meat_can": 0.131,
    "011_banana": 0.101,
    "013_apple": 0.230,
    "043_phillips_screwdriver": 0.070,
    "048_hammer": 0.023,
    "054_softball": 0.219,
    "061_foam_brick": 0.189,
    "077_rubiks_cube": 0.212,
}
"""Median epsilon of FRoGGeR in its own definition (``epsilon_frogger``), by object."""


@dataclass(frozen=True, kw_only=True)
class Options(HandOptions):
    """Requests of every hand and object."""

    n: NumberOption = 50
    objects: ObjectsOption = PRIMITIVES
    mu: MuOption = DEFAULT_MU
    fingers: FingersOption = None
    floating: Annotated[
        bool, typer.Option("--floating/--table", help="Without a table.", metavar="")
    ] = False
    clearance: Annotated[
        float, typer.Option(min=0, help="Least distance of what must not touch, m.")
    ] = 0.0
    rounds: RoundsOption = None
    max_attempts: AttemptsOption = 100
    baseline: Annotated[
        bool, typer.Option("--baseline", help="Compare with FRoGGeR's figures.", metavar="")
    ] = False


def cases(options: Options) -> Iterator[Row]:
    """Hands and objects, each with all of its requests."""
    fingers = None if options.fingers is None else tuple(names(options.fingers))
    setting = Setting(mu=options.mu, fingers=fingers, floating=options.floating)
    asked: Row = {"n": options.n, "seed": options.seed, "rounds": options.rounds}
    asked |= {"clearance": options.clearance, "max_attempts": options.max_attempts}
    for cell in cells_of(options.hand_names, options.objects):
        checked_hand(cell["hand"]).choose_fingers(fingers)
        yield {**cell, **asked, "setting": setting}


def measure(case: Row) -> Row:
    """All requests of a hand and an object, and the time of the first one from nothing."""
    requests, features = [], []
    for k in range(case["n"]):
        begin = time.process_time()
        task = task_of(case["hand"], case["spec"], case["setting"])
        made = time.process_time() - begin
        row, found = request(task, k, case)
        requests.append(row | {"prepare_s": row["prepare_s"] + made})
        if found is not None and row["n_fingers"] == len(task.finger_names):
            features.append(found)
    first_s = first_grasp_s({**case, "setting": asdict(case["setting"])})
    return {
        "hand": checked_hand(case["hand"]).name,
        **summed(requests),
        "first_s": first_s,
        **_diversities(features, task),
    }


def request(
    task: GraspTask, k: int, asked: Row, *, compiled: bool = True
) -> tuple[Row, GraspFeatures | None]:
    """Make request k of a task: attempts until one is found, what they cost, and its features.

    Args:
        task: The task.
        k: With the seed and the shape it fixes the starts.
        asked: "seed", "rounds", "max_attempts", and "clearance" (m), below which a found grasp
            counts as failed: 0 asks for no more than that nothing penetrates.
        compiled: Whether kernels are compiled from the first attempt, as in batches.

    Raises:
        PlannerError: It cannot be tried.
    """
    shape, options = task.object.shape, options_of(asked["rounds"])
    seed = seed_of(asked["seed"], shape, k)
    begin = time.process_time()
    if compiled:
        _load_kernels(task, asked)
    made: list[Attempt[Any]] = []
    reasons: list[str] = []
    plan = None
    with timed() as stages, compiled_searches() if compiled else nullcontext():
        for attempt in attempts(task, seed=seed, options=options):
            made.append(attempt)
            plan, reason = attempt.plan, attempt.failure.kind if attempt.failure else ""
            if plan is not None and clearance_of(plan) < asked["clearance"]:
                plan, reason = None, "clearance"
            reasons.append(reason)
            if plan is not None or len(made) >= asked["max_attempts"]:
                break
    cpu = sum(a.cpu_s for a in made)
    row: Row = {
        "found": plan is not None,
        "attempts": len(made),
        "cpu_s": cpu,
        "prepare_s": max(0.0, time.process_time() - begin - cpu),
        "stages": {**stages, OTHER: max(0.0, cpu - sum(stages.values()))},
        "reasons": dict(Counter(r for r in reasons if r)),
        # that passed every check but the way in; with a clearance only whole plans tell
        "passed": None
        if asked["clearance"]
        else sum(r == "" or r in APPROACH_KINDS for r in reasons),
        "n_fingers": 0,
    }
    if plan is None:
        return row, None
    half = half_longest_side(shape)
    row |= {
        "n_fingers": len(plan.task.finger_names),
        "epsilon": epsilon_l1(plan.contacts, length=shape.bounding_radius),
        "epsilon_frogger": epsilon_frogger(plan.contacts, half_longest_side=half),
        "clearance_mm": 1e3 * clearance_of(plan),
    }
    return row, GraspFeatures.of_plans([plan])


_loaded: set[tuple[bool, bool]] = set()
"""Kinds of problems for which this process has loaded what is compiled."""


def _load_kernels(task: GraspTask, asked: Row) -> None:
    """One attempt, once per process and kind of problem, that loads compiled kernels.

    Loading takes about a second and belongs to no grasp: it counts as preparation.
    """
    options = options_of(asked["rounds"])
    kind = (isinstance(task.object.shape, Mesh), options.rounds > 0)
    if kind not in _loaded:
        _loaded.add(kind)
        # a task that cannot work is told by the request itself
        with suppress(PlannerError), compiled_searches():
            next(attempts(task, seed=asked["seed"], options=options))


def summed(requests: Sequence[Row]) -> Row:
    """Requests of one task as one row: sums of counts and times, lists of the rest.

    "without_s" is the CPU time without the check of the way in, for the rate without that: it is an
    attempt's last check and attempts are independent, so that without it those that only it refused
    would count, and its time would not.
    """
    found = [r for r in requests if r["found"]]
    stages: Counter[str] = Counter()
    reasons: Counter[str] = Counter()
    for r in requests:
        stages.update(r["stages"])
        reasons.update(r["reasons"])
    cpu = sum(r["cpu_s"] for r in requests)
    passed = [r["passed"] for r in requests]
    known = None not in passed and APPROACH in stages
    return {
        "requested": len(requests),
        "found": len(found),
        "attempts": sum(r["attempts"] for r in requests),
        "cpu_s": cpu,
        "prepare_s": sum(r["prepare_s"] for r in requests),
        "taken_s": [r["cpu_s"] for r in found],
        "soon": sum(r["cpu_s"] <= SOON for r in found),
        "passed": sum(passed) if known else None,
        "without_s": cpu - stages[APPROACH] if known else None,
        "stages": dict(stages),
        "reasons": dict(reasons),
        **{
            name: [r[name] for r in found]
            for name in ("n_fingers", "epsilon", "epsilon_frogger", "clearance_mm")
        },
    }


def first_grasp_s(case: Row) -> float | None:
    """CPU time (s) of the first request in a process of its own with an empty cache.

    What is timed begins after the import: hand and object are loaded, the object is prepared, the
    grasp problem is built, and attempts are made until one is found; None where none is.

    Raises:
        TaskError: The process failed.
    """
    script = "import sys; from benchmarks.synthesis import from_nothing as f; f(sys.argv[1])"
    with TemporaryDirectory(prefix="opposable-") as cold:
        done = subprocess.run(
            [sys.executable, "-c", script, json.dumps(case)],
            capture_output=True,
            text=True,
            check=False,
            env=os.environ | {CACHE_VARIABLE: cold},
        )
    if done.returncode != 0:
        last = "".join(done.stderr.strip().splitlines()[-1:])
        raise TaskError(f"the time to the first grasp could not be measured: {last}")
    taken: float | None = json.loads(done.stdout.splitlines()[-1])
    return taken


def from_nothing(text: str) -> None:
    """Print the CPU time (s) of the first request of a case, JSON, in this process."""
    case = json.loads(text)
    fingers = case["setting"].pop("fingers")
    setting = Setting(**case["setting"], fingers=None if fingers is None else tuple(fingers))
    begin = time.process_time()
    row, _ = request(task_of(case["hand"], case["spec"], setting), 0, case, compiled=False)
    taken = time.process_time() - begin
    print(json.dumps(taken if row["found"] else None))


def _diversities(found: Sequence[GraspFeatures], task: GraspTask) -> Row:
    """Diversity of the grasps with all fingers, and of as many random starts."""
    if not found:
        return {}
    fields = GraspFeatures.__dataclass_fields__
    grasps = GraspFeatures(**{k: np.concatenate([getattr(f, k) for f in found]) for k in fields})
    try:
        starts = GraspFeatures.of_random_starts(task, len(grasps))
    except TaskError:
        return {}
    shape = task.object.shape
    both = {"grasps": grasps, "starts": starts}
    return {name: diversity(features, shape).to_dict() for name, features in both.items()}


def tables(result: Row) -> Iterator[Row | str]:
    """Speed, CPU by stage, quality and diversity, and the comparison with the baseline."""
    rows = [row for row in result["rows"] if not row["error"]]
    yield summary(
        "found grasps per CPU second (all attempts count), also without the way in; CPU s per "
        "request; preparing once; first grasp of a new process with an empty cache (last row: "
        "median)",
        rows,
        ("hand", "object"),
        {
            "found": parts("found", "requested"),
            "tries": ratio("attempts", "found"),
            "found/s": ratio("found", "cpu_s"),
            "no way in": ratio("passed", "without_s"),
            "<= 1 s": lambda frame: ratio("soon", "requested", 0, 100.0)(frame) + " %",
            "median": of("taken_s", digits=3),
            "p90": of("taken_s", 0.9, 3),
            "prepare s": of("prepare_s", "sum"),
            "first grasp s": of("first_s"),
        },
        [("all", "")],
    )
    spent: Counter[str] = Counter()
    for row in rows:
        spent.update(row["stages"])
    stages = [name for name, _ in spent.most_common()]
    yield summary(
        "CPU by stage, ms per found grasp",
        [
            r | {f"stage {name}": r["stages"].get(name) for name in stages}
            for r in rows
            if r["found"]
        ],
        ("hand", "object"),
        {n: ratio(f"stage {n}", "found", 1, 1e3) for n in stages}
        | {"all": ratio("cpu_s", "found", 1, 1e3)},
        [("all", "")],
    )
    against = result["setting"]["baseline"]
    yield summary(
        "epsilon: ours and in FRoGGeR's definition; clearance mm; diversity: grasps, then as many "
        "random starts",
        [r for r in rows if r["found"]],
        ("hand", "object"),
        {
            "epsilon": of("epsilon", digits=3),
            "p10": of("epsilon", 0.1, 3),
            "frogger": of("epsilon_frogger", digits=3),
            "its p10": of("epsilon_frogger", 0.1, 3),
            **({"ratio": lambda frame: number(over_baseline(frame), 2)} if against else {}),
            "clear": of("clearance_mm", digits=1),
            "distinct": _diversity("n_distinct", 0),
            "directions": _diversity("approach_entropy", 2),
            "surface %": _diversity("surface_share", 0, 100.0),
            "posture rad": _diversity("posture_width_rad", 2),
        },
    )
    if against and rows:
        rate = sum(r["found"] for r in rows) / (BASELINE_RATE * sum(r["cpu_s"] for r in rows))
        ratios = [
            np.median(r["epsilon_frogger"]) / BASELINE_EPSILON[r["object"]]
            for r in rows
            if r["found"] and r["object"] in BASELINE_EPSILON
        ]
        said = f"against FRoGGeR (corrected): {rate:.1f} times its {BASELINE_RATE} per CPU second"
        if ratios:
            said += f"; epsilon ratio median {np.median(ratios):.2f}, least {min(ratios):.2f}"
        yield said


def over_baseline(frame: Frame, name: str = "epsilon_frogger") -> float | None:
    """Median of FRoGGeR's epsilon over FRoGGeR's own on the object of a group, if it has one."""
    theirs = BASELINE_EPSILON.get(frame["object"].iloc[0])
    ours = amount(frame, name)
    return None if theirs is None or ours is None else ours / theirs


def _diversity(name: str, digits: int, scale: float = 1.0) -> Cell:
    def cell(frame: Frame) -> str:
        row = frame.iloc[0]
        if not isinstance(row.get("grasps"), dict):
            return "-"
        return " / ".join(number(row[of_][name], digits, scale) for of_ in ("grasps", "starts"))

    return cell
