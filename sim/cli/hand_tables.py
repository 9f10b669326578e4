"""What a hand is made of, and what was found out about it, for people.

Behind ``opposable hands NAME`` and ``opposable hands NAME --check``.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from planner.arrays import short_names
from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.kinematics import HandState
from sim.cli.common import say
from sim.tables import table

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


WORDS = (
    *("finger", "joint", "tip frame", "pad", "actuator", "drives", "force range", "ctrl range"),
    *("coupling", "equation", "kind", "of", "range", "actuators", "geom", "taxels", "x", "y", "z"),
    *("posture", "pads off the opposite ones, deg"),
)
"""Columns that are no numbers."""

_table = partial(table, left=WORDS)


def hand_tables(hand: Hand) -> list[Table]:
    """The same for people, lengths in mm and angles in degrees."""
    data = inspect_hand(hand)
    prefix, labels = short_names(hand.joint_names)
    label = {name: escape(short) for name, short in zip(hand.joint_names, labels, strict=True)}
    _, pads = short_names([f["pad_geometry"] for f in data["fingers"]], GEOM_WIDTH)
    _, servos = short_names(hand.actuation.names)
    joints = _table(
        f"{data['name']}: {data['joints']} joints, {data['actuators']} actuators, "
        f"{data['mass_kg']:.2f} kg",
        ("finger", "joint", "q", "lower deg", "upper deg", "torque N m"),
        (
            (
                finger["name"] if k == 0 else "",
                label[joint["name"]],
                str(joint["index"]),
                f"{np.rad2deg(joint['lower']):.1f}",
                f"{np.rad2deg(joint['upper']):.1f}",
                f"{joint['torque_limit_N_m']:.2f}",
            )
            for finger in [*data["other_joints"], *data["fingers"]]
            for k, joint in enumerate(finger["joints"])
        ),
        caption=_shortened(prefix, (*labels, *pads, *servos)),
    )
    tips = _table(
        "fingertips at q = 0, base frame",
        ("finger", "tip frame", "x mm", "y mm", "z mm", "pad", "radius mm", "mass g"),
        (
            (
                finger["name"],
                finger["tip_frame"],
                *(f"{1e3 * v:.1f}" for v in finger["tip_at_zero_base_m"]),
                escape(pad),
                f"{1e3 * finger['pad_radius_m']:.1f}",
                f"{1e3 * finger['mass_kg']:.0f}",
            )
            for finger, pad in zip(data["fingers"], pads, strict=True)
        ),
    )
    actuators = _table(
        "actuators",
        ("actuator", "drives", "force range", "ctrl range"),
        (
            (
                escape(servo),
                ", ".join(label[joint] for joint in actuator["joints"]),
                "[{:g}, {:g}]".format(*actuator["force_range"]),
                "[{:.3g}, {:.3g}]".format(*actuator["ctrl_range"]),
            )
            for actuator, servo in zip(data["actuator_table"], servos, strict=True)
        ),
    )
    couplings = _table(
        "couplings in a grasp",
        ("coupling", "equation", "kind"),
        (
            (
                c["name"],
                f"{' '.join(f'{v:+g} {label[j]}' for j, v in c['joints'].items())} "
                f"{'>=' if c['one_sided'] else '='} {c['value']:g}",
                "stop: can only push the left side up" if c["one_sided"] else "two-sided",
            )
            for c in data["couplings"]
        ),
    )
    return [joints, tips, actuators, *([couplings] if data["couplings"] else [])]


GEOM_WIDTH = 12
"""Characters of a geom's name, in tables of many columns."""


def _shortened(prefix: str, labels: Sequence[str], more: str = "") -> str | None:
    """What tables leave out of names; None if nothing."""
    parts = [f"without {prefix!r} before each name{more}"] * bool(prefix)
    if any("…" in text for text in labels):
        parts.append("long names are cut (…), whole with --json")
    return escape(", ".join(parts)) or None


STYLES = {"error": "bold red", "warning": "bold yellow", "note": "bold"}
"""Of the levels of findings."""


def print_check(report: CheckReport, console: Console) -> None:
    """What was found out about a hand: the tables, and the findings last."""
    prefix, names = short_names([j.name for j in report.joints])
    own = Counter(name for j in report.joints for name in j.actuators)
    short = bool(prefix) and all(
        len(j.actuators) == 1 and all(own[name] == 1 for name in j.actuators) for j in report.joints
    )
    _, geoms = short_names([p.geom for p in report.pads], GEOM_WIDTH)
    each = ", each with its own actuator" * short
    columns = ("joint", "of", "q", "qpos", "range", "torque N m", "actuators")
    joints = _table(
        f"{report.hand}: joints in the order of q",
        columns[: len(columns) - short],
        (
            (
                escape(name),
                j.belongs_to,
                str(j.q_index),
                str(j.qpos_index),
                f"{j.lower:.3f} .. {j.upper:.3f}",
                f"{j.torque[0]:.2f} .. {j.torque[1]:.2f}",
                *([] if short else [escape(", ".join(j.actuators))]),
            )
            for j, name in zip(report.joints, names, strict=True)
        ),
        caption=_shortened(prefix, (*names, *geoms), each),
    )
    pads = _table(
        "pads",
        ("finger", "geom", "radius mm", "cone deg", "stands out mm", "presses N", "taxels"),
        (
            (
                p.finger,
                escape(f"{geom} ({p.kind})"),
                f"{1e3 * p.radius:.2f}",
                f"{p.half_angle_deg:.0f}",
                f"{1e3 * p.stands_out:.2f}",
                "-" if p.presses is None else f"{p.presses:.1f}",
                p.taxels or "-",
            )
            for p, geom in zip(report.pads, geoms, strict=True)
        ),
    )
    spaces = _table(
        "where the tips get to, base frame, mm",
        ("finger", "x", "y", "z"),
        (
            (
                w.finger,
                *(f"{1e3 * a:.0f} .. {1e3 * b:.0f}" for a, b in zip(w.lower, w.upper, strict=True)),
            )
            for w in report.workspaces
        ),
    )
    postures = _table(
        "postures",
        ("posture", "gap mm", "pads off the opposite ones, deg", "clearance mm"),
        (
            (
                r.name,
                f"{1e3 * r.gap:.0f}",
                " ".join(f"{angle:.0f}" for angle in r.facing_deg),
                f"{1e3 * r.clearance:.1f}",
            )
            for r in report.postures
        ),
    )
    console.print(joints)
    for coupling in report.couplings:
        say(console, escape(f"coupling {coupling}"))
    for made in (pads, spaces, postures):
        console.print(made)
    say(console, f"Pinocchio and MuJoCo agree to {report.kinematics_error:.1e} m")
    for f in report.findings:
        say(console, f"[{STYLES[f.level]}]{f.level}:[/] {escape(f.what)}; {escape(f.what_to_do)}")
    if report.ok:
        say(console, "nothing forbids planning")
