"""A hand that an arm carries: its description, and ``Arm``, the planner's data of the arm.

The description is a third kind of ``hand.toml``: it names a hand's description, an arm's model, and
where on it the hand is put. The arm is any tree of hinges and slides, in MJCF, with its actuators.
See ``models/hands/allegro_on_arm7/hand.toml``.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from pydantic import Field

from planner.bridge import LinkGeometry, load_spec
from planner.errors import HandError, NotFoundError
from planner.hands.description_toml import read_toml, validated
from planner.joints.description import Finite, Vector
from planner.schema import StrictData
from planner.spatial import SE3, FloatArray, IntArray, pose_from_wxyz

__all__ = ["Arm", "ArmDescription", "Mount", "MountDescription", "mount_of", "read_mount"]


class ArmDescription(StrictData):
    """Which arm, where the hand is on it, and where it stands.

    Attributes:
        model: Model file (MJCF), relative to this file.
        attach: Site of the arm that the hand's base is put on.
        position: The base's origin in that site, m.
        quaternion_wxyz: The base's orientation in that site.
        base_position: Where the arm's root stands unless a task says otherwise, from the point of
            the table below the object's centre of mass, m, world axes.
        ready: Posture, rad (m for slides), where inverse kinematics starts; synthesis stays near it
            where it can.
    """

    model: str
    attach: str
    position: Vector = (0.0, 0.0, 0.0)
    quaternion_wxyz: tuple[Finite, Finite, Finite, Finite] = (1.0, 0.0, 0.0, 0.0)
    base_position: Vector
    ready: dict[str, Finite] = Field(default_factory=dict)


class MountDescription(StrictData):
    """A ``hand.toml`` that puts a described hand on an arm; ``hand`` is relative to this file."""

    schema_version: int = Field(alias="schema", ge=1, le=1)
    name: str
    summary: str = ""
    hand: str
    arm: ArmDescription


@dataclass(frozen=True, kw_only=True, eq=False)
class Arm:
    """The arm that carries a hand: the joints between its fixed root and the palm.

    Attributes:
        index: Where its joints stand in q, (n,).
        chain: Those of them that move the palm, root first.
        ready: Its ready posture (n,), order of ``index``.
        geometries: Names of its colliding geometries.
        T_spot_base: Pose of its root from the point of the table below the object.
        longest: Longest distance (m) of the palm's origin from the origin of the first joint.
    """

    index: IntArray
    chain: IntArray
    ready: FloatArray
    geometries: frozenset[str]
    T_spot_base: SE3
    longest: float

    @property
    def flange(self) -> int:
        """Pinocchio number of the last joint of the chain, on which the hand is."""
        return int(self.chain[-1]) + 1


@dataclass(frozen=True, kw_only=True)
class Mount:
    """A mount's description, and the file that it is in.

    Attributes:
        path: The file.
        description: Its content.
    """

    path: Path
    description: MountDescription

    @property
    def hand_path(self) -> Path:
        """The description of the hand."""
        return self.path.parent / self.description.hand

    @property
    def arm_path(self) -> Path:
        """The arm's model file."""
        return self.path.parent / self.description.arm.model

    def attach(self, hand_spec: Any) -> tuple[Any, str]:
        """A spec of the arm with the hand on it, and the name of its root body.

        Raises:
            ModelError: The arm's model is missing or not usable.
            NotFoundError: The arm has no such site.
        """
        from planner.bridge.edit import mount_spec  # here: few hands have an arm

        arm = self.description.arm
        T_site_base = pose_from_wxyz(np.array(arm.position), np.array(arm.quaternion_wxyz))
        return mount_spec(
            load_spec(self.arm_path),
            hand_spec,
            site=arm.attach,
            T_site_base=T_site_base,
            what=str(self.arm_path),
        )

    def arm(self, pin_model: Any, palm_frame: int, geometries: tuple[LinkGeometry, ...]) -> Arm:
        """The arm in the model of the whole.

        Raises:
            NotFoundError: The ready posture names a joint that the arm does not have.
            HandError: It leaves a joint's range, or no joint of the arm moves the palm.
        """
        from planner.bridge.edit import ARM_PREFIX

        names = tuple(pin_model.names)[1:]
        index = [k for k, name in enumerate(names) if name.startswith(ARM_PREFIX)]
        above = [int(j) - 1 for j in pin_model.supports[pin_model.frames[palm_frame].parentJoint]]
        chain = [k for k in above if k in index]
        if not chain:
            raise HandError(
                f"{self.path}: no joint of {self.arm_path} moves the palm; attach the hand to "
                "another site, or describe it without an arm"
            )
        ready = self._ready([names[k].removeprefix(ARM_PREFIX) for k in index], pin_model, index)
        position = np.array(self.description.arm.base_position)
        return Arm(
            index=np.array(index),
            chain=np.array(chain),
            ready=ready,
            geometries=frozenset(g.name for g in geometries if g.body.startswith(ARM_PREFIX)),
            T_spot_base=SE3(np.eye(3), position),
            longest=_longest(pin_model, chain, palm_frame),
        )

    def _ready(self, joints: list[str], pin_model: Any, index: list[int]) -> FloatArray:
        given = self.description.arm.ready
        for joint in given:
            if joint not in joints:
                raise NotFoundError(
                    f"joint of {self.arm_path}", joint, joints, "Correct [arm.ready]."
                )
        lower = np.array(pin_model.lowerPositionLimit)[index]
        upper = np.array(pin_model.upperPositionLimit)[index]
        ready = np.clip(np.zeros(len(index)), lower, upper)
        for joint, value in given.items():
            k = joints.index(joint)
            if not lower[k] <= value <= upper[k]:
                raise HandError(
                    f"{self.path}: [arm.ready] puts {joint} at {value:.4f}, outside its range "
                    f"[{lower[k]:.4f}, {upper[k]:.4f}]; bring it inside"
                )
            ready[k] = value
        return ready


def read_mount(path: Path) -> Mount | None:
    """The mount that a file describes; None if it describes something else, or nothing.

    Raises:
        HandError: Not TOML, a mount with faults, or a mount of another mount.
    """
    raw = read_toml(path)
    return mount_of(path, raw) if "arm" in raw else None


def mount_of(path: Path, raw: dict[str, Any]) -> Mount:
    """The mount that the content of a file describes.

    Args:
        path: The file.
        raw: Its content, which has the key "arm".

    Raises:
        HandError: A mount with faults, or a mount of another mount.
    """
    description = validated(path, MountDescription, raw, "a hand on an arm")
    mount = Mount(path=path, description=description)
    if not os.path.isfile(mount.hand_path):  # False where the name is too long
        raise HandError(f"{path}: hand names {mount.hand_path}, which does not exist; correct it")
    if read_mount(mount.hand_path) is not None:
        raise HandError(f"{path}: hand names {mount.hand_path}, which is on an arm; name the hand")
    if not np.linalg.norm(description.arm.quaternion_wxyz) > 0:
        raise HandError(f"{path}: quaternion_wxyz has no length; give a unit quaternion")
    return mount


def _longest(pin_model: Any, chain: list[int], palm_frame: int) -> float:
    """Sum (m) of the distances between joints from the first of the chain to the palm."""
    frame = pin_model.frames[palm_frame]
    joints = [int(j) for j in pin_model.supports[frame.parentJoint]]
    after = joints[joints.index(chain[0] + 1) + 1 :]
    total = float(np.linalg.norm(frame.placement.translation))
    total += sum(float(np.linalg.norm(pin_model.jointPlacements[j].translation)) for j in after)
    data = pin_model.createData()
    pin.computeJointJacobians(pin_model, data, pin.neutral(pin_model))
    for j in joints[1:]:
        column = pin.getJointJacobian(pin_model, data, j, pin.ReferenceFrame.LOCAL)[:3, j - 1]
        if np.linalg.norm(column) > 0:  # a slide moves its own origin
            ends = pin_model.lowerPositionLimit[j - 1], pin_model.upperPositionLimit[j - 1]
            total += float(np.abs(ends).max())
    return total
