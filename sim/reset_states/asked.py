"""``StatesAsked``: what is asked of a cache of states, and the draws that make them differ.

A *cell* is one object in one size. Its name names its files.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from planner.arrays import check_fields, checked_count
from planner.batch.recipe import recipe_of
from planner.contacts import MOST_FRICTION
from planner.errors import ObjectError, TaskError
from planner.exchange.dexgraspbench.squeeze import without_servos
from planner.files.whole import plain_name
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.objects import GraspObject, parse_object
from planner.shapes import Mesh, Shape, shape_from_dict, shape_to_dict
from planner.task import GraspTask
from sim.physics import PhysicsOptions

G = 9.81
"""Gravity, m/s2."""

SCALES = (0.01, 100.0)
"""Range of a size relative to the given one (-)."""

MOST_STATES = 10_000_000
"""Most states of a cell: 1 GB of rows of a 16-joint hand."""

MOST_PLANS = 100_000
"""Most plans of one kind and cell."""


@dataclass(frozen=True, kw_only=True)
class Draws:
    """From what the start of a hold is drawn; everything about a planned pose and its commands.

    Attributes:
        position: Standard deviation of the object's offset along each axis, m.
        angle: Standard deviation of its rotation vector along each axis, rad.
        joints: Standard deviation of each finger joint and of its target, rad (m for slides).
        squeeze: Least and greatest factor of the planned squeeze (-), uniform in its logarithm.
        friction: Least and greatest sliding friction (-), uniform.
        mass: Least and greatest mass, kg, uniform; None for 0.5 to 1.5 times the object's.
        gravity: Direction (3,) in the frame of the hand's base; None for one drawn evenly from the
            sphere.
    """

    position: float = 0.002
    angle: float = 0.08
    joints: float = 0.04
    squeeze: tuple[float, float] = (1.0, 2.0)
    friction: tuple[float, float] = (0.6, 1.2)
    mass: tuple[float, float] | None = None
    gravity: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        """Check every number."""
        check_fields(self, ("position", "angle", "joints"), what="draws: ", least=0.0)
        check_fields(self, ("squeeze", "friction", "mass"), what="draws: ", above=0.0)
        check_fields(self, ("gravity",), what="draws: ")
        for name in ("squeeze", "friction", "mass"):
            pair = getattr(self, name)
            if pair is not None and not pair[0] <= pair[1]:
                raise TaskError(
                    f"{name} is drawn from {pair[0]:g} to {pair[1]:g}; give two finite numbers > "
                    "0, the smaller one first"
                )
        if self.gravity is not None and not np.linalg.norm(self.gravity) > 0:
            raise TaskError('gravity has no direction; give one, such as -1,0,0, or "random"')


@dataclass(frozen=True, kw_only=True)
class StatesAsked:
    """What is asked for.

    Attributes:
        hand: What ``load_hand`` takes.
        objects: Specifications as ``parse_object`` takes them.
        n: States of every object and size.
        seed: Same seed, same states.
        scales: Sizes relative to the specification (-).
        grasps: Grasps that are planned per object and size.
        motions: Turns that are planned, each of about seven verified poses.
        gaits: Gaits that are planned.
        turn: Angle of a turn, rad; a gait's is twice that.
        fingers: Names of those that take part; all that the hand can use if empty.
        mu: Friction that planning relies on (-).
        draws: From what the start of a hold is drawn.
        physics: How MuJoCo computes, here and in the scene that is written.
    """

    hand: str
    objects: tuple[str, ...]
    n: int
    seed: int = 0
    scales: tuple[float, ...] = (1.0,)
    grasps: int = 200
    motions: int = 30
    gaits: int = 4
    turn: float = float(np.pi / 6)
    fingers: tuple[str, ...] = ()
    mu: float = 0.5
    draws: Draws = field(default_factory=Draws)
    physics: PhysicsOptions = field(default_factory=PhysicsOptions)

    def __post_init__(self) -> None:
        """Check counts and sizes; what concerns hand and objects is found out by planning."""
        counts = (("n", 1, MOST_STATES), ("seed", 0, 2**63 - 1))
        for name, least, most in counts:
            checked_count(name, getattr(self, name), least=least, most=most, error=TaskError)
        for name in ("grasps", "motions", "gaits"):
            checked_count(name, getattr(self, name), least=0, most=MOST_PLANS, error=TaskError)
        if self.grasps + self.motions + self.gaits == 0:
            raise TaskError("no grasps, motions or gaits are to be planned; ask for some of them")
        if not self.objects:
            raise TaskError("there are no objects; name at least one")
        if not self.scales:
            raise TaskError("there are no scales; give at least one")
        check_fields(self, ("scales",), least=SCALES[0], most=SCALES[1])
        check_fields(self, ("turn",), unit="rad")
        check_fields(self, ("mu",), least=0.0, most=MOST_FRICTION)
        if not 0 < abs(self.turn) <= np.pi:
            raise TaskError(f"turn is {np.degrees(self.turn):g} degrees; give up to 180, not 0")

    def to_dict(self) -> dict[str, Any]:
        """As plain data that a file keeps; n is left out, since more states of it may follow."""
        data = asdict(replace(self, physics=PhysicsOptions()))
        data.pop("n")
        return json_plain(data | {"physics": self.physics.to_dict()})


def json_plain(data: dict[str, Any]) -> dict[str, Any]:
    """Data as it comes back from JSON: tuples are lists."""
    plain: dict[str, Any] = json.loads(json.dumps(data))
    return plain


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One object in one size.

    Attributes:
        name: Name of its files.
        object: Its specification.
        scale: Its size relative to that (-).
        recipe: Its task as text: without a table, so that grasps come from all sides.
        mass: Mass that its scene has, kg.
        number: 32 bits out of the shape that its draws depend on, beside the seed.
    """

    name: str
    object: str
    scale: float
    recipe: str
    mass: float
    number: int


def cells_of(asked: StatesAsked) -> tuple[Hand, list[tuple[Cell, GraspTask]]]:
    """The hand and every object in every size, with its task.

    Raises:
        PlannerError: Hand or object cannot be loaded, two objects have one name, or the hand cannot
            be commanded by positions or hangs on an arm.
    """
    hand = load_hand(asked.hand)
    if reason := without_servos(hand):
        raise TaskError(
            f"{reason}; states are held by position targets: give a hand with position servos"
        )
    if hand.arm is not None:
        raise TaskError(
            f"{hand.name} hangs on an arm; states are those of a hand on a fixed base: give the "
            "hand alone"
        )
    cells: list[tuple[Cell, GraspTask]] = []
    for spec in asked.objects:
        given = parse_object(spec)
        for scale in asked.scales:
            item = scaled(given, scale)
            task = GraspTask.create(
                hand, item, table_height=None, mu=asked.mu, fingers=asked.fingers or None
            )
            label = given.shape.spec if given.name == given.shape.kind else given.name
            name = plain_name(f"{label}-s{scale:g}")
            if any(cell.name == name for cell, _ in cells):
                raise ObjectError(f"two objects are called {name}; give each object and size once")
            recipe = recipe_of(task)
            number = int(hashlib.sha256(recipe.encode()).hexdigest()[:8], 16)
            cell = Cell(
                name=name, object=spec, scale=scale, recipe=recipe, mass=item.mass, number=number
            )
            cells.append((cell, task))
    return hand, cells


def scaled(item: GraspObject, scale: float) -> GraspObject:
    """The object with all lengths multiplied; its mass stays.

    Raises:
        ObjectError: The result is too small or too large for a shape.
    """
    if scale == 1.0:
        return item
    return replace(item, shape=_scaled_shape(item.shape, scale))


def _scaled_shape(shape: Shape, scale: float) -> Shape:
    if type(shape) is Mesh:  # not a shape that is made of triangles by its sizes
        if shape.source is None:
            return Mesh.from_triangles(shape.vertices * scale, shape.faces)
        source = shape.source
        return Mesh.load(source.path, scale=source.scale * scale, repair=source.repair)
    data = {
        key: _times(value, scale) if key.endswith("_m") else value
        for key, value in shape_to_dict(shape).items()
    }
    return shape_from_dict(data)


def _times(value: Any, scale: float) -> Any:
    return [v * scale for v in value] if isinstance(value, list) else value * scale
