"""``manipulate --in-palm``: an object that lies in the palm is turned there, executed, reported.

Also why options of ``manipulate`` mean nothing with --goal or --in-palm: what a refusal says of
them. A test holds that no option is refused without its reason.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sim.cli.common import (
    EXIT_INTERRUPTED,
    EXIT_NO,
    check_films,
    err,
    make_folder,
    print_json,
    tell,
)
from sim.cli.execution import ExecutionOptions, physics_of
from sim.cli.options import MOVEMENT, flag, numbers, option
from sim.cli.tasks import TaskOptions, object_of

if TYPE_CHECKING:
    from planner.spatial import FloatArray


@dataclass(frozen=True, kw_only=True)
class PalmOptions:
    """How an object in the palm is turned."""

    in_palm: Annotated[
        bool,
        flag("--in-palm", "Palm up: the object lies in the palm and is turned there.", MOVEMENT),
    ] = False
    turn_to: Annotated[
        str,
        option(
            "With --in-palm: roll, pitch, yaw of the object in degrees, from how it lies; z is out "
            "of the palm, x to the fingers.",
            "R,P,Y",
            MOVEMENT,
        ),
    ] = "0,0,90"
    tilt: Annotated[
        float | None,
        option(
            "With --in-palm: how far the palm leans to the fingers, degrees; 20 if not given.",
            "DEG",
            MOVEMENT,
            min=0.0,
            max=90.0,
        ),
    ] = None

    @property
    def goal(self) -> FloatArray:
        """Rotation (3, 3): R = Rz(yaw) Ry(pitch) Rx(roll).

        Raises:
            TaskError: It is not three numbers.
        """
        import pinocchio as pin

        angles = (math.radians(v) for v in numbers("--turn-to", self.turn_to, 3))
        goal: FloatArray = pin.rpy.rpyToMatrix(*angles)
        return goal


KEPT = {
    *("hand", "object", "in_palm", "turn_to", "tilt", "output", "as_json", "video", "picture"),
    *("seed", "mass", "repair", "strict", "physics", "sim_mu"),
}
"""Parameters of ``manipulate`` that go with --in-palm."""


def turn_in_palm(
    hand: str,
    object: str,
    request: TaskOptions,
    asked: PalmOptions,
    execution: ExecutionOptions,
    folder: Path | None,
    picture: Path | None,
    as_json: bool,
    command: str,
    seed: int,
) -> None:
    """Turn an object in the palm and report.

    Raises:
        PlannerError: Bad input.
        Exit: It did not get there.
    """
    from sim.palm.run import TILT, reorient_in_palm
    from sim.report_file import write_report

    goal = asked.goal
    check_films(picture, execution.video)
    item = object_of(object, mass=request.mass, repair=request.repair, strict=request.strict)
    if folder is not None:
        make_folder(folder)
        picture = picture or folder / "turned.png"
    tilt = TILT if asked.tilt is None else math.radians(asked.tilt)
    with err.status("turning in the palm ...") as status:

        def show(time_s: float, left_deg: float) -> None:
            status.update(f"turning in the palm: {time_s:.1f} s, {left_deg:.0f} degrees left")

        report = reorient_in_palm(
            hand,
            item,
            goal,
            tilt=tilt,
            physics=physics_of(execution.physics, execution.sim_mu),
            seed=seed,
            picture=picture,
            video=execution.video,
            progress=show,
        )
    report = replace(report, command=command)
    if folder is not None:
        write_report(report.to_dict(), folder / "report.json")
        report.save_html(folder / "report.html")
    if as_json:
        print_json(report.to_dict())
    else:
        tell(str(report), *filter(None, [report.drawn]))
        if folder is not None:
            tell(f"open in a browser: {folder / 'report.html'} (beside report.json)")
    if report.outcome == "interrupted":
        raise typer.Exit(EXIT_INTERRUPTED)
    if not report.success:
        raise typer.Exit(EXIT_NO)


def _by_option(reasons: Mapping[str, Collection[str]]) -> dict[str, str]:
    return {option: reason for reason, options in reasons.items() for option in options}


WITH_GOAL = _by_option(
    {
        "--goal is the rotation and --place where it is held; whether wrist, table or fingers turn "
        "it is searched": ("rotate", "shift", "attitude", "gait"),
        "movements are planned over a table at height 0 with nothing else on it": (
            *("at", "table", "stand", "obstacle", "gravity"),
        ),
        "its grasps are kept for all goals: fingertips anywhere on a known object, joints exact": (
            *("touch", "avoid", "type", "mu_torsion", "grip_force", "expect_load"),
            *("joint_error", "cloud_error", "base", "wrist"),
        ),
        "all grasps that are kept are tried": ("max_attempts", "best_of"),
        "give --mass": ("density",),
        "there the object lies in the palm, and --turn-to is the goal": (
            *("in_palm", "turn_to", "tilt"),
        ),
        "what is executed is drawn into --out": ("picture",),
        "--plan-only executes nothing": (
            *("sim_mu", "physics", "error_model", "error_seed", "estimate", "pads", "controller"),
            *("view", "video", "arrows", "max_force", "via"),
        ),
    }
)
"""Parameter -> why it means nothing with --goal."""

IN_PALM = _by_option(
    {
        "--turn-to is the rotation": ("rotate", "shift", "gait", "goal", "put_down"),
        "the object lies in the palm, and there is no table": (
            *("pose", "at", "table", "stand", "obstacle", "place"),
        ),
        "the hand stands still with the palm up, and leans by --tilt": (
            *("attitude", "gravity", "base", "wrist", "goal_tilt", "wrist_tilt", "via"),
        ),
        "palm and all fingers may touch it anywhere": ("touch", "avoid", "fingers", "type"),
        "no contact is planned; --sim-mu is the friction that there is": ("mu", "mu_torsion"),
        "it is not gripped": ("grip_force", "expect_load", "max_force"),
        "pose and joints are known exactly": (
            *("joint_error", "cloud_error", "error_model", "error_seed", "estimate", "pads"),
        ),
        "nothing is planned before": ("plan_only", "max_attempts", "best_of"),
        "contact-implicit control is the only one": ("controller",),
        "give --mass": ("density",),
        "its films show neither": ("view", "arrows"),
    }
)
"""Parameter -> why it means nothing with --in-palm."""
