"""Meshes that nearly bound a solid, mended where that changes nothing that matters.

A mesh that is not sound as it is given is mended: edges (``repair``), triangles that cross others
of their own body (``patches``), bodies that overlap (``union``, or ``wrapping`` without
manifold3d). The result is sound, its distance from what was given is measured, and it is accepted
if a grasp would not notice.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.shapes.meshes.deviation import deviation
from planner.shapes.meshes.holes import hole_widths
from planner.shapes.meshes.patches import crossed_in_bodies, without_crossings
from planner.shapes.meshes.repair import right_side_out, with_paired_edges
from planner.shapes.meshes.soundness import Fault, bodies_of, body_volumes, faults_of, paired_edges
from planner.shapes.meshes.union import manifold_is_installed, united
from planner.shapes.meshes.wrapping import wrapped
from planner.spatial import FloatArray, IntArray

MOVED = 2e-4
"""Largest distance (m) by which mending may move the surface unasked: less than half of the 0.5 mm
within which a pad of a verified grasp touches the true surface."""

HOLE_REACH = 1.5e-3
"""Largest distance (m) of what closes a hole from the given surface, unasked: into a hole of that
half width, a fingertip of radius R = 6 mm sinks by a^2 / 2 R = 0.2 mm, as far as ``MOVED``,
whatever the surface was there."""

VOLUME = 0.005
"""Largest share by which mending may change the volume, and so mass and inertia, unasked."""

WIDEST_HOLE = 0.3
"""A hole is closed on request if its extent is at most this fraction of the object's: a wider one
is no defect, but the shape itself (an open shell)."""


NOTHING = 1e-6
"""Distance (m) that is told as none: to which distances are measured."""

TOLD_VOLUME = 1e-4
"""Share by which the volume changes, from which on it is told."""

WRAP_CELLS = (96, 192)
"""Cells along the longest extent when a surface is wrapped, coarse first: 1 mm on an object of 10
cm, and half of that where the surface moves too far."""

WRAP_ROUNDS = 6
"""Rounds of cutting and filling, at most, after wrapping: a second each."""


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


def too_wide(vertices: FloatArray, faces: IntArray) -> str:
    """The widest hole that no mending closes, and the limit, in words; "" if there is none."""
    length = float(np.ptp(vertices, axis=0).max())
    width = max(hole_widths(vertices, faces), default=0.0)
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
    widest = WIDEST_HOLE * float(np.ptp(vertices, axis=0).max())
    v, f = with_paired_edges(vertices, faces, widest, done)
    if len(f) == 0 or paired_edges(f) is None:
        faults = faults_of(v, f) if len(f) else faults_of(vertices, faces)
        return Mending(vertices=v, faces=f, done=tuple(done), faults=faults)
    f = right_side_out(v, f, done)
    closed, volume = (v, f), _volume(v, f)
    v, f, change = _uncrossed(v, f, volume, done)
    faults = faults_of(v, f)
    if faults and volume > 0:
        v, f = _one_solid(v, f, done)
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


def _uncrossed(
    vertices: FloatArray, faces: IntArray, volume: float, done: list[str]
) -> tuple[FloatArray, IntArray, float]:
    """Without triangles that cross others of their own body, and the share of volume that went.

    Cut out and filled or, where that moves the surface too far and a grid does not, wrapped.
    """
    crossed = crossed_in_bodies(vertices, faces)
    if len(crossed) == 0:
        return vertices, faces, 0.0
    given, how = (vertices, faces), "cut out and filled"
    best = without_crossings(vertices, faces)
    sound = best is not None and not faults_of(*best)
    if best is None or not sound or deviation(given, best) > MOVED:
        other = _wrapped(vertices, faces)
        if not faults_of(*other) and (not sound or deviation(given, other) <= MOVED):
            best, how = other, "wrapped on a grid"
    if best is None:
        return vertices, faces, 0.0
    done.append(f"{len(crossed)} triangles crossed, {how}")
    return *best, abs(_volume(*best) / volume - 1) if volume > 0 else np.inf


def _one_solid(
    vertices: FloatArray, faces: IntArray, done: list[str]
) -> tuple[FloatArray, IntArray]:
    """Bodies that overlap, touch or lie in each other as one solid."""
    parts = len(np.unique(bodies_of(faces)))
    if manifold_is_installed():
        v, f = united(vertices, faces)
        how = "united"
    else:
        v, f = _wrapped(vertices, faces)
        how = "wrapped on a grid, since manifold3d is not installed"
    done.append(f"{parts} parts that overlap or touch {how}")
    return v, f


def _wrapped(vertices: FloatArray, faces: IntArray) -> tuple[FloatArray, IntArray]:
    """Wrapped, with edges of two triangles each and without crossings, as far as can be had."""
    v, f = vertices, faces
    for cells in WRAP_CELLS:
        v, f = with_paired_edges(*wrapped(vertices, faces, cells), 0.0, [])
        v, f = without_crossings(v, f, rounds=WRAP_ROUNDS) or (v, f)
        if not faults_of(v, f) and deviation((vertices, faces), (v, f)) <= MOVED:
            break
    return v, f
