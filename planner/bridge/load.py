"""Reading and compiling a model file with MuJoCo, with errors that say what to do.

MJCF and URDF; links without joints stay bodies of their own. The mesh files that a model names are
found where models in the wild keep them: a repository is often called otherwise than the ROS
package that it holds, and a model is often moved without its meshes. Nothing outside of the folders
above a model is searched. Meshes are converted, and what a URDF only shows is added, for MuJoCo
leaves it out.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np

from planner.bridge.numbers import MOST_LENGTH, give_least_inertias
from planner.errors import ModelError, NotFoundError
from planner.spatial import FloatArray

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


HIDDEN_GROUP = 3
"""Group of geoms that collide and are not drawn; MuJoCo's viewer hides it too."""

_ROS_SCHEME = re.compile(r"package:/+")  # MuJoCo drops one of a URL's slashes; some write three

LFS_POINTER = b"version https://git-lfs"
"""What a file begins with that a clone without Git LFS has in place of its content."""

MOST_ABOVE = 5
"""Folders above a model in which the path of a mesh is looked for."""


def find_meshes(spec: Any, path: Path) -> None:
    """Let each mesh of a ``mujoco.MjSpec`` name a file that exists, if one is found.

    A path that leads nowhere is tried below the folders above the model, then by its last part in
    the model's mesh folder and beside the model. ``package://NAME/PATH`` is looked for in a folder
    called NAME above the model or beside one, then as PATH below the folders above it, then as the
    rest of PATH below a folder above it whose name PATH has.

    Args:
        spec: As read from ``path``.
        path: The model file.

    Raises:
        ModelError: A ``package://`` path leads nowhere, or a file is a pointer of Git LFS.
    """
    folder = path.parent / (spec.meshdir or "")
    for mesh in spec.meshes:
        if mesh.file:
            mesh.file = _found(mesh.file, folder, path)


def convert_meshes(spec: Any) -> None:
    """Replace meshes that MuJoCo does not read whole by their vertices and triangles.

    Args:
        spec: A ``mujoco.MjSpec`` read from a file; after ``find_meshes``.

    Raises:
        ModelError: A mesh cannot be converted.
    """
    from planner.shapes.meshes.io import converted_mesh, needs_conversion

    folder = Path(spec.modelfiledir or "") / (spec.meshdir or "")
    for mesh in spec.meshes:
        file = folder / mesh.file
        if not (mesh.file and file.is_file() and needs_conversion(file)):
            continue
        vertices, faces = converted_mesh(file)
        mesh.name = mesh.name or file.stem  # what MuJoCo calls a mesh without a name
        mesh.uservert, mesh.userface, mesh.file = vertices.ravel(), faces.ravel(), ""


def add_visuals(spec: Any, path: Path) -> None:
    """Add what a URDF only shows to its bodies: without mass, and touching nothing.

    Where a link shows something, what collides is in ``HIDDEN_GROUP``. A mesh that is not found or
    cannot be read is left out: a picture must not keep a hand from being planned with.

    Args:
        spec: The URDF as MuJoCo has read it, without its visuals.
        path: The file.
    """
    try:
        root = ElementTree.fromstring(path.read_bytes())
    except ElementTree.ParseError:
        return
    colours = {m.get("name"): c.get("rgba") for m in root.iter("material") for c in m.iter("color")}
    for link in root.findall("link"):
        body = spec.body(link.get("name", ""))
        colliding = [] if body is None else list(body.geoms)
        for visual in [] if body is None else link.findall("visual"):
            try:
                _add_visual(spec, body, visual, colours, path)
            except (ModelError, OSError, ValueError):
                continue
            spec.compiler.discardvisual = False
            for geom in colliding:
                geom.group = HIDDEN_GROUP


def _add_visual(
    spec: Any, body: Any, visual: Any, colours: dict[str | None, str | None], path: Path
) -> None:
    """One ``<visual>``.

    Raises:
        ModelError: Its mesh is not found or cannot be read.
        ValueError: It holds what is no number or no geometry.
    """
    shapes = [shape for geometry in visual.iter("geometry") for shape in geometry]
    if not shapes:
        raise ValueError("no geometry")
    (origin,) = visual.findall("origin")[:1] or [ElementTree.Element("origin")]
    turn = np.zeros(4)
    mujoco.mju_euler2Quat(turn, _numbers(origin.get("rpy"), (0.0, 0.0, 0.0)), "XYZ")
    radius, length = (_numbers(shapes[0].get(key), (0.0,))[0] for key in ("radius", "length"))
    kind, size, mesh = mujoco.mjtGeom.mjGEOM_MESH, np.zeros(3), None
    if shapes[0].tag == "box":
        kind, size = mujoco.mjtGeom.mjGEOM_BOX, _numbers(shapes[0].get("size"), size) / 2
    elif shapes[0].tag == "sphere":
        kind, size = mujoco.mjtGeom.mjGEOM_SPHERE, np.array([radius, 0.0, 0.0])
    elif shapes[0].tag == "cylinder":
        kind, size = mujoco.mjtGeom.mjGEOM_CYLINDER, np.array([radius, length / 2, 0.0])
    elif shapes[0].tag == "mesh":
        mesh = _add_visual_mesh(spec, shapes[0], f"{body.name}_visual{len(body.geoms)}", path)
    if mesh is None and not size.any():
        raise ValueError("no size")
    colour: Any = next((c.get("rgba") for c in visual.iter("color")), None)
    for material in visual.iter("material"):
        colour = colour or colours.get(material.get("name"))
    geom = body.add_geom(
        type=kind, size=size, pos=_numbers(origin.get("xyz"), (0.0, 0.0, 0.0)), quat=turn
    )
    geom.contype = geom.conaffinity = 0
    geom.mass = geom.density = 0.0
    geom.meshname = mesh or ""
    geom.rgba = _numbers(colour, geom.rgba)


def _add_visual_mesh(spec: Any, shape: Any, name: str, path: Path) -> str:
    """The mesh of a ``<visual>`` under a name that is free."""
    from planner.shapes.meshes.io import converted_mesh

    file = Path(
        path.parent / (spec.meshdir or ""),
        _found(shape.get("filename", ""), path.parent / (spec.meshdir or ""), path),
    )
    vertices, faces = converted_mesh(file, MOST_TRIANGLES)
    scale = _numbers(shape.get("scale"), (1.0, 1.0, 1.0))
    reach = np.abs(vertices * scale).max()
    if len(vertices) < LEAST_VERTICES or reach > MOST_LENGTH:
        raise ValueError(f"{file} has {len(vertices)} vertices and reaches {reach:g} m")
    while name in {mesh.name for mesh in spec.meshes}:
        name += "_"
    shell = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # never refused; it has no mass
    spec.add_mesh(
        name=name, uservert=vertices.ravel(), userface=faces.ravel(), scale=scale, inertia=shell
    )
    return name


MOST_TRIANGLES = 40_000
"""Triangles of a link that is only shown; fewer leave holes in thin shells (5,000 did). With
270,000 in all a hand compiles in 0.9 s of CPU, without them in 0.3."""

LEAST_VERTICES = 4
"""Vertices below which MuJoCo takes no mesh."""


def _numbers(text: str | None, default: Any) -> FloatArray:
    """Finite numbers of an attribute, as many as the default has.

    Raises:
        ValueError: It holds something else.
    """
    values = np.array(default if text is None else text.split(), dtype=np.float64)
    if len(values) != len(default) or not np.isfinite(values).all():
        raise ValueError(f"{text!r} is not {len(default)} numbers")
    return values


def _found(file: str, folder: Path, model: Path) -> str:
    """The path of a mesh that exists, if one is found; relative to the mesh folder, or absolute.

    Raises:
        ModelError: A ``package://`` path leads nowhere, or the file is a pointer of Git LFS.
    """
    url = _ROS_SCHEME.match(file)
    if url:
        file = str(_ros_file(file[url.end() :], model))
    elif not os.path.isfile(folder / file):
        file = str(_elsewhere(file, folder, model) or file)
    _check_content(folder / file, model)
    return file


def _elsewhere(file: str, folder: Path, model: Path) -> Path | None:
    """A mesh that is not where the model says."""
    inside = Path(file.replace("\\", "/"))
    above = model.resolve().parents[: MOST_ABOVE + 1]
    tries = [] if inside.is_absolute() else [root / inside for root in above]
    tries += [folder / inside.name, model.resolve().parent / inside.name]
    return next((t for t in tries if os.path.isfile(t)), None)


def _ros_file(inside: str, model: Path) -> Path:
    """``PACKAGE/PATH`` of a ROS URL.

    Raises:
        ModelError: It is not there.
    """
    package, _, rest = inside.partition("/")
    rest, above = rest.lstrip("/"), model.resolve().parents
    for folder in above:
        for root in (folder, folder / package):
            if root.name == package and os.path.isfile(root / rest):
                return root / rest
    for folder in above[: MOST_ABOVE + 1]:  # a clone that is called otherwise than the package
        if rest and os.path.isfile(folder / rest):
            return folder / rest
    parts = rest.split("/")
    for folder in above:  # a part of the package, moved alone
        for k, part in enumerate(parts[:-1], start=1):
            if folder.name == part and os.path.isfile(folder.joinpath(*parts[k:])):
                return folder.joinpath(*parts[k:])
    raise ModelError(
        f"{model} names package://{inside}, and none of the folders above it is or holds "
        f"{package!r} with that file; copy the package's folder into {above[0]}, from which the "
        "search goes upwards, or write a relative path"
    )


def _check_content(file: Path, model: Path) -> None:
    """Refuse what a clone without Git LFS leaves of a mesh.

    Raises:
        ModelError: It is such a pointer.
    """
    if not file.is_file():
        return
    with file.open("rb") as stream:
        if stream.read(len(LFS_POINTER)) == LFS_POINTER:
            raise ModelError(
                f"{model} names {file.name}, which is only a pointer of Git LFS, not the mesh; run "
                "git lfs pull in that repository"
            )
