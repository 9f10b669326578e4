"""``GraspFile``: a file of another tool, with the hand and the objects that its grasps are for.

``audit`` and ``refine`` open files through it: what a file says of its hand and object is used
where nothing is told, and compared with what is told.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from planner.errors import FileFormatError, NotFoundError, TaskError, few_of, shown
from planner.exchange.formats import GraspFormat, Reading, format_of, readable_format
from planner.exchange.given import GivenGrasps
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.objects import object_names, parse_object
from planner.shapes import SIZED_SHAPES, shape_key
from planner.shapes.meshes.io import MESH_SUFFIXES

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

    def grasps(self, hand: Hand, reading: Reading | None = None) -> GivenGrasps:
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

    def objects(self, given: GivenGrasps, told: str | None) -> dict[str, str]:
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
