"""A motion, a gait or a manipulation plan."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from planner.files.movements import gait_from_dict, manipulation_from_dict, motion_from_dict
from planner.pages.motion_page import motion_page
from planner.pages.object_motion import AnyMotion
from planner.pages.page import Page
from sim.viewing.kinds import Kind, ViewOptions
from sim.viewing.target import Target

READERS: dict[str, Callable[[dict[str, Any], str], AnyMotion]] = {
    "opposable-motion": motion_from_dict,
    "opposable-gait": gait_from_dict,
    "opposable-manipulation": manipulation_from_dict,
}
"""Format of a file -> what reads it."""


def _shown(target: Target, options: ViewOptions) -> Page:
    assert target.data is not None
    return motion_page(READERS[target.format](target.data, str(target.path)))


KIND = Kind(
    name="a motion, gait or manipulation plan",
    recognises=lambda target: target.format in READERS,
    shown=_shown,
)
"""See ``sim.viewing.kinds``."""
