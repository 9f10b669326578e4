"""Many grasps at once: planned in parallel, stored as they come, compared, thinned, exported."""

from planner.batch.dataset import GraspSet
from planner.batch.diversity import Diversity, GraspFeatures, diversity, thin
from planner.batch.run import BatchProgress, plan_grasps, plan_several, refine_grasps, separations

__all__ = [
    "BatchProgress",
    "Diversity",
    "GraspFeatures",
    "GraspSet",
    "diversity",
    "plan_grasps",
    "plan_several",
    "refine_grasps",
    "separations",
    "thin",
]
