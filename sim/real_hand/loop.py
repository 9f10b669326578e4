"""``LoopReport``: how a run of a loop went, in counts and times.

``ControlLoop``: reads a hand, asks a controller, writes its commands, at a fixed rate.

A tick, in this order: read; refuse readings that are broken, old or beyond a limit; ask the
controller; ask whether to stop; keep the command within its limits; write. What ``StopCause`` lists
ends the run with a report; an unforeseen error stops the hand too, and is raised. After an
emergency stop nothing is written (``sim.real_hand.safety``). After the last phase the hand holds
its last command. Phases of a trial: ``sim.real_hand.joints``.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from rich.console import Console, ConsoleOptions, RenderResult

from planner.arrays import checked_number, finite
from planner.errors import HandError, PlannerError, TaskError
from planner.hands.hand import Hand
from planner.spatial import FloatArray
from planner.system.threads import interrupts_wait
from sim.controllers.base import Controller, Phase
from sim.real_hand.interface import (
    Clock,
    EndOfReadings,
    HandInterface,
    HandObservation,
    Observer,
    Pace,
    PlanMark,
    RealClock,
    RecordedClock,
)
from sim.real_hand.log import LogWriter
from sim.real_hand.safety import CommandLimiter, CommandLimits, Guard, Safety, Stopped
from sim.screen import Report
from sim.tables import table_of

MICRO = 1e6

FORMAT = "opposable-loop-report"

VERSION = 1


@dataclass(frozen=True, kw_only=True)
class Times:
    """Times of the ticks of a loop, microseconds: median, 99 of 100, worst."""

    p50: float
    p99: float
    worst: float

    @classmethod
    def of(cls, seconds: FloatArray) -> Times:
        """Of times (m,) in s; NaN without any."""
        if not len(seconds):
            return cls(p50=np.nan, p99=np.nan, worst=np.nan)
        p50, p99 = np.percentile(seconds, (50, 99))
        return cls(p50=MICRO * p50, p99=MICRO * p99, worst=MICRO * float(seconds.max()))

    def __str__(self) -> str:
        """In words."""
        return f"{self.p50:.0f} / {self.p99:.0f} / {self.worst:.0f} us"


@dataclass(frozen=True, kw_only=True, repr=False)
class LoopReport(Report):
    """How a run went.

    Attributes:
        reason: "" where all phases are done; why it ended otherwise: a ``StopCause``, or "too few
            fingers touch", after which the hand holds its last command.
        detail: The same with numbers and names.
        on_stop: What was done at an emergency stop; "" where there was none.
        controller: Name of the controller.
        assumed: Senses for which planned values stood in.
        phases: Phases that were begun.
        rate_hz: Rate of the loop, Hz.
        duration_s: From the beginning of the first tick to the end of the last, s.
        ticks: How often the hand was read and a command found.
        written: How many commands were written.
        misses: Ticks that ended after their deadline.
        most_misses_in_a_row: Of these, the most one after the other.
        skipped: Slots in which no tick began.
        latency_us: From when a tick was due until its command was written, us.
        interface_cpu_us: CPU time per tick of reading and writing, us.
        controller_cpu_us: Of the controller.
        loop_cpu_us: Of the loop itself.
        oldest_reading_ms: Age of the oldest reading that was used, ms.
        repeated_readings: Ticks whose reading was that of the tick before.
        clamped: Actuator -> how often a wanted command lay outside its range; only those > 0.
        rate_limited: Actuator -> how often a wanted command was led to it more slowly.
        efforts_checked: Whether the hand reads efforts, so that their limit was checked.
    """

    reason: str
    detail: str
    on_stop: str
    controller: str
    assumed: tuple[str, ...]
    phases: tuple[str, ...]
    rate_hz: float
    duration_s: float
    ticks: int
    written: int
    misses: int
    most_misses_in_a_row: int
    skipped: int
    latency_us: Times
    interface_cpu_us: Times
    controller_cpu_us: Times
    loop_cpu_us: Times
    oldest_reading_ms: float
    repeated_readings: int
    clamped: Mapping[str, int]
    rate_limited: Mapping[str, int]
    efforts_checked: bool

    @property
    def success(self) -> bool:
        """Whether all phases were run to their end."""
        return not self.reason

    @property
    def done(self) -> bool:
        """The same."""
        return self.success

    @property
    def stopped(self) -> bool:
        """Whether it ended by an emergency stop."""
        return bool(self.on_stop)

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON; null for a number that is not there."""
        head = {"format": FORMAT, "version": VERSION, "done": self.done}
        data: dict[str, Any] = finite(head | asdict(self))
        return data

    def __str__(self) -> str:
        """The outcome in a line."""
        if self.done:
            return (
                f"done: {self.ticks} ticks at {self.rate_hz:g} Hz, {self.misses} deadlines missed"
            )
        after = f"; then: {self.on_stop}" if self.on_stop else "; it holds the last command"
        return f"ended: {self.reason}: {self.detail}{after}"

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """A table of the counts, for a terminal."""
        table = table_of(str(self), ("of the loop",), ("value",))
        missed = f"{self.misses} of {self.ticks}, at most {self.most_misses_in_a_row} in a row"
        for name, value in {
            "controller": self.controller,
            "phases": ", ".join(self.phases),
            "assumed instead of read": ", ".join(self.assumed) or "nothing",
            "rate, duration": f"{self.rate_hz:g} Hz, {self.duration_s:.2f} s",
            "commands written": str(self.written),
            "deadlines missed": missed,
            "slots skipped": str(self.skipped),
            "latency p50 / p99 / worst": str(self.latency_us),
            "CPU of the interface": str(self.interface_cpu_us),
            "CPU of the controller": str(self.controller_cpu_us),
            "CPU of the loop": str(self.loop_cpu_us),
            "oldest reading": f"{self.oldest_reading_ms:.1f} ms",
            "readings used again": str(self.repeated_readings),
            "clamped to the range": _counts(self.clamped),
            "limited in rate": _counts(self.rate_limited),
            "efforts": "checked" if self.efforts_checked else "not read, not checked",
        }.items():
            table.add_row(name, value)
        yield table


def _counts(counts: Mapping[str, int]) -> str:
    """The largest counts by name."""
    if not counts:
        return "none"
    first = sorted(counts, key=counts.__getitem__, reverse=True)[:3]
    more = f", {len(counts) - len(first)} more" if len(counts) > len(first) else ""
    return ", ".join(f"{name} {counts[name]}" for name in first) + more


Carry = Callable[[Phase, float, float], None]
"""Moves the hand as a whole, or tells who does: phase, share of it that has passed in [0, 1], and
how fast that share grows, per second. Called in every tick, before the controller."""

TOO_FEW = "too few fingers touch"
"""Why a run ends before the lift without an emergency."""

RATE_TOL = 1e-9
"""Relative excess of a rate that is rounding."""


class _Left(Exception):
    """A phase is not run; no emergency."""


@contextmanager
def _of_interface(doing: str) -> Iterator[None]:
    """What is done with an interface, whose failure stops the run."""
    try:
        yield
    except EndOfReadings as error:
        raise Stopped("no more readings", str(error)) from error
    except (PlannerError, OSError) as error:
        raise Stopped("interface failed", f"{doing}: {error}") from error


class ControlLoop:
    """One run of one controller on one hand.

    Attributes:
        interface: The hand.
        controller: What drives it.
        pace: Slots and misses.
        log: Every tick so far.
    """

    def __init__(
        self,
        interface: HandInterface,
        controller: Controller,
        hand: Hand,
        observer: Observer,
        *,
        rate_hz: float,
        clock: Clock | None = None,
        limits: CommandLimits | None = None,
        safety: Safety | None = None,
        carry: Carry | None = None,
        keep_log: bool = True,
    ) -> None:
        """Prepare; nothing is read or written yet.

        Args:
            interface: The hand.
            controller: What drives it.
            hand: Its model.
            observer: What turns its readings into observations.
            rate_hz: Rate, Hz.
            clock: Tells the time and waits; the system's monotonic clock if None.
            limits: How far and how fast commands may move; defaults if None.
            safety: What ends the run at once; defaults if None.
            carry: Moves the hand as a whole; nobody if None.
            keep_log: Whether every tick is kept in ``log``, about 3 kB each.

        Raises:
            TaskError: A rate above that of the interface, limits that fit no actuator, or a log of
                another plan or rate.
            NotFoundError: Limits for an actuator that there is not.
        """
        checked_number("the rate", rate_hz, above=0.0, error=TaskError)
        plan = None if observer.plan is None else PlanMark.of(observer.plan)
        if isinstance(clock, RecordedClock):
            clock.check_same_run(rate_hz, plan)
        if rate_hz > interface.rate_hz * (1.0 + RATE_TOL):
            raise TaskError(
                f"a rate of {rate_hz:g} Hz is asked for; this hand can be read and written at "
                f"{interface.rate_hz:g} Hz at most"
            )
        self.interface, self.controller = interface, controller
        self._hand, self._observer = hand, observer
        self._rate_hz = rate_hz
        self._clock = clock or RealClock()
        self._limits, self._safety = limits or CommandLimits(), safety or Safety()
        self._limits.rates(hand.actuation)  # bad limits end here
        self._carry, self._keep_log = carry, keep_log
        self.pace = Pace(self._clock, 1.0 / rate_hz)
        names = interface.joint_names, interface.actuator_names
        self.log = LogWriter(*names, interface.finger_names, rate_hz, plan)
        self._guard = Guard(self._safety, hand, *names, len(interface.finger_names))
        self._limiter: CommandLimiter | None = None
        self._to_interface = np.argsort(observer.actuators)
        self._phases: list[str] = []
        self._spans: list[tuple[float, float, float]] = []
        self._ticks = self._written = self._repeated = 0
        self._oldest = 0.0
        self._last_time = np.nan
        self._efforts = False
        self._reason = self._detail = self._did = ""

    def run(self, phases: Callable[[ControlLoop], object]) -> LoopReport:
        """Run some phases to their end, or to what ends them before.

        Args:
            phases: Calls ``phase`` for one phase after the other.

        Returns:
            What happened.

        Raises:
            HandError: The hand lacks a sense that the controller needs. Nothing was written.
        """
        if self._ticks:
            raise TaskError("this loop has run; make a new one to run again")
        ended = False
        try:
            phases(self)
            self.pace.rest()
            ended = True
        except _Left as left:
            self._reason, self._detail = TOO_FEW, str(left)
            ended = True
        except HandError:  # refused: a hand that was not written is left as it is
            ended = self._written == 0
            raise
        except Stopped as stopped:
            self._reason, self._detail = stopped.cause, stopped.detail
        except KeyboardInterrupt:
            self._reason, self._detail = "interrupted", "Ctrl-C"
        finally:  # an error that nobody foresaw stops the hand too
            if not ended:
                self._stop()
        return self.report()

    def phase(
        self,
        phase: Phase,
        duration: float,
        *,
        wait: float = 0.0,
        until: Callable[[HandObservation], bool] | None = None,
        refuse: Callable[[HandObservation], str] | None = None,
    ) -> HandObservation:
        """Run one phase.

        Args:
            phase: What the controller is told.
            duration: Nominal duration, s; at least one tick is made.
            wait: Longest further time, s.
            until: Whether the phase may end once ``duration`` is over; at once if None.
            refuse: Asked with the first observation, before anything is written: why the phase is
                not to be run, "" if it may be.

        Returns:
            The last observation.

        Raises:
            Stopped: The run ends here.
        """
        self._phases.append(phase)
        period = self.pace.period
        steps = max(1, round(duration / period))
        most = max(steps, round((duration + wait) / period))
        first = self.pace.slot
        while True:
            k = self.pace.slot - first
            progress = min(1.0, k / steps)
            observation = self._tick(phase, progress, 1.0 / (steps * period), refuse)
            refuse = None
            done = self.pace.slot - first
            if done >= most or (done >= steps and (until is None or until(observation))):
                return observation

    def _tick(
        self,
        phase: Phase,
        progress: float,
        per_second: float,
        refuse: Callable[[HandObservation], str] | None,
    ) -> HandObservation:
        begin = self.pace.begin()
        cpu = [time.thread_time()]
        with _of_interface("reading"):
            reading = self.interface.read()
        cpu.append(time.thread_time())
        self._guard.check(reading, self._clock.now())
        self._oldest = max(self._oldest, self._clock.now() - reading.time)
        self._repeated += reading.time == self._last_time
        self._last_time = reading.time
        observation = self._observer.observe(reading, phase, progress)
        if refuse is not None and (why := refuse(observation)):
            raise _Left(why)
        if self._carry is not None:
            with _of_interface("moving the hand as a whole"):
                self._carry(phase, progress, per_second)
        if self._limiter is None:
            self._observer.check_senses(self.controller, reading)
            self._efforts = reading.efforts is not None
            self._limiter = CommandLimiter(
                self._limits,
                self._hand.actuation,
                self.pace.period,
                observation.q,
            )
        cpu.append(time.thread_time())
        wanted = self._wanted(observation)
        cpu.append(time.thread_time())
        if self._safety.stop is not None and self._safety.stop():
            raise Stopped("asked", "the caller asked for it")
        with interrupts_wait():  # what was written and what is noted of it stay one
            now = self._clock.now()
            commands = self._limiter.step(wanted, now)[self._to_interface]
            cpu.append(time.thread_time())
            written = False
            try:
                with _of_interface("writing"):
                    self.interface.write(commands)
                written = True
            finally:
                self._ticks += 1
                self._written += written
                if self._keep_log:
                    self.log.add(
                        reading,
                        phase=phase,
                        progress=progress,
                        begin_s=begin,
                        write_s=now,
                        end_s=self._clock.now(),
                        wanted=wanted[self._to_interface],
                        commands=commands if written else None,
                    )
                self._note_cpu(cpu)
        self.pace.end()
        if self.pace.in_a_row >= self._safety.misses_in_a_row:
            raise Stopped(
                "deadline misses",
                f"{self.pace.in_a_row} in a row at {self._rate_hz:g} Hz; give a lower rate, or "
                "free the machine",
            )
        return observation

    def _note_cpu(self, cpu: list[float]) -> None:
        """Note the CPU time of interface, controller and the rest, s."""
        begin, read, ready, found, limited = cpu
        end = time.thread_time()
        interface = (read - begin) + (end - limited)
        self._spans.append((interface, found - ready, (ready - read) + (limited - found)))

    def _wanted(self, observation: HandObservation) -> FloatArray:
        """What the controller wants (nu,), order of the hand."""
        try:
            wanted = np.asarray(self.controller.step(observation), dtype=np.float64)
        except PlannerError as error:
            raise Stopped("bad command", f"the controller failed: {error}") from error
        shape = (len(self._hand.actuation.names),)
        if wanted.shape != shape:
            raise Stopped(
                "bad command",
                f"the controller returned commands of shape {wanted.shape}; the hand needs {shape}",
            )
        if not np.isfinite(wanted).all():
            name = self._hand.actuation.names[int(np.argmin(np.isfinite(wanted)))]
            raise Stopped("bad command", f"the controller's command for {name} is not finite")
        return wanted

    def _stop(self) -> None:
        """Do what is to be done at an emergency stop; nothing is written from now on."""
        with interrupts_wait():
            self._did = self._safety.on_stop
            if self._safety.on_stop == "torque off":
                try:
                    self.interface.stop()
                except (PlannerError, OSError) as error:
                    self._did = "torque off FAILED"
                    self._detail += f"; the torque could not be taken off ({error}): cut the power"

    def report(self) -> LoopReport:
        """What happened so far."""
        spans = np.array(self._spans).reshape(-1, 3).T
        names = self._hand.actuation.names
        limiter, zero = self._limiter, np.zeros(len(names), dtype=np.int64)
        clamped, limited = (zero, zero) if limiter is None else (limiter.clamped, limiter.limited)
        return LoopReport(
            reason=self._reason,
            detail=self._detail,
            on_stop=self._did,
            controller=type(self.controller).__name__,
            assumed=self._observer.assume,
            phases=tuple(self._phases),
            rate_hz=self._rate_hz,
            duration_s=self.pace.duration,
            ticks=self._ticks,
            written=self._written,
            misses=self.pace.misses,
            most_misses_in_a_row=self.pace.most_in_a_row,
            skipped=self.pace.skipped,
            latency_us=Times.of(self.pace.latencies),
            interface_cpu_us=Times.of(spans[0]),
            controller_cpu_us=Times.of(spans[1]),
            loop_cpu_us=Times.of(spans[2]),
            oldest_reading_ms=1e3 * self._oldest,
            repeated_readings=self._repeated,
            clamped={n: int(c) for n, c in zip(names, clamped, strict=True) if c},
            rate_limited={n: int(c) for n, c in zip(names, limited, strict=True) if c},
            efforts_checked=self._efforts,
        )
