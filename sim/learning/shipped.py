"""``policy_file``: the file of a policy, one of our own or of those that come with Opposable.

Whatever takes ``policy:NAME`` asks here: the command line, the benches, ``policy_controller``.
"""

from __future__ import annotations

from pathlib import Path

from planner.errors import FileFormatError, NotFoundError
from planner.system.package import models_dir

SUFFIX = ".npz"
"""Ending of a policy's file."""


def policy_file(text: Path | str) -> Path:
    """The file that a text names: a path, or the name of a shipped policy.

    A text with a folder or an ending, and a file that there is, is a path.

    Raises:
        FileFormatError: The text is empty.
        NotFoundError: It is a mere name, and nothing has it.
    """
    path = Path(text)
    if not str(text):
        raise FileFormatError("no file of a policy is named; give policy:FILE")
    if path.suffix or len(path.parts) != 1 or path.exists():
        return path
    names = shipped_policies()
    if str(text) not in names:
        raise NotFoundError("policy", str(text), (*names, f"your own file, FILE{SUFFIX}"))
    return _folder() / f"{text}{SUFFIX}"


def shipped_policies() -> tuple[str, ...]:
    """Names of the policies that come with Opposable."""
    return tuple(sorted(file.stem for file in _folder().glob(f"*{SUFFIX}")))


def _folder() -> Path:
    return models_dir() / "policies"
