"""Runs DexGraspBench in its own environment: a script of that environment's Python, not a module.

    python launch.py run CHECKOUT ARGUMENT...     its src/main.py, unchanged, with its arguments
    python launch.py read FOLDER                  its results in a folder, as JSON lines
    python launch.py open MODEL                   the MuJoCo there compiles a model; its version

``src/main.py`` imports every task of the benchmark, of which only the evaluation is run. What only
the others use (``ABSENT``) need not be installed: a module stands for it that raises when anything
of it is called. This file imports nothing of this project.
"""

from __future__ import annotations

import glob
import json
import os
import runpy
import sys
import types
from typing import Any

ABSENT = ("torch", "pxr")
"""Used by statistics and format conversion, and by pictures in OpenUSD: gigabytes, and no part in
the evaluation. The benchmark's README asks for torch 2.2.2 and names no version of usd-core."""


class _Absent(types.ModuleType):
    """A module that is not installed: may be named by imports and annotations, not used."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return _Absent(f"{self.__name__}.{name}")

    def __call__(self, *_: Any) -> None:
        """Refuse, but for the default arguments of ``src/util/rot_util.py``."""
        if self.__name__ != "torch.tensor":
            raise ImportError(f"{self.__name__} is used, and not installed")


def run(checkout: str, arguments: list[str]) -> None:
    """The benchmark's command line."""
    for name in ABSENT:
        sys.modules[name] = _Absent(name)
    os.chdir(checkout)
    sys.argv = ["src/main.py", *arguments]
    runpy.run_path(os.path.join(checkout, "src", "main.py"), run_name="__main__")


def read(folder: str) -> None:
    """The benchmark's figures of every grasp; arrays are left out."""
    import numpy as np

    for path in sorted(glob.glob(os.path.join(folder, "**", "*.npy"), recursive=True)):
        try:
            data = np.load(path, allow_pickle=True).item()
        except (EOFError, OSError, ValueError):  # cut off by an interruption: it is made again
            os.remove(path)
            continue
        row = {k: float(v) for k, v in data.items() if np.ndim(v) == 0 and not isinstance(v, str)}
        print(json.dumps({"file": os.path.relpath(path, folder), **row}))


def open_model(path: str) -> None:
    """Compile a model."""
    import mujoco

    model = mujoco.MjModel.from_xml_path(path)
    print(json.dumps({"mujoco": mujoco.__version__, "nq": model.nq, "nu": model.nu}))


if __name__ == "__main__":
    what, argument, *rest = sys.argv[1:]
    if what == "run":
        run(argument, rest)
    elif what == "read":
        read(argument)
    else:
        open_model(argument)
