"""What a trial of a turn in the hand meets: drawn at random, and not told to the planner."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from sim.bench.meshes import scaled_spec

__all__ = [
    "BELIEVED_MU",
    "FRICTION",
    "KINDS",
    "MASS",
    "PUSH_TIME",
    "PUSH_UNTIL",
    "REGRASP_FRICTION",
    "REGRASP_MASS",
    "REGRASP_RATE",
    "SIZE",
    "Conditions",
    "Kind",
]

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
"""Friction (-) that planner and controller rely on: a tenth below the least that there is."""

SHIFT, HEADING = 0.003, np.deg2rad(5.0)
"""Largest error of the place along either axis (m), and of the heading (rad)."""

PUSH_FORCE, PUSH_TIME = 0.4, 0.3
"""The push, N and s: horizontal, from any side, at some time of the turn."""

PUSH_UNTIL, REGRASP_RATE = 1.2, 0.2
"""Latest begin of the push, s since the turn began, unless the object is moved for a shorter time
(``sim.bench.manipulate.Turn.draw``); and a rate (rad/s) that no turn by
regrasps reaches: at the angle over it they are not over yet."""

PLACE = 0.15
"""Distance (m) from the object to where it is put, in any direction."""

REGRASP_FRICTION = (0.7, 1.0)
"""Sliding friction (-) where fingers move on between strokes; the planner knows the lower bound,
and leaves a tenth of it itself while a finger is away."""

REGRASP_MASS = 0.1
"""Mass (kg) that such turns are planned for: with the largest there is and the least friction no
four fingers of the Shadow-type hand bear the weight within the planner's margins. What there really
is stays ``MASS``."""


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """What there really is in one trial.

    Attributes:
        spec: The object.
        mass: kg.
        mu: Sliding friction (-).
        shift: Where it stands beside its place, x and y, m.
        heading: How it is turned there, rad.
        push: Force (x, y) of the push, N.
        push_after: When it begins, since the beginning of the turn, s.
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
