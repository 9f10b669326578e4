"""CasADi functions as compiled libraries: an option, the same numbers, kept on disk.

CasADi evaluates expressions in a virtual machine. As C, compiled once, the residuals of a grasp
take a seventh of the time (0.02 instead of 0.11 ms). The compiler needs 5 to 15 s for each kind of
problem, so this is for many grasps and is asked for: environment variable ``OPPOSABLE_COMPILE=1``.
Libraries lie in the cache directory under the digest of their source; no fast-math, no fused
multiplication, so that rounding is the virtual machine's.
"""

from __future__ import annotations

import hashlib
import os
import platform
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import casadi as ca

from planner.errors import PlannerError
from planner.shapes.cache import cache_directory

__all__ = ["COMPILE_VARIABLE", "compiled"]

COMPILE_VARIABLE = "OPPOSABLE_COMPILE"
"""Environment variable: "1" compiles, "" or "0" does not."""

FLAGS = ("-O1", "-ffp-contract=off", "-shared", "-fPIC")
"""Of the compiler; -O2 takes three times as long and wins nothing."""


def compiled(function: Any) -> Any:
    """The function as a compiled library if that is asked for; else itself.

    Raises:
        PlannerError: It is asked for but there is no compiler, or it fails, or the variable's value
            is neither 0 nor 1.
    """
    asked = os.environ.get(COMPILE_VARIABLE, "")
    if asked not in {"", "0", "1"}:
        raise PlannerError(f"{COMPILE_VARIABLE} is {asked!r}; set it to 1 or to 0, or not at all")
    if asked != "1":
        return function
    generator = ca.CodeGenerator(f"{function.name()}.c")
    generator.add(function)
    source = generator.dump()
    key = "\n".join([source, *FLAGS, platform.system(), platform.machine()])
    digest = hashlib.sha256(key.encode()).hexdigest()
    library = cache_directory() / "compiled" / f"{function.name()}-{digest[:24]}.so"
    if not library.is_file():
        _compile(source, library)
    return ca.external(function.name(), str(library))


def _compile(source: str, library: Path) -> None:
    """Compile C text to a library, which is there whole or not at all."""
    compiler = shutil.which(os.environ.get("CC", "cc"))
    if compiler is None:
        raise PlannerError(
            f"{COMPILE_VARIABLE}=1 but there is no C compiler {os.environ.get('CC', 'cc')!r}; "
            "install one, name one in CC, or unset the variable: all works without it"
        )
    library.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=library.parent) as folder:
        text, made = Path(folder) / "source.c", Path(folder) / "library.so"
        text.write_text(source, encoding="utf-8")
        done = subprocess.run(
            [compiler, *FLAGS, str(text), "-lm", "-o", str(made)],
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode != 0:
            first = done.stderr.strip().splitlines()[:3]
            raise PlannerError(
                f"{compiler} failed on generated code: {' '.join(first) or done.returncode}; unset "
                f"{COMPILE_VARIABLE}: all works without it"
            )
        os.replace(made, library)
