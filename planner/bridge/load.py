"""Reading and compiling a model file with MuJoCo, with errors that say what to do.

MJCF and URDF. Meshes are found and converted by ``mesh_files``; links without joints stay bodies of
their own.
"""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np

from planner.bridge.mesh_files import add_visuals, convert_meshes, find_meshes
from planner.bridge.numbers import give_least_inertias
from planner.errors import ModelError, NotFoundError

RIGID_SOLREF = (0.004, 1.0)
RIGID_SOLIMP = (0.99, 0.99, 0.001, 0.5, 2.0)
"""Time constant (s) and damping ratio, and impedance (-), of a coupling that is a gear: two steps
of 2 ms, the stiffest that MuJoCo takes. Under a torque t it yields by t (1 - d) / (d k m), where
m is the inertia of the joint, d the impedance and k = 1 / (d time constant^2) (MuJoCo
documentation, solver parameters): 0.2 N m on 2e-4 kg m^2 by 0.2 mrad, against 20 mrad with MuJoCo's
defaults."""

IMPOSSIBLE_INERTIA = "A + B >= C"
"""MuJoCo's message when it refuses moments of inertia, the largest above the sum of the others.
"""

_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
_JOINT = re.compile(r"<joint\s(?=[^>]*\btype\s*=)[^>]*?\bname\s*=\s*[\"']([^\"']*)[\"']")
_MIMIC = re.compile(
    r"<joint\s[^>]*?\bname\s*=\s*[\"']([^\"']*)[\"'](?:(?!</joint>).)*?"
    r"<mimic\s[^>]*?\bjoint\s*=\s*[\"']([^\"']*)[\"']",
    re.DOTALL,
)
"""The joint that follows, and the one that it follows."""

_MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
_INCLUDE = re.compile(r"<(?:include|model)\s[^>]*file\s*=\s*[\"']([^\"']+)[\"']")


def load_spec(path: Path) -> Any:
    """Read an MJCF or URDF file, with what it only shows, into a fresh ``mujoco.MjSpec``.

    Raises:
        ModelError: The file is missing, MuJoCo cannot read it, it holds no body, a mesh of another
            format cannot be converted, or a URDF has two joints of one name or one that mimics
            itself.
        NotFoundError: A joint of a URDF mimics one that does not exist.
    """
    spec = _read(path)
    convert_meshes(spec)
    if _is_urdf(path.read_text(encoding="utf-8", errors="replace")):
        add_visuals(spec, path)
    return spec


def _read(path: Path) -> Any:
    """``load_spec`` with meshes as the files that the model names."""
    if not path.is_file():
        raise ModelError(f"there is no model file {path}; give the path of an MJCF or URDF file")
    try:
        spec = _parsed(path)
    except (ValueError, FileNotFoundError) as error:
        reason = str(error).strip().replace("\n", "; ")
        raise ModelError(
            f"MuJoCo cannot read {path} as a model: {reason}{_remedy(reason)}"
        ) from error
    if len(spec.bodies) < 2:  # the world is one
        raise ModelError(f"{path} holds no body; {_what_to_load_instead(path)}")
    spec.compiler.fusestatic = False  # a palm without joint must not vanish in the world
    text = path.read_text(encoding="utf-8", errors="replace")
    if _is_urdf(text):
        _check_joints(text, path)
        for mimic in spec.equalities:  # a URDF has no word for how soft a gear is
            mimic.solref, mimic.solimp = RIGID_SOLREF, RIGID_SOLIMP
        give_least_inertias(spec)
    find_meshes(spec, path)
    return spec


def _is_urdf(text: str) -> bool:
    return "<robot" in text


def _parsed(path: Path) -> Any:
    """By MuJoCo, which goes by the suffix and does not know ``.mjcf``."""
    text = path.read_text(encoding="utf-8", errors="replace")
    mended = _mended(text) if _is_urdf(text) else text
    if path.suffix.lower() != ".mjcf" and mended == text:
        return mujoco.MjSpec.from_file(str(path))
    included = [f for f in _included(path) if f.is_file() and f != path]
    spec = mujoco.MjSpec.from_string(
        mended,
        include={f.relative_to(path.parent).as_posix(): f.read_bytes() for f in included},
    )
    spec.modelfiledir = str(path.parent.absolute())
    return spec


def _mended(urdf: str) -> str:
    """A URDF that MuJoCo reads: no balls and rods of radius 0, and an inertia beside every mass.

    The inertia is none, which ``give_least_inertias`` replaces. A file without such faults, or that
    is no XML, stays as it is.
    """
    try:
        root = ElementTree.fromstring(urdf)
    except (ElementTree.ParseError, ValueError):  # ValueError: two encodings
        return urdf
    changed = False
    for link in root.iter("link"):
        for part in [p for kind in ("collision", "visual") for p in link.findall(kind)]:
            if any(_is_zero(e.get("radius")) for e in part.iter()):
                link.remove(part)
                changed = True
        for inertial in link.findall("inertial"):
            if inertial.find("inertia") is None:
                ElementTree.SubElement(inertial, "inertia", dict.fromkeys(_MOMENTS, "0"))
                changed = True
    return ElementTree.tostring(root, encoding="unicode") if changed else urdf


def _is_zero(radius: str | None) -> bool:
    try:
        return radius is not None and float(radius) == 0.0
    except ValueError:
        return False  # MuJoCo says what is wrong with it


def _check_joints(urdf: str, path: Path) -> None:
    """Refuse ambiguous joints of a URDF, about which MuJoCo is silent.

    MuJoCo takes the name from the second of two joints of one name, and drops a ``<mimic>`` of a
    joint that is not there, so that its own joint moves by itself.

    Raises:
        ModelError: Two joints share a name, or one mimics itself.
        NotFoundError: A ``<mimic>`` names a joint that does not exist.
    """
    urdf = _COMMENT.sub("", urdf)
    joints = _JOINT.findall(urdf)
    for name, count in Counter(joints).items():
        if count > 1:
            raise ModelError(
                f"{path} has {count} joints called {name!r} (repeated name); give each its own, "
                "and correct what refers to it"
            )
    for follower, followed in _MIMIC.findall(urdf):
        if follower == followed:
            raise ModelError(
                f"{path}: joint {follower!r} mimics itself; name the joint that it follows, or "
                "take its <mimic> away"
            )
        if followed not in joints:
            raise NotFoundError(
                f"joint of {path} that {follower!r} can mimic",
                followed,
                joints,
                f"Correct the <mimic> of {follower!r} in the file: as it stands, MuJoCo lets that "
                "joint move by itself.",
            )


def compile_spec(spec: Any, what: str) -> Any:
    """Compile a spec into a ``mujoco.MjModel``.

    Args:
        spec: ``mujoco.MjSpec``.
        what: What is being compiled, for the message.

    Raises:
        ModelError: MuJoCo refuses the model.
    """
    try:
        return spec.compile()
    except ValueError as error:
        reason = str(error).replace("\n", "; ")
        raise ModelError(f"MuJoCo cannot compile {what}: {reason}{_remedy(reason)}") from error


def compile_balanced(spec: Any, what: str) -> tuple[Any, bool]:
    """Compile a spec; balance its inertias if MuJoCo refuses it otherwise.

    Returns:
        The ``mujoco.MjModel``, and whether inertias had to be balanced.

    Raises:
        ModelError: MuJoCo refuses the model for another reason.
    """
    try:
        return compile_spec(spec, what), False
    except ModelError as error:
        if IMPOSSIBLE_INERTIA not in str(error):
            raise
        spec.compiler.balanceinertia = True
        return compile_spec(spec, what), True


def model_files(path: Path) -> tuple[Path, ...]:
    """The existing ones of ``named_files``."""
    return tuple(f for f in named_files(path) if f.is_file())


def named_files(path: Path) -> tuple[Path, ...]:
    """A model file, the models that it includes or attaches, meshes and height fields, sorted.

    Raises:
        ModelError: The model cannot be read.
    """
    files = _included(path)
    spec = _read(path)
    folder = path.parent / (spec.meshdir or "")
    files |= {folder / part.file for part in (*spec.meshes, *spec.hfields) if part.file}
    return tuple(sorted(files))


def _included(path: Path) -> set[Path]:
    """A model file and those that it includes or attaches, found or not."""
    files = {path}
    queue = [path]
    while queue:
        text = queue.pop().read_text(encoding="utf-8", errors="replace")
        # MuJoCo looks for an included file beside the one that was opened first.
        new = {path.parent / name for name in _INCLUDE.findall(text)} - files
        queue += [f for f in new if f.is_file()]
        files |= new
    return files


def model_bytes(model: Any) -> bytes:
    """Everything in a compiled model, as MuJoCo writes it into a binary file."""
    buffer = np.zeros(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return buffer.tobytes()


def _what_to_load_instead(path: Path) -> str:
    """Advice for a fragment: the files beside it that include it."""
    users = []
    for other in sorted(path.parent.glob("*.xml")):
        text = other.read_text(encoding="utf-8", errors="replace")
        if any(Path(name).name == path.name for name in _INCLUDE.findall(text)):
            users.append(other.name)
    if users:
        return f"it is meant to be included: load a file that does, {' or '.join(users[:3])}"
    return "give a model with a <worldbody> (MJCF) or links (URDF)"


def _remedy(message: str) -> str:
    """Remedies for the refusals of MuJoCo that foreign models meet."""
    if IMPOSSIBLE_INERTIA in message or "balanceinertia" in message:
        return "; write balance_inertia = true under [repair] in the hand.toml"
    if "coplanar" in message:
        return "; give the mesh a thickness, or name its geom in drop_collision under [repair]"
    if "opening file" in message:
        return "; put the missing file there, or remove what names it from the model"
    if "mujocoinclude" in message:
        return "; it is a fragment: give the file that includes it"
    if "repeated element" in message or "unique element" in message:
        return "; keep one of them"
    if "Schema violation" in message:
        return (
            f"; this is MuJoCo {mujoco.__version__}, and the file may be of another version: take "
            "out or rename what it does not know"
        )
    return ""
