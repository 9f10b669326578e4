"""The command ``batch``: many grasps into a dataset, and one of them out of it again."""

from __future__ import annotations

import math
import statistics
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape

from sim.cli.common import (
    EXIT_NOT_FOUND,
    check_folder,
    err,
    goes_on,
    heeding_ctrl_c,
    print_json,
    refuse_given,
    say,
    show_wide,
    tell,
)
from sim.cli.options import (
    JsonOption,
    WorkersOption,
    argument,
    command,
    flag,
    option,
)
from sim.cli.search import PlanOptions
from sim.runner import ProgressBar
from sim.tables import number, table_of

if TYPE_CHECKING:
    from rich.table import Table

    from planner.batch import BatchProgress, GraspSet


class Export(StrEnum):
    """Formats of other projects that a batch is exported to."""

    dexgraspbench = "dexgraspbench"


@command
def batch(
    context: typer.Context,
    hand: Annotated[
        str, argument("Name, hand.toml, MJCF or URDF; of --extract the folder.", "HAND")
    ],
    objects: Annotated[
        list[str] | None, argument("Objects as `plan` takes them.", "OBJECT...")
    ] = None,
    n: Annotated[int, option("Grasps per object.", "N", None, "-n", "--number", min=1)] = 100,
    output: Annotated[
        Path | None,
        option(
            "Folder, grasps; a batch that is there goes on. Of --extract the plan file.",
            "PATH",
            None,
            "--out",
            "-o",
        ),
    ] = None,
    extract: Annotated[
        int | None,
        option("Verify this row of the batch in HAND, write it as a plan.", "ROW", min=0),
    ] = None,
    workers: WorkersOption = -1,
    *,
    request: PlanOptions,
    export: Annotated[Export | None, option("Also write OUT/dexgraspbench.", "FORMAT")] = None,
    export_all: Annotated[
        bool, flag("--export-all", "Fail where the format cannot take a grasp.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Plan many grasps on all cores into a Parquet dataset.

    An interrupted batch goes on when the same command is given again. What says how an object is,
    stands and may be touched holds for all objects.

    opposable batch FOLDER --extract ROW verifies a grasp of a batch again and writes its plan file.
    """
    if extract is not None:
        kept = ("hand", "extract", "output")
        refuse_given(context, "--extract takes a row of a batch and plans nothing", kept=kept)
        _extract(Path(hand), extract, output or Path("plan.json"))
        return
    if not objects:
        raise typer.BadParameter("give an object, or --extract ROW of the batch in HAND")
    folder = output or Path("grasps")
    from planner.batch import plan_grasps
    from planner.exchange.dexgraspbench import export_dexgraspbench
    from planner.files import write_json
    from planner.hand_loading import load_hand
    from planner.search.grasp import DEFAULT_MAX_ATTEMPTS

    loaded = load_hand(hand)
    tasks = [request.task(loaded, item) for item in objects]
    options = request.synthesis()
    with heeding_ctrl_c() as check, BatchBar(err) as bar, goes_on(bar.kept):

        def told(now: BatchProgress) -> None:
            bar.told(now)
            check()

        grasps = plan_grasps(
            loaded,
            tasks,
            n,
            seed=request.seed,
            workers=workers,
            out=folder,
            max_attempts=request.max_attempts or DEFAULT_MAX_ATTEMPTS,
            max_cpu_s=request.max_cpu_s,
            options=options,
            progress=told,
        )
    summary: dict[str, Any] = batch_summary(grasps)
    write_json(summary, folder / "summary.json")
    if export is not None:
        exported = export_dexgraspbench(grasps, folder / export.value, need_all=export_all)
        say(err, escape(f"{exported.summary}: {folder / export.value}"))
    if as_json:
        print_json(summary)
    else:
        show_wide(batch_table(summary))
        tell(f"written to {folder}: grasps/, attempts/, manifest.json, summary.json")
    if not any(item["found"] for item in summary["objects"]):
        raise typer.Exit(EXIT_NOT_FOUND)


def _extract(folder: Path, row: int, output: Path) -> None:
    """Verify a grasp of a batch again; write it as a plan file."""
    from planner.batch import GraspSet
    from planner.errors import NotFoundError
    from planner.files import write_plan

    check_folder(output)
    grasps = GraspSet(folder)
    if row >= len(grasps):
        raise NotFoundError("row", str(row), [f"0 to {len(grasps) - 1}"])
    write_plan(grasps.plan(row), output)
    tell(f"written to {output}")


class BatchBar(ProgressBar):
    """The bar of a batch, with its rate and what was found; use it as a context."""

    def told(self, now: BatchProgress) -> None:
        """Show how far a batch is."""
        planned = now.done - now.kept
        note = f"{now.rate:.1f}/s, found {now.found} of {planned}" if planned else ""
        self.show("planning", now.done, now.total, note)

    def kept(self) -> str:
        """How many grasps are kept, in words."""
        return f"{self.done} grasps are kept" if self.done else "nothing was planned"


def batch_summary(grasps: GraspSet) -> dict[str, Any]:
    """Figures of a batch as plain data: what was found, its cost, and how diverse it is."""
    columns = ("found", "attempts", "cpu_s", "epsilon", "reason")
    rows: dict[str, dict[str, list[Any]]] = {
        label: {name: [] for name in columns} for label in grasps.labels
    }
    for row in grasps:  # checked, which tables are not
        for name in columns:
            rows[row["object"]][name].append(row[name])
    return {
        "format": "opposable-batch-summary",
        "version": 1,
        "written_by": grasps.manifest.written_by,
        "hand": grasps.manifest.hand,
        "objects": [_object(grasps, label, rows[label]) for label in grasps.labels],
    }


def _object(grasps: GraspSet, label: str, rows: dict[str, list[Any]]) -> dict[str, Any]:
    found = sum(rows["found"])
    reasons = [r.split(":")[0] for r in rows["reason"] if r]
    return {
        "object": label,
        "requested": len(rows["found"]),
        "found": found,
        "attempts_per_found": sum(rows["attempts"]) / found if found else None,
        "cpu_s_per_found": sum(rows["cpu_s"]) / found if found else None,
        "epsilon_median": (
            statistics.median(e for e in rows["epsilon"] if e is not None) if found else None
        ),
        "commonest_reason": statistics.mode(reasons) if reasons else "",
        "diversity": grasps.diversity(label).to_dict(),
    }


COLUMNS = ("found", "tries", "CPU s", "epsilon", "distinct", "approach", "surface", "posture")
"""Found of requested; attempts and CPU per found; medians; diversity as in ``Diversity``."""


def batch_table(summary: dict[str, Any]) -> Table:
    """The summary as a table."""
    table = table_of(
        f"{summary['hand']}: tries and CPU per found grasp; distinct: without near-"
        "duplicates; approach: share of directions, entropy; surface: share touched; "
        "posture: width over which joints are spread",
        ("object",),
        COLUMNS,
    )
    for item in summary["objects"]:
        spread = item["diversity"]
        width = spread["posture_width_rad"]
        table.add_row(
            item["object"],
            f"{item['found']}/{item['requested']}",
            number(item["attempts_per_found"], 1),
            number(item["cpu_s_per_found"], 3),
            number(item["epsilon_median"], 3),
            str(spread["n_distinct"]),
            f"{100 * spread['approach_share']:.0f} %, {spread['approach_entropy']:.1f}",
            f"{100 * spread['surface_share']:.0f} %",
            "-" if width is None else f"{math.degrees(width):.1f} deg",
        )
    return table
