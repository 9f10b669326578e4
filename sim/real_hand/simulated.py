"""``SimulatedHand``: a trial in MuJoCo behind the interface of a real hand.

The trial stays what it is: its simulation makes every time step, its carrier moves the hand, its
recorder takes samples, and ``report`` judges them. Only the commands come from outside, through
``write``, and hold until the next ones. Run at the rate of the time steps, on the hand's own clock,
without limits, it is the trial to the last digit.

    own clock     ``hand.clock``: time passes where the loop waits, as fast as it can be computed
    real time     a clock is given: reading and writing simulate up to its time first
"""

from __future__ import annotations

import time
from collections.abc import Collection

import numpy as np

from planner.errors import HandError, TaskError
from planner.plan import GraspPlan
from planner.spatial import FloatArray
from sim.controllers import (
    Controller,
    Event,
    NeedsSenses,
    Phase,
    ReportsEvents,
    ReportsLimits,
    Sense,
    UsesSenses,
)
from sim.controllers.base import Observation
from sim.real_hand.interface import Clock, HandReading
from sim.report import TrialReport
from sim.trial import Trial

ALL_SENSES: tuple[Sense, ...] = ("touch", "object_pose", "object_twist", "pads")
"""What a simulated hand can be read for; contacts it does not give away."""


class _Written:
    """The simulation's controller: whatever was written last."""

    def __init__(self, plan: GraspPlan, driver: Controller) -> None:
        hand = plan.task.hand
        self._actuation = hand.actuation
        still = np.zeros(hand.nq)
        self.commands: FloatArray = hand.actuation.commands(plan.q_start, still, still)
        self.limp = False
        self._driver = driver

    def step(self, observation: Observation) -> FloatArray:
        """The commands written last; those that make no force where the torque is off."""
        if not self.limp:
            return self.commands
        none = np.zeros(len(observation.q))
        return self._actuation.commands(observation.q, observation.v, none)

    def saturated_actuators(self) -> tuple[str, ...]:
        """What the controller outside says."""
        driver = self._driver
        return driver.saturated_actuators() if isinstance(driver, ReportsLimits) else ()

    @property
    def events(self) -> tuple[Event, ...]:
        """What the controller outside noticed."""
        return self._driver.events if isinstance(self._driver, ReportsEvents) else ()


class SimulatedHand:
    """A hand in simulation.

    Attributes:
        trial: The trial that runs.
        controller: What the trial was made with, to be run on this hand.
        clock: What a loop is to be run by.
        joint_names, actuator_names: Those of the hand's model.
        finger_names: Fingers that take part, if it feels at all.
        rate_hz: One over the time step, Hz.
    """

    def __init__(
        self,
        trial: Trial,
        *,
        clock: Clock | None = None,
        senses: Collection[Sense] | None = None,
    ) -> None:
        """Take over a trial that has not run.

        Args:
            trial: The trial; its controller is not asked any more.
            clock: Real time; its own if None.
            senses: What can be read beside joints and efforts; what the trial's controller says
                that it needs or uses if None, or all if it says nothing.

        Raises:
            TaskError: The trial has run, or a sense that a hand cannot have.
        """
        simulation = trial.simulation
        if simulation.steps:
            raise TaskError("this trial has run already; make a new Trial for the hand")
        self.trial = trial
        self.controller = simulation.controller
        if senses is None:
            driver: object = self.controller
            senses = driver.needs if isinstance(driver, NeedsSenses) else ALL_SENSES
            senses = {*senses, *(driver.uses if isinstance(driver, UsesSenses) else ())}
        unknown = [sense for sense in senses if sense not in ALL_SENSES]
        if unknown:
            raise TaskError(
                f"a simulated hand cannot be read for {', '.join(unknown)}; it has "
                f"{', '.join(ALL_SENSES)}"
            )
        self._senses = frozenset(senses)
        task = trial.plan.task
        self.joint_names: tuple[str, ...] = task.hand.joint_names
        self.actuator_names: tuple[str, ...] = task.hand.actuation.names
        self.finger_names = task.finger_names if self._senses & {"touch", "pads"} else ()
        self.rate_hz = 1.0 / simulation.timestep
        self._simulation = simulation
        self._written = _Written(trial.plan, self.controller)
        simulation.controller = self._written
        self._real = clock
        self.clock: Clock = self if clock is None else clock
        self._offset: float | None = None if clock is not None else 0.0
        self._phase: Phase = simulation.phase
        self._carried = (0.0, 0.0, 0.0)  # progress, its rate, and since when
        self._begin = time.perf_counter()

    # ---- the interface

    def read(self) -> HandReading:
        """The state of now.

        Raises:
            HandError: The simulation has diverged.
        """
        self._catch_up()
        simulation, scene = self._simulation, self._simulation.scene
        if simulation.diverged:
            raise HandError(f"the simulation has diverged: {simulation.diverged}")
        seen = simulation.sensed(simulation.observe(self._phase, self._carried[0]))
        senses = self._senses
        return HandReading(
            time=simulation.time + (self._offset or 0.0),
            joints=seen.q,
            velocities=seen.v,
            efforts=np.array(simulation.data.actuator_force[scene.hand_ctrl]),
            touch=seen.normal_forces if "touch" in senses else None,
            T_world_base=seen.T_world_base,
            T_world_object=seen.T_world_object if "object_pose" in senses else None,
            object_twist=seen.object_twist if "object_twist" in senses else None,
            pads=seen.pads if "pads" in senses else None,
        )

    def write(self, commands: FloatArray) -> None:
        """Command the actuators (nu,) from now on.

        Raises:
            HandError: The torque was taken off.
        """
        if self._written.limp:
            raise HandError("the torque of this hand was taken off; make a new hand to go on")
        self._catch_up()
        self._written.commands = np.array(commands, dtype=np.float64)

    def stop(self) -> None:
        """Take the torque off: from now on the actuators make no force."""
        self._written.limp = True

    def close(self) -> None:
        """Close the viewer, if there is one."""
        self._simulation.close()

    # ---- what a real hand leaves to others

    def carry(self, phase: Phase, progress: float, per_second: float) -> None:
        """Move the hand as a whole, as the trial does; see ``sim.real_hand.Carry``."""
        simulation = self._simulation
        if phase != self._phase:
            self._phase = phase
            if phase == "settle":
                self.trial.recorder.mark_reference()
            if phase == "lift":
                simulation.scene.release(simulation.data)
        simulation.phase = phase
        self._carried = (progress, per_second, simulation.time)

    def report(self, *, interrupted: bool = False) -> TrialReport:
        """The trial's verdict on what happened."""
        simulation = self._simulation
        simulation.controller = self.controller
        if self._phase == "settle":  # it was not lifted
            self.trial.recorder.record()
        return self.trial.judged(self._begin, interrupted=interrupted)

    # ---- its own clock

    def now(self) -> float:
        """Simulated time, s."""
        return self._simulation.time

    def sleep_until(self, moment: float) -> None:
        """Simulate up to a time, s."""
        simulation = self._simulation
        half = 0.5 * simulation.timestep
        while simulation.time < moment - half and not simulation.ended:
            self._step()

    def _catch_up(self) -> None:
        """In real time, simulate up to now."""
        if self._real is None:
            return
        if self._offset is None:
            self._offset = self._real.now() - self._simulation.time
        self.sleep_until(self._real.now() - self._offset)

    def _step(self) -> None:
        """One time step, and a sample where one is due."""
        simulation = self._simulation
        progress, per_second, since = self._carried
        share = progress
        if simulation.time > since:
            share = min(1.0, progress + per_second * (simulation.time - since))
        simulation.step(self._phase, share)
        if simulation.due(self.trial.recorder.every):
            self.trial.recorder.record()
