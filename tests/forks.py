"""Python programs in processes of their own that need not import everything again.

A fork server (of ``multiprocessing``) imports the packages once for each worker of pytest, which
takes two seconds; a program is then a fork of it that begins within milliseconds, with its own
memory, folder and environment.
"""

from __future__ import annotations

import ast
import atexit
import multiprocessing
import os
import runpy
import signal
import subprocess
import sys
import tempfile
import threading
import warnings
import weakref
from collections.abc import Callable, Mapping
from contextlib import suppress
from multiprocessing import forkserver
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent

KERNELS = {"OPENBLAS_CORETYPE": "Haswell", "OMP_NUM_THREADS": "1"}
"""Read when NumPy is loaded: kernels of another processor round otherwise, and the same seed may
find another grasp than a page shows."""

SERVER = multiprocessing.get_context("forkserver")
SERVER.set_forkserver_preload(["preloaded"])


def environment_of_programs() -> dict[str, str]:
    """Variables of this process, without displays, and with the kernels of pages."""
    kept = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    paths = [str(ROOT), *filter(None, [kept.get("PYTHONPATH")])]
    return kept | KERNELS | {"PYTHONPATH": os.pathsep.join(paths)}


def command_line(*words: str) -> None:
    """Run ``opposable`` with words, as the installed program does."""
    from sim.cli import main

    sys.argv = ["opposable", *words]
    main()


def script(path: str) -> None:
    """Run a file as ``python FILE`` does; deprecated calls of its own are errors."""
    warnings.filterwarnings("error", category=DeprecationWarning, module="__main__")
    sys.argv = [path]
    sys.path.insert(0, str(Path(path).parent))
    runpy.run_path(path, run_name="__main__")


def brief_script(path: str, *smaller: str) -> None:
    """Run a file as ``script`` does, with brief trials, and with some of its constants smaller.

    Args:
        path: The file.
        smaller: Constants of the file with what they are set to, as ``NAME=VALUE``.
    """
    from brief import brief_trials

    source = Path(path).read_text(encoding="utf-8")
    tree = ast.parse(source, path)
    values = dict(words.split("=", 1) for words in smaller)
    for node in tree.body:
        if isinstance(node, ast.Assign) and (name := ast.unparse(node.targets[0])) in values:
            node.value = ast.parse(values.pop(name), mode="eval").body
    if values:
        raise LookupError(f"{path} has no constants {', '.join(values)}")
    sys.path.insert(0, str(Path(path).parent))
    with brief_trials(), tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / Path(path).name if smaller else Path(path)
        if smaller:
            run.write_text(ast.unparse(tree), encoding="utf-8")
        script(str(run))


def run(
    program: Callable[..., None],
    *words: str,
    folder: Path,
    environment: Mapping[str, str] | None = None,
    timeout: float | None = None,
) -> subprocess.CompletedProcess[str]:
    """Run a program in a folder and wait for its end.

    Args:
        program: A function of a module, called with ``words``.
        words: Its arguments.
        folder: Its working directory.
        environment: All of its variables; ``environment_of_programs()`` if None.
        timeout: Wall time (s) after which it is killed with all that it has started; any if None.

    Raises:
        subprocess.TimeoutExpired: It was killed.
    """
    environment = environment_of_programs() if environment is None else environment
    forks: Any = SERVER
    if multiprocessing.parent_process() is not None:  # a program that runs another has it all
        forks = multiprocessing.get_context("fork")
    else:
        _begin_server()
    with tempfile.TemporaryDirectory() as printed:
        files = [Path(printed) / name for name in ("out", "err")]
        process = forks.Process(
            target=_work, args=(program, words, str(folder), dict(environment), *map(str, files))
        )
        process.start()
        process.join(timeout)
        if process.is_alive():
            assert process.pid is not None and timeout is not None
            with suppress(ProcessLookupError):  # it has not come as far as to lead a group
                os.killpg(process.pid, signal.SIGKILL)
            process.kill()
            process.join()
            raise subprocess.TimeoutExpired([program.__name__, *words], timeout)
        out, err = (f.read_text(encoding="utf-8") if f.exists() else "" for f in files)
    assert process.exitcode is not None
    return subprocess.CompletedProcess([program.__name__, *words], process.exitcode, out, err)


def _begin_server() -> None:
    """Start the server with the environment of programs, unless it runs."""
    before = dict(os.environ)
    paths = [str(ROOT / "tests"), environment_of_programs()["PYTHONPATH"]]
    os.environ |= environment_of_programs() | {"PYTHONPATH": os.pathsep.join(paths)}
    try:
        forkserver.ensure_running()
    finally:
        os.environ.clear()
        os.environ |= before


def _work(
    program: Callable[..., None],
    words: tuple[str, ...],
    folder: str,
    environment: dict[str, str],
    out: str,
    err: str,
) -> None:
    """Run a program in this process, which is a fork, and end as an interpreter does."""
    os.setsid()  # so that it is killed with its children
    inherited: Any = weakref.finalize
    for finalizer in list(inherited._registry):
        finalizer.atexit = False  # folders and the like of its parent are its parent's to remove
    for number, path in ((1, out), (2, err)):
        opened = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(opened, number)
        os.close(opened)
    sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115  ends with the process
    sys.stderr = open(2, "w", encoding="utf-8", closefd=False, buffering=1)  # noqa: SIM115
    os.environ.clear()
    os.environ |= environment
    os.chdir(folder)
    try:
        program(*words)
    finally:
        ending: Any = threading
        ending._shutdown()  # pools send their workers away; who idles is waited for by minutes
        atexit._run_exitfuncs()
        sys.stdout.flush()
