"""What cameras saw of an object: points with noise, and the surface believed behind them."""

from planner.clouds.belief import Belief
from planner.clouds.cloud import PointCloud, prepared

__all__ = ["Belief", "PointCloud", "prepared"]
