"""Which way there is to draw without a window: EGL, OSMesa, or GLFW with a display.

On Linux without ``MUJOCO_GL`` they are tried in this order, and the first that gives an OpenGL
context is taken; with it only the one that it names, as in MuJoCo. macOS has its own (CGL).
Nothing is left in the environment by a way that does not work.
"""

from __future__ import annotations

import importlib
import os
import sys
import warnings
from dataclasses import dataclass
from typing import Any

__all__ = ["Backend", "open_backend", "why_not"]

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


def _open(way: str, width: int, height: int) -> Backend | str:
    if way not in NAMES:
        return f"MUJOCO_GL does not know it; give one of {', '.join(ORDER)}"
    if way == "glfw" and not any(os.environ.get(d) for d in ("DISPLAY", "WAYLAND_DISPLAY")):
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
