"""From triangles to the surface of a solid: sound as given, mended, or refused in words.

A mesh that is not sound as it is given is mended: its edges first (``repair``), then what crosses
itself is cut out and filled, or evened out by manifold3d, which also unites bodies that overlap.
The result is sound, its distance from what was given is measured, and it is accepted if a grasp
would not notice.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import coal
import numpy as np

from planner.errors import ObjectError
from planner.shapes.meshes.nearest_triangle import NearestTriangles, coal_tree
from planner.shapes.meshes.repair import (
    SAME,
    WIDEST_HOLE,
    Surface,
    hole_width,
    manifold_of,
    right_side_out,
    rims,
    surface_of,
    with_closed_holes,
    with_paired_edges,
)
from planner.shapes.meshes.soundness import (
    Fault,
    bodies_of,
    body_volumes,
    crossing_pairs,
    directed_edges,
    faults_of,
    folded_pairs,
    near_pairs,
    nested,
    paired_edges,
    size_fault,
    undirected_edges,
)
from planner.shapes.meshes.triangles import cover, digest_of
from planner.spatial import FloatArray, IntArray
from planner.system.disk_cache import read_arrays, write_arrays

MOVED = 2e-4
"""Largest distance (m) by which mending may move the surface unasked: less than half of the 0.5 mm
within which a pad of a verified grasp touches the true surface."""

HOLE_REACH = 1.5e-3
"""Largest distance (m) of what closes a hole from the given surface, unasked: into a hole of that
half width, a fingertip of radius R = 6 mm sinks by a^2 / 2 R = 0.2 mm, as far as ``MOVED``,
whatever the surface was there."""

VOLUME = 0.005
"""Largest share by which mending may change the volume, and so mass and inertia, unasked."""

NOTHING = 1e-6
"""Distance (m) that is told as none: to which distances are measured."""

TOLD_VOLUME = 1e-4
"""Share by which the volume changes, from which on it is told."""

CUTS = 6
"""Rounds in which crossing triangles are cut out and their holes closed, at most."""

SIMPLIFIED = (2.5e-5, 5e-5, 1e-4, 2e-4)
"""Tolerances (m) to which a surface is simplified if cuts leave crossings, up to ``MOVED``."""

ISLAND = 0.02
"""Share of all triangles below which what a cut leaves alone goes too."""

MOST_POINTS = 3_000
"""Points, about, on the triangles of either surface that the other has not."""

CHECK_VERSION = "v4"
"""Changes where checks or mending do, so that stored results are made anew."""

FIGURES = ("moved", "hole", "volume_change")
"""Numbers of a ``Mending`` that are stored."""


@dataclass(frozen=True, kw_only=True)
class Mending:
    """A surface that was mended, and by how much it differs from the given one.

    Attributes:
        vertices: (n, 3), m.
        faces: (m, 3).
        done: What was mended, in words.
        faults: What is wrong still; empty if it is sound.
        moved: Largest distance (m) between the two surfaces, but for holes.
        hole: Largest distance (m) of what closes a hole from the given surface; 0 without one.
        volume_change: Share of the volume that was gained or lost.
    """

    vertices: FloatArray
    faces: IntArray
    done: tuple[str, ...]
    faults: tuple[Fault, ...] = ()
    moved: float = 0.0
    hole: float = 0.0
    volume_change: float = 0.0

    @property
    def sentence(self) -> str:
        """What was done and how far the surface moved: "2 parts united; surface moved by ..."."""
        moved = "0" if self.moved < NOTHING else f"at most {1e3 * self.moved:.2g} mm"
        volume = ""
        if self.volume_change >= TOLD_VOLUME:
            volume = f", volume changed by {100 * self.volume_change:.2g} %"
        return f"{'; '.join(self.done)}; surface moved by {moved}{volume}"

    @property
    def too_much(self) -> str:
        """Why this is more than is mended unasked; "" if it is not."""
        if self.hole > HOLE_REACH:
            return (
                f"closing a hole makes surface up to {1e3 * self.hole:.2g} mm away from the given "
                f"one, more than {1e3 * HOLE_REACH:g} mm"
            )
        if self.moved > MOVED:
            return (
                f"mending moves the surface by up to {1e3 * self.moved:.2g} mm, more than "
                f"{1e3 * MOVED:g} mm"
            )
        if self.volume_change > VOLUME:
            return (
                f"mending changes the volume by {100 * self.volume_change:.2g} %, more than "
                f"{100 * VOLUME:g} %"
            )
        return ""


def checked_once(name: str, vertices: FloatArray, faces: IntArray) -> Mending | None:
    """As ``check_solid``; what was found is kept in the disk cache."""
    key = f"{CHECK_VERSION}-{digest_of(vertices, faces)}"
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
        hole = _too_wide(mending.vertices, mending.faces) if len(mending.faces) else ""
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


def _too_wide(vertices: FloatArray, faces: IntArray) -> str:
    """The widest hole that no mending closes, and the limit, in words; "" if there is none."""
    length = float(np.ptp(vertices, axis=0).max())
    width = max((hole_width(vertices, ring) for ring in rims(faces)), default=0.0)
    if width <= WIDEST_HOLE * length:
        return ""
    return (
        f"a hole is {1e3 * width:.3g} mm wide, {width / length:.2f} of the object's length, and "
        f"holes are closed up to {WIDEST_HOLE:g} of it ({1e3 * WIDEST_HOLE * length:.3g} mm), with "
        "--repair too: a wider one is taken for the shape itself"
    )


def mended(vertices: FloatArray, faces: IntArray) -> Mending:
    """The surface of a solid that is nearest to a surface that bounds none, as far as can be had.

    Args:
        vertices: (n, 3), m, finite.
        faces: (m, 3).
    """
    done: list[str] = []
    v, f = with_paired_edges(vertices, faces, done)
    if len(f) == 0 or paired_edges(f) is None:
        faults = faults_of(v, f) if len(f) else faults_of(vertices, faces)
        return Mending(vertices=v, faces=f, done=tuple(done), faults=faults)
    f = right_side_out(v, f, done)
    closed, volume, change = (v, f), _volume(v, f), 0.0
    crossed = _crossed(v, f)
    if len(crossed):
        v, f, how = _uncrossed(v, f)
        done.append(f"{len(crossed)} triangles crossed, {how}")
        change = abs(_volume(v, f) / volume - 1) if volume > 0 else np.inf
    faults = faults_of(v, f)
    if faults and volume > 0 and not len(_crossed(v, f)):
        done.append(f"{len(np.unique(bodies_of(f)))} parts that overlap or touch united")
        v, f = united(v, f)
        faults = faults_of(v, f)
    if faults:
        return Mending(vertices=v, faces=f, done=tuple(done), faults=faults)
    holes = any("closed" in words for words in done)
    return Mending(
        vertices=v,
        faces=f,
        done=tuple(done),
        moved=deviation(closed if holes else (vertices, faces), (v, f)),
        hole=deviation((vertices, faces), closed) if holes else 0.0,
        volume_change=change,
    )


def _volume(vertices: FloatArray, faces: IntArray) -> float:
    return float(body_volumes(vertices, faces, bodies_of(faces)).sum())


def _crossed(vertices: FloatArray, faces: IntArray) -> IntArray:
    """Triangles (k,) that cross, or lie on, others of their own body.

    Where edges are not of two triangles each: the triangles on such edges.
    """
    across = paired_edges(faces)
    if across is None:
        _, of_edge, counts = np.unique(
            undirected_edges(faces), return_inverse=True, return_counts=True
        )
        return np.flatnonzero((counts[of_edge].reshape(-1, 3) != 2).any(axis=1))
    corners, body = vertices[faces], bodies_of(faces)
    one, other = crossing_pairs(corners, near_pairs(vertices, faces))
    own = body[one] == body[other]
    folded = folded_pairs(corners, across)
    return np.unique(np.concatenate([one[own], other[own], *folded]))


def _uncrossed(vertices: FloatArray, faces: IntArray) -> tuple[FloatArray, IntArray, str]:
    """A surface whose bodies do not cross themselves, and how it came about; as far as can be had.

    Where few triangles cross, mostly slivers that decimation folded over, they go and the holes are
    closed. Where more cross, the whole surface is simplified by a tenth of a millimetre or so.
    """
    v, f = vertices, faces
    for _ in range(CUTS):
        faulty = _crossed(v, f)
        if len(faulty) == 0:
            return v, f, "cut out and filled"
        left = np.delete(f, faulty, axis=0)
        if len(left) == 0:
            break
        parts = bodies_of(left)
        large = np.bincount(parts) >= ISLAND * len(left)
        v, f, _ = with_closed_holes(v, _without_pinches(left[large[parts]]), np.inf)
        used, f = np.unique(f, return_inverse=True)
        v, f = v[used], f.reshape(-1, 3)
    whole = manifold_of(vertices, faces)
    for tolerance in SIMPLIFIED:
        v, f = surface_of(whole.simplify(tolerance))
        if len(f) and len(_crossed(v, f)) == 0:
            return v, f, f"simplified to {1e3 * tolerance:g} mm"
    return vertices, faces, "which neither cutting nor simplifying ends"


def _without_pinches(faces: IntArray) -> IntArray:
    """Without the triangles at vertices in which rims meet, so that every rim is simple."""
    while True:
        tail, head = directed_edges(faces)
        n = int(faces.max()) + 1
        is_open = ~np.isin(tail * n + head, head * n + tail)
        pinched = np.bincount(tail[is_open], minlength=n) > 1
        bad = pinched[faces].any(axis=1)
        if not bad.any() or bad.all():
            return faces
        faces = faces[~bad]


def united(vertices: FloatArray, faces: IntArray) -> Surface:
    """The union of the bodies of a surface, by manifold3d.

    A body that is wound inwards is a cavity if another lies around it, and of matter otherwise.

    Args:
        vertices: (n, 3), m.
        faces: (m, 3), each body closed, consistently wound, and not crossing itself.
    """
    import manifold3d

    body = bodies_of(faces)
    volumes = body_volumes(vertices, faces, body)
    turned = np.where((volumes < 0)[body][:, None], faces[:, ::-1], faces)
    cavities: dict[int, list[int]] = {}
    matter = set(range(len(volumes)))
    pairs = [(inner, outer) for inner, outer, _ in nested(vertices[turned], body, len(volumes))]
    for cavity in sorted({inner for inner, _ in pairs if volumes[inner] < 0}):
        # of the body closest around it; matter of another body fills it
        around = [outer for inner, outer in pairs if inner == cavity]
        owner = min(around, key=lambda outer: abs(float(volumes[outer])))
        matter.discard(cavity)
        cavities.setdefault(owner, []).append(cavity)
    solids = [manifold_of(vertices, turned[body == number]) for number in range(len(volumes))]
    parts = []
    for number in sorted(matter):
        hollow = [solids[k] for k in cavities.get(number, ())]
        subtract = manifold3d.OpType.Subtract
        parts.append(manifold3d.Manifold.batch_boolean([solids[number], *hollow], subtract))
    return surface_of(manifold3d.Manifold.batch_boolean(parts, manifold3d.OpType.Add))


def deviation(given: Surface, mended: Surface) -> float:
    """Largest distance (m) between two surfaces where they differ, to a micrometre.

    Of points of the mended surface from the given one, and of points of the given one outside the
    mended solid from its surface. What lies inside is matter, and could never be touched.

    Args:
        given: Vertices (n, 3), m, and faces (m, 3).
        mended: The same of a sound surface.
    """
    fresh, gone = _only_in(mended, given), _only_in(given, mended)
    moved = 0.0
    if len(fresh):
        moved = float(_distances(given, _points(mended[0][mended[1][fresh]])).max())
    if len(gone):
        points = _points(given[0][given[1][gone]])
        surface, _, normal = NearestTriangles(*mended).nearest(points)
        gap = points - surface
        outside = np.einsum("nd,nd->n", gap, normal) > 0
        moved = max(moved, float(np.linalg.norm(gap[outside], axis=1).max(initial=0.0)))
    return moved


def _only_in(one: Surface, other: Surface) -> IntArray:
    """Faces (k,) of the first surface that the second has not, however they are wound."""
    mine, theirs = (np.round(v[f].mean(axis=1) / SAME).astype(np.int64) for v, f in (one, other))
    known = set(map(tuple, theirs.tolist()))
    return np.flatnonzero([tuple(middle) not in known for middle in mine.tolist()])


def _points(corners: FloatArray) -> FloatArray:
    """Points spread over triangles (k, 3, 3), and some of their corners."""
    edges = np.roll(corners, -1, axis=1) - corners
    area = float(np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum()) / 2
    length = float(np.linalg.norm(edges, axis=2).max(axis=1).sum())  # needles have no area
    spread, _ = cover(corners, max(float(np.sqrt(area / MOST_POINTS)), length / MOST_POINTS, SAME))
    own = np.unique(corners.reshape(-1, 3), axis=0)
    return np.concatenate([p[:: max(1, len(p) // MOST_POINTS)] for p in (spread, own)])


def _distances(surface: Surface, points: FloatArray) -> FloatArray:
    """Distances (n,), m, of points (n, 3) from triangles that need not bound anything."""
    tree, probe = coal_tree(*surface), coal.Sphere(0.0)  # coal keeps no reference of its own
    measure = coal.ComputeDistance(tree, probe)
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    identity, pose = coal.Transform3s.Identity(), coal.Transform3s.Identity()
    out = np.empty(len(points))
    for i, point in enumerate(points):
        pose.setTranslation(point)
        result.clear()
        out[i] = measure(identity, pose, request, result)
    return np.maximum(out, 0.0)
