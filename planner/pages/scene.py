"""What a page shows in three dimensions and over time, as plain data without an engine.

A ``Scene`` has models (a tree of joints with meshes on it) and actors (a model at a place, which
may move). The browser computes the kinematics of the tree, so that sliders, plans and recorded
motions are all shown by the same few numbers: joints q and the pose of the base. Poses are rows
(x, y, z, qw, qx, qy, qz) in m, world; times in s; joints in rad or m.

``hand_model`` makes a hand's from its compiled models.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, Literal, TypeAlias

import numpy as np
import pinocchio as pin
import trimesh

from planner.bridge import LinkSurface, link_surfaces
from planner.hands.fingers import Pad
from planner.hands.hand import Hand
from planner.shapes.meshes.triangles import simplified
from planner.spatial import SE3, FloatArray, IntArray, pose_to_wxyz

__all__ = ["hand_model"]


Layer: TypeAlias = Literal[
    "hand",
    "pads",
    "object",
    "table",
    "obstacles",
    "collision",
    "field",
    "regions",
    "frames",
    "alternatives",
    "planned contacts",
    "measured contacts",
    "normals",
    "cones",
    "forces",
]
"""What a person switches on and off. "collision", "field", "frames", "alternatives" start off."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Joint:
    """A joint of a model's tree, and the body that it moves.

    Attributes:
        name: Its name.
        parent: Number of the parent joint in the model; -1 for the base.
        placement: Pose in the parent at q = 0, (7,).
        axis: Unit axis in the joint's own frame, (3,).
        kind: "hinge" turns about the axis, "slide" moves along it.
        lower: Lower limit, rad or m; -inf for none.
        upper: Upper limit.
    """

    name: str
    parent: int
    placement: FloatArray
    axis: FloatArray
    kind: Literal["hinge", "slide"]
    lower: float
    upper: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    """A mesh that is fixed to a joint of a model.

    Attributes:
        name: What is said where it is pointed at.
        joint: Number of the joint that carries it; -1 for the base.
        layer: What switches it.
        vertices: (n, 3), m, in the joint's frame.
        triangles: (k, 3), numbers of vertices, counter-clockwise from outside.
        colour: Red, green, blue, opacity, each in [0, 1].
        smooth: Whether it is shaded as round, across edges of less than 40 degrees.
    """

    name: str
    joint: int = -1
    layer: Layer
    vertices: FloatArray
    triangles: IntArray
    colour: tuple[float, float, float, float]
    smooth: bool = True


@dataclass(frozen=True, kw_only=True, eq=False)
class Model:
    """A tree of joints with meshes: a hand, an object, a table.

    Attributes:
        joints: In the order of q; parents come first.
        parts: The meshes.
        couplings: How sliders move together: ``(C, d)`` with C q = d, (k, nq) and (k,); None for
            joints that move alone.
    """

    joints: tuple[Joint, ...]
    parts: tuple[Part, ...]
    couplings: tuple[FloatArray, FloatArray] | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Actor:
    """A model at a place.

    Attributes:
        name: Its name, as ``Motion`` and the page's buttons use it: "hand", "object".
        model: Name of its model.
        pose: Pose of its base, (7,), world.
        q: Its joints, (nq,); empty for none.
        layer: What switches the whole of it, besides the layers of its parts; None for nothing.
        opacity: A factor on its parts' opacity.
    """

    name: str
    model: str
    pose: FloatArray
    q: FloatArray = field(default_factory=lambda: np.zeros(0))
    layer: Layer | None = None
    opacity: float = 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """Where an actor is over time; between samples the page shows the last one.

    Attributes:
        actor: Its name.
        pose: (m, 7), world.
        q: (m, nq).
    """

    actor: str
    pose: FloatArray
    q: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Contacts:
    """Contacts of fingers with an object over time, or once.

    Attributes:
        name: "planned" or "measured".
        layer: What switches the points.
        fingers: n names.
        points: (m, n, 3), in ``frame``, m; NaN without contact. m is 1 for what does not change.
        normals: (m, n, 3), unit, into the object.
        forces: (m, n, 3), what the hand does to the object, N.
        mu: Sliding friction, which the cones are drawn with.
        actor: Whose frame points, normals and forces are in; None for the world.
    """

    name: Literal["planned", "measured"]
    layer: Layer
    fingers: tuple[str, ...]
    points: FloatArray
    normals: FloatArray
    forces: FloatArray
    mu: float
    actor: str | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Line:
    """A curve of a plot.

    Attributes:
        name: In the legend.
        values: (m,), at ``Scene.time``; NaN leaves a gap. One value, (1,), is a level.
        dashed: Whether it is planned or a limit rather than measured.
        group: Lines of one group have one colour, "" for a colour of its own.
    """

    name: str
    values: FloatArray
    dashed: bool = False
    group: str = ""


@dataclass(frozen=True, kw_only=True, eq=False)
class Plot:
    """Curves over the scene's time.

    Attributes:
        title: What it shows.
        unit: Of the vertical axis, "" for none.
        lines: The curves.
    """

    title: str
    unit: str
    lines: tuple[Line, ...]


@dataclass(frozen=True, kw_only=True)
class Band:
    """A phase: a span of time with a name."""

    name: str
    begin: float
    end: float


@dataclass(frozen=True, kw_only=True)
class Mark:
    """A moment: an event of the controller, or where it went wrong.

    Attributes:
        time: s.
        text: What happened.
        kind: "fault" is drawn in red.
    """

    time: float
    text: str
    kind: Literal["event", "fault"] = "event"


@dataclass(frozen=True, kw_only=True, eq=False)
class Bars:
    """States over the scene's time, one row each: contact modes of fingers.

    Attributes:
        title: What they are.
        rows: Name of a row -> its state at every sample, m names; "" for none.
        colours: State -> colour as in CSS.
    """

    title: str
    rows: dict[str, tuple[str, ...]]
    colours: dict[str, str]


@dataclass(frozen=True, kw_only=True)
class View:
    """A place for the camera, besides front, side and top.

    Attributes:
        name: On its button: "palm".
        direction: From the focus to the camera, (3,), world.
    """

    name: str
    direction: tuple[float, float, float]


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """All that a page shows beside its text.

    Attributes:
        models: Name -> model.
        actors: What stands in the scene.
        focus: Point that the camera looks at first, (3,), m, world.
        radius: Size of what is to be seen, m.
        time: (m,), s; empty for a scene that does not move.
        motions: Where actors are at these times.
        contacts: Sets of contacts.
        plots: Curves over time.
        bars: States over time.
        bands: Phases.
        marks: Moments.
        start: Time at which the page opens, s.
        off: Layers that are off when the page opens.
        views: More places for the camera. The page opens with the one named "start" if there is
            one, which has no button.
        follow: Name of the actor that the camera goes along with; None for a camera that stands.
    """

    models: dict[str, Model]
    actors: tuple[Actor, ...]
    focus: FloatArray
    radius: float
    time: FloatArray = field(default_factory=lambda: np.zeros(0))
    motions: tuple[Motion, ...] = ()
    contacts: tuple[Contacts, ...] = ()
    plots: tuple[Plot, ...] = ()
    bars: tuple[Bars, ...] = ()
    bands: tuple[Band, ...] = ()
    marks: tuple[Mark, ...] = ()
    start: float = 0.0
    off: frozenset[Layer] = field(
        default_factory=lambda: frozenset({"collision", "field", "frames", "alternatives"})
    )
    views: tuple[View, ...] = ()
    follow: str | None = None


IDENTITY_ROW = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
"""The pose of a frame in itself."""


def pose_row(pose: SE3) -> FloatArray:
    """A pose as (7,), m and a unit quaternion."""
    return np.concatenate(pose_to_wxyz(pose))


def pose_rows(poses: Iterable[SE3]) -> FloatArray:
    """Poses as (m, 7)."""
    return np.array([pose_row(p) for p in poses]).reshape(-1, 7)


MOST_TRIANGLES = 40_000
"""Of a hand in a page; with three.js and an object such a page stays below 1 MB."""

LEAST_TRIANGLES = 200
"""That every mesh of a hand may keep."""

PAD_COLOUR = (0.98, 0.80, 0.30, 0.9)
TIP_COLOUR = (0.25, 0.28, 0.32, 1.0)
COLLISION_COLOUR = (0.20, 0.65, 0.85, 0.35)
PLAIN_COLOUR = (0.74, 0.77, 0.80, 1.0)
"""Colours: pads, the geometry that carries them, what collides, what has no colour of its own."""

MUJOCO_GREY = (0.5, 0.5, 0.5, 1.0)
"""MuJoCo's colour of a geom that is given none."""

PROUD = 3e-4
"""How far (m) a pad is drawn above its sphere, so that it is not hidden in the tip."""


@lru_cache(maxsize=8)
def hand_model(hand: Hand, *, for_painter: bool = False) -> Model:
    """A hand, with its arm if it has one, as a model: joints in the order of q.

    Bodies are drawn by their visual geoms, those without one by their colliding geoms. Layer
    "pads" holds the part of each pad's sphere on which contacts may lie, "collision" what collides
    (a mesh by its convex hull).

    Args:
        hand: The hand.
        for_painter: Every triangle, and nothing of "collision": ``planner.pages.painter`` makes its
            own choice of triangles, in a tenth of the time.
    """
    surfaces = link_surfaces(hand.mj_model, hand.pin_model)
    seen = {s.body for s in surfaces if not s.collides and s.colour[3] > 0}
    shown = [s for s in surfaces if s.collides != (s.body in seen)]
    hulls = [_collision(s) for s in surfaces if s.collides and not for_painter]
    share = 1.0 if for_painter else MOST_TRIANGLES / max(1, sum(len(s.triangles) for s in shown))
    carriers = {f.pad.geom for f in hand.fingers.values()}
    matrix, value = hand.coupling_matrix
    return Model(
        joints=_joints(hand.pin_model),
        parts=(
            *(_visual(s, share, s.name in carriers) for s in shown),
            *(_pad(f.name, f.pad) for f in hand.fingers.values()),
            *hulls,
        ),
        couplings=(matrix, value) if len(value) else None,
    )


def _joints(model: Any) -> tuple[Joint, ...]:
    """Pinocchio's joints from 1 on; number i here is joint i + 1 there."""
    data = model.createData()
    pin.forwardKinematics(model, data, pin.neutral(model))
    out = []
    for i in range(1, model.njoints):
        subspace = np.ravel(data.joints[i].S)  # (6,): linear, angular
        is_hinge = bool(np.abs(subspace[3:]).max() > 0)
        out.append(
            Joint(
                name=model.names[i],
                parent=int(model.parents[i]) - 1,
                placement=pose_row(model.jointPlacements[i]),
                axis=np.array(subspace[3:] if is_hinge else subspace[:3]),
                kind="hinge" if is_hinge else "slide",
                lower=float(model.lowerPositionLimit[i - 1]),
                upper=float(model.upperPositionLimit[i - 1]),
            )
        )
    return tuple(out)


def _visual(surface: LinkSurface, share: float, carries_pad: bool) -> Part:
    colour = surface.colour
    if np.allclose(colour, MUJOCO_GREY):
        colour = TIP_COLOUR if carries_pad else PLAIN_COLOUR
    elif colour[3] == 0:
        colour = PLAIN_COLOUR
    most = max(LEAST_TRIANGLES, int(share * len(surface.triangles)))
    vertices, triangles, _ = simplified(surface.vertices, surface.triangles, most)
    return _part(surface, "hand", vertices, triangles, colour)


def _collision(surface: LinkSurface) -> Part:
    vertices, triangles = surface.vertices, surface.triangles
    if surface.is_mesh:
        hull = trimesh.convex.convex_hull(vertices)
        vertices, triangles, _ = simplified(
            np.asarray(hull.vertices), np.asarray(hull.faces, np.int64), LEAST_TRIANGLES
        )
    return _part(surface, "collision", vertices, triangles, COLLISION_COLOUR)


def _part(
    surface: LinkSurface,
    layer: Layer,
    vertices: FloatArray,
    triangles: Any,
    colour: tuple[float, float, float, float],
) -> Part:
    return Part(
        name=surface.name,
        joint=surface.joint_id - 1,
        layer=layer,
        vertices=vertices,
        triangles=triangles,
        colour=colour,
    )


def _pad(finger: str, pad: Pad) -> Part:
    """The cap of a pad's sphere within its half angle about its axis."""
    rings, around = 8, 24
    polar = np.linspace(0.0, pad.half_angle, rings + 1)[1:]
    turn = 2 * np.pi * np.arange(around) / around
    local = [np.array([[0.0, 0.0, 1.0]])]
    local += [
        np.column_stack([np.sin(p) * np.cos(turn), np.sin(p) * np.sin(turn), 0 * turn + np.cos(p)])
        for p in polar
    ]
    points = np.concatenate(local) * (pad.radius + PROUD)
    next_ = np.roll(np.arange(around), -1)
    triangles = [np.column_stack([0 * next_, 1 + np.arange(around), 1 + next_])]
    for ring in range(rings - 1):
        a, b = 1 + ring * around + np.arange(around), 1 + ring * around + next_
        triangles += [
            np.column_stack([a, a + around, b + around]),
            np.column_stack([a, b + around, b]),
        ]
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), np.array(pad.axis)).matrix()
    return Part(
        name=f"pad of {finger}",
        joint=pad.joint_id - 1,
        layer="pads",
        vertices=points @ turn.T + pad.center,
        triangles=np.concatenate(triangles).astype(np.int64),
        colour=PAD_COLOUR,
    )
