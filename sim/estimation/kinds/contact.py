"""``contact``: joints, and whether each finger touches; a look only before the hand closes.

What pads would say is put in its place: contacts where round tips touch the estimated object, a
nominal force along the normal, no sliding.
"""

from __future__ import annotations

from planner.task import GraspTask
from sim.estimation.errors import SensorErrors
from sim.estimation.estimator import ObjectEstimator
from sim.estimation.named import register_estimator


@register_estimator("contact", "joints, and which fingers touch; no camera once the hand closes")
def by_contact(task: GraspTask, errors: SensorErrors) -> ObjectEstimator:
    """The estimator of a hand with a switch in every fingertip."""
    return ObjectEstimator(task, errors, touch="binary", camera=False)
