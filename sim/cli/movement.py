"""``--rotate`` and ``--shift``: what a command is told to do with the object in the hand."""

from __future__ import annotations

from typing import Annotated

import typer

from sim.cli.common import MOVEMENT_PANEL, numbers

NO_SHIFT, USUAL_TURN = "0,0,0", "z:90"
"""What is done if nothing is said: no translation, and this turn where there is no translation."""

RotateOption = Annotated[
    str | None,
    typer.Option(
        help=f"Axis (world) and degrees: y:30; {USUAL_TURN} if neither this nor --shift is given.",
        metavar="TURN",
        rich_help_panel=MOVEMENT_PANEL,
    ),
]
ShiftOption = Annotated[
    str,
    typer.Option(
        help="Translation in the hand, m, world.",
        metavar="X,Y,Z",
        show_default=False,
        rich_help_panel=MOVEMENT_PANEL,
    ),
]

Vector = tuple[float, float, float]

AXES: dict[str, Vector] = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


def movement(rotate: str | None, shift: str) -> tuple[Vector, float, Vector]:
    """Axis (3,), world, degrees and translation (3,), m, world, of both options together.

    Raises:
        TaskError: They hold something else.
    """
    x, y, z = numbers("--shift", shift, 3)
    if rotate is None:
        rotate = "z:0" if any((x, y, z)) else USUAL_TURN
    return (*_turn(rotate), (x, y, z))


def _turn(text: str) -> tuple[Vector, float]:
    """Axis and degrees of a turn.

    Raises:
        TaskError: Something else.
    """
    from planner.errors import TaskError

    axis, colon, degrees = text.rpartition(":")
    if not colon:
        axis = "z"
    if axis not in AXES:
        raise TaskError(
            f"--rotate {text!r} names no axis; give x, y or z and degrees: y:30, or degrees about "
            "z alone: 90"
        )
    return AXES[axis], numbers("--rotate", degrees, 1)[0]
