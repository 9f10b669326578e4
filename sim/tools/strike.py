"""``strike``: a hammer drives a nail, which slides against dry friction.

The hand brings the face of the hammer onto the nail's head and swings it about a horizontal axis,
as about an elbow behind the grip: slowly up, and down so that the face moves at the asked speed
where it meets the head. Before every blow it moves so that the tool, wherever it lies in the hand
by now, is where it was before the first one, and lower by as much as the nail has gone: a face that
meets the nail off its middle turns the tool further. (About the middle of the grip, 1 m/s at a
lever of 60 mm are 16 rad/s, which no forearm follows.)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

import mujoco
import numpy as np
import pinocchio as pin

from planner.arrays import checked_number
from planner.errors import ObjectError, TaskError
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray, minimum_jerk, rotation_angle, shifted
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
    tip_now,
)

SLIDE = f"{FIXTURE}/drive"

HEAD, SHANK = 0.007, 0.0025
"""Radius of the nail's head and of its shank, m."""

HEAD_HEIGHT = 0.002
"""Thickness of the head, m."""

RAISE, THROUGH, REST = 0.6, 0.012, 0.4
"""Times (s) of raising the hammer, of stopping after the blow, and of coming to rest. Stopped in 12
ms the face goes on by 6 mm where a nail goes on by 4 to 6 mm; in 20 ms by 10 mm, and the fingers
gave way by the rest."""

NAIL_IN = 0.015
"""How near (m) to the end of its way a nail is in, and is not struck again: as much as a blow with
a heavy hand drives it. A nail that has come to its end throws the hammer out of the fingertips."""

OUT_OF_HAND = (0.03, np.deg2rad(30.0))
"""Distance (m) and turn (rad) of the tool from where a blow begins beyond which the hand does not
aim again: three times what may be. The hand would follow a tool that it has lost."""

RISE = 0.04
"""How far (m) the hand goes up after the last blow."""

HOVER = 0.002
"""Height (m) of the face over the nail's head from which it is raised."""

LEVER = (0.03, 0.3)
"""Shortest and longest way, m, across from grip to face: below it no direction to swing in; half
the longest tool."""

SLOW = 0.8
"""Share of the asked speed (-) that the fastest blow must have at least."""

POSES = 4
"""Poses of a swing of the way that is checked."""


@dataclass
class _Blow:
    """What a blow was, from every time step of it: it lasts less than the time between samples.

    Attributes:
        speed: Of the face along the nail at most, until it met the nail, m/s.
        force: Of the tool on the nail at most, along it, N.
        met: Whether it met the nail.
    """

    speed: float = 0.0
    force: float = 0.0
    met: bool = False

    def note(self, measured: Mapping[str, float]) -> None:
        """Add the measurement of a time step."""
        self.met = self.met or measured["force_N"] > 0.0
        self.force = max(self.force, measured["force_N"])
        if not self.met:
            self.speed = max(self.speed, measured["speed_mps"])


class Strike(Use):
    """The face of the tool drives a nail."""

    _is_in = False
    """Whether the nail is in, so that it is not struck again."""

    _held: SE3
    """Where the tool was before the first blow, raised by as much as the nail was in, world."""

    _depth: float
    """How deep (m) the nail was before this blow."""

    lasting: ClassVar[bool] = False
    stub: ClassVar[float] = 0.04
    gives_way: ClassVar[float] = 0.004  # measured: 2 to 4 mm
    rehearsed: ClassVar[bool] = True  # 10 of 36 grasps let it turn, with margins of 3 to 11
    best_of: ClassVar[int] = 3
    defaults: ClassVar[Mapping[str, float]] = MappingProxyType(
        {
            "blows": 5.0,
            "speed_m_s": 1.0,
            "swing_deg": 20.0,
            "reach_m": 0.3,
            "friction_N": 15.0,
            "depth_m": 0.01,
            "length_m": 0.06,
        }
    )
    channels: ClassVar[Mapping[str, str]] = MappingProxyType(
        {
            "driven_mm": "Depth to which the nail is driven",
            "speed_mps": "Speed of the face along the nail",
            "force_N": "Force of the tool on the nail, along it",
            "tip_error_mm": "Distance of the face's middle from the nail's axis",
        }
    )

    @property
    def _most(self) -> float:
        """How far the nail can be driven, m."""
        return self.stub - HEAD_HEIGHT

    def check(self) -> None:
        """Refuse numbers that cannot be."""
        n, name = self.numbers, self.tool.name
        for key, least, most in (
            ("blows", 1, 50),
            ("speed_m_s", 0.1, 3.0),
            ("swing_deg", 5.0, 60.0),
            ("reach_m", 0.05, 0.6),
            ("friction_N", 0.1, 1000.0),
            ("depth_m", 0.001, self._most - NAIL_IN),
            ("length_m", 0.02, 0.1),
        ):
            if not least <= n[key] <= most:
                raise ObjectError(
                    f"{name}: use.numbers.{key} is {n[key]}; give {least:g} to {most:g}"
                )

    def add_fixture(self, spec: Any, physics: PhysicsOptions, yaw: float) -> None:
        """Add the nail."""
        n = self.numbers
        body = spec.worldbody.add_body(name=FIXTURE, pos=self.mouth)
        slide = body.add_joint(name=SLIDE, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=DOWN)
        slide.frictionloss = self.friction * n["friction_N"]
        slide.limited, slide.range = True, [0.0, self._most]
        for radius, height, top in ((HEAD, HEAD_HEIGHT, 0.0), (SHANK, n["length_m"], HEAD_HEIGHT)):
            mass = STEEL * np.pi * radius**2 * height
            at = (0.0, 0.0, -top - height / 2)
            add_solid(body, physics, "cylinder", (radius, height / 2), at, mass)
        pass_through_workpiece(spec)

    def _pivot(self, plan: GraspPlan) -> tuple[FloatArray, FloatArray, float]:
        """The elbow (3,), as high as the tip, the axis that raises the tip (3,), and m between.

        Raises:
            TaskError: The grip is too near the tip, seen from above, or too far.
        """
        tip = plan.task.T_world_object.act(self.tool.tip)
        lever = tip - plan.contacts.positions.mean(axis=0)
        lever[2] = 0.0
        size = checked_number(
            f"{self.tool.name}: the lever, across from the middle of the grip to the tip,",
            float(np.linalg.norm(lever)), least=LEVER[0], most=LEVER[1], unit="m", error=TaskError,
        )  # fmt: skip
        lever, reach = lever / size, self.numbers["reach_m"]
        return tip - reach * lever, np.cross(lever, [0.0, 0.0, 1.0]), reach

    def way(self, plan: GraspPlan) -> list[SE3]:
        """Down to the nail, a swing there and where it is driven in, and up."""
        pivot, axis, _ = self._pivot(plan)
        top = np.deg2rad(self.numbers["swing_deg"])
        out = []
        swings = np.linspace(0.0, top, POSES)
        for drop in (0.0, self._gap, self._gap + self.numbers["depth_m"]):
            base = shifted(plan.T_world_base, drop * DOWN)
            out += [about(pivot + drop * DOWN, axis, s) * base for s in swings]
            swings = swings[::-1]  # down again where it was swung up
        return [*out, shifted(plan.T_world_base, [0.0, 0.0, RISE])]

    def begin(self, simulation: Simulation, phase: Phase) -> None:
        """Note where the hand is."""
        self._base, self._begun, self._blow = simulation.T_world_base, simulation.time, -1
        if phase == "engage":
            self._grip = self._pivot(simulation.plan)
        if phase == "use":
            self._blows: list[_Blow] = []
            self._shift = self._base.translation - simulation.plan.T_world_base.translation

    def motion(self, simulation: Simulation, phase: Phase, share: float) -> Motion:
        """Where the hand is wanted."""
        s = float(minimum_jerk(np.asarray(share)))
        if phase == "engage":
            gap = float((tip_now(simulation, self.tool) - self._head(simulation))[2]) - HOVER
            if share == 0.0:
                self._way = gap
            return Motion(T_world_base=shifted(self._base, s * self._way * DOWN))
        if phase == "use":
            return self._striking(simulation)
        up = s * RISE if phase == "withdraw" else 0.0
        return Motion(T_world_base=shifted(self._base, [0.0, 0.0, up]))

    def _head(self, simulation: Simulation) -> FloatArray:
        """Top of the nail's head (3,), m, world."""
        return self.mouth + joint_value(simulation, SLIDE) * DOWN

    def _striking(self, simulation: Simulation) -> Motion:
        """Raise, strike, stop, rest: so many times."""
        n, (pivot, axis, lever) = self.numbers, self._grip
        rate, top = n["speed_m_s"] / lever, np.deg2rad(n["swing_deg"])
        low = HOVER / lever
        strike = 2 * (top + low) / rate
        whole = RAISE + strike + THROUGH + REST
        since = simulation.time - self._begun
        blow = min(int(since / whole), int(n["blows"]) - 1)
        t = since - blow * whole
        if blow != self._blow:
            depth = joint_value(simulation, SLIDE)
            if blow:
                self._base, self._shift = self._aimed(1.0)
                self._drop = (depth - self._depth) * DOWN
                self._turn = self._aim(simulation.T_world_object, depth)
            else:
                self._held = shifted(simulation.T_world_object, -depth * DOWN)
                self._turn, self._drop = pin.Motion.Zero(), np.zeros(3)
            self._blow, self._depth = blow, depth
            if depth > self._most - NAIL_IN:
                self._is_in = True
                return Motion(T_world_base=self._base, done=True)
            self._blows.append(_Blow())
        if t >= RAISE and simulation.touching():
            self._blows[-1].note(self.measure(simulation))
        raised = float(minimum_jerk(np.asarray(min(1.0, t / RAISE))))
        base, shift = self._aimed(raised)
        if t < RAISE:
            angle = top * raised
        elif t < RAISE + strike:
            angle = top - (top + low) * ((t - RAISE) / strike) ** 2
        else:
            left = min(1.0, (t - RAISE - strike) / THROUGH)
            angle = -low - rate * THROUGH * (left - left * left / 2)
            angle *= 1.0 - float(
                minimum_jerk(np.asarray(np.clip((t - RAISE - strike - THROUGH) / REST, 0.0, 1.0)))
            )
        return Motion(
            T_world_base=about(pivot + shift, axis, angle) * base,
            done=since >= n["blows"] * whole,
        )

    def _aim(self, tool: SE3, depth: float) -> pin.Motion:
        """Motion of the hand that brings the tool, as it lies in it, over a nail (depth in m)."""
        wanted = shifted(self._held, depth * DOWN)
        off = np.linalg.norm(wanted.translation - tool.translation)
        turned = rotation_angle(wanted.rotation @ tool.rotation.T)
        if off > OUT_OF_HAND[0] or turned > OUT_OF_HAND[1]:
            return pin.Motion(self._drop, np.zeros(3))
        return pin.log6(wanted * tool.inverse())

    def _aimed(self, share: float) -> tuple[SE3, FloatArray]:
        """Base pose, and its pivot's shift (3,), at a share of the way to where a blow begins."""
        return pin.exp6(share * self._turn) * self._base, self._shift + share * self._drop

    @property
    def duration(self) -> float:
        """Time (s) of all blows."""
        n = self.numbers
        strike = 2 * (np.deg2rad(n["swing_deg"]) * n["reach_m"] + HOVER) / n["speed_m_s"]
        return float(n["blows"] * (RAISE + strike + THROUGH + REST))

    def measure(self, simulation: Simulation) -> dict[str, float]:
        """Depth, speed, load, and where the face is."""
        head, tip = self._head(simulation), tip_now(simulation, self.tool)
        twist = simulation.object_twist()
        lever = tip - simulation.T_world_object.translation
        return {
            "driven_mm": 1e3 * joint_value(simulation, SLIDE),
            "speed_mps": float((twist[:3] + np.cross(twist[3:], lever)) @ DOWN),
            "force_N": float(-load_on_fixture(simulation, head)[2]),
            "tip_error_mm": 1e3 * float(np.linalg.norm((tip - head)[:2])),
        }

    def faults(
        self, time: FloatArray, phase: Sequence[str], seen: Mapping[str, FloatArray]
    ) -> list[Faulty]:
        """The nail is not driven as deep as it should be, or the blows were slow."""
        using = np.flatnonzero([p == "use" for p in phase])
        if not len(using):
            return []
        slow = self._hardest()[1] < SLOW * self.numbers["speed_m_s"]
        if slow or seen["driven_mm"][using[-1]] < 1e3 * self.numbers["depth_m"]:
            return [(float(time[using[-1]]), "use not done", self.summary(seen))]
        return []

    def _hardest(self) -> tuple[int, float, float]:
        """How many blows met the nail, the highest speed (m/s) of one and its largest force (N)."""
        met = [blow for blow in self._blows if blow.met]
        speed, force = (max([0.0, *(getattr(b, k) for b in met)]) for k in ("speed", "force"))
        return len(met), speed, force

    def summary(self, seen: Mapping[str, FloatArray]) -> str:
        """How deep the nail is, and how fast the blows were."""
        n, (blows, speed, force) = self.numbers, self._hardest()
        how = "in, " if self._is_in else ""
        return (
            f"{blows} of {n['blows']:.0f} blows, at up to {speed:.2f} m/s and {force:.0f} N, drove "
            f"the nail {how}{seen['driven_mm'][-1]:.1f} mm ({1e3 * n['depth_m']:.0f} wanted) "
            f"against {self.friction * n['friction_N']:g} N"
        )
