"""Are states still held after 2 s? Imports nothing but NumPy and MuJoCo.

    python check_states.py CACHE/OBJECT/states.npz [COUNT] [SEED]

COUNT states at random (500; 0: all) are held for 2 s by their commands, gravity, mass and friction.
Exit code 0: of 95 % the object moved by at most 5 mm and 5 degrees; 1: of fewer; 2: wrong usage.
"""

import sys
from pathlib import Path

import mujoco
import numpy as np

COLUMNS = "joint_position command object_position_m object_quaternion_wxyz gravity_m_s2"


def main(path: Path, count: int = 500, seed: int = 0) -> float:
    """Share of a random sample of states that is held."""
    states = np.load(path)
    model = mujoco.MjModel.from_xml_path(str(path.parent / str(states["scene"])))
    data = mujoco.MjData(model)
    # where everything stands in the model, by name
    joints = [model.joint(str(name)).qposadr[0] for name in states["joint_names"]]
    actuators = [model.actuator(str(name)).id for name in states["actuator_names"]]
    pose = model.joint("object").qposadr[0] + np.arange(7)
    body = model.body("object").id
    geoms = np.flatnonzero(model.geom_bodyid == body)
    mass, inertia = model.body_mass[body], model.body_inertia[body].copy()

    columns = {name: states[name] for name in (*COLUMNS.split(), "mass_kg", "friction")}
    n, moved, turned = len(columns["mass_kg"]), [], []
    rows = np.random.default_rng(seed).permutation(n)[: count or n]
    for state in ({name: column[row] for name, column in columns.items()} for row in rows):
        mujoco.mj_resetData(model, data)
        model.opt.gravity[:] = state["gravity_m_s2"]
        model.body_mass[body] = state["mass_kg"]
        model.body_inertia[body] = inertia * state["mass_kg"] / mass
        model.geom_friction[geoms, 0] = state["friction"]
        data.qpos[joints] = state["joint_position"]
        start = np.hstack([state["object_position_m"], state["object_quaternion_wxyz"]])
        data.qpos[pose] = start
        data.ctrl[actuators] = state["command"]
        mujoco.mj_step(model, data, round(2.0 / model.opt.timestep))
        end = data.qpos[pose]
        moved.append(np.linalg.norm(end[:3] - start[:3]))
        turned.append(2 * np.degrees(np.arccos(min(1.0, abs(start[3:] @ end[3:])))))
    held = (np.array(moved) <= 0.005) & (np.array(turned) <= 5.0)
    print(f"{held.sum()} of {len(held)} states held for 2 s ({100 * held.mean():.1f} %)")
    print(f"object moved: median {1e3 * np.median(moved):.3f} mm, most {1e3 * max(moved):.3f} mm")
    return float(held.mean())


if __name__ == "__main__":
    file, *numbers = sys.argv[1:] or [""]
    if not (Path(file).is_file() and all(map(str.isdecimal, numbers)) and len(numbers) <= 2):
        print("usage: " + __doc__.splitlines()[2].strip(), file=sys.stderr)
        sys.exit(2)
    sys.exit(0 if main(Path(file), *map(int, numbers)) >= 0.95 else 1)
