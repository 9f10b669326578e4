"""The hand zoo and the gallery: what is in them, what is measured, and the pages that say so."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("sphinx")

from benching import run_bench
from machinery.zoo import CARDS, gallery_pages, plain, zoo_pages
from PIL import Image
from test_foreign_hands import GRIPPER

from benchmarks import gallery, zoo
from benchmarks.gallery import EXAMPLES, gallery_entries
from benchmarks.zoo import ZooModel, chosen, zoo_models
from planner.errors import FileFormatError, NotFoundError

DOCS = EXAMPLES.parent / "docs"


def kept(name: str) -> dict[str, Any]:
    """What is in the checkout."""
    data: dict[str, Any] = json.loads((DOCS / name / f"{name}.json").read_text(encoding="utf-8"))
    return data


def others(folder: Path, text: str) -> ZooModel:
    """A model in a clone of somebody's repository."""
    path = folder / "someone" / "hands" / "model.xml"
    path.parent.mkdir(parents=True)
    path.write_text(text, encoding="utf-8")
    reference = path.relative_to(folder).as_posix()
    return ZooModel(name="A hand", source="repository", reference=reference)


def test_all_sources_are_there_and_every_hand_has_a_name_of_its_own() -> None:
    models = zoo_models()
    assert {m.source for m in models} == {"shipped", "package", "repository"}
    assert len({m.slug for m in models}) == len(models) >= 50
    assert sum(m.source == "repository" for m in models) >= 20
    for model in models:
        assert re.fullmatch(r"[a-z0-9-]+", model.slug)
        if model.source == "repository":
            where = r"https://github\.com/[\w-]+/[\w-]+/blob/[0-9a-f]{40}/\S+"
            assert re.fullmatch(where, model.url.replace(" ", "%20")), model.url


def test_two_hands_of_one_name_are_refused(tmp_path: Path) -> None:
    entry = '[[repositories]]\nrepository = "a/b"\ncommit = "c"\nhands = [["{}", "x"], ["{}", "y"]]'
    (tmp_path / "list.toml").write_text(entry.format("One hand", "one, hand"))
    with pytest.raises(FileFormatError, match="names hands alike: one-hand"):
        zoo_models(tmp_path / "list.toml")
    (tmp_path / "list.toml").write_text("[[repositories]]\nrepository = 1")
    with pytest.raises(FileFormatError, match="lacks repository, commit or hands"):
        zoo_models(tmp_path / "list.toml")


def test_hands_are_chosen_by_name() -> None:
    models = zoo_models()
    assert [m.name for m in chosen(models, ["barrett-hand", "shadow_hand"])] == [
        "Barrett hand",
        "shadow_hand",
    ]
    with pytest.raises(NotFoundError, match="no hand of the zoo is called 'Barret hand'"):
        chosen(models, ["Barret hand"])


def row_of(model: ZooModel, folder: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    monkeypatch.setattr(zoo, "zoo_models", lambda file: [model])
    (row,) = run_bench("zoo", models=folder, cpu_s=5.0)["rows"]
    return dict(row)


@pytest.mark.slow
def test_a_hand_that_holds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (model,) = chosen(zoo_models(), ["allegro_hand"])
    row = row_of(model, tmp_path, monkeypatch)
    assert (row["status"], len(row["fingers"]), row["joints"]) == ("held", 4, 16)
    grasp = row["grasp"]
    where = f"{grasp['object']} --seed {grasp['seed']}"
    assert grasp["command"] == f"opposable run allegro_hand {where}"
    assert [t["held"] for t in row["tries"]] == [False] * (len(row["tries"]) - 1) + [True]
    assert set(row) >= set(kept("zoo")["rows"][0]) - {"index"}  # what pages are made of


def test_a_gripper_is_refused_and_a_broken_model_says_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    row = row_of(others(tmp_path / "a", GRIPPER), tmp_path / "a", monkeypatch)
    assert (row["status"], row["tries"]) == ("refused", [])
    assert row["reason"].startswith("two fingers take part: a gripper")
    row = row_of(others(tmp_path / "b", "<mujoco><"), tmp_path / "b", monkeypatch)
    assert row["status"] == "not usable"
    assert "someone/hands/model.xml" in row["reason"]
    assert str(tmp_path) not in row["reason"]  # no folder of this machine


def test_every_script_is_an_entry_with_a_title() -> None:
    entries = gallery_entries()
    listed = {e["script"] for e in entries if e["script"]}
    modules = {"udp_hand.py", "formats/dexgraspnet.py", "formats/frogger.py"}
    scripts = {p.relative_to(EXAMPLES).as_posix() for p in EXAMPLES.glob("**/*.py")}
    assert listed | modules == scripts
    assert len({e["name"] for e in entries}) == len(entries)
    assert all(e["title"] and not e["title"].endswith(".") for e in entries)
    with pytest.raises(NotFoundError, match="no entry of the gallery is called 'demmo'"):
        run_bench("gallery", entries=["demmo"])


@pytest.mark.slow
def test_scripts_run_in_an_empty_folder_and_their_plots_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    draw = "from PIL import Image; Image.new('RGB', (900, 700), 'red').save('plot.png')"
    look = "import os; print(os.listdir('.'), 'in', os.getcwd())"
    plan = """
from dataclasses import replace
from planner import GraspTask, plan_grasp
from sim.scene.carrier import Timeline
from sim.show import picture
picture.PICTURE = replace(picture.PICTURE, size=(320, 240), larger=1.0, shadows=512)
brief = {"approach": 0.3, "squeeze": 0.4, "lift": 0.2, "hold": 0.1, "lift_height": 0.02}
Timeline.__init__.__kwdefaults__ |= brief  # a film of a second
plan_grasp(GraspTask.create("allegro_hand", "sphere"))
"""
    scripts = {"draws": f"{look}\n{draw}", "fails": "print(1 / 0)", "plans": plan}
    entries = []
    for name, text in scripts.items():
        (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")
        told = {"name": name, "group": "Examples", "title": "Mine", "script": f"{name}.py"}
        entries.append({**told, "command": []})
    monkeypatch.setattr(gallery, "EXAMPLES", tmp_path)
    monkeypatch.setattr(gallery, "gallery_entries", lambda: entries)
    pictures, pages = tmp_path / "pictures", tmp_path / "pages"
    result = run_bench("gallery", pictures=pictures, pages=pages)
    draws, fails, plans = result["rows"]
    assert draws["ok"] and draws["output"].startswith("[] in ") and draws["page"] == ""
    with Image.open(pictures / draws["picture"]) as image:
        assert image.size == (617, 480)
    assert not fails["ok"]
    assert fails["output"].endswith("ZeroDivisionError: division by zero")
    assert plans["ok"], plans["output"]
    assert "allegro_hand" in (pages / plans["page"]).read_text(encoding="utf-8")
    assert set(plans) >= set(kept("gallery")["rows"][0]) - {"index"}


def frames_of(film: Any) -> int:
    """Number of frames of an opened film."""
    count: int = film.n_frames
    return count


def test_a_film_becomes_small_and_keeps_its_length(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    frames = [Image.fromarray(rng.integers(0, 255, (48, 64, 3), dtype=np.uint8)) for _ in range(90)]
    frames[0].save(
        tmp_path / "long.webp", save_all=True, append_images=frames[1:], duration=40, loop=0
    )
    gallery.small_film(tmp_path / "long.webp", tmp_path / "small.webp")
    with Image.open(tmp_path / "small.webp") as film:
        assert (film.size, frames_of(film)) == (gallery.SIZE, 30)
        length = 0
        for k in range(frames_of(film)):
            film.seek(k)
            film.load()
            length += int(film.info["duration"])
    assert abs(length - 90 * 40) <= 30


def test_what_is_kept_shows_every_entry_and_all_of_them_ran() -> None:
    rows = kept("gallery")["rows"]
    assert {row["name"] for row in rows} == {e["name"] for e in gallery_entries()}
    for row in rows:
        assert row["ok"], row["name"]
        if row["picture"]:
            assert (DOCS / "gallery" / "pictures" / row["picture"]).stat().st_size < 150_000


def test_every_card_leads_to_a_page() -> None:
    for pages in (gallery_pages(kept("gallery"), {"demo.html"}), zoo_pages(kept("zoo"))):
        links = set(re.findall(r"\(generated/([\w-]+\.md)\)", pages[CARDS]))
        assert links == set(pages) - {CARDS}
    assert "../../scenes/demo.html" in gallery_pages(kept("gallery"), {"demo.html"})["demo.md"]
    assert plain("a_b|c") == r"a\_b\|c"
    assert '"machinery.zoo"' in (DOCS / "conf.py").read_text(encoding="utf-8")
