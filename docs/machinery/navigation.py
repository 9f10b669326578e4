"""The list of pages beside every page: made once a folder, and marked on each page.

Furo makes it anew for each page: Sphinx resolves all tables of contents and an HTML parser reads
the result. Seen from one folder the links are the same, so only the current page is marked anew.
"""

from __future__ import annotations

import posixpath
from dataclasses import dataclass, field
from typing import Any

from bs4 import BeautifulSoup, Tag
from bs4.element import AttributeValueList
from sphinx.application import Sphinx

BEFORE_FURO, AFTER_FURO = 400, 600
"""Priorities of an event for which Furo has Sphinx's own of 500."""


@dataclass
class Navigation:
    """The navigation of one folder.

    Attributes:
        soup: All of it, as Furo makes it, no page being the current one.
        items: Address of a page -> its entry.
    """

    soup: BeautifulSoup
    items: dict[str, Tag] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Find the entries."""
        for link in self.soup.select("li > a[href]"):
            if link.parent is not None:
                self.items.setdefault(str(link["href"]), link.parent)

    def at(self, address: str) -> str:
        """The navigation with the page at an address as the current one, what holds it opened."""
        if address not in self.items:
            return str(self.soup)
        here = self.items[address]
        opened = [here, *(parent for parent in here.parents if parent.name == "li")]
        boxes = [box for item in opened for box in item.select(":scope > input")]
        before = [AttributeValueList(item.get_attribute_list("class")) for item in opened]
        for item, classes in zip(opened, before, strict=True):
            mine = ["current", "current-page"] if item is here else ["current"]
            item["class"] = AttributeValueList([*classes, *mine])
        for box in boxes:
            box["checked"] = ""
        text = str(self.soup)
        for item, classes in zip(opened, before, strict=True):
            item["class"] = classes
        for box in boxes:
            del box["checked"]
        return text


FOLDERS: dict[str, Navigation] = {}
"""What was made in this build."""


def nobody(folder: str) -> str:
    """The name of a page of a folder that does not exist."""
    return posixpath.join(folder, "_")


def without_mark(
    app: Sphinx, page: str, template: str, context: dict[str, Any], doctree: object
) -> None:
    """Give Furo a table of contents without a current page once a folder, and then none."""
    folder = posixpath.dirname(page)
    builder: Any = app.builder
    if "toctree" in context:
        context["toctree"] = (
            (lambda **_: "")
            if folder in FOLDERS
            else lambda **options: builder._get_local_toctree(nobody(folder), **options)
        )


def with_mark(
    app: Sphinx, page: str, template: str, context: dict[str, Any], doctree: object
) -> None:
    """Mark the page in what was made for its folder."""
    folder = posixpath.dirname(page)
    if made := context.get("furo_navigation_tree"):
        FOLDERS.setdefault(folder, Navigation(BeautifulSoup(made, "html.parser")))
    if folder in FOLDERS:
        address = app.builder.get_relative_uri(nobody(folder), page)
        context["furo_navigation_tree"] = FOLDERS[folder].at(address)


def setup(app: Sphinx) -> dict[str, Any]:
    """Register both sides of Furo's own."""
    app.connect("builder-inited", lambda _: FOLDERS.clear())
    app.connect("html-page-context", without_mark, priority=BEFORE_FURO)
    app.connect("html-page-context", with_mark, priority=AFTER_FURO)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
