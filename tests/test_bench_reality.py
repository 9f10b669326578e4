"""``bench reality``: the same trials for every loop, counted; and the open loop of a turn."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from io import StringIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from manipulations import task_of
from rich.console import Console
from rich.table import Table
from typer.testing import CliRunner

from benchmarks.reality import LOOPS, Loop, reality_tables, register_loop, run_reality
from benchmarks.reality import loops as loops_module
from benchmarks.reality import tasks as tasks_module
from benchmarks.reality.loops import named_loop
from benchmarks.reality.reasons import class_of_turn
from benchmarks.reality.tasks import ComparedTask, register_task
from benchmarks.statistics import wilson
from planner.errors import FileFormatError, HandError, NotFoundError, PlannerError, TaskError
from planner.hand_loading import load_hand
from planner.search import plan_grasp
from planner.spatial import SE3
from planner.task import GRAVITY, GraspTask
from sim.cli import app
from sim.controllers import GraspController, Observation
from sim.estimation import EstimateLog
from sim.learning import Policy, PolicyFor
from sim.manipulation.timeline import SuccessCriteria, undisturbed
from sim.physics import PhysicsOptions
from sim.protocols.disturbance import Settings
from sim.protocols.outcome import Conditions
from sim.protocols.shake_pushes import PAUSE, PUSH_TIME, drawn_pushes, pushes_cases
from sim.reality import REALITIES, Reality
from sim.runner import Runner

RUN = CliRunner()
IDEAL, LAB, ROUGH = (REALITIES[name] for name in ("ideal", "lab", "rough"))


# --- intervals ---------------------------------------------------------------------------------


def test_intervals_are_those_of_the_textbook() -> None:
    # Brown, Cai and DasGupta 2001: 0 of 20 gives (0, 0.161); by the formula 15 of 20 is
    # (15.4 + 1.92 -+ ...) worked on paper below
    low, high = wilson(0, 20)
    assert low == pytest.approx(0.0, abs=1e-12)
    assert high == pytest.approx(0.161, abs=5e-4)
    z, p, n = 1.959964, 0.75, 20
    half = z / (1 + z * z / n) * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    middle = (p + z * z / (2 * n)) / (1 + z * z / n)
    assert wilson(15, 20) == pytest.approx((middle - half, middle + half), abs=1e-6)
    assert wilson(0, 0) == (0.0, 1.0)


# --- what loops are told -----------------------------------------------------------------------


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
    from sim.reality.drawn import Drawn
    from sim.reality.senses import RealSenses

    task = task_of("cylinder:0.03x0.08")
    reality = LOOPS["blind"].told(LAB)
    senses = RealSenses(reality, Drawn.of(reality, task.hand), task)
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


# --- trials ------------------------------------------------------------------------------------


@dataclass
class Fake:
    """A task whose trials cost nothing: it notes what it was asked."""

    asked: list[tuple[str, str, int, str, Reality]]
    planned: list[tuple[str, str, int, float]]

    def plan(self, hand: str, kind: str, seed: int, reality: Reality) -> list[Any]:
        self.planned.append((hand, kind, seed, reality.encoder_offset))
        if kind == "box" and seed == 1:
            raise TaskError("too large")
        return [hand, kind, seed]

    def execute(
        self, hand: str, kind: str, seed: int, plan: list[Any], loop: Loop, reality: Reality
    ) -> dict[str, Any]:
        assert plan == [hand, kind, seed]
        self.asked.append((hand, kind, seed, loop.name, reality))
        held = reality.ideal or loop.name != "open"
        return {"success": held, "reason": "" if held else "slipped", "slip_mm": 1.0 + seed}


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> Iterator[Fake]:
    from benchmarks.reality import run

    made = Fake([], [])
    monkeypatch.setattr(tasks_module, "_TASKS", dict(tasks_module._TASKS))
    monkeypatch.setattr(tasks_module, "TASKS", tasks_module._TASKS)
    register_task(
        ComparedTask(
            name="fake",
            about="nothing",
            objects=("sphere", "box"),
            plan=made.plan,
            execute=made.execute,
        )
    )
    run._planned.cache_clear()
    yield made
    run._planned.cache_clear()


Compare = Callable[..., dict[str, Any]]


@pytest.fixture
def compare(tmp_path: Path, fake: Fake) -> Compare:
    def run(**asked: Any) -> dict[str, Any]:
        values: dict[str, Any] = {
            "tasks": ["fake"],
            "realities": [IDEAL, LAB],
            "loops": ["truth", "readings", "open"],
            "seed": 0,
            "file": tmp_path / "rows.jsonl",
            "runner": Runner(console=Console(quiet=True), check=lambda: None),
        }
        n = asked.pop("n", 4)
        return run_reality(["allegro_hand", "shadow_hand"], n, **(values | asked))

    return run


def test_every_loop_meets_the_same_trials(fake: Fake, compare: Compare, tmp_path: Path) -> None:
    result = compare()
    by_loop: dict[str, set[Any]] = {}
    for hand, kind, seed, loop, reality in fake.asked:
        if not reality.ideal:
            assert reality.seed == seed
            by_loop.setdefault(loop, set()).add((hand, kind, seed))
    assert len(by_loop["open"]) == 6  # of 8, one object has no plan in either hand
    assert by_loop["truth"] == by_loop["readings"] == by_loop["open"]
    # each is planned once for calibrated joints and once for LAB's, for any number of loops
    assert len(fake.planned) == len(set(fake.planned)) == 16
    assert {offset for *_, offset in fake.planned} == {0.0, LAB.encoder_offset}
    cells = {(c["reality"], c["loop"], c["hand"], c["object"]): c for c in result["cells"]}
    assert len(cells) == 2 * 3 * 2 * 2
    assert all(c["n"] == 2 for c in cells.values())
    told = [json.loads(line) for line in (tmp_path / "rows.jsonl").read_text().splitlines()[1:]]
    assert {(r["reality"], r["loop"], r["estimator"]) for r in told} == {
        *((reality, loop, "none") for reality in ("lab", "ideal") for loop in ("truth", "open")),
        ("lab", "readings", "none"),  # of a world that is ideal it is told what truth is told
    }
    assert len({(r["hand"], r["kind"], r["draw"], r["reality"], r["loop"]) for r in told}) == 40
    box = cells["lab", "open", "allegro_hand", "box"]
    assert (box["planned"], box["success"]) == (1, 0)
    assert box["reasons"] == {"slipped": 1, "no plan": 1}


def test_what_is_told_the_same_is_run_once(fake: Fake, compare: Compare) -> None:
    result = compare()
    ideal = [loop for *_, loop, reality in fake.asked if reality.ideal]
    assert set(ideal) == {"truth", "open"}
    for one, other in (("truth", "readings"), ("readings", "truth")):
        found = [c for c in result["cells"] if (c["reality"], c["loop"]) == ("ideal", one)]
        same = [c for c in result["cells"] if (c["reality"], c["loop"]) == ("ideal", other)]
        assert [c | {"loop": other} for c in found] == same


def test_a_file_goes_on_with_more_of_anything(fake: Fake, compare: Compare, tmp_path: Path) -> None:
    first = compare(n=2, realities=[LAB], loops=["open"])
    made = len(fake.asked)
    assert sum(c["n"] for c in first["cells"]) == 4
    more = compare()
    again = len(fake.asked)
    assert again > made
    assert compare() == more | {k: compare()[k] for k in ("load_average", "date")}
    assert len(fake.asked) == again
    part = compare(n=2, realities=[LAB], loops=["open"])
    assert part["cells"] == first["cells"]
    other = compare(realities=[replace(LAB, pose_noise=0.5)])
    assert len(fake.asked) > again  # a preset that was changed is another one
    assert other["realities"][0]["pose_noise"] == 0.5
    lines = (tmp_path / "rows.jsonl").read_text().splitlines()
    rows = [json.loads(line) for line in lines[1:]]
    assert len({row["index"] for row in rows}) == len(rows)


def test_what_cannot_be_asked_for_is_refused(compare: Compare) -> None:
    with pytest.raises(NotFoundError, match="contact, estimates, open, readings, touch, truth"):
        compare(loops=["reading"])
    with pytest.raises(NotFoundError, match="hold, pushes, turn"):
        compare(tasks=["holds"])
    with pytest.raises(TaskError, match="2 realities are called 'lab'; give each a name"):
        compare(realities=[LAB, replace(LAB, object_mass=0.0)])
    with pytest.raises(PlannerError, match="allegro_hand"):
        run_reality(
            ["allegro"],
            1,
            tasks=["hold"],
            realities=[IDEAL],
            loops=["open"],
            seed=0,
            file=Path("never.jsonl"),
            runner=Runner(console=Console(quiet=True), check=lambda: None),
        )


def test_another_column_is_one_registration(
    fake: Fake, compare: Compare, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(loops_module, "_LOOPS", dict(loops_module._LOOPS))
    monkeypatch.setattr(loops_module, "LOOPS", loops_module._LOOPS)
    mine = replace(LOOPS["open"], name="mine", driver="mine", tasks=("fake",))
    register_loop(mine)
    register_loop(mine)
    with pytest.raises(TaskError, match="already"):
        register_loop(replace(mine, about="another"))
    register_loop(replace(mine, name="absent", why_not=lambda: "no model"))
    with pytest.raises(TaskError, match="'absent' cannot run: no model"):
        named_loop("absent")
    result = compare(loops=["mine"])
    assert {c["loop"] for c in result["cells"]} == {"mine"}
    with pytest.raises(TaskError, match="mine cannot do hold"):
        compare(loops=["mine"], tasks=["hold"])


def test_a_policy_of_a_file_is_a_column(
    fake: Fake, compare: Compare, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hand = load_hand("allegro_hand")
    n = len(hand.actuation.names)
    policy = Policy(
        about=PolicyFor.of(hand, objects="cylinder", angle_deg=90.0, reality="lab"),
        mean=np.zeros(3, dtype=np.float32),
        scale=np.ones(3, dtype=np.float32),
        weights=(np.zeros((3, n), dtype=np.float32),),
        biases=(np.zeros(n, dtype=np.float32),),
    )
    path = tmp_path / "p.npz"
    policy.save(path)
    loop = named_loop(f"policy:{path}")
    assert loop.does("turn")
    assert not loop.does("hold")
    assert "cylinder" in loop.about
    policy.save(tmp_path / "q.npz")
    changed = replace(policy, biases=(np.ones(n, dtype=np.float32),))
    changed.save(tmp_path / "r.npz")
    drivers = [named_loop(f"policy:{tmp_path / name}").driver for name in ("q.npz", "r.npz")]
    assert drivers[0] != drivers[1]  # other weights are another run
    with pytest.raises(FileFormatError):
        named_loop("policy:nowhere.npz")


def test_what_refuses_a_hand_is_counted(
    fake: Fake, compare: Compare, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*args: Any) -> dict[str, Any]:
        raise HandError("of another hand")

    fake_task = tasks_module._TASKS["fake"]
    monkeypatch.setitem(tasks_module._TASKS, "fake", replace(fake_task, execute=refuse))
    cells = compare(loops=["open"], realities=[LAB], n=1)["cells"]
    assert [cell["reasons"] for cell in cells] == [{"refused": 1}, {"refused": 1}]


def test_tables_count_and_say_why(compare: Compare) -> None:
    tables = list(reality_tables(compare()))
    texts, shown = tables[:3], [t for t in tables if isinstance(t, Table)]
    assert str(texts[0]).startswith("truth: ")
    rates, reasons, numbers = shown
    assert [str(c.header) for c in rates.columns] == [
        *("reality", "hand", "truth", "readings", "open")
    ]
    rows = list(zip(*(list(c.cells) for c in rates.columns), strict=True))
    assert rows[-1] == ("lab", "all", "6/8 (41-93)", "6/8 (41-93)", "0/8 (0-32)")
    stream = StringIO()
    Console(file=stream, width=200).print(reasons, numbers)
    assert "slipped 6, no plan 2" in stream.getvalue()


def test_objects_that_are_named_take_turns_with_the_draws_that_they_have_among_all(
    fake: Fake, compare: Compare, tmp_path: Path
) -> None:
    compare(n=8, loops=["open"], realities=[LAB])
    before = list(fake.asked)
    result = compare(n=4, loops=["open"], realities=[LAB], objects=["sphere"])
    assert [(c["object"], c["n"]) for c in result["cells"]] == [("sphere", 4)] * 2
    assert fake.asked == before, "they are rows of the file already"
    with pytest.raises(NotFoundError, match="object of the task fake"):
        compare(objects=["mug"])


def test_the_command_measures(tmp_path: Path, fake: Fake) -> None:
    out, samples = tmp_path / "out.json", tmp_path / "rows.jsonl"
    asked = ["--tasks", "fake", "--realities", "lab", "--loops", "open", "-n", "2"]
    done = RUN.invoke(
        app,
        ["bench", "reality", "allegro_hand", *asked, "--samples", str(samples), "--out", str(out)],
    )
    assert done.exit_code == 0, done.output
    assert json.loads(out.read_text())["format"] == "opposable-bench-reality"
    assert "0/2" in done.output
    wrong = RUN.invoke(app, ["bench", "reality", "--realities", "labs"])
    assert wrong.exit_code == 3
    assert "lab" in wrong.output


BENCHES = {
    "grasps": "benchmarks.grasps.run_grasps",
    "walls": "benchmarks.walls.run_walls",
    "metrics": "benchmarks.metrics.run_metrics",
    "trials": "benchmarks.trial_cost.run_trial_cost",
    "control": "benchmarks.control.run_control",
    "physics": "benchmarks.physics.run_physics",
    "manipulate": "benchmarks.manipulate.run_manipulate",
}
"""Commands that run trials, and what they call."""


class Stopped(Exception):
    """Ends a command where it would measure."""


@pytest.mark.parametrize("command", BENCHES)
def test_every_bench_that_runs_trials_takes_a_reality(
    command: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    given: dict[str, Any] = {}

    def run(*args: Any, **asked: Any) -> None:
        given.update(asked)
        raise Stopped

    monkeypatch.setattr(BENCHES[command], run)
    monkeypatch.chdir(tmp_path)
    hands = [] if command == "grasps" else ["allegro_hand"]
    done = RUN.invoke(app, ["bench", command, *hands, "--reality", "rough"])
    assert isinstance(done.exception, Stopped), done.output
    assert given["reality"] == ROUGH
    Path("mine.toml").write_text('preset = "rough"\nobject_size = 0.0\n', encoding="utf-8")
    done = RUN.invoke(app, ["bench", command, *hands, "--reality", "mine.toml"])
    assert isinstance(done.exception, Stopped), done.output
    assert given["reality"] == replace(ROUGH, name="mine.toml", object_size=0.0)
    assert RUN.invoke(app, ["bench", command, *hands, "--reality", "ruff"]).exit_code == 3


def test_jobs_hand_their_reality_on_and_files_say_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each trial of a bench is told the reality, drawn anew."""
    from benchmarks import trials, walls
    from benchmarks.control.jobs import control_jobs
    from benchmarks.metrics import samples_for
    from benchmarks.objects import BenchObject
    from benchmarks.physics import physics_jobs
    from benchmarks.run import stated

    ball = [BenchObject(label="ball", spec="sphere")]
    jobs = control_jobs(["allegro_hand"], ball, {"drift": 3}, 0, ROUGH)
    assert [job.reality for job in jobs] == [ROUGH.seeded(k) for k in range(3)]
    assert {s.reality for s in samples_for(["allegro_hand"], ball, 3, 0, ROUGH)} == {ROUGH}
    assert {j.reality for j in physics_jobs(["allegro_hand"], ball, ["holds"], ROUGH)} == {ROUGH}
    assert stated(ROUGH) == {"reality": ROUGH.to_dict(), "estimator": "all"}
    assert stated(ROUGH, "none") == {"reality": ROUGH.to_dict()}
    assert stated(IDEAL) == {}
    told: list[Reality] = []

    def trial(*args: Any, **asked: Any) -> None:
        told.append(asked["reality"])
        raise Stopped

    monkeypatch.setattr(trials, "Trial", trial)
    sample = samples_for(["allegro_hand"], ball, 3, 0, ROUGH)[2]
    with pytest.raises(Stopped):
        trials.try_sample(sample, lambda: None)
    monkeypatch.setattr(walls, "simulate", trial)
    job = walls._WallJob(
        index=0,
        hand="allegro_hand",
        spec="sphere",
        label="ball",
        k=5,
        seed=0,
        execute=True,
        reality=ROUGH,
    )
    with pytest.raises(Stopped):
        walls._made(job, lambda: None)
    assert told == [ROUGH.seeded(2), ROUGH.seeded(5)]


# --- pushes ------------------------------------------------------------------------------------


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


# --- reasons -----------------------------------------------------------------------------------


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
    found = tasks_module._estimated(log)
    assert found["pose_mm"] == pytest.approx(5.0)
    assert found["pose_deg"] == pytest.approx(2.0)
    assert found["within_two_sigma"] == pytest.approx(10 / 12)
    assert tasks_module._estimated(EstimateLog()) == {}
