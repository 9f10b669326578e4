"""``hand_model``: a hand as joints and meshes for a page, from its compiled models."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import pinocchio as pin
import trimesh

from planner.bridge import LinkSurface, link_surfaces
from planner.hands.fingers import Pad
from planner.hands.hand import Hand
from planner.pages.scene import Joint, Layer, Model, Part, pose_row
from planner.shapes.meshes.triangles import simplified
from planner.spatial import FloatArray

__all__ = ["hand_model"]

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
