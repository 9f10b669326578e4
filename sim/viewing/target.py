"""``Target``: what a person named on the command line, and what its content says it is."""

from __future__ import annotations

import json
import re
import tomllib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from planner.errors import FileFormatError, shown
from planner.pages.page import read_page_data

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
