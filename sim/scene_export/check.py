"""Does the exported scene hold its object? ``python check.py [FOLDER]``; needs mujoco and numpy.

Loads scene.xml beside this file, begins at the key frame "grasp", sends the commands of the key
frame "squeeze" to the servos and nothing else, and looks for 2 s whether the object stays in the
hand. Exit code 0 if it does. This file imports nothing of Opposable.
"""

import sys
from pathlib import Path

import mujoco
import numpy as np

SECONDS, MOST_MM, MOST_DEG = 2.0, 10.0, 15.0


def hold(scene: Path, seconds: float = SECONDS) -> tuple[bool, float, float]:
    """Whether the object is held to the end, and how far it moved (mm) and turned (degrees)."""
    model = mujoco.MjModel.from_xml_path(str(scene))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("grasp").id)
    data.ctrl[:] = model.key("squeeze").ctrl
    mujoco.mj_forward(model, data)
    body = model.body("object").id
    position, turn = data.xpos[body].copy(), data.xmat[body].reshape(3, 3).copy()
    mm = deg = 0.0
    while data.time < seconds and mm <= MOST_MM and deg <= MOST_DEG:
        mujoco.mj_step(model, data)
        mm = 1e3 * float(np.linalg.norm(data.xpos[body] - position))
        cosine = (float(np.trace(turn.T @ data.xmat[body].reshape(3, 3))) - 1.0) / 2.0
        deg = float(np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0))))
    held = bool(np.isfinite(data.qpos).all() and mm <= MOST_MM and deg <= MOST_DEG)
    return held, mm, deg


if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent
    held, mm, deg = hold(folder / "scene.xml")
    print(
        f"{'held' if held else 'not held'}: the object moved {mm:.2f} mm and turned {deg:.2f} deg"
    )
    sys.exit(0 if held else 1)
