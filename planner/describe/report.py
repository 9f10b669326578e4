"""``CheckReport``: the findings of ``check_hand``, as plain data.

Each finding says what to do. "error" forbids planning, "warning" costs grasps or realism, "note" is
worth knowing.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal

from planner.arrays import finite, short_repr

Level = Literal["error", "warning", "note"]


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One finding: its level, the fact, the remedy."""

    level: Level
    what: str
    what_to_do: str


class Findings(list[Finding]):
    """What a check has found, in the order in which it was found."""

    def add(self, level: Level, what: str, what_to_do: str) -> None:
        """Note a finding."""
        self.append(Finding(level=level, what=what, what_to_do=what_to_do))

    def error(self, what: str, what_to_do: str) -> None:
        """Note what forbids planning."""
        self.add("error", what, what_to_do)

    def warning(self, what: str, what_to_do: str) -> None:
        """Note what costs grasps or realism."""
        self.add("warning", what, what_to_do)

    def note(self, what: str, what_to_do: str) -> None:
        """Note a fact that is no fault."""
        self.add("note", what, what_to_do)

    def worst_first(self) -> tuple[Finding, ...]:
        """Errors, then warnings, then notes."""
        return tuple(sorted(self, key=lambda f: ("error", "warning", "note").index(f.level)))


@dataclass(frozen=True, kw_only=True)
class JointRow:
    """A joint: its place in both engines, its range (rad, m), torque mid-range (N m, N).

    Attributes:
        name: Its name.
        belongs_to: Its finger, "wrist", or "".
        q_index: Its number in Pinocchio's q.
        qpos_index: Its number in MuJoCo's qpos.
        lower: Lower end of its range.
        upper: Upper end.
        torque: Least and greatest torque that its actuators make there; infinite if unlimited.
        actuators: Names of the actuators that act on it.
    """

    name: str
    belongs_to: str
    q_index: int
    qpos_index: int
    lower: float
    upper: float
    torque: tuple[float, float]
    actuators: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class WorkspaceRow:
    """Workspace of a tip: corners of its box in the base's frame, m."""

    finger: str
    lower: tuple[float, float, float]
    upper: tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class PadRow:
    """A pad: its sphere against its geom.

    Attributes:
        finger: Name of the finger.
        geom: Its geom.
        kind: Of the geom.
        radius: m.
        half_angle_deg: Of its cone.
        depth_error: Depth of its centre in the geom less its radius, m.
        stands_out: How far the geom stands out before the sphere within the cone, m.
        hidden: How far another geom of the link stands out before both along the axis, m.
        taxels: Its array as ``hand.toml`` has it, for people; "" of a pad without one.
        presses: Force along the pad's look that the actuators make in the pinch posture, N; None
            for a finger that takes no part in it.
    """

    finger: str
    geom: str
    kind: str
    radius: float
    half_angle_deg: float
    depth_error: float
    stands_out: float
    hidden: float
    taxels: str
    presses: float | None


@dataclass(frozen=True, kw_only=True)
class TouchRow:
    """Two geometries that overlap at rest: distance by coal and by MuJoCo, m; whether allowed."""

    first: str
    second: str
    coal: float
    mujoco: float
    collides_in_mujoco: bool


@dataclass(frozen=True, kw_only=True)
class PostureRow:
    """A posture: free width between pads (m), how pads face each other (deg), clearance (m)."""

    name: str
    gap: float
    facing_deg: tuple[float, ...]
    clearance: float


SHARE = 0.35
"""Where the width of an object lies between the widths of the hand's postures pinch and open."""

LEAST, MOST = 0.015, 0.14
"""Smallest and largest width, m."""

LEAST_HEIGHT = 0.06
"""Least height (m) of what stands on the table, so that fingers have room beside it."""


@dataclass(frozen=True, kw_only=True)
class CheckReport:
    """Result of ``check_hand``."""

    hand: str
    joints: tuple[JointRow, ...]
    couplings: tuple[str, ...]
    workspaces: tuple[WorkspaceRow, ...]
    pads: tuple[PadRow, ...]
    touches: tuple[TouchRow, ...]
    postures: tuple[PostureRow, ...]
    kinematics_error: float
    findings: tuple[Finding, ...]

    def __repr__(self) -> str:
        """One line."""
        return short_repr(self)

    def __str__(self) -> str:
        """Whether a hand can be planned with, and how much is to be said about it."""
        ready = "ready to plan" if self.ok else "not ready to plan"
        return f"{self.hand}: {ready}, {len(self.findings)} findings"

    @property
    def ok(self) -> bool:
        """Whether nothing forbids planning."""
        return not any(f.level == "error" for f in self.findings)

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON; infinities are None."""
        return {"ok": self.ok, **finite(asdict(self))}


def fitting_objects(check: CheckReport) -> list[str]:
    """Specifications of objects between the pads' widths, the likeliest first, three of a size."""
    gaps = {row.name: float(row.gap) for row in check.postures}
    pinch = gaps.get("pinch", LEAST)
    width = pinch + SHARE * max(0.0, gaps.get("open", pinch) - pinch)
    width = round(min(max(width, LEAST), MOST), 3)
    found = []
    for scale in (1.0, 0.75, 1.2):
        wide = scale * width
        tall = max(1.5 * wide, LEAST_HEIGHT)
        found += [
            f"cylinder:{wide / 2:.3f}x{tall:.3f}",
            f"sphere:{wide / 2:.3f}",
            f"box:{0.85 * wide:.3f}x{0.85 * wide:.3f}x{tall:.3f}",
        ]
    return found
