"""``ours``: the defaults of ``PhysicsOptions``, whose fields state the reasons."""

from __future__ import annotations

from sim.physics import PhysicsOptions

__all__ = ["PRESET"]

PRESET = PhysicsOptions()
