"""What is viewed of a file of ours: a plan, a motion, a report, or a page as it is."""

from __future__ import annotations

from importlib import import_module

from planner.errors import NoGraspFoundError
from planner.files import plan_from_dict
from planner.files.disk import HANDOVER_FORMAT, MOVEMENT_FORMATS
from planner.files.movements import movement_from_dict
from planner.pages.motion_page import motion_page
from planner.pages.page import Page
from planner.pages.plan_page import plan_page, with_alternatives
from planner.plan import GraspPlan
from planner.search.grasp import plan_grasp
from planner.showing import page_of
from planner.synthesis.options import SynthesisOptions
from sim.show.browser import WrittenPage
from sim.show.targets import Kind, Target, ViewOptions

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


def _plan(target: Target, options: ViewOptions) -> Page:
    assert target.data is not None
    return page_of_plan(plan_from_dict(target.data, str(target.path)), options)


PLAN = Kind(
    name="a grasp plan",
    recognises=lambda target: target.format == FORMAT,
    shown=_plan,
    takes=frozenset({"alternatives"}),
)
"""See ``sim.show.targets``."""


def _handover(target: Target, options: ViewOptions) -> Page:
    from planner.files.handovers import handover_from_dict  # here: most files are none

    assert target.data is not None
    return plan_page(handover_from_dict(target.data, str(target.path)).both)


HANDOVER = Kind(
    name="a plan of a handover: the moment in which both hands hold",
    recognises=lambda target: target.format == HANDOVER_FORMAT,
    shown=_handover,
)
"""See ``sim.show.targets``."""


def _motion(target: Target, options: ViewOptions) -> Page:
    assert target.data is not None
    return motion_page(movement_from_dict(target.data, str(target.path)))


MOTION = Kind(
    name="a plan of a movement in the hand",
    recognises=lambda target: target.format in MOVEMENT_FORMATS,
    shown=_motion,
)
"""See ``sim.show.targets``."""


REPORT_READERS: dict[str, str] = {
    "opposable-report": "sim.report_file:read_report",
    "opposable-manipulation-report": "sim.manipulation:read_manipulation_report",
}
"""Format of a report -> "module:function" of what reads it, loaded at first use; its page is that
which is registered for what it returns (``planner.showing.register_page``)."""

REPORTS = ("report.json", "report.html")
"""Names of a report in the folder of a run."""


def _report(target: Target) -> Target:
    """The report of a folder; the target itself if it is a file."""
    names = (name for name in REPORTS if target.holds(name))
    name = next(names, None)
    return target if name is None else Target(f"{target.path}/{name}")


def _report_page(target: Target, options: ViewOptions) -> Page:
    report = _report(target)
    assert report.path is not None
    module, _, reader = REPORT_READERS[report.format].partition(":")
    page: Page = page_of(getattr(import_module(module), reader)(report.path))
    return page


REPORT = Kind(
    name="a report of a trial or manipulation (JSON, HTML, or the folder of the run)",
    recognises=lambda target: _report(target).format in REPORT_READERS,
    shown=_report_page,
)
"""See ``sim.show.targets``."""


def _page(target: Target, options: ViewOptions) -> WrittenPage:
    assert target.path is not None
    return WrittenPage(path=target.path, html=target.content)


PAGE = Kind(
    name="a page that Opposable wrote (HTML)",
    recognises=lambda target: target.is_html and target.data is not None,
    shown=_page,
)
"""See ``sim.show.targets``; asked last: plans and reports are made anew from their pages."""
