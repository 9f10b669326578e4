"""``Hold``: an object gripped in the air, to which a protocol then does what it likes.

A trial whose table and obstacles are left out. It begins at the grasp with open fingers, a
constraint holds the object until the grip is there, and then nothing but the hand does::

    hold = Hold(plan)
    fault = hold.grip() or hold.endure(2.0)

Movement is the object's in the palm, since the grip was there.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray, rotation_angle
from sim.carrier import Carrier
from sim.contacts import hand_contacts, normal_forces
from sim.controllers import Controller, Event, Phase, ReportsEvents
from sim.controllers.slip import SLIP_SPEED
from sim.physics.options import PhysicsOptions
from sim.protocols.outcome import Failure, Fault
from sim.scene import Scene
from sim.timeline import Timeline
from sim.trial import Trial
from sim.verdict import Samples

__all__ = ["GRIP", "LOST", "Hold", "Lost"]

GRIP = Timeline(approach=0.1, close=0.3, close_wait=0.5, squeeze=0.4, settle=0.2, lift=0.4)
"""Durations; there is no approach, and "lift" is the time to come to rest when the object is let
go."""

CHECK_EVERY = 0.01
"""Time between looks at whether the object is lost, s."""

RECORD_EVERY = 0.1
"""Time between samples, s."""

BLAME_WINDOW = 0.2
"""An actuator at its limit in most looks of this long (s) before a failure is its reason."""


REST_SPEED = SLIP_SPEED
"""Speed (m/s), of the centre of mass or by the turn on the bounding sphere, below which an object
is at rest: the speed from which on a contact is said to slip."""


@dataclass(frozen=True, kw_only=True)
class Lost:
    """When an object counts as lost.

    Attributes:
        mm: Movement in the palm, mm.
        deg: Turn in the palm, degrees.
    """

    mm: float = 10.0
    deg: float = 15.0


LOST = Lost()
"""The turn is that of DexGraspBench, the distance a fifth of its 50 mm: a servo yields by some
millimetres before anything slips."""

_PUSHED: tuple[Phase, ...] = ("close", "squeeze", "settle", "lift")


class Hold(Trial):
    """A grip in the air.

    Attributes:
        load: Size of the disturbance at present, written down with every sample.
    """

    def __init__(
        self,
        plan: GraspPlan,
        *,
        controller: Controller,
        physics: PhysicsOptions | None = None,
        lost: Lost | None = LOST,
        timeline: Timeline = GRIP,
        scene: Scene | None = None,
        carrier: Carrier | None = None,
    ) -> None:
        """Put the hand, fingers open, where it grasps.

        Args:
            plan: What to execute.
            controller: What drives the hand.
            physics: How MuJoCo computes; defaults if None.
            lost: When the object counts as lost; None for someone else's rule.
            timeline: Durations up to the hold.
            scene: Another scene than that of the plan's task in the air.
            carrier: What carries the hand in it.
        """
        task = replace(plan.task, table_height=None, obstacles=())
        super().__init__(
            replace(plan, task=task),
            physics=physics,
            controller=controller,
            timeline=timeline,
            record_every=RECORD_EVERY,
            scene=scene,
            carrier=carrier,
        )
        self.data = self.scene.start(plan.q_pregrasp, plan.T_world_base)
        self.carrier = _Still(self.carrier)
        self._lost = lost
        self._reference = self.T_palm_object
        self._looks = max(1, round(CHECK_EVERY / self.scene.physics.timestep))
        self._recent: deque[tuple[str, ...]] = deque(maxlen=round(BLAME_WINDOW / CHECK_EVERY))
        self._loads: list[float] = []
        self.load = 0.0

    def grip(self) -> Fault | None:
        """Close, press, and let go of the object; what went wrong, None if nothing did."""
        task = self.plan.task
        if not self.plan.forces.found:
            return self.fault("infeasible forces", self.plan.forces.reason)
        for phase in _PUSHED:
            going = self.run_phase(phase)
            if divergence := self.divergence():
                return self.fault("diverged", divergence)
            if not going:
                forces = normal_forces(self.scene, self.data, task.finger_names)
                missing = [f for f, n in zip(task.finger_names, forces, strict=True) if n == 0]
                detail = f"after the squeeze {', '.join(missing)} did not touch"
                return self.fault("no contact", f"{detail}; {task.fingers_needed} are needed")
        self.mark()
        return None

    @property
    def events(self) -> tuple[Event, ...]:
        """What the controller noticed so far."""
        return self.controller.events if isinstance(self.controller, ReportsEvents) else ()

    def mark(self) -> None:
        """From now on it is a hold, and the object's movement in the palm counts."""
        self._reference = self.T_palm_object
        self.recorder.mark_reference(self.data)
        self.phase = "hold"
        self.record()

    def endure(
        self, duration: float, *, each_step: Callable[[float], None] | None = None
    ) -> Fault | None:
        """Hold on, and look whether the object is lost.

        Args:
            duration: s.
            each_step: Called before every time step with the time since this call began, s.

        Returns:
            What went wrong; None if the object is still held.
        """
        dt = self.scene.physics.timestep
        steps = max(1, round(duration / dt))
        for k in range(steps):
            if each_step is not None:
                each_step(k * dt)
            self.step("hold", min(1.0, k / steps))
            if self.sample_due:
                self.record()
            if divergence := self.divergence():
                return self.fault("diverged", divergence)
            if self.steps % self._looks == 0:
                self._recent.append(self.limited_actuators())
                if self._lost is not None and (fault := self._look(self._lost)):
                    self.record()
                    return fault
        return None

    def push(self, wrench: FloatArray) -> None:
        """Disturb the object from now on by a wrench (6,), N and N m, about its centre of mass."""
        self.data.xfrc_applied[self.scene.object_body] = wrench

    def record(self) -> None:
        """Take a sample."""
        self.recorder.record(self.data, "hold", self.limited_actuators())
        self._loads.append(self.load)

    def at_rest(self) -> bool:
        """Whether the object hardly moves, in a hand that stands still."""
        linear, angular = np.split(self.data.qvel[self.scene.object_dof], 2)
        length = self.plan.task.object.shape.bounding_radius
        fastest = max(np.linalg.norm(linear), length * np.linalg.norm(angular))
        return bool(fastest < REST_SPEED)

    @property
    def T_palm_object(self) -> SE3:
        """Where the object is in the palm."""
        scene = self.scene
        T_world_palm = scene.body_pose(self.data, scene.palm_body)
        return T_world_palm.inverse() * scene.body_pose(self.data, scene.object_body)

    @property
    def T_base_object(self) -> SE3:
        """Where the object is in the hand's base."""
        scene = self.scene
        T_world_base = scene.body_pose(self.data, scene.base_body)
        return T_world_base.inverse() * scene.body_pose(self.data, scene.object_body)

    @property
    def q(self) -> FloatArray:
        """The hand's joints (nq,) as they are now."""
        return np.array(self.data.qpos[self.scene.hand_qpos])

    @property
    def samples(self) -> Samples:
        """What was recorded so far."""
        return self.recorder.samples()

    @property
    def loads(self) -> FloatArray:
        """The load at each sample, (m,); none while the grip is made."""
        loads = np.zeros(len(self.samples))
        if self._loads:
            loads[-len(self._loads) :] = self._loads
        return loads

    def touching(self) -> int:
        """How many fingers touch the object, the palm counted as one."""
        return len(set(hand_contacts(self.scene, self.data).fingers))

    def blamed(self, reason: Failure, detail: str) -> Fault:
        """The fault, put down to actuators that had no more to give where that is so."""
        names = [name for look in self._recent for name in set(look)]
        often = sorted({n for n in names if 2 * names.count(n) > len(self._recent)})
        if not often:
            return self.fault(reason, detail)
        return self.fault(
            "torque limit reached",
            f"{', '.join(often)} stood at the limit; then: {reason}, {detail}",
        )

    def fault(self, reason: Failure, detail: str) -> Fault:
        """A fault of this moment."""
        return Fault(reason=reason, detail=detail, time=float(self.data.time))

    def _look(self, lost: Lost) -> Fault | None:
        """Whether the object is lost now."""
        now = self.T_palm_object
        moved = 1e3 * float(np.linalg.norm(now.translation - self._reference.translation))
        turned = float(np.rad2deg(rotation_angle(self._reference.rotation.T @ now.rotation)))
        where = f"the object had moved {moved:.1f} mm and turned {turned:.1f} degrees in the hand"
        touching = self.touching()
        if touching == 0:
            return self.blamed("dropped", f"nothing touched it any more; {where}")
        if moved > lost.mm or turned > lost.deg:
            return self.blamed("slipped", f"{where}; {touching} fingers touched")
        return None


class _Still:
    """Keeps the hand where the grasp is, whatever carries it."""

    def __init__(self, carrier: Carrier) -> None:
        """Wrap what would lift it."""
        self._carrier = carrier

    def drive(self, data: Any, phase: Phase, share: float) -> None:
        """Command the pose of the grasp."""
        del phase, share
        self._carrier.drive(data, "settle", 0.0)
