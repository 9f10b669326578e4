"""Where the models that come with Opposable are: beside the code, in a wheel or a checkout."""

from __future__ import annotations

from pathlib import Path

from planner.errors import ModelError

__all__ = ["models_dir"]


def models_dir() -> Path:
    """Folder that holds ``hands/NAME/``, ``arms/NAME/`` and ``objects/NAME.ply``.

    Raises:
        ModelError: Neither an installed nor a checked-out model folder exists.
    """
    here = Path(__file__).resolve().parents[1]
    for folder in (here / "_models", here.parent / "models"):
        if (folder / "hands").is_dir():
            return folder
    raise ModelError(f"the models are missing beside {here}; install Opposable again")
