"""Recorded states: those that MuJoCo had, read by anybody, and a run that is the same without."""

from __future__ import annotations

import json
import os
import pickle
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from conftest import PlanOf
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.errors import FileFormatError
from planner.kinematics import HandState
from planner.plan import GraspPlan
from planner.quality import force_closure
from planner.spatial import SE3, FloatArray, pose_from_wxyz
from planner.system.threads import interrupts_wait
from sim.contacts import ContactHistory, hand_contacts, merge_per_finger
from sim.recorder import StateRecorder
from sim.recording import PALM, Recording, RecordingData
from sim.report import TrialReport
from sim.report_file import ReportFile, read_report, write_report
from sim.scene.carrier import Timeline
from sim.scene.physics import PhysicsOptions
from sim.simulation import Simulation
from sim.trial import Trial, simulate

pytestmark = pytest.mark.usefixtures("coarse_steps")

QUICK = Timeline(approach=0.2, close=0.3, close_wait=0.2, squeeze=0.2, lift=0.3, hold=0.2)


def pose_of(row: FloatArray) -> SE3:
    return pose_from_wxyz(row[:3], row[3:])


class Witness:
    """What MuJoCo says of every sample: poses by its own kinematics of the same joints."""

    def __init__(self) -> None:
        """Start empty."""
        self.samples: list[dict[str, Any]] = []

    def __call__(self, simulation: Simulation) -> None:
        if not simulation.due(0.02):
            return
        scene, data = simulation.scene, simulation.data
        copy = mujoco.MjData(scene.model)
        copy.qpos = data.qpos
        mujoco.mj_kinematics(scene.model, copy)
        hand = simulation.plan.task.hand
        self.samples.append(
            {
                "time": data.time,
                "q": data.qpos[scene.hand_qpos].copy(),
                "base": scene.body_pose(copy, scene.base_body),
                "palm": scene.body_pose(copy, scene.palm_body),
                "object": scene.body_pose(copy, scene.object_body),
                "bodies": {
                    name: copy.xpos[scene.model.body(f"hand/{name}").id].copy()
                    for name in hand.finger_of_body
                },
                "commands": data.ctrl[scene.hand_ctrl].copy(),
                "contacts": merge_per_finger(hand_contacts(scene, data)),
            }
        )


@pytest.fixture(scope="module", params=["allegro_hand", "allegro_on_arm7"])
def plan(request: pytest.FixtureRequest, plan_of: PlanOf) -> GraspPlan:
    return plan_of(request.param, "box")


@pytest.fixture(scope="module")
def seen(plan: GraspPlan) -> tuple[TrialReport, list[dict[str, Any]]]:
    """A trial, and what MuJoCo said at its samples."""
    witness = Witness()
    report = simulate(plan, timeline=QUICK, on_step=witness)
    return report, witness.samples


def test_states_are_those_of_the_simulator_at_the_same_times(
    seen: tuple[TrialReport, list[dict[str, Any]]],
) -> None:
    report, samples = seen
    recording = report.recording
    assert len(recording) == len(samples) == len(report.samples) > 50
    assert recording.phase == report.samples.phase
    for i, said in enumerate(samples):
        assert recording.time[i] == said["time"] == report.samples.time[i]
        np.testing.assert_array_equal(recording.q[i], said["q"])
        np.testing.assert_array_equal(recording.commands[i], said["commands"])
        assert pose_of(recording.T_world_base[i]).isApprox(said["base"], 1e-9), i
        assert pose_of(recording.T_world_object[i]).isApprox(said["object"], 1e-9), i


def test_the_base_moves_as_a_gantry_and_stands_on_an_arm(
    seen: tuple[TrialReport, list[dict[str, Any]]], plan: GraspPlan
) -> None:
    """The test above would pass if nothing moved."""
    base, q = seen[0].recording.T_world_base, seen[0].recording.q
    moved = float(np.ptp(base[:, :3], axis=0).max())
    if plan.task.hand.arm is None:
        assert moved > 0.05
    else:
        assert moved == 0.0
        assert np.ptp(q[:, plan.task.hand.arm_index], axis=0).max() > 0.05


def test_pinocchio_finds_the_palm_where_mujoco_has_it(
    seen: tuple[TrialReport, list[dict[str, Any]]], plan: GraspPlan
) -> None:
    report, samples = seen
    for i in range(0, len(samples), 10):
        base = pose_of(report.recording.T_world_base[i])
        palm = base * HandState(plan.task.hand, report.recording.q[i]).T_base_palm
        assert palm.isApprox(samples[i]["palm"], 1e-8), i


def test_contacts_are_those_of_the_step_with_their_forces(
    seen: tuple[TrialReport, list[dict[str, Any]]],
) -> None:
    report, samples = seen
    recording, touched = report.recording, 0
    for i, said in enumerate(samples):
        contacts = said["contacts"]
        columns = [recording.contact_names.index(f or PALM) for f in contacts.fingers]
        assert np.isfinite(recording.points[i, :, 0]).sum() == len(contacts)
        np.testing.assert_allclose(recording.points[i, columns], contacts.positions)
        np.testing.assert_allclose(recording.normals[i, columns], contacts.normals)
        np.testing.assert_allclose(recording.forces[i, columns], contacts.forces_in_axes())
        touched += len(contacts)
    assert touched > 100
    hold = report.samples.during("hold")
    normal = np.einsum("mkj,mkj->mk", recording.forces, recording.normals)[hold]
    n = len(report.fingers)
    np.testing.assert_allclose(normal[:, :n], report.samples.normal_force[hold])


def test_min_weight_is_that_of_the_contacts_and_agrees_with_closure(
    seen: tuple[TrialReport, list[dict[str, Any]]],
) -> None:
    report, samples = seen
    weight = report.recording.min_weight
    sign_of_closure = weight > 1e-6
    np.testing.assert_array_equal(sign_of_closure, report.samples.closed)
    last = samples[-1]["contacts"]
    assert weight[-1] == pytest.approx(force_closure(last, 8).normalised_min_weight, rel=0.05)
    assert weight[0] == -np.inf


def test_recording_does_not_change_the_run(
    plan: GraspPlan, seen: tuple[TrialReport, list[dict[str, Any]]], monkeypatch: Any
) -> None:
    monkeypatch.setattr(StateRecorder, "take", lambda *_: None)
    monkeypatch.setattr(StateRecorder, "recording", lambda *_: None)
    bare = simulate(plan, timeline=QUICK)
    assert getattr(bare, "recording") is None  # noqa: B009  by type it is never None
    for name in ("normal_force", "slip_mm", "moved_mm", "lift_mm", "epsilon"):
        np.testing.assert_array_equal(
            getattr(bare.samples, name), getattr(seen[0].samples, name), err_msg=name
        )


# --- files -------------------------------------------------------------------------------------


@st.composite
def recordings(draw: Callable[..., Any]) -> Recording:
    """Recordings of any size, with missing contacts and unlimited actuators."""
    m, nq, nu, k = (draw(st.integers(low, 4)) for low in (0, 1, 1, 1))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    missing = rng.random((m, k)) < 0.4
    points, normals, forces = rng.normal(size=(3, m, k, 3)) * 10.0 ** rng.integers(-3, 3)
    friction = rng.random((m, k, 2))
    for values in (points, normals, forces, friction):
        values[missing] = np.nan
    limits = np.sort(rng.normal(size=(nu, 2)), axis=1)
    limits[rng.random((nu, 2)) < 0.3] = np.nan
    limits = np.where(np.isnan(limits), [-np.inf, np.inf], limits)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return Recording(
        joint_names=tuple(f"joint {i}" for i in range(nq)),
        actuator_names=tuple(f"motor {i}" for i in range(nu)),
        control_range=limits,
        contact_names=tuple(f"finger {i}" for i in range(k)),
        time=np.cumsum(rng.random(m)),
        phase=tuple("hold" for _ in range(m)),
        q=rng.normal(size=(m, nq)),
        T_world_base=rng.normal(size=(m, 7)),
        T_world_object=rng.normal(size=(m, 7)),
        points=points,
        normals=normals,
        forces=forces,
        friction=friction,
        commands=rng.normal(size=(m, nu)),
    )


@settings(max_examples=60, deadline=None)
@given(recordings())
def test_a_recording_comes_back_from_json_within_its_rounding(recording: Recording) -> None:
    text = json.dumps(recording.to_dict(), allow_nan=False)
    read = Recording.from_data(RecordingData.model_validate(json.loads(text)))
    for name in ("joint_names", "actuator_names", "contact_names", "phase"):
        assert getattr(read, name) == getattr(recording, name)
    np.testing.assert_array_equal(read.control_range, recording.control_range)
    for name, off in (
        ("time", 1e-6),
        ("q", 1e-5),
        ("T_world_base", 1e-6),
        ("T_world_object", 1e-6),
        ("points", 1e-6),
        ("normals", 1e-5),
        ("forces", 1e-3),
        ("friction", 1e-6),
        ("commands", 1e-5),
        ("min_weight", 1e-6),
    ):
        np.testing.assert_allclose(
            getattr(read, name), getattr(recording, name), rtol=0, atol=0.51 * off, err_msg=name
        )
    assert read.to_dict() == recording.to_dict()  # what is rounded stays as it is


def test_a_report_is_read_as_it_was_written(
    seen: tuple[TrialReport, list[dict[str, Any]]], tmp_path: Path
) -> None:
    report, _ = seen
    write_report(report.to_dict(), tmp_path / "report.json")
    read = read_report(tmp_path / "report.json")
    assert read == report.to_file()
    assert read.plan is not None and read.plan["format"] == "opposable-plan"
    bare = ReportFile.model_validate(report.to_dict(states=False))
    assert (bare.plan, bare.recording) == (None, None)


def test_a_report_comes_back_from_another_process(
    seen: tuple[TrialReport, list[dict[str, Any]]],
) -> None:
    report, _ = seen
    back: TrialReport = pickle.loads(pickle.dumps(report))
    assert np.array_equal(back.plan.q, report.plan.q)
    assert back.plan.task.hand.digest == report.plan.task.hand.digest
    assert back.to_dict()["recording"] == report.to_dict()["recording"]
    assert back.verdict == report.verdict


def version_1(report: TrialReport) -> dict[str, Any]:
    """The report as it was written before there were states."""
    data = report.to_dict()
    for name in ("plan", "recording", "command"):
        del data[name]
    return data | {"version": 1}


def test_a_file_of_version_1_is_read_without_states(
    seen: tuple[TrialReport, list[dict[str, Any]]], tmp_path: Path
) -> None:
    write_report(version_1(seen[0]), tmp_path / "old.json")
    read = read_report(tmp_path / "old.json")
    assert (read.version, read.plan, read.recording, read.command) == (4, None, None, "")
    assert read.samples == seen[0].to_file().samples


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"version": 5}, "has report version 5"),
        ({"format": "opposable-plan"}, "is not a report file: its format is 'opposable-plan'"),
        ({"seed": None}, "is damaged: seed"),
        ({"recording": {"time_s": []}}, "is damaged: recording"),
        ({"fingers": 3}, "is damaged: fingers"),
    ],
)
def test_a_damaged_or_foreign_report_is_refused_in_one_line(
    change: dict[str, Any],
    words: str,
    seen: tuple[TrialReport, list[dict[str, Any]]],
    tmp_path: Path,
) -> None:
    write_report(seen[0].to_dict() | change, tmp_path / "r.json")
    with pytest.raises(FileFormatError, match=words) as caught:
        read_report(tmp_path / "r.json")
    assert "\n" not in str(caught.value)


def test_channels_of_different_lengths_are_refused(
    seen: tuple[TrialReport, list[dict[str, Any]]], tmp_path: Path
) -> None:
    data = seen[0].to_dict()
    data["samples"]["epsilon"].pop()
    write_report(data, tmp_path / "r.json")
    with pytest.raises(FileFormatError, match="channels over time have different lengths"):
        read_report(tmp_path / "r.json")


def test_rows_of_different_lengths_are_refused(
    seen: tuple[TrialReport, list[dict[str, Any]]],
) -> None:
    data = seen[0].recording.to_dict()
    data["q_rad"][3] = data["q_rad"][3][:-1]
    with pytest.raises(FileFormatError, match="rows differ in length"):
        Recording.from_data(RecordingData.model_validate(data))


def test_recordings_are_joined_on_one_axis(
    seen: tuple[TrialReport, list[dict[str, Any]]],
) -> None:
    first = seen[0].recording
    end = float(first.time[-1])
    both = first.joined(first.with_columns((*first.contact_names, "extra")), end)
    m = len(first)
    assert both.contact_names == (*first.contact_names, "extra")
    assert (np.diff(both.time) > 0).all() and both.time[-1] == 2 * end
    np.testing.assert_array_equal(both.q[m:], first.q)
    np.testing.assert_array_equal(both.points[:m, :-1], first.points)
    assert np.isnan(both.points[:, -1]).all()
    np.testing.assert_array_equal(both.min_weight, np.tile(first.min_weight, 2))


def test_a_lost_object_is_recorded_to_the_end(plan: GraspPlan) -> None:
    report = simulate(plan, timeline=QUICK, physics=PhysicsOptions(mu=0.02))
    assert not report.success
    assert report.recording.time[-1] >= report.verdict.time


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="SIGINT to one process is a matter of POSIX")
@pytest.mark.parametrize("before", [StateRecorder.take, ContactHistory.note])
def test_ctrl_c_within_a_sample_waits_for_its_end(
    monkeypatch: pytest.MonkeyPatch, plan: GraspPlan, before: Callable[..., None]
) -> None:
    trial, calls = Trial(plan, timeline=QUICK), 0

    def interrupted(*args: Any) -> None:
        nonlocal calls
        calls += 1
        if calls == 5:
            os.kill(os.getpid(), signal.SIGINT)
        before(*args)

    owner = StateRecorder if before is StateRecorder.take else ContactHistory
    monkeypatch.setattr(owner, before.__name__, interrupted)
    report = trial.run()
    assert report.reason == "interrupted"
    recording = trial.recorder.recording()
    assert len(recording) == len(trial.recorder.samples()) == 5


def test_an_interrupt_is_heard_after_the_lines_and_others_get_it_again() -> None:
    order: list[str] = []
    first = signal.signal(signal.SIGTERM, lambda *_: order.append("heard"))
    try:
        with interrupts_wait():
            signal.raise_signal(signal.SIGTERM)
            order.append("inside")
        order.append("after")
        signal.raise_signal(signal.SIGTERM)
    finally:
        signal.signal(signal.SIGTERM, first)
    assert order == ["inside", "heard", "after", "heard"]
