"""Where the object is, from joints, touch and camera, and how well that is known."""

from sim.sensing.estimation.estimator import (
    ESTIMATORS,
    NONE,
    AnyEstimator,
    Estimator,
    NamedEstimator,
    ObjectEstimator,
    check_estimator,
    default_estimator,
    estimator_for,
    estimator_name,
    register_estimator,
)
from sim.sensing.estimation.filter import ContactNoise
from sim.sensing.estimation.log import EstimateLog
from sim.sensing.estimation.state import SensorErrors

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
