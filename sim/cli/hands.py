"""Commands on models of hands.

``hands``: which there are, what one is made of, checks, proposals for models. ``crosscheck``:
whether Pinocchio sees what MuJoCo sees.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape

from sim.cli.common import (
    EXIT_NO,
    check_folder,
    err,
    out,
    print_json,
    refuse_given,
    say,
    tell,
)
from sim.cli.options import JsonOption, SeedOption, argument, command, flag, option

if TYPE_CHECKING:
    from planner.hands.hand import Hand

DESCRIBING = {"output", "base_body", "force"}
"""Parameters of ``--describe`` alone."""


@command
def hands(
    context: typer.Context,
    hand: Annotated[
        str | None,
        argument(
            "A name, hand.toml, MJCF or URDF file, or PACKAGE:NAME; all names if not given.",
            "[HAND]",
        ),
    ] = None,
    check: Annotated[
        bool, flag("--check", "What the planner sees of it, and what is in its way.")
    ] = False,
    describe: Annotated[
        bool, flag("--describe", "Propose a hand.toml for a model, a reason for each line.")
    ] = False,
    output: Annotated[
        Path | None,
        option("Write the hand.toml here instead of printing.", "FILE", None, "--out", "-o"),
    ] = None,
    base_body: Annotated[
        str | None, option("With --describe: body that is the root of the hand.", "NAME")
    ] = None,
    force: Annotated[bool, flag("--force", "Overwrite the hand.toml.")] = False,
    as_json: JsonOption = False,
) -> None:
    """List hands; show one's joints, actuators, tips, masses.

    With --check: exit code 1 if something forbids planning.
    """
    from planner.errors import TaskError

    if hand is None:
        refuse_given(context, "no hand is named", kept=("hand", "as_json"))
        _names(as_json)
    elif describe:
        if check or as_json:
            raise TaskError("--describe writes a hand.toml; leave --check and --json out")
        _describe(hand, output, base_body, force)
    else:
        refuse_given(context, "only --describe writes a hand.toml", of=DESCRIBING)
        (_check if check else _inspect)(hand, as_json)


def _names(as_json: bool) -> None:
    """Hands that ship, and hands in packages of others."""
    from planner.errors import PlannerError
    from planner.hands.catalog import find_hand, foreign_hand_names, hand_names

    there = dict.fromkeys(hand_names(), True)
    for name in foreign_hand_names():
        try:
            find_hand(name)
            there[name] = True
        except PlannerError:
            there[name] = False
    if as_json:
        print_json({"hands": [{"name": n, "installed": i} for n, i in there.items()]})
        return
    for name, installed in there.items():
        say(out, name if installed else f"{name} [dim](its package is not installed)[/]")


def _inspect(hand: str, as_json: bool) -> None:
    """What a hand is made of."""
    from planner.hand_loading import load_hand
    from sim.cli.hand_tables import hand_tables, inspect_hand

    loaded = load_hand(hand)
    if as_json:
        print_json(inspect_hand(loaded))
    else:
        for table in hand_tables(loaded):
            out.print(table)


def _check(hand: str, as_json: bool) -> None:
    """What the planner sees of a hand."""
    from planner.describe import check_hand
    from planner.describe.proposal import fitting_objects
    from planner.hand_loading import load_hand
    from sim.cli.hand_tables import print_check

    with err.status(f"checking {escape(hand)} ..."):
        loaded = load_hand(hand)
        report = check_hand(loaded)
        # the objects are of the size of one hand
        tried = report.ok and not loaded.pair
        fits = _graspable(loaded, fitting_objects(report)) if tried else []
    if as_json:
        print_json({**report.to_dict(), "fits": fits})
    else:
        print_check(report, out)
        for item in fits:
            say(out, f"a grasp is found: opposable run {escape(hand)} {item}")
    if not report.ok:
        raise typer.Exit(EXIT_NO)


ATTEMPTS = 100
"""Attempts at a grasp of an object that may fit, as those of ``opposable run``."""


def _graspable(hand: Hand, objects: Sequence[str]) -> list[str]:
    """The first object of each shape of which a grasp is found; others are refused or not found."""
    from planner.errors import NoGraspFoundError, TaskError
    from planner.search.grasp import plan_grasp
    from planner.task import GraspTask

    found: dict[str, str] = {}
    for item in objects:
        shape = item.partition(":")[0]
        if shape not in found:
            with suppress(NoGraspFoundError, TaskError):
                plan_grasp(GraspTask.create(hand, item), seed=0, max_attempts=ATTEMPTS)
                found[shape] = item
    return list(found.values())


def _describe(model: str, output: Path | None, base_body: str | None, force: bool) -> None:
    """A proposal of a hand.toml."""
    from planner.describe import description_text, propose, write_proposal
    from planner.errors import FileFormatError
    from planner.hand_loading import load_hand
    from planner.pages.notebook import postures_picture

    check_folder(output)
    for file in () if output is None else (output, output.with_suffix(".png")):
        if file.exists() and not force:
            raise FileFormatError(f"{file} exists already; name another file, or give --force")
    with err.status(f"reading {escape(model)}: kinematics, tips, collisions ..."):
        proposal = propose(model, base_body=base_body)
    if output is None:
        text = description_text(
            proposal.description, Path.cwd(), proposal.reasons, proposal.open_questions
        )
        typer.echo(text, nl=False)
        return
    write_proposal(proposal, output, overwrite=force)
    for question in proposal.open_questions:
        say(err, f"[bold]to do:[/] {escape(question)}")
    tell(f"wrote {output}; now: opposable hands {output} --check")
    picture = output.with_suffix(".png")
    picture.write_bytes(postures_picture(load_hand(output)))
    tell(f"its postures are drawn in {picture}")


TOLERANCES, READER = "Tolerances", "Pinocchio's own reader"
"""Groups of options in the help."""


@dataclass(frozen=True, kw_only=True)
class ToleranceOptions:
    """How far the models may differ, as in ``sim.crosscheck.Tolerances``."""

    kinematics: Annotated[float, option("Of poses, m and rad.", "TOL", TOLERANCES)] = 1e-10
    dynamics: Annotated[float, option("Of forces, relative.", "TOL", TOLERANCES)] = 1e-9
    parameters: Annotated[float, option("Of masses, limits, ..., relative.", "TOL", TOLERANCES)] = (
        1e-9
    )
    distance: Annotated[float, option("Of distances, m.", "TOL", TOLERANCES)] = 2e-6
    normal: Annotated[float, option("Of normals, rad.", "TOL", TOLERANCES)] = 1e-3


@command
def crosscheck(
    model: Annotated[str, argument("MJCF or URDF file, or a hand's name.", "MODEL")],
    against: Annotated[str | None, option("Another model, compared part by part.", "MODEL")] = None,
    same: Annotated[
        list[str] | None, option("MINE=OTHER: a part's name there; repeatable.", "NAMES")
    ] = None,
    seed: SeedOption = 0,
    configurations: Annotated[int, option("Random configurations.", "N", min=1)] = 20,
    *,
    tolerances: ToleranceOptions,
    own_reader: Annotated[bool, option("Ask it too, in a child process.", "", READER)] = True,
    judge_reader: Annotated[
        bool, flag("--judge-reader", "Its mistakes count too.", READER)
    ] = False,
    timeout: Annotated[float, option("Its time, s.", "S", READER, min=0.1)] = 60.0,
    output: Annotated[Path | None, option("Write JSON here.", "FILE", None, "--out", "-o")] = None,
    as_json: JsonOption = False,
) -> None:
    """Check a model: MuJoCo against Pinocchio, coal, another model.

    Exit code 0 if every judged quantity agrees, 1 if one differs, 3 on bad input: fit for a CI.
    """
    from planner.files import write_json
    from sim.crosscheck import Tolerances, compare_models, crosscheck_tables
    from sim.crosscheck import crosscheck as check

    check_folder(output)
    pairs = _pairs(same or [], against)
    common: dict[str, Any] = {
        "seed": seed,
        "n_configurations": configurations,
        "tolerances": Tolerances(**vars(tolerances)),
    }
    if against is None:
        report = check(
            model,
            own_reader=own_reader,
            judge_reader=judge_reader,
            timeout=timeout,
            **common,
        )
    else:
        report = compare_models(model, against, names=pairs, **common)
    if output is not None:
        write_json(report.to_dict(), output)
    if as_json:
        print_json(report.to_dict())
    else:
        for table in crosscheck_tables(report):
            out.print(table)
        for column in report.columns:
            if column.failure:
                say(out, f"[red]{escape(column.name)}:[/] {escape(column.failure)}")
            for note in column.notes:
                tell(f"{column.name}: {note}")
        tell(*report.notes)
        missing = [c.name for c in report.columns if c.failure and not c.judged]
        without = f", without {escape(' and '.join(missing))}" if missing else ""
        agree = f"[green]all judged quantities agree[/]{without}"
        say(out, agree if report.ok else "[red]differs[/]")
    if not report.ok:
        raise typer.Exit(EXIT_NO)


def _pairs(same: list[str], against: str | None) -> dict[str, str]:
    """Names of the reference -> names of the other model."""
    from planner.errors import TaskError

    wrong = [pair for pair in same if pair.count("=") != 1]
    if wrong or (same and against is None):
        raise TaskError(
            f"--same {(wrong or same)[0]!r}: give REFERENCE=OTHER, together with --against"
        )
    split = (pair.partition("=") for pair in same)
    return {reference.strip(): other.strip() for reference, _, other in split}
