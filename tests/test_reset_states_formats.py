"""Formats of states: what another reader finds in a file is what the states are."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from planner.errors import FileFormatError, NotFoundError, TaskError
from planner.hand_loading import load_hand
from planner.spatial import pose_from_wxyz, pose_to_wxyz
from sim.datasets.reset_states import StateFormat, StateSet, register_state_format, state_format
from sim.datasets.reset_states.formats import DOWN, HORA_JOINTS, T_WORLD_BASE, state_formats

HAND = load_hand("allegro_hand")


def made(n: int = 5, gravity: tuple[float, float, float] = (-9.81, 0.0, 0.0)) -> StateSet:
    """States of the Allegro-type hand that nobody has held."""
    rng = np.random.default_rng(0)
    quaternion = rng.normal(size=(n, 4))
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    quaternion *= np.sign(quaternion[:, :1])
    q = rng.uniform(HAND.q_lower, HAND.q_upper, size=(n, HAND.nq))
    return StateSet(
        hand="allegro_hand",
        object="sphere:0.04",
        scene="scene.xml",
        scale=0.8,
        joint_names=HAND.joint_names,
        actuator_names=HAND.actuation.names,
        q=q,
        commands=q + 0.1,
        targets=q + 0.1,
        position=rng.normal(size=(n, 3)) * 0.05,
        quaternion=quaternion,
        gravity=np.tile(gravity, (n, 1)),
        mass=rng.uniform(0.05, 0.15, n),
        friction=rng.uniform(0.5, 1.0, n),
        kind=np.array(["grasp"] * n),
        plan=np.arange(n),
        pose=np.zeros(n, dtype=np.int64),
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "ball-s0.8").mkdir()
    return tmp_path


def _seen(name: str, path: Path) -> dict[str, Any]:
    """Joint names, joints, targets or commands, place and orientation, as users of a file see."""
    if name == "hora":
        rows = np.load(path)
        back = [
            T_WORLD_BASE.inverse() * pose_from_wxyz(row[16:19], row[[22, 19, 20, 21]])
            for row in rows.astype(float)
        ]
        poses = np.array([np.concatenate(pose_to_wxyz(pose)) for pose in back])
        return {"names": HORA_JOINTS, "q": rows[:, :16], "p": poses[:, :3], "w": poses[:, 3:]}
    if name == "parquet":
        table = pytest.importorskip("pyarrow.parquet").read_table(path)
        about = json.loads(table.schema.metadata[b"opposable-states"])
        file = about | {
            key: np.stack(table[key].to_numpy(zero_copy_only=False)) for key in table.column_names
        }
    else:
        file = dict(np.load(path))
    nq = len(file["joint_names"])
    q, target, p, w = {
        "isaac_lab": lambda: [
            file[k] for k in ("joint_pos", "joint_pos_target", "object_pos_b", "object_quat_b_wxyz")
        ],
        "playground": lambda: [
            file["qpos"][:, :nq],
            file["ctrl"],
            file["qpos"][:, nq : nq + 3],
            file["qpos"][:, nq + 3 :],
        ],
    }.get(
        name,
        lambda: [
            file[k]
            for k in (
                *("joint_position", "joint_target"),
                *("object_position_m", "object_quaternion_wxyz"),
            )
        ],
    )()
    names = tuple(str(n) for n in file["joint_names"])
    return {"names": names, "q": q, "target": target, "p": p, "w": w}


@pytest.mark.parametrize("name", state_formats())
def test_every_format_gives_the_states_back_by_name(name: str, folder: Path) -> None:
    if name == "parquet":
        pytest.importorskip("pyarrow")
    states, format = made(), state_format(name)
    assert format.refuses(states) == ""
    seen = _seen(name, format.write(states, "ball-s0.8", folder))
    assert np.allclose(seen["q"], states.named(seen["names"]), atol=1e-6)
    assert np.allclose(seen["p"], states.position, atol=1e-6)
    assert np.allclose(seen["w"], states.quaternion, atol=1e-6)
    if "targets" not in format.lost:
        assert np.allclose(seen["target"], states.targets, atol=1e-6)


def test_npz_and_parquet_lose_no_digit(folder: Path) -> None:
    states = made()
    state_format("npz").write(states, "ball-s0.8", folder)
    again = StateSet.read(folder / "ball-s0.8" / "states.npz")
    for name in ("q", "commands", "position", "quaternion", "gravity", "mass", "friction"):
        assert np.array_equal(getattr(again, name), getattr(states, name)), name
    assert (again.hand, again.scale, again.joint_names) == ("allegro_hand", 0.8, HAND.joint_names)
    assert len(again[1:3]) == 2
    pytest.importorskip("pyarrow")
    parquet = state_format("parquet")
    read = _seen("parquet", parquet.write(states, "ball-s0.8", folder))
    assert np.array_equal(read["q"], states.q)
    assert read["names"] == HAND.joint_names


def test_hora_finds_its_hand_and_the_object_in_its_world(folder: Path) -> None:
    states = made()
    hora = state_format("hora")
    path = hora.write(states, "ball-s0.8", folder)
    assert path.name == "public_allegro_grasp_50k_s08.npy"  # what HORA's environment opens
    rows = np.load(path)
    assert rows.shape == (5, 23)
    assert rows.dtype == np.float32
    # as HORA uses a row: joints by its order, root state x, y, z and quaternion x, y, z, w
    for row, q, position, quaternion in zip(
        rows, states.q, states.position, states.quaternion, strict=True
    ):
        by_name = dict(zip(HORA_JOINTS, row[:16].tolist(), strict=True))
        assert np.allclose([by_name[n] for n in HAND.joint_names], q, atol=1e-6)
        there = T_WORLD_BASE * pose_from_wxyz(position, quaternion)
        assert np.allclose(row[16:19], there.translation, atol=1e-6)
        turn = pin.Quaternion(*(float(row[i]) for i in (22, 19, 20, 21))).matrix()
        assert np.allclose(turn, there.rotation, atol=1e-6)
    # palm up, gravity down: the palm's normal of our hand looks along z of HORA's world
    normal = T_WORLD_BASE.rotation @ HAND.palm_normal
    assert np.allclose(normal, [0.0, 0.0, 1.0], atol=1e-6)
    # Isaac Gym: Quat.from_axis_angle(y, -90 deg) * Quat.from_axis_angle(x, 90 deg)
    y, x = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])
    assert np.allclose(T_WORLD_BASE.rotation, pin.exp3(-np.pi / 2 * y) @ pin.exp3(np.pi / 2 * x))


def test_the_allegro_of_hora_is_ours() -> None:
    """Origins of its joints in the base, read off allegro.urdf at commit 410d958 by Pinocchio."""
    data = mujoco.MjData(HAND.mj_model)
    for k, name in enumerate(HORA_JOINTS):
        data.joint(name).qpos = HAND.q_lower[HAND.joint_index(name)] + 0.05 * k
    mujoco.mj_kinematics(HAND.mj_model, data)
    base = HAND.mj_model.body(HAND.description.base_body).id
    turn = data.xmat[base].reshape(3, 3)
    for name, expected in HORA_ORIGINS.items():
        anchor = data.xanchor[HAND.mj_model.joint(name).id]
        assert np.allclose(turn.T @ (anchor - data.xpos[base]), expected, atol=2e-5), name


HORA_ORIGINS = {
    "index_3": (-0.01448, 0.06018, 0.10471),
    "thumb_3": (0.03555, 0.11175, -0.07552),
    "middle_3": (0.03453, -0.00242, 0.10149),
    "ring_3": (0.0551, -0.04385, 0.08508),
}


def test_hora_takes_only_its_hand_and_its_gravity(folder: Path) -> None:
    hora = state_format("hora")
    sideways = made(gravity=(0.0, 0.0, -9.81))
    assert "--gravity=-1,0,0" in hora.refuses(sideways)
    assert np.allclose(DOWN, [-1.0, 0.0, 0.0])
    mixed = made()
    mixed.gravity[2] = [0.0, 9.81, 0.0]
    assert len(np.load(hora.write(mixed, "ball-s0.8", folder))) == 4
    shadow = load_hand("shadow_hand")
    states = made()
    other = StateSet(
        **vars(states)
        | {
            "joint_names": shadow.joint_names,
            "q": np.zeros((5, shadow.nq)),
            "targets": np.zeros((5, shadow.nq)),
        }
    )
    assert "16 joints" in hora.refuses(other)


def test_isaac_lab_has_both_orders_of_quaternions(folder: Path) -> None:
    states = made()
    path = state_format("isaac_lab").write(states, "ball-s0.8", folder)
    with np.load(path) as file:
        wxyz, xyzw = file["object_quat_b_wxyz"], file["object_quat_b_xyzw"]
        assert np.array_equal(wxyz[:, 1:], xyzw[:, :3])
        assert np.array_equal(wxyz[:, 0], xyzw[:, 3])
        assert not file["joint_vel"].any()


def test_files_that_are_no_states_are_refused(folder: Path) -> None:
    path = folder / "ball-s0.8" / "states.npz"
    made().write(path)
    content = dict(np.load(path))
    for change, words in (
        ({"format": "x"}, "holds no states"),
        ({"version": 2}, "has version 2"),
        ({"mass_kg": content["mass_kg"][:-1]}, "has shape"),
    ):
        np.savez(folder / "other.npz", **content | change)
        with pytest.raises(FileFormatError, match=words):
            StateSet.read(folder / "other.npz")
    content.pop("friction")
    np.savez(folder / "other.npz", **content)
    with pytest.raises(FileFormatError, match="lacks friction"):
        StateSet.read(folder / "other.npz")
    path.write_bytes(path.read_bytes()[:300])
    with pytest.raises(FileFormatError, match="cannot read"):
        StateSet.read(path)
    np.save(folder / "object.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(FileFormatError, match="cannot read"):
        StateSet.read(folder / "object.npy")


def test_an_unknown_format_or_joint_is_named() -> None:
    with pytest.raises(NotFoundError, match="hora"):
        state_format("isaac")
    with pytest.raises(TaskError, match="no joint elbow"):
        made().named(("index_0", "elbow"))
    taken = state_format("npz")
    with pytest.raises(TaskError, match="choose another name"):
        register_state_format(StateFormat(**vars(taken) | {"title": "mine"}))
