"""Known faults put into good grasps, each of which a stage of an audit must find.

What each is:

    gap           all fingers 30 % of the way back to the pre-grasp
    penetration   all fingers 10 % of that way further, as far as joint limits let them
    no closure    the first finger, which opposes the others, at the pre-grasp
    torque limit  the same grasp pressed with 1000 N per finger, which no actuator has
    wrong hand    base and joints of a right hand for the left one, or the other way round
    wrong scale   the object 20 % larger than the grasp was made for, without its table

A grasp of which no finger opposes all others alone has none without closure by the third.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from planner.exchange.audit import AuditRow, scaled_object
from planner.exchange.audit.judge import Judge
from planner.exchange.formats import GivenGrasp
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.task import GraspTask

OPENED, CLOSED, LARGER, GRIP = 0.3, -0.1, 1.2, 1000.0
"""Shares of the way to the pre-grasp (-), factor of the object (-), N."""


@dataclass(frozen=True, kw_only=True)
class KnownFault:
    """A fault.

    Attributes:
        name: What to call it.
        stages: Stages of which at least one must fail.
        grasp: Puts it into a grasp.
        task: Puts it into the task.
    """

    name: str
    stages: frozenset[str]
    grasp: Callable[[GivenGrasp, GraspTask], GivenGrasp] = lambda grasp, task: grasp
    task: Callable[[GraspTask], GraspTask] = lambda task: task


def _opened(share: float) -> Callable[[GivenGrasp, GraspTask], GivenGrasp]:
    def move(grasp: GivenGrasp, task: GraspTask) -> GivenGrasp:
        if grasp.q_pregrasp is None:
            return grasp
        q = grasp.q + share * (grasp.q_pregrasp - grasp.q)
        return replace(grasp, q=np.clip(q, task.hand.q_lower, task.hand.q_upper))

    return move


def _first_away(grasp: GivenGrasp, task: GraspTask) -> GivenGrasp:
    """The first finger of the task at the pre-grasp."""
    q = grasp.q.copy()
    if grasp.q_pregrasp is not None:
        index = task.fingers[0].q_index
        q[index] = grasp.q_pregrasp[index]
    return replace(grasp, q=q)


def other_hand(hand: Hand) -> Hand:
    """The left hand of a right one that comes with Opposable, or the other way round.

    Raises:
        NotFoundError: There is none.
    """
    left = "_left"
    name = hand.name.removesuffix(left) if hand.name.endswith(left) else hand.name + left
    return load_hand(name)


def _for_other_hand(task: GraspTask) -> GraspTask:
    return replace(task, hand=other_hand(task.hand))


def _larger(task: GraspTask) -> GraspTask:
    return replace(task, object=scaled_object(task.object, LARGER), table_height=None)


_ANYWHERE = frozenset({"gap", "pad", "penetration"})

FAULTS: Mapping[str, KnownFault] = MappingProxyType(
    {
        fault.name: fault
        for fault in (
            KnownFault(name="gap", stages=frozenset({"gap"}), grasp=_opened(OPENED)),
            KnownFault(
                name="penetration", stages=frozenset({"penetration"}), grasp=_opened(CLOSED)
            ),
            KnownFault(name="no closure", stages=frozenset({"closure"}), grasp=_first_away),
            KnownFault(
                name="torque limit",
                stages=frozenset({"forces"}),
                task=lambda task: replace(task, grip_force=GRIP),
            ),
            KnownFault(name="wrong hand", stages=_ANYWHERE, task=_for_other_hand),
            KnownFault(name="wrong scale", stages=_ANYWHERE, task=_larger),
        )
    }
)
"""All faults by name."""


def judged_with_fault(name: str, task: GraspTask, grasp: GivenGrasp) -> tuple[AuditRow, bool]:
    """The verdict on a good grasp with a fault, and whether a stage that must fail does.

    Args:
        name: Of the fault.
        task: Of the grasp.
        grasp: A good grasp with a pre-grasp.
    """
    fault = FAULTS[name]
    row = Judge(fault.task(task)).row(fault.grasp(grasp, task))
    return row, any(row.stages[stage].passed is False for stage in fault.stages)
