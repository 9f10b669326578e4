"""What a user imports: every public name resolves, and light parts stay light."""

from __future__ import annotations

import subprocess
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest

ENGINES = ("casadi", "coal", "mujoco", "pinocchio")
MOST_OURS, MOST_MODULES = 25, 300
"""Modules that bare contacts load, ours and all, which is what it costs: 13 and 205 were counted,
89 of them NumPy's."""


@pytest.mark.parametrize("package", ["planner", "sim"])
def test_every_public_name_resolves_and_no_submodule_has_it(package: str) -> None:
    module = import_module(package)
    assert module.__all__
    assert set(module.__all__) - {"__version__"} == set(module._HOMES)
    assert set(module.__all__) <= set(dir(module))
    for name, home in module._HOMES.items():
        assert getattr(module, name) is getattr(import_module(home), name)
        assert find_spec(f"{package}.{name}") is None, f"{package}.{name} is a module too"


def test_one_module_has_the_names_of_both_packages() -> None:
    """``opposable.py`` re-exports them; the wheel has it too (tests/test_wheel.py)."""
    import opposable as both
    import planner
    import sim

    names: dict[str, object] = {}
    exec("from opposable import *", names)
    wanted = {*planner.__all__, *sim.__all__}
    assert wanted <= set(names) and wanted <= set(dir(both))
    assert names["plan_grasp"] is planner.plan_grasp and names["simulate"] is sim.simulate
    assert set(planner.__all__) & set(sim.__all__) == set()


@pytest.mark.parametrize("package", ["planner", "sim", "opposable"])
def test_a_name_that_is_not_public_is_an_attribute_error(package: str) -> None:
    with pytest.raises(AttributeError, match="no attribute 'graspe'"):
        _ = import_module(package).graspe


@pytest.mark.parametrize("package", ["planner", "sim"])
def test_type_information_ships(package: str) -> None:
    origin = import_module(package).__file__
    assert origin is not None
    assert (Path(origin).parent / "py.typed").is_file()


def loaded_by(code: str) -> set[str]:
    """Modules that a fresh interpreter has loaded after some code."""
    lines = ["import sys", code, "print(*sys.modules)"]
    run = subprocess.run(
        [sys.executable, "-c", "\n".join(lines)], capture_output=True, text=True, check=True
    )
    return set(run.stdout.splitlines()[-1].split())


@pytest.mark.parametrize(
    "code",
    [
        "from planner.contacts import ContactSet",
        "from planner import ContactSet",
        "import planner.quality",
        "import planner.forces",
        "import planner, sim",
    ],
)
def test_contacts_quality_and_forces_load_without_an_engine(code: str) -> None:
    engines = loaded_by(code) & set(ENGINES)
    assert engines == set()


def test_contacts_on_bare_arrays_need_no_engine_and_load_quickly() -> None:
    code = """
from planner import ContactSet
contacts = ContactSet.from_arrays([[0, 0, 0.1], [0, 0, -0.1]], [[0, 0, -1], [0, 0, 1]], mu=0.5)
assert len(contacts) == 2
"""
    loaded = loaded_by(code)
    assert not loaded & set(ENGINES)
    assert len(loaded) < MOST_MODULES, len(loaded)
    ours = [name for name in loaded if name.partition(".")[0] in ("planner", "sim")]
    assert len(ours) < MOST_OURS, len(ours)
