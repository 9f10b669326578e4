"""The lab's step 2: positions and Jacobians of the fingertips, and three witnesses for them.

The lab takes them from MuJoCo and believes them. Here Pinocchio computes them and MuJoCo's
mj_jacSite and finite differences check them, at random joints. The hand floats, as a hand on a
robot does, and there the lab's own way of picking columns goes wrong: it uses addresses of
positions where those of velocities belong, and a free joint has 7 of one and 6 of the other.
Prints for each finger the largest differences over all postures (rounding for MuJoCo, the error of
a difference quotient for the other), and how wrong the lab's columns are: as wrong as can be.
"""

from __future__ import annotations

import mujoco
import numpy as np

from planner import HandState
from planner.hand_loading import load_hand

HAND = "shadow_hand"
POSTURES = 50  # random ones
SHIFT = 1e-6  # joint step of the finite difference, rad

hand = load_hand(HAND)
spec = hand.new_spec()
spec.body(hand.description.base_body).add_freejoint()
model = spec.compile()
data = mujoco.MjData(model)
joints = [model.joint(name) for name in hand.joint_names]
positions = np.array([joint.qposadr[0] for joint in joints])
columns = np.array([joint.dofadr[0] for joint in joints])
rng = np.random.default_rng(0)
worst = {name: np.zeros(4) for name in hand.fingers}
for q in rng.uniform(hand.q_lower, hand.q_upper, (POSTURES, hand.nq)):
    mujoco.mj_resetData(model, data)
    data.qpos[:7] = [0, 0, 0, 1, 0, 0, 0]  # the base at the world's origin
    data.qpos[positions] = q
    mujoco.mj_forward(model, data)
    state = HandState(hand, q)
    for finger in hand.fingers.values():
        tip = state.tip_pose(finger).translation
        jacobian = state.tip_jacobian(finger)
        site = data.site(finger.tip_frame)
        full = np.zeros((6, model.nv))
        mujoco.mj_jacSite(model, data, full[:3], full[3:], site.id)
        numeric = np.empty((3, len(finger.q_index)))
        for column, k in enumerate(finger.q_index):
            step = SHIFT * np.eye(hand.nq)[k]
            ahead, behind = HandState(hand, q + step), HandState(hand, q - step)
            moved = ahead.tip_pose(finger).translation - behind.tip_pose(finger).translation
            numeric[:, column] = moved / (2 * SHIFT)
        wrong = np.take(full, positions[finger.q_index], axis=1, mode="clip")
        differences = (
            tip - site.xpos,
            jacobian - full[:, columns[finger.q_index]],
            jacobian[:3] - numeric,
            jacobian[:3] - wrong[:3],
        )
        largest = [np.abs(difference).max() for difference in differences]
        worst[finger.name] = np.maximum(worst[finger.name], largest)

print(f"{hand.name}, {POSTURES} random postures: largest difference of Pinocchio from")
print("          MuJoCo's tip   MuJoCo's Jacobian   finite differences   the lab's columns")
for name, (tip_mm, exact, finite, lab) in worst.items():
    print(f"  {name:7} {1e3 * tip_mm:8.1e} mm {exact:15.1e} m/rad {finite:14.1e} m/rad", end="")
    print(f" {1e3 * lab:11.0f} mm/rad")
agree = all(row[0] < 1e-12 and row[1] < 1e-12 and row[2] < 1e-8 for row in worst.values())
print("all witnesses agree:", "yes" if agree else "no")
