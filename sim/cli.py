"""The command ``opposable``: thin; every subcommand imports what it needs when it runs.

Exit codes: 0 done and good; 1 done, and the answer is no (no closure, object not held); 2 wrong
usage; 3 bad input (an error that says what to do); 4 no grasp found; 130 interrupted.
"""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape

__all__ = ["main"]

EXIT_NO, EXIT_BAD_INPUT, EXIT_NOT_FOUND, EXIT_INTERRUPTED = 1, 3, 4, 130

app = typer.Typer(
    help="Plan a multi-finger grasp, execute it in MuJoCo, and judge both by the same analysis.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
bench = typer.Typer(help="Measure: tables that repeat the project's figures.", no_args_is_help=True)
app.add_typer(bench, name="bench")

TABLE_WIDTH = 120
"""Characters that the benchmark's table needs."""

out = Console()
err = Console(stderr=True)

HandArgument = Annotated[
    str, typer.Argument(help="A hand's name, or the path of its hand.toml.", metavar="HAND")
]
ObjectArgument = Annotated[
    str,
    typer.Argument(
        help="sphere, box, cylinder, capsule, ellipsoid; or with sizes in m: box:0.05x0.05x0.08",
        metavar="OBJECT",
    ),
]
FingersOption = Annotated[
    str | None, typer.Option(help="Fingers that take part: thumb,index,middle")
]
SeedOption = Annotated[int, typer.Option(min=0, help="Same seed, same plan.")]
MuOption = Annotated[float, typer.Option(help="Sliding friction that planning relies on (-).")]
MassOption = Annotated[float | None, typer.Option(help="Mass of the object, kg (default 0.1).")]
DensityOption = Annotated[
    float | None, typer.Option(help="Density of the object, kg/m3, instead of its mass.")
]
AttemptsOption = Annotated[int, typer.Option(min=1, help="Attempts before giving up.")]
CpuOption = Annotated[
    float | None, typer.Option(help="CPU seconds before giving up; checked between attempts.")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON for machines on stdout.")]
ViewOption = Annotated[bool, typer.Option("--view", help="Show the run in MuJoCo's viewer.")]
SimMuOption = Annotated[float, typer.Option(help="Sliding friction in simulation (-).")]
PlanArgument = Annotated[Path, typer.Argument(help="A plan file.", metavar="PLAN")]


def _say(console: Console, text: str) -> None:
    """Print a sentence that may hold a user's text; not broken into lines where it is piped."""
    console.print(text, highlight=False, soft_wrap=True)


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",")]


def _leave(*_: object) -> None:
    """Ctrl-C before anything was done."""
    os.write(2, b"interrupted\n")
    os._exit(EXIT_INTERRUPTED)


@contextmanager
def _errors_for_people() -> Iterator[None]:
    """Turn errors that a user can mend, and Ctrl-C, into a message and an exit code."""
    # Some libraries swallow a KeyboardInterrupt while they are imported: leave at once meanwhile.
    handler = signal.signal(signal.SIGINT, _leave)
    try:
        from planner.errors import NoGraspFoundError, PlannerError
    finally:
        signal.signal(signal.SIGINT, handler)
    try:
        yield
    except NoGraspFoundError as error:
        _say(err, f"[bold]not found:[/] {escape(str(error))}")
        raise typer.Exit(EXIT_NOT_FOUND) from error
    except PlannerError as error:
        _say(err, f"[bold red]error:[/] {escape(str(error))}")
        raise typer.Exit(EXIT_BAD_INPUT) from error
    except KeyboardInterrupt as error:
        _say(err, "interrupted")
        raise typer.Exit(EXIT_INTERRUPTED) from error


@contextmanager
def _heeding_ctrl_c() -> Iterator[Callable[[], None]]:
    """Give a function that raises the KeyboardInterrupt that got lost, if one did.

    CasADi makes a failed attempt out of a Ctrl-C while it solves, and planning would go on.
    """
    pressed: list[bool] = []

    def remember(*_: object) -> None:
        pressed.append(True)
        raise KeyboardInterrupt

    def check() -> None:
        if pressed:
            raise KeyboardInterrupt

    handler = signal.signal(signal.SIGINT, remember)
    try:
        yield check
    finally:
        signal.signal(signal.SIGINT, handler)


def _print_json(data: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(data, indent=1) + "\n")


def _plan(
    hand: str,
    object: str,
    *,
    fingers: str | None,
    seed: int,
    mu: float,
    mass: float | None,
    density: float | None,
    attempts: int,
    max_cpu_s: float | None,
) -> Any:
    """Plan with a spinner that counts attempts on stderr."""
    from planner.objects import parse_object
    from planner.search import Attempt, plan_grasp
    from planner.task import GraspTask

    task = GraspTask.create(
        hand,
        parse_object(object, mass=mass, density=density),
        mu=mu,
        fingers=None if fingers is None else _names(fingers),
    )
    title = f"planning: {task.hand.name}, {task.object.name} ..."
    with _heeding_ctrl_c() as check, err.status(title) as status:

        def show(attempt: Attempt) -> None:
            check()
            outcome = escape(attempt.reason[:70] or "found")
            status.update(f"planning: attempt {attempt.index + 1}: {outcome}")

        return plan_grasp(
            task, seed=seed, max_attempts=attempts, max_cpu_s=max_cpu_s, progress=show
        )


def _simulate(plan: Any, *, mu: float, view: bool, picture: Path | None) -> Any:
    """Execute with a progress bar on stderr."""
    from rich.progress import Progress

    from sim.scene import PhysicsOptions
    from sim.trial import simulate

    with Progress(console=err, transient=True, disable=not err.is_terminal) as progress:
        bar = progress.add_task("simulating", total=1.0)
        return simulate(
            plan,
            physics=PhysicsOptions(mu=mu),
            progress=lambda share: progress.update(bar, completed=share),
            view=view,
            picture=picture,
        )


@app.command()
@_errors_for_people()
def run(
    hand: HandArgument,
    object: ObjectArgument,
    out_dir: Annotated[
        Path | None, typer.Option("--out", help="Folder for plan, report and picture.")
    ] = None,
    fingers: FingersOption = None,
    seed: SeedOption = 0,
    mu: MuOption = 0.5,
    sim_mu: SimMuOption = 0.6,
    mass: MassOption = None,
    density: DensityOption = None,
    max_attempts: AttemptsOption = 40,
    max_cpu_s: CpuOption = None,
    view: ViewOption = False,
    as_json: JsonOption = False,
) -> None:
    """Plan a grasp, distribute its forces, execute it, judge it; writes plan, report, picture."""
    from planner.files import plan_to_dict, write_json, write_plan
    from sim.summary import print_plan, print_report
    from sim.viewing import check_display

    if out_dir is not None:
        _make_folder(out_dir)
    if view:
        check_display()
    plan = _plan(
        hand,
        object,
        fingers=fingers,
        seed=seed,
        mu=mu,
        mass=mass,
        density=density,
        attempts=max_attempts,
        max_cpu_s=max_cpu_s,
    )
    spec = plan.task.object.shape.spec.replace(":", "-")
    folder = out_dir or Path("runs") / f"{plan.task.hand.name}-{spec}-{seed}"
    _make_folder(folder)
    for old in ("report.json", "held.png"):  # of an earlier plan in this folder
        (folder / old).unlink(missing_ok=True)
    write_plan(plan, folder / "plan.json")
    if not as_json:
        print_plan(plan, out)
    report = _simulate(plan, mu=sim_mu, view=view, picture=folder / "held.png")
    write_json(report.to_dict(), folder / "report.json")
    if as_json:
        _print_json({"plan": plan_to_dict(plan), "report": report.to_dict()})
    else:
        print_report(report, out)
        note = ", held.png" if report.picture else f" (no picture: {report.picture_reason})"
        _say(out, escape(f"written to {folder}: plan.json, report.json{note}"))
    _exit_for(report)


def _make_folder(folder: Path) -> None:
    from planner.errors import FileFormatError

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileFormatError(f"cannot make the folder {folder}: {error.strerror}") from error


def _check_folder(file: Path | None) -> None:
    """Refuse a file in a folder that does not exist, before the work and not after it."""
    from planner.errors import FileFormatError

    if file is not None and not file.parent.is_dir():
        raise FileFormatError(f"cannot write {file}: there is no folder {file.parent}; make it")
    if file is not None and file.is_dir():
        raise FileFormatError(f"cannot write {file}: it is a folder; name a file")


def _exit_for(report: Any) -> None:
    if report.reason == "interrupted":
        raise typer.Exit(EXIT_INTERRUPTED)
    if not report.success:
        raise typer.Exit(EXIT_NO)


@app.command()
@_errors_for_people()
def inspect(hand: HandArgument, as_json: JsonOption = False) -> None:
    """What a hand is made of: joints per finger with limits, actuators, tips, masses, torques."""
    from planner.hand import Hand
    from sim.inspection import hand_tables, inspect_hand

    loaded = Hand.load(hand)
    if as_json:
        _print_json(inspect_hand(loaded))
    else:
        for table in hand_tables(loaded):
            out.print(table)


@app.command()
@_errors_for_people()
def plan(
    hand: HandArgument,
    object: ObjectArgument,
    output: Annotated[Path, typer.Option("--out", "-o", help="The plan file.")] = Path("plan.json"),
    fingers: FingersOption = None,
    seed: SeedOption = 0,
    mu: MuOption = 0.5,
    mass: MassOption = None,
    density: DensityOption = None,
    max_attempts: AttemptsOption = 40,
    max_cpu_s: CpuOption = None,
    as_json: JsonOption = False,
) -> None:
    """Plan a grasp and write it to a file."""
    from planner.files import plan_to_dict, write_plan
    from sim.summary import print_plan

    _check_folder(output)
    found = _plan(
        hand,
        object,
        fingers=fingers,
        seed=seed,
        mu=mu,
        mass=mass,
        density=density,
        attempts=max_attempts,
        max_cpu_s=max_cpu_s,
    )
    write_plan(found, output)
    if as_json:
        _print_json(plan_to_dict(found))
    else:
        print_plan(found, out)
        _say(out, escape(f"written to {output}"))


@app.command()
@_errors_for_people()
def simulate(
    plan_file: PlanArgument,
    report_file: Annotated[
        Path | None, typer.Option("--out", "-o", help="Write the trial report here.")
    ] = None,
    picture: Annotated[Path | None, typer.Option(help="Write a picture (PNG) here.")] = None,
    sim_mu: SimMuOption = 0.6,
    view: ViewOption = False,
    as_json: JsonOption = False,
) -> None:
    """Execute a plan file in MuJoCo: approach, close, squeeze, lift, hold; and judge it."""
    from planner.files import read_plan, write_json
    from sim.summary import print_report

    _check_folder(report_file)
    _check_folder(picture)
    report = _simulate(read_plan(plan_file), mu=sim_mu, view=view, picture=picture)
    if report_file is not None:
        write_json(report.to_dict(), report_file)
    if as_json:
        _print_json(report.to_dict())
    else:
        print_report(report, out)
        if picture is not None:
            note = report.picture_reason or f"written to {picture}"
            _say(out, escape(f"picture: {note}"))
    _exit_for(report)


@app.command()
@_errors_for_people()
def analyse(
    contacts_file: Annotated[
        Path, typer.Argument(help="A plan file or a list of contacts (JSON).", metavar="FILE")
    ],
    edges: Annotated[int, typer.Option(min=3, help="Sides of the friction pyramid.")] = 8,
    as_json: JsonOption = False,
) -> None:
    """Force closure, epsilon, min-weight and the rest of a plan or of contacts you typed in."""
    from planner.files import read_contacts
    from planner.quality import analyse as analyse_contacts

    contacts, length = read_contacts(contacts_file)
    report = analyse_contacts(contacts, length=length, edges=edges)
    if as_json:
        _print_json(report.to_dict())
    else:
        out.print(str(report), highlight=False)
    if not report.closure.closed:
        raise typer.Exit(EXIT_NO)


@app.command()
@_errors_for_people()
def schema(
    kind: Annotated[str, typer.Argument(help="plan, report or contacts")] = "plan",
) -> None:
    """The JSON Schema of plan files, trial reports, or contact lists."""
    from pydantic import BaseModel

    from planner.errors import NotFoundError
    from planner.files import ContactsFile, PlanFile
    from sim.report import ReportFile

    models: dict[str, type[BaseModel]] = {
        "plan": PlanFile,
        "report": ReportFile,
        "contacts": ContactsFile,
    }
    if kind not in models:
        raise NotFoundError("schema", kind, models)
    _print_json(models[kind].model_json_schema())


@bench.command("grasps")
@_errors_for_people()
def bench_grasps(
    hands: Annotated[str, typer.Option(help="Hands, comma separated.")] = (
        "shadow_hand,allegro_hand"
    ),
    objects: Annotated[str, typer.Option(help="Objects, comma separated.")] = (
        "sphere,box,cylinder,capsule,ellipsoid"
    ),
    seeds: Annotated[int, typer.Option(min=1, help="Seeds per cell, from 0.")] = 10,
    sim_mu: SimMuOption = 0.6,
    workers: Annotated[int, typer.Option(min=1, help="Processes.")] = 1,
    output: Annotated[Path | None, typer.Option("--out", help="Write JSON here.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Plan and execute hands x objects x seeds; the table of the README."""
    from planner.files import write_json
    from sim.benchmark import bench_table, run_benchmark

    _check_folder(output)
    result = run_benchmark(
        _names(hands), _names(objects), range(seeds), mu=sim_mu, workers=workers, console=err
    )
    if output is not None:
        write_json(result, output)
    if as_json:
        _print_json(result)
    else:
        # the table does not fit into 80 columns; a narrow terminal breaks its lines
        Console(width=max(out.width, TABLE_WIDTH)).print(bench_table(result))
    if result["interrupted"]:
        raise typer.Exit(EXIT_INTERRUPTED)


def main(arguments: list[str] | None = None) -> None:
    """Run the command line; ``arguments`` are ``sys.argv[1:]`` if None."""
    try:
        command: Callable[..., Any] = typer.main.get_command(app)
        command(args=arguments, prog_name="opposable")
    except KeyboardInterrupt:  # before a command began, or after it ended
        sys.exit(EXIT_INTERRUPTED)


if __name__ == "__main__":
    main()
