"""``ForeignScene``: hand, object, table and obstacles, read from somebody's compiled model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin

from planner.bridge.object_body import object_in_model
from planner.errors import NotFoundError, TaskError
from planner.hand_loading import load_hand
from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.objects import GraspObject, NeededWrench, Region, TouchRegion
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask, Obstacle
from planner.tolerances import DEFAULT_MU
from sim.scene.build import Scene
from sim.scene.physics import PhysicsOptions
from sim.show.camera import Subject

FRICTION_LEFT = 5 / 6
"""Share of a scene's friction that planning relies on at most (-): 0.5 of 0.6, as at home."""

SUNK = 0.002
"""How far (m) an object at rest may have sunk into what carries it: contacts yield."""

OFF_CENTER = 0.001
"""Distance (m) of the model's centre of mass from that of a uniform solid from which on the moment
of the weight about the latter is a needed wrench."""

WEIGHT = "weight"
"""Name of that wrench."""

REACHED, REACHED_RAD = 0.001, 0.01
"""How near (m, rad) a pose an arm has reached it."""

REACH_STEPS, DAMPING = 200, 1e-3
"""Iterations of its inverse kinematics, and their damping (m2)."""

ONE_AXIS = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
"""Joints of one coordinate."""

FREE = np.array([[-np.inf], [np.inf]])
"""Range of a joint without limits."""

EDGE = 0.001
"""How far (m) the bounds of a geom are widened, so that contacts on its faces lie inside."""

SAME_HAND, SAME_HAND_RAD = 0.001, 0.01
"""How far (m, rad) a link or a joint's axis may be from where the hand's own model has it."""

ACTUATOR_PARTS = ("gainprm", "biasprm", "ctrllimited", "ctrlrange", "forcelimited", "forcerange")
"""What an actuator of the scene has in common with that of the hand's own model."""

INDEPENDENT = 0.01
"""Least singular value (-) of three axes of joints from which on they count as three directions."""

LEVEL = 0.9999
"""Least vertical part (-) of the normal of a table's top."""

READ = ("hand", "object", "T_world_object", "table_height", "obstacles", "gravity")
"""Arguments of a task that the scene gives."""


class ForeignScene:
    """A scene as it is now.

    Attributes:
        model: The ``mujoco.MjModel``, as its owner compiled it.
        data: The ``mujoco.MjData`` that its owner steps.
        hand: The hand in it, read from its model.
        object: The object: axes of its body, origin at the centre of mass of a uniform solid.
        object_body: Body id of the object: the free one.
        parts: Ids of its bodies: that one and those below it.
        T_body_object: Pose of the object in its body.
        center: Centre of mass (3,) of the object in the model, object frame, m.
    """

    def __init__(
        self,
        model: Any,
        data: Any,
        hand: Hand | str | Path,
        object: str,
        *,
        table: str | None = None,
        obstacles: Sequence[str] = (),
        touch: Sequence[str] = (),
        prefix: str = "",
        jointed: bool = False,
    ) -> None:
        """Find hand and object in a scene.

        Args:
            model: The ``mujoco.MjModel``.
            data: Its ``mujoco.MjData``, with its kinematics computed.
            hand: The hand, or its ``hand.toml``: that of the model that was attached to the scene,
                or of the scene itself (``opposable hands SCENE --base-body PALM --describe``).
            object: Name of the free body to grasp. Bodies below it are part of the object, as if
                their joints were fixed where they are now.
            table: Name of the plane or box that carries it, or of a body which that is the only
                colliding geom of; None for none.
            obstacles: Names of boxes that hand and object must not touch; as of the table.
            touch: Names of the object's geoms in whose bounds fingers may touch it; all if none.
            prefix: What the names of the hand begin with in the scene and not in its description.
            jointed: The object may be held by joints of its own (a screw, a wheel): it is planned
                for as if it were free.

        Raises:
            NotFoundError: The scene has no such body, geom, joint or actuator.
            TaskError: The object is not free, the hand is another than the scene's, or the
                kinematics are not computed.
            PlannerError: Hand or object cannot be read.
        """
        self.model, self.data, self._prefix = model, data, prefix
        self.hand = hand if isinstance(hand, Hand) else load_hand(hand)
        what = f"body {object!r} of the scene"
        self.object_body = body = _id(model, "body", object)
        self._check_free(what, jointed)
        if not data.xmat[body].any():
            raise TaskError(
                "the kinematics of the scene are not computed; call mujoco.mj_forward(model, data)"
            )
        self.parts = np.flatnonzero(model.body_rootid == model.body_rootid[body])
        here = self.pose(body)
        below = [part for part in self.parts.tolist() if part != body]
        frozen = {part: here.actInv(self.pose(part)) for part in below}
        read = object_in_model(model, object, what, frozen=frozen, hulls=True)
        self.T_body_object, self.center = read.T_body_object, read.center
        region = None
        if touch:
            region = TouchRegion(allowed=tuple(self._bounds(name) for name in touch))
        self.object = GraspObject(name=object, shape=read.shape, mass=read.mass, touch=region)
        self._table = None if table is None else _solid(model, table)
        self._obstacles = {name: _solid(model, name) for name in obstacles}
        self._base = self._id("body", self.hand.description.base_body)
        self._joints = [self._id("joint", name) for name in self.hand.joint_names]
        self._ctrl = np.array([self._id("actuator", n) for n in self.hand.actuation.names])
        self._check_hand()

    @property
    def T_world_object(self) -> SE3:
        """Pose of the object now."""
        return self.pose(self.object_body) * self.T_body_object

    @property
    def T_world_base(self) -> SE3:
        """Pose of the hand's base now: of its body as it is where the hand's joints are zero."""
        pose = self.pose(self._base)
        first, number = self.model.body_jntadr[self._base], self.model.body_jntnum[self._base]
        if not np.isin(self._joints, first + np.arange(number)).any():
            return pose
        return pose * _pose(self._posed().body(self.hand.description.base_body)).inverse()

    @property
    def q(self) -> FloatArray:
        """The hand's joints (nq,) now, in the order of ``hand.joint_names``."""
        return np.array(self.data.qpos[self.model.jnt_qposadr[self._joints]])

    def _id(self, kind: str, name: str) -> int:
        """Id of a part of the hand."""
        return _id(self.model, kind, self._prefix + name)

    def pose(self, body: int) -> SE3:
        """Pose of a body now."""
        return _pose(self.data.body(body))

    def reaches(self, T_world_base: SE3) -> bool:
        """Whether what carries the hand can bring its base to a pose: by all joints above its own.

        Damped least squares from the posture of now, within the joints' ranges, while the hand's
        own stay as they are; what is in the way is not looked at.

        Raises:
            TaskError: A joint above the hand's is no hinge or slide, or there is none.
        """
        model, data, base = self.model, mujoco.MjData(self.model), self._base
        data.qpos[:] = self.data.qpos
        data.mocap_pos[:], data.mocap_quat[:] = self.data.mocap_pos, self.data.mocap_quat
        joints: list[int] = []
        body = base
        while body:
            first = int(model.body_jntadr[body])
            joints += range(first, first + int(model.body_jntnum[body])) if first >= 0 else ()
            body = int(model.body_parentid[body])
        joints = [joint for joint in joints if joint not in self._joints]
        if not joints or not np.isin(model.jnt_type[joints], ONE_AXIS).all():
            raise TaskError(
                f"{self.hand.name} is not carried by hinges and slides alone; reaches() knows no "
                "other carrier: decide for yourself what yours reaches"
            )
        at, dof = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
        low, high = np.where(
            model.jnt_limited[joints].astype(bool), model.jnt_range[joints].T, FREE
        )
        # joints of the hand may move the base's body in its base
        goal = T_world_base * self.T_world_base.actInv(self.pose(base))
        jacobian, error, quat = np.zeros((6, model.nv)), np.zeros(6), np.zeros(4)
        for _ in range(REACH_STEPS):
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            now = _pose(data.body(base))
            mujoco.mju_mat2Quat(quat, (goal.rotation @ now.rotation.T).ravel())
            mujoco.mju_quat2Vel(error[3:], quat, 1.0)
            error[:3] = goal.translation - now.translation
            if np.linalg.norm(error[:3]) < REACHED and np.linalg.norm(error[3:]) < REACHED_RAD:
                return True
            mujoco.mj_jacBody(model, data, jacobian[:3], jacobian[3:], base)
            j = jacobian[:, dof]
            step = j.T @ np.linalg.solve(j @ j.T + DAMPING * np.eye(6), error)
            data.qpos[at] = np.clip(data.qpos[at] + step, low, high)
        return False

    def task(self, *, mu: float | None = None, **changes: Any) -> GraspTask:
        """The task of grasping the object where it is now.

        Args:
            mu: Sliding friction that planning may rely on (-); what the scene has at most, with a
                reserve, and never more than planning's own, if None.
            changes: Further arguments of ``GraspTask.create``.

        Raises:
            TaskError: The object stands on nothing, an argument is the scene's to give, or the task
                cannot work.
        """
        if given := sorted(changes.keys() & set(READ)):
            raise TaskError(f"{', '.join(given)} of the task is read from the scene; leave it out")
        if mu is None:
            mu = min(DEFAULT_MU, FRICTION_LEFT * self._least_friction())
        gravity, pose = np.array(self.model.opt.gravity), self.T_world_object
        needed = list(changes.pop("needed", ()))
        if np.linalg.norm(self.center) > OFF_CENTER:
            up = pose.rotation.T @ (-self.object.mass * gravity)
            needed.append(
                NeededWrench(name=WEIGHT, torque=tuple(np.cross(self.center, up).tolist()))
            )
        table = None
        if self._table is not None:
            lowest = float(pose.translation[2] - self.object.shape.support(-pose.rotation[2]))
            table = self._top(self._table)
            table = lowest if table - SUNK < lowest < table else table
        return GraspTask.create(
            self.hand,
            self.object,
            T_world_object=pose,
            table_height=table,
            obstacles=[
                Obstacle(
                    name=name, size=self._box(geom), T_world_obstacle=_pose(self.data.geom(geom))
                )
                for name, geom in self._obstacles.items()
            ],
            gravity=gravity,
            mu=mu,
            needed=needed,
            **changes,
        )

    def for_task(self, task: GraspTask, period: float) -> Scene:
        """As a scene of ours: what simulations, controllers and contacts are read by.

        Args:
            task: Of this scene.
            period: Time (s) from one of its owner's steps to the next.
        """
        model, hand = self.model, self.hand
        joint = int(model.body_jntadr[self.object_body])
        part_of = task.part_of_body
        parts = {self._id("body", g.body): part_of.get(g.body, "") for g in hand.geometries}
        body_of = model.geom_bodyid.tolist()
        collides = model.geom_contype.astype(bool) | model.geom_conaffinity.astype(bool)
        return _Seen(
            foreign=self,
            task=task,
            physics=PhysicsOptions(name="foreign", timestep=period),
            T_world_base=self.T_world_base,
            model=model,
            hand_qpos=model.jnt_qposadr[self._joints],
            hand_dof=model.jnt_dofadr[self._joints],
            hand_ctrl=self._ctrl,
            arm_ctrl=np.zeros(0, dtype=np.int64),
            gantry=None,
            # of slides and hinges there are six coordinates, which are no pose
            object_qpos=int(model.jnt_qposadr[joint]) + np.arange(7 if self._one_joint else 0),
            object_dof=int(model.jnt_dofadr[joint])
            + np.arange(min(6, model.body_dofnum[self.object_body])),
            object_body=self.object_body,
            base_body=self._base,
            palm_body=self._id("body", hand.description.palm_body),
            finger_of_geom=MappingProxyType(
                {int(g): parts[b] for g in np.flatnonzero(collides) if (b := body_of[g]) in parts}
            ),
            support=-1,
            deviation=0.0,
        )

    def tips(self, fingers: Sequence[Finger]) -> tuple[int, ...]:
        """Body ids of what carries the pads of some fingers."""
        body_of = {g.name: g.body for g in self.hand.geometries}
        return tuple(self._id("body", body_of[f.pad.geom]) for f in fingers)

    def _check_free(self, what: str, jointed: bool) -> None:
        """Refuse an object that is not free: by one joint, or by three slides and three hinges."""
        model, body = self.model, self.object_body
        own = np.flatnonzero(model.jnt_bodyid == body)
        kinds, axes = model.jnt_type[own], model.jnt_axis[own]
        self._one_joint = kinds.tolist() == [mujoco.mjtJoint.mjJNT_FREE]
        ranks = [np.linalg.matrix_rank(axes[kinds == kind], INDEPENDENT) for kind in ONE_AXIS]
        six = len(own) == 6 and ranks == [3, 3]
        held = jointed and 0 < len(own) <= 6
        if not (self._one_joint or held) and (not six or model.body_parentid[body]):
            raise TaskError(
                f"{what} has no free joint, nor three slides and three hinges, either along three "
                "independent axes; name the body that moves freely, or say jointed=True"
            )

    def _posed(self) -> Any:
        """The hand's own model as its joints are now, with its kinematics computed."""
        own = self.hand.mj_model
        posed = mujoco.MjData(own)
        for part, value in zip(self.hand.joint_names, self.q, strict=True):
            posed.qpos[own.joint(part).qposadr] = value
        mujoco.mj_kinematics(own, posed)
        return posed

    def _check_hand(self) -> None:
        """Refuse a hand whose links, axes or actuators are other than the scene's."""
        own, name = self.hand.mj_model, self.hand.name
        again = "describe the hand of this scene (opposable hands SCENE --describe)"
        for part in self.hand.actuation.names:
            there = self.model.actuator(self._prefix + part)
            for key in ACTUATOR_PARTS:
                mine, its = (np.asarray(getattr(a, key)) for a in (own.actuator(part), there))
                if not np.allclose(mine, its, rtol=1e-6, atol=1e-9):
                    raise TaskError(
                        f"actuator {part} of the scene has {key} {its.tolist()}, that of {name} "
                        f"{mine.tolist()}: {again}"
                    )
        posed, T_world_body = self._posed(), self.pose(self._base)
        T_own = _pose(posed.body(self.hand.description.base_body))
        for part in sorted({g.body for g in self.hand.geometries}):
            there = T_world_body.actInv(self.pose(self._id("body", part)))
            far = T_own.actInv(_pose(posed.body(part))).actInv(there)
            off, turned = np.linalg.norm(far.translation), np.linalg.norm(pin.log3(far.rotation))
            if off > SAME_HAND or turned > SAME_HAND_RAD:
                raise TaskError(
                    f"{part} of the scene is {1e3 * off:.1f} mm and {np.rad2deg(turned):.1f} "
                    f"degrees from where {name} has it: {again}"
                )
        for part, joint in zip(self.hand.joint_names, self._joints, strict=True):
            axis = T_world_body.rotation.T @ self.data.xaxis[joint]
            mine = T_own.rotation.T @ posed.joint(part).xaxis
            if np.linalg.norm(axis - mine) > SAME_HAND_RAD:
                raise TaskError(
                    f"joint {part} of the scene has axis {axis.round(3).tolist()}, that of {name} "
                    f"{mine.round(3).tolist()}, in base axes: {again}"
                )

    def _least_friction(self) -> float:
        """Least sliding friction (-) between the object and a fingertip."""
        bodies = self.tips(tuple(self.hand.fingers.values()))
        of_body = self.model.geom_bodyid
        a, b = np.isin(of_body, self.parts), np.isin(of_body, bodies)
        first, second = self.model.geom_priority[a][:, None], self.model.geom_priority[b]
        mine, other = self.model.geom_friction[a, :1], self.model.geom_friction[b, 0]
        weaker = np.where(first > second, mine, np.where(first < second, other, np.inf))
        return float(np.minimum(weaker, np.maximum(mine, other)).min())

    def _bounds(self, name: str) -> Region:
        """The box, in the object's axes, around a geom of the object."""
        model, geom = self.model, _id(self.model, "geom", name)
        if model.geom_bodyid[geom] not in self.parts:
            raise TaskError(
                f"geom {name!r} does not belong to the object; name geoms of its bodies"
            )
        pose = self.T_world_object.actInv(_pose(self.data.geom(geom)))
        local, half = np.split(model.geom_aabb[geom], 2)
        middle, reach = pose.act(local), np.abs(pose.rotation) @ half + EDGE
        return Region(name=name, lower=tuple(middle - reach), upper=tuple(middle + reach))

    def _top(self, geom: int) -> float:
        """Height (m) of the top of a plane or of a box.

        Raises:
            TaskError: It is neither, or not level.
        """
        height, up = float(self.data.geom_xpos[geom][2]), self.data.geom_xmat[geom][6:]
        flat = self.model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE
        if (up[2] if flat else np.abs(up).max()) < LEVEL:
            raise TaskError(
                f"geom {self.model.geom(geom).name!r} is not level; a table of planning is: leave "
                "it out, or name a box among the obstacles"
            )
        if flat:
            return height
        return height + float(np.abs(self.data.geom_xmat[geom][6:]) @ self._box(geom)) / 2

    def _box(self, geom: int) -> FloatArray:
        """Full extents (3,), m, of a box.

        Raises:
            TaskError: The geom is none.
        """
        if self.model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_BOX:
            raise TaskError(
                f"geom {self.model.geom(geom).name!r} is no box; planning knows planes and boxes "
                "around an object: name one, or leave it out"
            )
        return 2.0 * np.asarray(self.model.geom_size[geom])


@dataclass(frozen=True, kw_only=True, eq=False)
class _Seen(Scene):
    """A foreign scene through the index maps of ours."""

    foreign: ForeignScene

    @cached_property
    def object_geoms(self) -> frozenset[int]:
        """Ids of the geoms of all its bodies."""
        own = np.isin(self.model.geom_bodyid, self.foreign.parts)
        return frozenset(np.flatnonzero(own).tolist())

    @property
    def subject(self) -> Subject:
        """What pictures are about: object, palm and fingers."""
        tips = self.foreign.tips(self.task.fingers)
        links = {self.body_of_geom[g] for g, finger in self.finger_of_geom.items() if finger}
        bodies = (self.object_body, *sorted(links | {self.palm_body}))
        return Subject(object_body=self.object_body, tips=tips, bodies=bodies)

    def start(self, q: FloatArray, T_world_base: SE3) -> Any:
        """Its owner's ``mujoco.MjData``, as it is."""
        return self.foreign.data

    def body_pose(self, data: Any, body: int) -> SE3:
        """Pose of a body in the world; of the object's body the object's."""
        pose = super().body_pose(data, body)
        return pose * self.foreign.T_body_object if body == self.object_body else pose

    def object_twist(self, data: Any) -> FloatArray:
        """That of the object's origin, which is not its body's; of any joints."""
        jacobian, body = np.zeros((6, self.model.nv)), self.object_body
        mujoco.mj_jacBody(self.model, data, jacobian[:3], jacobian[3:], body)
        twist = np.asarray(jacobian @ data.qvel)
        inside = self.foreign.pose(body).rotation @ self.foreign.T_body_object.translation
        twist[:3] += np.cross(twist[3:], inside)
        return twist


def _pose(part: Any) -> SE3:
    """Pose of a body or geom of ``mujoco.MjData``."""
    return SE3(part.xmat.reshape(3, 3), part.xpos)


def _solid(model: Any, name: str) -> int:
    """Id of a geom: of that name, or the only one that collides of a body of that name.

    Raises:
        NotFoundError: There is none.
    """
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
    named = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, name) >= 0
    collides = (model.geom_contype | model.geom_conaffinity).astype(bool)
    own = np.flatnonzero(collides & (model.geom_bodyid == body))
    return int(own[0]) if not named and len(own) == 1 else _id(model, "geom", name)


def _id(model: Any, kind: str, name: str) -> int:
    """Id of a named part.

    Raises:
        NotFoundError: There is none.
    """
    number = mujoco.mj_name2id(model, getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}"), name)
    if number < 0:
        count = {"body": model.nbody, "geom": model.ngeom, "joint": model.njnt}.get(kind, model.nu)
        names = [getattr(model, kind)(i).name for i in range(count)]
        raise NotFoundError(f"{kind} of the scene", name, [n for n in names if n])
    return int(number)
