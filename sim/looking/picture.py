"""How a scene looks: lights, camera, and a picture of it as a PNG file.

A picture is made where it can be. On Linux without ``MUJOCO_GL`` it is rendered through EGL, which
works without a display and, with Mesa, without a GPU; where neither works there is no picture but
a reason, and never an error.
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from PIL import Image

from planner.spatial import FloatArray

__all__ = ["CAMERA", "Picture", "add_scenery", "save_picture"]

CAMERA = "view"
"""Name of the camera that a scene has: it stays where it is and looks at the object."""

CAMERA_DISTANCE = 0.55
"""Horizontal distance (m) from object to camera: object and fingers fill the picture."""

CAMERA_HEIGHT = 0.22
"""Height (m) of the camera above the object before the lift: a look from slightly above."""

CAMERA_TURN = np.deg2rad(80.0)
"""Angle between the camera's direction and the side away from the hand's base: nearly in profile,
so that thumb and fingers are seen on both sides of the object. Of the two sides it is the one that
the palm faces."""

FIELD_OF_VIEW_DEG = 38.0
"""Vertical field of view of the camera, degrees."""

PICTURE_SIZE = (960, 720)
"""Width and height of a picture, pixels."""

EXTENT = 0.35
"""Size (m) of what matters in the picture; MuJoCo scales shadows and clipping by it."""

FLOOR_DEPTH = 0.5
"""How far (m) below the object the floor is drawn where there is no table."""


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A picture file, or why there is none.

    Attributes:
        path: The file; None if there is none.
        reason: Why there is none, "" otherwise.
    """

    path: Path | None
    reason: str


def add_scenery(
    spec: Any,
    focus: FloatArray,
    base: FloatArray,
    palm_faces: FloatArray,
    table_height: float | None,
    scale: float = 1.0,
) -> None:
    """Add what is only to be looked at: sky, lights, camera, and a floor where no table is.

    Args:
        spec: ``mujoco.MjSpec``; the camera follows its body "object".
        focus: Point (3,) to look at before the lift, m.
        base: Position (3,) of the hand's base at the grasp, m.
        palm_faces: Direction (3,) in which the palm faces then.
        table_height: Height of the table's top, m; None for no table.
        scale: How much more than object and hand is to be seen, a factor on the distance.
    """
    spec.visual.global_.offwidth, spec.visual.global_.offheight = PICTURE_SIZE
    spec.visual.quality.shadowsize = 4096
    spec.stat.center, spec.stat.extent = focus, scale * EXTENT
    spec.visual.headlight.ambient = (0.35, 0.35, 0.36)
    spec.visual.headlight.diffuse = (0.45, 0.45, 0.45)
    spec.visual.headlight.specular = (0.2, 0.2, 0.2)
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=(0.85, 0.90, 0.96),
        rgb2=(0.62, 0.68, 0.75),
        width=256,
        height=256,
    )
    away = np.arctan2(focus[1] - base[1], focus[0] - base[0])
    sides = [
        np.array([np.cos(away + turn), np.sin(away + turn), 0.0])
        for turn in (CAMERA_TURN, -CAMERA_TURN)
    ]
    toward = max(sides, key=lambda side: float(side @ palm_faces))
    eye = focus + scale * (CAMERA_DISTANCE * toward + np.array([0.0, 0.0, CAMERA_HEIGHT]))
    spec.worldbody.add_camera(
        name=CAMERA,
        pos=eye,
        mode=mujoco.mjtCamLight.mjCAMLIGHT_TARGETBODY,
        targetbody="object",
        fovy=FIELD_OF_VIEW_DEG,
    )
    lamp = focus + np.array([0.25 * toward[0], 0.25 * toward[1], 1.0])
    spec.worldbody.add_light(
        name="lamp",
        pos=lamp,
        dir=focus - lamp,
        diffuse=(0.45, 0.45, 0.43),
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        castshadow=True,
    )
    if table_height is None:
        spec.worldbody.add_geom(
            name="floor",
            type=mujoco.mjtGeom.mjGEOM_PLANE,
            size=(0, 0, 1),
            pos=(0, 0, focus[2] - FLOOR_DEPTH),
            contype=0,
            conaffinity=0,
            rgba=(0.78, 0.76, 0.73, 1.0),
        )


def save_picture(model: Any, data: Any, path: Path) -> Picture:
    """Render what the scene's camera sees now into a PNG file.

    Args:
        model: ``mujoco.MjModel`` with a camera called ``CAMERA``.
        data: ``mujoco.MjData``, with kinematics computed.
        path: The file to write.
    """
    pixels = _render(model, data)
    if isinstance(pixels, str):
        return Picture(path=None, reason=pixels)
    try:
        Image.fromarray(pixels).save(path)
    except OSError as error:
        return Picture(path=None, reason=f"cannot write {path}: {error}")
    return Picture(path=path, reason="")


def _render(model: Any, data: Any) -> Any:
    """Pixels (height, width, 3), or why there are none."""
    width, height = PICTURE_SIZE
    backend = os.environ.get("MUJOCO_GL", "").lower()
    try:
        # Chosen here, not by the environment at MuJoCo's import, so that the order of imports does
        # not matter and nothing global is changed.
        if sys.platform == "linux" and backend in ("", "egl"):
            from mujoco.egl import GLContext
        else:
            from mujoco.gl_context import GLContext
        context = GLContext(width, height)
    except (ImportError, RuntimeError, AttributeError, OSError) as error:
        what = backend or "EGL"
        return f"no offscreen rendering by {what}: {str(error).splitlines()[0][:200]}"
    try:
        context.make_current()
        return _draw(model, data, width, height)
    except (RuntimeError, mujoco.FatalError) as error:
        return f"offscreen rendering failed: {error}"
    finally:
        context.free()


def _draw(model: Any, data: Any, width: int, height: int) -> Any:
    renderer = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
    mujoco.mjr_setBuffer(int(mujoco.mjtFramebuffer.mjFB_OFFSCREEN), renderer)
    scene = mujoco.MjvScene(model, maxgeom=2000)
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
    camera.fixedcamid = model.camera(CAMERA).id
    mujoco.mjv_updateScene(
        model,
        data,
        _options(),
        mujoco.MjvPerturb(),
        camera,
        int(mujoco.mjtCatBit.mjCAT_ALL),
        scene,
    )
    viewport = mujoco.MjrRect(0, 0, width, height)
    pixels = np.zeros((height, width, 3), dtype=np.uint8)
    mujoco.mjr_render(viewport, scene, renderer)
    mujoco.mjr_readPixels(pixels, None, viewport, renderer)
    renderer.free()
    return np.flipud(pixels)


def _options() -> Any:
    """What is drawn: no sites, which some models have as rays and boxes around the hand."""
    options = mujoco.MjvOption()
    options.sitegroup[:] = 0
    return options
