"""The loops of the closed loop give what NumPy gives, and a force loop steps alike with both."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from planner.contacts import ContactSet
from planner.errors import ContactError
from planner.forces import ForceLoop, loop_kernels, turned_frames
from planner.forces.loop_kernels import (
    AWAY_CHANGED,
    OPEN_CHANGED,
    REFUSED,
    STOPS_CHANGED,
    give_answer,
    place_points,
    press_points,
    renew_limits,
    shortfall,
    turn_onto,
)
from planner.hands.hand import Hand
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


def placed(rng: np.random.Generator) -> list[Any]:
    jacobians = rng.normal(size=(N, 3, NV)) * (rng.random((N, 1, NV)) < 0.3)
    return [
        rng.normal(size=(N, 3)),
        frames_of(rng),
        rng.normal(size=3),
        jacobians,
        0.04,
        rng.normal(size=(NV, NV)),
        np.zeros((6, 3 * N + 2)),
        np.zeros((3 * N + 2, NV)),
        np.zeros((NV, 3 * N + 2)),
        np.zeros((3 * N + 2, NV), dtype=bool),
    ]


def test_rows_of_point_contacts(rng: np.random.Generator) -> None:
    given = placed(rng)
    answer, after = agree(place_points, *given)
    assert answer == OPEN_CHANGED
    answer, _ = agree(place_points, *after)
    assert answer == 0
    table, lever = after[6], after[7]
    force = rng.normal(size=(N, 3))
    pushed = np.einsum("nij,nj->ni", given[1], force)
    np.testing.assert_allclose(table[:3, : 3 * N] @ force.ravel(), pushed.sum(axis=0))
    moments = np.cross(given[0] - given[2], pushed).sum(axis=0) / 0.04
    np.testing.assert_allclose(table[3:, : 3 * N] @ force.ravel(), moments)
    torque = np.einsum("ni,nij->j", pushed, given[3])
    np.testing.assert_allclose(force.ravel() @ lever[: 3 * N], torque)


@pytest.mark.parametrize(
    ("which", "fault"), [(0, np.nan), (1, 2.0), (1, np.nan), (2, np.inf), (3, np.nan)]
)
def test_unsound_places_are_refused(rng: np.random.Generator, which: int, fault: float) -> None:
    given = placed(rng)
    given[which].flat[0] = fault
    assert agree(place_points, *given)[0] == REFUSED


def test_left_handed_frames_are_refused(rng: np.random.Generator) -> None:
    given = placed(rng)
    given[1][2, :, 2] *= -1.0
    assert agree(place_points, *given)[0] == REFUSED


def test_limits_of_torque(rng: np.random.Generator) -> None:
    stops, extra = 3, 2
    linear = rng.normal(size=(stops + 2 * NV + extra, 2 * NV + 1))
    state = rng.normal(size=2 * NV + 1)
    active = linear[:stops] @ state <= 0.01
    ends = np.sort(rng.normal(size=(2, NV + extra)), axis=0)
    least, most = ends[:1] - np.ones((2, 1)), np.full((2, NV + extra), np.inf)
    opened = np.where(rng.random(NV) < 0.3, [[-np.inf], [np.inf]], 0.0)
    room = np.zeros((2, NV + extra)), np.zeros((2, NV))
    given = (linear, state, active, 0.01, ends, least, most, opened, *room)
    assert agree(renew_limits, *given)[0] == 0
    active[1] ^= True
    assert agree(renew_limits, *given)[0] == STOPS_CHANGED


def test_shortfall_of_an_answer(rng: np.random.Generator) -> None:
    table, x, value = rng.normal(size=(9, 5)), rng.normal(size=5), np.zeros(9)
    limits = np.array([table @ x - 1.0, table @ x + 1.0])
    assert agree(shortfall, table, limits, x, value)[0] == 0.0
    limits[1, 4] -= 1.25
    assert agree(shortfall, table, limits, x, value)[0] == pytest.approx(0.25)
    limits[0] = -np.inf
    assert agree(shortfall, table, limits, x, value)[0] == pytest.approx(0.25)
    x[2] = np.nan
    assert agree(shortfall, table, limits, x, value)[0] == np.inf


def test_bounds_on_normal_forces() -> None:
    least, most = np.array([1.0, 2.0, 3.0]), np.array([4.0, 0.0, 5.0])
    room = np.full(10, -7.0), np.full(10, 7.0), np.zeros(3, dtype=bool)
    answer, after = agree(press_points, least, most, 3, *room)
    assert answer == AWAY_CHANGED
    assert after[3][:9:3].tolist() == [1.0, 0.0, 3.0]
    assert after[4][:9:3].tolist() == [4.0, 0.0, 5.0]
    assert agree(press_points, least, most, 3, *after[3:])[0] == 0
    for bad in (np.array([-1.0, 2.0, 3.0]), np.array([np.nan] * 3), np.array([5.0, 2.0, 3.0])):
        assert agree(press_points, bad, most, 3, *room)[0] == REFUSED


def test_what_an_answer_means(rng: np.random.Generator) -> None:
    x, lever = rng.normal(size=3 * N + 2), rng.normal(size=(3 * N + 2, NV))
    rows = rng.normal(size=(3, 6))
    room = np.zeros((N, 4)), np.zeros(6), np.zeros(NV)
    agree_writing(give_answer, x, *rows, lever, rng.normal(size=NV), *room)


def agree_writing(kernel: Any, *given: Any) -> None:
    (_, first), *others = both(kernel, given)
    for _, after in others:
        for one, other in zip(after, first, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12)


def test_frames_turned_onto_normals(rng: np.random.Generator) -> None:
    frames = frames_of(rng)
    normals = frames_of(rng)[:, :, 0]
    normals[(frames[:, :, 0] * normals).sum(axis=1) < -0.8] *= -1.0
    answer, after = agree(turn_onto, frames, normals, -0.9, np.zeros((N, 3, 3)))
    assert answer
    np.testing.assert_allclose(after[3][:, :, 0], normals, atol=1e-12)
    np.testing.assert_allclose(turned_frames(frames, normals), after[3], atol=1e-12)
    assert not agree(turn_onto, frames, -frames[:, :, 0].copy(), -0.9, frames.copy())[0]


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


def step_of(loop: ForceLoop, hand: Hand, **changes: Any) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(1)
    n = len(loop.problem.contacts)
    contacts = loop.problem.contacts
    jacobians = 0.05 * rng.normal(size=(n, 3, hand.nq))
    given: dict[str, Any] = {
        "positions": contacts.positions + 1e-3,
        "frames": contacts.frames.copy(),
        "center": contacts.center,
        "jacobians": jacobians,
        "q": 0.5 * (hand.q_lower + hand.q_upper),
        "gravity_torque": 0.01 * rng.normal(size=hand.nq),
        "min_normal": np.full(n, 0.1),
        "max_normal": np.full(n, 30.0),
        "previous": np.zeros((n, 4)),
    }
    step = loop.step(np.array([0.0, 0.0, -0.5, 0.0, 0.0, 0.0]), **(given | changes))
    return step.forces.copy(), step.joint_torques.copy(), step.left_over.copy()


@pytest.fixture
def make_loop(allegro: Hand) -> Callable[[], ForceLoop]:
    angles = np.linspace(0.0, 2 * np.pi, 4, endpoint=False)
    around = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(4)])
    contacts = ContactSet.from_arrays(positions=0.03 * around, normals=-around, mu=0.8)

    def make() -> ForceLoop:
        return ForceLoop(contacts, actuation=allegro.actuation, change_cost=1.0, edge_cost=10.0)

    return make


def test_a_force_loop_steps_alike_with_and_without_loops(
    allegro: Hand, make_loop: Callable[[], ForceLoop], monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = []
    place = loop_kernels.place_points

    def counted(*given: Any) -> int:
        calls.append(given)
        return place(*given)

    monkeypatch.setattr("planner.forces.loop.place_points", counted)
    away = np.array([30.0, 30.0, 0.0, 30.0])
    stop = allegro.q_lower.copy()
    changes: list[dict[str, Any]] = [{}, {"max_normal": away}, {}, {"q": stop}, {}, {}]
    answers = []
    for by_loops in ("1", "0"):
        monkeypatch.setenv("OPPOSABLE_COMPILE", by_loops)
        loop = make_loop()
        loop._by_loops = by_loops == "1"
        answers.append([step_of(loop, allegro, **change) for change in changes])
        if by_loops == "1":
            assert len(calls) == 4  # not where other stops became active
    for quick, plain in zip(*answers, strict=True):
        for one, other in zip(quick, plain, strict=True):
            np.testing.assert_allclose(one, other, atol=1e-7)


def test_what_loops_refuse_is_an_error_and_changes_nothing(
    allegro: Hand, make_loop: Callable[[], ForceLoop]
) -> None:
    loop = make_loop()
    loop._by_loops = True
    before = step_of(loop, allegro)
    with pytest.raises(ContactError, match="rotation"):
        step_of(loop, allegro, frames=2.0 * np.tile(np.eye(3), (4, 1, 1)))
    with pytest.raises(ContactError, match="NaN"):
        step_of(loop, allegro, jacobians=np.full((4, 3, allegro.nq), np.nan))
    with pytest.raises(ContactError, match="min_normal"):
        step_of(loop, allegro, min_normal=np.full(4, 40.0))
    after = step_of(loop, allegro)
    for one, other in zip(before, after, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-7)
