"""Have DexGraspBench itself, in its pinned versions, evaluate batches of grasps.

Batches are exported, the benchmark evaluates them, and our protocol of that name judges the same
grasps. Without a batch it is only set up.

``install``: a scratch environment and a checkout of it, in one folder that can be thrown away.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape

from benchmarks.bench import Options as Shared
from benchmarks.common import known
from benchmarks.summary import count, of, percentage, share, summary
from planner.batch import GraspSet
from planner.errors import FileFormatError, TaskError
from planner.exchange.dexgraspbench import export_dexgraspbench
from planner.exchange.dexgraspbench.models import file_name
from sim.cli.common import err, out, say
from sim.protocols.dexgraspbench import dexgraspbench_cases
from sim.tables import Row

COMMIT = "1e7a5a6"
"""Of https://github.com/JYChen18/DexGraspBench, 2025-06-05."""

HANDS = ("shadow", "allegro", "leap")
"""Hands of the benchmark without an arm: ``assets/hand/NAME/right_hand.xml``."""

MESHES = ("shadow_hand", "wonik_allegro", "leap_hand")
"""Folders of MuJoCo Menagerie that the files of these hands name."""

REQUIREMENTS = (
    "mujoco==3.3.2",
    "numpy==1.26.4",
    "scipy>=1.14,<1.16",
    "trimesh",
    "hydra-core",
    "transforms3d",
    "matplotlib",
    "scikit-learn",
    "imageio",
    "qpsolvers[clarabel]",
)
"""What the benchmark's README installs, without what its evaluation does not use (see
``dexgraspbench_launch.ABSENT``). The two versions are its own; its scipy is the newest for that
numpy, and 1.14 is the first with the ``scalar_first`` that it uses."""

UNCHANGED = ("src", "config", "assets/hand")
"""Folders of a checkout in which nothing may differ from the commit."""

LAUNCH = Path(__file__).with_name("dexgraspbench_launch.py")
"""Script for the environment's Python."""

LAST_LINES = 15
"""Lines of a failed command's output that the error repeats."""


@dataclass(frozen=True, kw_only=True)
class Installed:
    """The benchmark, ready to run.

    Attributes:
        python: Of its environment.
        checkout: Its files.
        lacking: Hands whose meshes are not there.
    """

    python: Path
    checkout: Path
    lacking: tuple[str, ...]

    def hand_file(self, hand: str) -> Path:
        """The benchmark's own file of one of ``HANDS``."""
        return self.checkout / "assets" / "hand" / hand / "right_hand.xml"

    def evaluate(self, arguments: Sequence[str]) -> None:
        """Run ``src/main.py`` with arguments.

        Raises:
            TaskError: It fails.
        """
        command(self._launch("run", str(self.checkout), *arguments), "DexGraspBench")

    def results(self, folder: Path) -> list[dict[str, Any]]:
        """What it found, one row per grasp: ``file`` and its numbers."""
        text = command(self._launch("read", str(folder)), "reading results of DexGraspBench")
        return [json.loads(line) for line in text.splitlines()]

    def opened(self, model: Path) -> dict[str, Any]:
        """Version of MuJoCo there, and nq and nu of a model that it compiles.

        Raises:
            TaskError: It refuses the model.
        """
        out: dict[str, Any] = json.loads(
            command(self._launch("open", str(model)), f"opening {model}")
        )
        return out

    def _launch(self, *arguments: str) -> list[str]:
        # isolated: no module of the current folder is imported
        return [str(self.python), "-I", str(LAUNCH), *arguments]


def install(
    home: Path, benchmark: str, meshes: str | None = None, *, commit: str | None = None
) -> Installed:
    """Make what is missing: ``HOME/env``, ``HOME/checkout`` at a commit, the meshes.

    Args:
        home: Folder for all of it.
        benchmark: Path or URL of a git repository with the benchmark.
        meshes: Path or URL of MuJoCo Menagerie, or a folder laid out as it is; None if no hand of
            the benchmark is used, or they are there.
        commit: Of the benchmark; ``COMMIT`` if None.

    Raises:
        TaskError: git, pip or a download fails; says what they said.
        FileFormatError: The folder cannot be written.
    """
    home = home.resolve()
    checkout, third = home / "checkout", home / "checkout" / "third_party" / "mujoco_menagerie"
    try:
        home.mkdir(parents=True, exist_ok=True)
        python = _environment(home / "env")
        if not (checkout / "src" / "main.py").exists():
            shutil.rmtree(checkout, ignore_errors=True)
            _clone(benchmark, checkout)
        command(
            ["git", "-C", str(checkout), "checkout", "-q", "--detach", commit or COMMIT],
            "git checkout",
        )
        changed = ["git", "-C", str(checkout), "status", "--porcelain", "--", *UNCHANGED]
        if text := command(changed, "git status"):
            raise TaskError(
                f"{checkout} was changed: {' '.join(text.split())}; remove that folder, and the "
                "benchmark is fetched anew"
            )
        if meshes is not None and _lacking(third):
            source = Path(meshes)
            if not source.is_dir():
                source = home / "menagerie"
                shutil.rmtree(source, ignore_errors=True)
                _clone(meshes, source, "--depth", "1")
            for name in MESHES:
                if (source / name).is_dir():
                    shutil.copytree(source / name, third / name, dirs_exist_ok=True)
    except OSError as error:
        raise FileFormatError(f"cannot write to {home}: {error.strerror}") from error
    return Installed(python=python, checkout=checkout, lacking=_lacking(third))


def command(words: Sequence[str], what: str) -> str:
    """What a program prints.

    Raises:
        TaskError: It is not there or fails; its last lines are told.
    """
    try:
        done = subprocess.run(words, capture_output=True, text=True, check=False)
    except OSError as error:
        raise TaskError(f"{what}: cannot run {words[0]}: {error.strerror}; install it") from error
    if done.returncode != 0:
        last = "\n".join((done.stdout + done.stderr).strip().splitlines()[-LAST_LINES:])
        raise TaskError(f"{what} failed with code {done.returncode}; the last it said:\n{last}")
    return done.stdout


def _environment(folder: Path) -> Path:
    """Python of a virtual environment with ``REQUIREMENTS``; made anew when they have changed."""
    python, note = folder / "bin" / "python", folder / "requirements.txt"
    wanted = "\n".join(REQUIREMENTS) + "\n"
    if python.exists() and note.exists() and note.read_text(encoding="utf-8") == wanted:
        return python
    shutil.rmtree(folder, ignore_errors=True)
    command([sys.executable, "-m", "venv", str(folder)], "making an environment")
    command([str(python), "-m", "pip", "install", "-q", *REQUIREMENTS], "pip install")
    note.write_text(wanted, encoding="utf-8")
    return python


def _clone(source: str, folder: Path, *options: str) -> None:
    command(["git", "clone", "-q", *options, source, str(folder)], f"git clone {source}")


def _lacking(third: Path) -> tuple[str, ...]:
    """Hands whose meshes are not there."""
    there = [(third / name).is_dir() for name in MESHES]
    return tuple(hand for hand, found in zip(HANDS, there, strict=True) if not found)


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
        told = ["--config-dir", str(home / "export"), f"hand={done.hand}"]
        rows = {
            name: evaluated(installed, home, done.hand, name, [*told, f"setting={name}"], options)
            for name in settings
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


def evaluated(
    installed: Installed,
    home: Path,
    hand: str,
    name: str,
    arguments: Sequence[str],
    options: Shared,
) -> dict[str, Row]:
    """The benchmark's rows of ``HOME/export`` by file, OBJECT/K.npy; those that are there are kept.

    Args:
        installed: The benchmark.
        home: Folder of export and evaluations.
        hand: Its grasps are in ``HOME/export/graspdata/HAND``.
        name: Of this evaluation.
        arguments: What the benchmark is told beside folders: hand, setting.
        options: Tell the number of processes.

    Raises:
        TaskError: The benchmark fails, or leaves grasps out.
    """
    grasps = home / "export" / "graspdata" / hand
    out = home / "evaluation" / name / hand
    note, stamp = out / "export.sha256", _digest(home / "export", hand)
    if not (note.is_file() and note.read_text(encoding="utf-8") == stamp):
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir(parents=True)
        note.write_text(stamp, encoding="utf-8")
    there = len(list(grasps.glob("*/*.npy")))
    rows = {row["file"]: row for row in installed.results(out)}
    if len(rows) == there:
        return rows
    log = home / "evaluation" / "log" / name / hand
    installed.evaluate(
        [
            *arguments,
            "task=eval",
            f"n_worker={options.workers}",
            "skip=True",  # grasps with a result in eval_dir
            "task.analytic_fc_metrics=null",
            f"grasp_dir={grasps}",
            f"eval_dir={out}",
            f"succ_dir={home / 'evaluation' / 'success' / name / hand}",
            f"log_dir={log}",
        ]
    )
    rows = {row["file"]: row for row in installed.results(out)}
    if len(rows) != there:
        raise TaskError(
            f"{installed.checkout} evaluated {len(rows)} of {there} grasps by {hand} as {name}; "
            f"its log is in {log}"
        )
    return rows


def _digest(export: Path, hand: str) -> str:
    """Of the grasps by a hand, their objects and the hand."""
    grasps = export / "graspdata" / hand
    folders = [grasps, export / "hand" / hand]
    folders += [export / "object" / item.name for item in grasps.iterdir()]
    files = sorted(path for folder in folders for path in folder.rglob("*") if path.is_file())
    whole = hashlib.sha256()
    described = export / "hand" / f"{hand}.yaml"
    for path in [*filter(Path.is_file, [described]), *files]:
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
