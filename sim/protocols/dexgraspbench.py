"""DexGraspBench's force-closure test, open loop, so that figures stand beside its users'.

Read from https://github.com/JYChen18/DexGraspBench at commit 1e7a5a6 (2025-06-05): ``config/task/
eval.yaml``, ``src/task/eval_func``, ``src/util/hand_util.py``. For each of six directions: from the
pre-grasp to the grasp in 10 stages of 10 steps, to the squeeze likewise, then a force of 10 m/s2
times the object's mass at its centre for 2 s. Every 0.2 s the object must be within 50 mm and 15
degrees of its first pose. There is no gravity, the object weighs 0.1 kg, a time step is 4 ms,
friction is 0.6 and 0.02 m, contacts of 4 dimensions, impratio 10, two noslip iterations, and a
hand that begins more than 10 mm inside the object or itself fails. The world is that of
``sim.protocols.dexgraspbench_scene``; hand, pieces and squeeze are those of the export of a batch.

``python -m benchmarks dexgraspbench`` compares the verdicts with those of the benchmark itself.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from planner.errors import TaskError
from planner.exchange.dexgraspbench import plan_squeeze
from planner.exchange.dexgraspbench.export import MASS, PUSH, without_servos
from planner.exchange.dexgraspbench.models import frame_shift
from planner.hands.hand import Hand
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray, pose_change
from sim.carrier import Timeline
from sim.controllers import Observation
from sim.protocols.cases import AXES, Conditions, axis_of
from sim.protocols.dexgraspbench_scene import benchmark_scene
from sim.protocols.disturbance import DisturbanceTrial
from sim.protocols.outcome import Outcome
from sim.verdict import DropCriteria, Fault, lost

STAGES, CHECK_S, CHECKS = 10, 0.2, 10
"""Stages of a motion; time between checks (s), and how many there are."""

MOTION = Timeline(
    approach=0.4, close=0.4, close_wait=0.0, squeeze=0.4, settle=0.2, lift=0.2, hold=2.0
)
"""10 stages of 10 steps of 4 ms to the grasp, and as many to the squeeze."""

FAR = DropCriteria(fewest=0, mm=50.0, deg=15.0)
"""Where the test is failed: movement in the world, whatever touches."""

DEEP_MM = 10.0
"""Penetration at the start from which on the test is failed, mm."""


@dataclass(frozen=True, kw_only=True)
class DexGraspBenchCase:
    """A push along one direction.

    Attributes:
        index: Number of the direction in ``AXES``.
    """

    index: int

    @property
    def name(self) -> str:
        """The direction."""
        return f"dexgraspbench {AXES[self.index]}"

    def run(self, plan: GraspPlan, conditions: Conditions | None = None) -> Outcome:
        """Execute it; physics and controller are the benchmark's, whatever the conditions."""
        del conditions
        task = replace(
            plan.task,
            gravity=np.zeros(3),
            object=replace(plan.task.object, mass=MASS),
        )
        floating = replace(plan, task=task)
        test = _BenchmarkTest(floating)
        force = np.append(PUSH * MASS * axis_of(self.index), np.zeros(3))
        fault = test.test(force)
        return Outcome(
            index=self.index,
            name=self.name,
            held=fault is None,
            fault=fault,
            fingers=task.finger_names,
            samples=test.trial.samples,
            recording=test.trial.recording,
            load=test.trial.loads,
            unit="N",
            wrench=force / np.linalg.norm(force),
            conditions={"mass_kg": MASS, "push_N": PUSH * MASS, **test.depths},
        )


def dexgraspbench_cases() -> tuple[DexGraspBenchCase, ...]:
    """The six directions."""
    return tuple(DexGraspBenchCase(index=i) for i in range(len(AXES)))


def unsuitable_for_dexgraspbench(hand: Hand) -> str:
    """Why a hand cannot be tested by this protocol; "" if it can."""
    if hand.arm is not None:
        return (
            f"protocol dexgraspbench carries the hand alone, by a weld, and {hand.name} is on an "
            "arm; use the protocols forces and robust, or plan with the hand without its arm"
        )
    if reason := without_servos(hand):
        return (
            f"protocol dexgraspbench commands postures, and {reason}; use the protocols forces and "
            "shake"
        )
    return ""


class Replay:
    """Commands postures one after the other, whatever happens: open loop."""

    def __init__(self, plan: GraspPlan) -> None:
        """Work out the commands of pre-grasp, grasp and squeeze.

        Raises:
            TaskError: The hand has actuators that follow no position.
        """
        hand, actuation = plan.task.hand, plan.task.hand.actuation
        if reason := unsuitable_for_dexgraspbench(hand):
            raise TaskError(reason)
        squeeze = plan_squeeze(plan.task, plan.contacts, plan.T_world_base, plan.q)
        self.fault = squeeze.reason
        self.pregrasp = actuation.moment @ plan.q_pregrasp + actuation.length0
        self.grasp = actuation.moment @ plan.q + actuation.length0
        self.squeeze: FloatArray = self.grasp if self.fault else squeeze.ctrl

    def step(self, observation: Observation) -> FloatArray:
        """Commands (nu,) for the hand's actuators."""
        stage = min(STAGES, int(STAGES * observation.progress + 1e-9) + 1) / STAGES
        if observation.phase == "close":
            return np.asarray(self.pregrasp + stage * (self.grasp - self.pregrasp))
        if observation.phase == "squeeze":
            return np.asarray(self.grasp + stage * (self.squeeze - self.grasp))
        return self.squeeze


def _deepest(data: Any) -> float:
    """Deepest penetration of any pair, mm; 0 without."""
    return 1e3 * max((-float(contact.dist) for contact in data.contact), default=0.0)


class _BenchmarkTest:
    """The benchmark's sequence of events.

    Attributes:
        trial: What is held, and then pushed.
        depths: Penetration at the pre-grasp, which the benchmark refuses, and at the grasp, which
            it reports.
    """

    def __init__(self, plan: GraspPlan) -> None:
        """The object is free from the beginning."""
        self._replay = Replay(plan)
        scene, welded = benchmark_scene(plan.task, plan.T_world_base)
        self.trial = DisturbanceTrial(
            plan,
            controller=self._replay,
            dropped=None,
            timeline=MOTION,
            scene=scene,
            carrier=welded,
        )
        self._shift = SE3(np.eye(3), -frame_shift(plan.task.object.shape))
        at_grasp = scene.start(plan.q, plan.T_world_base)
        self.depths = {
            "start_penetration_mm": _deepest(self.trial.simulation.data),
            "grasp_penetration_mm": _deepest(at_grasp),
        }

    def test(self, force: FloatArray) -> Fault | None:
        """Grasp, squeeze, push; what went wrong, None if nothing did."""
        trial, simulation = self.trial, self.trial.simulation
        if self._replay.fault:
            return trial.fault("infeasible forces", self._replay.fault)
        if self.depths["start_penetration_mm"] > DEEP_MM:
            depth = self.depths["start_penetration_mm"]
            detail = f"{depth:.1f} mm deep before it began; {DEEP_MM:g} are let pass"
            return trial.fault("penetration", detail)
        begin = self._object_pose()
        if fault := trial.run_phases("close", "squeeze"):
            return fault
        trial.begin_hold()
        trial.load = float(np.linalg.norm(force))
        trial.push(force)
        for _ in range(CHECKS):
            if fault := trial.hold_for(CHECK_S):
                return fault
            moved = pose_change(begin, self._object_pose())
            if lost(FAR, touching=0, moved=moved):
                detail = f"the object moved {moved[0]:.1f} mm and turned {moved[1]:.1f} degrees"
                touching = simulation.touching()
                return trial.put_down("slipped" if touching else "dropped", detail)
        return None

    def _object_pose(self) -> SE3:
        """Of the frame of the object's file, whose movement the benchmark looks at."""
        return self.trial.simulation.T_world_object * self._shift
