"""Arrays and numbers given to the Python API.

Objects of another kind altogether (None for a hand) are Python's own affair; what is a number, an
array or what becomes one must be answered or refused by name.
"""

from __future__ import annotations

from collections.abc import Callable
from random import Random
from typing import Any

import numpy as np

from planner.contacts import ContactSet
from planner.forces import ForceLoop, QuadraticCost, distribute_forces
from planner.hand_loading import load_hand
from planner.kinematics import HandState
from planner.objects import parse_object
from planner.quality import analyse, epsilon_l1, force_closure, primitive_wrenches
from planner.quality.ball import measure_hull
from planner.search.metrics import resisted_per_newton
from planner.shapes import Box, Mesh, Sphere
from planner.task import GraspTask

from ..hostile import array, number
from ..samples import HAND, Samples


def case(rng: Random, samples: Samples) -> Callable[[], object]:
    del samples
    call: Callable[[], object] = rng.choice(CALLS)(rng)
    return call


def _contacts() -> ContactSet:
    points = np.random.default_rng(0).normal(size=(4, 3))
    points /= np.linalg.norm(points, axis=1)[:, None]
    return ContactSet.from_arrays(0.03 * points, -points)


def _some(rng: Random, **makers: Callable[[], Any]) -> dict[str, Any]:
    """Some of the arguments."""
    return {name: make() for name, make in makers.items() if rng.random() < 0.35}


def _from_arrays(rng: Random) -> Callable[[], object]:
    given = _some(
        rng,
        mu=lambda: rng.choice([number(rng), array(rng, 4)]),
        mu_torsion=lambda: rng.choice([number(rng), array(rng, 4)]),
        center=lambda: array(rng, 3),
        forces=lambda: array(rng, 4, 4),
        model=lambda: rng.choice(["soft", "none", ["point"] * 3, None, 3]),
        fingers=lambda: rng.choice([None, "abcd", ["a"] * 4, 4]),
    )
    positions, normals = array(rng, 4, 3), array(rng, 4, 3)

    def call() -> object:
        contacts = ContactSet.from_arrays(positions, normals, **given)
        return force_closure(contacts), contacts.grasp_map(), contacts.friction_utilisation()

    return call


def _changed(rng: Random) -> Callable[[], object]:
    mu, torsion, forces = number(rng), array(rng, 4), array(rng, 4, 4)
    which = rng.randrange(2)
    if which:
        return lambda: _contacts().with_friction(mu, torsion)
    return lambda: _contacts().with_forces(forces).wrench()


def _distributed(rng: Random) -> Callable[[], object]:
    given: Any = {"wrench": array(rng, 6)} | _some(
        rng,
        min_normal=lambda: rng.choice([number(rng), array(rng, 4)]),
        max_normal=lambda: rng.choice([number(rng), array(rng, 4)]),
        edges=lambda: rng.choice([2, 3, 8, 2**31, 8.0, number(rng)]),
        edge_cost=lambda: rng.choice([number(rng), array(rng, 4)]),
        friction_scale=lambda: number(rng),
        costs=lambda: [QuadraticCost(p=array(rng, 12, 12), q=array(rng, 12), name="drawn")],
        jacobians=lambda: array(rng, 4, 3, 5),
        gravity_torque=lambda: array(rng, 5),
    )
    return lambda: distribute_forces(_contacts(), **given)


def _step(rng: Random) -> Callable[[], object]:
    wrench, given = array(rng, 6), _some(
        rng,
        positions=lambda: array(rng, 4, 3),
        frames=lambda: array(rng, 4, 3, 3),
        center=lambda: array(rng, 3),
        jacobians=lambda: array(rng, 4, 3, 5),
        gravity_torque=lambda: array(rng, 5),
        min_normal=lambda: rng.choice([number(rng), array(rng, 4)]),
        max_normal=lambda: rng.choice([number(rng), array(rng, 4)]),
        previous=lambda: array(rng, 4, 4),
    )  # fmt: skip
    return lambda: ForceLoop(_contacts(), joints=5, change_cost=1.0).step(wrench, **given)


def _measure(rng: Random) -> Callable[[], object]:
    length, edges = number(rng), rng.choice([number(rng), rng.randrange(-2, 40), 2**31, 512])
    which: Any = rng.choice([analyse, epsilon_l1])
    return lambda: which(_contacts(), length=length, edges=edges)


def _hull(rng: Random) -> Callable[[], object]:
    wrenches, length = array(rng, 6, 12), rng.choice([0.05, number(rng)])
    which = rng.randrange(3)
    if which == 0:
        return lambda: measure_hull(wrenches)
    if which == 1:
        return lambda: resisted_per_newton(_contacts(), wrenches, length=length)
    return lambda: primitive_wrenches(_contacts(), 8, length=length)


def _mesh(rng: Random) -> Callable[[], object]:
    vertices, faces = array(rng, 8, 3), array(rng, 6, 3)
    return lambda: Mesh.from_triangles(vertices, faces, repair=rng.random() < 0.5)


def _shape(rng: Random) -> Callable[[], object]:
    sizes, points = [number(rng) for _ in range(3)], array(rng, 5, 3)
    if rng.random() < 0.5:
        return lambda: Sphere(sizes[0]).signed_distance(points)
    return lambda: Box((sizes[0], sizes[1], sizes[2])).closest_point(points)


def _task(rng: Random) -> Callable[[], object]:
    given = _some(
        rng,
        mu=lambda: number(rng),
        mu_torsion=lambda: number(rng),
        grip_force=lambda: number(rng),
        gravity=lambda: array(rng, 3),
        table_height=lambda: number(rng),
    )
    mass = rng.choice([0.1, number(rng)])
    return lambda: GraspTask.create(HAND, parse_object("sphere", mass=mass), **given)


def _state(rng: Random) -> Callable[[], object]:
    q = array(rng, 16)
    return lambda: HandState(load_hand(HAND), q)


CALLS = (
    _from_arrays, _from_arrays, _changed, _distributed, _distributed, _step, _step, _measure, _hull,
    _mesh, _shape, _task, _state,
)  # fmt: skip
