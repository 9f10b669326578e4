"""``touch``: joints and pads; the object is looked at only before the hand closes."""

from __future__ import annotations

from planner.task import GraspTask
from sim.estimation.errors import SensorErrors
from sim.estimation.estimator import ObjectEstimator
from sim.estimation.named import register_estimator


@register_estimator("touch", "joints and pads; no camera once the hand closes")
def by_touch(task: GraspTask, errors: SensorErrors) -> ObjectEstimator:
    """The estimator of a hand that sees nothing while it holds."""
    return ObjectEstimator(task, errors, camera=False)
