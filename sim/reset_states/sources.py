"""Where states begin: planned grasps, turns and gaits as poses with commands that press.

A source holds the object with the planned forces of ``plan_squeeze``. Its commands are linear in
the squeeze: ``rest + s (press - rest)``, where ``rest`` are the commands that exert nothing there.
Poses are in the frame of the hand's base, which is the world of the scene
(``sim.reset_states.scene``).
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from planner.batch.jobs import end_with
from planner.batch.recipe import task_of
from planner.contacts import ContactSet
from planner.errors import NoGraspFoundError, PlannerError
from planner.exchange.dexgraspbench.squeeze import plan_squeeze
from planner.motion import MotionPlan, plan_motion
from planner.motion.gait import plan_gait
from planner.search import plan_grasp
from planner.spatial import SE3, FloatArray, pose_to_wxyz
from planner.task import GraspTask
from sim.reset_states.asked import Cell, StatesAsked

KINDS = ("grasp", "motion", "gait")
"""What a source is from."""

MOTION_ATTEMPTS = 6
"""Attempts per motion or gait: another plan with another seed follows anyway, and a gait that is
not found costs up to 3 s."""


@dataclass(frozen=True, kw_only=True)
class Source:
    """A planned pose of the object in the hand; lists instead of arrays, as it is kept in a file.

    Attributes:
        kind: What it is from, one of ``KINDS``.
        plan: Number of its plan among those of its kind.
        pose: Number of the pose along that plan, from 0.
        fingers: Names of the fingers that hold.
        q: Joints (nq,), rad or m.
        position: Of the object's centre of mass (3,) in the hand's base, m.
        quaternion: Its orientation there, w, x, y, z.
        rest: Commands (nu,) that exert nothing.
        press: Commands (nu,) of the planned squeeze.
    """

    kind: str
    plan: int
    pose: int
    fingers: tuple[str, ...]
    q: list[float]
    position: list[float]
    quaternion: list[float]
    rest: list[float]
    press: list[float]

    def to_dict(self) -> dict[str, Any]:
        """As plain data."""
        return asdict(self)


@dataclass(frozen=True, kw_only=True)
class PlanJob:
    """One plan that is to be made, as it is sent to a worker.

    Attributes:
        recipe: The task as text.
        kind: What is planned, one of ``KINDS``.
        k: Number of the plan among those of its kind.
        seed: Seed of its search.
        turn: Angle of a turn, rad.
        parent: Process that asked for it.
    """

    recipe: str
    kind: str
    k: int
    seed: int
    turn: float
    parent: int

    @property
    def key(self) -> str:
        """What names it in a journal."""
        return f"{self.kind} {self.k}"


def plan_jobs(asked: StatesAsked, cell: Cell) -> Iterator[PlanJob]:
    """The plans of a cell; the seed of each depends on seed, cell, kind and number alone."""
    for number, (kind, count) in enumerate(
        zip(KINDS, (asked.grasps, asked.motions, asked.gaits), strict=True)
    ):
        for k in range(count):
            words = np.random.SeedSequence([asked.seed, cell.number, number, k])
            seed = int(words.generate_state(1, np.uint64)[0] >> np.uint64(1))
            yield PlanJob(
                recipe=cell.recipe, kind=kind, k=k, seed=seed, turn=asked.turn, parent=os.getpid()
            )


def planned_sources(job: PlanJob) -> dict[str, Any]:
    """Make a plan: its sources, or the reason why there are none, under the job's key."""
    end_with(job.parent)
    task = task_of(job.recipe)
    try:
        found = list(_sources(job, task))
    except NoGraspFoundError as error:
        return {"key": job.key, "reason": str(error).splitlines()[0], "sources": []}
    except PlannerError as error:
        return {"key": job.key, "reason": str(error), "sources": []}
    reason = "" if found else "the servos cannot press as planned"
    return {"key": job.key, "reason": reason, "sources": [s.to_dict() for s in found]}


def _sources(job: PlanJob, task: GraspTask) -> Iterator[Source]:
    rng = np.random.default_rng(job.seed)
    axis = rng.normal(size=3)
    if job.kind == "grasp":
        plan = plan_grasp(task, seed=job.seed)
        yield from _pose(
            job, 0, plan.task, plan.contacts, plan.T_world_base, plan.q, task.T_world_object
        )
    elif job.kind == "motion":
        # every second turn is about the object's own axis, where round objects roll best
        axis = axis if job.k % 2 else np.array([0.0, 0.0, 1.0])
        turn = job.turn if job.k % 4 < 2 else -job.turn
        motion = plan_motion(
            task, axis=axis, angle=turn, seed=job.seed, max_attempts=MOTION_ATTEMPTS
        )
        yield from _knots(job, motion)
    else:
        gait = plan_gait(
            task,
            axis=(0.0, 0.0, 1.0),
            angle=2.0 * job.turn,
            seed=job.seed,
            max_attempts=MOTION_ATTEMPTS,
        )
        yield from _knots(job, gait.motion)
        own, number = gait.motion.grasp.task, len(gait.motion.knots)
        for move in gait.relocations:
            if move.cycle == 0:  # later cycles repeat the postures
                number += 1
                q = move.postures[len(move.postures) // 2]
                less = own.with_fingers(move.during.fingers)
                T_base = gait.T_world_base
                yield from _pose(job, number, less, move.during, T_base, q, move.T_world_object)


def _knots(job: PlanJob, motion: MotionPlan) -> Iterator[Source]:
    for number, knot in enumerate(motion.knots):
        yield from _pose(
            job,
            number,
            motion.grasp.task,
            knot.contacts,
            motion.T_world_base,
            knot.q,
            knot.T_world_object,
        )


def _pose(
    job: PlanJob,
    number: int,
    task: GraspTask,
    contacts: ContactSet,
    T_world_base: SE3,
    q: FloatArray,
    T_world_object: SE3,
) -> Iterator[Source]:
    """The source of one pose, if the servos can press there."""
    squeeze = plan_squeeze(task, contacts, T_world_base, q)
    if squeeze.reason:
        return
    rest, _ = task.hand.actuation.ctrl_for_torque(q, np.zeros_like(q), np.zeros_like(q))
    position, quaternion = pose_to_wxyz(T_world_base.inverse() * T_world_object)
    yield Source(
        kind=job.kind,
        plan=job.k,
        pose=number,
        fingers=tuple(contacts.fingers),
        q=q.tolist(),
        position=position.tolist(),
        quaternion=quaternion.tolist(),
        rest=rest.tolist(),
        press=squeeze.ctrl.tolist(),
    )
