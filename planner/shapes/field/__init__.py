"""The smooth signed distance of a mesh: a spline field, its fit, and its exact samples."""
