"""``Phases``: what every phase of a manipulation does and checks; a regrasp is in ``regrasping``.

The base is sent to planned poses up to the turn, and afterwards to where the measured object gets
to its target. The turn is measured as the signed twist of the object in the palm since the turn
began, and each stroke begins at the measured pose: rolling and regrasps are compensated. What the
robot decides by is what it reads (``reading``); whether a phase has failed is judged by the truth,
but for fingers that do not feel the object after the squeeze and strokes that stall.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from planner.errors import TaskError
from planner.kinematics import PATH_STEP, ROUNDING
from planner.motion.manipulation import ManipulationPlan
from planner.motion.phase import Ending
from planner.motion.single_stroke import MOST_PIVOT
from planner.quality import QualityReport, analyse
from planner.spatial import SE3, FloatArray, shifted
from sim.contacts import hand_contacts, merge_per_finger
from sim.controllers import Observation
from sim.controllers.grasp import RECLOSING_TIME, closing_ended
from sim.manipulation.machine import CLOSE_TO, PhaseCall
from sim.manipulation.regrasping import Regrasping
from sim.manipulation.simulation import ManipulationSim
from sim.manipulation.timeline import (
    ManipulationPhase,
    ManipulationTimeline,
    Measured,
    SuccessCriteria,
    at_goal,
    off_target,
    placed,
    too_short,
    undisturbed,
    where_it_stands,
)
from sim.scene.physics import PhysicsOptions

STILL_SPEED = np.deg2rad(3.0)
"""Rate (rad/s) below which a turn that has reached its angle has ended."""

CARRY_SPEED = 0.1
"""Mean speed (m/s) of a hand that carries the object while it turns it."""

LEAST_OF_STROKE = 0.4
"""Least share (-) of the asked angle that a stroke must make for another one to follow."""


class Phases:
    """The phases of one manipulation.

    Attributes:
        regrasping: Fingers that move on.
        quality: Quality of the measured contacts, of the phases that look at it.
    """

    def __init__(
        self,
        plan: ManipulationPlan,
        sim: ManipulationSim,
        timeline: ManipulationTimeline,
        criteria: SuccessCriteria,
        via: Sequence[tuple[float, float]] = (),
    ) -> None:
        """Prepare; ``via`` as in ``ManipulationOptions``."""
        self._plan, self._sim, self._via = plan, sim, via
        self._timeline, self._criteria = timeline, criteria
        self._turn_begun, self._carrying = False, 0.0
        self.regrasping = Regrasping(plan, sim, timeline)
        self.quality: dict[ManipulationPhase, QualityReport] = {}

    @property
    def left(self) -> float:
        """Turn that is still to be made, rad; negative beyond the goal."""
        return float(np.sign(self._plan.angle)) * (self._plan.angle - self._turned)

    def perform(self, call: PhaseCall) -> Measured:
        """Run a phase; why it failed, "" if it did not, and its numbers."""
        timeline, ending = self._timeline, call.ending
        phases: dict[ManipulationPhase, Callable[[], Measured]] = {
            "stand": self._stand,
            "approach": self._approach,
            "close": self._close,
            "squeeze": self._squeeze,
            "verify": lambda: self._verify("verify"),
            "lift": self._lift,
            "wrist": lambda: self._wrist("wrist"),
            "wrist back": lambda: self._wrist("wrist back"),
            "turn": self._turn,
            "regrasp": lambda: self._regrasp(call),
            "hold": self._hold,
            "verify again": lambda: self._verify("verify again"),
            "back": self._back,
            "carry": lambda: self._carry(ending),
            "lower": lambda: self._lower(ending),
            "release": lambda: self._let_go("release", timeline.release, ending),
            "open": lambda: self._let_go("open", timeline.open, ending),
            "retreat": lambda: self._retreat(ending),
        }
        return phases[call.phase]()

    def _regrasp(self, call: PhaseCall) -> Measured:
        if call.relocation is None:
            raise TaskError("a regrasp has no relocation; give PhaseCall one")
        fault, numbers = self.regrasping.perform(call.relocation)
        return fault, numbers | self._in_hand()

    def _stand(self) -> Measured:
        fault = self._sim.run("stand", self._timeline.stand)
        return self._standing(fault)

    def _go(self, phase: ManipulationPhase, T_world_base: SE3, duration: float) -> str:
        """Bring the base straight to a pose, in a time (s) if an arm can; what went wrong."""
        self._sim.mover.go(T_world_base, duration)
        return self._sim.run(phase, self._sim.mover.duration)

    def _approach(self) -> Measured:
        fault = self._go("approach", self._plan.T_world_base, self._timeline.approach)
        return self._standing(fault)

    def _close(self) -> Measured:
        wait, simulation = self._timeline.close_wait, self._sim.simulation
        until = closing_ended(self._sim.driver, wait, simulation.timestep)
        fault = self._sim.run(
            "close", self._timeline.close, wait=wait + RECLOSING_TIME, until=until
        )
        return self._standing(fault)

    def _squeeze(self) -> Measured:
        fault = self._sim.run("squeeze", self._timeline.squeeze)
        self._sim.reading.mark_reference()
        reason, numbers = self._standing(fault)
        task = self._plan.task
        forces = self._sim.simulation.normal_forces()
        each = list(zip(task.finger_names, forces.tolist(), strict=True))
        numbers |= {f"{finger}_N": force for finger, force in each}
        felt = self._sim.reading.normal_forces()
        missing = [task.finger_names[i] for i in np.flatnonzero(felt == 0.0)]
        touching = len(each) - len(missing)
        if not reason and touching < task.fingers_needed:
            few = f"{touching} fingers touch, {task.fingers_needed} are needed"
            reason = f"{few}; {', '.join(missing)} do not"
        return reason, numbers

    def _verify(self, phase: ManipulationPhase) -> Measured:
        """Hold on, then analyse the measured contacts by the planner's own code."""
        fault = self._sim.run(phase, self._timeline.verify)
        simulation = self._sim.simulation
        merged = merge_per_finger(hand_contacts(simulation.scene, simulation.data))
        if fault or len(merged) == 0:
            return fault or "nothing touches the object", {}
        shape = self._plan.task.object.shape
        quality = analyse(merged, length=shape.bounding_radius)
        self.quality[phase] = quality
        numbers = {
            "contacts": float(len(merged)),
            "min_weight": quality.closure.normalised_min_weight,
            "epsilon": quality.epsilon,
        }
        reason = "" if quality.closure.closed else f"no force closure: {quality.closure.reason}"
        return reason, numbers

    def _lift(self) -> Measured:
        simulation, height = self._sim.simulation, self.height
        duration = self._timeline.lift * self._stretch
        fault = self._go("lift", shifted(self._plan.T_world_base, [0.0, 0.0, height]), duration)
        numbers = self._in_hand()
        first = float(simulation.plan.task.T_world_object.translation[2])
        numbers["rise_mm"] = 1e3 * (float(simulation.T_world_object.translation[2]) - first)
        short = 1e3 * height - numbers["rise_mm"]
        if not fault and max(numbers["shift_mm"], short) > self._criteria.slip_mm:
            fault = (
                f"the object moved {numbers['shift_mm']:.1f} mm in the hand and rose {short:.1f} "
                "mm less than the hand"
            )
        return fault, numbers

    @property
    def height(self) -> float:
        """How far the object is lifted, m."""
        return max(self._timeline.height, self._plan.rise)

    @property
    def _stretch(self) -> float:
        """How many times as long as without an attitude lift and lowering take."""
        return self.height / self._timeline.height

    def _wrist(self, phase: ManipulationPhase) -> Measured:
        """Turn hand and object as one about the object to the attitude, or back."""
        path = self._plan.path
        shares = path.wrist_shares if phase == "wrist" else path.wrist_shares[::-1]
        up = np.array([0.0, 0.0, self.height])
        if phase == "wrist back" and self._via:  # where the object was carried
            up = self._carried(self._via[-1])
        poses = [shifted(self._plan.turned_base(share), up) for share in shares]
        duration = float(np.linalg.norm(path.wrist_turn)) / self._timeline.wrist_rate
        before = self._shift
        self._sim.mover.go_along(poses, duration)
        fault = self._sim.run(phase, self._sim.mover.duration)
        numbers = self._in_hand()
        numbers["drift_mm"] = moved = 1e3 * float(np.linalg.norm(self._shift - before))
        if not fault and moved > self._criteria.slip_mm:
            fault = f"the object moved {moved:.1f} mm in the hand while the wrist turned"
        return fault or self._tilted(numbers), numbers

    @property
    def _turned(self) -> float:
        """How far the object has come since the turn began, as it is read, rad, with its sign."""
        return self._sim.reading.turned()

    def _deviation(self) -> float:
        """Standard deviation (rad) of the turn by which the next one aims further."""
        sim = self._sim
        return sim.reading.deviation() if sim.driver.aims_by_belief else 0.0

    def _turn(self) -> Measured:
        """The turn, or its next stroke, from the measured pose."""
        first, self._turn_begun = not self._turn_begun, True
        if first:
            self._sim.reading.mark_reference()
            self._set_out()
        if self._plan.cycles > 1:
            return self._stroke()
        deviation = self._deviation()
        if not first or deviation:  # not first: fingers went back to where the motion began
            self._sim.driver.begin_stroke(self._plan.angle - self._turned, deviation)
        fault = self._follow("turn")
        numbers = self._in_hand()
        return fault or self._shortfall(numbers), numbers

    def _back(self) -> Measured:
        """The motion backwards, to where it began."""
        self._sim.driver.begin_back()
        fault = self._follow("back")
        numbers = self._in_hand()
        asked = float(np.rad2deg(self._plan.angle))
        short = too_short(-asked, numbers["turn_deg"] - asked, self._criteria)
        fault = fault or self._tilted(numbers)
        return fault or (short and f"{short}: {self._obstacle()}"), numbers

    @property
    def _shift(self) -> FloatArray:
        """How far the object has moved in the palm since the turn began (3,), m."""
        return self._sim.recorder.moved()[2]

    def _in_hand(self) -> dict[str, float]:
        """How the object lies in the palm, against how it lay when the turn began."""
        turn, tilt, shift = self._sim.recorder.moved()
        numbers = {
            "turn_deg": float(np.rad2deg(turn)),
            "tilt_deg": float(np.rad2deg(tilt)),
            "shift_mm": 1e3 * float(np.linalg.norm(shift)),
            "fingers": float(len(self._sim.touching_fingers)),
        }
        if self._plan.shift.any():
            asked = self._plan.grasp.T_world_palm.rotation.T @ self._plan.shift
            numbers["shift_off_mm"] = 1e3 * float(np.linalg.norm(shift - asked))
        return numbers

    def _shortfall(self, numbers: dict[str, float]) -> str:
        """Why the turn is not what was asked for, "" if it is."""
        asked = float(np.rad2deg(self._plan.angle))
        if short := too_short(asked, numbers["turn_deg"], self._criteria):
            return f"{short}: {self._obstacle()}"
        off = numbers.get("shift_off_mm", 0.0)
        fault = self._tilted(numbers)
        if not fault and off > self._criteria.shift_mm:
            fault = f"{off:.1f} mm from where it was to be moved: {self._obstacle()}"
        return fault

    def _stroke(self) -> Measured:
        before = self._turned
        deviation = self._deviation()
        asked = abs(self._sim.driver.begin_stroke(self._plan.angle - before, deviation).goal)
        fault = self._follow("turn")
        numbers = self._in_hand()
        made = abs(self._turned - before)
        numbers["stroke_deg"] = float(np.rad2deg(made))
        if not fault and self.left > CLOSE_TO and made < LEAST_OF_STROKE * asked:
            fault = (
                f"turned {np.rad2deg(made):.1f} of the stroke's {np.rad2deg(asked):.1f} degrees: "
                f"{self._obstacle()}"
            )
        return fault or self._tilted(numbers), numbers

    def _follow(self, phase: ManipulationPhase) -> str:
        """Run until the reference's turn is made; what ended it early, "" if nothing."""
        reference, dt = self._sim.driver.reference, self._sim.simulation.timestep
        last = reference.left

        def made(_: Observation) -> bool:
            nonlocal last
            rate = (reference.left - last) / dt
            last = reference.left
            there = reference.arrived if reference.goal == 0.0 else reference.left <= CLOSE_TO
            return bool(there and abs(rate) < STILL_SPEED)

        fastest = max(abs(reference.goal) / self._timeline.turn_rate, self._carrying)
        self._carrying = 0.0
        return self._sim.run(phase, fastest, wait=self._timeline.turn_wait, until=made)

    def _carried(self, place: tuple[float, float]) -> FloatArray:
        """Shift (3,), m, of a lifted hand from its grasp to where the object is at a place."""
        there = np.array([*place, self.height])
        there[:2] -= self._plan.task.T_world_object.translation[:2]
        return there

    def _set_out(self) -> None:
        """Send the hand along the places through which it carries the object meanwhile."""
        if not self._via:
            return
        x, y = self._plan.task.T_world_object.translation[:2].tolist()
        way, length = [self._carried((x, y))], 0.0
        for begin, end in pairwise(self._carried(place) for place in ((x, y), *self._via)):
            leg = float(np.linalg.norm(end - begin))
            pieces = math.ceil(leg / PATH_STEP - ROUNDING)  # without them it overshoots corners
            way.extend(np.linspace(begin, end, pieces + 1)[1:])
            length += leg
        if not length:
            return
        turned = abs(self._plan.path.angle) / self._timeline.turn_rate
        self._carrying = max(length / CARRY_SPEED, turned / self._plan.cycles)
        base = self._plan.turned_base(1.0)
        self._sim.mover.go_along([shifted(base, shift) for shift in way], self._carrying)
        self._carrying = self._sim.mover.duration

    def _tilted(self, numbers: dict[str, float]) -> str:
        tilt = numbers["tilt_deg"]
        if tilt <= self._criteria.tilt_deg:
            return ""
        return f"tilted by {tilt:.1f} degrees off the axis{self._held_back()}"

    def _obstacle(self) -> str:
        """Why the object does not follow, as far as the controller reports it."""
        holding = self._sim.driver.holding
        saturated = ", ".join(self._sim.driver.saturated_actuators())
        had_no_more = f"{saturated} had no more to give" if saturated else "it did not follow"
        return (holding.gave_up or had_no_more) + self._held_back()

    def _held_back(self) -> str:
        """Torsional friction above that of ``ours`` against a tip that pivots, "" if none is."""
        physics, pivoted = self._sim.simulation.scene.physics, self._plan.pivoted
        most, usual = int(np.argmax(pivoted)), PhysicsOptions.mu_torsion
        if pivoted[most] <= MOST_PIVOT or physics.condim < 4 or physics.mu_torsion <= usual:
            return ""
        finger, degrees = self._plan.task.finger_names[most], np.rad2deg(pivoted[most])
        return (
            f"; torsional friction of {1e3 * physics.mu_torsion:g} mm (mu_torsion; ours: "
            f"{1e3 * usual:g}) holds {finger}, which pivots by {degrees:.0f} degrees"
        )

    def _hold(self) -> Measured:
        before, first = self._in_hand(), self._shift
        fault = self._sim.run("hold", self._timeline.hold)
        numbers = self._in_hand()
        numbers["drift_mm"] = 1e3 * float(np.linalg.norm(self._shift - first))
        numbers["drift_deg"] = abs(numbers["turn_deg"] - before["turn_deg"])
        return fault or self._shortfall(numbers), numbers

    def _carry(self, ending: Ending) -> Measured:
        above = shifted(ending.T_world_target, [0.0, 0.0, self.height])
        fault = self._go("carry", self._sim.base_for(above), self._timeline.carry)
        numbers = off_target(above, self._sim.simulation.T_world_object)
        if not fault and ending.release is None:
            fault, goal = at_goal(above, self._sim.simulation.T_world_object, self._criteria)
            numbers |= goal
        return fault, numbers

    def _lower(self, ending: Ending) -> Measured:
        target, duration = ending.T_world_target, self._timeline.lower * self._stretch
        fault = self._go("lower", self._sim.base_for(target), duration)
        return fault, off_target(target, self._sim.simulation.T_world_object)

    def _let_go(self, phase: ManipulationPhase, duration: float, ending: Ending) -> Measured:
        fault = self._sim.run(phase, duration)
        return self._standing_at_target(fault, ending)

    def _retreat(self, ending: Ending) -> Measured:
        out = self._plan.way_out(self._sim.T_world_base, ending)
        fault = self._go("retreat", out, self._timeline.retreat)
        if not fault and self._sim.touched:
            fault = "the hand still touches the object"
        return self._standing_at_target(fault, ending)

    def _standing(self, fault: str) -> Measured:
        first = self._sim.simulation.plan.task.T_world_object
        reason, numbers = undisturbed(first, self._sim.simulation.T_world_object, self._criteria)
        return fault or reason, numbers

    def _standing_at_target(self, fault: str, ending: Ending) -> Measured:
        target, now = ending.T_world_target, self._sim.simulation.T_world_object
        if ending is not self._plan.ending:
            target = where_it_stands(target, now)
        reason, numbers = placed(target, now, self._criteria)
        return fault or reason, numbers
