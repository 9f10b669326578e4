"""``Policy``: a small network that corrects the playback of a plan, and its file.

At run time it is three products of matrices in NumPy. A file is an ``.npz`` without pickles: the
weights, the normalisation of the senses, and a text (JSON) that says what the policy is for.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.arrays import check_fields
from planner.errors import FileFormatError, HandError, NotFoundError, PlannerError, TaskError, shown
from planner.exchange.array_files import checked_small, read_npz
from planner.files.disk import whole_file
from planner.hands.hand import Hand
from planner.objects import GraspObject
from planner.plan import GraspPlan
from planner.spatial import FloatArray
from planner.system.package import written_by
from sim.learning.senses import AIM, SENSES, ObjectRange, SenseHistory, checked_senses
from sim.learning.trials import FRICTION, MASS
from sim.scene.physics import PhysicsOptions
from sim.sensing.errors import ErrorModel
from sim.sensing.estimation import NONE

POLICY_FORMAT, POLICY_VERSION = "opposable-policy", 4
"""What a file says it is, and the version of its contents. Version 1 had no ``estimator``; 2 did
not tell masses, frictions, physics and errors."""

RATE_HZ = 100.0
"""Decisions per second."""

ACTION_SCALE = 0.25
"""Change (rad) of a joint target by an action of 1: more than the servos of the Allegro-type hand
need for their whole torque (0.7 N m at 3 N m/rad)."""

FAR = 5.0
"""Largest deviation of a sense from its mean, in standard deviations: beyond, it is clipped."""

SAME_TURN = 0.01
"""Turns (degrees) that differ by less are the same."""

RATES = ("command_rate", "pose_rate", "touch_rate")
"""Numbers of an error model that are worse if they are smaller; 0 is every time step."""

MOST_NAMED = 3
"""Errors that a warning names; the others are counted."""


@dataclass(frozen=True, kw_only=True)
class PolicyFor:
    """What a policy was trained for.

    Attributes:
        hand: Name of the hand.
        joints: Its joints, in order.
        actuators: Its actuators, in order.
        fingers: Its fingers, in order.
        objects: Objects that it was trained on, a dimension ``a..b`` is a range in m.
        angle_deg: Turn that it was trained on, degrees.
        error_model: Name of the error model in which it was trained.
        errors: Its numbers and its sense of touch by their fields; empty if a file does not tell.
        physics: Numbers of the physics, friction aside; empty if a file does not tell.
        mass: Least and largest mass of the object, kg.
        friction: Least and largest sliding friction (-).
        rate_hz: Decisions per second.
        senses: Its inputs beside the plan.
        action_scale: Change of a joint target by an action of 1, rad.
        aim: Turn beyond the asked one at which its playback ends, rad.
        estimator: What tells it where the object is, a name out of ``sim.sensing.estimation``.
        command: What made it.
        written_by: Version that made it.
    """

    hand: str
    joints: tuple[str, ...]
    actuators: tuple[str, ...]
    fingers: tuple[str, ...]
    objects: str
    angle_deg: float
    error_model: str
    errors: Mapping[str, Any] = field(default_factory=dict)
    physics: Mapping[str, Any] = field(default_factory=dict)
    mass: tuple[float, float] = MASS
    friction: tuple[float, float] = FRICTION
    rate_hz: float = RATE_HZ
    senses: tuple[str, ...] = SENSES
    action_scale: float = ACTION_SCALE
    aim: float = AIM
    estimator: str = NONE
    command: str = ""
    written_by: str = field(default_factory=written_by)

    def __post_init__(self) -> None:
        """Check every number."""
        check_fields(self, ("angle_deg",), least=-360.0, most=360.0, unit="degrees")
        check_fields(self, ("rate_hz", "action_scale"), above=0.0)
        check_fields(self, ("aim",), least=0.0, unit="rad")
        check_fields(self, ("mass",), above=0.0, unit="kg")
        check_fields(self, ("friction",), above=0.0)

    @classmethod
    def of(cls, hand: Hand, **about: Any) -> PolicyFor:
        """For a hand, with what else is known."""
        return cls(
            hand=hand.name,
            joints=tuple(hand.joint_names),
            actuators=tuple(hand.actuation.names),
            fingers=tuple(hand.fingers),
            **about,
        )

    def check(self, hand: Hand) -> None:
        """Refuse another hand.

        Raises:
            HandError: Its name, joints, actuators or fingers differ.
        """
        for what, mine, given in (
            ("hand", self.hand, hand.name),
            ("joints", self.joints, tuple(hand.joint_names)),
            ("actuators", self.actuators, tuple(hand.actuation.names)),
            ("fingers", self.fingers, tuple(hand.fingers)),
        ):
            if mine != given:
                raise HandError(
                    f"this policy is for the {what} {_listed(mine)}, and the plan has "
                    f"{_listed(given)}; give a plan of {self.hand}, or a policy that was trained "
                    f"for {hand.name}: opposable learn {hand.name} {self.objects}"
                )

    def outside_training(
        self,
        item: GraspObject,
        angle_deg: float | None,
        physics: PhysicsOptions | None = None,
        error_model: ErrorModel | None = None,
    ) -> str:
        """In one line what it was not trained for, "" if there is nothing.

        Args:
            item: The object, with its mass.
            angle_deg: Turn about the vertical that is asked for, degrees; None for a movement of
                another kind, or none.
            physics: How MuJoCo computes, with the friction; not looked at if None.
            error_model: Errors of sensors, drives and object; not looked at if None.
        """
        beyond = []
        if not ObjectRange(self.objects).holds(item):
            beyond.append(f"the object is {item.name}")
        if angle_deg is None:
            beyond.append("the movement is no turn about the vertical")
        elif abs(angle_deg - self.angle_deg) > SAME_TURN:
            beyond.append(f"the turn is {angle_deg:g} degrees")
        if not self.mass[0] <= item.mass <= self.mass[1]:
            beyond.append(f"the mass is {item.mass:g} kg ({_range(self.mass)})")
        if physics is not None and not self.friction[0] <= physics.mu <= self.friction[1]:
            beyond.append(f"the friction is {physics.mu:g} ({_range(self.friction)})")
        if physics is not None and self.physics and self.physics != physics_numbers(physics):
            beyond.append(f"the physics is {physics.label}")
        larger = [] if error_model is None else self._larger_errors(error_model)
        if larger:
            more = len(larger) - MOST_NAMED
            named = ", ".join(larger[:MOST_NAMED]) + (f" and {more} more" if more > 0 else "")
            beyond.append(f"errors are larger than in its training: {named}")
        if not beyond:
            return ""
        *first, last = beyond
        listed = f"{', '.join(first)} and {last}" if first else last
        return (
            f"the policy was trained for {self.objects} turned by {self.angle_deg:g} degrees, and "
            f"{listed}: expect less of it"
        )

    def _larger_errors(self, error_model: ErrorModel) -> list[str]:
        """Errors of an error model that are larger than any that it was trained with, by name."""
        if not self.errors:
            known = error_model.ideal or error_model.name == self.error_model
            return [] if known else [f"those of {error_model.name}, as far as is known"]
        worse = [
            f"{name} {value:g}"
            for name, value in error_model.numbers.items()
            if name != "drift_time" and _worse(name, value, self.errors.get(name, 0.0))
        ]
        exact = ErrorModel().touch
        if error_model.touch not in (exact, self.errors.get("touch", exact)):
            worse.append(f"touch by {error_model.touch}")
        return worse


@dataclass(frozen=True, kw_only=True, eq=False)
class Policy:
    """Senses to actions: layers of rectified sums, the last one linear, clipped to [-1, 1].

    ``sim.learning.policy_controller`` makes controllers of it.

    Attributes:
        about: What it was trained for.
        mean: (m,), of the senses.
        scale: (m,), their standard deviations.
        weights: Matrices (inputs, outputs), first layer first.
        biases: Vectors (outputs,).
    """

    about: PolicyFor
    mean: NDArray[np.float32]
    scale: NDArray[np.float32]
    weights: tuple[NDArray[np.float32], ...]
    biases: tuple[NDArray[np.float32], ...]

    def __post_init__(self) -> None:
        """Check shapes and numbers.

        Raises:
            TaskError: Layers that do not fit each other or the hand, or a number that is none.
        """
        sizes = [len(self.mean), *(len(b) for b in self.biases)]
        shapes = list(pairwise(sizes))
        fits = [w.shape for w in self.weights] == shapes and len(self.scale) == sizes[0]
        if not fits or not shapes or sizes[-1] != len(self.about.actuators):
            raise TaskError(
                f"layers of shapes {[w.shape for w in self.weights]} with {sizes[0]} senses do not "
                f"make actions for {len(self.about.actuators)} actuators; train the policy anew"
            )
        every = [self.mean, self.scale, *self.weights, *self.biases]
        if not all(np.isfinite(a).all() for a in every) or not (self.scale > 0).all():
            raise TaskError("weights that are not finite, or a scale that is not above 0")

    @property
    def digest(self) -> str:
        """SHA-256 of weights and normalisation: tells two policies apart, whatever their files."""
        content = hashlib.sha256()
        for array in (self.mean, self.scale, *self.weights, *self.biases):
            content.update(np.ascontiguousarray(array).tobytes())
        return content.hexdigest()

    def act(self, senses: NDArray[Any]) -> FloatArray:
        """Actions (..., nu) for senses (..., m), each in [-1, 1]."""
        x = normalised(senses, self.mean, self.scale)
        for w, b in zip(self.weights[:-1], self.biases[:-1], strict=True):
            x = np.maximum(x @ w + b, np.float32(0.0))
        x = x @ self.weights[-1] + self.biases[-1]
        return np.asarray(np.minimum(np.maximum(x, -1.0), 1.0), dtype=np.float64)

    def save(self, path: Path | str) -> None:
        """Write it to a file.

        Raises:
            FileFormatError: The file cannot be written.
        """
        header = {"format": POLICY_FORMAT, "version": POLICY_VERSION, **asdict(self.about)}
        arrays: dict[str, NDArray[Any]] = {
            "header": np.frombuffer(json.dumps(header).encode(), dtype=np.uint8),
            "mean": self.mean,
            "scale": self.scale,
        }
        for k, (w, b) in enumerate(zip(self.weights, self.biases, strict=True)):
            arrays |= {f"weights{k}": w, f"biases{k}": b}
        with whole_file(Path(path)) as stream:
            np.savez(stream, allow_pickle=False, **arrays)

    @classmethod
    def load(cls, path: Path | str, *, hand: Hand | None = None) -> Policy:
        """Read one from a file.

        Args:
            path: The file.
            hand: Whose it is to be; any if None.

        Raises:
            FileFormatError: There is no such file, it is none of these, or of another version.
            HandError: It is for another hand.
        """
        file = Path(path)
        if file.is_dir():
            raise FileFormatError(f"{path} is a folder; give the file policy.npz in it")
        try:
            arrays = read_npz(file)
            header = json.loads(checked_small(arrays["header"], "header").tobytes().decode())
            kind, version = header.pop("format"), header.pop("version")
        except NotFoundError as error:
            raise FileFormatError(
                f"there is no policy {path}; make one: opposable learn HAND OBJECT"
            ) from error
        except (FileFormatError, ValueError, KeyError, AttributeError, RecursionError) as error:
            raise FileFormatError(
                f"{path} is no policy, or damaged ({error}); give a file that "
                "'opposable learn' wrote"
            ) from error
        if kind != POLICY_FORMAT or version not in range(1, POLICY_VERSION + 1):
            raise FileFormatError(
                f"{path} is of format {shown(kind)}, version {shown(version)}; this version reads "
                f"{POLICY_FORMAT!r}, version {POLICY_VERSION}; train the policy anew"
            )
        try:
            if "reality" in header:  # its name in files of versions 1 to 3
                header["error_model"] = header.pop("reality")
            for name in ("joints", "actuators", "fingers", "senses", "mass", "friction"):
                if name in header:
                    header[name] = tuple(header[name])
            about = PolicyFor(**header)
            checked_senses(about.senses)
            count = sum(name.startswith("weights") for name in arrays)
            found = cls(
                about=about,
                mean=arrays["mean"].astype(np.float32),
                scale=arrays["scale"].astype(np.float32),
                weights=tuple(arrays[f"weights{k}"].astype(np.float32) for k in range(count)),
                biases=tuple(arrays[f"biases{k}"].astype(np.float32) for k in range(count)),
            )
        except (KeyError, TypeError, ValueError, PlannerError) as error:
            raise FileFormatError(f"{path} is damaged: {error}; train the policy anew") from error
        if hand is not None:
            about.check(hand)
        return found

    def check_plan(self, plan: GraspPlan) -> None:
        """Refuse a plan that it was not trained for.

        Raises:
            HandError: Another hand.
            TaskError: The senses of its hand are not as many as it was trained with.
        """
        self.about.check(plan.task.hand)
        size = SenseHistory(plan.task, self.about.senses).size
        if size != len(self.mean):
            raise TaskError(
                f"this policy takes {len(self.mean)} numbers, and {plan.task.hand.name} tells "
                f"{size}; train it anew"
            )


def normalised(
    senses: NDArray[Any], mean: NDArray[np.float32], scale: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Senses (..., m) in standard deviations from their means (m,), clipped to ``FAR``."""
    x = (senses.astype(np.float32) - mean) / scale
    return np.asarray(np.minimum(np.maximum(x, np.float32(-FAR)), np.float32(FAR)))


def physics_numbers(physics: PhysicsOptions) -> dict[str, Any]:
    """What a policy's file says of the physics: all numbers but name and friction."""
    return {k: v for k, v in physics.to_dict().items() if k not in ("name", "mu")}


def error_numbers(error_model: ErrorModel) -> dict[str, Any]:
    """What a policy's file says of the errors it was trained with."""
    return {**error_model.numbers, "touch": error_model.touch}


def _worse(name: str, now: float, trained: float) -> bool:
    if name in RATES:
        return now > 0 and (trained == 0 or now < trained)
    return now > trained


def _range(ends: tuple[float, float]) -> str:
    return f"trained with {ends[0]:g} to {ends[1]:g}"


def _listed(names: str | tuple[str, ...]) -> str:
    return names if isinstance(names, str) else ", ".join(names)
