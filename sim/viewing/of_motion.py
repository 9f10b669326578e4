"""A motion, a gait or a manipulation plan."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from planner.files import read_gait, read_manipulation, read_motion
from planner.pages.motion_page import motion_page
from planner.pages.object_motion import AnyMotion
from planner.pages.page import Page
from sim.viewing.kinds import Kind, ViewOptions, register_kind
from sim.viewing.target import Target

__all__: list[str] = []

READERS: dict[str, Callable[[Path], AnyMotion]] = {
    "opposable-motion": read_motion,
    "opposable-gait": read_gait,
    "opposable-manipulation": read_manipulation,
}
"""Format of a file -> what reads it."""


def _shown(target: Target, options: ViewOptions) -> Page:
    assert target.path is not None
    return motion_page(READERS[target.format](target.path))


register_kind(
    Kind(
        name="a motion, gait or manipulation plan",
        recognises=lambda target: target.format in READERS,
        shown=_shown,
    )
)
