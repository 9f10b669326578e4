"""Joints as a driver knows them: which are told, by which names, and which follow.

A joint that no actuator moves and that the equality couplings C q = d tie to the others is a
follower: a driver moves it with the others and has no name for it, so that files for drivers leave
it out. A reader computes it from the same couplings. An actuator that moves several joints (a
tendon) has one number for them, its length R q + length0.

Poses of a plan in frames that others know, and what a format refuses.

Others know an object by its file, so that poses are written in the frame of that file; our own
frame has its origin at the centre of mass. What is not from a file keeps our frame.

Joints and poses of a file that says little of itself, as one of our hands has them.

A file may name no joints, name them by another numbering, leave out a wrist, and give the pose of a
body that is not the hand's base. ``FileJoints`` settles this once per file.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from planner.errors import FileFormatError, NotFoundError, TaskError, few_of
from planner.exchange.dexgraspbench.models import frame_shift
from planner.exchange.formats import Reading, Writing, joints_by_name
from planner.exchange.yaml_text import read_documents, table, text
from planner.hands.hand import Hand
from planner.kinematics import HandState
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray, IntArray, pose_from_wxyz
from planner.task import GraspTask

DETERMINED = 1e-9
"""A joint is tied by couplings if each direction that they leave free moves it by less (-)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Channels:
    """Numbers that a driver is told, one per joint or actuator.

    Attributes:
        names: n names, as the file calls them.
        matrix: (n, nq), value = matrix q + offset.
        offset: (n,), rad or m.
        said: Sentences that name joints left out and joints commanded together.
    """

    names: tuple[str, ...]
    matrix: FloatArray
    offset: FloatArray
    said: tuple[str, ...]

    def values(self, q: FloatArray) -> FloatArray:
        """Values (..., n), rad or m, at joints (..., nq)."""
        return np.asarray(np.asarray(q) @ self.matrix.T + self.offset)

    def by_name(self, q: FloatArray) -> dict[str, float]:
        """Values, rad or m, by name at joints (nq,)."""
        return dict(zip(self.names, self.values(q).tolist(), strict=True))


def followers(hand: Hand) -> IntArray:
    """Where joints stand in q that no actuator moves and equality couplings determine."""
    idle = np.flatnonzero(~hand.actuation.moment.any(axis=0))
    rows = _equalities(hand)[0][:, idle]
    if not len(idle) or not len(rows):
        return np.zeros(0, dtype=int)
    _, sizes, directions = np.linalg.svd(rows)
    rank = int((sizes > DETERMINED * sizes.max(initial=1.0)).sum())
    free = np.abs(directions[rank:]).max(axis=0, initial=0.0)
    return np.asarray(idle[free < DETERMINED])


def channels_of(hand: Hand, writing: Writing) -> Channels:
    """What a file tells of a hand's joints.

    Raises:
        NotFoundError: ``rename`` names a joint or actuator that is not told.
        TaskError: Two would have one name, or the hand has no actuators to go by.
    """
    left_out = followers(hand)
    if writing.by == "actuators":
        actuation = hand.actuation
        if not actuation.names:
            raise TaskError(f"{hand.name} has no actuators; export it by joints")
        names, matrix, offset = actuation.names, actuation.moment, actuation.length0
        what = "actuator"
        said: tuple[str, ...] = ("values are lengths of actuators, not positions of joints",)
    else:
        kept = np.setdiff1d(np.arange(hand.nq), left_out)
        names = tuple(hand.joint_names[i] for i in kept)
        matrix, offset, what = np.eye(hand.nq)[kept], np.zeros(len(kept)), "joint"
        said = ()
    if len(left_out):
        tied = ", ".join(hand.joint_names[i] for i in left_out)
        said += (f"left out, since they follow other joints by couplings: {tied}",)
    loose = np.setdiff1d(np.flatnonzero(~hand.actuation.moment.any(axis=0)), left_out)
    if len(loose):
        idle = ", ".join(hand.joint_names[i] for i in loose)
        said += (f"moved by no actuator and tied by no coupling that always holds: {idle}",)
    return Channels(
        names=renaming(names, writing.rename, f"{what} of {hand.name}"),
        matrix=matrix,
        offset=offset,
        said=said + _together(hand),
    )


def completed_joints(
    hand: Hand,
    names: Sequence[str],
    values: FloatArray,
    *,
    where: str,
    other_names: Mapping[str, str] | None = None,
) -> FloatArray:
    """Joints (nq,) of our hand from values by name, with followers from the couplings.

    Args:
        hand: Our hand.
        names: Joint names of the file.
        values: (n,), rad or m.
        where: Place in the file, for messages.
        other_names: Name in the file -> name of our joint, where they differ.

    Raises:
        FileFormatError: As ``joints_by_name``; followers may be missing.
    """
    mine = {(other_names or {}).get(name, name) for name in names}
    tied = np.array([i for i in followers(hand) if hand.joint_names[i] not in mine], dtype=int)
    added = [hand.joint_names[i] for i in tied]
    padded = np.concatenate([np.asarray(values, dtype=np.float64), np.zeros(len(tied))])
    q = joints_by_name(hand, [*names, *added], padded, where=where, other_names=other_names)
    if len(tied):
        matrix, value = _equalities(hand)
        rest = value - matrix @ q  # followers are at zero in it
        q[tied] = np.linalg.lstsq(matrix[:, tied], rest, rcond=None)[0]
    if not np.isfinite(q).all():
        raise FileFormatError(f"{where} holds NaN or infinity; give finite numbers")
    return q


def renaming(names: Sequence[str], rename: Mapping[str, str], what: str) -> tuple[str, ...]:
    """Names after a renaming.

    Args:
        names: Ours.
        rename: Ours -> theirs, where they differ.
        what: What they are names of, for messages: "joint of NAME".

    Raises:
        NotFoundError: A name that is not there is renamed.
        TaskError: Two would have one name.
    """
    for name in rename:
        if name not in names:
            raise NotFoundError(what, name, names)
    new = tuple(rename.get(name, name) for name in names)
    doubled = sorted({name for name in new if new.count(name) > 1})
    if doubled:
        raise TaskError(
            f"after renaming, more than one {what} is called {', '.join(doubled)}; give each a "
            "name of its own"
        )
    return new


def read_renaming(path: Path) -> dict[str, str]:
    """Names out of a TOML, YAML or JSON file of OLD = NEW.

    Raises:
        FileFormatError: It cannot be read, or holds something else.
    """
    what = "a file of names"
    if path.suffix.lower() == ".toml":
        try:
            data: Any = tomllib.loads(path.read_text("utf-8"))
        except OSError as error:
            raise FileFormatError(f"cannot read {what} {path}: {error.strerror}") from error
        except ValueError as error:  # not TOML, or not text
            raise FileFormatError(f"{path} is damaged or not TOML: {error}") from error
    else:
        documents = read_documents(path, what)
        data = documents[0] if len(documents) == 1 else documents
    return {old: text(new, f"{path}: {old}") for old, new in table(data, str(path)).items()}


def _equalities(hand: Hand) -> tuple[FloatArray, FloatArray]:
    """C (m, nq) and d (m,) of the couplings that hold always, not in a grasp alone."""
    chosen = [c for c in hand.couplings if not c.one_sided]
    rows = np.array([c.row for c in chosen], dtype=np.float64).reshape(-1, hand.nq)
    return rows, np.array([c.value for c in chosen], dtype=np.float64)


def _together(hand: Hand) -> tuple[str, ...]:
    """Sentences on actuators that move more than one joint."""
    actuation = hand.actuation
    told = []
    for name, row in zip(actuation.names, actuation.moment, strict=True):
        at = np.flatnonzero(row)
        if len(at) > 1:
            parts = " + ".join(
                hand.joint_names[i] if row[i] == 1.0 else f"{row[i]:g} {hand.joint_names[i]}"
                for i in at
            )
            told.append(f"actuator {name} commands {parts}")
    return tuple(told)


def T_file_object(task: GraspTask) -> SE3:
    """Pose of our frame of a task's object in the frame of the object's own file."""
    return SE3(np.eye(3), frame_shift(task.object.shape))


def T_base_body(hand: Hand, q: FloatArray, body: str) -> SE3:
    """Pose of a body of a hand in its base, at joints (nq,); of the base itself for "".

    Raises:
        NotFoundError: The hand has no such body.
    """
    if body in ("", hand.description.base_body):
        return SE3.Identity()
    bodies = [f.name for f in hand.pin_model.frames if f.type == pin.FrameType.BODY]
    if body not in bodies:
        raise NotFoundError(f"body of {hand.name}", body, bodies)
    return SE3(HandState(hand, q).pin_data.oMf[hand.pin_model.getBodyId(body)])


def T_object_body(plan: GraspPlan, body: str = "") -> SE3:
    """Pose of a body of the hand at the grasp, in the frame of the object's own file.

    Raises:
        NotFoundError: The hand has no such body.
    """
    task = plan.task
    T_object_base = task.T_world_object.inverse() * plan.T_world_base
    return T_file_object(task) * T_object_base * T_base_body(task.hand, plan.q, body)


def object_frame(task: GraspTask, writing: Writing) -> str:
    """Name of the object's frame in a file."""
    return writing.object_frame or task.object.name


def hand_frame(hand: Hand, writing: Writing) -> str:
    """Name of the hand's frame in a file."""
    return writing.hand_frame or writing.base_body or hand.description.base_body


def need_no_arm(task: GraspTask, what: str) -> Hand:
    """The hand of a task.

    Raises:
        TaskError: It is on an arm, or two hands.
    """
    task.hand.require_one(what)
    if task.hand.arm is not None:
        raise TaskError(
            f"{task.hand.name} is on an arm, and {what} tells the pose of a hand alone; plan with "
            "the hand without its arm, or export ros2-trajectory"
        )
    return task.hand


def need_one_pair(plans: Sequence[GraspPlan], what: str) -> GraspTask:
    """A task that all plans share as far as hand and object go.

    Raises:
        TaskError: They are of several hands or objects.
    """
    first = plans[0].task
    for plan in plans[1:]:
        task = plan.task
        for kind, mine, other, same in (
            ("hand", first.hand.name, task.hand.name, first.hand.digest == task.hand.digest),
            ("object", first.object.name, task.object.name, _same_object(first, task)),
        ):
            if not same:
                raise TaskError(
                    f"the plans are for more than one {kind}, {mine} and {other}, and a file of "
                    f"{what} is for one; write a file for each"
                )
    return first


def _same_object(one: GraspTask, other: GraspTask) -> bool:
    a, b = one.object, other.object
    return a is b or (a.name, a.shape.spec) == (b.name, b.shape.spec)


_SHADOW = re.compile(r"(?:robot0:|rh_|lh_)?((?:FF|MF|RF|LF|TH|WR)J)(\d)")
"""Joints of the Shadow hand: its maker counts from 1, the model of OpenAI (``robot0:``) from 0."""

NORM_TOL = 1e-2
"""How far the length of a quaternion may be from 1 (-): files hold single precision."""


def pose_of_seven(values: FloatArray, order: str, where: str) -> SE3:
    """Pose from position (m) and quaternion in one (7,).

    Args:
        values: (7,).
        order: "wxyz" or "xyzw".
        where: Place in the file, for messages.

    Raises:
        FileFormatError: Other numbers, not finite, or no unit quaternion.
    """
    array = np.asarray(values, dtype=float).reshape(-1)
    if array.shape != (7,) or not np.isfinite(array).all():
        raise FileFormatError(
            f"{where} is {np.shape(values)} numbers, or not finite; a pose is x, y, z (m) and a "
            f"quaternion {', '.join(order)}"
        )
    norm = float(np.linalg.norm(array[3:]))
    if abs(norm - 1.0) > NORM_TOL:
        raise FileFormatError(
            f"{where}: the last four of {np.round(array, 4).tolist()} have length {norm:.4g}, and "
            "a quaternion has length 1; it is damaged, or not a pose x, y, z and a quaternion"
        )
    quaternion = array[3:] if order == "wxyz" else array[[6, 3, 4, 5]]
    return pose_from_wxyz(array[:3], quaternion)


class FileJoints:
    """How the joints of a file become those of a hand, and its poses those of the hand's base."""

    def __init__(
        self,
        hand: Hand,
        reading: Reading,
        where: str,
        *,
        names: Sequence[str] | None = None,
        count: int,
        base_body: str = "",
    ) -> None:
        """Settle names.

        Args:
            hand: Our hand.
            reading: What the reader is told.
            where: The file, for messages.
            names: As the file gives them; None where it gives none.
            count: How many joints the file has.
            base_body: Body whose pose the format gives, if ``reading`` names no other; "" for the
                hand's base.

        Raises:
            FileFormatError: The file names no joints and nobody did, or they do not fit.
            NotFoundError: The hand has no such body.
        """
        self.hand, self.where = hand, where
        self.body = reading.base_body or base_body
        self.assumed: list[str] = []
        told = reading.joint_names or names
        held = self._held()
        if reading.joint_names is not None and len(reading.joint_names) != count:
            raise FileFormatError(
                f"{where} has {count} joints and --joint-names gives {len(reading.joint_names)}; "
                "give a name for each, in the order of the file"
            )
        if told is None and reading.by_number:
            wanted = [n for n in hand.joint_names if n not in held]
            whole = count == hand.nq
            if not whole and count != len(wanted):
                raise FileFormatError(
                    f"{where} has {count} joints, {hand.name} has {hand.nq}"
                    f"{f' ({len(wanted)} without those above {self.body})' if held else ''}; give "
                    "the hand that the file is for, or --joint-names"
                )
            told = hand.joint_names if whole else wanted
            self.assumed.append(f"joints are in the order of {hand.name}")
        if told is None:
            raise FileFormatError(
                f"{where} has {count} joints and does not name them; if they are in the order of "
                f"{hand.name} ({few_of(hand.joint_names)}), say --by-number, else give their "
                "names with --joint-names"
            )
        self.names = [reading.rename.get(n) or _ours(n, hand) for n in told]
        self.missing = [n for n in held if n not in self.names]
        if self.missing:
            joints = ", ".join(self.missing)
            self.assumed.append(
                f"{joints}, which the file lacks and which do not move {self.body}, are at 0"
            )

    def _held(self) -> list[str]:
        """Joints between the hand's base and the body of the poses."""
        if not self.body:
            return []
        T_base_body(self.hand, self.hand.neutral, self.body)  # refuses what there is not
        model = self.hand.mj_model
        chain, at = [], int(model.body(self.body).id)
        while at:
            first, number = int(model.body_jntadr[at]), int(model.body_jntnum[at])
            chain += [str(model.joint(j).name) for j in range(first, first + number)]
            at = int(model.body_parentid[at])
        return [n for n in self.hand.joint_names if n in chain]

    def of(self, values: FloatArray, where: str = "") -> FloatArray:
        """Joints (nq,) or (m, nq) of ours from those of the file (n,) or (m, n).

        Raises:
            FileFormatError: They are not as many, not numbers, or not finite.
        """
        place = where or self.where
        try:
            array = np.asarray(values, dtype=float)
        except (TypeError, ValueError):
            raise FileFormatError(f"{place} holds joints that are no numbers") from None
        if not np.isfinite(array).all():
            raise FileFormatError(f"{place} holds joints that are not finite; leave it out")
        if array.ndim and array.shape[-1] != len(self.names):
            raise FileFormatError(
                f"{place} has {array.shape[-1]} values for {len(self.names)} joints; it is damaged"
            )
        filled = np.concatenate([array, np.zeros((*array.shape[:-1], len(self.missing)))], axis=-1)
        return joints_by_name(self.hand, [*self.names, *self.missing], filled, where=place)

    def base(self, T_object_body: SE3, q: FloatArray) -> SE3:
        """Pose of the hand's base from that of the body that the file tells."""
        if not self.body:
            return T_object_body
        return T_object_body * T_base_body(self.hand, q, self.body).inverse()


def _ours(name: str, hand: Hand) -> str:
    """The joint of a hand that a file means by a name: the same, or one of the Shadow hand's."""
    if name in hand.joint_names:
        return name
    named = _SHADOW.fullmatch(name)
    if named is None:
        return name
    mine = {_numbered(joint): joint for joint in hand.joint_names}
    return mine.get(_numbered(name), name)


def _numbered(name: str) -> tuple[str, int] | None:
    """A joint of the Shadow hand with its maker's number; None for another."""
    named = _SHADOW.fullmatch(name)
    if named is None:
        return None
    return named[1], int(named[2]) + name.startswith("robot0:")
