"""``Loop``: what drives the hand in a trial, and what it is told; a column of ``errors``.

All loops execute the same plans against the same draws. A further column is one call of
``register_loop``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from planner.errors import TaskError
from planner.registry import Registry
from sim.controllers import GraspController, MakeController, ObjectImpedance
from sim.learning import open_loop, policy_controller
from sim.learning.controller import POLICY
from sim.sensing.errors import ErrorModel
from sim.sensing.estimation import ESTIMATORS, NONE


def _as_it_is(error_model: ErrorModel) -> ErrorModel:
    return error_model


@dataclass(frozen=True, kw_only=True)
class Loop:
    """One column.

    Attributes:
        name: In tables and on the command line.
        about: What it is, in one line.
        driver: What drives the hand: two loops with the same driver and estimator that are told
            the same are one and the same run, which is made once.
        holding: Makes what holds a grasp.
        turning: Makes what holds and turns the object of a manipulation, out of its grasp; None for
            the closed loop of ``manipulate``.
        estimator: Name of what tells it where the object is, out of ``sim.sensing.estimation``.
        told: Makes of the trial's error model the one whose sensors the loop reads. It must leave
            drives and object as they are, since all loops share them.
        usual: Whether it is a column where none are named.
        tasks: Names of the tasks that it can do; all if empty.
        why_not: Why it cannot run here, such as a package that is missing; "" if it can.
    """

    name: str
    about: str
    driver: str
    holding: MakeController
    turning: MakeController | None = None
    estimator: str = NONE
    told: Callable[[ErrorModel], ErrorModel] = _as_it_is
    usual: bool = True
    tasks: tuple[str, ...] = ()
    why_not: Callable[[], str] = lambda: ""

    def does(self, task: str) -> bool:
        """Whether it can do a task."""
        return not self.tasks or task in self.tasks


LOOPS: Registry[Loop] = Registry("loop")
"""Loops by their names, in the order of the columns."""


def register_loop(loop: Loop) -> Loop:
    """Make a loop known by its name, and return it.

    Raises:
        TaskError: Another one has that name.
    """
    return LOOPS.add(loop.name, loop)


def named_loop(name: str) -> Loop:
    """A registered loop that can run here, or that of a policy, "policy:FILE".

    Raises:
        NotFoundError: There is none of that name.
        FileFormatError: A policy that cannot be read.
        TaskError: It cannot run here.
    """
    if name.startswith(POLICY):
        return _policy(name)
    loop = LOOPS.named(name)
    if reason := loop.why_not():
        raise TaskError(f"the loop {name!r} cannot run: {reason}")
    return loop


def _policy(name: str) -> Loop:
    """The loop of a policy's file.

    Raises:
        FileFormatError: It cannot be read.
    """
    make = policy_controller(name.removeprefix(POLICY))
    about = make.policy.about
    return Loop(
        name=name,
        about=f"policy for {about.objects}, trained under {about.error_model}: joints and touch",
        driver=f"policy {make.policy.digest}",
        holding=make,
        turning=make,
        estimator=about.estimator,
        tasks=("turn",),
    )


register_loop(
    Loop(
        name="truth",
        about="closed loop, calibrated joints and exact sensors: drives and world are off",
        driver="impedance",
        holding=ObjectImpedance,
        told=ErrorModel.sensed_exactly,
    )
)
register_loop(
    Loop(
        name="readings",
        about="the same loop on what the sensors say, as they say it",
        driver="impedance",
        holding=ObjectImpedance,
    )
)
register_loop(
    Loop(
        name="blind",
        about="the same loop without a camera: the object was seen once, before the hand closed",
        driver="impedance",
        holding=ObjectImpedance,
        told=ErrorModel.without_camera,
        usual=False,
    )
)
for _name, _estimator in (("estimates", "all"), ("touch", "touch"), ("contact", "contact")):
    register_loop(
        Loop(
            name=_name,
            about=f"the same loop on an estimate, from {ESTIMATORS[_estimator].reads}",
            driver="impedance",
            holding=ObjectImpedance,
            estimator=_estimator,
        )
    )
register_loop(
    Loop(
        name="open",
        about="open loop: planned forces around the posture of the grip; planned joints in a turn",
        driver="playback",
        holding=GraspController,
        turning=open_loop,
    )
)
