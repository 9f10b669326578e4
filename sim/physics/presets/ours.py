"""``ours``: the defaults of ``PhysicsOptions``, whose fields state the reasons."""

from __future__ import annotations

from sim.physics.options import PhysicsOptions, register_physics

__all__ = ["PRESET"]

PRESET = register_physics(PhysicsOptions())
