"""``dexgraspbench``: how DexGraspBench computes.

Source: https://github.com/JYChen18/DexGraspBench at commit 1e7a5a6, ``src/util/hand_util.py`` and
``config/task/eval.yaml``.

The benchmark gives solref 0.005 1 and solimp 0.5 0.99 0.0001 to the geoms of the hand. The object
has the same priority and MuJoCo's defaults, 0.02 1 and 0.9 0.95 0.001: MuJoCo takes the mean of the
two.
"""

from __future__ import annotations

from sim.physics.options import PhysicsOptions, register_physics

PRESET = register_physics(
    PhysicsOptions(
        name="dexgraspbench",
        timestep=0.004,
        integrator="implicitfast",
        cone="elliptic",
        condim=4,
        mu=0.6,
        mu_torsion=0.02,
        mu_rolling=0.0001,  # MuJoCo's default; without effect in 4 dimensions
        impratio=10.0,
        noslip_iterations=2,
        iterations=100,  # MuJoCo's default
        solref=(0.0125, 1.0),
        solimp=(0.7, 0.97, 0.00055, 0.5, 2.0),
    )
)
