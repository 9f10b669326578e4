"""The commands of ``opposable`` in groups, and the names that they had before.

The only place where a command is registered: a new one is a line of ``GROUPS``. Its module is
imported when the command is asked for, so that none pays for another.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import typer
from rich.markup import escape
from typer.core import TyperGroup

from sim.cli.common import EXIT_BAD_INPUT, err, say


@dataclass(frozen=True, kw_only=True)
class Listed:
    """A command as it is listed.

    Attributes:
        name: Of the command; two words for one that stands under another.
        example: A line that can be typed as it stands.
        module: Where it is defined, in ``sim.cli``.
    """

    name: str
    example: str
    module: str

    @property
    def call(self) -> Callable[..., Any]:
        """What it does."""
        name = self.name.split()[-1]
        function: Callable[..., Any] = getattr(import_module(f"sim.cli.{self.module}"), name)
        return function


def _listed(name: str, arguments: str, module: str = "") -> Listed:
    """A command with its example; its module is called like it unless another is named."""
    example = f"opposable {name} {arguments}".strip()
    return Listed(name=name, example=example, module=module or name.split()[0])


GROUPS: dict[str, tuple[Listed, ...]] = {
    "Grasp": (
        _listed("run", "shadow_hand box", "grasp"),
        _listed("plan", "shadow_hand box -o plan.json", "grasp"),
        _listed("test", "plan.json -o report.json"),
        _listed("view", "plan.json -o plan.html"),
        _listed("use", "allegro_hand screwdriver", "grasp"),
    ),
    "In-hand": (
        _listed("manipulate", "allegro_hand cylinder:0.03x0.08 --rotate 45"),
        _listed("learn", "allegro_hand cylinder:0.03x0.08 -n 2 --rounds 0"),
    ),
    "Analysis": (
        _listed("analyse", "plan.json --forces"),
        _listed("certify", "plan.json --samples 100", "analyse"),
    ),
    "Data": (
        _listed("batch", "allegro_hand box mug -n 20"),
        _listed("scan", "box --views 2 -o cloud.ply"),
        _listed("export", "plan.json --to ros2-grasp -o g.yaml"),
        _listed("refine", "plan.json --out refined"),
        _listed("dataset states", "allegro_hand cylinder:0.03x0.08 -n 500"),
        _listed("dataset episodes", "plan.json -o episodes --video"),
    ),
    "Hands": (
        _listed("hands", "shadow_hand"),
        _listed("crosscheck", "my_hand.xml", "hands"),
        _listed("drive", "plan.json --rate 100 --log run.npz"),
    ),
}
"""Title of a group -> its commands; the first example is the group's."""

UNDER = {"dataset": "Data sets to learn from: stable states, episodes."}
"""Commands that hold others -> what they are."""


def _popped(words: list[str], *names: str) -> str | None:
    """The value of an option, taken out of the words; None where it is not given."""
    for at, word in enumerate(words):
        name, sign, value = word.partition("=")
        if name in names:
            if sign:
                del words[at]
                return value
            value = words[at + 1] if at + 1 < len(words) else ""
            del words[at : at + 2]
            return value
    return None


def _turn(default: str) -> Callable[[list[str]], list[str]]:
    """``plan-motion`` and ``plan-gait``: --angle and --axis are --rotate, friction is believed."""

    def words(given: list[str]) -> list[str]:
        given = [*given]
        axis, angle = _popped(given, "--axis"), _popped(given, "--angle")
        turn = f"{axis or 'z'}:{angle or default}"
        mu = [] if any(w.split("=")[0] == "--mu" for w in given) else ["--mu", "0.5"]
        return [*given, "--rotate", turn, *mu]

    return words


def _row(given: list[str]) -> list[str]:
    """``extract FOLDER ROW``: the second argument is the value of an option."""
    given = [*given]
    file = _popped(given, "--out", "-o")
    output = [] if file is None else ["-o", file]
    return [*given[:1], *(["--extract"] if len(given) > 1 else []), *given[1:], *output]


def _same(given: list[str]) -> list[str]:
    return given


@dataclass(frozen=True, kw_only=True)
class Renamed:
    """A command that has another name now.

    Attributes:
        begin: The words in its place.
        words: What becomes of the words behind it.
        end: Words behind those.
    """

    begin: tuple[str, ...]
    words: Callable[[list[str]], list[str]] = _same
    end: tuple[str, ...] = ()

    def line(self, given: list[str]) -> list[str]:
        """The words that do the same."""
        return [*self.begin, *self.words(given), *self.end]


RENAMED: dict[str, Renamed] = {
    "simulate": Renamed(begin=("test",)),
    "creep": Renamed(begin=("test",), end=("--protocol", "creep")),
    "demo": Renamed(begin=("manipulate", "--demo")),
    "plan-motion": Renamed(begin=("manipulate",), words=_turn("max"), end=("--plan-only",)),
    "plan-gait": Renamed(begin=("manipulate",), words=_turn("0"), end=("--plan-only", "--gait")),
    "forces": Renamed(begin=("analyse",), end=("--forces",)),
    "extract": Renamed(begin=("batch",), words=_row),
    "schema": Renamed(begin=("export", "--schema"), words=lambda given: given or ["plan"]),
    "audit": Renamed(begin=("refine",), end=("--judge-only",)),
    "inspect": Renamed(begin=("hands",)),
    "check-hand": Renamed(begin=("hands",), end=("--check",)),
    "describe": Renamed(begin=("hands",), end=("--describe",)),
    "states": Renamed(begin=("dataset", "states")),
    "episodes": Renamed(begin=("dataset", "episodes")),
}
"""Names that go with the next version -> what does the same."""

OLD_OPTIONS = {"--reality": "--error-model", "--reality-seed": "--error-seed"}
"""Options that go with the next version -> their names now."""


def word_of_today(word: str) -> str:
    """A word of a command line, an option by its name of today."""
    name, equals, value = word.partition("=")
    return OLD_OPTIONS.get(name, name) + equals + value


def flowing(text: str) -> str:
    """A docstring with every paragraph on one line, for a terminal of any width to break."""
    return "\n\n".join(" ".join(part.split()) for part in text.split("\n\n")).strip()


def _made(title: str, *commands: Listed) -> Any:
    """A command as Typer runs it, or a group of them."""
    made = typer.Typer(
        add_completion=False,
        help=UNDER.get(commands[0].name.split()[0]),
        no_args_is_help=len(commands) > 1,
    )
    for listed in commands:
        call = listed.call
        made.command(
            listed.name.split()[-1],
            help=flowing(call.__doc__ or ""),
            epilog=f"Example: {listed.example}",
            rich_help_panel=title,
        )(call)
    command: Any = typer.main.get_command(made)
    command.name, command.rich_help_panel = commands[0].name.split()[0], title
    return command


class Commands(Mapping[str, Any]):
    """Names -> commands, each made when it is asked for; old names stand for the new ones."""

    def __init__(self) -> None:
        """None is made yet."""
        self._listed: dict[str, list[tuple[str, Listed]]] = {}
        for title, commands in GROUPS.items():
            for listed in commands:
                self._listed.setdefault(listed.name.split()[0], []).append((title, listed))
        self._known: dict[str, Any] = {}

    def __getitem__(self, name: str) -> Any:
        """The command.

        Raises:
            KeyError: There is none.
        """
        if name == "bench":
            return measuring()
        if name in RENAMED:
            name = RENAMED[name].begin[0]
        if name not in self._known:
            found = self._listed[name]
            self._known[name] = _made(found[0][0], *(listed for _, listed in found))
        return self._known[name]

    def __iter__(self) -> Iterator[str]:
        """The names of today."""
        return iter(self._listed)

    def __len__(self) -> int:
        """How many there are."""
        return len(self._listed)


CHECKOUT = Path(__file__).resolve().parents[2]
"""Where this code lies; in a checkout the measurements lie beside it."""

NEEDS_CHECKOUT = (
    "[bold red]error:[/] measuring is `python -m benchmarks NAME` in a checkout: clone the "
    "repository, run `pip install -e .` in it, and repeat the command"
)
"""What ``bench`` answers in a wheel."""


def measuring() -> Any:
    """The commands of ``python -m benchmarks``.

    Raises:
        Exit: They are not there, as in a wheel.
    """
    if not (CHECKOUT / "pyproject.toml").is_file():
        say(err, NEEDS_CHECKOUT)
        raise typer.Exit(EXIT_BAD_INPUT)
    return typer.main.get_command(import_module("benchmarks.__main__").app())


class Opposable(TyperGroup):
    """The commands of ``opposable``; old names do the same, and say the new line."""

    def __init__(self, **attributes: Any) -> None:
        """As Typer makes it."""
        super().__init__(**attributes)
        self.commands: Any = Commands()

    def list_commands(self, ctx: Any) -> list[str]:
        """The names of today, in the order in which one would use them."""
        return list(self.commands)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Name, command and what is left of the words; an old name becomes the new line."""
        old = args[0]
        if old == "bench":
            group = self.commands[old]
            self._tell(ctx, old, ["python", "-m", "benchmarks", *args[1:]])
            return old, group, args[1:]
        if old in RENAMED:
            args = RENAMED[old].line(args[1:])
            self._tell(ctx, old, ["opposable", *args])
        new = [word_of_today(word) for word in args]
        if new != args:
            self._tell(ctx, next(w for w in args if w not in new), ["opposable", *new])
            args = new
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Run a command; a value of an option that it does not take is said with what it takes."""
        try:
            return super().invoke(ctx)
        except typer.BadParameter as error:
            cause = error.__cause__
            if cause is not None and type(cause).__module__.startswith("pydantic"):
                from planner.schema import told_of

                error.message = f"it{told_of(cause.errors()[0])}"  # type: ignore[attr-defined]
            raise

    @staticmethod
    def _tell(ctx: Any, old: str, new: list[str]) -> None:
        if not ctx.resilient_parsing:
            gone = old if old.startswith("-") else f"opposable {old}"
            text = f"`{gone}` goes with the next version; write: {shlex.join(new)}"
            say(err, escape(text))


def overview(title: str) -> str:
    """What ``opposable`` alone prints: the groups with their commands and an example of each."""
    width = 2 + max(map(len, GROUPS))
    lines = [title, ""]
    for group, commands in GROUPS.items():
        names = dict.fromkeys(c.name.split()[0] for c in commands)
        lines.append(f"{group:<{width}}{', '.join(names)}")
        lines.append(f"{'':<{width}}[dim]{commands[0].example}[/]")
    more = "A line on each: opposable --help. All options: opposable COMMAND --help"
    return "\n".join([*lines, "", more])
