"""Hands that stand in for a real one.

``SimulatedHand``: a trial in MuJoCo behind the interface of a real hand.

The trial stays what it is: its simulation makes every time step, its carrier moves the hand, its
recorder takes samples, and ``report`` judges them. Only the commands come from outside, through
``write``, and hold until the next ones. Run at the rate of the time steps, on the hand's own clock,
without limits, it is the trial to the last digit.

    own clock     ``hand.clock``: time passes where the loop waits, as fast as it can be computed
    real time     a clock is given: reading and writing simulate up to its time first

``ReplayedHand``: a log as a hand: its readings again, its commands to compare.

Run by ``hand.clock`` the loop sees the times of the log, misses included, so that the same
controller with the same limits gives the same commands; another one shows where it differs. The
readings do not answer to the commands: what a controller would have caused is not replayed. A loop
of another plan or at another rate is refused.
"""

from __future__ import annotations

import math
import time
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from planner.errors import FileFormatError, HandError, TaskError
from planner.hands.hand import Hand
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
from sim.real_hand.interface import Clock, EndOfReadings, HandReading, PlanMark, places
from sim.real_hand.log import HandLog, read_log
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


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Commands written to a replayed hand against those of the log.

    Attributes:
        compared: Ticks that were compared.
        largest: Largest difference of a command, rad or N m; 0 where nothing was compared.
        actuator: Where; "" where nothing differs.
        time_s: When, s since the log's first tick.
    """

    compared: int
    largest: float
    actuator: str
    time_s: float

    def __str__(self) -> str:
        """In words."""
        if not self.compared:
            return "no commands compared"
        where = f" ({self.actuator} at {self.time_s:.3f} s)" if self.actuator else ""
        return f"{self.compared} commands compared, largest difference {self.largest:.3g}{where}"


class ReplayedHand:
    """A log as a hand; also its clock.

    Attributes:
        log: What is replayed.
        clock: What a loop is to be run by.
        joint_names, actuator_names, finger_names: Those of the log.
        rate_hz: That of the log, Hz.
    """

    def __init__(self, log: HandLog | Path | str, hand: Hand | None = None) -> None:
        """Read a log.

        Args:
            log: The log, or its file.
            hand: The model that it is to fit; not checked if None.

        Raises:
            FileFormatError: The file cannot be read, is empty, or is of a hand with other joints
                or actuators.
        """
        self.log = log if isinstance(log, HandLog) else read_log(log)
        if not len(self.log):
            raise FileFormatError("the log holds no readings; record a longer run")
        if hand is not None:
            try:
                places("joint", hand.joint_names, self.log.joint_names)
                places("actuator", hand.actuation.names, self.log.actuator_names)
            except HandError as error:
                raise FileFormatError(
                    f"the log is of another hand than {hand.name}: {error}"
                ) from error
        self.joint_names, self.actuator_names = self.log.joint_names, self.log.actuator_names
        self.finger_names, self.rate_hz = self.log.finger_names, self.log.rate_hz
        self.clock: Clock = self
        self._i = 0
        self._now = float(self.log.begin_s[0])
        self._differences: list[tuple[int, FloatArray]] = []
        self._stopped = False

    def read(self) -> HandReading:
        """The reading of this tick.

        Raises:
            EndOfReadings: The log ends before it.
        """
        log, i = self.log, self._i
        if i >= len(log):
            raise EndOfReadings(f"the log ends after {len(log)} readings")
        self._now = float(log.write_s[i])
        return log.reading(i)

    def write(self, commands: FloatArray) -> None:
        """Compare commands (nu,) with those of the log.

        Raises:
            HandError: The hand was stopped.
        """
        if self._stopped:
            raise HandError("the replayed hand was stopped; make a new one to go on")
        logged = self.log.commands[self._i]
        if np.isfinite(logged).all():
            self._differences.append((self._i, np.abs(commands - logged)))
        self._now = float(self.log.end_s[self._i])

    def stop(self) -> None:
        """Refuse commands from now on."""
        self._stopped = True

    def close(self) -> None:
        """Nothing is open."""

    def comparison(self) -> Comparison:
        """How the commands written so far differ from those of the log."""
        if not self._differences:
            return Comparison(compared=0, largest=0.0, actuator="", time_s=float("nan"))
        table = np.array([row for _, row in self._differences])
        row, column = np.unravel_index(int(table.argmax()), table.shape)
        largest = float(table[row, column])
        tick = self._differences[int(row)][0]
        return Comparison(
            compared=len(table),
            largest=largest,
            actuator=self.actuator_names[int(column)] if largest > 0 else "",
            time_s=float(self.log.begin_s[tick] - self.log.begin_s[0]),
        )

    # ---- its own clock

    def check_same_run(self, rate_hz: float, plan: PlanMark | None) -> None:
        """See ``RecordedClock``: readings are those of the log's ticks and answer to its plan.

        A log of version 1 does not say which plan it is of, and none is refused.

        Raises:
            TaskError: Another rate, or another plan.
        """
        own = self.log.rate_hz
        if not math.isclose(rate_hz, own):
            raise TaskError(
                f"the log is of a loop at {own:g} Hz, and a rate of {rate_hz:g} Hz is asked for; "
                f"give {own:g} Hz: between its ticks there are no readings"
            )
        if plan is None or self.log.plan is None:
            return
        if said := self.log.plan.difference(plan):
            raise TaskError(f"the log is of {said}; give the plan that was driven")

    def now(self) -> float:
        """Time of the log, s."""
        return self._now

    def sleep_until(self, moment: float) -> None:
        """Go on to the next tick of the log, whenever that began."""
        self._i += 1
        later = moment if self._i >= len(self.log) else float(self.log.begin_s[self._i])
        self._now = max(self._now, later)
