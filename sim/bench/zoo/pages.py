"""``write_pages``: Markdown pages of the zoo out of what ``bench zoo`` measured.

Called when the documentation is built; the pages themselves are not kept in the checkout.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from sim.bench.zoo.table import counts
from sim.tables import Row

__all__ = ["read_zoo", "write_pages"]

GROUPS = {
    "shipped": "Hands that ship",
    "package": "Hands in Python packages",
    "repository": "Published models",
}
"""Source of a hand -> heading."""

BADGES = {
    "held": "success",
    "refused": "secondary",
    "did not hold": "warning",
    "no grasp found": "warning",
    "not usable": "danger",
}
"""Status of a hand -> colour of its badge."""

INTRODUCTION = """\
Every hand that ships with Opposable, every known hand in a Python package, and models that others
published: what the planner sees of each, and a grasp that held in simulation or the reason why
none did. Hands without a `hand.toml` are described by their structure alone, as
`opposable describe` does; nothing was written or corrected by hand. Models of others are not part
of Opposable: a hand's page links to its source.
"""

HOW = """\
Each hand got objects that fit between its pads (cylinders, spheres and boxes, on a table, 0.1 kg)
and seeds 0 to {seeds}, at most {attempts} attempts each, until a grasp held through approach, squeeze,
lift and hold, for at most {cpu_s:g} s of CPU. Grippers of two fingers are refused: point contacts of two fingers
cannot close a grasp. The table is made by

    opposable bench zoo --models FOLDER --pictures docs/zoo/pictures --out docs/zoo/zoo.json

where FOLDER holds clones of the repositories listed in `docs/zoo/models.toml`.
"""


def read_zoo(file: Path) -> Row:
    """What ``bench zoo`` wrote."""
    data: Row = json.loads(file.read_text(encoding="utf-8"))
    return data


def write_pages(data: Row, folder: Path) -> list[Path]:
    """Write ``index.md`` and a page per hand.

    Args:
        data: What ``bench zoo`` measured.
        folder: Where; pictures are looked for in ``pictures`` beside the pages.

    Returns:
        The files, the index first.
    """
    rows = data["rows"]
    pages = {"index": _index(data)} | {row["slug"]: _page(row) for row in rows}
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for name, text in pages.items():
        path = folder / f"{name}.md"
        path.write_text(text, encoding="utf-8")
        written.append(path)
    return written


def _index(data: Row) -> str:
    rows = data["rows"]
    how = HOW.format(
        seeds=data["seeds"] - 1, attempts=data["attempts_per_try"], cpu_s=data["cpu_s"]
    )
    made = f"Measured with {data['written_by']} on {data['machine']}, {data['cores']} cores."
    parts = ["# Hand zoo\n", INTRODUCTION, f"**{counts(rows)}.**\n"]
    for source, heading in GROUPS.items():
        members = [row for row in rows if row["source"] == source]
        if members:
            parts += [f"## {heading}\n", _grid(members)]
    parts += ["## How it was measured\n", how, made + "\n", _toctree(rows)]
    return "\n".join(parts)


def _grid(rows: list[Row]) -> str:
    """Cards, four in a line."""
    lines = ["::::{grid} 2 3 4 4", ":gutter: 2", ""]
    for row in rows:
        lines += [f":::{{grid-item-card}} {_plain(row['name'])}"]
        lines += [f":link: {row['slug']}", ":link-type: doc"]
        if row["picture"]:
            lines += [f":img-top: pictures/{row['picture']}"]
        lines += ["", _badge(row["status"]), "", _short(row), ":::", ""]
    return "\n".join([*lines, "::::", ""])


def _badge(status: str) -> str:
    return f"{{bdg-{BADGES.get(status, 'secondary')}}}`{status}`"


def _short(row: Row) -> str:
    """A line about a hand on its card."""
    if row["joints"] is None:
        return _plain(row["reason"].split(";")[0][:90])
    counted = f"{len(row['fingers'])} fingers, {row['joints']} joints"
    return f"{counted}, {row['grasp']['object']}" if row["grasp"] else counted


def _toctree(rows: list[Row]) -> str:
    return "\n".join(["```{toctree}", ":hidden:", "", *(row["slug"] for row in rows), "```", ""])


def _page(row: Row) -> str:
    parts = [f"# {_plain(row['name'])}\n", f"{_badge(row['status'])} {_origin(row)}\n"]
    if row["picture"]:
        what = "the grasp that held" if row["grasp"] else "the last try, after it"
        parts.append(
            f"```{{image}} pictures/{row['picture']}\n:alt: {_plain(row['name'])}: {what}\n```\n"
        )
    if row["grasp"]:
        parts.append(_grasp(row["grasp"]))
    elif row["reason"]:
        parts.append(f"## Why no grasp\n\n{_plain(row['reason'])}\n")
    if row["joints"] is not None:
        parts.append("\n".join(_facts(row)))
    parts += [_warnings(row), _tries(row)]
    return "\n".join(part for part in parts if part)


def _origin(row: Row) -> str:
    if row["source"] == "shipped":
        return "ships with Opposable"
    return f"[{row['model']}]({row['url']})"


def _grasp(grasp: Row) -> str:
    return f"""## A grasp that held

| | |
| --- | --- |
| object | `{grasp["object"]}`, 0.1 kg |
| seed, attempts | {grasp["seed"]}, {grasp["attempts"]} |
| fingers | {", ".join(grasp["fingers"])} |
| epsilon | {grasp["epsilon"]:.3f} |
| CPU time of planning | {grasp["cpu_s"]:.2f} s |
| movement in the hand | {grasp["slip_mm"]:.2f} mm, {grasp["slip_deg"]:.2f} degrees |

    {grasp["command"]}
"""


def _facts(row: Row) -> Iterator[str]:
    yield "## The hand\n"
    fingers = ", ".join(f"{f['name']} ({f['joints']})" for f in row["fingers"])
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
        return "## Warnings\n\n`opposable check-hand` has none.\n"
    lines = ["## Warnings\n", "What `opposable check-hand` says, and what to do:\n"]
    lines += [
        f"- {w['level']}: {_plain(w['what'])}\n  *{_plain(w['what_to_do'])}*"
        for w in row["warnings"]
    ]
    return "\n".join([*lines, ""])


def _tries(row: Row) -> str:
    """The tries, where more than one was needed."""
    if len(row["tries"]) < 2:
        return ""
    lines = ["## Tries\n", "| object | seed | attempts | outcome |", "| --- | --- | --- | --- |"]
    for one in row["tries"]:
        outcome = "held" if one["held"] else _plain(one["reason"]).replace("|", "/")
        lines.append(f"| `{one['object']}` | {one['seed']} | {one['attempts']} | {outcome} |")
    return "\n".join([*lines, ""])


def _plain(text: Any) -> str:
    """A text that Markdown shows as it is."""
    out = str(text)
    for letter in "\\`*_{}[]<>#$":
        out = out.replace(letter, f"\\{letter}")
    return out
