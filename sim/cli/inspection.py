"""What a hand is made of, and what was found out about it, for people.

Behind ``opposable inspect`` and ``opposable check-hand``.
"""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from planner.arrays import without_prefix
from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.kinematics.state import HandState

if TYPE_CHECKING:
    from planner.describe import CheckReport


def inspect_hand(hand: Hand) -> dict[str, Any]:
    """A hand as plain data: fingers, joints, actuators, couplings, masses (SI units, radians)."""
    state = HandState(hand, hand.neutral)
    middle = (hand.q_lower + hand.q_upper) / 2
    torque = np.abs(hand.actuation.torque_limits(middle)).max(axis=1)
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
            sign = ">=" if c["one_sided"] else "="
            couplings.add_row(c["name"], f"{terms} {sign} {c['value']:g}", kind)
        tables.append(couplings)
    return tables


def print_check(report: CheckReport, console: Console) -> None:
    """What was found out about a hand: the tables, and the findings last."""

    def say(text: str) -> None:
        console.print(text, highlight=False, soft_wrap=True)

    prefix, names = without_prefix([j.name for j in report.joints])
    own = Counter(name for j in report.joints for name in j.actuators)
    short = bool(prefix) and all(
        len(j.actuators) == 1 and all(own[name] == 1 for name in j.actuators) for j in report.joints
    )
    joints = Table(
        title=f"{report.hand}: joints in the order of q",
        caption=escape(
            f"without {prefix!r} before each name{', each with its own actuator' * short}"
        )
        if prefix
        else None,
    )
    columns = ("joint", "of", "q", "qpos", "range", "torque N m", "actuators")
    for column in columns[: len(columns) - short]:
        joints.add_column(column, overflow="fold")
    for j, name in zip(report.joints, names, strict=True):
        joints.add_row(
            escape(name),
            j.belongs_to,
            str(j.q_index),
            str(j.qpos_index),
            f"{j.lower:.3f} .. {j.upper:.3f}",
            f"{j.torque[0]:.2f} .. {j.torque[1]:.2f}",
            *([] if short else [escape(", ".join(j.actuators))]),
        )
    console.print(joints)
    for coupling in report.couplings:
        say(escape(f"coupling {coupling}"))
    pads = Table(title="pads")
    for column in (
        "finger",
        "geom",
        "radius mm",
        "cone deg",
        "stands out mm",
        "presses N",
        "taxels",
    ):
        pads.add_column(column)
    _, geoms = without_prefix([p.geom for p in report.pads])
    for p, geom in zip(report.pads, geoms, strict=True):
        pads.add_row(
            p.finger,
            escape(f"{geom} ({p.kind})"),
            f"{1e3 * p.radius:.2f}",
            f"{p.half_angle_deg:.0f}",
            f"{1e3 * p.stands_out:.2f}",
            "-" if p.presses is None else f"{p.presses:.1f}",
            p.taxels or "-",
        )
    console.print(pads)
    spaces = Table(title="where the tips get to, base frame, mm")
    for column in ("finger", "x", "y", "z"):
        spaces.add_column(column)
    for w in report.workspaces:
        ends = zip(w.lower, w.upper, strict=True)
        spaces.add_row(w.finger, *(f"{1e3 * a:.0f} .. {1e3 * b:.0f}" for a, b in ends))
    console.print(spaces)
    postures = Table(title="postures")
    for column in ("posture", "gap mm", "pads off the opposite ones, deg", "clearance mm"):
        postures.add_column(column)
    for r in report.postures:
        facing = " ".join(f"{angle:.0f}" for angle in r.facing_deg)
        postures.add_row(r.name, f"{1e3 * r.gap:.0f}", facing, f"{1e3 * r.clearance:.1f}")
    console.print(postures)
    say(f"Pinocchio and MuJoCo agree to {report.kinematics_error:.1e} m")
    styles = {"error": "bold red", "warning": "bold yellow", "note": "bold"}
    for f in report.findings:
        style = styles[f.level]
        say(f"[{style}]{f.level}:[/] {escape(f.what)}; {escape(f.what_to_do)}")
    if report.ok:
        say("nothing forbids planning")
