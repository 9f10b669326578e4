"""``PalmReport``: what happened to an object in the palm; its page is made here too."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from rich.console import Console, ConsoleOptions, RenderResult
from rich.text import Text

from planner.arrays import finite
from planner.pages.blocks import Block, Facts, Folded, Heading, PlotsHere, Verdict
from planner.pages.page import Page
from planner.pages.plan_scene import Stage
from planner.pages.scene import Line, Motion, Plot, Scene
from planner.showing import Shown
from planner.spatial import SE3, FloatArray, pose_from_wxyz
from planner.system.package import written_by
from planner.task import GraspTask
from sim.screen import Report
from sim.show.parts import facts_of, phase_bands, source_blocks

Outcome: TypeAlias = Literal["reached", "dropped", "not in time", "diverged", "interrupted"]
"""How a turn in the palm ends."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PalmReport(Report, Shown):
    """A turn in the palm; a row per period of the controller, in the frame of the hand.

    Attributes:
        hand: Name of the hand.
        object: Specification of the object's shape.
        mass_kg: Its mass.
        seed: Of the postures to which fingers may have opened.
        goal: Rotation (3, 3) that was asked for.
        tilt_deg: How far the palm leaned to the fingers.
        caged: Whether the object rolls off the open palm, or is pushed aside by curling fingers, so
            that it was held until they had curled about it, and some stayed when others opened.
        tolerance_deg: Largest angle that counts as there.
        hold_s: How long it had to be there.
        longest_s: Time that it had.
        outcome: How it ended.
        time: (m,), s, since the turn began.
        error_deg: (m,), angle to the goal.
        phase: m times "turn", "open" (fingers let go to begin anew) or "still" (commands stay).
        T_world_object: (m, 7), position (m) and quaternion w, x, y, z.
        q: (m, nq), joints, rad.
        solve_ms: (k,), CPU time of each solve on one core.
        look_ms: (l,), CPU time of each look ahead on one core.
        settings: Of the controller, as plain data.
        physics: Name and friction.
        wall_s: Time that it took.
        task: Hand, object and gravity; not in the file.
        T_world_base: Pose of the hand's base; not in the file.
        command: What the command line was told, "" of a script.
        drawn: Files of pictures and film that were drawn, in one line; not in the file.
    """

    hand: str
    object: str
    mass_kg: float
    seed: int
    goal: FloatArray
    tilt_deg: float
    caged: bool
    tolerance_deg: float
    hold_s: float
    longest_s: float
    outcome: Outcome
    time: FloatArray
    error_deg: FloatArray
    phase: tuple[str, ...]
    T_world_object: FloatArray
    q: FloatArray
    solve_ms: FloatArray
    look_ms: FloatArray
    settings: dict[str, Any]
    physics: dict[str, Any]
    wall_s: float
    task: GraspTask
    T_world_base: SE3
    command: str = ""
    drawn: str = ""

    @property
    def success(self) -> bool:
        """Whether the object stayed at the goal for as long as asked."""
        return self.outcome == "reached"

    @property
    def solve_ms_median(self) -> float:
        """Median CPU time of a solve, ms; NaN without one."""
        return float(np.median(self.solve_ms)) if len(self.solve_ms) else np.nan

    @property
    def solve_ms_95(self) -> float:
        """Time (ms) that 95 % of the solves stay below; NaN without one."""
        return float(np.percentile(self.solve_ms, 95)) if len(self.solve_ms) else np.nan

    @property
    def looking(self) -> float:
        """CPU time (s) of looks ahead per second of the turn."""
        return float(1e-3 * self.look_ms.sum() / self.time[-1])

    @property
    def openings(self) -> int:
        """How often the fingers opened."""
        opens = np.array([phase == "open" for phase in self.phase])
        return int(opens[:1].sum() + (opens[1:] & ~opens[:-1]).sum())

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        data: dict[str, Any] = finite(
            {
                "format": "opposable-palm-report",
                "version": 1,
                "written_by": written_by(),
                "command": self.command,
                "success": self.success,
                **{name: getattr(self, name) for name in _PLAIN},
                "goal": self.goal.tolist(),
                "solve_ms_median": self.solve_ms_median,
                "solve_ms_95": self.solve_ms_95,
                "openings": self.openings,
                "phase": list(self.phase),
                **{name: getattr(self, name).tolist() for name in _ARRAYS},
            }
        )
        return data

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """A line of verdict, and a line on how it was computed."""
        style = "bold green" if self.success else "bold red"
        yield Text.assemble(
            f"{self.hand}, {self.object}: ", (self.outcome, style), f": {self.summary}"
        )
        if not len(self.solve_ms):
            yield Text("it lay at its goal from the beginning: nothing was solved")
            return
        yield Text(
            f"solves: median {self.solve_ms_median:.1f} ms, 95 % below {self.solve_ms_95:.1f} ms "
            f"of CPU, one per {1e3 * self.settings['period_s']:.0f} ms, and {self.looking:.2f} s a "
            f"second for looks ahead; the palm leans by {self.tilt_deg:.0f} degrees"
        )

    @property
    def summary(self) -> str:
        """What came of it, a sentence with numbers."""
        end = f"{self.error_deg[-1]:.1f} degrees from the goal after {self.time[-1]:.2f} s"
        times = {0: "", 1: ", fingers opened once"}.get(
            self.openings, f", fingers opened {self.openings} times"
        )
        return f"{end} (least {np.nanmin(self.error_deg):.1f}, limit {self.tolerance_deg:g}){times}"


_PLAIN = (
    *("hand", "object", "mass_kg", "seed", "tilt_deg", "tolerance_deg", "hold_s", "longest_s"),
    *("caged", "outcome", "settings", "physics", "wall_s"),
)
_ARRAYS = ("time", "error_deg", "T_world_object", "q", "solve_ms", "look_ms")


def palm_page(report: PalmReport) -> Page:
    """The page of a turn in the palm: the motion, the error over time, the solves."""
    first = report.T_world_object[0]
    stage = Stage(
        report.task, report.T_world_base, report.q[0], pose_from_wxyz(first[:3], first[3:])
    )
    base = np.tile(stage.actors[0].pose, (len(report.time), 1))
    none = np.zeros((len(report.time), 0))
    limit = Line(name="limit", values=np.array([report.tolerance_deg]), dashed=True)
    error = Line(name="angle to the goal", values=report.error_deg)
    scene = Scene(
        models=stage.models,
        actors=tuple(stage.actors),
        focus=stage.focus,
        radius=stage.radius,
        time=report.time,
        motions=(
            Motion(actor="hand", pose=base, q=report.q),
            Motion(actor="object", pose=report.T_world_object, q=none),
        ),
        views=stage.views(None),
        follow="hand",
        plots=(Plot(title="Angle to the goal", unit="degrees", lines=(error, limit)),),
        bands=phase_bands(report.time.tolist(), report.phase),
    )
    data = report.to_dict()
    shown = {name: data[name] for name in _PLAIN if name not in ("settings", "physics")}
    blocks: tuple[Block, ...] = (
        PlotsHere(),
        facts_of(shown),
        Heading(text="Controller"),
        Facts(
            rows=(
                ("solve, median", f"{report.solve_ms_median:.2f} ms of CPU"),
                ("solve, 95 % below", f"{report.solve_ms_95:.2f} ms of CPU"),
                ("looks ahead", f"{report.looking:.2f} s of CPU a second"),
                ("fingers opened", str(report.openings)),
            )
        ),
        Folded(title="All numbers of the controller", blocks=(facts_of(report.settings),)),
        *source_blocks(data["written_by"], report.command),
    )
    text = f"{report.outcome[:1].upper()}{report.outcome[1:]}"
    return Page(
        title=f"{report.hand} turns {report.object} in the palm",
        subtitle="Contact-implicit control, palm up",
        verdict=Verdict(good=report.success, text=text, reason=report.summary),
        summary=blocks,
        scene=scene,
        data=data,
        kind="report",
    )
