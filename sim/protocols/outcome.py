"""``Outcome``: what became of one trial of a protocol, with what was recorded on the way.

The samples are those of any other trial (``sim.recording.Samples``): force closure of the contacts
that happened is decided by the code that judged the plan. A
``Case`` is one trial that can be sent to another process, run under ``Conditions``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Protocol

import numpy as np

from planner.arrays import finite
from planner.certify import NEAR, Neighbourhood
from planner.plan import GraspPlan
from planner.spatial import FloatArray
from sim.controllers import Event, MakeController
from sim.recording import Recording, Samples
from sim.scene.physics import PhysicsOptions
from sim.sensing.errors import ErrorModel
from sim.sensing.estimation import AnyEstimator
from sim.verdict import Fault, Reason


@dataclass(frozen=True, kw_only=True, eq=False)
class Outcome:
    """One trial.

    Attributes:
        index: Number of the trial in its protocol.
        name: What was done: "force +x", "shake rz".
        held: Whether the object was held to the end; a load that grows without end never is, and
            there ``largest_load_held`` counts.
        fault: Why and when it was not; None if it was.
        other_grasp: Of an object that was held by another grasp than was planned: which finger
            touched elsewhere, and how far off; "" otherwise, and where nothing compares them.
        fingers: Names of the columns of ``samples``, n.
        samples: What was judged, m samples.
        recording: States at the same times, of which pages are made; None where there are none.
        load: (m,), size of the disturbance at each sample: N, or N m for a pure torque; 0 without.
        unit: Unit of ``load``, "" where nothing is loaded.
        largest_load_held: Largest load under which the object came to rest; NaN where none grows.
        failure_load: Load under which it failed; infinite where the largest one was held.
        bound: What no control whatever could bear along this direction in the planned posture, by
            the certificate, with the friction of the simulation; NaN where none was worked out.
        bound_near: The same in any posture within ``planner.certify.NEAR`` of the planned one;
            infinite where none was found.
        stood: How far from the plan the grasp stood when it bore the most; None where nothing was
            borne.
        wrench: (6,), disturbance of load 1, N and N m, world axes about the centre of mass; zero
            where nothing is loaded.
        events: What the controller noticed, if it says so.
        conditions: What differed from the plan, and what the disturbance reached: name with unit ->
            number.
    """

    index: int
    name: str
    held: bool
    fault: Fault | None
    fingers: tuple[str, ...]
    samples: Samples
    load: FloatArray
    recording: Recording | None = None
    unit: str = ""
    largest_load_held: float = float("nan")
    failure_load: float = float("nan")
    bound: float = float("nan")
    bound_near: float = float("nan")
    stood: Neighbourhood | None = None
    wrench: FloatArray = field(default_factory=lambda: np.zeros(6))
    events: tuple[Event, ...] = ()
    conditions: Mapping[str, float] = field(default_factory=dict)
    other_grasp: str = ""

    @property
    def reason(self) -> Reason:
        """Why not held; "" if held."""
        return "" if self.fault is None else self.fault.reason

    @property
    def grows(self) -> bool:
        """Whether the load grew until the object was lost."""
        return math.isfinite(self.largest_load_held)

    @property
    def contradicts(self) -> bool:
        """Whether the simulation bore more than the certificate says anything could.

        That is so near the planned posture only: a grasp that has yielded further is another one,
        of which nothing is proven.
        """
        near = self.stood is not None and NEAR.holds(self.stood)
        return bool(near and self.largest_load_held > self.bound_near)

    @property
    def drift(self) -> tuple[float, float]:
        """Movement (mm) and turn (degrees) of the object in the palm at the last sample."""
        s = self.samples
        if len(s) == 0:
            return float("nan"), float("nan")
        return float(s.slip_mm[-1]), float(s.slip_deg[-1])

    @property
    def share_closed(self) -> float:
        """Share of the samples of the hold whose contacts close the grasp; NaN without a hold."""
        hold = self.samples.during("hold")
        return float(self.samples.closed[hold].mean()) if len(hold) else float("nan")

    @property
    def largest_utilisation(self) -> float:
        """Largest share of a finger's friction cone in use in the hold; NaN without contact."""
        used = self.samples.friction_utilisation[self.samples.during("hold")]
        known = used[np.isfinite(used)]
        return float(known.max()) if len(known) else float("nan")

    def to_row(self) -> dict[str, Any]:
        """One line of a table: numbers and words, None for what is not finite."""
        drift_mm, drift_deg = self.drift
        row: dict[str, Any] = {
            "index": self.index,
            "trial": self.name,
            "held": self.held,
            "reason": self.reason,
            "time_s": None if self.fault is None else self.fault.time,
            "largest_load_held": self.largest_load_held,
            "failure_load": self.failure_load,
            "bound": self.bound,
            "bound_near": self.bound_near,
            **self._stood_row(),
            "unit": self.unit,
            "drift_mm": drift_mm,
            "drift_deg": drift_deg,
            "closed_share": self.share_closed,
            "friction_used": self.largest_utilisation,
            "other_grasp": self.other_grasp,
            "detail": "" if self.fault is None else self.fault.detail,
            **self.conditions,
        }
        return dict(finite(row))

    def _stood_row(self) -> dict[str, Any]:
        """How far from the plan the grasp stood under the largest load, where there is one."""
        if self.stood is None:
            return {}
        return {
            "stood_off_mm": 1e3 * self.stood.shift,
            "stood_off_deg": float(np.rad2deg(self.stood.turn)),
            "tips_off_mm": 1e3 * self.stood.tips,
            "joints_off_deg": float(np.rad2deg(self.stood.joints)),
        }

    def to_dict(self) -> dict[str, Any]:
        """The row, and everything over time."""
        return {
            **self.to_row(),
            "wrench_per_load": self.wrench.tolist(),
            "fingers": list(self.fingers),
            "events": [asdict(event) for event in self.events],
            "over_time": {**self.samples.to_dict(), "load": finite(self.load)},
        }


AXES = ("+x", "-x", "+y", "-y", "+z", "-z")
"""Names of the six directions along the world's axes."""


def axis_of(i: int) -> FloatArray:
    """Unit vector (3,) of a name in ``AXES``."""
    out = np.zeros(3)
    out[i // 2] = 1.0 - 2.0 * (i % 2)
    return out


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """Under which all trials of a run take place.

    Attributes:
        physics: How MuJoCo computes.
        controller: Makes what drives the hand, out of the plan.
        error_model: Errors of sensors, drives and object; those of ``dexgraspbench`` and ``drake``
            are exact whatever it is.
        estimator: What tells the controller where the object is; see ``Simulation``.
    """

    physics: PhysicsOptions
    controller: MakeController
    error_model: ErrorModel = field(default_factory=ErrorModel)
    estimator: AnyEstimator | None = None


class Case(Protocol):
    """One trial of a protocol: plain data."""

    @property
    def index(self) -> int:
        """Its number."""
        ...

    @property
    def name(self) -> str:
        """What it is called."""
        ...

    def run(self, plan: GraspPlan, conditions: Conditions) -> Outcome:
        """Execute it."""
        ...
