"""The command ``export``: plans and batches into files of other tools."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape

from sim.cli.common import (
    JsonOption,
    err,
    errors_for_people,
    heeding_ctrl_c,
    keep_inputs,
    names,
    out,
    print_json,
    say,
)
from sim.cli.reading import renaming

if TYPE_CHECKING:
    from planner.exchange.export import AnyPlan

FORMATS_OF_SIM = ("sim.scene_export",)
"""Modules of ``sim`` that register a format when they are imported: those that need a scene."""

FRAMES_PANEL, CHOICE_PANEL = "Names in the file", "Out of a batch"
"""Groups of options in the help."""


@errors_for_people()
def export(
    sources: Annotated[
        list[Path] | None,
        typer.Argument(
            help="Plan files, folders of plan files or of batches.", metavar="PLAN_OR_BATCH"
        ),
    ] = None,
    to: Annotated[str, typer.Option(help="A format; --list shows them.", metavar="FORMAT")] = "",
    output: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="The file, or the folder of some formats."),
    ] = None,
    objects: Annotated[
        str | None,
        typer.Option(
            help="Objects by label, comma separated.", metavar="NAMES", rich_help_panel=CHOICE_PANEL
        ),
    ] = None,
    n: Annotated[
        int | None,
        typer.Option(
            "-n",
            "--number",
            min=1,
            help="The first N grasps of each object.",
            metavar="N",
            rich_help_panel=CHOICE_PANEL,
        ),
    ] = None,
    rename: Annotated[
        list[str] | None,
        typer.Option(
            help="Our name of a joint = its driver's: FFJ4=rh_FFJ4; or a TOML or YAML file.",
            metavar="OLD=NEW",
            rich_help_panel=FRAMES_PANEL,
        ),
    ] = None,
    by: Annotated[
        str,
        typer.Option(
            help="joints, or actuators: one number for joints that one motor moves.",
            metavar="WHAT",
            rich_help_panel=FRAMES_PANEL,
        ),
    ] = "joints",
    object_frame: Annotated[
        str,
        typer.Option(
            help="Frame of the object; its name if not given.",
            metavar="NAME",
            rich_help_panel=FRAMES_PANEL,
        ),
    ] = "",
    hand_frame: Annotated[
        str,
        typer.Option(
            help="Frame of the hand; its body's name if not given.",
            metavar="NAME",
            rich_help_panel=FRAMES_PANEL,
        ),
    ] = "",
    base_body: Annotated[
        str,
        typer.Option(
            help="Body of the hand whose pose is written; the base if not given.",
            metavar="BODY",
            rich_help_panel=FRAMES_PANEL,
        ),
    ] = "",
    world_frame: Annotated[
        str,
        typer.Option(
            help="Write poses in the world, under this name.",
            metavar="NAME",
            rich_help_panel=FRAMES_PANEL,
        ),
    ] = "",
    listed: Annotated[
        bool, typer.Option("--list", help="Show the formats and what each loses.", metavar="")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Write plans as files of other tools: Isaac, ROS 2 and others.

    The output is written whole or not at all. What a format cannot carry is refused.
    """
    from planner.errors import TaskError
    from planner.exchange import Writing, export_plans
    from planner.exchange.export import check_export

    for module in FORMATS_OF_SIM:
        import_module(module)
    if listed:
        _show_formats(as_json)
        return
    if not sources or not to or output is None:
        raise typer.BadParameter("give plans or a batch, --to FORMAT and -o PATH; or --list")
    writing = Writing(
        rename=renaming(rename or []),
        by=by,
        object_frame=object_frame,
        hand_frame=hand_frame,
        base_body=base_body,
        world_frame=world_frame,
    )
    check_export(to, output, writing)
    keep_inputs(output, *sources)
    if not output.parent.is_dir():
        raise TaskError(f"cannot write {output}: there is no folder {output.parent}; make it")
    plans = _read(sources, None if objects is None else names(objects), n)
    done = export_plans(plans, output, to, writing=writing)
    if as_json:
        print_json(
            {
                "format": done.format,
                "count": done.count,
                "files": [str(file) for file in done.files],
                "lost": done.lost,
                "notes": list(done.notes),
            }
        )
        return
    plural = "s" if done.count > 1 else ""
    say(out, escape(f"{done.count} plan{plural} written to {output} as {done.format}"))
    for note in done.notes:
        say(out, escape(f"  {note}"))
    if done.lost:
        say(out, escape(f"not in it: {done.lost}"))


def _read(
    sources: Sequence[Path], objects: Sequence[str] | None, first: int | None
) -> list[AnyPlan]:
    """All plans, with their number on stderr as they come."""
    from planner.exchange import plans_of

    plans: list[AnyPlan] = []
    with heeding_ctrl_c() as check, err.status("reading plans ...") as status:
        for plan in plans_of(sources, objects=objects, first=first):
            check()
            plans.append(plan)
            status.update(f"reading plans: {len(plans)}")
    return plans


def _show_formats(as_json: bool) -> None:
    from planner.exchange.formats import FORMATS, load_formats

    load_formats()
    rows: list[dict[str, Any]] = [
        {
            "name": f.name,
            "title": f.title,
            "reads": f.read is not None,
            "writes": f.write is not None,
            "movements": f.movements,
            "suffixes": list(f.suffixes),
            "takes": sorted(f.heeds),
            "loses": f.loses,
        }
        for f in FORMATS.values()
    ]
    if as_json:
        print_json({"formats": rows})
        return
    for row in rows:
        able = " and ".join(verb for verb in ("reads", "writes") if row[verb])
        moves = ", movements too" if row["movements"] else ""
        say(out, f"[bold]{row['name']}[/] ({able}{moves}): {escape(row['title'])}")
        say(out, escape(f"  {', '.join(row['suffixes']) or 'a folder'}"))
        say(out, escape(f"  not in it: {row['loses'] or 'nothing'}"))
