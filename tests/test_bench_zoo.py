"""The hand zoo: which hands, what is measured of them, and the pages that say so."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console
from test_foreign_hands import GRIPPER
from typer.testing import CliRunner

from benchmarks.cards import plain
from benchmarks.zoo.measure import HandJob, look_at, run_zoo
from benchmarks.zoo.models import MODELS_FILE, ZooModel, chosen, zoo_models
from benchmarks.zoo.objects import fitting_objects, fitting_width
from benchmarks.zoo.pages import CARDS, write_pages, zoo_pages
from benchmarks.zoo.table import counts, zoo_tables
from planner.describe.report import CheckReport, PostureRow
from planner.errors import FileFormatError, NotFoundError
from sim.cli import app
from sim.runner import Runner

HERE = Runner(console=Console(quiet=True), check=lambda: None)
ZOO = MODELS_FILE.parent


@pytest.fixture(scope="module")
def kept() -> dict[str, Any]:
    """What is in the checkout."""
    data: dict[str, Any] = json.loads((ZOO / "zoo.json").read_text(encoding="utf-8"))
    return data


def job(model: ZooModel, folder: Path, cpu_s: float = 5.0) -> HandJob:
    return HandJob(index=0, model=model, folder=folder, pictures=None, cpu_s=cpu_s)


def others(folder: Path, text: str) -> ZooModel:
    """A model in a clone of somebody's repository."""
    path = folder / "someone" / "hands" / "model.xml"
    path.parent.mkdir(parents=True)
    path.write_text(text, encoding="utf-8")
    reference = path.relative_to(folder).as_posix()
    return ZooModel(name="A hand", source="repository", reference=reference)


# --- which hands ----------------------------------------------------------------------------------


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


# --- what is measured -----------------------------------------------------------------------------


def checked(pinch: float, wide: float) -> CheckReport:
    gaps = {"open": wide, "pinch": pinch}
    rows = tuple(PostureRow(name=n, gap=g, facing_deg=(), clearance=0.0) for n, g in gaps.items())
    empty = dict.fromkeys(("joints", "couplings", "workspaces", "pads", "touches", "findings"), ())
    return CheckReport(hand="h", postures=rows, kinematics_error=0.0, **empty)


def test_objects_fit_between_the_pads() -> None:
    assert fitting_width(checked(0.04, 0.1)) == 0.061
    assert fitting_width(checked(0.001, 0.001)) == 0.015  # no object is thinner
    assert fitting_objects(0.06)[:3] == [
        "cylinder:0.030x0.090",
        "sphere:0.030",
        "box:0.051x0.051x0.090",
    ]
    assert len(set(fitting_objects(0.06))) == 9


@pytest.mark.slow
def test_a_hand_that_holds(tmp_path: Path) -> None:
    (model,) = chosen(zoo_models(), ["allegro_hand"])
    row = look_at(job(model, tmp_path), lambda: None)
    assert (row["status"], len(row["fingers"]), row["joints"]) == ("held", 4, 16)
    grasp = row["grasp"]
    assert (
        grasp["command"] == f"opposable run allegro_hand {grasp['object']} --seed {grasp['seed']}"
    )
    assert [t["held"] for t in row["tries"]] == [False] * (len(row["tries"]) - 1) + [True]
    again = look_at(job(model, tmp_path), lambda: None)
    for timed in (row, again):
        timed["cpu_s"] = timed["grasp"]["cpu_s"] = 0.0
        timed["tries"] = [{**t, "cpu_s": 0.0} for t in timed["tries"]]
    assert again == row


def test_a_gripper_is_refused_with_its_reason(tmp_path: Path) -> None:
    row = look_at(job(others(tmp_path, GRIPPER), tmp_path), lambda: None)
    assert row["status"] == "refused"
    assert row["reason"].startswith("two fingers take part: a gripper")
    assert row["tries"] == []


def test_a_model_that_cannot_be_read_says_why_without_this_machines_folders(tmp_path: Path) -> None:
    row = look_at(job(others(tmp_path, "<mujoco><worldbody/></mujoco>"), tmp_path), lambda: None)
    assert row["status"] == "not usable"
    assert row["reason"].startswith("someone/hands/model.xml holds no body")
    assert str(tmp_path) not in json.dumps(row)


def test_tries_end_with_the_budget(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from planner.errors import TaskError

    def never(*_: object, **__: object) -> None:
        raise TaskError("not today")

    monkeypatch.setattr("benchmarks.zoo.measure.plan_grasp", never)
    (model,) = chosen(zoo_models(), ["allegro_hand"])
    row = look_at(job(model, tmp_path, cpu_s=0.0), lambda: None)
    assert (row["status"], row["reason"], len(row["tries"])) == ("no grasp found", "not today", 1)
    row = look_at(job(model, tmp_path, cpu_s=1e9), lambda: None)
    assert len(row["tries"]) == 27  # nine objects, three seeds


def test_a_run_goes_on_where_it_ended(tmp_path: Path) -> None:
    models = [others(tmp_path, GRIPPER)]
    given: dict[str, Any] = {"folder": tmp_path, "pictures": None, "cpu_s": 1.0, "runner": HERE}
    first = run_zoo(models, file=tmp_path / "rows.jsonl", **given)
    (tmp_path / models[0].reference).unlink()
    again = run_zoo(models, file=tmp_path / "rows.jsonl", **given)
    assert again["rows"] == first["rows"]
    assert counts(first["rows"]).startswith("1 hands, 1 described: 1 refused")
    _, said = zoo_tables(first)
    assert "1 refused" in str(said)


def test_the_command(tmp_path: Path) -> None:
    rows = tmp_path / "zoo.jsonl"
    told = ["bench", "zoo", "Panda gripper", "--models", str(tmp_path), "--samples", str(rows)]
    done = CliRunner().invoke(app, [*told, "--json"])
    assert done.exit_code == 0, done.output
    (row,) = json.loads(done.output[done.output.index("{") :])["rows"]
    assert row["reason"].startswith("neither a known name nor") or "does not exist" in row["reason"]


# --- what is kept, and its pages ------------------------------------------------------------------


def test_what_is_kept_is_whole_and_small(kept: dict[str, Any]) -> None:
    rows = kept["rows"]
    assert not kept["interrupted"]
    assert len(rows) >= 50
    assert sum(row["status"] == "held" for row in rows) >= 45
    assert sum(row["source"] == "repository" and row["joints"] is not None for row in rows) >= 20
    known = {model.name for model in zoo_models()}
    for row in rows:
        assert row["name"] in known
        assert (row["grasp"] is not None) == (row["status"] == "held")
        assert row["reason"] or row["grasp"]
        if row["picture"]:
            assert (ZOO / "pictures" / row["picture"]).stat().st_size < 20_000
    pictures = {row["picture"] for row in rows}
    assert {path.name for path in (ZOO / "pictures").iterdir()} <= pictures


def test_what_is_kept_names_no_folder_of_the_machine(kept: dict[str, Any]) -> None:
    assert not re.search(r"/(opt|home|root|tmp|usr|work)/", json.dumps(kept))


def test_every_card_leads_to_a_page_and_shows_a_picture(kept: dict[str, Any]) -> None:
    pages = zoo_pages(kept)
    cards = pages[CARDS]
    links = set(re.findall(r"\(generated/([\w-]+\.md)\)", cards))
    assert links == {name for name in pages if name != CARDS}
    assert len(links) == len(kept["rows"])
    for picture in re.findall(r"\(pictures/([\w.-]+)\)", cards):
        assert (ZOO / "pictures" / picture).is_file()
    assert counts(kept["rows"]) in cards


def test_a_page_says_what_held_or_why_nothing_did(kept: dict[str, Any], tmp_path: Path) -> None:
    write_pages(kept, tmp_path)
    for row in kept["rows"]:
        text = (tmp_path / f"{row['slug']}.md").read_text(encoding="utf-8")
        assert text.startswith(f"# {plain(row['name'])}\n")
        if row["grasp"]:
            assert f"$ {row['grasp']['command']}\n" in text
        else:
            assert f"## Why no grasp\n\n{plain(row['reason'])}\n" in text


def test_markdown_in_a_message_is_shown_as_it_is() -> None:
    assert plain("a_b [c](d) <e> | $f$") == r"a\_b \[c\](d) \<e\> \| \$f\$"
