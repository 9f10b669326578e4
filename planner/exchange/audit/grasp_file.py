"""A file of another tool: opened, its hand and objects settled, its reading doubted.

``GraspFile``: a file of another tool, with the hand and the objects that its grasps are for.

``audit`` and ``refine`` open files through it: what a file says of its hand and object is used
where nothing is told, and compared with what is told.

Whether a file was read as it was meant: unit, order of quaternions, frame, hand.

Poses in millimetres, quaternions in the other order, inverted poses and the other hand give numbers
that look as good as any. They show where the hand is: under the wrong reading the pads of no grasp
are near the object, under the right one those of most are. Nothing is decided here: the error says
what to give. ``audit`` and ``refine`` read files through it.

Plans and batches of ours as grasps to be judged, through the same door as those of others.

An object in another size: the factor on a mesh that files of grasps give.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from planner.batch.dataset import GraspSet
from planner.batch.recipe import with_fingers_of
from planner.errors import FileFormatError, NotFoundError, PlannerError, TaskError, few_of, shown
from planner.exchange.audit.judge import Judge
from planner.exchange.formats import (
    GraspFormat,
    ImportedGrasp,
    ImportedGrasps,
    Reading,
    format_of,
    readable_format,
)
from planner.exchange.joints import T_file_object
from planner.hand_loading import load_hand
from planner.hands.catalog import hand_names
from planner.hands.hand import Hand
from planner.objects import object_names, parse_object
from planner.plan import GraspPlan
from planner.shapes import SIZED_SHAPES, shape_key
from planner.shapes.meshes.io import MESH_SUFFIXES
from planner.spatial import pose_from_wxyz
from planner.task import GraspTask

SAME_SIZE = 0.01
"""Relative difference (-) of extents and volume from which on two meshes are two objects."""

SIMPLIFIED = Path("mesh", "simplified.obj")
"""The mesh in the folder of an object of DexGraspNet's kind."""


@dataclass(frozen=True, kw_only=True)
class GraspFile:
    """A file or folder of grasps, and which of them are meant.

    Attributes:
        path: The file or folder.
        format: Its format.
        reading: What it does not say.
        only: Text in the name of the object; all grasps if empty.
        object: Name of the object, as the file has it; of all objects if None.
    """

    path: Path
    format: GraspFormat
    reading: Reading = field(default_factory=Reading)
    only: str = ""
    object: str | None = None

    @classmethod
    def open(
        cls,
        path: Path,
        *,
        format: str | None = None,
        reading: Reading | None = None,
        only: str = "",
    ) -> GraspFile:
        """Find out the format; no grasp is read yet.

        Args:
            path: The file or folder.
            format: Name of the format; that which the file looks like if None.
            reading: What the file does not say.
            only: Only grasps whose object's name holds this text.

        Raises:
            FileFormatError: It looks like no format, or like several.
            NotFoundError: No such file or format.
            TaskError: The format has no reader.
        """
        chosen = format_of(path) if format is None else readable_format(format)
        if not path.exists():
            raise NotFoundError("file", str(path), (), "give the path of a file", is_path=True)
        return cls(path=path, format=chosen, reading=reading or Reading(), only=only)

    def hand(self, told: str | None) -> Hand:
        """The hand that is told, as ``load_hand`` takes it; else that of the file.

        Raises:
            TaskError: Nothing is told, and the file names none that is known here.
            PlannerError: What is told cannot be loaded.
        """
        if told is not None:
            return load_hand(told)
        name = "" if self.format.hand_of is None else self.format.hand_of(self.path)
        if not name:
            raise TaskError(f"{self.path} does not say which hand it is for; give --hand")
        try:
            return load_hand(name, download=False)
        except NotFoundError as error:
            raise TaskError(
                f"{self.path} is for the hand {name!r}, which is not known here; give its name or "
                "file with --hand"
            ) from error

    def grasps(self, hand: Hand, reading: Reading | None = None) -> ImportedGrasps:
        """The grasps that are meant.

        Args:
            hand: The hand.
            reading: In place of that of the file, for another look at it.

        Raises:
            FileFormatError: Damaged, or with other joints.
            TaskError: No object has such a name.
        """
        assert self.format.read is not None  # seen to when it was opened
        given = self.format.read(self.path, hand, reading or self.reading)
        if self.only:
            kept = tuple(g for g in given.grasps if self.only in g.object)
            if not kept:
                names = few_of(sorted({g.object for g in given.grasps}))
                raise TaskError(
                    f"no object of {self.path} has {self.only!r} in its name; there is: {names}"
                )
            given = replace(given, grasps=kept)
        if self.object is None:
            return given
        return replace(given, grasps=tuple(g for g in given.grasps if g.object == self.object))

    def objects(self, given: ImportedGrasps, told: str | None) -> dict[str, str]:
        """Name of each object in the file -> what ``parse_object`` takes for it.

        Args:
            given: The grasps that are meant.
            told: The object that is told; those that the file names if None.

        Raises:
            FileFormatError: One object is told for grasps of several.
            TaskError: What is told contradicts the file; or nothing is told, and the file does not
                bring its object.
        """
        names = sorted({g.object for g in given.grasps})
        if told is None:
            return {name: self._brought(name) for name in names}
        need_one_object(self.path, names)
        name = names[0] if names else ""
        if self.format.object_specs and _contradicts(self._found(name), told):
            raise TaskError(
                f"{self.path} is of the object {name!r}, and {shown(told)} is given; leave "
                "--object out to take that of the file, or correct the file"
            )
        return {name: told}

    def _brought(self, name: str) -> str:
        """The object of a name in the file; TaskError where the file does not bring it."""
        found = self._found(name)
        if found and self.format.object_specs:
            return found
        if found:
            raise TaskError(
                f"{self.path} does not bring its object; it names {name}, which is there: give "
                f"--object {found}"
            )
        if self.format.object_specs and name:
            raise TaskError(
                f"{self.path} is of the object {name!r}, which is neither a shape nor a mesh file "
                "beside it or here; give --object"
            )
        named = f" (it calls it {name!r})" if name else ""
        raise TaskError(f"{self.path} does not bring its object{named}; give --object")

    def _found(self, name: str) -> str:
        """What ``parse_object`` takes for a name in the file; "" where there is nothing of it."""
        file, star, scale = name.partition("*")
        folder = self.path if self.path.is_dir() else self.path.parent
        for path in (
            folder / file,
            Path(file),
            folder / file / SIMPLIFIED,
            Path(file) / SIMPLIFIED,
        ):
            if path.suffix.lower() in MESH_SUFFIXES and path.is_file():
                return f"{path}{star}{scale}"
        of_shapes = self.format.object_specs and _kind(name) in object_names()
        return name if of_shapes else ""


def need_one_object(path: Path, names: list[str]) -> None:
    """Refuse grasps of several objects.

    Raises:
        FileFormatError: So.
    """
    if len(names) > 1:
        raise FileFormatError(
            f"{path} has grasps of {len(names)} objects: {few_of(names)}; one object is given at a "
            "time: say which grasps with --only, a part of its name"
        )


def _kind(spec: str) -> str:
    return spec.partition(":")[0].strip().lower()


def _contradicts(own: str, told: str) -> bool:
    """Whether two specifications are of two objects; a word without sizes is a name only."""
    if not own:
        return False
    if own in object_names():
        return _kind(told) in object_names() and _kind(told) != own
    mine, other = parse_object(own).shape, parse_object(told).shape
    if type(mine) is type(other) and mine.kind in SIZED_SHAPES:
        return shape_key(mine) != shape_key(other)
    # a mesh that was written anew has other triangles, and one may stand for a primitive
    return not (
        np.allclose(mine.half_extents, other.half_extents, rtol=SAME_SIZE)
        and np.isclose(mine.volume, other.volume, rtol=SAME_SIZE)
    )


SIGNS = ((0.001, 3), (0.01, 2))
"""Distance (m) of pads from the surface, either side, and how many of them must be so near: nearly
touching, which the other hand's pads do not; and near at all."""

LOOKED_AT = 40
"""Grasps of a file that are looked at."""

FEW = 0.1
"""Share of grasps (-) that may be near under a wrong reading: some are by chance."""

ENOUGH = 0.5
"""Share of grasps (-) that another reading must bring near to be named."""


def right_task(
    file: GraspFile,
    task_for: Callable[[Hand], GraspTask],
    hand: Hand,
    *,
    fixed_fingers: bool = False,
    within: float | None = None,
) -> tuple[GraspTask, ImportedGrasps]:
    """Task and grasps of one object of a file, seen to be read as they were written.

    Args:
        file: The file, restricted to an object where it has several.
        task_for: Makes the task for a hand.
        hand: The hand.
        fixed_fingers: Whether the fingers of the task hold and no others.
        within: Distance (m) of two pads from the object up to which a pose is as it was meant,
            where poses need be no grasps; by ``SIGNS`` if None.

    Raises:
        FileFormatError: Damaged; or the hand is nowhere near the object, and would be in another
            reading: it says what to give.
        TaskError: It holds no grasp.
    """
    given = file.grasps(hand)
    if not len(given):
        raise TaskError(f"{file.path} holds no grasp; give a file with grasps")
    task = task_for(hand)
    judge = Judge(task, fixed_fingers=fixed_fingers)
    if within is None or _share_near(judge, given, within, 2) <= FEW:
        _need_right_reading(file, judge, given, task_for)
    return task, given


def _need_right_reading(
    file: GraspFile, judge: Judge, given: ImportedGrasps, task_for: Callable[[Hand], GraspTask]
) -> None:
    """Refuse a file whose hand is nowhere near the object, and would be in another reading."""
    near = [_share_near(judge, given, *sign) for sign in SIGNS]
    if min(near) > FEW:
        _need_one_hand(file, judge, given, task_for)
        return
    for said, hand, other in _others(judge.task.hand, file.reading):
        try:
            again = _inverted(given) if other is None else file.grasps(hand, other)
            mine = judge if hand is judge.task.hand else Judge(task_for(hand), **judge.how)
            shares = [_share_near(mine, again, *sign) for sign in SIGNS]
        except PlannerError:  # this reading cannot be, and another one may
            continue
        for (within, count), before, share in zip(SIGNS, near, shares, strict=True):
            if before <= FEW and share >= ENOUGH:
                raise FileFormatError(
                    f"{file.path}: of the grasps looked at, {min(len(given), LOOKED_AT)} of "
                    f"{len(given)}, {100 * before:.0f} % have {count} pads within "
                    f"{1e3 * within:.0f} mm of the object's surface; {said[0]}, "
                    f"{100 * share:.0f} % do: {said[1]}"
                )


def _share_near(judge: Judge, given: ImportedGrasps, within: float, count: int) -> float:
    """Share of the grasps (-) with so many pads so near (m) to the object."""
    step = max(1, len(given) // LOOKED_AT)
    near = [judge.near_pads(g, within) >= count for g in given.grasps[::step][:LOOKED_AT]]
    return float(np.mean(near)) if near else 1.0


def _need_one_hand(
    file: GraspFile, judge: Judge, given: ImportedGrasps, task_for: Callable[[Hand], GraspTask]
) -> None:
    """Refuse a file some of whose grasps are those of the hand on the other side."""
    (within, count), mirrored = SIGNS[0], _mirrored(judge.task.hand)
    looked_at = given.grasps[:: max(1, len(given) // LOOKED_AT)][:LOOKED_AT]
    far = [k for k, grasp in enumerate(looked_at) if judge.near_pads(grasp, within) < count]
    if mirrored is None or len(far) <= FEW * len(looked_at):
        return
    try:
        hand = load_hand(mirrored)
        other, again = Judge(task_for(hand), **judge.how), file.grasps(hand).grasps
    except PlannerError:  # that hand cannot be meant
        return
    seen = again[:: max(1, len(again) // LOOKED_AT)]
    theirs = [seen[k].name for k in far if other.near_pads(seen[k], within) >= count]
    if len(theirs) >= ENOUGH * len(far):
        raise FileFormatError(
            f"{file.path} mixes hands: of the grasps looked at, {len(looked_at)} of {len(given)}, "
            f"{len(theirs)} touch the object with {mirrored} and not with "
            f"{judge.task.hand.name}, {theirs[0]} the first of them; give a file per hand"
        )


def _inverted(given: ImportedGrasps) -> ImportedGrasps:
    """The grasps with the poses that they have if what stands in the file is the object's."""
    grasps = [replace(g, T_object_base=g.T_object_base.inverse()) for g in given.grasps]
    return replace(given, grasps=tuple(grasps))


def _mirrored(hand: Hand) -> str | None:
    """Name of the hand on the other side; None where there is none."""
    name = hand.name.removesuffix("_left")
    mirrored = name if name != hand.name else f"{hand.name}_left"
    return mirrored if mirrored in hand_names() else None


def _others(hand: Hand, reading: Reading) -> Iterator[tuple[tuple[str, str], Hand, Reading | None]]:
    """Other readings, each with what it assumes and what to do then; None for inverted poses."""
    unit = reading.unit or 1.0
    if unit == 1.0:
        said = "with lengths in millimetres", "give --unit mm"
        yield said, hand, replace(reading, unit=1e-3)
    else:
        yield ("with lengths in metres", "give --unit m"), hand, replace(reading, unit=1.0)
    order = "wxyz" if reading.quaternion == "xyzw" else "xyzw"
    said = f"with quaternions in the order {order}", f"give --quaternion {order}"
    yield said, hand, replace(reading, quaternion=order)
    said = "with the inverse of each pose", "give poses of the hand's base in the object's frame"
    yield said, hand, None
    if mirrored := _mirrored(hand):
        said = f"for {mirrored}", f"give --hand {mirrored}"
        yield said, load_hand(mirrored), reading


def plans_as_imported(
    plans: Sequence[GraspPlan], source: Path, names: Sequence[str] | None = None
) -> Iterator[tuple[GraspTask, ImportedGrasps]]:
    """Each plan with its task, as a grasp of which nothing is verified.

    Args:
        plans: The plans.
        source: Where they are from.
        names: What to call them; their seeds if None.
    """
    for plan, name in zip(plans, names or [f"seed {p.record.seed}" for p in plans], strict=True):
        to_file, upright = T_file_object(plan.task), plan.task.T_world_object
        grasp = ImportedGrasp(
            name=name,
            T_object_base=to_file * upright.inverse() * plan.T_world_base,
            q=plan.q,
            q_pregrasp=plan.q_pregrasp,
            object=plan.task.object.shape.spec,
            T_world_object=upright * to_file.inverse(),
        )
        yield (
            plan.task,
            ImportedGrasps(source=source, format="plan", hand=plan.task.hand.name, grasps=(grasp,)),
        )


def batch_as_imported(grasps: GraspSet, source: Path) -> Iterator[tuple[GraspTask, ImportedGrasps]]:
    """The found grasps of a batch, one set per object and fingers, with their task."""
    for label in grasps.labels:
        sets: dict[tuple[str, ...], tuple[GraspTask, list[ImportedGrasp]]] = {}
        for index, row in grasps.found(label):
            task = with_fingers_of(grasps.task(label), row)
            to_file = T_file_object(task)
            base = pose_from_wxyz(
                np.array(row["base_position_object_m"]),
                np.array(row["base_quaternion_object_wxyz"]),
            )
            grasp = ImportedGrasp(
                name=f"row {index}",
                T_object_base=to_file * base,
                q=np.array(row["q_rad"]),
                q_pregrasp=np.array(row["q_pregrasp_rad"]),
                object=label,
                T_world_object=task.T_world_object * to_file.inverse(),
            )
            sets.setdefault(task.finger_names, (task, []))[1].append(grasp)
        for task, some in sets.values():
            yield (
                task,
                ImportedGrasps(
                    source=source, format="batch", hand=task.hand.name, grasps=tuple(some)
                ),
            )
