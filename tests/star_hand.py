"""A hand with any number of equal fingers in a circle: what costs grow with the contacts.

No shipped hand has more than five fingers. This one is as plain as can be: each finger has a hinge
to the side and three that close it towards the palm's axis, and a ball for a tip.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from pathlib import Path

CIRCLE = 0.045
"""Radius (m) of the circle in which the fingers stand: a sphere of 30 mm has room between them."""

LINKS = (0.035, 0.03, 0.025)
"""Lengths of a finger's links, m."""

LINK_RADIUS, TIP_RADIUS = 0.006, 0.008
"""Radii of links and tips, m: eight of them fit around that sphere."""

SIDE_RANGE, CLOSE_RANGE = (-0.4, 0.4), (-0.3, 1.6)
"""Ranges of the joints, rad."""

TORQUE = 0.7
"""Limit of every actuator, N m: that of an Allegro-type hand."""

OPEN, PINCH = (-0.3, 0.2, 0.2), (-0.3, 0.45, 0.4)
"""Closing joints (rad) of the postures: tips 56 and 38 mm from the axis, the second just touching a
sphere of 30 mm."""

HALF_ANGLE = 50.0
"""Half angle of the pads' cones, degrees; they face inwards and to the tip."""


def write_star_hand(folder: Path, n_fingers: int) -> Path:
    """Write model and description of a hand with so many fingers; the path of the latter.

    Args:
        folder: Where.
        n_fingers: At least 2.
    """
    root = ET.Element("mujoco", model=f"star_{n_fingers}")
    ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    world = ET.SubElement(root, "worldbody")
    actuators = ET.SubElement(root, "actuator")
    palm = ET.SubElement(world, "body", name="palm")
    size = f"{CIRCLE} 0.01"
    ET.SubElement(
        palm, "geom", name="palm", type="cylinder", pos="0 0 -0.02", size=size, mass="0.4"
    )
    for k in range(n_fingers):
        _add_finger(palm, actuators, f"finger{k + 1}", 2 * math.pi * k / n_fingers)
    ET.indent(root)
    model = folder / f"star_{n_fingers}.xml"
    ET.ElementTree(root).write(model, encoding="unicode")
    description = folder / f"star_{n_fingers}.toml"
    description.write_text(_description(model.name, n_fingers), encoding="utf-8")
    return description


def _description(model: str, n_fingers: int) -> str:
    """The hand's description, TOML."""
    names = [f"finger{k + 1}" for k in range(n_fingers)]
    text = f"""schema = 1
name = "star_{n_fingers}"
model = "{model}"
base_body = "palm"
palm_body = "palm"
palm_normal = [0.0, 0.0, 1.0]
wrist_joints = []
default_fingers = {names}
allowed_contacts = []
"""
    for name in names:
        joints = [f"{name}_side", *(f"{name}_close{i}" for i in range(len(LINKS)))]
        text += f"""
[[fingers]]
name = "{name}"
joints = {joints}
tip_site = "{name}_tip"
[fingers.pad]
geom = "{name}_tip"
center = [0.0, 0.0, {LINKS[-1]}]
radius = {TIP_RADIUS}
axis = [{math.sqrt(0.5)}, 0.0, {math.sqrt(0.5)}]
half_angle_deg = {HALF_ANGLE}
"""
    for posture, angles in (("open", OPEN), ("pinch", PINCH)):
        text += f"\n[postures.{posture}]\n"
        for name in names:
            text += "".join(f"{name}_close{i} = {angle}\n" for i, angle in enumerate(angles))
    return text


def _add_finger(palm: ET.Element, actuators: ET.Element, name: str, angle: float) -> None:
    """A finger at an angle (rad) of the circle; its own x axis points at the palm's axis."""
    x, y, turn = CIRCLE * math.cos(angle), CIRCLE * math.sin(angle), angle + math.pi
    body = ET.SubElement(
        palm,
        "body",
        name=f"{name}_base",
        pos=f"{x:.9f} {y:.9f} 0",
        quat=f"{math.cos(turn / 2):.12f} 0 0 {math.sin(turn / 2):.12f}",
    )
    ET.SubElement(body, "geom", type="sphere", size=str(LINK_RADIUS), mass="0.01")
    _add_joint(body, actuators, f"{name}_side", "1 0 0", SIDE_RANGE)
    for i, length in enumerate(LINKS):
        z = LINKS[i - 1] if i else 0.0
        body = ET.SubElement(body, "body", name=f"{name}_link{i}", pos=f"0 0 {z}")
        _add_joint(body, actuators, f"{name}_close{i}", "0 1 0", CLOSE_RANGE)
        last = i == len(LINKS) - 1
        end = length - TIP_RADIUS if last else length
        ET.SubElement(
            body,
            "geom",
            name=f"{name}_link{i}",
            type="capsule",
            size=str(LINK_RADIUS),
            fromto=f"0 0 0 0 0 {end}",
            mass="0.03",
        )
        if last:
            ET.SubElement(
                body,
                "geom",
                name=f"{name}_tip",
                type="sphere",
                size=str(TIP_RADIUS),
                pos=f"0 0 {length}",
                mass="0.01",
            )
            ET.SubElement(body, "site", name=f"{name}_tip", pos=f"0 0 {length}")


def _add_joint(
    body: ET.Element, actuators: ET.Element, name: str, axis: str, limits: tuple[float, float]
) -> None:
    """A hinge with a servo."""
    span = f"{limits[0]} {limits[1]}"
    ET.SubElement(body, "joint", name=name, axis=axis, range=span, damping="0.1", armature="0.0001")
    ET.SubElement(
        actuators,
        "position",
        name=name,
        joint=name,
        kp="3",
        ctrlrange=span,
        forcerange=f"{-TORQUE} {TORQUE}",
    )
