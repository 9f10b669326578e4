"""What leads a hand, watches it and sums a movement up: numbers on paper, rates by differences."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from planner.errors import TaskError
from planner.failure import Failure
from planner.forces.problem import torque_table
from planner.hands.hand import Hand
from planner.motion.path import ObjectPath
from planner.motion.plan import MovementPlan
from planner.search.from_cloud import _commonest
from planner.spatial import SE3, FloatArray
from planner.synthesis.link_spheres import margin_of
from sim.controllers.calibration import StopCorrection
from sim.manipulation.driver import BaseMover
from sim.scene.carrier import ArmCarrier, GantryCarrier, Timeline
from sim.sensing.estimation.log import EstimateLog
from sim.sensing.touch.senses import PlannedPads

STEP = 1e-5


@pytest.mark.parametrize("phase", ["approach", "open", "retreat", "lift", "hold"])
def test_an_arm_moves_at_the_rate_of_its_postures(phase: Any) -> None:
    """In each phase, also where the approach was cut short half way."""
    rng = np.random.default_rng(0)
    timeline = Timeline(approach=0.8, lift=1.5)
    carrier: Any = SimpleNamespace(
        _timeline=timeline,
        _path=SimpleNamespace(approach=rng.normal(size=(4, 3)), lift=rng.normal(size=(5, 3))),
        _approached=0.6,
        _lift_share=0.5,
    )
    seconds = timeline.lift if phase == "lift" else timeline.approach
    for share in (0.2, 0.55, 0.9):
        (before, _), (after, _) = (
            ArmCarrier.motion(carrier, phase, share + d) for d in (-STEP, STEP)
        )
        _, rate = ArmCarrier.motion(carrier, phase, share)
        np.testing.assert_allclose(rate, (after - before) / (2 * STEP * seconds), atol=1e-6)


def test_an_arm_is_where_its_paths_say_at_the_ends_of_phases() -> None:
    approach, lift = np.array([[0.0], [1.0], [3.0]]), np.array([[3.0], [5.0]])
    carrier: Any = SimpleNamespace(
        _timeline=Timeline(),
        _path=SimpleNamespace(approach=approach, lift=lift),
        _approached=1.0,
        _lift_share=0.5,
    )

    def at(phase: Any, share: float) -> float:
        return float(ArmCarrier.motion(carrier, phase, share)[0][0])

    ends = {
        ("approach", 0.0): 0.0,
        ("approach", 1.0): 3.0,
        ("close", 0.7): 3.0,
        ("lift", 0.0): 3.0,
        ("lift", 1.0): 4.0,  # half as high as the plan
        ("hold", 0.3): 4.0,
        ("open", 0.3): 3.0,
        ("retreat", 1.0): 0.0,
    }
    assert {key: at(*key) for key in ends} == pytest.approx(ends)


@pytest.mark.parametrize("phase", ["approach", "open", "retreat", "lift", "hold"])
def test_a_gantry_moves_at_the_rate_of_its_places(phase: Any) -> None:
    """After an approach that was given up half way, too: it opens there, and goes back from it."""
    start, timeline = np.arange(1.0, 7.0), Timeline(approach=0.8, lift=1.5, lift_height=0.1)
    lifted = np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.3])
    carrier: Any = SimpleNamespace(
        _timeline=timeline, _start=start, _lifted=lifted, _low=np.zeros(6), _still=np.zeros(6)
    )
    carrier._approached = 0.6
    seconds = timeline.lift if phase == "lift" else timeline.approach
    for share in (0.2, 0.9):
        (before, _), (after, _) = (
            GantryCarrier.motion(carrier, phase, share + d) for d in (-STEP, STEP)
        )
        _, rate = GantryCarrier.motion(carrier, phase, share)
        np.testing.assert_allclose(rate, (after - before) / (2 * STEP * seconds), atol=1e-6)
    ends = {
        "approach": (start, 0 * start),
        "open": (0.4 * start, 0.4 * start),
        "retreat": (0.4 * start, start),
        "lift": (0 * start, lifted),
        "hold": (lifted, lifted),
    }
    for share, expected in zip((0.0, 1.0), ends[phase], strict=True):
        found, rate = GantryCarrier.motion(carrier, phase, share)
        np.testing.assert_allclose(found, expected, atol=1e-12)
        np.testing.assert_allclose(rate, 0.0, atol=1e-12)


def turned(x: float, angle: float) -> SE3:
    return SE3(pin.exp3(np.array([0.0, 0.0, angle])), np.array([x, x**2, 0.0]))


def heading(pose: SE3) -> float:
    return float(np.arctan2(pose.rotation[1, 0], pose.rotation[0, 0]))


@pytest.mark.parametrize("along", [False, True])
def test_a_base_turns_the_short_way_past_half_a_turn(along: bool) -> None:
    given: list[FloatArray] = []

    def command(_: Any, target: FloatArray, velocity: FloatArray) -> FloatArray:
        given.append(target)
        return velocity

    gantry: Any = SimpleNamespace(
        coordinates=lambda pose: np.append(pose.translation, [0.0, 0.0, heading(pose)]),
        command=command,
        ctrl=np.arange(6),
    )
    places = [turned(0.0, 3.0), turned(0.1, 3.1), turned(0.2, 3.3)]
    mover = BaseMover(gantry, places[0])
    if along:
        mover.go_along(places, 1.0)
    else:
        mover.go(places[-1], 1.0)
    data: Any = SimpleNamespace(ctrl=np.zeros(6))
    for share in np.linspace(0.0, 1.0, 9):
        mover.drive(data, "approach", float(share))
    headings = np.array(given)[:, 5]
    assert (np.diff(headings) > 0).all()
    np.testing.assert_allclose(headings[[0, -1]], [3.0, 3.3])


@pytest.mark.parametrize("along", [False, True])
def test_a_base_moves_at_the_rate_of_its_places(along: bool) -> None:
    """What is given over to the servos: targets from end to end, rates of these, rest at both."""
    given: list[tuple[FloatArray, FloatArray]] = []

    def command(_: Any, target: FloatArray, velocity: FloatArray) -> FloatArray:
        given.append((target, velocity))
        return np.zeros(6)

    gantry: Any = SimpleNamespace(
        coordinates=lambda pose: np.append(pose.translation, [0.0, 0.0, heading(pose)]),
        command=command,
        ctrl=np.arange(6),
    )
    places = [turned(x, x) for x in (0.0, 0.1, 0.3)]
    mover = BaseMover(gantry, places[0])
    if along:
        mover.go_along(places, 2.0)
    else:
        mover.go(places[-1], 2.0)
    data: Any = SimpleNamespace(ctrl=np.zeros(6))
    for share in (0.0, 1.0, 0.3 - STEP, 0.3, 0.3 + STEP):
        mover.drive(data, "approach", share)
    begin, end, before, middle, after = given
    np.testing.assert_allclose(begin[0], np.zeros(6), atol=1e-12)
    np.testing.assert_allclose(end[0], [0.3, 0.09, 0.0, 0.0, 0.0, 0.3], atol=1e-12)
    np.testing.assert_allclose([begin[1], end[1]], 0.0, atol=1e-9)
    np.testing.assert_allclose(middle[1], (after[0] - before[0]) / (2 * STEP * 2.0), atol=1e-6)
    if along:  # half of the way is at the place between
        mover.drive(data, "approach", 0.5)
        np.testing.assert_allclose(given[-1][0][:3], [0.1, 0.01, 0.0], atol=1e-9)
    mover.stay()
    mover.drive(data, "hold", 0.5)
    np.testing.assert_allclose(given[-1][0], end[0], atol=1e-12)
    np.testing.assert_allclose(given[-1][1], 0.0)


@pytest.mark.parametrize("share", [0.25, 0.8])
def test_a_path_that_is_cut_short_goes_where_the_whole_one_does(share: float) -> None:
    whole = ObjectPath(axis=np.array([0.0, 0.0, 1.0]), angle=1.2, shift=np.array([0.1, 0.0, 0.2]))
    start = SE3(pin.exp3(np.array([0.3, 0.2, 0.1])), np.array([0.5, 0.0, 0.1]))
    for s in (0.0, 0.4, 1.0):
        np.testing.assert_allclose(
            whole.cut(share).pose(start, s).homogeneous, whole.pose(start, share * s).homogeneous
        )


def test_the_reserve_is_that_of_the_actuator_nearest_to_its_limit(allegro: Hand) -> None:
    """Pulls count against the lower limit, forces on the way too, those of no finger not at all."""
    q = allegro.posture("pinch")
    moment = allegro.actuation.moment
    limits = np.outer(np.arange(1.0, len(moment) + 1), [-1.0, 3.0])
    actuation = SimpleNamespace(moment=moment, force_limits=lambda _: limits)
    finger = allegro.fingers["index"]
    mine = np.flatnonzero(np.abs(moment[:, finger.q_index]).sum(axis=1))
    others = np.setdiff1d(np.arange(len(limits)), mine)

    def forces(actuator: int, share: float) -> Any:
        out = np.zeros(len(limits))
        out[actuator] = limits[actuator, int(share > 0)] * abs(share)
        return SimpleNamespace(actuator_forces=out)

    def reserve(*given: Any) -> float:
        knot = SimpleNamespace(q=q, forces=given[0], on_the_way=given[1:])
        task = SimpleNamespace(hand=SimpleNamespace(actuation=actuation), fingers=(finger,))
        getter: Any = MovementPlan.reserve
        return float(getter.func(SimpleNamespace(task=task, knots=(knot,))))

    assert reserve(forces(mine[0], 0.3)) == pytest.approx(0.7)
    assert reserve(forces(mine[1], -0.8)) == pytest.approx(0.2)
    assert reserve(forces(mine[0], 0.3), forces(mine[1], 0.9)) == pytest.approx(0.1)
    assert reserve(forces(others[0], 0.9)) == 1.0


def test_the_commonest_kind_of_failure_is_told_by_its_first_text() -> None:
    failures = [Failure(kind=k, text=f"{k} {n}") for n, k in enumerate("abbca")]
    assert _commonest(failures[1:]) == "b 1"
    assert _commonest([]) == "none made"


def test_links_of_touching_fingers_keep_other_margins_than_the_rest() -> None:
    def sphere(**of: Any) -> Any:
        about = {"geometry": "g", "joint_id": 3, "finger": "index", "is_pad": False}
        return SimpleNamespace(**(about | {"on_tip": False, "in_hull": False} | of))

    def finger(name: str, geom: str, joint: int, *, is_link: bool) -> Any:
        pad = SimpleNamespace(geom=geom, joint_id=joint)
        return SimpleNamespace(name=name, pad=pad, is_link=is_link)

    tip, link = finger("index", "tip", 4, is_link=False), finger("middle", "m2", 7, is_link=True)
    cases: list[tuple[Any, str | None]] = [
        (sphere(geometry="m2", finger="middle", joint_id=7), None),
        (sphere(geometry="other", finger="middle", joint_id=7), "clear_tip"),
        (sphere(is_pad=True), None),
        (sphere(is_pad=True, finger="ring"), "clear_object"),
        (sphere(on_tip=True), "clear_tip"),
        (sphere(on_tip=True, finger="ring"), "clear_object"),
        (sphere(), "clear_object"),
        (sphere(geometry="tip", joint_id=4), "clear_object"),  # of a tip the pad alone touches
    ]
    for one, margin in cases:
        assert margin_of(one, (tip, link)) == margin


def test_actuators_are_told_from_the_fullest_on_with_the_limit_on_their_side() -> None:
    forces = np.array([0.0, -0.9, 0.5, 0.2])
    limits = np.array([[-1.0, 1.0], [-1.0, 2.0], [-0.1, 1.0], [-1.0, np.inf]])
    head, *rows = torque_table(
        ("a", "b", "c", "d"), forces, limits, ("s1", "s2"), np.array([0.0, 0.4])
    )
    assert head.split() == ["actuator", "N", "m", "least", "greatest", "used"]
    assert [row.split()[0] for row in rows[:4]] == ["b", "c", "a", "d"]
    assert [row.split()[-2] for row in rows[:4]] == ["90", "50", "0", "0"]
    assert rows[4] == "  stops that carry (N m): s2 0.4000"


def observed(pose: SE3, covariance: FloatArray | None, time: float, phase: str) -> Any:
    uncertainty = None if covariance is None else SimpleNamespace(covariance=covariance, known=True)
    return SimpleNamespace(T_world_object=pose, uncertainty=uncertainty, time=time, phase=phase)


def test_errors_of_estimates_are_true_minus_estimated_in_the_world() -> None:
    log, covariance = EstimateLog(every=0.01), np.diag([1e-6, 4e-6, 9e-6, 1e-4, 1e-4, 4e-4])
    turn = pin.exp3(np.array([0.3, -0.2, 0.5]))
    true = SE3(pin.exp3(np.array([0.0, 0.0, 0.03])) @ turn, np.array([0.105, 0.2, 0.3]))
    estimated = SE3(turn, np.array([0.1, 0.2, 0.304]))
    for time, phase in ((0.0, "hold"), (0.004, "hold"), (0.010, "lift"), (0.5, "lift")):
        log.note(observed(true, None, time, phase), observed(estimated, covariance, time, phase))
    log.note(observed(true, None, 1.0, "lift"), observed(estimated, None, 1.0, "lift"))
    np.testing.assert_allclose(log.time, [0.0, 0.01, 0.5])
    assert log.phase == ("hold", "lift", "lift")
    error = [0.005, 0.0, -0.004, 0.0, 0.0, 0.03]
    np.testing.assert_allclose(log.error, np.tile(error, (3, 1)), atol=1e-12)
    np.testing.assert_allclose(log.deviation[0], [1e-3, 2e-3, 3e-3, 1e-2, 1e-2, 2e-2])
    assert log.within_two_sigma == pytest.approx(5 / 6)
    assert log._phases() == [(0.0, "hold"), (0.01, "lift")]
    with pytest.raises(TaskError, match="nothing was noted"):
        _ = EstimateLog().within_two_sigma


def test_planned_normals_turn_with_the_fingers_that_hold() -> None:
    """Whatever pads and base do together, normals go along; fewer than three turn with the base."""
    rng = np.random.default_rng(4)
    in_base = rng.normal(size=(4, 3))
    normals = rng.normal(size=(4, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    base, held = (SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3)) for _ in range(2))

    def expected(n: int, now: Callable[[FloatArray], FloatArray]) -> tuple[FloatArray, FloatArray]:
        places = np.array([now(point) for point in in_base[:n]])
        pads: Any = SimpleNamespace(
            _bodies=SimpleNamespace(
                turns=lambda: np.tile(np.eye(3), (n, 1, 1)), places=lambda: places
            ),
            _in_body=np.zeros((n, 3)),
            _centers=in_base[:n],
            _normals=normals[:n],
            _radii=np.full((n, 1), 0.01),
        )
        return PlannedPads.expected(pads, base)

    turned, places = expected(4, held.act)
    np.testing.assert_allclose(turned, normals @ held.rotation.T, atol=1e-9)
    np.testing.assert_allclose(places, [held.act(p) for p in in_base] + 0.01 * turned, atol=1e-9)
    np.testing.assert_allclose(expected(2, held.act)[0], normals[:2] @ base.rotation.T, atol=1e-9)


def test_a_confirmed_reading_of_a_stop_goes_down_with_the_offset_that_is_removed(
    shadow: Hand,
) -> None:
    stops = StopCorrection(shadow.actuation, shadow.neutral)
    assert stops.acts
    rng = np.random.default_rng(5)
    offset = rng.normal(size=shadow.nq)
    stops.offset = shadow.actuation.stop_rows @ offset
    stops.remove_offset(offset)
    np.testing.assert_allclose(stops.offset, 0.0, atol=1e-12)
