"""The list of pages beside every page: made once, and marked on each page.

Furo makes it anew for each page: Sphinx resolves all tables of contents and an HTML parser reads
the result. Pages differ in the current page and in where links begin, both of which the text of
one navigation can be given.
"""

from __future__ import annotations

import posixpath
import re
from dataclasses import dataclass, field
from functools import cache
from typing import Any

from bs4 import BeautifulSoup, Tag
from bs4.element import AttributeValueList
from sphinx.application import Sphinx

BEFORE_FURO, AFTER_FURO = 400, 600
"""Priorities of an event for which Furo has Sphinx's own of 500."""

MARK = "data-mark"
"""Attribute of the places in the text at which something can be added; no page has it."""


LINK = re.compile(r'(?<=href=")[^":#]+')
"""Address of a link within the site, without its anchor."""


@dataclass
class Navigation:
    """The navigation, seen from the first folder.

    Attributes:
        soup: All of it, as Furo makes it, no page being the current one.
        plain: Its text.
        above: Address of a page -> its entry and those that hold it, the entry first.
        places: Entry -> where in the text its classes end, and where its box can be checked.
    """

    soup: BeautifulSoup
    plain: str = ""
    above: dict[str, list[int]] = field(default_factory=dict)
    places: list[tuple[int, int | None]] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Find the entries, and their places in the text."""
        items = [item for item in self.soup.select("li") if isinstance(item, Tag)]
        numbers = {id(item): number for number, item in enumerate(items)}
        for number, item in enumerate(items):
            classes = item.get_attribute_list("class")
            item["class"] = AttributeValueList([*classes, f"{MARK}{number}-"])
            for box in item.select(":scope > input"):
                box[f"{MARK}{number}"] = ""
        for link in self.soup.select("li > a[href]"):
            holding = [numbers[id(parent)] for parent in link.parents if parent.name == "li"]
            self.above.setdefault(str(link["href"]), holding)
        text = str(self.soup)
        for number in range(len(items)):
            where = text.index(f" {MARK}{number}-")
            text = text.replace(f" {MARK}{number}-", "", 1)
            box_mark = f' {MARK}{number}=""'
            found = text.find(box_mark)
            text = text.replace(box_mark, "", 1)
            self.places.append((where, found if found >= 0 else None))
        self.plain = text

    def at(self, address: str) -> str:
        """The navigation with the page at an address as the current one, what holds it opened."""
        added: list[tuple[int, str]] = []
        for k, number in enumerate(self.above.get(address, [])):
            classes, box = self.places[number]
            added.append((classes, " current current-page" if k == 0 else " current"))
            if box is not None:
                added.append((box, ' checked=""'))
        text = self.plain
        for where, words in sorted(added, reverse=True):
            text = text[:where] + words + text[where:]
        folder = posixpath.dirname(address) or "."
        return LINK.sub(lambda link: relative(link[0], folder), text)


@cache
def relative(address: str, folder: str) -> str:
    """An address of the site seen from a folder; pages of a folder have the same links."""
    return posixpath.relpath(address, folder)


MADE: list[Navigation] = []
"""What was made in this build: none, or one."""

NOBODY = "_"
"""The name of a page of the first folder that does not exist."""


def without_mark(
    app: Sphinx, page: str, template: str, context: dict[str, Any], doctree: object
) -> None:
    """Give Furo a table of contents without a current page once, and then none."""
    builder: Any = app.builder
    if "toctree" in context:
        context["toctree"] = (
            (lambda **_: "")
            if MADE
            else lambda **options: builder._get_local_toctree(NOBODY, **options)
        )


def with_mark(
    app: Sphinx, page: str, template: str, context: dict[str, Any], doctree: object
) -> None:
    """Mark the page in what was made."""
    if not MADE and (made := context.get("furo_navigation_tree")):
        MADE.append(Navigation(BeautifulSoup(made, "html.parser")))
    if MADE:
        address = app.builder.get_relative_uri(NOBODY, page)
        context["furo_navigation_tree"] = MADE[0].at(address)


def setup(app: Sphinx) -> dict[str, Any]:
    """Register both sides of Furo's own."""
    app.connect("builder-inited", lambda _: MADE.clear())
    app.connect("html-page-context", without_mark, priority=BEFORE_FURO)
    app.connect("html-page-context", with_mark, priority=AFTER_FURO)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
