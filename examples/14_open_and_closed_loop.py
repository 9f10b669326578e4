"""Hold the same grasp open loop and closed loop against a push that grows until it breaks.

Open loop presses with the planned forces, and the servos' stiffness keeps the object in place.
Closed loop measures the object's pose, wants a wrench that brings it back, and finds contact forces
for that wrench within friction and actuators. Both begin with the same least normal forces. Prints,
for some directions, the push at which the object has moved 5 mm or 5 degrees in the hand, beside
the largest that any controller could hold (a linear programme over the same contacts, true cones
and torque limits), and draws movement over push in open_and_closed_loop.png. Closed loop holds two
to five times as much, since it presses harder where it must.
Needs matplotlib: pip install "opposable[plot]".
"""

from __future__ import annotations

from dataclasses import replace

import matplotlib
import numpy as np

from planner import GraspTask, plan_grasp
from planner.certify.breaking import breaking_along
from planner.spatial import SE3, FloatArray, pose_change
from sim.controllers import CONTROLLERS
from sim.scene.physics import PhysicsOptions
from sim.simulation import Simulation
from sim.trial import Timeline, Trial

HAND = "allegro_hand"
OBJECT = "sphere"
SEED = 0
MU = 0.6  # sliding friction in simulation (-); both controllers rely on 0.5
RATE = 15.0  # growth of the push, N/s
LARGEST = 30.0  # push at which it ends in any case, N
LIMIT_MM, LIMIT_DEG = 5.0, 5.0  # movement in the hand that counts as broken
PUSHES = {"up": (0, 0, 1), "down": (0, 0, -1), "sideways": (0, 1, 0)}  # world axes
QUICK = Timeline.quick(settle=0.1, lift=0.2, lift_height=0.02)
PICTURE = "open_and_closed_loop.png"

matplotlib.use("Agg")  # draws into files, without a display
from matplotlib import pyplot as plt  # noqa: E402  the backend is chosen first

plan = plan_grasp(GraspTask.create(HAND, OBJECT), seed=SEED)


def push_until_it_breaks(controller: str, direction: FloatArray) -> FloatArray:
    """Push (N), movement (mm) and rotation (degrees) in the hand over time, (m, 3)."""
    trial = Trial(
        plan,
        controller=controller,
        physics=PhysicsOptions(mu=MU),
        timeline=replace(QUICK, hold=LARGEST / RATE),
        record_every=0.1,
    )
    rows: list[tuple[float, float, float]] = []
    start: list[tuple[float, SE3]] = []

    def on_step(simulation: Simulation) -> None:
        if simulation.phase != "hold":
            return
        start.append((simulation.time, simulation.T_palm_object))
        begin, first = start[0]
        push = RATE * (simulation.time - begin)
        simulation.data.xfrc_applied[simulation.scene.object_body, :3] = push * direction
        moved, turned = pose_change(first, simulation.T_palm_object)
        rows.append((push, moved, turned))
        if moved > LIMIT_MM or turned > LIMIT_DEG:
            simulation.stop("the object has moved too far in the hand")

    trial.run(on_step=on_step)
    return np.array(rows)


contacts = plan.contacts.with_friction(MU)
figure, axes = plt.subplots(1, len(PUSHES), sharey=True, figsize=(11, 4))
print(f"{HAND}, {OBJECT}: push (N) at {LIMIT_MM:.0f} mm or {LIMIT_DEG:.0f} degrees in the hand\n")
print("direction  feedforward  impedance  impedance / feedforward  any controller")
for axis, (name, direction) in zip(axes, PUSHES.items(), strict=True):
    along = np.array(direction, dtype=np.float64)
    runs = {controller: push_until_it_breaks(controller, along) for controller in CONTROLLERS}
    opened, closed = runs["feedforward"][-1, 0], runs["impedance"][-1, 0]
    problem = replace(plan.forces.problem, contacts=contacts)
    bound = breaking_along(problem, np.concatenate([along, np.zeros(3)])).upper
    print(f"{name:10} {opened:11.1f} {closed:10.1f} {closed / opened:24.1f} {bound:15.1f}")
    for controller, run in runs.items():
        axis.plot(run[:, 0], run[:, 1], label=controller)
    axis.set_title(f"push {name}")
    axis.set_xlabel("push (N)")
axes[0].set_ylabel("movement in the hand (mm)")
axes[0].legend()
figure.savefig(PICTURE, dpi=120)
print(f"\n{PICTURE}: movement in the hand over the push")
