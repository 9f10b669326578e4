"""``all``: joints, pads and camera together."""

from __future__ import annotations

from planner.task import GraspTask
from sim.estimation.errors import SensorErrors
from sim.estimation.estimator import ObjectEstimator
from sim.estimation.named import register_estimator


@register_estimator("all", "joints, pads and camera")
def every_sense(task: GraspTask, errors: SensorErrors) -> ObjectEstimator:
    """The estimator that reads everything there is."""
    return ObjectEstimator(task, errors)
