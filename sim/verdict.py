"""The verdict on a trial: held, held by another grasp than was planned, or the reason why not.

``judge`` is a pure function of the samples: a trial is judged by numbers, after the fact, and the
same samples always get the same verdict. Of several faults the first in time is the reason, except
that an object that ends on the ground was "dropped", however it began to move. An object that was
held while a finger touched it further than ``Thresholds.contact_mm`` from its planned contact was
held by another grasp: a verdict of its own, since nothing that was proven of the plan is known of
that grasp.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np

from planner.arrays import check_fields
from planner.spatial import FloatArray
from sim.recording import Samples

__all__ = [
    "COLLISION_N",
    "OUTCOMES",
    "REASONS",
    "Fault",
    "GraspOutcome",
    "LossCriteria",
    "Reason",
    "Thresholds",
    "Verdict",
    "first_collision",
    "judge",
    "largest",
    "lost",
    "put_down_to_actuators",
]

Reason: TypeAlias = Literal[
    "",
    "no contact",
    "slipped",
    "dropped",
    "tipped",
    "hand collided",
    "torque limit reached",
    "infeasible forces",
    "penetration",
    "left the fixture",
    "use not done",
    "interrupted",
    "stopped",
    "diverged",
    "not run",
]
"""Why a trial did not succeed; "" if it did."""

REASONS: tuple[Reason, ...] = Reason.__args__  # type: ignore[attr-defined]
"""Every reason a verdict can have; "" is success."""


GraspOutcome: TypeAlias = Literal["held", "held, another grasp", "not held"]
"""How a trial ended: held as planned, held by another grasp, or not held."""

OUTCOMES: tuple[GraspOutcome, ...] = GraspOutcome.__args__  # type: ignore[attr-defined]
"""Every outcome of a trial."""


COLLISION_N = 1.0
"""Normal force (N) from which on hand on table, obstacle or itself is a collision, in trials as in
manipulations. A light touch is let pass, as a person's would be."""


@dataclass(frozen=True, kw_only=True)
class Thresholds:
    """Where success ends.

    Attributes:
        slip_mm: Movement of the object's centre of mass relative to the palm since the end of the
            squeeze, mm.
        slip_deg: Rotation likewise, degrees.
        disturbed_mm: Movement of the object before the lift, mm: more is called tipped.
        disturbed_deg: Rotation before the lift, degrees.
        lift_shortfall_mm: How far the object may end below the height asked for, mm.
        collision_N: Normal force between hand and table, obstacle or itself, N.
        contact_mm: Distance of a finger's mean contact in the hold from its planned one, in the
            object's frame, mm: beyond it the object is held by another grasp. Half the width of a
            fingertip; planned grasps are executed to 0.1 to 0.5 mm without sensor errors
            (``python -m benchmarks grasps``).
        saturated_share: Share of the samples under load in which an actuator stood at its limit,
            from which on a failure is put down to that (-).
    """

    slip_mm: float = 5.0
    slip_deg: float = 5.0
    disturbed_mm: float = 20.0
    disturbed_deg: float = 20.0
    lift_shortfall_mm: float = 5.0
    collision_N: float = COLLISION_N
    contact_mm: float = 5.0
    saturated_share: float = 0.5

    def __post_init__(self) -> None:
        """Check that every threshold is positive."""
        check_fields(self, what="threshold ", above=0.0, infinite=True)


@dataclass(frozen=True, kw_only=True)
class Fault:
    """Why an object was not held.

    Attributes:
        reason: One of ``REASONS``, not "".
        detail: What happened, in words with numbers.
        time: When, s of simulated time.
    """

    reason: Reason
    detail: str
    time: float = 0.0


@dataclass(frozen=True)
class Verdict:
    """Held, held by another grasp than was planned, or the reason why not.

    Attributes:
        fault: Why the object was not held; None if it was.
        other_grasp: Of an object that was held by another grasp: the finger that touched furthest
            from its planned contact, and how far, in words; "" otherwise.
    """

    fault: Fault | None = None
    other_grasp: str = ""

    @property
    def outcome(self) -> GraspOutcome:
        """One of ``OUTCOMES``."""
        if self.fault is not None:
            return "not held"
        return "held, another grasp" if self.other_grasp else "held"

    @property
    def as_planned(self) -> bool:
        """Whether the object was held by the grasp that was planned."""
        return self.outcome == "held"

    @property
    def success(self) -> bool:
        """Whether the object was held."""
        return self.fault is None

    @property
    def reason(self) -> Reason:
        """Why not; "" for success."""
        return "" if self.fault is None else self.fault.reason

    @property
    def detail(self) -> str:
        """What happened, in words with numbers; "" for success."""
        return "" if self.fault is None else self.fault.detail

    @property
    def time(self) -> float:
        """When it happened, s; NaN for success."""
        return float("nan") if self.fault is None else self.fault.time


@dataclass(frozen=True, kw_only=True)
class LossCriteria:
    """When an object counts as lost in trials, manipulations and the protocols of MuJoCo.

    Reset states have tests of their own: ``sim.datasets.reset_states.hold``.

    Attributes:
        fewest: Fewest fingers that hold it, the palm counted as one where the caller counts it.
        mm: Movement from which on it is lost, mm: in the palm unless the caller measures another.
        deg: Rotation likewise, degrees.
    """

    fewest: int = 1
    mm: float = float("inf")
    deg: float = float("inf")

    def __post_init__(self) -> None:
        """Check every number."""
        check_fields(self, ("fewest",), what="lost: ")
        check_fields(self, ("mm", "deg"), what="lost: ", above=0.0, infinite=True)


def lost(
    criteria: LossCriteria, *, touching: int, moved: tuple[float, float] = (0.0, 0.0)
) -> Literal["", "dropped", "slipped"]:
    """Whether an object is lost, and how; "" if it is held.

    Args:
        criteria: When it counts as lost.
        touching: How many fingers touch it.
        moved: How far it has moved, mm and degrees; NaN where that is not known.
    """
    if touching < criteria.fewest:
        return "dropped"
    return "slipped" if moved[0] >= criteria.mm or moved[1] >= criteria.deg else ""


def put_down_to_actuators(
    fault: Fault, saturated: Sequence[tuple[str, ...]], share: float = 0.5
) -> Fault:
    """The same fault, or "torque limit reached" if an actuator was saturated before it.

    Args:
        fault: What happened.
        saturated: Names of the saturated actuators at each look before it.
        share: Share of the looks from which on a saturated actuator is the reason (-).
    """
    counted = Counter(name for names in saturated for name in set(names))
    often = sorted(name for name, looks in counted.items() if looks >= share * len(saturated))
    if not often:
        return fault
    detail = f"{', '.join(often)} stood at the limit; then: {fault.reason}, {fault.detail}"
    return Fault(reason="torque limit reached", detail=detail, time=fault.time)


def judge(
    samples: Samples,
    *,
    fingers: tuple[str, ...],
    needed: int,
    lift_mm: float,
    thresholds: Thresholds,
    interrupted: bool = False,
    stopped: str = "",
    diverged: str = "",
    not_lifted: str = "",
    contacts_off_mm: Mapping[str, float] | None = None,
) -> Verdict:
    """The verdict on a trial.

    Args:
        samples: What was recorded, up to the end or to where the trial was given up.
        fingers: Names of the fingers that take part.
        needed: Fewest fingers that can hold the object.
        lift_mm: How far the object was to be lifted.
        thresholds: Where success ends.
        interrupted: Whether a person ended the trial (Ctrl-C).
        stopped: Why the caller ended it, "" if not.
        diverged: What went wrong numerically, "" if nothing did.
        not_lifted: Why the hand decided not to lift the object, "" if it did not.
        contacts_off_mm: Finger -> distance of its mean contact in the hold from its planned one,
            mm; NaN without contact, which ``needed`` judges.
    """
    if early := ended_early(samples, interrupted=interrupted, stopped=stopped, diverged=diverged):
        return Verdict(early)
    end = float(samples.time[-1]) if len(samples) else 0.0
    faults = [
        fault
        for fault in (
            first_collision(
                samples.time, samples.collision_N, samples.collision, thresholds.collision_N
            ),
            tipped(samples, thresholds),
            no_contact(samples, fingers, needed),
            _dropped_or_slipped(samples, fingers, needed, lift_mm, thresholds),
        )
        if fault is not None
    ]
    if not faults and not_lifted:
        return Verdict(Fault(reason="no contact", detail=not_lifted, time=end))
    if not faults:
        if not len(samples.during("hold")):
            return Verdict(ended_early(samples, interrupted=True))
        return Verdict(other_grasp=other_grasp(contacts_off_mm or {}, thresholds.contact_mm))
    return Verdict(first_fault(faults, samples, thresholds))


def ended_early(
    samples: Samples, *, interrupted: bool = False, stopped: str = "", diverged: str = ""
) -> Fault | None:
    """Why a trial ended before its end; None if it did not. Arguments as in ``judge``."""
    end = float(samples.time[-1]) if len(samples) else 0.0
    if diverged:
        return Fault(reason="diverged", detail=diverged, time=end)
    if stopped:
        detail = f"stopped by the caller after {end:.2f} s of simulated time: {stopped}"
        return Fault(reason="stopped", detail=detail, time=end)
    if interrupted:
        detail = f"ended after {end:.2f} s of simulated time, before the hold was over"
        return Fault(reason="interrupted", detail=detail, time=end)
    return None


def first_fault(faults: Sequence[Fault], samples: Samples, thresholds: Thresholds) -> Fault:
    """The first of several faults, put down to actuators at their limits if they were."""
    first = min(faults, key=lambda fault: fault.time)
    if first.reason == "hand collided":
        return first
    looks = [
        names
        for phase, time, names in zip(samples.phase, samples.time, samples.saturated, strict=True)
        if phase not in ("approach", "close") and time <= first.time
    ]
    return put_down_to_actuators(first, looks, thresholds.saturated_share)


def other_grasp(off_mm: Mapping[str, float], limit_mm: float) -> str:
    """The finger furthest from its planned contact, if that is beyond the limit; "" if none is."""
    far = {finger: mm for finger, mm in off_mm.items() if mm > limit_mm}
    if not far:
        return ""
    finger = max(far, key=lambda name: far[name])
    others = f", and {len(far) - 1} more are off" if len(far) > 1 else ""
    return (
        f"{finger} touches {far[finger]:.0f} mm from its planned contact ({limit_mm:g} mm are "
        f"allowed){others}"
    )


def first_collision(
    time: FloatArray, force: FloatArray, pairs: Sequence[str], limit: float
) -> Fault | None:
    """The first collision of the hand with table, obstacle or itself; None if there is none.

    Args:
        time: (m,), s.
        force: (m,), largest normal force of such a pair at each sample, N.
        pairs: m names of the pair.
        limit: Force from which on it is a collision, N.
    """
    i = _first(force > limit)
    if i is None:
        return None
    most = float(np.nanmax(force[i:]))
    detail = f"{pairs[i]} with {force[i]:.1f} N"
    if most > force[i]:
        detail += f" (up to {most:.1f} N later)"
    return Fault(reason="hand collided", detail=detail, time=float(time[i]))


def tipped(samples: Samples, thresholds: Thresholds) -> Fault | None:
    """An object that moved before the lift; None if it did not."""
    before = np.isin(np.array(samples.phase), ("approach", "close", "squeeze", "settle"))
    far = samples.moved_mm > thresholds.disturbed_mm
    far |= samples.turned_deg > thresholds.disturbed_deg
    i = _first(before & far)
    if i is None:
        return None
    detail = (
        f"the object moved {samples.moved_mm[i]:.0f} mm and turned {samples.turned_deg[i]:.0f} "
        f"degrees before the lift, in phase {samples.phase[i]}"
    )
    return fault_at(samples, i, "tipped", detail)


def no_contact(
    samples: Samples,
    fingers: tuple[str, ...],
    needed: int,
    phases: tuple[str, ...] = ("squeeze", "settle"),
    columns: slice = slice(None),
) -> Fault | None:
    """Too few fingers on the object at the end of phases; None if there are enough.

    Args:
        samples: What was recorded.
        fingers: Names of the fingers that count.
        needed: Fewest that can hold the object.
        phases: At the end of which it counts.
        columns: Where these fingers stand among those recorded.
    """
    index = samples.during(*phases)
    if len(index) == 0:
        return None
    i = int(index[-1])
    touching = samples.contacts[i, columns] > 0
    if int(touching.sum()) >= needed:
        return None
    missing = [f for f, touches in zip(fingers, touching, strict=True) if not touches]
    detail = (
        f"after the {phases[0]} {', '.join(missing)} did not touch; {needed} fingers are needed"
    )
    return fault_at(samples, i, "no contact", detail)


def _dropped_or_slipped(
    samples: Samples,
    fingers: tuple[str, ...],
    needed: int,
    lift_mm: float,
    thresholds: Thresholds,
) -> Fault | None:
    """Dropped or slipped, in lift and hold."""
    index = samples.during("lift", "hold")
    if len(index) == 0:
        return None
    holding = LossCriteria(fewest=needed)
    staying = LossCriteria(fewest=0, mm=thresholds.slip_mm, deg=thresholds.slip_deg)
    touching = (samples.contacts > 0).sum(axis=1)
    loose = [int(i) for i in index if lost(holding, touching=touching[i])]
    last = int(index[-1])
    short = lift_mm - samples.lift_mm[last]
    if last in loose or short > lift_mm / 2:
        detail = (
            f"at the end {touching[last]} of {len(fingers)} fingers touched, and the object had "
            f"risen {samples.lift_mm[last]:.0f} of {lift_mm:.0f} mm"
        )
        return fault_at(samples, loose[0] if loose else last, "dropped", detail)
    moved = [
        int(i)
        for i in index
        if lost(staying, touching=touching[i], moved=(samples.slip_mm[i], samples.slip_deg[i]))
    ]
    if not moved and short <= thresholds.lift_shortfall_mm:
        return None
    detail = (
        f"the object moved up to {largest(samples.slip_mm):.1f} mm and "
        f"{largest(samples.slip_deg):.1f} degrees in the hand, and ended {short:.1f} mm low"
    )
    return fault_at(samples, moved[0] if moved else last, "slipped", detail)


def fault_at(samples: Samples, i: int, reason: Reason, detail: str) -> Fault:
    """A fault at the time of a sample."""
    return Fault(reason=reason, detail=detail, time=float(samples.time[i]))


def _first(condition: Any) -> int | None:
    index = np.flatnonzero(condition)
    return int(index[0]) if len(index) else None


def largest(values: FloatArray) -> float:
    """The largest of the numbers that are not NaN; NaN if there is none."""
    known = values[np.isfinite(values)]
    return float(known.max()) if len(known) else float("nan")
