"""``ManipulationReport``: what a manipulation did, phase by phase, with numbers and reasons."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.arrays import finite
from planner.motion.manipulation import ManipulationPlan
from planner.quality import QualityReport
from planner.spatial import FloatArray, pose_from_wxyz, rotation_angle
from sim.controllers.base import event_lines
from sim.manipulation.log import FingerForce, ManipulationLog, finger_forces, mode_table, told_modes
from sim.manipulation.report_file import ManipulationReportFile
from sim.manipulation.simulation import DROPPED
from sim.manipulation.timeline import (
    IN_THE_AIR,
    TURNING,
    ManipulationTimeline,
    SuccessCriteria,
    short_of,
)
from sim.report import INTERRUPTED, ExecutionReport, PhaseResult
from sim.screen import error_lines
from sim.verdict import Fault, first_collision, lost


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ManipulationReport(ExecutionReport):
    """What happened, and whether it is what was asked for; see ``ExecutionReport`` too.

    Attributes:
        results: The phases that were run, in order; the last one failed if not all were run.
        complete: Whether the object was placed as planned, with a retry or without.
        put_down: Whether it was put down half-way.
        asked: Turn that was asked for, rad.
        asked_shift: Translation in the hand that was asked for with it (3,), m, world.
        back: Why the motion was made backwards before the object was put down, "" if it was not.
        R_world_palm: (3, 3), world from palm while the object was turned.
        log: What was judged, over time.
        plan: What was executed.
        planned_modes: (m, n), contact modes as planned, at every sample.
        measured_modes: (m, n), as measured.
        before: Quality of the measured contacts before the lift; None if it never came to that.
        after: After the turn.
        criteria: Where phases fail.
        timeline: Durations.
        force_limit: Largest normal force with which a finger may press for a success with closure,
            N.
        pictures: Files of pictures, by phase.
        earlier: What was done before, where the object was put down and all was begun again; what
            is told here is about the rest of the turn then.
    """

    results: tuple[PhaseResult, ...]
    complete: bool
    put_down: bool
    asked: float
    asked_shift: FloatArray
    back: str
    R_world_palm: FloatArray
    log: ManipulationLog
    plan: ManipulationPlan
    planned_modes: NDArray[np.str_]
    measured_modes: NDArray[np.str_]
    before: QualityReport | None
    after: QualityReport | None
    criteria: SuccessCriteria
    timeline: ManipulationTimeline
    force_limit: float
    pictures: dict[str, str]
    earlier: ManipulationReport | None = None

    @property
    def reason(self) -> str:
        """Why it failed, "" if it did not."""
        failed = [r for r in self.results if not r.passed]
        return f"{failed[-1].phase}: {failed[-1].reason}" if failed and not self.complete else ""

    @property
    def interrupted(self) -> bool:
        """Whether Ctrl-C ended it."""
        return bool(self.results) and self.results[-1].reason == INTERRUPTED

    @property
    def dropped(self) -> bool:
        """Whether the object was dropped in the air at any sample, by ``DROPPED``."""
        air = self.log.during(*IN_THE_AIR)
        return any(lost(DROPPED, touching=n) for n in self.log.touching[air])

    @property
    def turned(self) -> float:
        """Signed twist at the end of the hold, rad; NaN if it never came to that."""
        held = self.log.during("hold")
        return float(self.log.turn[held[-1]]) if len(held) else float("nan")

    @property
    def shifted(self) -> FloatArray:
        """Translation in the hand at the end of the hold (3,), m, world; NaN without one."""
        held = self.log.during("hold")
        if not len(held):
            return np.full(3, np.nan)
        return np.asarray(self.R_world_palm @ self.log.shift[held[-1]])

    @property
    def least_fingers(self) -> int:
        """Fewest fingers that touched at any sample in the air; 0 if it was never in the air."""
        air = self.log.during(*IN_THE_AIR)
        return int(self.log.touching[air].min()) if len(air) else 0

    @property
    def open_samples(self) -> int:
        """Samples in the air without force closure."""
        return int((~self.log.closed[self.log.during(*IN_THE_AIR)]).sum())

    @property
    def goal_off(self) -> float:
        """Rotation of the object off its goal at last, rad; NaN where a plan has none.

        A plan whose hand ends in its attitude has the goal that its object is turned to.
        """
        states = self.recording.T_world_object
        if not self.plan.ending.turned or not len(states):
            return float("nan")
        last = pose_from_wxyz(states[-1, :3], states[-1, 3:])
        return rotation_angle(self.plan.ending.T_world_target.rotation.T @ last.rotation)

    @property
    def _goal_number(self) -> dict[str, float]:
        """``goal_off`` in degrees, of a plan that has a goal."""
        return {"goal_off_deg": float(np.rad2deg(self.goal_off))} if self.plan.ending.turned else {}

    @property
    def goal_reached(self) -> bool:
        """Complete, not dropped, and within ``SuccessCriteria.goal_deg`` of the goal at last."""
        return self.plan.ending.turned and self.success

    @property
    def success(self) -> bool:
        """Turned as far or further, moved as asked for, not put down half-way, and not dropped.

        Of a plan with a goal: complete, near the goal, and not dropped.
        """
        if self.earlier is not None and not (self.earlier.complete and self.earlier.success):
            return False
        if self.plan.ending.turned:
            near = bool(np.rad2deg(self.goal_off) <= self.criteria.goal_deg)
            return self.complete and near and not self.dropped
        held = self.log.during("hold")
        return bool(len(held)) and bool(self._reached()[held[-1]]) and not self.dropped

    @property
    def collision(self) -> Fault | None:
        """The first collision of the hand with itself, table or obstacle; None without one.

        Judged as in a trial of a grasp, over the whole run and what was done before it.
        """
        if self.earlier is not None and self.earlier.collision is not None:
            return self.earlier.collision
        log = self.log
        return first_collision(log.time, log.collision_N, log.collision, self.criteria.collision_N)

    @property
    def forces(self) -> tuple[FingerForce, ...]:
        """How hard each finger pressed on the object over the whole run."""
        return finger_forces(self.log, self.fingers)

    @property
    def success_with_closure(self) -> bool:
        """A success, and nothing of ``faults``."""
        return self.success and not self.faults

    @property
    def faults(self) -> str:
        """What a success with closure must not have, "" if nothing.

        In the air enough fingers and force closure at every sample; over the whole run no collision
        of the hand, and no finger that presses harder than it may. The same of the movements of a
        chain before this one.
        """
        before = self.earlier if self.earlier is not None and self.earlier.complete else None
        faults = [before.faults] if before is not None and before.faults else []
        if self.least_fingers < self.criteria.fingers:
            faults.append(f"only {self.least_fingers} fingers touched at times")
        if self.open_samples:
            faults.append(f"{self.open_samples} samples without force closure")
        if self.collision is not None and (before is None or before.collision is None):
            detail, time = self.collision.detail, self.collision.time
            faults.append(f"the hand collided, {detail} at {time:.2f} s")
        hardest = max(self.forces, key=lambda force: force.sustained)
        if hardest.sustained > self.force_limit:
            faults.append(
                f"{hardest.finger} pressed with {hardest.sustained:.1f} N (at most "
                f"{self.force_limit:.1f})"
            )
        return "; ".join(faults)

    @property
    def time_to_angle(self) -> float:
        """Time from the beginning of the turn until it was reached, s; NaN if never."""
        turning = self.log.during(*TURNING)
        done = self._reached()[turning]
        if not done.any():
            return float("nan")
        times = self.log.time[turning]
        return float(times[np.argmax(done)] - times[0])

    @property
    def largest_tilt(self) -> float:
        """Largest rotation beside the turn, while turning and holding, rad."""
        return self._largest(self.log.tilt)

    @property
    def largest_off_path(self) -> float:
        """Largest distance of the object from where it was wanted, while turning and holding, m."""
        return self._largest(self.log.off_path)

    def __str__(self) -> str:
        """Phase by phase, contact modes, and the verdict."""
        lines = [] if self.earlier is None else [str(self.earlier), "", self._begun]
        lines += [str(result) for result in self.results]
        if self.log.during("turn").size:
            turning = self.log.during("turn", "regrasp")
            modes = told_modes(self.fingers, self.planned_modes, self.measured_modes, turning)
            lines += ["", *modes, ""]
            numbers = self.numbers()
            lines += [
                f"turned {numbers['turned_deg']:.2f} of {np.rad2deg(self.asked):.1f} degrees, "
                f"reached after {numbers['time_to_angle_s']:.2f} s",
                f"tilt up to {numbers['largest_tilt_deg']:.2f} degrees off the planned attitude, "
                f"centre up to {numbers['largest_off_path_mm']:.2f} mm off its path",
                *self._moved(),
                f"in the air: at least {self.least_fingers} fingers touched, "
                f"{self.open_samples} samples without force closure",
            ]
        if self.log.during("squeeze").size:
            limit = f"(at most {self.force_limit:.1f} N)"
            lines += [f"normal forces, largest mean over 20 ms {limit}:"]
            lines += [f"  {force}" for force in self.forces]
        lines += [f"controller: {line}" for line in event_lines(self.events)]
        lines += error_lines(self.error_model)
        verdict = "complete" if self.complete else f"failed in {self.reason}"
        if np.isfinite(self.goal_off):
            how = "held" if self.plan.ending.release is None else "standing"
            off, most = np.rad2deg(self.goal_off), self.criteria.goal_deg
            reached = "reached" if self.goal_reached else "not reached"
            what = "goal" if self.plan.then is None else "the pose between"
            lines.append(f"{what} {reached}: {off:.2f} degrees off (at most {most:g}), {how}")
        return "\n".join([*lines, f"{verdict}; the turn: {self._judged()}"])

    def __repr__(self) -> str:
        """One line: how it ended."""
        turned = f"turned {np.rad2deg(self.turned):.1f} of {np.rad2deg(self.asked):.1f} degrees"
        ended = "complete" if self.complete else f"failed in {self.reason}"
        return f"<ManipulationReport: {self.hand}, {self.object}, {turned}, {ended}"[:196] + ">"

    def _judged(self) -> str:
        """The turn in words: success with or without closure, or none."""
        if self.success_with_closure:
            return "success with closure"
        if self.success:
            return f"success, but {self.faults}"
        again = self.earlier is not None and not self.earlier.complete
        told = "put down half-way" if again else "not as asked"
        if self.collision is not None:
            told += f"; {self.collision.reason}: {self.collision.detail}"
        return told

    @property
    def _begun(self) -> str:
        """Why there are two runs."""
        planned = self.earlier is not None and self.earlier.complete
        return "from where it stands now, as planned:" if planned else "begun again:"

    def _moved(self) -> list[str]:
        """How far it was moved in the hand, if that was asked for; and why it was brought back."""
        lines = []
        if self.asked_shift.any():
            now, asked = (
                ", ".join(f"{v:.1f}" for v in 1e3 * shift + 0.0)
                for shift in (self.shifted, self.asked_shift)
            )
            lines.append(f"moved by ({now}) of ({asked}) mm in the hand")
        if self.back:
            lines.append(f"made backwards before it was put down: {self.back}")
        return lines

    def _reached(self) -> NDArray[np.bool_]:
        """At which samples (m,) the object was turned as far and moved as asked for."""
        far = short_of(self.asked, self.log.turn) <= 0.0
        if not self.asked_shift.any():
            return np.asarray(far)
        off = np.linalg.norm(self.log.shift @ self.R_world_palm.T - self.asked_shift, axis=1)
        return np.asarray(far & (1e3 * off <= self.criteria.shift_mm))

    def numbers(self) -> dict[str, float]:
        """The figures of a row in a table."""
        after = self.after
        off = np.linalg.norm(self.shifted - self.asked_shift)
        return {
            "turned_deg": float(np.rad2deg(self.turned)),
            "shift_off_mm": 1e3 * float(off),
            "time_to_angle_s": self.time_to_angle,
            "largest_tilt_deg": float(np.rad2deg(self.largest_tilt)),
            "largest_off_path_mm": 1e3 * self.largest_off_path,
            "least_fingers": float(self.least_fingers),
            "open_samples": float(self.open_samples),
            "epsilon_after": float("nan") if after is None else after.epsilon,
            "largest_collision_N": float(self.log.collision_N.max(initial=0.0)),
            "largest_force_N": max(force.sustained for force in self.forces),
            "force_limit_N": self.force_limit,
            **self._goal_number,
            "duration_s": self.results[-1].end if self.results else 0.0,
        }

    def to_file(self, *, states: bool = True) -> ManipulationReportFile:
        """The same as the data of a file, which pages are made of."""
        return ManipulationReportFile.model_validate(
            {
                **self._shared(states=states),
                "success_with_closure": self.success_with_closure,
                "complete": self.complete,
                "put_down_half_way": self.put_down,
                "dropped": self.dropped,
                "reason": self.reason,
                "faults": self.faults,
                "collision": "" if self.collision is None else self.collision.detail,
                "asked_deg": float(np.rad2deg(self.asked)),
                "asked_shift_mm": (1e3 * self.asked_shift).tolist(),
                "shifted_mm": finite(1e3 * self.shifted),
                "made_backwards_because": self.back,
                "numbers": finite(self.numbers()),
                "forces": [
                    {
                        "finger": f.finger,
                        "peak_N": f.peak,
                        "sustained_N": f.sustained,
                        "mean_N": f.mean,
                        "time_s": f.peak_time,
                    }
                    for f in self.forces
                ],
                "contact_modes": {
                    finger: mode_table(self.planned_modes[:, i], self.measured_modes[:, i])
                    for i, finger in enumerate(self.fingers)
                },
                "quality_before": None if self.before is None else self.before.to_dict(),
                "quality_after": None if self.after is None else self.after.to_dict(),
                "criteria": asdict(self.criteria),
                "timeline": asdict(self.timeline),
                "pictures": self.pictures,
                "samples": {
                    **self.log.to_dict(),
                    "contact_mode_planned": self.planned_modes.tolist(),
                    "contact_mode_measured": self.measured_modes.tolist(),
                },
                "earlier": None if self.earlier is None else self.earlier.to_file(states=states),
            }
        )

    def _largest(self, values: np.ndarray[Any, np.dtype[np.float64]]) -> float:
        turning = values[self.log.during(*TURNING)]
        return float(np.nanmax(turning)) if np.isfinite(turning).any() else float("nan")
