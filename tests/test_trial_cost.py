"""What a trial costs beside MuJoCo's steps, and what is left until it is asked for."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from conftest import PlanOf, calls_in

from benchmarks.trials import Replay, time_trial
from planner.contacts import ContactSet
from planner.plan import GraspPlan
from planner.quality import closure_and_epsilon
from sim import recorder as recording
from sim.contacts import hand_contacts, merge_per_finger
from sim.simulation import Simulation
from sim.trial import Timeline, Trial

MOST_CALLS = 220
"""Functions of Python and C per step of MuJoCo; 130 were counted."""


@pytest.fixture(scope="module")
def plan(plan_of: PlanOf) -> GraspPlan:
    return plan_of("allegro_hand", "box", seed=1)


def test_the_steps_alone_repeat_the_trial(plan: GraspPlan) -> None:
    row = time_trial(plan, "feedforward", repeats=1)
    assert row["same_state"]
    assert row["steps"] > 2000
    assert row["ratio"] == pytest.approx(row["trial_s"] / row["steps_s"])
    assert row["report_s"] > 0


def test_a_step_calls_few_functions(plan: GraspPlan) -> None:
    """What a trial costs beside MuJoCo's steps, counted; the benchmark ``trials`` times it."""
    trial = Trial(plan, timeline=Timeline.quick(hold=0.1))
    steps: list[float] = []
    calls = calls_in(lambda: trial.run(on_step=lambda simulation: steps.append(simulation.time)))
    assert calls < MOST_CALLS * len(steps), calls / len(steps)


def test_a_replay_of_other_commands_is_noticed(plan: GraspPlan) -> None:
    trial = Trial(plan, timeline=Timeline.quick(hold=0.1))
    replay = Replay(trial.simulation)
    trial.run(on_step=replay)
    replay.cpu_s()
    assert replay.same
    replay.inputs[100][0][:] += 0.01
    replay.cpu_s()
    assert not replay.same


def test_closure_is_computed_when_asked_for_and_is_that_of_the_contacts_then(
    plan: GraspPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[ContactSet] = []

    def look(simulation: Simulation) -> None:
        if simulation.due(0.05):
            seen.append(merge_per_finger(hand_contacts(simulation.scene, simulation.data)))

    calls: list[int] = []

    def counted(contacts: ContactSet, *, length: float) -> tuple[bool, float]:
        calls.append(len(contacts))
        return closure_and_epsilon(contacts, length=length)

    monkeypatch.setattr(recording, "closure_and_epsilon", counted)
    trial = Trial(plan, timeline=Timeline.quick(hold=0.2), record_every=0.05)
    report = trial.run(on_step=look)
    assert report.success
    assert not calls
    sent = pickle.loads(pickle.dumps(report.samples))
    assert len(calls) == len(seen) == len(report.samples) > 20
    length = plan.task.object.shape.bounding_radius
    said = [closure_and_epsilon(contacts, length=length) for contacts in seen]
    for samples in (report.samples, sent):
        np.testing.assert_array_equal(samples.closed, [closed for closed, _ in said])
        np.testing.assert_allclose(samples.epsilon, [e for _, e in said], atol=1e-12)
    assert len(calls) == len(seen)
    assert report.samples.closed.any()
    assert not report.samples.closed.all()
    with pytest.raises(AttributeError, match="no attribute 'torque'"):
        getattr(report.samples, "torque")  # noqa: B009  mypy knows that there is none
