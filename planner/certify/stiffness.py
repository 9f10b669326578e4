"""How a grasp gives way while position servos alone hold it: stable or buckling, and under a load.

Servos that are commanded one posture are springs about it, and the object hangs on them by contacts
that neither slide nor part but roll. With x = [object's shift and rotation (6), joints (nq)], all
small, the forces that bring the hand and object back are K x,

    K = E^T K_s E + sum_i B_i^T k B_i + s sum_i (L_i + H_i - W_i^T [f_i] A_i [n_i] W_i),

    E       x -> joints; K_s the servos' stiffness R^T k R, springs, and stops that carry
    B_i     x -> movement of object against tip at contact i, and spin about its normal
    L_i     lever: the contact turns with the object, its force does not: -[f_i] [r_i] on rotations
    H_i     the same of the finger's links: second derivative of f_i . p_i in the joints
    W_i     x -> rotation of object against tip; A_i = (S_object + S_tip)^-1 in the tangent plane, S
            the surfaces' curvature: rolling by W x moves the contact by A n x W x (Montana 1988)

for forces s f_i. The first line is a spring that no force weakens; the others grow with the force
(Cutkosky and Kao 1989; Howard and Kumar 1996). The servos' part falls with the square of the
object's size and the levers' with its size: a small object that is pressed hard turns aside, the
less, the flatter it and the tips are.

Where friction is a damper, as in simulations that regularise it, a contact slides by s with s' = -c
f_t. Sliding carries the contact over both surfaces, by A S_tip s over the object, so that levers
and normals change. Where that leads to no balance, what springs would hold turns aside slowly.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from scipy.linalg import block_diag, eigh, expm

from planner.errors import PlannerError
from planner.forces import ForceSolution
from planner.shapes import Shape
from planner.spatial import SE3, FloatArray, skew
from planner.task import GraspTask
from planner.verification import force_arguments

__all__ = ["GraspStiffness"]

CONTACT, SPIN = 1e5, 10.0
"""Stiffness of a contact against sliding (N/m) and spinning (N m/rad): far above those of servos,
some 1e3 N/m and 0.1 N m/rad seen from the object, and low enough for a matrix that is inverted."""

STOP = 20.0
"""Stiffness of a stop that carries, N m/rad: bent by 0.01 rad by the torque of a firm grip."""

SOFTEST = 0.001
"""Stiffness (N m/rad) of a joint without a servo, which keeps matrices invertible."""

NEAR = 5e-4
"""Distance (m) over which a surface's curvature is taken: a contact is that small."""

FLATTEST = 20.0
"""Least sum of both curvatures, 1/m: flat pads on flat faces roll no further than to their edge."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GraspStiffness:
    """K of the module for n contacts, N = 6 + nq.

    Attributes:
        springs: Its first line (N, N), N/m and N m/rad.
        bending: The others for the forces as they are (N, N), symmetric.
        rows: B (n, 4, N): along normal and tangents, and spin.
        shifts: (2n, N), what the forces do per metre by which a contact is along a tangent of where
            it should be.
        forces: Of the contacts (n, 4), N and N m, in contact frames.
        slips: (2n, N), what the forces do per metre by which the object slides along a tangent.
        tilts: (2n, N), how much of a normal force comes to lie along a tangent.
        tilted: (2n, 2n), the same per metre of sliding, N/m.
    """

    springs: FloatArray
    bending: FloatArray
    rows: FloatArray
    shifts: FloatArray
    forces: FloatArray
    slips: FloatArray
    tilts: FloatArray
    tilted: FloatArray

    @classmethod
    def of(
        cls, task: GraspTask, forces: ForceSolution, T_world_base: SE3, q: FloatArray
    ) -> GraspStiffness:
        """Of a grasp.

        Args:
            task: Gives the hand, whose actuators are servos, and the object where the contacts are.
            forces: Of its contacts, world, one per finger of the task.
            T_world_base: Base pose.
            q: Joints (nq,).
        """
        contacts, actuation = forces.contacts, task.hand.actuation
        still = replace(task, gravity=np.zeros(3))
        given = force_arguments(still, contacts, T_world_base, q)["jacobians"]
        nq, n = task.hand.nq, len(contacts)
        linear, angular = np.asarray(given).reshape(n, 2, 3, nq).transpose(1, 0, 2, 3)
        arms = np.array([skew(r) for r in contacts.positions - contacts.center])
        one, none = np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3, 3))
        moves = np.concatenate([one, -arms, -linear], axis=2)
        turns = np.concatenate([none, one, -angular], axis=2)
        axes = contacts.frames.transpose(0, 2, 1)
        rows = np.concatenate([axes @ moves, axes[:, :1] @ turns], axis=1)
        flat = (rows * np.sqrt([CONTACT] * 3 + [SPIN])[:, None]).reshape(4 * n, -1)
        springs = flat.T @ flat
        stops = actuation.stop_rows[forces.stop_forces > 0.0]
        servos = actuation.moment.T @ (-actuation.bias[:, 1, None] * actuation.moment)
        springs[6:, 6:] += servos + actuation.stiffness + SOFTEST * np.eye(nq)
        springs[6:, 6:] += STOP * stops.T @ stops
        bending = np.zeros_like(springs)
        pushes = contacts.forces_in_axes()[:, :3]
        shifts = np.cross(axes[:, 1:], pushes[:, None]) @ turns
        to_object = task.T_world_object.inverse()
        curved = _curvatures(
            task.object.shape,
            contacts.positions @ to_object.rotation.T + to_object.translation,
            to_object.rotation @ contacts.frames[:, :, 1:],
        )
        tips = _tips(task, T_world_base, q, contacts.frames[:, :, 1:])
        compliance = _rolling(curved + tips, contacts.frames)
        slips, tilts, tilted = np.zeros((n, 2, 6 + nq)), np.zeros((n, 2, 6 + nq)), []
        for i, f in enumerate(pushes):
            tangents, normal = contacts.frames[i, :, 1:], contacts.normals[i]
            ways = tangents.T @ compliance[i] @ tangents  # A in the tangent plane
            over, under = ways @ tips[i], ways @ curved[i]
            slips[i, :, 3:6] = -(tangents @ over).T @ skew(f)
            slips[i, :, 6:] = -(tangents @ under).T @ skew(f) @ angular[i]
            tilts[i, :, 3:6] = np.cross(normal, tangents, axis=0).T
            tilts[i] += curved[i] @ ways @ tangents.T @ skew(normal) @ turns[i]
            tilts[i] *= forces.forces[i, 0]
            tilted.append(forces.forces[i, 0] * curved[i] @ over)
            bending[3:6, 3:6] -= skew(f) @ arms[i]
            # f . (a_k x J_j) for k before j on the finger: moved by both
            second = np.triu(angular[i].T @ np.cross(linear[i], f, axis=0))
            bending[6:, 6:] += second + np.triu(second, 1).T
            bending -= turns[i].T @ skew(f) @ compliance[i] @ skew(contacts.normals[i]) @ turns[i]
        return cls(
            springs=springs,
            bending=(bending + bending.T) / 2,
            rows=rows,
            shifts=shifts.reshape(2 * n, -1),
            forces=np.array(forces.forces),
            slips=slips.reshape(2 * n, -1),
            tilts=tilts.reshape(2 * n, -1),
            tilted=block_diag(*tilted),
        )

    @property
    def buckling(self) -> float:
        """Factor (-) of the forces at which the grasp is no longer stable; infinite if none is."""
        try:
            least = float(eigh(self.bending, self.springs, eigvals_only=True)[0])
        except (np.linalg.LinAlgError, ValueError) as error:  # not positive definite, or NaN
            raise PlannerError(
                "the grasp has no positive stiffness without load; servos whose force grows with "
                "their error away from it are not supported"
            ) from error
        return -1.0 / least if least < 0.0 else float("inf")

    def under(
        self, factor: float, wrenches: FloatArray, misplaced: float
    ) -> tuple[FloatArray, FloatArray]:
        """How contact forces change and all moves, held at ``factor`` times the forces.

        Args:
            factor: Below ``buckling``.
            wrenches: On the object about its centre of mass (m, 6), N and N m, world axes.
            misplaced: Distance (m) by which a tip is out of place along its normal, or a contact
                along a tangent.

        Returns:
            Changes (m + 3n, n, 4), N and N m in contact frames, and movements x (m + 3n, N): under
            every wrench, with every tip out of place, with every contact along both tangents.
        """
        n, _, size = self.rows.shape
        m, k = len(wrenches), np.tile([CONTACT] * 3 + [SPIN], n)
        flat = self.rows.reshape(4 * n, size)
        gone = np.zeros((n, 4 * n))
        gone[np.arange(n), 4 * np.arange(n)] = misplaced
        pushed = np.vstack(
            [
                np.pad(wrenches, ((0, 0), (0, size - 6))),
                (gone * k) @ flat,
                factor * misplaced * self.shifts,
            ]
        )
        moved = np.linalg.solve(self.springs + factor * self.bending, pushed.T).T
        gaps = moved @ flat.T
        gaps[m : m + n] -= gone
        return (-gaps * k).reshape(len(moved), n, 4), moved

    def crept(
        self, factor: float, wrenches: FloatArray, misplaced: float, slides: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """The same after contacts have crept; a first row tells what pressing alone changes.

        Args:
            factor: As in ``under``.
            wrenches: As there; its rows follow, each in addition.
            misplaced: As there.
            slides: How far a contact slides along both tangents and spins in that time (n, 3),
                against a constant force of one, m/N and rad/(N m).

        Returns:
            Changes (1 + m + 3n, n, 4), in the frames of the contacts to which they have slid, and
            rotations (1 + m + 3n, 3).
        """
        n, _, size = self.rows.shape
        changes, moved = self.under(factor, wrenches, misplaced)
        moved = np.vstack([np.zeros((1, size)), moved])
        changes = np.vstack([np.zeros((1, 4 * n)), changes.reshape(-1, 4 * n)])
        along = (4 * np.arange(n)[:, None] + [1, 2, 3]).reshape(-1)
        plane = np.arange(3 * n).reshape(n, 3)[:, :2].reshape(-1)  # without spin
        k, flat = np.tile([CONTACT] * 2 + [SPIN], n), self.rows.reshape(4 * n, size)
        pushed, tilts, tilted = k[:, None] * flat[along], np.zeros((3 * n, size)), np.diag(k)
        pushed[plane] += factor * self.slips
        tilts[plane] = factor * self.tilts
        tilted[np.ix_(plane, plane)] -= factor * self.tilted
        by_sliding = np.linalg.solve(self.springs + factor * self.bending, pushed.T)
        left = tilted - (k[:, None] * flat[along] + tilts) @ by_sliding
        pulls = changes[:, along] - moved @ tilts.T
        pulls[0] += factor * self.forces[:, 1:].reshape(-1)
        c, still = slides.reshape(-1, 1), np.zeros((3 * n, 3 * n))
        steps = expm(np.block([[-c * left, np.eye(3 * n)], [still, still]]))[: 3 * n, 3 * n :]
        slid = -(steps @ (c * pulls.T)).T
        changes[:, along] = pulls + slid @ left.T
        changes[0, along] -= factor * self.forces[:, 1:].reshape(-1)
        changes[:, ::4] -= CONTACT * slid @ by_sliding.T @ flat[::4].T
        moved += slid @ by_sliding.T
        return changes.reshape(len(moved), n, 4), moved[:, 3:6]


def _tips(task: GraspTask, T_world_base: SE3, q: FloatArray, tangents: FloatArray) -> FloatArray:
    """Curvature (n, 2, 2), 1/m, of the pads along two tangents (n, 3, 2), world; 0 along reach."""
    data = task.hand.pin_model.createData()
    pin.forwardKinematics(task.hand.pin_model, data, q)
    out = []
    for finger, plane in zip(task.fingers, tangents, strict=True):
        turn = T_world_base.rotation @ data.oMi[finger.pad.joint_id].rotation
        across = np.eye(3) / finger.pad.radius
        for way in finger.pad.reach @ turn.T:
            across -= np.outer(way, way) / (way @ way * finger.pad.radius)
        out.append(plane.T @ across @ plane)
    return np.array(out)


def _rolling(curved: FloatArray, frames: FloatArray) -> FloatArray:
    """A (n, 3, 3) of the module, m, world axes, for both curvatures (n, 2, 2) together."""
    size, along = np.linalg.eigh(curved)
    out = frames[:, :, 1:] @ along
    return np.asarray((out / np.maximum(size, FLATTEST)[:, None, :]) @ out.transpose(0, 2, 1))


def _curvatures(shape: Shape, points: FloatArray, tangents: FloatArray) -> FloatArray:
    """Curvature (n, 2, 2), 1/m, of a surface at points (n, 3) along two tangents (n, 3, 2)."""
    steps = NEAR * tangents.transpose(0, 2, 1)  # (n, 2, 3)
    ends = np.stack([points[:, None] + steps, points[:, None] - steps])
    normals = shape.closest_point(ends.reshape(-1, 3))[1].reshape(ends.shape)
    slopes = (normals[0] - normals[1]) @ tangents / (2 * NEAR)
    return np.asarray((slopes + slopes.transpose(0, 2, 1)) / 2)
