"""Two hands as one: its description, and the model in which a carriage or an arm moves each hand.

Called by ``planner.hand_loading``. The description is a fourth kind of ``hand.toml``: it names two
descriptions, where the hands are at rest, and what moves them. A carriage has three slides and
three hinges through the palm's origin; it stands for the arm that would carry the hand. The joints
of both carriages are part of q like any others, so that one grasp map, one force programme and one
certificate take the contacts of both hands. See ``models/hands/two_allegro_hands/hand.toml``.

Where both hands are on arms (``planner.hands.arm``), the joints of each arm take the place of its
carriage's: the roots of both arms stand in the pair, whose base is on the table below the object.
Grasps are searched for with the same hands on carriages (``Hand.on_carriages``), each with its
arm's last link, and the arms then bring the palms there (``planner.collision.arm_path.onto_arms``).
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from pydantic import Field

from planner.bridge import compile_spec
from planner.bridge.edit import Carried, JointServo, carried_spec, take_off_arm
from planner.errors import HandError
from planner.hands.build import hand_of_model
from planner.hands.catalog import JOINED_NAMES
from planner.hands.description_toml import read_toml, validated
from planner.hands.fingers import Side
from planner.hands.hand import Hand
from planner.joints.description import FingerDescription, Finite, HandDescription, Positive, Vector
from planner.schema import StrictData
from planner.shapes.convex_pairs import DistancePair
from planner.spatial import SE3, FloatArray, pose_from_wxyz, pose_to_wxyz

PAIR = "pair"
"""Name of the root body, which the gantry carries."""

AXES = ("x", "y", "z", "rx", "ry", "rz")
"""Joints of a carriage, in order: slides, then hinges, in the axes of the carriage at rest. Its x
axis is the palm's normal, so that the hinge that turns far is the first and no angle near a right
one is in the middle."""


class HeldHand(StrictData):
    """One of the two hands.

    Attributes:
        name: What it is called; names of its bodies and joints begin with it.
        hand: Its description, relative to this file.
        position: Where its palm is at rest, m, in the axes of the pair; of a hand on an arm where
            the arm's root stands.
        quaternion_wxyz: Orientation of its base there; the arm's root is its base.
    """

    name: str = Field(min_length=1)
    hand: str
    position: Vector
    quaternion_wxyz: tuple[Finite, Finite, Finite, Finite]


class CarriageDescription(StrictData):
    """What moves a hand; both carriages are alike.

    Attributes:
        reach: How far each slide goes to either side, m.
        tilt: How far the second and third hinge turn to either side, rad; the first turns by half
            a turn.
        force: Largest force of a slide, N.
        torque: Largest torque of a hinge, N m.
        stiffness: Of a slide's position servo, N/m.
        turn_stiffness: Of a hinge's, N m/rad.
        mass: Of the moving part, kg.
        damping_ratio: Of each servo under carriage and hand (-).
    """

    reach: Positive = 0.4
    tilt: Positive = 1.2
    force: Positive = 100.0
    torque: Positive = 12.0
    stiffness: Positive = 2e4
    turn_stiffness: Positive = 300.0
    mass: Positive = 1.0
    damping_ratio: Positive = 1.0


class PairDescription(StrictData):
    """A ``hand.toml`` that puts two described hands on carriages."""

    schema_version: int = Field(alias="schema", ge=1, le=1)
    name: str
    summary: str = ""
    hands: tuple[HeldHand, HeldHand]
    carriage: CarriageDescription = CarriageDescription()


CARRIAGE_RADIUS = 0.04
"""Radius (m) of the ball whose moment of inertia a carriage has: a wrist's."""

HALF_TURN = float(np.pi)
"""How far (rad) the first hinge turns to either side."""

HALF_APART = 0.25
"""Distance (m) of a palm at rest from the middle of two hands that are named as ``ONE+OTHER``: room
for an object as wide as a person takes between both hands."""

ARM_AWAY = 0.6
"""Distance (m) of an arm's root from the middle of two arms that are named as ``ONE+OTHER``. Of 60
palms drawn on the sides of objects of 15 to 40 cm, both shipped hands reach all at this distance,
and stay there while they lift by 0.2 m; at 0.4 m one reaches 45, at 0.8 m the other 53."""

CARRIED_ARM = 0.1
"""Radius of gyration (m) of carriage, hand and their share of an object about the palm, for the
damping of the hinges."""


def read_pair(path: Path) -> PairDescription:
    """The pair that a file describes.

    Raises:
        HandError: Not TOML, or a pair with faults.
    """
    found = validated(path, PairDescription, read_toml(path), "two hands")
    first, second = found.hands
    if first.name == second.name:
        raise HandError(f"{path}: both hands are called {first.name!r}; rename one")
    for held in found.hands:
        if not os.path.isfile(path.parent / held.hand):
            raise HandError(f"{path}: {held.name!r} names {held.hand}, which does not exist")
        if not np.linalg.norm(held.quaternion_wxyz) > 0:
            raise HandError(f"{path}: quaternion_wxyz of {held.name!r} has no length; give a unit")
    return found


def joined_hands(hands: Sequence[Hand], reference: str) -> Hand:
    """Two hands as one that no file describes, palm to palm.

    On the usual carriages their fingers are up; arms stand opposite each other, the object between.

    Args:
        hands: Both hands, each alone.
        reference: What ``load_hand`` takes to get the same again: "ONE+OTHER".

    Raises:
        HandError: There are not two, one alone is on an arm, or one is two hands itself.
    """
    if len(hands) != len(JOINED_NAMES):
        raise HandError(f"{reference} names {len(hands)} hands; join two, as in one+other")
    held = [
        HeldHand(
            name=name,
            hand=hand.reference or hand.name,
            position=(0.0, -sign * HALF_APART, 0.0)
            if hand.arm is None
            else (0.0, -sign * ARM_AWAY, hand.arm.T_spot_base.translation[2]),
            quaternion_wxyz=_facing(hand, np.array([0.0, sign, 0.0])),
        )
        for name, hand, sign in zip(JOINED_NAMES, hands, (1.0, -1.0), strict=True)
    ]
    pair = PairDescription(schema=1, name=reference, hands=(held[0], held[1]))
    return two_hands(pair, hands, None, reference)


def _facing(hand: Hand, direction: FloatArray) -> tuple[float, float, float, float]:
    """Quaternion of a base at which the palm faces a horizontal direction (3,), fingers up.

    An arm stands upright, and its forward direction, x, points there.
    """
    if hand.arm is not None:
        return float(np.sqrt(0.5)), 0.0, 0.0, float(np.sign(direction[1]) * np.sqrt(0.5))
    data = hand.pin_model.createData()
    pin.framesForwardKinematics(hand.pin_model, data, hand.neutral)
    palm = data.oMf[hand.palm_frame_id]
    facing = palm.rotation @ hand.palm_normal
    tips = [data.oMf[f.tip_frame_id].translation for f in hand.choose_fingers()]
    ways = [tip - palm.translation for tip in tips]
    ways = [way - facing * (facing @ way) for way in ways]
    units = np.array([way / max(float(np.linalg.norm(way)), 1e-9) for way in ways])
    along = units[int(np.argmax(np.sum(units @ units.T, axis=1)))]  # a thumb points elsewhere
    up = np.array([0.0, 0.0, 1.0])
    before = np.column_stack([facing, along, np.cross(facing, along)])
    after = np.column_stack([direction, up, np.cross(direction, up)])
    w, x, y, z = pose_to_wxyz(SE3(after @ before.T, np.zeros(3)))[1]
    return float(w), float(x), float(y), float(z)


def two_hands(
    pair: PairDescription, hands: Sequence[Hand], path: Path | None, reference: str
) -> Hand:
    """Two hands on carriages, or on arms, as one.

    Args:
        pair: The description.
        hands: Both hands, each alone.
        path: Its file; None if there is none.
        reference: What ``load_hand`` takes to get the same again.

    Raises:
        HandError: One alone is on an arm, one is a pair itself, or they do not fit.
        ModelError: MuJoCo refuses the whole.
    """
    where = reference if path is None else str(path)
    for hand in hands:
        if hand.pair:
            raise HandError(
                f"{where}: hands names {hand.name}, which is two hands itself; name a hand alone"
            )
    on_arms = [hand.name for hand in hands if hand.arm is not None]
    if len(on_arms) == 1:
        raise HandError(
            f"{where}: {on_arms[0]} is on an arm and the other hand is not; put both on arms, or "
            "both on carriages by naming hands alone"
        )
    if on_arms:
        _check_roots(where, pair, hands)
    else:
        _check_faces(where, pair, hands)
    spec = pair_spec(pair, hands)
    written = pair.model_dump_json().encode() if path is None else path.read_bytes()
    content = b"".join(hand.digest.encode() for hand in hands) + written
    both = hand_of_model(
        spec,
        compile_spec(spec, where),
        pair_description(pair, hands),
        where=where,
        path=path,
        reference=reference,
        digest=hashlib.sha256(content).hexdigest(),
        sides=lambda joint_names: sides_of(pair, hands, joint_names),
    )
    return replace(both, on_carriages=_on_carriages(pair, hands, where)) if on_arms else both


def _on_carriages(pair: PairDescription, hands: Sequence[Hand], where: str) -> Hand:
    """The hands of two arms, each with the last link, on carriages about the origin of the pair.

    Each is at rest on its arm's side, its palm turned from where the arm has it at its ready
    posture, by the shortest way, to face the other arm.

    Raises:
        HandError: One arm stands above the other.
    """
    roots = [_at_rest(held, hand)[0] for held, hand in zip(pair.hands, hands, strict=True)]
    way = (roots[1].translation - roots[0].translation) * np.array([1.0, 1.0, 0.0])
    if not np.linalg.norm(way) > 0.0:
        raise HandError(f"{where}: one arm stands above the other; move them apart (position)")
    way /= np.linalg.norm(way)
    alone, rests = [_off_arm(hand) for hand in hands], []
    for held, hand, bare, root, sign in zip(
        pair.hands, hands, alone, roots, (1.0, -1.0), strict=True
    ):
        turn = root.rotation @ _palm_turn(hand)
        facing = pin.Quaternion.FromTwoVectors(turn @ hand.palm_normal, sign * way).matrix()
        base = SE3(facing @ turn @ _palm_turn(bare).T, np.zeros(3))
        x, y, z = -sign * HALF_APART * way
        w, *vector = pose_to_wxyz(base)[1].tolist()
        rests.append(
            HeldHand(
                name=held.name,
                hand=bare.name,
                position=(x, y, z),
                quaternion_wxyz=(w, vector[0], vector[1], vector[2]),
            )
        )
    carriages = pair.model_copy(update={"hands": (rests[0], rests[1])})
    return two_hands(carriages, alone, None, where)


def _off_arm(hand: Hand) -> Hand:
    """A hand that an arm carries, with the arm's last link alone."""
    assert hand.arm is not None
    joint = hand.joint_names[hand.arm.flange - 1]
    link = str(hand.mj_model.body(int(hand.mj_model.joint(joint).bodyid[0])).name)
    spec = hand.new_spec()
    take_off_arm(spec, link, hand.name)
    bare = hand_of_model(
        spec,
        compile_spec(spec, hand.name),
        hand.description.model_copy(update={"base_body": link}),
        where=hand.name,
        path=None,
        reference=None,
        digest=hashlib.sha256(f"{hand.digest} off its arm".encode()).hexdigest(),
    )
    names = {geometry.name for geometry in bare.geometries}
    return replace(bare, last_link=hand.arm.geometries & names)


def _palm_turn(hand: Hand) -> FloatArray:
    """Rotation (3, 3) of the palm in the hand's base, at rest."""
    data = hand.pin_model.createData()
    pin.framesForwardKinematics(hand.pin_model, data, hand.at_rest)
    return np.array(data.oMf[hand.palm_frame_id].rotation)


def pair_spec(pair: PairDescription, hands: Sequence[Hand]) -> Any:
    """``mujoco.MjSpec`` of both hands on their carriages or arms, under one root body.

    Raises:
        ModelError: MuJoCo refuses the whole.
    """
    c, carried = pair.carriage, []
    for held, hand in zip(pair.hands, hands, strict=True):
        rest, T_carriage_base = _at_rest(held, hand)
        load = c.mass + float(np.sum(hand.mj_model.body_mass))
        carried.append(
            Carried(
                name=held.name,
                spec=hand.new_spec(),
                T_root_carriage=rest,
                T_carriage_base=T_carriage_base,
                servos=[
                    _servo(c, load, slides=k < 3, most=most)
                    for k, most in enumerate((*(c.reach,) * 3, HALF_TURN, c.tilt, c.tilt))
                    if hand.arm is None
                ],
            )
        )
    return carried_spec(pair.name, PAIR, carried, AXES, mass=c.mass, radius=CARRIAGE_RADIUS)


def _servo(c: CarriageDescription, load: float, *, slides: bool, most: float) -> JointServo:
    """The servo of one joint of a carriage, damped for the mass (kg) that it carries."""
    kp = c.stiffness if slides else c.turn_stiffness
    moved = load if slides else load * CARRIED_ARM**2
    kv = 2.0 * c.damping_ratio * float(np.sqrt(kp * moved))
    return JointServo(slides=slides, most=most, kp=kp, kv=kv, force=c.force if slides else c.torque)


def pair_description(pair: PairDescription, hands: Sequence[Hand]) -> HandDescription:
    """The description of both: fingers, postures and couplings of each under its name."""
    both = list(zip(pair.hands, hands, strict=True))
    first = hands[0].description
    postures: dict[str, dict[str, float]] = {}
    for name in sorted(set.intersection(*(set(h.description.postures) for h in hands))):
        postures[name] = {
            f"{held.name}/{joint}": angle
            for held, hand in both
            for joint, angle in hand.description.postures[name].items()
        }
    return HandDescription(
        schema=1,
        name=pair.name,
        model=", ".join(hand.name for hand in hands),
        summary=pair.summary,
        source="; ".join(dict.fromkeys(hand.description.source for hand in hands)),
        base_body=PAIR,
        palm_body=f"{pair.hands[0].name}/{first.palm_body}",
        palm_normal=first.palm_normal,
        wrist_joints=tuple(f"{s.name}/{j}" for s, h in both for j in h.description.wrist_joints),
        default_fingers=tuple(_called(s, f.name) for s, h in both for f in h.choose_fingers()),
        allowed_contacts=tuple(
            (f"{s.name}/{a}", f"{s.name}/{b}")
            for s, h in both
            for a, b in h.description.allowed_contacts
        ),
        fingers=tuple(_finger(s, f) for s, h in both for f in h.description.fingers),
        couplings=tuple(
            c.model_copy(
                update={
                    "name": f"{s.name}/{c.name}",
                    "joints": {f"{s.name}/{j}": k for j, k in c.joints.items()},
                }
            )
            for s, h in both
            for c in h.description.couplings
        ),
        postures=postures,
    )


def _check_faces(where: str, pair: PairDescription, hands: Sequence[Hand]) -> None:
    """Refuse palms that look away from each other at rest.

    Raises:
        HandError: One looks away.
    """
    rests = [_at_rest(held, hand)[0] for held, hand in zip(pair.hands, hands, strict=True)]
    way = rests[1].translation - rests[0].translation
    for held, rest, toward in zip(pair.hands, rests, (way, -way), strict=True):
        if not rest.rotation[:, 0] @ toward > 0.0:
            raise HandError(
                f"{where}: at rest the palm of {held.name!r} does not look towards the other hand; "
                "turn it by its quaternion_wxyz, or exchange the positions"
            )


def _check_roots(where: str, pair: PairDescription, hands: Sequence[Hand]) -> None:
    """Refuse arms whose roots, which stand fixed, overlap.

    Raises:
        HandError: They do.
    """
    roots = [
        [(_at_rest(s, h)[0] * g.T_joint_geometry, g) for g in h.geometries if g.joint_id == 0]
        for s, h in zip(pair.hands, hands, strict=True)
    ]
    for (T_one, one), (T_other, other) in product(*roots):
        if DistancePair(one.geometry, other.geometry).distance(T_one, T_other) < 0.0:
            names = " and ".join(held.name for held in pair.hands)
            raise HandError(
                f"{where}: the arms of {names} stand in one place; move them apart (position)"
            )


def sides_of(
    pair: PairDescription,
    hands: Sequence[Hand],
    joint_names: Sequence[str],
) -> tuple[Side, ...]:
    """Both hands by the names and joints of the whole."""
    sides = []
    for held, hand in zip(pair.hands, hands, strict=True):
        joints = np.array([joint_names.index(f"{held.name}/{joint}") for joint in hand.joint_names])
        if hand.arm is None:
            carriage = np.array([joint_names.index(f"{held.name}/carriage_{a}") for a in AXES])
        else:
            carriage = joints[hand.arm.chain]
        sides.append(
            Side(
                name=held.name,
                palm_body=f"{held.name}/{hand.description.palm_body}",
                palm_normal=hand.palm_normal,
                carriage=carriage,
                fingers=tuple(_called(held, name) for name in hand.fingers),
                alone=hand,
                joints=joints,
                T_base_root=None if hand.arm is None else _at_rest(held, hand)[0],
            )
        )
    return tuple(sides)


def _called(held: HeldHand, finger: str) -> str:
    return f"{held.name}_{finger}"


def _finger(held: HeldHand, finger: FingerDescription) -> FingerDescription:
    pad = finger.pad.model_copy(update={"geom": f"{held.name}/{finger.pad.geom}"})
    return finger.model_copy(
        update={
            "name": _called(held, finger.name),
            "joints": tuple(f"{held.name}/{joint}" for joint in finger.joints),
            "tip_site": f"{held.name}/{finger.tip_frame}",
            "tip": None,
            "pad": pad,
        }
    )


def _at_rest(held: HeldHand, hand: Hand) -> tuple[SE3, SE3]:
    """Pose of the carriage in the pair, x along the palm's normal, and of the base on it.

    Of a hand on an arm, the pose of the arm's root, twice the same place.
    """
    if hand.arm is not None:
        root = pose_from_wxyz(np.array(held.position), np.array(held.quaternion_wxyz))
        return root, SE3.Identity()
    data = hand.pin_model.createData()
    pin.framesForwardKinematics(hand.pin_model, data, hand.neutral)
    T_base_palm = data.oMf[hand.palm_frame_id]
    turn = pose_from_wxyz(np.zeros(3), np.array(held.quaternion_wxyz)).rotation
    T_pair_palm = SE3(turn @ T_base_palm.rotation, np.array(held.position))
    facing = T_pair_palm.rotation @ hand.palm_normal
    side = np.roll(np.eye(3)[int(np.argmax(np.abs(facing)))], 1)
    across = np.cross(facing, side)
    across /= np.linalg.norm(across)
    axes: FloatArray = np.column_stack([facing, np.cross(across, facing), across])
    rest = SE3(axes, np.array(held.position))
    return rest, rest.inverse() * T_pair_palm * T_base_palm.inverse()


def carriage_joints(moved: SE3) -> FloatArray:
    """Joints (6,), m and rad, of a carriage that has moved so in its axes at rest.

    moved = Trans(x, y, z) Rx Ry Rz.
    """
    R = moved.rotation
    ry = np.arcsin(np.clip(R[0, 2], -1.0, 1.0))
    rx, rz = np.arctan2(-R[1, 2], R[2, 2]), np.arctan2(-R[0, 1], R[0, 0])
    return np.array([*moved.translation, rx, ry, rz])
