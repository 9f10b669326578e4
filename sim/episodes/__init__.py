"""Executed trials as data sets of other tools: one row per control step, video, metadata."""
