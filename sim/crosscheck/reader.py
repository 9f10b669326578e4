"""Pinocchio's own reader of MJCF and URDF, run in a child process, since it can crash or hang.

The child writes the model that it read, and what each collision geometry spans, to a file; the
parent compares them like any other model. It imports this package from where the parent has it, and
nothing from the current folder. Before it reads, it says that it has started, so that an
installation in which it cannot start is told from a model that it cannot read.
"""

from __future__ import annotations

import pickle
import re
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pinocchio as pin

from planner.errors import PlannerError
from planner.spatial import FloatArray
from sim.crosscheck.boxes import bounding_box

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
