"""Our docstrings as Sphinx wants them: types out of the annotations, colons and bars left alone.

The docstrings are written to be read in an editor. Types stand in the annotations only; here each
is added to its parameter as it is written in the source, with links to what is public.
"""

from __future__ import annotations

import builtins
import inspect
import re
from typing import Any

from sphinx.application import Sphinx

from machinery.public import PACKAGES, documented, imports

RESULT = re.compile(r"^ *(Returns|Yields):$")
WORD = re.compile(r"[A-Za-z_][\w.]*")
LIST = re.compile(r" *([-*]|\d+\.) ")
FIELD = re.compile(r":(ivar|param) (?:\\\*)*(\w+):")
LITERAL = re.compile(r"(``.*?``)")


def as_written(annotation: object) -> str:
    """An annotation as its source says it."""
    text = annotation if isinstance(annotation, str) else inspect.formatannotation(annotation)
    return text.strip("'\"")


def linked(annotation: object, module: str) -> str:
    """An annotation out of a module, with links to the public names in it."""
    text = as_written(annotation)
    pieces: list[str] = []
    end = 0
    for word in WORD.finditer(text):
        name = word[0]
        home = ".".join(imports(module).get(name, (module, name)))
        if not hasattr(builtins, name) and (full := documented().get(home)):
            pieces += [literal(text[end : word.start()]), f":py:obj:`{name} <{full}>`"]
            end = word.end()
    return "\\ ".join(filter(None, [*pieces, literal(text[end:])]))


def literal(text: str) -> str:
    """Text as literal text, with the blanks around it outside."""
    bare = text.strip()
    return text.replace(bare, f"``{bare}``") if bare else text


def colons_are_colons(what: str, lines: list[str]) -> None:
    """Keep Napoleon from reading the words before a colon as the type of a result or attribute."""
    first = [0] if what in ("property", "attribute", "data") and lines else []
    for k in first + [k + 1 for k, line in enumerate(lines[:-1]) if RESULT.match(line)]:
        text = lines[k].lstrip()
        if ":" in text:
            lines[k] = f"{lines[k].removesuffix(text)}: {text}"


def bars_are_bars(lines: list[str]) -> None:
    """Let ``|f|`` be a magnitude and no substitution, outside of literal text."""
    block: int | None = None  # indentation of the line that began a literal block
    for k, line in enumerate(lines):
        indent = _indent(line)
        if block is not None and line.strip() and indent <= block:
            block = None
        if block is None:
            parts = LITERAL.split(line)
            parts[::2] = [part.replace("|", r"\|") for part in parts[::2]]
            lines[k] = "".join(parts)
            if line.rstrip().endswith("::"):
                block = indent


def indented_is_literal(lines: list[str]) -> None:
    """Show an indented block as it stands: formulas and tables, as in Markdown."""
    for k in range(len(lines) - 1, 1, -1):
        before = next((line for line in reversed(lines[:k]) if line.strip()), "")
        begins = lines[k].strip() and not lines[k - 1].strip() and before
        deeper = _indent(lines[k]) >= _indent(before) + 4
        if begins and deeper and not before.endswith("::") and not LIST.match(before):
            lines[k:k] = [f"{' ' * _indent(before)}::", ""]


def _indent(line: str) -> int:
    return len(line) - len(line.lstrip())


def shared_fields(lines: list[str]) -> None:
    """Say of attributes that are described together what is said of them of each."""
    for k in range(len(lines) - 1, -1, -1):
        if field := re.match(r":ivar ((?:\w+, )+\w+):(.*)", lines[k]):
            lines[k : k + 1] = [f":ivar {one}:{field[2]}" for one in field[1].split(", ")]


def fields(obj: object) -> dict[str, str]:
    """Attribute of a class -> its annotation with links."""
    found: dict[str, str] = {}
    for base in reversed(inspect.getmro(obj) if inspect.isclass(obj) else ()):
        if base.__module__.split(".")[0] in PACKAGES:
            annotations = vars(base).get("__annotations__", {})
            found |= {name: linked(kind, base.__module__) for name, kind in annotations.items()}
    return found


def add_types(what: str, obj: Any, lines: list[str]) -> None:
    """Add the types of parameters, results and attributes to what the docstring says of them."""
    types = {("ivar", name): kind for name, kind in fields(obj).items()}
    called, result = inspect.unwrap(getattr(obj, "fget", obj)), ""
    if inspect.isclass(called):
        called = vars(called).get("__init__")
    if inspect.isfunction(called) and called.__module__.split(".")[0] in PACKAGES:
        given = {n: linked(kind, called.__module__) for n, kind in called.__annotations__.items()}
        result = given.pop("return", "")
        types |= {("param", name): kind for name, kind in given.items()}
    for k in range(len(lines) - 1, -1, -1):
        field = FIELD.match(lines[k])
        if field and (text := types.get((field[1], field[2]))):
            lines.insert(k, f":{'type' if field[1] == 'param' else 'vartype'} {field[2]}: {text}")
    if what in ("function", "method") and result not in ("", "``None``"):
        lines += ["", f":rtype: {result}"]
    elif what == "property" and result:
        lines[:0] = [f"*Property*, {result}.", ""]


def before_napoleon(
    app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]
) -> None:
    """Make of a docstring in its source what Napoleon reads rightly."""
    indented_is_literal(lines)
    colons_are_colons(what, lines)
    bars_are_bars(lines)


def after_napoleon(
    app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]
) -> None:
    """Add to the fields that Napoleon has made."""
    shared_fields(lines)
    add_types(what, obj, lines)


def no_signature_of_models(
    app: Sphinx, what: str, name: str, obj: object, options: object, *_: object
) -> tuple[str, str] | None:
    """Leave out the arguments of a Pydantic model: its fields are a table of their own."""
    return ("", "") if hasattr(obj, "model_fields") else None


def setup(app: Sphinx) -> dict[str, Any]:
    """Register what is done to docstrings, before and after Napoleon."""
    app.connect("autodoc-process-docstring", before_napoleon, priority=100)
    app.connect("autodoc-process-docstring", after_napoleon, priority=900)
    app.connect("autodoc-process-signature", no_signature_of_models)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
