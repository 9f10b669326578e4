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
    check_estimator,
    default_estimator,
    estimator_for,
    estimator_name,
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
    "check_estimator",
    "contact",
    "default_estimator",
    "estimator_for",
    "estimator_name",
    "register_estimator",
    "touch",
]
