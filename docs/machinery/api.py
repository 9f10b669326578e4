"""The pages of the API: one a group of rooms, written from ``__all__`` before Sphinx reads."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.pycode import ModuleAnalyzer

from machinery.docstrings import bars_are_bars
from machinery.public import PACKAGES, PublicName, documented, groups, public_names
from machinery.write import write_pages

FOLDER = Path(__file__).parent.parent / "reference" / "generated" / "api"


def slug(title: str) -> str:
    """A title as the name of a file."""
    return re.sub(r"\W+", "-", title.lower())


def ours(value: object) -> bool:
    """Whether a class or function is defined in one of our packages."""
    return str(getattr(value, "__module__", "")).split(".")[0] in PACKAGES


def attribute_doc(name: PublicName) -> list[str]:
    """The docstring below a constant or an alias, line by line."""
    if inspect.ismodule(name.value):
        return (inspect.getdoc(name.value) or "").splitlines()
    return ModuleAnalyzer.for_module(name.home).find_attr_docs().get(("", name.home_name), [])


def summary(name: PublicName) -> str:
    """The first sentence of what a name is for."""
    value = name.value
    described = (inspect.isclass(value) or inspect.isroutine(value)) and ours(value)
    text = inspect.getdoc(value) or "" if described else "\n".join(attribute_doc(name))
    first = [" ".join(text.split("\n\n")[0].split())]
    bars_are_bars(first)
    return first[0]


def entry(name: PublicName) -> Iterator[str]:
    """The lines that document one name."""
    value = name.value
    also = [f"   Also ``from {package} import {name.name}``.\n" for package in name.shortcuts]
    if inspect.isclass(value) and ours(value):
        kind = "autoexception" if issubclass(value, BaseException) else "autoclass"
        yield from (f".. {kind}:: {name.full_name}", "   :members:", "")
    elif inspect.isroutine(value) and ours(value):
        yield from (f".. autofunction:: {name.full_name}", "")
    else:
        yield f".. py:data:: {name.name}"
        yield f"   :module: {name.module}"
        if isinstance(value, int | float | str | tuple) and len(repr(value)) < 70:
            yield f"   :value: {value!r}"
        yield ""
        described = attribute_doc(name)
        bars_are_bars(described)
        yield from (f"   {line}" for line in described)
        yield ""
    yield from also


def page(title: str, rooms: list[str]) -> str:
    """A page of the reference: its rooms, each with a table of names and what they mean."""
    lines = [title, "=" * len(title), ""]
    for room in rooms:
        mine = [n for n in public_names() if n.module == room or n.module.startswith(f"{room}.")]
        for module in dict.fromkeys(n.module for n in mine):
            names = sorted((n for n in mine if n.module == module), key=lambda n: n.name.lower())
            lines += [module, "-" * len(module), ""]
            lines += [f".. automodule:: {module}", "   :no-members:", ""]
            lines += [".. list-table::", "   :widths: auto", "   :class: names", ""]
            for name in names:
                lines += [f"   * - :py:obj:`{name.name} <{name.full_name}>`"]
                lines += [f"     - {summary(name)}"]
            lines += [""]
            for name in names:
                lines += entry(name)
    return "\n".join(lines)


def first_page() -> str:
    """The list of the pages, and the names that a script imports from the packages themselves."""
    lines = ["API", "===", ""]
    lines += ["Units, frames and signs are those of the :doc:`conventions </how/conventions>`.", ""]
    lines += [".. toctree::", "   :maxdepth: 1", "", *(f"   {slug(t)}" for t in groups()), ""]
    for package in PACKAGES:
        title = f"from {package} import ..."
        lines += [title, "-" * len(title), "", ".. list-table::", "   :class: names", ""]
        for name in public_names():
            if package in name.shortcuts and not name.name.startswith("_"):
                lines += [f"   * - :py:obj:`{name.name} <{name.full_name}>`"]
                lines += [f"     - {summary(name)}"]
        lines += [""]
    return "\n".join(lines)


def write(app: Sphinx) -> None:
    """Write the pages and their list."""
    pages = {f"{slug(title)}.rst": page(title, rooms) for title, rooms in groups().items()}
    write_pages(FOLDER, {"index.rst": first_page(), **pages})


def exists(full_name: str) -> bool:
    """Whether a dotted name of ours leads to something."""
    module, _, name = full_name.rpartition(".")
    if module.split(".")[0] not in PACKAGES:
        return False
    try:
        return hasattr(import_module(module), name)
    except ModuleNotFoundError:
        return exists(module)


def find_home(
    app: Sphinx, env: BuildEnvironment, node: addnodes.pending_xref, contnode: nodes.TextElement
) -> nodes.reference | nodes.TextElement | None:
    """Lead a name out of a signature, said as it is defined, to where it is documented.

    What is ours and not public stays without a link; what does not exist is a warning.
    """
    if node["refdomain"] != "py":
        return None
    target = str(node["reftarget"])
    for known, full in documented().items():
        if target == known or target.startswith(f"{known}."):
            found: Any = env.domains["py"].resolve_xref(
                env,
                node["refdoc"],
                app.builder,
                "obj",
                full + target.removeprefix(known),
                node,
                contnode,
            )
            return found
    inside = f"{node.get('py:module')}.{node.get('py:class')}"
    around = [n for n in public_names() if n.full_name == inside]
    homes = {str(node.get("py:module")), *(n.home for n in around)}
    there = exists(target) or any(exists(f"{home}.{target}") for home in homes)
    return contnode if there else None


def setup(app: Sphinx) -> dict[str, Any]:
    """Write the pages when a build begins."""
    app.connect("builder-inited", write)
    app.connect("missing-reference", find_home)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
