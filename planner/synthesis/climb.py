"""From a grasp to the best one near it: an ascent that stays among solved grasps.

The rounds of ``planner.synthesis.optimize`` leave the terms for the objective and return at the
end, wherever that is: of twenty rounds the last is rarely the best. A step here is a short run with
the objectives and one without, and it counts only if the grasp is solved again and better;
otherwise the grasp before it comes back and the next step aims nearer. Costs that keep a first
grasp in an ordinary posture would hold the ascent back, so they weigh little.

``nearby_start`` draws a start beside a grasp, from where another ascent may end higher.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pinocchio as pin

from planner.collision.world import CollisionWorld
from planner.hands.hand import Hand
from planner.numerics.levenberg_marquardt import SOLVED
from planner.spatial import SE3
from planner.synthesis.objectives.registry import EPSILON
from planner.synthesis.optimize import GAIN, MEND_ITERATIONS, NEARLY, GraspRun
from planner.synthesis.options import SynthesisOptions
from planner.synthesis.problem import Candidate, Start

STEPS = 12
"""Most steps: after some ten the gain of one is below a hundredth."""

FIRST_STEPS = 4
"""Most steps while there is nothing to beat: what comes first should come soon, and starts beside
it go on."""

STEP_ITERATIONS, RETURN_ITERATIONS = 5, 8
"""Evaluations of a step with the objectives, and of the return to the terms."""

LIGHT = 0.05
"""Share of their weights that the costs keep."""

DAMPING = 1.0
"""Damping of the first step: contacts of a solved grasp may move by centimetres."""

LEAST_RISE = 1e-3
"""Share by which a step must raise the value."""

SHRINK, GROW, LEAST_GAIN, MOST_GAIN = 0.4, 1.5, 0.02, 0.3
"""Factors on the target of a step after a poor and a good one, and its limits (-)."""

POOR, GOOD = 0.01, 0.5
"""A step is poor below this share of the value, good above this share of its target."""

HEAVIER = 3.0
"""Factor on the damping after a step that is taken back."""

LEAST_SHARES = {2: 0.5, 4: 0.7, 8: 0.9, STEPS: 0.9}
"""Steps -> share of the best value below which the ascent is given up: values a few steps later
rarely exceed it."""

MEASURED_EVERY = 3
"""Steps that one measurement of the true distances between links serves."""

TURN, SHIFT, JOINT, POINT = 0.09, 0.003, 0.03, 0.0045
"""Standard deviations of a start beside a grasp: base (rad, m), joints (share of their range),
contact points (m)."""


def with_light_costs(options: SynthesisOptions) -> SynthesisOptions:
    """The options of an ascent: the same margins and objectives, little weight on the costs."""
    return replace(
        options,
        weight_tangential=LIGHT * options.weight_tangential,
        weight_share=LIGHT * options.weight_share,
        weight_posture=LIGHT * options.weight_posture,
        weight_center=LIGHT * options.weight_center,
    )


def climb(
    run: GraspRun,
    options: SynthesisOptions,
    *,
    value: Callable[[GraspRun], float],
    best: float,
    world: CollisionWorld | None,
) -> float | None:
    """Raise the value of a solved run; the value reached, or None if it was given up.

    Args:
        run: Solved, with the parameters of ``with_light_costs``; it ends at the best grasp.
        options: Objectives.
        value: What is to be large, of the run at its x.
        best: Value to beat; -inf for none.
        world: True geometry, where capsules stand for wider links.
    """
    _return(run, options, world, MEND_ITERATIONS)
    now, kept, gain, damping = value(run), run.x, GAIN, DAMPING
    for step in range(1, (STEPS if best > -np.inf else FIRST_STEPS) + 1):
        run.update_objectives(options, gain)
        if step % MEASURED_EVERY == 0:
            run.refresh_link_distances(world, options)
        run.solve(STEP_ITERATIONS, damping, slow=0.0)
        reached = run.end.damping
        run.drop_objectives()
        if run.end.worst > SOLVED:
            run.solve(RETURN_ITERATIONS, slow=np.inf)
        then = value(run) if run.end.worst <= NEARLY else -np.inf
        if then > now + LEAST_RISE * abs(now):
            if then - now > GOOD * gain:
                gain = min(gain * GROW, MOST_GAIN)
            elif then - now < POOR * abs(now):
                gain *= SHRINK
            now, kept, damping = then, run.x, reached or DAMPING
        else:
            run.x = kept
            gain *= SHRINK
            damping = max(damping, MIN_DAMPING) * HEAVIER
            if EPSILON not in options.weights:
                break  # without a target to bring nearer the same step would come again
        if gain < LEAST_GAIN:
            break
        if now < LEAST_SHARES.get(step, 0.0) * best:
            return None
    if now < LEAST_SHARES[STEPS] * best:
        return None
    run.x = kept
    _return(run, options, world, MEND_ITERATIONS)
    return now


MIN_DAMPING = 1e-3
"""Least damping after a step that is taken back."""


def _return(
    run: GraspRun, options: SynthesisOptions, world: CollisionWorld | None, budget: int
) -> None:
    """Satisfy the terms alone from x, with pairs of links kept apart that are too near."""
    run.drop_objectives()
    run.refresh_link_distances(world, options)
    run.solve(budget, slow=np.inf)


def nearby_start(hand: Hand, start: Start, candidate: Candidate, rng: np.random.Generator) -> Start:
    """A start beside a grasp: base, joints and contacts moved at random by little.

    A base that is fixed and joints that are frozen stay.

    Args:
        hand: The hand.
        start: Where the grasp came from.
        candidate: The grasp.
        rng: Random numbers.
    """
    turn, shift = TURN * rng.normal(size=3), SHIFT * rng.normal(size=3)
    joints = JOINT * rng.normal(size=hand.nq) * (hand.q_upper - hand.q_lower)
    points = candidate.points + POINT * rng.normal(size=candidate.points.shape)
    pose = candidate.T_object_base
    if not (start.base_fixed or hand.arm is not None):
        middle, rotation = candidate.points.mean(axis=0), pin.exp3(turn)
        place = middle + rotation @ (pose.translation - middle) + shift
        pose = SE3(rotation @ pose.rotation, place)
    q = np.where(start.frozen, start.q, candidate.q + joints)
    return replace(
        start,
        T_object_base=pose,
        q=np.clip(q, hand.q_lower, hand.q_upper),
        points=points,
        forces=candidate.forces,
    )
