"""What a hand is made of, as data and as tables: behind ``opposable inspect``."""

from __future__ import annotations

from typing import Any

import numpy as np
from rich.table import Table

from planner.hand import Finger, Hand
from planner.kinematics import HandState

__all__ = ["hand_tables", "inspect_hand"]


def inspect_hand(hand: Hand) -> dict[str, Any]:
    """A hand as plain data: fingers, joints, actuators, couplings, masses (SI units, radians)."""
    state = HandState(hand, hand.neutral)
    torque = torque_limits(hand)
    masses = {hand.mj_model.body(i).name: float(m) for i, m in enumerate(hand.mj_model.body_mass)}
    return {
        "name": hand.name,
        "summary": hand.description.summary,
        "sha256": hand.digest,
        "joints": hand.nq,
        "actuators": len(hand.actuation.names),
        "mass_kg": float(sum(masses.values())),
        "base_body": hand.description.base_body,
        "palm_body": hand.description.palm_body,
        "wrist_joints": list(hand.description.wrist_joints),
        "default_fingers": [f.name for f in hand.choose_fingers()],
        "other_joints": _other_joints(hand, torque),
        "fingers": [_finger(hand, f, state, torque, masses) for f in hand.fingers.values()],
        "actuator_table": [
            {
                "name": name,
                "joints": [j for j, r in zip(hand.joint_names, row, strict=True) if r != 0],
                "force_range": [float(v) for v in hand.actuation.force_range[i]],
                "ctrl_range": [float(v) for v in hand.actuation.ctrl_range[i]],
            }
            for i, (name, row) in enumerate(
                zip(hand.actuation.names, hand.actuation.moment, strict=True)
            )
        ],
        "couplings": [
            {
                "name": c.name,
                "joints": {
                    hand.joint_names[int(k)]: float(c.row[k]) for k in np.flatnonzero(c.row)
                },
                "value": c.value,
                "one_sided": c.one_sided,
            }
            for c in hand.couplings
        ],
        "colliding_geometries": len(hand.geometries),
    }


def torque_limits(hand: Hand) -> Any:
    """Largest joint torque (nq,) in N m that the actuators give each joint alone, mid-range."""
    middle = (hand.q_lower + hand.q_upper) / 2
    limits = np.abs(hand.actuation.force_limits(middle)).max(axis=1)
    return (np.abs(hand.actuation.moment) * limits[:, None]).max(axis=0, initial=0.0)


def _finger(
    hand: Hand, finger: Finger, state: HandState, torque: Any, masses: dict[str, float]
) -> dict[str, Any]:
    tip = state.tip_pose(finger).translation
    return {
        "name": finger.name,
        "tip_frame": finger.tip_frame,
        "tip_at_zero_base_m": [float(v) for v in tip],
        "pad_geometry": finger.pad.geom,
        "pad_radius_m": finger.pad.radius,
        "mass_kg": sum(masses[b] for b in finger.bodies),
        "joints": [_joint(hand, int(k), torque) for k in finger.q_index],
    }


def _joint(hand: Hand, k: int, torque: Any) -> dict[str, Any]:
    return {
        "name": hand.joint_names[k],
        "index": k,
        "lower": float(hand.q_lower[k]),
        "upper": float(hand.q_upper[k]),
        "torque_limit_N_m": float(torque[k]),
    }


def _other_joints(hand: Hand, torque: Any) -> list[dict[str, Any]]:
    """Joints that belong to no finger: the wrist's, and any others."""
    wrist = {int(k) for k in hand.wrist_index}
    in_fingers = {int(k) for f in hand.fingers.values() for k in f.q_index}
    arm = {int(k) for k in hand.arm_index}
    rest = set(range(hand.nq)) - in_fingers - wrist - arm
    return [
        {"name": name, "joints": [_joint(hand, k, torque) for k in sorted(members)]}
        for name, members in (("arm", arm), ("wrist", wrist), ("other", rest))
        if members
    ]


def hand_tables(hand: Hand) -> list[Table]:
    """The same for people, lengths in mm and angles in degrees."""
    data = inspect_hand(hand)
    joints = Table(
        title=f"{data['name']}: {data['joints']} joints, {data['actuators']} actuators, "
        f"{data['mass_kg']:.2f} kg"
    )
    for column in ("finger", "joint", "q", "lower deg", "upper deg", "torque N m"):
        joints.add_column(column, justify="right" if column[-1] in "qgm" else "left")
    for finger in [*data["other_joints"], *data["fingers"]]:
        for k, joint in enumerate(finger["joints"]):
            joints.add_row(
                finger["name"] if k == 0 else "",
                joint["name"],
                str(joint["index"]),
                f"{np.rad2deg(joint['lower']):.1f}",
                f"{np.rad2deg(joint['upper']):.1f}",
                f"{joint['torque_limit_N_m']:.2f}",
            )
    tips = Table(title="fingertips at q = 0, base frame")
    for column in ("finger", "tip frame", "x mm", "y mm", "z mm", "pad", "radius mm", "mass g"):
        tips.add_column(column, justify="right" if column[-1] in "mg" else "left")
    for finger in data["fingers"]:
        tips.add_row(
            finger["name"],
            finger["tip_frame"],
            *(f"{1e3 * v:.1f}" for v in finger["tip_at_zero_base_m"]),
            finger["pad_geometry"],
            f"{1e3 * finger['pad_radius_m']:.1f}",
            f"{1e3 * finger['mass_kg']:.0f}",
        )
    actuators = Table(title="actuators")
    for column in ("actuator", "drives", "force range", "ctrl range"):
        actuators.add_column(column)
    for actuator in data["actuator_table"]:
        low, high = actuator["force_range"]
        ctrl_low, ctrl_high = actuator["ctrl_range"]
        actuators.add_row(
            actuator["name"],
            ", ".join(actuator["joints"]),
            f"[{low:g}, {high:g}]",
            f"[{ctrl_low:.3g}, {ctrl_high:.3g}]",
        )
    tables = [joints, tips, actuators]
    if data["couplings"]:
        couplings = Table(title="couplings in a grasp")
        for column in ("coupling", "equation", "kind"):
            couplings.add_column(column)
        for c in data["couplings"]:
            terms = " ".join(f"{v:+g} {j}" for j, v in c["joints"].items())
            kind = "stop: can only push the left side up" if c["one_sided"] else "two-sided"
            couplings.add_row(c["name"], f"{terms} = {c['value']:g}", kind)
        tables.append(couplings)
    return tables
