"""Tables of results come out of the files of the commands that measure."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import typer

pytest.importorskip("sphinx")

from machinery import results

from benchmarks.__main__ import app
from sim import runner

pytestmark = pytest.mark.documentation

ROOT = Path(__file__).resolve().parent.parent
FILES = sorted(results.DATA.glob("*.json"))
PAGES = "\n".join(p.read_text(encoding="utf-8") for p in (ROOT / "docs" / "results").glob("*.md"))


def result(path: Path) -> dict[str, Any]:
    read = json.loads(path.read_text(encoding="utf-8"))
    assert isinstance(read, dict)
    return read


@pytest.mark.parametrize("path", FILES, ids=lambda p: p.name)
def test_a_file_says_how_it_was_measured_and_stands_on_a_page(path: Path) -> None:
    read = result(path)
    assert read["command"].startswith("python -m benchmarks ")
    assert re.fullmatch(r"\d{4}-\d\d-\d\d", read["date"])
    assert re.fullmatch(r"[0-9a-f]{7,}", read["commit"]), "measured on files that were changed"
    assert not read["interrupted"]
    assert path.stat().st_size < 1000 * results.LARGEST_KB
    assert f"```{{measured}} {path.name}" in PAGES
    assert any(line.startswith("| ---") for line in results.as_page(read))


def test_every_file_that_a_page_shows_is_there() -> None:
    shown = set(re.findall(r"```\{measured\} (\S+)", PAGES))
    assert shown
    assert shown == {path.name for path in FILES}


COMMANDS = [result(path)["command"] for path in FILES] + re.findall(
    r"^\$ (python -m benchmarks .*)$",
    (ROOT / "benchmarks" / "README.md").read_text(encoding="utf-8"),
    re.MULTILINE,
)


@pytest.mark.parametrize("line", COMMANDS)
def test_commands_of_files_and_of_the_list_are_those_of_today(line: str) -> None:
    words = shlex.split(line)[3:]
    group: Any = typer.main.get_command(app(words[:1]))
    name, command, rest = group.resolve_command(group.make_context("x", words), words)
    context = command.make_context(name, [], resilient_parsing=True)
    left = command.make_parser(context).parse_args(rest)[1]
    assert not left


def test_a_table_of_a_summary_becomes_one_of_a_page() -> None:
    table = {"title": "grasps", "columns": ["hand", "held"], "rows": [["allegro_hand", "10/10"]]}
    assert results.as_markdown(table) == [
        "**grasps**",
        "",
        "| hand | held |",
        "| --- | --- |",
        "| allegro\\_hand | 10/10 |",
        "",
    ]


def test_a_measurement_says_command_date_and_commit(monkeypatch: pytest.MonkeyPatch) -> None:
    for program in (["bin/opposable", "bench"], ["/home/me/benchmarks/__main__.py"]):
        monkeypatch.setattr("sys.argv", [*program, "grasps", "--hands", "a b"])
        made = runner.made_with()
        assert made["command"] == "python -m benchmarks grasps --hands 'a b'"
    assert re.fullmatch(r"\d{4}-\d\d-\d\d", made["date"])
    if (ROOT / ".git").exists():
        assert re.fullmatch(r"([0-9a-f]{7,}(-dirty)?)?", made["commit"])
    monkeypatch.setattr("sys.argv", ["pytest"])
    assert runner.made_with()["command"] == ""


def test_rates_beside_the_peer_are_those_of_the_data() -> None:
    text = (ROOT / "docs" / "results" / "grasps.md").read_text(encoding="utf-8")
    for rounds, name in ((0, "synthesis-scans-0.json"), (4, "synthesis-scans.json")):
        read = result(results.DATA / name)
        assert read["setting"]["rounds"] == rounds
        row = next(
            line
            for line in text.splitlines()
            if f"`--rounds {rounds}`" in line and line.startswith("|")
        )
        speed = read["summary"][0]
        total = dict(zip(speed["columns"], speed["rows"][-1], strict=True))
        assert f"| {float(total['found/s']):.1f} |" in row
    read = result(results.DATA / "synthesis-scans.json")
    fewer = sum(cell["with_fewer_fingers"] for cell in read["cells"])
    assert f"{fewer} of these {read['total']['found']}" in text
