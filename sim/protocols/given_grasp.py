"""A hold trial of a grasp that somebody else made, verified or not, by position commands alone.

The world, its physics and the steps are those of ``sim.protocols.dexgraspbench``: a hand welded at
its pose, a free object without gravity, servos led from the pre-grasp to the grasp and to the
squeeze in 10 stages of 10 steps each. Then the object's weight pulls at its centre of mass for 2 s,
along the gravity of the task. It is held if it stays within 50 mm and 15 degrees of where it was.

A file without a pre-grasp begins at the grasp. One without a squeeze gets that of our own exports
(``planner.exchange.dexgraspbench.plan_squeeze``) where the nearest surface points of the pads can
press; else the closing motion goes on as far again, as BODex has it, and without a pre-grasp the
grasp itself is commanded, which hardly presses.
"""

from __future__ import annotations

import mujoco
import numpy as np

from planner.exchange.audit import StageResult
from planner.exchange.audit.judge import T_world_base
from planner.exchange.dexgraspbench import plan_squeeze
from planner.exchange.formats import GivenGrasp
from planner.spatial import SE3, FloatArray, pose_change, pose_from_wxyz
from planner.task import GraspTask
from planner.verification.geometry import contacts_at
from sim.protocols.dexgraspbench import FAR, STAGES, unsuitable_for_dexgraspbench
from sim.protocols.dexgraspbench_scene import benchmark_scene
from sim.verdict import lost

STEPS = 10
"""Time steps of a stage."""

HOLD_S = 2.0
"""How long the weight pulls, s."""


def hold_given_grasp(task: GraspTask, grasp: GivenGrasp) -> StageResult:
    """Execute a grasp; its number is how far the object moved, mm.

    Args:
        task: Hand, object and its mass, gravity.
        grasp: The grasp.

    Raises:
        ModelError: MuJoCo refuses the scene.
    """
    if reason := unsuitable_for_dexgraspbench(task.hand):
        return StageResult(passed=None, reason=reason)
    base = T_world_base(task, grasp)
    scene, _ = benchmark_scene(task, base)
    actuation = task.hand.actuation
    before = grasp.q if grasp.q_pregrasp is None else grasp.q_pregrasp
    opened, closed = (actuation.moment @ q + actuation.length0 for q in (before, grasp.q))
    pressed = _squeeze(task, grasp, base)
    data = scene.start(np.array(before), base)
    begin = _object_pose(data.qpos[scene.object_qpos])
    for first, last in ((opened, closed), (closed, pressed)):
        for stage in range(1, STAGES + 1):
            data.ctrl[scene.hand_ctrl] = first + stage / STAGES * (last - first)
            for _ in range(STEPS):
                mujoco.mj_step(scene.model, data)
    data.xfrc_applied[scene.object_body, :3] = task.object.mass * task.gravity
    worst = (0.0, 0.0)
    for _ in range(round(HOLD_S / scene.model.opt.timestep)):
        mujoco.mj_step(scene.model, data)
        if (
            not np.isfinite(data.qpos).all()
            or data.warning.number[mujoco.mjtWarning.mjWARN_BADQACC]
        ):
            return StageResult(passed=False, reason="the simulation diverged")
        worst = pose_change(begin, _object_pose(data.qpos[scene.object_qpos]))
        if lost(FAR, touching=0, moved=worst):
            break
    held = not lost(FAR, touching=0, moved=worst)
    reason = "" if held else f"the object moved {worst[0]:.1f} mm and turned {worst[1]:.1f} degrees"
    return StageResult(passed=held, number=worst[0], reason=reason)


def _squeeze(task: GraspTask, grasp: GivenGrasp, base: SE3) -> FloatArray:
    """Commands (nu,) that press."""
    actuation = task.hand.actuation
    if grasp.q_squeeze is not None:
        return np.asarray(actuation.moment @ grasp.q_squeeze + actuation.length0)
    q = np.array(grasp.q)
    planned = plan_squeeze(task, contacts_at(task, base, q), base, q)
    if not planned.reason:
        return planned.ctrl
    before = q if grasp.q_pregrasp is None else grasp.q_pregrasp
    return np.asarray(actuation.moment @ (2.0 * q - before) + actuation.length0)


def _object_pose(qpos: FloatArray) -> SE3:
    return pose_from_wxyz(qpos[:3], qpos[3:])
