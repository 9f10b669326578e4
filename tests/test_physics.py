"""Named physics, files of physics, and the creep of friction that they decide on."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from planner.errors import FileFormatError, NotFoundError, TaskError
from planner.files import write_plan
from planner.plan import GraspPlan
from planner.search.grasp import plan_grasp
from planner.synthesis.options import SynthesisOptions
from planner.task import GraspTask
from sim.cli import main
from sim.creep import contact_drag, impedance, least_creep, predicted_creep, remedies
from sim.protocols.creep import measure_creep, sized_remedies
from sim.protocols.run import physics_of
from sim.scene.build import OBJECT, build_scene
from sim.scene.carrier import Timeline
from sim.scene.physics import PRESETS, PhysicsOptions, named_physics
from sim.trial import simulate

SOFT = PRESETS["mujoco-default"]
WEIGHT = 9.81
HEIGHT_M = 0.08


@pytest.fixture(scope="module")
def grasped() -> GraspPlan:
    """A box held so far below its upper rim that it is held while creep is measured.

    Under MuJoCo's defaults pads climb by 5.5 mm/s, for 1.7 s until creep is measured. A pad near
    the rim (rounds on epsilon spread them, to 4 mm from it) is past it before: the box is lost.
    """
    task, options = GraspTask.create("allegro_hand", "box"), SynthesisOptions(rounds=0)
    plans = (plan_grasp(task, seed=seed, options=options) for seed in range(10))
    return next(p for p in plans if HEIGHT_M - p.contacts.positions[:, 2].max() > 5.5e-3 * 1.7)


def scene_of(plan: GraspPlan, physics: PhysicsOptions) -> Any:
    return build_scene(plan.task, T_world_base=plan.T_world_base, q=plan.q, physics=physics)


# presets


def test_presets_are_called_as_they_are_registered() -> None:
    assert set(PRESETS) == {"ours", "mujoco-default", "menagerie", "dexgraspbench"}
    for name, preset in PRESETS.items():
        assert preset.name == preset.label == name
        assert named_physics(name) is preset
    assert PRESETS["ours"] == PhysicsOptions()


def test_mujoco_default_is_what_a_scene_gets_that_says_nothing() -> None:
    spec = mujoco.MjSpec()
    option, geom = spec.option, spec.worldbody.add_geom()
    assert option.timestep == SOFT.timestep
    assert int(option.cone) == mujoco.mjtCone.mjCONE_PYRAMIDAL
    assert option.impratio == SOFT.impratio
    assert option.noslip_iterations == SOFT.noslip_iterations
    assert option.iterations == SOFT.iterations
    assert geom.condim == SOFT.condim
    np.testing.assert_allclose(geom.friction, SOFT.friction)
    np.testing.assert_allclose(geom.solref[:2], SOFT.solref)
    np.testing.assert_allclose(geom.solimp, SOFT.solimp)
    # the one number that is not MuJoCo's, for the sake of the servos
    assert int(option.integrator) == mujoco.mjtIntegrator.mjINT_EULER
    assert SOFT.integrator == "implicitfast"


def test_dexgraspbench_has_the_mean_of_hand_and_object() -> None:
    """The benchmark writes the hand's numbers; the object keeps MuJoCo's, at the same priority."""
    ours, soft, mixed = PhysicsOptions(), SOFT, PRESETS["dexgraspbench"]
    np.testing.assert_allclose(mixed.solref, np.mean([ours.solref, soft.solref], axis=0))
    np.testing.assert_allclose(mixed.solimp, np.mean([ours.solimp, soft.solimp], axis=0))
    spec = mujoco.MjSpec()
    for height, numbers in ((0.0, ours), (0.015, soft)):
        body = spec.worldbody.add_body(pos=(0, 0, height))
        geom = body.add_geom(size=(0.01, 0, 0), solref=numbers.solref, solimp=numbers.solimp)
        geom.type = mujoco.mjtGeom.mjGEOM_SPHERE
        body.add_freejoint()
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.contact[0].solref[:2], mixed.solref)
    np.testing.assert_allclose(data.contact[0].solimp, mixed.solimp)


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_scenes_compute_as_the_preset_says(grasped: GraspPlan, name: str) -> None:
    physics = PRESETS[name]
    model = scene_of(grasped, physics).model
    option, geom = model.opt, model.geom(OBJECT)
    assert option.timestep == physics.timestep
    assert mujoco.mjtCone(option.cone).name == f"mjCONE_{physics.cone.upper()}"
    assert mujoco.mjtIntegrator(option.integrator).name == f"mjINT_{physics.integrator.upper()}"
    assert option.impratio == physics.impratio
    assert option.noslip_iterations == physics.noslip_iterations
    assert int(option.jacobian) == int(mujoco.mjtJacobian.mjJAC_DENSE)
    assert geom.condim[0] == physics.condim
    assert geom.priority[0] == 1
    np.testing.assert_allclose(geom.solref[:2], physics.solref)
    np.testing.assert_allclose(geom.solimp, physics.solimp)
    np.testing.assert_allclose(geom.friction, physics.friction)


def test_label_says_what_was_changed() -> None:
    assert replace(SOFT, mu=0.6).label == "mujoco-default with mu 0.6"
    changed = PhysicsOptions(timestep=0.004, solref=(0.01, 1.0))
    assert changed.label == "ours with timestep 0.004, solref 0.01 1"
    assert changed.to_dict()["name"] == changed.label
    assert "condim 4" in str(changed)


def test_protocol_reports_state_every_number(grasped: GraspPlan) -> None:
    told = physics_of(grasped, SOFT)
    assert told["name"] == "mujoco-default"
    assert told["cone"] == "pyramidal"
    assert told["condim"] == 3
    assert told["solref"] == [0.02, 1.0]
    assert told["solimp"] == list(SOFT.solimp)
    stiff = replace(SOFT, timestep=0.004, solref=(0.005, 1.0))
    assert physics_of(grasped, stiff)["solref"] == [0.008, 1.0]  # MuJoCo raises it


# files


def written(tmp_path: Path, name: str, text: str) -> Path:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def test_a_file_changes_a_preset(tmp_path: Path) -> None:
    text = 'preset = "mujoco-default"\nimpratio = 100\ncone = "elliptic"\nsolref = [0.01, 1]\n'
    found = PRESETS.given(str(written(tmp_path, "mine.toml", text)))
    wanted = replace(SOFT, name="mine.toml", impratio=100, cone="elliptic", solref=(0.01, 1.0))
    assert found == wanted
    assert found.label == "mine.toml"


def test_a_file_without_preset_changes_ours_and_may_have_a_name(tmp_path: Path) -> None:
    path = written(tmp_path, "a.json", json.dumps({"name": "rig", "noslip_iterations": 0}))
    assert PRESETS.read(path) == PhysicsOptions(name="rig", noslip_iterations=0)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("impratoi = 10", "impratoi: no such field; give some of preset, name, timestep"),
        ("impratio = 0", "impratio is 0; give a finite number from 1e-06 to"),
        ("impratio = true", "impratio is True"),
        ("timestep = nan", "timestep is nan"),
        ("mu = -1", "mu in simulation is -1"),
        ('mu = "high"', "mu in simulation is 'high'"),
        (
            "noslip_iterations = 1.5",
            "noslip_iterations is 1.5; give a whole number from 0 to",
        ),
        ("iterations = 0", "iterations is 0; give a whole number from 1 to"),
        ("condim = 1", "condim is 1; give one of 3, 4, 6"),
        ('cone = "round"', "cone is 'round'; give one of elliptic, pyramidal"),
        ("cone = []", r"cone is \[\]; give one of"),
        ('integrator = "rk4"', "integrator is 'rk4'; give one of euler"),
        ("solref = 0.02", "solref is 0.02; give 2 finite numbers"),
        ("solref = [-100, -1]", "the time constant, solref"),
        ("solref = [0.02, 0]", "the damping ratio"),
        ("solimp = [0.9, 0.95, 0.001]", "solimp is .*; give 5 finite numbers"),
        ("solimp = [0.9, 1.0, 0.001, 0.5, 2]", "give impedances in"),
        ('name = ""', "name is ''; give a text"),
        ("preset = 3", "preset is 3; give one of ours"),
    ],
)
def test_bad_fields_are_named_with_the_file(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(TaskError, match=f"bad.toml: .*{said}"):
        PRESETS.given(str(written(tmp_path, "bad.toml", text)))


def test_bad_files_are_told(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="cannot read the physics file"):
        PRESETS.given(str(tmp_path / "none.toml"))
    with pytest.raises(FileFormatError, match="no TOML or JSON by its ending"):
        PRESETS.given(str(written(tmp_path, "a.json", "impratio = 10")))
    with pytest.raises(FileFormatError, match="no TOML or JSON by its ending"):
        PRESETS.given(str(written(tmp_path, "b.json", "[" * 100_000)))
    with pytest.raises(FileFormatError, match="holds no fields"):
        PRESETS.given(str(written(tmp_path, "c.json", "[1]")))
    with pytest.raises(NotFoundError, match="no physics is called 'bullet'"):
        PRESETS.given(str(written(tmp_path, "d.toml", 'preset = "bullet"')))


def test_an_unknown_name_says_what_there_is() -> None:
    with pytest.raises(NotFoundError, match="Did you mean 'mujoco-default'"):
        PRESETS.given("mujoco-defaults")
    with pytest.raises(NotFoundError, match="no physics is called"):
        named_physics("./mine")


def test_fields_of_a_file_are_those_of_the_class() -> None:
    assert list(PhysicsOptions().to_dict()) == [field.name for field in fields(PhysicsOptions)]


# creep

RIG = """
<mujoco>
  <option gravity="0 0 -9.81"/>
  <worldbody>
    <body name="left" pos="-0.03 0 0"><joint name="left" type="slide" axis="1 0 0"/>
      <geom type="sphere" size="0.01" mass="0.07"/></body>
    <body name="right" pos="0.03 0 0"><joint name="right" type="slide" axis="-1 0 0"/>
      <geom type="sphere" size="0.01" mass="0.07"/></body>
    <body name="object"><freejoint/>
      <geom type="box" size="0.0199 0.02 0.2" mass="0.1"/></body>
  </worldbody>
  <actuator><motor joint="left"/><motor joint="right"/></actuator>
</mujoco>
"""


class Rig:
    """A box between two balls on rails, pressed by a force."""

    def __init__(self, physics: PhysicsOptions, press: float) -> None:
        """Build it."""
        spec = mujoco.MjSpec.from_string(RIG)
        physics.apply(spec, np.array([0.0, 0.0, -WEIGHT]))
        for geom in spec.geoms:
            geom.friction, geom.condim = physics.friction, physics.condim
            geom.solref, geom.solimp = physics.solref, physics.solimp
        self.physics = physics
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.data.ctrl[:] = press

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / self.physics.timestep)):
            mujoco.mj_step(self.model, self.data)

    def creep(self) -> float:
        """Speed (m/s) at which the box sinks once all is steady."""
        self.run(0.3)
        begin = self.data.body("object").xpos[2]
        self.run(0.2)
        return float(begin - self.data.body("object").xpos[2]) / 0.2

    def drags(self) -> list[tuple[float, float]]:
        """Drag b / R_t (N s/m) of every contact, by the formula and by MuJoCo itself."""
        model, data = self.model, self.data
        mujoco.mj_forward(model, data)
        elliptic = self.physics.cone == "elliptic"
        out = []
        for contact in data.contact[: data.ncon]:
            row = int(contact.efc_address) + int(elliptic)
            scale = 1.0 if elliptic else 2.0 * float(contact.friction[0]) ** 2
            theirs = scale * data.efc_KBIP[row, 1] / data.efc_R[row]
            inverse = float(model.body_invweight0[model.geom_bodyid[contact.geom], 0].sum())
            depth = -float(contact.dist)
            ours = contact_drag(self.physics, inverse_mass=inverse, depth=depth)
            out.append((ours, float(theirs)))
        return out


VARIANTS: Sequence[PhysicsOptions] = (
    SOFT,
    replace(SOFT, mu=0.6),
    replace(SOFT, condim=4),
    replace(SOFT, cone="elliptic"),
    replace(SOFT, cone="elliptic", impratio=10.0),
    replace(SOFT, cone="elliptic", solref=(0.01, 1.0)),
    replace(SOFT, cone="elliptic", solimp=(0.99, 0.99, 0.001, 0.5, 2.0)),
    replace(SOFT, cone="elliptic", timestep=0.004, solref=(0.005, 1.0)),
    replace(PhysicsOptions(), noslip_iterations=0),
    replace(PRESETS["dexgraspbench"], noslip_iterations=0),
    PRESETS["menagerie"],
)


@pytest.mark.parametrize("physics", VARIANTS, ids=lambda p: p.label)
def test_the_formula_is_mujocos_own_and_gives_the_creep(physics: PhysicsOptions) -> None:
    rig = Rig(physics, press=4.0)
    seen = rig.creep()
    drags = rig.drags()
    assert len(drags) >= 2
    for ours, theirs in drags:
        assert ours == pytest.approx(theirs, rel=1e-6)
    assert seen == pytest.approx(0.1 * WEIGHT / sum(ours for ours, _ in drags), rel=0.03)


def test_creep_is_inverse_to_impratio_and_noslip_ends_it() -> None:
    round_ = replace(SOFT, cone="elliptic")
    slow = [Rig(replace(round_, impratio=r), press=4.0).creep() for r in (1.0, 10.0, 100.0)]
    assert slow[0] / slow[1] == pytest.approx(10.0, rel=0.05)
    assert slow[1] / slow[2] == pytest.approx(10.0, rel=0.05)
    assert Rig(replace(SOFT, noslip_iterations=10), press=4.0).creep() < 1e-3 * slow[0]


def test_no_grip_ends_the_creep_of_soft_contacts() -> None:
    """Beyond the depth at which the impedance is the highest, pressing harder changes nothing."""
    soft = replace(SOFT, cone="elliptic")
    firm, firmer = (Rig(soft, press=press).creep() for press in (10.0, 40.0))
    assert firmer == pytest.approx(firm, rel=0.03)
    assert firm > 1e-3


@pytest.mark.parametrize(
    "solimp", [SOFT.solimp, (0.1, 0.9, 0.002, 0.3, 3.0), (0.2, 0.8, 1.0, 0.5, 1.0)]
)
def test_impedance_is_mujocos_curve(solimp: tuple[float, float, float, float, float]) -> None:
    rig = Rig(replace(SOFT, cone="elliptic", solimp=solimp), press=2.0)
    for _ in range(60):
        mujoco.mj_step(rig.model, rig.data)
        mujoco.mj_forward(rig.model, rig.data)
        for contact in rig.data.contact[: rig.data.ncon]:
            theirs = rig.data.efc_KBIP[contact.efc_address, 2]
            assert impedance(solimp, -contact.dist) == pytest.approx(theirs, rel=1e-9)


def test_prediction_of_a_scene_is_above_the_least(grasped: GraspPlan) -> None:
    scene = scene_of(grasped, SOFT)
    data = scene.start(grasped.q, grasped.T_world_base)
    names = grasped.task.finger_names
    assert least_creep(scene, names) == least_creep(scene, names, SOFT) > 1e-3
    assert least_creep(scene, names, PhysicsOptions()) < 1e-4
    assert least_creep(scene, ()) == np.inf
    assert predicted_creep(scene, data) > least_creep(scene, names)


def test_remedies_are_for_a_budget(grasped: GraspPlan) -> None:
    scene = scene_of(grasped, SOFT)

    def creep(physics: PhysicsOptions) -> float:
        return least_creep(scene, grasped.task.finger_names, physics)

    changes = remedies(SOFT, creep, 1e-4)
    assert [c.what.split()[0] for c in changes] == ["<option", "<option", "every"]
    assert all(creep(c.physics) <= 1e-4 for c in changes[1:])
    tenth = remedies(SOFT, creep, 1e-3)
    assert tenth[1].physics.impratio == pytest.approx(changes[1].physics.impratio / 10, abs=1)
    assert remedies(SOFT, creep, 1.0) == ()
    assert remedies(PhysicsOptions(), creep, 1e-9) == ()
    assert len(remedies(SOFT, creep, 1e-9)) == 1  # only noslip is left
    with pytest.raises(TaskError, match="creep budget"):
        remedies(SOFT, creep, 0.0)
    with pytest.raises(TaskError, match="inverse_mass"):
        contact_drag(SOFT, inverse_mass=0.0, depth=0.0)


@pytest.mark.slow
def test_under_the_defaults_a_grasp_is_lost_and_every_remedy_holds_it(grasped: GraspPlan) -> None:
    lost = simulate(grasped, physics=SOFT)
    assert lost.reason == "slipped"
    assert len(lost.remedies) == 3
    told = lost.to_dict()
    assert told["physics"]["name"] == "mujoco-default"
    assert told["physics"]["solimp"] == list(SOFT.solimp)
    assert told["least_creep_mm_s"] > 1.0
    scene = scene_of(grasped, SOFT)
    names = grasped.task.finger_names
    for change in remedies(SOFT, lambda p: least_creep(scene, names, p), 1e-4):
        held = simulate(grasped, physics=change.physics, timeline=Timeline.quick())
        assert held.success, change.what
        assert held.largest_slip[0] < 2.0
        assert held.remedies == ()


# the command line


def cli(*arguments: str) -> tuple[int, str, str]:
    """Call the command in this process: exit code, output, messages with blanks as one."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err), pytest.raises(SystemExit) as ended:
        main(list(arguments))
    code = ended.value.code
    assert isinstance(code, int)
    return code, out.getvalue(), " ".join(err.getvalue().split())


@pytest.mark.slow
def test_commands_take_physics_by_name_and_file(grasped: GraspPlan, tmp_path: Path) -> None:
    plan = tmp_path / "plan.json"
    write_plan(grasped, plan)
    code, told, _ = cli("test", str(plan), "--physics", "mujoco-default", "--json")
    report = json.loads(told)
    assert code == 1
    assert report["physics"]["name"] == "mujoco-default"
    assert report["physics"]["mu"] == 1.0
    mine = written(tmp_path, "mine.toml", 'preset = "mujoco-default"\nnoslip_iterations = 10')
    more = ("--sim-mu", "0.8", "--verbose")
    code, told, _ = cli("test", str(plan), "--physics", str(mine), *more)
    assert code == 0
    assert "physics: mine.toml" in told
    out = tmp_path / "test"
    force = ("--protocol", "shake", "--only", "shake z", "--workers", "1", "--out", str(out))
    code, told, _ = cli("test", str(plan), *force, "--physics", "menagerie", "--json")
    assert json.loads(told)["reports"][0]["physics"]["name"] == "menagerie"


@pytest.mark.parametrize(
    "command",
    [
        ("run", "allegro_hand", "box"),
        ("manipulate", "--demo"),
        ("manipulate", "allegro_hand", "box"),
    ],
)
def test_a_wrong_physics_ends_before_the_work(command: tuple[str, ...]) -> None:
    code, _, told = cli(*command, "--physics", "bullet")
    assert code == 3
    assert "no physics is called 'bullet'" in told


# creep of a plan, and changes that are enough


@pytest.mark.slow
def test_creep_of_a_plan_is_measured_and_a_lost_object_told(grasped: GraspPlan) -> None:
    soft = measure_creep(grasped, SOFT)
    assert soft.measured == pytest.approx(soft.predicted, rel=0.15)
    assert soft.predicted > soft.least > 1e-3
    assert soft.lost == ""
    slippery = measure_creep(grasped, PhysicsOptions(mu=0.02, mu_torsion=0.0))
    assert slippery.measured == np.inf
    assert slippery.lost


@pytest.mark.slow
def test_changes_are_made_large_enough_for_what_is_measured(grasped: GraspPlan) -> None:
    """Fingers that press on each other add to the formula; the budget is between the two speeds."""
    scene = PRESETS["menagerie"]
    seen = measure_creep(grasped, scene)
    assert seen.measured > 1.1 * seen.least
    budget = (seen.least * seen.measured) ** 0.5  # by the formula alone there is nothing to change
    tried = sized_remedies(grasped, scene, seen, budget)
    assert [t.remedy.kind for t in tried] == ["noslip", "impratio", "contacts"]
    assert all(t.enough and t.creep.measured <= budget for t in tried)
    assert sized_remedies(grasped, scene, seen, 1.01 * seen.measured) == ()
    # of a lost object the formula alone tells the size, and the changes must grow
    gone = replace(seen, measured=np.inf)
    assert all(t.enough for t in sized_remedies(grasped, scene, gone, seen.least / 2))


@pytest.mark.slow
def test_the_command_creep_says_what_to_change(grasped: GraspPlan, tmp_path: Path) -> None:
    plan = tmp_path / "plan.json"
    write_plan(grasped, plan)
    code, told, _ = cli("test", "--protocol", "creep", str(plan), "--budget", "0.5", "--json")
    data = json.loads(told)
    assert code == 1
    assert data["physics"]["name"] == "mujoco-default"
    assert not data["within_budget"]
    assert all(c["enough"] and c["creep_mm_s"] <= 0.5 for c in data["changes"])
    assert any("priority" in c["what"] for c in data["changes"])
    code, told, _ = cli("test", "--protocol", "creep", str(plan), "--physics", "ours")
    assert code == 0
    assert "0.1 mm/s are wanted" in told
    code, _, told = cli("test", "--protocol", "creep", str(plan), "--budget", "-1")
    assert code == 3
    assert "--budget is -1" in told
