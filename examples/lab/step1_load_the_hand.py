"""The lab's step 1: load a dexterous hand and find its five fingers in the model.

The lab looks for names: a joint belongs to a finger if the finger's name is in it, and a fingertip
is a body called "tip". Real models have neither. Here a description names them, and MuJoCo is the
witness: every joint is moved alone, and the tips that move must be those of the joint's finger.
Prints joints, tip and pad of each finger, which actuator pulls more than one joint, and the number
of joints for which model and description disagree: 0.
"""

from __future__ import annotations

import mujoco
import numpy as np

from planner.hand_loading import load_hand
from planner.spatial import FloatArray

HAND = "shadow_hand"
STEP = 0.1  # how far each joint is moved, rad
MOVED = 1e-9  # a tip that moved further than this has moved, m

hand = load_hand(HAND)
model, data = hand.mj_model, mujoco.MjData(hand.mj_model)
print(f"{hand.name}: {model.njnt} joints, {model.nu} actuators, {model.nbody} bodies")
for finger in hand.fingers.values():
    print(f"  {finger.name:7} {len(finger.joints)} joints ({', '.join(finger.joints)})", end=", ")
    print(f"tip {finger.tip_frame}, pad on {finger.pad.geom}")

shared = {
    name: [hand.joint_names[j] for j in np.flatnonzero(row)]
    for name, row in zip(hand.actuation.names, hand.actuation.moment, strict=True)
    if np.count_nonzero(row) > 1
}
print("actuators that pull several joints:", end=" ")
print("; ".join(f"{name}: {' + '.join(joints)}" for name, joints in shared.items()))


def tips(q: FloatArray) -> FloatArray:
    """Fingertips (n_fingers, 3) in MuJoCo, m, world."""
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    return np.array([data.site(finger.tip_frame).xpos for finger in hand.fingers.values()])


middle = (hand.q_lower + hand.q_upper) / 2
rest = tips(middle)
disagree = []
for k, joint in enumerate(hand.joint_names):
    moved = np.linalg.norm(tips(middle + STEP * np.eye(hand.nq)[k]) - rest, axis=1) > MOVED
    told = [joint in f.joints or k in hand.wrist_index for f in hand.fingers.values()]
    if not np.array_equal(moved, told):
        disagree.append(joint)
print(f"\nwrist: {', '.join(hand.joint_names[k] for k in hand.wrist_index)} move every tip")
print(f"joints that move other tips than the description says: {len(disagree)}", *disagree)
