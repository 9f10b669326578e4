"""The cross-check: engines agree, known mistakes are named, seeded faults are found and named."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest
import trimesh
from conftest import hand_of_others
from typer.testing import CliRunner

import sim.crosscheck.check as check_module
from planner.bridge import pinocchio_from_mujoco
from planner.errors import ModelError, NotFoundError, PlannerError, TaskError
from planner.system.package import models_dir
from sim.cli import app
from sim.crosscheck import (
    BRIDGE,
    QUANTITIES,
    READER,
    CrosscheckReport,
    Tolerances,
    causes,
    compare_models,
    crosscheck,
    crosscheck_tables,
    reader,
)
from sim.crosscheck.causes import EVIDENCE, Context
from sim.crosscheck.mujoco_side import MujocoSide, layout_of
from sim.crosscheck.parts import random_states
from sim.crosscheck.reader import compiled

TUTORIAL = Path(__file__).parents[1] / "docs/tutorials/cross-check.md"
FINGER = re.findall(r"```xml\n(.*?)```", TUTORIAL.read_text("utf-8"), re.DOTALL)[0]
"""The tutorial's ``finger.urdf``."""

SHIPPED = ("allegro_hand", "shadow_hand")

EVERYTHING = """
<mujoco>
  <compiler angle="radian"/>
  <option gravity="1 -2 -9"/>
  <default><geom friction="1"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 1"/>
    <site name="in_the_world" pos="0.3 0.1 0"/>
    <body name="marker" mocap="true" pos="0 0 1"><geom size="0.01"/></body>
    <body name="root" pos="0.1 0.2 0.7" quat="0.5 0.1 -0.7 0.4">
      <inertial pos="0 0 0.01" mass="0.9" diaginertia="0.01 0.01 0.01"/>
      <body pos="0 0.1 0" quat="1 0.2 0 0.1">
        <inertial pos="0.01 0.02 0.03" quat="1 2 3 4" mass="0.7" diaginertia="0.03 0.02 0.04"/>
        <joint axis="1 2 3" pos="0.01 0 -0.02" ref="0.4" armature="0.02" range="-1 2" damping="2"/>
        <joint name="s1" type="slide" axis="0 -1 1" pos="0 0.05 0" ref="-0.03"/>
        <joint name="h2" axis="0 1 0" pos="0 -0.01 0.03" ref="-1.1" frictionloss="0.3"/>
        <geom type="cylinder" size="0.02 0.05"/>
        <site pos="0.1 0 0" quat="0 1 0 1"/>
        <body name="stiff" pos="0.2 0 0" quat="0.3 0.1 0.9 0">
          <inertial pos="0.02 0 0" quat="0 1 1 0" mass="0.2" diaginertia="0.01 0.02 0.015"/>
          <body name="ball" pos="0 0 0.15">
            <inertial pos="0 0.04 0" mass="0.3" diaginertia="0.004 0.005 0.006"/>
            <joint name="b" type="ball" pos="0.01 -0.02 0.03" armature="0.01" damping="0.1"/>
            <geom type="capsule" size="0.02 0.04"/>
            <site name="s_ball" pos="0 0 0.07"/>
            <body name="end" pos="0 0.1 0.1">
              <inertial pos="0 0 0" mass="0.1" diaginertia="0.001 0.001 0.001"/>
              <joint name="h3" axis="-1 0 0"/>
              <geom type="ellipsoid" size="0.02 0.03 0.04"/>
            </body>
          </body>
        </body>
      </body>
    </body>
    <body name="flying" pos="1 0 1" quat="0 0 1 0">
      <inertial pos="0.01 0 -0.02" quat="1 0 1 0" mass="0.5" diaginertia="0.002 0.003 0.004"/>
      <joint name="f" type="free" armature="0.05" damping="0.2"/>
      <geom type="box" size="0.03 0.02 0.01"/>
      <body name="flag" pos="0 0 0.1" quat="1 1 0 0">
        <inertial pos="0 0 0.02" mass="0.4" diaginertia="0.002 0.002 0.002"/>
        <joint name="h4" axis="1 1 0" pos="0 0.02 0" ref="0.2" range="0 1"/>
        <geom type="mesh" mesh="tetrahedron"/>
        <site name="s_flag" pos="0 0.02 0"/>
      </body>
    </body>
  </worldbody>
  <asset><mesh name="tetrahedron" vertex="0 0 0 .1 0 0 0 .2 0 0 0 .3"/></asset>
  <tendon>
    <fixed name="t"><joint joint="h3" coef="0.5"/><joint joint="h4" coef="-2"/></fixed>
    <fixed name="u"><joint joint="h2" coef="1"/></fixed>
  </tendon>
  <actuator>
    <position joint="h4" kp="3" forcerange="-1 2" gear="-2"/>
    <motor tendon="t" forcerange="-1 1"/>
    <motor joint="s1"/>
  </actuator>
  <equality>
    <joint name="joints" joint1="h3" joint2="h4" polycoef="0.1 2 0 0 0"/>
    <joint name="alone" joint1="s1" polycoef="0.1 0 0 0 0"/>
    <tendon name="tendons" tendon1="t" tendon2="u" polycoef="0 1.5 0 0 0"/>
    <connect name="connect" body1="flag" body2="end" anchor="0 0 0.1"/>
    <connect name="sites" site1="s_flag" site2="in_the_world"/>
    <weld name="weld" body1="flag" body2="ball" relpose="0.1 0 0 1 0.2 0.3 0" anchor="0 .1 .2"/>
    <weld name="pinned" body1="flying" torquescale="0.4"/>
    <weld name="glue" site1="s_flag" site2="s_ball"/>
  </equality>
</mujoco>
"""


def here(path: Path, timeout: float) -> reader.ReaderResult:
    """Pinocchio's own reader without a child process, for files that do not crash it."""
    try:
        return reader._result(reader._answer(path))
    except RuntimeError as error:
        return reader._failed(f"RuntimeError: {error}")


@pytest.fixture
def in_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(check_module, "read_with_pinocchio", here)


# --- the bridge -----------------------------------------------------------------------------------


def test_every_kind_of_part_agrees_in_both_engines() -> None:
    spec = mujoco.MjSpec.from_string(EVERYTHING)
    report = crosscheck(spec, seed=3, n_configurations=10)
    assert report.ok, report.faults
    cells = {cell.quantity: cell for cell in report.column(BRIDGE).cells}
    groups = {QUANTITIES[title].group for title in cells}
    assert groups >= {
        "structure", "parameters", "kinematics", "dynamics", "couplings", "geometry"
    }  # fmt: skip
    assert cells["equality rows"].compared == 8 * 10
    assert cells["joint range"].compared == 5
    for title in ("mass matrix", "Coriolis force", "gravity force", "forward dynamics"):
        assert cells[title].error < 1e-11, title


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_hands_agree(name: str) -> None:
    report = crosscheck(models_dir() / "hands" / name / f"{name}.xml", n_configurations=3,
                        own_reader=False)  # fmt: skip
    assert report.ok, report.faults
    assert report.notes == (("not compared: springs",) if name == "shadow_hand" else ())


def test_a_hand_is_checked_as_it_is_loaded() -> None:
    report = crosscheck("allegro_hand_left", n_configurations=1)
    assert report.ok
    assert "own reader is asked only about model files" in report.notes[0]


def turn_inertia(model: Any) -> None:
    """Change the products of inertia of one link and keep its moments, mass and centre."""
    old = model.inertias[3]
    tensor = old.inertia.copy()
    tensor[0, 1] = tensor[1, 0] = tensor[0, 1] + 0.1 * np.diag(tensor).min()
    model.inertias[3] = pin.Inertia(old.mass, old.lever, tensor)


@pytest.mark.parametrize(
    ("change", "quantity"),
    [
        (turn_inertia, "inertia"),
        (lambda m: setattr(m, "armature", m.armature + 0.1),
         "armature"),
        (lambda m: setattr(m, "damping", m.damping + 0.1), "damping"),
        (lambda m: setattr(m, "upperEffortLimit", m.upperEffortLimit * 1.1), "effort limit"),
        (lambda m: setattr(m, "gravity", pin.Motion.Zero()), "gravity"),
        (lambda m: setattr(m, "lowerPositionLimit", m.lowerPositionLimit - 1e-6), "joint range"),
    ],
)  # fmt: skip
def test_a_wrong_pinocchio_model_is_found(change: Any, quantity: str) -> None:
    model = mujoco.MjModel.from_xml_path(str(models_dir() / "hands/allegro_hand/allegro_hand.xml"))
    other = pinocchio_from_mujoco(model)
    assert compare_models(model, other, n_configurations=1).ok
    change(other)
    report = compare_models(model, other, n_configurations=1)
    assert {d.quantity for d in report.columns[0].faults} == {quantity}


@pytest.mark.parametrize("product", [3, 4, 5])
def test_products_of_inertia_are_compared_between_two_files(product: int) -> None:
    tensors = [[0.3, 0.3, 0.3, 0.01, 0.02, 0.03] for _ in range(2)]
    tensors[1][product] += 1e-6
    here, there = (
        mujoco.MjSpec.from_string(
            '<mujoco><worldbody><body name="link"><joint axis="0 0 1"/><inertial pos="0 0 0" '
            f'mass="1" fullinertia="{" ".join(map(str, tensor))}"/></body></worldbody></mujoco>'
        )
        for tensor in tensors
    )
    (fault,) = compare_models(here, there, n_configurations=1).columns[0].faults
    assert (fault.quantity, fault.part) == ("inertia", "link")
    assert fault.error == pytest.approx(1e-6 / 0.3, rel=1e-3)
    assert fault.reference != fault.value  # all six numbers are shown


def test_geometries_that_pinocchio_places_wrongly_are_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def shifted(model: Any) -> Any:
        out = pinocchio_from_mujoco(model)
        out.jointPlacements[1].translation += [0, 0, 1e-5]
        return out

    monkeypatch.setattr(check_module, "pinocchio_from_mujoco", shifted)
    report = crosscheck("allegro_hand", n_configurations=2)
    cells = {cell.quantity: cell.verdict for cell in report.column(BRIDGE).cells}
    assert cells["distance"] == cells["body offset"] == cells["body position"] == "differs"
    assert not report.ok


def test_configurations_are_random_within_limits_and_of_unit_quaternions() -> None:
    model = mujoco.MjModel.from_xml_string(EVERYTHING)
    layout = layout_of(model)
    facts = dict(MujocoSide(model, "MuJoCo", layout).parts().joints)
    held = np.ones(model.nv, dtype=bool)
    held[layout.joints[1].v] = False
    states = random_states(layout, facts, held, np.random.default_rng(0), 50)
    qpos = np.array([state.qpos for state in states])
    for slot in layout.joints:
        values = qpos[:, slot.q]
        if slot.kind in ("free", "ball"):
            np.testing.assert_allclose(np.linalg.norm(values[:, -4:], axis=1), 1)
        bounds = facts[slot.name].range
        if bounds is not None:
            assert (bounds[0] <= values).all() and (values <= bounds[1]).all()
        spread = values.max(axis=0) - values.min(axis=0)
        assert (spread > 0.05).all() == (slot.name != layout.joints[1].name), slot.name
    np.testing.assert_array_equal(qpos[:, layout.joints[1].q], -0.03)  # held where it is drawn


def test_the_same_seed_gives_the_same_report() -> None:
    reports = [crosscheck("allegro_hand", seed=s, n_configurations=2) for s in (5, 5, 6)]
    first, second, other = (json.dumps(r.to_dict()["columns"]) for r in reports)
    assert first == second != other


# --- two models -----------------------------------------------------------------------------------


FAULTS = ("axis", "mass", "limit", "offset", "tip")


def spoil(spec: Any, kind: str, rng: np.random.Generator) -> tuple[str, str]:
    """Change one number of a model; the quantity and the part that must be named."""
    size = 10.0 ** rng.uniform(-6, -1)
    if kind in ("axis", "limit"):
        joint = spec.joints[rng.integers(len(spec.joints))]
        if kind == "axis":
            joint.axis = pin.exp3(size * rng.normal(size=3)) @ joint.axis
            return "joint axis", joint.name
        bounds = np.array(joint.range)
        bounds[rng.integers(2)] += size
        joint.range = bounds
        return "joint range", joint.name
    if kind == "tip":
        site = spec.sites[rng.integers(len(spec.sites))]
        site.pos = site.pos + size * rng.normal(size=3)
        return "site offset", site.name
    body = spec.bodies[rng.integers(1, len(spec.bodies))]
    if kind == "mass":
        body.mass *= 1 + size
        return "mass", body.name
    body.pos = body.pos + size * rng.normal(size=3)
    return "body offset", body.name


@pytest.mark.parametrize("name", SHIPPED)
def test_every_seeded_fault_is_found_and_named(name: str) -> None:
    path = models_dir() / "hands" / name / f"{name}.xml"
    for seed in range(10):
        spec = mujoco.MjSpec.from_file(str(path))
        expected = spoil(spec, FAULTS[seed % 5], np.random.default_rng(seed))
        report = compare_models(path, spec, n_configurations=1)
        named = {(d.quantity, d.part) for d in report.columns[0].faults}
        assert named == {expected}, seed
        assert not report.ok
    assert compare_models(path, mujoco.MjSpec.from_file(str(path)), n_configurations=1).ok


MJCF_ARM = """
<mujoco><compiler angle="radian"/><worldbody><body name="base">
  <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
  <body name="upper" pos="0 0 0.1">
    <joint name="shoulder" axis="0 0 1" range="-1 2" actuatorfrcrange="-5 5" damping="0.1"/>
    <inertial pos="0.1 0 0" mass="0.5" diaginertia="0.01 0.02 0.02"/>
    <body name="lower" pos="0.3 0 0">
      <joint name="elbow" type="slide" axis="1 0 0" range="-0.1 0.2" actuatorfrcrange="-7 7"/>
      <inertial pos="0 0.05 0" mass="0.2" diaginertia="0.003 0.002 0.002"/>
      <geom type="box" size="0.1 0.02 0.02"/>
    </body>
  </body>
</body></worldbody></mujoco>
"""

URDF_ARM = """
<robot name="arm">
  <link name="base"><inertial><mass value="1"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="lower"><inertial><origin xyz="0 0.05 0"/><mass value="0.2"/>
    <inertia ixx="0.003" iyy="0.002" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><box size="0.2 0.04 0.04"/></geometry></collision></link>
  <link name="upper"><inertial><origin xyz="0.1 0 0"/><mass value="0.5"/>
    <inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <origin xyz="0 0 0.1"/><axis xyz="0 0 1"/><dynamics damping="0.1"/>
    <limit lower="-1" upper="2" effort="5" velocity="1"/></joint>
  <joint name="a_slide" type="prismatic"><parent link="upper"/><child link="lower"/>
    <origin xyz="0.3 0 0"/><axis xyz="1 0 0"/>
    <limit lower="-0.1" upper="0.2" effort="7" velocity="1"/></joint>
</robot>
"""


@pytest.mark.parametrize("by", ["urdf", "pinocchio"])
def test_a_urdf_is_compared_with_an_mjcf_by_names(tmp_path: Path, by: str) -> None:
    mjcf, urdf = tmp_path / "arm.xml", tmp_path / "arm.urdf"
    mjcf.write_text(MJCF_ARM, encoding="utf-8")
    urdf.write_text(URDF_ARM, encoding="utf-8")
    other = urdf if by == "urdf" else pin.buildModelFromUrdf(str(urdf))
    report = compare_models(mjcf, other, names={"elbow": "a_slide"})
    assert report.ok, report.faults
    nameless = compare_models(mjcf, other)
    assert {(d.quantity, d.part) for d in nameless.columns[0].faults} == {
        ("joints present", "elbow"),
        ("joints present", "a_slide (not in the reference)"),
    }
    with pytest.raises(TaskError, match=r"says knee = a_slide, and .*not in both models"):
        compare_models(mjcf, other, names={"knee": "a_slide"})


def test_joints_in_another_order_and_a_free_base_are_no_difference() -> None:
    link = (
        '<body name="{0}" pos="{1} 0 0"><joint name="j_{0}" axis="0 {1} 1"/>'
        '<inertial pos="0 0 .1" mass="{1}" diaginertia="1 1 1"/></body>'
    )
    links = [link.format("a", 1), link.format("b", 2)]
    model = (
        '<mujoco><worldbody><body name="base" pos="1 2 3"><freejoint name="f"/>'
        '<inertial pos=".1 0 0" mass="1" diaginertia="1 1 1"/>{}</body></worldbody></mujoco>'
    )
    one, two = (mujoco.MjModel.from_xml_string(model.format("".join(x)))
                for x in (links, links[::-1]))  # fmt: skip
    assert one.joint(1).name != two.joint(1).name
    report = compare_models(one, two)
    assert report.ok, report.faults
    assert compare_models(one, pinocchio_from_mujoco(two)).ok


def test_a_joint_of_another_kind_or_none_at_all_is_named() -> None:
    hinge = mujoco.MjModel.from_xml_string(MJCF_ARM)
    slide = mujoco.MjModel.from_xml_string(MJCF_ARM.replace('type="slide"', ""))
    report = compare_models(hinge, slide)
    assert ("joint kind", "elbow") in {(d.quantity, d.part) for d in report.columns[0].faults}
    fixed = mujoco.MjModel.from_xml_string(
        MJCF_ARM.replace('<joint name="elbow" type="slide" axis="1 0 0" range="-0.1 0.2"'
                         ' actuatorfrcrange="-7 7"/>', "")
    )  # fmt: skip
    report = compare_models(hinge, fixed)
    assert {(d.quantity, d.part) for d in report.columns[0].faults} == {("joints present", "elbow")}
    # with the elbow at zero, everything else is the same
    assert {c.quantity for c in report.columns[0].cells if c.verdict == "differs"} == {
        "joints present"
    }


def test_an_axis_beside_the_origin_is_told_from_the_point_it_goes_through() -> None:
    beside = '<joint name="shoulder" pos="0.1 0.2 0"'
    text = MJCF_ARM.replace('<joint name="shoulder"', beside)
    moved = text.replace('pos="0.1 0.2 0"', 'pos="0.1 0.201 0"')
    turned = text.replace('axis="0 0 1"', 'axis="0 0.01 1"')
    models = [mujoco.MjModel.from_xml_string(x) for x in (text, moved, turned)]
    for other, quantity in zip(models[1:], ("joint anchor", "joint axis"), strict=True):
        (fault,) = compare_models(models[0], other).columns[0].faults
        assert (fault.quantity, fault.part) == (quantity, "shoulder")
    assert fault.error == pytest.approx(np.arctan(0.01))


def test_what_is_no_number_is_no_agreement() -> None:
    model = mujoco.MjModel.from_xml_string(MJCF_ARM)
    other = pinocchio_from_mujoco(model)
    other.inertias[2].mass = np.nan
    report = compare_models(model, other, n_configurations=1)
    assert not report.ok
    assert {c.quantity for c in report.columns[0].cells if c.verdict == "differs"} >= {
        "mass matrix", "gravity force", "forward dynamics"
    }  # fmt: skip


def test_a_changed_coupling_is_named() -> None:
    changed = EVERYTHING.replace('polycoef="0.1 2 0 0 0"', 'polycoef="0.1 2.001 0 0 0"')
    report = compare_models(*(mujoco.MjSpec.from_string(x) for x in (EVERYTHING, changed)))
    assert [(d.quantity, d.part) for d in report.columns[0].faults] == [("equality rows", "joints")]


# --- Pinocchio's own reader -----------------------------------------------------------------------

INERTIAL = '<inertial pos="0.01 0 0" mass="0.3" diaginertia="0.01 0.01 0.01"/>'
JOINT = '<joint name="j" axis="0 1 0" range="-1 1"/>'


def model(
    inside: str = JOINT + INERTIAL,
    *,
    base: str = "",
    link: str = "",
    before: str = "",
    after: str = "",
    compiler: str = 'angle="radian"',
) -> str:
    """A fixed base and one link; the one feature under test goes into one of the gaps."""
    return (
        f"<mujoco><compiler {compiler}/>{before}<worldbody><body name='base' {base}>"
        '<inertial pos="0 0 0.01" mass="0.5" diaginertia="0.01 0.02 0.03"/>'
        f"<body name='link' pos='0.1 0 0' {link}>{inside}</body>"
        f"</body></worldbody>{after}</mujoco>"
    )


def joint(attributes: str) -> str:
    return f'<joint name="j" axis="0 1 0" {attributes}/>{INERTIAL}'


MESH = '<asset><mesh name="t" file="t.obj" {}/></asset>'
SECOND = f'<body name="second"><joint name="k" axis="1 0 0"/>{INERTIAL}</body>'

MISTAKES = {
    "root pose": (model(base='pos="1 2 3" quat="1 1 0 0"'), "root pose"),
    "second body": (model().replace("</worldbody>", f"{SECOND}</worldbody>"), "first body only"),
    "frame": (model(JOINT + INERTIAL + f"<frame pos='0 0 1'>{SECOND}</frame>"), "frame"),
    "include": (model(JOINT + INERTIAL + '<include file="part.xml"/>'), "include"),
    "world site": (model().replace("<body name='base'", "<site name='w'/><body name='base'"),
                   "world site"),
    "root site": (model().replace("<body name='link'", "<site name='r'/><body name='link'"),
                  "root site"),
    "ref": (model(joint('range="-60 60" ref="20"'), compiler=""), "joint range"),
    "slide in degrees": (model(joint('type="slide" range="-0.04 0.05"'), compiler=""),
                         "joint range"),
    "slide and ref": (model(joint('type="slide" range="-0.04 0.05" ref="0.01"'), compiler=""),
                      "joint range"),
    "limited": (model(joint('range="-1 1" limited="false"')), "joint range"),
    "composite with ref": (model(JOINT + '<joint name="k" axis="1 0 0" range="-2 1" ref="0.2"/>'
                                 + INERTIAL), "joint range"),
    "actuator": (model(after='<actuator><motor joint="j" forcerange="-1 1"/></actuator>'),
                 "actuators"),
    "axisangle": (model(link='axisangle="0 0 2 0.5"'), "axisangle"),
    "eulerseq": (model(link='euler="0.1 0.2 0.3"', compiler='angle="radian" eulerseq="ZYX"'),
                 "eulerseq"),
    "mesh mass": (model(JOINT + '<geom type="mesh" mesh="t"/>', before=MESH.format("")), "mass"),
    "class mass": (model(JOINT + '<geom size="0.1"/>',
                         before='<default><geom mass="0.7"/></default>'), "mass"),
    "inertiagrouprange": (model(JOINT + '<geom size="0.1" group="1"/><geom size="0.1"/>',
                                compiler='angle="radian" inertiagrouprange="1 2"'), "mass"),
    "balanced": (model('<joint name="j" axis="0 1 0"/><inertial pos="0 0 0" mass="1"'
                       ' fullinertia="0.1 0.1 0.3 0.01 0 0"/>',
                       compiler='angle="radian" balanceinertia="true"'), "balanced inertia"),
    "damping polynomial": (model(joint('damping="0.4 0.2"')), "damping polynomial"),
    "ball damping": (model('<joint name="j" type="ball" damping="0.4"/>' + INERTIAL),
                     "ball damping"),
    "mesh scale": (model(JOINT + INERTIAL + '<geom type="mesh" mesh="t"/>', before=MESH.format("")
                         + '<default><mesh scale="0.01 0.01 0.01"/></default>'), "geometry"),
    "mesh refpos": (model(JOINT + INERTIAL + '<geom type="mesh" mesh="t"/>',
                          before=MESH.format('refpos="1 0 0"')), "geometry"),
    "fitted": (model(JOINT + INERTIAL + '<geom type="box" mesh="t"/>', before=MESH.format("")),
               "geometry"),
    "class geom pos": (model(JOINT + INERTIAL + "<geom/>",
                             before='<default><geom pos="0 0 1" size="0.1"/></default>'),
                       "geometry"),
    "class site pos": (model(JOINT + INERTIAL + "<site name='s'/>",
                             before='<default><site pos="0 0 1"/></default>'), "class pose"),
    "class site quat": (model(JOINT + INERTIAL + "<site name='s'/>",
                              before='<default><site quat="0 0 1 .1"/></default>'), "class pose"),
    "fixed chain": (model(JOINT + INERTIAL + '<body name="m" pos="1 0 0"><body name="n"'
                          ' pos="0 0 1"><site name="s" pos="0 2 0"/></body></body>'),
                    "fixed chain"),
    "joint equality": (model(after='<equality><joint joint1="j"/></equality>'), "equalities"),
    "weld": (model(after='<equality><weld body1="link"/></equality>'), "equalities"),
    "unnamed site": (model(JOINT + INERTIAL + '<site pos="1 0 0"/>'), "no name"),
    "unnamed siblings": (model(JOINT + INERTIAL + "<body><joint name='a'/>" + INERTIAL
                               + "</body><body><joint name='b'/>" + INERTIAL + "</body>"),
                         "no name"),
    "unnamed body": (model(JOINT + INERTIAL + "<body><joint name='a'/>" + INERTIAL
                           + "<body name='b'><joint name='b'/>" + INERTIAL + "</body></body>"),
                     "no name"),
    "free root": (model().replace("<body name='base' >", "<body name='base' pos='1 2 3'"
                                  " quat='1 1 0 0'><freejoint name='f'/>"), "free joint"),
    "gravity": (model(before='<option gravity="0 0 -1"/>'), "gravity"),
}  # fmt: skip
"""One mistake of Pinocchio 4.1's reader each, found by hand on just these files, and its key."""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with what the models above refer to."""
    (tmp_path / "t.obj").write_text(
        "o t\nv 0.0 0.0 0.0\nv 0.1 0.0 0.0\nv 0.0 0.2 0.0\nv 0.0 0.0 0.3\n"
        "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n",
        encoding="utf-8",
    )
    (tmp_path / "part.xml").write_text(f"<mujoco>{SECOND}</mujoco>", encoding="utf-8")
    return tmp_path


def read(folder: Path, text: str) -> CrosscheckReport:
    path = folder / "model.xml"
    path.write_text(text, encoding="utf-8")
    return crosscheck(path, n_configurations=1)


@pytest.mark.usefixtures("in_process")
@pytest.mark.parametrize("title", MISTAKES)
def test_a_mistake_of_the_reader_is_named(folder: Path, title: str) -> None:
    text, key = MISTAKES[title]
    report = read(folder, text)
    column = report.column(READER)
    assert report.column(BRIDGE).ok, report.column(BRIDGE).differences
    assert set(column.causes) - {"body missing"} == {key}
    assert column.unexplained == ()
    assert report.ok  # the reader is not judged unless asked
    assert not column.ok


@pytest.mark.usefixtures("in_process")
@pytest.mark.parametrize(
    "text",
    [
        model(),
        model(JOINT + INERTIAL + '<site name="s"/><geom size="0.1"/>'),
        model(link='axisangle="0 0 1 0.5"'),
        model(link='euler="0.1 0.2 0.3"', compiler='angle="radian" eulerseq="zyx"'),
        model(joint('range="-1 1" actuatorfrcrange="-2 2" armature="1" damping="2"')),
        model('<joint name="j" type="ball" pos="0 0 0.1"/>' + INERTIAL),
        model('<joint axis="0 1 0" range="-1 1"/>' + INERTIAL),
        model(JOINT + '<joint name="k" axis="1 0 0" range="-2 1" pos="0 0 .1"/>' + INERTIAL),
        model(JOINT + INERTIAL).replace("name='link'", ""),
        model().replace("<body name='base' >", "<body name='base'><freejoint/>"),
        model(JOINT + '<geom size="0.1"/>', before='<default><geom density="100"/></default>'),
        model(JOINT + INERTIAL + '<geom type="mesh" mesh="t"/>',
              before=MESH.format('scale="2 2 2"')),
    ],
)  # fmt: skip
def test_what_the_reader_gets_right_is_not_blamed(folder: Path, text: str) -> None:
    column = read(folder, text).column(READER)
    assert column.ok, column.differences


@pytest.mark.usefixtures("in_process")
def test_a_frame_below_the_world_leaves_no_model(folder: Path) -> None:
    text = model().replace("<worldbody>", "<worldbody><frame>")
    report = read(folder, text.replace("</worldbody>", "</frame></worldbody>"))
    assert "a <frame> right below <worldbody> is not read" in report.column(READER).failure
    assert report.ok


def shift_limits(model: Any) -> None:
    model.lowerPositionLimit = model.lowerPositionLimit - 0.01


def add_mass(model: Any) -> None:
    model.inertias[1].mass += 0.01


def shift_root(model: Any) -> None:
    frame = model.frames[model.getBodyId("base")]
    frame.placement = frame.placement * pin.SE3(np.eye(3), np.array([0.1, 0, 0]))


@pytest.mark.usefixtures("in_process")
@pytest.mark.parametrize(
    ("title", "tamper", "quantity"),
    [
        ("ref", shift_limits, "joint range"),
        ("mesh mass", add_mass, "mass"),
        ("root pose", shift_root, "body offset"),
    ],
)
def test_a_cause_needs_the_number_that_it_predicts(
    folder: Path, monkeypatch: pytest.MonkeyPatch, title: str, tamper: Any, quantity: str
) -> None:
    def wrong(path: Path, timeout: float) -> reader.ReaderResult:
        found = here(path, timeout)
        tamper(found.model)
        return found

    monkeypatch.setattr(check_module, "read_with_pinocchio", wrong)
    # the feature is in the file, and the number is not the one that it would give
    unexplained = read(folder, MISTAKES[title][0]).column(READER).unexplained
    assert quantity in {d.quantity for d in unexplained}
    assert all(d.cause == d.reason == "" for d in unexplained)


@pytest.mark.usefixtures("in_process")
def test_limits_of_zero_in_a_urdf_are_named(tmp_path: Path) -> None:
    text = URDF_ARM.replace('lower="-1" upper="2" effort="5"', 'lower="0" upper="0" effort="0"')
    path = tmp_path / "arm.urdf"
    path.write_text(text, encoding="utf-8")
    column = crosscheck(path, n_configurations=1).column(READER)
    assert [d.quantity for d in column.faults] == ["joint range", "effort limit"]
    assert set(column.causes) == {"zero limits"}


@pytest.mark.slow
def test_the_reader_runs_in_a_child_process(folder: Path) -> None:
    report = read(folder, model(base='pos="1 0 0"'))
    assert list(report.column(READER).causes) == ["root pose"]


@pytest.mark.parametrize(
    ("script", "reason"), [("kill -SEGV $$", "signal 11"), ("exec sleep 9", "no answer within")]
)
def test_a_reader_that_crashes_or_hangs_is_reported(
    folder: Path, monkeypatch: pytest.MonkeyPatch, script: str, reason: str
) -> None:
    path = folder / "model.xml"
    path.write_text(model(), encoding="utf-8")
    put_for_python(folder, monkeypatch, f'for last; do :; done; touch "$last/started"; {script}')
    report = crosscheck(path, n_configurations=1, timeout=0.3, judge_reader=True)
    assert reason in report.column(READER).failure
    assert "cause unknown" in report.column(READER).failure
    assert not report.ok


@pytest.mark.parametrize(
    ("script", "reason"),
    [("exit 0", "ended with code 0"), ("exec sleep 9", "no answer"), ("kill -9 $$", "signal 9")],
)
def test_a_reader_that_cannot_start_is_an_error_and_no_agreement(
    folder: Path, monkeypatch: pytest.MonkeyPatch, script: str, reason: str
) -> None:
    path = folder / "model.xml"
    path.write_text(model(), encoding="utf-8")
    put_for_python(folder, monkeypatch, script)
    with pytest.raises(PlannerError, match=f"did not start: .*{reason}.*--no-own-reader"):
        crosscheck(path, n_configurations=1, timeout=0.3)


def put_for_python(folder: Path, monkeypatch: pytest.MonkeyPatch, script: str) -> None:
    """Let child processes run a shell script instead of Python."""
    program = folder / "python"
    program.write_text(f"#!/bin/sh\n{script}\n", encoding="utf-8")
    program.chmod(0o755)
    monkeypatch.setattr("sys.executable", str(program))


@pytest.mark.slow
def test_nothing_of_the_current_folder_is_run(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran = tmp_path / "ran"
    here = tmp_path / "project"
    (here / "sim").mkdir(parents=True)
    for name in ("pinocchio.py", "numpy.py", "sim/__init__.py", "planner.py"):
        text = f"open({str(ran)!r}, 'a').write({name!r}); raise SystemExit"
        (here / name).write_text(text, encoding="utf-8")
    monkeypatch.chdir(here)
    report = read(folder, model(base='pos="1 0 0"'))
    assert list(report.column(READER).causes) == ["root pose"]  # it did read
    assert not ran.exists()


# --- report, command and errors -------------------------------------------------------------------


def test_the_report_is_json_and_a_table() -> None:
    report = crosscheck("allegro_hand", n_configurations=1)
    data = json.loads(json.dumps(report.to_dict(), allow_nan=False))
    assert (data["kind"], data["schema"], data["ok"]) == ("crosscheck", 1, True)
    assert {c["quantity"] for c in data["columns"][0]["cells"]} <= set(QUANTITIES)
    assert crosscheck_tables(report)[0].row_count == len(data["columns"][0]["cells"])
    other = compare_models("allegro_hand", "shadow_hand", n_configurations=1).to_dict()
    assert json.loads(json.dumps(other, allow_nan=False))["ok"] is False


def test_a_report_prints_as_a_screen() -> None:
    text = str(crosscheck("allegro_hand", n_configurations=1))
    assert text.splitlines()[0].endswith("all judged quantities agree (1 configurations, seed 0)")
    assert "bridge: 33 quantities agree" in text
    text = str(compare_models("allegro_hand", "shadow_hand", n_configurations=1))
    assert "differs" in text.splitlines()[0]
    assert " more in .faults" in text
    assert "joints present of index_0 differs" in text
    assert len(text.splitlines()) <= 24
    assert len(text) < 2000


@pytest.mark.usefixtures("in_process")
def test_a_printed_report_names_causes_and_failures(folder: Path) -> None:
    text, key = MISTAKES["ref"]
    assert f"{key}: ref 0.3491 is subtracted from the range" in str(read(folder, text))
    bare = model().replace("<body name='base'", "<frame><body name='base'")
    failed = read(folder, bare.replace("</worldbody>", "</frame></worldbody>"))
    assert "Pinocchio's reader (not judged): " in str(failed)


@pytest.mark.parametrize(("stretch", "turned"), [(1.0, True), (1.02, False)])
def test_a_turn_is_told_from_a_stretched_orientation(stretch: float, turned: bool) -> None:
    """A third of a turn is a rotation, though it is not its own inverse."""
    rotation = stretch * pin.exp3(np.array([0.0, 0.0, 2.0]))
    reader: Any = SimpleNamespace(local=lambda part, site: SimpleNamespace(rotation=rotation))
    assert Context.turned(reader, "tip") == turned


def test_every_known_cause_has_its_evidence() -> None:
    named = {cause["evidence"] for cause in causes._known()}
    assert named == set(EVIDENCE)
    assert {q for cause in causes._known() for q in cause["quantities"]} <= set(QUANTITIES)


def test_exit_codes_are_those_of_a_ci(tmp_path: Path) -> None:
    right, wrong = tmp_path / "right.xml", tmp_path / "wrong.xml"
    right.write_text(MJCF_ARM, encoding="utf-8")
    wrong.write_text(MJCF_ARM.replace('mass="0.2"', 'mass="0.2001"'), encoding="utf-8")
    run = CliRunner().invoke
    base = ["crosscheck", str(right), "--configurations", "1", "--no-own-reader"]
    done = run(app, base)
    assert done.exit_code == 0, done.output
    assert "all judged quantities agree" in done.output
    against = [*base, "--against", str(wrong)]
    done = run(app, [*against, "--json"])
    assert done.exit_code == 1
    faults = [d for d in json.loads(done.stdout)["columns"][0]["differences"] if d["part"]]
    assert (faults[0]["quantity"], faults[0]["part"]) == ("mass", "lower")
    loose = ["--parameters", "1e-3", "--dynamics", "1e-2", "--kinematics", "1e-3"]
    assert run(app, [*against, *loose]).exit_code == 0
    assert run(app, ["crosscheck", str(tmp_path / "gone.xml")]).exit_code == 3
    assert run(app, [*against, "--same", "elbow"]).exit_code == 3
    assert run(app, [*base, "--parameters", "-1"]).exit_code == 3
    report = tmp_path / "report.json"
    assert run(app, [*base, "--out", str(report)]).exit_code == 0
    assert json.loads(report.read_text(encoding="utf-8"))["kind"] == "crosscheck"


def test_bad_input_is_named(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"a int is no model; give the path"):
        crosscheck(3)
    with pytest.raises(NotFoundError, match=r"^gone\.xml does not exist; give a hand\.toml"):
        crosscheck("gone.xml")
    with pytest.raises(TaskError, match=r"n_configurations 0; give .* at least one"):
        crosscheck("allegro_hand", n_configurations=0)
    with pytest.raises(TaskError, match=r"tolerance distance is nan; give a finite number >= 0"):
        Tolerances(distance=float("nan"))


# --- hands of other projects ----------------------------------------------------------------------


@pytest.mark.usefixtures("in_process")
@pytest.mark.parametrize(
    ("name", "causes"),
    [
        ("gymnasium-robotics:shadow", {"first body only", "root pose", "root site"}),
        ("example-robot-data:allegro_right", {"balanced inertia"}),
        ("robosuite:jaco_three_finger", {"actuators", "equalities", "fixed chain", "joint range"}),
        ("robosuite:robotiq_3f", {"equalities", "joint range", "root pose", "root site"}),
    ],
)
def test_hands_of_others_agree_and_the_reader_is_seen_through(name: str, causes: set[str]) -> None:
    hand_of_others(name)
    report = crosscheck(name, n_configurations=1)
    assert report.ok, report.faults
    assert set(report.column(READER).causes) == causes
    assert report.column(READER).unexplained == ()


def test_impossible_inertias_of_a_file_are_balanced_and_named(tmp_path: Path) -> None:
    text = (
        '<mujoco><worldbody><body><joint axis="0 0 1"/><inertial pos="0 0 0" mass="1" '
        'diaginertia="{}"/></body></worldbody></mujoco>'
    )
    rod, sound = tmp_path / "rod.xml", tmp_path / "sound.xml"
    rod.write_text(text.format("1 1 3"))
    sound.write_text(text.format("1 2 3"))
    found = compiled(rod)
    (note,) = found.notes
    assert "some inertias are impossible" in note and "balanced" in note
    np.testing.assert_allclose(found.model.body_inertia[1], [5 / 3] * 3)
    assert compiled(sound).notes == ()


LOWER_BOX = (
    '<collision><origin xyz="0 0 0.025"/><geometry><box size="0.014 0.014 0.044"/></geometry>'
    "</collision>"
)
FILE_FAULTS = {
    "a joint's place": ('xyz="0 0 0.02"', 'xyz="0 0 0.021"', "body offset", "lower"),
    "a joint's turn": ('rpy="0.1 0 0"', 'rpy="0.101 0 0"', "body turn", "lower"),
    "an axis": ('<axis xyz="0 1 0"/><limit lower="0" upper="1.5"',
        '<axis xyz="0.001 1 0"/><limit lower="0" upper="1.5"', "joint axis", "bend"),
    "a kind": ('name="bend" type="revolute"', 'name="bend" type="prismatic"', "joint kind", "bend"),
    "a mimic's ratio": ('multiplier="0.8"', 'multiplier="0.81"', "equality rows", "equality0"),
    "a lost mimic": ('<mimic joint="bend" multiplier="0.8"/>', "", "equality rows", "equality0"),
    "a mass": ('value="0.03"', 'value="0.0301"', "mass", "lower"),
    "a centre of mass": ('<origin xyz="0 0 0.015"/><mass', '<origin xyz="0 0 0.0155"/><mass',
        "link centre", "upper"),
    "a moment of inertia": ('ixx="4e-6"', 'ixx="4.1e-6"', "inertia", "upper"),
    "a product of inertia": ('izz="1e-6" ixy="0"', 'izz="1e-6" ixy="2e-7"', "inertia", "upper"),
    "an upper limit": ('upper="1.5"', 'upper="1.49"', "joint range", "bend"),
    "a lower limit": ('lower="0" upper="1.2"', 'lower="-0.01" upper="1.2"', "joint range", "tip"),
    "an effort": ('upper="1.5" effort="1"', 'upper="1.5" effort="1.1"', "effort limit", "bend"),
    "a speed": ('upper="1.2" effort="1" velocity="5"', 'upper="1.2" effort="1" velocity="5.5"',
        "velocity limit", "tip"),
    "a lost speed": ('upper="1.2" effort="1" velocity="5"', 'upper="1.2" effort="1"',
        "velocity limit", "tip"),
    "damping": ('damping="0.01"', 'damping="0.011"', "damping", "bend"),
    "friction": ('friction="0.02"', 'friction="0.021"', "dry friction", "bend"),
    "a radius": ('radius="0.009"', 'radius="0.0099"', "geometry size", "upper_geom0"),
    "a longer box": ("0.014 0.014 0.044", "0.014 0.014 0.045", "geometry size", "lower_geom0"),
    "a geometry's place": ('<collision><origin xyz="0 0 0.03"/>',
        '<collision><origin xyz="0.001 0 0.03"/>', "geometry offset", "upper_geom0"),
    "a geometry's turn": ('<collision><origin xyz="0 0 0.025"/>',
        '<collision><origin xyz="0 0 0.025" rpy="0 0.001 0"/>', "geometry turn", "lower_geom0"),
    "a geometry's kind": ('<sphere radius="0.009"/>', '<cylinder radius="0.009" length="0.018"/>',
        "geometry kind", "upper_geom0"),
    "a lost geometry": (LOWER_BOX, "", "geometries present", "lower_geom0"),
    "one geometry more": (LOWER_BOX,
        LOWER_BOX + '<collision><geometry><sphere radius="0.001"/></geometry></collision>',
        "geometries present", "lower_geom1 (not in the reference)"),
    "a link's name": ('"upper"', '"outer"', "bodies present", "upper"),
}  # fmt: skip
"""Faults put into the tutorial's file: text, what stands for it, then quantity and part told."""


@pytest.mark.parametrize("title", FILE_FAULTS)
def test_every_fault_in_the_file_of_the_tutorial_is_named(tmp_path: Path, title: str) -> None:
    old, new, quantity, part = FILE_FAULTS[title]
    assert old in FINGER
    right, wrong = tmp_path / "finger.urdf", tmp_path / "edited.urdf"
    right.write_text(FINGER, encoding="utf-8")
    wrong.write_text(FINGER.replace(old, new), encoding="utf-8")
    assert compare_models(right, right, n_configurations=1).ok
    report = compare_models(right, wrong, n_configurations=1)
    assert not report.ok
    told = {(d.quantity, d.part) for d in report.columns[0].faults}
    assert (quantity, part) in told
    # nothing else is blamed, but for the joint that a name or a kind takes along
    assert title in ("a kind", "a link's name") or told == {(quantity, part)}, told


def test_a_geometry_on_another_link_is_told_on_both(tmp_path: Path) -> None:
    right, wrong = tmp_path / "finger.urdf", tmp_path / "edited.urdf"
    right.write_text(FINGER, encoding="utf-8")
    text = FINGER.replace(LOWER_BOX, "").replace("</link>\n</robot>", f"{LOWER_BOX}</link></robot>")
    wrong.write_text(text, encoding="utf-8")
    faults = compare_models(right, wrong, n_configurations=1).columns[0].faults
    assert [(d.part, d.reference.split(" on ")[-1], d.value.split(" on ")[-1]) for d in faults] == [
        ("lower_geom0", "lower", "none"),
        ("upper_geom1 (not in the reference)", "none", "upper"),
    ]


def test_a_geometry_written_otherwise_is_the_same(tmp_path: Path) -> None:
    one = """<mujoco><worldbody><body name="b"><joint name="j"/>
      <geom type="box" size="0.01 0.02 0.03" pos="0 0.1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.1" size="0.01"/>
      <geom type="ellipsoid" size="0.03 0.02 0.01" pos="0.2 0 0"/></body></worldbody></mujoco>"""
    other = """<mujoco><worldbody><body name="b"><joint name="j"/>
      <geom type="ellipsoid" size="0.02 0.03 0.01" pos="0.2 0 0" euler="0 0 90"/>
      <geom type="capsule" fromto="0 0 0.1 0 0 0" size="0.01"/>
      <geom type="box" size="0.01 0.03 0.02" pos="0 0.1 0" euler="90 0 0"/>
      </body></worldbody></mujoco>"""
    tolerances = Tolerances(kinematics=1e-9)  # masses are added up in another order
    for text in (one, other):
        report = compare_models(
            mujoco.MjSpec.from_string(one),
            mujoco.MjSpec.from_string(text),
            n_configurations=1,
            tolerances=tolerances,
        )
        assert report.ok, report.faults


@pytest.mark.parametrize(("change", "told"), [(1.0, set()), (1.1, {"geometry"})])
def test_meshes_are_compared_by_their_hulls(tmp_path: Path, change: float, told: set[str]) -> None:
    solid = trimesh.creation.icosphere(subdivisions=1, radius=0.02)
    solid.apply_translation([0.01, 0, 0])
    solid.export(tmp_path / "ball.stl")
    solid.apply_scale(change)
    solid.export(tmp_path / "ball.ply")
    text = FINGER.replace('<sphere radius="0.009"/>', '<mesh filename="ball.{}"/>')
    paths = [tmp_path / f"{suffix}.urdf" for suffix in ("stl", "ply")]
    for path in paths:
        path.write_text(text.format(path.stem), encoding="utf-8")
    report = compare_models(*paths, n_configurations=1)
    assert {d.quantity for d in report.columns[0].faults} == told


def test_an_inertia_that_no_body_can_have_is_noted(tmp_path: Path) -> None:
    path = tmp_path / "finger.urdf"
    path.write_text(FINGER, encoding="utf-8")
    assert crosscheck(path, n_configurations=1, own_reader=False).notes == ()
    path.write_text(FINGER.replace('ixx="4e-6" iyy="4e-6"', 'ixx="0.4" iyy="0.4"'))
    report = crosscheck(path, n_configurations=1, own_reader=False)
    (note,) = report.notes
    assert "upper has an inertia of 0.4 kg m2" in note and "radius of gyration of 4.47e+03" in note
    assert report.ok  # both engines read it alike
