"""Checks a built site: every link leads somewhere, nothing is loaded from outside.

    python docs/machinery/check.py site

Pages of other sites cannot be opened without a network: their addresses are counted and must be
well formed.
"""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass, field
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

LOADING = {
    ("script", "src"),
    ("img", "src"),
    ("iframe", "src"),
    ("source", "src"),
    ("video", "src"),
    ("video", "poster"),
    ("embed", "src"),
    ("object", "data"),
    ("link", "href"),
    ("use", "href"),
}
"""Attributes whose address a browser opens by itself."""

NOT_LOADED = {"search", "index", "next", "prev", "canonical", "author"}
"""Kinds of ``<link>`` that are only followed."""

IN_STYLES = re.compile(r"(?:url\(|@import)\s*['\"]?([^'\")\s;]+)")
WELL_FORMED = re.compile(r"^(https?://[\w.-]+\.[a-z]{2,}(:\d+)?(/\S*)?|mailto:\S+@\S+)$")


@dataclass(eq=False)
class Page(HTMLParser):
    """What a page points to.

    Attributes:
        loaded: Addresses that a browser opens by itself.
        followed: Addresses of links.
        anchors: Places in it that a link can name.
        styles: Text of its style sheets.
    """

    loaded: list[str] = field(default_factory=list)
    followed: list[str] = field(default_factory=list)
    anchors: set[str] = field(default_factory=set)
    styles: str = ""

    def __post_init__(self) -> None:
        """Begin to parse."""
        HTMLParser.__init__(self)
        self._in_style = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note the addresses and the name of an element."""
        given = {name: value or "" for name, value in attrs}
        self._in_style = tag == "style"
        self.anchors |= {given[name] for name in ("id", "name") if name in given}
        self.styles += given.get("style", "")
        only_followed = set(given.get("rel", "").split()) & NOT_LOADED
        for name, value in given.items():
            if (tag, name) in LOADING and not (tag == "link" and only_followed):
                self.loaded.append(value)
            elif name == "srcset":
                self.loaded += [part.split()[0] for part in value.split(",") if part.split()]
            elif name == "href":
                self.followed.append(value)

    def handle_endtag(self, tag: str) -> None:
        """Leave a style sheet."""
        self._in_style = False

    def handle_data(self, data: str) -> None:
        """Keep the text of style sheets."""
        if self._in_style:
            self.styles += data


@dataclass
class Found:
    """What a check has found.

    Attributes:
        dead: Links within the site that lead nowhere: (page, address).
        outside: What would be loaded from another site: (file, address).
        malformed: Addresses of other sites that are none.
        external: Addresses of other sites, not opened.
        links: Links within the site that were followed.
    """

    dead: list[tuple[str, str]] = field(default_factory=list)
    outside: list[tuple[str, str]] = field(default_factory=list)
    malformed: list[tuple[str, str]] = field(default_factory=list)
    external: set[str] = field(default_factory=set)
    links: int = 0


def read(path: Path) -> Page:
    """A page as it is written."""
    page = Page()
    page.feed(path.read_text(encoding="utf-8"))
    return page


@cache
def led_to(folder: Path, address: str) -> Path:
    """The file that an address leads to, seen from a folder; pages of a folder share most."""
    target = (folder / address).resolve()
    return target / "index.html" if target.is_dir() else target


@cache
def exists(site: Path, target: Path) -> bool:
    """Whether a file is there, and within the site."""
    return target.is_file() and site in target.parents


def check(site: Path) -> Found:
    """Follow every link of every page of a built site."""
    site = site.resolve()
    led_to.cache_clear()
    exists.cache_clear()
    pages = {path: read(path) for path in sorted(site.rglob("*.html"))}
    found = Found()
    for path, page in pages.items():
        name = str(path.relative_to(site))
        page.loaded += IN_STYLES.findall(page.styles)
        for address in page.loaded + page.followed:
            parts = urlsplit(address)
            if parts.scheme in ("data", "javascript") or address.startswith("about:"):
                continue
            if parts.scheme or parts.netloc:
                if address in page.loaded:
                    found.outside.append((name, address))
                elif WELL_FORMED.match(address):
                    found.external.add(address)
                else:
                    found.malformed.append((name, address))
                continue
            found.links += 1
            target = led_to(path.parent, unquote(parts.path)) if parts.path else path
            there = path == target or exists(site, target)
            anchor = unquote(parts.fragment)
            if not there or (anchor and target in pages and anchor not in pages[target].anchors):
                found.dead.append((name, address))
    for path in sorted(site.rglob("*.css")):
        for address in IN_STYLES.findall(path.read_text(encoding="utf-8")):
            if urlsplit(address).netloc:
                found.outside.append((str(path.relative_to(site)), address))
    return found


def main(site: Path) -> int:
    """Say what was found; the exit code."""
    found = check(site)
    for what in ("dead", "outside", "malformed"):
        for page, address in getattr(found, what):
            print(f"{what}: {page}: {address}")
    print(f"{found.links} links lead somewhere, {len(found.dead)} do not;", end=" ")
    print(f"{len(found.outside)} addresses are loaded from outside;", end=" ")
    print(f"{len(found.external)} addresses of other sites are well formed and were not opened")
    return int(bool(found.dead or found.outside or found.malformed))


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
