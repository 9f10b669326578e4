"""What pads feel against the velocities that MuJoCo gives."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from planner.search.grasp import plan_grasp
from planner.task import GraspTask
from sim.contacts import object_contacts
from sim.contacts.reading import read_pads
from sim.simulation import Simulation
from sim.trial import Timeline, Trial


@pytest.fixture(scope="module")
def held() -> Simulation:
    """A box that is held while the hand swings: contacts of several fingers that slide."""
    plan = plan_grasp(GraspTask.create("allegro_hand", "box"), seed=2)
    trial = Trial(plan, timeline=Timeline.quick(hold=0.1))
    rng = np.random.default_rng(0)
    trial.run()
    trial.simulation.data.qvel[:] += 0.3 * rng.normal(size=trial.simulation.scene.model.nv)
    mujoco.mj_forward(trial.simulation.scene.model, trial.simulation.data)
    return trial.simulation


def test_sliding_is_the_relative_velocity_that_mujoco_gives_at_the_contact(
    held: Simulation,
) -> None:
    scene, data, fingers = held.scene, held.data, held.plan.task.finger_names
    pads = read_pads(scene, data, fingers)
    seen = 0
    for k, finger in enumerate(fingers):
        mine = [c for c in object_contacts(scene, data) if scene.finger_of_geom[c[1]] == finger]
        if len(mine) != 1:
            continue
        i, geom, sign = mine[0]
        at, normal = data.contact.pos[i], sign * data.contact.frame[i, :3]
        body = int(scene.model.geom_bodyid[geom])
        slip, turn = np.zeros(3), np.zeros(3)
        for b, way in ((scene.object_body, 1.0), (body, -1.0)):
            twist = np.zeros(6)
            kind = int(mujoco.mjtObj.mjOBJ_XBODY)
            mujoco.mj_objectVelocity(scene.model, data, kind, b, twist, 0)
            slip += way * (twist[3:] + np.cross(twist[:3], at - data.xpos[b]))
            turn += way * twist[:3]
        np.testing.assert_allclose(pads.sliding[k], slip - (slip @ normal) * normal, atol=1e-12)
        assert pads.spin[k] == pytest.approx(turn @ normal, abs=1e-12)
        np.testing.assert_allclose(pads.position[k], at)
        assert np.linalg.norm(slip) > 1e-3
        seen += 1
    assert seen >= 2
