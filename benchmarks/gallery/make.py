"""``run_gallery``: run every entry in an empty folder of its own; text, film and page."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar

from PIL import Image, ImageDraw, ImageFont, ImageSequence

from benchmarks.gallery.entries import EXAMPLES, Entry
from benchmarks.gallery.watch import FILM, PAGE
from benchmarks.run import Job, measure
from sim.runner import Check, Runner
from sim.tables import Row

FORMAT = "opposable-gallery"

ROOT = Path(__file__).resolve().parents[2]
"""The checkout, from which the scripts import."""

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
class EntryJob(Job):
    """One entry.

    Attributes:
        entry: What to run.
        pictures: Folder for its film or picture.
        pages: Folder for its page; None for none.
    """

    entry: Entry
    pictures: Path
    pages: Path | None

    NOTHING: ClassVar[Row] = {"ok": False, "output": "", "picture": "", "page": "", "cpu_s": None}

    def row(self, **values: Any) -> Row:
        """The row: what is not given stands for an entry that could not be run."""
        e = self.entry
        told = {"name": e.name, "group": e.group, "title": e.title, "script": e.script}
        return super().row(**{**told, "command": list(e.command), **self.NOTHING, **values})

    def lost(self, reason: str) -> Row:
        """The row of an entry that could not be run."""
        return self.row(output=reason)


def run_entry(job: EntryJob, check: Check) -> Row:
    """Run an entry; its film becomes small, its page stays as it is."""
    entry = job.entry
    with TemporaryDirectory() as folder:
        there = Path(folder)
        (there / "run").mkdir()
        what = ["opposable", *entry.command] if entry.command else [str(EXAMPLES / entry.script)]
        begin = os.times()
        try:
            done = subprocess.run(
                [sys.executable, "-W", "ignore", "-m", "benchmarks.gallery.watch", folder, *what],
                cwd=there / "run",
                env={**os.environ, "PYTHONPATH": str(ROOT)},
                capture_output=True,
                text=True,
                timeout=TIME_LIMIT,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return job.lost(f"it took longer than {TIME_LIMIT:g} s")
        end = os.times()
        check()
        page = ""
        if job.pages is not None and (there / PAGE).is_file():
            page = f"{entry.name}.html"
            (job.pages / page).write_bytes((there / PAGE).read_bytes())
        lines = (done.stdout if done.returncode == 0 else done.stderr).splitlines()
        kept = [line.replace(f"{folder}/run/", "").rstrip() for line in lines]
        picture = _picture(there, job.pictures, entry.name, "\n".join(kept))
        return job.row(
            ok=done.returncode == 0,
            output="\n".join(kept[:MOST_LINES] + ["..."] * (len(kept) > MOST_LINES)),
            picture=picture,
            page=page,
            cpu_s=round(
                end.children_user
                + end.children_system
                - begin.children_user
                - begin.children_system,
                2,
            ),
        )


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


def run_gallery(
    entries: Sequence[Entry],
    *,
    pictures: Path,
    pages: Path | None,
    file: Path,
    runner: Runner,
) -> Row:
    """Run all entries that the file does not have yet.

    Args:
        entries: What to run.
        pictures: Folder for films and pictures.
        pages: Folder for pages, some MB each; None for none.
        file: Of the rows, one per entry.
        runner: Who works.
    """
    jobs = [
        EntryJob(index=k, entry=entry, pictures=pictures, pages=pages)
        for k, entry in enumerate(entries)
    ]
    asked = {"format": f"{FORMAT}-rows", "version": 1, "entries": [e.name for e in entries]}
    return measure(
        runner,
        run_entry,
        jobs,
        kind=FORMAT,
        title="gallery",
        lost=EntryJob.lost,
        file=file,
        asked=asked,
        made_at=time.strftime("%Y-%m-%d"),
    )
