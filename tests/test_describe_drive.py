"""What drives a described hand: shared tendons, rotors, damping, couplings that postures keep."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
from test_describe import claw, urdf, written

from planner.bridge import load_spec
from planner.describe import Proposal, check_hand, propose
from planner.describe.drive import _listed
from planner.describe.postures import PostureSolver
from planner.errors import HandError
from planner.hand_loading import hand_from_spec
from planner.hands.hand import Hand
from planner.joints.couplings import Coupling, nearest_on_couplings
from planner.joints.description import CouplingDescription

pytestmark = pytest.mark.usefixtures("brief_postures")

NAMES = ("thumb", "left", "right")

SHARED_TIP = """
    <geom name="{name}_b" type="capsule" fromto="0 0 0 0 0 0.03" size="0.007" mass="0.02"/>
    <body name="{name}_c" pos="0 0 0.03">
      <joint name="{name}_c" axis="0 1 0" range="0 1.4"/>
      <geom name="{name}_ball" type="capsule" fromto="0 0 0 0 0 0.02" size="0.009" mass="0.01"/>
    </body>
"""


def shared() -> str:
    """A claw of three joints a finger, of which one tendon drives the last two together."""
    text = claw(tip=SHARED_TIP).replace(
        '_b" axis="0 1 0" range="-0.6 1.4"', '_b" axis="0 1 0" range="0 1.4"'
    )
    tendons = "".join(
        f'<fixed name="{n}_t"><joint joint="{n}_b" coef="1"/>'
        f'<joint joint="{n}_c" coef="1"/></fixed>'
        for n in NAMES
    )
    text = text.replace("<actuator>", f"<tendon>{tendons}</tendon><actuator>")
    for n in NAMES:
        text = text.replace(f'joint="{n}_b" kp', f'name="{n}_pull" tendon="{n}_t" kp')
    return text


@pytest.fixture(scope="module")
def proposed() -> Proposal:
    return propose(mujoco.MjSpec.from_string(shared()))


def test_joints_that_share_a_tendon_get_a_stop_and_no_motor(proposed: Proposal) -> None:
    d = proposed.description
    assert d.actuators == ()
    assert d.joint_defaults.least_armature is None and d.joint_defaults.armature is None
    # a contact on the pad stretches the joint nearer to the palm, to the end of its range at 0
    assert d.couplings == tuple(
        CouplingDescription(name=f"{n}_b_stop", joints={f"{n}_b": 1.0}, value=0.0, kind="stop")
        for n in NAMES
    )
    why = next(r.why for r in proposed.reasons if r.key == "couplings.thumb_b_stop")
    assert "thumb_pull drives thumb_b and thumb_c together" in why
    assert "No motor and no tie is added" in why
    hand = hand_from_spec(mujoco.MjSpec.from_string(shared()), d)
    assert hand.actuation.moment.shape == (6, 9)
    assert hand.posture("pinch")[hand.joint_index("thumb_b")] == 0.0


def test_joints_that_close_the_other_way_stop_at_the_other_end() -> None:
    # the same claw with every axis turned about
    text = shared().replace('"-0.6 1.4"', '"-1.4 0.6"').replace('"0 1.4"', '"-1.4 0"')
    text = text.replace('axis="0 1 0"', 'axis="0 -1 0"')
    couplings = propose(mujoco.MjSpec.from_string(text)).description.couplings
    assert {(tuple(c.joints.values()), c.value, c.kind) for c in couplings} == {
        ((-1.0,), 0.0, "stop")
    }


def test_without_its_stops_such_a_hand_is_refused_with_what_to_write(proposed: Proposal) -> None:
    bare = proposed.description.model_copy(update={"couplings": ()})
    with pytest.raises(HandError, match=r"hold their sum alone \('thumb_pull' drives") as refused:
        hand_from_spec(mujoco.MjSpec.from_string(shared()), bare)
    for text in ("thumb_b = 1.0", 'kind = "stop"', 'kind = "equality"', "right_pull"):
        assert text in str(refused.value)


def test_tied_joints_need_no_new_postures(proposed: Proposal) -> None:
    ties = tuple(
        CouplingDescription(
            name=f"{n}_tie", joints={f"{n}_b": 1.0, f"{n}_c": -1.0}, kind="equality"
        )
        for n in NAMES
    )
    tied = proposed.description.model_copy(update={"couplings": ties})
    hand = hand_from_spec(mujoco.MjSpec.from_string(shared()), tied)
    matrix, value = hand.coupling_matrix
    for name in ("open", "pinch"):
        q, letter = hand.posture(name), hand.described_posture(name)
        assert np.abs(matrix @ letter - value).max() > 0.05
        np.testing.assert_allclose(matrix @ q, value, atol=1e-7)
        assert (q >= hand.q_lower).all() and (q <= hand.q_upper).all()
        # both joints of a pair meet half-way, and nothing else moves
        for n in NAMES:
            b, c = hand.joint_index(f"{n}_b"), hand.joint_index(f"{n}_c")
            assert q[b] == pytest.approx((letter[b] + letter[c]) / 2, abs=1e-7)
            a = hand.joint_index(f"{n}_a")
            assert q[a] == pytest.approx(letter[a], abs=1e-7)
    notes = [f for f in check_hand(hand).findings if "violates couplings" in f.what]
    assert len(notes) == len(hand.description.postures) >= 2  # of every candidate
    assert all(f.level == "note" and "thumb_b = " in f.what_to_do for f in notes)


def test_a_posture_that_keeps_its_couplings_stays_to_the_bit(shadow: Hand) -> None:
    for name in shadow.description.postures:
        assert (shadow.posture(name) == shadow.described_posture(name)).all()


def test_the_nearest_joints_on_couplings_keep_ranges() -> None:
    lower, upper = np.array([0.0, 0.0, -1.0]), np.array([1.0, 0.5, 1.0])
    tie = Coupling(name="tie", row=np.array([1.0, -1.0, 0.0]), value=0.0, one_sided=False)
    q = nearest_on_couplings(np.array([1.0, 0.4, 0.2]), [tie], lower, upper)
    assert q is not None
    # d/dx of ((x - 1) / 1)^2 + ((x - 0.4) / 0.5)^2 is 0 at x = 0.52, beyond the second range
    np.testing.assert_allclose(q, [0.5, 0.5, 0.2], atol=1e-8)
    far = Coupling(name="far", row=np.array([1.0, 0.0, 0.0]), value=2.0, one_sided=False)
    assert nearest_on_couplings(np.zeros(3), [far], lower, upper) is None


def test_a_rounded_posture_keeps_the_range_of_a_joint_that_follows(tmp_path: Path) -> None:
    # the follower ends at 0.5003 where the free joint is at 1.0006: rounded to 1.001 it would pass
    text = urdf(mimic=True)
    for n in ("f1", "f2", "f3"):
        head, tail = text.split(f'<joint name="{n}.1"')
        tail = tail.replace('upper="1.4"', 'upper="0.5003"', 1)
        text = f'{head}<joint name="{n}.1"{tail}'
    path = written(tmp_path, text, "claw.urdf")
    hand = hand_from_spec(load_spec(path), propose(path).description)
    solver = PostureSolver(hand, hand.choose_fingers())
    q = hand.neutral.copy()
    q[[hand.joint_index(f"{n}.0") for n in ("f1", "f2", "f3")]] = 1.0006
    rounded = solver.rounded(q)
    assert (rounded <= hand.q_upper).all() and (rounded >= hand.q_lower).all()
    matrix, value = hand.coupling_matrix
    np.testing.assert_allclose(matrix @ rounded, value, atol=1e-7)
    np.testing.assert_allclose(rounded[hand.joint_index("f1.0")], 1.0006, atol=1e-6)


def without_servos(joint: str) -> str:
    text = re.sub(r"<actuator>.*</actuator>", "", claw(), flags=re.DOTALL)
    return text.replace('axis="0 1 0"', f'axis="0 1 0" {joint}')


def damping_of(text: str) -> tuple[Hand, float]:
    """A hand as described, and the damping over the critical one of its slowest joint."""
    spec = mujoco.MjSpec.from_string(text)
    hand = hand_from_spec(spec, propose(spec).description)
    data = mujoco.MjData(hand.mj_model)
    data.qpos[:] = hand.neutral
    mujoco.mj_forward(hand.mj_model, data)
    full = np.zeros((hand.nq, hand.nq))
    mujoco.mj_fullM(hand.mj_model, data, full)
    kp, kv = -hand.actuation.bias[:, 1], -hand.actuation.bias[:, 2]
    joint = np.argmax(hand.actuation.moment, axis=1)
    total = kv + hand.mj_model.dof_damping[joint]
    return hand, float((total / (2 * np.sqrt(kp * np.diag(full)[joint]))).min())


def test_a_rotor_of_the_model_stays_and_the_servo_is_damped_for_it() -> None:
    hand, share = damping_of(without_servos('armature="0.1" damping="0.75"'))
    np.testing.assert_array_equal(hand.mj_model.dof_armature, 0.1)
    assert hand.description.joint_defaults.least_armature is None
    # the joint's own damping counts: without it the hand would take 0.7 s to close
    assert share == pytest.approx(1.0, abs=0.05)


def test_joints_without_a_rotor_get_one_beside_those_that_have_one() -> None:
    text = without_servos("").replace('name="thumb_a" axis', 'name="thumb_a" armature="0.05" axis')
    hand, share = damping_of(text)
    expected = np.full(hand.nq, 2e-4)
    expected[hand.joint_index("thumb_a")] = 0.05
    np.testing.assert_allclose(hand.mj_model.dof_armature, expected)
    assert share >= 0.95


def test_a_posture_is_looked_for_within_the_ranges_of_joints_that_follow(tmp_path: Path) -> None:
    # free joints could bend to 1.4, but their followers, at half of it, end at 0.2
    text = urdf(mimic=True)
    for n in ("f1", "f2", "f3"):
        head, tail = text.split(f'<joint name="{n}.1"')
        tail = tail.replace('upper="1.4"', 'upper="0.2"', 1)
        text = f'{head}<joint name="{n}.1"{tail}'
    path = written(tmp_path, text, "claw.urdf")
    hand = hand_from_spec(load_spec(path), propose(path).description)
    solver = PostureSolver(hand, hand.choose_fingers())
    q = solver.candidates()[0].pinch.q
    matrix, value = hand.coupling_matrix
    # clipped to its ranges, a posture that ignored them would leave the couplings
    np.testing.assert_allclose(matrix @ q, value, atol=0.02)


def test_a_long_list_of_joints_tells_how_many_more_there_are() -> None:
    joints = ("a", "b", "c", "d", "e")
    assert _listed(joints[:3]) == "a, b, c"
    assert _listed(joints) == "a, b, c and 2 other joints"
