"""Readers of other tools' files give the poses that the files were made with.

The files are made here as the other side's code writes them (the modules cite it).
"""

from __future__ import annotations

import pickle
import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner.batch import GraspSet, plan_grasps
from planner.errors import FileFormatError, NotFoundError
from planner.exchange.dexgraspbench import export_dexgraspbench
from planner.exchange.dexgraspbench.read import read_dexgraspbench
from planner.exchange.formats import FORMATS, GraspFormat, Reading, format_named, format_of
from planner.exchange.joints import FileJoints
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.kinematics import HandState
from planner.spatial import SE3, pose_from_wxyz, pose_to_wxyz

BY_NUMBER = Reading(by_number=True)

EXAMPLES = Path(__file__).resolve().parent.parent / "examples" / "formats"


@pytest.fixture
def example(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> GraspFormat:
    """A format of ``examples/formats``, registered as its package does."""
    made = runpy.run_path(str(EXAMPLES / f"{request.param}.py"))["FORMAT"]
    assert isinstance(made, GraspFormat)
    monkeypatch.setitem(FORMATS, made.name, made)
    return made


@pytest.fixture(scope="module")
def hand() -> Hand:
    return load_hand("allegro_hand")


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def _pose(rng: np.random.Generator) -> SE3:
    return pose_from_wxyz(rng.normal(scale=0.1, size=3), rng.normal(size=4))


def _seven(pose: SE3) -> np.ndarray[Any, Any]:
    return np.concatenate(pose_to_wxyz(pose))


def _close(a: SE3, b: SE3, tol: float = 1e-6) -> None:
    np.testing.assert_allclose(a.homogeneous, b.homogeneous, atol=tol)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["allegro_hand", "shadow_hand"])
def test_an_export_of_a_batch_comes_back(name: str, tmp_path: Path) -> None:
    plan_grasps(name, ["box:0.05x0.05x0.08", "mug"], 2, seed=1, workers=1, out=tmp_path / "set")
    grasps = GraspSet(tmp_path / "set")
    exported = export_dexgraspbench(grasps, tmp_path / "out")
    folder = tmp_path / "out" / "graspdata"
    assert format_of(folder).name == "dexgraspbench"
    mine = load_hand(name)
    given = read_dexgraspbench(folder, mine, BY_NUMBER)
    found = [row for label in sorted(grasps.labels) for _, row in grasps.found(label)]
    assert len(given) + sum(exported.left_out.values()) == len(found) > 2
    file = "{object}/{k}.npy"
    rows = [r for r in found if (folder / name / file.format(**r).replace(":", "-")).is_file()]
    assert len(given) == len(rows) >= 2  # one that holds only under gravity is left out
    for grasp, row in zip(given.grasps, rows, strict=True):
        task = grasps.task(row["object"])
        shift = SE3(np.eye(3), getattr(task.object.shape, "offset", np.zeros(3)))
        base = pose_from_wxyz(
            np.array(row["base_position_object_m"]), np.array(row["base_quaternion_object_wxyz"])
        )
        from_file = task.object.shape.spec.startswith("/")
        _close(grasp.T_object_base, shift * base if from_file else base)
        np.testing.assert_allclose(grasp.q, row["q_rad"], atol=1e-6)
        assert grasp.q_pregrasp is not None and grasp.q_squeeze is not None
        np.testing.assert_allclose(grasp.q_pregrasp, row["q_pregrasp_rad"], atol=1e-6)
        assert grasp.scale == 1.0 and grasp.object.endswith(row["object"].replace(":", "-"))


def _dictionary(hand: Hand, rng: np.random.Generator) -> tuple[dict[str, Any], SE3, SE3]:
    """A grasp of the benchmark, its object's pose, and that of the hand in it."""
    place, base = _pose(rng), _pose(rng)
    q = rng.normal(size=(3, hand.nq))
    seven = _seven(place * base)
    pre, at, squeeze = (np.concatenate([seven, row]) for row in q)
    data = {
        "obj_path": "objects/can",
        "obj_scale": 0.5,
        "obj_pose": _seven(place),
        "pregrasp_qpos": pre,
        "grasp_qpos": at,
        "squeeze_qpos": squeeze,
    }
    return data, place, base


def test_one_dictionary(hand: Hand, tmp_path: Path, rng: np.random.Generator) -> None:
    data, place, base = _dictionary(hand, rng)
    np.save(tmp_path / "a.npy", np.array(data, dtype=object))
    (grasp,) = read_dexgraspbench(tmp_path / "a.npy", hand, BY_NUMBER).grasps
    _close(grasp.T_object_base, base)
    assert grasp.T_world_object is not None
    _close(grasp.T_world_object, place)
    np.testing.assert_allclose(grasp.q, data["grasp_qpos"][7:])
    assert (grasp.object, grasp.scale) == ("objects/can", 0.5)


def test_a_quaternion_in_the_other_order_and_millimetres(
    hand: Hand, tmp_path: Path, rng: np.random.Generator
) -> None:
    data, _, base = _dictionary(hand, rng)
    for name in ("obj_pose", "pregrasp_qpos", "grasp_qpos", "squeeze_qpos"):
        data[name] = data[name].copy()
        data[name][3:7] = data[name][[4, 5, 6, 3]]
        data[name][:3] *= 1e3
    np.save(tmp_path / "a.npy", np.array(data, dtype=object))
    told = Reading(by_number=True, quaternion="xyzw", unit=1e-3)
    (grasp,) = read_dexgraspbench(tmp_path / "a.npy", hand, told).grasps
    _close(grasp.T_object_base, base)


def _scene(folder: Path, place: SE3) -> None:
    scene = {
        "scene": {
            "can": {"pose": _seven(place), "scale": np.full(3, 0.06), "file_path": "can.obj"}
        },
        "task": {"obj_name": "can"},
    }
    np.save(folder / "scene.npy", np.array(scene, dtype=object))


def test_batched_dictionaries_with_a_scene(
    hand: Hand, tmp_path: Path, rng: np.random.Generator
) -> None:
    made = [_dictionary(hand, rng) for _ in range(3)]
    place = made[0][1]
    data: dict[str, Any] = {
        name: np.array([m[0][name] for m in made])
        for name in ("pregrasp_qpos", "grasp_qpos", "squeeze_qpos")
    }
    data |= {"scene_path": "scene.npy", "scene_scale": np.array([1.0, 2.0, 0.5])}
    np.save(tmp_path / "a.npy", np.array(data, dtype=object))
    with pytest.raises(FileFormatError, match=r"scene file scene\.npy, which is neither"):
        read_dexgraspbench(tmp_path / "a.npy", hand, BY_NUMBER)
    _scene(tmp_path, place)
    given = read_dexgraspbench(tmp_path / "a.npy", hand, BY_NUMBER)
    assert [g.scale for g in given.grasps] == pytest.approx([0.06, 0.12, 0.03])
    for grasp, (_, there, base) in zip(given.grasps, made, strict=True):
        _close(grasp.T_object_base, place.inverse() * there * base)
    assert len(read_dexgraspbench(tmp_path, hand, BY_NUMBER)) == 3, "scenes are passed over"


def test_dexonomy_and_bodex(hand: Hand, tmp_path: Path, rng: np.random.Generator) -> None:
    data, place, base = _dictionary(hand, rng)
    _scene(tmp_path, place)
    dexonomy = {
        "grasp_qpos": data["grasp_qpos"][None],
        "squeeze_qpos": data["squeeze_qpos"][None],
        "pregrasp_qpos": np.array([data["pregrasp_qpos"], data["grasp_qpos"]]),
        "scene_path": "scene.npy",
    }
    np.save(tmp_path / "a.npy", np.array(dexonomy, dtype=object))
    (grasp,) = read_dexgraspbench(tmp_path / "a.npy", hand, BY_NUMBER).grasps
    _close(grasp.T_object_base, base)
    assert grasp.q_pregrasp is not None
    np.testing.assert_allclose(grasp.q_pregrasp, data["pregrasp_qpos"][7:])
    order = list(reversed(range(hand.nq)))
    poses = np.array([[[data[f"{n}_qpos"] for n in ("pregrasp", "grasp", "squeeze")]] * 2])
    poses = np.moveaxis(poses, 1, 1).reshape(1, 2, 3, -1)
    poses[..., 7:] = poses[..., 7:][..., order]
    bodex = {
        "robot_pose": poses,
        "scene_path": ["scene.npy"],
        "joint_names": [hand.joint_names[i] for i in order],
    }
    np.save(tmp_path / "b.npy", np.array(bodex, dtype=object))
    given = read_dexgraspbench(tmp_path / "b.npy", hand, Reading())
    assert len(given) == 2
    for grasp in given.grasps:
        np.testing.assert_allclose(grasp.q, data["grasp_qpos"][7:])
        _close(grasp.T_object_base, base)


def test_joints_without_names_need_a_word(
    hand: Hand, tmp_path: Path, rng: np.random.Generator
) -> None:
    data, _, _ = _dictionary(hand, rng)
    np.save(tmp_path / "a.npy", np.array(data, dtype=object))
    with pytest.raises(FileFormatError, match=r"16 joints and does not name them.*--by-number"):
        read_dexgraspbench(tmp_path / "a.npy", hand, Reading())
    with pytest.raises(FileFormatError, match="16 joints, shadow_hand has 24"):
        read_dexgraspbench(tmp_path / "a.npy", load_hand("shadow_hand"), BY_NUMBER)
    turned = Reading(joint_names=tuple(reversed(hand.joint_names)))
    (grasp,) = read_dexgraspbench(tmp_path / "a.npy", hand, turned).grasps
    np.testing.assert_allclose(grasp.q, data["grasp_qpos"][7:][::-1])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"grasp_qpos": np.zeros(23)}, "length 1"),
        ({"grasp_qpos": np.full(23, np.nan)}, "not finite"),
        ({"grasp_qpos": np.zeros(4)}, "grasp_qpos has the shape"),
        ({"grasp_qpos": "text"}, "damaged or of another version"),
        ({"squeeze_qpos": np.zeros(9)}, "squeeze_qpos has the shape"),
        ({"obj_scale": [1.0, 2.0, 3.0]}, "scale"),
        ({"obj_pose": np.zeros(3)}, "obj_pose"),
        ({"joint_names": ["x"] * 16}, "names twice"),
    ],
)
def test_damaged_dictionaries_name_the_place(
    hand: Hand, tmp_path: Path, rng: np.random.Generator, change: dict[str, Any], said: str
) -> None:
    data, _, _ = _dictionary(hand, rng)
    np.save(tmp_path / "a.npy", np.array(data | change, dtype=object))
    with pytest.raises(FileFormatError, match=said) as raised:
        read_dexgraspbench(tmp_path / "a.npy", hand, BY_NUMBER)
    assert "a.npy" in str(raised.value)


def _net_names() -> list[str]:
    fingers = [(f, 4) for f in ("FF", "MF", "RF")] + [("LF", 5), ("TH", 5)]
    return [f"robot0:{f}J{i}" for f, n in fingers for i in reversed(range(n))]


def _net(rng: np.random.Generator) -> dict[str, Any]:
    names = ("WRJTx", "WRJTy", "WRJTz", "WRJRx", "WRJRy", "WRJRz", *_net_names())
    values = rng.normal(size=len(names))
    return {"scale": 0.08, "qpos": {n: float(v) for n, v in zip(names, values, strict=True)}}


@pytest.mark.parametrize("example", ["dexgraspnet"], indirect=True)
def test_dexgraspnet(example: GraspFormat, tmp_path: Path, rng: np.random.Generator) -> None:
    assert example.read is not None
    shadow = load_hand("shadow_hand")
    rows = [_net(rng) for _ in range(2)]
    np.save(tmp_path / "core-mug.npy", np.array(rows, dtype=object))
    assert format_of(tmp_path / "core-mug.npy").name == "dexgraspnet"
    given = example.read(tmp_path / "core-mug.npy", shadow, Reading())
    for grasp, row in zip(given.grasps, rows, strict=True):
        qpos = row["qpos"]
        # our joints count from 1
        for ours, theirs in (("FFJ4", "FFJ3"), ("LFJ5", "LFJ4"), ("THJ1", "THJ0")):
            assert grasp.q[shadow.joint_index(ours)] == qpos[f"robot0:{theirs}"]
        assert not grasp.q[shadow.wrist_index].any()
        palm = grasp.T_object_base * HandState(shadow, grasp.q).T_base_palm
        np.testing.assert_allclose(
            palm.translation, [qpos[n] for n in ("WRJTx", "WRJTy", "WRJTz")], atol=1e-12
        )
        from scipy.spatial.transform import Rotation

        angles = [qpos[n] for n in ("WRJRx", "WRJRy", "WRJRz")]
        turned = Rotation.from_euler("xyz", angles).as_matrix()  # lower case: fixed axes
        np.testing.assert_allclose(palm.rotation, turned, atol=1e-12)
        assert (grasp.scale, grasp.object) == (0.08, "core-mug")


@pytest.mark.parametrize("example", ["dexgraspnet"], indirect=True)
def test_damaged_dexgraspnet(
    example: GraspFormat, tmp_path: Path, rng: np.random.Generator
) -> None:
    assert example.read is not None
    shadow, path = load_hand("shadow_hand"), tmp_path / "a.npy"
    for change, said in (
        ({"WRJTx": None}, "grasp 0"),
        ({"robot0:FFJ3": "x"}, "not all numbers"),
        ({"robot0:FFJ3": float("nan")}, "not finite"),
        ({"j5": 0.1}, "names j5, which shadow_hand does not have"),
    ):
        row = _net(rng)
        row["qpos"] |= change
        np.save(path, np.array([row], dtype=object))
        with pytest.raises(FileFormatError, match=said):
            example.read(path, shadow, Reading())
    with pytest.raises(FileFormatError, match="does not fit allegro_hand: it lacks index_0"):
        np.save(path, np.array([_net(rng)], dtype=object))
        example.read(path, load_hand("allegro_hand"), Reading())


@pytest.mark.parametrize("example", ["frogger"], indirect=True)
def test_frogger(
    example: GraspFormat, hand: Hand, tmp_path: Path, rng: np.random.Generator
) -> None:
    assert example.read is not None
    place, base = _pose(rng), _pose(rng)
    seven = _seven(place * base)
    q = rng.normal(size=hand.nq)
    lost = np.full(7 + hand.nq, np.nan)
    data = {
        "q_stars": np.array([lost, np.concatenate([seven[3:], seven[:3], q])]),
        "obj_settings": {"X_WO": place.homogeneous[:3], "name": "can"},
        "model_settings": {"name": "algr_rh"},
    }
    (tmp_path / "a.pkl").write_bytes(pickle.dumps(data))
    assert format_of(tmp_path / "a.pkl").name == "frogger"
    given = example.read(tmp_path / "a.pkl", hand, BY_NUMBER)
    (grasp,) = given.grasps
    _close(grasp.T_object_base, base)
    np.testing.assert_allclose(grasp.q, q)
    assert (given.hand, grasp.object, grasp.name) == ("algr_rh", "can", "row 1")
    arm = load_hand("allegro_on_arm7")
    data["q_stars"] = rng.normal(size=(1, arm.nq))
    (tmp_path / "b.pkl").write_bytes(pickle.dumps(data))
    (grasp,) = example.read(tmp_path / "b.pkl", arm, BY_NUMBER).grasps
    _close(grasp.T_object_base, place.inverse())


def test_a_body_that_is_not_there_and_a_format_that_is_not_there(hand: Hand) -> None:
    with pytest.raises(NotFoundError, match="body of allegro_hand"):
        FileJoints(hand, Reading(base_body="wrist"), "x", names=hand.joint_names, count=16)
    with pytest.raises(NotFoundError, match="no format is called 'dexgrasp'"):
        format_named("dexgrasp")


def test_a_file_of_no_known_form_names_the_formats(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.arange(3))
    with pytest.raises(FileFormatError, match=r"looks like none of .*table.*; say which"):
        format_of(tmp_path / "a.npy")


def test_a_hostile_or_damaged_file_is_said_to_be_so_and_not_of_no_form(tmp_path: Path) -> None:
    folder = tmp_path / "set"
    folder.mkdir()
    hostile = b"cos\nsystem\n(S'touch ran'\ntR."
    np.save(folder / "a.npy", np.array({"grasp_qpos": 0}, dtype=object))
    data = (folder / "a.npy").read_bytes()
    (folder / "a.npy").write_bytes(data[: data.index(b"\n") + 1] + hostile)
    (tmp_path / "b.pkl").write_bytes(hostile)
    (tmp_path / "c.pt").write_bytes(b"PK")
    for path, said in (
        (folder, "it holds 'os.system'"),
        (folder / "a.npy", "it holds 'os.system'"),
        (tmp_path / "b.pkl", "it holds 'os.system'"),
        (tmp_path / "c.pt", "PyTorch file"),
    ):
        with pytest.raises(FileFormatError, match=said):
            format_of(path)
