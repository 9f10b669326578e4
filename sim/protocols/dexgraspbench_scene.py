"""The world of DexGraspBench, built as its ``src/util/hand_util.py`` builds it.

What differs from our own scene, each with its share of the verdicts:

- The hand's base is free and hangs on a weld to a mocap body, MuJoCo's defaults but for solimp: it
  gives way by millimetres under the forces of the fingers.
- Contacts mix the hand's parameters (5 ms) with MuJoCo's defaults for the object (20 ms): several
  times softer than ours.
- A primitive is a polyhedron, and a mesh its convex pieces, of one density.
- The hand's collision bits and margins are its own.

The constraint Jacobian stays dense (mujoco 4.0.0 factorises sparse Hessians wrongly).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from planner.bridge import compile_spec
from planner.exchange.dexgraspbench import benchmark_pieces
from planner.exchange.dexgraspbench.models import T_model_base
from planner.spatial import SE3, FloatArray, pose_from_wxyz, pose_to_wxyz
from planner.task import GraspTask
from sim.controllers.base import Phase
from sim.gantry import Gantry
from sim.physics import PhysicsOptions
from sim.scene import HAND_PREFIX, OBJECT, Scene, add_looks, dress_hand, drop_options, index_scene

HAND_SOLREF, HAND_SOLIMP = (0.005, 1.0), (0.5, 0.99, 0.0001)
"""Contact parameters that the benchmark gives to all geoms of a hand."""

OBJECT_SOLREF, OBJECT_SOLIMP = (0.02, 1.0), (0.9, 0.95, 0.001)
"""Those of the object, MuJoCo's defaults; a contact has the means of both."""

WELD_SOLIMP = (0.9, 0.95, 0.001, 0.5, 2.0)
"""Impedance of the weld that carries the hand; its solref is MuJoCo's default."""

HANGER = "mocap"
"""Name of the body that the hand is welded to."""


def benchmark_physics() -> PhysicsOptions:
    """The benchmark's options."""
    return PhysicsOptions(timestep=0.004, mu=0.6, mu_torsion=0.02, impratio=10, noslip_iterations=2)


def benchmark_contacts() -> dict[str, list[float]]:
    """Contact parameters between hand and object, as a report states them."""
    solimp = [float(x) for x in np.mean([HAND_SOLIMP, OBJECT_SOLIMP], axis=0)]
    return {
        "solref": [float(x) for x in np.mean([HAND_SOLREF, OBJECT_SOLREF], axis=0)],
        "solimp": [*solimp, 0.5, 2.0],
    }


@dataclass(frozen=True, kw_only=True, eq=False)
class Welded(Gantry):
    """A free hand that a weld keeps at a pose; no servos.

    Attributes:
        T_base_model: World of the hand's model file in the frame of its base: what is free.
    """

    T_base_model: SE3

    def coordinates(self, T_world_base: SE3) -> FloatArray:
        """Position and quaternion w, x, y, z (7,) of the free body for a pose of the base."""
        return np.concatenate(pose_to_wxyz(T_world_base * self.T_base_model))

    def pose(self, coordinates: FloatArray) -> SE3:
        """Pose of the base for position and quaternion (7,) of the free body."""
        return pose_from_wxyz(coordinates[:3], coordinates[3:]) * self.T_base_model.inverse()

    def drive(self, data: Any, phase: Phase, share: float) -> None:
        """Nothing: the mocap body stands where the grasp is."""


def benchmark_scene(task: GraspTask, T_world_base: SE3) -> tuple[Scene, Welded]:
    """The benchmark's world for a task, without table; the second carries the hand.

    Args:
        task: Hand, object and its mass; gravity is off.
        T_world_base: Base pose of the grasp.

    Raises:
        ModelError: MuJoCo refuses the scene.
    """
    physics = benchmark_physics()
    spec = mujoco.MjSpec()
    spec.modelname = f"{task.hand.name}, {task.object.name}"
    physics.apply(spec, np.zeros(3))
    T_base_model = T_model_base(task.hand).inverse()
    _add_hand(spec, task, T_world_base * T_base_model, T_base_model.inverse(), physics)
    _add_object(spec, task)
    add_looks(spec, task, T_world_base, task.hand.neutral)
    for geom in spec.geoms:
        geom.friction[:2] = physics.mu, physics.mu_torsion
        geom.condim = 4
    model = compile_spec(spec, f"the scene of {spec.modelname}")
    free = model.joint(HANGER)
    welded = Welded(
        T_world_base=T_world_base,
        qpos=int(free.qposadr[0]) + np.arange(7),
        dof=int(free.dofadr[0]) + np.arange(6),
        ctrl=np.zeros(0, dtype=np.int64),
        gains=np.zeros((2, 0)),
        T_base_model=T_base_model,
    )
    return index_scene(task, physics, T_world_base, model, welded), welded


def _add_hand(
    spec: Any, task: GraspTask, T_world_model: SE3, T_model_base: SE3, physics: PhysicsOptions
) -> None:
    child = task.hand.new_spec()
    drop_options(child)
    physics.apply(child, np.zeros(3))  # one set of options, or MuJoCo warns of a conflict
    base = child.body(task.hand.description.base_body)
    base.pos, base.quat = pose_to_wxyz(T_model_base)
    for geom in child.geoms:
        geom.solref[:2] = HAND_SOLREF
        geom.solimp[:3] = HAND_SOLIMP
    dress_hand(child, task.hand.mj_model)
    root = spec.worldbody.add_frame().attach_body(child.worldbody, HAND_PREFIX, "")
    root.add_freejoint(name=HANGER)
    position, quaternion = pose_to_wxyz(T_world_model)
    root.pos, root.quat = position, quaternion  # the weld keeps the pose that both begin with
    spec.worldbody.add_body(name=HANGER, mocap=True, pos=position, quat=quaternion)
    weld = spec.add_equality(name=HANGER, type=mujoco.mjtEq.mjEQ_WELD)
    weld.objtype = mujoco.mjtObj.mjOBJ_BODY
    weld.name1, weld.name2 = HANGER, f"{HAND_PREFIX}world"
    weld.solimp = WELD_SOLIMP
    weld.data = [*(0.0,) * 10, 1.0, 0.0]


def _add_object(spec: Any, task: GraspTask) -> None:
    position, quaternion = pose_to_wxyz(task.T_world_object)
    body = spec.worldbody.add_body(name=OBJECT, pos=position, quat=quaternion)
    body.add_freejoint(name=OBJECT)
    shape = task.object.shape
    for k, (vertices, faces) in enumerate(benchmark_pieces(shape)):
        name = OBJECT if k == 0 else f"{OBJECT}/{k}"
        mesh = spec.add_mesh(name=name)
        mesh.uservert, mesh.userface = vertices.ravel(), faces.ravel()
        geom = body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name)
        geom.density = task.object.mass / shape.volume
