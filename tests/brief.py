"""Trials as brief as they can be: those of commands, pages and scripts that say no times.

They take every step of a trial, and draw what it draws; what the whole timeline does is tested by
trials, and what a picture of full size shows by tests of pictures.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import fields, replace
from typing import Any
from unittest.mock import patch

from planner.describe import postures
from sim.datasets.reset_states import make, shards
from sim.manipulation.timeline import ManipulationTimeline
from sim.protocols import Settings
from sim.scene import physics
from sim.scene.carrier import Timeline
from sim.show import picture

BRIEF = Timeline.quick(lift=0.3, hold=0.3, lift_height=0.05)
"""A trial of 1.8 s instead of 5.3 s; quicker, and sensor errors let the hand touch the table."""

BRIEF_TURN = ManipulationTimeline(approach=0.4, lift=0.4, carry=0.2, retreat=0.2, height=0.03)
"""A manipulation of 2.6 s, the turn apart, instead of 4.7 s."""

BRIEF_PROTOCOL = Settings(growth=1.5, hold_s=0.5)
"""Loads of a protocol grow in steps of a half instead of a tenth."""

COARSE = replace(physics.PRESETS.usual, timestep=0.004)
"""Half of the steps and of what controllers compute; DexGraspBench takes 4 ms, too."""

POSTURES = {"RADII": (0.022, 0.034, 0.046), "FIRST": (0.034,), "STARTS": 1}
"""Radii (m) to which the postures of a new hand are searched, those begun with, and starts."""

SMALL_SHARD = 16
"""Candidates of a shard of reset states, of which a half is kept, instead of 64."""

SMALL_PICTURE = replace(picture.PICTURE, size=(320, 240), larger=1.0, shadows=512)
"""A picture that takes a tenth of the time where no GPU draws it."""


@contextmanager
def brief_trials() -> Iterator[None]:
    """Trials and manipulations of this process, and of its forks, are brief by default."""
    with ExitStack() as patches:
        given: tuple[Any, ...] = (BRIEF, BRIEF_TURN, BRIEF_PROTOCOL)
        for brief in given:
            values = {field.name: getattr(brief, field.name) for field in fields(brief)}
            kind = type(brief)
            patches.enter_context(patch.object(kind.__init__, "__kwdefaults__", values))
            assert kind() == brief
        patches.enter_context(patch.object(picture, "PICTURE", SMALL_PICTURE))
        patches.enter_context(coarse_steps())
        patches.enter_context(small_shards())
        for name, few in POSTURES.items():
            patches.enter_context(patch.object(postures, name, few))
        yield


@contextmanager
def coarse_steps() -> Iterator[None]:
    """Trials of this process, and of its forks, take steps of 4 ms unless they name physics."""
    presets, kind = physics.PRESETS, physics.PhysicsOptions
    begin: Any = kind.__init__
    with (
        patch.dict(begin.__kwdefaults__, timestep=COARSE.timestep),
        patch.dict(presets._known, {COARSE.name: COARSE}),
        patch.object(presets, "usual", COARSE),
    ):
        assert kind() == COARSE
        yield


@contextmanager
def small_shards() -> Iterator[None]:
    """Shards of reset states that are held by this process, and by its forks, are small."""
    with (
        patch.object(make, "SHARD", SMALL_SHARD),
        patch.object(shards, "SHARD", SMALL_SHARD),
    ):
        yield
