"""Where the camera stands when a page opens: beside the palm, and where the hand hides little."""

from __future__ import annotations

import numpy as np

from planner.contacts import ContactSet
from planner.kinematics.state import HandState
from planner.pages.scene import Model, View
from planner.spatial import SE3, FloatArray

__all__ = ["hand_points", "views_of"]

POINTS = 2000
"""Points of a hand, about 7 mm apart."""

NEAR = 0.008
"""Distance (m) from a line of sight within which a point of the hand hides what is behind."""

IN_FRONT = 0.01
"""How much nearer to the camera (m) it is then at least: a tip does not hide its own contact."""

AZIMUTHS = np.deg2rad(np.arange(-180, 180, 15))
HEIGHTS = (0.25, 0.45, 0.8)
USUAL_HEIGHT = 0.45
"""Places that are compared: angles (rad) about the vertical, heights over the distance (-)."""

USUAL = np.array([0.5, -0.75, 0.0])
"""From the right and the front, where the rest leaves a choice."""


def hand_points(model: Model, T_world_base: SE3, state: HandState) -> FloatArray:
    """Points (n, 3), m, world, spread by area over what is drawn of a hand."""
    rng = np.random.default_rng(0)
    corners = []
    for part in model.parts:
        if part.layer != "hand":
            continue
        pose = T_world_base if part.joint < 0 else T_world_base * state.joint_pose(part.joint + 1)
        vertices = np.asarray(part.vertices) @ pose.rotation.T + pose.translation
        corners.append(vertices[part.triangles])
    triangles = np.concatenate(corners)  # (k, 3, 3)
    sides = triangles[:, 1:] - triangles[:, :1]
    ends = np.cumsum(np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1))
    chosen = np.searchsorted(ends, (np.arange(POINTS) + 0.5) / POINTS * ends[-1])
    weights = rng.dirichlet(np.ones(3), size=POINTS)
    points: FloatArray = np.einsum("nk,nkd->nd", weights, triangles[chosen])
    return points


def views_of(
    facing: FloatArray, contacts: ContactSet | None, hiding: FloatArray, seen: FloatArray
) -> tuple[View, ...]:
    """The opening view, named "start", and "palm".

    The opening one looks neither along the palm's normal nor along the grip, and as little of the
    object as possible is behind the hand.

    Args:
        facing: Direction that the palm faces (3,), unit, world.
        contacts: World; None where nothing is held.
        hiding: Points of the hand (n, 3), m, world.
        seen: Points of the object (m, 3), m, world.
    """
    grip = np.zeros(3)
    if contacts is not None and len(contacts):
        grip = np.linalg.eigh(contacts.normals.T @ contacts.normals)[1][:, -1]
    azimuth, height = (v.ravel() for v in np.meshgrid(AZIMUTHS, HEIGHTS))
    directions = np.column_stack([np.cos(azimuth), np.sin(azimuth), height])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    costs = np.abs(directions @ facing) + 0.6 * np.abs(directions @ grip)
    costs += np.abs(height - USUAL_HEIGHT) - 0.1 * directions @ USUAL
    best, least = 0, np.inf
    for k in np.argsort(costs):
        if costs[k] >= least:
            break  # what the hand hides only adds to it
        cost = costs[k] + 2.0 * _hidden(directions[k], hiding, seen)
        if cost < least:
            best, least = k, cost
    return _view("start", directions[best]), _view("palm", facing)


def _hidden(direction: FloatArray, hiding: FloatArray, seen: FloatArray) -> float:
    """Share of points (m, 3) that are behind others (n, 3) for a camera in a direction."""
    across = np.linalg.svd(direction[None])[2][1:].T  # (3, 2): the plane of the picture
    u, v = ((seen @ a)[:, None] - hiding @ a for a in across.T)
    nearer = hiding @ direction - (seen @ direction)[:, None] > IN_FRONT
    return float(((u * u + v * v < NEAR**2) & nearer).any(axis=1).mean())


def _view(name: str, direction: FloatArray) -> View:
    x, y, z = (float(v) for v in direction)
    return View(name=name, direction=(x, y, z))
