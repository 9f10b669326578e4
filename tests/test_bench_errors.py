"""The benchmark ``errors``: the same trials for every loop, counted; pushes of a minute."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from benching import run_bench
from conftest import needs
from manipulations import task_of

from benchmarks import errors
from benchmarks.errors import ComparedTask, class_of_turn
from benchmarks.loops import LOOPS, named_loop, register_loop
from planner.errors import HandError, NotFoundError, TaskError
from planner.search.grasp import plan_grasp
from planner.spatial import SE3
from planner.task import GRAVITY, GraspTask
from sim.controllers import GraspController, Observation
from sim.manipulation.timeline import SuccessCriteria, undisturbed
from sim.protocols.disturbance import Settings
from sim.protocols.outcome import Conditions
from sim.protocols.shake_pushes import PAUSE, PUSH_TIME, drawn_pushes, pushes_cases
from sim.scene.physics import PhysicsOptions
from sim.sensing.errors import ERROR_MODELS, ErrorModel
from sim.sensing.estimation import EstimateLog

IDEAL, LAB, ROUGH = (ERROR_MODELS[name] for name in ("ideal", "lab", "rough"))


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    """A task without physics: what was executed. The open loop loses every object."""
    made: list[tuple[Any, ...]] = []

    def plan(hand: str, kind: str, seed: int, told: ErrorModel) -> list[str]:
        if (kind, seed) == ("box", 1):
            raise TaskError("no way")
        return ["a plan"]

    def execute(hand: str, kind: str, seed: int, plan: Any, loop: Any, told: ErrorModel) -> Any:
        made.append((hand, kind, seed, loop.name, told))
        if hand == "shadow_hand" and loop.name == "mine":
            raise HandError("of another hand")
        lost = loop.name == "open"
        return {"success": not lost, "reason": "slipped" if lost else ""}

    task = ComparedTask(about="a", objects=("sphere", "box"), plan=plan, execute=execute)
    monkeypatch.setattr(errors, "TASKS", {"fake": task})
    errors._planned.cache_clear()
    return made


def test_every_loop_meets_the_same_trials(fake: list[tuple[Any, ...]]) -> None:
    asked: dict[str, Any] = {
        "tasks": "fake",
        "error_models": "ideal,lab",
        "loops": "truth,open",
        "n": 4,
    }
    result = run_bench("errors", **asked)
    assert len(result["rows"]) == 4 * 2 * 2 * 2
    for loop in ("truth", "open"):
        mine = [(h, k, s, told.seed) for h, k, s, name, told in fake if name == loop]
        other = [(h, k, s, told.seed) for h, k, s, name, told in fake if name != loop]
        assert mine == other and all(s == drawn for *_, s, drawn in mine)
    assert {told.ideal for *_, name, told in fake if name == "open"} == {True, False}
    read = {told for *_, name, told in fake if name == "truth" and not told.ideal}
    assert all(told.encoder_noise == 0.0 < told.object_mass for told in read)
    texts = [one for one in result["summary"] if isinstance(one, str)]
    assert texts[0].startswith("truth: ")
    rates, reasons, _ = (one for one in result["summary"] if not isinstance(one, str))
    assert rates["columns"] == ["error model", "hand", "truth", "open"]
    assert ["lab", "all", "6/8 (41-93)", "0/8 (0-32)"] in rates["rows"]
    assert ["fake", "lab", "open", "slipped 6, no plan 2"] in reasons["rows"]


@needs("pandas")
def test_what_cannot_be_asked_for_is_refused(
    fake: list[tuple[Any, ...]], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: dict[str, Any] = {"tasks": "fake", "error_models": "lab", "loops": "open", "n": 1}
    with pytest.raises(NotFoundError, match="contact, estimates, open, readings, touch, truth"):
        run_bench("errors", **{**asked, "loops": "reading"})
    with pytest.raises(NotFoundError, match="object of the task"):
        run_bench("errors", **asked, objects="mug")
    monkeypatch.setattr(LOOPS, "_known", dict(LOOPS.items()))
    mine = register_loop(replace(LOOPS["open"], name="mine", driver="mine", tasks=("fake",)))
    with pytest.raises(TaskError, match="already"):
        register_loop(replace(mine, about="another"))
    register_loop(replace(mine, name="absent", why_not=lambda: "no model"))
    with pytest.raises(TaskError, match="'absent' cannot run: no model"):
        named_loop("absent")
    register_loop(replace(mine, name="turner", tasks=("turn",)))
    with pytest.raises(TaskError, match="turner cannot do fake"):
        run_bench("errors", **{**asked, "loops": "turner"})
    rows = run_bench("errors", **{**asked, "loops": "mine"})["rows"]
    assert [row["reason"] for row in rows] == ["refused", ""]


def test_truth_keeps_the_world_and_the_drives_and_takes_all_of_the_senses() -> None:
    told = LOOPS["truth"].told(ROUGH)
    left = {name for name, value in told.numbers.items() if value and name != "drift_time"}
    assert left == {
        *("dry_friction", "torque_constant", "command_delay", "command_rate"),
        *("object_size", "object_mass", "object_center", "object_friction"),
    }
    assert all(told.numbers[name] == ROUGH.numbers[name] for name in left)
    assert told.seed == ROUGH.seed


def test_blind_sees_the_object_once() -> None:
    from sim.sensing.errors.model import Drawn
    from sim.sensing.errors.senses import RealSenses

    task = task_of("cylinder:0.03x0.08")
    error_model = LOOPS["blind"].told(LAB)
    senses = RealSenses(error_model, Drawn.of(error_model, task.hand), task)
    known = [
        senses.read(_seen(0.002 * k, 0.01 * k, task.hand.nq)).T_world_object for k in range(600)
    ]
    assert all(pose.isApprox(known[0]) for pose in known)
    assert abs(known[0].translation[0]) < 0.006  # the first one, with its noise


def _seen(time: float, x: float, nq: int) -> Observation:
    return Observation(
        time=time,
        phase="hold",
        progress=0.0,
        q=np.zeros(nq),
        v=np.zeros(nq),
        T_world_base=SE3.Identity(),
        T_world_object=SE3(np.eye(3), np.array([x, 0.0, 0.0])),
        normal_forces=np.zeros(4),
        read_twist=lambda: np.zeros(6),
        read_contacts=lambda: None,  # type: ignore[arg-type, return-value]
    )


def test_pushes_keep_their_time_and_their_force_and_come_from_everywhere() -> None:
    pushes = drawn_pushes(60.0, 2.0, np.random.default_rng(1))
    again = drawn_pushes(60.0, 2.0, np.random.default_rng(1))
    assert pushes == again
    begins = np.array([p.begin for p in pushes])
    forces = np.array([p.force for p in pushes])
    gaps = np.diff(begins) - PUSH_TIME
    assert PAUSE[0] <= gaps.min() < gaps.max() <= PAUSE[1]
    assert 60.0 - 2 * PAUSE[1] - PUSH_TIME < begins[-1] + PUSH_TIME < 60.0
    sizes = np.linalg.norm(forces, axis=1)
    assert 0.6 <= sizes.min() < sizes.max() <= 2.0
    assert 55 <= len(pushes) <= 80
    octants = {tuple(row) for row in (forces > 0).tolist()}
    assert len(octants) == 8


@dataclass(frozen=True)
class Ended:
    """What ``class_of_turn`` reads of a report."""

    results: tuple[Any, ...] = ()
    dropped: bool = False
    success: bool = False
    success_with_closure: bool = False
    faults: str = ""
    held: int = 0

    @property
    def log(self) -> Any:
        return SimpleNamespace(during=lambda *phases: range(self.held))


def failed(phase: str, reason: str) -> tuple[Any, ...]:
    return (SimpleNamespace(phase=phase, reason=reason, passed=False),)


REASONS = [
    (Ended(success=True, success_with_closure=True), ""),
    (Ended(dropped=True, results=failed("turn", "turned 3 of 90 degrees: x")), "dropped"),
    (Ended(results=failed("squeeze", "2 fingers touch, 3 are needed; ring do not")), "no contact"),
    (Ended(results=failed("turn", "turned 84.0 of 90.0 degrees: it did not follow")), "stalled"),
    (Ended(results=failed("hold", "turned 84.0 of 90.0 degrees: it"), held=3), "turned back"),
    (Ended(results=failed("turn", "tilted by 16.0 degrees off the axis")), "tilted"),
    (Ended(results=failed("lift", "the object moved 7.1 mm in the hand and rose 1.0 mm less"))
     , "slipped in the lift"),
    (Ended(results=failed("stand", "stopped: seen enough")), "stand"),
    (Ended(results=(), held=3), "short of the angle"),
    (Ended(results=failed("retreat", "the hand still touches it"), held=3), "short of the angle"),
    (Ended(success=True, faults="only 2 fingers touched at times"), "fingers lost at times"),
    (Ended(success=True, faults="only 2 fingers touched at times; the hand collided, x"),
     "hand collided"),
]  # fmt: skip


@pytest.mark.parametrize(("ended", "expected"), REASONS)
def test_reasons_have_classes(ended: Any, expected: str) -> None:
    assert class_of_turn(ended) == expected


def test_classes_are_of_the_sentences_of_the_phases() -> None:
    criteria = SuccessCriteria()
    there = SE3(np.eye(3), np.array([0.05, 0.0, 0.0]))
    moved, _ = undisturbed(SE3.Identity(), there, criteria)
    ended: Any = Ended(results=failed("close", moved))
    assert class_of_turn(ended) == "knocked over"


@pytest.mark.parametrize(("load", "held"), [(0.5, True), (60.0, False)])
def test_pushes_are_felt_and_a_strong_one_loses_the_object(load: float, held: bool) -> None:
    plan = plan_grasp(GraspTask.create("allegro_hand", "sphere"), seed=0)
    settings = Settings(pushes=1, pushes_s=2.0, push_load=load)
    (case,) = pushes_cases(settings, seed=1)
    conditions = Conditions(physics=PhysicsOptions(), controller=GraspController)
    outcome = case.run(plan, conditions)
    assert outcome.held == held
    made = drawn_pushes(2.0, load * -GRAVITY[2] * 0.1, np.random.default_rng([1, 0]))
    assert outcome.conditions["pushes"] == len(made) >= 1
    strongest = max(np.linalg.norm(push.force) for push in made)
    if held:
        assert outcome.conditions["pushes_survived"] == len(made)
        assert outcome.load.max() == pytest.approx(strongest)
        assert np.nanmax(outcome.samples.slip_mm) > 0.03  # at rest it is 0.01
    else:
        assert outcome.conditions["pushes_survived"] < len(made)
        assert outcome.reason in ("dropped", "slipped", "torque limit reached")


def test_how_far_an_estimate_was_off_counts_the_turn_alone() -> None:
    """On paper: 3 mm and 4 mm along two axes are 5 mm; of 12 errors 2 lie beyond two sigma."""
    log = EstimateLog()
    at_end = np.array([0.003, -0.004, 0.0, 0.0, 0.0, np.deg2rad(2.0)])
    sigma = np.array([0.001, 0.001, 0.001, 0.1, 0.1, 0.1])
    log._rows = [
        (0.0, "lift", np.ones(6), sigma, True),
        (0.1, "turn", np.zeros(6), sigma, True),
        (0.2, "turn", at_end, sigma, True),
        (0.3, "carry", np.ones(6), sigma, True),
    ]
    found = errors._estimated(log)
    assert found["pose_mm"] == pytest.approx(5.0)
    assert found["pose_deg"] == pytest.approx(2.0)
    assert found["within_two_sigma"] == pytest.approx(10 / 12)
    assert errors._estimated(EstimateLog()) == {}
