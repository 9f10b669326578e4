"""YAML in and out: a reader that hides no double key, and checked values that say their place.

Numbers such as ``1e-05`` are text to YAML 1.1, which wants ``1.0e-05``; some tools write them all
the same, so that a text that is a number counts as one here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from planner.arrays import LARGEST_FLOAT
from planner.errors import FileFormatError, TaskError, shown
from planner.spatial import SE3, FloatArray, pose_from_wxyz

UNIT_TOL = 1e-3
"""How far the length of a quaternion may be from 1 (-): files with four decimals pass."""

MOST_VALUES = 1_000_000
"""Most values of a file with aliases, written out; without aliases the file's size is the limit."""

DEEPEST = 50
"""Most mappings and lists inside each other; what is read here has fewer than ten."""

HEAD = 4096
"""Characters of a file within which it says its format."""

WIDTH = 100
"""Characters of a line of YAML, as near as numbers allow."""


def _yaml() -> Any:
    """PyYAML.

    Raises:
        TaskError: It is not installed.
    """
    try:
        return import_module("yaml")
    except ImportError as error:
        raise TaskError(
            "this format is YAML, which needs PyYAML: pip install 'opposable[yaml]'"
        ) from error


def yaml_text(documents: Sequence[Any], comments: Sequence[str] = ()) -> str:
    """Plain data as YAML, numbers to the last digit.

    Args:
        documents: Each becomes a document of its own.
        comments: Lines that stand above all.
    """
    yaml = _yaml()
    body = yaml.dump_all(
        documents,
        Dumper=getattr(yaml, "CSafeDumper", yaml.SafeDumper),
        sort_keys=False,
        default_flow_style=None,
        width=WIDTH,
        allow_unicode=True,
        explicit_start=len(documents) > 1,
    )
    return "".join(f"# {line}\n" for line in comments) + str(body)


def read_documents(path: Path, what: str) -> list[Any]:
    """The documents of a YAML or JSON file, without those that are empty.

    Raises:
        FileFormatError: It cannot be read, is damaged, or has a key twice in one place.
    """
    yaml = _yaml()
    try:
        written = path.read_text("utf-8")
        _need_plain(written, yaml)
        return [d for d in yaml.load_all(written, _loader(yaml)) if d is not None]
    except OSError as error:
        raise FileFormatError(f"cannot read {what} {path}: {error.strerror}") from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        said = " ".join(str(error).split())
        raise FileFormatError(f"{path} is damaged or not YAML: {said}") from error


def _need_plain(written: str, yaml: Any) -> None:
    """See that libyaml does not end the process by depth, and that aliases stand for little.

    Writers repeat what stands in two places by an alias; aliases of aliases make a kilobyte stand
    for 10^12 values. What is counted is as it would be written out.
    """
    depth, count = 0, 0
    begun: list[tuple[str | None, int]] = []  # anchor of each open collection, and the count there
    sizes: dict[str, int] = {}
    for event in yaml.parse(written, getattr(yaml, "CSafeLoader", yaml.SafeLoader)):
        count += sizes.get(event.anchor, 1) if isinstance(event, yaml.AliasEvent) else 1
        if isinstance(event, yaml.CollectionStartEvent):
            begun.append((event.anchor, count))
        elif isinstance(event, yaml.CollectionEndEvent):
            anchor, before = begun.pop()
            if anchor is not None:
                sizes[anchor] = count - before
        if isinstance(event, yaml.AliasEvent) and event.anchor in [name for name, _ in begun]:
            raise ValueError(f"the alias *{event.anchor} stands in what it names{event.start_mark}")
        if isinstance(event, yaml.AliasEvent) and count > MOST_VALUES:
            raise ValueError(
                f"its aliases stand for more than {MOST_VALUES} values{event.start_mark}; write "
                "out what they stand for"
            )
        depth = len(begun)
        if depth > DEEPEST:
            raise ValueError(f"it is nested more than {DEEPEST} times{event.start_mark}")


def _loader(yaml: Any) -> Any:
    """The safe loader, which makes plain data only, and refuses a key that is given twice."""

    class Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
        def construct_mapping(self, node: Any, deep: bool = False) -> Any:
            seen: set[Any] = set()
            for key, _ in node.value:
                name = getattr(key, "value", None)
                if isinstance(name, str) and name in seen:
                    raise yaml.constructor.ConstructorError(
                        None, None, f"the key {name!r} is given twice", key.start_mark
                    )
                seen.add(name if isinstance(name, str) else id(key))
            return super().construct_mapping(node, deep)

    return Loader


def head_of(path: Path) -> str:
    """The first ``HEAD`` characters of a text file; "" for a folder or another file."""
    if not path.is_file():
        return ""
    try:
        with path.open(encoding="utf-8") as stream:
            return stream.read(HEAD)
    except UnicodeDecodeError:
        return ""


def table(value: Any, where: str) -> Mapping[str, Any]:
    """A value that must be a mapping with texts as keys.

    Raises:
        FileFormatError: It is something else.
    """
    if not isinstance(value, dict):
        raise FileFormatError(f"{where} is {_shown(value)}; a mapping of names to values is needed")
    for key in value:
        if not isinstance(key, str):
            raise FileFormatError(
                f"{where} has the key {shown(key)}; write it as a text, in quotes"
            )
    return value


def member(data: Mapping[str, Any], key: str, where: str) -> Any:
    """A value of a mapping that must be there.

    Raises:
        FileFormatError: It is not.
    """
    if key not in data:
        there = ", ".join(map(str, data)) or "nothing"
        raise FileFormatError(f"{where} has no {key}; it has {there}")
    return data[key]


def text(value: Any, where: str) -> str:
    """A value that must be a text.

    Raises:
        FileFormatError: It is something else.
    """
    if not isinstance(value, str):
        raise FileFormatError(f"{where} is {_shown(value)}; a text is needed")
    return value


def number(value: Any, where: str) -> float:
    """A value that must be a finite number, or a text that is one.

    Raises:
        FileFormatError: It is something else.
    """
    try:
        found = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError, OverflowError):
        found = math.nan
    if not abs(found) <= LARGEST_FLOAT:  # NaN too
        raise FileFormatError(
            f"{where} is {_shown(value)}; a finite number is needed, {LARGEST_FLOAT:g} at most"
        )
    return found


def numbers(value: Any, count: int | None, where: str) -> FloatArray:
    """A value that must be a list of finite numbers.

    Args:
        value: The value.
        count: How many; None for any number.
        where: Its place, for messages.

    Raises:
        FileFormatError: It is something else.
    """
    if not isinstance(value, list) or (count is not None and len(value) != count):
        size = f" of {len(value)}" if isinstance(value, list) else ""
        wanted = "numbers" if count is None else f"{count} numbers"
        raise FileFormatError(f"{where} is {_shown(value)}{size}; a list of {wanted} is needed")
    return np.array([number(v, f"{where}[{i}]") for i, v in enumerate(value)], dtype=np.float64)


def pose_of(position: FloatArray, quat_wxyz: FloatArray, where: str) -> SE3:
    """A pose from a position (3,), m, and a quaternion w, x, y, z (4,) of length 1.

    Raises:
        FileFormatError: The quaternion's length is not 1.
    """
    length = float(np.linalg.norm(quat_wxyz))
    if abs(length - 1.0) > UNIT_TOL:
        raise FileFormatError(
            f"{where} is a quaternion of length {length:.6g}; a rotation has length 1: the file "
            "is damaged, or its numbers mean something else"
        )
    return pose_from_wxyz(position, quat_wxyz)


def _shown(value: Any) -> str:
    """A value in a message, not longer than a few words."""
    if isinstance(value, dict | list):
        return "a mapping" if isinstance(value, dict) else "a list"
    return shown(value, 40)
