"""``turn``: the loop that turns an object in the palm of a plant to a rotation, and what it saw.

The horizon of the controller is too short to see that a finger has to go round the object, or that
a push ends beyond the fingers. So every ``ahead_s`` the loop looks further: it tries on a copy of
the simulation what comes of going on, and, unless that gains, of opening the fingers first to
postures near the one in which they began, drawn by the seed. The best is done (a rollout of the
controller; Bertsekas, Rollout algorithms). Within ``still_deg`` of the goal the commands stay.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import mujoco
import numpy as np
import pinocchio as pin

from planner.spatial import FloatArray, IntArray
from sim.palm.control import PalmController
from sim.palm.model import Plant
from sim.palm.report import Outcome
from sim.palm.settings import PalmSettings

STILL_SHARE = 0.7
"""Largest share (-) of the tolerance at which the commands stay: 3.5 of 5 degrees."""

SINK = 0.06
"""How far (m) below where it began an object is dropped: the thickness of a palm and a finger."""


FRICTIONS = (5 / 6, 7 / 6, 11 / 12)
"""Shares (-) of the friction with which a look ahead is made, and made again before it is done: the
friction that there is need not be known better."""

AGAIN = (0.87, 0.97, 1.03, 1.13)
"""Shares (-) of the friction with which a branch is tried once more where its ends with
``FRICTIONS`` are further apart than ``ALIKE_DEG``; each that drops the object adds its share of
``LOST_DEG``. Two cubes high on the fingers were dropped by what three frictions had let pass; of 28
trials with other frictions and steps from one of these states 7 drop it."""

ALIKE_DEG = 10.0
"""Difference (degrees) of costs up to which ends with other frictions are the same end."""

FINALISTS = 4
"""Branches that are tried with the other frictions (-): those that end best with the first."""

WIDEST = 6
"""Times (-) ``scatter_rad`` that openings are drawn with at most: with each look that finds the
object where it was they become wider. A cube jammed between fingers was held at 92 degrees for
280 s by openings of one width."""

NEAR = 0.3
"""Share (-) of the cost that is left which counts as progress, where this is less than
``progress_deg``. At 6 degrees a gain of 3 is impossible: the commands stay from 3.5 degrees on."""

ONWARD = 4
"""Openings (-) that are tried at the end of a branch which gains nothing: one of each target."""

LOST_DEG = 180.0
"""What (degrees) it costs to be dropped with all of ``AGAIN``, as much as any angle; and to end
where each opening drops the object, of which half counts, in the mean of before and after."""

REST_S = 0.3
"""Time (s) after a branch in which an object that was thrown would fall out of the hand, and in
which one that rolls gets further: it must still be there then, and its place counts then too."""

LOOK_STEP_S = 0.004
"""Least step (s) of the simulation where branches are first compared: half the time of the scene's
2 ms, and ends of 0.6 s differ by 2 mm in the median. What is tried again has the scene's own step:
going on with a cube at 147 degrees ended at 114 to 142 with 4 ms, and at 220 in most of 24 trials
with 2 ms."""

ROUNDING_S = 1e-9
"""Difference (s) of times that are the same but for rounding."""

SAME_RAD = 1e-9
"""Angle (rad) between rotations that are the same."""


Progress: TypeAlias = Callable[[float, float], object]
"""Takes the time (s) since the object lay still and the angle to the goal (degrees)."""


@dataclass(kw_only=True, eq=False)
class TurnLog:
    """What happened, a row per period.

    Attributes:
        time: s, at the end of each period.
        error_deg: Angle to the goal.
        phase: "turn", "open" or "still".
        qpos: States (nqpos,) of the model.
        solve_s: CPU time of each solve, s.
        look_s: CPU time of each look ahead, s.
        outcome: How it ended.
    """

    time: list[float] = field(default_factory=list)
    error_deg: list[float] = field(default_factory=list)
    phase: list[str] = field(default_factory=list)
    qpos: list[FloatArray] = field(default_factory=list)
    solve_s: list[float] = field(default_factory=list)
    look_s: list[float] = field(default_factory=list)
    outcome: Outcome = "not in time"


@dataclass(frozen=True, kw_only=True, eq=False)
class _Branch:
    """What is done until a time (s): the fingers open to commands ``away`` first, unless None.

    ``goal`` (3, 3) and ``place`` (3,) are what the controller is asked for; nothing moves if it
    ``rests``.
    """

    away: FloatArray | None
    goal: FloatArray
    place: FloatArray
    opens_until: float
    until: float
    rests: bool = False


class _Driver:
    """Moves the plant on, a period at a time, in the simulation or in a look ahead."""

    def __init__(
        self,
        plant: Plant,
        goal: FloatArray,
        place: FloatArray,
        settings: PalmSettings,
        begun: FloatArray,
        within: float,
    ) -> None:
        self.plant, self.goal, self.place, self.settings = plant, goal, place, settings
        self.begun, self.within = begun, within
        self.controller = PalmController(plant, settings)
        self.solve_s: list[float] = []

    def twin(self) -> _Driver:
        """Another with a controller of its own."""
        given = (self.plant, self.goal, self.place, self.settings, self.begun, self.within)
        return _Driver(*given)

    def phase(self, data: Any, branch: _Branch) -> str:
        """What is done from now on."""
        if data.time < branch.opens_until - ROUNDING_S:
            if branch.rests:
                return "still"
            if branch.away is not None:
                return "open"
        return "still" if angle_deg(self.plant, data, self.goal) <= self.within else "turn"

    def period(
        self, model: Any, data: Any, branch: _Branch, on_step: Callable[[], None] | None = None
    ) -> str:
        """Move on by a period, and say in which phase."""
        plant, asked, phase = self.plant, self.settings, self.phase(data, branch)
        command = data.ctrl[plant.ctrl].copy()
        new = command
        if phase == "turn":
            # from where the servos are: a squeeze that is stored throws the object out
            command = plant.moment @ data.qpos[plant.qpos]
            command[plant.idle] = self.begun[plant.idle]  # a wrist that sags would sag further
            start = time.thread_time()
            new = self.controller.command(data.qpos, command, branch.goal, branch.place)
            self.solve_s.append(time.thread_time() - start)
            new = self.controller.held_back(new, command)
            new[plant.idle] = self.begun[plant.idle]
            command = new
        elif phase == "open":
            self.controller.forget()
            most = asked.period_s / asked.step_s * asked.command_rad
            new = command + np.clip(branch.away - command, -most, most)
        steps = max(1, round(asked.period_s / model.opt.timestep))
        for k in range(steps):
            data.ctrl[plant.ctrl] = command + (k + 1) / steps * (new - command)
            mujoco.mj_step(model, data)
            if on_step is not None:
                on_step()
        return phase


class _LookAhead:
    """Tries branches on copies of the simulation, with less and with more friction."""

    def __init__(self, driver: _Driver, low: float, seed: int, caged: bool = False) -> None:
        self._real, self._low, self._rng = driver, low, np.random.default_rng(seed)
        self._caged = caged
        model = driver.plant.model
        steps = [max(model.opt.timestep, LOOK_STEP_S)]
        steps += [model.opt.timestep] * (len(FRICTIONS) - 1 + len(AGAIN))
        shares = (*FRICTIONS, *AGAIN)
        self._models = [
            _rubbed(model, share, step) for share, step in zip(shares, steps, strict=True)
        ]
        self._data, self._end = (mujoco.MjData(driver.plant.model) for _ in range(2))
        self._trial = driver.twin()
        self._best, self._since = np.inf, -np.inf
        self._last, self._unmoved = np.inf, 0
        self._fingers = _servos_of_fingers(driver.plant)

    def choose(self, data: Any) -> _Branch:
        """What to do from a state on.

        Going on, or turning the object where it lies, where that gains ``progress_deg`` or
        ``NEAR`` of what is left, if that is less; else the branch with the least cost at its end
        with the worst friction, without going on once nothing has been gained for ``stall_s``.
        Where that costs ``lapse_deg`` more than now, the object lies on the fingers: some of them
        stay then while others open. Where nothing gains, what another opening makes of the end
        counts too. Where all costs ``lapse_deg`` more, fingers stay, and others are drawn later.
        """
        asked, now = self._real.settings, float(data.time)
        here = self._cost(data)
        gain = min(asked.progress_deg, NEAR * here)
        if here < self._best - gain:
            self._best, self._since = here, now
        stuck = now - self._since > asked.stall_s
        unmoved = abs(here - self._last) < gain
        self._last, self._unmoved = here, self._unmoved + 1 if unmoved else 0
        on = self._onwards(data, self._real.place)
        found, gained = [], here - gain
        for one in [on, *self._staying(data)]:
            first = self.value(0, data, one)
            if first < gained and self._risk(data, one, first, self.value(1, data, one)) < gained:
                return one
            found.append((first, one))
        branches = self._worst(data, self._openings(data), [] if stuck else found, gained)
        if branches[0][0] > here + asked.lapse_deg:
            branches += self._worst(data, self._openings(data, some=True), [], gained)
        branches = [pair for pair in branches if pair[0] < np.inf]
        if all(value >= gained for value, _ in branches):  # what comes after counts as much
            branches = [
                (0.5 * (value + self._onward(data, one, value)), one) for value, one in branches
            ]
        if stuck:
            self._best, self._since = np.inf, now
        value, best = min(branches, key=lambda pair: pair[0], default=(np.inf, on))
        if value <= here + asked.lapse_deg * (1 + self._unmoved):
            return best
        end = now + asked.open_s + asked.ahead_s
        return replace(on, opens_until=end, until=end, rests=True)

    def _onwards(self, data: Any, place: FloatArray) -> _Branch:
        """Going on to the goal, with the object at a place (3,)."""
        now = float(data.time)
        until = now + self._real.settings.ahead_s
        return _Branch(away=None, goal=self._real.goal, place=place, opens_until=now, until=until)

    def _staying(self, data: Any) -> list[_Branch]:
        """Turning an object that lies off its place where it lies: the way back may be barred."""
        if self._off(data) <= self._real.settings.free_m:
            return []
        return [self._onwards(data, data.xpos[self._real.plant.object_body].copy())]

    def _risk(self, data: Any, branch: _Branch, *costs: float) -> float:
        """The worst of the costs of a branch, and what it costs that it may drop the object."""
        worst = max(costs)
        if not ALIKE_DEG <= worst - min(costs) < np.inf:
            return worst
        again = range(len(FRICTIONS), len(self._models))
        drops = [self.value(which, data, branch) == np.inf for which in again]
        return worst + LOST_DEG * float(np.mean(drops))

    def _worst(
        self,
        data: Any,
        branches: list[_Branch],
        found: list[tuple[float, _Branch]],
        enough: float,
    ) -> list[tuple[float, _Branch]]:
        """The best branches by their costs with the worst friction, the least first.

        Some were ``found`` with the first friction before. One that costs less than ``enough``, and
        no more than others do with the first friction, ends the search.
        """
        found = found + [(self.value(0, data, branch), branch) for branch in branches]
        found.sort(key=lambda pair: pair[0])
        worst: list[tuple[float, _Branch]] = []
        for least, branch in found[:FINALISTS]:
            if worst and worst[0][0] < min(enough, least):
                break
            costs = [least]
            for which in range(1, len(FRICTIONS)):
                if costs[-1] < np.inf:
                    costs.append(self.value(which, data, branch))
            cost = self._risk(data, branch, *costs)
            worst = sorted([*worst, (cost, branch)], key=lambda pair: pair[0])
        return worst

    def _onward(self, data: Any, branch: _Branch, value: float) -> float:
        """Least cost after another opening at the end of a branch; ``LOST_DEG`` where all drop."""
        self.value(0, data, branch)
        mujoco.mj_copyData(self._end, self._models[0], self._data)
        for some in (False, True):
            openings = self._openings(self._end, some)[:ONWARD]
            least = min(self.value(0, self._end, one) for one in openings)
            if least < np.inf:
                return least
        return value + LOST_DEG

    def _openings(self, data: Any, some: bool = False) -> list[_Branch]:
        """Branches that open fingers to postures near the first, and ask for targets in turn.

        Of ``some`` each opens about half of the fingers, and the others stay. So it is in every
        other round of targets of what is ``caged``: when all open a ball turns back with them.
        """
        real, asked, now = self._real, self._real.settings, float(data.time)
        width = asked.scatter_rad * min(1 + self._unmoved, WIDEST)
        scatter = width * self._rng.standard_normal((asked.branches, len(real.begun)))
        scatter[:, real.plant.idle] = 0.0
        opens, targets = now + asked.open_s, self._targets(data)
        away = real.begun + scatter
        if some or self._caged:
            opened = self._rng.random((asked.branches, len(self._fingers))) < 0.5
            if not some:
                opened[np.arange(asked.branches) // len(targets) % 2 == 0] = True
            moves = opened.astype(int) @ self._fingers > 0
            away = np.where(moves, away, data.ctrl[real.plant.ctrl])
        return [
            _Branch(
                away=one,
                goal=targets[k % len(targets)],
                place=real.place,
                opens_until=opens,
                until=opens + asked.ahead_s,
            )
            for k, one in enumerate(away)
        ]

    def _targets(self, data: Any) -> list[FloatArray]:
        """Rotations (3, 3) that branches ask for; what comes of them is judged by the goal.

        The goal; where the object lies away from where fingers reach, the rotation that it has, so
        that only its place is to change; beyond the goal, for a turn that is held up before it, by
        a quarter turn at most: where more than that is left, this is the other way round; and one
        beside the goal, for a way on which fingers cannot turn it.
        """
        goal, asked = self._real.goal, self._real.settings
        here = data.xmat[self._real.plant.object_body].reshape(3, 3).copy()
        left = pin.log3(goal @ here.T)
        angle = max(float(np.linalg.norm(left)), SAME_RAD)
        beyond = pin.exp3(min(asked.beyond, np.pi / 2 / angle) * left) @ goal
        beside = pin.exp3(asked.beside_rad * self._rng.standard_normal(3)) @ goal
        return [goal, here if self._off(data) > asked.free_m else goal, beyond, beside]

    def value(self, which: int, data: Any, branch: _Branch) -> float:
        """Cost (degrees) at the end of a branch; infinite where the object is dropped.

        Args:
            which: Index of the friction in ``FRICTIONS``.
            data: Where it begins; not moved on.
            branch: What is done.
        """
        model, ahead = self._models[which], self._data
        mujoco.mj_copyData(ahead, model, data)
        self._trial.controller.adopt(self._real.controller)
        while ahead.time < branch.until - ROUNDING_S:
            self._trial.period(model, ahead, branch)
            if self._lost(ahead):
                return np.inf
        cost = self._cost(ahead)
        mujoco.mj_step(model, ahead, round(REST_S / model.opt.timestep))
        return np.inf if self._lost(ahead) else max(cost, self._cost(ahead))

    def _lost(self, data: Any) -> bool:
        height = data.xpos[self._real.plant.object_body][2]
        return not np.isfinite(data.qpos).all() or bool(height < self._low)

    def _off(self, data: Any) -> float:
        """Distance (m) of the object to its place."""
        return float(np.linalg.norm(data.xpos[self._real.plant.object_body] - self._real.place))

    def _cost(self, data: Any) -> float:
        """Angle (degrees) to the goal, and what it costs to lie away from where fingers reach.

        At the goal the place costs nothing: nothing moves any more.
        """
        real, free = self._real, self._real.settings.free_m
        angle = angle_deg(real.plant, data, real.goal)
        if angle <= real.within:
            return angle
        far = max(0.0, self._off(data) - free)
        return angle + real.settings.far_deg * far * (1.0 + far / free)


def _servos_of_fingers(plant: Plant) -> IntArray:
    """For each fingertip, the servos (nu,) that move it, as 0 and 1."""
    rows = []
    for tip, _ in plant.tips:
        chain, body = np.zeros(plant.model.nv, dtype=bool), tip
        while body:
            first = plant.model.body_dofadr[body]
            chain[first : first + plant.model.body_dofnum[body]] = True
            body = plant.model.body_parentid[body]
        rows.append((plant.moment[:, chain[plant.dof]] != 0).any(axis=1))
    return np.array(rows, dtype=int)


def _rubbed(model: Any, share: float, step_s: float) -> Any:
    """A copy of a model with a share of its sliding friction, and steps of its own."""
    rubbed = copy.copy(model)
    rubbed.opt.timestep = step_s
    rubbed.geom_friction[:, 0] *= share
    rubbed.pair_friction[:, :2] *= share
    return rubbed


def turn(
    plant: Plant,
    data: Any,
    goal: FloatArray,
    place: FloatArray,
    *,
    settings: PalmSettings,
    tolerance_deg: float,
    hold_s: float,
    longest_s: float,
    seed: int,
    caged: bool = False,
    on_step: Callable[[], None] | None = None,
    progress: Progress | None = None,
) -> TurnLog:
    """Turn the object until it has stayed at the goal, was dropped, or the time is over.

    Ctrl-C ends it too, with what there is.

    Args:
        plant: Hand and object; its servos have the commands of ``data.ctrl``.
        data: ``mujoco.MjData``; moved on.
        goal: Rotation (3, 3) of the object, world.
        place: Where its centre is to be (3,), m, world.
        settings: Of the controller.
        tolerance_deg: Largest angle to the goal that counts as there.
        hold_s: How long it has to be there in one go, s.
        longest_s: Simulated time after which it has failed, s.
        seed: Of the postures to which fingers may open.
        caged: Whether the fingers cage the object: in half of the openings some stay then.
        on_step: Called after every step of the simulation.
        progress: Told how far it is, after every period.

    Raises:
        KeyboardInterrupt: It was interrupted before the end of the first period.
    """
    model, log = plant.model, TurnLog()
    begun, began_at = data.ctrl[plant.ctrl].copy(), float(data.time)
    low = float(data.xpos[plant.object_body][2]) - SINK
    within = min(settings.still_deg, STILL_SHARE * tolerance_deg)
    driver = _Driver(plant, goal, place, settings, begun, within)
    look = _LookAhead(driver, low, seed, caged)
    branch = _Branch(away=None, goal=goal, place=place, opens_until=-np.inf, until=-np.inf)
    held = 0.0
    while data.time - began_at < longest_s:
        try:
            if data.time >= branch.until - ROUNDING_S and driver.phase(data, branch) == "turn":
                start = time.thread_time()
                branch = look.choose(data)
                log.look_s.append(time.thread_time() - start)
            phase = driver.period(model, data, branch, on_step)
        except KeyboardInterrupt:
            if not log.time:
                raise
            log.outcome = "interrupted"
            break
        error = angle_deg(plant, data, goal)
        log.time.append(float(data.time) - began_at)
        log.error_deg.append(error)
        log.phase.append(phase)
        log.qpos.append(data.qpos.copy())
        if progress is not None:
            progress(log.time[-1], error)
        held = held + settings.period_s if error <= tolerance_deg else 0.0
        if not np.isfinite(data.qpos).all():
            log.outcome = "diverged"
        elif data.xpos[plant.object_body][2] < low:
            log.outcome = "dropped"
        elif held >= hold_s - 0.5 * model.opt.timestep:
            log.outcome = "reached"
        if log.outcome != "not in time":
            break
    log.solve_s = driver.solve_s
    return log


def angle_deg(plant: Plant, data: Any, goal: FloatArray) -> float:
    """Angle (degrees) of the object to a rotation (3, 3)."""
    now = data.xmat[plant.object_body].reshape(3, 3)
    return float(np.degrees(np.linalg.norm(pin.log3(goal @ now.T))))
