"""``ManipulationLog``: a manipulation over time, channel by channel, and who records it.

How hard fingers press over a whole manipulation, and how hard they may.

The force programme puts the wanted wrench first. Where friction hardly suffices, as for a torque
about the vertical by tangential forces alone, it presses as hard as allowed for the last tenths of
a newton. So the controller of a manipulation has a limit, and the verdict checks measured forces.

Contact modes over time: what every finger does to the object, planned and measured.

    off     the finger does not touch (a planned one is told to be off)
    break   it does not touch although it should
    slip    the object slides over it faster than ``SLIP_SPEED``
    roll    it does not slide, and the contact wanders over the object faster than ``ROLL_SPEED``
    stick   neither

Where sticking ends and rolling begins is a matter of speed: any round tip rolls a little.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.interpolate import interp1d

from planner.motion import MovementPlan
from planner.motion.manipulation import ManipulationPlan
from planner.motion.verify import LEAST_FORCE_LIMIT
from planner.quality import closure_and_epsilon
from planner.spatial import SE3, FloatArray, IntArray, signed_twist
from planner.system.threads import interrupts_wait
from sim.contacts.reading import read_pads
from sim.controllers.monitors import SLIP_SPEED
from sim.manipulation.timeline import PHASES, ManipulationPhase
from sim.recorder import SampleRecorder
from sim.recording import Channel, ChannelTable
from sim.simulation import Simulation

MM, DEG = 1e3, float(np.rad2deg(1.0))
"""Numbers in files per number of the log: mm per m, degrees per rad."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ManipulationLog(ChannelTable):
    """What happened, m samples, n fingers that take part.

    Turn, tilt and shift are the object's in the palm since the turn began, or since the grip was
    there while it has not.

    Attributes:
        time: (m,), s.
        phase: m phases.
        touching: (m,), how many fingers of the hand touch the object, the palm not counted.
        points: (m, n, 3), merged contacts in the object's frame, m; NaN without contact.
        sliding: (m, n), speed of the object over the pad beyond what spinning explains, m/s; NaN
            without contact.
        closed: (m,), force closure of the measured contacts, merged per finger, with their own
            friction.
        epsilon: (m,), their L1 epsilon (-).
        friction_utilisation: (m, n), share of the friction cone in use (-); NaN without contact.
        turn: (m,), signed twist about the axis of the turn, rad.
        tilt: (m,), rotation beside that, rad.
        shift: (m, 3), translation, m, palm axes.
        off_path: (m,), distance from where the reference has the object, m; NaN before the turn.
        path_parameter: (m,), where on the planned path the reference is, 0 to 1.
        away: (m, n), which fingers are told to be off the object.
        normal_force: (m, n), N, on the object, mean over the time steps since the last sample.
        peak_force: (m, n), the largest of these steps, N.
        collision_N: (m,), largest normal force of hand on table, obstacle or itself.
        collision: m names of the pair with that force, "" without.
    """

    time: Annotated[FloatArray, Channel("time_s")]
    phase: Annotated[tuple[ManipulationPhase, ...], Channel("phase", str)]
    touching: Annotated[IntArray, Channel("fingers_touching", int)]
    points: Annotated[FloatArray, Channel("contact_object_m", shape=(3,), per_finger=True)]
    sliding: Annotated[FloatArray, Channel("sliding_mm_s", scale=MM, per_finger=True)]
    closed: Annotated[NDArray[np.bool_], Channel("closed", bool)]
    epsilon: Annotated[FloatArray, Channel("epsilon")]
    friction_utilisation: Annotated[FloatArray, Channel("friction_utilisation", per_finger=True)]
    turn: Annotated[FloatArray, Channel("object_in_palm_turn_deg", scale=DEG)]
    tilt: Annotated[FloatArray, Channel("object_in_palm_tilt_deg", scale=DEG)]
    shift: Annotated[FloatArray, Channel("object_in_palm_shift_mm", shape=(3,), scale=MM)]
    off_path: Annotated[FloatArray, Channel("off_path_mm", scale=MM)]
    path_parameter: Annotated[FloatArray, Channel("path_parameter")]
    away: Annotated[NDArray[np.bool_], Channel("away", bool, per_finger=True)]
    normal_force: Annotated[FloatArray, Channel("normal_force_N", per_finger=True)]
    peak_force: Annotated[FloatArray, Channel("peak_normal_force_N", per_finger=True)]
    collision_N: Annotated[FloatArray, Channel("collision_N")]
    collision: Annotated[tuple[str, ...], Channel("collision", str)]


class ManipulationRecorder(SampleRecorder):
    """Samples of one manipulation."""

    def __init__(self, simulation: Simulation, axis: FloatArray) -> None:
        """Start empty.

        Args:
            simulation: What is watched.
            axis: Axis of the turn (3,), unit, palm.
        """
        super().__init__(simulation)
        self._axis = axis
        self._turn = 0.0
        self._forces: list[FloatArray] = []

    def note_forces(self, normal_forces: FloatArray) -> None:
        """Note the normal forces (n,), N, of one time step, for the next sample."""
        self._forces.append(normal_forces)

    def mark_reference(self) -> None:
        """From now on movement is counted from how the object lies in the palm now."""
        super().mark_reference()
        self._turn = 0.0

    def moved(self) -> tuple[float, float, FloatArray]:
        """Turn (rad), tilt beside it (rad) and shift (3,), m, in the palm since the mark."""
        if self._reference is None:
            return 0.0, 0.0, np.zeros(3)
        now = self._simulation.T_palm_object
        turned = now.rotation @ self._reference.rotation.T
        turn = signed_twist(turned, self._axis, near=self._turn)
        tilt = float(np.linalg.norm(pin.log3(turned @ pin.exp3(-turn * self._axis))))
        return turn, tilt, now.translation - self._reference.translation

    def record(
        self,
        phase: ManipulationPhase,
        *,
        path_parameter: float,
        wanted: SE3 | None,
        away: NDArray[np.bool_],
    ) -> None:
        """Take a sample: all of it, also where Ctrl-C comes meanwhile.

        Args:
            phase: Phase.
            path_parameter: Where on the path the reference is.
            wanted: T_palm_object that is wanted, None before it is held.
            away: (n,), which fingers are told to be off the object.
        """
        simulation = self._simulation
        scene, data = simulation.scene, simulation.data
        forces = np.array(self._forces or [np.zeros(len(self._fingers))])
        pads = read_pads(scene, data, self._fingers)
        pose, now = simulation.T_world_object, simulation.T_palm_object
        turn, tilt, shift = self.moved()
        off = np.nan if wanted is None else np.linalg.norm(now.translation - wanted.translation)
        with interrupts_wait():
            self._turn, self._forces = turn, []
            self._take(
                phase,
                {
                    "time": float(data.time),
                    "phase": phase,
                    "points": (pads.position - pose.translation) @ pose.rotation,
                    "sliding": np.linalg.norm(pads.sliding, axis=1) - pads.creep_speed,
                    "turn": turn,
                    "tilt": tilt,
                    "shift": shift,
                    "off_path": off,
                    "path_parameter": path_parameter,
                    "away": away.copy(),
                    "normal_force": forces.mean(axis=0),
                    "peak_force": forces.max(axis=0),
                },
            )

    def log(self) -> ManipulationLog:
        """All samples so far."""
        merged = self._contacts.rows().merged
        collision, force = self._contacts.collisions(self._simulation.scene)
        touching = np.delete(merged.counts(), merged.names.index(""), axis=1).sum(axis=1)
        used = merged.friction_utilisation()
        columns: dict[str, Any] = {
            "touching": touching,
            "collision_N": force,
            "collision": collision,
            "closed": [],
            "epsilon": [],
            "friction_utilisation": [],
        }
        noted = [name for name in ManipulationLog.channels() if name not in columns]
        columns |= {name: [row[name] for row in self._rows] for name in noted}
        for i in range(len(self._rows)):
            mine = merged.of(i)
            share = {
                merged.names[k]: u for k, u in zip(merged.finger[mine], used[mine], strict=True)
            }
            closed, epsilon = closure_and_epsilon(merged.at(i), length=self._length)
            columns["closed"].append(closed)
            columns["epsilon"].append(epsilon)
            columns["friction_utilisation"].append([share.get(f, np.nan) for f in self._fingers])
        return ManipulationLog.of(columns, len(self._fingers))


OVER_PLAN = 1.875
"""Normal force over the plan's largest (-) with which a finger may press: a margin for pushes and
pose errors, and for what springs and movement add to what is asked. The verdict's, as
``LEAST_FORCE_LIMIT``; no constant of a controller moves it."""


@dataclass(frozen=True, kw_only=True)
class FingerForce:
    """Normal force of one finger on the object.

    Attributes:
        finger: Its name.
        peak: Largest of all time steps, N; 0 if it never touched.
        sustained: Largest mean over the 20 ms between two samples, N.
        mean: Mean over the samples in which it pressed, N.
        peak_time: When the largest sustained force was, s.
    """

    finger: str
    peak: float
    sustained: float
    mean: float
    peak_time: float

    def __str__(self) -> str:
        """One finger in words."""
        return (
            f"{self.finger} {self.sustained:.1f} N at {self.peak_time:.2f} s (mean "
            f"{self.mean:.1f}, one time step {self.peak:.1f})"
        )


def finger_forces(log: ManipulationLog, fingers: tuple[str, ...]) -> tuple[FingerForce, ...]:
    """Forces of all fingers, in the order of the log's columns."""
    out = []
    for i, finger in enumerate(fingers):
        force = log.normal_force[:, i]
        pressed = force[force > 0.0]
        if not len(pressed):
            out.append(FingerForce(finger=finger, peak=0.0, sustained=0.0, mean=0.0, peak_time=0.0))
            continue
        hardest = int(force.argmax())
        out.append(
            FingerForce(
                finger=finger,
                peak=float(log.peak_force[:, i].max()),
                sustained=float(force[hardest]),
                mean=float(np.mean(pressed)),
                peak_time=float(log.time[hardest]),
            )
        )
    return tuple(out)


def force_limit(plan: ManipulationPlan) -> float:
    """Largest normal force (N) with which a finger may press in a manipulation: the judge's.

    It follows from the plan's own largest force at any knot and while any finger moves on.
    """
    solved = [one for knot in plan.knots for one in (knot.forces, *knot.on_the_way, *knot.needed)]
    planned = [forces.contacts.forces[:, 0] for forces in solved]
    for move in plan.relocations:
        planned += [contacts.forces[:, 0] for contacts in (move.before, move.during, move.after)]
    return max(LEAST_FORCE_LIMIT, OVER_PLAN * float(np.nanmax(np.concatenate(planned))))


Mode: TypeAlias = Literal["off", "break", "slip", "roll", "stick"]

MODES: tuple[Mode, ...] = Mode.__args__  # type: ignore[attr-defined]

ROLL_SPEED = 0.002
"""Speed (m/s) of the contact over the object from which on it rolls: a tip of 12 mm that turns by
10 degrees a second against the object."""

MODE_LETTERS = 60
"""Approximate number of letters for the contact modes of a turn."""

LETTERS = (("stick", "s"), ("roll", "r"), ("slip", "S"), ("break", "!"), ("off", "-"))
"""One for each mode."""

SPAN = 2
"""Samples to either side over which the speed of a contact is taken: the centre of several contacts
jumps when one of them opens."""


def measured_modes(
    time: FloatArray, points: FloatArray, sliding: FloatArray, wanted: NDArray[np.bool_]
) -> NDArray[np.str_]:
    """Modes (m, n) of m samples of n fingers.

    Args:
        time: (m,), s.
        points: (m, n, 3), contacts in the object's frame, m; NaN without contact.
        sliding: (m, n), speed of the object over the pad, m/s; NaN without contact.
        wanted: (m, n), which fingers were to touch.
    """
    speed = wandering(time, points)
    touching = np.isfinite(points[..., 0])
    modes = np.where(np.nan_to_num(speed) > ROLL_SPEED, "roll", "stick")
    modes = np.where(np.nan_to_num(sliding) > SLIP_SPEED, "slip", modes)
    return np.where(touching, modes, np.where(wanted, "break", "off"))


def planned_modes(time: FloatArray, points: FloatArray) -> NDArray[np.str_]:
    """The same of planned contacts (m, n, 3) in the object's frame: NaN is off; none slips."""
    modes = np.where(np.nan_to_num(wandering(time, points)) > ROLL_SPEED, "roll", "stick")
    return np.where(np.isfinite(points[..., 0]), modes, "off")


def wandering(time: FloatArray, points: FloatArray) -> FloatArray:
    """Speed (m, n), m/s, of contacts (m, n, 3) over the object; NaN next to a missing one."""
    m = len(time)
    if m < 2:
        return np.full(points.shape[:2], np.nan)
    index = np.arange(m)
    before, after = np.maximum(index - SPAN, 0), np.minimum(index + SPAN, m - 1)
    moved = np.linalg.norm(points[after] - points[before], axis=2)
    return np.asarray(moved / (time[after] - time[before])[:, None])


def planned_points(
    motion: MovementPlan,
    path_parameter: FloatArray,
    phase: tuple[ManipulationPhase, ...],
    away: NDArray[np.bool_],
) -> FloatArray:
    """Planned contacts (m, n, 3) in the object's frame; NaN before the grip and after the release.

    Args:
        motion: The plan.
        path_parameter: (m,), where on its path the reference is, 0 to 1.
        phase: m phases.
        away: (m, n), which fingers are to be off the object.
    """
    points = np.array([k.contacts_in_object.positions for k in motion.knots])
    planned = interp1d([k.path_parameter for k in motion.knots], points, axis=0)(path_parameter)
    order = {name: k for k, name in enumerate(PHASES)}
    order |= dict.fromkeys(("regrasp", "back", "wrist", "wrist back"), order["turn"])
    index = np.array([order[p] for p in phase], dtype=int)
    off = (index < order["verify"]) | (index > order["lower"])
    planned[off[:, None] | away] = np.nan
    return np.asarray(planned)


def mode_table(planned: NDArray[np.str_], measured: NDArray[np.str_]) -> dict[str, dict[str, int]]:
    """How many samples planned as the first were measured as the second; zeros left out."""
    out: dict[str, dict[str, int]] = {}
    for mode in MODES:
        row = {m: int(((planned == mode) & (measured == m)).sum()) for m in MODES}
        if any(row.values()):
            out[mode] = {m: n for m, n in row.items() if n}
    return out


def told_modes(
    fingers: Sequence[str],
    planned: NDArray[np.str_],
    measured: NDArray[np.str_],
    turning: IntArray,
) -> list[str]:
    """Contact modes of each finger while the object is turned, planned above measured.

    Args:
        fingers: Names of n fingers.
        planned: (m, n), modes of all samples.
        measured: (m, n), likewise.
        turning: Numbers of the samples of the turn.
    """
    index = turning[:: max(1, len(turning) // MODE_LETTERS)]
    lines = [f"contact modes during the turn ({', '.join(f'{v} {k}' for k, v in LETTERS)}):"]
    width = max(len(f) for f in fingers)
    for i, finger in enumerate(fingers):
        for name, modes in (("planned", planned), ("measured", measured)):
            row = "".join(dict(LETTERS)[str(m)] for m in modes[index, i])
            lines.append(f"  {finger:<{width}} {name:<8} {row}")
    return lines
