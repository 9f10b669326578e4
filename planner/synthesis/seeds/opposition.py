"""How the fingers of a hand oppose each other in its postures, measured once for many starts."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.kinematics import moving_hand
from planner.spatial import FloatArray, cross
from planner.synthesis.link_spheres import LinkSphere
from planner.task import GraspTask

ALIKE = 8
"""Postures of about the wanted gap among which one is drawn."""


@dataclass(frozen=True, kw_only=True)
class Opposition:
    """How the fingers of a hand oppose each other in a posture, in the base's frame.

    Attributes:
        opposer: Number of the finger that opposes the others.
        axis: (3,), unit, from the opposer's pad to the mean of the others'.
        center: (3,), m, half-way between.
        palm_side: (3,), unit, from the centre to the palm, orthogonal to ``axis``.
        gap: Free width between the pads along the axis, m.
    """

    opposer: int
    axis: FloatArray
    center: FloatArray
    palm_side: FloatArray
    gap: float


def opposition(task: GraspTask, q: FloatArray) -> Opposition:
    """Opposition of the task's fingers at q."""
    state = moving_hand(task.hand).move(q)
    fingers = task.fingers
    n = len(fingers)
    centers = np.array([state.pad_center(f) for f in fingers])
    axes = np.array([state.pad_axis(f) for f in fingers])
    # the opposer's pad faces against the sum of the other pads
    opposer = int((axes @ axes.sum(axis=0)).argmin())
    rest = np.arange(n) != opposer
    others = centers[rest].sum(axis=0) / (n - 1)
    across = others - centers[opposer]
    width = math.sqrt(float(across @ across))
    axis = across / width
    center = (others + centers[opposer]) / 2
    side = np.array(state.T_base_palm.act(task.hand.palm_point)) - center
    side -= axis * (axis @ side)
    radii = [f.pad.radius for f in fingers]
    beside = (sum(radii) - radii[opposer]) / (n - 1)
    return Opposition(
        opposer=opposer,
        axis=axis,
        center=center,
        palm_side=side / math.sqrt(float(side @ side)),
        gap=width - radii[opposer] - beside,
    )


def frame_of(axis: FloatArray, side: FloatArray) -> FloatArray:
    """Rotation (3, 3) whose columns are two orthogonal unit vectors and their product."""
    return np.array([axis, side, cross(axis, side)]).T


@dataclass(frozen=True, kw_only=True, eq=False)
class Postures:
    """m postures of a hand, in its base's frame.

    Attributes:
        q: (m, nq).
        gaps: Free width between the pads, (m,), m, ascending.
        centers: Half-way between opposed pads (m, 3), m.
        frames: (m, 3, 3), columns: opposition axis, direction of the palm, their product.
        spheres: Centres of link spheres (m, b, 3), m.
        pads: Centres of the pads (m, n, 3), m.
        facing: Axes of the pads (m, n, 3), unit.
    """

    q: FloatArray
    gaps: FloatArray
    centers: FloatArray
    frames: FloatArray
    spheres: FloatArray
    pads: FloatArray
    facing: FloatArray

    def draw(self, gap: float, rng: np.random.Generator) -> int:
        """Number of a posture that leaves about a gap (m)."""
        middle = int(np.searchsorted(self.gaps, gap))
        first = min(max(middle - ALIKE // 2, 0), max(len(self.gaps) - ALIKE, 0))
        return int(rng.integers(first, min(first + ALIKE, len(self.gaps))))


def measure_postures(
    hand: Hand,
    fingers: Sequence[Finger],
    spheres: Sequence[LinkSphere],
    drawn: Sequence[FloatArray],
    opposed: Callable[[FloatArray], Opposition],
) -> Postures:
    """Where pads and links are in postures (m, nq).

    Args:
        hand: The hand.
        fingers: Fingers that take part.
        spheres: Spheres in the links.
        drawn: The postures.
        opposed: How the fingers oppose each other in one.
    """
    found = [opposed(q) for q in drawn]
    order = np.argsort([o.gap for o in found], kind="stable")
    joints = np.array([b.joint_id for b in spheres])
    local = np.array([b.center for b in spheres])[:, :, None]
    places, pads, facing = [], [], []
    for k in order:
        state = moving_hand(hand).move(drawn[k])
        poses = state.pin_data.oMi
        turns = np.array([pose.rotation for pose in poses])[joints]
        shifts = np.array([pose.translation for pose in poses])[joints]
        places.append((turns @ local)[:, :, 0] + shifts)
        pads.append([state.pad_center(f) for f in fingers])
        facing.append([state.pad_axis(f) for f in fingers])
    return Postures(
        q=np.array([drawn[k] for k in order]),
        gaps=np.array([found[k].gap for k in order]),
        centers=np.array([found[k].center for k in order]),
        frames=np.array([frame_of(found[k].axis, found[k].palm_side) for k in order]),
        spheres=np.array(places),
        pads=np.array(pads),
        facing=np.array(facing),
    )
