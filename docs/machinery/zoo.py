"""The pages of zoo and gallery, out of what ``bench zoo`` and ``bench gallery`` wrote."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx
from sphinx.config import Config

from benchmarks.gallery.pages import SCENES, gallery_pages
from benchmarks.zoo.pages import zoo_pages
from machinery.examples import trial
from machinery.write import write_pages

DOCS = Path(__file__).parent.parent
EXTRA = DOCS / "gallery" / "extra"
"""What goes into the site as it is: the entries' own pages, too large to be kept in the checkout;
``python -m benchmarks gallery --pages docs/gallery/extra/scenes`` makes them."""


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
