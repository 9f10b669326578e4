"""What is only to be looked at: sky, lights, ground, and a mark by which a turn is seen.

Nothing here has mass or collides, so that a scene moves as it would without it.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from planner.spatial import FloatArray
from sim.looking.view import FIELD_OF_VIEW_DEG

__all__ = ["LAMPS", "OBJECT_MATERIAL", "add_object_material", "add_scenery", "lamp_at"]

OBJECT_MATERIAL = "object"
"""Name of the object's material and texture."""

OBJECT_RGB, SHADE_RGB, MARK_RGB = (118, 176, 126), (66, 128, 88), (252, 246, 226)
"""The object: its two greens by quadrants of heading, and the mark at heading zero; 0 to 255."""

MARK_DEG = 9.0
"""Half the width of the mark, degrees of heading."""

TEXELS = 128
"""Width of a side of the object's texture."""

EXTENT = 0.30
"""Size (m) of what matters in the picture; MuJoCo scales shadows and clipping by it."""

FLOOR_DEPTH = 0.5
"""How far (m) below the object the floor is drawn where there is no table."""

LAMPS = {
    "key lamp": ((0.32, -0.42, -1.0), (0.42, 0.41, 0.38), True),
    "fill lamp": ((0.8, 0.9, -0.8), (0.16, 0.18, 0.21), False),
}
"""Name -> direction of the light for a camera that looks along +x (y is left), brightness, and
whether it casts shadows: the key lamp stands on the left behind the camera."""

_RGB = int(mujoco.mjtTextureRole.mjTEXROLE_RGB)


def add_scenery(
    spec: Any,
    focus: FloatArray,
    toward_camera: FloatArray,
    table_height: float | None,
    scale: float = 1.0,
) -> None:
    """Add sky, lights, and a floor where no table is; place the viewer's first camera.

    Args:
        spec: ``mujoco.MjSpec``.
        focus: Point (3,) to look at before the lift, m.
        toward_camera: Direction (3,) from there to where a person would stand, world.
        table_height: Height of the table's top, m; None for no table.
        scale: How much more than object and hand is to be seen, a factor on the distance.
    """
    look = spec.visual
    look.global_.fovy = FIELD_OF_VIEW_DEG
    look.global_.azimuth = float(np.rad2deg(np.arctan2(-toward_camera[1], -toward_camera[0])))
    look.global_.elevation = -20.0
    look.quality.shadowsize = 4096
    look.map.znear, look.map.shadowclip = 0.02, 4.5
    look.headlight.ambient = (0.40, 0.40, 0.41)
    look.headlight.diffuse = (0.36, 0.36, 0.36)
    look.headlight.specular = (0.05, 0.05, 0.05)
    spec.stat.center, spec.stat.extent = focus, scale * EXTENT
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=(0.93, 0.95, 0.97),
        rgb2=(0.70, 0.76, 0.83),
        width=256,
        height=256,
    )
    for name, (_, brightness, shadow) in LAMPS.items():
        position, direction = lamp_at(name, focus, look.global_.azimuth)
        spec.worldbody.add_light(
            name=name,
            pos=position,
            dir=direction,
            diffuse=brightness,
            specular=(0.25, 0.25, 0.25) if shadow else (0.0, 0.0, 0.0),
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            castshadow=shadow,
        )
    if table_height is None:
        spec.worldbody.add_geom(
            name="floor",
            type=mujoco.mjtGeom.mjGEOM_PLANE,
            size=(0, 0, 1),
            pos=(0, 0, focus[2] - FLOOR_DEPTH),
            contype=0,
            conaffinity=0,
            rgba=(0.86, 0.86, 0.85, 1.0),
        )


def lamp_at(name: str, focus: FloatArray, azimuth: float) -> tuple[FloatArray, FloatArray]:
    """Where one of ``LAMPS`` stands, and the direction (3,) of its light.

    Args:
        name: Which.
        focus: Point (3,) that is looked at, m.
        azimuth: Of the camera, degrees.
    """
    c, s = np.cos(np.deg2rad(azimuth)), np.sin(np.deg2rad(azimuth))
    x, y, z = LAMPS[name][0]
    direction = np.array([c * x - s * y, s * x + c * y, z])
    return focus - direction, direction / np.linalg.norm(direction)


def add_object_material(spec: Any) -> None:
    """Add a material whose texture tells the heading of what wears it.

    MuJoCo puts a cube texture on any geom as seen from its centre: the colour of a point is that of
    its direction. The mark is a sector about +x, from pole to pole, and the quadrants alternate.
    """
    texture = spec.add_texture(
        name=OBJECT_MATERIAL,
        type=mujoco.mjtTexture.mjTEXTURE_CUBE,
        width=TEXELS,
        height=6 * TEXELS,
        nchannel=3,
    )
    texture.data = _heading_texture().tobytes()
    material = spec.add_material(name=OBJECT_MATERIAL, specular=0.15, shininess=0.3)
    material.textures[_RGB] = OBJECT_MATERIAL


def _heading_texture() -> NDArray[np.uint8]:
    """Pixels (6 sides x rows, columns, 3) in MuJoCo's order: right, left, up, down, front, back."""
    at = (2 * np.arange(TEXELS) + 1) / TEXELS - 1
    s, t = np.meshgrid(at, at)
    one = np.ones_like(s)
    # OpenGL's cube map: which direction the texel (s, t) of a side lies in
    sides = [
        (one, -t, -s),
        (-one, -t, s),
        (s, one, t),
        (s, -one, -t),
        (s, -t, one),
        (-s, -t, -one),
    ]
    out = np.empty((6, TEXELS, TEXELS, 3), dtype=np.uint8)
    for pixels, (x, y, z) in zip(out, sides, strict=True):
        heading = np.rad2deg(np.arctan2(y, x))
        odd = (np.floor(heading / 90.0) % 2).astype(bool)
        pixels[:] = np.where(odd[..., None], SHADE_RGB, OBJECT_RGB)
        pixels[np.abs(heading) < MARK_DEG] = MARK_RGB
        del z
    return out.reshape(6 * TEXELS, TEXELS, 3)
