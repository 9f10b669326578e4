"""A hand as DexGraspBench reads it: model, meshes, and its entry of ``config/hand``.

The base stands where the hand's own model file puts it, so that a grasp's qpos, which places the
world of that file, is right for the exported model and for the original one alike.
"""

from __future__ import annotations

import json
import os.path
import re
import shutil
from functools import lru_cache
from pathlib import Path, PurePath

import numpy as np

from planner.bridge import compile_spec, load_spec
from planner.errors import FileFormatError
from planner.exchange.dexgraspbench.pinned_mjcf import pinned_mjcf
from planner.files import plain_name
from planner.hands.description_toml import read_description
from planner.hands.hand import Hand
from planner.spatial import SE3, pose_from_wxyz, pose_to_wxyz

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
