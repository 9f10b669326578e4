"""DexGraspBench's force-closure test, open loop, so that figures stand beside its users'.

Read from https://github.com/JYChen18/DexGraspBench at commit 1e7a5a6 (2025-06-05): ``config/task/
eval.yaml``, ``src/task/eval_func``, ``src/util/hand_util.py``. For each of six directions: from the
pre-grasp to the grasp in 10 stages of 10 steps, to the squeeze likewise, then a force of 10 m/s2
times the object's mass at its centre for 2 s. Every 0.2 s the object must be within 50 mm and 15
degrees of its first pose. There is no gravity, the object weighs 0.1 kg, a time step is 4 ms,
friction is 0.6 and 0.02 m, contacts of 4 dimensions, impratio 10, two noslip iterations, and a
hand that begins more than 10 mm inside the object or itself fails. Hand,
pieces and squeeze are those of the export of a batch.

``python -m benchmarks dexgraspbench`` compares the verdicts with those of the benchmark itself.

``benchmark_scene`` builds the world as ``src/util/hand_util.py`` does. What differs from our own
scene, each with its share of the verdicts:

- The hand's base is free and hangs on a weld to a mocap body, MuJoCo's defaults but for solimp: it
  gives way by millimetres under the forces of the fingers.
- Contacts mix the hand's parameters (5 ms) with MuJoCo's defaults for the object (20 ms): several
  times softer than ours.
- A primitive is a polyhedron, and a mesh its convex pieces, of one density.
- The hand's collision bits and margins are its own.

The constraint Jacobian stays dense (mujoco 4.0.0 factorises sparse Hessians wrongly).

``hold_imported_grasp`` executes a grasp that somebody else made, verified or not, by position
commands alone, with the same world, physics and steps: a hand welded at
its pose, a free object without gravity, servos led from the pre-grasp to the grasp and to the
squeeze in 10 stages of 10 steps each. Then the object's weight pulls at its centre of mass for 2 s,
along the gravity of the task. It is held if it stays within 50 mm and 15 degrees of where it was.

A file without a pre-grasp begins at the grasp. One without a squeeze gets that of our own exports
(``planner.exchange.dexgraspbench.plan_squeeze``) where the nearest surface points of the pads can
press; else the closing motion goes on as far again, as BODex has it, and without a pre-grasp the
grasp itself is commanded, which hardly presses.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from planner.bridge import compile_spec
from planner.errors import TaskError
from planner.exchange.audit.judge import T_world_base
from planner.exchange.audit.report import StageResult
from planner.exchange.dexgraspbench import benchmark_pieces, plan_squeeze
from planner.exchange.dexgraspbench.export import MASS, PUSH, without_servos
from planner.exchange.dexgraspbench.models import T_model_base, frame_shift
from planner.exchange.formats import ImportedGrasp
from planner.hands.hand import Hand
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray, pose_change, pose_from_wxyz, pose_to_wxyz
from planner.task import GraspTask
from planner.verification import contacts_at
from sim.controllers import Observation
from sim.controllers.base import Phase
from sim.protocols.disturbance import DisturbanceTrial
from sim.protocols.outcome import AXES, Conditions, Outcome, axis_of
from sim.scene.build import (
    HAND_PREFIX,
    OBJECT,
    Scene,
    add_looks,
    drop_options,
    index_scene,
)
from sim.scene.carrier import Timeline
from sim.scene.gantry import Gantry
from sim.scene.physics import PhysicsOptions
from sim.show.dress import dress_hand
from sim.verdict import Fault, LossCriteria, lost

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


STAGES, CHECK_S, CHECKS = 10, 0.2, 10
"""Stages of a motion; time between checks (s), and how many there are."""

MOTION = Timeline(
    approach=0.4, close=0.4, close_wait=0.0, squeeze=0.4, settle=0.2, lift=0.2, hold=2.0
)
"""10 stages of 10 steps of 4 ms to the grasp, and as many to the squeeze."""

FAR = LossCriteria(fewest=0, mm=50.0, deg=15.0)
"""Where the test is failed: movement in the world, whatever touches."""

DEEP_MM = 10.0
"""Penetration at the start from which on the test is failed, mm."""


@dataclass(frozen=True, kw_only=True)
class DexGraspBenchCase:
    """A push along one direction.

    Attributes:
        index: Number of the direction in ``AXES``.
    """

    index: int

    @property
    def name(self) -> str:
        """The direction."""
        return f"dexgraspbench {AXES[self.index]}"

    def run(self, plan: GraspPlan, conditions: Conditions | None = None) -> Outcome:
        """Execute it; physics and controller are the benchmark's, whatever the conditions."""
        del conditions
        task = replace(
            plan.task,
            gravity=np.zeros(3),
            object=replace(plan.task.object, mass=MASS),
        )
        floating = replace(plan, task=task)
        test = _BenchmarkTest(floating)
        force = np.append(PUSH * MASS * axis_of(self.index), np.zeros(3))
        fault = test.test(force)
        return test.trial.outcome(
            self,
            fault,
            unit="N",
            wrench=force / np.linalg.norm(force),
            conditions={"mass_kg": MASS, "push_N": PUSH * MASS, **test.depths},
        )


def dexgraspbench_cases() -> tuple[DexGraspBenchCase, ...]:
    """The six directions."""
    return tuple(DexGraspBenchCase(index=i) for i in range(len(AXES)))


def unsuitable_for_dexgraspbench(hand: Hand) -> str:
    """Why a hand cannot be tested by this protocol; "" if it can."""
    if hand.pair:
        return f"protocol dexgraspbench carries one hand, and {hand.name} is two; use hold"
    if hand.arm is not None:
        return (
            f"protocol dexgraspbench carries the hand alone, by a weld, and {hand.name} is on an "
            "arm; use the protocols forces and robust, or plan with the hand without its arm"
        )
    if reason := without_servos(hand):
        return (
            f"protocol dexgraspbench commands postures, and {reason}; use the protocols forces and "
            "shake"
        )
    return ""


class Replay:
    """Commands postures one after the other, whatever happens: open loop."""

    def __init__(self, plan: GraspPlan) -> None:
        """Work out the commands of pre-grasp, grasp and squeeze.

        Raises:
            TaskError: The hand has actuators that follow no position.
        """
        hand, actuation = plan.task.hand, plan.task.hand.actuation
        if reason := unsuitable_for_dexgraspbench(hand):
            raise TaskError(reason)
        squeeze = plan_squeeze(plan.task, plan.contacts, plan.T_world_base, plan.q)
        self.fault = squeeze.reason
        self.pregrasp = actuation.moment @ plan.q_pregrasp + actuation.length0
        self.grasp = actuation.moment @ plan.q + actuation.length0
        self.squeeze: FloatArray = self.grasp if self.fault else squeeze.ctrl

    def step(self, observation: Observation) -> FloatArray:
        """Commands (nu,) for the hand's actuators."""
        stage = min(STAGES, int(STAGES * observation.progress + 1e-9) + 1) / STAGES
        if observation.phase == "close":
            return np.asarray(self.pregrasp + stage * (self.grasp - self.pregrasp))
        if observation.phase == "squeeze":
            return np.asarray(self.grasp + stage * (self.squeeze - self.grasp))
        return self.squeeze


def _deepest(data: Any) -> float:
    """Deepest penetration of any pair, mm; 0 without."""
    return 1e3 * max((-float(contact.dist) for contact in data.contact), default=0.0)


class _BenchmarkTest:
    """The benchmark's sequence of events.

    Attributes:
        trial: What is held, and then pushed.
        depths: Penetration at the pre-grasp, which the benchmark refuses, and at the grasp, which
            it reports.
    """

    def __init__(self, plan: GraspPlan) -> None:
        """The object is free from the beginning."""
        self._replay = Replay(plan)
        scene, welded = benchmark_scene(plan.task, plan.T_world_base)
        self.trial = DisturbanceTrial(
            plan,
            controller=self._replay,
            dropped=None,
            timeline=MOTION,
            scene=scene,
            carrier=welded,
        )
        self._shift = SE3(np.eye(3), -frame_shift(plan.task.object.shape))
        at_grasp = scene.start(plan.q, plan.T_world_base)
        self.depths = {
            "start_penetration_mm": _deepest(self.trial.simulation.data),
            "grasp_penetration_mm": _deepest(at_grasp),
        }

    def test(self, force: FloatArray) -> Fault | None:
        """Grasp, squeeze, push; what went wrong, None if nothing did."""
        trial, simulation = self.trial, self.trial.simulation
        if self._replay.fault:
            return trial.fault("infeasible forces", self._replay.fault)
        if self.depths["start_penetration_mm"] > DEEP_MM:
            depth = self.depths["start_penetration_mm"]
            detail = f"{depth:.1f} mm deep before it began; {DEEP_MM:g} are let pass"
            return trial.fault("penetration", detail)
        begin = self._object_pose()
        if fault := trial.run_phases("close", "squeeze"):
            return fault
        trial.begin_hold()
        trial.load = float(np.linalg.norm(force))
        trial.push(force)
        for _ in range(CHECKS):
            if fault := trial.hold_for(CHECK_S):
                return fault
            moved = pose_change(begin, self._object_pose())
            if lost(FAR, touching=0, moved=moved):
                detail = f"the object moved {moved[0]:.1f} mm and turned {moved[1]:.1f} degrees"
                touching = simulation.touching()
                return trial.put_down("slipped" if touching else "dropped", detail)
        return None

    def _object_pose(self) -> SE3:
        """Of the frame of the object's file, whose movement the benchmark looks at."""
        return self.trial.simulation.T_world_object * self._shift


STAGE_STEPS = 10
"""Time steps of a stage."""

HOLD_S = 2.0
"""How long the weight pulls, s."""


def hold_imported_grasp(task: GraspTask, grasp: ImportedGrasp) -> StageResult:
    """Execute a grasp; its number is how far the object moved, mm.

    Args:
        task: Hand, object and its mass, gravity.
        grasp: The grasp.

    Raises:
        ModelError: MuJoCo refuses the scene.
    """
    if reason := unsuitable_for_dexgraspbench(task.hand):
        return StageResult(passed=None, reason=reason)
    base = T_world_base(task, grasp)
    scene, _ = benchmark_scene(task, base)
    actuation = task.hand.actuation
    before = grasp.q if grasp.q_pregrasp is None else grasp.q_pregrasp
    opened, closed = (actuation.moment @ q + actuation.length0 for q in (before, grasp.q))
    pressed = _squeeze(task, grasp, base)
    data = scene.start(np.array(before), base)
    begin = _pose_of(data.qpos[scene.object_qpos])
    for first, last in ((opened, closed), (closed, pressed)):
        for stage in range(1, STAGES + 1):
            data.ctrl[scene.hand_ctrl] = first + stage / STAGES * (last - first)
            for _ in range(STAGE_STEPS):
                mujoco.mj_step(scene.model, data)
    data.xfrc_applied[scene.object_body, :3] = task.object.mass * task.gravity
    worst = (0.0, 0.0)
    for _ in range(round(HOLD_S / scene.model.opt.timestep)):
        mujoco.mj_step(scene.model, data)
        if (
            not np.isfinite(data.qpos).all()
            or data.warning.number[mujoco.mjtWarning.mjWARN_BADQACC]
        ):
            return StageResult(passed=False, reason="the simulation diverged")
        worst = pose_change(begin, _pose_of(data.qpos[scene.object_qpos]))
        if lost(FAR, touching=0, moved=worst):
            break
    held = not lost(FAR, touching=0, moved=worst)
    reason = "" if held else f"the object moved {worst[0]:.1f} mm and turned {worst[1]:.1f} degrees"
    return StageResult(passed=held, number=worst[0], reason=reason)


def _squeeze(task: GraspTask, grasp: ImportedGrasp, base: SE3) -> FloatArray:
    """Commands (nu,) that press."""
    actuation = task.hand.actuation
    if grasp.q_squeeze is not None:
        return np.asarray(actuation.moment @ grasp.q_squeeze + actuation.length0)
    q = np.array(grasp.q)
    planned = plan_squeeze(task, contacts_at(task, base, q), base, q)
    if not planned.reason:
        return planned.ctrl
    before = q if grasp.q_pregrasp is None else grasp.q_pregrasp
    return np.asarray(actuation.moment @ (2.0 * q - before) + actuation.length0)


def _pose_of(qpos: FloatArray) -> SE3:
    return pose_from_wxyz(qpos[:3], qpos[3:])
