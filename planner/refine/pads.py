"""Where the pads of a given hand pose belong on an object, and which fingers take part.

A pad belongs to the nearest point of the surface, unless it faces away from that: a pad that has
sunk half through a thin wall, or one beyond the edge of a box. Then the point is the first that it
does not face away from, of those nearest to a few places behind the pad.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planner.collision.moving_hand import moving_hand
from planner.failure import Failure
from planner.hands.fingers import Finger
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask

BEHIND = np.array([0.0, 0.004, 0.008, 0.014, 0.02])
"""Distances (m) behind a pad's centre from which the surface is looked for, in this order."""

FACED = 0.0
"""Least cosine between where a pad faces and the inward normal at the point that it belongs to: the
pad does not face away from it. With 0.5 contacts count as displaced by less, and the true nearest
points of a tilted pad are missed more often."""

NEAR = 0.025
"""Gap (m) up to which a finger takes part in a given grasp: twice what the hands of data sets are
off by, and less than the distance of a finger that is meant to be away."""

FARTHEST = 0.08
"""Gap (m) up to which the nearest of the other fingers are taken where too few are near."""


@dataclass(frozen=True, kw_only=True)
class UnderPads:
    """Surface points under pads, in the object's frame.

    Attributes:
        points: (n, 3), m.
        outward: Unit normals there (n, 3).
        gaps: Signed distance of each pad's sphere from its nearest point of the surface (n,), m.
        axes: Directions in which the pads face (n, 3).
    """

    points: FloatArray
    outward: FloatArray
    gaps: FloatArray
    axes: FloatArray


def under_pads(
    task: GraspTask, T_world_base: SE3, q: FloatArray, fingers: Sequence[Finger]
) -> UnderPads:
    """Where the pads of some fingers belong on the task's object.

    Args:
        task: Hand and object.
        T_world_base: Base pose.
        q: Joints (nq,).
        fingers: The fingers.
    """
    base, state = task.T_world_object.inverse() * T_world_base, moving_hand(task.hand).move(q)
    centers = np.array([base.act(state.pad_center(f)) for f in fingers])
    axes = np.array([base.rotation @ state.pad_axis(f) for f in fingers])
    radii = np.array([f.pad.radius for f in fingers])
    n, m = len(fingers), len(BEHIND)
    behind = centers[:, None] - BEHIND[:, None] * axes[:, None]
    points, outward = (
        v.reshape(n, m, 3) for v in task.object.shape.closest_point(behind.reshape(-1, 3))
    )
    gaps = np.einsum("ik,ik->i", centers - points[:, 0], outward[:, 0]) - radii
    facing = -np.einsum("ijk,ik->ij", outward, axes)
    faced = facing >= FACED
    first = np.where(faced.any(axis=1), faced.argmax(axis=1), 0)
    each = np.arange(n)
    return UnderPads(
        points=points[each, first],
        outward=outward[each, first],
        gaps=gaps,
        axes=axes,
    )


def fingers_near(
    task: GraspTask, T_world_base: SE3, q: FloatArray
) -> tuple[tuple[str, ...], ...] | Failure:
    """Fingers that take part in a given grasp: the sets to try, the likeliest first.

    All fingers of the hand are asked, also those that are none of its default ones.

    Args:
        task: Hand and object.
        T_world_base: Base pose.
        q: Joints (nq,).

    Returns:
        At least one set of names, or why there is none: too few pads come near.
    """
    fingers = tuple(task.hand.fingers.values())
    gaps = under_pads(task, T_world_base, q, fingers).gaps
    touch = task.object.touch
    needed = set(touch.required) if touch is not None else set()
    order = sorted(range(len(fingers)), key=lambda i: (fingers[i].name not in needed, gaps[i]))
    near = sum(gaps[i] <= NEAR or fingers[i].name in needed for i in order)
    most = sum(gaps[i] <= FARTHEST for i in order)
    if most < task.fingers_needed:
        return _too_few(task, [fingers[i].name for i in order], gaps[order], most)
    first = max(near, task.fingers_needed)
    # one less, then one more: of those left the farthest goes, or the next one comes
    counts = [first, first - 1, first + 1]
    sets = [order[:k] for k in counts if task.fingers_needed <= k <= most]
    return tuple(tuple(f.name for i, f in enumerate(fingers) if i in one) for one in sets)


def _too_few(task: GraspTask, names: list[str], gaps: FloatArray, near: int) -> Failure:
    """The failure of a pose with too few pads near the object; names and gaps, nearest first."""
    said = (
        f"no pad comes near {task.object.name}"
        if near == 0
        else f"only {near} of {len(names)} pads come near {task.object.name}, and a grasp needs "
        f"{task.fingers_needed}"
    )
    listed = ", ".join(f"{n} {1e3 * g:.0f} mm" for n, g in zip(names, gaps, strict=True))
    return Failure(
        kind="too_few_pads",
        text=f"{said}: gaps are {listed} (allowed {1e3 * FARTHEST:.0f}); check the frame "
        "and the units of the pose",
        numbers={"near": float(near), "nearest": float(gaps.min())},
    )
