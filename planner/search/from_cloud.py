"""``plan_from_cloud``: a grasp of what cameras saw a part of, or an error that says why none.

Grasps are planned on the mesh of each plausible hypothesis, with fingers where the surface is
certain enough. Each then has to survive what may be true instead: samples of the hypothesis, of the
surface's process at the contacts and of the error of the object's pose. A finger goes on along its
contact's normal until it feels the surface. A sample asks for closure with the task's friction
and a hand clear of that hypothesis. The grasp that survives most is taken, less half of the share
in which the first finger may tip the object instead of sliding it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.arrays import checked_kind, checked_number
from planner.attempt import Attempt, check_seed
from planner.certify import Tolerance, contact_tolerances
from planner.clouds.belief import STEP, Belief
from planner.clouds.cloud import PointCloud
from planner.contacts import ContactSet
from planner.errors import PlannerError, TaskError, UncertainError
from planner.failure import Failure
from planner.hands.hand import Hand
from planner.kinematics.state import HandState
from planner.objects import DEFAULT_MASS, GraspObject
from planner.plan import GraspPlan
from planner.quality import force_closure, plainly_closed
from planner.search.grasp import attempts
from planner.shapes.mesh import surface_triangles
from planner.spatial import SE3, FloatArray, contact_frames
from planner.synthesis.link_spheres import link_spheres
from planner.synthesis.options import SynthesisOptions
from planner.task import GraspTask
from planner.tolerances import CLOSURE_EDGES

__all__ = ["CloudPlan", "plan_from_cloud"]

SAMPLES = 60
"""Samples of what may be true on which a plan is tried: a share of 0.9 is known to 0.04."""

SURVIVES, ENOUGH = 0.3, 0.8
"""Share of samples (-) that a plan must survive, and the merit with which the search ends. Samples
are harder than the world is: of 32 plans on one-view scans with which this was set, 29 held, and 11
of 12 of those that survived less than half."""

PLAUSIBLE = 0.08
"""Weight (-) of a hypothesis below which nothing is planned on it."""

TRIED, PLANS = 2, 3
"""Hypotheses on which grasps are planned, and plans for each."""

CONE_SHARE = 0.5
"""Share of the friction (-) that the internal force of synthesis may use: 14 degrees of 27 are left
to errors of the normals."""

FELT = 0.012
"""How far (m) a finger goes beyond its planned place until it feels the surface."""

SPARE = 0.002
"""Distance (m) from the surface that an opened finger keeps, and depth to which spheres in the
links may be in another hypothesis: they bulge by as much."""

ROOM = 0.005
"""Most (m) that is added to the clearances of the hand for errors of surface and pose."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CloudPlan:
    """A grasp of an object of which cameras saw a part.

    Attributes:
        plan: The grasp, verified on the mesh of the chosen hypothesis; ``plan.task.object.belief``
            is what is known of the surface.
        survival: Share of the samples of what may be true that it survives (-).
        tipping: Share of the samples (-) in which the first finger to arrive may tip the object.
        samples: How many samples.
        position_std: Standard deviation of the surface at each contact along its normal (n,), m.
        normal_std: The same of the normal's direction, about each of two axes, (n,), rad.
        refused: Why other plans and hypotheses were not taken, a sentence each.
    """

    plan: GraspPlan
    survival: float
    tipping: float
    samples: int
    position_std: FloatArray
    normal_std: FloatArray
    refused: tuple[str, ...]

    @property
    def merit(self) -> float:
        """By what plans are compared (-): survival less half of ``tipping``."""
        return self.survival - 0.5 * self.tipping

    @property
    def belief(self) -> Belief:
        """What is known of the surface."""
        belief = self.plan.task.object.belief
        assert belief is not None, "the plan is of a cloud"
        return belief

    @cached_property
    def tolerances(self) -> tuple[Tolerance, ...]:
        """Errors of all contacts at once that closure is proven to tolerate (a second of CPU)."""
        return contact_tolerances(self.plan.contacts)

    def __str__(self) -> str:
        """The plan, and what is known against what it tolerates."""
        belief, (position, normal, _) = self.belief, self.tolerances
        names = self.plan.task.finger_names
        rows = [
            f"{name:10} {1e3 * s:16.1f} {np.rad2deg(a):16.0f}"
            for name, s, a in zip(names, self.position_std, self.normal_std, strict=True)
        ]
        kind = belief.hypothesis
        return "\n".join(
            [
                str(self.plan),
                f"surface: {len(belief.cloud)} points of {len(belief.cloud.views)} view(s), noise "
                f"{1e3 * belief.cloud.noise:.1f} mm; what is behind: {kind.name}, plausibility "
                f"{kind.weight:.2f}",
                *belief.cloud.notes,
                f"{'finger':10} {'surface std (mm)':>16} {'normal std (deg)':>16}",
                *rows,
                f"closure is proven for errors of {position.promised or 0.0:.1f} mm or "
                f"{normal.promised or 0.0:.0f} degrees at every contact; {self.survival:.0%} of "
                f"{self.samples} samples of what may be true are survived; in {self.tipping:.0%} "
                "the first finger may tip the object",
                *self.refused,
            ]
        )


def plan_from_cloud(
    hand: Hand | str | Path,
    cloud: PointCloud,
    *,
    seed: int = 0,
    mass: float = DEFAULT_MASS,
    name: str = "cloud",
    max_attempts: int = 12,
    pose_error: tuple[float, float] = (0.0, 0.0),
    survives: float = SURVIVES,
    options: SynthesisOptions | None = None,
    **task: Any,
) -> CloudPlan:
    """The grasp that survives most of what may be true of an object seen in part.

    Args:
        hand: A hand, its name, or the path of its description.
        cloud: What cameras saw, in the frame in which the plan is to be (z up).
        seed: Same seed, same plan.
        mass: Of the object, kg; no camera tells it.
        name: What to call the object.
        max_attempts: Attempts for each hypothesis.
        pose_error: Standard deviations of the error of the cloud's pose along and about each axis,
            m and rad: of the calibration of camera and hand. Where the cloud has a table, which
            tells height and tilt, along the table and about the vertical.
        survives: Share of samples (-) below which a plan is refused.
        options: Margins of the problem; clearances are widened for what is uncertain if None.
        **task: Further arguments of ``GraspTask.create``.

    Raises:
        UncertainError: No plan survives enough; says what is lacking.
        ObjectError: The cloud is not usable.
        PlannerError: What ``GraspTask.create`` raises.
    """
    cloud = checked_kind("cloud", cloud, PointCloud)
    check_seed(seed)
    checked_number("mass", mass, above=0.0, unit="kg", error=TaskError)
    for value, unit in zip(pose_error, ("m", "rad"), strict=True):
        checked_number("pose_error", value, least=0.0, most=0.5, unit=unit, error=TaskError)
    belief = Belief.of(cloud)
    if not len(belief.deviations):
        raise UncertainError(
            "too little of the object was seen: nowhere do enough points lie together to fit a "
            "surface. Look from nearer, or give less noise",
            (),
            None,
        )
    best: CloudPlan | None = None
    made: list[Attempt[GraspPlan]] = []
    refused: list[str] = []
    likely = [h for k, h in enumerate(belief.hypotheses[:TRIED]) if not k or h.weight >= PLAUSIBLE]
    # ordinary margins where none is found with those for what is uncertain: the samples judge
    for margins in (options,) if options else (_widened(belief, pose_error[0]), SynthesisOptions()):
        for number, hypothesis in enumerate(likely):
            what = f"{hypothesis.name} (plausibility {hypothesis.weight:.2f})"
            try:
                grasp_task = _task(hand, belief, number, mass, name, task)
                search = islice(attempts(grasp_task, seed=seed, options=margins), max_attempts)
            except PlannerError as error:
                refused.append(f"{what}: {error}")
                continue
            begin = len(made)
            best = _best_of(search, best, pose_error, seed, made)
            failures = [a.failure for a in made[begin:] if a.failure is not None]
            if len(failures) == len(made) - begin:
                common = _commonest(failures)
                refused.append(f"{what}: no grasp in {len(failures)} attempts: {common}")
            if best is not None and best.merit >= ENOUGH:
                break
        if best is not None:
            break
    if best is None or best.survival < survives:
        raise _abstained(best, survives, belief, refused, made)
    return replace(best, refused=tuple(refused))


def _best_of(
    search: Iterable[Attempt[GraspPlan]],
    best: CloudPlan | None,
    pose_error: tuple[float, float],
    seed: int,
    made: list[Attempt[GraspPlan]],
) -> CloudPlan | None:
    """The best of a plan and the first ``PLANS`` of a search, whose attempts are added."""
    plans = 0
    for attempt in search:
        made.append(attempt)
        if attempt.plan is None:
            continue
        plans += 1
        other = _tried(attempt.plan, pose_error, seed, 0.0 if best is None else best.merit)
        if best is None or other.merit > best.merit:
            best = other
        if plans == PLANS or best.merit >= ENOUGH:
            break
    return best


def _widened(belief: Belief, shift: float) -> SynthesisOptions:
    """Margins for a surface and a pose, off by a shift (m), that are uncertain."""
    room = min(float(np.median(belief.deviations)) + shift, ROOM)
    usual = SynthesisOptions()
    return replace(
        usual,
        clear_object=usual.clear_object + room,
        clear_table=usual.clear_table + room,
        cone_share=CONE_SHARE,
    )


def _task(
    hand: Hand | str | Path,
    belief: Belief,
    number: int,
    mass: float,
    name: str,
    more: dict[str, Any],
) -> GraspTask:
    """The task of grasping a hypothesis, where the cloud has it, on its table.

    The mesh may end above the table's top, since no camera saw its foot: it stands there.
    """
    chosen, mesh = belief.of_hypothesis(number)
    item = GraspObject(name=name, shape=mesh, mass=mass, belief=chosen)
    pose = chosen.T_world_object
    table = belief.cloud.table
    if table is not None:
        lowest = float(pose.translation[2]) - mesh.support(np.array([0.0, 0.0, -1.0]))
        table = lowest if abs(lowest - table) < UNSEEN_FOOT else table
    return GraspTask.create(hand, item, **{"T_world_object": pose, "table_height": table, **more})


UNSEEN_FOOT = 0.015
"""Distance (m) from the table's top within which a mesh ends on it: its foot is in the shadow of
what is above, and cells of the grid are as large as 3 mm."""


def _tried(plan: GraspPlan, pose_error: tuple[float, float], seed: int, beaten: float) -> CloudPlan:
    """A plan with the share of samples that it survives; less where it is not above ``beaten``."""
    belief = plan.task.object.belief
    assert belief is not None, "the plan is of a cloud"
    planned = plan.contacts_in_object
    n, rng = len(planned), np.random.default_rng(seed)
    points, frames = planned.positions, planned.frames
    # a contact, and one step along each of its axes: value and slope of the surface
    stencil = np.concatenate([np.zeros((3, 1)), STEP * np.eye(3)], axis=1)
    spots = points[:, None] + np.einsum("nde,ek->nkd", frames, stencil)
    errors = belief.samples(spots.reshape(-1, 3), SAMPLES, rng).reshape(SAMPLES, n, 4)
    weights = np.array([h.weight for h in belief.hypotheses])
    kinds = rng.choice(len(weights), SAMPLES, p=weights / weights.sum())
    shifts = rng.normal(size=(SAMPLES, 3)) * pose_error[0]
    turns = rng.normal(size=(SAMPLES, 3)) * pose_error[1]
    if belief.cloud.table is not None:
        shifts[:, 2] = turns[:, :2] = 0.0
    # where the object's surface is if its pose is off: seen from it, contacts are elsewhere
    moved = spots[None] - shifts[:, None, None] - np.cross(turns[:, None, None], spots[None])
    way = np.zeros((SAMPLES, n))
    for _ in range(NEWTON):
        at = moved + way[:, :, None, None] * frames[:, None, :, 0]
        values = np.empty((SAMPLES, n, 4))
        for kind in np.unique(kinds):
            mine = kinds == kind
            values[mine] = belief.mean(at[mine].reshape(-1, 3), int(kind)).reshape(-1, n, 4)
        here = values[..., 0] + errors[..., 0]
        slope = (values[..., 1:] - values[..., :1]) / STEP  # along normal (inward) and tangents
        inward = -slope[..., 0]
        steep = inward > LEAST_SLOPE
        way = np.clip(way + here / np.where(steep, inward, 1.0), -2.0 * FELT, 2.0 * FELT)
    slope[..., 1:] += (errors[..., 2:] - errors[..., :1]) / STEP
    reached = (way <= FELT) & (way >= SPARE - plan.pregrasp_distance)
    touched = (steep & reached & (np.abs(here) < FELT / 4)).all(axis=1)
    positions = moved[:, :, 0] + way[..., None] * frames[:, :, 0]
    normals = -np.einsum("nde,sne->snd", frames, slope)
    hits = [_hits(plan, belief, kind) for kind in range(len(weights))]
    lags = way - way.min(axis=1, keepdims=True)
    tips = (lags.max(axis=1) > LAG) & _tips(plan)[way.argmin(axis=1)]
    held, left = 0, np.flatnonzero(touched & ~np.array(hits)[kinds])
    for done, k in enumerate(left):
        if held + len(left) - done <= beaten * SAMPLES:
            break
        held += _closed(planned, positions[k], normals[k])
    tilt = errors[..., 2:] - errors[..., :1]
    return CloudPlan(
        plan=plan,
        survival=held / SAMPLES,
        tipping=float(tips.mean()),
        samples=SAMPLES,
        position_std=belief.deviation(points),
        normal_std=np.arctan(tilt.std(axis=0).mean(axis=1) / STEP),
        refused=(),
    )


NEWTON = 3
"""Steps by which a finger's way to the surface is found."""

LEAST_SLOPE = 0.3
"""Slope (-) of the surface's distance along a contact's normal below which a finger slides past."""


LAG = 0.002
"""Way (m) by which the last finger comes later than the first that moves an object on its table."""

TABLE_MU = 0.6
"""Friction (-) of object and table beyond which pushes are not thought of: that of a trial."""


BASE = 0.005
"""Height (m) of what counts as an object's base, whose edge a belief rounds."""


def _tips(plan: GraspPlan) -> NDArray[np.bool_]:
    """Whether each finger (n,), were it the first to push, tips the object instead of sliding it.

    A push at height h by what friction with the table bears, mu W, tips it where mu h exceeds the
    lever of the weight about the edge of the base. What has no base, as a ball, rolls either way.
    """
    task, contacts = plan.task, plan.contacts
    if task.table_height is None:
        return np.zeros(len(contacts), dtype=bool)
    vertices = surface_triangles(task.object.shape)[0] @ task.T_world_object.rotation.T
    base = vertices[vertices[:, 2] < vertices[:, 2].min() + BASE]
    push = contacts.normals[:, :2]
    levers = (push @ base[:, :2].T).max(axis=1)
    heights = contacts.positions[:, 2] - task.table_height
    flat = np.linalg.norm(push, axis=1)
    tips = (levers > SPARE * flat) & (TABLE_MU * heights * flat > levers)
    return np.asarray(tips, dtype=bool)


def _closed(contacts: ContactSet, positions: FloatArray, normals: FloatArray) -> bool:
    """Whether contacts close elsewhere."""
    there = replace(contacts, positions=positions, frames=contact_frames(normals))
    return plainly_closed(there, CLOSURE_EDGES) or force_closure(there, CLOSURE_EDGES).closed


def _hits(plan: GraspPlan, belief: Belief, kind: int) -> bool:
    """Whether the palm or an inner link is in another hypothesis."""
    hand, state = plan.task.hand, HandState(plan.task.hand, plan.q)
    spheres = [s for s in link_spheres(hand) if not s.is_pad and not s.on_tip]
    T_object_base: SE3 = plan.task.T_world_object.inverse() * plan.T_world_base
    poses = [T_object_base * state.joint_pose(i) for i in range(len(state.pin_data.oMi))]
    centers = np.array([poses[s.joint_id].act(s.center) for s in spheres])
    radii = np.array([s.radius for s in spheres])
    # on the chosen one the plan is verified: links are no larger than they are clear of it
    radii = np.minimum(radii, belief.mean(centers))
    gaps = belief.mean(centers, kind) - radii
    return bool(gaps.min(initial=np.inf) < -SPARE - belief.grid.spacing)


def _commonest(failures: list[Failure]) -> str:
    """The text of the commonest kind of failure."""
    kinds = [f.kind for f in failures]
    return next((f.text for f in failures if f.kind == max(kinds, key=kinds.count)), "none made")


def _abstained(
    best: CloudPlan | None,
    survives: float,
    belief: Belief,
    refused: list[str],
    made: list[Attempt[GraspPlan]],
) -> UncertainError:
    """Why no plan is given."""
    if best is None:
        why = "no grasp was found whose contacts are certain enough: " + "; ".join(refused)
    else:
        worst = 1e3 * float(best.position_std.max())
        why = (
            f"the best grasp survives {best.survival:.0%} of {best.samples} samples of what may be "
            f"true, less than {survives:.0%}: the surface at its contacts is known to "
            f"{worst:.1f} mm at worst"
        )
    return UncertainError(
        f"too little of the object was seen: {why}. Add a view from another side, or give less "
        f"noise if {1e3 * belief.cloud.noise:.1f} mm is too much",
        tuple(made),
        best,
    )
