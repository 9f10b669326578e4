"""``ForeignScene``: a MuJoCo scene of another project, unchanged, with a hand and an object in it.

It is read, never built or changed: where joints and actuators of the hand stand in it, by their
names; what the object is, by its geoms; how hand and object touch. So planned and measured contacts
go through the same functions as in a scene of ours. Its owner steps it::

    scene = ForeignScene(model, data, "hand.toml", "hammer", table="table_top")
    plan = plan_grasp(scene.task())
    run = ForeignRun(plan, scene, step)  # step(T_world_base, ctrl) makes one of its steps
    if run.grasp():
        run.move(shifted(plan.T_world_base, [0.0, 0.0, 0.1]), 1.0)

What is known of it is the truth in ``data``: joints, poses and contacts without errors.
"""

from __future__ import annotations

from sim.foreign.run import ForeignRun
from sim.foreign.scene import ForeignScene

__all__ = ["ForeignRun", "ForeignScene"]
