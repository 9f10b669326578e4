"""``TurnEnv``: an object is picked up and turned in the hand, as a Gymnasium environment.

    import gymnasium
    env = gymnasium.make("sim.learning.environment:Opposable/Turn-v0", error_model="lab")

An episode is one ``ManipulationRun``, the very protocol by which turns are judged, with its phases
and its verdict. It waits for an action ``rate_hz`` times a second from the squeeze to the release;
before, the fingers close by themselves, and afterwards they open by themselves.

Observations, a dictionary of named senses (float32):

    joints       joints as read (nq,), rad
    targets      commands of the last decision (nu,), rad
    touch        normal force per finger of the hand, N; 0 of those that take no part
    clock        place on the planned path, rate of the turn (rad/s), share of the planned forces,
                 whether the object stands on something, by the phase
    plan         planned posture of now, as it would be read (nq,), rad
    object_pose  only if asked for: object in the hand's base as the camera says, position (m) and
                 quaternion (w, x, y, z)

An action, in [-1, 1] for every actuator, sets joint targets, by one of ``ACTIONS``:

    playback     the plan's commands of the moment plus ``ACTION_SCALE`` times the action; 0 is the
                 open loop
    increment    the last targets plus ``INCREMENT`` times the action
    absolute     the action as a share of the commands' range

The reward of a step is the progress of the turn as a share of the one asked for, counted to 1; the
last step adds 1 if the verdict is a success with closure.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeAlias

import gymnasium
import numpy as np
import pinocchio as pin
from greenlet import GreenletExit, getcurrent, greenlet  # switches inside one thread
from gymnasium.spaces import Box, Dict
from numpy.typing import NDArray

from planner.errors import NotFoundError, TaskError, shown
from planner.plan import GraspPlan
from planner.spatial import FloatArray
from sim.controllers import Observation
from sim.learning.controller import PolicyController
from sim.learning.policy import RATE_HZ
from sim.learning.trials import Conditions, Plans, TurnTask
from sim.manipulation import ManipulationReport, ManipulationRun
from sim.scene.physics import PhysicsOptions
from sim.sensing.errors import named_errors

ENVIRONMENT = "Opposable/Turn-v0"
"""Name under which it is registered when this module is imported."""

ACTIONS = ("playback", "increment", "absolute")
"""What an action can mean."""

ALWAYS, OPTIONAL = ("joints", "targets", "touch", "clock", "plan"), ("object_pose",)
"""Senses that there always are, and that there are if asked for."""

INCREMENT = 0.05
"""Change (rad) of a joint target by an action of 1 in mode "increment": 5 rad/s at 100 Hz."""

MOST_TOUCH, MOST_RATE, BEYOND = 100.0, 10.0, 1.0
"""Bounds of the observation space: N, rad/s, and rad beyond the joints' ranges."""

REDRAWS = 20
"""Trials that are drawn, at most, until one comes to the first action."""

SenseData: TypeAlias = dict[str, NDArray[np.float32]]


RATE_TOL = 1e-9
"""Rates (Hz) that differ by less are the same: rounding."""


class TurnEnv(gymnasium.Env[SenseData, NDArray[Any]]):
    """Turning an object in the hand; see the module."""

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012, an attribute of Gymnasium's

    def __init__(
        self,
        *,
        hand: str = "allegro_hand",
        objects: str = "cylinder:0.025..0.035x0.08",
        angle_deg: float = 90.0,
        error_model: str = "ideal",
        senses: Sequence[str] = (),
        action: str = "playback",
        rate_hz: float = RATE_HZ,
        plans: int = 4,
        folder: Path | str | None = None,
        seed: int = 0,
        render_mode: str | None = None,
    ) -> None:
        """Prepare spaces; plans are made when they are first drawn, in some seconds each.

        Args:
            hand: Name or path of the hand; its actuators must be position servos.
            objects: Objects as ``sim.learning.ObjectRange`` takes them.
            angle_deg: Turn about the vertical that is asked for, degrees.
            error_model: Name of the errors of sensors, drives and object.
            senses: More senses, of ``object_pose``.
            action: What an action means: playback, increment or absolute.
            rate_hz: Actions per second.
            plans: How many different plans episodes draw from.
            folder: Where plans are kept; in memory if None.
            seed: Of the plans; ``reset`` has its own for all that is drawn.
            render_mode: None: films are drawn by ``opposable manipulate --controller``.

        Raises:
            NotFoundError: No such hand, error model, sense or meaning of an action.
            TaskError: A number that is not positive, or senses that are no list.
        """
        if action not in ACTIONS:
            raise NotFoundError("meaning of an action", action, ACTIONS)
        if isinstance(senses, str):
            raise TaskError(f"senses is {shown(senses)}; give a list of names: [{shown(senses)}]")
        for name in senses:
            if name not in (*ALWAYS, *OPTIONAL):
                raise NotFoundError("sense of the environment", name, (*ALWAYS, *OPTIONAL))
        if not (isinstance(plans, int) and plans >= 1):
            raise TaskError(f"plans is {shown(plans)}; give an integer >= 1")
        if not (math.isfinite(rate_hz) and rate_hz > 0):
            raise TaskError(f"rate_hz is {rate_hz}; give actions per second, above 0")
        most = 1.0 / PhysicsOptions().timestep
        if rate_hz > most + RATE_TOL:
            raise TaskError(
                f"rate_hz is {rate_hz:g}, and there are {most:g} time steps per second; give at "
                "most so many actions"
            )
        self.render_mode = render_mode
        self.task = TurnTask(
            hand=hand,
            objects=objects,
            angle=math.radians(angle_deg),
            error_model=named_errors(error_model),
            seed=seed,
        )
        self._plans = _shared_plans(self.task, None if folder is None else Path(folder))
        self._count, self._rate, self._meaning = plans, rate_hz, action
        self._sees_pose = "object_pose" in senses
        self._course: Any = None
        self._run: ManipulationRun | None = None
        self._external: _External | None = None
        self._progress = 0.0
        self._set_spaces()

    def _set_spaces(self) -> None:
        hand = self._plans.hand
        nq, nu = hand.nq, len(hand.actuation.names)

        def box(low: Any, high: Any, n: int) -> Any:
            least, most = (np.broadcast_to(np.asarray(v, np.float32), n) for v in (low, high))
            return Box(least, most, dtype=np.float32)

        reach = hand.q_lower - BEYOND, hand.q_upper + BEYOND
        least, most = hand.actuation.ctrl_range.T
        spaces = {
            "joints": box(*reach, nq),
            "targets": box(least, most, nu),
            "touch": box(0.0, MOST_TOUCH, len(hand.fingers)),
            "clock": box(0.0, [1.0, MOST_RATE, 1.0, 1.0], 4),
            "plan": box(*reach, nq),
        }
        if self._sees_pose:
            spaces["object_pose"] = box(-BEYOND, BEYOND, 7)
        self._spaces: dict[str, Any] = spaces
        self.observation_space: Any = Dict(spaces)
        self.action_space: Any = box(-1.0, 1.0, nu)

    # ---- Gymnasium

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[SenseData, dict[str, Any]]:
        """Draw a trial, and close the fingers.

        Args:
            seed: Of plan and conditions; goes on with the last one's numbers if None.
            options: ``{"plan": k}`` takes the plan of that number, an integer >= 0; one beyond
                ``plans`` is made.

        Returns:
            The observation, and what was drawn: ``plan`` and ``object``; and ``redrawn``, how many
            trials ended before the first action, as where a finger pushed the object over.

        Raises:
            TaskError: No trial came to the first action, or another option than that.
        """
        requested = _requested_plan(options or {})
        super().reset(seed=seed)
        self.close()
        for redrawn in range(REDRAWS):
            drawn = int(self.np_random.integers(self._count))
            number = drawn if requested is None else requested
            conditions = Conditions.draw(self.np_random)
            plan = self._plans(number)
            self._external = _External(plan.grasp, self._rate, self._meaning)
            self._run = conditions.run(self.task, plan, self._external)
            self._course, self._progress = greenlet(self._run.perform), 0.0
            if self._course.switch() is None:
                about = {"plan": number, "object": plan.task.object.shape.spec, "redrawn": redrawn}
                return self._observation(), about
        raise TaskError(
            f"{REDRAWS} trials of {self.task.objects} ended before the first action; give another "
            "object or a milder error model"
        )

    def step(self, action: NDArray[Any]) -> tuple[SenseData, float, bool, bool, dict[str, Any]]:
        """Act until the next decision, or until the end of the run.

        Returns:
            Observation, reward, whether the run has ended, False, and at the end ``success``
            (with closure), ``is_success`` (the same), ``reason`` and ``turned_deg``.

        Raises:
            TaskError: An action of another shape or not finite, or no episode under way.
        """
        if self._course is None or self._course.dead:
            raise TaskError("no episode is under way; call reset first")
        command = np.asarray(action, dtype=np.float64)
        shape = self.action_space.shape
        if command.shape != shape:
            raise TaskError(f"the action has shape {command.shape}; give one of shape {shape}")
        if not np.isfinite(command).all():
            raise TaskError("the action has numbers that are not finite; give numbers in [-1, 1]")
        report = self._course.switch(np.clip(command, -1.0, 1.0))
        reward = self._reward()
        if report is None:
            return self._observation(), reward, False, False, {}
        return (
            self._observation(),
            reward + report.success_with_closure,
            True,
            False,
            _verdict(report),
        )

    def close(self) -> None:
        """End the episode that is under way."""
        if self._course is not None and not self._course.dead:
            self._course.throw(GreenletExit)
        self._course = None

    # ---- parts

    def _reward(self) -> float:
        """Progress of the turn since the last step, as a share of all of it."""
        assert self._run is not None and self._external is not None
        if self._external.seen is None or self._external.seen.phase not in ("turn", "hold"):
            return 0.0
        turned = self._run.sim.recorder.moved()[0]
        before = self._progress
        self._progress = float(np.clip(turned / self.task.angle, 0.0, 1.0))
        return self._progress - before

    def _observation(self) -> SenseData:
        assert self._external is not None
        known = self._external.senses()
        if self._sees_pose:
            seen = self._external.seen
            assert seen is not None
            pose = pin.SE3ToXYZQUAT(seen.T_world_base.inverse() * seen.T_world_object)
            known["object_pose"] = pose[[0, 1, 2, 6, 3, 4, 5]]
        out = {}
        for name, space in self._spaces.items():
            value = known[name].astype(np.float32)
            out[name] = np.clip(value, space.low, space.high)
        return out


class _External(PolicyController):
    """A controller whose decisions come from outside: it lets the environment's caller go on."""

    def __init__(self, plan: GraspPlan, rate_hz: float, meaning: str) -> None:
        plan.task.require_fingertips("the environment")
        super().__init__(plan)
        self.period = 1.0 / rate_hz
        self.seen: Observation | None = None
        self._meaning = meaning
        self._target: FloatArray = np.zeros(len(self.action))
        hand = plan.task.hand
        self._fingers = [list(hand.fingers).index(name) for name in plan.task.finger_names]
        self._touch = np.zeros(len(hand.fingers))

    def decide(self, observation: Observation) -> FloatArray:
        """What the caller of ``step`` gives."""
        if self.seen is None:
            self._target = super().commands(observation)
        self.seen = observation
        action: FloatArray = getcurrent().parent.switch(None)
        low, high = self._range.T
        if self._meaning == "increment":
            self._target = np.clip(self._target + INCREMENT * action, low, high)
        elif self._meaning == "absolute":
            self._target = low + 0.5 * (action + 1.0) * (high - low)
        return action

    def commands(self, observation: Observation) -> FloatArray:
        """Commands (nu,) by the meaning of actions."""
        if self._meaning == "playback":
            self._target = super().commands(observation)
        return self._target

    def senses(self) -> dict[str, FloatArray]:
        """The senses at the last decision."""
        seen, play = self.seen, self.playback
        assert seen is not None
        self._touch[self._fingers] = seen.normal_forces
        clock = [play.place, play.rate, play.share, float(play.standing)]
        return {
            "joints": seen.q,
            "targets": self._target,
            "touch": self._touch,
            "clock": np.array(clock),
            "plan": play.q,
        }


_shared_plans = lru_cache(maxsize=8)(Plans)
"""The environments of one process share their plans."""


def _requested_plan(options: dict[str, Any]) -> int | None:
    """Number of the plan that options ask for; None if they do not."""
    if unknown := sorted(set(options) - {"plan"}):
        raise TaskError(f"no option of reset is called {', '.join(unknown)}; there is: plan")
    number = options.get("plan")
    if number is None:
        return None
    if not (isinstance(number, int | np.integer) and number >= 0):
        raise TaskError(f"the option plan is {shown(number)}; give an integer >= 0")
    return int(number)


def _verdict(report: ManipulationReport) -> dict[str, Any]:
    good = report.success_with_closure
    return {
        "success": good,
        "is_success": good,
        "reason": report.reason or report.faults,
        "turned_deg": math.degrees(report.turned),
    }


if ENVIRONMENT not in gymnasium.registry:
    gymnasium.register(id=ENVIRONMENT, entry_point="sim.learning.environment:TurnEnv")
