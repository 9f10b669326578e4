"""What a grasp can be made good at, by name: rows of residuals that rounds of descents work on.

Each objective gives rows that count where they are negative, in its own unit and less what is aimed
at. Their numeric parameters are found anew when a round begins, and are zero outside rounds. What a
plan then reaches, each by its full definition on the true geometry, is told by
``planner.plan_metrics``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from planner.spatial import FloatArray
from planner.synthesis.objectives.joint import (
    aim_torque,
    limits_rows,
    manipulability_rows,
    torque_rows,
)
from planner.synthesis.objectives.wrench import (
    aim_min_weight,
    aim_robustness,
    aim_task,
    min_weight_rows,
    robustness_rows,
    task_rows,
)
from planner.synthesis.symbols import GraspPoint, GraspSymbols

__all__ = [
    "EPSILON",
    "OBJECTIVES",
    "GraspPoint",
    "GraspSymbols",
    "Objective",
    "objective_parameters",
    "objective_rows",
]

EPSILON = "epsilon"
"""The default; its rows are always there (``planner.synthesis.terms``)."""


def _nothing(_moment: GraspPoint) -> FloatArray:
    """Parameters of rows that have none."""
    return np.zeros(0)


@dataclass(frozen=True, kw_only=True)
class Objective:
    """Something that a grasp can be made good at.

    Attributes:
        share: Weight of its rows against those of epsilon (-), so that weight 1 is sensible.
        rows: Rows and their parameters as expressions.
        aim: The parameters at a grasp, in the same order.
    """

    share: float
    rows: Callable[[GraspSymbols], tuple[Any, Any]] | None = None
    aim: Callable[[GraspPoint], FloatArray] = _nothing


OBJECTIVES: Mapping[str, Objective] = {
    EPSILON: Objective(share=1.0),
    "min_weight": Objective(share=0.6, rows=min_weight_rows, aim=aim_min_weight),
    "task": Objective(share=1.0, rows=task_rows, aim=aim_task),
    "robustness": Objective(share=4.0, rows=robustness_rows, aim=aim_robustness),
    "torque": Objective(share=20.0, rows=torque_rows, aim=aim_torque),
    "manipulability": Objective(share=0.5, rows=manipulability_rows),
    "limits": Objective(share=1.0, rows=limits_rows),
}
"""All objectives by name. With these shares each raises its own measure most while nine of ten
attempts that succeed without an objective still do; with twice as much grasps are lost."""


def objective_rows(names: tuple[str, ...], symbols: GraspSymbols) -> tuple[dict[str, Any], Any]:
    """Rows (m,) of each objective, and the parameters (k,) of all for ``objective_parameters``."""
    rows, parameters = {}, [ca.SX(0, 1)]
    for name in names:
        objective = OBJECTIVES[name]
        if objective.rows is None:
            continue
        size = ca.SX.sym(f"size_{name}")
        expression, own = objective.rows(symbols)
        rows[name] = objective.share * size * expression
        parameters += [size, own]
    return rows, ca.vertcat(*parameters)


def objective_parameters(
    names: tuple[str, ...], weights: Mapping[str, float], moment: GraspPoint
) -> FloatArray:
    """Parameters (k,) of the rows of objectives at a grasp.

    Args:
        names: As for ``objective_rows``.
        weights: Weight of each squared residual (-).
        moment: The grasp.
    """
    parts = [np.zeros(0)]
    for name in names:
        parts += [np.array([np.sqrt(weights[name])]), OBJECTIVES[name].aim(moment)]
    return np.concatenate(parts)
