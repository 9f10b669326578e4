"""The pages of the zoo, Markdown for Sphinx, out of what ``bench zoo`` measured.

They are written when the documentation is built (``docs/machinery/zoo.py``) and not kept.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from benchmarks.cards import card, grid, plain
from benchmarks.zoo.table import counts
from sim.tables import Row

CARDS = "cards.txt"
"""What the index of the zoo includes: the counts and a card per hand."""

PICTURES = "pictures"
"""Folder of the pictures, seen from the index; the pages stand one folder below it."""

GROUPS = {
    "shipped": "Hands that ship",
    "package": "Hands in Python packages",
    "repository": "Published models",
}
"""Source of a hand -> heading."""


def zoo_pages(data: Row) -> dict[str, str]:
    """Name of a file -> its text: the cards, and a page per hand.

    Args:
        data: What ``bench zoo`` measured.
    """
    rows = data["rows"]
    return {CARDS: _cards(data)} | {f"{row['slug']}.md": _page(row) for row in rows}


def write_pages(data: Row, folder: Path) -> None:
    """Write them into a folder beside ``pictures``; what else is in it stays."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in zoo_pages(data).items():
        (folder / name).write_text(text, encoding="utf-8")


def _cards(data: Row) -> str:
    rows = data["rows"]
    parts = [f"**{counts(rows)}.**\n"]
    for source, heading in GROUPS.items():
        members = [row for row in rows if row["source"] == source]
        if members:
            parts += [f"## {heading}\n", grid([_card(row) for row in members])]
    parts.append(
        f"At most {data['attempts_per_try']} attempts per try, {data['seeds']} seeds, "
        f"{data['cpu_s']:g} s of CPU per hand; {data['written_by']}, {data['machine']}, "
        f"{data['cores']} cores.\n"
    )
    return "\n".join(parts)


def _card(row: Row) -> str:
    return card(
        title=row["name"],
        page=f"generated/{row['slug']}.md",
        picture=f"{PICTURES}/{row['picture']}" if row["picture"] else "",
        lines=(f"**{row['status']}**", _short(row)),
        kind="good" if row["status"] == "held" else "other",
    )


def _short(row: Row) -> str:
    """A line about a hand on its card."""
    if row["joints"] is None:
        return plain(row["reason"].split(";")[0].rpartition(": ")[2][:80])
    counted = f"{len(row['fingers'])} fingers, {row['joints']} joints"
    return f"{counted}, {row['grasp']['object']}" if row["grasp"] else counted


def _page(row: Row) -> str:
    parts = [f"# {plain(row['name'])}\n", f"**{row['status']}**; {_origin(row)}\n"]
    if row["picture"]:
        what = "the grasp that held" if row["grasp"] else "the last try, after it"
        parts.append(f"![{plain(row['name'])}: {what}](../{PICTURES}/{row['picture']})\n")
    if row["grasp"]:
        parts.append(_grasp(row))
    elif row["reason"]:
        parts.append(f"## Why no grasp\n\n{plain(row['reason'])}\n")
    if row["joints"] is not None:
        parts.append("\n".join(_facts(row)))
    parts += [_warnings(row), _tries(row)]
    return "\n".join(part for part in parts if part)


def _origin(row: Row) -> str:
    if row["source"] == "shipped":
        return "ships with Opposable"
    return f"[{plain(row['model'])}]({row['url']})"


def _grasp(row: Row) -> str:
    grasp: Mapping[str, Any] = row["grasp"]
    where = "the folder of clones" if row["source"] == "repository" else "any folder"
    return f"""## A grasp that held

| | |
| --- | --- |
| object | `{grasp["object"]}`, 0.1 kg |
| seed, attempts | {grasp["seed"]}, {grasp["attempts"]} |
| fingers | {", ".join(grasp["fingers"])} |
| epsilon | {grasp["epsilon"]:.3f} |
| CPU time of planning | {grasp["cpu_s"]:.2f} s |
| movement in the hand | {grasp["slip_mm"]:.2f} mm, {grasp["slip_deg"]:.2f} degrees |

The same grasp again, from {where}:

<!-- test: skip run by bench zoo -->
```console
$ {grasp["command"]}
```
"""


def _facts(row: Row) -> Iterator[str]:
    yield "## The hand\n"
    fingers = ", ".join(f"{plain(f['name'])} ({f['joints']})" for f in row["fingers"])
    yield f"- fingers (joints): {fingers}"
    yield f"- {row['joints']} joints, {row['actuators']} actuators"
    if row["couplings"]:
        yield f"- {len(row['couplings'])} couplings:"
        for coupling in row["couplings"]:
            yield f"  - `{coupling}`"
    yield ""


def _warnings(row: Row) -> str:
    if row["joints"] is None:
        return ""
    if not row["warnings"]:
        return "## Warnings\n\n`opposable hands --check` has none.\n"
    lines = ["## Warnings\n", "What `opposable hands --check` says, and what to do:\n"]
    lines += [
        f"- {w['level']}: {plain(w['what'])}.\n  *{plain(w['what_to_do'])}.*"
        for w in row["warnings"]
    ]
    return "\n".join([*lines, ""])


def _tries(row: Row) -> str:
    """The tries, where more than one was needed."""
    if len(row["tries"]) < 2:
        return ""
    lines = ["## Tries\n", "| object | seed | attempts | outcome |", "| --- | --- | --- | --- |"]
    for one in row["tries"]:
        outcome = "held" if one["held"] else plain(one["reason"]).replace("|", "/")
        lines.append(f"| `{one['object']}` | {one['seed']} | {one['attempts']} | {outcome} |")
    return "\n".join([*lines, ""])
