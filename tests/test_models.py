"""The hand models against the published figures, and against physics at the scenes' time step."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
import pytest

Array = npt.NDArray[np.float64]

HANDS = Path(__file__).resolve().parent.parent / "models" / "hands"
NAMES = ("shadow_hand", "allegro_hand")
POSTURES = ("zero", "open", "pinch")
SHADOW_PREFIX = {"index": "FF", "middle": "MF", "ring": "RF", "little": "LF"}

# Joint order, range (rad) and force limit (N m); None where a J0 tendon drives the joint.
SHADOW_JOINTS: dict[str, tuple[float, float, float | None]] = {
    "WRJ2": (-0.5236, 0.1745, 10),
    "WRJ1": (-0.6981, 0.4887, 5),
    **{
        f"{prefix}J{number}": row
        for prefix in ("FF", "MF", "RF", "LF")
        for number, row in (
            *(((5, (0.0, 0.7854, 1.0)),) if prefix == "LF" else ()),
            (4, (-0.3491, 0.3491, 1.0)),
            (3, (-0.2618, 1.5708, 1.0)),
            (2, (0.0, 1.5708, None)),
            (1, (0.0, 1.5708, None)),
        )
    },
    "THJ5": (-1.0472, 1.0472, 3),
    "THJ4": (0, 1.2217, 2),
    "THJ3": (-0.2094, 0.2094, 1),
    "THJ2": (-0.6981, 0.6981, 1),
    "THJ1": (-0.2618, 1.5708, 1),
}
_ALLEGRO_FINGER = ((-0.47, 0.47), (-0.196, 1.61), (-0.174, 1.709), (-0.227, 1.618))
_ALLEGRO_THUMB = ((0.263, 1.396), (-0.105, 1.163), (-0.189, 1.644), (-0.162, 1.719))
ALLEGRO_JOINTS: dict[str, tuple[float, float, float | None]] = {
    f"{finger}_{j}": (*limits, 0.7)
    for finger in ("index", "middle", "ring", "thumb")
    for j, limits in enumerate(_ALLEGRO_THUMB if finger == "thumb" else _ALLEGRO_FINGER)
}
JOINTS = {"shadow_hand": SHADOW_JOINTS, "allegro_hand": ALLEGRO_JOINTS}


class Model:
    """A compiled hand with its description, stepped as the scenes do."""

    def __init__(self, name: str) -> None:
        """Compile ``models/hands/NAME/NAME.xml`` and read the description beside it."""
        self.m: Any = mujoco.MjModel.from_xml_path(str(HANDS / name / f"{name}.xml"))
        self.m.opt.timestep = 0.002
        self.m.opt.integrator = int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
        self.m.opt.cone = int(mujoco.mjtCone.mjCONE_ELLIPTIC)
        self.m.opt.jacobian = int(mujoco.mjtJacobian.mjJAC_DENSE)
        self.d: Any = mujoco.MjData(self.m)
        with (HANDS / name / "hand.toml").open("rb") as file:
            self.text: dict[str, Any] = tomllib.load(file)
        self.fingers: dict[str, dict[str, Any]] = {f["name"]: f for f in self.text["fingers"]}

    def posture(self, name: str) -> Array:
        q = np.clip(np.zeros(self.m.nq), self.m.jnt_range[:, 0], self.m.jnt_range[:, 1])
        for joint, value in self.text["postures"].get(name, {}).items():
            q[int(self.m.joint(joint).qposadr[0])] = value
        return q

    def put(self, q: Array) -> None:
        mujoco.mj_resetData(self.m, self.d)
        self.d.qpos[:] = q
        mujoco.mj_forward(self.m, self.d)

    def lengths(self, q: Array) -> Array:
        self.put(q)
        return np.array(self.d.actuator_length)

    def in_palm(self, point: Array) -> Array:
        palm = self.d.body("palm")
        return np.array(palm.xmat.reshape(3, 3).T @ (point - palm.xpos))

    def pad(self, finger: str) -> tuple[Array, Array, Array, int]:
        """Centre and axis of a pad (world), its body's rotation and number."""
        pad = self.fingers[finger]["pad"]
        body = int(self.m.geom_bodyid[self.m.geom(pad["geom"]).id])
        turn = np.array(self.d.xmat[body]).reshape(3, 3)
        center = np.array(self.d.xpos[body]) + turn @ np.array(pad["center"])
        return center, turn @ np.array(pad["axis"]), turn, body

    def moment(self) -> Array:
        """Actuator moments (nu, nv)."""
        out = np.zeros((self.m.nu, self.m.nv))
        d = self.d
        mujoco.mju_sparse2dense(
            out, d.actuator_moment, d.moment_rownnz, d.moment_rowadr, d.moment_colind
        )
        return out

    def contacts(self) -> list[tuple[str, str]]:
        return [(self.m.geom(c.geom1).name, self.m.geom(c.geom2).name) for c in self.d.contact]


@pytest.fixture(params=NAMES)
def hand(request: pytest.FixtureRequest) -> Iterator[Model]:
    yield Model(request.param)


@pytest.fixture
def shadow() -> Model:
    return Model("shadow_hand")


@pytest.fixture
def allegro() -> Model:
    return Model("allegro_hand")


def test_counts(shadow: Model, allegro: Model) -> None:
    assert (shadow.m.nq, shadow.m.nv, shadow.m.nu, shadow.m.ntendon) == (24, 24, 20, 8)
    assert (allegro.m.nq, allegro.m.nv, allegro.m.nu, allegro.m.ntendon) == (16, 16, 16, 0)
    assert list(shadow.fingers) == ["thumb", "index", "middle", "ring", "little"]
    assert list(allegro.fingers) == ["thumb", "index", "middle", "ring"]


def test_every_element_is_named_once(hand: Model) -> None:
    m = hand.m
    for kind, count in (
        ("body", m.nbody),
        ("jnt", m.njnt),
        ("geom", m.ngeom),
        ("site", m.nsite),
        ("actuator", m.nu),
        ("tendon", m.ntendon),
    ):
        names = [getattr(m, kind)(i).name for i in range(count)]
        assert all(names), kind
        assert len(set(names)) == count, kind
    bodies = {m.body(i).name for i in range(m.nbody)}
    # Pinocchio keeps bodies and sites in one list of frames.
    assert not bodies & {m.site(i).name for i in range(m.nsite)}


def test_root_stands_free_at_the_origin(hand: Model) -> None:
    m = hand.m
    assert m.body(1).name == hand.text["base_body"]
    assert np.array_equal(m.body_pos[1], np.zeros(3))
    assert np.array_equal(m.body_quat[1], [1, 0, 0, 0])
    assert m.body_jntnum[1] == 0
    assert not np.any(m.geom_bodyid == 0)
    assert np.count_nonzero(m.body_parentid[1:] == 0) == 1


def test_every_geom_collides_with_everything(hand: Model) -> None:
    m = hand.m
    assert np.all(m.geom_contype == 1) and np.all(m.geom_conaffinity == 1)
    assert np.all(m.geom_condim == 4)
    primitive = {
        int(t)
        for t in (
            mujoco.mjtGeom.mjGEOM_BOX,
            mujoco.mjtGeom.mjGEOM_CAPSULE,
            mujoco.mjtGeom.mjGEOM_CYLINDER,
            mujoco.mjtGeom.mjGEOM_SPHERE,
        )
    }
    assert {int(t) for t in m.geom_type} <= primitive


def test_tip_positions_at_zero_shadow(shadow: Model) -> None:
    shadow.put(np.zeros(24))
    published = {
        "index": (0.033, 0, 0.191),
        "middle": (0.011, 0, 0.195),
        "ring": (-0.011, 0, 0.191),
        "little": (-0.033, 0, 0.1825),
        "thumb": (0.1029, -0.0086, 0.0979),
    }
    for finger, point in published.items():
        site = shadow.d.site(f"{finger}_tip").xpos
        assert np.allclose(shadow.in_palm(site), point, atol=2e-4), finger


def test_tip_positions_at_zero_allegro(allegro: Model) -> None:
    allegro.put(np.zeros(16))
    straight = 0.0164 + 0.054 + 0.0384 + 0.0267
    lean, side = np.cos(np.deg2rad(5)), np.sin(np.deg2rad(5))
    expected = {
        "index": (0, 0.0435 + side * straight, -0.001542 + lean * straight),
        "middle": (0, 0, 0.0007 + straight),
        "ring": (0, -0.0435 - side * straight, -0.001542 + lean * straight),
    }
    for finger, point in expected.items():
        site = allegro.d.site(f"{finger}_tip").xpos
        assert np.allclose(allegro.in_palm(site), point, atol=1e-6), finger
    # Thumb: the published quaternion, rounded to four digits, turns (-.027, .005, .0399 + reach).
    turn = np.zeros(9)
    quat = np.array([0.4777, -0.5213, -0.5213, -0.4777])
    mujoco.mju_quat2Mat(turn, quat / np.linalg.norm(quat))
    reach = np.array([-0.027, 0.005, 0.0399 + 0.0177 + 0.0514 + 0.0423])
    expected_thumb = np.array([-0.0182, 0.019333, -0.045987]) + turn.reshape(3, 3) @ reach
    site = allegro.d.site("thumb_tip").xpos
    assert np.allclose(allegro.in_palm(site), expected_thumb, atol=2e-4)


@pytest.mark.parametrize("name", NAMES)
def test_joint_ranges_and_order(name: str) -> None:
    m = Model(name).m
    assert [m.joint(i).name for i in range(m.njnt)] == list(JOINTS[name])
    for joint, (low, high, _) in JOINTS[name].items():
        assert np.allclose(m.joint(joint).range, (low, high), atol=1e-9), joint


@pytest.mark.parametrize("name", NAMES)
def test_force_limits_reachable_at_every_q(name: str) -> None:
    m = Model(name).m
    driven = set()
    for i in range(m.nu):
        gain, bias = m.actuator_gainprm[i, 0], m.actuator_biasprm[i, :3]
        force, ctrl = m.actuator_forcerange[i], m.actuator_ctrlrange[i]
        if int(m.actuator_trntype[i]) == int(mujoco.mjtTrn.mjTRN_JOINT):
            joint = m.joint(int(m.actuator_trnid[i, 0]))
            low, high = (float(v) for v in joint.range)
            limit = JOINTS[name][joint.name][2]
            driven.add(joint.name)
        else:
            prefix = m.tendon(int(m.actuator_trnid[i, 0])).name[:2]
            low, high, limit = 0.0, 2 * 1.5708, 1.0
            assert JOINTS[name][f"{prefix}J1"][2] is None
            driven |= {f"{prefix}J1", f"{prefix}J2"}
        assert limit is not None
        assert np.allclose(force, (-limit, limit)), m.actuator(i).name
        for q in (low, high):
            reach = gain * ctrl + bias[0] + bias[1] * q
            assert reach[0] <= force[0] + 1e-9, (m.actuator(i).name, q)
            assert reach[1] >= force[1] - 1e-9, (m.actuator(i).name, q)
    assert driven == set(JOINTS[name])


def test_masses(shadow: Model, allegro: Model) -> None:
    total = float(np.sum(shadow.m.body_mass))
    assert total == pytest.approx(3.794, abs=1e-9)
    assert total - float(shadow.m.body("forearm").mass[0]) == pytest.approx(0.79, abs=0.005)
    assert float(np.sum(allegro.m.body_mass)) == pytest.approx(0.9549, abs=1e-9)


def test_inertias_are_those_of_a_body_of_that_size(hand: Model) -> None:
    m = hand.m
    for body in range(1, m.nbody):
        inertia = np.sort(m.body_inertia[body])
        assert inertia[2] <= inertia[0] + inertia[1] + 1e-15, m.body(body).name
        radius_of_gyration = np.sqrt(inertia[2] / m.body_mass[body])
        assert 0.002 < radius_of_gyration < 0.07, m.body(body).name


@pytest.mark.parametrize("posture", POSTURES)
def test_no_contact_inside_the_hand(hand: Model, posture: str) -> None:
    hand.put(hand.posture(posture))
    assert hand.contacts() == []


def test_no_contact_inside_the_hand_at_exact_zero(hand: Model) -> None:
    hand.put(np.zeros(hand.m.nq))
    assert hand.contacts() == []


# Bodies that overlap by construction and that MuJoCo does not take for parent and child: those of
# a root that is welded to the world, and links on both sides of a hub.
EXCLUDED = {
    "shadow_hand": {("forearm", "wrist"), ("thumb_proximal", "thumb_middle")},
    "allegro_hand": {
        *(("palm", f"{finger}_base") for finger in ("index", "middle", "ring", "thumb")),
        ("palm", "thumb_proximal"),
    },
}


@pytest.mark.parametrize("name", NAMES)
def test_only_overlaps_by_construction_are_excluded(name: str) -> None:
    m = Model(name).m
    pairs = [(int(s) >> 16, int(s) & 0xFFFF) for s in m.exclude_signature[: m.nexclude]]
    found = {frozenset((m.body(a).name, m.body(b).name)) for a, b in pairs}
    assert found == {frozenset(pair) for pair in EXCLUDED[name]}


def test_self_collisions_are_seen(hand: Model) -> None:
    """The exclusions must not hide a thumb that goes through a finger."""
    rng = np.random.default_rng(0)
    seen = set()
    for _ in range(300):
        hand.put(rng.uniform(hand.m.jnt_range[:, 0], hand.m.jnt_range[:, 1]))
        seen |= {frozenset((a.split("_")[0], b.split("_")[0])) for a, b in hand.contacts()}
    assert frozenset(("thumb", "index")) in seen
    assert frozenset(("index", "middle")) in seen


def test_postures_respect_ranges_and_couplings(hand: Model) -> None:
    for posture in POSTURES:
        q = hand.posture(posture)
        assert np.all(q >= hand.m.jnt_range[:, 0]) and np.all(q <= hand.m.jnt_range[:, 1])
        for coupling in hand.text.get("couplings", []):
            value = sum(
                c * q[int(hand.m.joint(j).qposadr[0])] for j, c in coupling["joints"].items()
            )
            assert value == pytest.approx(coupling["value"], abs=1e-12), coupling["name"]


def _opposition(hand: Model) -> tuple[Array, Array, Array]:
    """Thumb pad centre, mean centre of the other default fingers' pads, and the line between."""
    thumb = hand.pad("thumb")[0]
    others = [f for f in hand.text["default_fingers"] if f != "thumb"]
    middle = np.mean([hand.pad(f)[0] for f in others], axis=0)
    return thumb, middle, (middle - thumb) / np.linalg.norm(middle - thumb)


def test_pinch_opposes_the_thumb(hand: Model) -> None:
    hand.put(hand.posture("pinch"))
    thumb, middle, line = _opposition(hand)
    assert 0.060 <= np.linalg.norm(middle - thumb) <= 0.065
    for finger in hand.text["default_fingers"]:
        towards = line if finger == "thumb" else -line
        angle = np.rad2deg(np.arccos(hand.pad(finger)[1] @ towards))
        assert angle < 25, finger  # well inside the pad's cone
    # The palm faces the space between the pads.
    normal = hand.d.body("palm").xmat.reshape(3, 3) @ np.array(hand.text["palm_normal"])
    assert ((thumb + middle) / 2 - hand.d.body("palm").xpos) @ normal > 0.04


def test_open_is_pinch_opened(hand: Model) -> None:
    hand.put(hand.posture("pinch"))
    line = _opposition(hand)[2]
    pinched = {f: hand.pad(f)[0] for f in hand.text["default_fingers"]}
    hand.put(hand.posture("open"))
    for finger, center in pinched.items():
        outwards = -line if finger == "thumb" else line
        assert 0.018 <= (hand.pad(finger)[0] - center) @ outwards <= 0.032, finger


def test_fingers_flex_towards_the_palmar_side(hand: Model) -> None:
    """Every flexion joint moves its tip along the palm's normal for positive q."""
    flexion = ("J3", "J2", "J1", "_1", "_2", "_3")
    for name, finger in hand.fingers.items():
        if name == "thumb":
            continue
        for joint in finger["joints"]:
            if not joint.endswith(flexion):
                continue
            q = np.zeros(hand.m.nq)
            hand.put(q)
            before = hand.in_palm(hand.d.site(finger["tip_site"]).xpos)
            q[int(hand.m.joint(joint).qposadr[0])] = 0.1
            hand.put(q)
            after = hand.in_palm(hand.d.site(finger["tip_site"]).xpos)
            assert (after - before) @ np.array(hand.text["palm_normal"]) > 1e-3, joint


def _support(m: Any, geom: int, direction: Array) -> float:
    """How far a geom of a body reaches along a direction of that body's frame, m."""
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, m.geom_quat[geom])
    axes = turn.reshape(3, 3)
    radius, half = float(m.geom_size[geom, 0]), float(m.geom_size[geom, 1])
    at = float(m.geom_pos[geom] @ direction)
    if int(m.geom_type[geom]) == int(mujoco.mjtGeom.mjGEOM_SPHERE):
        return at + radius
    assert int(m.geom_type[geom]) == int(mujoco.mjtGeom.mjGEOM_CAPSULE)
    return at + radius + half * abs(float(axes[:, 2] @ direction))


def test_pads_are_the_outer_surface(hand: Model) -> None:
    """A plane that comes from any direction of the cone meets the pad's sphere first."""
    hand.put(np.zeros(hand.m.nq))
    for name, finger in hand.fingers.items():
        pad, body = finger["pad"], hand.pad(name)[3]
        geoms = [g for g in range(hand.m.ngeom) if int(hand.m.geom_bodyid[g]) == body]
        for cone in ("", "rolling_"):
            axis, half = np.array(pad[f"{cone}axis"]), np.deg2rad(pad[f"{cone}half_angle_deg"])
            for direction in _within(axis, half):
                sphere = float(np.array(pad["center"]) @ direction) + pad["radius"]
                reach = max(_support(hand.m, g, direction) for g in geoms)
                assert sphere == pytest.approx(reach, abs=1e-9), (name, cone, direction)


def _within(axis: Array, half: float) -> Iterator[Array]:
    """Directions all over a cone and on its rim."""
    side = np.cross(axis, [0.0, 1.0, 0.0] if abs(axis[1]) < 0.5 else [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    up = np.cross(axis, side)
    for opening in np.linspace(0, half, 7):
        for turn in np.linspace(0, 2 * np.pi, 24, endpoint=False):
            rim = np.cos(turn) * side + np.sin(turn) * up
            yield np.cos(opening) * axis + np.sin(opening) * rim


def test_tip_sites_shadow_end_at_the_capsule(shadow: Model) -> None:
    shadow.put(np.zeros(24))
    for name, finger in shadow.fingers.items():
        pad = finger["pad"]
        reach = 0.0275 if name == "thumb" else 0.026
        assert pad["center"][2] + pad["radius"] == pytest.approx(reach, abs=1e-12)
        site = shadow.m.site(finger["tip_site"])
        assert np.allclose(site.pos, (0, 0, reach)) and np.allclose(site.quat, (1, 0, 0, 0))


def _push_pad(shadow: Model, finger: str, polar_deg: float, force: float) -> float:
    """Tip movement (m) after one second under ``force`` N on the pad, J^T f fed forward.

    The feed-forward takes the servos' own compliance away: what moves is what no actuator holds.
    """
    m, d = shadow.m, shadow.d
    m.opt.gravity[:] = 0
    shadow.put(shadow.posture("pinch"))
    hold = np.array(d.actuator_length)
    tip = np.array(d.site(f"{finger}_tip").xpos)
    center, _, turn, body = shadow.pad(finger)
    polar = np.deg2rad(polar_deg)
    outwards = turn @ np.array([0, -np.sin(polar), np.cos(polar)])
    point = center + shadow.fingers[finger]["pad"]["radius"] * outwards
    jacobian = np.zeros((3, m.nv))
    mujoco.mj_jac(m, d, jacobian, None, point, body)
    wanted = -np.linalg.pinv(shadow.moment().T) @ (jacobian.T @ (-force * outwards))
    d.ctrl[:] = hold + wanted / m.actuator_gainprm[:, 0]
    for _ in range(500):
        d.qfrc_applied[:] = 0
        mujoco.mj_applyFT(m, d, -force * outwards, np.zeros(3), point, body, d.qfrc_applied)
        mujoco.mj_step(m, d)
    return float(np.linalg.norm(d.site(f"{finger}_tip").xpos - tip))


@pytest.mark.parametrize("finger", list(SHADOW_PREFIX))
def test_stop_holds_three_newton_on_the_pad(shadow: Model, finger: str) -> None:
    for polar in (5.0, 45.0, 85.0):
        assert _push_pad(shadow, finger, polar, 3.0) < 1e-3


@pytest.mark.parametrize("finger", list(SHADOW_PREFIX))
def test_without_the_stop_the_finger_collapses(shadow: Model, finger: str) -> None:
    """The test above can fail: the passive spring alone does not hold."""
    shadow.m.tendon_limited[shadow.m.tendon(f"{SHADOW_PREFIX[finger]}_stop").id] = 0
    assert _push_pad(shadow, finger, 45.0, 3.0) > 2e-3


def test_step_response_settles(hand: Model) -> None:
    """From open to pinch in one step of ctrl at dt = 2 ms: no overshoot, no ringing, no NaN."""
    m, d = hand.m, hand.d
    m.opt.gravity[:] = 0
    goal = hand.lengths(hand.posture("pinch"))
    start = hand.lengths(hand.posture("open"))
    d.ctrl[:] = goal
    lengths, speeds = [], []
    for _ in range(500):
        mujoco.mj_step(m, d)
        lengths.append(np.array(d.actuator_length))
        speeds.append(np.array(d.qvel))
    track, velocity = np.array(lengths), np.array(speeds)
    assert np.isfinite(track).all()
    assert np.abs(track[-1] - goal).max() < 5e-3
    assert np.abs(velocity[-50:]).max() < 5e-3
    change = goal - start
    moving = np.abs(change) > 0.05
    overshoot = ((track - goal) * np.sign(change))[:, moving].max(axis=0) / np.abs(change[moving])
    assert overshoot.max() < 0.05
    still = np.abs(track[200:, moving] - goal[moving]) < 0.05 * np.abs(change[moving])
    assert still.all()  # within 5 % after 0.4 s


def test_every_servo_is_stable_alone(hand: Model) -> None:
    """A small step on each actuator from pinch settles without ringing; catches the wrist too."""
    m, d = hand.m, hand.d
    m.opt.gravity[:] = 0
    hold = hand.lengths(hand.posture("pinch"))
    for i in range(m.nu):
        hand.put(hand.posture("pinch"))
        d.ctrl[:] = hold
        d.ctrl[i] += 0.05
        track = []
        for _ in range(250):
            mujoco.mj_step(m, d)
            track.append(float(d.actuator_length[i]) - hold[i])
        assert max(track) < 0.055, m.actuator(i).name
        assert track[-1] == pytest.approx(0.05, abs=0.006), m.actuator(i).name


def test_unloaded_fingers_curl_evenly(shadow: Model) -> None:
    """J1 and J2 stay together along a free motion, also under gravity across the fingers."""
    m, d = shadow.m, shadow.d
    for gravity in ((0, 0, -9.81), (9.81, 0, 0), (-9.81, 0, 0)):
        m.opt.gravity[:] = gravity
        goal = shadow.lengths(shadow.posture("pinch"))
        shadow.put(shadow.posture("open"))
        d.ctrl[:] = goal
        for _ in range(500):
            mujoco.mj_step(m, d)
        for prefix in SHADOW_PREFIX.values():
            split = float(d.joint(f"{prefix}J2").qpos[0] - d.joint(f"{prefix}J1").qpos[0])
            assert -1e-3 < split < 0.05, (prefix, gravity)


def test_spring_brings_the_distal_joints_together(shadow: Model) -> None:
    """A finger left with J2 > J1 finds back to J1 = J2, and the spring is at rest there."""
    m, d = shadow.m, shadow.d
    m.opt.gravity[:] = 0
    q = shadow.posture("pinch")
    shadow.put(q)
    assert np.abs(d.qfrc_spring).max() < 1e-12
    hold = np.array(d.actuator_length)
    for prefix in SHADOW_PREFIX.values():
        q[int(m.joint(f"{prefix}J2").qposadr[0])] += 0.15
        q[int(m.joint(f"{prefix}J1").qposadr[0])] -= 0.15
    shadow.put(q)
    d.ctrl[:] = hold
    for _ in range(1000):
        mujoco.mj_step(m, d)
    for prefix in SHADOW_PREFIX.values():
        split = float(d.joint(f"{prefix}J2").qpos[0] - d.joint(f"{prefix}J1").qpos[0])
        assert -1e-3 < split < 0.03, prefix
