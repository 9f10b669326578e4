"""Have DexGraspBench itself, in its pinned versions, evaluate batches of grasps.

Batches are exported, the benchmark evaluates them, and our protocol of that name judges the same
grasps. Without a batch it is only set up.
"""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from benchmarks.bench import Options as Shared
from benchmarks.common import known
from benchmarks.dexgraspbench_checkout import HANDS, Installed, install
from benchmarks.summary import count, of, percentage, share, summary
from planner.batch import GraspSet
from planner.errors import TaskError
from planner.exchange.dexgraspbench import export_dexgraspbench
from planner.exchange.dexgraspbench.models import file_name
from sim.cli.common import err, out, say
from sim.protocols.dexgraspbench import dexgraspbench_cases
from sim.tables import Row

SETTINGS = ("fc", "tabletop")
"""The benchmark's settings for hands without an arm."""


@dataclass(frozen=True, kw_only=True)
class Options(Shared):
    """All grasps of the batches; neither -n nor --seed counts."""

    batches: Annotated[
        list[Path] | None,
        typer.Argument(help="Folders of batches; without one, only sets up.", metavar="[BATCH]..."),
    ] = None
    benchmark: Annotated[
        str, typer.Option(help="Path or URL of DexGraspBench's git repository.")
    ] = "https://github.com/JYChen18/DexGraspBench"
    meshes: Annotated[
        str | None,
        typer.Option(help="Path or URL of MuJoCo Menagerie, for the benchmark's own hands."),
    ] = None
    home: Annotated[
        Path, typer.Option(help="Folder for environment, checkout, export and results.")
    ] = Path("dexgraspbench")
    settings: Annotated[str, typer.Option(help="The benchmark's settings, comma separated.")] = (
        "fc,tabletop"
    )
    compare: Annotated[
        bool,
        typer.Option(
            help="Also judge every grasp by our own --protocol dexgraspbench.", metavar=""
        ),
    ] = True


def cases(options: Options) -> Iterator[Row]:
    """The benchmark's verdicts, which go on where an evaluation ended.

    Raises:
        PlannerError: A batch cannot be read or exported, or the benchmark fails.
    """
    settings = known("setting of DexGraspBench", options.settings, SETTINGS)
    installed = install(options.home, options.benchmark, options.meshes)
    if not options.batches:
        for hand in HANDS:
            if hand not in installed.lacking:
                say(out, escape(f"plan with: opposable batch {installed.hand_file(hand)} ..."))
        if installed.lacking:
            lacking = ", ".join(installed.lacking)
            say(out, escape(f"without meshes: {lacking}; give --meshes to plan with them"))
    home, seen = options.home.resolve(), dict[str, Path]()
    for folder in options.batches or ():
        batch = GraspSet(folder)
        done = export_dexgraspbench(batch, home / "export")
        if done.hand in seen:
            raise TaskError(
                f"two batches are of the hand {done.hand}, in {seen[done.hand]} and {folder}; give "
                "one batch with all objects"
            )
        seen[done.hand] = folder
        for reason, n in done.left_out.items():
            say(err, escape(f"{done.hand}: {n} grasps left out: {reason}"))
        model = installed.opened(home / "export" / "hand" / done.hand / f"{done.hand}.xml")
        rows = {
            name: _evaluated(installed, home, done.hand, name, options.workers) for name in settings
        }
        for label in batch.labels:
            for number, row in batch.found(label):
                file = f"{file_name(label)}/{row['k']}.npy"
                here = {name: rows[name][file] for name in settings if file in rows[name]}
                if len(here) == len(settings):  # else left out by the export
                    yield {
                        "hand": done.hand,
                        "object": label,
                        "k": int(row["k"]),
                        "batch": str(folder),
                        "row": number,
                        "mujoco": model["mujoco"],
                        "compare": options.compare,
                        "penetration_mm": 1e3 * next(iter(here.values()))["ho_pene"],
                        **{name: bool(r["succ_flag"]) for name, r in here.items()},
                        **{f"{n}_moved_mm": 1e3 * r["delta_pos"] for n, r in here.items()},
                        **{f"{n}_turned_deg": r["delta_angle"] for n, r in here.items()},
                    }


def measure(case: Row) -> Row:
    """Our verdict on a grasp: held in all six directions; it ends at the first that fails."""
    if not case["compare"]:
        return {"ours": None, "same": None}
    plan = GraspSet(case["batch"]).plan(case["row"])
    held = all(test.run(plan).held for test in dexgraspbench_cases())
    return {"ours": held, "same": held == case["fc"] if "fc" in case else None}


def _evaluated(
    installed: Installed, home: Path, hand: str, setting: str, workers: int
) -> dict[str, Row]:
    """The benchmark's rows of an export by file, OBJECT/K.npy; those that are there are kept."""
    export = home / "export"
    out = home / "evaluation" / setting / hand
    note, stamp = out / "export.sha256", _digest(export, hand)
    if not (note.is_file() and note.read_text(encoding="utf-8") == stamp):
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir(parents=True)
        note.write_text(stamp, encoding="utf-8")
    there = len(list((export / "graspdata" / hand).glob("*/*.npy")))
    rows = {row["file"]: row for row in installed.results(out)}
    if len(rows) == there:
        return rows
    installed.evaluate(
        [
            "--config-dir",
            str(export),
            "task=eval",
            f"hand={hand}",
            f"setting={setting}",
            f"n_worker={workers}",
            "skip=True",  # grasps with a result in eval_dir
            "task.analytic_fc_metrics=null",
            f"grasp_dir={export / 'graspdata' / hand}",
            f"eval_dir={out}",
            f"succ_dir={home / 'evaluation' / 'success' / setting / hand}",
            f"log_dir={home / 'evaluation' / 'log' / setting / hand}",
        ]
    )
    rows = {row["file"]: row for row in installed.results(out)}
    if len(rows) != there:
        raise TaskError(
            f"DexGraspBench evaluated {len(rows)} of {there} grasps by {hand} in its setting "
            f"{setting}; its log is in {home / 'evaluation' / 'log' / setting / hand}"
        )
    return rows


def _digest(export: Path, hand: str) -> str:
    """Of the grasps by a hand, their objects and the hand."""
    grasps = export / "graspdata" / hand
    folders = [grasps, export / "hand" / hand]
    folders += [export / "object" / item.name for item in grasps.iterdir()]
    files = sorted(path for folder in folders for path in folder.rglob("*") if path.is_file())
    whole = hashlib.sha256()
    for path in [export / "hand" / f"{hand}.yaml", *files]:
        whole.update(f"{path.relative_to(export)}\n".encode() + path.read_bytes())
    return whole.hexdigest()


def tables(result: Row) -> Iterator[Row]:
    """Shares that hold, penetration and agreement per hand and object, and per hand."""
    yield summary(
        "DexGraspBench: grasps that hold; mm of hand in object, median and worst; same verdict as "
        "our --protocol dexgraspbench",
        result["rows"],
        ("hand", "object"),
        {
            "grasps": count,
            **{f"{n} held": share(n) for n in SETTINGS if n in result["setting"]["settings"]},
            **{n: percentage(n) for n in SETTINGS if n in result["setting"]["settings"]},
            "mm": of("penetration_mm"),
            "worst": of("penetration_mm", "max"),
            "same": share("same", known="same"),
        },
        [(None, "all")],
    )
