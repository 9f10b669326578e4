"""Which contact forces the actuators command, and which compliance alone decides.

Contacts and joints give way. For joint references y, from those at which nothing presses, and a
wrench w on the object, which moves by u while the joints move by q,

    G f + w = 0,    C_contact f = J q - G^T u,    q = y - C_joint J^T f,

so that, with K^-1 = C_contact + J C_joint J^T,

    f = -G_K^+ w + E y,    G_K^+ = K G^T (G K G^T)^-1,    E = (I - G_K^+ G) K J

(Bicchi 1994; Prattichizzo and Bicchi 1998). Of the internal forces, G f = 0, the columns of E are
active: references make them. What is left of them is passive, P = ker J^T and ker G: such a force
loads no joint and moves nothing. Whatever y and w are,

    P^T C_contact f = 0,

the second equation multiplied by P^T. These are the rows that ``build_force_problem`` adds, so that
no force is counted that neither an actuator commands nor compliance brings about. Joints that a tie
holds together move as one: J is that of the motions that ties leave.

``GraspCompliance.under`` puts unilateral contacts and friction on top: contacts that part or slide
bear what the cone leaves them, and the others take the rest. ``pressed`` is how a grasp gets there:
from gaps, by torques that the servos add.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from planner.arrays import finite_array, float_array
from planner.contacts import ContactSet
from planner.errors import ContactError
from planner.forces.problem import ForceProblem
from planner.joints.actuation import Actuation
from planner.spatial import FloatArray

LEAST_LEVER = 1e-4
"""Joint torque per force (m) below which joints do not feel a force: 0.1 mm, so that 1 N is a
hundredth of the dry friction of a finger's joint."""

SOFTEST = 1e-3
"""Stiffness (N m/rad) of a joint that nothing drives, which keeps matrices invertible."""

STOP = 20.0
"""Stiffness of a stop that carries, N m/rad: bent by 0.01 rad by the torque of a firm grip."""

LARGEST_STEP, SMALLEST_STEP, ITERATIONS = 0.1, 1e-3, 60
"""Steps of a load, as shares of it, and Newton iterations of each (-)."""

SINGULAR = 1e-9
"""Added to a matrix, as a share of its mean eigenvalue (-): what slides has no stiffness."""

BALANCED = 1e-6
"""Residual that counts as balanced, as a share of the largest force (-)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GraspCompliance:
    """A grasp of m force components, in the contact frames, by nv joints.

    Attributes:
        grasp_map: G (6, m), N and N m about the centre of mass; fewer rows in the plane.
        joint_map: J^T (nv, m), joint torque per force component.
        contact: C_contact (m,), m/N (rad/(N m) of a torsion), all > 0.
        joint: C_joint (nv, nv), rad/(N m).
    """

    grasp_map: FloatArray
    joint_map: FloatArray
    contact: FloatArray
    joint: FloatArray

    @classmethod
    def of(cls, problem: ForceProblem, contact: ArrayLike) -> GraspCompliance:
        """Of a hand whose actuators are servos that hold their references.

        Args:
            problem: Of contacts, with the hand's actuation.
            contact: C_contact in m/N, one number or (m,); a torsion's counts per its
                ``column_scale`` squared.

        Raises:
            ContactError: No actuation, or a compliance that is not positive.
        """
        limits = problem.torque_limits
        if limits is None or problem.q is None:
            raise ContactError("the problem has no hand; give actuation, jacobians and q")
        a = limits.actuation
        stiffness = a.moment.T @ (-a.bias[:, 1, None] * a.moment) + a.stiffness
        active = a.stop_rows[a.active_stops(problem.q)]
        stiffness = stiffness + STOP * active.T @ active + SOFTEST * np.eye(len(stiffness))
        return cls(
            grasp_map=problem.contacts.grasp_map(),
            joint_map=problem.joint_map,
            contact=_compliances(contact, problem.n_force)
            / problem.column_scale[: problem.n_force] ** 2,
            joint=np.asarray(np.linalg.inv(stiffness), dtype=np.float64),
        )

    @cached_property
    def stiffness(self) -> FloatArray:
        """K (m, m), N/m."""
        given = self.joint_map.T @ self.joint @ self.joint_map
        return np.asarray(np.linalg.inv(np.diag(self.contact) + given))

    @cached_property
    def spread(self) -> FloatArray:
        """G_K^+ (m, 6): -G_K^+ w is how contacts share a wrench w while references are held."""
        g, k = self.grasp_map, self.stiffness
        return np.asarray(np.linalg.solve(g @ k @ g.T, g @ k).T)

    @cached_property
    def commanded(self) -> FloatArray:
        """E (m, nv): internal forces per change of a joint's reference, N/rad."""
        own = self.stiffness @ self.joint_map.T
        return np.asarray(own - self.spread @ (self.grasp_map @ own))

    @cached_property
    def passive(self) -> FloatArray:
        """P (m, h), orthonormal: internal forces that no joint feels."""
        return passive_forces(self.grasp_map, self.joint_map)

    @cached_property
    def active(self) -> FloatArray:
        """Orthonormal basis (m, a) of the internal forces that references make."""
        size = self.grasp_map.shape[1] - np.linalg.matrix_rank(self.grasp_map)
        left, _, _ = np.linalg.svd(self.commanded, full_matrices=False)
        return np.asarray(left[:, : size - self.passive.shape[1]])

    def pressed(
        self,
        contacts: ContactSet,
        torque: FloatArray,
        wrench: FloatArray,
        gaps: ArrayLike = 0.0,
    ) -> tuple[FloatArray, float]:
        """Forces (m,) where servos added a torque while the object was held, and then let it go.

        Args:
            contacts: n contacts; give the friction.
            torque: Of the joints (nv,) beside what holds the hand itself, N m.
            wrench: On the object, w (6,), N and N m.
            gaps: How far pads are from the object before, one number or (n,), m; negative where
                they have sunk in.

        Returns:
            As ``under``; a contact that does not touch has the negative normal force that its gap
            would take, -gap / C_contact.
        """
        state, n = np.zeros(len(self.contact)), len(self.grasp_map)
        normal = np.cumsum([0, *contacts.dims])[:-1]
        state[normal] = -np.asarray(gaps, dtype=np.float64) / self.contact[normal]
        load = np.append(np.zeros(n), torque)
        inside, state, held = self._grown(contacts, (0.0 * state, state), load, slice(n, None))
        load = np.append(self.grasp_map @ inside + wrench, 0.0 * torque)
        _, state, free = self._grown(contacts, (inside, state), load, slice(None))
        return state, min(held, free)

    def under(
        self, contacts: ContactSet, forces: FloatArray, wrench: ArrayLike
    ) -> tuple[FloatArray, float]:
        """Forces (m,) after a further wrench grew slowly, references held; contacts slide and part.

        Args:
            contacts: Give the friction.
            forces: Before it (m,), inside the cones, or with gaps as ``pressed`` gives them.
            wrench: What is added (6,), N and N m.

        Returns:
            Forces, and the share of the wrench (-) up to which balance was found: less than 1 where
            the grasp breaks.
        """
        load = np.zeros(self._moves.shape[1])
        load[: len(self.grasp_map)] = float_array("wrench", wrench)
        first = self._in_cones(contacts, forces, np.zeros(len(forces)))[0]
        f, _, share = self._grown(contacts, (first, forces), load, slice(None))
        return f, share

    @cached_property
    def _moves(self) -> FloatArray:
        """How pads move against the object (m, 6 + nv), by motions of object and joints."""
        return np.hstack([-self.grasp_map.T, self.joint_map.T])

    def _grown(
        self,
        contacts: ContactSet,
        before: tuple[FloatArray, FloatArray],
        load: FloatArray,
        free: slice,
    ) -> tuple[FloatArray, FloatArray, float]:
        """Forces, their state (see ``_in_cones``) and the share (-) of a load that is balanced.

        Args:
            contacts: Give the friction.
            before: Forces (m,) that are balanced without the load, and the state (m,).
            load: Wrench on the object and torques of the joints (6 + nv,).
            free: Which of the motions there are.
        """
        first, f = before[0], before[0]
        last = before[1], np.zeros(len(load[free]))
        size = max(float(np.abs(first).max(initial=0.0)), 1.0)
        share, step = 0.0, LARGEST_STEP
        while share < 1.0 and step >= SMALLEST_STEP:
            goal = min(share + step, 1.0)
            there = self._balanced(contacts, last, (first, goal * load), free, BALANCED * size)
            if there is None:
                step /= 2.0
            else:
                (f, last), share, step = there, goal, LARGEST_STEP
        return f, last[0], share

    def _balanced(
        self,
        contacts: ContactSet,
        last: tuple[FloatArray, FloatArray],
        given: tuple[FloatArray, FloatArray],
        free: slice,
        tolerance: float,
    ) -> tuple[FloatArray, tuple[FloatArray, FloatArray]] | None:
        """Forces that balance a load beyond given ones, and where that is; see ``_in_cones``."""
        moves, (before, moved), (first, load) = self._moves[:, free], last, given
        n = len(self.grasp_map)
        servos = np.zeros((len(load), len(load)))
        servos[n:, n:] = np.linalg.inv(self.joint)
        servos = servos[free, free]

        def left(at: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
            f, state, slope = self._in_cones(contacts, before, moves @ (at - moved))
            return moves.T @ (f - first) + servos @ at - load[free], f, state, slope

        at = moved
        missing, f, state, slope = left(at)
        for _ in range(ITERATIONS):
            if np.abs(missing).max() <= tolerance:
                return f, (state, at)
            matrix = moves.T @ slope @ moves + servos
            matrix += SINGULAR * np.trace(matrix) / len(matrix) * np.eye(len(matrix))
            way, share = np.linalg.solve(matrix, missing), 1.0
            while True:
                tried = left(at - share * way)
                if np.linalg.norm(tried[0]) < np.linalg.norm(missing) or share < 1e-2:
                    break
                share /= 2.0
            at, (missing, f, state, slope) = at - share * way, tried
        return None

    def _in_cones(
        self, contacts: ContactSet, before: FloatArray, by: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Forces (m,) when pads have moved by (m,) against the object, and their slope (m, m).

        Between them, what ``before`` is next time: the forces, and of a contact that parted the
        negative normal force that would have kept it.
        """
        trial, out = before + by / self.contact, np.zeros(len(before))
        state = out.copy()
        slope, at = np.zeros((len(before), len(before))), 0
        for (mu, twist), dim in zip(contacts.friction.tolist(), contacts.dims, strict=True):
            own, k = slice(at, at + dim), 1.0 / self.contact[at : at + dim]
            at += dim
            f = trial[own]
            state[own.start] = f[0]
            if f[0] < 0.0:
                continue
            limit = np.array([mu, mu, twist][: dim - 1])
            side = np.divide(f[1:], limit, out=np.zeros(dim - 1), where=limit > 0.0)
            length, block = float(np.linalg.norm(side)), np.diag(k)
            if length > f[0]:
                way = side / length
                f = np.append(f[0], f[0] * way * limit)
                block[1:, 0] = k[0] * way * limit
                turn = np.eye(dim - 1) - np.outer(way, way)
                unit = np.divide(1.0, limit, out=np.zeros(dim - 1), where=limit > 0.0)
                block[1:, 1:] = f[0] / length * limit[:, None] * turn * (unit * k[1:])
            out[own], state[own], slope[own, own] = f, f, block
        return out, state, slope


def passive_forces(grasp_map: FloatArray, joint_map: FloatArray) -> FloatArray:
    """P (m, h), orthonormal: forces in ker G that load no joint (``LEAST_LEVER``).

    Args:
        grasp_map: G (6, m).
        joint_map: J^T (nv, m), m.
    """
    if grasp_map.shape[1] <= len(grasp_map):
        return np.zeros((grasp_map.shape[1], 0))
    null = np.linalg.svd(grasp_map)[2][np.linalg.matrix_rank(grasp_map) :].T
    _, felt, turn = np.linalg.svd(joint_map @ null)
    felt = np.append(felt, np.zeros(len(turn) - len(felt)))
    return np.asarray(null @ turn[felt < LEAST_LEVER].T)


def passive_rows(
    contacts: ContactSet,
    joint_map: FloatArray,
    actuation: Actuation | None,
    compliance: ArrayLike,
    unit: FloatArray,
) -> FloatArray:
    """P^T C_contact (h, m), rows of unit length: what they make of f is 0.

    Args:
        contacts: n contacts.
        joint_map: J^T (nv, m).
        actuation: Of the hand; its ties hold joints together.
        compliance: C_contact, one number for all or (m,), m/N; only ratios count.
        unit: Unit of each force component per newton (m,); a torsion's compliance counts per its
            square.

    Raises:
        ContactError: A compliance that is not positive.
    """
    levers, m = joint_map, joint_map.shape[1]
    if actuation is not None and (ties := np.isinf(actuation.stop_values)).any():
        held = actuation.stop_rows[ties]
        levers = np.linalg.svd(held)[2][np.linalg.matrix_rank(held) :] @ joint_map
    rows = passive_forces(contacts.grasp_map(), levers).T * (_compliances(compliance, m) / unit**2)
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True))


def _compliances(given: ArrayLike, m: int) -> FloatArray:
    """One per force component.

    Raises:
        ContactError: One that is not positive, or too many.
    """
    numbers = float_array("contact_compliance", given)
    value = finite_array(
        "contact_compliance", numbers if numbers.ndim else np.full(m, numbers), (m,)
    )
    if (value <= 0.0).any():
        raise ContactError("contact_compliance holds a number that is not > 0; give m/N")
    return value
