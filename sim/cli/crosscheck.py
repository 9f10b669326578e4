"""The command ``crosscheck``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape

from sim.cli.common import EXIT_NO, check_folder, out, print_json, say, tell
from sim.cli.options import JsonOption, SeedOption, argument, command, flag, option

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
