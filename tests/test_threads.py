"""Threads plan at once, and each plans what it plans alone, to the last bit."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from importlib import import_module
from typing import Any

import numpy as np
import pytest

from planner.certify import certify_contacts
from planner.errors import NoGraspFoundError
from planner.forces import ForceLoop, distribute_forces
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.motion import plan_motion
from planner.motion.gait import plan_gait
from planner.motion.phase import Knot
from planner.objects import parse_object
from planner.plan import GraspPlan
from planner.quality import force_closure
from planner.search.grasp import attempts, plan_grasp
from planner.system.threads import built, kept_by_thread, made_once, without_warnings
from planner.task import GraspTask
from planner.verification import force_arguments

OFTEN = 1e-6
"""Time (s) after which threads change places: as often as Python lets them."""


@pytest.fixture(autouse=True)
def often() -> Iterator[None]:
    before = sys.getswitchinterval()
    sys.setswitchinterval(OFTEN)
    yield
    sys.setswitchinterval(before)


def at_once(*works: Callable[[], Any]) -> list[Any]:
    """What these give, each in a thread of its own, all begun together."""
    begin = threading.Barrier(len(works))
    found: list[Any] = [None] * len(works)

    def run(i: int) -> None:
        begin.wait(timeout=300.0)
        try:
            found[i] = works[i]()
        except BaseException as error:
            found[i] = error

    threads = [threading.Thread(target=run, args=(i,)) for i in range(len(works))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for one in found:
        if isinstance(one, BaseException):
            raise one
    return found


def bits_of(plan: GraspPlan) -> bytes:
    """All numbers that make a plan what it is."""
    arrays = (
        plan.q,
        plan.q_pregrasp,
        plan.T_world_base.homogeneous,
        plan.T_world_base_start.homogeneous,
        plan.contacts.positions,
        plan.contacts.forces,
        plan.forces.joint_torques,
        plan.verification.pad_gaps,
    )
    return b"".join(np.ascontiguousarray(a).tobytes() for a in arrays)


def bits_of_knots(knots: tuple[Knot, ...]) -> bytes:
    return b"".join(k.q.tobytes() + k.contacts.forces.tobytes() for k in knots)


SEEDS = range(2)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hand", "objects"),
    [
        ("allegro_hand", ("cylinder:0.03x0.10", "cylinder:0.025x0.12")),
        ("shadow_hand", ("mug", "torus:0.035x0.012")),
    ],
)
def test_plans_of_threads_are_those_of_one(hand: str, objects: tuple[str, str]) -> None:
    loaded = load_hand(hand)
    alone = {
        (name, seed): bits_of(plan_grasp(GraspTask.create(loaded, name), seed=seed))
        for name in objects
        for seed in SEEDS
    }

    def work(task: GraspTask, name: str) -> Callable[[], None]:
        def plan() -> None:
            for seed in SEEDS:
                assert bits_of(plan_grasp(task, seed=seed)) == alone[name, seed]

        return plan

    tasks = [(GraspTask.create(loaded, name), name) for name in objects]
    # two objects of one kind, and two threads at one task
    at_once(*[work(*which) for which in (tasks[0], tasks[1], tasks[1])])


def test_plans_with_objectives_of_rows_of_their_own(allegro: Hand) -> None:
    from planner.synthesis.options import SynthesisOptions

    options = SynthesisOptions(objective="torque:1,robustness:0.5")
    tasks = [GraspTask.create(allegro, name) for name in ("box", "box:0.04x0.06x0.08")]
    alone = [bits_of(plan_grasp(task, seed=1, options=options)) for task in tasks]
    works = [lambda task=task: plan_grasp(task, seed=1, options=options) for task in tasks]
    assert [bits_of(plan) for plan in at_once(*works)] == alone


def test_iterators_of_attempts_may_be_mixed_and_moved(allegro: Hand) -> None:
    tasks = [GraspTask.create(allegro, name) for name in ("sphere", "sphere:0.03")]

    def outcome(attempt: Any) -> bytes:
        return str(attempt.failure).encode() if attempt.plan is None else bits_of(attempt.plan)

    def first(task: GraspTask) -> list[bytes]:
        return [outcome(a) for a, _ in zip(attempts(task, seed=3), range(4), strict=False)]

    alone = [first(task) for task in tasks]
    mixed: list[list[bytes]] = [[], []]
    running = [attempts(task, seed=3) for task in tasks]
    for k in range(4):
        for results, iterator in zip(mixed, running, strict=True):
            if k % 2:  # every other attempt in another thread than the one that began
                results.extend(at_once(partial(lambda it: outcome(next(it)), iterator)))
            else:
                results.append(outcome(next(iterator)))
    assert mixed == alone


def test_a_search_within_the_progress_of_another_changes_neither(allegro: Hand) -> None:
    # the second object is of the same kind, and its search needs more than one attempt
    outer, inner = (GraspTask.create(allegro, f"box:{s}x{s}x0.08") for s in (0.05, 0.03))
    alone = [bits_of(plan_grasp(task, seed=0)) for task in (outer, inner)]
    within: list[bytes] = []

    def nested(_: Any) -> None:
        within.append(bits_of(plan_grasp(inner, seed=0)))

    assert bits_of(plan_grasp(outer, seed=0, progress=nested)) == alone[0]
    assert set(within) == {alone[1]}


@pytest.mark.slow
def test_motions_of_threads_are_those_of_one(shadow: Hand) -> None:
    def turn(size: str, seed: int) -> bytes:
        task = GraspTask.create(shadow, size, fingers=["thumb", "index", "middle"])
        try:
            found = plan_motion(task, angle=np.deg2rad(40.0), seed=seed, max_attempts=2)
        except NoGraspFoundError as error:
            return str(error).encode()
        return bits_of(found.grasp) + bits_of_knots(found.knots)

    asked = [("cylinder:0.03x0.08", 0), ("cylinder:0.028x0.08", 1)]
    alone = [turn(*one) for one in asked]
    assert any(len(found) > 1000 for found in alone)  # some are motions
    assert at_once(*[lambda one=one: turn(*one) for one in asked]) == alone


@pytest.mark.slow
def test_gaits_of_threads_are_those_of_one(allegro: Hand) -> None:
    def turn(seed: int) -> bytes:
        task = GraspTask.create(allegro, "cylinder:0.03x0.08")
        try:
            found = plan_gait(task, angle=np.deg2rad(60.0), seed=seed, max_attempts=1)
        except NoGraspFoundError as error:
            return str(error).encode()
        return b"".join(bits_of_knots(stroke.knots) for stroke in found.strokes)

    alone = [turn(seed) for seed in range(2)]
    assert at_once(*[lambda seed=seed: turn(seed) for seed in range(2)]) == alone


@pytest.fixture(scope="module")
def two_plans(allegro: Hand) -> list[GraspPlan]:
    """Plans of the same size of force programme."""
    return [plan_grasp(GraspTask.create(allegro, name), seed=1) for name in ("box", "sphere")]


@pytest.mark.parametrize("solver", ["daqp", "osqp"])
def test_forces_and_closure_of_threads_are_those_of_one(
    two_plans: list[GraspPlan], solver: str
) -> None:
    def numbers(plan: GraspPlan) -> bytes:
        given = force_arguments(plan.task, plan.contacts, plan.T_world_base, plan.q)
        forces = distribute_forces(plan.contacts, solver=solver, **given)
        closure = force_closure(plan.contacts, edges=8)
        assert closure.weights is not None
        return forces.forces.tobytes() + closure.weights.tobytes()

    alone = [numbers(plan) for plan in two_plans]
    works = [lambda plan=plan: [numbers(plan) for _ in range(15)] for plan in two_plans]
    for found, one in zip(at_once(*works), alone, strict=True):
        assert set(found) == {one}


def test_loops_of_threads_do_not_share_a_solver(two_plans: list[GraspPlan]) -> None:
    def loop(plan: GraspPlan) -> bytes:
        made = ForceLoop(plan.contacts, solver="daqp", min_normal=0.1, max_normal=5.0)
        wrench = np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0])
        return b"".join(made.step(k / 20 * wrench).forces.tobytes() for k in range(20))

    alone = [loop(plan) for plan in two_plans]
    assert at_once(*[lambda plan=plan: loop(plan) for plan in two_plans]) == alone


@pytest.mark.slow
def test_certificates_of_threads_are_those_of_one(two_plans: list[GraspPlan]) -> None:
    def numbers(plan: GraspPlan) -> str:
        made = certify_contacts(plan.contacts, length=0.05, width=0.5, max_points=40)
        return str({k: v for k, v in made.as_dict().items() if k != "cpu_s"})

    alone = [numbers(plan) for plan in two_plans]
    assert at_once(*[lambda plan=plan: numbers(plan) for plan in two_plans]) == alone


@pytest.mark.slow
def test_a_mesh_that_threads_share_is_prepared_once(
    allegro: Hand, monkeypatch: pytest.MonkeyPatch
) -> None:
    mesh, field = (import_module(f"planner.shapes.{name}") for name in ("mesh", "mesh_field"))
    fits = [0]

    def fit(*arguments: Any, **options: Any) -> Any:
        fits[0] += 1
        return true(*arguments, **options)

    true = field.fit_mesh_field
    monkeypatch.setattr(field, "fit_mesh_field", fit)
    monkeypatch.setattr(mesh, "read_arrays", lambda *_: None)
    monkeypatch.setattr(mesh, "write_arrays", lambda *_: None)
    item = parse_object("superquadric:0.05x0.06x0.08x0.6x0.6")
    tasks = [GraspTask.create(allegro, item) for _ in range(2)]
    one, other = at_once(*[lambda t=t: bits_of(plan_grasp(t, seed=0)) for t in tasks])
    assert one == other
    assert fits == [1]


def test_what_is_made_once_is_made_by_one_thread() -> None:
    made: list[int] = []

    @made_once(4)
    def make(n: int) -> object:
        made.append(n)
        threading.Event().wait(0.02)
        return object()

    class Holder:
        @built
        def value(self) -> object:
            """Something."""
            made.append(-1)
            threading.Event().wait(0.02)
            return object()

    holder = Holder()
    assert len(set(at_once(*[lambda: make(1)] * 4))) == 1
    assert len(set(at_once(*[lambda: holder.value] * 4))) == 1
    assert made == [1, -1]


def test_what_is_kept_by_a_thread_is_its_own_and_goes_with_it() -> None:
    class Kept:
        alive = 0

        def __init__(self) -> None:
            Kept.alive += 1

        def __del__(self) -> None:
            Kept.alive -= 1

    @kept_by_thread(4)
    def make(n: int) -> Kept:
        return Kept()

    assert make(1) is make(1)
    at_once(*[lambda: make(1) is make(1) or pytest.fail("made twice")] * 3)
    gc.collect()
    assert Kept.alive == 1
    made = at_once(*[lambda: make(2)] * 2)
    assert made[0] is not made[1]


@pytest.mark.slow
def test_threads_that_build_their_first_problems_at_once() -> None:
    # in a process of its own, where nothing is built yet
    code = """
import sys, threading
sys.setswitchinterval(1e-6)
from planner import GraspTask, plan_grasp
from planner.hand_loading import load_hand
hand = load_hand("allegro_hand")
names = ("box", "sphere", "capsule", "ellipsoid")
found = {}
def work(name):
    found[name] = plan_grasp(GraspTask.create(hand, name), seed=0).q.tobytes()
threads = [threading.Thread(target=work, args=(name,)) for name in names]
[t.start() for t in threads], [t.join() for t in threads]
for name in names:
    assert plan_grasp(GraspTask.create(hand, name), seed=0).q.tobytes() == found[name], name
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=os.environ, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]


def test_threads_that_want_no_warnings_leave_them_as_they_were() -> None:
    before = list(warnings.filters)
    entered, left = threading.Event(), threading.Event()

    def first() -> None:
        with without_warnings():
            entered.set()
            left.wait(timeout=300.0)  # leaves after the second, which entered later
            warnings.warn("not heard", stacklevel=1)

    def second() -> None:
        entered.wait(timeout=300.0)
        with without_warnings():
            warnings.warn("not heard", stacklevel=1)
        left.set()

    at_once(first, second)
    assert list(warnings.filters) == before
    with pytest.warns(UserWarning, match="heard"):
        warnings.warn("heard", stacklevel=1)
