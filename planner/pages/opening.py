"""Brings a page to a person: into the cell of a notebook, or into the browser of this machine."""

from __future__ import annotations

import os
import sys
import tempfile
import webbrowser
from html import escape
from importlib import import_module
from pathlib import Path

from planner.files.json_csv import plain_name
from planner.pages.page import Page, page_html, write_page

__all__ = ["has_browser", "show_page", "temporary_page"]

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
