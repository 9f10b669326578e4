"""Known causes for wrong poses, limits, damping, efforts and gravity in Pinocchio's own reader."""

from __future__ import annotations

from itertools import product

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from planner.spatial import FloatArray, pose_from_wxyz
from sim.crosscheck.cause_context import EQUAL, Context
from sim.crosscheck.quantities import Difference

__all__ = ["VALUES"]

_DEFAULT_GRAVITY = (0.0, 0.0, -9.81)
_HUGE = 1e15
"""Effort, N m, that stands for none."""

_ORIENTATIONS = ("quat", "axisangle", "euler", "xyaxes", "zaxis", "fromto")


def _root_pose(d: Difference, c: Context) -> str:
    """The first body, fixed to the world, stands at the origin there."""
    moved = any(slot.body == d.part for slot in c.layout.joints)
    local = c.local(d.part)
    if d.part == c.first and not moved and _close(local.homogeneous, np.eye(4)):
        return "pose of the root body is dropped: the whole model is in that body's frame"
    return ""


def _free_pose(d: Difference, c: Context) -> str:
    slot = next((s for s in c.layout.joints if s.body == d.part and s.kind == "free"), None)
    if slot is None:
        return ""
    q = c.layout.q_drawn[slot.q]
    drawn, local = pose_from_wxyz(q[:3], q[3:]), c.local(d.part)
    shifted = 2 * drawn.translation - drawn.rotation @ drawn.translation
    if _close(local.rotation, drawn.rotation) and _close(local.translation, shifted):
        return "a free body that is drawn at p, turned by R, is shifted by p - R p"
    return ""


def _axisangle(d: Difference, c: Context) -> str:
    site = d.quantity.startswith("site")
    written = _attributes(d, c).get("axisangle")
    if written is None:
        return ""
    axis = np.array(written.split(), dtype=float)[:3]
    if abs(np.linalg.norm(axis) - 1) > EQUAL and not c.turned(d.part, site=site):
        return "the axis of its axisangle is not of unit length, and not normalised there"
    return ""


def _extrinsic(d: Difference, c: Context) -> str:
    sequence = c.text.option("compiler", "eulerseq") if c.text else None
    written = _attributes(d, c).get("euler")
    if sequence is None or written is None or sequence.islower():
        return ""
    degrees = c.source.spec.compiler.degree
    angles = np.array(written.split(), dtype=float)
    predicted = Rotation.from_euler(sequence.upper(), angles, degrees=bool(degrees)).as_matrix()
    if _close(c.local(d.part, site=d.quantity.startswith("site")).rotation, predicted):
        return f"eulerseq {sequence!r} turns about fixed axes; there about the turned ones"
    return ""


def _class_pose(d: Difference, c: Context) -> str:
    """A site without a pose of its own has one from its class."""
    element = c.text.element("site", d.part) if c.text else None
    if c.text is None or element is None:
        return ""
    inherited = c.text.inherited(element)
    local = c.local(d.part, site=True)
    if d.quantity == "site offset":
        lost = "pos" in inherited and "pos" not in element.attrib
        predicted = _close(local.translation, np.zeros(3))
    else:
        own = any(name in element.attrib for name in _ORIENTATIONS)
        lost = not own and any(name in inherited for name in _ORIENTATIONS)
        predicted = _close(local.rotation, np.eye(3))
    return "its pose comes from a default class, and is ignored there" if lost and predicted else ""


def _fixed_chain(d: Difference, c: Context) -> str:
    """A site of a body that is fixed to a fixed body."""
    body = c.layout.sites[d.part]
    if body == "world" or c.layout.roots[body] == body:
        return ""
    pose, wrong = c.fixed_site(d.part)
    if _close(pose.homogeneous, wrong.homogeneous):
        return "its body is fixed to a fixed body, and that one's pose is left out for the site"
    return ""


def _range(d: Difference, c: Context) -> str:
    """One of the known mistakes with limits, or several at once."""
    j = list(c.slots).index(d.part)
    model, spec = c.model, c.source.spec
    there = c.there.joints[d.part].range
    if there is None or spec is None or c.text is None:
        return ""
    limited = bool(model.jnt_limited[j])
    reference = float(model.qpos0[int(model.jnt_qposadr[j])])
    slide = c.slots[d.part].kind == "slide" and bool(spec.compiler.degree)
    mistakes = {
        "limited is false, and the range is used all the same": not limited,
        "a slide's range, m, is converted from degrees": slide,
        f"ref {reference:.4g} is subtracted from the range": reference != 0,
    }
    for chosen in product(
        *((False, True) if possible else (False,) for possible in mistakes.values())
    ):
        if chosen[0] != (not limited) or not any(chosen):
            continue
        predicted = np.array(model.jnt_range[j])
        predicted = np.deg2rad(predicted) if chosen[1] else predicted
        predicted = predicted - reference if chosen[2] else predicted
        if _close(there, predicted):
            return "; ".join(m for m, made in zip(mistakes, chosen, strict=True) if made)
    return ""


def _effort(d: Difference, c: Context) -> str:
    here, there = c.here.joints[d.part].effort, c.there.joints[d.part].effort
    if np.isfinite(here).any() and (np.abs(there) > _HUGE).all() and c.model.nu:
        return "actuators are not read: no force range, no gain"
    return ""


def _urdf_zero(d: Difference, c: Context) -> str:
    """Limits of a URDF that MuJoCo takes for none."""
    here, there = c.here.joints[d.part], c.there.joints[d.part]
    if c.text is not None:
        return ""
    if d.quantity == "joint range":
        stated = there.range is not None and there.range[0] == there.range[1]
        none = here.range is not None and np.isinf(here.range).all()
        return (
            "equal limits are none for MuJoCo, and a locked joint there" if stated and none else ""
        )
    if not there.effort.any() and np.isinf(here.effort).all():
        return "an effort of 0 is none for MuJoCo, and no strength there"
    return ""


def _polynomial(d: Difference, c: Context) -> str:
    slot = c.slots[d.part]
    if c.model.dof_dampingpoly[slot.v].any() and not c.there.joints[d.part].damping.any():
        return "damping with more than one coefficient is read as 0"
    return ""


def _ball_damping(d: Difference, c: Context) -> str:
    if c.slots[d.part].kind == "ball" and not c.there.joints[d.part].damping.any():
        return "damping of ball joints is read as 0"
    return ""


def _gravity(d: Difference, c: Context) -> str:
    stated = c.text is not None and c.text.option("option", "gravity") is not None
    if (stated or (c.text and c.text.includes)) and _close(
        c.there.gravity, np.array(_DEFAULT_GRAVITY)
    ):
        return "the file's gravity is not read"
    return ""


def _coupling(d: Difference, c: Context) -> str:
    names = {c.model.equality(e).name or f"equality{e}": e for e in range(c.model.neq)}
    kind = mujoco.mjtEq(int(c.model.eq_type[names[d.part]])).name.removeprefix("mjEQ_").lower()
    if c.text is None:
        return "mimic of a URDF is not read unless it is asked for"
    if kind in ("connect", "weld"):
        return f"a {kind} is no part of the model (buildModelAndConstraintsFromMJCF gives it apart)"
    return f"equalities of {kind}s are dropped"


def _attributes(d: Difference, c: Context) -> dict[str, str]:
    """Attributes of the body or site that a difference is about; none if it is not in the file."""
    kind = "site" if d.quantity.startswith("site") else "body"
    element = c.text.element(kind, d.part) if c.text else None
    return {} if element is None else element.attrib


def _close(a: FloatArray, b: FloatArray) -> bool:
    return bool(np.allclose(a, b, rtol=EQUAL, atol=EQUAL))


_POSES = ("body offset", "body turn")
_TURNS = ("body turn", "site turn")

VALUES = (
    ("root pose", _POSES, _root_pose),
    ("free joint", _POSES, _free_pose),
    ("axisangle", _TURNS, _axisangle),
    ("eulerseq", _TURNS, _extrinsic),
    ("fixed chain", ("site offset", "site turn"), _fixed_chain),
    ("class pose", ("site offset", "site turn"), _class_pose),
    ("joint range", ("joint range",), _range),
    ("zero limits", ("joint range", "effort limit"), _urdf_zero),
    ("actuators", ("effort limit",), _effort),
    ("damping polynomial", ("damping",), _polynomial),
    ("ball damping", ("damping",), _ball_damping),
    ("gravity", ("gravity",), _gravity),
    ("equalities", ("equality rows",), _coupling),
)
"""Key, quantities and check of each cause; a check gives the reason in words, or ""."""
