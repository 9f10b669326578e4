"""The problem of a task's motions, built once and kept: like that of its grasps."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

from planner.hands.hand import Hand
from planner.motion.holds import Hold
from planner.motion.problem import MotionProblem, build_motion_problem
from planner.shapes import Shape
from planner.synthesis.mesh_surface import surface_of
from planner.synthesis.terms.term import Term
from planner.system.threads import BUILDING, made_once
from planner.task import GraspTask

__all__ = ["motion_problem_for"]


def motion_problem_for(
    task: GraspTask,
    n_knots: int,
    holds: tuple[Hold, ...] = (),
    terms: tuple[Term, ...] = (),
) -> tuple[MotionProblem, float]:
    """The problem of a task's hand, fingers and kind of shape, and the time to build it, s.

    Args:
        task: The task.
        n_knots: Number of knots.
        holds: What must hold while a finger is away.
        terms: Terms of users that every knot has, see ``SynthesisOptions.form``.
    """
    begin = time.perf_counter()
    shape = task.object.shape
    form = _Form(
        digest=task.hand.digest,
        finger_names=task.finger_names,
        kind=surface_of(shape).kind,
        n_knots=n_knots,
        n_obstacles=len(task.obstacles),
        holds=holds,
        terms=terms,
        hand=task.hand,
        shape=shape,
    )
    found = _built(form)
    with BUILDING:  # fitting a field takes seconds: one thread does it and the others wait
        found.grasp.surface.field_of(shape)
    return found, time.perf_counter() - begin


@dataclass(frozen=True, kw_only=True)
class _Form:
    """What determines a problem, for the cache; and an example of it."""

    digest: str
    finger_names: tuple[str, ...]
    kind: str
    n_knots: int
    n_obstacles: int
    holds: tuple[Hold, ...]
    terms: tuple[Term, ...]
    hand: Hand = field(compare=False)
    shape: Shape = field(compare=False)


@made_once(8)
def _built(form: _Form) -> MotionProblem:
    fingers = form.hand.choose_fingers(form.finger_names)
    return build_motion_problem(
        form.hand,
        fingers,
        form.shape,
        form.n_knots,
        form.n_obstacles,
        form.holds,
        tuple(term.name for term in form.terms),
    )
