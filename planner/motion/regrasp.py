"""Relocations after a stroke: fingers move on one at a time while the others hold the object.

Fingers land where the stroke began, recomputed on the true geometry with the object where it stands
at the end. For every lift of the order the contacts that hold close with a margin and bear the
object's weight within the torque limits, without force on the lifted finger; all contacts do so
after the landing; and the finger's swing is free of collisions.

``plan_back`` serves a turn that stalls: from any point of the motion the fingers return to where it
began, the object held still, and the motion starts again. ``plan_others`` serves a lift that is
refused during execution: the remaining fingers move on in another order.

The swing of one finger from contact to contact while the others hold: up, over, and down.

The path of the pad's centre is given in the object's frame: along the outward normal to one of
``HEIGHTS``, at that height over the surface to above the landing, and down along the normal there.
The joints of the finger follow by steps, each a quadratic programme
(``planner.numerics.least_squares``),

    min  |J dq - (wanted - c)|^2 / height^2 + POSTURE_WEIGHT |q + dq - q_even|^2 + DAMPING |dq|^2
    s.t. nearby pairs stay ``ROOM`` apart (soft); couplings; joint limits

with q_even interpolated between both postures. The result is verified with coal at every sample and
half-way between samples: nothing penetrates, and the lifted pad stays clear of the object. Where
the fingers that hold bear the load of a use, fingers also keep ``LOADED_ROOM`` from each other, and
in another attitude ``ROOM``.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from planner.collision.pad_contact import contact_geometries, pad_contacts
from planner.collision.world import CollisionWorld
from planner.contacts import ContactSet
from planner.failure import Failure
from planner.hands.fingers import Finger
from planner.kinematics import MovingHand
from planner.motion.order import NoOrder, Order, find_order, holding, standing
from planner.motion.phase import Relocation
from planner.motion.plan import MovementPlan
from planner.numerics.least_squares import Barrier, Task, constrained_ik_step
from planner.spatial import SE3, FloatArray, IntArray
from planner.task import GraspTask
from planner.tolerances import PENETRATION_TOL, SWING_VERDICT_SHARE, TOUCH_TOL
from planner.verification import contacts_of, plan_forces

HOLDING_GRIP = 0.5
"""Least normal force (N) of the fingers that hold, where the task's grip force is infeasible: a
finger between two others pushes the object out of their grip, so it presses lightly."""

HOLDING_EDGES = 16
"""Sides of the friction pyramid of those forces; the inscribed pyramid gives away
1 - cos(pi/16) = 2 % of the friction."""


class RegraspPlanner:
    """Plans relocations after strokes of one task; the geometry is built once.

    Attributes:
        lifted: The task without table and obstacles.
        without: The same without each of its fingers.
        paths: Swings of single fingers.
    """

    def __init__(self, task: GraspTask) -> None:
        """Prepare the geometry."""
        self.lifted = replace(task, table_height=None, obstacles=())
        self.paths = FingerPaths(self.lifted)
        self.without = [
            self.lifted.with_fingers([name for name in task.finger_names if name != away])
            for away in task.finger_names
        ]

    def relocations(
        self,
        stroke: MovementPlan,
        *,
        moved: frozenset[int] = frozenset(),
        refused: frozenset[int] = frozenset(),
    ) -> tuple[Relocation, ...] | NoOrder | Failure:
        """The relocations after a stroke, in an order that holds; or why there is none.

        Args:
            stroke: The stroke.
            moved: Numbers of the fingers that have moved on already.
            refused: Numbers of the fingers that execution could not lift next.

        Returns:
            The relocations; or ``NoOrder``; or a failure where the object does not look the same to
            the hand after the stroke.
        """
        end = _End(self, stroke)
        if end.failure is not None:
            return end.failure

        def refuse(finger: int, before: frozenset[int]) -> Failure | None:
            if before == moved and finger in refused:
                text = "it could not be lifted when it was tried"
                return Failure(kind="refused_before", text=text)
            return end.refuse(finger, before)

        found = find_order(end.begin, end.end, stroke.path.axis, refuse=refuse, moved=moved)
        return end.build(found, moved) if isinstance(found, Order) else found


def cut_motion(motion: MovementPlan, path_parameter: float) -> MovementPlan:
    """The part of a motion up to the knot nearest to a path parameter, at least to the second.

    Args:
        motion: The whole.
        path_parameter: Where on its path, 0 to 1.
    """
    at = np.array([knot.path_parameter for knot in motion.knots])
    last = max(1, int(np.abs(at - path_parameter).argmin()))
    return motion.with_knots(motion.knots[: last + 1], motion.path.cut(float(at[last])))


def plan_back(motion: MovementPlan, path_parameter: float) -> tuple[Relocation, ...] | Failure:
    """Relocations of all fingers from a point of a motion back to its beginning; or why not.

    Args:
        motion: The motion.
        path_parameter: Where on its path it is now, 0 to 1; the nearest knot stands for it.
    """
    task = motion.grasp.task
    if len(task.fingers) - 1 < task.fingers_needed:
        n = len(task.fingers)
        text = f"{n} fingers are too few to lift one of them"
        return Failure(kind="too_few_fingers", text=text, numbers={"fingers": n})
    found = RegraspPlanner(motion.path.borne(task)).relocations(cut_motion(motion, path_parameter))
    return found.failure if isinstance(found, NoOrder) else found


def plan_others(
    stroke: MovementPlan, moved: Collection[str], refused: Collection[str]
) -> tuple[Relocation, ...] | Failure:
    """Relocations of the remaining fingers in an order that avoids refused lifts; or why not.

    Args:
        stroke: The stroke.
        moved: Names of the fingers that have moved on already.
        refused: Names of the fingers that cannot be lifted next.
    """
    task = stroke.grasp.task
    numbers = [frozenset(map(task.finger_names.index, names)) for names in (moved, refused)]
    planner = RegraspPlanner(stroke.path.borne(task))
    found = planner.relocations(stroke, moved=numbers[0], refused=numbers[1])
    return found.failure if isinstance(found, NoOrder) else found


@dataclass(frozen=True, kw_only=True)
class _Move:
    """A lift that holds: the swing, and the forces during and after it."""

    postures: FloatArray
    grip: float
    during: ContactSet
    after: ContactSet


class _End:
    """Hand and object at the end of a stroke."""

    def __init__(self, planner: RegraspPlanner, stroke: MovementPlan) -> None:
        """Compute the contacts where fingers stand and where they land."""
        self._planner, self._stroke = planner, stroke
        first, last = stroke.knots[0], stroke.knots[-1]
        self.T_world_object = last.T_world_object
        self._base = self.T_world_object.inverse() * stroke.T_world_base
        task = planner.lifted
        touches = pad_contacts(task, task.T_world_object * self._base, first.q)
        gaps = np.array([touch.pad_gap for touch in touches])
        worst = int(np.abs(gaps).argmax())
        self.failure: Failure | None = None
        if abs(gaps[worst]) > TOUCH_TOL:
            self.failure = Failure(
                kind="object_not_alike",
                text="the object does not look the same to the hand after a stroke: "
                f"{stroke.path} put the surface {1e3 * gaps[worst]:.1f} mm from where "
                f"{task.finger_names[worst]} would land",
                numbers={"gap": float(gaps[worst])},
            )
        self.begin = contacts_of(task, touches).transformed(
            self.T_world_object * task.T_world_object.inverse()
        )
        self.end = last.contacts
        self._moves: dict[tuple[int, frozenset[int]], _Move] = {}

    def posture(self, moved: frozenset[int]) -> FloatArray:
        """Joints (nq,) after some fingers have moved on; idle fingers go with the first to move."""
        first, last = self._stroke.knots[0].q, self._stroke.knots[-1].q
        q = (first if moved else last).copy()
        for i, finger in enumerate(self._planner.lifted.fingers):
            q[finger.q_index] = (first if i in moved else last)[finger.q_index]
        return q

    def refuse(self, finger: int, moved: frozenset[int]) -> Failure | None:
        """Why a finger cannot be lifted although the others close, None if it can."""
        planner, base = self._planner, self._stroke.T_world_base
        task = planner.lifted
        name = task.finger_names[finger]
        q, landed = self.posture(moved), self.posture(moved | {finger})
        rest = holding(self.begin, self.end, moved, finger)
        for grip in (task.grip_force, min(HOLDING_GRIP, task.grip_force)):
            during = plan_forces(
                planner.without[finger],
                rest,
                base,
                q,
                min_normal=grip,
                friction_scale=SWING_VERDICT_SHARE,
                edges=HOLDING_EDGES,
            )
            if during.found:
                break
        if not during.found:
            return Failure(
                kind="no_forces_while_lifted",
                text=f"the others cannot bear the load: {during.reason}",
            )
        after = plan_forces(task, standing(self.begin, self.end, moved | {finger}), base, landed)
        if not after.found:
            return Failure(
                kind="no_forces_after_landing",
                text=f"with {name} landed there are no forces: {after.reason}",
            )
        postures = planner.paths.path(task.hand.fingers[name], self._base, q, landed)
        if isinstance(postures, Failure):
            return postures
        self._moves[finger, moved] = _Move(
            postures=postures, grip=grip, during=during.contacts, after=after.contacts
        )
        return None

    def build(self, order: Order, moved: frozenset[int]) -> tuple[Relocation, ...]:
        """The relocations of an order whose lifts hold, after some fingers have moved on."""
        out: list[Relocation] = []
        before = standing(self.begin, self.end, moved) if moved else self.end
        for lift in order.lifts:
            move = self._moves[lift.finger, lift.moved]
            out.append(
                Relocation(
                    cycle=0,
                    finger=self._planner.lifted.finger_names[lift.finger],
                    T_world_object=self.T_world_object,
                    postures=move.postures,
                    before=before,
                    during=move.during,
                    after=move.after,
                    margin=lift.margin,
                    grip=move.grip,
                )
            )
            before = move.after
        return tuple(out)


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

LOADED_ROOM = 2e-3
"""Least distance (m) between links of different fingers in a gait whose task needs wrenches:
fingers that bear them yield by a millimetre, and one that swung 0.5 mm past its neighbour pressed
on it with 1.8 N. In another attitude ``ROOM`` is kept: with 2 mm gaits took six times as long to
find."""

UPRIGHT = 0.999
"""Least share (-) of gravity along -z with which the hand is above what it holds."""

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
        down = float(task.gravity[2]) <= -UPRIGHT * float(np.linalg.norm(task.gravity))
        self._apart = LOADED_ROOM if task.needed else 0.0 if down else ROOM
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
            out.append(self.follow(finger, base, guess, center, q + share * (landed - q), height))
        return np.array([*out, landed])

    def follow(
        self,
        finger: Finger,
        base: SE3,
        q: FloatArray,
        center: FloatArray,
        even: FloatArray,
        height: float,
    ) -> FloatArray:
        """Joints (nq,) near q with the finger's pad centred at a point (3,), object frame.

        Args:
            finger: The finger.
            base: Pose of the base in the object's frame.
            q: Joints (nq,) to begin with; those of other fingers stay.
            center: Where the pad's centre is wanted (3,), m.
            even: Joints (nq,) that the posture keeps near to.
            height: Length (m) by which errors are measured.
        """
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
        room = ROOM + np.where(near.hand_environment, 0.0, self._apart)
        return rates[moving], (room - near.distances)[moving]

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
            crowded = self._apart and self.world.between_fingers(T_world_base, q, self._apart)
            if crowded:
                return Failure(
                    kind="swing_crowded",
                    text=f"{crowded} apart at {_where(k, samples)}; fingers keep "
                    f"{1e3 * self._apart:g} mm",
                    numbers={"distance": crowded.distance},
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
