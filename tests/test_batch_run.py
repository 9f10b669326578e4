"""Batches in several processes: the same rows whatever happens to those."""

from __future__ import annotations

import gc
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any
from weakref import finalize

import joblib
import numpy as np
import pytest
from joblib.externals.loky import get_reusable_executor

from planner.batch import BatchProgress, GraspFeatures, GraspSet, plan_grasps, pool
from planner.batch.pool import BatchObject, Job, can_fork, finished, planned_rows
from planner.batch.rows import failed_row
from planner.errors import TaskError
from planner.files import read_plan, write_plan
from planner.hands.hand import Hand
from planner.numerics.kernels import compiled_searches
from planner.search.grasp import plan_grasp
from planner.task import GraspTask

pytestmark = pytest.mark.slow

pa = pytest.importorskip("pyarrow")

N = 8
"""Grasps of the batch that all of these tests plan."""

SOME, MANY = 12, 600
"""Grasps of a batch that loses a worker, and of one that is interrupted: of that only as many are
planned as the tests look at."""

TIMES = ("cpu_s", "build_s")
"""Columns that differ from run to run."""


def batch(out: Path | None = None, **options: Any) -> GraspSet:
    """The batch that all of these tests plan."""
    return plan_grasps("allegro_hand", ["sphere"], N, out=out, seed=3, **options)


def rows_of(grasps: GraspSet) -> list[dict[str, Any]]:
    """Rows without times."""
    table: list[dict[str, Any]] = grasps.table().drop_columns(list(TIMES)).to_pylist()
    return table


def gone_on(out: Path) -> GraspSet:
    """The interrupted batch, gone on with until the first N grasps are there."""
    before = {row["k"]: row for row in GraspSet(out)}
    told: list[BatchProgress] = []

    def stop(now: BatchProgress) -> None:
        told.append(now)
        if now.done >= len(before) + N:  # those that were missing come in order
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        plan_grasps("allegro_hand", ["sphere"], MANY, out=out, seed=3, workers=1, progress=stop)
    assert told[0].kept == len(before)
    done = GraspSet(out)
    assert {row["k"]: row for row in done if row["k"] in before} == before
    return done


@pytest.fixture(scope="module")
def reference() -> GraspSet:
    """Planned by this process alone."""
    return batch(workers=1)


def make_ready(backend: str) -> None:
    """End what loky's workers of an earlier test are watched by: a process with threads forks none.

    Skips the test where there is no such thing as a fork.
    """
    if backend == "fork":
        get_reusable_executor().shutdown(wait=True, kill_workers=True)
        if not can_fork():
            pytest.skip("another thread runs Python")


def fake_jobs(n: int) -> Iterator[Job]:
    """Requests that need no hand."""
    for i in range(n):
        item = BatchObject(label="thing", recipe="", key="")
        yield Job(index=i, object=item, k=i, seed=i, max_attempts=1, options=None, parent=-1)


def test_rows_are_in_order_and_whole(reference: GraspSet) -> None:
    assert reference.complete
    assert [r["k"] for r in reference] == list(range(N))
    assert reference.labels == ("sphere:0.035",)
    row = reference[2]
    assert row["found"]
    assert np.shape(row["q_rad"]) == np.shape(row["joint_torques_N_m"]) == (16,)
    assert np.shape(row["contact_positions_object_m"]) == (4, 3)
    # the contacts are on the sphere, normals into it, forces in the cones and balancing weight
    points = np.array(row["contact_positions_object_m"])
    normals = np.array(row["contact_normals_object"])
    forces = np.array(row["contact_forces_object_N"])
    assert normals == pytest.approx(-points / 0.035, abs=1e-9)
    pressing = np.einsum("nd,nd->n", normals, forces)
    assert (pressing > 1.49).all()
    sliding = np.linalg.norm(forces - pressing[:, None] * normals, axis=1)
    assert (sliding <= 0.5 * pressing + 1e-6).all()
    assert forces.sum(axis=0) == pytest.approx([0, 0, 0.1 * 9.81], abs=1e-3)
    assert 0 < row["epsilon"] < 1
    assert 0 < row["min_weight"] <= 1


def test_a_row_turns_back_into_its_plan(reference: GraspSet, tmp_path: Path) -> None:
    row, plan = reference[4], reference.plan(4)
    with compiled_searches():
        direct = plan_grasp(GraspTask.create("allegro_hand", "sphere"), seed=row["seed"])
    assert plan.q == pytest.approx(direct.q, abs=1e-12)
    assert plan.T_world_base.homogeneous == pytest.approx(
        direct.T_world_base.homogeneous, abs=1e-12
    )
    assert plan.contacts.forces == pytest.approx(direct.contacts.forces, abs=1e-4)
    assert (plan.record.seed, plan.record.attempt) == (row["seed"], row["attempts"] - 1)
    write_plan(plan, tmp_path / "plan.json")
    assert read_plan(tmp_path / "plan.json").q == pytest.approx(plan.q)


def test_the_files_are_plain_parquet(reference: GraspSet) -> None:
    import pyarrow.parquet as pq

    table = pq.read_table(reference.folder / "grasps")
    assert table.num_rows == N
    assert table.schema.metadata[b"joint_names"].decode().split(",")[0] == "index_0"
    assert b"w, x, y, z" in table.schema.field("base_quaternion_object_wxyz").metadata.values()
    pandas = pytest.importorskip("pandas")
    frame = pandas.read_parquet(reference.folder / "grasps")
    assert frame["q_rad"][0].shape == (16,)
    assert frame["found"].all()


def test_features_of_rows_are_those_of_plans(reference: GraspSet) -> None:
    stored = reference.features("sphere:0.035", most=2)
    planned = GraspFeatures.of_plans([reference.plan(0), reference.plan(1)])
    for name in GraspFeatures.__dataclass_fields__:
        assert getattr(stored, name) == pytest.approx(getattr(planned, name), abs=1e-9), name


def test_thinned_rows_are_some_of_those_found(reference: GraspSet) -> None:
    kept = reference.thinned("sphere:0.035")
    assert set(kept) <= set(range(N))
    assert len(kept) == reference.diversity("sphere:0.035").n_distinct


# in an order in which loky's workers, who import everything, do more than one test
@pytest.mark.parametrize(("workers", "backend"), [(2, "fork"), (2, "threading"), (2, "loky")])
def test_workers_make_no_difference(reference: GraspSet, workers: int, backend: str) -> None:
    make_ready(backend)
    assert rows_of(batch(workers=workers, backend=backend)) == rows_of(reference)


def test_neither_does_what_else_is_in_the_batch(reference: GraspSet) -> None:
    both = plan_grasps("allegro_hand", ["sphere:0.2", "sphere"], 2, seed=3, workers=1)
    assert [r["found"] for r in both] == [False, False, True, True]
    assert "too large" in both[0]["reason"]
    assert rows_of(both)[2:] == rows_of(reference)[:2]


def test_a_batch_goes_on_where_it_was_interrupted(reference: GraspSet, tmp_path: Path) -> None:
    told: list[BatchProgress] = []

    def stop(now: BatchProgress) -> None:
        told.append(now)
        if now.done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        batch(tmp_path, workers=1, progress=stop)
    before = GraspSet(tmp_path).table().to_pylist()
    assert len(before) == 3
    told.clear()
    done = batch(tmp_path, workers=1, progress=told.append)
    assert (told[0].done, told[0].kept, told[-1].done, told[-1].found) == (3, 3, N, N - 3)
    assert told[-1].rate > 0
    assert done.table().to_pylist()[:3] == before  # times and all: nothing was planned again
    assert rows_of(done) == rows_of(reference)
    again = batch(tmp_path, workers=1, progress=told.append)
    assert told[-1].kept == N
    assert again.table().equals(done.table())


@pytest.mark.parametrize("backend", ["loky", "fork"])
def test_a_killed_worker_costs_nothing_but_time(reference: GraspSet, backend: str) -> None:
    make_ready(backend)
    killed: list[int] = []

    def kill(now: BatchProgress) -> None:
        if now.done >= 3 and not killed:
            victim = multiprocessing.active_children()[0].pid
            assert victim is not None
            os.kill(victim, signal.SIGKILL)
            killed.append(victim)

    asked: dict[str, Any] = {"seed": 3, "workers": 2, "backend": backend, "progress": kill}
    rows = rows_of(plan_grasps("allegro_hand", ["sphere"], SOME, **asked))
    assert rows[:N] == rows_of(reference)
    assert [row["k"] for row in rows] == list(range(SOME))
    assert killed


@pytest.mark.parametrize("backend", ["fork", "loky"])
def test_a_request_that_kills_its_worker_is_found_out(
    monkeypatch: pytest.MonkeyPatch, backend: str
) -> None:
    make_ready(backend)
    if backend == "loky":  # to start fewer processes
        monkeypatch.setattr(pool, "DEATHS_ALONE", 1)

    def deadly(job: Job) -> dict[str, Any]:
        if job.index == 4:
            os.kill(os.getpid(), signal.SIGKILL)
        return failed_row(job.index, job.object.label, job.k, job.seed, "harmless", ())

    monkeypatch.setattr(pool, "plan_row", deadly)
    rows = sorted(planned_rows(fake_jobs(12), 2, backend), key=lambda row: int(row["index"]))
    assert [row["index"] for row in rows] == list(range(12))
    times = 1 + pool.DEATHS_ALONE
    assert {row["index"]: row["reason"] for row in rows if row["reason"] != "harmless"} == {
        4: f"its process died {times} times, killed or by a fault in a library"
    }


def test_a_backend_without_a_stream_of_results_works_too(monkeypatch: pytest.MonkeyPatch) -> None:
    # as Ray's backend is: its results come by the list
    from joblib import register_parallel_backend
    from joblib._parallel_backends import ThreadingBackend

    class Lists(ThreadingBackend):  # type: ignore[misc]
        supports_return_generator = False

    register_parallel_backend("lists", Lists)

    def quick(job: Job) -> dict[str, Any]:
        return failed_row(job.index, job.object.label, job.k, job.seed, "", ())

    monkeypatch.setattr(pool, "plan_row", quick)
    rows = list(planned_rows(fake_jobs(21), 2, "lists"))
    assert sorted(row["index"] for row in rows) == list(range(21))


def started(out: Path) -> subprocess.Popen[str]:
    """The batch in a process group of its own, by the command line."""
    words = f"batch allegro_hand sphere -n {MANY} --seed 3 --workers 2".split()
    code = f"from sim.cli import main; main({[*words, '--out', str(out)]!r})"
    return subprocess.Popen(
        [sys.executable, "-c", code], start_new_session=True, stderr=subprocess.PIPE, text=True
    )


def wait_for(condition: Callable[[], bool], what: str) -> None:
    """Wait for something to happen, however busy the machine is; ten minutes are a hang."""
    for _ in range(30_000):
        if condition():
            return
        time.sleep(0.02)
    pytest.fail(f"waited ten minutes for {what}")


def lines_in(folder: Path) -> int:
    """Rows in the journal."""
    path = folder / "journal.jsonl"
    return len(path.read_text(encoding="utf-8").splitlines()) if path.exists() else 0


def members(group: int) -> list[int]:
    """Live processes of a process group."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text(encoding="utf-8").rpartition(")")[2].split()
        except OSError:
            continue  # it ended meanwhile
        if int(fields[2]) == group and fields[0] != "Z":
            found.append(int(stat.parent.name))
    return found


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes in /proc")
def test_a_killed_parent_leaves_what_was_planned(reference: GraspSet, tmp_path: Path) -> None:
    with started(tmp_path) as process:
        wait_for(lambda: lines_in(tmp_path) >= 2, "two grasps")
        os.kill(process.pid, signal.SIGKILL)
    wait_for(lambda: not members(process.pid), "the workers to end by themselves")
    before = {row["k"]: row for row in GraspSet(tmp_path)}
    assert 2 <= len(before) < MANY
    rows = sorted(rows_of(gone_on(tmp_path)), key=lambda row: int(row["k"]))
    assert rows[:N] == rows_of(reference)


STUCK = """
import ctypes, os, sys, time
from pathlib import Path
from planner.batch.pool import end_with, finished

folder, backend, parent = Path(sys.argv[1]), sys.argv[2], os.getpid()

def work(job):
    if backend == "loky":
        end_with(parent)  # as every job of ours does there
    (folder / f"{job}").touch()
    # a library that keeps Python's lock stops threads of Python, not the kernel
    ctypes.PyDLL(None).sleep(120) if backend == "fork" else time.sleep(120)

list(finished(work, range(2), workers=2, backend=backend, given_up=lambda job, why: None))
"""


@pytest.mark.skipif(not can_fork(), reason="forks, and looks for processes in /proc")
@pytest.mark.parametrize("backend", ["fork", "loky"])
def test_no_worker_outlives_its_parent_whatever_it_is_busy_with(
    tmp_path: Path, backend: str
) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", STUCK, str(tmp_path), backend], start_new_session=True
    ) as process:
        try:
            wait_for(
                lambda: len(list(tmp_path.iterdir())) == 2 or process.poll() is not None,
                "two busy workers",
            )
            assert process.poll() is None, "it ended before its workers were busy"
            process.kill()
            process.wait()
            wait_for(lambda: not members(process.pid), "the workers to end")
        finally:
            for pid in members(process.pid):
                os.kill(pid, signal.SIGKILL)


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes in /proc")
def test_ctrl_c_keeps_what_was_planned(reference: GraspSet, tmp_path: Path) -> None:
    with started(tmp_path) as process:
        wait_for(lambda: lines_in(tmp_path) >= 2, "two grasps")
        os.killpg(process.pid, signal.SIGINT)  # a terminal interrupts workers, too
        _, message = process.communicate(timeout=600)
    assert process.returncode == 130
    before = {row["k"]: row for row in GraspSet(tmp_path)}
    assert f"{len(before)} grasps are kept" in message
    assert "Traceback" not in message
    rows = sorted(rows_of(gone_on(tmp_path)), key=lambda row: int(row["k"]))
    assert rows[:N] == rows_of(reference)
    wait_for(lambda: not members(process.pid), "the workers to end")


@pytest.mark.filterwarnings("ignore:.*tasks which were still being processed:UserWarning")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")  # loky's own
@pytest.mark.parametrize("backend", ["fork", "loky"])
def test_ctrl_c_while_workers_are_begun_or_sent_jobs_is_heard(
    backend: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_ready(backend)
    where = (ProcessPoolExecutor, "submit") if backend == "fork" else (joblib.Parallel, "__call__")
    begin, pressed = getattr(*where), list[int]()

    def interrupted(*arguments: Any, **options: Any) -> Any:
        begun = begin(*arguments, **options)
        if not pressed:
            pressed.append(os.getpid())
            os.kill(os.getpid(), signal.SIGINT)
        return begun

    monkeypatch.setattr(where[0], where[1], interrupted)
    rows = finished(abs, range(50), workers=2, backend=backend, given_up=lambda job, why: 0)
    with pytest.raises(KeyboardInterrupt):
        list(rows)
    assert pressed == [os.getpid()]
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def test_bad_requests_are_refused(allegro: Hand) -> None:
    task = GraspTask.create("shadow_hand", "sphere")
    for arguments, message in (
        (dict(objects=[]), "no objects"),
        (dict(objects="sphere"), "give a list"),
        (dict(objects=["sphere", "sphere:0.035"]), "two objects are called"),
        (dict(objects=[task]), "another hand"),
        (dict(n=0), "n is 0"),
        (dict(seed=-1), "seed is -1"),
        (dict(max_attempts=0), "max_attempts is 0"),
        (dict(workers=0), "workers is 0"),
        (dict(backend="lokky"), "cannot use the backend 'lokky'"),
    ):
        given: dict[str, Any] = {"objects": ["sphere"], "n": 1} | arguments
        with pytest.raises(TaskError, match=message):
            plan_grasps(allegro, given.pop("objects"), given.pop("n"), **given)


def test_copies_send_functions_without_a_name_too() -> None:
    """As the controllers of a protocol are, where a lambda makes them."""
    jobs: list[Callable[[int], int]] = [partial(lambda k, x: k + x, k) for k in range(5)]
    done = finished(_curried, jobs, workers=2, backend="fork", given_up=lambda job, why: job)
    assert sorted(made(10) for made in done) == [11, 12, 13, 14, 15]


def _curried(job: Callable[[int], int]) -> Callable[[int], int]:
    return lambda x: job(x) + 1


@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks are a matter of POSIX")
def test_a_fork_that_ends_leaves_the_grasps_of_its_parent(allegro: Hand) -> None:
    grasps = plan_grasps(allegro, ["sphere"], 1, workers=1)
    folder = grasps.folder
    at_exit: Any = finalize
    child = multiprocessing.get_context("fork").Process(target=at_exit._exitfunc)
    child.start()
    child.join()
    assert folder.is_dir()
    del grasps
    gc.collect()
    assert not folder.exists()
