"""``SynthesisOptions``: terms, margins, weights and objectives of grasp synthesis.

``with_room`` adds room for joints that are not where their encoders say, and above the table beside
low parts. The searches for grasps and motions call it where a task's ``joint_error`` is above 0:
they solve with the room first; where that fails they go on from there without it, so that a plan
has room where there is some and is found where there is none.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from planner.arrays import check_fields
from planner.errors import NotFoundError, TaskError, shown
from planner.kinematics import tip_reach
from planner.objects import NeededWrench
from planner.shapes import Mesh
from planner.spatial import FloatArray
from planner.synthesis.objectives import EPSILON, OBJECTIVES, checked_wrenches
from planner.synthesis.terms.registry import TERMS, checked_terms
from planner.synthesis.terms.term import Term
from planner.task import GraspTask
from planner.tolerances import EDGE_RADIUS, SYNTHESIS_SHARE

NO_OBJECTIVE = "none"
"""Name for no objective at all: the first grasp that is reached."""


@dataclass(frozen=True, kw_only=True)
class ProblemForm:
    """Which rows a problem has beside the standard ones; each form is built once.

    Attributes:
        objectives: Names of the objectives that need rows of their own.
        terms: Terms of users.
    """

    objectives: tuple[str, ...] = ()
    terms: tuple[Term, ...] = ()


MOST_CLEARANCE = 1.0
"""Largest clearance (m) that can be asked for: the reach of a hand."""

MOST_WEIGHT = 1e6
"""Largest weight of a residual (-): beyond it the others are lost in rounding."""

MOST_ROUNDS = 1000
"""Most rounds: each costs milliseconds, and gains end within ten."""


@dataclass(frozen=True, kw_only=True)
class SynthesisOptions:
    """Margins, weights, objectives, own terms and effort; a new set of rows is built once.

    Attributes:
        cone_share: Share k of the friction coefficient that the internal force may use (-).
        clear_object: Distance from the object that is asked of the spheres in the links (not pads),
            m. Between two spheres the true link may be nearer; the verdict is on the true geometry.
        clear_tip: The same for the body that carries a pad, m.
        clear_table: Distance from table and obstacles that is asked of the links, m.
        clear_fingers: Distance asked between two fingers, m.
        weight_tangential: Cost of tangential force (-).
        weight_share: Cost of unequal normal forces (-).
        weight_posture: Cost of leaving the pinch posture, per squared share of joint range (-).
        weight_center: Cost of the mean contact point's squared distance from the centre of mass, in
            characteristic lengths (-): a grasp far from it bears the weight with torsion.
        rounds: How many rounds work on the objectives.
        objective: What rounds improve (``planner.synthesis.objectives``): a name, several
            as "epsilon:1,torque:0.5", or a mapping of names to weights > 0 of their squared
            residuals; "none" for nothing. Kept as text.
        task_wrenches: Wrenches (k, 6) of the objective "task", object frame, about the
            centre of mass, N and N m; if there are none, the object's weight in any direction.
        terms: Names of registered terms (``register_term``) that the problem has
            beside the standard ones.
    """

    cone_share: float = SYNTHESIS_SHARE
    clear_object: float = 0.003
    clear_tip: float = 0.0007
    clear_table: float = 0.003
    clear_fingers: float = 0.002
    weight_tangential: float = 1.0
    weight_share: float = 0.1
    weight_posture: float = 0.3
    weight_center: float = 1.0
    rounds: int = 4
    objective: str | Mapping[str, float] = EPSILON
    task_wrenches: tuple[tuple[float, ...], ...] | FloatArray = ()
    terms: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check every number and the objectives; keep them and the wrenches as plain data."""
        check_fields(self, ("cone_share",), above=0.0, most=1.0)
        clearances = ("clear_object", "clear_tip", "clear_table", "clear_fingers")
        check_fields(self, clearances, least=-MOST_CLEARANCE, most=MOST_CLEARANCE, unit="m")
        costs = ("weight_tangential", "weight_share", "weight_posture", "weight_center")
        check_fields(self, costs, least=0.0, most=MOST_WEIGHT)
        check_fields(self, ("rounds",), most=MOST_ROUNDS)
        weights = _checked_weights(self.objective)
        text = ",".join(n if w == 1.0 else f"{n}:{w!r}" for n, w in weights.items())
        object.__setattr__(self, "objective", text or NO_OBJECTIVE)
        object.__setattr__(self, "terms", checked_terms(self.terms))
        object.__setattr__(self, "task_wrenches", checked_wrenches(self.task_wrenches))
        if len(self.task_wrenches) and TASK not in weights:
            raise TaskError(
                f"there are task wrenches, but the objective is {shown(self.objective)}; add "
                f"{TASK!r} to it, or leave them out"
            )

    @cached_property
    def weights(self) -> dict[str, float]:
        """Weight of each objective (-), by name in the order of ``OBJECTIVES``."""
        return _checked_weights(self.objective)

    @property
    def form(self) -> ProblemForm:
        """The part of the options that decides which rows a problem has."""
        return ProblemForm(
            objectives=tuple(name for name in self.weights if name != EPSILON),
            terms=tuple(TERMS[name] for name in self.terms),
        )

    def values(self) -> dict[str, float]:
        """Margins and weights that are parameters of the problem, by name."""
        return {name: getattr(self, name) for name in OPTION_NAMES}

    def to_dict(self) -> dict[str, Any]:
        """Plain data, as JSON gives it back; ``terms`` only where there are any."""
        data = {**asdict(self), "task_wrenches": [list(row) for row in self.task_wrenches]}
        terms = data.pop("terms")
        return {**data, "terms": list(terms)} if terms else data


TASK = "task"
"""The objective that task wrenches belong to."""

OPTION_NAMES = tuple(
    n
    for n in SynthesisOptions.__dataclass_fields__
    if n not in ("rounds", "objective", "task_wrenches", "terms")
)
"""Names of the options that are parameters of the problem."""


def _checked_weights(objective: str | Mapping[str, float]) -> dict[str, float]:
    """Weights by name in the registry's order; none for "none" and for an empty mapping.

    Raises:
        NotFoundError: An objective that does not exist.
        TaskError: A name twice, or a weight that is not a number > 0.
    """
    if objective == NO_OBJECTIVE or (isinstance(objective, Mapping) and not objective):
        return {}
    hint = f"{NO_OBJECTIVE!r} alone stands for no objective."
    return named_weights(objective, OBJECTIVES, what="objective", hint=hint)


def named_weights(
    given: str | Mapping[str, float], names: Collection[str], *, what: str, hint: str = ""
) -> dict[str, float]:
    """Weights by name, in the order of the names that there are.

    Args:
        given: "epsilon", "epsilon:1,torque:0.5", or a mapping.
        names: The names that there are.
        what: What errors call one of them.
        hint: What the error of an unknown name adds.

    Raises:
        NotFoundError: A name that does not exist.
        TaskError: None at all, a name twice, or a weight that is not a number > 0.
    """
    if not isinstance(given, str | Mapping) or not given:
        raise TaskError(
            f"{what} is {shown(given)}; give a name, or a mapping of names to weights > 0"
        )
    pairs = _pairs(given, what) if isinstance(given, str) else list(given.items())
    for name, weight in pairs:
        if name not in names:
            raise NotFoundError(what, str(name), names, hint)
        if isinstance(weight, bool) or not isinstance(weight, int | float):
            raise TaskError(f"the weight of {name!r} is {shown(weight)}; give a number > 0")
        if not (np.isfinite(weight) and weight > 0):
            raise TaskError(f"the weight of {name!r} is {weight}; give a finite number > 0")
    weights = dict(pairs)
    if len(weights) < len(pairs):
        raise TaskError(f"{what} {shown(given)} names one twice; give each name once")
    return {name: float(weights[name]) for name in names if name in weights}


def _pairs(text: str, what: str) -> list[tuple[str, float]]:
    """Names and weights out of "epsilon:1,torque:0.5"; no weight is 1."""
    pairs = []
    for part in text.split(","):
        name, colon, weight = (piece.strip() for piece in part.partition(":"))
        try:
            pairs.append((name, float(weight) if colon else 1.0))
        except ValueError as error:
            raise TaskError(
                f"the weight of {what} {name!r} is {shown(weight)}; write NAME:WEIGHT with a "
                "number > 0, for example torque:0.5"
            ) from error
    return pairs


def needed_options(needed: Sequence[NeededWrench], options: SynthesisOptions) -> SynthesisOptions:
    """The options with the task's needed wrenches as directions of the objective "task".

    As they are where nothing is needed, where the caller has directions of his own, or where there
    is no objective at all. A grasp produces what it resists in the opposite direction.
    """
    if not needed or TASK in options.weights or not options.weights:
        return options
    loads = tuple(tuple(float(-v) for v in one.wrench) for one in needed)
    return replace(options, objective=f"{options.objective},{TASK}", task_wrenches=loads)


ROOM_DEVIATIONS, TABLE_DEVIATIONS = 1.0, 2.0
"""Standard deviations of a fingertip's place that the room between fingers and of links from the
object has, and that above table and obstacles (-). A tip that comes down on the table ends a trial:
of 17 holds of the Shadow-type hand under ``rough`` 9 succeeded with one, and 13 with two
(development draws). A link that came down on the object's rim was found in six of six failed
turns that were taken apart (development draws)."""


def with_room(options: SynthesisOptions, task: GraspTask) -> SynthesisOptions:
    """The options with more distance of links from the object, between fingers and from the table.

    More by ``ROOM_DEVIATIONS`` and ``TABLE_DEVIATIONS`` x ``task.joint_error`` x ``tip_reach``. The
    same options if the joints have no error.
    """
    deviation = task.joint_error * tip_reach(task.hand)
    if deviation == 0.0:
        return options
    return replace(
        options,
        clear_object=options.clear_object + ROOM_DEVIATIONS * deviation,
        clear_fingers=options.clear_fingers + ROOM_DEVIATIONS * deviation,
        clear_table=options.clear_table + TABLE_DEVIATIONS * deviation,
    )


LEAST_ROOM = 0.0007
"""Distance (m) from the table that is asked beside the lowest parts: that of ``clear_tip``."""


@lru_cache(maxsize=8)
def table_room(task: GraspTask) -> float:
    """Distance (m) of links from the table that a narrow object's height leaves; else infinite.

    A round pad of radius r touches a level face at least r above the table, and less than
    ``EDGE_RADIUS`` below the top it is on an edge: half of what is left between goes to the table.
    """
    shape = task.object.shape
    if task.table_height is None or not (isinstance(shape, Mesh) and shape.narrow):
        return np.inf
    up = task.T_world_object.rotation[2]
    top = task.T_world_object.translation[2] + shape.support(up)
    radius = max(f.pad.radius for f in task.fingers)
    return float(max(LEAST_ROOM, (top - task.table_height - EDGE_RADIUS - radius) / 2))
