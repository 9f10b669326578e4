"""Proposals cached on disk.

A proposal takes seconds, mostly for postures. It is determined by the model, the name of its file,
our code and the libraries: those make the key.
"""

from __future__ import annotations

import hashlib
from functools import lru_cache
from importlib import metadata
from pathlib import Path

from pydantic import ValidationError

from planner.bridge.load import named_files
from planner.describe.propose import located, propose
from planner.joints.description import HandDescription
from planner.system.disk_cache import read_text, write_text

KIND = "proposal"

LIBRARIES = ("mujoco", "pin", "coal", "numpy", "scipy", "trimesh")
"""Distributions on whose numbers a proposal depends."""


def proposed_description(model: str | Path) -> HandDescription:
    """The description that ``propose`` finds for a model, found once.

    Args:
        model: As for ``propose``, on disk.

    Raises:
        PlannerError: As ``propose`` does.
    """
    path, line = located(model)
    key = _key(path, line)
    if key is None:
        return propose(model).description
    known = _read(key)
    if known is not None:
        return known.model_copy(update={"model": line})
    description = propose(model).description
    write_text(KIND, key, description.to_json())
    return description


def _read(key: str) -> HandDescription | None:
    text = read_text(KIND, key)
    try:
        return None if text is None else HandDescription.from_json(text)
    except ValidationError:
        return None


def _key(path: Path, line: str) -> str | None:
    """Key of a proposal, wherever the model lies; None if not all files are known.

    The hand is called after the last part of its ``model`` line.
    """
    files = named_files(path)
    if not all(f.is_file() for f in files):
        return None  # MuJoCo found them elsewhere, or will say what is missing
    digest = hashlib.sha256(_made_with())
    parts = [line.rpartition("/")[2].encode()]
    for file in files:
        parts += [file.name.encode(), file.read_bytes()]
    for part in parts:
        digest.update(hashlib.sha256(part).digest())
    return digest.hexdigest()


@lru_cache(maxsize=1)
def _made_with() -> bytes:
    """Digest of all modules of the planner, and of the libraries' versions."""
    root = Path(__file__).resolve().parents[1]
    digest = hashlib.sha256()
    for module in sorted(root.rglob("*.py")):
        digest.update(hashlib.sha256(module.read_bytes()).digest())
    for name in LIBRARIES:
        digest.update(f"{name} {_version(name)};".encode())
    return digest.digest()


def _version(name: str) -> str:
    """Of a distribution; "" where it came in another way than as a package of that name."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ""
