"""From a name or a path to the files of a hand model on disk.

The models travel inside the wheel (``planner/_models``) and stand at the top of a checkout
(``models``); both are found from any working directory.
"""

from __future__ import annotations

import os
from pathlib import Path

from planner.errors import ModelError, NotFoundError

__all__ = ["find_hand", "hand_names", "models_dir"]

DESCRIPTION_FILE = "hand.toml"


def models_dir() -> Path:
    """Folder that holds ``hands/NAME/``.

    Raises:
        ModelError: Neither an installed nor a checked-out model folder exists.
    """
    here = Path(__file__).resolve().parent
    for folder in (here / "_models", here.parent / "models"):
        if (folder / "hands").is_dir():
            return folder
    raise ModelError(f"the models are missing beside {here}; install Opposable again")


def hand_names() -> tuple[str, ...]:
    """Names of the hands that come with Opposable, sorted."""
    folders = (models_dir() / "hands").iterdir()
    return tuple(sorted(f.name for f in folders if (f / DESCRIPTION_FILE).is_file()))


def find_hand(name_or_path: str | Path) -> Path:
    """Path of a hand's description file.

    Args:
        name_or_path: A name out of ``hand_names()``, a description file (``hand.toml``), or a
            folder that holds one.

    Raises:
        NotFoundError: It is neither a known name nor an existing path.
        ModelError: The path exists but is not a hand description.
    """
    path = Path(name_or_path)
    if str(name_or_path) in hand_names():
        return models_dir() / "hands" / str(name_or_path) / DESCRIPTION_FILE
    if os.path.isdir(path):  # False, not an error, where the name is too long or the way is barred
        path = path / DESCRIPTION_FILE
    if os.path.isfile(path):
        if path.suffix != ".toml":
            raise ModelError(f"{path} is not a hand description; give the hand.toml beside it")
        return path
    looks_like_path = path.suffix or len(path.parts) > 1
    hint = "Or give the path of a hand.toml." + (
        " That path does not exist." * bool(looks_like_path)
    )
    raise NotFoundError("hand", str(name_or_path), hand_names(), hint)
