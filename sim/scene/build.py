"""``Scene``: the MuJoCo world of a ``GraspTask``: driven gantry, hand, table, obstacles, object.

The hand hangs on a gantry of six driven joints (``sim.scene.gantry``). A hand on an arm has no
gantry: the arm's root stands fixed, and its own servos carry the hand (``sim.scene.carrier``).

Friction is explicit. MuJoCo mixes the friction of two geoms by their maximum unless one has the
higher priority; here the object decides against the hand (condim 4 unless the physics says
otherwise: sliding and torsion), and table and obstacles decide against the object (condim 6: with
rolling too, so that a ball stays where it is put). So do the other numbers of a contact.

A mesh collides as convex pieces that cover it (``planner.shapes.pieces``) and is
shown as it is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any

import mujoco
import numpy as np
from pinocchio import SE3

from planner.arrays import check_fields
from planner.bridge import compile_spec
from planner.collision.world import TABLE_SIZE
from planner.hands.hand import Hand
from planner.kinematics import HandState
from planner.objects import GraspObject
from planner.shapes import Shape
from planner.shapes.mesh import surface_triangles
from planner.shapes.solid import solid_deviation, solid_geoms
from planner.spatial import FloatArray, IntArray, pose_to_wxyz
from planner.task import GraspTask
from sim.scene.gantry import GANTRY, Gantry, add_gantry, tuned_gantry
from sim.scene.physics import CONTACT_SOLREF, PRESETS, AnyPhysics, PhysicsOptions
from sim.show.camera import OBJECT_MATERIAL, Subject, add_object_material, add_scenery
from sim.show.dress import HIDDEN_GROUP, dress_hand

__all__ = [
    "HAND_PREFIX",
    "OBJECT",
    "TABLE",
    "PhysicsOptions",
    "Scene",
    "Truth",
    "add_looks",
    "add_solid_object",
    "build_scene",
    "dress_hand",
    "drop_options",
    "hand_spec",
    "index_scene",
    "scene_spec",
]

HAND_PREFIX = "hand/"
"""Prefix of every name of the hand's model in the scene."""

OBJECT, TABLE, SUPPORT = "object", "table", "support"
"""Names of bodies in the scene, and of the constraint that holds an object without a table."""

WORLD_BIT = 1 << 30
"""Bit of contype and conaffinity by which object, table and obstacles meet the hand and each other.
The other bits are the hand model's own and decide which of its links touch each other."""

OBSTACLE_PREFIX = "obstacle/"
"""Prefix of the names of obstacles, so that none is taken for something else."""

ARM_VIEW = 2.3
"""From how much farther away a hand on an arm is shown: an arm of 1 m beside the object."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """A compiled scene with its index maps; make one with ``build_scene``.

    Attributes:
        task: What it shows.
        physics: How it computes.
        T_world_base: Base pose of the grasp.
        model: Compiled ``mujoco.MjModel``.
        hand_qpos: (nq,), where the hand's joints, in the order of ``hand.joint_names``, stand in
            ``data.qpos``.
        hand_dof: (nq,), where they stand in ``data.qvel``.
        hand_ctrl: (nu,), where the hand's actuators, in the order of ``hand.actuation.names``,
            stand in ``data.ctrl``.
        arm_ctrl: (n,), those of them that drive the joints of the arm that carries the hand.
        gantry: What carries the hand; None for a hand on an arm.
        object_qpos: (7,), the object's pose in ``data.qpos``: position, quaternion w, x, y, z.
        object_dof: (6,), its velocity in ``data.qvel``: linear in world axes, angular in its own.
        object_body: Body id of the object.
        base_body: Body id of the hand's base.
        palm_body: Body id of the hand's palm.
        finger_of_geom: Colliding geom id of the hand -> name of the finger or link, "" for a palm
            that takes no part.
        support: Equality id that holds the object before the lift, -1 where a table does.
        deviation: How far (m) the geoms of the object reach out of its true shape at most: 0 for a
            primitive, measured for the convex pieces of a mesh.
    """

    task: GraspTask
    physics: PhysicsOptions
    T_world_base: SE3
    model: Any
    hand_qpos: IntArray
    hand_dof: IntArray
    hand_ctrl: IntArray
    arm_ctrl: IntArray
    gantry: Gantry | None
    object_qpos: IntArray
    object_dof: IntArray
    object_body: int
    base_body: int
    palm_body: int
    finger_of_geom: Mapping[int, str]
    support: int
    deviation: float

    @cached_property
    def object_geoms(self) -> frozenset[int]:
        """Ids of the geoms of the object."""
        body: IntArray = self.model.geom_bodyid
        return frozenset(np.flatnonzero(body == self.object_body).tolist())

    @cached_property
    def body_of_geom(self) -> list[int]:
        """Body id of every geom, as plain numbers."""
        bodies: list[int] = self.model.geom_bodyid.tolist()
        return bodies

    @cached_property
    def root_of_body(self) -> list[int]:
        """Root of the tree of every body, as plain numbers."""
        roots: list[int] = self.model.body_rootid.tolist()
        return roots

    @cached_property
    def pyramids(self) -> bool:
        """Whether friction cones are pyramids, whose edges have a force each; else elliptic."""
        return bool(self.model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL)

    def finger_numbers(self, fingers: tuple[str, ...]) -> IntArray:
        """Place among some fingers of the one that each geom belongs to (ngeom,), -1 for none."""
        if fingers not in self._finger_numbers:
            numbers = np.full(self.model.ngeom, -1, dtype=np.int64)
            for geom, name in self.finger_of_geom.items():
                if name in fingers:
                    numbers[geom] = fingers.index(name)
            self._finger_numbers[fingers] = numbers
        return self._finger_numbers[fingers]

    @cached_property
    def _finger_numbers(self) -> dict[tuple[str, ...], IntArray]:
        return {}

    def posed(self, q: FloatArray, T_world_base: SE3, T_world_object: SE3) -> FloatArray:
        """State (qpos) with the hand at q (nq,) and a base pose, and the object at a pose."""
        qpos = np.array(self.model.qpos0)
        qpos[self.hand_qpos] = q
        if self.gantry is not None:
            qpos[self.gantry.qpos] = self.gantry.coordinates(T_world_base)
        qpos[self.object_qpos] = np.concatenate(pose_to_wxyz(T_world_object))
        return qpos

    def start(self, q: FloatArray, T_world_base: SE3) -> Any:
        """Fresh ``mujoco.MjData`` at rest: hand at q (nq,) and a base pose, object at its place."""
        data = mujoco.MjData(self.model)
        data.qpos[:] = self.posed(q, T_world_base, self.task.T_world_object)
        mujoco.mj_forward(self.model, data)
        return data

    @property
    def subject(self) -> Subject:
        """What pictures of it are about: object, palm and fingers."""
        body_of = self.model.geom_bodyid
        pads = [f.pad.geom for f in self.task.fingers]
        links = {int(body_of[g]) for g, finger in self.finger_of_geom.items() if finger}
        return Subject(
            object_body=self.object_body,
            tips=tuple(int(body_of[self.model.geom(HAND_PREFIX + pad).id]) for pad in pads),
            bodies=(self.object_body, *sorted(links | {self.palm_body})),
        )

    def body_pose(self, data: Any, body: int) -> SE3:
        """Pose of a body in the world."""
        return SE3(data.xmat[body].reshape(3, 3), data.xpos[body])

    def object_twist(self, data: Any) -> FloatArray:
        """Linear velocity (m/s) of the object's centre and angular velocity (rad/s), (6,), world.

        MuJoCo keeps the angular velocity of a free body in the body's own axes.
        """
        linear, angular = np.split(data.qvel[self.object_dof], 2)
        turn = data.xmat[self.object_body].reshape(3, 3)
        return np.concatenate([linear, turn @ angular])

    def T_palm_object(self, data: Any) -> SE3:
        """Pose of the object in the palm."""
        T_world_palm = self.body_pose(data, self.palm_body)
        return T_world_palm.inverse() * self.body_pose(data, self.object_body)

    def release(self, data: Any) -> None:
        """Let go of an object that no table carries."""
        if self.support >= 0:
            data.eq_active[self.support] = 0


@dataclass(frozen=True, kw_only=True, eq=False)
class Truth:
    """What there really is, where a task holds a belief: the object of a cloud, say.

    The body of the object in the scene keeps the frame of the belief. So the pose that is read of
    it is the believed one at first, and follows every true motion of the object.

    Attributes:
        object: The object, with its true mass.
        T_world_object: Where it is when a trial begins.
        table_height: z of the table's top, m; None for no table.
    """

    object: GraspObject
    T_world_object: SE3
    table_height: float | None = 0.0

    def __post_init__(self) -> None:
        """Check the height."""
        check_fields(self, what="truth: ", unit="m")


def build_scene(
    task: GraspTask,
    *,
    T_world_base: SE3,
    q: FloatArray | None = None,
    physics: AnyPhysics | None = None,
    change: Callable[[Any], None] | None = None,
    truth: Truth | None = None,
    hinges: FloatArray | None = None,
) -> Scene:
    """Assemble and compile the scene of a task.

    Args:
        task: Hand, object and its pose, table, obstacles, gravity.
        T_world_base: Base pose at which the gantry's joints read zero: that of the grasp.
        q: Joints (nq,) at the grasp, from which the camera takes its place; zero if None.
        physics: How MuJoCo computes, or the name of a preset; defaults if None.
        change: Changes the ``mujoco.MjSpec`` to a world that differs from the task's; not if None.
        truth: Object and table that there really are; those of the task if None.
        hinges: Axes (3, 3) of the gantry's hinges in its columns, world; the world's if None.

    Raises:
        ModelError: MuJoCo refuses the scene.
    """
    hinges = np.eye(3) if hinges is None else hinges
    physics = PRESETS.given(physics)
    hand = task.hand
    truth = truth or _believed(task)
    spec = scene_spec(task, T_world_base, physics, truth=truth, hinges=hinges)
    if change is not None:
        change(spec)
    add_looks(spec, task, T_world_base, hand.neutral if q is None else q)
    model = compile_spec(spec, f"the scene of {spec.modelname}")
    gantry = None
    if not hand.on_arm:
        gantry = tuned_gantry(model, T_world_base, truth.object.mass, OBJECT, hinges)
    return index_scene(task, physics, T_world_base, model, gantry, truth.object.shape)


def _believed(task: GraspTask) -> Truth:
    """A world as the task has it."""
    return Truth(
        object=task.object, T_world_object=task.T_world_object, table_height=task.table_height
    )


def scene_spec(
    task: GraspTask,
    T_world_base: SE3,
    physics: PhysicsOptions,
    *,
    with_gantry: bool = True,
    truth: Truth | None = None,
    hinges: FloatArray | None = None,
) -> Any:
    """The ``mujoco.MjSpec`` of a task's scene, not compiled and without what is only looked at.

    Args:
        task: Hand, object and its pose, table, obstacles, gravity.
        T_world_base: Base pose of the grasp.
        physics: How MuJoCo computes.
        with_gantry: Whether a gantry carries the hand; else its base stands fixed in the world, as
            the root of an arm does.
        truth: Object and table that there really are; those of the task if None.
        hinges: Axes (3, 3) of the gantry's hinges in its columns, world; the world's if None.
    """
    spec = mujoco.MjSpec()
    spec.modelname = f"{task.hand.name}, {task.object.name}"
    physics.apply(spec, task.gravity)
    truth = truth or _believed(task)
    gantry = _add_hand(spec, task, T_world_base, physics)
    if with_gantry and not task.hand.on_arm:
        add_gantry(spec, gantry, task.hand.mj_model, np.eye(3) if hinges is None else hinges)
    _add_object(spec, task, truth, physics)
    _add_surroundings(spec, task, truth.table_height, physics)
    return spec


def _add_hand(spec: Any, task: GraspTask, T_world_base: SE3, physics: PhysicsOptions) -> Any:
    """Add the hand on a body, which is returned."""
    position, quaternion = pose_to_wxyz(T_world_base)
    gantry = spec.worldbody.add_body(name=GANTRY, pos=position)
    child = hand_spec(task.hand, physics, task.gravity)
    dress_hand(child, task.hand.mj_model)
    spec.attach(child, prefix=HAND_PREFIX, frame=gantry.add_frame(quat=quaternion))
    return gantry


def hand_spec(hand: Hand, physics: PhysicsOptions, gravity: FloatArray) -> Any:
    """The hand's ``mujoco.MjSpec`` with the physics of a scene, its contacts those of an object.

    Args:
        hand: The hand.
        physics: How MuJoCo computes.
        gravity: (3,), m/s2, world.
    """
    spec = hand.new_spec()
    drop_options(spec)
    physics.apply(spec, gravity)
    for geom in spec.geoms:
        geom.friction = physics.friction
        geom.priority = 0
        # forces at a distance are not what contacts are judged by
        geom.margin = geom.gap = 0.0
        if geom.contype or geom.conaffinity:
            geom.contype &= ~WORLD_BIT
            geom.conaffinity |= WORLD_BIT
    return spec


def add_looks(spec: Any, task: GraspTask, T_world_base: SE3, q: FloatArray) -> None:
    """Add what is only to be looked at, the heading mark of the object with it.

    Args:
        spec: ``mujoco.MjSpec`` with the object.
        task: What it shows.
        T_world_base: Base pose of the grasp.
        q: Joints (nq,) at the grasp.
    """
    hand = task.hand
    add_object_material(spec)
    for geom in spec.body(OBJECT).geoms:
        geom.material = OBJECT_MATERIAL
    T_world_palm = T_world_base * HandState(hand, q).T_base_palm
    add_scenery(
        spec,
        task.T_world_object.translation,
        T_world_palm.rotation @ hand.palm_normal,
        task.table_height,
        ARM_VIEW if hand.on_arm else 1.0,
    )


def drop_options(spec: Any) -> None:
    """Forget how a model wants to be computed: the scene decides, and MuJoCo warns of conflicts."""
    fresh = mujoco.MjSpec()
    for name in dir(fresh.option):
        if not name.startswith("_"):
            setattr(spec.option, name, getattr(fresh.option, name))
    for name in dir(fresh):
        if name in ("njmax", "nconmax") or name.startswith("nuser_"):
            setattr(spec, name, getattr(fresh, name))


def add_solid_object(
    spec: Any,
    item: GraspObject,
    T_world_object: SE3,
    physics: PhysicsOptions,
    inside: SE3 | None = None,
) -> Any:
    """Add the free body of an object with its mass and colliding geoms; the body.

    Args:
        spec: ``mujoco.MjSpec`` to add to.
        item: The object.
        T_world_object: Its pose.
        physics: How MuJoCo computes.
        inside: Its pose in the frame of the body; the same frame if None.
    """
    inside = SE3.Identity() if inside is None else inside
    position, quaternion = pose_to_wxyz(T_world_object * inside.inverse())
    body = spec.worldbody.add_body(name=OBJECT, pos=position, quat=quaternion)
    body.add_freejoint(name=OBJECT)
    inertia = inside.rotation @ item.shape.inertia(item.mass) @ inside.rotation.T
    body.explicitinertial = True
    body.mass = item.mass
    body.ipos = inside.translation
    body.fullinertia = [*np.diag(inertia), inertia[0, 1], inertia[0, 2], inertia[1, 2]]
    for k, part in enumerate(solid_geoms(item.shape)):
        name = OBJECT if k == 0 else f"{OBJECT}/{k}"
        geom = body.add_geom(name=name, condim=physics.condim, priority=1)
        geom.pos, geom.quat = pose_to_wxyz(inside * part.T_object_geom)
        if part.vertices is not None and part.faces is not None:
            _add_mesh(spec, name, part.vertices, part.faces)
            geom.meshname = name
            geom.group = HIDDEN_GROUP  # the true mesh is shown instead
        _solid(geom, part.kind, part.size, physics)
    return body


def _add_object(spec: Any, task: GraspTask, truth: Truth, physics: PhysicsOptions) -> None:
    item, position = truth.object, task.T_world_object.translation
    inside = SE3.Identity()
    if truth.T_world_object != task.T_world_object:
        inside = task.T_world_object.inverse() * truth.T_world_object
    body = add_solid_object(spec, item, truth.T_world_object, physics, inside)
    if body.geoms[0].group == HIDDEN_GROUP:
        _add_picture(spec, body, item.shape, inside)
    if truth.table_height is None:
        weld = spec.add_equality(name=SUPPORT, type=mujoco.mjtEq.mjEQ_WELD)
        weld.objtype = mujoco.mjtObj.mjOBJ_BODY
        weld.name1 = OBJECT
        # Anchor (in the world, the second body), relative pose as it is, torque scale.
        weld.data = [*position, *(0.0,) * 7, 1.0, 0.0]
        weld.solref = CONTACT_SOLREF


def _add_mesh(spec: Any, name: str, vertices: FloatArray, faces: IntArray) -> None:
    mesh = spec.add_mesh(name=name)
    mesh.uservert, mesh.userface = vertices.ravel(), faces.ravel()


def _add_picture(spec: Any, body: Any, shape: Shape, T_body_object: SE3) -> None:
    """The true triangles, to be seen only."""
    name = f"{OBJECT}/seen"
    _add_mesh(spec, name, *surface_triangles(shape))
    spec.mesh(name).inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    geom = body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_MESH)
    geom.meshname = name
    geom.pos, geom.quat = pose_to_wxyz(T_body_object)
    geom.contype = geom.conaffinity = 0
    geom.density = 0.0


def _add_surroundings(
    spec: Any, task: GraspTask, table_height: float | None, physics: PhysicsOptions
) -> None:
    x, y, _ = task.T_world_object.translation
    if table_height is not None:
        half = np.array(TABLE_SIZE) / 2
        table = spec.worldbody.add_body(name=TABLE, pos=(x, y, table_height - half[2]))
        geom = table.add_geom(name=TABLE, condim=6, priority=2, rgba=(0.88, 0.87, 0.85, 1.0))
        _solid(geom, "box", tuple(half), physics)
    for obstacle in task.obstacles:
        position, quaternion = pose_to_wxyz(obstacle.T_world_obstacle)
        name = OBSTACLE_PREFIX + obstacle.name
        body = spec.worldbody.add_body(name=name, pos=position, quat=quaternion)
        geom = body.add_geom(name=name, condim=6, priority=2, rgba=(0.5, 0.55, 0.6, 1.0))
        _solid(geom, "box", tuple(obstacle.size / 2), physics)


def _solid(geom: Any, kind: str, size: tuple[float, ...], physics: PhysicsOptions) -> None:
    geom.type = getattr(mujoco.mjtGeom, f"mjGEOM_{kind.upper()}")
    geom.contype = geom.conaffinity = WORLD_BIT
    if size:
        geom.size = [*size, *(0.0,) * (3 - len(size))]
    geom.friction = physics.friction
    geom.solref = physics.solref
    geom.solimp = physics.solimp


def index_scene(
    task: GraspTask,
    physics: PhysicsOptions,
    T_world_base: SE3,
    model: Any,
    gantry: Gantry | None,
    shape: Shape | None = None,
) -> Scene:
    """Find the parts of a compiled scene, whose hand has the prefix, by their names.

    The shape is that of the object in it, if it is not the task's.
    """
    hand = task.hand
    hand_joints = [model.joint(HAND_PREFIX + name) for name in hand.joint_names]
    hand_ctrl = np.array([model.actuator(HAND_PREFIX + n).id for n in hand.actuation.names])
    free = model.joint(OBJECT)
    return Scene(
        task=task,
        physics=physics,
        T_world_base=T_world_base,
        model=model,
        hand_qpos=np.array([int(j.qposadr[0]) for j in hand_joints]),
        hand_dof=np.array([int(j.dofadr[0]) for j in hand_joints]),
        hand_ctrl=hand_ctrl,
        arm_ctrl=hand_ctrl[hand.actuation.moment[:, hand.arm_index].any(axis=1)],
        gantry=gantry,
        object_qpos=int(free.qposadr[0]) + np.arange(7),
        object_dof=int(free.dofadr[0]) + np.arange(6),
        object_body=int(model.body(OBJECT).id),
        base_body=int(model.body(HAND_PREFIX + hand.description.base_body).id),
        palm_body=int(model.body(HAND_PREFIX + hand.description.palm_body).id),
        finger_of_geom=_finger_of_geom(task, model),
        support=int(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_EQUALITY, SUPPORT)),
        deviation=solid_deviation(task.object.shape if shape is None else shape),
    )


def _finger_of_geom(task: GraspTask, model: Any) -> Mapping[int, str]:
    return MappingProxyType(
        {
            int(model.geom(HAND_PREFIX + g.name).id): task.part_of_body.get(g.body, "")
            for g in task.hand.geometries
        }
    )
