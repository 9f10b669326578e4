"""The arrows of the architecture, read from the imports: who may know whom."""

from __future__ import annotations

import ast
import importlib
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("planner", "sim")


@cache
def sources() -> dict[str, Path]:
    """Dotted name of every module of both packages and of ``benchmarks`` -> its file."""
    out = {}
    for package in (*PACKAGES, "benchmarks"):
        for path in sorted((ROOT / package).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            out[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return out


def within(name: str, room: str) -> bool:
    """Whether a dotted name is a room or in it."""
    return name == room or name.startswith(f"{room}.")


def imported(tree: ast.AST, module: str, *, functions_too: bool) -> Iterator[str]:
    """Dotted names that are imported, for ``from a import b`` both a and a.b."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module} imports relatively; write the whole name"
            assert node.module is not None
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif functions_too or not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield from imported(node, module, functions_too=functions_too)


@dataclass(frozen=True)
class Facts:
    """What the tests need of a module; its tree is dropped, as collecting garbage walks all trees.

    Attributes:
        early: What it imports when it is imported.
        late: The same, in functions too.
        public: ``__all__`` as it is written, or None.
        assigned: Names that it assigns at its top level.
    """

    early: frozenset[str]
    late: frozenset[str]
    public: tuple[str, ...] | None
    assigned: frozenset[str]


@cache
def facts(module: str) -> Facts:
    """A module as its parser sees it."""
    tree = ast.parse(sources()[module].read_text(encoding="utf-8"))
    early, late = (frozenset(imported(tree, module, functions_too=too)) for too in (False, True))
    values = {
        target.id: node.value
        for node in tree.body
        if isinstance(node, ast.Assign)
        for target in node.targets
        if isinstance(target, ast.Name)
    }
    public = values.get("__all__")
    names = None if public is None else tuple(ast.literal_eval(public))
    return Facts(early, late, names, frozenset(values))


def imports_of(module: str, *, functions_too: bool = True) -> frozenset[str]:
    """What a module imports; branches of ``if TYPE_CHECKING`` count like any other."""
    return facts(module).late if functions_too else facts(module).early


@cache
def neighbours(module: str, *, functions_too: bool = False) -> frozenset[str]:
    """Modules of ours that run when a module is imported, except the packages that hold it.

    ``import a.b`` runs the package a as well.
    """
    out = set()
    for name in imports_of(module, functions_too=functions_too):
        parts = name.split(".")
        for k in range(1, len(parts) + 1):
            ancestor = ".".join(parts[:k])
            if ancestor in sources() and not within(module, ancestor):
                out.add(ancestor)
    # the top package re-exports what is public: it stands above everything it holds
    return frozenset(out - {p for p in PACKAGES if module.split(".")[0] == p})


def reached(module: str, *, functions_too: bool = False) -> set[str]:
    """Modules of ours that a module imports, directly or through others."""
    found: set[str] = set()
    stack = [module]
    while stack:
        new = neighbours(stack.pop(), functions_too=functions_too) - found
        found |= new
        stack += new
    return found


def in_cycles(*, functions_too: bool = False) -> list[str]:
    """Modules of ours, packages themselves apart, that import themselves through others."""
    left = set(sources())
    while done := {m for m in left if not left & neighbours(m, functions_too=functions_too)}:
        left -= done  # what imports nothing that is left is in no cycle
    return [m for m in left - {*PACKAGES} if m in reached(m, functions_too=functions_too)]


def test_the_reader_of_imports_sees_every_form() -> None:
    code = """
import a
import b.c as d
from e import f
if TYPE_CHECKING:
    from g import h
class K:
    import i
def late():
    import j
"""
    tree = ast.parse(code)
    early = {"a", "b.c", "e", "e.f", "g", "g.h", "i"}
    assert set(imported(tree, "x", functions_too=False)) == early
    assert set(imported(tree, "x", functions_too=True)) == early | {"j"}


def test_all_modules_are_found() -> None:
    assert {"planner", "planner.contacts", "planner.bridge.load", "sim.trial"} <= set(sources())


def test_planner_never_imports_sim() -> None:
    guilty = {
        m for m in sources() if within(m, "planner") for i in imports_of(m) if within(i, "sim")
    }
    assert not guilty


def test_nothing_that_ships_imports_the_measurements() -> None:
    ships = [m for m in sources() if not within(m, "benchmarks")]
    assert not {m for m in ships for i in imports_of(m) if within(i, "benchmarks")}


def test_in_planner_only_the_bridge_imports_mujoco() -> None:
    users = {m for m in sources() if any(within(i, "mujoco") for i in imports_of(m))}
    planner_users = {m for m in users if within(m, "planner")}
    assert planner_users
    assert {m for m in planner_users if not within(m, "planner.bridge")} == set()


ALLOWED = tomllib.loads((ROOT / "tests/rooms.toml").read_text(encoding="utf-8"))
"""Package -> its rooms from the bottom up -> rooms that each may import; itself always."""


def room_of(module: str) -> str:
    """The file or folder of a package's top level that a module is, or is in."""
    return ".".join(module.split(".")[:2])


@cache
def rooms_of(package: str) -> dict[str, set[str]]:
    """Room of a package -> rooms that it imports, in functions too."""
    out: dict[str, set[str]] = {}
    known = {room_of(m) for m in sources()}
    for module in [m for m in sources() if within(m, package) and m != package]:
        below = {room_of(i) for i in imports_of(module) if i.count(".") and within(i, package)}
        out.setdefault(room_of(module), set()).update((below & known) - {room_of(module)})
    return out


@pytest.mark.parametrize("package", PACKAGES)
def test_every_room_is_in_the_table(package: str) -> None:
    assert set(rooms_of(package)) == {f"{package}.{room}" for room in ALLOWED[package]}


@pytest.mark.parametrize(
    ("package", "room"), [(package, room) for package in PACKAGES for room in ALLOWED[package]]
)
def test_a_room_knows_only_the_rooms_below(package: str, room: str) -> None:
    order = list(ALLOWED[package])
    allowed = ALLOWED[package][room].split()
    assert all(order.index(below) < order.index(room) for below in allowed)
    found = {name.removeprefix(f"{package}.") for name in rooms_of(package)[f"{package}.{room}"]}
    assert found <= set(allowed), f"{room} imports {sorted(found - set(allowed))}"


@pytest.mark.parametrize("room", ["planner.contacts", "planner.quality", "planner.forces"])
def test_grasp_analysis_reaches_neither_hand_nor_engine(room: str) -> None:
    # directly or through any other module: contacts alone must be enough
    forbidden = ("planner.hands.hand", "planner.bridge", "planner.kinematics", "planner.task")
    for module in [m for m in sources() if within(m, room)]:
        everything = {module} | reached(module)
        assert not {m for m in everything for f in forbidden if within(m, f)}
        engines = {
            i for m in everything for i in imports_of(m) if i in ("mujoco", "coal", "casadi")
        }
        assert not engines


def test_tolerances_are_defined_on_their_page_alone() -> None:
    page = set(facts("planner.tolerances").public or ())
    assert page
    for module in set(sources()) - {"planner.tolerances"}:
        again = facts(module).assigned & page
        assert not again, f"{module} defines {sorted(again)} again"


def test_synthesis_does_not_know_who_uses_it() -> None:
    above = ("planner.plan", "planner.search.grasp", "planner.files")
    for module in [m for m in sources() if within(m, "planner.synthesis")]:
        assert not {m for m in reached(module) for a in above if within(m, a)}, module


def test_there_are_no_import_cycles() -> None:
    assert not in_cycles()
    assert not in_cycles(functions_too=True)
    # a package re-exports what its modules define: none of them may ask it for a name
    own = [(m, i) for m in sources() for i in imports_of(m) if i != m and within(m, i)]
    assert not own


def test_every_folder_of_modules_is_a_package() -> None:
    folders = {path.parent for path in sources().values()}
    missing = [str(f.relative_to(ROOT)) for f in folders if not (f / "__init__.py").is_file()]
    assert not missing


def sort_key(name: str) -> tuple[int, str]:
    """Constants, then classes, then functions, as isort has them."""
    group = 0 if name.isupper() and len(name) > 1 else 1 if name[0].isupper() else 2
    return group, name


FACES = [m for m, path in sources().items() if "__all__" in path.read_text(encoding="utf-8")]
"""Modules that may say what is public; the text alone, as parsing all of them takes seconds."""


@pytest.mark.parametrize("module", FACES)
def test_public_names_are_sorted_and_resolve(module: str) -> None:
    names = facts(module).public or ()
    assert list(names) == sorted(set(names), key=sort_key)
    loaded = importlib.import_module(module)
    assert [n for n in names if not hasattr(loaded, n)] == []


def test_every_package_with_contents_says_what_is_public() -> None:
    for module, path in sources().items():
        if path.name == "__init__.py" and imports_of(module):
            assert facts(module).public, f"{module} re-exports without __all__"
