"""Parts of the benchmark ``control``: pushes, promises, slips that are known."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from conftest import PlanOf

from benchmarks import control, slips
from benchmarks.control import PARTS, Options, cases, tables
from benchmarks.slips import Watched
from planner.certify import smallest_breaking
from planner.contacts import ContactSet
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray
from planner.verification import with_grip
from sim.contacts import hand_contacts
from sim.contacts.reading import read_pads
from sim.controllers import CONTROLLERS, GraspController, Observation, PadReading
from sim.controllers.monitors import SLIP_SPEED
from sim.protocols.disturbance import DROPPED, DisturbanceTrial
from sim.protocols.forces import PushCase
from sim.protocols.outcome import Outcome
from sim.protocols.variations import RobustCase
from sim.sensing.errors import ErrorModel
from sim.verdict import Fault

DT = 0.002


def test_every_part_sees_the_same_grasps() -> None:
    asked = Options(n=9, objects="sphere,box", parts="fc,drift", seed=3)
    made = list(cases(asked))
    assert len(made) == 18
    by_grasp: dict[int, set[tuple[str, str, int]]] = {}
    for case in made:
        grasp = (case["hand"], case["spec"], case["plan_seed"])
        by_grasp.setdefault(case["grasp"], set()).add(grasp)
        assert case["error_model"] == ErrorModel().seeded(case["grasp"])
    assert all(len(grasps) == 1 for grasps in by_grasp.values())
    # four cells: grasps 0 to 3 have the first seed, 8 the third
    assert [next(iter(by_grasp[k]))[2] for k in (0, 3, 4, 8)] == [3, 3, 4, 5]
    # a cell's grasps come together
    places = [(case["hand"], case["spec"]) for case in made]
    assert sum(a != b for a, b in pairwise(places)) == 3
    assert len({part.number for part in PARTS.values()}) == len(PARTS) <= control.NUMBERS


def test_pushes_are_compared_by_their_medians_and_with_the_bounds() -> None:
    def load(opened: float, best: float, closed: float, bound: float) -> dict[str, Any]:
        limits = {"kind": "force", "unit": "N", "lost_mm": 10.0, "lost_deg": 15.0}
        near = None if bound > 9 else 1.2 * bound
        loads = {"feedforward": opened, "best": best, "grip_N": 2.0 * best, "impedance": closed}
        return {**limits, "bound": bound, "bound_near": near, **loads}

    def row(k: int, *loads: float) -> dict[str, Any]:
        told = {"part": "push", "hand": "allegro_hand", "object": "sphere", "grasp": k}
        return {**told, "error": "", "pushes": [load(*loads)]}

    rows = [row(0, 2.0, 3.0, 7.0, 5.0), row(1, 1.0, 2.0, 9.0, 10.0), row(2, 4.0, 4.0, 5.0, 4.5)]
    (table,) = tables({"rows": rows})
    # medians 2, 3 and 7 N; shares 1.4, 0.9 and 1.11; beyond the near bounds 6 and 5.4 N: the first
    told = ["3", "2 N", "3 N", "6.0 N", "7 N", "3.50", "2.33", "1.11", "0.94", "3/3", "2/3", "1/2"]
    assert table["rows"][-1] == ["all", "", *told]
    assert "lost: 10 mm or 15 degrees in the palm" in table["title"]


@pytest.fixture(scope="module")
def plan(plan_of: PlanOf) -> GraspPlan:
    return plan_of("allegro_hand", "sphere")


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
    row = control.push_row(plan, np.random.default_rng(0), ErrorModel())
    grips = control.tried_grips(plan)
    assert grips[0] == plan.task.grip_force
    assert len(grips) == control.GRIPS + 1
    once = [*[CONTROLLERS["feedforward"]] * len(grips), CONTROLLERS["impedance"]]
    assert [made for made, *_ in met] == once * 2
    assert [grip for *_, grip in met] == [*grips, grips[0]] * 2
    for k, zero in ((0, slice(3, 6)), (len(once), slice(0, 3))):
        for other in met[k : k + len(once)]:
            np.testing.assert_array_equal(met[k][1], other[1])
        assert np.linalg.norm(met[k][1]) == pytest.approx(1.0)
        assert not met[k][1][zero].any()
    first = row["pushes"][0]
    assert (first["feedforward"], first["best"], first["grip_N"]) == (grips[0], *grips[-1:] * 2)
    assert (first["lost_mm"], first["lost_deg"]) == (DROPPED.mm, DROPPED.deg)


def test_the_largest_grip_is_the_last_that_the_hand_has(plan: GraspPlan) -> None:
    most = control.largest_grip(plan)
    assert with_grip(plan, most).forces.found
    assert not with_grip(plan, (1.0 + 2.0 * control.GRIP_TOL) * most).forces.found
    pressed = with_grip(plan, 0.9 * most)
    assert pressed.contacts.forces[:, 0].min() == pytest.approx(0.9 * most, rel=1e-5)
    weak = with_grip(plan, most)
    assert control.tried_grips(weak) == [most]  # nothing above it is left to try


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
    row = control.promise_row(plan, np.random.default_rng(0), ErrorModel())
    assert json.loads(json.dumps(row, allow_nan=False)) == row
    told = {(load["kind"], load["speed"]): load["broke_at"] for load in row["loads"]}
    assert told["force", "slow"] == pytest.approx(0.86)
    assert told["force", "sudden"] == pytest.approx(0.9)
    assert told["torque", "slow"] is told["torque", "sudden"] is None
    assert row["loads"][0]["promised"] == pytest.approx(force.bounds.lower)
    along = pushed[0] / np.linalg.norm(pushed[0])
    np.testing.assert_allclose(along, force.wrench / np.linalg.norm(force.wrench), atol=1e-9)


def test_the_grid_is_seen_by_a_latin_square(
    plan: GraspPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(RobustCase, "run", lambda self, plan, conditions: outcome(self))
    squares = set()
    for seed in range(10):
        trials = control.robust_row(plan, np.random.default_rng(seed), ErrorModel())["trials"]
        cells = [
            (t["mass"], t["friction"], t["pose"]) for t in trials if t["loop"] == "feedforward"
        ]
        assert cells == [(t["mass"], t["friction"], t["pose"]) for t in trials[1::2]]
        for pair in ((0, 1), (0, 2), (1, 2)):
            assert len({tuple(c[i] for i in pair) for c in cells}) == len(cells) == 9
        squares.add(frozenset(cells))
    assert len(frozenset.union(*squares)) == 27  # together they are the whole grid


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
    monkeypatch.setattr(slips, "PEACE_S", 0.3)
    monkeypatch.setattr(slips, "PROVOCATIONS", 1)
    monkeypatch.setattr(slips, "GROW_S", 0.5)
    row = slips.slip_row(plan, np.random.default_rng(0), ErrorModel())
    for loop in row["loops"]:
        assert loop["slips"] >= 1
        assert loop["found"] >= 1
        assert loop["calm_s"] == pytest.approx(0.3, abs=0.01)
        assert loop["calm_false"] == 0
    assert json.loads(json.dumps(row, allow_nan=False)) == row


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
