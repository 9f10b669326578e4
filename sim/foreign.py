"""``ForeignScene``: a MuJoCo scene of another project, unchanged, with a hand and an object in it.

It is read, never built or changed: where joints and actuators of the hand stand in it, by their
names; what the object is, by its geoms; how hand and object touch. So planned and measured contacts
go through the same functions as in a scene of ours. Its owner steps it::

    scene = ForeignScene.read(model, data, "hand.toml", "hammer", table="table_top")
    plan = plan_grasp(scene.task())
    run = ForeignRun(plan, scene, step)  # step(T_world_base, ctrl) makes one of its steps
    if run.grasp():
        run.move(shifted(plan.T_world_base, [0.0, 0.0, 0.1]), 1.0)

What is known of it is the truth in ``data``: joints, poses and contacts without errors.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import mujoco
import numpy as np

from planner.bridge.object_body import object_in_model
from planner.contacts import ContactSet
from planner.errors import NotFoundError, TaskError
from planner.hand_loading import load_hand
from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.objects import GraspObject, NeededWrench, Region, TouchRegion
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray, minimum_jerk, pose_change
from planner.task import GraspTask, Obstacle
from planner.tolerances import DEFAULT_MU
from sim.contacts import hand_contacts
from sim.controllers import AnyController, Observation, Phase
from sim.controllers.grasp import RECLOSING_TIME, closing_ended
from sim.scene.build import Scene
from sim.scene.carrier import Timeline
from sim.scene.physics import PhysicsOptions
from sim.show.camera import Subject
from sim.simulation import Simulation

__all__ = ["ForeignRun", "ForeignScene"]

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

FREE = np.array([[-np.inf], [np.inf]])
"""Range of a joint without limits."""

EDGE = 0.001
"""How far (m) the bounds of a geom are widened, so that contacts on its faces lie inside."""

SAME_HAND = 0.001
"""How far (m) a link may stand from where the hand's own model has it."""

ARRIVED_MM, ARRIVED_DEG = 3.0, 1.5
"""How near its wanted pose a base has arrived: within the pre-grasp's opening."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ForeignScene:
    """A scene as it is now; make one with ``ForeignScene.read``.

    Attributes:
        model: The ``mujoco.MjModel``, as its owner compiled it.
        data: The ``mujoco.MjData`` that its owner steps.
        hand: The hand in it, read from its model.
        object: The object: axes of its body, origin at the centre of mass of a uniform solid.
        object_body: Body id of the object.
        T_body_object: Pose of the object in its body.
        center: Centre of mass (3,) of the object in the model, object frame, m.
        table: Geom id of the plane or box that carries it, -1 for none.
        obstacles: Geom ids of boxes that hand and object must not touch.
        prefix: What the names of the hand begin with in the scene.
    """

    model: Any
    data: Any
    hand: Hand
    object: GraspObject
    object_body: int
    T_body_object: SE3
    center: FloatArray
    table: int
    obstacles: tuple[int, ...]
    prefix: str

    @classmethod
    def read(
        cls,
        model: Any,
        data: Any,
        hand: Hand | str | Path,
        object: str,
        *,
        table: str | None = None,
        obstacles: Sequence[str] = (),
        touch: Sequence[str] = (),
        prefix: str = "",
    ) -> ForeignScene:
        """Find hand and object in a scene.

        Args:
            model: The ``mujoco.MjModel``.
            data: Its ``mujoco.MjData``, with its kinematics computed.
            hand: The hand, or its ``hand.toml``: that of the model that was attached to the scene,
                or of the scene itself (``opposable hands SCENE --base-body PALM --describe``).
            object: Name of the free body to grasp.
            table: Name of the plane or box that carries it; None for none.
            obstacles: Names of boxes that hand and object must not touch.
            touch: Names of the object's geoms in whose bounds fingers may touch it; all if none.
            prefix: What the names of the hand begin with in the scene and not in its description.

        Raises:
            NotFoundError: The scene has no such body, geom, joint or actuator.
            TaskError: The object is not free, its table or an obstacle has another form, or the
                hand is another than the scene's.
            PlannerError: Hand or object cannot be read.
        """
        hand = hand if isinstance(hand, Hand) else load_hand(hand)
        what = f"body {object!r} of the scene"
        read = object_in_model(model, object, what)
        body = int(model.body(object).id)
        joint = int(model.body_jntadr[body])
        if joint < 0 or model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_FREE:
            raise TaskError(f"{what} has no free joint; name the body that has it")
        regions = [_bounds(model, name, body, read.T_body_object) for name in touch]
        scene = cls(
            model=model,
            data=data,
            hand=hand,
            object=GraspObject(
                name=object,
                shape=read.shape,
                mass=read.mass,
                touch=TouchRegion(allowed=tuple(regions)) if regions else None,
            ),
            object_body=body,
            T_body_object=read.T_body_object,
            center=read.center,
            table=-1 if table is None else _id(model, "geom", table),
            obstacles=tuple(_id(model, "geom", name) for name in obstacles),
            prefix=prefix,
        )
        scene._check_hand()
        return scene

    @property
    def T_world_object(self) -> SE3:
        """Pose of the object now."""
        return self.pose(self.object_body) * self.T_body_object

    @property
    def T_world_base(self) -> SE3:
        """Pose of the hand's base now."""
        return self.pose(self._base)

    @property
    def q(self) -> FloatArray:
        """The hand's joints (nq,) now, in the order of ``hand.joint_names``."""
        return np.array(self.data.qpos[self.model.jnt_qposadr[self._joints]])

    @property
    def _joints(self) -> list[int]:
        return [self._id("joint", name) for name in self.hand.joint_names]

    def _id(self, kind: str, name: str) -> int:
        """Id of a part of the hand."""
        return _id(self.model, kind, self.prefix + name)

    def pose(self, body: int) -> SE3:
        """Pose of a body now."""
        return SE3(self.data.xmat[body].reshape(3, 3), self.data.xpos[body])

    @property
    def _base(self) -> int:
        return self._id("body", self.hand.description.base_body)

    def reaches(self, T_world_base: SE3) -> bool:
        """Whether what carries the hand can bring its base to a pose: by all joints above the base.

        Damped least squares from the posture of now, within the joints' ranges; what is in the way
        is not looked at.
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
        at, dof = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
        low, high = np.where(
            model.jnt_limited[joints].astype(bool), model.jnt_range[joints].T, FREE
        )
        jacobian, error, quat = np.zeros((6, model.nv)), np.zeros(6), np.zeros(4)
        for _ in range(REACH_STEPS):
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            now = SE3(data.xmat[base].reshape(3, 3), data.xpos[base])
            mujoco.mju_mat2Quat(quat, (T_world_base.rotation @ now.rotation.T).ravel())
            mujoco.mju_quat2Vel(error[3:], quat, 1.0)
            error[:3] = T_world_base.translation - now.translation
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
            TaskError: The object stands on nothing, or the task cannot work.
        """
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
        if self.table >= 0:
            lowest = pose.translation[2] - self.object.shape.support(-pose.rotation[2])
            table = _top(self.model, self.data, self.table)
            table = lowest if table - SUNK < lowest < table else table
        return GraspTask.create(
            self.hand,
            self.object,
            T_world_object=pose,
            table_height=table,
            obstacles=[_obstacle(self.model, self.data, geom) for geom in self.obstacles],
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
        model, hand, joint = self.model, self.hand, self.model.body_jntadr[self.object_body]
        bodies = {g.body for g in hand.geometries}
        of_hand = {self._id("body", name): name for name in bodies}
        collides = model.geom_contype.astype(bool) | model.geom_conaffinity.astype(bool)
        return _Seen(
            foreign=self,
            task=task,
            physics=PhysicsOptions(name="foreign", timestep=period),
            T_world_base=self.T_world_base,
            model=model,
            hand_qpos=model.jnt_qposadr[self._joints],
            hand_dof=model.jnt_dofadr[self._joints],
            hand_ctrl=np.array([self._id("actuator", n) for n in hand.actuation.names]),
            arm_ctrl=np.zeros(0, dtype=np.int64),
            gantry=None,
            object_qpos=int(model.jnt_qposadr[joint]) + np.arange(7),
            object_dof=int(model.jnt_dofadr[joint]) + np.arange(6),
            object_body=self.object_body,
            base_body=self._base,
            palm_body=self._id("body", hand.description.palm_body),
            finger_of_geom=MappingProxyType(
                {
                    int(g): task.part_of_body.get(of_hand[body], "")
                    for g in np.flatnonzero(collides)
                    if (body := int(model.geom_bodyid[g])) in of_hand
                }
            ),
            support=-1,
            deviation=0.0,
        )

    def tips(self, fingers: Sequence[Finger]) -> tuple[int, ...]:
        """Body ids of what carries the pads of some fingers."""
        body_of = {g.name: g.body for g in self.hand.geometries}
        return tuple(self._id("body", body_of[f.pad.geom]) for f in fingers)

    def _check_hand(self) -> None:
        """Refuse a hand whose links are elsewhere than the scene's."""
        own = self.hand.mj_model
        for name in self.hand.actuation.names:
            self._id("actuator", name)
        posed = mujoco.MjData(own)
        for name, value in zip(self.hand.joint_names, self.q, strict=True):
            posed.qpos[own.joint(name).qposadr] = value
        mujoco.mj_kinematics(own, posed)
        root = own.body(self.hand.description.base_body).id
        T_own = SE3(posed.xmat[root].reshape(3, 3), posed.xpos[root])
        for name in sorted({g.body for g in self.hand.geometries}):
            there = self.T_world_base.actInv(self.data.xpos[self._id("body", name)])
            off = np.linalg.norm(there - T_own.actInv(posed.xpos[own.body(name).id]))
            if off > SAME_HAND:
                raise TaskError(
                    f"{name} of the scene is {1e3 * off:.1f} mm from where {self.hand.name} has "
                    "it: describe the hand of this scene (opposable hands SCENE --describe)"
                )

    def _least_friction(self) -> float:
        """Least sliding friction (-) between the object and a fingertip."""
        bodies = self.tips(tuple(self.hand.fingers.values()))
        priority, friction = self.model.geom_priority, self.model.geom_friction[:, 0]
        of_body = self.model.geom_bodyid
        least = np.inf
        for a in np.flatnonzero(of_body == self.object_body):
            for b in np.flatnonzero(np.isin(of_body, bodies)):
                stronger = [g for g in (a, b) if priority[g] == max(priority[a], priority[b])]
                least = min(least, max(friction[stronger]))
        return float(least)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Seen(Scene):
    """A foreign scene through the index maps of ours."""

    foreign: ForeignScene

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
        """Pose of a body in the world; of the object's body that of the object."""
        pose = super().body_pose(data, body)
        return pose * self.foreign.T_body_object if body == self.object_body else pose

    def object_twist(self, data: Any) -> FloatArray:
        """That of the object's origin, which is not its body's."""
        twist = super().object_twist(data)
        inside = (
            self.foreign.pose(self.object_body).rotation @ self.foreign.T_body_object.translation
        )
        twist[:3] += np.cross(twist[3:], inside)
        return twist


class ForeignRun(Simulation):
    """A plan executed in a foreign scene, whose owner makes the steps.

    Attributes:
        wanted: Where the hand's base was asked to be in the last step; the next way begins there.
        held: Pose of the object in the palm when the grasp was made, from which slip counts.
    """

    def __init__(
        self,
        plan: GraspPlan,
        scene: ForeignScene,
        step: Callable[[SE3, FloatArray], object],
        *,
        period: float,
        controller: AnyController | None = None,
    ) -> None:
        """Begin where the scene is.

        Args:
            plan: A plan for ``scene.task()``.
            scene: The scene.
            step: Makes one step of the scene: takes where the hand's base is wanted, and the
                commands (nu,) of the hand's actuators in the order of ``hand.actuation.names``.
            period: Time (s) that one of these steps takes.
            controller: What drives the hand; as ``Simulation``.
        """
        super().__init__(
            _bearing(plan),
            scene=scene.for_task(plan.task, period),
            controller=controller,
            carrier=_Nothing(),
        )
        self._make_step = step
        self.wanted = self._from = self._to = scene.T_world_base
        self.held = self.T_palm_object

    def step(self, phase: Phase, share: float) -> Observation:
        """Have one step made; see ``Simulation.step``."""
        observation = self.observe(phase, share)
        self._told = observation
        self._ctrl = self._commands(observation)
        s = float(minimum_jerk(np.asarray(share)))
        turn = SE3.Interpolate(_turn(self._from), _turn(self._to), s).rotation
        place = (1.0 - s) * self._from.translation + s * self._to.translation
        self.wanted = SE3(turn, place)
        self._make_step(self.wanted, self._ctrl)
        self.steps += 1
        return observation

    def move(
        self,
        T_world_base: SE3,
        duration: float,
        *,
        wait: float = 0.0,
        phase: Phase = "hold",
        until: Callable[[Observation], bool] | None = None,
    ) -> bool:
        """Bring the hand's base to a pose, straight.

        Args:
            T_world_base: The pose.
            duration: Of the way, s.
            wait: Longest further time (s) until it has arrived.
            phase: What the controller is told: "approach" before the grasp.
            until: When it may end once the way is over, instead of by arriving.

        Returns:
            Whether it came near the pose.
        """
        self._from, self._to = self.wanted, T_world_base
        for _ in self.run(phase, duration, wait=wait, until=until or self._arrived):
            pass
        return self._arrived()

    def grasp(self, timeline: Timeline | None = None, *, wait: float = 1.0) -> bool:
        """Approach, close and squeeze as the plan does, from where its approach begins.

        Args:
            timeline: Durations; defaults if None.
            wait: Longest further time (s) until the base has arrived.

        Returns:
            Whether as many fingers as the task needs feel the object.
        """
        timeline, plan = timeline or Timeline(), self.plan
        self.move(plan.T_world_base, timeline.approach, wait=wait, phase="approach")
        over = closing_ended(self.controller, timeline.close_wait, self.timestep)
        wait = timeline.close_wait + RECLOSING_TIME
        self.move(plan.T_world_base, timeline.close, wait=wait, phase="close", until=over)
        self.move(plan.T_world_base, timeline.squeeze, phase="squeeze")
        self.held = self.T_palm_object
        self.move(plan.T_world_base, timeline.settle, phase="settle")
        return self.touching() >= plan.task.fingers_needed

    @property
    def slip(self) -> tuple[float, float]:
        """How far the object has moved in the palm since it was grasped, mm and degrees."""
        return pose_change(self.held, self.T_palm_object)

    @property
    def contacts(self) -> ContactSet:
        """Measured contacts of hand and object, merged per finger, world: as those of a plan."""
        return hand_contacts(self.scene, self.data)

    def _arrived(self, observation: Observation | None = None) -> bool:
        far, turned = pose_change(self._to, self.T_world_base)
        return far <= ARRIVED_MM and turned <= ARRIVED_DEG


def _bearing(plan: GraspPlan) -> GraspPlan:
    """The plan with the forces that bear the weight at the model's own centre of mass.

    Those with and those without the margin times the weight's moment are proven; what is between
    them lies in the same friction cones and limits.
    """
    for one, found in zip(plan.task.needed, plan.needed, strict=True):
        if one.name == WEIGHT:
            more = found.contacts.forces - plan.contacts.forces
            forces = plan.contacts.forces + more / plan.task.needed_margin
            return replace(plan, contacts=plan.contacts.with_forces(forces))
    return plan


class _Nothing:
    """A carrier that moves nothing: the scene's owner carries the hand."""

    def drive(self, data: Any, phase: Phase, share: float) -> None:
        """Nothing."""


def _turn(pose: SE3) -> SE3:
    return SE3(pose.rotation, np.zeros(3))


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


def _bounds(model: Any, name: str, body: int, T_body_object: SE3) -> Region:
    """The box, in the object's axes, around a geom of the object."""
    geom = _id(model, "geom", name)
    if model.geom_bodyid[geom] != body:
        raise TaskError(f"geom {name!r} does not belong to the object; name geoms of its body")
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
    local, half = np.split(model.geom_aabb[geom], 2)
    inside = T_body_object.inverse()
    rotation = inside.rotation @ turn.reshape(3, 3)
    middle = inside.act(model.geom_pos[geom] + turn.reshape(3, 3) @ local)
    reach = np.abs(rotation) @ half
    return Region(name=name, lower=tuple(middle - reach - EDGE), upper=tuple(middle + reach + EDGE))


def _top(model: Any, data: Any, geom: int) -> float:
    """Height (m) of the top of a plane or of a box."""
    height = float(data.geom_xpos[geom][2])
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE:
        return height
    return height + float(np.abs(data.geom_xmat[geom][6:]) @ _box(model, geom)) / 2


def _obstacle(model: Any, data: Any, geom: int) -> Obstacle:
    pose = SE3(data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom])
    return Obstacle(name=model.geom(geom).name, size=_box(model, geom), T_world_obstacle=pose)


def _box(model: Any, geom: int) -> FloatArray:
    """Full extents (3,), m, of a box.

    Raises:
        TaskError: The geom is none.
    """
    if model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_BOX:
        raise TaskError(
            f"geom {model.geom(geom).name!r} is no box; planning knows planes and boxes around an "
            "object: name one, or leave it out"
        )
    return 2.0 * np.asarray(model.geom_size[geom])
