"""``export_scene``: a plan becomes a folder from which another simulator starts in the same state.

scene.xml      MJCF: hand, object, key frames pregrasp, grasp and squeeze
hand.urdf      the hand alone, from its base; without servos, tendons and couplings
object.urdf    the object alone
meshes/        Wavefront OBJ, m
physics.json   gains, limits, friction, contact model, integrator, joints and commands by name
check.py       loads scene.xml in MuJoCo alone and says whether the object is held
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import sim.scene_export.check as check_script
from planner.errors import FileFormatError
from planner.exchange.formats import GraspFormat, Writing, register_format
from planner.files import write_json
from planner.plan import GraspPlan
from sim.physics import PRESETS, AnyPhysics
from sim.scene import OBJECT, Scene
from sim.scene_export.keyframes import key_frames
from sim.scene_export.mjcf import MESHES, mesh_files, plain_scene, scene_mjcf
from sim.scene_export.physics_file import PHYSICS_FORMAT, physics_data
from sim.scene_export.urdf import body_urdf, ellipsoid_files, not_in_urdf

SCENE, PHYSICS, CHECK, HAND_URDF, OBJECT_URDF = (
    "scene.xml",
    "physics.json",
    "check.py",
    "hand.urdf",
    "object.urdf",
)
"""Names of the files."""


def export_scene(
    plan: GraspPlan, folder: Path | str, *, physics: AnyPhysics | None = None
) -> tuple[Path, ...]:
    """Write the scene of a plan, whole or not at all.

    Args:
        plan: The grasp.
        folder: Made; an earlier export in it is replaced.
        physics: How MuJoCo computes, or the name of a preset; defaults if None.

    Returns:
        The files.

    Raises:
        TaskError: The hand has actuators that follow no position, or the plan has no forces.
        ModelError: The scene has parts that cannot be written: tendons through space, ties between
            bodies.
        FileFormatError: The folder holds something else, or cannot be written.
    """
    target = Path(folder)
    keys = key_frames(plan)
    scene, spec = plain_scene(plan, PRESETS.given(physics))
    meshes = mesh_files(scene.model)
    hand, about = plan.task.hand, "hand.urdf is rooted at the hand's base"
    texts = {mesh.file: mesh.text for mesh in (*meshes, *ellipsoid_files(scene.model))}
    texts[SCENE] = scene_mjcf(scene, spec, keys, meshes)
    effort = _effort(scene)
    for name, body, title in (
        (HAND_URDF, scene.base_body, hand.name),
        (OBJECT_URDF, scene.object_body, OBJECT),
    ):
        texts[name] = body_urdf(scene.model, body, title, meshes, effort)
    texts[CHECK] = Path(check_script.__file__).read_text(encoding="utf-8")
    urdf = {"frames": about, "cannot_say": not_in_urdf(scene.model)}
    data = physics_data(plan, scene, keys, urdf)
    _need_ours(target)
    try:
        with tempfile.TemporaryDirectory(dir=target.absolute().parent, prefix=".export-") as made:
            home = Path(made) / "scene"
            (home / MESHES).mkdir(parents=True)
            for name, text in texts.items():
                (home / name).write_text(text, encoding="utf-8")
            write_json(data, home / PHYSICS)
            if target.exists():
                os.replace(target, Path(made) / "old")
            os.replace(home, target)
    except OSError as error:
        raise FileFormatError(f"cannot write {target}: {error.strerror}") from error
    return tuple(sorted(path for path in target.rglob("*") if path.is_file()))


def _effort(scene: Scene) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Largest torque (nv,) of the actuators on each degree of freedom, force ranges alone."""
    hand = scene.task.hand
    most = np.abs(hand.actuation.force_range).max(axis=1)
    with np.errstate(invalid="ignore"):
        of_joint = np.where(hand.actuation.moment, np.abs(hand.actuation.moment) * most[:, None], 0)
    out = np.zeros(scene.model.nv)
    out[scene.hand_dof] = of_joint.sum(axis=0)
    return out


def _need_ours(folder: Path) -> None:
    """A folder is only replaced if it is empty or an earlier export, with nothing beside it."""
    if not folder.exists():
        if not folder.absolute().parent.is_dir():
            raise FileFormatError(f"there is no folder {folder.parent}; make it, or name another")
        return
    if folder.is_dir() and not any(folder.iterdir()):
        return
    try:
        ours = json.loads((folder / PHYSICS).read_text(encoding="utf-8"))["format"]
    except (OSError, ValueError, KeyError, TypeError):
        ours = ""
    if ours != PHYSICS_FORMAT:
        raise FileFormatError(
            f"{folder} is no earlier export of a scene; name another folder, or empty it"
        )
    own = {SCENE, HAND_URDF, OBJECT_URDF, MESHES, PHYSICS, CHECK}
    if others := sorted(entry.name for entry in folder.iterdir() if entry.name not in own):
        raise FileFormatError(
            f"{folder} holds an earlier export and {', '.join(others)}, which would be lost; name "
            "another folder, or move them"
        )


def _write(plans: Sequence[GraspPlan], path: Path, writing: Writing) -> tuple[Path, ...]:
    """One plan to the folder itself, several to numbered folders in it."""
    del writing
    if len(plans) == 1:
        return export_scene(plans[0], path)
    if path.exists() and not (path.is_dir() and not any(path.iterdir())):
        raise FileFormatError(
            f"{path} exists already; several scenes are written into a new folder: name another"
        )
    _need_ours(path)
    try:
        with tempfile.TemporaryDirectory(dir=path.absolute().parent, prefix=".export-") as made:
            home = Path(made) / "scenes"
            home.mkdir()
            for k, plan in enumerate(plans):
                export_scene(plan, home / f"{k:03d}")
            os.replace(home, path)
    except OSError as error:
        raise FileFormatError(f"cannot write {path}: {error.strerror}") from error
    return tuple(sorted(file for file in path.rglob("*") if file.is_file()))


MJCF_SCENE = register_format(
    GraspFormat(
        name="mjcf-scene",
        title="a folder with MJCF, key frames, URDF, meshes and the physics beside it",
        suffixes=(),
        loses="the way to the grasp; table and obstacles are left out",
        recognises=lambda path: False,
        write=_write,
    )
)
"""Another simulator starts from it; see the module."""
