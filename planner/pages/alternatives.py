"""``with_alternatives``: other grasps of the same task as ghosts beside the one of a page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from planner.pages.own_assets import own_scripts
from planner.pages.page import Page
from planner.pages.rows import pose_row
from planner.pages.scene import Actor
from planner.plan import GraspPlan

__all__ = ["with_alternatives"]

OPACITY = 0.22
"""Of a ghost (-)."""


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
            model="hand",
            pose=pose_row(plan.T_world_base),
            q=plan.q,
            layer="alternatives",
            opacity=OPACITY,
        )
        for plan in plans
    ]
    scene = replace(
        page.scene,
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
