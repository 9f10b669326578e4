"""The best of several grasps: what is asked for, and attempts that build on each other."""

from planner.best.attempts import FALLEN_BEHIND, improving_attempts
from planner.best.wanted import BEST, FIRST, Wanted

__all__ = ["BEST", "FALLEN_BEHIND", "FIRST", "Wanted", "improving_attempts"]
