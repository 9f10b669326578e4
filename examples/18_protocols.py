"""Test a grasp: a benchmark's protocol, then pushes that grow until the object is lost.

Runs DexGraspBench's `fc` test, and two directions of our `forces` under the planned forces alone
and under the closed loop. Beside each stands what the certificate proves: no control could bear
more with these contacts and motors. Prints a table, and tells if the simulation contradicts it.
"""

from __future__ import annotations

from planner import GraspTask, plan_grasp
from sim.protocols import Settings, run_protocol

OBJECT = "cylinder:0.03x0.10"
PUSHES = ("force -z", "torque +x")
SETTINGS = Settings(growth=1.5)  # coarse: a load is half as large again as the one before

plan = plan_grasp(GraspTask.create("allegro_hand", OBJECT), seed=0)

fc = run_protocol(plan, "fc")
physics = fc.physics
print(f"fc: held {sum(o.held for o in fc.outcomes)} of {fc.asked} directions")
print(f"  time step {physics['timestep_s']} s, {physics['cone']} cones", end=", ")
print(f"impratio {physics['impratio']:g}, noslip {physics['noslip_iterations']}")

opened, closed = (
    run_protocol(plan, "forces", controller=name, settings=SETTINGS, only=PUSHES)
    for name in ("feedforward", "impedance")
)
print(f"{'':>10} {'open':>7} {'closed':>7} {'proven':>7}")
for a, b in zip(opened.outcomes, closed.outcomes, strict=True):
    print(f"{a.name:>10} {a.borne:7.3g} {b.borne:7.3g} {a.bound:7.3g} {a.unit}")
    print(f"{'':>10} {a.reason}; {b.reason}")
contradictions = (*opened.contradictions, *closed.contradictions)
print("contradictions:", ", ".join(contradictions) or "none")
