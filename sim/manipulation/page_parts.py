"""Runs of a manipulation on one time axis, and the contacts that were planned for every sample.

Where an object was put down half-way and all was begun again, a report holds the earlier run. The
page shows both, one after the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.interpolate import interp1d
from scipy.spatial.transform import Rotation

from planner.files.data import ContactData
from planner.files.disk import checked_file
from planner.files.movements import MovementFile, as_movement
from planner.motion.plan import standing_under
from planner.pages.scene import Contacts
from planner.spatial import FloatArray
from planner.task import GraspTask, Obstacle
from sim.manipulation.report_file import ManipulationReportFile
from sim.recording import Recording
from sim.show.trial_page import force_of


@dataclass(frozen=True, eq=False)
class Part:
    """One run of a manipulation.

    Attributes:
        report: What its file holds.
        shift: Time (s) of its beginning on the page's axis.
    """

    report: ManipulationReportFile
    shift: float

    @cached_property
    def recording(self) -> Recording | None:
        """Its states; None without."""
        data = self.report.recording
        return None if data is None else Recording.from_data(data)

    @cached_property
    def plan(self) -> MovementFile | None:
        """Its plan; None without.

        Raises:
            FileFormatError: It is damaged, or of another version.
        """
        data, source = self.report.plan, "the report's plan"
        if data is None:
            return None
        return checked_file(MovementFile, as_movement(data, source), source)

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.channel("time_s"))

    def channel(self, name: str) -> list[Any]:
        """A channel of the samples, by its name in files."""
        values: list[Any] = getattr(self.report.samples, name)
        return values

    @property
    def end(self) -> float:
        """When it ended, on the page's axis, s."""
        return float(self.time[-1]) if len(self) else self.shift

    @property
    def time(self) -> FloatArray:
        """Times of the samples on the page's axis (m,), s."""
        return np.array(self.channel("time_s"), dtype=np.float64) + self.shift


def parts_of(report: ManipulationReportFile) -> tuple[Part, ...]:
    """All runs of a report in their order; those before a change of fingers are left out."""
    runs = [report]
    while runs[0].earlier is not None and runs[0].earlier.fingers == report.fingers:
        runs.insert(0, runs[0].earlier)
    parts: list[Part] = []
    for run in runs:
        parts.append(Part(run, parts[-1].end if parts else 0.0))
    return tuple(parts)


def obstacles_of(plan: MovementFile, task: GraspTask) -> tuple[Obstacle, ...]:
    """The task's obstacles, and what carries the object at its target."""
    if plan.ending is None:
        return task.obstacles
    return (*task.obstacles, *standing_under(task, plan.ending.T_world_target.pose()))


def planned_forces(part: Part) -> FloatArray:
    """Planned normal forces (m, n), N, where the reference is; NaN off the object or unknown."""
    forces = np.full((len(part), len(part.report.fingers)), np.nan)
    if part.plan is None:
        return forces
    knots = [[c.force_normal_N for c in k.contacts] for k in part.plan.knots]
    return _masked(part, _along(part, part.plan, knots))


def planned_contacts(parts: Sequence[Part], mu: float) -> Contacts:
    """Where the plan has the contacts at every sample, world, with their forces.

    On one grasp they are fixed to the object as it is; in a gait, whose fingers meet another side
    of the object at every stroke, to the base. Every part must have a plan and states.
    """
    rows = [_planned(part) for part in parts]
    points, normals, forces = (np.concatenate([row[k] for row in rows]) for k in range(3))
    return Contacts(
        name="planned",
        layer="planned contacts",
        fingers=tuple(parts[0].report.fingers),
        points=points,
        normals=normals,
        forces=forces,
        mu=mu,
    )


def _planned(part: Part) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points, normals and forces (m, n, 3), world, of a part with plan and states."""
    plan, recording = part.plan, part.recording
    assert plan is not None and recording is not None
    carried = recording.T_world_object if plan.cycles == 1 else recording.T_world_base
    base = plan.grasp.grasp.T_world_base
    frames = [(k.T_world_object if plan.cycles == 1 else base).pose() for k in plan.knots]
    turns = Rotation.from_quat(carried[:, [4, 5, 6, 3]]).as_matrix()
    out = []
    for read, shift in ((_position, True), (_normal, False), (force_of, False)):
        local = []
        for frame, knot in zip(frames, plan.knots, strict=True):
            vectors = np.array([read(c) for c in knot.contacts])
            local.append((vectors - shift * frame.translation) @ frame.rotation)
        world = np.einsum("mij,mnj->mni", turns, _along(part, plan, local))
        out.append(_masked(part, world + shift * carried[:, None, :3]))
    return out[0], out[1], out[2]


def _position(contact: ContactData) -> FloatArray:
    return np.array(contact.position_world_m)


def _normal(contact: ContactData) -> FloatArray:
    return np.array(contact.normal_into_object_world)


def _along(part: Part, plan: MovementFile, knots: Sequence[Any]) -> FloatArray:
    """What every knot has (k, n, ...), at the path parameter of every sample (m, n, ...)."""
    places = [k.place for k in plan.knots]
    at = np.clip(np.array(part.channel("path_parameter"), dtype=np.float64), 0.0, 1.0)
    return np.asarray(interp1d(places, np.array(knots), axis=0)(at))


def _masked(part: Part, values: FloatArray) -> FloatArray:
    """NaN where a finger is planned off the object."""
    off = np.array(part.channel("contact_mode_planned")).reshape(len(part), -1) == "off"
    return np.where(off.reshape(off.shape + (1,) * (values.ndim - 2)), np.nan, values)
