"""What can be viewed: hands and objects by name or model, and files of ours.

See ``sim.show.targets``, which asks each kind of ``OURS`` in turn.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from importlib import import_module
from typing import Any, TypeVar

from planner.describe import check_hand, propose
from planner.errors import NoGraspFoundError, ObjectError
from planner.files import plan_from_dict
from planner.files.disk import MOVEMENT_FORMATS
from planner.files.movements import movement_from_dict
from planner.hand_loading import load_hand
from planner.hands.catalog import MODEL_SUFFIXES, find_hand, foreign_hand_names, hand_names
from planner.objects import TouchRegion, object_names, parse_object, parse_region
from planner.pages.hand_page import comments_of, hand_page, reasons_by_key
from planner.pages.mesh_page import mesh_page
from planner.pages.motion_page import motion_page
from planner.pages.page import Page
from planner.pages.plan_page import plan_page, with_alternatives
from planner.plan import GraspPlan
from planner.search.grasp import plan_grasp
from planner.shapes.meshes.io import CONVERTIBLE, MESH_SUFFIXES
from planner.showing import page_of
from planner.synthesis.options import SynthesisOptions
from sim.show.browser import WrittenPage
from sim.show.dataset import DATASET
from sim.show.targets import Kind, Target, ViewOptions

Plan = TypeVar("Plan")

SCHEMES = ("menagerie:", "robot_descriptions:", "package:")
"""Beginnings of names of models in packages."""

DESCRIPTION_FILE = "hand.toml"

ROOTS = (b"<mujoco", b"<robot")
"""Root elements of models, MJCF and URDF."""


def _is_hand(target: Target) -> bool:
    if target.text in (*hand_names(), *foreign_hand_names()):
        return True
    if target.path is None:
        return target.text.startswith(SCHEMES)
    if target.is_folder:
        return target.holds(DESCRIPTION_FILE)
    if target.names_body:
        return False
    return any(root in target.head for root in ROOTS) or "schema" in (target.table or {})


def _hand_page(target: Target, options: ViewOptions) -> Page:
    hand, path = load_hand(target.text), find_hand(target.text)
    if path.suffix.lower() in MODEL_SUFFIXES:
        proposal = propose(target.text)
        reasons, questions = reasons_by_key(proposal.reasons), proposal.open_questions
    else:
        reasons, questions = comments_of(path), ()
    return hand_page(hand, reasons=reasons, questions=questions, check=check_hand(hand))


HAND = Kind(name="a hand (name, hand.toml, MJCF or URDF)", recognises=_is_hand, shown=_hand_page)


def _is_mesh(target: Target) -> bool:
    if target.path is None:
        return target.text.lower().partition(":")[0].strip() in object_names()
    if target.names_body:
        return True
    return target.is_file and (_format(target) != "" or _suffix(target) in CONVERTIBLE)


def _suffix(target: Target) -> str:
    return "" if target.path is None else target.path.suffix.lower()


def _format(target: Target) -> str:
    """The suffix that the content of a mesh file asks for; "" for a file of something else."""
    head = target.head
    if head.startswith((b"ply\n", b"ply\r")):
        return ".ply"
    if head.startswith(b"glTF"):
        return ".glb"
    if head.lstrip().startswith(b"solid") and b"facet" in head:
        return ".stl"
    if len(head) >= BINARY_STL and target.path is not None:
        (triangles,) = struct.unpack_from("<I", head, BINARY_STL - 4)
        if target.path.stat().st_size == BINARY_STL + 50 * triangles:
            return ".stl"
    whole = head[: head.rfind(b"\n")]  # the last line may be cut
    starts = {line.split(maxsplit=1)[0] for line in whole.splitlines() if line.strip()}
    if b"v" in starts and all(word in OBJ_WORDS or word.startswith(b"#") for word in starts):
        return ".obj"
    return _suffix(target) if _suffix(target) in MESH_SUFFIXES else ""


BINARY_STL = 84
"""Bytes before the triangles of a binary STL file, the count of triangles at their end."""

OBJ_WORDS = frozenset(
    (b"v", b"vn", b"vt", b"vp", b"f", b"l", b"p", b"o", b"g", b"s", b"usemtl", b"mtllib")
)
"""Words with which lines of an OBJ file begin."""


def _mesh_page(target: Target, options: ViewOptions) -> Page:
    wanted = _format(target) if target.is_file and not target.names_body else ""
    if wanted and _suffix(target) != wanted and _suffix(target) not in CONVERTIBLE:
        raise ObjectError(
            f"{target.path} holds a mesh of the format {wanted} and is named otherwise; rename it "
            f"to end in {wanted}"
        )
    touch = None
    if options.touch or options.avoid:
        touch = TouchRegion(
            allowed=tuple(parse_region(text) for text in options.touch),
            forbidden=tuple(parse_region(text) for text in options.avoid),
        )
    item = parse_object(target.text, repair=options.repair, strict=options.strict, touch=touch)
    return mesh_page(item, spec=target.text, touch=options.touch, avoid=options.avoid)


MESH = Kind(
    name="an object or mesh (mug, box:0.05x0.05x0.08, part.stl*0.001, scene.xml#body)",
    recognises=_is_mesh,
    shown=_mesh_page,
    takes=frozenset({"touch", "avoid", "repair", "strict"}),
)

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


def _read(target: Target, read: Callable[[dict[str, Any], str], Plan]) -> Plan:
    """The plan in a file."""
    assert target.data is not None
    return read(target.data, str(target.path))


PLAN = Kind(
    name="a grasp plan",
    recognises=lambda target: target.format == "opposable-plan",
    shown=lambda target, options: page_of_plan(_read(target, plan_from_dict), options),
    takes=frozenset({"alternatives"}),
)

MOTION = Kind(
    name="a plan of a movement: in the hand, of a tool, or from hand to hand",
    recognises=lambda target: target.format in MOVEMENT_FORMATS,
    shown=lambda target, _: motion_page(_read(target, movement_from_dict)),
)

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


def _page(target: Target, options: ViewOptions) -> WrittenPage:
    assert target.path is not None
    return WrittenPage(path=target.path, html=target.content)


PAGE = Kind(
    name="a page that Opposable wrote (HTML)",
    recognises=lambda target: target.is_html and target.data is not None,
    shown=_page,
)

OURS = (HAND, MESH, PLAN, MOTION, REPORT, DATASET, PAGE)
"""In the order in which they are asked and listed; pages last: plans and reports are made anew from
theirs."""
