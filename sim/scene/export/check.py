"""Does the exported scene hold its object? ``python check.py [FOLDER]``; needs mujoco and numpy.

Loads scene.xml beside this file, begins at the key frame "grasp", sends the commands of the key
frame "squeeze" to the servos and nothing else, and looks for 2 s whether the object stays in the
hand. Exit code 0 if it does, 1 if not, 2 if there is no scene. This file imports nothing of
Opposable.
"""

import sys
from pathlib import Path

import mujoco
import numpy as np

SECONDS, MOST_MM, MOST_DEG = 2.0, 10.0, 15.0


def hold(
    scene: Path, seconds: float = SECONDS, push: "np.typing.ArrayLike" = 0.0
) -> tuple[bool, float, float]:
    """Whether the object is held to the end, and how far it moved (mm) and turned (degrees).

    In the second half a push, force (N) and torque (N m) in world axes, acts on the object's centre
    of mass.
    """
    model = mujoco.MjModel.from_xml_path(str(scene))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("grasp").id)
    data.ctrl[:] = model.key("squeeze").ctrl
    mujoco.mj_forward(model, data)
    body = model.body("object").id
    position, turn = data.xpos[body].copy(), data.xmat[body].reshape(3, 3).copy()
    mm = deg = 0.0
    while data.time < seconds and mm <= MOST_MM and deg <= MOST_DEG:
        if data.time >= seconds / 2:
            data.xfrc_applied[body] = push
        mujoco.mj_step(model, data)
        mm = 1e3 * float(np.linalg.norm(data.xpos[body] - position))
        cosine = (float(np.trace(turn.T @ data.xmat[body].reshape(3, 3))) - 1.0) / 2.0
        deg = float(np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0))))
    held = bool(np.isfinite(data.qpos).all() and mm <= MOST_MM and deg <= MOST_DEG)
    return held, mm, deg


def scene_of(given: list[str]) -> Path:
    """The scene of the folder that is given, or of this file's; ends with exit code 2 if none."""
    scene = (Path(given[0]) if given else Path(__file__).parent) / "scene.xml"
    fault = "" if scene.is_file() else f"there is no {scene}; give the folder of an exported scene"
    if len(given) > 1:
        fault = f"{len(given)} arguments are given; give one folder, or none for that of this file"
    if fault:
        print(f"usage: python check.py [FOLDER]\n{fault}", file=sys.stderr)
        sys.exit(2)
    return scene


if __name__ == "__main__":
    held, mm, deg = hold(scene_of(sys.argv[1:]))
    print(
        f"{'held' if held else 'not held'}: the object moved {mm:.2f} mm and turned {deg:.2f} deg"
    )
    sys.exit(0 if held else 1)
