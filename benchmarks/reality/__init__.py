"""``bench reality``: the same trials under each reality, by each loop, counted with intervals.

``tasks``  what is tried: holds, turns, holds under pushes; add one with ``register_task``
``loops``  what drives the hand and what it is told; add a column with ``register_loop``
``run``    the trials, a row each, in a file that goes on where it ended
``table``  what the rows come to
"""

from __future__ import annotations

from benchmarks.reality.loops import LOOPS, Loop, register_loop
from benchmarks.reality.run import run_reality
from benchmarks.reality.table import reality_tables
from benchmarks.reality.tasks import TASKS, register_task

__all__ = [
    "LOOPS",
    "TASKS",
    "Loop",
    "reality_tables",
    "register_loop",
    "register_task",
    "run_reality",
]
