"""The contact model of a hand with an object in its palm: a quasi-dynamic step in closed form.

State x: displacement of the object (3 of its centre, 3 of its rotation, world axes) and of the
hand's joints, since the moment at which the contacts were read. Input u: commands of the position
servos. Without contact a step moves the system by Q^-1 tau, where tau are weight and servo forces
and Q the stiffnesses of object (``PalmSettings``) and servos. With contacts it is the programme

    min 1/2 d' Q d - tau' d    subject to    J (x + d) + gap >= 0,

J with a row J_n + mu J_t for each of four edges t of every friction pyramid. Its dual has the
Hessian J Q^-1 J'; put a diagonal K^-1 in its place, and the forces are in closed form (Jin,
arXiv 2408.07855):

    lambda = K max(0, -(gap + J (x + Q^-1 tau))),    d = Q^-1 (tau + J' lambda).

``max(0, z)`` is smoothed to w log(1 + exp(z / w)). J, gaps and Q stay as they were read.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from planner.errors import TaskError
from planner.spatial import FloatArray, IntArray
from sim.palm.settings import PalmSettings
from sim.scene.build import HAND_PREFIX, Scene

COUPLED = 100.0
"""Stiffness of a coupling of joints in stiffnesses of the stiffest servo (-): as good as rigid."""

LEAST_STIFFNESS = 1e-3
"""Stiffness (N m/rad) of a joint that no servo holds, so that Q has an inverse."""

FREE = 6
"""Coordinates of the object; the joints follow."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Plant:
    """A MuJoCo model with a hand that stands, and a free object.

    Attributes:
        model: ``mujoco.MjModel``.
        qpos: (nq,), where the hand's joints stand in ``data.qpos``.
        dof: (nq,), where they stand in ``data.qvel``.
        ctrl: (nu,), the hand's servos in ``data.ctrl``.
        moment: (nu, nq), servo lengths per joint.
        coupling: (k, nq), rows whose product with the joints stays as it is.
        idle: (n,), servos that stay where they are: the wrist's.
        object_body: Body id of the object.
        tips: Body id and point (3,), m, body frame, of every fingertip.
    """

    model: Any
    qpos: IntArray
    dof: IntArray
    ctrl: IntArray
    moment: FloatArray
    coupling: FloatArray
    idle: IntArray
    object_body: int
    tips: tuple[tuple[int, FloatArray], ...]

    def __post_init__(self) -> None:
        """Check that position servos drive the hand.

        Raises:
            TaskError: Something else does.
        """
        kp = self.model.actuator_gainprm[self.ctrl, 0]
        if not (kp > 0).all() or not np.allclose(self.model.actuator_biasprm[self.ctrl, 1], -kp):
            raise TaskError(
                "an object in the palm is turned by position servos, and this hand has others; "
                "give one whose actuators are position servos"
            )

    @property
    def object_dof(self) -> IntArray:
        """(6,), its velocity in ``data.qvel``: linear in world axes, angular in its own."""
        first = int(self.model.body_dofadr[self.object_body])
        return np.arange(first, first + FREE)

    @property
    def object_qpos(self) -> IntArray:
        """(7,), the object's pose in ``data.qpos``: position, quaternion w, x, y, z."""
        first = int(self.model.jnt_qposadr[self.model.body_jntadr[self.object_body]])
        return np.arange(first, first + 7)


def plant_of(scene: Scene) -> Plant:
    """The plant that a scene of one hand is; see ``Plant``."""
    hand, model = scene.task.hand, scene.model
    pads = [finger.pad for finger in hand.fingers.values()]
    bodies = [int(model.geom_bodyid[model.geom(HAND_PREFIX + pad.geom).id]) for pad in pads]
    return Plant(
        model=model,
        qpos=scene.hand_qpos,
        dof=scene.hand_dof,
        ctrl=scene.hand_ctrl,
        moment=hand.actuation.moment,
        coupling=hand.coupling_matrix[0],
        idle=np.flatnonzero(hand.actuation.moment[:, hand.wrist_index].any(axis=1)),
        object_body=scene.object_body,
        tips=tuple((body, np.array(pad.center)) for body, pad in zip(bodies, pads, strict=True)),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class ContactStep:
    """The step with contacts as they were read: x -> x + d; n = 6 + nq coordinates, m edges.

    Attributes:
        keep: (n, n), what remains of x without contact.
        drive: (n, nu), what commands add.
        rest: (n,), what weight and the servos' present state add.
        compliance: (n, n), Q^-1.
        jacobian: (m, n), rows J_n + mu J_t.
        gaps: (m,), m, one per edge, equal for the edges of a contact.
        stiffness: K, N/m.
        smoothing: w, m.
    """

    keep: FloatArray
    drive: FloatArray
    rest: FloatArray
    compliance: FloatArray
    jacobian: FloatArray
    gaps: FloatArray
    stiffness: float
    smoothing: float

    def __post_init__(self) -> None:
        """Keep the product that every step needs: Q^-1 J', (n, m)."""
        object.__setattr__(self, "_push", self.compliance @ self.jacobian.T)

    def forces(self, x: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Forces (m,), N, along the edges in a step from x (n,) with u (nu,), and their slopes.

        The slope (m,), N/m, is what a force gains per m by which its gap would close further.
        """
        free = self.keep @ x + self.drive @ u + self.rest
        z = -(self.gaps + self.jacobian @ free) / self.smoothing
        grown = np.exp(-np.abs(z))  # both branches of softplus and its slope without overflow
        force = self.stiffness * self.smoothing * (np.maximum(z, 0.0) + np.log1p(grown))
        return force, self.stiffness * np.where(z > 0, 1.0, grown) / (1.0 + grown)

    def step(self, x: FloatArray, u: FloatArray) -> FloatArray:
        """State (n,) after a step from x (n,) with commands u (nu,)."""
        free = self.keep @ x + self.drive @ u + self.rest
        moved: FloatArray = free + self._push @ self.forces(x, u)[0]  # type: ignore[attr-defined]
        return moved

    def differential(
        self, x: FloatArray, u: FloatArray, dx: FloatArray, du: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """The step, and its exact derivative along dx (n, k) and du (nu, k): (n,) and (n, k)."""
        push: FloatArray = self._push  # type: ignore[attr-defined]
        free = self.keep @ x + self.drive @ u + self.rest
        force, slope = self.forces(x, u)
        moved = self.keep @ dx + self.drive @ du
        return free + push @ force, moved - push @ (slope[:, None] * (self.jacobian @ moved))


class PalmModel:
    """Reads contacts and servos of a plant, on a copy of its model in which contacts reach out.

    Attributes:
        plant: The plant.
        kp: (nu,), stiffness of the servos, N m/rad.
        data: ``mujoco.MjData`` of the copy, as of the last ``read``.
    """

    def __init__(self, plant: Plant, settings: PalmSettings) -> None:
        """Copy the model, and let pairs with the object be contacts before they touch."""
        self.plant, self._settings = plant, settings
        self._model = copy.copy(plant.model)
        own = self._model.geom_bodyid == plant.object_body
        self._model.geom_margin[own] = self._model.geom_gap[own] = settings.reach_m
        self.data = mujoco.MjData(self._model)
        self.kp = np.array(self._model.actuator_gainprm[plant.ctrl, 0])
        self._columns = np.concatenate([plant.object_dof, plant.dof])

    def read(self, qpos: FloatArray) -> ContactStep:
        """The step at a state (MuJoCo's qpos)."""
        model, data, plant, asked = self._model, self.data, self.plant, self._settings
        data.qpos[:], data.qvel[:] = qpos, 0.0
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        pull = plant.moment.T * self.kp  # (nq, nu)
        servos = pull @ plant.moment
        stiff = servos + COUPLED * self.kp.max() * plant.coupling.T @ plant.coupling
        stiff += LEAST_STIFFNESS * np.diag(np.diag(servos) <= 0)
        n = FREE + len(plant.qpos)
        compliance = np.zeros((n, n))
        compliance[range(3), range(3)] = 1.0 / asked.object_stiffness
        compliance[range(3, FREE), range(3, FREE)] = 1.0 / asked.turn_stiffness
        soft = np.linalg.inv(stiff)
        compliance[FREE:, FREE:] = soft
        keep = np.eye(n)
        keep[FREE:, FREE:] -= soft @ servos
        drive = np.zeros((n, len(plant.ctrl)))
        drive[FREE:] = soft @ pull
        rest = np.zeros(n)
        weight = asked.weight_share * model.body_mass[plant.object_body]
        rest[:3] = weight * model.opt.gravity / asked.object_stiffness
        rest[FREE:] = -soft @ (servos @ data.qpos[plant.qpos] + data.qfrc_bias[plant.dof])
        jacobian, gaps = self._edges()
        return ContactStep(
            keep=keep,
            drive=drive,
            rest=rest,
            compliance=compliance,
            jacobian=jacobian,
            gaps=gaps,
            stiffness=asked.contact_stiffness,
            smoothing=asked.smoothing_m,
        )

    def _edges(self) -> tuple[FloatArray, FloatArray]:
        """Rows of the edges (m, n) and gaps (m,), of the contacts of hand and object."""
        model, data, plant = self._model, self.data, self.plant
        bodies = model.geom_bodyid[data.contact.geom]  # (ncon, 2)
        ours = np.flatnonzero((bodies == plant.object_body).sum(axis=1) == 1)
        nearest = ours[np.argsort(data.contact.dist[ours], kind="stable")]
        nearest = nearest[: self._settings.contacts]
        rows = np.empty((len(nearest), 4, model.nv))
        first, second = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        for row, k in zip(rows, nearest, strict=True):
            point = data.contact.pos[k]
            mujoco.mj_jac(model, data, first, None, point, bodies[k, 0])
            mujoco.mj_jac(model, data, second, None, point, bodies[k, 1])
            normal, t1, t2 = data.contact.frame[k].reshape(3, 3) @ (second - first)
            t1, t2 = self._settings.mu * t1, self._settings.mu * t2
            row[:] = normal + t1, normal - t1, normal + t2, normal - t2
        edges = rows.reshape(-1, model.nv)[:, self._columns]
        turn = data.xmat[plant.object_body].reshape(3, 3)
        edges[:, 3:FREE] = edges[:, 3:FREE] @ turn.T  # MuJoCo turns a free body about its own axes
        return edges, np.repeat(data.contact.dist[nearest], 4)

    def tips(self) -> tuple[FloatArray, FloatArray]:
        """Fingertips seen from the object's centre (k, 3), m, and their Jacobians (k, 3, nq)."""
        model, data = self._model, self.data
        center = data.xpos[self.plant.object_body]
        places, jacobians = [], []
        one = np.zeros((3, model.nv))
        for body, point in self.plant.tips:
            place = data.xpos[body] + data.xmat[body].reshape(3, 3) @ point
            mujoco.mj_jac(model, data, one, None, place, body)
            places.append(place - center)
            jacobians.append(one[:, self.plant.dof])
        return np.array(places), np.array(jacobians)

    def pose(self) -> tuple[FloatArray, FloatArray]:
        """Rotation (3, 3) and centre (3,), m, of the object, world."""
        body = self.plant.object_body
        return self.data.xmat[body].reshape(3, 3), self.data.xpos[body]

    def gap(self, qpos: FloatArray) -> float:
        """Least gap (m) of hand and object at a state; infinite where none is within reach."""
        self.data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self.data)
        mujoco.mj_comPos(self._model, self.data)
        mujoco.mj_collision(self._model, self.data)
        return float(min(self._near(), default=np.inf))

    def _near(self) -> Sequence[float]:
        bodies = self._model.geom_bodyid[self.data.contact.geom]
        ours = (bodies == self.plant.object_body).sum(axis=1) == 1
        return list(self.data.contact.dist[ours])
