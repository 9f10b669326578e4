"""Runs a task of another project in its own environment: a script of that environment's Python.

    python scenes_launch.py TASK CHECKOUT SEED     TASK: a name of ``SERVED``

Lines of JSON in, ``{"reset": true}`` or ``{"action": [...]}``, as its ``step`` takes it; lines out,
the state of its MuJoCo after that. Scene, reset, step, controllers and test of success are its own.
Of DexJoCo two things are left out: its pictures, which nobody looks at here, and its waiting for
the wall clock. This file imports nothing of this project.
"""

from __future__ import annotations

import json
import os
import sys
from importlib import import_module
from typing import Any

STATE = ("qpos", "qvel", "ctrl", "mocap_pos", "mocap_quat")
"""Parts of ``mujoco.MjData`` that are told."""

DRAWN = ("body_pos", "body_quat", "geom_size", "body_mass")
"""Parts of ``mujoco.MjModel`` that resets change."""


class _NoPictures:
    """In place of its renderer."""

    def __init__(self, *_: Any, **__: Any) -> None:
        """Nothing."""

    def render(self, *_: Any, **__: Any) -> None:
        """Nothing."""


class DexJoCo:
    """A task of DexJoCo: position and quaternion (w, x, y, z) of the flange, 16 joint targets."""

    def __init__(self, name: str, tells: tuple[str, ...], checkout: str, seed: int) -> None:
        """Make it, by the middle of its class's name, and what it tells of a step."""
        self._keys = ("succeed", *tells)
        sys.path.insert(0, os.path.join(checkout, "dexjoco"))
        module = "".join(f"_{c.lower()}" if c.isupper() else c for c in name)
        task: Any = import_module(f"dexjoco.sim.envs.panda{module}_env")
        task.MujocoRenderer = _NoPictures
        kind = getattr(task, f"Panda{name}GymEnv")
        kind._compute_observation = lambda self: {}
        # its default but for tongs, which have none: light, camera and textures; poses are random
        self._env = env = kind(seed=seed, randomize=False)
        env.hz = float("inf")
        self.model, self.data, self.seconds = env.model, env.data, float(env.control_dt)

    def reset(self) -> None:
        """Its reset."""
        self._env.reset()

    def step(self, action: Any) -> dict[str, Any]:
        """Its step; what it says of it."""
        _, _, ended, _, info = self._env.step(action)
        return {"ended": bool(ended)} | {key: float(info[key]) for key in self._keys}


class Adroit:
    """The hammer of gymnasium-robotics: 26 commands of actuators, each scaled to -1 .. 1."""

    def __init__(self, checkout: str, seed: int) -> None:
        """Make it as it registers it: with its limit of steps."""
        sys.path.insert(0, checkout)
        import gymnasium

        gymnasium.register_envs(import_module("gymnasium_robotics"))
        known = [name for name in gymnasium.registry if name.startswith("AdroitHandHammer-v")]
        self._env, self._seed = gymnasium.make(max(known)), seed
        env: Any = self._env.unwrapped
        self.model, self.data, self.seconds = env.model, env.data, float(env.dt)

    def reset(self) -> None:
        """Its reset."""
        self._env.reset(seed=self._seed)

    def step(self, action: Any) -> dict[str, Any]:
        """Its step; what it says of it."""
        _, _, ended, truncated, info = self._env.step(action)
        return {"ended": bool(ended or truncated), "succeed": float(info["success"])}


SERVED: dict[str, Any] = {
    "hammer_nail": lambda *given: DexJoCo("HammerNail", ("nail_depth", "hammer_hit"), *given),
    "pinch_tongs": lambda *given: DexJoCo("PinchTongs", ("pinch_count",), *given),
    "click_mouse": lambda *given: DexJoCo("ClickMouse", (), *given),
    "pick_bucket": lambda *given: DexJoCo("PickBucket", (), *given),
    "fold_glasses": lambda *given: DexJoCo("FoldGlasses", (), *given),
    "adroit_hammer": Adroit,
}
"""How each task is made; takes a checkout and a seed."""


def serve(task: Any, mujoco: Any, answers: Any) -> None:
    """Answer line by line until the input ends."""
    import numpy as np

    for line in sys.stdin:
        asked = json.loads(line)
        told: dict[str, Any] = {"ended": False, "succeed": 0.0, "seconds": task.seconds}
        if "action" in asked:
            told |= task.step(np.array(asked["action"]))
        else:
            task.reset()
            told |= {name: getattr(task.model, name).tolist() for name in DRAWN}
            told |= {"mujoco": mujoco.__version__}
        told |= {name: getattr(task.data, name).tolist() for name in STATE}
        told |= {"time": float(task.data.time)}
        answers.write(json.dumps(told) + "\n")
        answers.flush()


if __name__ == "__main__":
    said = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what the task prints is none of the answers
    serve(SERVED[sys.argv[1]](sys.argv[2], int(sys.argv[3])), import_module("mujoco"), said)
