"""Starts of grasp synthesis: palm poses, postures, and pairs of opposed surface points."""
