"""``GraspPlan``: a verified grasp, everything needed to execute it, and the proof of what it is."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from planner.collision.arm_path import ArmPath
from planner.collision.world import Clearance
from planner.contacts import ContactSet
from planner.failure import Failure
from planner.forces import ForceSolution
from planner.immutable import freeze
from planner.kinematics import HandState
from planner.quality import QualityReport, analyse
from planner.showing import Shown, in_notebook
from planner.spatial import SE3, FloatArray, interpolate_path, minimum_jerk
from planner.task import GraspTask

__all__ = ["BestOf", "GraspPlan", "JointTrajectory", "SearchRecord", "SolveRecord", "Verification"]


@dataclass(frozen=True, kw_only=True)
class SearchRecord:
    """Which attempt of a search gave a plan, and what that cost; ``run_attempts`` fills it in.

    Attributes:
        seed: Seed of the search.
        attempt: Number of the attempt that gave the plan, from 0; seed and attempt fix the start.
        attempts: How many attempts had been made when it was found.
        cpu_s: CPU time of the search until it was found, s, without building.
        build_s: Time that building the problem took, s: once per hand, fingers and kind of shape.
    """

    seed: int = 0
    attempt: int = 0
    attempts: int = 1
    cpu_s: float = 0.0
    build_s: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Verification:
    """Residuals of a grasp on the true geometry.

    Attributes:
        pad_gaps: Signed distance of each finger's pad from the surface, (n,), m: of its sphere, or
            of the geometry that carries it where the sphere only approximates that.
        pad_geometry_gaps: The same for the whole geometry that carries the pad, by coal, (n,), m.
        pad_angles: Angle between pad axis and contact direction, (n,), rad.
        closest: The smallest clearances that are not pad contacts, nearest first.
        coupling_error: Largest violation of a kinematic coupling, rad.
        limit_error: Largest violation of a joint limit, rad.
        failures: What fails; empty if the grasp holds geometrically.
    """

    pad_gaps: FloatArray
    pad_geometry_gaps: FloatArray
    pad_angles: FloatArray
    closest: tuple[Clearance, ...]
    coupling_error: float
    limit_error: float
    failures: tuple[Failure, ...]

    @property
    def ok(self) -> bool:
        """Whether nothing failed."""
        return not self.failures

    @property
    def failure(self) -> Failure | None:
        """All failures as one, of the kind of the first; None where nothing failed."""
        if self.ok:
            return None
        text = "; ".join(f.text for f in self.failures)
        return replace(self.failures[0], text=f"true geometry: {text}")


@dataclass(frozen=True, kw_only=True)
class BestOf:
    """Of how many plans one is the best, and by what.

    Attributes:
        found: Plans that the search found.
        metric: Metric by which they were compared, or several with weights
            (``planner.search.metrics.Measure``).
        value: Of the plan, in the metric's unit.
        improving: Whether the attempts built on each other (``keep="best"``).
    """

    found: int
    metric: str
    value: float
    improving: bool


@dataclass(frozen=True, kw_only=True)
class SolveRecord(SearchRecord):
    """Where a grasp comes from.

    Of a plan that is the best of several, ``attempts`` and ``cpu_s`` are those of the whole search:
    the same seed with ``max_attempts=attempts`` and otherwise the same arguments gives it again on
    any machine, whatever the budget in CPU seconds was.

    Attributes:
        iterations: Evaluations of the residuals in its attempt.
        status: Why least squares ended (informative only; the verdict is ``Verification``).
        objective: What the grasp was to be good at, as ``SynthesisOptions.objective``.
        best: Of how many it is the best; None for the first found.
    """

    iterations: int
    status: str
    objective: str = "epsilon"
    best: BestOf | None = None


@dataclass(frozen=True, kw_only=True)
class JointTrajectory:
    """Joint positions over time, for a real hand.

    Attributes:
        joint_names: n names.
        times: (m,), s.
        positions: (m, n), rad (m for slides).
        phases: What each sample belongs to, m names.
        T_world_base: Base pose at each sample, m poses.
    """

    joint_names: tuple[str, ...]
    times: FloatArray
    positions: FloatArray
    phases: tuple[str, ...]
    T_world_base: tuple[SE3, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class GraspPlan(Shown):
    """A grasp that passed every check of ``planner.verification`` and the force QP.

    Like its task it never changes: poses and arrays are read-only copies.

    Attributes:
        task: What was asked.
        T_world_base: Pose of the hand's base at the grasp.
        T_world_base_start: Pose from which the base moves straight to it with ``q_pregrasp``.
        q: Joints at the grasp (nq,), pads just touching, order of ``hand.joint_names``.
        q_pregrasp: Joints (nq,), pads opened along the contact normals.
        pregrasp_distance: By how much they are opened, m.
        contacts: Contacts with the true surface, world, with the planned forces.
        forces: The force distribution that balances the object's weight, with its residuals.
        verification: Residuals on the true geometry.
        record: Where the plan comes from.
        arm: Way in and lift of the arm that carries the hand; None without one.
        needed: Forces that produce ``needed_margin`` times each needed wrench of the task beside
            bearing the weight, in its order.
    """

    task: GraspTask
    T_world_base: SE3
    T_world_base_start: SE3
    q: FloatArray
    q_pregrasp: FloatArray
    pregrasp_distance: float
    contacts: ContactSet
    forces: ForceSolution
    verification: Verification
    record: SolveRecord
    arm: ArmPath | None = None
    needed: tuple[ForceSolution, ...] = ()

    def __post_init__(self) -> None:
        """Keep copies that nobody changes: what is proven of them is proven once."""
        freeze(self, poses=("T_world_base", "T_world_base_start"), arrays=("q", "q_pregrasp"))

    def __repr__(self) -> str:
        """One line; the attributes hold the rest."""
        return f"<GraspPlan of {self.task!r}, seed {self.record.seed}>"

    def __str__(self) -> str:
        """A screen: contacts with their forces, and the quality."""
        task, record, closure = self.task, self.record, self.quality.closure
        best = record.best
        found = f"found at attempt {record.attempt + 1}"
        if best is not None:
            found = (
                f"the best of {best.found} found in {record.attempts} attempts by {best.metric}, "
                f"{best.value:.4g}, at attempt {record.attempt + 1},"
            )
        at, used = self.contacts_in_object.positions, self.contacts.friction_utilisation()
        rows = [
            f"{name:10} {' '.join(f'{1e3 * v:7.1f}' for v in at[i])} "
            f"{self.contacts.forces[i, 0]:10.2f} {100 * used[i]:12.0f} % "
            f"{1e6 * self.verification.pad_gaps[i]:13.2f}"
            for i, name in enumerate(task.finger_names)
        ]
        return "\n".join(
            [
                f"plan: {task.hand.name} grasps {task.object.shape.spec} "
                f"({1e3 * task.object.mass:.0f} g), seed {record.seed}: {found} "
                f"in {record.cpu_s:.2f} s of CPU "
                f"(building {record.build_s:.2f} s)",
                *([f"object mended: {task.object.mended}"] if task.object.mended else []),
                "finger       contact in object (mm)  force (N)  friction used  pad gap (um)",
                *rows,
                f"force closure {'yes' if closure.closed else 'no'}, "
                f"epsilon {self.quality.epsilon:.4f}, "
                f"min-weight {closure.normalised_min_weight:.3f} (of 1); nearest other pair: "
                f"{self.verification.closest[0]}",
            ]
        )

    def _repr_html_(self) -> str:
        """What a notebook shows of it: a table and a picture, made once."""
        return in_notebook(self)

    @cached_property
    def quality(self) -> QualityReport:
        """Metrics of the contacts, computed when first asked for (tens of milliseconds)."""
        return analyse(self.contacts, length=self.task.object.shape.bounding_radius)

    @property
    def T_world_palm(self) -> SE3:
        """Pose of the palm's body at the grasp."""
        return self.T_world_base * HandState(self.task.hand, self.q).T_base_palm

    @property
    def q_start(self) -> FloatArray:
        """Joints (nq,) where the approach begins: fingers at the pre-grasp, an arm retreated."""
        q = self.q_pregrasp.copy()
        if self.arm is not None:
            q[self.task.hand.arm_index] = self.arm.approach[0]
        return q

    @property
    def contacts_in_object(self) -> ContactSet:
        """The planned contacts in the object's frame, in which plan and execution are compared."""
        return self.contacts.transformed(self.task.T_world_object.inverse())

    def joint_trajectory(
        self, *, approach_s: float = 1.5, close_s: float = 1.0, rate_hz: float = 50.0
    ) -> JointTrajectory:
        """Approach and closing as joint positions by name, for a real hand.

        The squeeze is a matter of forces, see ``forces``; it is not part of the trajectory.

        Args:
            approach_s: Duration of the straight approach, s.
            close_s: Duration of closing from the pre-grasp to the grasp, s.
            rate_hz: Samples per second.
        """
        n_approach = max(2, round(approach_s * rate_hz) + 1)
        n_close = max(2, round(close_s * rate_hz) + 1)
        s, r = np.linspace(0, 1, n_approach), np.linspace(0, 1, n_close)[1:]
        start, end = self.T_world_base_start.translation, self.T_world_base.translation
        bases = [
            SE3(self.T_world_base.rotation, start + a * (end - start)) for a in minimum_jerk(s)
        ]
        closing = self.q_pregrasp + minimum_jerk(r)[:, None] * (self.q - self.q_pregrasp)
        approach = np.tile(self.q_pregrasp, (n_approach, 1))
        if self.arm is not None:
            approach[:, self.task.hand.arm_index] = interpolate_path(
                self.arm.approach, minimum_jerk(s)
            )
        return JointTrajectory(
            joint_names=self.task.hand.joint_names,
            times=np.concatenate([s * approach_s, approach_s + r * close_s]),
            positions=np.vstack([approach, closing]),
            phases=("approach",) * n_approach + ("close",) * len(r),
            T_world_base=(*bases, *(self.T_world_base,) * len(r)),
        )
