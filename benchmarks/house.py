"""How large the house is: ``python -m benchmarks.house``; a minute, a plan and a trial.

Code lines (neither blank nor comment nor docstring) and files of each room, commands and options,
modules of ours that ``opposable run`` imports, and planner files that ``opposable plan`` enters.
"""

from __future__ import annotations

import ast
import io
import subprocess
import sys
import tempfile
import tokenize
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("planner", "sim")

IDLE = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}
"""Tokens that make no code line."""

IMPORTED = """
import atexit, sys
def count():
    ours = [n for n in sys.modules if n.split(".")[0] in ("planner", "sim")]
    print("IMPORTED", len(ours))
atexit.register(count)
"""

ENTERED = """
import atexit, inspect, sys
def note(frame, event, argument, seen=set()):
    code = frame.f_code
    if event == "call" and "/planner/" in code.co_filename and code.co_name[0] != "<":
        if code.co_flags & inspect.CO_OPTIMIZED:
            seen.add((code.co_filename, code.co_firstlineno))
def count():
    sys.setprofile(None)
    seen = note.__defaults__[0]
    print("ENTERED", len({name for name, _ in seen}), len(seen))
atexit.register(count)
sys.setprofile(note)
"""

COMMAND = """
import sys
sys.argv = ["opposable", *{words!r}]
from sim.cli import main
main()
"""


def code_lines(path: Path) -> int:
    """Lines of a file that hold a token of code; imports and ``__all__`` count."""
    source = path.read_text(encoding="utf-8")
    texts: set[int] = set()
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Expr(value=ast.Constant(value=str())):
                texts.update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in IDLE:
            lines.update(range(token.start[0], token.end[0] + 1))
    return len(lines - texts)


def rooms() -> Iterator[tuple[str, int, int]]:
    """Each room with its files and code lines, after the sums of the packages."""
    files: Counter[str] = Counter()
    lines: Counter[str] = Counter()
    for package in (*PACKAGES, "benchmarks"):
        for path in sorted((ROOT / package).rglob("*.py")):
            parts = path.relative_to(ROOT).parts
            room = "/".join(parts[:2]) if len(parts) > 2 else f"{package} (top level)"
            for name in (f"all of {package}", room):
                files[name] += 1
                lines[name] += code_lines(path)
    for name in sorted(files, key=lambda n: (not n.startswith("all of"), n)):
        yield name, files[name], lines[name]


def surface() -> tuple[int, int]:
    """Commands of the command line, and options of all of them."""
    import typer

    from sim.cli import app

    command = typer.main.get_command(app)
    shown = [c for c in command.commands.values() if not c.hidden]  # type: ignore[attr-defined]
    options = sum(p.param_type_name == "option" for c in shown for p in c.params)
    return len(shown), options


def counted(watch: str, *words: str) -> str:
    """What a watching line says after a command of ours has ended."""
    code = watch + COMMAND.format(words=words)
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(
            [sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=False
        )
    said = [line for line in done.stdout.splitlines() if line.startswith(("IMPORTED", "ENTERED"))]
    return said[-1] if said else done.stderr[-300:]


def main() -> None:
    """Print all of it."""
    for name, files, lines in rooms():
        print(f"{name:32} {files:5} files {lines:7} code lines")
    commands, options = surface()
    print(f"{commands} commands, {options} options")
    run = counted(IMPORTED, "run", "shadow_hand", "box")
    print(f"modules that `opposable run shadow_hand box` imports: {run}")
    plan = counted(ENTERED, "plan", "allegro_hand", "mug", "-o", "plan.json")
    print(f"planner files and functions that `opposable plan allegro_hand mug` enters: {plan}")


if __name__ == "__main__":
    main()
