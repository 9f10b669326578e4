"""Stable hand-object states from which reinforcement learning begins its episodes."""

from sim.datasets.reset_states.formats import (
    StateFormat,
    StateSet,
    register_state_format,
    state_format,
    state_formats,
)
from sim.datasets.reset_states.make import StatesProgress, make_states
from sim.datasets.reset_states.starts import Draws, StatesAsked

__all__ = [
    "Draws",
    "StateFormat",
    "StateSet",
    "StatesAsked",
    "StatesProgress",
    "make_states",
    "register_state_format",
    "state_format",
    "state_formats",
]
