"""Finding hands by name and path, and what a faulty description or model is answered."""

from __future__ import annotations

import json
import pickle
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from test_describe import claw, written

from planner import GraspTask, plan_grasp
from planner.batch.recipe import recipe_of, task_of
from planner.errors import HandError, ModelError, NotFoundError, PlannerError
from planner.files import plan_from_dict, plan_to_dict
from planner.hand_loading import load_hand
from planner.hands import catalog
from planner.hands.catalog import find_hand, hand_names, hand_reference, model_file
from planner.hands.hand import Hand
from planner.system.package import models_dir

EditHand = Callable[..., Path]

INDEX_PAD = 'geom = "index_pad"'


# --- finding --------------------------------------------------------------------------------------


def test_both_right_hands_are_there() -> None:
    assert {"allegro_hand", "shadow_hand"} <= set(hand_names())
    assert list(hand_names()) == sorted(hand_names())


@pytest.mark.parametrize("name", hand_names())
def test_every_hand_is_named_after_its_folder_and_describes_itself(name: str) -> None:
    hand = load_hand(name)
    assert hand.name == name
    assert hand.path == models_dir() / "hands" / name / "hand.toml"
    assert hand.description.summary
    assert hand.description.source
    assert {"open", "pinch"} <= set(hand.description.postures)


def test_hands_are_found_from_a_foreign_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = hand_names()
    monkeypatch.chdir(tmp_path)
    assert hand_names() == before
    assert load_hand("allegro_hand").nq == 16


def test_a_folder_of_the_same_name_does_not_hide_a_hand(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "allegro_hand").mkdir()
    monkeypatch.chdir(tmp_path)
    assert find_hand("allegro_hand") == models_dir() / "hands" / "allegro_hand" / "hand.toml"


def test_a_hand_is_found_by_file_by_folder_and_by_relative_path(
    edit_hand: EditHand, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = edit_hand()
    monkeypatch.chdir(file.parent.parent)
    folder = Path(file.parent.name)
    for given in (file, str(file), file.parent, folder, folder / "hand.toml"):
        assert find_hand(given).resolve() == file.resolve()
        assert load_hand(given).name == "allegro_hand"


@pytest.mark.parametrize(
    ("given", "nearest"),
    [
        ("shadow", "shadow_hand"),
        ("shadowhand", "shadow_hand"),
        ("alegro_hand", "allegro_hand"),
        ("allegro-hand", "allegro_hand"),
    ],
)
def test_a_misspelt_hand_is_answered_with_the_nearest_name(given: str, nearest: str) -> None:
    with pytest.raises(NotFoundError, match=f"no hand is called '{given}'") as caught:
        load_hand(given)
    assert f"Did you mean {nearest!r}?" in str(caught.value)
    assert "There is: allegro_hand, " in str(caught.value)
    assert "Or give the path of a hand.toml" in str(caught.value)
    assert caught.value.available == hand_names()


def test_a_long_list_is_left_out_where_a_name_is_near() -> None:
    names = [f"joint_{k}" for k in range(60)]
    assert str(NotFoundError("joint", "joint_7x", names, "Mend it.")).endswith("? Mend it.")
    assert "There is: joint_0, " in str(NotFoundError("joint", "zzz", names))


def test_an_error_of_a_path_can_be_sent_to_another_process() -> None:
    error = NotFoundError("hand", "a/b.xml", ["c"], "give another", is_path=True)
    again = pickle.loads(pickle.dumps(error))
    assert str(again) == str(error) == "a/b.xml does not exist; give another"
    assert again.available == ("c",)


def test_a_name_like_none_of_them_gets_the_list_and_no_guess() -> None:
    with pytest.raises(NotFoundError) as caught:
        load_hand("zzz")
    assert "Did you mean" not in str(caught.value)
    assert "shadow_hand" in str(caught.value)


@pytest.mark.parametrize("given", ["somewhere/hand.toml", "hand.toml", "a/b"])
def test_a_path_that_does_not_exist_is_called_a_path(
    given: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(NotFoundError, match=f"^{re.escape(given)} does not exist; give a hand"):
        load_hand(given)


@pytest.mark.parametrize("given", ["", "a" * 400, "a\0b", "hand.toml/" + "a" * 400])
def test_a_name_that_no_file_can_have(given: str) -> None:
    with pytest.raises(NotFoundError, match=r"no hand is called |does not exist; give"):
        load_hand(given)


def test_an_empty_folder_is_no_hand(tmp_path: Path) -> None:
    with pytest.raises(NotFoundError, match=r"hand\.toml does not exist; give a hand\.toml"):
        load_hand(tmp_path)


def test_a_model_file_is_found_as_itself(edit_hand: EditHand) -> None:
    model = edit_hand().parent / "allegro_hand.xml"
    assert find_hand(model) == model
    assert hand_reference(model) == str(model)


@pytest.mark.slow
@pytest.mark.usefixtures("brief_postures")
def test_a_model_file_is_a_hand_by_its_structure_wherever_it_lies(tmp_path: Path) -> None:
    model = written(tmp_path, claw())
    hand = load_hand(model)
    assert (hand.nq, len(hand.fingers), hand.path) == (6, 3, model)
    assert hand.reference == str(model)
    (tmp_path / "moved").mkdir()
    moved = shutil.copy(model, tmp_path / "moved")
    assert load_hand(moved).digest == hand.digest
    Path(moved).write_text(claw().replace('mass="0.02"', 'mass="0.021"'))
    assert load_hand(moved).digest != hand.digest


def test_what_is_neither_description_nor_model_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "hand.stl"
    path.write_text("solid", encoding="utf-8")
    with pytest.raises(ModelError, match=r"hand\.stl is neither a hand description nor a model; "):
        load_hand(path)


# --- hands of others ------------------------------------------------------------------------------


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An importable package ``tiny_hands`` that holds one file, ``arm/hand.xml``."""
    folder = tmp_path / "site" / "tiny_hands"
    (folder / "arm").mkdir(parents=True)
    (folder / "arm" / "hand.xml").write_text("<mujoco/>", encoding="utf-8")
    monkeypatch.syspath_prepend(folder.parent)
    return folder


def test_a_file_in_a_package_is_found(package: Path) -> None:
    expected = package / "arm" / "hand.xml"
    assert find_hand("package:tiny_hands/arm/hand.xml") == expected
    assert model_file("package:tiny_hands/arm/hand.xml", Path("elsewhere")) == expected
    assert hand_reference("package:tiny_hands/arm/hand.xml") == "package:tiny_hands/arm/hand.xml"


def test_a_share_of_a_wheel_without_modules_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # example-robot-data is such a wheel: no module, data beside the modules of others
    (tmp_path / "data_only-1.0.dist-info").mkdir()
    (tmp_path / "data_only-1.0.dist-info" / "METADATA").write_text(
        "Name: data-only\nVersion: 1.0\n"
    )
    model = tmp_path / "cmeel.prefix" / "share" / "data-only" / "hand.urdf"
    model.parent.mkdir(parents=True)
    model.write_text("<robot/>")
    monkeypatch.syspath_prepend(tmp_path)
    assert find_hand("package:data-only/hand.urdf") == model


@pytest.mark.parametrize("inside", ["gone.xml", "", "arm", "../hand.xml"])
def test_a_file_that_a_package_lacks(package: Path, inside: str) -> None:
    with pytest.raises(ModelError, match=r"package 'tiny_hands' has no file .*correct the path"):
        find_hand(f"package:tiny_hands/{inside}")


@pytest.mark.parametrize(
    ("name", "said"),
    [
        (
            "nowhere_hands",
            r"is not installed, and .* none .* knows .*example-robot-data.* the path",
        ),
        ("os", "a module of Python itself"),
        *((odd, "is not the name of a package; give") for odd in ("no.where", "", "..", "os path")),
    ],
)
def test_a_package_that_is_missing(name: str, said: str) -> None:
    """The name may come out of a file: no command that would install whatever is called so."""
    with pytest.raises(ModelError, match=said) as told:
        find_hand(f"package:{name}/hand.xml")
    assert "pip install" not in str(told.value)


def test_a_known_hand_of_a_missing_package_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(catalog._KNOWN, "nowhere-hands:one", "package:nowhere_hands/one.xml")
    monkeypatch.setitem(
        catalog.FOREIGN_HANDS, "nowhere-hands:one", catalog._KNOWN["nowhere-hands:one"]
    )
    for given in ("nowhere-hands:one", "nowhere_hands:one"):
        with pytest.raises(ModelError, match=r"'nowhere_hands' is not installed; install it, "):
            load_hand(given)


def test_an_unknown_hand_of_a_package_is_answered_with_the_nearest() -> None:
    with pytest.raises(NotFoundError, match="Did you mean 'robosuite:inspire_right'"):
        load_hand("robosuite:inspire_rigth")


def test_a_reference_is_a_name_or_an_absolute_path(
    edit_hand: EditHand, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = edit_hand()
    monkeypatch.chdir(file.parent)
    assert load_hand("hand.toml").reference == str(file)
    assert load_hand("shadow_hand").reference == "shadow_hand"
    assert hand_reference("menagerie:shadow_hand") == "menagerie:shadow_hand"
    monkeypatch.chdir("/")
    assert load_hand(str(file)).digest == load_hand(load_hand(file).reference or "").digest


class _Robot:
    """What ``mujoco_menagerie`` says of a model, offline."""

    name, default_model, entry_names = "claw", "claw", ("claw", "scene")

    def xml(self, entry: str) -> Path:
        if entry == "scene":
            raise OSError("no network")
        return Path("/cache/claw.xml")


@pytest.fixture
def menagerie(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stand-in for the package ``mujoco_menagerie``."""
    module = ModuleType("mujoco_menagerie")
    module.__spec__ = ModuleSpec("mujoco_menagerie", None)
    for name, value in {
        "names": lambda: ["claw", "dog"],
        "get": lambda name: _Robot(),
        "robots": lambda category: [_Robot()],
        "MenagerieError": KeyError,
        "Cache": lambda: SimpleNamespace(root=None, is_cached=lambda robot: False),
    }.items():
        setattr(module, name, value)
    monkeypatch.setitem(sys.modules, "mujoco_menagerie", module)


@pytest.mark.usefixtures("menagerie")
def test_a_model_of_menagerie_is_found_by_name_and_entry() -> None:
    assert (
        find_hand("menagerie:claw") == find_hand("menagerie:claw/claw") == Path("/cache/claw.xml")
    )
    with pytest.raises(ModelError, match=r"no network.*mujoco_menagerie prefetch claw where there"):
        find_hand("menagerie:claw/scene")
    with pytest.raises(NotFoundError, match=r"no model of MuJoCo Menagerie .*There is: claw\."):
        find_hand("menagerie:clwa")
    with pytest.raises(NotFoundError, match="no entry of menagerie:claw is called 'left'"):
        find_hand("menagerie:claw/left")


@pytest.mark.usefixtures("menagerie")
def test_what_a_file_names_is_not_downloaded_from_menagerie(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pytest.raises(ModelError, match=r"downloads nothing; .* mujoco_menagerie prefetch claw"):
        find_hand("menagerie:claw", download=False)
    cache = SimpleNamespace(root=None, is_cached=lambda robot: True)
    monkeypatch.setattr(sys.modules["mujoco_menagerie"], "Cache", lambda: cache)
    assert find_hand("menagerie:claw", download=False) == Path("/cache/claw.xml")


@pytest.mark.parametrize(
    ("source", "package"),
    [("menagerie", "mujoco_menagerie"), ("robot_descriptions", "robot_descriptions")],
)
def test_a_collection_that_is_not_installed(
    source: str, package: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ModelError, match=f"{source}:claw needs .*not installed; pip install "):
        find_hand(f"{source}:claw")


class _GitError(Exception):
    pass


@pytest.fixture
def robot_descriptions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A stand-in for the packages ``robot_descriptions`` and ``git``."""
    folder = tmp_path / "robot_descriptions"
    folder.mkdir()
    for name, text in {
        "__init__": "",
        "_descriptions": (
            "class _D:\n    tags = {'end_effector'}\n"
            "DESCRIPTIONS = {n + '_description': _D for n in ('claw_mj', 'arm', 'far', 'srdf')}"
        ),
        "claw_mj_description": "MJCF_PATH = '/cache/claw.xml'",
        "arm_description": "URDF_PATH = '/cache/arm.urdf'",
        "far_description": "import git\nraise git.exc.GitError('could not resolve host')",
        "srdf_description": "SRDF_PATH = '/cache/arm.srdf'",
    }.items():
        (folder / f"{name}.py").write_text(text, encoding="utf-8")
    git = ModuleType("git")
    git.exc = SimpleNamespace(GitError=_GitError)  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "git", git)
    monkeypatch.syspath_prepend(tmp_path)
    for name in [n for n in sys.modules if n.partition(".")[0] == "robot_descriptions"]:
        monkeypatch.delitem(sys.modules, name)
    return folder


@pytest.mark.usefixtures("robot_descriptions")
def test_a_model_of_robot_descriptions_is_found_by_name() -> None:
    assert find_hand("robot_descriptions:claw_mj") == Path("/cache/claw.xml")
    assert find_hand("robot_descriptions:arm_description") == Path("/cache/arm.urdf")
    with pytest.raises(ModelError, match=r"could not resolve host.*pull far_description where"):
        find_hand("robot_descriptions:far")
    with pytest.raises(ModelError, match="names neither an MJCF nor a URDF file"):
        find_hand("robot_descriptions:srdf")
    with pytest.raises(NotFoundError, match=r"called 'clwa_mj'\. Did you mean 'claw_mj'"):
        find_hand("robot_descriptions:clwa_mj")


@pytest.mark.skipif(shutil.which("git") is None, reason="git is asked to clone")
def test_what_a_file_names_is_not_cloned(robot_descriptions: Path, tmp_path: Path) -> None:
    source, target = tmp_path / "source", tmp_path / "clone"
    subprocess.run(["git", "init", "-q", "--bare", source], check=True)
    command = ["git", "clone", "-q", f"file://{source}", str(target)]
    program = f"""
import git, subprocess
if subprocess.run({command!r}, capture_output=True).returncode != 0:
    raise git.exc.GitError("transport not allowed")
MJCF_PATH = "/cache/far.xml"
"""
    (robot_descriptions / "far_description.py").write_text(program, encoding="utf-8")
    with pytest.raises(ModelError, match=r"downloads nothing; .* pull far_description first"):
        find_hand("robot_descriptions:far", download=False)
    assert not target.exists()
    assert find_hand("robot_descriptions:claw_mj", download=False) == Path("/cache/claw.xml")
    assert find_hand("robot_descriptions:far") == Path("/cache/far.xml")
    assert target.exists()


def test_readers_of_files_download_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    plan = plan_grasp(GraspTask.create("allegro_hand", "sphere"), seed=0)
    data, recipe = plan_to_dict(plan), json.loads(recipe_of(plan.task))
    data["task"]["hand"]["description_path"] = "robot_descriptions:far"
    recipe["task"]["hand"]["description_path"] = "menagerie:claw"
    asked = []

    def asks(name: str, *, download: bool = True) -> Path:
        asked.append((name, download))
        raise ModelError("asked")

    monkeypatch.setattr("planner.hand_loading.find_hand", asks)
    with pytest.raises(ModelError, match="asked"):
        plan_from_dict(data, "plan.json")
    with pytest.raises(ModelError, match="asked"):
        task_of(json.dumps(recipe))
    assert asked == [("robot_descriptions:far", False), ("menagerie:claw", False)]


@pytest.mark.usefixtures("robot_descriptions")
def test_robot_descriptions_without_git(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "git", None)
    with pytest.raises(ModelError, match=r"cloned with git, which is missing .*install git and"):
        find_hand("robot_descriptions:claw_mj")


# --- the description ------------------------------------------------------------------------------


def test_what_is_not_toml_is_refused(tmp_path: Path) -> None:
    for text in ("{not toml", "<mujoco/>", "schema = "):
        path = tmp_path / "hand.toml"
        path.write_text(text, encoding="utf-8")
        with pytest.raises(HandError, match=r"hand\.toml is not a TOML file: \S"):
            load_hand(path)


def test_bytes_that_are_not_text_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "hand.toml"
    path.write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(HandError, match="is not a TOML file"):
        load_hand(path)


@pytest.mark.parametrize(
    ("toml", "fault"),
    [
        ({"schema = 1": "schema = 1\ncolour = 3"}, r"colour is no field"),
        ({'palm_body = "palm"\n': ""}, r"palm_body is missing"),
        ({"schema = 1\n": "schema = 2\n"}, r"schema is 2; it should be 1"),
        ({INDEX_PAD: INDEX_PAD + "\nsoft = true"}, r"fingers\[index\]\.pad\.soft is no field"),
        ({INDEX_PAD + "\n": ""}, r"fingers\[index\]\.pad\.geom is missing"),
        (
            {"radius = 0.012": "radius = -0.012"},
            r"pad\.radius is -0\.012; it should be greater",
        ),
        ({"radius = 0.012": "radius = nan"}, r"fingers\[thumb\]\.pad\.radius is nan"),
        (
            {"radius = 0.012": "radius = 12.0"},
            r"pad\.radius is 12\.0; .*less than 0\.1",
        ),
        (
            {"half_angle_deg = 45.0": "half_angle_deg = 120.0"},
            r"deg is 120\.0; .*equal to 90",
        ),
        (
            {"[0.0, 0.0, 0.0423]": "[0.0, nan, 0.0]"},
            r"\[thumb\]\.pad\.center\.1 is nan; ",
        ),
        ({"[0.0, 0.0, 0.0423]": "[0.0, 0.0]"}, r"fingers\[thumb\]\.pad\.center\.2 is missing"),
        ({"[1.0, 0.0, 0.0]": "[0.0, 0.0, 0.0]"}, r"palm_normal: .*needs a length; give a unit"),
        ({"index_1 = 0.6\n": "index_1 = inf\n"}, r"postures\.open\.index_1 is inf; .*finite"),
        (
            {"index_1 = 0.6\n": 'index_1 = "wide"\n'},
            r"postures\.open\.index_1 is 'wide'; it should be a number",
        ),
    ],
)
def test_a_faulty_field_is_named(edit_hand: EditHand, toml: dict[str, str], fault: str) -> None:
    with pytest.raises(HandError, match=r"hand\.toml does not describe a hand: .*" + fault):
        load_hand(edit_hand(toml))


def test_every_fault_of_a_description_is_told_at_once(edit_hand: EditHand) -> None:
    with pytest.raises(HandError) as caught:
        load_hand(
            edit_hand({"schema = 1": "schema = 1\ncolour = 3", "radius = 0.012": "radius = 0"})
        )
    assert "colour is no field" in str(caught.value)
    assert str(caught.value).count("pad.radius is 0; it should be greater") == 4


def test_directions_are_normalised_on_reading(edit_hand: EditHand) -> None:
    hand = load_hand(edit_hand({"[1.0, 0.0, 0.0]": "[3.0, 0.0, 4.0]"}))
    np.testing.assert_allclose(hand.palm_normal, [0.6, 0.0, 0.8], rtol=0, atol=1e-15)


# --- description against model --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("toml", "kind", "given", "nearest"),
    [
        ({'tip_site = "index_tip"': 'tip_site = "index_tipp"'}, "site", "index_tipp", "index_tip"),
        ({INDEX_PAD: 'geom = "index_pads"'}, "colliding geom", "index_pads", "index_pad"),
        ({'"index_0", "index_1"': '"index_0", "index_9"'}, "joint", "index_9", "index_"),
        ({'base_body = "palm"': 'base_body = "plam"'}, "body", "plam", "palm"),
        ({'palm_body = "palm"': 'palm_body = "pal"'}, "body", "pal", "palm"),
        ({"wrist_joints = []": 'wrist_joints = ["index_7"]'}, "joint", "index_7", "index_"),
        (
            {"allowed_contacts = []": 'allowed_contacts = [["palm", "index_pat"]]'},
            "colliding geom",
            "index_pat",
            "index_pad",
        ),
        (
            {
                "[postures.open]": '[[couplings]]\nname = "c"\njoints = { index_11 = 1.0 }\n'
                'kind = "stop"\n\n[postures.open]'
            },
            "joint",
            "index_11",
            "index_",
        ),
        ({'["thumb", "index"': '["thumb", "indx"'}, "finger", "indx", "index"),
    ],
)
def test_a_name_that_the_model_does_not_have(
    edit_hand: EditHand, toml: dict[str, str], kind: str, given: str, nearest: str
) -> None:
    expected = rf"no {kind} of .*allegro_hand\.xml is called '{given}'\. Did you mean '{nearest}"
    with pytest.raises(NotFoundError, match=expected) as caught:
        load_hand(edit_hand(toml))
    assert "Correct " in str(caught.value)


def test_a_posture_of_an_unknown_joint(edit_hand: EditHand) -> None:
    with pytest.raises(NotFoundError, match="no joint of allegro_hand is called 'index_8'"):
        load_hand(edit_hand({"index_1 = 0.6\n": "index_8 = 0.6\n"}))


def test_a_posture_outside_the_joint_range(edit_hand: EditHand) -> None:
    message = (
        r"posture 'open': joint index_1 is at 2\.6000, outside its range \[-0\.1960, 1\.6100\]; "
        "bring it inside"
    )
    with pytest.raises(HandError, match=message):
        load_hand(edit_hand({"index_1 = 0.6\n": "index_1 = 2.6\n"}))


def test_a_hand_without_fingers(edit_hand: EditHand) -> None:
    file = edit_hand()
    text = file.read_text(encoding="utf-8")
    head, tail = text[: text.index("[[fingers]]")], text[text.index("[postures.open]") :]
    file.write_text(head + tail, encoding="utf-8")
    with pytest.raises(HandError, match=r"describes no finger; add at least one \[\[fingers\]\]"):
        load_hand(file)


def test_two_fingers_of_one_name(edit_hand: EditHand) -> None:
    with pytest.raises(HandError, match="two fingers of one name; rename one"):
        load_hand(edit_hand({'name = "index"': 'name = "middle"'}))


def test_a_pad_on_another_link(edit_hand: EditHand) -> None:
    for geom in ("palm", "middle_pad"):
        message = rf"pad geom '{geom}' of finger 'index' does not move with .* name a geom of its"
        with pytest.raises(HandError, match=message):
            load_hand(edit_hand({INDEX_PAD: f'geom = "{geom}"'}))


# --- the model ------------------------------------------------------------------------------------


def test_a_model_file_that_is_missing(edit_hand: EditHand) -> None:
    with pytest.raises(ModelError, match=r"no model file .*gone\.xml; give the path of an MJCF"):
        load_hand(edit_hand({'"allegro_hand.xml"': '"gone.xml"'}))


def test_a_model_that_is_broken_xml(edit_hand: EditHand) -> None:
    with pytest.raises(ModelError, match=r"MuJoCo cannot read .*allegro_hand\.xml as a model: "):
        load_hand(edit_hand(xml={"</worldbody>": ""}))


def test_a_model_that_mujoco_does_not_compile(edit_hand: EditHand) -> None:
    with pytest.raises(ModelError, match=r"MuJoCo cannot compile .*allegro_hand\.xml: .*inertia"):
        load_hand(edit_hand(xml={'mass="0.0119"': 'mass="-1"'}))


def test_a_ball_joint_is_refused(edit_hand: EditHand) -> None:
    file = edit_hand(xml={'<body name="palm">': '<body name="palm"><joint name="f" type="ball"/>'})
    message = "free or ball joints below 'palm'; a hand has hinges and slides: replace a ball joint"
    with pytest.raises(HandError, match=message):
        load_hand(file)


def test_a_floating_base_is_a_base(edit_hand: EditHand, allegro: Hand) -> None:
    hand = load_hand(
        edit_hand(xml={'<body name="palm">': '<body name="palm"><freejoint name="f"/>'})
    )
    assert hand.joint_names == allegro.joint_names


def test_a_joint_without_a_name_gets_one(edit_hand: EditHand) -> None:
    hand = load_hand(
        edit_hand(
            {
                '"index_0"': '"index_base_joint0"',
                "[postures.open]": (
                    '[[actuators]]\njoints = ["index_base_joint0"]\nkp = 3.0\nforce_limit = 0.7\n'
                    "[postures.open]"
                ),
            },
            {'<joint name="index_0"': "<joint", 'joint="index_0"': 'joint="index_1"'},
        )
    )
    assert hand.joint_names[0] == "index_base_joint0"


def test_a_colliding_geom_without_a_name_gets_one(edit_hand: EditHand) -> None:
    hand = load_hand(edit_hand(xml={'<geom name="index_proximal"': "<geom"}))
    assert "index_proximal_geom0" in {g.name for g in hand.geometries}


def test_a_plane_in_the_model(edit_hand: EditHand) -> None:
    plane = '<body name="palm"><geom name="floor" type="plane" size="1 1 1"/>'
    with pytest.raises(ModelError, match=r"'floor' is a plane, a height field or .*; use a solid"):
        load_hand(edit_hand(xml={'<body name="palm">': plane}))


def test_a_body_without_a_name(edit_hand: EditHand) -> None:
    hand = load_hand(edit_hand(xml={'<body name="index_proximal"': "<body"}))
    assert "index_proximal" in [g.name for g in hand.geometries]


def test_what_is_fixed_beside_the_base_is_dropped(edit_hand: EditHand) -> None:
    wall = '<worldbody><geom name="wall" type="box" size="0.1 0.1 0.1" pos="1 0 0"/>'
    hand = load_hand(edit_hand(xml={"<worldbody>": wall}))
    assert "wall" not in {g.name for g in hand.geometries}


def test_a_tip_site_named_like_its_body(edit_hand: EditHand) -> None:
    hand = load_hand(
        edit_hand(
            {'tip_site = "index_tip"': 'tip_site = "index_distal"'},
            {'site name="index_tip"': 'site name="index_distal"'},
        )
    )
    tip = hand.pin_model.frames[hand.fingers["index"].tip_frame_id].placement.translation
    np.testing.assert_allclose(tip, [0, 0, 0.0267], rtol=0, atol=1e-12)


def test_every_one_of_these_is_of_the_one_family() -> None:
    for leaf in (HandError, ModelError, NotFoundError):
        assert issubclass(leaf, PlannerError)


def test_hands_of_others_are_found_by_either_spelling_of_their_package() -> None:
    line = catalog.FOREIGN_HANDS["example-robot-data:allegro_right"]
    assert catalog.foreign_hand_model("example-robot-data:allegro_right") == line
    assert catalog.foreign_hand_model("example_robot_data:allegro_right") == line
    assert catalog.foreign_hand_model("example-robot-data:allegro") is None
    assert catalog.foreign_hand_model("allegro_hand") is None
