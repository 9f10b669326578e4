"""``turn``: a screw, a key, a lid: the tip turns a socket by the wrist, against friction.

The fixture is a socket (four walls and a floor, open above) on a hinge about the tool's axis with
dry friction. With a lead it advances along that axis by so much per turn, as a screw does; with a
stop it turns no further. The hand lowers the tip into it, as the pose of the tool in the hand
wants it, presses, turns about the axis until the socket has turned as far as it should, and goes
back up. An angle > 0 turns clockwise seen from above, and advances.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, ClassVar

import mujoco
import numpy as np
import pinocchio as pin

from planner.errors import ObjectError
from planner.plan import GraspPlan
from planner.shapes import Mesh
from planner.spatial import SE3, FloatArray, minimum_jerk, shifted
from sim.controllers import Phase
from sim.scene.physics import PhysicsOptions
from sim.simulation import Simulation
from sim.tools.use import (
    DOWN,
    FIXTURE,
    STEEL,
    Faulty,
    Motion,
    Use,
    about,
    add_solid,
    joint_value,
    load_on_fixture,
    pass_through_workpiece,
    sensed_object,
    tip_now,
)

HINGE, SLIDE = f"{FIXTURE}/turn", f"{FIXTURE}/advance"

WALL, FLOOR = 0.004, 0.004
"""Thickness of the socket's walls and of its floor, m."""

ARMATURE = 1e-4
"""Inertia (kg m2) added to the hinge. MuJoCo softens the lead's equality by the sum of both joints'
inverse inertias, whatever its coefficients: with 2e-6 the screw sinks by 0.1 m."""

MOST_LEAD = 0.02
"""Largest advance per turn, m: a steeper thread is turned by what pushes on it."""

SLIDE_DAMPING, SLIDE_ARMATURE = 1.0, 0.01
"""Damping (N s/m) and added inertia (kg) of the socket along its axis: a socket of grams on a stiff
lead would ring at the rate of the time steps."""

STIFF = (0.9999, 0.9999, 0.001, 0.5, 2.0)
"""Impedance (``solimp``) of the lead: with it 3 N along the axis move the screw by 0.1 mm."""

RATE = np.deg2rad(60.0)
"""Speed of the wrist, rad/s. The base of a Shadow-type hand is 0.36 m from the axis: at 120 degrees
per second it ran 2 to 4 mm outside of its circle, and the tool was pushed out of its place."""

RAMP = 0.3
"""Time (s) in which that speed is reached, and given up again before the end: a wrist that stops
within a time step shakes the fingers off the tool."""

CREEP = np.deg2rad(10.0)
"""Least speed (rad/s) of the wrist while it turns: what is left of a turn is made with it."""

MADE = np.deg2rad(0.3)
"""How near (rad) to the asked angle the socket has turned as far as it should."""

OVERTURN = np.deg2rad(60.0)
"""How much further (rad) than asked the wrist may turn: fingers yield by 10 to 30 degrees."""

SHORT = 3.0
"""How far below the asked angle (degrees) the socket may end: the wrist stops where it is read."""

INSERTED = 0.9
"""Share of the socket's depth to which the hand lowers the tip (-): the push does the rest, and the
floor is not met at speed."""

RISE = 0.03
"""How far (m) above the socket's mouth the tip ends."""

LEAST_DEPTH = 0.2
"""Share of the depth by which the tip must stay in the socket while it turns (-)."""

ALIGN_GAIN = 8.0
"""Rate (1/s) at which the hand takes the tool's error of pose away before it enters the socket."""

LOOK, ALIGNED = 0.2, 0.5
"""Shares of "engage" at which the hand begins to bring the tip into line, and has done so."""

POSES = 12
"""Poses of a turn of the way that is checked."""


class Turn(Use):
    """The tip of the tool turns a socket."""

    guided: ClassVar[bool] = True

    defaults: ClassVar[Mapping[str, float]] = MappingProxyType(
        {
            "angle_deg": 90.0,
            "friction_N_m": 0.03,
            "lead_m": 0.0,
            "stop_deg": 0.0,
            "push_N": 2.0,
            "socket_x_m": 0.009,
            "socket_y_m": 0.002,
            "depth_m": 0.005,
            "clearance_m": 0.0003,
        }
    )
    channels: ClassVar[Mapping[str, str]] = MappingProxyType(
        {
            "angle_deg": "Angle of the socket",
            "torque_Nm": "Torque of the tool on the socket, about its axis",
            "push_N": "Force of the tool on the socket, along its axis",
            "tip_error_mm": "Distance of the tip from the socket's axis",
            "depth_mm": "Depth of the tip in the socket",
        }
    )

    def check(self) -> None:
        """Refuse numbers that cannot be."""
        n, name = self.numbers, self.tool.name
        for key in ("socket_x_m", "socket_y_m", "depth_m"):
            if not 1e-3 <= n[key] <= 0.1:
                raise ObjectError(f"{name}: use.numbers.{key} is {n[key]}; give 0.001 to 0.1 m")
        for key, most in (("friction_N_m", 10.0), ("push_N", 100.0), ("clearance_m", 0.005)):
            if not 0.0 <= n[key] <= most:
                raise ObjectError(f"{name}: use.numbers.{key} is {n[key]}; give 0 to {most:g}")
        if not 1.0 <= abs(n["angle_deg"]) <= 3600.0:
            raise ObjectError(f"{name}: angle_deg is {n['angle_deg']}; give 1 to 3600 degrees")
        if n["stop_deg"] and abs(n["stop_deg"]) < abs(n["angle_deg"]) - SHORT:
            raise ObjectError(f"{name}: the stop at {n['stop_deg']} degrees is before the end")
        if n["stop_deg"] * n["angle_deg"] < 0.0:
            raise ObjectError(
                f"{name}: stop_deg is {n['stop_deg']} and angle_deg {n['angle_deg']}; give both "
                "one sign, or no stop"
            )
        if not abs(n["lead_m"]) <= MOST_LEAD:
            raise ObjectError(
                f"{name}: lead_m is {n['lead_m']}; give -{MOST_LEAD:g} to {MOST_LEAD:g} m per turn"
            )
        axis, sign = self.tool.axis, np.sign(n["angle_deg"])
        given = [
            sign * axis @ (w.torque - np.cross(self.tool.tip, w.force)) for w in self.tool.needed
        ]
        most = max([0.0, *given])
        if n["friction_N_m"] > most * (1 + 1e-6):  # rounded where torques are moved to the tip
            raise ObjectError(
                f"{name}: use.numbers.friction_N_m is {n['friction_N_m']:g}, but its needed "
                f"wrenches turn the fixture with {most:.3g} N m at most; raise torque_N_m about "
                "the axis in needed, in the direction of angle_deg"
            )
        self._goal = np.deg2rad(n["angle_deg"])
        self._depth = n["depth_m"] * self.tool.scale
        self._check_fit()
        self._starts_inside = self._gap == 0.0

    def _check_fit(self) -> None:
        """Refuse a socket into which the tip, of a tool with corners, does not go.

        Raises:
            ObjectError: The tip is wider; with its size.
        """
        n, tool = self.numbers, self.tool
        if not isinstance(tool.shape, Mesh):
            return
        turn = tool.T_world_object(np.zeros(3)).rotation
        corners = (tool.shape.vertices - tool.tip) @ turn.T
        inside = corners[corners[:, 2] < self._depth]
        wide = 2 * np.abs(inside[:, :2]).max(axis=0, initial=0.0)
        socket = tool.scale * np.array([n["socket_x_m"], n["socket_y_m"]])
        if (wide > socket + 2 * n["clearance_m"]).any():
            raise ObjectError(
                f"{tool.name}: its tip is {1e3 * wide[0]:.3g} x {1e3 * wide[1]:.3g} mm in the "
                f"lowest {1e3 * self._depth:.3g} mm, and the socket {1e3 * socket[0]:.3g} x "
                f"{1e3 * socket[1]:.3g}; give use.numbers socket_x_m and socket_y_m that fit it"
            )

    def offered(self, yaw: float = 0.0) -> SE3:
        """Above the socket; in it where the gap is 0."""
        pose = super().offered(yaw)
        return shifted(pose, self._depth * DOWN) if self._starts_inside else pose

    def add_fixture(self, spec: Any, physics: PhysicsOptions, yaw: float) -> None:
        """Add the socket."""
        n = self.numbers
        body = spec.worldbody.add_body(name=FIXTURE, pos=self.mouth)
        body.quat = [np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)]
        slide = mujoco.mjtJoint.mjJNT_SLIDE
        given = {"damping": SLIDE_DAMPING, "armature": SLIDE_ARMATURE}
        body.add_joint(name=SLIDE, type=slide, axis=DOWN, **given)
        hinge = body.add_joint(name=HINGE, type=mujoco.mjtJoint.mjJNT_HINGE, axis=DOWN)
        hinge.frictionloss = self.friction * n["friction_N_m"]
        hinge.armature = ARMATURE
        if n["stop_deg"]:
            unit = 1.0 if spec.compiler.degree else np.deg2rad(1.0)
            stop = unit * n["stop_deg"]
            hinge.limited, hinge.range = True, [min(0.0, stop), max(0.0, stop)]
        lead = spec.add_equality(type=mujoco.mjtEq.mjEQ_JOINT)
        lead.objtype = mujoco.mjtObj.mjOBJ_JOINT
        lead.name1, lead.name2 = SLIDE, HINGE
        lead.solref, lead.solimp = physics.solref, STIFF
        lead.data = [0.0, n["lead_m"] / (2 * np.pi), *(0.0,) * 10]
        size = np.array([n["socket_x_m"], n["socket_y_m"]]) * self.tool.scale / 2
        x, y = size + n["clearance_m"]
        d = self._depth / 2
        parts = [
            ((WALL / 2, y + WALL, d), (x + WALL / 2, 0.0, -d)),
            ((WALL / 2, y + WALL, d), (-x - WALL / 2, 0.0, -d)),
            ((x, WALL / 2, d), (0.0, y + WALL / 2, -d)),
            ((x, WALL / 2, d), (0.0, -y - WALL / 2, -d)),
            ((x + WALL, y + WALL, FLOOR / 2), (0.0, 0.0, -2 * d - FLOOR / 2)),
        ]
        for half, at in parts:
            add_solid(body, physics, "box", half, at, STEEL * 8 * float(np.prod(half)))
        pass_through_workpiece(spec)

    def way(self, plan: GraspPlan) -> list[SE3]:
        """Down into the socket, around, and up."""
        base, advance = plan.T_world_base, self.numbers["lead_m"] * self._goal / (2 * np.pi)
        drop = 0.0 if self._starts_inside else self._gap + self._depth
        down = [shifted(base, s * drop * DOWN) for s in (0.0, 0.5, 1.0)]
        turns = abs(self._goal) + OVERTURN
        most = min(turns, 2 * np.pi)
        sign = np.sign(self._goal)
        around = [
            shifted(self._turned(down[-1], sign * most * k / POSES), advance * DOWN * k / POSES)
            for k in range(1, POSES + 1)
        ]
        return [*down, *around, shifted(around[-1], [0.0, 0.0, RISE])]

    def _turned(self, base: SE3, angle: float) -> SE3:
        """A base pose turned about the socket's axis."""
        return about(self.mouth, DOWN, angle) * base

    def begin(self, simulation: Simulation, phase: Phase) -> None:
        """Note where hand and tool are."""
        self._base, self._begun = simulation.T_world_base, simulation.time
        if phase == "engage":
            self._aligned = self._base
        if phase == "use":
            self._angle = 0.0
        if phase == "withdraw":
            self._rise = RISE + self._depth

    def motion(self, simulation: Simulation, phase: Phase, share: float) -> Motion:
        """Where the hand is wanted."""
        if phase == "engage":
            return self._engaging(simulation, share)
        if phase == "use":
            return self._turning(simulation)
        s = float(minimum_jerk(np.asarray(share))) if phase == "withdraw" else 0.0
        return Motion(T_world_base=shifted(self._base, [0.0, 0.0, s * self._rise]))

    def _engaging(self, simulation: Simulation, share: float) -> Motion:
        push = self.numbers["push_N"]
        if self._starts_inside:
            return Motion(T_world_base=self._base, push=share * push)
        if share < LOOK:
            return Motion(T_world_base=self._base)
        s = float(minimum_jerk(np.asarray(max(0.0, share - ALIGNED) / (1.0 - ALIGNED))))
        drop = s * (self._gap + INSERTED * self._depth) * DOWN
        now = sensed_object(simulation)
        if self._depth_of(now) < 0.0:  # the tip is free: bring the tool into line, by its pose
            error = pin.log6(shifted(self.offered(self.yaw), drop) * now.inverse())
            step = pin.exp6(ALIGN_GAIN * simulation.timestep * error)
            self._aligned = step * self._aligned
        return Motion(T_world_base=shifted(self._aligned, drop))

    def _depth_of(self, pose: SE3) -> float:
        """How far below the mouth the tip is (m), the tool at a pose."""
        return float((self.mouth - pose.rotation @ self.tool.tip - pose.translation)[2])

    def _turning(self, simulation: Simulation) -> Motion:
        """Press, then turn about the socket's axis at an even speed, and slow down at the end."""
        goal, change = abs(self._goal), RATE / RAMP
        since = simulation.time - self._begun - RAMP
        left = goal - joint_value(simulation, HINGE) * np.sign(self._goal)
        if since > 0.0:
            rate = min(RATE, change * since, float(np.sqrt(2.0 * change * max(left, 0.0))))
            self._angle += max(rate, CREEP) * simulation.timestep
        angle = float(np.sign(self._goal) * min(self._angle, goal + OVERTURN))
        return Motion(
            T_world_base=self._turned(self._base, angle),
            push=self.numbers["push_N"],
            done=bool(left <= MADE),
        )

    @property
    def duration(self) -> float:
        """Longest time (s) of turning."""
        return float((abs(self._goal) + OVERTURN) / RATE + 5 * RAMP)

    def measure(self, simulation: Simulation) -> dict[str, float]:
        """Angle, load, and where the tip is."""
        advance = joint_value(simulation, SLIDE)
        mouth = self.mouth + advance * DOWN
        tip, load = tip_now(simulation, self.tool), load_on_fixture(simulation, self.mouth)
        return {
            "angle_deg": float(np.rad2deg(joint_value(simulation, HINGE))),
            "torque_Nm": float(-load[5]),
            "push_N": float(-load[2]),
            "tip_error_mm": 1e3 * float(np.linalg.norm((tip - mouth)[:2])),
            "depth_mm": 1e3 * float((mouth - tip)[2]),
        }

    def faults(
        self, time: FloatArray, phase: Sequence[str], seen: Mapping[str, FloatArray]
    ) -> list[Faulty]:
        """The tip left the socket, or the socket did not turn as far as it should."""
        using = np.array([p == "use" for p in phase])
        if not using.any():
            return []
        least = 1e3 * LEAST_DEPTH * self._depth
        out = np.flatnonzero(using & (seen["depth_mm"] < least))
        found: list[Faulty] = []
        if len(out):
            detail = f"the tip was {seen['depth_mm'][out[0]]:.1f} mm deep in the socket"
            found.append(
                (float(time[out[0]]), "left the fixture", f"{detail} ({least:.1f} wanted)")
            )
        turned = float(seen["angle_deg"][using][-1])
        if turned * np.sign(self._goal) < abs(self.numbers["angle_deg"]) - SHORT:
            end = float(time[using][-1])
            found.append((end, "use not done", self.summary(seen)))
        return found

    def summary(self, seen: Mapping[str, FloatArray]) -> str:
        """How far it turned, against what."""
        return (
            f"the socket turned {seen['angle_deg'][-1]:.0f} of {self.numbers['angle_deg']:.0f} "
            f"degrees against {self.friction * self.numbers['friction_N_m']:g} N m; the tip was at "
            f"most {np.nanmax(seen['tip_error_mm'][seen['depth_mm'] > 0], initial=0.0):.1f} mm off"
        )
