"""``plan_single_stroke``: pick an object up, turn or move it on one grasp, put it down.

Turns about the vertical come easily to hands: tips roll around the object. Where the object is
tilted or moved, tips may pivot on their contacts instead; the pivot is bounded here. The fallback
schedule tells which fingers and pads are tried in turn, and how far beyond the angle they turn.

``OnArm``: manipulations planned for a hand alone, made by the hand on its arm.

While the hand turns the object its base stands still. So the turn is planned for the hand without
its arm, where the arm can bring the palm, and judged again with the arm and the way in, the lift,
the carry and the way out that the arm makes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
import pinocchio as pin

from planner.collision.arm_path import LIFT_HEIGHT, verify_arm_path
from planner.collision.pregrasp import way_back
from planner.collision.world import CollisionWorld
from planner.errors import HandError, TaskError
from planner.failure import Failure
from planner.forces import ForceLoop
from planner.hand_loading import load_hand
from planner.hands.arm import read_mount
from planner.hands.hand import Hand
from planner.kinematics import HandState, follow, palm_paths, palm_pose, reach, straight_path
from planner.motion.context import OUT_OF_REACH, Reaches, tripods, with_rolling_pads
from planner.motion.ending import Rests, planned_ending, standing
from planner.motion.path import (
    LARGEST_TURN,
    UNTURNED,
    AnyAttitude,
    ObjectPath,
    check_place,
    checked_attitude,
    checked_axis,
    checked_shift,
    tilts,
)
from planner.motion.plan import Ending, ManipulationPlan, MovementPlan, rise_for
from planner.motion.search import MotionAttempt, motion_attempts
from planner.motion.task import with_fingers
from planner.motion.verify import FALLS, MovementVerifier, Waypoint, pressed
from planner.plan import SolveRecord
from planner.search.attempt import nothing_found
from planner.spatial import SE3, FloatArray, rotation_angle, shifted
from planner.synthesis.problem import Start
from planner.synthesis.seeds import turning_seeder_for
from planner.system.threads import made_once
from planner.task import GraspTask
from planner.verification import force_arguments, verify_grasp

CANDIDATES = 3
"""Plans of which the best is taken, unless one is good enough to be taken at once; fewer where the
schedule gives no more."""

GOOD_RESERVE, GOOD_MARGIN = 0.1, 0.15
"""Share of its limit that every actuator keeps, and margin of closure (-), with which a plan is
good enough. The reserve moves the fingers and answers pushes, slips and an object beside its
planned place."""

GOOD_PRESS = 7.5
"""Largest normal force (N) in an attitude and on the way there with which a plan is good enough:
the closed loop may ask for 1.6 times as much."""

GOOD_ON_BALLS = 0.4
"""Margin of closure (-) with which a plan for a ball is good enough, whatever its reserve. Below it
one finger opposes another with most of the force, and torsional friction of the pivoting tips holds
the ball back; above it all fingers press alike."""

TURN_TOLERANCE, TILT_TOLERANCE, SHIFT_TOLERANCE = 0.03, 0.01, 0.0
"""Default path tolerance (m) of turns about the vertical, of tilts, and of translations. An object
that is tilted or moved is to end where it was asked to. A turn about the vertical gains angle by
the tolerance: a finger follows a face a third of the way around and cannot go as far to the side.
"""

MAX_ATTEMPTS = 50
"""Attempts before giving up."""

MOST_PIVOT = math.radians(12.0)
"""Most (rad) that a tip may pivot while the object is tilted or moved. With more,
torsional friction may stop the object short of its target."""

FALLEN = 12
"""Grasps that hold palm down but not in the attitude after which the search ends if none did: some
seconds. A Shadow-type hand had up to 6 before its first plan."""

OVERSHOOT, TIPS_OVERSHOOT, LEAST_OVERSHOOT = (math.radians(degrees) for degrees in (8.0, 5.0, 2.0))
"""Planned overshoot (rad) of the turn. A grasp made beside its planned place meets a joint limit
early, and the reference of an object that lags continues into the overshoot. Objects that turn the
fingertips along (``Shape.turns_tips``) get less, because hands can hardly turn wide ones further.
The least is for the last resort, and for turns by several strokes, whose last stroke makes up for
what is missing."""

FIRST, FIRST_TIPS, LATER = 3, 6, 8
"""Attempts of the first entry, of the first entry for objects that turn the tips along, whose
starts hold less often, and of each later entry."""


@dataclass(frozen=True, kw_only=True)
class Fallback:
    """One entry of the schedule.

    Attributes:
        task: The task, with the fingers and the pads of this entry.
        overshoot: Turn planned beyond what is asked for, rad.
        attempts: Attempts before the next entry; None until a plan is found.
    """

    task: GraspTask
    overshoot: float
    attempts: int | None


def fallback_schedule(task: GraspTask) -> Iterator[Fallback]:
    """The entries in the order in which they are tried.

    An entry ends the search if it gives a good plan, or enough plans with those before it:

        object       fingers and pads                     overshoot       attempts
        cylinder     all fingers                          8 degrees       3
                     one less, for each; thumb last       8               8
                     all, pads as wide as tips are round  8               3
        block, mesh  thumb and the first two neighbours   5               6
                     each other pair of neighbours        5               8
        ball         the same, and after its first entry  2               6
        any          the first fingers                    2               until one is found

    Fingers that the caller names all take part.
    """
    tips = task.object.shape.turns_tips
    sets = [task]
    if task.may_spare_fingers and len(task.finger_names) > task.fingers_needed:
        if tips:
            # a fourth finger would have to go all the way as well: on a block it stays on its face
            sets = [with_fingers(task, names) for names in tripods(task)]
        else:
            # the thumb comes first and is left out last
            for left_out in reversed(task.finger_names):
                names = [name for name in task.finger_names if name != left_out]
                sets.append(with_fingers(task, names))
    overshoot, first = (TIPS_OVERSHOOT, FIRST_TIPS) if tips else (OVERSHOOT, FIRST)
    yield Fallback(task=sets[0], overshoot=overshoot, attempts=first)
    if task.object.shape.ball_like:
        yield Fallback(task=sets[0], overshoot=LEAST_OVERSHOOT, attempts=first)
    for one in filter(_closes, sets[1:]):
        yield Fallback(task=one, overshoot=overshoot, attempts=LATER)
    # contacts are nearer to the rims of pads on cylinders that are wide for a hand
    if not with_rolling_pads(sets[0]).hand.rolls:
        rolling = replace(sets[0], hand=task.hand.rolling)
        yield Fallback(task=rolling, overshoot=overshoot, attempts=first)
    yield Fallback(task=sets[0], overshoot=LEAST_OVERSHOOT, attempts=None)


def _closes(task: GraspTask) -> bool:
    """Whether the fingers open wide enough for the object: without a thumb they may not."""
    try:
        turning_seeder_for(task)
    except TaskError:
        return False
    return True


def plan_single_stroke(
    task: GraspTask,
    *,
    axis: Sequence[float] | FloatArray = (0.0, 0.0, 1.0),
    angle: float,
    shift: Sequence[float] | FloatArray = (0.0, 0.0, 0.0),
    place: tuple[float, float] | None = None,
    path_tolerance: float | None = None,
    seed: int = 0,
    max_attempts: int = MAX_ATTEMPTS,
    rests: Rests | None = None,
    attitude: AnyAttitude = "down",
) -> ManipulationPlan:
    """Plan a manipulation on one grasp.

    Args:
        task: What stands where, on a table, and the hand. Where it may spare fingers, plans are
            tried with one less too (``fallback_schedule``), and the plan's task has the chosen.
        axis: Axis of the turn (3,), world.
        angle: Turn in the hand, rad, with its sign.
        shift: Translation in the hand (3,), m, world, evenly along the turn.
        place: Where the object is to stand, x and y in m, world; where it was if None.
        path_tolerance: How far the object may leave its path, m; if None ``TURN_TOLERANCE``, or
            ``TILT_TOLERANCE`` or ``SHIFT_TOLERANCE`` where it is tilted or moved.
        seed: Same seed, same plan.
        max_attempts: Budget in attempts, for each attitude that an arm can choose from.
        rests: Tells whether an object stays where a task has it, as ``sim.manipulation.rests``;
            None takes geometry alone.
        attitude: As for ``plan_motion``.

    Raises:
        NoGraspFoundError: The budget ended.
        TaskError: No table, or what ``plan_motion`` refuses.
    """
    if task.table_height is None:
        raise TaskError("there is no table to pick from and to place on; give table_height")
    if max_attempts < 1:
        raise TaskError(f"max_attempts is {max_attempts}; give at least 1")
    direction, moved = checked_axis(axis), checked_shift(shift)
    check_place(place)
    if path_tolerance is None:
        turning = TILT_TOLERANCE if tilts(direction) else TURN_TOLERANCE
        path_tolerance = SHIFT_TOLERANCE if moved.any() else turning
    made: list[MotionAttempt] = []
    tried: list[tuple[str, ...]] = []
    for alone, turned, on_arm, reaches in carried_ways(task, attitude):
        asked = ObjectPath(axis=direction, angle=angle, shift=moved, attitude=turned)
        found: list[ManipulationPlan] = []
        fallen, stopped, budget = 0, False, len(made) + max_attempts
        for fallback in fallback_schedule(alone):
            attempts = fallback.attempts
            done = len(made) >= budget or (fallen >= FALLEN and not found)
            if done or good_enough(found) or (attempts is None and found):
                break
            tried.append(fallback.task.finger_names)
            path = _with_overshoot(asked, fallback.overshoot)
            most = budget if attempts is None else min(budget, len(made) + attempts)
            for attempt in motion_attempts(
                fallback.task,
                path,
                path_tolerance=path_tolerance,
                seed=seed,
                reaches=reaches,
            ):
                fell = fallen >= FALLEN and not found
                if len(made) >= most or good_enough(found) or fell:
                    break
                made.append(attempt)
                if attempt.plan is None:
                    failure = attempt.failure
                    fallen += failure is not None and failure.kind == FALLS
                    stopped |= failure is not None and failure.kind == OUT_OF_REACH
                    continue
                whole = pivots(attempt.plan) or whole_plan(
                    attempt.plan, on_arm, angle, place, shift=moved, rests=rests
                )
                if isinstance(whole, Failure):
                    made[-1], stopped = replace(attempt, plan=None, failure=whole), True
                    continue
                found.append(whole)
        if found:
            best = max(found, key=merit)
            record = replace(best.record, attempts=len(made), cpu_s=sum(a.cpu_s for a in made))
            return replace(best, record=record)
        if not stopped:  # the hand's own limits are the same in every attitude of the arm's choice
            break
    if fallen >= FALLEN:
        raise nothing_found(
            f"grasp of {task.object.name} by {task.hand.name} that holds it while the "
            "wrist turns: it falls in this attitude",
            made,
            "Try another attitude, a lighter object, more friction or other fingers",
        )
    sets = " or ".join(", ".join(names) for names in dict.fromkeys(tried))
    raise nothing_found(
        f"way to turn or move {task.object.name} by {asked} with {task.hand.name} ({sets})",
        made,
        "Try a smaller turn, a larger path tolerance, other fingers or more attempts",
    )


def whole_plan(
    motion: MovementPlan,
    on_arm: OnArm | None,
    angle: float,
    place: tuple[float, float] | None,
    *,
    shift: FloatArray | None = None,
    rests: Rests | None = None,
) -> ManipulationPlan | Failure:
    """A movement with its ending, made by the arm that the hand is on; or why there is none.

    Args:
        motion: Of one stroke or several, by the hand alone.
        on_arm: The arm; None where the base is free.
        angle: Requested turn, rad.
        place: As for ``plan_single_stroke``.
        shift: Requested translation in the hand (3,), m, world; none if None.
        rests: As for ``plan_single_stroke``.
    """
    carried = motion if on_arm is None else on_arm.carried(motion)
    if isinstance(carried, Failure):
        return carried
    ending = planned_ending(carried, angle, place, rests=rests)
    if isinstance(ending, Failure):
        return ending
    if ending.back and motion.cycles > 1:
        return Failure(kind="falls", text=ending.back)  # regrasps are not made backwards
    if on_arm is not None and (blocked := on_arm.blocked(carried, ending)):
        return blocked
    moved = np.zeros(3) if shift is None else shift
    return ManipulationPlan.of(carried, ending, angle=angle, shift=moved)


def good_enough(found: Sequence[ManipulationPlan]) -> bool:
    """Whether it is time to take the best of what was found."""
    return len(found) >= CANDIDATES or any(merit(p) >= 1.0 for p in found)


def merit(plan: ManipulationPlan) -> float:
    """How good a plan is (-), from 1 on good enough to be taken at once."""
    if plan.task.object.shape.ball_like:
        return plan.margin / GOOD_ON_BALLS
    good = min(plan.reserve / GOOD_RESERVE, plan.margin / GOOD_MARGIN)
    if not plan.path.turns_wrist:
        return good
    solved = [one for knot in plan.knots for one in (knot.forces, *knot.on_the_way)]
    return min(good, GOOD_PRESS / max(turning_press(plan), *map(pressed, solved)))


@made_once(CANDIDATES + 1)
def turning_press(motion: MovementPlan) -> float:
    """Largest normal force (N) of a stroke in its attitude against tips that pivot; inf if none do.

    A tip that pivots turns the object along. The others bear that torque by tangential forces, for
    which they press harder, and the tip presses harder against them.
    """
    task = motion.path.borne(replace(motion.task, table_height=None, obstacles=()))
    most = 0.0
    for knot, spin in zip(motion.knots, motion.spins, strict=True):
        now: Any = force_arguments(task, knot.contacts, motion.T_world_base, knot.q)
        limits = {key: now.pop(key) for key in ("actuation", "min_normal", "friction_scale")}
        step = ForceLoop(knot.contacts, **limits).step(now.pop("wrench"), spin=spin, **now)
        most = max(most, float(step.forces[:, 0].max()) if step.balanced else math.inf)
    return most


def _with_overshoot(asked: ObjectPath, overshoot: float) -> ObjectPath:
    """The path asked for with an overshoot (rad) of the turn, and the same share of translation."""
    angle = asked.angle
    if angle == 0.0:
        return asked
    turn = max(abs(angle), min(abs(angle) + overshoot, LARGEST_TURN))
    whole = math.copysign(turn, angle)
    return replace(asked, angle=whole, shift=whole / angle * asked.shift)


def pivots(motion: MovementPlan) -> Failure | None:
    """Which tip pivots too far on its contact when the object is tilted or moved, None for none.

    Torsional friction, which the controller does not model, would hold the object back.
    """
    if not (motion.path.shift.any() or tilts(motion.path.axis)):
        return None
    pivoted = motion.pivoted
    worst = int(np.argmax(pivoted))
    if pivoted[worst] <= MOST_PIVOT:
        return None
    degrees = float(np.rad2deg(pivoted[worst]))
    name = motion.grasp.task.finger_names[worst]
    return Failure(
        kind="pivots",
        text=f"{name} pivots on its contact by {degrees:.0f} degrees",
        numbers={"pivot_deg": degrees},
    )


NOMINAL = 12
"""Number of palm poses that are drawn to find the attitudes that an arm reaches."""

ARM_CLEARANCE = 5e-3
"""Distance (m) that an arm keeps from everything while it turns the wrist. With none planned a link
met the table with 3.4 N."""

HEADINGS = np.arange(4) * np.pi / 2
"""Turns (rad) about the vertical of the axis of a named attitude."""

POSTURES = 8
"""Postures of the arm at a grasp of which one is to bring the hand to its attitude."""

SHORT = 1e-4
"""How much less (rad) than half a turn an arm turns the palm up, so that it may go either way
around."""

SPARE = 0.02
"""How much farther (m) than planned the arm must reach at the target: the object lies in the hand
by some millimetres and degrees otherwise than planned, and the hand makes up for that."""


def carried_ways(
    task: GraspTask, attitude: AnyAttitude
) -> Iterator[tuple[GraspTask, FloatArray, OnArm | None, Reaches | None]]:
    """What to plan for in turn: one entry, or one for each attitude that an arm can choose from.

    Yields:
        The task of the hand alone, the attitude (3, 3), the arm, and what the arm reaches; None
        where the base is free.

    Raises:
        HandError: As ``OnArm``.
        TaskError: As ``OnArm.headed``.
    """
    asked = checked_attitude(attitude)
    if task.hand.arm is None:
        yield task, asked, None, None
        return
    on_arm = OnArm(task)
    for turned in on_arm.headed(asked, free=isinstance(attitude, str)):
        there = turned if rotation_angle(turned) > UNTURNED else None
        yield on_arm.alone, turned, on_arm, partial(on_arm.reaches, turned=there)


class OnArm:
    """The arm of one task.

    Attributes:
        alone: The task for the hand alone, whose base is free.
    """

    def __init__(self, task: GraspTask) -> None:
        """Take the hand off its arm.

        Raises:
            HandError: The hand was not loaded from a description of a hand on an arm.
        """
        mount = None if task.hand.path is None else read_mount(task.hand.path)
        if mount is None or task.T_world_base is None:
            raise HandError(
                f"{task.hand.name} is on an arm that no description tells of; load it from its "
                "hand.toml, which names the hand alone"
            )
        self._task, self._root = task, SE3(task.T_world_base)
        hand = load_hand(mount.hand_path)
        self._columns = [task.hand.joint_names.index(name) for name in hand.joint_names]
        if task.hand.rolls:
            hand = hand.rolling
        self.alone = replace(task, hand=hand, T_world_base=None)

    def reaches(self, T_world_base: SE3, q: FloatArray, turned: FloatArray | None = None) -> bool:
        """Whether the arm brings the palm there that the hand alone has at a base pose and q.

        With an attitude (3, 3) also along the way there, straight up and around the object, with
        its links clear wherever forces are verified.
        """
        return self._posture(T_world_base, q, turned) is not None

    def _posture(
        self, T_world_base: SE3, q: FloatArray, turned: FloatArray | None
    ) -> FloatArray | None:
        """All joints (nq,) with the arm where it does what ``reaches`` asks for; None if none do.

        An arm with a joint to spare has many postures for one pose of the palm; some are drawn.
        """
        wanted = self._root.inverse() * T_world_base * HandState(self.alone.hand, q).T_base_palm
        hand, whole = self._task.hand, np.array(self._first)
        whole[self._columns] = q
        found = reach(hand, wanted, whole)
        if not found.there:
            return None
        if turned is None or self._turns(found.q, turned):
            return found.q
        rng, index = np.random.default_rng(0), hand.arm_index
        for _ in range(POSTURES - 1):
            whole[index] = rng.uniform(hand.q_lower[index], hand.q_upper[index])
            found = follow(hand, wanted, whole)
            if found.there and self._turns(found.q, turned):
                return found.q
        return None

    def _turns(self, q: FloatArray, turned: FloatArray) -> bool:
        """Whether the arm goes from joints (nq,) to an attitude, with its links clear there."""
        now, path = q.copy(), ObjectPath.of_wrist(turned)
        center = self._task.T_world_object.translation
        up = np.array([0.0, 0.0, rise_for(self._task, self._root, [q], path)])
        turns = [path.wrist(share) for share in path.wrist_shares]
        stops = [SE3(turn, center - turn @ center + up) * self._root for turn in turns]
        ways = arm_way(self._task.hand, self._root, q, stops)
        for pose, way in zip(stops, ways, strict=False):  # ways end where there is none
            if way is None:
                return False
            now[self._task.hand.arm_index] = way[-1]
            held = pose * self._root.inverse() * self._task.T_world_object
            nearest = self._world.nearest_on_arm(self._root, now, T_world_object=held)
            if nearest.distance < ARM_CLEARANCE:
                return False
        return True

    def headed(self, attitude: FloatArray, *, free: bool) -> list[FloatArray]:
        """Attitudes that the arm reaches, that from most palm poses first.

        Args:
            attitude: Rotation (3, 3), world.
            free: Whether the horizontal axis of the turn may be another.

        Raises:
            TaskError: It reaches none.
        """
        if rotation_angle(attitude) <= UNTURNED:
            return [attitude]
        turns = [pin.exp3(np.array([0.0, 0.0, h])) for h in HEADINGS[: None if free else 1]]
        seeder, rng = turning_seeder_for(self.alone), np.random.default_rng(0)
        starts = [seeder.draw(rng) for _ in range(NOMINAL)]
        poses = [
            (self._task.T_world_object * start.T_object_base, start.q)
            for start in starts
            if isinstance(start, Start)
        ]
        able = [pose for pose in poses if self.reaches(*pose)]
        about = pin.log3(attitude)
        if free:
            about *= min(1.0, (np.pi - SHORT) / float(np.linalg.norm(about)))
        found = [pin.exp3(turn @ about) for turn in turns]
        reached = [sum(self.reaches(*pose, turned) for pose in able) for turned in found]
        if not any(reached):
            raise TaskError(
                f"{self._task.hand.name} does not reach the attitude: of {len(able)} palm poses "
                "over the object that it reaches it turns none there, lifted clear of the table; "
                "give another attitude, or T_world_base, the pose of the arm's root"
            )
        best_first = np.argsort(-np.array(reached), kind="stable").tolist()
        return [found[k] for k in best_first if reached[k]]

    def carried(self, motion: MovementPlan) -> MovementPlan | Failure:
        """A motion of the hand alone with the arm below it, judged again; or why it fails."""
        alone = motion.grasp.task
        turned = motion.path.attitude if motion.path.turns_wrist else None
        arm = self._posture(motion.T_world_base, motion.grasp.q, turned)
        if arm is None:
            return Failure(
                kind=OUT_OF_REACH,
                text="the arm cannot bring the palm to where the motion is and turn it there",
            )
        hand = self._task.hand.rolling if alone.hand.rolls else self._task.hand
        task = replace(alone, hand=hand, T_world_base=self._root)
        postures = np.tile(arm, (len(motion.knots), 1))
        postures[:, self._columns] = [knot.q for knot in motion.knots]
        verifier = MovementVerifier(task)
        grasp = verify_grasp(
            task,
            self._root,
            postures[0],
            record=SolveRecord(
                iterations=motion.record.iterations, status="motion", objective="motion"
            ),
        )
        if isinstance(grasp, Failure):
            return grasp.at("start, with the arm")
        waypoints = [
            Waypoint(
                path_parameter=knot.path_parameter,
                T_object_base=knot.T_world_object.inverse() * self._root,
                q=q,
            )
            for knot, q in zip(motion.knots, postures, strict=True)
        ]
        knots = verifier.verify_knots(self._root, waypoints, motion.path, motion.path_tolerance)
        if isinstance(knots, Failure):
            return knots.at("with the arm")
        stroke = replace(motion.with_knots(knots), grasp=grasp)
        height = max(LIFT_HEIGHT, stroke.rise)
        if stroke.path.turns_wrist and (stuck := lifted_blocked(stroke, height)):
            return stuck
        repeated = verifier.repeated(stroke, motion.cycles)
        return repeated.at("with the arm") if isinstance(repeated, Failure) else repeated

    def blocked(self, motion: MovementPlan, ending: Ending) -> Failure | None:
        """Why the arm cannot carry the object to where it is put down; None if it can."""
        end = motion.knots[0 if ending.back else -1]
        there = motion.grasp.task if ending.back else standing(motion)
        if isinstance(there, Failure):
            return there
        world, hand, now = CollisionWorld(there), there.hand, np.array(end.q)
        lift = max(LIFT_HEIGHT, motion.rise)
        # back from the attitude the arm is in another posture than it was lifted in
        if motion.path.turns_wrist and (stuck := lifted_blocked(motion, lift, (), ending)):
            return stuck
        to = ending.T_world_target.translation - end.T_world_object.translation
        up = np.array([0.0, 0.0, lift])
        assert ending.release is not None  # it ends on the table
        out = way_back(hand, self._root, ending.release)
        away = ending.T_world_target.translation - self._root.translation
        away[2] = 0.0
        for what, shift in (
            ("lift the object after the turn", up),
            ("carry the object to where it is put down", np.array([to[0], to[1], 0.0])),
            ("lower the object", -up),
            ("reach further than planned", SPARE * away / max(float(np.linalg.norm(away)), 1e-9)),
            ("leave the object", out),
        ):
            path = straight_path(hand, now, self._root.rotation.T @ shift)
            if path is None:
                text = f"the arm cannot {what} within its limits"
                return Failure(kind="arm_unreachable", text=text)
            if shift is not out and (
                touched := verify_arm_path(world, self._root, end.q, path, clearance=0.0, held=True)
            ):
                return touched.at(what)
            now[hand.arm_index] = path[-1]
        return None

    @cached_property
    def _world(self) -> CollisionWorld:
        return CollisionWorld(self._task)

    @cached_property
    def _first(self) -> FloatArray:
        """Joints (nq,) with the arm ready."""
        q = np.array(self._task.hand.neutral)
        arm = self._task.hand.arm
        assert arm is not None
        q[arm.index] = arm.ready
        return q


def arm_way(
    hand: Hand, root: SE3, q: FloatArray, poses: Sequence[SE3]
) -> Iterator[FloatArray | None]:
    """Arm postures (m, n) on a hand's way to each pose in turn; None, last, where there are none.

    Args:
        hand: On an arm.
        root: Pose of the arm's root.
        q: Joints (nq,) where the way begins.
        poses: Of a base that moves with the palm, and that is at the root where the way begins.
    """
    T_root_palm = palm_pose(hand, q)
    return palm_paths(hand, q, [root.inverse() * pose * T_root_palm for pose in poses])


def lifted_blocked(
    motion: MovementPlan,
    height: float,
    via: Sequence[tuple[float, float]] = (),
    ending: Ending | None = None,
) -> Failure | None:
    """Why an arm cannot turn a lifted hand to its attitude and carry it on; None if it can.

    Args:
        motion: Of a hand on an arm.
        height: How far hand and object are lifted, m.
        via: Places of the object, x and y in m, world, one after the other.
        ending: What follows at the last of them, up to above where the object is put down; nothing
            if None.
    """
    task, q, root = motion.task, motion.grasp.q, motion.grasp.T_world_base
    world = CollisionWorld(task)
    shares, there = motion.path.wrist_shares, np.array([0.0, 0.0, height])
    way = [("lift the object", 0.0, there)]
    for share in shares[1:]:
        ends = f"it ends {100 * share:.0f} % of the way there"
        way.append((f"turn the hand to the attitude: {ends}", share, there))
    held = " in the attitude" if motion.path.turns_wrist else ""
    for place in via:
        there = np.array([*place, height])
        there[:2] -= task.T_world_object.translation[:2]
        way.append((f"carry the object to {place}{held}", 1.0, there))
    if ending is not None:
        way += [("turn the hand back where it was carried", s, there) for s in shares[-2::-1]]
        end = motion.knots[0 if ending.back else -1].T_world_object.translation
        there = ending.T_world_target.translation - end + np.array([0.0, 0.0, height])
        way.append(("carry the object to where it is put down", 0.0, there))
    poses = [shifted(motion.turned_base(share), shift) for _, share, shift in way]
    paths = arm_way(task.hand, root, q, poses)
    for (what, _, _), path in zip(way, paths, strict=False):  # paths end where there is none
        if path is None:
            return Failure(kind="arm_unreachable", text=f"the arm cannot {what}")
        clearance = ARM_CLEARANCE if what.startswith("turn") else 0.0
        touched = verify_arm_path(world, root, q, path, clearance=clearance, held=True)
        if touched:
            return touched.at(what.partition(":")[0])
    return None
