"""Whole trials: success, every way of failing that can be provoked, and the report."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from brief import COARSE
from conftest import PlanOf

from planner.errors import FileFormatError, TaskError
from planner.files import write_plan
from planner.hand_loading import load_hand
from planner.plan import GraspPlan
from planner.quality import analyse
from planner.search.grasp import plan_grasp
from planner.spatial import SE3, FloatArray, minimum_jerk
from planner.task import GraspTask, Obstacle
from sim.contacts import hand_contacts
from sim.controllers import Observation
from sim.protocols import Settings, run_protocol
from sim.report import TrialReport
from sim.report_file import ReportFile
from sim.scene.carrier import Timeline
from sim.scene.physics import PhysicsOptions, named_physics
from sim.simulation import Simulation
from sim.trial import Trial, TrialOptions, simulate
from sim.verdict import Thresholds

pytestmark = pytest.mark.usefixtures("coarse_steps")

QUICK = Timeline(approach=0.3, close=0.3, close_wait=0.2, squeeze=0.2, lift=0.4, hold=0.2)


@pytest.fixture(scope="module")
def plan(plan_of: PlanOf) -> GraspPlan:
    return plan_of("allegro_hand", "sphere")


@pytest.fixture(scope="module")
def report(plan: GraspPlan, tmp_path_factory: pytest.TempPathFactory) -> TrialReport:
    return simulate(plan, picture=tmp_path_factory.mktemp("trial") / "held.png")


@pytest.mark.slow
def test_a_plan_may_be_given_by_its_file(plan: GraspPlan, tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    write_plan(plan, path)
    timeline = replace(QUICK, hold=0.05)
    told = simulate(str(path), timeline=timeline)
    given = simulate(plan, timeline=timeline)
    assert told.samples.moved_mm == pytest.approx(given.samples.moved_mm, abs=1e-6)
    quick = Settings(shake_s=0.05)
    judged = run_protocol(path, "shake", settings=quick, only=("shake x",), workers=1)
    assert judged.outcomes[0].name == "shake x" and judged.outcomes[0].held
    with pytest.raises(FileFormatError):
        simulate(tmp_path / "none.json")


def test_the_object_is_held(report: TrialReport) -> None:
    assert report.success, report.verdict.detail
    assert report.reason == ""
    millimetres, degrees = report.largest_slip
    assert 0 < millimetres < 1
    assert 0 < degrees < 2
    assert report.samples.lift_mm[-1] == pytest.approx(100, abs=2)


def test_measured_contacts_are_the_planned_ones(report: TrialReport, plan: GraspPlan) -> None:
    assert [c.finger for c in report.comparison] == list(plan.task.finger_names)
    for c in report.comparison:
        error = np.linalg.norm(c.measured_position - c.planned_position)
        assert c.position_error_mm == pytest.approx(1e3 * error)
        assert c.position_error_mm < 1.5
        assert c.force_error_percent < 20
        assert abs(c.measured_normal_force - c.planned_normal_force) <= c.force_error_N + 1e-9


def test_the_same_analysis_judges_plan_and_execution(report: TrialReport) -> None:
    assert report.quality_measured is not None
    assert report.quality_measured.closure.closed
    assert report.quality_measured.n_contacts == len(report.fingers)
    # Both have the plan's friction, and contacts are within a millimetre of the planned ones.
    planned = report.quality_planned.epsilon
    assert report.quality_measured.epsilon == pytest.approx(planned, rel=0.05)


def test_a_report_says_at_which_friction_its_contacts_were_analysed(
    report: TrialReport, plan: GraspPlan
) -> None:
    contacts, physics_mu = report.contacts_measured, report.physics["mu"]
    assert contacts is not None
    assert report.quality_measured is not None
    assert report.quality_mu == plan.task.mu == 0.5
    assert contacts.mu == pytest.approx(np.full(len(contacts), physics_mu))
    assert physics_mu == 0.6
    length = plan.task.object.shape.bounding_radius
    same = contacts.with_friction(report.quality_mu, plan.task.mu_torsion)
    at_the_plans = analyse(same, length=length).epsilon
    at_its_own = analyse(contacts, length=length).epsilon
    assert report.quality_measured.epsilon == pytest.approx(at_the_plans)
    assert at_its_own > 1.1 * at_the_plans
    assert report.to_dict()["quality_mu"] == 0.5


def test_samples_over_time(report: TrialReport) -> None:
    s = report.samples
    assert np.diff(s.time) == pytest.approx(0.02)
    hold = s.during("hold")
    assert len(hold) == 100
    assert s.closed[hold].all()
    assert s.closed_unmerged[hold].all()
    assert (s.epsilon[hold] > 0).all()
    assert (s.friction_utilisation[hold] <= 1 + 1e-6).all()
    approach = s.during("approach")
    assert (s.contacts[approach] == 0).all()
    assert not s.closed[approach].any()
    assert np.isnan(s.slip_mm[s.during("approach", "close", "squeeze")]).all()
    assert np.isfinite(s.slip_mm[s.during("settle", "lift", "hold")]).all()


def test_contact_forces_carry_the_object(plan: GraspPlan) -> None:
    """Sum of contact forces = m (a - g) at every moment of the hold, by MuJoCo's own qacc."""
    errors = []

    def look(simulation: Simulation) -> None:
        if simulation.phase == "hold":
            scene, data = simulation.scene, simulation.data
            wrench = hand_contacts(scene, data).wrench()
            acceleration = data.qacc[scene.object_dof[:3]] - plan.task.gravity
            errors.append(np.abs(wrench[:3] - plan.task.object.mass * acceleration).max())

    simulate(plan, timeline=QUICK, on_step=look)
    assert len(errors) == round(QUICK.hold / COARSE.timestep)
    assert max(errors) < 0.01


def test_report_is_plain_json_that_follows_its_schema(report: TrialReport) -> None:
    data = report.to_dict()
    text = json.dumps(data, allow_nan=False)
    read = ReportFile.model_validate(json.loads(text))
    assert (read.format, read.version) == ("opposable-report", 4)
    assert read.success
    assert read.physics["mu"] == 0.6
    assert read.timeline["hold"] == 2.0
    assert read.thresholds["slip_mm"] == 5.0
    over_time = read.samples.model_dump()
    assert len(over_time["time_s"]) == len(report.samples)
    assert over_time["object_in_palm_moved_mm"][0] is None


def test_files_that_were_written_with_older_names_are_read(report: TrialReport) -> None:
    old = report.to_dict()
    old["carried_by"] = "mount"
    old["thresholds"]["limited_share"] = old["thresholds"].pop("saturated_share")
    read = ReportFile.model_validate(old)
    assert (read.carried_by, read.thresholds["limited_share"]) == ("mount", 0.5)


def test_picture_is_there_or_its_absence_is_explained(report: TrialReport, can_draw: bool) -> None:
    assert (report.picture is not None) == can_draw
    assert bool(report.picture_reason) != can_draw
    if report.picture is not None:
        assert report.picture.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


def explained(report: TrialReport) -> str:
    return " ".join(" ".join(str(line) for line in report.details()).split())


def test_a_repr_is_one_short_line(report: TrialReport) -> None:
    for thing in (report, report.plan, report.quality_planned, report.contacts_measured):
        assert len(repr(thing)) <= 200
        assert "\n" not in repr(thing)


def test_physics_go_by_name(plan: GraspPlan) -> None:
    named = Trial(plan, physics="menagerie").simulation.scene.physics
    assert named == named_physics("menagerie")
    wrong: Any = 3
    with pytest.raises(TaskError, match="physics is 3; give a PhysicsOptions, one of ours"):
        Trial(plan, physics=wrong)


def test_options_are_passed_whole_and_keywords_change_them(plan: GraspPlan) -> None:
    options = TrialOptions(physics="menagerie", timeline=QUICK, record_every=0.05)
    trial = Trial(plan, options, record_every=0.01)
    assert trial.simulation.scene.physics == named_physics("menagerie")
    assert (trial.timeline, trial.recorder.every) == (QUICK, 0.01)
    assert options.record_every == 0.05
    with pytest.raises(TaskError, match="record_every"):
        TrialOptions(record_every=0.0)


@pytest.mark.slow
def test_a_grasp_that_slid_along_is_another_grasp(plan: GraspPlan) -> None:
    """A plan whose contacts are told 7 mm off is executed by the same fingers: held, elsewhere."""
    positions = plan.contacts.positions.copy()
    tangent = plan.contacts.frames[0, :, 1]
    positions[0] += 7e-3 * tangent
    told = replace(plan, contacts=replace(plan.contacts, positions=positions))
    report = simulate(told, timeline=QUICK)
    assert report.success and not report.as_planned
    assert report.verdict.outcome == "held, another grasp"
    assert report.fingers[0] in report.verdict.other_grasp
    assert " 7 mm " in report.verdict.other_grasp
    assert "another grasp" in str(report).splitlines()[0]
    assert report.to_file().other_grasp == report.verdict.other_grasp
    strict = Thresholds(contact_mm=8.0)
    assert simulate(told, timeline=QUICK, thresholds=strict).as_planned


@pytest.mark.slow
def test_a_report_prints_as_a_screen(report: TrialReport, plan: GraspPlan) -> None:
    """Whether it was held, and if not why; no dump of arrays."""
    held = str(report)
    assert len(held) < 3000
    assert "held: the object moved" in held.splitlines()[0]
    assert all(name in held for name in report.fingers)
    assert "100 of 100 samples" in explained(report)
    assert "100 of 100 samples" not in held
    slippery = PhysicsOptions(mu=0.02, mu_torsion=0.0)
    failed = simulate(plan, timeline=QUICK, physics=slippery, controller="impedance")
    text = " ".join(str(failed).split())
    assert len(text) < 3000
    assert f"not held, {failed.reason}: {failed.verdict.detail}" in text
    # how many events there are depends on the grasp; of more than eight the first eight are told
    event = failed.events[0]
    for n, rest in ((8, None), (9, "and 1 more events"), (20, "and 12 more events")):
        events = tuple(replace(event, time=100.0 + k) for k in range(n))
        text = explained(replace(failed, events=events))
        assert len(text) < 3000
        assert [f"{e.time:.3f} s: {e.kind}" in text for e in events] == [k < 8 for k in range(n)]
        assert rest in text if rest else "more events" not in text


def test_a_plan_prints_as_a_screen(plan: GraspPlan) -> None:
    text = str(plan)
    assert len(text) < 3000
    assert "allegro_hand grasps sphere:0.035 (100 g), seed 0: found at attempt" in text
    assert "force closure yes, epsilon" in text
    assert [line.split()[0] for line in text.splitlines()[2:-1]] == list(plan.task.finger_names)


def test_the_same_trial_twice_gives_the_same_numbers(plan: GraspPlan) -> None:
    first, second = (simulate(plan, timeline=QUICK).samples for _ in range(2))
    np.testing.assert_array_equal(first.normal_force, second.normal_force)
    np.testing.assert_array_equal(first.slip_mm, second.slip_mm)


def test_without_friction_the_object_is_not_held(plan: GraspPlan) -> None:
    failed = simulate(plan, timeline=QUICK, physics=PhysicsOptions(mu=0.02, mu_torsion=0.0))
    assert not failed.success
    assert failed.reason in ("slipped", "dropped", "tipped", "no contact")
    assert failed.verdict.detail
    json.dumps(failed.to_dict(), allow_nan=False)


class Still:
    """Keeps the fingers at the pre-grasp, or does something wrong."""

    def __init__(self, plan: GraspPlan, value: Any = None) -> None:
        """Keep what to return, if it is not to be still."""
        self.plan, self.value, self.seen = plan, value, list[Observation]()

    def step(self, observation: Observation) -> FloatArray:
        self.seen.append(observation)
        if self.value is not None:
            return np.array(self.value)
        hand = self.plan.task.hand
        zero = np.zeros(hand.nq)
        return hand.actuation.ctrl_for_torque(self.plan.q_pregrasp, zero, zero)[0]


def test_users_controller_takes_part_and_fingers_that_never_close_touch_nothing(
    plan: GraspPlan,
) -> None:
    controller = Still(plan)
    failed = simulate(plan, controller=controller, timeline=QUICK)
    assert failed.reason == "no contact"
    assert all(name in failed.verdict.detail for name in plan.task.finger_names)
    assert failed.simulated_s < QUICK.duration  # given up before the lift
    assert len(controller.seen) == round(failed.simulated_s / COARSE.timestep)
    phases = [o.phase for o in controller.seen]
    assert list(dict.fromkeys(phases)) == ["approach", "close", "squeeze", "settle"]
    last = controller.seen[-1]
    assert len(last.contacts) == 0
    np.testing.assert_allclose(last.q, plan.q_pregrasp, atol=0.1)
    assert last.T_world_base.isApprox(plan.T_world_base, 1e-3)


@pytest.mark.parametrize(("mu_torsion", "needed"), [(0.0, 3), (0.004, 2)])
def test_soft_fingers_without_torsion_are_counted_as_points(
    plan: GraspPlan, mu_torsion: float, needed: int
) -> None:
    task = replace(plan.task, contact_model="soft", mu_torsion=mu_torsion)
    assert task.fingers_needed == needed
    failed = simulate(replace(plan, task=task), controller=Still(plan), timeline=QUICK)
    assert f"{needed} fingers are needed" in failed.verdict.detail


def test_commands_of_a_wrong_shape_are_refused(plan: GraspPlan) -> None:
    with pytest.raises(TaskError, match=r"shape \(3,\); the hand needs \(16,\)"):
        simulate(plan, controller=Still(plan, [0.0, 0.0, 0.0]), timeline=QUICK)


def test_commands_that_are_not_numbers_end_the_trial(plan: GraspPlan) -> None:
    failed = simulate(plan, controller=Still(plan, [np.nan] * 16), timeline=QUICK)
    assert failed.reason == "diverged"
    assert "commands" in failed.verdict.detail


@pytest.mark.parametrize("beyond", [-0.01, 0.01])
def test_actuators_at_their_limit_are_recorded_for_any_controller(
    plan: GraspPlan, beyond: float
) -> None:
    """Just inside the control range it is the force that is clipped, beyond it the command."""
    high = plan.task.hand.actuation.ctrl_range[:, 1]
    timeline = replace(QUICK, approach=0.05, close=0.02, squeeze=0.02, settle=0.02)
    pushed = simulate(plan, controller=Still(plan, high + beyond), timeline=timeline)
    assert set(pushed.samples.saturated[0]) <= set(plan.task.hand.actuation.names)
    assert len(pushed.samples.saturated[0]) >= 12  # of 16; a moving joint may be below its limit


def test_interruption_gives_a_partial_report(plan: GraspPlan) -> None:
    def stop(share: float) -> None:
        if share > 0.5:
            raise KeyboardInterrupt

    partial = simulate(plan, timeline=QUICK, progress=stop)
    assert partial.reason == "interrupted"
    assert 0.4 * QUICK.duration < partial.simulated_s < 0.7 * QUICK.duration
    assert len(partial.samples) > 10
    json.dumps(partial.to_dict(), allow_nan=False)


def test_a_plan_without_forces_is_not_executed(plan: GraspPlan) -> None:
    class Nothing:
        found, reason = False, "the friction cones do not reach"

    refused = simulate(replace(plan, forces=Nothing()))  # type: ignore[arg-type]
    assert refused.reason == "infeasible forces"
    assert refused.verdict.detail == "the friction cones do not reach"
    assert len(refused.samples) == 0
    json.dumps(refused.to_dict(), allow_nan=False)


def test_an_obstacle_in_the_way_is_hit(plan: GraspPlan) -> None:
    state = plan.T_world_palm.translation
    wall = Obstacle(
        name="wall",
        size=np.array([0.05, 0.05, 0.02]),
        T_world_obstacle=SE3(np.eye(3), state + np.array([0.0, 0.0, 0.0])),
    )
    blocked = replace(plan, task=replace(plan.task, obstacles=(wall,)))
    failed = simulate(blocked, timeline=QUICK)
    assert failed.reason == "hand collided"
    assert "wall" in failed.verdict.detail


@pytest.mark.parametrize(
    ("attribute", "value"), [("forcerange", "-0.02 0.02"), ("ctrlrange", "0 0.3")]
)
def test_a_hand_too_weak_for_the_plan_reaches_its_torque_limit(
    plan: GraspPlan, tmp_path: Path, attribute: str, value: str
) -> None:
    """The plan of the true hand on a copy whose thumb is weak or whose commands are clipped."""
    assert plan.task.hand.path is not None
    shutil.copytree(plan.task.hand.path.parent, tmp_path / "hand")
    model = tmp_path / "hand" / plan.task.hand.description.model
    spec = mujoco.MjSpec.from_file(str(model))
    for actuator in spec.actuators:
        if "thumb" in actuator.name:
            setattr(actuator, attribute, [float(v) for v in value.split()])
    model.write_text(spec.to_xml())
    weak = replace(plan, task=replace(plan.task, hand=load_hand(tmp_path / "hand")))
    failed = simulate(weak, timeline=QUICK)
    assert failed.reason == "torque limit reached", failed.verdict.detail
    assert "thumb" in failed.verdict.detail


def test_the_hand_follows_its_way(plan: GraspPlan) -> None:
    """Base on its straight line within 2.5 mm; without feed-forward of speed it would lag 10.

    At 0.75 m/s, the peak of this hurried approach, that is 3 ms.
    """
    off = dict.fromkeys(("approach", "lift"), 0.0)

    def look(simulation: Simulation) -> None:
        if simulation.phase in off:
            data, first = simulation.data, simulation.scene.T_world_base.translation
            now = data.time - simulation.scene.physics.timestep  # poses are of the step's beginning
            base = simulation.scene.body_pose(data, simulation.scene.base_body).translation
            if simulation.phase == "approach":
                s = minimum_jerk(np.array(min(1.0, now / QUICK.approach)))
                start = plan.T_world_base_start.translation
                expected = start + s * (first - start)
            else:
                began.append(float(now))
                s = minimum_jerk(np.array(min(1.0, (now - began[0]) / QUICK.lift)))
                expected = first + np.array([0.0, 0.0, float(s) * QUICK.lift_height])
            off[simulation.phase] = max(off[simulation.phase], float(np.abs(base - expected).max()))

    began: list[float] = []
    simulate(plan, timeline=QUICK, on_step=look)
    assert off["approach"] < 2.5e-3
    assert off["lift"] < 2.5e-3


def test_an_object_put_elsewhere_is_missed_or_disturbed(plan: GraspPlan) -> None:
    """A trial does not believe the plan: it looks at what MuJoCo reports."""
    trial = Trial(plan, timeline=QUICK)
    trial.simulation.data.qpos[trial.simulation.scene.object_qpos[0]] += 0.5
    failed = trial.run()
    assert failed.reason in ("no contact", "tipped")


def test_object_without_table_is_supported_until_the_lift() -> None:
    pose = SE3(np.eye(3), np.array([0.0, 0.0, 0.5]))
    task = GraspTask.create("allegro_hand", "sphere", table_height=None, T_world_object=pose)
    report = simulate(plan_grasp(task), timeline=QUICK)
    assert report.supported
    assert report.success, report.verdict.detail


@pytest.mark.parametrize(
    ("options", "message"),
    [({"lift": 0.0}, "lift is 0.0"), ({"hold": float("nan")}, "hold is nan")],
)
def test_timeline_refuses_what_cannot_be(options: dict[str, float], message: str) -> None:
    with pytest.raises(TaskError, match=message):
        Timeline(**options)


def test_record_every_must_be_positive(plan: GraspPlan) -> None:
    with pytest.raises(TaskError, match=r"record_every, .*, is 0"):
        Trial(plan, record_every=0.0)


def test_viewer_without_a_display_says_so(plan: GraspPlan, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(TaskError, match="no display"):
        simulate(plan, timeline=QUICK, view=True)


def test_progress_is_told_with_every_sample(plan: GraspPlan) -> None:
    told: list[float] = []
    report = simulate(plan, timeline=QUICK, progress=told.append)
    assert told == sorted(told) and told[-1] <= 1.0
    assert len(told) == pytest.approx(len(report.samples), abs=1)
