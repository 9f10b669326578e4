"""``ideal``: the object's pose, the joints and all numbers are known exactly and at once."""

from __future__ import annotations

from sim.reality.errors import Reality, register_reality

PRESET = register_reality(Reality())
