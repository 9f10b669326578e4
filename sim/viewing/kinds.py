"""``kinds``: the kinds of things that can be viewed, each recognised by its content.

Adding one is one module with a ``KIND``, and its name in ``MODULES``; from elsewhere it is a call
of ``register_kind``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TypeAlias

from planner.errors import FileFormatError, NotFoundError, few_of
from planner.files import plan_files
from planner.hands.catalog import hand_names
from planner.objects import object_names
from planner.pages.page import Page
from sim.viewing.server import Site
from sim.viewing.target import Target


@dataclass(frozen=True, kw_only=True)
class WrittenPage:
    """A page that is a file already.

    Attributes:
        path: The file.
        html: Its content.
    """

    path: Path
    html: str


Shown: TypeAlias = Page | WrittenPage | Site
"""One page, which can be written into a file, or a site, which needs a server."""


@dataclass(frozen=True, kw_only=True)
class ViewOptions:
    """What a person asks for besides the thing itself.

    Attributes:
        alternatives: How many further grasps of a plan's task to plan and show beside it.
        touch: Where fingers may touch an object, each as ``planner.objects.parse_region`` reads it.
        avoid: Where they must not.
        repair: Whether to mend a mesh however much that changes.
        strict: Whether to refuse a mesh that would have to be mended.
    """

    alternatives: int = 0
    touch: tuple[str, ...] = ()
    avoid: tuple[str, ...] = ()
    repair: bool = False
    strict: bool = False


@dataclass(frozen=True, kw_only=True)
class Kind:
    """A kind of thing that can be viewed.

    Attributes:
        name: What it is called, in a list: "a grasp plan (plan.json)".
        recognises: Whether a target is one, judged by its content.
        shown: What there is to see of it. It may raise any ``PlannerError``.
        takes: Names of the options that mean something for it.
    """

    name: str
    recognises: Callable[[Target], bool]
    shown: Callable[[Target, ViewOptions], Shown]
    takes: frozenset[str] = frozenset()


MODULES = ("of_hand", "of_mesh", "of_plan", "of_motion", "of_report", "of_dataset", "of_page")
"""Modules of this package with a ``KIND`` each, in the order in which they are listed."""

_REGISTERED: list[Kind] = []


def register_kind(kind: Kind) -> None:
    """Add a kind after those that are there; one of the same name is replaced."""
    _REGISTERED[:] = [*(k for k in _REGISTERED if k.name != kind.name), kind]


def kinds() -> tuple[Kind, ...]:
    """All kinds; imports what recognises them."""
    ours = (import_module(f"{__package__}.{module}").KIND for module in MODULES)
    return (*ours, *_REGISTERED)


def recognise(target: Target) -> Kind:
    """The kind of a target.

    Raises:
        NotFoundError: It is neither a name that is known nor a path that exists.
        FileFormatError: It is a file or folder of another kind; says what can be viewed.
    """
    known = kinds()
    for kind in known:
        if kind.recognises(target):
            return kind
    if target.path is None:
        names = (*hand_names(), *object_names())
        if _like_path(target):
            advice = "give a file, a folder, or the name of a hand or object"
            raise NotFoundError("hand or object", target.text, names, advice, is_path=True)
        hint = "Or give the path of a file or folder."
        raise NotFoundError("hand or object", target.text, names, hint)
    plans = plan_files(target.path) if target.is_folder else ()
    if plans:
        raise FileFormatError(
            f"{target.path} holds {len(plans)} plan files, and one is viewed; give a file of it: "
            f"{few_of(file.name for file in plans)}"
        )
    found = f"its format is {target.format!r}" if target.format else "it is of another kind"
    raise FileFormatError(
        f"{target.path} cannot be viewed: {found}; what can be: {', '.join(k.name for k in known)}"
    )


def _like_path(target: Target) -> bool:
    return "/" in target.text or "." in target.text
