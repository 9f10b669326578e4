"""Trials as brief as they can be: those of commands, pages and scripts that say no times.

They take every step of a trial, and draw what it draws; what the whole timeline does is tested by
trials, and what a picture of full size shows by tests of pictures.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from unittest.mock import patch

from sim.manipulation.timeline import ManipulationTimeline
from sim.scene.carrier import Timeline
from sim.show import picture

BRIEF = Timeline.quick(lift=0.3, hold=0.3, lift_height=0.05)
"""A trial of 1.8 s instead of 5.3 s; quicker, and sensor errors let the hand touch the table."""

BRIEF_TURN = ManipulationTimeline(approach=0.4, lift=0.4, carry=0.2, retreat=0.2, height=0.03)
"""A manipulation of 2.6 s, the turn apart, instead of 4.7 s."""

SMALL_PICTURE = replace(picture.PICTURE, size=(320, 240), larger=1.0, shadows=512)
"""A picture that takes a tenth of the time where no GPU draws it."""


@contextmanager
def brief_trials() -> Iterator[None]:
    """Trials and manipulations of this process, and of its forks, are brief by default."""
    with (
        patch.object(Timeline.__init__, "__kwdefaults__", asdict(BRIEF)),
        patch.object(ManipulationTimeline.__init__, "__kwdefaults__", asdict(BRIEF_TURN)),
        patch.object(picture, "PICTURE", SMALL_PICTURE),
    ):
        assert (Timeline(), ManipulationTimeline()) == (BRIEF, BRIEF_TURN)
        yield
