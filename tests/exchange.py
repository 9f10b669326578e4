"""What tests of exports share: plans moved about, and a hand with a joint that follows another."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from hypothesis import strategies as st

from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.plan import GraspPlan
from planner.spatial import pose_from_wxyz

UNIT = st.floats(-1.0, 1.0)

LINK = (
    '<link name="{0}"><inertial><mass value="0.05"/><inertia ixx="1e-5" iyy="1e-5" izz="1e-5" '
    'ixy="0" ixz="0" iyz="0"/></inertial><collision><geometry>{1}</geometry></collision></link>'
)
HINGE = (
    '<joint name="{0}" type="revolute"><parent link="palm"/><child link="{0}"/>'
    '<origin xyz="{1} 0 0.04"/><axis xyz="0 1 0"/>'
    '<limit lower="-0.5" upper="1" effort="2" velocity="1"/>{2}</joint>'
)
CLAW = (
    '<robot name="claw">'
    + LINK.format("palm", '<box size="0.06 0.02 0.04"/>')
    + LINK.format("left", '<sphere radius="0.008"/>')
    + LINK.format("right", '<sphere radius="0.008"/>')
    + HINGE.format("left", "-0.03", "")
    + HINGE.format("right", "0.03", '<mimic joint="left" multiplier="-0.5" offset="0.1"/>')
    + "</robot>"
)
CLAW_TOML = """schema = 1
name = "claw"
model = "claw.urdf"
base_body = "palm"
palm_body = "palm"
palm_normal = [0, 0, 1]
[[actuators]]
joints = ["left"]
kp = 3.0
force_limit = 0.7
"""
FINGER = """[[fingers]]
name = "{0}"
joints = ["{0}"]
[fingers.tip]
body = "{0}"
position = [0, 0, 0]
[fingers.pad]
geom = "{0}_geom0"
center = [0, 0, 0]
radius = 0.008
axis = [{1}, 0, 0]
half_angle_deg = 40
"""


def make_claw(folder: Path) -> Hand:
    """Two fingers: right = 0.1 - 0.5 left, and a motor for the left one."""
    (folder / "claw.urdf").write_text(CLAW, encoding="utf-8")
    text = CLAW_TOML + FINGER.format("left", 1) + FINGER.format("right", -1)
    (folder / "hand.toml").write_text(text, encoding="utf-8")
    return load_hand(folder / "hand.toml")


def moved(plan: GraspPlan, numbers: list[float]) -> GraspPlan:
    """A plan elsewhere, for what only carries numbers: a pose and joints out of [-1, 1]."""
    values = np.array(numbers)
    turn = values[3:7] if np.linalg.norm(values[3:7]) > 1e-3 else np.array([1.0, 0.0, 0.0, 0.0])
    low, high = plan.task.hand.q_lower, plan.task.hand.q_upper
    shares = 0.5 + 0.5 * np.resize(values[7:], 2 * len(low))
    return replace(
        plan,
        T_world_base=pose_from_wxyz(values[:3], turn),
        q=low + shares[: len(low)] * (high - low),
        q_pregrasp=low + shares[len(low) :] * (high - low),
    )


def some_numbers() -> st.SearchStrategy[list[float]]:
    """What ``moved`` takes."""
    return st.lists(UNIT, min_size=12, max_size=40)
