"""The gallery: every example, run as it stands, with what it shows and prints."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import needs
from PIL import Image
from rich.console import Console

from benchmarks.gallery import make
from benchmarks.gallery.entries import EXAMPLES, Entry, chosen, gallery_entries
from benchmarks.gallery.make import EntryJob, run_entry, run_gallery, small_film
from benchmarks.gallery.pages import CARDS, gallery_pages
from benchmarks.gallery.table import gallery_table
from planner.errors import NotFoundError
from sim.runner import Runner

HERE = Runner(console=Console(quiet=True), check=lambda: None)
GALLERY = EXAMPLES.parent / "docs" / "gallery"


def entry(folder: Path, text: str, monkeypatch: pytest.MonkeyPatch) -> EntryJob:
    """The job of a script of ours."""
    (folder / "mine.py").write_text(text, encoding="utf-8")
    monkeypatch.setattr(make, "EXAMPLES", folder)
    for name in ("pictures", "pages"):
        (folder / name).mkdir()
    one = Entry(name="mine", group="Examples", title="Mine", script="mine.py")
    return EntryJob(index=0, entry=one, pictures=folder / "pictures", pages=folder / "pages")


def frames_of(film: Any) -> int:
    """Number of frames of an opened film."""
    count: int = film.n_frames
    return count


def test_every_script_is_an_entry_with_a_title() -> None:
    entries = gallery_entries()
    listed = {e.script for e in entries if e.script}
    modules = {"udp_hand.py", "formats/dexgraspnet.py", "formats/frogger.py"}
    assert listed | modules == {
        p.relative_to(EXAMPLES).as_posix() for p in EXAMPLES.glob("**/*.py")
    }
    assert len({e.name for e in entries}) == len(entries)
    assert all(e.title and not e.title.endswith(".") for e in entries)
    assert {"demo", "full-turn"} <= {e.name for e in entries}
    with pytest.raises(NotFoundError, match="no entry of the gallery is called 'demmo'"):
        chosen(entries, ["demmo"])


@pytest.mark.slow
def test_a_script_runs_in_an_empty_folder_and_its_plot_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    draw = "from PIL import Image; Image.new('RGB', (900, 700), 'red').save('plot.png')"
    look = "import os; print(os.listdir('.'), 'in', os.getcwd())"
    row = run_entry(entry(tmp_path, f"{look}\n{draw}", monkeypatch), lambda: None)
    assert row["ok"], row["output"]
    assert row["output"].startswith("[] in ")
    with Image.open(tmp_path / "pictures" / row["picture"]) as kept:
        assert kept.size == (617, 480)
    assert row["page"] == ""


@pytest.mark.slow
def test_a_script_that_fails_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    row = run_entry(entry(tmp_path, "print(1 / 0)", monkeypatch), lambda: None)
    assert not row["ok"]
    assert row["output"].endswith("ZeroDivisionError: division by zero")


@pytest.mark.slow
def test_a_plan_is_held_filmed_and_has_its_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    script = "from planner import GraspTask, plan_grasp\n"
    script += "plan_grasp(GraspTask.create('allegro_hand', 'sphere'))"
    row = run_entry(entry(tmp_path, script, monkeypatch), lambda: None)
    assert row["ok"], row["output"]
    page = (tmp_path / "pages" / row["page"]).read_text(encoding="utf-8")
    assert "allegro_hand" in page
    if row["picture"]:  # where something can be drawn
        with Image.open(tmp_path / "pictures" / row["picture"]) as film:
            assert 2 <= frames_of(film) <= make.FRAMES


def test_a_film_becomes_small_and_keeps_its_length(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    frames = [Image.fromarray(rng.integers(0, 255, (48, 64, 3), dtype=np.uint8)) for _ in range(90)]
    frames[0].save(
        tmp_path / "long.webp", save_all=True, append_images=frames[1:], duration=40, loop=0
    )
    small_film(tmp_path / "long.webp", tmp_path / "small.webp")
    with Image.open(tmp_path / "small.webp") as film:
        assert (film.size, frames_of(film)) == (make.SIZE, 30)
        length = 0
        for k in range(frames_of(film)):
            film.seek(k)
            film.load()
            length += int(film.info["duration"])
    assert abs(length - 90 * 40) <= 30


def test_the_table_of_nothing(tmp_path: Path) -> None:
    made = run_gallery([], pictures=tmp_path, pages=None, file=tmp_path / "rows", runner=HERE)
    assert gallery_table(made).row_count == 0


@pytest.fixture(scope="module")
def kept() -> dict[str, Any]:
    """What is in the checkout."""
    import json

    data: dict[str, Any] = json.loads((GALLERY / "gallery.json").read_text(encoding="utf-8"))
    return data


def test_what_is_kept_shows_every_entry_and_all_of_them_ran(kept: dict[str, Any]) -> None:
    assert {row["name"] for row in kept["rows"]} == {e.name for e in gallery_entries()}
    for row in kept["rows"]:
        assert row["ok"], row["name"]
        if row["picture"]:
            assert (GALLERY / "pictures" / row["picture"]).stat().st_size < 150_000


def test_every_card_leads_to_a_page(kept: dict[str, Any]) -> None:
    scenes = {"demo.html"}
    pages = gallery_pages(kept, scenes)
    links = set(re.findall(r"\(generated/([\w-]+\.md)\)", pages[CARDS]))
    assert links == set(pages) - {CARDS}
    assert "../../scenes/demo.html" in pages["demo.md"]
    assert not any("scenes/" in text for name, text in pages.items() if name != "demo.md")


@needs("sphinx")
def test_the_documentation_writes_the_pages() -> None:
    """The extension is among those that ``docs/conf.py`` names."""
    conf = (GALLERY.parent / "conf.py").read_text(encoding="utf-8")
    assert '"machinery.zoo"' in conf
