"""Signed distances, nearest points and normals between geometries, one pair or many at once."""
