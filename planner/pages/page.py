"""``Page`` and ``write_page``: one HTML file that opens anywhere, without a network.

The file holds three.js (out of trimesh's package), our script and style, the scene (compressed),
the summary as plain HTML, and the numbers that it was made from, which ``read_page_data`` gives
back. Its content security policy forbids the browser every request.
"""

from __future__ import annotations

import base64
import gzip
import json
import re
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from html import escape
from importlib import resources
from pathlib import Path
from typing import Any

from planner.errors import FileFormatError
from planner.files.json_csv import whole_file
from planner.pages.blocks import PLOTS, Block, Verdict, block_html
from planner.pages.payload import scene_bytes
from planner.pages.scene import Scene
from planner.pages.three import three_source
from planner.version import __version__

__all__ = ["Page", "page_html", "read_page_data", "without_folder", "write_page"]

SCRIPTS = (
    "unpack.js",
    "clock.js",
    "camera.js",
    "bodies.js",
    "contacts.js",
    "stage.js",
    "axes.js",
    "plots.js",
    "timeline.js",
    "panel.js",
    "main.js",
)
"""Our scripts in the order in which they run; a page's own ones come before the last."""

POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"
)
"""Content security policy: nothing is fetched from anywhere."""

LARGEST_DATA = 1 << 28
"""Bytes of unpacked numbers that are read back: more is not a page of ours."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Page:
    """What is written into one file.

    Attributes:
        title: Of the page.
        subtitle: A line below it.
        verdict: What a person reads first; None where there is nothing to judge.
        summary: What follows, in order.
        scene: What is drawn; None for a page without a scene.
        data: The numbers that the page shows, plain data for JSON: a plan, a report.
        kind: What ``data`` is: "plan", "report", "motion", "hand".
        scripts: JavaScript of this kind of page; see ``assets/README.md``.
        extra: What those scripts need: plain data and arrays.
    """

    title: str
    subtitle: str = ""
    verdict: Verdict | None = None
    summary: tuple[Block, ...] = ()
    scene: Scene | None = None
    data: Mapping[str, Any] | None = None
    kind: str = ""
    scripts: tuple[str, ...] = ()
    extra: Mapping[str, Any] = field(default_factory=dict)


def without_folder(spec: str) -> str:
    """What a title calls an object: of a mesh or model file the name, without its folder."""
    return re.split(r"[/\\]", spec)[-1]


def write_page(page: Page, path: Path | str) -> None:
    """Write a page whole or not at all.

    Raises:
        FileFormatError: The folder does not exist or cannot be written.
        PlannerError: trimesh carries another three.js.
    """
    text = page_html(page)
    with whole_file(Path(path)) as stream:
        stream.write(text.encode())


def page_html(page: Page) -> str:
    """A page as one HTML document.

    Raises:
        PlannerError: trimesh carries another three.js.
    """
    blocks = ([page.verdict] if page.verdict is not None else []) + list(page.summary)
    summary = "\n".join(block_html(b) for b in blocks)
    if PLOTS not in summary:
        summary += PLOTS
    scripts = [_asset(name) for name in SCRIPTS]
    scripts[-1:-1] = page.scripts
    parts = []
    if page.data is not None:
        text = json.dumps(page.data, allow_nan=False, separators=(",", ":"))
        parts.append(_packed("opposable-data", text.encode(), f' data-kind="{escape(page.kind)}"'))
    if page.scene is not None:
        parts.append(_packed("opposable-scene", scene_bytes(page.scene, page.extra)))
        parts.append(_packed_three())
    own = "\n".join(f"<script>\n{_safe(s)}\n</script>" for s in scripts)
    subtitle = f'<p class="subtitle">{escape(page.subtitle)}</p>' if page.subtitle else ""
    return _asset("page.html").format(
        policy=POLICY,
        version=escape(__version__),
        title=escape(page.title),
        subtitle=subtitle,
        style=_asset("page.css"),
        summary=summary,
        stage=_asset("stage.html") if page.scene is not None else "",
        layout="with-scene" if page.scene is not None else "text-only",
        parts="\n".join(parts),
        scripts=own,
    )


def _packed(identity: str, content: bytes, more: str = "") -> str:
    """Bytes in an element that the browser does not run."""
    packed = base64.b64encode(gzip.compress(content, 6, mtime=0)).decode()
    return f'<script type="application/gzip;base64" id="{identity}"{more}>{packed}</script>'


@cache
def _packed_three() -> str:
    return _packed("opposable-three", three_source().encode())


@cache
def _asset(name: str) -> str:
    return resources.files("planner.pages").joinpath("assets", name).read_text(encoding="utf-8")


def _safe(script: str) -> str:
    """A script that cannot end its own element."""
    return script.replace("</script", "<\\/script")


_DATA = re.compile(
    r'<script type="application/gzip;base64" id="opposable-data" data-kind="(\w*)">'
    r"([A-Za-z0-9+/=]*)</script>"
)


def read_page_data(path: Path | str) -> tuple[str, dict[str, Any]]:
    """The kind and the numbers that a page was made from, out of its file.

    Raises:
        FileFormatError: The file cannot be read, is not a page of ours, or is damaged.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise FileFormatError(f"cannot read {path}: {reason}") from error
    found = _DATA.search(text)
    if found is None:
        raise FileFormatError(
            f"{path} is not a page with numbers in it; give an HTML file that opposable wrote "
            "(report.html, plan.html), whole as it was written"
        )
    try:
        unpacker = zlib.decompressobj(wbits=31)
        content = unpacker.decompress(base64.b64decode(found[2], validate=True), LARGEST_DATA)
        if not unpacker.eof:
            raise ValueError("its numbers end early")
        data = json.loads(content)
    except (ValueError, zlib.error, RecursionError) as error:
        raise FileFormatError(
            f"the numbers in {path} are damaged ({error}); write the page again"
        ) from error
    if not isinstance(data, dict):
        raise FileFormatError(f"the numbers in {path} are not those of a plan or report")
    return found[1], data
