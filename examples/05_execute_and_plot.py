"""Execute a plan in MuJoCo and plot normal forces and epsilon over time.

The contacts that MuJoCo reports go through the same analysis as the planned ones, so plan and
execution can be put side by side. Prints the verdict and a table of planned against measured
contacts (fractions of a millimetre and a few per cent), and draws trial.png in the current folder:
forces rise to the planned ones (dashed) in the squeeze and stay there through lift and hold.
Needs matplotlib: pip install "opposable[plot]".
"""

from __future__ import annotations

import matplotlib

from planner import GraspTask, plan_grasp
from planner.quality import analyse
from sim.controllers import PHASES
from sim.scene.physics import PhysicsOptions
from sim.trial import simulate

HAND = "allegro_hand"
OBJECT = "cylinder"
SEED = 0
MU = 0.6  # sliding friction in simulation (-); planning relies on 0.5
PICTURE = "trial.png"

matplotlib.use("Agg")  # draws into files, without a display
from matplotlib import pyplot as plt  # noqa: E402  the backend is chosen first

plan = plan_grasp(GraspTask.create(HAND, OBJECT), seed=SEED)
report = simulate(plan, physics=PhysicsOptions(mu=MU))

moved, turned = report.largest_slip
if report.success:
    print(f"held; the object moved {moved:.2f} mm and {turned:.2f} degrees in the hand")
else:
    print(f"not held: {report.reason}; {report.verdict.detail}")
print("\nfinger     position error (mm)   planned (N)   measured (N)   force error (%)")
for c in report.comparison:
    forces = f"{c.planned_normal_force:11.2f} {c.measured_normal_force:14.2f}"
    print(f"{c.finger:10} {c.position_error_mm:19.2f}   {forces} {c.force_error_percent:17.1f}")
planned = report.quality_planned.epsilon_round
print(f"\nepsilon of true cones, planned at mu {plan.task.mu}: {planned}")
if report.quality_measured is not None and report.contacts_measured is not None:
    same = report.quality_measured.epsilon_round
    print(f"epsilon of true cones, measured, at the plan's mu {report.quality_mu}: {same}")
    own = analyse(report.contacts_measured, length=plan.task.object.shape.bounding_radius)
    print(f"epsilon of true cones, measured, at the simulation's mu {MU}: {own.epsilon_round}")

samples = report.samples
figure, (top, bottom) = plt.subplots(2, 1, sharex=True, figsize=(8, 6))
for i, finger in enumerate(report.fingers):
    (line,) = top.plot(samples.time, samples.normal_force[:, i], label=finger)
    top.axhline(plan.contacts.forces[i, 0], color=line.get_color(), linestyle="--", linewidth=0.8)
top.set_ylabel("normal force (N)")
top.legend(loc="upper left")
bottom.plot(samples.time, samples.epsilon, color="black")
bottom.set_ylim(0.0, 1.4 * samples.epsilon.max() + 1e-3)  # room for the names of the phases
bottom.set_ylabel("epsilon of the contacts (-)")
bottom.set_xlabel("time (s)")
for phase in PHASES:
    if phase in samples.phase:
        begin = samples.time[samples.phase.index(phase)]
        for axes in (top, bottom):
            axes.axvline(begin, color="grey", linewidth=0.5)
        bottom.text(begin, bottom.get_ylim()[1], f" {phase}", rotation=90, va="top", fontsize=8)
figure.savefig(PICTURE, dpi=120)
print(f"\n{PICTURE}: normal forces (planned ones dashed) and epsilon over {samples.time[-1]:.1f} s")
