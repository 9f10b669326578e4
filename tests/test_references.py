"""Dotted names in docstrings, comments and documents lead to something that exists."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
REFERENCE = re.compile(r"`{1,2}((?:planner|sim)(?:\.\w+)+)(?:\(.*?\))?`{1,2}")
"""A name in backquotes that begins with one of our packages."""

FILES = [
    path
    for folder in ("planner", "sim", "examples", "docs", "tests")
    for path in sorted((ROOT / folder).rglob("*"))
    if path.suffix in (".py", ".md", ".toml")
] + [ROOT / "README.md"]


def exists(name: str) -> bool:
    """Whether a dotted name is a module, or something in one."""
    parts = name.split(".")
    for k in range(len(parts), 0, -1):
        try:
            found: object = importlib.import_module(".".join(parts[:k]))
        except ModuleNotFoundError:
            continue
        for part in parts[k:]:
            if not hasattr(found, part):
                fields = getattr(found, "__annotations__", {})
                return part in fields
            found = getattr(found, part)
        return True
    return False


def test_the_reader_of_references_can_tell() -> None:
    assert exists("planner.contacts.ContactSet.forces")
    assert exists("planner.plan.GraspPlan.contacts")
    assert not exists("planner.contacts.ContactSett")
    assert not exists("planner.collision.no_such_module")


@pytest.mark.parametrize("package", ["planner", "sim", "examples", "docs", "tests", "README.md"])
def test_every_reference_resolves(package: str) -> None:
    lost = {
        (str(path.relative_to(ROOT)), name)
        for path in FILES
        if path.relative_to(ROOT).parts[0] == package
        for name in REFERENCE.findall(path.read_text(encoding="utf-8"))
        if not name.endswith(".py") and not exists(name)
    }
    assert lost - {("tests/test_references.py", "planner.collision.pad_contact")} == set()
