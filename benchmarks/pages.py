"""``run_pages``: pages of random reports, written, opened in a browser, and compared with states.

The poses that a page shows are read out of it at random times and compared with what was recorded,
and with MuJoCo's kinematics of the recorded joints; the page computes its own from Pinocchio's
model.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar

import mujoco
import numpy as np
from rich.table import Table

from benchmarks.pages_browser import Opened, headless, opened
from benchmarks.pages_cases import KINDS, Made, ReportKind, States, make_report
from benchmarks.run import Job, measure
from planner.errors import PlannerError
from planner.hands.hand import Hand
from planner.spatial import FloatArray, pose_from_wxyz
from sim.runner import Check, Runner
from sim.tables import Columns, Row, number, share, summary_table

TIMES = 10
"""Random times at which poses are read."""

NEAR_MM = 1.0
"""How far (mm) a pose may be off."""

LEAST_COLOURS = 5
"""Common colours from which on a scene is not blank: an empty one has two, ground and sky."""

LONGEST_S, LARGEST_MB, LARGEST_TURN_MB = 2.0, 3.0, 6.0
"""CPU time of writing a page, which does not depend on what else the machine does, and size of one;
of one of a full turn."""


@dataclass(frozen=True, kw_only=True)
class PageJob(Job):
    """One report.

    Attributes:
        kind: What it is of.
        seed: Seed of the measurement; what is drawn depends on it and on ``index``.
    """

    SHOWN: ClassVar = ("kind",)

    kind: ReportKind
    seed: int


def run_pages(
    n: int, *, seed: int = 0, folder: Path | None = None, file: Path | None, runner: Runner
) -> Row:
    """Write and open n pages.

    Args:
        n: How many.
        seed: Of what is drawn.
        folder: Where the pages are kept; nowhere if None.
        file: JSON lines, one per page; an interrupted measurement goes on with it.
        runner: Who works; in this process, where the browser is.

    Raises:
        PlannerError: playwright or a browser is missing.
    """
    if runner.workers != 1:
        raise PlannerError("bench pages works in one process; leave --workers out")
    jobs = [PageJob(index=i, kind=kind, seed=seed) for i, kind in enumerate(_kinds(n, seed))]
    with headless() as browser, TemporaryDirectory() as temporary:
        return measure(
            runner,
            partial(_page, browser=browser, folder=folder or Path(temporary)),
            jobs,
            kind="pages",
            title="pages",
            lost=PageJob.lost,
            file=file,
            asked={"format": "pages-rows", "version": 1, "seed": seed, "n": n},
            seed=seed,
        )


def _kinds(n: int, seed: int) -> Sequence[ReportKind]:
    """Kinds of n reports, each at least once where there is room, in random order."""
    kinds = list(KINDS)
    counts = np.maximum(1, np.floor(n * np.array(list(KINDS.values())))).astype(int)
    every = [kind for kind, count in zip(kinds, counts, strict=True) for _ in range(count)]
    every += ["trial"] * max(0, n - len(every))
    order = np.random.default_rng(seed).permutation(len(every))
    return [every[i] for i in order[:n]]


def _page(job: PageJob, check: Check, *, browser: Any, folder: Path) -> Row:
    """One report, its page, and what the browser shows."""
    rng = np.random.default_rng([job.seed, job.index])
    try:
        made = make_report(job.kind, rng)
    except PlannerError as error:
        return job.lost(str(error))
    check()
    path = folder / f"{job.index:03d}-{job.kind.replace(' ', '-')}.html"
    begin, cpu = time.perf_counter(), time.process_time()
    made.write(path)
    cpu, wall = time.process_time() - cpu, time.perf_counter() - begin
    with opened(browser, path) as page:
        shown = _shown(page, made, rng)
        errors, requests = [*page.errors], [*page.requests]
    task = made.task
    return job.row(
        hand=task.hand.name,
        object=task.object.shape.spec,
        condition=made.condition,
        outcome=made.outcome,
        samples=0 if made.states is None else len(made.states.time),
        write_s=wall,
        write_cpu_s=cpu,
        MB=path.stat().st_size / 1e6,
        errors=errors,
        requests=requests,
        **shown,
    )


def _shown(page: Opened, made: Made, rng: np.random.Generator) -> dict[str, Any]:
    """What a page shows: whether it is blank, where it opened, and how far its poses are off."""
    states = made.states
    if states is None:  # a page of text
        return {"blank": None, "opened_off_s": None, "off_mm": None, "mujoco_off_mm": None}
    opened_off = None
    if made.fault is not None:
        # it opens at the sample at or before the fault, or at its first
        opened_off = abs(page.time - float(np.clip(made.fault, *states.time[[0, -1]])))
    blank = page.colours() < LEAST_COLOURS
    hand = made.task.hand
    samples = rng.integers(0, len(states.time), TIMES)
    asked = {"hand": (None, *hand.joint_names), "object": (None,)}
    found = page.poses_at([float(states.time[i]) + 1e-7 for i in samples], asked)
    off = [_off(shown, states, int(i)) for i, shown in zip(samples, found, strict=True)]
    mujoco_off = [_off_mujoco(s, hand, states, int(i)) for i, s in zip(samples, found, strict=True)]
    return {
        "blank": blank,
        "opened_off_s": opened_off,
        "off_mm": 1e3 * max(off),
        "mujoco_off_mm": 1e3 * max(mujoco_off),
    }


def _off(shown: dict[str, FloatArray], states: States, i: int) -> float:
    """Largest distance (m) of base and object from their recorded places, of points on them too."""
    pairs = (
        (shown["hand"][0], states.T_world_base[i]),
        (shown["object"][0], states.T_world_object[i]),
    )
    return max(float(np.abs(_corners(there) - _corners(true)).max()) for there, true in pairs)


def _corners(row: FloatArray) -> FloatArray:
    """Points (4, 3) of a frame: its origin, and 0.1 m along its axes."""
    pose = pose_from_wxyz(row[:3], row[3:])
    ends: FloatArray = np.vstack([np.zeros(3), 0.1 * np.eye(3)]) @ pose.rotation.T
    shifted: FloatArray = ends + pose.translation
    return shifted


def _off_mujoco(shown: dict[str, FloatArray], hand: Hand, states: States, i: int) -> float:
    """Largest distance (m) of the joints from where MuJoCo's kinematics has them."""
    model = hand.mj_model
    data = mujoco.MjData(model)
    for name, value in zip(hand.joint_names, states.q[i], strict=True):
        data.qpos[int(model.joint(name).qposadr[0])] = value
    mujoco.mj_kinematics(model, data)
    base = pose_from_wxyz(states.T_world_base[i, :3], states.T_world_base[i, 3:])
    root = model.body(hand.description.base_body).id
    there = (data.xanchor - data.xpos[root]) @ data.xmat[root].reshape(3, 3)
    ids = [model.joint(name).id for name in hand.joint_names]
    true = there[ids] @ base.rotation.T + base.translation
    distance = np.linalg.norm(shown["hand"][1:, :3] - true, axis=1)
    return float(distance[model.jnt_type[ids] == HINGE].max(initial=0.0))


HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)
"""A slide's anchor does not move with it, so only hinges are compared."""


def pages_table(result: Row) -> list[Table | str]:
    """A line for every kind of report, and what was asked for."""
    rows = [row for row in result["rows"] if "error" not in row]
    columns: Columns = {
        "pages": lambda some: str(len(some)),
        "errors": lambda some: str(sum(len(r["errors"]) for r in some)),
        "requests": lambda some: str(sum(len(r["requests"]) for r in some)),
        "blank": lambda some: str(sum(bool(r["blank"]) for r in some)),
        "off (mm)": lambda some: _largest(some, "off_mm", 4),
        "off MuJoCo (mm)": lambda some: _largest(some, "mujoco_off_mm", 4),
        "opened off (s)": lambda some: _largest(some, "opened_off_s", 3),
        "written in (s of CPU)": lambda some: _largest(some, "write_cpu_s", 2),
        "(s)": lambda some: _largest(some, "write_s", 2),
        "MB": lambda some: _largest(some, "MB", 2),
        "all good": lambda some: share(_good(r) for r in some),
    }
    table = summary_table("pages of random reports, the worst of each", rows, ["kind"], columns)
    lost = [f"no report: {row['error']}" for row in result["rows"] if "error" in row]
    outcomes = sorted({(r["outcome"]) for r in rows})
    hands, objects = ({r[name] for r in rows} for name in ("hand", "object"))
    about = (
        f"{sum(_good(r) for r in rows)} of {len(rows)} pages are good: no error, no request, not "
        f"blank, poses within {NEAR_MM:g} mm at {TIMES} times, written in {LONGEST_S:g} s of CPU, "
        f"at most {LARGEST_MB:g} MB ({LARGEST_TURN_MB:g} MB of a full turn); {len(hands)} hands, "
        f"{len(objects)} objects; outcomes: {', '.join(outcomes)}"
    )
    return [table, about, *lost]


def _largest(rows: Sequence[Row], name: str, digits: int) -> str:
    return number(max((r[name] for r in rows if r[name] is not None), default=None), digits)


def _good(row: Row) -> bool:
    """Whether a page is what was asked for."""
    largest = LARGEST_TURN_MB if row["kind"] == "full turn" else LARGEST_MB
    poses = [row[name] for name in ("off_mm", "mujoco_off_mm") if row[name] is not None]
    return (
        not row["errors"]
        and not row["requests"]
        and not row["blank"]
        and all(off <= NEAR_MM for off in poses)
        and (row["opened_off_s"] or 0.0) <= SAMPLE_S
        and row["write_cpu_s"] <= LONGEST_S
        and row["MB"] <= largest
    )


SAMPLE_S = 0.021
"""A page opens at a sample: this near (s) to the time of the fault."""
