"""Whether an object rests where it was put, and where it comes to rest if it does not.

The pose that geometry gives, lowered straight down on a stand or put on a face of its hull, need
not be an equilibrium: a lemon on four walls rolls by 9 degrees, and the convex pieces of a scan may
stand on another face than the scan. Both would happen before the hand touches the object, and again
after it has let go. So the simulation is asked, with nothing but the object and what it stands on
in reach.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from planner.collision.pair_table import lift_to_rest
from planner.errors import TaskError
from planner.shapes import Mesh
from planner.spatial import SE3, rotation_angle
from planner.task import GraspTask
from sim.scene.build import Scene, build_scene
from sim.scene.physics import PhysicsOptions

WATCHED = 1.0
"""Time (s) that an object is watched for: one that rolls off moves by 1 mm within 0.3 s."""

LEAST_MOVED, LEAST_TILTED = 0.001, float(np.deg2rad(1.0))
"""Movement (m) and rotation (rad) within that time that count as standing still: contacts give way
by 0.1 mm, and facets of a scan of 8,000 triangles differ by half a degree."""

LONGEST = 5.0
"""Time (s) after which an object that still moves never rests."""

SLOW = 1e-3
"""Speed (m/s, and rad/s) below which it is at rest."""

TRIES = 3
"""Times that a pose in which it came to rest is tried: lowered exactly, it may roll a little on."""

CLEAR = 0.5
"""Height (m) of the hand above the object meanwhile: far from it."""

NEAR = 0.02
"""How far (m) above or below the pose in which it came to rest in simulation an object lies by its
true geometry: convex pieces reach some millimetres out of a scan."""


def rests(task: GraspTask) -> bool:
    """Whether the object of a task stays where the task has it until it is touched."""
    scene, data = _scene(task)
    first = task.T_world_object
    _run(scene, data, WATCHED)
    now = scene.body_pose(data, scene.object_body)
    moved = float(np.linalg.norm(now.translation - first.translation))
    turned = rotation_angle(first.rotation.T @ now.rotation)
    return moved <= LEAST_MOVED and turned <= LEAST_TILTED


def settled(task: GraspTask) -> GraspTask:
    """The task itself if its object rests where it is, else with the object where it comes to rest.

    Without a table something else holds the object, and a primitive on a table rests by formula.

    Raises:
        TaskError: It rolls off, or never comes to rest.
    """
    primitive = not isinstance(task.object.shape, Mesh)
    if task.table_height is None or (primitive and not task.carrying):
        return task
    for _ in range(TRIES):
        if rests(task):
            return task
        task = replace(task, T_world_object=_where_it_rests(task))
    if rests(task):
        return task
    raise TaskError(
        f"{task.object.name} does not stand where it was put, and rolls on from where it came to "
        f"rest {TRIES} times; choose another pose of it, or another stand"
    )


def _where_it_rests(task: GraspTask) -> SE3:
    """Where an object comes to rest, as high as its true geometry lies there."""
    scene, data = _scene(task)
    for _ in range(round(LONGEST / WATCHED)):
        _run(scene, data, WATCHED)
        if np.abs(data.qvel[scene.object_dof]).max() < SLOW:
            break
    else:
        raise TaskError(
            f"{task.object.name} does not stand where it was put, and still moves after "
            f"{LONGEST:.0f} s; choose another pose of it, or another stand"
        )
    pose = scene.body_pose(data, scene.object_body)
    table = task.table_height
    lowest = task.lowest_point(pose)
    if not task.carrying:
        down = 0.0 if table is None else table - lowest
        return SE3(pose.rotation, pose.translation + np.array([0.0, 0.0, down]))
    fell = 1e3 * float(task.T_world_object.translation[2] - pose.translation[2])
    lift = lift_to_rest(task.object.shape, pose, task.carrying, -NEAR, NEAR)
    if lift is None or lift <= -NEAR:
        raise TaskError(
            f"{task.object.name} does not stand on {task.carrying[0].name!r} and the others that "
            f"carry it: left alone it comes down by {fell:.0f} mm; choose another pose of it, or "
            "another stand"
        )
    return SE3(pose.rotation, pose.translation + np.array([0.0, 0.0, lift]))


def _scene(task: GraspTask) -> tuple[Scene, Any]:
    """The scene with the hand far above, and its data."""
    stands = SE3(np.eye(3), task.T_world_object.translation)
    if task.T_world_base is not None:  # an arm, or a fixed base: all of it goes up
        stands = SE3(task.T_world_base)
    stands.translation = stands.translation + np.array([0.0, 0.0, CLEAR])
    T_world_base = stands
    scene = build_scene(task, T_world_base=T_world_base, physics=PhysicsOptions(mu=task.mu))
    return scene, scene.start(task.hand.neutral, T_world_base)


def _run(scene: Scene, data: Any, duration: float) -> None:
    """Go on for a time (s)."""
    for _ in range(round(duration / scene.physics.timestep)):
        mujoco.mj_step(scene.model, data)
