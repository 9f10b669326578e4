"""Starts of grasp synthesis: palm poses, postures, and pairs of opposed surface points."""

from __future__ import annotations

from planner.shapes import Mesh
from planner.synthesis.seeds.draw import Seeder
from planner.task import GraspTask

__all__ = ["seeder_for", "turning_seeder_for"]


def seeder_for(task: GraspTask) -> Seeder:
    """The source of starts that suits the task's contacts and object."""
    # each is imported here, as most tasks need none of them
    if task.hand.pair:
        from planner.synthesis.seeds.facing_palms import PairSeeder

        return PairSeeder(task)
    if not task.is_of_fingertips:
        from planner.synthesis.seeds.enveloping import EnvelopingSeeder

        return EnvelopingSeeder(task)
    if not isinstance(task.object.shape, Mesh):
        return Seeder(task)
    from planner.synthesis.seeds.mesh import MeshSeeder, NarrowSeeder

    return NarrowSeeder(task) if task.object.shape.narrow else MeshSeeder(task)


def turning_seeder_for(task: GraspTask) -> Seeder:
    """The source of starts from which the task's object is turned or moved in the hand."""
    from planner.synthesis.seeds.mesh import TurningSeeder  # here: for meshes alone

    return TurningSeeder(task) if isinstance(task.object.shape, Mesh) else Seeder(task)
