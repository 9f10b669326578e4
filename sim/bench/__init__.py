"""Measurements of the planner, behind the commands of ``opposable bench``."""
