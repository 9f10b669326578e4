"""The command ``refine``: given hand poses judged, and brought to the nearest verified grasps."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape

from sim.cli.common import (
    EXIT_INTERRUPTED,
    EXIT_NO,
    EXIT_NOT_FOUND,
    err,
    heeding_ctrl_c,
    make_folder,
    print_json,
    refuse_given,
    say,
    show_wide,
    tell,
)
from sim.cli.judge import check_rows, judge, sets_of_ours, sets_of_theirs
from sim.cli.options import SCENE, JsonOption, argument, command, flag, option
from sim.cli.reading import ReadingOptions, listed_plans, our_kind
from sim.cli.tasks import TaskOptions
from sim.runner import ProgressBar

if TYPE_CHECKING:
    from rich.table import Table

    from planner.exchange.formats import ImportedGrasp
    from planner.search.refine import RefinedGrasp
    from planner.spatial import SE3, FloatArray
    from planner.task import GraspTask

JUDGING = {"approach", "simulate"}
"""Parameters of ``--judge-only`` alone."""

KEPT = {"file", "output", "workers", "as_json", "judge_only", *JUDGING}
"""Parameters that go with plans of ours, which bring the rest."""

SHOWN = 50
"""Rows that are shown; the file of rows has all."""


@dataclass(frozen=True, kw_only=True)
class GivenTaskOptions(TaskOptions):
    """The task of given grasps: most are made without a table."""

    table: Annotated[str, option("Height of the table's top, m, or none.", "Z|none", SCENE)] = (
        "none"
    )


@dataclass(frozen=True)
class _Given:
    """A hand pose of a file, with its task and name."""

    name: str
    task: GraspTask
    T_world_base: SE3
    q: FloatArray


@command
def refine(
    context: typer.Context,
    file: Annotated[Path, argument("Grasps; a plan, a folder of them, a batch.", "FILE")],
    hand: Annotated[
        str | None, option("Name, hand.toml, MJCF, URDF; else that of FILE.", "HAND")
    ] = None,
    object: Annotated[
        str | None, option("As `plan` does, at scale 1; else that of FILE.", "OBJECT")
    ] = None,
    output: Annotated[
        Path | None,
        option(
            "Folder for plans and refined.json; of --judge-only rows, .csv or .parquet.",
            "PATH",
            None,
            "--out",
            "-o",
        ),
    ] = None,
    judge_only: Annotated[
        bool, flag("--judge-only", "Judge them as they are, by the verdict on our own.")
    ] = False,
    approach: Annotated[
        bool, flag("--approach", "With --judge-only: ask for a straight way in, too.")
    ] = False,
    simulate: Annotated[
        bool, flag("--simulate", "With --judge-only: execute every grasp, too.")
    ] = False,
    workers: Annotated[
        int | None, option("Processes, -1 for one per core; 1, with --judge-only -1.", "N")
    ] = None,
    *,
    reading: ReadingOptions,
    request: GivenTaskOptions,
    as_json: JsonOption = False,
) -> None:
    """Bring given hand poses to the nearest verified grasps.

    A plan brings hand, object and surroundings, and only its pose is taken; a table may bring hand
    and object; other files need --hand and --object. Fingers are found from the poses if
    --fingers does not name them. What is brought back is written as plan files. Exit code 0 if all
    are, 1 if some are not, 4 if none is.

    With --judge-only they stay as they are: exit code 0 if every grasp passes, 1 if not.
    """
    kind = None if reading.format is not None else our_kind(file)
    if kind is not None:
        why = f"{file} brings hand, object and surroundings"
        refuse_given(context, why, kept=KEPT)
    if judge_only:
        check_rows(output, file)
        judge(
            sets_of_theirs(file, hand, object, reading, request)
            if kind is None
            else sets_of_ours(file, kind),
            fixed_fingers=kind is not None or request.fingers is not None,
            approach=approach,
            simulate=simulate,
            workers=(1 if kind in ("plan", "plans") else -1) if workers is None else workers,
            output=output,
            as_json=as_json,
        )
        return
    refuse_given(context, "only --judge-only judges", of=JUDGING)
    assumed: Sequence[str] = ()
    if kind is None:
        assumed, given = _poses(file, hand, object, reading, request)
    elif kind == "batch":
        given = list(_of_batch(file))
    else:
        given = [_of_plan(one) for one in listed_plans([file])]
    _refine(file, given, assumed, output or Path("refined"), workers or 1, as_json)


def _refine(
    file: Path,
    given: Sequence[_Given],
    assumed: Sequence[str],
    folder: Path,
    workers: int,
    as_json: bool,
) -> None:
    """Refine poses, write plans as they come and the rows at the end.

    Raises:
        FileFormatError: The folder holds something.
        Exit: Not all were brought back, or it was interrupted.
    """
    from planner.batch import refine_grasps
    from planner.errors import FileFormatError
    from planner.files import write_json, write_plan

    if folder.is_dir() and any(folder.iterdir()):
        raise FileFormatError(
            f"{folder} exists already and is not empty; name another folder with --out, since "
            "plans of two runs would lie beside each other"
        )
    make_folder(folder)
    rows: dict[int, dict[str, Any]] = {}
    complete = False
    with heeding_ctrl_c() as check, ProgressBar(err, quiet=as_json) as bar:
        bar.show("refining", 0, len(given))
        results = refine_grasps(
            [one.task for one in given],
            [(one.T_world_base, one.q) for one in given],
            workers=workers,
        )
        try:
            for index, result in results:
                path = _plan_file(folder, index, given[index].name, len(given))
                if result.plan is not None:
                    write_plan(result.plan, path)
                rows[index] = _row(given[index].name, result, path)
                bar.show("refining", len(rows), len(given))
                check()
            complete = True
        except KeyboardInterrupt:
            say(err, f"interrupted; {len(rows)} of {len(given)} are kept")
    report = _report(file, [rows[i] for i in sorted(rows)], len(given), assumed)
    write_json(report, folder / "refined.json")
    if as_json:
        print_json(report)
    else:
        _show(report, folder)
    if not complete:
        raise typer.Exit(EXIT_INTERRUPTED)
    if report["found"] < len(given):
        raise typer.Exit(EXIT_NO if report["found"] else EXIT_NOT_FOUND)


def _poses(
    file: Path,
    hand: str | None,
    object: str | None,
    reading: ReadingOptions,
    request: GivenTaskOptions,
) -> tuple[Sequence[str], list[_Given]]:
    """What was taken for granted, and the poses of a file of another tool.

    Raises:
        TaskError: Hand or object are missing, or the file holds no grasp.
        FileFormatError: The file cannot be read, or was read in another unit, order or hand than it
            was written.
    """
    from planner.exchange.audit import right_task
    from planner.search.refine.pose import NEAR

    opened = reading.open(file)
    loaded = opened.hand(hand)
    every = opened.grasps(loaded)
    placed: list[_Given] = []
    for name, spec in opened.objects(every, object).items():
        task, given = right_task(
            replace(opened, object=name),
            partial(request.task, object=spec),
            loaded,
            fixed_fingers=request.fingers is not None,
            within=NEAR,
        )
        task_for = _task_for(task, own_place=request.table == "none")
        placed += [_placed(one, task_for(one)) for one in given.grasps]
    return every.assumed, placed


def _of_plan(file: Path) -> _Given:
    """The pose of a plan file, of which nothing is verified."""
    from planner.files import pose_of_plan

    task, T_world_base, q = pose_of_plan(file)
    return _Given(file.stem, task, T_world_base, q)


def _of_batch(folder: Path) -> Iterator[_Given]:
    """The poses of a batch."""
    from planner.batch import GraspSet
    from planner.exchange.audit import batch_as_imported

    for task, given in batch_as_imported(GraspSet(folder), folder):
        for grasp in given.grasps:
            yield _placed(grasp, task)


def _task_for(first: GraspTask, *, own_place: bool) -> Callable[[ImportedGrasp], GraspTask]:
    """The task of each grasp: one per scale and, where the file says so, place of the object."""
    from planner.exchange.audit.judge import scaled_object
    from planner.exchange.joints import T_file_object

    made: dict[Any, GraspTask] = {}

    def task_for(grasp: ImportedGrasp) -> GraspTask:
        where = grasp.T_world_object if own_place else None
        key = (grasp.scale, None if where is None else where.homogeneous.tobytes())
        if key not in made:
            task = first
            if grasp.scale != 1.0:
                item = scaled_object(first.object, grasp.scale)
                place = item.resting_pose(0.0 if task.table_height is None else task.table_height)
                task = replace(task, object=item, T_world_object=place)
            if where is not None:
                task = replace(task, T_world_object=where * T_file_object(task))
            made[key] = task
        return made[key]

    return task_for


def _placed(grasp: ImportedGrasp, task: GraspTask) -> _Given:
    """A grasp in the world of its task; its file knows the object by the object's own file."""
    from planner.exchange.joints import T_file_object

    to_world = task.T_world_object * T_file_object(task).inverse()
    return _Given(grasp.name, task, to_world * grasp.T_object_base, grasp.q)


def _plan_file(folder: Path, index: int, name: str, n: int) -> Path:
    from planner.files import plain_name

    return folder / f"{index:0{len(str(max(n - 1, 0)))}}-{plain_name(name)}.json"


def _row(name: str, result: RefinedGrasp, path: Path) -> dict[str, Any]:
    """One result as plain data; m, rad, s."""
    moved = result.movement
    return {
        "name": name,
        "found": result.found,
        "failure": "" if result.failure is None else result.failure.kind,
        "reason": "" if result.failure is None else result.failure.text,
        "fingers": list(result.task.finger_names),
        "contact_m": None if moved is None else moved.contacts.tolist(),
        "joint_rad": None if moved is None else moved.joint,
        "palm_m": None if moved is None else moved.shift,
        "palm_rad": None if moved is None else moved.turn,
        "tries": len(result.attempts),
        "cpu_s": result.cpu_s,
        "notes": list(result.notes),
        "plan": path.name if result.found else "",
    }


def _report(
    file: Path, rows: list[dict[str, Any]], total: int, assumed: Sequence[str]
) -> dict[str, Any]:
    from planner.system.package import written_by

    return {
        "format": "opposable-refined",
        "version": 1,
        "written_by": written_by(),
        "source": str(file),
        "total": total,
        "found": sum(row["found"] for row in rows),
        "assumed": list(assumed),
        "grasps": rows,
    }


def _show(report: dict[str, Any], folder: Path) -> None:
    """A table for people, and what was noted."""
    rows = report["grasps"]
    show_wide(_table(rows[:SHOWN]))
    if len(rows) > SHOWN:
        tell(f"... and {len(rows) - SHOWN} more, all in {folder / 'refined.json'}")
    for row in rows[:SHOWN]:
        for text in (row["reason"], *row["notes"]):
            if text:
                tell(f"{row['name']}: {text}")
    for sentence in report["assumed"]:
        tell(f"taken for granted: {sentence}")
    tell(
        f"{report['found']} of {report['total']} brought back; written to {folder}: "
        f"{'a plan file for each, ' if report['found'] else ''}refined.json"
    )


def _table(rows: list[dict[str, Any]]) -> Table:
    """How each grasp was moved: to the plan, or to the nearest that was reached."""
    from sim.tables import number, table_of

    table = table_of(
        "how far the hand moved: contacts and joints at most, palm",
        ("grasp", "brought back"),
        ("fingers", "contact mm", "joint rad", "palm mm", "palm rad", "CPU ms"),
    )
    for row in rows:
        contacts = row["contact_m"]
        table.add_row(
            escape(row["name"]),
            "yes" if row["found"] else f"no: {row['failure']}",
            str(len(row["fingers"])),
            number(None if contacts is None else max(contacts), 1, 1e3),
            number(row["joint_rad"], 3),
            number(row["palm_m"], 1, 1e3),
            number(row["palm_rad"], 3),
            number(row["cpu_s"], 1, 1e3),
        )
    return table
