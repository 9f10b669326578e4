"""Stable hand-object states from which reinforcement learning begins its episodes."""

from sim.reset_states.formats import (
    StateFormat,
    StateSet,
    register_state_format,
    state_format,
    state_formats,
)
from sim.reset_states.make import StatesProgress, make_states
from sim.reset_states.starts import Draws, StatesAsked

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
