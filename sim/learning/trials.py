"""Trials of turns to learn from: plans over a range of objects, and conditions that are drawn.

The conditions are those of ``python -m benchmarks manipulate``: mass, friction, where the object
really stands, and a push during the turn. The planner knows the size, the largest mass and the
least friction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from planner.arrays import check_fields
from planner.contacts import MOST_FRICTION
from planner.errors import NoGraspFoundError, TaskError
from planner.files import read_manipulation, write_manipulation
from planner.files.movements import manipulation_from_dict, movement_to_dict
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.motion.manipulation import (
    ONE_STROKE,
    ManipulationPlan,
    manipulation_task,
    plan_manipulation,
)
from planner.objects import parse_object
from planner.spatial import SE3
from planner.task import GraspTask
from sim.learning.senses import ObjectRange
from sim.manipulation import ManipulationRun, Push, rests, settled
from sim.manipulation.in_hand import AnyTurningController
from sim.scene.physics import PhysicsOptions
from sim.sensing.errors import ERROR_MODELS, IDEAL, ErrorModel

FRICTION, MASS = (0.5, 1.0), (0.05, 0.3)
"""True sliding friction (-) and mass (kg), as in ``benchmarks.conditions``."""

BELIEVED_MU = 0.9 * FRICTION[0]
"""Friction (-) that is planned for, as there."""

SHIFT, HEADING = 0.003, math.radians(5.0)
"""Largest error of the object's place along x and y (m), and of its heading (rad), as there."""

PUSH_FORCE, PUSH_TIME, PUSH_UNTIL = 0.4, 0.3, 1.2
"""Force (N), duration (s) and latest beginning (s after the turn began) of the push, as there."""

TRIES = 3
"""Seeds that are tried for a plan, each with the next size of the range."""

PLAN_SEEDS = 10**6
"""First seed of plans: far from those that a bench begins with, so that no plan is trained on and
measured with."""

GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
"""Multiples of it, modulo 1, cover a range evenly however many there are."""


@dataclass(frozen=True, kw_only=True)
class TurnTask:
    """What is learned.

    Attributes:
        hand: Name or path of the hand.
        objects: Objects; a dimension ``a..b`` is a range.
        angle: Turn about the vertical that is asked for, rad.
        error_model: Errors of sensors, drives and object.
        physics: How MuJoCo computes; friction is drawn.
        seed: Of plans.
    """

    hand: str
    objects: str
    angle: float = math.pi / 2
    error_model: ErrorModel = ERROR_MODELS[IDEAL]
    physics: PhysicsOptions = field(default_factory=PhysicsOptions)
    seed: int = 0

    def __post_init__(self) -> None:
        """Check objects, angle and seed.

        Raises:
            PlannerError: No object, no turn that one stroke can make, or no seed.
        """
        ObjectRange(self.objects)
        check_fields(self, ("angle",), unit="rad")
        if not 0.0 < abs(self.angle) <= ONE_STROKE:
            raise TaskError(
                f"the turn is {math.degrees(self.angle):g} degrees, and a policy is trained for "
                f"turns without a regrasp; give up to {math.degrees(ONE_STROKE):.0f} degrees "
                "either way, not 0"
            )
        check_fields(self, ("seed",), what="the ")


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """What there really is in one trial.

    Attributes:
        mass: kg.
        mu: Sliding friction (-).
        shift: Where the object stands less where it is believed to, x and y, m.
        heading: The same of its heading, rad.
        push: Force of the push, x and y, N.
        push_after: Its beginning, s after the turn began.
        seed: Of what the error model draws.
    """

    mass: float
    mu: float
    shift: tuple[float, float]
    heading: float
    push: tuple[float, float]
    push_after: float
    seed: int

    def __post_init__(self) -> None:
        """Check every number."""
        check_fields(self, ("mass",), above=0.0, unit="kg")
        check_fields(self, ("mu",), least=0.0, most=MOST_FRICTION)
        check_fields(self, ("shift", "heading", "push"))
        check_fields(self, ("push_after",), least=0.0, unit="s")
        check_fields(self, ("seed",))

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Conditions:
        """Conditions of one trial."""
        mass, mu = float(rng.uniform(*MASS)), float(rng.uniform(*FRICTION))
        x, y = rng.uniform(-SHIFT, SHIFT, size=2).tolist()
        heading = float(rng.uniform(-HEADING, HEADING))
        way = float(rng.uniform(0.0, 2.0 * np.pi))
        return cls(
            mass=mass,
            mu=mu,
            shift=(x, y),
            heading=heading,
            push=(PUSH_FORCE * math.cos(way), PUSH_FORCE * math.sin(way)),
            push_after=float(rng.uniform(0.0, PUSH_UNTIL)),
            seed=int(rng.integers(2**31)),
        )

    def run(
        self, task: TurnTask, plan: ManipulationPlan, controller: AnyTurningController
    ) -> ManipulationRun:
        """The execution of a plan under these conditions, not begun yet."""
        return ManipulationRun(
            plan,
            controller=controller,
            true_task=true_task(plan.task, self.mass, self.shift, self.heading),
            physics=replace(task.physics, mu=self.mu),
            push=Push(force=np.array([*self.push, 0.0]), after=self.push_after, duration=PUSH_TIME),
            error_model=task.error_model.seeded(self.seed),
        )


def true_task(
    task: GraspTask, mass: float, shift: tuple[float, float], heading: float
) -> GraspTask:
    """What there really is: the object has another mass, and stands aside, with what it stands on.

    Args:
        task: What is believed.
        mass: Of the object, kg.
        shift: Of the object and of obstacles along x and y, m, world.
        heading: By how much the object is turned about the vertical, rad.
    """
    pose, aside = task.T_world_object, np.array([*shift, 0.0])
    turned = pin.exp3(np.array([0.0, 0.0, heading])) @ pose.rotation
    return replace(
        task,
        object=replace(task.object, mass=mass),
        T_world_object=SE3(turned, pose.translation + aside),
        obstacles=tuple(o.moved(aside) for o in task.obstacles),
    )


class Plans:
    """Plans of a task, made when first asked for and kept in a folder.

    Attributes:
        task: What is planned.
        hand: The hand.
    """

    def __init__(self, task: TurnTask, folder: Path | None = None) -> None:
        """Nothing is planned yet.

        Args:
            task: What is planned.
            folder: Where plans are kept as files, which must exist; in memory only if None.

        Raises:
            PlannerError: There is no such hand.
        """
        self.task, self._folder = task, folder
        self.hand: Hand = load_hand(task.hand)
        self._made: dict[int, ManipulationPlan] = {}

    def __call__(self, number: int) -> ManipulationPlan:
        """The plan of a number from 0: the same for the same seed of the task.

        Raises:
            NoGraspFoundError: There is none for some sizes near it.
        """
        if number not in self._made:
            found = self._read(number)
            if found is None:
                planned = self._plan(number)
                # as a file has it, which is what a run that goes on reads
                data = movement_to_dict(planned)
                found = manipulation_from_dict(data, f"plan {number}", hand=self.hand)
            self._made[number] = found
        return self._made[number]

    def _file(self, number: int) -> Path | None:
        return None if self._folder is None else self._folder / f"plan-{number:04d}.json"

    def _read(self, number: int) -> ManipulationPlan | None:
        file = self._file(number)
        if file is None or not file.exists():
            return None
        return read_manipulation(file, hand=self.hand)

    def _plan(self, number: int) -> ManipulationPlan:
        sizes, failure = ObjectRange(self.task.objects), None
        for k in range(TRIES):
            item = parse_object(sizes.at((GOLDEN * (number + k / TRIES)) % 1.0), mass=MASS[1])
            task = manipulation_task(self.hand, item, mu=BELIEVED_MU)
            believed = settled(replace(task, joint_error=self.task.error_model.encoder_offset))
            seed = PLAN_SEEDS + TRIES * (self.task.seed + number) + k
            try:
                plan = plan_manipulation(believed, angle=self.task.angle, seed=seed, rests=rests)
            except NoGraspFoundError as error:
                failure = error
                continue
            file = self._file(number)
            if file is not None:
                write_manipulation(plan, file)
            return plan
        assert failure is not None
        raise failure
