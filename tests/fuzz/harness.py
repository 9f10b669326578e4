"""Cases run each in a process of its own, which is forked from one that has everything loaded.

A process that takes more than ``TIME``, ``CLOCK`` or ``MEMORY`` is ended. What it wrote goes to a
file in its folder. Folders are removed again; ``--keep`` copies those of cases that failed.
"""

from __future__ import annotations

import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Any

from typer.main import get_command

import planner
import sim
import sim.cli
from planner.errors import NoGraspFoundError, PlannerError
from planner.system.disk_cache import CACHE_VARIABLE
from sim.cli import app, main

from . import classes
from .samples import Samples

TIME, CLOCK = 60.0, 240.0
"""Seconds of processor time, and on the clock, after which a case hangs: on a busy machine the
clock tells little."""

MEMORY = 4 * 2**30
"""Bytes of resident memory that a case may take."""

POLL = 0.02
"""Seconds between two looks at a running case."""

ANSWERS = {0: "ok", 1: "no", 2: "usage", 3: "named", 4: "no"}
"""Exit codes of the command line that are answers."""

RAW, UNSOUND = 70, 71
"""Exit codes of a case that ended with an exception of another kind, and that could not be made."""

COLUMNS = ("ok", "no", "named", "usage", "raw", "crash", "hang", "memory", "litter", "unsound")
GOOD = frozenset(COLUMNS[:4])

LITTER = ("MUJOCO_LOG.TXT", "core")
"""Files that no command may leave in the current folder."""

OUTPUT = "output.txt"


def names() -> list[str]:
    """The classes of inputs: the modules in ``classes``."""
    return sorted(module.name for module in iter_modules(classes.__path__))


@dataclass
class Outcome:
    """What became of a case.

    Attributes:
        name: Of its class.
        number: Of the case.
        verdict: One of ``COLUMNS``.
        output: The end of what it wrote.
        memory: Bytes of memory at most.
        cpu_s: Processor time, s.
    """

    name: str
    number: int
    verdict: str
    output: str
    memory: int
    cpu_s: float


@dataclass
class Running:
    """A case on its way."""

    name: str
    number: int
    folder: Path
    begin: float
    ended: str = ""


@dataclass
class Harness:
    """Runs cases.

    Attributes:
        seed: Of all cases.
        workers: How many run at once.
        keep: Folder for the folders of cases that failed; None for none.
        samples: What cases are made from.
    """

    seed: int
    workers: int = 1
    keep: Path | None = None
    samples: Samples = field(init=False)
    _root: Any = field(init=False)

    def __enter__(self) -> Harness:
        """Make the samples, in a process of their own, and load what cases need."""
        self._root = tempfile.TemporaryDirectory(prefix="fuzz-")
        root = Path(self._root.name)
        os.environ[CACHE_VARIABLE] = str(root / "cache")
        self.samples = Samples(root / "samples")
        self.samples.folder.mkdir()
        child = os.fork()
        if child == 0:
            with _leaving():
                self.samples.make()
        if os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) != 0:
            raise RuntimeError("the samples could not be made: the traceback is above")
        _load()
        return self

    def __exit__(self, *_: object) -> None:
        """Remove everything."""
        self._root.cleanup()

    def run(self, cases: Sequence[tuple[str, int]]) -> Iterator[Outcome]:
        """Outcomes of cases (class, number) as they end."""
        waiting = list(reversed(cases))
        running: dict[int, Running] = {}
        while waiting or running:
            while waiting and len(running) < self.workers:
                name, number = waiting.pop()
                pid, case = self._start(name, number)
                running[pid] = case
            for pid, case in list(running.items()):
                done, status, usage = os.wait4(pid, os.WNOHANG)
                if done:
                    del running[pid]
                    yield self._outcome(pid, case, status, usage)
                elif _cpu(pid) > TIME or time.monotonic() - case.begin > CLOCK:
                    case.ended = "hang"
                elif _resident(pid) > MEMORY:
                    case.ended = "memory"
                if not done and case.ended:
                    _end(pid)
            time.sleep(POLL)

    def _start(self, name: str, number: int) -> tuple[int, Running]:
        folder = Path(tempfile.mkdtemp(dir=self._root.name))
        (folder / "here").mkdir()
        sys.stdout.flush()
        pid = os.fork()
        if pid == 0:
            _run_here(name, self.seed, number, folder, self.samples)
        return pid, Running(name, number, folder, time.monotonic())

    def _outcome(self, pid: int, case: Running, status: int, usage: Any) -> Outcome:
        _end(pid)  # what it started and left behind
        code = os.waitstatus_to_exitcode(status)
        text = (case.folder / OUTPUT).read_text(encoding="utf-8", errors="replace")
        memory = usage.ru_maxrss * 1024
        if case.ended:
            verdict = case.ended
        elif memory > MEMORY:
            verdict = "memory"
        elif code < 0:
            verdict = "crash"
        elif code == UNSOUND:
            verdict = "unsound"
        elif code not in ANSWERS or "Traceback (most recent call last)" in text:
            verdict = "raw"
        elif any((case.folder / "here" / name).exists() for name in LITTER):
            verdict = "litter"
        else:
            verdict = ANSWERS[code]
        if self.keep is not None and verdict not in GOOD:
            shutil.copytree(
                case.folder, self.keep / f"{case.name}-{self.seed}-{case.number}",
                symlinks=True, dirs_exist_ok=True, ignore=_ignored,
            )  # fmt: skip
        shutil.rmtree(case.folder, ignore_errors=True)
        cpu = usage.ru_utime + usage.ru_stime
        return Outcome(case.name, case.number, verdict, text[-3000:], memory, cpu)


def table(outcomes: Sequence[Outcome]) -> str:
    """Counts of verdicts by class, and what a case took."""
    lines = [f"{'class':14}{'inputs':>7}" + "".join(f"{c:>9}" for c in COLUMNS) + "  CPU s   MB"]
    for name in sorted({o.name for o in outcomes}):
        mine = [o for o in outcomes if o.name == name]
        counts = Counter(o.verdict for o in mine)
        most = max(o.memory for o in mine) // 2**20
        lines.append(
            f"{name:14}{len(mine):7}"
            + "".join(f"{counts[c]:9}" for c in COLUMNS)
            + f"{sum(o.cpu_s for o in mine):7.0f}{most:5}"
        )
    return "\n".join(lines)


def _load() -> None:
    """Import what commands import when they run, once for all cases."""
    for package in (planner, sim):
        for name in package.__all__:
            getattr(package, name)
    for module in iter_modules(sim.cli.__path__, "sim.cli."):
        import_module(module.name)
    for name in names():
        import_module(f"{classes.__name__}.{name}")
    get_command(app)


def _run_here(name: str, seed: int, number: int, folder: Path, samples: Samples) -> None:
    """In the child: make the case, run it, leave."""
    os.setsid()
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    os.chdir(folder / "here")
    output = os.open(folder / OUTPUT, os.O_WRONLY | os.O_CREAT, 0o600)
    os.dup2(output, 1)
    os.dup2(output, 2)
    with _leaving(UNSOUND):
        make = import_module(f"{classes.__name__}.{name}").case
        case = make(random.Random(f"{name}/{seed}/{number}"), samples)
        run: Callable[[], object] = case if callable(case) else lambda: main(list(case))
        if not callable(case):
            print("opposable", *map(repr, case), flush=True)
        with _leaving():
            run()


class _leaving:
    """A block at whose end the process ends, with the exit code that its exception means."""

    def __init__(self, raw: int = RAW) -> None:
        self._raw = raw

    def __enter__(self) -> None:
        """Begin."""

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        """End the process."""
        code = 0
        if isinstance(error, SystemExit):
            code = error.code if isinstance(error.code, int) else 0 if error.code is None else 1
        elif isinstance(error, NoGraspFoundError):
            code = 4
        elif isinstance(error, PlannerError):
            print(type(error).__name__, error)
            code = 3
        elif error is not None:
            traceback.print_exception(error)
            code = self._raw
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):
                stream.flush()
        os._exit(code)


def _ignored(folder: str, files: list[str]) -> list[str]:
    """Pipes cannot be copied."""
    return [name for name in files if (Path(folder) / name).is_fifo()]


def _resident(pid: int) -> int:
    """Bytes of memory of a process; 0 if it has gone."""
    try:
        pages = int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1])
    except (OSError, IndexError, ValueError):
        return 0
    return pages * resource.getpagesize()


def _cpu(pid: int) -> float:
    """Seconds of processor time of a process; 0 if it has gone."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _end(pid: int) -> None:
    """End a process and what it started, which are a group."""
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(pid, signal.SIGKILL)
