"""``Page`` and ``write_page``: one HTML file that opens anywhere, without a network.

The file holds three.js (out of trimesh's package, so that our tree holds no third-party code), our
script and style, the scene (compressed), the summary as plain HTML, and the numbers that it was
made from, which ``read_page_data`` gives back. Its content security policy forbids the browser
every request.

A scene becomes the bytes that a page unpacks: JSON for the structure, a block of bytes for arrays.
An array stands in the JSON as ``{"$": [type, shape, offset]}``. Positions of vertices are 16-bit
steps within the box of their part (0.2 m: 3 um), so that a page stays small.

``show_page`` brings it into the cell of a notebook, or into the browser of this machine.
"""

from __future__ import annotations

import base64
import gzip
import json
import math
import os
import re
import sys
import tempfile
import webbrowser
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from functools import cache
from html import escape
from importlib import import_module, resources
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from planner.errors import FileFormatError, PlannerError
from planner.files.disk import plain_name, whole_file
from planner.pages.blocks import PLOTS, Block, Verdict, block_html
from planner.pages.scene import Part, Scene
from planner.system.package import __version__

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
    scripts = [asset(name) for name in SCRIPTS]
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
    return asset("page.html").format(
        policy=POLICY,
        version=escape(__version__),
        title=escape(page.title),
        subtitle=subtitle,
        style=asset("page.css"),
        summary=summary,
        stage=asset("stage.html") if page.scene is not None else "",
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


STEPS = 65535
"""Steps of a coordinate within a part's box."""

ALIGNMENT = 8
"""Bytes; arrays begin at multiples, as the browser's typed arrays require."""

_TYPES = {"float32": "f4", "float64": "f8", "uint16": "u2", "uint32": "u4", "uint8": "u1"}


def scene_bytes(scene: Scene, extra: Mapping[str, Any]) -> bytes:
    """A scene, and what a page's own scripts need, as bytes."""
    return pack({"scene": scene, "extra": dict(extra)})


def pack(tree: Any) -> bytes:
    """Plain data, dataclasses and arrays as bytes: length of the JSON (4), JSON, arrays."""
    blocks: list[bytes] = []
    plain = _plain(tree, blocks)
    text = json.dumps(plain, allow_nan=False, separators=(",", ":")).encode()
    text += b" " * (-(len(text) + 4) % ALIGNMENT)
    return len(text).to_bytes(4, "little") + text + b"".join(blocks)


def _plain(value: Any, blocks: list[bytes]) -> Any:
    if isinstance(value, Part):
        return _part(value, blocks)
    if isinstance(value, Scene):
        out = {f.name: _plain(getattr(value, f.name), blocks) for f in fields(value)}
        out["time"] = _array(np.asarray(value.time, np.float64), blocks)
        return out
    if isinstance(value, np.ndarray):
        return _small_or_array(value, blocks)
    if is_dataclass(value):
        return {f.name: _plain(getattr(value, f.name), blocks) for f in fields(value)}
    if isinstance(value, Mapping):
        return {str(k): _plain(v, blocks) for k, v in value.items()}
    if isinstance(value, frozenset | set):
        return sorted(value)
    if isinstance(value, list | tuple):
        return [_plain(v, blocks) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _small_or_array(values: NDArray[Any], blocks: list[bytes]) -> Any:
    """Up to 16 numbers are readable JSON, more are bytes; NaN needs bytes."""
    if values.ndim == 1 and values.size <= 16 and np.isfinite(values).all():
        return [float(v) for v in values]
    return _array(np.asarray(values, np.float32), blocks)


def _array(values: NDArray[Any], blocks: list[bytes]) -> dict[str, Any]:
    data = np.ascontiguousarray(values).tobytes()
    offset = sum(len(b) for b in blocks)
    blocks.append(data + b"\0" * (-len(data) % ALIGNMENT))
    return {"$": [_TYPES[values.dtype.name], list(values.shape), offset]}


def _part(part: Part, blocks: list[bytes]) -> dict[str, Any]:
    """A mesh with 16-bit coordinates; vertices at one place become one."""
    vertices = np.asarray(part.vertices, np.float64)
    low, size = vertices.min(axis=0), np.maximum(np.ptp(vertices, axis=0), 1e-9)
    steps = np.rint((vertices - low) / size * STEPS).astype(np.int64)
    key = (steps[:, 0] << 32) + (steps[:, 1] << 16) + steps[:, 2]
    _, first, number = np.unique(key, return_index=True, return_inverse=True)
    # in the order of the mesh, which compresses better
    order = np.argsort(first)
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    triangles = rank[number][np.asarray(part.triangles)]
    width = np.uint16 if len(order) <= STEPS else np.uint32
    return {
        "name": part.name,
        "joint": part.joint,
        "layer": part.layer,
        "low": [float(v) for v in low],
        "size": [float(v) for v in size],
        "vertices": _array(steps[first[order]].astype(np.uint16), blocks),
        "triangles": _array(triangles.astype(width), blocks),
        "colour": [float(v) for v in part.colour],
        "smooth": part.smooth,
    }


REVISION = 'const e="140"'
"""Revision of three.js that the pages were written for."""

BEGIN = "Three.js Authors"
END = 'Object.defineProperty(t,"__esModule",{value:!0})}));'
"""Where the library ends; what follows are trimesh's own controls."""


@cache
def three_source() -> str:
    """three.js r140 as a script that defines the global THREE.

    Raises:
        PlannerError: trimesh is of a version that carries another one, or none.
    """
    archive = Path(trimesh.__file__).parent / "resources/templates/viewer.zip"
    try:
        with zipfile.ZipFile(archive) as zipped:
            page = zipped.read("viewer.html.template").decode()
    except (OSError, KeyError, zipfile.BadZipFile, UnicodeDecodeError) as error:
        raise _not_there(str(error)) from error
    begin = page.find("<script>") + len("<script>")
    end = page.find(END)
    source = page[begin : end + len(END)]
    if end < 0 or REVISION not in source or BEGIN not in source[:500] or "</script" in source:
        raise _not_there("its viewer holds another revision of three.js than r140")
    return source


def _not_there(reason: str) -> PlannerError:
    return PlannerError(
        f"pages are drawn by three.js out of the package trimesh, and trimesh {trimesh.__version__}"
        f" does not have it: {reason}; pip install 'trimesh{TRIMESH}'"
    )


TRIMESH = ">=4.10,<6"
"""Versions of trimesh with that revision; the same in pyproject.toml."""


@cache
def asset(name: str) -> str:
    """The text of a file in ``planner/pages/assets``."""
    return resources.files("planner.pages").joinpath("assets", name).read_text(encoding="utf-8")


def own_scripts(*names: str) -> tuple[str, ...]:
    """Scripts of a kind of page, after one that adds the style of side panels."""
    style = json.dumps(asset("side.css")).replace("</", "<\\/")
    made = f'Object.assign(document.createElement("style"), {{textContent: {style}}})'
    return (f"document.head.append({made});", *(asset(name) for name in names))


CELL_HEIGHT = 640
"""Height (CSS pixels) of a page in the cell of a notebook."""


def show_page(page: Page) -> None:
    """Show a page in the notebook that this runs in, else in the browser.

    Where there is neither, the page is written to a temporary file and its path printed.
    """
    shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
    if shell is not None and hasattr(shell, "kernel"):
        display = import_module("IPython.display")
        display.display(display.HTML(_in_frame(page)))
        return
    file = temporary_page(page)
    if has_browser():
        webbrowser.open(file.resolve().as_uri())
    else:
        print(f"no browser on this machine; the page is {file}")


def _in_frame(page: Page) -> str:
    """A page in a frame of its own, which runs its scripts and reaches nothing of the notebook."""
    return (
        f'<iframe srcdoc="{escape(page_html(page))}" sandbox="allow-scripts allow-downloads" '
        f'style="width:100%;height:{CELL_HEIGHT}px;border:0"></iframe>'
    )


def has_browser() -> bool:
    """Whether this machine has a display and a browser on it."""
    displays = ("DISPLAY", "WAYLAND_DISPLAY")
    if sys.platform == "linux" and not any(os.environ.get(d) for d in displays):
        return False
    try:
        webbrowser.get()
    except webbrowser.Error:
        return False
    return True


def temporary_page(page: Page) -> Path:
    """A page in a temporary file of its own."""
    file = Path(tempfile.mkdtemp(prefix="opposable-")) / f"{plain_name(page.title)}.html"
    write_page(page, file)
    return file
