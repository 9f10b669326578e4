"""Controllers of manipulations: your own, what they are told, and what their loop is made of."""

from __future__ import annotations

import copy
import math
from dataclasses import replace
from typing import Any, cast

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from manipulations import QUICK, turned_cylinder, turned_cylinder_report

from planner.errors import NotFoundError, TaskError
from planner.motion.manipulation import ManipulationPlan
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray
from sim.contacts.reading import read_pads
from sim.controllers import ImpedanceGains, ObjectImpedance, Observation
from sim.controllers.base import PoseUncertainty
from sim.controllers.impedance import ImpedanceLaw
from sim.manipulation import (
    InHandController,
    ManipulationObservation,
    ManipulationReport,
    ManipulationRun,
    manipulate,
)
from sim.manipulation.driver import ManipulationDriver
from sim.manipulation.in_hand import AnyTurningController, GuidedController
from sim.manipulation.simulation import Reading
from sim.sensing.errors import ERROR_MODELS
from sim.simulation import Simulation

pytestmark = pytest.mark.usefixtures("coarse_steps")


@pytest.fixture(scope="module")
def plan() -> ManipulationPlan:
    return turned_cylinder()


# --- controllers of your own -------------------------------------------------------------------


class Servo:
    """A user's controller: it drives the joints to where the target has them, and presses on."""

    def __init__(self, plan: GraspPlan) -> None:
        """Made for the grasp that the manipulation begins with."""
        self.plan = plan
        self.seen: list[ManipulationObservation] = []

    def step(self, observation: ManipulationObservation) -> FloatArray:
        self.seen.append(observation)
        target, plan = observation.target, self.plan
        if target is None:
            close = observation.progress if observation.phase == "close" else 0.0
            q = plan.q_pregrasp + close * (plan.q - plan.q_pregrasp)
        else:
            q = target.q
        torque = 3.0 * (q - observation.q) - 0.05 * observation.v
        torque += plan.forces.joint_torques if target is not None else 0.0
        ctrl, _ = plan.task.hand.actuation.ctrl_for_torque(observation.q, 0.0 * q, torque)
        return ctrl


@pytest.fixture(scope="module")
def served(plan: ManipulationPlan) -> tuple[Servo, ManipulationReport]:
    """What it is told in a whole run, and the report."""
    mine = Servo(plan.grasp)
    return mine, manipulate(plan, controller=mine, timeline=QUICK)


def test_a_controller_of_your_own_is_told_target_and_schedule(
    plan: ManipulationPlan, served: tuple[Servo, ManipulationReport]
) -> None:
    mine, report = served
    assert report.controller == "Servo"
    phases = [r.phase for r in report.results]
    assert "turn" in phases, str(report)
    n = len(plan.task.fingers)
    for observation in mine.seen:
        assert isinstance(observation, ManipulationObservation)
        before = observation.phase in ("approach", "close")
        assert (observation.target is None) == before
        assert observation.wanted.shape == observation.holding.shape == (n,)
        assert observation.wanted.all() and observation.grip == plan.task.grip_force
        assert observation.phase not in ("open", "retreat"), "the hand opens by itself"
    turning = [o for o in mine.seen if o.phase == "turn"]
    targets = [o.target for o in turning if o.target is not None]
    first, last = targets[0].T_palm_object, targets[-1].T_palm_object
    axis = plan.grasp.T_world_palm.rotation.T @ plan.motion.path.axis
    led = last.rotation @ first.rotation.T
    assert np.arccos((np.trace(led) - 1.0) / 2.0) > math.radians(5.0)
    # the twist of a target is the rate of its pose about the axis of the turn
    spin = max(float(t.twist[3:] @ axis) for t in targets)
    assert 0.3 < spin <= QUICK.turn_rate + 1e-6
    assert turning[-1].holding.all()


@pytest.mark.slow
def test_what_a_controller_of_your_own_misses_slows_the_turn(
    plan: ManipulationPlan, served: tuple[Servo, ManipulationReport]
) -> None:
    class Weak(Servo):
        missed = 0.25

    def fastest(mine: Servo) -> float:
        targets = [o.target for o in mine.seen if o.phase == "turn" and o.target is not None]
        return max(float(np.linalg.norm(target.twist[3:])) for target in targets)

    weak = Weak(plan.grasp)
    manipulate(plan, controller=weak, timeline=QUICK, on_step=until_held)
    assert fastest(weak) < 0.8 * fastest(served[0])


def until_held(simulation: Simulation) -> None:
    """Ends a run once the object is turned."""
    if simulation.phase == "hold":
        simulation.stop("seen enough")


@pytest.mark.slow
def test_a_class_a_function_and_a_name_make_a_controller(plan: ManipulationPlan) -> None:
    made: list[GraspPlan] = []

    class Mine(ObjectImpedance):
        """A subclass of what is there."""

        def __init__(self, grasp: GraspPlan) -> None:
            made.append(grasp)
            super().__init__(grasp, max_normal=12.0)

    def make(grasp: GraspPlan) -> ObjectImpedance:
        return Mine(grasp)

    default = turned_cylinder_report()
    report = manipulate(plan, controller=Mine, timeline=QUICK)
    assert report.success_with_closure, str(report)
    assert report.turned == pytest.approx(default.turned, abs=1e-3)
    for controller, kind in ((make, Mine), ("impedance", ObjectImpedance)):
        given: AnyTurningController = controller
        assert type(ManipulationRun(plan, controller=given).sim.driver.holding) is kind
    assert made == [plan.grasp] * 2
    assert default.controller == "ObjectImpedance"
    # 12 N is what the default may ask of a finger of this plan
    assert report.force_limit == pytest.approx(18.0)


@pytest.mark.slow
def test_a_controller_without_a_loop_is_judged_like_any_other(plan: ManipulationPlan) -> None:
    report = manipulate(plan, controller="feedforward", timeline=QUICK)
    assert report.controller == "GraspController"
    assert [r.phase for r in report.results][:4] == ["stand", "approach", "close", "squeeze"]
    assert not report.success


def test_what_is_no_controller_is_refused_by_name(plan: ManipulationPlan) -> None:
    with pytest.raises(NotFoundError, match="impedanc"):
        manipulate(plan, controller="impedanc")
    wrong: Any = 7
    with pytest.raises(TaskError, match="controller is 7"):
        manipulate(plan, controller=wrong)


def test_commands_of_the_wrong_shape_are_refused(plan: ManipulationPlan) -> None:
    class Short:
        def step(self, observation: Observation) -> FloatArray:
            return np.zeros(3)

    with pytest.raises(TaskError, match=r"commands of shape \(3,\)"):
        manipulate(plan, controller=Short())


def test_the_default_is_an_in_hand_controller(plan: ManipulationPlan) -> None:
    assert isinstance(ObjectImpedance(plan.grasp), InHandController)
    assert not isinstance(Servo(plan.grasp), InHandController)


# --- the loop ----------------------------------------------------------------------------------


@pytest.mark.parametrize("direction", range(6))
def test_a_held_body_comes_back_without_ringing(direction: int) -> None:
    """A body under the impedance that was made for it is critically damped in every direction.

    From rest at x0 it goes as x0 (1 + w t) exp(-w t): half as much damping swings over by 16 %.
    """
    mass, inertia, bandwidth = 0.2, 3e-4, 60.0
    gains = ImpedanceGains.of_body(
        mass=mass, inertia=inertia, bandwidth=bandwidth, learning_rate=0.0
    )
    law, x, v, dt = ImpedanceLaw(gains), 1e-3, 0.0, 1e-4
    moves = mass if direction < 3 else inertia
    for k in range(1000):
        offset = np.zeros(6)
        offset[direction] = x
        pose = SE3(pin.exp3(offset[3:]), offset[:3])
        twist = np.zeros(6)
        twist[direction] = v
        force = law.wrench(SE3.Identity(), pose, twist)[direction]
        v += dt * float(force) / moves
        x += dt * v
        time = (k + 1) * dt
        exact = 1e-3 * (1.0 + bandwidth * time) * math.exp(-bandwidth * time)
        assert x == pytest.approx(exact, abs=1e-5)
        assert x > -1e-6, "it swings over"


def test_a_pad_feels_sliding_along_its_surface_alone(plan: ManipulationPlan) -> None:
    """A pad into which the object is pressed feels no sliding, however fast it comes."""
    simulation = Simulation(plan.grasp, controller="feedforward")
    for phase, duration in (("approach", 0.3), ("close", 0.4), ("squeeze", 0.2)):
        for _ in simulation.run(phase, duration):  # type: ignore[arg-type]
            pass
    scene, fingers = simulation.scene, plan.task.finger_names
    data = copy.copy(simulation.data)
    data.qvel[:] = 0.0
    mujoco.mj_forward(scene.model, data)
    still = read_pads(scene, data, fingers)
    assert (still.normal_force > 0.0).all()
    np.testing.assert_allclose(still.sliding, 0.0, atol=1e-9)
    for i in range(len(fingers)):
        normal = still.normal[i]
        aside = np.cross(normal, [0.0, 0.0, 1.0])
        aside /= np.linalg.norm(aside)
        data.qvel[scene.object_dof[:3]] = -0.05 * normal + 0.01 * aside
        mujoco.mj_forward(scene.model, data)
        sliding = read_pads(scene, data, fingers).sliding[i]
        # 50 mm/s into the pad are none along it
        assert abs(sliding @ normal) < 1e-3
        assert sliding @ aside == pytest.approx(0.01, rel=0.1)
        assert np.linalg.norm(sliding) == pytest.approx(0.01, rel=0.1)


def test_the_hand_stays_open_while_it_retreats(plan: ManipulationPlan) -> None:
    class Holding:
        """What holds the object, and is not to be asked any more."""

        reference: Any = None

        def step(self, observation: Observation) -> FloatArray:
            raise AssertionError(f"asked in the phase {observation.phase}")

    grasp = plan.grasp
    observation = Observation(
        time=1.0,
        phase="open",
        progress=0.0,
        q=grasp.q,
        v=np.zeros_like(grasp.q),
        T_world_base=grasp.T_world_base,
        T_world_object=grasp.task.T_world_object,
        normal_forces=np.zeros(len(grasp.task.fingers)),
        read_twist=lambda: np.zeros(6),
        read_contacts=lambda: grasp.contacts,
    )
    holding: Any = Holding()
    driver = ManipulationDriver(plan, holding, rate=1.0)
    closed = driver.step(observation)
    opened = driver.step(replace(observation, phase="open", progress=1.0))
    assert np.abs(opened - closed).max() > 0.01
    for progress in (0.0, 0.5, 1.0):
        retreating = replace(observation, phase="retreat", progress=progress)
        np.testing.assert_array_equal(driver.step(retreating), opened)


def test_what_a_controller_of_ones_own_lacks_is_told(plan: ManipulationPlan) -> None:
    """The actuators that it names as saturated; none of one that does not say."""

    class Weak:
        """Wants more of one actuator than there is."""

        def step(self, observation: Observation) -> FloatArray:
            return np.zeros(observation.q.shape)

        def saturated_actuators(self) -> tuple[str, ...]:
            return ("thumb_1",)

    class Silent:
        """Says nothing of it."""

        def step(self, observation: Observation) -> FloatArray:
            return np.zeros(observation.q.shape)

    weak: Any = Weak()
    silent: Any = Silent()
    assert GuidedController(plan.grasp, weak).saturated_actuators() == ("thumb_1",)
    assert GuidedController(plan.grasp, silent).saturated_actuators() == ()


@pytest.mark.parametrize(
    ("deviation_deg", "beyond_deg"), [(0.0, 0.5), (0.6, 1.7), (1.0, 2.5), (30.0, 2.5)]
)
def test_the_goal_lies_further_where_the_turn_is_not_known_well(
    plan: ManipulationPlan, deviation_deg: float, beyond_deg: float
) -> None:
    holding: Any = ObjectImpedance(plan.grasp)
    driver = ManipulationDriver(plan, holding, rate=1.0)
    reference = driver.begin_stroke(plan.angle, np.deg2rad(deviation_deg))
    assert np.rad2deg(reference.goal - plan.angle) == pytest.approx(beyond_deg)
    assert holding.reference is reference
    # never beyond what was planned
    whole = driver.begin_stroke(plan.motion.path.angle, np.deg2rad(deviation_deg))
    assert whole.goal == plan.motion.path.angle


@pytest.mark.parametrize("about", [(0.0, 0.0, 1.0), (0.6, 0.0, -0.8)])
def test_the_deviation_that_is_read_is_that_about_the_axis(
    plan: ManipulationPlan, about: tuple[float, float, float]
) -> None:
    axis = np.array(about)
    recorder: Any = None  # knows the truth, which is not asked
    assert Reading(Simulation(plan.grasp), recorder, axis).deviation() == 0.0
    simulation = Simulation(plan.grasp, error_model=ERROR_MODELS["lab"])
    assert simulation.estimator is not None
    tell = simulation.estimator.step
    wide = np.diag([1.0, 1.0, 1.0, 0.01**2, 0.02**2, 0.03**2])

    class Unsure:
        """Tells what the estimator does, and that it knows little."""

        def step(self, observation: Observation) -> Observation:
            uncertainty = PoseUncertainty(covariance=wide, known=True)
            return replace(tell(observation), uncertainty=uncertainty)

    simulation.estimator = cast(Any, Unsure())
    palm = plan.grasp.T_world_palm.rotation  # the joints are read a degree off
    expected = np.linalg.norm(np.array([0.01, 0.02, 0.03]) * (palm @ axis))
    read = Reading(simulation, recorder, axis).deviation()
    assert read == pytest.approx(expected, rel=0.1)
