"""``bench control``: which grasps are asked what, slips that are known, what the tables count."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from io import StringIO
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import PlanOf
from rich.console import Console

from benchmarks import planned
from benchmarks.control import (
    control_tables,
    grasps_of,
    jobs,
    parts,
    promise,
    push,
    run_control,
    slip_trial,
)
from benchmarks.control.jobs import PARTS, ROWS_PER_GRASP, Part, control_jobs
from benchmarks.control.parts import rate_row
from benchmarks.control.slip_trial import Watched, slip_row
from benchmarks.objects import BenchObject
from planner.certify import smallest_breaking
from planner.contacts import ContactSet
from planner.errors import FileFormatError, NotFoundError
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray
from planner.verification.grasp import with_grip
from sim.contacts import hand_contacts
from sim.contacts.reading import read_pads
from sim.controllers import CONTROLLERS, GraspController, Observation, PadReading
from sim.controllers.monitors import SLIP_SPEED
from sim.protocols.dexgraspbench import dexgraspbench_cases
from sim.protocols.disturbance import DROPPED, DisturbanceTrial
from sim.protocols.forces import PushCase
from sim.protocols.outcome import Outcome
from sim.protocols.variations import RobustCase
from sim.reality import Reality
from sim.runner import Runner
from sim.verdict import Fault

SPHERE = BenchObject(label="sphere", spec="sphere")
BOX = BenchObject(label="box", spec="box")
HANDS = ["allegro_hand", "shadow_hand"]
DT = 0.002


@pytest.fixture(scope="module")
def plan(plan_of: PlanOf) -> GraspPlan:
    return plan_of("allegro_hand", "sphere")


# which grasps are asked what


def test_every_part_sees_the_same_grasps() -> None:
    made = control_jobs(HANDS, [SPHERE, BOX], {"fc": 9, "drift": 4}, 3)
    assert len({job.index for job in made}) == len(made) == 13
    by_grasp: dict[int, set[tuple[str, str, int]]] = {}
    for job in made:
        by_grasp.setdefault(job.grasp, set()).add((job.hand, job.spec, job.plan_seed))
    assert all(len(grasps) == 1 for grasps in by_grasp.values())
    # four cells: grasps 0 to 3 have the first seed, 8 the third
    assert [next(iter(by_grasp[k]))[2] for k in (0, 3, 4, 8)] == [3, 3, 4, 5]
    assert len(set.union(*(by_grasp[k] for k in range(4)))) == 4
    # a cell's grasps come together
    cells = [(job.hand, job.spec) for job in made]
    assert sum(a != b for a, b in pairwise(cells)) == 3


def test_numbers_of_rows_do_not_depend_on_what_else_is_asked() -> None:
    few = control_jobs(HANDS, [SPHERE], {"drift": 2}, 0)
    many = control_jobs(HANDS, [SPHERE], {"fc": 7, "drift": 5}, 0)
    assert set(few) <= set(many)
    assert len({part.number for part in PARTS.values()}) == len(PARTS) <= ROWS_PER_GRASP
    everything = control_jobs(HANDS, [SPHERE], dict.fromkeys(PARTS, 40), 0)
    assert len({job.index for job in everything}) == 40 * len(PARTS)


def test_parts_have_the_numbers_that_their_figures_ask_for() -> None:
    assert grasps_of(["fc", "push"], None) == {"fc": 200, "push": 50}
    assert grasps_of(["fc", "push"], 3) == {"fc": 3, "push": 3}
    with pytest.raises(NotFoundError, match="no part is called 'pull'"):
        grasps_of(["pull"], None)


def run(file: Path, asked: Mapping[str, int], **options: Any) -> dict[str, Any]:
    runner = Runner(console=Console(quiet=True), check=lambda: None)
    given: dict[str, Any] = {"seed": 0, "runner": runner}
    return run_control(["allegro_hand"], [SPHERE], asked, file=file, **(given | options))


def test_a_file_goes_on_with_more_grasps_and_other_parts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[str] = []

    def fake(name: str) -> Callable[[GraspPlan, np.random.Generator, Reality], dict[str, Any]]:
        def measure(plan: GraspPlan, rng: np.random.Generator, reality: Reality) -> dict[str, Any]:
            seen.append(name)
            return {"drawn": float(rng.random()), "planned": len(plan.task.fingers)}

        return measure

    faked = {
        name: Part(number=part.number, measure=fake(name), grasps=part.grasps)
        for name, part in PARTS.items()
    }
    monkeypatch.setattr(jobs, "PARTS", faked)
    file = tmp_path / "x.jsonl"
    first = run(file, {"fc": 2})
    second = run(file, {"fc": 3, "drift": 1})
    assert seen == ["fc", "fc", "drift", "fc"]
    assert [r["part"] for r in second["rows"]] == ["fc", "drift", "fc", "fc"]
    assert [r for r in second["rows"] if r in first["rows"]] == first["rows"]
    assert run(file, {"fc": 2})["rows"] == first["rows"]
    assert len({r["drawn"] for r in second["rows"]}) == 4  # each its own
    with pytest.raises(FileFormatError, match=r"other arguments \(different: seed\)"):
        run(file, {"fc": 2}, seed=1)


def test_a_grasp_that_is_not_found_is_a_row_with_its_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(planned, "_plan", lambda *_: "too wide")
    result = run(tmp_path / "x.jsonl", {"fc": 2})
    assert [r["error"] for r in result["rows"]] == ["too wide"] * 2
    (table,) = control_tables(result)
    assert table.caption == "2 of 2 grasps were not found"


# parts


def outcome(case: Any, **values: Any) -> Outcome:
    samples: Any = ()
    whole: dict[str, Any] = {"held": True, "fault": None, **values}
    return Outcome(index=0, name=case.name, fingers=(), samples=samples, load=np.zeros(0), **whole)


def test_both_loops_meet_the_same_pushes(plan: GraspPlan, monkeypatch: pytest.MonkeyPatch) -> None:
    met: list[tuple[Any, FloatArray, float]] = []

    def borne(self: PushCase, plan: GraspPlan, conditions: Any) -> Outcome:
        grip = plan.task.grip_force
        met.append((conditions.controller, self.direction, grip))
        return outcome(
            self,
            largest_load_held=grip,
            failure_load=np.inf,
            bound=4.0,
            bound_near=np.inf,
            unit="N",
        )

    monkeypatch.setattr(PushCase, "run", borne)
    row = push.push_row(plan, np.random.default_rng(0), Reality())
    grips = push.tried_grips(plan)
    assert grips[0] == plan.task.grip_force
    assert len(grips) == push.GRIPS + 1
    once = [*[CONTROLLERS["feedforward"]] * len(grips), CONTROLLERS["impedance"]]
    assert [made for made, *_ in met] == once * 2
    assert [grip for *_, grip in met] == [*grips, grips[0]] * 2
    for k, zero in ((0, slice(3, 6)), (len(once), slice(0, 3))):
        for other in met[k : k + len(once)]:
            np.testing.assert_array_equal(met[k][1], other[1])
        assert np.linalg.norm(met[k][1]) == pytest.approx(1.0)
        assert not met[k][1][zero].any()
    assert json.loads(json.dumps(row, allow_nan=False)) == row
    first = row["pushes"][0]
    assert first["feedforward"] == {"borne": grips[0], "broke": None, "reason": ""}
    assert first["best"] == {"borne": grips[-1], "broke": None, "reason": "", "grip_N": grips[-1]}
    assert (first["lost_mm"], first["lost_deg"], first["bound_near"]) == (
        DROPPED.mm,
        DROPPED.deg,
        None,
    )


def test_the_largest_grip_is_the_last_that_the_hand_has(plan: GraspPlan) -> None:
    most = push.largest_grip(plan)
    assert with_grip(plan, most).forces.found
    assert not with_grip(plan, (1.0 + 2.0 * push.GRIP_TOL) * most).forces.found
    pressed = with_grip(plan, 0.9 * most)
    assert pressed.contacts.forces[:, 0].min() == pytest.approx(0.9 * most, rel=1e-5)
    weak = with_grip(plan, most)
    assert push.tried_grips(weak) == [most]  # nothing above it is left to try


def test_a_promise_is_tested_along_its_weakest_direction(
    plan: GraspPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A hold that loses the object at 0.855 of the promised force, and never under torque."""
    pushed: list[FloatArray] = []
    force = smallest_breaking(plan.forces.problem, "force", length=0.035)
    limit = 0.855 * force.bounds.lower

    def hold_for(self: DisturbanceTrial, duration: float) -> Fault | None:
        beyond = np.linalg.norm(pushed[-1][:3]) > limit
        return Fault(reason="slipped", detail="", time=0.0) if beyond else None

    monkeypatch.setattr(DisturbanceTrial, "close_and_squeeze", lambda self: None)
    monkeypatch.setattr(DisturbanceTrial, "push", lambda self, wrench: pushed.append(wrench))
    monkeypatch.setattr(DisturbanceTrial, "hold_for", hold_for)
    row = promise.promise_row(plan, np.random.default_rng(0), Reality())
    assert json.loads(json.dumps(row, allow_nan=False)) == row
    told = {(load["kind"], load["speed"]): load["broke_at"] for load in row["loads"]}
    assert told["force", "slow"] == pytest.approx(0.86)
    assert told["force", "sudden"] == pytest.approx(0.9)
    assert told["torque", "slow"] is told["torque", "sudden"] is None
    assert row["loads"][0]["promised"] == pytest.approx(force.bounds.lower)
    along = pushed[0] / np.linalg.norm(pushed[0])
    np.testing.assert_allclose(along, force.wrench / np.linalg.norm(force.wrench), atol=1e-9)


def test_promises_are_counted() -> None:
    def load(broke_at: float | None) -> dict[str, Any]:
        limits = {"lost_mm": 10.0, "lost_deg": 15.0}
        return {"kind": "force", "speed": "slow", "broke_at": broke_at, **limits}

    rows = [row_of("promise", k, loads=[load(s)]) for k, s in enumerate([0.9, 0.97, 1.05, None])]
    last = cells({"rows": rows})[-1]
    # not lost counts as the most that was tried
    assert last == ["all", "", "slow", "4", "1.01", "0.92", "0.90", "3/4", "2/4"]
    assert "10 mm or 15 degrees in the palm" in str(control_tables({"rows": rows})[0].title)


def test_the_grid_is_seen_by_a_latin_square(
    plan: GraspPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(RobustCase, "run", lambda self, plan, conditions: outcome(self))
    squares = set()
    for seed in range(10):
        trials = parts.robust_row(plan, np.random.default_rng(seed), Reality())["trials"]
        cells = [
            (t["mass"], t["friction"], t["pose"]) for t in trials if t["loop"] == "feedforward"
        ]
        assert cells == [(t["mass"], t["friction"], t["pose"]) for t in trials[1::2]]
        for pair in ((0, 1), (0, 2), (1, 2)):
            assert len({tuple(c[i] for i in pair) for c in cells}) == len(cells) == 9
        squares.add(frozenset(cells))
    assert len(frozenset.union(*squares)) == 27  # together they are the whole grid


@pytest.mark.slow
def test_a_grasp_holds_in_fc_and_is_timed(plan: GraspPlan, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parts, "dexgraspbench_cases", lambda: dexgraspbench_cases()[:1])
    row = parts.fc_row(plan, np.random.default_rng(0), Reality())
    assert (row["held"], row["of"], row["reasons"]) == (1, 1, [])
    assert 0 <= row["start_penetration_mm"] <= 1.0
    assert 0 <= row["grasp_penetration_mm"] <= 1.0
    monkeypatch.setattr(parts, "STRETCHES", 3)
    timed = {
        loop["loop"]: loop for loop in rate_row(plan, np.random.default_rng(0), Reality())["loops"]
    }
    assert timed["feedforward"]["step_ms"] == 2.0
    for loop in timed.values():
        assert 0 < np.median(loop["bare_ms"]) < np.median(loop["whole_ms"])
    assert np.median(timed["feedforward"]["whole_ms"]) < np.median(timed["impedance"]["whole_ms"])


# known slips


class Still:
    """Commands nothing."""

    def step(self, observation: Observation) -> FloatArray:
        return np.zeros(1)


def watch(speeds: FloatArray, force: float = 2.0) -> Watched:
    """What is seen of pads whose object slides with speeds (m, n) along one direction, m/s."""
    watched = Watched(Still(), speeds.shape[1])
    n = speeds.shape[1]
    empty = ContactSet.from_arrays(np.zeros((0, 3)), np.zeros((0, 3)), center=np.zeros(3))
    for k, row in enumerate(speeds):
        pads = PadReading(
            normal_force=np.full(n, force),
            force=np.tile([force, 0.0, 0.0], (n, 1)),
            position=np.zeros((n, 3)),
            normal=np.tile([1.0, 0.0, 0.0], (n, 1)),
            sliding=row[:, None] * [0.0, 1.0, 0.0],
        )
        watched.step(
            Observation(
                time=DT * k,
                phase="hold",
                progress=0.0,
                q=np.zeros(1),
                v=np.zeros(1),
                T_world_base=SE3.Identity(),
                T_world_object=SE3.Identity(),
                normal_forces=np.full(n, force),
                read_twist=lambda: np.zeros(6),
                read_contacts=lambda: empty,
                read_pads=lambda pads=pads: pads,  # type: ignore[misc]
            )
        )
    return watched


def test_a_pad_slides_when_it_has_been_fast_for_as_long_as_a_slip() -> None:
    speeds = np.zeros((20, 2))
    speeds[-6:, 1] = 1.2 * SLIP_SPEED  # 10 ms from the first to the last
    assert watch(speeds).sliding()
    assert not watch(speeds[:-1]).sliding()
    assert not watch(speeds, force=0.01).sliding()
    speeds[-3, 1] = 0.0
    assert not watch(speeds).sliding()


def test_alarms_begin_and_end_with_the_slip() -> None:
    speeds = np.zeros((200, 3))
    speeds[50:80, 2] = 0.02
    speeds[190:, 0] = 0.02
    watched = watch(speeds)
    watched.finish()
    early, late = sorted(watched.alarms, key=lambda alarm: alarm.begin)
    assert (early.finger, late.finger) == (2, 0)
    assert DT * 50 < early.begin < DT * 62
    assert DT * 80 < early.end < DT * 100
    assert late.end == pytest.approx(DT * 199)


@pytest.mark.slow
def test_provoked_slips_are_found(plan: GraspPlan, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(slip_trial, "PEACE_S", 0.3)
    monkeypatch.setattr(slip_trial, "PROVOCATIONS", 1)
    monkeypatch.setattr(slip_trial, "GROW_S", 0.5)
    row = slip_row(plan, np.random.default_rng(0), Reality())
    for loop in row["loops"]:
        assert loop["slips"] >= 1
        assert loop["found"] >= 1
        assert loop["calm_s"] == pytest.approx(0.3, abs=0.01)
        assert loop["calm_false"] == 0
    assert json.loads(json.dumps(row, allow_nan=False)) == row


# tables


def cells(result: dict[str, Any], part: int = 0) -> list[list[str]]:
    """Rows of a table, as printed."""
    stream = StringIO()
    table = control_tables(result)[part]
    Console(file=stream, width=200).print(table)
    return [
        [str(c) for c in row] for row in zip(*(col.cells for col in table.columns), strict=True)
    ]


def row_of(part: str, k: int = 0, hand: str = "allegro_hand", **values: Any) -> dict[str, Any]:
    return {
        "index": k,
        "part": part,
        "hand": hand,
        "object": "sphere",
        "grasp": k,
        "error": "",
        **values,
    }


def test_fc_counts_grasps_that_hold_in_all_directions() -> None:
    rows = [
        row_of("fc", k, held=held, of=6, start_penetration_mm=0.1 * k, grasp_penetration_mm=0.2)
        for k, held in enumerate([6, 6, 5, 6])
    ]
    assert cells({"rows": rows})[-1] == ["all", "", "3/4", "75.0 %", "23/24", "0.30", "0.20"]


def test_pushes_are_compared_by_their_medians_and_with_the_bounds() -> None:
    def load(opened: float, best: float, closed: float, bound: float) -> dict[str, Any]:
        return {
            "kind": "force",
            "unit": "N",
            "lost_mm": 10.0,
            "lost_deg": 15.0,
            "bound": bound,
            "bound_near": None if bound > 9 else 1.2 * bound,
            "feedforward": {"borne": opened},
            "best": {"borne": best, "grip_N": 2.0 * best},
            "impedance": {"borne": closed},
        }

    rows = [
        row_of("push", 0, pushes=[load(2.0, 3.0, 7.0, 5.0)]),
        row_of("push", 1, pushes=[load(1.0, 2.0, 9.0, 10.0)]),
        row_of("push", 2, pushes=[load(4.0, 4.0, 5.0, 4.5)]),
    ]
    last = cells({"rows": rows})[-1]
    # medians 2, 3 and 7 N; shares 1.4, 0.9 and 1.11; beyond the near bounds 6 and 5.4 N: the first
    told = ["3", "2 N", "3 N", "6.0 N", "7 N", "3.50", "2.33", "1.11", "0.94", "3/3", "2", "1"]
    assert last == ["all", "", *told]
    assert "lost: 10 mm or 15 degrees in the palm" in str(control_tables({"rows": rows})[0].title)


def test_slips_and_peace_are_added_up() -> None:
    def loop(**values: Any) -> dict[str, Any]:
        numbers = {"slips": 10, "found": 9, "alarms": 12, "right": 11, "delay": 0.012}
        return {"loop": "feedforward", **numbers, "calm_s": 50.0, "calm_false": 1, **values}

    rows = [row_of("slip", k, loops=[loop()]) for k in range(2)]
    last = cells({"rows": rows})[-1]
    assert last[2:] == ["18/20", "90.0 %", "22/24", "91.7 %", "12", "100", "2", "2.00"]


def test_drift_grid_and_rate_are_counted() -> None:
    def hold(moved: float, reason: str = "") -> dict[str, Any]:
        return {
            "loop": "feedforward",
            "noslip": 10,
            "reason": reason,
            "moved_mm": moved,
            "turned_deg": moved,
        }

    rows = [row_of("drift", 0, seconds=10.0, holds=[hold(0.1), hold(0.9), hold(30.0, "dropped")])]
    (drift,) = cells({"rows": rows})
    assert drift == ["feedforward", "10", "2/3", "0.500", "0.820", "0.900", "1/3", "0.90"]
    grid = [
        {"loop": loop, "mass": 1.0, "friction": 0.7, "pose": "none", "held": held}
        for loop, held in (("feedforward", True), ("feedforward", False), ("impedance", True))
    ]
    assert cells({"rows": [row_of("robust", trials=grid)]})[-1][2:] == ["1/2 50.0 %", "1/1 100.0 %"]
    timed = {
        "loop": "impedance",
        "reason": "",
        "step_ms": 2.0,
        "whole_ms": [1.0, 0.8, 1.3],
        "bare_ms": [0.2],
    }
    lost = timed | {"reason": "no contact"}
    (told,) = cells({"rows": [row_of("rate", fingers=5, loops=[timed, lost])]})
    assert told[2:] == ["5", "1", "1.000", "0.800", "0.200", "0.800", "2.00"]


def test_pads_of_one_finger_are_summed(plan: GraspPlan) -> None:
    """Two pads that are called one: forces add, places and normals are weighted means."""
    hold = DisturbanceTrial(plan, controller=GraspController(plan))
    assert hold.close_and_squeeze() is None
    found = hand_contacts(hold.simulation.scene, hold.simulation.data)
    apart = ContactSet.from_contacts(
        [found[i] for i, f in enumerate(found.fingers) if f in ("thumb", "index")],
        center=found.center,
    )
    slid = read_pads(hold.simulation.scene, hold.simulation.data, apart.fingers).sliding
    names = {
        geom: "thumb" if name == "index" else name
        for geom, name in hold.simulation.scene.finger_of_geom.items()
    }
    together = read_pads(
        replace(hold.simulation.scene, finger_of_geom=names),
        hold.simulation.data,
        ("thumb", "ring"),
    )
    assert len(apart) == 2
    press = apart.forces[:, 0]
    weight = press / press.sum()
    forces = apart.forces_in_axes()
    assert together.normal_force[0] == pytest.approx(press.sum())
    np.testing.assert_allclose(together.force[0], forces.sum(axis=0), atol=1e-12)
    np.testing.assert_allclose(together.position[0], weight @ apart.positions, atol=1e-12)
    np.testing.assert_allclose(together.sliding[0], weight @ slid, atol=1e-12)
    mean = weight @ apart.normals
    np.testing.assert_allclose(together.normal[0], mean / np.linalg.norm(mean), atol=1e-9)
