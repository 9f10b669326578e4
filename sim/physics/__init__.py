"""Physics of the simulation: options with a reason each, and presets by name."""

from sim.physics.named import (
    AnyPhysics,
    as_physics,
    named_physics,
    physics_for,
    read_physics,
)
from sim.physics.options import PRESETS, PhysicsOptions, register_physics
from sim.physics.presets import dexgraspbench, menagerie, mujoco_default
from sim.preset_files import SUFFIXES

__all__ = [
    "PRESETS",
    "SUFFIXES",
    "AnyPhysics",
    "PhysicsOptions",
    "as_physics",
    "dexgraspbench",
    "menagerie",
    "mujoco_default",
    "named_physics",
    "physics_for",
    "read_physics",
    "register_physics",
]
