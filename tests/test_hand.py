"""``Hand``: fingers, pads, couplings, postures and checks of a configuration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import FrozenInstanceError
from pathlib import Path

import coal
import mujoco
import numpy as np
import pytest

from planner.errors import HandError, NotFoundError, TaskError
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.shapes.convex_pairs import DistancePair
from planner.spatial import SE3, FloatArray, contact_frames

EditHand = Callable[..., Path]


def test_fingers_and_joints_of_both_hands(allegro: Hand, shadow: Hand) -> None:
    assert {f.name: len(f.joints) for f in allegro.fingers.values()} == {
        "thumb": 4,
        "index": 4,
        "middle": 4,
        "ring": 4,
    }
    assert {f.name: len(f.joints) for f in shadow.fingers.values()} == {
        "thumb": 5,
        "index": 4,
        "middle": 4,
        "ring": 4,
        "little": 5,
    }
    assert (allegro.nq, len(allegro.actuation.names)) == (16, 16)
    assert (shadow.nq, len(shadow.actuation.names)) == (24, 20)


def test_every_joint_belongs_to_one_finger_or_to_the_wrist(right_hand: Hand) -> None:
    owned = [i for f in right_hand.fingers.values() for i in f.q_index] + [*right_hand.wrist_index]
    assert sorted(owned) == list(range(right_hand.nq))
    for finger in right_hand.fingers.values():
        assert tuple(right_hand.joint_names[i] for i in finger.q_index) == finger.joints


def test_every_body_of_a_finger_moves_with_that_finger_alone(right_hand: Hand) -> None:
    # a body is a finger's if the finger's joints move it: asked of MuJoCo's own tree
    model = right_hand.mj_model
    for finger in right_hand.fingers.values():
        expected = set()
        for b in range(1, model.nbody):
            welded = int(model.body_weldid[b])  # the body whose joint moves this one
            first, count = int(model.body_jntadr[welded]), int(model.body_jntnum[welded])
            joints = {model.joint(j).name for j in range(first, first + count)}
            if joints & set(finger.joints):
                expected.add(model.body(b).name)
        assert finger.bodies == expected


def test_only_the_shadow_has_a_wrist(allegro: Hand, shadow: Hand) -> None:
    assert len(allegro.wrist_index) == 0
    assert [shadow.joint_names[i] for i in shadow.wrist_index] == ["WRJ2", "WRJ1"]


def directions_in_cone(axis: FloatArray, half_angle: float, count: int) -> FloatArray:
    """Unit directions (count + 1, 3) within a cone, its axis first and its rim included."""
    rng = np.random.default_rng(0)
    _, t1, t2 = contact_frames(axis)[0].T
    angle = half_angle * np.sqrt(rng.uniform(0, 1, count))
    angle[: count // 4] = half_angle
    turn = rng.uniform(0, 2 * np.pi, count)
    rim = np.cos(turn)[:, None] * t1 + np.sin(turn)[:, None] * t2
    return np.vstack([axis, np.cos(angle)[:, None] * axis + np.sin(angle)[:, None] * rim])


def test_a_pad_is_the_outer_surface_of_its_link_within_its_cone(right_hand: Hand) -> None:
    # 2 mm above the pad, the nearest part of everything rigid with it is 2 mm away.
    probe, height = 1e-4, 2e-3
    for finger in right_hand.fingers.values():
        pad = finger.pad
        link = [g for g in right_hand.geometries if g.joint_id == pad.joint_id]
        assert pad.geom in [g.name for g in link]
        for direction in directions_in_cone(pad.axis, pad.half_angle, 40):
            point = pad.center + (pad.radius + height + probe) * direction
            gaps = {
                g.name: DistancePair(g.geometry, coal.Sphere(probe))
                .query(g.T_joint_geometry, SE3(np.eye(3), point))
                .distance
                for g in link
            }
            assert gaps[pad.geom] == pytest.approx(height, abs=1e-6)
            assert min(gaps.values()) == pytest.approx(height, abs=1e-6)


def test_couplings_of_the_shadow_are_the_stops_of_its_distal_joints(shadow: Hand) -> None:
    matrix, value = shadow.coupling_matrix
    assert matrix.shape == (4, 24)
    np.testing.assert_array_equal(value, 0)
    assert all(c.one_sided for c in shadow.couplings)
    for row, prefix in zip(matrix, ("FF", "MF", "RF", "LF"), strict=True):
        expected = np.zeros(24)
        expected[shadow.joint_index(f"{prefix}J2")] = 1
        expected[shadow.joint_index(f"{prefix}J1")] = -1
        np.testing.assert_array_equal(row, expected)


def test_a_hand_without_couplings_has_an_empty_matrix(allegro: Hand) -> None:
    matrix, value = allegro.coupling_matrix
    assert (matrix.shape, value.shape) == ((0, 16), (0,))


def test_postures_keep_the_couplings_and_the_limits(right_hand: Hand) -> None:
    matrix, value = right_hand.coupling_matrix
    for name in right_hand.description.postures:
        q = right_hand.posture(name)
        assert (q >= right_hand.q_lower).all()
        assert (q <= right_hand.q_upper).all()
        np.testing.assert_allclose(matrix @ q, value, rtol=0, atol=1e-12)


def test_a_joint_that_a_posture_does_not_name_is_at_zero_or_its_nearest_limit(
    edit_hand: EditHand,
) -> None:
    hand = load_hand(edit_hand({"thumb_0 = 1.323\n": ""}))
    q = hand.posture("open")
    assert q[hand.joint_index("thumb_0")] == 0.263  # its range is 0.263 to 1.396
    assert q[hand.joint_index("index_0")] == 0


def test_an_unknown_posture_or_joint_is_answered_with_what_there_is(allegro: Hand) -> None:
    with pytest.raises(NotFoundError, match=r"no posture of allegro_hand .*mean 'pinch'.*open, "):
        allegro.posture("pinsh")
    with pytest.raises(NotFoundError, match=r"no joint of allegro_hand .*'index_1'"):
        allegro.joint_index("indx_1")


# --- configurations -------------------------------------------------------------------------------


def test_q_of_another_length_is_refused(allegro: Hand) -> None:
    with pytest.raises(HandError, match=r"q has shape \(24,\); allegro_hand needs \(16,\)"):
        allegro.checked_q(np.zeros(24))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_q_that_is_not_finite_is_refused(allegro: Hand, bad: float) -> None:
    q = allegro.posture("open")
    q[3] = bad
    with pytest.raises(HandError, match="start holds NaN or infinity"):
        allegro.checked_q(q, "start")


def test_the_worst_joint_outside_its_range_is_named(allegro: Hand) -> None:
    q = allegro.posture("open")
    q[allegro.joint_index("index_1")] = 1.7
    q[allegro.joint_index("thumb_0")] = 0.0
    message = (
        r"start: joint thumb_0 is at 0\.0000, outside its range \[0\.2630, 1\.3960\]; bring it"
    )
    with pytest.raises(HandError, match=message):
        allegro.checked_q(q, "start")


def test_q_at_its_limits_is_accepted_and_copied(right_hand: Hand) -> None:
    for limit in (right_hand.q_lower, right_hand.q_upper):
        checked = right_hand.checked_q(limit)
        np.testing.assert_array_equal(checked, limit)
        assert checked is not limit
    assert right_hand.checked_q(right_hand.q_lower.tolist()).dtype == np.float64


# --- fingers that take part -----------------------------------------------------------------------


def test_fingers_are_chosen_in_the_order_asked(shadow: Hand) -> None:
    assert [f.name for f in shadow.choose_fingers(["ring", "thumb"])] == ["ring", "thumb"]


def test_fingers_by_default_are_the_description_s(shadow: Hand) -> None:
    default = [f.name for f in shadow.choose_fingers()]
    assert default == ["thumb", "index", "middle", "ring"]


def test_without_a_default_all_fingers_take_part(edit_hand: EditHand) -> None:
    hand = load_hand(edit_hand({'default_fingers = ["thumb", "index", "middle", "ring"]\n': ""}))
    assert [f.name for f in hand.choose_fingers()] == list(hand.fingers)


def test_a_finger_named_twice_is_refused(allegro: Hand) -> None:
    with pytest.raises(TaskError, match=r"named twice in \['thumb', 'index', 'thumb'\]; name each"):
        allegro.choose_fingers(["thumb", "index", "thumb"])


def test_an_unknown_finger_is_answered_with_the_nearest(allegro: Hand) -> None:
    with pytest.raises(NotFoundError, match=r"no finger of allegro_hand .*Did you mean 'thumb'\?"):
        allegro.choose_fingers(["thum"])


# --- identity -------------------------------------------------------------------------------------


def test_the_digest_follows_both_files(edit_hand: EditHand, allegro: Hand) -> None:
    assert load_hand(edit_hand()).digest == allegro.digest
    digests = {
        allegro.digest,
        load_hand(edit_hand({"index_1 = 0.6\n": "index_1 = 0.61\n"})).digest,
        load_hand(edit_hand(xml={'kp="3"': 'kp="4"'})).digest,
    }
    assert len(digests) == 3


def test_a_hand_cannot_be_changed_by_accident(allegro: Hand) -> None:
    with pytest.raises(FrozenInstanceError):
        allegro.name = "other"  # type: ignore[misc]
    with pytest.raises(TypeError):
        allegro.fingers["extra"] = allegro.fingers["index"]  # type: ignore[index]
    allegro.q_lower[:] = 7
    assert allegro.q_lower[0] == -0.47
    allegro.palm_normal[:] = 7
    np.testing.assert_array_equal(allegro.palm_normal, [1, 0, 0])


def test_a_new_spec_is_fresh_and_compiles_to_the_same_model(right_hand: Hand) -> None:
    spec = right_hand.new_spec()
    spec.worldbody.add_body(name="extra")
    model = right_hand.new_spec().compile()
    with pytest.raises(KeyError):
        model.body("extra")
    assert model.nbody == right_hand.mj_model.nbody
    data, ours = mujoco.MjData(model), mujoco.MjData(right_hand.mj_model)
    for m, d in ((model, data), (right_hand.mj_model, ours)):
        d.qpos[:] = right_hand.posture("pinch")
        mujoco.mj_kinematics(m, d)
    np.testing.assert_array_equal(data.geom_xpos, ours.geom_xpos)


def test_neutral_is_zero_or_the_nearest_end_of_the_range(right_hand: Hand) -> None:
    neutral = right_hand.neutral
    spans_zero = (right_hand.q_lower <= 0) & (right_hand.q_upper >= 0)
    np.testing.assert_array_equal(neutral[spans_zero], 0)
    for k in np.flatnonzero(~spans_zero):
        ends = np.array([right_hand.q_lower[k], right_hand.q_upper[k]])
        assert neutral[k] == ends[np.argmin(np.abs(ends))] != 0
    right_hand.checked_q(neutral)
