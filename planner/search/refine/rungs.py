"""The term ``near``: a cost of leaving a given hand pose.

Rows, with weights that are parameters of the problem, so that one problem serves every pose and
every strength of the wish to stay:

    w_contact (p_i - p_i0)        contact i from the point under its given pad
    w_shift (R a + t - b)         the palm's origin from where it was
    w_turn 4 s                    turn of the base, modified Rodrigues parameters from the start's
    w_joint_j (q_j - q_j0)        joints

It is no standard term: ``planner.search.refine`` asks for it. All weights are zero unless given.

From a start at the given pose to a grasp near it: one rung of the ladder, by least squares.

A first run solves the terms of synthesis together with the term ``near``
(``planner.search.refine.rungs``) at the weight of the rung. A second run, with the term at a
hundredth of that, brings the terms that the first has traded for nearness to where they hold; it
begins where the first has ended and steps are least, so it stays there. Both are the compiled loops
of ``planner.synthesis``.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from planner.failure import Failure
from planner.hands.hand import Hand
from planner.kinematics import moving_hand
from planner.plan import GraspPlan
from planner.search.attempt import finished, true_links
from planner.search.refine.pose import JOINT_UNIT, LENGTH_UNIT, TURN_UNIT, GivenPose, UnderPads
from planner.shapes.base import Patch, Surface
from planner.spatial import FloatArray
from planner.synthesis.optimize import MEND_ITERATIONS, NEARLY, GraspRun
from planner.synthesis.options import NO_OBJECTIVE, SynthesisOptions
from planner.synthesis.problem import Candidate, GraspProblem, Start
from planner.synthesis.seeds.draw import frozen_joints, opposed_forces
from planner.synthesis.symbols import GraspSymbols
from planner.synthesis.terms.registry import register_term
from planner.synthesis.terms.term import Role, Rows, Term
from planner.system.threads import stage
from planner.task import GraspTask

SMALLEST_RANGE = 1e-3
"""Least range (rad or m) of a joint that its change is compared with."""


def _near(g: GraspSymbols) -> Iterator[Rows]:
    n = len(g.points)
    points, contact = g.parameter("near_points", 3 * n), g.parameter("near_contact", 1)
    for i, (finger, point) in enumerate(zip(g.fingers, g.points, strict=True)):
        off = point - points[3 * i : 3 * i + 3]
        yield Rows(expression=contact * off, about=(finger.name,))
    at, place = g.parameter("near_at", 3), g.parameter("near_place", 3)
    shift, turn = g.parameter("near_shift", 1), g.parameter("near_turn", 1)
    yield Rows(expression=shift * (g.rotation @ at + g.shift - place))
    yield Rows(expression=turn * 4 * g.x[:3])
    q, joint = g.parameter("near_q", g.hand.nq), g.parameter("near_joint", g.hand.nq)
    yield Rows(expression=joint * (g.q - q))


NEAR = register_term(
    Term(
        name="near",
        meaning="displacement of contacts and palm over 10 mm, turn and joints over 0.2 rad",
        role=Role.COST,
        unit="-",
        weight=1.0,
        write=_near,
        judged="the movement is reported",
    )
)


def near_numbers(
    hand: Hand,
    weight: float,
    *,
    points: FloatArray,
    q: FloatArray,
    at: FloatArray,
    place: FloatArray,
) -> Mapping[str, FloatArray | float]:
    """Parameters of the term, for ``GraspProblem.parameters``.

    Args:
        hand: The hand.
        weight: Residual (-) of one unit of ``planner.search.refine.pose``.
        points: Points of the surface under the given pads (n, 3), object frame, m.
        q: Given joints (nq,).
        at: The palm's origin (3,) in the frame of the base, or of an arm's last link, m.
        place: Where it was (3,), object frame, m.
    """
    span = np.maximum(hand.q_upper - hand.q_lower, SMALLEST_RANGE)
    return {
        "near_points": points.ravel(),
        "near_contact": weight / LENGTH_UNIT,
        "near_at": at,
        "near_place": place,
        "near_shift": weight / LENGTH_UNIT,
        "near_turn": weight / TURN_UNIT,
        "near_q": q,
        "near_joint": weight / np.minimum(JOINT_UNIT, span) / np.sqrt(hand.nq),
    }


@dataclass(frozen=True, kw_only=True)
class Rung:
    """How strongly one try stays near.

    Attributes:
        weight: Of the term ``near`` (-).
        costs: Share of their weights (-) that the costs of synthesis keep: they centre contacts
            and level forces, and so lead away from where the pads were.
        reach: How far (m) along each axis a contact may be from the point under its pad.
        rounds: Rounds that raise epsilon, for grasps that cannot bear the object's weight.
        faced: Whether flat sides are assigned by where pads face alone, not by what is nearest.
    """

    weight: float
    costs: float
    reach: float = np.inf
    rounds: int = 0
    faced: bool = False


RUNGS = (
    Rung(weight=0.3, costs=0.05, reach=0.008),
    Rung(weight=0.1, costs=0.3, reach=0.008, rounds=2),
    Rung(weight=0.1, costs=0.3, reach=0.016, faced=True),
    Rung(weight=0.3, costs=0.05),
    Rung(weight=0.03, costs=1.0, rounds=3),
)
"""From the nearest to the freest."""

BOUNDED = 2
"""How many of them, the first, bound contacts to what counts as near."""

LET_GO = 0.01
"""Share of the weight that is left in the second run."""

STRONGER = SynthesisOptions()
"""Options of the rounds, whose objective is epsilon."""

ROUND_GAIN, ROUND_ITERATIONS = 0.1, 4
"""Target of epsilon over that of the first run (-), and evaluations of a round."""

FIRST_ITERATIONS = 30
"""Evaluations of the first run."""


def near_options(options: SynthesisOptions) -> SynthesisOptions:
    """Options of a refinement: the margins and terms of these, no objective, the term ``near``."""
    return replace(
        options, objective=NO_OBJECTIVE, task_wrenches=(), terms=(*options.terms, NEAR.name)
    )


def climb_rung(
    problem: GraspProblem,
    task: GraspTask,
    start: Start,
    pose: GivenPose,
    under: UnderPads,
    options: SynthesisOptions,
    rung: Rung,
) -> tuple[GraspPlan | Failure, Candidate]:
    """The grasp that one rung reaches, or why it is none, and where the solver ended.

    Args:
        problem: The problem of the task, with the term ``near``.
        task: With the fingers that take part.
        start: From ``start_at``.
        pose: The given pose.
        under: Where its pads belong.
        options: From ``near_options``.
        rung: How strongly to stay.
    """
    begin = time.process_time()
    light = replace(
        options,
        weight_posture=0.0,
        weight_center=rung.costs * options.weight_center,
        weight_tangential=rung.costs * options.weight_tangential,
        weight_share=rung.costs * options.weight_share,
    )

    def parameters(weight: float) -> FloatArray:
        own = near_numbers(
            task.hand, weight, points=under.points, q=pose.q, **_palm(task, pose, start)
        )
        return problem.parameters(task, start, pose.q, light, own)

    with stage("solve"):
        run = GraspRun(problem, task, start, parameters(rung.weight))
        run.solve(FIRST_ITERATIONS)
        damping = None
        for _ in range(rung.rounds if run.end.worst <= NEARLY else 0):
            run.update_objectives(STRONGER, ROUND_GAIN)
            run.solve(ROUND_ITERATIONS, damping)
            damping = run.end.damping
        run.set_parameters(parameters(LET_GO * rung.weight))
        run.refresh_link_distances(true_links(task), light)
        run.solve(MEND_ITERATIONS, slow=np.inf)
        if run.end.worst <= NEARLY and run.refresh_link_distances(true_links(task), light):
            run.solve(MEND_ITERATIONS, slow=np.inf)
    candidate = run.candidate(run.end.status, begin)
    return finished(problem, task, candidate, options), candidate


def start_at(
    task: GraspTask, surface: Surface, pose: GivenPose, under: UnderPads, rung: Rung
) -> Start:
    """The start that is the given pose itself.

    Args:
        task: With the fingers that take part.
        surface: Form of the object in the problem.
        pose: The given pose.
        under: Where its pads belong.
        rung: Bounds the contacts.
    """
    skin = float(surface.skin(surface.size(task.object.shape)))
    points = under.points + skin * under.outward
    normals = -under.axes if rung.faced else under.outward
    patches = tuple(
        _near_patch(_patch(task, surface, finger, point, normal), point, rung.reach)
        for finger, point, normal in zip(task.finger_names, points, normals, strict=True)
    )
    lower, upper = np.array([p.lower for p in patches]), np.array([p.upper for p in patches])
    opposer = int(np.argmin(np.einsum("ik,k->i", normals, normals.sum(axis=0))))
    return Start(
        T_object_base=task.T_world_object.inverse() * pose.T_world_base,
        q=pose.q,
        points=np.clip(points, lower, upper),
        forces=opposed_forces(normals, opposer),
        patches=patches,
        frozen=frozen_joints(task),
        base_fixed=task.T_world_base is not None,
    )


def _near_patch(patch: Patch, point: FloatArray, reach: float) -> Patch:
    """The part of a patch within reach of where a point lies on it."""
    inside = np.clip(point, patch.lower, patch.upper)
    return replace(
        patch,
        lower=np.maximum(patch.lower, inside - reach),
        upper=np.minimum(patch.upper, inside + reach),
    )


def _patch(
    task: GraspTask, surface: Surface, finger: str, point: FloatArray, normal: FloatArray
) -> Patch:
    """The patch at a point, cut down to the nearest region that the finger may touch."""
    shape, touch = task.object.shape, task.object.touch
    here = surface.patch_at(shape, point, normal)
    regions = [] if touch is None else list(touch.allowed)
    if touch is not None and finger in touch.required:
        regions = [touch.required[finger]]
    cut = [
        replace(patch, lower=lower, upper=upper)
        for region in regions
        for patch in (here, *surface.patches(shape))
        if (
            (lower := np.maximum(patch.lower, region.lower))
            <= (upper := np.minimum(patch.upper, region.upper))
        ).all()
    ]
    far = [float(np.linalg.norm(np.clip(point, c.lower, c.upper) - point)) for c in cut]
    return cut[int(np.argmin(far))] if cut else here


def _palm(task: GraspTask, pose: GivenPose, start: Start) -> dict[str, FloatArray]:
    """The palm's origin in the link that the unknowns move, and where it was in the object."""
    state = moving_hand(task.hand).move(start.q)
    palm = state.T_base_palm
    if task.hand.arm is not None:
        palm = state.joint_pose(task.hand.arm.flange).inverse() * palm
    was = task.T_world_object.inverse() * pose.T_world_palm
    return {"at": np.array(palm.translation), "place": np.array(was.translation)}
