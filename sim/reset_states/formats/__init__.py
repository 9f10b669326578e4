"""Formats that caches of states are written in: a module and a registration each."""

from sim.reset_states.formats.registry import (
    StateFormat,
    register_state_format,
    state_format,
    state_formats,
)

__all__ = ["StateFormat", "register_state_format", "state_format", "state_formats"]
