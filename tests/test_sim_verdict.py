"""The verdict: every reason from samples made by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planner.errors import TaskError
from sim.controllers.base import PHASES, Phase
from sim.recording import Samples
from sim.verdict import REASONS, Thresholds, Verdict, judge

FINGERS = ("thumb", "index", "middle")
EACH = 5  # samples per phase
M = EACH * len(PHASES)


def at(phase: Phase) -> slice:
    start = PHASES.index(phase) * EACH
    return slice(start, start + EACH)


def held() -> Samples:
    """A trial in which everything goes well."""
    phase = tuple(p for p in PHASES for _ in range(EACH))
    contacts = np.zeros((M, 3), dtype=int)
    contacts[at("squeeze").start :] = 1
    closed = np.asarray(contacts.all(axis=1))
    lift = np.zeros(M)
    lift[at("lift")] = np.linspace(0, 100, EACH)
    lift[at("hold")] = 99.8
    slip = np.full(M, np.nan)
    slip[at("settle").start :] = 0.3
    return Samples(
        time=np.linspace(0.1, 0.1 * M, M),
        phase=phase,
        contacts=contacts,
        palm_contacts=np.zeros(M, dtype=int),
        normal_force=2.0 * contacts,
        friction_utilisation=np.where(contacts > 0, 0.5, np.nan),
        closed=closed,
        closed_unmerged=closed,
        epsilon=np.where(closed, 0.1, 0.0),
        slip_mm=slip,
        slip_deg=slip.copy(),
        moved_mm=lift.copy(),
        turned_deg=np.zeros(M),
        lift_mm=lift,
        collision_N=np.zeros(M),
        collision=("",) * M,
        saturated=((),) * M,
    )


def changed(samples: Samples, name: str, where: slice, value: float) -> Samples:
    array = getattr(samples, name).copy()
    array[where] = value
    return replace(samples, **{name: array})


def verdict(samples: Samples, needed: int = 3, **options: object) -> Verdict:
    return judge(
        samples,
        fingers=FINGERS,
        needed=needed,
        lift_mm=100.0,
        thresholds=Thresholds(),
        **options,  # type: ignore[arg-type]
    )


def dropped_at(phase: Phase) -> Samples:
    start = slice(at(phase).start, M)
    samples = changed(held(), "contacts", start, 0)
    return changed(changed(samples, "lift_mm", start, 0), "slip_mm", start, 100)


def test_a_held_object_is_a_success() -> None:
    result = verdict(held())
    assert result.success
    assert (result.reason, result.detail) == ("", "")


def test_slip_in_millimetres_or_degrees() -> None:
    for name in ("slip_mm", "slip_deg"):
        assert verdict(changed(held(), name, at("hold"), 4.9)).success
        result = verdict(changed(held(), name, at("hold"), 5.1))
        assert result.reason == "slipped"
        assert "5.1" in result.detail
        assert result.time == pytest.approx(0.1 * (at("hold").start + 1))


def test_slip_counts_in_the_lift_even_if_it_comes_back() -> None:
    assert verdict(changed(held(), "slip_mm", slice(22, 23), 6.0)).reason == "slipped"


def test_ending_low_is_slipping() -> None:
    result = verdict(changed(held(), "lift_mm", at("hold"), 90.0))
    assert result.reason == "slipped"
    assert "10.0 mm low" in result.detail


def test_dropped_names_the_moment_of_losing_touch() -> None:
    result = verdict(dropped_at("hold"))
    assert result.reason == "dropped"
    assert result.time == pytest.approx(0.1 * (at("hold").start + 1))
    assert "0 of 3 fingers touched" in result.detail


def test_an_object_left_behind_was_dropped_even_if_fingers_still_touch_it() -> None:
    samples = changed(held(), "lift_mm", slice(at("lift").start, M), 0.0)
    assert verdict(samples).reason == "dropped"


def test_dropped_wins_over_the_slip_before_it() -> None:
    samples = changed(dropped_at("hold"), "slip_mm", at("lift"), 10.0)
    assert verdict(samples).reason == "dropped"


def test_too_few_contacts_at_the_end_are_a_drop_only_if_more_are_needed() -> None:
    samples = held()
    contacts = samples.contacts.copy()
    contacts[at("hold"), 2] = 0
    samples = replace(samples, contacts=contacts)
    assert verdict(samples, needed=3).reason == "dropped"
    assert verdict(samples, needed=2).success


def test_no_contact_names_the_missing_finger() -> None:
    samples = held()
    contacts = samples.contacts.copy()
    contacts[:, 1] = 0
    result = verdict(replace(samples, contacts=contacts))
    assert result.reason == "no contact"
    assert "index did not touch" in result.detail


def test_tipped_over_before_the_lift() -> None:
    result = verdict(changed(held(), "turned_deg", at("close"), 40.0))
    assert result.reason == "tipped"
    assert "40 degrees" in result.detail
    assert verdict(changed(held(), "turned_deg", at("hold"), 40.0)).success
    assert verdict(changed(held(), "moved_mm", at("squeeze"), 30.0)).reason == "tipped"


def test_collision_names_the_pair_and_the_force() -> None:
    samples = changed(held(), "collision_N", at("close"), 3.0)
    pairs = list(samples.collision)
    pairs[at("close").start] = "thumb_pad - table"
    result = verdict(replace(samples, collision=tuple(pairs)))
    assert result.reason == "hand collided"
    assert result.detail == "thumb_pad - table with 3.0 N"
    assert verdict(changed(held(), "collision_N", at("close"), 0.5)).success


def test_of_several_faults_the_first_is_the_reason() -> None:
    late_collision = changed(dropped_at("lift"), "collision_N", at("hold"), 9.0)
    assert verdict(late_collision).reason == "dropped"
    early_collision = changed(dropped_at("hold"), "collision_N", at("close"), 9.0)
    assert verdict(early_collision).reason == "hand collided"


def test_failure_with_an_actuator_at_its_limit_is_put_down_to_it() -> None:
    limited = [("THJ2",) if p in ("squeeze", "settle", "lift") else () for p in held().phase]
    result = verdict(replace(dropped_at("hold"), saturated=tuple(limited)))
    assert result.reason == "torque limit reached"
    assert "THJ2" in result.detail
    assert "dropped" in result.detail
    assert verdict(replace(held(), saturated=tuple(limited))).success
    seldom: list[tuple[str, ...]] = [()] * M
    seldom[at("squeeze").start] = ("THJ2",)
    assert verdict(replace(dropped_at("hold"), saturated=tuple(seldom))).reason == "dropped"


def test_interruption_and_divergence_come_before_everything() -> None:
    assert verdict(dropped_at("hold"), interrupted=True).reason == "interrupted"
    result = verdict(held(), interrupted=True, diverged="positions are not finite")
    assert (result.reason, result.detail) == ("diverged", "positions are not finite")


def test_a_trial_given_up_before_the_lift_is_no_success() -> None:
    samples = held()
    half = at("lift").start
    cut = {f: getattr(samples, f)[:half] for f in samples.__dataclass_fields__}
    cut["contacts"] = cut["contacts"] * 0
    assert verdict(Samples(**cut)).reason == "no contact"
    cut["contacts"] = cut["contacts"] + 1
    assert verdict(Samples(**cut)).reason == "interrupted"


def test_reasons_are_those_of_the_documentation() -> None:
    assert set(REASONS) == {
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
    }


def test_thresholds_must_be_positive() -> None:
    with pytest.raises(TaskError, match="slip_mm is -1"):
        Thresholds(slip_mm=-1)


@pytest.mark.parametrize(
    ("off", "outcome"),
    [
        ({"thumb": 4.9, "index": 0.1, "middle": 0.2}, "held"),
        ({"thumb": 5.1, "index": 0.1, "middle": 48.0}, "held, another grasp"),
        ({"thumb": float("nan"), "index": 0.1, "middle": 0.2}, "held"),
    ],
)
def test_contacts_far_from_the_plan_are_another_grasp(off: dict[str, float], outcome: str) -> None:
    verdict = judge(
        held(),
        fingers=FINGERS,
        needed=3,
        lift_mm=100,
        thresholds=Thresholds(),
        contacts_off_mm=off,
    )
    assert verdict.success
    assert verdict.outcome == outcome
    assert verdict.as_planned == (outcome == "held")
    if not verdict.as_planned:  # the worst one is named
        assert verdict.other_grasp.startswith("middle touches 48 mm")


def test_an_actuator_that_saturates_after_the_fault_is_not_its_reason() -> None:
    """The object slips half-way under load; the thumb is stuck before, or only after that."""
    first = at("lift").start
    slipped = changed(held(), "slip_mm", slice(first, M), 6.0)
    for late, reason in ((True, "slipped"), (False, "torque limit reached")):
        stuck = tuple(("thumb",) if (i > first) == late else () for i in range(M))
        result = judge(
            replace(slipped, saturated=stuck),
            fingers=FINGERS,
            needed=3,
            lift_mm=100.0,
            thresholds=Thresholds(saturated_share=0.3),
        )
        assert result.reason == reason
