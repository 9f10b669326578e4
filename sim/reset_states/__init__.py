"""Stable hand-object states from which reinforcement learning begins its episodes."""

from sim.reset_states.formats import (
    StateFormat,
    register_state_format,
    state_format,
    state_formats,
)
from sim.reset_states.make import StatesProgress, make_states
from sim.reset_states.starts import Draws, StatesAsked
from sim.reset_states.states import StateSet

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
