"""``Shown`` and ``in_notebook``: what gives things their ``save_html`` and ``_repr_html_``.

Plans stand below the room that makes pages, so they cannot import it. The packages, which stand
above all their rooms, say by name where the page of each kind is made (``register_page``), and what
a notebook shows of it (``register_notebook``); that is imported when it is first asked for.
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

_WRITER = "planner.pages.page:write_page"


def register_page(kind: str, maker: str) -> None:
    """Say what makes the page of a kind of thing.

    Args:
        kind: Name of its class, for example "GraspPlan".
        maker: "module:function", a function of the thing that returns ``planner.pages.page.Page``.
    """
    _MAKERS[kind] = maker


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
    for kind in type(thing).__mro__:
        if kind.__name__ in _MAKERS:
            return _named(_MAKERS[kind.__name__])(thing)
    hint = "Register a function with planner.showing.register_page."
    raise NotFoundError("kind of thing with a page", type(thing).__name__, _MAKERS, hint)


def _named(home: str) -> Any:
    module, _, name = home.partition(":")
    return getattr(import_module(module), name)


class Shown:
    """A thing that a page can show."""

    def save_html(self, path: Path | str) -> None:
        """Write its page: one HTML file that opens in any browser, without a network.

        Args:
            path: The file, replaced if it is there.

        Raises:
            FileFormatError: The folder does not exist or cannot be written.
        """
        _named(_WRITER)(page_of(self), path)
