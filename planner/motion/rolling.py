"""Rolling: a round tip does not slide on the object, and its contact moves as it turns.

In the object's frame let c be the centre of a pad of radius r, n the outward normal at the
contact, and w the tip's angular velocity. The point of the tip at the contact is at rest if

    dc/dt = r w x n

(Montana 1988, The kinematics of contact and grasp, for a sphere). Between two knots, with the
rotation vector v from one orientation of the tip to the next and n in the middle of both:

    c' - c - r v x n = 0    along the tangents.

The chord of a turn by v differs from its arc by |v|^2/24, so this is right to 1 % for 30 degrees
between knots. A turn about the normal, v . n, is free: the contact pivots. Torsional friction
resists it: a force of 10 N on a patch of 5 mm gives 0.05 N m, as much as a hand can exert about a
small object. Pivoting therefore has a cost on balls, and where objects are tilted or moved.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin

from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.kinematics.state import HandState
from planner.kinematics.symbolic import SymbolicHand
from planner.spatial import SE3, FloatArray
from planner.synthesis.unknowns import Unknowns, mrp_matrix


def rolling_function(hand: Hand, fingers: tuple[Finger, ...]) -> Any:
    """CasADi function of two knots' grasp unknowns and R0 (9, by columns).

    Gives the slip of each pad (3 n,), m, object frame, and its Jacobian by both, (3 n, 2 size).
    """
    return _between_knots(hand, fingers)[0]


def pivoting_function(hand: Hand, fingers: tuple[Finger, ...]) -> Any:
    """The same for the turn of each tip about its contact's normal, (n,), rad."""
    return _between_knots(hand, fingers)[1]


def _between_knots(hand: Hand, fingers: tuple[Finger, ...]) -> tuple[Any, Any]:
    unknowns = Unknowns(n_joints=hand.nq, n_contacts=len(fingers))
    first, second = (ca.SX.sym(name, unknowns.size) for name in ("x0", "x1"))
    r0 = ca.SX.sym("R0", 3, 3)
    before = _tips(hand, fingers, unknowns, r0, first)
    after = _tips(hand, fingers, unknowns, r0, second)
    rows, pivots = [], []
    for finger, (c0, r_0, p0), (c1, r_1, p1) in zip(fingers, before, after, strict=True):
        normal = c0 - p0 + c1 - p1
        normal = normal / ca.norm_2(normal)
        turn = _rotation_vector(r_1 @ r_0.T)
        gone = c1 - c0 - finger.pad.radius * ca.cross(turn, normal)
        rows.append(gone - normal * ca.dot(normal, gone))
        pivots.append(ca.dot(turn, normal))
    inputs, both = [first, second, ca.vec(r0)], ca.vertcat(first, second)
    rolled, pivoted = (
        ca.Function(name, inputs, [ca.densify(out), ca.densify(ca.jacobian(out, both))])
        for name, out in (("rolling", ca.vertcat(*rows)), ("pivoting", ca.vertcat(*pivots)))
    )
    return rolled, pivoted


def _tips(
    hand: Hand, fingers: tuple[Finger, ...], unknowns: Unknowns, r0: Any, x: Any
) -> list[tuple[Any, Any, Any]]:
    """Centre and orientation of every pad, and its contact point, in the object's frame."""
    n, at = len(fingers), 6 + unknowns.n_joints
    symbolic = SymbolicHand(hand, x[6:at])
    base = r0 @ mrp_matrix(x[:3])
    points = [x[at + 3 * i : at + 3 * i + 3] for i in range(n)]
    return [
        (
            base @ symbolic.point(f.pad.joint_id, f.pad.center) + x[3:6],
            base @ symbolic.joint(f.pad.joint_id)[0],
            point,
        )
        for f, point in zip(fingers, points, strict=True)
    ]


def _rotation_vector(rotation: Any) -> Any:
    """Rotation vector (3,) of a rotation by less than a radian: to 1e-3 of its length."""
    twice = ca.inv_skew(rotation - rotation.T)
    u = (3 - ca.trace(rotation)) / 2  # 1 - cos
    # angle / sin(angle) as a series in 1 - cos(angle)
    return twice / 2 * (1 + u / 3 + 2 * u**2 / 15 + 2 * u**3 / 35)


def slips(
    hand: Hand,
    fingers: tuple[Finger, ...],
    bases: tuple[SE3, SE3],
    postures: tuple[FloatArray, FloatArray],
    normals: tuple[FloatArray, FloatArray],
) -> FloatArray:
    """How far (n,), m, each pad slides between two placements, by Pinocchio.

    Args:
        hand: The hand.
        fingers: The fingers that touch.
        bases: Pose of the base in the object's frame, before and after.
        postures: Joints (nq,), before and after.
        normals: Outward unit normals (n, 3) at the contacts, object frame, before and after.
    """
    states = [HandState(hand, q) for q in postures]
    out = []
    for i, finger in enumerate(fingers):
        pad = finger.pad
        old, new = (
            base * state.joint_pose(pad.joint_id) for base, state in zip(bases, states, strict=True)
        )
        normal = normals[0][i] + normals[1][i]
        normal /= np.linalg.norm(normal)
        turn = pin.log3(new.rotation @ old.rotation.T)
        gone = new.act(pad.center) - old.act(pad.center) - pad.radius * np.cross(turn, normal)
        out.append(float(np.linalg.norm(gone - normal * (normal @ gone))))
    return np.array(out)
