"""``isaac-grasp``: YAML of grasps of one object by one gripper, version 1.0, by NVIDIA.

Isaac Sim's Grasp Editor writes and imports it, Isaac ROS, GraspGen and others read it:

    format: isaac_grasp
    format_version: 1.0
    object_frame, gripper_frame     names, for people
    grasps:
      NAME:
        confidence                  0 to 1
        position, orientation       of the gripper's frame in the object's: m, {w, xyz: [x, y, z]}
        cspace_position             joint -> rad or m, at the grasp
        pregrasp_cspace_position    the same, opened

Read from https://github.com/isaac-sim/IsaacSim at commit 045ca8b (2026-06-22), ``source/extensions/
isaacsim.robot_setup.grasp_editor/isaacsim/robot_setup/grasp_editor``: ``data_writer.py`` for keys,
versions and for numbers that are texts, ``grasp_importer.py`` for the direction of the pose; and
from https://github.com/NVlabs/GraspGen at commit a56d518, ``grasp_gen/dataset/eval_utils.py``.
Isaac Sim's manual calls the frames ``object_frame_link`` and ``gripper_frame_link``, its code and
Isaac ROS's manual as above; both are read, and no reader there relies on either.

The object's frame is that of its own file, as in ``planner.exchange.dexgraspbench``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from planner.errors import FileFormatError, shown
from planner.exchange.formats import (
    GraspFormat,
    ImportedGrasp,
    ImportedGrasps,
    Reading,
    Writing,
    register_format,
)
from planner.exchange.joints import (
    T_base_body,
    T_object_body,
    channels_of,
    completed_joints,
    hand_frame,
    need_no_arm,
    need_one_pair,
    object_frame,
)
from planner.exchange.yaml_text import (
    head_of,
    member,
    number,
    numbers,
    pose_of,
    read_documents,
    table,
    text,
    yaml_text,
)
from planner.files import whole_file
from planner.hands.hand import Hand
from planner.plan import GraspPlan
from planner.spatial import pose_to_wxyz
from planner.system.package import written_by

NAME, VERSION = "isaac_grasp", 1.0
"""What such a file says of itself."""

FRAMES = ("object_frame", "object_frame_link"), ("gripper_frame", "gripper_frame_link")
"""Keys of the frames' names, of which the first is written."""


def write_isaac_grasp(plans: Sequence[GraspPlan], path: Path, writing: Writing) -> tuple[Path, ...]:
    """Write plans of one hand and one object.

    ``confidence`` is the normalised min-weight of the contacts, which is in (0, 1] for a plan.

    Raises:
        TaskError: Several hands or objects, or a hand on an arm.
        FileFormatError: The file cannot be written.
    """
    first = need_one_pair(plans, ISAAC_GRASP.name)
    hand = need_no_arm(first, ISAAC_GRASP.name)
    channels = channels_of(hand, writing)
    grasps: dict[str, Any] = {}
    for i, plan in enumerate(plans):
        position, wxyz = pose_to_wxyz(T_object_body(plan, writing.base_body))
        grasps[f"grasp_{i}"] = {
            "confidence": float(plan.quality.closure.normalised_min_weight),
            "position": position.tolist(),
            "orientation": {"w": float(wxyz[0]), "xyz": wxyz[1:].tolist()},
            "cspace_position": channels.by_name(plan.q),
            "pregrasp_cspace_position": channels.by_name(plan.q_pregrasp),
        }
    data = {
        "format": NAME,
        "format_version": VERSION,
        FRAMES[0][0]: object_frame(first, writing),
        FRAMES[1][0]: hand_frame(hand, writing),
        "grasps": grasps,
    }
    comments = (
        f"{written_by()}: {hand.name} grasps {first.object.shape.spec}",
        "m, rad; confidence: normalised min-weight of the contacts",
        *channels.said,
    )
    with whole_file(path) as stream:
        stream.write(yaml_text([data], comments).encode())
    return (path,)


def read_isaac_grasp(path: Path, hand: Hand, reading: Reading) -> ImportedGrasps:
    """Read the grasps of a file.

    Raises:
        FileFormatError: It is damaged, of another version, for another hand, or holds poses
            without joints; the message names the place.
    """
    documents = read_documents(path, "a file of grasps")
    if len(documents) != 1:
        raise FileFormatError(f"{path} holds {len(documents)} YAML documents; one is needed")
    where = str(path)
    data = table(documents[0], where)
    if member(data, "format", where) != NAME:
        raise FileFormatError(f"{where}: format is {shown(data['format'])}; {NAME} is needed")
    version = number(member(data, "format_version", where), f"{where}: format_version")
    if version != VERSION:
        raise FileFormatError(
            f"{where}: format_version is {version:g}; this Opposable reads {VERSION}"
        )
    if reading.quaternion is not None:
        raise FileFormatError(
            f"{where} says w and xyz by name, and an order of {reading.quaternion} is given as "
            "well; leave that out"
        )
    named = [
        next((text(data[k], f"{where}: {k}") for k in keys if k in data), "") for keys in FRAMES
    ]
    grasps = table(member(data, "grasps", where), f"{where}: grasps")
    return ImportedGrasps(
        source=path,
        format=ISAAC_GRASP.name,
        hand=named[1],
        grasps=tuple(
            _read_grasp(name, value, f"{where}: grasps.{name}", hand, reading, named[0])
            for name, value in grasps.items()
        ),
        assumed=(
            f"{named[1] or 'the gripper frame'} is the frame of the body "
            f"{reading.base_body or hand.description.base_body!r} of {hand.name}",
            f"{named[0] or 'the object frame'} is the frame of the object's file",
        ),
    )


def _read_grasp(
    name: str, value: Any, where: str, hand: Hand, reading: Reading, item: str
) -> ImportedGrasp:
    grasp = table(value, where)
    turn = table(member(grasp, "orientation", where), f"{where}.orientation")
    xyz = numbers(member(turn, "xyz", f"{where}.orientation"), 3, f"{where}.orientation.xyz")
    w = number(member(turn, "w", f"{where}.orientation"), f"{where}.orientation.w")
    at = numbers(member(grasp, "position", where), 3, f"{where}.position") * (reading.unit or 1.0)
    pose = pose_of(at, np.array([w, *xyz]), f"{where}.orientation")
    key = "cspace_position"
    q = _joints(member(grasp, key, where), f"{where}.{key}", hand, reading)
    opened, key = None, "pregrasp_cspace_position"
    if key in grasp:
        opened = _joints(grasp[key], f"{where}.{key}", hand, reading)
    sure = grasp.get("confidence")
    return ImportedGrasp(
        name=name,
        T_object_base=pose * T_base_body(hand, q, reading.base_body).inverse(),
        q=q,
        q_pregrasp=opened,
        object=item,
        confidence=None if sure is None else number(sure, f"{where}.confidence"),
    )


def _joints(value: Any, where: str, hand: Hand, reading: Reading) -> Any:
    """Joints (nq,) of a mapping by name."""
    given: Mapping[str, Any] = table(value, where)
    values = np.array([number(v, f"{where}.{k}") for k, v in given.items()], dtype=np.float64)
    return completed_joints(hand, list(given), values, where=where, other_names=reading.rename)


def _recognises(path: Path) -> bool:
    lines = (line.split(":", 1) for line in head_of(path).splitlines() if ":" in line)
    return any(k.strip(" \"'{") == "format" and NAME in v for k, v in lines)


ISAAC_GRASP = register_format(
    GraspFormat(
        name="isaac-grasp",
        title="isaac_grasp YAML 1.0 of NVIDIA's Isaac Sim, Isaac ROS and GraspGen",
        suffixes=(".yaml", ".yml"),
        loses=(
            "the object's shape and mass, contacts and forces, friction, table and obstacles, the "
            "way to the pre-grasp"
        ),
        recognises=_recognises,
        read=read_isaac_grasp,
        write=write_isaac_grasp,
        heeds=frozenset({"rename", "object_frame", "hand_frame", "base_body"}),
    )
)
