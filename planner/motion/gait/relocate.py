"""The swing of one finger from contact to contact while the others hold: up, over, and down.

The path of the pad's centre is given in the object's frame: along the outward normal to one of
``HEIGHTS``, at that height over the surface to above the landing, and down along the normal there.
The joints of the finger follow by steps, each a quadratic programme (``planner.numerics.ik_step``),

    min  |J dq - (wanted - c)|^2 / height^2 + POSTURE_WEIGHT |q + dq - q_even|^2 + DAMPING |dq|^2
    s.t. nearby pairs stay ``ROOM`` apart (soft); couplings; joint limits

with q_even interpolated between both postures. The result is verified with coal at every sample and
half-way between samples: nothing penetrates, and the lifted pad stays clear of the object.
"""

from __future__ import annotations

import numpy as np

from planner.collision.pad_contact import contact_geometries
from planner.collision.world import CollisionWorld
from planner.failure import Failure
from planner.hands.fingers import Finger
from planner.kinematics.state import MovingHand
from planner.numerics.ik_step import Barrier, Task, constrained_ik_step
from planner.spatial import SE3, FloatArray, IntArray
from planner.task import GraspTask
from planner.tolerances import PENETRATION_TOL

HEIGHTS = (0.012, 0.006, 0.02)
"""Heights (m) to which a pad is lifted, in the order they are tried. The first exceeds the
deflection of a compliant hand, the lower one serves fingers close together, the higher one a
protrusion."""

UP, OVER = 4, 6
"""Samples of the swing upwards, and across; downwards as many as upwards."""

STEPS = 4
"""Most inverse-kinematics steps at a sample."""

SETTLED = 0.01
"""Step (rad) below which the joints have converged: about half a millimetre at a pad."""

LARGEST = 0.3
"""Longest step of a joint (rad): the linearisation holds for short arcs only."""

POSTURE_WEIGHT, DAMPING = 0.05, 0.02
"""Cost of a radian off the interpolated posture, and of a step of one radian, relative to missing
the pad's target by the height (-)."""

SEEN = 0.02
"""Distance (m) below which pairs enter the programme."""

ROOM = 1e-3
"""Distance (m) that the finger keeps from nearby geometries, where it can."""

PRICE = 100.0
"""Cost of falling short of ``ROOM`` by one height (-)."""

STILL = 1e-3
"""Rate of a distance (m/rad) below which the finger cannot change it."""

CLEAR = 5e-4
"""Least distance (m) of a lifted pad from the object; a touching pad may be as far off."""

JUMP = 0.6
"""Largest change (rad) of a joint between samples: a larger one passes a posture
from which the finger does not return continuously."""


class FingerPaths:
    """Swings of single fingers, for one task.

    Attributes:
        world: Hand and object alone.
    """

    def __init__(self, task: GraspTask) -> None:
        """Collect the geometry.

        Args:
            task: Without table and obstacles: the object is lifted.
        """
        self._task = task
        self.world = CollisionWorld(task)
        self._moving = MovingHand(task.hand, task.hand.q_lower)

    def path(
        self, finger: Finger, T_object_base: SE3, q: FloatArray, landed: FloatArray
    ) -> FloatArray | Failure:
        """Joints (m, nq) from q to where one finger has landed; or what blocks the swing.

        Args:
            finger: The finger that swings.
            T_object_base: Pose of the base in the object's frame; both stand still.
            q: Joints (nq,) before.
            landed: Joints (nq,) after; other fingers may move along.
        """
        failures = []
        for height in HEIGHTS:
            postures = self._lifted(finger, T_object_base, q, landed, height)
            failure = self.verify(finger, T_object_base, postures)
            if failure is None:
                return postures
            failures.append(failure)
        return failures[0]

    def _lifted(
        self, finger: Finger, base: SE3, q: FloatArray, landed: FloatArray, height: float
    ) -> FloatArray:
        """Joints (m, nq) along the swing, at a height above the object."""
        ends = [base.act(self._moving.move(p).pad_center(finger)) for p in (q, landed)]
        raised = height * np.linspace(0.0, 1.0, UP + 1)
        over = np.linspace(0.0, 1.0, OVER + 1)[1:-1]
        shares = np.concatenate([np.zeros(UP + 1), over, np.ones(UP + 1)])
        heights = np.concatenate([raised, np.full(OVER - 1, height), raised[::-1]])
        line = ends[0] + shares[:, None] * (ends[1] - ends[0])
        points, outward = self._task.object.shape.closest_point(line)
        centers = points + (finger.pad.radius + heights)[:, None] * outward
        even = np.linspace(0.0, 1.0, len(shares))
        out = [q]
        for share, center in zip(even[1:-1], centers[1:-1], strict=True):
            guess = q + share * (landed - q)
            guess[finger.q_index] = out[-1][finger.q_index]
            out.append(self._follow(finger, base, guess, center, q + share * (landed - q), height))
        return np.array([*out, landed])

    def _follow(
        self,
        finger: Finger,
        base: SE3,
        q: FloatArray,
        center: FloatArray,
        even: FloatArray,
        height: float,
    ) -> FloatArray:
        """Joints (nq,) near q with the finger's pad centred at a point (3,), object frame."""
        hand, index = self._task.hand, finger.q_index
        inverse, T_world_base = base.inverse(), self._task.T_world_object * base
        wanted = inverse.act(center)
        matrix, value = hand.coupling_matrix
        coupled = np.flatnonzero(np.abs(matrix[:, index]).max(axis=1, initial=0.0))
        q = q.copy()
        for _ in range(STEPS):
            self._moving.move(q)
            now = self._moving.pad_center(finger)
            rows = self._moving.point_jacobian(finger.pad.joint_id, now)[:3, index] / height
            rates, short = self._near(T_world_base, q, index)
            off = (value - matrix @ q)[coupled]
            found = constrained_ik_step(
                Task(rows, (wanted - now) / height),
                [Barrier(rates, short, unit=height)],
                np.clip(hand.q_lower - q, -LARGEST, 0.0)[index],
                np.clip(hand.q_upper - q, 0.0, LARGEST)[index],
                equality=Task(matrix[np.ix_(coupled, index)], off),
                posture=(even - q)[index],
                posture_weight=POSTURE_WEIGHT,
                damping=DAMPING,
                price=PRICE,
            )
            if found is None:
                break
            q[index] = np.clip(q[index] + found, hand.q_lower[index], hand.q_upper[index])
            if np.abs(found).max() < SETTLED:
                break
        return q

    def _near(
        self, T_world_base: SE3, q: FloatArray, index: IntArray
    ) -> tuple[FloatArray, FloatArray]:
        """Rates (k, n) of nearby distances by a finger's joints, and their shortfall (k,), m."""
        near = self.world.near(T_world_base, q, SEEN)
        rates = near.rates(self._moving)[:, index]
        moving = np.abs(rates).max(axis=1, initial=0.0) > STILL
        return rates[moving], (ROOM - near.distances)[moving]

    def verify(self, finger: Finger, T_object_base: SE3, postures: FloatArray) -> Failure | None:
        """Why the swing (m, nq) of one finger is refused, None if it is free."""
        jump = np.abs(np.diff(postures[:, finger.q_index], axis=0)).max()
        if jump > JUMP:
            return Failure(
                kind="swing_jump",
                text=f"{finger.name} turns a joint by {np.rad2deg(jump):.0f} degrees at once",
                numbers={"jump": float(jump)},
            )
        hand, T_world_base = self._task.hand, self._task.T_world_object * T_object_base
        mine = {g.name for g in contact_geometries(hand, finger)}
        holding = {
            g.name
            for f in self._task.fingers
            for g in contact_geometries(hand, f)
            if f is not finger
        }
        halves = (postures[1:] + postures[:-1]) / 2
        samples = np.empty((2 * len(postures) - 1, postures.shape[1]))
        samples[::2], samples[1::2] = postures, halves
        near = 2  # first and last samples, where the pad only just leaves the surface or lands
        for k, q in enumerate(samples[1:-1], start=1):
            leaving = k <= near or k >= len(samples) - 1 - near
            touching = holding | (mine if leaving else set())
            found = self.world.closest(T_world_base, q, 1, may_touch=touching)
            if found and found[0].distance < (-PENETRATION_TOL if leaving else 0.0):
                return Failure(
                    kind="swing_collision",
                    text=f"the swing of {finger.name} is blocked at {_where(k, samples)}: "
                    f"{found[0]}",
                    numbers={"distance": found[0].distance},
                )
            gap = self._gap(finger, T_object_base, q)
            if not leaving and gap < CLEAR:
                return Failure(
                    kind="swing_too_low",
                    text=f"{finger.name} is lifted by {1e3 * gap:.2f} mm only "
                    f"at {_where(k, samples)}",
                    numbers={"gap": gap},
                )
        return None

    def _gap(self, finger: Finger, base: SE3, q: FloatArray) -> float:
        """Signed distance (m) of the pad's sphere from the object."""
        center = base.act(self._moving.move(q).pad_center(finger))
        points, outward = self._task.object.shape.closest_point(center[None])
        return float((center - points[0]) @ outward[0]) - finger.pad.radius


def _where(k: int, samples: FloatArray) -> str:
    return f"{100 * k / (len(samples) - 1):.0f} % of its swing"
