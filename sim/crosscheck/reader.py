"""How models are read: by MuJoCo, and by Pinocchio's own reader of MJCF and URDF.

That reader runs in a child process, since it can crash or hang. The child writes the model that it
read, and what each collision geometry spans, to a file; the parent compares them like any other
model. It imports this package from where the parent has it, and nothing from the current folder.
Before it reads, it says that it has started, so that an installation in which it cannot start is
told from a model that it cannot read.

Geometries are handed over as bounding boxes. A box, exact in given axes, tells a wrong size, scale,
pose or kind of shape without any pairing of coal's types with MuJoCo's: a mesh read as triangles
and its convex hull have the same box.
"""

from __future__ import annotations

import os
import pickle
import re
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import coal
import mujoco
import numpy as np
import pinocchio as pin

from planner.bridge import compile_spec, load_spec
from planner.bridge.load import compile_balanced
from planner.bridge.numbers import impossible_inertias, worst_inertia
from planner.bridge.structure import read_spec
from planner.errors import ModelError, PlannerError
from planner.hand_loading import load_hand
from planner.hands.catalog import find_hand
from planner.spatial import SE3, FloatArray

DESCRIPTION = ".toml"
"""How the name of a file ends that describes a hand and is no model."""

BALANCED = (
    "some inertias are impossible (the largest moment exceeds the sum of the others) and were "
    "balanced by MuJoCo: compared is the balanced model"
)
"""Note on a model that MuJoCo refuses as it is."""


@dataclass(frozen=True, kw_only=True)
class Source:
    """A model, ready to be compared.

    Attributes:
        name: For tables.
        model: ``mujoco.MjModel``.
        spec: ``mujoco.MjSpec`` that it was compiled from; None if a compiled model was given.
        path: The file that Pinocchio's own reader gets; None if there is no file.
        notes: What had to be changed before MuJoCo took the model.
    """

    name: str
    model: Any
    spec: Any
    path: Path | None
    notes: tuple[str, ...] = ()


def compiled(model: Any) -> Source:
    """Compile what was given, and note inertias that no body can have: engines read them alike.

    Args:
        model: Path of an MJCF or URDF file, a hand as for ``load_hand``, ``mujoco.MjSpec`` or
            ``mujoco.MjModel``.

    Raises:
        NotFoundError: There is no such file or hand.
        ModelError: MuJoCo cannot read or compile it, or it is none of these.
    """
    source = _compiled(model)
    impossible = impossible_inertias(source.model)
    if not impossible:
        return source
    note = (
        f"{worst_inertia(impossible)}: correct it in the model, or, for a hand, write "
        "inertia_from_geometry under [repair] in its hand.toml (opposable hands --describe does)"
    )
    return replace(source, notes=(*source.notes, note))


def stated_velocities(source: Source) -> dict[str, float] | None:
    """Joint -> largest speed that a URDF states, rad/s or m/s; None for models of other kinds."""
    if source.path is None:
        return None
    root = ElementTree.parse(source.path).getroot()  # MuJoCo has read it before
    if root.tag != "robot":
        return None
    limits = {j.get("name", ""): j.find("limit") for j in root.findall("joint")}
    out = {}
    for name, limit in limits.items():
        if limit is None:
            continue
        text = limit.get("velocity", "inf")
        try:
            out[name] = float(text)
        except ValueError as error:
            raise ModelError(
                f"{source.path}: the velocity limit of joint {name!r} is {text!r}; give a number"
            ) from error
    return out


def _compiled(model: Any) -> Source:
    if isinstance(model, mujoco.MjModel):
        return Source(name="model", model=model, spec=None, path=None)
    if isinstance(model, mujoco.MjSpec):
        spec = read_spec(model)
        name = spec.modelname or "model"
        return Source(name=name, model=compile_spec(spec, name), spec=spec, path=None)
    if not isinstance(model, str | Path):
        raise ModelError(
            f"a {type(model).__name__} is no model; give the path of an MJCF or URDF file, a "
            "mujoco.MjSpec or a mujoco.MjModel"
        )
    path = Path(model)
    if not os.path.isfile(path) or path.suffix == DESCRIPTION:
        path = find_hand(model)
    if path.suffix == DESCRIPTION:
        hand = load_hand(model)
        note = (
            "checked as the hand is loaded; Pinocchio's own reader is asked only about model "
            "files: give the path of one"
        )
        return Source(name=hand.name, model=hand.mj_model, spec=None, path=None, notes=(note,))
    spec = load_spec(path)
    # impossible inertias are common in URDF files, and not what a cross-check is about
    model, balanced = compile_balanced(spec, str(path))
    notes = (BALANCED,) if balanced else ()
    return Source(name=str(path), model=model, spec=spec, path=path, notes=notes)


STARTED, ANSWER = "started", "answer.pickle"
"""Files that the child leaves in its folder: the first before it reads the model."""

PACKAGES = Path(__file__).resolve().parents[2]
"""Folder of this package, where the child finds it if its own path does not."""

CHILD = """
import sys
sys.path.append(sys.argv[1])
from sim.crosscheck.reader import answer_in_child
answer_in_child(*sys.argv[2:])
"""
"""Program of the child. ``-P`` keeps the current folder out of its path, which ``-m`` and ``-c``
would put first: a ``pinocchio.py`` or a folder ``sim`` there must not be run instead of ours."""


@dataclass(frozen=True, kw_only=True)
class ReaderResult:
    """What became of a file in Pinocchio's own reader.

    Attributes:
        model: ``pinocchio.Model``; None if there is none.
        boxes: Collision geometry -> corners (2, 3) of its bounding box in the frame that carries
            it, m, or None for a plane; in the reader's order; empty if they could not be read.
        carriers: Collision geometry -> name of that frame.
        failure: Why there is no model, in the reader's words; "" if there is one.
        geometry_failure: Why there are no geometries, likewise.
    """

    model: Any
    boxes: Mapping[str, FloatArray | None]
    carriers: Mapping[str, str]
    failure: str
    geometry_failure: str


def read_with_pinocchio(path: Path, timeout: float) -> ReaderResult:
    """Read a model file with Pinocchio's own reader.

    Args:
        path: MJCF or URDF.
        timeout: Seconds after which the child is ended.

    Raises:
        PlannerError: The child could not start, so that nothing is known about the reader.
    """
    with tempfile.TemporaryDirectory() as folder:
        answer, started = Path(folder) / ANSWER, Path(folder) / STARTED
        command = [sys.executable, "-P", "-c", CHILD, str(PACKAGES), str(path.resolve()), folder]
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=timeout, check=False, cwd=folder
            )
            code, errors = done.returncode, done.stderr
            failure = _why(code, errors)
        except subprocess.TimeoutExpired:
            code, failure = -1, f"no answer within {timeout:g} s"
        if not started.is_file():
            raise PlannerError(
                f"the child process of Pinocchio's own reader did not start: {failure}. Mend the "
                "installation or give it more time (--timeout), or leave that reader out "
                "(--no-own-reader)"
            )
        if code != 0 or not answer.is_file():
            return _failed(failure)
        return _result(pickle.loads(answer.read_bytes()))  # written by our own child just now


def _result(stored: Mapping[str, Any]) -> ReaderResult:
    model = pin.Model()
    model.loadFromString(stored["model"])
    return ReaderResult(
        model=model,
        boxes=stored["boxes"],
        carriers=stored["carriers"],
        failure="",
        geometry_failure=stored["geometry_failure"],
    )


def _failed(reason: str) -> ReaderResult:
    return ReaderResult(model=None, boxes={}, carriers={}, failure=reason, geometry_failure="")


def _why(code: int, errors: str) -> str:
    if code < 0:
        return f"crashed with signal {-code}"
    lines = [line for line in errors.splitlines() if line.strip()]
    start = next((i for i, line in enumerate(lines) if _RAISED.match(line)), len(lines) - 1)
    return " ".join(lines[start:]) or f"ended with code {code}"


_RAISED = re.compile(r"\w+(Error|Exception|_at)?: ")
"""First line of what Python prints of an exception behind its traceback."""


def _answer(path: Path) -> dict[str, Any]:
    """In the child: the model and the boxes of its geometries."""
    urdf = is_urdf(path)
    model = pin.buildModelFromUrdf(str(path)) if urdf else pin.buildModelFromMJCF(str(path))
    boxes, carriers, failure = {}, {}, ""
    try:
        if urdf:
            folders = [str(folder) for folder in path.parents]
            found = pin.buildGeomFromUrdf(
                model, str(path), pin.GeometryType.COLLISION, package_dirs=folders
            )
        else:
            found = pin.buildGeomFromMJCF(model, str(path), pin.GeometryType.COLLISION)
    except (RuntimeError, ValueError, IndexError) as error:
        failure = str(error)
    else:
        for item in found.geometryObjects:
            frame = model.frames[item.parentFrame]
            local = frame.placement.actInv(item.placement)
            boxes[item.name] = bounding_box(item.geometry, local)
            carriers[item.name] = frame.name
    return {
        "model": model.saveToString(),
        "boxes": boxes,
        "carriers": carriers,
        "geometry_failure": failure,
    }


def is_urdf(path: Path) -> bool:
    """Whether a model file is URDF rather than MJCF."""
    return path.suffix.lower() == ".urdf" or "<robot" in path.read_text(
        encoding="utf-8", errors="replace"
    )


def answer_in_child(path: str, folder: str) -> None:
    """What the child does: say in its folder that it has started, read, and leave the answer."""
    (Path(folder) / STARTED).touch()
    (Path(folder) / ANSWER).write_bytes(pickle.dumps(_answer(Path(path))))


def bounding_box(geometry: Any, pose: SE3) -> FloatArray | None:
    """Lowest and highest corner (2, 3), m, of a geometry in the frame where its pose is given.

    Args:
        geometry: coal geometry.
        pose: Its pose.

    Returns:
        The corners; None for what has no end (planes) and for kinds that no model file has.
    """
    points = vertices(geometry)
    if points is not None:
        placed = points @ pose.rotation.T + pose.translation
        return np.stack([placed.min(axis=0), placed.max(axis=0)])
    half = _half_extents(geometry, pose.rotation)
    return None if half is None else np.stack([pose.translation - half, pose.translation + half])


def vertices(geometry: Any) -> FloatArray | None:
    """Vertices (n, 3), m, of a coal geometry; None for one that has none."""
    if isinstance(geometry, coal.Convex):
        return np.array([geometry.point(i) for i in range(geometry.num_points)])
    if isinstance(geometry, coal.BVHModelBase):
        return np.array([geometry.vertex(i) for i in range(geometry.num_vertices)])
    return None


def _half_extents(geometry: Any, rotation: FloatArray) -> FloatArray | None:
    """Half of the box's edges (3,): the support of the shape along each axis."""
    axis = np.abs(rotation[:, 2])  # of a capsule or cylinder
    if isinstance(geometry, coal.Sphere):
        return np.full(3, geometry.radius)
    if isinstance(geometry, coal.Capsule):
        return np.asarray(axis * geometry.halfLength + geometry.radius)
    if isinstance(geometry, coal.Cylinder):
        across = np.sqrt(np.maximum(1 - axis**2, 0.0))
        return np.asarray(axis * geometry.halfLength + across * geometry.radius)
    if isinstance(geometry, coal.Box):
        return np.asarray(np.abs(rotation) @ geometry.halfSide)
    if isinstance(geometry, coal.Ellipsoid):
        return np.asarray(np.sqrt(rotation**2 @ geometry.radii**2))
    return None
