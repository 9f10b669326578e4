"""What is compared: states, what every side says of them, quantities with units and tolerances.

All sides speak the language of the reference, MuJoCo's: its joints in its order, its qpos and qvel,
world axes for Jacobians and the linear velocity of a free joint, body axes for its angular one.
Random configurations are seeded, within limits, with quaternions of unit length.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from planner.arrays import check_fields
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


@dataclass(frozen=True, kw_only=True)
class Tolerances:
    """What counts as equal.

    Attributes:
        kinematics: Poses, Jacobians, axes and centres of mass, m and rad.
        dynamics: Mass matrix, forces and accelerations, relative.
        parameters: Masses, inertias, limits and the like, relative.
        distance: Distances of geometries that are apart, and what geometries span, m.
        normal: Angle between the directions of these distances, rad. Where the distance is exact
            to e, a surface of radius r gives its direction to sqrt(2 e / r) only.
    """

    kinematics: float = 1e-10
    dynamics: float = 1e-9
    parameters: float = 1e-9
    distance: float = 2e-6
    normal: float = 1e-3

    def __post_init__(self) -> None:
        """Refuse what cannot be a tolerance."""
        check_fields(self, what="tolerance ", least=0.0)


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """One row of the table.

    Attributes:
        title: Its name.
        unit: "m", "rad", "m/s2" or "relative"; "" for what is there or is not.
        group: "structure", "parameters", "kinematics", "dynamics", "couplings" or "geometry".
        tolerance: Which of ``Tolerances`` judges it; None if every difference counts.
        parts: Kind of part that it belongs to.
    """

    title: str
    unit: str
    group: str
    tolerance: str | None
    parts: str


def _rows() -> tuple[Quantity, ...]:
    table = """
        joints present | | structure | | joint
        bodies present | | structure | | body
        sites present | | structure | | site
        joint kind | | structure | | joint
        geometries present | | structure | | geom
        geometry kind | | structure | | geom
        body offset | m | parameters | kinematics | body
        body turn | rad | parameters | kinematics | body
        joint axis | rad | parameters | kinematics | joint
        joint anchor | m | parameters | kinematics | joint
        site offset | m | parameters | kinematics | site
        site turn | rad | parameters | kinematics | site
        gravity | m/s2 | parameters | kinematics | model
        joint range | relative | parameters | parameters | joint
        armature | relative | parameters | parameters | joint
        damping | relative | parameters | parameters | joint
        dry friction | relative | parameters | parameters | joint
        effort limit | relative | parameters | parameters | joint
        velocity limit | relative | parameters | parameters | joint
        mass | relative | parameters | parameters | body
        link centre | m | parameters | kinematics | body
        inertia | relative | parameters | parameters | body
        geometry | m | parameters | distance | geom
        geometry size | m | parameters | distance | geom
        geometry offset | m | parameters | kinematics | geom
        geometry turn | rad | parameters | kinematics | geom
        body position | m | kinematics | kinematics | body
        body orientation | rad | kinematics | kinematics | body
        site position | m | kinematics | kinematics | site
        site orientation | rad | kinematics | kinematics | site
        body Jacobian | m, rad | kinematics | kinematics | body
        site Jacobian | m, rad | kinematics | kinematics | site
        centre of mass | m | kinematics | kinematics | body
        mass matrix | relative | dynamics | dynamics | joint
        Coriolis force | relative | dynamics | dynamics | joint
        gravity force | relative | dynamics | dynamics | joint
        forward dynamics | relative | dynamics | dynamics | joint
        equality rows | relative | couplings | parameters | equality
        distance | m | geometry | distance | pair
        normal | rad | geometry | normal | pair
        distance in overlap | m | overlap | distance | pair
    """
    out = []
    for line in table.strip().splitlines():
        title, unit, group, tolerance, parts = (cell.strip() for cell in line.split("|"))
        out.append(
            Quantity(title=title, unit=unit, group=group, tolerance=tolerance or None, parts=parts)
        )
    return tuple(out)


QUANTITIES = {quantity.title: quantity for quantity in _rows()}
"""Title -> quantity, in the order of the table."""


@dataclass(frozen=True, kw_only=True)
class Difference:
    """One quantity of one part that is not equal.

    Attributes:
        quantity: Title of the quantity.
        part: Name of the part (joint, body, site, pair).
        error: In the quantity's unit; infinite where one side has no value.
        tolerance: What was allowed.
        state: Number of the configuration; -1 where it does not matter.
        reference: The reference's value, for people.
        value: The other side's value, for people.
        cause: Key of a known cause, or "".
        reason: The cause in words, or "".
    """

    quantity: str
    part: str
    error: float
    tolerance: float
    state: int = -1
    reference: str = ""
    value: str = ""
    cause: str = ""
    reason: str = ""

    def __str__(self) -> str:
        """For people."""
        unit = QUANTITIES[self.quantity].unit
        size = f" by {self.error:.2g} {unit}".rstrip() if np.isfinite(self.error) and unit else ""
        values = f": {self.reference} here, {self.value} there" if self.reference else ""
        reason = f" ({self.reason})" if self.reason else ""
        return f"{self.quantity} of {self.part} differs{size}{values}{reason}"


@dataclass(kw_only=True)
class Tally:
    """What has been measured so far between the reference and one other side.

    Attributes:
        tolerances: What counts as equal.
        count: Quantity -> comparisons made.
        worst: Quantity -> largest error, its part and its configuration.
        differences: (quantity, part) -> worst difference beyond tolerance.
    """

    tolerances: Tolerances
    count: dict[str, int] = field(default_factory=dict)
    worst: dict[str, tuple[float, str, int]] = field(default_factory=dict)
    differences: dict[tuple[str, str], Difference] = field(default_factory=dict)

    def allowed(self, quantity: str) -> float:
        """Tolerance of a quantity."""
        name = QUANTITIES[quantity].tolerance
        return 0.0 if name is None else float(getattr(self.tolerances, name))

    def add(
        self,
        quantity: str,
        part: str,
        error: float,
        *,
        state: int = -1,
        values: tuple[FloatArray | str, FloatArray | str] = ("", ""),
    ) -> None:
        """Take note of one comparison.

        Args:
            quantity: Title of the quantity.
            part: Name of the part.
            error: In the quantity's unit; NaN counts as infinite.
            state: Number of the configuration.
            values: Both values, to show them to people.
        """
        error = float("inf") if np.isnan(error) else float(error)
        self.count[quantity] = self.count.get(quantity, 0) + 1
        if quantity not in self.worst or error > self.worst[quantity][0]:
            self.worst[quantity] = (error, part, state)
        known = self.differences.get((quantity, part))
        if error > self.allowed(quantity) and (known is None or error > known.error):
            reference, value = (_text(v) for v in values)
            self.differences[quantity, part] = Difference(
                quantity=quantity,
                part=part,
                error=error,
                tolerance=self.allowed(quantity),
                state=state,
                reference=reference,
                value=value,
            )


def _text(value: FloatArray | str) -> str:
    if isinstance(value, str):
        return value
    flat = np.ravel(value)
    words = " ".join(f"{v:.6g}" for v in flat)
    return words if len(flat) == 1 else f"({words})"


UNLIMITED = {"hinge": np.pi, "slide": 0.1}
"""Half of the range, rad and m, in which a joint without limits is tried."""

FLIGHT = 0.5
"""Half of the range, m, in which a free body is placed about where it is drawn."""


def random_states(
    layout: Layout,
    joints: dict[str, JointFacts],
    moving: BoolArray,
    generator: np.random.Generator,
    count: int,
) -> tuple[State, ...]:
    """Random states; joints that one side lacks stay where they are drawn.

    Args:
        layout: The reference's.
        joints: What the reference says about each joint.
        moving: (nv,) booleans: degrees of freedom that both sides have.
        generator: Source of randomness.
        count: How many.
    """

    def state(index: int) -> State:
        qpos = as_drawn(layout).qpos.copy()
        for slot in layout.joints:
            if not moving[slot.v].all():
                continue
            if slot.kind in (FREE, BALL):
                quaternion = generator.normal(size=4)
                qpos[slot.q.stop - 4 : slot.q.stop] = quaternion / np.linalg.norm(quaternion)
                if slot.kind == FREE:
                    qpos[slot.q.start : slot.q.start + 3] += generator.uniform(
                        -FLIGHT, FLIGHT, size=3
                    )
                continue
            bounds = joints[slot.name].range
            low, high = (-np.inf, np.inf) if bounds is None else bounds
            reach = UNLIMITED[slot.kind]
            low = low if np.isfinite(low) else min(-reach, high - 2 * reach)
            high = high if np.isfinite(high) else max(reach, low + 2 * reach)
            qpos[slot.q] = generator.uniform(low, high)
        qvel = np.where(moving, generator.normal(size=layout.nv), 0.0)
        torque = np.where(moving, generator.normal(size=layout.nv), 0.0)
        return State(index=index, qpos=qpos, qvel=qvel, torque=torque, moving=moving)

    return tuple(state(index) for index in range(count))


def as_drawn(layout: Layout) -> State:
    """The model as it is drawn, at rest. There a joint's axis does not shift the body behind it."""
    zero = np.zeros(layout.nv)
    moving = np.ones(layout.nv, dtype=bool)
    return State(index=-1, qpos=layout.q_drawn.copy(), qvel=zero, torque=zero, moving=moving)
