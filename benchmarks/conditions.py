"""Randomised conditions of a turn in the hand, hidden from the planner; how objects stand.

Meshes of the project are scaled as a whole, so that they are as wide as the cylinders and blocks of
a trial; files, and names with sizes of their own, are taken as they are. All stand as high as they
can, as cylinders and blocks do: a hand from above needs room below its fingertips.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Literal, TypeAlias

import numpy as np
import typer

from planner.objects import object_names, parse_object
from planner.shapes import SIZED_SHAPES, Shape
from planner.shapes.made import Made
from planner.spatial import SE3, FloatArray

HeightOption = Annotated[
    float, typer.Option(min=0.04, help="Height of cylinder, block and ellipsoid, m.")
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


SURE_DEG = 10.0
"""Least tilt (degrees) that an object must bear to stand higher than in its surest pose."""

ALIKE = 0.001
"""Difference of two heights (m) that is none: the surer pose is taken."""


def scaled_spec(spec: str, width: float) -> str:
    """The specification of an object that is about this wide, m, if its size is not given.

    Width is the narrower side of its bounding box as it stands.
    """
    name = spec.strip().lower()
    if name not in object_names() or not issubclass(SIZED_SHAPES[name], Made):
        return spec
    own, sizes = _default(name)
    factor = width / own
    scaled = (size if is_pure else round(factor * size, 5) for size, is_pure in sizes)
    return f"{name}:{'x'.join(f'{size:g}' for size in scaled)}"


@lru_cache
def _default(name: str) -> tuple[float, tuple[tuple[float, bool], ...]]:
    """Width (m) of a mesh of the project, and its sizes, with whether they are pure numbers."""
    shape = parse_object(name).shape
    width = float(_extents(shape, standing(shape).rotation)[:2].min())
    sizes = zip(shape.sizes, shape.size_names, strict=True)
    return width, tuple((size, of in shape.pure_numbers) for size, of in sizes)


def standing(shape: Shape) -> SE3:
    """``T_world_object`` on a table at height 0, as high as the object stands surely."""
    poses = shape.resting_poses()
    sure = [k for k, pose in enumerate(poses) if (pose.margin_deg or SURE_DEG) >= SURE_DEG] or [0]
    heights = [float(_extents(shape, poses[k].rotation)[2]) for k in sure]
    # the first one is the surest
    return shape.resting_pose(
        index=next(k for k, h in zip(sure, heights, strict=True) if h > max(heights) - ALIKE)
    )


def _extents(shape: Shape, rotation: FloatArray) -> FloatArray:
    """Extents (3,) along the world's axes, m."""
    return np.array([shape.support(axis) + shape.support(-axis) for axis in rotation])
