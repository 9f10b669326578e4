"""``Shown`` and ``in_notebook``: give things ``show``, ``save``, ``save_html``, ``_repr_html_``.

Plans stand below the room that makes pages, so they cannot import it. The packages, which stand
above all their rooms, say by name where the page and the file of each kind are made
(``register_page``), and what a notebook shows of it (``register_notebook``); that is imported when
it is first asked for.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

from planner.errors import NotFoundError

__all__ = ["Shown", "in_notebook", "page_of", "register_notebook", "register_page"]

_MAKERS: dict[str, str] = {}
"""Name of a class -> "module:function" of what makes its page."""

_NOTEBOOK: dict[str, str] = {}
"""Name of a class -> "module:function" of what a notebook shows of it."""

_KEPT = "_notebook_html"
"""Where a thing keeps it."""

_FILES: dict[str, str] = {}
"""Name of a class -> "module:function" of what writes its file."""


def register_page(kind: str, maker: str, writer: str = "") -> None:
    """Say what makes the page of a kind of thing, and what writes its file.

    Args:
        kind: Name of its class, for example "GraspPlan".
        maker: "module:function", a function of the thing that returns ``planner.pages.page.Page``.
        writer: "module:function" of the thing and a path; "" for a kind without a file.
    """
    _MAKERS[kind] = maker
    if writer:
        _FILES[kind] = writer


def register_notebook(kind: str, maker: str) -> None:
    """Say what makes the HTML that notebooks show of a kind of thing.

    Args:
        kind: Name of its class.
        maker: "module:function", a function of the thing that returns HTML.
    """
    _NOTEBOOK[kind] = maker


def in_notebook(thing: object) -> str:
    """What a notebook shows of a thing that does not change: a table and a small picture as HTML.

    It is made once for each thing. Give ``_repr_html_`` of a registered kind this body.

    Raises:
        NotFoundError: Nothing makes it for this kind.
    """
    kept = vars(thing)
    if _KEPT not in kept:
        kind = type(thing).__name__
        if kind not in _NOTEBOOK:
            hint = "Register a function with planner.showing.register_notebook."
            raise NotFoundError("kind of thing for notebooks", kind, _NOTEBOOK, hint)
        kept[_KEPT] = _named(_NOTEBOOK[kind])(thing)
    html: str = kept[_KEPT]
    return html


def page_of(thing: object) -> Any:
    """The ``planner.pages.page.Page`` of a thing.

    Raises:
        NotFoundError: Nothing makes pages of its kind.
    """
    return _registered(_MAKERS, thing, "kind of thing with a page")(thing)


def _registered(makers: dict[str, str], thing: object, what: str) -> Any:
    for kind in type(thing).__mro__:
        if kind.__name__ in makers:
            return _named(makers[kind.__name__])
    hint = "Register a function with planner.showing.register_page."
    raise NotFoundError(what, type(thing).__name__, makers, hint)


def _named(home: str) -> Any:
    module, _, name = home.partition(":")
    return getattr(import_module(module), name)


class Shown:
    """A thing that a page can show, and a file keep."""

    def show(self) -> None:
        """Show its page: in the cell of a notebook, else in the browser.

        Without a browser the path of the page, a temporary file, is printed.
        """
        _named("planner.pages.page:show_page")(page_of(self))

    def save(self, path: Path | str) -> None:
        """Write its file (JSON), from which it can be read again.

        Args:
            path: The file, replaced if it is there.

        Raises:
            FileFormatError: The folder does not exist or cannot be written, or no file can hold it.
            NotFoundError: Nothing writes files of its kind.
        """
        _registered(_FILES, self, "kind of thing with a file")(self, path)

    def save_html(self, path: Path | str) -> None:
        """Write its page: one HTML file that opens in any browser, without a network.

        Args:
            path: The file, replaced if it is there.

        Raises:
            FileFormatError: The folder does not exist or cannot be written.
        """
        _named("planner.pages.page:write_page")(page_of(self), path)
