"""The same batch on a Dask cluster and on Ray, also where a worker process is killed in between."""

from __future__ import annotations

import importlib
import os
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from threading import Thread
from typing import Any

import pytest

from planner.batch import GraspSet, plan_grasps

pytestmark = [
    pytest.mark.slow,
    # both libraries warn about ports, sockets and options of their own
    pytest.mark.filterwarnings("ignore"),
]

pytest.importorskip("pyarrow")

N = 4
"""Grasps of the batch. After a death, each that was in flight has a new pool to itself: 10 s."""

TIMES = ("cpu_s", "build_s")
"""Columns that differ from run to run."""

AT_WORK = 0.6
"""CPU seconds after which a worker has a request in hand: its first begins with the imports."""

Workers = Callable[[], list[int]]
"""Process ids of the workers that live."""


@contextmanager
def dask_cluster() -> Iterator[Workers]:
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        started = list(client.run(os.getpid).values())
        yield lambda: started


@contextmanager
def ray_cluster() -> Iterator[Workers]:
    ray = pytest.importorskip("ray", reason="Ray is large and not in the extra ci: run it by hand")
    register: Any = importlib.import_module("ray.util.joblib")
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, logging_level="ERROR")
    try:
        register.register_ray()
        yield ray_workers
    finally:
        ray.shutdown()


def ray_workers() -> list[int]:
    """Descendants of this process that run the pool's actors."""
    out = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            title = (folder / "cmdline").read_bytes()
        except OSError:  # it has ended
            continue
        if b"ray::" in title and b"PoolActor" in title:
            out.append(int(folder.name))
    return out


CLUSTERS: dict[str, Callable[[], AbstractContextManager[Workers]]] = {
    "dask": dask_cluster,
    "ray": ray_cluster,
}


def batch(out: Path | None = None, **options: Any) -> GraspSet:
    return plan_grasps("allegro_hand", ["sphere"], N, out=out, seed=3, **options)


def rows_of(grasps: GraspSet) -> list[dict[str, Any]]:
    table: list[dict[str, Any]] = grasps.table().drop_columns(list(TIMES)).to_pylist()
    return table


@pytest.fixture(scope="module")
def reference() -> GraspSet:
    """Planned by this process alone."""
    return batch(workers=1)


@pytest.mark.skipif(not Path("/proc/self/cmdline").exists(), reason="looks for workers in /proc")
@pytest.mark.parametrize("backend", CLUSTERS)
def test_a_cluster_gives_the_same_rows_though_a_worker_is_killed(
    reference: GraspSet, backend: str, tmp_path: Path
) -> None:
    killed: list[int] = []
    with CLUSTERS[backend]() as workers:
        killer = Thread(target=kill_one_at_work, args=(workers, killed), daemon=True)
        killer.start()
        grasps = batch(tmp_path, workers=2, backend=backend)
    assert len(killed) == 1
    counts = Counter(grasps.table(["k"])["k"].to_pylist())
    assert counts == dict.fromkeys(range(N), 1)  # all are there, none twice
    assert rows_of(grasps) == rows_of(reference)


def kill_one_at_work(workers: Workers, killed: list[int]) -> None:
    """Kill a worker that has used ``AT_WORK`` seconds of CPU since it was first seen."""
    before: dict[int, float] = {}
    while not killed:
        time.sleep(0.05)
        for pid in workers():
            spent = cpu_seconds(pid)
            if spent - before.setdefault(pid, spent) > AT_WORK:
                killed.append(pid)
                os.kill(pid, signal.SIGKILL)
                return


def cpu_seconds(pid: int) -> float:
    """CPU time (s) of a process; 0 if it has ended."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
