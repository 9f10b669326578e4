"""Known causes for parts that Pinocchio's own reader lacks, and for files that it refuses."""

from __future__ import annotations

from sim.crosscheck.cause_context import Context
from sim.crosscheck.mjcf_text import MjcfText
from sim.crosscheck.quantities import Difference
from sim.crosscheck.reader import is_urdf
from sim.crosscheck.sources import Source

__all__ = ["STRUCTURE", "explain_failure"]


def explain_failure(source: Source, failure: str) -> str:
    """Why the reader gave no model, with the cause where it is known."""
    cause = "cause unknown"
    if source.path is not None and not is_urdf(source.path):
        text = MjcfText(source.path)
        world = text.root.find("worldbody")
        if "No such node (body)" in failure and world is not None:
            if world.find("body") is None and world.find("frame") is not None:
                cause = "a <frame> right below <worldbody> is not read"
            elif world.find("body") is None and text.includes:
                cause = "<include> is not followed, and the bodies stand in another file"
        elif text.includes:
            cause = "<include> is not followed: what it brings is missing here"
    return f"{failure} ({cause})"


def _first_body(d: Difference, c: Context) -> str:
    body = c.body_of(d)
    if d.error and body != "world" and c.top(body) != c.first:
        return f"only the first body below the world, {c.first!r}, is read"
    return ""


def _include(d: Difference, c: Context) -> str:
    body = c.body_of(d)
    if c.text and c.text.includes and body != "world" and c.text.element("body", body) is None:
        return "it comes from an <include>, which is not followed"
    return ""


def _frame(d: Difference, c: Context) -> str:
    if c.text is None:
        return ""
    kind = {"joints present": "joint", "sites present": "site"}.get(d.quantity, "body")
    element = c.text.element(kind, d.part)
    if element is None:
        element = c.text.element("body", c.body_of(d))
    if element is not None and any(a.tag == "frame" for a in c.text.ancestors(element)):
        return "it stands in a <frame>, whose children are lost"
    return ""


def _world_site(d: Difference, c: Context) -> str:
    if d.quantity == "sites present" and c.layout.sites.get(d.part) == "world":
        return "sites of the world are not read"
    return ""


def _root_site(d: Difference, c: Context) -> str:
    moved = any(slot.body == c.first for slot in c.layout.joints)
    if d.quantity == "sites present" and c.body_of(d) == c.first and not moved:
        return "sites of a root body without joint are not read"
    return ""


def _unnamed(d: Difference, c: Context) -> str:
    """A part without a name gets another one there."""
    part = d.part.removesuffix(_EXTRA)
    if part != d.part:
        invented = any(word in part for word in ("Bis", "Joint_", "Site_", "_free"))
        return "the reader's name for a part without one" if invented else ""
    kind = d.quantity.split()[0]
    accessor, count = {
        "bodies": (c.model.body, c.model.nbody),
        "joints": (c.model.joint, c.model.njnt),
        "sites": (c.model.site, c.model.nsite),
    }[kind]
    if part not in {accessor(i).name for i in range(count)}:
        return "it has no name in the file, and another one there"
    return ""


def _nameless_siblings(d: Difference, c: Context) -> str:
    """Of several bodies without a name below one parent, the first is read once for each."""
    body = c.body_of(d)
    if d.part.endswith(_EXTRA):  # the second copy of the first one's joint
        body = next((s.body for s in c.slots.values() if f"{s.name}{_EXTRA}" == d.part), "world")
    if body == "world" or _has_name(c, body):
        return ""
    parent = c.layout.parents[body]
    siblings = [b for b, up in c.layout.parents.items() if up == parent and not _has_name(c, b)]
    if len(siblings) > 1:
        return "of several bodies without a name below one parent, the first is read repeatedly"
    return ""


def _nameless_lost(d: Difference, c: Context) -> str:
    """Below any body but the root, a body without a name is lost; its children hang elsewhere."""
    body = c.body_of(d)
    if d.quantity.startswith("body ") and body in c.layout.parents:
        body = c.layout.parents[body]
    while body in c.layout.parents and body not in c.there.bodies:
        parent = c.layout.parents[body]
        if not _has_name(c, body) and c.layout.parents.get(parent, "world") != "world":
            return "a body without a name, below a body that is not the root, is lost"
        body = parent
    return ""


def _has_name(c: Context, body: str) -> bool:
    return bool(c.model.body(["world", *c.layout.parents].index(body)).name)


_EXTRA = " (not in the reference)"


def _geometry_of_lost_body(d: Difference, c: Context) -> str:
    body = next((b for b in c.layout.parents if d.part.startswith(f"{b}_geom")), "")
    names = {c.model.geom(g).name: int(c.model.geom_bodyid[g]) for g in range(c.model.ngeom)}
    if names.get(d.part):
        body = list(c.layout.parents)[names[d.part] - 1]
    return "its body is missing there" if body and body not in c.there.bodies else ""


_PARTS = ("joints present", "bodies present", "sites present")

STRUCTURE = (
    ("first body only", _PARTS, _first_body),
    ("include", _PARTS, _include),
    ("frame", _PARTS, _frame),
    ("world site", _PARTS, _world_site),
    ("root site", _PARTS, _root_site),
    ("no name", (*_PARTS, "mass", "link centre", "inertia"), _nameless_siblings),
    ("no name", (*_PARTS, "body offset", "body turn"), _nameless_lost),
    ("no name", _PARTS, _unnamed),
    ("body missing", ("geometries present",), _geometry_of_lost_body),
)
"""Key, quantities and check of each cause; a check gives the reason in words, or ""."""
