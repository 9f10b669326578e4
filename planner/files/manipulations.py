"""Manipulation files: versioned JSON with the motion or gait, and how the object is put down.

Nothing in a file is believed: motion or gait are judged again, and so is the way out. A target or a
reserve of torque that is not that of the motion is refused.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np

from planner.approach.pregrasp import Approach
from planner.errors import FileFormatError, TaskError, shown
from planner.files.data import ArmData, Finite, NotNegative, PoseData, Vector3
from planner.files.gaits import GaitFile, gait_from_dict, gait_to_dict
from planner.files.json_csv import checked_file, read_json, write_json
from planner.files.motions import MotionFile, motion_from_dict, motion_to_dict
from planner.hands.hand import Hand
from planner.motion.manipulation import Ending, ManipulationPlan
from planner.motion.manipulation.ending import backwards, object_at_target
from planner.motion.manipulation.plan import torque_reserve
from planner.motion.release import verify_release
from planner.schema import StrictData
from planner.version import written_by

SAME = 1e-6
"""How far (m, rad, -) what a file tells may be from what follows from its motion."""


class EndingData(StrictData):
    """How the object is put down; joints in the order of the grasp's ``joint_names``.

    ``arm_out`` is the arm's way out, reversed, if the hand is on one.
    """

    T_world_target: PoseData
    q_open_rad: list[Finite]
    opening_m: NotNegative
    T_world_base_out: PoseData
    made_backwards_because: str
    arm_out: ArmData | None = None


class ManipulationFile(StrictData):
    """A manipulation plan as JSON, with either a motion or a gait."""

    format: Literal["opposable-manipulation"] = "opposable-manipulation"
    version: Literal[1] = 1
    written_by: str
    angle_rad: Finite
    shift_m: Vector3
    motion: MotionFile | None
    gait: GaitFile | None
    ending: EndingData
    torque_reserve: Finite
    attempts: int
    cpu_s: Finite


def manipulation_to_dict(plan: ManipulationPlan) -> dict[str, Any]:
    """A manipulation as plain data that follows ``ManipulationFile``."""
    ending, gait = plan.ending, plan.gait
    motion = None if gait else MotionFile.model_validate(motion_to_dict(plan.motion))
    data = ManipulationFile(
        written_by=written_by(),
        angle_rad=plan.angle,
        shift_m=tuple(plan.shift),
        motion=motion,
        gait=GaitFile.model_validate(gait_to_dict(gait)) if gait else None,
        ending=EndingData(
            T_world_target=PoseData.of(ending.T_world_target),
            q_open_rad=list(ending.release.q),
            opening_m=ending.release.pregrasp_distance,
            T_world_base_out=PoseData.of(ending.release.T_world_base_start),
            made_backwards_because=ending.back,
            arm_out=None if (arm := ending.release.arm) is None else ArmData.of(plan.grasp, arm),
        ),
        torque_reserve=plan.reserve,
        attempts=plan.attempts,
        cpu_s=plan.cpu_s,
    )
    return data.model_dump(mode="json")


def write_manipulation(plan: ManipulationPlan, path: Path | str) -> None:
    """Write a manipulation file."""
    write_json(manipulation_to_dict(plan), path)


def read_manipulation(path: Path | str, *, hand: Hand | None = None) -> ManipulationPlan:
    """Read a manipulation file and check it.

    The plan is as ``plan_manipulation`` gave it: print it, execute it with ``sim.manipulate``, or
    take its ``joint_trajectory`` to a hand.

    Args:
        path: The file.
        hand: The hand to use; the one that the file names if None.

    Raises:
        FileFormatError: Damaged, of another version, or for another hand; or it does not hold.
        PlannerError: The hand or object cannot be loaded.
    """
    return manipulation_from_dict(read_json(path, "manipulation file"), str(path), hand=hand)


def given_manipulation(given: ManipulationPlan | Path | str) -> ManipulationPlan:
    """A plan as it is, or read from its file.

    Raises:
        FileFormatError: As ``read_manipulation``.
        TaskError: Neither the plan of a manipulation nor a path.
    """
    if isinstance(given, str | Path):
        return read_manipulation(given)
    if not isinstance(given, ManipulationPlan):
        raise TaskError(
            f"{shown(given)} is a {type(given).__name__}; give the plan of a manipulation, as "
            "plan_manipulation and manipulation_of return it, or the path of its file"
        )
    return given


def manipulation_from_dict(
    data: dict[str, Any], source: str, *, hand: Hand | None = None
) -> ManipulationPlan:
    """The manipulation that plain data hold, checked like a file.

    Args:
        data: What ``manipulation_to_dict`` gave.
        source: What errors call it, as the path of a file.
        hand: The hand to use; the one that the data name if None.

    Raises:
        FileFormatError: Damaged, of another version, or for another hand; or it does not hold.
        PlannerError: The hand or object cannot be loaded.
    """
    file = checked_file(ManipulationFile, data, source)
    if (file.motion is None) == (file.gait is None):
        raise FileFormatError(f"{source} holds a motion and a gait, or neither; give one of them")
    gait = None if file.gait is None else gait_from_dict(data["gait"], source, hand=hand)
    motion = gait.motion if gait else motion_from_dict(data["motion"], source, hand=hand)
    way_out = file.ending.arm_out
    release = Approach(
        q=motion.grasp.task.hand.checked_q(file.ending.q_open_rad, "q_open_rad"),
        pregrasp_distance=file.ending.opening_m,
        T_world_base_start=file.ending.T_world_base_out.pose(),
        arm=None if way_out is None else way_out.path(motion.grasp.task.hand),
    )
    plan = ManipulationPlan(
        motion=motion,
        gait=gait,
        angle=file.angle_rad,
        shift=np.array(file.shift_m),
        ending=Ending(
            T_world_target=file.ending.T_world_target.pose(),
            release=release,
            back=file.ending.made_backwards_because,
        ),
        reserve=file.torque_reserve,
        attempts=file.attempts,
        cpu_s=file.cpu_s,
    )
    fault = _fault(plan)
    if fault:
        raise FileFormatError(f"{source}: {fault}; it is damaged")
    return plan


def _fault(plan: ManipulationPlan) -> str:
    """What a plan tells that does not follow from its motion, "" if nothing."""
    motion, ending = plan.motion, plan.ending
    path, whole = motion.path, (plan.gait or motion.path)
    if plan.angle * whole.angle < 0.0 or abs(plan.angle) > abs(whole.angle) + SAME:
        return (
            f"it is to turn by {np.rad2deg(plan.angle):.1f} degrees and its motion by "
            f"{np.rad2deg(whole.angle):.1f}"
        )
    share = plan.angle / whole.angle if whole.angle else 1.0
    if not np.allclose(share * whole.shift, plan.shift, rtol=0.0, atol=SAME):
        return "its translation is not that of its motion"
    x, y, _ = ending.T_world_target.translation
    made = 0.0 if ending.back else plan.angle
    target = object_at_target(plan.task, path.axis, made, (x, y))
    if not target.isApprox(ending.T_world_target, SAME):
        return "its object does not stand at its target as it was turned"
    if ending.back:
        grasp, way_in = ending.release, backwards(motion, (x, y), ending.back).release
        same = np.allclose(grasp.q, way_in.q, rtol=0.0, atol=SAME)
        if not (same and grasp.T_world_base_start.isApprox(way_in.T_world_base_start, SAME)):
            return "its way out is not its way in, though the motion is made backwards"
    elif fault := verify_release(motion, ending.release):
        return f"its way out fails its checks: {fault}"
    if abs(torque_reserve(motion) - plan.reserve) > RESERVE_TOL:
        return "its torque reserve is not that of its forces"
    return ""


RESERVE_TOL = 1e-3
"""How far (-) a torque reserve may be from that of the forces that are computed again."""
