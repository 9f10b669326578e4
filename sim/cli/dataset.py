"""The command ``dataset``: stable states to start from, and trials as episodes to learn from."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape

from planner.tolerances import DEFAULT_MU
from sim.cli.common import (
    EXIT_INTERRUPTED,
    EXIT_NOT_FOUND,
    err,
    goes_on,
    heeding_ctrl_c,
    print_json,
    say,
    show_wide,
    tell,
)
from sim.cli.execution import controller_of, physics_of
from sim.cli.options import (
    SEARCH,
    TRIAL,
    FingersOption,
    HandArgument,
    JsonOption,
    MuOption,
    ObjectsArgument,
    PhysicsOption,
    SeedOption,
    SimMuOption,
    WorkersOption,
    argument,
    command,
    flag,
    names,
    numbers,
    option,
)
from sim.runner import ProgressBar
from sim.tables import table_of

if TYPE_CHECKING:
    from rich.table import Table

    from sim.datasets.episodes import AnyReport, Episode
    from sim.datasets.reset_states import StatesProgress

DRAWN = "What is drawn"
"""Group of the options that make states differ."""


@command
def states(
    hand: HandArgument,
    objects: ObjectsArgument,
    n: Annotated[
        int, option("States per object and size.", "N", None, "-n", "--number", min=1)
    ] = 1000,
    folder: Annotated[
        Path, option("Folder; a cache that is there goes on.", "DIR", None, "--out")
    ] = Path("cache"),
    scales: Annotated[str, option("Sizes relative to the object's.", "S,...")] = "1",
    formats: Annotated[
        list[str] | None,
        option("npz, parquet, hora, playground, isaac_lab, all.", "NAME", None, "--format"),
    ] = None,
    workers: WorkersOption = -1,
    seed: SeedOption = 0,
    grasps: Annotated[int, option("Grasps per object and size.", "N", SEARCH, min=0)] = 200,
    motions: Annotated[int, option("Planned turns, likewise.", "N", SEARCH, min=0)] = 30,
    gaits: Annotated[int, option("Planned gaits, likewise.", "N", SEARCH, min=0)] = 4,
    fingers: FingersOption = None,
    mu: MuOption = DEFAULT_MU,
    friction: Annotated[str, option("Range (-).", "LOW,HIGH", DRAWN)] = "0.6,1.2",
    mass: Annotated[
        str | None, option("Range, kg; 0.5 to 1.5 times the object's.", "LOW,HIGH", DRAWN)
    ] = None,
    gravity: Annotated[
        str, option("Direction in the hand's base.", "random|X,Y,Z", DRAWN)
    ] = "random",
    physics: PhysicsOption = "ours",
    as_json: JsonOption = False,
) -> None:
    """Make stable states of an object in the hand to learn from.

    They are drawn around planned grasps, turns and gaits, and each is held in MuJoCo for 2 s by
    position commands alone. Exit code 0 if every object and size got as many as were asked for.

    An interrupted run goes on when the same command is given again, also with a larger -n; a
    smaller one takes no state away.
    """
    from sim.datasets.reset_states import Draws, StatesAsked, make_states

    draws: dict[str, Any] = {"friction": tuple(numbers("--friction", friction, 2))}
    if mass is not None:
        draws["mass"] = tuple(numbers("--mass", mass, 2))
    if gravity != "random":
        draws["gravity"] = tuple(numbers("--gravity", gravity, 3))
    asked = StatesAsked(
        hand=hand,
        objects=tuple(objects),
        n=n,
        seed=seed,
        scales=tuple(numbers("--scales", scales, scales.count(",") + 1)),
        grasps=grasps,
        motions=motions,
        gaits=gaits,
        fingers=() if fingers is None else tuple(names(fingers)),
        mu=mu,
        draws=Draws(**draws),
        physics=physics_of(physics),
    )
    with StatesBar(err) as bar, goes_on(bar.kept):
        summary = make_states(
            asked, folder, workers=workers, formats=formats or ("all",), progress=bar.told
        )
    if as_json:
        print_json(summary)
    else:
        show_wide(states_table(summary))
        for cell in summary["cells"]:
            if cell["before"] > n:
                tell(f"{cell['name']} had {cell['before']} states before, and keeps them")
            for name, reason in cell["left_out"].items():
                tell(f"no {name} of {cell['name']}: {reason}")
        files = [file for cell in summary["cells"][:1] for file in cell["files"].values()]
        tell(f"written to {folder}: {', '.join((*files, 'summary.json'))}")
        first = summary["cells"][0]["name"]
        check = f"python {folder / 'check_states.py'} {folder / first / 'states.npz'}"
        tell(f"to hold a sample without Opposable: {check}")
    if any(cell["states"] < n for cell in summary["cells"]):
        raise typer.Exit(EXIT_NOT_FOUND)


class StatesBar(ProgressBar):
    """The bar of each phase, with rate and share kept; use it as a context."""

    def __init__(self, console: Console) -> None:
        """A bar on a console."""
        super().__init__(console)
        self._states: dict[str, int] = {}

    def told(self, now: StatesProgress) -> None:
        """Show how far a run is."""
        note = ""
        if now.phase == "holding":
            self._states[now.cell] = now.done
            fresh = now.done - now.before
            rate = fresh / now.elapsed_s if now.elapsed_s > 0 else 0.0
            note = f"{rate:.1f}/s, kept {100 * now.done / max(1, now.tried):.0f} %"
        self.show(f"{now.phase} {now.cell}", now.done, now.total, note)

    def kept(self) -> str:
        """How much is kept, in words."""
        if not self._states:
            return "what was planned is kept"
        return f"{sum(self._states.values())} states are kept"


def states_table(summary: dict[str, Any]) -> Table:
    """A row per object and size, of the content of ``summary.json``."""
    table = table_of(
        f"{summary['hand']}: stable states",
        ("object", "commonest loss"),
        ("states", "kept", "CPU ms/state", "orientations covered", "gravity covered"),
    )
    for cell in summary["cells"]:
        states = f"{cell['states']}/{cell['asked']}"
        if not cell["tried"]:
            reasons = cell["plans"]["reasons"]
            table.add_row(cell["name"], next(iter(reasons), ""), states, "", "", "", "")
            continue
        lost = next(iter(cell["lost"].items()), ("", 0))
        covered = cell.get("coverage", {})
        shares = [
            f"{covered[key]['reached']}/{covered[key]['cells']}" if covered else ""
            for key in ("orientations_of_object_in_palm", "directions_of_gravity_in_palm")
        ]
        table.add_row(
            cell["name"],
            f"{lost[1]} {lost[0].split(':')[0]}" if lost[1] else "",
            states,
            f"{100 * cell['rate_kept']:.1f} %",
            f"{1e3 * cell['hold_cpu_s_per_state']:.1f}",
            *shares,
        )
    return table


@command
def episodes(
    inputs: Annotated[
        list[Path], argument("Plans, reports, folders of plans or of batches.", "INPUT...")
    ],
    folder: Annotated[
        Path, option("The data set, a new folder.", "DIR", None, "--out", "-o")
    ] = Path("episodes"),
    to: Annotated[str, option("lerobot.", "FORMAT")] = "lerobot",
    fps: Annotated[
        int | None,
        option("Frames per second; if not given the most that fit, usually 50.", "N", min=1),
    ] = None,
    video: Annotated[bool, flag("--video", "Film every episode (lerobot).")] = False,
    size: Annotated[str, option("Width and height of the films, pixels.", "WxH")] = "320x240",
    failed: Annotated[bool, flag("--failed", "Keep trials that failed, marked so.")] = False,
    most: Annotated[
        int | None,
        option("Trials of every batch; all if not given.", "N", None, "-n", "--number", min=1),
    ] = None,
    controller: Annotated[
        str,
        option(
            "feedforward, impedance or policy:FILE; if not given, feedforward for grasps and "
            "impedance for turns.",
            "NAME",
            TRIAL,
        ),
    ] = "",
    sim_mu: SimMuOption = None,
    physics: PhysicsOption = "ours",
    as_json: JsonOption = False,
) -> None:
    """Trials as a LeRobot data set of episodes.

    Plans of grasps and manipulations and the rows of batches are executed in MuJoCo; reports with
    states are taken as they are. All are of one hand. Ctrl-C keeps the episodes that are whole; an
    error leaves nothing behind.
    """
    from sim.datasets.episodes import write_episodes
    from sim.datasets.episodes.episode import format_named
    from sim.datasets.episodes.sources import Trials, sources_of
    from sim.datasets.episodes.writing import check_films, refuse_full, size_of

    format_named(to)  # bad input ends here
    driver = controller_of(controller)
    pixels = size_of(size)
    if video:
        check_films(pixels)
    refuse_full(folder)
    trials = Trials(controller=driver, physics=physics_of(physics, sim_mu), fps=fps)
    sources = sources_of(inputs, trials, most=most)
    with heeding_ctrl_c() as check, ProgressBar(err, ticks=True) as bar:

        def reports() -> Iterator[tuple[str, AnyReport]]:
            for done, source in enumerate(sources):
                bar.show("episodes", done, len(sources))
                check()
                yield source.name, source.report()

        def left_out(episode: Episode, why: str) -> None:
            if why:
                say(err, escape(f"left out: {episode.source}: {why}"))

        written = write_episodes(
            reports(), folder, to, fps=fps, video=video, size=pixels, failed=failed, told=left_out
        )
    if as_json:
        print_json(written.to_dict())
    else:
        tell(str(written))
    if not written.complete:
        say(err, "interrupted; the episodes that were whole are kept")
        raise typer.Exit(EXIT_INTERRUPTED)
