"""``kinds``: the kinds of things that can be viewed, each recognised by its content.

Adding one is one ``Kind``, and its place in ``sim.show.kinds.OURS``; from elsewhere it
is a call of ``register_kind``.

``Target``: what a person named on the command line, and what its content says it is.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any

from planner.errors import FileFormatError, NotFoundError, few_of, shown
from planner.files import plan_files
from planner.hands.catalog import hand_names
from planner.objects import object_names
from planner.pages.page import read_page_data
from sim.show.browser import Shown


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


_REGISTERED: list[Kind] = []


def register_kind(kind: Kind) -> None:
    """Add a kind after those that are there; one of the same name is replaced."""
    _REGISTERED[:] = [*(k for k in _REGISTERED if k.name != kind.name), kind]


def kinds() -> tuple[Kind, ...]:
    """All kinds; imports what recognises them."""
    ours: tuple[Kind, ...] = import_module("sim.show.kinds").OURS  # by its name: it needs this one
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
        if "/" in target.text or "." in target.text:
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


HEAD = 1 << 16
"""Bytes from the beginning of a file by which it is recognised."""

_SCALED = re.compile(r"(.+)\*[^*/\\]*")
"""A mesh file with its scale: part.stl*0.001."""

_BODY = re.compile(r"(.+)#[^#/\\]*")
"""A body of a model: scene.xml#mug."""


@dataclass(frozen=True)
class Target:
    """A name, a file or a folder.

    Attributes:
        text: As it was given.
    """

    text: str

    @cached_property
    def path(self) -> Path | None:
        """The file or folder, without a scale or the name of a body; None if there is none."""
        candidates = [self.text]
        candidates += [
            m[1] for m in (_SCALED.fullmatch(self.text), _BODY.fullmatch(self.text)) if m
        ]
        for candidate in candidates:
            try:
                if Path(candidate).exists():
                    return Path(candidate)
            except (OSError, ValueError):  # no file can have this name, or the way is barred
                continue
        return None

    @property
    def is_folder(self) -> bool:
        """Whether it is a folder."""
        return self.path is not None and self.path.is_dir()

    @property
    def is_file(self) -> bool:
        """Whether it is a file."""
        return self.path is not None and self.path.is_file()

    @property
    def names_body(self) -> bool:
        """Whether it names a body of a model file."""
        return self.path is not None and _BODY.fullmatch(self.text) is not None

    def holds(self, name: str) -> bool:
        """Whether it is a folder with a file of this name."""
        return self.is_folder and (self._there / name).is_file()

    @cached_property
    def head(self) -> bytes:
        """The beginning of the file.

        Raises:
            FileFormatError: It cannot be read.
        """
        try:
            with self._there.open("rb") as stream:
                return stream.read(HEAD)
        except OSError as error:
            raise FileFormatError(f"cannot read {self.path}: {error.strerror}") from error

    @cached_property
    def content(self) -> str:
        """The whole file as text; what is not UTF-8 is replaced.

        Raises:
            FileFormatError: It cannot be read.
        """
        try:
            return self._there.read_text(encoding="utf-8", errors="replace")
        except OSError as error:
            raise FileFormatError(f"cannot read {self.path}: {error.strerror}") from error

    @cached_property
    def data(self) -> dict[str, Any] | None:
        """The JSON object that the file holds, or the numbers of a page; None for another file.

        Raises:
            FileFormatError: It begins like JSON and is damaged, or is a page of others.
        """
        if self.is_html:
            return read_page_data(self._there)[1]
        if not self.is_file or not self.head.lstrip().startswith(b"{"):
            return None
        try:
            data = json.loads(self.content)
        except (ValueError, RecursionError) as error:  # no JSON, or too deep
            raise FileFormatError(f"{self.path} is damaged or not JSON: {error}") from error
        return data if isinstance(data, dict) else None

    @cached_property
    def table(self) -> dict[str, Any] | None:
        """The tables of a TOML file; None for a file of something else."""
        if not self.is_file or b"=" not in self.head or b"\0" in self.head:
            return None
        try:
            return tomllib.loads(self.content)
        except tomllib.TOMLDecodeError:
            return None

    @property
    def format(self) -> str:
        """The field ``format`` of a JSON file; "" if there is none."""
        found = (self.data or {}).get("format")
        return found if isinstance(found, str) else ""

    @property
    def is_html(self) -> bool:
        """Whether it is an HTML page."""
        return self.is_file and self.head.lstrip()[:14].lower() in (b"<!doctype html", b"<html")

    @property
    def _there(self) -> Path:
        if self.path is None:
            raise FileFormatError(f"there is no file {shown(self.text)}; check the path")
        return self.path
