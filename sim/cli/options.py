"""Options that commands share, each declared once: its type, help text, unit and group.

A command takes a group of options, a dataclass, as a parameter; each of its fields is an option::

    @command
    def plan(hand: HandArgument, *, request: PlanOptions) -> None: ...
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from dataclasses import MISSING, fields, is_dataclass
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, get_type_hints

import typer

from sim.cli.common import errors_for_people

if TYPE_CHECKING:
    from planner.motion.path import AnyAttitude
    from planner.spatial import FloatArray

Command = TypeVar("Command", bound=Callable[..., None])

SCENE, GRIP, MOVEMENT, SEARCH, TRIAL = (
    "Object and surroundings",
    "Hand and grip",
    "Movement",
    "Search",
    "Trial",
)
"""Groups of options in the help of a command; what is in none is about output."""


def option(
    help: str, metavar: str | None = None, panel: str | None = None, *names: str, **more: Any
) -> Any:
    """An option as Typer takes it.

    Args:
        help: What it is, with its unit.
        metavar: What stands for its value.
        panel: Group in the help.
        names: On the command line; "--" and the parameter's name if there is none.
        more: Further arguments of ``typer.Option``, such as ``min``.
    """
    return typer.Option(*names, help=help, metavar=metavar, rich_help_panel=panel, **more)


def flag(name: str, help: str, panel: str | None = None) -> Any:
    """An option without a value."""
    return option(help, "", panel, name)


def argument(help: str, metavar: str) -> Any:
    """An argument as Typer takes it."""
    return typer.Argument(help=help, metavar=metavar)


HAND = "Its name, hand.toml, MJCF or URDF file."
OBJECT = (
    "box, box:0.05x0.05x0.08 (m), part.stl*0.001, scene.xml#body; sphere, cylinder, capsule, "
    "ellipsoid, mug, lbracket, torus, hammer, superquadric, knot, cup, bowl, tube..."
)
HandArgument = Annotated[str, argument(HAND, "HAND")]
ObjectArgument = Annotated[str, argument(OBJECT, "OBJECT")]
SeenArgument = Annotated[
    str,
    argument(f"{OBJECT}; or what cameras saw: cloud.ply, .pcd, .xyz, .npy, .json", "OBJECT"),
]
ObjectsArgument = Annotated[list[str], argument("Objects as `plan` takes them.", "OBJECT...")]
PlanArgument = Annotated[Path, argument("A plan file.", "PLAN")]

MassOption = Annotated[float | None, option("Mass, kg; 0.1 if not given.", "KG", SCENE)]
StandOption = Annotated[
    float,
    option("Height of a stand under the object, m.", "M", SCENE, min=0.0, show_default=False),
]
FingersOption = Annotated[
    str | None, option("Those that take part: thumb,index,ring", "NAMES", GRIP)
]
TypeOption = Annotated[
    str | None,
    option(
        "What touches: fingertip, pinch, tripod, lateral, power, hook, palms, any.", "TYPE", GRIP
    ),
]
MuOption = Annotated[float, option("Sliding friction relied on (-).", "MU", GRIP)]
JointErrorOption = Annotated[
    float | None,
    option(
        "Standard deviation of the encoders' errors, for which fingers get room; that of "
        "--error-model if not given.",
        "DEG",
        GRIP,
        min=0.0,
    ),
]

NO_SHIFT, USUAL_TURN = "0,0,0", "z:90"
"""What is done if nothing is said: no translation, and this turn where there is no translation."""

RotateOption = Annotated[
    str | None,
    option(
        f"Axis (world) and degrees: y:30, 0,0,1:30; {USUAL_TURN} if neither this nor --shift is "
        "given.",
        "TURN",
        MOVEMENT,
    ),
]
ShiftOption = Annotated[
    str, option("Translation in the hand, m, world.", "X,Y,Z", MOVEMENT, show_default=False)
]

AttitudeOption = Annotated[
    str,
    option(
        "Attitude of the hand while it turns or moves the object: down as it grasps, sideways, up "
        "(the palm), or roll, pitch, yaw in degrees about the world's axes.",
        "NAME|R,P,Y",
        MOVEMENT,
    ),
]

SeedOption = Annotated[int, option("Same seed, same result.", "N", min=0)]
AttemptsOption = Annotated[int, option("Attempts before giving up.", "N", SEARCH, min=1)]
ObjectiveOption = Annotated[
    str,
    option(
        "epsilon, min_weight, task, robustness, torque, manipulability, limits; several with "
        "weights: epsilon:1,torque:0.5; or none.",
        "NAMES",
        SEARCH,
    ),
]
RoundsOption = Annotated[
    int | None, option("Rounds of work on the objectives.", "N", SEARCH, min=0)
]
WorkersOption = Annotated[int, option("Processes; -1 for one per core.", "N")]

ControllerOption = Annotated[
    str,
    option(
        "feedforward: planned forces; impedance: a loop holds the object; policy:FILE.",
        "NAME",
        TRIAL,
    ),
]
SimMuOption = Annotated[float | None, option("Sliding friction in simulation (-).", "MU", TRIAL)]
PhysicsOption = Annotated[
    str,
    option(
        "ours, mujoco-default, menagerie, dexgraspbench, or a TOML or JSON file.", "NAME", TRIAL
    ),
]
ErrorModelOption = Annotated[str, option("Errors: ideal, lab, rough, or a file.", "NAME", TRIAL)]
ErrorSeedOption = Annotated[
    int | None, option("Of what --error-model draws; 0.", "N", TRIAL, min=0)
]
EstimateOption = Annotated[
    str | None, option("Object's pose by: all, touch, contact, none.", "NAME", TRIAL)
]
PadsOption = Annotated[str | None, option("Touch: exact, taxels, effort, binary.", "SENSE", TRIAL)]
ViewOption = Annotated[bool, flag("--view", "Show it in MuJoCo's viewer.", TRIAL)]
VideoOption = Annotated[
    Path | None, option("Write a film here: run.mp4, run.webp or run.gif.", "FILE")
]
PictureOption = Annotated[Path | None, option("Write a picture (PNG) here.", "FILE")]
ArrowsOption = Annotated[bool, flag("--arrows", "Draw contact forces into pictures and film.")]
VerboseOption = Annotated[bool, flag("--verbose", "Print what explains the verdict too.")]
JsonOption = Annotated[bool, flag("--json", "Print JSON for machines on stdout.")]


def with_options(command: Command) -> Command:
    """A command for Typer: a parameter of a dataclass type becomes an option for each field."""
    parameters: list[inspect.Parameter] = []
    groups: dict[str, type] = {}
    for parameter in inspect.signature(command, eval_str=True).parameters.values():
        group = parameter.annotation
        if not (isinstance(group, type) and is_dataclass(group)):
            parameters.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY))
            continue
        groups[parameter.name] = group
        hints = get_type_hints(group, include_extras=True)
        parameters += [
            inspect.Parameter(
                field.name,
                inspect.Parameter.KEYWORD_ONLY,
                default=inspect.Parameter.empty if field.default is MISSING else field.default,
                annotation=hints[field.name],
            )
            for field in fields(group)
        ]

    @wraps(command)
    def called(**given: Any) -> None:
        hand = given.get("hand")
        item = given.get("object") or given.get("objects") or given.get("tool")
        if hand and item:
            _refuse_swapped(hand, item if isinstance(item, str) else item[0])
        for name, group in groups.items():
            given[name] = group(**{f.name: given.pop(f.name) for f in fields(group)})
        command(**given)

    stated: Any = called
    stated.__signature__ = inspect.Signature(parameters)
    stated.__annotations__ = {p.name: p.annotation for p in parameters}
    stated_as: Command = stated
    return stated_as


def _refuse_swapped(hand: str, object: str) -> None:
    """Say so where the object, or the tool, stands before the hand.

    Raises:
        TaskError: It does.
    """
    from planner.errors import TaskError
    from planner.hands.catalog import foreign_hand_names, hand_names
    from planner.objects import object_names

    if object not in (*hand_names(), *foreign_hand_names()):
        return
    from planner.tools import tool_names

    for kind, names in (("an object", object_names()), ("a tool", tool_names())):
        if hand.split(":")[0] in names:
            raise TaskError(
                f"{hand!r} is {kind} and {object!r} a hand; the hand comes first: {object} {hand}"
            )


def command(function: Command) -> Command:
    """A command: its groups of options spread out, its errors for people."""
    return errors_for_people()(with_options(function))


def names(text: str) -> list[str]:
    """Names out of a comma-separated list; empty ones are dropped.

    Raises:
        TaskError: There is none.
    """
    from planner.errors import TaskError

    found = [name.strip() for name in text.split(",") if name.strip()]
    if not found:
        raise TaskError(f"{text!r} holds no name; give names with commas between them")
    return found


COUNTS = ("none", "one", "two", "three", "four", "five", "six")
"""Counts in words."""


def numbers(option: str, text: str, count: int) -> list[float]:
    """So many numbers with commas between them.

    Raises:
        TaskError: Something else.
    """
    from planner.errors import TaskError

    wanted = "give one" if count == 1 else f"give {COUNTS[count]} with commas between them"
    try:
        values = [float(v) for v in text.split(",")]
    except ValueError as error:
        raise TaskError(f"{option} {text!r} holds something else than numbers; {wanted}") from error
    if len(values) != count:
        raise TaskError(f"{option} {text!r} has {len(values)} numbers; {wanted}")
    if not all(math.isfinite(v) for v in values):
        raise TaskError(f"{option} {text!r} is not finite; {wanted}")
    return values


Vector = tuple[float, float, float]

AXES: dict[str, Vector] = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


def movement(rotate: str | None, shift: str) -> tuple[Vector, float, Vector]:
    """Axis (3,), world, degrees and translation (3,), m, world, of --rotate and --shift together.

    Degrees are infinite for "max", the largest turn that there is.

    Raises:
        TaskError: They hold something else.
    """
    x, y, z = numbers("--shift", shift, 3)
    if rotate is None:
        rotate = "z:0" if any((x, y, z)) else USUAL_TURN
    return (*_turn(rotate), (x, y, z))


def attitude_of(text: str) -> AnyAttitude:
    """What --attitude holds, as planning takes it: a name, or R = Rz(yaw) Ry(pitch) Rx(roll).

    Raises:
        TaskError: Something else.
    """
    if "," not in text:
        return text
    import pinocchio as pin

    roll, pitch, yaw = (math.radians(v) for v in numbers("--attitude", text, 3))
    turn: FloatArray = pin.rpy.rpyToMatrix(roll, pitch, yaw)
    return turn


def _turn(text: str) -> tuple[Vector, float]:
    """Axis and degrees of a turn.

    Raises:
        TaskError: Something else.
    """
    from planner.errors import TaskError

    axis, colon, degrees = text.rpartition(":")
    if not colon:
        axis = "z"
    if "," in axis:
        x, y, z = numbers("--rotate", axis, 3)
        vector: Vector = (x, y, z)
    elif axis in AXES:
        vector = AXES[axis]
    else:
        raise TaskError(
            f"--rotate {text!r} names no axis; give x, y or z and degrees: y:30, a vector and "
            "degrees: 0,0,1:30, or degrees about z alone: 90"
        )
    return vector, math.inf if degrees == "max" else numbers("--rotate", degrees, 1)[0]
