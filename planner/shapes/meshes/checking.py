"""From triangles to the surface of a solid: sound as given, mended, or refused in words."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from planner.errors import ObjectError
from planner.shapes.meshes.mending import Mending, mended, too_wide
from planner.shapes.meshes.soundness import faults_of, size_fault
from planner.shapes.meshes.triangles import digest_of
from planner.shapes.meshes.union import manifold_is_installed
from planner.spatial import FloatArray, IntArray
from planner.system.disk_cache import read_arrays, write_arrays

CHECK_VERSION = "v3"
"""Changes where checks or mending do, so that stored results are made anew."""

FIGURES = ("moved", "hole", "volume_change")
"""Numbers of a ``Mending`` that are stored."""


def checked_once(name: str, vertices: FloatArray, faces: IntArray) -> Mending | None:
    """As ``check_solid``; what was found is kept in the disk cache."""
    by = "manifold" if manifold_is_installed() else "grid"
    key = f"{CHECK_VERSION}-{by}-{digest_of(vertices, faces)}"
    known = read_arrays("sound", key)
    if known is not None and set(known) == {"sound"}:
        return None
    if known is not None:
        try:
            return _restored(known)
        except (KeyError, ValueError, TypeError, IndexError):
            pass  # of another form: made anew
    mending = check_solid(name, vertices, faces)
    write_arrays("sound", key, {"sound": np.ones(1)} if mending is None else _stored(mending))
    return mending


def _stored(mending: Mending) -> dict[str, FloatArray | IntArray]:
    return {
        "vertices": mending.vertices,
        "faces": mending.faces,
        "figures": np.array([getattr(mending, name) for name in FIGURES]),
        "done": np.frombuffer("\n".join(mending.done).encode(), dtype=np.uint8).astype(np.int64),
    }


def _restored(known: dict[str, FloatArray]) -> Mending:
    vertices = known["vertices"].reshape(-1, 3)
    faces = known["faces"].reshape(-1, 3).astype(np.int64)
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise ValueError("faces of vertices that are not there")
    done = known["done"].astype(np.uint8).tobytes().decode()
    figures = dict(zip(FIGURES, known["figures"].astype(float).tolist(), strict=True))
    return Mending(vertices=vertices, faces=faces, done=tuple(done.split("\n")), **figures)


def check_solid(
    name: str, vertices: FloatArray, faces: IntArray, *, repair: bool = False, strict: bool = False
) -> Mending | None:
    """How the surface of a solid was mended; None if it is sound as it is.

    Args:
        name: What to call it in messages.
        vertices: (n, 3), m.
        faces: (m, 3).
        repair: Whether to accept what mending changes, however much that is.
        strict: Whether to refuse what would have to be mended.

    Raises:
        ObjectError: It bounds no solid; says what is wrong, where, and what can be done.
    """
    if repair and strict:
        raise ObjectError(
            f"{name}: repair and strict are both asked for; give one of them: --repair accepts "
            "what mending changes, --strict refuses what would have to be mended"
        )
    wrong_size = size_fault(vertices)
    if wrong_size:
        file = name if Path(name).suffix else "FILE"
        remedy = wrong_size.remedy.replace("FILE", file)
        raise ObjectError(f"{name} {wrong_size.what}; sizes are in metres: {remedy}")
    faults = faults_of(vertices, faces)
    if not faults:
        return None
    what = f"{name} is not the surface of a solid: {'; '.join(fault.what for fault in faults)}"
    if strict:
        raise ObjectError(
            f"{what}; it is not mended, since --strict (strict=True) is given: leave that out, or "
            "mend it in the program that made it"
        )
    mending = mended(vertices, faces)
    if mending.faults:
        tried = "; ".join(mending.done) if mending.done else "nothing could be mended"
        left = "; ".join(fault.what for fault in mending.faults)
        hole = too_wide(mending.vertices, mending.faces) if len(mending.faces) else ""
        left = f"{left}; {hole}" if hole else left
        raise ObjectError(
            f"{what}. Mending was tried ({tried}), and then {left}; close it, or unite its parts, "
            "in the program that made it"
        )
    if mending.too_much and not repair:
        raise ObjectError(
            f"{what}; {mending.too_much}: accept that with --repair (repair=True), or mend it in "
            "the program that made it"
        )
    return mending
