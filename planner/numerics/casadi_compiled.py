"""CasADi functions as compiled libraries: an option, the same numbers, kept on disk.

CasADi evaluates expressions in a virtual machine. As compiled C the residuals of a grasp take a
fraction of the time. The compiler needs seconds for each kind of problem, which pays for many
grasps only; the environment variable ``OPPOSABLE_COMPILE=1`` switches it on.
Libraries lie in the cache directory under the digest of source, compiler and flags; no fast-math,
no fused multiplication, so that rounding is the virtual machine's. See
``planner.system.disk_cache`` for what is checked before one is loaded.
"""

from __future__ import annotations

import hashlib
import os
import platform
import shutil
import subprocess
import tempfile
from functools import lru_cache
from pathlib import Path
from typing import Any

import casadi as ca

from planner.errors import PlannerError
from planner.numerics.kernels import COMPILE_VARIABLE
from planner.system.disk_cache import cache_directory, check_folder, is_intact, make_private, seal

__all__ = ["compiled"]

FLAGS = ("-O1", "-ffp-contract=off", "-shared", "-fPIC")
"""Flags of the compiler; -O2 compiles longer and gains nothing."""

WITHOUT = f"unset {COMPILE_VARIABLE}: all works without it"


def compiled(function: Any) -> Any:
    """The function as a compiled library if that is asked for; else itself.

    A kept library that is damaged, or that others could have changed, is compiled anew.

    Raises:
        PlannerError: It is asked for but there is no compiler, or it fails, or others can write to
            the folder of libraries, or a library cannot be loaded, or the variable's value is
            neither 0 nor 1.
    """
    asked = os.environ.get(COMPILE_VARIABLE, "")
    if asked not in {"", "0", "1"}:
        raise PlannerError(f"{COMPILE_VARIABLE} is {asked!r}; set it to 1 or to 0, or not at all")
    if asked != "1":
        return function
    generator = ca.CodeGenerator(f"{function.name()}.c")
    generator.add(function)
    source = generator.dump()
    compiler = _compiler()
    key = "\n".join(
        [source, compiler, _version(compiler), *FLAGS, platform.system(), platform.machine()]
    )
    digest = hashlib.sha256(key.encode()).hexdigest()
    library = cache_directory().absolute() / "compiled" / f"{function.name()}-{digest[:24]}.so"
    make_private(library.parent)
    check_folder(library.parent)
    if not is_intact(library):
        _compile(source, compiler, library)
    try:
        return ca.external(function.name(), str(library))
    except RuntimeError as error:  # a folder from which no code may be run, for example
        raise PlannerError(
            f"the compiled library {library} cannot be loaded: {error}; {WITHOUT}"
        ) from error


def _compiler() -> str:
    """Path of the C compiler."""
    name = os.environ.get("CC", "cc")
    compiler = shutil.which(name)
    if compiler is None:
        raise PlannerError(
            f"{COMPILE_VARIABLE}=1 but there is no C compiler {name!r}; install one, name one in "
            f"CC, or {WITHOUT}"
        )
    return compiler


@lru_cache(maxsize=4)
def _version(compiler: str) -> str:
    """Version text of a compiler, "" if none: another version makes another library."""
    done = _run([compiler, "--version"])
    return done.stdout


def _compile(source: str, compiler: str, library: Path) -> None:
    """Compile C text to a library, atomically."""
    with tempfile.TemporaryDirectory(dir=library.parent) as folder:
        text, made = Path(folder) / "source.c", Path(folder) / "library.so"
        text.write_text(source, encoding="utf-8")
        done = _run([compiler, *FLAGS, str(text), "-lm", "-o", str(made)])
        if done.returncode != 0 or not made.is_file():
            first = done.stderr.strip().splitlines()[:3]
            raise PlannerError(
                f"{compiler} failed on generated code: {' '.join(first) or done.returncode}; "
                f"{WITHOUT}"
            )
        seal(made, library)


def _run(command: list[str]) -> subprocess.CompletedProcess[str]:
    """Run the compiler.

    Raises:
        PlannerError: It cannot be started.
    """
    try:
        return subprocess.run(
            command, capture_output=True, text=True, errors="replace", check=False
        )
    except OSError as error:
        raise PlannerError(f"cannot run {command[0]}: {error.strerror}; {WITHOUT}") from error
