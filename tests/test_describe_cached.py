"""Proposals cached on disk: the same to the last bit, made anew when their inputs change."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from test_describe import claw, written

from planner.describe import propose, proposed_description
from planner.errors import HandError, ModelError, NotFoundError
from planner.hand_loading import load_hand
from planner.joints.description import HandDescription
from planner.system.disk_cache import CACHE_VARIABLE, write_text

cached = import_module("planner.describe.propose")  # a function of the package has its name

pytestmark = pytest.mark.usefixtures("brief_postures")

MODEL = """
<mujoco model="thing">
  <compiler meshdir="meshes"/>
  <asset><mesh name="tip" file="tip.stl"/></asset>
  <include file="more.xml"/>
  <worldbody><body name="palm"><geom type="mesh" mesh="tip"/></body></worldbody>
</mujoco>"""

MORE = '<mujoco><option timestep="{}"/></mujoco>'


@pytest.fixture
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "cache"
    monkeypatch.setenv(CACHE_VARIABLE, str(folder))
    return folder


def described(normal: tuple[float, float, float] = (0.6, 0.0, 0.8)) -> HandDescription:
    """A description whose direction is none that validation makes."""
    valid = HandDescription(
        schema=1, name="thing", model="", base_body="palm", palm_body="palm", palm_normal=(0, 0, 1)
    )
    return valid.model_copy(update={"palm_normal": normal})


@pytest.fixture
def calls(own_cache: Path, monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Models for which a (quick) proposal was made."""
    made: list[Path] = []

    class Made:
        def __init__(self, model: Path) -> None:
            made.append(model)
            self.description = described().model_copy(update={"model": str(model)})

    monkeypatch.setattr(cached, "propose", Made)
    return made


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """A model with a mesh and an included file."""
    return thing(tmp_path / "thing")


def thing(folder: Path) -> Path:
    (folder / "meshes").mkdir(parents=True)
    trimesh.creation.box((0.02, 0.02, 0.02)).export(folder / "meshes" / "tip.stl")
    (folder / "more.xml").write_text(MORE.format(0.002), encoding="utf-8")
    path = folder / "thing.xml"
    path.write_text(MODEL, encoding="utf-8")
    return path


@pytest.mark.slow
def test_a_kept_proposal_is_the_same_to_the_last_bit(
    own_cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = written(tmp_path, claw())
    fresh = propose(model).description
    first = load_hand(model)
    (stored,) = (own_cache / "proposal").iterdir()

    def never(*_: object) -> None:
        raise AssertionError("proposed again")

    monkeypatch.setattr(cached, "propose", never)
    again = load_hand(model)
    assert repr(again.description) == repr(first.description) == repr(fresh)
    assert again.description == fresh
    assert again.digest == first.digest
    assert stored.is_file()
    for name, finger in first.fingers.items():
        np.testing.assert_array_equal(again.fingers[name].pad.axis, finger.pad.axis)
    np.testing.assert_array_equal(again.posture("pinch"), first.posture("pinch"))


NUMBERS = st.floats(-1e12, 1e12)  # what a file may hold


@settings(max_examples=200, deadline=None)
@given(normal=st.tuples(NUMBERS, NUMBERS, NUMBERS), angle=NUMBERS)
def test_text_and_back_changes_no_bit(normal: tuple[float, float, float], angle: float) -> None:
    given = described(normal).model_copy(update={"postures": {"open": {"joint": angle}}})
    assert repr(HandDescription.from_json(given.to_json())) == repr(given)


def test_a_description_that_is_read_otherwise_still_gets_unit_directions() -> None:
    read = HandDescription.model_validate_json(described((0.0, 3.0, 4.0)).to_json())
    assert read.palm_normal == (0.0, 0.6, 0.8)


def test_it_is_made_once(model: Path, calls: list[Path]) -> None:
    first = proposed_description(model)
    assert proposed_description(str(model)) == first
    assert len(calls) == 1


def test_a_copy_elsewhere_needs_none_and_has_its_own_path(
    model: Path, calls: list[Path], tmp_path: Path
) -> None:
    proposed_description(model)
    other = thing(tmp_path / "elsewhere")
    assert proposed_description(other).model == str(other)
    assert len(calls) == 1


@pytest.mark.parametrize("changed", ["model", "include", "mesh", "name", "code"])
def test_whatever_it_follows_from_makes_it_anew(
    changed: str, model: Path, calls: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    proposed_description(model)
    if changed == "model":
        model.write_text(MODEL.replace("palm", "hand"), encoding="utf-8")
    elif changed == "include":
        (model.parent / "more.xml").write_text(MORE.format(0.001), encoding="utf-8")
    elif changed == "mesh":
        trimesh.creation.box((0.03, 0.02, 0.02)).export(model.parent / "meshes" / "tip.stl")
    elif changed == "name":
        model = model.rename(model.with_name("other.xml"))  # the hand is called after it
    else:
        monkeypatch.setattr(cached, "_made_with", lambda: b"other code")
    proposed_description(model)
    assert len(calls) == 2


def test_the_code_that_counts_is_all_of_the_planner(monkeypatch: pytest.MonkeyPatch) -> None:
    before = cached._made_with.__wrapped__()
    monkeypatch.setattr(cached, "_version", lambda name: f"another {name}")
    other_versions = cached._made_with.__wrapped__()
    read = Path.read_bytes

    def edited(path: Path) -> bytes:
        return read(path) + (b"#" if path.name == "postures.py" else b"")

    monkeypatch.setattr(Path, "read_bytes", edited)
    assert len({before, other_versions, cached._made_with.__wrapped__()}) == 3


def test_a_model_whose_files_are_not_all_found_is_not_kept(model: Path, calls: list[Path]) -> None:
    (model.parent / "meshes" / "tip.stl").unlink()
    proposed_description(model)
    proposed_description(model)
    assert len(calls) == 2


@pytest.mark.parametrize("damage", ["cut", "bit", "text", "empty", "other text", "folder"])
def test_a_damaged_file_is_made_anew(
    damage: str, model: Path, calls: list[Path], own_cache: Path
) -> None:
    first = proposed_description(model)
    (stored,) = (own_cache / "proposal").iterdir()
    content = stored.read_bytes()
    if damage == "cut":
        stored.write_bytes(content[:-50])
    elif damage == "bit":
        at = content.index(b"0.6")  # of the palm's normal; it would still be a description
        stored.write_bytes(content[:at] + b"0.7" + content[at + 3 :])
    elif damage == "text":
        stored.write_text("no arrays")
    elif damage == "empty":
        stored.write_bytes(b"")
    elif damage == "other text":
        write_text("proposal", stored.stem, '{"schema": 1}')
    else:
        stored.unlink()
        stored.mkdir()
    assert proposed_description(model) == first
    assert len(calls) == 2
    if damage != "folder":
        proposed_description(model)
        assert len(calls) == 2
    assert not list(own_cache.rglob("*.part"))


def test_errors_are_those_of_propose(own_cache: Path, tmp_path: Path) -> None:
    with pytest.raises(NotFoundError, match=r"^nothing\.xml does not exist; give a hand\.toml"):
        proposed_description("nothing.xml")
    with pytest.raises(HandError, match="is a description already"):
        proposed_description("allegro_hand")
    broken = tmp_path / "broken.xml"
    broken.write_text("<mujoco", encoding="utf-8")
    with pytest.raises(ModelError, match=r"MuJoCo cannot read .*broken\.xml"):
        proposed_description(broken)
    assert not own_cache.exists()
