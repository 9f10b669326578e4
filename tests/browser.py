"""A browser without a network for the tests of pages: ``open_page`` opens a file in Chromium."""

from __future__ import annotations

import base64
import io
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from planner.spatial import FloatArray

CHROMIUM = next(
    (
        path
        for name in ("chromium", "chromium-browser", "google-chrome")
        if (path := shutil.which(name))
    ),
    None,
)
"""A browser of this machine; None where there is none."""

ARGUMENTS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
"""WebGL without a GPU."""


def need_browser() -> None:
    """Skip the test where playwright or a browser is missing."""
    pytest.importorskip("playwright.sync_api")
    if CHROMIUM is None:
        pytest.skip("no chromium, chromium-browser or google-chrome on the PATH")


@dataclass
class OpenPage:
    """A page in the browser.

    Attributes:
        page: playwright's page.
        errors: Errors that the page threw or wrote to the console.
        requests: Addresses that it asked for, besides its own file.
    """

    page: Any
    errors: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)

    def wait(self, condition: str, seconds: float = 30.0) -> None:
        """Wait until an expression is true.

        playwright's ``wait_for_function`` is not possible: the page's policy forbids ``eval``.
        """
        end = time.monotonic() + seconds
        while not self.page.evaluate(condition):
            assert time.monotonic() < end, f"still not true after {seconds} s: {condition}"
            self.page.wait_for_timeout(20)

    def seek(self, at: float) -> None:
        """Move the page to a time, s."""
        self.page.evaluate("t => window.opposable.seek(t)", at)

    def time(self) -> float:
        """The page's time, s."""
        return float(self.page.evaluate("window.opposable.time()"))

    def pose(self, actor: str, joint: str | None = None) -> FloatArray:
        """World pose (7,) of an actor's base or of a joint's body, as drawn."""
        call = "([a, j]) => window.opposable.pose(a, j)"
        return np.array(self.page.evaluate(call, [actor, joint]))

    def set(self, layer: str, on: bool) -> None:
        """Switch a layer."""
        self.page.evaluate("([l, on]) => window.opposable.set(l, on)", [layer, on])

    def picture(self, selector: str = "#view") -> Image.Image:
        """What an element looks like."""
        self.page.evaluate("window.opposable.draw && window.opposable.draw()")
        return Image.open(io.BytesIO(self.page.locator(selector).screenshot())).convert("RGB")

    def drawn(self) -> Image.Image:
        """What is drawn of the scene alone, without the words and buttons over it."""
        draw = "Opposable.stage.draw(), document.getElementById('canvas').toDataURL()"
        _, _, content = self.page.evaluate(draw).partition(",")
        return Image.open(io.BytesIO(base64.b64decode(content))).convert("RGBA")

    def colours(self) -> int:
        """How many colours (of 16 steps per channel) fill more than 0.1 % of the scene."""
        pixels = np.asarray(self.picture("#canvas")).reshape(-1, 3).astype(int) // 16
        counts = np.bincount(pixels @ [256, 16, 1])
        return int((counts > 1e-3 * len(pixels)).sum())

    def all_errors(self) -> list[str]:
        """Errors that the browser saw, and those that the page kept."""
        return [*self.errors, *self.page.evaluate("window.opposable.errors")]


@contextmanager
def browser() -> Iterator[Any]:
    """A headless Chromium; the test is skipped where there is none."""
    need_browser()
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        yield chromium
        chromium.close()


@contextmanager
def open_page(
    chromium: Any,
    path: Path,
    *,
    width: int = 1400,
    height: int = 900,
    scale: float = 0.5,
    dark: bool = False,
    script: str = "",
) -> Iterator[OpenPage]:
    """A page's file, open and started, without a network.

    Args:
        chromium: What ``browser`` gave.
        path: The file.
        width: Of the window, pixels.
        height: Of the window, pixels.
        scale: Pixels of the screen per pixel of the window: few, for no GPU draws them.
        dark: Whether the person prefers dark pages.
        script: JavaScript that runs before the page's own.
    """
    context = chromium.new_context(
        viewport={"width": width, "height": height},
        device_scale_factor=scale,
        offline=True,
        color_scheme="dark" if dark else "light",
    )
    address = path.resolve().as_uri()
    opened = OpenPage(page=context.new_page())

    if script:
        opened.page.add_init_script(script)

    def refuse(route: Any) -> None:
        if route.request.url == address:
            route.continue_()
        else:
            route.abort()

    def asked(request: Any) -> None:
        if request.url.split("#")[0] != address and not request.url.startswith(("data:", "blob:")):
            opened.requests.append(request.url)

    context.route("**/*", refuse)
    opened.page.on("request", asked)
    opened.page.on("pageerror", lambda error: opened.errors.append(str(error)))
    opened.page.on(
        "console",
        lambda m: opened.errors.append(m.text) if m.type in ("error", "warning") else None,
    )
    opened.page.goto(address)
    try:
        opened.wait("window.opposable.ready || window.opposable.errors.length > 0")
        yield opened
    finally:
        context.close()
