"""What a search for a grasp is to keep: the first found, or the best of several, and by what."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from planner.attempt import Attempt
from planner.errors import NotFoundError, TaskError, shown
from planner.plan import BestOf, GraspPlan
from planner.plan_metrics import Measure
from planner.synthesis.objectives.registry import EPSILON
from planner.synthesis.options import NO_OBJECTIVE, SynthesisOptions

FIRST = "first"
"""Name for keeping the first grasp found, or the best of the first few."""

BEST = "best"
"""Name for keeping the best grasp that a budget gives."""

DEFAULT_MAX_ATTEMPTS = 100
"""Attempts before giving up. On the shipped shapes one or two are usual; one that fails costs some
ten milliseconds."""


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """What a search keeps and when it ends, checked.

    Attributes:
        options: Margins, weights and objectives.
        measure: By what grasps are compared; None where the first is taken.
        improving: Whether attempts build on each other.
        best_of: Grasps after which the search ends; None for the end of the budget.
        max_attempts: Budget in attempts; None for no limit.
        max_cpu_s: Budget in CPU seconds; None for no limit.
    """

    options: SynthesisOptions
    measure: Measure | None
    improving: bool
    best_of: int | None
    max_attempts: int | None
    max_cpu_s: float | None

    @classmethod
    def of(
        cls,
        *,
        max_attempts: int | None = None,
        max_cpu_s: float | None = None,
        best_of: int | None = None,
        keep: str = FIRST,
        metric: str | Mapping[str, float] | None = None,
        options: SynthesisOptions | None = None,
    ) -> Wanted:
        """From the arguments of ``plan_grasp``.

        Raises:
            NotFoundError: ``keep`` is neither "first" nor "best", or an unknown metric.
            TaskError: A budget or ``best_of`` is not positive, or they contradict each other.
        """
        for name, value in (("max_attempts", max_attempts), ("best_of", best_of)):
            whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
            if value is not None and not (whole and value >= 1):
                raise TaskError(f"{name} is {shown(value)}; give an integer, at least 1")
        if max_cpu_s is not None and not max_cpu_s > 0:
            raise TaskError(f"max_cpu_s is {max_cpu_s}; give seconds > 0")
        if keep not in (FIRST, BEST):
            raise NotFoundError("way to keep a grasp", str(keep), (FIRST, BEST))
        if keep == BEST and best_of is not None:
            raise TaskError(
                f"keep is 'best' and best_of is {best_of}; leave one out: best_of ends with so "
                "many grasps, keep='best' with max_attempts or max_cpu_s"
            )
        compares = keep == BEST or best_of is not None
        if metric is not None:
            Measure.of(metric)  # an error of it speaks of a metric, not of an objective
        if metric is not None and not compares:
            raise TaskError(
                f"metric is {shown(metric)}, but the first grasp is taken, whatever it is worth; "
                "give best_of or keep='best' too"
            )
        if options is None:
            options = SynthesisOptions() if metric is None else SynthesisOptions(objective=metric)
        objective = EPSILON if options.objective == NO_OBJECTIVE else options.objective
        measure = Measure.of(objective if metric is None else metric, options.task_wrenches)
        if max_attempts is None and (keep == FIRST or max_cpu_s is None):
            max_attempts = DEFAULT_MAX_ATTEMPTS
        return cls(
            options=options,
            measure=measure if compares else None,
            improving=keep == BEST,
            best_of=None if keep == BEST else best_of or 1,
            max_attempts=max_attempts,
            max_cpu_s=max_cpu_s,
        )

    def value(self, plan: GraspPlan) -> float:
        """What a plan is worth; 0 where the first is taken."""
        return 0.0 if self.measure is None else self.measure(plan)

    def recorded(self, plan: GraspPlan, made: Sequence[Attempt[GraspPlan]]) -> GraspPlan:
        """A plan with the record of the attempts that it is the best of; the first as it is."""
        if self.measure is None:
            return plan
        best = BestOf(
            found=sum(attempt.plan is not None for attempt in made),
            metric=self.measure.text,
            value=self.measure(plan),
            improving=self.improving,
        )
        spent = sum(attempt.cpu_s for attempt in made)
        record = replace(plan.record, attempts=len(made), cpu_s=spent, best=best)
        return replace(plan, record=record)
