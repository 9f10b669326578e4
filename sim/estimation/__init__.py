"""Where the object is, from joints, touch and camera, and how well that is known."""

from sim.estimation.errors import SensorErrors
from sim.estimation.estimator import ObjectEstimator
from sim.estimation.filter import Trust
from sim.estimation.kinds import all, contact, touch
from sim.estimation.named import (
    ESTIMATORS,
    NONE,
    AnyEstimator,
    Estimator,
    NamedEstimator,
    estimator_for,
    register_estimator,
)

__all__ = [
    "ESTIMATORS",
    "NONE",
    "AnyEstimator",
    "Estimator",
    "NamedEstimator",
    "ObjectEstimator",
    "SensorErrors",
    "Trust",
    "all",
    "contact",
    "estimator_for",
    "register_estimator",
    "touch",
]
