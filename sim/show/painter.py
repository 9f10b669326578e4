"""``Painter``: draws states of one model; one OpenGL context for all its pictures.

``Viewer``: MuJoCo's live viewer beside a trial, in real time.

Edges are smoothed by drawing larger and shrinking. Without a GPU that is cheaper than MuJoCo's four
samples a pixel: 26 ms of CPU instead of 42 at 640 x 480, and shadows have smooth edges too.

There is more than one way to draw without a window: EGL, OSMesa, or GLFW with a display. On Linux
without ``MUJOCO_GL`` they are tried in this order, and the first that gives an OpenGL context is
taken; with it only the one that it names, as in MuJoCo. macOS has its own (CGL). Nothing is left in
the environment by a way that does not work.
"""

from __future__ import annotations

import copy
import importlib
import os
import sys
import time
import warnings
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from planner.errors import TaskError
from planner.spatial import FloatArray
from sim.show.camera import LAMPS, View, lamp_at

ORDER = ("egl", "osmesa", "glfw")
"""Ways to draw on Linux, in the order in which they are tried."""

NAMES = {"egl": "EGL", "osmesa": "OSMesa", "glfw": "GLFW", "cgl": "CGL"}
"""How they are written."""

OFF = ("disable", "disabled", "off", "false", "0")
"""Values of ``MUJOCO_GL`` by which MuJoCo is told not to draw."""

_PLATFORM = "PYOPENGL_PLATFORM"


@dataclass(frozen=True)
class Backend:
    """An OpenGL context that is current in this thread, until it is closed.

    Attributes:
        name: How it draws, such as "EGL".
        context: MuJoCo's context object.
    """

    name: str
    context: Any

    def close(self) -> None:
        """Free the context."""
        self.context.free()


def open_backend(width: int, height: int) -> Backend | str:
    """Open the first way to draw that works, or say in one line why none does.

    Args:
        width: Of the largest picture, pixels.
        height: Likewise.
    """
    asked = os.environ.get("MUJOCO_GL", "").strip().lower()
    if asked in OFF:
        return f"no offscreen rendering: MUJOCO_GL is {asked}; unset it"
    ways: tuple[str, ...] = (asked,) if asked else ORDER
    if sys.platform == "darwin":
        ways = ("cgl",)
    reasons = []
    for way in ways:
        found = _open(way, width, height)
        if isinstance(found, Backend):
            return found
        reasons.append(f"{NAMES.get(way, way)}: {found}")
    return f"no offscreen rendering ({'; '.join(reasons)}); {_remedy(asked)}"


def why_not() -> str:
    """Why nothing can be drawn on this machine, in one line; "" if it can."""
    found = open_backend(8, 8)
    if isinstance(found, str):
        return found
    found.close()
    return ""


def _has_display() -> bool:
    return any(os.environ.get(d) for d in ("DISPLAY", "WAYLAND_DISPLAY"))


def _open(way: str, width: int, height: int) -> Backend | str:
    if way not in NAMES:
        return f"MUJOCO_GL does not know it; give one of {', '.join(ORDER)}"
    if way == "glfw" and not _has_display():
        return "there is no display"
    platform = os.environ.get(_PLATFORM)
    try:
        # Chosen here, not by the environment at MuJoCo's import, so that the order of imports does
        # not matter. GLFW only warns where it cannot open its display.
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            if way == "glfw":
                importlib.import_module("glfw").init()
            context = importlib.import_module(f"mujoco.{way}").GLContext(width, height)
            context.make_current()
    except AttributeError:  # PyOpenGL's way to say that it found none
        _forget(way, platform)
        return "its library is not installed"
    except (ImportError, RuntimeError, OSError, Warning) as error:
        _forget(way, platform)
        return (str(error).splitlines() or [type(error).__name__])[0].split(". ")[0][:120]
    return Backend(NAMES[way], context)


def _forget(way: str, platform: str | None) -> None:
    """Undo what a failed import has set: PyOpenGL is bound to one platform per import."""
    if platform is None:
        os.environ.pop(_PLATFORM, None)
    else:
        os.environ[_PLATFORM] = platform
    for name in list(sys.modules):
        if name.split(".")[0] == "OpenGL" or name.startswith(f"mujoco.{way}"):
            del sys.modules[name]


def _remedy(asked: str) -> str:
    if asked:
        return "unset MUJOCO_GL, so that another way is tried"
    return "install Mesa's EGL, such as apt install libegl1, or leave the picture out"


Pixels = NDArray[np.uint8]
"""A picture: (height, width, 3), red, green, blue."""

SPARE_GEOMS = 200
"""Room in a scene beside the model's geoms: arrows, and lines that MuJoCo adds."""

ARROW_M_PER_N, ARROW_WIDTH = 0.015, 0.0022
"""Length (m) of an arrow per newton, and its radius (m)."""

LONGEST_ARROW = 0.12
"""Length (m) of the longest arrow that is drawn."""

ARROW_COLOR, ARROW_GLOW = (0.95, 0.20, 0.12, 1.0), 0.6
"""Red, and how much of it shines by itself, so that it is seen through the glass."""

GLASS = 0.25
"""Opacity of the object under arrows, which lie in it."""


@dataclass(frozen=True, kw_only=True)
class Quality:
    """What drawing is given time for.

    Attributes:
        size: Width and height of a picture, pixels.
        larger: By how much larger it is drawn than it becomes, a factor on both.
        shadows: Width of the map from which shadows are drawn, pixels.
        slices: Faces around a primitive; half as many from pole to pole.
    """

    size: tuple[int, int]
    larger: float
    shadows: int
    slices: int


@dataclass(frozen=True, kw_only=True)
class Arrows:
    """Forces to draw.

    Attributes:
        points: Where they act, (n, 3), m, world.
        forces: (n, 3), N, world.
        object_body: Body that they act on; it is drawn as glass, so that they can be seen.
    """

    points: FloatArray
    forces: FloatArray
    object_body: int


class Painter:
    """Draws states of a model.

    Attributes:
        backend: How it draws, such as "EGL".
        size: Width and height of its pictures, pixels.
    """

    def __init__(self, model: Any, quality: Quality, backend: Backend) -> None:
        """Take over an open backend; see ``open_painter``.

        Raises:
            FatalError: MuJoCo's, where the context has not what it needs.
        """
        self.backend, self.size = backend.name, quality.size
        self._model, self._backend = model, backend
        self._data = mujoco.MjData(model)
        width, height = drawn_size(quality)
        look = model.vis
        look.global_.offwidth, look.global_.offheight = width, height
        look.quality.shadowsize, look.quality.offsamples = quality.shadows, 0
        look.quality.numslices, look.quality.numstacks = quality.slices, quality.slices // 2
        self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(int(mujoco.mjtFramebuffer.mjFB_OFFSCREEN), self._context)
        self._scene = mujoco.MjvScene(model, maxgeom=model.ngeom + SPARE_GEOMS)
        self._options = mujoco.MjvOption()
        self._options.sitegroup[:] = 0  # some models have rays and boxes around the hand
        self._viewport = mujoco.MjrRect(0, 0, width, height)
        self._pixels = np.zeros((height, width, 3), dtype=np.uint8)

    def light(self, view: View) -> None:
        """Turn the scene's lamps to where they are for a camera."""
        names = [self._model.light(i).name for i in range(self._model.nlight)]
        for i, name in enumerate(names):
            if name in LAMPS:
                place, direction = lamp_at(name, view.lookat, view.azimuth)
                self._model.light_pos[i], self._model.light_dir[i] = place, direction

    def draw(self, qpos: FloatArray, view: View, arrows: Arrows | None = None) -> Pixels:
        """What is seen.

        Args:
            qpos: State (nq,).
            view: From where.
            arrows: Forces to draw too.
        """
        model, data, scene = self._model, self._data, self._scene
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)  # lights and cameras may hang on it
        mujoco.mj_camlight(model, data)
        every = int(mujoco.mjtCatBit.mjCAT_ALL)
        mujoco.mjv_updateScene(model, data, self._options, None, view.camera, every, scene)
        if arrows is not None:
            self._add(arrows)
        mujoco.mjr_render(self._viewport, scene, self._context)
        mujoco.mjr_readPixels(self._pixels, None, self._viewport, self._context)
        upright = Image.fromarray(np.flipud(self._pixels))
        return np.asarray(upright.resize(self.size, Image.Resampling.BOX))

    def _add(self, arrows: Arrows) -> None:
        scene, kind = self._scene, int(mujoco.mjtGeom.mjGEOM_ARROW)
        own = np.flatnonzero(self._model.geom_bodyid == arrows.object_body)
        for geom in scene.geoms[: scene.ngeom]:
            if geom.objtype == mujoco.mjtObj.mjOBJ_GEOM and geom.objid in own:
                geom.rgba[3] = GLASS
        for point, force in zip(arrows.points, arrows.forces, strict=True):
            size = float(np.linalg.norm(force))
            length = min(ARROW_M_PER_N * size, LONGEST_ARROW)
            if length < 2 * ARROW_WIDTH or scene.ngeom >= scene.maxgeom:
                continue
            geom = scene.geoms[scene.ngeom]
            mujoco.mjv_initGeom(
                geom,
                kind,
                np.zeros(3),
                np.zeros(3),
                np.eye(3).ravel(),
                np.array(ARROW_COLOR, dtype=np.float32),
            )
            geom.emission = ARROW_GLOW
            mujoco.mjv_connector(geom, kind, ARROW_WIDTH, point, point + length * force / size)
            scene.ngeom += 1

    def close(self) -> None:
        """Free the context."""
        self._context.free()
        self._backend.close()

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Free the context."""
        self.close()


def drawn_size(quality: Quality) -> tuple[int, int]:
    """Width and height before shrinking, pixels."""
    width, height = (round(quality.larger * n) for n in quality.size)
    return width, height


def open_painter(model: Any, quality: Quality) -> Painter | str:
    """A painter, or in one line why there is none.

    Args:
        model: ``mujoco.MjModel``; a copy of it is drawn.
        quality: What drawing is given time for.
    """
    backend = open_backend(*drawn_size(quality))
    if isinstance(backend, str):
        return backend
    try:
        return Painter(copy.copy(model), quality, backend)
    except (RuntimeError, mujoco.FatalError) as error:
        backend.close()
        return f"no offscreen rendering ({backend.name}: {error})"


FRAME = 1.0 / 60.0
"""Time between two pictures, s."""


def check_display() -> None:
    """See whether a window could open.

    Raises:
        TaskError: There is no display.
    """
    if sys.platform == "linux" and not _has_display():
        raise TaskError("there is no display to show the trial on; run it without the viewer")


class Viewer:
    """A window that follows a simulation; closing it lets the simulation go on unseen."""

    def __init__(self, model: Any, data: Any) -> None:
        """Open the window.

        Raises:
            TaskError: There is no display, or MuJoCo cannot open a window on it.
        """
        check_display()
        import mujoco.viewer  # opens a connection to the display

        try:
            self._handle = mujoco.viewer.launch_passive(model, data)
        except RuntimeError as error:
            raise TaskError(
                f"MuJoCo's viewer does not open: {error}; run without the viewer (on macOS, start "
                "Python as mjpython)"
            ) from error
        self._begin = time.perf_counter() - data.time
        self._next = 0.0

    def show(self, now: float) -> None:
        """Draw if a picture is due at simulated time ``now`` (s), and wait until then."""
        if now < self._next or not self._handle.is_running():
            return
        self._next = now + FRAME
        self._handle.sync()
        time.sleep(max(0.0, self._begin + now - time.perf_counter()))

    def close(self) -> None:
        """Close the window."""
        self._handle.close()
