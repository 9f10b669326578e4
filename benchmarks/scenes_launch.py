"""Runs a task of DexJoCo in its own environment: a script of that environment's Python.

    python scenes_launch.py CHECKOUT SEED     the hammer and the nail; seed of its randomness

Lines of JSON in, ``{"reset": true}`` or ``{"action": [...]}`` (flange position, quaternion w, x, y,
z, and 16 joint targets, as its ``step`` takes them); lines out, the state of its MuJoCo after that.
The task's scene, reset, step, arm controller and test of success are its own. Two things are left
out: its pictures, which nobody looks at here, and its waiting for the wall clock. This file imports
nothing of this project.
"""

from __future__ import annotations

import json
import os
import sys
from importlib import import_module
from typing import Any

STATE = ("qpos", "qvel", "ctrl", "mocap_pos", "mocap_quat")
"""Parts of ``mujoco.MjData`` that are told."""

DRAWN = ("body_pos", "geom_size", "body_mass")
"""Parts of ``mujoco.MjModel`` that its reset changes."""


class _NoPictures:
    """In place of its renderer."""

    def __init__(self, *_: Any, **__: Any) -> None:
        """Nothing."""

    def render(self, *_: Any, **__: Any) -> None:
        """Nothing."""


def serve(checkout: str, seed: int) -> None:
    """Answer line by line until the input ends."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what the task prints is none of the answers
    sys.path.insert(0, os.path.join(checkout, "dexjoco"))
    import mujoco

    task: Any = import_module("dexjoco.sim.envs.panda_hammer_nail_env")

    task.MujocoRenderer = _NoPictures
    task.PandaHammerNailGymEnv._compute_observation = lambda self: {}
    env = task.PandaHammerNailGymEnv(seed=seed)
    env.hz = float("inf")
    for line in sys.stdin:
        asked = json.loads(line)
        info, ended = {}, False
        if "action" in asked:
            import numpy as np

            _, _, ended, _, info = env.step(np.array(asked["action"]))
        else:
            env.reset()
        told: dict[str, Any] = {name: getattr(env.data, name).tolist() for name in STATE}
        if "reset" in asked:
            told |= {name: getattr(env.model, name).tolist() for name in DRAWN}
            told |= {"mujoco": mujoco.__version__, "seconds": float(env.control_dt)}
        told |= {"time": float(env.data.time), "ended": bool(ended)}
        told |= {name: float(info.get(name, 0.0)) for name in ("succeed", "nail_depth")}
        told["hit"] = bool(info.get("hammer_hit", False))
        answers.write(json.dumps(told) + "\n")
        answers.flush()


if __name__ == "__main__":
    serve(sys.argv[1], int(sys.argv[2]))
