"""``PlanMark``: which plan a log is of, so that it is replayed with that plan and no other."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from planner.plan import GraspPlan
from planner.shapes import shape_key

DIGITS = 9
"""Decimals of numbers that count: a plan that was written and read is the same to rounding."""


@dataclass(frozen=True, kw_only=True)
class PlanMark:
    """What identifies a plan.

    Attributes:
        hand: Name of its hand.
        hand_sha256: Digest of the hand's files.
        object: Specification of its object.
        sha256: Digest of hand, object, mass, friction, gravity, grip and of the grasp's joints and
            poses.
    """

    hand: str
    hand_sha256: str
    object: str
    sha256: str

    @classmethod
    def of(cls, plan: GraspPlan) -> PlanMark:
        """That of a plan; the same before the plan is written and after it is read."""
        task = plan.task
        numbers: tuple[Any, ...] = (
            *(task.object.mass, task.mu, task.grip_force, task.gravity),
            *(task.T_world_object.homogeneous, plan.T_world_base.homogeneous),
            *(plan.T_world_base_start.homogeneous, plan.q, plan.q_pregrasp),
        )
        content = [
            task.hand.digest,
            shape_key(task.object.shape),
            task.finger_names,
            [(np.round(n, DIGITS) + 0.0).tolist() for n in numbers],  # + 0.0: no minus zero
        ]
        return cls(
            hand=task.hand.name,
            hand_sha256=task.hand.digest,
            object=task.object.shape.spec,
            sha256=hashlib.sha256(json.dumps(content).encode()).hexdigest(),
        )

    def to_dict(self) -> dict[str, str]:
        """Plain data."""
        return asdict(self)

    def difference(self, other: PlanMark) -> str:
        """What the two plans differ in, for people; "" if they are the same."""
        if self.sha256 == other.sha256:
            return ""
        if self.hand_sha256 != other.hand_sha256:
            same_name = self.hand == other.hand
            return f"another {self.hand}" if same_name else f"{self.hand}, not of {other.hand}"
        if self.object != other.object:
            return f"{self.object}, not of {other.object}"
        return f"another grasp of {self.object} by {self.hand}"
