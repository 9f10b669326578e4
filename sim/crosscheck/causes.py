"""Why Pinocchio's own reader differs: known causes, each seen in the file, most in the numbers too.

``causes.toml`` lists the known mistakes of one version of that reader. A cause is named only if the
file has the feature at the very part that differs. Where the mistake produces a known value, the
reader's value is compared with it: poses, limits, damping, gravity, masses, balanced inertias,
scaled and fitted meshes. Of an ``axisangle`` the reader's matrix must be no rotation. Missing
parts, equalities, a mesh's ``refpos`` and a geom's pose from its class are named by the feature
alone. Anything else stays without a cause ("cause unknown").

``EVIDENCE`` has a function for each: it looks at one difference and gives the reasons that apply
with the values of their texts; none where they do not. A mistake with masses is made on purpose in
a copy of the model, which MuJoCo then compiles: the cause is named if the reader's mass is the one
that comes out.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import cache
from importlib.resources import files
from itertools import product
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeAlias
from xml.etree import ElementTree

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from planner.bridge.pinocchio_model import body_name
from planner.spatial import SE3, FloatArray, pose_from_wxyz, skew
from sim.crosscheck.compare import local_pose
from sim.crosscheck.geometry import geom_name
from sim.crosscheck.mujoco_side import MujocoSide
from sim.crosscheck.parts import Difference, Slot, as_drawn
from sim.crosscheck.pinocchio_side import PinocchioSide
from sim.crosscheck.reader import ReaderResult, Source, is_urdf
from sim.crosscheck.report import Column


@cache
def _known() -> tuple[dict[str, Any], ...]:
    """The table of causes."""
    text = files("sim.crosscheck").joinpath("causes.toml").read_text(encoding="utf-8")
    return tuple(tomllib.loads(text)["cause"])


def explain(column: Column, context: Context) -> Column:
    """The column with a cause at each fault where one is known.

    Poses, forces and accelerations differ as a consequence of these faults, and get no cause.
    """
    faults = set(column.faults)
    explained = (_explain(d, context) if d in faults else d for d in column.differences)
    return replace(column, differences=tuple(explained))


def _explain(difference: Difference, context: Context) -> Difference:
    for cause in _known():
        if difference.quantity in cause["quantities"]:
            seen = EVIDENCE[cause["evidence"]](difference, context)
            if seen:
                reasons = (cause["reason"][name].format(**f) for name, f in seen.items())
                return replace(difference, cause=cause["key"], reason="; ".join(reasons))
    return difference


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


ORIENTATIONS = ("quat", "axisangle", "euler", "xyaxes", "zaxis", "fromto")
"""Attributes of MJCF that turn an element."""

EQUAL = 1e-6
"""Up to which a value, m, rad or relative, is the one that a mistake predicts."""


class Context:
    """A model, what Pinocchio's own reader made of it, and the text of the file.

    ``twins`` keeps what ``_twin`` compiles: mistakes -> bodies touched, their masses.
    """

    def __init__(
        self, source: Source, here: MujocoSide, there: PinocchioSide, result: ReaderResult
    ) -> None:
        """Compute what is asked for again and again.

        Args:
            source: The model, from a file.
            here: The reference.
            there: The reader's model.
            result: What the reader gave.
        """
        self.source, self.model, self.layout = source, source.model, here.layout
        self.result = result
        mjcf = None if source.path is None or is_urdf(source.path) else source.path
        self.text = None if mjcf is None else MjcfText(mjcf)
        self.here, self.there = here.parts(), there.parts()
        drawn = as_drawn(here.layout)
        self._drawn = here.observe(drawn), there.observe(drawn)
        self.twins: dict[tuple[str, ...], tuple[frozenset[str], dict[str, float]]] = {}
        self.slots: dict[str, Slot] = {slot.name: slot for slot in here.layout.joints}

    def local(self, part: str, *, site: bool = False) -> SE3:
        """The reader's pose of a body or site in its parent's frame, as the model is drawn."""
        there = self._drawn[1]
        return local_pose(self.layout, there, there, part, site=site)

    def pose_in(self, root: str, body: str) -> SE3:
        """The reference's pose of a body in a body that it is fixed to."""
        here = self._drawn[0]
        return here.bodies[root].actInv(here.bodies[body])

    def fixed_site(self, site: str) -> tuple[SE3, SE3]:
        """The reader's pose of a site in the moving body that carries it, and the wrong one.

        The wrong one is what comes out where the site's body is placed by its own offset alone,
        as if the body that it is fixed to stood at the moving body's origin.
        """
        here, there = self._drawn
        body = self.layout.sites[site]
        root = self.layout.roots[body]
        pose = there.sites[site]
        carried = pose if root not in there.bodies else there.bodies[root].actInv(pose)
        wrong = local_pose(self.layout, there, here, body) * local_pose(
            self.layout, there, here, site, site=True
        )
        return carried, wrong

    def turned(self, part: str, *, site: bool = False) -> bool:
        """Whether the reader's orientation of a part is that of a rotation at all."""
        rotation = np.asarray(self.local(part, site=site).rotation)
        return bool(np.abs(rotation.T @ rotation - np.eye(3)).max() < EQUAL)

    def body_of(self, difference: Difference) -> str:
        """Body of the joint, site or body that a difference is about; "world" if it has none."""
        part = difference.part
        if difference.quantity.startswith("site"):
            return self.layout.sites.get(part, "world")
        if part in self.slots and difference.quantity.startswith("joint"):
            return self.slots[part].body
        return part if part in self.layout.parents else "world"

    def top(self, body: str) -> str:
        """The ancestor of a body that stands right below the world."""
        while self.layout.parents.get(body, "world") != "world":
            body = self.layout.parents[body]
        return body

    @property
    def first(self) -> str:
        """The first body below the world."""
        return next(iter(self.layout.parents))


Reasons: TypeAlias = dict[str, dict[str, Any]]
"""Name of each reason that applies -> values of its text."""

Evidence: TypeAlias = Callable[[Difference, Context], Reasons]

_EVIDENCE: dict[str, Evidence] = {}

EVIDENCE: Mapping[str, Evidence] = MappingProxyType(_EVIDENCE)
"""By the names that ``causes.toml`` gives them."""


def evidence(function: Evidence) -> Evidence:
    """Register a function by its name, without the underscore."""
    _EVIDENCE[function.__name__.removeprefix("_")] = function
    return function


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


@evidence
def _outside_first_body(d: Difference, c: Context) -> Reasons:
    body = c.body_of(d)
    return when(d.error and body != "world" and c.top(body) != c.first, first=c.first)


@evidence
def _in_included_file(d: Difference, c: Context) -> Reasons:
    body = c.body_of(d)
    included = c.text and c.text.includes and body != "world"
    return when(included and c.text and c.text.element("body", body) is None)


@evidence
def _in_frame(d: Difference, c: Context) -> Reasons:
    if c.text is None:
        return {}
    kind = {"joints present": "joint", "sites present": "site"}.get(d.quantity, "body")
    element = c.text.element(kind, d.part)
    if element is None:
        element = c.text.element("body", c.body_of(d))
    return when(element is not None and any(a.tag == "frame" for a in c.text.ancestors(element)))


@evidence
def _on_world(d: Difference, c: Context) -> Reasons:
    return when(c.layout.sites.get(d.part) == "world")


@evidence
def _on_fixed_root(d: Difference, c: Context) -> Reasons:
    moved = any(slot.body == c.first for slot in c.layout.joints)
    return when(c.body_of(d) == c.first and not moved)


@evidence
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


@evidence
def _nameless_siblings(d: Difference, c: Context) -> Reasons:
    """Of several bodies without a name below one parent, the first is read once for each."""
    body = c.body_of(d)
    if d.part.endswith(_EXTRA):  # the second copy of the first one's joint
        body = next((s.body for s in c.slots.values() if f"{s.name}{_EXTRA}" == d.part), "world")
    if body == "world" or _has_name(c, body):
        return {}
    siblings = [b for b, up in c.layout.parents.items() if up == c.layout.parents[body]]
    return when(sum(not _has_name(c, b) for b in siblings) > 1)


@evidence
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


@evidence
def _body_missing(d: Difference, c: Context) -> Reasons:
    body = next((b for b in c.layout.parents if d.part.startswith(f"{b}_geom")), "")
    names = {c.model.geom(g).name: int(c.model.geom_bodyid[g]) for g in range(c.model.ngeom)}
    if names.get(d.part):
        body = list(c.layout.parents)[names[d.part] - 1]
    return when(body and body not in c.there.bodies)


# poses


@evidence
def _root_at_origin(d: Difference, c: Context) -> Reasons:
    """The first body, fixed to the world, stands at the origin there."""
    moved = any(slot.body == d.part for slot in c.layout.joints)
    fixed_root = d.part == c.first and not moved
    return when(fixed_root and _close(c.local(d.part).homogeneous, np.eye(4)))


@evidence
def _free_body_shifted(d: Difference, c: Context) -> Reasons:
    slot = next((s for s in c.layout.joints if s.body == d.part and s.kind == "free"), None)
    if slot is None:
        return {}
    q = c.layout.q_drawn[slot.q]
    drawn, local = pose_from_wxyz(q[:3], q[3:]), c.local(d.part)
    shifted = 2 * drawn.translation - drawn.rotation @ drawn.translation
    turned = _close(local.rotation, drawn.rotation)
    return when(turned and _close(local.translation, shifted))


@evidence
def _axis_not_of_unit_length(d: Difference, c: Context) -> Reasons:
    axis = np.array(_written(d, c).get("axisangle", "1 0 0").split(), dtype=float)[:3]
    long = abs(np.linalg.norm(axis) - 1) > EQUAL
    return when(long and not c.turned(d.part, site=d.quantity.startswith("site")))


@evidence
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


@evidence
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


@evidence
def _on_body_fixed_to_fixed_body(d: Difference, c: Context) -> Reasons:
    body = c.layout.sites[d.part]
    if body == "world" or c.layout.roots[body] == body:
        return {}
    pose, wrong = c.fixed_site(d.part)
    return when(_close(pose.homogeneous, wrong.homogeneous))


# parameters


@evidence
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


@evidence
def _no_actuators(d: Difference, c: Context) -> Reasons:
    here, there = c.here.joints[d.part].effort, c.there.joints[d.part].effort
    return when(np.isfinite(here).any() and (np.abs(there) > _HUGE).all() and c.model.nu)


@evidence
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


@evidence
def _damping_polynomial(d: Difference, c: Context) -> Reasons:
    written = c.model.dof_dampingpoly[c.slots[d.part].v].any()
    return when(written and not c.there.joints[d.part].damping.any())


@evidence
def _ball_damping(d: Difference, c: Context) -> Reasons:
    return when(c.slots[d.part].kind == "ball" and not c.there.joints[d.part].damping.any())


@evidence
def _default_gravity(d: Difference, c: Context) -> Reasons:
    stated = c.text and (c.text.option("option", "gravity") is not None or c.text.includes)
    return when(stated and _close(c.there.gravity, np.array(_DEFAULT_GRAVITY)))


@evidence
def _equality(d: Difference, c: Context) -> Reasons:
    if c.text is None:
        return when(True, "mimic")
    names = {c.model.equality(e).name or f"equality{e}": e for e in range(c.model.neq)}
    kind = mujoco.mjtEq(int(c.model.eq_type[names[d.part]])).name.removeprefix("mjEQ_").lower()
    return when(True, "loop" if kind in ("connect", "weld") else "dropped", kind=kind)


_SHOWN = 1e-4
"""Up to which sizes, as they are shown with six digits, are equal (relative)."""

_MESH = int(mujoco.mjtGeom.mjGEOM_MESH)
_MASS_OF_MESH = 1.0
"""Mass, kg, and inertia, kg m2, that the reader gives to a body of mesh geoms without inertial."""


def _mesh_mass(spec: Any, c: Context) -> set[str]:
    """Every body without inertial whose mass comes from meshes gets 1 kg."""
    changed = set()
    for i, body in enumerate(spec.bodies):
        if i and not body.explicitinertial and any(int(g.type) == _MESH for g in body.geoms):
            body.explicitinertial, body.mass = True, _MASS_OF_MESH
            body.inertia, body.ipos = np.full(3, _MASS_OF_MESH), np.zeros(3)
            body.fullinertia = np.full(6, np.nan)
            changed.add(body_name(c.model, i))
    return changed


def _class_mass(spec: Any, c: Context) -> set[str]:
    """A geom whose mass comes from its class gets density times volume."""
    changed = set()
    for i, body in enumerate(spec.bodies):
        for k, geom in enumerate(body.geoms):
            element = _element(c, int(c.model.body_geomadr[i]) + k)
            if c.text is None or element is None or "mass" in element.attrib:
                continue
            if "mass" in c.text.inherited(element):
                geom.mass = np.nan
                changed.add(body_name(c.model, i))
    return changed


def _group_range(spec: Any, c: Context) -> set[str]:
    """Geoms of all groups count."""
    low, high = spec.compiler.inertiagrouprange
    if low <= 0 and high >= 5:
        return set()
    spec.compiler.inertiagrouprange = (0, 5)
    return set(c.layout.parents)


def _total_mass(spec: Any, c: Context) -> set[str]:
    """Masses stay as they are written."""
    if spec.compiler.settotalmass <= 0:
        return set()
    spec.compiler.settotalmass = -1
    return set(c.layout.parents)


_Mistake: TypeAlias = Callable[[Any, Context], set[str]]
_MISTAKES: Mapping[str, _Mistake] = {
    "mesh": _mesh_mass,
    "class": _class_mass,
    "group": _group_range,
    "total": _total_mass,
}


@evidence
def _mass(d: Difference, c: Context) -> Reasons:
    """The mistakes that explain the mass of a link, one alone or all of the file together."""
    if c.source.spec is None or d.part not in c.there.links:
        return {}
    links = {b for b, root in c.layout.roots.items() if root == d.part}
    for trial in (*((name,) for name in _MISTAKES), tuple(_MISTAKES)):
        touched, masses = _twin(c, trial)
        predicted = sum(masses[b] for b in links)
        weighed = c.there.links[d.part].mass
        if touched & links and abs(predicted - weighed) <= EQUAL * predicted:
            return {name: {} for name in trial if _twin(c, (name,))[0] & links}
    return {}


def _twin(c: Context, mistakes: tuple[str, ...]) -> tuple[frozenset[str], dict[str, float]]:
    """Bodies that mistakes touch, and the masses of all bodies, kg, that come out."""
    if mistakes not in c.twins:
        spec = c.source.spec.copy()
        touched = frozenset().union(*(_MISTAKES[name](spec, c) for name in mistakes))
        model = spec.compile() if touched else c.model
        names = ["world", *c.layout.parents]
        c.twins[mistakes] = touched, {n: float(model.body_mass[i]) for i, n in enumerate(names)}
    return c.twins[mistakes]


@evidence
def _not_balanced(d: Difference, c: Context) -> Reasons:
    """The inertia as it is written, impossible as it may be, is the reader's."""
    spec = c.source.spec
    if spec is None or not spec.compiler.balanceinertia or d.part not in c.there.links:
        return {}
    theirs = c.there.links[d.part]
    names = ["world", *c.layout.parents]
    total = np.zeros((3, 3))
    for name, root in c.layout.roots.items():
        if root != d.part:
            continue
        body = spec.bodies[names.index(name)]
        if not body.explicitinertial:
            continue
        full = np.array(body.fullinertia)
        tensor = np.diag(body.inertia)
        turn = pose_from_wxyz(np.zeros(3), body.iquat).rotation
        if np.isfinite(full).all():
            (xx, yy, zz, xy, xz, yz) = full
            tensor, turn = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), np.eye(3)
        local = c.pose_in(d.part, name)
        turn = local.rotation @ turn
        arm = skew(local.act(np.array(body.ipos)) - theirs.center)
        total += turn @ tensor @ turn.T - body.mass * arm @ arm
    return when(np.allclose(total, theirs.inertia, rtol=0, atol=EQUAL * np.abs(total).max()))


@evidence
def _geometry(d: Difference, c: Context) -> Reasons:
    """Wrong size or place of a geometry."""
    g = next(g for g in range(c.model.ngeom) if geom_name(c.model, g) == d.part)
    element = _element(c, g)
    if c.text is None or element is None or not d.value:
        return {}
    inherited = c.text.inherited(element)
    attributes = inherited | element.attrib
    here, there = (np.array(v.strip("()").split(), dtype=float) for v in (d.reference, d.value))
    if "mesh" in attributes and attributes.get("type", "sphere") != "mesh":
        return when(there.max() < EQUAL, "fitted")
    asset = _asset(c, attributes.get("mesh"))
    if asset is not None:
        scale = c.text.inherited(asset).get("scale")
        if scale is not None and "scale" not in asset.attrib:
            factors = np.abs(np.array(scale.split(), dtype=float))
            if np.allclose(there * factors, here, rtol=_SHOWN, atol=EQUAL):
                return when(True, "scale")
        if {"refpos", "refquat"} & asset.attrib.keys():
            return when(True, "refpos")
    return when({"pos", *ORIENTATIONS} & (inherited.keys() - element.attrib.keys()), "class")


def _asset(c: Context, name: str | None) -> Any:
    """The mesh of that name as it is written; without a name it is called after its file."""
    if c.text is None or name is None:
        return None
    for mesh in c.text.root.iterfind("asset/mesh"):
        if mesh.get("name", Path(mesh.get("file", "")).stem) == name:
            return mesh
    return None


def _element(c: Context, g: int) -> Any:
    """The geom as it is written."""
    if c.text is None:
        return None
    if c.model.geom(g).name:
        return c.text.element("geom", c.model.geom(g).name)
    body = int(c.model.geom_bodyid[g])
    owner = c.text.element("body", body_name(c.model, body))
    written = [] if owner is None else owner.findall("geom")
    order = g - int(c.model.body_geomadr[body])
    return written[order] if order < len(written) else None


_MAIN = "main"
"""Name of the class that applies where none is named."""


class MjcfText:
    """The elements of one MJCF file as written, and what they have of their classes.

    The compiled model knows all values and not where they came from. Files that it includes are not
    opened.
    """

    def __init__(self, path: Path) -> None:
        """Read the file, which MuJoCo has read before."""
        self.root = ElementTree.parse(path).getroot()
        self._parents = {child: parent for parent in self.root.iter() for child in parent}
        self._classes: dict[str, dict[str, dict[str, str]]] = {_MAIN: {}}
        for default in self.root.findall("default"):
            self._read_class(default, default.get("class", _MAIN), {})

    def _read_class(
        self, element: ElementTree.Element, name: str, above: dict[str, dict[str, str]]
    ) -> None:
        values = {tag: dict(attributes) for tag, attributes in above.items()}
        for child in element:
            if child.tag != "default":
                values.setdefault(child.tag, {}).update(child.attrib)
        self._classes[name] = values
        for child in element.findall("default"):
            self._read_class(child, child.get("class", ""), values)

    def element(self, tag: str, name: str) -> ElementTree.Element | None:
        """The element below the world with that tag and name."""
        world = self.root.find("worldbody")
        if world is None:
            return None
        return next((e for e in world.iter(tag) if e.get("name") == name), None)

    def ancestors(self, element: ElementTree.Element) -> Iterator[ElementTree.Element]:
        """Parent, grandparent and so on."""
        while element in self._parents:
            element = self._parents[element]
            yield element

    def inherited(self, element: ElementTree.Element) -> dict[str, str]:
        """Attributes that the element has from its class."""
        name = element.get("class")
        if name is None:
            classes = (a.get("childclass") for a in self.ancestors(element))
            name = next((c for c in classes if c is not None), _MAIN)
        return self._classes.get(name, {}).get(element.tag, {})

    def option(self, tag: str, attribute: str) -> str | None:
        """Attribute of a top-level element such as ``compiler``; None if it is not written."""
        values = [e.get(attribute) for e in self.root.findall(tag)]
        return next((v for v in reversed(values) if v is not None), None)

    @property
    def includes(self) -> bool:
        """Whether the file includes another one."""
        return self.root.find(".//include") is not None
