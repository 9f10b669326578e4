"""Evidence of the reader's mistakes with structure, poses and parameters (``causes.toml``).

Each function looks at one difference and gives the reasons that apply with the values of their
texts; none where the file lacks the feature, or the number is not the one that the mistake makes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import product
from types import MappingProxyType
from typing import Any, TypeAlias

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from planner.spatial import FloatArray, pose_from_wxyz
from sim.crosscheck.cause_context import EQUAL, ORIENTATIONS, Context
from sim.crosscheck.quantities import Difference

Reasons: TypeAlias = dict[str, dict[str, Any]]
"""Name of each reason that applies -> values of its text."""

Evidence: TypeAlias = Callable[[Difference, Context], Reasons]

_EXTRA = " (not in the reference)"

_DEFAULT_GRAVITY = (0.0, 0.0, -9.81)

_HUGE = 1e15
"""Effort, N m, that stands for none."""


def when(seen: object, reason: str = "it", **values: Any) -> Reasons:
    """A reason if something is so."""
    return {reason: values} if seen else {}


def _close(a: FloatArray, b: FloatArray) -> bool:
    return bool(np.allclose(a, b, rtol=EQUAL, atol=EQUAL))


def _has_name(c: Context, body: str) -> bool:
    return bool(c.model.body(["world", *c.layout.parents].index(body)).name)


def _written(d: Difference, c: Context) -> Mapping[str, str]:
    """Attributes of the body or site that a difference is about; none if it is not in the file."""
    kind = "site" if d.quantity.startswith("site") else "body"
    element = c.text.element(kind, d.part) if c.text else None
    return {} if element is None else element.attrib


# parts that are not there


def _outside_first_body(d: Difference, c: Context) -> Reasons:
    body = c.body_of(d)
    return when(d.error and body != "world" and c.top(body) != c.first, first=c.first)


def _in_included_file(d: Difference, c: Context) -> Reasons:
    body = c.body_of(d)
    included = c.text and c.text.includes and body != "world"
    return when(included and c.text and c.text.element("body", body) is None)


def _in_frame(d: Difference, c: Context) -> Reasons:
    if c.text is None:
        return {}
    kind = {"joints present": "joint", "sites present": "site"}.get(d.quantity, "body")
    element = c.text.element(kind, d.part)
    if element is None:
        element = c.text.element("body", c.body_of(d))
    return when(element is not None and any(a.tag == "frame" for a in c.text.ancestors(element)))


def _on_world(d: Difference, c: Context) -> Reasons:
    return when(c.layout.sites.get(d.part) == "world")


def _on_fixed_root(d: Difference, c: Context) -> Reasons:
    moved = any(slot.body == c.first for slot in c.layout.joints)
    return when(c.body_of(d) == c.first and not moved)


def _nameless(d: Difference, c: Context) -> Reasons:
    """A part without a name gets another one there."""
    part = d.part.removesuffix(_EXTRA)
    if part != d.part:
        return when(any(w in part for w in ("Bis", "Joint_", "Site_", "_free")), "invented")
    accessor, count = {
        "bodies": (c.model.body, c.model.nbody),
        "joints": (c.model.joint, c.model.njnt),
        "sites": (c.model.site, c.model.nsite),
    }[d.quantity.split()[0]]
    return when(part not in {accessor(i).name for i in range(count)}, "lost")


def _nameless_siblings(d: Difference, c: Context) -> Reasons:
    """Of several bodies without a name below one parent, the first is read once for each."""
    body = c.body_of(d)
    if d.part.endswith(_EXTRA):  # the second copy of the first one's joint
        body = next((s.body for s in c.slots.values() if f"{s.name}{_EXTRA}" == d.part), "world")
    if body == "world" or _has_name(c, body):
        return {}
    siblings = [b for b, up in c.layout.parents.items() if up == c.layout.parents[body]]
    return when(sum(not _has_name(c, b) for b in siblings) > 1)


def _below_nameless(d: Difference, c: Context) -> Reasons:
    """Below any body but the root, a body without a name is lost; its children hang elsewhere."""
    parents, body = c.layout.parents, c.body_of(d)
    if d.quantity.startswith("body ") and body in parents:
        body = parents[body]
    while body in parents and body not in c.there.bodies:
        if not _has_name(c, body) and parents.get(parents[body], "world") != "world":
            return when(True)
        body = parents[body]
    return {}


def _body_missing(d: Difference, c: Context) -> Reasons:
    body = next((b for b in c.layout.parents if d.part.startswith(f"{b}_geom")), "")
    names = {c.model.geom(g).name: int(c.model.geom_bodyid[g]) for g in range(c.model.ngeom)}
    if names.get(d.part):
        body = list(c.layout.parents)[names[d.part] - 1]
    return when(body and body not in c.there.bodies)


# poses


def _root_at_origin(d: Difference, c: Context) -> Reasons:
    """The first body, fixed to the world, stands at the origin there."""
    moved = any(slot.body == d.part for slot in c.layout.joints)
    fixed_root = d.part == c.first and not moved
    return when(fixed_root and _close(c.local(d.part).homogeneous, np.eye(4)))


def _free_body_shifted(d: Difference, c: Context) -> Reasons:
    slot = next((s for s in c.layout.joints if s.body == d.part and s.kind == "free"), None)
    if slot is None:
        return {}
    q = c.layout.q_drawn[slot.q]
    drawn, local = pose_from_wxyz(q[:3], q[3:]), c.local(d.part)
    shifted = 2 * drawn.translation - drawn.rotation @ drawn.translation
    turned = _close(local.rotation, drawn.rotation)
    return when(turned and _close(local.translation, shifted))


def _axis_not_of_unit_length(d: Difference, c: Context) -> Reasons:
    axis = np.array(_written(d, c).get("axisangle", "1 0 0").split(), dtype=float)[:3]
    long = abs(np.linalg.norm(axis) - 1) > EQUAL
    return when(long and not c.turned(d.part, site=d.quantity.startswith("site")))


def _fixed_axes_taken_for_turned(d: Difference, c: Context) -> Reasons:
    sequence = c.text.option("compiler", "eulerseq") if c.text else None
    written = _written(d, c).get("euler")
    if sequence is None or written is None or sequence.islower():
        return {}
    degrees = bool(c.source.spec.compiler.degree)
    angles = np.array(written.split(), dtype=float)
    predicted = Rotation.from_euler(sequence.upper(), angles, degrees=degrees).as_matrix()
    local = c.local(d.part, site=d.quantity.startswith("site"))
    return when(_close(local.rotation, predicted), sequence=sequence)


def _site_pose_from_class(d: Difference, c: Context) -> Reasons:
    """A site without a pose of its own has one from its class."""
    element = c.text.element("site", d.part) if c.text else None
    if c.text is None or element is None:
        return {}
    local = c.local(d.part, site=True)
    names, ignored = set(ORIENTATIONS), _close(local.rotation, np.eye(3))
    if d.quantity == "site offset":
        names, ignored = {"pos"}, _close(local.translation, np.zeros(3))
    own = names & element.attrib.keys()
    return when(ignored and not own and names & c.text.inherited(element).keys())


def _on_body_fixed_to_fixed_body(d: Difference, c: Context) -> Reasons:
    body = c.layout.sites[d.part]
    if body == "world" or c.layout.roots[body] == body:
        return {}
    pose, wrong = c.fixed_site(d.part)
    return when(_close(pose.homogeneous, wrong.homogeneous))


# parameters


def _range(d: Difference, c: Context) -> Reasons:
    """One of the known mistakes with limits, or several at once."""
    j = list(c.slots).index(d.part)
    model, spec, there = c.model, c.source.spec, c.there.joints[d.part].range
    if there is None or spec is None or c.text is None:
        return {}
    limited = bool(model.jnt_limited[j])
    ref = float(model.qpos0[int(model.jnt_qposadr[j])])
    slide = c.slots[d.part].kind == "slide" and bool(spec.compiler.degree)
    # what is possible in this file; a range that is not limited is always used there
    possible = {"limited": not limited, "slide": slide, "ref": ref != 0}
    choices = ([not limited], [False, slide], [False, ref != 0])
    for chosen in product(*choices):
        made = dict(zip(possible, chosen, strict=True))
        predicted = np.array(model.jnt_range[j])
        predicted = np.deg2rad(predicted) if made["slide"] else predicted
        predicted = predicted - ref if made["ref"] else predicted
        if any(chosen) and _close(there, predicted):
            return {name: {"ref": ref} for name, so in made.items() if so}
    return {}


def _no_actuators(d: Difference, c: Context) -> Reasons:
    here, there = c.here.joints[d.part].effort, c.there.joints[d.part].effort
    return when(np.isfinite(here).any() and (np.abs(there) > _HUGE).all() and c.model.nu)


def _zero_limits_of_urdf(d: Difference, c: Context) -> Reasons:
    """Limits of a URDF that MuJoCo takes for none."""
    here, there = c.here.joints[d.part], c.there.joints[d.part]
    if c.text is not None:
        return {}
    if d.quantity == "joint range":
        stated = there.range is not None and there.range[0] == there.range[1]
        none = here.range is not None and np.isinf(here.range).all()
        return when(stated and none, "range")
    return when(not there.effort.any() and np.isinf(here.effort).all(), "effort")


def _damping_polynomial(d: Difference, c: Context) -> Reasons:
    written = c.model.dof_dampingpoly[c.slots[d.part].v].any()
    return when(written and not c.there.joints[d.part].damping.any())


def _ball_damping(d: Difference, c: Context) -> Reasons:
    return when(c.slots[d.part].kind == "ball" and not c.there.joints[d.part].damping.any())


def _default_gravity(d: Difference, c: Context) -> Reasons:
    stated = c.text and (c.text.option("option", "gravity") is not None or c.text.includes)
    return when(stated and _close(c.there.gravity, np.array(_DEFAULT_GRAVITY)))


def _equality(d: Difference, c: Context) -> Reasons:
    if c.text is None:
        return when(True, "mimic")
    names = {c.model.equality(e).name or f"equality{e}": e for e in range(c.model.neq)}
    kind = mujoco.mjtEq(int(c.model.eq_type[names[d.part]])).name.removeprefix("mjEQ_").lower()
    return when(True, "loop" if kind in ("connect", "weld") else "dropped", kind=kind)


EVIDENCE: Mapping[str, Evidence] = MappingProxyType(
    {
        function.__name__.removeprefix("_"): function
        for function in (
            _outside_first_body,
            _in_included_file,
            _in_frame,
            _on_world,
            _on_fixed_root,
            _nameless_siblings,
            _below_nameless,
            _nameless,
            _body_missing,
            _root_at_origin,
            _free_body_shifted,
            _axis_not_of_unit_length,
            _fixed_axes_taken_for_turned,
            _on_body_fixed_to_fixed_body,
            _site_pose_from_class,
            _range,
            _zero_limits_of_urdf,
            _no_actuators,
            _damping_polynomial,
            _ball_damping,
            _default_gravity,
            _equality,
        )
    }
)
"""By the names that ``causes.toml`` gives them."""
