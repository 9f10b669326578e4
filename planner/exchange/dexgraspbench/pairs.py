"""Grasps of two hands as BimanDexGraspBench reads them: both hands of one model on arms.

Read from https://github.com/DexGrasp-TH/BimanDexGraspBench at commit 48ef8a6: ``src/task/eval_func/
base.py`` for the keys, ``fc_arm.py`` for the test, ``src/util/hand_util.py`` for qpos and ctrl. An
evaluation is that of DexGraspBench, but for the hand: its model is fixed in the world, qpos has no
pose of a base but joints of arms, in the order of ``joint_names``.

The pair that plans has a carriage for each hand; the benchmark's model ``dual_dummy_arm_shadow``
has an arm of three slides and three hinges with servos of its own. A grasp is given to it as it is:
palms where they are planned, fingers by the joints of the same name, and commands that press with
the same forces by the servos of that model. Nothing there has weight, so that the whole may stand
in any way: of random ones the one is taken in which the arms are farthest from their singular
posture, a middle hinge at a right angle.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from planner.bridge import actuation_from_mujoco, compile_spec, load_spec, pinocchio_from_mujoco
from planner.errors import ModelError, TaskError
from planner.exchange.dexgraspbench.export import MASS, Squeeze, plan_squeeze
from planner.exchange.dexgraspbench.models import frame_shift
from planner.hands.hand import Hand
from planner.hands.two_hands import carriage_joints
from planner.joints.actuation import Actuation
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray, IntArray, pose_from_wxyz, pose_to_wxyz

STANCES = 60
"""Random orientations of the whole that are tried."""

EXACT = 1e-9
"""Largest deviation (m, -) of a palm from where it is to be."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PairModel:
    """A model with two hands on arms of six joints; names of its parts may lack the pair's prefix.

    Attributes:
        names: Its joints, in their order.
        arms: Where the joints of both arms stand among them (2, 6).
        palms: Frames of both palms.
        fingers: Where the other joints stand in q of the pair that plans, and here (n, 2).
        pin_model: ``pinocchio.Model``.
        actuation: Its servos.
        hand: The pair that plans.
    """

    names: tuple[str, ...]
    arms: IntArray
    palms: IntArray
    fingers: IntArray
    pin_model: Any
    actuation: Actuation
    hand: Hand

    @classmethod
    def of(cls, path: Path, hand: Hand) -> PairModel:
        """The model of a file, for a pair whose hands have its bodies and joints.

        Args:
            path: Its MJCF file.
            hand: The pair.

        Raises:
            TaskError: It is one hand, or on arms, or has other bodies or joints.
            ModelError: Its arms are not three slides and three hinges about x, y and z.
        """
        if not hand.pair:
            raise TaskError(f"{hand.name} is one hand; plan with two, of the joints of {path}")
        if hand.on_arm:
            raise TaskError(
                f"{hand.name} is on arms of its own; plan with two hands on carriages, for which "
                f"the arms of {path} stand"
            )
        model = compile_spec(load_spec(path), str(path))
        pin_model = pinocchio_from_mujoco(model)
        names = tuple(pin_model.names[1:])
        palms, arms = [], []
        for side in hand.sides:
            alone = side.palm_body.removeprefix(side.called(""))
            palm = side.palm_body if pin_model.existBodyName(side.palm_body) else alone
            if not pin_model.existBodyName(palm):
                raise TaskError(f"{path} has no body {palm!r}, the palm of {side.name} in the pair")
            frame = pin_model.getBodyId(palm)
            palms.append(frame)
            above = pin_model.supports[pin_model.frames[frame].parentJoint]
            arms.append([int(j) - 1 for j in above if j > 0])
        if any(len(arm) != len(hand.sides[0].carriage) for arm in arms):
            raise ModelError(f"the arms of {path} have not six joints each: {arms}")
        pairs = []
        for side in hand.sides:
            for k, name in enumerate(hand.joint_names):
                if name.startswith(side.called("")) and k not in side.carriage:
                    here = name if name in names else name.removeprefix(side.called(""))
                    if here not in names:
                        raise TaskError(f"{path} has no joint {here!r}, which {side.name} has")
                    pairs.append((k, names.index(here)))
        return cls(
            names=names,
            arms=np.array(arms),
            palms=np.array(palms),
            fingers=np.array(pairs),
            pin_model=pin_model,
            actuation=actuation_from_mujoco(model),
            hand=hand,
        )

    def joints(self, T_world_base: SE3, q: FloatArray) -> FloatArray:
        """Joints here (nq,) at which palms and fingers are where those of the pair are.

        Args:
            T_world_base: Base of the pair, in the world of this model.
            q: Joints of the pair.

        Raises:
            ModelError: The arms are not three slides and three hinges about x, y and z.
        """
        out = np.zeros(len(self.names))
        out[self.fingers[:, 1]] = q[self.fingers[:, 0]]
        palms = _frames(self.hand.pin_model, q, _palms(self.hand))
        wanted = [T_world_base * pose for pose in palms]
        rest = self.pin_model.createData()
        pin.framesForwardKinematics(self.pin_model, rest, np.zeros(len(self.names)))
        for arm, palm, pose in zip(self.arms, self.palms, wanted, strict=True):
            wrist = rest.oMi[int(arm[-1]) + 1]
            there = pose * (wrist.inverse() * rest.oMf[int(palm)]).inverse()
            out[arm] = carriage_joints(wrist.inverse() * there)
        for pose, found in zip(wanted, _frames(self.pin_model, out, self.palms), strict=True):
            if not found.isApprox(pose, EXACT):
                raise ModelError(
                    "the arms of the model are not three slides and three hinges about x, y and z"
                )
        return out

    def squeezed(
        self, T_world_base: SE3, q: FloatArray, q_here: FloatArray, torques: FloatArray
    ) -> FloatArray:
        """Joints (nq,) to be commanded here so that palms and fingers press as those of the pair.

        Args:
            T_world_base: Base of the pair, in the world of this model.
            q: Joints of the pair.
            q_here: Joints here at the same posture.
            torques: Of the pair's joints (nq of the pair,), N and N m.
        """
        here = np.zeros(len(self.names))
        here[self.fingers[:, 1]] = torques[self.fingers[:, 0]]
        theirs = _jacobians(self.hand.pin_model, q, _palms(self.hand))
        ours = _jacobians(self.pin_model, q_here, self.palms)
        for side, arm, given, own in zip(self.hand.sides, self.arms, theirs, ours, strict=True):
            wrench = np.linalg.solve(given[:, side.carriage].T, torques[side.carriage])
            turn = T_world_base.rotation
            world = np.concatenate([turn @ wrench[:3], turn @ wrench[3:]])
            here[arm] = own[:, arm].T @ world
        ctrl, _ = self.actuation.ctrl_for_torque(q_here, np.zeros_like(q_here), here)
        moment = self.actuation.moment
        out: FloatArray = q_here + np.linalg.pinv(moment) @ (ctrl - moment @ q_here)
        return out

    def stance(self, T_object_base: SE3, q: FloatArray, seed: int) -> FloatArray:
        """Orientation (3, 3) of the object within the arms' range, the farthest from singular.

        Raises:
            TaskError: In none that is tried all joints of the arms are within their range.
        """
        rng = np.random.default_rng(seed)
        quaternions = rng.normal(size=(STANCES, 4))
        quaternions /= np.linalg.norm(quaternions, axis=1)[:, None]
        tried = [pose_from_wxyz(np.zeros(3), one).rotation for one in quaternions]
        middle = self.arms[:, 4]

        low, high = self.pin_model.lowerPositionLimit, self.pin_model.upperPositionLimit

        def worst(turn: FloatArray) -> tuple[float, float]:
            there = self.joints(SE3(turn, np.zeros(3)) * T_object_base, q)
            beyond = np.maximum(low - there, there - high)[self.arms]
            return max(float(beyond.max()), 0.0), float(np.abs(there[middle]).max())

        best: FloatArray = min(tried, key=worst)
        if worst(best)[0] > 0.0:
            raise TaskError(
                f"in none of {STANCES} orientations the arms of the benchmark's model reach the "
                "grasp; use a smaller object, or another grasp of it"
            )
        return best


def pair_squeeze(plan: GraspPlan, mass: float = MASS) -> Squeeze:
    """The squeeze of a grasp by two hands for an object of that mass (kg); nothing lifts it."""
    given = plan.task, plan.contacts, plan.T_world_base, plan.q
    return plan_squeeze(*given, mass=mass, lifted=False)


def pair_dict(
    plan: GraspPlan, squeeze: Squeeze, model: PairModel, obj_path: Path
) -> Mapping[str, Any]:
    """A grasp in the benchmark's form; see the module.

    Args:
        plan: By two hands.
        squeeze: Of the plan.
        model: The benchmark's model of both hands.
        obj_path: The object's folder.
    """
    T_object_base = plan.task.T_world_object.inverse() * plan.T_world_base
    T_world_object = SE3(model.stance(T_object_base, plan.q, plan.record.seed), np.zeros(3))
    base = T_world_object * T_object_base
    q = model.joints(base, plan.q)
    opened = model.joints(base, plan.q_pregrasp)
    # the same posture of a hinge, not a turn away from it
    opened[model.arms] += 2 * np.pi * np.round((q - opened)[model.arms] / (2 * np.pi))
    to_file = SE3(np.eye(3), -frame_shift(plan.task.object.shape))
    return {
        "obj_path": str(obj_path),
        "obj_scale": 1.0,
        "obj_pose": np.concatenate(pose_to_wxyz(T_world_object * to_file)),
        "joint_names": list(model.names),
        "pregrasp_qpos": opened,
        "grasp_qpos": q,
        "squeeze_qpos": model.squeezed(base, plan.q, q, squeeze.torques),
    }


def _palms(hand: Hand) -> IntArray:
    return np.array([hand.pin_model.getBodyId(side.palm_body) for side in hand.sides])


def _frames(model: Any, q: FloatArray, frames: IntArray) -> list[SE3]:
    """Poses of frames."""
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return [data.oMf[int(k)].copy() for k in frames]


def _jacobians(model: Any, q: FloatArray, frames: IntArray) -> list[FloatArray]:
    """Of frames (6, nv) each, linear rows first, about their origins, in the axes of the root."""
    data = model.createData()
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    return [
        np.array(pin.getFrameJacobian(model, data, int(k), pin.LOCAL_WORLD_ALIGNED)) for k in frames
    ]
