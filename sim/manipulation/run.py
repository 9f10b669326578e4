"""``manipulate``: execute a ``ManipulationPlan`` in MuJoCo, phase by phase, each with its check.

    stand, approach, close, squeeze, verify, lift, turn, hold, verify again, carry, lower, release,
    open, retreat

It ends at the first phase that fails. What really is there may differ from what was planned for:
friction, mass and the object's pose; the controller knows of it only what it measures. The base is
sent to planned poses up to the turn, and then to where the measured object gets to its target.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np

from planner.quality import QualityReport, analyse
from planner.spatial import SE3, FloatArray, signed_twist
from planner.task import GraspTask
from sim.contacts import hand_contacts, merge_per_finger, normal_forces
from sim.controllers import Phase, Sensing
from sim.manipulation.drive import BaseMover, MotionController
from sim.manipulation.modes import measured_modes, planned_modes
from sim.manipulation.pace import Bounds, Pace, Step
from sim.manipulation.plan import ManipulationPlan
from sim.manipulation.report import Check, ManipulationReport
from sim.manipulation.samples import Track, Watch
from sim.physics import PhysicsOptions
from sim.picture import save_picture
from sim.trial import Trial

__all__ = ["ManipulationRun", "Push", "manipulate"]

SAMPLE_EVERY = 0.02
"""Time between samples, s: that at which strict verdicts look."""

STILL_SPEED = np.deg2rad(3.0)
"""Rate (rad/s) below which a turn that has reached its angle has ended."""

_PHASE: dict[Step, Phase] = {
    "stand": "approach",
    "approach": "approach",
    "close": "close",
    "squeeze": "squeeze",
    "verify": "settle",
    "lift": "lift",
    "turn": "turn",
    "hold": "hold",
    "verify again": "hold",
    "carry": "carry",
    "lower": "lower",
    "release": "release",
    "open": "open",
    "retreat": "retreat",
}


@dataclass(frozen=True, kw_only=True)
class Push:
    """A force on the object's centre of mass while it is turned.

    Attributes:
        force: (3,), N, world.
        after: When, since the beginning of the turn, s.
        duration: How long, s.
    """

    force: FloatArray
    after: float
    duration: float


class ManipulationRun(Trial):
    """One execution of a plan.

    Attributes:
        watch: What takes samples.
    """

    def __init__(
        self,
        plan: ManipulationPlan,
        *,
        really: GraspTask | None = None,
        physics: PhysicsOptions | None = None,
        sensing: Sensing | None = None,
        pace: Pace | None = None,
        bounds: Bounds | None = None,
        push: Push | None = None,
    ) -> None:
        """Build the scene and put hand and object at their start; see ``manipulate``."""
        self._pace, self._bounds = pace or Pace(), bounds or Bounds()
        grasp = plan.motion.grasp
        self._driver = MotionController(plan, rate=self._pace.turn_rate, sensing=sensing)
        super().__init__(
            replace(grasp, task=really or grasp.task), physics=physics, controller=self._driver
        )
        self._manipulation, self._push = plan, push
        self._mover = BaseMover(self.scene.mount, grasp.T_world_base_start)
        self._carrier = self._mover
        self.watch = Watch(self.scene, self._driver.reference.axis)
        self._sample_steps = max(1, round(SAMPLE_EVERY / self.scene.physics.timestep))
        self._checks: list[Check] = []
        self._before: QualityReport | None = None
        self._after: QualityReport | None = None

    def perform(self, *, pictures: Path | None = None) -> ManipulationReport:
        """Run all phases, or up to the first that fails.

        Args:
            pictures: Folder for a picture at the end of each phase; it must exist.
        """
        taken: dict[str, str] = {}
        no_picture = ""
        mujoco.set_mju_user_warning(lambda _: None)
        try:
            for step, run in self._phases():
                begin = float(self.data.time)
                reason, numbers = run()
                diverged = self._divergence()
                self._checks.append(
                    Check(
                        step=step,
                        begin=begin,
                        end=float(self.data.time),
                        reason=diverged or reason,
                        numbers=numbers,
                    )
                )
                if pictures is not None and not no_picture:
                    name = f"{len(self._checks):02d}-{step.replace(' ', '-')}.png"
                    made = save_picture(self.scene.model, self.data, pictures / name)
                    no_picture = made.reason
                    if made.path is not None:
                        taken[step] = str(made.path)
                if diverged or reason:
                    break
        finally:
            mujoco.set_mju_user_warning(None)
        return self._told(taken, no_picture)

    def _phases(self) -> list[tuple[Step, Callable[[], _Outcome]]]:
        return [
            ("stand", self._stand),
            ("approach", self._approach),
            ("close", self._close),
            ("squeeze", self._squeeze),
            ("verify", lambda: self._verify("verify")),
            ("lift", self._lift),
            ("turn", self._turn),
            ("hold", self._hold),
            ("verify again", lambda: self._verify("verify again")),
            ("carry", self._carry),
            ("lower", self._lower),
            ("release", self._release),
            ("open", self._open),
            ("retreat", self._retreat),
        ]

    def _advance(
        self,
        step: Step,
        duration: float,
        *,
        wait: float = 0.0,
        until: Callable[[bool], bool] | None = None,
    ) -> None:
        """Run a phase for its duration, and longer where something is waited for.

        Args:
            step: Which phase.
            duration: s.
            wait: Longest further time, s.
            until: Whether the phase may end after ``duration``, asked after every step with
                whether all fingers touched; at once if None.
        """
        dt = self.scene.physics.timestep
        steps, longest = max(1, round(duration / dt)), round((duration + wait) / dt)
        begin = float(self.data.time)
        for k in range(max(steps, longest)):
            if self._push is not None and step == "turn":
                since = float(self.data.time) - begin - self._push.after
                pushed = 0.0 <= since < self._push.duration
                force = self._push.force if pushed else np.zeros(3)
                self.data.xfrc_applied[self.scene.object_body, :3] = force
            touching = self._step(_PHASE[step], min(1.0, k / steps))
            if self._steps % self._sample_steps == 0:
                reference = self._driver.reference
                self.watch.take(
                    self.data, step, reference.place, self._driver.holding.T_palm_wanted
                )
            if self._divergence() or (step in _HELD and self._lost()):
                break
            if k + 1 >= steps and (until is None or until(touching)):
                break
        self.data.xfrc_applied[self.scene.object_body] = 0.0
        self._mover.stay()

    def _lost(self) -> bool:
        """Whether nothing of the hand touches the object."""
        return len(hand_contacts(self.scene, self.data)) == 0

    def _stand(self) -> _Outcome:
        self._advance("stand", self._pace.stand)
        return self._undisturbed()

    def _approach(self) -> _Outcome:
        grasp = self._manipulation.motion.grasp
        self._mover.go(grasp.T_world_base, self._pace.approach)
        self._advance("approach", self._pace.approach)
        return self._undisturbed()

    def _close(self) -> _Outcome:
        pace = self._pace
        self._advance("close", pace.close, wait=pace.close_wait, until=lambda touching: touching)
        return self._undisturbed()

    def _squeeze(self) -> _Outcome:
        self._advance("squeeze", self._pace.squeeze)
        self.watch.mark(self.data)
        reason, numbers = self._undisturbed()
        names = self.plan.task.finger_names
        forces = normal_forces(self.scene, self.data, names)
        numbers |= {f"{f}_N": float(n) for f, n in zip(names, forces, strict=True)}
        touching, needed = int((forces > 0).sum()), self.plan.task.fingers_needed
        if touching < needed:
            missing = ", ".join(f for f, n in zip(names, forces, strict=True) if n == 0)
            reason = f"{touching} fingers touch, {needed} are needed; {missing} do not"
        return reason, numbers

    def _verify(self, step: Step) -> _Outcome:
        """Hold on, then analyse the measured contacts by the planner's own code."""
        self._advance(step, self._pace.verify)
        merged = merge_per_finger(hand_contacts(self.scene, self.data))
        if len(merged) == 0:
            return "nothing touches the object", {}
        quality = analyse(merged, length=self.plan.task.object.shape.bounding_radius)
        if step == "verify":
            self._before = quality
        else:
            self._after = quality
        numbers = {
            "contacts": float(len(merged)),
            "min_weight": quality.closure.normalised_min_weight,
            "epsilon": quality.epsilon,
        }
        reason = "" if quality.closure.closed else f"no force closure: {quality.closure.reason}"
        return reason, numbers

    def _lift(self) -> _Outcome:
        pace = self._pace
        base = self._manipulation.motion.T_world_base
        self._mover.go(_raised(base, pace.height), pace.lift)
        self._advance("lift", pace.lift)
        numbers = self._in_hand()
        rise = float(self._object().translation[2] - self.plan.task.T_world_object.translation[2])
        numbers["rise_mm"] = 1e3 * rise
        reason = self._drop() or self._slid(numbers)
        short = 1e3 * pace.height - numbers["rise_mm"]
        if not reason and short > self._bounds.slip_mm:
            reason = f"the object rose {short:.1f} mm less than the hand"
        return reason, numbers

    def _turn(self) -> _Outcome:
        pace, reference = self._pace, self._driver.reference
        self.watch.mark(self.data)
        fastest = abs(reference.goal) / pace.turn_rate
        last = [0.0]

        def still(_: bool) -> bool:
            rate = (reference.left - last[0]) / self.scene.physics.timestep
            last[0] = reference.left
            return reference.left <= CLOSE_TO and abs(rate) < STILL_SPEED

        self._advance("turn", fastest, wait=pace.turn_wait, until=still)
        numbers = self._in_hand()
        return self._drop() or self._stalled(numbers), numbers

    def _hold(self) -> _Outcome:
        before = self._in_hand()
        self._advance("hold", self._pace.hold)
        numbers = self._in_hand()
        numbers["drift_mm"] = abs(numbers["shift_mm"] - before["shift_mm"])
        numbers["drift_deg"] = abs(numbers["turn_deg"] - before["turn_deg"])
        return self._drop() or self._stalled(numbers), numbers

    def _carry(self) -> _Outcome:
        pace, target = self._pace, self._manipulation.T_world_target
        self._mover.go(self._base_for(_raised(target, pace.height)), pace.carry)
        self._advance("carry", pace.carry)
        return self._drop(), self._off_target(pace.height)

    def _lower(self) -> _Outcome:
        self._mover.go(self._base_for(self._manipulation.T_world_target), self._pace.lower)
        self._advance("lower", self._pace.lower)
        return self._drop(), self._off_target(0.0)

    def _release(self) -> _Outcome:
        self._advance("release", self._pace.release)
        return self._placed()

    def _open(self) -> _Outcome:
        self._advance("open", self._pace.open)
        return self._placed()

    def _retreat(self) -> _Outcome:
        release, motion = self._manipulation.release, self._manipulation.motion
        way = release.T_world_base_start.translation - motion.T_world_base.translation
        now = self.scene.body_pose(self.data, self.scene.base_body)
        turn = now.rotation @ motion.T_world_base.rotation.T
        out = SE3(now.rotation, now.translation + turn @ way)
        self._mover.go(out, self._pace.retreat)
        self._advance("retreat", self._pace.retreat)
        reason, numbers = self._placed()
        if not reason and not self._lost():
            reason = "the hand still touches the object"
        return reason, numbers

    def _object(self) -> SE3:
        return self.scene.body_pose(self.data, self.scene.object_body)

    def _base_for(self, T_world_object: SE3) -> SE3:
        """Where the base must be for the object, as it lies in the hand now, to be at a pose."""
        T_world_base = self.scene.body_pose(self.data, self.scene.base_body)
        return T_world_object * self._object().inverse() * T_world_base

    def _undisturbed(self) -> _Outcome:
        """Whether the object stands where it stood before it is held."""
        first, now = self.plan.task.T_world_object, self._object()
        moved = 1e3 * float(np.linalg.norm(now.translation - first.translation))
        tilted = _tilt(first, now)
        reason = ""
        if moved > self._bounds.disturbed_mm or tilted > self._bounds.tilt_deg:
            reason = f"the object was moved by {moved:.1f} mm and tilted by {tilted:.1f} degrees"
        return reason, {"moved_mm": moved, "tilt_deg": tilted}

    def _in_hand(self) -> dict[str, float]:
        """How the object lies in the palm, against the mark."""
        turn, tilt, shift = self.watch.moved(self.data)
        merged = merge_per_finger(hand_contacts(self.scene, self.data))
        return {
            "turn_deg": float(np.rad2deg(turn)),
            "tilt_deg": float(np.rad2deg(tilt)),
            "shift_mm": 1e3 * float(np.linalg.norm(shift)),
            "fingers": float(len(set(merged.fingers) - {""})),
        }

    def _drop(self) -> str:
        """Why the object counts as dropped, "" if it does not."""
        if self._lost():
            gave_up = self._driver.holding.gave_up
            return "the object was dropped" + (f": {gave_up}" if gave_up else "")
        return ""

    def _slid(self, numbers: dict[str, float]) -> str:
        if numbers["shift_mm"] > self._bounds.slip_mm:
            return f"the object moved {numbers['shift_mm']:.1f} mm in the hand"
        return ""

    def _stalled(self, numbers: dict[str, float]) -> str:
        """Why the turn is not what was asked for, "" if it is."""
        asked = float(np.rad2deg(self._manipulation.angle))
        turned, tilt = numbers["turn_deg"], numbers["tilt_deg"]
        if abs(asked - turned) > self._bounds.angle_deg:
            gave_up = self._driver.holding.gave_up
            limited = ", ".join(self._driver.limited_actuators())
            why = gave_up or (f"{limited} had no more to give" if limited else "it did not follow")
            return f"turned {turned:.1f} of {asked:.1f} degrees: {why}"
        if tilt > self._bounds.tilt_deg:
            return f"tilted by {tilt:.1f} degrees off the axis"
        return ""

    def _off_target(self, height: float) -> dict[str, float]:
        """How far the object is from its target, raised by a height (m)."""
        target, now = self._manipulation.T_world_target, self._object()
        off = now.translation - target.translation - [0.0, 0.0, height]
        turn = now.rotation @ target.rotation.T
        return {
            "off_mm": 1e3 * float(np.linalg.norm(off[:2])),
            "above_mm": 1e3 * float(off[2]),
            "heading_deg": float(np.rad2deg(signed_twist(turn, _UP))),
            "tilt_deg": _tilt(target, now),
        }

    def _placed(self) -> _Outcome:
        """Whether the object is where it was to be put."""
        numbers, bounds = self._off_target(0.0), self._bounds
        reason = ""
        if numbers["off_mm"] > bounds.place_mm or abs(numbers["above_mm"]) > bounds.place_mm:
            reason = (
                f"the object is {numbers['off_mm']:.1f} mm beside and {numbers['above_mm']:.1f} mm "
                "above its target"
            )
        elif max(abs(numbers["heading_deg"]), numbers["tilt_deg"]) > bounds.angle_deg:
            reason = (
                f"the object is {numbers['heading_deg']:.1f} degrees off its heading and tilted by "
                f"{numbers['tilt_deg']:.1f}"
            )
        return reason, numbers

    def _told(self, pictures: dict[str, str], no_picture: str) -> ManipulationReport:
        track = self.watch.track()
        planned = _planned_points(self._manipulation, track)
        wanted = np.isfinite(planned[..., 0])
        return ManipulationReport(
            checks=tuple(self._checks),
            complete=len(self._checks) == len(self._phases())
            and all(c.passed for c in self._checks),
            fingers=self.plan.task.finger_names,
            asked=self._manipulation.angle,
            track=track,
            planned_modes=planned_modes(track.time, planned),
            measured_modes=measured_modes(track.time, track.points, track.sliding, wanted),
            before=self._before,
            after=self._after,
            bounds=self._bounds,
            events=self._driver.events,
            pictures=pictures,
            picture_reason=no_picture,
        )


_Outcome = tuple[str, dict[str, float]]

_UP = np.array([0.0, 0.0, 1.0])

_HELD: tuple[Step, ...] = ("lift", "turn", "hold", "verify again", "carry")

CLOSE_TO = np.deg2rad(0.5)
"""A turn this near (rad) to its end is made."""


def manipulate(
    plan: ManipulationPlan,
    *,
    really: GraspTask | None = None,
    physics: PhysicsOptions | None = None,
    sensing: Sensing | None = None,
    pace: Pace | None = None,
    bounds: Bounds | None = None,
    push: Push | None = None,
    pictures: Path | None = None,
) -> ManipulationReport:
    """Execute a plan and judge it.

    Args:
        plan: What to execute.
        really: The task as it really is, where mass or pose differ from the plan's.
        physics: How MuJoCo computes, with the true friction; defaults if None.
        sensing: How well the object is known; exactly and at once if None.
        pace: Durations; defaults if None.
        bounds: Where phases fail; defaults if None.
        push: A disturbance during the turn.
        pictures: Folder for a picture at the end of each phase; it must exist.
    """
    run = ManipulationRun(
        plan,
        really=really,
        physics=physics,
        sensing=sensing,
        pace=pace,
        bounds=bounds,
        push=push,
    )
    return run.perform(pictures=pictures)


def _raised(pose: SE3, height: float) -> SE3:
    return SE3(pose.rotation, pose.translation + [0.0, 0.0, height])


def _tilt(first: SE3, now: SE3) -> float:
    """Angle (degrees) between what was vertical in the object and the vertical."""
    axis = now.rotation @ first.rotation.T @ _UP
    return float(np.rad2deg(np.arccos(np.clip(axis @ _UP, -1.0, 1.0))))


def _planned_points(plan: ManipulationPlan, track: Track) -> FloatArray:
    """Planned contacts (m, n, 3) in the object's frame at every sample; NaN before and after."""
    knots = plan.motion.knots
    points = np.array([k.contacts_in_object.positions for k in knots])
    places = np.array([k.place for k in knots])
    out = np.array(
        [
            [np.interp(track.place, places, points[:, i, j]) for j in range(3)]
            for i in range(points.shape[1])
        ]
    ).transpose(2, 0, 1)
    begin, end = _LOADED_STEPS
    order = {step: k for k, step in enumerate(_PHASE)}
    index = np.array([order[s] for s in track.step])
    out[(index < order[begin]) | (index > order[end])] = np.nan
    return out


_LOADED_STEPS: tuple[Step, Step] = ("verify", "lower")
