"""Objects in the palm: the contact step on paper, its derivative, the controller, the report."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import mujoco
import numpy as np
import pinocchio as pin
import pytest
import qpsolvers
from typer.testing import CliRunner

from benchmarks import palm
from planner.errors import NotFoundError, PlannerError, TaskError
from planner.spatial import FloatArray
from sim.cli import app
from sim.cli.common import EXIT_INTERRUPTED
from sim.palm import PalmReport, PalmSettings, reorient_in_palm
from sim.palm.control import PalmController, _Problem
from sim.palm.loop import AGAIN, FRICTIONS, _Branch, _Driver, _LookAhead, _rubbed, turn
from sim.palm.model import ContactStep, PalmModel, Plant, plant_of
from sim.palm.run import (
    AHEAD,
    CRADLES,
    GRAVITY,
    LIFT,
    ROLLS_M,
    TILT,
    _settle,
    _travel,
    lay_down,
    palm_scene,
)
from sim.tables import Row

CUBE, BALL = "box:0.05x0.05x0.05", "sphere:0.03"
QUARTER = pin.exp3(np.array([0.0, 0.0, np.pi / 2]))


def block(push: float, mu: float = 0.5, stiffness: float = 1e4) -> ContactStep:
    """A block of 100 N/m on a plane, in x and z, pressed down by 1 N and pushed by some N."""
    jacobian = np.array([[mu, 1.0], [-mu, 1.0]])
    return ContactStep(
        keep=np.eye(2),
        drive=np.zeros((2, 1)),
        rest=np.array([push, -1.0]) / 100.0,
        compliance=np.eye(2) / 100.0,
        jacobian=jacobian,
        gaps=np.zeros(2),
        stiffness=stiffness,
        smoothing=1e-9,
    )


def exact(step: ContactStep) -> FloatArray:
    """The displacement by the programme itself, solved as a QP."""
    q = np.linalg.inv(step.compliance)
    found = qpsolvers.solve_qp(q, -q @ step.rest, -step.jacobian, step.gaps, solver="daqp")
    return np.asarray(found)


def test_one_edge_has_the_force_of_the_programme() -> None:
    """With one row the dual's Hessian is a number: with its inverse as K the two agree."""
    step = replace(block(0.3), jacobian=np.array([[0.5, 1.0]]), gaps=np.zeros(1))
    k = 1.0 / float((step.jacobian @ step.compliance @ step.jacobian.T)[0, 0])
    step = replace(step, stiffness=k)
    assert step.step(np.zeros(2), np.zeros(1)) == pytest.approx(exact(step), abs=1e-9)


@pytest.mark.parametrize("push", [0.0, 0.2, 0.45, 0.8, 2.0])
def test_a_pressed_block_sticks_in_the_cone_and_slides_beyond(push: float) -> None:
    """Edges of one contact, K by hand: the normal motion of the programme, and its sign in x.

    The edges couple by 1 - mu^2; a diagonal K of 1 / (2 / 100) bears the weight exactly.
    """
    step = block(push, stiffness=50.0)
    moved, wanted = step.step(np.zeros(2), np.zeros(1)), exact(step)
    forces = step.forces(np.zeros(2), np.zeros(1))[0]
    assert (forces >= 0).all()
    if push <= 0.5:  # in the cone: the programme sticks, ours creeps by 1 - mu^2 of the free motion
        assert wanted == pytest.approx(np.zeros(2), abs=1e-9)
        assert moved[1] == pytest.approx(0.0, abs=1e-8)
        assert moved[0] == pytest.approx((1 - 0.5**2) * push / 100.0, abs=1e-8)
    else:
        assert wanted[0] > 0.0
        assert 0.0 < moved[0] <= push / 100.0
        assert (forces.max() > 2 * forces.min()) == (push > 0.7)


def test_no_contact_no_force() -> None:
    step = replace(block(0.3), gaps=np.full(2, 0.1))
    assert step.step(np.zeros(2), np.zeros(1)) == pytest.approx(step.rest)


@pytest.fixture(scope="module")
def lying() -> tuple[Any, Plant, Any, FloatArray]:
    """Scene, plant, data with a cube at rest in curled fingers, and their joints."""
    scene, q, nest = palm_scene("allegro_hand", CUBE)
    plant, data = plant_of(scene), mujoco.MjData(scene.model)
    lay_down(plant, data, PalmSettings(), scene.task.hand.neutral, np.eye(3), nest)
    data.ctrl[plant.ctrl] = plant.moment @ q
    for _ in range(300):
        mujoco.mj_step(scene.model, data)
    return scene, plant, data, q


def test_derivatives_agree_with_finite_differences(lying: Any) -> None:
    _, plant, data, _ = lying
    asked = PalmSettings()
    model = PalmModel(plant, asked)
    step = model.read(data.qpos)
    assert len(step.gaps) >= 16
    target = np.array([0.01, 0.0, 0.01, 0.1, 0.2, 0.3])
    problem = _Problem(step, asked, data.ctrl[plant.ctrl], target, model.tips())
    x = np.random.default_rng(3).uniform(-0.1, 0.1, asked.horizon * len(plant.ctrl))
    residuals, jacobian = problem.linearised(x)
    assert residuals == pytest.approx(problem.residuals(x), abs=1e-12)
    for k in range(0, len(x), 7):
        h = 1e-6 * np.eye(len(x))[k]
        slope = (problem.residuals(x + h) - problem.residuals(x - h)) / 2e-6
        assert jacobian[:, k] == pytest.approx(slope, abs=1e-6)


def test_a_contact_row_turns_about_the_axes_of_the_world(lying: Any) -> None:
    """A cube on its corner: its own axes are not the world's."""
    _, plant, data, _ = lying
    model = PalmModel(plant, PalmSettings(contacts=1))
    qpos = data.qpos.copy()
    turned = pin.exp3(np.array([0.3, 0.5, -0.4]))

    def at(rotation: Any) -> Any:
        x, y, z, w = pin.Quaternion(rotation).coeffs()
        out = qpos.copy()
        out[plant.object_qpos[3:]] = w, x, y, z
        out[plant.object_qpos[2]] += 0.02
        return out

    first = model.read(at(turned))
    row = first.jacobian[:4].mean(axis=0)[3:6]
    assert np.linalg.norm(row) > 0.005  # the corner is off the centre
    for axis, one in zip(np.eye(3), row, strict=True):
        change = model.read(at(pin.exp3(1e-5 * axis) @ turned)).gaps[0] - first.gaps[0]
        assert change == pytest.approx(1e-5 * one, abs=3e-9)


def test_a_contact_row_is_the_rate_of_the_gap(lying: Any) -> None:
    """Moving the object along world axes changes the nearest gap as the mean of its edges says."""
    _, plant, data, _ = lying
    model = PalmModel(plant, PalmSettings(contacts=1))
    qpos = data.qpos.copy()
    first = model.read(qpos)
    normal = first.jacobian[:4].mean(axis=0)
    for axis in range(3):
        moved = qpos.copy()
        moved[plant.object_qpos[axis]] += 1e-5
        change = model.read(moved).gaps[0] - first.gaps[0]
        assert change == pytest.approx(1e-5 * normal[axis], abs=2e-7)


def ipopt(step: ContactStep, asked: PalmSettings, ctrl: Any, target: Any, tips: Any) -> float:
    """Least cost of a horizon by IPOPT with CasADi's derivatives: the same terms, written again."""
    nu, steps = len(ctrl), asked.horizon
    u = ca.MX.sym("u", nu, steps)
    x, command, cost = ca.MX.zeros(step.keep.shape[0]), ca.MX(ca.DM(ctrl)), 0
    places, jacobians = tips
    for k in range(steps):
        command = command + u[:, k]
        free = step.keep @ x + step.drive @ command + step.rest
        z = -(step.gaps + step.jacobian @ free) / step.smoothing
        force = step.stiffness * step.smoothing * ca.log(1 + ca.exp(z))
        x = ca.MX(free + step.compliance @ (step.jacobian.T @ force))
        share = 1.0 if k == steps - 1 else asked.running_share
        cost += share * asked.position_cost * ca.sumsqr(x[:3] - target[:3])
        cost += share * asked.rotation_cost * ca.sumsqr(x[3:6] - target[3:])
        cost += asked.effort_cost * ca.sumsqr(u[:, k])
        for place, jacobian in zip(places, jacobians, strict=True):
            cost += asked.tip_cost * ca.sumsqr(place + jacobian @ x[6:] - x[:3])
    quiet = {"ipopt.print_level": 0, "print_time": False}
    solver = ca.nlpsol("palm", "ipopt", {"x": ca.vec(u), "f": cost}, quiet)
    most = asked.command_rad
    return float(solver(x0=np.zeros(nu * steps), lbx=-most, ubx=most)["f"])


def test_the_solve_is_as_good_as_ipopt(lying: Any) -> None:
    """More sweeps than a real-time iteration makes reach IPOPT's cost, and two come near it."""
    _, plant, data, _ = lying
    costs = {}
    for sweeps in (2, 30):
        asked = PalmSettings(sweeps=sweeps, goal_rad=1.0)
        controller = PalmController(plant, asked)
        controller._range = np.array([[-np.inf], [np.inf]]) * np.ones(len(plant.ctrl))
        ctrl = data.ctrl[plant.ctrl].copy()
        place = data.xpos[plant.object_body] + [0.01, 0.0, 0.01]
        controller.command(data.qpos, ctrl, pin.exp3(np.array([0.0, 0.0, 0.8])), place)
        step = controller.model.read(data.qpos)
        rotation = data.xmat[plant.object_body].reshape(3, 3)
        turned = pin.log3(pin.exp3(np.array([0.0, 0.0, 0.8])) @ rotation.T)
        target = np.concatenate([place - data.xpos[plant.object_body], turned])
        given = (step, asked, ctrl, target, controller.model.tips())
        residuals = _Problem(*given).residuals(controller._increments.ravel())
        costs[sweeps], least = float(residuals @ residuals), ipopt(*given)
        assert costs[sweeps] >= 0.999 * least
    assert costs[30] <= 1.01 * least
    assert costs[2] <= 1.1 * least


def test_an_object_at_its_goal_is_left_alone(lying: Any) -> None:
    _, plant, data, _ = lying
    now = mujoco.MjData(plant.model)
    now.qpos[:], now.ctrl[:], now.eq_active[:] = data.qpos, data.ctrl, data.eq_active
    mujoco.mj_forward(plant.model, now)
    goal = now.xmat[plant.object_body].reshape(3, 3).copy()
    place = now.xpos[plant.object_body].copy()
    asked: dict[str, Any] = {"tolerance_deg": 5.0, "hold_s": 0.5, "longest_s": 2.0, "seed": 0}
    log = turn(plant, now, goal, place, settings=PalmSettings(), **asked)
    assert log.outcome == "reached"
    assert set(log.phase[1:]) == {"still"}
    assert max(log.error_deg) < 2.0


def drive(lying: Any, turned: float, **asked: Any) -> tuple[Any, _LookAhead]:
    """Data as they lie, and a look ahead towards a turn (degrees) about the vertical."""
    _, plant, data, _ = lying
    now = mujoco.MjData(plant.model)
    mujoco.mj_copyData(now, plant.model, data)
    goal = pin.exp3(np.array([0.0, 0.0, np.radians(turned)])) @ now.xmat[plant.object_body].reshape(
        3, 3
    )
    place = now.xpos[plant.object_body].copy()
    settings = PalmSettings(**asked)
    driver = _Driver(plant, goal, place, settings, now.ctrl[plant.ctrl].copy(), 3.5)
    return now, _LookAhead(driver, float(place[2]) - 0.06, seed=0)


def test_a_look_ahead_leaves_the_world_as_it_is(lying: Any) -> None:
    now, look = drive(lying, 60.0, branches=2, ahead_s=0.3, open_s=0.2)
    before = (now.qpos.copy(), now.qvel.copy(), now.ctrl.copy(), now.time)
    friction = lying[1].model.geom_friction.copy()
    look.choose(now)
    for was, same in zip(before, (now.qpos, now.qvel, now.ctrl, now.time), strict=True):
        assert np.array_equal(was, same)
    assert np.array_equal(friction, lying[1].model.geom_friction)


def test_its_value_is_what_comes_of_it(lying: Any) -> None:
    """A branch that leaves the fingers where they are costs the angle that there is."""
    now, look = drive(lying, 60.0)
    end = now.time + 0.3
    stays = _Branch(
        away=look._real.begun, goal=np.eye(3), place=look._real.place, opens_until=end, until=end
    )
    assert look.value(0, now, stays) == pytest.approx(60.0, abs=1.0)
    on = replace(look._onwards(now, look._real.place), until=now.time + 0.2)
    first = look.value(0, now, on)
    look.value(1, now, on)
    assert look.value(0, now, on) == first  # whatever was tried between
    look._low = 1.0  # all that lies lower than a metre counts as dropped
    assert look.value(0, now, stays) == np.inf


def test_the_best_branch_is_done_that_does_not_drop(
    lying: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Values by hand: going on gains nothing, the least falls with more friction."""
    now, look = drive(lying, 60.0, branches=3)
    drawn: list[_Branch] = []
    openings = look._openings

    def draw(at: Any) -> list[_Branch]:
        drawn[:] = openings(at)
        return drawn

    def value(which: int, data: Any, branch: _Branch) -> float:
        if branch.away is None:
            return 59.0
        place = next(k for k, one in enumerate(drawn) if one is branch)
        return (np.inf, 10.0, 30.0)[place] if which == 0 else (5.0, np.inf, 30.0)[place]

    def no_more(at: Any, some: bool = False) -> list[_Branch]:
        assert not some  # the best gains, so that no finger needs to stay
        return draw(at)

    monkeypatch.setattr(look, "_openings", no_more)
    monkeypatch.setattr(look, "value", value)
    assert look.choose(now) is drawn[2]
    assert drawn[0].away is not None and drawn[1].away is not None
    assert not np.array_equal(drawn[0].away, drawn[1].away)


def test_fingers_stay_where_each_branch_drops(lying: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    now, look = drive(lying, 60.0, branches=3)
    monkeypatch.setattr(look, "value", lambda *_: np.inf)
    stays = look.choose(now)
    command = now.ctrl.copy()
    assert look._real.period(lying[1].model, now, stays) == "still"  # and is told as no opening
    assert np.array_equal(now.ctrl, command)
    assert stays.until > now.time


@pytest.mark.parametrize("which_is_worse", [1, 2])
def test_the_worst_friction_counts(
    lying: Any, monkeypatch: pytest.MonkeyPatch, which_is_worse: int
) -> None:
    """Two openings: with less friction 10 and 20 degrees, with more or between 50 and 30."""
    now, look = drive(lying, 60.0, branches=2)
    drawn = look._openings(now)
    values = {id(drawn[0]): (10.0, 50.0), id(drawn[1]): (20.0, 30.0)}
    monkeypatch.setattr(look, "_openings", lambda _: drawn)

    def value(which: int, _: Any, branch: _Branch) -> float:
        return values.get(id(branch), (59.0, 59.0))[int(which == which_is_worse)]

    monkeypatch.setattr(look, "value", value)
    assert look.choose(now) is drawn[1]


@pytest.mark.parametrize("least", [0, 1])
def test_what_more_frictions_drop_is_not_done(
    lying: Any, monkeypatch: pytest.MonkeyPatch, least: int
) -> None:
    """Two openings, 10 to 30 and 40 degrees; with one of four more the first drops the object."""
    now, look = drive(lying, 60.0, branches=2)
    drawn = look._openings(now)
    risky, safe = drawn[least], drawn[1 - least]
    monkeypatch.setattr(look, "_openings", lambda *_, **__: drawn)
    spread = 20.0
    risks: tuple[int, ...] = (4,)

    def value(which: int, _: Any, branch: _Branch) -> float:
        if branch is risky:
            return np.inf if which in risks else 10.0 + spread * (which == 1)
        return 40.0 if branch is safe else 70.0

    monkeypatch.setattr(look, "value", value)
    assert look.choose(now) is safe
    spread = 5.0  # ends that are alike are not tried again
    assert look.choose(now) is risky
    spread, risks = 20.0, ()  # and if none drops, the first is done
    assert look.choose(now) is risky


def test_going_on_is_tried_with_more_frictions_too(
    lying: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """40 and 20 degrees by going on, which one or two more frictions in four drop: 85, 130."""
    now, look = drive(lying, 60.0, branches=2)
    values = [40.0, 20.0, 20.0, 20.0, 20.0, np.inf, 20.0]
    monkeypatch.setattr(
        look, "value", lambda which, _, branch: np.inf if branch.away is not None else values[which]
    )
    monkeypatch.setattr(look, "_onward", lambda _, __, value: value)
    best = look.choose(now)
    assert best.away is None and not best.rests  # 25 more than now, with 30 the fingers stay
    values[3] = np.inf
    assert look.choose(now).rests


def test_openings_become_wider_while_the_object_is_held(
    lying: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    now, look = drive(lying, 60.0, branches=40)
    monkeypatch.setattr(look, "value", lambda *_: np.inf)
    costs = iter([60.0, *[59.0] * 9, 50.0])
    monkeypatch.setattr(look, "_cost", lambda _: next(costs))
    widths = []
    for _ in range(11):
        look.choose(now)
        away = np.array([one.away for one in look._openings(now)])
        widths.append(np.std(away - look._real.begun) / look._real.settings.scatter_rad)
    assert np.allclose(widths, [1, 2, 3, 4, 5, 6, 6, 6, 6, 6, 1], rtol=0.15)


def test_going_on_is_no_branch_once_it_is_stuck(
    lying: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    now, look = drive(lying, 60.0, branches=2, stall_s=1.0)
    monkeypatch.setattr(
        look, "value", lambda _, __, branch: 80.0 if branch.away is not None else 60
    )
    assert look.choose(now).away is None
    now.time += 1.1
    assert look.choose(now).away is not None
    assert look.choose(now).away is None  # it begins to count anew


def test_where_openings_drop_it_some_fingers_stay(
    lying: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each finger's four servos move together or stay, and the best of these branches is done."""
    now, look = drive(lying, 60.0)
    ctrl = lying[1].ctrl
    now.ctrl[ctrl] += 0.01
    assert look._fingers.sum(axis=1).tolist() == [4, 4, 4, 4]
    assert (look._fingers.sum(axis=0) == 1).all()
    opened = np.array([one.away != now.ctrl[ctrl] for one in look._openings(now, some=True)])
    assert 0.2 < opened.mean() < 0.8
    for servos in look._fingers.astype(bool):
        assert (opened[:, servos].all(axis=1) == opened[:, servos].any(axis=1)).all()

    def value(which: int, data: Any, branch: _Branch) -> float:
        stays = branch.away is None or (branch.away == now.ctrl[ctrl]).any()
        return 60.0 if branch.away is not None and stays else np.inf

    monkeypatch.setattr(look, "value", value)
    monkeypatch.setattr(look, "_onward", lambda _, __, value: value)
    best = look.choose(now)
    assert best.away is not None and (best.away == now.ctrl[ctrl]).any()


def test_what_comes_after_decides_where_nothing_gains(
    lying: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two openings, 70 and 80 degrees: all drop after the first, 10 are left after the second."""
    now, look = drive(lying, 60.0, branches=2)
    drawn = look._openings(now)
    monkeypatch.setattr(look, "_openings", lambda *_, **__: drawn)
    values = {id(drawn[0]): 70.0, id(drawn[1]): 80.0}

    def value(which: int, data: Any, branch: _Branch) -> float:
        if data is now:
            look._data.qpos[0] = values.get(id(branch), 0.0)
            return values.get(id(branch), 65.0)
        return {70.0: np.inf, 80.0: 10.0}.get(float(data.qpos[0]), 65.0)

    monkeypatch.setattr(look, "value", value)
    assert look.choose(now) is drawn[1]
    values = {id(drawn[0]): 70.0, id(drawn[1]): np.inf}
    assert look.choose(now).away is None  # 65 degrees, by going on
    look._since = -10.0
    assert look.choose(now).rests  # going on is no branch, and after the opening all drop


def test_less_counts_as_progress_where_less_is_left(
    lying: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 6 degrees 2 are gained by going on, and of 60 not; an opening would gain more."""
    now, look = drive(lying, 60.0, branches=2)
    for here, goes_on in ((6.0, True), (60.0, False)):
        look._best, look._since = np.inf, -np.inf
        monkeypatch.setattr(look, "_cost", lambda _, here=here: here)
        monkeypatch.setattr(
            look,
            "value",
            lambda _, __, branch, here=here: here - (2.0 if branch.away is None else 5.0),
        )
        assert (look.choose(now).away is None) == goes_on


def test_small_progress_near_the_goal_is_no_standstill(
    lying: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From 6 to 4 degrees, and no branch gains: openings stay narrow, and it is not stuck."""
    now, look = drive(lying, 60.0, branches=2, stall_s=1.0)
    monkeypatch.setattr(look, "value", lambda _, __, branch: 6.0 if branch.away is None else 20.0)
    monkeypatch.setattr(look, "_onward", lambda _, __, value: value)
    for here in (6.0, 4.0):
        monkeypatch.setattr(look, "_cost", lambda _, here=here: here)
        assert look.choose(now).away is None
        assert look._unmoved == 0
        now.time += 0.6
    assert look._since == pytest.approx(now.time - 0.6)


def test_going_on_to_the_place_stays_a_branch_beside_turning_where_it_lies(
    lying: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    now, look = drive(lying, 60.0, branches=2)
    look._real.place = look._real.place + np.array([0.03, 0.0, 0.0])
    here = look._cost(now)

    def value(which: int, data: Any, branch: _Branch) -> float:
        there = branch.away is None and np.allclose(branch.place, look._real.place)
        return here - 1.0 if there else here + 10.0  # less than progress

    monkeypatch.setattr(look, "value", value)
    monkeypatch.setattr(look, "_onward", lambda _, __, value: value)
    best = look.choose(now)
    assert best.away is None and np.allclose(best.place, look._real.place)


def test_an_object_off_its_place_is_turned_where_it_lies(
    lying: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Asked for its place it gains nothing, asked to stay there it does; at its place none asks."""
    now, look = drive(lying, 60.0, branches=2)
    assert look._staying(now) == []
    lies = look._real.place.copy()
    look._real.place = lies + np.array([0.03, 0.0, 0.0])

    def value(which: int, data: Any, branch: _Branch) -> float:
        return 20.0 if np.allclose(branch.place, lies) else 200.0

    monkeypatch.setattr(look, "value", value)
    best = look.choose(now)
    assert best.away is None and not best.rests
    asked: list[Any] = []

    def command(qpos: Any, ctrl: Any, goal: Any, place: Any) -> Any:
        asked.append(place)
        return ctrl

    monkeypatch.setattr(look._real.controller, "command", command)
    look._real.period(lying[1].model, now, best)
    assert np.allclose(asked, lies)


def test_at_the_goal_the_place_costs_nothing(lying: Any) -> None:
    for turned, costs in ((3.0, False), (5.0, True)):  # the commands stay within 3.5 degrees
        now, look = drive(lying, turned)
        look._real.place = look._real.place + np.array([0.03, 0.0, 0.0])
        assert (look._cost(now) > turned + 1.0) == costs


def test_rest_does_not_last_for_ever(lying: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """An opening that loses 100 degrees, of which 30 may be lost: fingers rest three times."""
    now, look = drive(lying, 60.0, branches=2)
    monkeypatch.setattr(
        look, "value", lambda _, __, branch: np.inf if branch.away is None else 160.0
    )
    monkeypatch.setattr(look, "_onward", lambda _, __, value: value)
    assert [look.choose(now).rests for _ in range(4)] == [True, True, True, False]


def test_what_lies_out_of_reach_is_brought_back_by_some_of_them(lying: Any) -> None:
    """These ask for the rotation that the object has; at its place none does."""
    now, look = drive(lying, 60.0, branches=4)
    has = now.xmat[lying[1].object_body].reshape(3, 3)
    assert not any(np.allclose(branch.goal, has) for branch in look._openings(now))
    look._real.place = look._real.place + np.array([0.03, 0.0, 0.0])
    backs = [np.allclose(branch.goal, has) for branch in look._openings(now)]
    assert backs == [False, True, False, False]


@pytest.mark.parametrize(("left", "beyond"), [(20.0, 20.0), (60.0, 60.0), (120.0, 90.0)])
def test_some_of_them_turn_beyond_the_goal_and_some_beside_it(
    lying: Any, left: float, beyond: float
) -> None:
    """About the same axis by as much as is left, a quarter turn at most; beside it, elsewhere."""
    now, look = drive(lying, left, branches=8)
    has = now.xmat[lying[1].object_body].reshape(3, 3)
    goals = [branch.goal for branch in look._openings(now)]
    goal = look._real.goal
    assert np.allclose(goals[0], goal) and np.allclose(goals[4], goal)
    axis = pin.log3(goal @ has.T) / np.radians(left)
    assert np.allclose(goals[2], pin.exp3(np.radians(left + beyond) * axis) @ has, atol=1e-6)
    assert 1.0 < np.degrees(np.linalg.norm(pin.log3(goals[3] @ goal.T))) < 120.0
    assert not np.allclose(goals[3], look._openings(now)[3].goal)  # drawn anew


@pytest.mark.parametrize(("tolerance", "still"), [(5.0, True), (1.0, False)])
def test_it_stays_only_within_the_tolerance_that_is_asked_for(
    lying: Any, tolerance: float, still: bool
) -> None:
    """2.5 degrees are still within 5, and not within 1."""
    now, look = drive(lying, 2.5)
    asked: dict[str, Any] = {"tolerance_deg": tolerance, "hold_s": 0.5, "longest_s": 0.3, "seed": 0}
    settings = PalmSettings(branches=1, ahead_s=0.1)
    log = turn(lying[1], now, look._real.goal, look._real.place, settings=settings, **asked)
    assert (set(log.phase) == {"still"}) == still


def test_a_look_ahead_counts_place_friction_and_a_fall(lying: Any) -> None:
    now, look = drive(lying, 60.0)
    angle = look._cost(now)
    look._real.place = look._real.place + np.array([0.03, 0.0, 0.0])
    assert look._cost(now) == pytest.approx(angle + 2 * 2000.0 * 0.015, abs=0.2)
    assert FRICTIONS[0] < FRICTIONS[2] < 1.0 < FRICTIONS[1]
    model = lying[1].model
    for rubbed, share in zip(look._models, (*FRICTIONS, *AGAIN), strict=True):
        assert rubbed.geom_friction[:, 0] == pytest.approx(share * model.geom_friction[:, 0])
    pair = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><geom name='a' size='1'/><body><geom name='b' size='1'/></body>"
        "</worldbody><contact><pair geom1='a' geom2='b' friction='1 1 1 1 1'/></contact></mujoco>"
    )
    assert _rubbed(pair, 0.5, 0.002).pair_friction[0] == pytest.approx([0.5, 0.5, 1.0, 1.0, 1.0])
    steps = [model.opt.timestep for model in look._models]
    assert steps == [0.004] + [lying[1].model.opt.timestep] * (len(FRICTIONS) + len(AGAIN) - 1)
    thrown = drive(lying, 60.0)[0]
    thrown.qpos[lying[1].object_qpos[:3]] += [0.3, 0.0, 0.0]  # beside the hand
    end = thrown.time
    rests = replace(look._onwards(now, look._real.place), opens_until=end, until=end, rests=True)
    assert look.value(0, thrown, rests) == np.inf


@pytest.mark.parametrize("costs", [(10.0, 40.0), (40.0, 10.0)])
def test_what_rolls_on_after_a_branch_counts(
    lying: Any, monkeypatch: pytest.MonkeyPatch, costs: tuple[float, float]
) -> None:
    now, look = drive(lying, 60.0)
    told = iter(costs)
    monkeypatch.setattr(look, "_cost", lambda _: next(told))
    end = now.time
    rests = replace(look._onwards(now, look._real.place), opens_until=end, until=end, rests=True)
    assert look.value(0, now, rests) == 40.0


def test_a_search_ends_with_what_gains_and_is_no_worse_than_others(
    lying: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """10 degrees with each friction: no other can be less, with 20 at its best."""
    now, look = drive(lying, 60.0, branches=2)
    first, second = look._openings(now)
    tried = []

    def value(which: int, _: Any, branch: _Branch) -> float:
        tried.append((which, branch is first))
        return 10.0 if branch is first else 20.0

    monkeypatch.setattr(look, "value", value)
    assert look._worst(now, [first, second], [], 57.0) == [(10.0, first)]
    assert tried == [(0, True), (0, False), (1, True), (2, True)]
    tried.clear()
    assert len(look._worst(now, [first, second], [], 5.0)) == 2  # none gains: both are told


def test_a_mirror_is_no_goal() -> None:
    with pytest.raises(TaskError, match="goal_rotation is no rotation"):
        reorient_in_palm("allegro_hand", CUBE, np.diag([1.0, 1.0, -1.0]))


def test_a_hand_without_a_palm_up_pose_is_named() -> None:
    with pytest.raises(NotFoundError, match=r"palm-up pose of a hand.*shadow_hand_left"):
        reorient_in_palm("shadow_hand_left", CUBE, QUARTER)


@pytest.mark.parametrize("hand", CRADLES)
def test_a_cube_rests_in_each_cradle_where_fingertips_reach(hand: str) -> None:
    """For 1.5 s within 3 mm of where it settled; fingertips within 8 cm of where it is wanted."""
    scene, q, nest = palm_scene(hand, CUBE)
    plant, data = plant_of(scene), mujoco.MjData(scene.model)
    lay_down(plant, data, PalmSettings(), scene.task.hand.neutral, np.eye(3), nest)
    _settle(plant, data, q)
    first = data.xpos[plant.object_body].copy()
    mujoco.mj_step(scene.model, data, 750)
    place = data.xpos[plant.object_body]
    assert np.linalg.norm(place - first) < 0.003
    for body, point in plant.tips:
        tip = data.xpos[body] + data.xmat[body].reshape(3, 3) @ point
        assert np.linalg.norm(tip - place - [AHEAD, 0.0, LIFT]) < 0.08


def laid(shape: str) -> tuple[Plant, Any, FloatArray, FloatArray]:
    """An object just above the open Allegro-type hand: plant, data, curled joints, its place."""
    scene, q, nest = palm_scene("allegro_hand", shape)
    plant, data = plant_of(scene), mujoco.MjData(scene.model)
    lay_down(plant, data, PalmSettings(), scene.task.hand.neutral, np.eye(3), nest)
    return plant, data, q, nest


def test_a_ball_on_the_palm_rolls_as_on_a_slope() -> None:
    """Without slip, from rest, 5/7 g sin(tilt): nothing in the scene's contacts resists rolling."""
    plant, data, *_ = laid(BALL)
    mujoco.mj_step(plant.model, data, 50)  # down by the gap to the palm, which it touches then
    speed, began = data.qvel[plant.object_dof[0]], data.time
    mujoco.mj_step(plant.model, data, 25)
    gained = (data.qvel[plant.object_dof[0]] - speed) / (data.time - began)
    assert gained == pytest.approx(5 / 7 * GRAVITY * np.sin(TILT), rel=0.02)


@pytest.mark.parametrize(
    ("shape", "rolls"),
    [
        (BALL, True),
        ("ellipsoid:0.06x0.054x0.048", True),
        (CUBE, False),
        ("cylinder:0.028x0.055", False),
        ("torus:0.025x0.015", False),
    ],
)
def test_what_rolls_leaves_the_open_palm(shape: str, rolls: bool) -> None:
    scene, _, nest = palm_scene("allegro_hand", shape)
    opened = scene.task.hand.neutral
    way = _travel(plant_of(scene), PalmSettings(), opened, opened, np.eye(3), nest)
    assert (np.linalg.norm(way) > ROLLS_M) == rolls
    assert np.linalg.norm(way) < 0.01 or rolls


@pytest.mark.parametrize(("shape", "caged"), [(CUBE, False), ("cylinder:0.028x0.055", True)])
def test_what_curling_fingers_push_aside_is_held_meanwhile(shape: str, caged: bool) -> None:
    """The thumb pushes the cylinder by 4 cm, to 3 cm beside the palm's middle."""
    report = reorient_in_palm("allegro_hand", shape, QUARTER, longest_s=0.1)
    assert report.caged == caged
    assert abs(report.T_world_object[0, 1]) < 0.015


@pytest.mark.parametrize("radius", ["0.025", "0.03", "0.035"])
def test_fingers_cage_a_ball_that_is_held_and_do_not_press_it(radius: str) -> None:
    """It keeps its pose until they have curled; then it rests in the hand under its own weight.

    It is wedged between fingers, so that one may bear up to twice the weight. Fingers that stay
    curled about a ball of 25 mm press it onto the palm with 10 N, ten weights.
    """
    plant, data, q, _ = laid(f"sphere:{radius}")
    before, seen = data.qpos[plant.object_qpos].copy(), []
    _settle(plant, data, q, lambda: seen.append(data.qpos[plant.object_qpos[:3]].copy()), held=True)
    held = np.array(seen)[: 2 * len(seen) // 3]
    assert np.abs(held - before[:3]).max() < 0.001
    assert abs(data.xpos[plant.object_body][2] - before[2]) < 0.01
    assert np.linalg.norm(data.qvel[plant.object_dof[:3]]) < 0.01
    force, largest = np.zeros(6), 0.0
    weight = plant.model.body_mass[plant.object_body] * GRAVITY
    for k in range(data.ncon):
        if plant.object_body in plant.model.geom_bodyid[data.contact.geom[k]]:
            mujoco.mj_contactForce(plant.model, data, k, force)
            largest = max(largest, force[0])
    assert 0.2 * weight < largest < 2.0 * weight


def test_a_ball_is_laid_down_where_it_comes_to_rest_and_has_hardly_turned_there() -> None:
    """Laid where a cube lies it turned by 16 degrees until it lay still."""
    report = reorient_in_palm("allegro_hand", BALL, QUARTER, longest_s=0.1)
    assert report.caged
    assert report.error_deg[0] == pytest.approx(90.0, abs=12.0)


def test_half_of_the_openings_hold_what_rolls_by_some_fingers(lying: Any) -> None:
    """One round of targets opens all fingers, the next some of them; a cube's open all."""
    now, look = drive(lying, 60.0)
    now.ctrl[lying[1].ctrl] += 0.01
    stays = [(one.away == now.ctrl[lying[1].ctrl]).any() for one in look._openings(now)]
    assert not any(stays)
    rolling = _LookAhead(look._real, look._low, 0, caged=True)
    stays = [(one.away == now.ctrl[lying[1].ctrl]).any() for one in rolling._openings(now)]
    assert not any(stays[:4]) and sum(stays[4:]) >= 3


def test_an_object_that_rolls_off_is_told_at_once() -> None:
    with pytest.raises(TaskError, match="rolls off the palm at once"):
        reorient_in_palm("allegro_hand", CUBE, QUARTER, shift=(-0.09, 0.0))


@pytest.mark.parametrize("given", [{"seed": -1}, {"seed": 1.5}, {"settings": "fast"}])
def test_a_seed_or_settings_of_another_kind_are_named(given: Any) -> None:
    with pytest.raises(PlannerError, match=next(iter(given))):
        reorient_in_palm("allegro_hand", CUBE, QUARTER, **given)


def test_a_setting_that_cannot_be_is_refused() -> None:
    with pytest.raises(TaskError, match="period_s"):
        PalmSettings(period_s=0.2)
    with pytest.raises(TaskError, match="ahead_s"):
        PalmSettings(ahead_s=1e5)


@pytest.mark.slow
def test_a_short_turn_is_executed_and_reported(tmp_path: Path) -> None:
    report = reorient_in_palm("allegro_hand", CUBE, QUARTER.T, longest_s=8.0)
    assert isinstance(report, PalmReport)
    assert report.error_deg.min() < 0.7 * report.error_deg[0]
    there = report.error_deg[-5:] <= report.tolerance_deg  # 0.5 s
    assert report.success == bool(there.all())
    assert report.to_dict()["outcome"] == report.outcome
    report.save_html(tmp_path / "report.html")
    assert "Contact-implicit control" in (tmp_path / "report.html").read_text()
    again = reorient_in_palm("allegro_hand", CUBE, QUARTER.T, longest_s=8.0)
    assert again.error_deg.tolist() == report.error_deg.tolist()


@pytest.mark.slow
def test_a_ball_is_turned_by_a_quarter() -> None:
    report = reorient_in_palm("allegro_hand", BALL, QUARTER, longest_s=30.0)
    assert report.caged and report.success
    assert 60.0 < report.error_deg[0] < 100.0  # laid down as asked, it has hardly rolled


def test_a_benchmark_gives_any_rotation_the_time_that_is_asked() -> None:
    asked = palm.Options(n=1, goals="yaw,any", longest=300.0)
    assert {case["goal"]: case["longest_s"] for case in palm.cases(asked)} == {
        "yaw": 30.0,
        "any": 300.0,
    }


def test_the_published_code_runs_in_its_folder_and_results_go_where_they_were_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[Path] = []

    def run(case: Row) -> Row:
        seen.append(Path.cwd())
        return case

    monkeypatch.setattr(palm, "_run_published", run)
    before = Path.cwd()
    palm.measure({"scene": "published", "folder": str(tmp_path)})
    assert seen == [tmp_path.resolve()]
    assert Path.cwd() == before


def test_ctrl_c_ends_a_turn_in_the_palm_with_what_there_is(tmp_path: Path) -> None:
    told: list[tuple[float, float]] = []

    def press(time_s: float, left_deg: float) -> None:
        told.append((time_s, left_deg))
        if len(told) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):  # of the caller's own function: it is the caller's
        reorient_in_palm("allegro_hand", CUBE, QUARTER, progress=press)
    assert [time for time, _ in told] == pytest.approx([0.1, 0.2])
    assert all(60.0 < left < 100.0 for _, left in told)


@pytest.mark.parametrize("periods", [0, 2])
def test_ctrl_c_keeps_the_periods_that_are_over(
    monkeypatch: pytest.MonkeyPatch, periods: int
) -> None:
    whole = _Driver.period
    made: list[int] = []

    def period(*args: Any) -> str:
        if len(made) == periods:
            raise KeyboardInterrupt
        made.append(1)
        return whole(*args)

    monkeypatch.setattr(_LookAhead, "choose", lambda self, _: _quiet(self))
    monkeypatch.setattr(_Driver, "period", period)
    if not periods:
        with pytest.raises(KeyboardInterrupt):
            reorient_in_palm("allegro_hand", CUBE, QUARTER)
        return
    report = reorient_in_palm("allegro_hand", CUBE, QUARTER)
    assert (report.outcome, len(report.time)) == ("interrupted", periods)
    assert not report.success
    assert report.to_dict()["outcome"] == "interrupted"
    made.clear()
    asked = ["manipulate", "allegro_hand", CUBE, "--in-palm", "--turn-to", "0,0,90", "--json"]
    assert CliRunner().invoke(app, asked).exit_code == EXIT_INTERRUPTED


def _quiet(look: _LookAhead) -> _Branch:
    real = look._real
    return _Branch(away=None, goal=real.goal, place=real.place, opens_until=-1.0, until=np.inf)
