"""The grasp problem of a task, built once and kept."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

from planner.hands.hand import Hand
from planner.shapes import Shape
from planner.synthesis.mesh_surface import surface_of
from planner.synthesis.options import ProblemForm
from planner.synthesis.problem import GraspProblem, build_problem
from planner.system.threads import BUILDING, made_once
from planner.task import GraspTask


@dataclass(frozen=True)
class Problems:
    """The grasp problem of a task, and the time (s) that it took to build."""

    grasp: GraspProblem
    build_s: float


def problems_for(task: GraspTask, form: ProblemForm | None = None) -> Problems:
    """The problem of a task; built once per hand, fingers, kind of shape, obstacles and form.

    A mesh's field is made here too, so that attempts take no time for either.

    Args:
        task: The task.
        form: Objectives and terms beside the standard ones; None for neither.
    """
    kind = _Kind(task.object.shape)
    same, n_obstacles = _SameHand(task.hand), len(task.obstacles)
    form = form or ProblemForm()
    problems = _cached_problems(same, task.finger_names, kind, n_obstacles, form)
    begin = time.perf_counter()
    with BUILDING:  # fitting a field takes seconds: one thread does it and the others wait
        problems.grasp.surface.field_of(task.object.shape)
    return replace(problems, build_s=problems.build_s + time.perf_counter() - begin)


class _Kind:
    """A shape that compares by its form in the problem, for the cache."""

    def __init__(self, shape: Shape) -> None:
        self.shape, self.kind = shape, surface_of(shape).kind

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Kind) and other.kind == self.kind

    def __hash__(self) -> int:
        return hash(self.kind)


class _SameHand:
    """A hand that compares by what determines it, for the cache: loaded twice it is the same."""

    def __init__(self, hand: Hand) -> None:
        self.hand = hand

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _SameHand) and other.hand.digest == self.hand.digest

    def __hash__(self) -> int:
        return hash(self.hand.digest)


@made_once(16)
def _cached_problems(
    same: _SameHand,
    finger_names: tuple[str, ...],
    kind: _Kind,
    n_obstacles: int,
    form: ProblemForm,
) -> Problems:
    begin = time.perf_counter()
    fingers = same.hand.choose_fingers(finger_names)
    grasp = build_problem(
        same.hand,
        fingers,
        kind.shape,
        n_obstacles,
        form.objectives,
        tuple(term.name for term in form.terms),
    )
    return Problems(grasp=grasp, build_s=time.perf_counter() - begin)
