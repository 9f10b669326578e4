"""Starts of grasp synthesis: hand poses with the fingers opposed across the object.

In the pinch posture the finger whose pad faces the others is the opposer (a thumb). The line
from its pad to the mean of the other pads is the hand's opposition axis. A start lays that axis
along a direction in which the object is narrow enough, turns the hand about it so that the palm
comes from the free side, adds noise, and takes as first contacts the surface points nearest to the
pads. Which face each finger is assigned to follows from those points.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planner.errors import TaskError
from planner.failure import Failure
from planner.joints.description import OPEN, PINCH
from planner.kinematics import moving_hand, reach
from planner.shapes.base import Patch, Surface
from planner.spatial import SE3, FloatArray
from planner.synthesis.mesh_surface import surface_of
from planner.synthesis.problem import Start
from planner.synthesis.seeds.opposition import Opposition, frame_of, opposition
from planner.task import GraspTask

POSITION_NOISE = 0.01
"""Standard deviation (m) of the hand's position in a start."""

TILT_NOISE = 0.45
"""Standard deviation (rad) of the hand's turn about the opposition axis in a start."""

JOINT_NOISE = 0.05
"""Standard deviation of the joints in a start, in shares of their range."""

MOST_OPEN = 0.6
"""Starts lie between the pinch posture and this share of the way to the open one (-)."""

MOST_STRETCHED, STRETCHES = 4.0, 17
"""How far (-) beyond the open posture (1) the fingers are stretched to find the widest object, and
the number of postures tried."""

DRAWS = 8
"""Palm poses drawn in search of one that the arm reaches."""

SPARE_REACH = 2.0
"""Largest distance of an object from the palm, in distances (-) of a pinched one: only objects that
are certainly out of reach are refused without an attempt."""

TRIPOD = 3
"""Fingers that close a grasp with friction and without torsion."""

NEXT_FACE = np.cos(np.deg2rad(45.0))
"""Cosine between a pad's axis and the opposition axis below which the face of a box that the pad
faces is a neighbour of that of the others: then the axis says which face is opposed."""

AXIS_NOISE = 0.15
"""Standard deviation (rad) of the opposition axis about the chosen direction of the object."""


class Seeder:
    """Draws starts for one task."""

    def __init__(self, task: GraspTask) -> None:
        """Compute the postures and directions that all starts share.

        Raises:
            TaskError: The object is too wide for the hand in every direction.
        """
        self.task = task
        self.surface: Surface = surface_of(task.object.shape)
        self.skin = float(self.surface.skin(self.surface.size(task.object.shape)))
        self.open = self._with_wrist(task.hand.posture(OPEN))
        pinch = self._with_wrist(task.hand.posture(PINCH))
        self.posture = np.where(self._resting(), self.open, pinch)
        self.pinch = opposition(task, self.posture)
        state = moving_hand(task.hand).move(self.posture)
        facing = np.array([state.pad_axis(f) for f in task.fingers])
        self.aside = (facing * _along(self.pinch, len(facing))).sum(axis=1) < NEXT_FACE
        self.stretches = np.linspace(0.0, MOST_STRETCHED, STRETCHES)
        self.gaps = np.array([opposition(task, self._stretched(s)).gap for s in self.stretches])
        self.widest = float(self.gaps.max())
        self.frozen = frozen_joints(task)
        self._check_within_reach()
        self._prepare()

    def _prepare(self) -> None:
        """Find the directions of the object across which the hand can close."""
        task = self.task
        candidates = self._directions()
        widths = [2 * _half_width(task.object.shape, c) for c in candidates]
        self.smallest = min(widths)
        # an object wider than the open hand is started with fingers stretched just around it
        reach, self._stretch = max(opposition(task, self.open).gap, self.pinch.gap), None
        if self.smallest >= reach:
            wide = self.gaps > self.smallest
            reach, self._stretch = self.widest, float(self.stretches[np.argmax(wide)])
        self.directions = [c for c, w in zip(candidates, widths, strict=True) if w < reach]
        self._check_size()

    def draw(self, rng: np.random.Generator) -> Start | Failure:
        """One start, or why there is none."""
        task = self.task
        if task.hand.arm is None:
            T_world_base, q = self._place(rng)
        else:
            carried = self._carried(rng)
            if isinstance(carried, Failure):
                return carried
            T_world_base, q = carried
        T_object_base = task.T_world_object.inverse() * T_world_base
        state = moving_hand(task.hand).move(q)
        pads = np.array([T_object_base.act(state.pad_center(f)) for f in task.fingers])
        facing = np.array([T_object_base.rotation @ state.pad_axis(f) for f in task.fingers])
        points, normals = self._first_contacts(pads, facing)
        if self.skin > 0.0:
            points = points + self.skin * normals
        if task.object.shape.flat_sides is not None:
            normals = self._face_normals(q, T_object_base, normals)
        patches = tuple(
            self._patch(finger, p, n, rng)
            for finger, p, n in zip(task.finger_names, points, normals, strict=True)
        )
        return Start(
            T_object_base=T_object_base,
            q=q,
            points=np.array(
                [np.clip(p, c.lower, c.upper) for p, c in zip(points, patches, strict=True)]
            ),
            forces=self._forces(normals),
            patches=patches,
            frozen=self.frozen,
            base_fixed=task.T_world_base is not None,
        )

    def _first_contacts(
        self, pads: FloatArray, facing: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """First contact points and outward normals (n, 3) of pads at (n, 3), object frame.

        Args:
            pads: Centres of the pads, m.
            facing: Axes of the pads, unit.
        """
        return self.task.object.shape.closest_point(pads)

    def _face_normals(self, q: FloatArray, T_object_base: SE3, nearest: FloatArray) -> FloatArray:
        """Outward normals (n, 3) of the faces that the pads are to touch.

        The nearest faces are often neighbours; those that the pads face are opposed.

        Args:
            q: Joints (nq,).
            T_object_base: Pose of the base in the object's frame.
            nearest: Normals (n, 3) of the points nearest to the pads.
        """
        state = moving_hand(self.task.hand).move(q)
        facing = [state.pad_axis(f) for f in self.task.fingers]
        if self.aside.any():
            along = _along(opposition(self.task, q), len(facing))
            facing = [a if far else f for f, a, far in zip(facing, along, self.aside, strict=True)]
        return -np.array([T_object_base.rotation @ f for f in facing])

    def _forces(self, normals: FloatArray) -> FloatArray:
        """Forces (n, 3) of a start against outward normals (n, 3), in units of their mean."""
        return opposed_forces(normals, self.pinch.opposer)

    def _patch(
        self, finger: str, point: FloatArray, normal: FloatArray, rng: np.random.Generator
    ) -> Patch:
        """The patch under a pad, cut down to a region that the finger may touch."""
        shape, touch = self.task.object.shape, self.task.object.touch
        nearest = self.surface.patch_at(shape, point, normal)
        regions = [] if touch is None else list(touch.allowed)
        if touch is not None and finger in touch.required:
            regions = [touch.required[finger]]
        for k in rng.permutation(len(regions)):
            for patch in (nearest, *self.surface.patches(shape)):
                lower = np.maximum(patch.lower, regions[k].lower)
                upper = np.minimum(patch.upper, regions[k].upper)
                if (lower <= upper).all():
                    return replace(patch, lower=lower, upper=upper)
        return nearest

    def _place(self, rng: np.random.Generator) -> tuple[SE3, FloatArray]:
        """Base pose and joints (nq,) of a start, as if the base could be anywhere."""
        task = self.task
        q = self._noisy_posture(rng)
        if task.T_world_base is not None and task.hand.arm is None:
            return task.T_world_base, q
        now = opposition(task, q)
        direction = self._noisy(self.directions[rng.integers(len(self.directions))], rng)
        axis = task.T_world_object.rotation @ direction
        above = self._free_side(axis, rng)
        rotation = frame_of(axis, above) @ frame_of(now.axis, now.palm_side).T
        center = task.T_world_object.translation + rng.normal(0, POSITION_NOISE, 3)
        return SE3(rotation, center - rotation @ now.center), q

    def _carried(self, rng: np.random.Generator) -> tuple[SE3, FloatArray] | Failure:
        """A start that the arm can reach: where its root stands, and all joints."""
        hand, T_world_base = self.task.hand, SE3(self.task.T_world_base)
        least = np.inf
        for _ in range(DRAWS):
            T_world_free, q = self._place(rng)
            T_world_palm = T_world_free * moving_hand(hand).move(q).T_base_palm
            reached = reach(hand, T_world_base.inverse() * T_world_palm, q)
            if reached.there:
                return T_world_base, reached.q
            least = min(least, reached.distance)
        return Failure(
            kind="out_of_reach",
            text=f"out of reach: of {DRAWS} palm poses drawn the arm reaches none; the nearest it "
            f"comes to one is {1e3 * least:.0f} mm",
            numbers={"distance": float(least)},
        )

    def _check_within_reach(self) -> None:
        """Refuse objects that no posture of the arm brings the palm to."""
        task, hand = self.task, self.task.hand
        if hand.arm is None or task.T_world_base is None:
            return
        state = moving_hand(hand).move(self.posture)
        first = task.T_world_base.act(state.joint_pose(int(hand.arm.chain[0]) + 1).translation)
        palm = float(np.linalg.norm(state.T_base_palm.translation - self.pinch.center))
        far = float(np.linalg.norm(task.T_world_object.translation - first))
        longest = hand.arm.longest + SPARE_REACH * palm + task.object.shape.bounding_radius
        if far > longest:
            raise TaskError(
                f"the object is out of the arm's reach: it is {far:.2f} m from the first joint of "
                f"{hand.name}, and arm and hand stretched straight are {longest:.2f} m long; bring "
                "it nearer, or give T_world_base, the pose of the arm's root"
            )

    def _check_size(self) -> None:
        """Refuse objects that are too wide for the open hand, or too small for the pads."""
        hand, shape = self.task.hand.name, self.task.object.shape
        if not self.directions:
            raise TaskError(
                f"the object is too large for {hand}: its pads open {1e3 * self.widest:.0f} mm, "
                f"the smallest width across which it could close is {1e3 * self.smallest:.0f} mm; "
                "use a smaller object, another pose of it, other fingers or a larger hand"
            )
        n = len(self.task.fingers)
        pad = min(f.pad.radius for f in self.task.fingers)
        room = PACKING[min(n, max(PACKING))] * (shape.bounding_radius + pad)
        if room < 2 * pad:
            raise TaskError(
                f"the object is too small for {hand}: {n} pads of {1e3 * pad:.0f} mm radius do not "
                f"fit around a ball of {1e3 * shape.bounding_radius:.1f} mm radius; use a larger "
                "object or fewer fingers"
            )

    @property
    def tripod(self) -> tuple[str, ...]:
        """The opposer and the two fingers nearest to it, or all where there are no more."""
        state = moving_hand(self.task.hand).move(self.posture)
        pads = np.array([state.pad_center(f) for f in self.task.fingers])
        away = np.linalg.norm(pads - pads[self.pinch.opposer], axis=1)
        kept = set(np.argsort(away, kind="stable")[:TRIPOD])
        return tuple(name for i, name in enumerate(self.task.finger_names) if i in kept)

    def _stretched(self, share: float) -> FloatArray:
        """Posture at a share of the way from pinch (0) to open (1) and beyond, within limits."""
        hand = self.task.hand
        q = self.posture + share * (self.open - self.posture)
        return self._with_wrist(np.clip(q, hand.q_lower, hand.q_upper))

    def _with_wrist(self, q: FloatArray) -> FloatArray:
        q = q.copy()
        q[self.task.hand.wrist_index] = self.task.wrist_q
        if self.task.hand.arm is not None:
            q[self.task.hand.arm.index] = self.task.hand.arm.ready
        return q

    def _resting(self) -> FloatArray:
        """Joints of fingers that do not take part."""
        resting = np.ones(self.task.hand.nq, dtype=bool)
        for finger in self.task.fingers:
            resting[finger.q_index] = False
        return resting

    def _directions(self) -> list[FloatArray]:
        """Directions in the object's frame across which the hand could close.

        A dozen directions around the horizontal; for shapes of flat sides only their normals,
        because opposed contacts need opposed faces.
        """
        sides = self.task.object.shape.flat_sides
        to_object = self.task.T_world_object.rotation.T
        if sides is not None:
            candidates = list(sides)
        else:
            turns = np.linspace(0, 2 * np.pi, 12, endpoint=False)
            candidates = [to_object @ np.array([np.cos(a), np.sin(a), 0.0]) for a in turns]
        if self.task.table_height is not None:
            up = to_object @ np.array([0.0, 0.0, 1.0])
            # a box that stands on a corner has no level face normal: then any of them
            candidates = [c for c in candidates if abs(c @ up) < STEEPEST] or candidates
        return candidates

    def _free_side(self, axis: FloatArray, rng: np.random.Generator) -> FloatArray:
        """A direction across ``axis`` on which the palm may be: up, with noise."""
        up = np.array([0.0, 0.0, 1.0])
        if self.task.table_height is None:
            up = rng.normal(size=3)
        up = up - axis * (axis @ up)
        up /= np.linalg.norm(up)
        return np.array(pin.exp3(axis * rng.normal(0, TILT_NOISE)) @ up)

    def _noisy_posture(self, rng: np.random.Generator) -> FloatArray:
        share = rng.uniform(0.0, MOST_OPEN)
        return self._with_noise(
            self._stretched(share if self._stretch is None else self._stretch + share), rng
        )

    def _with_noise(self, q: FloatArray, rng: np.random.Generator) -> FloatArray:
        hand = self.task.hand
        noise = rng.normal(0, JOINT_NOISE, hand.nq) * (hand.q_upper - hand.q_lower)
        return self._with_wrist(np.clip(q + noise, hand.q_lower, hand.q_upper))

    def _noisy(self, direction: FloatArray, rng: np.random.Generator) -> FloatArray:
        if self.task.object.shape.flat_sides is not None:
            return direction
        return np.array(pin.exp3(rng.normal(0, AXIS_NOISE, 3)) @ direction)


def _along(found: Opposition, n: int) -> FloatArray:
    """Directions (n, 3), unit, in which fingers press along the opposition axis."""
    signs = np.full(n, -1.0)
    signs[found.opposer] = 1.0
    return np.asarray(signs[:, None] * found.axis)


PACKING = {2: 2.0, 3: 3**0.5, 4: (8 / 3) ** 0.5, 5: 2**0.5}
"""Largest possible smallest distance of n points on a unit sphere (Tammes' problem); points that
are closer than two pad radii belong to pads that overlap."""

STEEPEST = 0.5
"""Largest cosine between an opposition axis and the vertical for an object on a table: a finger
below the object would have to pass through the table."""


def _half_width(shape: object, direction: FloatArray) -> float:
    """Half the width (m) of a convex shape across a unit direction of its frame."""
    return float(shape.support(direction))  # type: ignore[attr-defined]


def frozen_joints(task: GraspTask) -> NDArray[np.bool_]:
    """Joints (nq,) that stay: the wrist's, unless it is free; those of an arm's side branches.

    Fingers that do not take part may move out of the way.
    """
    frozen = np.zeros(task.hand.nq, dtype=bool)
    frozen[task.hand.wrist_index] = not task.wrist_free
    if task.hand.arm is not None:
        frozen[np.setdiff1d(task.hand.arm.index, task.hand.arm.chain)] = True
    return frozen


def opposed_forces(normals: FloatArray, opposer: int) -> FloatArray:
    """Forces (n, 3) against outward normals; the opposer bears as much as all others together."""
    n = len(normals)
    share = np.full(n, n / (2.0 * (n - 1)))
    share[opposer] = n / 2.0
    return np.asarray(-normals * share[:, None])
