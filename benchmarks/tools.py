"""Tools: grasps for a use, and their use in MuJoCo, under drawn friction, size and pose.

Each case draws, from its seed alone: friction between hand and tool, the fixture's friction (the
plan believes the tool's file), the tool's size where its file has sections, and how tool and
fixture are turned. ``done`` counts by the verdict of the trial.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import typer

from benchmarks.bench import HandOptions
from benchmarks.common import checked_hand
from benchmarks.summary import counted, of, share, summary
from planner.errors import NoGraspFoundError
from planner.plan import SearchRecord
from planner.tools import load_tool, needed_margin
from sim.scene.physics import PhysicsOptions
from sim.tables import Row
from sim.tools import FingersTrial, UseTrial, plan_fingers, plan_tool
from sim.tools.fingers import checked_by

MU = (0.55, 0.8)
"""Friction (-) between hand and tool; planning relies on 0.5."""

FIXTURE = (0.7, 1.1)
"""Factor (-) on the fixture's friction."""

SIZE = (0.9, 1.1)
"""Factor (-) on the size of a tool made of sections."""

YAW = np.pi / 4
"""Largest turn (rad) of tool and fixture about the vertical."""

SHAPED = ("hammer",)
"""Tools whose shape takes no scale."""


@dataclass(frozen=True, kw_only=True)
class Options(HandOptions):
    """Seeds count from ``--seed``."""

    tools: Annotated[str, typer.Option(help="Names or files.")] = "screwdriver,key,lid,hammer"
    by: Annotated[str, typer.Option(help="wrist, or fingers.")] = "wrist"


def cases(options: Options) -> Iterator[Row]:
    """Hands x tools x seeds."""
    by = {} if checked_by(options.by) == "wrist" else {"by": options.by}
    for hand in options.hand_names:
        checked_hand(hand)
        for tool in options.tools.split(","):
            for seed in range(options.seed, options.seed + options.n):
                yield {"hand": hand, "tool": tool, "seed": seed, **by}


def measure(case: Row) -> Row:
    """Plan and use one tool."""
    rng = np.random.default_rng(case["seed"])
    mu, friction, scale = (float(rng.uniform(*span)) for span in (MU, FIXTURE, SIZE))
    yaw = float(rng.uniform(-YAW, YAW))
    scale = 1.0 if case["tool"] in SHAPED else scale
    drawn = {"mu": mu, "fixture": friction, "scale": scale, "yaw": yaw}
    tool = load_tool(case["tool"], scale=scale)
    physics = PhysicsOptions(name="drawn", mu=mu)
    planning = {"hand": case["hand"], "tool": tool, "seed": case["seed"], "yaw": yaw}
    trial: UseTrial
    margin = None
    try:
        if "by" in case:
            gait = plan_fingers(**planning)
            record: SearchRecord = gait.record
            trial = FingersTrial(gait, friction=friction, physics=physics)
        else:
            movement = plan_tool(**planning)
            plan = movement.grasp
            record, margin = plan.record, needed_margin(plan)
            trial = UseTrial(movement, friction=friction, physics=physics)
    except NoGraspFoundError as error:
        return {**drawn, "done": False, "reason": f"no plan: {str(error)[:200]}"}
    report = trial.run()
    best, use = getattr(record, "best", None), report.use
    slip = report.largest_slip
    return {
        **drawn,
        "done": report.success,
        "reason": report.reason or "done",
        "detail": report.verdict.detail,
        "summary": "" if use is None else use["summary"],
        "margin": margin,
        "rehearsal": best.value if best is not None and best.metric == "rehearsal" else None,
        "attempts": record.attempts,
        "plan_s": record.cpu_s,
        "slip_mm": slip[0],
        "slip_deg": slip[1],
    }


def tables(result: Row) -> Iterator[Row]:
    """A line per hand and tool."""
    yield summary(
        "Tools: used as they should be",
        result["rows"],
        ("hand", "tool"),
        {
            "done": share("done"),
            "margin (-)": of("margin", digits=1),
            "plan, CPU s": of("plan_s", digits=1),
            "slip, mm, most": of("slip_mm", "max", digits=1),
            "slip, deg, most": of("slip_deg", "max", digits=1),
            "ended": counted("reason"),
        },
    )
