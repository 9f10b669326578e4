"""``menagerie``: an object in the scene files that MuJoCo Menagerie ships beside its hands.

Source: https://github.com/google-deepmind/mujoco_menagerie, folders ``shadow_hand`` and
``wonik_allegro``, files ``scene_right.xml`` and ``right_hand.xml``.

The hands ask for elliptic cones and impratio 10, and their fingers for solref 0.005 and solimp 0.5
0.99 0.0001. The object of the scene has a higher priority than the fingers and says nothing of
solref and solimp: so MuJoCo's soft defaults decide, and what the fingers ask for has no effect.
"""

from __future__ import annotations

from sim.physics.options import PhysicsOptions, register_physics

PRESET = register_physics(
    PhysicsOptions(
        name="menagerie",
        timestep=0.002,  # MuJoCo's default
        integrator="implicitfast",  # the LEAP hand asks for it; Euler: see mujoco_default
        cone="elliptic",
        condim=6,
        # of the two scenes the smaller: 0.5 0.01 0.003 beside Shadow, 0.7 0.002 0.002 beside
        # Allegro
        mu=0.5,
        mu_torsion=0.002,
        mu_rolling=0.002,
        impratio=10.0,
        noslip_iterations=0,  # MuJoCo's default
        iterations=100,  # MuJoCo's default
        solref=(0.02, 1.0),
        solimp=(0.9, 0.95, 0.001, 0.5, 2.0),
    )
)
