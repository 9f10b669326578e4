"""``drake``: the exported scene held in another physics engine, by position commands alone.

The plan is exported (``sim.scene.export``) and begins in Drake at the grasp with the squeeze
commanded (``hold_in_drake``): for 2 s under the plan's gravity; then six times more, with a
force of half of the object's weight from another side in the second half. Commands do not react to
anything. Contact model, solver, modulus and dissipation are Drake's defaults; friction is
that of ``--physics``. An object is lost that moves more than 10 mm or 15 degrees.

Before, the hand closes for ``CLOSE_TIME`` by the planned torques, the object fixed. A squeeze is
position commands that make these torques at the planned posture; Drake's surfaces meet 0.3 to 1 mm
further (their meshes lie inside of the shapes, and 10 MPa give way), which at 3 N m/rad is half
and more of the 1 to 3 N of a power grasp, another share at each link, and nothing at the palm. So
commands are those at the posture in which Drake's fingers bear these torques, as a trial's
controller latches the posture that it finds, and stay what they are from there on.

What else happens before the grasp is left out: it is an opinion on the grasp, not on its way.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from planner.errors import TaskError
from planner.exchange.dexgraspbench.export import without_servos
from planner.hands.hand import Hand
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray, IntArray, contact_frames, pose_change
from sim.contacts import ContactRows
from sim.protocols.drake_scene import INSTALL, TIME_STEP, DrakeScene, load_drake_scene
from sim.protocols.outcome import AXES, Conditions, Outcome, axis_of
from sim.recorder import closure_columns, contact_columns
from sim.recording import Samples
from sim.scene.build import HAND_PREFIX
from sim.scene.export import export_scene
from sim.verdict import Fault

PUSH_SHARE = 0.5
"""Push over the object's weight under 9.81 m/s2 (-): the planned forces carry the weight with a
margin of 20 % in friction, and nothing closes the fingers further."""

STANDARD_GRAVITY = 9.81
"""m/s2."""


@dataclass(frozen=True, kw_only=True)
class DrakeCase:
    """A hold, or a hold with a push.

    Attributes:
        index: 0 for the hold; else one more than the number of the direction in ``AXES``.
    """

    index: int

    @property
    def name(self) -> str:
        """What it is called."""
        return f"push {AXES[self.index - 1]}" if self.index else "hold"

    def push(self, plan: GraspPlan) -> FloatArray:
        """The push (6,), N, world axes, about the centre of mass; zero without one."""
        if not self.index:
            return np.zeros(6)
        weight = plan.task.object.mass * STANDARD_GRAVITY
        return np.append(PUSH_SHARE * weight * axis_of(self.index - 1), np.zeros(3))

    def run(self, plan: GraspPlan, conditions: Conditions) -> Outcome:
        """Export and hold it; the controller is left out."""
        push = self.push(plan)
        with tempfile.TemporaryDirectory() as made:
            folder = Path(made) / "scene"
            export_scene(plan, folder, physics=conditions.physics)
            seen = hold_in_drake(folder, wrench=push)
        size = float(np.linalg.norm(push))
        pushed = seen.time > seen.pushed_from
        return Outcome(
            index=self.index,
            name=self.name,
            held=seen.held,
            fault=None if seen.held else _fault(seen),
            fingers=plan.task.finger_names,
            samples=_samples(plan, seen, conditions.physics.mu),
            load=np.where(pushed, size, 0.0),
            unit="N" if self.index else "",
            wrench=push / size if self.index else push,
        )


def drake_cases() -> tuple[DrakeCase, ...]:
    """The hold and six pushes."""
    return tuple(DrakeCase(index=i) for i in range(1 + len(AXES)))


def unsuitable_for_drake(hand: Hand) -> str:
    """Why a hand cannot be tested by this protocol; "" if it can."""
    if reason := without_servos(hand):
        return f"protocol drake commands positions, and {reason}; use the protocol forces"
    return ""


def drake_physics(mu: float) -> dict[str, Any]:
    """How Drake computes, as a report states it."""
    return {
        "name": "Drake's defaults",
        "engine": "Drake",
        "timestep_s": TIME_STEP,
        "friction": mu,
        "contacts": "compliant hydroelastic patches",
        "servos": "implicit",
        "install": INSTALL,
    }


def _fault(seen: Held) -> Fault:
    last = len(seen.time) - 1
    touching = bool((seen.touches.moment == last).any())
    return Fault(
        reason="slipped" if touching else "dropped",
        detail=f"in Drake, {seen.detail}",
        time=float(seen.time[-1]),
    )


def _samples(plan: GraspPlan, seen: Held, mu: float) -> Samples:
    """What Drake did, judged by the code that judges every trial."""
    task = plan.task
    rows = _rows(plan, seen, mu)
    m, length = len(seen.time), task.object.shape.bounding_radius
    columns: dict[str, Any] = {
        **contact_columns(rows, task.finger_names),
        **closure_columns(rows, length),
        "time": seen.time,
        "phase": ["hold"] * m,
        # the hand's base stands still: movement in the world is movement in the hand
        "slip_mm": seen.moved_mm,
        "slip_deg": seen.turned_deg,
        "moved_mm": seen.moved_mm,
        "turned_deg": seen.turned_deg,
        "lift_mm": seen.rise_mm,
        "collision_N": np.full(m, np.nan),
        "collision": [""] * m,
        "saturated": [()] * m,
    }
    return Samples.of(columns, len(task.finger_names))


def _rows(plan: GraspPlan, seen: Held, mu: float) -> ContactRows:
    """Drake's patches as point contacts at their centroids."""
    touches, finger_of = seen.touches, plan.task.part_of_body
    names = (*dict.fromkeys((*plan.task.hand.fingers, *finger_of.values())), "")
    bodies = [body.removeprefix(HAND_PREFIX) for body in touches.bodies]
    frames = contact_frames(touches.normals)
    forces = np.zeros((len(bodies), 4))
    forces[:, :3] = np.einsum("nji,nj->ni", frames, touches.forces)
    return ContactRows(
        names=names,
        centers=seen.centers,
        moment=touches.moment,
        finger=np.array([names.index(finger_of.get(b, "")) for b in bodies], dtype=np.int64),
        positions=touches.positions,
        frames=frames,
        dims=np.full(len(bodies), 3),
        friction=np.tile([mu, 0.0], (len(bodies), 1)),
        forces=forces,
    )


CLOSE_TIME = 0.2
"""Time of closing before the hold, s: fingers meet the object within 20 ms."""

SAMPLE_EVERY = 0.1
"""Time between samples, s."""

LOOK_EVERY = 0.01
"""Time between looks at whether the object is lost, s."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Touches:
    """Contacts of the object at all samples, K in all.

    Attributes:
        moment: (K,), the sample's number, ascending.
        bodies: K names of the bodies of the hand.
        positions: (K, 3), m, world axes.
        normals: (K, 3), into the object.
        forces: (K, 3), on the object, N.
    """

    moment: IntArray
    bodies: tuple[str, ...]
    positions: FloatArray
    normals: FloatArray
    forces: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Held:
    """What became of a hold in another engine; m samples.

    Attributes:
        held: Whether the object stayed within the limits to the end.
        detail: What was seen, a sentence.
        time: (m,), s.
        moved_mm, turned_deg: (m,), of the object since the start.
        rise_mm: (m,), how far it rose.
        centers: (m, 3), its centre of mass, m, world axes.
        touches: Its contacts.
        pushed_from: When a push begins, s.
    """

    held: bool
    detail: str
    time: FloatArray
    moved_mm: FloatArray
    turned_deg: FloatArray
    rise_mm: FloatArray
    centers: FloatArray
    touches: Touches
    pushed_from: float


def hold_in_drake(
    folder: Path,
    *,
    seconds: float | None = None,
    wrench: FloatArray | None = None,
) -> Held:
    """Begin at the key frame "grasp", close to the torques of "squeeze", and look for some time.

    Args:
        folder: An exported scene.
        seconds: How long; what the export's own check says if None.
        wrench: Force (N) and torque (N m) (6,) on the object's centre of mass, world axes, from the
            beginning of the second half; none if None.

    Raises:
        TaskError: Drake is not installed, or its solver gave up.
        FileFormatError: The folder is no export, or Drake cannot read it.
    """
    scene = load_drake_scene(folder)
    return next(_Trial(scene).run(scene.check["seconds"] if seconds is None else seconds, [wrench]))


def holds_in_drake(folder: Path, wrenches: Sequence[FloatArray | None]) -> Iterator[Held]:
    """The same for several wrenches, whose first half is simulated once."""
    scene = load_drake_scene(folder)
    return _Trial(scene).run(scene.check["seconds"], wrenches)


@dataclass(frozen=True, kw_only=True)
class _Seen:
    """Samples (time, mm, degrees, pose) and touches (sample, body, position, normal, force)."""

    samples: list[tuple[float, float, float, SE3]] = field(default_factory=list)
    touches: list[tuple[int, str, FloatArray, FloatArray, FloatArray]] = field(default_factory=list)

    def told(self, begin: SE3, *, held: bool, pushed_from: float) -> Held:
        """The same as arrays."""
        time, mm, deg, poses = zip(*self.samples, strict=True)
        moment, bodies, *arrays = zip(*self.touches, strict=True) if self.touches else [()] * 5
        positions, normals, forces = (np.array(a, dtype=float).reshape(-1, 3) for a in arrays)
        return Held(
            held=held,
            detail=f"after {time[-1]:.2f} s the object had moved {mm[-1]:.1f} mm and turned "
            f"{deg[-1]:.1f} degrees, with {moment.count(len(time) - 1)} contacts",
            time=np.array(time),
            moved_mm=np.array(mm),
            turned_deg=np.array(deg),
            rise_mm=1e3 * np.array([(p.translation - begin.translation)[2] for p in poses]),
            centers=np.array([pose.translation for pose in poses]),
            touches=Touches(
                moment=np.array(moment, dtype=np.int64),
                bodies=tuple(bodies),
                positions=positions,
                normals=normals,
                forces=forces,
            ),
            pushed_from=pushed_from,
        )


class _Trial:
    """A simulator at the start of a hold."""

    def __init__(self, scene: DrakeScene) -> None:
        """Put hand and object where they are at the grasp, and squeeze."""
        from pydrake.math import RigidTransform

        self._scene, plant = scene, scene.plant
        self._simulator = scene.simulator
        root = self._simulator.get_mutable_context()
        self._context = plant.GetMyMutableContextFromRoot(root)
        q = plant.GetPositions(self._context)
        grasp = scene.key_frames["grasp"]["joints"]
        self._start = np.array([grasp[name] for name in scene.joints])
        q[scene.q_index] = self._start
        plant.SetPositions(self._context, q)
        plant.SetFreeBodyPose(
            self._context, scene.object_body, RigidTransform(scene.T_world_object.homogeneous)
        )
        self._torque = plant.get_applied_generalized_force_input_port()
        self._wanted = plant.get_desired_state_input_port(scene.object_body.model_instance())
        self._close()

    def _close(self) -> None:
        """Press with the planned torques on the fixed object; keep the commands of the last."""
        step = float(self._scene.plant.time_step())
        held = self._scene.plant.GetJointByName(self._scene.object_body.name())
        held.Lock(self._context)
        for k in range(round(CLOSE_TIME / step)):
            self._command()
            self._step((k + 1) * step, None)
        held.Unlock(self._context)
        self._command()
        self._simulator.get_mutable_context().SetTime(0.0)
        self._simulator.Initialize()

    def _command(self) -> None:
        """Command what makes the torques of the squeeze where the joints are now."""
        scene, plant = self._scene, self._scene.plant
        squeeze, explicit = scene.key_frames["squeeze"]["commands"], scene.explicit
        moved = plant.GetPositions(self._context)[scene.q_index] - self._start
        desired = np.zeros(2 * plant.num_actuators())
        for name, (place, factor, offset) in scene.wanted.items():
            joint = scene.joints.index(plant.GetJointActuatorByName(name).joint().name())
            desired[place] = factor * squeeze[name] + offset + moved[joint]
        self._wanted.FixValue(self._context, desired)
        commands = np.array([squeeze[name] for name in explicit.names])
        self._commands = commands - explicit.bias[:, 1] * (explicit.rows @ moved) / explicit.gain

    def run(self, seconds: float, wrenches: Sequence[FloatArray | None]) -> Iterator[Held]:
        """Simulate: a first half, and from its end a second one for every wrench."""
        steps = round(seconds / float(self._scene.plant.time_step()))
        begin, half = self._object_pose(), steps // 2
        first = _Seen()
        lost = self._advance(range(1, half + 1), None, begin, first)
        root = self._simulator.get_mutable_context()
        middle = root.Clone()
        for wrench in wrenches:
            root.SetTimeStateAndParametersFrom(middle)
            self._simulator.Initialize()
            seen = _Seen(samples=[*first.samples], touches=[*first.touches])
            gone = lost or self._advance(range(half + 1, steps + 1), wrench, begin, seen)
            yield seen.told(begin, held=not gone, pushed_from=seconds / 2)

    def _advance(self, steps: range, wrench: FloatArray | None, begin: SE3, seen: _Seen) -> bool:
        """Simulate some steps; whether the object was lost."""
        step = float(self._scene.plant.time_step())
        look, sample = (round(t / step) for t in (LOOK_EVERY, SAMPLE_EVERY))
        for k in steps:
            self._step(k * step, wrench)
            lost = k % look == 0 and self._lost(begin, self._scene.check)
            if not lost and k % sample:
                continue
            pose = self._object_pose()
            seen.touches.extend((len(seen.samples), *touch) for touch in self._touches())
            seen.samples.append((k * step, *pose_change(begin, pose), pose))
            if lost:
                return True
        return False

    def _step(self, time: float, wrench: FloatArray | None) -> None:
        """Simulate one step, up to some time."""
        self._push(wrench)
        try:
            self._simulator.AdvanceTo(time)
        except RuntimeError as error:
            raise TaskError(
                f"Drake gave up after {time:.3f} s: {error}; leave this plan out, or try a "
                "smaller time step"
            ) from error

    def _lost(self, begin: SE3, check: Mapping[str, Any]) -> bool:
        """Whether the object has left its place, or is nowhere."""
        mm, deg = pose_change(begin, self._object_pose())
        return not (mm <= check["most_mm"] and deg <= check["most_deg"])

    def _push(self, wrench: FloatArray | None) -> None:
        """Torques of this step that Drake does not make itself, and a push on the object."""
        scene, plant = self._scene, self._scene.plant
        q, v = plant.GetPositions(self._context), plant.GetVelocities(self._context)
        forces = np.zeros(plant.num_velocities())
        forces[scene.v_index] = scene.explicit.torque(
            q[scene.q_index], v[scene.v_index], self._commands
        )
        if wrench is not None:
            first = scene.object_body.floating_velocities_start_in_v()
            # a free body's velocity is angular first, both in world axes
            forces[first : first + 6] = np.concatenate([wrench[3:], wrench[:3]])
        self._torque.FixValue(self._context, forces)

    def _object_pose(self) -> SE3:
        pose = self._scene.plant.EvalBodyPoseInWorld(self._context, self._scene.object_body)
        return SE3(pose.rotation().matrix(), pose.translation())

    def _touches(self) -> list[tuple[str, FloatArray, FloatArray, FloatArray]]:
        """Body, position, mean normal into the object and force on it of each contact patch."""
        scene = self._scene
        results = scene.plant.get_contact_results_output_port().Eval(self._context)
        out = []
        for k in range(results.num_hydroelastic_contacts()):
            contact = results.hydroelastic_contact_info(k)
            patch = contact.contact_surface()
            first, second = (self._body_of(g) for g in (patch.id_M(), patch.id_N()))
            if scene.object_body not in (first, second):
                continue
            # normals point out of N into M, and the force acts on M
            mine, other = (1.0, second) if first is scene.object_body else (-1.0, first)
            faces = range(patch.num_faces())
            normal = sum(patch.area(i) * np.array(patch.face_normal(i)) for i in faces)
            normal = mine * normal / np.linalg.norm(normal)
            force = mine * np.array(contact.F_Ac_W().translational())
            out.append((str(other.name()), np.array(patch.centroid()), normal, force))
        return out

    def _body_of(self, geometry: Any) -> Any:
        """The body that carries a geometry."""
        frame = self._scene.inspector.GetFrameId(geometry)
        return self._scene.plant.GetBodyFromFrameId(frame)
