"""Hand descriptions proposed from structure alone, against hands whose description is known."""

from __future__ import annotations

import json
import re
import time
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import coal
import mujoco
import numpy as np
import pinocchio as pin
import pytest
from conftest import hand_of_others
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.bridge import hand_geometries, load_spec
from planner.bridge.pinocchio_model import pinocchio_from_mujoco
from planner.bridge.structure import structure_of
from planner.describe import Proposal, description_text, postures, propose, write_proposal
from planner.describe.drive import impossible_couplings
from planner.describe.fingertips import ConvexLink, cone_directions, sphere_directions
from planner.describe.overlaps import HandGaps
from planner.describe.postures import PostureCandidate, PostureSolver
from planner.describe.tree import finger_names, read_tree
from planner.errors import FileFormatError, HandError, ModelError, NotFoundError
from planner.hand_loading import hand_from_spec, load_hand
from planner.hands.description_toml import read_description
from planner.hands.hand import Hand
from planner.joints.couplings import Coupling
from planner.kinematics import HandState
from planner.shapes.convex_pairs import DistancePair
from planner.spatial import SE3
from planner.synthesis.seeds.opposition import opposition
from planner.system.package import models_dir
from planner.task import GraspTask

pytestmark = pytest.mark.usefixtures("brief_postures")

WHOLE_SEARCH = {name: getattr(postures, name) for name in ("RADII", "FIRST", "STARTS")}
"""What ``brief_postures`` makes small."""

FINGER = """
<body name="{name}_a" pos="{x} {y} 0.02" euler="0 0 {turn}">
  <joint name="{name}_a" axis="0 1 0" range="{low} {high}"/>
  <geom name="{name}_a" type="capsule" fromto="0 0 0 0 0 0.05" size="0.008" mass="0.03"/>
  <body name="{name}_b" pos="0 0 0.05">
    <joint name="{name}_b" axis="0 1 0" range="{low} {high}"/>
    {tip}
  </body>
</body>
"""
BALL_TIP = """
    <geom name="{name}_b" type="capsule" fromto="0 0 0 0 0 0.03" size="0.007" mass="0.02"/>
    <geom name="{name}_ball" type="sphere" pos="0 0 0.03" size="0.011" mass="0.005"/>
"""


def claw(
    *,
    names: tuple[str, ...] = ("thumb", "left", "right"),
    tip: str = BALL_TIP,
    angle: str = 'angle="radian"',
    turns: tuple[float, float, float] = (0.0, np.pi, np.pi),
    limits: tuple[float, float] = (-0.6, 1.4),
    ctrl: str = "-1 2",
) -> str:
    """A palm that faces +z with three fingers that close over it: the first against the others."""
    places = ((-0.035, 0.0), (0.035, 0.025), (0.035, -0.025))
    low, high = limits
    fingers = "".join(
        FINGER.format(name=n, x=x, y=y, turn=t, low=low, high=high, tip=tip.format(name=n))
        for n, (x, y), t in zip(names, places, turns, strict=True)
    )
    driven = "".join(
        f'<position joint="{n}_{k}" kp="4" forcerange="-1 1" ctrlrange="{ctrl}"/>'
        for n in names
        for k in "ab"
    )
    return f"""
    <mujoco model="claw">
      <compiler {angle} autolimits="true"/>
      <worldbody>
        <geom name="floor" type="plane" size="1 1 1"/>
        <body name="cube" pos="0.5 0 0"><freejoint/><geom type="box" size=".02 .02 .02"/></body>
        <body name="palm" pos="0 0 0.4">
          <geom type="box" size="0.04 0.04 0.02" mass="0.3"/>{fingers}
        </body>
      </worldbody>
      <actuator>{driven}</actuator>
    </mujoco>"""


def model_of(hand: str) -> Path:
    return models_dir() / "hands" / hand / f"{hand}.xml"


Known = tuple[Hand, Proposal, tuple[PostureCandidate, ...]]


@pytest.fixture(scope="module", params=["allegro_hand", "shadow_hand"])
def known(request: pytest.FixtureRequest) -> Known:
    """A shipped hand, the proposal for its bare model, and the candidates for its postures.

    The search is whole for the smaller of the two.
    """
    found: list[tuple[PostureCandidate, ...]] = []
    search = PostureSolver.candidates

    def noted(solver: PostureSolver) -> tuple[PostureCandidate, ...]:
        found.append(search(solver))
        return found[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(PostureSolver, "candidates", noted)
        for name, value in WHOLE_SEARCH.items() if request.param == "allegro_hand" else ():
            patch.setattr(postures, name, value)
        proposal = propose(model_of(request.param))
    return load_hand(request.param), proposal, found[0]


@pytest.fixture(scope="module")
def proposed_claw(tmp_path_factory: pytest.TempPathFactory) -> Proposal:
    return propose(written(tmp_path_factory.mktemp("claw"), claw()))


def written(folder: Path, text: str, name: str = "claw.xml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def test_a_bare_model_gives_the_anatomy_of_the_shipped_description(
    known: Known,
) -> None:
    hand, proposal, _ = known
    ours, theirs = proposal.description, hand.description
    assert ours.base_body == theirs.base_body
    assert ours.palm_body == theirs.palm_body
    assert ours.palm_normal == pytest.approx(theirs.palm_normal)
    assert ours.wrist_joints == theirs.wrist_joints
    assert ours.default_fingers == theirs.default_fingers
    assert {f.name: f.joints for f in ours.fingers} == {f.name: f.joints for f in theirs.fingers}
    assert not proposal.open_questions
    assert not ours.actuators and ours.joint_defaults == theirs.joint_defaults
    assert ours.repair == theirs.repair and ours.allowed_contacts == theirs.allowed_contacts


def test_a_bare_model_gives_the_pads_of_the_shipped_description(
    known: Known,
) -> None:
    hand, proposal, _ = known
    theirs = {f.name: f for f in hand.description.fingers}
    for finger in proposal.description.fingers:
        expected = theirs[finger.name]
        assert finger.tip_site == expected.tip_site
        assert finger.pad.geom == expected.pad.geom
        assert finger.pad.center == pytest.approx(expected.pad.center, abs=1e-6)
        assert finger.pad.radius == pytest.approx(expected.pad.radius, abs=1e-6)
        assert finger.pad.axis == pytest.approx(expected.pad.axis, abs=1e-6)
        assert abs(finger.pad.half_angle_deg - expected.pad.half_angle_deg) <= 5.0


def test_stops_of_tendon_coupled_fingers_are_found_with_their_side(
    known: Known,
) -> None:
    hand, proposal, _ = known
    found = {(frozenset(c.joints.items()), c.value, c.kind) for c in proposal.description.couplings}
    expected = {(frozenset(c.joints.items()), c.value, c.kind) for c in hand.description.couplings}
    assert found == expected


def test_proposed_postures_oppose_the_thumb_to_the_others(known: Known) -> None:
    hand, proposal, _ = known
    spec = mujoco.MjSpec.from_file(str(model_of(hand.name)))
    proposed = hand_from_spec(spec, proposal.description)
    task = GraspTask.create(proposed, "sphere")
    gaps = {}
    for name in ("pinch", "open"):
        q = proposed.posture(name)
        found = opposition(task, q)
        assert task.finger_names[found.opposer] == "thumb"
        gaps[name] = found.gap
        state = HandState(proposed, q)
        for i, finger in enumerate(task.fingers):
            look = found.axis if i == found.opposer else -found.axis
            assert state.pad_axis(finger) @ look > np.cos(np.deg2rad(60.0))
    assert 0.03 <= gaps["pinch"] <= 0.07
    assert gaps["open"] >= gaps["pinch"] + 0.03


def test_the_same_model_gives_the_same_proposal(proposed_claw: Proposal) -> None:
    again = propose(proposed_claw.description.model)
    assert again == proposed_claw


def test_every_guess_has_a_reason(known: Known) -> None:
    _, proposal, _ = known
    keys = {r.key for r in proposal.reasons}
    d = proposal.description
    expected = {"base_body", "palm_body", "palm_normal", "default_fingers"}
    expected |= {f"fingers.{f.name}.{part}" for f in d.fingers for part in ("joints", "tip", "pad")}
    expected |= {f"couplings.{c.name}" for c in d.couplings}
    expected |= {f"postures.{p}" for p in d.postures}
    assert expected <= keys
    assert all(r.why and r.value for r in proposal.reasons)


def test_a_claw_of_three_capsule_fingers(proposed_claw: Proposal) -> None:
    d = proposed_claw.description
    assert (d.name, d.base_body, d.palm_body) == ("claw", "palm", "palm")
    assert d.palm_normal == (0.0, 0.0, 1.0)  # the fingers close against each other and point up
    assert [f.name for f in d.fingers] == ["thumb", "finger2", "finger3"]
    assert d.default_fingers == ("thumb", "finger2", "finger3")
    thumb = d.fingers[0]
    assert thumb.joints == ("thumb_a", "thumb_b")
    assert thumb.pad.geom == "thumb_ball" and thumb.pad.radius == pytest.approx(0.011)
    assert thumb.pad.center == pytest.approx((0.0, 0.0, 0.03))
    # rotation about +y moves what points up towards +x
    assert thumb.pad.axis == pytest.approx((np.sqrt(0.5), 0.0, np.sqrt(0.5)))
    assert thumb.tip is not None and thumb.tip.position == pytest.approx((0.0, 0.0, 0.03))


def test_the_palm_is_the_body_that_most_fingers_are_on(tmp_path: Path) -> None:
    """And not a heavier one at the wrist, however it is fixed to it."""
    text = claw().replace(
        '<body name="palm" pos="0 0 0.4">',
        '<body name="flange"><geom type="cylinder" size="0.02 0.01" mass="9"/>'
        '<body name="palm" pos="0 0 0.4">',
    )
    path = written(tmp_path, text.replace("</worldbody>", "</body></worldbody>"))
    assert propose(path).description.palm_body == "palm"


def test_the_closing_side_is_the_larger_side_of_the_range(tmp_path: Path) -> None:
    # the same fingers with their axes turned about: they close at negative angles
    path = written(tmp_path, claw(limits=(-1.4, 0.6), turns=(np.pi, 0.0, 0.0)))
    description = propose(path).description
    assert description.fingers[0].pad.axis == pytest.approx((-np.sqrt(0.5), 0.0, np.sqrt(0.5)))
    assert description.postures["pinch"]["thumb_b"] < 0


def test_postures_of_a_claw_are_wide_and_narrow(proposed_claw: Proposal, tmp_path: Path) -> None:
    spec = mujoco.MjSpec.from_string(claw())
    hand = hand_from_spec(spec, proposed_claw.description)
    task = GraspTask.create(hand, "sphere")
    pinch, wide = (opposition(task, hand.posture(p)).gap for p in ("pinch", "open"))
    assert 0.02 < pinch < wide


def stage() -> str:
    """Three fingers that hang from a ring 0.28 m above the base, 120 degrees apart, joints +-90."""
    fingers = ""
    for k in range(3):
        turn = 2 * np.pi * k / 3
        place = f"{0.05 * np.sin(turn):.6f} {-0.05 * np.cos(turn):.6f} 0.28"
        fingers += f"""
        <body name="f{k}_a" pos="{place}" euler="0 0 {turn:.6f}">
          <joint name="f{k}_swing" axis="0 1 0" range="-1.57 1.57"/>
          <geom type="sphere" size="0.02" mass="0.1"/>
          <body name="f{k}_b"><joint name="f{k}_lift" axis="1 0 0" range="-1.57 1.57"/>
            <geom type="capsule" fromto="0 0 0 0 0 -0.15" size="0.01" mass="0.1"/>
            <body name="f{k}_c" pos="0 0 -0.15">
              <joint name="f{k}_curl" axis="1 0 0" range="-3.0 3.0"/>
              <geom type="capsule" fromto="0 0 0 0 0 -0.14" size="0.008" mass="0.05"/>
              <geom type="sphere" pos="0 0 -0.14" size="0.01" mass="0.01"/>
            </body>
          </body>
        </body>"""
    return f"""
    <mujoco model="stage"><compiler angle="radian" autolimits="true"/>
      <worldbody><body name="floor">
        <geom type="cylinder" pos="0 0 0.32" size="0.09 0.01" mass="1"/>{fingers}
      </body></worldbody>
    </mujoco>"""


def test_a_stage_whose_base_is_the_floor_has_its_palm_above_the_fingertips() -> None:
    spec = mujoco.MjSpec.from_string(stage())
    proposal = propose(spec)
    assert not [q for q in proposal.open_questions if "no good" in q]
    hand = hand_from_spec(spec, proposal.description)
    np.testing.assert_allclose(hand.palm_point, [0.0, 0.0, 0.28], atol=1e-6)
    q = np.zeros(9)
    for k in range(3):
        q[[hand.joint_index(f"f{k}_lift"), hand.joint_index(f"f{k}_curl")]] = -0.9, 1.7
    assert opposition(GraspTask.create(hand, "sphere:0.03"), q).palm_side[2] > 0.9
    np.testing.assert_array_equal(load_hand("shadow_hand").palm_point, np.zeros(3))


def test_candidates_differ_and_the_first_is_followed_over_more_openings(
    known: Known,
) -> None:
    hand, proposal, candidates = known
    spec = mujoco.MjSpec.from_file(str(model_of(hand.name)))
    proposed = hand_from_spec(spec, proposal.description)
    assert 1 <= len(candidates) <= 3
    scores = [c.score for c in candidates]
    assert scores == sorted(scores, reverse=True)
    names = set(proposal.description.postures)
    assert names == {f"{p}{s}" for p in ("open", "pinch") for s in ("", "_2", "_3")[: len(scores)]}
    span = proposed.q_upper - proposed.q_lower
    for a, b in combinations(candidates, 2):
        assert (np.abs(a.pinch.q - b.pinch.q) / span).max() > 0.1
    for candidate in candidates:
        assert candidate.pinch.good and candidate.wide.radius > candidate.pinch.radius
        # pads touch an object of that radius: recomputed from the joints alone
        state = HandState(proposed, candidate.pinch.q)
        for finger in proposed.choose_fingers():
            away = np.linalg.norm(candidate.pinch.point - state.pad_center(finger))
            reach = finger.pad.radius + candidate.pinch.radius
            assert away >= reach - 0.004
            assert candidate.bar or away <= reach + 0.004


@pytest.mark.parametrize("name", ["allegro_hand", "shadow_hand"])
def test_postures_are_one_where_every_joint_is_within_an_eighth_of_its_range(name: str) -> None:
    hand = load_hand(name)
    solver = PostureSolver(hand, hand.choose_fingers())
    span = (hand.q_upper - hand.q_lower)[solver._free]
    one = hand.neutral[solver._free]
    off = np.where(np.arange(len(span)) % 2, 0.11, -0.11) * span
    assert solver._alike(one, one) and solver._alike(one, one + off)
    for k in range(len(span)):
        far = off.copy()
        far[k] = -0.13 * span[k]
        assert not solver._alike(one, one + far) and not solver._alike(one + far, one)


def test_distances_with_memory_are_those_without(known: Known) -> None:
    hand, _, _ = known
    near, rng = 0.01, np.random.default_rng(1)
    gaps, data = HandGaps(hand, near), hand.pin_model.createData()
    q = hand.posture("pinch")
    compared = 0
    for step in (0.0, 1e-8, 1e-8, 1e-3, 1e-2, 1e-8, 0.3, 0.02):
        q = np.clip(q + step * rng.standard_normal(hand.nq), hand.q_lower, hand.q_upper)
        pin.forwardKinematics(hand.pin_model, data, q)
        ours, fresh = gaps.between_parts(data.oMi), HandGaps(hand, np.inf).between_parts(data.oMi)
        close = fresh <= near
        np.testing.assert_allclose(ours[close], fresh[close], atol=1e-9)
        assert (ours <= fresh + 1e-9).all()  # a lower bound elsewhere
        compared += int(close.sum())
    assert compared > 10


@pytest.fixture(scope="module")
def of_spec() -> tuple[mujoco.MjSpec, Proposal]:
    spec = mujoco.MjSpec.from_string(claw())
    return spec, propose(spec)


def test_a_spec_and_a_compiled_model_give_what_the_file_gives(
    proposed_claw: Proposal, of_spec: tuple[mujoco.MjSpec, Proposal]
) -> None:
    spec, from_spec = of_spec
    from_model = propose(mujoco.MjModel.from_xml_string(claw()))
    changed = {"model": from_spec.description.model}
    assert from_spec.description == proposed_claw.description.model_copy(update=changed)
    assert from_model.description.fingers == proposed_claw.description.fingers
    assert any("made in Python" in q for q in from_spec.open_questions)
    assert len(spec.bodies) == len(mujoco.MjSpec.from_string(claw()).bodies)  # left as it was


def test_a_file_in_radians_that_is_read_in_degrees_is_repaired(tmp_path: Path) -> None:
    # without the unit, -0.6 .. 1.4 are two degrees
    proposal = propose(written(tmp_path, claw(angle="")))
    assert proposal.description.repair.angle == "radian"
    assert any(r.key == "repair.angle" and "degrees" in r.why for r in proposal.reasons)


URDF_FINGER = """
<link name="{n}_a"><inertial><mass value="0.03"/><origin xyz="0 0 0.02"/>
  <inertia ixx="{ixx}" iyy="1e-5" izz="2e-6" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><origin xyz="0 0 0.025"/>
    <geometry><box size="0.014 0.014 0.05"/></geometry></collision>
</link>
<joint name="{n}.0" type="revolute"><parent link="palm"/><child link="{n}_a"/>
  <origin xyz="{x} {y} 0.02" rpy="0 0 {turn}"/><axis xyz="0 1 0"/>
  <limit lower="-0.6" upper="1.4" effort="{effort}" velocity="5"/>
  <dynamics damping="{damping}" friction="{friction}"/></joint>
<link name="{n}_b"><inertial><mass value="0.02"/><origin xyz="0 0 0.015"/>
  <inertia ixx="6e-6" iyy="6e-6" izz="2e-6" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><origin xyz="0 0 0.03"/><geometry><sphere radius="0.011"/></geometry></collision>
</link>
<joint name="{n}.1" type="revolute"><parent link="{n}_a"/><child link="{n}_b"/>
  <origin xyz="0 0 0.05"/><axis xyz="0 1 0"/>
  <limit lower="-0.6" upper="1.4" effort="{effort}" velocity="5"/>
  <dynamics damping="{damping}" friction="{friction}"/>{mimic}</joint>
"""


def urdf(
    *,
    effort: float = 0.9,
    damping: float = 0.02,
    friction: float = 0.0,
    ixx: float = 1e-5,
    mimic: bool = False,
) -> str:
    places = (("f1", -0.035, 0.0, 0.0), ("f2", 0.035, 0.025, np.pi), ("f3", 0.035, -0.025, np.pi))
    fingers = "".join(
        URDF_FINGER.format(
            n=n,
            x=x,
            y=y,
            turn=turn,
            effort=effort,
            damping=damping,
            friction=friction,
            ixx=ixx,
            mimic=f'<mimic joint="{n}.0" multiplier="0.5"/>' if mimic else "",
        )
        for n, x, y, turn in places
    )
    return f"""<robot name="claw"><link name="palm">
      <inertial><mass value="0.3"/><inertia ixx="3e-4" iyy="3e-4" izz="3e-4" ixy="0" ixz="0"
      iyz="0"/></inertial><collision><geometry><box size="0.08 0.08 0.04"/></geometry></collision>
      </link>{fingers}</robot>"""


def test_a_urdf_gets_servos_from_its_efforts(tmp_path: Path) -> None:
    proposal = propose(written(tmp_path, urdf(), "claw.urdf"))
    (servos,) = proposal.description.actuators
    assert servos.joints == ("f1.0", "f1.1", "f2.0", "f2.1", "f3.0", "f3.1")
    assert servos.force_limit == 0.9
    assert servos.kp == pytest.approx(3.6)  # the whole force at 0.25 rad
    assert proposal.description.joint_defaults.damping is None
    assert proposal.description.joint_defaults.frictionloss is None
    # the structure alone says which finger is opposed to the others
    assert [f.name for f in proposal.description.fingers] == ["thumb", "finger2", "finger3"]
    hand = load_hand(tmp_path / "claw.urdf")
    assert hand.actuation.moment.shape == (6, 6)


def test_fillers_in_a_urdf_are_not_believed(tmp_path: Path) -> None:
    text = urdf(effort=15.0, damping=10.0, friction=12.0, ixx=1e-9)
    proposal = propose(written(tmp_path, text, "claw.urdf"))
    d = proposal.description
    assert d.repair.balance_inertia  # a rod cannot have so little inertia about one axis
    assert d.actuators[0].force_limit == 0.7
    assert d.joint_defaults.frictionloss == 0.0
    assert d.joint_defaults.damping is not None and d.joint_defaults.damping < 0.2
    assert any("15" in q and "force_limit" in q for q in proposal.open_questions)


def test_inertias_that_no_link_can_have_are_replaced_by_those_of_the_geometry(
    tmp_path: Path,
) -> None:
    assert 'ixx="1e-05"' in urdf()
    text = re.sub(r'(ixx|iyy|izz)="[^"]*"', r'\1="0.1"', urdf())
    proposal = propose(written(tmp_path, text, "claw.urdf"))
    mended = proposal.description.repair.inertia_from_geometry
    assert len(mended) == 6 and "palm" not in mended  # what carries the hand does not swing
    assert any("0.1 kg m2" in q and "5 more such bodies" in q for q in proposal.open_questions)
    hand = hand_from_spec(load_spec(tmp_path / "claw.urdf"), proposal.description)
    assert hand.mj_model.body_inertia[2:].max() < 1e-4
    (tmp_path / "hand.toml").write_text(description_text(proposal.description, tmp_path))
    again = load_hand(tmp_path / "hand.toml")
    np.testing.assert_array_equal(again.mj_model.body_inertia, hand.mj_model.body_inertia)


@pytest.mark.parametrize("base", [None, "palm"])
def test_closed_loops_are_named_as_what_they_are(tmp_path: Path, base: str | None) -> None:
    loop = '<connect name="rod" body1="thumb_a" body2="left_b" anchor="0 0 0"/>'
    text = claw().replace("<actuator>", f"<equality>{loop}</equality><actuator>")
    with pytest.raises(HandError, match=r"has closed loops: rod tie.*<equality><joint"):
        propose(written(tmp_path, text), base_body=base)


def test_a_weld_within_one_link_closes_no_loop(proposed_claw: Proposal, tmp_path: Path) -> None:
    body = re.search(r'<body name="thumb_b"[^>]*>', claw())
    assert body is not None
    nail = '<body name="nail"><geom size="0.001" mass="1e-6" contype="0" conaffinity="0"/></body>'
    weld = '<equality><weld name="glue" body1="nail" body2="thumb_b"/></equality>'
    text = claw().replace(body[0], body[0] + nail).replace("<actuator>", f"{weld}<actuator>")
    proposal = propose(written(tmp_path, text))
    assert proposal.description.fingers == proposed_claw.description.fingers
    assert not hand_from_spec(load_spec(tmp_path / "claw.xml"), proposal.description).couplings


@pytest.mark.parametrize("tag", ["<collision ", '<visual radius="0" ', "<inertial>"])
def test_a_broken_urdf_is_refused_at_once(tag: str, tmp_path: Path) -> None:
    path = tmp_path / "hand.urdf"
    path.write_text("<robot>" + tag * 20_000, encoding="utf-8")
    begin = time.process_time()
    with pytest.raises(ModelError):
        load_hand(path)
    assert time.process_time() - begin < 2.0


def test_a_mass_without_inertia_and_a_ball_of_no_size_are_read(tmp_path: Path) -> None:
    whole = urdf()
    inertia = re.search(r"\s*<inertia [^>]*/>", whole)
    assert inertia is not None
    nothing = '<collision><geometry><sphere radius="0.00"/></geometry></collision></link>'
    text = whole.replace(inertia[0], "", 1).replace("</link>", nothing, 1)
    first = Path(written(tmp_path, text, "claw.urdf"))
    spec = load_spec(first)
    assert len(spec.geoms) == len(load_spec(written(tmp_path, whole, "whole.urdf")).geoms)
    proposal = propose(first)
    assert any("an inertia that no body has" in q for q in proposal.open_questions)


def test_joints_that_mimic_others_get_no_servo(tmp_path: Path) -> None:
    proposal = propose(written(tmp_path, urdf(mimic=True), "claw.urdf"))
    (servos,) = proposal.description.actuators
    assert servos.joints == ("f1.0", "f2.0", "f3.0")
    assert not proposal.description.couplings  # the loader finds them in the model
    hand = hand_from_spec(load_spec(tmp_path / "claw.urdf"), proposal.description)
    assert hand.posture("pinch")[1] == pytest.approx(0.5 * hand.posture("pinch")[0])


def test_couplings_that_freeze_their_joints_are_impossible() -> None:
    lower, upper = np.zeros(2), np.ones(2)
    frozen = Coupling(name="sum", row=np.array([1.0, 1.0]), value=0.0, one_sided=False)
    beyond = Coupling(name="far", row=np.array([1.0, -1.0]), value=1.5, one_sided=False)
    fine = Coupling(name="half", row=np.array([1.0, -0.5]), value=0.0, one_sided=False)
    assert impossible_couplings([frozen, beyond, fine], lower, upper) == ("sum", "far")


def test_joints_that_are_coupled_with_an_offset_follow_it(allegro: Hand) -> None:
    row = np.zeros(allegro.nq)
    row[allegro.joint_index("index_3")], row[allegro.joint_index("index_2")] = 1.0, -0.5
    tied = replace(allegro, couplings=(Coupling(name="tie", row=row, value=0.3, one_sided=False),))
    solver = PostureSolver(tied, tied.choose_fingers())
    q = solver.complete(np.full(tied.nq - 1, 0.4))
    assert row @ q == pytest.approx(0.3)
    assert q[allegro.joint_index("index_2")] == 0.4 or q[allegro.joint_index("index_3")] == 0.4


def test_a_coupling_that_the_ranges_forbid_is_dropped_and_asked_for(tmp_path: Path) -> None:
    equality = (
        '<equality><joint name="tie" joint1="thumb_a" joint2="thumb_b" polycoef="3 1 0 0 0"/>'
        "</equality>"
    )
    text = claw().replace("<actuator>", equality + "<actuator>")
    proposal = propose(written(tmp_path, text))
    assert proposal.description.repair.drop_couplings == ("tie",)
    assert any("tie" in q for q in proposal.open_questions)


def test_links_that_always_overlap_are_excluded(tmp_path: Path) -> None:
    # an invisible knuckle between palm and link, and a link that starts inside the palm
    text = claw().replace(
        '<body name="thumb_b" pos="0 0 0.05">',
        '<body name="hub" pos="0 0 0.05"><joint name="hub" axis="1 0 0" range="-0.1 0.1"/>'
        '<inertial pos="0 0 0" mass="0.01" diaginertia="1e-6 1e-6 1e-6"/><body name="thumb_b">',
    )
    text = text.replace(
        'name="thumb_ball" type="sphere" pos="0 0 0.03" size="0.011" mass="0.005"/>\n\n  </body>',
        'name="thumb_ball" type="sphere" pos="0 0 0.03" size="0.011" mass="0.005"/>\n\n'
        "  </body></body>",
    )
    text = text.replace(
        "</actuator>", '<position joint="hub" kp="4" forcerange="-1 1"/></actuator>'
    )
    description = propose(written(tmp_path, text)).description
    assert description.repair.exclude == (("thumb_a", "thumb_b"),)
    assert description.fingers[0].joints == ("thumb_a", "hub", "thumb_b")


def hull_tip(radius: float) -> str:
    """A tip that is a mesh: a ball's points on a short bone."""
    points = 0.03 * np.array([0.0, 0.0, 1.0]) + radius * sphere_directions(400)
    ring = 0.006 * np.array([[np.cos(t), np.sin(t), 0.0] for t in np.linspace(0, 6, 12)])
    text = " ".join(f"{v:.7f}" for v in np.vstack([points, ring]).ravel())
    return f'<mesh name="tip" vertex="{text}"/>'


def test_the_pad_of_a_rounded_hull_is_its_ball(tmp_path: Path) -> None:
    tip = '<geom name="{name}_b" type="mesh" mesh="tip" mass="0.02"/>'
    text = claw(tip=tip).replace("<worldbody>", f"<asset>{hull_tip(0.01)}</asset><worldbody>")
    description = propose(written(tmp_path, text)).description
    pad = description.fingers[0].pad
    assert pad.center == pytest.approx((0.0, 0.0, 0.03), abs=1e-3)
    assert pad.radius == pytest.approx(0.01, abs=5e-4)
    assert pad.half_angle_deg >= 40.0
    # the sphere touches the hull from inside: description and geometry fit, so the hand loads
    hand_from_spec(load_spec(tmp_path / "claw.xml"), description)


def test_a_flat_tip_is_told_as_such_and_loads(tmp_path: Path) -> None:
    tip = '<geom name="{name}_b" type="box" pos="0 0 0.015" size="0.004 0.009 0.02" mass="0.02"/>'
    proposal = propose(written(tmp_path, claw(tip=tip)))
    pad = proposal.description.fingers[0].pad
    assert pad.axis == pytest.approx((1.0, 0.0, 0.0))
    assert pad.radius == pytest.approx(0.004)
    assert sum("not round" in q for q in proposal.open_questions) == 3


def test_a_large_flat_hull_has_its_pad_on_the_face_and_not_in_the_edge(tmp_path: Path) -> None:
    # 15 x 25 x 50 mm with edges rounded by 1.5 mm: the ball of the edge is no pad of such a tip
    rounded = sphere_directions(600)
    half, edge = np.array([0.0075, 0.0125, 0.025]), 0.0015
    points = np.array([0.0, 0.0, 0.03]) + np.sign(rounded) * (half - edge) + edge * rounded
    asset = f'<mesh name="tip" vertex="{" ".join(f"{v:.6f}" for v in points.ravel())}"/>'
    tip = '<geom name="{name}_b" type="mesh" mesh="tip" mass="0.02"/>'
    text = claw(tip=tip).replace("<worldbody>", f"<asset>{asset}</asset><worldbody>")
    proposal = propose(written(tmp_path, text))
    pad = proposal.description.fingers[0].pad
    assert pad.axis == pytest.approx((1.0, 0.0, 0.0), abs=0.02)
    # half as thick as the tip, below the face, between its middle and its end
    assert pad.radius == pytest.approx(0.0075, abs=2e-4)
    assert pad.center[0] == pytest.approx(0.0, abs=2e-4)
    assert 0.035 < pad.center[2] < 0.045
    assert sum("not round" in q for q in proposal.open_questions) == 3
    hand_from_spec(load_spec(tmp_path / "claw.xml"), proposal.description)


def test_the_pad_of_a_cylinder_is_on_its_side_towards_the_tip(tmp_path: Path) -> None:
    tip = '<geom name="{name}_b" type="cylinder" pos="0 0 0.018" size="0.007 0.017" mass="0.02"/>'
    description = propose(written(tmp_path, claw(tip=tip))).description
    pad = description.fingers[0].pad
    assert pad.axis == pytest.approx((1.0, 0.0, 0.0), abs=1e-6)
    assert pad.radius == pytest.approx(0.007)
    assert pad.center == pytest.approx((0.0, 0.0, 0.018 + 0.0085), abs=1e-6)


def test_a_joint_that_bends_both_ways_closes_as_the_one_before_it(tmp_path: Path) -> None:
    both_ways = claw().replace('_b" axis="0 1 0" range="-0.6 1.4"', '_b" axis="0 1 0" range="-1 1"')
    proposal = propose(written(tmp_path, both_ways))
    assert not any("which way it closes" in q for q in proposal.open_questions)
    assert all(f.pad.axis[0] > 0.5 for f in proposal.description.fingers)


def fingers_in_the_world() -> str:
    """The claw without its palm's body: the palm's box and the fingers lie in the world."""
    head, palm = claw().split('<body name="palm" pos="0 0 0.4">')
    inside, rest = palm.split("</body>\n      </worldbody>")
    return head + inside + "</worldbody>" + rest


def test_fingers_that_start_from_the_world_get_a_palm(tmp_path: Path) -> None:
    path = written(tmp_path, fingers_in_the_world())
    proposal = propose(path)
    made = proposal.description
    assert made.repair.world_body == made.base_body == made.palm_body
    assert [f.joints[0] for f in made.fingers] == ["thumb_a", "left_a", "right_a"]
    write_proposal(proposal, tmp_path / "hand.toml")
    hand = load_hand(tmp_path / "hand.toml")
    # the palm's box belongs to it; the floor and the free cube do not
    mine = [g for g in hand.geometries if g.body == made.palm_body]
    assert [g.kind for g in mine] == ["box"]
    assert hand.nq == 6


def test_a_cover_that_follows_a_finger_is_no_finger(tmp_path: Path) -> None:
    cover = (
        '<body name="cover" pos="-0.06 0 0.02"><joint name="cover" axis="0 1 0" range="-0.6 1.4"/>'
        '<geom type="box" pos="0 0 0.02" size="0.002 0.01 0.02" mass="0.005"/></body></body>'
        "\n      </worldbody>"
    )
    follow = '<equality><joint joint1="cover" joint2="thumb_a"/></equality></mujoco>'
    text = claw().replace("</body>\n      </worldbody>", cover).replace("</mujoco>", follow)
    proposal = propose(written(tmp_path, text))
    assert len(proposal.description.fingers) == 3
    assert not any("cover belongs to no finger" in q for q in proposal.open_questions)


def test_an_actuator_by_the_pid_plugin_is_the_servo_of_its_gains(tmp_path: Path) -> None:
    servo = '<position joint="thumb_a" kp="4" forcerange="-1 1" ctrlrange="-1 2"/>'
    pid = (
        '<plugin name="thumb" plugin="mujoco.pid" instance="pid" joint="thumb_a" '
        'forcerange="-1 1" ctrlrange="-1 2" actdim="2"/>'
    )
    gains = (
        '<extension><plugin plugin="mujoco.pid"><instance name="pid"><config key="kp" value="2.5"/>'
        '<config key="ki" value="3"/><config key="kd" value="0.02"/>'
        '<config key="slewmax" value="3"/><config key="imax" value="0.1"/>'
        "</instance></plugin></extension><worldbody>"
    )
    text = claw().replace(servo, pid).replace("<worldbody>", gains)
    assert pid in text
    path = written(tmp_path, text)
    drive = hand_from_spec(load_spec(path), propose(path).description).actuation
    k = drive.names.index("thumb")
    assert drive.gain[k] == 2.5
    np.testing.assert_array_equal(drive.bias[k], (0.0, -2.5, -0.02))


def test_the_weight_of_a_hand_is_borne_once(tmp_path: Path) -> None:
    path = written(tmp_path, claw().replace("<body ", '<body gravcomp="1" '))
    hand = hand_from_spec(load_spec(path), propose(path).description)
    assert not hand.mj_model.body_gravcomp.any()


def test_a_gripper_of_two_fingers_is_said(tmp_path: Path) -> None:
    text = claw()
    start = text.index('<body name="right_a"')
    text = text[:start] + text[text.index("</body>", text.index("</body>", start) + 1) + 7 :]
    text = "".join(line for line in re.split(r"(?=<position)", text) if "right_" not in line[:30])
    if "</actuator>" not in text:
        text += "</actuator></mujoco>"
    proposal = propose(written(tmp_path, text))
    assert len(proposal.description.default_fingers) == 2
    assert any("gripper of two fingers" in q for q in proposal.open_questions)


def test_an_arm_upstream_is_left_out_and_said(tmp_path: Path) -> None:
    arm = "".join(
        f'<body name="arm{i}" pos="0 0 0.1"><joint name="arm{i}" axis="0 {i % 2} {(i + 1) % 2}" '
        'range="-1 1"/><geom type="capsule" fromto="0 0 0 0 0 0.06" size="0.02"/>'
        for i in range(4)
    )
    text = claw().replace('<body name="palm" pos="0 0 0.4">', arm + '<body name="palm">')
    text = text.replace("</worldbody>", "</body>" * 4 + "</worldbody>")
    proposal = propose(written(tmp_path, text))
    assert proposal.description.base_body == "palm"
    assert not proposal.description.wrist_joints
    assert any("arm" in q for q in proposal.open_questions)


def test_several_hands_need_a_choice(tmp_path: Path) -> None:
    second = claw(names=("a", "b", "c")).split('<body name="palm"')[1].split("</worldbody>")[0]
    text = claw().replace("</worldbody>", f'<body name="other"{second}</worldbody>')
    path = written(tmp_path, text)
    with pytest.raises(HandError, match=r"several hands.*'palm', 'other'.*base_body"):
        propose(path)
    assert propose(path, base_body="other").description.palm_body == "other"
    with pytest.raises(NotFoundError, match="othr"):
        propose(path, base_body="othr")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('<mujoco><worldbody><body><geom size="1"/></body></worldbody></mujoco>', "looks like a"),
        (claw().replace('range="-0.6 1.4"', ""), "have no range"),
        (
            claw(tip='<geom type="sphere" size="0.01" contype="0" conaffinity="0"/>'),
            "fingers whose last link can touch",
        ),
    ],
)
def test_what_is_no_hand_is_said(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(HandError, match=message):
        propose(written(tmp_path, text))


def test_what_is_no_model_is_said(tmp_path: Path) -> None:
    with pytest.raises(ModelError):
        propose(written(tmp_path, "<mujoco><worldbody/></mujoco>"))
    with pytest.raises(HandError, match="description already"):
        propose("allegro_hand")
    with pytest.raises(NotFoundError):
        propose(tmp_path / "missing.xml")


def test_a_written_proposal_reads_back(known: Known, tmp_path: Path) -> None:
    _, proposal, _ = known
    path = tmp_path / "hand.toml"
    write_proposal(proposal, path)
    read = read_description(path).description
    for ours, theirs in zip(read.fingers, proposal.description.fingers, strict=True):
        assert ours.pad.axis == pytest.approx(
            theirs.pad.axis, abs=1e-15
        )  # made a unit vector again
    fingers = tuple(f.model_copy(update={"pad": None}) for f in read.fingers)
    expected = tuple(f.model_copy(update={"pad": None}) for f in proposal.description.fingers)
    assert fingers == expected
    assert read.model_copy(update={"fingers": ()}) == proposal.description.model_copy(
        update={"fingers": ()}
    )
    text = path.read_text(encoding="utf-8")
    for reason in proposal.reasons:
        if not reason.key.endswith((".value", "_drive")):
            assert reason.why.split()[0] in text
    assert max(len(line) for line in text.splitlines() if line.startswith("#")) <= 100
    with pytest.raises(FileFormatError, match="exists already"):
        write_proposal(proposal, path)
    write_proposal(proposal, path, overwrite=True)
    with pytest.raises(FileFormatError, match="cannot write"):
        write_proposal(proposal, tmp_path / "no" / "hand.toml")


def test_a_model_beside_the_file_is_named_relatively(
    proposed_claw: Proposal, tmp_path: Path
) -> None:
    text = description_text(proposed_claw.description, Path(proposed_claw.description.model).parent)
    assert 'model = "claw.xml"' in text
    elsewhere = description_text(proposed_claw.description, tmp_path / "a")
    assert json.dumps(proposed_claw.description.model) in elsewhere


@pytest.mark.parametrize("friction", [0.0, 0.05])
def test_a_zero_that_was_proposed_is_written(
    proposed_claw: Proposal, friction: float, tmp_path: Path
) -> None:
    """A model's dry friction is replaced by none: not the same as leaving it as it is."""
    before = proposed_claw.description
    defaults = before.joint_defaults.model_copy(update={"frictionloss": friction})
    description = before.model_copy(update={"joint_defaults": defaults})
    path = tmp_path / "hand.toml"
    path.write_text(description_text(description, tmp_path), encoding="utf-8")
    read = read_description(path).description
    assert read.joint_defaults == description.joint_defaults
    assert read.joint_defaults.frictionloss == friction


@settings(max_examples=60, deadline=None)
@given(st.text(min_size=1, max_size=12), st.text(max_size=12), st.floats(-3, 3))
def test_any_name_survives_the_file(joint: str, geom: str, value: float) -> None:
    import tomllib

    from planner.describe.proposal import _line

    text = "\n".join(_line(joint, value) + _line("geom", geom) if joint != "geom" else [])
    expected = {} if joint == "geom" else {joint: value, "geom": geom}
    assert tomllib.loads(text) == expected


@pytest.mark.parametrize("kind", ["sphere", "capsule", "cylinder", "box", "ellipsoid", "mesh"])
def test_depth_is_what_coal_says_and_support_bounds_it(kind: str) -> None:
    rng = np.random.default_rng(1)
    points = " ".join(f"{v:.5f}" for v in 0.02 * rng.normal(size=(30, 3)).ravel())
    size = {"sphere": "0.02", "capsule": "0.01 0.03", "cylinder": "0.01 0.03"}.get(
        kind, "0.01 0.02 0.03"
    )
    shape = 'mesh="m"' if kind == "mesh" else f'size="{size}"'
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><asset><mesh name="m" vertex="{points}"/></asset><worldbody><body>'
        f'<joint name="j"/><geom name="g" type="{kind}" {shape} pos="0.01 0.02 0" '
        'euler="10 20 30"/></body></worldbody></mujoco>'
    )
    (geometry,) = hand_geometries(model, pinocchio_from_mujoco(model))
    solid = ConvexLink(geometry)
    directions = sphere_directions(3000)
    inside = 0
    for _ in range(60):
        x = solid.center + 0.012 * rng.normal(size=3)
        depth = solid.depth(x)
        point = DistancePair(geometry.geometry, coal.Sphere(1e-6))
        by_coal = -point.distance(geometry.T_joint_geometry, SE3(np.eye(3), x)) - 1e-6
        if by_coal > 1e-4:
            inside += 1
            tolerance = 2e-4 if kind == "ellipsoid" else 2e-5  # that one is sampled
            assert depth == pytest.approx(by_coal, abs=tolerance)
            assert (solid.support(directions) - directions @ x).min() >= depth - tolerance
        else:
            assert depth <= 1e-4
    assert inside >= 10


def test_cone_directions_are_unit_symmetric_and_within() -> None:
    axis = np.array([0.6, 0.0, 0.8])
    directions = cone_directions(axis, 0.5)
    assert np.allclose(np.linalg.norm(directions, axis=1), 1.0)
    assert (directions @ axis >= np.cos(0.5) - 1e-12).all()
    assert np.allclose(np.cross(directions.mean(axis=0), axis), 0.0, atol=1e-12)


def test_an_actuator_in_the_parent_s_axes_drives_its_joint(
    of_spec: tuple[mujoco.MjSpec, Proposal],
) -> None:
    text = claw()
    in_parent = text.replace("<position joint=", "<position jointinparent=")
    assert in_parent != text
    other = propose(mujoco.MjSpec.from_string(in_parent)).description
    assert of_spec[1].description == other
    assert other.actuators == ()  # no servos are missing


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (("r_thumb", "r_index", "r_middle_finger"), ["thumb", "index", "middle"]),
        (("robot0:TH", "robot0:FF", "robot0:LF"), ["thumb", "index", "little"]),
        (("spring", "tough", "offset"), ["finger1", "finger2", "finger3"]),
        (("index_1", "index_2", "ring"), ["finger1", "finger2", "ring"]),
    ],
)
def test_names_of_fingers(names: tuple[str, ...], expected: list[str]) -> None:
    structure = structure_of(mujoco.MjModel.from_xml_string(isolated(claw(names=names))))
    tree = read_tree(structure, "palm", "claw")
    found, reasons = finger_names(structure, tree.branches)
    assert found == expected
    assert len(reasons) == 3


def isolated(text: str) -> str:
    return text.replace("<freejoint/>", "")


FOREIGN: dict[str, dict[str, Any]] = {
    "gymnasium-robotics:shadow": {
        "base": "robot0:hand mount",
        "palm": "robot0:palm",
        "normal": (0.0, -1.0, 0.0),
        "wrist": 2,
        "fingers": ["index", "middle", "ring", "little", "thumb"],
        "pad": ("robot0:C_ffdistal", (0.0, 0.0, 0.024), 0.00705),
        "couplings": 4,
        "open": 0,
    },
    "example-robot-data:allegro_right": {
        "base": "palm_link",
        "palm": "palm_link",
        "normal": (1.0, 0.0, 0.0),
        "wrist": 0,
        "fingers": ["finger1", "finger2", "finger3", "thumb"],
        "pad": ("link_3.0_tip_geom0", (0.0, 0.0, 0.0), 0.012),
        "couplings": 0,
        "open": 1,
    },
    "robosuite:fourier_right": {
        "base": "right_hand",
        "palm": "r_palm",
        "normal": (0.0, 1.0, 0.0),
        "wrist": 0,
        "fingers": ["thumb", "index", "middle", "ring", "little"],
        "pad": ("R_thumb_distal_link_col", (0.03, 0.0, 0.0), 0.006),
        "couplings": 0,
        "open": 0,
    },
}
"""What the makers' files say, read by hand."""


@pytest.mark.slow
@pytest.mark.parametrize("name", FOREIGN)
def test_hands_of_others_are_described_from_structure_alone(name: str) -> None:
    hand_of_others(name)
    expected = FOREIGN[name]
    proposal = propose(name)
    d = proposal.description
    assert (d.base_body, d.palm_body) == (expected["base"], expected["palm"])
    assert d.palm_normal == expected["normal"]
    assert len(d.wrist_joints) == expected["wrist"]
    assert [f.name for f in d.fingers] == expected["fingers"]
    geom, center, radius = expected["pad"]
    pad = d.fingers[0].pad
    assert pad.geom == geom
    assert pad.center == pytest.approx(center, abs=2e-3)
    assert pad.radius == pytest.approx(radius, abs=1e-3)
    assert len(d.couplings) == expected["couplings"]
    assert len(proposal.open_questions) == expected["open"]
    assert d.model.startswith("package:")
