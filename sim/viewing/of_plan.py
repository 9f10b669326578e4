"""A grasp plan, with other grasps of its task if they are asked for."""

from __future__ import annotations

from planner.errors import NoGraspFoundError
from planner.files import plan_from_dict
from planner.pages.alternatives import with_alternatives
from planner.pages.page import Page
from planner.pages.plan_page import plan_page
from planner.plan import GraspPlan
from planner.search import plan_grasp
from planner.synthesis.options import SynthesisOptions
from sim.viewing.kinds import Kind, ViewOptions
from sim.viewing.target import Target

FORMAT = "opposable-plan"

ATTEMPTS = 50
"""Attempts for each other grasp: the search makes as many as it takes, and this many at most."""


def page_of_plan(plan: GraspPlan, options: ViewOptions) -> Page:
    """The page of a plan with the alternatives that are asked for."""
    page = plan_page(plan)
    if not options.alternatives:
        return page
    objective = plan.record.objective
    # the wrenches of a task objective are not part of a plan
    wanted = SynthesisOptions() if "task" in objective else SynthesisOptions(objective=objective)
    plans, failed = [], []
    for k in range(options.alternatives):
        seed = plan.record.seed + 1 + k
        try:
            plans.append(plan_grasp(plan.task, seed=seed, max_attempts=ATTEMPTS, options=wanted))
        except NoGraspFoundError as error:
            failed.append(f"Seed {seed} gave none: {error}")
    return with_alternatives(page, plans, failed)


def _shown(target: Target, options: ViewOptions) -> Page:
    assert target.data is not None
    return page_of_plan(plan_from_dict(target.data, str(target.path)), options)


KIND = Kind(
    name="a grasp plan",
    recognises=lambda target: target.format == FORMAT,
    shown=_shown,
    takes=frozenset({"alternatives"}),
)
"""See ``sim.viewing.kinds``."""
