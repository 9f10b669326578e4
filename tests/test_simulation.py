"""The simulation by itself: what is seen, what may drive it, and how it ends."""

from __future__ import annotations

from functools import partial

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from conftest import PlanOf

from planner.errors import NotFoundError, TaskError
from planner.plan import GraspPlan
from planner.spatial import FloatArray, pose_change, pose_to_wxyz
from sim.contacts import hand_contacts
from sim.controllers import (
    CONTROLLERS,
    GraspController,
    ObjectImpedance,
    Observation,
    controller_for,
    controller_maker,
    controller_name,
)
from sim.protocols import run_protocol
from sim.protocols.disturbance import DisturbanceTrial
from sim.recorder import Recorder
from sim.scene.carrier import Timeline
from sim.simulation import Simulation
from sim.trial import simulate

QUICK = Timeline(approach=0.3, close=0.3, close_wait=0.2, squeeze=0.2, lift=0.4, hold=0.2)


@pytest.fixture(scope="module")
def plan(plan_of: PlanOf) -> GraspPlan:
    return plan_of("allegro_hand", "sphere")


@pytest.fixture(scope="module")
def on_a_wrist(plan_of: PlanOf) -> GraspPlan:
    """A hand whose palm moves in its base."""
    return plan_of("shadow_hand", "cylinder")


# what is seen


def put_object(simulation: Simulation, pose: pin.SE3) -> None:
    scene, data = simulation.scene, simulation.data
    data.qpos[scene.object_qpos] = np.concatenate(pose_to_wxyz(pose))
    mujoco.mj_kinematics(scene.model, data)


def test_slip_is_movement_in_the_palm_and_not_in_the_base(on_a_wrist: GraspPlan) -> None:
    plan = on_a_wrist
    simulation = Simulation(plan, q=plan.q, T_world_base=plan.T_world_base)
    scene, data = simulation.scene, simulation.data
    recorder = Recorder(simulation, 0.02)
    recorder.mark_reference()
    T_palm_object, T_base_object = simulation.T_palm_object, simulation.T_base_object
    data.qpos[scene.hand_qpos[plan.task.hand.wrist_index]] += 0.2
    mujoco.mj_kinematics(scene.model, data)
    put_object(simulation, scene.body_pose(data, scene.palm_body) * T_palm_object)
    assert recorder.slip() == pytest.approx((0.0, 0.0), abs=1e-4)
    moved, turned = pose_change(T_base_object, simulation.T_base_object)
    assert moved > 5.0
    assert turned == pytest.approx(np.rad2deg(np.hypot(0.2, 0.2)), rel=0.1)
    # where the object stays behind, it has moved in the palm as far as the palm under it
    put_object(simulation, simulation.T_world_base * T_base_object)
    assert recorder.slip()[0] > 5.0
    assert recorder.slip()[1] == pytest.approx(turned, abs=1e-4)
    recorder.record()
    samples = recorder.samples()
    assert (samples.slip_mm[-1], samples.slip_deg[-1]) == recorder.slip()


def test_the_objects_twist_is_in_world_axes(plan: GraspPlan) -> None:
    """Against the difference of two poses, of an object that is turned and spins."""
    simulation = Simulation(plan)
    scene, data = simulation.scene, simulation.data
    turned = pin.SE3(pin.exp3(np.array([0.9, -0.4, 0.7])), np.array([0.1, 0.2, 0.6]))
    put_object(simulation, turned)
    data.qvel[scene.object_dof] = [0.3, -0.1, 0.2, 1.0, 2.0, -0.5]
    seen = simulation.observe("hold", 1.0).object_twist
    before = simulation.T_world_object
    elapsed = 1e-6
    mujoco.mj_integratePos(scene.model, data.qpos, data.qvel, elapsed)
    mujoco.mj_kinematics(scene.model, data)
    after = simulation.T_world_object
    linear = (after.translation - before.translation) / elapsed
    angular = pin.log3(after.rotation @ before.rotation.T) / elapsed
    np.testing.assert_allclose(seen, np.concatenate([linear, angular]), atol=1e-5)
    assert np.abs(seen[3:] - data.qvel[scene.object_dof[3:]]).max() > 0.5  # in other axes


def test_poses_hang_together(on_a_wrist: GraspPlan) -> None:
    simulation = Simulation(on_a_wrist)
    scene, data = simulation.scene, simulation.data
    in_base = simulation.T_world_base * simulation.T_base_object
    in_palm = scene.body_pose(data, scene.palm_body) * simulation.T_palm_object
    assert in_base.isApprox(simulation.T_world_object, 1e-12)
    assert in_palm.isApprox(simulation.T_world_object, 1e-12)
    assert simulation.touching() == 0
    np.testing.assert_array_equal(simulation.q, on_a_wrist.q_start)


# running and ending


def test_a_phase_lasts_as_long_as_it_was_told_and_waits_for_what_it_is_to_wait_for(
    plan: GraspPlan,
) -> None:
    simulation = Simulation(plan)
    dt = simulation.timestep
    since: list[float] = []
    seen = list(simulation.run("approach", 20 * dt, before=since.append))
    assert [len(seen), simulation.steps] == [20, 20]
    np.testing.assert_allclose(since, dt * np.arange(20))
    np.testing.assert_allclose([o.progress for o in seen], np.arange(20) / 20)
    never = simulation.run("close", 5 * dt, wait=7 * dt, until=lambda _: False)
    assert [o.progress for o in never][5:] == [1.0] * 7
    soon = simulation.run("close", 5 * dt, wait=7 * dt, until=lambda o: o.time >= 33.5 * dt)
    assert len(list(soon)) == 5 and simulation.steps == 37
    later = simulation.run("close", 5 * dt, wait=7 * dt, until=lambda o: o.time >= 44.5 * dt)
    assert len(list(later)) == 9
    due = [simulation.due(4 * dt) for _ in simulation.run("close", 8 * dt)]
    assert sum(due) == 2


def test_whoever_looks_on_may_stop_it(plan: GraspPlan) -> None:
    times: list[float] = []

    def on_step(simulation: Simulation) -> None:
        times.append(simulation.time)
        if simulation.phase == "squeeze":
            simulation.stop("seen enough")
            simulation.stop("said again")

    report = simulate(plan, timeline=QUICK, on_step=on_step)
    assert (report.success, report.reason) == (False, "stopped")
    assert "seen enough" in report.verdict.detail
    assert "said again" not in report.verdict.detail
    assert times[-1] == pytest.approx(report.simulated_s)
    assert report.simulated_s < QUICK.approach + QUICK.close + QUICK.close_wait + QUICK.squeeze
    assert set(report.samples.phase) <= {"approach", "close", "squeeze"}
    assert report.to_dict()["reason"] == "stopped"


def test_a_simulation_that_has_ended_makes_no_further_step(plan: GraspPlan) -> None:
    simulation = Simulation(plan)
    for _ in simulation.run("approach", 0.1):
        simulation.stop("at once")
    assert (simulation.steps, simulation.ended) == (1, True)
    assert list(simulation.run("close", 0.1)) == []
    with pytest.raises(TaskError, match="stop needs a reason"):
        simulation.stop("")


def test_a_disturbance_trial_that_is_stopped_says_so(plan: GraspPlan) -> None:
    trial = DisturbanceTrial(plan)
    assert trial.close_and_squeeze() is None
    trial.simulation.on_step = partial(Simulation.stop, reason="seen enough")
    fault = trial.hold_for(1.0)
    assert fault is not None
    assert (fault.reason, fault.detail) == ("stopped", "stopped by the caller: seen enough")


# what may drive it


class Limp:
    """Commands nothing, and counts."""

    def __init__(self) -> None:
        """Start at nought."""
        self.steps = 0

    def step(self, observation: Observation) -> FloatArray:
        self.steps += 1
        return np.zeros(16)


def limp(plan: GraspPlan) -> Limp:
    return Limp()


def test_a_controller_is_a_name_an_object_a_class_or_a_function(plan: GraspPlan) -> None:
    own = Limp()
    assert controller_for(plan, own) is own
    for given, kind, name in (
        (None, GraspController, "feedforward"),
        ("feedforward", GraspController, "feedforward"),
        ("impedance", ObjectImpedance, "impedance"),
        (ObjectImpedance, ObjectImpedance, "ObjectImpedance"),
        (limp, Limp, "limp"),
        (partial(ObjectImpedance, mu=0.4), ObjectImpedance, "partial"),
        (own, Limp, "Limp"),
    ):
        assert type(controller_for(plan, given)) is kind
        assert type(controller_maker(given)(plan)) is kind
        assert controller_name(given) == name
    assert isinstance(Simulation(plan, controller="impedance").controller, ObjectImpedance)


def test_what_is_no_controller_is_refused(plan: GraspPlan) -> None:
    with pytest.raises(NotFoundError, match=r"called 'closed'. There is: feedforward, impedance"):
        simulate(plan, controller="closed")
    with pytest.raises(NotFoundError, match="policy:FILE on the command line"):
        simulate(plan, controller="closed")
    for call in (simulate, partial(run_protocol, protocol="forces")):
        with pytest.raises(TaskError, match="controller is 3; give one of feedforward, impedance"):
            call(plan, controller=3)  # type: ignore[arg-type]
        with pytest.raises(TaskError, match="Limp is a class that does not take the plan alone"):
            call(plan, controller=Limp)  # type: ignore[arg-type]
    with pytest.raises(TaskError, match=r"made \[1\] of the plan, which has no method step"):
        simulate(plan, controller=lambda plan: [1])  # type: ignore[arg-type]


def test_every_trial_of_a_protocol_gets_its_own_copy_of_a_controller(plan: GraspPlan) -> None:
    own = Limp()
    report = run_protocol(plan, "shake", controller=own, only=["shake x", "shake y"])
    assert [o.reason for o in report.outcomes] == ["no contact"] * 2
    assert (own.steps, report.controller) == (0, "Limp")


def test_registered_controllers_hold_an_object(plan: GraspPlan) -> None:
    for name in CONTROLLERS:
        trial = DisturbanceTrial(plan, controller=name)
        assert trial.close_and_squeeze() is None
        assert len(hand_contacts(trial.simulation.scene, trial.simulation.data)) >= 3
