"""Scripts and styles of single kinds of pages, beside those that every page has."""

from __future__ import annotations

import json
from functools import cache
from importlib import resources

__all__ = ["asset", "own_scripts"]


@cache
def asset(name: str) -> str:
    """The text of a file in ``planner/pages/assets``."""
    return resources.files("planner.pages").joinpath("assets", name).read_text(encoding="utf-8")


def own_scripts(*names: str) -> tuple[str, ...]:
    """Scripts of a kind of page, after one that adds the style of side panels."""
    style = json.dumps(asset("side.css")).replace("</", "<\\/")
    made = f'Object.assign(document.createElement("style"), {{textContent: {style}}})'
    return (f"document.head.append({made});", *(asset(name) for name in names))
