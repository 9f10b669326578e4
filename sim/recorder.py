"""``Recorder``: takes samples of a trial and turns them into ``Samples`` and comparisons.

A sample copies what is there, and computes nothing while the simulation runs, so that a run with it
is the same run. What can be computed from that is computed after the run, for all samples at once;
closure and epsilon, which take longer than a trial, when they are asked for. ``StateRecorder``
takes the states of a ``Recording`` likewise: poses are made from the joints of the same moment,
since MuJoCo's own poses are those of the step before.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin

from planner.arrays import finite
from planner.kinematics import HandState
from planner.quality import closure_and_epsilon, force_closure
from planner.spatial import SE3, FloatArray, pose_change, pose_to_wxyz
from planner.system.threads import interrupts_wait
from planner.tolerances import CLOSURE_EDGES
from sim.contacts import ContactHistory, ContactRows
from sim.recording import PALM, Recording, Samples
from sim.report import FingerComparison
from sim.report_file import PathRecord
from sim.simulation import Simulation

__all__ = ["Recorder", "SampleRecorder"]


class StateRecorder:
    """States of one simulation, one row per call of ``take``."""

    def __init__(self, simulation: Simulation) -> None:
        """Start empty."""
        self._simulation = simulation
        scene = simulation.scene
        self._gantry = np.zeros(0, dtype=int) if scene.gantry is None else scene.gantry.qpos
        self._base = simulation.plan.T_world_base  # of a hand on an arm, whose base stands
        self._phases: list[str] = []
        self._rows: list[FloatArray] = []
        self._read: list[tuple[FloatArray, FloatArray] | None] = []

    def take(self, phase: str) -> None:
        """Take the state of now, which belongs to a phase."""
        scene, data = self._simulation.scene, self._simulation.data
        parts = (
            [data.time],
            data.qpos[scene.hand_qpos],
            data.qpos[scene.object_qpos],
            data.ctrl[scene.hand_ctrl],
            data.qpos[self._gantry],
        )
        self._rows.append(np.concatenate(parts))
        self._phases.append(phase)
        seen, read = self._simulation.seen, None
        if seen is not None:
            read = seen.q.copy(), np.concatenate(pose_to_wxyz(seen.T_world_object))
        self._read.append(read)

    def recording(self, contacts: Mapping[str, Any]) -> Recording:
        """Everything taken so far.

        Args:
            contacts: Fields of ``Recording`` about the contacts at the same moments.
        """
        scene, task = self._simulation.scene, self._simulation.plan.task
        sizes = (1, len(scene.hand_qpos), 7, len(scene.hand_ctrl), len(self._gantry))
        rows = np.array(self._rows).reshape(-1, sum(sizes))
        time, q, T_world_object, commands, gantry = np.split(rows, np.cumsum(sizes)[:-1], axis=1)
        quaternion = T_world_object[:, 3:]
        quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
        read_q, read_pose = self._readings(q.shape[1])
        return Recording(
            joint_names=task.hand.joint_names,
            actuator_names=task.hand.actuation.names,
            control_range=task.hand.actuation.ctrl_range,
            time=time[:, 0],
            phase=tuple(self._phases),
            q=q,
            T_world_base=self._bases(gantry),
            T_world_object=T_world_object,
            commands=commands,
            read_q=read_q,
            read_T_world_object=read_pose,
            **contacts,
        )

    def _readings(self, nq: int) -> tuple[FloatArray | None, FloatArray | None]:
        """Joints (m, nq) and poses (m, 7) that the controller read; None if that was the truth."""
        if not any(self._read):
            return None, None
        none = np.full(nq, np.nan), np.full(7, np.nan)
        joints, poses = zip(*(none if read is None else read for read in self._read), strict=True)
        return np.array(joints), np.array(poses)

    def _bases(self, gantry: FloatArray) -> FloatArray:
        """Poses of the base (m, 7) from the joints of what carries it; an arm's base stands."""
        carrier = self._simulation.scene.gantry
        if carrier is None:
            return np.tile(np.concatenate(pose_to_wxyz(self._base)), (len(gantry), 1))
        rows = [np.concatenate(pose_to_wxyz(carrier.pose(row))) for row in gantry]
        return np.array(rows).reshape(-1, 7)


NAN = float("nan")


class SampleRecorder:
    """States, contacts and rows of one simulation; what a row holds is a subclass's."""

    def __init__(self, simulation: Simulation) -> None:
        """Start empty.

        Args:
            simulation: What is watched.
        """
        self._simulation = simulation
        task = simulation.plan.task
        self._fingers = task.finger_names
        self._length = task.object.shape.bounding_radius
        self._reference: SE3 | None = None
        self._rows: list[dict[str, Any]] = []
        self._states = StateRecorder(simulation)
        self._contacts = ContactHistory.of(simulation.scene)

    def mark_reference(self) -> None:
        """From now on movement in the palm counts from how the object lies there now."""
        self._reference = self._held_at()

    def _held_at(self) -> SE3:
        """Pose of the object where it is held: in the palm."""
        return self._simulation.T_palm_object

    def _take(self, phase: str, row: dict[str, Any]) -> None:
        """Keep the state and the contacts of now, and a row of a table."""
        self._rows.append(row)
        self._states.take(phase)
        self._contacts.note(self._simulation.data)

    def recording(self) -> Recording:
        """The states at the times of the samples."""
        merged = self._contacts.rows().merged
        return self._states.recording(merged.columns(self._fingers, PALM))


WHOLE_LINE = 2.0
"""Reaches of a pad (-) from any place of it to any other: from one end to the other end."""

LEAST_TOLD = 0.01
"""Planned normal force (N) from which on an error is told as a share of it: an inner link may only
touch."""


def tilt_deg(wanted: SE3, pose: SE3) -> float:
    """Angle (degrees) between the vertical as two poses see it; turns about it do not count."""
    there, here = wanted.rotation[2], pose.rotation[2]
    return float(np.rad2deg(np.arctan2(np.linalg.norm(np.cross(there, here)), there @ here)))


class Recorder(SampleRecorder):
    """Samples of one trial, taken at most every so often.

    Attributes:
        every: Time between samples, s.
    """

    def __init__(self, simulation: Simulation, every: float) -> None:
        """Start empty.

        Args:
            simulation: What is watched.
            every: Time between samples, s.
        """
        super().__init__(simulation)
        self.every = every
        self._samples: Samples | None = None
        self._poses: list[SE3] = []  # of the object
        self._in_palm: list[tuple[SE3 | None, SE3]] = []  # its reference, and where it is
        self._carried: list[SE3 | None] = []  # pose of the base that is planned for these times
        self._in_base: SE3 | None = None  # pose of the object there that is kept

    def mark_reference(self) -> None:
        """From now on movement counts from how the object lies in palm and planned base now."""
        super().mark_reference()
        base = self._planned_base()
        self._in_base = None if base is None else base.inverse() * self._simulation.T_world_object

    def _planned_base(self) -> SE3 | None:
        """Where the base of two hands should be now; None of one hand, or of arms."""
        simulation = self._simulation
        return simulation.planned_base() if simulation.plan.task.hand.pair else None

    def path_errors(self) -> PathRecord | None:
        """How far the object is from its planned path; None but of two hands on carriages."""
        if self._in_base is None:
            return None
        out = np.full((len(self._rows), 3), NAN)
        for i, (row, base) in enumerate(zip(self._rows, self._carried, strict=True)):
            if base is not None and row["phase"] in ("lift", "hold"):
                wanted, pose = base * self._in_base, self._poses[i]
                out[i] = (*pose_change(wanted, pose), tilt_deg(wanted, pose))
        off, turned, tilted = finite(out.T)
        return PathRecord(off_mm=off, turned_deg=turned, tilted_deg=tilted)

    def record(self) -> None:
        """Take a sample of now: all of it, also where Ctrl-C comes meanwhile."""
        simulation, phase = self._simulation, self._phase()
        row = {
            "time": simulation.time,
            "phase": phase,
            "saturated": simulation.saturated_actuators(),
        }
        with interrupts_wait():
            self._take(phase, row)
            self._poses.append(simulation.T_world_object)
            self._in_palm.append((self._reference, self._held_at()))
            self._carried.append(self._planned_base())
            self._samples = None

    def _phase(self) -> str:
        """What a sample of now belongs to."""
        return self._simulation.phase

    def samples(self) -> Samples:
        """Everything recorded so far; made once."""
        if self._samples is None:
            self._samples = self._make_samples()
        return self._samples

    def _make_samples(self) -> Samples:
        raw = self._contacts.rows()
        columns = contact_columns(raw, self._fingers)
        collision, force = self._contacts.collisions(self._simulation.scene)
        columns |= {"collision_N": force, "collision": collision}
        for name in _ROW:
            columns[name] = [row[name] for row in self._rows]
        columns |= self._movements()
        return Samples.of(
            columns, len(self._fingers), later=partial(closure_columns, raw, length=self._length)
        )

    def _movements(self) -> dict[str, FloatArray]:
        """Movements of the object in the world and in the palm, (m,) each."""
        first = self._simulation.plan.task.T_world_object
        in_world = _changes(first, self._poses)
        slip = np.full((len(self._in_palm), 2), NAN)
        references = {id(reference): reference for reference, _ in self._in_palm}
        for key, reference in references.items():
            if reference is not None:
                mine = [i for i, (mark, _) in enumerate(self._in_palm) if id(mark) == key]
                slip[mine] = _changes(reference, [self._in_palm[i][1] for i in mine])
        heights = np.array([pose.translation[2] for pose in self._poses])
        return {
            "slip_mm": slip[:, 0],
            "slip_deg": slip[:, 1],
            "moved_mm": in_world[:, 0],
            "turned_deg": in_world[:, 1],
            "lift_mm": 1e3 * (heights - first.translation[2]),
        }

    def comparison(self) -> tuple[FingerComparison, ...]:
        """Planned against measured contacts while holding; empty if it never came to that."""
        hold = [i for i, row in enumerate(self._rows) if row["phase"] == "hold"]
        if not hold:
            return ()
        planned = self._simulation.plan.contacts_in_object
        merged = self._contacts.rows().merged
        turn = np.array([pose.rotation for pose in self._poses])[merged.moment]
        shift = np.array([pose.translation for pose in self._poses])[merged.moment]
        local = np.einsum("nji,nj->ni", turn, merged.positions - shift)
        position = _spread(merged, local, self._fingers)[hold]  # (m, n, 3)
        force = _spread(merged, merged.forces[:, :1], self._fingers)[hold, :, 0]  # (m, n)
        force = np.nan_to_num(force)
        out = []
        for i, finger in enumerate(self._fingers):
            known = position[np.isfinite(position[:, i, 0]), i]
            mean = known.mean(axis=0) if len(known) else np.full(3, NAN)
            wanted = float(planned.forces[i, 0])
            error = float(np.abs(force[:, i] - wanted).mean())
            out.append(
                FingerComparison(
                    finger=finger,
                    planned_position=planned.positions[i],
                    measured_position=mean,
                    position_error_mm=1e3 * float(np.linalg.norm(self._off(i, mean))),
                    planned_normal_force=wanted,
                    measured_normal_force=float(force[:, i].mean()),
                    force_error_N=error,
                    force_error_percent=100.0 * error / wanted if wanted > LEAST_TOLD else NAN,
                )
            )
        return tuple(out)

    def _off(self, i: int, measured: FloatArray) -> FloatArray:
        """How far (3,), m, contact i is from its place in the plan; object frame.

        A link that lies on the object may touch anywhere along its line: that is no difference.
        """
        plan = self._simulation.plan
        off, pad = measured - plan.contacts_in_object.positions[i], plan.task.fingers[i].pad
        if len(pad.reach):
            turn = plan.task.T_world_object.rotation.T @ plan.T_world_base.rotation
            turn = turn @ HandState(plan.task.hand, plan.q).joint_pose(pad.joint_id).rotation
            off = pad.beyond_reach(off, turn, WHOLE_LINE)
        return np.asarray(off)

    def slip(self) -> tuple[float, float]:
        """Movement (mm) and rotation (degrees) in the palm since the reference; NaN before."""
        if self._reference is None:
            return NAN, NAN
        return pose_change(self._reference, self._held_at())


_ROW = ("time", "phase", "saturated")
"""What a sample notes itself; the contacts say the rest."""


def _changes(before: SE3, after: Sequence[SE3]) -> FloatArray:
    """``pose_change`` of many poses, (m, 2): mm and degrees."""
    if not after:
        return np.zeros((0, 2))
    shift = np.array([pose.translation for pose in after]) - before.translation
    turns = before.rotation.T @ np.array([pose.rotation for pose in after])
    angles = np.array([pin.log3(turn) for turn in turns])
    return np.column_stack(
        [1e3 * np.sqrt(np.vecdot(shift, shift)), np.rad2deg(np.sqrt(np.vecdot(angles, angles)))]
    )


def contact_columns(rows: ContactRows, fingers: Sequence[str]) -> dict[str, Any]:
    """Columns of ``Samples`` about contacts: how many, and forces and friction merged per finger.

    Args:
        rows: Contacts, not merged.
        fingers: Names of those that take part, n.
    """
    counts, merged = rows.counts(), rows.merged
    own = [rows.names.index(finger) for finger in fingers]
    used = merged.friction_utilisation()[:, None]
    return {
        "contacts": counts[:, own],
        "palm_contacts": np.delete(counts, own, axis=1).sum(axis=1),
        "normal_force": np.nan_to_num(_spread(merged, merged.forces[:, :1], fingers)[:, :, 0]),
        "friction_utilisation": _spread(merged, used, fingers)[:, :, 0],
    }


def _spread(merged: ContactRows, values: FloatArray, fingers: Sequence[str]) -> FloatArray:
    """Values of merged contacts (K, d) by moment and finger, (m, n, d); NaN without contact."""
    out = np.full((len(merged.centers), len(merged.names), values.shape[1]), NAN)
    out[merged.moment, merged.finger] = values
    return out[:, [merged.names.index(finger) for finger in fingers]]


def closure_columns(raw: ContactRows, length: float) -> dict[str, Any]:
    """Closure and epsilon of the contacts of every moment.

    Args:
        raw: Contacts, not merged.
        length: Torque is divided by it, m.
    """
    closed, unmerged, epsilon = [], [], []
    merged = raw.merged
    several = raw.counts().sum(axis=1) != merged.counts().sum(axis=1)
    for moment in range(len(raw.centers)):
        is_closed, radius = closure_and_epsilon(merged.at(moment), length=length)
        closed.append(is_closed)
        epsilon.append(radius)
        as_they_are = is_closed
        if several[moment]:
            as_they_are = force_closure(raw.at(moment), CLOSURE_EDGES).closed
        unmerged.append(as_they_are)
    return {"closed": closed, "closed_unmerged": unmerged, "epsilon": epsilon}
