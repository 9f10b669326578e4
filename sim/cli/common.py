"""What all commands share: consoles, arguments, exit codes, errors for people."""

from __future__ import annotations

import json
import math
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape

EXIT_NO, EXIT_BAD_INPUT, EXIT_NOT_FOUND, EXIT_INTERRUPTED = 1, 3, 4, 130
"""Done, and the answer is no; bad input; no grasp found; interrupted."""

out = Console()
err = Console(stderr=True)

HandArgument = Annotated[
    str,
    typer.Argument(
        help="A hand's name, or the path of its hand.toml or of an MJCF or URDF file.",
        metavar="HAND",
    ),
]
ObjectArgument = Annotated[
    str,
    typer.Argument(
        help="sphere, box, cylinder, capsule, ellipsoid, mug, lbracket, torus, hammer, "
        "superquadric, knot; with sizes in m: box:0.05x0.05x0.08; a mesh: "
        "mug.stl, part.obj*0.001; a body of a model: scene.xml#mug",
        metavar="OBJECT",
    ),
]
FingersOption = Annotated[
    str | None, typer.Option(help="Fingers that take part: thumb,index,middle")
]
SeedOption = Annotated[int, typer.Option(min=0, help="Same seed, same plan.")]
MuOption = Annotated[float, typer.Option(help="Sliding friction that planning relies on (-).")]
StandOption = Annotated[
    float, typer.Option(min=0.0, help="Height of a stand that carries the object, m; 0 for none.")
]
MassOption = Annotated[float | None, typer.Option(help="Mass of the object, kg (default 0.1).")]
DensityOption = Annotated[
    float | None, typer.Option(help="Density of the object, kg/m3, instead of its mass.")
]
RepairOption = Annotated[bool, typer.Option(help="Mend a mesh that does not bound a solid.")]
PoseOption = Annotated[
    int, typer.Option(min=0, help="Which of its stable poses the object stands in.")
]
TouchOption = Annotated[
    list[str] | None,
    typer.Option(help="Where fingers may touch, m from the centre of mass: z>0.01,x<0.02"),
]
AvoidOption = Annotated[
    list[str] | None, typer.Option(help="Where they must not touch, in the same form.")
]
ObjectiveOption = Annotated[
    str,
    typer.Option(
        help="What the grasp should be good at: epsilon, min_weight, task, robustness, torque, "
        "manipulability, limits; several with weights: epsilon:1,torque:0.5; none for nothing."
    ),
]
TaskWrenchOption = Annotated[
    list[str] | None,
    typer.Option(
        help="A wrench on the object that the objective task is about: fx,fy,fz,tx,ty,tz in N and "
        "N m, object's frame; the weight in any direction if there is none."
    ),
]
LoadOption = Annotated[
    str | None,
    typer.Option(
        help="The largest load that the object is to bear in the hand, in any direction: a force "
        "in N, or force,torque in N and N m. It sizes the grip; without it the weight does."
    ),
]
RoundsOption = Annotated[
    int | None,
    typer.Option(
        min=0,
        help="Rounds that work on the objectives; the planner's default if not given. More make "
        "stronger grasps, fewer are faster.",
    ),
]
AttemptsOption = Annotated[int, typer.Option(min=1, help="Attempts before giving up.")]
CpuOption = Annotated[
    float | None, typer.Option(help="CPU seconds before giving up; checked between attempts.")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON for machines on stdout.")]
VideoOption = Annotated[
    Path | None, typer.Option(help="Write a film here: run.mp4, run.webp or run.gif.")
]
PictureOption = Annotated[Path | None, typer.Option(help="Write a picture (PNG) here.")]
ArrowsOption = Annotated[
    bool, typer.Option("--arrows", help="Draw contact forces into pictures and film.")
]
ViewOption = Annotated[bool, typer.Option("--view", help="Show the run in MuJoCo's viewer.")]
ControllerOption = Annotated[
    str,
    typer.Option(
        help="feedforward: the planned forces; impedance: a loop that keeps the object in place."
    ),
]
SimMuOption = Annotated[
    float | None,
    typer.Option(help="Sliding friction in simulation (-); that of --physics if not given."),
]
PhysicsOption = Annotated[
    str,
    typer.Option(
        help="How MuJoCo computes: ours, mujoco-default, menagerie, dexgraspbench, or a TOML or "
        "JSON file with fields of PhysicsOptions.",
        metavar="NAME|FILE",
    ),
]
PlanArgument = Annotated[Path, typer.Argument(help="A plan file.", metavar="PLAN")]


def say(console: Console, text: str) -> None:
    """Print a sentence that may hold a user's text; not broken into lines where it is piped."""
    console.print(text, highlight=False, soft_wrap=True)


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


COUNTS = ("none", "one", "two", "three", "four", "five", "six")
"""Counts in words."""


def physics_of(text: str, sim_mu: float | None = None) -> Any:
    """Physics as ``--physics`` and ``--sim-mu`` give it.

    Raises:
        NotFoundError: There is no such preset.
        FileFormatError: A file that cannot be read.
        TaskError: A field that there is not, or a value out of range.
    """
    from sim.physics import physics_for

    found = physics_for(text)
    return found if sim_mu is None else replace(found, mu=sim_mu)


def _leave(*_: object) -> None:
    """Ctrl-C before anything was done."""
    os.write(2, b"interrupted\n")
    os._exit(EXIT_INTERRUPTED)


@contextmanager
def errors_for_people() -> Iterator[None]:
    """Turn errors that a user can mend, and Ctrl-C, into a message and an exit code."""
    # Some libraries swallow a KeyboardInterrupt while they are imported: leave at once meanwhile.
    handler = signal.signal(signal.SIGINT, _leave)
    try:
        from planner.errors import NoGraspFoundError, PlannerError
    finally:
        signal.signal(signal.SIGINT, handler)
    _made.clear()
    try:
        yield
    except NoGraspFoundError as error:
        _remove_empty_folders()
        say(err, f"[bold]not found:[/] {escape(str(error))}")
        raise typer.Exit(EXIT_NOT_FOUND) from error
    except PlannerError as error:
        _remove_empty_folders()
        say(err, f"[bold red]error:[/] {escape(str(error))}")
        raise typer.Exit(EXIT_BAD_INPUT) from error
    except KeyboardInterrupt as error:
        _remove_empty_folders()
        say(err, "interrupted")
        raise typer.Exit(EXIT_INTERRUPTED) from error


@contextmanager
def heeding_ctrl_c() -> Iterator[Callable[[], None]]:
    """Give a function that raises the KeyboardInterrupt that got lost, if one did.

    CasADi makes a failed attempt out of a Ctrl-C while it solves, and planning would go on.
    SIGTERM, by which a system ends what runs too long, counts as Ctrl-C meanwhile.
    """
    pressed: list[bool] = []

    def remember(*_: object) -> None:
        pressed.append(True)
        raise KeyboardInterrupt

    def check() -> None:
        if pressed:
            raise KeyboardInterrupt

    handlers = {s: signal.signal(s, remember) for s in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield check
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


def print_json(data: dict[str, Any]) -> None:
    """JSON on stdout, for machines; a number that is not finite becomes null."""
    from planner.plain import finite

    sys.stdout.write(json.dumps(finite(data), indent=1, allow_nan=False) + "\n")


def make_folder(folder: Path) -> None:
    """Make a folder, with an error for people; one that an error leaves empty is removed again."""
    from planner.errors import FileFormatError

    try:
        missing = [f for f in (folder, *folder.parents) if not f.exists()]
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        reason = getattr(error, "strerror", None) or error
        raise FileFormatError(f"cannot make the folder {folder}: {reason}") from error
    _made.extend(reversed(missing))


_made: list[Path] = []
"""Folders that the command made, outermost first."""


def _remove_empty_folders() -> None:
    while _made:
        with suppress(OSError):  # it holds something, or has gone
            _made.pop().rmdir()


def check_folder(file: Path | None) -> None:
    """Refuse a file in a folder that does not exist, before the work and not after it."""
    from planner.errors import FileFormatError

    if file is None:
        return
    try:
        has_folder, is_folder = file.parent.is_dir(), file.is_dir()
    except (OSError, ValueError) as error:  # too long a name, a barred way, a null character
        reason = getattr(error, "strerror", None) or error
        raise FileFormatError(f"cannot write {file}: {reason}; give another name") from error
    if not has_folder:
        raise FileFormatError(f"cannot write {file}: there is no folder {file.parent}; make it")
    if is_folder:
        raise FileFormatError(f"cannot write {file}: it is a folder; name a file")


def check_films(*files: Path | None) -> None:
    """Refuse files that cannot be written, the last of them a film, before the work.

    Raises:
        FileFormatError: A folder that does not exist.
        TaskError: A film of an unknown kind, or one that needs a package.
    """
    from sim.looking.film import check_video

    for file in files:
        check_folder(file)
    check_video(files[-1])


def exit_for(report: Any) -> None:
    """Exit as a trial report says."""
    if report.reason == "interrupted":
        raise typer.Exit(EXIT_INTERRUPTED)
    if not report.success:
        raise typer.Exit(EXIT_NO)
