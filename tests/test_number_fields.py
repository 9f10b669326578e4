"""Numbers that users give: every public dataclass refuses what cannot be, by its name and range.

``ALLOWED`` is the meaning: which values a field may have. A dataclass with a number that has a
default is given by users unless it stands in ``MADE``, so that a new one has to be put into either.
"""

from __future__ import annotations

import ast
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from udp_hand import LossyLink

from planner.certify import Neighbourhood
from planner.contacts import Contact, ContactSet
from planner.errors import ObjectError, PlannerError, TaskError
from planner.forces import ExpectedLoad
from planner.hands.hand import Hand
from planner.kinematics import HandState
from planner.motion.path import ObjectPath, check_place
from planner.objects import GraspObject, NeededWrench
from planner.quality import analyse, force_closure
from planner.shapes import SIZED_SHAPES, Box, Mesh
from planner.spatial import SE3, contact_frames
from planner.synthesis.options import SynthesisOptions
from planner.tools import load_tool
from sim.controllers.base import PadReading
from sim.controllers.impedance import ImpedanceGains
from sim.crosscheck.parts import Tolerances
from sim.datasets.episodes.episode import Asked
from sim.datasets.reset_states.starts import Draws, StatesAsked
from sim.handover import HandoverTimeline
from sim.learning.policy import PolicyFor
from sim.learning.training import Course
from sim.learning.trials import Conditions, TurnTask
from sim.manipulation.simulation import ManipulationOptions, Push
from sim.manipulation.timeline import ManipulationTimeline, SuccessCriteria
from sim.palm import PalmSettings
from sim.protocols.disturbance import Settings
from sim.protocols.shake_pushes import Push as PushOfProtocol
from sim.real_hand import CommandLimits, Safety
from sim.real_hand.safety import CommandLimiter
from sim.scan import Calibration, DepthCamera, DepthNoise
from sim.scene.build import Truth
from sim.scene.carrier import Timeline
from sim.scene.physics import PhysicsOptions
from sim.sensing.errors import ErrorModel
from sim.sensing.estimation.filter import ContactNoise
from sim.sensing.estimation.state import SensorErrors
from sim.tools.trial import UseTimeline
from sim.trial import TrialOptions
from sim.verdict import LossCriteria, Thresholds

ROOT = Path(__file__).resolve().parents[1]

POSITIVE, NOT_NEGATIVE, SIGNED, SHARE = "> 0", ">= 0", "any", "0 to 1"
POSITIVE_OR_INFINITE = "> 0, inf"

POLICY = PolicyFor(
    hand="h", joints=(), actuators=(), fingers=(), objects="box", angle_deg=90.0, error_model="lab"
)
ALLOWED: tuple[tuple[Any, dict[str, str]], ...] = (
    (Neighbourhood(), {"": NOT_NEGATIVE}),
    (
        Contact(position=np.zeros(3), frame=np.eye(3)),
        {
            "mu": NOT_NEGATIVE,
            "mu_torsion": NOT_NEGATIVE,
        },
    ),
    (ExpectedLoad(), {"": NOT_NEGATIVE}),
    (GraspObject(name="box", shape=Box(size=(0.05, 0.05, 0.05))), {"mass": POSITIVE}),
    (
        SynthesisOptions(),
        {
            **dict.fromkeys(("clear_object", "clear_tip", "clear_table", "clear_fingers"), SIGNED),
            "cone_share": POSITIVE,
            "rounds": NOT_NEGATIVE,
            "": NOT_NEGATIVE,
        },
    ),
    (
        ImpedanceGains(stiffness=1.0, damping=1.0, turning_stiffness=1.0, turning_damping=1.0),
        {"": NOT_NEGATIVE},
    ),
    (Tolerances(), {"": NOT_NEGATIVE}),
    (Asked(fps=30), {"fps": POSITIVE}),
    (SensorErrors(), {"": NOT_NEGATIVE}),
    (ContactNoise(), {"": POSITIVE}),
    (POLICY, {"angle_deg": SIGNED, "aim": NOT_NEGATIVE, "": POSITIVE}),
    (Course(), {"rounds": NOT_NEGATIVE, "share": SHARE, "noise": SHARE, "": POSITIVE}),
    (
        TurnTask(hand="allegro_hand", objects="cylinder:0.03x0.1"),
        {
            "angle": SIGNED,
            "seed": NOT_NEGATIVE,
        },
    ),
    (
        Conditions(
            mass=0.1, mu=0.5, shift=(0.0, 0.0), heading=0.0, push=(0.0, 0.0), push_after=0.0, seed=1
        ),
        {
            **dict.fromkeys(("shift", "heading", "push"), SIGNED),
            "mass": POSITIVE,
            "": NOT_NEGATIVE,
        },
    ),
    (Push(force=np.zeros(3), after=0.0, duration=0.1), {"force": SIGNED, "": NOT_NEGATIVE}),
    (NeededWrench(name="a", force=(0.0, 0.0, 1.0)), {"force": SIGNED, "torque": SIGNED}),
    (
        load_tool("key"),
        {"tip": SIGNED, "axis": SIGNED, "grip_force": POSITIVE, "scale": POSITIVE},
    ),
    (PushOfProtocol(begin=0.0, force=(0.0, 0.0, 1.0)), {"force": SIGNED, "begin": NOT_NEGATIVE}),
    (ManipulationTimeline(), {"": POSITIVE}),
    (SuccessCriteria(), {"": POSITIVE_OR_INFINITE, "fingers": POSITIVE}),
    (
        PhysicsOptions(),
        {
            **dict.fromkeys(("noslip_iterations", "mu", "mu_torsion", "mu_rolling"), NOT_NEGATIVE),
            "solref": POSITIVE,
            "solimp": POSITIVE,
            "": POSITIVE,
        },
    ),
    (
        PalmSettings(),
        {
            **dict.fromkeys(("mu", "weight_share", "running_share", "tip_cost"), NOT_NEGATIVE),
            **dict.fromkeys(("still_deg", "scatter_rad", "beyond", "beside_rad"), NOT_NEGATIVE),
            "": POSITIVE,
        },
    ),
    (Settings(), {"random": NOT_NEGATIVE, "": POSITIVE}),
    (TrialOptions(), {"record_every": POSITIVE}),
    (Safety(), {"joint_margin": NOT_NEGATIVE, "": POSITIVE}),
    (ErrorModel(), {"drift_time": POSITIVE, "seed": "", "": NOT_NEGATIVE}),
    (
        Draws(),
        {
            **dict.fromkeys(("squeeze", "friction", "mass"), POSITIVE),
            "gravity": SIGNED,
            "": NOT_NEGATIVE,
        },
    ),
    (
        StatesAsked(hand="allegro_hand", objects=("box",), n=1),
        {
            "n": POSITIVE,
            "scales": POSITIVE,
            "turn": SIGNED,
            "": NOT_NEGATIVE,
        },
    ),
    (CommandLimits(rate=1.0), {"rate": POSITIVE_OR_INFINITE}),
    (
        HandoverTimeline(),
        {"close_wait": NOT_NEGATIVE, "turn": SIGNED, "tilt": SIGNED, "": POSITIVE},
    ),
    (
        Truth(
            object=GraspObject(name="box", shape=Box(size=(0.05, 0.05, 0.05))),
            T_world_object=SE3.Identity(),
        ),
        {"table_height": SIGNED},
    ),
    (DepthCamera(), {"": POSITIVE}),
    (DepthNoise(), {"bleeding": SHARE, "specks": SHARE, "": NOT_NEGATIVE}),
    (Calibration(), {"": NOT_NEGATIVE}),
    (UseTimeline(), {"close_wait": NOT_NEGATIVE, "turn": SIGNED, "tilt": SIGNED, "": POSITIVE}),
    (Timeline(), {"close_wait": NOT_NEGATIVE, "turn": SIGNED, "tilt": SIGNED, "": POSITIVE}),
    (Thresholds(), {"": POSITIVE_OR_INFINITE}),
    (LossCriteria(), {"fewest": NOT_NEGATIVE, "": POSITIVE_OR_INFINITE}),
    *((k.from_sizes(k.default_sizes), {"": POSITIVE}) for k in SIZED_SHAPES.values()),
)
"""Valid dataclasses; field -> what it may be, "" for all fields of numbers that are not named."""

MADE = frozenset(
    [
        *(
            "Actor",
            "Part",
            "JointFacts",
            "Budget",
            "Actuation",
            "ActuatorDescription",
            "ArmDescription",
            "Attempt",
            "AuditRow",
        ),
        *(
            "Barrier",
            "Estimate",
            "Difference",
            "Drawn",
            "ExecutionOptions",
            "Failure",
            "Fallback",
        ),
        *(
            "Fault",
            "Filtered",
            "FingerDescription",
            "ForceStep",
            "ImportedGrasp",
            "GraspPoint",
        ),
        *(
            "GraspTask",
            "HandDescription",
            "HandReading",
            "Job",
            "ContactSample",
            "MovementPlan",
        ),
        *(
            "Channel",
            "Mending",
            "MeshSource",
            "Model",
            "MotionUnknowns",
            "Objective",
        ),
        *(
            "Opening",
            "Outcome",
            "Pad",
            "PadReading",
            "PlanOptions",
            "Reading",
            "Recording",
            "Region",
        ),
        *(
            "Row",
            "Rung",
            "Gantry",
            "Motion",
            "CloudPlan",
            "ObjectPath",
            "Runner",
            "Samples",
            "Scene",
            "SearchRecord",
            "SolidGeom",
            "StablePose",
        ),
        *(
            "StageResult",
            "Tally",
            "Trials",
            "Trials",
            "TaskOptions",
            "Term",
            "Tolerance",
            "TorqueCase",
        ),
        *(
            "TouchContext",
            "TrialReport",
            "TurnOptions",
            "Verdict",
            "ViewOptions",
            "SolveRecord",
        ),
    ]
)
"""Made by the toolkit, read by a schema or the command line, or checked by tests of their own."""

KINDS = ("float", "int", "tuple[float", "FloatArray")


def number_fields(owner: Any) -> dict[str, str]:
    return {f.name: str(f.type) for f in fields(owner) if str(f.type).startswith(KINDS)}


def hostile(meaning: str, kind: str) -> list[Any]:
    """What a field of a meaning must refuse; of a sequence one number is replaced."""
    single = [np.nan, -np.inf, 1j, "1", None, 10**400]
    if meaning != POSITIVE_OR_INFINITE:
        single.append(np.inf)
    if meaning != SIGNED:
        single.append(-1)
    if meaning.startswith("> 0"):
        single.append(0)
    if meaning == SHARE:
        single.append(1.5)
    if kind.startswith("int"):
        single.append(1.5)
    if kind.startswith(("float", "int")):
        single += [
            np.ma.masked_array(1.0, mask=True),
            True,
            [1.0, 1.0],
            np.ones(2),
            np.ones((1, 1)),
        ]
    return [v for v in single if v is not None or not kind.endswith("None")]


def named(owner: Any) -> str:
    return f"{type(owner).__module__}.{type(owner).__name__}"


@pytest.mark.parametrize(("owner", "ranges"), ALLOWED, ids=lambda x: type(x).__name__)
def test_a_number_that_cannot_be_is_refused_by_its_name(owner: Any, ranges: dict[str, str]) -> None:
    kinds = number_fields(owner) | ({"rate": "float | None"} if "rate" in ranges else {})
    assert set(ranges) - {""} <= set(kinds)
    for name, kind in kinds.items():
        meaning = ranges.get(name, ranges.get(""))
        for value in hostile(meaning, kind) if meaning else ():
            given = value
            if not kind.startswith(("float", "int")):
                first = getattr(owner, name) if getattr(owner, name) is not None else (1.0, 1.0)
                given = (value, *list(first)[1:])
            with pytest.raises(PlannerError, match=r"give|gives"):
                replace(owner, **{name: given})
                pytest.fail(f"{named(owner)}({name}={given!r}) is taken")


def test_every_dataclass_with_numbers_to_choose_is_in_the_table() -> None:
    """A field of numbers with a default is what a user may set."""
    known = {type(owner).__name__ for owner, _ in ALLOWED} | MADE
    for path in sorted(p for top in ("planner", "sim") for p in (ROOT / top).rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        for node in ast.parse(text).body if "@dataclass" in text else ():
            if not isinstance(node, ast.ClassDef) or node.name.startswith("_"):
                continue
            if not any("dataclass" in ast.unparse(d) for d in node.decorator_list):
                continue
            chosen = [
                a.target.id
                for a in node.body
                if isinstance(a, ast.AnnAssign) and isinstance(a.target, ast.Name) and a.value
                if ast.unparse(a.annotation).startswith(KINDS)
            ]
            assert not chosen or node.name in known, f"{path}: {node.name} has {chosen}"


def test_limits_of_a_real_hand_cannot_be_lost_to_a_period(allegro: Hand) -> None:
    periods: tuple[Any, ...] = (-1.0, 0.0, np.inf, np.nan, 1e-300, np.ones(2), "1")
    for period in periods:
        with pytest.raises(TaskError, match="the period is"):
            CommandLimiter(CommandLimits(), allegro.actuation, period, allegro.q_lower)
    for name in ("loss", "damage", "latency", "jitter"):
        for value in (-0.1, np.inf, np.nan, 1j):
            wrong: dict[str, Any] = {name: value}
            with pytest.raises(TaskError, match=f"{name} is"):
                LossyLink(**wrong)


def pads(**changed: Any) -> PadReading:
    whole = np.zeros((2, 3))
    given = dict(normal_force=np.zeros(2), force=whole, position=whole, normal=whole, sliding=whole)
    return PadReading(**(given | changed))


@pytest.mark.parametrize(
    "changed",
    [
        {"normal_force": -5.0},
        {"normal_force": np.array([1.0, -5.0])},
        {"force": -5},
        {"position": np.zeros((3, 3))},
        {"spin": np.zeros(3)},
    ],
)
def test_readings_of_pads_have_the_shapes_of_their_fingers(changed: dict[str, Any]) -> None:
    assert len(pads().normal_force) == 2
    with pytest.raises(PlannerError, match="give"):
        pads(**changed)


def test_wrong_shapes_and_sizes_at_other_doors_are_named(allegro: Hand) -> None:
    points = np.random.default_rng(0).normal(size=(3, 3))
    contacts = ContactSet.from_arrays(points, -points)
    state = HandState(allegro, np.zeros(allegro.nq))
    huge: Any = [[10**400, 0, 0]]
    masked: Any = np.ma.MaskedArray([0.5] * 3, mask=[True, False, False])
    wrongs: dict[str, Callable[[], object]] = {
        "axis is": lambda: ObjectPath(axis=(0, 0), angle=1.0, shift=np.zeros(3)),  # type: ignore[arg-type]
        "place has shape": lambda: check_place([]),
        "place is": lambda: check_place((0.0, 1e300)),
        "forces have shape": lambda: contacts.wrench_of(np.zeros(3)),
        "gravity_base has shape": lambda: state.gravity_torque(np.zeros(2)),
        "points is 'x'": lambda: state.point_jacobians([1], "x"),  # type: ignore[arg-type]
        "joint_ids are": lambda: state.point_jacobians(np.array([99]), np.zeros((1, 3))),
        "points have shape": lambda: state.point_jacobians(np.array(1.5), np.zeros((1, 3))),
        "1e154": lambda: contact_frames(points * 1e300),
        "normals are": lambda: contact_frames(huge),
        "radius is": lambda: SIZED_SHAPES["sphere"].from_sizes([10**400]),
        "mu is": lambda: contacts.with_friction(masked),
    }
    for message, wrong in wrongs.items():
        with pytest.raises(PlannerError, match=message):
            wrong()


def test_what_is_no_contact_set_is_told_where_its_contacts_are() -> None:
    class Plan:
        contacts = ()

    for ask in (analyse, force_closure):
        with pytest.raises(PlannerError, match=r"no ContactSet; give its .contacts"):
            ask(Plan())  # type: ignore[arg-type]
    few = ContactSet.from_arrays([[0.0, 0.0, 0.1]], [[0.0, 0.0, -1.0]])
    with pytest.raises(PlannerError, match="length is not given"):
        analyse(few)


CORNERS = 0.05 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


@pytest.mark.parametrize(
    "faces",
    [
        np.where(FACES == 3, -1, FACES),
        FACES + 0.7,
        np.where(FACES == 3, 9, FACES),
        [[0, 2, 1], [0, 1]],
        np.ma.masked_array(FACES, mask=FACES == 3),
        np.zeros((0, 3), dtype=int),
    ],
    ids=["negative", "fractional", "out of range", "ragged", "masked", "none"],
)
def test_a_mesh_refuses_faces_that_are_no_indices_of_its_vertices(faces: Any) -> None:
    assert Mesh(CORNERS, FACES).volume == pytest.approx(0.05**3 / 6)
    for make in (Mesh, Mesh.from_triangles):
        with pytest.raises(ObjectError, match="faces"):
            make(CORNERS, faces)


@pytest.mark.parametrize("given", [-1, "x", [], np.zeros(2)], ids=str)
@pytest.mark.parametrize(
    ("options", "name"),
    [
        (TrialOptions, "timeline"),
        (TrialOptions, "thresholds"),
        (ManipulationOptions, "timeline"),
        (ManipulationOptions, "criteria"),
        (ManipulationOptions, "push"),
        (ManipulationOptions, "true_task"),
        (Safety, "stop"),
    ],
)
def test_options_of_a_class_refuse_what_is_none_of_it(
    options: Any, name: str, given: object
) -> None:
    """An empty list was taken for the defaults, and a number was an AttributeError."""
    with pytest.raises(TaskError, match=f"^{name} is .*; give a"):
        options(**{name: given})
