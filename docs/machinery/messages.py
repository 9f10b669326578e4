"""Every message of an error that a user can meet, read out of the code that raises it.

A message is written where it is raised; here its template is shown, with the name of what is put in
in angle brackets. A test compares it with the messages that the code makes.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

from machinery.commands import shown
from machinery.write import write_pages
from planner import errors

ROOT = Path(__file__).resolve().parent.parent.parent
FOLDER = ROOT / "docs" / "reference" / "generated" / "messages"
SOMETHING = "<...>"
"""What stands for something that has no short name."""

COMPOSED = "(a sentence composed of what was found)"
"""The text of a failure that has no template."""

CLASSES = tuple(n for n in errors.__all__ if isinstance(getattr(errors, n), type))
"""The classes of errors; what else the module offers raises nothing."""

LEAVES = (ast.Constant, ast.Name, ast.expr_context, ast.operator, ast.cmpop, ast.alias)
"""What no call stands in: more than half of a tree."""

PAGES = {
    "NotFoundError": "Names that do not exist",
    "ModelError": "Model files",
    "HandError": "Hands",
    "ObjectError": "Objects and meshes",
    "TaskError": "Tasks, options and settings",
    "ContactError": "Contacts and wrenches",
    "FileFormatError": "Plans, reports and other files",
    "PlannerError": "What is not installed, and the rest",
    "NoGraspFoundError": "What is not installed, and the rest",
    "UncertainError": "What is not installed, and the rest",
    "UnreachableError": "What is not installed, and the rest",
    "InfeasibleError": "What is not installed, and the rest",
    "Finding": "What hands --check finds",
    "Fault": "Faults of meshes",
    "ValueError": "Faults of a file, with the field where they are",
    "Failure": "Why nothing was found",
}
"""Error -> title of its page."""


MAKES = re.compile(rf"\b({'|'.join(dict.fromkeys([*CLASSES, *PAGES]))})\(")
"""A call of one of them."""


@dataclass(frozen=True, order=True)
class Message:
    """A message as it can be met.

    Attributes:
        text: Its template.
        error: The class that is raised, or ``Failure``.
        room: Where it comes from.
        kind: Of a failure, what statistics call it.
    """

    text: str
    error: str
    room: str
    kind: str = ""


class Reader:
    """Reads the messages of one module."""

    def __init__(self, path: Path) -> None:
        """Parse the module."""
        self.tree = ast.parse(path.read_text(encoding="utf-8"))
        self.room = ".".join(path.relative_to(ROOT).with_suffix("").parts[:2])
        self.functions: dict[str, ast.FunctionDef] = {}
        self.makers: list[tuple[ast.Call | ast.Raise, ast.AST | None]] = []  # in what functions
        waiting: list[tuple[ast.AST, ast.AST | None]] = [(self.tree, None)]
        while waiting:
            node, function = waiting.pop()
            if isinstance(node, ast.FunctionDef):
                self.functions[node.name] = function = node
            elif isinstance(node, ast.Call | ast.Raise):
                self.makers.append((node, function))
            children = [c for c in ast.iter_child_nodes(node) if not isinstance(c, LEAVES)]
            waiting += [(child, function) for child in reversed(children)]  # the first comes next
        self.constants = {
            target.id: node.value
            for node in self.tree.body
            if isinstance(node, ast.Assign)
            for target in node.targets
            if isinstance(target, ast.Name)
        }

    def messages(self) -> Iterator[Message]:
        """What the module raises, and the failures it returns."""
        for node, function in self.makers:
            yield from self._made(node, function)

    def _made(self, node: ast.Call | ast.Raise, function: ast.AST | None) -> Iterator[Message]:
        if isinstance(node, ast.Call) and _name(node.func) in CLASSES:
            yield from self._raised(node, function)
        elif isinstance(node, ast.Call) and _name(node.func) in ("Finding", "Fault"):
            given = {k.arg: k.value for k in node.keywords if k.arg}
            for what in self.texts(given["what"], function) if "what" in given else ():
                remedy_of = given.get("what_to_do", ast.Constant(""))
                for remedy in self.texts(remedy_of, function):
                    text = "; ".join(filter(None, [what, remedy]))
                    yield Message(text, _name(node.func), self.room)
        elif isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
            if _name(node.exc.func) == "ValueError":  # of a validator: it names a fault of a file
                yield from self._raised(node.exc, function)
        elif isinstance(node, ast.Call) and _name(node.func) == "Failure":
            given = {k.arg: k.value for k in node.keywords if k.arg}
            if {"kind", "text"} <= given.keys():
                kinds = list(self.texts(given["kind"], function))
                for text in self.texts(given["text"], function):
                    said = text if has_words(text) else COMPOSED
                    yield Message(said, "Failure", self.room, " or ".join(kinds))

    def _raised(self, call: ast.Call, function: ast.AST | None) -> Iterator[Message]:
        error = _name(call.func)
        if error == "NotFoundError":
            given = dict(zip(("what", "given", "available", "hint"), call.args, strict=False))
            given |= {k.arg: k.value for k in call.keywords if k.arg}
            for what in self.texts(given["what"], function):
                hints = list(self.texts(given["hint"], function)) if "hint" in given else [""]
                for hint in hints:
                    if "is_path" in given:
                        yield Message(f"<path> does not exist; {hint}", error, self.room)
                        continue
                    there = "Did you mean <nearest>? There is: <names>."
                    yield Message(
                        f"no {what} is called <name>. {there} {hint}".strip(), error, self.room
                    )
        elif call.args:
            for text in self.texts(call.args[0], function):
                yield Message(text, error, self.room)

    def texts(self, node: ast.AST, function: ast.AST | None, depth: int = 0) -> Iterator[str]:
        """The templates that an expression can be, with a name for what is put in."""
        if depth > 4:
            yield SOMETHING
        elif isinstance(node, ast.Constant):
            yield str(node.value)
        elif isinstance(node, ast.JoinedStr):
            yield "".join(self._part(part) for part in node.values)
        elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
            for left in self.texts(node.left, function, depth + 1):
                for right in self.texts(node.right, function, depth + 1):
                    yield left + right
        elif isinstance(node, ast.IfExp):
            yield from self.texts(node.body, function, depth + 1)
            yield from self.texts(node.orelse, function, depth + 1)
        elif isinstance(node, ast.Name) and node.id in self.constants:
            yield from self.texts(self.constants[node.id], None, depth + 1)
        elif isinstance(node, ast.Name) and (values := _assigned(node.id, function)):
            for value in values:
                yield from self.texts(value, function, depth + 1)
        elif isinstance(node, ast.Call) and (made := self.functions.get(_name(node.func))):
            for inner in ast.walk(made):
                if isinstance(inner, ast.Return) and inner.value is not None:
                    yield from self.texts(inner.value, made, depth + 1)
        else:
            yield named(node)

    def _part(self, part: ast.expr) -> str:
        """One part of an f-string."""
        if isinstance(part, ast.FormattedValue):
            inner = part.value
            if isinstance(inner, ast.Name) and inner.id in self.constants:
                value = self.constants[inner.id]
                if isinstance(value, ast.Constant):
                    return str(value.value)
            return named(inner)
        return str(part.value) if isinstance(part, ast.Constant) else SOMETHING


def named(node: ast.AST) -> str:
    """A short name of an expression, in angle brackets."""
    if isinstance(node, ast.Name | ast.Attribute):
        name = _name(node)
        return f"<{name.strip('_').replace('_', ' ')}>" if len(name) > 1 else SOMETHING
    if isinstance(node, ast.Subscript | ast.Starred):
        return named(node.value)
    if isinstance(node, ast.Call) and len(node.args) == 1:
        of = named(node.args[0])
        if _name(node.func) == "len" and of != SOMETHING:
            return f"<number of {of[1:]}"
        return of
    if isinstance(node, ast.GeneratorExp | ast.ListComp):
        return named(node.generators[0].iter)
    if isinstance(node, ast.BinOp):
        return named(node.left)
    return SOMETHING


def _name(node: ast.AST) -> str:
    """The last part of a dotted name."""
    return str(getattr(node, "id", "") or getattr(node, "attr", ""))


def _assigned(name: str, function: ast.AST | None) -> list[ast.expr]:
    """What a name is set to in a function."""
    return [
        node.value
        for node in (ast.walk(function) if function is not None else ())
        if isinstance(node, ast.Assign)
        for target in node.targets
        if isinstance(target, ast.Name) and target.id == name
    ]


def modules() -> list[Path]:
    """Modules whose errors a user can meet."""
    return [p for pkg in ("planner", "sim") for p in sorted((ROOT / pkg).rglob("*.py"))]


def raises(path: Path) -> bool:
    """Whether a module makes an error, a failure or a finding anywhere; most do not."""
    return MAKES.search(path.read_text(encoding="utf-8")) is not None


@cache
def read(path: Path) -> tuple[Message, ...]:
    """The messages of a module."""
    return tuple(Reader(path).messages())


@cache
def all_messages() -> tuple[Message, ...]:
    """Every message once, in alphabetical order, those without any word left out."""
    found = {m for path in modules() if raises(path) for m in read(path)}
    by_text = {(m.text, m.error, m.kind): m for m in sorted(found, reverse=True)}
    return tuple(sorted(m for m in by_text.values() if has_words(m.text)))


def has_words(text: str) -> bool:
    """Whether a template says anything of its own."""
    return any(c.isalpha() for part in text.split("<") for c in part.partition(">")[2] or "") or (
        bool(text) and not text.startswith("<")
    )


def slug(title: str) -> str:
    """A title as the name of a file."""
    return "-".join(word.strip(",") for word in title.lower().split())


def page(title: str, messages: list[Message]) -> str:
    """A table of messages."""
    lines = [title, "=" * len(title), ""]
    classes = sorted({m.error for m in messages if m.error in CLASSES})
    if classes:
        lines += ["In Python: " + ", ".join(f":py:exc:`planner.errors.{c}`" for c in classes), ""]
    kinds = any(m.kind for m in messages)
    lines += [".. list-table::", "   :header-rows: 1", "   :class: messages", ""]
    lines += ["   * - message", f"     - {'kind' if kinds else 'from'}"]
    for message in messages:
        lines += [f"   * - {shown(message.text)}"]
        lines += [f"     - ``{(message.kind if kinds else message.room) or message.room}``"]
    return "\n".join([*lines, ""])


def pages() -> dict[str, str]:
    """Name of a file -> its text: one page a kind of error."""
    titles: dict[str, list[Message]] = {title: [] for title in PAGES.values()}
    for message in all_messages():
        titles[PAGES[message.error]].append(message)
    return {f"{slug(title)}.rst": page(title, found) for title, found in titles.items() if found}


def setup(app: Sphinx) -> dict[str, Any]:
    """Write the pages when a build begins."""
    app.connect("builder-inited", lambda _: write_pages(FOLDER, pages()))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
