"""The short form of the fuzzer: ``python -m tests.fuzz`` is the long one."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[1]

EACH, DEAR = 8, 2
"""Inputs per class, and of those that take seconds each; ``python -m tests.fuzz`` takes more."""


def fuzz(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "tests.fuzz", "--failures", str(folder / "f"), *arguments]
    # loops are not compiled: each case would load them anew
    environment = os.environ | {"OPPOSABLE_COMPILE": "0"}
    return subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=600, check=False
    )


def test_hostile_inputs_get_an_answer_or_a_named_error(tmp_path: Path) -> None:
    done = fuzz("-n", str(EACH), "--dear", str(DEAR), "--seed", "7", folder=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    rows = [line.split() for line in done.stdout.splitlines() if line and line[0] != " "]
    counts = {row[0]: [int(cell) for cell in row[1:6]] for row in rows if row[0] != "class"}
    classes = sorted(path.stem for path in (ROOT / "tests/fuzz/classes").glob("[a-z]*.py"))
    assert sorted(counts) == classes
    assert all(sum(good) == inputs >= DEAR for inputs, *good in counts.values())
    assert sum(inputs == EACH for inputs, *_ in counts.values()) == len(classes) - 2


FAULTS = {
    "raw": "raise ValueError('raw')",
    "crash": "import os; os.kill(os.getpid(), 11)",
    "memory": "block = bytearray(5 * 2**28); block[::4096] = b'x' * len(block[::4096])",
    "litter": "open('MUJOCO_LOG.TXT', 'w').close()",
    "named": "from planner.errors import TaskError; raise TaskError('named')",
    "usage": "raise SystemExit(2)",
    "ok": "pass",
}


def test_every_fault_is_seen(tmp_path: Path) -> None:
    program = f"""
import json, sys
sys.path.insert(0, {str(ROOT)!r})
import types
from tests.fuzz import harness
harness.MEMORY = 2**30  # a quarter of what it is, which would take seconds to be filled
harness.Samples.make = lambda self: None
faults = {list(FAULTS.values())!r}
for number, fault in enumerate(faults):
    made = types.ModuleType(f"tests.fuzz.classes.planted{{number}}")
    made.case = lambda rng, samples, fault=fault: (lambda: exec(fault))
    sys.modules[made.__name__] = made
with harness.Harness(0) as running:
    cases = [(f"planted{{number}}", 0) for number in range(len(faults))]
    print(json.dumps([outcome.verdict for outcome in running.run(cases)]))
"""
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=200, check=False,
        cwd=tmp_path,
    )  # fmt: skip
    assert json.loads(done.stdout.splitlines()[-1]) == list(FAULTS), done.stderr
