"""Where the object is, from joints, touch and camera, and how well that is known."""

from sim.estimation.estimator import ObjectEstimator
from sim.estimation.filter import ContactNoise
from sim.estimation.log import EstimateLog
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
from sim.estimation.state import SensorErrors

__all__ = [
    "ESTIMATORS",
    "NONE",
    "AnyEstimator",
    "ContactNoise",
    "EstimateLog",
    "Estimator",
    "NamedEstimator",
    "ObjectEstimator",
    "SensorErrors",
    "check_estimator",
    "default_estimator",
    "estimator_for",
    "estimator_name",
    "register_estimator",
]
