"""POMDAR's screw without its checkout: a scene of ours in its place, put together as its own is."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from benchmarks import pomdar
from planner.errors import FileFormatError, NotFoundError, TaskError
from planner.hand_loading import load_hand
from sim.foreign import ForeignScene

LAUNCHER = '''
import nothing_that_is_installed

SCENE_TEMPLATE = """<mujoco><compiler angle="radian" autolimits="true"/>
<include file="hand/orca_v1.xml"/><include file="{task_rel}"/>
<option cone="elliptic" impratio="10"/>
<worldbody><body name="hand_mocap" mocap="true" pos="0.3 0 0.3"/></worldbody>
<equality><weld body1="hand_mocap" body2="root"/></equality></mujoco>"""
'''

SCREW = """<mujoco><worldbody><body name="bolt_body" pos="0 0 0.1276">
<joint name="bolt_slide" type="slide" axis="0 0 -1" range="0 0.04"/>
<joint name="bolt_hinge" type="hinge" axis="0 0 1" range="-62.83 0" damping="0.00005"/>
<geom type="cylinder" size="0.0064 0.004" pos="0 0 0.004" mass="0.055"/></body></worldbody>
<actuator><motor name="slide_bolt_motor" joint="bolt_slide" ctrlrange="-50 50"/></actuator>
</mujoco>"""


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A checkout with a launcher and one task, and without the hand."""
    (tmp_path / "sim/tasks").mkdir(parents=True)
    (tmp_path / "sim/launch_mujoco_orca.py").write_text(LAUNCHER)
    (tmp_path / "sim/tasks/C1_Thread.xml").write_text(SCREW)
    return tmp_path


def test_a_stroke_turns_the_screw_and_its_thread_takes_it_down(checkout: Path) -> None:
    trial = pomdar._Screwing(checkout / "sim", load_hand("allegro_hand"), seed=1)
    palm = trial.scene.pose(trial.model.body("robot/palm").id)
    assert np.allclose(palm.translation, pomdar.PALM)
    assert palm.rotation[2] @ trial.hand.palm_normal == pytest.approx(-1.0)
    plan = trial.plan()
    trial.bring(plan.grasp, trial.run(plan.grasp, trial._driver(plan)))
    assert abs(trial.turned) < 0.5, "nothing touches it on the way"
    trial.stroke(plan)
    assert 40.0 < trial.turned < 75.0
    sank = float(trial._slide.qpos[0]) - trial._begun
    assert sank == pytest.approx(pomdar.LEAD * trial.turned / 360.0, abs=2e-4)
    assert not trial.hit


def test_a_bolt_on_joints_is_refused_unless_it_is_named_so(checkout: Path) -> None:
    model = pomdar.scene_of(checkout / "sim", "C1_Thread", load_hand("allegro_hand"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    with pytest.raises(TaskError, match=r"no free joint.*or say jointed=True"):
        ForeignScene(model, data, "allegro_hand", "bolt_body", prefix="robot/")
    scene = ForeignScene(model, data, "allegro_hand", "bolt_body", prefix="robot/", jointed=True)
    assert scene.object.mass == pytest.approx(0.055)
    seen = scene.for_task(scene.task(fingers=("thumb", "index", "middle")), 0.002)
    assert seen.object_dof.tolist() == [0, 1]


def test_another_folder_and_another_task_are_named(checkout: Path) -> None:
    with pytest.raises(FileFormatError, match="no checkout of pomdar_benchmark"):
        list(pomdar.cases(pomdar.Options(scene=checkout / "sim")))
    with pytest.raises(NotFoundError, match="Did you mean 'C1_Thread'"):
        list(pomdar.cases(pomdar.Options(scene=checkout, tasks="C1_Tread")))
    with pytest.raises(NotFoundError, match=r"fingers for the screw.*allegro_hand_left"):
        list(pomdar.cases(pomdar.Options(scene=checkout, hands=["allegro_hand_left"])))
