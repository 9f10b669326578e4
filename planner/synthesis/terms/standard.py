"""The terms of contact, forces and joints, which every problem has.

Pads touch the surface off its edges, around the centre of mass. An internal force is strictly
inside all friction cones, and borne by the stops; couplings, the arm that carries the hand, and the
preferred posture bind the joints.

An internal force strictly inside all cones together with rank G = 6 is force closure (Murray, Li,
Sastry 1994, proposition 5.3); rank follows from three contacts that are not on a line.
"""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca
import numpy as np

from planner.joints.couplings import Coupling
from planner.spatial import FloatArray
from planner.synthesis.symbols import GraspSymbols
from planner.synthesis.terms.term import Role, Rows, Term
from planner.task import outermost

PER_METRE = 1e3
"""Weight of a length: a millimetre is one unit of residual."""

COST_WEIGHT = 0.2
"""Weight of the root of a cost, which ranks grasps but must not outweigh contact. With half of it
forces are infeasible more often, with twice of it least squares take more iterations."""

EDGE_WEIGHT = 20.0
"""Weight of the shortfall of the smooth distance's slope at a contact: 0.2 at an edge."""


def _touch(g: GraspSymbols) -> Iterator[Rows]:
    for finger, center, point, normal in zip(
        g.fingers, g.centers, g.points, g.outward, strict=True
    ):
        apart = finger.pad.radius - g.surface.skin(g.size)
        gap = g.rotation @ center + g.shift - point - apart * normal
        yield Rows(expression=gap, about=(finger.name,))


def _surface(g: GraspSymbols) -> Iterator[Rows]:
    for finger, code, point in zip(g.fingers, g.codes, g.points, strict=True):
        error = g.surface.surface_error(g.size, code, point)
        if error is not None:
            yield Rows(expression=error, about=(finger.name,))


def _facing(g: GraspSymbols) -> Iterator[Rows]:
    for finger, normal in zip(g.fingers, g.outward, strict=True):
        axis = g.rotation @ g.symbolic.direction(finger.pad.joint_id, finger.pad.axis)
        rim = max(finger.pad.half_angle - g.surface.normal_error, 0.0)
        yield Rows(expression=-ca.dot(axis, normal) - float(np.cos(rim)), about=(finger.name,))


def _along(g: GraspSymbols) -> Iterator[Rows]:
    """Both ends of a line that touches are outside of the plane that is tangent at its contact.

    The end at share 1 is (1 - s) a . n above it where the contact is at share s of the way a.
    """
    for finger, center, normal in zip(g.fingers, g.centers, g.outward, strict=True):
        middle = g.symbolic.point(finger.pad.joint_id, finger.pad.center)
        shares = g.shares(finger, center - middle)
        for share, way in zip(shares, g.reach(finger), strict=True):
            slope = ca.dot(g.rotation @ way, normal)
            rows = ca.vertcat((1 - share) * slope, -(1 + share) * slope)
            yield Rows(expression=rows, about=(finger.name,))


def _edge(g: GraspSymbols) -> Iterator[Rows]:
    for finger, point in zip(g.fingers, g.points, strict=True):
        flatness = g.surface.flatness(g.size, point)
        if flatness is not None:
            yield Rows(expression=flatness, about=(finger.name,))


def _center(g: GraspSymbols) -> Iterator[Rows]:
    middle = sum(g.points[1:], g.points[0]) / len(g.points)
    yield Rows(expression=ca.sqrt(g.option["weight_center"]) * middle / g.length)


TOUCH = Term(
    name="touch",
    meaning="pad centre c_i(q) - (p_i + r_i n_i): one radius off the surface",
    role=Role.EQUALITY,
    unit="m",
    weight=PER_METRE,
    write=_touch,
    judged="pad within 0.5 mm of the true surface",
    lacking=(
        "the fingers do not reach the surface as it lies; raise or turn the object, or take "
        "other fingers or another size"
    ),
)

SURFACE = Term(
    name="surface",
    meaning="g(p_i): contact point on its patch",
    role=Role.EQUALITY,
    unit="m",
    weight=PER_METRE,
    write=_surface,
    judged="contacts are computed on the true surface",
    lacking=(
        "contacts would have to lie beside the faces; the faces are too small or do not oppose "
        "each other within reach: another pose, other fingers, a larger object"
    ),
)

FACING = Term(
    name="facing",
    meaning="pad axis . -n_i - cos(half angle): the pad touches, not the nail",
    role=Role.INEQUALITY,
    unit="-",
    weight=20.0,
    margin=0.02,
    write=_facing,
    wording="{} at the rim of its pad",
    judged="pad angle to the true normal",
    lacking=(
        "the fingers reach the object with nail or side, not with their pads; another pose or "
        "size, or other fingers"
    ),
)

ALONG = Term(
    name="along",
    meaning="height of both ends of a link or face over the tangent plane at its contact",
    role=Role.INEQUALITY,
    unit="m",
    weight=PER_METRE,
    write=_along,
    wording="{} beside its contact",
    judged="whole link within 0.5 mm of the true surface",
    lacking="links meet the object with an edge or an end; a rounder or smaller object",
)

EDGE = Term(
    name="edge",
    meaning="slope of a mesh's smooth distance at a contact, short of flat",
    role=Role.COST_BELOW_ZERO,
    unit="-",
    weight=EDGE_WEIGHT,
    write=_edge,
    judged="spread of the true normals around a contact",
)

CENTER = Term(
    name="center",
    meaning="mean contact point over the characteristic length, times the root of weight_center",
    role=Role.COST,
    unit="-",
    weight=COST_WEIGHT,
    write=_center,
)


PRESS_MIN = 0.25
"""Smallest normal force of a finger over the mean normal force (-)."""

TOUCH_MIN = 0.05
"""The same of an inner link or the palm, onto which others press (-)."""

LEVER = 0.05
"""Typical lever arm of a fingertip force, m; makes stop torques comparable to unit forces."""

ALIGNED_TOL = 1e-9
"""Share (-) of a stop outside the range of actuators and couplings below which they bear it."""


def _balance(g: GraspSymbols) -> Iterator[Rows]:
    pairs = zip(g.points, g.forces, strict=True)
    torque = sum((ca.cross(p, f) for p, f in pairs), ca.SX.zeros(3))
    total = sum(g.forces[1:], g.forces[0])
    yield Rows(expression=total + g.weight / g.newtons if g.is_around else total)
    yield Rows(expression=torque / g.length)


def _level(g: GraspSymbols) -> Iterator[Rows]:
    normal = g.normal_forces
    yield Rows(expression=sum(normal[1:], normal[0]) / len(normal) - 1)


def _cone(g: GraspSymbols) -> Iterator[Rows]:
    for finger, force, normal in zip(g.fingers, g.forces, g.normal_forces, strict=True):
        tangential = ca.dot(force, force) - normal**2
        most = (g.option["cone_share"] * g.mu * normal) ** 2
        yield Rows(expression=most - tangential, about=(finger.name,))


def _press(g: GraspSymbols) -> Iterator[Rows]:
    pressing = outermost(g.fingers) if g.is_around else range(len(g.fingers))
    for i, (finger, normal) in enumerate(zip(g.fingers, g.normal_forces, strict=True)):
        least = PRESS_MIN if i in pressing else TOUCH_MIN
        yield Rows(expression=normal - least, about=(finger.name,))


def transmission(g: GraspSymbols) -> tuple[FloatArray, list[Coupling]]:
    """What bears joint torques: columns (nq, k) of R^T, then of two-sided couplings C^T; and stops.

    The stops are the one-sided couplings of the fingers that bear what those columns cannot.
    """
    hand = g.hand
    moving = {int(i) for f in g.fingers for i in f.q_index}
    firm = [c.row for c in hand.couplings if not c.one_sided]
    drive = np.column_stack([hand.actuation.moment.T, *firm])
    rest = np.eye(hand.nq) - drive @ np.linalg.pinv(drive)
    stops = [c for c in hand.couplings if c.one_sided and set(np.flatnonzero(c.row)) <= moving]
    return drive, [c for c in stops if np.linalg.norm(rest @ c.row) > ALIGNED_TOL]


def _stop(g: GraspSymbols) -> Iterator[Rows]:
    """Multiplier of each one-sided coupling: tau = R^T F + C^T mu + S^T lam, by least squares.

    A stop bears the torque that actuators (F) and two-sided couplings (mu) cannot; a stop in their
    range has no row.
    """
    drive, used = transmission(g)
    if not used:
        return
    rest = np.eye(g.hand.nq) - drive @ np.linalg.pinv(drive)
    moving = {int(i): f.name for f in g.fingers for i in f.q_index}
    left = np.linalg.pinv(np.column_stack([rest @ c.row for c in used]))
    multipliers = ca.DM(left) @ g.torque / LEVER
    for k, stop in enumerate(used):
        joints = np.flatnonzero(stop.row)
        names = dict.fromkeys(moving[int(i)] for i in joints)
        yield Rows(expression=multipliers[k], about=tuple(names))


def _forces(g: GraspSymbols) -> Iterator[Rows]:
    n = len(g.fingers)
    for finger, force, outward, normal in zip(
        g.fingers, g.forces, g.outward, g.normal_forces, strict=True
    ):
        tangential = force + normal * outward
        aside = ca.sqrt(g.option["weight_tangential"] / n) / g.mu * tangential
        uneven = ca.sqrt(g.option["weight_share"] / n) * (normal - 1)
        yield Rows(expression=ca.vertcat(aside, uneven), about=(finger.name,))


CLOSURE = "force closure and the force programme"

BALANCE = Term(
    name="balance",
    meaning="sum f_i and sum p_i x f_i / length: an internal force; with links the weight too",
    role=Role.EQUALITY,
    unit="-",
    weight=20.0,
    write=_balance,
    judged=CLOSURE,
    lacking=(
        "the forces of these fingers do not cancel, since their contacts do not oppose each "
        "other; a narrower object, other fingers, more friction"
    ),
)

LEVEL = Term(
    name="level",
    meaning="mean of the normal forces f_i . -n_i, less 1",
    role=Role.EQUALITY,
    unit="-",
    weight=20.0,
    write=_level,
    lacking=(
        "these fingers cannot balance a grip here, whatever they press with, and the solver "
        "lets go; a smaller or differently turned object, fingers that oppose each other, more "
        "friction"
    ),
)

CONE = Term(
    name="cone",
    meaning="(cone_share mu fn_i)^2 - |ft_i|^2: strictly inside every friction cone",
    role=Role.INEQUALITY,
    unit="-",
    weight=20.0,
    write=_cone,
    wording="force of {} at the edge of its cone",
    judged=CLOSURE,
    lacking=(
        "the grip holds only with more friction than there is; more friction, a place whose "
        "faces oppose each other, other fingers"
    ),
)

PRESS = Term(
    name="press",
    meaning=f"fn_i - {PRESS_MIN:g}, of inner links and palm - {TOUCH_MIN:g}: every finger presses",
    role=Role.INEQUALITY,
    unit="-",
    weight=20.0,
    write=_press,
    wording="force of {} at its least",
    judged=CLOSURE,
    lacking=(
        "one of the fingers cannot press against the others; leave it out, or take a smaller object"
    ),
)

STOP = Term(
    name="stop",
    meaning=f"torque of each one-sided stop over {LEVER:g} m: a stop can only push",
    role=Role.INEQUALITY,
    unit="-",
    weight=10.0,
    write=_stop,
    wording="a stop that can only push",
    judged="the force programme",
    lacking="a coupled joint would have to pull at its stop; other fingers, another pose",
)

FORCES = Term(
    name="forces",
    meaning="ft_i / mu and fn_i - 1, times the roots of weight_tangential and weight_share",
    role=Role.COST,
    unit="-",
    weight=COST_WEIGHT,
    write=_forces,
)


ARM_POSTURE = 1e-3
"""Cost (-) of an arm's joint that leaves its start, over that of a finger's joint that leaves the
pinch posture, per share of their ranges. The start comes from inverse kinematics that begins at the
ready posture; with the ready posture itself as the target fewer attempts are solved."""


def _coupling(g: GraspSymbols) -> Iterator[Rows]:
    matrix, value = g.hand.coupling_matrix
    if len(value):
        yield Rows(expression=ca.DM(matrix) @ g.q - value)


def _arm(g: GraspSymbols) -> Iterator[Rows]:
    if g.root is None:
        return
    turn, origin = g.symbolic.flange
    apart = g.rotation.T @ g.root[0] @ turn
    yield Rows(expression=g.root[0] @ origin + g.root[1] - g.shift)
    yield Rows(expression=ca.inv_skew(apart - apart.T) / 2)


def _posture(g: GraspSymbols) -> Iterator[Rows]:
    span = g.hand.q_upper - g.hand.q_lower
    span[g.hand.arm_index] /= np.sqrt(ARM_POSTURE)
    n_hand = g.hand.nq - len(g.hand.arm_index)
    root = ca.sqrt(g.option["weight_posture"] / n_hand)
    yield Rows(expression=root * (g.q - g.posture) / span)


COUPLING = Term(
    name="coupling",
    meaning="C q - d",
    role=Role.EQUALITY,
    unit="rad",
    weight=50.0,
    write=_coupling,
    judged="couplings hold",
    lacking=(
        "joints that move together cannot both be where they would have to be; another size or "
        "pose, other fingers"
    ),
)

ARM = Term(
    name="arm",
    meaning="offset and sine of the turn of the arm's last link from where s and t put it",
    role=Role.EQUALITY,
    unit="m",
    weight=PER_METRE,
    write=_arm,
    judged="the verdict computes the base from the joints",
    lacking="the arm does not bring the hand there; put the object nearer, or free its pose",
)

POSTURE = Term(
    name="posture",
    meaning="q less the preferred posture over the range, times the root of weight_posture",
    role=Role.COST,
    unit="-",
    weight=COST_WEIGHT,
    write=_posture,
)
