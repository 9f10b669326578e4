"""A headless browser without a network, in which ``bench pages`` opens what it wrote.

playwright drives it; the browser is the Chromium on the PATH.
"""

from __future__ import annotations

import io
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from planner.errors import PlannerError
from planner.spatial import FloatArray

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
"""Names that are looked for on the PATH."""

ARGUMENTS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
"""WebGL without a GPU."""

WINDOW = {"width": 700, "height": 500}
"""Of the page, pixels: small, since every pixel of the scene is computed without a GPU."""

PATIENCE = 60.0
"""Longest wait for a page to start, s."""

STARTED = "window.opposable.ready || window.opposable.errors.length > 0"

POSES = """([times, actors]) => times.map((t) => {
  window.opposable.seek(t);
  return Object.fromEntries(Object.entries(actors).map(
    ([actor, joints]) => [actor, joints.map((joint) => window.opposable.pose(actor, joint))]));
})"""

COMMON = 1e-3
"""Share of the scene's pixels from which on a colour counts."""


@dataclass
class Opened:
    """A page that is open.

    Attributes:
        page: playwright's page.
        errors: What it threw or wrote to the console as a warning or an error.
        requests: Addresses that it asked for, besides its own file.
    """

    page: Any
    errors: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)

    @property
    def time(self) -> float:
        """The time that it shows, s."""
        return float(self.page.evaluate("window.opposable.time()"))

    def poses_at(
        self, times: Sequence[float], actors: Mapping[str, Sequence[str | None]]
    ) -> list[dict[str, FloatArray]]:
        """World poses as drawn, at some times, s.

        Args:
            times: Where the page is moved to, one after the other.
            actors: Actor -> names of joints, whose bodies are asked for; None for the base.

        Returns:
            For every time actor -> (k, 7).
        """
        found = self.page.evaluate(POSES, [list(times), {a: list(j) for a, j in actors.items()}])
        return [{a: np.array(rows, dtype=np.float64) for a, rows in one.items()} for one in found]

    def colours(self) -> int:
        """How many colours, of 16 steps per channel, are common in the scene."""
        self.page.evaluate("window.opposable.draw()")
        shot = Image.open(io.BytesIO(self.page.locator("#canvas").screenshot())).convert("RGB")
        pixels = np.asarray(shot).reshape(-1, 3) // 16
        _, counts = np.unique(pixels, axis=0, return_counts=True)
        return int((counts > COMMON * len(pixels)).sum())


@contextmanager
def headless() -> Iterator[Any]:
    """A browser.

    Raises:
        PlannerError: playwright or a browser is missing.
    """
    program = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    if program is None:
        raise PlannerError(f"none of {', '.join(BROWSERS)} is on the PATH; install one")
    try:
        playwright = import_module("playwright.sync_api")
    except ImportError as error:
        raise PlannerError(
            "opening pages needs playwright: pip install 'opposable[browser]'"
        ) from error
    with playwright.sync_playwright() as running:
        browser = running.chromium.launch(executable_path=program, args=ARGUMENTS)
        yield browser
        browser.close()


@contextmanager
def opened(browser: Any, path: Path) -> Iterator[Opened]:
    """A page's file, open and started, in a window of its own without a network."""
    context = browser.new_context(viewport=WINDOW, offline=True)
    address = path.resolve().as_uri()
    made = Opened(page=context.new_page())

    def asked(request: Any) -> None:
        own = request.url.split("#")[0] == address or request.url.startswith(("data:", "blob:"))
        if not own:
            made.requests.append(request.url)

    def heard(message: Any) -> None:
        if message.type in ("error", "warning"):
            made.errors.append(message.text)

    made.page.on("request", asked)
    made.page.on("pageerror", lambda error: made.errors.append(str(error)))
    made.page.on("console", heard)
    try:
        made.page.goto(address)
        end = time.monotonic() + PATIENCE
        while not made.page.evaluate(
            "window.opposable.ready || window.opposable.errors.length > 0"
        ):
            if time.monotonic() > end:
                made.errors.append(f"the page has not started after {PATIENCE} s")
                break
            made.page.wait_for_timeout(20)
        made.errors += made.page.evaluate("window.opposable.errors")
        yield made
    finally:
        context.close()
