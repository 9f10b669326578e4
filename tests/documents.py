"""Run the commands and scripts of a page of the documentation, in order, in an empty folder.

What is run and how a page says so is written in ``docs/design.md`` under "Writing documentation".
As a script it runs one page where it stands: ``python tests/documents.py PAGE``.
"""

from __future__ import annotations

import io
import os
import re
import shlex
import shutil
import subprocess
import sys
from contextlib import nullcontext, redirect_stdout
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import groupby, zip_longest
from pathlib import Path
from typing import Any

import forks

ROOT = Path(__file__).resolve().parent.parent
FENCE = re.compile(r"^(?P<indent> *)(?P<marks>`{3,}|:{3,})(?P<word>[\w{}-]*)")
COMMENT = re.compile(r"^ *<!-- test: *(.*?) *-->$")
NUMBER = re.compile(r"-?\d+\.?\d*(?:e-?\d+)?")
QUOTED = re.compile(r"'[^']*'|\"[^\"$`]*\"")
SHELL = re.compile(r"[|&;<>$`#~\"'\\]")
"""What the shell does something with. No file of a page matches a star, so words keep theirs."""

BETWEEN = ("&&", "||", ";", "|")
"""What stands between the programs of a line, where no quotes are about it."""

RUN = ("opposable", "python", "cd", "ls", "cat", "head", "mkdir", "cp")
"""Programs of a console block that are run."""

NOT_RUN = ("pip", "git", "export", "source", "sphinx-build", "pytest", "uv", "apt", "brew")
"""Programs of a console block that are not: they install, or they are tested elsewhere."""

WORDS = ("add", "copy", "exit", "file", "needs", "prints", "skip")
"""What a comment ``<!-- test: ... -->`` may begin with."""


class PageError(Exception):
    """A page that does not do what it shows; the message says where."""


@dataclass(frozen=True)
class Block:
    """One fenced block of a page.

    Attributes:
        line: Line of the page on which its text begins, from 1.
        language: The word after the fence; "" without one.
        text: What is between the fences.
        notes: What the comments directly above say: (word, rest).
    """

    line: int
    language: str
    text: str
    notes: tuple[tuple[str, str], ...]

    def note(self, word: str) -> list[str]:
        """What follows a word in the comments above, once for each time it is said."""
        return [rest for said, rest in self.notes if said == word]

    @property
    def commands(self) -> list[tuple[int, str]]:
        """Commands of a console or bash block: (line of the page, command)."""
        return self._read()[0]

    @property
    def output(self) -> str:
        """What the page says is printed: lines that are no commands."""
        return self._read()[1]

    def _read(self) -> tuple[list[tuple[int, str]], str]:
        """Commands, those that go on after a backslash as one, and the other lines."""
        commands: list[tuple[int, str]] = []
        output: list[str] = []
        going_on = False
        for number, line in enumerate(self.text.splitlines(), self.line):
            given = line.rstrip().removesuffix("\\").strip()
            if going_on:
                commands[-1] = (commands[-1][0], f"{commands[-1][1]} {given}")
            elif self.language == "bash" and given and not given.startswith("#"):
                commands.append((number, given))
            elif self.language == "console" and line.startswith("$ "):
                commands.append((number, given.removeprefix("$").strip()))
            else:
                output.append(line)
                continue
            going_on = line.rstrip().endswith("\\")
        return commands, "\n".join(output)


def blocks(page: Path) -> list[Block]:
    """The fenced blocks of a page, from the top down.

    Raises:
        PageError: A comment for the test is not understood, or a fence does not end.
    """
    found: list[Block] = []
    notes: list[tuple[str, str]] = []
    lines = iter(enumerate(page.read_text(encoding="utf-8").splitlines(), 1))
    for number, line in lines:
        if comment := COMMENT.match(line):
            word, _, rest = comment[1].partition(" ")
            if word not in WORDS:
                raise PageError(f"{page}:{number}: {word!r} is none of {', '.join(WORDS)}")
            notes.append((word, rest.strip()))
        elif fence := FENCE.match(line):
            text: list[str] = []
            for _, inner in lines:
                if inner.strip() == fence["marks"]:
                    break
                text.append(inner.removeprefix(fence["indent"]))
            else:
                raise PageError(f"{page}:{number}: this fence has no end")
            found.append(Block(number + 1, fence["word"], "\n".join(text), tuple(notes)))
            notes = []
        elif line.strip() and notes:
            raise PageError(f"{page}:{number}: a comment for the test is not above a block")
    return found


def programs(command: str) -> list[list[str]]:
    """The words of each program that a line of the shell starts, by its bare name."""
    lexer = shlex.shlex(command, posix=True, punctuation_chars=";|&")
    lexer.whitespace_split = True
    found = []
    for between, part in groupby(lexer, key=BETWEEN.__contains__):
        words = [] if between else list(part)
        while words and re.fullmatch(r"\w+=.*", words[0]):  # a variable for this command
            words = words[1:]
        if words:
            name = Path(words[0]).name
            found.append(["python" if name == "python3" else name, *words[1:]])
    return found


def is_run(words: list[str]) -> bool:
    """Whether the test runs a program.

    Raises:
        PageError: It is not known.
    """
    if words[0] in NOT_RUN or words[:3] == ["python", "-m", "venv"]:
        return False
    if words[0] in RUN:
        return True
    raise PageError(f"{words[0]!r} is neither run ({', '.join(RUN)}) nor left out")


def same(printed: str, said: str) -> str | None:
    """Why an output is not what a page says: words to the letter, numbers to their last digits."""
    lines, expected = ([x for x in t.splitlines() if x.strip()] for t in (printed, said))
    if len(lines) != len(expected):
        return f"{len(lines)} lines instead of {len(expected)}:\n{printed}"
    for line, told in zip(lines, expected, strict=True):
        if NUMBER.sub("#", line).split() != NUMBER.sub("#", told).split():
            return f"{line!r} instead of {told!r}"
        for value, number in zip(NUMBER.findall(line), NUMBER.findall(told), strict=True):
            digits = number.partition("e")[0].partition(".")[2]
            if abs(float(value) - float(number)) > 2.1 * 10.0 ** -len(digits):
                return f"{value} instead of {number} in {line!r}"
    return None


class Run:
    """A page at work in the folder where the process stands."""

    def __init__(self, page: Path) -> None:
        """Read the page and prepare what its programs find around them."""
        self.page = page
        self.names: dict[str, Any] = {"__name__": "__main__"}
        self.printed = ""
        self.environment = os.environ | {
            "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
            "NO_COLOR": "1",
            "COLUMNS": "100",
        }

    def where(self, line: int) -> str:
        """A line of the page, for a message."""
        return f"{self.page.name}:{line}"

    def block(self, block: Block) -> None:
        """Do what one block shows.

        Raises:
            PageError: It does not do it.
        """
        for given in block.note("copy"):
            source, _, name = given.partition(" as ")
            shutil.copy(ROOT / source, name or Path(source).name)
        for name in block.note("file"):
            Path(name).write_text(f"{block.text}\n", encoding="utf-8")
        if block.note("file") or block.note("skip"):
            return
        if block.language == "python":
            self.script(block)
        elif block.commands:
            self.printed = "".join(self.command(block, *c) for c in block.commands)
        if block.note("prints") and (why := same(self.printed, block.output)):
            raise PageError(f"{self.where(block.line)}: {why}")

    def script(self, block: Block) -> None:
        """Run Python in the names that the page's earlier blocks have made."""
        padded = "\n" * (block.line - 1) + block.text
        with redirect_stdout(io.StringIO()) as out:
            exec(compile(padded, str(self.page), "exec"), self.names)
        self.printed = out.getvalue()

    def command(self, block: Block, line: int, command: str) -> str:
        """Run one line of the shell and return what it printed."""
        parts = programs(command)
        if not all([is_run(words) for words in parts]):
            return ""
        if parts[0][0] == "cd":
            os.chdir(parts[0][1])
            return ""
        if parts[-1][0] == "opposable":
            command = " ".join([command, *block.note("add")])
        done = self.ended(command)
        expected = int((block.note("exit") or ["0"])[0])
        if done.returncode != expected:
            raise PageError(
                f"{self.where(line)}: `{command}` ended with {done.returncode} instead of "
                f"{expected}:\n{done.stdout}{done.stderr}"
            )
        return done.stdout

    def ended(self, command: str) -> subprocess.CompletedProcess[str]:
        """A line of the shell after its end; our own program alone needs no shell."""
        name, *words = shlex.split(command)
        if name == "opposable" and not SHELL.search(QUOTED.sub("", command)):
            return forks.run(
                forks.command_line, *words, folder=Path.cwd(), environment=self.environment
            )
        return subprocess.run(
            ["bash", "-c", command],
            env=self.environment,
            capture_output=True,
            text=True,
            check=False,
        )


def missing(page: Path) -> list[str]:
    """Packages that a page needs and that are not installed."""
    names = [
        name for block in blocks(page) for said in block.note("needs") for name in said.split()
    ]
    return [name for name in dict.fromkeys(names) if find_spec(name) is None]


def is_compared(block: Block, following: Block | None) -> bool:
    """Whether a page says what a block prints: in it, or below a script."""
    below = following is not None and block.language == "python" and following.note("prints")
    return bool(block.note("prints") or below)


def run_page(page: Path) -> None:
    """Do all that a page shows, in the folder where the process stands.

    What a page says is printed comes from a whole trial; the others are brief.
    """
    from brief import brief_trials

    sys.path.insert(0, "")  # what a page writes can be imported by it
    run = Run(page)
    shown = blocks(page)
    for block, following in zip_longest(shown, shown[1:]):
        begun = sum(os.times()[:4])
        with nullcontext() if is_compared(block, following) else brief_trials():
            run.block(block)
        seconds = sum(os.times()[:4]) - begun  # of the processor, its programs' too
        if seconds > 0.1:
            print(f"{run.where(block.line)}: {block.language}, {seconds:.1f} s", file=sys.stderr)


def run_one(page: str) -> None:
    """Do all that a page shows; what it does not do ends the process with a message."""
    try:
        run_page(Path(page).resolve())
    except PageError as error:
        sys.exit(str(error))


if __name__ == "__main__":
    run_one(sys.argv[1])
