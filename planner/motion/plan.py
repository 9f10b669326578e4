"""``MovementPlan``: how an object moves in the hand, as a sequence of phases on one base pose.

    grasp -> stroke -> [a relocation of every finger -> stroke] x (cycles - 1)
                    -> [the use of a tool, or another hand takes it] -> ending

A phase (``planner.motion.phase``) is a ``Stroke``: the object goes along its path, all contacts
stay and roll; a ``Relocation``: one contact moves, the others stay and hold the object still; a
``ToolUse`` or a ``Handover``, before which the object stays in the fingers. A motion is one stroke
(``plan_motion``), a gait several (``plan_gait``), a manipulation has an ``Ending`` as well
(``plan_manipulation``, ``plan_handover``, ``sim.plan_tool``). The knots of all are judged by one
verifier (``planner.motion.verify``); all are run by one machine (``sim.manipulation.machine``) and
kept in one kind of file (``planner.files.movements``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import pinocchio as pin

from planner.collision.arm_path import LIFT_HEIGHT
from planner.collision.pregrasp import way_back
from planner.errors import TaskError
from planner.immutable import freeze
from planner.kinematics import HandState
from planner.motion.path import ObjectPath
from planner.motion.phase import Ending, Handover, Knot, Phase, Relocation, Stroke, ToolUse
from planner.motion.trajectory import JOINT_RATE, TURN_RATE, TrajectoryBuilder
from planner.plan import GraspPlan, JointTrajectory, SearchRecord
from planner.showing import Shown, in_notebook
from planner.spatial import SE3, FloatArray, shifted
from planner.synthesis.objectives import driving
from planner.task import GraspTask, Obstacle

if TYPE_CHECKING:
    from planner.tools import Tool

LIFT_S, CARRY_S, LOWER_S, OPEN_S, RETREAT_S = 0.7, 0.8, 0.6, 0.4, 0.6
"""Durations (s) of the pieces of a trajectory in which the base moves or the fingers open."""

WRIST_RATE = 1.0
"""Mean rate (rad/s) at which the wrist turns to the attitude and back, and in the use of a tool."""

USE_SPEED = 0.1
"""Mean speed (m/s) of the base on the way of a use, in a trajectory."""

TORSION = 5e-3
"""Torsional friction (m) of pads that pivot, that of trials (``sim.scene.physics``). It helps to
hold an object, which plans do without, and it turns one along."""

PIVOTING = math.radians(0.5)
"""Turn (rad) of a tip about its contact's normal from knot to knot, over some 8 degrees of the
object, from which on all of it acts."""

SMALLEST_RANGE = 1e-3
"""Least range (rad or m) of a joint by which distances are divided."""

NO_LIMIT = 1e-9
"""Least limit (N m, N) that divides a force."""

HALVES = slice(0, 3), slice(3, 6)
"""Translation and rotation in a motion vector."""

SAME_PLACE = 1e-6
"""Distance (m) below which two places are the same."""


CLEAR = 0.03
"""How far (m) hand and object stay above table and obstacles while the wrist turns."""


@dataclass(frozen=True, kw_only=True)
class Limit:
    """One limit of a path's length.

    Attributes:
        what: In words: a joint and its end, or a term and the finger it concerns.
        finger: Name of the finger, "" for none.
        joint: Name of the joint, "" for none.
        path_parameter: Where on the path, 0 to 1.
        gain: Growth of the path, as a share of the requested one, when the limit gives way by one
            ``unit``.
        unit: A millimetre, a degree, a hundredth of a number.
    """

    what: str
    finger: str
    joint: str
    path_parameter: float
    gain: float
    unit: str

    def __str__(self) -> str:
        """One line."""
        return f"{self.what}, at {100 * self.path_parameter:.0f} % of the path"


@dataclass(frozen=True, kw_only=True)
class MotionRecord(SearchRecord):
    """Where a movement comes from.

    Attributes:
        iterations: Evaluations of the residuals in its attempt.
        worst: Largest weighted residual of a term in the verified candidate.
    """

    iterations: int
    worst: float


@dataclass(frozen=True, kw_only=True, eq=False)
class MovementPlan(Shown):
    """A movement of the object in the hand; every knot and every lift passed the checks of a grasp.

    All poses are relative to the grasp on the table: execution lifts hand and object first, both by
    the same translation, which the plan leaves out.

    Attributes:
        grasp: The grasp with which it begins, with its approach, where the object is.
        path: The path of one stroke; shorter than requested if that was too long.
        phases: In their order, beginning with a stroke.
        path_tolerance: Largest distance of the object from the path, m.
        limits: What kept the path from being longer, if the longest path was requested.
        record: Where the plan comes from.
        angle: Requested turn, rad, with its sign; the strokes may go further.
        shift: Requested translation in the hand (3,), m, world.
        ending: How the object is put down or held; None where that is not planned.
        then: The movement that begins where this one has put the object down; None for none.
        tool: The tool that is used, as it is; fingers that turn it may be planned for a cylinder.
            None where none is used.
    """

    grasp: GraspPlan
    path: ObjectPath
    phases: tuple[Phase, ...]
    path_tolerance: float
    limits: tuple[Limit, ...]
    record: MotionRecord
    angle: float
    shift: FloatArray = field(default_factory=lambda: np.zeros(3))
    ending: Ending | None = None
    then: ManipulationPlan | None = None
    tool: Tool | None = None

    def __post_init__(self) -> None:
        """Keep copies that nobody changes."""
        freeze(self, arrays=("shift",))

    @classmethod
    def of_stroke(
        cls,
        grasp: GraspPlan,
        path: ObjectPath,
        knots: Sequence[Knot],
        *,
        path_tolerance: float,
        record: MotionRecord,
        limits: tuple[Limit, ...] = (),
    ) -> MovementPlan:
        """A movement of one stroke, all of which is requested; see the attributes."""
        return MovementPlan(
            grasp=grasp,
            path=path,
            phases=(Stroke(cycle=0, knots=tuple(knots)),),
            path_tolerance=path_tolerance,
            limits=limits,
            record=record,
            angle=path.angle,
            shift=path.shift,
        )

    def with_knots(self, knots: Sequence[Knot], path: ObjectPath | None = None) -> MovementPlan:
        """The first stroke alone with other knots, and with another path if one is given."""
        return self.of_stroke(
            self.grasp,
            path or self.path,
            knots,
            path_tolerance=self.path_tolerance,
            record=self.record,
            limits=self.limits,
        )

    @property
    def motion(self) -> MovementPlan:
        """The first stroke alone."""
        return self.with_knots(self.knots)

    @property
    def task(self) -> GraspTask:
        """The task, with the chosen fingers."""
        return self.grasp.task

    @property
    def T_world_base(self) -> SE3:
        """Pose of the hand's base throughout."""
        return self.grasp.T_world_base

    @cached_property
    def strokes(self) -> tuple[Stroke, ...]:
        """The strokes, in order."""
        return tuple(p for p in self.phases if isinstance(p, Stroke))

    @cached_property
    def relocations(self) -> tuple[Relocation, ...]:
        """The relocations, in order."""
        return tuple(p for p in self.phases if isinstance(p, Relocation))

    @cached_property
    def held_phase(self) -> ToolUse | Handover | None:
        """What is done while the object stays in the fingers; None where it moves in them."""
        return next((p for p in self.phases if isinstance(p, ToolUse | Handover)), None)

    @property
    def tool_use(self) -> ToolUse | None:
        """The use of a tool by the hand as a whole; None without one."""
        return self.held_phase if isinstance(self.held_phase, ToolUse) else None

    @property
    def handover(self) -> Handover | None:
        """How another hand takes the object; None where none does."""
        return self.held_phase if isinstance(self.held_phase, Handover) else None

    @property
    def regrasps(self) -> tuple[Relocation, ...]:
        """The relocations after the first stroke, which every cycle repeats; () of one stroke."""
        return tuple(r for r in self.relocations if r.cycle == 0)

    @property
    def order(self) -> tuple[str, ...]:
        """Names of the fingers in the order in which they move on."""
        return tuple(r.finger for r in self.regrasps)

    @property
    def cycles(self) -> int:
        """Number of strokes."""
        return len(self.strokes)

    @property
    def knots(self) -> tuple[Knot, ...]:
        """The knots of the first stroke, in order; the first is the grasp."""
        return self.strokes[0].knots

    @property
    def planned_angle(self) -> float:
        """Turn of all strokes together, rad; ``angle`` or beyond."""
        return self.cycles * self.path.angle

    @property
    def planned_shift(self) -> FloatArray:
        """Translation of all strokes together (3,), m, world."""
        return self.cycles * self.path.shift

    @property
    def margin(self) -> float:
        """Least normalised min-weight of closure (-) over the knots of a stroke and all lifts."""
        return min([self.strokes[0].margin, *(r.margin for r in self.relocations)])

    @property
    def clearance(self) -> float:
        """Smallest distance of geometries that must not touch, m, over the knots of a stroke."""
        return min(k.clearance for k in self.knots)

    @cached_property
    def reserve(self) -> float:
        """Least share of its limit that an actuator of the fingers keeps, over all knots.

        The forces are those that bear the weight, also while the wrist turns.
        """
        task = self.task
        actuation, used = task.hand.actuation, driving(task.hand, task.fingers)
        left = 1.0
        for knot in self.knots:
            low, high = actuation.force_limits(knot.q)[used].T
            for forces in (knot.forces, *knot.on_the_way):
                force = forces.actuator_forces[used]
                limit = np.where(force > 0, high, -low)
                left = min(left, float((1.0 - np.abs(force) / np.maximum(limit, NO_LIMIT)).min()))
        return left

    @cached_property
    def rise(self) -> float:
        """How far (m) above the grasp the hand is before its wrist turns; see ``rise_for``."""
        ends = (self.knots[0].q, self.knots[-1].q)
        return rise_for(self.task, self.T_world_base, ends, self.path)

    def turned_base(self, share: float) -> SE3:
        """Pose of the base, not lifted, at a share of the wrist's way to the attitude."""
        center, turn = self.task.T_world_object.translation, self.path.wrist(share)
        return SE3(turn, center - turn @ center) * self.T_world_base

    @property
    def joint_room(self) -> tuple[str, float, float]:
        """The finger joint nearest to a limit, how near (share of its range), and where."""
        hand = self.task.hand
        index = np.concatenate([f.q_index for f in self.task.fingers])
        lower, upper = hand.q_lower[index], hand.q_upper[index]
        q = np.array([k.q[index] for k in self.knots])
        room = np.minimum(q - lower, upper - q) / np.maximum(upper - lower, SMALLEST_RANGE)
        k, j = np.unravel_index(int(np.argmin(room)), room.shape)
        return hand.joint_names[index[j]], float(room[k, j]), self.knots[k].path_parameter

    @property
    def slipped(self) -> FloatArray:
        """Slip (n,), m, of each pad over a stroke: 0 if it only rolls."""
        return np.asarray(np.sum([k.slips for k in self.knots], axis=0))

    @cached_property
    def pivots(self) -> FloatArray:
        """Rotation (n_knots - 1, n), rad, of each tip on the object about its contact's normal.

        From knot to knot of a stroke; positive about the normal into the object.
        """
        task, out = self.task, []
        for a, b in pairwise(self.knots):
            before, after = (
                (k.T_world_object.inverse() * self.T_world_base, HandState(task.hand, k.q))
                for k in (a, b)
            )
            normals = a.contacts_in_object.normals + b.contacts_in_object.normals
            for finger, normal in zip(task.fingers, normals, strict=True):
                old, new = (
                    base.rotation @ state.joint_pose(finger.pad.joint_id).rotation
                    for base, state in (before, after)
                )
                out.append(pin.log3(new @ old.T) @ normal / np.linalg.norm(normal))
        return np.reshape(out, (-1, len(task.fingers)))

    @property
    def pivoted(self) -> FloatArray:
        """Rotation (n,), rad, of each tip about its contact's normal over a stroke."""
        return np.asarray(np.abs(self.pivots).sum(axis=0))

    @cached_property
    def spins(self) -> FloatArray:
        """Torque (n_knots, n) of pivoting tips about their normals per normal force, m.

        With the palm down it is 0: those turns were measured without.
        """
        if not self.path.turns_wrist:
            return np.zeros((len(self.knots), len(self.task.fingers)))
        turns = np.pad(self.pivots, ((1, 1), (0, 0)), mode="edge")
        return TORSION * np.clip((turns[:-1] + turns[1:]) / (2.0 * PIVOTING), -1.0, 1.0)

    def at(self, path_parameter: float) -> tuple[SE3, FloatArray]:
        """Pose of the object and joints (nq,) in the first stroke at a path parameter, 0 to 1.

        Between knots the object is interpolated along its screw, the joints linearly.
        """
        at = np.array([k.path_parameter for k in self.knots])
        i = int(np.clip(np.searchsorted(at, path_parameter, side="right") - 1, 0, len(at) - 2))
        part = float(np.clip((path_parameter - at[i]) / (at[i + 1] - at[i]), 0.0, 1.0))
        a, b = self.knots[i], self.knots[i + 1]
        return SE3.Interpolate(a.T_world_object, b.T_world_object, part), a.q + part * (b.q - a.q)

    @property
    def final_parameter(self) -> float:
        """Path parameter in (0, 1] at which the last stroke has turned the object by ``angle``."""
        if not self.angle or self.ending is None:
            return 1.0
        return min(1.0, self.angle / self.path.angle - (self.cycles - 1))

    def turned_object(self) -> tuple[SE3, FloatArray]:
        """Planned pose of the object and joints (nq,) when it has turned by ``angle``.

        Hand and object are at the grasp, not lifted.
        """
        now, q = self.at(self.final_parameter)
        if self.cycles == 1:
            return now, q
        begin, first = self.strokes[-1].knots[0].T_world_object, self.knots[0].T_world_object
        turned = now.rotation @ first.rotation.T @ begin.rotation
        return SE3(turned, begin.translation + now.translation - first.translation), q

    def joint_trajectory(
        self,
        *,
        approach_s: float = 1.5,
        close_s: float = 1.0,
        lift_m: float = 0.08,
        joint_rate: float = JOINT_RATE,
        turn_rate: float = TURN_RATE,
        rate_hz: float = 50.0,
    ) -> JointTrajectory:
        """Joint positions by name and poses of the base, for a real hand on any carrier.

        Phases are approach, close, and turn, or "stroke 1", "regrasp FINGER", "stroke 2" and so on.
        With an ending lift comes before the turn, and after it back where the plan has one, carry,
        lower, open and retreat; in another attitude also wrist before the turn, and "wrist back"
        before the carry; the turn ends at ``angle`` then, short of the planned overshoot. Of a tool
        the use follows the closing: the way that was verified, at an even speed, or the strokes
        of the fingers, after which it stays in its fixture. Of a handover lift, reach, take, open
        and retreat do, as high as it is planned.
        Contact forces are not part of it. Joints pass through the knots without overshoot.

        Args:
            approach_s: As for ``GraspPlan.joint_trajectory``.
            close_s: As there.
            lift_m: How far the hand is lifted, m; only with an ending.
            joint_rate: Largest rate of a joint after the closing, rad/s or m/s.
            turn_rate: Largest rate of the object's turn, rad/s.
            rate_hz: Samples per second.

        Raises:
            TaskError: A duration or a rate that is not positive.
        """
        builder = TrajectoryBuilder(
            self.grasp,
            approach_s=approach_s,
            close_s=close_s,
            joint_rate=joint_rate,
            turn_rate=turn_rate,
            rate_hz=rate_hz,
        )
        if self.tool_use is not None:
            self._use(builder, self.tool_use)
            return builder.built()
        if self.handover is not None:
            self._hand_over(builder, self.handover)
            return builder.built()
        if self.ending is None or self.tool is not None:  # a tool stays in its fixture
            self._move(builder)
            return builder.built()
        base, up = self.T_world_base, np.array([0.0, 0.0, max(lift_m, self.rise)])
        builder.move_base("lift", shifted(base, up), LIFT_S * self._stretch(lift_m))
        turned = [shifted(self.turned_base(share), up) for share in self.path.wrist_shares]
        wrist_s = float(np.linalg.norm(self.path.wrist_turn)) / WRIST_RATE
        if self.path.turns_wrist:
            builder.move_along("wrist", turned[1:], wrist_s)
        T_world_object, q = self._move(builder)
        if self.path.turns_wrist and not self.ending.turned:
            builder.move_along("wrist back", turned[-2::-1], wrist_s)
        to_target = self.ending.T_world_target * T_world_object.inverse() * base
        builder.move_base("carry", shifted(to_target, up), CARRY_S)
        if self.ending.release is None:
            return builder.built()
        builder.move_base("lower", to_target, LOWER_S * self._stretch(lift_m))
        builder.turn("open", np.array([q, self.ending.release.q]), np.array([0.0, 1.0]), OPEN_S)
        builder.move_base("retreat", self.way_out(to_target), RETREAT_S)
        return builder.built()

    def _stretch(self, lift_m: float) -> float:
        """How many times as long lift and lowering take: as many as the hand is lifted further."""
        return max(1.0, self.rise / lift_m)

    def _move(self, builder: TrajectoryBuilder) -> tuple[SE3, FloatArray]:
        """Append all phases, and the way back; object, before any lift, and joints at the end."""
        end = self.final_parameter
        for phase in self.phases:
            if isinstance(phase, Relocation):
                shares = np.linspace(0.0, 1.0, len(phase.postures))
                builder.turn(f"regrasp {phase.finger}", phase.postures, shares)
            if not isinstance(phase, Stroke):
                continue
            until = end if phase.cycle == self.cycles - 1 else 1.0
            parameters, postures = self._postures(until)
            name = "turn" if self.cycles == 1 else f"stroke {phase.cycle + 1}"
            builder.turn(name, postures, parameters, until * self.path.angle)
        if self.ending is None or not self.ending.back:
            return self.turned_object()
        parameters, postures = self._postures(end)
        builder.turn("back", postures[::-1], end - parameters[::-1], end * self.path.angle)
        return self.knots[0].T_world_object, self.knots[0].q

    def _use(self, builder: TrajectoryBuilder, use: ToolUse) -> None:
        """Append the way of a use, and back where a finger works."""
        if use.finger:
            shares = np.linspace(0.0, 1.0, len(use.postures))
            builder.turn("use", use.postures, shares)
            builder.turn("withdraw", use.postures[::-1], shares)
            return
        steps = [pin.log6(a.inverse() * b).vector for a, b in pairwise(use.way)]
        far, turned = (sum(float(np.linalg.norm(s[part])) for s in steps) for part in HALVES)
        builder.move_along("use", use.way[1:], max(far / USE_SPEED, turned / WRIST_RATE))

    def _hand_over(self, builder: TrajectoryBuilder, given: Handover) -> None:
        """Append the lift, the ways of both hands, and how they close and open."""
        up = np.array([0.0, 0.0, given.lift_height])
        builder.move_base("lift", shifted(self.T_world_base, up), LIFT_S)
        taken = np.array([given.way_in[-1], given.both.q])
        left = np.array([given.both.q, given.way_out[0]])
        for name, way in (
            ("reach", given.way_in),
            ("take", taken),
            ("open", left),
            ("retreat", given.way_out),
        ):
            builder.turn(name, way, np.linspace(0.0, 1.0, len(way)))

    def _postures(self, until: float) -> tuple[FloatArray, FloatArray]:
        """Path parameters (m,) of a stroke up to one of them, and joints (m, nq) there."""
        before = [k.path_parameter for k in self.knots if k.path_parameter < until]
        parameters = np.array([*before, until])
        return parameters, np.array([self.at(s)[1] for s in parameters])

    def way_out(self, T_world_base: SE3, ending: Ending | None = None) -> SE3:
        """Pose of the base at the end of the straight way out.

        Args:
            T_world_base: Pose of the base when the fingers have opened.
            ending: How the object is put down; the plan's if None.

        Raises:
            TaskError: The plan has no ending, and none is given.
        """
        chosen = ending or self.ending
        if chosen is None or chosen.release is None:
            raise TaskError(
                "the plan has no ending that lets go; give one, or plan it by manipulation_of"
            )
        planned = self.T_world_base
        way = way_back(self.task.hand, planned, chosen.release)
        return shifted(T_world_base, T_world_base.rotation @ planned.rotation.T @ way)

    def __repr__(self) -> str:
        """One line."""
        strokes = f"{self.cycles} x " if self.cycles > 1 else ""
        return f"<{type(self).__name__} of {self.task!r}: {strokes}{self.path}>"

    def _repr_html_(self) -> str:
        """What a notebook shows of it: a table and a picture, made once."""
        return in_notebook(self)

    def __str__(self) -> str:
        """The path, the margins, the limits, and how the object is put down."""
        joint, room, where = self.joint_room
        task, cycles = self.task, self.cycles
        strokes = f"{cycles} strokes of " if cycles > 1 else ""
        item = task.object.shape.spec if self.tool is None else self.tool.name
        lines = [
            f"{task.hand.name} ({', '.join(task.finger_names)}), {item}: {strokes}{self.path}",
            f"  {len(self.knots)} knots, off the path by up to "
            f"{1e3 * max(k.off_path for k in self.knots):.1f} mm "
            f"(tolerance {1e3 * self.path_tolerance:.1f})",
            f"  closure: least normalised min-weight {self.strokes[0].margin:.3f}",
            f"  clearance: least {1e3 * self.clearance:.2f} mm",
            f"  joints: {joint} comes within {100 * room:.1f} % of its range of an end, at "
            f"{100 * where:.0f} % of the path",
            "  pads slide by "
            + ", ".join(
                f"{name} {1e3 * s:.2f}"
                for name, s in zip(task.finger_names, self.slipped, strict=True)
            )
            + " mm in all",
        ]
        lines += [f"  after each stroke, {r}" for r in self.regrasps]
        lines += [f"  {self.held_phase}"] if self.held_phase is not None else []
        if self.limits:
            lines.append("  longer if these gave way:")
            lines += [f"    {limit}" for limit in self.limits]
        return "\n".join(lines)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ManipulationPlan(MovementPlan):
    """Pick, turn or move in the hand, place: a movement with an ending.

    Attributes:
        ending: Final pose of the object, and how the hand lets go of it.
    """

    ending: Ending = field()  # required, though any movement may have one

    @classmethod
    def of(
        cls, movement: MovementPlan, ending: Ending, *, angle: float, shift: FloatArray
    ) -> ManipulationPlan:
        """A movement with an ending.

        Args:
            movement: The movement.
            ending: How the object is put down.
            angle: Requested turn, rad; the movement may go further.
            shift: Requested translation in the hand (3,), m, world.
        """
        return cls(
            grasp=movement.grasp,
            path=movement.path,
            phases=movement.phases,
            path_tolerance=movement.path_tolerance,
            limits=movement.limits,
            record=movement.record,
            angle=angle,
            shift=shift,
            ending=ending,
            tool=movement.tool,
        )

    @classmethod
    def of_held(
        cls,
        grasp: GraspPlan,
        knots: Sequence[Knot],
        phase: ToolUse | Handover,
        *,
        tool: Tool | None = None,
    ) -> ManipulationPlan:
        """The use of a tool or a handover: the object stays in the fingers, and is held at last.

        Args:
            grasp: The grasp with which it begins.
            knots: Of the object as it is held.
            phase: What is done with it.
            tool: The tool of a use.
        """
        made = grasp.record
        return cls(
            grasp=grasp,
            path=ObjectPath.of_wrist(np.eye(3)),
            phases=(Stroke(cycle=0, knots=tuple(knots)), phase),
            path_tolerance=0.0,
            limits=(),
            record=MotionRecord(
                iterations=made.iterations,
                worst=0.0,
                **{f.name: getattr(made, f.name) for f in fields(SearchRecord)},
            ),
            angle=0.0,
            ending=Ending(
                T_world_target=grasp.task.T_world_object, release=None, back="", turned=True
            ),
            tool=tool,
        )

    @property
    def chain(self) -> tuple[ManipulationPlan, ...]:
        """This plan and those that follow on it, in order."""
        return (self, *(() if self.then is None else self.then.chain))

    @property
    def attempts(self) -> int:
        """Attempts made."""
        return self.record.attempts

    @property
    def cpu_s(self) -> float:
        """CPU time of planning without building, s."""
        return self.record.cpu_s

    @property
    def under_target(self) -> tuple[Obstacle, ...]:
        """Obstacles that carry the object at another target above the table, as at its start."""
        return standing_under(self.task, self.ending.T_world_target)

    def __repr__(self) -> str:
        """One line."""
        one = self.held_phase
        what = f"{np.rad2deg(self.angle):.1f} degrees" if one is None else str(one)
        return f"<ManipulationPlan of {self.task!r}: {what}>"

    def __str__(self) -> str:
        """The movement and the ending."""
        target = ", ".join(f"{v:.3f}" for v in self.ending.T_world_target.translation)
        shift = ", ".join(f"{v:.1f}" for v in 1e3 * self.shift + 0.0)
        requested = f"requested: {np.rad2deg(self.angle):.1f} degrees, ({shift}) mm; put down"
        if self.ending.turned:
            rpy = (
                np.rint(np.rad2deg(pin.rpy.matrixToRpy(self.ending.T_world_target.rotation))) + 0.0
            )
            told = ", ".join(f"{v:g}" for v in rpy)
            held = "held" if self.ending.release is None else "set down"
            requested = f"to roll, pitch, yaw ({told}) degrees, {held}"
        if self.tool is not None:
            requested = f"requested: {np.rad2deg(self.angle):.1f} degrees, in its fixture"
        if self.ending.release is None:  # as high as it is lifted
            target = ", ".join(f"{v:.3f}" for v in self.ending.T_world_target.translation[:2])
        lines = [
            super().__str__(),
            *([f"  {requested} at ({target}) m"] if self.held_phase is None else []),
            f"  the most loaded actuator keeps {100 * self.reserve:.0f} % of its limit",
        ]
        if self.ending.back:
            lines.append(f"  made backwards before it is put down: {self.ending.back}")
        return "\n".join(
            [
                *lines,
                *([] if self.then is None else ["then, from where it stands:", str(self.then)]),
            ]
        )


MotionPlan: TypeAlias = MovementPlan
"""A movement of one stroke, as ``plan_motion`` gives it."""

GaitPlan: TypeAlias = MovementPlan
"""A movement of several strokes, as ``plan_gait`` gives it."""


def rise_for(
    task: GraspTask, T_world_base: SE3, postures: Sequence[FloatArray], path: ObjectPath
) -> float:
    """How far (m) above a grasp a hand is before its wrist turns, 0 without an attitude.

    Hand and object turn about the object's centre there, ``CLEAR`` of table and obstacles; at the
    grasp if there is neither. A hand on an arm is above it by ``LIFT_HEIGHT`` at least, from where
    on the arm's links are checked; the last two are clear like the hand, below which they are with
    the palm up.

    Args:
        task: Where the object is, and the hand.
        T_world_base: Pose of the base at the grasp.
        postures: Joints (nq,) of the hand meanwhile.
        path: Tells the attitude.
    """
    if not path.turns_wrist:
        return 0.0
    hand, arm = task.hand, task.hand.arm
    center = task.T_world_object.translation
    corners = [task.object.shape.bounding_radius * np.vstack([np.eye(3), -np.eye(3)])]
    near = 0 if arm is None else int(arm.chain[-2:][0]) + 1
    for q in postures:
        state = HandState(hand, q)
        for one in hand.geometries:
            if arm is None or one.name not in arm.geometries or one.joint_id >= near:
                pose = T_world_base * state.joint_pose(one.joint_id) * one.T_joint_geometry
                corners.append(one.corners @ pose.rotation.T + pose.translation - center)
    turns = np.array([path.wrist(share) for share in path.wrist_shares])
    lowest = float((np.vstack(corners) @ turns[:, 2].T).min())
    tops = [-np.inf if task.table_height is None else task.table_height]
    for o in task.obstacles:
        half = np.abs(o.T_world_obstacle.rotation[2]) @ o.size / 2
        tops.append(float(o.T_world_obstacle.translation[2] + half))
    least = 0.0 if arm is None else LIFT_HEIGHT
    return max(least, max(tops) + CLEAR - lowest - float(center[2]))


def standing_under(task: GraspTask, target: SE3) -> tuple[Obstacle, ...]:
    """Copies at the target of the obstacles that carry the object, if that is another place."""
    gone = target.translation - task.T_world_object.translation
    if np.linalg.norm(gone[:2]) < SAME_PLACE:
        return ()
    by = np.array([*gone[:2], 0.0])
    return tuple(replace(o.moved(by), name=f"{o.name} at the target") for o in task.carrying)
