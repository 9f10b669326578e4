"""``plan_handover``: one of two hands takes the object from the other.

Each hand's grasp is an ordinary grasp of that hand alone; here the two are put together. The giving
hand grasps the object where it stands; the taking hand then grasps it in the air, where the other
one leaves it room. A pair of two hands (``planner.hands.two_hands``) is placed so that its
carriages reach both grasps. In the pair there are three grasps of one object: that of the giving
hand, that of both, and that of the taking hand. Each has its own closure, forces and torque limits.

While the load is transferred, the forces are

    f(s) = (1 - s) f_give + s f_take,   0 <= s <= 1

Friction cones, torque limits and the balance with the weight are convex, so that every f(s) is
admissible where f_give and f_take are.

The hands come and go straight, without turning: each way is followed without a gap, since a hand
that is at a distance d from all others may move by d before it could touch.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice, product
from typing import Any

import numpy as np
import pinocchio as pin

from planner.arrays import checked_kind, checked_number
from planner.collision.pregrasp import APPROACH_CLEARANCE, CLOSING_SHARES, STANDOFF, Approach
from planner.collision.world import TABLE_SIZE, CollisionWorld
from planner.errors import NotFoundError, TaskError
from planner.failure import Failure
from planner.hands.fingers import Side
from planner.hands.hand import Hand
from planner.hands.two_hands import carriage_joints
from planner.motion.path import ObjectPath
from planner.motion.phase import Handover
from planner.motion.plan import ManipulationPlan
from planner.motion.verify import MovementVerifier
from planner.numerics.kernels import planning_time
from planner.plan import GraspPlan
from planner.search.attempt import Attempt, check_seed, nothing_found
from planner.search.grasp import attempts
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask, Obstacle
from planner.verification import (
    contacts_at,
    no_forces,
    plan_forces,
    verify_geometry,
    verify_grasp,
)

__all__ = ["plan_handover", "put_together"]

ROUNDS = 20
"""Rounds of a search, each of which adds one grasp to give with and ``TAKES`` to take with."""

TAKES = 6
"""Grasps to take with, per round: most leave the giving hand no room."""

MOST_ATTEMPTS = 300
"""Attempts of each hand after which no more grasps of it are looked for."""

FIRST_ATTEMPTS = 60
"""Attempts in which each hand has to find its first grasp. A hand that can grasp the object takes a
few; one that cannot is named after these."""

SPINS = 24
"""Turns of the pair about the line between its palms that are looked at: 15 degrees apart."""

LEAST_OPPOSED = float(np.cos(np.deg2rad(40.0)))
"""Cosine between the directions in which both palms look from which on both hands would come from
one side: carriages tilt by 69 degrees."""

LEAST_APART = 0.012
"""Distance (m) of a contact of one hand from one of the other below which their tips would meet:
less than the diameter of the thinnest fingertip."""

WORTH_APART = 0.03
"""Distance (m) of contacts that is worth as much as palms that look at right angles, not alike."""

BACK = (0.0, 0.08, 0.16, 0.24)
"""Distances (m) beyond the begin of its way in at which the taking hand may wait, tried so."""

LIFT_HEIGHT = 0.25
"""Height (m) above where it stood at which the object is handed over: a hand's length, so that the
other hand comes under it."""

HIGHEST = 2.0
"""Largest height (m) of a lift: what a person reaches."""

BELOW = "table below"
"""Name of the table in tasks in the air, where it is an obstacle."""

TABLE_ROOM = 0.01
"""Least distance (m) of the waiting hand from the table and all else."""

REACHED = 1.0 + 1e-9
"""Largest share (-) of its range that a joint of a carriage takes up, with what a file rounds."""

LEAST_STEP = 5e-4
"""Shortest step (m) along a way: half of the clearance that is asked for, so that nothing is jumped
over."""


def plan_handover(
    task: GraspTask,
    *,
    to: str | None = None,
    seed: int = 0,
    lift_height: float = LIFT_HEIGHT,
    rounds: int = ROUNDS,
) -> ManipulationPlan:
    """A handover between the two hands of a task: a movement with a ``Handover`` in it.

    Args:
        task: A task of two hands: its object, where that stands, friction and surroundings. Its
            fingers are not used: both hands take it with their fingertips.
        to: Name of the hand that takes, one of ``task.hand.sides``; the second if None.
        seed: Same seed, same plan.
        lift_height: How far above where it stands the object is handed over, m.
        rounds: How long to search; each round adds grasps of both hands.

    Raises:
        NoGraspFoundError: One of the hands finds no grasp, or no pair of grasps goes together;
            carries why each does not.
        NotFoundError: No hand of the pair has that name.
        TaskError: The task is of one hand, or one of the hands cannot grasp the object.
    """
    check_seed(seed)
    task = checked_kind("task", task, GraspTask)
    giver, taker = _sides(task, to)
    checked_number("lift_height", lift_height, above=0.0, most=HIGHEST, unit="m", error=TaskError)
    meeting = _Meeting(task, giver, taker, lift_height)
    gives = _grasps(giver, _alone(task, giver), seed)
    takes = _grasps(taker, replace(_alone(task, taker), **meeting.in_the_air), seed)
    made: list[Attempt[ManipulationPlan]] = []
    mine: list[GraspPlan] = []
    others: list[GraspPlan] = []
    for _ in range(rounds):
        new, more = list(islice(gives, 1)), list(islice(takes, TAKES))
        pairs = [(g, t) for g in mine for t in more]
        pairs += [(g, t) for g in new for t in (*others, *more)]
        mine, others = mine + new, others + more
        for give, take in sorted(pairs, key=_order):
            begin = planning_time()
            found = meeting.plan(give, take)
            index, used = len(made), planning_time() - begin
            failure = found if isinstance(found, Failure) else None
            plan = None if isinstance(found, Failure) else found
            made.append(Attempt(index=index, plan=plan, failure=failure, cpu_s=used))
            if plan is not None:
                return plan
    raise nothing_found(
        f"handover of {task.object.name} from {giver.name} to {taker.name} ({task.hand.name})",
        made,
        "Try another seed, or a larger object: what is handed over needs room for both hands",
    )


def put_together(
    task: GraspTask,
    give: GraspPlan,
    take: GraspPlan,
    *,
    to: str,
    lift_height: float,
    T_world_pair: SE3 | None = None,
) -> ManipulationPlan | Failure:
    """A handover out of two grasps, or why it is none: everything is checked as when planning.

    Args:
        task: The task of both hands.
        give: Grasp of the giving hand alone, where the object stands.
        take: Grasp of the taking hand alone, in the air.
        to: Name of the hand that takes.
        lift_height: See ``plan_handover``, m.
        T_world_pair: Pose of the pair's base; where the carriages reach best if None. Two places
            may be as good, of which rounding takes one.

    Raises:
        NotFoundError, TaskError: See ``plan_handover``.
    """
    return _Meeting(task, *_sides(task, to), lift_height).plan(give, take, T_world_pair)


def _sides(task: GraspTask, to: str | None) -> tuple[Side, Side]:
    """Who gives and who takes.

    Raises:
        NotFoundError, TaskError: See ``plan_handover``.
    """
    sides = {side.name: side for side in task.hand.pair}
    if not sides:
        raise TaskError(
            f"a handover takes two hands, and {task.hand.name} is one; load two, such as "
            "two_allegro_hands or allegro_hand+shadow_hand_left"
        )
    if task.hand.on_arm:
        raise TaskError(
            f"a handover takes hands on carriages, and those of {task.hand.name} are on arms; name "
            "the hands alone, as in allegro_hand+shadow_hand_left"
        )
    to = list(sides)[-1] if to is None else to
    if not isinstance(to, str) or to not in sides:
        raise NotFoundError("hand to take the object", str(to), sides)
    (giver,) = (side for name, side in sides.items() if name != to)
    return giver, sides[to]


def _grasps(side: Side, task: GraspTask, seed: int) -> Iterator[GraspPlan]:
    """Grasps of one hand alone, as long as attempts find some.

    Raises:
        NoGraspFoundError: Its first ``FIRST_ATTEMPTS`` find none.
        TaskError: The hand cannot grasp the object.
    """
    made, found = [], False
    for attempt in islice(attempts(task, seed=seed), MOST_ATTEMPTS):
        if attempt.plan is not None:
            found = True
            yield attempt.plan
        made.append(attempt)
        if not found and len(made) == FIRST_ATTEMPTS:
            what = f"grasp of {task.object.name} by {side.name} ({task.hand.name}) alone"
            raise nothing_found(what, made, "A handover needs one of each hand")


def _alone(task: GraspTask, side: Side) -> GraspTask:
    """The task of one hand alone."""
    assert side.alone is not None
    return GraspTask.create(
        side.alone,
        task.object,
        T_world_object=task.T_world_object,
        table_height=task.table_height,
        obstacles=task.obstacles,
        gravity=task.gravity,
        mu=task.mu,
        mu_torsion=task.mu_torsion,
        contact_model=task.contact_model,
        expected_load=task.expected_load or None,
    )


def _looks(plan: GraspPlan) -> FloatArray:
    """Where a palm looks (3,), world."""
    return np.asarray(plan.T_world_palm.rotation @ plan.task.hand.palm_normal)


def _alike(give: GraspPlan, take: GraspPlan) -> float:
    """How much two palms look in one direction (-)."""
    return float(_looks(give) @ _looks(take))


def _apart(give: GraspPlan, take: GraspPlan) -> float:
    """Least distance (m) of a contact of one hand from one of the other."""
    ways = give.contacts.positions[:, None] - take.contacts.positions[None]
    return float(np.linalg.norm(ways, axis=2).min())


def _order(pair: tuple[GraspPlan, GraspPlan]) -> float:
    """The smaller, the earlier a pair is tried: palms opposed, contacts apart."""
    return _alike(*pair) - _apart(*pair) / WORTH_APART


class _Carried:
    """One hand of a pair, as its carriage carries it."""

    def __init__(self, hand: Hand, side: Side) -> None:
        """Find where it is at rest, and where its joints stand in those of the pair."""
        assert side.alone is not None
        alone, model = side.alone, hand.pin_model
        data = model.createData()
        pin.framesForwardKinematics(model, data, hand.neutral)
        base = data.oMf[model.getBodyId(side.called(alone.description.base_body))]
        self._hand, self._mine = hand, side.carriage
        self.root = SE3(data.oMi[int(side.carriage[-1]) + 1])
        self.at_rest = base.inverse() * self.root  # of the carriage, in the base
        palm = data.oMf[model.getBodyId(side.palm_body)]
        self.looks = palm.rotation @ side.palm_normal
        self._index = side.joints
        self.geometries = frozenset(side.called(g.name) for g in alone.geometries)
        self.fingers = dict(zip(alone.fingers, side.fingers, strict=True))

    def joints(self, T_pair_base: SE3) -> FloatArray:
        """Joints of the carriage (6,) that bring the base there."""
        return carriage_joints(self.root.inverse() * T_pair_base * self.at_rest)

    def put(self, q: FloatArray, T_pair_base: SE3, own: FloatArray) -> None:
        """Write carriage and joints of the hand alone into q (nq,) of the pair."""
        q[self._mine], q[self._index] = self.joints(T_pair_base), own

    def strain(self, T_pair_base: SE3) -> float:
        """Largest share (-) of its range that a joint of the carriage takes up; above 1 beyond."""
        low, high = self._hand.q_lower[self._mine], self._hand.q_upper[self._mine]
        at = self.joints(T_pair_base)
        return float(np.maximum(at / high, at / low).max())

    def shift(self, R_pair: FloatArray, way: FloatArray) -> FloatArray:
        """Change of the pair's joints (nq,) that moves the hand straight by a way (3,), world."""
        out = np.zeros(self._hand.nq)
        out[self._mine[:3]] = self.root.rotation.T @ R_pair.T @ way
        return out


class _Meeting:
    """Grasps of one object by the two hands of a pair, put together."""

    def __init__(self, task: GraspTask, giver: Side, taker: Side, lift_height: float) -> None:
        """Find where the hands are at rest."""
        self._task, self._names, self._lift_height = task, (giver.name, taker.name), lift_height
        self._hands = _Carried(task.hand, giver), _Carried(task.hand, taker)
        below = () if task.table_height is None else (_table_below(task, lift_height),)
        self.in_the_air: dict[str, Any] = {"table_height": None, "obstacles": below}
        self._air = CollisionWorld(replace(task, **self.in_the_air))
        self._standing = CollisionWorld(task)

    def plan(
        self, give: GraspPlan, take: GraspPlan, pair: SE3 | None = None
    ) -> ManipulationPlan | Failure:
        """A handover with these grasps, the pair at a pose if one is given; or why it is none."""
        if _alike(give, take) > LEAST_OPPOSED:
            return Failure(kind="one_side", text="both hands would come from one side")
        if _apart(give, take) < LEAST_APART:
            return Failure(kind="contacts_meet", text="both hands would touch at one place")
        pair = self._placed(give, take) if pair is None else pair
        if pair is None or self._strain(pair, give, take) > REACHED:
            return Failure(kind="carriage_reach", text="the carriages do not reach both grasps")
        giver, taker = self._hands
        held = self._joints(pair, give, take, give.q, take.q)
        opened = self._joints(pair, give, take, give.q, take.q_pregrasp)
        left = self._joints(pair, give, take, give.q_pregrasp, take.q)
        world = self._air.of(self._pair_task(pair, give, take, **self.in_the_air))
        both = _grasp(world, pair, held, opened, take)
        if isinstance(both, Failure):
            return both
        out, way = (_way_back(plan) for plan in (give, take))
        failure = (
            _on_way(world, pair, opened, taker, way)
            or _closing(world, pair, held, opened, taker)
            or _closing(world, pair, held, left, giver)
            or _on_way(world, pair, left, giver, out)
        )
        if failure is not None:
            return failure
        come = opened + taker.shift(pair.rotation, way)
        waiting = self._waiting(world, pair, come, give, take)
        if isinstance(waiting, Failure):
            return waiting
        alone = self._pair_task(pair, take=take, **self.in_the_air)
        taken = _grasp(world.of(alone), pair, held, opened, take)
        if isinstance(taken, Failure):
            return taken
        held_still = ObjectPath.of_wrist(np.eye(3))
        knots = MovementVerifier(waiting.task).held(pair, waiting.q, held_still)
        if isinstance(knots, Failure):
            return knots
        handover = Handover(
            both=both,
            take=taken,
            way_in=np.array([waiting.q, come, opened]),
            way_out=np.array([left, left + giver.shift(pair.rotation, out)]),
            giver=self._names[0],
            taker=self._names[1],
            lift_height=self._lift_height,
            task=self._task,
            alone=(give, take),
        )
        return ManipulationPlan.of_held(waiting, knots, handover)

    def _placed(self, give: GraspPlan, take: GraspPlan) -> SE3 | None:
        """Pose of the pair at which the carriages reach best; None if they nowhere do.

        The line between the palms lies along the mean of where they look; the pair may turn about
        it. The middle of both carriages' slides is then where they need them.
        """
        giver, taker = self._hands
        wanted = _looks(give) - _looks(take)
        along = giver.looks - taker.looks
        first = pin.Quaternion.FromTwoVectors(along, wanted).matrix()
        ends = [(give, giver), (take, taker)]
        ways = [_way_back(plan) for plan, _ in ends]
        best, least = None, 1.0
        for angle in np.linspace(0.0, 2.0 * np.pi, SPINS, endpoint=False):
            turn = pin.exp3(angle * wanted / np.linalg.norm(wanted)) @ first
            at = [(plan.T_world_base * hand.at_rest).translation for plan, hand in ends]
            rest = [turn @ hand.root.translation for _, hand in ends]
            pair = SE3(turn, np.mean(np.array(at) + np.array(ways) / 2.0 - np.array(rest), axis=0))
            strain = self._strain(pair, give, take)
            if strain <= least:
                best, least = pair, strain
        return best

    def _strain(self, pair: SE3, give: GraspPlan, take: GraspPlan) -> float:
        """Largest share (-) of its range that a joint of the carriages takes up, the pair there."""
        return max(
            hand.strain(pair.inverse() * SE3(base.rotation, base.translation + share * way))
            for plan, hand in zip((give, take), self._hands, strict=True)
            for base, way in [(plan.T_world_base, _way_back(plan))]
            for share in (0.0, 1.0)
        )

    def _joints(
        self, pair: SE3, give: GraspPlan, take: GraspPlan, giving: FloatArray, taking: FloatArray
    ) -> FloatArray:
        """Joints (nq,) of the pair with both hands at their grasps, and their own joints."""
        q = self._task.hand.neutral
        for hand, plan, own in zip(self._hands, (give, take), (giving, taking), strict=True):
            hand.put(q, pair.inverse() * plan.T_world_base, own)
        return q

    def _pair_task(
        self,
        pair: SE3,
        give: GraspPlan | None = None,
        take: GraspPlan | None = None,
        **changes: Any,
    ) -> GraspTask:
        """The task of the pair at which the fingers of one grasp or of both touch."""
        grasps = [(h, p) for h, p in zip(self._hands, (give, take), strict=True) if p is not None]
        names = [hand.fingers[name] for hand, plan in grasps for name in plan.task.finger_names]
        return replace(
            self._task,
            T_world_base=pair,
            finger_names=tuple(names),
            alternatives=(),
            grip_force=min(plan.task.grip_force for _, plan in grasps),
            **changes,
        )

    def _waiting(
        self, world: CollisionWorld, pair: SE3, come: FloatArray, give: GraspPlan, take: GraspPlan
    ) -> GraspPlan | Failure:
        """The grasp of the giving hand where the object stands, while the other one waits.

        It waits at the first place of which nothing is near, on the table or in the air.
        """
        taker = self._hands[1]
        task = self._pair_task(pair, give)
        standing, out = self._standing.of(task), _way_back(give)
        start = SE3(pair.rotation, pair.translation + out)
        back = _way_back(take)
        failure = Failure(kind="no_place_to_wait", text="the taking hand has no place to wait")
        for beyond, along in product(BACK, (back, back + np.array([0.0, 0.0, STANDOFF]))):
            way = beyond * along / np.linalg.norm(along)
            q = come + taker.shift(pair.rotation, way)
            if np.maximum(q - task.hand.q_upper, task.hand.q_lower - q).max() > 0.0:
                continue
            near = min(standing.nearest_of(T, q, taker.geometries).distance for T in (pair, start))
            if near < TABLE_ROOM or _on_way(world, pair, come, taker, way) is not None:
                continue
            opened = q.copy()
            self._hands[0].put(opened, pair.inverse() * give.T_world_base, give.q_pregrasp)
            approach = Approach(
                q=opened, pregrasp_distance=give.pregrasp_distance, T_world_base_start=start
            )
            found = verify_grasp(
                task, pair, q, record=give.record, approach=approach, world=standing
            )
            if not isinstance(found, Failure):
                return found
            failure = found
        return failure


def _table_below(task: GraspTask, lift_height: float) -> Obstacle:
    """The table, as far below the object as it will be in the air."""
    assert task.table_height is not None
    size = np.array(TABLE_SIZE)
    x, y, _ = task.T_world_object.translation
    at = np.array([x, y, task.table_height - lift_height - size[2] / 2])
    return Obstacle(name=BELOW, size=size, T_world_obstacle=SE3(np.eye(3), at))


def _way_back(plan: GraspPlan) -> FloatArray:
    """From a grasp to where its straight way in begins (3,), m, world."""
    return np.asarray(plan.T_world_base_start.translation - plan.T_world_base.translation)


def _grasp(
    world: CollisionWorld, pair: SE3, q: FloatArray, opened: FloatArray, take: GraspPlan
) -> GraspPlan | Failure:
    """A grasp in the air that is closed while hands are there already, or what is wrong with it."""
    task = world.task
    verification = verify_geometry(world, pair, q)
    if verification.failure is not None:
        return verification.failure
    # closed they are: each hand's contacts alone were proven to be, where it was planned
    contacts = contacts_at(task, pair, q)
    forces = plan_forces(task, contacts, pair, q)
    if not forces.found:
        return no_forces(task, forces)
    return GraspPlan(
        task=task,
        T_world_base=pair,
        T_world_base_start=pair,
        q=q,
        q_pregrasp=opened,
        pregrasp_distance=take.pregrasp_distance,
        contacts=forces.contacts,
        forces=forces,
        verification=verification,
        record=take.record,
    )


def _on_way(
    world: CollisionWorld, pair: SE3, q: FloatArray, hand: _Carried, way: FloatArray
) -> Failure | None:
    """What a hand comes too near to on its straight way (3,), m, world; None if to nothing."""
    length, at = float(np.linalg.norm(way)), 0.0
    shift = hand.shift(pair.rotation, way)
    while length > 0.0:
        near = world.nearest_of(pair, q + min(at / length, 1.0) * shift, hand.geometries)
        if near.distance < APPROACH_CLEARANCE:
            return Failure(
                kind="way_collision",
                text=f"a hand touches on its way beside the other: {near}",
                numbers={"distance": near.distance},
            )
        if at >= length:
            break
        at += max(near.distance - APPROACH_CLEARANCE, LEAST_STEP)
    return None


def _closing(
    world: CollisionWorld, pair: SE3, q: FloatArray, opened: FloatArray, hand: _Carried
) -> Failure | None:
    """What a hand touches while its fingers close or open beside the other; None if nothing."""
    for share in CLOSING_SHARES.ravel():
        near = world.nearest_of(pair, q + share * (opened - q), hand.geometries)
        if near.distance <= 0.0:
            return Failure(
                kind="closing_collision",
                text=f"the fingers touch while they move: {near}",
                numbers={"distance": near.distance},
            )
    return None
