"""From a solver's candidate to a plan: pads put onto the true surface, then the verdict.

Shared by the search (``planner.search.grasp``), which starts anywhere, and by
``planner.search.refine``, which starts from a given hand pose.
"""

from __future__ import annotations

import numpy as np

from planner.collision.world import CollisionWorld
from planner.failure import Failure
from planner.plan import GraspPlan, SolveRecord
from planner.spatial import SE3, FloatArray
from planner.synthesis.optimize import nearly
from planner.synthesis.options import SynthesisOptions
from planner.synthesis.problem import Candidate, GraspProblem
from planner.synthesis.symbols import GraspPoint
from planner.synthesis.terms.fingers import capsules_are_true
from planner.synthesis.terms.term import Term, first_failure
from planner.system.threads import kept_by_thread, stage
from planner.task import GraspTask
from planner.verification import (
    project_onto_surface,
    verify_grasp,
    with_palm_on_surface,
)

__all__ = ["UNSOLVED", "finished", "true_geometry", "true_links", "verified_on_surface"]

UNSOLVED = "unsolved_"
"""Begin of the kind of a failure to satisfy a term, whose name follows."""


@kept_by_thread(8)
def true_geometry(task: GraspTask) -> CollisionWorld:
    """The true geometry of a task, of which every thread keeps its last few."""
    return CollisionWorld(task)


def true_links(task: GraspTask) -> CollisionWorld | None:
    """The true geometry, where the capsules of the terms are not exactly the hand's links."""
    return None if capsules_are_true(task.hand) else true_geometry(task)


def finished(
    problem: GraspProblem, task: GraspTask, candidate: Candidate, options: SynthesisOptions
) -> GraspPlan | Failure:
    """The plan of a candidate if it is solved and holds on the true geometry; else why not.

    Args:
        problem: The problem that was solved.
        task: Its task.
        candidate: Where the solver ended.
        options: With what it solved.
    """
    worst, weighted = problem.worst_violation(candidate.violation)
    if not weighted <= nearly(task):
        violation = candidate.violation[worst.name]
        return Failure(
            kind=f"{UNSOLVED}{worst.name}",
            text=f"not solved, term {worst.name}: violated by {violation:.1e}",
            numbers={"violation": violation},
        )
    record = SolveRecord(
        iterations=candidate.iterations,
        status=candidate.status,
        objective=str(options.objective),
    )
    q = np.clip(candidate.q, task.hand.q_lower, task.hand.q_upper)
    T_world_base = task.T_world_object * candidate.T_object_base
    return verified_on_surface(task, T_world_base, q, record=record, terms=problem.own_terms)


def verified_on_surface(
    task: GraspTask,
    T_world_base: SE3,
    q: FloatArray,
    *,
    record: SolveRecord,
    terms: tuple[Term, ...] = (),
) -> GraspPlan | Failure:
    """Project onto the true surface, verify, and ask the terms that have a verdict of their own.

    Args:
        task: The task.
        T_world_base: Base pose.
        q: Joints (nq,), within their limits.
        record: Where they come from.
        terms: Terms beside the standard ones.
    """
    with stage("project"):
        T_world_base = with_palm_on_surface(task, T_world_base, q)
        q = project_onto_surface(task, T_world_base, q)
    plan = verify_grasp(task, T_world_base, q, record=record, world=true_geometry(task))
    if isinstance(plan, Failure) or not terms:
        return plan
    at = plan.contacts_in_object
    point = GraspPoint(task=task, q=plan.q, points=at.positions, inward=at.normals)
    return first_failure(terms, point) or plan
