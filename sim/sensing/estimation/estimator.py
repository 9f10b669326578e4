"""``ObjectEstimator``: stands between sensors and controller and tells where the object is.

It takes an ``Observation`` and gives one: pose and twist are its own, ``uncertainty`` says how well
the pose is known. At every time step the last estimate is carried on with the joints; every
``PERIOD`` the filter goes on by a sample of the senses, and a measured pose counts at its time
stamp.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Literal, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planner.spatial import SE3, FloatArray
from planner.task import GraspTask
from sim.controllers import Event, Observation, Phase, Sense
from sim.controllers.monitors import LOADED
from sim.controllers.readings import TOUCH_FORCE, PadReading, PoseUncertainty
from sim.sensing.estimation.filter import ContactNoise, Filtered, PoseFilter
from sim.sensing.estimation.state import PoseMeasurement, SensorErrors, SensorSample
from sim.sensing.estimation.track import LossDetector, Track

PERIOD = 0.01
"""Time (s) between two samples of the filter; it goes on at once where a finger (un)touches."""

NOMINAL_FORCE = 1.0
"""Normal force (N) that is given for a contact of which only is known that it is one."""

STANDING: frozenset[Phase] = frozenset(
    {"approach", "close", "squeeze", "settle", "release", "open", "retreat"}
)
"""Phases in which the object stands in the world."""

Touch: TypeAlias = Literal["pads", "binary"]
"""What fingertips feel: place, force and normal, or only that they touch."""

TOL = 1e-9
"""Times that differ by less (s) are the same: rounding of sums of time steps."""


class ObjectEstimator:
    """An estimator of one trial: call ``step`` once a time step.

    Attributes:
        needs: Senses that it reads.
        task: What it believes of hand and object.
    """

    def __init__(
        self,
        task: GraspTask,
        errors: SensorErrors,
        *,
        touch: Touch = "pads",
        camera: bool = True,
        contact_noise: ContactNoise | None = None,
    ) -> None:
        """Prepare for a task.

        Args:
            task: Hand, fingers, shape, table and gravity, as they are believed.
            errors: How far senses are trusted.
            touch: What fingertips feel.
            camera: Whether poses are measured all the time; else only before the hand closes.
            contact_noise: Errors of contacts; the default of this touch if None.
        """
        self.task = task
        self.needs: tuple[Sense, ...] = ("touch", "object_pose")
        if touch == "pads":
            self.needs = (*self.needs, "pads")
        feels = touch == "pads"
        if contact_noise is None:
            contact_noise = ContactNoise() if feels else ContactNoise(creep=1e-3, share=0.05)
        self._filter = PoseFilter(task, errors, contact_noise, feels=feels)
        self._feels, self._camera = feels, camera
        self._least = LOADED if feels else TOUCH_FORCE
        self._loss = LossDetector()
        self._track: Track | None = None
        self._closing: float | None = None
        self._measurements, self._last_pose = 0, -np.inf
        self._uncertainty: PoseUncertainty | None = None
        self._base_twist = np.zeros(6)

    @property
    def events(self) -> tuple[Event, ...]:
        """When it no longer knew the pose, and when it knew it again."""
        return self._loss.events

    @property
    def known(self) -> Filtered | None:
        """What the filter knows, at its last sample; None before the first step."""
        return None if self._track is None else self._track.known

    @property
    def offsets(self) -> FloatArray:
        """Offsets (nq,) of the joints, reading minus joint, rad or m; 0 where nothing is known."""
        out = np.zeros(self.task.hand.nq)
        if self._track is not None:
            out[self._filter.tips.index] = self._track.known.estimate.offsets
        return out

    def step(self, observation: Observation) -> Observation:
        """What is known: the observation with the estimated pose and twist."""
        if self._closing is None and observation.phase != "approach":
            self._closing = observation.time
        touching = np.asarray(observation.normal_forces > self._least)
        track = self._track
        if track is None:
            self._track = track = self._begin(observation, touching)
            self._note(track)
        elif observation.time > track.last.time + TOL:
            last = track.last
            changed = last.standing != (observation.phase in STANDING) or bool(
                (touching != last.touching).any()
            )
            fresh = self._fresh(observation)
            here = (
                observation.measured_pose is None
                or observation.measured_pose.time > last.time + TOL
            )
            due = changed or observation.time >= last.time + PERIOD - TOL or (fresh and here)
            if due:
                self._go_on(track, observation, touching)
            if fresh:
                self._add_pose(track, observation)
            if due or fresh:
                self._note(track)
        return self._output(track, observation)

    # ---- looking

    def _begin(self, observation: Observation, touching: NDArray[np.bool_]) -> Track:
        sample = self._sample(observation, touching)
        seen = observation.measured_pose
        pose = observation.T_world_object if seen is None else seen.T_world_object
        self._last_pose = observation.time if seen is None else seen.time
        self._measurements = 1
        measurement = PoseMeasurement(observation.T_world_base.actInv(pose), 0, np.inf)
        return Track(self._filter, sample, measurement)

    def _fresh(self, observation: Observation) -> bool:
        """Whether there is a pose that has not been counted."""
        seen = observation.measured_pose
        time = observation.time if seen is None else seen.time
        least = PERIOD - TOL if seen is None else TOL
        if time < self._last_pose + least:
            return False
        return self._camera or self._closing is None or time < self._closing

    def _add_pose(self, track: Track, observation: Observation) -> None:
        seen = observation.measured_pose
        time = observation.time if seen is None else seen.time
        pose = observation.T_world_object if seen is None else seen.T_world_object
        track.add_pose(time, pose, self._measurements, time - self._last_pose, world=True)
        self._measurements += 1
        self._last_pose = time

    # ---- touching

    def _go_on(self, track: Track, observation: Observation, touching: NDArray[np.bool_]) -> None:
        last = track.last
        sample = self._sample(observation, touching)
        track.go_on(sample)
        elapsed = sample.time - last.time
        # of the base, world axes, about the world's origin
        change = sample.T_world_base * last.T_world_base.inverse()
        self._base_twist = np.array(pin.log6(change).vector) / elapsed

    def _note(self, track: Track) -> None:
        """Set what controllers read: covariance, world axes, and whether the pose is known."""
        T_world_base = track.last.T_world_base
        turn = np.zeros((6, 6))
        turn[:3, :3] = turn[3:, 3:] = T_world_base.rotation
        covariance = turn @ track.known.estimate.pose_covariance() @ turn.T
        known = self._loss.update(track.last.time, covariance)
        self._uncertainty = PoseUncertainty(covariance=covariance, known=known)

    def _sample(self, observation: Observation, touching: NDArray[np.bool_]) -> SensorSample:
        points = normals = sliding = np.zeros((len(touching), 3))
        base = observation.T_world_base
        if self._feels and touching.any():
            pads = observation.pads
            touching = touching & (pads.normal_force > 0)
            tips = self._filter.tips.at(observation.q)
            inside = base.inverse()
            local = tips.into(_placed(inside, pads.position))
            felt = touching[:, None]
            points = np.where(felt, local, 0.0)
            turned = base.rotation
            normals = np.where(felt, tips.turned_into(pads.normal @ turned), 0.0)
            sliding = np.where(felt, tips.turned_into(pads.sliding @ turned), 0.0)
        return SensorSample(
            time=observation.time,
            q=observation.q,
            T_world_base=base,
            standing=observation.phase in STANDING,
            touching=touching,
            points=points,
            normals=normals,
            sliding=sliding,
        )

    # ---- output

    def _output(self, track: Track, observation: Observation) -> Observation:
        known, last = track.known, track.last
        pose, motion = known.estimate.T_base_object, known.motion
        elapsed = observation.time - last.time
        k = self._filter.tips.index
        if motion is not None and elapsed > TOL:
            moved = motion.by_joints @ (observation.q - last.q)[k]
            moved = moved + elapsed * motion.rest_rate
            pose = pin.exp6(pin.Motion(moved)) * pose
        T_world_object = observation.T_world_base * pose
        out = replace(
            observation,
            T_world_object=T_world_object,
            read_twist=partial(self._twist, known, observation, T_world_object),
            uncertainty=self._uncertainty,
            measured_pose=None,
        )
        if self._feels:
            return replace(out, read_pads=lambda: observation.pads)
        touching = observation.normal_forces > self._least
        forces = np.where(touching, NOMINAL_FORCE, 0.0)
        return replace(
            out,
            normal_forces=forces,
            read_pads=partial(self._pads, known, observation, forces),
        )

    def _twist(self, known: Filtered, observation: Observation, pose: SE3) -> FloatArray:
        """Velocity of the object's origin, and its angular velocity, (6,), world."""
        twist = self._base_twist.copy()
        if known.motion is not None:
            v = observation.v[self._filter.tips.index]
            in_base = known.motion.by_joints @ v + known.motion.rest_rate
            twist += observation.T_world_base.action @ in_base
        twist[:3] += np.cross(twist[3:], pose.translation)
        return twist

    def _pads(self, known: Filtered, observation: Observation, forces: FloatArray) -> PadReading:
        """What pads would say of contacts of which only is known that they are there."""
        points, normals = self._filter.contacts(known.estimate, observation.q)
        base, away = observation.T_world_base, (forces == 0.0)[:, None]
        normals = np.where(away, np.nan, normals @ base.rotation.T)
        return PadReading(
            normal_force=forces,
            force=np.nan_to_num(forces[:, None] * normals),
            position=np.where(away, np.nan, _placed(base, points)),
            normal=normals,
            sliding=np.where(away, np.nan, np.zeros((len(forces), 3))),
        )


def _placed(T: SE3, points: FloatArray) -> FloatArray:
    return np.asarray(points @ T.rotation.T + T.translation)
