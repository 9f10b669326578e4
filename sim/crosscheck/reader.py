"""Pinocchio's own reader of MJCF and URDF, run in a child process, since it can crash or hang.

The child (``python -m sim.crosscheck.reader``) writes the model that it read, and what each
collision geometry spans, to a file; the parent compares them like any other model.
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

from planner.spatial import FloatArray
from sim.crosscheck.boxes import bounding_box

__all__ = ["ReaderResult", "is_urdf", "read_with_pinocchio"]


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
    """
    with tempfile.TemporaryDirectory() as folder:
        answer = Path(folder) / "answer.pickle"
        command = [sys.executable, "-m", "sim.crosscheck.reader", str(path.resolve()), str(answer)]
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=timeout, check=False
            )
        except subprocess.TimeoutExpired:
            return _failed(f"no answer within {timeout:g} s")
        if done.returncode != 0 or not answer.is_file():
            return _failed(_why(done.returncode, done.stderr))
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


if __name__ == "__main__":
    Path(sys.argv[2]).write_bytes(pickle.dumps(_answer(Path(sys.argv[1]))))
