"""The pages of the zoo and of the gallery, out of what ``bench zoo`` and ``bench gallery`` wrote."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

from machinery.write import write_pages
from sim.bench.zoo.pages import zoo_pages

DOCS = Path(__file__).parent.parent


def write(app: Sphinx) -> None:
    """Write both."""
    zoo = json.loads((DOCS / "zoo" / "zoo.json").read_text(encoding="utf-8"))
    write_pages(DOCS / "zoo" / "generated", zoo_pages(zoo))


def setup(app: Sphinx) -> dict[str, Any]:
    """Write the pages when a build begins."""
    app.add_css_file("cards.css")
    app.connect("builder-inited", write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
