"""``UseTrial``: grasp a tool, use it, put it back in the air, and judge.

The same trial as of any grasp up to the squeeze. Then the support releases the tool; the hand
brings its tip to the fixture ("engage"), uses it ("use"), takes it away ("withdraw") and holds it.
The closed loop of ``ObjectImpedance`` keeps the tool in the palm: it gives what the use loads it
with by the force programme by which the plan was proven, and grips as the plan does for the needed
wrenches.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Unpack
from weakref import proxy

import numpy as np
from numpy.typing import NDArray

from planner.arrays import checked_kind, checked_number
from planner.errors import NoGraspFoundError, TaskError
from planner.failure import Failure
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.motion.phase import ToolUse
from planner.motion.plan import ManipulationPlan
from planner.motion.tool_use import with_use
from planner.plan import GraspPlan
from planner.search.grasp import Attempt
from planner.shapes.registry import shape_key
from planner.spatial import SE3, FloatArray, IntArray, signed_twist
from planner.task import GraspTask
from planner.tools import Tool, load_tool, plan_use, use_data, use_task
from sim.controllers import PHASES, Observation, Phase
from sim.controllers.base import PadReading
from sim.controllers.impedance import ImpedanceLaw
from sim.controllers.object_impedance import ObjectImpedance
from sim.manipulation.machine import PhaseCall, StateMachine
from sim.manipulation.timeline import CONTROLLER_PHASE, Measured
from sim.recorder import Recorder
from sim.report import FingerComparison, TrialReport
from sim.scene.carrier import Timeline, carrier_of
from sim.scene.gantry import GANTRY_FREQUENCY, Gantry
from sim.scene.physics import PhysicsOptions
from sim.simulation import Simulation
from sim.tools.use import DOWN, OwnFinger, Use, needs_gantry, use_of
from sim.trial import Trial, TrialKeywords, TrialOptions, run_grasp_phase, why_not_lifted
from sim.verdict import (
    Fault,
    Thresholds,
    Verdict,
    ended_early,
    fault_at,
    first_collision,
    first_fault,
    no_contact,
    tipped,
)

__all__ = ["UseTimeline", "UseTrial", "plan_tool"]

MOST_RESIST = 100.0
"""Largest factor on a fixture's friction (-): more is a fixture that never moves."""

SAME_WAY = 1e-4
"""How far (rad, m, -) a planned way may be from the one that its grasp gives again: rounding, which
inverse kinematics magnifies."""

SAME_POSE = 1e-6
"""How far entries of two poses (-, m) may differ that are one: a plan file rounds."""

USING: tuple[Phase, ...] = ("engage", "use", "withdraw")
"""Phases between the squeeze and the hold."""

YIELDING = 0.3
"""Time constant (s) with which a tool that its fixture guides is wanted where it is, across the
axis: slow beside the fingers, fast beside a turn. A tool that was 4 mm away at the end of the use
was thrown by the spring when the fixture let it go."""

GONE = 0.05
"""Time (s) without any contact after which the tool is out of the hand: a blow shakes fingers
off it for single time steps."""

USE_THRESHOLDS = Thresholds(slip_mm=10.0, slip_deg=10.0)
"""Where the use of a tool ends to be one: by as much may it move in the hand."""


@dataclass(frozen=True, kw_only=True)
class UseTimeline(Timeline):
    """How long each phase takes, in s; how long a use may take is its own.

    Attributes:
        engage: The tip to the fixture.
        withdraw: Away from it.
    """

    engage: float = 2.0
    withdraw: float = 1.0
    hold: float = 0.5

    @property
    def duration(self) -> float:
        """Nominal duration without waiting and without the use, s."""
        phases = (*PHASES[:4], "engage", "withdraw", "hold")
        return float(sum(getattr(self, phase) for phase in phases))


class GuidedLoad:
    """What a hand gives a tool that a fixture guides: the push as planned, a torque as learned.

    All that a loop would learn beside the torque about the axis grows against the fixture. By the
    fingers a Shadow-type hand tilted a screwdriver by 4 degrees within 5 strokes, and could not
    lift its thumb; by the wrist it came to give 8 N down and up in turn, where 3 N push.
    """

    def __init__(self, plan: GraspPlan, *, share: float) -> None:
        """Begin with a share (-) of the torque that the plan needs.

        All is in the base's axes: they go around the fixture's axis with the tool.
        """
        each = [-plan.task.needed_load(one) for one in plan.task.needed]
        needed = max(each, key=lambda wrench: abs(float(wrench[3:] @ DOWN)))  # the one that turns
        turn = plan.T_world_base.rotation
        self._push, self._about = needed[:3] @ turn, -DOWN @ turn
        self._torque = share * float(needed[3:] @ -DOWN)

    def give(self) -> FloatArray:
        """Wrench (6,), N and N m."""
        return np.concatenate([self._push, self._torque * self._about])

    def take(self, learned: FloatArray) -> None:
        """Keep of a learned wrench (6,) the torque about the axis."""
        self._torque = float(learned[3:] @ self._about)


class UseController(ObjectImpedance):
    """Keeps the tool where it lies in the palm, whatever loads it: a ``Controller``.

    It learns while the wrist turns, too: what a socket resists with is about the axis of the turn.
    Learned only before and after it, the load of a lid turned it by 17 degrees in the fingertips.
    What was learned is forgotten when the tool is taken out of its fixture: it would throw it.
    Where the fixture guides the tool, see ``GuidedLoad``.
    """

    turning_time: ClassVar[float] = 0.0

    def __init__(
        self,
        plan: GraspPlan,
        *,
        learns: bool = True,
        guided: bool = False,
        finger: OwnFinger | None = None,
    ) -> None:
        """Note how hard the fingers press in the plan while the needed wrenches are produced.

        Args:
            plan: What to execute.
            learns: Whether a lasting load is learned; blows are none.
            guided: Whether the fixture guides the tool.
            finger: What drives a finger that does not hold; None where all do.
        """
        super().__init__(plan)
        if not learns:
            self.law = ImpedanceLaw(replace(self.law.gains, learning_rate=0.0))
        self._before_use: FloatArray | None = None
        self._learns = learns
        self._finger = finger
        self._guided = GuidedLoad(plan, share=0.0) if guided else None
        pressed = [float(found.forces[:, 0].mean()) for found in plan.needed]
        self._firm = max([self.grip, *pressed])

    def step(self, observation: Observation) -> FloatArray:
        """Commands (nu,) for the hand's actuators."""
        own, guided = None, self._guided if observation.phase == "use" else None
        since = self._time
        if self._finger is not None and observation.phase in (*USING, "hold"):
            before = self._finger.load
            own = self._finger.step(observation)
            self.law.load = self.law.load + self._finger.load - before
        if observation.phase in USING:
            self.grip = self._firm
            if not self._learns:
                self.schedule.lost_time = GONE
            turn = observation.T_world_base.rotation  # the load is in base axes, and the base turns
            if observation.phase == "use":
                if self._before_use is None:
                    self._before_use = self.law.load.reshape(2, 3) @ turn.T
                if guided is not None:
                    self.law.load = guided.give()
            if observation.phase == "withdraw" and self._before_use is not None:
                self.law.load, self._before_use = (self._before_use @ turn).ravel(), None
            observation = observation.altered(phase="hold")
        ctrl = super().step(observation)
        if guided is not None:
            guided.take(self.law.load)
            self._yield_to_fixture(observation, observation.time - since)
        if own is None or self._finger is None:
            return ctrl
        return np.where(self._finger.actuators, own, ctrl)

    def _tighten(self, elapsed: float, pads: PadReading) -> None:
        """Answer to slips, but not to those of a blow.

        A blow makes every pad slide for milliseconds, whatever its friction: believed to be 0.1
        where it was 0.77, and with three times the grip, the forces were none of the actuators'.
        """
        if self._learns:
            super()._tighten(elapsed, pads)

    def _given(self, pads: PadReading) -> FloatArray:
        """Contact forces (n, 3) that the fingers are to give, contact frames, N.

        In a blow no more along the surface than the normal force that is felt bears: a finger off
        the tool that gives the rest runs aside.
        """
        forces = super()._given(pads)
        if self._learns:
            return forces
        along = np.linalg.norm(forces[:, 1:], axis=1, keepdims=True)
        most = (self._mu * pads.normal_force)[:, None]
        share = np.divide(most, along, out=np.ones_like(along), where=along > most)
        return np.hstack([forces[:, :1], share * forces[:, 1:]])

    def _yield_to_fixture(self, observation: Observation, elapsed: float) -> None:
        """Want the tool as far from the axis as the fixture has it."""
        assert self.T_palm_wanted is not None
        T_world_palm = observation.T_world_base * self._torques.T_base_palm
        in_palm = T_world_palm.actInv(observation.T_world_object)
        along = T_world_palm.rotation.T @ DOWN
        wanted = self.T_palm_wanted.translation
        off = in_palm.translation - wanted
        place = wanted + elapsed / YIELDING * (off - (off @ along) * along)
        self.T_palm_wanted = SE3(self.T_palm_wanted.rotation, place)


class UseCarrier:
    """Moves the gantry: as in a trial up to the squeeze, then as the use wants it."""

    def __init__(self, trial: UseTrial, gantry: Gantry, timeline: Timeline) -> None:
        """Note what is moved."""
        self._trial, self._gantry = proxy(trial), gantry  # which holds this, by its simulation
        self._grasping = carrier_of(trial.plan, trial.simulation.scene, timeline)
        self._target, self._velocity = np.zeros((2, 6))
        self.done = False

    def begin(self, data: Any) -> None:
        """A phase begins where the hand is: there its targets begin too."""
        self._target, self.done = data.qpos[self._gantry.qpos].copy(), False
        self._velocity = np.zeros(6)

    def drive(self, data: Any, phase: Phase, share: float) -> None:
        """Set the gantry's commands."""
        if phase in PHASES[:4]:
            self._grasping.drive(data, phase, share)
            return
        gantry, simulation = self._gantry, self._trial.simulation
        wanted = self._trial.use.motion(simulation, phase, share)
        self.done = wanted.done
        target = gantry.coordinates(wanted.T_world_base)
        target[3:] += 2 * np.pi * np.round((self._target[3:] - target[3:]) / (2 * np.pi))
        velocity = (target - self._target) / simulation.timestep
        before, self._velocity = self._velocity, velocity
        self._target, target = target, target.copy()
        if not self._trial.use.lasting:  # a blow: what accelerates the carried mass, too
            target += (velocity - before) / simulation.timestep / GANTRY_FREQUENCY**2
        if wanted.push is not None:  # a force in place of a height, damped as the servo is
            force = np.array([0.0, 0.0, -wanted.push])
            lever = self._trial.use.mouth - simulation.T_world_base.translation
            target[2], velocity[2] = data.qpos[gantry.qpos[2]], 0.0
            self._target[2] = target[2]  # the height that the next command begins at
            load = np.concatenate([force, np.cross(lever, force)])
            target += load / gantry.gains[0]  # its moment too, or the hand would tilt
        data.ctrl[gantry.ctrl] = gantry.command(data, target, velocity)


class UseRecorder(Recorder):
    """Takes what the use measures with every sample."""

    def __init__(self, simulation: Simulation, every: float, use: Use) -> None:
        super().__init__(simulation, every)
        self._use = use
        self.measured: list[dict[str, float]] = []

    def record(self) -> None:
        """Take a sample of now."""
        super().record()
        self.measured.append(self._use.measure(self._simulation))

    def seen(self) -> dict[str, FloatArray]:
        """What was measured, (m,) each."""
        return {name: np.array([row[name] for row in self.measured]) for name in self._use.channels}


class UseTrial(Trial):
    """One use of a tool.

    Attributes:
        movement: What is executed; ``plan`` is its grasp.
        use: What is done with the tool.
        results: The phases that were run, in order.
    """

    def __init__(
        self,
        movement: ManipulationPlan,
        options: TrialOptions | None = None,
        *,
        friction: float = 1.0,
        **changes: Unpack[TrialKeywords],
    ) -> None:
        """Build the scene with the fixture, and put hand and tool at their start.

        Args:
            movement: The use of a tool, from ``plan_tool`` or a file.
            options: Under which conditions; defaults if None.
            friction: Factor on the dry friction of the fixture that the plan does not know (-).
            changes: Fields of ``TrialOptions`` by name that are to be others.

        Raises:
            TaskError: The plan uses no tool, its hand is on an arm, its grasp is none where the use
                offers the tool, its way not that of the use, the factor out of range, or a
                controller, a truth or a timeline is given that is none of a use.
            PlannerError: As ``Trial``.
        """
        asked = replace(options or TrialOptions(), **changes)
        plan = checked_kind("movement", movement, ManipulationPlan).grasp
        if movement.tool is None:
            raise TaskError(
                f"{movement!r} uses no tool; give what plan_tool or plan_fingers returns"
            )
        needs_gantry(plan.task)
        self.movement, self.use = movement, use_of(movement.tool)
        self.use.yaw = yaw_of_plan(plan, self.use)
        if movement.tool_use is not None:
            _check_way(movement.tool_use, self.use.planned(plan), movement.tool.name)
        self.use.friction = checked_number(
            "friction", friction, least=0.0, most=MOST_RESIST, error=TaskError
        )
        if asked.truth is not None or asked.controller is not None:
            raise TaskError("a tool is known, and its use has its own controller; give neither")
        timeline = asked.timeline or UseTimeline()
        if not isinstance(timeline, UseTimeline):
            raise TaskError("a use has other phases than a trial; give a UseTimeline")
        super().__init__(
            plan,
            replace(
                asked,
                timeline=timeline,
                controller=UseController(
                    plan,
                    learns=self.use.lasting,
                    guided=self.use.guided,
                    finger=self.use.finger(plan),
                ),
                thresholds=asked.thresholds or USE_THRESHOLDS,
            ),
        )
        gantry = self.simulation.scene.gantry
        assert gantry is not None
        self.carrier = UseCarrier(self, gantry, timeline)
        self.simulation.carrier = self.carrier
        self.recorder: UseRecorder = UseRecorder(self.simulation, asked.record_every, self.use)

    def _surroundings(self) -> Callable[[Any], None]:
        """Adds the fixture to the scene."""

        def change(spec: Any) -> None:
            self.use.add_fixture(spec, self._physics, self.use.yaw)

        return change

    def perform(self) -> None:
        """Run all phases, or up to the one after which going on makes no sense."""
        machine = StateMachine(self.movement)
        self.run_phases(machine.run(self._perform, lambda: self.simulation.time))

    def _perform(self, call: PhaseCall) -> Measured:
        """Run a phase; why it failed, "" if it did not, and its numbers."""
        phase, simulation = CONTROLLER_PHASE[call.phase], self.simulation
        if call.phase == "stand":  # hand and tool are where they begin
            return "", {}
        if phase in (*USING, "hold"):
            return self._run(phase), self.in_hand()
        going_on = run_grasp_phase(simulation, self.recorder, self.timeline, phase)
        if phase != "settle" or not going_on:
            return "" if going_on else simulation.why_ended or why_not_lifted(simulation), {}
        self.not_lifted = why_not_lifted(simulation)
        if self.not_lifted:
            self.recorder.record()
        else:
            simulation.scene.release(simulation.data)
        return self.not_lifted, {}

    def _comparison(self) -> tuple[FingerComparison, ...]:
        """None: the fingers press as the needed wrenches ask, not as the plan does to hold."""
        return ()

    def _moment(self, report: TrialReport) -> float | None:
        """Where it went wrong, or the end of the use: afterwards the tool is in the air."""
        samples, wrong = report.samples, super()._moment(report)
        if wrong is not None or "use" not in samples.phase:
            return wrong
        return float(samples.time[samples.during("use")][-1])

    def _run(self, phase: Phase) -> str:
        """Run a phase of the use; why going on makes no sense, "" if it does."""
        simulation, use = self.simulation, self.use
        use.begin(simulation, phase)
        duration = use.duration if phase == "use" else getattr(self.timeline, phase)
        self.carrier.begin(simulation.data)
        gone = 0.0
        for _ in simulation.run(phase, duration):
            if simulation.due(self.recorder.every):
                self.recorder.record()
            gone = 0.0 if simulation.touching() else gone + simulation.timestep
            if gone >= GONE:
                self.recorder.record()
                return "nothing of the hand touches the tool"
            if phase == "use" and self.carrier.done:
                break
        if simulation.ended:
            return simulation.why_ended
        return "" if simulation.touching() else "nothing of the hand touches the tool"

    def _verdict(self, compared: tuple[FingerComparison, ...], interrupted: bool) -> Verdict:
        """The verdict on a use: the object held, and the use done."""
        samples, simulation, task = self.recorder.samples(), self.simulation, self.plan.task
        early = ended_early(
            samples,
            interrupted=interrupted,
            stopped=simulation.stopped,
            diverged=simulation.diverged,
        )
        limits = self.thresholds
        phase = np.array(samples.phase)
        using = np.isin(phase, (*USING, "hold"))
        touching = (samples.contacts > 0).sum(axis=1)
        loose = _last_run(using & (touching < task.fingers_needed))
        far = (samples.slip_mm > limits.slip_mm) | (samples.slip_deg > limits.slip_deg)
        slipped = np.flatnonzero(using & far)
        faults: list[Fault | None] = []
        if len(loose):
            i = int(loose[0])
            detail = f"{touching[i]} fingers touched the tool, in phase {phase[i]}"
            faults.append(fault_at(samples, i, "dropped", detail))
        if len(slipped):
            i = int(slipped[0])
            detail = (
                f"the tool moved {samples.slip_mm[i]:.1f} mm and {samples.slip_deg[i]:.1f} degrees "
                f"in the hand, in phase {phase[i]}"
            )
            faults.append(fault_at(samples, i, "slipped", detail))
        if early is not None and not (faults and early.reason == "diverged"):
            return Verdict(early)  # a simulation that diverges after the tool is lost: it was lost
        faults += [
            first_collision(
                samples.time, samples.collision_N, samples.collision, limits.collision_N
            ),
            tipped(samples, limits),
            no_contact(samples, task.finger_names, task.fingers_needed),
        ]
        faults += [
            Fault(reason=reason, detail=detail, time=time)
            for time, reason, detail in self.use.faults(
                samples.time, samples.phase, self.recorder.seen()
            )
        ]
        found = [fault for fault in faults if fault is not None]
        if found:
            return Verdict(first_fault(found, samples, limits))
        if not len(samples.during("hold")):
            detail = self.not_lifted or "it never came to its use"
            return Verdict(fault_at(samples, len(samples) - 1, "no contact", detail))
        return Verdict()

    def _report(
        self, verdict: Verdict, begin: float, compared: tuple[FingerComparison, ...] = ()
    ) -> TrialReport:
        report = super()._report(verdict, begin, compared)
        tool, seen = self.use.tool, self.recorder.seen()
        used = "use" in report.samples.phase
        summary = self.use.summary(seen) if used else "it never came to its use"
        return replace(
            report,
            object=tool.name,
            use={
                "tool": tool.name,
                "kind": use_data(tool).kind,
                "summary": summary,
                "yaw_rad": self.use.yaw,
                "friction_factor": self.use.friction,
                "numbers": dict(self.use.numbers),
                "needed_margin": self.plan.task.needed_margin,
                "titles": dict(self.use.channels),
                "channels": {name: values.tolist() for name, values in seen.items()},
            },
        )


def _check_way(told: ToolUse, true: ToolUse, name: str) -> None:
    """Refuse a use whose way is not the one that its tool and grasp give.

    Raises:
        TaskError: It is another.
    """
    ways = [
        np.array([pose.homogeneous for pose in one.way]).reshape(-1, 4, 4) for one in (told, true)
    ]
    same = told.finger == true.finger and all(
        a.shape == b.shape and np.allclose(a, b, rtol=0.0, atol=SAME_WAY)
        for a, b in (ways, (told.postures, true.postures))
    )
    if not same:
        raise TaskError(
            f"the way in the plan is not that of the use of {name} in this grasp; plan again"
        )


def _last_run(bad: NDArray[np.bool_]) -> IntArray:
    """Numbers of the samples from which on it stays bad to the end; none where it ends well."""
    good = np.flatnonzero(~bad)
    return np.arange(int(good[-1]) + 1 if len(good) else 0, len(bad))


def yaw_of_plan(plan: GraspPlan, use: Use) -> float:
    """Turn (rad) about the vertical with which a grasp was planned for a use.

    Raises:
        TaskError: It was planned for another tool, or for one that is offered elsewhere.
    """
    tool, task = use.tool, plan.task
    for what, planned, given in (
        ("object", task.object.name, tool.name),
        ("shape", shape_key(task.object.shape), shape_key(tool.shape)),
        ("needed wrenches", task.needed, tool.needed),
    ):
        if planned != given:
            raise TaskError(
                f"the plan is of {task.object.name}, whose {what} is not that of {tool.name}; give "
                "a plan of plan_tool for this tool"
            )
    turn = task.T_world_object.rotation @ use.offered().rotation.T
    yaw = signed_twist(turn, -DOWN)
    off = task.T_world_object.inverse() * use.offered(yaw)
    far = np.abs(off.homogeneous - np.eye(4)).max()
    if far > SAME_POSE:
        raise TaskError(
            f"the plan grasps {tool.name} at {task.T_world_object.translation}, not upright at "
            f"{use.offered(yaw).translation} m, where its use offers it; give a plan of plan_tool"
        )
    return yaw


def task_of_use(
    hand: Any, tool: Tool, *, yaw: float = 0.0, **changes: Any
) -> tuple[GraspTask, Use]:
    """The task of grasping a tool where its use offers it, and the use.

    Raises:
        PlannerError: As ``use_of``, ``needs_gantry`` and ``planner.tools.use_task``.
    """
    use = use_of(tool)
    use.yaw = yaw = checked_number("yaw", yaw, unit="rad", error=TaskError)
    hand = hand if isinstance(hand, Hand) else load_hand(hand)
    if (holding := use.holding_fingers(hand, changes.get("fingers"))) is not None:
        changes["fingers"] = holding
    task = use_task(hand, tool, use.offered(yaw), obstacles=use.obstacles, **changes)
    needs_gantry(task)
    return task, use


def rehearsed(plan: GraspPlan, tool: Tool) -> float | Failure:
    """How far a use brings a grasp to the limits of slip, under the friction that it relies on.

    Nothing of a later trial is known: friction of hand and fixture are those of the plan and of the
    tool's file.

    Args:
        plan: A grasp of the tool.
        tool: The tool.

    Returns:
        Movement of the tool in the hand as a share (-) of what ``USE_THRESHOLDS`` allow, the larger
        one of distance and angle; or what the use fails by.

    Raises:
        KeyboardInterrupt: It was interrupted.
    """
    movement = with_use(plan, use_of(tool).planned(plan))
    if isinstance(movement, Failure):
        return movement
    trial = UseTrial(movement, physics=PhysicsOptions(name="relied on", mu=plan.task.mu))
    most = 0.0

    def watch(simulation: Simulation) -> None:
        nonlocal most
        if simulation.phase in (*USING, "hold") and simulation.due(trial.recorder.every):
            slip_mm, slip_deg = trial.recorder.slip()
            limits = trial.thresholds
            most = max(most, slip_mm / limits.slip_mm, slip_deg / limits.slip_deg)
            if most > 1.0:
                simulation.stop(f"the tool moved by {slip_mm:.1f} mm, {slip_deg:.1f} degrees")

    report = trial.run(on_step=watch)
    if report.success:
        return most
    if report.reason == "interrupted":
        raise KeyboardInterrupt
    why = trial.simulation.stopped or f"{report.reason}, {report.verdict.detail}"
    text = f"in a rehearsal of the use, with friction {plan.task.mu:g}: {why}"
    return Failure(kind="use_rehearsal", text=text)


MOST_ATTEMPTS = 300
"""Attempts before no grasp for a use is found: one for a lever takes 19 to 117 of some 0.2 s."""


def plan_tool(
    hand: Any,
    tool: Tool | str | Path,
    *,
    seed: int = 0,
    max_attempts: int = MOST_ATTEMPTS,
    yaw: float = 0.0,
    progress: Callable[[Attempt[GraspPlan]], object] | None = None,
    rehearse: bool = True,
    **changes: Any,
) -> ManipulationPlan:
    """The use of a tool: a grasp with the needed wrenches with margin, and a way that is free.

    Where proven margins do not tell whether the tool stays in the hand (``Use.rehearsed``), the use
    is tried with every grasp, see ``rehearsed``.

    Args:
        hand: A hand, its name, or the path of its description.
        tool: A tool, its name, or the path of its file.
        seed: Same seed, same plan.
        max_attempts: Budget in attempts.
        yaw: Turn of tool and fixture about the vertical, rad.
        progress: Called after every attempt.
        rehearse: False takes a grasp without trying its use.
        changes: Further arguments of ``GraspTask.create``.

    Raises:
        PlannerError: No such hand, tool or kind of use; a wrench that the hand cannot produce; or
            no grasp in the budget, with the needed wrench and the limit that ended it.
    """
    tool = load_tool(tool)
    task, use = task_of_use(hand, tool, yaw=yaw, **changes)
    grasp = plan_use(
        task,
        use.way,
        seed=seed,
        max_attempts=max_attempts,
        progress=progress,
        best_of=use.best_of,
        fit=use.fitting(),
        gives_way=use.gives_way,
        rehearse=(lambda plan: rehearsed(plan, tool)) if rehearse and use.rehearsed else None,
    )
    found = with_use(grasp, use.planned(grasp))
    if isinstance(found, Failure):
        raise NoGraspFoundError(f"the grasp of {tool.name} is none for its use: {found}", ())
    return found
