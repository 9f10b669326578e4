"""One hold: 2 s in MuJoCo under gravity, with position commands alone; a state, or why it is lost.

The state that is kept is the one at the END of the hold, with velocities zero. By then the drawn
errors of pose, joints and commands have settled, and the second half of the hold has shown how far
it still creeps. The state at the beginning holds the same errors as penetrations and gaps: a
simulator that loads it would have to live through the same transient.

A hold ends early once the object is lost. Its tests, with their numbers, are the constants below.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import mujoco
import numpy as np

from planner.spatial import FloatArray
from sim.reset_states.scene import HoldScene

HOLD_S = 2.0
"""Duration of a hold, s."""

LOOKS = (0.025, 0.05, 0.1, 0.15, 0.25, 0.4, 0.6, 0.8, 1.0, 1.5, 2.0)
"""Shares of half a hold (s of its 2 s) after which the object is looked at, so that a hold that has
failed ends."""

HALF = 1.0
"""When the second half begins, in the unit of ``LOOKS``."""

FAR = 0.03
"""Distance (m) from the start beyond which the object counts as dropped."""

SLIP, SLIP_ANGLE = 0.001, float(np.deg2rad(2.0))
"""Most that the object may move (m) and turn (rad) in the second half: a fifth and two fifths of
what counts as lost afterwards, over half of that time."""

SPEED, SPIN, JOINT_SPEED = 0.005, 0.1, 0.1
"""Most that may be left at the end, m/s, rad/s, and rad/s or m/s."""

DEEPEST = 0.001
"""Deepest penetration (m) between object and hand, or hand and hand."""

BEYOND = 0.02
"""How far (rad or m) a joint may be pressed beyond its limit, which MuJoCo holds softly."""

FEWEST = 2
"""Fewest parts of the hand that touch the object, the palm counted as one finger."""

BAD_NUMBERS = (
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
)
"""MuJoCo's warnings of numbers that are not finite or huge."""

DIVERGED, DROPPED, SLIPPED, MOVING, PENETRATES, LIMITS, LOOSE = (
    "numbers not finite",
    f"dropped: the object went over {1e3 * FAR:g} mm from where it began",
    f"slipped over {1e3 * SLIP:g} mm or {np.degrees(SLIP_ANGLE):g} degrees in the second half",
    f"still moving: over {1e3 * SPEED:g} mm/s or {SPIN:g} rad/s",
    f"penetrates by over {1e3 * DEEPEST:g} mm",
    f"hits limits: a joint over {BEYOND:g} rad beyond its end",
    f"touched by fewer than {FEWEST} fingers",
)
REASONS = (DIVERGED, DROPPED, SLIPPED, MOVING, PENETRATES, LIMITS, LOOSE)
"""Why a hold is lost, in the order in which they are looked for."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Held:
    """The end of a hold.

    Attributes:
        reason: One of ``REASONS``; "" if it was held.
        q: Joints (nq,), rad or m.
        position: Of the object (3,), m.
        quaternion: Its orientation, w, x, y, z.
        steps: Time steps that were made.
    """

    reason: str
    q: FloatArray
    position: FloatArray
    quaternion: FloatArray
    steps: int


def hold(scene: HoldScene) -> Held:
    """Hold the state that was put into a scene.

    Args:
        scene: With mass, friction, gravity, and the state at rest with its commands.
    """
    model, data = scene.model, scene.data
    half = HOLD_S / 2.0 / model.opt.timestep
    begin = np.array(data.qpos[scene.object_qpos])
    middle, reason, made = begin, "", 0
    for since, until in pairwise((0.0, *LOOKS)):
        steps = round(until * half) - round(since * half)
        mujoco.mj_step(model, data, steps)
        made += steps
        now = np.array(data.qpos[scene.object_qpos])
        reason = _lost(data, begin, now)
        if reason:
            break
        if until == HALF:
            middle = now
    if not reason:
        reason = _doubtful(scene, middle, now)
    quaternion = now[3:] / np.linalg.norm(now[3:])
    return Held(
        reason=reason,
        q=np.array(data.qpos[scene.qpos]),
        position=now[:3],
        quaternion=quaternion if quaternion[0] >= 0 else -quaternion,
        steps=made,
    )


def _lost(data: Any, begin: FloatArray, now: FloatArray) -> str:
    """Why a hold need not go on; "" if it may."""
    if any(data.warning[what].number for what in BAD_NUMBERS) or not np.isfinite(now).all():
        return DIVERGED
    return DROPPED if np.linalg.norm(now[:3] - begin[:3]) > FAR else ""


def _doubtful(scene: HoldScene, middle: FloatArray, end: FloatArray) -> str:
    """Why a hold that came to its end is no stable state; "" if it is one."""
    model, data = scene.model, scene.data
    turned = 2.0 * np.arccos(min(1.0, abs(float(middle[3:] @ end[3:]))))
    if np.linalg.norm(end[:3] - middle[:3]) > SLIP or turned > SLIP_ANGLE:
        return SLIPPED
    twist, joints = data.qvel[scene.object_qvel], data.qvel[scene.qvel]
    moving = np.linalg.norm(twist[:3]) > SPEED or np.linalg.norm(twist[3:]) > SPIN
    if moving or np.abs(joints).max() > JOINT_SPEED:
        return MOVING
    mujoco.mj_forward(model, data)  # contacts of the pose that is kept
    if data.ncon and data.contact.dist[: data.ncon].min() < -DEEPEST:
        return PENETRATES
    if _beyond_limits(scene):
        return LIMITS
    return LOOSE if len(_touching(scene)) < FEWEST else ""


def _beyond_limits(scene: HoldScene) -> bool:
    model, q = scene.model, scene.data.qpos[scene.qpos]
    joints = model.dof_jntid[scene.qvel]
    low, high = model.jnt_range[joints].T
    outside = np.maximum(low - q, q - high)[model.jnt_limited[joints].astype(bool)]
    return bool(outside.size and outside.max() > BEYOND)


def _touching(scene: HoldScene) -> set[str]:
    """Fingers that press on the object, "" for the palm."""
    found = set()
    for contact in scene.data.contact[: scene.data.ncon]:
        pair = [int(g) for g in contact.geom]
        if len(scene.geoms.intersection(pair)) == 1 and contact.efc_address >= 0:
            other = pair[0] if pair[1] in scene.geoms else pair[1]
            found.add(scene.finger_of_geom[other])
    return found
