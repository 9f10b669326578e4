"""``plan_from_cloud``: a grasp of what cameras saw a part of, or an error that says why none.

Grasps are planned on the mesh of each plausible hypothesis, with fingers where the surface is
certain enough. Each then has to survive what may be true instead: samples of the hypothesis, of the
surface's process at the contacts and of the error of the object's pose. A finger goes on along its
contact's normal until it feels the surface. A sample asks for closure with the task's friction
and a hand clear of that hypothesis. The grasp that survives most is taken, less half of the share
in which the first finger may tip the object instead of sliding it, and less the share of the hand
that is where no camera saw through.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from pinocchio import exp3

from planner.arrays import checked_kind, checked_number
from planner.certify import Tolerance, contact_tolerances
from planner.clouds.belief import Belief
from planner.clouds.cloud import PointCloud
from planner.collision.pregrasp import Approach
from planner.errors import PlannerError, TaskError, UncertainError
from planner.failure import Failure
from planner.hands.hand import Hand
from planner.objects import DEFAULT_MASS, GraspObject
from planner.plan import GraspPlan
from planner.search.attempt import Attempt, check_seed
from planner.search.grasp import attempts
from planner.search.in_the_way import CLEAR, SPARE, things_about
from planner.search.survival import survival_of
from planner.shapes import Mesh
from planner.spatial import SE3, FloatArray, signed_twist
from planner.synthesis.options import SynthesisOptions
from planner.task import GraspTask, Obstacle
from planner.verification import verify_grasp

__all__ = ["CloudPlan", "plan_from_cloud"]

SURVIVES, GOOD, ENOUGH = 0.1, 0.8, 0.9
"""Share of samples (-) that a plan must survive, the merit with which no other hypothesis is
planned on, and the one with which no other plan is made. Samples
are harder than the world is: on 80 development scans (40 of one view) 67 of 72 plans that survived
0.3 or more were held, and of the 7 that survived less, 0.03 to 0.23, six were held too."""

ATTEMPTS, AGAIN, NEXT_SEED = 12, 4, 1000
"""Attempts for each hypothesis, one in how many of them again with ordinary margins, and what is
added to a seed to plan anew (-)."""

PLAUSIBLE = 0.08
"""Weight (-) of a hypothesis below which nothing is planned on it."""

TRIED, PLANS, KEPT = 2, 3, 3
"""Hypotheses on which grasps are planned, plans for each, and plans that are kept of all."""

CONE_SHARE = 0.5
"""Share of the friction (-) that the internal force of synthesis may use: 14 degrees of 27 are left
to errors of the normals."""

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
        clearance: Least distance of the hand from seen points, of the object and of other things,
            links that touch left out, m; twice ``CLEAR`` if it is more. Below ``CLEAR`` nothing is
            survived.
        others: The next best plans, best first, at most ``KEPT`` with this one.
        pose_error: Standard deviations of the pose's error, m and rad, that samples have.
        survives: Share of samples (-) that a plan must survive.
        hidden: Share of the hand's volume (-), at the grasp, through which no camera saw.
        options: Margins of the search, with which grasps are planned anew; widened ones if None.
        max_attempts: Attempts for each hypothesis, then too.
    """

    plan: GraspPlan
    survival: float
    tipping: float
    samples: int
    position_std: FloatArray
    normal_std: FloatArray
    refused: tuple[str, ...] = ()
    clearance: float = 2.0 * CLEAR
    others: tuple[CloudPlan, ...] = ()
    pose_error: tuple[float, float] = (0.0, 0.0)
    survives: float = SURVIVES
    hidden: float = 0.0
    options: SynthesisOptions | None = None
    max_attempts: int = ATTEMPTS

    def after(self, felt: FloatArray, moved: SE3 | None = None) -> CloudPlan | None:
        """The next plan after a try that felt the object at places (m, 3), m; None if none is left.

        Felt places correct the object's place along the table, and are conditions of its surface
        from then on; hypotheses that they contradict lose weight. Every other plan is verified
        where the object is then, and tried on samples again. If none is left, grasps are planned
        anew, with another seed; not for an arm.

        Args:
            felt: In the object's frame as it was planned, with which they moved.
            moved: How the object has moved since then, world; not at all if None.
        """
        belief, shift = self.belief.with_felt(felt, self.pose_error[0])
        task = self.plan.task
        turn = task.T_world_object.rotation
        there = (SE3.Identity() if moved is None else moved) * SE3(np.eye(3), turn @ shift)
        if self.belief.cloud.table is not None:
            there = along_table(there, task.T_world_object.translation)
        found = []
        for other in self.others:
            plan = _verified(other.plan, belief, there)
            if isinstance(plan, GraspPlan):
                found.append(_tried(plan, self.pose_error, plan.record.seed, 0.0))
        good = [p for p in sorted(found, key=lambda p: -p.merit) if p.survival >= self.survives]
        if not good and self.plan.arm is None:
            seed = self.plan.record.seed + NEXT_SEED
            anew = partial(_task_again, task, belief, there)
            budget = self.max_attempts, self.options
            found = _searched(anew, belief, self.pose_error, seed, *budget).kept
            good = [p for p in found if p.survival >= self.survives]
        if not good:
            return None
        return replace(good[0], others=tuple(good[1:]), survives=self.survives,
                       options=self.options, max_attempts=self.max_attempts)  # fmt: skip

    @property
    def merit(self) -> float:
        """By what plans are compared (-): survival less half of ``tipping``, and ``hidden``."""
        return self.survival - 0.5 * self.tipping - self.hidden

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
                f"the first finger may tip the object; {self.hidden:.0%} of the hand are where no "
                "camera saw through",
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
    max_attempts: int = ATTEMPTS,
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
    task_of = partial(_task, hand, belief, mass, name, task)
    found = _searched(task_of, belief, pose_error, seed, max_attempts, options)
    kept = sorted(found.kept, key=lambda plan: (plan.survival < survives, *_place(plan)))
    best = replace(kept[0], others=tuple(kept[1:])) if kept else None
    if best is None or best.survival < survives:
        raise _abstained(best, survives, belief, found.refused, found.made)
    return replace(best, refused=tuple(found.refused), survives=survives, options=options,
                   max_attempts=max_attempts)  # fmt: skip


@dataclass(kw_only=True)
class _Searched:
    """Plans of all hypotheses, the best first, attempts, and why others were not taken."""

    kept: list[CloudPlan] = field(default_factory=list)
    made: list[Attempt[GraspPlan]] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)


def _searched(
    task_of: Callable[[int], GraspTask],
    belief: Belief,
    pose_error: tuple[float, float],
    seed: int,
    max_attempts: int,
    options: SynthesisOptions | None,
) -> _Searched:
    """Plan on the task of each plausible hypothesis, which its number tells."""
    out = _Searched()
    order = np.argsort([-h.weight for h in belief.hypotheses], kind="stable")[:TRIED].tolist()
    likely = [k for k in order if k == order[0] or belief.hypotheses[k].weight >= PLAUSIBLE]
    few, beside = -(-max_attempts // AGAIN), dict[int, list[Obstacle]]()
    # ordinary margins where none is found with those for what is uncertain: the samples judge
    both = (_widened(belief, pose_error[0]), max_attempts), (SynthesisOptions(), few)
    for margins, most in ((options, max_attempts),) if options else both:
        for number in likely:
            hypothesis = belief.hypotheses[number]
            what = f"{hypothesis.name} (plausibility {hypothesis.weight:.2f})"
            try:
                task = task_of(number)
                if number not in beside:
                    beside[number] = things_about(task)
                among = replace(task, obstacles=(*task.obstacles, *beside[number]))
                search = islice(attempts(among, seed=seed, options=margins), most)
            except PlannerError as error:
                out.refused.append(f"{what}: {error}")
                continue
            begin = len(out.made)
            _add_best(search, task, out.kept, pose_error, seed, out.made)
            failures = [a.failure for a in out.made[begin:] if a.failure is not None]
            if len(failures) == len(out.made) - begin:
                common = _commonest(failures)
                out.refused.append(f"{what}: no grasp in {len(failures)} attempts: {common}")
            if out.kept and out.kept[0].merit >= GOOD:
                break
        if any(plan.clearance >= CLEAR for plan in out.kept):
            break
    return out


def _add_best(
    search: Iterable[Attempt[GraspPlan]],
    task: GraspTask,
    kept: list[CloudPlan],
    pose_error: tuple[float, float],
    seed: int,
    made: list[Attempt[GraspPlan]],
) -> None:
    """Add the first ``PLANS`` of a search that are clear, and those before, to the best ones."""
    plans = 0
    for attempt in search:
        made.append(attempt)
        if attempt.plan is None:
            continue
        is_full = len(kept) == KEPT and kept[-1].clearance >= CLEAR
        beaten = kept[-1].merit if is_full else 0.0
        # without what the search alone keeps away from
        its = replace(attempt.plan.task, obstacles=task.obstacles)
        plan = replace(attempt.plan, task=its)
        kept.append(_tried(plan, pose_error, seed, beaten))
        plans += kept[-1].clearance >= CLEAR  # other things in the way are often elsewhere
        kept.sort(key=_place)
        del kept[KEPT:]
        if plans == PLANS or kept[0].merit >= ENOUGH:
            break


def _place(plan: CloudPlan) -> tuple[bool, float]:
    """What plans are ordered by: those that are clear of what was seen come first."""
    return plan.clearance < CLEAR, -plan.merit


def _tried(plan: GraspPlan, pose_error: tuple[float, float], seed: int, beaten: float) -> CloudPlan:
    """A plan with what it survives, as far as it is above ``beaten``."""
    found = survival_of(plan, pose_error, seed, beaten)
    return CloudPlan(plan=plan, pose_error=pose_error, **vars(found))


def along_table(moved: SE3, about: FloatArray) -> SE3:
    """What a motion is along the table, of a place (3,), m, and about the vertical through it."""
    up = np.array([0.0, 0.0, 1.0])
    turn = exp3(signed_twist(moved.rotation, up) * up)
    way = moved.act(about) - about
    return SE3(turn, about - turn @ about + np.array([way[0], way[1], 0.0]))


def _verified(plan: GraspPlan, belief: Belief, moved: SE3) -> GraspPlan | Failure:
    """The plan of another belief, where its object has moved to, as every plan is verified."""
    old = plan.task.object.belief
    assert old is not None, "the plan is of a cloud"
    mine = replace(belief, chosen=old.chosen, offset=old.offset)
    task = replace(
        plan.task,
        object=replace(plan.task.object, belief=mine),
        T_world_object=moved * plan.task.T_world_object,
    )
    if plan.arm is not None:  # its way in was planned for where it was
        place = plan.task.T_world_object.translation
        way = np.linalg.norm(moved.act(place) - place)
        return plan if way < SPARE else Failure(kind="moved", text="the object has moved")
    way_in = Approach(
        q=plan.q_pregrasp,
        pregrasp_distance=plan.pregrasp_distance,
        T_world_base_start=moved * plan.T_world_base_start,
    )
    base = moved * plan.T_world_base
    return verify_grasp(task, base, plan.q, record=plan.record, approach=way_in)


def _widened(belief: Belief, shift: float) -> SynthesisOptions:
    """Margins for a surface and a pose, off by a shift (m), that are uncertain."""
    surface = float(np.median(belief.deviations))
    usual = SynthesisOptions()
    return replace(
        usual,
        clear_object=usual.clear_object + min(surface + shift, ROOM),
        # neighbours go on towards one another by less than each goes
        clear_fingers=usual.clear_fingers + min(surface + shift, ROOM) / 2.0,
        # along the table nothing comes nearer to it, and low objects leave no room below fingers
        clear_table=usual.clear_table + min(surface, ROOM),
        cone_share=CONE_SHARE,
    )


def _task(
    hand: Hand | str | Path,
    belief: Belief,
    mass: float,
    name: str,
    more: dict[str, Any],
    number: int,
) -> GraspTask:
    """The task of grasping a hypothesis, where the cloud has it, on its table."""
    chosen, mesh = belief.of_hypothesis(number)
    item = GraspObject(name=name, shape=mesh, mass=mass, belief=chosen)
    table = _stands_on(chosen, mesh)
    pose = chosen.T_world_object
    return GraspTask.create(hand, item, **{"T_world_object": pose, "table_height": table, **more})


def _task_again(task: GraspTask, belief: Belief, moved: SE3, number: int) -> GraspTask:
    """A task with a hypothesis of another belief, moved since the task's object was planned on."""
    chosen, mesh = belief.of_hypothesis(number)
    old, table = task.object, task.table_height
    by_cloud = (
        old.belief is not None
        and isinstance(old.shape, Mesh)
        and _stands_on(old.belief, old.shape) == table
    )
    if by_cloud:  # a height that was given stays
        table = _stands_on(chosen, mesh)
    since = task.T_world_object * SE3(np.eye(3), -belief.offset)
    return replace(
        task,
        object=replace(task.object, shape=mesh, belief=chosen),
        T_world_object=moved * since * chosen.T_world_object,
        table_height=table,
    )


def _stands_on(chosen: Belief, mesh: Mesh) -> float | None:
    """Height (m) of the table for a mesh, which may end above it, since no camera saw its foot."""
    table = chosen.cloud.table
    if table is None:
        return None
    lowest = float(chosen.offset[2]) - mesh.support(np.array([0.0, 0.0, -1.0]))
    return lowest if abs(lowest - table) < UNSEEN_FOOT else table


LOW = 0.025
"""Height (m) of an object on a table, about that of a fingertip, below which a refusal says so."""

UNSEEN_FOOT = 0.015
"""Distance (m) from the table's top within which a mesh ends on it: its foot is in the shadow of
what is above, and cells of the grid are as large as 3 mm."""


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
        why = "no grasp was found whose contacts are certain enough"
        failures = [a.failure for a in made if a.failure is not None]
        common = _commonest(failures).split(";")[0]
        why += f", {len(made)} tried: {common}" if failures else ": " + "; ".join(refused)
        table, top = belief.cloud.table, float(np.percentile(belief.cloud.points[:, 2], 95))
        if table is not None and top - table < LOW:
            why += (
                f". It is about {1e3 * (top - table):.0f} mm high: what is so low, as a "
                "thin ring, is touched from above by fingertips that are clear of the table"
            )
    elif best.clearance < CLEAR:
        return UncertainError(
            f"in the best grasp the hand is {1e3 * best.clearance:.1f} mm from what was seen of "
            f"the object beside its contacts, or of what stands beside it; {1e3 * CLEAR:g} mm is "
            "asked for. Take away what stands beside it, or give another seed",
            tuple(made),
            best,
        )
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
