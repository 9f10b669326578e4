"""Randomised conditions of a trial of a turn in the hand, hidden from the planner."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from benchmarks.meshes import scaled_spec

Kind: TypeAlias = Literal["cylinder", "block", "sphere", "ellipsoid"]

KINDS: tuple[Kind, ...] = Kind.__args__  # type: ignore[attr-defined]

SIZE = (0.05, 0.07)
"""Diameter of cylinder and sphere, width of a block and of a mesh that takes sizes, widths of an
ellipsoid, m."""

FRICTION = (0.5, 1.0)
"""Sliding friction in simulation (-)."""

MASS = (0.05, 0.3)
"""Mass, kg."""

BELIEVED_MU = 0.9 * FRICTION[0]
"""Friction (-) that planner and controller rely on: 10 % below the least that is drawn."""

SHIFT, HEADING = 0.003, np.deg2rad(5.0)
"""Largest position error along x and y (m) and heading error (rad) of the object on the table."""

PUSH_FORCE, PUSH_TIME = 0.4, 0.3
"""Force (N) and duration (s) of the push: horizontal, in a random direction, at a random time of
the turn."""

PUSH_UNTIL, REGRASP_RATE = 1.2, 0.2
"""Latest start of the push (s after the turn began), unless the motion is shorter
(``benchmarks.manipulate.Turn.draw``); and a turning rate (rad/s) that no turn by regrasps reaches:
the turn lasts longer than its angle over this rate."""

PLACE = 0.15
"""Distance (m) from the object to the place where it is put down, in a random direction."""

REGRASP_FRICTION = (0.7, 1.0)
"""Sliding friction (-) in turns by regrasps. The planner knows the lower bound, and keeps a margin
of 10 % itself while a finger is away."""

REGRASP_MASS = 0.1
"""Mass (kg) that turns by regrasps are planned for: at the largest mass and the least friction no
four fingers of the Shadow-type hand carry the weight within the planner's margins. The true mass is
drawn from ``MASS``."""


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """True conditions of one trial.

    Attributes:
        spec: The object.
        mass: kg.
        mu: Sliding friction (-).
        shift: Position error on the table, x and y, m.
        heading: Heading error, rad.
        push: Force (x, y) of the push, N.
        push_after: Its start, s after the turn began.
        place: Where the object is to be put, x and y, m.
    """

    spec: str
    mass: float
    mu: float
    shift: tuple[float, float]
    heading: float
    push: tuple[float, float]
    push_after: float
    place: tuple[float, float]

    @classmethod
    def draw(
        cls,
        kind: str,
        height: float,
        rng: np.random.Generator,
        friction: tuple[float, float] = FRICTION,
        push_until: float = PUSH_UNTIL,
    ) -> Conditions:
        """Conditions of one trial; sizes to a tenth of a millimetre.

        Args:
            kind: One of ``KINDS``, or the specification of another object.
            height: Of cylinder, block and ellipsoid, m.
            rng: Draws.
            friction: Range of the sliding friction (-).
            push_until: Latest begin of the push, s.
        """
        a, b = np.round(rng.uniform(*SIZE, size=2), 4).tolist()
        specs = {
            "cylinder": f"cylinder:{a / 2:g}x{height:g}",
            "block": f"box:{a:g}x{a:g}x{height:g}",
            "sphere": f"sphere:{a / 2:g}",
            "ellipsoid": f"ellipsoid:{a:g}x{b:g}x{height:g}",
        }
        mass, mu = float(rng.uniform(*MASS)), float(rng.uniform(*friction))
        x, y = rng.uniform(-SHIFT, SHIFT, size=2).tolist()
        heading = float(rng.uniform(-HEADING, HEADING))
        side, way = rng.uniform(0.0, 2.0 * np.pi, size=2).tolist()
        return cls(
            spec=specs[kind] if kind in specs else scaled_spec(kind, a),
            mass=mass,
            mu=mu,
            shift=(x, y),
            heading=heading,
            push=(PUSH_FORCE * math.cos(side), PUSH_FORCE * math.sin(side)),
            push_after=float(rng.uniform(0.0, push_until)),
            place=(PLACE * math.cos(way), PLACE * math.sin(way)),
        )
