"""One registry for all kinds of things: names, refusals, and what other packages bring."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from planner.errors import ModelError, NotFoundError, TaskError
from planner.hands.catalog import FOREIGN_HANDS, find_hand, foreign_hand_names, hand_reference
from planner.objects import parse_object
from planner.registry import Registry, forget_plugins
from planner.shapes import SIZED_SHAPES

PACKAGE = "somebodys_things"


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A package outside the tree that brings a shape and a hand, as pip leaves it."""
    (tmp_path / f"{PACKAGE}.py").write_text(
        "from pathlib import Path\n"
        "from dataclasses import dataclass\n"
        "from planner.shapes import Sphere\n"
        "@dataclass(frozen=True)\n"
        "class Marble(Sphere):\n"
        "    kind = 'marble'\n"
        "    default_sizes = (0.02,)\n"
        "CLAW = Path(__file__).with_name('claw.xml')\n"
    )
    (tmp_path / "claw.xml").write_text("<mujoco/>")
    meta = tmp_path / f"{PACKAGE}-1.0.dist-info"
    meta.mkdir()
    (meta / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {PACKAGE}\nVersion: 1.0\n")
    (meta / "entry_points.txt").write_text(
        f"[opposable.shapes]\nmarble = {PACKAGE}:Marble\n"
        f"[opposable.hands]\nsomebodys_claw = {PACKAGE}:CLAW\n"
        f"[opposable.broken]\nnothing = {PACKAGE}:Nothing\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    registries: tuple[Registry[object], ...] = (SIZED_SHAPES, FOREIGN_HANDS)  # type: ignore
    for registry in registries:
        monkeypatch.setattr(registry, "_known", dict(registry._known))
    forget_plugins()
    yield tmp_path
    sys.modules.pop(PACKAGE, None)
    forget_plugins()


def test_an_installed_package_brings_a_shape_and_a_hand(installed: Path) -> None:
    assert "marble" in SIZED_SHAPES and PACKAGE not in sys.modules
    item = parse_object("marble:0.01")
    assert item.shape.sizes == (0.01,) and item.name == "marble"
    assert find_hand("somebodys_claw") == installed / "claw.xml"
    assert "somebodys_claw" in foreign_hand_names()
    assert hand_reference("somebodys_claw") == "somebodys_claw"


def test_an_entry_point_that_cannot_be_loaded_is_named(installed: Path) -> None:
    broken: Registry[object] = Registry("thing", group="broken")
    with pytest.raises(ModelError, match=r"brings 'nothing' as .*:Nothing for opposable.broken"):
        broken.named("nothing")
    assert list(broken) == ["nothing"]  # listing imports nothing


def test_a_name_is_taken_once_and_told_where_it_is_missing() -> None:
    things: Registry[object] = Registry("thing")
    one = object()
    assert things.add("one", one) is one is things.add("one", one)
    with pytest.raises(TaskError, match="thing 'one' is there already; choose another name"):
        things.add("one", object())
    with pytest.raises(NotFoundError, match=r"no thing is called 'on'\. Did you mean 'one'"):
        things.named("on")
    assert list(things) == ["one"] and len(things) == 1 and "two" not in things


def test_what_is_ours_is_imported_when_it_is_asked_for() -> None:
    things: Registry[float] = Registry("thing")
    things.add_homes({"far": "no_such_module:thing", "near": "math:pi"})
    assert list(things) == ["far", "near"] and "far" in things and len(things) == 2
    assert things["near"] is math.pi and things.named("near") is math.pi
    with pytest.raises(ModuleNotFoundError, match="no_such_module"):
        things["far"]
    with pytest.raises(TaskError, match="near"):
        things.add("near", 3.0)
    with pytest.raises(TaskError, match="near is there already"):
        things.add_homes({"near": "math:e"})
    assert things["near"] is math.pi


def test_our_kinds_of_shapes_are_called_as_their_classes_say() -> None:
    for name, shape in SIZED_SHAPES.items():
        assert shape.kind == name
        assert shape.from_sizes(shape.default_sizes).sizes == shape.default_sizes
