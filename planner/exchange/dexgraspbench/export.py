"""DexGraspBench's files of grasps, its squeeze pose, and the folder that it evaluates.

Grasps as DexGraspBench reads them: a dictionary in an .npy file each.

    obj_path                   folder with urdf/meshes/*.obj, convex, and info/simplified.json
    obj_scale                  factor on the object's meshes; 1 here
    obj_pose (7,)              frame of the object's file, position (m) and quaternion w, x, y, z
    pregrasp_qpos, grasp_qpos, squeeze_qpos (7 + nq,)   world of the hand's model file as position
                               and quaternion w, x, y, z, then joints in the order of that file

The benchmark commands R qpos to the actuators, R the transmission: it takes them for position
servos. So the squeeze pose is the posture with R q = the commands that make the forces of
``plan_squeeze`` by the hand's own actuator laws, nearest to the grasp.

Squeeze pose for DexGraspBench: how far beyond the grasp its servos are commanded.

The benchmark commands one posture and holds it throughout: its servos are springs about it, and a
grasp gives way as ``planner.certify.stiffness.GraspStiffness`` tells. A squeeze of s times
the planned forces f0, which press without a load and balance, is good when after every change that
the protocol brings each contact still holds:

    f_i = s f0_i + change_i(s, load) -+ e_i(s),

in the soft-finger cone of the benchmark, for all loads, where e_i is what the misplaced contacts
change: they are not where the plan has them, by ``MISPLACED``. Too small an s leaves no friction
to the loads. Too large a one turns the object aside, by forces that miss the points where they
balance and at last by themselves: s stays below ``STABLE`` of that, and turns less than ``TURNED``,
while contacts creep as long as the benchmark holds: the more, the lighter a finger's links are.
The squeeze is the least s that leaves ``SPARE`` of every normal force, or the one that leaves most.

Plans, rather than a batch, as a folder that DexGraspBench evaluates; see the package.

The folder is that of ``export_dexgraspbench``, with the grasps of an object numbered in the order
in which they are given.
"""

from __future__ import annotations

import math
import os
import secrets
import shutil
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from planner.batch.dataset import GraspSet
from planner.batch.recipe import label_of, with_fingers_of
from planner.batch.rows import found_row
from planner.certify.stiffness import GraspStiffness
from planner.contacts import ContactSet
from planner.errors import FileFormatError, PlannerError, TaskError, shown
from planner.exchange.dexgraspbench.models import (
    T_model_base,
    file_name,
    frame_shift,
    write_hand,
    write_object,
)
from planner.exchange.formats import Writing
from planner.forces import ForceSolution
from planner.hands.hand import Hand
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray, pose_from_wxyz, pose_to_wxyz
from planner.task import GraspTask
from planner.verification import plan_forces

MASS = 0.1
"""Of every object in the benchmark, kg (``config/task/eval.yaml``)."""

PUSH = 10.0
"""Force over mass that stands for gravity, m/s2, in all six directions (``fc_mocap.py``)."""

JERK = 25.0
"""Acceleration (m/s2) of a lift in the benchmark: the hand's target jumps by 10 mm, and the weld
that draws it there has the time constant 20 ms: 10 mm / (20 ms)^2 (``tabletop_mocap.py``)."""

LOADS = np.vstack(
    [PUSH * np.vstack([np.eye(3), -np.eye(3)]), (PUSH + JERK) * np.array([[0.0, 0.0, -1.0]])]
)
"""Forces over mass (7, 3), m/s2, in world axes, on the object's centre of mass; the last is the
lift's."""

PUSHES = len(LOADS) - 1
"""How many of them are pushes: all but the lift."""

FRICTION = 0.6
"""Friction coefficient of the benchmark (-) (``config/task/eval.yaml``)."""

TORSION = 0.02
"""Its torsional friction, m."""

FRICTION_SHARES = (0.3, 0.5, 0.8)
"""Shares of the planned friction coefficient (-) with which pressing forces are tried: with little
friction in use, more is left to the loads, but balanced forces may be very unequal. The set that
leaves most friction is taken, and of those with enough the gentlest; ``LAST_SHARE`` if there is
none with these."""

LAST_SHARE = 1.0
"""Of the friction in planning, which is below the benchmark's."""

SPARE = 0.3
"""Share of normal forces (-) that a squeeze leaves under every load: small changes alone are
linear."""

STABLE = 0.9
"""Share of the force at which a grasp buckles that a squeeze may use (-). What loads and errors do
grows without bound there, which ``_use`` counts; the last tenth is a reserve for tips whose shape
is not known exactly."""

FACTORS = 1.1 ** np.arange(-7.0, 22.0)
"""Multiples of the planned forces that are tried (-), 0.5 to 7.4: in steps of a tenth."""

TURNED = math.radians(15.0)
"""Rotation with which the benchmark calls an object lost, rad."""

HOLD = 2.0
"""Time (s) for which the benchmark holds."""

CREEP = 1.9e-5
"""Speed (m/s) of a contact per newton along its surface and inverse mass of 1 /kg. Friction there
is a damper: with impedance d 0.97, damping b 165 /s and impratio 10 it is (1 - d) / (d b impratio).
Two noslip iterations stop two contacts, but hardly the coupled ones of a hand."""

TINY = 1e-9
"""Least normal force, N, by which is divided."""

MISPLACED = 0.001
"""Distance (m) between a contact and its plan: the servos lag by different times, so that the first
finger to touch pushes the object before the last one does."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Squeeze:
    """A squeeze, or the reason why there is none.

    Attributes:
        reason: Why not; "" if there is one.
        ctrl: Commands (nu,) of the actuators; empty without one.
        factor: Planned forces are multiplied by this (-); NaN without one.
        use: Share of a normal force, or of the rotation that is let pass, that the loads need at
            most (-); above 1 they may win. NaN without one.
        forces: Normal forces (n,) at the grasp, N, but for what actuators that stand at their limit
            lack; empty without one.
        torques: Of the joints (nq,), which make these forces, N m; empty without one.
    """

    reason: str = ""
    ctrl: FloatArray
    factor: float
    use: float
    forces: FloatArray
    torques: FloatArray

    def posture(self, task: GraspTask, q: FloatArray) -> FloatArray:
        """Joints (nq,) whose lengths R q are the commands, the nearest to q (nq,).

        The benchmark sends R q to the actuators. Joints without an actuator stay.

        Raises:
            PlannerError: There is no squeeze.
        """
        if self.reason:
            raise PlannerError(f"no squeeze: {self.reason}; leave the grasp out")
        moment = task.hand.actuation.moment
        out: FloatArray = q + np.linalg.pinv(moment) @ (self.ctrl - moment @ q)
        return out


def without_servos(hand: Hand) -> str:
    """Why a hand cannot be commanded by postures; "" if it can."""
    actuation = hand.actuation
    motors = [n for n, b in zip(actuation.names, actuation.bias, strict=True) if b[1] >= 0]
    if not motors:
        return ""
    return f"{', '.join(motors)} of {hand.name} are no position servos"


def plan_squeeze(
    task: GraspTask,
    contacts: ContactSet,
    T_world_base: SE3,
    q: FloatArray,
    *,
    mass: float = MASS,
    lifted: bool = True,
) -> Squeeze:
    """The squeeze of a grasp.

    Args:
        task: Gives grip, friction and hand; its gravity and mass do not count.
        contacts: One contact per finger of the task, world.
        T_world_base: Base pose.
        q: Joints (nq,).
        mass: Of the object there, kg.
        lifted: Whether it is lifted there, too.
    """
    none = np.zeros(0)
    floating = replace(task, gravity=np.zeros(3))
    best: tuple[float, float, float, ForceSolution] | None = None
    for forces in _pressing(floating, contacts, T_world_base, q):
        for bearing, pressed in _bearing(floating, forces) if forces.found else ():
            stiffness = GraspStiffness.of(bearing, pressed, T_world_base, q)
            held = mass * LOADS[: None if lifted else PUSHES], _slides(bearing, mass)
            use, factor = _least_factor(task, stiffness, forces, q, *held)
            found = max(use, 1.0 - SPARE), factor * forces.forces[:, 0].max(), factor, forces
            if best is None or found[:2] < best[:2]:
                best = found
    nothing = Squeeze(
        reason=forces.reason, ctrl=none, factor=math.nan, use=math.nan, forces=none, torques=none
    )
    if best is None:
        return nothing
    use, _, factor, forces = best
    if not np.isfinite(use):
        reason = "no squeeze is within the actuators' limits and below buckling"
        return replace(nothing, reason=reason, use=use)
    torques = factor * forces.joint_torques
    ctrl, _ = task.hand.actuation.ctrl_for_torque(q, np.zeros_like(q), torques)
    normals = factor * forces.forces[:, 0]
    return Squeeze(ctrl=ctrl, factor=factor, use=use, forces=normals, torques=torques)


def _pressing(
    task: GraspTask, contacts: ContactSet, T_world_base: SE3, q: FloatArray
) -> Iterator[ForceSolution]:
    """Forces that balance without a load, at several shares of friction.

    If there are none: with all of the friction, then with fingers of a pair that need not press
    beside its palms.
    """
    given = task, contacts, T_world_base, q
    tried = [plan_forces(*given, friction_scale=share) for share in FRICTION_SHARES]
    yield from tried
    if not any(forces.found for forces in tried):
        last = plan_forces(*given, friction_scale=LAST_SHARE)
        yield last
        if not last.found and task.hand.pair:
            palms = np.where(task.least_normals < task.grip_force, 0.0, task.least_normals)
            yield plan_forces(*given, friction_scale=LAST_SHARE, min_normal=palms)


def _bearing(task: GraspTask, forces: ForceSolution) -> Iterator[tuple[GraspTask, ForceSolution]]:
    """Task and forces with all contacts, and with those alone that press with the grip.

    A link or palm that only lies against the object is let go by the first load that draws it away:
    what then holds are the others.
    """
    yield task, forces
    light = (task.least_normals == 0.0) & (forces.forces[:, 0] < task.grip_force)
    if not light.any() or len(light) - light.sum() < task.fingers_needed:
        return
    contacts = [forces.contacts[int(i)] for i in np.flatnonzero(~light)]
    names = [n for n, away in zip(task.finger_names, light, strict=True) if not away]
    yield (
        task.with_fingers(names),
        replace(
            forces,
            contacts=ContactSet.from_contacts(contacts, center=forces.contacts.center),
            forces=forces.forces[~light],
        ),
    )


def _slides(task: GraspTask, mass: float) -> FloatArray:
    """How far contacts creep while the benchmark holds (n, 3), m/N and rad/(N m)."""
    model = task.hand.mj_model
    bodies = [int(model.geom(finger.pad.geom).bodyid[0]) for finger in task.fingers]
    inverse = 1.0 / mass + model.body_invweight0[bodies, 0]
    spin = (FRICTION / TORSION) ** 2  # MuJoCo scales impedances of an elliptic cone so
    return np.asarray(HOLD * CREEP * inverse[:, None] * [1.0, 1.0, spin])


def _least_factor(
    task: GraspTask,
    stiffness: GraspStiffness,
    forces: ForceSolution,
    q: FloatArray,
    loads: FloatArray,
    slides: FloatArray,
) -> tuple[float, float]:
    """Share of the friction in use, and the factor of the forces; see the module."""
    limit, actuation = STABLE * stiffness.buckling, task.hand.actuation

    def allowed(factor: float) -> bool:
        torques = factor * forces.joint_torques
        return factor < limit and not actuation.short_of(q, torques, 1e-9).any()

    tried = [factor for factor in FACTORS if allowed(factor)]
    if tried and tried[-1] < FACTORS[-1]:  # what the actuators give beyond the last step counts
        low, high = tried[-1], 1.1 * tried[-1]
        for _ in range(20):
            middle = (low + high) / 2
            low, high = (middle, high) if allowed(middle) else (low, middle)
        tried.append(low)
    uses = [_use(stiffness, factor, loads, slides) for factor in tried]
    for i, (use, factor) in enumerate(zip(uses, tried, strict=True)):
        if factor >= 1.0 and use <= 1.0 - SPARE:
            if factor == 1.0 or i == 0 or uses[i - 1] <= 1.0 - SPARE:
                return use, factor
            share = (uses[i - 1] - (1.0 - SPARE)) / (uses[i - 1] - use)
            return 1.0 - SPARE, tried[i - 1] + share * (factor - tried[i - 1])
    return min(zip(uses, tried, strict=True), default=(float("inf"), 1.0))


def _use(stiffness: GraspStiffness, factor: float, loads: FloatArray, slides: FloatArray) -> float:
    """Largest share (-) of a contact's normal force, or of ``TURNED``, that any load needs."""
    m, n = len(loads), len(stiffness.forces)
    wrenches = np.hstack([loads, np.zeros_like(loads)])
    changes, turned = stiffness.crept(factor, wrenches, MISPLACED, slides)
    alone, changes = changes[0], changes[1:]
    # a finger out of place presses on all others, and the object settles between them
    lost = np.linalg.norm(changes[m : m + n, :, 0], axis=0)
    force = factor * stiffness.forces + alone + changes[:m]
    sliding = np.linalg.norm(force[:, :, 1:3], axis=2) / FRICTION
    needed = np.hypot(sliding, force[:, :, 3] / TORSION) + lost - alone[:, 0] - changes[:m, :, 0]
    slips = float((needed / np.maximum(factor * stiffness.forces[:, 0], TINY)).max())
    # the lift is over before contacts have crept
    most = np.linalg.norm(turned[0] + turned[1 : 1 + PUSHES], axis=1).max()
    return max(slips, float(most + np.linalg.norm(turned[1 + m :])) / TURNED)


@dataclass(frozen=True, kw_only=True)
class Exported:
    """Result of an export.

    Attributes:
        hand: Name of the hand for the benchmark.
        written: How many grasps.
        left_out: Reason -> how many grasps were left out for it.
    """

    hand: str
    written: int
    left_out: Mapping[str, int]

    @property
    def summary(self) -> str:
        """One sentence."""
        text = f"{self.written} grasps exported"
        if not self.left_out:
            return text
        reasons = "; ".join(f"{count}: {reason}" for reason, count in self.left_out.items())
        return f"{text}, {sum(self.left_out.values())} left out ({reasons})"


def export_dexgraspbench(
    grasps: GraspSet, folder: Path | str, *, need_all: bool = False
) -> Exported:
    """Write the found grasps of a batch, their objects and their hand.

    In ``folder``, with HAND the name in the result: ``graspdata/HAND/OBJECT/K.npy``,
    ``object/OBJECT/``, ``hand/HAND.yaml`` for the benchmark's ``config/hand`` and ``hand/HAND/``
    with the model and its meshes. Paths in these files are absolute. Several hands may share a
    folder. A grasp that cannot press without gravity is left out.

    Args:
        grasps: The batch.
        folder: Made if it does not exist.
        need_all: Whether a grasp that cannot press is an error instead.

    Raises:
        TaskError: The hand is on an arm, whose way in this format tells differently, or has
            actuators that follow no position; or two objects would have one folder.
        ModelError: The MuJoCo that the benchmark pins cannot read such a hand.
        FileFormatError: The folder cannot be written or holds another hand of that name, or a
            grasp cannot press and all are needed.
    """
    folder = Path(folder).resolve()
    hand = _allowed(grasps.task(grasps.labels[0]).hand)
    _need_distinct_folders(grasps.labels)
    written = 0
    left_out: Counter[str] = Counter()
    T_base_model = T_model_base(hand).inverse()
    try:
        name = write_hand(hand, folder / "hand")
        for label in grasps.labels:
            task = grasps.task(label)
            place = folder / "object" / file_name(label)
            write_object(task, place)
            target = folder / "graspdata" / name / file_name(label)
            target.mkdir(parents=True, exist_ok=True)
            for old in target.glob("*.npy"):
                old.unlink()  # of an export before
            for _, row in grasps.found(label):
                reason, squeeze = _pressed(task, row)
                if squeeze is None:
                    if need_all:
                        raise FileFormatError(
                            f"grasp {row['k']} of {label!r} cannot press without gravity: "
                            f"{reason}; leave out such grasps, or plan with a smaller grip"
                        )
                    left_out[reason.split(";")[0]] += 1  # the same for many
                    continue
                data: Any = grasp_dict(task, row, place, squeeze, T_base_model)
                np.save(target / f"{row['k']}.npy", data, allow_pickle=True)
                written += 1
    except OSError as error:
        raise FileFormatError(f"cannot write to {folder}: {error.strerror}") from error
    return Exported(hand=name, written=written, left_out=dict(left_out))


def grasp_dict(
    task: GraspTask,
    row: Mapping[str, Any],
    obj_path: Path,
    squeeze: Squeeze,
    T_base_model: SE3,
) -> dict[str, Any]:
    """One grasp in the benchmark's form; see the module.

    The object is where the task has it, but with the table's top at z = 0, where the benchmark
    puts its floor.

    Args:
        task: The task of the row's object.
        row: A row with a grasp.
        obj_path: The object's folder.
        squeeze: Of the grasp.
        T_base_model: World of the hand's model file in the frame of the hand's base.
    """
    lift = SE3(np.eye(3), np.array([0.0, 0.0, -(task.table_height or 0.0)]))
    T_world_object = lift * task.T_world_object
    base = _flat(T_world_object * _base(row) * T_base_model)
    to_file = SE3(np.eye(3), -frame_shift(task.object.shape))
    q, opened = np.array(row["q_rad"]), np.array(row["q_pregrasp_rad"])
    return {
        "obj_path": str(obj_path),
        "obj_scale": 1.0,
        "obj_pose": _flat(T_world_object * to_file),
        "pregrasp_qpos": np.concatenate([base, opened]),
        "grasp_qpos": np.concatenate([base, q]),
        "squeeze_qpos": np.concatenate([base, squeeze.posture(task, q)]),
    }


def row_squeeze(task: GraspTask, row: Mapping[str, Any]) -> Squeeze:
    """The squeeze of a row with a grasp."""
    contacts = ContactSet.from_arrays(
        row["contact_positions_object_m"],
        row["contact_normals_object"],
        mu=task.mu,
        mu_torsion=task.mu_torsion,
        model=task.contact_model,
        fingers=task.finger_names,
    ).transformed(task.T_world_object)
    return plan_squeeze(task, contacts, task.T_world_object * _base(row), np.array(row["q_rad"]))


def _pressed(task: GraspTask, row: Mapping[str, Any]) -> tuple[str, Squeeze | None]:
    """Why a row has no squeeze, "" if it has, and the squeeze; one that fails ends itself alone."""
    try:
        squeeze = row_squeeze(with_fingers_of(task, row), row)
    except PlannerError as error:
        return str(error), None
    return squeeze.reason, None if squeeze.reason else squeeze


def _need_distinct_folders(labels: Sequence[str]) -> None:
    """The grasps of one object would replace those of another."""
    first: dict[str, str] = {}
    for label in labels:
        other = first.setdefault(file_name(label), label)
        if other != label:
            raise TaskError(
                f"the objects {shown(other)} and {label!r} would both be exported as "
                f"{file_name(label)!r}; plan one of them in another batch, or give it another name"
            )


def _base(row: Mapping[str, Any]) -> SE3:
    """Base pose of a row in the object's frame."""
    return pose_from_wxyz(
        np.array(row["base_position_object_m"]), np.array(row["base_quaternion_object_wxyz"])
    )


def _flat(pose: SE3) -> FloatArray:
    """Position (m) and quaternion w, x, y, z in one (7,)."""
    return np.concatenate(pose_to_wxyz(pose))


def write_dexgraspbench(
    plans: Sequence[GraspPlan], folder: Path, writing: Writing
) -> tuple[Path, ...]:
    """Write plans of one hand, with their objects and the hand.

    Args:
        plans: At least one.
        folder: Made here; it must not exist, or be empty.
        writing: Not heeded: the benchmark has names of its own.

    Returns:
        The files of the grasps.

    Raises:
        TaskError: Several hands, a hand on an arm or without position servos, two objects of one
            name, or a grasp that cannot press without gravity.
        ModelError: The MuJoCo that the benchmark pins cannot read such a hand.
        FileFormatError: The folder holds something, or cannot be written.
    """
    hand = _one_hand(plans)
    grouped = _by_object(plans)
    squeezes = [_squeeze(i, plan) for i, plan in enumerate(plans)]
    folder = folder.resolve()
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise FileFormatError(f"{folder} exists and is no empty folder; name another one")
    part = folder.with_name(f".{secrets.token_hex(8)}.part")
    digits = len(str(max(map(len, grouped.values())) - 1))
    written = []
    try:
        part.mkdir()
        name = write_hand(hand, part / "hand", moved_to=folder / "hand")
        T_base_model = T_model_base(hand).inverse()
        for label, numbers in grouped.items():
            write_object(plans[numbers[0]].task, part / "object" / label)
            target = part / "graspdata" / name / label
            target.mkdir(parents=True)
            for k, number in enumerate(numbers):
                plan = plans[number]
                row = found_row(number, label, k, plan, [])
                place = folder / "object" / label
                data: Any = grasp_dict(plan.task, row, place, squeezes[number], T_base_model)
                file = target / f"{k:0{digits}}.npy"
                np.save(file, data, allow_pickle=True)
                written.append(folder / file.relative_to(part))
        with suppress(OSError):
            folder.rmdir()  # an empty one
        os.replace(part, folder)
    except OSError as error:
        raise FileFormatError(f"cannot write {folder}: {error.strerror or error}") from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return tuple(written)


def _one_hand(plans: Sequence[GraspPlan]) -> Hand:
    """The hand of all plans."""
    hand = plans[0].task.hand
    others = {plan.task.hand.name for plan in plans if plan.task.hand.digest != hand.digest}
    if others:
        raise TaskError(
            f"the plans are for more than one hand, {hand.name} and {', '.join(sorted(others))}; "
            "write a folder for each"
        )
    return _allowed(hand)


def _allowed(hand: Hand) -> Hand:
    """A hand, if the benchmark can have it."""
    hand.require_one("export for DexGraspBench")
    if hand.arm is not None:
        raise TaskError(
            f"{hand.name} is on an arm, and DexGraspBench takes hands alone; plan with the hand "
            "without its arm"
        )
    if reason := without_servos(hand):
        raise TaskError(
            f"{reason}; DexGraspBench commands postures: plan with a hand that has position servos"
        )
    return hand


def _by_object(plans: Sequence[GraspPlan]) -> dict[str, list[int]]:
    """Numbers of the plans by the name of their object's folder."""
    grouped: dict[str, list[int]] = defaultdict(list)
    for i, plan in enumerate(plans):
        grouped[file_name(label_of(plan.task))].append(i)
    for label, numbers in grouped.items():
        specs = {plans[i].task.object.shape.spec for i in numbers}
        if len(specs) > 1:
            raise TaskError(
                f"the objects {' and '.join(sorted(specs))} would both be exported as {label!r}; "
                "write a folder for each, or give one of them another name"
            )
    return dict(grouped)


def _squeeze(number: int, plan: GraspPlan) -> Squeeze:
    found = plan_squeeze(plan.task, plan.contacts, plan.T_world_base, plan.q)
    if found.reason:
        raise TaskError(
            f"plan {number} cannot press without gravity: {found.reason}; leave it out, or plan "
            "with a smaller grip"
        )
    return found
