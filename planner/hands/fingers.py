"""What a hand touches with: pads, fingers, and the sides of two hands."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from planner.spatial import FloatArray, IntArray

__all__ = ["Finger", "Pad", "Side"]


@dataclass(frozen=True, kw_only=True)
class Pad:
    """Spherical contact pad, fixed in a joint's frame.

    Attributes:
        geom: Collision geometry whose surface it is part of.
        joint_id: Pinocchio joint it moves with.
        center: (3,), m, in the joint's frame.
        axis: (3,), unit, in the joint's frame: where the pad faces.
        radius: m.
        half_angle: rad; contact points lie within this cone about the axis.
        rolling_axis: (3,), unit: middle of the cone within which contacts may roll.
        rolling_half_angle: rad; of that cone. Without a description, both equal ``axis`` and
            ``half_angle``.
        reach: (k, 3), m, orthogonal, in the joint's frame: the sphere stands for all that have
            their centre at most these away from ``center``, along a link or in a face; none
            (0, 3) at a fingertip.
    """

    geom: str
    joint_id: int
    center: FloatArray
    axis: FloatArray
    radius: float
    half_angle: float
    rolling_axis: FloatArray
    rolling_half_angle: float
    reach: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))

    def beyond_reach(self, off: FloatArray, turn: FloatArray, most: float = 1.0) -> FloatArray:
        """What is left of an offset (3,) from the pad's centre that its reach does not take up.

        Args:
            off: m, in any axes.
            turn: Rotation (3, 3) of the pad's joint in those axes.
            most: How many times its reach may be taken up (-).
        """
        for along in self.reach @ turn.T:
            off = off - np.clip(off @ along / (along @ along), -most, most) * along
        return off

    @property
    def rolling(self) -> Pad:
        """The same pad with the cone within which contacts may roll."""
        return replace(self, axis=self.rolling_axis, half_angle=self.rolling_half_angle)


@dataclass(frozen=True, kw_only=True)
class Finger:
    """One finger.

    Attributes:
        name: Its name in the description.
        joints: Joint names from the palm outwards.
        q_index: (n,), where those joints stand in q.
        tip_frame: Name of the tip frame (a site), also in ``pin_model``.
        tip_frame_id: Its number in ``pin_model.frames``.
        pad: Where it touches.
        bodies: Names of the bodies that belong to the finger.
        is_link: Whether it is no finger but a link that can touch, or the palm: a finger that ends
            early (``planner.hands.link_pads``).
    """

    name: str
    joints: tuple[str, ...]
    q_index: IntArray
    tip_frame: str
    tip_frame_id: int
    pad: Pad
    bodies: frozenset[str]
    is_link: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class Side:
    """One hand of two, or the only one.

    Attributes:
        name: Its name in the description of the pair; "" of the only one.
        palm_body: Body of its palm.
        palm_normal: Direction the palm faces (3,), unit, in that body's frame.
        carriage: Where the joints of its carriage stand in q (6,); empty for the only one.
        fingers: Names of its fingers.
        alone: The ``Hand`` alone, of two; None of the only one.
    """

    name: str
    palm_body: str
    palm_normal: FloatArray
    carriage: IntArray
    fingers: tuple[str, ...]
    alone: Any = None

    def called(self, name: str) -> str:
        """What a body, joint or geometry of the hand alone is called in the whole."""
        return f"{self.name}/{name}" if self.name else name
