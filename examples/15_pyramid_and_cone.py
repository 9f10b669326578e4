"""What a controller loses, or wrongly believes, when it sees friction cones as pyramids.

The force programme of a controller is quadratic because round cones are cut into pyramids with k
sides. An inscribed pyramid forbids forces that friction would bear; a circumscribed one allows
forces that slip. Prints, for some k, the largest push down on a held object that the programme says
the grasp can hold (the median and the worst over directions around the vertical, as a share of what
the round cones hold by a second programme), the grip that it asks for under a push of half that
size, and the time per step. Draws the shares over k in pyramid_and_cone.png. Inscribed
promises are never above the cones', circumscribed never below; from 8 sides on the loss is a few
per cent, less than friction is ever known.
Needs matplotlib: pip install "opposable[plot]".
"""

from __future__ import annotations

import matplotlib
import numpy as np

from planner import GraspTask, plan_grasp
from planner.certify.breaking import breaking_along
from planner.contacts import Pyramid
from planner.forces import ForceLoop, build_force_problem
from planner.spatial import FloatArray

HAND = "allegro_hand"
OBJECT = "sphere"
SEED = 0
SIDES = (3, 4, 6, 8, 12, 16, 32)
CONES: tuple[Pyramid, ...] = ("inscribed", "circumscribed")
TILT = 0.5  # the pushes lean this far from the vertical, rad
COUNT = 24  # of pushes, evenly around it
HALVINGS = 12  # of the interval in which a largest push lies: to 1 / 4096 of it
PICTURE = "pyramid_and_cone.png"

matplotlib.use("Agg")  # draws into files, without a display
from matplotlib import pyplot as plt  # noqa: E402  the backend is chosen first

plan = plan_grasp(GraspTask.create(HAND, OBJECT), seed=SEED)
known = plan.forces.problem
around = np.linspace(0.0, 2.0 * np.pi, COUNT, endpoint=False)
pushes = np.zeros((COUNT, 6))
pushes[:, 0], pushes[:, 1] = np.sin(TILT) * np.cos(around), np.sin(TILT) * np.sin(around)
pushes[:, 2] = -np.cos(TILT)
# velocity of each contact per joint velocity, from the plan's own programme, which is in its axes
levers = known.joint_map.T.reshape(len(plan.contacts), 3, -1)
jacobians = plan.contacts.frames @ levers
exact = build_force_problem(
    plan.contacts,
    wrench=known.wrench,
    jacobians=jacobians,
    actuation=plan.task.hand.actuation,
    q=plan.q,
    gravity_torque=known.gravity_torque,
)
round_cones = np.array([breaking_along(exact, push).upper for push in pushes])


def promises(cone: Pyramid, sides: int) -> tuple[FloatArray, float, float]:
    """Largest pushes (COUNT,), N; sum of normal forces under half of them, N; time per step, us."""
    loop = ForceLoop(
        plan.contacts,
        edges=sides,
        cone=cone,
        actuation=plan.task.hand.actuation,
    )
    out, grips, times = [], [], []

    def held(push: FloatArray) -> bool:
        step = loop.step(
            known.wrench + push,
            jacobians=jacobians,
            q=plan.q,
            gravity_torque=known.gravity_torque,
        )
        times.append(step.total_s)
        return step.balanced

    for push, limit in zip(pushes, round_cones, strict=True):
        low, high = 0.0, 2.0 * limit
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            low, high = (middle, high) if held(middle * push) else (low, middle)
        out.append(low)
        held(0.5 * limit * push)
        grips.append(float(loop.result.forces[:, 0].sum()))
    return np.array(out), float(np.mean(grips)), 1e6 * float(np.median(times))


print(f"{HAND}, {OBJECT}: round cones hold {np.round(round_cones.min(), 1)} to", end=" ")
print(f"{np.round(round_cones.max(), 1)} N in {COUNT} directions\n")
print("cone            sides   median share   least   largest   grip (N)   us per step")
figure, axis = plt.subplots(figsize=(8, 4.5))
for cone in CONES:
    rows = [promises(cone, k) for k in SIDES]
    shares = np.array([row[0] / round_cones for row in rows])
    for k, share, (_, grip, microseconds) in zip(SIDES, shares, rows, strict=True):
        numbers = f"{np.median(share):14.3f} {share.min():7.3f} {share.max():9.3f}"
        print(f"{cone:15} {k:5d} {numbers} {grip:10.2f} {microseconds:13.0f}")
    axis.fill_between(SIDES, shares.min(axis=1), shares.max(axis=1), alpha=0.3)
    axis.plot(SIDES, np.median(shares, axis=1), marker="o", label=cone)
axis.axhline(1.0, color="grey", linewidth=0.8)
axis.set_xscale("log", base=2)
axis.set_xlabel("sides of the pyramid (-)")
axis.set_ylabel("largest push, as a share of the round cones' (-)")
axis.legend()
figure.savefig(PICTURE, dpi=120)
print(f"\n{PICTURE}: shares over the number of sides")
