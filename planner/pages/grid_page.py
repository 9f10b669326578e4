"""``grid_html``, ``grid_script``, ``grid_models``: a grid of grasps that a server brings.

Unlike a ``Page`` it is not one file: it asks its own server for columns, places of hands and pages
of single grasps. Pictures are drawn in the browser.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from html import escape

from planner.hands.hand import Hand
from planner.pages.hand_model import hand_model
from planner.pages.page import asset, pack, three_source
from planner.pages.plan_scene import object_model
from planner.pages.scene import Model, pose_row
from planner.shapes.meshes.triangles import simplified
from planner.task import GraspTask

__all__ = ["grid_html", "grid_models", "grid_script"]

SCRIPTS = ("unpack.js", "bodies.js", "side.js", "thumbnails.js", "grid.js", "grid_main.js")
"""In the order in which they run, after three.js."""

MOST_TRIANGLES = 12_000
"""Of a hand or an object in a picture of 176 pixels."""

DRAWN = ("hand", "pads", "object")
"""Layers in a picture."""


def grid_html(title: str, subtitle: str) -> str:
    """The page of a grid."""
    style = "\n".join(asset(name) for name in ("page.css", "side.css", "grid.css"))
    return asset("grid.html").format(title=escape(title), subtitle=escape(subtitle), style=style)


def grid_script() -> str:
    """Its script, three.js included.

    Raises:
        PlannerError: trimesh carries another three.js.
    """
    return "\n".join((three_source(), *(asset(name) for name in SCRIPTS)))


def grid_models(hand: Hand, tasks: Mapping[str, GraspTask]) -> bytes:
    """The hand and the objects that its pictures are made of, packed.

    Args:
        hand: The hand of all grasps.
        tasks: Label of an object -> its task, in whose pose it is shown.
    """
    return pack(
        {
            "hand": _light(hand_model(hand)),
            "objects": {
                label: {
                    "model": _light(object_model(task.object.shape, label).model),
                    "pose": pose_row(task.T_world_object),
                }
                for label, task in tasks.items()
            },
        }
    )


def _light(model: Model) -> Model:
    """A model with what a small picture shows, and with few triangles."""
    drawn = [part for part in model.parts if part.layer in DRAWN]
    share = MOST_TRIANGLES / max(1, sum(len(part.triangles) for part in drawn))
    parts = []
    for part in drawn:
        most = max(LEAST_TRIANGLES, int(share * len(part.triangles)))
        vertices, triangles, _ = simplified(part.vertices, part.triangles, most)
        parts.append(replace(part, vertices=vertices, triangles=triangles))
    return Model(joints=model.joints, parts=tuple(parts))


LEAST_TRIANGLES = 60
"""That every part may keep."""
