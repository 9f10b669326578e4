"""``mesh_page``: an object with its stable poses, its smooth field, and where it may be touched.

``zero_level_set`` gives the zero level of a smooth distance field as triangles (surface nets,
Gibson 1998): one vertex per grid cell that the surface passes, at the mean of its crossings of the
cell's edges; one quadrilateral per edge that it crosses, between the four cells around. Newton
steps along the gradient then put the vertices onto the zero level. By hand, since no dependency of
the toolkit extracts level sets; a page needs no more than this.
"""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from typing import Any

import numpy as np
import trimesh

from planner.objects import GraspObject, TouchRegion
from planner.pages.blocks import Block, Facts, Sentence
from planner.pages.page import Page, own_scripts, without_folder
from planner.pages.plan_scene import object_model, table_model
from planner.pages.scene import IDENTITY_ROW, Actor, Model, Part, Scene, pose_row
from planner.shapes import Mesh
from planner.shapes.distance_field import DistanceField
from planner.shapes.hulls import StablePose
from planner.shapes.mesh import surface_triangles
from planner.shapes.meshes.triangles import simplified
from planner.spatial import FloatArray, IntArray

HAND = "allegro_hand"
"""Hand of the command that the page shows."""

FIELD_COLOUR = (0.85, 0.35, 0.75, 0.45)
TOUCH_COLOUR, AVOID_COLOUR = (0.20, 0.65, 0.35, 1.0), (0.82, 0.22, 0.20, 1.0)
"""Colours: the field's zero level, where fingers may touch, where they must not."""

MOST_FIELD_TRIANGLES, MOST_REGION_TRIANGLES = 30_000, 40_000
"""In a page of about 1 MB."""

FINEST_EDGE = 1 / 60
"""Edge of the triangles that are coloured by region, over the object's size (-)."""

PROUD = 2e-3
"""How far regions are drawn above the surface, over the bounding radius (-)."""


def mesh_page(
    item: GraspObject, *, spec: str = "", touch: Sequence[str] = (), avoid: Sequence[str] = ()
) -> Page:
    """A page of an object on a table.

    Args:
        item: The object, with its regions.
        spec: How the command line names it, for the command that the page shows.
        touch: The regions where fingers may touch, as the command line has them.
        avoid: Those where they must not.
    """
    shape, poses = item.shape, item.shape.resting_poses()
    shown = object_model(shape, item.name)
    parts, notes = list(shown.model.parts), [shown.note] if shown.note else []
    if isinstance(shape, Mesh):
        parts.append(_field_part(shape))
    if item.touch is not None:
        parts += _region_parts(item)
    rows = [pose_row(item.resting_pose(index=k)) for k in range(len(poses))]
    radius = shape.bounding_radius
    scene = Scene(
        models={
            "object": Model(joints=(), parts=tuple(parts)),
            "table": table_model(3 * radius),
        },
        actors=(
            Actor(name="object", model="object", pose=rows[0]),
            Actor(name="table", model="table", pose=IDENTITY_ROW, layer="table"),
        ),
        focus=rows[0][:3],
        radius=1.2 * radius,
        off=frozenset({"collision", "field", "frames", "alternatives"}),
    )
    stable = [_pose_data(p, row) for p, row in zip(poses, rows, strict=True)]
    options = [word for text in touch for word in ("--touch", text)]
    options += [word for text in avoid for word in ("--avoid", text)]
    return Page(
        title=item.name,
        subtitle=without_folder(spec),
        summary=tuple(_summary(item, notes)),
        scene=scene,
        data={
            "name": item.name,
            "mass_kg": item.mass,
            "volume_m3": shape.volume,
            "stable_poses": stable,
        },
        kind="object",
        scripts=own_scripts("side.js", "object.js", "object_start.js"),
        extra={
            "object": {
                "poses": stable,
                "command": shlex.join(["opposable", "plan", HAND, spec or item.name, *options]),
            }
        },
    )


def _pose_data(pose: StablePose, row: FloatArray) -> dict[str, Any]:
    return {
        "pose": row.tolist(),
        "margin_deg": pose.margin_deg,
        "probability": pose.probability,
    }


def _summary(item: GraspObject, notes: Sequence[str]) -> list[Block]:
    shape = item.shape
    rows = [
        ("size along x, y, z", " x ".join(f"{v:.0f}" for v in _extents(item)) + " mm"),
        ("mass", f"{1e3 * item.mass:.0f} g"),
        ("volume", f"{1e6 * shape.volume:.1f} cm3"),
        ("bounding radius", f"{1e3 * shape.bounding_radius:.1f} mm about the centre of mass"),
    ]
    blocks: list[Block] = []
    if isinstance(shape, Mesh):
        field = shape.field(fine=True)
        off = float(np.abs(field.value(shape.vertices)).max())
        rows += [
            ("triangles", str(len(shape.faces))),
            ("smooth field: grid", f"{1e3 * field.spacing:.2f} mm"),
            ("smooth field: largest value at a vertex", f"{1e3 * off:.2f} mm"),
            ("smooth field: proven bound", f"{1e3 * field.error:.2f} mm within the bounding box"),
        ]
        if shape.mended:
            blocks.append(Sentence(text=f"Mended: {shape.mended}.", kind="warning"))
    blocks.insert(0, Facts(rows=tuple(rows)))
    blocks += [Sentence(text=note, kind="warning") for note in notes]
    if item.touch is not None:
        blocks.append(Sentence(text=_regions_in_words(item, item.touch)))
    return blocks


def _extents(item: GraspObject) -> FloatArray:
    axes = np.eye(3)
    extents: FloatArray = 1e3 * np.array(
        [item.shape.support(axis) + item.shape.support(-axis) for axis in axes]
    )
    return extents


def _regions_in_words(item: GraspObject, touch: TouchRegion) -> str:
    vertices, triangles = surface_triangles(item.shape)
    vertices, triangles = _fine(vertices, triangles)
    corners = vertices[triangles]
    areas = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    free = touch.permits(corners.mean(axis=1))
    return (
        f"Fingers may touch {100 * areas[free].sum() / areas.sum():.0f} % of the surface (green) "
        "and not the rest (red)."
    )


def _field_part(shape: Mesh) -> Part:
    lower, upper = shape.bounds
    vertices, triangles = zero_level_set(shape.field(fine=True), lower, upper)
    vertices, triangles, _ = simplified(vertices, triangles, MOST_FIELD_TRIANGLES)
    return Part(
        name="zero level of the smooth field",
        layer="field",
        vertices=vertices,
        triangles=triangles,
        colour=FIELD_COLOUR,
    )


def _region_parts(item: GraspObject) -> list[Part]:
    """The surface where it may be touched, and where it must not."""
    assert item.touch is not None
    vertices, triangles = _fine(*surface_triangles(item.shape))
    free = item.touch.permits(vertices[triangles].mean(axis=1))
    solid = trimesh.Trimesh(vertices, triangles, process=False)
    vertices = vertices + PROUD * item.shape.bounding_radius * np.asarray(solid.vertex_normals)
    out = []
    for name, chosen, colour in (
        ("fingers may touch here", free, TOUCH_COLOUR),
        ("fingers must not touch here", ~free, AVOID_COLOUR),
    ):
        if chosen.any():
            used, faces = np.unique(triangles[chosen], return_inverse=True)
            out.append(
                Part(
                    name=name,
                    layer="regions",
                    vertices=vertices[used],
                    triangles=faces.reshape(-1, 3).astype(np.int64),
                    colour=colour,
                )
            )
    return out


def _fine(vertices: FloatArray, triangles: IntArray) -> tuple[FloatArray, IntArray]:
    """Triangles small enough that a region's border looks straight, as far as the page allows."""
    vertices, triangles, _ = simplified(vertices, triangles, MOST_REGION_TRIANGLES)
    edge = float(np.ptp(vertices, axis=0).max()) * FINEST_EDGE
    while True:
        v, f = trimesh.remesh.subdivide_to_size(vertices, triangles, edge)
        if len(f) <= 2 * MOST_REGION_TRIANGLES:
            return np.asarray(v, np.float64), np.asarray(f, np.int64)
        edge *= 1.5


MOST_CELLS = 72
"""Cells along the longest side: the grid is as fine as the field's own where that has no more."""

MARGIN = 2
"""Cells beyond the solid's bounding box."""

NEWTON_STEPS = 3
"""From within a cell to the level: to some micrometres where the field is smooth."""


def zero_level_set(
    field: DistanceField, lower: FloatArray, upper: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Vertices (n, 3), m, and triangles (k, 3), counter-clockwise from outside.

    Args:
        field: Negative inside.
        lower: Lower corner (3,) of the box in which to look, m.
        upper: Its upper corner (3,).
    """
    spacing = max(field.spacing, float((upper - lower).max()) / MOST_CELLS)
    first = lower - MARGIN * spacing
    shape = np.ceil((upper - lower) / spacing).astype(int) + 2 * MARGIN + 1
    nodes = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1)
    values = field.value(first + spacing * nodes.reshape(-1, 3)).reshape(shape)
    vertices, triangles = _nets(values)
    return _onto_level(field, first + spacing * vertices, spacing), triangles


def _nets(values: FloatArray) -> tuple[FloatArray, IntArray]:
    """Surface net of values at the nodes of a grid; vertices in units of the grid."""
    inside = values < 0.0
    cells = np.array(values.shape) - 1
    total, count = np.zeros((*cells, 3)), np.zeros(cells, dtype=int)
    crossings = []
    for axis in range(3):
        low = np.arange(cells[axis])
        a, b = (values.take(low + end, axis=axis) for end in (0, 1))
        crossed = (a < 0.0) != (b < 0.0)
        at = np.argwhere(crossed)
        share = (a[crossed] / (a[crossed] - b[crossed]))[:, None]
        points = at + share * np.eye(3)[axis]
        crossings.append((axis, at))
        for around in _around(axis):  # the four cells that share the edge
            cell = at - around
            there = ((cell >= 0) & (cell < cells)).all(axis=1)
            np.add.at(total, tuple(cell[there].T), points[there])
            np.add.at(count, tuple(cell[there].T), 1)
    passed = count > 0
    number = np.full(cells, -1)
    number[passed] = np.arange(passed.sum())
    vertices = total[passed] / count[passed][:, None]
    quads = []
    for axis, at in crossings:
        four = np.stack([at - around for around in _around(axis)], axis=1)  # (m, 4, 3)
        there = ((four >= 0) & (four < cells)).all(axis=(1, 2))
        corners = number[tuple(np.moveaxis(four[there], 2, 0))]
        outwards = inside[tuple(at[there].T)]
        corners[~outwards] = corners[~outwards][:, ::-1]
        quads.append(corners)
    q = np.concatenate(quads)
    triangles: IntArray = np.concatenate([q[:, [0, 1, 2]], q[:, [0, 2, 3]]]).astype(np.int64)
    return vertices, triangles


def _around(axis: int) -> IntArray:
    """Offsets (4, 3) of the cells around an edge, counter-clockwise seen from its end."""
    u, v = np.eye(3, dtype=np.int64)[(axis + 1) % 3], np.eye(3, dtype=np.int64)[(axis + 2) % 3]
    return np.array([u + v, v, 0 * u, u])


def _onto_level(field: DistanceField, points: FloatArray, spacing: float) -> FloatArray:
    """Points moved along the gradient to where the field is zero; never farther than a cell."""
    start = points
    for _ in range(NEWTON_STEPS):
        rows = field.taylor(points, 1)
        gradient = rows[:, 1:4]
        squared = np.maximum(np.einsum("nd,nd->n", gradient, gradient), 0.01)
        points = points - (rows[:, 0] / squared)[:, None] * gradient
    moved = np.linalg.norm(points - start, axis=1) <= spacing
    kept: FloatArray = np.where(moved[:, None], points, start)
    return kept
