"""Opposable: all public names of ``planner`` and ``sim`` in one place, loaded when first used.

In a script::

    from opposable import GraspTask, plan_grasp, simulate
"""

from typing import TYPE_CHECKING

import planner
import sim

if TYPE_CHECKING:
    from planner import *  # noqa: F403
    from sim import *  # noqa: F403

__version__ = planner.__version__


def __getattr__(name: str) -> object:
    """A public name of one of the two packages; ``__all__`` is the names of both."""
    if name == "__all__":
        return sorted({*planner.__all__, *sim.__all__})
    for package in (planner, sim):
        if name in package.__all__:
            return getattr(package, name)
    raise AttributeError(f"module 'opposable' has no attribute {name!r}")


def __dir__() -> list[str]:
    """All public names."""
    return sorted({*planner.__all__, *sim.__all__, "__version__"})
