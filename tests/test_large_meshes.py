"""Scans of hundreds of thousands of triangles: accepted, judged rightly, and in little time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from conftest import calls_in

from planner.shapes import Mesh
from planner.shapes.meshes import soundness
from planner.shapes.meshes.io import read_mesh
from planner.shapes.meshes.soundness import crossing_pairs, faults_of, near_pairs, overlapping_boxes
from planner.system.disk_cache import CACHE_VARIABLE

RING, TUBE = 0.04, 0.015


def torus(major: int, minor: int) -> trimesh.Trimesh:
    return trimesh.creation.torus(RING, TUBE, major_sections=major, minor_sections=minor)


@pytest.mark.slow
def test_200_000_triangles_are_read_and_checked_in_seconds(tmp_path: Path) -> None:
    torus(400, 250).export(tmp_path / "ring.ply")
    found: list[object] = []

    def read() -> None:
        vertices, faces = read_mesh(tmp_path / "ring.ply", 1.0)
        found.extend((len(faces), faults_of(vertices, faces)))

    calls = calls_in(read)
    assert found == [200_000, ()]
    # 0.8 s where nothing else runs; nine times that in the version that looked triangle by triangle
    assert calls < 20_000, calls


def test_one_crossing_among_200_000_triangles_is_found() -> None:
    made = torus(400, 250)
    vertices = np.array(made.vertices)
    vertices[1234] -= 2.02 * TUBE * np.array(made.vertex_normals[1234])
    (fault,) = faults_of(vertices, np.array(made.faces))
    assert "passes through itself" in fault.what


@pytest.mark.slow
def test_as_many_triangles_as_are_allowed_are_accepted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A quarter of the million of the package, for which everything takes four times as long."""
    assert soundness.MOST_TRIANGLES == 1_000_000
    monkeypatch.setattr(soundness, "MOST_TRIANGLES", 250_000)
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    torus(500, 250).export(tmp_path / "fine.ply")
    mesh = Mesh.load(tmp_path / "fine.ply")
    assert len(mesh.faces) == 250_000 and mesh.mended == ""
    # its sections are polygons, of so much of a circle's area
    polygons = np.prod([n / (2 * np.pi) * np.sin(2 * np.pi / n) for n in (500, 250)])
    assert mesh.volume == pytest.approx(2 * np.pi**2 * RING * TUBE**2 * polygons, rel=1e-6)
    spin = RING**2 + 0.75 * TUBE**2  # of a solid torus about its axis, by mass
    assert mesh.inertia(0.1)[2, 2] == pytest.approx(0.1 * spin, rel=1e-4)


def test_overlapping_boxes_are_those_of_all_pairs() -> None:
    rng = np.random.default_rng(0)
    low = rng.random((300, 3))
    high = low + rng.random((300, 3)) ** 4
    one, other = overlapping_boxes(low, high)
    found = {tuple(sorted(pair)) for pair in zip(one.tolist(), other.tolist(), strict=True)}
    assert len(found) == len(one)
    i, j = np.triu_indices(300, 1)
    hit = ((low[i] <= high[j]) & (low[j] <= high[i])).all(axis=1)
    assert found == set(zip(i[hit].tolist(), j[hit].tolist(), strict=True))


@pytest.mark.parametrize("seed", range(8))
def test_the_crossings_of_a_crumpled_ball_are_those_of_all_pairs(seed: int) -> None:
    """What is left out for sharing a corner or an edge does not cross."""
    rng = np.random.default_rng(seed)
    made = trimesh.creation.icosphere(2, 0.03)
    noise = rng.normal(size=made.vertices.shape) * rng.choice([1e-3, 3e-3, 8e-3])
    vertices, faces = np.array(made.vertices) + noise, np.array(made.faces)
    corners = vertices[faces]
    fast = crossing_pairs(corners, near_pairs(vertices, faces))
    every = crossing_pairs(corners, np.triu_indices(len(faces), 1))
    pairs = [
        {tuple(sorted(pair)) for pair in zip(a.tolist(), b.tolist(), strict=True)}
        for a, b in (fast, every)
    ]
    assert pairs[0] == pairs[1]
