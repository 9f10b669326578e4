"""The lab's step 5: turn a held object by 90 degrees about the vertical.

The lab lets the fingertips circle around the object and hopes; its angle, 2 acos |w|, has neither
axis nor sign, so that a tumble counts as a turn. Here the turn is planned before it is made: poses
of the object with joints and contacts, each force-closed with a margin and clear of collisions,
while tips roll on the object. A closed loop on the measured pose makes it, and what counts is the
signed twist about the axis that was commanded. Prints the plan with how far the pads slide in all,
and over the turn the twist, the tilt off the axis, fingers in contact and closure. Last, a fall on
the side without any turn, by both measures: the lab's calls it turned by 90 degrees.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from planner import manipulation_task, parse_object, plan_manipulation
from planner.spatial import signed_twist
from sim.manipulation import ManipulationTimeline, manipulate
from sim.scene.physics import PhysicsOptions

HAND = "allegro_hand"
OBJECT = "cylinder:0.03x0.08"
UP = np.array([0.0, 0.0, 1.0])
ANGLE = np.deg2rad(90.0)  # about UP
MU, SIM_MU = 0.45, 0.6  # friction that the plan relies on, and that there is (-)
ROWS = 10  # that are printed of the turn
QUICK = ManipulationTimeline(  # all but the turn, s; height in m
    approach=0.4,
    close=0.3,
    squeeze=0.3,
    lift=0.4,
    hold=0.2,
    carry=0.2,
    lower=0.3,
    release=0.1,
    open=0.1,
    retreat=0.1,
    height=0.03,
)

task = manipulation_task(HAND, parse_object(OBJECT), mu=MU)
plan = plan_manipulation(task, axis=UP, angle=ANGLE, seed=0)
print(plan.motion)
report = manipulate(plan, physics=PhysicsOptions(mu=SIM_MU), timeline=QUICK)
log = report.log
turning = log.during("turn")
print("\ntime (s)   turned (deg)   tilt (deg)   fingers   closed")
for i in turning[:: max(1, len(turning) // ROWS)]:
    angles = f"{np.rad2deg(log.turn[i]):12.1f} {np.rad2deg(log.tilt[i]):12.1f}"
    since = log.time[i] - log.time[turning[0]]
    closed = "yes" if log.closed[i] else "no"
    print(f"{since:8.2f} {angles} {log.touching[i]:9d}   {closed}")
end = "dropped" if report.dropped else "not dropped"
print(f"\nturned by {np.rad2deg(report.turned):.1f} degrees, {end}", end=", ")
print(f"at least {report.least_fingers} fingers in contact in the air")
closed = "yes" if report.success_with_closure else "no"
print(f"all of it, with force closure at every sample: {closed}")

fallen = pin.exp3(np.pi / 2 * np.array([1.0, 0.0, 0.0]))
lab = 2 * np.arccos(np.clip(abs(pin.Quaternion(fallen).w), -1, 1))
print(f"fallen on its side: {np.rad2deg(lab):.0f} degrees turned as the lab measures", end=", ")
print(f"{np.rad2deg(signed_twist(fallen, UP)) + 0.0:.0f} about the axis")
