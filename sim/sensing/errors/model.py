"""``ErrorModel``: errors of sensors and drives, and random properties of the object.

Planner and controller do not know them. Without arguments there are none. Every error has a field
of its own, and all of them are drawn from ``seed`` (``Drawn``), each from a stream of its own named
by its field: a ``SeedSequence`` of the seed whose spawn key is a checksum of the name. Streams give
standard numbers, which the field only scales. So an error that is added or changed leaves the draws
of all others as they were, and doubles with its field. ``drawn_numbers`` and ``drawn_text`` say to
people what was drawn: a failure then has its likely cause beside it. Sets of errors have names,
those below and others that are registered; a file holds one too, TOML or JSON with fields of
``ErrorModel`` (``sim.presets``)::

    preset = "lab"
    encoder_offset = 0.035  # rad
    object_mass = 0.0
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, TypeAlias
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from planner.arrays import checked_number, finite
from planner.errors import NotFoundError, TaskError, shown
from planner.hands.hand import Hand
from planner.kinematics import joint_axes
from planner.spatial import FloatArray
from sim.controllers.base import EXACT
from sim.presets import Presets

IDEAL = "ideal"
"""Name of the model without errors."""

BELOW_ONE = (
    "encoder_scale",
    "torque_constant",
    "touch_scale",
    "object_size",
    "object_mass",
    "object_center",
    "object_friction",
)
"""Shares; at 1 the least size, mass or friction that is drawn would be 0."""


@dataclass(frozen=True, kw_only=True)
class ErrorModel:
    """What sensors, drives and object have for errors; each 0 unless given.

    "Standard deviation" means a normal distribution, "at most" a uniform one about 0. The joints
    are those of the hand; an arm that carries it is taken as calibrated.

    Attributes:
        name: What a report calls it.
        encoder_offset: Standard deviation of a joint's constant offset, rad (m for slides).
        encoder_scale: Standard deviation of a joint's scale error (-).
        encoder_noise: Standard deviation of the white noise of a joint's reading, rad.
        encoder_step: Step in which a joint's reading is given, rad (m for slides).
        rate_noise: Standard deviation of the white noise of a joint's velocity, rad/s.
        backlash: Lost motion between each position servo and its joint, from stop to stop, rad (m
            for slides); motors have none.
        dry_friction: Dry friction of every joint beside what the model has, N m (N for slides).
        torque_constant: Largest error of an actuator's force, as a share of it (-).
        command_delay: Age of a command when it acts, s.
        command_rate: Rate at which commands are taken over and held, Hz; 0 for every time step.
        pose_noise: Standard deviation of the white noise of the object's position, each axis, m.
        turn_noise: The same of its rotation, each axis, rad.
        pose_drift: Standard deviation of the correlated noise of the position, each axis, m.
        turn_drift: The same of the rotation, each axis, rad.
        drift_time: Correlation time of all that drifts, s: its autocorrelation is
            exp(-t / drift_time).
        pose_bias: Standard deviation of the constant error of the position, each axis, m.
        turn_bias: The same of the rotation, each axis, rad.
        pose_rate: Rate at which poses are measured, Hz; 0 for every time step.
        pose_delay: Age of a pose when it arrives, s.
        dropout: Probability per measured pose that poses stop arriving (-).
        dropout_time: How long they then stay away, s.
        touch_noise: Standard deviation of the force that a finger feels, each axis, N; a finger
            without contact says so without noise.
        touch_scale: Largest scale error of that force, of each finger, as a share (-).
        touch_step: Step in which the normal force is given, N.
        touch_threshold: Normal force below which a finger feels nothing, N.
        touch_place: Standard deviation of the drifting error of where a finger feels a contact,
            each axis along its pad, m. Normal and force turn with it about the pad's centre.
        touch_rate: Rate at which pads are read, Hz; 0 for every time step.
        touch_delay: Age of a pad's reading when it arrives, s.
        sliding_noise: Standard deviation of a pad's sliding velocity, each axis, m/s.
        object_size: Largest error of all lengths of the object, as a share (-).
        object_mass: Largest error of its mass, as a share (-).
        object_center: Largest offset of its centre of mass along each axis, as a share of half its
            extent there (-).
        object_friction: Largest error of its friction, as a share (-).
        touch: Sense of touch, by its name in ``sim.sensing.touch``: exact, taxels, effort or
            binary.
        seed: Of all draws, an integer >= 0.
    """

    name: str = IDEAL
    encoder_offset: float = 0.0
    encoder_scale: float = 0.0
    encoder_noise: float = 0.0
    encoder_step: float = 0.0
    rate_noise: float = 0.0
    backlash: float = 0.0
    dry_friction: float = 0.0
    torque_constant: float = 0.0
    command_delay: float = 0.0
    command_rate: float = 0.0
    pose_noise: float = 0.0
    turn_noise: float = 0.0
    pose_drift: float = 0.0
    turn_drift: float = 0.0
    drift_time: float = 1.0
    pose_bias: float = 0.0
    turn_bias: float = 0.0
    pose_rate: float = 0.0
    pose_delay: float = 0.0
    dropout: float = 0.0
    dropout_time: float = 0.0
    touch_noise: float = 0.0
    touch_scale: float = 0.0
    touch_step: float = 0.0
    touch_threshold: float = 0.0
    touch_place: float = 0.0
    touch_rate: float = 0.0
    touch_delay: float = 0.0
    sliding_noise: float = 0.0
    object_size: float = 0.0
    object_mass: float = 0.0
    object_center: float = 0.0
    object_friction: float = 0.0
    touch: str = EXACT
    seed: int = 0

    def __post_init__(self) -> None:
        """Check every number."""
        if not (isinstance(self.seed, int) and self.seed >= 0) or isinstance(self.seed, bool):
            raise TaskError(f"error model: seed is {shown(self.seed)}; give an integer >= 0")
        if not (isinstance(self.name, str) and self.name):
            raise TaskError(f"error model: name is {shown(self.name)}; give a text")
        if self.touch != EXACT:
            from sim.sensing.touch import check_touch

            check_touch(self.touch)
        given: dict[str, Any] = dict(self.numbers)  # dataclasses check no types
        for name, value in given.items():
            checked_number(f"error model: {name}", value, least=0.0, error=TaskError)
            if name in BELOW_ONE and value >= 1:
                raise TaskError(f"error model: {name} is {value}; give a share in [0, 1)")
        if self.drift_time == 0:
            raise TaskError("error model: drift_time is 0; give a time in s above 0")
        if self.dropout > 1:
            raise TaskError(f"error model: dropout is {self.dropout}; give a probability in [0, 1]")

    @property
    def numbers(self) -> dict[str, float]:
        """All errors by the names of their fields."""
        return {f.name: getattr(self, f.name) for f in fields(self) if f.name not in NO_ERROR}

    @property
    def ideal(self) -> bool:
        """Whether it has no error at all: then nothing is drawn, changed or delayed."""
        return self.touch == EXACT and not any(
            value for name, value in self.numbers.items() if name != "drift_time"
        )

    @property
    def has_pose_errors(self) -> bool:
        """Whether the object's pose, as it is read, is not the one of now."""
        return any(self.numbers[name] for name in POSE_ERRORS)

    def seeded(self, seed: int) -> ErrorModel:
        """The same with another seed."""
        return replace(self, seed=seed)

    def only(self, *names: str) -> ErrorModel:
        """The same with only some of its errors: to find which one does the harm.

        Args:
            names: Of fields; ``drift_time``, ``touch`` and ``seed`` are always kept.

        Raises:
            NotFoundError: No error has that name.
            TaskError: No name was given, or that of a field that is always kept.
        """
        if not names:
            raise TaskError("only() was given no name; give those of the errors that stay")
        for name in names:
            if name in (*NO_ERROR, "drift_time"):
                raise TaskError(
                    f"{name} is always kept; give names of errors, as {EXAMPLE}, or change "
                    "it with dataclasses.replace"
                )
            if name not in self.numbers:
                raise NotFoundError("error of an error model", name, tuple(self.numbers))
        kept = {name: self.numbers[name] for name in (*names, "drift_time")}
        label = f"{self.name}: {', '.join(names)}"
        return ErrorModel(name=label, touch=self.touch, seed=self.seed, **kept)

    def sensed_exactly(self) -> ErrorModel:
        """The same world and drives with calibrated joints, and sensors without errors.

        What is left is drawn as before. It is the best that any estimator could do.
        """
        sensed = (name for name in self.numbers if name not in NOT_SENSED)
        exact: dict[str, Any] = dict.fromkeys(sensed, 0.0)
        return replace(self, name=f"{self.name}, sensed exactly", **exact)

    def without_camera(self) -> ErrorModel:
        """The same with a camera that sees the object once, when a trial begins."""
        return replace(self, name=f"{self.name}, no camera", dropout=1.0, dropout_time=FOREVER)

    def to_dict(self) -> dict[str, Any]:
        """All fields as plain data."""
        return dict(finite(asdict(self)))


POSE_ERRORS = (
    "pose_noise",
    "turn_noise",
    "pose_drift",
    "turn_drift",
    "pose_bias",
    "turn_bias",
    "pose_rate",
    "pose_delay",
    "dropout",
)
"""Errors without which the object's pose and twist are exact."""

NO_ERROR = ("name", "touch", "seed")
"""Fields that are no error."""

EXAMPLE = "encoder_offset"
"""An error, for a message."""

NOT_SENSED = (
    "drift_time",
    "dry_friction",
    "torque_constant",
    "command_delay",
    "command_rate",
    "object_size",
    "object_mass",
    "object_center",
    "object_friction",
)
"""Errors of drives and of the world; the others are of sensors and of what stands between them and
the joints."""

FOREVER = 1e9
"""A time (s) that no trial lasts."""

ERROR_MODELS = Presets("error model", ErrorModel())
"""error models by their names; ``ideal`` has no error."""

AnyErrorModel: TypeAlias = ErrorModel | str
"""What is accepted as an error model: itself, the name of a preset, or the path of a file."""

register_errors = ERROR_MODELS.register


def named_errors(name: str, seed: int = 0) -> ErrorModel:
    """A registered error model with a seed.

    Raises:
        NotFoundError: There is none of that name.
        TaskError: The seed is no integer >= 0.
    """
    return ERROR_MODELS.named(name).seeded(seed)


LAB = ERROR_MODELS.register(
    ErrorModel(
        name="lab",
        encoder_offset=math.radians(1.0),
        encoder_noise=math.radians(0.05),
        encoder_step=math.radians(0.1),
        rate_noise=0.02,
        dry_friction=0.02,
        command_delay=0.003,
        command_rate=1000.0 / 3.0,
        pose_noise=0.001,
        turn_noise=math.radians(1.0),
        pose_rate=60.0,
        pose_delay=0.03,
        touch_noise=0.03,
        touch_scale=0.1,
        touch_step=0.01,
        touch_threshold=0.05,
        touch_place=0.0006,
        touch_rate=100.0,
        touch_delay=0.01,
        sliding_noise=0.002,
        object_mass=0.2,
        object_friction=0.3,
    )
)
"""A hand that was calibrated with care, good tactile pads, and a good camera.

What is no calibration is taken from data sheets and papers; docs/how/sensors.md names them.
"""

ROUGH = ERROR_MODELS.register(
    ErrorModel(
        name="rough",
        encoder_offset=math.radians(3.0),
        encoder_scale=0.01,
        encoder_noise=math.radians(0.1),
        encoder_step=math.radians(0.1),
        rate_noise=0.02,
        dry_friction=0.04,
        torque_constant=0.1,
        command_delay=0.004,
        command_rate=250.0,
        pose_noise=0.003,
        turn_noise=math.radians(3.0),
        pose_drift=0.0015,
        turn_drift=math.radians(1.5),
        drift_time=1.0,
        pose_rate=15.0,
        pose_delay=0.08,
        dropout=0.02,
        dropout_time=0.2,
        touch_noise=0.05,
        touch_scale=0.1,
        touch_step=0.01,
        touch_threshold=0.05,
        touch_place=0.0006,
        touch_rate=100.0,
        touch_delay=0.01,
        sliding_noise=0.002,
        object_size=0.02,
        object_mass=0.3,
        object_center=0.1,
        object_friction=0.4,
    )
)
"""A hand out of its box, a cheap camera, an object whose data sheet is wrong.

Pose noise is white and drifts besides: half as much again, over 1 s, as the estimate of a marker
does when the hand turns in the light. A camera loses the object behind a finger about once in 3 s
(2 % of 15 poses a second) for 0.2 s. Commands go over a bus of 250 Hz and act 4 ms late. Pads are
those of ``lab``, with more noise.
"""


def stream(seed: int, name: str) -> np.random.Generator:
    """The random numbers of one error."""
    key = (crc32(name.encode()),)
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


def hand_actuators(hand: Hand) -> NDArray[np.bool_]:
    """Which actuators (nu,) drive joints of the hand, not of an arm that carries it."""
    own = np.setdiff1d(np.arange(hand.nq), hand.arm_index)
    drives: NDArray[np.bool_] = (hand.actuation.moment[:, own] != 0).any(axis=1)
    return drives


@dataclass(frozen=True, kw_only=True, eq=False)
class Drawn:
    """What stays the same during a trial.

    Attributes:
        encoder_offset: (nq,), reading minus joint at a joint of 0, rad or m; 0 for an arm's.
        encoder_scale: (nq,), growth of the reading per joint, less 1 (-); 0 for an arm's.
        torque_constant: (nu,), true over nominal force of each actuator, less 1 (-).
        pose_bias: (3,), constant error of the object's position, m.
        turn_bias: (3,), rotation vector, rad, world axes.
        touch_scale: (fingers of the hand,), growth of a finger's felt force, less 1 (-).
        size: True over nominal lengths of the object (-).
        mass: True over nominal mass (-).
        center: (3,), centre of mass, as a share of half the extents, object's axes (-).
        friction: True over nominal friction (-).
    """

    encoder_offset: FloatArray
    encoder_scale: FloatArray
    torque_constant: FloatArray
    pose_bias: FloatArray
    turn_bias: FloatArray
    touch_scale: FloatArray
    size: float
    mass: float
    center: FloatArray
    friction: float

    @classmethod
    def of(cls, error_model: ErrorModel, hand: Hand) -> Drawn:
        """Draw for a hand."""
        nq, nu = hand.nq, len(hand.actuation.names)
        of_hand = np.ones(nq)
        of_hand[hand.arm_index] = 0.0

        def normal(name: str, n: int) -> FloatArray:
            numbers = stream(error_model.seed, name).standard_normal(n)
            return np.asarray(error_model.numbers[name] * numbers)

        def uniform(name: str, n: int) -> FloatArray:
            numbers = stream(error_model.seed, name).uniform(-1.0, 1.0, n)
            return np.asarray(error_model.numbers[name] * numbers)

        return cls(
            encoder_offset=of_hand * normal("encoder_offset", nq),
            encoder_scale=of_hand * normal("encoder_scale", nq),
            torque_constant=hand_actuators(hand) * uniform("torque_constant", nu),
            pose_bias=normal("pose_bias", 3),
            turn_bias=normal("turn_bias", 3),
            touch_scale=uniform("touch_scale", len(hand.fingers)),
            size=1.0 + float(uniform("object_size", 1)[0]),
            mass=1.0 + float(uniform("object_mass", 1)[0]),
            center=uniform("object_center", 3),
            friction=1.0 + float(uniform("object_friction", 1)[0]),
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain data, by the names of the attributes."""
        return {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in vars(self).items()}


PHRASES: Mapping[str, tuple[str, float, int]] = {
    "largest_encoder_offset_deg": ("joints up to {} degrees off", 0.0, 1),
    "largest_slide_offset_mm": ("slides up to {} mm off", 0.0, 1),
    "largest_encoder_scale_percent": ("joint scales up to {} % off", 0.0, 1),
    "largest_torque_percent": ("actuator forces up to {} % off", 0.0, 0),
    "pose_bias_mm": ("poses {} mm aside", 0.0, 1),
    "turn_bias_deg": ("poses turned by {} degrees", 0.0, 1),
    "largest_touch_percent": ("felt forces up to {} % off", 0.0, 0),
    "size_factor": ("size x {}", 1.0, 3),
    "mass_factor": ("mass x {}", 1.0, 2),
    "largest_center_percent": ("centre of mass up to {} % of half the extents aside", 0.0, 0),
    "friction_factor": ("friction x {}", 1.0, 2),
}
"""Phrase of each number, what it is without an error, and decimals that are shown."""


def drawn_numbers(drawn: Drawn, hand: Hand) -> dict[str, float]:
    """The draws of a trial as few numbers, by the names of ``PHRASES``; all of them.

    Args:
        drawn: What was drawn.
        hand: Whose joints it is about.
    """
    hinges = np.ones(hand.nq, dtype=bool)
    model = hand.pin_model
    for j, axis in enumerate(joint_axes(model)):
        if j:
            hinges[model.joints[j].idx_q] = axis[3:].any()
    turned = np.where(hinges, drawn.encoder_offset, 0.0)
    return {
        "largest_encoder_offset_deg": float(np.rad2deg(_largest(turned))),
        "largest_slide_offset_mm": 1e3 * _largest(drawn.encoder_offset[~hinges]),
        "largest_encoder_scale_percent": 100.0 * _largest(drawn.encoder_scale),
        "largest_torque_percent": 100.0 * _largest(drawn.torque_constant),
        "pose_bias_mm": 1e3 * float(np.linalg.norm(drawn.pose_bias)),
        "turn_bias_deg": float(np.rad2deg(np.linalg.norm(drawn.turn_bias))),
        "largest_touch_percent": 100.0 * _largest(drawn.touch_scale),
        "size_factor": drawn.size,
        "mass_factor": drawn.mass,
        "largest_center_percent": 100.0 * _largest(drawn.center),
        "friction_factor": drawn.friction,
    }


def drawn_text(numbers: Iterable[Mapping[str, float]]) -> str:
    """One line about the draws of some trials; "" if nothing was off.

    Of several trials it says the largest errors, and between what factors lie.
    """
    trials, said = list(numbers), []
    for name, (phrase, exact, digits) in PHRASES.items():
        values = [one[name] for one in trials if name in one]
        if any(value != exact for value in values):
            least, most = f"{min(values):.{digits}f}", f"{max(values):.{digits}f}"
            spread = name.endswith("_factor") and least != most
            said.append(phrase.format(f"{least} to {most}" if spread else most))
    return ", ".join(said)


def _largest(values: FloatArray) -> float:
    return float(np.abs(values).max(initial=0.0))
