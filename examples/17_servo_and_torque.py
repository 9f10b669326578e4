"""Position servos against torque motors, under the same closed loop, at some control rates.

The loop finds joint torques. A motor gets the torque; a servo gets the target q + torque / kp,
which at the moment it is sent gives the same torque. Between two commands the two differ: a motor
keeps its torque while a servo keeps a spring around where the joint was. Prints, for both kinds of
the same hand and some control rates, how far the object moves in the hand under a sudden push and
what the fingers then press (30 % more after each slip that was noticed), and draws the movement in
servo_and_torque.png. At 125 Hz and more both agree within a few hundredths of a millimetre; at
50 Hz these gains are too high for both.
Needs matplotlib: pip install "opposable[plot]".
"""

from __future__ import annotations

from dataclasses import replace

import matplotlib
import mujoco
import numpy as np

from planner import GraspPlan, GraspTask, Hand, plan_grasp
from planner.hand_loading import hand_from_spec
from planner.spatial import FloatArray
from sim.controllers import ObjectImpedance, Observation
from sim.protocols.disturbance import DisturbanceTrial
from sim.verdict import LossCriteria

HAND = "allegro_hand"
OBJECT = "sphere"
SEED = 0
PUSH = np.array([0.0, 3.0, 0.0])  # world axes, N: three times the object's weight
BEGIN, HOLD = 0.2, 0.8  # of the push and the end, s since the hold began
EVERY = (1, 2, 4, 10)  # a new command every so many time steps
DROPPED = LossCriteria(mm=8.0, deg=15.0)  # movement in the hand that counts as lost
PICTURE = "servo_and_torque.png"

matplotlib.use("Agg")  # draws into files, without a display
from matplotlib import pyplot as plt  # noqa: E402  the backend is chosen first


class Slower:
    """A controller that is asked only every so many steps; its command stays in between."""

    def __init__(self, inner: ObjectImpedance, every: int) -> None:
        """Wrap a controller."""
        self.inner, self.every, self.count = inner, every, 0
        self.ctrl: FloatArray = np.zeros(0)

    def step(self, observation: Observation) -> FloatArray:
        """The present command (nu,)."""
        if self.count % self.every == 0:
            self.ctrl = self.inner.step(observation)
        self.count += 1
        return self.ctrl


def with_motors(hand: Hand) -> Hand:
    """The same hand with a motor of the same strength in the place of every servo."""
    spec = mujoco.MjSpec.from_file(str(hand.path.parent / hand.description.model))  # type: ignore[union-attr]
    for actuator in spec.actuators:
        actuator.set_to_motor()
        actuator.ctrllimited = mujoco.mjtLimited.mjLIMITED_FALSE
    return hand_from_spec(spec, hand.description)


def pushed(plan: GraspPlan, every: int) -> tuple[bool, FloatArray, FloatArray]:
    """Whether it was held, time (s) and movement (mm) (m, 2), and last normal forces (n,), N."""
    controller = Slower(ObjectImpedance(plan), every)
    hold = DisturbanceTrial(plan, controller=controller, dropped=DROPPED)
    fault = hold.close_and_squeeze()
    first = hold.simulation.T_palm_object.translation
    rows: list[tuple[float, float]] = []

    def look(since: float) -> None:
        hold.push(np.append(PUSH if since > BEGIN else np.zeros(3), np.zeros(3)))
        moved = hold.simulation.T_palm_object.translation - first
        rows.append((since, 1e3 * float(np.linalg.norm(moved))))

    fault = fault or hold.hold_for(HOLD, each_step=look)
    return fault is None, np.array(rows).reshape(-1, 2), controller.inner.forces[:, 0]


servo_plan = plan_grasp(GraspTask.create(HAND, OBJECT), seed=SEED)
motors = with_motors(servo_plan.task.hand)
motor_plan = replace(servo_plan, task=replace(servo_plan.task, hand=motors))
figure, axes = plt.subplots(1, len(EVERY), sharey=True, figsize=(12, 4))
print(f"{HAND}, {OBJECT}: pushed by {np.linalg.norm(PUSH):.0f} N\n")
print("rate (Hz)   drive    moved (mm)   at the end (mm)   normal forces at the end (N)")
for axis, every in zip(axes, EVERY, strict=True):
    for drive, plan in (("servos", servo_plan), ("motors", motor_plan)):
        held, rows, forces = pushed(plan, every)
        line = f"{500 / every:9.0f}   {drive:6}"
        if not held:
            print(f"{line}   lost the object")
            continue
        print(f"{line} {rows[:, 1].max():12.3f} {rows[-1, 1]:17.3f}   {np.round(forces, 2)}")
        axis.plot(rows[:, 0], rows[:, 1], label=drive)
    axis.set_title(f"{500 / every:.0f} Hz")
    axis.set_xlabel("time since the hold began (s)")
axes[0].set_ylabel("movement in the hand (mm)")
axes[0].legend()
figure.savefig(PICTURE, dpi=120)
print(f"\n{PICTURE}: movement in the hand over time")
