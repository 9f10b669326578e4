"""The loops of the closed loop give what NumPy gives."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from planner.spatial import contact_frames
from sim.contacts.pads import pad_means
from sim.controllers.holding_loops import tips_moved, torques_for
from sim.controllers.monitors import follow_sliding

N, NV = 4, 16


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(5)


def frames_of(rng: np.random.Generator, n: int = N) -> np.ndarray:
    normals = rng.normal(size=(n, 3))
    return contact_frames(normals / np.linalg.norm(normals, axis=1)[:, None])


def both(kernel: Any, given: tuple[Any, ...]) -> Iterator[tuple[Any, tuple[Any, ...]]]:
    """Answer and arguments, as they are afterwards, of the loops and of NumPy."""
    for form in (kernel.loops, kernel.plain, kernel):
        mine = tuple(a.copy() if isinstance(a, np.ndarray) else a for a in given)
        yield form(*mine), mine


def agree(kernel: Any, *given: Any, tol: float = 1e-12) -> Any:
    """The answer of both forms, which must agree in it and in all that they write."""
    forms = list(both(kernel, given))
    for answer, after in forms[1:]:
        np.testing.assert_allclose(answer, forms[0][0], rtol=tol, atol=tol)
        for one, other in zip(after, forms[0][1], strict=True):
            np.testing.assert_allclose(one, other, rtol=tol, atol=tol)
    return forms[0]


@pytest.mark.parametrize("count", [4, 2])
def test_fingertips_that_move_like_a_body(rng: np.random.Generator, count: int) -> None:
    holding = np.arange(N) < count
    moved_by = np.repeat(np.eye(N, dtype=bool), NV // N, axis=1)
    arrays = rng.normal(size=(6, NV)), moved_by, 0.05 * rng.normal(size=(N, 3))
    room = np.zeros((N, 3, NV)), np.zeros((N, 3)), np.zeros((N, 3))
    v, apart = rng.normal(size=NV), 1e-3 * rng.normal(size=(N, 3))
    given = (*arrays, 0.05 * rng.normal(size=3), holding, v, apart, 150.0, *room)
    # where few hold, only RANK_TOL fixes the rest
    agree(tips_moved, *given, tol=1e-9 if count == N else 1e-6)


@pytest.mark.parametrize("holding", [(1, 1, 1, 1), (1, 0, 1, 0)])
def test_torques_of_forces_and_posture(rng: np.random.Generator, holding: tuple[int, ...]) -> None:
    own = np.repeat(np.eye(N, dtype=bool), NV // N, axis=1)
    jacobians = rng.normal(size=(N, 3, NV)) * own[:, None]
    holds, searching = np.array(holding, dtype=bool), np.array([False, False, False, True])
    forces, normals, spring, apart, velocity = rng.normal(size=(5, N, 3))
    bent, rates, stiffness, damping, torque = rng.normal(size=(5, NV))
    at_tips = (forces, normals, holds, searching, spring, apart, velocity)
    of_joints = (bent, rates, stiffness, damping, torque)
    given, _ = agree(torques_for, *at_tips, jacobians, own, *of_joints, tol=1e-9)
    pushes = np.where(holds[:, None], forces + spring, 0.0)
    if not holds[1]:  # the second finger leaves, the fourth searches
        pushes[1] = 100.0 * (apart[1] - 0.01 * normals[1]) - 15.0 * velocity[1]
        pushes[3] = 0.5 * normals[3] - 15.0 * velocity[3]
    posture = given - pushes.ravel() @ jacobians.reshape(-1, NV) - torque
    posture += damping * rates - stiffness * bent
    pressing = np.linalg.lstsq(jacobians.reshape(-1, NV).T, posture, rcond=None)[0]
    assert np.abs(pressing).max() < 1e-6


def test_slips_are_followed_alike(rng: np.random.Generator) -> None:
    pads = rng.uniform(0.0, 0.1, size=N), rng.normal(0.0, 0.01, size=(N, 3))
    state = 0.01 * rng.normal(size=(N, 3)), 0.01 * rng.uniform(size=N), np.zeros((2, N))
    since, slipping = rng.uniform(0.0, 0.02, size=(2, N)), rng.uniform(size=(2, N)) < 0.5
    for spin in (rng.normal(size=N), np.ones(1)):
        begins, _ = agree(follow_sliding, 0.002, *pads, spin, *state, since, slipping)
        assert begins.any() and not begins.all()


@pytest.mark.parametrize("pyramids", [False, True])
def test_pads_feel_the_same_to_the_last_bit(rng: np.random.Generator, pyramids: bool) -> None:
    k, bodies, geoms = 7, 5, 9
    is_object = np.arange(geoms) == 8
    finger = np.array([0, 0, 1, 1, 2, -1, -1, 3, -1])
    pairs = np.array([[0, 8], [8, 1], [2, 8], [2, 3], [8, 4], [8, 5], [0, 8]], dtype=np.int32)
    dims = np.array([3, 4, 3, 3, 6, 3, 1], dtype=np.int32)
    size = np.where(dims == 1, 1, 2 * (dims - 1)) if pyramids else dims
    addresses = (np.cumsum(size) - size).astype(np.int32)
    addresses[3] = -1
    frames = frames_of(rng, k).transpose(0, 2, 1).reshape(k, 9).copy()
    given = (
        pairs,
        rng.normal(size=(k, 3)),
        frames,
        addresses,
        dims,
        rng.random((k, 5)),
        np.abs(rng.normal(size=int(size.sum()))),
        pyramids,
        rng.normal(size=(bodies, 6)),
        rng.normal(size=(bodies, 3)),
        rng.normal(size=(bodies, 3)),
        finger,
        is_object,
        np.arange(geoms, dtype=np.int32) % bodies,
        np.zeros(bodies, dtype=np.int32),
        4,
        N,
    )
    first, *others = (answer for answer, _ in both(pad_means, given))
    assert (first[:3, 0] > 0.0).all()
    assert first[3, 0] == 0.0
    assert np.isnan(first[3, 4:13]).all()
    for other in others:
        np.testing.assert_array_equal(other, first)
