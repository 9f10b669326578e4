"""The command ``learn``: a policy for turns in the hand, by imitation of the closed loop."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from sim.cli.common import (
    err,
    goes_on,
    heeding_ctrl_c,
    out,
    print_json,
    say,
    tell,
    told_command,
)
from sim.cli.execution import error_model_of, physics_of
from sim.cli.options import (
    ErrorModelOption,
    HandArgument,
    JsonOption,
    PhysicsOption,
    SeedOption,
    argument,
    command,
    names,
    option,
)
from sim.runner import ProgressBar
from sim.tables import table_of

if TYPE_CHECKING:
    from sim.learning import Progress as Made


@dataclass(frozen=True, kw_only=True)
class CourseOptions:
    """How long and by which senses is learnt, as in ``sim.learning.Course``."""

    plans: Annotated[int, option("Plans to learn from.", "N", min=1)] = 40
    demonstrations: Annotated[
        int, option("Episodes of round 0.", "N", None, "-n", "--demonstrations", min=1)
    ] = 40
    rounds: Annotated[int, option("Rounds in which the policy drives.", "N", min=0)] = 3
    episodes: Annotated[int, option("Episodes of each.", "N", min=1)] = 20
    senses: Annotated[str, option("Of joints,touch,targets,plan,clock,object.", "NAMES")] = (
        "touch,clock,object"
    )


@command
def learn(
    context: typer.Context,
    hand: HandArgument,
    objects: Annotated[str, argument("As `plan` takes it; a..b is a range, m.", "OBJECT")],
    folder: Annotated[
        Path, option("Folder; a training begun there goes on.", "DIR", None, "--out")
    ] = Path("runs/learn"),
    rotate: Annotated[float, option("Turn, degrees.", "DEG")] = 90.0,
    *,
    asked: CourseOptions,
    seed: SeedOption = 0,
    physics: PhysicsOption = "ours",
    error_model: ErrorModelOption = "lab",
    as_json: JsonOption = False,
) -> None:
    """Learn to turn objects in the hand without a camera.

    The planner's closed loop, which is told the truth, teaches a small network that is told what
    sensors say. Use the policy with --controller policy:FILE.

    An interrupted training goes on when the same command is given again.
    """
    from sim.learning import Course, TurnTask
    from sim.learning import learn as train

    task = TurnTask(
        hand=hand,
        objects=objects,
        angle=math.radians(rotate),
        error_model=error_model_of(error_model),
        physics=physics_of(physics),
        seed=seed,
    )
    course = Course(**{**vars(asked), "senses": tuple(names(asked.senses))})
    with heeding_ctrl_c(), _Bar(err, ticks=True) as bar, goes_on(bar.kept):
        learned = train(
            task, course, folder, command=told_command(context), progress=_shown(bar.told)
        )
    told = learned.to_dict()
    if as_json:
        print_json(told)
        return
    out.print(_table(told))
    tell(
        f"written to {folder}: policy.npz, progress.csv, curves.png",
        f"to use it: opposable manipulate {hand} OBJECT --rotate {rotate:g} "
        f"--error-model {error_model} --controller policy:{folder / 'policy.npz'}",
    )


def _shown(bar: Callable[[Made], None]) -> Callable[[Made], None]:
    """What shows how far it is: a bar, and a line for each round where there is no terminal."""

    def show(now: Made) -> None:
        bar(now)
        if now.round_ends and not err.is_terminal:
            say(
                err,
                f"round {now.round}: {now.in_round} episodes, {now.strict} with closure; "
                f"{now.episode} of {now.of} in all",
            )

    return show


class _Bar(ProgressBar):
    """The bar of all rounds; use it as a context."""

    def told(self, now: Made) -> None:
        """Show how far it is."""
        note = f"round {now.round}, with closure {now.strict} of {now.in_round}"
        if math.isfinite(now.fitted):
            note += f", error {now.fitted:.2g}"
        self.show("learning", now.episode, now.of, note)

    def kept(self) -> str:
        """What there is."""
        return f"{self.done} episodes are kept"


def _table(told: dict[str, Any]) -> Table:
    """A row for each round."""
    table = table_of(
        "episodes by round",
        ("round", "teacher drives"),
        ("episodes", "turned, not dropped", "with closure"),
    )
    for row in told["rounds"]:
        n = row["episodes"]
        table.add_row(
            str(row["round"]),
            f"{100 * row['teacher_share']:.0f} %",
            str(n),
            f"{row['success']} of {n}",
            f"{row['success_with_closure']} of {n}",
        )
    return table
