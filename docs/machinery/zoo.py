"""The pages of zoo and gallery, out of what ``python -m benchmarks`` wrote.

Cards are MyST Markdown: containers and a style sheet (``docs/static/cards.css``) do what a grid
needs; links and pictures stay Markdown, so that Sphinx checks them.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx
from sphinx.config import Config

from benchmarks.zoo import counts
from machinery.examples import trial
from machinery.write import write_pages
from sim.tables import Row

DOCS = Path(__file__).parent.parent
EXTRA = DOCS / "gallery" / "extra"
"""What goes into the site as it is: the entries' own pages, too large to be kept in the checkout;
``python -m benchmarks gallery --pages docs/gallery/extra/scenes`` makes them."""

CARDS, PICTURES, SCENES = "cards.txt", "pictures", "scenes"
"""What an index includes: a card per hand or entry; folder of its pictures, seen from the index,
the pages standing one folder below it; folder in the site that holds the entries' own pages."""

GROUPS = {
    "shipped": "Hands that ship",
    "package": "Hands in Python packages",
    "repository": "Published models",
}
"""Source of a hand -> heading."""


def zoo_pages(data: Row) -> dict[str, str]:
    """Name of a file -> its text: the cards, and a page per hand.

    Args:
        data: What ``zoo`` measured.
    """
    rows = data["rows"]
    return {CARDS: _cards(data)} | {f"{row['slug']}.md": _page(row) for row in rows}


def _cards(data: Row) -> str:
    rows, setting = data["rows"], data["setting"]
    parts = [f"**{counts(rows)}.**\n"]
    for source, heading in GROUPS.items():
        members = [row for row in rows if row["source"] == source]
        if members:
            parts += [f"## {heading}\n", grid([_card(row) for row in members])]
    parts.append(
        f"At most {setting['max_attempts']} attempts per try, {setting['n']} seeds, "
        f"{setting['cpu_s']:g} s of CPU per hand; {data['written_by']}, {data['machine']}, "
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

<!-- test: skip run by zoo -->
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


def gallery_pages(data: Row, scenes: Collection[str] = ()) -> dict[str, str]:
    """Name of a file -> its text: the cards, and a page per entry.

    Args:
        data: What ``gallery`` made.
        scenes: Names of the entries' own pages that the site will have.
    """
    pages = {CARDS: _entry_cards(data["rows"])}
    return pages | {f"{row['name']}.md": _entry_page(row, scenes) for row in data["rows"]}


def _entry_cards(rows: list[Row]) -> str:
    parts = []
    for group in dict.fromkeys(row["group"] for row in rows):
        members = [_entry_card(row) for row in rows if row["group"] == group]
        parts += [f"## {group}\n", grid(members)]
    return "\n".join(parts)


def _entry_card(row: Row) -> str:
    return card(
        title=_name(row),
        page=f"generated/{row['name']}.md",
        picture=f"{PICTURES}/{row['picture']}" if row["picture"] else "",
        lines=(_sentence(row),),
    )


def _sentence(row: Row) -> str:
    """The title as a sentence."""
    text = plain(row["title"])
    return text if text.endswith(("?", "!")) else f"{text}."


def _name(row: Row) -> str:
    """The entry's name in words."""
    return " ".join(row["name"].replace("_", " ").replace("-", " ").split())


def _entry_page(row: Row, scenes: Collection[str]) -> str:
    parts = [f"# {plain(_name(row))}\n", f"{_sentence(row)}\n"]
    if row["picture"]:
        parts.append(f"![{plain(row['title'])}](../{PICTURES}/{row['picture']})\n")
    if row["page"] in scenes:
        parts.append(
            '<iframe class="scene" loading="lazy" title="Scene" '
            f'src="../../{SCENES}/{row["page"]}"></iframe>\n\n'
            f'<p><a href="../../{SCENES}/{row["page"]}">Open it alone</a>.</p>\n'
        )
    if row["script"]:
        parts.append(
            f"```{{literalinclude}} ../../../examples/{row['script']}\n:language: python\n```\n"
        )
    else:
        command = " ".join(["opposable", *row["command"]])
        parts.append(f"<!-- test: skip run by gallery -->\n```console\n$ {command}\n```\n")
    if row["output"]:
        parts.append(f"## What it prints\n\n````text\n{row['output']}\n````\n")
    return "\n".join(parts)


def card(*, title: str, page: str, picture: str, lines: Iterable[str], kind: str = "") -> str:
    """One card.

    Args:
        title: Plain text.
        page: What it links to; "" for nothing.
        picture: Path of its picture; "" for none.
        lines: Markdown below the title.
        kind: A class of its own in the style sheet.
    """
    name = plain(title)
    image = f"![{name}]({picture})" if picture else ""
    parts = [f":::{{container}} card {kind}".rstrip()]
    if image:
        parts += [f"[{image}]({page})" if page else image, ""]
    parts += [f"**[{name}]({page})**" if page else f"**{name}**", ""]
    parts += [f"{line}\n" for line in lines if line]
    return "\n".join([*parts, ":::", ""])


def grid(cards: Iterable[str]) -> str:
    """Cards side by side, as many as fit."""
    return "\n".join(["::::{container} cards", *cards, "::::", ""])


def plain(text: object) -> str:
    """A text that Markdown shows as it is."""
    return "".join(f"\\{c}" if c in "\\`*_{}[]<>#$|~" else c for c in str(text))


def add_scenes(app: Sphinx, config: Config) -> None:
    """Take the entries' own pages into the site, if they were made."""
    if EXTRA.is_dir():
        config.html_extra_path = [*config.html_extra_path, str(EXTRA)]


def write(app: Sphinx) -> None:
    """Write the pages of both."""
    zoo = json.loads((DOCS / "zoo" / "zoo.json").read_text(encoding="utf-8"))
    write_pages(DOCS / "zoo" / "generated", zoo_pages(zoo))
    gallery = json.loads((DOCS / "gallery" / "gallery.json").read_text(encoding="utf-8"))
    scenes = {path.name for path in (EXTRA / SCENES).glob("*.html")}
    write_pages(DOCS / "gallery" / "generated", gallery_pages(gallery, scenes))


def write_first_scene(app: Sphinx, error: Exception | None) -> None:
    """Write the page of a trial that the first page of the site shows in a frame."""
    if error is None and app.builder.format == "html":
        folder = Path(app.outdir) / SCENES
        folder.mkdir(exist_ok=True)
        trial().save_html(folder / "first.html")


def setup(app: Sphinx) -> dict[str, Any]:
    """Write the pages when a build begins."""
    app.add_css_file("cards.css")
    app.connect("config-inited", add_scenes)
    app.connect("builder-inited", write)
    app.connect("build-finished", write_first_scene)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
