"""The term of actuators: what presses an object into the hand must be in their power.

The verdict's force programme decides; here the forces of the problem alone count, so that contacts
and joints move to where they can be made. Written for grasps with inner links or a palm: a hand
that closes around an object may end where a servo's range ends, and its force with it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import casadi as ca
import numpy as np

from planner.synthesis.symbols import GraspSymbols
from planner.synthesis.terms.standard import LEVER, transmission
from planner.synthesis.terms.term import Role, Rows, Term


def _effort(g: GraspSymbols) -> Iterator[Rows]:
    """Actuator forces F = pinv(R^T) (J^T f - passive) within their limits, both ways."""
    if not g.is_around:
        return
    a = g.hand.actuation
    columns, stops = transmission(g)
    drive = np.linalg.pinv(np.column_stack([columns, *(c.row for c in stops)]))[: len(a.names)]
    passive = ca.DM(a.spring_torque) - ca.DM(a.stiffness) @ g.q
    force = ca.DM(drive) @ (g.newtons * g.torque + _of_wrist(g) - passive)
    offset = a.bias[:, 0] + a.bias[:, 1] * (a.length0 + ca.DM(a.moment) @ g.q)
    ends = np.sort(a.gain[:, None] * a.ctrl_range, axis=1)
    used = {int(j): f.name for f in g.fingers for j in f.q_index}
    used.update((int(j), "wrist") for j in g.hand.wrist_index)
    for i in range(len(a.names)):
        about = [used[j] for j in np.flatnonzero(a.moment[i]).tolist() if j in used]
        if not about:
            continue
        for sign, end, most in zip((-1.0, 1.0), ends[i], a.force_range[i], strict=True):
            if np.isinf(end) and np.isinf(most):
                continue
            reach = sign * (float(end) + offset[i]) if np.isfinite(end) else np.inf
            room = ca.fmin(reach, sign * float(most)) - sign * force[i]
            yield Rows(expression=room / (LEVER * g.newtons), about=tuple(dict.fromkeys(about)))


def _of_wrist(g: GraspSymbols) -> Any:
    """Torques (nq,) with which the wrist's joints bear the object and the hand beyond them."""
    out, model = ca.SX.zeros(g.hand.nq), g.hand.pin_model
    weight, gravity = g.rotation.T @ g.weight, g.rotation.T @ g.gravity
    center = -g.rotation.T @ g.shift  # the object's, in the base
    for j in g.hand.wrist_index.tolist():
        name = model.names[j + 1]
        out[j] = g.symbolic.joint_torque(name, center, -weight)
        for k in range(1, model.njoints):
            if g.hand.moved_by[k, j]:
                part = model.inertias[k]
                at = g.symbolic.point(k, part.lever)
                out[j] += g.symbolic.joint_torque(name, at, -part.mass * gravity)
    return out


EFFORT = Term(
    name="effort",
    meaning=f"room of each actuator beside the forces, over the torque of a unit at {LEVER:g} m",
    role=Role.INEQUALITY,
    unit="-",
    weight=10.0,
    margin=0.05,
    write=_effort,
    wording="an actuator of {} at its limit",
    judged="the force programme",
    lacking=(
        "the hand's actuators do not press with the grip where its links meet the object; less "
        "mass or grip, more friction, another size or pose, fingertips alone"
    ),
)
