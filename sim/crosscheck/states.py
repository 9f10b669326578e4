"""Seeded random configurations, within limits, with unit quaternions."""

from __future__ import annotations

import numpy as np

from sim.crosscheck.parts import BALL, FREE, BoolArray, JointFacts, Layout, State

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
    return tuple(_random(layout, joints, moving, generator, i) for i in range(count))


def _random(
    layout: Layout,
    joints: dict[str, JointFacts],
    moving: BoolArray,
    generator: np.random.Generator,
    index: int,
) -> State:
    qpos = as_drawn(layout).qpos.copy()
    for slot in layout.joints:
        if not moving[slot.v].all():
            continue
        if slot.kind in (FREE, BALL):
            quaternion = generator.normal(size=4)
            qpos[slot.q.stop - 4 : slot.q.stop] = quaternion / np.linalg.norm(quaternion)
            if slot.kind == FREE:
                qpos[slot.q.start : slot.q.start + 3] += generator.uniform(-FLIGHT, FLIGHT, size=3)
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


def as_drawn(layout: Layout) -> State:
    """The model as it is drawn, at rest. There a joint's axis does not shift the body behind it."""
    zero = np.zeros(layout.nv)
    moving = np.ones(layout.nv, dtype=bool)
    return State(index=-1, qpos=layout.q_drawn.copy(), qvel=zero, torque=zero, moving=moving)
