"""Cards of the documentation's galleries, in MyST Markdown: a picture, a title, a few lines.

Containers and a style sheet (``docs/static/cards.css``) do what a grid needs; links and pictures
stay Markdown, so that Sphinx checks them.
"""

from __future__ import annotations

from collections.abc import Iterable


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
