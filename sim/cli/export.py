"""The command ``export``: plans and batches into files of other tools; schemas of our own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape

from sim.cli.common import err, heeding_ctrl_c, keep_inputs, out, print_json, say, tell
from sim.cli.options import JsonOption, argument, command, flag, names, option
from sim.cli.reading import renaming

if TYPE_CHECKING:
    from planner.exchange.export import AnyPlan

FORMATS_OF_SIM = ("sim.scene.export",)
"""Modules of ``sim`` that register a format when they are imported: those that need a scene."""

FRAMES, CHOICE = "Names in the file", "Out of a batch"
"""Groups of options in the help."""


@command
def export(
    sources: Annotated[
        list[Path] | None,
        argument("Plan files, folders of plan files or of batches.", "PLAN_OR_BATCH"),
    ] = None,
    to: Annotated[str, option("A format; --list shows them.", "FORMAT")] = "",
    output: Annotated[
        Path | None,
        option("The file, or the folder of some formats.", "PATH", None, "--out", "-o"),
    ] = None,
    objects: Annotated[
        str | None, option("Objects by label, comma separated.", "NAMES", CHOICE)
    ] = None,
    n: Annotated[
        int | None,
        option("The first N grasps of each object.", "N", CHOICE, "-n", "--number", min=1),
    ] = None,
    rename: Annotated[
        list[str] | None,
        option(
            "Our name of a joint = its driver's: FFJ4=rh_FFJ4; or a TOML or YAML file.",
            "OLD=NEW",
            FRAMES,
        ),
    ] = None,
    by: Annotated[
        str,
        option("joints, or actuators: one number for joints that one motor moves.", "WHAT", FRAMES),
    ] = "joints",
    object_frame: Annotated[
        str, option("Frame of the object; its name if not given.", "NAME", FRAMES)
    ] = "",
    hand_frame: Annotated[
        str, option("Frame of the hand; its body's name if not given.", "NAME", FRAMES)
    ] = "",
    base_body: Annotated[
        str,
        option("Body of the hand whose pose is written; the base if not given.", "BODY", FRAMES),
    ] = "",
    world_frame: Annotated[
        str, option("Write poses in the world, under this name.", "NAME", FRAMES)
    ] = "",
    listed: Annotated[bool, flag("--list", "Show the formats and what each loses.")] = False,
    schema: Annotated[
        str | None,
        option(
            "Print the JSON Schema of our own files: plan, movement, report, manipulation-report, "
            "contacts or grasp-table.",
            "KIND",
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Write plans as files of other tools: Isaac, ROS 2 and others.

    The output is written whole or not at all. What a format cannot carry is refused.
    """
    if schema is not None:
        _print_schema(schema)
        return
    from planner.errors import TaskError
    from planner.exchange import Writing, export_plans
    from planner.exchange.export import check_export

    for module in FORMATS_OF_SIM:
        import_module(module)
    if listed:
        _show_formats(as_json)
        return
    if not sources or not to or output is None:
        raise typer.BadParameter(
            "give plans or a batch, --to FORMAT and -o PATH; or --list, or --schema KIND"
        )
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
        print_json(asdict(done) | {"files": [str(file) for file in done.files]})
        return
    plural = "s" if done.count > 1 else ""
    tell(f"{done.count} plan{plural} written to {output} as {done.format}")
    tell(*(f"  {note}" for note in done.notes))
    if done.lost:
        tell(f"not in it: {done.lost}")


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
        tell(f"  {', '.join(row['suffixes']) or 'a folder'}")
        tell(f"  not in it: {row['loses'] or 'nothing'}")


def _print_schema(kind: str) -> None:
    """The JSON Schema of plans, reports, contact lists and tables.

    Raises:
        NotFoundError: There is no file of that kind.
    """
    from pydantic import BaseModel

    from planner.errors import NotFoundError
    from planner.exchange.table_forms import TableFile
    from planner.files import ContactsFile, MovementFile, PlanFile
    from sim.manipulation import ManipulationReportFile
    from sim.report_file import ReportFile

    models: dict[str, type[BaseModel]] = {
        "plan": PlanFile,
        "movement": MovementFile,
        "report": ReportFile,
        "manipulation-report": ManipulationReportFile,
        "contacts": ContactsFile,
        "grasp-table": TableFile,
    }
    if kind in ("motion", "gait", "manipulation"):  # names of earlier versions
        kind = "movement"
    if kind not in models:
        raise NotFoundError("schema", kind, models)
    print_json(models[kind].model_json_schema())
