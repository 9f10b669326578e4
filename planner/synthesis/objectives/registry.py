"""The objectives by name: rows that rounds of least squares improve.

Each objective gives rows that count where they are negative: a metric less its target. Their
numeric parameters are updated when a round begins and are zero outside rounds.
``planner.search.metrics`` evaluates the metrics of a plan by their full definitions on the true
geometry.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from planner.spatial import FloatArray
from planner.synthesis.objectives.joint import (
    limits_rows,
    manipulability_rows,
    torque_rows,
    update_torque,
)
from planner.synthesis.objectives.wrench import (
    min_weight_rows,
    robustness_rows,
    task_rows,
    update_min_weight,
    update_robustness,
    update_task,
)
from planner.synthesis.symbols import GraspPoint, GraspSymbols

EPSILON = "epsilon"
"""The default; its rows are the term ``planner.synthesis.terms.resistance``."""


def _nothing(_point: GraspPoint) -> FloatArray:
    """Parameters of rows that have none."""
    return np.zeros(0)


@dataclass(frozen=True, kw_only=True)
class Objective:
    """One objective.

    Attributes:
        weight: Weight of its rows against those of epsilon (-), so that weight 1 is sensible.
        rows: Rows and their parameters as expressions.
        update: Computes the parameters at a grasp, in the same order.
    """

    weight: float
    rows: Callable[[GraspSymbols], tuple[Any, Any]] | None = None
    update: Callable[[GraspPoint], FloatArray] = _nothing


OBJECTIVES: dict[str, Objective] = {
    EPSILON: Objective(weight=1.0),
    "min_weight": Objective(weight=0.6, rows=min_weight_rows, update=update_min_weight),
    "task": Objective(weight=1.0, rows=task_rows, update=update_task),
    "robustness": Objective(weight=4.0, rows=robustness_rows, update=update_robustness),
    "torque": Objective(weight=20.0, rows=torque_rows, update=update_torque),
    "manipulability": Objective(weight=0.5, rows=manipulability_rows),
    "limits": Objective(weight=1.0, rows=limits_rows),
}
"""All objectives by name. With these weights each raises its own measure most while nine of ten
attempts that succeed without an objective still do; with twice as much grasps are lost.
``planner.search.metrics.register_metric`` adds one."""


def objective_rows(names: tuple[str, ...], symbols: GraspSymbols) -> tuple[dict[str, Any], Any]:
    """Rows (m,) of each objective, and the parameters (k,) of all for ``objective_parameters``."""
    rows, parameters = {}, [ca.SX(0, 1)]
    for name in names:
        objective = OBJECTIVES[name]
        if objective.rows is None:
            continue
        size = ca.SX.sym(f"size_{name}")
        expression, own = objective.rows(symbols)
        rows[name] = objective.weight * size * expression
        parameters += [size, own]
    return rows, ca.vertcat(*parameters)


def objective_parameters(
    names: tuple[str, ...], weights: Mapping[str, float], point: GraspPoint
) -> FloatArray:
    """Parameters (k,) of the rows of objectives at a grasp.

    Args:
        names: As for ``objective_rows``.
        weights: Weight of each squared residual (-).
        point: The grasp.
    """
    parts = [np.zeros(0)]
    for name in names:
        parts += [np.array([np.sqrt(weights[name])]), OBJECTIVES[name].update(point)]
    return np.concatenate(parts)
