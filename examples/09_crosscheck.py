"""Check Pinocchio against MuJoCo on a model, and find what somebody changed in a copy of it.

The first table compares MuJoCo with the Pinocchio model that Opposable builds from it, and with the
one that Pinocchio's own reader makes of the same file. The second compares the model with a copy in
which one link is 1 % heavier and one joint's axis is off by half a degree, and names both.
"""

from __future__ import annotations

import mujoco
import numpy as np

from planner.system.package import models_dir
from sim.crosscheck import compare_models, crosscheck

MODEL = models_dir() / "hands" / "allegro_hand" / "allegro_hand.xml"
CONFIGURATIONS = 5
SEED = 0

report = crosscheck(MODEL, seed=SEED, n_configurations=CONFIGURATIONS)
for column in report.columns:
    print(f"{column.name}: {'agrees' if column.ok else 'differs'}")
    for key, reason in column.causes.items():
        print(f"  {reason} ({sum(d.cause == key for d in column.differences)} differences)")

spec = mujoco.MjSpec.from_file(str(MODEL))
half_a_degree = np.deg2rad(0.5)
spec.body("index_middle").mass *= 1.01
spec.joint("index_1").axis = [np.sin(half_a_degree), np.cos(half_a_degree), 0.0]
changed = compare_models(MODEL, spec, seed=SEED, n_configurations=CONFIGURATIONS)
print("copy agrees" if changed.ok else "copy differs:")
for fault in changed.columns[0].faults:  # the parts themselves, not what follows from them
    print(f"  {fault}")
