"""Load a hand, look at its fingers, and find every joint again in Pinocchio and in MuJoCo.

Prints the fingers with their joints, the fingertips by forward kinematics beside what MuJoCo says
(they agree to rounding), one fingertip Jacobian, and for every joint its place in q, in the hand's
own MuJoCo model, in a scene, and the actuators that drive it.
"""

from __future__ import annotations

import mujoco
import numpy as np

from planner import SE3, GraspTask, HandState
from planner.hand_loading import load_hand
from sim.scene.build import build_scene

HAND = "shadow_hand"  # name, or path of a hand.toml
POSTURE = "pinch"  # a posture that the description names
SHIFT = 1e-6  # joint step of the finite difference, rad

hand = load_hand(HAND)
q = hand.posture(POSTURE)
print(f"{hand.name}: {hand.nq} joints, {len(hand.actuation.names)} actuators")
for finger in hand.fingers.values():
    low, high = (np.rad2deg(limit[finger.q_index]) for limit in (hand.q_lower, hand.q_upper))
    limits = [f"{n} [{a:.0f}, {b:.0f}]" for n, a, b in zip(finger.joints, low, high, strict=True)]
    print(f"  {finger.name}: {', '.join(limits)} degrees")

# Forward kinematics by Pinocchio; the raw models are there for everything that Hand does not do.
state = HandState(hand, q)
data = mujoco.MjData(hand.mj_model)
data.qpos[:] = q
mujoco.mj_forward(hand.mj_model, data)
base = data.body(hand.description.base_body)
T_world_base = SE3(base.xmat.reshape(3, 3), base.xpos)
print(f"\nfingertips in the base frame, posture {POSTURE!r} (mm), and MuJoCo's difference (mm)")
for finger in hand.fingers.values():
    tip = state.tip_pose(finger).translation
    other = T_world_base.actInv(data.site(finger.tip_frame).xpos)
    x, y, z = 1e3 * tip
    difference = 1e3 * np.abs(tip - other).max()
    print(f"  {finger.name:7} {x:8.2f} {y:8.2f} {z:8.2f}   {difference:.1e}")

# The Jacobian of a fingertip, and a finite difference as its witness.
finger = next(iter(hand.fingers.values()))
jacobian = state.tip_jacobian(finger)
numeric = np.empty((3, len(finger.q_index)))
for column, k in enumerate(finger.q_index):
    step = SHIFT * np.eye(hand.nq)[k]
    ahead, behind = HandState(hand, q + step), HandState(hand, q - step)
    difference = ahead.tip_pose(finger).translation - behind.tip_pose(finger).translation
    numeric[:, column] = difference / (2 * SHIFT)
print(f"\nJacobian of the {finger.name}'s tip, linear rows (mm per degree), over its joints")
print(np.array2string(1e3 * np.deg2rad(jacobian[:3]), precision=3, suppress_small=True))
print(f"largest difference to finite differences: {np.abs(jacobian[:3] - numeric).max():.1e} m/rad")

# Where each joint stands: in q (and Pinocchio), in the hand's model, in a scene; what drives it.
# In a scene the gantry's joints come first: use the index maps, never numbers.
scene = build_scene(GraspTask.create(hand, "sphere"), T_world_base=SE3.Identity())
print(f"\n{'joint':8} {'q':>3} {'pin':>4} {'hand qpos':>10} {'scene qpos':>11}   driven by")
for i, name in enumerate(hand.joint_names):
    pin_joint = hand.pin_model.joints[hand.pin_model.getJointId(name)]
    own = int(hand.mj_model.joint(name).qposadr[0])
    drivers = np.flatnonzero(hand.actuation.moment[:, i])
    ctrl = ", ".join(f"{hand.actuation.names[a]} (ctrl {scene.hand_ctrl[a]})" for a in drivers)
    print(f"{name:8} {i:3} {pin_joint.idx_q:4} {own:10} {scene.hand_qpos[i]:11}   {ctrl}")
kinds = [type(model).__name__ for model in (hand.pin_model, hand.mj_model)]
print(f"\nraw models: {kinds[0]} of Pinocchio, {kinds[1]} of MuJoCo")
