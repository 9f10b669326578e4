"""Postures in which a hand may start: from pinch to open and beyond, with noise, measured once.

The seeder of meshes takes those whose pads leave the gap that it needs, and has their links' places
at hand without asking for kinematics again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.kinematics.state import HandState
from planner.spatial import FloatArray
from planner.synthesis.link_spheres import LinkSphere
from planner.synthesis.seeds.draw import Opposition, frame_of

__all__ = ["Postures", "measure_postures"]

ALIKE = 8
"""Postures of about the wanted gap among which one is drawn."""


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
    """

    q: FloatArray
    gaps: FloatArray
    centers: FloatArray
    frames: FloatArray
    spheres: FloatArray
    pads: FloatArray

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
    places, pads = [], []
    for k in order:
        state = HandState(hand, drawn[k])
        poses = state.pin_data.oMi
        turns = np.array([pose.rotation for pose in poses])[joints]
        shifts = np.array([pose.translation for pose in poses])[joints]
        places.append((turns @ local)[:, :, 0] + shifts)
        pads.append([state.pad_center(f) for f in fingers])
    return Postures(
        q=np.array([drawn[k] for k in order]),
        gaps=np.array([found[k].gap for k in order]),
        centers=np.array([found[k].center for k in order]),
        frames=np.array([frame_of(found[k].axis, found[k].palm_side) for k in order]),
        spheres=np.array(places),
        pads=np.array(pads),
    )
