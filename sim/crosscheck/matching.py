"""Which joint, body and site of a Pinocchio model is which of a MuJoCo reference.

By name, with a map of names where they differ. Pinocchio's MJCF reader renames what has no name and
drops the names of joints that share a body: what is left over is matched by order, joint by joint
inside the same body, and body by body below the same parent.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pinocchio as pin

from sim.crosscheck.parts import Layout
from sim.crosscheck.pinocchio_side import PinJoint, PinocchioSide, joints_of

_WORLD = "world"
"""Link of a URDF that is MuJoCo's world, which is no body of its own."""


def match(
    model: Any, name: str, layout: Layout, names: Mapping[str, str] | None = None
) -> PinocchioSide:
    """A Pinocchio model as a side of a cross-check.

    Args:
        model: ``pinocchio.Model``.
        name: What the side is called in tables.
        layout: The reference's.
        names: Reference's name -> the model's name, where they differ.
    """
    renamed = names or {}
    bodies = _frames(model, pin.FrameType.BODY)
    sites = _frames(model, pin.FrameType.OP_FRAME)
    found_bodies: dict[str, int] = {}
    for body, parent in layout.parents.items():
        wanted = renamed.get(body, body)
        if wanted not in bodies and parent in found_bodies:  # Pinocchio's word for "no name"
            wanted = f"{model.frames[found_bodies[parent]].name}Bis"
        if wanted in bodies and bodies[wanted] not in found_bodies.values():
            found_bodies[body] = bodies[wanted]
    found_sites = {
        site: sites[renamed.get(site, site)]
        for site in layout.sites
        if renamed.get(site, site) in sites
    }
    found_joints = _joints(model, layout, renamed, found_bodies)
    used = {*found_bodies.values(), *found_sites.values()}
    taken = [*found_joints.values()]
    others = [f"joint {j.name}" for j in joints_of(model) if j not in taken and j.name]
    others += [f"body {n}" for n, f in bodies.items() if f not in used and n != _WORLD]
    others += [f"site {n}" for n, f in sites.items() if f not in used]
    return PinocchioSide(
        model,
        name,
        layout,
        joints=found_joints,
        bodies=found_bodies,
        sites=found_sites,
        others=tuple(others),
    )


def _frames(model: Any, kind: Any) -> dict[str, int]:
    return {f.name: i for i, f in enumerate(model.frames) if f.type == kind}


def _joints(
    model: Any, layout: Layout, names: Mapping[str, str], bodies: Mapping[str, int]
) -> dict[str, PinJoint]:
    present = joints_of(model)
    by_name = {joint.name: joint for joint in present if joint.name}
    out = {
        slot.name: by_name[names.get(slot.name, slot.name)]
        for slot in layout.joints
        if names.get(slot.name, slot.name) in by_name
    }
    taken = list(out.values())
    for body, frame in bodies.items():  # what has lost its name: by its body, in order
        wanted = [s for s in layout.joints if s.body == body and s.name not in out]
        carrier = int(model.frames[frame].parentJoint)
        left = [j for j in present if j.id == carrier and j not in taken and _nameless(j)]
        if layout.roots[body] == body and len(wanted) == len(left):
            out.update(zip((s.name for s in wanted), left, strict=True))
            taken += left
    return out


def _nameless(joint: PinJoint) -> bool:
    """Part of a composite, or named by Pinocchio's reader: ``<body>Joint_<i>``, ``<body>_free``."""
    return joint.name is None or "Joint_" in joint.name or joint.name.endswith("_free")
