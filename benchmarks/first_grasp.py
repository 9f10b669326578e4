"""CPU time from nothing to the first grasp, in a process of its own with an empty cache.

What is timed begins after the import: hand and object are loaded, the object is prepared, the grasp
problem is built, and attempts are made until one is found.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from dataclasses import asdict
from tempfile import TemporaryDirectory

from benchmarks.requests import Request, Setting, outcome_of
from planner.errors import TaskError
from planner.system.disk_cache import CACHE_VARIABLE


def first_grasp_s(request: Request) -> float | None:
    """CPU time (s) of a request in a new process; None where it finds no grasp.

    Args:
        request: What is wanted.

    Raises:
        TaskError: The process failed.
    """
    asked = json.dumps(asdict(request))
    with TemporaryDirectory(prefix="opposable-") as cold:
        done = subprocess.run(
            [sys.executable, "-m", "benchmarks.first_grasp", asked],
            capture_output=True,
            text=True,
            check=False,
            env=os.environ | {CACHE_VARIABLE: cold},
        )
    if done.returncode != 0:
        last = done.stderr.strip().splitlines()[-1:]
        raise TaskError(f"the time to the first grasp could not be measured: {''.join(last)}")
    taken = json.loads(done.stdout.splitlines()[-1])
    return None if taken is None else float(taken)


def _measured(asked: str) -> float | None:
    """CPU time (s) of the request that a text holds, in this process."""
    values = json.loads(asked)
    setting = values.pop("setting")
    fingers = setting.pop("fingers")
    setting = Setting(**setting, fingers=None if fingers is None else tuple(fingers))
    begin = time.process_time()
    outcome = outcome_of(Request(**values, setting=setting), compiled=False)
    taken = time.process_time() - begin
    return taken if outcome.found else None


if __name__ == "__main__":
    print(json.dumps(_measured(sys.argv[1])))
