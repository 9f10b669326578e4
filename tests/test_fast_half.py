"""The fast half of the tests (``pytest``) reaches every room of both packages."""

from __future__ import annotations

import ast
import tomllib
from pathlib import Path

TESTS = Path(__file__).resolve().parent
ROOMS: dict[str, dict[str, str]] = tomllib.loads((TESTS / "rooms.toml").read_text(encoding="utf-8"))

SLOW = "pytest.mark.slow"


def has_fast_tests(module: ast.Module) -> bool:
    """Whether a file has a test that the fast half runs."""
    for node in module.body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "pytestmark":
            return SLOW not in ast.unparse(node.value)
    return any(
        isinstance(node, ast.FunctionDef)
        and node.name.startswith("test_")
        and SLOW not in map(ast.unparse, node.decorator_list)
        for node in module.body
    )


def rooms_imported(module: ast.Module) -> set[tuple[str, str]]:
    """(package, room) of all that a file imports by name."""
    names: set[str] = set()
    for node in ast.walk(module):
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
    return {(parts[0], parts[1]) for parts in (name.split(".") for name in names) if parts[1:]}


def test_every_room_is_imported_by_a_file_with_fast_tests() -> None:
    found: set[tuple[str, str]] = set()
    for path in TESTS.glob("test_*.py"):
        module = ast.parse(path.read_text(encoding="utf-8"))
        if path.name != Path(__file__).name and has_fast_tests(module):
            found |= rooms_imported(module)
    assert {(package, room) for package in ROOMS for room in ROOMS[package]} - found == set()
