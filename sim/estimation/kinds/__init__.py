"""Estimators that ship, a file each; each registers itself by its name."""
