"""Examples of the formats: small ones as text, others made by planning and simulating once."""

from __future__ import annotations

import json
import math
from functools import cache
from typing import Any

from planner import (
    GraspPlan,
    GraspTask,
    ManipulationPlan,
    manipulation_task,
    parse_object,
    plan_grasp,
    plan_manipulation,
)
from planner.exchange.table import table_of
from planner.files import plan_to_dict
from planner.files.movements import movement_to_dict
from sim import (
    ManipulationTimeline,
    PhysicsOptions,
    Timeline,
    TrialReport,
    manipulate,
    simulate,
)

MOST_ITEMS = 2
"""Items of a list that are shown."""

LONGEST_LIST = 4
"""Lists up to this length are shown in whole."""

PHYSICS = """\
name = "coarse"
timestep = 0.004         # s
impratio = 5.0
noslip_iterations = 2
solref = [0.01, 1.0]     # time constant in s, damping ratio
"""

CONTACTS = """\
{
  "contacts": [
    {"position_m": [0.03, 0, 0], "normal_into_object": [-1, 0, 0], "mu": 0.5,
     "model": "soft", "mu_torsion_m": 0.005},
    {"position_m": [-0.03, 0, 0], "normal_into_object": [1, 0, 0], "mu": 0.5,
     "model": "soft", "mu_torsion_m": 0.005}
  ],
  "center_m": [0, 0, 0]
}
"""


def cut(value: Any) -> Any:
    """A value with its long lists cut short."""
    if isinstance(value, dict):
        return {key: cut(inner) for key, inner in value.items()}
    if isinstance(value, list) and len(value) > LONGEST_LIST:
        return [*map(cut, value[:MOST_ITEMS]), ...]
    if isinstance(value, list):
        return [cut(inner) for inner in value]
    return round(value, 4) if isinstance(value, float) else value


def printed(value: Any, indent: int = 0) -> str:
    """JSON with short lists on one line; ``...`` for what was cut."""
    blank = " " * indent
    if value is ...:
        return "..."
    if isinstance(value, dict) and value:
        inner = (f"{blank}  {json.dumps(k)}: {printed(v, indent + 2)}" for k, v in value.items())
        return "{\n" + ",\n".join(inner) + f"\n{blank}}}"
    if isinstance(value, list) and any(isinstance(item, dict) for item in value):
        items = (f"{blank}  {printed(v, indent + 2)}" for v in value)
        return "[\n" + ",\n".join(items) + f"\n{blank}]"
    if isinstance(value, list):
        return f"[{', '.join(printed(item) for item in value)}]"
    return json.dumps(value)


def shortened(data: dict[str, Any]) -> str:
    """A file's data as text, its long lists cut."""
    return printed(cut(json.loads(json.dumps(data))))


@cache
def _grasp() -> GraspPlan:
    return plan_grasp(GraspTask.create("allegro_hand", "cylinder:0.03x0.10"), seed=0)


@cache
def _manipulation() -> ManipulationPlan:
    task = manipulation_task("allegro_hand", parse_object("cylinder:0.03x0.08"), mu=0.45)
    return plan_manipulation(task, angle=math.radians(10))


def plan() -> str:
    """A grasp plan."""
    return shortened(plan_to_dict(_grasp()))


def grasp_table() -> str:
    """A table of one grasp."""
    return shortened(table_of([_grasp()]).model_dump(exclude_none=True))


@cache
def trial() -> TrialReport:
    """A trial of that grasp."""
    return simulate(_grasp(), timeline=Timeline.quick())


def report() -> str:
    """A trial report."""
    return shortened(trial().to_dict())


def movement() -> str:
    """A manipulation plan: a movement of one stroke with an ending."""
    return shortened(movement_to_dict(_manipulation()))


def manipulation_report() -> str:
    """What happened in a manipulation."""
    quick = ManipulationTimeline(approach=0.4, lift=0.4, carry=0.2, retreat=0.2, height=0.03)
    coarse = PhysicsOptions(timestep=0.004)  # s; the field's names are what is shown
    return shortened(manipulate(_manipulation(), timeline=quick, physics=coarse).to_dict())
