"""What is compared: the data that every side of a cross-check hands over.

All sides speak the language of the reference, MuJoCo's: its joints in its order, its qpos and qvel,
world axes for Jacobians and the linear velocity of a free joint, body axes for its angular one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from planner.spatial import SE3, FloatArray

BoolArray: TypeAlias = NDArray[np.bool_]

FREE, BALL, SLIDE, HINGE = KINDS = ("free", "ball", "slide", "hinge")
"""Kinds of joints, numbered as ``mujoco.mjtJoint`` numbers them."""


@dataclass(frozen=True, kw_only=True)
class Slot:
    """Where a joint of the reference stands in qpos and qvel.

    Attributes:
        name: Its name; invented where the model has none.
        kind: One of ``KINDS``.
        body: Name of the body that it moves.
        q: Slice of qpos.
        v: Slice of qvel.
    """

    name: str
    kind: str
    body: str
    q: slice
    v: slice


@dataclass(frozen=True, kw_only=True)
class Layout:
    """Names and order of the reference.

    Attributes:
        joints: Its joints, in its order.
        parents: Body -> parent body; "world" has none. Parents come before children.
        roots: Body -> the moving body that it is rigidly fixed to, or "world".
        sites: Site -> body.
        nq: Size of qpos.
        nv: Size of qvel.
        q_drawn: qpos (nq,) at which the model stands as it is drawn (MuJoCo's qpos0).
    """

    joints: tuple[Slot, ...]
    parents: Mapping[str, str]
    roots: Mapping[str, str]
    sites: Mapping[str, str]
    nq: int
    nv: int
    q_drawn: FloatArray

    def dof_name(self, dof: int) -> str:
        """Name of a degree of freedom: the joint's, with a number where it has several."""
        slot = next(s for s in self.joints if s.v.start <= dof < s.v.stop)
        several = slot.v.stop - slot.v.start > 1
        return f"{slot.name}[{dof - slot.v.start}]" if several else slot.name


@dataclass(frozen=True, kw_only=True)
class State:
    """One configuration, in the reference's order.

    Attributes:
        index: Its number; -1 for the model as it is drawn.
        qpos: Positions (nq,), rad and m; quaternions w, x, y, z of unit length.
        qvel: Velocities (nv,).
        torque: Joint torques and forces (nv,) for forward dynamics.
        moving: (nv,) booleans: the other joints are held, since one of the sides lacks them.
    """

    index: int
    qpos: FloatArray
    qvel: FloatArray
    torque: FloatArray
    moving: BoolArray


@dataclass(frozen=True, kw_only=True)
class JointFacts:
    """What a side says about a joint.

    Attributes:
        kind: One of ``KINDS``, or what else the side calls it.
        range: Lower and upper position limit (2,), infinite where there is none; None for balls
            and free joints, whose limits are not compared.
        armature: (nv of the joint,), kg m2 or kg.
        damping: (nv of the joint,), N m s/rad or N s/m.
        friction: Dry friction (nv of the joint,), N m or N.
        effort: Bounds (nv of the joint, 2), N m or N; infinite where nothing is stated.
        velocity: Largest speed (nv of the joint,), rad/s or m/s, infinite where the file states
            none; None where the kind of file has no word for it.
    """

    kind: str
    range: FloatArray | None
    armature: FloatArray
    damping: FloatArray
    friction: FloatArray
    effort: FloatArray
    velocity: FloatArray | None = None


@dataclass(frozen=True, kw_only=True)
class LinkInertia:
    """Inertia of a moving body together with all that is rigidly fixed to it.

    Attributes:
        mass: kg.
        center: Centre of mass (3,) in the body's frame, m.
        inertia: About the centre of mass, in the axes of the body's frame (3, 3), kg m2.
    """

    mass: float
    center: FloatArray
    inertia: FloatArray


@dataclass(frozen=True, kw_only=True)
class Parts:
    """What a side says that does not depend on the configuration; names of the reference.

    Attributes:
        joints: Joint -> facts, for joints of the reference that the side has.
        links: Moving body -> inertia.
        inertias: Body -> inertia of it alone; empty where a side does not tell bodies apart that
            are fixed to each other.
        bodies: Bodies of the reference that the side has.
        sites: Sites of the reference that the side has.
        gravity: Acceleration (3,), m/s2.
        others: Names that the side has and the reference has not, with their kind.
    """

    joints: Mapping[str, JointFacts]
    links: Mapping[str, LinkInertia]
    inertias: Mapping[str, LinkInertia]
    bodies: frozenset[str]
    sites: frozenset[str]
    gravity: FloatArray
    others: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Observation:
    """What a side computes at one state, in the reference's names, order and axes.

    Attributes:
        bodies: Body -> pose in the world.
        sites: Site -> pose in the world.
        body_jacobians: Body -> (6, nv), linear over angular velocity of its frame, world axes.
        site_jacobians: Site -> the same.
        mass_matrix: (nv, nv), armature included.
        coriolis: Coriolis and centrifugal forces (nv,).
        gravity: Forces (nv,) that hold the model against gravity.
        acceleration: qacc (nv,) under ``State.torque``, gravity and linear damping.
        centers: Moving body -> centre of mass (3,) of it and all that it carries, world, m.
    """

    bodies: Mapping[str, SE3]
    sites: Mapping[str, SE3]
    body_jacobians: Mapping[str, FloatArray]
    site_jacobians: Mapping[str, FloatArray]
    mass_matrix: FloatArray
    coriolis: FloatArray
    gravity: FloatArray
    acceleration: FloatArray
    centers: Mapping[str, FloatArray]


class Side(Protocol):
    """One of the models that are compared."""

    @property
    def name(self) -> str:
        """What the side is called in tables."""

    @property
    def moving(self) -> BoolArray:
        """Which degrees of freedom (nv,) of the reference it has, as booleans."""

    def parts(self) -> Parts:
        """What does not depend on the configuration."""

    def observe(self, state: State) -> Observation:
        """What it computes at a state."""
