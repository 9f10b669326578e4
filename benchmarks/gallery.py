"""Run every example and film it: the gallery of the documentation.

Each entry, a script in ``examples`` or a command, runs in an empty folder of its own; its plot,
film or printed text becomes a small picture, and its page stays as it is.

Each runs in a process of its own, as it is; its last simulation is filmed, and its page kept.

    python -m benchmarks.gallery FOLDER SCRIPT
    python -m benchmarks.gallery FOLDER opposable ARGUMENTS...

FOLDER then holds ``film.webp`` and ``page.html`` of the last trial or manipulation; of a run that
only plans, those of its last plan, which is held in a trial of its own.
"""

from __future__ import annotations

import ast
import os
import runpy
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import wraps
from importlib.metadata import entry_points
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import typer
from PIL import Image, ImageDraw, ImageFont, ImageSequence

import planner.search.grasp
from benchmarks.bench import Options as Shared
from benchmarks.summary import table_data
from planner.errors import NotFoundError, TaskError
from sim.cli.common import make_folder
from sim.manipulation.run import ManipulationRun
from sim.tables import Row, number
from sim.trial import Trial, simulate

FILM, PAGE = "film.webp", "page.html"
"""Files that a run leaves."""


def watch(folder: Path, arguments: list[str]) -> None:
    """Run and film.

    Args:
        folder: Where film and page go.
        arguments: A script, or "opposable" and its arguments.
    """
    plans: list[Any] = []
    shown: list[Any] = []
    _film(Trial, "run", folder, shown)
    _film(ManipulationRun, "perform", folder, shown)
    _keep_plans(plans)
    try:
        if arguments[0] == "opposable":
            (program,) = entry_points(group="console_scripts", name="opposable")
            sys.argv = arguments
            program.load()()
        else:
            sys.argv = arguments
            sys.path.insert(0, str(Path(arguments[0]).parent))
            runpy.run_path(arguments[0], run_name="__main__")
    finally:
        if plans and not shown:
            simulate(plans[-1])
            shown[:] = plans[-1:]
        if shown:
            shown[-1].save_html(folder / PAGE)


def _film(owner: Any, method: str, folder: Path, shown: list[Any]) -> None:
    """Let a method that simulates film and leave its report."""
    original: Callable[..., Any] = getattr(owner, method)

    @wraps(original)
    def filmed(self: Any, **options: Any) -> Any:
        report = original(self, **{**options, "video": folder / FILM})
        shown.append(report)
        return report

    setattr(owner, method, filmed)


def _keep_plans(plans: list[Any]) -> None:
    """Note what ``plan_grasp`` finds."""
    home: Any = planner.search.grasp
    original = home.search

    @wraps(original)
    def noted(*arguments: Any, **options: Any) -> Any:
        plan, made = original(*arguments, **options)
        if plan is not None:
            plans.append(plan)
        return plan, made

    home.search = noted


FORMAT = "opposable-gallery"

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
"""Folder of the examples, in the checkout."""

FULL_TURN = (
    *("manipulate", "shadow_hand", "cylinder:0.03x0.08", "--rotate", "z:360"),
    *("--mu", "0.7", "--sim-mu", "0.8"),
)
"""By strokes and regrasps: the hand turns the object by some 60 degrees at a time."""

COMMANDS = {
    "demo": ("The demonstration: pick, turn by 90 degrees, place", ("demo",)),
    "full-turn": (
        "A full turn in the hand, by strokes and regrasps",
        FULL_TURN,
    ),
}
"""Commands beside the scripts: name -> title and arguments of ``opposable``."""

GROUPS = {"": "Examples", "lab": "The lab's six steps and its errors"}
"""Folder below ``examples`` -> heading."""

MODULES = {EXAMPLES / "udp_hand.py"}
"""What stands beside the scripts to be imported by them."""

TIME_LIMIT = 900.0
"""Longest that an entry may run, s."""

SIZE = (320, 240)

FRAMES = 30

QUALITY = 32
"""Pixels, most frames and WebP quality of a film in the gallery: some 40 kB."""

TERMINAL, TERMINAL_TEXT, TEXT_SIZE = (30, 34, 42), (216, 222, 233), 13
"""Colours and size (pixels) of printed text as a picture."""

MOST_LINES = 60
"""Lines of output that are kept."""


@dataclass(frozen=True, kw_only=True)
class Options(Shared):
    """Entries; neither -n nor --seed counts."""

    entries: Annotated[
        list[str] | None,
        typer.Argument(help="Entries of the gallery; all if none is named.", metavar="[ENTRY]..."),
    ] = None
    pictures: Annotated[Path, typer.Option(help="Folder for films and pictures.")] = Path(
        "docs/gallery/pictures"
    )
    pages: Annotated[
        Path | None, typer.Option(help="Folder for pages with 3D scenes; no pages if none.")
    ] = None


def gallery_entries() -> list[Row]:
    """All of them, the scripts by name, then the commands: name, heading, title and what runs."""
    entries: list[Row] = []
    for folder, heading in GROUPS.items():
        for path in sorted(set((EXAMPLES / folder).glob("*.py")) - MODULES):
            document = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or path.stem
            title = " ".join(document.split("\n\n")[0].split()).removesuffix(".")
            told = {"name": path.stem, "group": heading, "title": title}
            script = path.relative_to(EXAMPLES).as_posix()
            entries.append({**told, "script": script, "command": []})
    for name, (title, arguments) in COMMANDS.items():
        told = {"name": name, "group": "Commands", "title": title}
        entries.append({**told, "script": "", "command": list(arguments)})
    return entries


def cases(options: Options) -> Iterator[Row]:
    """The entries that were asked for.

    Raises:
        NotFoundError: Nothing in the gallery is called so.
    """
    by_name = {entry["name"]: entry for entry in gallery_entries()}
    for name in options.entries or ():
        if name not in by_name:
            raise NotFoundError("entry of the gallery", name, by_name)
    for folder in filter(None, (options.pictures, options.pages)):
        make_folder(folder)
    folders = {"pictures": str(options.pictures), "pages": str(options.pages or "")}
    yield from ({**by_name[name], **folders} for name in options.entries or by_name)


def measure(case: Row) -> Row:
    """Run an entry; its film becomes small, its page stays as it is.

    Raises:
        TaskError: It took too long.
    """
    with TemporaryDirectory() as folder:
        there = Path(folder)
        (there / "run").mkdir()
        script = str(EXAMPLES / case["script"])
        what = ["opposable", *case["command"]] if case["command"] else [script]
        begin = os.times()
        try:
            done = subprocess.run(
                [sys.executable, "-W", "ignore", "-m", "benchmarks.gallery", folder, *what],
                cwd=there / "run",
                env={**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[1])},
                capture_output=True,
                text=True,
                timeout=TIME_LIMIT,
                check=False,
            )
        except subprocess.TimeoutExpired as error:
            raise TaskError(f"{case['name']} took longer than {TIME_LIMIT:g} s") from error
        end, page = os.times(), ""
        if case["pages"] and (there / PAGE).is_file():
            page = f"{case['name']}.html"
            (Path(case["pages"]) / page).write_bytes((there / PAGE).read_bytes())
        lines = (done.stdout if done.returncode == 0 else done.stderr).splitlines()
        kept = [line.replace(f"{folder}/run/", "").rstrip() for line in lines]
        picture = _picture(there, Path(case["pictures"]), case["name"], "\n".join(kept))
    own = end.children_user + end.children_system - begin.children_user - begin.children_system
    return {
        "ok": done.returncode == 0,
        "output": "\n".join(kept[:MOST_LINES] + ["..."] * (len(kept) > MOST_LINES)),
        "picture": picture,
        "page": page,
        "cpu_s": round(own, 2),
    }


def _picture(folder: Path, pictures: Path, name: str, printed: str) -> str:
    """The entry's own plot if it drew one, else its film, else what it printed; the file's name."""
    plots = sorted((folder / "run").glob("*.png"))
    target = pictures / f"{name}.webp"
    if plots:
        with Image.open(plots[0]) as image:
            plot = image.convert("RGB")
            plot.thumbnail((2 * SIZE[0], 2 * SIZE[1]), Image.Resampling.LANCZOS)
            plot.save(target, "WEBP", quality=70, method=6)
    elif (folder / FILM).is_file():
        small_film(folder / FILM, target)
    else:
        text_picture(printed, target)
    return target.name


def text_picture(printed: str, target: Path) -> None:
    """The first lines of what an entry printed, as a terminal shows them."""
    from matplotlib import font_manager

    size = (2 * SIZE[0], 2 * SIZE[1])
    image = Image.new("RGB", size, TERMINAL)
    font = ImageFont.truetype(font_manager.findfont("DejaVu Sans Mono"), TEXT_SIZE)
    draw, step = ImageDraw.Draw(image), round(1.35 * TEXT_SIZE)
    for k, line in enumerate(printed.splitlines()[: size[1] // step - 1]):
        draw.text((step, step * (k + 0.5)), line, font=font, fill=TERMINAL_TEXT)
    image.save(target, "WEBP", quality=80, method=6)


def small_film(film: Path, target: Path) -> None:
    """A film of few pixels and frames, as long as the given one."""
    with Image.open(film) as opened:
        count = int(getattr(opened, "n_frames", 1))
        every = -(-count // FRAMES)
        frames, duration = [], 0
        for k, frame in enumerate(ImageSequence.Iterator(opened)):
            duration += int(frame.info.get("duration", 40))
            if k % every == 0:
                frames.append(frame.convert("RGB").resize(SIZE, Image.Resampling.LANCZOS))
    frames[0].save(
        target,
        "WEBP",
        save_all=True,
        append_images=frames[1:],
        duration=max(20, duration // len(frames)),
        loop=0,
        quality=QUALITY,
        method=6,
    )


def tables(result: Row) -> Iterator[Row]:
    """Whether each entry ran, and what it left."""
    lines = []
    for row in (row for row in result["rows"] if not row["error"]):
        ran = "yes" if row["ok"] else f"no: {row['output'].splitlines()[-1:]}"
        left = (row["picture"] or "-", row["page"] or "-", number(row["cpu_s"], 1))
        lines.append([row["name"], ran, *left])
    yield table_data("gallery", ("entry", "ran", "picture", "page"), ("CPU s",), lines)


if __name__ == "__main__":
    watch(Path(sys.argv[1]).absolute(), sys.argv[2:])
