"""An object as DexGraspBench reads it: convex pieces, and the file its density comes from.

Pieces and pose are in the frame of the object's own file, in metres: ours has its origin at the
centre of mass. ``simplified.json`` says under ``gravity_center`` where that is, as the benchmark's
own files do. What is not from a file keeps our frame.

MJCF text for the MuJoCo that DexGraspBench pins, 3.3.2, out of what a newer MuJoCo writes.

MuJoCo refuses a whole file for one attribute that it does not know, so what is written is checked
against a list of what 3.3.2 knows (from its own ``mj_printSchema``), for the elements of a hand.
Elements of the world rather than the hand (options, visuals, sensors, key frames) are left out: the
benchmark sets its own.

A hand as DexGraspBench reads it: model, meshes, and its entry of ``config/hand``.

The base stands where the hand's own model file puts it, so that a grasp's qpos, which places the
world of that file, is right for the exported model and for the original one alike.
"""

from __future__ import annotations

import json
import os.path
import re
import shutil
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path, PurePath
from types import MappingProxyType

import numpy as np

from planner.bridge import compile_spec, load_spec
from planner.errors import FileFormatError, ModelError, shown
from planner.files import plain_name, write_json
from planner.hands.description_toml import read_description
from planner.hands.hand import Hand
from planner.shapes import Shape
from planner.shapes.hulls import hull_of
from planner.shapes.mesh import Mesh, surface_triangles
from planner.shapes.pieces import convex_pieces, deviation
from planner.spatial import SE3, FloatArray, IntArray, pose_from_wxyz, pose_to_wxyz
from planner.task import GraspTask

NO_BETTER = 0.9
"""Pieces that reach out of the solid by more than this share of what the hull does (-) gain
nothing, and the hull is written: for example of a can with a thin rim at both ends."""


def frame_shift(shape: Shape) -> FloatArray:
    """The centre of mass (3,), m, in the frame of the object's file."""
    if isinstance(shape, Mesh) and shape.source is not None:
        return np.array(shape.offset)
    return np.zeros(3)


@lru_cache(maxsize=32)
def benchmark_pieces(shape: Shape) -> tuple[tuple[FloatArray, IntArray], ...]:
    """Vertices (n, 3), m, about the centre of mass, and faces (m, 3) of convex pieces of a shape.

    One for a convex shape, and for a mesh that cutting makes no truer than its hull is.
    """
    if not isinstance(shape, Mesh):
        return (surface_triangles(shape),)
    pieces = convex_pieces(shape)
    if len(pieces) > 1:
        hull = hull_of(shape.hull_vertices)
        if hull is not None and pieces.deviation > NO_BETTER * deviation(shape, [hull]):
            return ((hull.points, hull.faces),)
    return tuple(zip(pieces.vertices, pieces.faces, strict=True))


def write_object(task: GraspTask, folder: Path) -> None:
    """Write the object of a task: ``urdf/meshes/convex_piece_*.obj`` and ``info/simplified.json``.

    Args:
        task: The task.
        folder: The object's folder; made if it does not exist.
    """
    shape = task.object.shape
    shift = frame_shift(shape)
    (folder / "urdf" / "meshes").mkdir(parents=True, exist_ok=True)
    (folder / "info").mkdir(exist_ok=True)
    for old in (folder / "urdf" / "meshes").glob("convex_piece_*.obj"):
        old.unlink()  # of an export before
    for i, (vertices, faces) in enumerate(benchmark_pieces(shape)):
        lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices + shift]
        lines += [f"f {a} {b} {c}" for a, b, c in faces + 1]
        path = folder / "urdf" / "meshes" / f"convex_piece_{i:03d}.obj"
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    info = {
        "gravity_center": shift.tolist(),
        "obb": (2.0 * shape.half_extents).tolist(),
        "scale": 1.0,
        "density": task.object.mass / shape.volume,
        "mass": task.object.mass,
    }
    write_json(info, folder / "info" / "simplified.json")


PINNED = "3.3.2"
"""MuJoCo's version in the benchmark's README at commit 1e7a5a6."""

_PLACE = "axisangle euler pos quat xyaxes zaxis"
_LIMIT = (
    "class damping frictionloss group limited margin name range solimpfriction solimplimit "
    "solreffriction solreflimit stiffness user"
)
_FORCE_LIMIT = "actuatorfrclimited actuatorfrcrange armature"
_EQUALITY = "active class name solimp solref"

_KNOWN: Mapping[str, str] = MappingProxyType(
    {
        "mujoco": "model",
        "compiler": (
            "alignfree angle assetdir autolimits balanceinertia boundinertia boundmass coordinate "
            "discardvisual eulerseq fitaabb fusestatic inertiafromgeom inertiagrouprange meshdir "
            "saveinertial settotalmass strippath texturedir usethread"
        ),
        "default": "class",
        "asset": "",
        "mesh": (
            "class content_type face file inertia maxhullvert name normal refpos refquat scale "
            "smoothnormal texcoord vertex"
        ),
        "material": (
            "class emission metallic name reflectance rgba roughness shininess specular texrepeat "
            "texuniform"
        ),
        "worldbody": "",
        "body": f"childclass gravcomp mocap name user {_PLACE}",
        "inertial": f"diaginertia fullinertia mass {_PLACE}",
        "joint": (
            f"{_FORCE_LIMIT} {_LIMIT} actuatorgravcomp axis pos ref springdamper springref type "
            "active joint1 joint2 polycoef solimp solref coef joint"
        ),
        "geom": (
            "class conaffinity condim contype density fitscale fluidcoef fluidshape friction "
            "fromto gap group margin mass material mesh name priority rgba shellinertia size "
            f"solimp solmix solref type user geom sidesite {_PLACE}"
        ),
        "site": f"class fromto group material name rgba size type user site {_PLACE}",
        "contact": "",
        "pair": ("class condim friction gap geom1 geom2 margin name solimp solref solreffriction"),
        "exclude": "body1 body2 name",
        "equality": "active solimp solref",
        "connect": f"anchor body1 body2 site1 site2 {_EQUALITY}",
        "weld": f"anchor body1 body2 relpose site1 site2 torquescale {_EQUALITY}",
        "tendon": f"{_LIMIT} material rgba springlength width polycoef tendon1 tendon2 {_EQUALITY}",
        "spatial": f"{_FORCE_LIMIT} {_LIMIT} material rgba springlength width",
        "fixed": f"{_FORCE_LIMIT} {_LIMIT} springlength",
        "pulley": "divisor",
        "actuator": "",
        "general": (
            "actdim actearly actlimited actrange biasprm biastype body class cranklength cranksite "
            "ctrllimited ctrlrange dynprm dyntype forcelimited forcerange gainprm gaintype gear "
            "group joint jointinparent lengthrange name refsite site slidersite tendon user"
        ),
    }
)
"""Element -> attributes that 3.3.2 knows. Elements of one name in several places share a line."""

_WORLD = frozenset(
    {
        "camera",
        "custom",
        "keyframe",
        "layer",
        "light",
        "option",
        "sensor",
        "size",
        "skin",
        "statistic",
        "texture",
        "visual",
    }
)
"""Elements that say nothing of the hand's motion or contacts, left out."""

_HARMLESS: Mapping[str, frozenset[str]] = MappingProxyType(
    {
        # in 4.0 a note on what ctrl means; the force follows from gain and bias alone
        "general": frozenset({"input"}),
        "geom": frozenset({"castshadow"}),
        "material": frozenset({"texture"}),
    }
)
"""Attributes that change neither motion nor contact, left out; others are refused."""

_ONE_NUMBER = ("damping", "stiffness")
"""Attributes that hold a polynomial in MuJoCo 4 and one number in 3.3.2."""


def pinned_mjcf(text: str, hand: str, files: Mapping[str, Path] | None = None) -> str:
    """MJCF that MuJoCo 3.3.2 reads.

    Args:
        text: MJCF as a newer MuJoCo writes it.
        hand: What the hand is called, for messages.
        files: Name of a mesh file in the text -> the file that the result names instead, relative
            to the folder "assets" beside it; no mesh files if None.

    Raises:
        ModelError: The model needs what 3.3.2 does not have.
    """
    root = ET.fromstring(text)
    _drop_world(root)
    for element in root.iter():
        _check(element, hand)
        if element.tag == "compiler":
            for name in ("meshdir", "texturedir", "assetdir"):
                element.attrib.pop(name, None)
            if files:
                element.set("meshdir", "assets")
        if element.tag == "mesh" and "file" in element.attrib:
            element.set("file", str((files or {})[element.attrib["file"]]))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _drop_world(element: ET.Element) -> None:
    """Leave out elements of the world, at any depth."""
    for child in list(element):
        if child.tag in _WORLD:
            element.remove(child)
        else:
            _drop_world(child)


def _check(element: ET.Element, hand: str) -> None:
    """Drop harmless attributes of an element and refuse what 3.3.2 does not know."""
    if element.tag not in _KNOWN:
        raise ModelError(
            f"the model of {hand} has an element <{element.tag}>; DexGraspBench pins MuJoCo "
            f"{PINNED}, for which the export writes no such element: take it out of the model"
        )
    known = _KNOWN[element.tag].split()
    for name in list(element.attrib):
        if name in _HARMLESS.get(element.tag, frozenset()):
            del element.attrib[name]
        elif name not in known:
            raise ModelError(
                f"<{element.tag}> of {hand} has {name}={shown(element.attrib[name])}, which MuJoCo "
                f"{PINNED} does not know, and DexGraspBench pins it: take it out of the model"
            )
    for name in _ONE_NUMBER:
        if len(element.attrib.get(name, "0").split()) > 1:
            raise ModelError(
                f"<{element.tag}> of {hand} has {name}={shown(element.attrib[name])}; MuJoCo "
                f"{PINNED}, which DexGraspBench pins, takes one number: give a linear law"
            )


NO_MODEL_NAME = ("", "MuJoCo Model")
"""Names of a model whose author gave none."""

TAKEN = (
    *("allegro", "leap", "shadow", "ur10e_shadow"),
    *("null", "true", "false", "nan", "inf"),
)
"""Names that a hand in an export cannot have. The first are in the benchmark's own ``config/hand``,
which its Hydra searches before the folder of an export: it would evaluate its own hand instead, and
say nothing. The others Hydra reads as values."""

MESHES = "assets"
"""Folder of the meshes beside the model."""


def file_name(label: str) -> str:
    """A label as the name of a file or folder, which never leaves its folder."""
    return plain_name(label.replace("+", "-"))


def export_name(hand: Hand) -> str:
    """Name of a hand in an export.

    The name in its description; for a model without one, the model's own name, or folder and file
    where it has none: "right_hand.xml" is the file name of most hands. Letters, digits, ``_`` and
    ``-`` stay, everything else becomes a dash. What the benchmark would take for something else
    begins with "hand-": its own hands, numbers, and words of YAML.
    """
    if hand.path is None or hand.path.suffix == ".toml":
        return _hand_name(hand.name)
    named = str(hand.spec.modelname)
    path = hand.path.resolve()
    return _hand_name(f"{path.parent.name}-{path.stem}" if named in NO_MODEL_NAME else named)


def _hand_name(text: str) -> str:
    name = file_name(re.sub(r"[^A-Za-z0-9_\-]", "-", text))
    return f"hand-{name}" if name.lower() in TAKEN or not name[0].isalpha() else name


@lru_cache(maxsize=8)
def T_model_base(hand: Hand) -> SE3:
    """Pose of the hand's base in the world of its model file.

    The identity for a hand without a file, a mirrored one, and one whose base is below another
    body of its file: then only the exported model has the joints of the grasp.
    """
    here = SE3(np.eye(3), np.zeros(3))
    if hand.path is None:
        return here
    path = hand.path
    if path.suffix == ".toml":
        described = read_description(path)
        if described.mirror_axis is not None:
            return here
        path = described.model_path
    spec = load_spec(path)
    if hand.description.repair.angle is not None:
        spec.compiler.degree = hand.description.repair.angle == "degree"
    spec.compiler.balanceinertia = True  # only the pose is asked for
    body = compile_spec(spec, str(path)).body(hand.description.base_body)
    if int(body.parentid[0]) != 0:
        return here
    return pose_from_wxyz(np.array(body.pos), np.array(body.quat))


def write_hand(hand: Hand, folder: Path, *, moved_to: Path | None = None) -> str:
    """Write ``NAME.yaml``, ``NAME/NAME.xml`` and ``NAME/assets/`` for a hand.

    The first is JSON, which YAML includes.

    Args:
        hand: The hand.
        folder: Where; made if it does not exist.
        moved_to: What the folder will be called when it is read, if otherwise: paths are absolute.

    Returns:
        NAME, the benchmark's name of the hand.

    Raises:
        FileFormatError: Another hand of that name is there.
        ModelError: The benchmark's MuJoCo cannot read such a model.
    """
    name = export_name(hand)
    config = folder / f"{name}.yaml"
    if config.exists() and _digest_in(config) != hand.digest:
        raise FileFormatError(
            f"{config} describes another hand of that name; export to another folder, or remove it"
        )
    home = folder / name
    home.mkdir(parents=True, exist_ok=True)
    spec = hand.new_spec()
    base = spec.body(hand.description.base_body)
    base.pos, base.quat = pose_to_wxyz(T_model_base(hand))
    files = _copy_meshes(spec, home / MESHES)
    model = home / f"{name}.xml"
    model.write_text(pinned_mjcf(spec.to_xml(), hand.name, files), encoding="utf-8")
    fingers = hand.fingers.values()
    tips = [_body_of(hand, finger.pad.geom) for finger in fingers]
    bodies = [hand.description.palm_body, *(b for finger in fingers for b in sorted(finger.bodies))]
    data = {
        "xml_path": str((moved_to or folder) / name / model.name),
        "mocap": True,
        "exclude_table_contact": None,
        "color": [0.2, 0.55, 0.85, 1.0],
        "finger_prefix": [
            os.path.commonprefix(sorted(finger.bodies)) or tip  # noqa: RUF071 - names, not paths
            for finger, tip in zip(fingers, tips, strict=True)
        ],
        "valid_body_name": bodies,
        "tip_body_name": tips,
        "sha256": hand.digest,  # ours: the hand that this was written for
    }
    config.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
    return name


def _digest_in(config: Path) -> str:
    """Of the hand that a file of the export describes; "" if it does not say."""
    try:
        data = json.loads(config.read_text(encoding="utf-8"))
    except ValueError:
        return ""
    return str(data.get("sha256", "")) if isinstance(data, dict) else ""


def _copy_meshes(spec: object, folder: Path) -> dict[str, Path]:
    """Copy a model's mesh files; name in the model -> name in the folder."""
    root = Path(spec.modelfiledir) / (spec.meshdir or "")  # type: ignore[attr-defined]
    out: dict[str, Path] = {}
    for mesh in spec.meshes:  # type: ignore[attr-defined]
        if not mesh.file or mesh.file in out:
            continue
        folder.mkdir(exist_ok=True)
        # two folders of a model may hold files of one name
        target = f"{len(out):02d}-{file_name(PurePath(mesh.file).name)}"
        shutil.copyfile(root / mesh.file, folder / target)
        out[mesh.file] = Path(target)
    return out


def _body_of(hand: Hand, geom: str) -> str:
    """Name of the body that carries a geom."""
    model = hand.mj_model
    return str(model.body(int(model.geom(geom).bodyid[0])).name)
