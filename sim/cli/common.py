"""What all commands share: consoles, arguments, exit codes, errors for people."""

from __future__ import annotations

import json
import math
import os
import shlex
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

EXIT_NO, EXIT_USAGE, EXIT_BAD_INPUT, EXIT_NOT_FOUND, EXIT_INTERRUPTED = 1, 2, 3, 4, 130
"""Done, and the answer is no; wrong usage; bad input; no grasp found; interrupted."""

out = Console()
err = Console(stderr=True)

SCENE_PANEL, GRIP_PANEL, MOVEMENT_PANEL, SEARCH_PANEL, TRIAL_PANEL = (
    "Object and surroundings",
    "Hand and grip",
    "Movement",
    "Search",
    "Trial",
)
"""Groups of options in the help of a command; what is in none is about output."""

HandArgument = Annotated[
    str,
    typer.Argument(help="Its name, hand.toml, MJCF or URDF file.", metavar="HAND"),
]
ObjectArgument = Annotated[
    str,
    typer.Argument(
        help="box, box:0.05x0.05x0.08 (m), part.stl*0.001, scene.xml#body; sphere, cylinder, "
        "capsule, ellipsoid, mug, lbracket, torus, hammer, superquadric, knot, cup, bowl, tube...",
        metavar="OBJECT",
    ),
]
FingersOption = Annotated[
    str | None,
    typer.Option(
        help="Those that take part: thumb,index,ring",
        metavar="NAMES",
        rich_help_panel=GRIP_PANEL,
    ),
]
SeedOption = Annotated[int, typer.Option(min=0, help="Same seed, same result.", metavar="N")]
MuOption = Annotated[
    float,
    typer.Option(help="Sliding friction relied on (-).", metavar="MU", rich_help_panel=GRIP_PANEL),
]
StandOption = Annotated[
    float,
    typer.Option(
        min=0.0,
        help="Height of a stand under the object, m.",
        metavar="M",
        show_default=False,
        rich_help_panel=SCENE_PANEL,
    ),
]
MassOption = Annotated[
    float | None,
    typer.Option(help="Mass, kg; 0.1 if not given.", metavar="KG", rich_help_panel=SCENE_PANEL),
]
RepairOption = Annotated[
    bool,
    typer.Option(
        "--repair",
        help="Mend its mesh however much that changes.",
        metavar="",
        rich_help_panel=SCENE_PANEL,
    ),
]
StrictOption = Annotated[
    bool,
    typer.Option(
        "--strict",
        help="Refuse a mesh that would be mended.",
        metavar="",
        rich_help_panel=SCENE_PANEL,
    ),
]
TouchOption = Annotated[
    list[str] | None,
    typer.Option(
        help="Where it may be touched: z>0.01,x<0.02 (m).",
        metavar="REGION",
        rich_help_panel=SCENE_PANEL,
    ),
]
AvoidOption = Annotated[
    list[str] | None,
    typer.Option(
        help="Where it must not be touched, likewise.",
        metavar="REGION",
        rich_help_panel=SCENE_PANEL,
    ),
]
JsonOption = Annotated[
    bool, typer.Option("--json", help="Print JSON for machines on stdout.", metavar="")
]
ViewOption = Annotated[
    bool,
    typer.Option(
        "--view", help="Show it in MuJoCo's viewer.", metavar="", rich_help_panel=TRIAL_PANEL
    ),
]
VerboseOption = Annotated[
    bool,
    typer.Option("--verbose", help="Print what explains the verdict too.", metavar=""),
]
VideoOption = Annotated[
    Path | None,
    typer.Option(help="Write a film here: run.mp4, run.webp or run.gif.", metavar="FILE"),
]
PictureOption = Annotated[
    Path | None, typer.Option(help="Write a picture (PNG) here.", metavar="FILE")
]
ArrowsOption = Annotated[
    bool,
    typer.Option("--arrows", help="Draw contact forces into pictures and film.", metavar=""),
]
ControllerOption = Annotated[
    str,
    typer.Option(
        help="feedforward: planned forces; impedance: a loop holds the object; policy:FILE.",
        metavar="NAME",
        rich_help_panel=TRIAL_PANEL,
    ),
]
SimMuOption = Annotated[
    float | None,
    typer.Option(
        help="Sliding friction in simulation (-).", metavar="MU", rich_help_panel=TRIAL_PANEL
    ),
]
PhysicsOption = Annotated[
    str,
    typer.Option(
        help="ours, mujoco-default, menagerie, dexgraspbench, or a TOML or JSON file.",
        metavar="NAME",
        rich_help_panel=TRIAL_PANEL,
    ),
]
RealityOption = Annotated[
    str,
    typer.Option(
        help="Errors: ideal, lab, rough, or a file.",
        metavar="NAME",
        rich_help_panel=TRIAL_PANEL,
    ),
]
JointErrorOption = Annotated[
    float | None,
    typer.Option(
        min=0.0,
        help="Standard deviation of the encoders' errors, for which fingers get room; that of "
        "--reality if not given.",
        metavar="DEG",
        rich_help_panel=GRIP_PANEL,
    ),
]

RealitySeedOption = Annotated[
    int | None,
    typer.Option(
        min=0, help="Of what --reality draws; 0.", metavar="N", rich_help_panel=TRIAL_PANEL
    ),
]
EstimateOption = Annotated[
    str | None,
    typer.Option(
        help="Object's pose by: all, touch, contact, none.",
        metavar="NAME",
        rich_help_panel=TRIAL_PANEL,
    ),
]
PadsOption = Annotated[
    str | None,
    typer.Option(
        help="Touch: exact, taxels, effort, binary.",
        metavar="SENSE",
        rich_help_panel=TRIAL_PANEL,
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
    from sim.physics import PRESETS

    found = PRESETS.given(text)
    return found if sim_mu is None else replace(found, mu=sim_mu)


def controller_of(name: str) -> Any:
    """What ``--controller`` names: a name as it is, or what makes controllers of a policy.

    Raises:
        NotFoundError: No controller or policy has that name.
        FileFormatError: A policy that cannot be read.
    """
    from sim.learning import named_driver

    return named_driver(name)


def check_policy(execution: Any, hand: Any, item: Callable[[], Any], degrees: float | None) -> None:
    """Refuse another hand than a policy's, and say what else it was not trained for.

    Call it before anything is planned; other controllers are for every hand.

    Args:
        execution: Options of an execution: ``controller``, ``physics``, ``sim_mu``, ``reality``
            and ``pads``.
        hand: Name or path of the hand, or the hand.
        item: Gives the object.
        degrees: Turn about the vertical that is asked for; None for another movement, or none.

    Raises:
        PlannerError: No such hand or object, or the policy is for another hand.
    """
    from sim.learning import PolicyMaker

    driver = controller_of(execution.controller)
    if not isinstance(driver, PolicyMaker):
        return
    from planner.hand_loading import load_hand

    about = driver.policy.about
    about.check(load_hand(hand) if isinstance(hand, str) else hand)
    physics = physics_of(execution.physics, execution.sim_mu)
    reality = reality_of(execution.reality, pads=execution.pads)
    beyond = about.beyond(item(), degrees, physics, reality)
    if beyond:
        say(err, escape(beyond))


def reckoning_with(request: Any, reality: str) -> Any:
    """A request that reckons with the encoders of a reality, unless it says how far they are off.

    Args:
        request: Options of planning, with ``joint_error``.
        reality: As ``reality_of`` takes it.

    Raises:
        PlannerError: See ``reality_of``.
    """
    if request.joint_error is not None:
        return request
    return replace(request, joint_error=math.degrees(reality_of(reality).encoder_offset))


def reality_of(
    text: str, seed: int | None = None, pads: str | None = None, *, draws: bool = False
) -> Any:
    """Reality as ``--reality``, ``--reality-seed`` and ``--pads`` give it.

    Args:
        text: Name of a preset, or a file.
        seed: Of what is drawn; that of the reality if None.
        pads: Sense of touch; that of the reality if None.
        draws: Whether something is drawn without ``--reality`` too.

    Raises:
        NotFoundError: There is none of that name, or no such sense of touch.
        FileFormatError: A file that cannot be read.
        TaskError: A field that there is not, a value out of range, or a seed of nothing.
    """
    from planner.errors import TaskError
    from sim.reality import REALITIES

    found = REALITIES.given(text)
    found = found if pads is None else replace(found, touch=pads)
    if seed is None:
        return found
    if found.ideal and not draws:
        raise TaskError(
            f"--reality-seed {seed} seeds errors, and the reality {found.name!r} has none; give "
            "--reality lab, rough or a file, or leave the seed out"
        )
    return found.seeded(seed)


def estimate_of(name: str | None) -> str | None:
    """Estimator as ``--estimate`` gives it.

    Raises:
        NotFoundError: There is none of that name.
    """
    from sim.estimation import check_estimator

    if name is not None:
        check_estimator(name)
    return name


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


class CtrlC:
    """Whether Ctrl-C was pressed; a call raises the KeyboardInterrupt that got lost, if one did."""

    def __init__(self) -> None:
        """Not yet."""
        self.pressed = False

    def __call__(self) -> None:
        """Raise if it was pressed.

        Raises:
            KeyboardInterrupt: It was.
        """
        if self.pressed:
            raise KeyboardInterrupt


@contextmanager
def heeding_ctrl_c(*, at_once: bool = True) -> Iterator[CtrlC]:
    """Note Ctrl-C, and raise the KeyboardInterrupt that got lost, if one did.

    CasADi makes a failed attempt out of a Ctrl-C while it solves, and planning would go on.
    SIGTERM, by which a system ends what runs too long, counts as Ctrl-C meanwhile.

    Args:
        at_once: Whether the first Ctrl-C raises; else it is only noted, and the second one raises.
    """
    noted = CtrlC()

    def remember(*_: object) -> None:
        again, noted.pressed = noted.pressed, True
        if at_once or again:
            raise KeyboardInterrupt

    handlers = {s: signal.signal(s, remember) for s in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield noted
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


def told_command(context: typer.Context) -> str:
    """What the command line was told, as it can be typed again; defaults are left out."""
    words = context.command_path.split()
    for parameter in context.command.params:
        name = parameter.name or ""
        source = context.get_parameter_source(name)
        if source is None or source.name != "COMMANDLINE":
            continue
        value = context.params[name]
        values = list(value) if isinstance(value, list | tuple) else [value]
        if parameter.param_type_name == "argument":
            words += [str(v) for v in values]
        elif isinstance(value, bool):
            words.append(parameter.opts[0] if value else parameter.secondary_opts[0])
        else:
            words += [word for v in values for word in (parameter.opts[0], str(v))]
    return shlex.join(words)


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


def keep_inputs(output: Path | None, *inputs: Path | None) -> None:
    """Refuse to write over a file that is read.

    Raises:
        FileFormatError: The output is one of the inputs.
    """
    from planner.errors import FileFormatError

    if output is None or not output.exists():
        return
    for given in inputs:
        if given is not None and given.is_file() and output.samefile(given):
            raise FileFormatError(f"{given} would be written over; give another name for it")


def check_films(*files: Path | None) -> None:
    """Refuse files that cannot be written, the last of them a film, before the work.

    Raises:
        FileFormatError: A folder that does not exist.
        TaskError: A film of an unknown kind, or one that needs a package.
    """
    from sim.looking.picture import check_video

    for file in files:
        check_folder(file)
    check_video(files[-1])


def exit_for(report: Any) -> None:
    """Exit as a trial report says."""
    if report.reason == "interrupted":
        raise typer.Exit(EXIT_INTERRUPTED)
    if not report.as_planned:
        raise typer.Exit(EXIT_NO)
