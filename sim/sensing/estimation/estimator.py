"""``ObjectEstimator``: stands between sensors and controller and tells where the object is.

It takes an ``Observation`` and gives one: pose and twist are its own, ``uncertainty`` says how well
the pose is known. At every time step the last estimate is carried on with the joints; every
``PERIOD`` the filter goes on by a sample of the senses, and a measured pose counts at its time
stamp.

Estimators have names. One of your own registers itself by one::

    @register_estimator("mine", "what it reads, in a few words")
    def mine(task, errors):
        return Mine(task)               # step(observation) -> observation, events
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, Protocol, TypeAlias, runtime_checkable

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planner.errors import NotFoundError, TaskError, shown
from planner.registry import Registry
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask
from sim.controllers import Event, Observation, Phase, Sense
from sim.controllers.base import TOUCH_FORCE, PadReading, PoseUncertainty
from sim.controllers.monitors import LOADED
from sim.sensing.errors import ErrorModel
from sim.sensing.estimation.filter import ContactNoise, Filtered, LossDetector, PoseFilter, Track
from sim.sensing.estimation.state import PoseMeasurement, SensorErrors, SensorSample

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


NONE = "none"
"""Name of no estimator: the controller reads the sensors themselves."""


@runtime_checkable
class Estimator(Protocol):
    """What stands between sensors and controller."""

    @property
    def events(self) -> tuple[Event, ...]:
        """What it noticed so far, in order."""
        ...

    def step(self, observation: Observation) -> Observation:
        """What is known, from what sensors say; called once a time step."""
        ...


MakeEstimator: TypeAlias = Callable[[GraspTask, SensorErrors], Estimator]
"""Makes an estimator for a task and the expected errors of its senses."""

AnyEstimator: TypeAlias = str | MakeEstimator
"""What is accepted as an estimator: a name, or what makes one. Each trial gets its own."""


@dataclass(frozen=True)
class NamedEstimator:
    """An estimator with a name.

    Attributes:
        make: Makes one.
        reads: What it reads, in a few words.
    """

    make: MakeEstimator
    reads: str


ESTIMATORS: Registry[NamedEstimator] = Registry("estimator")
"""Estimators by their names."""


def register_estimator(name: str, reads: str) -> Callable[[MakeEstimator], MakeEstimator]:
    """Make known by a name what makes an estimator.

    Args:
        name: Its name.
        reads: What it reads, in a few words.

    Raises:
        TaskError: There is one of that name.
    """

    def register(make: MakeEstimator) -> MakeEstimator:
        if name == NONE:
            raise TaskError(f"{NONE!r} is the name of no estimator; choose another name")
        ESTIMATORS.add(name, NamedEstimator(make, reads))
        return make

    return register


register_estimator("all", "joints, pads and camera")(ObjectEstimator)
# contacts where round tips touch the estimated object, a nominal force, no sliding
register_estimator("contact", "joints, and which fingers touch; no camera once the hand closes")(
    partial(ObjectEstimator, touch="binary", camera=False)
)
register_estimator("touch", "joints and pads; no camera once the hand closes")(
    partial(ObjectEstimator, camera=False)
)


def default_estimator(error_model: ErrorModel | None) -> str:
    """Name of the estimator where none is asked for.

    It is the one with all senses where the pose that is read has errors: a controller that acts on
    each pose by itself multiplies their noise by its stiffness. An exact pose needs none.
    """
    return "all" if error_model is not None and error_model.has_pose_errors else NONE


def estimator_name(estimator: AnyEstimator | None, error_model: ErrorModel | None) -> str:
    """What reports call the estimator of a trial."""
    if estimator is None:
        return default_estimator(error_model)
    if isinstance(estimator, str):
        return estimator
    return str(getattr(estimator, "__name__", type(estimator).__name__))


def check_estimator(name: str) -> None:
    """Refuse a name that no estimator has.

    Raises:
        NotFoundError: There is none of that name.
    """
    if name != NONE and name not in ESTIMATORS:
        raise NotFoundError("estimator", name, (*ESTIMATORS, NONE))


def estimator_for(
    task: GraspTask, estimator: AnyEstimator | None, error_model: ErrorModel | None
) -> Estimator | None:
    """The estimator of a trial; None for none.

    Args:
        task: What it is to believe.
        estimator: A name, or what makes one; if None, that with all senses where the
            pose that is read has errors, and none where it is exact.
        error_model: How large the errors of the senses are; their size is all that is told of it.

    Raises:
        NotFoundError: No estimator has that name.
        TaskError: It is none.
    """
    if estimator is None:
        estimator = default_estimator(error_model)
    errors = SensorErrors.of(error_model)
    if isinstance(estimator, str):
        if estimator == NONE:
            return None
        check_estimator(estimator)
        return ESTIMATORS[estimator].make(task, errors)
    made: object = estimator(task, errors) if callable(estimator) else estimator
    if not isinstance(made, Estimator):
        raise TaskError(
            f"{shown(estimator)} is no estimator; give a name "
            f"({', '.join((*ESTIMATORS, NONE))}), or "
            "what makes an object with step(observation) and events out of task and sensor errors"
        )
    return made
