"""``with_alternatives``: other grasps of the same task as ghosts beside the one of a page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from planner.pages.own_assets import own_scripts
from planner.pages.page import Page
from planner.pages.rows import pose_row
from planner.pages.scene import Actor, Model
from planner.plan import GraspPlan
from planner.shapes.meshes.simplify import simplified

__all__ = ["with_alternatives"]

OPACITY, COLOUR = 0.17, (0.45, 0.60, 0.80, 1.0)
"""Of a ghost: alike for all its parts, whose own colours would hide the hand of the plan."""

MOST_TRIANGLES = 300
"""Of each part of a ghost."""


def with_alternatives(page: Page, plans: Sequence[GraspPlan], failed: Sequence[str] = ()) -> Page:
    """A plan's page with other plans of its task: hands at their grasps, and a list of them.

    Args:
        page: The page of a plan.
        plans: The others.
        failed: A sentence for each seed that gave none.
    """
    assert page.scene is not None
    actors = [
        Actor(
            name=f"seed {plan.record.seed}",
            model=GHOST,
            pose=pose_row(plan.T_world_base),
            q=plan.q,
            layer="alternatives",
            opacity=OPACITY,
        )
        for plan in plans
    ]
    ghost = _ghost(page.scene.models["hand"])
    scene = replace(
        page.scene,
        models={**page.scene.models, GHOST: ghost},
        actors=(*page.scene.actors, *actors),
        off=page.scene.off - {"alternatives"},
    )
    listed = [
        {
            "actor": actor.name,
            "epsilon": plan.quality.epsilon,
            "min_weight": plan.quality.closure.normalised_min_weight,
            "strongest_N": float(plan.contacts.forces[:, 0].max()),
            "fingers": list(plan.task.finger_names),
        }
        for actor, plan in zip(actors, plans, strict=True)
    ]
    return replace(
        page,
        scene=scene,
        scripts=(*page.scripts, *own_scripts("side.js", "alternatives.js")),
        extra={**page.extra, "alternatives": {"plans": listed, "failed": list(failed)}},
    )


GHOST = "ghost of the hand"


def _ghost(hand: Model) -> Model:
    """A hand in one colour, without pads, and with fewer triangles."""
    parts = []
    for part in hand.parts:
        if part.layer == "hand":
            vertices, triangles, _ = simplified(part.vertices, part.triangles, MOST_TRIANGLES)
            parts.append(replace(part, vertices=vertices, triangles=triangles, colour=COLOUR))
    return Model(joints=hand.joints, parts=tuple(parts))
