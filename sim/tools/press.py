"""``press``: one finger presses a lever, again and again, while the others hold the tool.

The lever hangs on a hinge at the tool's head and moves with the tool: a box that a spring holds off
the body, with dry friction. The free body is tool and lever in one; the force with which the finger
presses is the only one from outside beside weight and contacts, so the others must balance it. It
is the tool's needed wrench: minus the finger's force, at the lever's end.

The grasp leaves the pressing finger out. Grasps are searched of the body alone, which is round:
turned about its axis, so that the lever is where the finger can press it, one is as good as before,
and is verified again, with the lever standing in the way. The finger's way goes from where it is
idle to before the lever, and on along the arc of its end. It is executed by position, with the
joint torques of the planned force.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar

import mujoco
import numpy as np
import pinocchio as pin

from planner.collision.pad_contact import contact_geometries, pad_contact_queries
from planner.collision.world import CollisionWorld
from planner.errors import ObjectError, TaskError
from planner.failure import Failure
from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.kinematics import MovingHand
from planner.motion.phase import ToolUse
from planner.motion.regrasp import LOADED_ROOM, FingerPaths
from planner.motion.tool_gait import UPRIGHT
from planner.plan import GraspPlan
from planner.shapes import Mesh
from planner.spatial import SE3, FloatArray, minimum_jerk
from planner.system.threads import made_once
from planner.task import GraspTask, Obstacle
from planner.verification import verify_geometry, verify_grasp
from sim.controllers import Observation, Phase
from sim.controllers.hand_dynamics import motor_servo
from sim.scene.build import OBJECT
from sim.scene.physics import PhysicsOptions
from sim.simulation import Simulation
from sim.tools.use import Faulty, Motion, Use, add_solid, joint_value

LEVER = "lever"
"""Name of the lever's body, and of what stands for it when the hand's room is checked."""

THICK, WIDE = 0.005, 0.016
"""Thickness and width of the lever, m."""

MASS = 0.004
"""Of the lever, kg; the tool's comes on top."""

PRELOAD, FRICTION = 0.5, 0.1
"""Force of the spring at rest, and of dry friction, as shares of the force at the end (-)."""

DAMPING, ARMATURE = 1e-3, 1e-5
"""Damping (N m s/rad) and added inertia (kg m2) of the hinge: a lever let go does not ring."""

FREE, DOWN_SHARE = 0.25, 0.8
"""Shares of the stroke (-): below the first the lever is up again, above the second it is down."""

BEFORE, BEYOND = 0.01, 0.002
"""How far (m) the pad is from the lever between idling and pressing, and how far beyond the end of
its stroke the finger is sent: its servo yields."""

MISSED = 0.0015
"""How far (m) the pad may be from where it is wanted on its way."""

FAR = 0.03
"""Miss (m) from which on the lever is out of reach in every heading."""

FACING = np.deg2rad(60.0)
"""Largest angle (rad) between the pad's axis and the direction in which it presses."""

ROOM = 1e-3
"""Least distance (m) of the pressing finger from all that it does not press."""

HEADINGS, SIDE = 48, 6
"""Turns of a round body that are looked at, and how many to either side of that in which the lever
is where the idle finger's pad is."""

IN, STAY, OUT, REST = 0.25, 0.1, 0.25, 0.15
"""Times (s) of a press: down, there, up, and off."""

ON_STRAIGHT, ON_WAY, ON_ARC, TRIES = 6, 4, 4, 6
"""Postures from idling to before the lever, on to it, and along its stroke; steps for each."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FingerWay:
    """How the finger gets to the lever and through its stroke.

    Attributes:
        finger: Which.
        reach: (m, nq), rad, from where it idles to where it touches the lever.
        stroke: (k, nq), rad, from there to the end of the stroke and ``BEYOND``.
        torque: (nq,), N m, with which it presses at the end of the stroke.
    """

    finger: Finger
    reach: FloatArray
    stroke: FloatArray
    torque: FloatArray


class Press(Use):
    """One finger presses the lever of the tool."""

    best_of: ClassVar[int] = 2
    """Few grasps let the finger reach the lever."""

    defaults: ClassVar[Mapping[str, float]] = MappingProxyType(
        {
            "presses": 30.0,
            "force_N": 3.0,
            "stroke_m": 0.006,
            "lever_m": 0.035,
        }
    )
    channels: ClassVar[Mapping[str, str]] = MappingProxyType(
        {
            "stroke_mm": "Stroke of the lever's end",
            "force_N": "Force of the hand on the lever",
            "stray_N": "Force of other fingers on the lever",
        }
    )

    def check(self) -> None:
        """Refuse numbers that cannot be."""
        n, name = self.numbers, self.tool.name
        for key, least, most in (
            ("presses", 1, 200),
            ("force_N", 0.1, 50.0),
            ("stroke_m", 0.002, 0.02),
            ("lever_m", 0.01, 0.1),
        ):
            if not least <= n[key] <= most:
                raise ObjectError(
                    f"{name}: use.numbers.{key} is {n[key]}; give {least:g} to {most:g}"
                )
        if n["stroke_m"] > 0.5 * n["lever_m"]:
            raise ObjectError(f"{name}: stroke_m is more than half of lever_m; give a longer lever")
        force = np.array([n["force_N"], 0.0, 0.0])
        wanted = np.concatenate([force, np.cross(self.tool.tip, force)])
        if len(self.tool.needed) != 1 or not np.allclose(self.tool.needed[0].wrench, wanted):
            raise ObjectError(
                f"{name}: its needed wrench does not balance the press; give one, with force_N = "
                f"{force.tolist()} and no torque: it is about the tip, the lever's end"
            )
        if self.tool.axis[2] > -UPRIGHT:
            raise ObjectError(
                f"{name}: tip.axis is {self.tool.axis.tolist()}; give [0, 0, -1]: the tool stands "
                "upright, and its lever hangs down to the tip"
            )
        self._length, self._stroke = (n[k] * self.tool.scale for k in ("lever_m", "stroke_m"))
        self._most = float(np.arcsin(self._stroke / self._length))
        self._hinge = self.tool.tip + np.array([-THICK / 2, 0.0, self._length])

    def offered(self, yaw: float = 0.0) -> SE3:
        """Upright, its lowest point ``gap_m`` above the block."""
        shape, pose = self.tool.shape, self.tool.T_world_object(np.zeros(3), yaw)
        corners = shape.vertices if isinstance(shape, Mesh) else np.array([-shape.half_extents])
        lowest = float((corners @ pose.rotation.T)[:, 2].min())
        return SE3(pose.rotation, np.array([0.0, 0.0, self._size[2] + self._gap - lowest]))

    def _end(self, angle: float) -> tuple[FloatArray, FloatArray]:
        """Where the lever is pressed (3,), m, and its outward normal (3,), at an angle (rad)."""
        turn = pin.exp3(np.array([0.0, angle, 0.0]))
        place = turn @ [THICK / 2, 0.0, -self._length]
        return self._hinge + place, turn[:, 0]

    def _lever(self, task: GraspTask, angle: float) -> Obstacle:
        """The lever as it stands in the way, at an angle (rad)."""
        turn = pin.exp3(np.array([0.0, angle, 0.0]))
        middle = SE3(turn, self._hinge + turn @ [0.0, 0.0, -self._length / 2])
        size = np.array([THICK, WIDE, self._length])
        return Obstacle(name=LEVER, size=size, T_world_obstacle=task.T_world_object * middle)

    def add_fixture(self, spec: Any, physics: PhysicsOptions, yaw: float) -> None:
        """Add the lever to the tool."""
        del yaw
        length = self._length
        body = spec.body(OBJECT).add_body(name=LEVER, pos=self._hinge)
        given = {"axis": [0, 1, 0], "damping": DAMPING, "armature": ARMATURE}
        hinge = body.add_joint(name=LEVER, type=mujoco.mjtJoint.mjJNT_HINGE, **given)
        unit = 1.0 if not spec.compiler.degree else float(np.rad2deg(1.0))
        hinge.limited, hinge.range = True, [0.0, unit * self._most]
        hinge.solref_limit = physics.solref
        torque = self.friction * self.numbers["force_N"] * length
        spring = (1.0 - FRICTION - PRELOAD) * torque / self._most
        hinge.stiffness = [spring, 0.0, 0.0]
        hinge.springref = -unit * PRELOAD * self._most / (1.0 - FRICTION - PRELOAD)
        hinge.frictionloss = FRICTION * torque
        half = (THICK / 2, WIDE / 2, length / 2)
        add_solid(body, physics, "box", half, (0.0, 0.0, -length / 2), MASS)

    def holding_fingers(self, hand: Hand, given: Sequence[str] | None = None) -> tuple[str, ...]:
        """All fingers, or those given, but the one that presses: the index, or the first no thumb.

        Raises:
            TaskError: That one is given too, or the hand has none.
        """
        presser = self._presser(hand)
        if given is not None and presser in given:
            raise TaskError(
                f"fingers has {presser}, which presses the lever of {self.tool.name}; leave it out"
            )
        return tuple(n for n in (hand.fingers if given is None else given) if n != presser)

    def _presser(self, hand: Hand) -> str:
        names = [name for name in hand.fingers if name != "thumb"]
        if not names:
            raise TaskError(
                f"{hand.name} has no finger but {', '.join(hand.fingers)} to press the lever of "
                f"{self.tool.name}; give a hand whose others can hold it"
            )
        return "index" if "index" in names else names[0]

    def fitting(self) -> Callable[[GraspPlan, GraspTask], GraspPlan | Failure]:
        """``fit``."""
        return self.fit

    def fit(self, plan: GraspPlan, task: GraspTask) -> GraspPlan | Failure:
        """The grasp turned about the tool's axis, the finger at the lever; or why there is none.

        Args:
            plan: A grasp of the body alone, without needed wrenches.
            task: The task with them.
        """
        T_object_base = task.T_world_object.inverse() * plan.T_world_base
        hand = task.hand
        finger = hand.fingers[self._presser(hand)]
        pad = T_object_base.act(MovingHand(hand, plan.q).pad_center(finger))
        step = 2 * np.pi / HEADINGS
        first = round(-float(np.arctan2(pad[1], pad[0])) / step)
        standing = replace(task, obstacles=(*task.obstacles, self._lever(task, 0.0)))
        failure: Failure | None = None
        for k in sorted(range(-SIDE, SIDE + 1), key=abs):
            turn = SE3(pin.exp3(np.array([0.0, 0.0, (first + k) * step])), np.zeros(3))
            base = task.T_world_object * turn * T_object_base
            way = self.finger_way(task, base, plan.q)
            if isinstance(way, Failure):
                failure = failure or way
                if way.numbers.get("missed", 0.0) > FAR:
                    break
                continue
            found = verify_grasp(standing, base, plan.q, record=plan.record)
            if isinstance(found, Failure):
                failure = found
                continue
            alone = verify_geometry(CollisionWorld(task), base, plan.q)  # as its file is read
            return replace(found, task=task, verification=alone)
        assert failure is not None
        return failure

    def finger_way(self, task: GraspTask, base: SE3, q: FloatArray) -> FingerWay | Failure:
        """How the finger gets to the lever and through its stroke; or what is in the way.

        Args:
            task: The task, without the lever.
            base: Pose of the hand's base, world.
            q: Joints (nq,) of the grasp.
        """
        hand = task.hand
        finger, paths = hand.fingers[self._presser(hand)], _paths(task)
        T_object_base, moving = task.T_world_object.inverse() * base, MovingHand(hand, q)
        angles = np.linspace(0.0, 1.0, ON_ARC + 1) * self._most
        aims = [self._end(0.0)] * (ON_WAY + 1) + [self._end(a) for a in angles[1:]]
        away = [*np.linspace(BEFORE, 0.0, ON_WAY + 1), *np.zeros(ON_ARC - 1), -BEYOND]
        out, at = [], q.copy()
        for (place, normal), off in zip(aims, away, strict=True):
            center = place + (finger.pad.radius + off) * normal
            missed = np.inf
            for _ in range(TRIES):
                before, at = missed, paths.follow(finger, T_object_base, at, center, at, BEFORE)
                pad = T_object_base.act(moving.move(at).pad_center(finger))
                missed = float(np.linalg.norm(pad - center))
                if missed < MISSED / 3 or missed > 0.7 * before:
                    break
            if missed > MISSED:
                text = f"{finger.name} misses its place at the lever by {1e3 * missed:.1f} mm"
                return Failure(kind="lever_out_of_reach", text=text, numbers={"missed": missed})
            axis = T_object_base.rotation @ moving.pad_axis(finger)
            if float(axis @ -normal) < np.cos(FACING):
                text = f"the pad of {finger.name} does not face the lever"
                return Failure(kind="lever_not_faced", text=text)
            out.append(at)
        push = -self.numbers["force_N"] * T_object_base.rotation.T @ self._end(self._most)[1]
        point = moving.pad_center(finger)
        torque = moving.point_jacobian(finger.pad.joint_id, point)[:3].T @ push
        if hand.actuation.short_of(at, task.needed_margin * torque, 1e-9).any():
            text = f"{finger.name} cannot press with {self.numbers['force_N']:g} N at the lever"
            return Failure(kind="lever_too_hard", text=text)
        idle = q + np.linspace(0.0, 1.0, ON_STRAIGHT + 1)[:, None] * (out[0] - q)
        reach = np.array([*idle, *out[1 : ON_WAY + 1]])
        stroke = np.array(out[ON_WAY:])
        blocked = self._blocked(task, base, finger, reach, 0.0)
        for angle, posture in zip(angles[1:].tolist(), stroke[1:], strict=True):
            blocked = blocked or self._blocked(task, base, finger, posture[None], angle)
        return blocked or FingerWay(finger=finger, reach=reach, stroke=stroke, torque=torque)

    def _blocked(
        self, task: GraspTask, base: SE3, finger: Finger, way: FloatArray, angle: float
    ) -> Failure | None:
        """What the hand comes into on the finger's way (m, nq), the lever at an angle (rad)."""
        obstacles = (*task.obstacles, self._lever(task, angle))
        world = CollisionWorld(replace(task, obstacles=obstacles))
        pads = pad_contact_queries(task).names
        mine = {g.name for g in contact_geometries(task.hand, finger)}
        for q in way:
            near = [
                one
                for one in world.distances(base, q)
                if not (one.second == LEVER and one.first in mine)
                and not (one.second == OBJECT and one.first in pads)
            ]
            worst = min(near, key=lambda one: one.distance)
            crowded = world.between_fingers(base, q, LOADED_ROOM)
            if crowded is not None or worst.distance < ROOM:
                text = f"{finger.name} has no room on its way to the lever: {crowded or worst}"
                return Failure(kind="lever_blocked", text=text)
        return None

    def _way_of(self, plan: GraspPlan) -> FingerWay:
        """The finger's way in a grasp.

        Raises:
            TaskError: It has none.
        """
        way = self.finger_way(plan.task, plan.T_world_base, plan.q)
        if isinstance(way, Failure):
            raise TaskError(f"{way}; give a plan of plan_tool for {self.tool.name}")
        return way

    def planned(self, plan: GraspPlan) -> ToolUse:
        """The finger's way to the lever and through its stroke; the hand stays."""
        way = self._way_of(plan)
        return ToolUse(
            way=tuple(self.way(plan)),
            finger=way.finger.name,
            postures=np.vstack([way.reach, way.stroke[1:]]),
        )

    def finger(self, plan: GraspPlan) -> PressingFinger:
        """What drives the pressing finger.

        Raises:
            TaskError: It has no way to the lever in this grasp.
        """
        way = self._way_of(plan)
        (needed,) = plan.task.needed
        wrench = plan.task.T_world_object.rotation @ needed.wrench.reshape(2, 3).T
        return PressingFinger(plan, way, (plan.T_world_base.rotation.T @ wrench).T.ravel())

    def way(self, plan: GraspPlan) -> list[SE3]:
        """The hand stays where it grasped."""
        return [plan.T_world_base]

    def begin(self, simulation: Simulation, phase: Phase) -> None:
        """Note where the hand is."""
        del phase
        self._base, self._begun = simulation.T_world_base, simulation.time

    def motion(self, simulation: Simulation, phase: Phase, share: float) -> Motion:
        """The hand stays."""
        del share
        done = phase == "use" and simulation.time - self._begun >= self.duration
        return Motion(T_world_base=self._base, done=done)

    @property
    def duration(self) -> float:
        """Time (s) of all presses."""
        return float(self.numbers["presses"] * (IN + STAY + OUT + REST))

    def measure(self, simulation: Simulation) -> dict[str, float]:
        """Where the lever is, and what presses on it."""
        scene, data = simulation.scene, simulation.data
        presser = self._presser(simulation.plan.task.hand)
        lever, load, force = int(scene.model.body(LEVER).id), {True: 0.0, False: 0.0}, np.zeros(6)
        for k in range(data.ncon):
            geoms = data.contact[k].geom.tolist()
            if lever not in [scene.body_of_geom[g] for g in geoms]:
                continue
            mujoco.mj_contactForce(scene.model, data, k, force)
            fingers = [scene.finger_of_geom[g] for g in geoms if g in scene.finger_of_geom]
            load[presser in fingers] += float(force[0])
        return {
            "stroke_mm": 1e3 * self._length * float(np.sin(joint_value(simulation, LEVER))),
            "force_N": load[True],
            "stray_N": load[False],
        }

    def _pressed(self, stroke_mm: FloatArray) -> int:
        """How often the lever went down and came up again, by its stroke (m,)."""
        share, count, is_down = stroke_mm / (1e3 * self._stroke), 0, False
        for s in share.tolist():
            if not is_down and s >= DOWN_SHARE:
                is_down = True
            elif is_down and s <= FREE:
                is_down, count = False, count + 1
        return count

    def faults(
        self, time: FloatArray, phase: Sequence[str], seen: Mapping[str, FloatArray]
    ) -> list[Faulty]:
        """The lever was pressed less often than asked."""
        using = np.flatnonzero([p in ("use", "withdraw", "hold") for p in phase])
        if not len(using) or self._pressed(seen["stroke_mm"]) >= self.numbers["presses"]:
            return []
        return [(float(time[using[-1]]), "use not done", self.summary(seen))]

    def summary(self, seen: Mapping[str, FloatArray]) -> str:
        """How often it was pressed, and how hard."""
        n = self.numbers
        return (
            f"the lever went down and came up {self._pressed(seen['stroke_mm'])} of "
            f"{n['presses']:.0f} times against {self.friction * n['force_N']:g} N, pressed with "
            f"{seen['force_N'].max():.1f} N at most"
        )


@made_once(2)
def _paths(task: GraspTask) -> FingerPaths:
    return FingerPaths(task)


class PressingFinger:
    """Drives the finger that presses: positions along its way, torques of the planned force.

    Attributes:
        actuators: (nu,), which are the finger's.
        load: (6,), what the others are to give now, base axes, N and N m.
    """

    def __init__(self, plan: GraspPlan, way: FingerWay, load: FloatArray) -> None:
        """Prepare.

        Args:
            plan: The grasp.
            way: Of the finger.
            load: (6,), what the other fingers give while it presses, base axes, N and N m.
        """
        self._way, self._most, hand = way, load, plan.task.hand
        self.load = np.zeros(6)
        self._hand, self._gravity, self._index = hand, plan.task.gravity, way.finger.q_index
        self._moving = MovingHand(hand, plan.q)
        self._stiffness, self._damping = motor_servo(hand, plan.q)
        self.actuators = (hand.actuation.moment[:, self._index] != 0).any(axis=1)
        self._phase, self._begun = "", 0.0
        self._from: FloatArray = plan.q
        self._last = (0.0, plan.q)

    def share(self, since: float) -> float:
        """Share of the stroke (-) at a time (s) since the first press began."""
        t = since % (IN + STAY + OUT + REST)
        up = minimum_jerk(np.asarray(np.clip(t / IN, 0.0, 1.0)))
        back = minimum_jerk(np.asarray(np.clip((t - IN - STAY) / OUT, 0.0, 1.0)))
        return float(up - back)

    def step(self, observation: Observation) -> FloatArray:
        """Commands (nu,) of which the finger's count."""
        now, k = observation.time, self._index
        if observation.phase != self._phase:
            self._phase, self._begun, self._from = observation.phase, now, observation.q.copy()
            self._last = (now, observation.q.copy())
        share, q = 0.0, observation.q.copy()
        if observation.phase == "use":
            share = self.share(now - self._begun)
            q[k] = _along(self._way.stroke, share)[k]
        else:
            s = float(minimum_jerk(np.asarray(observation.progress)))
            way = self._way.reach if observation.phase == "engage" else self._way.reach[::-1]
            s = s if observation.phase in ("engage", "withdraw") else 1.0
            left = (1.0 - s) * (self._from - way[0])
            q[k] = (_along(way, s) + left)[k]
        before, q_before = self._last
        self._last = (now, q.copy())
        v = np.zeros_like(q)
        if now > before:
            v[k] = (q - q_before)[k] / (now - before)
        gravity = observation.T_world_base.rotation.T @ self._gravity
        torque = self._moving.move(observation.q).gravity_torque(gravity)
        torque += self._hand.pin_model.damping * v + share * self._way.torque
        torque += self._stiffness * (q - observation.q) + self._damping * (v - observation.v)
        self.load = share * self._most
        return self._hand.actuation.commands(q, v, torque)


def _along(way: FloatArray, share: float) -> FloatArray:
    """Joints (nq,) at a share of a way (m, nq)."""
    at = share * (len(way) - 1)
    i = min(int(at), len(way) - 2)
    return np.asarray(way[i] + (at - i) * (way[i + 1] - way[i]))
