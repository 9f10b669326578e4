"""``check_hand``: a hand as the planner sees it, and all that prevents or hinders planning."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from planner.bridge.geometry import body_positions, geom_distance, joint_inertia, touching_geoms
from planner.bridge.numbers import impossible_inertias, worst_inertia
from planner.bridge.pinocchio_model import body_name
from planner.describe.grip import check_pads, check_postures
from planner.describe.overlaps import TOUCHING, check_overlaps, placed_geometries, separate_pairs
from planner.describe.proposal import CheckReport, Findings, JointRow, TouchRow, WorkspaceRow
from planner.hands.hand import Hand
from planner.kinematics import HandState
from planner.shapes.convex_pairs import DistancePair
from planner.spatial import FloatArray

SAMPLES = 500
"""Random configurations that sample a finger's workspace."""

STANDARD_GRAVITY = 9.81
"""m/s^2."""

SLOWEST = 0.5
"""Time (s) in which full torque moves a hinge 1 rad from rest, above which it lags: hands close
within some 0.5 s. 0.07 s at most for the hands that ship."""

HINGE = 3
"""MuJoCo's number of that kind of joint."""

KINEMATICS_TOL = 1e-10
"""Difference (m) between Pinocchio and MuJoCo that is rounding."""

DISTANCE_TOL = 1e-4
"""Difference (m) between coal and MuJoCo, where geometries touch, that is reported."""


def check_hand(hand: Hand, *, seed: int = 0) -> CheckReport:
    """Check everything that the planner uses of a hand.

    Args:
        hand: The hand.
        seed: Of the random configurations.
    """
    rng = np.random.default_rng(seed)
    findings = Findings()
    fingers = hand.choose_fingers()
    # two hands are checked one by one: their pads do not look at each other
    postures = () if hand.pair else check_postures(hand, fingers, findings)
    joints = _joints(hand, findings)
    _check_weight(hand, findings)
    _check_inertias(hand, joints, findings)
    if all(f.level != "error" for f in findings):
        check_overlaps(hand, findings)
    return CheckReport(
        hand=hand.name,
        joints=joints,
        couplings=_couplings(hand),
        workspaces=_workspaces(hand, rng),
        pads=check_pads(hand, findings),
        touches=_touches(hand, findings),
        postures=postures,
        kinematics_error=_kinematics_error(hand, rng, findings),
        findings=findings.worst_first(),
    )


def _joints(hand: Hand, findings: Findings) -> tuple[JointRow, ...]:
    middle = (hand.q_lower + hand.q_upper) / 2
    torques = hand.actuation.torque_limits(middle)
    owner = {j: f.name for f in hand.fingers.values() for j in f.joints}
    owner |= dict.fromkeys(hand.description.wrist_joints, "wrist")
    mover = "arm" if hand.on_arm else "carriage"
    owner |= {hand.joint_names[k]: mover for k in hand.carriage_index}
    out = []
    for k, name in enumerate(hand.joint_names):
        acting = np.flatnonzero(hand.actuation.moment[:, k])
        out.append(
            JointRow(
                name=name,
                belongs_to=owner.get(name, ""),
                q_index=k,
                qpos_index=int(hand.mj_model.joint(name).qposadr[0]),
                lower=float(hand.q_lower[k]),
                upper=float(hand.q_upper[k]),
                torque=(float(torques[k, 0]), float(torques[k, 1])),
                actuators=tuple(hand.actuation.names[i] for i in acting),
            )
        )
    unlimited = [r.name for r in out if np.isinf(r.torque).any()]
    if unlimited:
        findings.warning(
            f"nothing limits the torque of {_listed(unlimited)}",
            "give the actuators a forcerange, or a ctrlrange: plans may ask for "
            "forces that the hand does not have",
        )
    idle = [r.name for r in out if not r.belongs_to]
    if idle:
        findings.note(
            f"{_listed(idle)} belong to no finger and not to the wrist",
            "the planner may move them; name them in a finger's joints or in "
            "wrist_joints if they belong there",
        )
    return tuple(out)


def _check_weight(hand: Hand, findings: Findings) -> None:
    """Note actuators that cannot bear the hand's own links in the pinch posture, however turned.

    An actuator counts with its largest force anywhere in its range: at the end of a range a stop
    helps.
    """
    if "pinch" not in hand.description.postures:
        return
    q, drive = hand.posture("pinch"), hand.actuation
    by_ctrl = np.abs(drive.gain) * (drive.ctrl_range[:, 1] - drive.ctrl_range[:, 0])
    most = np.minimum(np.abs(drive.force_range).max(axis=1), by_ctrl)
    model = hand.pin_model.copy()
    needed = np.zeros(len(most))
    for direction in np.vstack([np.eye(3), -np.eye(3)]):
        model.gravity.linear = STANDARD_GRAVITY * direction
        torque = pin.computeGeneralizedGravity(model, model.createData(), q)
        force, _ = drive.split_torque(q, np.asarray(torque) + drive.passive_torque(q))
        needed = np.maximum(needed, np.abs(force))
    weak = np.flatnonzero(needed > most)
    if weak.size:
        worst = int(weak[np.argmax(needed[weak] / most[weak])])
        findings.warning(
            f"{_listed([drive.names[i] for i in weak])} cannot bear the weight of the "
            f"links: in the pinch posture {drive.names[worst]} needs {needed[worst]:.3g} N m "
            f"(N) and makes {most[worst]:.3g} at most",
            "correct the masses of the links, or give the actuators more force or "
            "wider control ranges",
        )


def _check_inertias(hand: Hand, joints: Sequence[JointRow], findings: Findings) -> None:
    """Warn of inertias that no link has, and of joints whose actuators hardly move them."""
    impossible = impossible_inertias(hand.mj_model)
    if impossible:
        solid = [f'"{one.body}"' for one in impossible if one.has_solid]
        mend = f", or write inertia_from_geometry = [{', '.join(solid)}] under [repair]"
        findings.warning(
            f"{worst_inertia(impossible)}: joints hardly move, and trials fail in "
            "collisions or without contact",
            f"correct the inertias in the model{mend if solid else ''}",
        )
    inertia = joint_inertia(hand.mj_model, hand.neutral)
    for row, moved, armature in zip(joints, inertia, hand.mj_model.dof_armature, strict=True):
        strength = min(-row.torque[0], row.torque[1])
        hinge = int(hand.mj_model.joint(row.name).type[0]) == HINGE
        if not (hinge and 0 < strength < np.inf):
            continue
        time = float(np.sqrt(2 * moved / strength))  # from rest over 1 rad
        if time > SLOWEST:
            findings.warning(
                f"{row.name} moves {moved:.3g} kg m2 (armature {armature:.3g}) by "
                f"{strength:.3g} N m at most: {time:.2g} s for 1 rad, and it lags behind "
                "every plan",
                "correct the armature of the joint (armature under "
                "[joint_defaults]) or the inertias of the links, or give its actuator more "
                "force",
            )


def _couplings(hand: Hand) -> tuple[str, ...]:
    out = []
    for c in hand.couplings:
        terms = " ".join(
            f"{c.row[k]:+.4g} {hand.joint_names[int(k)]}" for k in np.flatnonzero(c.row)
        )
        kind = "stop, active in a grasp" if c.one_sided else "equality"
        sign = ">=" if c.one_sided else "="
        out.append(f"{c.name}: {terms} {sign} {c.value:.4g} ({kind})")
    return tuple(out)


def _workspaces(hand: Hand, rng: np.random.Generator) -> tuple[WorkspaceRow, ...]:
    matrix, value = hand.coupling_matrix
    inverse = np.linalg.pinv(matrix) if len(value) else np.zeros((hand.nq, 0))
    tips: dict[str, list[FloatArray]] = {name: [] for name in hand.fingers}
    for sample in rng.uniform(hand.q_lower, hand.q_upper, (SAMPLES, hand.nq)):
        q = sample - inverse @ (matrix @ sample - value)
        q = np.clip(q, hand.q_lower, hand.q_upper)
        q[hand.wrist_index] = np.clip(0, hand.q_lower, hand.q_upper)[hand.wrist_index]
        state = HandState(hand, q)
        for finger in hand.fingers.values():
            tips[finger.name].append(np.array(state.tip_pose(finger).translation))
    return tuple(
        WorkspaceRow(
            finger=name, lower=_triple(np.min(p, axis=0)), upper=_triple(np.max(p, axis=0))
        )
        for name, p in tips.items()
    )


def _touches(hand: Hand, findings: Findings) -> tuple[TouchRow, ...]:
    """Parts that overlap at rest and must not, as coal and as MuJoCo see it."""
    q = hand.neutral
    poses = placed_geometries(hand, q)
    in_mujoco = {(a, b) for a, b, d in touching_geoms(hand.mj_model, q) if d < 0}
    out = []
    for i, j in separate_pairs(hand):
        a, b = hand.geometries[i], hand.geometries[j]
        depth = DistancePair(a.geometry, b.geometry).distance(poses[i], poses[j])
        names = (min(a.name, b.name), max(a.name, b.name))
        if depth >= TOUCHING and names not in in_mujoco:
            continue
        out.append(
            TouchRow(
                first=names[0],
                second=names[1],
                coal=float(depth),
                mujoco=geom_distance(hand.mj_model, q, a.name, b.name),
                collides_in_mujoco=names in in_mujoco,
            )
        )
    body = {g.name: g.body for g in hand.geometries}
    for row in out:
        findings.warning(
            f"{row.first} and {row.second} overlap by {-1e3 * row.coal:.2f} mm at rest",
            f'if they always do, write exclude = [["{body[row.first]}", '
            f'"{body[row.second]}"]] under [repair]; a pose in which they part will do as well',
        )
        if abs(row.coal - row.mujoco) > DISTANCE_TOL:
            findings.note(
                f"coal says {1e3 * row.coal:.2f} mm and MuJoCo {1e3 * row.mujoco:.2f} mm "
                f"for {row.first} and {row.second}",
                "nothing: engines measure deep overlaps differently",
            )
    return tuple(out)


def _kinematics_error(hand: Hand, rng: np.random.Generator, findings: Findings) -> float:
    """Largest distance (m) between the same body in Pinocchio and in MuJoCo."""
    model = hand.mj_model
    frames = [hand.pin_model.getBodyId(body_name(model, i)) for i in range(1, model.nbody)]
    worst = 0.0
    for q in rng.uniform(hand.q_lower, hand.q_upper, (5, hand.nq)):
        data = hand.pin_model.createData()
        pin.framesForwardKinematics(hand.pin_model, data, q)
        ours = np.array([data.oMf[f].translation for f in frames])
        worst = max(worst, float(np.abs(ours - body_positions(model, q)[1:]).max()))
    if worst > KINEMATICS_TOL:
        findings.error(
            f"Pinocchio and MuJoCo place a body {1e3 * worst:.3g} mm apart",
            "report it with the model: opposable crosscheck shows where",
        )
    return worst


def _triple(v: FloatArray) -> tuple[float, float, float]:
    return (float(v[0]), float(v[1]), float(v[2]))


def _listed(names: Sequence[str]) -> str:
    few = ", ".join(names[:4])
    return few if len(names) <= 4 else f"{few} and {len(names) - 4} more"
