"""The arrows of the architecture, read from the imports: who may know whom."""

from __future__ import annotations

import ast
import importlib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("planner", "sim")


@cache
def sources() -> dict[str, Path]:
    """Dotted name of every module of both packages -> its file."""
    out = {}
    for package in PACKAGES:
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


@cache
def imports_of(module: str, *, functions_too: bool = True) -> frozenset[str]:
    """What a module imports; branches of ``if TYPE_CHECKING`` count like any other."""
    tree = ast.parse(sources()[module].read_text(encoding="utf-8"))
    return frozenset(imported(tree, module, functions_too=functions_too))


@cache
def neighbours(module: str) -> frozenset[str]:
    """Modules of ours that run when a module is imported, except the packages that hold it.

    ``import a.b`` runs the package a as well.
    """
    out = set()
    for name in imports_of(module, functions_too=False):
        parts = name.split(".")
        for k in range(1, len(parts) + 1):
            ancestor = ".".join(parts[:k])
            if ancestor in sources() and not within(module, ancestor):
                out.add(ancestor)
    # the top package re-exports what is public: it stands above everything it holds
    return frozenset(out - {p for p in PACKAGES if module.split(".")[0] == p})


def reached(module: str) -> set[str]:
    """Modules of ours that a module imports, directly or through others."""
    found: set[str] = set()
    stack = [module]
    while stack:
        new = neighbours(stack.pop()) - found
        found |= new
        stack += new
    return found


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


def test_in_planner_only_the_bridge_imports_mujoco() -> None:
    users = {m for m in sources() if any(within(i, "mujoco") for i in imports_of(m))}
    planner_users = {m for m in users if within(m, "planner")}
    assert planner_users
    assert {m for m in planner_users if not within(m, "planner.bridge")} == set()


# room -> rooms of planner that it may import; itself always
ALLOWED = {
    "planner.errors": (),
    "planner.spatial": ("errors",),
    "planner.arrays": ("errors", "spatial"),
    "planner.contacts": ("arrays", "errors", "spatial"),
    "planner.actuation": ("errors", "spatial"),
    "planner.threads": (),
    "planner.tolerances": (),
    "planner.version": (),
    "planner.programme": ("spatial", "threads"),
    "planner.paths": ("spatial",),
    "planner.plain": (),
    "planner.quality": ("arrays", "errors", "spatial", "contacts", "plain", "programme"),
    "planner.forces": (
        "arrays",
        "errors",
        "spatial",
        "contacts",
        "actuation",
        "programme",
        "threads",
    ),
    "planner.trust": ("errors",),
    "planner.shapes": ("arrays", "errors", "spatial", "trust"),
    "planner.regions": ("errors", "spatial"),
    "planner.objects": ("errors", "spatial", "bridge", "regions", "shapes"),
    "planner.environment": (),
    "planner.fetched": ("environment", "errors"),
    "planner.catalog": ("errors", "fetched"),
    "planner.schema": (),
    "planner.couplings": ("errors", "spatial", "programme"),
    "planner.description": ("schema",),
    "planner.described": ("errors", "schema", "spatial", "bridge", "catalog", "description"),
    "planner.bridge": ("errors", "spatial", "actuation", "couplings", "description", "shapes"),
    "planner.fingers": ("errors", "spatial", "bridge", "couplings", "description", "proximity"),
    "planner.mount": ("errors", "spatial", "bridge", "description", "schema"),
    "planner.ik": ("errors", "spatial", "hand", "mount"),
    "planner.hand_model": (
        "errors",
        "spatial",
        "actuation",
        "bridge",
        "couplings",
        "description",
        "fingers",
        "mount",
    ),
    "planner.hand": (
        "errors",
        "spatial",
        "bridge",
        "catalog",
        "couplings",
        "described",
        "description",
        "fingers",
        "hand_model",
        "mount",
    ),
    "planner.describe": (
        "errors",
        "spatial",
        "bridge",
        "catalog",
        "couplings",
        "description",
        "hand",
        "kinematics",
        "plain",
        "proximity",
        "shapes",
    ),
    "planner.proximity": ("errors", "spatial", "shapes"),
    "planner.mesh_depth": ("spatial",),
    "planner.mesh_proximity": ("spatial", "mesh_depth", "proximity"),
    "planner.geometry_pairs": ("spatial", "proximity"),
    "planner.mesh_pairs": ("spatial", "mesh_proximity"),
    "planner.clearances": ("spatial",),
    "planner.sweep": ("spatial", "geometry_pairs", "hand", "mesh_pairs", "shapes"),
    "planner.layout": (
        "errors",
        "spatial",
        "hand",
        "mesh_proximity",
        "proximity",
        "shapes",
        "task",
    ),
    "planner.resting": ("spatial", "layout", "shapes", "task"),
    "planner.collision": (
        "errors",
        "spatial",
        "geometry_pairs",
        "kinematics",
        "clearances",
        "layout",
        "mesh_pairs",
        "mesh_proximity",
        "proximity",
        "shapes",
        "sweep",
        "task",
    ),
    "planner.kinematics": ("arrays", "errors", "spatial", "hand"),
    "planner.symbolic": ("errors", "spatial", "hand", "kinematics"),
    "planner.certify": (
        "arrays",
        "errors",
        "spatial",
        "actuation",
        "contacts",
        "forces",
        "kinematics",
        "plan",
        "programme",
        "quality",
        "shapes",
    ),
    "planner.measures": (
        "arrays",
        "errors",
        "spatial",
        "contacts",
        "hand",
        "kinematics",
        "plan",
        "quality",
        "synthesis",
    ),
    "planner.fixed": ("spatial",),
    "planner.task": (
        "arrays",
        "errors",
        "fixed",
        "forces",
        "spatial",
        "contacts",
        "hand",
        "objects",
        "shapes",
    ),
    "planner.motion": (
        "tolerances",
        "errors",
        "fixed",
        "spatial",
        "attempt",
        "collision",
        "contacts",
        "forces",
        "hand",
        "judge",
        "kinematics",
        "plan",
        "quality",
        "resting",
        "shapes",
        "stages",
        "symbolic",
        "synthesis",
        "task",
        "threads",
    ),
    "planner.gait": (
        "tolerances",
        "errors",
        "fixed",
        "spatial",
        "attempt",
        "collision",
        "contacts",
        "hand",
        "judge",
        "kinematics",
        "motion",
        "plan",
        "programme",
        "quality",
        "shapes",
        "synthesis",
        "task",
    ),
    "planner.batch": (
        "arrays",
        "environment",
        "errors",
        "spatial",
        "bridge",
        "catalog",
        "contacts",
        "described",
        "files",
        "forces",
        "hand",
        "judge",
        "kinematics",
        "objects",
        "plan",
        "quality",
        "schema",
        "search",
        "shapes",
        "synthesis",
        "task",
        "threads",
        "version",
    ),
}


@pytest.mark.parametrize("room", ALLOWED)
def test_a_room_knows_only_the_rooms_below(room: str) -> None:
    modules = [m for m in sources() if within(m, room)]
    assert modules, f"{room} has gone: bring this table up to date"
    allowed = (room, *(f"planner.{name}" for name in ALLOWED[room]))
    for module in modules:
        strangers = {
            name for name in neighbours(module) if not any(within(name, above) for above in allowed)
        }
        assert not strangers, f"{module} imports {sorted(strangers)}"


@pytest.mark.parametrize("room", ["planner.contacts", "planner.quality", "planner.forces"])
def test_grasp_analysis_reaches_neither_hand_nor_engine(room: str) -> None:
    # directly or through any other module: contacts alone must be enough
    forbidden = ("planner.hand", "planner.bridge", "planner.kinematics", "planner.task")
    for module in [m for m in sources() if within(m, room)]:
        everything = {module} | reached(module)
        assert not {m for m in everything for f in forbidden if within(m, f)}
        # casadi is the way to solvers of small programmes there, and nothing else
        known = everything - {"planner.programme"}
        engines = {i for m in known for i in imports_of(m) if i in ("mujoco", "coal", "casadi")}
        assert not engines


def test_tolerances_are_defined_on_their_page_alone() -> None:
    page = set(public_names("planner.tolerances") or ())
    assert page
    for module, path in sources().items():
        if module == "planner.tolerances":
            continue
        tree = ast.parse(path.read_text(encoding="utf-8"))
        targets = [t for node in tree.body if isinstance(node, ast.Assign) for t in node.targets]
        own = {t.id for t in targets if isinstance(t, ast.Name)}
        assert not own & page, f"{module} defines {sorted(own & page)} again"


def test_synthesis_does_not_know_who_uses_it() -> None:
    above = ("planner.plan", "planner.search", "planner.files")
    for module in [m for m in sources() if within(m, "planner.synthesis")]:
        assert not {m for m in reached(module) for a in above if within(m, a)}, module


def test_there_are_no_import_cycles() -> None:
    cycles = [m for m in sources() if m not in PACKAGES and m in reached(m)]
    assert not cycles
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


def public_names(module: str) -> list[str] | None:
    """``__all__`` as it is written, or None."""
    for node in ast.parse(sources()[module].read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            names = ast.literal_eval(node.value)
            assert isinstance(names, list)
            return names
    return None


@pytest.mark.parametrize("module", [m for m in sources() if public_names(m) is not None])
def test_public_names_are_sorted_and_resolve(module: str) -> None:
    names = public_names(module)
    assert names == sorted(set(names or ()), key=sort_key)
    loaded = importlib.import_module(module)
    assert [n for n in names or () if not hasattr(loaded, n)] == []


def test_every_package_with_contents_says_what_is_public() -> None:
    for module, path in sources().items():
        if path.name == "__init__.py" and imports_of(module):
            assert public_names(module), f"{module} re-exports without __all__"
