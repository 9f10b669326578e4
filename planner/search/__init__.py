"""Searches: attempts by seed, the first grasp or the best of many, and grasps near a given one."""
