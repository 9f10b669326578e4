"""The pages of the gallery, Markdown for Sphinx, out of what ``bench gallery`` made."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from benchmarks.cards import card, grid, plain
from sim.tables import Row

CARDS = "cards.txt"
"""What the index of the gallery includes: a card per entry."""

PICTURES = "pictures"
"""Folder of films and pictures, seen from the index; the pages stand one folder below it."""

SCENES = "scenes"
"""Folder in the site that holds the entries' own pages with their 3D scenes."""


def gallery_pages(data: Row, scenes: Collection[str] = ()) -> dict[str, str]:
    """Name of a file -> its text: the cards, and a page per entry.

    Args:
        data: What ``bench gallery`` made.
        scenes: Names of the entries' own pages that the site will have.
    """
    pages = {CARDS: _cards(data["rows"])}
    return pages | {f"{row['name']}.md": _page(row, scenes) for row in data["rows"]}


def write_pages(data: Row, folder: Path, scenes: Collection[str] = ()) -> None:
    """Write them into a folder beside ``pictures``; what else is in it stays."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in gallery_pages(data, scenes).items():
        (folder / name).write_text(text, encoding="utf-8")


def _cards(rows: list[Row]) -> str:
    parts = []
    for group in dict.fromkeys(row["group"] for row in rows):
        members = [_card(row) for row in rows if row["group"] == group]
        parts += [f"## {group}\n", grid(members)]
    return "\n".join(parts)


def _card(row: Row) -> str:
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


def _page(row: Row, scenes: Collection[str]) -> str:
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
        parts.append(f"<!-- test: skip run by bench gallery -->\n```console\n$ {command}\n```\n")
    if row["output"]:
        parts.append(f"## What it prints\n\n````text\n{row['output']}\n````\n")
    return "\n".join(parts)
