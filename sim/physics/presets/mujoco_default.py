"""``mujoco-default``: what MuJoCo computes where a scene says nothing.

Source: the XML reference of MuJoCo, elements ``option`` and ``geom``; the numbers are read from a
fresh ``mujoco.MjSpec`` by a test.
"""

from __future__ import annotations

from sim.physics.options import PhysicsOptions, register_physics

PRESET = register_physics(
    PhysicsOptions(
        name="mujoco-default",
        timestep=0.002,
        # MuJoCo's default is Euler, which takes servo damping explicitly: hands with light fingers
        # and strong dampers diverge (10 of 11 default grasps of the Shadow-type hand), whatever the
        # contacts do; a scene with such servos must ask for this one
        integrator="implicitfast",
        cone="pyramidal",
        condim=3,
        mu=1.0,
        mu_torsion=0.005,  # without effect in 3 dimensions
        mu_rolling=0.0001,
        impratio=1.0,
        noslip_iterations=0,
        iterations=100,
        solref=(0.02, 1.0),
        solimp=(0.9, 0.95, 0.001, 0.5, 2.0),
    )
)
