"""Terms of a motion beside those of its grasps, and the names of their rows.

Rolling: a round tip does not slide on the object, and its contact moves as it turns.

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

Stances: closure by the other fingers while one swings, which a stroke needs to be repeated.

A finger that swings to its next contact leaves n - 1 in stance. They close the grasp if an internal
force strictly inside their cones exists. Its forces g_j are unknowns, with the terms of a grasp:

    sum g_j = 0,  sum x_j x g_j / length = 0,  mean normal force = 1,
    (share mu g_n)^2 - |g_t|^2 >= 0,           g_n - PRESS_MIN >= 0.

x_j is the contact of finger j at a knot of its own, in the hand's frame: fingers that have swung
stand where the stroke begins, the others where it ends.

Loads of contacts and actuators that bear the weight along the path.

The forces f of a knot balance each other and are known up to a factor. The fingers press with

    F = scale f + G^+ (-w),    scale = max(grip / min_i f_i, weight / (FRICTION_SHARE mu n))

with the wrench w of the weight and normal forces f_i of mean 1. Every finger presses with the
task's grip at least, friction of all together can carry the weight, and G^+ (-w), the least forces
that balance it, are added. The solver chooses the direction of f within its cones. Required are

    load    share of its limit that an actuator spends on F  <= MOST_LOAD
    bearing FRICTION_SHARE mu F_n - |F_t|                    >= 0,   in units of the scale
    strong  MOST_PLANNED - F_n                               >= 0,   in another attitude

A grasp that is far from the centre of mass, or presses by a long lever, has forces that balance
each other, but none that also bear the weight.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.kinematics import HandState
from planner.motion.path import ObjectPath
from planner.shapes.base import CODE_DIM, SIZE_DIM, Surface
from planner.spatial import SE3, FloatArray, IntArray
from planner.synthesis.objectives import LEAST_LIMIT, LEAST_PRESS, driving
from planner.synthesis.symbols import SymbolicHand, Unknowns, contact_torque, mrp_matrix
from planner.synthesis.terms.standard import BALANCE, CONE, LEVEL, PER_METRE, PRESS, PRESS_MIN
from planner.synthesis.terms.term import Role, Row, Term
from planner.task import GraspTask
from planner.tolerances import FRICTION_SHARE, SWING_SHARE

ROLLING = Term(
    name="rolling",
    meaning="slip of each tip from knot to knot",
    role=Role.EQUALITY,
    unit="m",
    weight=PER_METRE,
    judged="slip between knots, by Pinocchio",
)

PATH = Term(
    name="path",
    meaning="path tolerance less the object's distance from its path",
    role=Role.INEQUALITY,
    unit="m",
    weight=PER_METRE,
    wording="the path tolerance",
    judged="path tolerance",
)

PIVOTING = Term(
    name="pivoting",
    meaning="turn of each tip about its contact's normal from knot to knot, where that costs",
    role=Role.COST,
    unit="rad",
    weight=12.0,
)
"""Torsional friction holds up an object that is turned against pivoting tips. With pads as wide as
the tips are round, the weight 12 turns balls of 54 and 60 mm in the Shadow-type hand with 4 to 12
mN m (6 plans), 5 with 8 to 17 mN m (7 plans); with 20 fewer starts hold."""

SWING: tuple[Term, ...] = tuple(
    replace(
        term,
        name=f"swing_{term.name}",
        meaning=f"while a finger swings, of the others' forces: {term.meaning}",
        write=None,
        wording="closure without {}",
        judged="closure at each regrasp",
    )
    for term in (BALANCE, LEVEL, CONE, PRESS)
)
"""Force closure of the stance: the contacts that hold the object while one finger swings."""

LOAD = Term(
    name="load",
    meaning="largest share of its limit that an actuator may spend, less the share it spends",
    role=Role.INEQUALITY,
    unit="-",
    weight=2.0,
    wording="load of actuator {}",
    judged="the force programme at every knot",
)
"""With this weight a motion that spends a tenth more is still worth verifying."""

BEARING = Term(
    name="bearing",
    meaning="friction less the tangential force under the weight, over the mean normal force",
    role=Role.INEQUALITY,
    unit="-",
    weight=5.0,
    wording="friction of {} under the weight",
    judged="the force programme at every knot",
)

STRONG = Term(
    name="strong",
    meaning="largest normal force in another attitude, less that under the weight, over the former",
    role=Role.INEQUALITY,
    unit="-",
    weight=5.0,
    wording="force of {} at its largest in the attitude",
    judged="the force programme at every knot",
)
"""Contacts whose heights fit the weight with the palm down press three to five times as hard with
the palm up: all of 12 grasps of the Shadow-type hand with more than 12 N (3 of 4 cylinders)."""

STEADY = Term(
    name="steady",
    meaning="second differences of the joints over the knots, over their ranges",
    role=Role.COST,
    unit="-",
    weight=1.0,
)
"""Without this cost redundant fingers take another posture at every knot."""

REACH = Term(
    name="reach",
    meaning="missing share of the path, where its length is maximised",
    role=Role.EQUALITY,
    unit="rad",
    weight=4.0,
    judged="the share is fixed before the verdict",
)
"""The weight is that of one radian, or of 35 mm (a fingertip's way in that). It makes a radian
worth some 0.1 mm of violation, which the last run of least squares takes back."""

MOTION_TERMS = (ROLLING, PATH, *SWING, LOAD, BEARING, STRONG, REACH, PIVOTING, STEADY)
"""All of them."""


def rows_of_fingers(term: Term, fingers: tuple[Finger, ...], each: int, knot: int) -> list[Row]:
    """Names of rows, ``each`` for every finger, finger by finger."""
    about = [f.name for f in fingers for _ in range(each)]
    return [term.row((name,), i, knot) for i, name in enumerate(about)]


def swing_rows(fingers: tuple[Finger, ...], swinging: int, knot: int) -> list[Row]:
    """Names of the rows of closure while one finger swings, in the order of ``StanceRows``."""
    n = len(fingers) - 1
    sizes = zip(SWING, (6, 1, n, n), strict=True)
    about = (fingers[swinging].name,)
    return [term.row(about, i, knot) for term, size in sizes for i in range(size)]


def load_rows(hand: Hand, fingers: tuple[Finger, ...], knot: int) -> list[Row]:
    """Names of the rows of loads at a knot: actuators, then contacts twice."""
    actuators = [hand.actuation.names[k] for k in driving(hand, fingers)]
    rows = [LOAD.row((name,), i, knot) for i, name in enumerate(actuators)]
    contacts = [rows_of_fingers(term, fingers, 1, knot) for term in (BEARING, STRONG)]
    return [*rows, *contacts[0], *contacts[1]]


def steady_rows(hand: Hand, knot: int) -> list[Row]:
    """Names of the rows of even motion of the joints past a knot."""
    return [STEADY.row((name,), i, knot) for i, name in enumerate(hand.joint_names)]


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


@dataclass(frozen=True, kw_only=True)
class Stance:
    """Which contacts hold the object while one finger swings.

    Attributes:
        swinging: Number of the finger that swings.
        knots: The knot at which each of all fingers stands, -1 for the last.
    """

    swinging: int
    knots: tuple[int, ...]


class StanceRows:
    """Weighted residuals of one stance, by its contacts, their forces and path parameters.

    Everything is in the object's frame where its path begins.
    """

    def __init__(self, surface: Surface, n_contacts: int) -> None:
        """Differentiate.

        Args:
            surface: Form of the object's shape; one that needs no distance field.
            n_contacts: Number of contacts in stance.
        """
        m = n_contacts
        points, forces = ca.SX.sym("x", 3 * m), ca.SX.sym("g", 3 * m)
        parameters, codes = ca.SX.sym("c", m), ca.SX.sym("codes", CODE_DIM * m)
        axis, angle, shift = ca.SX.sym("a", 3), ca.SX.sym("angle"), ca.SX.sym("d", 3)
        size, mu, length = ca.SX.sym("size", SIZE_DIM), ca.SX.sym("mu"), ca.SX.sym("length")
        total, torque, level = ca.SX.zeros(3), ca.SX.zeros(3), ca.SX.zeros(1)
        cones: list[Any] = []
        presses: list[Any] = []
        for j in range(m):
            p, g = points[3 * j : 3 * j + 3], forces[3 * j : 3 * j + 3]
            turn = mrp_matrix(axis * ca.tan(parameters[j] * angle / 4))
            code = codes[CODE_DIM * j : CODE_DIM * (j + 1)]
            pressed = -ca.dot(g, turn @ surface.outward_normal(size, code, p))
            total, torque = total + g, torque + ca.cross(turn @ p + parameters[j] * shift, g)
            level += pressed / m
            cones.append((SWING_SHARE * mu * pressed) ** 2 - ca.dot(g, g) + pressed**2)
            presses.append(pressed - PRESS_MIN)
        balance, mean, cone, press = (term.weight for term in SWING)
        rows = ca.densify(
            ca.vertcat(
                balance * total,
                balance * torque / length,
                mean * (level - 1),
                cone * ca.vertcat(*cones),
                press * ca.vertcat(*presses),
            )
        )
        jacobian = ca.densify(ca.jacobian(rows, ca.vertcat(points, forces, parameters)))
        inputs = [points, forces, parameters, axis, angle, shift, codes, size, mu, length]
        self._call = ca.Function("stance", inputs, [rows, jacobian])
        self._both: NDArray[np.bool_] = np.arange(rows.numel()) < N_EQUAL

    def __call__(
        self,
        points: FloatArray,
        forces: FloatArray,
        parameters: FloatArray,
        path: tuple[FloatArray, float, FloatArray],
        p: dict[str, FloatArray],
        codes: FloatArray,
    ) -> tuple[FloatArray, FloatArray, IntArray]:
        """Active rows (k,), their Jacobian (k, 7 m) by points, forces and parameters, and numbers.

        Args:
            points: Contact points (m, 3), each in the object's frame at its knot.
            forces: (m, 3), in units of the mean normal force.
            parameters: Path parameter of the object at the knot of each contact (m,), 0 to 1.
            path: Axis (3,), angle (rad) and shift (3,), m, of the whole path.
            p: Parameters of a grasp, by name.
            codes: Codes of the patches (m, k).
        """
        grasp = (codes.ravel(), p["size"], p["mu"], p["length"])
        found = self._call(points.ravel(), forces.ravel(), parameters, *path, *grasp)
        values, slopes = found[0].full().ravel(), found[1].full()
        counts = self._both | (values < 0.0)
        return values[counts], slopes[counts], np.flatnonzero(counts)


N_EQUAL = 7
"""Number of equality rows: force (3), torque (3) and the mean normal force."""


MOST_LOAD = 0.75
"""Largest share (-) of an actuator's limit that the contact forces may take."""

MOST_PLANNED = 9.0
"""Largest normal force (N) that is asked for in another attitude: less than the verdict allows
(``planner.motion.verify.MOST_PRESS``), so that the closed loop has something left."""

INSCRIBED = float(np.cos(np.pi / 8))
"""Share (-) of the friction that the pyramids of the verdict's force programme have: contacts that
need all of the cone's have to press harder in them."""

LEAST_GRAM = 1e-6
"""Added to G G^T (-), for contacts on a line."""

TINY = 1e-12
"""Added under the root of a squared tangential force (N^2)."""


def load_function(hand: Hand, fingers: tuple[Finger, ...]) -> Any:
    """CasADi function of a knot's grasp unknowns, R0 (9, by columns) and ``load_parameters``.

    Gives margins >= 0: ``MOST_LOAD`` less the load of every actuator of the fingers (k,) and
    then the margins of friction (n,) and of the largest force (n,), as residuals; and their
    Jacobian (k + 2 n, size).
    """
    unknowns = Unknowns(n_joints=hand.nq, n_contacts=len(fingers))
    n, at = len(fingers), 6 + hand.nq
    x, r0 = ca.SX.sym("x", unknowns.size), ca.SX.sym("R0", 3, 3)
    used = driving(hand, fingers)
    grip, carry, weight = ca.SX.sym("grip"), ca.SX.sym("carry"), ca.SX.sym("weight", 3)
    mu, length, turned = ca.SX.sym("mu"), ca.SX.sym("length"), ca.SX.sym("turned")
    per_limit = ca.SX.sym("per_limit", len(used), 2)
    symbolic = SymbolicHand(hand, x[6:at])
    rotation = r0 @ mrp_matrix(x[:3])
    normals, forces, centers, columns = [], [], [], []
    least = ca.SX(np.inf)
    for i, finger in enumerate(fingers):
        point = x[at + 3 * i : at + 3 * i + 3]
        force = x[at + 3 * n + 3 * i : at + 3 * n + 3 * i + 3]
        center = symbolic.point(finger.pad.joint_id, finger.pad.center)
        outward = rotation @ center + x[3:6] - point
        outward = outward / ca.norm_2(outward)
        least = ca.fmin(least, -ca.dot(force, outward))
        normals.append(outward)
        forces.append(force)
        centers.append(center)
        columns.append(ca.vertcat(ca.SX.eye(3), ca.skew(point) / length))
    grasp = ca.horzcat(*columns)
    gram = grasp @ grasp.T + LEAST_GRAM * ca.SX.eye(6)
    parts = ca.ldl(gram)  # fewer operations than with the default, QR
    bearing = grasp.T @ ca.ldl_solve(ca.vertcat(-weight, ca.SX.zeros(3)), *parts)
    scale = ca.fmax(grip / ca.fmax(least, LEAST_PRESS), carry)
    torque = ca.SX.zeros(hand.nq)
    friction, spared = [], []
    for i, finger in enumerate(fingers):
        pressed = scale * forces[i] + bearing[3 * i : 3 * i + 3]
        torque += contact_torque(symbolic, finger, rotation, centers[i], normals[i], pressed)
        normal = -ca.dot(pressed, normals[i])
        aside = ca.sqrt(ca.sumsqr(pressed + normal * normals[i]) + TINY)
        share = FRICTION_SHARE * (1 - turned * (1 - INSCRIBED))
        friction.append((share * mu * normal - aside) / scale)
        spared.append(turned * (1 - normal / MOST_PLANNED))
    firm = [c.row for c in hand.couplings if not c.one_sided]
    drive = np.linalg.pinv(np.column_stack([hand.actuation.moment.T, *firm]))
    effort = ca.DM(drive[used]) @ torque
    spare = MOST_LOAD - ca.fmax(effort * per_limit[:, 0], effort * per_limit[:, 1])
    contacts = [t.weight * ca.vertcat(*m) for t, m in ((BEARING, friction), (STRONG, spared))]
    out = ca.densify(ca.vertcat(LOAD.weight * spare, *contacts))
    parameters = ca.vertcat(grip, carry, mu, length, turned, weight, ca.vec(per_limit))
    jacobian = ca.densify(ca.jacobian(out, x))
    return ca.Function("loads", [x, ca.vec(r0), parameters], [out, jacobian])


def load_parameters(
    task: GraspTask, path: ObjectPath, path_parameters: FloatArray, q: FloatArray
) -> FloatArray:
    """Parameters (n_knots, m) of ``load_function`` along a path.

    The weight turns in the object's frame as if the whole path were covered.

    Args:
        task: The task.
        path: Where the object is to go.
        path_parameters: Of each knot (n_knots,), 0 to 1.
        q: Joints (nq,) at which the actuators' limits are taken.
    """
    used = driving(task.hand, task.fingers)
    low, high = task.hand.actuation.force_limits(q)[used].T
    low, high = np.minimum(low, -LEAST_LIMIT), np.maximum(high, LEAST_LIMIT)
    weight = task.object.mass * path.borne(task).gravity
    carry = float(np.linalg.norm(weight)) / (FRICTION_SHARE * task.mu * len(task.fingers))
    length, to_object = task.object.shape.bounding_radius, task.T_world_object.rotation.T
    return np.array(
        [
            np.concatenate(
                [
                    [task.grip_force, carry, task.mu, length, float(path.turns_wrist)],
                    to_object @ pin.exp3(-c * path.angle * path.axis) @ weight,
                    1 / low,
                    1 / high,
                ]
            )
            for c in path_parameters
        ]
    )
