"""A grasp in symbols, in which terms and objectives are written, and a grasp in numbers.

Wrenches of contacts and joint torques are expressions that terms and objectives share. Here too
are the layout of the column x of a grasp's unknowns, and modified Rodrigues parameters.

``SymbolicHand`` has placements of joints and points as expressions of q. The Pinocchio wheel on
PyPI comes without ``pinocchio.casadi``; hinges and slides need no more than Rodrigues' formula. The
twin is checked against Pinocchio and MuJoCo to 1e-10.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.kinematics import joint_axes
from planner.shapes.base import CODE_DIM, SIZE_DIM, Surface
from planner.spatial import SE3, FloatArray, skew
from planner.task import GraspTask, outermost


@dataclass(frozen=True)
class _Placement:
    """Rotation (3, 3) and translation (3,) as CasADi expressions."""

    rotation: Any
    translation: Any


class SymbolicHand:
    """Kinematics of a hand as CasADi SX expressions of a given q.

    Everything is in the hand's base frame, as in ``HandState``. With ``from_flange`` the last joint
    of the arm that carries the hand and all that it moves is in that joint's frame instead.
    """

    def __init__(self, hand: Hand, q: Any, *, from_flange: bool = False) -> None:
        """Build the placements of all joints.

        Args:
            hand: The hand.
            q: CasADi SX column (nq, 1), rad or m.
            from_flange: Whether to leave out where the arm puts its last joint, see ``flange``.
        """
        self.hand = hand
        self.q = q
        model = hand.pin_model
        axes = joint_axes(model)
        self._axes = axes
        cut = hand.arm.flange if from_flange and hand.arm is not None else 0
        self._flange = self._root = _Placement(ca.SX.eye(3), ca.SX.zeros(3))
        self._joints = [self._root]
        self._moved = [cut == 0]
        for j in range(1, model.njoints):
            parent = self._joints[model.parents[j]]
            fixed = model.jointPlacements[j]
            rotation = parent.rotation @ fixed.rotation
            translation = parent.translation + parent.rotation @ fixed.translation
            angle = q[int(model.joints[j].idx_q)]
            linear, angular = axes[j, :3], axes[j, 3:]
            if np.any(angular):
                rotation = rotation @ _rodrigues(angular, angle)
            else:
                translation = translation + rotation @ (linear * angle)
            placement = _Placement(rotation, translation)
            if j == cut:
                self._flange, placement = placement, self._root
            self._joints.append(placement)
            self._moved.append(j == cut or self._moved[model.parents[j]])

    @property
    def flange(self) -> tuple[Any, Any]:
        """Rotation (3, 3) and origin (3,) of the arm's last joint in the base, if cut there."""
        return self._flange.rotation, self._flange.translation

    def is_cut_off(self, joint_id: int) -> bool:
        """Whether a joint is upstream of the cut, in the base's frame while the hand is not."""
        return not self._moved[joint_id]

    def joint(self, joint_id: int) -> tuple[Any, Any]:
        """Rotation (3, 3) and origin (3,) of a joint's frame in the base."""
        placement = self._joints[joint_id]
        return placement.rotation, placement.translation

    def point(self, joint_id: int, local: FloatArray) -> Any:
        """A point (3,), m, fixed in a joint's frame, in the base."""
        placement = self._joints[joint_id]
        return placement.translation + placement.rotation @ np.asarray(local)

    def direction(self, joint_id: int, local: FloatArray) -> Any:
        """A direction (3,) fixed in a joint's frame, in the base."""
        return self._joints[joint_id].rotation @ np.asarray(local)

    def tip(self, finger: Finger) -> tuple[Any, Any]:
        """Rotation (3, 3) and origin (3,) of a finger's tip frame in the base."""
        frame = self.hand.pin_model.frames[finger.tip_frame_id]
        placement = self._joints[frame.parentJoint]
        return (
            placement.rotation @ frame.placement.rotation,
            placement.translation + placement.rotation @ frame.placement.translation,
        )

    def tip_jacobian(self, finger: Finger) -> Any:
        """Jacobian (6, n) of the tip frame over the finger's joints, rows as in ``HandState``."""
        _, origin = self.tip(finger)
        model = self.hand.pin_model
        columns = []
        for name in finger.joints:
            j = model.getJointId(name)
            placement = self._joints[j]
            linear = placement.rotation @ self._axes[j, :3]
            angular = placement.rotation @ self._axes[j, 3:]
            arm = origin - placement.translation
            columns.append(ca.vertcat(linear + ca.cross(angular, arm), angular))
        return ca.horzcat(*columns)

    def joint_columns(self) -> Any:
        """Twist (6, nq) [linear; angular] of what passes the origin, per velocity of each joint.

        In the frame of the joint's placement: what it moves goes at linear + angular x point.
        """
        columns = []
        for j in range(1, self.hand.pin_model.njoints):
            placement = self._joints[j]
            angular = placement.rotation @ self._axes[j, 3:]
            linear = placement.rotation @ self._axes[j, :3]
            moment = ca.cross(angular, placement.translation)
            columns.append(ca.vertcat(linear - moment, angular))
        return ca.horzcat(*columns)

    def joint_torque(self, joint_name: str, point: Any, force: Any) -> Any:
        """Torque (N m, or force in N of a slide) of a joint that presses ``force`` at ``point``.

        The static reaction tau = J^T f of one joint upstream of the point, both in the base.
        """
        j = self.hand.pin_model.getJointId(joint_name)
        placement = self._joints[j]
        linear = placement.rotation @ self._axes[j, :3]
        angular = placement.rotation @ self._axes[j, 3:]
        arm = point - placement.translation
        return ca.dot(linear + ca.cross(angular, arm), force)


def _rodrigues(axis: FloatArray, angle: Any) -> Any:
    """Rotation by ``angle`` about a unit axis: I + sin(a) K + (1 - cos(a)) K^2."""
    k = skew(axis)
    return ca.DM.eye(3) + ca.sin(angle) * k + (1 - ca.cos(angle)) * (k @ k)


@dataclass(frozen=True, kw_only=True)
class Unknowns:
    """Layout of x = [turn (3), shift (3), q, contact points (3 each), forces (3 each)].

    Attributes:
        n_joints: Number of joints.
        n_contacts: Number of fingers that take part.
    """

    n_joints: int
    n_contacts: int

    @property
    def size(self) -> int:
        """Length of x."""
        return 6 + self.n_joints + 6 * self.n_contacts

    def pack(
        self,
        turn: FloatArray,
        shift: FloatArray,
        q: FloatArray,
        points: FloatArray,
        forces: FloatArray,
    ) -> FloatArray:
        """One column (size,) of its parts; points and forces are (n_contacts, 3)."""
        return np.concatenate([turn, shift, q, np.ravel(points), np.ravel(forces)])

    def symbols(self) -> tuple[Any, Any, Any, list[Any], list[Any]]:
        """CasADi symbols of turn, shift, q, and of every contact's point and force."""
        n = range(self.n_contacts)
        return (
            ca.SX.sym("s", 3),
            ca.SX.sym("t", 3),
            ca.SX.sym("q", self.n_joints),
            [ca.SX.sym(f"p{i}", 3) for i in n],
            [ca.SX.sym(f"f{i}", 3) for i in n],
        )

    def pose(self, x: FloatArray, reference: SE3) -> SE3:
        """Pose of turn and shift of x; the turn is relative to the reference's orientation."""
        return SE3(reference.rotation @ mrp_numeric(x[:3]), x[3:6])

    def q(self, x: FloatArray) -> FloatArray:
        """Joints (n_joints,)."""
        return x[6 : 6 + self.n_joints]

    def points(self, x: FloatArray) -> FloatArray:
        """Contact points (n_contacts, 3)."""
        return x[self.point_columns].reshape(-1, 3)

    def forces(self, x: FloatArray) -> FloatArray:
        """Forces (n_contacts, 3)."""
        return x[self.point_columns.stop :].reshape(-1, 3)

    @property
    def point_columns(self) -> slice:
        """Columns of the contact points."""
        return slice(6 + self.n_joints, 6 + self.n_joints + 3 * self.n_contacts)


def mrp_matrix(s: Any) -> Any:
    """Rotation matrix of modified Rodrigues parameters: no singularity below a full turn."""
    k = ca.skew(s)
    n = ca.dot(s, s)
    return ca.SX.eye(3) + (8 * (k @ k) + 4 * (1 - n) * k) / (1 + n) ** 2


def mrp_numeric(s: FloatArray) -> FloatArray:
    """The same (3, 3) of numbers (3,)."""
    k, n = skew(s), float(s @ s)
    return np.eye(3) + (8 * (k @ k) + 4 * (1 - n) * k) / (1 + n) ** 2


def mrp_rates(s: FloatArray) -> FloatArray:
    """Turn of the matrix M, in its own axes, per change of s, (3, 3): M' dM = [rates ds]x.

    Inverse of ds = ((1 - s.s) I + 2 [s]x + 2 s s') omega / 4 (Schaub and Junkins, Analytical
    mechanics of space systems, equation 3.152).
    """
    a, b, c = s.tolist()  # written out: numpy's own takes ten times as long on three numbers
    n = a * a + b * b + c * c
    d, k = 1 - n, 4 / (1 + n) ** 2
    rates: FloatArray = k * np.array(
        [
            [d + 2 * a * a, 2 * (a * b + c), 2 * (a * c - b)],
            [2 * (a * b - c), d + 2 * b * b, 2 * (b * c + a)],
            [2 * (a * c + b), 2 * (b * c - a), d + 2 * c * c],
        ]
    )
    return rates


TINY = 1e-9
"""Keeps the root of a sum of squares differentiable at zero."""


def support(u: Any, points: list[Any], outward: list[Any], mu: Any, length: Any) -> Any:
    """Support of the round cones' unit wrenches in direction u (6,), torques over ``length``.

    max_i  g_i . n_i + mu |g_i - (g_i . n_i) n_i|,   g_i = u_f + u_t x p_i / length.
    """
    values = []
    for p, n in zip(points, outward, strict=True):
        g = u[:3] + ca.cross(u[3:], p) / length
        normal = -ca.dot(g, n)
        tangential = g + normal * n
        values.append(normal + mu * ca.sqrt(ca.sumsqr(tangential) + TINY))
    top = values[0]
    for value in values[1:]:
        top = ca.fmax(top, value)
    return top


def contact_torque(
    symbolic: SymbolicHand, finger: Finger, rotation: Any, center: Any, normal: Any, force: Any
) -> Any:
    """Joint torques (nq,) with which a finger presses ``force`` (object frame) at its contact.

    Args:
        symbolic: Kinematics.
        finger: The finger.
        rotation: Of the base in the object's frame (3, 3).
        center: Centre of the pad in the base (3,).
        normal: Outward normal, object frame (3,).
        force: On the object (3,).
    """
    point = center - finger.pad.radius * (rotation.T @ normal)
    local = rotation.T @ force
    out = ca.SX.zeros(symbolic.hand.nq)
    for name, index in zip(finger.joints, finger.q_index, strict=True):
        out[int(index)] = symbolic.joint_torque(name, point, local)
    return out


def _center(g: GraspSymbols, finger: Finger, point: Any, normal: Any) -> Any:
    """Centre (3,) of a pad; of one that reaches along a link or in a face, where it touches."""
    pad, center = finger.pad, g.symbolic.point(finger.pad.joint_id, finger.pad.center)
    wanted = g.rotation.T @ (point + pad.radius * normal - g.shift) - center
    for share, way in zip(g.shares(finger, wanted), g.reach(finger), strict=True):
        center = center + share * way
    return center


class GraspSymbols:
    """The unknowns and parameters of a grasp, and expressions that terms share: CasADi SX.

    Points, normals and forces are in the object's frame, whose origin is the centre of mass.

    Attributes:
        hand: The hand.
        fingers: Fingers that take part, in order of the contacts.
        surface: Form of the shape in the problem.
        unknowns: Layout of ``x``.
        x: All unknowns, a column.
        q: Joints (nq,).
        points: Contact points (3,) each, m.
        forces: Forces on the object (3,) each, in units of the mean normal force.
        reference: Orientation (3, 3) of the base, or of the arm's last link, at the start.
        root: Rotation (3, 3) and origin (3,) of an arm's root; None for a hand without an arm.
        size: Size of the shape, see ``Surface.size``.
        codes: Patch of each finger.
        table: Unit normal and offset d of the table: points above have n . x - d >= 0, m.
        boxes: Obstacles: rotation and translation into the obstacle's frame, half extents, m.
        mu: Friction (-).
        length: Characteristic length, m.
        grip: Normal force with which the outermost contact of each finger presses at least, N.
        mass: Of the object, kg.
        gravity: Acceleration (3,), m/s2.
        posture: Preferred joints (nq,).
        option: Margins and weights by name, see ``SynthesisOptions.values``.
        own: Parameters of single terms, see ``parameter``.
        rotation: Orientation (3, 3) of the base, or of the arm's last link.
        shift: Its origin (3,), m.
        symbolic: Kinematics at q, from the arm's last link if there is an arm.
        outward: Outward normals (3,) at the contact points.
    """

    def __init__(
        self,
        hand: Hand,
        fingers: tuple[Finger, ...],
        surface: Surface,
        n_obstacles: int,
        options: tuple[str, ...],
    ) -> None:
        """Make the symbols.

        Args:
            hand: The hand.
            fingers: Fingers that take part.
            surface: Form of the shape.
            n_obstacles: Number of obstacle boxes.
            options: Names of the margins and weights.
        """
        n = len(fingers)
        self.hand, self.fingers, self.surface = hand, fingers, surface
        self.unknowns = Unknowns(n_joints=hand.nq, n_contacts=n)
        s, self.shift, self.q, self.points, self.forces = self.unknowns.symbols()
        self.x = ca.vertcat(s, self.shift, self.q, *self.points, *self.forces)
        self.reference = ca.SX.sym("R0", 3, 3)
        self.root = (
            (ca.SX.sym("R_root", 3, 3), ca.SX.sym("t_root", 3)) if hand.arm is not None else None
        )
        self.size = ca.SX.sym("size", SIZE_DIM)
        self.codes = [ca.SX.sym(f"code{i}", CODE_DIM) for i in range(n)]
        self.table = (ca.SX.sym("table_n", 3), ca.SX.sym("table_d"))
        self.boxes = [
            (ca.SX.sym("R_ob", 3, 3), ca.SX.sym("t_ob", 3), ca.SX.sym("h_ob", 3))
            for _ in range(n_obstacles)
        ]
        self.mu, self.length = ca.SX.sym("mu"), ca.SX.sym("length")
        self.grip, self.mass = ca.SX.sym("grip"), ca.SX.sym("mass")
        self.gravity = ca.SX.sym("gravity", 3)
        self.posture = ca.SX.sym("posture", hand.nq)
        self.option = {name: ca.SX.sym(name) for name in options}
        self.own: dict[str, Any] = {}
        self.rotation = self.reference @ mrp_matrix(s)
        self.symbolic = SymbolicHand(hand, self.q, from_flange=True)
        self.outward = [
            surface.outward_normal(self.size, code, p)
            for code, p in zip(self.codes, self.points, strict=True)
        ]

    def parameter(self, name: str, size: int) -> Any:
        """A column of numbers (size,) that a term needs beside the parameters of every problem.

        It is zero unless ``GraspProblem.parameters`` is given another value by its name.

        Args:
            name: Begins with the term's name, so that no two terms mean the same.
            size: How many numbers.
        """
        return self.own.setdefault(name, ca.SX.sym(name, size))

    @property
    def parameters(self) -> dict[str, Any]:
        """Columns of the parameters, by name."""
        root = self.root
        return {
            "reference": ca.vec(self.reference),
            "root": ca.SX(0, 1) if root is None else ca.vertcat(ca.vec(root[0]), root[1]),
            "size": self.size,
            "codes": ca.vertcat(*self.codes),
            "table": ca.vertcat(*self.table),
            "obstacles": ca.vertcat(*[v for r, t, h in self.boxes for v in (ca.vec(r), t, h)]),
            "mu": self.mu,
            "grip": self.grip,
            "mass": self.mass,
            "gravity": self.gravity,
            "length": self.length,
            "posture": self.posture,
            **self.option,
            **self.own,
        }

    @cached_property
    def centers(self) -> list[Any]:
        """Centres (3,) of the pads, in the frame of the base or of the arm's last link, m."""
        contacts = zip(self.fingers, self.points, self.outward, strict=True)
        return [_center(self, *contact) for contact in contacts]

    def reach(self, finger: Finger) -> list[Any]:
        """How far (3,) the centre of a finger's pad may be from its middle, as ``centers``."""
        pad = finger.pad
        return [self.symbolic.direction(pad.joint_id, way) for way in pad.reach]

    def shares(self, finger: Finger, wanted: Any) -> list[Any]:
        """Where along each of its ways, in [-1, 1], a pad's centre is nearest to a wanted one.

        Args:
            finger: Whose pad.
            wanted: From the middle of the pad (3,), m, in the frame of ``centers``.
        """
        lengths = (finger.pad.reach**2).sum(axis=1)
        return [
            ca.fmax(-1.0, ca.fmin(1.0, ca.dot(wanted, way) / float(length)))
            for way, length in zip(self.reach(finger), lengths, strict=True)
        ]

    @cached_property
    def normal_forces(self) -> list[Any]:
        """Normal force of each finger, in units of their mean."""
        return [-ca.dot(f, n) for f, n in zip(self.forces, self.outward, strict=True)]

    @property
    def is_around(self) -> bool:
        """Whether inner links or the palm of one hand touch: forces then bear the weight too."""
        return not self.hand.pair and any(finger.is_link for finger in self.fingers)

    @property
    def weight(self) -> Any:
        """Of the object (3,), N."""
        return self.mass * self.gravity

    @cached_property
    def newtons(self) -> Any:
        """What a unit of force is, N, so that no outermost contact presses less than the grip."""
        least = ca.SX(np.inf)
        for i in outermost(self.fingers):
            least = ca.fmin(least, self.normal_forces[i])
        return self.grip / ca.fmax(least, LEAST_PRESS)

    @cached_property
    def torque(self) -> Any:
        """Joint torques (nq,) with which the fingers press these forces."""
        total = ca.SX.zeros(self.hand.nq)
        for finger, center, normal, force in zip(
            self.fingers, self.centers, self.outward, self.forces, strict=True
        ):
            total += contact_torque(self.symbolic, finger, self.rotation, center, normal, force)
        return total

    def place(self, joint_id: int, local: FloatArray) -> Any:
        """A point (3,) fixed in a joint's frame, in the object's frame, m."""
        rotation, shift = self.rotation, self.shift
        if self.root is not None and self.symbolic.is_cut_off(joint_id):
            rotation, shift = self.root
        return rotation @ self.symbolic.point(joint_id, local) + shift


@dataclass(frozen=True, kw_only=True, eq=False)
class GraspPoint:
    """A grasp in numbers: linearisation point of objectives, argument of a term's verdict.

    Attributes:
        task: The task, with the fingers that take part.
        q: Joints (nq,).
        points: Contact points (n, 3), object frame, m.
        inward: Unit normals into the object (n, 3).
        wrenches: Task wrenches (k, 6), object frame, N and N m.
    """

    task: GraspTask
    q: FloatArray
    points: FloatArray
    inward: FloatArray
    wrenches: FloatArray = field(default_factory=lambda: np.zeros((0, 6)))

    @property
    def length(self) -> float:
        """Characteristic length, m."""
        return self.task.object.shape.bounding_radius


LEAST_PRESS = 0.25
"""Least normal force of the outermost contacts (-) that the unit of force is reckoned from."""

NO_TABLE = 10.0
"""Distance (m) at which problems put the table when there is none: beyond any hand."""


def table_in_object(task: GraspTask) -> FloatArray:
    """Numbers (4,) for the table: unit normal in the object's frame, and offset, m."""
    inverse = task.T_world_object.inverse()
    normal = inverse.rotation @ np.array([0.0, 0.0, 1.0])
    if task.table_height is None:
        return np.append(normal, -NO_TABLE)
    on_table = inverse.act(np.array([0.0, 0.0, task.table_height]))
    return np.append(normal, normal @ on_table)


def obstacles_in_object(task: GraspTask) -> FloatArray:
    """Numbers (15 k,) for the obstacles: from the object's frame into that of each."""
    parts: list[FloatArray] = [np.zeros(0)]
    for obstacle in task.obstacles:
        inverse = obstacle.T_world_obstacle.inverse() * task.T_world_object
        parts += [inverse.rotation.ravel(order="F"), inverse.translation, obstacle.size / 2]
    return np.concatenate(parts)
