"""Reading and compiling a model file with MuJoCo, with errors that say what to do."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco

from planner.errors import ModelError

__all__ = ["compile_spec", "load_spec"]


def load_spec(path: Path) -> Any:
    """Read an MJCF file into a fresh ``mujoco.MjSpec``.

    Raises:
        ModelError: The file is missing or MuJoCo cannot read it.
    """
    if not path.is_file():
        raise ModelError(f"there is no model file {path}; give the path of an MJCF file")
    try:
        return mujoco.MjSpec.from_file(str(path))
    except (ValueError, FileNotFoundError) as error:
        raise ModelError(f"MuJoCo cannot read {path} as a model: {error}") from error


def compile_spec(spec: Any, what: str) -> Any:
    """Compile a spec into a ``mujoco.MjModel``.

    Args:
        spec: ``mujoco.MjSpec``.
        what: What is being compiled, for the message.

    Raises:
        ModelError: MuJoCo refuses the model.
    """
    try:
        return spec.compile()
    except ValueError as error:
        raise ModelError(f"MuJoCo cannot compile {what}: {error}") from error
