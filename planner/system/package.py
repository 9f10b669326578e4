"""Of the packages: their version, names that are imported when first used (PEP 562), and models.

The version is written here and nowhere else: the package's metadata are made from it, and a
checkout on PYTHONPATH has no metadata, or those of another version that is installed beside it.

The two packages use ``lazy_names`` in their ``__init__``: ``import planner.contacts`` loads NumPy
alone, not four engines. The models that come with Opposable are beside the code, in a wheel or a
checkout.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path

from planner.errors import ModelError

__all__ = ["__version__", "written_by"]

__version__ = "0.1.0"
"""Version of both packages; the wheel is built with it."""


def written_by() -> str:
    """This version, as files name it."""
    return f"opposable {__version__}"


def lazy_names(
    package: str, homes: Mapping[str, str]
) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """The module functions ``__getattr__`` and ``__dir__`` of a package.

    Args:
        package: Its ``__name__``.
        homes: Public name -> the module that defines it. A submodule of the package must not have
            the name: importing the submodule would bind the name first.
    """

    def get(name: str) -> object:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(homes[name]), name)
        setattr(sys.modules[package], name, value)
        return value

    def names() -> list[str]:
        return sorted({*vars(sys.modules[package]), *homes})

    return get, names


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
