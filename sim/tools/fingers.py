"""``FingersTrial``: a tool is turned by the fingers alone; ``use_tool``: by fingers or wrist.

The palm stands still above the tool, whose tip is in its fixture from the beginning. The movement
is a gait (``planner.motion.tool_gait``), executed by the phases and the state machine of a
manipulation, which neither lifts nor puts down here; scene, verdict, report and page are those of
every use. The support lets go when the fingers press.

In a stroke the hand gives what the use needs and goes on learning it: the push along the axis and
the torque against friction. While a finger moves on it gives none of it, since dry friction holds
the tool still, and bears the weight alone.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, TypeAlias, Unpack

import numpy as np

from planner.errors import NotFoundError, TaskError
from planner.failure import Failure
from planner.motion.gait import MAX_ATTEMPTS, plan_others
from planner.motion.phase import Ending, Relocation
from planner.motion.plan import ManipulationPlan
from planner.motion.tool_gait import plan_tool_gait, verify_tool_gait
from planner.motion.verify import ASKED_SHARE
from planner.plan import GraspPlan
from planner.spatial import FloatArray
from planner.tools import Tool, load_tool, use_data
from sim.controllers import Observation
from sim.controllers.object_impedance import ObjectImpedance
from sim.manipulation.driver import ManipulationDriver
from sim.manipulation.log import force_limit
from sim.manipulation.machine import PhaseCall, StateMachine
from sim.manipulation.phases import Phases
from sim.manipulation.simulation import ManipulationOptions, ManipulationSim
from sim.manipulation.timeline import Measured, SuccessCriteria
from sim.report import FingerComparison, TrialReport
from sim.tools.trial import GuidedLoad, UseRecorder, UseTrial, plan_tool, task_of_use
from sim.tools.turn import HINGE, Turn
from sim.tools.use import joint_value, use_of
from sim.trial import TrialKeywords, TrialOptions
from sim.verdict import Verdict, fault_at

By: TypeAlias = Literal["wrist", "fingers"]
"""What drives a tool."""

BY: tuple[By, ...] = By.__args__  # type: ignore[attr-defined]

LASH = np.deg2rad(10.0)
"""Turn (rad) planned beyond the asked one: a blade of 9 mm with 0.3 mm of play on either side turns
by 4 degrees in its slot before the socket turns."""


class StrokeController(ObjectImpedance):
    """Gives what the use needs in strokes (``GuidedLoad``), and none of it while fingers move."""

    def __init__(self, plan: GraspPlan, *, max_normal: float) -> None:
        """Begin with the wrench that the plan needs.

        Args:
            plan: The grasp that the gait begins with.
            max_normal: Largest normal force that a pad is asked for, N.
        """
        super().__init__(plan, max_normal=max_normal)
        self._guided = GuidedLoad(plan, share=1.0)

    def step(self, observation: Observation) -> FloatArray:
        """Commands (nu,) for the hand's actuators."""
        strokes = observation.phase == "turn"
        self.law.load = self._guided.give() if strokes else np.zeros(6)
        ctrl = super().step(observation)
        if strokes:
            self._guided.take(self.law.load)
        return ctrl


class FingersRecorder(UseRecorder):
    """Movement in the hand counts from where the stroke has the tool, which goes on."""

    strokes = False

    def record(self) -> None:
        """Take a sample of now."""
        driver = self._simulation.controller
        assert isinstance(driver, ManipulationDriver)
        self._reference = driver.holding.T_palm_wanted
        super().record()

    def _phase(self) -> str:
        return "use" if self.strokes else super()._phase()


class FingersTrial(UseTrial):
    """One use of a tool by the fingers; the ``Situation`` of the machine that runs it.

    Attributes:
        movement: The gait; ``plan`` is the grasp that it begins with, of the true tool.
    """

    recorder: FingersRecorder

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
            movement: A gait of a tool, from ``plan_fingers`` or a file.
            options: As for ``UseTrial``, as all below.
            friction: Factor on the dry friction of the fixture that the plan does not know (-).
            changes: Fields of ``TrialOptions`` by name that are to be others.

        Raises:
            TaskError: The plan is no gait of a tool, or a timeline is given: that of a manipulation
                is used.
            PlannerError: As ``UseTrial``.
        """
        if movement.tool is None or movement.tool_use is not None:
            raise TaskError(f"{movement!r} is no gait of a tool; give what plan_fingers returns")
        grasp, tool = movement.grasp, standing(movement.tool)
        if changes.get("timeline") is not None or (options and options.timeline is not None):
            raise TaskError("strokes have the timeline of a manipulation; give no timeline")
        if (failure := verify_tool_gait(movement)) is not None:
            raise TaskError(f"{failure}; give a gait of plan_fingers for this tool")
        true = replace(grasp, task=replace(grasp.task, object=tool))
        super().__init__(replace(movement, grasp=true), options, friction=friction, **changes)
        self.movement = movement
        # how far it turned is judged by the fixture, and more is planned than is asked
        conditions = ManipulationOptions(criteria=SuccessCriteria(angle_deg=np.inf))
        holding = StrokeController(grasp, max_normal=ASKED_SHARE * force_limit(movement))
        self.sim = ManipulationSim(movement, holding, conditions, simulation=self.simulation)
        self.recorder = FingersRecorder(self.simulation, self.recorder.every, self.use)
        self._phases = Phases(movement, self.sim, conditions.timeline, conditions.criteria)
        self._goal = np.deg2rad(self.use.numbers["angle_deg"])
        self._ended, self._complete = "", False

    def perform(self) -> None:
        """Run all phases, or up to one that fails."""
        simulation, recorder = self.simulation, self.recorder
        told = simulation.on_step

        def on_step(seen: Any) -> None:
            if simulation.due(recorder.every):
                recorder.record()
            if told is not None:
                told(seen)

        simulation.on_step = on_step
        machine = StateMachine(self.movement, self, retry=True)

        def perform(call: PhaseCall) -> Measured:
            recorder.strokes = machine.state in ("turn", "regrasp")
            if recorder.strokes:
                simulation.scene.release(simulation.data)
            return self._phases.perform(call)

        self.run_phases(machine.run(perform, lambda: simulation.time))
        last = self.results[-1]
        self._ended = "" if last.passed else f"{last.phase} {last.about}: {last.reason}"
        self._complete = machine.complete
        recorder.record()

    def _verdict(self, compared: tuple[FingerComparison, ...], interrupted: bool) -> Verdict:
        """As of every use, with what ended the strokes."""
        found = super()._verdict(compared, interrupted)
        fault = found.fault
        if fault is None and not self._complete:
            samples = self.recorder.samples()
            return Verdict(fault_at(samples, len(samples) - 1, "use not done", self._ended))
        if fault is None or not self._ended:
            return found
        return Verdict(replace(fault, detail=f"{fault.detail}; {self._ended}"))

    # ---- the situation, for the state machine

    @property
    def left(self) -> float:
        """Turn of the fixture that is still to be made, rad."""
        turned = joint_value(self.simulation, HINGE)
        return float(np.sign(self._goal) * (self._goal - turned))

    @property
    def touched(self) -> bool:
        """Whether the hand touches the tool."""
        return self.sim.touched

    def fingers_back(self) -> tuple[Relocation, ...] | Failure:
        """A gait does not go back."""
        return Failure(kind="regrasped", text="a gait does not go back")

    def other_order(self, moved: Iterable[str]) -> tuple[Relocation, ...] | Failure:
        """How the fingers that have not moved go on in another order; or why they cannot."""
        return plan_others(self.movement, tuple(moved), self._phases.regrasping.refused)

    def put_down(self) -> Ending | Failure:
        """It is not put down."""
        return Failure(kind="in_its_fixture", text="the tool stays in its fixture")


def standing(tool: Tool) -> Tool:
    """The tool offered with its tip in the fixture.

    Raises:
        TaskError: Its use is none that fingers make.
    """
    use = use_data(tool)
    if not isinstance(use_of(tool), Turn):
        raise TaskError(
            f"{tool.name} is for {use.kind!r}, which takes the whole hand; fingers alone turn "
            "tools (kind 'turn'): use it by the wrist"
        )
    return replace(tool, use=use.model_copy(update={"gap_m": 0.0}))


def plan_fingers(
    hand: Any,
    tool: Tool | str | Path,
    *,
    seed: int = 0,
    max_attempts: int = MAX_ATTEMPTS,
    yaw: float = 0.0,
    **changes: Any,
) -> ManipulationPlan:
    """The strokes and regrasps with which the fingers alone use a tool.

    Args:
        hand: A hand, its name, or the path of its description.
        tool: A tool, its name, or the path of its file; its handle is round.
        seed: Same seed, same plan.
        max_attempts: Budget in attempts, see ``planner.motion.tool_gait.plan_tool_gait``.
        yaw: Turn of tool and fixture about the vertical, rad.
        changes: Further arguments of ``GraspTask.create``.

    Raises:
        PlannerError: No such hand, tool or kind of use; a use or a handle that is not for fingers;
            a wrench that the hand cannot produce; or no gait in the budget.
    """
    task, use = task_of_use(hand, standing(load_tool(tool)), yaw=yaw, **changes)
    angle = np.deg2rad(use.numbers["angle_deg"])
    turn = -float(angle + np.sign(angle) * LASH)  # > 0 is clockwise seen from above
    return plan_tool_gait(task, angle=turn, seed=seed, max_attempts=max_attempts)


def use_tool(
    hand: Any,
    tool: Tool | str | Path,
    options: TrialOptions | None = None,
    *,
    by: By = "wrist",
    seed: int = 0,
    **changes: Unpack[TrialKeywords],
) -> TrialReport:
    """Plan the use of a tool, use it, and judge; the trials make pictures and films.

    Args:
        hand: A hand, its name, or the path of its description.
        tool: A tool, its name, or the path of its file.
        options: Under which conditions; defaults if None.
        by: "wrist": the hand turns or swings with the tool; "fingers": the palm stands still.
        seed: Same seed, same plan.
        changes: Fields of ``TrialOptions`` by name; a timeline is a ``UseTimeline``.

    Raises:
        PlannerError: See ``plan_tool``, ``plan_fingers`` and ``UseTrial``; or ``by`` is neither.
    """
    tool = load_tool(tool)
    if checked_by(by) == "fingers":
        return FingersTrial(plan_fingers(hand, tool, seed=seed), options, **changes).run()
    return UseTrial(plan_tool(hand, tool, seed=seed), options, **changes).run()


def checked_by(by: str) -> By:
    """What drives a tool, as it was given.

    Raises:
        NotFoundError: It is neither "wrist" nor "fingers".
    """
    if by not in BY:
        raise NotFoundError("way to drive a tool", by, BY)
    return by
