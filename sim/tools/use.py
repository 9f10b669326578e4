"""``Use``: a kind of use of a tool; what a kind adds to a trial, and how the hand moves in it.

Every use has a workpiece, a block that stands on the ground at the world's origin, and on it a
fixture: bodies with joints and friction, which the tool meets by contacts alone. The tool is
offered with its axis down and its tip ``gap_m`` above the fixture's mouth; the support releases it
when the fingers press.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, TypeAlias

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planner.errors import ObjectError, TaskError
from planner.failure import Failure
from planner.hands.hand import Hand
from planner.motion.phase import ToolUse
from planner.plan import GraspPlan
from planner.registry import Registry
from planner.spatial import SE3, FloatArray, shifted
from planner.task import GraspTask, Obstacle
from planner.tools import BEST_OF, Tool, use_data, use_numbers
from sim.controllers import Observation, Phase
from sim.scene.build import OBSTACLE_PREFIX, WORLD_BIT
from sim.scene.physics import PhysicsOptions
from sim.simulation import Simulation
from sim.verdict import Reason

WORKPIECE, FIXTURE = "workpiece", "fixture"
"""Names of the block and of the body in which the tool works; its joints begin like it."""

LARGEST_PIECE = 1.0
"""Largest extent (m) of a workpiece: what is larger was given in other units."""

DOWN = np.array([0.0, 0.0, -1.0])
"""Into the fixture, along the tool's axis (3,), world."""

STEEL = 7800.0
"""Density of fixtures, kg/m3."""

Faulty: TypeAlias = tuple[float, Reason, str]
"""Time (s), reason of the verdict, and detail of what a use did wrong."""


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Where the hand is wanted now.

    Attributes:
        T_world_base: Pose of its base.
        push: Force (N) along the world's -z in place of the base's height; None to hold that.
        done: Whether the phase may end.
    """

    T_world_base: SE3
    push: float | None = None
    done: bool = False


class OwnFinger(Protocol):
    """Drives a finger that does not hold the tool.

    Attributes:
        actuators: (nu,), which are the finger's.
        load: (6,), what the others are to give now, base axes, N and N m.
    """

    actuators: NDArray[np.bool_]
    load: FloatArray

    def step(self, observation: Observation) -> FloatArray:
        """Commands (nu,) of which the finger's count."""


class Use(ABC):
    """One use of one tool.

    Attributes:
        tool: The tool.
        numbers: Those of its file, with the kind's defaults.
    """

    defaults: ClassVar[Mapping[str, float]]
    """Name -> default of the numbers of the kind."""

    stub: ClassVar[float] = 0.012
    """Height (m) of the fixture's mouth above the workpiece."""

    channels: ClassVar[Mapping[str, str]]
    """Name -> title of what is recorded over time; the name ends with the unit."""

    lasting: ClassVar[bool] = True
    """Whether the tool is loaded for longer than moments, so that the hand may learn the load."""

    gives_way: ClassVar[float] = 0.0
    """How far (m) the use takes the tool away from fingers for moments: those then follow."""

    guided: ClassVar[bool] = False
    """Whether the fixture guides the tool, so that the hand is to learn only the torque about the
    vertical."""

    best_of: ClassVar[int] = BEST_OF
    """Grasps of which the best is taken."""

    rehearsed: ClassVar[bool] = False
    """Whether a grasp is tried in simulation before it is taken: where its proven margins do not
    tell whether the tool stays in the hand."""

    yaw: float = 0.0
    """Turn of tool and fixture about the vertical, rad; may be set."""

    friction: float = 1.0
    """Factor on the fixture's dry friction that no plan knows (-); may be set."""

    def __init__(self, tool: Tool) -> None:
        """Read the numbers of the tool.

        Raises:
            ObjectError: The tool has none of the kind, or one that its kind has not.
        """
        self.tool, self.numbers, use = tool, use_numbers(tool, self.defaults), use_data(tool)
        self._size, self._gap = np.array(use.workpiece_m), use.gap_m
        if not ((self._size > 0) & (self._size <= LARGEST_PIECE)).all():
            raise ObjectError(
                f"{tool.name}: workpiece_m is {self._size}; give three lengths > 0 and <= "
                f"{LARGEST_PIECE:g} m"
            )
        self.check()

    @abstractmethod
    def check(self) -> None:
        """Refuse numbers that cannot be.

        Raises:
            ObjectError: There is one.
        """

    @property
    def mouth(self) -> FloatArray:
        """Where the tip enters the fixture (3,), m, world."""
        return np.array([0.0, 0.0, self._size[2] + self.stub])

    def offered(self, yaw: float = 0.0) -> SE3:
        """Pose at which the tool is offered, in line with its fixture.

        Args:
            yaw: Turn of tool and fixture about the vertical, rad.
        """
        return shifted(self.tool.T_world_object(self.mouth, yaw), [0.0, 0.0, self._gap])

    @property
    def obstacles(self) -> tuple[Obstacle, ...]:
        """The workpiece, as the planner sees it."""
        pose = SE3(np.eye(3), np.array([0.0, 0.0, self._size[2] / 2]))
        return (Obstacle(name=WORKPIECE, size=self._size, T_world_obstacle=pose),)

    @abstractmethod
    def add_fixture(self, spec: Any, physics: PhysicsOptions, yaw: float) -> None:
        """Add the fixture's bodies to a ``mujoco.MjSpec``."""

    def holding_fingers(
        self, hand: Hand, given: Sequence[str] | None = None
    ) -> Sequence[str] | None:
        """Names of the fingers that hold the tool; those given, or the hand's own if None.

        Raises:
            TaskError: The use needs one of those given for something else.
        """
        del hand
        return given

    def fitting(self) -> Callable[[GraspPlan, GraspTask], GraspPlan | Failure] | None:
        """What makes a grasp of the body alone one for the use; None if all grasps are searched."""
        return None

    def finger(self, plan: GraspPlan) -> OwnFinger | None:
        """What drives a finger that does not hold; None where all do.

        Raises:
            TaskError: It cannot be done in this grasp.
        """
        del plan
        return None

    @abstractmethod
    def way(self, plan: GraspPlan) -> list[SE3]:
        """Base poses of a grasp through which the use takes the hand, close together.

        Raises:
            TaskError: The tool cannot be used in this grasp; another may do.
        """

    def planned(self, plan: GraspPlan) -> ToolUse:
        """The way of the use as a phase of a movement.

        Raises:
            TaskError: As ``way``.
        """
        return ToolUse(way=tuple(self.way(plan)), finger="", postures=np.zeros((0, len(plan.q))))

    @abstractmethod
    def begin(self, simulation: Simulation, phase: Phase) -> None:
        """A phase begins: look at what there is."""

    @abstractmethod
    def motion(self, simulation: Simulation, phase: Phase, share: float) -> Motion:
        """Where the hand is wanted at a share in [0, 1] of a phase: engage, use, withdraw, hold."""

    @property
    @abstractmethod
    def duration(self) -> float:
        """Longest time (s) of the phase "use"."""

    @abstractmethod
    def measure(self, simulation: Simulation) -> dict[str, float]:
        """What is recorded now, by ``channels``."""

    @abstractmethod
    def faults(
        self, time: FloatArray, phase: Sequence[str], seen: Mapping[str, FloatArray]
    ) -> list[Faulty]:
        """What went wrong with the use; empty if it is done.

        Args:
            time: (m,), s.
            phase: m phases.
            seen: What was measured, (m,) each.
        """

    @abstractmethod
    def summary(self, seen: Mapping[str, FloatArray]) -> str:
        """What was done, a sentence with numbers; the phase "use" was begun."""


USES: Registry[type[Use]] = Registry("kind of use", group="uses")
"""Every kind of use by its name."""


def register_use(name: str, use: type[Use]) -> type[Use]:
    """Make a kind of use known by its name, as tool files have it.

    A package of others needs no call: an entry point of the group ``opposable.uses`` will do.

    Raises:
        TaskError: The name is another's.
    """
    return USES.add(name, use)


def use_of(tool: Tool) -> Use:
    """The use of a tool.

    Raises:
        NotFoundError: There is no such kind.
        ObjectError: The tool says no use, or numbers that its kind has not.
    """
    return USES.named(use_data(tool).kind)(tool)


def add_solid(
    body: Any,
    physics: PhysicsOptions,
    kind: str,
    size: Sequence[float],
    at: Sequence[float] | FloatArray,
    mass: float,
) -> None:
    """Add a colliding geom of a fixture, whose friction decides against the tool's.

    Args:
        body: Body of a ``mujoco.MjSpec``.
        physics: How contacts are computed.
        kind: "box" or "cylinder".
        size: Half lengths, or radius and half length, m.
        at: Centre (3,), m, in the body.
        mass: kg.
    """
    geom = body.add_geom(condim=physics.condim, priority=2, rgba=(0.45, 0.47, 0.52, 1.0))
    geom.type = getattr(mujoco.mjtGeom, f"mjGEOM_{kind.upper()}")
    geom.contype = geom.conaffinity = WORLD_BIT
    geom.size = [*size, *(0.0,) * (3 - len(size))]
    geom.pos, geom.mass = at, mass
    geom.friction, geom.solref, geom.solimp = physics.friction, physics.solref, physics.solimp


def pass_through_workpiece(spec: Any) -> None:
    """Let the fixture move in the block that it stands on, as a screw does in its thread."""
    spec.add_exclude(bodyname1=FIXTURE, bodyname2=OBSTACLE_PREFIX + WORKPIECE)


def joint_value(simulation: Simulation, name: str) -> float:
    """Coordinate of a fixture's joint, rad or m."""
    model, data = simulation.scene.model, simulation.data
    return float(data.qpos[model.joint(name).qposadr[0]])


def tip_now(simulation: Simulation, tool: Tool) -> FloatArray:
    """Where the tip is (3,), m, world."""
    pose = simulation.T_world_object
    return np.asarray(pose.rotation @ tool.tip + pose.translation)


def load_on_fixture(simulation: Simulation, at: FloatArray) -> FloatArray:
    """Force and torque (6,) of the tool on the fixture about a point, N and N m, world."""
    scene, data = simulation.scene, simulation.data
    body_of, wanted = scene.body_of_geom, {scene.object_body, int(scene.model.body(FIXTURE).id)}
    total, force = np.zeros(6), np.zeros(6)
    for k in range(data.ncon):
        contact = data.contact[k]
        pair = [body_of[int(g)] for g in contact.geom]
        if set(pair) != wanted:
            continue
        mujoco.mj_contactForce(scene.model, data, k, force)
        axes = contact.frame.reshape(3, 3).T  # the normal points from the first geom to the second
        sign = 1.0 if pair[1] != scene.object_body else -1.0
        push, twist = sign * axes @ force[:3], sign * axes @ force[3:]
        total += np.concatenate([push, twist + np.cross(contact.pos - at, push)])
    return total


def about(point: FloatArray, axis: FloatArray, angle: float) -> SE3:
    """The motion (SE3) that turns by an angle (rad) about an axis through a point, world."""
    turn = pin.exp3(angle * axis)
    return SE3(turn, point - turn @ point)


def sensed_object(simulation: Simulation) -> SE3:
    """Pose of the tool as the controller reads it."""
    seen = simulation.seen
    return simulation.T_world_object if seen is None else seen.T_world_object


def needs_gantry(task: GraspTask) -> None:
    """Refuse a hand on an arm.

    Raises:
        TaskError: It is on one.
    """
    if task.hand.arm is not None:
        raise TaskError(
            f"{task.hand.name} is on an arm; tools are used with a hand that the gantry "
            "carries: name the hand alone"
        )
