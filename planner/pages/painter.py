"""A still picture of a scene without a graphics processor: triangles, sorted by depth, and marks.

For notebooks and thumbnails. The camera is at infinity; light comes from above beside it; every
triangle has one shade. What is behind something by less than the size of a triangle may show.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw

from planner.pages.scene import Actor, Contacts, Layer, Model, Part, Scene
from planner.shapes.meshes.triangles import clustered
from planner.spatial import SE3, FloatArray, IntArray, pose_from_wxyz

__all__ = ["data_uri", "paint"]

SUPERSAMPLE = 2
"""Pixels of the drawing per pixel of the picture, along each side."""

MOST_TRIANGLES = 6000
"""Triangles of all parts together; meshes of models with more are simplified."""

LEAST_TRIANGLES, LEAST_OF_OBJECT = 60, 20_000
"""That every part, and a part of the object, may keep: thin walls would get holes."""

LONGEST_EDGE = 0.15
"""Longest edge of a triangle, in radii of the scene: a large one would be sorted wrongly."""

LEAST_LIGHT, LIGHT_FROM = 0.5, (-0.45, 0.65, 0.6)
"""Light where none falls (-), and where it comes from: right, up and towards the camera."""

COLOURS = 256
"""Of the picture's palette."""

HIDDEN: frozenset[Layer] = frozenset(
    {"collision", "field", "frames", "alternatives", "cones", "regions"}
)
"""Layers that are not painted."""

BACKGROUND, FLOOR = (255, 255, 255), (236, 233, 228)
"""Colours of the background and of the table."""

FINGER_COLOURS = (
    (213, 94, 0),
    (0, 114, 178),
    (0, 158, 115),
    (204, 121, 167),
    (86, 180, 233),
    (230, 159, 0),
    (117, 112, 179),
    (102, 102, 102),
)
"""Of contacts, in the order of the fingers; told apart by colour-blind readers too. Pages have the
same (``assets/unpack.js``)."""

PAD_NEARER = 2e-3
"""How much nearer (m) than it is a pad counts when triangles are sorted."""

SEEN = 2.0
"""How far from the middle, in radii of the scene, triangles are painted: an arm reaches out."""

DARKEST = 0.2
"""What black is painted as (-), so that its shades can be told apart."""

DOT = 0.019
"""Radius of a contact's mark over the shorter side of the picture; hollow where it is behind."""

NORMAL = 0.16
"""Length of a contact's normal as painted, in radii of the scene."""

MARGIN = 0.05
"""Free border of the picture (-)."""


def paint(
    scene: Scene,
    direction: Sequence[float],
    *,
    size: tuple[int, int] = (320, 260),
    up: Sequence[float] = (0.0, 0.0, 1.0),
) -> bytes:
    """A picture of a scene as it stands, as PNG.

    Args:
        scene: Actors, where they are, and contacts, of which the first set is marked.
        direction: From the middle to the camera, (3,), world.
        size: Width and height, pixels.
        up: What is up in the picture, (3,), world, not along ``direction``.
    """
    camera = _camera(np.array(direction, dtype=np.float64), np.array(up, dtype=np.float64))
    corners, colours, nearer = _triangles(scene)
    turned = (corners - scene.focus) @ camera.T  # right, up, towards the camera
    cross: FloatArray = np.cross(turned[:, 1] - turned[:, 0], turned[:, 2] - turned[:, 0])
    facing = cross[:, 2] > 0
    turned, cross, colours = turned[facing], cross[facing], colours[facing]
    depth = turned[:, :, 2].mean(axis=1) + nearer[facing]
    order = np.argsort(depth, kind="stable")
    shades = _shaded(cross, colours)
    marks = (_marks(scene) - scene.focus) @ camera.T
    points = np.concatenate([turned.mean(axis=1), marks.reshape(-1, 3)])
    seen = points[np.linalg.norm(points, axis=1) <= scene.radius, :2]
    lower, upper = seen.min(axis=0), seen.max(axis=0)
    wide = np.array(size) * SUPERSAMPLE
    scale = float(((1 - 2 * MARGIN) * wide / np.maximum(upper - lower, 1e-9)).min())
    middle = (lower + upper) / 2

    def pixels(points: FloatArray) -> FloatArray:
        flat = (points - middle) * scale
        drawn: FloatArray = wide / 2 + flat * (1.0, -1.0)
        return drawn

    image = Image.new("RGB", (int(wide[0]), int(wide[1])), BACKGROUND)
    draw = ImageDraw.Draw(image)
    for floor in _floors(scene):
        draw.polygon(pixels((floor - scene.focus) @ camera[:2].T).ravel().tolist(), fill=FLOOR)
    flat = pixels(turned[:, :, :2].reshape(-1, 2)).reshape(-1, 6)[order].tolist()
    for corner, shade in zip(flat, shades[order].tolist(), strict=True):
        draw.polygon(corner, fill=tuple(shade), outline=tuple(shade))
    for k, (point, tail) in enumerate(marks):
        colour = FINGER_COLOURS[k % len(FINGER_COLOURS)]
        is_behind = tail[2] < point[2]  # the surface there faces away from the camera
        at, end = pixels(np.array([point[:2], tail[:2]]))
        radius = DOT * wide.min()
        draw.line([*end.tolist(), *at.tolist()], fill=colour, width=round(0.6 * radius))
        box = [*(at - radius).tolist(), *(at + radius).tolist()]
        inner, outer = (BACKGROUND, colour) if is_behind else (colour, BACKGROUND)
        draw.ellipse(box, fill=inner, outline=outer, width=round(1.5 * SUPERSAMPLE))
    small = image.resize(size, Image.Resampling.LANCZOS)
    out = io.BytesIO()
    small.quantize(COLOURS, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE).save(
        out, "PNG", optimize=True
    )
    return out.getvalue()


def data_uri(picture: bytes) -> str:
    """A PNG as the address of an image within HTML."""
    return "data:image/png;base64," + base64.b64encode(picture).decode("ascii")


def _camera(direction: FloatArray, up: FloatArray) -> FloatArray:
    """Rotation (3, 3) from the world to right, up and towards the camera."""
    towards = direction / np.linalg.norm(direction)
    right = np.cross(up, towards)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(towards, right), towards])


def _triangles(scene: Scene) -> tuple[FloatArray, FloatArray, FloatArray]:
    """All that is painted: triangles (k, 3 corners, 3), m, world, their colours (k, 3) in [0, 1].

    And how much nearer to the camera they count (k,), m: pads lie on their tips.
    """
    found = [
        (actor, part, poses)
        for actor in scene.actors
        if actor.layer not in HIDDEN
        for poses in [_poses(scene.models[actor.model], actor)]
        for part in scene.models[actor.model].parts
        if part.layer not in HIDDEN and part.layer != "table" and len(part.triangles)
    ]
    share = MOST_TRIANGLES / max(1, sum(len(part.triangles) for _, part, _ in found))
    corners, colours, nearer = [np.zeros((0, 3, 3))], [np.zeros((0, 3))], [np.zeros(0)]
    for _, part, poses in found:
        least = LEAST_OF_OBJECT if part.layer == "object" else LEAST_TRIANGLES
        most = max(least, int(share * len(part.triangles)))
        vertices, triangles = _coarser(part, most)
        pose = poses[part.joint]
        placed = vertices @ pose.rotation.T + pose.translation
        some = placed[triangles]
        near = np.linalg.norm(some - scene.focus, axis=2).min(axis=1) < SEEN * scene.radius
        some = _divided(some[near], LONGEST_EDGE * scene.radius)
        corners.append(some)
        colours.append(np.broadcast_to(part.colour[:3], (len(some), 3)))
        nearer.append(np.full(len(some), PAD_NEARER if part.layer == "pads" else 0.0))
    return np.concatenate(corners), np.concatenate(colours), np.concatenate(nearer)


def _coarser(part: Part, most: int) -> tuple[FloatArray, IntArray]:
    """Vertices and triangles of a part, about as few as wanted: a triangle for half a cell."""
    if len(part.triangles) <= most:
        return part.vertices, part.triangles
    a, b, c = np.moveaxis(part.vertices[part.triangles], 1, 0)
    area = float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2
    cell = max(float(np.sqrt(2 * area / most)), 1e-6)
    return clustered(part.vertices, part.triangles, part.vertices.min(axis=0), cell)


def _poses(model: Model, actor: Actor) -> dict[int, SE3]:
    """World poses of a model's joints by number; -1 is its base."""
    poses = {-1: pose_from_wxyz(actor.pose[:3], actor.pose[3:])}
    for i, (joint, value) in enumerate(zip(model.joints, actor.q, strict=True)):
        placed = poses[joint.parent] * pose_from_wxyz(joint.placement[:3], joint.placement[3:])
        if joint.kind == "hinge":
            half = 0.5 * float(value)
            quaternion = np.array([np.cos(half), *(np.sin(half) * joint.axis)])
            poses[i] = placed * pose_from_wxyz(np.zeros(3), quaternion)
        else:
            poses[i] = placed * SE3(np.eye(3), float(value) * joint.axis)
    return poses


def _divided(corners: FloatArray, longest: float) -> FloatArray:
    """Triangles (k, 3, 3) with every one that has an edge above a length (m) cut into four."""
    done = []
    while len(corners):
        edges = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2).max(axis=1)
        done.append(corners[edges <= longest])
        a, b, c = np.moveaxis(corners[edges > longest], 1, 0)
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        four = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        corners = np.concatenate([np.stack(t, axis=1) for t in four])
    return np.concatenate(done) if done else corners


def _shaded(cross: FloatArray, colours: FloatArray) -> IntArray:
    """Red, green, blue (k, 3), 0 to 255, of triangles by their normals as the camera sees them."""
    length = np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-18)
    light = np.array(LIGHT_FROM) / np.linalg.norm(LIGHT_FROM)
    falls: FloatArray = np.clip(cross / length @ light, 0.0, 1.0)
    strength = LEAST_LIGHT + (1 - LEAST_LIGHT) * falls
    # few shades: as seen no coarser, and a smaller file
    lifted = DARKEST + (1 - DARKEST) * colours
    shades: FloatArray = np.clip(255 * lifted * np.round(strength, 2)[:, None], 0, 255)
    return shades.astype(np.int64)


def _floors(scene: Scene) -> list[FloatArray]:
    """Corners (4, 3), m, world, of the top of every table, as far as the scene reaches."""
    out = []
    for actor in scene.actors:
        for part in scene.models[actor.model].parts:
            if part.layer == "table":
                top = float(actor.pose[2] + part.vertices[:, 2].max())
                x, y = scene.focus[:2]
                wide = 1.2 * scene.radius
                square = [(-wide, -wide), (wide, -wide), (wide, wide), (-wide, wide)]
                out.append(np.array([(x + a, y + b, top) for a, b in square]))
    return out


def _marks(scene: Scene) -> FloatArray:
    """Contact points and where their normals come from, (n, 2, 3), m, world; empty without any."""
    if not scene.contacts:
        return np.zeros((0, 2, 3))
    contacts: Contacts = scene.contacts[0]
    points, normals = contacts.points[-1], contacts.normals[-1]
    for actor in scene.actors:
        if actor.name == contacts.actor:
            pose = pose_from_wxyz(actor.pose[:3], actor.pose[3:])
            points = points @ pose.rotation.T + pose.translation
            normals = normals @ pose.rotation.T
    touching = np.isfinite(points).all(axis=1)
    tails = points - NORMAL * scene.radius * normals
    marks: FloatArray = np.stack([points[touching], tails[touching]], axis=1)
    return marks
