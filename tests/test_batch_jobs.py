"""Requests of a batch: their seeds, their tasks as text, and what planning one gives."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.batch import pool
from planner.batch.pool import BatchObject, Job, batch_jobs, grasp_seed, plan_row
from planner.batch.recipe import label_of, recipe_of, task_of
from planner.errors import FileFormatError, TaskError
from planner.failure import Failure
from planner.forces import ExpectedLoad
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.numerics.kernels import compiled_searches
from planner.objects import GraspObject, TouchRegion, parse_object, parse_region
from planner.plan import GraspPlan
from planner.search.grasp import Attempt, plan_grasp
from planner.shapes import Box, Mesh, Sphere, shape_key
from planner.spatial import SE3
from planner.synthesis.options import SynthesisOptions
from planner.task import GraspTask, Obstacle

SPHERE = Sphere(radius=0.035)


def job_for(task: GraspTask, *, k: int = 0, max_attempts: int = 3) -> Job:
    """A request of this process."""
    return Job(
        index=k,
        object=BatchObject.of(label_of(task), task),
        k=k,
        seed=grasp_seed(0, shape_key(task.object.shape), k),
        max_attempts=max_attempts,
        options=None,
        parent=os.getpid(),
    )


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**64), k=st.integers(0, 10**9))
def test_seeds_are_integers_that_fit_every_file(seed: int, k: int) -> None:
    value = grasp_seed(seed, shape_key(SPHERE), k)
    assert 0 <= value < 2**63
    assert value == grasp_seed(seed, shape_key(Sphere(radius=0.035)), k)


def test_seeds_of_all_grasps_differ() -> None:
    shapes = [SPHERE, Sphere(radius=0.036), Box(size=(0.05, 0.05, 0.08))]
    keys = [shape_key(shape) for shape in shapes]
    seeds = {grasp_seed(s, key, k) for s in (0, 1) for key in keys for k in range(500)}
    assert len(seeds) == 2 * 3 * 500


def test_a_mesh_has_the_same_seeds_wherever_its_file_is(tmp_path: Path) -> None:
    mesh = parse_object("mug").shape
    assert isinstance(mesh, Mesh)
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in mesh.vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in mesh.faces + 1]
    keys = []
    for name in ("here.obj", "there.obj"):
        (tmp_path / name).write_text("\n".join(lines), encoding="utf-8")
        keys.append(shape_key(Mesh.load(tmp_path / name)))
    assert keys[0] == keys[1]
    assert keys[0] != shape_key(mesh)  # the mug that is made is told by its sizes


def test_requests_are_numbered_by_object_and_grasp_and_skip_what_is_there() -> None:
    items = [BatchObject(label=name, recipe="", key=64 * name) for name in ("a", "b")]
    made = list(batch_jobs(items, 3, 9, lambda i: i not in (1, 3), 7, None))
    assert [(j.index, j.object.label, j.k) for j in made] == [
        (0, "a", 0),
        (2, "a", 2),
        (4, "b", 1),
        (5, "b", 2),
    ]
    assert [j.seed for j in made] == [grasp_seed(9, 64 * j.object.label, j.k) for j in made]


def test_a_task_survives_as_text(allegro: Hand) -> None:
    touch = TouchRegion(allowed=(parse_region("z>0.01"),), forbidden=(parse_region("x<-0.02"),))
    item = GraspObject(name="crate", shape=Box(size=(0.05, 0.05, 0.1)), mass=0.3, touch=touch)
    wall = Obstacle(
        name="wall", size=np.array([0.1, 0.01, 0.1]), T_world_obstacle=SE3(np.eye(3), np.ones(3))
    )
    T = SE3(np.eye(3), np.array([0.1, 0.2, 0.4]))
    task = GraspTask.create(
        allegro,
        item,
        mu=0.7,
        fingers=["thumb", "index", "middle"],
        obstacles=[wall],
        T_world_object=T,
        table_height=0.3,
        gravity=(0.0, 0.1, -9.0),
    )
    text = recipe_of(task)
    again = task_of(text)
    assert recipe_of(again) == text
    assert again.finger_names == ("thumb", "index", "middle")
    assert (again.mu, again.grip_force, again.table_height) == (0.7, task.grip_force, 0.3)
    assert again.object.mass == 0.3
    assert again.object.touch == touch
    assert again.T_world_object.translation.tolist() == [0.1, 0.2, 0.4]
    assert again.obstacles[0].name == "wall"
    assert task_of(text) is again


def test_a_task_of_rolling_pads_survives_as_text(allegro: Hand) -> None:
    again = task_of(recipe_of(GraspTask.create(allegro.rolling, "cylinder")))
    assert again.hand.rolls and again.hand.digest == allegro.rolling.digest
    assert not task_of(recipe_of(GraspTask.create(allegro, "cylinder"))).hand.rolls


def test_tasks_of_one_hand_share_it(allegro: Hand) -> None:
    recipes = [recipe_of(GraspTask.create(allegro, name)) for name in ("sphere", "box")]
    assert task_of(recipes[0]).hand is task_of(recipes[1]).hand


def test_a_hand_made_in_python_cannot_be_sent(allegro: Hand) -> None:
    task = GraspTask.create(replace(allegro, reference=None), "sphere")
    with pytest.raises(TaskError, match="write its model"):
        recipe_of(task)


def test_a_hand_whose_files_changed_is_refused(edit_hand: Callable[..., Path]) -> None:
    task = GraspTask.create(load_hand(edit_hand()), "sphere")
    recipe = recipe_of(task).replace(task.hand.digest, "0" * 64)
    with pytest.raises(FileFormatError, match="changed since"):
        task_of(recipe)
    with pytest.raises(FileFormatError, match="damaged"):
        task_of(recipe[:-5])


def test_labels_are_names_or_sizes(allegro: Hand) -> None:
    named = GraspObject(name="ball", shape=SPHERE)
    assert label_of(GraspTask.create(allegro, named)) == "ball"
    assert label_of(GraspTask.create(allegro, "sphere:0.035")) == "sphere:0.035"


def test_what_the_planner_refuses_is_a_row_with_its_reason(allegro: Hand) -> None:
    row = plan_row(job_for(GraspTask.create(allegro, "sphere:0.2"), k=4))
    assert not row["found"]
    assert "too large" in row["reason"]
    assert (row["index"], row["k"], row["attempts"], row["tries"]) == (4, 4, 0, [])


def test_failed_attempts_are_kept_with_their_reasons(
    allegro: Hand, monkeypatch: pytest.MonkeyPatch
) -> None:
    task = GraspTask.create(allegro, "sphere")
    # a margin of 9 cm from everything, which no grasp has
    job = replace(job_for(task, max_attempts=2), options=SynthesisOptions(clear_object=0.09))
    row = plan_row(job)
    assert not row["found"]
    assert row["attempts"] == len(row["tries"]) == 2
    assert row["reason"] == row["tries"][-1][0] != ""
    assert row["cpu_s"] == pytest.approx(sum(cpu for _, cpu in row["tries"]))


def interrupting(
    task: GraspTask, *, progress: Callable[[Attempt[GraspPlan]], None], **_: object
) -> None:
    """In place of planning: Ctrl-C while the solver runs, which goes on to the next attempt."""
    os.kill(os.getpid(), signal.SIGINT)
    for i in range(2):
        failure = Failure(kind="interrupted", text="solver: interrupted")
        progress(Attempt(index=i, plan=None, failure=failure, cpu_s=0.0))
    raise TaskError("went on after Ctrl-C")


def test_ctrl_c_ends_a_request_without_a_row(
    allegro: Hand, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pool, "plan_grasp", interrupting)
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        plan_row(job_for(GraspTask.create(allegro, "sphere")))
    assert signal.getsignal(signal.SIGINT) is before


def test_a_worker_leaves_ctrl_c_to_who_started_it(
    allegro: Hand, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pool, "plan_grasp", interrupting)
    job = replace(job_for(GraspTask.create(allegro, "sphere")), parent=-1)
    assert plan_row(job)["reason"] == "went on after Ctrl-C"


def test_threads_plan_at_once(allegro: Hand, monkeypatch: pytest.MonkeyPatch) -> None:
    together = threading.Barrier(4)

    def meets(task: GraspTask, **_: object) -> None:
        together.wait(timeout=300.0)  # breaks unless all four are here
        raise TaskError("none")

    monkeypatch.setattr(pool, "plan_grasp", meets)
    job = job_for(GraspTask.create(allegro, "sphere"))
    threads = [threading.Thread(target=plan_row, args=(job,)) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not together.broken


def test_a_request_gives_the_plan_that_plan_grasp_gives(shadow: Hand) -> None:
    # on a ball of 36 mm four fingers find no room; the sixth attempt is made with three
    task = GraspTask.create(shadow, "sphere:0.018")
    for k in range(2):
        row = plan_row(job_for(task, k=k, max_attempts=10))
        with compiled_searches():
            plan = plan_grasp(task, seed=row["seed"], max_attempts=10)
        assert row["found"]
        assert tuple(row["fingers"]) == plan.task.finger_names
        assert row["q_rad"] == plan.q.tolist()
        assert row["attempts"] == plan.record.attempts
        assert len(row["fingers"]) < len(task.finger_names)


def test_a_task_is_made_again_to_the_last_bit(allegro: Hand) -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        turn = pin.exp3(rng.normal(size=3))
        T = SE3(turn, np.array([0.1, 0.2, 0.5]))
        wall = Obstacle(name="wall", size=np.full(3, 0.1), T_world_obstacle=T)
        task = GraspTask.create(
            allegro,
            "box",
            T_world_object=T,
            obstacles=[wall],
            T_world_base=SE3(turn.T, np.ones(3)),
            expected_load=ExpectedLoad(force=3.0, torque=0.1),
            joint_error=0.05,
        )
        again = task_of(recipe_of(task))
        assert again.expected_load == task.expected_load
        assert again.joint_error == task.joint_error
        assert again.grip_force == task.grip_force
        assert (again.T_world_object.homogeneous == task.T_world_object.homogeneous).all()
        assert again.T_world_base is not None
        assert (again.T_world_base.rotation == turn.T).all()
        assert (again.obstacles[0].T_world_obstacle.rotation == turn).all()
        assert again.may_spare_fingers
