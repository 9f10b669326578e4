"""Polyhedra as bare arrays: input checks, moments, digest."""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import sha256
from typing import Self

import numpy as np

from planner.arrays import float_array
from planner.errors import ObjectError
from planner.spatial import FloatArray, IntArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Polyhedron:
    """A solid bounded by triangles, with its centre of mass at the origin.

    Attributes:
        vertices: (n, 3), m; read-only.
        faces: (m, 3), indices of vertices, counter-clockwise seen from outside; read-only.
        offset: The centre of mass (3,) where it was before, m.
        volume: m3.
        second_moments: (3, 3) about the centre of mass, m5.
    """

    vertices: FloatArray
    faces: IntArray
    offset: FloatArray
    volume: float
    second_moments: FloatArray

    @classmethod
    def centred(cls, vertices: FloatArray, faces: IntArray) -> Self:
        """From vertices (n, 3), m, about any origin, and faces (m, 3) that bound a solid.

        Raises:
            ObjectError: See ``checked_triangles``.
        """
        points, triangles = checked_triangles("mesh", vertices, faces)
        v, f = np.array(points), np.array(triangles)
        volume, center, second = moments(v[f])
        v -= center
        v.setflags(write=False)
        f.setflags(write=False)
        second -= volume * np.outer(center, center)
        return cls(vertices=v, faces=f, offset=center, volume=volume, second_moments=second)


def moments(corners: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    """Volume (m3), centroid (3,) and second moments (3, 3), m5, about the origin.

    Each triangle spans a tetrahedron with the origin, of determinant D: volume D/6, first moments
    D/24 (a + b + c), second moments D/120 (a a' + b b' + c c' + s s') with s = a + b + c (Tonon,
    "Explicit exact formulas for the 3-D tetrahedron inertia tensor", 2004).
    """
    a, b, c = (corners[:, k] for k in range(3))
    d = np.einsum("nd,nd->n", a, np.cross(b, c))
    total = a + b + c
    volume = float(d.sum() / 6)
    center = np.einsum("n,nd->d", d, total) / 24 / volume
    second = sum(np.einsum("n,ni,nj->ij", d, v, v) for v in (a, b, c, total)) / 120
    return volume, center, np.asarray(second)


def digest_of(vertices: FloatArray, faces: IntArray) -> str:
    """SHA-256 of vertices (n, 3) and faces (m, 3), as hexadecimal; the same on every machine."""
    content = sha256(np.ascontiguousarray(vertices, dtype="<f8").tobytes())
    content.update(np.ascontiguousarray(faces, dtype="<i8").tobytes())
    return content.hexdigest()


def checked_triangles(
    name: str, vertices: FloatArray, faces: IntArray
) -> tuple[FloatArray, IntArray]:
    """Vertices (n, 3), m, as float64 and faces (m, 3) as int64.

    Raises:
        ObjectError: Other shapes, NaN or infinity, no faces, or faces of vertices that are not
            there.
    """
    v = float_array(f"{name}: vertices", vertices, error=ObjectError)
    try:
        f = np.asarray(faces)
        if isinstance(faces, np.ma.MaskedArray) and faces.mask.any():
            raise ValueError("some of it is masked")
    except ValueError as fault:  # rows of different lengths
        raise ObjectError(f"{name}: faces are no array ({fault}); give integers (m, 3)") from fault
    if v.ndim != 2 or v.shape[1:] != (3,) or not np.isfinite(v).all():
        raise ObjectError(f"{name}: vertices have shape {v.shape}; give finite (n, 3), in m")
    if f.ndim != 2 or f.shape[1:] != (3,) or not np.issubdtype(f.dtype, np.integer) or len(f) == 0:
        raise ObjectError(f"{name}: faces are {f.dtype} of shape {f.shape}; give integers (m, 3)")
    if f.min() < 0 or f.max() >= len(v):
        raise ObjectError(
            f"{name}: faces name vertex {f.min()} to {f.max()}, but there are 0 to {len(v) - 1}"
        )
    return v, f.astype(np.int64)
