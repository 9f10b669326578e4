"""How late may the object's pose be known? The closed loop under a sudden push, for some delays.

A camera that sees the object answers late. The loop takes the object's velocity from the joints,
which are known at once, so a late pose makes it slower to answer but does not make it swing at
first. Prints, for some delays, how far the object is moved by a push that begins and ends suddenly,
how far it swings back, and how much it still moves at the end, all of it in the hand, and draws
the movement over time in delay.png. With the gains that come along, delays up to some 20 ms cost
little, from 50 ms on the loop swings. A lower bandwidth is then the remedy, at the price of a
larger movement: the last line.
Needs matplotlib: pip install "opposable[plot]".
"""

from __future__ import annotations

import matplotlib
import numpy as np

from planner import GraspTask, plan_grasp
from planner.spatial import FloatArray
from sim.controllers import ImpedanceGains, ObjectImpedance
from sim.controllers.impedance import BANDWIDTH, LEARNING_RATE, effective_inertia
from sim.protocols.disturbance import DisturbanceTrial
from sim.sensing.errors import ErrorModel

HAND = "allegro_hand"
OBJECT = "sphere"
SEED = 0
PUSH = np.array([0.0, 3.0, 0.0])  # world axes, N: three times the object's weight
BEGIN, END, HOLD = 0.2, 0.6, 1.2  # of the push, and of the hold, s since the hold began
CASES = ((0, 1.0), (20, 1.0), (50, 1.0), (100, 1.0), (100, 0.4))  # ms, of the bandwidth
PICTURE = "delay.png"

matplotlib.use("Agg")  # draws into files, without a display
from matplotlib import pyplot as plt  # noqa: E402  the backend is chosen first

plan = plan_grasp(GraspTask.create(HAND, OBJECT), seed=SEED)
mass, inertia = effective_inertia(plan, plan.task.object.mass)


def pushed(delay_ms: float, share: float) -> tuple[FloatArray, tuple[str, ...]]:
    """Time since the hold began (s) and movement along the push (mm), (m, 2); what was noticed."""
    controller = ObjectImpedance(
        plan,
        gains=ImpedanceGains.of_body(
            mass=mass,
            inertia=inertia,
            bandwidth=share * BANDWIDTH,
            learning_rate=share**2 * LEARNING_RATE,
        ),
    )
    late = ErrorModel(name="late", pose_delay=1e-3 * delay_ms)
    hold = DisturbanceTrial(plan, controller=controller, dropped=None, error_model=late)
    hold.close_and_squeeze()
    first = hold.simulation.T_palm_object.translation
    towards = (
        hold.simulation.scene.body_pose(
            hold.simulation.data, hold.simulation.scene.palm_body
        ).rotation.T
        @ PUSH
    )
    rows: list[tuple[float, float]] = []

    def look(since: float) -> None:
        hold.push(np.append(PUSH if BEGIN < since < END else np.zeros(3), np.zeros(3)))
        moved = (hold.simulation.T_palm_object.translation - first) @ towards / np.linalg.norm(PUSH)
        rows.append((since, 1e3 * float(moved)))

    hold.hold_for(HOLD, each_step=look)
    return np.array(rows), tuple(event.kind for event in controller.events)


print(f"{HAND}, {OBJECT}: pushed by {np.linalg.norm(PUSH):.0f} N for {END - BEGIN:.1f} s\n")
print("delay (ms)   bandwidth (rad/s)   pushed (mm)   back (mm)   still moving (mm)   noticed")
figure, axis = plt.subplots(figsize=(8, 4.5))
for delay, share in CASES:
    rows, noticed = pushed(delay, share)
    time, moved = rows.T
    end = moved[time > HOLD - 0.2]
    numbers = f"{moved.max():13.2f} {-moved[time > END].min():11.2f} {np.ptp(end):19.3f}"
    counts = ", ".join(f"{noticed.count(k)} x {k}" for k in dict.fromkeys(noticed)) or "nothing"
    print(f"{delay:10d} {share * BANDWIDTH:19.0f} {numbers}   {counts}")
    axis.plot(time, moved, label=f"{delay} ms, {share * BANDWIDTH:.0f} rad/s")
axis.set_ylim(-13.0, 13.0)
axis.set_xlabel("time since the hold began (s)")
axis.set_ylabel("movement along the push (mm)")
axis.legend()
figure.savefig(PICTURE, dpi=120)
print(f"\n{PICTURE}: movement along the push over time")
